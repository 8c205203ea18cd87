"""Maps of ROS map_server and Nav2: a .yaml beside a .pgm, .png or .bmp, in and out.

Sources: http://wiki.ros.org/map_server and nav2_map_server/src/map_io.cpp of
https://github.com/ros-navigation/navigation2.

The probability that a pixel p is occupied is (255 - p) / 255, or p / 255 with ``negate``. Under
``mode: trinary`` it is occupied above ``occupied_thresh``, free below ``free_thresh``, else
unknown; p is the mean of the channels, and alpha is one of them, as in both servers. ``scale``:
what is not opaque is unknown, and between the thresholds stands a value of 0 to 100. ``raw``: p
itself is the value up to 100, and unknown above, whatever the thresholds. Values between 0 and 100
are neither free nor occupied, so they are treated as unknown cells.

Row 0 here is the top row of the picture; ROS numbers rows from the bottom. ``origin`` is the pose
(x, y, yaw) of the lower left corner of the picture, in metres and radians.
"""

from __future__ import annotations

import cmath
import math
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path, PureWindowsPath
from typing import Any, Literal

import numpy as np
import yaml
from PIL import Image

from mapdata.arrays import Array, Bytes, Flags, Int8s
from mapdata.checks import check_resolution
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import LIMITS, Limits, files_of, map_files, read_text, split_of
from mapdata.formats.images import PICTURES, Pixels, read_pixels, tell_free
from mapdata.formats.registry import Format
from mapdata.npy import FormatError, refusing
from mapdata.shards.files import StrPath
from mapdata.shards.root import Root

ENDINGS = (".yaml", ".yml")
MODES = ("trinary", "scale", "raw")

MAX_YAML_BYTES = 2**16
"""Largest .yaml file that is read; that of a map has some 200 bytes."""

MAX_YAML_DEPTH = 16
"""Most lists and mappings inside one another; those of a map are 2 deep."""

_YAML_OPENS = (
    yaml.BlockMappingStartToken,
    yaml.BlockSequenceStartToken,
    yaml.FlowMappingStartToken,
    yaml.FlowSequenceStartToken,
)
_YAML_CLOSES = (yaml.BlockEndToken, yaml.FlowMappingEndToken, yaml.FlowSequenceEndToken)


@dataclass(frozen=True, eq=False)
class RosMap:
    """A map as map_server would publish it, with row 0 on top.

    Attributes:
        cells: (H, W) int8, 0 free, 100 occupied, 1 to 99 between, -1 unknown.
        resolution: metres per cell.
        origin: (x, y, yaw) of the lower left corner, in metres and radians.
        mode: trinary, scale or raw: how the pixels became cells.
    """

    cells: Int8s
    resolution: float
    origin: tuple[float, float, float]
    mode: str = "trinary"

    def to_metres(self, row: float, column: float) -> tuple[float, float]:
        """Return (x, y), in metres, of the middle of a cell (row, col)."""
        x0, y0, yaw = self.origin
        # metres from the lower left corner, along the edges of the picture
        across = (column + 0.5) * self.resolution
        up = (len(self.cells) - row - 0.5) * self.resolution
        # the picture is rotated by yaw about that corner, as a product of complex numbers is
        place = complex(across, up) * cmath.rect(1.0, yaw)
        return x0 + place.real, y0 + place.imag


def read_map(path: StrPath, limits: Limits = LIMITS) -> RosMap:
    """Return the map of a .yaml file.

    Raises:
        FormatError: fields missing or out of range, a picture that is missing, damaged or outside
            the yaml's folder.
    """
    path = Path(path)
    fields = _fields(path)
    resolution = _number(path, "resolution", fields["resolution"])
    if resolution <= 0:
        raise FormatError(f"{path}: resolution is {resolution}, expected metres per cell above 0")
    low = _number(path, "free_thresh", fields["free_thresh"])
    high = _number(path, "occupied_thresh", fields["occupied_thresh"])
    if not 0 <= low <= high <= 1:
        raise FormatError(
            f"{path}: free_thresh {low} and occupied_thresh {high}, expected 0 <= free <= "
            "occupied <= 1"
        )
    negate = fields.get("negate", 0)
    if negate not in (0, 1) or isinstance(negate, float):
        raise FormatError(f"{path}: negate is {negate!r}, expected 0 or 1")
    mode = str(fields.get("mode", "trinary")).lower()
    if mode not in MODES:
        raise FormatError(f"{path}: mode is {mode[:40]!r}, expected {', '.join(MODES)}")
    if mode == "raw" and negate:
        raise FormatError(
            f"{path}: mode raw with negate: ROS 1 turns values round, Nav2 does not; say negate: 0"
        )
    origin = fields.get("origin", [0.0, 0.0, 0.0])
    if not isinstance(origin, list) or len(origin) != 3:
        raise FormatError(f"{path}: origin is {str(origin)[:40]!r}, expected [x, y, yaw]")
    x, y, yaw = (_number(path, "origin", value) for value in origin)
    pixels = read_pixels(_image(path, fields["image"]), limits)
    cells = _classify(pixels, mode, negate, low, high)
    return RosMap(cells, resolution, (x, y, yaw), mode)


def _fields(path: Path) -> dict[str, Any]:
    """Return the fields of a .yaml file by name; those without a default are there."""
    text = read_text(path, Limits(unpacked=MAX_YAML_BYTES))
    with refusing(f"{path}: not plain YAML"):
        _check_tokens(path, text)
        fields = yaml.safe_load(text)
    named = fields if isinstance(fields, dict) else {}
    for name in ("image", "resolution", "free_thresh", "occupied_thresh"):
        if name not in named:
            raise FormatError(f"{path}: has no field {name!r}, expected the YAML of a ROS map")
    return named


def _check_tokens(path: Path, text: str) -> None:
    """Refuse YAML whose parsing would take minutes.

    The tokens come one by one, so what follows the first bad one is never looked at.

    Raises:
        FormatError: an alias, or lists and mappings in one another deeper than `MAX_YAML_DEPTH`.
    """
    depth = 0
    for token in yaml.scan(text):
        # 700 bytes with aliases of aliases can stand for minutes of work.
        if isinstance(token, yaml.AliasToken):
            raise FormatError(f"{path}: not plain YAML (an alias: write out what it stands for)")
        # The time that the scanner takes grows with the square of the depth.
        if isinstance(token, _YAML_OPENS):
            depth += 1
        elif isinstance(token, _YAML_CLOSES):
            depth -= 1
        if depth > MAX_YAML_DEPTH:
            raise FormatError(
                f"{path}: not plain YAML (lists or mappings in one another more than "
                f"{MAX_YAML_DEPTH} deep, expected the flat YAML of a ROS map)"
            )


def _number(path: Path, name: str, value: object) -> float:
    """Return the finite number that is the value of a field.

    Text of a number is one too: to YAML 1.1, 5e-2 without a point is text.
    """
    number = math.nan
    if isinstance(value, (int, float, str)) and not isinstance(value, bool):
        with suppress(ValueError, OverflowError):
            number = float(value)
    if not math.isfinite(number):
        raise FormatError(f"{path}: {name} is {str(value)[:40]!r}, expected a finite number")
    return number


def _image(path: Path, name: object) -> Path:
    """Return the picture's path, which must lie in the folder of the yaml, links followed.

    Another picture is never opened: a yaml from elsewhere may name any file of this machine.
    """
    if not isinstance(name, str) or not name or "\0" in name:
        raise FormatError(f"{path}: image is {str(name)[:40]!r}, expected the name of a picture")
    folder = path.parent.resolve()
    with refusing(f"{path}: image is {name[:80]!r}"):
        image = (folder / name).resolve()
    inside = image.is_relative_to(folder)
    if not (inside and image.is_file()):
        what = "is missing" if inside else "lies outside the folder of the yaml"
        beside = PureWindowsPath(name).name
        if beside != name and (folder / beside).is_file():
            what += f"; say image: {beside}, which lies beside it"
        raise FormatError(f"{path}: image {name[:80]!r} {what}")
    return image


def _classify(pixels: Pixels, mode: str, negate: bool, low: float, high: float) -> Int8s:
    """Return map_server's value of each pixel, as in `RosMap`."""
    values, white = pixels
    colours = values if mode == "trinary" else values[:, :, :3]  # all but alpha
    total = colours.sum(axis=2, dtype=np.uint32)
    # a table of the value for each sum of channels: a picture has far more pixels than sums
    most = colours.shape[2] * white
    shade = np.arange(most + 1) / most
    if mode == "raw":
        table = np.rint(shade * 255)
        table[table > 100] = -1
    else:
        occupied = shade if negate else 1 - shade
        table = np.full(len(shade), -1.0)
        if mode == "scale" and high > low:
            table = np.clip(np.rint((occupied - low) / (high - low) * 100), 0, 100)
        table[occupied < low] = 0
        table[occupied > high] = 100
    cells: Int8s = table.astype(np.int8)[total]
    if mode == "scale" and values.shape[2] == 4:
        cells[values[:, :, 3] < white] = -1  # what is not opaque
    return cells


def to_grid(cells: Int8s, unknown: str | None, what: str) -> Bytes:
    """Return cells as a grid, 0 free and 1 occupied.

    Args:
        cells: as in `RosMap`.
        unknown: "occupied" or "free": what all other cells become; None allows no others.
        what: named in errors.

    Raises:
        FormatError: such cells, and ``unknown`` does not say.
    """
    between = _unknown(cells)
    if unknown is None and between.any():
        raise FormatError(
            f"{what}: {between.mean():.1%} of its cells are unknown: say --ros.unknown occupied "
            "or --ros.unknown free"
        )
    occupied = cells == 100
    if unknown == "occupied":
        occupied |= between
    return np.asarray(occupied, np.uint8)


def _unknown(cells: Int8s) -> Flags:
    """Return which cells are neither free nor occupied."""
    return np.isin(cells, (0, 100), invert=True)


def _is_filter_mask(ros_map: RosMap) -> bool:
    """Return whether a map is what the costmap filters of Nav2 take: keepout zones, speed limits.

    A map that was saved in the mode raw has free and occupied cells, 0 and 100, and perhaps unknown
    ones. The pixels of a mask are percentages, or white, which is unknown in that mode.

    Source: https://docs.nav2.org/configuration/packages/costmap-plugins/keepout_filter.html.
    """
    if ros_map.mode != "raw" or not _unknown(ros_map.cells).any():
        return False
    return not ((ros_map.cells == 0).any() and (ros_map.cells == 100).any())


def resampled(grid: Bytes, factor: Fraction, rule: str | None, limits: Limits = LIMITS) -> Bytes:
    """Return a map whose cells are ``factor`` times as wide.

    They are counted from the lower left corner, where the origin of a ROS map is. What a cell
    sticks out of the map above or on the right counts as occupied.

    Args:
        grid: (H, W) uint8, 0 free and 1 occupied.
        factor: new width of a cell over the old one.
        rule: "mean": a cell is occupied if half of what it covers is; else if any of it is.
        limits: of the cells that come out.

    Raises:
        FormatError: more cells than that, or no whole one.
    """
    rows, columns = grid.shape
    if factor > min(grid.shape) or grid.size > limits.pixels * factor**2:
        raise FormatError(
            f"{rows} x {columns} cells, too few or too many for cells {float(factor):g} times as "
            "wide: expected another --resolution"
        )
    # With the side of an old cell in q parts, that of a new one has p: all areas are whole numbers.
    p, q = factor.as_integer_ratio()
    area: Array = grid[::-1]
    for full in (1, p):  # the area of what is occupied: first rows are added up, then columns
        count = math.ceil(len(area) / factor)
        cell, part = np.divmod(np.arange(count + 1) * p, q)  # where the edges of new cells are
        beyond = cell[-1] + 1 - len(area)
        area = np.pad(area, ((0, beyond), (0, 0)), constant_values=full)
        before = np.cumsum(area, axis=0) - area
        area = np.diff(q * before[cell] + part[:, None] * area[cell], axis=0).T
    least = p**2 / 2 if rule == "mean" else 1
    return np.asarray(area >= least, np.uint8)[::-1]


def read(
    source: Path,
    limits: Limits = LIMITS,
    *,
    unknown: Literal["occupied", "free"] | None = None,
    resolution: float | None = None,
    resample: Literal["any", "mean"] | None = None,
) -> Collection:
    """Read the map of a .yaml file, or all below a folder.

    Args:
        source: file or folder.
        limits: of what is read.
        unknown: what unknown cells become; without it, maps with such cells are left out.
        resolution: metres per cell that every map is resampled to; default its own.
        resample: a resampled cell is occupied if any part of what it covers is, or if half of it
            is (mean); default any.
    """
    if resolution is not None:
        resolution = check_resolution("resolution", resolution)
    elif resample is not None:
        raise ValueError("resample: does nothing without resolution")
    found = Collection()
    unknowns = []
    for path in files_of(source, ENDINGS, limits, found):
        with found.leaving_out(path):
            one = read_map(path, limits)
            if _is_filter_mask(one):
                raise FormatError(
                    f"{path}: mode: raw, a filter mask, not a map: its pixels are costs or speed "
                    "limits"
                )
            grid = to_grid(one.cells, unknown, str(path))
            unknowns.append(_unknown(one.cells).mean())
            if resolution is not None:
                # from what is written, since 0.15 / 0.05 is not 3 to floats
                factor = Fraction(repr(resolution)) / Fraction(repr(one.resolution))
                grid = resampled(grid, factor.limit_denominator(1000), resample, limits)
            metres = resolution or one.resolution
            found.maps.append(ForeignMap(str(path), grid, split_of(path, source), metres))
    tell_free(found, "what the .yaml calls free", "negate in the .yaml, or --ros.unknown,")
    if any(unknowns):
        found.notes.append(
            f"{np.mean(unknowns):.1%} of the cells were unknown and are now {unknown}"
        )
    return found


def write(
    target: Path, root: Root, progress: bool, *, image: Literal["pgm", "png", "bmp"] = "pgm"
) -> list[str]:
    """Write each map as ``<split>/map<i>.yaml`` and ``<split>/map<i>.<image>``, as map_saver does.

    Args:
        target: folder.
        root: dataset.
        progress: show a progress bar.
        image: kind of the pictures.

    Returns:
        Notes for the user.
    """
    for path, grid, _ in map_files(target, root, progress):
        pixels = np.where(grid, 0, 254).astype(np.uint8)  # what map_saver writes
        picture = path.with_suffix(f".{image}")
        Image.fromarray(pixels).save(picture)
        path.with_suffix(".yaml").write_text(
            f"image: {picture.name}\nmode: trinary\nresolution: {root.resolution!r}\n"
            "origin: [0.0, 0.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
            newline="\n",
        )
    return ["rooms and labels are not in this format: pictures, resolution and splits are"]


FORMAT = Format("ros", ENDINGS, read, write, beside=PICTURES)
