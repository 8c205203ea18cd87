"""The one door to all benchmarks: python -m benchmarks
[labels|paths|terrain|making|build|loading|planners] [--quick].
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

TABLES = {
    "labels": "all labels of a map beside naive Python, and how they grow",
    "paths": "A* a path beside pyastar2d, python-tcod, scipy, scikit-image, networkx, pathfinding",
    "terrain": "goal fields and A* on terrain beside scikit-image and pyastar2d",
    "making": "making maps beside maze-dataset",
    "build": "a dataset on disk beside the kernels alone; the first build ever; imports",
    "loading": "batches beside tensors in RAM, TensorDataset, naive h5py, npz, PNG + CSV, "
    "HF datasets, webdataset",
    "planners": "classical and learned planners on the same problems",
}
HEAD = """# Benchmarks

Written by `python -m benchmarks{arguments}`. The contestants of a table take turns on one machine:
trust the ratios more than the times.

![Time of a path by A* and of a sample beside other packages, in multiples](images/speed.png)

A peer with other results than ours stops the run. Times and ratios are medians. A target is a
minimum ratio or rate, or a maximum time, size or growth; missed ones are marked. `pip install -e
".[bench]"` (and `maze-dataset "muutils<0.9"`) installs the peers; missing ones are skipped.
Single tables go by their names: labels, paths, terrain, making, build, loading, planners.
`--quick` takes a minute or two and is less exact.
"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables asked for, one after another, and write them as a page with --write."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="Measure ours beside the peers, on an idle machine.",
        epilog="\n".join(f"{name:10}{what}" for name, what in TABLES.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "tables", nargs="*", metavar="TABLE", help=f"{', '.join(TABLES)} (default: all)"
    )
    parser.add_argument(
        "--quick", action="store_true", help="a small run: minutes, and rough figures"
    )
    parser.add_argument(
        "--folder", help="where datasets are written (default: the temporary folder)"
    )
    parser.add_argument(
        "--write", metavar="FILE", help="write the tables as a page, such as docs/benchmarks.md"
    )
    options = parser.parse_args(arguments)
    if unknown := [name for name in options.tables if name not in TABLES]:
        parser.error(f"unknown table {', '.join(unknown)}: expected {', '.join(TABLES)}")
    for folder in (options.folder, options.write and Path(options.write).parent):
        if folder is not None and not Path(folder).is_dir():
            parser.error(f"there is no folder {folder}")
    texts = []
    for name in options.tables or TABLES:
        texts.append(import_module(f"benchmarks.{name}").table(options.quick, options.folder))
        print(texts[-1], flush=True)
    if options.write:
        said = "".join(
            f" {word}" for word in (*options.tables, *(["--quick"] if options.quick else []))
        )
        Path(options.write).write_text(
            "\n".join([HEAD.format(arguments=said), *texts]), encoding="utf-8"
        )


if __name__ == "__main__":
    main()
