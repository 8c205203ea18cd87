"""A dataset is a folder, a URL or several; one at a URL is fetched once and checked."""

from __future__ import annotations

import hashlib
import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import samples
from helpers.cards import table
from helpers.imported import imported
from torch.utils.data import DataLoader

from mapdata import (
    DatasetNotFoundError,
    Labels,
    MapDataset,
    Movement,
    ShardError,
    build,
    repair,
    verify,
)
from mapdata.plotting import plot_figure, report
from mapdata.plotting.figures import FIGURES
from mapdata.shards import (
    MANIFEST,
    PROVENANCE,
    Root,
    card,
    content_hash,
    dataset_statistics,
    read_manifest,
)
from mapdata.shards.corruption import inspect, repair_found
from mapdata.shards.root import folder_of, places


class Handler(SimpleHTTPRequestHandler):
    """Serves a folder and remembers which files were fetched."""

    fetched: list[str]

    def __init__(self, *arguments: Any, fetched: list[str], **named: Any) -> None:
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
        self.folder = folder
        self.url = url
        self.fetched = fetched


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
        thread = threading.Thread(
            target=http.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True
        )
        thread.start()
        yield Server(folder / "maps", f"http://127.0.0.1:{http.server_port}/maps", fetched)
        http.shutdown()
        thread.join()


def test_a_dataset_at_a_url_is_the_dataset(server: Server) -> None:
    """The same samples and table; each shard is fetched once, when it is first touched."""
    here, there = (
        MapDataset(root, fields=samples.ALL_FIELDS) for root in (str(server.folder), server.url)
    )
    names = [entry.name for entry in read_manifest(server.folder).shards]
    assert server.fetched == ["/maps/manifest.json"]
    samples.assert_same(there[-1], here[-1])
    assert server.fetched[1:] == [f"/maps/{names[-1]}"]
    samples.assert_same(there[:], here[:])
    assert there.table().equals(here.table())
    assert sorted(server.fetched[1:]) == [f"/maps/{name}" for name in names]


def test_what_is_cached_is_not_fetched_again(server: Server) -> None:
    """Only the manifest is, so that a grown dataset is seen; a slash at the end is ignored."""
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
    """What does not have the manifest's hash is never kept; once repaired, it is fetched."""
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
        with pytest.raises(
            DatasetNotFoundError, match=f"{url}/manifest.json could not be read: .*connect"
        ):
            MapDataset(url)


def test_local_and_remote_roots_mix(server: Server) -> None:
    """One dataset over both."""
    both = MapDataset([str(server.folder), server.url])
    samples.assert_same(both[len(both) // 2], both[0])


# --- whatever takes a dataset -------------------------------------------------------------------


def occupancy(labels: Iterator[Labels]) -> list[bytes]:
    """Return the grids of all maps."""
    return [grid.tobytes() for batch in labels for grid in batch.maps.occupancy]


def test_a_root_is_its_maps(server: Server) -> None:
    """Folder and URL hold the same maps, a shard at a time; one map is found without the others."""
    here = Root.open(server.folder)
    there = Root.open(server.url)
    assert (here.map_size, here.movement, here.maps) == ((20, 20), Movement(), 60)
    assert len(here.shards) == len(here.manifests[0].shards)
    assert (str(here), str(there)) == (str(server.folder), server.url)
    assert server.fetched == ["/maps/manifest.json"]
    labels, i = there.map(37)
    assert labels.maps.index[i] == 37
    assert len(server.fetched) == 2
    assert [content_hash(batch) for batch in here.labels()] == [
        content_hash(batch) for batch in there.labels()
    ]


def test_several_roots_are_one(server: Server, tmp_path: Path) -> None:
    """Their maps one after another, numbered on, also behind a dataset that is not finished."""
    other = Path(samples.build_small(tmp_path / "other", maps=10))
    both = Root.open([server.url, other])
    assert both.maps == 70
    assert np.concatenate([batch.maps.index for batch in both.labels()]).tolist() == list(range(70))
    expected = occupancy(Root.open(server.folder).labels()) + occupancy(Root.open(other).labels())
    assert occupancy(both.labels()) == expected
    for index in (0, 59, 60, 69):
        labels, i = both.map(index)
        assert labels.maps.index[i] == index
        assert labels.maps.occupancy[i].tobytes() == expected[index]
    for index in (-1, 70):
        with pytest.raises(
            ValueError, match=f"got {index}, {server.url}, .*other holds maps 0 to 69"
        ):
            both.map(index)
    unfinished = build(tmp_path / "part", samples.SPEC, maps=60, shard_size=16, part=(0, 2))
    ahead = Root.open([tmp_path / "part", other])
    assert not unfinished.complete
    assert ahead.map(63)[0].maps.index[0] == 60
    with pytest.raises(ValueError, match="part is not finished"):
        Root.open([other, tmp_path / "part"], complete=True)


def test_roots_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    """None at all, and two sizes."""
    first = samples.build_small(tmp_path / "first", maps=3)
    second = samples.build_small(tmp_path / "second", samples.WIDE, maps=3)
    with pytest.raises(ValueError, match="got an empty list"):
        places([])
    with pytest.raises(ValueError, match=f"root: {second} has map_size .*, {first} has"):
        Root.open([first, second])


def test_progress_is_shown_on_request(server: Server, capsys: pytest.CaptureFixture[str]) -> None:
    """A bar of maps."""
    assert len(list(Root.open(server.folder).labels(progress=True))) > 1
    assert "60/60" in capsys.readouterr().err


def test_statistics_card_report_and_figures(server: Server, tmp_path: Path) -> None:
    """Of a URL they are those of the folder; of two they are of the maps of both."""
    assert card(server.url) == card(server.folder)
    assert report(server.url) == report(server.folder)
    other = samples.build_small(tmp_path / "other", maps=10)
    both = (server.url, other)
    of = dataset_statistics(both)
    parts = [dataset_statistics(place) for place in both]
    assert len(of) == 70
    for name in ("rooms", "free", "split", "hardness", "lengths"):
        np.testing.assert_array_equal(
            getattr(of, name), np.concatenate([getattr(part, name) for part in parts])
        )
    for kind in FIGURES:
        assert plot_figure(both, kind, index=65).axes
    text = card(both)
    facts = table(text, "What it is")
    assert facts[""] == ["maps", "other"]
    assert facts["content hash"] == [part.root.manifests[0].content_hash for part in parts]
    assert text.count("## Make it again") == 2
    assert "maps + other: 70 grid maps" in text
    assert "MapDataset(['maps', 'other'], split=" in text
    assert "maps + other: 70 grid maps" in report(both, maps=20)


def test_imported_maps_at_a_url_say_where_they_come_from(server: Server) -> None:
    """Their card is that of the folder."""
    folder = imported(server.folder.parent / "imported")
    url = server.url.replace("/maps", "/imported")
    assert card(url) == card(folder)
    assert verify(url) == []
    (folder / PROVENANCE).unlink()
    assert verify(url) == [f"{url}/{PROVENANCE}: missing"]
    eight = samples.build_small(
        server.folder.parent / "eight", replace(samples.SPEC, movement=Movement(8)), maps=3
    )
    both = card([url, eight])
    assert "Cite the source of the maps. The labels are" in both
    assert "Please cite the paper whose maps these are:" in both


def test_verify_looks_at_what_is_served(server: Server, tmp_path: Path) -> None:
    """Each damaged or missing file is named by its URL; several are checked one after another."""
    assert verify(server.url) == verify([server.url, server.folder]) == []
    first, second, *_ = (entry.name for entry in read_manifest(server.folder).shards)
    (server.folder / first).write_bytes(b"damaged")
    (server.folder / second).unlink()
    assert verify(server.url) == [], "what was fetched is sound"
    for cached in (tmp_path / "cache").rglob("*.h5"):
        cached.unlink()
    damaged, missing = verify(server.url)
    assert (
        damaged == f"{server.url}/{first}: what was fetched is damaged (its file hash does not fit)"
    )
    assert missing == f"{server.url}/{second} was not found"
    assert len(verify([server.url, server.folder])) == 4
    (server.folder / MANIFEST).write_text("{}")
    assert verify(server.url)[0].startswith(f"{server.url}/{MANIFEST}: ")
    with pytest.raises(DatasetNotFoundError):
        verify([server.folder, server.url + "x"])


def test_a_url_can_only_be_read(server: Server, tmp_path: Path) -> None:
    """Repairing one is refused before anything is repaired; its folder can be."""
    (entry, *_) = read_manifest(server.folder).shards
    sound = (server.folder / entry.name).read_bytes()
    (server.folder / entry.name).unlink()
    for given in (server.url, [str(server.folder), server.url]):
        with pytest.raises(
            ValueError, match=f"root: {server.url} is a URL, which can only be read"
        ):
            repair(given)
    with pytest.raises(ValueError, match="is a URL"):
        repair_found(inspect(server.url))
    with pytest.raises(ValueError, match="is a URL"):
        build(server.url, samples.SPEC)
    assert not (server.folder / entry.name).exists()
    other = samples.build_small(tmp_path / "other")
    assert repair([str(server.folder), other]) == []
    assert (server.folder / entry.name).read_bytes() == sound
    assert folder_of(server.folder) == server.folder


def test_a_cache_that_was_changed_is_fetched_again(server: Server, tmp_path: Path) -> None:
    """Also where its size is what it was."""
    first = MapDataset(server.url)[0]
    (cached,) = (tmp_path / "cache").rglob("*.h5")
    sound = cached.read_bytes()
    cached.write_bytes(sound[:-1] + bytes([sound[-1] ^ 1]))
    samples.assert_same(MapDataset(server.url)[0], first)
    assert cached.read_bytes() == sound
