"""A costmap from a few drives: what a robot's driver avoids, learnt from where it was driven.

Costmaps are tuned by hand: how far from a wall a path costs more, and how much. Here the cost of a
cell is a curve of its distance to the nearest obstacle, or a network's answer to planes of the
user's own. Its teachers are recorded drives alone:

    from mapdata.costmaps import fit_costmap
    from mapdata.formats.ros import read_map

    costmap = fit_costmap(read_map("office.yaml"), "drives.csv", robot_radius=0.2)
    print(costmap.comparison)  # beside shortest paths and an inflation layer
    costmap.plot().figure.savefig("curve.png")
    costmap.write("costmap")  # a .pgm and a .yaml for a static layer

docs/howto/costmap.md shows what it finds, and where it does not serve. The inflation layer that it
is compared with needs scipy, the extra [examples].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import torch

from mapdata.arrays import Bytes, Float32s, Ints
from mapdata.checks import check_count
from mapdata.costmaps.cost_models import Costs, Curve, PlaneNetwork, knots, nearest_knot
from mapdata.costmaps.drives import MAX_PART, MIN_PART, Drive, cells_of_drive, read_drives
from mapdata.costmaps.fitting import learn
from mapdata.costmaps.inflation_layer import (
    NAVFN_FACTOR,
    NAVFN_NEUTRAL,
    fitted_inflation,
    inflation_costs,
)
from mapdata.costmaps.sites import MOVEMENT, Planes, Site, clearance_plane, site_of
from mapdata.formats import RosMap
from mapdata.search import search_batch, terrain_from_costs
from mapdata.shards import write_output

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MIN_DRIVEN = 25
"""The curve is drawn grey at clearances at which fewer cells were driven."""

MAX_OCCUPANCY = 98
"""A static layer of Nav2 takes occupancy 100 as an obstacle and 99 as one inflated by the robot's
radius (static_layer.cpp), so that 98 is the dearest free cell.
"""


@dataclass(frozen=True, eq=False)
class Costmap:
    """What `fit_costmap` found.

    Attributes:
        costs: for each map (H, W) float32, the cost of each cell; 1 is the cheapest free cell, and
            0 stands for cells where the robot cannot be.
        grids: for each map (H, W), where the robot can be.
        curve: with the default plane, a table with a row for each knot: ``clearance`` in metres,
            ``cost`` in the mean over starts, where 1 is the cheapest clearance, ``low`` and
            ``high`` over the starts, and ``driven``, the number of cells nearest to the knot.
            Otherwise None.
        misjudgement: with the default plane, the factor by which the driver typically misjudges the
            cost of a cell: 1 for one who drives cheapest paths. Otherwise None.
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
    misjudgement: float | None
    comparison: pd.DataFrame
    inflation: tuple[float, float]
    dropped: dict[str, int]
    drives: int
    _maps: list[RosMap]
    _models: list[Costs]

    def predict(self, site: Site) -> Float32s:
        """Return the costs of another map, (H, W), as `costs`: of a robot that drives alike there.

        ``site`` is what `site_of` returns for it, with the same planes.
        """
        return _costs(self._models, site)

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
        for rows, colour, label in (
            (self.curve, "0.7", f"fewer than {MIN_DRIVEN} cells driven"),
            (self.curve.where(known), "C0", "driven"),
        ):
            axes.fill_between(
                rows["clearance"], rows["low"], rows["high"], color=colour, alpha=0.3, linewidth=0
            )
            axes.plot(rows["clearance"], rows["cost"], ".-", color=colour, label=label)
        axes.set_title(f"this driver misjudges a cell by a factor of {self.misjudgement:.1f}")
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
    steps: int = 400,
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
            classes of the ground or a picture. A network learns costs of such planes, without what
            a curve has: one minimum, and an estimate of the driver's mistakes.
        held_back: share of the drives that is not learnt from, but compared with; at least one.
        starts: number of fits with different random numbers. The costs are their geometric mean.
        steps: number of training steps of each fit.
        seed: of the fits, and of which drives are held back.

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

    driven = np.concatenate(
        [sites[drive.map].planes[:, drive.cells[:, 0], drive.cells[:, 1]].T for drive in training]
    ).astype(np.float64)  # (N, P), the planes of all driven cells
    counts = np.bincount(nearest_knot(driven[:, 0]), minlength=len(knots()))
    is_curve = planes is clearance_plane
    models: list[Costs] = []
    noises = []
    for start_seed in rng.integers(2**31, size=starts).tolist():
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(start_seed)
            models.append(Curve(counts) if is_curve else PlaneNetwork(driven))
        noises.append(learn(models[-1], sites, training, steps, start_seed))
    costs = [_costs(models, site) for site in sites]
    inflation = fitted_inflation(sites, training, robot_radius, rng)
    rows = {
        "learnt costs": costs,
        "shortest path": [np.where(site.grid, 0, 1).astype(np.float32) for site in sites],
        "inflation layer": [inflation_costs(site, robot_radius, *inflation) for site in sites],
    }
    comparison = pd.DataFrame(
        [{"costs": name, **_distances(sites, test, of_maps)} for name, of_maps in rows.items()]
    )
    return Costmap(
        costs=costs,
        grids=[site.grid for site in sites],
        curve=_curve(models, counts) if is_curve else None,
        misjudgement=math.exp(np.mean(noises)) if is_curve else None,
        comparison=comparison,
        inflation=inflation,
        dropped=dropped,
        drives=len(all_drives) - test_count,
        _maps=map_list,
        _models=models,
    )


@torch.no_grad()
def _costs(models: list[Costs], site: Site) -> Float32s:
    """Return costs (H, W) of which the cheapest free cell has 1, and 0 on occupied cells."""
    planes = torch.from_numpy(site.planes).movedim(0, -1)
    log_costs = torch.stack([model(planes) for model in models]).mean(dim=0).numpy()
    is_free = site.grid == 0
    smallest = log_costs[is_free].min() if is_free.any() else 0.0
    costs: Float32s = np.where(is_free, np.exp(log_costs - smallest), 0).astype(np.float32)
    return costs


@torch.no_grad()
def _curve(models: list[Costs], counts: Ints) -> pd.DataFrame:
    """Return the learnt cost at each knot, as `Costmap.curve`."""
    at_knots = torch.tensor(knots(), dtype=torch.float32)[:, None]
    logs = torch.stack([model(at_knots) for model in models]).numpy().astype(np.float64)
    # Paths tell no scale: each start is brought to the mean 0 over the driven cells.
    logs -= (logs * counts).sum(axis=1, keepdims=True) / counts.sum()
    smallest = logs.mean(axis=0).min()
    return pd.DataFrame(
        {
            "clearance": knots(),
            "cost": np.exp(logs.mean(axis=0) - smallest),
            "low": np.exp(logs.min(axis=0) - smallest),
            "high": np.exp(logs.max(axis=0) - smallest),
            "driven": counts,
        }
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
