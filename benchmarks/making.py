"""Making maps beside maze-dataset, the nearest maker of mazes to learn from: python -m benchmarks
making.

Not the same maps: its mazes are a random depth-first tree, one cell wide, with one path each; ours
are rooms and
passages with all labels. Both sides make grids of about the same side and solve them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module

from benchmarks.measure import Peer, Row, each, interleaved, median_ratio, to_text
from mapdata import Labels, MapSpec, generate, label

PACKAGES = ("mapdata-torch", "numpy", "numba")
PEER = Peer(
    "maze-dataset",
    "maze-dataset",
    "maze_dataset",
    "MazeDataset.from_config(MazeDatasetConfig(grid_n=32, gen_dfs))",
)


def maps(generator: MapSpec, count: int) -> Labels:
    """Make ``count`` maps of a spec with all labels."""
    return label(generate(generator, 0, range(count)))


def mazes(count: int) -> int:
    """Make ``count`` mazes of 32 x 32 cells, 65 x 65 with their walls, each with a path; return how
    many came.
    """
    module = PEER.load()
    makers = import_module("maze_dataset.generation").LatticeMazeGenerators
    config = module.MazeDatasetConfig(
        name="benchmark", grid_n=32, n_mazes=count, maze_ctor=makers.gen_dfs
    )
    return len(
        module.MazeDataset.from_config(
            config, do_download=False, load_local=False, save_local=False
        )
    )


def table(quick: bool, parent: str | None = None) -> str:
    """Measure, and return the table; nothing is written."""
    rounds, ours, theirs = (3, 1000, 20) if quick else (9, 10_000, 100)
    specs = {name: MapSpec.preset(name) for name in ("paper", "dungeon")}
    contestants: dict[str, Callable[[], object]] = {
        name: partial(maps, specs[name], ours) for name in specs
    }
    if not PEER.absence:
        contestants["mazes"] = partial(mazes, theirs)
    times = interleaved(contestants, rounds)
    rows = []
    for name in specs:
        row = Row(f"a map of preset {name}, 64 x 64, all labels", each(times[name], ours))
        if not PEER.absence:
            ratio = median_ratio(times["mazes"], times[name]) * ours / theirs
            note = f"{PEER.name}: a maze of 65 x 65 with one path; {ours:,} maps, {theirs:,} mazes"
            row = row._replace(
                other=each(times["mazes"], theirs), ratio=f"{ratio:,.0f}x", note=note
            )
        rows.append(row if not PEER.absence else row._replace(note=f"{PEER.name}: skipped"))
    notes = (
        f"{rounds} repeats; the packages make different maps, so the table compares only times",
    )
    return to_text("Making maps", rows, packages=PACKAGES, notes=notes, peers=[PEER])
