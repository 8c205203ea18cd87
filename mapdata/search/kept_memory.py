"""The memory of searches that a thread keeps from one call to the next."""

from __future__ import annotations

import threading

import numpy as np

from mapdata.arrays import Bytes
from mapdata.jit import Int
from mapdata.search.kernels import Scratch, plain_scratch_view, scratch_bytes
from mapdata.search.lattice import Lattice, MoveRule, plain_lattice

MAX_KEPT_BYTES = 5 * 2**28
"""Largest scratch memory that a thread keeps from one call to the next: 1.25 GiB.

Faulting in new pages takes longer than most searches. What is kept is address space: only pages
that searches touched take memory, mostly less than a quarter. A call that needs more, under
8-connectivity on over 9.7 M cells, allocates memory for itself and frees it.
"""


class _ThreadScratch(threading.local):
    """Scratch memory of each thread. Kernels run without the GIL, so threads cannot share it.

    Attributes:
        memory: the memory.
        shape: rows and columns of the maps of the last call for many problems.
        rule: rule of that call.
        parts: the lattice of that call, and ``memory`` as its scratch. To make them takes as long
            as to solve a few problems.
    """

    memory = np.empty(0, np.uint8)
    shape: tuple[int, ...] = ()
    rule: MoveRule = (0, 0)
    parts: tuple[Lattice, Scratch] | None = None


_thread_scratch = _ThreadScratch()


def kept_memory(shape: tuple[Int, Int], rule: MoveRule) -> Bytes:
    """Return memory for any search on maps of ``shape`` (rows, columns).

    The thread's next call overwrites it.
    """
    rows, columns = shape
    diagonals, _ = rule
    max_pushes_per_cell = 8 if diagonals else 4
    size = scratch_bytes(max_pushes_per_cell, (rows + 2) * (columns + 2))
    memory = _thread_scratch.memory
    if size > len(memory):
        memory = np.empty(size, np.uint8)
        if size <= MAX_KEPT_BYTES:
            _thread_scratch.memory = memory
            _thread_scratch.parts = None  # They are of the old memory, which would be kept, too.
    return memory


def kept_search_memory(shape: tuple[Int, Int], rule: MoveRule) -> tuple[Lattice, Scratch]:
    """Return the lattice of maps of ``shape`` (rows, columns), and `kept_memory` as its scratch.

    It is `mapdata.search.kernels.search_memory` for callers that come back soon.
    """
    kept = _thread_scratch
    if kept.parts is not None and kept.shape == shape and kept.rule == rule:
        return kept.parts
    memory = kept_memory(shape, rule)
    lattice = plain_lattice(shape, rule)
    parts = lattice, plain_scratch_view(memory, lattice)
    if memory is kept.memory:
        kept.shape, kept.rule, kept.parts = shape, rule, parts
    return parts
