"""Mazes: equal to a slow reference, spanning trees by scipy, and a dataset like any other in every
verb and field.
"""

from __future__ import annotations

import re

import numpy as np
import pytest
from helpers.examples import examples
from helpers.reference import reference_split
from helpers.reference_families import reference_maze, reference_points
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from mapdata import (
    Maze,
    generate,
    label,
)

SETTINGS = examples(150)


@st.composite
def mazes(draw: st.DrawFn) -> Maze:
    """Any maze of up to 24 cells a side with at least two lattice cells."""
    corridor, wall = draw(st.integers(1, 3)), draw(st.integers(1, 3))
    least = corridor + 2 * wall
    size = draw(st.tuples(st.integers(least, 24), st.integers(least + corridor + wall, 24)))
    points = draw(st.integers(2, 4))
    reopened = draw(st.sampled_from([0.0, 0.3, 1.0]))
    cells = np.prod([(side - wall) // (corridor + wall) for side in size])
    return Maze(size, corridor, wall, reopened, min(points, int(cells)))


@SETTINGS
@given(mazes(), st.integers(0, 2**64 - 1), st.integers(0, 2**63 - 1))
def test_any_maze_equals_the_reference(generator: Maze, seed: int, index: int) -> None:
    """Grid, seed points and split, for all widths, sizes that the lattice does not fill, large
    seeds and indices.
    """
    maps = generate(generator, seed, [index])
    grid = reference_maze(generator, seed, index)
    free = [(int(row), int(column)) for row, column in np.argwhere(np.array(grid) == 0)]
    assert maps.occupancy[0].tolist() == grid
    points = reference_points(free, seed, index, generator.seed_points)
    assert maps.seed_points[0].tolist() == [list(cell) for cell in points]
    assert len(set(points)) == generator.seed_points == maps.rooms[0]
    assert maps.split[0] == reference_split(generator, seed, index)
    assert (maps.sizes == -1).all()
    assert (maps.directions == -1).all()
    assert (maps.passage_width == -1).all()


@pytest.mark.parametrize(("corridor", "wall"), [(1, 1), (3, 2)])
def test_perfect_mazes_are_trees(corridor: int, wall: int) -> None:
    """All cells are joined, by one way only: as many open walls as cells less one."""
    generator = Maze((60, 45), corridor, wall)
    pitch = corridor + wall
    cells = ((60 - wall) // pitch) * ((45 - wall) // pitch)
    for grid in generate(generator, 11, range(20)).occupancy:
        assert ndimage.label(grid == 0)[1] == 1
        assert (grid == 0).sum() == cells * corridor**2 + (cells - 1) * corridor * wall


def test_reopened_walls_have_their_share() -> None:
    """Of the walls that a perfect maze leaves, a share is open; with 1 all are."""
    size = (41, 41)
    perfect = generate(Maze(size), 5, range(200)).occupancy
    some = generate(Maze(size, reopened=0.2), 5, range(200)).occupancy
    every = generate(Maze(size, reopened=1.0), 5, range(3)).occupancy
    assert (some <= perfect).all()  # the same maze with more walls open
    closed = 2 * 20 * 19 - (20 * 20 - 1)
    share = (perfect.astype(int) - some).sum() / (200 * closed)
    assert share == pytest.approx(0.2, abs=5 * (0.2 * 0.8 / (200 * closed)) ** 0.5)
    assert all((grid == 0).sum() == 20 * 20 + 2 * 20 * 19 for grid in every)


def test_seed_points_lie_far_apart() -> None:
    """On the average much farther than cells drawn uniformly: the nearest two are twice as far."""
    maps = generate(Maze(), 3, range(200))
    source = np.random.default_rng(0)

    def nearest(points: np.ndarray) -> float:
        gaps = np.linalg.norm(points[:, None] - points[None], axis=2)
        return float(gaps[np.triu_indices(len(points), 1)].min())

    spread = [nearest(points) for points in maps.seed_points]
    uniform = [
        nearest(np.argwhere(grid == 0)[source.choice((grid == 0).sum(), 5)])
        for grid in maps.occupancy
    ]
    assert np.mean(spread) > 1.7 * np.mean(uniform)


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ({"corridor": 0}, "corridor: got 0, expected an integer of at least 1"),
        ({"wall": 0}, "wall: got 0"),
        ({"reopened": 1.5}, "reopened: got 1.5, expected a probability"),
        ({"seed_points": 1}, "seed_points: got 1"),
        ({"seed_points": 256}, "seed_points: got 256, expected at most 255"),
        ({"map_size": (5, 4)}, "seed_points: got 5, expected at most 2"),
        ({"map_size": (4, 4)}, "map_size: got (4, 4), expected a maze of at least 2 junctions"),
        ({"map_size": (2, 2), "wall": 5}, "map_size: got (2, 2)"),
        ({"map_size": (5000, 64)}, "map_size"),
    ],
)
def test_bad_values_are_refused(values: dict[str, object], why: str) -> None:
    """The message names the value, and what was expected."""
    with pytest.raises(ValueError, match=re.escape(why)):
        Maze(**values)  # type: ignore[arg-type]


def test_labels_of_perfect_mazes_have_one_path() -> None:
    """Both searches find the only one."""
    labels = label(generate(Maze((21, 21)), 1, range(10)))
    assert labels.all_connected.all()
    np.testing.assert_array_equal(labels.bfs.moves, labels.astar.moves)
    np.testing.assert_array_equal(labels.bfs.costs, labels.astar.costs)
