"""What scripts that compare planners or samplers share: problems and tables."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from mapdata.movement import Movement

if TYPE_CHECKING:
    import pandas as pd

    from mapdata.problems import ProblemSet


def given_problems(
    root: list[str],
    recipe: str | None,
    seed: int | None,
    maps: int | None,
    **how: Any,
) -> ProblemSet:
    """Return one problem a map, of new maps or of the test split of a dataset, or those of a file.

    New maps are those of ``recipe``, a preset's name, a recipe file or its JSON text; those of a
    preset have seed 77 by default. Of a .scen, ``maps`` is the number of problems, all without; of
    another file all are taken.

    Raises:
        ValueError: what would do nothing beside a root or a file; what `ProblemSet.sample`,
            `ProblemSet.read` and `read_problems` refuse.
        DatasetNotFoundError: there is no dataset under ``root``.
    """
    from mapdata.formats import Limits, read_problems
    from mapdata.generators import PRESETS
    from mapdata.problems import ProblemSet

    if not root:
        recipe = recipe or "dungeon"
        if seed is None and recipe in PRESETS:
            seed = 77
        return ProblemSet.sample(recipe, seed, maps, **how)
    is_file = len(root) == 1 and Path(root[0]).suffix.lower() in (".npz", ".scen")
    if recipe is not None or (seed is not None and not is_file):
        raise ValueError("preset, seed: would do nothing beside the root of a dataset")
    if not is_file:
        return ProblemSet.read(root, maps, **how)
    given = {"count": maps, "seed": seed, "until_hard": how.get("until_hard")}
    options = {name: value for name, value in given.items() if value is not None}
    problems = read_problems(root[0], Limits(progress=True), **options)
    if how.get("movement") not in (None, Movement(8), problems.movement):
        raise ValueError(f"{root[0]}: its problems are for {problems.movement}")
    return problems


def check_outputs(*files: str | None) -> None:
    """Refuse a file that could not be written after the work.

    Raises:
        ValueError: its folder does not exist.
    """
    for file in files:
        if file is not None and not Path(file).parent.is_dir():
            raise ValueError(f"{file}: there is no folder {Path(file).parent}")


def write_table(table: pd.DataFrame, csv: str | None, json: str | None) -> None:
    """Write a table to the files that were asked for."""
    if csv is not None:
        table.to_csv(csv, index=False)
    if json is not None:
        table.to_json(json, orient="records", indent=1)
