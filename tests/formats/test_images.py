"""A folder of pictures and stacks of arrays: what becomes a map, what is left out and why."""

from __future__ import annotations

import struct
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from helpers.examples import examples
from helpers.wild import SETTINGS, Bytes, cli, npy, png
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image, ImageOps
from scipy import ndimage

from mapdata import read_shard
from mapdata.formats import Collection, FormatError, Limits, read_any
from mapdata.formats.files import files_below, natural_key
from mapdata.formats.images import brightness, read, read_pixels
from mapdata.formats.registry import recognise
from mapdata.formats.shrinking import any_occupied
from mapdata.shards import read_manifest

GRID: Bytes = np.array([[0, 0, 1, 1], [0, 1, 1, 0], [0, 0, 0, 0]], np.uint8)
DARK: Bytes = np.where(GRID, np.uint8(10), np.uint8(240)).astype(np.uint8)


def grids(folder: Path, **options: object) -> list[list[list[int]]]:
    """Read a folder and return its grids; nothing may be left out."""
    collection = read(folder, **options)  # type: ignore[arg-type]
    assert collection.left_out == []
    return [foreign_map.grid.tolist() for foreign_map in collection.maps]


def test_dark_is_occupied_in_all_types_of_pictures(tmp_path: Path) -> None:
    """Transparent pixels are free."""
    grey = Image.fromarray(DARK)
    for k, mode in enumerate(("1", "L", "RGB", "RGBA", "P", "LA")):
        grey.convert(mode, dither=Image.Dither.NONE).save(tmp_path / f"{k}.png")
    Image.fromarray(DARK.astype(np.uint16) * 257).save(tmp_path / "6.png")
    grey.save(tmp_path / "7.bmp")
    grey.convert("RGB").resize((32, 24), Image.Resampling.NEAREST).save(
        tmp_path / "8.jpg", quality=95
    )
    (tmp_path / "9.pgm").write_bytes(b"P5 4 3 255\n" + DARK.tobytes())
    hole = Image.fromarray(np.dstack([np.zeros((3, 4, 3), np.uint8), GRID * 255]))
    hole.save(tmp_path / "10.png")
    hole.save(tmp_path / "11.webp", lossless=True, exact=True)
    grey.save(tmp_path / "12.webp", lossless=True)
    for k, mode in enumerate(("1", "L", "RGB", "P", "CMYK", "I;16"), 13):
        picture = Image.fromarray(DARK.astype(np.uint16) * 257)
        if mode != "I;16":
            picture = grey.convert(mode, dither=Image.Dither.NONE)
        picture.save(tmp_path / f"{k}.tif")
    grey.save(tmp_path / "19.tiff", compression="tiff_lzw")
    # of several pictures the first one is read
    grey.save(tmp_path / "20.gif", save_all=True, append_images=[Image.new("L", (4, 3))])
    hole.save(tmp_path / "21.gif")
    assert grids(tmp_path, size=(3, 4)) == [GRID.tolist()] * 22


def test_a_colour_that_stands_for_transparent_is_free(tmp_path: Path) -> None:
    """Optimisers of pictures mark transparent pixels by a colour in grey and RGB pictures."""
    black = Image.fromarray(np.where(GRID, 0, 1).astype(np.uint8))
    black.save(tmp_path / "0.png", transparency=1)
    black.convert("RGB").save(tmp_path / "1.png", transparency=(1, 1, 1))
    assert grids(tmp_path) == [GRID.tolist()] * 2


@pytest.mark.parametrize(
    ("orientation", "turned"),
    [(1, GRID), (3, GRID[::-1, ::-1]), (6, np.rot90(GRID, -1)), (8, np.rot90(GRID))],
)
def test_a_tiff_is_rotated_by_its_orientation_tag(
    orientation: int, turned: npt.NDArray[np.uint8], tmp_path: Path
) -> None:
    """The tag 274 also counts in an uncompressed TIFF."""
    Image.fromarray(DARK).save(tmp_path / "0.tif", tiffinfo={274: orientation})
    assert grids(tmp_path) == [turned.tolist()]


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("photometric", [0, 1])
def test_a_tiff_says_which_end_is_white(photometric: int, bits: int, tmp_path: Path) -> None:
    """Written from the TIFF 6.0 specification (Adobe, 1992, section 3, PhotometricInterpretation):
    under 0 (WhiteIsZero) the number 0 is white, under 1 (BlackIsZero) the largest is.
    """
    largest = 2**bits - 1
    grey = DARK.astype(np.uint16) * (largest // 255)
    samples = (grey if photometric else largest - grey).astype(f"<u{bits // 8}").tobytes()
    rows, columns = DARK.shape
    # a tag and its value: columns, rows, bits, uncompressed, photometric, place and rows of the
    # pixels, channels, their bytes
    first = {256: columns, 257: rows, 258: bits, 259: 1, 262: photometric}
    tags = first | {273: 8, 277: 1, 278: rows, 279: len(samples)}
    data = b"II" + struct.pack("<HL", 42, 8 + len(samples)) + samples
    data += struct.pack("<H", len(tags))
    for tag, value in tags.items():
        data += struct.pack("<HHLL", tag, 4, 1, value)  # a LONG
    (tmp_path / "0.tif").write_bytes(data + bytes(4))
    assert grids(tmp_path) == [GRID.tolist()]
    values, maximum = read_pixels(tmp_path / "0.tif")
    assert maximum == largest
    assert (values[:, :, 0] == grey).all()


def test_pixels_above_the_threshold_are_free(tmp_path: Path) -> None:
    """Inverted, they are occupied."""
    Image.fromarray(np.array([[0, 100, 200, 255]], np.uint8)).save(tmp_path / "a.png")
    assert grids(tmp_path) == [[[1, 1, 0, 0]]]
    assert grids(tmp_path, threshold=0.2) == [[[1, 0, 0, 0]]]
    assert grids(tmp_path, threshold=0.9, invert=True) == [[[0, 0, 0, 1]]]
    for options in (
        {"threshold": 1.5},
        {"threshold": float("nan")},
        {"fit": "stretch"},
        {"fit": "crop"},
        {"resample": "any"},
        {"resample": "any", "size": (1, 1), "fit": "crop"},
    ):
        with pytest.raises(ValueError, match=r"threshold|fit|resample"):
            read_any(tmp_path, **options)


def floor_plan() -> tuple[Bytes, Bytes]:
    """Return a photo of a floor plan, (H, W) brightness, and the plan, 1 where a wall is drawn.

    A shadow lies on its lower right corner, and the camera adds noise.
    """
    plan: Bytes = np.zeros((150, 200), np.uint8)
    for wall in (np.s_[15:20, 15:185], np.s_[130:135, 15:185], np.s_[72:75, 15:185]):
        plan[wall] = 1
    for wall in (np.s_[15:135, 15:20], np.s_[15:135, 180:185], np.s_[15:135, 90:93]):
        plan[wall] = 1
    for door in (np.s_[30:50, 88:95], np.s_[100:120, 88:95], np.s_[70:77, 40:60]):
        plan[door] = 0
    row, column = np.indices(plan.shape)
    light = 0.95 - 0.65 * (0.6 * column / 200 + 0.4 * row / 150)
    noise = np.random.default_rng(0).normal(0, 5, plan.shape)
    photo = np.where(plan, 0.12, 1.0) * light * 255 + noise
    return np.clip(photo, 0, 255).astype(np.uint8), plan


def test_a_photo_is_named_with_its_noise(tmp_path: Path) -> None:
    """The note has the share of pixels near the threshold and the number of specks."""
    photo, plan = floor_plan()
    Image.fromarray(photo).save(tmp_path / "photo.png")
    collection = read(tmp_path)
    (foreign_map,) = collection.maps
    assert (foreign_map.grid != plan).mean() > 0.15
    near = (np.abs(photo / 255 - 0.5) <= 0.1).mean()
    specks = 0
    for kind in (0, 1):
        labels, _ = ndimage.label(foreign_map.grid == kind, np.ones((3, 3)))
        specks += int((np.bincount(labels.ravel())[1:] < 4).sum())
    assert (
        f"{tmp_path / 'photo.png'} looks like a photo: {near:.1%} of the pixels are within 0.1 of "
        f"the threshold, and {specks:,} components have fewer than 4 cells; --images.threshold "
        "local compares each pixel with the mean around it"
    ) in collection.notes
    Image.fromarray(photo).save(tmp_path / "second.png")
    assert any("photo.png and 1 more look like a photo" in note for note in read(tmp_path).notes)


@pytest.mark.parametrize("invert", [False, True])
def test_a_local_threshold_ignores_shadows(invert: bool, tmp_path: Path) -> None:
    """Walls and rooms of a photo are those of the plan; of its negative they are, too."""
    photo, plan = floor_plan()
    Image.fromarray(255 - photo if invert else photo).save(tmp_path / "photo.png")
    collection = read(tmp_path, threshold="local", invert=invert)
    assert (collection.maps[0].grid != plan).mean() < 0.005
    assert not any("like a photo" in note for note in collection.notes)


def test_a_clean_plan_is_no_photo(tmp_path: Path) -> None:
    """Its lines have soft edges, whose pixels are near the threshold."""
    _, plan = floor_plan()
    soft = ndimage.uniform_filter(np.where(plan, 0.0, 255.0), 2)
    Image.fromarray(soft.astype(np.uint8)).save(tmp_path / "plan.png")
    assert not any("like a photo" in note for note in read(tmp_path).notes)


def test_a_local_threshold_is_for_pictures_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Probabilities have no shadows; another word than local is no threshold."""
    np.save(tmp_path / "a.npy", np.full((4, 5), 0.25))
    local = ("--images.threshold", "local")
    code, _, err = cli(capsys, "import", tmp_path / "a.npy", tmp_path / "out", *local)
    assert code == 2
    assert "a.npy: --images.threshold local is for pictures alone" in err
    other = ("--images.threshold", "global")
    code, _, err = cli(capsys, "import", tmp_path / "a.npy", tmp_path / "out", *other)
    assert code == 2
    assert "--images.threshold: got 'global', expected a number or local" in err


def test_heights_in_a_picture_of_16_bits_are_named(tmp_path: Path) -> None:
    """Without white for "no data" nothing of them is bright, which is an error, too."""
    heights = np.arange(400, 600).reshape(10, 20).astype(np.uint16)
    heights[0] = 65535
    Image.fromarray(heights).save(tmp_path / "heights.png")
    ((_, reason),) = read(tmp_path).left_out
    assert reason.startswith("holds 420 to 599, and 65535 for white: it looks like heights or dist")
    Image.fromarray(np.arange(0, 65535, 329, dtype=np.uint16)[:200].reshape(10, 20)).save(
        tmp_path / "heights.png"
    )
    assert len(read(tmp_path).maps) == 1


def test_resize_and_crop(tmp_path: Path) -> None:
    """Resizing keeps blocks of equal pixels, cropping takes the middle, and pictures that are too
    small to crop are left out.
    """
    Image.fromarray(np.kron(DARK, np.ones((2, 2), np.uint8))).save(tmp_path / "a.png")
    assert grids(tmp_path, size=(3, 4)) == [GRID.tolist()]
    assert grids(tmp_path, size=(2, 4), fit="crop") == [
        np.kron(GRID, np.ones((2, 2), int))[2:4, 2:6].tolist()
    ]
    collection = read(tmp_path, size=(7, 4), fit="crop")
    assert collection.maps == []
    assert collection.left_out[0][1] == "has 6 x 8 cells, too small to crop 7 x 4"


@examples(60, SETTINGS)
@given(
    arrays.arrays(
        np.uint8, st.tuples(st.integers(1, 7), st.integers(1, 7)), elements=st.integers(0, 1)
    ),
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
)
def test_a_resized_cell_is_occupied_if_any_part_of_it_is(
    grid: Bytes, size: tuple[int, int]
) -> None:
    """Cells are compared as rectangles, whose corners are fractions."""
    height, width = grid.shape
    rows, columns = size

    def overlap(old: int, old_length: int, new: int, new_length: int) -> bool:
        first = max(Fraction(old, old_length), Fraction(new, new_length))
        last = min(Fraction(old + 1, old_length), Fraction(new + 1, new_length))
        return first < last

    expected = np.zeros(size, int)
    for row, column in np.argwhere(grid).tolist():
        for down in range(rows):
            for right in range(columns):
                if overlap(row, height, down, rows) and overlap(column, width, right, columns):
                    expected[down, right] = 1
    assert any_occupied(grid, size).tolist() == expected.tolist()


@pytest.mark.parametrize("ending", ["png", "npy"])
def test_walls_stay_when_pictures_and_arrays_become_smaller(ending: str, tmp_path: Path) -> None:
    """Sixteen rooms with walls of one pixel stay sixteen. By the mean they become one, and a note
    has both numbers, as scipy counts them, and the share of the free area that was lost.
    """
    plan = np.zeros((256, 256), np.uint8)
    plan[[0, 1, -2, -1]] = plan[:, [0, 1, -2, -1]] = 1
    plan[64::64] = 1
    plan[:, 64::64] = 1
    plan[3:6, 3:6] = 1
    plan[4, 4] = 0  # a speck of one cell, which is not counted
    path = tmp_path / f"plan.{ending}"
    if ending == "npy":
        np.save(path, plan)
    else:
        Image.fromarray(255 * (1 - plan)).save(path)
    for resample, rooms in ((None, 16), ("any", 16), ("mean", 1)):
        collection = read(path, size=(64, 64), resample=resample)  # type: ignore[arg-type]
        grid = collection.maps[0].grid
        assert ndimage.label(grid == 0)[1] == rooms
        lost = 1 - (grid == 0).mean() / (plan == 0).mean()
        change = f"{lost:.1%} of the free area was lost"
        if lost < 0:
            change = f"{-lost:.1%} of free area was added"
        (note,) = [note for note in collection.notes if "components" in note]
        assert note.endswith(f"free cells: 16 before, {rooms} after; {change}")
    (note, _) = read(path, size=(12, 12)).notes
    assert note.endswith("of the free area was lost; shrink less, or use mean (--images.resample)")
    (note, *_) = read(path, size=(12, 12), fit="crop").notes
    assert note.startswith("cropped to 12 x 12 cells: components of at least 16 free cells: 16")
    assert note.endswith("was lost; crop less, or resize (--images.fit)")
    plan[::2] = 1
    grating = tmp_path / "grating.npy"
    np.save(grating, plan)
    reason = "no free cell is left of 64 x 64 cells: shrink less, or use mean (--images.resample)"
    assert read(grating, size=(64, 64)).left_out == [(str(grating), reason)]
    # nothing is said where nothing is resized
    assert not any("components" in note for note in read(path, size=(256, 256)).notes)


@pytest.mark.parametrize("orientation", range(1, 10))
@pytest.mark.parametrize("ending", ["jpg", "png", "webp"])
def test_a_photo_is_turned_as_its_exif_says(orientation: int, ending: str, tmp_path: Path) -> None:
    """Pillow's own function says how; 9 is not defined. The map servers of ROS ignore EXIF."""
    exif = Image.Exif()
    exif[274] = orientation
    large = Image.fromarray(np.kron(DARK, np.ones((16, 16), np.uint8)))
    path = tmp_path / f"photo.{ending}"
    large.save(path, exif=exif, **({"lossless": True} if ending == "webp" else {"quality": 95}))
    with Image.open(path) as stored:
        expected = ImageOps.exif_transpose(stored).convert("L")
    grid = read(path).maps[0].grid
    assert grid.tolist() == (np.asarray(expected) <= 127).astype(int).tolist()
    assert read_pixels(path).values.shape[:2] == (48, 64)


@pytest.mark.parametrize("factor", [2, 4, 6])
def test_pictures_and_arrays_are_resized_alike(factor: int, tmp_path: Path) -> None:
    """By the mean, a cell that is half dark becomes occupied."""
    plan = np.ones((24 * factor, 24 * factor), np.uint8)
    plan[1:-1, 1:-1] = 0
    plan[:, :: 2 * factor] = 1
    noise = np.random.default_rng(factor).integers(0, 2, plan.shape, np.uint8)
    for each in (plan, noise):
        Image.fromarray(255 * (1 - each)).save(tmp_path / "plan.png")
        np.save(tmp_path / "plan.npy", each)
        half = factor * factor / 2
        exact = each.reshape(24, factor, 24, factor).sum(axis=(1, 3)) >= half
        assert grids(tmp_path, size=(24, 24), resample="mean") == [exact.astype(int).tolist()] * 2
        Image.fromarray(255 * each).save(tmp_path / "plan.png")
        np.save(tmp_path / "plan.npy", 1 - each)
        collection = grids(tmp_path, size=(24, 24), invert=True, resample="mean")
        assert collection == [exact.astype(int).tolist()] * 2


def test_arrays_are_imported(tmp_path: Path) -> None:
    """Arrays may have any number type and order, and be one grid or a stack; 1 is occupied."""
    stack = np.stack([GRID, 1 - GRID])
    np.save(tmp_path / "a.npy", stack)
    np.save(tmp_path / "b.npy", np.asfortranarray(GRID.astype(bool)))
    np.savez_compressed(tmp_path / "c.npz", maps=GRID * 0.75, names=np.arange(2))
    assert grids(tmp_path) == [GRID.tolist(), (1 - GRID).tolist(), GRID.tolist(), GRID.tolist()]
    assert grids(tmp_path / "b.npy", invert=True) == [(1 - GRID).tolist()]
    np.savez(tmp_path / "c.npz", a=GRID, b=GRID)
    (left,) = read(tmp_path).left_out
    assert left[1] == (
        "holds arrays a (3, 4), b (3, 4), expected one of (N, H, W); --images.array NAME says "
        "which one"
    )
    np.savez(tmp_path / "c.npz", a=GRID, b=1 - GRID)
    assert grids(tmp_path / "c.npz", array="b") == [(1 - GRID).tolist()]
    assert "holds no array 'c', but a, b" in read(tmp_path / "c.npz", array="c").left_out[0][1]
    with pytest.raises(ValueError, match=r"array: does nothing without an \.npz file"):
        read(tmp_path / "b.npy", array="b")


@pytest.mark.parametrize(
    ("shape", "line"),
    [
        ((2, 4, 5, 3), "values[..., :3].mean(axis=-1) < 128"),
        ((2, 4, 5, 4), "values[..., :3].mean(axis=-1) < 128"),
        ((20,), "values.reshape(rows, columns)"),
    ],
)
def test_an_array_of_another_shape_is_refused_with_the_line_that_helps(
    shape: tuple[int, ...], line: str, tmp_path: Path
) -> None:
    """What the line makes of the array is read."""
    values = np.random.default_rng(0).integers(0, 2, shape)
    np.save(tmp_path / "a.npy", values)
    ((_, complaint),) = read(tmp_path).left_out
    assert line in complaint
    made = eval(line, {"values": values, "rows": 4, "columns": 5})
    np.save(tmp_path / "a.npy", made)
    assert grids(tmp_path) == made.reshape(-1, 4, 5).astype(int).tolist()


def test_folders_give_splits_and_names_give_the_order(tmp_path: Path) -> None:
    """The map map2 comes before map10; hidden and linked folders are not read."""
    for k, folder in enumerate(("Train", "validation", "test/deep", ".hidden")):
        (tmp_path / folder).mkdir(parents=True)
        for name in ("map10.png", "map2.PNG"):
            Image.fromarray(DARK).save(tmp_path / folder / name)
        assert k < 4
    (tmp_path / "link").symlink_to(tmp_path / "test", target_is_directory=True)
    (tmp_path / "folder.png").mkdir()
    collection = read(tmp_path)
    assert sorted(foreign_map.split or 0 for foreign_map in collection.maps) == [0, 0, 1, 1, 2, 2]
    assert [Path(foreign_map.name).name for foreign_map in collection.maps[:2]] == [
        "map2.PNG",
        "map10.png",
    ]
    assert sorted(["a10", "a9b", "a9", "b", "a\u00b2"], key=natural_key)[:2] == ["a9", "a9b"]
    with pytest.raises(FormatError, match="more than 3 files"):
        files_below(tmp_path, (".png",), Limits(files=3), Collection())


MEMORY = """
import resource, sys
from pathlib import Path
import numpy, PIL.Image
from mapdata.formats.images import read_pixels
from mapdata.formats import FormatError, Limits
from mapdata.npy import Npz
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for path in sys.argv[1:]:
    try:
        if path.endswith("npz"):
            Npz(Path(path), 2**26).arrays("a")
        else:
            read_pixels(Path(path), Limits(unpacked=2**26))
    except FormatError as error:
        print(error)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="ru_maxrss is in kilobytes on Linux")
def test_decompression_bombs_take_no_memory(tmp_path: Path) -> None:
    """Bombs of 88 and 400 megapixels and of 128 MiB are refused with less than 50 MB
    more memory.
    """
    import subprocess
    import zipfile

    (tmp_path / "a.png").write_bytes(png(9400, 9400))
    (tmp_path / "b.png").write_bytes(png(20000, 20000))
    with (
        zipfile.ZipFile(tmp_path / "c.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("a.npy", "w", force_zip64=True) as member,
    ):
        member.write(npy((2**27,), b""))
        for _ in range(2):
            member.write(bytes(2**26))
    files = [str(tmp_path / name) for name in ("a.png", "b.png", "c.npz")]
    done = subprocess.run(
        [sys.executable, "-c", MEMORY, *files], capture_output=True, text=True, check=True
    )
    *errors, grown = done.stdout.splitlines()
    assert len(errors) == 3
    assert int(grown) < 50


def test_brightness_is_exact(tmp_path: Path) -> None:
    """It is the mean of the colours, and transparent pixels lie on white."""
    Image.fromarray(np.array([[[255, 0, 0], [10, 20, 30]]], np.uint8)).save(tmp_path / "a.png")
    assert brightness(read_pixels(tmp_path / "a.png")).tolist() == [[85, 20]]
    with pytest.raises(FormatError, match="no such file"):
        read_pixels(tmp_path / "none.png")


@pytest.mark.slow
def test_the_command_imports_pictures_of_two_sizes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two sizes become two datasets, files that are left out are listed, and flags of other formats
    are refused.
    """
    (tmp_path / "in").mkdir()
    Image.fromarray(DARK).save(tmp_path / "in" / "a.png")
    Image.fromarray(np.kron(DARK, np.ones((2, 2), np.uint8))).save(tmp_path / "in" / "b.png")
    (tmp_path / "in" / "c.png").write_bytes(png(9400, 9400))
    Image.fromarray(np.zeros((3, 4), np.uint8)).save(tmp_path / "in" / "d.png")
    assert recognise(tmp_path / "in") == "images"
    code, _, err = cli(
        capsys,
        "import",
        tmp_path / "in",
        tmp_path / "out",
        "--seed-points",
        3,
        "--resolution",
        0.02,
    )
    assert code == 0
    assert err.count("left out: ") == 2
    assert "d.png: has no two connected free cells (0 free in all)" in err
    for size, grid in (("3x4", GRID), ("6x8", np.kron(GRID, np.ones((2, 2), np.uint8)))):
        manifest = read_manifest(tmp_path / "out" / size)
        assert manifest.resolution == 0.02
        labels = read_shard(tmp_path / "out" / size / manifest.shards[0].name)
        assert np.array_equal(labels.maps.occupancy[0], grid)
        assert cli(capsys, "verify", tmp_path / "out" / size)[0] == 0
        assert cli(capsys, "info", tmp_path / "out" / size)[0] == 0
        assert cli(capsys, "show", tmp_path / "out" / size, "-o", tmp_path / "map.png")[0] == 0
    for flags in (
        ("--ros.unknown", "free"),
        ("--movingai.scen",),
        ("--images.fit", "crop"),
        ("--tile", "3"),
        ("--corner-cutting",),
    ):
        assert cli(capsys, "import", tmp_path / "in", tmp_path / "no", *flags)[0] == 2
    assert not (tmp_path / "no").exists()
    code, _, err = cli(capsys, "import", tmp_path / "nothing", tmp_path / "no")
    assert (code, "no such file or folder" in err) == (2, True)
    (tmp_path / "in" / "e.map").write_text("x")
    code, _, err = cli(capsys, "import", tmp_path / "in", tmp_path / "no")
    assert (code, "files of images and movingai; --format says which" in err) == (2, True)


def test_masks_of_zero_and_one_are_not_taken_for_black(tmp_path: Path) -> None:
    """Their brightest pixel is 1 of 255, so they are left out with advice, and read with a lower
    threshold.
    """
    Image.fromarray(1 - GRID).save(tmp_path / "mask.png")
    collection = read(tmp_path, invert=True)
    assert collection.maps == []
    assert (
        "brightest pixel is 1 of 255, nothing is above --images.threshold 0.5"
        in collection.left_out[0][1]
    )
    assert grids(tmp_path, threshold=0.0) == [GRID.tolist()]
    for mask in (np.uint16(1 - GRID), np.stack([1 - GRID, 0 * GRID, 0 * GRID], axis=2)):
        Image.fromarray(mask).save(tmp_path / "mask.png")
        assert "brightest pixel is 1 of 255" in read(tmp_path).left_out[0][1]
        assert grids(tmp_path, threshold=0.0) == [GRID.tolist()]


def test_stacks_may_have_one_channel(tmp_path: Path) -> None:
    """A stack of shape (N, 1, H, W) is read, one of two channels is refused, and the limit counts
    the cells of one map.
    """
    np.savez(tmp_path / "a.npz", maps=np.stack([GRID, 1 - GRID])[:, None], labels=np.arange(2))
    assert grids(tmp_path) == [GRID.tolist(), (1 - GRID).tolist()]
    assert read(tmp_path, Limits(pixels=11)).maps == []
    np.savez(tmp_path / "a.npz", maps=np.zeros((3, 2, 4, 4)))
    assert read(tmp_path).maps == []


ROOM: Bytes = np.pad(np.zeros((4, 6), np.uint8), 1, constant_values=1)


@pytest.mark.parametrize("ending", ["png", "bmp", "npy"])
def test_a_note_says_which_cells_are_free(ending: str, tmp_path: Path) -> None:
    """It has the share of free cells; if the borders of most maps are free, a note says how to
    invert them.
    """

    def notes(cells: Bytes, **options: bool) -> list[str]:
        path = tmp_path / f"a.{ending}"
        if ending == "npy":
            np.save(path, cells)
        else:
            Image.fromarray(255 * (1 - cells)).save(path)
        return read(path, **options).notes  # type: ignore[arg-type]

    told = "bright pixels (0 in arrays) were taken for free: 50.0% of a map"
    assert notes(ROOM) == [told]
    first, warning = notes(1 - ROOM)
    assert first == told
    assert warning.startswith("the border of 1 of 1 maps is mostly free")
    assert "--images.invert" in warning
    told = "dark pixels (1 in arrays) were taken for free: 50.0% of a map"
    assert notes(1 - ROOM, invert=True) == [told]


PLAN: Bytes = np.pad(ROOM, 2)
"""A room with paper around it."""


@pytest.mark.parametrize("invert", [False, True])
@pytest.mark.parametrize("resample", [None, "mean"])
@pytest.mark.parametrize("ending", ["png", "npy"])
def test_the_paper_around_a_plan_can_be_closed(
    ending: str, resample: str | None, invert: bool, tmp_path: Path
) -> None:
    """Only the inside of the room stays free, and the note on free borders names the option."""
    path = tmp_path / f"a.{ending}"
    cells = 1 - PLAN if invert else PLAN
    if ending == "npy":
        np.save(path, cells)
    else:
        Image.fromarray(255 * (1 - cells)).save(path)
    options: dict[str, Any] = {"invert": invert}
    plain = read(path, **options)
    assert np.array_equal(plain.maps[0].grid, PLAN)
    assert any("--images.outside occupied" in note for note in plain.notes)
    if resample is not None:
        rows, columns = PLAN.shape
        options |= {"size": (2 * rows, 2 * columns), "resample": resample}
    closed = read(path, outside="occupied", **options)
    expected = np.pad(np.zeros((4, 6), np.uint8), 3, constant_values=1)
    if resample is not None:
        expected = expected.repeat(2, 0).repeat(2, 1)
    assert np.array_equal(closed.maps[0].grid, expected)
    share = 1 - 24 / np.count_nonzero(PLAN == 0)
    assert f"{share:.1%} of the free cells were connected to the edge" in closed.notes[-1]
    assert not any("border" in note for note in closed.notes)
    same = read(path, outside="free", **options)
    assert np.array_equal(same.maps[0].grid.mean(), plain.maps[0].grid.mean())
    assert not any("border" in note for note in same.notes)


def test_paper_on_both_sides_of_a_plan_is_closed(tmp_path: Path) -> None:
    """A plan that reaches from edge to edge divides the paper; a diagonal gap lets nothing in."""
    plan = np.zeros((7, 6), np.uint8)
    plan[[1, 5]] = plan[:, [0, -1]] = 1
    plan[[0, -1], 0] = 0
    plan[1, 0] = 0
    np.save(tmp_path / "a.npy", plan)
    (foreign_map,) = read(tmp_path, outside="occupied").maps
    expected = np.ones_like(plan)
    expected[2:5, 1:-1] = 0
    assert np.array_equal(foreign_map.grid, expected)


def test_a_plan_with_an_open_door_is_no_silent_ruin(tmp_path: Path) -> None:
    """Nothing is left inside, or a small room alone: an error or a note says why."""
    plan = PLAN.copy()
    plan[2, 5] = 0
    Image.fromarray(255 * (1 - plan)).save(tmp_path / "a.png")
    ((_, reason),) = read(tmp_path, outside="occupied").left_out
    assert reason.startswith("no free cell is left inside: all are connected to the edge")
    plan[3, 3] = 0
    plan[[3, 4], [4, 3]] = 1  # a closet in the corner
    Image.fromarray(255 * (1 - plan)).save(tmp_path / "a.png")
    *_, note = read(tmp_path, outside="occupied").notes
    assert "of 1 of 1 maps" in note
    assert "less than 20% is left, perhaps because a door or window" in note


@pytest.mark.parametrize(
    ("name", "content", "hint"),
    [
        ("a.png", b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n", "git lfs pull"),
        ("a.npy", b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n", "git lfs pull"),
        ("a.npz", b"/annex/objects/SHA256E-s1--00.npz\n", "git annex get"),
        ("a.png", b"../.git/annex/objects/x/y", "git annex get"),
        ("a.jpg", b"<!doctype html>\n<html>", "a web page: download the file itself"),
        ("a.npy", b"\x89PNG\r\n\x1a\n", "its name should end with .png"),
        ("a.npz", b"\x93NUMPY\1\0", "its name should end with .npy"),
        ("a.npy", b"0.0 1.0 1.0\n", "plain text: its name should end with .txt or .csv"),
    ],
)
def test_a_file_that_is_another_one_is_named(
    name: str, content: bytes, hint: str, tmp_path: Path
) -> None:
    """Pointers of Git LFS and git-annex, web pages, and files with another's ending."""
    (tmp_path / name).write_bytes(content)
    ((_, reason),) = read(tmp_path).left_out
    assert "; it looks like " in reason
    assert hint in reason


@pytest.mark.parametrize("data", [b"P5\n8 6\n255\n", b"P5 8 6 65535\n"])
def test_unknown_cells_of_a_robots_map_are_refused_without_an_option(
    data: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In a .pgm without its .yaml, unknown cells of grey 205 are brighter than the threshold and
    would be free.
    """
    pixels = np.where(ROOM, 0, 254).astype(np.uint8)
    pixels[1, 1:6] = 205
    path = tmp_path / "map.pgm"
    if b"65535" in data:
        path.write_bytes(data + (pixels.astype(">u2") * 257).tobytes())
    else:
        path.write_bytes(data + pixels.tobytes())
    code, _, err = cli(capsys, "import", path, tmp_path / "none")
    assert code == 2
    assert "map.pgm: 10.4% of its pixels are of grey 205" in err
    assert "import its .yaml, or say --images.unknown occupied or --images.unknown free" in err
    path.with_suffix(".yaml").write_text("image: map.pgm")
    assert f"import {tmp_path / 'map.yaml'}, or say" in read(path).left_out[0][1]
    for unknown, is_occupied in (("occupied", pixels < 254), ("free", pixels < 205)):
        collection = read(path, unknown=unknown)  # type: ignore[arg-type]
        assert collection.maps[0].grid.tolist() == is_occupied.tolist()
        assert f"10.4% of the cells were unknown and are now {unknown}" in collection.notes
        collection = read(path, unknown=unknown, invert=True)  # type: ignore[arg-type]
        assert (
            collection.maps[0].grid.tolist()
            == ((pixels == 254) | ((pixels == 205) & (unknown == "occupied"))).tolist()
        )
    # a threshold above 205 says it, too
    collection = read(path, threshold=0.85)
    assert collection.maps[0].grid.tolist() == (pixels < 254).tolist()


def test_unknown_cells_are_replaced_before_pictures_are_scaled(tmp_path: Path) -> None:
    """A cell that is half unknown counts by half as what unknown cells become."""
    pixels = np.full((4, 4), 254, np.uint8)
    pixels[:, 1] = 205
    pixels[0, 3] = 0
    Image.fromarray(pixels).save(tmp_path / "a.png")
    for unknown, expected in (("occupied", [[1, 0], [1, 0]]), ("free", [[0, 0], [0, 0]])):
        collection = read(tmp_path, unknown=unknown, size=(2, 2), resample="mean")  # type: ignore[arg-type]
        assert collection.maps[0].grid.tolist() == expected


def test_the_greys_of_a_floor_plan_are_not_unknown(tmp_path: Path) -> None:
    """At the edges of lines 205 is one of many greys; pictures of 0 and 254 only are
    read as well.
    """
    pixels = np.full((16, 16), 255, np.uint8)
    pixels[4] = np.arange(0, 256, 16)
    pixels[5, :2] = 205
    plan = Image.fromarray(pixels)
    plan.save(tmp_path / "plan.png")
    Image.fromarray(np.where(ROOM, 0, 254).astype(np.uint8)).save(tmp_path / "map.pgm")
    for options in ({}, {"unknown": "occupied"}):
        collection = read(tmp_path, **options)  # type: ignore[arg-type]
        assert collection.left_out == []
        assert collection.maps[1].grid.tolist() == (pixels <= 127).tolist()
        assert collection.maps[0].grid.tolist() == ROOM.tolist()
        assert not any("unknown" in note for note in collection.notes)


def test_a_progress_bar_counts_the_files_on_request(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without the request nothing is shown."""
    for k in range(3):
        Image.fromarray(DARK).save(tmp_path / f"{k}.png")
    assert len(read(tmp_path).maps) == 3
    assert capsys.readouterr().err == ""
    assert len(read(tmp_path, Limits(progress=True)).maps) == 3
    assert "3/3" in capsys.readouterr().err
