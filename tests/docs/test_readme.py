"""README.md and the pages that it leads to first show what happens: commands, recipe, presets."""

from __future__ import annotations

import re
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import matplotlib as mpl
import pytest
import torch
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


GRAPHS = r"labels, (paper|dungeon|cave),"
SINGLE = r"A\*, per (short )?path, (\w+, 64 x 64|64 x 64, single)|A\*, \w+, 64 x 64, . moves"
RIVALS = {
    "all labels of a map, beside scipy's": [
        (GRAPHS, "scipy, searches alone"),
        (GRAPHS, "scipy, with its graphs"),
    ],
    "all labels of a map, beside igraph's": [
        (GRAPHS, "igraph, searches alone"),
        (GRAPHS, "igraph, with its graphs"),
    ],
    "a path by A*, beside pyastar2d": [(SINGLE, "pyastar2d: equal")],
    "a path by A* of many in one call, beside pyastar2d": [
        (r"A\*, per path, 64 x 64, one call", "pyastar2d: equal")
    ],
    "a path by A* on terrain, beside pyastar2d": [
        (r"A\*, per path, 64 x 64", "pyastar2d: another rule")
    ],
    "a path by A*, beside cstar-pathfinding": [(SINGLE, "cstar-pathfinding")],
    "a path by A*, beside Warthog's A*": [(SINGLE, "Warthog, astar")],
    "a path by jump point search of many in one call": [
        (r"jump point search, \w+, 64 x 64", "Warthog, jps2")
    ],
}
"""README's rows: the work and the note of the rows of docs/benchmarks.md that each stands for."""


def range_of(measured: str, moves: int, work: str, note: str) -> str:
    """Return the range of the ratios on the page of benchmarks; an empty text without such rows.

    Args:
        measured: the page.
        moves: 4 or 8. Rows of terrain have 8, and other rows that do not say it have 4.
        work: regular expression of the beginning of the first cell.
        note: beginning of the last cell.
    """
    ratios = []
    for line in measured.splitlines():
        cells = [cell.strip() for cell in line.split("|")[1:-1]]
        if len(cells) != 6 or not re.match(work, cells[0]) or not cells[5].startswith(note):
            continue
        default = "8" if "another rule" in note else "4"
        stated = re.search(r"([48])( moves|-connected)", cells[0])
        if str(moves) == (stated[1] if stated else default):
            ratios.append(float(cells[3].removesuffix("x")))
    return f"{min(ratios):g} to {max(ratios):g}" if ratios else ""


def test_every_path_beside_a_planner_stands_in_a_range() -> None:
    """No row of 64 x 64 cells beside a package that README names is left out."""
    measured = (DOCS / "benchmarks.md").read_text(encoding="utf-8")
    works = [work for each in RIVALS.values() for work, _ in each]
    tables = [[cell.strip() for cell in line.split("|")[1:-1]] for line in measured.splitlines()]
    measured_works = [
        cells[0]
        for cells in tables
        if len(cells) == 6
        and re.match("pyastar2d|cstar|Warthog, astar", cells[5])
        and " 64 x 64" in cells[0]
        and cells[3]
    ]
    assert len(measured_works) > 20
    left_out = [row for row in measured_works if not any(re.match(work, row) for work in works)]
    assert left_out == []


def test_its_numbers_are_those_of_the_benchmarks() -> None:
    """Each range is that of all rows of docs/benchmarks.md, in whatever table, for this work beside
    this package.
    """
    measured = (DOCS / "benchmarks.md").read_text(encoding="utf-8")
    table = README.split("## In numbers")[1].split("## ")[0]
    lines = [line for line in table.splitlines() if line.startswith("| a")]
    assert len(lines) == len(RIVALS)
    for line, (work, words) in zip(lines, RIVALS.items(), strict=True):
        label, *cells = (cell.strip() for cell in line.split("|")[1:-1])
        assert label.startswith(work)
        for moves, cell in zip((4, 8), cells, strict=True):
            ranges = [range_of(measured, moves, *each) for each in words]
            assert cell == "; ".join(filter(None, ranges)), (label, moves)
    fastest, _, _ = range_of(measured, 8, r"A\*, \w+, 64 x 64", "Warthog, jps2").partition(" to ")
    assert f"jump point search takes as little as {fastest} of it" in " ".join(table.split())
    ratio = re.search(r"\| (0\.\d+)x +\|[^|]*\| torch.index_select of problems", measured)
    assert ratio is not None
    assert f"served {1 / float(ratio[1]):.0f} times as fast" in " ".join(table.split())


def test_its_first_block_runs() -> None:
    """It prints the text that follows it, and the picture that it names is there."""
    first, text, *others = pages.blocks(PAGE)
    assert [block.language for block in (first, text, *others)] == [
        "python",
        "text",
        "python",
        "bibtex",
    ]
    with mpl.rc_context({"backend": "Agg"}):
        assert printed_by(first.text) == text.text
    assert Path("batch.png").read_bytes().startswith(b"\x89PNG")


def printed_by(program: str) -> str:
    """Run a program of the page, and return what it prints."""
    output = StringIO()
    threads = torch.get_num_threads()
    try:
        with redirect_stdout(output):
            exec(compile(program, str(PAGE), "exec", dont_inherit=True), {"__name__": PAGE.stem})
    finally:
        torch.set_num_threads(threads)
    return output.getvalue()


def rows_of(printed: str) -> dict[str, tuple[float, float]]:
    """Return the share of optimal paths and the regret of each row of the output, in per cent."""
    row = r"^A\* on (\w+) costs: ([\d.]+)% optimal, regret ([\d.]+)%$"
    found = re.findall(row, printed, re.MULTILINE)
    return {name: (float(optimal), float(regret)) for name, optimal, regret in found}


@pytest.mark.slow
def test_its_program_ends_in_a_table() -> None:
    """It has at most 45 lines. After two steps its rows are those of the page, and those that need
    no network have the page's figures.
    """
    program = pages.shortened(PAGE)[2].text
    assert len(program.splitlines()) <= 45
    rows = rows_of(printed_by(program))
    table = re.findall(r"^\| (\w+) \| (\d.*?) % \| (\d.*?) % \|$", README, re.MULTILINE)
    assert list(rows) == [name for name, _, _ in table] == ["no", "learnt", "true"]
    for name, optimal, regret in (table[0], table[2]):
        assert rows[name] == (float(optimal), float(regret))


@pytest.mark.soak
@pytest.mark.parametrize("seed", [10, 11])
def test_its_program_learns(seed: int) -> None:
    """From other weights, too: 90 % of the paths are optimal. Trainings had 5 % to spare."""
    program = pages.blocks(PAGE)[2].text
    assert program.count("manual_seed(0)") == 1
    rows = rows_of(printed_by(program.replace("manual_seed(0)", f"manual_seed({seed})")))
    optimal, regret = rows["learnt"]
    assert optimal >= 90
    assert regret <= 0.5


@pytest.mark.slow
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
