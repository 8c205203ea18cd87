"""A warning where a plain DataLoader serves the same random problems in each epoch."""

from __future__ import annotations

import warnings

import numpy as np
from torch.utils.data import get_worker_info

from mapdata.arrays import Ints

_process = {"warned": False}
"""Whether this process has warned. One warning says it all, however many datasets there are."""

MAX_WATCHED = 2**30
"""A dataset with more problems is not watched: nobody passes over it twice, and the watch takes a
byte for each.
"""


class RepeatWatch:
    """Finds out whether a second, shuffled pass over a dataset repeats the draws of the first one.

    Only what is read in the main process is seen. The first pass is over once each problem was
    served. A later pass in ascending order is a validation, which should repeat its problems. A
    single batch may be a look at the data, so the second batch in another order gives the warning.
    """

    def __init__(self) -> None:
        """Begin before the first pass."""
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
        if get_worker_info() is not None or length > MAX_WATCHED:
            return False
        if not self._first_pass_is_over:
            if self._is_seen is None:
                self._is_seen = np.zeros(length, np.bool_)
            self._is_seen[problems] = True
            self._seen_count += len(problems)
            self._first_pass_is_over = self._seen_count >= length and bool(self._is_seen.all())
            return False
        self._is_seen = None
        # A pass in ascending order may begin again, for instance after a break.
        follows = problems[0] > self._last_problem or problems[0] == 0
        is_ascending = follows and bool((problems[1:] > problems[:-1]).all())
        self._last_problem = int(problems[-1])
        self._shuffled_batches += not is_ascending
        return self._shuffled_batches >= 2


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
