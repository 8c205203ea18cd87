"""`EpochSampler`: the order of a data loader, which a resumed training continues."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset
from torch.utils.data.distributed import DistributedSampler

from mapdata.arrays import Ints, UInt32s
from mapdata.datasets.sample import Sample
from mapdata.jit import Int, kernel
from mapdata.rng import ORDER, block

if TYPE_CHECKING:
    import pytorch_lightning as pl


class LateLoader(DataLoader[Sample]):
    """A DataLoader that starts when its first batch is requested, not when it is iterated over.

    Lightning creates the iterator before it has restored the position of a checkpoint, and workers
    prefetch batches at once.
    """

    def __iter__(self) -> Iterator[Any]:  # type: ignore[override]
        yield from super().__iter__()


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
        """
        super().__init__(
            dataset,
            num_replicas=1,
            rank=0,
            shuffle=sampling_seed is not None,
            drop_last=drop_last,
        )
        self.batch_size = batch_size
        self.sampling_seed = sampling_seed
        self.module = module

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
        if self.sampling_seed is None:
            yield from range(rank, sample_count, rank_count)
            return
        epoch, batches_done = self._position()
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

    def _position(self) -> tuple[int, int]:
        """Return the epoch and the number of its batches that are done."""
        trainer = getattr(self.module, "trainer", None)
        if trainer is not None and trainer.training:
            # This attribute of Lightning is not public, but no public one holds the number.
            # tests/datasets/test_datamodule.py would notice a change.
            batches_done = int(trainer.fit_loop.epoch_loop.batch_progress.current.ready)
            is_within_epoch = batches_done < self._batch_count()
            return trainer.current_epoch, batches_done if is_within_epoch else 0
        epoch = self.epoch
        self.epoch += 1
        return epoch, 0

    def _batch_count(self) -> int:
        """Return the number of batches of an epoch on this rank."""
        full_batches, remainder = divmod(len(self), self.batch_size)
        has_partial_batch = remainder > 0 and not self.drop_last
        return full_batches + has_partial_batch


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
