"""Datasets at a URL, over a real local HTTP server: fetched once, checked, cached."""

from __future__ import annotations

import hashlib
import socket
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from helpers import samples
from torch.utils.data import DataLoader

from mapdata import DatasetNotFoundError, MapDataset, ShardError
from mapdata.shards import read_manifest


class Handler(SimpleHTTPRequestHandler):
    """Serves a folder and remembers which files were fetched."""

    fetched: list[str]

    def __init__(self, *arguments: Any, fetched: list[str], **named: Any) -> None:  # noqa: ANN401
        """Serve one request."""
        self.fetched = fetched
        super().__init__(*arguments, **named)

    def do_GET(self) -> None:
        """Send a file."""
        self.fetched.append(self.path)
        super().do_GET()

    def log_message(self, *_: object) -> None:
        """Print nothing."""


class Server:
    """A folder at a URL."""

    def __init__(self, folder: Path, url: str, fetched: list[str]) -> None:
        """Keep what a test needs."""
        self.folder, self.url, self.fetched = folder, url, fetched


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    """Serve a small dataset below `maps`; the cache is empty."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    folder = tmp_path / "served"
    samples.build_small(folder / "maps")
    fetched: list[str] = []
    handler = partial(Handler, directory=str(folder), fetched=fetched)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as http:
        thread = threading.Thread(target=http.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
        thread.start()
        yield Server(folder / "maps", f"http://127.0.0.1:{http.server_port}/maps", fetched)
        http.shutdown()
        thread.join()


def test_a_dataset_at_a_url_is_the_dataset(server: Server) -> None:
    """The same samples and table; each shard is fetched once, when it is first touched."""
    here, there = (MapDataset(root, fields=samples.ALL_FIELDS) for root in (str(server.folder), server.url))
    names = [entry.name for entry in read_manifest(server.folder).shards]
    assert server.fetched == ["/maps/manifest.json"]
    samples.assert_same(there[-1], here[-1])
    assert server.fetched[1:] == [f"/maps/{names[-1]}"]
    samples.assert_same(there[:], here[:])
    assert there.table().equals(here.table())
    assert sorted(server.fetched[1:]) == [f"/maps/{name}" for name in names]


def test_what_is_cached_is_not_fetched_again(server: Server) -> None:
    """Only the manifest is, so that a dataset that grew is seen; a slash at the end changes nothing."""
    first = MapDataset(server.url)[:]
    count = len(server.fetched)
    again = MapDataset(server.url + "/")
    samples.assert_same(again[:], first)
    assert [path.lstrip("/") for path in server.fetched[count:]] == ["maps/manifest.json"]
    samples.build_small(server.folder, maps=90)
    grown = MapDataset(server.url)
    assert len(grown) > len(again)
    known = len(server.fetched)
    samples.assert_same(grown[: len(again) // 2], again[: len(again) // 2])
    assert len(server.fetched) == known


def test_workers_read_the_cache(server: Server) -> None:
    """A dataset at a URL pickles and forks like any other."""
    dataset = MapDataset(server.url)
    expected = list(DataLoader(dataset, 64))
    samples.assert_all_same(
        list(DataLoader(dataset, 64, num_workers=1, multiprocessing_context="fork")), expected
    )  # fmt: skip


def test_damaged_files_are_refused(server: Server, tmp_path: Path) -> None:
    """What does not have the manifest's hash is never mapped nor kept; once it is repaired, it is fetched."""
    entry = read_manifest(server.folder).shards[0]
    shard = server.folder / entry.name
    sound = shard.read_bytes()
    shard.write_bytes(sound[:-1] + bytes([sound[-1] ^ 1]))
    dataset = MapDataset(server.url)
    with pytest.raises(ShardError, match=f"{server.url}/{entry.name}: what was fetched is damaged"):
        dataset[0]
    assert not list((tmp_path / "cache").rglob("*.h5"))
    shard.write_bytes(sound)
    assert dataset[0].map.shape == (1, 20, 20)
    (cached,) = (tmp_path / "cache").rglob("*.h5")
    assert hashlib.sha256(cached.read_bytes()).hexdigest() == entry.sha256


def test_a_damaged_cache_is_fetched_again(server: Server, tmp_path: Path) -> None:
    """A file that was cut short on disk is replaced."""
    first = MapDataset(server.url)[0]
    (cached,) = (tmp_path / "cache").rglob("*.h5")
    size = cached.stat().st_size
    cached.write_bytes(cached.read_bytes()[:100])
    samples.assert_same(MapDataset(server.url)[0], first)
    assert cached.stat().st_size == size


def test_damaged_manifests_are_refused(server: Server) -> None:
    """Nothing is opened by one."""
    manifest = server.folder / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"maps": 60', '"maps": 61'))
    with pytest.raises(ShardError, match=f"{server.url}.*: damaged"):
        MapDataset(server.url)


def test_a_missing_dataset_is_named(server: Server) -> None:
    """The URL that was looked for; a shard that is missing likewise."""
    with pytest.raises(DatasetNotFoundError, match=f"{server.url}x/manifest.json was not found"):
        MapDataset(server.url + "x")
    name = read_manifest(server.folder).shards[0].name
    (server.folder / name).unlink()
    with pytest.raises(DatasetNotFoundError, match=f"{name} was not found"):
        MapDataset(server.url)[0]


@pytest.mark.skipif(find_spec("s3fs") is not None, reason="package s3fs is installed")
def test_urls_that_need_another_package_name_it(server: Server) -> None:
    """`s3://` wants s3fs."""
    with pytest.raises(ValueError, match=r"root: s3://bucket/maps needs another package: .*s3fs"):
        MapDataset("s3://bucket/maps")


def test_unknown_protocols_are_refused() -> None:
    """A slip in the URL is an error that names the root."""
    with pytest.raises(ValueError, match=r"root: htp://host/maps: .*htp"):
        MapDataset("htp://host/maps")


def test_a_server_that_does_not_answer_is_not_a_missing_dataset(server: Server) -> None:
    """The message says what went wrong, and does not say that nothing is there."""
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{unused.getsockname()[1]}/maps"
        with pytest.raises(DatasetNotFoundError, match=f"{url}/manifest.json could not be read: .*connect"):
            MapDataset(url)


def test_local_and_remote_roots_mix(server: Server) -> None:
    """One dataset over both."""
    both = MapDataset([str(server.folder), server.url])
    samples.assert_same(both[len(both) // 2], both[0])
