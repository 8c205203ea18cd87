"""The card of exported problems: what it says of the columns is true of the rows."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from helpers import samples

from mapdata import OnlineMapDataset
from mapdata.export import export_problems
from mapdata.export.parquet import table_of

NAMES = {"uint8": "uint8", "int64": "int64", "int32": "int32", "float32": "float"}
"""The types of numpy in the words of Arrow."""


def columns_of(card: str) -> dict[str, str]:
    """Return what a card says of each column."""
    table = card.partition("| column | meaning |\n|---|---|\n")[2].partition("\n\n")[0]
    rows = [line.strip("| ").partition(" | ") for line in table.splitlines()]
    return {name: meaning for name, _, meaning in rows}


def test_columns_have_the_shapes_that_the_card_states(tmp_path: Path) -> None:
    """Neither the batch axis nor the channel axis of 1: as many axes as it says, of this type."""
    pytest.importorskip("pyarrow")
    fields = samples.ALL_FIELDS
    export_problems(samples.SPEC, tmp_path / "out", format="parquet", count=1, fields=fields)
    meanings = columns_of((tmp_path / "out/README.md").read_text())
    batch = OnlineMapDataset(samples.SPEC, 5, 4, None, samples.ALL_FIELDS)[:2]
    table = table_of({name: np.asarray(field) for name, field in batch._asdict().items()})
    assert set(meanings) == set(samples.ALL_FIELDS)
    for name, meaning in meanings.items():
        shape, dtype = re.match(r"(?:\((.*?)\) )?(\w+),? ", meaning).groups()  # type: ignore[union-attr]
        stated = [side for side in (shape or "").split(",") if side.strip()]
        kind = table.schema.field(name).type
        axes = 0
        while "list" in str(kind).partition("<")[0]:
            kind = kind.value_type
            axes += 1
        assert axes == len(stated), name
        assert str(kind) == NAMES[dtype], name


def test_the_name_of_the_folder_is_text(tmp_path: Path) -> None:
    """Not Markdown, whatever a stranger called it."""
    pytest.importorskip("pyarrow")
    folder = tmp_path / "a *b* [c](d) <e>"
    export_problems(samples.SPEC, folder, format="parquet", count=1, split="val")
    card = (folder / "README.md").read_text()
    assert "\n# a \\*b\\* \\[c\\](d) &lt;e&gt;\n" in card
    assert "load_dataset('a *b* [c](d) <e>', split=" in card
