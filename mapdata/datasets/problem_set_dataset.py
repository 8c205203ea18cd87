"""`ProblemSetDataset`: the problems of a `ProblemSet` as torch samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from mapdata.datasets.arguments import DEFAULT_FIELDS, FieldFunction, Serving, Transform
from mapdata.datasets.batch_sources import SetSource
from mapdata.datasets.info import DatasetInfo, field_infos
from mapdata.datasets.problem_dataset import ProblemDataset
from mapdata.describe.dataset_card import movement_text
from mapdata.problems.problem_set import ProblemSet


class ProblemSetDataset(ProblemDataset):
    """The problems of a `ProblemSet`, as torch samples: sample i is problem i.

    It trains and validates on problems that come with their own starts and goals: those of a
    MovingAI .scen, of planning-datasets or TransPath, which `mapdata.formats.read_problems` reads,
    or those of a saved set.

    The fields are those of `MapDataset`. Its rooms are the start and the goal alone:
    ``seed_points`` has these two cells, in this order, and ``connection_matrix`` the costs between
    them. The movement is that of the set. All epochs serve the same problems; ``augment`` draws
    their symmetries anew in each. A subset of the set serves its problems unchanged: with the same
    ``problem`` and ``map_index``, image and symmetries.

    A map that problems of the set share is in memory once, in each loader worker, too.

    Args:
        problem_set: the problems.
        fields: as in `MapDataset`, like all further arguments. With ``search="astar"`` the paths
            are those that the set has found already; with "bfs" they are searched on the fly.

    Raises:
        ValueError: arguments that do not fit, or that would do nothing.

    >>> from mapdata import Movement
    >>> problem_set = ProblemSet.sample("dungeon", seed=77, maps=20, movement=Movement(8))
    >>> dataset = ProblemSetDataset(problem_set, fields=("map", "goal", "cost"))
    >>> len(dataset), tuple(dataset[:8].map.shape)
    (20, (8, 1, 64, 64))
    """

    def __init__(
        self,
        problem_set: ProblemSet,
        fields: Sequence[str | FieldFunction] = DEFAULT_FIELDS,
        *,
        search: str = "astar",
        augment: bool = False,
        sampling_seed: int = 0,
        max_length: int | None = None,
        dtype: torch.dtype | str | None = None,
        transform: Transform | None = None,
    ) -> None:
        """Check and keep the arguments; the problems are not copied."""
        if not isinstance(problem_set, ProblemSet):
            raise ValueError(
                f"problem_set: got {problem_set!r}, expected a ProblemSet; "
                "mapdata.formats.read_problems(path) reads one from a file"
            )
        serving = Serving(
            fields=fields,
            search=search,
            augment=augment,
            sampling_seed=sampling_seed,
            max_length=max_length,
            dtype=dtype,
            transform=transform,
        )
        super().__init__(None, serving)
        self.problem_set = problem_set
        self._open()
        self._check_on_maps()

    def _open(self) -> None:
        self.source = SetSource(self.problem_set, self.serving)

    def __repr__(self) -> str:
        return (
            f"ProblemSetDataset({self.problem_set.description!r}): {len(self)} problems, "
            f"map_size={self.map_size}, movement={self.movement}{self._epoch_note()}"
        )

    @property
    def info(self) -> DatasetInfo:
        """The number of maps and problems, and what a sample holds.

        The shapes of the fields are those of the first sample, which is loaded for it.
        """
        return DatasetInfo(
            roots=(),
            recipes=(None,),
            identities=(None,),
            content_hashes=(self.problem_set.content_hash,),
            map_counts={"all": self.problem_set.map_count},
            problem_counts={"all": len(self)},
            map_size=self.map_size,
            resolution=None,
            movement=self.movement,
            has_terrain=self.has_terrain,
            fields=field_infos(self._load(np.array([0]), 0)) if len(self) else None,
        )

    def served_text(self) -> str:
        """Return which problems are served, in words."""
        rule = movement_text(self.movement, self.has_terrain)
        return f"{self.problem_set.description}; {rule}"

    def problems_text(self) -> str:
        """Return the hash of the problems; sets that differ in their description alone are one."""
        return f"problem set {self.problem_set.content_hash[:12]}"
