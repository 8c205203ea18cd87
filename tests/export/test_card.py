"""The card of exported problems: what it says of the columns is true of the rows."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import samples

from mapdata import Movement, OnlineMapDataset
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


@pytest.mark.slow
def test_a_folder_whose_name_is_no_utf8_gets_a_card(tmp_path: Path) -> None:
    """The title has "?" for the byte that is no letter."""
    pytest.importorskip("pyarrow")
    folder = tmp_path / "maps\udcff"
    export_problems(samples.SPEC, folder, format="parquet", count=1, split="val")
    assert "\n# maps?\n" in (folder / "README.md").read_text(encoding="utf-8")


def test_the_card_states_licence_and_limits(tmp_path: Path) -> None:
    """What a track for datasets asks for, as far as the export knows it."""
    pytest.importorskip("pyarrow")
    arguments: dict[str, Any] = {"format": "parquet", "count": 1, "split": "val"}
    export_problems(samples.SPEC, tmp_path / "plain", **arguments)
    bfs = {**arguments, "search": "bfs", "distinct": True, "licence": "cc-by-4.0"}
    export_problems(samples.SPEC, tmp_path / "bfs", **bfs, movement=Movement(8))
    plain, of_bfs = ((tmp_path / name / "README.md").read_text() for name in ("plain", "bfs"))
    assert "## Licence\n\nNone is stated" in plain
    assert "## Licence\n\ncc-by-4.0\n" in of_bfs
    assert "The rule is 4-connected" in plain
    assert "The rule is 8-connected" in of_bfs
    for card in (plain, of_bfs):
        assert "none is the map of a real place" in card
        assert ("fewest moves" in card, "Copies of maps" in card) == (card is of_bfs, card is plain)


def test_the_name_of_the_folder_is_text(tmp_path: Path) -> None:
    """Not Markdown, whatever a stranger called it."""
    pytest.importorskip("pyarrow")
    folder = tmp_path / "a *b* [c](d) <e>"
    export_problems(samples.SPEC, folder, format="parquet", count=1, split="val")
    card = (folder / "README.md").read_text()
    assert "\n# a \\*b\\* \\[c\\](d) &lt;e&gt;\n" in card
    assert "load_dataset('a *b* [c](d) <e>', split=" in card
