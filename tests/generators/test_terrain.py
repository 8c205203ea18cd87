"""Terrain: equal to a slow reference, with exact shares, alone and over other families."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest
from helpers.examples import examples
from helpers.families import forget
from helpers.pages import DOCS
from helpers.reference_families import reference_terrain
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from mapdata import PRESETS, Cave, MapGenerator, MapSpec, Maze, Movement, Terrain, generate
from mapdata.generators import UnknownFamily, as_recipe, identity, register
from mapdata.generators.recipe import Recipe
from mapdata.generators.stored_families import stored_generator
from mapdata.hashing import sha256_hex

SIZES = st.tuples(st.integers(1, 20), st.integers(1, 20))
SEEDS = st.integers(0, 2**64 - 1)
INDICES = st.integers(0, 2**63 - 1)
WARCRAFT = (8, 12, 53, 77, 92)


@st.composite
def levels(draw: st.DrawFn) -> dict[str, Any]:
    """Draw costs and their shares, as parameters of `Terrain`."""
    costs = draw(st.lists(st.integers(1, 255), min_size=1, max_size=12))
    weights = draw(
        st.lists(st.integers(0, 9), min_size=len(costs), max_size=len(costs)).filter(any)
    )
    shares = draw(st.sampled_from([(), tuple(weight / sum(weights) for weight in weights)]))
    return {"costs": tuple(costs), "shares": shares}


@examples(100)
@given(
    SIZES,
    levels(),
    st.integers(1, 25) | st.sampled_from([1000, 4096]),
    st.sampled_from([0.0, 0.1, 0.5, 1.0]),
    st.booleans(),
    SEEDS,
    INDICES,
)
def test_any_terrain_equals_the_reference(
    size: tuple[int, int],
    parameters: dict[str, Any],
    scale: int,
    obstacles: float,
    corners: bool,
    seed: int,
    index: int,
) -> None:
    """The costs of all cells, for all sizes, scales, levels and shares of obstacles."""
    generator = Terrain(
        size, **parameters, scale=scale, obstacles=obstacles, corners=corners, seed_points=3
    )
    maps = generate(generator, seed, [index])
    assert maps.terrain is not None
    np.testing.assert_array_equal(maps.terrain[0], reference_terrain(generator, seed, index))
    if corners:
        last_cell = (size[0] - 1, size[1] - 1)
        corner_cells = sorted({(0, 0), last_cell})
        corner_points = maps.seed_points[0, : maps.rooms[0]].tolist()
        assert [tuple(point) for point in corner_points] == corner_cells
    else:
        components, _ = ndimage.label(maps.occupancy[0] == 0)
        largest = np.bincount(components[components > 0]).argmax()
        points = maps.seed_points[0, : maps.rooms[0]]
        assert (components[tuple(points.T)] == largest).all()
        assert len(points) == min(3, (components == largest).sum())


@examples(50)
@given(st.sampled_from([MapSpec(), Maze(), Cave()]), SIZES, levels(), SEEDS, INDICES)
def test_terrain_over_another_family_equals_the_reference(
    over: MapGenerator, size: tuple[int, int], parameters: dict[str, Any], seed: int, index: int
) -> None:
    """And grids, rooms, seed points and splits are those of the other family."""
    if isinstance(over, MapSpec):
        over = MapSpec(
            size, room_rows=(1, size[0]), room_columns=(1, size[1]), passage_width=(1, 1)
        )
    else:
        over = replace(over, map_size=(size[0] + 10, size[1] + 10))
    generator = Terrain(**parameters, over=over)
    maps = generate(generator, seed, [index])
    expected = generate(over, seed, [index])
    assert maps.terrain is not None
    occupancy = expected.occupancy[0].tolist()
    np.testing.assert_array_equal(
        maps.terrain[0], reference_terrain(generator, seed, index, occupancy)
    )
    for name in vars(expected):
        if name != "terrain":
            assert np.array_equal(getattr(maps, name), getattr(expected, name)), name


@examples(50)
@given(
    st.tuples(st.integers(2, 40), st.integers(2, 40)),
    st.lists(st.integers(1, 9), min_size=1, max_size=6),
    st.floats(0, 0.9),
    SEEDS,
)
def test_each_map_has_the_stated_shares(
    size: tuple[int, int], weights: list[int], obstacles: float, seed: int
) -> None:
    """Obstacles are rounded to whole cells; so is each border between two levels."""
    costs = tuple(range(1, len(weights) + 1))
    shares = tuple(weight / sum(weights) for weight in weights)
    generator = Terrain(size, costs, shares, obstacles=obstacles)
    terrain = generate(generator, seed, range(3)).terrain
    assert terrain is not None
    for grid in terrain:
        free_cells = int((grid > 0).sum())
        assert grid.size - free_cells == min(round(obstacles * grid.size), grid.size - 1)
        for level in range(len(costs)):
            cells_up_to_level = ((grid > 0) & (grid <= costs[level])).sum()
            assert abs(cells_up_to_level - free_cells * sum(shares[: level + 1])) <= 0.5 + 1e-3


@examples(20)
@given(st.lists(INDICES, min_size=1, max_size=5), SEEDS, st.booleans())
def test_a_map_depends_on_its_seed_and_number_alone(
    indices: list[int], seed: int, corners: bool
) -> None:
    """A batch holds the same maps in any order, and in batches of one."""
    generator = Terrain((9, 14), corners=corners)
    batch = generate(generator, seed, indices).terrain
    assert batch is not None
    for terrain, index in zip(batch, indices, strict=True):
        alone = generate(generator, seed, [index])
        assert alone.terrain is not None
        np.testing.assert_array_equal(terrain, alone.terrain[0])
    other = generate(generator, seed ^ 1, indices).terrain
    assert other is not None
    assert not np.array_equal(batch, other)


def test_the_draws_are_those_of_the_format() -> None:
    """The golden hashes: these maps must never change."""
    batches = {
        "terrain": generate("terrain", 7, range(30)).terrain,
        "tiles": generate("tiles", 7, range(30)).terrain,
        "over": generate(Terrain(costs=WARCRAFT, scale=5, over=MapSpec()), 7, range(30)).terrain,
    }
    hashes = {name: sha256_hex(np.ascontiguousarray(batch).data) for name, batch in batches.items()}
    assert hashes == {
        "terrain": "4c586b9ab029aaebe447e4e497205388458c6abaefbf4ded2f68930d04232391",
        "tiles": "ceda0d6f2931f9f1e32ca1dcf59b280bf781ea36d9dda72277ba072c72872584",
        "over": "e09bc81af15136d975ea402c80833002c1989ab98b64f805fabb699878d1e859",
    }
    page = (DOCS / "format.md").read_text(encoding="utf-8")
    assert hashes["terrain"] in page
    assert hashes["tiles"] in page


def test_presets_are_those_of_the_documentation() -> None:
    """64 x 64 with costs 1 to 10, and the shape of the Warcraft task."""
    terrain = PRESETS["terrain"]
    assert isinstance(terrain, Terrain)
    assert (terrain.map_size, terrain.costs) == ((64, 64), tuple(range(1, 11)))
    assert terrain.movement == Movement(8)
    maps = generate("tiles", 0, range(50))
    assert maps.terrain is not None
    assert maps.terrain.shape == (50, 12, 12)
    assert maps.movement == Movement(8, corner_cutting=True, diagonal_cost=1)
    assert (maps.seed_points == [[0, 0], [11, 11]]).all()
    for grid in maps.terrain:
        costs, counts = np.unique(grid, return_counts=True)
        assert tuple(costs) == WARCRAFT
        assert set(counts) <= {28, 29}  # a fifth of 144 cells


def test_terrain_is_smooth_and_its_scale_is_the_size_of_hills() -> None:
    """Neighbours are of nearly the same height; larger hills have fewer borders of levels."""
    changes = []
    for scale in (1, 2, 4, 8, 16, 32):
        terrain = generate(Terrain(scale=scale, obstacles=0), 3, range(20)).terrain
        assert terrain is not None
        steps = np.abs(np.diff(terrain.astype(int), axis=2))
        changes.append(float((steps > 0).mean()))
        if scale >= 8:
            assert (steps <= 2).mean() > 0.95
    assert changes == sorted(changes, reverse=True)
    assert changes[0] > 0.85
    assert changes[-1] < 0.2


def test_most_free_cells_are_connected() -> None:
    """Obstacles are blobs, which leave ways between them."""
    for obstacles, min_share in ((0.1, 0.97), (0.3, 0.9)):
        shares = []
        for grid in generate(Terrain(obstacles=obstacles), 0, range(50)).occupancy:
            components, _ = ndimage.label(grid == 0)
            shares.append(np.bincount(components[components > 0]).max() / (grid == 0).sum())
        assert np.mean(shares) > min_share


@pytest.mark.parametrize("size", [(1, 1), (1, 2), (2, 2), (4096, 3), (5, 4096)])
@pytest.mark.parametrize("corners", [False, True])
def test_extreme_sizes(size: tuple[int, int], corners: bool) -> None:
    """Every map has a free cell, and seed points on free cells."""
    generator = Terrain(size, obstacles=1.0, corners=corners, scale=4096)
    maps = generate(generator, 1, [0, 2**63 - 1])
    cell_count = size[0] * size[1]
    free_cells = min(2, cell_count) if corners else 1
    assert ((maps.occupancy == 0).sum(axis=(1, 2)) == free_cells).all()
    assert (maps.rooms == free_cells).all()


@pytest.mark.parametrize(
    "over", [MapSpec((40, 50), splits=(1, 0, 0)), Maze((9, 11), movement=Movement(8)), Cave()]
)
def test_terrain_over_a_generator_survives_json(over: MapGenerator) -> None:
    """Recipes, shards and manifests state it as a nested object."""
    generator = Terrain(costs=WARCRAFT, shares=(0.5, 0.125, 0.125, 0.125, 0.125), over=over)
    assert (generator.map_size, generator.movement) == (over.map_size, over.movement)
    values = json.loads(generator.to_json())
    assert values["over"] == json.loads(over.to_json())
    assert {"obstacles", "seed_points", "corners"}.isdisjoint(values)
    assert MapGenerator.from_json(generator.to_json()) == generator
    assert stored_generator(generator.to_json()) == generator
    recipe = Recipe(generator, seed=3, maps=7)
    assert as_recipe(json.dumps(recipe.to_dict())) == recipe
    assert hash(generator) == hash(MapGenerator.from_json(generator.to_json()))
    assert generator.format_version == 3


def test_over_may_be_the_name_of_a_preset_in_json() -> None:
    """As wherever JSON states a generator."""
    recipe = as_recipe({"spec": {"generator": "terrain", "over": "cave"}})
    assert recipe.generator == Terrain(over=PRESETS["cave"])
    assert (
        recipe.generator.description == "terrain with costs over caves made by a cellular automaton"
    )
    assert Terrain(over=MapSpec()).citation == MapSpec.citation


@dataclass(frozen=True)
class Shelves(Cave):
    """A family that only some processes know."""

    name: ClassVar[str] = "shelves"


def test_stored_terrain_over_an_unknown_family_can_be_read() -> None:
    """It keeps its identity, and refuses to draw maps."""
    register(Shelves)
    try:
        generator = Terrain(over=Shelves((8, 9)))
        text = generator.to_json()
    finally:
        forget("shelves")
    stored = stored_generator(text)
    assert isinstance(stored, Terrain)
    assert isinstance(stored.over, UnknownFamily)
    assert stored.to_json() == text
    assert identity(stored, 5) == identity(generator, 5)
    assert (stored.map_size, stored.has_terrain, stored.format_version) == ((8, 9), True, 3)
    why = "the family 'shelves' is not known here; import its module"
    with pytest.raises(ValueError, match=re.escape(why)):
        Recipe(stored)
    with pytest.raises(ValueError, match=re.escape(why)):
        stored.draw(0, np.arange(2))
    with pytest.raises(ValueError, match=re.escape(why)):
        MapGenerator.from_json(text)


def test_terrain_in_itself_is_refused_at_any_depth() -> None:
    """Even where it lies too deep for Python's recursion."""
    values: dict[str, Any] = {}
    for _ in range(5000):
        values = {"generator": "terrain", "over": values}
    with pytest.raises(ValueError, match="over: got the family 'terrain' in itself"):
        MapGenerator.from_dict(values)


class _Weighted(Cave):
    """Caves that claim to have terrain."""

    @property
    def has_terrain(self) -> bool:
        """Say that there is terrain."""
        return True


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ({"costs": ()}, "costs: got (), expected 1 to 255 costs, integers from 1 to 255"),
        ({"costs": (1, 256)}, "costs: got (1, 256), expected 1 to 255 costs"),
        ({"costs": (0, 1)}, "costs: got 0, expected an integer of at least 1"),
        ({"costs": 5}, "costs: got 5, expected 1 to 255 costs"),
        ({"costs": (1,) * 256}, "expected 1 to 255 costs"),
        ({"shares": (0.5, 0.5)}, "shares: got (0.5, 0.5), expected 10 fractions in [0, 1]"),
        ({"costs": (1, 2), "shares": (0.5, 0.6)}, "shares: got (0.5, 0.6), expected 2 fractions"),
        ({"costs": (1, 2), "shares": (-0.5, 1.5)}, "shares: got (-0.5, 1.5), expected 2 fractions"),
        ({"shares": 1}, "shares: got 1, expected 10 fractions"),
        ({"scale": 0}, "scale: got 0, expected an integer of at least 1"),
        ({"scale": 4097}, "scale: got 4097, expected at most 4096 cells"),
        ({"obstacles": 1.5}, "obstacles: got 1.5, expected a probability"),
        ({"seed_points": 1}, "seed_points: got 1"),
        ({"corners": 1}, "corners: got 1, expected True or False"),
        ({"over": "cave"}, "over: got 'cave', expected a MapGenerator, such as Cave()"),
        ({"over": Terrain()}, "expected a generator without terrain of its own"),
        ({"over": _Weighted()}, "expected a generator without terrain of its own"),
        (
            {"over": Cave(), "map_size": (9, 9)},
            "map_size: got (9, 9), but `over` decides on it and has (64, 64); leave it out",
        ),
        ({"over": Cave(), "movement": Movement(8)}, "movement: got Movement"),
        ({"over": Cave(), "resolution": 0.5}, "resolution: got 0.5, but `over` decides on it"),
        ({"over": Cave(), "splits": (1, 0, 0)}, "splits: got (1.0, 0.0, 0.0), but `over`"),
        ({"over": Cave(), "obstacles": 0.2}, "obstacles: got 0.2, but the maps of `over` keep"),
        ({"over": Cave(), "seed_points": 3}, "seed_points: got 3, but the maps of `over` keep"),
        ({"over": Cave(), "corners": True}, "corners: got True, but the maps of `over` keep"),
    ],
)
def test_bad_values_are_refused(values: dict[str, Any], why: str) -> None:
    """The message names the parameter, and what was expected."""
    with pytest.raises(ValueError, match=re.escape(why)):
        Terrain(**values)


def test_values_of_over_may_be_repeated() -> None:
    """A generator with some parameter replaced states all of them."""
    generator = Terrain(over=Maze((20, 31), movement=Movement(8)))
    changed = replace(generator, scale=3)
    assert (changed.map_size, changed.movement) == ((20, 31), Movement(8))
