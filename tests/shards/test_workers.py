"""Long work: results as they finish, how many are under way, bars, and executors whose workers
die.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from threading import Event
from typing import Any

import pytest
from helpers.builds import MAPS, SEED, SIZE, SPEC, InTheCaller, make, names

from mapdata import build, verify
from mapdata.shards import Manifest, read_manifest
from mapdata.shards.workers import bar, completed, thread_pool


def twice(number: int) -> int:
    """Return a result that tells its task."""
    if number == 13:
        raise OSError("no space left")
    return 2 * number


@pytest.mark.parametrize("max_pending", [1, 3, 100])
def test_every_task_comes_back_once(max_pending: int) -> None:
    """Each with its own result, whatever finished first."""
    with ThreadPoolExecutor(2) as pool:
        assert sorted(completed(pool, twice, range(10), max_pending)) == [
            (k, 2 * k) for k in range(10)
        ]
        assert list(completed(pool, twice, [], max_pending)) == []


class Counting(ThreadPoolExecutor):
    """Counts what is under way."""

    pending = max_pending = 0

    def submit(
        self, function: Callable[..., Any], /, *arguments: object, **options: object
    ) -> Future[Any]:
        """Take a task."""
        self.pending += 1
        self.max_pending = max(self.max_pending, self.pending)
        return super().submit(function, *arguments, **options)


def test_so_many_are_under_way() -> None:
    """What the caller took is no longer under way."""
    with Counting(2) as pool:
        for _ in completed(pool, twice, range(14, 40), 4):
            pool.pending -= 1
        # The next task is submitted before the caller has counted the last one.
        assert pool.max_pending <= 5


def test_results_come_before_the_last_task_is_given() -> None:
    """An executor that works when it is given a task does not delay what is finished."""
    submitted: list[int] = []

    def tasks() -> Iterator[int]:
        for k in range(14, 20):
            submitted.append(k)
            yield k

    for number, _ in completed(InTheCaller(), twice, tasks(), 1000):
        assert submitted[-1] == number


def test_an_error_comes_out_and_the_rest_is_cancelled() -> None:
    """What was not begun never is."""
    begun: list[int] = []

    def task(number: int) -> int:
        begun.append(number)
        return twice(number)

    with pytest.raises(OSError, match="no space left"), thread_pool(1) as pool:
        list(completed(pool, task, range(12, 500), 20))
    assert len(begun) < 25


def test_ctrl_c_neither_waits_nor_begins_anything() -> None:
    """What is under way goes on; what was not begun never is."""
    gate = Event()

    def interrupted() -> Iterator[Future[Any]]:
        with thread_pool(1) as pool:
            yield pool.submit(gate.wait, 60)
            yield pool.submit(twice, 1)
            raise KeyboardInterrupt

    work = interrupted()
    pending, later = next(work), next(work)
    with pytest.raises(KeyboardInterrupt):
        next(work)
    assert not pending.done()
    assert later.cancelled()
    gate.set()


def test_a_bar_shows_maps_rate_and_time_left(capsys: pytest.CaptureFixture[str]) -> None:
    """And from where it goes on; one that is not shown prints nothing."""
    with bar(True, 10, initial=4) as advance:
        advance(6)
    assert "10/10" in capsys.readouterr().err
    with bar(False, 10) as advance:
        advance(6)
    assert capsys.readouterr() == ("", "")


def test_a_bar_shows_a_note_while_its_count_stays(capsys: pytest.CaptureFixture[str]) -> None:
    """The first note at once; a later one replaces it."""
    with bar(True, 10, unit=" problems") as advance:
        advance(0, "16 maps tried")
        assert " 0/10" in capsys.readouterr().err.rpartition("16 maps tried")[0]
        advance(10, "32 maps tried")
    assert "32 maps tried" in capsys.readouterr().err
    with bar(False, 10) as advance:
        advance(0, "16 maps tried")
    assert capsys.readouterr() == ("", "")


# --- processes ----------------------------------------------------------------------------------


def spawned(workers: int) -> ProcessPoolExecutor:
    """Return a pool of fresh processes, as on every platform."""
    return ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))


class Dying(ProcessPoolExecutor):
    """A pool one of whose workers is killed when some tasks are given, as the system kills one that
    takes too much.
    """

    def submit(
        self, function: Callable[..., Any], /, *arguments: object, **options: object
    ) -> Future[Any]:
        """Take a task."""
        future = super().submit(function, *arguments, **options)
        if self._queue_count == 3:
            os.kill(next(iter(self._processes)), signal.SIGKILL)
        return future


@pytest.mark.slow
def test_processes_and_one_that_dies(tmp_path: Path) -> None:
    """A pool of processes makes the same files; when one dies the build ends all the same, after a
    warning.
    """
    truth = make(tmp_path / "truth")
    with spawned(2) as pool:
        assert make(tmp_path / "whole", workers=None, executor=pool) == truth
    with (
        Dying(1, mp_context=multiprocessing.get_context("spawn")) as pool,
        pytest.warns(UserWarning, match="Threads of this process make the other shards"),
    ):
        assert make(tmp_path / "broken", workers=None, executor=pool) == truth
    for root in (tmp_path / "whole", tmp_path / "broken"):
        assert read_manifest(root) == truth
        assert verify(root) == []
        assert sorted(path.name for path in root.iterdir() if path.name != ".lock") == sorted(
            names(MAPS, SIZE)
        )


class Elsewhere(InTheCaller):
    """A worker that sees another disk under the same path."""

    def submit(
        self, function: Callable[..., Any], /, *arguments: object, **options: object
    ) -> Future[Any]:
        """Run ``function``, and lose what it wrote."""
        future = super().submit(function, *arguments, **options)
        (self.root / future.result().name).unlink()
        return future

    root: Path


def test_workers_must_share_the_folder(tmp_path: Path) -> None:
    """A manifest never lists what only another machine has."""
    pool = Elsewhere()
    pool.root = tmp_path / "maps"
    with pytest.raises(OSError, match="must share the folder"):
        make(tmp_path / "maps", workers=None, executor=pool)
    assert read_manifest(tmp_path / "maps").shards == ()


# --- parts and many shards ----------------------------------------------------------------------


@pytest.mark.parametrize("parts", [1, 2, 3, 7])
def test_parts(parts: int, tmp_path: Path) -> None:
    """In any order, more parts than shards included, the union is the whole; each part makes its
    own shards only.
    """
    truth = make(tmp_path / "truth")
    root = tmp_path / "maps"
    manifest: Manifest | None = None
    for k in reversed(range(parts)):
        before = set() if manifest is None else {entry.start for entry in manifest.shards}
        manifest = build(
            root, SPEC, maps=MAPS, seed=SEED, shard_size=SIZE, workers=1, part=(k, parts)
        )
        assert {entry.start for entry in manifest.shards} - before == set(
            range(k * SIZE, MAPS, parts * SIZE)
        )
        assert manifest.complete == (k == 0 or (parts > k >= 3 and len(manifest.shards) == 3))
    assert manifest == truth == read_manifest(root)


@pytest.mark.parametrize("part", [(1, 1), (-1, 2), (0, 0), (0.5, 2), (1,), 5])
def test_parts_that_cannot_be(part: Any, tmp_path: Path) -> None:
    """They are counted from 0."""
    expected = r"(\(k, n\) with 0 <= k < n|2 integers|an integer)"
    with pytest.raises(ValueError, match=f"^part: got .*, expected {expected}"):
        build(tmp_path / "maps", SPEC, maps=MAPS, seed=SEED, part=part)
    assert not (tmp_path / "maps").exists()


def test_writing_the_manifest_takes_a_twentieth_of_a_build(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Shards of 0.1 s and manifests of 5 s, on our own clock: the longer it takes, the more seldom
    it is written.
    """
    clock = {"now": 0.0, "written": 0.0}

    def write(_: Path, mine: Manifest, *, wait: bool = True) -> Manifest:
        clock["now"] += 5
        clock["written"] += 5
        return mine

    def shard(number: int) -> Any:
        clock["now"] += 0.1
        return entries[number % len(entries)]

    entries = make(tmp_path / "maps").shards
    monkeypatch.setattr("mapdata.shards.builder.merge", write)
    monkeypatch.setattr("mapdata.shards.builder.time.monotonic", lambda: clock["now"])
    monkeypatch.setattr(
        "mapdata.shards.builder._built_entries", lambda *_: (shard(k) for k in range(10_000))
    )
    build(tmp_path / "maps", SPEC, maps=MAPS + 1, seed=SEED, shard_size=SIZE)
    assert clock["now"] > 1000
    assert 0.03 < clock["written"] / clock["now"] < 0.06
