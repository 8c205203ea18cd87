"""Dask: a real cluster of processes, whose workers are killed and join while a build runs."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.builds import SPEC

from mapdata import build, verify
from mapdata.shards import read_manifest
from mapdata.shards.cluster import dask_executor

MAPS = 400
SHARD = 5
RECIPE = json.dumps({"spec": SPEC.to_dict(), "seed": 5, "maps": MAPS})

LOSSES = """
import logging, os, signal, sys, time
from concurrent.futures import Executor, Future
from importlib import import_module
from dask import config
from distributed import Client, LocalCluster
from mapdata import build
from mapdata.generators import as_recipe
from mapdata.shards.cluster import dask_executor

def located(function, *arguments):
    return os.getpid(), function(*arguments)

class Watching(Executor):  # kills a worker when so many shards are finished; half-way it waits for one that joins
    def __init__(self, inner, cluster):
        self.inner, self.cluster = inner, cluster
        self.given, self.places, self.killed = 0, [], []

    def submit(self, *task):
        while self.given == 40 and (len(self.places) < 40 or len(self.cluster.scheduler.workers) < 3):
            time.sleep(0.01)
        if self.given == 40:  # who joined has imported mapdata, too, before the others take what is left
            with Client(self.cluster, set_as_default=False) as client:
                client.run(import_module, "mapdata.shards.cluster", on_error="ignore")
        self.given += 1
        future = Future()
        self.inner.submit(located, *task).add_done_callback(lambda done: self.take(done, future))
        return future

    def take(self, done, future):
        place, entry = done.result()
        self.places.append(place)
        if len(self.places) in (5, 20, 45):
            nanny = self.cluster.workers[min(self.cluster.workers)]
            self.killed.append(nanny.pid)
            os.kill(nanny.pid, signal.SIGKILL)
        if len(self.places) == 10:
            self.cluster.scale(3)
        future.set_result(entry)

if __name__ == "__main__":
    recipe = as_recipe(sys.argv[2])
    config.set({"distributed.scheduler.allowed-failures": 100})
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, protocol="tcp", dashboard_address=None,
        silence_logs=logging.CRITICAL,
    ) as cluster:
        assert cluster.scheduler_address.startswith("tcp://")
        with dask_executor(cluster.scheduler_address) as inner:
            executor = Watching(inner, cluster)
            build(sys.argv[1], recipe.generator, maps=recipe.maps, seed=recipe.seed, shard_size=5, executor=executor)
            assert len(executor.places) == 80
            assert len(set(executor.killed)) == 3
            joined = cluster.workers[max(cluster.workers)].pid  # workers are numbered, the first one is killed
            assert joined in executor.places, "nobody joined"
    print("nothing lost")
"""


@pytest.fixture(scope="module")
def truth(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give the dataset that threads build."""
    root = tmp_path_factory.mktemp("truth") / "maps"
    build(root, SPEC, maps=MAPS, seed=5, shard_size=SHARD)
    return root


@pytest.mark.slow
def test_workers_are_killed_and_join(tmp_path: Path, truth: Path) -> None:
    """Three workers are killed and one joins: nothing is lost, the files are the same."""
    pytest.importorskip("distributed")
    script = tmp_path / "losses.py"
    script.write_text(LOSSES, encoding="utf-8")
    command = [sys.executable, str(script), str(tmp_path / "maps"), RECIPE]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "nothing lost\n"
    assert read_manifest(tmp_path / "maps") == read_manifest(truth)
    assert verify(tmp_path / "maps") == []


@pytest.mark.slow
def test_the_command_builds_on_a_cluster(tmp_path: Path, truth: Path) -> None:
    """``--scheduler`` takes the address of one that runs; its bar counts the maps."""
    distributed = pytest.importorskip("distributed")
    code = "from mapdata.cli import main; main()"
    flags = ["--recipe", RECIPE, "--shard-size", str(SHARD)]
    build_maps = [sys.executable, "-c", code, "build", str(tmp_path / "maps"), *flags]
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        protocol="tcp",
        dashboard_address=None,
    ) as cluster:
        build_maps += ["--scheduler", cluster.scheduler_address]
        done = subprocess.run(build_maps, capture_output=True, text=True, check=False, timeout=300)
        assert done.returncode == 0, done.stderr
        assert "400/400" in done.stderr
        build_maps += ["--workers", "2"]
        done = subprocess.run(build_maps, capture_output=True, text=True, check=False, timeout=300)
        assert done.returncode == 2
        assert "workers: would do nothing beside an executor" in done.stderr
    assert read_manifest(tmp_path / "maps") == read_manifest(truth)


def test_schedulers_that_cannot_be(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is named: no address, Dask not installed."""
    with (
        pytest.raises(ValueError, match="got 'dask', expected tcp://HOST:PORT"),
        dask_executor("dask"),
    ):
        pass
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(ValueError, match="pip install distributed"),
        dask_executor("tcp://127.0.0.1:1"),
    ):
        pass
