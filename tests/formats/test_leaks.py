"""Maps that stand in two splits: counted, exactly and up to symmetry, and dropped on request."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.grids import random_grids
from helpers.wild import cli

from mapdata import read_shard, verify
from mapdata.arrays import Bytes
from mapdata.formats import Collection, ForeignMap, import_maps
from mapdata.limits import SPLITS
from mapdata.shards import PROVENANCE, read_manifest

TRAIN, VAL, TEST = range(3)


def collection(*maps: tuple[int | None, Bytes]) -> Collection:
    """Return maps with their splits."""
    return Collection([ForeignMap(f"map {k}", cells, split=s) for k, (s, cells) in enumerate(maps)])


def kept(root: Path) -> dict[str, list[bytes]]:
    """Return the grids of each split of a dataset."""
    (entry,) = read_manifest(root).shards
    maps = read_shard(root / entry.name).maps
    return {
        split: [grid.tobytes() for grid in maps.occupancy[maps.split == code]]
        for code, split in enumerate(SPLITS)
    }


@pytest.mark.parametrize("shape", [(12, 12), (9, 14)])
def test_copies_in_two_splits_are_counted_and_dropped(
    shape: tuple[int, int], tmp_path: Path
) -> None:
    """One exact copy and one mirrored in test, one mirrored in val; a repetition inside a split
    is none. What is dropped stands in an earlier split; the test split stays whole.
    """
    a, b, c, d, e = random_grids(5, *shape)
    maps = [
        (TRAIN, a),
        (TRAIN, b),
        (TRAIN, c),
        (TRAIN, d),
        (TRAIN, d),
        (VAL, c[::-1, ::-1]),
        (VAL, e),
        (TEST, a),
        (TEST, b[:, ::-1]),
        (TEST, e[::-1]),
    ]
    source = collection(*maps)
    (dataset,) = import_maps(tmp_path / "all", source)
    assert dataset.manifest.maps == 10
    assert source.notes == [
        "maps in two splits: 0 of val in train (1 up to symmetry), 1 of test in train (2 up to "
        "symmetry), 0 of test in val (1 up to symmetry); 4 copies in the earlier ones are kept, "
        "--drop-leaks leaves them out"
    ]
    source = collection(*maps)
    (dataset,) = import_maps(tmp_path / "apart", source, drop_leaks=True)
    assert source.notes[0].endswith("4 copies in the earlier ones are left out")
    assert verify(dataset.root) == []
    assert kept(dataset.root) == {
        "train": [d.tobytes(), d.tobytes()],
        "val": [np.ascontiguousarray(c[::-1, ::-1]).tobytes()],
        "test": [np.ascontiguousarray(g).tobytes() for g in (a, b[:, ::-1], e[::-1])],
    }


def test_only_square_maps_have_transposed_copies(tmp_path: Path) -> None:
    """A transposed square is a copy; a transposed rectangle has another size and is another map."""
    square = random_grids(1, 12, 12)[0]
    source = collection((TRAIN, square), (TEST, square.T))
    import_maps(tmp_path / "square", source)
    assert "0 of test in train (1 up to symmetry)" in source.notes[0]
    wide = random_grids(1, 9, 14)[0]
    source = collection((TRAIN, wide), (TEST, wide.T))
    import_maps(tmp_path / "wide", source)
    assert source.notes == []  # two datasets of one map each
    source = collection((TRAIN, square), (TEST, 1 - square))
    import_maps(tmp_path / "two", source)
    assert source.notes == ["no map stands in two splits, exactly or up to symmetry"]


def test_distinct_maps_are_counted_in_each_split(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A split may repeat its own maps: import and info say how many it has, before and after
    copies in other splits are left out.
    """
    a, b, c = random_grids(3, 12, 12)
    stacks = {"train": [a, a, a[::-1], b, b], "val": [b, b.T], "test": [c, c, c]}
    for split, grids in stacks.items():
        (tmp_path / "in" / split).mkdir(parents=True)
        np.save(tmp_path / "in" / split / "maps.npy", grids)
    for flags, message in (
        ((), "5 of 10 (3 up to symmetry): train 3, val 2, test 1"),
        (("--drop-leaks",), "5 of 8 (3 up to symmetry): train 2, val 2, test 1"),
    ):
        root = tmp_path / f"out{len(flags)}"
        code, imported, _ = cli(capsys, "import", tmp_path / "in", root, *flags)
        assert code == 0
        assert f"distinct maps:        {message}\n" in imported
        code, info, _ = cli(capsys, "info", root)
        assert (code, info in imported) == (0, True)
        assert verify(root) == []


def test_info_of_an_import_shows_splits_movement_and_source(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It also shows the share of free cells; for a single map it counts no copies."""
    np.save(tmp_path / "plan.npy", np.eye(4, dtype=np.uint8))
    _, imported, _ = cli(capsys, "import", tmp_path / "plan.npy", tmp_path / "out")
    assert "two splits" not in imported
    code, info, _ = cli(capsys, "info", tmp_path / "out")
    assert code == 0
    assert info.splitlines()[1:6] == [
        "splits:               train 1, val 0, test 0",
        "movement:             4-connected: north, east, south, west, each at cost 1",
        "resolution:           0.1 m per cell assumed; import with --resolution to state it",
        "free cells:           75.0%",
        f"source:               {tmp_path / 'plan.npy'}, format images",
    ]
    assert "distinct" not in info
    # without a sound record, what the manifest says remains
    for damaged in ("{}", "[", '{"free": 1}', None):
        record = tmp_path / "out" / PROVENANCE
        record.unlink()
        if damaged is not None:
            record.write_text(damaged)
        code, info, _ = cli(capsys, "info", tmp_path / "out")
        assert (code, "4-connected" in info, "free cells" in info) == (0, True, False)
        record.touch()


def test_drawn_splits_are_kept(tmp_path: Path) -> None:
    """Equal maps without splits are drawn into two splits, and the maps that are not dropped keep
    theirs.
    """
    a, b = random_grids(2, 12, 12)
    source = collection(*[(None, grid) for _ in range(40) for grid in (a, b)])
    (dataset,) = import_maps(tmp_path / "all", source)
    before = kept(dataset.root)
    assert all(len(set(grids)) == 2 for grids in before.values())
    (dataset,) = import_maps(tmp_path / "apart", source, drop_leaks=True)
    after = kept(dataset.root)
    assert after == {"train": [], "val": [], "test": before["test"]}


def test_the_command_reports_copies_and_a_flag_drops_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The report is one line."""
    grids = random_grids(3, 12, 12)
    for split in ("train", "test"):
        (tmp_path / "in" / split).mkdir(parents=True)
        np.save(tmp_path / "in" / split / "maps.npy", grids)
    code, out, _ = cli(capsys, "import", tmp_path / "in", tmp_path / "a")
    assert code == 0
    assert out.count("3 of test in train (3 up to symmetry)") == 1
    code, out, _ = cli(capsys, "import", tmp_path / "in", tmp_path / "b", "--drop-leaks")
    assert (code, "3 copies in the earlier ones are left out" in out) == (0, True)
    assert "maps:                 3 of 12 x 12" in out
