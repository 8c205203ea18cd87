"""The manifest: text and back, sums and plans, refusals, merging, sweeping, entries."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import pickle
import re
import socket
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import h5py
import pytest
from helpers.builds import SPEC, restated, shard_name
from helpers.examples import examples
from helpers.specs import specs
from hypothesis import given
from hypothesis import strategies as st

import mapdata
from mapdata import DatasetNotFoundError, MapSpec, ShardError, build, identity
from mapdata.generators import as_recipe
from mapdata.limits import SPLITS
from mapdata.shards import MANIFEST, PROVENANCE, Manifest, read_manifest, write_file
from mapdata.shards.builder import planned_headers
from mapdata.shards.header import is_shard_name
from mapdata.shards.manifest import Entry, parse_manifest
from mapdata.shards.merging import LOCK, load_shard, merge, sweep, union

SETTINGS = examples(60)
HASH = "0123456789abcdef" * 4


def entry_of(start: int, stop: int, content: str = HASH) -> Entry:
    """Return an entry for a shard that nobody wrote."""
    problems = dict.fromkeys(("maps", "route", "route_unsolvable", "rooms", "rooms_unsolvable"), 0)
    counts = dict.fromkeys(
        ("segments", "drawn", "reachable", "all_connected", "most_rooms"), stop - start
    )
    splits = {split: dict(problems) for split in SPLITS}
    return Entry(shard_name(start, stop), start, stop, 4096, HASH, content, {**counts, **splits})


def manifest_of(
    generator: MapSpec, seed: int, maps: int, shard_size: int, done: int = 0
) -> Manifest:
    """Return a manifest whose first ``done`` shards are finished."""
    planned = Manifest(
        generator,
        seed,
        generator.map_size,
        generator.movement,
        generator.resolution,
        maps,
        shard_size,
    )
    return replace(planned, shards=tuple(entry_of(*limits) for limits in planned.plan[:done]))


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of three shards; tests leave it as it is."""
    root = tmp_path_factory.mktemp("built") / "maps"
    build(root, SPEC, maps=8, seed=5, shard_size=3, workers=1)
    return root


# --- text and back ------------------------------------------------------------------------------


@SETTINGS
@given(
    specs(),
    st.integers(0, 2**64 - 1),
    st.integers(1, 50),
    st.integers(1, 20),
    st.integers(0, 50),
    st.booleans(),
)
def test_text_round_trip(
    generator: MapSpec, seed: int, maps: int, shard_size: int, done: int, imported: bool
) -> None:
    """A manifest comes back from its text equal, finished or not, with and without a recipe."""
    manifest = manifest_of(generator, seed, maps, shard_size, done)
    if imported:
        manifest = replace(manifest, generator=None, seed=None)
    again = parse_manifest(manifest.to_json(), "text")
    assert again == manifest
    assert again.to_json() == manifest.to_json()
    assert again.identity == (None if imported else identity(generator, seed))


def test_the_manifest_on_disk_is_its_text(built: Path) -> None:
    """The file is the text of what is read from it, and its hash is over all its other values."""
    text = (built / MANIFEST).read_text(encoding="utf-8")
    assert read_manifest(built).to_json() == text == restated(text, lambda _: None)


def test_the_recipe_states_all_that_makes_the_maps(built: Path) -> None:
    """The recipe states all that makes the maps, and what they hash to; imported maps have none."""
    manifest = read_manifest(built)
    recipe = json.loads(manifest.recipe())
    assert list(recipe) == ["format_version", "spec", "seed", "maps", "identity", "content_hash"]
    assert MapSpec.from_dict(recipe["spec"]) == SPEC
    assert (recipe["seed"], recipe["maps"], recipe["identity"]) == (5, 8, identity(SPEC, 5))
    assert recipe["content_hash"] == manifest.content_hash
    with pytest.raises(ValueError, match="imported"):
        replace(manifest, generator=None, seed=None).recipe()
    assert as_recipe(recipe).generator == SPEC
    with pytest.raises(ValueError, match="is not that of its spec and seed"):
        as_recipe({**recipe, "seed": 6})


def test_a_manifest_is_not_read_beyond_its_limit(
    built: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its size is looked at first: a file of many gigabytes takes no memory."""
    size = (built / MANIFEST).stat().st_size
    monkeypatch.setattr("mapdata.shards.manifest.MAX_MANIFEST_BYTES", size)
    assert read_manifest(built).done == 8
    monkeypatch.setattr("mapdata.shards.manifest.MAX_MANIFEST_BYTES", size - 1)
    with pytest.raises(ShardError, match=f"larger than {size - 1} bytes"):
        read_manifest(built)


@SETTINGS
@given(st.integers(1, 200), st.integers(1, 70), st.integers(0, 200))
def test_plan_and_sums(maps: int, shard_size: int, done: int) -> None:
    """The plan covers every map once, in order; sums are over finished shards."""
    manifest = manifest_of(SPEC, 0, maps, shard_size, done)
    assert [i for start, stop in manifest.plan for i in range(start, stop)] == list(range(maps))
    assert all(stop - start == shard_size for start, stop in manifest.plan[:-1])
    finished = manifest.shards
    assert manifest.complete == (done >= len(manifest.plan))
    assert manifest.total("segments") == sum(entry.stop - entry.start for entry in finished)
    assert manifest.content_hash == f"{int(HASH, 16) * len(finished) % 2**256:064x}"
    assert [(header.start, header.stop) for header in planned_headers(manifest)] == manifest.plan


# --- names --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("start", "stop"), [(0, 1), (1000, 2000), (10**12 - 1, 10**12), (10**15, 10**15 + 7)]
)
def test_shard_names(start: int, stop: int) -> None:
    """Names have at least twelve digits, sort like their maps, and are known as names."""
    name = entry_of(start, stop).file_name
    assert is_shard_name(name)
    assert [int(part) for part in re.findall(r"\d+", name[:-3])] == [start, stop]


NOT_NAMES = [
    "../maps-000000000000-000000000003.h5",
    "a/maps-000000000000-000000000003.h5",
    "/etc/passwd",
    "..",
    "",
    "maps-0-3.h5",
    "maps-000000000000-000000000003.h5\n",
    "maps-000000000000-000000000003.h5.tmp",
    ".maps-000000000000-000000000003.h5",
    "maps-00000000000a-000000000003.h5",
    "maps--00000000001-000000000003.h5",
    "manifest.json",
]


@pytest.mark.parametrize("name", NOT_NAMES)
def test_other_names_are_never_opened(name: str, built: Path) -> None:
    """A manifest that lists another file, its hash made to fit, is refused by name."""
    assert not is_shard_name(name)
    text = (built / MANIFEST).read_text(encoding="utf-8")
    text = restated(text, lambda values: values["shards"][1].update(name=name))
    with pytest.raises(ShardError, match=re.escape(f"{name!r} is not the name of a shard")):
        parse_manifest(text, "text")


# --- what is refused ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "damaged"),
        ("{", "damaged"),
        ("null", "damaged"),
        ("5", "damaged"),
        ("[]", "damaged"),
        ("{}", "damaged"),
        ('"mapdata"', "damaged"),
        ('{"format":"minari"}', "not a manifest of mapdata"),
        ('{"format":"mapdata"}', "damaged"),
        ("[" * 100_000, "damaged"),
        (
            '{"format":"mapdata","format_version":4}',
            r"format version 4, this mapdata [\d.]+ reads 1 to 3",
        ),
        ('{"format":"mapdata","format_version":"1"}', "format version 1"),
    ],
)
def test_other_texts_are_refused(text: str, says: str, tmp_path: Path) -> None:
    """No manifest, a damaged one, or another version: file and fault are named."""
    (tmp_path / MANIFEST).write_text(text, encoding="utf-8")
    with pytest.raises(ShardError, match=says) as caught:
        read_manifest(tmp_path)
    assert str(caught.value).startswith(f"{tmp_path / MANIFEST}: ")


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    """A manifest is UTF-8."""
    (tmp_path / MANIFEST).write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ShardError, match="damaged"):
        read_manifest(tmp_path)


def test_a_flipped_bit_changes_no_value(built: Path) -> None:
    """Any flipped bit is refused, or lies in white space and changes no value."""
    text = (built / MANIFEST).read_bytes()
    manifest = read_manifest(built)
    random = Random(1)
    refused = 0
    for _ in range(600):
        damaged = bytearray(text)
        damaged[random.randrange(len(text))] ^= 1 << random.randrange(8)
        try:
            assert parse_manifest(damaged.decode(), "text") == manifest
        except (ShardError, UnicodeDecodeError):
            refused += 1
    assert refused > 300


def shards_of(values: dict[str, Any], order: list[int]) -> None:
    """List shards in another order, or twice, with the content hash that fits them."""
    values["shards"] = [values["shards"][k] for k in order]
    total = sum(int(entry["content_hash"], 16) for entry in values["shards"])
    values.update(content_hash=f"{total % 2**256:064x}")


LIES: dict[str, Callable[[dict[str, Any]], object]] = {
    "no maps": lambda values: values.pop("maps"),
    "no shards": lambda values: values.pop("shards"),
    "more files than there can be": lambda values: values.update(maps=10**15),
    "shards a number": lambda values: values.update(shards=5),
    "a shard is a number": lambda values: values["shards"].append(5),
    "a shard without a name": lambda values: values["shards"][0].pop("name"),
    "a shard knows more": lambda values: values["shards"][0].update(colour="red"),
    "a name is a number": lambda values: values["shards"][0].update(name=7),
    "a side is missing": lambda values: values.update(map_size=[16]),
    "another spec": lambda values: values.update(spec=[]),
    "many small files": lambda values: values.update(maps=5 * 10**7, shard_size=5),
    "sides that are fractions": lambda values: values.update(map_size=[16.0, 16.0]),
    "three sides": lambda values: values.update(map_size=[16, 16, 16]),
    "resolution a text": lambda values: values.update(resolution="fine"),
    "a shard twice": lambda values: shards_of(values, [0, 0, 1, 2]),
    "shards out of order": lambda values: shards_of(values, [1, 0, 2]),
    "a shard behind the end": lambda values: values.update(maps=6),
    "shards of another size": lambda values: values.update(shard_size=4),
    "connectivity 5": lambda values: values["movement"].update(connectivity=5),
}
UNCHECKED: dict[str, Callable[[dict[str, Any]], object]] = {
    "maps a text": lambda values: values.update(maps="8"),
    "maps a fraction": lambda values: values.update(maps=8.0),
    "maps negative": lambda values: values.update(maps=-1),
    "shard size 0": lambda values: values.update(shard_size=0),
    "shard size a text": lambda values: values.update(shard_size="3"),
    "seed a word": lambda values: values.update(seed="five"),
    "start a text": lambda values: values["shards"][0].update(start="0"),
    "bytes a text": lambda values: values["shards"][0].update(bytes="4096"),
    "content hash no hash": lambda values: values["shards"][0].update(content_hash="no"),
    "counts a number": lambda values: values["shards"][0].update(counts=5),
    "fewer problems than none": lambda values: values["shards"][0]["counts"]["val"].update(
        route=-1
    ),
    "counts missing": lambda values: values["shards"][0].update(counts={}),
    "name of another shard": lambda values: values["shards"][0].update(name=shard_name(3, 6)),
}


@pytest.mark.parametrize(
    "lie",
    [
        *(pytest.param(lie, id=name) for name, lie in LIES.items()),
        *(pytest.param(lie, id=name) for name, lie in UNCHECKED.items()),
    ],
)
def test_values_that_cannot_be_are_refused(
    lie: Callable[[dict[str, Any]], object], built: Path
) -> None:
    """Values of other types, their hash made to fit, are refused on reading, not met later."""
    text = restated((built / MANIFEST).read_text(encoding="utf-8"), lie)
    with pytest.raises(ShardError, match=r"^text: "):
        parse_manifest(text, "text")


@pytest.mark.parametrize("kind", ["nothing", "an empty folder", "a file"])
def test_no_dataset(kind: str, tmp_path: Path) -> None:
    """What was looked for, why it is not there, and what makes one."""
    root = tmp_path / "maps"
    if kind == "an empty folder":
        root.mkdir()
    elif kind == "a file":
        root.write_text("maps", encoding="utf-8")
    with pytest.raises(DatasetNotFoundError) as caught:
        read_manifest(root)
    message = str(caught.value)
    assert message.startswith(f"no dataset at {root}: ")
    assert (f"'mapdata build {root}'" in message) == (kind != "a file")
    assert ("Give the folder of a dataset" in message) == (kind == "a file")
    assert ("no manifest.json there" in message) == (kind == "an empty folder")
    assert isinstance(caught.value, FileNotFoundError)


def test_the_error_crosses_processes(tmp_path: Path) -> None:
    """What a worker raises says the same in its parent."""
    for error in (
        DatasetNotFoundError(tmp_path, "it does not exist"),
        DatasetNotFoundError(tmp_path, "it is a file", "Give its folder"),
    ):
        assert str(pickle.loads(pickle.dumps(error))) == str(error)


# --- merging ------------------------------------------------------------------------------------


def test_merge_is_a_union(tmp_path: Path) -> None:
    """What two builders finished stands in the manifest of both, in the order of the maps."""
    whole = manifest_of(SPEC, 1, 10, 4, done=3)
    first = replace(whole, shards=whole.shards[2:])
    second = replace(whole, shards=whole.shards[:1])
    assert merge(tmp_path, first) == first == read_manifest(tmp_path)
    assert merge(tmp_path, second).shards == (whole.shards[0], whole.shards[2])
    assert merge(tmp_path, whole) == whole == read_manifest(tmp_path)
    assert merge(tmp_path, replace(whole, shards=())) == whole
    assert (tmp_path / MANIFEST).read_text(encoding="utf-8") == whole.to_json()


def test_merge_keeps_the_larger_dataset(tmp_path: Path) -> None:
    """A builder of fewer maps does not shrink what another extends, nor list its partial shard."""
    small = manifest_of(SPEC, 1, 6, 4, done=2)
    large = manifest_of(SPEC, 1, 10, 4, done=2)
    for first, second in ((small, large), (large, small)):
        merge(tmp_path, first)
        union = merge(tmp_path, second)
        assert union.maps == 10
        assert [(entry.start, entry.stop) for entry in union.shards] == [(0, 4), (4, 8)]
        (tmp_path / MANIFEST).unlink()


def test_merge_removes_what_a_larger_shard_replaced(tmp_path: Path) -> None:
    """The partial shard of a builder of fewer maps goes when the manifest no longer lists it."""
    small = manifest_of(SPEC, 1, 6, 4, done=2)
    large = manifest_of(SPEC, 1, 10, 4, done=2)
    for entry in (*small.shards, *large.shards):
        (tmp_path / entry.name).touch()
    merge(tmp_path, large)
    merge(tmp_path, small)
    assert sorted(path.name for path in tmp_path.glob("maps-*")) == [
        shard_name(0, 4),
        shard_name(4, 8),
    ]


def test_a_union_lists_every_map_once(tmp_path: Path) -> None:
    """Of two partial last shards, left by builders of fewer maps, it takes the longer."""
    whole = manifest_of(SPEC, 1, 12, 4, done=2)
    nine = replace(whole, maps=9, shards=(*whole.shards, entry_of(8, 9)))
    ten = replace(whole, maps=10, shards=(*whole.shards, entry_of(8, 10)))
    for first, second in ((nine, ten), (ten, nine)):
        both = union(replace(first, maps=12), second)
        assert [(entry.start, entry.stop) for entry in both.shards] == [(0, 4), (4, 8), (8, 10)]
        assert parse_manifest(both.to_json(), "text") == both


@pytest.mark.parametrize(
    "other",
    [manifest_of(SPEC, 2, 6, 4), manifest_of(SPEC, 1, 6, 3), manifest_of(MapSpec(), 1, 6, 4)],
)
def test_merge_refuses_another_dataset(other: Manifest, tmp_path: Path) -> None:
    """A dataset of another seed, shard size or spec that appeared meanwhile is left alone."""
    merge(tmp_path, other)
    with pytest.raises(ValueError, match="another dataset"):
        merge(tmp_path, manifest_of(SPEC, 1, 6, 4, done=1))
    assert read_manifest(tmp_path) == other


def test_merge_waits_for_the_lock_unless_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a repair found would be lost otherwise."""
    asked: list[bool] = []

    def ask(_: object, wait: bool = False) -> bool:
        asked.append(wait)
        return True

    monkeypatch.setattr("mapdata.shards.merging.take_lock", ask)
    merge(tmp_path, manifest_of(SPEC, 1, 10, 4))
    merge(tmp_path, manifest_of(SPEC, 1, 10, 4), wait=False)
    assert asked == [True, False]


def test_merge_can_do_without_waiting(tmp_path: Path) -> None:
    """One that does not wait leaves the manifest to the other builder until that is done."""
    whole = manifest_of(SPEC, 1, 10, 4, done=3)
    merge(tmp_path, replace(whole, shards=()))
    with open(tmp_path / LOCK, "ab") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        assert merge(tmp_path, whole, wait=False) == whole
        assert read_manifest(tmp_path).shards == ()
    assert merge(tmp_path, whole, wait=False) == whole == read_manifest(tmp_path)


def test_merge_needs_no_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file system that has none says so, and is written to all the same."""

    def flock(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", flock)
    whole = manifest_of(SPEC, 1, 10, 4, done=3)
    assert merge(tmp_path, whole, wait=False) == whole == read_manifest(tmp_path)


# --- the lock -----------------------------------------------------------------------------------


@pytest.mark.parametrize("what", ["pipe", "folder", "link out", "link to nothing", "link inside"])
def test_a_lock_is_a_plain_file(what: str, tmp_path: Path) -> None:
    """A pipe is not waited for, a link not followed, and nothing is made behind it."""
    root = tmp_path / "maps"
    root.mkdir()
    outside = tmp_path / "outside"
    inside = root / "README.md"
    inside.touch()
    if what == "pipe":
        os.mkfifo(root / LOCK)
    elif what == "folder":
        (root / LOCK).mkdir()
    else:
        target = {"link out": tmp_path / "file", "link to nothing": outside, "link inside": inside}
        (tmp_path / "file").touch()
        (root / LOCK).symlink_to(target[what])
    with pytest.raises((ShardError, OSError), match=re.escape(str(root / LOCK))) as caught:
        merge(root, manifest_of(SPEC, 1, 6, 3))
    assert "\n" not in str(caught.value)
    assert what == "link inside" or "expected a plain file" in str(caught.value)
    assert not outside.exists()
    assert not (root / MANIFEST).exists()


# --- sweeping -----------------------------------------------------------------------------------

TEMPORARIES = [
    f".{shard_name(0, 3)}.1234567890abcdef.mapdata.tmp",
    f".{shard_name(0, 3)}.1234567890abcdef.tmp",
    f".{MANIFEST}.1234567890abcdef.tmp",
    f".{PROVENANCE}.1234567890abcdef.tmp",
    f".{shard_name(0, 3)}-0.PROCESS.tmp",
    f".{shard_name(0, 3)}-0.elsewhere.1.tmp",
]
"""Names of `write_file`, today's and those that earlier versions gave; PROCESS is this host and
this process.
"""


def is_swept(path: Path) -> bool:
    """Tell whether a file goes."""
    sweep(path.parent, manifest_of(SPEC, 1, 6, 3))
    return not path.exists()


@pytest.mark.parametrize("name", TEMPORARIES)
def test_sweep_leaves_what_is_locked(name: str, tmp_path: Path) -> None:
    """A temporary file stays while its builder lives, which holds a lock, and no longer.

    Process numbers and host names are equal in two containers, so they tell nothing.
    """
    path = tmp_path / name.replace("PROCESS", f"{socket.gethostname()}.{os.getpid()}")
    with open(path, "xb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert not is_swept(path)
    assert is_swept(path)


def test_a_writer_holds_the_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Others may sweep as often as they like while it writes."""
    true_fsync = os.fsync
    seen: list[Path] = []

    def fsync(descriptor: int) -> None:
        paths = list(tmp_path.glob(".*.tmp"))
        assert not any(is_swept(path) for path in paths)
        seen.extend(paths)
        true_fsync(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    write_file(tmp_path / MANIFEST, b"whole")
    assert len(seen) == 1
    assert os.listdir(tmp_path) == [MANIFEST]


@pytest.mark.parametrize("kind", ["that fail", "that do nothing"])
def test_without_locks_age_tells(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where a file system has no locks, what was written to within a day stays."""

    def flock(*_: object) -> None:
        if kind == "that fail":
            raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", flock)
    path = tmp_path / TEMPORARIES[0]
    path.touch()
    now = path.stat().st_mtime
    for age, goes in ((0, False), (80_000, False), (90_000, True)):
        os.utime(path, (now - age, now - age))
        assert is_swept(path) == goes


@pytest.mark.parametrize("name", [".notes.tmp", shard_name(0, 3), f"{MANIFEST}.tmp", ".git.tmp"])
def test_sweep_takes_only_what_mapdata_wrote(name: str, tmp_path: Path) -> None:
    """Files of other names are no business of a builder."""
    (tmp_path / name).touch()
    assert not is_swept(tmp_path / name)


def test_sweep_takes_no_folders_and_pipes(tmp_path: Path) -> None:
    """Nor does it stumble over them."""
    (tmp_path / TEMPORARIES[0]).mkdir()
    os.mkfifo(tmp_path / TEMPORARIES[1])
    assert not is_swept(tmp_path / TEMPORARIES[0])
    assert (tmp_path / TEMPORARIES[1]).exists()


def test_what_is_swept_too_early_is_written_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever takes a temporary file away, the file gets its name, and it is whole."""
    true_replace = os.replace
    left = 2

    def replace_later(source: Path, target: Path) -> None:
        nonlocal left
        left -= 1
        if left >= 0:
            assert is_swept(source)
        true_replace(source, target)

    monkeypatch.setattr(os, "replace", replace_later)
    write_file(tmp_path / MANIFEST, b"whole")
    assert (tmp_path / MANIFEST).read_bytes() == b"whole"
    assert os.listdir(tmp_path) == [MANIFEST]
    with pytest.raises(FileNotFoundError):
        write_file(tmp_path / "gone" / MANIFEST, b"whole")


def test_sweep_takes_what_a_larger_shard_replaced(tmp_path: Path) -> None:
    """A partial shard that a listed one replaces goes, as after a builder that died; no other."""
    stay = [(0, 4), (4, 8), (8, 10), (8, 12), (12, 13)]
    for limits in (*stay, (4, 6), (4, 7)):
        (tmp_path / shard_name(*limits)).touch()
    sweep(tmp_path, manifest_of(SPEC, 1, 10, 4, done=3))
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        shard_name(*limits) for limits in stay
    ]


# --- entries ------------------------------------------------------------------------------------


def test_load_shard_gives_the_entry(built: Path) -> None:
    """What the manifest says of a shard can be derived from the file."""
    manifest = read_manifest(built)
    assert (
        tuple(load_shard(built, header) for header in planned_headers(manifest)) == manifest.shards
    )


@pytest.mark.parametrize(
    "damage", ["missing", "empty", "truncated", "bit in a map", "bit in a path", "bit in a text"]
)
def test_load_shard_takes_no_damaged_one(damage: str, built: Path, tmp_path: Path) -> None:
    """A shard that is not there, not whole, or does not hash to what it says gives None."""
    (header, *_) = planned_headers(read_manifest(built))
    name = header.file_name
    image = bytearray((built / name).read_bytes())
    with h5py.File(built / name, "r") as file:
        places = {
            "bit in a map": file["maps"].id.get_offset(),
            "bit in a path": file["bfs_moves"].id.get_offset(),
            # an attribute that only other programs read
            "bit in a text": image.index(b"occupancy"),
        }
    if damage in places:
        image[places[damage]] ^= 2
    if damage != "missing":
        (tmp_path / name).write_bytes(image[: {"empty": 0, "truncated": -1}.get(damage)])
    assert load_shard(tmp_path, header) is None


def test_load_shard_takes_no_other_maps(built: Path) -> None:
    """A sound shard of another range, seed or resolution gives None."""
    (header, *_) = planned_headers(read_manifest(built))
    for other in (
        replace(header, seed=6),
        replace(header, generator=replace(SPEC, resolution=0.2)),
    ):
        assert load_shard(built, other) is None
    assert load_shard(built, header) is not None


def test_entries_do_not_depend_on_the_library_version(
    built: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A later mapdata of the same format version reads the same manifest."""
    before = read_manifest(built)
    monkeypatch.setattr(mapdata, "__version__", "9.9")
    assert read_manifest(built) == before
