"""Links in the sources of an import, whatever the format: never read unless the user says so."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from helpers.foreign_files import SOURCES, YAML, picture
from helpers.wild import cli

from mapdata.formats import Collection, FormatError, read_any, read_problems
from mapdata.formats.registry import functions_by_format

LINK_OUT = "a link to outside the folder; 'cp -rL"
OPTIONS: dict[str, dict[str, Any]] = {"scen": {"scen": True}}
"""What reads all files of a source, if not the default."""
FILES = [(kind, name) for kind, source in SOURCES.items() for name in source.files]


def outcome(read: Callable[..., object], *arguments: object, **options: object) -> str:
    """Return all that a call tells of its files, or its error."""
    try:
        found = read(*arguments, **options)
    except FormatError as error:
        return str(error)
    assert isinstance(found, Collection)
    maps = [
        f"{each.name} {each.grid.tolist()} {each.terrain} {each.seed_points.tolist()}"
        for each in found.maps
    ]
    reasons = [f"{name}: {reason}" for name, reason in found.left_out]
    return "\n".join([*maps, *reasons, *found.notes])


@pytest.mark.parametrize(("kind", "name"), FILES)
def test_no_link_out_of_the_source_is_read(kind: str, name: str, tmp_path: Path) -> None:
    """A file moves away and becomes a link: what it holds makes no difference.

    With ``follow_links`` the maps are those of the folder without links.
    """
    source = SOURCES[kind]
    folder = tmp_path / "source"
    path = folder / "set" / name
    source.write(folder / "set")

    def read(**options: object) -> str:
        return outcome(read_any, folder, source.format, **OPTIONS.get(kind, {}), **options)

    plain = read()
    assert "[[" in plain
    outside = tmp_path / f"outside{path.suffix}"
    shutil.move(path, outside)
    without = read()
    assert without != plain, "the format reads this file"
    path.symlink_to(outside)
    assert read(follow_links=True) == plain
    refused = read()
    assert f"{path}: {LINK_OUT}" in refused
    content = outside.read_bytes()
    outside.write_bytes(b"secret\n" + content[:10])
    assert read() == refused
    path.unlink()
    # A link to a file inside the source is read.
    inside = path.with_name(f".hidden{path.suffix}")
    inside.write_bytes(content)
    path.symlink_to(inside.name)
    assert read() == plain
    # A folder is a link as well.
    path.unlink()
    shutil.move(inside, path)
    shutil.move(path.parent, tmp_path / "outside folder")
    path.parent.symlink_to(tmp_path / "outside folder")
    assert read(follow_links=True) == plain
    assert f"{path.parent}: {LINK_OUT}" in read()


@pytest.mark.parametrize("kind", SOURCES)
def test_a_file_that_the_user_names_may_be_a_link(kind: str, tmp_path: Path) -> None:
    """Its name is the user's own. The files beside it are those beside the link, so a format that
    needs them reads neither maps nor problems.
    """
    source = SOURCES[kind]
    named = source.write(tmp_path / "real")
    (tmp_path / "links").mkdir()
    for path in (tmp_path / "real").iterdir():
        (tmp_path / "links" / path.name).symlink_to(path)
    link = tmp_path / "links" / named.name
    readers: list[Callable[..., Any]] = [lambda **how: read_any(link, source.format, **how).maps]
    if source.format in functions_by_format("problems") and kind != "map":
        split: dict[str, Any] = (
            {"split": "train"} if source.format in ("warcraft", "tilebased") else {}
        )
        readers.append(lambda **how: read_problems(link, **split, **how))
    for read in readers:
        if len(source.files) > 1:
            with pytest.raises(FormatError, match=LINK_OUT):
                read()
        else:
            assert len(read()) >= 1
        assert len(read(follow_links=True)) >= 1


def test_a_folder_of_links_says_why_it_holds_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Links to files and to a folder, one in a circle, and one whose target is not there."""
    for name in ("real", "links"):
        (tmp_path / name).mkdir()
    for name in ("a.png", "b.png"):
        (tmp_path / "real" / name).write_bytes(picture("png"))
        (tmp_path / "links" / name).symlink_to(tmp_path / "real" / name)
    (tmp_path / "links" / "c.png").symlink_to("c.png")
    with pytest.raises(FormatError, match=r"a\.png: a link to outside the folder; 'cp -rL"):
        read_any(tmp_path / "links")
    code, _, errors = cli(capsys, "import", tmp_path / "links", tmp_path / "out")
    assert code == 2
    assert "--follow-links" in errors
    code, output, _ = cli(
        capsys, "import", tmp_path / "links", tmp_path / "out", "--follow-links", "--seed-points", 3
    )
    assert code == 0
    assert "2 of 3 x 4 cells" in output
    (tmp_path / "folders").mkdir()
    (tmp_path / "folders" / "train").symlink_to(tmp_path / "real")
    (tmp_path / "real" / "round").symlink_to(tmp_path / "real")
    with pytest.raises(FormatError, match=r"folders/train: a link to outside the folder"):
        read_any(tmp_path / "folders")
    found = read_any(tmp_path / "folders", follow_links=True)
    assert [foreign_map.split for foreign_map in found.maps] == [0, 0]
    (tmp_path / "real" / "a.png").unlink()
    collection = read_any(tmp_path / "links", follow_links=True)
    reasons = {Path(name).name: reason for name, reason in collection.left_out}
    assert reasons["a.png"] == f"no such file (a link to {tmp_path / 'real' / 'a.png'})"
    assert set(reasons) == {"a.png", "c.png"}


def test_no_folder_is_read_twice_through_links(tmp_path: Path) -> None:
    """A link leads to a folder that holds the folder of the link."""
    source = tmp_path / "all" / "source"
    (source / "in").mkdir(parents=True)
    for folder in (source, source / "in", source.parent):
        (folder / "a.png").write_bytes(picture("png"))
    (source / "up").symlink_to(source.parent)
    names = [foreign_map.name for foreign_map in read_any(source, follow_links=True).maps]
    assert len({Path(name).resolve() for name in names}) == len(names) == 3


def test_a_file_that_is_elsewhere_says_what_fetches_it(tmp_path: Path) -> None:
    """A link of git-annex without its content, and pointers of DVC instead of files."""
    path = tmp_path / "a.png"
    path.symlink_to("../.git/annex/objects/x/y/MD5--z.png")
    for source in (path, tmp_path):
        with pytest.raises(
            FormatError, match=r"no such file.* \(a link to .*git annex get fetches"
        ):
            read_any(source, follow_links=True)
    path.unlink()
    (tmp_path / "a.png.dvc").write_text("outs:\n- md5: 00\n  path: a.png\n")
    (tmp_path / "dvc.yaml").write_text("stages: {}\n")
    for source in (tmp_path / "a.png.dvc", tmp_path):
        with pytest.raises(FormatError, match="pointers of DVC to other files: dvc pull fetches"):
            read_any(source)


def test_a_name_with_dots_is_no_link(tmp_path: Path) -> None:
    """A yaml that names a picture outside its folder is refused even where links are followed."""
    (tmp_path / "in").mkdir()
    (tmp_path / "secret.png").write_bytes(picture("png"))
    (tmp_path / "in" / "map.yaml").write_bytes(YAML.replace(b"a.pgm", b"../secret.png"))
    with pytest.raises(FormatError, match="lies outside the folder of the yaml"):
        read_any(tmp_path / "in" / "map.yaml", follow_links=True)
