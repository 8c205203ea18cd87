"""Building a dataset beside the kernels alone, and what a newcomer waits for: python -m benchmarks
build.

Everything is measured in one run. Wall time, so the machine should be idle; every build starts from
an empty folder and ends with both hashes and all bytes on disk.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.measure import Row, each, interleaved, median_ratio, seconds, to_text
from mapdata import MapSpec, build, generate, label
from mapdata.shards import open_shard, write_file

PACKAGES = ("mapdata-torch", "numpy", "numba", "h5py")
SCRIPT = Path(__file__).parent.parent / "scripts" / "build_shards.py"
SPEC = MapSpec.preset("paper")
SHARD = 1000
HEAVY = ("torch", "lightning", "pytorch_lightning", "pandas", "matplotlib")
"""What ``import mapdata`` must not import."""


def kernels(maps: int) -> None:
    """Do what a build computes, shard by shard, and keep nothing."""
    for start in range(0, maps, SHARD):
        label(generate(SPEC, 0, range(start, min(start + SHARD, maps))))


def build_rows(
    folder: Path, maps: int, rounds: int, target: str, *, beside_kernels: bool
) -> list[Row]:
    """Return the rows of building ``maps`` maps with one worker and with two."""
    hashes = set()

    def run(workers: int) -> None:
        root = tempfile.mkdtemp(dir=folder)
        hashes.add(
            build(root, SPEC, maps=maps, seed=0, shard_size=SHARD, workers=workers).content_hash
        )

    def write() -> None:
        root = Path(tempfile.mkdtemp(dir=folder))
        for k, image in enumerate(images):
            write_file(root / f"{k}.bin", image)

    def clean() -> None:
        for root in folder.iterdir():
            shutil.rmtree(root)

    manifest = build(folder / "first", SPEC, maps=maps, seed=0, shard_size=SHARD)
    images = [(folder / "first" / entry.name).read_bytes() for entry in manifest.shards]
    size = sum(len(image) for image in images)
    clean()
    contestants = {"one": lambda: run(1), "two": lambda: run(2)}
    if beside_kernels:
        contestants |= {"kernels": lambda: kernels(maps), "write": write}
    times = interleaved(contestants, rounds, after=clean, clock=time.perf_counter)
    if hashes != {manifest.content_hash}:
        raise SystemExit(f"one and two workers gave different maps: content hashes {hashes}")
    one, two = times["one"], times["two"]
    ratio = median_ratio(one, two)
    rows = [
        Row(
            f"{maps:,} maps, 2 workers",
            each(two, 1),
            each(one, 1),
            f"{ratio:.2f}x",
            target,
            "1 worker, same content hash",
        )
    ]
    if beside_kernels:
        rate = maps / statistics.median(one)
        alone = maps / statistics.median(times["kernels"])
        share = median_ratio(times["kernels"], one)
        disk = f"{size / 1e6:.1f} MB in {len(images)} shards"
        rows = [
            Row(
                f"{maps:,} maps to disk, 1 worker",
                f"{each(one, 1)}, {rate:,.0f} maps/s",
                f"{each(times['kernels'], 1)}, {alone:,.0f} maps/s",
                f"{share:.2f}x",
                "0.72x",
                "generate and label alone, nothing kept",
            ),
            Row(
                "of which writing and fsync",
                each(times["write"], 1),
                note=f"{disk}, written once more with fsync",
            ),
            *rows,
        ]
    return rows


def opening_rows(folder: Path, rounds: int) -> list[Row]:
    """Return the rows of opening a shard of 10,000 maps, beside the hash of its file."""
    root = folder / "opened"
    entry = build(root, SPEC, maps=10_000, seed=0, shard_size=10_000).shards[0]
    path = root / entry.name
    # A copy's own size and hash are those of the manifest, and no process has compared it before.
    fresh = folder / "fresh"
    times: dict[str, list[float]] = {"with": [], "hash": [], "again": []}
    for _ in range(rounds):
        shutil.copyfile(path, fresh)
        times["with"].append(seconds(lambda: open_shard(fresh, entry.bytes, entry.sha256)))
        times["hash"].append(seconds(lambda: hashlib.sha256(path.read_bytes()).hexdigest()))
        # Its hash is known by now, as that of every shard after the first epoch.
        times["again"].append(seconds(lambda: open_shard(fresh, entry.bytes, entry.sha256)))
    return [
        Row(
            "open a shard of 10,000 maps, hash compared",
            each(times["with"], 1),
            each(times["hash"], 1),
            f"{median_ratio(times['hash'], times['with']):.2f}x",
            note=f"reading and hashing its {entry.bytes / 1e6:.1f} MB alone",
        ),
        Row("open it again, hash known", each(times["again"], 1), target="3 ms"),
    ]


def first_rows(folder: Path, repeats: int) -> list[Row]:
    """Return the rows of the very first build: a fresh process and no compiled kernel, then once
    more with them.
    """
    cold: list[float] = []
    warm: list[float] = []
    for k in range(repeats):
        cache = folder / f"cache-{k}"
        environment = {**os.environ, "XDG_CACHE_HOME": str(cache), "NUMBA_CACHE_DIR": str(cache)}
        for name, times in (("cold", cold), ("warm", warm)):
            command = [sys.executable, str(SCRIPT), str(folder / f"{name}-{k}")]
            times.append(_wall(command, environment)[0])
    return [
        Row(
            "first build ever, 10,000 maps, a process",
            each(cold, 1),
            target="8 s",
            note="compiles every kernel it needs",
        ),
        Row(
            "the next build, 10,000 maps, a process",
            each(warm, 1),
            note="kernels from the cache; imports included",
        ),
    ]


def import_rows(repeats: int) -> list[Row]:
    """Return the rows of imports, each in fresh processes."""
    rows = []
    for work, statement, target in (
        ("import mapdata", "import mapdata", "0.5 s"),
        ("import all that a build needs", "from mapdata import MapSpec, build", ""),
    ):
        program = (
            f"import sys, time; began = time.perf_counter(); {statement}; "
            "print(time.perf_counter() - began);"
        )
        program += f"print(', '.join(name for name in {HEAVY} if name in sys.modules) or 'none')"
        times, loaded = [], set()
        for _ in range(repeats):
            inside, names = _wall([sys.executable, "-c", program], dict(os.environ))[1].splitlines()
            times.append(float(inside))
            loaded.add(names)
        rows.append(
            Row(
                work,
                each(times, 1),
                target=target,
                note=f"of {', '.join(HEAVY)}: {', '.join(sorted(loaded))}",
            )
        )
    return rows


def _wall(command: list[str], environment: dict[str, str]) -> tuple[float, str]:
    """Return the wall seconds of a process, and what it printed."""
    output = []

    def run() -> None:
        output.append(
            subprocess.run(
                command, env=environment, check=True, capture_output=True, text=True
            ).stdout
        )

    return seconds(run, clock=time.perf_counter), output[0]


def table(quick: bool, parent: str | None = None) -> str:
    """Measure, and return the table; datasets are written below ``parent``, or the temporary
    folder.
    """
    rounds = 3 if quick else 9
    with tempfile.TemporaryDirectory(dir=parent) as name:
        folder = Path(name)
        (folder / "builds").mkdir()
        rows = build_rows(folder / "builds", 10_000, rounds, "1.6x", beside_kernels=True)
        if not quick:
            rows += build_rows(folder / "builds", 100_000, 5, "", beside_kernels=False)
        rows += opening_rows(folder, rounds)
        rows += first_rows(folder, 1 if quick else 3)
        rows += import_rows(5 if quick else 15)
    notes = (
        f"{rounds} repeats (100,000 maps: 5, first build: {1 if quick else 3})",
        f"preset paper, shards of {SHARD} maps",
    )
    return to_text("Building a dataset", rows, packages=PACKAGES, notes=notes)
