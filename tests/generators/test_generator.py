"""The registry of generators: names in JSON, presets, versions of the format, and a family of one's
own.
"""

from __future__ import annotations

import json
import pickle
import sys
from collections import UserList
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
import pytest
from helpers.builds import Built
from helpers.examples import slow
from helpers.families import KNOWN, SMALL, UNIFORM, forget, write_module
from helpers.samples import ALL_FIELDS, assert_same

from mapdata import (
    Cave,
    Forest,
    MapDataModule,
    MapDataset,
    MapGenerator,
    Maps,
    MapSpec,
    Maze,
    Movement,
    OnlineMapDataset,
    ProblemSet,
    build,
    generate,
    identity,
    label,
    read_shard,
    verify,
)
from mapdata.arrays import Ints
from mapdata.cli import main
from mapdata.generators import Terrain, UnknownFamily, as_recipe, register, with_seed_points
from mapdata.generators.generator import GENERATORS
from mapdata.generators.stored_families import _cached_generator, stored_generator
from mapdata.shards import read_manifest


@dataclass(frozen=True)
class Stripes(MapGenerator):
    """Horizontal stripes, open at one end: a family that somebody else writes."""

    name: ClassVar[str] = "stripes"
    description: ClassVar[str] = "stripes"

    map_size: tuple[int, int] = (9, 8)
    every: int = 2
    resolution: float = 0.1
    movement: Movement = field(default_factory=Movement)
    splits: tuple[float, float, float] = (0.8, 0.1, 0.1)

    @property
    def max_seed_points(self) -> int:
        """Three."""
        return 3

    def draw(self, seed: int, indices: Ints) -> Maps:
        """Return the maps ``indices``."""
        grids = np.zeros((len(indices), *self.map_size), np.uint8)
        grids[:, 1 :: self.every, 1:] = 1
        return with_seed_points(self, seed, indices, grids)


@pytest.fixture
def stripes() -> Iterator[type[Stripes]]:
    """The family, registered for one test."""
    register(Stripes, {"striped": Stripes()})
    yield Stripes
    forget("stripes", "striped")


def test_a_family_of_ones_own_is_built_and_verified(stripes: type[Stripes], tmp_path: Path) -> None:
    """Registered, it is known to recipes, manifests and shards."""
    generator = MapGenerator.preset("striped")
    manifest = build(tmp_path / "maps", generator, maps=5, seed=2, shard_size=3)
    assert verify(tmp_path / "maps") == []
    assert json.loads(manifest.recipe())["spec"]["generator"] == "stripes"
    assert MapGenerator.from_dict({"generator": "stripes", "every": 3}) == stripes(every=3)
    maps = read_shard(tmp_path / "maps" / manifest.shards[0].name).maps
    np.testing.assert_array_equal(maps.occupancy, generate(generator, 2, range(3)).occupancy)


@pytest.mark.parametrize(
    ("cell", "rooms", "fault"),
    [
        ((9, 3), 3, r"the seed point \(9, 3\), expected cells of a map of 9 x 8"),
        ((3, 8), 3, r"the seed point \(3, 8\), expected"),
        ((10**9, 3), 3, r"the seed point \(1000000000, 3\), expected"),
        ((3, -5), 3, r"the seed point \(3, -5\), expected"),
        ((-1, -1), 3, "2 seed points, but Maps.rooms says 3"),
        ((3, 0), 0, "3 seed points, but Maps.rooms says 0"),
        ((3, 0), 2, "3 seed points, but Maps.rooms says 2"),
        ((3, 0), 4, "3 seed points, but Maps.rooms says 4"),
    ],
)
def test_a_family_that_draws_unsound_seed_points_is_refused(
    cell: tuple[int, int], rooms: int, fault: str
) -> None:
    """Cells outside of the map, a count that is not theirs: compiled code would go astray."""

    @dataclass(frozen=True)
    class Unsound(Stripes):
        def draw(self, seed: int, indices: Ints) -> Maps:
            """Return the maps of `Stripes`, whose first seed point is another cell."""
            maps = super().draw(seed, indices)
            maps.seed_points[-1, 0] = cell
            maps.rooms[-1] = rooms
            return maps

    with pytest.raises(ValueError, match=f"^stripes: drew map 3 with {fault}"):
        generate(Unsound(), 0, range(4))


def test_a_family_that_returns_no_usable_maps_is_refused() -> None:
    """The message says what ``draw`` returned and what to return."""

    @dataclass(frozen=True)
    class Grids(Stripes):
        def draw(self, seed: int, indices: Ints) -> Maps:
            """Return an array instead of maps."""
            return np.zeros((len(indices), *self.map_size), np.uint8)  # type: ignore[return-value]

    @dataclass(frozen=True)
    class First(Stripes):
        def draw(self, seed: int, indices: Ints) -> Maps:
            """Return the first map alone."""
            return super().draw(seed, indices[:1])

    @dataclass(frozen=True)
    class Full(Stripes):
        def draw(self, seed: int, indices: Ints) -> Maps:
            """Return maps without a free cell."""
            grids = np.ones((len(indices), *self.map_size), np.uint8)
            return with_seed_points(self, seed, indices, grids)

    advice = r"expected Maps of 2 maps; with_seed_points\(self, seed, indices, grids\)"
    with pytest.raises(ValueError, match=f"^stripes: draw returned a ndarray, {advice}"):
        generate(Grids(), 0, [4, 5])
    with pytest.raises(ValueError, match=f"^stripes: draw returned 1 maps, {advice}"):
        generate(First(), 0, [4, 5])
    with pytest.raises(ValueError, match=r"^stripes: drew map 4 with all cells occupied, expected"):
        generate(Full(), 0, [4, 5])


def test_a_parameter_that_json_cannot_hold_is_named(tmp_path: Path) -> None:
    """By a build, which creates no folder, and by a data module."""

    @dataclass(frozen=True)
    class Random(Stripes):
        rng: Any = None

    root = tmp_path / "maps"
    message = r"^rng: got Generator\(PCG64\) at .*, expected a value that JSON can hold: a finite"
    with pytest.raises(ValueError, match=message):
        build(root, Random(rng=np.random.default_rng()))
    with pytest.raises(ValueError, match=message):
        MapDataModule(root, build=Random(rng=np.random.default_rng()))
    with pytest.raises(ValueError, match=r"^every: got np\.int64\(3\), expected"):
        build(root, Stripes(every=np.int64(3)))  # type: ignore[arg-type]
    assert not root.exists()


def test_a_family_that_draws_other_maps_each_time_is_refused(tmp_path: Path) -> None:
    """Random numbers without a seed, and numbers of which each map takes the next ones."""

    @dataclass(frozen=True)
    class Unseeded(Stripes):
        def draw(self, seed: int, indices: Ints) -> Maps:
            """Return maps of other stripes each time."""
            grids = (np.random.default_rng().random((len(indices), *self.map_size)) < 0.3).astype(
                np.uint8
            )
            return with_seed_points(self, seed, indices, grids)

    @dataclass(frozen=True)
    class Consecutive(Stripes):
        def draw(self, seed: int, indices: Ints) -> Maps:
            """Return maps that depend on the other maps of the batch."""
            rng = np.random.default_rng(seed)
            grids = (rng.random((len(indices), *self.map_size)) < 0.3).astype(np.uint8)
            return with_seed_points(self, seed, indices, grids)

    root = tmp_path / "maps"
    for generator in (Unseeded(), Consecutive(), Terrain((9, 8), over=Unseeded())):
        with pytest.raises(ValueError, match="map 1 differs when it is drawn again, so its recipe"):
            build(root, generator, maps=4, workers=1)
        with pytest.raises(ValueError, match="draw must take all random numbers from block"):
            OnlineMapDataset(generator, length=4)
    assert not root.exists()
    assert len(OnlineMapDataset(Stripes(), length=4)) == 4


@pytest.mark.parametrize("shard_size", [2, 100])
@pytest.mark.parametrize("edit", ["cells", "seed points"])
def test_a_dataset_is_not_extended_with_maps_of_an_edited_draw(
    stripes: type[Stripes], tmp_path: Path, shard_size: int, edit: str
) -> None:
    """The stored maps stay: a partial last shard would be replaced, others would be mixed."""

    @dataclass(frozen=True)
    class Edited(Stripes):
        def draw(self, seed: int, indices: Ints) -> Maps:
            """Return other maps than `Stripes` for the same parameters."""
            if edit == "seed points":
                maps = super().draw(seed, indices)
                return replace(maps, seed_points=maps.seed_points[:, ::-1].copy())
            grids = np.zeros((len(indices), *self.map_size), np.uint8)
            grids[:, 1 :: self.every, 2:] = 1
            return with_seed_points(self, seed, indices, grids)

    root = tmp_path / "maps"
    before = build(root, stripes(), maps=3, shard_size=shard_size, workers=1)
    with pytest.raises(ValueError, match=r"cannot be continued: stripes draws another map \d than"):
        build(root, Edited(), maps=5, shard_size=shard_size, workers=1)
    assert read_manifest(root) == before
    unchanged = build(root, Edited(), maps=3, shard_size=shard_size, workers=1)
    assert unchanged.shards == before.shards
    after = build(root, stripes(), maps=5, shard_size=shard_size, workers=1)
    assert after.maps == 5


def test_a_family_that_counts_in_bytes_is_refused() -> None:
    """Products of its counts would overflow, and compiled code write past the end."""

    @dataclass(frozen=True)
    class Small(Stripes):
        def draw(self, seed: int, indices: Ints) -> Maps:
            """Return the maps of `Stripes`, with counts of another type."""
            maps = super().draw(seed, indices)
            return replace(maps, rooms=maps.rooms.astype(np.uint8))

    with pytest.raises(
        ValueError, match=r"stripes: drew Maps\.rooms of type uint8, expected int64"
    ):
        generate(Small(), 0, range(4))


def test_what_is_no_family_is_refused() -> None:
    """A class in place of a generator."""
    with pytest.raises(ValueError, match=r"recipe: got <class .*MapSpec'>, expected a preset"):
        generate(MapSpec, 0, [0])  # type: ignore[arg-type]


@pytest.mark.parametrize("shape", [(2, 1, 8), (2, 9, 1), (1, 9, 8), (2, 8, 9), (4, 9, 4)], ids=str)
def test_grids_of_another_size_are_refused(shape: tuple[int, int, int]) -> None:
    """A family draws as many maps as it is asked for, of its own size."""
    with pytest.raises(ValueError, match=r"grids: got shape .* expected 2 maps of \(9, 8\)"):
        with_seed_points(Stripes(), 0, np.arange(2), np.zeros(shape, np.uint8))


def test_maps_keep_their_numbers() -> None:
    """Whatever becomes of the array that they were asked by."""
    numbers = np.arange(3)
    maps = generate(Stripes(), 0, numbers)
    numbers += 100
    assert maps.index.tolist() == [0, 1, 2]


def test_indices_are_any_integers_that_can_be_gone_through() -> None:
    """Also those of a generator, which can be gone through only once, or of a set."""
    for indices in ((k for k in (4, 2)), {4: "d", 2: "b"}.keys(), np.array([4, 2], np.uint8)):
        assert generate(Stripes(), 0, indices).index.tolist() == [4, 2]
    assert len(generate(Stripes(), 0, [])) == 0


@pytest.mark.parametrize("wrong", [3, np.array(3), [[1, 2]], [0.5], np.array([1.0])], ids=repr)
def test_what_is_no_sequence_of_integers_is_refused(wrong: Any) -> None:
    """A number alone, sequences of sequences, and fractions."""
    with pytest.raises(ValueError, match=r"indices: got .* expected integers from 0 to 2"):
        generate(Stripes(), 0, wrong)


# --- families that are not known ----------------------------------------------------------------


def test_a_stored_generator_of_an_unknown_family(stripes: type[Stripes]) -> None:
    """It says what the family said: the same JSON, identity and format version, size and moves."""
    known = stripes(every=3, movement=Movement(8))
    forget("stripes")
    unknown = stored_generator(known.to_json())
    assert isinstance(unknown, UnknownFamily)
    assert unknown.to_json() == known.to_json()
    assert identity(unknown, 5) == identity(known, 5)
    assert unknown.format_version == known.format_version == 2
    for name in ("name", "map_size", "resolution", "movement", "splits"):
        assert getattr(unknown, name) == getattr(known, name)
    again = pickle.loads(pickle.dumps(unknown))
    assert again == unknown
    assert hash(again) == hash(unknown)
    assert repr(again) == repr(unknown)
    assert stored_generator(stripes(every=4).to_json()) != unknown
    register(stripes)
    assert stored_generator(known.to_json()) == known


def test_a_class_made_anew_is_that_of_what_is_read(stripes: type[Stripes]) -> None:
    """A notebook runs its cell again: what was read before has the old class, what follows not."""
    text = stripes().to_json()
    assert type(stored_generator(text)) is stripes
    cell: dict[str, Any] = {**globals()}
    exec(CELL.format(more=1), cell)
    with pytest.raises(ValueError, match="unknown key"):
        stripes.from_json(cell["Stripes"]().to_json().replace("more", "fewer"))
    # The new class has another parameter, so it cannot draw the maps of the old one.
    assert isinstance(stored_generator(text), UnknownFamily)
    assert type(stored_generator(cell["Stripes"]().to_json())) is cell["Stripes"]


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], None]]:
    """Give what installs a package beside ``pillars.py``, with a line of entry points."""
    write_module(tmp_path)
    (tmp_path / "broken_halls.py").write_text("import mapdata_nowhere\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)

    def install(line: str) -> None:
        folder = tmp_path / "halls-1.0.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: halls\nVersion: 1.0\n")
        (folder / "entry_points.txt").write_text(f"[mapdata.generators]\n{line}\n")

    forget("pillars", "columns")
    yield install
    forget("pillars", "columns")
    sys.modules.pop("broken_halls", None)


@pytest.mark.parametrize("target", ["pillars:Pillars", "pillars"])
def test_an_installed_family_is_imported_when_it_is_needed(
    target: str, installed: Callable[[str], None]
) -> None:
    """By the entry point of its name, which names its class, or a module that registers it."""
    installed(f"pillars = {target}")
    assert type(stored_generator(Maze().to_json())) is Maze
    assert MapGenerator.from_dict({"generator": "cave"}) == Cave()
    assert "pillars" not in sys.modules
    pillars = MapGenerator.from_dict({"generator": "pillars", "side": 2})
    assert (pillars.name, pillars.map_size) == ("pillars", (9, 12))
    assert "pillars" in sys.modules
    assert type(stored_generator(pillars.to_json())) is type(pillars)


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (
            "pillars = broken_halls:Pillars",
            r"cannot be imported \(ModuleNotFoundError: No module named 'mapdata_nowhere'\)",
        ),
        ("pillars = pillars:Columns", r"cannot be imported \(AttributeError: module 'pillars'.*\)"),
        ("pillars = mapdata:Maze", "is the family 'maze'"),
        ("pillars = json", r"cannot be imported \(ValueError: json: expected a frozen dataclass.*"),
    ],
)
def test_a_broken_package_is_named_on_one_line(
    line: str, why: str, installed: Callable[[str], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its maps are read all the same; what needs the family says which package fails, and how."""
    if "Columns" in line:  # the module would register the family before it fails
        path = Path(sys.path[0], "pillars.py")
        path.write_text(path.read_text(encoding="utf-8").partition("\nregister(")[0])
    installed(line)
    stored = {**Stripes().to_dict(), "generator": "pillars"}
    assert isinstance(stored_generator(json.dumps(stored)), UnknownFamily)
    what = f"the entry point '{line}' of the package halls {why}; known are {KNOWN}"
    with pytest.raises(ValueError, match=f"^generator: .*'pillars' is not known here; {what}"):
        MapGenerator.from_dict(stored)


CELL = """
@dataclass(frozen=True)
class Stripes(Stripes):
    more: int = {more}

register(Stripes, {{"striped": Stripes()}})
"""


def test_a_cell_that_runs_again_takes_the_place_of_its_family(stripes: type[Stripes]) -> None:
    """As it is, and edited: with another field, another preset."""
    for more in (1, 1, 2):
        cell: dict[str, Any] = {**globals()}
        exec(CELL.format(more=more), cell)
        family: Any = cell["Stripes"]
        assert [GENERATORS["stripes"]] == [family]
        assert MapGenerator.preset("striped") == family(more=more)
        seven = family(more=7)
        assert MapGenerator.from_dict(seven.to_dict()) == seven
    with pytest.raises(ValueError, match="the preset 'striped' is there already"):
        register(family, {"striped": family(more=9)})
    assert MapGenerator.preset("striped") == family(more=2)


@dataclass(frozen=True)
class Bars(Stripes):
    """A family with parameters that are tuples, which it does not convert from JSON's lists."""

    name: ClassVar[str] = "bars"
    side: tuple[int, int] = (2, 5)
    marks: tuple[tuple[int, int], ...] | None = None


@pytest.fixture
def bars() -> Iterator[type[Bars]]:
    """The family, registered for one test."""
    register(Bars)
    yield Bars
    forget("bars")


def test_parameters_that_are_tuples_are_tuples_again(bars: type[Bars]) -> None:
    """JSON has lists only; a generator that is read equals the one that was written."""
    generator = bars(side=(1, 3), marks=((1, 2), (3, 4)))
    assert MapGenerator.from_json(generator.to_json()) == generator
    assert stored_generator(generator.to_json()) == generator
    assert hash(stored_generator(generator.to_json())) == hash(generator)
    assert MapGenerator.from_json(bars().to_json()) == bars()


def test_a_dataset_with_tuples_among_its_parameters_is_built_twice_and_extended(
    bars: type[Bars], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By generator, by JSON and by a data module; also if the annotations cannot be read."""
    root = tmp_path / "maps"
    generator = bars(side=(1, 3))
    text = json.dumps({"spec": generator.to_dict(), "seed": 4, "maps": 8})
    first = build(root, generator, seed=4, maps=4, workers=1)
    assert build(root, text, maps=4, workers=1) == first
    main(["build", str(root), "--recipe", text, "--maps", "6", "--workers", "1"])
    module = MapDataModule(str(root), build=text, batch_size=2)
    module.prepare_data()
    module.prepare_data()
    assert verify(root) == []
    monkeypatch.setitem(Bars.__annotations__, "side", "Unknown")
    _cached_generator.cache_clear()
    extended = build(root, generator, seed=4, maps=10, workers=1)
    assert build(root, generator, seed=4, maps=10, workers=1).identity == first.identity
    assert extended.maps == 10


def test_registering_refuses_what_cannot_work() -> None:
    """A name that is taken, a preset that is taken, a class that is no frozen dataclass, one that
    has no name or cannot be made.
    """

    @dataclass(frozen=True)
    class Impostor(MapSpec):
        """Another family of the same name."""

    class Plain(Stripes):
        """No dataclass of its own, so not frozen by itself, but it inherits: it may be
        registered.
        """

    with pytest.raises(ValueError, match="'rooms' is the name of <class 'mapdata"):
        register(Impostor)
    namesake = type("Maze", (Maze,), {"__dataclass_fields__": {}})
    with pytest.raises(ValueError, match=r"'maze' is the name of <class 'mapdata\..*\.Maze'>"):
        register(namesake)
    with pytest.raises(ValueError, match="the preset 'paper' is there already"):
        register(Maze, {"paper": Maze()})
    assert Plain.name == "stripes"
    with pytest.raises(ValueError, match="expected a frozen dataclass"):
        register(MapGenerator)  # type: ignore[type-abstract]

    @dataclass(frozen=True)
    class Nameless(MapGenerator):
        """It can be made, but nothing says what it is called."""

        @property
        def max_seed_points(self) -> int:
            return 2

        def draw(self, seed: int, indices: Ints) -> Maps:
            raise AssertionError("register refuses the class before anything is drawn")

    @dataclass(frozen=True)
    class Unfinished(MapGenerator):
        """It has a name, and nothing that draws."""

        name: ClassVar[str] = "unfinished"

    for family in (Nameless, Unfinished):
        with pytest.raises(ValueError, match="dataclass with name, max_seed_points and draw"):
            register(family)
    nameless = 'Nameless: has no name and no description; declare name: ClassVar.str. = "..." and '
    with pytest.raises(ValueError, match=f"^{nameless}"):
        generate(Nameless(), 0, [0])

    @dataclass(frozen=True)
    class Bare(Nameless):
        """It has a name, but the dataset card could not say what its maps are."""

        name: ClassVar[str] = "bare"

    with pytest.raises(ValueError, match=r"^Bare: has no description; declare description: "):
        register(Bare)
    assert "unfinished" not in GENERATORS


def test_presets_of_one_family_and_of_all() -> None:
    """A family knows its own, `MapGenerator` all."""
    assert MapSpec.preset("dungeon").rooms == (8, 16)
    assert MapGenerator.preset("maze") == Maze.preset("maze") == Maze()
    with pytest.raises(
        ValueError, match=r"preset: 'maze' is of another family: MapGenerator.preset\('maze'\)"
    ):
        MapSpec.preset("maze")


@pytest.mark.parametrize(
    ("values", "why"),
    [
        (
            {"generator": "mazes"},
            r"^generator: the family 'mazes' is not known here; import its module \(--import "
            rf"MODULE in a command, import MODULE in Python\); known are {KNOWN}; did you mean "
            r"maze\?$",
        ),
        (
            {"family": "pillars", "pillars": 40},
            "^spec: unknown keys: family, pillars; known are generator, .*; did you mean generator",
        ),
        ({"generator": "maze", "corridr": 2}, "unknown key: corridr; .* did you mean corridor"),
        ({"generator": 3}, "generator.*: got 3"),
        ({"generator": "maze", "rooms": [2, 3]}, "unknown key: rooms"),
        ({"corridor": 2}, "unknown key: corridor"),
        ("mazes", "preset: got 'mazes'"),
        ([1], "expected an object"),
    ],
)
def test_bad_specs_are_refused(values: object, why: str) -> None:
    """By naming what is wrong."""
    with pytest.raises(ValueError, match=why):
        MapGenerator.from_dict(values)


def test_version_1_says_what_it_always_said() -> None:
    """Specs of Algorithm 1 say no generator, and their identities stay; others are of version 2."""
    assert "generator" not in MapSpec().to_dict()
    assert (
        identity(MapSpec(), 7) == "d1b8a4aa131547ef781bcafb680990d01786599565f1ecbf05d9d2c7a680f20c"
    )
    assert (MapSpec().format_version, Maze().format_version) == (1, 2)
    assert MapSpec.from_dict({"generator": "rooms"}) == MapSpec()
    assert MapGenerator.from_json(Maze(corridor=3).to_json()) == Maze(corridor=3)


def test_a_spec_is_read_from_any_mapping() -> None:
    """With mappings in it; what is kept are plain values, and so the identity is the same."""
    movement = MappingProxyType({"connectivity": 8})
    values = {"map_size": UserList([40, 50]), "cover": UserList([0.1, 0.2]), "movement": movement}
    generator = MapGenerator.from_dict(MappingProxyType({"generator": "forest", **values}))
    assert generator == Forest((40, 50), cover=(0.1, 0.2), movement=Movement(8))
    assert identity(generator, 3) == identity(
        Forest((40, 50), cover=(0.1, 0.2), movement=Movement(8)), 3
    )


# --- a dataset like any other -------------------------------------------------------------------


@pytest.mark.parametrize("name", [name if name == "maze" else slow(name) for name in UNIFORM])
def test_every_field_of_a_family_is_served(name: str, built: Built) -> None:
    """From shards, their recipe, and online alike; by the stored movement and another one."""
    generator = SMALL[name]
    root = built(generator, maps=30, seed=7, shard_size=12)
    recipe = as_recipe(read_manifest(root).recipe())
    assert (recipe.generator, recipe.seed, recipe.maps) == (generator, 7, 30)
    for problems in ("route", "random"):
        batch = MapDataset(root, "train", ALL_FIELDS, problems=problems)[:]
        assert batch.map.shape[1:] == (1, *generator.map_size)
        assert (batch.cost >= 0).all()
    fields = ("map", "start", "goal", "path")
    moved = MapDataset(root, None, fields, movement=Movement(8))[:]
    assert (moved.path[:, 0] == moved.start).all()
    stored = MapDataset(root, None, fields, problems="random")[:]
    assert_same(stored, OnlineMapDataset(generator, 7, 30, fields=fields, problems="random")[:])
    np.testing.assert_array_equal(stored.map[:, 0], generate(generator, 7, range(30)).occupancy)
    assert len(ProblemSet.sample(generator, seed=3, maps=5, movement=Movement(8))) == 5


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in UNIFORM if name != "rooms"])
def test_every_verb_takes_a_family(
    name: str, built: Built, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nobody speaks of rooms, passages or the algorithm that draws them."""
    root = built(SMALL[name], maps=30, seed=7, shard_size=12)
    for line in (
        f"info {root}",
        f"info {root} --card {tmp_path}/card.md",
        f"verify {root}",
        *(
            f"show {root} --figure {figure} -o {tmp_path}/{figure}.png"
            for figure in ("map", "gallery", "path", "matrix", "distributions")
        ),
        f"report {root} -o {tmp_path}/report.html",
        *(
            f"export {root} {tmp_path}/{target} --format {target.partition('.')[0]}"
            for target in ("paper", "movingai", "ros", "parquet", "planning-datasets.npz")
        ),
    ):
        main(line.split())
    card = (tmp_path / "card.md").read_text(encoding="utf-8")
    assert SMALL[name].description in card
    for text in (capsys.readouterr().out, card):
        assert "assages" not in text
        assert "Algorithm 1" not in text
    assert "seed points" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_maps_without_room_for_seed_points() -> None:
    """Maps of one or two cells have what fits, and labels."""
    for generator in (Cave((1, 1)), Cave((4, 5), occupied=1.0), Forest((1, 2), (0.5, 0.5), (1, 1))):
        maps = generate(generator, 1, range(50))
        labels = label(maps)
        assert 1 <= maps.rooms.min() <= maps.rooms.max() <= 2
        assert labels.all_connected.all()
