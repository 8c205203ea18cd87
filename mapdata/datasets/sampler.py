"""`EpochSampler`: the order of a data loader, which a resumed training continues."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset
from torch.utils.data.distributed import DistributedSampler

from mapdata.arrays import Ints, UInt32s
from mapdata.checks import check_count
from mapdata.datasets.problem_dataset import ProblemDataset
from mapdata.datasets.sample import Sample
from mapdata.jit import Int, kernel
from mapdata.rng import ORDER, block

if TYPE_CHECKING:
    import pytorch_lightning as pl


class LateLoader(DataLoader[Sample]):
    """The DataLoader of `MapDataModule`, which can go on in the middle of an epoch.

    `EpochSampler` orders its samples. The loader starts when its first batch is requested, not when
    it is iterated over: Lightning creates the iterator before it has restored the position of a
    checkpoint, and workers prefetch batches at once.
    """

    _batches_handed_out: int = 0  # in the pass that began last

    def __iter__(self) -> Iterator[Any]:  # type: ignore[override]
        self._batches_handed_out = 0
        for batch in super().__iter__():
            self._batches_handed_out += 1
            yield batch

    def state_dict(self) -> dict[str, Any]:
        """Return where this loader is: an epoch, and how many of its batches were handed out.

        Batches that workers have prefetched do not count. All values are numbers, texts or None, so
        a checkpoint can hold them. After the last batch of an epoch it is the begin of the next
        one.
        """
        # Under Trainer(overfit_batches=...) Lightning puts a sampler of its own in place of ours.
        # Its position is not ours to know.
        if not isinstance(self.sampler, EpochSampler):
            return {_OTHER_SAMPLER: type(self.sampler).__name__}
        return self.sampler.state_dict(self._batches_handed_out)

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Begin the next pass where another loader was when it returned ``state``.

        The pass serves exactly the batches that were not handed out. Under a Trainer that resumes
        from a checkpoint, the Trainer's own position counts, which leaves out a batch whose
        training step did not end.

        At the begin of an epoch the loader may have other problems or another order than the one
        that returned the state. In the middle of an epoch another order gives a warning.

        Raises:
            ValueError: this is no state of such a loader, or one in the middle of an epoch of other
                problems.
        """
        self._batches_handed_out = 0
        holds_position = not isinstance(state, Mapping) or _OTHER_SAMPLER not in state
        if isinstance(self.sampler, EpochSampler) and holds_position:
            self.sampler.load_state_dict(state)


_OTHER_SAMPLER = "sampler"
"""Key of the state of a loader whose sampler is none of ours: the name of its class."""

_OTHER_PROBLEMS = ("problems", "problems_text")
"""Keys of a state that differ if the problems differ."""

MAX_SHUFFLED = 2**32
"""Samples of an order, whose numbers have 32 bits."""


class EpochSampler(DistributedSampler[Any]):
    """Yields ``index + epoch * len(dataset)``: each rank its share, from the Trainer's position on.

    For training the order is a permutation that is a function of (sampling seed, epoch). All ranks
    get equally many samples, so up to ranks - 1 samples are left out. For evaluation the order is
    that of the dataset in epoch 0, and every sample is on exactly one rank.

    Epoch, rank and position are read when the iteration starts, so that a resumed epoch continues
    where it stopped. Without a Trainer the first pass is epoch 0, or the epoch that `set_epoch`
    sets, and each further pass is the next epoch.
    """

    def __init__(
        self,
        dataset: Dataset[Sample],
        batch_size: int,
        sampling_seed: int | None,
        module: pl.LightningDataModule | None = None,
        *,
        drop_last: bool = False,
    ) -> None:
        """Keep the arguments.

        Args:
            dataset: whose samples are ordered.
            batch_size: samples in a batch of the loader.
            sampling_seed: seed of the permutations; None keeps the order of the dataset.
            module: its Trainer knows epoch, rank and position.
            drop_last: whether the loader leaves out a last batch that is not full.

        Raises:
            ValueError: more samples than an order can hold.
        """
        super().__init__(
            dataset,
            num_replicas=1,
            rank=0,
            shuffle=sampling_seed is not None,
            drop_last=drop_last,
        )
        sample_count = len(dataset)  # type: ignore[arg-type]
        if sampling_seed is not None and sample_count > MAX_SHUFFLED:
            raise ValueError(
                f"dataset: got {sample_count:,} problems, expected at most {MAX_SHUFFLED:,} to "
                "shuffle; take a smaller length or per_map, since each epoch has new problems"
            )
        if isinstance(dataset, ProblemDataset):
            dataset.expect_epochs()
        self.batch_size = batch_size
        self.sampling_seed = sampling_seed
        self.module = module
        # Epoch and batch at which the last pass began. None before the first one, and after
        # `set_epoch` or `load_state_dict`.
        self._began: tuple[int, int] | None = None
        # Epoch and batch that `load_state_dict` got. It counts if the next pass is of this epoch.
        self._loaded = (0, 0)

    def __repr__(self) -> str:
        arguments = f"batch_size={self.batch_size}, sampling_seed={self.sampling_seed}"
        return f"EpochSampler({self.dataset}, {arguments})"

    def __len__(self) -> int:
        """Return the number of samples of this rank."""
        rank, rank_count = self._rank()
        sample_count = len(self.dataset)  # type: ignore[arg-type]
        if self.sampling_seed is None:
            return len(range(rank, sample_count, rank_count))
        return sample_count // rank_count

    def __iter__(self) -> Iterator[int]:
        rank, rank_count = self._rank()
        sample_count = len(self.dataset)  # type: ignore[arg-type]
        epoch, batches_done = self._begin()
        if self.sampling_seed is None:
            in_order = range(rank, sample_count, rank_count)
            yield from in_order[batches_done * self.batch_size :]
            return
        # As an array the order takes four bytes a sample. Python's integers take nine times as
        # much, so they are created for one batch at a time.
        order = np.arange(sample_count, dtype=np.uint32)
        shuffle(order, np.uint64(self.sampling_seed), epoch)
        share = order[rank::rank_count][: len(self)]
        for first in range(batches_done * self.batch_size, len(share), self.batch_size):
            indices = share[first : first + self.batch_size].astype(np.int64)
            yield from (indices + epoch * sample_count).tolist()

    def _rank(self) -> tuple[int, int]:
        """Return the rank of this process and the number of ranks."""
        trainer = getattr(self.module, "trainer", None)
        if trainer is not None:
            return trainer.global_rank, trainer.world_size
        if torch.distributed.is_available() and torch.distributed.is_initialized():
            return torch.distributed.get_rank(), torch.distributed.get_world_size()
        return 0, 1

    def set_epoch(self, epoch: int) -> None:
        """Make the next pass that of ``epoch``."""
        super().set_epoch(epoch)
        self._began = None

    def state_dict(self, batches_handed_out: int) -> dict[str, Any]:
        """Return the position of a loader, as `LateLoader.state_dict` does.

        Args:
            batches_handed_out: by the loader in its last pass.
        """
        if self._began is not None:
            epoch, first_batch = self._began
            batches_done = first_batch + batches_handed_out
        else:
            epoch = self.epoch
            loaded_epoch, loaded_batches = self._loaded
            batches_done = loaded_batches if loaded_epoch == epoch else 0
        if batches_done >= self._batch_count():
            epoch += 1
            batches_done = 0
        return {"epoch": epoch, "batches_done": batches_done, **self._order()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Begin the next pass at the position of a loader, as `LateLoader.load_state_dict` does."""
        order = self._order()
        # States of version 0.3.0 have no text of the problems.
        names = ["epoch", "batches_done", *(name for name in order if name != "problems_text")]
        if not isinstance(state, Mapping) or not set(names) <= set(state):
            raise ValueError(
                f"state: got {state!r}, expected what state_dict() of a loader of MapDataModule "
                f"returned: a mapping with {', '.join(names)}; from a checkpoint without it, load "
                "only the weights of the model"
            )
        epoch = check_count("epoch", state["epoch"], minimum=0)
        batches_done = check_count("batches_done", state["batches_done"], minimum=0)
        changes = {
            name: _change(name, state[name], value)
            for name, value in order.items()
            if name in state and state[name] != value
        }
        self._check_changes(changes, batches_done)
        self.set_epoch(epoch)
        # In another order an epoch may have fewer batches than were done. Then it begins anew.
        self._loaded = (epoch, batches_done if batches_done < self._batch_count() else 0)

    def _check_changes(self, changes: Mapping[str, str], batches_done: int) -> None:
        """Refuse a state in the middle of an epoch of other problems; warn of another order.

        Args:
            changes: what has changed since the state was saved, in words, by the names of `_order`.
            batches_done: in the epoch of the state.

        Raises:
            ValueError: other problems, or more batches than an epoch has.
        """
        if batches_done == 0:
            return
        remedy = "resume from the end of an epoch, or load only the weights of the model"
        text = ", ".join(changes.values())
        if any(name in changes for name in _OTHER_PROBLEMS):
            raise ValueError(
                f"state: got one in the middle of an epoch of other problems ({text}), expected "
                f"one of the same problems; {remedy}"
            )
        if changes:
            warnings.warn(
                f"this loader goes on in the middle of an epoch of another order ({text}): in this "
                "epoch some samples may come twice or not at all",
                stacklevel=4,
            )
        elif batches_done >= self._batch_count():
            raise ValueError(
                f"batches_done: got {batches_done}, expected less than {self._batch_count()}, the "
                f"number of batches of an epoch; {remedy}"
            )

    def _order(self) -> dict[str, int | str | None]:
        """Return what decides, beside the epoch, which samples the batches of this rank hold."""
        dataset = self.dataset
        return {
            "batch_size": self.batch_size,
            "problems": len(dataset),  # type: ignore[arg-type]
            "problems_text": (
                dataset.problems_text() if isinstance(dataset, ProblemDataset) else None
            ),
            "ranks": self._rank()[1],
            "sampling_seed": self.sampling_seed,
        }

    def _begin(self) -> tuple[int, int]:
        """Begin a pass; return its epoch and the number of its batches that are done."""
        self._began = self._position()
        self._loaded = (0, 0)
        return self._began

    def _position(self) -> tuple[int, int]:
        """Return the epoch of the next pass and the number of its batches that are done."""
        trainer = getattr(self.module, "trainer", None)
        if self.sampling_seed is not None and trainer is not None and trainer.training:
            # This attribute of Lightning is not public, but no public one holds the number.
            # tests/datasets/test_datamodule.py would notice a change.
            batches_done = int(trainer.fit_loop.epoch_loop.batch_progress.current.ready)
            is_within_epoch = batches_done < self._batch_count()
            return trainer.current_epoch, batches_done if is_within_epoch else 0
        epoch = self.epoch
        self.epoch += 1
        loaded_epoch, loaded_batches = self._loaded
        return epoch, loaded_batches if loaded_epoch == epoch else 0

    def _batch_count(self) -> int:
        """Return the number of batches of an epoch on this rank."""
        full_batches, remainder = divmod(len(self), self.batch_size)
        has_partial_batch = remainder > 0 and not self.drop_last
        return full_batches + has_partial_batch


def _change(name: str, saved: object, here: object) -> str:
    """Return in words how an entry of a state differs from that of this loader."""
    if name != "problems_text":
        return f"{name} was {saved} and is {here}"
    # These texts have several parts, of which usually one differs.
    saved_parts, here_parts = str(saved).split("; "), str(here).split("; ")
    gone = "; ".join(part for part in saved_parts if part not in here_parts)
    new = "; ".join(part for part in here_parts if part not in saved_parts)
    saved_with = f"with {gone}" if gone else "without it"
    here_with = f"with {new}" if new else "without it"
    return f"saved {saved_with}, here {here_with}"


@kernel
def shuffle(order: Ints | UInt32s, seed: np.uint64, epoch: Int) -> None:
    """Permute ``order`` in place for an epoch, by the shuffle of Fisher and Yates.

    It draws 64-bit words of stream ORDER.
    """
    for k in range(len(order) - 1, 0, -1):
        w0, w1, _w2, _w3 = block(seed, np.uint64(k), epoch, ORDER, 0)
        # j = (word * n) >> 64 for the 64-bit word with the upper half w0 and the lower half w1. It
        # is computed in two halves, because the product has more than 64 bits.
        n = np.uint64(k + 1)
        j = (w0 * n + ((w1 * n) >> np.uint64(32))) >> np.uint64(32)
        order[k], order[np.int64(j)] = order[np.int64(j)], order[k]
