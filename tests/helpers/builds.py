"""A dataset of three shards that tests of building share, and what they look at in its folder."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import pytest

from mapdata import MapGenerator, MapSpec, Movement, Terrain, build
from mapdata.hashing import canonical_json
from mapdata.shards import MANIFEST, Manifest, read_manifest

SPEC = MapSpec((16, 70), (2, 4), (2, 6), (3, 12), passage_width=(1, 2), skip_probability=0.3)
SEED = 5
MAPS = 11
SIZE = 4
"""Maps in a shard."""

SOUND_SPEC = MapSpec(
    (20, 70),
    (2, 5),
    (2, 8),
    (3, 12),
    passage_width=(1, 2),
    skip_probability=0.5,
    movement=Movement(8),
)
SOUND_SEED = 3
"""Three maps of these are the sound dataset that helpers/hostile.py spoils."""

SOUND_TERRAIN = Terrain((20, 70), movement=Movement(8))
"""Three maps of these are the sound dataset with terrain."""


class Built(Protocol):
    """The type of the fixture `built`."""

    def __call__(
        self,
        generator: MapGenerator | str,
        *,
        maps: int,
        seed: int = 0,
        shard_size: int = 1000,
    ) -> Path:
        """Return the folder of this dataset, which tests leave as it is."""


def make(
    root: Path,
    maps: int = MAPS,
    shard_size: int = SIZE,
    *,
    workers: int | None = 1,
    executor: Executor | None = None,
) -> Manifest:
    """Build the dataset of these tests."""
    return build(
        root, SPEC, maps=maps, seed=SEED, shard_size=shard_size, workers=workers, executor=executor
    )


def shard_name(start: int, stop: int) -> str:
    """Return the name of a shard as docs/format.md gives it."""
    return f"maps-{start:012d}-{stop:012d}.h5"


def names(maps: int, shard_size: int) -> list[str]:
    """Return the names that a finished root holds."""
    starts = range(0, maps, shard_size)
    return [MANIFEST, *(shard_name(start, min(start + shard_size, maps)) for start in starts)]


def listing(root: Path) -> list[str]:
    """Return the names in a root, without the lock."""
    return sorted(name for name in os.listdir(root) if name != ".lock")


class Stamp(NamedTuple):
    """What changes when a file is written again."""

    inode: int
    modified: int
    size: int


def stamps(root: Path) -> dict[str, Stamp]:
    """Return the stamps of all shards of a root."""
    found = {path.name: path.stat() for path in root.glob("maps-*.h5")}
    return {
        name: Stamp(status.st_ino, status.st_mtime_ns, status.st_size)
        for name, status in found.items()
    }


def restated(text: str, change: Callable[[dict[str, Any]], object]) -> str:
    """Return a manifest with other values and the hash that fits them, as a hostile one has."""
    values = json.loads(text)
    del values["manifest_hash"]
    change(values)
    values["manifest_hash"] = hashlib.sha256(canonical_json(values).encode()).hexdigest()
    return json.dumps(values, indent=1) + "\n"


def publish(root: Path, name: str, image: bytes) -> None:
    """Put another file in the place of a shard, with a manifest that states its size and hash."""
    manifest = read_manifest(root)
    digest = hashlib.sha256(image).hexdigest()
    shards = tuple(
        replace(entry, bytes=len(image), sha256=digest) if entry.name == name else entry
        for entry in manifest.shards
    )
    (root / name).write_bytes(image)
    (root / MANIFEST).write_text(replace(manifest, shards=shards).to_json(), encoding="utf-8")


class InTheCaller(Executor):
    """Runs a task when it is submitted."""

    def submit(
        self, function: Callable[..., Any], /, *arguments: object, **options: object
    ) -> Future[Any]:
        """Run ``function`` now."""
        future: Future[Any] = Future()
        try:
            future.set_result(function(*arguments, **options))
        except BaseException as error:
            future.set_exception(error)
        return future


@contextmanager
def unprivileged_folder(mode: int = 0o555) -> Iterator[Path]:
    """Give a folder of this mode to a user whom modes stop: root becomes nobody meanwhile."""
    with tempfile.TemporaryDirectory() as outer:
        os.chmod(outer, 0o755)  # pytest's own folders are closed to other users
        folder = Path(outer) / "root"
        folder.mkdir()
        folder.chmod(mode)
        if os.geteuid() == 0:
            try:
                os.setresuid(65534, 65534, 0)
            except (AttributeError, OSError):
                pytest.skip("root, and cannot become anybody else")
        try:
            yield folder
        finally:
            if os.getresuid()[2] == 0:
                os.setresuid(0, 0, 0)
            folder.chmod(0o755)
