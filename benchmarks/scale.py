"""A dataset of a million maps from its build to its export: python -m benchmarks scale.

Each step runs in a process of its own, as on a cluster, with one thread. It needs a gigabyte of
disk for the maps, and half of one for the export.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.measure import Row, to_text

PACKAGES = ("mapdata-torch", "numpy", "h5py")
SHARD = 10_000
BEGIN = """
import resource, sys, time
import numpy as np, torch
import mapdata
from mapdata import MapDataset
from mapdata.export import export_problems
torch.set_num_threads(1)
root, number = sys.argv[1], int(sys.argv[2])
mapdata.build(root + "/kernels", "paper", maps=10, workers=1)
warm = MapDataset(root + "/kernels")
warm[[0, 1]]
"""
"""What each program begins with: imports, kernels and their cache are not measured."""

END = """
seconds = time.process_time() - began
print(work, seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""
"""What each program ends with: it prints a number of its work, its time, and its memory in MB."""

EPOCH = """
dataset = MapDataset(root + "/maps", "train")
dataset[np.arange(0, len(dataset), 5_000)]  # opens and hashes the shards, another step
order = np.random.default_rng(0).permutation(len(dataset))
began = time.process_time()
for first in range(64 * part, len(order), 64 * parts):
    dataset.__getitems__(order[first : first + 64])
work = len(order) // parts
"""
"""An epoch of the training split in random order, or each ``parts``-th batch of it."""

STEPS = {
    "build": """
began = time.process_time()
mapdata.build(root + "/maps", "paper", maps=number, seed=1, shard_size=10_000, workers=1)
work = number
""",
    "open": """
began = time.process_time()
dataset = MapDataset(root + "/maps", "train")
dataset[np.arange(0, len(dataset), 5_000)]  # some problems of every shard
work = len(dataset)
""",
    "epoch": "part, parts = 0, 1" + EPOCH,
    "rank 0": "part, parts = 0, 2" + EPOCH,
    "rank 1": "part, parts = 1, 2" + EPOCH,
    "verify": """
began = time.process_time()
assert mapdata.verify(root + "/maps") == []
work = number
""",
    "export": """
export_problems(root + "/kernels", root + "/warm", fields=("map", "start", "goal", "cost"))
began = time.process_time()
work = number // 10
export_problems(
    root + "/maps", root + "/arrays", split="train", count=work,
    fields=("map", "start", "goal", "cost"),
)
""",
}
"""Programs of the steps, in order; ``root`` and ``number`` are their arguments."""


def start(step: str, root: Path, number: int) -> subprocess.Popen[str]:
    """Start the program of a step on a dataset of ``number`` maps."""
    program = BEGIN + STEPS[step] + END
    command = [sys.executable, "-c", program, str(root), str(number)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def result(process: subprocess.Popen[str]) -> tuple[int, float, float]:
    """Return what the program of a step prints: work, CPU seconds, and its largest memory in MB.

    Raises:
        SystemExit: it failed.
    """
    printed, _ = process.communicate()
    if process.returncode:
        raise SystemExit("a step failed, see above")
    work, seconds, memory = printed.split()[-3:]
    return int(work), float(seconds), float(memory)


def table(quick: bool, folder: str | None = None) -> str:
    """Return the table in markdown; ``quick`` takes a hundredth of the maps."""
    number = 10_000 if quick else 1_000_000
    rows = []
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        root = Path(temporary)
        for step, name in (
            ("build", "build {:,} maps with labels"),
            ("open", "open all shards, hashes compared"),
            ("epoch", "an epoch of its {:,} training problems, batches of 64"),
            ("ranks", "the same by two processes at once, {:,} problems each"),
            ("verify", "verify"),
            ("export", "export {:,} problems as arrays"),
        ):
            processes = [step] if step != "ranks" else ["rank 0", "rank 1"]
            found = [result(p) for p in [start(each, root, number) for each in processes]]
            work = found[0][0]
            seconds = max(each[1] for each in found)
            memory = max(each[2] for each in found)
            rate = f"{work / seconds:,.0f} a second"
            rows.append(
                Row(name.format(work), f"{seconds:.3g} s", note=f"{rate}, {memory:,.0f} MB")
            )
            if step == "build":
                size = sum(path.stat().st_size for path in (root / "maps").iterdir())
        rows[0] = rows[0]._replace(note=f"{rows[0].note}; {size / number:,.0f} bytes a map")
    return to_text(
        "A million maps",
        rows,
        packages=PACKAGES,
        notes=(
            f"preset paper, shards of {SHARD:,} maps; one thread for each process, measured once",
            "MB: the largest memory of the process, with torch. Files are in the page cache.",
        ),
    )
