"""What scripts that compare planners or samplers share: problems and tables."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

    from mapdata.problems import Problems


def given_problems(
    root: list[str],
    preset: str | None,
    seed: int | None,
    maps: int | None,
    **how: Any,
) -> Problems:
    """Return one problem a map, of new maps or of the test split of a dataset, or a saved set.

    Raises:
        ValueError: a preset or seed beside a root; what `Problems.sample` and `Problems.read`
            refuse.
        DatasetNotFoundError: there is no dataset under ``root``.
    """
    from mapdata.generators import Generator
    from mapdata.problems import Problems

    if not root:
        return Problems.sample(
            Generator.preset(preset or "dungeon"), 77 if seed is None else seed, maps, **how
        )
    if preset is not None or seed is not None:
        raise ValueError("preset, seed: would do nothing beside the root of a dataset")
    if len(root) == 1 and root[0].endswith(".npz"):
        if maps is not None or how.get("until_hard") is not None:
            raise ValueError("maps, until_hard: would do nothing beside a saved set of problems")
        return Problems.load(root[0])
    return Problems.read(root, maps, **how)


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
