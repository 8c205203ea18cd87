"""Links in the sources of an import, whatever the format: never read unless the user says so."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers import weighted
from helpers.wild import cli
from PIL import Image

from mapdata.export import export_problems
from mapdata.formats import Collection, FormatError, export, read_any, read_problems
from mapdata.formats.registry import functions_by_format

GRID = np.pad(np.zeros((6, 7), np.uint8), 1, constant_values=1)


def images(folder: Path, _root: Path) -> None:
    """Write a picture and an array."""
    Image.fromarray(255 * (1 - GRID)).save(folder / "a.png")
    np.save(folder / "b.npy", GRID)


def text(folder: Path, _root: Path) -> None:
    """Write two mazes of letters."""
    letters = "\n".join("".join(".#"[cell] for cell in row) for row in GRID.tolist())
    for name in ("a.txt", "b.txt"):
        (folder / name).write_text(f"{letters}\n")


def tilebased(folder: Path, _root: Path) -> None:
    """Write one split."""
    random = np.random.default_rng(1)
    arrays = weighted.tile_arrays(random, weighted.draw_costs(random, 2, 5, 6))
    np.savez(folder / "train.npz", **arrays)  # type: ignore[arg-type]


def warcraft(folder: Path, _root: Path) -> None:
    """Write one split."""
    costs = weighted.draw_costs(np.random.default_rng(1), 2, 5, 6)
    weighted.write_warcraft(folder, {"train": costs})


def transpath(folder: Path, _root: Path) -> None:
    """Write the test split: four files, of which the labels are not read."""
    for name, cell in (("maps", None), ("starts", (1, 1)), ("goals", (3, 4)), ("focal", (3, 4))):
        array = np.zeros((2, 1, 8, 9), np.uint8)
        array[:, 0] = GRID
        if cell is not None:
            array[:] = 0
            array[:, 0, cell[0], cell[1]] = 1
        (folder / "test").mkdir(exist_ok=True)
        np.save(folder / "test" / f"{name}.npy", array)


def maze_hard(folder: Path, root: Path) -> None:
    """Write two splits."""
    export_problems(root, folder / "set", format="maze-hard", count=2, split="test")


def release(name: str) -> Callable[[Path, Path], None]:
    """Return a function that writes a dataset in a format of maps."""

    def write(folder: Path, root: Path) -> None:
        targets = {"planning-datasets": folder / "set.npz"}
        export(root, targets.get(name, folder / "set"), name)
        for split in ("train", "test"):  # one split is enough
            shutil.rmtree(folder / "set" / split, ignore_errors=True)

    return write


WRITERS: dict[str, Callable[[Path, Path], None]] = {
    "images": images,
    "text": text,
    "tilebased": tilebased,
    "warcraft": warcraft,
    "transpath": transpath,
    "maze-hard": maze_hard,
    "movingai": release("movingai"),
    "ros": release("ros"),
    "planning-datasets": release("planning-datasets"),
}


def test_every_format_is_tested_here() -> None:
    """A new format gets its writer above."""
    assert WRITERS.keys() == functions_by_format("read").keys()


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


@pytest.mark.parametrize("name", WRITERS)
def test_no_link_out_of_the_source_is_read(name: str, square: Path, tmp_path: Path) -> None:
    """Each file in turn moves away and becomes a link: what it holds makes no difference.

    With ``follow_links`` the maps are those of the folder without links.
    """
    folder = tmp_path / "source"
    folder.mkdir()
    WRITERS[name](folder, square)
    options: dict[str, object] = {"scen": True} if name == "movingai" else {}
    plain = outcome(read_any, folder, name, **options)
    assert plain.count("[[") > 1
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    # Of many alike, such as the maps of a folder, the first ones are enough.
    for path in [*paths[:3], *paths[-3:]]:
        outside = tmp_path / f"outside{path.suffix}"
        shutil.move(path, outside)
        content = outside.read_bytes()
        without = outcome(read_any, folder, name, **options)
        path.symlink_to(outside)
        assert outcome(read_any, folder, name, follow_links=True, **options) == plain
        sound = outcome(read_any, folder, name, **options)
        outside.write_bytes(b"secret\n" + content[:10])
        assert outcome(read_any, folder, name, **options) == sound
        if without != plain:  # the format reads this file at all
            assert f"{path}: a link to outside the folder; 'cp -rL" in sound
        path.unlink()
        outside.write_bytes(content)
        shutil.move(outside, path)
    # A folder is a link as well.
    folders = {path.parent for path in paths} - {folder}
    for path in folders:
        shutil.move(path, tmp_path / "outside folder")
        path.symlink_to(tmp_path / "outside folder")
        assert outcome(read_any, folder, name, follow_links=True, **options) == plain
        assert f"{path}: a link to outside the folder" in outcome(read_any, folder, name, **options)
        path.unlink()
        shutil.move(tmp_path / "outside folder", path)
    # A link to a file inside the source is read.
    inside = paths[0].with_name(f".hidden{paths[0].suffix}")
    shutil.move(paths[0], inside)
    paths[0].symlink_to(inside.name)
    assert outcome(read_any, folder, name, **options) == plain


@pytest.mark.parametrize(
    ("name", "linked"), [("warcraft", "train_vertex_weights.npy"), ("transpath", "goals.npy")]
)
def test_problems_are_not_read_through_links(name: str, linked: str, tmp_path: Path) -> None:
    """They are of the formats that read several files for one set."""
    folder = tmp_path / name
    folder.mkdir()
    WRITERS[name](folder, folder)
    (path,) = folder.rglob(linked)
    shutil.move(path, tmp_path / linked)
    path.symlink_to(tmp_path / linked)
    split = "train" if name == "warcraft" else "test"
    with pytest.raises(FormatError, match="a link to outside the folder; 'cp -rL"):
        read_problems(folder, split=split)
    assert len(read_problems(folder, split=split, follow_links=True)) == 2


@pytest.mark.parametrize("name", ["warcraft", "transpath", "images"])
def test_a_file_that_the_user_names_may_be_a_link(name: str, tmp_path: Path) -> None:
    """Its name is the user's own. The files beside it are those beside the link."""
    folder, links = tmp_path / name, tmp_path / f"{name} links"
    folder.mkdir()
    links.mkdir()
    WRITERS[name](folder, folder)
    paths = [path for path in folder.rglob("*") if path.is_file()]
    (named,) = (path for path in paths if path.stem in ("train_vertex_weights", "maps", "a"))
    for path in paths:
        (links / path.name).symlink_to(path)
    if name == "images":
        assert len(read_any(links / named.name, name).maps) == 1
        return
    with pytest.raises(FormatError, match="a link to outside the folder"):
        read_any(links / named.name, name)
    assert len(read_any(links / named.name, name, follow_links=True).maps) == 2


def test_a_folder_of_links_says_why_it_holds_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Links to files and to a folder, and a link whose target is not there."""
    for name in ("real", "links"):
        (tmp_path / name).mkdir()
    images(tmp_path / "real", tmp_path)
    for path in sorted((tmp_path / "real").iterdir()):
        (tmp_path / "links" / path.name).symlink_to(path)
    with pytest.raises(FormatError, match=r"a\.png: a link to outside the folder; 'cp -rL"):
        read_any(tmp_path / "links")
    code, _, errors = cli(capsys, "import", tmp_path / "links", tmp_path / "out")
    assert code == 2
    assert "--follow-links" in errors
    code, output, _ = cli(
        capsys, "import", tmp_path / "links", tmp_path / "out", "--follow-links", "--seed-points", 3
    )
    assert code == 0
    assert "2 of 8 x 9 cells" in output
    (tmp_path / "folders").mkdir()
    (tmp_path / "folders" / "train").symlink_to(tmp_path / "real")
    (tmp_path / "real" / "round").symlink_to(tmp_path / "real")
    with pytest.raises(FormatError, match=r"folders/train: a link to outside the folder"):
        read_any(tmp_path / "folders")
    found = read_any(tmp_path / "folders", follow_links=True)
    assert [foreign_map.split for foreign_map in found.maps] == [0, 0]
    (tmp_path / "real" / "a.png").unlink()
    (reason,) = [why for _, why in read_any(tmp_path / "links", follow_links=True).left_out]
    assert reason == f"no such file (a link to {tmp_path / 'real' / 'a.png'})"


def test_no_folder_is_read_twice_through_links(tmp_path: Path) -> None:
    """A link leads to a folder that holds the folder of the link."""
    source = tmp_path / "all" / "source"
    (source / "in").mkdir(parents=True)
    for folder in (source, source / "in", source.parent):
        images(folder, tmp_path)
    (source / "up").symlink_to(source.parent)
    names = [foreign_map.name for foreign_map in read_any(source, follow_links=True).maps]
    assert len({Path(name).resolve() for name in names}) == len(names) == 6


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
    Image.fromarray(255 * (1 - GRID)).save(tmp_path / "secret.png")
    (tmp_path / "in" / "map.yaml").write_text(
        "image: ../secret.png\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.2\n"
    )
    with pytest.raises(FormatError, match="lies outside the folder of the yaml"):
        read_any(tmp_path / "in" / "map.yaml", follow_links=True)
