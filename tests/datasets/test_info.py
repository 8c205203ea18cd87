"""`dataset.info`: counted by loading everything, and compared with the manifest."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers import samples

from mapdata import MapDataset, Movement, OnlineMapDataset, Pairs, Random, Sample
from mapdata.datasets import DatasetInfo, FieldInfo
from mapdata.formats import Collection, ForeignMap, import_maps
from mapdata.generators import Recipe
from mapdata.shards import read_manifest

SPLITS = ("train", "val", "test")


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A small dataset in four shards."""
    return samples.build_small(tmp_path_factory.mktemp("info") / "maps")


def test_info_holds_the_recipe_and_the_hashes_of_the_manifest(root: str) -> None:
    """With them the dataset can be built again, and compared."""
    manifest = read_manifest(Path(root))
    info = MapDataset(root, "train").info
    assert info.roots == (root,)
    assert info.recipes == (Recipe(samples.SPEC, 5, 60, manifest.content_hash),)
    assert info.identities == (manifest.identity,)
    assert info.content_hashes == (manifest.content_hash,)
    assert (info.map_size, info.resolution) == ((20, 20), samples.SPEC.resolution)
    assert info.movement == samples.SPEC.movement
    assert MapDataset(root, movement=Movement(8)).info.movement == Movement(8)


@pytest.mark.parametrize("problems", ["route", "pairs", "random", Pairs(unsolvable=True)])
def test_counts_are_those_of_the_datasets_of_each_split(root: str, problems: Any) -> None:
    """The whole dataset has the problems of its three splits, and as many maps as were built."""
    parts = {split: MapDataset(root, split, problems=problems) for split in SPLITS}
    info = MapDataset(root, problems=problems).info
    assert info.problem_counts == {split: len(part) for split, part in parts.items()}
    maps = {split: len(MapDataset(root, split, problems="random")) for split in SPLITS}
    assert info.map_counts == maps
    assert sum(info.map_counts.values()) == 60
    for split, part in parts.items():
        assert part.info.problem_counts == {split: len(part)}
        assert part.info.map_counts == {split: maps[split]}


@pytest.mark.parametrize("radius", [0.0, 0.09])
def test_counts_are_those_after_filter_and_radius(root: str, radius: float) -> None:
    """Each split filtered for itself has as many problems."""
    whole = MapDataset(root, radius=radius).filter(path_length=(4, 12))
    parts = {
        split: MapDataset(root, split, radius=radius).filter(path_length=(4, 12))
        for split in SPLITS
    }
    assert whole.info.problem_counts == {split: len(part) for split, part in parts.items()}
    assert 0 < sum(whole.info.problem_counts.values()) == len(whole) < len(MapDataset(root))


def test_imported_maps_have_no_recipe(tmp_path: Path) -> None:
    """Nobody can build them again, but their content has a hash."""
    maps = Collection([ForeignMap("eye", np.eye(20, dtype=np.uint8))] * 8)
    root = tmp_path / "imported"
    import_maps(root, maps)
    info = MapDataset(root, problems="random").info
    assert (info.recipes, info.identities) == ((None,), (None,))
    assert info.content_hashes == (read_manifest(root).content_hash,)


def test_several_roots_have_an_entry_each(root: str, tmp_path: Path) -> None:
    """Their counts are added up."""
    other = samples.build_small(tmp_path / "other", maps=10, seed=6)
    info = MapDataset([root, other]).info
    assert [recipe.seed for recipe in info.recipes if recipe] == [5, 6]
    assert sum(info.map_counts.values()) == 70


@pytest.mark.parametrize("split", [None, "val"])
def test_info_of_maps_made_online(root: str, split: str | None) -> None:
    """Recipe and identity are those of a build; maps of each split are those that shards have."""
    info = OnlineMapDataset(samples.SPEC, 5, 60, split).info
    assert info.recipes == (Recipe(samples.SPEC, 5, 60),)
    assert info.identities == (read_manifest(Path(root)).identity,)
    assert (info.roots, info.content_hashes) == ((), (None,))
    built = {name: len(MapDataset(root, name, problems="random")) for name in SPLITS}
    expected = built if split is None else {split: 60}
    assert info.map_counts == info.problem_counts == expected


def share_free(batch: Sample) -> torch.Tensor:
    """Return (B,) the share of free cells."""
    share: torch.Tensor = 1 - batch.map.float().mean(dim=(1, 2, 3))
    return share


@pytest.mark.parametrize("max_length", [None, 64])
def test_fields_have_the_shapes_and_dtypes_of_samples(root: str, max_length: int | None) -> None:
    """Each sample has them; the number of rows of a path is None where it varies."""
    fields: tuple[Any, ...] = (*samples.ALL_FIELDS, share_free)
    dataset = MapDataset(root, fields=fields, max_length=max_length, dtype=torch.float32)
    described = dataset.info.fields
    assert described is not None
    assert described["path"] == FieldInfo((max_length, 2), torch.int64)
    assert described["map"] == FieldInfo((1, 20, 20), torch.float32)
    assert list(described) == [*samples.ALL_FIELDS, "share_free"]
    for sample in (dataset[0], dataset[7]):
        for name, tensor in sample._asdict().items():
            shape = tuple(tensor.shape)
            if name == "path" and max_length is None:
                shape = (None, *shape[1:])
            assert described[name] == FieldInfo(shape, tensor.dtype), name


def test_a_dataset_without_problems_has_no_shapes(root: str) -> None:
    """There is no sample that could have them."""
    info = MapDataset(root).filter(path_length=(10_000, None)).info
    assert info.fields is None
    assert info.problem_counts == dict.fromkeys(SPLITS, 0)


def test_the_repr_has_a_line_for_each_attribute(root: str) -> None:
    """So that it is read at a glance."""
    info = MapDataset(root, "train", problems=Random()).info
    first, *lines, last = repr(info).splitlines()
    assert (first, last) == ("DatasetInfo(", ")")
    assert [line.strip().split("=")[0] for line in lines] == list(DatasetInfo.__annotations__)
    assert f"    map_counts={info.map_counts}," in lines
