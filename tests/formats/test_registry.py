"""The registry: recognising, refusing, exports that appear whole; docs/formats.md runs."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest
from helpers.foreign_files import SOURCES
from helpers.wild import cli
from PIL import Image

from mapdata import DatasetNotFoundError, MapSpec, ShardError, build, read_shard
from mapdata.export import PROBLEM_FORMATS
from mapdata.formats import (
    Collection,
    ForeignMap,
    Format,
    FormatError,
    Limits,
    export,
    paper,
    read_any,
    register,
)
from mapdata.formats.registry import FORMATS, functions_by_format, recognise
from mapdata.shards import Root

PAGE = (Path(__file__).parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")


def test_the_page_of_formats_lists_every_format(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The table of docs/formats.md has every format, and the Python code of the page runs."""
    rows = re.findall(r"^\| (`[a-z`, -]+`) \| (yes|) ?\| (yes|problems|) ?\|", PAGE, re.MULTILINE)
    readable: set[str] = set()
    written: dict[str, set[str]] = {"": set(), "yes": set(), "problems": set()}
    for names, reads, writes in rows:
        written[writes].update(re.findall("[a-z-]+", names))
        if reads:
            readable.update(re.findall("[a-z-]+", names))
    assert readable == set(functions_by_format("read"))
    assert written["yes"] == set(functions_by_format("write"))
    assert written["problems"] == set(PROBLEM_FORMATS)
    monkeypatch.chdir(tmp_path)
    Path("floorplans").mkdir()
    Image.fromarray(np.full((128, 128), 255, np.uint8)).save("floorplans/a.png")
    monkeypatch.setattr("mapdata.formats.registry.FORMATS", dict(FORMATS))
    blocks = re.findall(r"^```python\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    exec(compile("".join(blocks), "docs/formats.md", "exec"), {})
    assert capsys.readouterr().out.endswith("[[0 0 0 0]\n [0 1 1 0]\n [0 0 0 0]]\n")
    assert list(Path("floorplans.movingai").rglob("*.scen"))


def test_the_docstring_of_paper_lists_every_written_column(root: Path, tmp_path: Path) -> None:
    """The docstring of paper.py lists the columns that are written, and no others."""
    export(root, tmp_path / "release", "paper")
    header = (tmp_path / "release" / "maps.csv").read_text(encoding="utf-8").partition("\n")[0]
    table = re.findall(r"^\| ([a-z_, ]+) \|", paper.__doc__ or "", re.MULTILINE)[1:]
    assert {name for line in table for name in line.split(", ")} == set(header.split(","))


@pytest.mark.parametrize("format_name", sorted(functions_by_format("write")))
def test_an_export_is_whole_or_nothing(
    format_name: str, square: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If a shard cannot be read half-way, neither a target nor a temporary file remains."""
    calls = 0
    labels_of = Root.labels

    def broken(self: Root, **how: bool) -> object:
        nonlocal calls
        for labels in labels_of(self, **how):
            calls += 1
            if calls > 1:
                raise OSError(28, "No space left on device")
            yield labels

    monkeypatch.setattr(Root, "labels", broken)
    with pytest.raises(OSError, match="No space left"):
        export(square, tmp_path / "out.npz", format_name)
    assert list(tmp_path.iterdir()) == []


def test_an_export_removes_what_a_killed_one_left(square: Path, tmp_path: Path) -> None:
    """Temporary files of any killed export in the folder of the target are removed, files of other
    programs stay.
    """
    left = tmp_path / ".before.0123456789abcdef.mapdata.tmp"
    (left / "export" / "train").mkdir(parents=True)
    (left / "lock").touch()
    (tmp_path / ".notes.tmp").touch()
    export(square, tmp_path / "out", "ros")
    assert sorted(path.name for path in tmp_path.iterdir()) == [".notes.tmp", "out"]


def test_two_exports_at_once_have_different_temporary_names(
    square: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The name holds the process, so that an export does not remove the files of a running one."""
    true_replace = os.replace
    targets = [tmp_path / "second"]

    def replace(source: Path, target: Path) -> None:
        names = [path.name for path in tmp_path.iterdir() if path.name.startswith(".")]
        assert all(re.fullmatch(r"\.\w+\.[0-9a-f]{16}\.mapdata\.tmp", name) for name in names)
        assert names
        if targets:
            export(square, targets.pop(), "ros")
        true_replace(source, target)

    monkeypatch.setattr(os, "replace", replace)
    export(square, tmp_path / "first", "ros")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["first", "second"]


def test_exports_that_are_refused(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No dataset, an unfinished or damaged dataset, a target in use, and an unknown format are
    refused.
    """
    with pytest.raises(DatasetNotFoundError):
        export(tmp_path / "none", tmp_path / "out", "ros")
    with pytest.raises(ValueError, match="format: got 'zarr', expected one of paper"):
        export(root, tmp_path / "out", "zarr")
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "x").write_text("mine")
    with pytest.raises(FormatError, match="exists already"):
        export(root, tmp_path / "used", "ros")
    damaged = tmp_path / "damaged"
    build(damaged, MapSpec(), maps=2)
    shard = next(damaged.glob("*.h5"))
    shard.write_bytes(shard.read_bytes()[:-1])
    with pytest.raises(ShardError):
        export(damaged, tmp_path / "out", "ros")
    assert cli(capsys, "export", damaged, tmp_path / "out", "--format", "ros")[0] == 1
    shard.unlink()
    assert cli(capsys, "export", damaged, tmp_path / "out", "--format", "ros")[0] == 1
    assert not (tmp_path / "out").exists()
    (tmp_path / "empty").mkdir()
    export(root, tmp_path / "empty", "ros")
    assert len(list((tmp_path / "empty").rglob("*.yaml"))) == 24


@pytest.mark.parametrize("kind", SOURCES)
def test_a_source_is_recognised_by_its_files(kind: str, tmp_path: Path) -> None:
    """By the file that a user names, and by its folder."""
    named = SOURCES[kind].write(tmp_path)
    assert recognise(named) == recognise(tmp_path) == SOURCES[kind].format


def test_an_archive_that_no_format_can_open_is_refused(tmp_path: Path) -> None:
    """Formats look into an .npz to recognise it. One that is damaged is of none of them."""
    (tmp_path / "a.npz").write_bytes(b"PK\x03\x04 cut off")
    assert recognise(tmp_path / "a.npz") == "images"  # which takes every .npz
    with pytest.raises(FormatError, match=r"a\.npz: not a sound \.npz file"):
        read_any(tmp_path / "a.npz")


def test_what_no_format_recognises_is_refused(tmp_path: Path) -> None:
    """So are a file that is missing, and options of another format."""
    np.save(tmp_path / "stack.npy", np.zeros((2, 3, 4)))
    assert recognise(tmp_path / "stack.npy") == "images"
    (tmp_path / "text").mkdir()
    (tmp_path / "text" / "a.txt").write_text("x")
    for source, message in (
        (tmp_path / "none", "no such file"),
        (tmp_path / "text", "no file of a known format"),
    ):
        with pytest.raises(FormatError, match=message):
            recognise(source)
    np.savez(tmp_path / "tiles.npz", maps=1, costs=1, targets=1, sources=1)  # without paths
    assert recognise(tmp_path / "tiles.npz") != "tilebased"
    with pytest.raises(FormatError, match="text: holds no map of format ros"):
        read_any(tmp_path / "text", "ros")
    with pytest.raises(ValueError, match="format: got 'zarr'"):
        read_any(tmp_path / "text", "zarr")
    with pytest.raises(ValueError, match="scen: does nothing for format images"):
        read_any(tmp_path / "stack.npy", scen=True)
    with pytest.raises(ValueError, match=r"does nothing for format images; did you mean size\?"):
        read_any(tmp_path / "stack.npy", sizes="8x8")


def test_links_and_pipes_with_the_ending_of_a_table_are_ignored(
    square: Path, tmp_path: Path
) -> None:
    """A dangling link and a pipe beside the maps of a robot do not belong to another format."""
    export(square, tmp_path / "maps", "ros")
    (tmp_path / "maps" / "x.csv").symlink_to("gone.csv")
    os.mkfifo(tmp_path / "maps" / "y.csv")
    assert recognise(tmp_path / "maps") == "ros"


def test_a_table_beside_map0_needs_a_format(tmp_path: Path) -> None:
    """As in the authors' release, the pictures are inverted there, so the user must name the
    format.
    """
    Image.fromarray(np.full((4, 4), 255, np.uint8)).save(tmp_path / "a.png")
    (tmp_path / "data.csv").write_text("name,rows\na,4\n")
    assert recognise(tmp_path) == "images"
    (tmp_path / "a.png").rename(tmp_path / "map0.png")
    assert recognise(tmp_path) == "paper"
    with pytest.raises(FormatError, match=r"paper: .* --format images --images.invert reads"):
        read_any(tmp_path)
    assert len(read_any(tmp_path, "images").maps) == 1


def test_pictures_beside_a_yaml_belong_to_the_map_of_a_robot(tmp_path: Path) -> None:
    """Other arrays in the folder do not belong to it, so it holds two formats."""
    (tmp_path / "map.yaml").write_text("image: map.pgm\n")
    Image.fromarray(np.full((4, 4), 255, np.uint8)).save(tmp_path / "map.png")
    assert recognise(tmp_path) == "ros"
    np.save(tmp_path / "stack.npy", np.zeros((2, 3, 4)))
    with pytest.raises(FormatError, match="files of images and ros"):
        recognise(tmp_path)


def read_letters(source: Path, limits: Limits, *, wall: str = "x") -> Collection:
    """Read rows of letters.

    Args:
        source: file.
        limits: of what is read.
        wall: the letter of
            occupied cells.
    """
    cells = np.array(
        [[letter == wall for letter in line] for line in source.read_text().split()], np.uint8
    )
    return Collection([ForeignMap(source.name, cells)])


def test_a_format_of_the_user_can_be_registered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is recognised before the built-in formats and read, and its options become flags."""
    (tmp_path / "a.map").write_text("....\n.#..\n")
    monkeypatch.setattr("mapdata.formats.registry.FORMATS", dict(FORMATS))
    letters = Format("letters", (".map",), read_letters)
    register(letters)
    register(letters)
    with pytest.raises(ValueError, match="'letters' is the name of another format"):
        register(Format("letters"))
    assert recognise(tmp_path) == "letters"
    code, out, _ = cli(capsys, "import", "--help")
    assert code == 0
    assert "letters:\n  Read rows of letters." in out
    assert "the letter of occupied cells (default: x)" in " ".join(out.split())
    assert (
        cli(capsys, "import", tmp_path / "a.map", tmp_path / "out", "--letters.wall", "#")[0] == 0
    )
    shard = next((tmp_path / "out").glob("*.h5"))
    assert read_shard(shard).maps.occupancy[0].tolist() == [[0, 0, 0, 0], [0, 1, 0, 0]]


@pytest.mark.parametrize(
    ("message", "arguments"),
    [
        ("SRC: got an empty name", ["", "out"]),
        ("ROOT: got an empty name", ["stack.npy", ""]),
        (
            "--images.size: got '0x5', expected ROWSxCOLUMNS",
            ["stack.npy", "out", "--images.size", "0x5"],
        ),
        (
            "size: got (5000, 5), expected 1 to",
            ["stack.npy", "out", "--images.size", "5000x5"],
        ),
        (
            "--max-pixels: got 0, expected an integer of at least 1",
            ["stack.npy", "out", "--max-pixels", "0"],
        ),
        ("has 6 x 6 pixels, expected at most 35", ["stack.npy", "out", "--max-pixels", "35"]),
        ("fit: does nothing without size", ["stack.npy", "out", "--images.fit", "crop"]),
        ("--images.fit: invalid choice: 'scale'", ["stack.npy", "out", "--images.fit", "scale"]),
        (
            "--ros.unknown: does nothing for format images",
            ["stack.npy", "out", "--ros.unknown", "free"],
        ),
    ],
)
def test_wrong_usage_of_import_writes_nothing(
    message: str,
    arguments: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """One line names the flag or the file, and the exit code is 2."""
    monkeypatch.chdir(tmp_path)
    np.save("stack.npy", np.zeros((2, 6, 6)))
    code, out, err = cli(capsys, "import", *arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert message in err
    assert [path.name for path in tmp_path.iterdir()] == ["stack.npy"]


def test_an_export_needs_a_target_name_with_the_right_ending(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An empty name is refused, and a name without .npz is quoted as the user wrote it."""
    assert "TARGET: got an empty name" in cli(capsys, "export", root, "", "--format", "ros")[2]
    code, _, err = cli(capsys, "export", root, tmp_path / "x", "--format", "planning-datasets")
    assert (code, err) == (2, f"mapdata: {tmp_path / 'x'}: expected a name that ends with .npz\n")
