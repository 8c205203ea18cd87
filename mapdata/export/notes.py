"""What an export tells its user: how many problems it has, on which maps, and what may be wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mapdata.arrays import Array, Ints
from mapdata.describe.dataset_card import counted
from mapdata.describe.problem_statistics import ProblemStatistics
from mapdata.describe.statistics import count_repeats
from mapdata.export.sources import Part
from mapdata.generators.generator import PRESETS
from mapdata.limits import SPLITS
from mapdata.problems.sources import Random
from mapdata.shards.manifest import MANIFEST

_FEW_MAPS = 0.9
"""There is a note if random problems are on less than this share of the maps that they could use.
"""

_FEW_SINGLE_PATHS = 0.9
"""There is a note if less than this share of problems has one shortest path."""


def source_notes(source: Any) -> list[str]:
    """Return a note on a source that names both a preset and a dataset in the working folder."""
    if not isinstance(source, str) or source not in PRESETS:
        return []
    if not (Path(source) / MANIFEST).exists():
        return []
    return [
        f"source: {source} is the preset; ./{source} is the dataset in the folder of this name, "
        "which was not read"
    ]


def count_notes(parts: Sequence[Part]) -> list[str]:
    """Return notes on the number of problems of each split."""
    notes = [f"{part.split}: {part.count:,} problems" for part in parts]
    for part in parts:
        if part.count > len(part.dataset):
            notes.append(
                f"{part.split}: maps are used again, with other starts and goals, since an epoch "
                f"has {counted(len(part.dataset), 'problem')}"
            )
    return notes


def map_notes(parts: Sequence[Part], map_indices: Mapping[str, Ints]) -> list[str]:
    """Return notes on random problems that are on fewer maps than they could be.

    Args:
        parts: the splits.
        map_indices: numbers of the maps, one for each problem, by split.
    """
    notes = []
    for part in parts:
        _, problems_on_map = np.unique(map_indices[part.split], return_counts=True)
        map_count = len(problems_on_map)
        # Random problems of an epoch are evenly on all maps, as long as each map has some.
        source = part.dataset.serving.problems
        possible_maps = -(-min(part.count, len(part.dataset)) // source.per_map)  # rounded up
        is_random = isinstance(source, Random)
        if is_random and map_count < _FEW_MAPS * possible_maps:
            notes.append(
                f"{part.split}: these {part.count:,} problems are on {map_count:,} different maps "
                f"of {possible_maps:,}, up to {problems_on_map.max():,} on one map, because few "
                "maps have such a problem; wider conditions or more maps give more"
            )
    return notes


def target_notes(fields: tuple[str, ...], statistics: Mapping[str, ProblemStatistics]) -> list[str]:
    """Return a note if paths are written that are often one of several shortest paths.

    It is of the first split; the splits hardly differ.
    """
    split, first = next(iter(statistics.items()))
    has_path = not {"path", "path_mask"}.isdisjoint(fields)
    if has_path and first.single_path.value < _FEW_SINGLE_PATHS:
        return [f"{split}: {first.target_text()}"]
    return []


def neighbour_notes(
    parts: Sequence[Part], neighbours: Mapping[str, int], *, is_drawn: bool
) -> list[str]:
    """Return notes on mazes whose solution equals the question: no cell is between S and G.

    Args:
        parts: the splits.
        neighbours: number of such problems, by split.
        is_drawn: whether the problems are drawn, so that conditions may leave some out.
    """
    remedy = "; --length 3: leaves them out" if is_drawn else ""
    return [
        f"{part.split}: in {neighbours[part.split]:,} of {part.count:,} problems S and G are "
        f"neighbours, so the solved maze equals the question{remedy}"
        for part in parts
        if neighbours[part.split]
    ]


def copy_notes(map_hashes: Mapping[str, Array], map_indices: Mapping[str, Ints]) -> list[str]:
    """Return notes on problems whose maps are copies: in a split, and of maps in train.

    Args:
        map_hashes: hashes of the maps, one for each problem, by split; or empty.
        map_indices: numbers of the maps, one for each problem, by split.
    """
    notes = []
    for split, hashes in map_hashes.items():
        numbers, first_problems = np.unique(map_indices[split], return_index=True)
        different = len(np.unique(hashes[first_problems]))
        if different < len(numbers):
            notes.append(
                f"{split}: of its {len(numbers):,} maps {different:,} differ, and the others are "
                "copies of them; --distinct leaves out the problems on copies"
            )
    if "train" not in map_hashes or len(map_hashes) == 1:
        return notes
    split_codes = [
        np.full(len(hashes), SPLITS.index(split), np.uint8) for split, hashes in map_hashes.items()
    ]
    repeats = count_repeats(np.concatenate(list(map_hashes.values())), np.concatenate(split_codes))
    notes += [
        f"{later}: {count:,} of {len(map_hashes[later]):,} problems are on maps that are also in "
        "train, so a model saw these maps in training; --distinct leaves them out"
        for (earlier, later), count in repeats.across.items()
        if earlier == "train" and count > 0
    ]
    return notes
