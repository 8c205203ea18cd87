"""A dataset is a folder, a URL or several; one at a URL is fetched once and checked."""

from __future__ import annotations

import gzip
import hashlib
import pickle
import re
import socket
import struct
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
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
from helpers.refusals import memory
from torch.utils.data import DataLoader

from mapdata import (
    DatasetNotFoundError,
    Labels,
    MapDataset,
    MapSpec,
    Movement,
    ShardError,
    build,
    repair,
    verify,
)
from mapdata.cli import main
from mapdata.describe import card, dataset_statistics
from mapdata.plotting import report
from mapdata.plotting.figures import FIGURES, plot_figure
from mapdata.shards import MANIFEST, PROVENANCE, Root, content_hash, read_manifest, remote
from mapdata.shards.corruption import inspect, repair_faults
from mapdata.shards.locations import locations, target_folder

TRIES = (remote.PAUSES, remote.MAX_SILENCE, remote.MAX_SECONDS)
"""What users have; tests wait for less."""


class Handler(SimpleHTTPRequestHandler):
    """Serves a folder, remembers which files were fetched, and fails as it is told."""

    def __init__(
        self,
        *arguments: Any,
        fetched: list[str],
        faults: list[str],
        sent: list[int],
        over: threading.Event,
        **named: Any,
    ) -> None:
        """Serve one request."""
        self.fetched = fetched
        self.sent = sent
        self.faults = faults
        self.over = over
        super().__init__(*arguments, **named)

    def do_GET(self) -> None:
        """Send a file, or do what the first of the faults says."""
        self.fetched.append(self.path)
        fault = self.faults.pop(0) if self.faults else "none"
        data = b""
        if fault == "none":
            super().do_GET()
            return
        if fault.isdigit():
            self.send_error(int(fault))
            return
        if fault in ("loop", "away"):
            if fault == "loop":
                self.faults.append("loop")
            self.send_response(302)
            self.send_header("Location", self.path if fault == "loop" else "file:///etc/hostname")
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        if fault in ("endless", "drip"):
            self.send_without_end(2**16 if fault == "endless" else 1)
            return
        if fault == "page":
            data = b"\n<!DOCTYPE html><html><body>Please log in</body></html>"
        elif fault != "stall":
            data = Path(self.translate_path(self.path)).read_bytes()
        self.send_response(200)
        if fault in ("bomb", "gzip"):
            # a gzip file may have many members, one after another
            member = gzip.compress(bytes(2**26) if fault == "bomb" else data, mtime=0)
            data = member * (32 if fault == "bomb" else 1)
            self.send_header("Content-Encoding", "gzip")
        if fault != "cut":
            self.send_header("Content-Length", str(len(data) or 1000))
        self.end_headers()
        if fault == "stall":
            self.over.wait(60)
        elif fault == "reset":
            self.wfile.write(data[:10])
            self.wfile.flush()
            hard = struct.pack("ii", 1, 0)  # closing it is a reset
            self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, hard)
        else:
            with suppress(OSError):  # the client has seen enough
                self.wfile.write(data[: len(data) // 2] if fault in ("short", "cut") else data)

    def send_without_end(self, piece: int) -> None:
        """Send pieces until the client is gone, 64 MB of large ones at most."""
        self.send_response(200)
        self.end_headers()
        with suppress(OSError):
            for _ in range(2**26 // piece if piece > 1 else 10_000):
                self.wfile.write(bytes(piece))
                self.sent.append(piece)
                if piece == 1 and self.over.wait(0.01):
                    return

    def log_message(self, *_: object) -> None:
        """Print nothing."""


class Server:
    """A folder at a URL."""

    def __init__(
        self, folder: Path, url: str, fetched: list[str], faults: list[str], sent: list[int]
    ) -> None:
        """Keep what a test needs."""
        self.folder = folder
        self.url = url
        self.fetched = fetched
        self.faults = faults
        self.sent = sent


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    """Serve a small dataset below `maps`; the cache is empty."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    folder = tmp_path / "served"
    samples.build_small(folder / "maps")
    fetched: list[str] = []
    faults: list[str] = []
    sent: list[int] = []
    over = threading.Event()
    monkeypatch.setattr(remote, "PAUSES", (0.01, 0.02))
    handler = partial(
        Handler, directory=str(folder), fetched=fetched, faults=faults, sent=sent, over=over
    )
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as http:
        thread = threading.Thread(
            target=http.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True
        )
        thread.start()
        url = f"http://127.0.0.1:{http.server_port}/maps"
        yield Server(folder / "maps", url, fetched, faults, sent)
        over.set()
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


def test_a_cache_is_rid_of_what_killed_fetches_left(server: Server, tmp_path: Path) -> None:
    """When its dataset is opened next."""
    MapDataset(server.url)
    (folder,) = (tmp_path / "cache" / "mapdata" / "remote").iterdir()
    left = folder / ".0123456789abcdef-maps.h5.0123456789abcdef.mapdata.tmp"
    left.write_bytes(b"half a shard")
    MapDataset(server.url)
    assert [path.name for path in folder.iterdir()] == [MANIFEST]


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


def unused_url() -> str:
    """Return a URL at which nothing listens."""
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        return f"http://127.0.0.1:{unused.getsockname()[1]}/maps"


@pytest.mark.filterwarnings("ignore:.*Trying again")
def test_a_server_that_does_not_answer_is_not_a_missing_dataset(server: Server) -> None:
    """The message says what went wrong, and does not say that nothing is there."""
    url = unused_url()
    with pytest.raises(
        ConnectionError, match=f"^{url}/manifest.json could not be read: .*connect"
    ) as caught:
        MapDataset(url)
    assert "no dataset" not in str(caught.value)


FAULTS = {
    "500": "500",
    "503": "503",
    "429": "429",
    "short": "received .* of .* bytes",
    "reset": "",
    "stall": "Timeout",
}
"""What passes, and what must be said of it."""


@pytest.mark.parametrize("fault", FAULTS)
def test_what_passes_is_tried_again(
    fault: str, server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A manifest and a shard that come at the second or third try; each try that fails is said."""
    monkeypatch.setattr(remote, "MAX_SILENCE", 0.2)
    server.faults[:] = [fault]
    with pytest.warns(UserWarning, match=f"manifest.json could not be read.*{FAULTS[fault]}"):
        dataset = MapDataset(server.url)
    server.faults[:] = [fault, fault]
    with pytest.warns(UserWarning, match=r"\.h5 could not be read.*Trying again") as said:
        sample = dataset[0]
    assert len(said) == 2
    samples.assert_same(sample, MapDataset(server.folder)[0])


def test_half_a_shard_is_no_damage(server: Server) -> None:
    """Its server says no length, the manifest does: it is asked for again."""
    dataset = MapDataset(server.url)
    server.faults[:] = ["cut"]
    with pytest.warns(UserWarning, match=r"\.h5: \d+ of \d+ bytes came"):
        sample = dataset[0]
    samples.assert_same(sample, MapDataset(server.folder)[0])


@pytest.mark.filterwarnings("ignore:.*Trying again")
@pytest.mark.parametrize("fault", FAULTS)
def test_what_stays_is_named(fault: str, server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the middle of an epoch: the file, the reason, the number of tries and their limit.

    On one line, and not as a dataset that is missing.
    """
    monkeypatch.setattr(remote, "MAX_SILENCE", 0.2)
    dataset = MapDataset(server.url)
    server.faults[:] = [fault] * 3
    with pytest.raises(ConnectionError) as caught:
        dataset[0]
    name = read_manifest(server.folder).shards[0].name
    assert re.match(f"{server.url}/{name} could not be read: .*{FAULTS[fault]}", str(caught.value))
    assert "(3 tries, each given up after 0.2 s without a byte or 300 s" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert "no dataset" not in str(caught.value)
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)
    assert server.fetched[1:] == [f"/maps/{name}"] * 3
    samples.assert_same(dataset[0], MapDataset(server.folder)[0])  # it may be asked again


def test_the_tries_are_those_of_the_page() -> None:
    """docs/loading.md says how often, after what pauses, and within what limit."""
    page = (Path(__file__).parents[2] / "docs" / "loading.md").read_text(encoding="utf-8")
    assert TRIES == ((1, 4), 20, 300)
    for text in (
        "mapdata tries three times",
        "waits 1 and then 4 seconds between the tries",
        "ends after 20 seconds without a byte, or after 5 minutes in all",
    ):
        assert text in " ".join(page.split())


@pytest.mark.filterwarnings("ignore:.*Trying again")
def test_a_server_that_drips_bytes_is_given_up(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is never silent, so that only the limit of a whole try ends it."""
    dataset = MapDataset(server.url)
    monkeypatch.setattr(remote, "MAX_SECONDS", 0.3)
    server.faults[:] = ["drip"] * 3
    with pytest.raises(ConnectionError, match=r"could not be read: .*Timeout.* or 0.3 s in all\)"):
        dataset[0]
    assert server.sent


def test_no_more_is_read_than_the_manifest_says(server: Server) -> None:
    """A server that sends without end is left one byte after the end of the shard."""
    dataset = MapDataset(server.url)
    server.faults[:] = ["endless"]
    with pytest.raises(ShardError, match="what was fetched is damaged"):
        dataset[0]
    assert sum(server.sent) < 2**25  # what the buffers of the system hold, and not 64 MB


def test_what_is_missing_is_not_tried_again(server: Server) -> None:
    """A 404 stays one."""
    with pytest.raises(DatasetNotFoundError, match="was not found"):
        MapDataset(server.url + "x")
    assert server.fetched == ["/mapsx/manifest.json"]


@pytest.mark.filterwarnings("ignore:.*Trying again", "ignore:.*Going on")
def test_a_full_cache_needs_no_server(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The manifest is kept too, and what is kept is compared with its hashes."""
    truth = MapDataset(server.url)[:]
    other = imported(server.folder.parent / "imported")
    url = server.url.replace("/maps", "/imported")
    text = card(url)
    assert verify(url) == []
    monkeypatch.setattr(remote, "_open_url", broken)
    with pytest.warns(UserWarning, match="Going on with what was fetched before"):
        dataset = MapDataset(server.url)
    samples.assert_same(dataset[:], truth)
    assert card(url) == text == card(other)
    assert verify([server.url, url]) == []
    cached = next((tmp_path / "cache").rglob(f"*{read_manifest(server.folder).shards[0].name}"))
    cached.write_bytes(cached.read_bytes()[:-1] + b"?")
    with pytest.raises(ConnectionError, match=f"{cached.name[17:]} could not be read: unplugged"):
        MapDataset(server.url)[:]


def broken(url: str) -> None:
    """Fail as a network does that is not there."""
    raise OSError("unplugged")


def test_a_manifest_that_is_gone_is_not_taken_from_the_cache(server: Server) -> None:
    """A server that answers is believed."""
    MapDataset(server.url)
    (server.folder / MANIFEST).unlink()
    with pytest.raises(DatasetNotFoundError, match="was not found"):
        MapDataset(server.url)


@pytest.mark.skipif(sys.platform != "linux", reason="/proc/self/clear_refs is Linux's")
def test_a_bomb_takes_no_memory(server: Server) -> None:
    """What a server packs, though it is asked for plain bytes, is not unpacked: here 2 GB."""
    MapDataset(server.url)  # what a first fetch loads
    server.faults[:] = ["bomb"]
    Path("/proc/self/clear_refs").write_text("5")  # resets VmHWM
    before = memory("VmRSS")
    with pytest.warns(UserWarning, match=f"{server.url}/manifest.json .*packs it with gzip"):
        MapDataset(server.url)
    assert memory("VmHWM") - before < 100 << 20


REFUSALS = {
    "401": "access is denied (401",
    "403": "access is denied (403",
    "410": "its server refuses the request (410",
    "loop": "its server redirects in a circle; check the URL",
    "away": "its server redirects to file:///etc/hostname, no address of the web",
    "page": "its server sent a page of HTML or XML, expected the file",
    "gzip": "its server packs it with gzip, unasked",
}
"""Answers that stay, and what must be said of each."""


@pytest.mark.parametrize("fault", REFUSALS)
def test_an_answer_that_stays_is_named_and_not_asked_for_again(fault: str, server: Server) -> None:
    """For a shard and for a manifest: neither damage nor a missing dataset, and one try."""
    dataset = MapDataset(server.url)
    name = read_manifest(server.folder).shards[0].name
    server.faults[:] = [fault]
    with pytest.raises(ConnectionError) as caught:
        dataset[0]
    assert str(caught.value).startswith(f"{server.url}/{name} could not be read: ")
    assert REFUSALS[fault] in str(caught.value)
    assert "\n" not in str(caught.value)
    assert type(pickle.loads(pickle.dumps(caught.value))) is type(caught.value)
    if fault != "loop":
        assert server.fetched[1:] == [f"/maps/{name}"]
    server.faults[:] = []
    samples.assert_same(dataset[0], MapDataset(server.folder)[0])  # it may be asked later
    server.faults[:] = [fault]
    with pytest.warns(UserWarning, match="Going on with what was fetched before") as said:
        MapDataset(server.url)
    assert REFUSALS[fault] in str(said[0].message)


def test_a_stream_comes_in_pieces(server: Server) -> None:
    """A shard that is longer than what arrives at once."""
    build(server.folder.parent / "large", maps=3000, recipe=MapSpec(), shard_size=3000)
    url = server.url.replace("/maps", "/large")
    assert len(MapDataset(url)[:10].map) == 10
    assert verify(url) == []


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
    labels, i = there.locate(37)
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
        labels, i = both.locate(index)
        assert labels.maps.index[i] == index
        assert labels.maps.occupancy[i].tobytes() == expected[index]
    for index in (-1, 70):
        with pytest.raises(
            ValueError, match=f"got {index}, {server.url}, .*other holds maps 0 to 69"
        ):
            both.locate(index)
    unfinished = build(tmp_path / "part", samples.SPEC, maps=60, shard_size=16, part=(0, 2))
    ahead = Root.open([tmp_path / "part", other])
    assert not unfinished.complete
    assert ahead.locate(63)[0].maps.index[0] == 60
    with pytest.raises(ValueError, match="part is not finished"):
        Root.open([other, tmp_path / "part"], complete=True)


def test_roots_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    """None at all, and two sizes."""
    first = samples.build_small(tmp_path / "first", maps=3)
    second = samples.build_small(tmp_path / "second", samples.WIDE, maps=3)
    with pytest.raises(ValueError, match="got an empty list"):
        locations([])
    with pytest.raises(ValueError, match=f"root: {second} has map_size .*, {first} has"):
        Root.open([first, second])


def test_progress_is_shown_on_request(server: Server, capsys: pytest.CaptureFixture[str]) -> None:
    """A bar of maps."""
    assert len(list(Root.open(server.folder).labels(progress=True))) > 1
    assert "60/60" in capsys.readouterr().err


@pytest.mark.slow
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


@pytest.mark.filterwarnings("ignore:.*Trying again")
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


@pytest.mark.slow
def test_every_verb_takes_a_url_or_says_why_not(
    server: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Those that read do; what writes a dataset, or reads foreign files, names the URL whole."""
    url = server.url
    for line in (
        ["info", url],
        ["verify", url],
        ["show", url, "-o", str(tmp_path / "map.png")],
        ["report", url, "-o", str(tmp_path / "report.html")],
        ["export", url, str(tmp_path / "paper"), "--format", "paper"],
    ):
        main(line)
    capsys.readouterr()
    for line in (
        ["build", url],
        ["import", url, str(tmp_path / "maps")],
        ["import", url, str(tmp_path / "maps"), "--format", "images"],
        ["verify", url, "--repair"],
        ["export", str(server.folder), url, "--format", "paper"],
        ["report", str(server.folder), "-o", f"{url}/report.html"],
        ["show", str(server.folder), "-o", f"{url}/map.png"],
        ["info", str(server.folder), "--card", f"{url}/README.md"],
        ["check-scen", f"{url}/arena.map.scen"],
    ):
        with pytest.raises(SystemExit, match="2"):
            main(line)
        (error,) = capsys.readouterr().err.splitlines()
        assert re.match(rf"mapdata: .*{url}.* a URL, ", error), error
    assert not Path("http:").exists()


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
        repair_faults(inspect(server.url))
    with pytest.raises(ValueError, match="is a URL"):
        build(server.url, samples.SPEC)
    assert not (server.folder / entry.name).exists()
    other = samples.build_small(tmp_path / "other")
    assert repair([str(server.folder), other]) == []
    assert (server.folder / entry.name).read_bytes() == sound
    assert target_folder(server.folder) == server.folder


def test_a_cache_that_was_changed_is_fetched_again(server: Server, tmp_path: Path) -> None:
    """Also where its size is what it was."""
    first = MapDataset(server.url)[0]
    (cached,) = (tmp_path / "cache").rglob("*.h5")
    sound = cached.read_bytes()
    cached.write_bytes(sound[:-1] + bytes([sound[-1] ^ 1]))
    samples.assert_same(MapDataset(server.url)[0], first)
    assert cached.read_bytes() == sound
