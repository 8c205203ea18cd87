"""Survey: what it counts equals slow counting, and repeated maps are found in all their symmetric
images.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from helpers.samples import SPEC, WIDE, build_small

from mapdata import Labels, MapDataset, MapSpec, Route, ShardError, generate
from mapdata.arrays import Bytes
from mapdata.formats import Collection, ForeignMap, import_maps
from mapdata.shards import DatasetStatistics, Root, dataset_statistics, read_manifest
from mapdata.shards.statistics import histogram
from mapdata.spec import SPLITS


def all_labels(root: str) -> list[Labels]:
    """Return the labels of all shards."""
    return list(Root.open(root).labels())


@pytest.mark.parametrize("spec", [SPEC, WIDE], ids=["4", "8"])
def test_survey_counts_what_a_loop_counts(tmp_path: Path, spec: MapSpec) -> None:
    """Survey counts what a loop counts."""
    root = build_small(tmp_path / "d", spec)
    of = dataset_statistics(root)
    at = segment = 0
    for labels in all_labels(root):
        for i in range(len(labels.maps)):
            n = int(labels.maps.rooms[i])
            assert (of.index[at], of.rooms[at], of.split[at]) == (
                labels.maps.index[i],
                n,
                labels.maps.split[i],
            )
            assert of.free[at] == pytest.approx((labels.maps.occupancy[i] == 0).mean())
            matrix = labels.matrix("astar", i)
            assert of.all_connected[at] == (matrix >= 0).all()
            skipped = not labels.maps.connected[i, : n - 1].all()
            assert of.redundant[at] == ((matrix >= 0).all() and skipped)
            lengths = [len(path) for path in labels.route("astar", i)]
            assert of.lengths[segment : segment + n - 1].tolist() == lengths
            assert of.hardest[at] == pytest.approx(
                max(0, of.hardness[segment : segment + n - 1].max())
            )
            for search in ("bfs", "astar"):
                counts = of.iterations[search][segment : segment + n - 1]
                assert counts.tolist() == labels.iterations(search, i).tolist()
            at, segment = at + 1, segment + n - 1
    assert (
        (len(of), len(of.lengths)) == (at, segment) == (60, of.root.manifests[0].total("segments"))
    )
    assert of.rooms_known


@pytest.mark.parametrize("spec", [SPEC, WIDE], ids=["4", "8"])
def test_hardness_is_that_of_the_served_problems(tmp_path: Path, spec: MapSpec) -> None:
    """Hardness is that of the served problems."""
    root = build_small(tmp_path / "d", spec)
    of, served = (
        dataset_statistics(root),
        MapDataset(root, split=None, fields=("hardness",), problems=Route(unsolvable=True)),
    )
    expected = np.array([float(served[k][0]) for k in range(len(served))])
    np.testing.assert_allclose(
        of.hardness[of.lengths != 1], expected, rtol=1e-6
    )  # problems of length 0 are left out
    assert (of.hardness[of.lengths == 1] == 1).all()


def test_distributions_leave_out_what_has_no_path(tmp_path: Path) -> None:
    """Distributions leave out what has no path."""
    of = dataset_statistics(build_small(tmp_path / "d"))
    values = of.distributions()
    assert list(values) == [
        "rooms a map",
        "free share of a map",
        "path length of a segment, cells",
        "hardness of a segment",
    ]
    assert (of.lengths == 0).any()
    assert len(values["hardness of a segment"]) == of.root.manifests[0].total("reachable")
    assert values["hardness of a segment"].min() == 1


def slow_repeats(
    grids: Bytes, split: Bytes, images: int
) -> tuple[dict[str, int], dict[tuple[str, str], int]]:
    """Compare all pairs of maps in all symmetric images."""

    def same(a: Bytes, b: Bytes) -> bool:
        turned = [np.rot90(b, k) for k in range(4)]
        every = [b] if images == 1 else [*turned, *(np.flip(one, 0) for one in turned)]
        return any(a.shape == one.shape and (a == one).all() for one in every)

    of = [[grid for grid, code in zip(grids, split, strict=True) if code == k] for k in range(3)]
    inside = {
        SPLITS[k]: sum(any(same(a, b) for b in of[k][:j]) for j, a in enumerate(of[k]))
        for k in range(3)
    }
    across = {
        (SPLITS[a], SPLITS[b]): sum(any(same(one, other) for other in of[a]) for one in of[b])
        for a, b in combinations(range(3), 2)
    }
    return inside, across


@pytest.mark.parametrize("size", [(4, 4), (3, 5), (9, 70)], ids=str)
def test_repeats_equal_those_of_all_pairs(tmp_path: Path, size: tuple[int, int]) -> None:
    """Repeats equal those of all pairs."""
    rng = np.random.default_rng(0)
    grids = (rng.random((60, *size)) < 0.15).astype(np.uint8)
    for k in range(0, 60, 6):  # a copy, a mirror image, a half turn, and a quarter turn of a square
        grids[k + 1] = grids[k]
        grids[k + 2] = grids[k][::-1]
        grids[k + 3] = grids[k][::-1, ::-1]
        if size[0] == size[1]:
            grids[k + 4] = grids[k].T[::-1]
    split = rng.integers(0, 3, 60).astype(np.uint8)
    maps = [
        ForeignMap(str(k), grid, split=int(code))
        for k, (grid, code) in enumerate(zip(grids, split, strict=True))
    ]
    import_maps(tmp_path / "d", Collection(maps), seed_points=2, shard_size=25)
    of = dataset_statistics(tmp_path / "d", repeats=True)
    assert of.symmetries == (8 if size[0] == size[1] else 4)
    for found, images in zip(of.repeats, (1, 8), strict=True):
        assert (found.inside, found.across) == slow_repeats(grids, split, images)
    assert sum(of.repeats[1].inside.values()) > sum(of.repeats[0].inside.values()) > 0
    assert not of.rooms_known


def test_generated_maps_repeat_only_where_they_are_tiny(tmp_path: Path) -> None:
    """Generated maps repeat only where they are tiny."""
    spec = MapSpec((3, 3), (2, 2), (1, 3), (1, 3), passage_width=(1, 1))
    of = dataset_statistics(build_small(tmp_path / "d", spec, maps=200), repeats=True)
    grids = generate(spec, 5, range(200)).occupancy
    distinct = {
        name: len({grid.tobytes() for grid in grids[of.split == k]})
        for k, name in enumerate(SPLITS)
    }
    assert of.repeats[0].inside == {
        name: int((of.split == k).sum()) - distinct[name] for k, name in enumerate(SPLITS)
    }


def test_repeats_are_counted_on_request_only(tmp_path: Path) -> None:
    """Repeats are counted on request only."""
    of = dataset_statistics(build_small(tmp_path / "d", maps=3))
    with pytest.raises(ValueError, match="repeats=True"):
        _ = of.repeats


def test_read_map_finds_the_shard(tmp_path: Path) -> None:
    """Read map finds the shard."""
    root = build_small(tmp_path / "d")
    expected = generate(SPEC, 5, [37]).occupancy[0]
    labels, i = Root.open(root).map(37)
    assert (labels.maps.occupancy[i] == expected).all()
    for index in (-1, 60):
        with pytest.raises(ValueError, match=f"got {index}, .* holds maps 0 to 59"):
            Root.open(root).map(index)


def test_a_missing_or_cut_shard_is_named(tmp_path: Path) -> None:
    """A missing or cut shard is named."""
    root = build_small(tmp_path / "d")
    path = Path(root) / read_manifest(Path(root)).shards[1].name
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(ShardError, match=path.name):
        dataset_statistics(root)
    path.unlink()
    with pytest.raises(ShardError, match=f"{path.name}: missing"):
        dataset_statistics(root)


@pytest.mark.parametrize(
    "values",
    [[], [3.0], [2.0, 2.0, 9.0], [0.5], [0.25, 0.25, 0.75], list(range(1000)), [1.0, 1e6]],
    ids=["none", "one", "integers", "half", "shares", "many", "far"],
)
def test_histogram_counts_every_value(values: list[float]) -> None:
    """Histogram counts every value."""
    edges, counts = histogram(np.array(values, np.float64))
    assert counts.sum() == len(values)
    assert len(edges) == len(counts) + 1 <= 32
    assert (np.diff(edges) > 0).all()


def test_an_empty_survey_holds_nothing(tmp_path: Path) -> None:
    """An empty survey holds nothing."""
    root = Path(build_small(tmp_path / "d", maps=3))
    manifest = read_manifest(root)
    (root / "manifest.json").write_text(replace(manifest, shards=()).to_json())
    of: DatasetStatistics = dataset_statistics(root, repeats=True)
    assert len(of) == 0
    assert of.repeats[1].inside == dict.fromkeys(SPLITS, 0)
