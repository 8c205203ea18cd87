"""Algorithm 1: equal to the reference map by map, and draws that are what the paper says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
import numpy.typing as npt
import pytest
from helpers.examples import Some, examples, slow
from helpers.reference import block, reference_map
from helpers.specs import specs
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from mapdata import Maps, MapSpec, generate
from mapdata.generators import rooms as rooms_generator
from mapdata.movement import Movement

SETTINGS = examples(300)
PRESETS = sorted(rooms_generator.PRESETS)
UNCOUNTED = ("movement", "columns", "terrain")  # not arrays of N maps; rooms have no terrain
FIELDS = [field.name for field in fields(Maps) if field.name not in UNCOUNTED]
"""The arrays of a batch: all of them have an entry for each map."""


def padded(pairs: Sequence[tuple[int, int]], rows: int) -> npt.NDArray[np.int64]:
    """Pad pairs with -1 up to this many rows."""
    return np.array([*pairs, *[(-1, -1)] * (rows - len(pairs))], dtype=np.int64).reshape(rows, 2)


def assert_equals_reference(maps: Maps, place: int, generator: MapSpec, seed: int) -> None:
    """Compare every field of the batch's map at this place with the reference."""
    index = int(maps.index[place])
    expected = reference_map(generator, seed, index)
    most = generator.rooms[1]
    np.testing.assert_array_equal(maps.occupancy[place], expected.occupancy)
    assert maps.rooms[place] == len(expected.seed_points)
    assert maps.passage_width[place] == expected.passage_width
    np.testing.assert_array_equal(maps.seed_points[place], padded(expected.seed_points, most))
    np.testing.assert_array_equal(maps.sizes[place], padded(expected.sizes, most))
    np.testing.assert_array_equal(maps.directions[place], padded(expected.directions, most - 1))
    drawn = [direction != (-1, -1) for direction in expected.directions]
    np.testing.assert_array_equal(maps.connected[place], drawn + [False] * (most - 1 - len(drawn)))
    assert maps.split[place] == expected.split


# --- equal to the reference ---------------------------------------------------------------------


@SETTINGS
@given(
    specs(),
    st.integers(0, 2**64 - 1),
    st.lists(st.integers(0, 1000) | st.integers(0, 2**63 - 1), max_size=4),
)
def test_any_spec_equals_the_reference(generator: MapSpec, seed: int, indices: list[int]) -> None:
    """Every field of every map, for odd sizes, single rows, wide maps, rooms as large as the map,
    skip 0 and 1.
    """
    maps = generate(generator, seed, indices)
    assert maps.index.tolist() == indices
    assert maps.movement == generator.movement
    for place in range(len(indices)):
        assert_equals_reference(maps, place, generator, seed)


@pytest.mark.parametrize("name", [slow(name) if name == "dungeon128" else name for name in PRESETS])
def test_presets_equal_the_reference(name: str) -> None:
    """A hundred maps of each preset."""
    generator = MapSpec.preset(name)
    maps = generate(generator, 2**63 + 11, range(100))
    for place in range(100):
        assert_equals_reference(maps, place, generator, 2**63 + 11)


@pytest.mark.parametrize("count", [0, 3])
def test_shapes_and_types(count: int) -> None:
    """Arrays have the documented shapes and types, an empty batch included."""
    generator = MapSpec(map_size=(40, 70), movement=Movement(8))
    maps = generate(generator, 1, range(count))
    expected = {
        "index": ((count,), np.int64),
        "occupancy": ((count, 40, 70), np.uint8),
        "rooms": ((count,), np.int64),
        "passage_width": ((count,), np.int64),
        "seed_points": ((count, 9, 2), np.int64),
        "sizes": ((count, 9, 2), np.int64),
        "directions": ((count, 8, 2), np.int64),
        "split": ((count,), np.uint8),
        "connected": ((count, 8), np.bool_),
    }
    found = {name: (getattr(maps, name).shape, getattr(maps, name).dtype.type) for name in expected}
    assert found == expected
    assert maps.movement == Movement(8)


# --- a pure function of (spec, seed, index) -----------------------------------------------------


def test_a_map_does_not_depend_on_its_batch() -> None:
    """Whatever the batch, its order, repeats, and the form of the indices: map i is map i."""
    generator = MapSpec.preset("dungeon")
    indices = np.array([5, 0, 2**40 + 3, 5, 17, 1])
    together = generate(generator, 9, indices)
    for order in ([2, 1, 0, 5, 4, 3], [3, 3, 4], [1]):
        again = generate(generator, 9, indices[order].tolist())
        for name in FIELDS:
            np.testing.assert_array_equal(
                getattr(again, name), getattr(together, name)[order], err_msg=name
            )
    strided = generate(generator, 9, np.repeat(indices, 2)[::2])
    np.testing.assert_array_equal(strided.occupancy, together.occupancy)


def test_generating_again_leaves_the_first_maps_alone() -> None:
    """A batch owns its memory: nothing is shared between calls."""
    first = generate(MapSpec(), 1, range(8))
    kept = {name: getattr(first, name).copy() for name in FIELDS}
    generate(MapSpec(), 2, range(8))
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(first, name), kept[name], err_msg=name)


def test_maps_are_distinct() -> None:
    """A thousand maps asked are a thousand maps, and another seed (in either half) gives another
    thousand.
    """
    seeds = [0, 1, 2**32, 2**63]
    grids = np.concatenate([generate(MapSpec(), seed, range(1000)).occupancy for seed in seeds])
    assert len(grids) == 4000
    different = {grid.tobytes() for grid in grids}
    assert len(different) == 4000


@pytest.mark.parametrize(
    ("seed", "indices", "culprit"),
    [
        (-1, [0], "seed"),
        (2**64, [0], "seed"),
        (0, [3, -2], "ind.*-2"),
        (0, [2**63], "ind.*9223372036854775808"),
    ],
)
def test_numbers_beyond_the_generator_are_refused(
    seed: int, indices: list[int], culprit: str
) -> None:
    """A seed of more than 64 bits would share another's maps, and an index is 0 or a positive
    int64.
    """
    with pytest.raises(ValueError, match=culprit):
        generate(MapSpec(), seed, indices)


# --- the draws are what the paper says ----------------------------------------------------------

COUNT = 20_000


@pytest.fixture(scope="module")
def paper() -> Maps:
    """Return twenty thousand maps of Table 1."""
    return generate(MapSpec(), 2110, range(COUNT))


def counts(values: npt.NDArray[np.int64], low: int, high: int) -> npt.NDArray[np.int64]:
    """Count each value from low to high; another value fails here."""
    assert values.min() >= low
    assert values.max() <= high
    return np.bincount(values.ravel() - low, minlength=high - low + 1)


def assert_uniform(values: npt.NDArray[np.int64], low: int, high: int) -> None:
    """Chi-square against the uniform draw from low to high, both included."""
    assert stats.chisquare(counts(values, low, high)).pvalue > 1e-4


def test_numbers_of_rooms_and_widths_are_uniform(paper: Maps) -> None:
    """Rooms 2-9 and passages 7-15, both ends included, each independent of the other."""
    assert_uniform(paper.rooms, 2, 9)
    assert_uniform(paper.passage_width, 7, 15)
    table = np.zeros((8, 9), dtype=np.int64)
    np.add.at(table, (paper.rooms - 2, paper.passage_width - 7), 1)
    assert stats.chi2_contingency(table).pvalue > 1e-4


@pytest.mark.parametrize("room", range(9))
def test_seeds_and_sizes_are_uniform(paper: Maps, room: int) -> None:
    """Seed points over all rows and columns, sides over 14-33, for the first room and for the
    ninth.
    """
    drawn = paper.rooms > room
    for axis in range(2):
        assert_uniform(paper.seed_points[drawn, room, axis], 0, 63)
        assert_uniform(paper.sizes[drawn, room, axis], 14, 33)


def test_rows_and_columns_are_independent(paper: Maps) -> None:
    """Seed rows say nothing about seed columns, nor heights about widths, nor a map about the
    next.
    """
    seed_points, sizes = paper.seed_points[:, 0], paper.sizes[:, 0]
    pairs = [
        (seed_points[:, 0] // 8, seed_points[:, 1] // 8),
        (sizes[:, 0] - 14, sizes[:, 1] - 14),
        (seed_points[:, 0] // 8, paper.seed_points[:, 1, 0] // 8),
        (paper.rooms[:-1] - 2, paper.rooms[1:] - 2),
    ]
    for one, other in pairs:
        table = np.zeros((one.max() + 1, other.max() + 1), dtype=np.int64)
        np.add.at(table, (one, other), 1)
        assert stats.chi2_contingency(table).pvalue > 1e-4


@pytest.mark.parametrize("passage", range(8))
def test_ten_percent_and_a_fair_coin(paper: Maps, passage: int) -> None:
    """No passage in ten percent, else horizontal or vertical first with equal chance; nothing else
    occurs.
    """
    directions = paper.directions[paper.rooms > passage + 1, passage]
    kinds = [(-1, -1), (1, 0), (0, 1)]
    found = np.array([(directions == kind).all(axis=1).sum() for kind in kinds])
    assert found.sum() == len(directions)
    assert stats.chisquare(found, np.array([0.1, 0.45, 0.45]) * len(directions)).pvalue > 1e-4


@pytest.mark.parametrize("probability", [0.0, 0.3, 1.0])
def test_skip_probability_is_obeyed(probability: float) -> None:
    """Never at 0, always at 1, and in its share between."""
    maps = generate(MapSpec(skip_probability=probability), 4, range(5000))
    passages = int((maps.rooms - 1).sum())
    skipped = passages - int(maps.connected.sum())
    assert stats.binomtest(skipped, passages, probability).pvalue > 1e-4


def test_a_probability_is_a_sharp_integer_threshold() -> None:
    """A passage is skipped, and a map is for training, when the word is below p * 2**32, not when
    it equals it.
    """
    skip = block(5, 9, 0, 0, 2)[0]
    split = block(5, 9, 0, 2, 0)[0]
    for more, happens in ((0, False), (1, True)):
        train = (split + more) / 2**32
        generator = MapSpec(
            skip_probability=(skip + more) / 2**32, splits=(train, 0.0, 1.0 - train)
        )
        maps = generate(generator, 5, [9])
        assert maps.connected[0, 0] != happens
        assert maps.split[0] == (0 if happens else 2)


@pytest.mark.parametrize(
    "splits", [(0.8, 0.1, 0.1), (0.5, 0.0, 0.5), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
)
def test_splits_have_their_shares(splits: tuple[float, float, float]) -> None:
    """Each split has its fraction of the maps, and a fraction of 0 has none."""
    found = np.bincount(generate(MapSpec(splits=splits), 4, range(5000)).split, minlength=3)
    shares = np.array(splits)
    used = shares > 0
    assert len(found) == 3
    assert not found[~used].any()
    if used.sum() > 1:
        assert stats.chisquare(found[used], 5000 * shares[used]).pvalue > 1e-4


def test_a_split_belongs_to_the_index_alone() -> None:
    """Other rooms or sizes leave the splits as they are, and they say nothing about the rooms."""
    maps = generate(MapSpec(), 8, range(5000))
    np.testing.assert_array_equal(
        maps.split, generate(MapSpec.preset("dungeon"), 8, range(5000)).split
    )
    table = np.zeros((3, 8), dtype=np.int64)
    np.add.at(table, (maps.split, maps.rooms - 2), 1)
    assert stats.chi2_contingency(table).pvalue > 1e-4


# --- geometry -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PRESETS)
def test_every_seed_is_free(name: str) -> None:
    """All seeds lie on the map, on free cells."""
    maps = generate(MapSpec.preset(name), 3, range(1000))
    for occupancy, rooms, seed_points in zip(
        maps.occupancy, maps.rooms, maps.seed_points, strict=True
    ):
        rows, columns = seed_points[:rooms].T
        assert (seed_points[:rooms] >= 0).all()
        assert not occupancy[rows, columns].any()


def test_rooms_do_not_wrap_round_the_border() -> None:
    """Without passages a cell is free exactly when its coordinates lie in some room: no slice, no
    wrap.
    """
    generator = MapSpec(skip_probability=1.0, map_size=(33, 70))
    maps = generate(generator, 12, range(500))
    row, column = np.ogrid[:33, :70]
    clipped = 0
    for place in range(500):
        free = np.zeros((33, 70), dtype=np.bool_)
        for q in range(maps.rooms[place]):
            height, width = maps.sizes[place, q]
            top, left = maps.seed_points[place, q] - maps.sizes[place, q] // 2
            in_rows = (top <= row) & (row < top + height)
            in_columns = (left <= column) & (column < left + width)
            free |= in_rows & in_columns
            clipped += top < 0 or left < 0 or top + height > 33 or left + width > 70
        np.testing.assert_array_equal(maps.occupancy[place] == 0, free)
    assert clipped > 1000


def test_metadata_keep_the_drawn_sizes() -> None:
    """A room that the border clips keeps its drawn rows and columns."""
    generator = MapSpec(
        map_size=(20, 30), room_rows=(20, 20), room_columns=(30, 30), passage_width=(1, 1)
    )
    maps = generate(generator, 12, range(50))
    for rooms, sizes in zip(maps.rooms, maps.sizes, strict=True):
        assert (sizes[:rooms] == (20, 30)).all()
        assert (sizes[rooms:] == -1).all()


@pytest.mark.parametrize("name", PRESETS)
def test_passages_are_free_and_their_elbows_full(some: Some, name: str) -> None:
    """Both legs are free over their whole width, and so is the T x T square at the corner, as far
    as the map goes.
    """
    generator = MapSpec.preset(name)
    maps = generate(generator, 77, range(some(1000)))
    seen = 0
    for place in range(len(maps.rooms)):
        grid = maps.occupancy[place]
        wide = int(maps.passage_width[place])
        for q in range(maps.rooms[place] - 1):
            if not maps.connected[place, q]:
                continue
            (row, column), (end_row, end_column) = maps.seed_points[place, q : q + 2].tolist()
            horizontal_first = maps.directions[place, q, 0] == 1
            corner_row, corner_column = (row, end_column) if horizontal_first else (end_row, column)
            top = corner_row - wide // 2
            left = corner_column - wide // 2
            rows = slice(max(0, top), top + wide)
            columns = slice(max(0, left), left + wide)
            from_column_to_column = slice(min(column, end_column), max(column, end_column) + 1)
            from_row_to_row = slice(min(row, end_row), max(row, end_row) + 1)
            assert not grid[rows, columns].any()
            assert not grid[rows, from_column_to_column].any()
            assert not grid[from_row_to_row, columns].any()
            seen += 1
    assert seen > 3 * len(maps.rooms)


def test_rooms_as_small_as_they_get_still_hold_an_elbow() -> None:
    """With rooms of one cell only the corner's square frees its outer corner: it is there, and
    nothing beyond it.
    """
    generator = MapSpec(
        room_rows=(1, 1),
        room_columns=(1, 1),
        rooms=(2, 2),
        passage_width=(5, 5),
        skip_probability=0.0,
    )
    maps = generate(generator, 1, range(300))
    row, column = np.ogrid[:64, :64]
    for place in range(300):
        (a_row, a_column), (b_row, b_column) = maps.seed_points[place].tolist()
        horizontal_first = maps.directions[place, 0, 0] == 1
        corner_row, corner_column = (a_row, b_column) if horizontal_first else (b_row, a_column)
        in_row = abs(row - corner_row) <= 2
        in_column = abs(column - corner_column) <= 2
        along_row = (min(a_row, b_row) <= row) & (row <= max(a_row, b_row))
        along_column = (min(a_column, b_column) <= column) & (column <= max(a_column, b_column))
        free = (in_row & along_column) | (in_column & along_row) | (in_row & in_column)
        np.testing.assert_array_equal(maps.occupancy[place] == 0, free)
