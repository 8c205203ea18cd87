"""The one door to all benchmarks: python -m benchmarks
[labels|paths|graphs|terrain|making|build|first_uses|loading|bands|scale] [--quick].
"""

from __future__ import annotations

import os

if __name__ == "__main__":  # before numpy and torch are imported, which read these
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"

import argparse
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from benchmarks.measure import to_markdown
from mapdata.shards import write_output

TABLES = {
    "labels": "all labels of a map beside naive Python, and how they grow",
    "paths": "A* beside pyastar2d, python-tcod, scipy, scikit-image, networkx, pathfinding",
    "graphs": "labels beside scipy and igraph, with and without their graphs; A* beside cstar and "
    "Warthog",
    "terrain": "goal fields and A* on terrain beside scikit-image and pyastar2d",
    "making": "making maps beside maze-dataset",
    "build": "a dataset on disk beside the kernels alone; the first build ever; imports",
    "first_uses": "what the first use of each feature compiles",
    "loading": "batches beside tensors in RAM, TensorDataset, naive h5py, npz, PNG + CSV, "
    "HF datasets, webdataset, zarr, litdata",
    "bands": "random problems under conditions: how many goals a map gets",
    "scale": "a million maps: build, open, an epoch, two processes, verify, export",
}
PAGE = """# Benchmarks

The command `python -m benchmarks{arguments}` writes this page. The first rows of its tables:

{results}

![{caption}](images/speed.png)

{tables}
## How it is measured

- In each table, mapdata and the other packages run in turns on one machine. The ratios are more
  reliable than the times.
- Times and ratios are medians. All work runs on one thread, unless a row names workers.
- Times are CPU times of the process, which other programs on the machine do not lengthen. Those of
  builds on disk, of first uses and of workers are wall-clock times. Warthog prints its own.
- Where a package has several functions for a table's work, the fastest one counts.
- If another package returns other results than mapdata, the benchmark stops with an error.
- A target is a minimum ratio or rate, or a maximum time, size or growth. Missed targets are
  marked.
- `pip install -e ".[bench]"` (and `maze-dataset "muutils<0.9"`, and `litdata`, whose torchvision
  must fit your torch) installs the other packages. Missing ones are skipped.
- `python -m benchmarks labels paths` writes single tables: {names}. With `--quick` it takes a
  minute or two and is less exact.
"""
CAPTION = (
    "Bar chart: how many times as long other packages take for a path by A* and to load a sample"
)


def results(tables: Sequence[str]) -> str:
    """Return a table of the first row of each of ``tables``."""
    lines = [
        [line for line in table.splitlines() if line.startswith("|")][:3]  # head, rule, first row
        for table in tables
    ]
    rows = [[cell.strip() for cell in first.split("|")[1:-1]] for *_, first in lines]
    head = [cell.strip() for cell in lines[0][0].split("|")[1:-1]]
    return to_markdown([head, *rows])


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables asked for, one after another, and write them as a page with --write."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="Measure mapdata and other packages in turns, on an idle machine.",
        epilog="\n".join(f"{name:10}{what}" for name, what in TABLES.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "tables", nargs="*", metavar="TABLE", help=f"{', '.join(TABLES)} (default: all)"
    )
    parser.add_argument(
        "--quick", action="store_true", help="a small run: it takes minutes and is less exact"
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
        asked = [*options.tables, *(["--quick"] if options.quick else [])]
        page = PAGE.format(
            arguments="".join(f" {word}" for word in asked),
            results=results(texts),
            caption=CAPTION,
            tables="\n".join(texts),
            names=", ".join(TABLES),
        )
        write_output(options.write, page.encode())


if __name__ == "__main__":
    main()
