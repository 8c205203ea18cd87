"""The content hash: equal to plain Python's, the same for all batches, another for any value."""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from helpers.examples import examples
from helpers.specs import MOVEMENTS, SIDES, specs
from helpers.terrain_maps import labelled_terrain
from hypothesis import given
from hypothesis import strategies as st

from mapdata import Labels, MapSpec, generate, label
from mapdata.movement import Movement
from mapdata.shards import content_hash
from mapdata.shards.content import combine

SETTINGS = examples(40)
NUMBERS = st.integers(0, 1000) | st.integers(0, 2**63 - 1)
SPECS = {
    "4": MapSpec((20, 70), (2, 5), (2, 8), (3, 12), passage_width=(1, 2), skip_probability=0.5),
    "8": MapSpec(
        (20, 24),
        (2, 5),
        (2, 6),
        (2, 6),
        passage_width=(1, 2),
        skip_probability=0.5,
        movement=Movement(8),
    ),
}


def reference_record(labels: Labels, place: int) -> bytes:
    """Return the record of docs/format.md for one map of a batch, value by value."""
    maps = labels.maps
    n = int(maps.rooms[place])
    index = int(maps.index[place])
    height, width = maps.occupancy.shape[1:]
    words = [height, width, index % 2**32, index // 2**32]
    words += [maps.split[place], maps.passage_width[place], n]
    words += maps.seed_points[place, :n].ravel().tolist()
    words += maps.sizes[place, :n].ravel().tolist()
    words += maps.directions[place, : n - 1].ravel().tolist()
    moves = b""
    for search in (labels.bfs, labels.astar):
        for segment in range(*maps.segment_offsets[place : place + 2]):
            first, last = search.offsets[segment : segment + 2]
            words += [last - first, search.iterations[segment]]
            moves += search.moves[first:last].tobytes()
        for pair in range(*maps.pair_offsets[place : place + 2]):
            words += search.costs[pair].tolist()
    words_a_row = math.ceil(width / 64)
    bits = np.zeros((height, words_a_row * 64), np.uint8)
    bits[:, :width] = maps.occupancy[place]
    record = b"".join(struct.pack("<I", int(word) % 2**32) for word in words)
    record += np.packbits(bits, axis=1, bitorder="little").tobytes()
    if maps.terrain is not None:
        record += maps.terrain[place].tobytes()
    record += moves
    return record + bytes(-len(record) % 4)  # zeros up to a whole number of words


def reference_hash(labels: Labels) -> str:
    """Return the sum of the hashes of all records."""
    total = 0
    for place in range(len(labels.maps)):
        digest = hashlib.sha256(reference_record(labels, place)).digest()
        total += int.from_bytes(digest, "big")
    return f"{total % 2**256:064x}"


def labelled(generator: MapSpec, seed: int, *indices: int) -> Labels:
    """Return labelled maps."""
    return label(generate(generator, seed, indices))


# --- equal to the reference ---------------------------------------------------------------------


@SETTINGS
@given(specs(), st.integers(0, 2**64 - 1), st.lists(NUMBERS, min_size=1, max_size=4))
def test_any_maps_equal_the_reference(generator: MapSpec, seed: int, indices: list[int]) -> None:
    """The hash is that of the records of docs/format.md, also for indices beyond 32 bits."""
    labels = labelled(generator, seed, *indices)
    assert content_hash(labels) == reference_hash(labels)


@SETTINGS
@given(st.integers(0, 2**32), SIDES, SIDES, st.integers(1, 4), st.sampled_from(MOVEMENTS))
def test_any_terrain_equals_the_reference(
    seed: int, rows: int, columns: int, count: int, movement: Movement
) -> None:
    """With the terrain of a map behind its cells, and half units as costs."""
    labels = labelled_terrain(seed, (rows, columns), count, movement)
    assert content_hash(labels) == reference_hash(labels)


# --- what it does not depend on -----------------------------------------------------------------


@SETTINGS
@given(
    st.permutations(range(9)),
    st.sets(st.integers(1, 8), max_size=4),
    st.sampled_from(sorted(SPECS)),
)
def test_batches_combine_in_any_order(order: list[int], cuts: set[int], name: str) -> None:
    """Any partition of the maps, in any order, combines to the hash of all."""
    whole = content_hash(labelled(SPECS[name], 6, *range(9)))
    bounds = [0, *sorted(cuts), 9]
    parts = [order[first:last] for first, last in pairwise(bounds)]
    assert combine([content_hash(labelled(SPECS[name], 6, *part)) for part in parts]) == whole


def test_padding_does_not_count() -> None:
    """Rows beyond a map's own rooms are not part of what it says."""
    labels = labelled(SPECS["4"], 0, *range(5))
    maps = labels.maps
    more = np.full((5, 3, 2), 77)
    wider = replace(
        maps,
        seed_points=np.concatenate((maps.seed_points, more), axis=1),
        sizes=np.concatenate((maps.sizes, more), axis=1),
        directions=np.concatenate((maps.directions, more), axis=1),
    )
    assert content_hash(Labels(wider, labels.bfs, labels.astar)) == content_hash(labels)


def test_no_hashes_add_up_to_nothing() -> None:
    """The sum of no hashes is 0, which adds nothing to others."""
    some = content_hash(labelled(SPECS["4"], 0, 1))
    assert combine([]) == "0" * 64
    assert combine(["0" * 64, some]) == combine([some]) == some


def test_no_maps_hash_to_zero() -> None:
    """No maps hash to 0."""
    assert content_hash(labelled(SPECS["4"], 0)) == "0" * 64


def test_sums_wrap_and_keep_their_zeros() -> None:
    """The sum is modulo 2**256 and always has 64 digits."""
    assert combine(["f" * 64, f"{1:064x}"]) == "0" * 64
    assert combine(["f" * 64, f"{16:064x}"]) == f"{15:064x}"


# --- what it depends on -------------------------------------------------------------------------


Change = Callable[[Labels], Labels]


def _first(table: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a copy whose first value has its lowest bit flipped."""
    changed = table.copy()
    changed.flat[0] ^= 1
    return changed


def _in_maps(name: str) -> Change:
    """Return a change of one array of the maps."""

    def change(labels: Labels) -> Labels:
        values: dict[str, Any] = {name: _first(getattr(labels.maps, name))}
        return replace(labels, maps=replace(labels.maps, **values))

    return change


def _in_search(search: str, name: str) -> Change:
    """Return a change of one array of what a search found."""

    def change(labels: Labels) -> Labels:
        found = getattr(labels, search)
        changed = replace(found, **{name: _first(getattr(found, name))})
        return replace(labels, **{search: changed})

    return change


def _offset(place: int, by: int) -> Change:
    """Return a change of one offset of the moves of BFS."""

    def change(labels: Labels) -> Labels:
        offsets = labels.bfs.offsets.copy()
        offsets[place] += by
        return replace(labels, bfs=replace(labels.bfs, offsets=offsets))

    return change


def _more_columns(labels: Labels) -> Labels:
    return replace(labels, maps=replace(labels.maps, columns=labels.maps.columns + 1))


def _swapped(labels: Labels) -> Labels:
    return Labels(labels.maps, labels.astar, labels.bfs)


CHANGES: dict[str, Change] = {
    "columns": _more_columns,
    "planners swapped": _swapped,
    "a move to the next segment": _offset(1, 1),
}
for array in ("index", "packed", "passage_width", "seed_points", "sizes", "directions", "split"):
    CHANGES[array] = _in_maps(array)
for search in ("bfs", "astar"):
    for array in ("moves", "iterations", "costs"):
        CHANGES[f"{search} {array}"] = _in_search(search, array)
for count in (1, 2, 3):  # every length of the zeros at the end of a record
    CHANGES[f"{count} moves less"] = _offset(-1, -count)


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_every_value_counts(change: Change) -> None:
    """One bit of any table changes the hash, to that of the changed records."""
    labels = labelled(SPECS["4"], 3, 3, 4)
    changed = change(labels)
    assert content_hash(changed) == reference_hash(changed) != content_hash(labels)


def test_every_cost_of_terrain_counts() -> None:
    """Another cost of a cell changes the hash, and so does leaving out the terrain."""
    labels = labelled_terrain(3, (5, 7), 2, Movement(8))
    assert labels.maps.terrain is not None
    hashes = {content_hash(labels)}
    for k in range(labels.maps.terrain.size):
        terrain = labels.maps.terrain.copy()
        terrain.flat[k] ^= 1
        changed = replace(labels, maps=replace(labels.maps, terrain=terrain))
        assert content_hash(changed) == reference_hash(changed)
        hashes.add(content_hash(changed))
    hashes.add(content_hash(replace(labels, maps=replace(labels.maps, terrain=None))))
    assert len(hashes) == labels.maps.terrain.size + 2


def test_maps_with_swapped_numbers_are_other_maps() -> None:
    """The number of a map is part of its record: the same grids in another order hash otherwise."""
    labels = labelled(SPECS["4"], 3, 3, 4)
    swapped = replace(labels, maps=replace(labels.maps, index=labels.maps.index[::-1].copy()))
    assert content_hash(swapped) != content_hash(labels)


def test_equal_values_in_other_arrays_hash_equal() -> None:
    """The hash is of values, and hashing changes none of them: labelled anew they hash the same."""
    labels = labelled(SPECS["8"], 3, *range(4))
    before = content_hash(labels)
    assert content_hash(labels) == content_hash(labelled(SPECS["8"], 3, *range(4))) == before
