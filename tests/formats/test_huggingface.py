"""Hugging Face: the real ``datasets`` opens what we write, and finds what the shards hold."""

from __future__ import annotations

import builtins
import os
from pathlib import Path

import numpy as np
import pytest
from helpers.wild import cli

from mapdata import read_shard
from mapdata.describe.table import join_segments
from mapdata.limits import SPLITS
from mapdata.shards import read_manifest

os.environ.setdefault("HF_HUB_OFFLINE", "1")
os.environ.setdefault("HF_HUB_DISABLE_TELEMETRY", "1")


@pytest.mark.filterwarnings("ignore")  # of the libraries under it, not ours to mend
def test_the_datasets_library_opens_an_export(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Splits, rows, types and values are equal, and the picture shows free white."""
    datasets = pytest.importorskip("datasets", reason="pip install datasets")
    pytest.importorskip("pyarrow", reason="pip install pyarrow")
    assert cli(capsys, "export", root, tmp_path / "hub", "--format", "huggingface")[0] == 0
    found = datasets.load_dataset(str(tmp_path / "hub"), cache_dir=str(tmp_path / "cache"))
    assert sorted(found) == ["test", "train", "validation"]
    labels = [read_shard(root / entry.name) for entry in read_manifest(root).shards]
    seen = 0
    for split, name in zip(SPLITS, ("train", "validation", "test"), strict=True):
        for row in found[name]:
            batch = labels[row["item"] // 16]
            k, seen = row["item"] % 16, seen + 1
            maps = batch.maps
            n = int(batch.maps.rooms[k])
            assert SPLITS[maps.split[k]] == split
            assert row["label"] == f"map{row['item']}"
            assert np.array_equal(row["map"], maps.occupancy[k])
            assert np.array_equal(np.asarray(row["image"]), maps.occupancy[k] == 0)
            assert row["seed_rows"] == maps.seed_points[k, :n, 0].tolist()
            assert row["direction_for_passages"] == maps.directions[k, : n - 1].reshape(-1).tolist()
            assert row["connected"] == maps.connected[k, : n - 1].tolist()
            assert row["all_connected"] == batch.all_connected[k]
            for search in ("bfs", "astar"):
                cells = join_segments(batch.route(search, k))
                assert row[f"{search}_row_path"] == cells[:, 0].tolist()
                assert row[f"{search}_column_path"] == cells[:, 1].tolist()
                segments = batch.iterations(search, k)
                assert row[f"{search}_iterations"] == segments.sum()
                assert row[f"{search}_segment_iterations"] == segments.tolist()
                reachable = row["reachable"]
                assert len(row[f"{search}_path_gaps"]) == reachable.count(False)
                assert np.allclose(row[f"{search}_connection_matrix"], batch.matrix(search, k))
    assert seen == 24
    stacked = found["train"].with_format("numpy")[:3]["map"]
    assert np.stack(stacked).shape == (3, 20, 70)


def test_the_card_has_valid_front_matter(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A YAML reader finds the files of each split, and the card has identity and content hash."""
    yaml = pytest.importorskip("yaml")
    pytest.importorskip("pyarrow", reason="pip install pyarrow")
    cli(capsys, "export", root, tmp_path / "hub", "--format", "huggingface")
    card = (tmp_path / "hub" / "README.md").read_text(encoding="utf-8")
    front = yaml.safe_load(card.split("---")[1])
    files = front["configs"][0]["data_files"]
    assert [one["split"] for one in files] == ["train", "validation", "test"]
    assert all(sorted((tmp_path / "hub").glob(one["path"])) for one in files)
    manifest = read_manifest(root)
    assert manifest.content_hash in card
    assert str(manifest.identity) in card


def test_an_export_without_pyarrow_is_refused(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The message says how to install it, and nothing is written."""
    from mapdata.formats import export

    load = builtins.__import__

    def missing(name: str, *arguments: object) -> object:
        if name.startswith("pyarrow"):
            raise ImportError(name)
        return load(name, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(ValueError, match="pip install pyarrow"):
        export(root, tmp_path / "hub", "huggingface")
    monkeypatch.undo()
    assert list(tmp_path.iterdir()) == []
