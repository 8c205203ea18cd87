"""A costmap from a few drives: what a robot's driver avoids, learnt from where it was driven.

Costmaps are tuned by hand: how far from a wall a path costs more, and how much. Here a
`CostPredictor` learns the cost of a cell from its distance to the nearest obstacle, or from planes
of the user's own. Its teachers are recorded drives alone:

    from mapdata.formats.ros import read_map
    from mapdata.models import fit_costmap

    costmap = fit_costmap(read_map("office.yaml"), "drives.csv", robot_radius=0.2)
    print(costmap.comparison)  # beside shortest paths and an inflation layer
    costmap.plot().figure.savefig("curve.png")
    costmap.write("costmap")  # a .pgm and a .yaml for a static layer

The loss says how much more a part of a drive costs than the cheapest path between its ends, as
that of `CostPredictor`, but as a ratio. Drives need not be cheapest paths of anything: the costs
are those under which they are nearest to it.

docs/howto/costmap.md shows what it finds, and where it does not serve. The inflation layer that it
is compared with needs scipy, the extra [examples].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
import pandas as pd
import torch
from torch import nn

from mapdata import Movement, search_batch, terrain_from_costs
from mapdata.arrays import Bytes, Float32s, Floats, Ints, offsets_of
from mapdata.checks import check_count
from mapdata.formats import RosMap
from mapdata.search import clearance, inflate
from mapdata.shards import write_output

from .cost_predictor import CostPredictor, path_weights

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOVEMENT = Movement(8, corner_cutting=True)
"""Drives may pass corners of the inflated map, since inflation keeps the robot clear of obstacles.
"""

MAX_GAP = 1.0
"""A distance between poses, in metres, at which a new drive begins if drives have no numbers."""

MAX_CLEARANCE = 2.0
"""Clearances above it count as it, in metres: no driver minds a wall that is farther away."""

MIN_PART = 4
"""Smallest number of cells of a part of a drive that training and comparison use."""

MAX_PART = 40
"""Largest number of cells of such a part. A driver knows the way around a room better than that
through a building.
"""

MARGIN = 12
"""Number of cells around a part in which training looks for cheaper paths."""

MAX_LOG_COST = 1.5
"""The dearest free cell costs at most exp(3) = 20 times as much as the cheapest one. NavFn can tell
apart a ratio of 5.
"""

PARTS = 12
"""Number of parts of drives in a training step."""

MIN_DRIVEN = 50
"""The curve is drawn grey at clearances at which fewer cells were driven."""

CURVE_BIN = 0.1
"""Width of a point of the curve, in metres."""

NAVFN_NEUTRAL = 50
NAVFN_FACTOR = 0.8
MAX_OCCUPANCY = 98
"""NavFn of Nav2 charges COST_NEUTRAL + COST_FACTOR * cost for a cell (navfn.hpp, setCostmap in
navfn.cpp). A static layer takes occupancy 100 as an obstacle and 99 as one inflated by the robot's
radius (static_layer.cpp), so that 98 is the dearest free cell.
"""

Planes: TypeAlias = Callable[[Bytes, float], npt.ArrayLike]
"""A function from a grid (H, W), 0 free and 1 occupied, and its resolution in metres per cell, to
planes (P, H, W).
"""


def clearance_plane(grid: Bytes, resolution: float) -> Float32s:
    """Return one plane, (1, H, W): the distance to the nearest obstacle, in metres, at most 2."""
    metres: Float32s = np.minimum(clearance(grid) * resolution, MAX_CLEARANCE)[None]
    return metres


class Drive(NamedTuple):
    """A part of a recorded drive on one map.

    Attributes:
        map: number of the map.
        cells: (k, 2) cells, each a move of 8-connected movement from the one before it.
    """

    map: int
    cells: Ints


# --- reading drives -----------------------------------------------------------------------------


def read_drives(source: pd.DataFrame | str | Path) -> list[Floats]:
    """Return the poses of each drive, (n, 2) metres: x and y.

    Args:
        source: a table or a CSV file with columns ``x`` and ``y``, in metres, and perhaps
            ``drive``, a number or name. Without it, a gap of more than `MAX_GAP` begins a drive.

    Raises:
        ValueError: a column is missing, or a number is not finite.
    """
    table = source if isinstance(source, pd.DataFrame) else pd.read_csv(source)
    table = table.rename(columns=lambda name: str(name).strip().lower())
    missing = [name for name in ("x", "y") if name not in table]
    if missing:
        raise ValueError(
            f"drives: got the columns {', '.join(map(str, table.columns))}, expected x and y in "
            "metres, and perhaps drive"
        )
    poses = table[["x", "y"]].to_numpy(np.float64)
    if not np.isfinite(poses).all():
        row = int(np.flatnonzero(~np.isfinite(poses).all(axis=1))[0])
        raise ValueError(f"drives: row {row} has {poses[row].tolist()}, expected finite metres")
    if "drive" in table:
        return [poses[rows] for rows in table.groupby("drive", sort=False).indices.values()]
    gaps = np.hypot(*np.diff(poses, axis=0).T)
    return np.split(poses, np.flatnonzero(gaps > MAX_GAP) + 1)


def cells_of_drive(
    poses: Floats, ros_map: RosMap, grid: Bytes
) -> tuple[list[Ints], dict[str, int]]:
    """Return the parts of a drive that lie on free cells, and how much was dropped.

    Poses are snapped to cells, and cells that are no neighbours are joined by straight moves.

    Args:
        poses: (n, 2), in metres.
        ros_map: the map.
        grid: (H, W), where the middle of the robot can be.

    Returns:
        Parts, (k, 2) each, of at least `MIN_PART` cells; and numbers of poses outside of the map,
        of cells that are not free, and of cells in parts that are too short.
    """
    upper_right = ros_map.to_metres(points=np.array([0.0, grid.shape[1]]))
    # Distances from the lower left corner along the map's own axes, in cells.
    corner = ros_map.to_metres(points=np.array([float(grid.shape[0]), 0.0]))
    upper_left = ros_map.to_metres(points=np.zeros(2))
    right_axis = (upper_right - upper_left) / (grid.shape[1] * ros_map.resolution)
    up_axis = (upper_left - corner) / (grid.shape[0] * ros_map.resolution)
    columns = (poses - corner) @ right_axis / ros_map.resolution
    rows = grid.shape[0] - (poses - corner) @ up_axis / ros_map.resolution
    is_inside = (rows >= 0) & (rows < grid.shape[0]) & (columns >= 0) & (columns < grid.shape[1])
    cells = np.stack([np.floor(rows), np.floor(columns)], axis=1)[is_inside].astype(np.int64)
    joined = _joined(cells)
    is_free = grid[tuple(joined.T)] == 0
    breaks = np.flatnonzero(np.diff(is_free.astype(np.int8)) != 0) + 1
    stretches = np.split(np.arange(len(joined)), breaks)
    free_stretches = [joined[k] for k in stretches if len(k) and is_free[k[0]]]
    parts = [part for part in free_stretches if len(part) >= MIN_PART]
    dropped = {
        "poses outside of the map": int((~is_inside).sum()),
        "cells that are not free": int((~is_free).sum()),
        "cells in parts that are too short": int(is_free.sum()) - sum(map(len, parts)),
    }
    return parts, dropped


def _joined(cells: Ints) -> Ints:
    """Return cells (k, 2) with straight lines between them, and no cell twice in a row."""
    if not len(cells):
        return cells
    steps = np.abs(np.diff(cells, axis=0)).max(axis=1)  # moves from each cell to the next one
    pieces = [cells[:1]]
    for cell, following, count in zip(cells[:-1], cells[1:], steps.tolist(), strict=True):
        shares = np.arange(1, count + 1)[:, None] / max(count, 1)
        pieces.append(np.rint(cell + shares * (following - cell)).astype(np.int64))
    return np.concatenate(pieces)


# --- the fit ------------------------------------------------------------------------------------


class _Windows(NamedTuple):
    """Parts of drives, each in a window of its map; windows have equal sizes.

    Attributes:
        planes: (B, P, h, w) float32, brought to the order of 1.
        grids: (B, h, w), occupied outside of the map.
        paths: (B, T, 2) cells of the window, padded with -1.
    """

    planes: Float32s
    grids: Bytes
    paths: Ints


@dataclass(frozen=True, eq=False)
class Site:
    """A map as the fit sees it.

    Attributes:
        ros_map: the map.
        grid: (H, W), where the middle of the robot can be.
        planes: (P, H, W) float32, as the function of the user returned them.
    """

    ros_map: RosMap
    grid: Bytes
    planes: Float32s

    @cached_property
    def obstacle_distance(self) -> Floats:
        """The distance from the middle of a cell to that of the nearest occupied one, in metres.

        Raises:
            ModuleNotFoundError: scipy is missing.
        """
        try:
            from scipy.ndimage import distance_transform_edt
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(
                "fit_costmap needs scipy, the extra [examples]: pip install scipy", name="scipy"
            ) from error
        cells = distance_transform_edt(self.ros_map.grid("occupied") == 0)
        return np.asarray(cells, np.float64) * self.ros_map.resolution


@dataclass(frozen=True, eq=False)
class Costmap:
    """What `fit_costmap` found.

    Attributes:
        costs: for each map (H, W) float32, the cost of each cell; 1 is the cheapest free cell, and
            0 stands for cells where the robot cannot be.
        grids: for each map (H, W), where the robot can be.
        curve: with the default plane, a table of ``clearance`` in metres, ``cost`` in the mean over
            starts, ``low`` and ``high`` over them, and ``driven``, the number of cells. Otherwise
            None.
        comparison: a row each for the learnt costs, shortest paths and an inflation layer:
            ``distance``, how far the cells of a held-back drive are from the planned path in the
            mean, in cells, and ``within``, the share of them at most one cell away.
        inflation: (inflation_radius, cost_scaling_factor) of that layer.
        dropped: numbers of poses and cells of the drives that were not used, by reason.
        drives: number of drives that the costs were learnt from; those held back are not counted.
    """

    costs: list[Float32s]
    grids: list[Bytes]
    curve: pd.DataFrame | None
    comparison: pd.DataFrame
    inflation: tuple[float, float]
    dropped: dict[str, int]
    drives: int
    _maps: list[RosMap]
    _models: list[CostPredictor]
    _moments: tuple[Floats, Floats]

    def predict(self, site: Site) -> Float32s:
        """Return the costs of another map, (H, W), as `costs`: of a robot that drives alike there.

        ``site`` is what `site_of` returns for it, with the same planes.
        """
        logs = [_log_costs(model, site.planes, *self._moments) for model in self._models]
        return _from_one(np.mean(logs, axis=0), site.grid)

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the curve: cost against clearance, with its range over starts.

        It is grey where fewer than `MIN_DRIVEN` cells were driven.

        Raises:
            ValueError: the costs were learnt from planes of the user's own, so there is no curve.
        """
        if self.curve is None:
            raise ValueError("there is no curve of costs that were learnt from your own planes")
        if axes is None:
            from matplotlib.figure import Figure

            axes = Figure(figsize=(6, 4), layout="constrained").add_subplot()
        known = self.curve["driven"] >= MIN_DRIVEN
        for is_known, colour in ((False, "0.7"), (True, "C0")):
            rows = self.curve.where(known == is_known)
            axes.fill_between(
                rows["clearance"], rows["low"], rows["high"], color=colour, alpha=0.3, linewidth=0
            )
            label = "driven" if is_known else f"fewer than {MIN_DRIVEN} cells driven"
            axes.plot(rows["clearance"], rows["cost"], ".-", color=colour, label=label)
        axes.set_xlabel("distance to the nearest obstacle, m")
        axes.set_ylabel("cost of a cell")
        axes.set_ylim(bottom=0)
        axes.legend()
        return axes

    def write(self, folder: str | Path, number: int = 0) -> float:
        """Write ``costmap.pgm`` and ``costmap.yaml`` of a map, for a static layer of Nav2.

        The mode is raw: a pixel is the occupancy that map_server publishes, 100 where the robot
        cannot be, and 0 to `MAX_OCCUPANCY` elsewhere. A static layer with ``trinary_costmap:
        false`` makes of occupancy v the cost 2.54 v, and NavFn charges 50 + .8 * cost for a cell.
        So NavFn's charge is proportional to the learnt cost, from 50 on, until it is clipped at
        248.

        Args:
            folder: an existing folder, or a new one.
            number: of the map.

        Returns:
            The share of free cells whose cost is clipped.
        """
        costs = self.costs[number]
        is_free = self.grids[number] == 0
        charge = NAVFN_NEUTRAL * costs
        occupancy = (charge - NAVFN_NEUTRAL) / NAVFN_FACTOR / 2.54
        is_clipped = is_free & (np.rint(occupancy) > MAX_OCCUPANCY)
        pixels = np.where(is_free, np.clip(np.rint(occupancy), 0, MAX_OCCUPANCY), 100)
        target = Path(folder)
        target.mkdir(parents=True, exist_ok=True)
        height, width = pixels.shape
        head = f"P5\n{width} {height}\n255\n".encode()
        write_output(target / "costmap.pgm", head + pixels.astype(np.uint8).tobytes())
        ros_map = self._maps[number]
        origin = ", ".join(f"{value!r}" for value in ros_map.origin)
        text = (
            f"image: costmap.pgm\nmode: raw\nresolution: {ros_map.resolution!r}\n"
            f"origin: [{origin}]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
        )
        write_output(target / "costmap.yaml", text.encode())
        return float(is_clipped.sum() / max(is_free.sum(), 1))


def fit_costmap(
    maps: RosMap | Sequence[RosMap],
    drives: pd.DataFrame | str | Path | Sequence[pd.DataFrame | str | Path],
    *,
    robot_radius: float,
    planes: Planes = clearance_plane,
    held_back: float = 0.2,
    starts: int = 3,
    steps: int = 350,
    seed: int = 0,
) -> Costmap:
    """Learn the cost of cells from drives.

    Args:
        maps: a map of `mapdata.formats.ros.read_map`, or several. Unknown cells count as occupied.
        drives: the drives on it, as `read_drives` takes them; for several maps one table or file
            for each.
        robot_radius: in metres.
        planes: what the costs may depend on, by default the distance to the nearest obstacle. A
            function gets the map's grid and its resolution and returns planes (P, H, W), such as
            classes of the ground or a picture.
        held_back: share of the drives that is not learnt from, but compared with; at least one.
        starts: number of networks with different random weights. The costs are their geometric
            mean.
        steps: number of training steps of each network.
        seed: of the weights, and of which drives are held back.

    Raises:
        ValueError: fewer than two drives on free cells, other numbers of maps and of files, planes
            of another shape, or what `read_drives` refuses.
    """
    map_list = [maps] if isinstance(maps, RosMap) else list(maps)
    files: list[Any]
    files = [drives] if isinstance(drives, (pd.DataFrame, str, Path)) else list(drives)
    if len(files) != len(map_list):
        raise ValueError(f"drives: got {len(files)}, expected one for each of {len(map_list)} maps")
    check_count("starts", starts)
    check_count("steps", steps)
    sites = [site_of(ros_map, robot_radius, planes) for ros_map in map_list]
    all_drives: list[list[Drive]] = []
    dropped: dict[str, int] = {}
    for number, (file, site) in enumerate(zip(files, sites, strict=True)):
        for poses in read_drives(file):
            parts, lost = cells_of_drive(poses, site.ros_map, site.grid)
            dropped = {reason: dropped.get(reason, 0) + count for reason, count in lost.items()}
            if parts:
                all_drives.append([Drive(number, part) for part in parts])
    if len(all_drives) < 2:
        raise ValueError(
            f"drives: got {len(all_drives)} on free cells, expected at least 2 (dropped: {dropped})"
        )
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(all_drives))
    test_count = min(max(round(held_back * len(all_drives)), 1), len(all_drives) - 1)
    test = [part for k in order[:test_count] for part in all_drives[k]]
    training = [part for k in order[test_count:] for part in all_drives[k]]

    centre, scale = _moments(sites, training)
    models = [
        _fitted(sites, training, centre, scale, steps, int(rng.integers(2**31)))
        for _ in range(starts)
    ]
    log_costs = [
        np.mean([_log_costs(model, site.planes, centre, scale) for model in models], axis=0)
        for site in sites
    ]
    costs = [_from_one(logs, site.grid) for logs, site in zip(log_costs, sites, strict=True)]
    inflation = _fitted_inflation(sites, training, robot_radius, rng)
    rows = {
        "learnt costs": costs,
        "shortest path": [np.where(site.grid, 0, 1).astype(np.float32) for site in sites],
        "inflation layer": [inflation_costs(site, robot_radius, *inflation) for site in sites],
    }
    comparison = pd.DataFrame(
        [{"costs": name, **_distances(sites, test, of_maps)} for name, of_maps in rows.items()]
    )
    curve = None
    if planes is clearance_plane:
        curve = _curve(sites, training, models, centre, scale)
    return Costmap(
        costs,
        [site.grid for site in sites],
        curve,
        comparison,
        inflation,
        dropped,
        len(all_drives) - test_count,
        map_list,
        models,
        (centre, scale),
    )


def site_of(ros_map: RosMap, robot_radius: float, planes: Planes = clearance_plane) -> Site:
    """Return a map with its planes.

    Raises:
        ValueError: the planes have another shape, or numbers that are not finite.
    """
    obstacles = ros_map.grid("occupied")
    grid = inflate(obstacles, robot_radius / ros_map.resolution)
    stack = np.asarray(planes(obstacles, ros_map.resolution), np.float32)
    if stack.ndim != 3 or stack.shape[1:] != grid.shape or not len(stack):
        raise ValueError(
            f"planes: got shape {stack.shape}, expected (P, {grid.shape[0]}, {grid.shape[1]})"
        )
    if not np.isfinite(stack).all():
        raise ValueError("planes: got numbers that are not finite")
    return Site(ros_map, grid, stack)


def _moments(sites: list[Site], drives: list[Drive]) -> tuple[Floats, Floats]:
    """Return the mean and the deviation of each plane over the driven cells, (P,) each."""
    driven = np.concatenate(
        [sites[drive.map].planes[:, drive.cells[:, 0], drive.cells[:, 1]] for drive in drives],
        axis=1,
    ).astype(np.float64)
    deviation = driven.std(axis=1)
    return driven.mean(axis=1), np.where(deviation > 0, deviation, 1.0)


def _fitted(
    sites: list[Site], drives: list[Drive], centre: Floats, scale: Floats, steps: int, seed: int
) -> CostPredictor:
    """Return a network after training on random parts of the drives."""
    rng = np.random.default_rng(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        model = CostPredictor(
            MOVEMENT.connectivity,
            MOVEMENT.corner_cutting,
            MOVEMENT.diagonal_cost,
            width=24,
            parts=0,
            planes=len(centre),
        )
        optimizer = torch.optim.Adam(model.parameters(), lr=0.01)
        for step in range(steps):
            rate = 0.01 * max(0.02, 0.5 + 0.5 * math.cos(math.pi * step / steps))
            for group in optimizer.param_groups:
                group["lr"] = rate
            windows = _windows_of(sites, _random_parts(drives, PARTS, rng), centre, scale)
            costs = bounded(model.log_costs(torch.from_numpy(windows.planes))).exp()  # (B, h, w)
            driven, planned = map(torch.from_numpy, _weights_of(windows, costs.detach().numpy()))
            driven_costs = (costs * driven).sum(dim=(1, 2))
            planned_costs = (costs * planned).sum(dim=(1, 2))
            # How much dearer a drive is than the cheapest path, in the logarithm: 0 at best.  The
            # difference itself, the loss of `CostPredictor`, would make all driven cells ever
            # cheaper where drives are never cheapest paths, as those of people.
            loss = (driven_costs.log() - planned_costs.log()).mean()
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(model.parameters(), 1.0)
            optimizer.step()
    return model.eval()


def bounded(log_costs: torch.Tensor) -> torch.Tensor:
    """Return logarithms of costs within `MAX_LOG_COST` of 0, and nearly as they are near 0.

    Otherwise a single dear cell, which every path has to cross, could outweigh the rest of a path,
    and all paths would cost nearly the same.
    """
    return MAX_LOG_COST * torch.tanh(log_costs / MAX_LOG_COST)


def _random_parts(drives: list[Drive], count: int, rng: np.random.Generator) -> list[Drive]:
    """Return random parts of drives; a drive is chosen in proportion to its cells."""
    lengths = np.array([len(drive.cells) for drive in drives])
    parts = []
    for k in rng.choice(len(drives), count, p=lengths / lengths.sum()).tolist():
        longest = min(MAX_PART, int(lengths[k]))
        # Short and long parts are equally likely, in the logarithm of their lengths.
        length = round(math.exp(rng.uniform(math.log(MIN_PART), math.log(longest))))
        first = int(rng.integers(lengths[k] - length + 1))
        parts.append(Drive(drives[k].map, drives[k].cells[first : first + length]))
    return parts


def _windows_of(sites: list[Site], parts: list[Drive], centre: Floats, scale: Floats) -> _Windows:
    """Return parts of drives with the cells around them."""
    lows = [part.cells.min(axis=0) - MARGIN for part in parts]
    extents = [
        part.cells.max(axis=0) + MARGIN + 1 - low for part, low in zip(parts, lows, strict=True)
    ]
    height, width = np.max(extents, axis=0).tolist()
    planes = np.zeros((len(parts), len(centre), height, width), np.float32)
    grids = np.ones((len(parts), height, width), np.uint8)
    paths = np.full((len(parts), max(len(part.cells) for part in parts), 2), -1, np.int64)
    for b, (part, low) in enumerate(zip(parts, lows, strict=True)):
        site = sites[part.map]
        top, left = np.maximum(low, 0).tolist()
        rows = slice(top, min(low[0] + height, site.grid.shape[0]))
        columns = slice(left, min(low[1] + width, site.grid.shape[1]))
        own_rows = slice(rows.start - low[0], rows.stop - low[0])
        own_columns = slice(columns.start - low[1], columns.stop - low[1])
        of_order_one = (site.planes[:, rows, columns] - centre[:, None, None]) / scale[
            :, None, None
        ]
        planes[b, :, own_rows, own_columns] = of_order_one
        grids[b, own_rows, own_columns] = site.grid[rows, columns]
        paths[b, : len(part.cells)] = part.cells - low
    return _Windows(planes, grids, paths)


def _log_costs(model: CostPredictor, planes: Float32s, centre: Floats, scale: Floats) -> Float32s:
    """Return the logarithm of the cost of each cell, (H, W), up to a constant."""
    of_order_one = ((planes - centre[:, None, None]) / scale[:, None, None]).astype(np.float32)
    with torch.inference_mode():
        logs: Float32s = bounded(model.log_costs(torch.from_numpy(of_order_one)[None]))[0].numpy()
    return logs


def _from_one(log_costs: Float32s, grid: Bytes) -> Float32s:
    """Return costs (H, W) of which the cheapest free cell has 1, and 0 on occupied cells."""
    is_free = grid == 0
    smallest = log_costs[is_free].min() if is_free.any() else 0.0
    costs: Float32s = np.where(is_free, np.exp(log_costs - smallest), 0).astype(np.float32)
    return costs


# --- what it is compared with -------------------------------------------------------------------


def inflation_costs(
    site: Site, robot_radius: float, inflation_radius: float, cost_scaling_factor: float
) -> Float32s:
    """Return what NavFn charges for the cells of an inflation layer, (H, W), in units of 50.

    The layer's cost is ``252 * exp(-cost_scaling_factor * (distance - robot_radius))`` up to the
    inflation radius, and 0 beyond it; the distance is that to the nearest occupied cell's middle
    (computeCost of nav2_costmap_2d/inflation_layer.hpp). Occupied cells get 0.

    Raises:
        ModuleNotFoundError: scipy is missing.
    """
    distance = site.obstacle_distance
    layer = np.floor(252 * np.exp(-cost_scaling_factor * np.maximum(distance - robot_radius, 0)))
    layer = np.where(distance <= inflation_radius, layer, 0)
    charge = (NAVFN_NEUTRAL + NAVFN_FACTOR * layer) / NAVFN_NEUTRAL
    costs: Float32s = np.where(site.grid, 0, charge).astype(np.float32)
    return costs


def _fitted_inflation(
    sites: list[Site], drives: list[Drive], robot_radius: float, rng: np.random.Generator
) -> tuple[float, float]:
    """Return the parameters of the inflation layer under which drives are nearest to cheapest.

    What is minimised is the relative regret of 256 random parts of the drives. 40 random layers
    come first. Then 80 steps around the best one become smaller and smaller.
    """
    parts = _random_parts(drives, 256, rng)

    def regret(parameters: Floats) -> float:
        radius, factor = np.exp(parameters).tolist()
        costs = [
            inflation_costs(site, robot_radius, robot_radius + radius, factor) for site in sites
        ]
        return _relative_regret(sites, parts, costs)

    low, high = np.log([0.02, 0.1]), np.log([3.0, 30.0])
    tried = [rng.uniform(low, high) for _ in range(40)]
    regrets = [regret(parameters) for parameters in tried]
    best, smallest = tried[int(np.argmin(regrets))], min(regrets)
    for step in range(80):
        spread = 0.5 * 0.96**step
        candidate = np.clip(best + spread * rng.standard_normal(2), low, high)
        found = regret(candidate)
        if found < smallest:
            best, smallest = candidate, found
    radius, factor = np.exp(best).tolist()
    return robot_radius + radius, factor


def _relative_regret(sites: list[Site], parts: list[Drive], costs: list[Float32s]) -> float:
    """Return how much dearer parts of drives are than the cheapest paths, in the mean."""
    windows = _windows_of(
        [
            Site(site.ros_map, site.grid, of_map[None])
            for site, of_map in zip(sites, costs, strict=True)
        ],
        parts,
        np.zeros(1),
        np.ones(1),
    )
    window_costs = windows.planes[:, 0]
    driven, planned = _weights_of(windows, window_costs)
    driven_costs = (driven * window_costs).sum(axis=(1, 2))
    planned_costs = (planned * window_costs).sum(axis=(1, 2))
    return float((driven_costs / planned_costs - 1).mean())


def _weights_of(windows: _Windows, costs: Float32s) -> tuple[Float32s, Float32s]:
    """Return how often the cost of each cell counts in drives, and in cheapest paths, (B, h, w)."""
    terrain = terrain_from_costs(np.where(windows.grids, 1, costs), windows.grids)
    numbers = np.arange(len(windows.paths))
    counts = (windows.paths[:, :, 0] >= 0).sum(axis=1)
    lasts = windows.paths[numbers, counts - 1]
    planned = search_batch(
        "astar", windows.grids, windows.paths[:, 0], lasts, MOVEMENT, terrain=terrain
    )
    driven_cells = windows.paths[windows.paths[:, :, 0] >= 0]
    return (
        path_weights(driven_cells, offsets_of(counts), windows.grids, MOVEMENT, numbers),
        path_weights(planned.cells, planned.offsets, windows.grids, MOVEMENT, numbers),
    )


def _distances(sites: list[Site], drives: list[Drive], costs: list[Float32s]) -> dict[str, float]:
    """Return how far drives are from the paths that are planned between their ends, in cells.

    A drive is compared in parts of `MAX_PART` cells, each planned on the whole map.
    """
    distances = []
    for drive in drives:
        grid = sites[drive.map].grid
        terrain = terrain_from_costs(np.where(grid, 1, costs[drive.map])[None], grid[None])[0]
        for first in range(0, len(drive.cells), MAX_PART):
            part = drive.cells[first : first + MAX_PART]
            if len(part) < MIN_PART:
                continue
            planned = search_batch(
                "astar", grid[None], part[:1], part[-1:], MOVEMENT, terrain=terrain[None]
            ).cells
            apart = np.linalg.norm(part[:, None] - planned[None], axis=2)
            distances.append(apart.min(axis=1))
    cells = np.concatenate(distances)
    return {"distance": float(cells.mean()), "within": float((cells <= 1).mean())}


def _curve(
    sites: list[Site],
    drives: list[Drive],
    models: list[CostPredictor],
    centre: Floats,
    scale: Floats,
) -> pd.DataFrame:
    """Return the learnt cost at each clearance, as `Costmap.curve`."""
    driven = np.concatenate(
        [sites[drive.map].planes[0, drive.cells[:, 0], drive.cells[:, 1]] for drive in drives]
    )
    edges = np.arange(0, MAX_CLEARANCE + CURVE_BIN, CURVE_BIN)
    counts = np.histogram(np.minimum(driven, MAX_CLEARANCE - 1e-6), edges)[0]
    middles = (edges[:-1] + edges[1:]) / 2
    logs = np.stack(
        [
            _log_costs(model, middles[None, None].astype(np.float32), centre, scale)[0]
            for model in models
        ]
    )
    # Paths tell no scale: each start is brought to the mean 0 over the driven cells.
    logs = logs - (logs * counts).sum(axis=1, keepdims=True) / counts.sum()
    smallest = logs.mean(axis=0)[counts > 0].min()
    return pd.DataFrame(
        {
            "clearance": middles,
            "cost": np.exp(logs.mean(axis=0) - smallest),
            "low": np.exp(logs.min(axis=0) - smallest),
            "high": np.exp(logs.max(axis=0) - smallest),
            "driven": counts,
        }
    )
