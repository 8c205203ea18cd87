"""Problems of a source are drawn on given maps, whoever gives the maps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import torch

from mapdata import MapDataset, Maze, Movement, OnlineMapDataset, ProblemSet, build, generate
from mapdata.arrays import Ints
from mapdata.problems import drawing, sources
from mapdata.problems.drawing import Drawing, Drawn, GivenMaps, Paths
from mapdata.search.map_stack import MapStack

MAZE = Maze((9, 9))
SEED = 5


@dataclass(frozen=True)
class FirstToLast:
    """The way from the first free cell of a map to the last one, which is no source of mapdata."""

    name: ClassVar[str] = "first-to-last"
    counted: ClassVar[str] = "maps"
    is_stored: ClassVar[bool] = False
    needs_seed_points: ClassVar[bool] = False
    goals_differ: ClassVar[bool] = False
    remedy: ClassVar[str] = "other maps"
    unsolvable: ClassVar[bool] = False
    per_map: ClassVar[int] = 1


def draw_first_to_last(
    drawing: Drawing, given: GivenMaps, maps: MapStack, keys: Ints, epoch: int
) -> tuple[Ints, None]:
    """Return the first and the last free cell of each map."""
    del drawing, given, keys, epoch
    ends = [np.argwhere(grid == 0)[[0, -1]].reshape(-1) for grid in maps.grids]
    return np.array(ends), None


@pytest.fixture
def _source(monkeypatch: pytest.MonkeyPatch) -> None:
    """Add the source as its author would: to the sources, with a function that draws it."""
    monkeypatch.setattr(sources, "Source", sources.Source | FirstToLast)
    monkeypatch.setitem(drawing._DRAWN_BY, FirstToLast, draw_first_to_last)


@pytest.mark.usefixtures("_source")
def test_a_further_source_serves_datasets_and_sets(tmp_path: Path) -> None:
    """No class of a dataset or set knows it."""
    build(tmp_path, MAZE, maps=6, seed=SEED, workers=1)
    fields = ("map_index", "start", "goal")
    source: sources.Source = FirstToLast()  # type: ignore[assignment]
    cells = [np.argwhere(grid == 0) for grid in generate(MAZE, SEED, range(6)).occupancy]
    first, last = (np.array([of_map[k] for of_map in cells]) for k in (0, -1))
    for dataset in (
        MapDataset(tmp_path, fields=fields, problems=source),
        OnlineMapDataset(MAZE, SEED, 6, fields=fields, problems=source),
    ):
        batch = dataset[:]
        assert batch.map_index.tolist() == [0, 1, 2, 3, 4, 5]
        assert torch.equal(batch.start, torch.from_numpy(first))
        assert torch.equal(batch.goal, torch.from_numpy(last))
    problem_set = ProblemSet.sample(MAZE, SEED, 6, problems=source)
    np.testing.assert_array_equal(problem_set.starts, first)
    np.testing.assert_array_equal(problem_set.goals, last)
    of_split = ProblemSet.read(tmp_path, split="train", problems=source)
    assert 0 < len(of_split) <= 6
    assert set(map(tuple, of_split.goals)) <= set(map(tuple, last))


def paths_of(*cells: list[tuple[int, int]]) -> Paths:
    """Return paths; path k took k + 1 iterations."""
    joined = np.array([cell for path in cells for cell in path], np.int64).reshape(-1, 2)
    offsets = np.cumsum([0, *map(len, cells)])
    return Paths(joined, offsets, np.arange(1, len(cells) + 1))


def as_lists(paths: Paths) -> list[tuple[list[list[int]], int]]:
    """Return cells and iterations of each path."""
    parts = np.split(paths.cells, paths.offsets[1:-1])
    return [(part.tolist(), int(n)) for part, n in zip(parts, paths.iterations, strict=True)]


def test_problems_are_replaced_with_their_maps_and_paths() -> None:
    """Number, map, ends and path; a path that is empty, too."""
    maps = MapStack(np.zeros((3, 2, 2), np.uint8), None)
    ends = np.array([[0, 0, 0, 1], [-1] * 4, [1, 0, 1, 1]])
    drawn = Drawn(
        np.array([7, 8, 9]), maps, maps, ends, paths_of([(0, 0), (0, 1)], [], [(1, 0), (1, 1)])
    )
    other_maps = MapStack(np.ones((2, 2, 2), np.uint8), None)
    others = Drawn(
        np.array([20, 21]),
        other_maps,
        other_maps,
        np.array([[-1] * 4, [0, 1, 1, 1]]),
        paths_of([], [(0, 1), (1, 1)]),
    )
    mended = drawn.overwritten(np.array([1]), others, np.array([1]))
    assert mended.numbers.tolist() == [7, 21, 9]
    assert mended.has_problem.all()
    assert mended.maps.grids.any(axis=(1, 2)).tolist() == [False, True, False]
    assert mended.starts.tolist() == [[0, 0], [0, 1], [1, 0]]
    assert mended.goals.tolist() == [[0, 1], [1, 1], [1, 1]]
    assert mended.paths is not None
    assert as_lists(mended.paths) == [
        ([[0, 0], [0, 1]], 1),
        ([[0, 1], [1, 1]], 2),
        ([[1, 0], [1, 1]], 3),
    ]


def test_parts_are_joined_in_their_order() -> None:
    """Inflated maps stay beside the stored ones."""
    movement = Movement()
    source = sources.Pairs()
    grids = np.zeros((2, 7, 7), np.uint8)
    grids[:, 3, 3] = 1
    points = np.array([[[0, 0], [6, 6]], [[0, 6], [6, 0]]])
    given = GivenMaps(np.array([4, 5]), MapStack(grids, None), points, np.array([2, 2]))
    rule = Drawing(source, 0, movement, attempts=1, min_clearance=9)
    whole = rule.on(given, np.arange(2))
    joined = Drawn.joined([rule.on(given.select(slice(k, k + 1)), np.array([k])) for k in (0, 1)])
    assert joined.numbers.tolist() == [4, 5]
    np.testing.assert_array_equal(joined.ends, whole.ends)
    np.testing.assert_array_equal(joined.maps.grids, whole.maps.grids)
    np.testing.assert_array_equal(joined.stored.grids, grids)
    assert whole.maps.grids.sum() > grids.sum()
    assert joined.paths is not None
    assert whole.paths is not None
    assert as_lists(joined.paths) == as_lists(whole.paths)


@pytest.mark.parametrize("source", [sources.Route(), sources.Random((10, None), None, None, True)])
def test_costs_that_are_too_high_are_refused_by_the_number_of_the_map(
    source: sources.Source,
) -> None:
    """That of the dataset, whichever row of a batch the map is in."""
    terrain = np.ones((2, 3, 4000), np.uint8)
    terrain[1] = 255
    terrain[:, 1, :-1] = 0  # so that paths lead to the far end and back
    points = np.array([[[0, 0], [2, 0]]] * 2)
    maps = MapStack((terrain == 0).astype(np.uint8), terrain)
    given = GivenMaps(np.array([4, 7]), maps, points, np.array([2, 2]))
    with pytest.raises(ValueError, match=r"^map 7: terrain: a path costs"):
        Drawing(source, 0, Movement(8), attempts=1).on(given, np.arange(2))
