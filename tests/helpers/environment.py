"""What is run in an environment to say that mapdata works there, and its row in docs/install.md.

In a fresh environment of any Python, with the versions that are to be tried:

    pip install -e ".[train]" && NUMBA_CACHE_DIR=$(mktemp -d) python tests/helpers/environment.py

Needs nothing beside the dependencies of mapdata: the lowest versions that pyproject.toml allows are
tried too, and there is no pytest for each of them. What needs an extra is tried where it is there.
Takes a minute, most of it compiling. Prints what fails, and last the row; exit code 1 if anything
failed.
"""

from __future__ import annotations

import os
import platform
import re
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib.metadata import requires, version
from importlib.util import find_spec
from pathlib import Path

import torch
from pytorch_lightning import LightningModule, Trainer

from mapdata import MapDataModule, MapDataset, Sample
from mapdata.cli import main
from mapdata.shards import read_manifest

CHECKOUT = Path(__file__).parents[2]
MAPS = 10_000
CONTENT = "f3d6ab24f58abf8a0a9f3c418a30af731880ddb0d0bdd902e96ca81ffd2f18d3"
"""The content hash of the default recipe."""


class Model(LightningModule):
    """Says of a map and a goal how long the path is."""

    def __init__(self) -> None:
        """Make one layer."""
        super().__init__()
        self.layer = torch.nn.Linear(64 * 64 + 2, 1)

    def training_step(self, batch: Sample, _: int) -> torch.Tensor:
        """Return the squared error of a batch of the default fields."""
        cells = torch.cat((batch.map.flatten(1), batch.goal / 64), dim=1)
        length = (batch.path[..., 0] >= 0).sum(dim=1)
        return torch.nn.functional.mse_loss(self.layer(cells)[:, 0], length / 64)

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Return the optimizer."""
        return torch.optim.Adam(self.parameters())


def build() -> None:
    """Build the default recipe; its bytes are those of every other machine."""
    main(["build", "maps"])
    assert read_manifest(Path("maps")).content_hash == CONTENT
    main(["verify", "maps"])


def kept() -> None:
    """Read files that other versions wrote."""
    for root in sorted((CHECKOUT / "tests" / "data").iterdir()):
        main(["verify", str(root)])


def served() -> None:
    """Read a dataset through http."""
    handler = partial(SimpleHTTPRequestHandler, directory=".")
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_port}/maps"
        for ours, theirs in zip(MapDataset(url)[:5], MapDataset("maps")[:5], strict=True):
            assert torch.equal(ours, theirs)
        server.shutdown()


def train() -> None:
    """Train an epoch on the default fields."""
    trainer = Trainer(
        max_epochs=1,
        accelerator="cpu",
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
    )
    trainer.fit(Model(), MapDataModule("maps", batch_size=256))
    assert trainer.current_epoch == 1


def converted() -> None:
    """Write pictures and tables, and read the maps from them."""
    main(["build", "few", "--maps", "20"])
    main(["export", "few", "release", "--format", "paper"])
    main(["import", "release/images", "again", "--images.invert"])
    assert sum(entry.stop - entry.start for entry in read_manifest(Path("again")).shards) == 20
    main(["export", "few", "robots", "--format", "ros", "--ros.image", "png"])
    main(["import", "robots", "robot-maps"])
    assert sum(entry.stop - entry.start for entry in read_manifest(Path("robot-maps")).shards) == 20
    main(["show", "few", "-o", "map.png"])


def script() -> None:
    """Take one training step of a path predictor, by its command line."""
    file = str(CHECKOUT / "scripts" / "train_path_predictor.py")
    subprocess.run(
        [sys.executable, file, "--product", "fit", "--trainer.fast_dev_run", "true"], check=True
    )


def parquet() -> None:
    """Write what Hugging Face reads."""
    main(["export", "few", "hub", "--format", "parquet"])


def dask() -> None:
    """Build in processes of a cluster."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        main(["build", "by-dask", "--maps", "20", "--scheduler", address])
    assert read_manifest(Path("by-dask")).content_hash == read_manifest(Path("few")).content_hash


def roadmap() -> None:
    """Solve problems with the sampler of a sample model."""
    file = str(CHECKOUT / "scripts" / "evaluate_sampler.py")
    subprocess.run(
        [sys.executable, file, "--preset", "paper", "--maps", "3", "--sizes", "12"], check=True
    )


STEPS: dict[str, Callable[[], None]] = {
    "build and verify": build,
    "kept files": kept,
    "http": served,
    "an epoch": train,
    "out and in": converted,
}
EXTRAS: dict[str, Callable[[], None]] = {
    "jsonargparse": script,
    "pyarrow": parquet,
    "distributed": dask,
    "scipy": roadmap,
}
"""What needs a library that mapdata does without, tried where it is installed."""


def row(result: str) -> str:
    """Return the row of docs/install.md: the versions of all dependencies and the result."""
    import h5py

    wanted = [text for text in requires("mapdata-torch") or [] if "extra ==" not in text]
    names = sorted(re.split(r"[\[<>=~! ;]", text)[0] for text in wanted)
    names += [name for name in EXTRAS if find_spec(name)]
    versions = ", ".join(f"{name} {version(name)}" for name in names)
    hdf5 = f" (HDF5 {h5py.version.hdf5_version})"
    versions = versions.replace(f"h5py {version('h5py')}", f"h5py {version('h5py')}{hdf5}")
    return f"| {platform.python_version()} | {versions} | {result} |"


def run() -> None:
    """Run all steps, whatever fails, and print the row."""
    failed = []
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        extras = {name: step for name, step in EXTRAS.items() if find_spec(name)}
        for name, step in {**STEPS, **extras}.items():
            print(f"--- {name}", flush=True)
            try:
                step()
            except BaseException:  # SystemExit is how a command fails
                traceback.print_exc()
                failed.append(name)
        os.chdir(CHECKOUT)  # some systems remove no folder that is in use
    print(row("all pass" if not failed else f"fails: {', '.join(failed)}"))
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    run()
