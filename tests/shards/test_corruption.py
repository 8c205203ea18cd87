"""Damage: verify names every file that is not what it was, repair makes just those again."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import h5py
import numpy as np
import pytest
from helpers.builds import (
    MAPS,
    SEED,
    SIZE,
    SOUND_TERRAIN,
    SPEC,
    Built,
    InTheCaller,
    listing,
    make,
    names,
    restated,
    shard_name,
    stamps,
)
from helpers.examples import Some, slow
from helpers.grids import random_grids
from helpers.imported import collection

import mapdata
from mapdata import DatasetNotFoundError, MapGenerator, repair, verify
from mapdata.cli import main
from mapdata.formats import import_maps
from mapdata.shards import MANIFEST, PROVENANCE, Manifest, corruption, read_manifest
from mapdata.shards.dataset_files import load_manifest
from mapdata.shards.files import temporary_path
from mapdata.shards.merging import announced


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Give the path of a root that does not exist yet."""
    return tmp_path / "maps"


# --- verify -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def finished(request: pytest.FixtureRequest, built: Built) -> Path:
    """A finished dataset, of rooms unless the test asks for others; tests leave it as it is."""
    generator: MapGenerator = getattr(request, "param", SPEC)
    return built(generator, maps=MAPS, seed=SEED, shard_size=SIZE)


with_terrain = pytest.mark.parametrize(
    "finished", [SPEC, SOUND_TERRAIN], ids=["rooms", "terrain"], indirect=True
)


@pytest.fixture
def copied(finished: Path, root: Path) -> Path:
    """Give a copy of the finished dataset to damage."""
    shutil.copytree(finished, root)
    return root


def named(root: Path) -> Iterator[str]:
    """Yield the name of the file that each fault names."""
    for fault in verify(root):
        path, _, _ = fault.partition(": ")
        assert Path(path).parent == root
        yield Path(path).name


@with_terrain
def test_verify_finds_every_flipped_bit(some: Some, copied: Path) -> None:
    """One bit at many random places of every file: that file is named, and no other."""
    random = Random(3)
    for name in names(MAPS, SIZE):
        image = (copied / name).read_bytes()
        for _ in range(some(25)):
            damaged = bytearray(image)
            damaged[random.randrange(len(image))] ^= 1 << random.randrange(8)
            (copied / name).write_bytes(damaged)
            assert list(named(copied)) == [name]
        (copied / name).write_bytes(image)
    assert verify(copied) == []


@pytest.mark.parametrize("length", [0, 1, 100, 8192, -1])
def test_verify_finds_truncation(length: int, copied: Path) -> None:
    """Each file cut short is named."""
    for name in names(MAPS, SIZE):
        image = (copied / name).read_bytes()
        (copied / name).write_bytes(image[:length])
        assert list(named(copied)) == ([name] if len(image) > length else [])
        (copied / name).write_bytes(image)
    assert verify(copied) == []


def test_verify_finds_swapped_shards(copied: Path) -> None:
    """Two shards under each other's names are both named."""
    one, other = (copied / shard_name(*limits) for limits in ((0, 4), (4, 8)))
    one.rename(copied / "aside")
    other.rename(one)
    (copied / "aside").rename(other)
    assert list(named(copied)) == [one.name, other.name]


def test_verify_finds_a_shard_that_a_fitting_manifest_swaps(copied: Path) -> None:
    """A manifest made to fit swapped files is refused by what the shards say of themselves."""
    one, other = (copied / shard_name(*limits) for limits in ((0, 4), (4, 8)))
    one.rename(copied / "aside")
    other.rename(one)
    (copied / "aside").rename(other)

    def swap(values: dict[str, Any]) -> None:
        first, second = values["shards"][:2]
        for key in ("bytes", "sha256", "content_hash", "counts"):
            first[key], second[key] = second[key], first[key]

    (copied / MANIFEST).write_text(
        restated((copied / MANIFEST).read_text(encoding="utf-8"), swap), encoding="utf-8"
    )
    assert [name for name in named(copied) if name != MANIFEST] == [one.name, other.name]
    assert all("holds other maps" in fault for fault in verify(copied) if "maps-" in fault)


def test_verify_finds_a_missing_shard(copied: Path) -> None:
    """A shard that is gone is named, and so are those that no manifest lists."""
    (copied / shard_name(4, 8)).unlink()
    assert verify(copied) == [f"{copied / shard_name(4, 8)}: missing"]
    manifest = read_manifest(copied)
    (copied / MANIFEST).write_text(
        replace(manifest, shards=manifest.shards[:1]).to_json(), encoding="utf-8"
    )
    assert verify(copied) == [
        f"{copied / shard_name(4, 8)}: missing (the build did not finish)",
        f"{copied / shard_name(8, 11)}: finished, not listed yet: build again",
    ]


def test_verify_names_strange_files(copied: Path, tmp_path: Path) -> None:
    """A shard of another dataset under a name of its own, programs, other programs' leftovers.

    What belongs there, what hides and folders are not named; nothing is deleted.
    """
    make(tmp_path / "other", maps=3)
    strange = (shard_name(100, 103), "setup.exe", "notes.txt", "x.tmp", ".x.tmp", "maps-1.h5")
    shutil.copy(tmp_path / "other" / shard_name(0, 3), copied / strange[0])
    for name in strange[1:]:
        (copied / name).touch()
    (copied / "link").symlink_to("nowhere")
    for name in ("README.md", "recipe.json", ".lock", ".gitattributes", f".{MANIFEST}.1f.tmp"):
        (copied / name).touch()
    (copied / "64x64").mkdir()
    assert sorted(named(copied)) == sorted((*strange, "link"))
    assert f"{copied / strange[0]}: no file of this dataset: keep it elsewhere" in verify(copied)
    assert sorted(repair(copied)) == sorted(verify(copied))
    for name in (*strange, "link"):
        (copied / name).unlink()
    assert verify(copied) == []


def test_verify_shows_how_far_it_is_without_a_manifest(
    copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Looking at all shards for what the dataset was takes long."""
    (copied / MANIFEST).unlink()
    with pytest.raises(SystemExit, match="1"):
        main(["verify", str(copied)])
    printed = capsys.readouterr().err
    assert re.search(r"3/3 \[.* shards/s\]", printed)
    assert re.search(rf"{MAPS}/{MAPS} \[.* maps/s\]", printed)


@pytest.mark.parametrize("name", [MANIFEST, shard_name(4, 8)])
def test_a_pipe_is_not_waited_for(name: str, copied: Path) -> None:
    """Verify names what is a pipe, a folder, or a link in a circle."""
    for make_strange in (os.mkfifo, os.mkdir, lambda path: os.symlink(path, path)):
        shutil.move(copied / name, copied.with_name("aside"))
        make_strange(copied / name)
        assert next(named(copied)) == name
        if make_strange is os.mkdir:
            (copied / name).rmdir()
        else:
            (copied / name).unlink()
        shutil.move(copied.with_name("aside"), copied / name)
    assert verify(copied) == []


@pytest.mark.parametrize(
    ("finished", "dataset"),
    [(SPEC, "astar_iterations"), (SOUND_TERRAIN, "terrain")],
    ids=["rooms", "terrain"],
    indirect=["finished"],
)
def test_verify_finds_other_labels(dataset: str, copied: Path) -> None:
    """A shard whose file hashes are made to fit still has its content hash against it."""
    path = copied / shard_name(4, 8)
    image = bytearray(path.read_bytes())
    with h5py.File(path, "r") as file:
        offset, values = file[dataset].id.get_offset(), file[dataset][()]
    image[offset + int(np.flatnonzero(values > 1)[0]) * values.itemsize] ^= 1
    path.write_bytes(image)
    digest = hashlib.sha256(image).hexdigest()
    text = (copied / MANIFEST).read_text(encoding="utf-8")
    lie = restated(text, lambda values: values["shards"][1].update(sha256=digest))
    (copied / MANIFEST).write_text(lie, encoding="utf-8")
    assert verify(copied) == [f"{path}: damaged (its content hash does not fit)"]


def test_verify_finds_other_counts(copied: Path) -> None:
    """Counts, by which datasets number their problems, are derived from the shards too."""
    text = (copied / MANIFEST).read_text(encoding="utf-8")
    lie = restated(text, lambda values: values["shards"][1]["counts"].update(reachable=0))
    (copied / MANIFEST).write_text(lie, encoding="utf-8")
    assert verify(copied) != []


def test_verify_lives_with_other_library_versions(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A dataset that an earlier mapdata of the same format version wrote is not damaged."""
    monkeypatch.setattr(mapdata, "__version__", "9.9")
    assert verify(finished) == []


def test_verify_changes_nothing(finished: Path) -> None:
    """It reads."""
    before = stamps(finished)
    text = (finished / MANIFEST).read_bytes()
    assert verify(finished) == []
    assert (stamps(finished), (finished / MANIFEST).read_bytes()) == (before, text)


def test_verify_needs_a_dataset(tmp_path: Path) -> None:
    """Without one it says what was looked for."""
    with pytest.raises(DatasetNotFoundError, match="no dataset at"):
        verify(tmp_path)


def test_verify_finds_a_missing_manifest(copied: Path) -> None:
    """Where shards are, a manifest belongs."""
    (copied / MANIFEST).unlink()
    assert verify(copied) == [f"{copied / MANIFEST}: missing"]


def test_verify_checks_the_shards_of_a_damaged_manifest(copied: Path) -> None:
    """One damage does not hide another: shards say themselves what they hold."""
    (copied / MANIFEST).write_text("{", encoding="utf-8")
    (copied / shard_name(0, 4)).write_bytes(flipped(copied / shard_name(0, 4), "astar_moves"))
    (copied / shard_name(4, 8)).unlink()
    assert list(named(copied)) == [MANIFEST, shard_name(0, 4), shard_name(4, 8)]


def described_otherwise(path: Path) -> bytes:
    """Return a shard file with a bit flipped that only other programs read, in a description."""
    image = bytearray(path.read_bytes())
    image[image.index(b"occupancy")] ^= 1
    return bytes(image)


def test_damage_that_only_h5py_reads_is_named_without_a_manifest(
    finished: Path, copied: Path
) -> None:
    """The shards that no manifest lists are whole for every HDF5 program, or made again."""
    path = copied / shard_name(4, 8)
    path.write_bytes(described_otherwise(path))
    before = stamps(copied)
    (copied / MANIFEST).unlink()
    assert list(named(copied)) == [MANIFEST, path.name]
    assert "incorrect metadata checksum" in verify(copied)[1]
    assert repair(copied) == []
    assert images(copied) == images(finished)
    assert [name for name, stamp in stamps(copied).items() if stamp != before[name]] == [path.name]


def test_finished_shards_of_a_killed_extension_are_no_strange_files(
    copied: Path, tmp_path: Path
) -> None:
    """The build that goes on lists them as they are, and removes the partial shard."""
    make(tmp_path / "larger", maps=18)
    shorter = (copied / shard_name(8, 11)).read_bytes()
    more = [shard_name(8, 12), shard_name(12, 16), shard_name(16, 18)]
    for name in more:
        shutil.copy(tmp_path / "larger" / name, copied)
    lines = [f"{copied / name}: finished, not listed yet: build again" for name in more]
    assert verify(copied) == lines
    assert repair(copied) == lines
    before = stamps(copied)
    make(copied, maps=18)
    assert {name: before[name] for name in more} == {name: stamps(copied)[name] for name in more}
    assert verify(copied) == []
    replaced = copied / shard_name(8, 11)
    for remove in (partial(make, copied, 18), partial(repair, copied)):
        replaced.write_bytes(shorter)
        assert verify(copied) == [
            f"{replaced}: replaced by a shard of more maps: the next build or repair removes it"
        ]
        remove()
        assert not replaced.exists()
        assert verify(copied) == []


# --- a running build ------------------------------------------------------------------------------


class Watched(InTheCaller):
    """Builds in the caller, and does something whenever a shard is finished."""

    def __init__(self, look: Callable[[], object]) -> None:
        """Keep what is done."""
        self.look = look

    def submit(
        self, function: Callable[..., Any], /, *arguments: object, **options: object
    ) -> Future[Any]:
        """Build a shard."""
        future = super().submit(function, *arguments, **options)
        self.look()
        return future


def test_what_a_running_build_has_not_finished_is_no_fault(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What is there is checked, and a note says how much that is; damage is named as always."""
    root = tmp_path / "maps"
    seen: list[list[str]] = []

    def look() -> None:
        with pytest.warns(
            UserWarning, match=f"is running, {len(seen) + 1} of 3 shards are finished"
        ):
            seen.append(verify(root))
        main(["verify", str(root)])
        assert f"{root}: no faults found\nnote: {root}: a build or" in capsys.readouterr().out
        first = root / shard_name(0, 4)
        sound = first.read_bytes()
        first.write_bytes(sound[:-1])
        with pytest.warns(UserWarning, match="is running"):
            (fault,) = verify(root)
        assert str(first) in fault
        first.write_bytes(sound)

    make(root, executor=Watched(look), workers=None)
    assert seen == [[], [], []]
    assert verify(root) == []
    assert not list(root.glob(".*.tmp"))


def test_a_replaced_shard_is_no_fault_of_a_running_build(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The manifest that was read first lists the short shard, which is gone when its turn comes."""
    root = tmp_path / "maps"
    make(root)
    read = load_manifest
    extended: list[Path] = []

    def load_old_manifest(location: str, follow_links: bool = False) -> Manifest:
        manifest = read(location, follow_links)
        if not extended:
            extended.append(root)
            make(root, 18)
        return manifest

    monkeypatch.setattr(corruption, "load_manifest", load_old_manifest)
    with announced(root), pytest.warns(UserWarning, match="is running, 5 of 5"):
        assert verify(root) == []


# --- repair -------------------------------------------------------------------------------------


def test_repair_removes_what_killed_writers_left(
    copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also where no file has a fault."""
    before = listing(copied)
    for name in (MANIFEST, shard_name(0, 4)):
        temporary_path(copied / name).write_bytes(b"half a file")
    assert verify(copied) == []
    main(["verify", str(copied), "--repair"])
    assert capsys.readouterr().out == f"{copied}: no faults found\n"
    assert listing(copied) == before


def flipped(path: Path, dataset: str) -> bytes:
    """Return a shard file with one bit of a dataset flipped."""
    image = bytearray(path.read_bytes())
    with h5py.File(path, "r") as file:
        image[file[dataset].id.get_offset()] ^= 4
    return bytes(image)


def flip(path: Path, random: Random) -> None:
    """Flip one bit of a file."""
    image = bytearray(path.read_bytes())
    image[random.randrange(len(image))] ^= 1 << random.randrange(8)
    path.write_bytes(image)


def images(root: Path) -> dict[str, bytes]:
    """Return all files of a root but the lock."""
    return {path.name: path.read_bytes() for path in root.iterdir() if path.name != ".lock"}


@with_terrain
@pytest.mark.parametrize("seed", [*range(4), *map(slow, range(4, 12))])
def test_repair_mends_whatever_happened(seed: int, finished: Path, copied: Path) -> None:
    """Files flipped, cut, deleted and swapped: each is named and repaired, no other is touched."""
    random = Random(seed)
    files = random.sample(names(MAPS, SIZE), random.randint(1, 3))
    shards = [name for name in files if name != MANIFEST]
    for name in files:
        path = copied / name
        how = random.choice(["flipped", "flipped", "cut", "deleted", "swapped"])
        if how == "cut":
            path.write_bytes(path.read_bytes()[: random.randrange(path.stat().st_size)])
        elif how == "deleted" and name != MANIFEST:
            path.unlink()
        elif how == "swapped" and len(shards) > 1 and name == shards[0]:
            one, other = ((copied / shard).read_bytes() for shard in shards[:2])
            (copied / shards[0]).write_bytes(other)
            (copied / shards[1]).write_bytes(one)
        elif path.exists() and (MANIFEST not in files or name == MANIFEST):
            flip(path, random)
        elif path.exists():  # no manifest to tell damage in the gaps between arrays from none
            path.write_bytes(path.read_bytes()[:-1])
    before = stamps(copied)
    assert sorted(named(copied)) == sorted(files)
    assert repair(copied) == []
    assert images(copied) == images(finished)
    assert {name for name, stamp in stamps(copied).items() if stamp != before.get(name)} <= set(
        files
    )
    assert verify(copied) == []


@pytest.mark.parametrize("gone", [False, True])
def test_repair_of_the_manifest_alone(gone: bool, finished: Path, copied: Path) -> None:
    """It is made from the shards, byte by byte what it was, and they stay as they are."""
    (copied / MANIFEST).write_text('{"shard_size": 4', encoding="utf-8")
    if gone:
        (copied / MANIFEST).unlink()
    before = stamps(copied)
    assert repair(copied) == []
    assert (images(copied), stamps(copied)) == (images(finished), before)


def test_a_small_dataset_keeps_its_shard_size(root: Path) -> None:
    """A dataset smaller than one shard can be extended after its manifest was repaired."""
    make(root, maps=3, shard_size=4)
    text = (root / MANIFEST).read_bytes()
    (root / MANIFEST).write_bytes(text[:-20])
    assert repair(root) == []
    assert (root / MANIFEST).read_bytes() == text


def test_repair_finishes_what_a_build_did_not(finished: Path, copied: Path) -> None:
    """A shard that was never made is a shard that is missing."""
    manifest = read_manifest(copied)
    (copied / MANIFEST).write_text(
        replace(manifest, shards=manifest.shards[:1]).to_json(), encoding="utf-8"
    )
    (copied / shard_name(8, 11)).unlink()
    assert repair(copied) == []
    assert images(copied) == images(finished)


def test_nothing_says_what_a_dataset_was(copied: Path) -> None:
    """Without a manifest and a readable shard there is no recipe: the message says what to do."""
    for name in names(MAPS, SIZE):
        (copied / name).write_bytes(b"\0" * 100)
    before = images(copied)
    lines = repair(copied)
    for line, name in zip(lines, names(MAPS, SIZE), strict=True):
        assert line.startswith(f"{copied / name}: damaged")
        assert line.endswith("run the same build again")
    assert images(copied) == before


def test_what_the_manifest_said_is_not_forgotten(finished: Path, copied: Path) -> None:
    """A shard made again with another content than the manifest says is an error, not a repair."""
    lie = restated(
        (copied / MANIFEST).read_text(encoding="utf-8"),
        lambda values: (
            values["shards"][1].update(content_hash="1" * 64)
            or values.update(content_hash=total(values))
        ),
    )
    (copied / MANIFEST).write_text(lie, encoding="utf-8")
    said = f"made again with content hash {read_manifest(finished).shards[1].content_hash}"
    for _ in range(2):  # nor is it the next time
        (line,) = repair(copied)
        assert said in line


def total(values: dict[str, Any]) -> str:
    """Return the content hash that a manifest's entries add up to."""
    return f"{sum(int(entry['content_hash'], 16) for entry in values['shards']) % 2**256:064x}"


@pytest.fixture
def imported(tmp_path: Path) -> Path:
    """Give a dataset of imported maps, in three shards."""
    (made,) = import_maps(
        tmp_path / "imported", collection(*random_grids(7)), seed_points=3, shard_size=3
    )
    return made.root


@pytest.mark.slow
def test_every_file_of_imported_maps_is_checked(imported: Path) -> None:
    """One bit at many random places: that file is named, and no other."""
    random = Random(4)
    for name in (
        MANIFEST,
        PROVENANCE,
        *(shard_name(start, min(start + 3, 7)) for start in (0, 3, 6)),
    ):
        image = (imported / name).read_bytes()
        for _ in range(25):
            flip(imported / name, random)
            assert [path for path in named(imported) if path != name] == []
            assert verify(imported) != []
            (imported / name).write_bytes(image)
        (imported / name).unlink()
        assert list(named(imported)) == [name]
        (imported / name).write_bytes(image)
    assert verify(imported) == []


def test_imported_maps_cannot_be_made_again(
    imported: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It says which, and how to get them back; the manifest is mended all the same; exit code 1
    until they are back.
    """
    path = imported / shard_name(3, 6)
    image = path.read_bytes()
    text = (imported / MANIFEST).read_bytes()
    path.write_bytes(flipped(path, "maps"))
    (imported / MANIFEST).write_bytes(text[:-9])
    with pytest.raises(SystemExit, match="1"):
        main(["verify", str(imported), "--repair"])
    printed = capsys.readouterr()
    assert (
        f"not repaired: {path}: damaged (its content hash does not fit); it cannot be made again, "
        "imported maps have no recipe: delete it and import again" in printed.out
    )
    assert printed.err.splitlines()[-1] == "mapdata: 1 of 2 not repaired"
    assert [entry.start for entry in read_manifest(imported).shards] == [0, 6]
    path.unlink()
    import_maps(imported, collection(*random_grids(7)), seed_points=3, shard_size=3)
    assert (path.read_bytes(), (imported / MANIFEST).read_bytes()) == (image, text)
    assert verify(imported) == []


@pytest.mark.parametrize("is_listed", [True, False])
def test_imported_maps_in_damaged_metadata_are_written_anew(
    is_listed: bool, imported: Path
) -> None:
    """They need no recipe: the file still holds them, though h5py cannot read it."""
    before = images(imported)
    path = imported / shard_name(3, 6)
    path.write_bytes(described_otherwise(path))
    if not is_listed:
        (imported / MANIFEST).unlink()
    assert list(named(imported)) == [MANIFEST] * (not is_listed) + [path.name]
    assert repair(imported) == []
    assert images(imported) == before


def test_imported_maps_with_an_attribute_more_are_written_anew(imported: Path) -> None:
    """Another program changed the file, and its maps and labels are still there."""
    before = images(imported)
    path = imported / shard_name(3, 6)
    with h5py.File(path, "r+") as file:
        file.attrs["by"] = "somebody"
    (line,) = verify(imported)
    assert line.startswith(f"{path}: has ")
    assert repair(imported) == []
    assert images(imported) == before


def test_imported_maps_of_another_program_must_be_imported_again(imported: Path) -> None:
    """Neither with a manifest nor without can they be read; the line says what to do instead."""
    path = imported / shard_name(3, 6)
    with h5py.File(path, "r+") as file:
        file["maps"].attrs["by"] = "somebody"
    for _ in range(2):
        (line,) = repair(imported)
        assert line.startswith(f"{path}: ")
        assert line.endswith(
            "it cannot be made again, imported maps have no recipe: delete it and import again"
        )
        (imported / MANIFEST).unlink()


def test_other_imported_maps_are_not_taken_for_a_repair(imported: Path, tmp_path: Path) -> None:
    """A sound shard of the same numbers whose content is not what the manifest states."""
    (other,) = import_maps(
        tmp_path / "other", collection(*random_grids(8)[1:]), seed_points=3, shard_size=3
    )
    path = imported / shard_name(3, 6)
    image = (other.root / path.name).read_bytes()
    path.write_bytes(image)
    (line,) = repair(imported)
    assert "it cannot be made again" in line
    assert path.read_bytes() == image


def test_the_command_repairs(
    finished: Path, copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """verify: exit code 1 and a line a file; with --repair exit code 0, and no faults are left."""
    (copied / shard_name(0, 4)).write_bytes(flipped(copied / shard_name(0, 4), "bfs_moves"))
    (copied / shard_name(8, 11)).unlink()
    with pytest.raises(SystemExit, match="1"):
        main(["verify", str(copied)])
    assert "mapdata: 2 faults found; --repair" in capsys.readouterr().err
    main(["verify", str(copied), "--repair"])
    printed = capsys.readouterr()
    assert printed.out.splitlines()[-1] == f"{copied}: 2 repaired"
    assert re.search(r"7/7 \[.*<.*maps/s\]", printed.err)  # maps, time left and rate of the repair
    assert images(copied) == images(finished)
    main(["verify", str(copied), "--repair"])
    assert capsys.readouterr().out == f"{copied}: no faults found\n"
