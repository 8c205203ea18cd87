"""What the first use of a feature compiles: python -m benchmarks first_uses.

Each use runs in a process of its own, first with an empty kernel cache, then once more with the
kernels in it. The difference of the two is what compiling costs.
"""

from __future__ import annotations

import os
import re
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.measure import Row, each, to_text

PACKAGES = ("mapdata-torch", "numba", "torch")

LOADER = """
from mapdata import *
import mapdata, torch
torch.set_num_threads(1)
def batch(build="paper", fields=("map", "start", "goal", "path"), **options):
    module = MapDataModule(None, build=build, fields=fields, batch_size=16, **options)
    return next(iter(module.train_dataloader()))
"""
"""What the programs of batches begin with."""

README = Path(__file__).parent.parent / "README.md"


def readme_training(sets: int, steps: int) -> str:
    """Return README's second program, which trains on so many sets of maps, so many steps each.

    Raises:
        ValueError: README has no such program any more.
    """
    programs = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    shortened, count = re.subn(
        r"SETS, STEPS = \d+, \d+", f"SETS, STEPS = {sets}, {steps}", programs[1]
    )
    if count != 1:
        raise ValueError("README.md: expected SETS and STEPS once in its second program")
    return shortened


USES: dict[str, str] = {
    "build 100 maps of paper": "import sys, mapdata; from mapdata import MapSpec, build; "
    "build(sys.argv[1], MapSpec(), maps=100, workers=1)",
    "batch of the default problems": LOADER + "batch()",
    "batch of random problems": LOADER + "batch(problems='random')",
    "batch of hard problems and masks": LOADER
    + "batch(problems=Random(hardness=(1.05, None)), movement=Movement(8), "
    "fields=('map', 'start_mask', 'goal_mask', 'optimal_mask'))",
    "batch with optimal_moves": LOADER + "batch(fields=('map', 'optimal_moves'))",
    "batch with cost_to_go": LOADER + "batch(fields=('map', 'cost_to_go'))",
    "batch with waypoints": LOADER + "batch(fields=('map', 'waypoints'))",
    "batch for a robot's radius": LOADER + "batch(problems='random', radius=0.1)",
    "batch of mazes": LOADER + "batch('maze')",
    "batch of random problems on terrain": LOADER + "batch('terrain', problems='random')",
    "batch of tile images": LOADER + "batch('tiles', fields=('map', 'image'))",
    "all classical planners under 8 moves": "from mapdata import *; from mapdata.evaluation import "
    "classical; moves = Movement(8); evaluate(classical(moves), "
    "ProblemSet.sample('paper', seed=1, maps=20, movement=moves))",
    "README's second program, 2 steps": readme_training(1, 2),
    "one path by A*": "import numpy; from mapdata import astar, Movement; "
    "astar(numpy.zeros((9, 9), 'u1'), (0, 0), (8, 8), Movement(8))",
}
"""Programs that use a feature, by what they do."""


def cpu_of(program: str, cache: Path, target: Path) -> float:
    """Return the seconds of processor time that a program takes in a process of its own."""
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache), "NUMBA_CACHE_DIR": str(cache)}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-c", program, str(target)],
        check=True,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def use_row(name: str, folder: Path, repeats: int) -> Row:
    """Return the row of a use: what compiling takes, and what all of the first use takes."""
    compiling, whole = [], []
    for k in range(repeats):
        place = folder / f"{list(USES).index(name)}-{k}"
        place.mkdir()
        cold, warm = (
            cpu_of(USES[name], place / "cache", place / word) for word in ("cold", "warm")
        )
        compiling.append(cold - warm)
        whole.append(cold)
    return Row(name, each(compiling, 1), note=f"of {each(whole, 1)} for the process with imports")


def table(quick: bool, folder: str | None = None) -> str:
    """Return the table in markdown; ``quick`` measures each use once."""
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        rows = [use_row(name, Path(temporary), 1 if quick else 3) for name in USES]
    return to_text(
        "First uses",
        rows,
        packages=PACKAGES,
        notes=(
            "Processor time that compiling takes at the first use of a feature on a machine, from "
            "an empty kernel cache. Later processes find the kernels there.",
        ),
    )
