"""The order of a data loader, which a resumed training takes up again."""

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
    """A DataLoader that starts when its first batch is asked for, not when it is iterated over.

    Lightning makes the iterator before it has restored where a checkpoint stopped, and workers
    fetch ahead at once.
    """

    def __iter__(self) -> Iterator[Any]:  # type: ignore[override]
        yield from super().__iter__()


class EpochSampler(DistributedSampler[Any]):
    """Yields ``index + epoch * len(dataset)``, each rank its share, from where the Trainer is.

    Training: a permutation that is a function of (sampling seed, epoch); all ranks get equally
    many, at most ranks - 1 samples are left out. Else: the order of the dataset, epoch 0, every
    sample on exactly one rank.
    It asks for epoch, rank and position when it is first iterated over, so that a resumed epoch
    goes on where it stopped. Without a Trainer the first pass is epoch 0, or the one that
    `set_epoch` says, and each further pass the next one.
    """

    def __init__(
        self,
        dataset: Dataset[Sample],
        batch_size: int,
        sampling_seed: int | None,
        module: pl.LightningDataModule | None = None,
    ) -> None:
        """Sample ``dataset``; ``sampling_seed`` None keeps its order."""
        super().__init__(dataset, num_replicas=1, rank=0, shuffle=sampling_seed is not None)
        self.batch_size = batch_size
        self.sampling_seed = sampling_seed
        self.module = module

    def __repr__(self) -> str:
        arguments = f"batch_size={self.batch_size}, sampling_seed={self.sampling_seed}"
        return f"EpochSampler({self.dataset}, {arguments})"

    def __len__(self) -> int:
        """Return how many samples this rank gets."""
        rank, world = self._share()
        total = len(self.dataset)  # type: ignore[arg-type]
        if self.sampling_seed is None:
            return len(range(rank, total, world))
        return total // world

    def __iter__(self) -> Iterator[int]:
        rank, world = self._share()
        total = len(self.dataset)  # type: ignore[arg-type]
        if self.sampling_seed is None:
            yield from range(rank, total, world)
            return
        epoch, done = self._position()
        # Four bytes a sample: Python's integers take nine times as much, so each batch has its own.
        order = np.arange(total, dtype=np.uint32)
        shuffle(order, np.uint64(self.sampling_seed), epoch)
        mine = order[rank::world][: len(self)]  # all ranks get equally many
        for first in range(done * self.batch_size, len(mine), self.batch_size):
            batch = mine[first : first + self.batch_size].astype(np.int64)
            yield from (batch + epoch * total).tolist()

    def _share(self) -> tuple[int, int]:
        """Return (rank, number of ranks)."""
        trainer = getattr(self.module, "trainer", None)
        if trainer is not None:
            return trainer.global_rank, trainer.world_size
        if torch.distributed.is_available() and torch.distributed.is_initialized():
            return torch.distributed.get_rank(), torch.distributed.get_world_size()
        return 0, 1

    def _position(self) -> tuple[int, int]:
        """Return the epoch and how many of its batches are done."""
        trainer = getattr(self.module, "trainer", None)
        if trainer is not None and trainer.training:
            # Not a public attribute, but the only place that knows:
            # tests/datasets/test_datamodule.py watches it.
            done = int(trainer.fit_loop.epoch_loop.batch_progress.current.ready)
            batches = -(-len(self) // self.batch_size)
            return trainer.current_epoch, done if done < batches else 0
        epoch = self.epoch  # 0 at first, or what `set_epoch` says
        self.epoch += 1
        return epoch, 0


@kernel
def shuffle(order: Ints | UInt32s, seed: np.uint64, epoch: Int) -> None:
    """Bring ``order`` into that of an epoch, by the shuffle of Fisher and Yates.

    Its draws are 64-bit words of stream ORDER.
    """
    for k in range(len(order) - 1, 0, -1):
        w0, w1, _w2, _w3 = block(seed, np.uint64(k), epoch, ORDER, 0)
        # multiply-high of a 64-bit word, in two halves
        n = np.uint64(k + 1)
        j = (w0 * n + ((w1 * n) >> np.uint64(32))) >> np.uint64(32)
        order[k], order[np.int64(j)] = order[np.int64(j)], order[k]
