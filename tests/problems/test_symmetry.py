"""Symmetries of maps and of the fields around their goals."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.specs import movements

from mapdata import Movement, Random
from mapdata.problems.sampling import sample_problems
from mapdata.problems.symmetry import transform_cells, transform_fields, transform_grids
from mapdata.search import rule_of
from mapdata.search.goals import GoalFields, fill_goal_fields, goal_fields


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (6, 5), (5, 70), (9, 9), (64, 64)], ids=str)
def test_grids_are_flipped_and_transposed_as_by_numpy(
    shape: tuple[int, int], dtype: type[np.uint8 | np.float32]
) -> None:
    """All codes at once; those that transpose on square maps alone."""
    codes = np.arange(8 if shape[0] == shape[1] else 4)
    grids = np.random.default_rng(0).integers(0, 200, (len(codes), *shape)).astype(dtype)
    found = transform_grids(grids, codes)
    assert found.dtype == dtype
    for code, grid in zip(codes.tolist(), grids, strict=True):
        expected = grid[::-1] if code & 1 else grid
        expected = expected[:, ::-1] if code & 2 else expected
        np.testing.assert_array_equal(found[code], expected.T if code & 4 else expected)


@movements
@pytest.mark.parametrize("shape", [(13, 13), (9, 70)], ids=str)
def test_fields_move_along_with_the_map(shape: tuple[int, int], movement: Movement) -> None:
    """Those found as problems are sampled, after a symmetry, are those of the map after it."""
    codes = np.arange(8 if shape[0] == shape[1] else 4)
    grids = (np.random.default_rng(1).random((len(codes), *shape)) < 0.25).astype(np.uint8)
    rule = rule_of(movement)
    sampled = goal_fields(grids.shape, GoalFields._fields)
    ends = sample_problems(grids, np.uint64(3), 0, codes, Random().bands, rule, sampled)
    starts = transform_cells(np.ascontiguousarray(ends[:, :2]), codes, *shape)
    goals = transform_cells(np.ascontiguousarray(ends[:, 2:4]), codes, *shape)
    expected = goal_fields(grids.shape, GoalFields._fields)
    fill_goal_fields(transform_grids(grids, codes), starts, goals, rule, expected)
    for name, found, truth in zip(
        GoalFields._fields, transform_fields(sampled, codes), expected, strict=True
    ):
        np.testing.assert_array_equal(found, truth, err_msg=name)
