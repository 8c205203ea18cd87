"""Long life: old files stay readable, newer ones are refused by name, memory does not grow."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from h5py import h5a

import mapdata
from mapdata import MapDataset, MapGenerator, MapSpec, ShardError, build, read_shard, verify
from mapdata.hashing import canonical_json
from mapdata.limits import FORMAT_VERSIONS
from mapdata.shards import MANIFEST, content_hash, open_shard, read_manifest

KEPT = Path(__file__).parents[1] / "data"
FIELDS = ("map", "start", "goal", "path", "length", "iterations", "problem")

HASHES = {
    "format-1": (
        "e9aa16f96cf80d59c7d4bb282274f6ea58566ce9f7aba87341d77684df33a8a2",
        "cab67ec201eef865ceff1ccae4dc18d322f555c0b1216837bdd9c4234c593162",
    ),
    "format-1-h5py-3.9": (  # HDF5 1.12 lays out the same maps in other bytes than 2.0
        "e9aa16f96cf80d59c7d4bb282274f6ea58566ce9f7aba87341d77684df33a8a2",
        "cab67ec201eef865ceff1ccae4dc18d322f555c0b1216837bdd9c4234c593162",
    ),
    "format-2": (
        "761b08b829dad6ab53ad79dc48cc16f88a0b12b21d71851694d49754a9a0300f",
        "0aaf7f51624172489f0af6ffc892a6f34a3a6f152f38ecf006c7c0de2d6a39e2",
    ),
    "format-1-imported": (
        "a3bf5b10b6195a829845faaba793ba429b011112c29cb7d27ce98a017c255754",
        "0cf15d9ae549efa8b0f5ac5670321b7a2ad9ea9246683c7c452112bfcdda978f",
    ),
    "format-3": (
        "ee1a7243bce75b4f5ba0785fa64dcec7895f08cd3e6b95422f401c50d548ab34",
        "058764249b7c9cb2c9e8365dd96f241b2335d21f604b124ac6039e48864333b8",
    ),
    "format-3-imported": (
        "2a43080de60cc0fe5901f586e2d9dc53557ee821e8615c1855edce1c5f2765b8",
        "29ff34c86431fe4de331597495ac972d1a77310b6fa6048621d7c522e3703034",
    ),
}
"""Of each kept dataset the content hash and that of its stored problems. A new format adds lines,
none is changed.
"""


def samples_hash(root: Path) -> str:
    """Return the hash of all samples of a dataset: the stored problems of both searches."""
    digest = hashlib.sha256()
    fields: tuple[str, ...] = FIELDS
    if read_manifest(root).has_terrain:
        fields = (*FIELDS, "terrain", "cost")
    for search in ("bfs", "astar"):
        for problems in ("route", "pairs"):
            dataset = MapDataset(root, fields=fields, search=search, problems=problems)
            for value in dataset[:]:
                digest.update(np.ascontiguousarray(value.numpy()).tobytes())
    return digest.hexdigest()


@pytest.mark.parametrize("name", HASHES)
def test_kept_datasets_read_to_the_same_hash(name: str) -> None:
    """Written by the version that brought the format: content, bytes and samples are the same."""
    root = KEPT / name
    (content, samples) = HASHES[name]
    manifest = read_manifest(root)
    assert manifest.content_hash == content
    found = []
    for entry in manifest.shards:
        assert hashlib.sha256((root / entry.name).read_bytes()).hexdigest() == entry.sha256
        found.append(content_hash(read_shard(root / entry.name)))
    assert sum(int(hashed, 16) for hashed in found) % 2**256 == int(content, 16)
    assert samples_hash(root) == samples
    assert verify(root) == []


@pytest.mark.parametrize("name", ["format-1", "format-2", "format-3"])
def test_a_kept_recipe_gives_the_kept_content(name: str, tmp_path: Path) -> None:
    """The few lines of JSON that were kept make the same maps and labels today."""
    manifest = read_manifest(KEPT / name)
    recipe = json.loads(manifest.recipe())
    build(
        tmp_path / "maps",
        MapGenerator.from_dict(recipe["spec"]),
        maps=recipe["maps"],
        seed=recipe["seed"],
    )
    assert (
        read_manifest(tmp_path / "maps").content_hash == HASHES[name][0] == recipe["content_hash"]
    )


def test_every_format_is_kept() -> None:
    """Whoever raises the format version keeps a dataset of it."""
    assert {f"format-{version}" for version in FORMAT_VERSIONS} <= set(HASHES)
    # Beside the datasets there are saved problem sets, which tests/problems/test_set_file.py reads.
    assert {path.name for path in KEPT.iterdir()} == {*HASHES, "problem-sets-1"}


def test_a_newer_format_is_refused_by_naming_both_versions(tmp_path: Path) -> None:
    """In the manifest, and in a shard."""
    newer = FORMAT_VERSIONS[-1] + 1
    says = rf"format version {newer}, this mapdata .* reads 1 to 3"
    shutil.copytree(KEPT / "format-1", tmp_path / "maps")
    path = tmp_path / "maps" / MANIFEST
    values = json.loads(path.read_text())
    values["format_version"] = newer
    del values["manifest_hash"]
    values["manifest_hash"] = hashlib.sha256(canonical_json(values).encode()).hexdigest()
    path.write_text(json.dumps(values))
    with pytest.raises(ShardError, match=says):
        read_manifest(tmp_path / "maps")
    with pytest.raises(ShardError, match=says):
        MapDataset(tmp_path / "maps")
    shard = next((tmp_path / "maps").glob("*.h5"))
    with h5py.File(shard, "r+") as file:
        h5a.open(file.id, b"format_version").write(np.array(newer))
    with pytest.raises(ShardError, match=says) as caught:
        open_shard(shard)
    assert mapdata.__version__ in str(caught.value)


MEMORY = """
import sys
from torch.utils.data import DataLoader
from mapdata import MapDataModule, MapDataset, verify

def anonymous():
    text = open("/proc/self/status").read()
    return int(text.split("RssAnon:")[1].split()[0])

module = MapDataModule(sys.argv[1], batch_size=64, augment=True)
module.setup("fit")
held = []
for epoch in range(4):
    for batch in module.train_dataloader():
        pass
    for batch in DataLoader(MapDataset(sys.argv[1], problems="random"), 64, shuffle=True):
        pass
    held.append(anonymous())
print(*held)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="RssAnon is Linux's")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.slow
def test_epochs_of_loading_take_no_more_memory(tmp_path: Path) -> None:
    """After the first epoch, which compiles and opens all, three more take at most 1 % more."""
    build(tmp_path / "maps", MapSpec.preset("dungeon"), maps=1500, seed=1, shard_size=100)
    command = [sys.executable, "-W", "ignore", "-c", MEMORY, str(tmp_path / "maps")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    first, *rest = (int(word) for word in done.stdout.split())
    assert max(rest) < 1.01 * first, (first, rest)
