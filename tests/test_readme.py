"""What README.md shows is what happens: its Python, its commands, its recipe, its table of presets."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from mapdata.build import Recipe
from mapdata.cli import build_main, main
from mapdata.spec import PRESETS

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS: list[tuple[str, str]] = re.findall(r"^```(\w+)\n(.*?)^```$", README, re.DOTALL | re.MULTILINE)
"""Language and text of each code block, in order."""

PYTHON = [k for k, (language, _) in enumerate(BLOCKS) if language == "python"]


def exit_code(arguments: list[str]) -> object:
    """Run ``mapdata`` and return its exit code."""
    try:
        main(arguments)
    except SystemExit as stop:
        return stop.code
    return None


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_both_command_lines_stand_at_the_top() -> None:
    """Nothing else is needed, so they come before the first heading."""
    first = "    pip install -c constraints.txt -e . && python scripts/build_shards.py\n"
    second = '    pip install -c constraints.txt -e ".[test]" && pytest\n'
    assert first + second in README.split("\n## ")[0]


@pytest.mark.parametrize("k", PYTHON)
def test_python_does_what_the_readme_says(k: int, capsys: pytest.CaptureFixture[str]) -> None:
    """A block of Python prints the block of text that follows it, if one does, and leaves the pictures it names."""
    code = BLOCKS[k][1]
    exec(compile(code, "README.md", "exec"), {"__name__": "readme"})
    following = BLOCKS[k + 1] if k + 1 < len(BLOCKS) else ("", "")
    if following[0] == "text":
        assert capsys.readouterr().out == following[1]
    for picture in re.findall(r'savefig\("([^"]+)"', code):
        assert Path(picture).read_bytes().startswith(b"\x89PNG")


def test_the_first_example_is_ten_lines_and_ends_in_a_picture() -> None:
    """One minute of reading, and something to see."""
    lines = [line for line in BLOCKS[PYTHON[0]][1].splitlines() if line]
    assert len(lines) <= 10
    assert "savefig" in lines[-1]


def test_the_script_builds_where_the_readme_says(capsys: pytest.CaptureFixture[str]) -> None:
    """The folder is `data/maps`, and the last line says how to look at it."""
    build_main(["--maps", "3"])
    assert Path("data/maps/manifest.json").is_file()
    assert "mapdata show data/maps --index 2 -o map.png" in capsys.readouterr().out


def test_commands_run_one_after_another(capsys: pytest.CaptureFixture[str]) -> None:
    """From building to rebuilding by a recipe, as they stand."""
    lines = [line for language, block in BLOCKS if language == "sh" for line in block.splitlines()]
    assert {"build", "info", "verify", "show"} <= {line.split()[1] for line in lines}
    for line in lines:
        program, *arguments = shlex.split(line, comments=True)
        output = arguments.pop() if ">" in arguments else None
        assert program == "mapdata"
        assert exit_code([word for word in arguments if word != ">"]) in (None, 0), line
        printed = capsys.readouterr().out
        if output is not None:
            Path(output).write_text(printed, encoding="utf-8")
        if "--recipe" in arguments and "build" in arguments:
            assert "bit for bit" in printed
    assert Path("map.png").read_bytes().startswith(b"\x89PNG")


def test_the_recipe_of_ones_own_is_one() -> None:
    """A recipe needs only what differs from the defaults."""
    (text,) = (block for language, block in BLOCKS if language == "json")
    recipe = Recipe.load(text)
    assert (recipe.spec.map_size, recipe.spec.movement.connectivity, recipe.maps) == ((48, 96), 8, 500)


def test_table_of_presets() -> None:
    """The table has every preset, with its limits."""
    rows = dict(re.findall(r"^\| `(\w+)` \| (\d.*?) \| [^|]*\|$", README, re.MULTILINE))
    assert rows == {
        name: f"{spec.map_size[0]} x {spec.map_size[1]} | {spec.rooms[0]}-{spec.rooms[1]} | "
        f"{spec.room_rows[0]}-{spec.room_rows[1]} | {spec.passage_width[0]}-{spec.passage_width[1]}"
        for name, spec in PRESETS.items()
    }
    assert all(spec.room_rows == spec.room_columns for spec in PRESETS.values())


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md"])
def test_files_that_are_named_exist(page: str) -> None:
    """Links and paths lead somewhere; `x.py` stands for any file."""
    text = (ROOT / page).read_text(encoding="utf-8")
    links = [link for link in re.findall(r"\]\(([^)]+)\)", text) if "://" not in link]
    named = re.findall(r"`((?:mapdata|docs|tests|benchmarks|scripts)/[\w./]*)`", text)
    assert [name for name in links + named if not name.endswith("x.py") and not (ROOT / name).exists()] == []
