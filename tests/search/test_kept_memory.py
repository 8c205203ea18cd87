"""The memory of searches: kept between calls up to a bound, and for one thread alone."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from helpers.examples import Some, slow
from helpers.specs import movements

from mapdata import astar, bfs
from mapdata.movement import Movement
from mapdata.search import kept_memory, search_batch
from mapdata.search.kernels import search_memory
from mapdata.search.lattice import move_rule

OCTILE = Movement(8)
CUTTING = Movement(8, corner_cutting=True)


@movements
@pytest.mark.parametrize("side", [256, slow(1024)])
def test_a_plain_call_faults_in_no_pages(some: Some, movement: Movement, side: int) -> None:
    """What a search writes to is there from the call before."""
    resource = pytest.importorskip("resource")
    grid = np.zeros((side, side), dtype=np.uint8)
    ends = ((0, 0), (side - 1, side // 2))
    calls = some(50)
    for search in (astar, bfs):
        search(grid, *ends, movement)
        search(grid, *ends, movement)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        for _ in range(calls):
            search(grid, *ends, movement)
        faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
        assert faults < calls, f"{faults} page faults in {calls} calls of {search.__name__}"


def test_threads_do_not_share_scratch_memory() -> None:
    """Searches of several threads at a time find what they find alone."""
    source = np.random.default_rng(4)
    grids = [(source.random((side, side)) < 0.3).astype(np.uint8) for side in (70, 130, 257, 90)]
    for grid in grids:
        grid[0, 0] = grid[-1, -1] = 0

    def solve(k: int) -> tuple[list[list[int]], float, int]:
        grid = grids[k % len(grids)]
        last = len(grid) - 1
        if k % 2:
            solution = bfs(grid, (0, 0), (last, last), CUTTING)
        else:
            solution = astar(grid, (0, 0), (last, last), OCTILE)
        return solution.path.tolist(), solution.cost, solution.iterations

    alone = [solve(k) for k in range(8)]
    together: dict[int, list[object]] = {k: [] for k in range(8)}

    def work(k: int) -> None:
        together[k] += [solve(k) for _ in range(30)]

    threads = [threading.Thread(target=work, args=(k,)) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert together == {k: [alone[k]] * 30 for k in range(8)}


def test_scratch_memory_is_kept_up_to_a_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thread keeps what its largest search needed, unless that is above the bound."""
    monkeypatch.setattr(kept_memory, "_thread_scratch", kept_memory._ThreadScratch())
    small, large = (np.zeros((side, side), dtype=np.uint8) for side in (64, 300))
    monkeypatch.setattr(kept_memory, "MAX_KEPT_BYTES", 10**6)
    astar(small, (0, 0), (9, 9), OCTILE)
    kept = kept_memory._thread_scratch.memory
    assert 0 < len(kept) <= 10**6
    solution = astar(large, (0, 0), (299, 299), OCTILE)
    assert solution.cost == 299 * 2**0.5
    assert kept_memory._thread_scratch.memory is kept
    monkeypatch.setattr(kept_memory, "MAX_KEPT_BYTES", 10**8)
    astar(large, (0, 0), (9, 9), OCTILE)
    assert len(kept) < len(kept_memory._thread_scratch.memory) <= 10**8


@movements
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (9, 1), (5, 8)])
def test_scratch_memory_holds_the_most_that_a_search_can_push(
    shape: tuple[int, int], movement: Movement, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is kept for calls from Python is as large as what kernels take for themselves."""
    monkeypatch.setattr(kept_memory, "_thread_scratch", kept_memory._ThreadScratch())
    rule = move_rule(movement)
    memory = kept_memory.kept_memory(shape, rule)
    _, scratch = search_memory(shape, rule)
    assert len(memory) == sum(part.nbytes for part in scratch)


def test_maps_of_other_shapes_and_rules_take_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is kept of the last call serves only maps of the same shape under the same rule."""
    monkeypatch.setattr(kept_memory, "_thread_scratch", kept_memory._ThreadScratch())
    source = np.random.default_rng(5)
    for k in range(60):
        movement = (Movement(4), Movement(8), CUTTING)[k % 3]
        shape = [(4, 7), (7, 4), (30, 2), (4, 7)][source.integers(4)]
        grids = (source.random((2, *shape)) < 0.2).astype(np.uint8)
        grids[:, 0, 0] = grids[:, -1, -1] = 0
        starts, goals = np.zeros((2, 2), int), np.full((2, 2), shape) - 1
        solved = search_batch("astar", grids, starts, goals, movement)
        for b in range(2):
            alone = astar(grids[b], starts[b], goals[b], movement)
            cells = solved.cells[solved.offsets[b] : solved.offsets[b + 1]]
            np.testing.assert_array_equal(cells, alone.path)
