"""What docs/scale.md shows: its plan follows from its rates, its sizes are real, its scripts are
what they say.
"""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path

import numba
import pytest
import yaml
from helpers.builds import stamps
from helpers.examples import slow

from mapdata import build
from mapdata.cli import main
from mapdata.shards import read_manifest

PAGE = (Path(__file__).parents[2] / "docs" / "scale.md").read_text(encoding="utf-8")
BLOCKS: list[tuple[str, str]] = re.findall(r"^```(\w+)\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
RATES = {
    name: (int(rate.replace(",", "")), int(size.replace(",", "")))
    for name, rate, size in re.findall(
        r"^\| `(\w+)` \| ([\d,]+) \| ([\d,]+) \|$", PAGE, re.MULTILINE
    )
}


def test_the_plan_follows_from_the_rates() -> None:
    """Core hours, minutes, bytes and files of each row are computed from the table above it."""
    rows = re.findall(
        r"^\| 10\^(\d) \| `(\w+)` \| (.*) \| (.*) \| (.*) GB \| (.*) \| (.*) \|$",
        PAGE,
        re.MULTILINE,
    )
    assert len(rows) == 6
    for power, name, hours, minutes, size, shard, files in rows:
        maps, (rate, each) = 10 ** int(power), RATES[name]
        assert hours == f"{maps / rate / 3600:.1f}"
        assert minutes == f"{maps / rate / 60 / 100:.1f}"
        assert size == f"{maps * each / 1e9:,.0f}"
        assert files == f"{maps // int(shard.replace(',', '')):,}"


@pytest.mark.parametrize("name", [slow(name) if name != "paper" else name for name in RATES])
def test_a_map_has_so_many_bytes(name: str, tmp_path: Path) -> None:
    """A real build agrees, within a twentieth."""
    maps = 100 if name == "dungeon128" else 1000
    manifest = build(tmp_path / "maps", name, maps=maps)
    assert sum(entry.bytes for entry in manifest.shards) / maps == pytest.approx(
        RATES[name][1], rel=0.05
    )


def commands() -> list[list[str]]:
    """Return the commands that build a part, as the shell splits them."""
    return [
        shlex.split(line.strip(" -"))
        for line in PAGE.splitlines()
        if "mapdata build" in line and "--part $" in line
    ]


@pytest.mark.parametrize("k", range(2))
def test_parts_of_the_page_make_the_whole(k: int, tmp_path: Path) -> None:
    """The commands of the SLURM script and of the indexed job, with fewer maps, from the first part
    to the last.
    """
    program, verb, _, *flags = commands()[k]
    assert (program, verb) == ("mapdata", "build")
    values = dict(zip(flags[::2], flags[1::2], strict=True)) | {
        "--maps": "20",
        "--shard-size": "10",
    }
    variable, count = values.pop("--part").split("/")
    assert (variable, count) == (("$SLURM_ARRAY_TASK_ID", "$JOB_COMPLETION_INDEX")[k], "100")
    root, others = str(tmp_path / "maps"), [text for flag in values.items() for text in flag]
    for part in (99, 1, 0):
        main([verb, root, *others, "--part", f"{part}/{count}"])
    assert read_manifest(tmp_path / "maps").complete
    assert len(stamps(tmp_path / "maps")) == 2


def test_the_scripts_are_sound() -> None:
    """As many parts as jobs, numbered from 0; the shell and YAML can read them."""
    slurm = next(block for _, block in BLOCKS if "#SBATCH" in block)
    assert "--array=0-99\n" in slurm
    for language, block in BLOCKS:
        if language == "sh":
            subprocess.run(["bash", "-n"], input=block, text=True, check=True)
        elif language == "python":
            compile(block, "docs/scale.md", "exec")
    (job,) = (yaml.safe_load(block) for language, block in BLOCKS if language == "yaml")
    assert (job["spec"]["completionMode"], job["spec"]["completions"]) == ("Indexed", 100)


def test_the_lines_of_the_image_are_sound() -> None:
    """Numba knows the settings; the shell and Python can read the commands."""
    ((setting, serve, clean),) = (
        block.splitlines() for language, block in BLOCKS if language == "dockerfile"
    )
    names = re.findall(r"NUMBA_(\w+)=", setting)
    assert len(names) == 3
    assert [name for name in names if name not in vars(numba.config)] == []
    subprocess.run(["bash", "-n"], input=clean.removeprefix("RUN "), text=True, check=True)
    _, _, _, program = shlex.split(serve)
    compile(program, "docs/scale.md", "exec")


@pytest.mark.parametrize("part", ["1", "3/3", "-1/3", "a/b", "1/0"])
def test_parts_that_cannot_be(
    part: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line that says how they are counted."""
    with pytest.raises(SystemExit, match="2"):
        main(["build", str(tmp_path / "maps"), f"--part={part}"])
    assert "expected K/N with K from 0 to N - 1" in capsys.readouterr().err
