"""Faults: builders killed at every step and at random times, full and read-only disks, many
builders at once, Ctrl-C.

What kills or forks runs in a process of its own.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from helpers.builds import SPEC, names, stamps

from mapdata import MapDataset, MapSpec, build, verify
from mapdata.shards import MANIFEST, read_manifest

SLOW = pytest.mark.skipif(
    "config.getoption('-m') != 'slow'", reason="minutes long: run with -m slow"
)
FORKS = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")

# --- killed --------------------------------------------------------------------------------------

PRELUDE = f"""
import builtins, fcntl, os, random, signal, sys, time
from dataclasses import replace
from pathlib import Path
from mapdata import MapSpec, build, generate, label, verify
from mapdata.shards import Manifest, read_manifest
from mapdata.shards.builder import planned_headers
from mapdata.shards.merging import load_shard
from mapdata.shards.image import shard_image

spec, root = MapSpec.from_json({SPEC.to_json()!r}), Path(sys.argv[1])
maps, size = 30, 2
planned = Manifest(spec, 5, spec.map_size, spec.movement, spec.resolution, maps, size)
for header in planned_headers(replace(planned, maps=1)):
    shard_image(label(generate(spec, 5, [0])), header)  # load the kernels

def child(place, before=lambda: None, maps=maps, workers=2, part=(0, 1)):
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            before()
            manifest = build(place, spec, maps=maps, seed=5, shard_size=size, workers=workers, part=part)
            code = 0 if part != (0, 1) or manifest.complete else 2
        finally:
            os._exit(code)
    return pid

def done(pid):
    assert os.waitpid(pid, 0)[1] == 0

def stamps(place):
    return {{path.name: (path.stat().st_ino, path.stat().st_mtime_ns) for path in place.glob("maps-*.h5")}}
"""

STEPS = """
class Steps:  # counts what a builder does to the disk, and ends it before the step of this number
    def __init__(self, last):
        self.left = last

    def step(self):
        self.left -= 1
        if self.left < 0:
            os.kill(os.getpid(), signal.SIGKILL)

    def watched(self, function):
        def call(*arguments, **options):
            self.step()
            return function(*arguments, **options)

        return call

    def watch(self):
        for name in ("mkdir", "fsync", "replace", "unlink", "close"):
            setattr(os, name, self.watched(getattr(os, name)))
        fcntl.flock = self.watched(fcntl.flock)
        plain = builtins.open

        def opened(file, mode="r", *arguments, **options):
            if not set(mode) & set("wax"):
                return plain(file, mode, *arguments, **options)
            self.step()
            return Halves(plain(file, mode, *arguments, **options), self.step)

        builtins.open = opened

class Halves:  # a file that reaches the disk in two halves
    def __init__(self, file, step):
        self.file, self.step, self.fileno = file, step, file.fileno

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.step()
        self.file.close()

    def write(self, data):
        for half in (data[: len(data) // 2], data[len(data) // 2 :]):
            self.file.write(half)
            self.file.flush()
            self.step()

    def flush(self):
        self.file.flush()

def killed(place, last, count):  # whether the builder was killed, and not finished
    pid = child(place, Steps(last).watch, maps=count, workers=1)
    return os.WIFSIGNALED(os.waitpid(pid, 0)[1])

def sound(place):  # what stands under a final name is complete
    for path in place.glob("maps-*.h5"):
        start, stop = map(int, path.stem.split("-")[1:])
        (header,) = planned_headers(replace(planned, maps=stop, shard_size=stop - start)) if start == 0 else (
            header for header in planned_headers(replace(planned, maps=stop)) if header.start == start)
        assert load_shard(place, header) is not None, f"{path.name} is torn"
    if (place / "manifest.json").exists():
        manifest = read_manifest(place)
        assert all((place / entry.name).stat().st_size == entry.bytes for entry in manifest.shards)

counts = [int(count) for count in sys.argv[2].split(",")]  # maps, built one after another: the second extends
done(child(root / "truth", maps=counts[-1]))
truth = {path.name: path.read_bytes() for path in (root / "truth").iterdir()}
number = 0
while True:
    place = root / f"killed-{number}"
    for count in counts[:-1]:
        done(child(place, maps=count))
    before = stamps(place)
    stopped = killed(place, number, counts[-1])
    if place.exists():
        sound(place)
        before |= stamps(place)
    done(child(place, maps=counts[-1]))
    after = stamps(place)
    assert all(after[name] == before[name] for name in after if name in before), f"step {number}: made twice"
    assert {path.name: path.read_bytes() for path in place.iterdir()} == truth, f"step {number}: another result"
    if not stopped:
        break
    number += 1
print(number)
"""

KILLS = """
done(child(root / "truth"))
truth = read_manifest(root / "truth").content_hash
draws = random.Random(int(sys.argv[2]))
for number in range(int(sys.argv[3])):
    place = root / str(number)
    for shards in sorted(draws.sample(range(maps // size), 2)):  # killed, and killed again while it goes on
        pid = child(place)
        while len(stamps(place)) < shards and os.waitpid(pid, os.WNOHANG) == (0, 0):
            time.sleep(0.0005)
        time.sleep(0.004 * draws.random())  # anywhere between two shards
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
    before = stamps(place)
    for header in planned_headers(planned):
        name = header.file_name
        assert (name in before) == (load_shard(place, header) is not None), f"{name} is torn"
    done(child(place))
    assert read_manifest(place).content_hash == truth
    assert verify(place) == []
    after = stamps(place)
    assert all(after[name] == stamp for name, stamp in before.items()), "a finished shard was made again"
    assert not list(place.glob(".*.tmp")), "a dead builder's file is left"
    print(len(before), end=" ")
"""

TOGETHER = """
unlocked = lambda: setattr(fcntl, "flock", lambda *_: None)
before = unlocked if sys.argv[2] == "unlocked" else lambda: None
place, other = root / "together", root / "alone"
for pid in [child(place, before) for _ in range(4)]:
    done(pid)
assert verify(place) == []  # of what others do meanwhile nothing is promised without locks
done(child(other))
assert read_manifest(place) == read_manifest(other)
assert sorted(path.name for path in place.iterdir()) == sorted(path.name for path in other.iterdir())
assert all((place / name).read_bytes() == (other / name).read_bytes() for name in stamps(other))
print("one result")
"""


PARTS = """
def unlocked():  # as on a file system whose locks do nothing
    fcntl.flock = lambda *_: None

before = unlocked if sys.argv[2] == "unlocked" else lambda: None
place, other = root / "together", root / "alone"
for pid in [child(place, before, part=(k, 4)) for k in range(4)]:
    done(pid)
made = stamps(place)
done(child(other))
assert set(made) == set(stamps(other)), "the parts are not the whole"
assert read_manifest(place).complete  # the last part lists what a merge without a lock lost
assert verify(place) == []
done(child(place, before))
assert stamps(place) == made, "a shard was made twice"
assert all((place / path.name).read_bytes() == path.read_bytes() for path in other.iterdir())
print("one result")
"""

JOBS = """
from mapdata import MapDataModule
recipe = '{"maps": 3000, "seed": 3}'

def job():
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            MapDataModule(str(root / "together"), build=recipe).prepare_data()
            code = 0 if read_manifest(root / "together").complete else 2
        finally:
            os._exit(code)
    return pid

for pid in [job() for _ in range(4)]:
    done(pid)
manifest = build(root / "alone", MapSpec(), maps=3000, seed=3)
assert read_manifest(root / "together") == manifest
assert verify(root / "together") == []
print("one result")
"""


def run_script(code: str, *arguments: object) -> str:
    """Run a script that forks builders, in a process without threads; return what it prints."""
    command = [sys.executable, "-c", PRELUDE + code, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@FORKS
@pytest.mark.slow
def test_a_killed_build_continues(tmp_path: Path) -> None:
    """SIGKILL at random times, five builds, each killed twice: no torn shard under a final name,
    none made twice.
    """
    assert len(run_script(KILLS, tmp_path, 1, 5).split()) == 5


@SLOW
@pytest.mark.soak
@FORKS
def test_a_killed_build_continues_fifty_times(tmp_path: Path) -> None:
    """The same, fifty builds."""
    counts = [int(count) for count in run_script(KILLS, tmp_path, 2, 50).split()]
    assert len(set(counts)) > 5, "the kills came at few places"


@FORKS
@pytest.mark.parametrize("counts", ["3", "3,4"], ids=["anew", "extended"])
@pytest.mark.slow
def test_a_builder_killed_at_every_step(counts: str, tmp_path: Path) -> None:
    """SIGKILL before each call that changes the disk, half-written files included: no torn file
    under a final name; building goes on to the files of an undisturbed build, nothing else is left,
    no finished shard is made twice.
    """
    assert int(run_script(STEPS, tmp_path, counts)) > 20


# --- many at once -------------------------------------------------------------------------------


@FORKS
@pytest.mark.parametrize("lock", ["locked", "unlocked"])
@pytest.mark.slow
def test_four_builders_make_one_dataset(lock: str, tmp_path: Path) -> None:
    """Four processes on one root: the result, file by file, is that of one; also without locks."""
    assert run_script(TOGETHER, tmp_path, lock) == "one result\n"


@FORKS
@pytest.mark.parametrize("lock", ["locked", "unlocked"])
@pytest.mark.slow
def test_parts_make_the_whole(lock: str, tmp_path: Path) -> None:
    """Four parts at once: each shard is made once, together they are what one builder makes."""
    assert run_script(PARTS, tmp_path, lock) == "one result\n"


WRITER = """
import os, sys, time
from pathlib import Path
from mapdata.shards import write_file
synced = os.fsync
def fsync(descriptor):  # the file is written, and not renamed yet
    print("written", flush=True)
    sys.stdin.read(1)
    os.fsync = synced
os.fsync = fsync
write_file(Path(sys.argv[1]), b"whole")
"""

SWEEPER = """
import sys
from pathlib import Path
from mapdata.shards import read_manifest
from mapdata.shards.merging import sweep
sweep(Path(sys.argv[1]), read_manifest(Path(sys.argv[1])))
"""

CONTAINER = ("unshare", "--pid", "--fork", "--mount-proc")
"""Runs a program with process numbers of its own, as a container does."""


@pytest.mark.skipif(sys.platform != "linux", reason="makes namespaces")
@pytest.mark.slow
def test_builders_in_two_containers(tmp_path: Path) -> None:
    """One whose process number means nothing to the other keeps its temporary file."""
    if subprocess.run([*CONTAINER, "true"], capture_output=True, check=False).returncode:
        pytest.skip("may not make namespaces")
    build(tmp_path, SPEC, maps=1, workers=1)
    (tmp_path / f".{MANIFEST}.left.tmp").touch()
    # some processes later, so that its number is none of a process in the other container
    later = f'for k in 1 2 3 4 5; do sh -c :; done; "{sys.executable}" -c "$0" "$1"; exit $?'
    writer = subprocess.Popen(
        [*CONTAINER, "sh", "-c", later, WRITER, str(tmp_path / "README.md")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    with writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == "written\n"
        (writing, left) = sorted(tmp_path.glob(".*.tmp"))
        subprocess.run([*CONTAINER, sys.executable, "-c", SWEEPER, str(tmp_path)], check=True)
        assert (writing.exists(), left.exists()) == (True, False)
        writer.communicate("\n")
    assert writer.returncode == 0
    assert (tmp_path / "README.md").read_bytes() == b"whole"


@FORKS
@pytest.mark.slow
def test_four_jobs_prepare_one_dataset(tmp_path: Path) -> None:
    """``prepare_data`` of four processes at once: one result."""
    assert run_script(JOBS, tmp_path) == "one result\n"


# --- full and read-only disks -------------------------------------------------------------------


@contextmanager
def mounted(folder: Path, *options: str) -> Iterator[Path]:
    """Mount something at a folder; skip where that is not allowed."""
    folder.mkdir()
    if subprocess.run(
        ["mount", *options, str(folder)], capture_output=True, check=False
    ).returncode:
        pytest.skip("may not mount file systems")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def command(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run ``mapdata`` in a process of its own."""
    program = [sys.executable, "-c", "from mapdata.cli import main; main()", *map(str, arguments)]
    return subprocess.run(program, capture_output=True, text=True, check=False)


def complaint(done: subprocess.CompletedProcess[str]) -> str:
    """Return the one line that an error is, beside the bar."""
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    (line,) = (line for line in done.stderr.splitlines() if line.startswith("mapdata: "))
    return line


@pytest.mark.skipif(sys.platform != "linux", reason="mounts a tmpfs")
@pytest.mark.slow
def test_a_full_disk(tmp_path: Path) -> None:
    """A real one: one line, exit code 2, only whole files under final names; with room again the
    build goes on.
    """
    arguments = ("--maps", 3000, "--shard-size", 500, "--seed", 3)
    with mounted(tmp_path / "disk", "-t", "tmpfs", "-o", "size=1000k", "tmpfs") as disk:
        line = complaint(command("build", disk / "maps", *arguments))
        assert f"No space left on device: '{disk / 'maps'}/" in line
        before = stamps(disk / "maps")
        assert 0 < len(before) < 6
        listed = {entry.name for entry in read_manifest(disk / "maps").shards}
        assert listed <= set(before)
        assert set(os.listdir(disk / "maps")) == {".lock", MANIFEST, *before}
        subprocess.run(["mount", "-o", "remount,size=8m", str(disk)], check=True)
        assert command("build", disk / "maps", *arguments).returncode == 0
        assert {
            name: stamp for name, stamp in stamps(disk / "maps").items() if name in before
        } == before
        truth = build(tmp_path / "truth", MapSpec(), maps=3000, shard_size=500, seed=3)
        assert read_manifest(disk / "maps") == truth
        assert verify(disk / "maps") == []


@pytest.mark.skipif(sys.platform != "linux", reason="mounts a folder")
@pytest.mark.slow
def test_a_read_only_disk(tmp_path: Path) -> None:
    """A root on a disk that nobody may write to: one line, nothing added; a finished one is built
    and verified.
    """
    build(tmp_path / "finished", MapSpec(), maps=20, shard_size=10)
    unfinished = read_manifest(tmp_path / "finished")
    (tmp_path / "empty").mkdir()
    for name in ("empty", "finished"):
        with mounted(
            tmp_path / f"{name}-mounted", "-o", "ro", "--bind", str(tmp_path / name)
        ) as folder:
            with pytest.raises(
                PermissionError, match=f"^root: no permission to write in {folder}$"
            ):
                build(folder, MapSpec(), maps=30, shard_size=10)
            if name == "finished":
                assert build(folder, MapSpec(), maps=20, shard_size=10) == unfinished
                assert verify(folder) == []
                assert "no permission" in complaint(
                    command("build", folder, "--maps", 30, "--shard-size", 10)
                )
    assert os.listdir(tmp_path / "empty") == []
    assert read_manifest(tmp_path / "finished") == unfinished


# --- Ctrl-C -------------------------------------------------------------------------------------


STOPPED = """
import signal, sys, threading
from mapdata.cli import main
from mapdata.shards import builder

# A background job of a shell, such as a CI's, ignores Ctrl-C unless it asks for it.
signal.signal(signal.SIGINT, signal.default_int_handler)
left, generate = int(sys.argv.pop(1)), builder.generate

def generated(*arguments):
    global left
    left -= 1
    if left == 0:
        signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
    return generate(*arguments)

builder.generate = generated
main()
"""
"""The command, with Ctrl-C pressed when it begins with the shard of this number."""


def stopped(root: Path, shard: int, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Build, and press Ctrl-C when this shard is begun, counted from 1."""
    program = [sys.executable, "-c", STOPPED, str(shard), "build", str(root), *map(str, arguments)]
    return subprocess.run(program, capture_output=True, text=True, check=False, timeout=300)


@pytest.mark.skipif(os.name == "nt", reason="sends SIGINT")
@pytest.mark.slow
def test_ctrl_c_does_not_wait_for_a_shard(tmp_path: Path) -> None:
    """Shards that take minutes each: it stops at once, with one line that says how to go on, and no
    traceback.
    """
    done = stopped(
        tmp_path / "maps", 1, "--preset", "dungeon128", "--maps", 10**6, "--shard-size", 10**5
    )
    assert done.returncode == 130
    assert done.stderr.splitlines()[-1] == "mapdata: stopped; run the same command again to go on"
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(os.name == "nt", reason="sends SIGINT")
@pytest.mark.slow
def test_the_same_command_goes_on(tmp_path: Path) -> None:
    """What was finished when it was stopped is not made again.

    A shard lasts milliseconds: the second, and one after it, may be finished before the signal
    arrives, but not all eight.
    """
    arguments = ("--maps", 2000, "--shard-size", 250, "--workers", 1)
    assert stopped(tmp_path / "maps", 2, *arguments).returncode == 130
    before = stamps(tmp_path / "maps")
    assert 1 <= len(before) < 8
    assert command("build", tmp_path / "maps", *arguments).returncode == 0
    after = stamps(tmp_path / "maps")
    assert {name: stamp for name, stamp in after.items() if name in before} == before
    assert sorted(after) == names(2000, 250)[1:]
    assert verify(tmp_path / "maps") == []


# --- many shards --------------------------------------------------------------------------------


@SLOW
@pytest.mark.soak
def test_ten_thousand_shards(tmp_path: Path) -> None:
    """Shards cost no more each when there are many; opening them takes a twentieth of that."""
    costs = []
    for shards in (1000, 10_000):
        began = time.process_time()
        build(tmp_path / str(shards), SPEC, maps=shards, shard_size=1, workers=1)
        costs.append((time.process_time() - began) / shards)
    assert costs[1] < 1.5 * costs[0]
    began = time.process_time()
    dataset = MapDataset(tmp_path / "10000", "train")
    opening = time.process_time() - began
    assert len(dataset) > 8000
    assert opening < 0.05 * costs[1] * 10_000
    print(
        f"{1e3 * costs[0]:.2f} and {1e3 * costs[1]:.2f} ms of CPU a shard; opened in "
        f"{opening:.2f} s"
    )


# --- long life ----------------------------------------------------------------------------------

MEMORY = """
import sys
from pathlib import Path
from mapdata.shards import builder as module
from mapdata import MapSpec

def resident():  # kB
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmRSS"))

class Seen(list):
    pass

seen, make = Seen(), module._built_entries
def made(*arguments):
    for entry in make(*arguments):
        seen.append(resident())
        yield entry
module._built_entries = made
module.build(Path(sys.argv[1]), MapSpec(), maps=30_000, shard_size=500, workers=2)
print(*seen)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.slow
def test_a_build_holds_its_memory(tmp_path: Path) -> None:
    """The last half of sixty shards needs no more memory than the first."""
    command = [sys.executable, "-c", MEMORY, str(tmp_path / "maps")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    seen = [int(kilobytes) for kilobytes in done.stdout.split()]
    assert len(seen) == 60
    assert max(seen[30:]) < 1.1 * max(seen[:30]), seen
