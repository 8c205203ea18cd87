"""Recipes: everything that asks which maps are meant accepts the same forms."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

import mapdata
from mapdata import (
    PRESETS,
    MapDataModule,
    MapSpec,
    Maze,
    Movement,
    OnlineMapDataset,
    ProblemSet,
    Random,
    Recipe,
    ShardError,
    build,
    generate,
)
from mapdata.arrays import Bytes
from mapdata.cli import main
from mapdata.generators import RecipeLike, as_recipe
from mapdata.shards import read_manifest, read_shard

RECIPE = Recipe(Maze((16, 12), reopened=0.1), seed=5, maps=6)
"""The recipe that most forms stand for."""

FORMS: dict[str, Callable[[str], RecipeLike]] = {
    "preset": lambda file: "maze",
    "name of a file": lambda file: file,
    "path of a file": Path,
    "text": lambda file: Path(file).read_text(encoding="utf-8"),
    "mapping": lambda file: RECIPE.to_dict(),
    "generator": lambda file: RECIPE.generator,
    "recipe": lambda file: RECIPE,
}
"""The accepted forms, each made from the name of the recipe file."""

EXPECTED = {"preset": Recipe(Maze()), "generator": Recipe(RECIPE.generator)}
"""What a form stands for that is not `RECIPE`."""


def built_maps(recipe: RecipeLike, root: Path) -> Bytes:
    """Return 6 maps that `build` stores."""
    manifest = build(root, recipe, maps=6, workers=1)
    return read_shard(root / manifest.shards[0].name).maps.occupancy


def generated_maps(recipe: RecipeLike, root: Path) -> Bytes:
    """Return 6 maps of `generate`."""
    return generate(recipe, indices=range(6)).occupancy


def online_maps(recipe: RecipeLike, root: Path) -> Bytes:
    """Return 6 maps that `OnlineMapDataset` serves."""
    maps: Bytes = OnlineMapDataset(recipe, length=6, fields=("map",))[:].map[:, 0].numpy()
    return maps


def module_maps(recipe: RecipeLike, root: Path) -> Bytes:
    """Return 6 maps of the generator and seed that `MapDataModule` serves."""
    module = MapDataModule(None, build=recipe)
    module.setup("test")
    (dataset,) = module.datasets.values()
    assert isinstance(dataset, OnlineMapDataset)
    return generate(dataset.generator, dataset.seed, range(6)).occupancy


def sampled_maps(recipe: RecipeLike, root: Path) -> Bytes:
    """Return the grids of 6 problems of `ProblemSet.sample`."""
    return ProblemSet.sample(recipe, maps=6, movement=Movement(), problems=Random()).grids


@pytest.fixture
def file(tmp_path: Path) -> str:
    """Write a recipe file."""
    path = tmp_path / "recipe.json"
    path.write_text(json.dumps(RECIPE.to_dict()), encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    "maps_of", [built_maps, generated_maps, online_maps, module_maps, sampled_maps]
)
def test_every_function_accepts_every_form(
    maps_of: Callable[[RecipeLike, Path], Bytes], form: str, file: str, tmp_path: Path
) -> None:
    """All of them give the maps of the generator and seed that the form stands for."""
    expected = EXPECTED.get(form, RECIPE)
    maps = expected.generator.draw(expected.seed, generate("maze", indices=range(6)).index)
    assert (maps_of(FORMS[form](file), tmp_path / "maps") == maps.occupancy).all()


@pytest.mark.parametrize("form", FORMS)
def test_every_form_is_the_same_recipe(form: str, file: str) -> None:
    """A form that states no seed and no number of maps has seed 0 and 10,000 maps."""
    assert as_recipe(FORMS[form](file)) == EXPECTED.get(form, RECIPE)


@pytest.mark.parametrize("form", FORMS)
def test_the_data_module_keeps_plain_values(form: str, file: str) -> None:
    """A checkpoint holds the recipe as text or plain values, which build the same maps."""
    kept = MapDataModule(None, build=FORMS[form](file)).hparams["build"]
    assert as_recipe(json.loads(json.dumps(kept))) == EXPECTED.get(form, RECIPE)


def test_without_numbers_the_maps_are_those_of_the_recipe(tmp_path: Path) -> None:
    """Seed and number of maps come from the recipe where no argument overrides them."""
    manifest = build(tmp_path / "maps", RECIPE, workers=1)
    assert (manifest.seed, manifest.maps) == (5, 6)
    assert len(generate(RECIPE)) == len(OnlineMapDataset(RECIPE)) == 6
    assert len(ProblemSet.sample(RECIPE, movement=Movement(), problems=Random())) == 6
    longer = OnlineMapDataset(RECIPE, seed=8, length=9)
    assert (longer.seed, len(longer)) == (8, 9)
    assert (generate(RECIPE, 8, [3]).packed == generate(RECIPE.generator, 8, [3]).packed).all()
    module = MapDataModule(str(tmp_path / "module"), build=RECIPE, batch_size=2)
    assert next(iter(module.train_dataloader())).map.shape[1:] == (1, 16, 12)
    assert read_manifest(tmp_path / "module").content_hash == manifest.content_hash


def test_an_override_drops_the_content_hash() -> None:
    """The hash is that of one seed and one number of maps; naming these changes nothing."""
    recipe = Recipe(RECIPE.generator, 5, 6, content_hash="0" * 64)
    assert as_recipe(recipe, seed=5, maps=6) is recipe
    assert as_recipe(recipe, seed=4) == Recipe(RECIPE.generator, 4, 6)
    assert as_recipe(recipe, maps=7) == Recipe(RECIPE.generator, 5, 7)


def test_build_compares_the_content_hash(tmp_path: Path) -> None:
    """Of exactly the maps that the recipe states, and only when all of them are there."""
    content_hash = build(tmp_path / "maps", RECIPE, workers=1).content_hash
    sound = Recipe(RECIPE.generator, 5, 6, content_hash)
    assert build(tmp_path / "again", sound, workers=1).content_hash == content_hash
    edited = Recipe(RECIPE.generator, 5, 6, "0" * 64)
    with pytest.raises(ShardError, match=f"content hash {content_hash}, the recipe says 0000"):
        build(tmp_path / "edited", edited, workers=1)
    assert build(tmp_path / "more", edited, maps=7, workers=1).complete
    part = build(tmp_path / "part", edited, shard_size=3, part=(0, 2), workers=1)
    assert not part.complete


@pytest.mark.parametrize(
    ("recipe", "message"),
    [
        ("mazes", r"recipe: got 'mazes', expected a preset \(paper, .*; did you mean maze\?"),
        (3, r"recipe: got 3, expected a preset .* JSON text such as .*, a mapping, a MapGen"),
        (Maze, r"recipe: got <class .*Maze'>, expected a preset"),
        (None, r"recipe: got None, expected a preset"),
        (Path("none.json"), r"recipe: none.json: no such file, expected a recipe as JSON"),
        (Path(), r"recipe: .: is a folder, expected a recipe as JSON"),
        ("{", r"recipe: not JSON"),
        ({"spec": "mazes"}, r"preset: got 'mazes', .*; did you mean maze\?"),
        ({"splits": [0.6, 0.2, 0.2]}, r"recipe: got 'splits', .* parameter .*: write it into spec"),
        ({"content_hash": 3}, r"content_hash: got 3, expected a SHA-256 in hexadecimal digits"),
    ],
)
def test_what_is_no_recipe_is_refused(recipe: RecipeLike, message: str, tmp_path: Path) -> None:
    """Each message says what was passed and what is accepted; no folder is made."""
    for function in (
        as_recipe,
        generate,
        OnlineMapDataset,
        lambda text: build(tmp_path / "x", text),
    ):
        with pytest.raises(ValueError, match=message):
            function(recipe)
    assert not (tmp_path / "x").exists()


def test_a_recipe_file_is_a_json_object_of_limited_size(tmp_path: Path) -> None:
    """A list, and a file that is much larger than a recipe, are refused by the name of the file."""
    path = tmp_path / "recipe.json"
    path.write_text("[]", encoding="utf-8")
    with pytest.raises(ValueError, match=r"recipe: .*recipe\.json: expected an object with"):
        as_recipe(path)
    path.write_bytes(b" " * (2**20 + 1))
    with pytest.raises(ValueError, match=r"recipe\.json has 1048577 bytes, expected at most"):
        as_recipe(path)


@pytest.mark.parametrize("name", ["map.yaml", "arena.map", "hall.PNG"])
def test_a_file_of_a_map_is_no_recipe(name: str, tmp_path: Path) -> None:
    """The message says how a map becomes a dataset."""
    path = tmp_path / name
    path.write_text("image: map.pgm\n", encoding="utf-8")
    hint = f"picture 'mapdata import .*{name} ROOT' makes a dataset$"
    with pytest.raises(ValueError, match=hint):
        as_recipe(path)
    path.write_bytes(b" " * (2**20 + 1))
    with pytest.raises(ValueError, match=f"expected at most .*{hint}"):
        as_recipe(path)
    path.write_text('{"spec": "dungeon"}', encoding="utf-8")  # a recipe after all
    assert as_recipe(path) == as_recipe("dungeon")


def test_a_dataset_is_no_recipe(tmp_path: Path) -> None:
    """The message names what serves the problems of a dataset."""
    with pytest.raises(
        ValueError, match=r"is a folder, .*; problems of a dataset are served by ProblemSet\.read"
    ):
        as_recipe(str(tmp_path))


def test_presets_are_public_and_read_only() -> None:
    """`mapdata.PRESETS` maps each name to its generator."""
    assert mapdata.PRESETS["dungeon"] == MapSpec.preset("dungeon")
    with pytest.raises(TypeError):
        PRESETS["mine"] = Maze()  # type: ignore[index]


def test_the_command_builds_every_form_of_text(file: str, tmp_path: Path) -> None:
    """A preset's name, a file, or its JSON text."""
    for k, text in enumerate((file, json.dumps(RECIPE.to_dict()), "maze")):
        main(["build", str(tmp_path / str(k)), "--recipe", text, "--maps", "3"])
    manifests = [read_manifest(tmp_path / str(k)) for k in range(3)]
    assert [(manifest.generator, manifest.seed) for manifest in manifests] == [
        (RECIPE.generator, 5),
        (RECIPE.generator, 5),
        (Maze(), 0),
    ]
