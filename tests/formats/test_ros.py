"""ROS maps: the servers' own rule pixel by pixel, pictures as they exist, faults of a yaml."""

from __future__ import annotations

import math
import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from helpers.examples import examples
from helpers.wild import SETTINGS, Bytes, cli
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image
from scipy import ndimage

from mapdata import astar, read_shard, to_metres
from mapdata.formats import FormatError, export, read_any
from mapdata.formats.images import Pixels, read_pixels
from mapdata.formats.registry import recognise
from mapdata.formats.ros import RosMap, _classify, read, read_map, resampled
from mapdata.shards import read_manifest

YAML = """image: {image}
resolution: 0.050000
origin: [-12.200000, -12.200000, 0.000000]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
# Free 254, occupied 0, unknown 205, as map_saver writes them.
ROWS = [[254, 254, 0], [205, 254, 254]]
CELLS = [[0, 0, 100], [-1, 0, 0]]
P5 = b"P5\n# CREATOR: Map_generator.cpp 0.050 m/pix\n3 2\n255\n" + bytes(ROWS[0] + ROWS[1])
P2 = b"P2 # text\n3 2\n# maximum follows\n255\n254 254 0\n205 # unknown\n254 254\n"
P5_16 = b"P5 3 2 65535\n" + (np.array(ROWS) * 257).astype(">u2").tobytes()
P2_MAX = b"P2\n3 2\n127\n127 127 0 102 127 127"


def write(folder: Path, picture: bytes = P5, name: str = "map.pgm", **fields: str) -> Path:
    """Write a map; fields replace or add lines of its yaml."""
    (folder / name).write_bytes(picture)
    lines = dict(line.split(": ", 1) for line in YAML.format(image=name).splitlines())
    (folder / "map.yaml").write_text(
        "".join(f"{key}: {text}\n" for key, text in {**lines, **fields}.items())
    )
    return folder / "map.yaml"


@pytest.mark.parametrize(
    "image", [P5, P2, P5_16, P2_MAX], ids=["P5", "P2", "16 bit", "maximum 127"]
)
def test_variants_of_pgm_are_read(image: bytes, tmp_path: Path) -> None:
    """They are binary and text, with comments anywhere in the header, two bytes a pixel and another
    maximum.
    """
    ros_map = read_map(write(tmp_path, image))
    assert ros_map.cells.tolist() == CELLS
    assert (ros_map.resolution, ros_map.origin) == (0.05, (-12.2, -12.2, 0.0))


@pytest.mark.parametrize(
    ("picture_format", "mode"),
    [
        *(("png", mode) for mode in ("L", "RGB", "RGBA", "P", "I;16", "LA")),
        *(("bmp", m) for m in ("L", "RGB", "RGBA", "P")),
    ],
)
def test_types_of_pictures_are_read(mode: str, picture_format: str, tmp_path: Path) -> None:
    """They are grey, colour, palette, 16 bits, and alpha, which the servers count as a white
    channel.
    """
    grey = Image.fromarray(np.array(ROWS, np.uint8))
    picture = (
        Image.fromarray((np.array(ROWS, np.uint16) * 257).astype(np.uint16))
        if mode == "I;16"
        else grey.convert(mode)
    )
    picture.save(tmp_path / f"map.{picture_format}")
    ros_map = read_map(
        write(tmp_path, (tmp_path / f"map.{picture_format}").read_bytes(), f"map.{picture_format}")
    )
    # With alpha, (3 * 205 + 255) / 4 = 217.5 is below the free threshold, and both servers make it
    # free. But as 205 is a main grey of this map, it is unknown.
    assert ros_map.cells.tolist() == CELLS


@pytest.mark.parametrize(
    ("colour", "mode", "unknown", "reason"),
    [
        (0, "trinary", None, "no cell is free: 80.0% of the picture is transparent, which no map"),
        (255, "trinary", None, "80.0% of its cells are unknown, and 80.0% are transparent, which"),
        (255, "scale", None, "80.0% of its cells are unknown, and 80.0% are transparent, which no"),
        (255, "scale", "occupied", "no cell is free: 80.0% of the picture is transparent, which"),
    ],
)
def test_free_space_that_is_transparent_is_named(
    colour: int, mode: str, unknown: str | None, reason: str, tmp_path: Path
) -> None:
    """Programs that draw floor plans leave the paper transparent; both map servers count the alpha
    as a colour or take the pixel for unknown.
    """
    pixels = np.full((5, 5, 4), (colour, colour, colour, 0), np.uint8)
    pixels[0] = (0, 0, 0, 255)
    Image.fromarray(pixels).save(tmp_path / "map.png")
    path = write(tmp_path, (tmp_path / "map.png").read_bytes(), "map.png", mode=mode)
    with pytest.raises(FormatError, match=re.escape(reason)):
        read_any(path, unknown=unknown)


def test_transparent_pixels_beside_free_ones_are_no_error(tmp_path: Path) -> None:
    """The world around a building may be transparent, and is occupied then."""
    pixels = np.full((5, 5, 4), 0, np.uint8)
    pixels[1:4, 1:4] = 255
    Image.fromarray(pixels).save(tmp_path / "map.png")
    path = write(tmp_path, (tmp_path / "map.png").read_bytes(), "map.png")
    (foreign_map,) = read_any(path).maps
    assert foreign_map.grid.sum() == 16


def slow(
    pixel: tuple[int, ...], white: int, mode: str, negate: bool, low: float, high: float
) -> int:
    """Return map_server's value of one pixel, written after its C++."""
    colours = pixel[:3]
    channels = pixel if mode == "trinary" else colours
    shade = sum(channels) / len(channels) / white
    occupied = shade if negate else 1.0 - shade
    if mode == "raw":
        value = round(shade * 255)
        return value if value <= 100 else -1
    if mode == "scale" and len(pixel) == 4 and pixel[3] < white:
        return -1
    if occupied > high:
        return 100
    if occupied < low:
        return 0
    return -1 if mode == "trinary" else round((occupied - low) / (high - low) * 100)


@examples(150, SETTINGS)
@given(
    arrays.arrays(np.uint8, st.tuples(st.just(2), st.integers(1, 5), st.sampled_from([1, 3, 4]))),
    st.sampled_from(["trinary", "scale", "raw"]),
    st.booleans(),
    st.floats(0, 0.99),
    st.floats(0, 0.99),
)
def test_cells_follow_the_servers_rule_for_any_pixel(
    values: Bytes, mode: str, negate: bool, first_threshold: float, second_threshold: float
) -> None:
    """The thresholds are any numbers, too."""
    low = min(first_threshold, second_threshold)
    high = max(first_threshold, second_threshold) + 0.01
    cells = _classify(Pixels(values, 255), mode, negate and mode != "raw", low, high)
    for row in range(values.shape[0]):
        for column in range(values.shape[1]):
            pixel = tuple(values[row, column].tolist())
            assert cells[row, column] == slow(pixel, 255, mode, negate and mode != "raw", low, high)


def test_negate_and_thresholds(tmp_path: Path) -> None:
    """Negate swaps black and white, thresholds are strict, and the text 5e-2 is a number."""
    assert read_map(write(tmp_path, negate="1")).cells.tolist() == [[100, 100, 0], [100, 100, 100]]
    assert read_map(write(tmp_path, negate="true")).cells.tolist() == [
        [100, 100, 0],
        [100, 100, 100],
    ]
    assert read_map(write(tmp_path, occupied_thresh="1.0")).cells.tolist() == [
        [0, 0, -1],
        [-1, 0, 0],
    ]
    assert read_map(write(tmp_path, resolution="5e-2")).resolution == 0.05
    assert (
        read_map(write(tmp_path, mode="scale")).cells[1, 0] == 0
    )  # (50 / 255 - 0.196) / 0.454 is 0.02 %
    assert read_map(write(tmp_path, mode="scale", free_thresh="0.1")).cells[1, 0] == 17


FREE, OCCUPIED, UNKNOWN = 254, 0, 205
"""The greys of map_saver."""


def saved_map(unknown_share: float = 0.5, free_grey: int = FREE) -> Bytes:
    """Return a picture (20, 50) of map_saver; of each 100 cells 20 are occupied."""
    greys = np.full(1000, free_grey, np.uint8)
    greys[:200] = OCCUPIED
    greys[200 : 200 + round(1000 * unknown_share)] = UNKNOWN
    return np.random.default_rng(0).permutation(greys).reshape(20, 50)


def pgm(greys: Bytes) -> bytes:
    """Return a picture as a PGM."""
    return b"P5 %d %d 255\n" % greys.shape[::-1] + greys.tobytes()


@pytest.mark.parametrize(
    ("fields", "state"),
    [
        ({"free_thresh": "0.25"}, "free"),
        ({"free_thresh": "0.25", "mode": "trinary"}, "free"),
        ({"free_thresh": "0.1", "occupied_thresh": "0.15"}, "occupied"),
    ],
)
def test_grey_205_is_unknown_in_a_map_of_map_saver(
    fields: dict[str, str], state: str, tmp_path: Path
) -> None:
    """The thresholds do not count: map_saver of Nav2 writes 0.25 beside such a picture."""
    greys = saved_map()
    path = write(tmp_path, pgm(greys), **fields)
    assert np.array_equal(read_map(path).cells == -1, greys == UNKNOWN)
    with pytest.raises(
        FormatError,
        match=r"50.0% of its cells are unknown \(grey 205, as map_saver writes them, although the "
        rf"thresholds make it {state}\): say --ros.unknown occupied or",
    ):
        read_any(path)
    for unknown, expected in (
        ("occupied", greys != FREE),
        ("free", greys == OCCUPIED),
    ):
        collection = read_any(path, unknown=unknown)
        assert np.array_equal(collection.maps[0].grid, expected)
        assert np.array_equal(read_map(path).grid(unknown), expected)  # type: ignore[arg-type]
        assert (
            f"grey 205 is unknown in 1 of 1 maps ({path}), as map_saver writes it, although their "
            f"thresholds make it {state}" in collection.notes
        )
        # the picture without its .yaml is the same map
        alone = read_any(tmp_path / "map.pgm", unknown=unknown)
        assert np.array_equal(alone.maps[0].grid, expected)
    with pytest.raises(
        FormatError, match=r"50.0% of its pixels are of grey 205.*import .*map.yaml"
    ):
        read_any(tmp_path / "map.pgm")


@pytest.mark.parametrize(
    ("greys", "fields", "value"),
    [
        (saved_map(0.009), {}, 0),  # too few unknown cells
        (saved_map(0.01), {}, -1),
        (saved_map(0.01, free_grey=250), {}, -1),
        (saved_map(free_grey=249), {}, 0),  # no grey of free cells
        (saved_map(), {"mode": "scale"}, 0),
        (saved_map(), {"mode": "raw"}, -1),  # 205 is above 100
        (saved_map(), {"negate": "1"}, 100),
    ],
)
def test_the_yaml_decides_on_205_in_other_pictures(
    greys: Bytes, fields: dict[str, str], value: int, tmp_path: Path
) -> None:
    """Both greys have to fill 1 % of a map in mode trinary, in which white is free."""
    path = write(tmp_path, pgm(greys), free_thresh="0.25", **fields)
    assert (read_map(path).cells[greys == UNKNOWN] == value).all()
    if value == 0:
        notes = read_any(path, unknown="occupied").notes
        assert not any("205" in note for note in notes)


def test_a_map_gives_its_grid(tmp_path: Path) -> None:
    """Unknown cells need a word, and only two words are known."""
    ros_map = read_map(write(tmp_path))
    assert ros_map.grid("free").tolist() == [[0, 0, 1], [0, 0, 0]]
    assert ros_map.grid("occupied").tolist() == [[0, 0, 1], [1, 0, 0]]
    with pytest.raises(ValueError, match=r"unknown: 16.7% of its cells are unknown: expected 'occ"):
        ros_map.grid()
    with pytest.raises(ValueError, match="unknown: got 'wall', expected one of occupied, free"):
        ros_map.grid("wall")  # type: ignore[arg-type]
    with pytest.raises(
        ValueError, match=r"got a RosMap, .*; ros_map.grid\(unknown=...\) makes one"
    ):
        astar(ros_map, (0, 0), (0, 1))  # type: ignore[arg-type]


def test_few_unknown_cells_are_not_called_none(tmp_path: Path) -> None:
    """One cell of 10,000 is less than 0.1 %."""
    greys = np.full((100, 100), FREE, np.uint8)
    greys[0, 0] = 100
    path = write(tmp_path, pgm(greys))
    with pytest.raises(FormatError, match=r"less than 0\.1% of its cells are unknown"):
        read_any(path)
    notes = read_any(path, unknown="occupied").notes
    assert "less than 0.1% of the cells were unknown and are now occupied" in notes
    assert any("free: more than 99.9% of a map" in note for note in notes)
    # the border is free, and the .yaml says so
    assert not any("border" in note for note in notes)


@pytest.mark.parametrize("yaw", ["nan", "-nan", ".nan"])
def test_a_yaw_of_nan_is_refused_where_it_is_used(yaw: str, tmp_path: Path) -> None:
    """Old versions of map_saver write it, and an import needs no origin."""
    path = write(tmp_path, origin=f"[1.0, 2.0, {yaw}]")
    assert len(read_any(path, unknown="free").maps) == 1
    ros_map = read_map(path)
    with pytest.raises(ValueError, match="origin"):
        ros_map.to_metres(cells=(0, 0))
    with pytest.raises(ValueError, match="origin"):
        ros_map.to_cells([1.01, 2.01])


def test_a_map_without_free_cells_left_is_refused(tmp_path: Path) -> None:
    """The reason is the resampling, and not the map."""
    greys = np.full((40, 40), FREE, np.uint8)
    greys[::2] = OCCUPIED
    path = write(tmp_path, pgm(greys), resolution="0.1")
    with pytest.raises(
        FormatError, match=r"no free cell is left of 20 x 20 cells: shrink less, or"
    ):
        read_any(path, resolution=0.2)
    assert len(read_any(path, resolution=0.1).maps) == 1


@pytest.mark.parametrize("resample", [None, "mean"])
def test_a_note_says_what_resampling_does_to_walls(resample: str | None, tmp_path: Path) -> None:
    """It counts components as scipy does, and the lost share of the area in square metres."""
    greys = np.full((120, 120), FREE, np.uint8)
    greys[[0, 60, 119]] = greys[:, [0, 60, 119]] = OCCUPIED
    path = write(tmp_path, pgm(greys), resolution="0.1")
    collection = read_any(path, resolution=0.4, resample=resample)
    grid = collection.maps[0].grid
    after = 1 if resample else 4
    assert ndimage.label(grid == 0)[1] == after
    lost = 1 - (grid == 0).sum() * 0.4**2 / ((greys == FREE).sum() * 0.1**2)
    change = f"{lost:.1%} of the free area was lost"
    if lost < 0:
        change = f"{-lost:.1%} of free area was added"
    note = (
        "resampled to 0.4 metres per cell: components of at least 16 free cells: 4 before, "
        f"{after} after; {change}"
    )
    assert note in collection.notes
    greys[1::8] = greys[2::8] = OCCUPIED
    write(tmp_path, pgm(greys), resolution="0.1")
    advice = "lost; shrink less" if resample else "lost; shrink less, or use --ros.resample mean"
    assert any(
        note.endswith(advice) for note in read_any(path, resolution=0.4, resample=resample).notes
    )


def test_metres_are_measured_from_the_origin(tmp_path: Path) -> None:
    """The origin is the lower left corner, row 0 is on top, and yaw rotates about the origin."""
    ros_map = read_map(write(tmp_path, origin="[1.0, 2.0, 0.0]"))
    assert ros_map.to_metres(cells=(1, 0)) == pytest.approx([1.025, 2.025])
    assert ros_map.to_metres(points=(0.5, 2.5)) == pytest.approx([1.125, 2.075])
    with pytest.raises(ValueError, match="points and cells: got neither"):
        ros_map.to_metres()
    turned = read_map(write(tmp_path, origin="[1.0, 2.0, 1.5707963267948966]"))
    assert turned.to_metres(cells=(0, 2)) == pytest.approx([1 - 0.075, 2.125])


@pytest.mark.parametrize("yaw", [0.0, 0.3, 1.5707963267948966, -2.5])
def test_points_in_metres_lie_in_cells(yaw: float, tmp_path: Path) -> None:
    """The middle of each cell, and points near its corners, lie in that cell."""
    ros_map = read_map(write(tmp_path, origin=f"[1.0, -2.0, {yaw}]"))
    cells = np.argwhere(np.ones_like(ros_map.cells))
    middles = ros_map.to_metres(cells=cells)
    assert np.array_equal(ros_map.to_cells(middles), cells)
    assert ros_map.to_cells(middles.reshape(2, 3, 2)).shape == (2, 3, 2)
    assert ros_map.to_cells(middles[4]).tolist() == [1, 1]
    for offset in ((0.45, 0.45), (-0.45, 0.45), (-0.45, -0.45)):
        corners = to_metres(
            points=cells + 0.5 + offset, rows=2, resolution=0.05, origin=ros_map.origin
        )
        assert np.array_equal(ros_map.to_cells(corners), cells)
    outside = ros_map.to_metres(points=[[0.5, 0.5], [2.1, 0.5]])
    with pytest.raises(ValueError, match="outside of the map of 2 x 3 cells"):
        ros_map.to_cells(outside)
    with pytest.raises(ValueError, match="outside of the map"):
        ros_map.to_cells([np.nan, 0])
    with pytest.raises(ValueError, match=r"metres: got shape \(3,\), expected \(..., 2\)"):
        ros_map.to_cells([1.0, 2.0, 0.0])


def test_values_between_the_thresholds_are_not_called_unknown(tmp_path: Path) -> None:
    """In mode scale a grey pixel is between free and occupied."""
    path = write(tmp_path, mode="scale", free_thresh="0.1")
    with pytest.raises(FormatError, match=r"16.7% of its cells are between free and occupied: say"):
        read_any(path)


def test_a_map_that_is_left_out_is_an_error_with_the_reason(tmp_path: Path) -> None:
    """Beside another map it is one of those left out."""
    path = write(tmp_path)
    with pytest.raises(FormatError, match=r"no map can be used: .*16.7% of its cells are unknown"):
        read_any(path)
    (tmp_path / "good.pgm").write_bytes(b"P5 2 1 255\n\xfe\xfe")
    (tmp_path / "good.yaml").write_text(YAML.format(image="good.pgm"))
    collection = read_any(tmp_path, "ros")
    assert (len(collection.maps), len(collection.left_out)) == (1, 1)


def test_an_export_says_that_the_origin_is_not_kept(root: Path, tmp_path: Path) -> None:
    """A dataset does not store it."""
    notes = export(root, tmp_path / "out", "ros")
    assert any("the origin of each .yaml is [0, 0, 0]" in note for note in notes)


def test_unknown_cells_are_refused_or_noted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without an option the map is refused with its share of unknown cells; with it a note says
    what they became.
    """
    path = write(tmp_path)
    code, _, err = cli(capsys, "import", path, tmp_path / "no")
    assert code == 2
    assert "16.7% of its cells are unknown: say --ros.unknown occupied or --ros.unknown free" in err
    for word, value in (("occupied", 1), ("free", 0)):
        code, out, _ = cli(
            capsys, "import", path, tmp_path / word, "--ros.unknown", word, "--seed-points", 2
        )
        assert code == 0
        assert f"16.7% of the cells were unknown and are now {word}" in out
        manifest = read_manifest(tmp_path / word)
        assert manifest.resolution == 0.05
        grid = read_shard(tmp_path / word / manifest.shards[0].name).maps.occupancy[0]
        assert grid.tolist() == [[0, 0, 1], [value, 0, 0]]


@pytest.mark.parametrize(
    "pixels",
    [
        [[254, 254, 255], [205, 254, 255]],  # white: no area; all of it is unknown in this mode
        [[0, 0, 255], [255, 255, 255]],
        [[0, 40, 60], [0, 0, 40]],
    ],
)
def test_a_filter_mask_is_refused(
    pixels: list[list[int]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A mask of keepout zones or speed limits is named as one, whatever unknown cells are to
    become.
    """
    path = write(tmp_path, b"P5 3 2 255\n" + np.array(pixels, np.uint8).tobytes(), mode="raw")
    for options in ((), ("--ros.unknown", "free")):
        code, _, err = cli(capsys, "import", path, tmp_path / "out", *options)
        assert code == 2
        assert "map.yaml: mode: raw, a filter mask, not a map" in err
    assert read_map(path).mode == "raw"


def test_a_map_that_was_saved_raw_is_read(tmp_path: Path) -> None:
    """Its pixels are 0 and 100, and 255 for unknown cells."""
    pixels = np.array([[0, 0, 100], [255, 0, 0]], np.uint8)
    path = write(tmp_path, b"P5 3 2 255\n" + pixels.tobytes(), mode="raw")
    assert "16.7% of its cells are unknown" in read(path).left_out[0][1]
    assert read(path, unknown="free").maps[0].grid.tolist() == [[0, 0, 1], [0, 0, 0]]
    pixels[1, 0] = 100
    write(tmp_path, b"P5 3 2 255\n" + pixels.tobytes(), mode="raw")
    assert read(path).maps[0].grid.tolist() == [[0, 0, 1], [1, 0, 0]]


@pytest.mark.parametrize("cell", [(1000, 1), (1, 1000), (-1, -1)])
def test_cells_outside_of_the_map_have_no_metres(cell: tuple[int, int], tmp_path: Path) -> None:
    """As `to_cells` refuses points outside; the padding of paths is outside, too."""
    ros_map = read_map(write(tmp_path))
    rows, columns = ros_map.cells.shape
    assert ros_map.to_metres(cells=[(0, 0), (rows - 1, columns - 1)]).shape == (2, 2)
    with pytest.raises(ValueError, match="cells: got"):
        ros_map.to_metres(cells=[(0, 0), cell])
    with pytest.raises(ValueError, match="cells: got"):
        ros_map.to_metres(cells=cell)


def test_the_picture_of_a_map_is_no_map(tmp_path: Path) -> None:
    """Its .yaml file has the resolution and the origin."""
    write(tmp_path)
    with pytest.raises(
        FormatError, match=r"map\.pgm: is the picture of a map, expected the \.yaml"
    ):
        read_map(tmp_path / "map.pgm")


def test_other_yaml_beside_a_map_is_no_matter(tmp_path: Path) -> None:
    """Parameters of nodes are skipped; a file with a part of what a map needs is left out."""
    write(tmp_path)
    (tmp_path / "params.yaml").write_text("amcl:\n  ros__parameters: {image_width: 3, data: x}\n")
    (tmp_path / "half.yml").write_text("image: map.pgm\n")
    assert recognise(tmp_path) == "ros"
    collection = read_any(tmp_path, unknown="occupied")
    assert len(collection.maps) == 1
    ((name, reason),) = collection.left_out
    assert (name, reason) == (
        str(tmp_path / "half.yml"),
        "has no field 'resolution', expected the YAML of a ROS map",
    )
    with pytest.raises(
        FormatError, match=r"--format ros refuses params.yaml: has no field 'image'"
    ):
        read_any(tmp_path / "params.yaml")


@pytest.mark.parametrize(
    "text",
    [
        "info:\n  width: 4\ndata:\n- -1\n- 100\n- 0\n- 0\n---\n",
        "data: [-1, 100, 0, 0]\ninfo: {height: 2, width: 2}\n",
        "data: [" + "-1, 100, " * 9000 + "0]\ninfo: {height: 1, width: 18001}\n",  # a long file
    ],
)
def test_a_printed_message_is_named(text: str, tmp_path: Path) -> None:
    """An OccupancyGrid as ROS prints it; the page of the format tells how to read it."""
    path = tmp_path / "map.yaml"
    path.write_text(text)
    for source in (path, tmp_path):
        with pytest.raises(
            FormatError, match=r"is a message, such as an OccupancyGrid, .* map_saver"
        ):
            read_any(source)


def test_a_pgm_is_scaled_to_its_maximum(tmp_path: Path) -> None:
    """A maximum of 8 bits becomes 255 and one of 16 bits 65535; values above it are white."""
    (tmp_path / "8.pgm").write_bytes(b"P5 3 1 100\n" + bytes([0, 50, 101]))
    (tmp_path / "16.pgm").write_bytes(b"P5 3 1 1000\n" + np.array([0, 500, 1001], ">u2").tobytes())
    for name, expected in (("8.pgm", [0, 128, 255]), ("16.pgm", [0, 32768, 65535])):
        values, white = read_pixels(tmp_path / name)
        assert values.ravel().tolist() == expected
        assert white == expected[-1]


@SETTINGS
@given(
    arrays.arrays(np.int8, (2, 3), elements=st.sampled_from([-1, 0, 40, 100])),
    st.sampled_from(["occupied", "free"]),
)
def test_cells_become_free_or_occupied(cells: npt.NDArray[np.int8], unknown: str) -> None:
    """The value 0 is free, 100 is occupied, and all other values become what unknown
    cells become.
    """
    ros_map = RosMap(cells, 0.05, (0.0, 0.0, 0.0))
    grid = ros_map.grid(unknown)  # type: ignore[arg-type]
    assert grid.tolist() == [
        [{0: 0, 100: 1}.get(v, int(unknown == "occupied")) for v in row] for row in cells.tolist()
    ]


def slowly_resampled(grid: Bytes, factor: Fraction, rule: str) -> list[list[int]]:
    """Return a map of wider cells: each adds up its overlaps with all old ones, as fractions.

    Rows are counted from below; beyond the map all is occupied.
    """
    height = len(grid)
    rows, columns = (math.ceil(side / factor) for side in grid.shape)

    def overlap(old: int, new: int) -> Fraction:
        first = max(Fraction(old), new * factor)
        last = min(Fraction(old + 1), (new + 1) * factor)
        return max(Fraction(0), last - first)

    found = [[0] * columns for _ in range(rows)]
    for up in range(rows):
        for right in range(columns):
            free = Fraction(0)
            for row, column in np.argwhere(grid == 0).tolist():
                free += overlap(height - 1 - row, up) * overlap(column, right)
            occupied = factor**2 - free
            enough = occupied > 0 if rule == "any" else occupied >= factor**2 / 2
            found[rows - 1 - up][right] = int(enough)
    return found


@examples(100, SETTINGS)
@given(
    arrays.arrays(
        np.uint8, st.tuples(st.integers(1, 5), st.integers(1, 5)), elements=st.integers(0, 1)
    ),
    st.fractions(Fraction(1, 4), 5, max_denominator=6),
    st.sampled_from(["any", "mean"]),
)
def test_resampling_adds_up_areas(grid: Bytes, factor: Fraction, rule: str) -> None:
    """Areas are exact for finer and coarser cells, by whole numbers and by fractions."""
    if factor > min(grid.shape):
        with pytest.raises(FormatError, match="cells, too few or too many for cells"):
            resampled(grid, factor, rule)
    else:
        assert resampled(grid, factor, rule).tolist() == slowly_resampled(grid, factor, rule)


def test_a_resolution_resamples_the_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command and Python do the same; 0.15 / 0.05 is exactly 3."""
    cells = np.zeros((7, 12), np.uint8)
    cells[0, 1] = cells[5, 4] = 1
    cells[3:6, 6:9] = 1
    pixels = np.where(cells, 0, 254).astype(np.uint8)
    path = write(tmp_path, b"P5 12 7 255\n" + pixels.tobytes())
    for flags, rule in (((), "any"), (("--ros.resample", "mean"), "mean")):
        out = tmp_path / rule
        code, _, _ = cli(capsys, "import", path, out, "--resolution", 0.15, *flags)
        assert code == 0
        manifest = read_manifest(out)
        assert manifest.resolution == 0.15
        grid = read_shard(out / manifest.shards[0].name).maps.occupancy[0]
        assert grid.tolist() == slowly_resampled(cells, Fraction(3), rule)
    assert [line.count(1) for line in slowly_resampled(cells, Fraction(3), "any")] == [4, 1, 2]
    (foreign_map,) = read_any(path, resolution=0.1).maps
    assert (foreign_map.resolution, foreign_map.shape) == (0.1, (4, 6))
    (foreign_map,) = read_any(path, resolution=np.float64(0.1)).maps
    assert foreign_map.shape == (4, 6)
    (foreign_map,) = read_any(path, resolution=0.05).maps
    assert foreign_map.grid.tolist() == cells.tolist()
    path.write_text(path.read_text().replace("0.050000", "0.0500000007450581"))
    (foreign_map,) = read_any(path, resolution=0.1).maps
    assert foreign_map.shape == (4, 6)


def test_bad_resolutions_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """They are not above 0, too fine for the limit, or coarser than the map; so is a rule without a
    resolution.
    """
    path = write(tmp_path, resolution="0.05")
    for flags, message in (
        (("--resolution", "0"), "resolution: got 0.0, expected metres per cell above 0"),
        (("--resolution", "nan"), "resolution: got nan, expected metres per cell above 0"),
        (("--resolution", "inf"), "resolution: got inf, expected metres per cell above 0"),
        (("--resolution", "5e-324"), "resolution: got 5e-324, expected metres per cell above 0"),
        (("--resolution", "1e308"), "resolution: got 1e+308, expected metres per cell above 0"),
        (("--resolution", "1e-9"), "2 x 3 cells, too few or too many for cells 0 times as wide"),
        (("--resolution", "0.2"), "2 x 3 cells, too few or too many for cells 4 times as wide"),
        (("--ros.resample", "any"), "resample: does nothing without resolution"),
    ):
        given = ("--ros.unknown", "free", *flags)
        code, _, err = cli(capsys, "import", path, tmp_path / "out", *given)
        assert (code, err.count("mapdata: ")) == (2, 1)
        assert message in err


# --- costmaps -------------------------------------------------------------------------------------

COSTS = [[0, 1, 128, 252], [253, 254, 255, 40], [0, 0, 7, 0]]


def write_costmap(folder: Path, costs: list[list[int]], **fields: str) -> Path:
    """Write a costmap as Nav2 saves it in mode raw."""
    values = np.array(costs, np.uint8)
    header = f"P5\n{values.shape[1]} {values.shape[0]}\n255\n".encode()
    return write(folder, header + values.tobytes(), **{"mode": "raw", **fields})


@pytest.mark.parametrize(("unknown", "cost"), [("free", 1), ("occupied", 0)])
def test_costs_of_a_costmap_become_terrain(
    unknown: str, cost: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """0 to 252 become 1 to 253, 253 and 254 are occupied, and 255 is what the option says."""
    path = write_costmap(tmp_path, COSTS)
    options = ("--ros.costmap", "raw", "--ros.unknown", unknown)
    code, out, _ = cli(capsys, "import", path, tmp_path / "data", *options, "--seed-points", 3)
    assert code == 0
    assert "costs 0 to 252 are terrain 1 to 253, 253 and 254 are occupied" in out
    assert "the costs of free cells are 1 to 253" in out
    assert f"8.3% of the cells were unknown and are now {unknown}" in out
    manifest = read_manifest(tmp_path / "data")
    assert manifest.resolution == 0.05
    maps = read_shard(tmp_path / "data" / manifest.shards[0].name).maps
    assert maps.terrain is not None
    assert maps.terrain[0].tolist() == [[1, 2, 129, 253], [0, 0, cost, 41], [1, 1, 8, 1]]
    assert np.array_equal(maps.occupancy, maps.terrain == 0)


def test_a_saved_topic_has_costs_from_0_to_100(tmp_path: Path) -> None:
    """99 and 100 are occupied. Either scale is refused where the other one was said."""
    path = write_costmap(tmp_path, [[0, 1, 98], [99, 100, 255]])
    collection = read_any(path, costmap="scaled", unknown="free")
    terrain = collection.maps[0].terrain
    assert terrain is not None
    assert terrain.tolist() == [[1, 2, 99], [0, 0, 1]]
    message = "its largest cost is 100, an obstacle in what map_saver saves"
    with pytest.raises(FormatError, match=message):
        read_any(path, costmap="raw", unknown="free")
    message = "its largest cost is 254, expected at most 100: say --ros.costmap raw"
    with pytest.raises(FormatError, match=message):
        read_any(write_costmap(tmp_path, COSTS), costmap="scaled", unknown="free")


@pytest.mark.parametrize(
    ("fields", "options", "reason"),
    [
        ({}, {}, "8.3% of its cells are unknown: say --ros.unknown occupied or --ros.unknown free"),
        ({"mode": "trinary"}, {}, "mode is trinary, expected mode: raw"),
        ({"negate": "1"}, {}, "mode raw with negate"),
        (
            {},
            {"unknown": "free", "resolution": 0.1},
            "has 0.05 metres per cell, and a costmap is not resampled: leave --resolution out",
        ),
    ],
)
def test_a_costmap_with_a_fault_is_refused(
    fields: dict[str, str], options: dict[str, Any], reason: str, tmp_path: Path
) -> None:
    """The message says what to do."""
    path = write_costmap(tmp_path, COSTS, **fields)
    with pytest.raises(FormatError, match=reason) as error:
        read_any(path, costmap="raw", **options)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "pixels",
    [np.zeros((2, 3), np.uint16), np.eye(3, dtype=np.uint8), np.zeros((2, 3, 4), np.uint8)],
    ids=["16 bits", "colours", "alpha"],
)
def test_pixels_that_are_no_costs_are_refused(pixels: Bytes, tmp_path: Path) -> None:
    """A cost is a byte. A grey picture may be saved in three equal channels."""
    colours = np.zeros((3, 3, 3), np.uint8)
    colours[:, :, 0] = 7
    if pixels.shape == (3, 3):
        pixels = colours
    Image.fromarray(pixels).save(tmp_path / "map.png")
    path = write(tmp_path, (tmp_path / "map.png").read_bytes(), "map.png", mode="raw")
    message = r"map\.png: expected a grey picture of 8 bits, costs 0 to 255"
    with pytest.raises(FormatError, match=message):
        read_any(path, costmap="raw")
    Image.fromarray(np.full((2, 3, 3), 7, np.uint8)).save(tmp_path / "map.png")
    terrain = read_any(path, costmap="raw").maps[0].terrain
    assert terrain is not None
    assert np.unique(terrain).tolist() == [8]


def test_without_the_option_a_costmap_is_the_map_that_it_was(tmp_path: Path) -> None:
    """In mode raw 100 is occupied, 0 free, and the rest unknown."""
    path = write_costmap(tmp_path, [[0, 100, 7], [0, 254, 255]])
    foreign_map = read_any(path, unknown="free").maps[0]
    assert foreign_map.terrain is None
    assert foreign_map.grid.tolist() == [[0, 1, 0], [0, 0, 0]]
