"""Problems and tables for the scripts that compare planners or samplers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from mapdata.movement import Movement

if TYPE_CHECKING:
    import pandas as pd

    from mapdata.problems import ProblemSet


def load_problems(
    root: list[str],
    recipe: str | None,
    seed: int | None,
    maps: int | None,
    **sampling_options: Any,
) -> ProblemSet:
    """Return the problems that a script compares planners on, one for each map unless from a file.

    Args:
        root: empty for new maps; datasets, whose test split is taken; or a file of problems.
        recipe: of new maps: a preset's name, a recipe file or its JSON text; default "dungeon".
        seed: of new maps and their problems; for a preset the default is 77. For datasets, of
            their problems; for a file of planning-datasets, of the starts.
        maps: number of maps; for a .scen the maximal number of its problems, by default all.
        **sampling_options: those of `ProblemSet.sample` and `ProblemSet.read`, such as
            ``movement``.

    Raises:
        ValueError: options that would do nothing with a root or a file; what `ProblemSet.sample`,
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
        return ProblemSet.sample(recipe, seed, maps, **sampling_options)
    is_file = len(root) == 1 and Path(root[0]).suffix.lower() in (".npy", ".npz", ".scen")
    if recipe is not None:
        raise ValueError("preset: has no effect on problems of a dataset, leave it out")
    if not is_file:
        return ProblemSet.read(root, maps, seed=seed, **sampling_options)
    # A file that does not know one of these options refuses it, so only those in use are passed.
    for name in ("problems", "split", "radius"):
        if name in sampling_options and Path(root[0]).exists():
            flag = "--per-map" if name == "problems" else f"--{name}"
            raise ValueError(f"{flag}: does nothing for {root[0]}, a file with its own problems")
    file_options = {"count": maps, "seed": seed, "until_hard": sampling_options.get("until_hard")}
    options_in_use: dict[str, Any] = {
        name: option for name, option in file_options.items() if option is not None
    }
    problems = read_problems(root[0], Limits(progress=True), **options_in_use)
    # The flags' default, 8-connected, does not mean that the user asked for this movement.
    if sampling_options.get("movement") not in (None, Movement(8), problems.movement):
        raise ValueError(f"{root[0]}: its problems are for {problems.movement}")
    return problems


def check_outputs(*files: str | None) -> None:
    """Check, before the work begins, that the folders of output files exist.

    Args:
        files: names of files; None for a file that is not to be written.

    Raises:
        ValueError: a folder does not exist.
    """
    for file in files:
        if file is not None and not Path(file).parent.is_dir():
            raise ValueError(f"{file}: there is no folder {Path(file).parent}")


def write_table(table: pd.DataFrame, csv: str | None, json: str | None) -> None:
    """Write a table as a CSV file, a JSON file or both; None for a file that is not wanted.

    Raises:
        OSError: the disk is full or may not be written to. The message names the file, which stays
            as it was.
    """
    from mapdata.shards import write_output

    if csv is not None:
        write_output(csv, table.to_csv(index=False).encode())
    if json is not None:
        write_output(json, table.to_json(orient="records", indent=1).encode())
