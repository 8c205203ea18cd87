"""Imported grids: drawn seed points, one dataset per size, and a root that only goes on."""

from __future__ import annotations

import json
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from helpers import reference
from helpers.examples import slow
from helpers.grids import random_grids
from helpers.imported import collection
from helpers.wild import cli
from scipy import ndimage

from mapdata import (
    Labels,
    MapDataModule,
    MapDataset,
    Maps,
    ProblemSet,
    ShardError,
    build,
    label,
    read_shard,
    repair,
    verify,
)
from mapdata.describe import card, dataset_statistics
from mapdata.formats import Collection, ForeignMap, import_maps
from mapdata.formats.importing import divided_splits
from mapdata.generators.points import largest_component
from mapdata.limits import SPLITS
from mapdata.movement import Movement
from mapdata.shards import MANIFEST, PROVENANCE, Root, read_manifest

Bytes = npt.NDArray[np.uint8]
POINTS = 5


def test_a_dataset_of_grids(tmp_path: Path) -> None:
    """Seeds and splits are the draws of streams 5 and 2; rooms unknown; verify, MapDataset and the
    recipe's absence.
    """
    grids = random_grids(7)
    (made,) = import_maps(
        tmp_path / "out", collection(*grids), seed_points=4, seed=2**63 + 1, shard_size=3
    )
    assert verify(made.root) == []
    assert made.manifest.identity is None
    with pytest.raises(ValueError, match="no recipe"):
        made.manifest.recipe()
    expected_splits = reference.divided_splits(2**63 + 1, range(7), (0.8, 0.1, 0.1))
    splits = []
    for entry in made.manifest.shards:
        maps = read_shard(made.root / entry.name).maps
        splits += [SPLITS[code] for code in maps.split]
        for k, i in enumerate(maps.index.tolist()):
            assert np.array_equal(maps.occupancy[k], grids[i])
            cells = largest_component(grids[i], 0).tolist()
            seed_points = []
            for draw in range(4):
                word = reference.block(2**63 + 1, i, 0, POINTS, draw)[0]
                seed_points.append(list(divmod(cells.pop(word * len(cells) >> 32), 70)))
            assert maps.seed_points[k].tolist() == seed_points
            assert maps.split[k] == expected_splits[i]
        assert (maps.sizes == -1).all()
        assert (maps.directions == -1).all()
        assert (maps.passage_width == -1).all()
    for problems, count in (("route", 21), ("pairs", 42), ("random", 7)):
        dataset = MapDataset(made.root, problems=problems)
        assert len(dataset) == count
        assert dataset[0].map.shape == (1, 12, 70)
    origin = json.loads((made.root / "import.json").read_text())
    assert len(origin.pop("hash")) == 64
    counts = {"all": 7, **{split: splits.count(split) for split in SPLITS}}
    assert origin == {
        "free": pytest.approx(1 - np.mean(grids)),
        "distinct": counts,
        "distinct_up_to_symmetry": counts,
        "seeds": 4,
        "seed": 2**63 + 1,
        "resolution_assumed": True,
        "sources": [f"g{k}" for k in range(7)],
    }


def test_the_content_of_an_import_is_the_golden_one(tmp_path: Path) -> None:
    """Draws, labels and layout are the same in every version."""
    rows, columns = np.indices((9, 33))
    grids = [np.asarray((rows * (k + 3) + columns * 5) % 7 == 0, np.uint8) for k in range(3)]
    (dataset,) = import_maps(
        tmp_path / "out", collection(*grids), seed_points=3, seed=11, movement=Movement(8)
    )
    assert dataset.manifest.content_hash == GOLDEN


GOLDEN = "c59b4fc7739def46dd4178e26c9fb987247ed352c62f6c0f5206307f9ef168e7"


def test_seed_points_of_the_source_come_first(tmp_path: Path) -> None:
    """Maps with fewer free cells than asked for have fewer seed points, or are left out."""
    two: Bytes = np.array([[0, 0, 1, 0]], np.uint8)
    source = collection(two, np.ones((1, 4), np.uint8), np.array([[0, 1, 0, 1]], np.uint8))
    source.maps.append(ForeignMap("given", two, seed_points=np.array([[0, 3]])))
    (dataset,) = import_maps(tmp_path / "out", source, seed_points=5)
    maps = read_shard(dataset.root / dataset.manifest.shards[0].name).maps
    assert maps.rooms.tolist() == [2, 3]
    assert maps.seed_points[1, 0].tolist() == [0, 3]
    assert [name for name, _ in source.left_out] == ["g1", "g2"]


@pytest.mark.parametrize(
    ("seed_points", "why"),
    [
        ([[0, 9]], "outside the map"),
        ([[-1, 0]], "outside the map"),
        ([[0, 2]], "on an occupied cell"),
        ([], "0 rooms"),
    ],
)
def test_maps_with_bad_seed_points_are_left_out(
    seed_points: list[list[int]], why: str, tmp_path: Path
) -> None:
    """The reason is noted."""
    grid: Bytes = np.array([[0, 0, 1]], np.uint8)
    bad = ForeignMap(
        "bad", grid, seed_points=np.array(seed_points, np.int64).reshape(-1, 2), rooms_known=True
    )
    source = Collection([bad, ForeignMap("good", grid)])
    import_maps(tmp_path / "out", source)
    assert source.left_out[0][0] == "bad"
    assert why in source.left_out[0][1]


def test_each_size_and_resolution_becomes_a_dataset(tmp_path: Path) -> None:
    """With a given resolution or tiles the maps form one dataset."""
    source = collection(*random_grids(2, 8, 8), *random_grids(1, 16, 9))
    source.maps.append(ForeignMap("fine", random_grids(1, 8, 8)[0], resolution=0.05))
    datasets = import_maps(tmp_path / "a", source)
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == [
        "16x9",
        "8x8-0.05m",
        "8x8-0.1m",
    ]
    assert [dataset.manifest.maps for dataset in datasets] == [2, 1, 1]
    assert len(import_maps(tmp_path / "b", source, resolution=0.2)) == 2
    (tiled,) = import_maps(tmp_path / "c", source, resolution=0.2, tile=(8, 8))
    assert (tiled.root, tiled.manifest.maps, tiled.manifest.map_size) == (tmp_path / "c", 5, (8, 8))
    with pytest.raises(ValueError, match=r"tile: got \(0, 8\)"):
        import_maps(tmp_path / "d", source, tile=(0, 8))


def test_a_note_says_what_tiles_do_to_free_space(tmp_path: Path) -> None:
    """It counts components as scipy does, and the free cells that are dropped at the edges."""
    grid = random_grids(1, 20, 30)[0]
    grid[:, :10] = 0
    source = collection(grid)
    import_maps(tmp_path / "out", source, tile=(8, 9))
    tiles = [
        grid[top : top + 8, left : left + 9] for top in range(0, 16, 8) for left in range(0, 27, 9)
    ]

    def components(cells: Bytes) -> int:
        labels, _ = ndimage.label(cells == 0)
        return int((np.bincount(labels.ravel())[1:] >= 16).sum())

    lost = 1 - sum((tile == 0).sum() for tile in tiles) / (grid == 0).sum()
    assert 0.2 < lost < 0.4
    assert (
        f"cut into tiles of 8 x 9 cells: components of at least 16 free cells: {components(grid)} "
        f"before, {sum(map(components, tiles))} after; {lost:.1%} of the free area was lost; "
        "another --tile drops less at the edges"
    ) in source.notes
    whole = collection(grid)
    import_maps(tmp_path / "whole", whole, tile=(20, 30))
    assert not any("components" in note for note in whole.notes)


def test_an_import_can_be_completed(tmp_path: Path) -> None:
    """A second import changes nothing and writes lost shards again; another import is refused."""
    grids = random_grids(5)
    (dataset,) = import_maps(tmp_path / "out", collection(*grids), shard_size=2)
    before = {
        path.name: (path.read_bytes(), path.stat().st_mtime_ns)
        for path in dataset.root.glob("*.h5")
    }
    import_maps(tmp_path / "out", collection(*grids), shard_size=2)
    assert {
        path.name: (path.read_bytes(), path.stat().st_mtime_ns)
        for path in dataset.root.glob("*.h5")
    } == before
    next(iter(dataset.root.glob("*.h5"))).unlink()
    import_maps(tmp_path / "out", collection(*grids), shard_size=2)
    assert {path.name: path.read_bytes() for path in dataset.root.glob("*.h5")} == {
        n: d for n, (d, _) in before.items()
    }
    assert verify(dataset.root) == []
    for source, options in (
        (collection(*grids), {"shard_size": 3}),
        (collection(*grids), {"shard_size": 2, "seed": 1}),
        (collection(*(1 - grid for grid in grids)), {"shard_size": 2}),
    ):
        with pytest.raises(ValueError, match="holds another dataset"):
            import_maps(tmp_path / "out", source, **options)  # type: ignore[arg-type]
    assert verify(dataset.root) == []
    assert read_manifest(dataset.root).content_hash == dataset.manifest.content_hash


def test_two_imports_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """While an import writes, another one is refused in one line and removes no file."""
    begun, go_on = threading.Event(), threading.Event()

    def slow_label(maps: Maps) -> Labels:
        begun.set()
        assert go_on.wait(60)
        return label(maps)

    monkeypatch.setattr("mapdata.formats.importing.label", slow_label)
    root = tmp_path / "maps"
    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(import_maps, root, collection(*random_grids(5)), shard_size=2)
        assert begun.wait(60)
        with pytest.raises(ValueError, match=f"root: another process writes to {root}; wait"):
            import_maps(root, collection(*random_grids(10)[5:]), shard_size=2)
        go_on.set()
        (dataset,) = first.result()
    assert verify(root) == []
    assert read_manifest(root) == dataset.manifest
    with pytest.raises(ValueError, match="holds another dataset"):
        import_maps(root, collection(*random_grids(10)[5:]), shard_size=2)
    assert verify(root) == []


def test_imports_sweep(tmp_path: Path) -> None:
    """Temporary files of a killed import are removed by the next one."""
    import_maps(tmp_path, collection(*random_grids(5)), shard_size=2)
    for name in (MANIFEST, PROVENANCE, "maps-000000000000-000000000002.h5"):
        (tmp_path / f".{name}.1234.tmp").touch()
    import_maps(tmp_path, collection(*random_grids(5)), shard_size=2)
    assert list(tmp_path.glob("*.tmp")) == []
    assert verify(tmp_path) == []


def test_an_import_into_a_url_is_refused() -> None:
    """It is refused before anything is written."""
    with pytest.raises(ValueError, match="root: http://host/maps is a URL"):
        import_maps("http://host/maps", collection(*random_grids(5)))


def test_an_import_follows_no_link_out_of_the_root(tmp_path: Path) -> None:
    """A shard that is a link to another folder is refused by name, and the target of the link
    stays.
    """
    root = tmp_path / "maps"
    import_maps(root, collection(*random_grids(5)), shard_size=2)
    shard = root / "maps-000000000002-000000000004.h5"
    shard.rename(tmp_path / shard.name)
    shard.symlink_to(tmp_path / shard.name)
    with pytest.raises(ShardError, match=f"{shard}: a link out of its folder"):
        import_maps(root, collection(*random_grids(5)), shard_size=2)
    assert (tmp_path / shard.name).is_file()


def test_a_root_with_other_files_is_refused(tmp_path: Path) -> None:
    """A folder with other files, or a file, is refused before anything is written."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("x")
    for root in (tmp_path / "mine", tmp_path / "mine" / "thesis.tex"):
        with pytest.raises(ValueError, match=r"holds something else|is a file"):
            import_maps(root, collection(*random_grids(1)))
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    "options",
    [
        {"seed_points": 1},
        {"seed_points": 256},
        {"seed_points": True},
        {"seed": -1},
        {"splits": (1, 1, 1)},
        {"shard_size": 0},
        {"resolution": 0.0},
        {"resolution": float("nan")},
    ],
)
def test_bad_arguments_are_named_before_anything_is_written(
    options: dict[str, object], tmp_path: Path
) -> None:
    """The error names the argument, and the root is not created."""
    with pytest.raises(ValueError, match=next(iter(options))):
        import_maps(tmp_path / "out", collection(*random_grids(1)), **options)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="no map to import"):
        import_maps(tmp_path / "out", Collection())
    assert list(tmp_path.iterdir()) == []


def test_a_map_with_a_bad_resolution_is_left_out(tmp_path: Path) -> None:
    """It is left out by name; numbers of numpy are accepted."""
    values: list[Any] = [-1, float("nan"), "0.1", np.float32(0.25), np.int64(1)]
    grids = random_grids(len(values))
    maps = [
        ForeignMap(str(value), grid, resolution=value)
        for value, grid in zip(values, grids, strict=True)
    ]
    source = Collection(maps)
    datasets = import_maps(tmp_path / "out", source)
    assert sorted(each.manifest.resolution for each in datasets) == [0.25, 1.0]
    assert [name for name, _ in source.left_out] == ["-1", "nan", "0.1"]
    (dataset,) = import_maps(tmp_path / "all", Collection(maps), resolution=np.float64(0.5))
    assert dataset.manifest.resolution == 0.5


def test_numbers_of_the_source_give_the_order_of_the_maps(tmp_path: Path) -> None:
    """This holds for the numbers 0 to N - 1; other numbers are dropped with a note."""
    grids = random_grids(3)
    source = Collection([ForeignMap("x", grid, number=2 - k) for k, grid in enumerate(grids)])
    (dataset,) = import_maps(tmp_path / "a", source)
    maps = read_shard(dataset.root / dataset.manifest.shards[0].name).maps
    assert all(np.array_equal(maps.occupancy[k], grids[2 - k]) for k in range(3))
    source = Collection([ForeignMap("x", grid, number=5 + k) for k, grid in enumerate(grids)])
    import_maps(tmp_path / "b", source)
    assert "numbered anew" in source.notes[0]


def test_maps_are_kept_as_bits() -> None:
    """100,000 maps of 512 x 512 cells take 3.3 GB instead of 26; arrays that are no grid are
    refused.
    """
    grid = random_grids(1, 5, 13)[0]
    one = ForeignMap("x", grid)
    assert one.grid.tolist() == grid.tolist()
    assert (one.shape, one._bits.nbytes) == ((5, 13), 5 * 2)
    for bad in (grid[0], 255 * grid, -grid.astype(np.int8), grid / 2):
        with pytest.raises(ValueError, match="cells: x: got"):
            ForeignMap("x", bad)
    assert ForeignMap("x", grid.astype(float)).grid.tolist() == grid.tolist()


@pytest.mark.parametrize("split", [3, -1, "train", 1.7])
def test_an_unknown_split_is_refused(split: object) -> None:
    """A dataset with an unknown code of a split could not be read."""
    with pytest.raises(ValueError, match=f"split: x: got {split!r}, expected 0, 1, 2 or None"):
        ForeignMap("x", np.zeros((3, 3), np.uint8), split=split)  # type: ignore[arg-type]


@pytest.mark.parametrize(("size", "count"), [slow((512, 512), 64), ((4096, 700), 5)])
def test_a_repaired_manifest_is_that_of_the_import(
    size: tuple[int, int], count: int, tmp_path: Path
) -> None:
    """One whole shard, of the size that an import takes of large maps: the same import goes on.

    Only a corner of each map is free, so that its labels take no time.
    """
    grids = np.ones((count, *size), np.uint8)
    grids[:, :4, :10] = 0
    grids[:, 0, 0] = 1
    grids[np.arange(count), 1, np.arange(count) % 8] = 1
    (dataset,) = import_maps(tmp_path / "out", collection(*grids), seed_points=2)
    assert len(dataset.manifest.shards) == 1
    text = (dataset.root / MANIFEST).read_bytes()
    (dataset.root / MANIFEST).unlink()
    repair(dataset.root)
    assert (dataset.root / MANIFEST).read_bytes() == text
    import_maps(tmp_path / "out", collection(*grids), seed_points=2)


def test_readers_refuse_an_import_without_shards(tmp_path: Path) -> None:
    """The dataset, problems and figures refuse it, as they refuse a build that has not begun."""
    (made,) = import_maps(tmp_path / "out", collection(*random_grids(5)), shard_size=2)
    (made.root / MANIFEST).write_text(replace(made.manifest, shards=()).to_json())
    says = r"holds none of its 5 maps yet: no shard is finished\. .*run the command that makes it"
    with pytest.raises(ValueError, match=says):
        MapDataset(made.root)
    with pytest.raises(ValueError, match=says):
        ProblemSet.read(made.root, movement=Movement(8))
    with pytest.raises(ValueError, match=says):
        dataset_statistics(made.root)
    with pytest.raises(ValueError, match=says):
        Root.open(made.root).locate(3)


def test_a_map_with_costs_that_are_too_high_is_named_as_in_its_source(tmp_path: Path) -> None:
    """Its number in the dataset would say nothing to the user."""
    corridor = np.full((3, 2100), 255, np.uint8)
    corridor[1, :-1] = 0  # so that the path from row 0 to row 2 has 4,201 cells
    source = Collection(movement=Movement(8))
    for name, terrain in (("low", np.where(corridor == 255, 1, 0)), ("high", corridor)):
        source.maps.append(
            ForeignMap(
                name,
                (terrain == 0).astype(np.uint8),
                seed_points=np.array([[0, 0], [2, 0]]),
                rooms_known=True,
                terrain=terrain.astype(np.uint8),
            )
        )
    with pytest.raises(
        ValueError, match=r"^high: terrain: a path costs 1,0.*, and costs are exact"
    ):
        import_maps(tmp_path / "out", source)


@pytest.mark.parametrize(
    "splits", [(0.8, 0.1, 0.1), (0.5, 0.25, 0.25), (0.7, 0.3, 0.0), (0.0, 0.02, 0.98), (0, 0, 1)]
)
def test_maps_are_divided_by_the_rule_of_the_page(splits: tuple[float, float, float]) -> None:
    """Maps of other splits stand between them; the numbers of all maps key the random numbers."""
    free = np.zeros((1, 2), np.uint8)
    for count in (*range(13), 40, 101):
        stated = {k: k % 3 for k in range(count) if k % 4 == 1}
        maps = [ForeignMap(f"g{k}", free, stated.get(k)) for k in range(count)]
        unstated = [k for k in range(count) if k not in stated]
        expected = {**stated, **reference.divided_splits(SEED, unstated, splits)}
        found = divided_splits(maps, SEED, splits)
        assert found.tolist() == [expected[k] for k in range(count)]
        if len(unstated) >= 3:
            given = {int(found[k]) for k in unstated}
            assert given == {code for code in range(3) if splits[code] > 0}


SEED = 2**63 + 1


def test_copies_count_one_by_one_and_the_dropped_ones_leave_the_splits_as_they_are(
    tmp_path: Path,
) -> None:
    """Three copies of a map and two others: the copies are divided as other maps are."""
    one, two, three = random_grids(3)
    grids = (one, two, one, three, one)
    (kept,) = import_maps(tmp_path / "all", collection(*grids), seed=3)
    codes = reference.divided_splits(3, range(5), (0.8, 0.1, 0.1))
    maps = read_shard(kept.root / kept.manifest.shards[0].name).maps
    assert maps.split.tolist() == [codes[k] for k in range(5)]
    (separated,) = import_maps(tmp_path / "separated", collection(*grids), seed=3, drop_leaks=True)
    latest = max(codes[k] for k in (0, 2, 4))
    expected = [codes[k] for k in range(5) if k in (1, 3) or codes[k] == latest]
    maps = read_shard(separated.root / separated.manifest.shards[0].name).maps
    assert maps.split.tolist() == expected


def test_a_split_without_a_map_is_noted(tmp_path: Path) -> None:
    """Maps whose source says the split, and splits that should be empty, need no note."""
    grids = [np.zeros((3, 3 + k), np.uint8) for k in range(1)]
    source = collection(*grids)
    import_maps(tmp_path / "one", source, seed_points=2)
    (note,) = [note for note in source.notes if note.startswith("no map is in")]
    assert "no map is in val and test: 1 map is too few to divide; three maps" in note
    quiet = collection(*grids)
    import_maps(tmp_path / "all", quiet, seed_points=2, splits=(1, 0, 0))
    divided = Collection([ForeignMap("a", grids[0], 0)])
    import_maps(tmp_path / "own", divided, seed_points=2)
    assert not any("no map is in" in note for note in (*quiet.notes, *divided.notes))


def test_many_maps_left_out_are_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The first 10 are named."""
    grid = np.ones((4, 60), np.uint8)
    grid[:, :4] = 0
    np.save(tmp_path / "wide.npy", grid)
    arguments = ("import", tmp_path / "wide.npy", tmp_path / "out", "--tile", "4x4")
    code, _, err = cli(capsys, *arguments, "--seed-points", 2)
    assert code == 0
    assert err.count("has no two connected free cells") == 10
    assert "left out: 4 more, 14 in all" in err


def test_what_identifies_imported_maps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One content hash at two resolutions, though a robot fits elsewhere; info and card say so."""
    grid = np.zeros((9, 9), np.uint8)
    grid[4, :4] = grid[4, 5:] = 1  # a door of one cell
    cells = np.array([[2, 2], [2, 6], [6, 2]])
    roots = [tmp_path / "fine", tmp_path / "coarse"]
    for root, resolution in zip(roots, (0.5, 1.0), strict=True):
        source = collection(grid, seed_points=cells, rooms_known=True)
        import_maps(root, source, resolution=resolution)
    fine, coarse = (read_manifest(root) for root in roots)
    assert fine.content_hash == coarse.content_hash
    reached = [len(MapDataset(root, problems="pairs", radius=0.3)) for root in roots]
    assert reached == [1, 3]
    for root, metres in zip(roots, ("0.5 m per cell", "1 m per cell"), strict=True):
        _, info, _ = cli(capsys, "info", root)
        for said in (metres, fine.content_hash, "4-connected", "resolution and movement identify"):
            assert said in info
            assert said in card(root)


def test_a_file_in_place_of_a_collection_is_refused(tmp_path: Path) -> None:
    """The error names the function that reads it."""
    with pytest.raises(TypeError, match=r"source: got str, expected a Collection: .*read_any"):
        import_maps(tmp_path / "out", "map.yaml")  # type: ignore[arg-type]


def test_imported_maps_are_not_built_again(tmp_path: Path) -> None:
    """No recipe makes more of them; a data module reads them without ``build``."""
    import_maps(tmp_path / "maps", collection(np.zeros((9, 9), np.uint8)))
    for make in (build, lambda root, recipe: MapDataModule(root, build=recipe).prepare_data()):
        with pytest.raises(
            ValueError, match=r"holds maps that were imported, .* leave out the rec"
        ):
            make(tmp_path / "maps", "dungeon")


def test_a_resolution_that_is_stated_is_not_called_assumed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the user or the source; the card says which of its facts was assumed."""
    np.save(tmp_path / "a.npy", np.zeros((4, 5), np.uint8))
    assumed = "The source states no resolution; it was assumed."
    cli(capsys, "import", tmp_path / "a.npy", tmp_path / "bare")
    assert assumed in card(tmp_path / "bare")
    _, out, _ = cli(capsys, "import", tmp_path / "a.npy", tmp_path / "out", "--resolution", 0.1)
    assert "resolution:           0.1 m per cell\n" in out
    assert assumed not in card(tmp_path / "out")
    source = collection(np.zeros((4, 5), np.uint8), resolution=0.1)
    (dataset,) = import_maps(tmp_path / "stated", source)
    assert assumed not in card(dataset.root)


def test_an_import_of_several_sizes_prints_a_line_for_each(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The datasets are many, and a summary of each would hide what the import says of all."""
    (tmp_path / "in").mkdir()
    for k in range(3):
        np.save(tmp_path / "in" / f"{k}.npy", np.zeros((k + 1, 4, 5 + k), np.uint8))
    code, out, _ = cli(capsys, "import", tmp_path / "in", tmp_path / "out")
    assert code == 0
    lines = [line for line in out.splitlines() if not line.startswith("note:")]
    assumed = "0.1 m per cell assumed; import with --resolution to state it"
    assert lines == [
        f"{tmp_path}/out/4x5: 1 map of 4 x 5 cells, {assumed}; train 1, val 0, test 0",
        f"{tmp_path}/out/4x6: 2 maps of 4 x 6 cells, {assumed}; train 2, val 0, test 0",
        f"{tmp_path}/out/4x7: 3 maps of 4 x 7 cells, {assumed}; train 1, val 1, test 1",
        "3 datasets, one for each size and resolution: 'mapdata info' tells more of each",
    ]
