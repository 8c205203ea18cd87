"""What README.md shows is what happens: its Python, its commands, its recipe, its table of
presets.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from helpers import pages
from helpers.pages import ROOT

from mapdata.cli import build_main
from mapdata.generators import PRESETS, MapSpec
from mapdata.shards import Recipe

PAGE = ROOT / "README.md"
README = PAGE.read_text(encoding="utf-8")
BLOCKS = pages.blocks(PAGE)


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_both_command_lines_stand_at_the_top() -> None:
    """Nothing else is needed, so they come before the first heading."""
    first = "    pip install -c constraints.txt -e . && python scripts/build_shards.py\n"
    second = '    pip install -c constraints.txt -e ".[test]" && pytest\n'
    assert first + second in README.split("\n## ")[0]


def test_every_block_runs() -> None:
    """Python prints the text that follows it, commands run as they stand, and the pictures that are
    named are there.
    """
    shown = pages.run(PAGE)
    commands = [
        line for block in BLOCKS if block.language == "sh" for line in block.text.splitlines()
    ]
    assert {"build", "info", "verify", "show", "report"} <= {line.split()[1] for line in commands}
    assert len(shown) == len(commands)
    for line, printed in zip(commands, shown, strict=True):
        assert ("bit for bit" in printed) == (" build " in line and "--recipe" in line), line
    for picture in ("map7.png", "map.png"):
        assert Path(picture).read_bytes().startswith(b"\x89PNG")


def test_the_script_builds_where_the_readme_says(capsys: pytest.CaptureFixture[str]) -> None:
    """The folder is `data/maps`, and the last line says how to look at it."""
    build_main(["--maps", "3"])
    assert Path("data/maps/manifest.json").is_file()
    assert "mapdata show data/maps --index 2 -o map.png" in capsys.readouterr().out


def test_the_recipe_of_ones_own_is_one() -> None:
    """A recipe needs only what differs from the defaults."""
    (text,) = (block.text for block in BLOCKS if block.language == "json")
    recipe = Recipe.load(text)
    assert (recipe.spec.map_size, recipe.spec.movement.connectivity, recipe.maps) == (
        (48, 96),
        8,
        500,
    )


def test_table_of_presets() -> None:
    """The table has every preset, with its limits."""
    rows = dict(re.findall(r"^\| `(\w+)` \| (\d.*?) \| [^|]*\|$", README, re.MULTILINE))
    assert rows == {
        name: f"{spec.map_size[0]} x {spec.map_size[1]} | {spec.rooms[0]}-{spec.rooms[1]} | "
        f"{spec.room_rows[0]}-{spec.room_rows[1]} | {spec.passage_width[0]}-{spec.passage_width[1]}"
        for name, spec in PRESETS.items()
        if isinstance(spec, MapSpec)
    }
    assert all(
        spec.room_rows == spec.room_columns
        for spec in PRESETS.values()
        if isinstance(spec, MapSpec)
    )


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md"])
def test_files_that_are_named_exist(page: str) -> None:
    """Links and paths lead somewhere; `x.py` stands for any file."""
    text = (ROOT / page).read_text(encoding="utf-8")
    links = [link for link in re.findall(r"\]\(([^)]+)\)", text) if "://" not in link]
    named = re.findall(r"`((?:mapdata|docs|tests|benchmarks|scripts)/[\w./]*)`", text)
    assert [
        name for name in links + named if not name.endswith("x.py") and not (ROOT / name).exists()
    ] == []
