"""The table of samplers is compared with roadmaps that are built one by one, and with a sampler of
the vertices of shortest paths.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
import pytest
from helpers.examples import Some

from mapdata import Movement, ProblemSet
from mapdata.models.pretrained.lego.experience import Mining, near_optimal_paths
from mapdata.roadmaps import (
    build_roadmap,
    compare,
    connection_radius,
    contenders,
    free_at,
    halton,
    plot_success,
    to_text,
    uniform,
)
from mapdata.roadmaps.comparison import DENSE, DENSE_SEED

Points: TypeAlias = npt.NDArray[np.float64]
Grids: TypeAlias = npt.NDArray[np.uint8]
Cells: TypeAlias = npt.NDArray[np.int64]


class Learned:
    """A sampler as `contenders` takes it, which has learned nothing: its points are uniform."""

    def sample_batch(
        self, grids: Grids, starts: Cells, goals: Cells, n: int, seed: int = 0
    ) -> Points:
        """Return (B, n, 2) points in free cells."""
        return np.stack([uniform(grid, n, seed + 99 + k) for k, grid in enumerate(grids)])


@cache
def unseen_problems(maps: int = 12) -> ProblemSet:
    """Return a problem on each of some maps."""
    return ProblemSet.sample("dungeon", seed=2718, maps=maps, movement=Movement(8))


def first_path(problems: ProblemSet, k: int) -> Points:
    """Return a shortest path of a problem on a dense roadmap, both ends included."""
    grid = problems.grids[k]
    return near_optimal_paths(grid, problems.starts[k], problems.goals[k], Mining(), k)[0]


def shortest(grid: Grids, problems: ProblemSet, k: int, points: Points) -> float:
    """Return the length of the shortest path of problem k on a roadmap of these points."""
    ends = [problems.starts[k] + 0.5, problems.goals[k] + 0.5]
    max_length = connection_radius(len(points), grid.shape)
    return build_roadmap(grid, np.concatenate([ends, points]), max_length).shortest_path()[0]


def test_the_table_has_success_and_lengths_of_roadmaps(some: Some) -> None:
    """They are those of roadmaps that are built one by one, and lie in their intervals."""
    maps = some(40)
    problems = unseen_problems(maps)
    rows = contenders({"learned": Learned()})
    with_two_rows = ["gaussian", "bridge", "corners", "medial_axis", "learned"]
    alone = [f"{name}_alone" for name in with_two_rows]
    assert set(rows) == {"halton", "uniform", *with_two_rows, *alone}
    table = compare(rows, problems, [24, 50], bootstrap=50)
    sizes = 2
    subsets = 2
    assert len(table) == len(rows) * sizes * subsets
    assert set(table["problems"]) == {maps, int(problems.hard.sum())}
    assert (table["length_ratio"].isna() == (table["success"] == 0)).all()
    solved_some = table[table["success"] > 0]
    for metric in ("success", "length_ratio"):
        assert (solved_some[f"{metric}_low"] <= solved_some[metric]).all()
        assert (solved_some[f"{metric}_high"] >= solved_some[metric]).all()
    assert "hard: " in to_text(table)

    lengths = []
    dense_lengths = []
    for k, grid in enumerate(problems.grids):
        lengths.append(shortest(grid, problems, k, halton(grid, 24, k)))
        dense = halton(grid, DENSE, DENSE_SEED + k)
        dense_lengths.append(shortest(grid, problems, k, dense))
    is_solved = np.isfinite(lengths)
    both_solved = is_solved & np.isfinite(dense_lengths)
    ratios = np.divide(lengths, dense_lengths, where=both_solved, out=np.zeros(maps))[both_solved]
    of_halton = table[table["sampler"] == "halton"]
    row = of_halton[(of_halton["subset"] == "all") & (of_halton["n"] == 24)].iloc[0]
    assert row["success"] == pytest.approx(is_solved.mean())
    assert row["length_ratio"] == pytest.approx(ratios.mean())


@pytest.mark.slow
def test_a_perfect_sampler_is_perfect() -> None:
    """A sampler of the vertices of the shortest path solves all problems, and its paths are as long
    as those on the dense roadmap.
    """
    problems = unseen_problems()

    def perfect(
        grids: Grids,
        starts: Cells,
        goals: Cells,
        n: int,
        seeds: Sequence[int],
    ) -> Points:
        """Return the n inner points of each path, filled up with its last point."""
        samples = np.empty((len(grids), n, 2))
        for k in range(len(grids)):
            inner_points = first_path(problems, k)[1:-1]
            samples[k] = inner_points[np.minimum(np.arange(n), len(inner_points) - 1)]
        return samples

    table = compare({"perfect": perfect, "halton": contenders({})["halton"]}, problems, [100])
    all_problems = table[table["subset"] == "all"].set_index("sampler")
    assert all_problems.success["perfect"] == 1
    assert all_problems.success_low["perfect"] == 1
    assert all_problems.length_ratio["perfect"] == pytest.approx(1, abs=0.01)
    assert all_problems.length_ratio["perfect"] < all_problems.length_ratio["halton"]


def test_terrain_is_refused() -> None:
    """Roadmaps are searched by length, so costs of cells would be ignored."""
    movement = Movement(8, corner_cutting=True, diagonal_cost=1)
    problems = ProblemSet.sample("tiles", maps=2, movement=movement, problems="route")
    with pytest.raises(ValueError, match="roadmaps: got maps with terrain"):
        compare(contenders({}), problems, [10])


def test_a_roadmap_of_one_vertex_is_refused() -> None:
    """The half that is not Halton's would have no vertex."""
    with pytest.raises(ValueError, match="sizes of 2 or more"):
        compare(contenders({}), unseen_problems(), [1])


def test_every_row_has_n_free_points() -> None:
    """This holds for odd n, too. In rows that are half Halton's, these are the points of the row of
    Halton, and the others are those of the sampler alone.
    """
    problems = unseen_problems()
    problem_arrays = (problems.grids, problems.starts, problems.goals)
    rows = contenders({"learned": Learned()})
    for n in (2, 25):
        second_half = n // 2
        first_half = n - second_half
        points = {name: row(*problem_arrays, n, range(12)) for name, row in rows.items()}
        for samples in points.values():
            assert samples.shape == (12, n, 2)
            for grid, of_problem in zip(problems.grids, samples, strict=True):
                assert free_at(grid, of_problem).all()
        for name in ("gaussian", "bridge", "corners", "medial_axis", "learned"):
            assert np.array_equal(points[name][:, :first_half], points["halton"][:, :first_half])
            alone = rows[f"{name}_alone"](*problem_arrays, second_half, range(12))
            assert np.array_equal(points[name][:, first_half:], alone)


@pytest.mark.slow
def test_the_figure() -> None:
    """It has a line for each sampler, and the error bars end at the bounds of the intervals."""
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    rows = contenders({})
    table = compare(rows, unseen_problems(), [10, 20], bootstrap=50)
    axes = plot_success(table, Figure().add_subplot(), "all")
    assert len(axes.lines) == len(rows) == 10
    by_sampler = table[table["subset"] == "all"].pivot(index="n", columns="sampler")
    bars = [bar for bar in axes.collections if isinstance(bar, LineCollection)]
    for name, bar in zip(table["sampler"].unique(), bars, strict=True):
        ends = np.array([segment[:, 1] for segment in bar.get_segments()])
        success = by_sampler["success"][name]
        assert np.allclose(ends[:, 0], np.minimum(by_sampler["success_low"][name], success))
        assert np.allclose(ends[:, 1], np.maximum(by_sampler["success_high"][name], success))
