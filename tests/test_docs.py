"""What docs/loading.md shows runs, one block after another, and its table is the code's."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import samples

from mapdata.fields import FIELDS

PAGE = (Path(__file__).parent.parent / "docs" / "loading.md").read_text(encoding="utf-8")
BLOCKS: list[str] = re.findall(r"^```python\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)


@pytest.mark.filterwarnings("ignore:.*does not have many workers which may be a bottleneck")
@pytest.mark.filterwarnings("ignore:.*isinstance.treespec, LeafSpec.* is deprecated")
@pytest.mark.filterwarnings("ignore:The number of training batches .* is smaller than the logging interval")
def test_every_block_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In an empty folder, in the order of the page; each imports what it uses."""
    monkeypatch.chdir(tmp_path)
    assert len(BLOCKS) > 5
    for k, block in enumerate(BLOCKS):
        exec(compile(block, f"docs/loading.md, block {k}", "exec"), {"__name__": "loading"})
    assert (tmp_path / "data" / "maps" / "manifest.json").is_file()


def test_the_table_of_fields_is_complete() -> None:
    """Each field has a row, each row a field, with the types that the code's docstrings state."""
    table = PAGE.split("## Fields")[1].split("## ")[0]
    rows = re.findall(r"^\| (`.*?) \| \((.*?)\) (\w+) \|", table, re.MULTILINE)
    found = {name: (shape, dtype) for names, shape, dtype in rows for name in re.findall(r"`(\w+)`", names)}
    assert set(found) == set(FIELDS) == set(samples.ALL_FIELDS)
    for name, (shape, dtype) in found.items():
        assert f"({shape}) {dtype}" in (FIELDS[name].__doc__ or ""), name


def test_files_and_functions_that_are_named_exist() -> None:
    """Links inside the repository lead somewhere."""
    links = [link for link in re.findall(r"\]\(([^)]+)\)", PAGE) if "://" not in link]
    assert [link for link in links if not (Path(__file__).parent.parent / "docs" / link).exists()] == []
