"""README.md and the pages that it leads to first show what happens: commands, recipe, presets."""

from __future__ import annotations

import re
from pathlib import Path

import matplotlib as mpl
import pytest
from helpers import pages
from helpers.pages import DOCS, ROOT

from mapdata.cli import build_main
from mapdata.generators import PRESETS, MapSpec, as_recipe

PAGE = ROOT / "README.md"
README = PAGE.read_text(encoding="utf-8")
COMMAND = DOCS / "command.md"
BLOCKS = pages.blocks(COMMAND)


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_both_command_lines_stand_at_the_top() -> None:
    """With a virtual environment nothing else is needed, so they come before the first heading."""
    environment = "    python3 -m venv .venv && . .venv/bin/activate\n"
    first = "    pip install -c constraints.txt -e . && python scripts/build_shards.py\n"
    second = '    pip install -c constraints.txt -e ".[test]" && pytest -n 2\n'
    assert environment + first + second in README.split("\n## ")[0]


def test_its_numbers_are_those_of_the_benchmarks() -> None:
    """Each range goes from the smallest to the largest ratio of the rows of docs/benchmarks.md."""
    measured = (DOCS / "benchmarks.md").read_text(encoding="utf-8")
    title = "\n## Beside graph libraries and planners in C++\n"
    section = measured.split(title)[1].split("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("|")]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]

    def said(moves: int, *words: str) -> str:
        ratios = [
            float(ratio.removesuffix("x"))
            for work, _, _, ratio, _, note in rows
            if f", {moves} moves" in work
            and "512" not in work
            and all(word in f"{work}; {note}" for word in words)
        ]
        assert ratios, words
        return f"{min(ratios):g} to {max(ratios):g}"

    table = README.split("## In numbers")[1].split("## ")[0]
    for library in ("scipy", "igraph"):
        (line,) = (line for line in table.splitlines() if f"beside {library}'s" in line)
        cells = [
            f"{said(moves, library, 'searches alone')}; {said(moves, library, 'with its graphs')}"
            for moves in (4, 8)
        ]
        assert [cell.strip() for cell in line.split("|")[2:4]] == cells
    for planner, moves in (("pyastar2d", (4, 8)), ("cstar-pathfinding", (8,)), ("Warthog", (4, 8))):
        (line,) = (line for line in table.splitlines() if f"beside {planner}" in line)
        words = (planner, "astar") if planner == "Warthog" else (planner,)
        cells = [said(k, *words) if k in moves else "" for k in (4, 8)]
        assert [cell.strip() for cell in line.split("|")[2:4]] == cells
    fastest, _, _ = said(8, "jps2").partition(" to ")
    assert f"jump point search takes as little as {fastest} of it" in " ".join(table.split())
    ratio = re.search(r"\| (0\.\d+)x +\|[^|]*\| torch.index_select of problems", measured)
    assert ratio is not None
    assert f"served {1 / float(ratio[1]):.0f} times as fast" in " ".join(table.split())


def test_its_python_runs() -> None:
    """It prints the text that follows it, and the picture that it names is there."""
    assert [block.language for block in pages.blocks(PAGE)] == ["python", "text", "bibtex"]
    with mpl.rc_context({"backend": "Agg"}):
        pages.run(PAGE)
    assert "for map, start, goal, optimal in" in README
    assert Path("batch.png").read_bytes().startswith(b"\x89PNG")


def test_every_command_runs() -> None:
    """As they stand, and the picture that one names is there."""
    shown = pages.run(COMMAND)
    commands = [
        line for block in BLOCKS if block.language == "sh" for line in block.text.splitlines()
    ]
    assert {"build", "info", "verify", "show", "report"} <= {line.split()[1] for line in commands}
    assert len(shown) == len(commands)
    for line, printed in zip(commands, shown, strict=True):
        assert ("bit for bit" in printed) == (" build " in line and "--recipe" in line), line
    assert Path("map.png").read_bytes().startswith(b"\x89PNG")


def test_the_script_builds_where_the_readme_says(capsys: pytest.CaptureFixture[str]) -> None:
    """The folder is `data/maps`, and the last line says how to look at it."""
    build_main(["--maps", "3"])
    assert Path("data/maps/manifest.json").is_file()
    assert "mapdata show data/maps --index 2 -o map.png" in capsys.readouterr().out


def test_the_recipe_of_ones_own_is_one() -> None:
    """A recipe needs only what differs from the defaults."""
    (text,) = (block.text for block in BLOCKS if block.language == "json")
    recipe = as_recipe(text)
    assert (recipe.generator.map_size, recipe.generator.movement.connectivity, recipe.maps) == (
        (48, 96),
        8,
        500,
    )


def test_table_of_presets() -> None:
    """The table has every preset, with its limits."""
    page = (DOCS / "words.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `(\w+)` \| (\d.*?) \| [^|]*\|$", page, re.MULTILINE))
    expected = {}
    for name, generator in PRESETS.items():
        if isinstance(generator, MapSpec):
            rows_and_columns = " x ".join(map(str, generator.map_size))
            ranges = (generator.rooms, generator.room_rows, generator.passage_width)
            texts = [f"{low}-{high}" for low, high in ranges]
            expected[name] = " | ".join([rows_and_columns, *texts])
    assert rows == expected
    assert all(
        generator.room_rows == generator.room_columns
        for generator in PRESETS.values()
        if isinstance(generator, MapSpec)
    )


@pytest.mark.parametrize(
    "page", ["README.md", "CONTRIBUTING.md", "docs/words.md", "docs/command.md", "docs/layout.md"]
)
def test_files_that_are_named_exist(page: str) -> None:
    """Links, pictures and paths lead somewhere; `x.py` stands for any file."""
    text = (ROOT / page).read_text(encoding="utf-8")
    links = [link for link in re.findall(r"\]\(([^)]+)\)", text) if "://" not in link]
    links += re.findall(r'(?:src|srcset)="([^"]+)"', text)
    named = re.findall(r"`((?:mapdata|docs|tests|benchmarks|scripts)/[\w./]*)`", text)
    places = [(ROOT / page).parent / link.split("#")[0] for link in links]
    places += [ROOT / name for name in named if not name.endswith("x.py")]
    assert [place for place in places if not place.exists()] == []
