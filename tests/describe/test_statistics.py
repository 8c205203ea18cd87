"""Statistics equal slow counting; repeated maps are found in all their symmetric images."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from helpers import reference
from helpers.samples import SPEC, WIDE, build_small
from helpers.terrain_maps import imported_header, random_terrain_maps

from mapdata import (
    Labels,
    MapDataset,
    MapSpec,
    Movement,
    Route,
    ShardError,
    Terrain,
    build,
    generate,
)
from mapdata.arrays import Bytes
from mapdata.describe import dataset_statistics
from mapdata.describe.statistics import Repeats, bin_edges
from mapdata.formats import Collection, ForeignMap, import_maps
from mapdata.limits import SPLITS
from mapdata.search.labels import label
from mapdata.shards import MANIFEST, Manifest, Root, read_manifest
from mapdata.shards.image import shard_image
from mapdata.shards.manifest import entry_of


def all_labels(root: str) -> list[Labels]:
    """Return the labels of all shards."""
    return list(Root.open(root).labels())


@pytest.mark.parametrize("generator", [SPEC, WIDE], ids=["4", "8"])
def test_statistics_count_what_a_loop_counts(tmp_path: Path, generator: MapSpec) -> None:
    """Every value of a map and of a segment is that of a loop over the labels."""
    root = build_small(tmp_path / "d", generator)
    statistics = dataset_statistics(root)
    at = 0  # the map among all maps
    first = 0  # its first segment among all segments
    for labels in all_labels(root):
        maps = labels.maps
        for i in range(len(maps)):
            n = int(maps.rooms[i])
            assert statistics.index[at] == maps.index[i]
            assert statistics.rooms[at] == n
            assert statistics.split[at] == maps.split[i]
            assert statistics.free[at] == pytest.approx((maps.occupancy[i] == 0).mean())
            all_connected = bool((labels.matrix("astar", i) >= 0).all())
            assert statistics.all_connected[at] == all_connected
            all_drawn = bool(maps.connected[i, : n - 1].all())
            assert statistics.redundant[at] == (all_connected and not all_drawn)
            segments = slice(first, first + n - 1)
            lengths = [len(path) for path in labels.route("astar", i)]
            assert statistics.lengths[segments].tolist() == lengths
            assert statistics.hardest[at] == pytest.approx(
                max(0, statistics.hardness[segments].max())
            )
            for search in ("bfs", "astar"):
                counts = statistics.iterations[search][segments]
                assert counts.tolist() == labels.iterations(search, i).tolist()
            at += 1
            first += n - 1
    assert len(statistics) == at == 60
    assert len(statistics.lengths) == first == statistics.root.manifests[0].total("segments")
    assert statistics.rooms_known


@pytest.mark.parametrize("generator", [SPEC, WIDE], ids=["4", "8"])
def test_hardness_is_that_of_the_served_problems(tmp_path: Path, generator: MapSpec) -> None:
    """Hardness is that of the problems that `MapDataset` serves."""
    root = build_small(tmp_path / "d", generator)
    statistics = dataset_statistics(root)
    problems = Route(unsolvable=True)
    served = MapDataset(root, split=None, fields=("hardness",), problems=problems)
    expected = np.array([float(served[k][0]) for k in range(len(served))])
    # problems from a cell to itself are not served
    np.testing.assert_allclose(statistics.hardness[statistics.lengths != 1], expected, rtol=1e-6)
    assert (statistics.hardness[statistics.lengths == 1] == 1).all()


def test_distributions_leave_out_what_has_no_path(tmp_path: Path) -> None:
    """Lengths and hardness are those of segments with a path; the names are those of the card."""
    statistics = dataset_statistics(build_small(tmp_path / "d"))
    values = statistics.distributions()
    assert list(values) == [
        "rooms a map",
        "free share of a map",
        "path length of a segment, cells",
        "hardness of a segment",
    ]
    assert (statistics.lengths == 0).any()
    assert len(values["hardness of a segment"]) == statistics.root.manifests[0].total("reachable")
    assert values["hardness of a segment"].min() == 1


@pytest.mark.parametrize("movement", [Movement(), Movement(8), Movement(8, diagonal_cost=1)])
def test_statistics_of_terrain_count_what_a_loop_counts(tmp_path: Path, movement: Movement) -> None:
    """Costs, hardness and cells of each cost are those of plain Python."""
    generator = Terrain((12, 15), seed_points=3, obstacles=0.2, movement=movement)
    build(tmp_path / "d", generator, maps=6, seed=2, shard_size=4, workers=1)
    statistics = dataset_statistics(tmp_path / "d")
    costs = []
    hardness = []
    for labels in all_labels(str(tmp_path / "d")):
        terrains = labels.maps.terrain
        assert terrains is not None
        for i, terrain in enumerate(terrains.tolist()):
            smallest = min(cost for row in terrain for cost in row if cost > 0)
            for q, path in enumerate(labels.route("astar", i)):
                cells = [(row, column) for row, column in path.tolist()]
                cost = reference.path_cost(cells, movement, terrain)
                steps = reference.heuristic(cells[0], cells[-1], movement)
                lower_bound = smallest * reference.as_float(steps, movement)
                costs.append(cost)
                hardness.append(cost / lower_bound if lower_bound else 1.0)
                assert labels.matrix("astar", i)[q, q + 1] == cost
    assert statistics.costs.tolist() == costs
    np.testing.assert_allclose(statistics.hardness, hardness, rtol=1e-12)
    terrain = np.concatenate([labels.maps.terrain for labels in all_labels(str(tmp_path / "d"))])
    assert statistics.cell_counts is not None
    assert statistics.cell_counts.tolist() == [(terrain == cost).sum() for cost in range(256)]
    assert list(statistics.distributions())[-1] == "cost of a segment"


def test_repeated_terrain_is_counted_by_its_costs(tmp_path: Path) -> None:
    """Maps without obstacles differ by their costs; a mirrored map is a symmetric copy."""
    maps = random_terrain_maps(1, (6, 6), 5, Movement(8))
    assert maps.terrain is not None
    terrain = np.maximum(maps.terrain, 1)
    terrain[1] = terrain[0]
    terrain[2] = terrain[0][:, ::-1]
    terrain[4] = 1  # the smallest cost of all maps
    free = replace(
        maps, terrain=terrain, packed=np.zeros_like(maps.packed), split=np.zeros_like(maps.split)
    )
    header = imported_header(free)
    labels = label(free)
    image, content = shard_image(labels, header)
    (tmp_path / header.file_name).write_bytes(image)
    manifest = Manifest(**header.origin(), maps=5, shard_size=5)
    entry = entry_of(header, content, labels, image)
    (tmp_path / MANIFEST).write_text(replace(manifest, shards=(entry,)).to_json(), encoding="utf-8")
    exact, symmetric = dataset_statistics(tmp_path, repeats=True).repeats
    assert (exact.inside["train"], symmetric.inside["train"]) == (1, 2)


def are_same(a: Bytes, b: Bytes, *, symmetric: bool) -> bool:
    """Return whether two grids are equal, or if ``symmetric``, equal after a turn or a flip."""
    images = [b]
    if symmetric:
        turned = [np.rot90(b, k) for k in range(4)]
        images = [*turned, *(np.flip(turned_grid, 0) for turned_grid in turned)]
    return any(np.array_equal(a, image) for image in images)


def slow_repeats(grids: Bytes, split: Bytes, *, symmetric: bool) -> Repeats:
    """Compare all pairs of maps."""

    def is_in(grid: Bytes, candidates: list[Bytes]) -> bool:
        return any(are_same(grid, candidate, symmetric=symmetric) for candidate in candidates)

    grids_by_split = {name: list(grids[split == code]) for code, name in enumerate(SPLITS)}
    inside = {}
    for name, own in grids_by_split.items():
        inside[name] = sum(is_in(grid, own[:k]) for k, grid in enumerate(own))
    across = {}
    for a, b in combinations(SPLITS, 2):
        across[a, b] = sum(is_in(grid, grids_by_split[a]) for grid in grids_by_split[b])
    return Repeats(inside, across)


@pytest.mark.parametrize("size", [(4, 4), (3, 5), (9, 70)], ids=str)
def test_repeats_equal_those_of_all_pairs(tmp_path: Path, size: tuple[int, int]) -> None:
    """Repeats equal those of all pairs."""
    rng = np.random.default_rng(0)
    grids = (rng.random((60, *size)) < 0.15).astype(np.uint8)
    is_square = size[0] == size[1]
    for k in range(0, 60, 6):
        grids[k + 1] = grids[k]
        grids[k + 2] = grids[k][::-1]  # a mirror image
        grids[k + 3] = grids[k][::-1, ::-1]  # a half turn
        if is_square:
            grids[k + 4] = grids[k].T[::-1]  # a quarter turn
    split = rng.integers(0, 3, 60).astype(np.uint8)
    maps = [
        ForeignMap(str(k), grid, split=int(code))
        for k, (grid, code) in enumerate(zip(grids, split, strict=True))
    ]
    import_maps(tmp_path / "d", Collection(maps), seed_points=2, shard_size=25)
    statistics = dataset_statistics(tmp_path / "d", repeats=True)
    assert statistics.symmetries == (8 if is_square else 4)
    for repeats, symmetric in zip(statistics.repeats, (False, True), strict=True):
        expected = slow_repeats(grids, split, symmetric=symmetric)
        assert repeats.inside == expected.inside
        assert repeats.across == expected.across
    exact, symmetric_repeats = statistics.repeats
    assert sum(symmetric_repeats.inside.values()) > sum(exact.inside.values()) > 0
    assert not statistics.rooms_known


def test_generated_maps_repeat_only_where_they_are_tiny(tmp_path: Path) -> None:
    """Of maps of nine cells some repeat: as many as a set of them is smaller."""
    generator = MapSpec((3, 3), (2, 2), (1, 3), (1, 3), passage_width=(1, 1))
    statistics = dataset_statistics(build_small(tmp_path / "d", generator, maps=200), repeats=True)
    grids = generate(generator, 5, range(200)).occupancy
    for code, name in enumerate(SPLITS):
        texts = [grid.tobytes() for grid in grids[statistics.split == code]]
        assert statistics.repeats[0].inside[name] == len(texts) - len(set(texts))


def test_repeats_are_counted_on_request_only(tmp_path: Path) -> None:
    """Without ``repeats=True`` there is an error that names it."""
    statistics = dataset_statistics(build_small(tmp_path / "d", maps=3))
    with pytest.raises(ValueError, match="repeats=True"):
        _ = statistics.repeats


def test_read_map_finds_the_shard(tmp_path: Path) -> None:
    """`Root.map` finds the shard of a map, and refuses numbers that the dataset does not have."""
    root = build_small(tmp_path / "d")
    expected = generate(SPEC, 5, [37]).occupancy[0]
    labels, i = Root.open(root).locate(37)
    assert (labels.maps.occupancy[i] == expected).all()
    for index in (-1, 60):
        with pytest.raises(ValueError, match=f"got {index}, .* holds maps 0 to 59"):
            Root.open(root).locate(index)


def test_a_missing_or_cut_shard_is_named(tmp_path: Path) -> None:
    """The error names the shard, and says that it is missing where it is."""
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
    [
        [],
        [3.0],
        [2.0, 2.0, 9.0],
        [0.5],
        [0.25, 0.25, 0.75],
        list(range(32)),
        list(range(1000)),
        [1.0, 1e6],
    ],
    ids=["none", "one", "integers", "half", "shares", "some", "many", "far"],
)
def test_histogram_counts_every_value(values: list[float]) -> None:
    """No value lies outside the edges, and there are at most 31 bins."""
    edges = bin_edges(np.array(values, np.float64))
    counts, _ = np.histogram(values, edges)
    assert counts.sum() == len(values)
    assert len(edges) == len(counts) + 1 <= 32
    assert (np.diff(edges) > 0).all()


def test_a_dataset_without_shards_has_no_statistics(tmp_path: Path) -> None:
    """The error says that no map is there yet."""
    root = Path(build_small(tmp_path / "d", maps=3))
    manifest = read_manifest(root)
    (root / "manifest.json").write_text(replace(manifest, shards=()).to_json())
    with pytest.raises(ValueError, match="holds none of its 3 maps yet"):
        dataset_statistics(root, repeats=True)
