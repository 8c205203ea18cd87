"""The inflation layer of Nav2, and its fit to drives, which learnt costs are compared with."""

from __future__ import annotations

import numpy as np

from mapdata.arrays import Float32s, Floats
from mapdata.costmaps.drives import Drive, random_parts
from mapdata.costmaps.sites import Paths, Site, windows_of

NAVFN_NEUTRAL = 50
NAVFN_FACTOR = 0.8
"""NavFn of Nav2 charges COST_NEUTRAL + COST_FACTOR * cost for a cell (navfn.hpp, setCostmap in
navfn.cpp).
"""

PARTS = 256
RANDOM_TRIES = 100
TRIES = 150
"""Parts of drives, and layers that are tried on them. The fit takes as long as that of the learnt
costs.
"""


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
    costs = charges(site.obstacle_distance, robot_radius, inflation_radius, cost_scaling_factor)
    return np.where(site.grid, 0, costs).astype(np.float32)


def charges(
    distance: Floats | Float32s, robot_radius: float, inflation_radius: float, factor: float
) -> Floats:
    """Return the costs of `inflation_costs` at distances (...), in metres."""
    layer = np.floor(252 * np.exp(-factor * np.maximum(distance - robot_radius, 0)))
    layer = np.where(distance <= inflation_radius, layer, 0)
    return (NAVFN_NEUTRAL + NAVFN_FACTOR * layer) / NAVFN_NEUTRAL


def fitted_inflation(
    sites: list[Site], drives: list[Drive], robot_radius: float, rng: np.random.Generator
) -> tuple[float, float]:
    """Return the inflation radius, in metres, and the cost scaling factor that explain drives best.

    What is minimised is by how much random parts of the drives cost more than the cheapest paths,
    as a ratio, in the mean. First `RANDOM_TRIES` random layers are tried, then `TRIES` around the
    best one, nearer and nearer.
    """
    of_distances = [
        Site(site.ros_map, site.grid, site.obstacle_distance[None].astype(np.float32))
        for site in sites
    ]
    windows = windows_of(of_distances, random_parts(drives, PARTS, rng))

    def excess(parameters: Floats) -> float:
        radius, factor = np.exp(parameters).tolist()
        costs = charges(windows.planes[:, 0], robot_radius, robot_radius + radius, factor)

        def of(paths: Paths) -> Floats:
            cells = tuple(paths.cells.T)
            return np.bincount(cells[0], paths.weights * costs[cells], PARTS).astype(np.float64)

        return float((of(windows.driven) / of(windows.planned(costs)) - 1).mean())

    low, high = np.log([0.02, 0.1]), np.log([3.0, 30.0])
    tried = [rng.uniform(low, high) for _ in range(RANDOM_TRIES)]
    found = [excess(parameters) for parameters in tried]
    best, smallest = tried[int(np.argmin(found))], min(found)
    for step in range(TRIES):
        spread = 0.5 * 0.98**step
        candidate = np.clip(best + spread * rng.standard_normal(2), low, high)
        if (of_candidate := excess(candidate)) < smallest:
            best, smallest = candidate, of_candidate
    radius, factor = np.exp(best).tolist()
    return robot_radius + radius, factor
