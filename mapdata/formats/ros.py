"""Maps of ROS map_server and Nav2: a .yaml beside a .pgm, .png or .bmp, in and out.

Sources: http://wiki.ros.org/map_server and nav2_map_server/src/map_io.cpp of
https://github.com/ros-navigation/navigation2.

The probability that a pixel p is occupied is (255 - p) / 255, or p / 255 with ``negate``. The field
``mode`` says how a probability becomes the value of a cell:

- ``trinary``: 100 (occupied) above ``occupied_thresh``, 0 (free) below ``free_thresh``, otherwise
  unknown. p is the mean of all channels including alpha, as in both servers.
- ``scale``: as trinary, but between the thresholds the value rises from 0 to 100, and pixels that
  are not opaque are unknown. p is the mean of the colours.
- ``raw``: p itself is the value up to 100, and unknown above, whatever the thresholds.

Values between 0 and 100 are neither free nor occupied, so they are treated as unknown cells.

A costmap of Nav2 may be such a file in mode raw, whose pixels are costs. There are two scales:

| | free cells | occupied | unknown |
|---|---|---|---|
| ``raw``, as Costmap2D and its topic ``costmap_raw`` have them | 0 to 252 | 253, 254 | 255 |
| ``scaled``, as map_saver saves the topic ``costmap`` | 0 to 98 | 99, 100 | 255 |

253 and 99 are cells from which the robot's inscribed circle touches an obstacle. Source:
nav2_costmap_2d/src/costmap_2d_publisher.cpp of the same repository.

Row 0 here is the top row of the picture; ROS numbers rows from the bottom. ``origin`` is the pose
(x, y, yaw) of the lower left corner of the picture, in metres and radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image

from mapdata.arrays import Array, Bytes, Flags, Floats, Int8s, Ints
from mapdata.checks import check_choice, check_resolution
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import (
    LIMITS,
    Limits,
    files_with_endings,
    maps_to_write,
    percent,
    split_from_folders,
    write_picture,
)
from mapdata.formats.images import (
    PICTURES,
    UNKNOWN,
    Pixels,
    brightness,
    note_free_cells,
    read_pixels,
    unknown_of_map_saver,
)
from mapdata.formats.registry import Format
from mapdata.formats.ros_header import is_ros_map, read_header
from mapdata.formats.shrinking import FreeSpace, check_free
from mapdata.npy import FormatError
from mapdata.search.metres import to_metres
from mapdata.shards.files import StrPath
from mapdata.shards.root import Root

ENDINGS = (".yaml", ".yml")


@dataclass(frozen=True, eq=False)
class RosMap:
    """A map as map_server would publish it, with row 0 on top.

    Attributes:
        cells: (H, W) int8, 0 free, 100 occupied, 1 to 99 between, -1 unknown.
        resolution: metres per cell.
        origin: (x, y, yaw) of the lower left corner, in metres and radians; old versions of
            map_saver write a yaw of NaN.
        mode: trinary, scale or raw.
    """

    cells: Int8s
    resolution: float
    origin: tuple[float, float, float]
    mode: str = "trinary"

    def to_metres(
        self, *, points: ArrayLike | None = None, cells: ArrayLike | None = None
    ) -> Floats:
        """Return points or the middles of cells, (row, col), as (x, y) in metres.

        It is `mapdata.to_metres` with the rows, resolution and origin of this map.

        Args:
            points: (..., 2) in cells; the middle of cell (r, c) is (r + 0.5, c + 0.5).
            cells: (..., 2) integers.

        Raises:
            ValueError: what `mapdata.to_metres` refuses, cells outside of the map, or a yaw of NaN.
        """
        metres = to_metres(
            points=points,
            cells=cells,
            rows=len(self.cells),
            resolution=self.resolution,
            origin=self._known_origin(),
        )
        if cells is not None and np.size(cells):
            last = np.reshape(cells, (-1, 2)).max(axis=0)
            if (last >= self.cells.shape).any():
                raise ValueError(
                    f"cells: got cells up to {tuple(last.tolist())}, outside of the map of "
                    f"{self.cells.shape[0]} x {self.cells.shape[1]} cells"
                )
        return metres

    def to_cells(self, metres: ArrayLike) -> Ints:
        """Return the cells (row, col) in which points lie: the inverse of `to_metres`.

        `to_metres` returns the middle of a cell; any other point of the cell gives the same cell.

        Args:
            metres: (..., 2), points (x, y) in metres.

        Returns:
            (..., 2) int64.

        Raises:
            ValueError: another shape, a point outside of the map, or a yaw of NaN.
        """
        in_metres = np.asarray(metres, np.float64)
        if in_metres.shape[-1:] != (2,):
            raise ValueError(f"metres: got shape {in_metres.shape}, expected (..., 2): x and y")
        x, y, yaw = self._known_origin()
        east = in_metres[..., 0] - x
        north = in_metres[..., 1] - y
        # The map is rotated about its lower left corner by yaw.
        right = (east * math.cos(yaw) + north * math.sin(yaw)) / self.resolution
        up = (north * math.cos(yaw) - east * math.sin(yaw)) / self.resolution
        rows, columns = self.cells.shape
        # A point on the edge of two cells belongs to the one to its right and above.
        from_corner = np.stack((rows - 1 - np.floor(up), np.floor(right)), axis=-1)
        # With NaN every comparison is false, so this form of the test refuses it.
        is_inside = ((from_corner >= 0) & (from_corner < (rows, columns))).all(axis=-1)
        if not is_inside.all():
            first_outside = in_metres[~is_inside].reshape(-1, 2)[0].tolist()
            raise ValueError(
                f"metres: {first_outside} lies outside of the map of {rows} x {columns} cells, "
                f"whose lower left corner is {[x, y]}; expected metres in the frame of the map"
            )
        return np.asarray(from_corner, np.int64)

    def _known_origin(self) -> tuple[float, float, float]:
        """Return the origin.

        Raises:
            ValueError: its yaw is NaN.
        """
        if math.isnan(self.origin[2]):
            raise ValueError(
                f"origin: got {self.origin}, whose yaw is not known; expected radians, 0 if the "
                "map is not rotated: correct the .yaml"
            )
        return self.origin

    def grid(self, unknown: Literal["occupied", "free"] | None = None) -> Bytes:
        """Return the map as a grid for searches, (H, W) uint8, 0 free and 1 occupied.

        Args:
            unknown: what cells become that are neither free nor occupied; None refuses them.

        Raises:
            ValueError: such cells, while ``unknown`` is None; another word.
        """
        if unknown is not None:
            check_choice("unknown", unknown, ("occupied", "free"))
        is_unknown = _unknown_cells(self.cells)
        if unknown is None and is_unknown.any():
            raise ValueError(
                f"unknown: {_unknown_share(self.cells)}: expected 'occupied' or 'free', what they "
                "become"
            )
        is_occupied = self.cells == 100
        if unknown == "occupied":
            is_occupied |= is_unknown
        return np.asarray(is_occupied, np.uint8)


def read_map(path: StrPath, limits: Limits = LIMITS) -> RosMap:
    """Return the map of a .yaml file.

    In mode trinary, grey 205 is unknown in a picture of map_saver, whatever the thresholds are: a
    ``free_thresh`` of 0.25, which map_saver of Nav2 writes beside it, would make it free.

    Raises:
        FormatError: fields missing or out of range, a picture that is missing, damaged or outside
            the yaml's folder.
    """
    if Path(path).suffix.lower() in PICTURES:
        raise FormatError(f"{path}: is the picture of a map, expected the .yaml file that names it")
    return _read_map(Path(path), limits).ros_map


class _ReadMap(NamedTuple):
    """The map of a .yaml file, and what a user has to know of it.

    Attributes:
        ros_map: the map.
        overruled: what the thresholds would have made of cells of the grey that map_saver writes
            for unknown ones: "free" or "occupied"; an empty text if there are none.
        transparent: the share of cells that are not free because their pixels are transparent.
    """

    ros_map: RosMap
    overruled: str
    transparent: float


def _read_map(path: Path, limits: Limits) -> _ReadMap:
    """Return the map of a .yaml file.

    Raises:
        FormatError: as `read_map`.
    """
    header = read_header(path, limits)
    pixels = read_pixels(header.picture, limits)
    cells = _classify(pixels, header.mode, header.negate, header.low, header.high)
    overruled = ""
    if header.mode == "trinary" and not header.negate:
        is_unknown = unknown_of_map_saver(brightness(pixels))
        values = cells[is_unknown]
        if (values == 0).any():
            overruled = "free"
        elif (values == 100).any():
            overruled = "occupied"
        cells[is_unknown] = -1
    transparent = 0.0
    if header.mode != "raw" and pixels.values.shape[2] == 4:
        transparent = float(((pixels.values[:, :, 3] == 0) & (cells != 0)).mean())
    ros_map = RosMap(cells, header.resolution, header.origin, header.mode)
    return _ReadMap(ros_map, overruled, transparent)


def _classify(pixels: Pixels, mode: str, negate: bool, low: float, high: float) -> Int8s:
    """Return map_server's value of each pixel, (H, W) int8, as `RosMap.cells`.

    Args:
        pixels: of the picture.
        mode: trinary, scale or raw.
        negate: whether white is occupied.
        low: probability below which a cell is free.
        high: probability above which a cell is occupied.
    """
    values, white = pixels
    has_alpha = values.shape[2] == 4
    channels = values if mode == "trinary" else values[:, :, :3]
    total = channels.sum(axis=2, dtype=np.uint32)
    # A picture has far more pixels than there are sums of channels, so the value is computed once
    # for each sum.
    max_total = channels.shape[2] * white
    shade = np.arange(max_total + 1) / max_total  # 0 black, 1 white
    if mode == "raw":
        value_of_total = np.rint(shade * 255)
        value_of_total[value_of_total > 100] = -1
    else:
        probability = shade if negate else 1 - shade
        value_of_total = np.full(len(shade), -1.0)
        if mode == "scale" and high > low:
            scaled = np.rint((probability - low) / (high - low) * 100)
            value_of_total = np.clip(scaled, 0, 100)
        value_of_total[probability < low] = 0
        value_of_total[probability > high] = 100
    cells: Int8s = value_of_total.astype(np.int8)[total]
    if mode == "scale" and has_alpha:
        is_opaque = values[:, :, 3] == white
        cells[~is_opaque] = -1
    return cells


class _CostScale(NamedTuple):
    """What the pixels of a costmap mean.

    Attributes:
        max_free: the largest cost of a free cell.
        max_occupied: the largest cost of an occupied cell; larger ones do not exist but `_UNKNOWN`.
    """

    max_free: int
    max_occupied: int


_COST_SCALES = {"raw": _CostScale(252, 254), "scaled": _CostScale(98, 100)}
"""The scales of costmaps by name, as in the table of this module."""

_UNKNOWN = 255
"""The pixel of an unknown cell of a costmap."""

_SAY_UNKNOWN = (
    "say --ros.unknown occupied or --ros.unknown free, or unknown='occupied' or unknown='free' in "
    "Python"
)
"""What to do about unknown cells."""


def read_costs(path: StrPath, limits: Limits = LIMITS) -> tuple[Bytes, float]:
    """Return the pixels of a costmap, (H, W) uint8, and its metres per cell.

    Raises:
        FormatError: as `read_map`; another mode than raw, or a picture whose pixels are no costs.
    """
    path = Path(path)
    header = read_header(path, limits)
    if header.mode != "raw":
        raise FormatError(
            f"{path}: mode is {header.mode}, expected mode: raw, in which the pixels of a costmap "
            "are its costs"
        )
    values, white = read_pixels(header.picture, limits)
    costs = values[:, :, 0]
    is_grey = values.shape[2] <= 3 and (values == costs[:, :, None]).all()
    if white != _UNKNOWN or not is_grey:
        raise FormatError(f"{header.picture}: expected a grey picture of 8 bits, costs 0 to 255")
    return costs, header.resolution


def to_terrain(costs: Bytes, scale: str, unknown: str | None, label: str) -> Bytes:
    """Return costs as terrain, (H, W) uint8: cost 0 becomes 1, and so on; 0 is occupied.

    Args:
        costs: (H, W) uint8, the pixels of a costmap.
        scale: "raw" or "scaled".
        unknown: "occupied" or "free": what unknown cells become, with the lowest cost if they are
            free; None refuses them.
        label: names the map in errors.

    Raises:
        FormatError: unknown cells, while ``unknown`` is None; costs of the other scale.
    """
    is_unknown = costs == _UNKNOWN
    if unknown is None and is_unknown.any():
        share = percent(float(is_unknown.mean()))
        raise FormatError(f"{label}: {share} of its cells are unknown: {_SAY_UNKNOWN}")
    max_cost = int(costs[~is_unknown].max(initial=0))
    scaled = _COST_SCALES["scaled"]
    max_free, max_occupied = _COST_SCALES[scale]
    if max_cost > max_occupied:
        raise FormatError(
            f"{label}: its largest cost is {max_cost}, expected at most {max_occupied}: say "
            "--ros.costmap raw"
        )
    if scale == "raw" and max_cost == scaled.max_occupied:
        raise FormatError(
            f"{label}: its largest cost is {max_cost}, an obstacle in what map_saver saves of the "
            "topic costmap: say --ros.costmap scaled"
        )
    terrain = np.where(costs <= max_free, costs + 1, 0).astype(np.uint8)
    if unknown == "free":
        terrain[is_unknown] = 1
    return terrain


def _unknown_share(cells: Int8s) -> str:
    """Return how many cells are unknown or between the thresholds, as text."""
    is_unknown = _unknown_cells(cells)
    is_between = (cells > 0) & (cells < 100)
    state = "unknown"
    if is_between.any():
        state = "between free and occupied"
        if (is_unknown & ~is_between).any():
            state = "unknown or between free and occupied"
    return f"{percent(float(is_unknown.mean()))} of its cells are {state}"


def _unknown_cells(cells: Int8s) -> Flags:
    """Return which cells, (H, W), are neither free nor occupied."""
    return np.isin(cells, (0, 100), invert=True)


def _is_filter_mask(ros_map: RosMap) -> bool:
    """Return whether a map is a mask for Nav2's costmap filters, of keepout zones or speed limits.

    A map that was saved in the mode raw has free and occupied cells, 0 and 100, and perhaps unknown
    ones. The pixels of a mask are percentages, or white, which is unknown in that mode.

    Source: https://docs.nav2.org/configuration/packages/costmap-plugins/keepout_filter.html.
    """
    if ros_map.mode != "raw" or not _unknown_cells(ros_map.cells).any():
        return False
    has_free = (ros_map.cells == 0).any()
    has_occupied = (ros_map.cells == 100).any()
    return not (has_free and has_occupied)


def resampled(grid: Bytes, factor: Fraction, rule: str | None, limits: Limits = LIMITS) -> Bytes:
    """Return a map whose cells are ``factor`` times as wide.

    New cells are aligned with the lower left corner, where the origin of a ROS map is. A new cell
    at the upper or right edge may reach beyond the map; that part counts as occupied.

    Args:
        grid: (H, W) uint8, 0 free and 1 occupied.
        factor: width of a new cell over that of an old one.
        rule: "mean": a cell is occupied if at least half of its area is; otherwise if any of it is.
        limits: of the number of new cells.

    Raises:
        FormatError: the map is smaller than a new cell, or there are too many new cells.
    """
    rows, columns = grid.shape
    if factor > min(grid.shape) or grid.size > limits.pixels * factor**2:
        raise FormatError(
            f"{rows} x {columns} cells, too few or too many for cells {float(factor):g} times as "
            "wide: expected another --resolution"
        )
    # With factor = p / q, an old cell is q units wide and a new one p units, so that all areas are
    # whole numbers of square units.
    p, _ = factor.as_integer_ratio()
    from_below: Array = grid[::-1]
    # Occupied units in each new row of each old column; a full cell has p of them.
    in_new_rows = _sums_over_new_rows(from_below, factor, full=1)
    # Occupied square units in each new cell. The transpose turns columns into rows.
    area = _sums_over_new_rows(in_new_rows.T, factor, full=p).T
    min_occupied = p**2 / 2 if rule == "mean" else 1
    return np.asarray(area >= min_occupied, np.uint8)[::-1]


def _sums_over_new_rows(amounts: Array, factor: Fraction, full: int) -> Array:
    """Return the occupied amount in each new row, which is ``factor`` = p / q old rows high.

    Args:
        amounts: (H, W), occupied amount of each cell per unit of height.
        factor: height of a new row over that of an old one.
        full: the amount of a wholly occupied cell, which fills the last new row.

    Returns:
        (ceil(H / factor), W), where an old row is q units high.
    """
    p, q = factor.as_integer_ratio()
    old_count = len(amounts)
    new_count = math.ceil(old_count / factor)
    # The edges of the new rows: the old row in which each lies, and its height above that row's
    # lower edge in units.
    row, height = np.divmod(np.arange(new_count + 1) * p, q)
    # The last edge may lie beyond the map, which is extended by occupied rows.
    padding = row[-1] + 1 - old_count
    padded = np.pad(amounts, ((0, padding), (0, 0)), constant_values=full)
    below_row = np.cumsum(padded, axis=0) - padded
    below_edge = q * below_row[row] + height[:, None] * padded[row]
    return np.diff(below_edge, axis=0)


def read(
    source: Path,
    limits: Limits = LIMITS,
    *,
    unknown: Literal["occupied", "free"] | None = None,
    resolution: float | None = None,
    resample: Literal["any", "mean"] | None = None,
    costmap: Literal["raw", "scaled"] | None = None,
) -> Collection:
    """Read the map of a .yaml file, or all below a folder.

    Args:
        source: file or folder.
        limits: of what is read.
        unknown: state of unknown cells; without this option, maps with unknown cells are left out.
        resolution: metres per cell to which every map is resampled (default: its own).
        resample: rule for a resampled cell: it is occupied if any part of its area is occupied
            (any), or if half of its area is (mean) (default: any).
        costmap: read costmaps of Nav2 as terrain. Raw costmaps have costs 0 to 252, and 253 and 254
            are occupied. Scaled ones, saved from the topic costmap, have costs 0 to 98, and 99 and
            100 are occupied.
    """
    if resolution is not None:
        resolution = check_resolution("resolution", resolution)
    elif resample is not None:
        raise ValueError("resample: does nothing without resolution")
    collection = Collection()
    unknown_shares: list[float] = []
    overruled_maps: dict[str, list[str]] = {"free": [], "occupied": []}
    free_space = FreeSpace()
    advice = "shrink less" if resample == "mean" else "shrink less, or use --ros.resample mean"
    for path in files_with_endings(source, ENDINGS, limits, collection):
        with collection.leaving_out(path):
            if source.is_dir() and path.is_file() and not is_ros_map(path):
                continue  # parameters of a node, landmarks, ...
            split = split_from_folders(path, source)
            if costmap is not None:
                foreign_map, unknown_share = _read_costmap(
                    path, split, limits, costmap, unknown, resolution
                )
            else:
                ros_map, overruled, transparent = _read_map(path, limits)
                grid = _checked_grid(path, ros_map, overruled, transparent, unknown)
                unknown_share = float(_unknown_cells(ros_map.cells).mean())
                if resolution is not None:
                    # The quotient of the decimal texts, since 0.15 / 0.05 is not 3 in floats.
                    factor = Fraction(repr(resolution)) / Fraction(repr(ros_map.resolution))
                    factor = factor.limit_denominator(1000)
                    own_grid = grid
                    grid = resampled(own_grid, factor, resample, limits)
                    check_free(own_grid, grid, advice)
                    if factor != 1:
                        free_space.add(own_grid, [grid], cell_area=float(factor**2))
                foreign_map = ForeignMap(str(path), grid, split, resolution or ros_map.resolution)
                if overruled:
                    overruled_maps[overruled].append(str(path))
            collection.maps.append(foreign_map)
            unknown_shares.append(unknown_share)
    if costmap is None:
        note_free_cells(collection, "what the .yaml calls free", None)
        for state, names in overruled_maps.items():
            if names:
                collection.notes.append(
                    f"grey {UNKNOWN} is unknown in {len(names)} of {len(collection.maps)} maps "
                    f"({names[0]}), as map_saver writes it, although their thresholds make it "
                    f"{state}"
                )
        if resolution is not None:
            action = f"resampled to {resolution:g} metres per cell"
            collection.notes += free_space.notes(action, advice)
    else:
        max_free, max_occupied = _COST_SCALES[costmap]
        collection.notes.append(
            f"costs 0 to {max_free} are terrain 1 to {max_free + 1}, {max_free + 1} and "
            f"{max_occupied} are occupied"
        )
    if any(unknown_shares):
        collection.notes.append(
            f"{percent(float(np.mean(unknown_shares)))} of the cells were unknown and are now "
            f"{unknown}"
        )
    return collection


def _checked_grid(
    path: Path,
    ros_map: RosMap,
    overruled: str,
    transparent: float,
    unknown: Literal["occupied", "free"] | None,
) -> Bytes:
    """Return the grid of the map of a .yaml file, (H, W) uint8, 0 free and 1 occupied.

    Args:
        path: of the file, for errors.
        ros_map: its map.
        overruled: as in `_ReadMap`.
        transparent: as in `_ReadMap`.
        unknown: what unknown cells become.

    Raises:
        FormatError: a filter mask; unknown cells, while ``unknown`` is None; no free cell, because
            free space is transparent.
    """
    if _is_filter_mask(ros_map):
        raise FormatError(
            f"{path}: mode: raw, a filter mask, not a map: its pixels are costs or speed limits; "
            "--ros.costmap reads costs"
        )
    if unknown is None and _unknown_cells(ros_map.cells).any():
        reason = _unknown_share(ros_map.cells)
        if overruled:
            reason += (
                f" (grey {UNKNOWN}, as map_saver writes them, although the thresholds make it "
                f"{overruled})"
            )
        if transparent:
            reason += (
                f", and {percent(transparent)} are transparent, which no map server takes for free "
                "(save the picture without transparency, white where cells are free)"
            )
        raise FormatError(f"{path}: {reason}: {_SAY_UNKNOWN}")
    grid = ros_map.grid(unknown)
    if transparent and grid.all():
        raise FormatError(
            f"{path}: no cell is free: {percent(transparent)} of the picture is transparent, which "
            "no map server takes for free: save it without transparency, white where cells are free"
        )
    return grid


def _read_costmap(
    path: Path,
    split: int | None,
    limits: Limits,
    scale: str,
    unknown: str | None,
    resolution: float | None,
) -> tuple[ForeignMap, float]:
    """Return the costmap of a .yaml file, and the share of its cells that were unknown.

    Raises:
        FormatError: a file that `read_costs` or `to_terrain` refuses, or another resolution.
    """
    costs, own_resolution = read_costs(path, limits)
    if resolution not in (None, own_resolution):
        raise FormatError(
            f"{path}: has {own_resolution:g} metres per cell, and a costmap is not resampled: "
            "leave --resolution out"
        )
    terrain = to_terrain(costs, scale, unknown, str(path))
    grid = np.asarray(terrain == 0, np.uint8)
    foreign_map = ForeignMap(str(path), grid, split, own_resolution, terrain=terrain)
    return foreign_map, float((costs == _UNKNOWN).mean())


def write(
    target: Path, root: Root, progress: bool, *, image: Literal["pgm", "png", "bmp"] = "pgm"
) -> list[str]:
    """Write each map as ``<split>/map<i>.yaml`` and ``<split>/map<i>.<image>``, as map_saver does.

    Args:
        target: folder.
        root: dataset.
        progress: show a progress bar.
        image: file format of the pictures.

    Returns:
        Notes for the user.
    """
    for stem, grid, _ in maps_to_write(target, root, progress):
        pixels = np.where(grid, 0, 254).astype(np.uint8)  # the greys of map_saver
        picture = stem.with_suffix(f".{image}")
        write_picture(picture, Image.fromarray(pixels))
        stem.with_suffix(".yaml").write_text(
            f"image: {picture.name}\nmode: trinary\nresolution: {root.resolution!r}\n"
            "origin: [0.0, 0.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
            newline="\n",
        )
    return [
        "rooms and labels are not in this format: pictures, resolution and splits are",
        "a dataset does not keep where its maps lie: the origin of each .yaml is [0, 0, 0], so "
        "write x, y and yaw of your map there",
    ]


FORMAT = Format("ros", ENDINGS, read, write, recognises=is_ros_map, companion_endings=PICTURES)
