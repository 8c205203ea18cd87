"""Labels: route, iterations and connection matrices equal the reference, for all presets and
movements, with terrain and without it.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from helpers import reference
from helpers.examples import Some
from helpers.grids import scipy_distances
from helpers.specs import movements
from scipy import ndimage

from mapdata import Labels, Maps, MapSpec, Terrain, generate, label
from mapdata.movement import Movement
from mapdata.search import labels as labels_module
from mapdata.search.ground import as_ground, load_map
from mapdata.search.jump_points import find_free_neighbours
from mapdata.search.kernels import search_memory
from mapdata.search.labels import _fill_costs
from mapdata.search.lattice import cell_at, move_rule

SEARCHES = reference.SEARCHES
SPECS = {
    # Small rooms and few passages: many seeds without a path between them.
    "islands": MapSpec(
        (20, 24), (2, 5), (2, 6), (2, 6), passage_width=(1, 2), skip_probability=0.6
    ),
    # Wider than a machine word, thin: detours.
    "wide": MapSpec((9, 70), (2, 5), (1, 4), (3, 12), passage_width=(1, 2), skip_probability=0.2),
    # One row of four cells: most maps have seeds that coincide.
    "line": MapSpec((1, 4), (2, 6), (1, 1), (1, 2), passage_width=(1, 1), skip_probability=0.5),
    "column": MapSpec((5, 1), (2, 6), (1, 2), (1, 1), passage_width=(1, 1), skip_probability=0.5),
    "cell": MapSpec((1, 1), (2, 4), (1, 1), (1, 1), passage_width=(1, 1)),
    "open": MapSpec((15, 15), (2, 6), (5, 15), (5, 15), passage_width=(1, 5)),
}
PRESETS = {"paper": 16, "narrow": 16, "dungeon": 6, "dungeon128": 1}
"""Number of maps of each preset."""

QUICK_PRESETS = ("paper",)
"""Presets that README's test command tries; the others are slow."""


def seed_points_of(maps: Maps, i: int) -> list[reference.Cell]:
    """Return the seed points of the batch's map at this place."""
    return [(int(row), int(column)) for row, column in maps.seed_points[i, : maps.rooms[i]]]


def terrain_of(maps: Maps, i: int) -> list[list[int]] | None:
    """Return the terrain of the batch's map at this place, as the reference takes it."""
    return None if maps.terrain is None else maps.terrain[i].tolist()


def assert_route(
    maps: Maps, labels: Labels, search: str, i: int
) -> list[reference.ReferenceResult]:
    """Compare one planner's segments and iterations on one map, and return the reference's."""
    grid, seed_points = maps.occupancy[i].tolist(), seed_points_of(maps, i)
    route = reference.reference_route(
        SEARCHES[search], grid, seed_points, maps.movement, terrain_of(maps, i)
    )
    segments = labels.route(search, i)
    assert len(segments) == len(route)
    for q, expected in enumerate(route):
        segment = labels.segment(search, i, q)
        np.testing.assert_array_equal(segments[q], segment)
        assert segment.dtype == np.int64
        assert segment.shape == (len(expected.path), 2)
        assert [tuple(cell) for cell in segment.tolist()] == expected.path
    iterations = [expected.iterations for expected in route]
    first, last = maps.segment_offsets[i : i + 2]
    assert labels.iterations(search, i).tolist() == iterations
    assert labels.by_search(search).iterations[first:last].tolist() == iterations
    return route


def assert_equals_reference(maps: Maps, labels: Labels, i: int, every_pair: bool) -> None:
    """Compare all labels of one map; every_pair searches each matrix entry, scipy fills the large
    ones faster.
    """
    grid, seed_points, movement = (
        maps.occupancy[i].tolist(),
        seed_points_of(maps, i),
        maps.movement,
    )
    route = assert_route(maps, labels, "astar", i)
    assert_route(maps, labels, "bfs", i)
    if every_pair:
        costs, moves = (
            reference.reference_matrix(
                SEARCHES[search], grid, seed_points, movement, terrain_of(maps, i)
            )
            for search in ("astar", "bfs")
        )
    else:
        rows, columns = np.array(seed_points).T
        costs = moves = scipy_distances(maps.occupancy[i], seed_points, movement)[:, rows, columns]
        if movement.connectivity == 8:
            hops = replace(movement, diagonal_cost=1)
            moves = scipy_distances(maps.occupancy[i], seed_points, hops)[:, rows, columns]
    for search, expected in (("astar", costs), ("bfs", moves)):
        assert labels.matrix(search, i).dtype == np.float64
        np.testing.assert_allclose(
            labels.matrix(search, i), expected, rtol=0 if every_pair else 1e-12
        )
    first, last = maps.segment_offsets[i : i + 2]
    assert labels.reachable[first:last].tolist() == [bool(expected.path) for expected in route]
    assert labels.all_connected[i] == (costs >= 0).all()


# --- equal to the reference ---------------------------------------------------------------------


@movements
@pytest.mark.parametrize("name", SPECS)
def test_small_maps_equal_the_reference(some: Some, name: str, movement: Movement) -> None:
    """Everything that `label` gives, both matrices searched entry by entry."""
    maps = generate(replace(SPECS[name], movement=movement), 6, range(some(20)))
    labels = label(maps)
    for i in range(len(maps.rooms)):
        assert_equals_reference(maps, labels, i, every_pair=True)


@movements
def test_maps_with_terrain_equal_the_reference(some: Some, movement: Movement) -> None:
    """The same, with costs of cells; BFS counts moves all the same."""
    islands = replace(SPECS["islands"], movement=movement)
    maps = generate(Terrain(costs=(1, 2, 5, 30), scale=2, over=islands), 4, range(some(20)))
    labels = label(maps)
    for i in range(len(maps.rooms)):
        assert_equals_reference(maps, labels, i, every_pair=True)


@movements
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in QUICK_PRESETS else pytest.mark.slow)
        for name in PRESETS
    ],
)
def test_presets_equal_the_reference(some: Some, name: str, movement: Movement) -> None:
    """Everything that `label` gives, for maps of all presets."""
    maps = generate(replace(MapSpec.preset(name), movement=movement), 1, range(some(PRESETS[name])))
    labels = label(maps)
    for i in range(len(maps.rooms)):
        assert_equals_reference(maps, labels, i, every_pair=False)


def test_the_kinds_of_map_are_what_they_are_for() -> None:
    """Coinciding seeds, segments without a path, and routes that are whole all occur in the maps
    above.
    """
    line = generate(SPECS["line"], 6, range(20))
    coinciding = [len(set(seed_points_of(line, i))) < line.rooms[i] for i in range(20)]
    assert sum(coinciding) > 10
    islands = label(generate(SPECS["islands"], 6, range(20)))
    assert 0.2 < islands.reachable.mean() < 0.8
    assert 0 < islands.all_connected.sum() < 20


# --- properties, without the reference ----------------------------------------------------------


@pytest.mark.parametrize(
    "generator", [*SPECS.values(), *map(MapSpec.preset, PRESETS)], ids=[*SPECS, *PRESETS]
)
def test_four_connected_matrices(some: Some, generator: MapSpec) -> None:
    """BFS's and A*'s matrices are equal, symmetric, zero on the diagonal, and hold each segment's
    moves.
    """
    maps = generate(generator, 21, range(some(200)))
    labels = label(maps)
    for i in range(len(maps.rooms)):
        matrix = labels.matrix("bfs", i)
        np.testing.assert_array_equal(matrix, labels.matrix("astar", i))
        np.testing.assert_array_equal(matrix, matrix.T)
        assert matrix.shape == (maps.rooms[i], maps.rooms[i])
        assert not matrix.diagonal().any()
        for search in SEARCHES:
            lengths = [len(segment) for segment in labels.route(search, i)]
            assert matrix.diagonal(1).tolist() == [length - 1 for length in lengths]


@movements
@pytest.mark.parametrize("name", ["islands", "wide", "dungeon"])
def test_no_connection_exactly_where_components_differ(
    some: Some, name: str, movement: Movement
) -> None:
    """-1, `reachable` and `all_connected` follow scipy's connected components; the smallest other
    entry is 0.
    """
    generator = SPECS[name] if name in SPECS else MapSpec.preset(name)
    maps = generate(replace(generator, movement=movement), 22, range(some(200)))
    labels = label(maps)
    structure = ndimage.generate_binary_structure(2, 2 if movement.corner_cutting else 1)
    apart = 0
    for i in range(len(maps.rooms)):
        components, _ = ndimage.label(maps.occupancy[i] == 0, structure=structure)
        rows, columns = np.array(seed_points_of(maps, i)).T
        of_seed = components[rows, columns]
        together = of_seed[:, None] == of_seed[None, :]
        for search in SEARCHES:
            matrix = labels.matrix(search, i)
            np.testing.assert_array_equal(matrix != -1, together)
            assert (matrix[together] >= 0).all()
        first, last = maps.segment_offsets[i : i + 2]
        np.testing.assert_array_equal(labels.reachable[first:last], together.diagonal(1))
        assert labels.all_connected[i] == together.all()
        apart += not together.all()
    assert 0 < apart < len(maps.rooms)


@movements
def test_shapes_and_types(movement: Movement) -> None:
    """Flat arrays hold n - 1 segments a map, in order, and an empty batch has none."""
    for count in (0, 1, 25):
        maps = generate(MapSpec(movement=movement), 2, range(count))
        labels = label(maps)
        segments = int((maps.rooms - 1).sum())
        assert maps.segment_offsets.tolist() == [0, *np.cumsum(maps.rooms - 1).tolist()]
        assert (labels.reachable.shape, labels.all_connected.shape) == ((segments,), (count,))
        assert labels.reachable.dtype == labels.all_connected.dtype == np.bool_
        for search in SEARCHES:
            assert labels.by_search(search).iterations.dtype == np.int64
            assert labels.by_search(search).iterations.shape == (segments,)


@movements
def test_labels_do_not_depend_on_the_batch(movement: Movement) -> None:
    """A map alone, last or first in its batch, has the same labels."""
    generator = replace(MapSpec.preset("narrow"), movement=movement)
    together = label(generate(generator, 3, range(6)))
    for i in range(6):
        alone = label(generate(generator, 3, [i]))
        for search in SEARCHES:
            np.testing.assert_array_equal(alone.matrix(search, 0), together.matrix(search, i))
            np.testing.assert_array_equal(
                alone.iterations(search, 0), together.iterations(search, i)
            )
            for segment_alone, segment_together in zip(
                alone.route(search, 0), together.route(search, i), strict=True
            ):
                np.testing.assert_array_equal(segment_alone, segment_together)


def test_another_maps_labels_are_never_given() -> None:
    """A map, segment or planner that is not there is an error, not a neighbour's label."""
    maps = generate(MapSpec(), 3, range(4))
    labels, last = label(maps), int(maps.rooms[0]) - 1
    for i, q in ((0, last), (4, 0)):
        with pytest.raises((IndexError, ValueError)):
            labels.segment("bfs", i, q)
    for search, i in (("bfs", 4), ("dijkstra", 0)):
        for asked in (labels.matrix, labels.iterations, labels.route):
            with pytest.raises((IndexError, ValueError)):
                asked(search, i)


@pytest.mark.parametrize("cell", [(-1, 3), (-3, 3), (16, 3), (3, -1), (3, 16), (3, 18), (3, -3)])
def test_a_seed_point_outside_is_refused(cell: reference.Cell) -> None:
    """Also where, row after row, the cell would be a free one of the next row."""
    maps = generate(MapSpec((16, 16), (2, 2), (16, 16), (16, 16), passage_width=(1, 1)), 0, [0, 1])
    assert not maps.occupancy[:, 1:-1, 1:-1].all()
    maps.packed[:] = 0  # all is free
    maps.seed_points[1, 1] = cell
    with pytest.raises(ValueError, match=f"{re.escape(str(cell))} of map 1 is not a free"):
        label(maps)
    maps.seed_points[0, 0] = cell
    with pytest.raises(ValueError, match=f"{re.escape(str(cell))} of map 0 is not a free"):
        label(maps)


def test_a_seed_point_in_a_wall_is_refused() -> None:
    """A search would begin where nobody can stand."""
    maps = generate(MapSpec(), 0, [4])
    maps.packed[:] = 0
    maps.packed[0, 5] = 1 << 7
    maps.seed_points[0, 1] = (5, 7)
    with pytest.raises(ValueError, match=r"seed_points: \(5, 7\) of map 4 is not a free cell"):
        label(maps)


@pytest.mark.parametrize("has_terrain", [False, True])
def test_costs_without_a_path_take_the_place_of_what_memory_held(has_terrain: bool) -> None:
    """(-1, 0), since the content hash covers both numbers; on terrain, costs are doubled."""
    grid = np.zeros((5, 9), np.uint8)
    grid[:, 4] = 1
    lattice, scratch = search_memory(grid.shape, move_rule(Movement(8)))
    map_, cell_costs = as_ground(grid, 1 - grid if has_terrain else None)
    is_valid, ground = load_map(map_, cell_costs, lattice, scratch.came_from)
    assert is_valid
    neighbours = np.zeros(lattice.cells, np.uint8)
    find_free_neighbours(scratch.came_from, lattice, neighbours)
    ends = np.array([cell_at(2, column, lattice) for column in (2, 6, 7)])
    costs = np.full((3, 2), 7)
    source = np.array([cell_at(2, 0, lattice)])
    assert _fill_costs(source, ends, ground, neighbours, lattice, scratch, costs) == 0
    assert costs.tolist() == [[4 if has_terrain else 2, 0], [-1, 0], [-1, 0]]


@pytest.mark.slow
def test_the_papers_shares() -> None:
    """The design's figures: about 99 % of paper segments have a path, about 96 % of paper maps are
    one component.
    """
    labels = label(generate(MapSpec(), 0, range(5000)))
    assert labels.reachable.mean() == pytest.approx(0.99, abs=0.006)
    assert labels.all_connected.mean() == pytest.approx(0.96, abs=0.015)


@pytest.mark.parametrize("preset", ["maze15", "dungeon", "noise30"])
def test_bits_and_queue_give_equal_labels(preset: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which of them runs depends on the lengths of paths, and changes nothing but the time."""
    maps = generate(preset, 5, range(40))
    found = []
    for threshold in (0.0, math.inf):
        monkeypatch.setattr(labels_module, "LONG_PATHS", threshold)
        found.append(label(maps).bfs)
    for name in ("moves", "offsets", "iterations", "costs"):
        np.testing.assert_array_equal(getattr(found[0], name), getattr(found[1], name))


def test_a_grid_in_place_of_maps_is_refused() -> None:
    """Labels are of maps with seed points."""
    with pytest.raises(TypeError, match="maps: got ndarray, expected the Maps that"):
        label(np.zeros((3, 3), np.uint8))  # type: ignore[arg-type]
