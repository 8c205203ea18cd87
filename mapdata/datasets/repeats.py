"""A warning where a plain DataLoader serves the same random problems in each epoch."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import torch
from torch.utils.data import get_worker_info

from mapdata.arrays import Ints

_process = {"warned": False}
"""Whether this process has warned. One warning says it all, however many datasets there are."""

MAX_WATCHED = 2**30
"""A dataset with more problems is not watched: nobody passes over it twice, and the watch takes a
byte for each.
"""

_WARNED = -(2**62)
"""So many starts of workers, which stay below 0 for ever, say that there was a warning."""


class RepeatWatch:
    """Finds out whether a second, shuffled pass over a dataset repeats the draws of the first one.

    In the main process the first pass is over once each problem was served. A worker of a loader
    serves a part of each pass, so the first worker counts: the starts of first workers, and what it
    has served itself, since persistent workers are started only once.

    A later pass in ascending order is a validation, which should repeat its problems. A single
    batch may be a look at the data, so the second batch in another order gives the warning.
    """

    def __init__(self) -> None:
        """Begin before the first pass."""
        # Shared by all processes. It is negative once there was a warning.
        self._starts_of_workers = torch.zeros(1, dtype=torch.int64).share_memory_()
        self._is_in_worker = False
        self._is_seen: np.ndarray[tuple[int], np.dtype[np.bool_]] | None = None
        self._seen_count = 0  # with repetitions
        self._first_pass_is_over = False
        self._last_problem = -1
        self._shuffled_batches = 0

    def sees_repeats(self, problems: Ints, length: int) -> bool:
        """Take in a batch of epoch 0; return whether it is now known that a pass repeats another.

        Args:
            problems: (B,) the numbers of the problems, B at least 1.
            length: the number of all problems.
        """
        if length > MAX_WATCHED:
            return False
        worker = get_worker_info()
        if worker is None:
            is_later_pass = self._was_first_pass_over(problems, length)
        elif worker.id == 0:
            is_later_pass = self._was_first_part_over(problems, length / worker.num_workers)
        else:
            return False
        if not is_later_pass:
            return False
        # A pass in ascending order may begin again, for instance after a break.
        follows = problems[0] > self._last_problem or problems[0] == 0
        is_ascending = follows and bool((problems[1:] > problems[:-1]).all())
        self._last_problem = int(problems[-1])
        self._shuffled_batches += not is_ascending
        sees_repeats = self._shuffled_batches >= 2
        if sees_repeats:
            self._starts_of_workers.fill_(_WARNED)
        return sees_repeats

    def _was_first_pass_over(self, problems: Ints, length: int) -> bool:
        """Take in a batch of the main process; return whether the first pass was over before it."""
        if self._first_pass_is_over:
            self._is_seen = None
            return True
        if self._is_seen is None:
            self._is_seen = np.zeros(length, np.bool_)
        self._is_seen[problems] = True
        self._seen_count += len(problems)
        self._first_pass_is_over = self._seen_count >= length and bool(self._is_seen.all())
        return False

    def _was_first_part_over(self, problems: Ints, part: float) -> bool:
        """Take in a batch of the first worker; return whether its first part was over before it.

        Args:
            problems: (B,) the numbers of the problems.
            part: how many problems of a pass the worker serves, up to a batch more or less.
        """
        if not self._is_in_worker:  # What the main process has seen does not count here.
            self._is_in_worker = True
            self._seen_count = 0
            self._starts_of_workers += 1
        starts = int(self._starts_of_workers.item())
        is_over = starts > 1 or (starts == 1 and self._seen_count >= part + len(problems))
        self._seen_count += len(problems)
        return is_over

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for another process: a watch before its first pass."""
        return {
            **vars(self),
            "_is_seen": None,
            "_seen_count": 0,
            "_first_pass_is_over": False,
            "_last_problem": -1,
            "_shuffled_batches": 0,
        }


def warn_of_repeats(drawn: str) -> None:
    """Warn, once for each process, that each pass serves the same draws.

    Args:
        drawn: what should be drawn anew, "problems", "symmetries" or "light".
    """
    if _process["warned"]:
        return
    _process["warned"] = True
    warnings.warn(
        f"a second pass over this dataset serves the same {drawn} as the first, those of epoch 0: "
        "instead of shuffle=True give the DataLoader sampler=EpochSampler(dataset, batch_size, "
        "sampling_seed=0) of mapdata.datasets, or use MapDataModule, and each pass is an epoch of "
        "its own",
        stacklevel=4,
    )
