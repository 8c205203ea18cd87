"""The examples of CONTRIBUTING.md work as they stand there, and leave no family, field or format
behind.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from helpers import pages
from helpers.pages import ROOT

from mapdata import MapDataset, build, formats
from mapdata.datasets import FIELDS
from mapdata.formats.registry import FORMATS
from mapdata.generators.generator import GENERATORS


def test_the_examples_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The family is built and served with the field, the format reads a file, and the planner is in
    a table.
    """
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "contributing"}
    texts = [block.text for block in pages.blocks(ROOT / "CONTRIBUTING.md")]
    texts[-1] = texts[-1].replace("\nevaluate(", "\ntable = evaluate(")
    with ExitStack() as stack:
        for registry in (FIELDS, FORMATS, GENERATORS):
            stack.enter_context(patch.dict(registry))
        for text in texts:
            exec(compile(text, "CONTRIBUTING.md", "exec", dont_inherit=True), names)
        build("halls", names["Halls"](), maps=20)
        batch = MapDataset("halls", fields=("map", "free_share"))[:8]
        assert not batch.map[:, :, 20:44, 20:44].any()
        assert batch.free_share.tolist() == pytest.approx(
            (1 - batch.map.float().mean(dim=(1, 2, 3))).tolist()
        )
        Path("door.digits").write_text("00100\n00000\n")
        assert formats.read_any("door.digits").maps[0].grid.sum() == 1
    assert names["table"]["opt"][0] == 1
