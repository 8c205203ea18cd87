"""Goal fields and A* on terrain beside scikit-image and pyastar2d, drawing terrain, and pictures.

Run it by python -m benchmarks terrain.

scikit-image has our costs, where corners may be cut, and must find equal ones. pyastar2d charges
the cost of the cell that a move enters, and its diagonals are no longer than its straight moves, so
that only its time is compared.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

import mapdata
from benchmarks.measure import Peer, Row, each, interleaved, median_ratio, to_text
from mapdata import Movement, Terrain

Bytes: TypeAlias = npt.NDArray[np.uint8]
Cell: TypeAlias = tuple[int, int]

PACKAGES = ("mapdata-torch", "numpy", "numba")

MOVEMENT = Movement(8, corner_cutting=True)
"""The moves of scikit-image's MCP_Geometric: it cuts corners."""

SIDE = 64

SCIKIT_IMAGE = Peer(
    "scikit-image", "scikit-image", "skimage.graph", "MCP_Geometric(costs).find_costs([goal])"
)
PYASTAR2D = Peer(
    "pyastar2d", "pyastar2d", "pyastar2d", "astar_path(weights, start, goal, allow_diagonal=True)"
)


def smooth_terrain(source: np.random.Generator, levels: list[int], scale: int = 8) -> Bytes:
    """Return a map of smooth noise: bilinear between random corners that are ``scale`` cells apart.

    The noise is cut into as many equal intervals as there are ``levels`` of costs.
    """
    corners = source.random((SIDE // scale + 2, SIDE // scale + 2))
    coordinates = np.arange(SIDE) / scale
    first = coordinates.astype(int)
    weight = coordinates - first
    rows = corners[first] * (1 - weight)[:, None] + corners[first + 1] * weight[:, None]
    noise = rows[:, first] * (1 - weight) + rows[:, first + 1] * weight
    share = (noise - noise.min()) / np.ptp(noise)
    level = np.minimum((share * len(levels)).astype(int), len(levels) - 1)
    terrain: Bytes = np.array(levels, np.uint8)[level]
    return terrain


def maps_of(count: int) -> Mapping[str, list[Bytes]]:
    """Return ``count`` maps of each kind."""
    source = np.random.default_rng(0)
    one_to_ten = list(range(1, 11))
    warcraft = [8, 12, 53, 77, 92]
    return {
        "smooth, 1 to 10": [smooth_terrain(source, one_to_ten) for _ in range(count)],
        "smooth, 5 levels of 8 to 92": [smooth_terrain(source, warcraft) for _ in range(count)],
        "random, 1 to 99": list(source.integers(1, 100, (count, SIDE, SIDE), np.uint8)),
        "ones": list(np.ones((count, SIDE, SIDE), np.uint8)),
    }


def random_cells(count: int, seed: int) -> list[Cell]:
    """Return ``count`` cells."""
    cells = np.random.default_rng(seed).integers(0, SIDE, size=(count, 2)).tolist()
    return [(row, column) for row, column in cells]


def skimage_costs(module: Any, terrain: Bytes, goal: Cell) -> npt.NDArray[np.float64]:
    """Return the costs of all cells by scikit-image."""
    costs: npt.NDArray[np.float64]
    costs, _ = module.MCP_Geometric(terrain.astype(float)).find_costs([goal])
    return costs


def skimage_path_cost(module: Any, terrain: Bytes, start: Cell, goal: Cell) -> float:
    """Return the cost of a path by scikit-image."""
    _, cost = module.route_through_array(terrain.astype(float), start, goal, geometric=True)
    return float(cost)


def check_costs(terrains: list[Bytes], starts: list[Cell], goals: list[Cell]) -> None:
    """Compare our costs with those of scikit-image, if it is there.

    Raises:
        SystemExit: they differ.
    """
    if SCIKIT_IMAGE.absence:
        return
    module = SCIKIT_IMAGE.load()
    for terrain, start, goal in zip(terrains, starts, goals, strict=True):
        grid = np.zeros_like(terrain)
        field = mapdata.distance_field(grid, goal, MOVEMENT, terrain=terrain)
        cost = mapdata.astar(grid, start, goal, MOVEMENT, terrain=terrain).cost
        if not np.allclose(field, skimage_costs(module, terrain, goal), rtol=1e-6):
            raise SystemExit(f"mapdata and {SCIKIT_IMAGE.name} differ in a field")
        if not np.isclose(cost, skimage_path_cost(module, terrain, start, goal), rtol=1e-9):
            raise SystemExit(f"mapdata and {SCIKIT_IMAGE.name} differ in a path")


def rows_of(name: str, terrains: list[Bytes], rounds: int) -> list[Row]:
    """Return the rows of one kind of map: goal fields, and paths by A*."""
    count = len(terrains)
    starts = random_cells(count, 1)
    goals = random_cells(count, 2)
    check_costs(terrains, starts, goals)
    grids = [np.zeros_like(terrain) for terrain in terrains]

    def for_each(solve: Callable[[int], object]) -> Callable[[], object]:
        return lambda: [solve(k) for k in range(count)]

    contestants = {
        "field": for_each(
            lambda k: mapdata.distance_field(grids[k], goals[k], MOVEMENT, terrain=terrains[k])
        ),
        "path": for_each(
            lambda k: mapdata.astar(grids[k], starts[k], goals[k], MOVEMENT, terrain=terrains[k])
        ),
    }
    if not SCIKIT_IMAGE.absence:
        graph = SCIKIT_IMAGE.load()
        field_of = partial(skimage_costs, graph)
        path_of = partial(skimage_path_cost, graph)
        contestants["scikit-image field"] = for_each(lambda k: field_of(terrains[k], goals[k]))
        contestants["scikit-image path"] = for_each(
            lambda k: path_of(terrains[k], starts[k], goals[k])
        )
    if not PYASTAR2D.absence:
        search = partial(PYASTAR2D.load().astar_path, allow_diagonal=True)
        weights = [terrain.astype(np.float32) for terrain in terrains]
        contestants["pyastar2d path"] = for_each(lambda k: search(weights[k], starts[k], goals[k]))
    times = interleaved(contestants, rounds)

    def row(work: str, ours: str, peer: Peer, theirs: str, target: str, note: str) -> Row:
        time = each(times[ours], count)
        if peer.absence:
            return Row(work, time, target=target, note=f"{peer.name}: skipped")
        ratio = f"{median_ratio(times[theirs], times[ours]):,.1f}x"
        return Row(work, time, each(times[theirs], count), ratio, target, f"{peer.name}: {note}")

    sized = f"{SIDE} x {SIDE}, {name}"
    return [
        row(
            f"goal field, {sized}",
            "field",
            SCIKIT_IMAGE,
            "scikit-image field",
            "0.15 ms",
            "equal costs",
        ),
        row(f"A*, per path, {sized}", "path", SCIKIT_IMAGE, "scikit-image path", "", "equal costs"),
        row(f"A*, per path, {sized}", "path", PYASTAR2D, "pyastar2d path", "", "another rule"),
    ]


@dataclass(frozen=True)
class StoredMaps:
    """Maps as `mapdata.Tiles` reads them from a batch."""

    stored_terrain: Bytes
    stored_grids: Bytes
    symmetries: npt.NDArray[np.int64]
    problems: npt.NDArray[np.int64]
    sampling_seed: int = 0
    epoch: int = 0


def naive_pictures(terrain: Bytes, textures: Bytes, noise: int) -> Bytes:
    """Return pictures that numpy draws from a bank: ``textures`` (costs, variants, 3, k, k)."""
    source = np.random.default_rng(0)
    variants = source.integers(0, textures.shape[1], terrain.shape)
    tiles = textures[terrain, variants]  # (B, H, W, 3, k, k)
    maps, rows, columns, _, pixels, _ = tiles.shape
    pictures = tiles.transpose(0, 3, 1, 4, 2, 5).reshape(maps, 3, rows * pixels, columns * pixels)
    if noise:
        levels = source.standard_normal(pictures.shape, np.float32) * noise
        pictures = np.clip(pictures + levels, 0, 255).astype(np.uint8)
    return pictures


def picture_rows(rounds: int) -> list[Row]:
    """Return the rows of pictures: tiles of 8 x 8 pixels with and without noise."""
    source = np.random.default_rng(0)
    terrain = source.integers(1, 6, (8, SIDE, SIDE), np.uint8)
    no_symmetries = np.zeros(len(terrain), np.int64)
    maps = StoredMaps(terrain, (terrain == 0).astype(np.uint8), no_symmetries, np.arange(8))
    textures = source.integers(0, 256, (6, 1024, 3, 8, 8), np.uint8)
    rows = []
    for noise, target in ((0, ""), (10, "0.5 us")):
        contestants: dict[str, Callable[[], object]] = {
            "ours": partial(mapdata.Tiles(noise=noise), maps),
            "numpy": partial(naive_pictures, terrain, textures, noise),
        }
        times = interleaved(contestants, rounds)
        rows.append(
            Row(
                f"a tile of 8 x 8 pixels, {'noise' if noise else 'no noise'}",
                each(times["ours"], terrain.size),
                each(times["numpy"], terrain.size),
                f"{median_ratio(times['numpy'], times['ours']):,.1f}x",
                target,
                "numpy: the tiles of 1,024 random textures, and normal noise",
            )
        )
    return rows


def drawing_rows(rounds: int) -> list[Row]:
    """Return the rows of drawing maps of terrain, in batches on one core."""
    indices = np.arange(1000)
    generators: dict[str, Terrain] = {
        "preset terrain": Terrain.preset("terrain"),
        "the same with corners": replace(Terrain.preset("terrain"), corners=True),
        "preset tiles, 12 x 12": Terrain.preset("tiles"),
    }
    contestants: dict[str, Callable[[], object]] = {
        name: partial(generator.draw, 0, indices) for name, generator in generators.items()
    }
    times = interleaved(contestants, rounds)
    notes = {
        name: f"{generator.max_seed_points} seed points" for name, generator in generators.items()
    }
    return [
        Row(
            f"draw a map, {name}", each(times[name], len(indices)), target="50 us", note=notes[name]
        )
        for name in generators
    ]


def table(quick: bool, parent: str | None = None) -> str:
    """Measure, and return the table; nothing is written."""
    rounds = 3 if quick else 9
    count = 30 if quick else 200
    rows = [
        row for name, terrains in maps_of(count).items() for row in rows_of(name, terrains, rounds)
    ]
    rows += picture_rows(rounds)
    rows += drawing_rows(rounds)
    notes = (
        f"{rounds} repeats",
        f"{count} maps of each kind without occupied cells, one call for each map and its goal; "
        "8-connected, corners are cut",
        "in pyastar2d, a move costs as much as the cell that it enters",
    )
    return to_text("Terrain", rows, packages=PACKAGES, notes=notes, peers=[SCIKIT_IMAGE, PYASTAR2D])
