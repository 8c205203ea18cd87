"""The command line: every verb, exit codes 0, 1 and 2, one line for every bad input, recipes,
pictures, imports.
"""

from __future__ import annotations

import io
import json
import os
import re
import shlex
import shutil
import socket
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from helpers.builds import (
    MAPS,
    SEED,
    SIZE,
    SPEC,
    Built,
    shard_name,
    stamps,
    unprivileged_folder,
)
from helpers.examples import slow
from helpers.families import KNOWN, forget, write_module

import mapdata
from mapdata import MapDataset, MapSpec, Maze, Movement, ProblemSet, Random, build, read_shard
from mapdata.cli import app as cli
from mapdata.cli.export import problems_of_flags
from mapdata.export import export_problems
from mapdata.generators import PRESETS, Cave, Terrain
from mapdata.generators.generator import _presets
from mapdata.shards import MANIFEST, cluster, read_manifest

HOME = Path(__file__).parents[2]
PNG = b"\x89PNG\r\n\x1a\n"


class Outcome(NamedTuple):
    """What a command did."""

    code: int
    out: str
    err: str


class Command:
    """Runs ``mapdata`` in this process."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        """Keep what captures the output."""
        self.capsys = capsys

    def __call__(self, *arguments: object) -> Outcome:
        """Run it with these arguments."""
        self.capsys.readouterr()
        code: object = 0
        try:
            cli.main([str(argument) for argument in arguments])
        except SystemExit as error:
            code = error.code or 0
        assert isinstance(code, int)
        out, err = self.capsys.readouterr()
        # Whether the first use of a kernel is told depends on how long it compiles.
        told = [line for line in err.splitlines(True) if not line.startswith("compiling kernels")]
        return Outcome(code, out, "".join(told))

    def refused(self, code: int, message: str, *arguments: object) -> None:
        """Run it and check that it ends with this code and one line that says this."""
        outcome = self(*arguments)
        assert outcome.code == code, outcome
        assert re.search(message, outcome.err), outcome.err
        assert outcome.err.startswith("mapdata: ")
        assert outcome.err.count("\n") == 1
        assert outcome.out == ""


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Command:
    """Give the command."""
    return Command(capsys)


@pytest.fixture(scope="module")
def dataset(built: Built) -> Path:
    """Give a finished dataset; tests leave it as it is."""
    return built(SPEC, maps=MAPS, seed=SEED, shard_size=SIZE)


@pytest.fixture
def copied(dataset: Path, tmp_path: Path) -> Path:
    """Give a copy of the dataset to damage."""
    return Path(shutil.copytree(dataset, tmp_path / "maps"))


def recipe_file(folder: Path, **values: object) -> Path:
    """Write a recipe."""
    path = folder / "recipe.json"
    path.write_text(json.dumps(values), encoding="utf-8")
    return path


def spec_file(folder: Path, **values: object) -> Path:
    """Write a recipe of the tests' spec with some other values."""
    return recipe_file(folder, spec=SPEC.to_dict() | values, seed=SEED, maps=MAPS)


# --- every verb ---------------------------------------------------------------------------------


def test_build_and_info_print_the_same_summary(run: Command, tmp_path: Path) -> None:
    """Build makes the dataset, shows a bar and ends with the summary; info omits only the rate."""
    root = tmp_path / "maps"
    built = run(
        "build",
        root,
        "--preset",
        "narrow",
        "--maps",
        6,
        "--seed",
        3,
        "--shard-size",
        4,
        "--workers",
        2,
    )
    assert built.code == 0
    assert "6/6" in built.err
    manifest = read_manifest(root)
    assert (manifest.generator, manifest.seed, manifest.maps) == (MapSpec.preset("narrow"), 3, 6)
    assert manifest.complete
    for text in (
        "6 of 64 x 64 cells in 2 shards",
        "maps/s",
        " MB, ",
        str(manifest.identity),
        manifest.content_hash,
    ):
        assert text in built.out
    for name in ("drawn passages", "reachable segments", "fully connected maps"):
        assert re.search(rf"{name}: +\d+\.\d%", built.out)
    look = re.search(r"mapdata show (.*) --index (\d+) -o map.png", built.out)
    assert look is not None
    assert (look[1], look[2]) == (str(root), "5")
    info = run("info", root)
    assert (info.code, info.err) == (0, "")
    assert info.out == "".join(
        line for line in built.out.splitlines(keepends=True) if not line.startswith("rate")
    )


def test_info_names_the_generator_the_seed_and_the_rules(run: Command, tmp_path: Path) -> None:
    """The preset if the parameters are its own, else the family with all of its parameters."""
    movement = Movement(8, corner_cutting=True)
    dungeon = MapSpec.preset("dungeon")
    maze = Maze((30, 30), corridor=2, reopened=0.1, resolution=0.05, movement=movement)
    expected = {
        dungeon: [
            "generator:            preset dungeon",
            "seed:                 9223372036854775808",
            "movement:             4-connected: north, east, south, west, each at cost 1",
            "resolution:           0.1 m per cell",
        ],
        maze: [
            "generator:            family maze, corridor 2, wall 1, reopened 0.1, seed_points 5",
            "seed:                 9223372036854775808",
            "movement:             8-connected: straight steps at cost 1, diagonal steps at cost "
            "sqrt 2, unrestricted",
            "resolution:           0.05 m per cell",
        ],
    }
    for generator, lines in expected.items():
        root = tmp_path / generator.name
        build(root, generator, maps=2, seed=2**63, workers=1)
        assert run("info", root).out.splitlines()[1:5] == lines


def test_info_prints_the_card(run: Command, dataset: Path, tmp_path: Path) -> None:
    """``--card -`` is the standard output, as in other programs; no file has this name."""
    assert run("info", dataset, "--card", tmp_path / "card.md").code == 0
    printed = run("info", dataset, "--card", "-")
    assert printed.code == 0
    assert printed.out == (tmp_path / "card.md").read_text(encoding="utf-8")
    assert not Path("-").exists()


def test_an_output_that_cannot_be_written_is_refused_before_the_work(
    run: Command, dataset: Path, tmp_path: Path
) -> None:
    """No bar of progress is shown, and the message names the file that the user asked for."""
    target = tmp_path / "none" / "out.png"
    for verb, flag in (("report", "-o"), ("show", "-o"), ("info", "--card")):
        message = f"{target}: cannot be written, the folder {target.parent} does not exist$"
        run.refused(2, f"^mapdata: {message}", verb, dataset, flag, target)
        message = f"{tmp_path}: is a folder, expected the name of a file$"
        run.refused(2, f"^mapdata: {message}", verb, dataset, flag, tmp_path)
    for verb in ("report", "show"):
        run.refused(2, "^mapdata: -: cannot be written to the standard", verb, dataset, "-o", "-")


def test_build_extends_a_dataset(run: Command, tmp_path: Path) -> None:
    """The same command again builds nothing, and with more maps it builds the missing ones."""
    root = tmp_path / "maps"
    assert run("build", root, "--maps", 4, "--shard-size", 2).code == 0
    before = stamps(root)
    assert run("build", root, "--maps", 4, "--shard-size", 2).code == 0
    assert stamps(root) == before
    assert run("build", root, "--maps", 6, "--shard-size", 2).code == 0
    assert {name: stamps(root)[name] for name in before} == before
    assert len(read_manifest(root).shards) == 3


def test_info_prints_what_the_problems_are_worth(run: Command, dataset: Path) -> None:
    """Of the problems, movement, split and radius that the flags name."""
    printed = run("info", dataset, "--problems")
    statistics = MapDataset(dataset).problem_statistics()
    assert printed.out == f"{statistics!r}\n\n{statistics.target_text()}\n"
    source = '{"random": {"hardness": [1.05, null]}}'
    served = MapDataset(
        dataset, "train", problems=source, movement=Movement(8, True, 1), radius=0.05
    )
    rule = ("--connectivity", 8, "--corner-cutting", "--diagonal-cost", 1)
    printed = run(
        "info", dataset, "--problems", source, "--split", "train", "--radius", 0.05, *rule
    )
    assert printed.out.startswith(f"{served.problem_statistics()!r}\n")
    assert f"{source}; 8-connected" in printed.out
    run.refused(2, "need --problems", "info", dataset, "--split", "train")
    run.refused(2, "need --problems", "info", dataset, "--radius", 0.1)
    run.refused(2, "need --problems", "info", dataset, "--connectivity", 8)
    run.refused(2, "--recipe", "info", dataset, "--recipe", "--problems")
    run.refused(2, "problems: got 'routes'", "info", dataset, "--problems", "routes")


def test_flags_of_bands_add_to_random_problems() -> None:
    """Also to those of a JSON text, unless it has a band of the same name."""
    bands = {"distance": "10:", "hardness": None, "length": ":40"}
    asked_for = Random((10, None), None, (None, 40))
    assert problems_of_flags("route", dict.fromkeys(bands)) == "route"
    for problems in (None, "random", '{"random": {}}'):
        assert problems_of_flags(problems, bands) == asked_for
    several = problems_of_flags('{"random": {"per_map": 3, "hardness": [1.2, null]}}', bands)
    assert several == replace(asked_for, per_map=3, hardness=(1.2, None))
    for problems, says in (
        ("route", "--distance, --length: only for random problems, got --problems route"),
        ('{"random": {"length": [3, 9]}}', "--length: --problems has a band of this name, too"),
    ):
        with pytest.raises(ValueError, match=says):
            problems_of_flags(problems, bands)


@pytest.mark.parametrize("text", ["5", "5,10", "a:b", "9:5", "nan:", ":-1", "1:2:3"])
def test_what_is_no_band_is_refused(text: str) -> None:
    """A band is two numbers in order, of which either may be left out."""
    with pytest.raises(ValueError, match=f"--length: got '{text}', expected MIN:MAX with MIN"):
        problems_of_flags(None, {"length": text})


def test_build_takes_a_movement(run: Command, tmp_path: Path) -> None:
    """That of the stored paths, which the recipe has, too."""
    flags = ["--connectivity", 8, "--corner-cutting", "--diagonal-cost", 1]
    assert run("build", tmp_path / "maps", "--preset", "maze", "--maps", 2, *flags).code == 0
    manifest = read_manifest(tmp_path / "maps")
    assert manifest.movement == Movement(8, corner_cutting=True, diagonal_cost=1)
    assert manifest.generator == replace(PRESETS["maze"], movement=manifest.movement)


def test_a_part_says_that_the_dataset_is_not_finished(run: Command, tmp_path: Path) -> None:
    """Its content hash is not the one of the recipe, and another one after each part."""
    arguments = ["build", tmp_path / "maps", "--maps", 5, "--shard-size", 1]
    first = run(*arguments, "--part", "0/2").out
    assert "part 1 of 2: 3 shards of 5\n" in first
    assert re.search(
        r"content hash: +of the finished dataset only; these 3 maps: [0-9a-f]{64}", first
    )
    second = run(*arguments, "--part", "1/2").out
    assert "part 2 of 2: 2 shards of 5\n" in second
    content_hash = read_manifest(tmp_path / "maps").content_hash
    assert re.search(f"content hash: +{content_hash}\n", second)
    assert "part " not in run(*arguments).out


def test_show_understands_a_number_of_a_map(run: Command, dataset: Path) -> None:
    """As the last argument, where it is no folder."""
    run.refused(2, "7: no dataset; did you mean --index 7\\?", "show", dataset, 7)


def test_a_dead_scheduler_is_named_before_it_is_sought(
    run: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask is silent for most of a minute before it fails."""

    def gives_up(scheduler: str) -> None:
        raise OSError(f"{scheduler}: nobody answers")

    monkeypatch.setattr(cluster, "dask_executor", gives_up)
    outcome = run("build", tmp_path / "maps", "--scheduler", "tcp://127.0.0.1:1")
    assert outcome.err.splitlines() == [
        "connecting to tcp://127.0.0.1:1 ...",
        "mapdata: tcp://127.0.0.1:1: nobody answers",
    ]


def test_conditions_that_no_map_meets_are_printed_as_they_are_given(
    run: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not as an object of Python."""
    monkeypatch.setattr("mapdata.problems.substitutes.MAX_CELLS", 32 * 225 * 30)
    arguments = ["--format", "arrays", "--split", "val", "--count", 1, "--length", "200:"]
    outcome = run("export", "maze15", tmp_path / "out", *arguments)
    assert outcome.code == 2
    message = 'problems: got {"random": {"length": [200.0, null]}}: none on one map after another'
    assert message in outcome.err.splitlines()[-1]


def test_info_says_that_a_dataset_is_not_finished(run: Command, copied: Path) -> None:
    """The build was stopped before all maps were written."""
    manifest = read_manifest(copied)
    (copied / MANIFEST).write_text(
        replace(manifest, shards=manifest.shards[:1]).to_json(), encoding="utf-8"
    )
    assert f"{SIZE} of 16 x 70 cells in 1 shard" in run("info", copied).out
    assert f"(of {MAPS}: not finished)" in run("info", copied).out
    (copied / MANIFEST).write_text(replace(manifest, shards=()).to_json(), encoding="utf-8")
    assert run("info", copied).code == 0


def test_verify_accepts_a_sound_dataset(run: Command, dataset: Path) -> None:
    """It prints one line, and the exit code is 0."""
    outcome = run("verify", dataset)
    assert (outcome.code, outcome.out) == (0, f"{dataset}: no faults found\n")


def test_verify_names_every_damaged_file(run: Command, copied: Path) -> None:
    """It prints a line for each file, and the exit code is 1."""
    (copied / shard_name(0, 4)).unlink()
    image = bytearray((copied / shard_name(8, 11)).read_bytes())
    image[len(image) // 2] ^= 1
    (copied / shard_name(8, 11)).write_bytes(image)
    outcome = run("verify", copied)
    assert outcome.code == 1
    assert [line.split(": ")[0] for line in outcome.out.splitlines()] == [
        str(copied / shard_name(0, 4)),
        str(copied / shard_name(8, 11)),
    ]
    assert (
        outcome.err.splitlines()[-1]
        == "mapdata: 2 faults found; --repair builds shards again if there is a recipe"
    )


@pytest.mark.parametrize("index", [slow(0), 3, slow(4), slow(MAPS - 1)])
def test_show_writes_a_picture(index: int, run: Command, dataset: Path, tmp_path: Path) -> None:
    """The picture is a PNG of the map that ``--index`` names."""
    outcome = run("show", dataset, "--index", index, "-o", tmp_path / "map.png")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out == f"wrote {tmp_path / 'map.png'}\n"
    assert (tmp_path / "map.png").read_bytes().startswith(PNG)


@pytest.mark.parametrize(
    "arguments",
    [slow(["report", "-o"]), ["info", "--card"], slow(["show", "--figure", "gallery", "-o"])],
)
def test_verbs_that_read_all_maps_show_a_bar(
    arguments: list[str], run: Command, dataset: Path, tmp_path: Path
) -> None:
    """With a million maps they take minutes."""
    verb, *flags = arguments
    outcome = run(verb, dataset, *flags, tmp_path / "out.png")
    assert outcome.code == 0
    assert f"{MAPS}/{MAPS}" in outcome.err


@pytest.mark.slow
@pytest.mark.parametrize("flags", [("report", "-o"), ("info", "--card")], ids=["report", "card"])
def test_output_is_written_through_links_and_devices(
    flags: tuple[str, str], run: Command, dataset: Path, tmp_path: Path
) -> None:
    """A link is followed, and a device is written to; neither is replaced by a file."""
    verb, flag = flags
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_text("old")
    link.symlink_to(target)
    assert run(verb, dataset, flag, link).code == 0
    assert link.is_symlink()
    assert target.read_bytes() not in (b"old", b"")
    pipe, to_pipe = tmp_path / "pipe", tmp_path / "to_pipe"
    os.mkfifo(pipe)
    to_pipe.symlink_to(pipe)
    for name in (pipe, to_pipe):
        came: list[bytes] = []
        reader = threading.Thread(target=lambda: came.append(pipe.read_bytes()), daemon=True)  # noqa: B023
        reader.start()
        assert run(verb, dataset, flag, name).code == 0
        reader.join(timeout=60)
        assert len(came[0]) > 100
        assert pipe.is_fifo()
    ends = os.pipe()  # as `>(...)` of a shell
    got: list[bytes] = []
    with os.fdopen(ends[0], "rb") as source:
        reader = threading.Thread(target=lambda: got.append(source.read()), daemon=True)
        reader.start()
        assert run(verb, dataset, flag, f"/dev/fd/{ends[1]}").code == 0
        os.close(ends[1])
        reader.join(timeout=60)
    assert len(got[0]) > 100


def test_verify_takes_problem_sets_and_exports(run: Command, dataset: Path, tmp_path: Path) -> None:
    """It prints one line for each, and the exit code is 0; a dataset may stand beside them."""
    problems = tmp_path / "set.npz"
    ProblemSet.sample("maze15", 0, 2, movement=Movement(4)).save(problems)
    export = tmp_path / "export"
    export_problems(ProblemSet.load(problems), export)
    outcome = run("verify", problems, dataset, export)
    assert outcome.code == 0
    assert sorted(outcome.out.splitlines()) == sorted(
        f"{source}: no faults found" for source in (problems, dataset, export)
    )
    for path, said in ((problems, "fault found"), (export / "test/goal.npy", "fault found")):
        content = bytearray(path.read_bytes())
        content[-80] ^= 4
        path.write_bytes(content)
        outcome = run("verify", export if path.is_relative_to(export) else path)
        assert outcome.code == 1
        (line,) = outcome.out.splitlines()
        assert line.startswith(f"{path}: ")
        assert said in outcome.err
    assert run("verify", problems, export, dataset).code == 1
    outcome = run("verify", problems, "--repair")
    assert (outcome.code, outcome.out) == (2, "")
    assert f"--repair: {problems} is a problem set, and has no recipe" in outcome.err


def test_verify_refuses_what_it_does_not_know(run: Command, tmp_path: Path) -> None:
    """By its name: another file, another folder, an archive of other arrays, nothing."""
    text = tmp_path / "notes.txt"
    text.write_text("mine")
    outcome = run("verify", text)
    assert outcome.code == 2
    assert f"no dataset at {text}: it is a file" in outcome.err
    for path in (tmp_path, tmp_path / "none"):
        outcome = run("verify", path)
        assert outcome.code == 2
        assert str(path) in outcome.err
    archive = tmp_path / "other.npz"
    np.savez(archive, a=np.zeros(3))
    outcome = run("verify", archive)
    assert (outcome.code, outcome.out.count("\n")) == (1, 1)
    assert outcome.out.startswith(f"{archive}: holds no saved problems (holds no array 'about'")


def test_a_letter_that_the_output_lacks_is_escaped(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A finished command ends with 0 whatever the encoding of its output, as on Windows."""
    folder = shutil.copytree(dataset, tmp_path / "maps-\u010d")
    output = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(output, "cp1252", newline="\n"))
    cli.main(["verify", str(folder)])  # which raises SystemExit if the code is not 0
    assert output.getvalue().decode("cp1252").endswith("maps-\\u010d: no faults found\n")


@pytest.mark.slow
def test_verify_works_without_stderr(dataset: Path) -> None:
    """A service may run without standard error; the bar is then not shown."""
    command = f"'{sys.executable}' -m mapdata verify '{dataset}' 2>&-"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, f"{dataset}: no faults found\n")


def test_a_card_that_is_a_link_is_replaced(run: Command, dataset: Path, tmp_path: Path) -> None:
    """A link or a pipe in the dataset is replaced, and the target of the link stays."""
    copy = shutil.copytree(dataset, tmp_path / "copy")
    outside, pipe = tmp_path / "outside", tmp_path / "pipe"
    outside.write_text("mine")
    os.mkfifo(pipe)
    for target in (outside, pipe):
        for name, command in (
            ("README.md", ("info", copy, "--card")),
            (MANIFEST, ("verify", copy, "--repair")),
        ):
            (copy / name).unlink(missing_ok=True)
            (copy / name).symlink_to(target)
            assert run(*command).code == 0
            assert outside.read_text() == "mine"
            assert not (copy / name).is_symlink()


@pytest.mark.slow
def test_show_draws_the_map_and_colours_of_its_flags(
    run: Command, dataset: Path, tmp_path: Path
) -> None:
    """Pictures of one map are equal; those of two maps, or in the paper's colours, are not."""
    pictures = []
    for number, flags in enumerate(("", "", "--index 1", "--paper-colours")):
        assert run("show", dataset, *flags.split(), "-o", tmp_path / f"{number}.png").code == 0
        pictures.append((tmp_path / f"{number}.png").read_bytes())
    assert pictures[0] == pictures[1]
    assert len(set(pictures)) == 3


@pytest.mark.slow
@pytest.mark.parametrize(("verb", "name"), [("show", "map.png"), ("report", "report.html")])
def test_without_output_no_file_is_replaced(
    verb: str,
    name: str,
    run: Command,
    dataset: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The default is a name in the working folder, with a number if the name exists."""
    monkeypatch.chdir(tmp_path)
    stem, ending = name.split(".")
    if verb == "show":
        assert run(verb, dataset).out == f"wrote {name}\n"
        assert os.listdir(tmp_path) == [name]
    Path(name).write_text("mine")
    Path(f"{stem}-2.{ending}").symlink_to("nowhere")
    assert f"wrote {stem}-3.{ending}" in run(verb, dataset).out
    assert Path(name).read_text() == "mine"
    assert sorted(os.listdir(tmp_path)) == sorted(
        [name, f"{stem}-2.{ending}", f"{stem}-3.{ending}"]
    )


def test_a_file_that_output_names_is_replaced(run: Command, dataset: Path, tmp_path: Path) -> None:
    """This is what users expect, since they named the file."""
    (tmp_path / "picture").write_text("old")
    assert run("show", dataset, "-o", tmp_path / "picture").code == 0
    assert (tmp_path / "picture").read_bytes().startswith(PNG)


def test_list_shows_every_preset(run: Command) -> None:
    """It shows the name, size, family and parameters, as a recipe has them."""
    lines = run("list").out.splitlines()
    assert [line.split()[0] for line in lines] == list(PRESETS)
    for line, generator in zip(lines, PRESETS.values(), strict=True):
        assert f" {generator.map_size[0]} x {generator.map_size[1]} " in line
        assert f" {generator.description}" in line
    (dungeon,) = (line for line in lines if line.startswith("dungeon "))
    assert "rooms [8, 16]" in dungeon
    assert "map_size" not in dungeon


def test_list_shows_a_generator_inside_of_a_preset(
    run: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the nested object of a recipe."""
    monkeypatch.setitem(_presets, "rough", Terrain(over=Cave((9, 12))))
    line = run("list").out.splitlines()[-1]
    assert line.startswith("rough       9 x 12      terrain with costs over caves")
    assert ', over {"generator": "cave", "map_size": [9, 12], "occupied": 0.45' in line


def test_build_takes_a_map_size_and_numbers_with_an_exponent(run: Command, tmp_path: Path) -> None:
    """The size replaces the preset's, and 1e1 is 10."""
    flags = ("--preset", "cave", "--map-size", "24x40", "--maps", "1e1", "--seed", "1.5E+1")
    assert run("build", tmp_path / "maps", *flags).code == 0
    manifest = read_manifest(tmp_path / "maps")
    assert manifest.generator == replace(PRESETS["cave"], map_size=(24, 40))
    assert (manifest.maps, manifest.seed) == (10, 15)


@pytest.mark.parametrize(
    "arguments", [["--help"], ["build", "--help"], ["show", "--help"], ["--version"]]
)
def test_help_and_version(arguments: list[str], run: Command) -> None:
    """Both end with exit code 0."""
    outcome = run(*arguments)
    assert (outcome.code, outcome.err) == (0, "")
    assert ("usage: mapdata" in outcome.out) == ("--help" in arguments)
    assert (f"mapdata {mapdata.__version__}\n" == outcome.out) == ("--version" in arguments)


@pytest.mark.parametrize("verb", cli.VERBS)
def test_every_help_has_examples_that_parse(verb: str, run: Command) -> None:
    """Each line under Examples is a command whose flags the verb has."""
    text = run(verb, "--help").out
    examples = re.findall(rf"^  mapdata {verb}\b(.*?)(?: > .*)?$", text, re.MULTILINE)
    assert examples
    assert "Examples:\n" in text
    parser = cli.verb_parser(verb)
    for example in examples:
        parser.parse_args(shlex.split(example))


def test_build_says_when_its_folder_has_the_name_of_a_preset(
    run: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise 'mapdata build tiles' would be taken for a way to build the preset."""
    monkeypatch.chdir(tmp_path)
    code, out, _ = run("build", "tiles", "--maps", 2)
    assert code == 0
    assert "the maps are those of the preset paper; 'mapdata build FOLDER --preset tiles'" in out
    code, out, _ = run("build", "maze", "--maps", 2, "--preset", "tiles")
    assert code == 0
    assert "note:" not in out


@pytest.mark.parametrize(
    ("verb", "patched", "advice"),
    [
        (
            "build",
            "mapdata.shards.costly_maps.label",
            "take fewer --workers or a smaller --shard-size, ",
        ),
        ("show", "mapdata.plotting.figures.plot_map", ""),
    ],
)
def test_a_lack_of_memory_is_one_line(
    verb: str,
    patched: str,
    advice: str,
    run: Command,
    copied: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It names the dataset, what could not be allocated and what to do; the dataset stays."""

    def fail(*_: object, **__: object) -> None:
        np.empty((2**45, 2**10), np.uint8)

    before = stamps(copied)
    monkeypatch.setattr(patched, fail)
    recipe = json.dumps({"spec": SPEC.to_dict()})
    more = ("--recipe", recipe, "--seed", SEED, "--shard-size", SIZE, "--maps", 2 * MAPS)
    outcome = run(verb, copied, *(more if verb == "build" else ("-o", copied / "map.png")))
    assert outcome.code == 2
    assert "Traceback" not in outcome.err
    assert outcome.err.splitlines()[-1] == (
        f"mapdata: {copied}: the memory does not suffice (Unable to allocate 32.0 PiB for an array "
        f"with shape (35184372088832, 1024) and data type uint8); {advice}end other programs, or "
        "take a machine with more memory"
    )
    assert stamps(copied) == before


HELP = """
import io, sys
from contextlib import redirect_stdout
from mapdata.cli.app import VERBS, main

for arguments in (["--help"], *([verb, "--help"] for verb in VERBS)):
    try:
        with redirect_stdout(io.StringIO()) as text:
            main(arguments)
    except SystemExit:
        pass
    assert "usage: mapdata" in text.getvalue()
    print(*arguments, *(name for name in ("torch", "matplotlib", "pandas") if name in sys.modules))
"""


@pytest.mark.slow
def test_no_help_imports_what_takes_seconds() -> None:
    """All helps in one process of its own, since this one has imported everything."""
    done = subprocess.run(
        [sys.executable, "-c", HELP], capture_output=True, text=True, check=False, cwd=HOME
    )
    assert done.returncode == 0, done.stderr
    lines = ["--help", *(f"{verb} --help" for verb in cli.VERBS)]
    assert done.stdout.splitlines() == lines


def test_the_help_of_build_names_all_presets(run: Command) -> None:
    """The help lists them as text, since loading them would take seconds."""
    names = re.search(r"--preset PRESET +(.*?) \(default", run("build", "--help").out, re.DOTALL)
    assert names is not None
    assert re.findall(r"\w+", names[1].replace(" or ", " ")) == list(PRESETS)


def test_mapdata_alone_shows_the_verbs(run: Command, tmp_path: Path) -> None:
    """So do --help and ``python -m mapdata``; without arguments the exit code is 2."""
    shown = run("--help").out
    for verb in cli.VERBS:
        assert f"\n  {verb} " in shown
    assert run() == Outcome(2, shown, "")
    command = [sys.executable, "-m", "mapdata"]
    done = subprocess.run(command, cwd=HOME, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (2, shown, "")


def test_a_flag_before_the_verb_is_refused(run: Command) -> None:
    """The message says that the verb comes first, and proposes no verb that looks like the flag."""
    run.refused(2, "--import: the verb comes first, as in mapdata verify", "--import", "pillars")


def test_a_similar_verb_is_proposed_for_a_misspelt_verb(run: Command) -> None:
    """If none is similar, all verbs are listed."""
    run.refused(2, "unknown verb 'biuld'; did you mean build?", "biuld", "data/maps")
    run.refused(
        2, r"unknown verb 'xyzzy'; known are list, build, .*, check-scen, evaluate \(", "xyzzy"
    )


# --- recipes ------------------------------------------------------------------------------------


def test_a_recipe_rebuilds_bit_for_bit(run: Command, dataset: Path, tmp_path: Path) -> None:
    """What info --recipe prints builds the same files, and build says that it compared the content
    hash.
    """
    recipe = tmp_path / "recipe.json"
    recipe.write_text(run("info", dataset, "--recipe").out, encoding="utf-8")
    outcome = run("build", tmp_path / "again", "--recipe", recipe, "--shard-size", SIZE)
    assert outcome.code == 0
    assert "bit for bit" in outcome.out
    for name in (MANIFEST, *stamps(dataset)):
        assert (tmp_path / "again" / name).read_bytes() == (dataset / name).read_bytes()
    rebuilt = run(
        "build",
        tmp_path / "other",
        "--recipe",
        recipe.read_text(encoding="utf-8"),
        "--shard-size",
        3,
    )
    assert rebuilt.code == 0
    assert "bit for bit" in rebuilt.out


def test_a_build_that_disagrees_with_its_recipe_is_refused(
    run: Command, dataset: Path, tmp_path: Path
) -> None:
    """If the content hash is another one, the exit code is 1, and both hashes are printed."""
    values = json.loads(run("info", dataset, "--recipe").out)
    true, values["content_hash"] = values["content_hash"], "0" * 64
    outcome = run("build", tmp_path / "again", "--recipe", recipe_file(tmp_path, **values))
    assert outcome.code == 1
    assert (
        outcome.err.splitlines()[-1] == f"mapdata: content hash {true}, the recipe says {'0' * 64}"
    )
    assert "bit for bit" not in outcome.out


def test_more_maps_than_the_recipe_are_not_compared(
    run: Command, dataset: Path, tmp_path: Path
) -> None:
    """The seed and number of maps of a recipe can be overridden; its hash then says nothing."""
    recipe = recipe_file(tmp_path, **json.loads(run("info", dataset, "--recipe").out))
    outcome = run("build", tmp_path / "more", "--recipe", recipe, "--maps", MAPS + 1)
    assert outcome.code == 0
    assert "bit for bit" not in outcome.out
    assert read_manifest(tmp_path / "more").maps == MAPS + 1


def test_a_recipe_of_an_unfinished_dataset_is_true(
    run: Command, copied: Path, tmp_path: Path
) -> None:
    """It is printed without a hash, and builds the whole dataset."""
    manifest = read_manifest(copied)
    (copied / MANIFEST).write_text(
        replace(manifest, shards=manifest.shards[:1]).to_json(), encoding="utf-8"
    )
    outcome = run("info", copied, "--recipe")
    assert outcome.code == 0
    values = json.loads(outcome.out)
    assert "content_hash" not in values
    recipe = recipe_file(tmp_path, **values)
    assert run("build", tmp_path / "again", "--recipe", recipe).code == 0
    assert read_manifest(tmp_path / "again").content_hash == manifest.content_hash


# --- bad input ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("message", "arguments"),
    [
        ("maps: got 0", ["--maps", "0"]),
        ("maps: got -1", ["--maps", "-1"]),
        ("--maps: got 'many', expected a whole number such as 10000 or 1e4", ["--maps", "many"]),
        ("--maps: got '1.5', expected a whole number", ["--maps", "1.5"]),
        ("--maps: got '1e-4', expected a whole number", ["--maps", "1e-4"]),
        ("--maps: got '1.25e1', expected a whole number", ["--maps", "1.25e1"]),
        ("--maps: got '1e999', expected a whole number", ["--maps", "1e999"]),
        ("--map-size: got '64', expected ROWSxCOLUMNS as in 64x64", ["--map-size", "64"]),
        ("room_rows: got (14, 33), expected at most 8: rooms would be", ["--map-size", "8x8"]),
        ("--map-size: not allowed with --recipe", ["--map-size", "9x9", "--recipe", "paper"]),
        ("unknown flag --size; did you mean --map-size?", ["--size", "64x64"]),
        ("seed: got -1", ["--seed", "-1"]),
        ("seed: got 18446744073709551616", ["--seed", str(2**64)]),
        ("preset: got 'papers', expected one of paper, narrow", ["--preset", "papers"]),
        ("shard_size: got 0", ["--shard-size", "0"]),
        ("workers: got 0", ["--workers", "0"]),
        ("recipe: none.json: no such file, expected a recipe", ["--recipe", "none.json"]),
        ("recipe: none/rooms: no such file", ["--recipe", "none/rooms"]),
        ("--connectivity: not allowed with", ["--connectivity", "8", "--recipe", "paper"]),
        ("--corner-cutting and --diagonal-cost: need --connectivity 8", ["--corner-cutting"]),
        ("recipe: not JSON", ["--recipe", "{"]),
        (
            '(char 1)); expected JSON such as {"spec": "dungeon", "seed": 7',
            ["--recipe", "{spec: 1}"],
        ),
        ("got 'paper(seed=3)', expected a preset (paper, narrow", ["--recipe", "paper(seed=3)"]),
        ('JSON text such as {"spec": "dungeon", "seed": 7, "maps": 500}', ["--recipe", "spec: x"]),
        ("--preset: not allowed with --recipe", ["--preset", "narrow", "--recipe", "paper"]),
        ("--part: got '4/4', expected K/N", ["--part", "4/4"]),
        ("unknown flag --xyz (mapdata build --help says more)", ["--xyz"]),
        ("unknown flag --map-sise; did you mean --map-size?", ["--map-sise", "3"]),
        ("unknown flag --shard-sise; did you mean --shard-size?", ["--shard-sise", "3"]),
        ("unknown flag --preste; did you mean --preset?", ["--preste=narrow"]),
        ("unknown flag --see; did you mean --seed?", ["--see", "3"]),
        (f"{', '.join(PRESETS)}; did you mean dungeon?", ["--preset", "dungoen"]),
    ],
)
def test_bad_flags_of_build_are_refused_in_one_line(
    message: str, arguments: list[str], run: Command, tmp_path: Path
) -> None:
    """The exit code is 2, and no folder is created."""
    run.refused(2, re.escape(message), "build", tmp_path / "maps", *arguments)
    assert not (tmp_path / "maps").exists()


@pytest.mark.parametrize(
    ("message", "values"),
    [
        ("rooms: got (1, 1), expected at least 2", {"rooms": (1, 1)}),
        ("rooms: got (2, 256), expected at most 255", {"rooms": (2, 256)}),
        ("rooms: upper limit 2 is under the lower limit 5", {"rooms": (5, 2)}),
        ("room_rows: upper limit 2 is under the lower limit 5", {"room_rows": (5, 2)}),
        ("room_rows: got (0, 3), expected at least 1", {"room_rows": (0, 3)}),
        (
            "room_rows: got (2, 17), expected at most 16: rooms would be larger than the map",
            {"room_rows": (2, 17)},
        ),
        ("room_columns: got (3, 71), expected at most 70", {"room_columns": (3, 71)}),
        (
            "passage_width: got (1, 17), expected at most 16: passages would be larger",
            {"passage_width": (1, 17)},
        ),
        ("passage_width: got (0, 1), expected at least 1", {"passage_width": (0, 1)}),
        ("map_size: got (0, 70)", {"map_size": (0, 70)}),
        ("map_size: got (4097, 70), expected 1 to 4096", {"map_size": (4097, 70)}),
        ("map_size: got [64], expected 2 integers", {"map_size": [64]}),
        ("skip_probability: got 1.5, expected a probability in [0, 1]", {"skip_probability": 1.5}),
        ("skip_probability: got -0.1", {"skip_probability": -0.1}),
        ("skip_probability: got nan", {"skip_probability": float("nan")}),
        ("skip_probability: got 'ten percent'", {"skip_probability": "ten percent"}),
        ("resolution: got 0.0", {"resolution": 0}),
        ("resolution: got inf", {"resolution": float("inf")}),
        ("splits: got [0.5, 0.6, 0.1]", {"splits": [0.5, 0.6, 0.1]}),
        ("connectivity: got 6, expected 4 or 8", {"movement": {"connectivity": 6}}),
        ("spec: unknown key: wings; known are generator, map_size", {"wings": 2}),
        (
            "spec: unknown keys: family, pillars; known are generator, map_size, resolution, "
            "movement, splits, rooms, room_rows, room_columns, passage_width, skip_probability; "
            "did you mean generator?",
            {"family": "pillars", "pillars": 40},
        ),
        ("movement: unknown key: wings", {"movement": {"wings": 2}}),
        (
            "generator: the family 'mazes' is not known here; import its module (--import MODULE "
            f"in a command, import MODULE in Python); known are {KNOWN}; did you mean maze?",
            {"generator": "mazes"},
        ),
        pytest.param(
            "resolution: got 1",
            {"resolution": 10**400},
        ),
    ],
)
def test_bad_specs_are_refused_in_one_line(
    message: str, values: dict[str, Any], run: Command, tmp_path: Path
) -> None:
    """The line names the bad value, the exit code is 2, and no folder is created."""
    run.refused(
        2, re.escape(message), "build", tmp_path / "maps", "--recipe", spec_file(tmp_path, **values)
    )
    assert not (tmp_path / "maps").exists()


@pytest.mark.parametrize(
    ("message", "content"),
    [
        ("not JSON", b""),
        (r"not JSON \(Expecting value.*\); expected JSON such as \{", b"spec: {generator: maze}"),
        ("expected an object", b"[]"),
        ("recipe: got 'rooms', expected one of content_hash", b'{"rooms": [2, 3]}'),
        (r"recipe\.json: not JSON \('utf-8' codec", b'{"maps": \xff}'),
        (
            f"format version 4, this mapdata {mapdata.__version__} reads 1 to 3",
            b'{"format_version": 4}',
        ),
        pytest.param(
            "recipe",
            b'{"spec": ' + b"[" * 100_000,
        ),
    ],
)
def test_bad_recipe_files_are_refused_in_one_line(
    message: str, content: bytes, run: Command, tmp_path: Path
) -> None:
    """The exit code is 2, and no folder is created."""
    (tmp_path / "recipe.json").write_bytes(content)
    run.refused(2, message, "build", tmp_path / "maps", "--recipe", tmp_path / "recipe.json")
    assert not (tmp_path / "maps").exists()


@pytest.mark.parametrize(
    ("message", "arguments"),
    [
        ("with seed 5, asked for seed 6", ["--seed", 6, "--maps", MAPS, "--shard-size", SIZE]),
        ("with shard_size 4, asked for shard_size 5", ["--maps", MAPS, "--shard-size", 5]),
        ("holds 11 maps, asked for 10: a dataset only grows", ["--maps", 10, "--shard-size", SIZE]),
    ],
)
def test_a_root_with_another_dataset_is_refused(
    message: str, arguments: list[object], run: Command, dataset: Path, tmp_path: Path
) -> None:
    """Both values of the difference are named, the exit code is 2, and the dataset does
    not change.
    """
    before = stamps(dataset)
    another_recipe = spec_file(tmp_path, skip_probability=0.2)
    only = "with skip_probability 0.3, asked for skip_probability 0.2: choose another folder, or"
    run.refused(
        2, only, "build", dataset, "--recipe", another_recipe, "--maps", MAPS, "--shard-size", SIZE
    )
    run.refused(2, message, "build", dataset, "--recipe", spec_file(tmp_path), *arguments)
    run.refused(
        2,
        r"map_size \(16, 70\), .*asked for seed 0, .*map_size \(64, 64\)",
        "build",
        dataset,
        "--maps",
        MAPS,
    )
    assert stamps(dataset) == before


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nowhere", "there is no module 'nowhere', neither in the working folder {folder} nor"),
        ("broken.deeper", "there is no module 'broken.deeper', neither"),
        ("broken.py", "got 'broken.py', expected the name of a module, as in --import broken$"),
        ("./broken.py", "got './broken.py', expected the name of a module, as in --import broken$"),
        ("", "got '', expected the name of a module$"),
        (".", "got '.', expected the name of a module$"),
        ("wrong", "wrong: SyntaxError: "),
        ("lacking", "lacking: ModuleNotFoundError: No module named 'mapdata_nowhere'$"),
        ("taken", "taken: ValueError: Mine: 'maze' is the name of <class 'mapdata"),
        ("leaving", "leaving: SystemExit: 3$"),
    ],
)
def test_modules_that_cannot_be_imported_are_named_in_one_line(
    name: str,
    message: str,
    run: Command,
    dataset: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The line says what is wrong with the module, and the exit code is 2."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path.copy())
    before = sys.modules.copy()
    for module, text in {
        "broken": "",
        "wrong": "if",
        "lacking": "import mapdata_nowhere",
        "leaving": "raise SystemExit(3)",
        "taken": "from dataclasses import dataclass\nfrom mapdata import Maze, generators\n\n"
        "@dataclass(frozen=True)\nclass Mine(Maze):\n    pass\n\n"
        "generators.register(Mine)\n",
    }.items():
        (tmp_path / f"{module}.py").write_text(text, encoding="utf-8")
    line = f"^mapdata: --import: {message.format(folder=tmp_path)}"
    run.refused(2, line, "info", dataset, "--import", name)
    for module in sys.modules.keys() - before.keys():
        del sys.modules[module]


def test_verbs_without_families_have_no_flag_to_import_one(run: Command) -> None:
    """It would do nothing there; all other verbs list it in their help."""
    for verb in cli.VERBS:
        has_flag = "--import MODULE" in run(verb, "--help").out
        assert has_flag == (verb not in ("import", "check-scen")), verb


def test_bad_roots_are_refused(run: Command, tmp_path: Path) -> None:
    """A root is refused if it is a file, lies below a file, or holds other files."""
    (tmp_path / "notes").write_text("notes", encoding="utf-8")
    run.refused(2, "notes is a file, expected a folder", "build", tmp_path / "notes")
    run.refused(2, "notes", "build", tmp_path / "notes" / "maps")
    run.refused(2, r"holds something else \('notes'\)", "build", tmp_path)
    assert os.listdir(tmp_path) == ["notes"]


@pytest.mark.parametrize("verb", ["info", "verify", "show"])
def test_a_missing_dataset_is_named_in_one_line(verb: str, run: Command, tmp_path: Path) -> None:
    """The line says which file was sought and how to make a dataset; the exit code is 2."""
    run.refused(
        2,
        f"no dataset at {tmp_path / 'none'}: it does not exist. Make one with",
        verb,
        tmp_path / "none",
    )
    run.refused(
        2, f"no dataset at {tmp_path}: no manifest.json there. Make one with", verb, tmp_path
    )
    (tmp_path / "file").touch()
    run.refused(2, f"no dataset at {tmp_path / 'file'}", verb, tmp_path / "file")
    # Such as an export: a dataset would be written into it.
    run.refused(2, "there. The folder holds other files: name the folder", verb, tmp_path)


def test_a_preset_in_place_of_a_dataset_is_named_as_such(
    run: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """'mapdata build maze15', without --preset, would build maps of another one."""
    monkeypatch.chdir(tmp_path)
    run.refused(2, "'mapdata build data/maze15 --preset maze15' stores maps", "show", "maze15")


@pytest.mark.parametrize("verb", ["info", "verify", "show"])
def test_datasets_in_subfolders_are_named(
    verb: str, run: Command, dataset: Path, tmp_path: Path
) -> None:
    """An import of maps of several sizes makes them; the advice is not to build a dataset there."""
    for number in range(10):
        (tmp_path / f"{number}x64").symlink_to(dataset)
    names = ", ".join(str(tmp_path / f"{number}x64") for number in range(8))
    message = (
        f"no dataset at {tmp_path}: no manifest.json there. Its subfolders are datasets, give one "
        f"of them: {names} and 2 more$"
    )
    run.refused(2, message, verb, tmp_path)


@pytest.mark.parametrize("verb", ["info", "verify", "show"])
def test_a_file_of_a_dataset_is_refused_as_a_root(verb: str, run: Command, dataset: Path) -> None:
    """The message names the folder, and does not advise to build a dataset there."""
    for name in (MANIFEST, shard_name(0, 4)):
        message = f"no dataset at {dataset / name}: it is a file. Give its folder: {dataset}$"
        run.refused(2, message, verb, dataset / name)
    message = "it is a file. Give the folder of a dataset; 'mapdata import FILE ROOT' makes one of"
    run.refused(2, message, verb, __file__)


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs a folder that holds no others")
def test_a_folder_that_cannot_be_created_is_named(
    run: Command, dataset: Path, tmp_path: Path
) -> None:
    """Every verb that creates a folder names it."""
    message = r"^mapdata: /proc/x: this folder cannot be made \(No such file or directory\)$"
    run.refused(2, message, "build", "/proc/x", "--maps", 2)
    run.refused(2, message, "export", dataset, "/proc/x/maps", "--format", "paper")
    (tmp_path / "site.map").write_text("type octile\nheight 1\nwidth 2\nmap\n..\n")
    outcome = run("import", tmp_path / "site.map", "/proc/x", "--seed-points", 2)
    assert (outcome.code, outcome.err.splitlines()[-1][: len("mapdata: /proc/x: this")]) == (
        2,
        "mapdata: /proc/x: this",
    )


def test_a_url_without_a_server_is_refused_in_one_line(
    run: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The line has the number of attempts, and no warning is printed for them."""
    monkeypatch.setattr("mapdata.shards.remote.PAUSES", (0.0, 0.0))
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))  # and nobody listens
        url = f"http://127.0.0.1:{closed.getsockname()[1]}/maps"
        message = f"^mapdata: {url}/manifest.json could not be read: .*3 tries"
        with warnings.catch_warnings(record=True) as printed:
            warnings.simplefilter("default")
            run.refused(2, message, "info", url)
    assert printed == []


@pytest.mark.filterwarnings("default")
def test_a_warning_is_one_line(
    run: Command, dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is printed without the file and the source line that issued it."""

    def with_warning(*_: object) -> str:
        warnings.warn("the server is old.\nGoing on", stacklevel=1)
        return "a dataset"

    monkeypatch.setattr(cli, "summary", with_warning)
    outcome = run("info", dataset)
    assert outcome == Outcome(0, "a dataset\n", "mapdata: warning: the server is old. Going on\n")


@pytest.mark.parametrize("index", [-1, MAPS, 10**30])
def test_show_refuses_an_index_outside_the_dataset(index: int, run: Command, dataset: Path) -> None:
    """The message names the valid numbers."""
    run.refused(
        2, f"index: got {index}, .* holds maps 0 to {MAPS - 1}", "show", dataset, "--index", index
    )


def test_show_refuses_outputs_that_cannot_be_written(
    run: Command, dataset: Path, tmp_path: Path
) -> None:
    """A missing folder and an unknown picture format are refused in one line."""
    run.refused(2, "none", "show", dataset, "-o", tmp_path / "none" / "map.png")
    run.refused(2, "xyz", "show", dataset, "-o", tmp_path / "map.xyz")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    "arguments", [["burn"], ["build"], ["info"], ["build", "a", "b"], ["show", "a", "--red"]]
)
def test_wrong_usage_is_refused_in_one_line(arguments: list[str], run: Command) -> None:
    """The line points to the help."""
    run.refused(2, r"--help says more\)$", *arguments)


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: text[: len(text) // 2],
        lambda text: text.replace('"seed": 5', '"seed": 6'),
        lambda text: "",
    ],
    ids=["cut", "changed", "empty"],
)
def test_every_verb_refuses_a_damaged_manifest(
    damage: Callable[[str], str], run: Command, copied: Path
) -> None:
    """The exit code is 1, and the file is named."""
    text = (copied / MANIFEST).read_text(encoding="utf-8")
    (copied / MANIFEST).write_text(damage(text), encoding="utf-8")
    for verb in (["info", copied], ["show", copied], ["build", copied, "--maps", MAPS]):
        run.refused(1, f"{copied / MANIFEST}: damaged", *verb)
    outcome = run("verify", copied)
    assert outcome.code == 1
    assert outcome.out.startswith(f"{copied / MANIFEST}: damaged")


def test_a_damaged_shard_cannot_be_shown(run: Command, copied: Path) -> None:
    """The exit code is 1, and the file is named."""
    path = copied / shard_name(0, 4)
    path.write_bytes(path.read_bytes()[:-100])
    run.refused(1, f"{path}: (not a sound shard|has )", "show", copied)


def test_a_root_without_write_permission_is_refused(run: Command) -> None:
    """One line is printed, the exit code is 2, and no file is added."""
    with unprivileged_folder() as folder:
        run.refused(2, str(folder), "build", folder, "--maps", 2)
        run.refused(2, str(folder), "build", folder / "maps", "--maps", 2)
        assert os.listdir(folder) == []


def test_ctrl_c_says_how_to_continue(
    run: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One line is printed, and the exit code is 130, as in a shell."""

    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("mapdata.shards.build", stop)
    run.refused(130, "stopped; run the same command again to go on", "build", tmp_path / "maps")


# --- other processes ----------------------------------------------------------------------------

FULL_DISK = """
import resource, sys
from mapdata.cli import main
main(["build", sys.argv[1] + "/warm", "--maps", "1", "--workers", "1"])  # load the kernels
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), int(sys.argv[2])))
main(["build", sys.argv[1] + "/maps", "--maps", "40", "--shard-size", "20", "--workers", "1"])
"""


@pytest.mark.slow
@pytest.mark.parametrize("limit", [300, 12_000], ids=["not even the manifest", "no shard"])
def test_a_full_disk_is_reported_in_one_line(limit: int, tmp_path: Path) -> None:
    """The disk is really full (RLIMIT_FSIZE); the exit code is 2, and no partial file remains."""
    command = [sys.executable, "-c", FULL_DISK, str(tmp_path), str(limit)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    (line,) = (line for line in done.stderr.splitlines() if line.startswith("mapdata: "))
    assert "File too large" in line
    left = set(os.listdir(tmp_path / "maps")) - {".lock"}
    assert left == (set() if limit == 300 else {MANIFEST})
    if left:
        assert read_manifest(tmp_path / "maps").shards == ()


def test_import_is_light() -> None:
    """``import mapdata`` loads none of the large packages, and neither does a movement."""
    heavy = [
        "torch",
        "lightning",
        "pytorch_lightning",
        "pandas",
        "matplotlib",
        "numba",
        "h5py",
        "scipy",
    ]
    code = f"""
import sys, mapdata
mapdata.Movement(8), mapdata.__version__, dir(mapdata)
print([name for name in {heavy} if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


@pytest.mark.slow
def test_the_script_has_a_default_root(tmp_path: Path) -> None:
    """``python scripts/build_shards.py`` builds under data/maps, with the flags and exit codes of
    the verb.
    """
    script = [sys.executable, str(HOME / "scripts" / "build_shards.py")]
    done = subprocess.run(
        [*script, "--maps", "3"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    root = tmp_path / "data" / "maps"
    manifest = read_manifest(root)
    assert (manifest.generator, manifest.seed, manifest.maps, manifest.shard_size) == (
        MapSpec(),
        0,
        3,
        1000,
    )
    assert len(read_shard(root / manifest.shards[0].name).maps) == 3
    assert "mapdata show data/maps --index 2 -o map.png" in done.stdout


def test_the_script_takes_a_root_and_the_flags(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All flags reach the build, and so does a family from a module in the working folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path.copy())
    flags = {
        "--maps": "3",
        "--seed": "9",
        "--preset": "dungeon",
        "--shard-size": "2",
        "--workers": "1",
    }
    cli.build_main(["there", *(text for flag in flags.items() for text in flag)])
    manifest = read_manifest(tmp_path / "there")
    assert (manifest.generator, manifest.seed) == (MapSpec.preset("dungeon"), 9)
    assert (manifest.maps, manifest.shard_size) == (3, 2)
    write_module(tmp_path)
    cli.build_main(["halls", "--preset", "columns", "--maps", "2", "--import", "pillars"])
    generator = read_manifest(tmp_path / "halls").generator
    assert generator is not None
    assert generator.name == "pillars"
    forget("pillars", "columns")


@pytest.mark.slow
def test_a_closed_pipe_is_no_error(dataset: Path) -> None:
    """``mapdata info ROOT | head -1`` prints no error, whether the output is long or short."""
    for arguments in (["info", str(dataset)], ["--help"]):
        command = [sys.executable, "-c", "from mapdata.cli import main; main()", *arguments]
        ours, theirs = os.pipe()
        os.close(ours)
        done = subprocess.run(
            command, stdout=theirs, stderr=subprocess.PIPE, text=True, check=False
        )
        os.close(theirs)
        assert (done.returncode, done.stderr) == (141, "")


def test_show_writes_the_named_file(run: Command, dataset: Path, tmp_path: Path) -> None:
    """A name without an ending becomes a PNG of exactly this name; an empty name is refused."""
    assert run("show", dataset, "-o", tmp_path / "picture").out == f"wrote {tmp_path / 'picture'}\n"
    assert (tmp_path / "picture").read_bytes()[:4] == b"\x89PNG"
    run.refused(2, r"^mapdata: \.: is a folder, expected the name", "show", dataset, "-o", "")
