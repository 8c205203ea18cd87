"""Data of a family of maps whose module is not imported: read, shown and verified all the same."""

from __future__ import annotations

import hashlib
import json
import pickle
import re
import shutil
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from helpers.builds import publish, restated
from helpers.families import KNOWN, PILLARS, forget, write_module
from helpers.samples import ALL_FIELDS, assert_same

from mapdata import (
    Cave,
    MapDataModule,
    MapDataset,
    OnlineMapDataset,
    Sample,
    ShardError,
    build,
    generate,
    identity,
    read_shard,
    repair,
    verify,
)
from mapdata.cli import main
from mapdata.describe import card
from mapdata.generators import MapGenerator, UnknownFamily, as_recipe
from mapdata.hashing import canonical_json
from mapdata.shards import MANIFEST, open_shard, read_manifest
from mapdata.shards.reader import map_shard

NOT_KNOWN = re.escape(
    "the family 'pillars' is not known here; import its module (--import MODULE in a command, "
    f"import MODULE in Python); known are {KNOWN}"
)
RECIPE = {"spec": {"generator": "pillars", "gaps": [2, 4]}, "seed": 3, "maps": 10}


class Known(NamedTuple):
    """What a process that knows the family sees of the dataset."""

    root: Path
    identity: str
    recipe: str
    batch: Sample
    table: Any
    pickled: bytes


PADDED = ("connection_matrix", "seed_points")
"""Fields that are padded to the largest number of seed points."""


def samples_of(root: object) -> Sample:
    """Return all problems of a dataset as one batch, with all fields."""
    return MapDataset(str(root), None, ALL_FIELDS)[:]


def assert_same_maps(unknown: Sample, known: Sample) -> None:
    """Compare all fields of a batch.

    The family may have six seed points and the stored maps have four, so the padding differs.
    """
    assert_same(unknown, known, PADDED)
    assert unknown.seed_points.shape[1:] == (4, 2)
    assert unknown.connection_matrix.shape[1:] == (4, 4)
    np.testing.assert_array_equal(unknown.seed_points, known.seed_points[:, :4])
    np.testing.assert_array_equal(unknown.connection_matrix, known.connection_matrix[:, :4, :4])
    assert (known.seed_points[:, 4:] == -1).all()


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Known:
    """Build the dataset where the family is known, look at it, and make the family unknown."""
    folder = tmp_path_factory.mktemp("pillars")
    write_module(folder)
    sys.path.insert(0, str(folder))
    __import__("pillars")
    sys.path.remove(str(folder))
    root = folder / "maps"
    recipe = as_recipe(RECIPE)
    manifest = build(root, recipe.generator, maps=10, seed=3, shard_size=4, workers=1)
    dataset = MapDataset(root, None, ("seed_points", "connection_matrix"))
    dataset[:]
    seen = Known(
        root,
        identity(recipe.generator, 3),
        manifest.recipe(),
        samples_of(root),
        dataset.table(),
        pickle.dumps(dataset),
    )
    forget("pillars", "columns")
    return seen


@pytest.fixture
def root(known: Known, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Give a copy of the dataset in a working folder that holds ``pillars.py``, too."""
    write_module(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path.copy())
    yield Path(shutil.copytree(known.root, tmp_path / "maps"))
    forget("pillars", "columns")


def exit_code(*arguments: object) -> object:
    """Run ``mapdata`` in this process and return its exit code."""
    try:
        main([str(argument) for argument in arguments])
    except SystemExit as stop:
        return stop.code or 0
    return 0


# --- reading ------------------------------------------------------------------------------------


def test_samples_are_those_of_where_the_family_is_known(known: Known, root: Path) -> None:
    """All fields of all problems, the table, shards and modules; from a folder and from a URL."""
    manifest = read_manifest(root)
    assert isinstance(manifest.generator, UnknownFamily)
    assert_same_maps(samples_of(root), known.batch)
    assert MapDataset(root).table().equals(known.table)
    assert len(read_shard(root / manifest.shards[0].name).maps) == 4
    assert next(iter(MapDataModule(str(root), batch_size=5).train_dataloader())).map.shape[0] == 5
    assert_same_maps(samples_of(f"file://{root}"), known.batch)


def test_identity_and_recipe_are_those_of_the_family(known: Known, root: Path) -> None:
    """They are computed from what is stored, from the manifest and from a shard alike."""
    manifest = read_manifest(root)
    header = open_shard(root / manifest.shards[0].name).header
    assert manifest.identity == header.identity == known.identity
    assert json.loads(manifest.recipe()) == json.loads(known.recipe)
    assert manifest.generator == header.generator
    assert manifest.header(*header.limits) == header
    assert read_manifest(root).to_json() == manifest.to_json()


def test_it_mixes_with_datasets_of_known_families(root: Path, tmp_path: Path) -> None:
    """Of one map size and movement, in any order."""
    build(tmp_path / "caves", Cave((9, 12)), maps=4, workers=1)
    own = MapDataset(root)[:].map
    caves = MapDataset(tmp_path / "caves")[:].map
    mixed = MapDataset([str(root), str(tmp_path / "caves"), str(root)])[:].map
    np.testing.assert_array_equal(mixed, np.concatenate([own, caves, own]))


def test_a_worker_that_does_not_know_the_family_pads_as_its_parent(
    known: Known, root: Path
) -> None:
    """The family says how many seed points a map may have, stored maps how many they have."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = pickle.loads(known.pickled)
    assert isinstance(again.reader.manifests[0].generator, UnknownFamily)
    assert again.info.recipes == (None,)
    np.testing.assert_array_equal(again[:].seed_points, known.batch.seed_points)
    np.testing.assert_array_equal(again[:].connection_matrix, known.batch.connection_matrix)


def test_the_module_may_be_imported_between_two_reads(
    known: Known, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a notebook: the manifest was read without the family, its shards are read with it."""
    dataset = MapDataset(root, None, ALL_FIELDS)
    monkeypatch.syspath_prepend(root.parent)
    module = __import__("pillars")
    assert_same_maps(dataset[:], known.batch)
    assert_same(samples_of(root), known.batch)
    assert read_manifest(root).generator == module.Pillars(gaps=(2, 4))
    assert hash(read_manifest(root).header(0, 4)) == hash(dataset.reader.manifests[0].header(0, 4))


# --- what needs the family ----------------------------------------------------------------------


def test_what_needs_the_family_says_so_on_one_line(root: Path, tmp_path: Path) -> None:
    """Drawing maps, building, extending, maps online, recipes."""
    generator = read_manifest(root).generator
    assert isinstance(generator, UnknownFamily)
    recipe = read_manifest(root).recipe()
    module = MapDataModule(None, build=recipe)
    needs: list[Callable[[], object]] = [
        lambda: generate(generator, 3, [0]),
        lambda: generator.draw(3, np.arange(2)),
        lambda: build(root, generator, maps=12, seed=3, shard_size=4),
        lambda: build(tmp_path / "new", generator, maps=12, seed=3),
        lambda: OnlineMapDataset(generator),
        lambda: as_recipe(recipe),
        module.setup,
    ]
    for need in needs:
        with pytest.raises(ValueError, match=f"{NOT_KNOWN}$"):
            need()
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
def test_verbs_that_read_need_no_family(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Info, show, report and export; the card says how the maps are made again."""
    for line in (
        "info maps",
        "info maps --recipe",
        "show maps --index 3 -o map.png",
        "report maps -o report.html",
        "export maps paper --format paper",
        "info maps --card",
    ):
        assert exit_code(*line.split()) == 0, capsys.readouterr().err
    assert "not known" not in capsys.readouterr().out
    text = (root / "README.md").read_text(encoding="utf-8")
    assert "maps of the family pillars" in text
    assert re.search("^mapdata build maps .* --import MODULE$", text, re.MULTILINE)
    assert "Write the module that has the family pillars in place of MODULE." in text


def test_the_command_imports_the_module_from_the_working_folder(
    known: Known, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """To build from a recipe, to go on, and to use the presets that the module registers."""
    (root.parent / "recipe.json").write_text(known.recipe, encoding="utf-8")
    assert exit_code("build", "again", "--recipe", "recipe.json", "--shard-size", "4") == 2
    error = capsys.readouterr().err
    assert re.fullmatch(f"mapdata: generator: {NOT_KNOWN}\n", error)
    flags = ("--shard-size", "4", "--import", "pillars")
    assert exit_code("build", "again", "--recipe", "recipe.json", *flags) == 0
    assert "bit for bit" in capsys.readouterr().out
    assert read_manifest(Path("again")) == read_manifest(root)
    forget("pillars", "columns")
    assert exit_code("build", "more", "--preset", "columns", "--maps", "2", *flags) == 0
    assert "--import pillars" in card("more")
    assert "The module pillars has the family pillars." in card("more")


def test_a_card_names_the_module_of_several_parts_once(known: Known, root: Path) -> None:
    """Two parts of a mixture are of a family that somebody else wrote."""
    part = json.loads(known.recipe)["spec"]
    recipe = {"spec": {"generator": "mixture", "parts": [part, {**part, "side": 2}]}, "maps": 4}
    (root.parent / "recipe.json").write_text(json.dumps(recipe), encoding="utf-8")
    assert exit_code("build", "both", "--recipe", "recipe.json", "--import", "pillars") == 0
    assert card("both").count("--import pillars") == 1
    assert card("both").count("The module pillars has the family pillars.") == 1


# --- a class that was changed since its maps were built ------------------------------------------

CHANGES = {
    "a new parameter": ("    side: int = 1", "    side: int = 1\n    wide: int = 0", "new: wide"),
    "a renamed parameter": ("gaps", "spaces", "new: spaces; removed: gaps"),
    "another form of a value": (
        "        super().__post_init__()",
        "        super().__post_init__()\n        self._convert(lambda name, side: 1.0, 'side')",
        "with other values: side",
    ),
    "a value that is refused": (
        "        super().__post_init__()",
        "        super().__post_init__()\n        raise RuntimeError('too narrow')",
        "RuntimeError: too narrow",
    ),
    "terrain": (
        "    def draw(",
        "    @property\n    def has_terrain(self):\n        return True\n\n    def draw(",
        "with other values: has_terrain",
    ),
}


@pytest.mark.parametrize("name", CHANGES)
def test_maps_of_a_class_that_has_changed_are_read(
    name: str, known: Known, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing is damaged; what draws maps says how the class differs from the stored parameters."""
    old, new, difference = CHANGES[name]
    write_module(root.parent, PILLARS.replace(old, new).replace('{"columns": Pillars()}', ""))
    reason = (
        "the stored parameters of the family 'pillars' are not those of the registered class "
        rf"Pillars \({difference}\); the stored maps can be read, but making more of them needs "
        "the class as it was when they were built"
    )
    flags = ("--import", "pillars")
    assert exit_code("verify", "maps", *flags) == 0
    well, note = capsys.readouterr().out.splitlines()
    assert well == "maps: no faults found"
    assert re.fullmatch(
        f"note: maps: the parameters of its recipe were not checked, since {reason}", note
    )
    assert_same_maps(samples_of(root), known.batch)
    generator = read_manifest(root).generator
    assert isinstance(generator, UnknownFamily)
    assert read_manifest(root).identity == known.identity
    with pytest.raises(ValueError, match=f"^spec: {reason}$"):
        OnlineMapDataset(generator)
    (root / read_manifest(root).shards[0].name).unlink()
    (fault,) = repair(root)
    assert re.search(f": missing; it cannot be made again: {reason}$", fault)
    assert "delete" not in fault


def test_maps_of_a_class_with_a_new_parameter_are_not_extended(
    known: Known, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Neither by parameters nor by the recipe of the dataset: the maps would be of two families."""
    old, new, _ = CHANGES["a new parameter"]
    write_module(root.parent, PILLARS.replace(old, new))
    (root.parent / "recipe.json").write_text(known.recipe, encoding="utf-8")
    flags = ("--maps", "12", "--shard-size", "4", "--import", "pillars")
    assert exit_code("build", "maps", "--recipe", json.dumps(RECIPE), *flags) == 2
    error = capsys.readouterr().err
    assert error.startswith("mapdata: root: maps cannot be continued: the stored parameters of ")
    assert "class Pillars (new: wide); the stored maps can be read" in error
    assert exit_code("build", "maps", "--recipe", "recipe.json", *flags) == 2
    assert capsys.readouterr().err == (
        f"mapdata: recipe: its identity {known.identity} is not that of its spec and seed: its "
        "parameters are not those of the registered class Pillars (new: wide)\n"
    )
    assert read_manifest(root).maps == 10


def test_a_generator_that_was_read_before_its_module_was_imported(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It still cannot draw maps; the dataset has to be opened again."""
    generator = read_manifest(root).generator
    monkeypatch.syspath_prepend(root.parent)
    __import__("pillars")
    assert generator is not None
    with pytest.raises(ValueError, match="was not registered when the dataset was opened; open it"):
        generator.draw(3, np.arange(2))
    assert not isinstance(read_manifest(root).generator, UnknownFamily)


# --- verifying ----------------------------------------------------------------------------------


def test_verify_says_what_it_could_not_check(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """On a line of its own, which is no fault; in Python it is a warning."""
    assert exit_code("verify", "maps") == 0
    well, note = capsys.readouterr().out.splitlines()
    assert well == "maps: no faults found"
    why = f"maps: the parameters of its recipe were not checked, since {NOT_KNOWN}"
    assert re.fullmatch(f"note: {why}", note)
    with pytest.warns(UserWarning, match=f"^{why}$"):
        assert verify("maps") == []
    assert exit_code("verify", "maps", "--import", "pillars") == 0
    assert capsys.readouterr().out == "maps: no faults found\n"


def test_damage_is_found_and_repaired_where_the_family_is_known(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without the family, verify names the damaged shards, and repair why they are left."""
    names = [entry.name for entry in read_manifest(root).shards]
    before = {name: (root / name).read_bytes() for name in names}
    flipped = bytearray(before[names[0]])
    flipped[-1] ^= 1
    (root / names[0]).write_bytes(flipped)
    (root / names[2]).unlink()
    assert exit_code("verify", "maps") == 1
    out, error = capsys.readouterr()
    assert out.splitlines()[:2] == [
        f"maps/{names[0]}: damaged (its file hash does not fit)",
        f"maps/{names[2]}: missing",
    ]
    assert error.splitlines()[-1] == (
        "mapdata: 2 faults found; --repair builds shards again if there is a recipe and its maps "
        "can be drawn (see the note)"
    )
    left = repair(root)
    assert len(left) == 2
    for fault in left:
        assert re.search(f"; it cannot be made again: {NOT_KNOWN}$", fault)
    assert exit_code("verify", "maps", "--repair") == 1
    assert exit_code("verify", "maps", "--repair", "--import", "pillars") == 0
    assert {name: (root / name).read_bytes() for name in names} == before


def test_a_lost_manifest_is_made_again_without_the_family(root: Path) -> None:
    """All that it says is derived from the shards."""
    manifest = read_manifest(root)
    (root / MANIFEST).unlink()
    with pytest.warns(UserWarning, match=NOT_KNOWN):
        assert verify(root) == [f"{root / MANIFEST}: missing"]
    assert repair(root) == []
    assert read_manifest(root) == manifest


# --- hostile data -------------------------------------------------------------------------------

MOVEMENT = {"connectivity": 4, "corner_cutting": False, "diagonal_cost": 2**0.5}
DEEP: Any = 0
for _ in range(40):
    DEEP = [DEEP]

HOSTILE: dict[str, tuple[dict[str, Any], str]] = {
    "maps too large": ({"map_size": [9, 4097]}, r"map_size: got \(9, 4097\), expected 1 to 4096"),
    "maps without rows": ({"map_size": [0, 12]}, "map_size"),
    "three sides": ({"map_size": [9, 12, 3]}, "map_size"),
    "no resolution": ({"resolution": 0.0}, "resolution: got 0.0"),
    "resolution a text": ({"resolution": "fine"}, "resolution"),
    "splits over 1": ({"splits": [0.8, 0.3, 0.1]}, "splits"),
    "a movement of others": ({"movement": MOVEMENT | {"wings": 2}}, "movement: unknown key: wings"),
    "connectivity 5": ({"movement": MOVEMENT | {"connectivity": 5}}, "connectivity"),
    "a movement that leaves out": ({"movement": {"connectivity": 4}}, "identity"),
    "a resolution of another type": ({"resolution": 1}, "identity"),
    "no map size": ({"map_size": None}, "spec: lacks map_size, which every family has"),
    "a name that writes to the terminal": ({"generator": "\x1b[2J"}, "printable characters"),
    "a long name": ({"generator": "p" * 101}, "1 to 100 printable characters"),
    "no name": ({"generator": ""}, "printable characters"),
    "a name that is a number": ({"generator": 3}, "generator: got 3, expected the name of"),
    "a list as its name": ({"generator": ["pillars"]}, "expected the name of a family"),
    "long parameters": ({"note": "x" * 4000}, "characters, expected at most 4000"),
    "deep parameters": ({"note": DEEP}, "more than 32 deep"),
    "the name of a known family": ({"generator": "maze"}, "spec: unknown keys: side, gaps; known"),
}


def stated_identity(generator: object, seed: int) -> str:
    """Return the identity that docs/format.md gives to a spec, sound or not."""
    values = {"format_version": 2, "spec": generator, "seed": seed}
    text = json.dumps(values, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


@pytest.mark.parametrize("name", HOSTILE)
def test_a_name_that_is_not_known_skips_no_check(name: str, root: Path) -> None:
    """Every value that all families have is checked."""
    changes, why = HOSTILE[name]

    def change(values: dict[str, Any]) -> None:
        generator = values["spec"] | changes
        values["spec"] = {key: value for key, value in generator.items() if value is not None}
        values["identity"] = stated_identity(values["spec"], values["seed"])

    text = (root / MANIFEST).read_text(encoding="utf-8")
    (root / MANIFEST).write_text(restated(text, change), encoding="utf-8")
    with pytest.raises(ShardError, match=why) as caught:
        read_manifest(root)
    assert str(caught.value).startswith(f"{root / MANIFEST}: ")
    assert "\n" not in str(caught.value)
    assert "\x1b" not in str(caught.value)


@pytest.mark.parametrize("name", ["pillars", "columns"])
def test_a_shard_of_another_family_is_not_served(name: str, root: Path) -> None:
    """Neither of these is known, and still they are not the same."""
    shard = root / read_manifest(root).shards[0].name
    header = open_shard(shard).header
    assert header.generator is not None
    stored = canonical_json({**header.generator.to_dict(), "gaps": [3, 4]} | {"generator": name})
    image = shard.read_bytes().replace(header.generator.to_json().encode(), stored.encode())
    assert header.identity is not None
    image = image.replace(header.identity.encode(), stated_identity(json.loads(stored), 3).encode())
    assert image != shard.read_bytes()
    publish(root, shard.name, image)
    other = map_shard(shard).shard.header.generator
    assert isinstance(other, UnknownFamily)
    assert other.name == name
    with pytest.raises(ShardError, match="holds other maps than the manifest says"):
        MapDataset(root)[0]
    with pytest.warns(UserWarning, match=NOT_KNOWN):
        assert verify(root) == [f"{shard}: holds other maps than the manifest says"]


def test_a_recipe_keeps_to_families_that_are_known() -> None:
    """What is stored may be of an unknown family; what is asked for may not."""
    values = {"generator": "pillars", "map_size": [9, 12]}
    with pytest.raises(ValueError, match=f"^generator: {NOT_KNOWN}$"):
        MapGenerator.from_dict(values)
