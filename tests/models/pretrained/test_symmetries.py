"""The symmetries of a map move planes, points and cells alike."""

from __future__ import annotations

import pytest
import torch

from mapdata import MapSpec, Movement, ProblemSet
from mapdata.models.pretrained.symmetries import (
    random_symmetry,
    restore_plane,
    transform_plane,
    transform_points,
)


@pytest.mark.parametrize("code", range(8))
def test_a_plane_is_restored(code: int) -> None:
    """`restore_plane` is the inverse of `transform_plane`, for maps that are not square, too."""
    plane = torch.arange(2 * 5 * 7).view(2, 5, 7)
    assert torch.equal(restore_plane(transform_plane(plane, code), code), plane)


@pytest.mark.parametrize("code", range(8))
def test_a_point_stays_in_its_cell(code: int) -> None:
    """The cell under a point has the same number before and after, wherever in the cell it lies."""
    plane = torch.arange(5 * 7).view(5, 7)
    points = torch.rand(50, 2, generator=torch.Generator().manual_seed(0)) * torch.tensor([5, 7])
    row, column = points.long().unbind(1)
    transformed = transform_points(points, code, plane.shape)
    new_row, new_column = transformed.long().unbind(1)
    assert torch.equal(transform_plane(plane, code)[new_row, new_column], plane[row, column])


def test_symmetries_move_everything_along() -> None:
    """Points, starts, goals and masks stay on their cells of the map under all symmetries. All
    eight symmetries occur, each with and without a swap of start and goal.
    """
    problems = ProblemSet.sample(
        MapSpec.preset("dungeon"), seed=2718, maps=12, movement=Movement(8)
    )
    starts = torch.tensor(problems.starts)
    goals = torch.tensor(problems.goals)
    grids = torch.tensor(problems.grids)[:, None]
    maps = torch.arange(len(grids))
    marks = torch.zeros_like(grids)
    for rows, columns in (starts.T, goals.T):
        marks[maps, 0, rows, columns] = 1
    fields = {"map": grids, "optimal_mask": marks, "start": starts, "goal": goals}
    occupied = grids.sum(dim=(1, 2, 3))
    torch.manual_seed(0)
    outcomes = set()
    for _ in range(300):
        turned, points = random_symmetry(fields, starts + 0.25)
        for name in ("start", "goal"):
            rows, columns = turned[name].T
            assert (turned["optimal_mask"][maps, 0, rows, columns] == 1).all()
            assert (turned["map"][maps, 0, rows, columns] == 0).all()
        assert torch.equal(turned["map"].sum(dim=(1, 2, 3)), occupied)
        cells = points.floor().long()
        swapped = not torch.equal(cells, turned["start"])
        if swapped:
            assert torch.equal(cells, turned["goal"])
        outcomes.add((swapped, tuple(turned["start"][0].tolist())))
    assert len(outcomes) == 16
