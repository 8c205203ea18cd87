"""Changes real files at random and reads them.

`PYTHONPATH=tests python -m helpers.fuzzing shards` (or `formats`) runs it. A case is a function of
(target, seed, number). Its files stand in the folder while it is read, so that a crash leaves them
behind; a case that hangs ends the program with a traceback, one that takes more than 200 MB of
address space runs out of memory. Expected are data, or the one error that the reader names.
"""

from __future__ import annotations

import argparse
import faulthandler
import hashlib
import random
import re
import resource
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

from helpers.foreign_files import SOURCES, Source
from helpers.samples import ALL_FIELDS
from helpers.specs import Noted
from mapdata import MapDataset, MapSpec, ShardError, Terrain, Waypoints, build
from mapdata.formats import FormatError, Limits, read_any
from mapdata.formats.movingai import check_scen
from mapdata.generators import register
from mapdata.movement import Movement
from mapdata.shards import MANIFEST, open_shard, read_manifest
from mapdata.shards.arrays import decode

SPEC = MapSpec(
    (12, 20),
    (2, 4),
    (2, 5),
    (2, 7),
    passage_width=(1, 2),
    skip_probability=0.4,
    splits=(0.4, 0.3, 0.3),
)
ROOM = 200 << 20
"""Address space that the cases may take, in bytes."""
HANGS = 300
"""Seconds after which a case hangs, on the busiest machine."""

Case: TypeAlias = Callable[[random.Random, Path], str]
"""Writes one case into an empty folder and reads it; returns what became of it."""


_ODD_BYTES = (b"\0", b"\xff", b"\x7f", b"-", b"9", b'"', b",", b"\n", b"[", b"e")
_ODD_INTEGERS = (0, 1, 2**31 - 1, 2**32 - 1, 2**40, 2**62, 2**63 - 1, 2**64 - 1)
_ODD_NUMBERS = (b"-1", b"1e999", b"nan", b"99999999999999999999", b"0x1", b"65536")


def changed(draw: random.Random, data: bytes) -> bytes:
    """Return ``data`` after one to four changes."""
    out = bytearray(data)
    for _ in range(draw.randint(1, 4)):
        at = draw.randrange(len(out) + 1)
        more = draw.randint(1, 16)
        what = draw.choice(("flip", "byte", "word", "copy", "insert", "delete", "cut", "number"))
        if what == "flip" and at < len(out):
            out[at] ^= 1 << draw.randrange(8)
        elif what == "byte":
            out[at : at + 1] = draw.choice(_ODD_BYTES)
        elif what == "word":
            word = draw.choice((*_ODD_INTEGERS, len(out), at))
            size = draw.choice((2, 4, 8))
            order = draw.choice(("little", "big"))
            out[at : at + size] = (word % 256**size).to_bytes(size, order)
        elif what == "copy":
            source = draw.randrange(len(out) + 1)
            out[at : at + more] = out[source : source + more]
        elif what == "insert":
            out[at:at] = draw.randbytes(more)
        elif what == "delete":
            del out[at : at + more]
        elif what == "number":
            out[at:at] = draw.choice(_ODD_NUMBERS)
        elif draw.random() < 0.2:
            del out[at:]
    return bytes(out)


# --- shards -------------------------------------------------------------------------------------


def shard_cases(folder: Path) -> Iterator[tuple[str, Case]]:
    """Yield the cases of each kind of shard: both movements, built, of terrain, and of a spec so
    long that its attributes lie in several blocks.
    """
    for connectivity in (4, 8):
        root = folder / f"maps{connectivity}"
        build(root, replace(SPEC, movement=Movement(connectivity)), maps=4, seed=1)
        yield f"{connectivity}-connected", _shard_case(root)
    terrain = Terrain((12, 20), seed_points=3, obstacles=0.2, movement=Movement(8))
    build(folder / "terrain", terrain, maps=4, seed=1)
    yield "terrain", _shard_case(folder / "terrain")
    register(Noted)
    build(folder / "long", Noted((12, 20), note="x" * 2000), maps=4, seed=1)
    yield "a long spec", _shard_case(folder / "long")


_SEALED = 28
"""Where the superblock says how long the file is."""


def sealed(draw: random.Random, image: bytes) -> bytes:
    """Return a shard that is changed, and most often says that it is as long as it is.

    One in two is changed in its metadata alone, where no byte moves.
    """
    data = bytearray(image)
    if draw.random() < 0.5:
        data[:] = changed(draw, image)
    else:
        for _ in range(draw.randint(1, 6)):
            # structures begin with their signature; a header leads to the next within 150 bytes
            signature = draw.choice(
                (b"OHDR", b"FRHP", b"FHDB", b"FHIB", b"BTHD", b"BTLF", b"\x89HDF")
            )
            begins = [found.start() for found in re.finditer(re.escape(signature), image)] or [0]
            at = draw.choice(begins) + draw.randrange(4, 150)
            size = draw.choice((1, 1, 2, 8))
            word = draw.choice((*_ODD_INTEGERS, len(image), at, *begins, draw.randrange(256)))
            data[at : at + size] = (word % 256**size).to_bytes(size, "little")
    if draw.random() < 0.9 and len(data) > _SEALED + 8:
        data[_SEALED : _SEALED + 8] = len(data).to_bytes(8, "little")
    return bytes(data)


def _read_all(root: Path, search: str, movement: Movement) -> None:
    """Read every problem of a dataset, with every field.

    Waypoints are filled, because a path through walls is no error of the other fields either. Maps
    with terrain have no taut lines.
    """
    fields: list[str | Waypoints] = [
        Waypoints(fill=True) if name == "waypoints" else name for name in ALL_FIELDS
    ]
    if read_manifest(root).has_terrain:
        fields = [name for name in ALL_FIELDS if name not in ("waypoints", "bends")]
    for problems in ("route", "pairs", "random"):
        MapDataset(root, fields=fields, problems=problems, search=search, movement=movement)[:]


def _shard_case(root: Path) -> Case:
    manifest = read_manifest(root)
    entry = manifest.shards[0]
    image = (root / entry.name).read_bytes()
    choices = [
        (search, Movement(connectivity)) for search in ("bfs", "astar") for connectivity in (4, 8)
    ]
    for choice in choices:  # compiles what there is to compile
        _read_all(root, *choice)

    def case(draw: random.Random, folder: Path) -> str:
        data = sealed(draw, image)
        (folder / entry.name).write_bytes(data)
        # The hash fits: who publishes a hostile shard publishes its manifest, too.
        digest = hashlib.sha256(data).hexdigest()
        shards = (replace(entry, bytes=max(len(data), 1), sha256=digest),)
        (folder / MANIFEST).write_text(replace(manifest, shards=shards).to_json())
        try:
            decode(open_shard(folder / entry.name))
            _read_all(folder, *draw.choice(choices))
        except ShardError as error:
            return _one_line(error)
        except ValueError as error:  # a map that is all walls now has no random problem
            if "none on one map after another" not in str(error):
                raise
        return "read"

    return case


# --- formats ------------------------------------------------------------------------------------

LIMITS = Limits(pixels=2**16, unpacked=2**22)


def format_cases(_: Path) -> Iterator[tuple[str, Case]]:
    """Yield the cases of each kind of foreign files."""
    for kind, source in SOURCES.items():
        yield f"{source.format}, {kind}", _format_case(source)


def _format_case(source: Source) -> Case:
    def case(draw: random.Random, folder: Path) -> str:
        chosen = draw.choice(sorted(source.files))
        spoiled = {**source.files, chosen: changed(draw, source.files[chosen])}
        source._replace(files=spoiled).write(folder)
        try:
            found = read_any(folder, source.format, LIMITS)
            for scen in folder.rglob("*.scen"):
                check_scen(scen, limits=LIMITS)
        except FormatError as error:
            return _one_line(error)
        return "left out" if found.left_out else "read"

    return case


def _one_line(error: Exception) -> str:
    if "\n" in str(error):
        raise AssertionError(f"an error of several lines: {error}")
    return "refused"


# --- the loop -----------------------------------------------------------------------------------

TARGETS = {"shards": shard_cases, "formats": format_cases}


def main() -> None:
    """Run cases until there are enough or the time is over, and print what became of them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("target", choices=TARGETS)
    parser.add_argument("--cases", type=int, default=10**9)
    parser.add_argument("--seconds", type=float, default=1e9)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="fuzzing-"))
    kinds = list(TARGETS[arguments.target](folder / "sound"))
    counts: Counter[str] = Counter()
    here = folder / "case"
    end = time.monotonic() + arguments.seconds
    slowest = 0.0
    limited = False
    for number in range(arguments.cases):
        kind, case = kinds[number % len(kinds)]
        shutil.rmtree(here, ignore_errors=True)
        here.mkdir()
        faulthandler.dump_traceback_later(HANGS, exit=True)
        began = time.monotonic()
        try:
            result = case(random.Random(f"{arguments.target} {arguments.seed} {number}"), here)
        except BaseException:
            print(
                f"{arguments.target}, seed {arguments.seed}, case {number} ({kind}): see {here}",
                file=sys.stderr,
            )
            raise
        faulthandler.cancel_dump_traceback_later()
        counts[f"{kind}: {result}"] += 1
        if number == 8 * len(kinds) and not limited:  # everything is imported and compiled by now
            size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            resource.setrlimit(resource.RLIMIT_AS, (size + ROOM, size + ROOM))
            limited = True
        elif limited:
            slowest = max(slowest, time.monotonic() - began)
        if time.monotonic() > end:
            break
    shutil.rmtree(folder)
    for name, count in sorted(counts.items()):
        print(f"{name}: {count}")
    print(f"cases: {sum(counts.values())}, slowest: {slowest:.2f} s")


if __name__ == "__main__":
    main()
