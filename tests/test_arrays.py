"""What public objects print: sizes, seed, identity, and never their arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import samples

from mapdata import (
    MapDataModule,
    MapDataset,
    MapSpec,
    Maze,
    Movement,
    OnlineMapDataset,
    Plan,
    ProblemSet,
    astar,
    generate,
    label,
    search_batch,
)
from mapdata.describe import dataset_statistics
from mapdata.evaluation import classical
from mapdata.formats import Collection, ForeignMap
from mapdata.generators import Recipe
from mapdata.shards import Root, open_shard, read_manifest


@pytest.fixture(scope="module")
def printed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What each of the public objects prints."""
    root = samples.build_small(tmp_path_factory.mktemp("reprs") / "maps")
    maps = generate(samples.SPEC, 5, range(40))
    labels = label(maps)
    dataset = MapDataset(root, "train", (*samples.ALL_FIELDS,))
    module = MapDataModule(root)
    module.setup("fit")
    ends = maps.seed_points[:, 0], maps.seed_points[:, 1]
    foreign = ForeignMap("eye", np.eye(20, dtype=np.uint8), seed_points=ends[0])
    paths = search_batch("astar", maps.occupancy, *ends)
    objects = {
        "maps": maps,
        "labels": labels,
        "search labels": labels.astar,
        "sample": dataset[0],
        "batch": dataset[:40],
        "before fields": dataset._batch(np.arange(40), 0),
        "dataset": dataset,
        "online": OnlineMapDataset(samples.SPEC, 7, 300),
        "module": module,
        "root": Root.open([root, root]),
        "manifest": read_manifest(Path(root)),
        "recipe": Recipe(samples.SPEC, 3),
        "shard": open_shard(sorted(Path(root).glob("*.h5"))[0]),
        "statistics": dataset_statistics(root, repeats=True),
        "problems": ProblemSet.sample(MapSpec(), 77, maps=40, movement=Movement(8)),
        "result": paths,
        "search result": astar(maps.occupancy[0], ends[0][0], ends[1][0]),
        "sampler": module.train_dataloader().sampler,
        "plan": Plan(paths.cells, 99),
        "foreign": foreign,
        "collection": Collection([foreign] * 1000),
        "planners": classical()[:10],
        "maze": Maze(),
    }
    return {name: repr(instance) for name, instance in objects.items()}


def test_no_array_and_no_address_is_printed(printed: dict[str, str]) -> None:
    """One line each, short enough to read."""
    for name, text in printed.items():
        assert "array(" not in text, name
        assert "tensor(" not in text, name
        assert " object at 0x" not in text, name
        assert "\n" not in text, name
        assert len(text) < 2000, name


def test_sizes_seed_and_identity_are_printed(printed: dict[str, str]) -> None:
    """What one looks for first."""
    manifest = "Manifest(60 maps, map_size=(20, 20), seed=5, identity="
    for name, parts in {
        "maps": ["Maps(movement=", "packed=uint64 (40, 20, 1), rooms=int64 (40,)"],
        "labels": ["Labels(maps=Maps(", "astar=RouteLabels(moves=uint8 ("],
        "sample": ["Sample(map=uint8 (1, 20, 20), ", "problem=0"],
        "batch": ["Sample(map=uint8 (40, 1, 20, 20), ", "start=int64 (40, 2), goal="],
        "dataset": ["map_size=(20, 20)", "content_hash=["],
        "online": ["seed=7", "300 problems"],
        "module": ["batch_size=256", "{'train': MapDataset("],
        "root": [manifest],
        "manifest": [manifest],
        "shard": ["seed=5", "start=0, stop=16"],
        "statistics": ["DatasetStatistics(60 maps, ", manifest],
        "problems": ["ProblemSet(grids=uint8 (40, 64, 64), ", "problems by seed 77"],
        "result": ["BatchResult(cells=int64 (", "cost=float64 (40,)"],
        "plan": ["Plan(path=int64 (", "expansions=99, prepared=0, looks=None, order=None)"],
        "foreign": ["ForeignMap('eye', 20 x 20 cells)"],
        "collection": ["Collection(1000 maps, None, 0 left out, 0 notes)"],
    }.items():
        for part in parts:
            assert part in printed[name], name


def test_printing_a_data_module_builds_nothing(tmp_path: Path) -> None:
    """Lightning's own text opens the loaders, and so would build what is missing."""
    module = MapDataModule(tmp_path / "maps", build="paper")
    assert str(module) == repr(module)
    assert repr(module).endswith(": not set up")
    assert list(tmp_path.iterdir()) == []


def test_small_values_are_printed() -> None:
    """Cells and numbers of one sample are read at a glance."""
    sample = OnlineMapDataset(samples.SPEC, fields=("start", "cost", "hardness"))[0]
    cost, hardness = sample.cost.item(), sample.hardness.item()
    assert repr(sample) == f"Sample(start={sample.start.tolist()}, cost={cost}, {hardness=})"
    assert "Movement(connectivity=8" in repr(Movement(8))
