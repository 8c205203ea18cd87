"""Building: one content hash whatever the way; going on, extending, refusing, crashes."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from random import Random
from types import MappingProxyType
from typing import Any, TypeAlias

import h5py
import pytest
from helpers.builds import (
    MAPS,
    SEED,
    SIZE,
    SPEC,
    InTheCaller,
    listing,
    make,
    names,
    restated,
    shard_name,
    stamps,
    unprivileged_folder,
)
from helpers.examples import slow
from helpers.families import KNOWN as FAMILIES
from helpers.families import SMALL
from helpers.pages import DOCS

from mapdata import (
    MapDataset,
    MapGenerator,
    MapSpec,
    Maze,
    ShardError,
    Terrain,
    __version__,
    build,
    generate,
    identity,
    label,
    read_shard,
    repair,
    verify,
)
from mapdata.generators import Recipe, as_recipe
from mapdata.movement import Movement
from mapdata.shards import MANIFEST, Manifest, builder, content_hash, read_manifest
from mapdata.shards.builder import build_shard, planned_headers
from mapdata.shards.merging import merge

OTHER = replace(SPEC, skip_probability=0.2)
KNOWN: dict[str, Any] = {
    "recipe": SPEC,
    "maps": MAPS,
    "seed": SEED,
    "shard_size": SIZE,
    "workers": 1,
}
"""The arguments of the dataset of these tests."""

SLOW = pytest.mark.skipif(
    "config.getoption('-m') != 'slow'", reason="minutes long: run with -m slow"
)


Task: TypeAlias = Callable[..., Any]


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Give the path of a root that does not exist yet."""
    return tmp_path / "maps"


@pytest.fixture(scope="module")
def truth() -> str:
    """Return the content hash of the dataset of these tests, made without any file."""
    return content_hash(label(generate(SPEC, SEED, range(MAPS))))


# --- one content hash ---------------------------------------------------------------------------

# A change of one of these values is a change of the format: it needs a new format version, and a
# note in the changelog.
GOLDEN: list[tuple[MapGenerator, int, int, str, str]] = [
    (
        MapSpec(),
        0,
        10,
        "acc4e87d864f40d108ebc739dec8aac123d2a8ac377ed6ac2a1f092e7e6119a5",
        "356538d522b09c70e056be7ed6e395c79c2ae7e4b60549dac6914ade3b53fd87",
    ),
    (
        MapSpec(),
        0,
        100,
        "acc4e87d864f40d108ebc739dec8aac123d2a8ac377ed6ac2a1f092e7e6119a5",
        "137b3996dadab6b4313682f91ebc3bc788e8dd30fd48af1908e110b9e4fd2e4c",
    ),
    (
        MapSpec(movement=Movement(8)),
        0,
        10,
        "8fd3f60d41ca94a01c982d9ed7d4b5a0b486caf83a18f1e9de5d6cd6e3ec3d48",
        "9e79e8be216eb3ae5b8128eae987fd56934117e7109849fb3c83edb3138befa6",
    ),
    (
        MapSpec.preset("narrow"),
        2**64 - 1,
        10,
        "2aba7aa1a67976e2bc2e3a5e0be2da64a9c6368211315d31d70840f19e60e40a",
        "fc4034de37cbd81a31ea814a7f7087fc6d67589ef8d9ae8b14f810b9c2fb55fb",
    ),
    (
        MapSpec.preset("dungeon"),
        1,
        10,
        "9415e5222aeef70afa1ee4df54312ece79d975008c45025bb4853c4114671b34",
        "e4377922659a4f2f54b2e6b74c6c65abaa906159b8fad54ecf3fc9006be56c28",
    ),
    (
        replace(MapSpec.preset("dungeon"), movement=Movement(8)),
        1,
        10,
        "a714875c01ca8011d2951b80e8d82595d143d1e379708582a4f614e77557c21a",
        "37f58febd11305c0dd955604d3d048130ab7eea4496acfd9040a0285807451fa",
    ),
    (
        MapSpec.preset("dungeon128"),
        2,
        10,
        "7467ed992708108e6b694004c866dbd9fee488bd5d6969da9f83eaea3f6c8f37",
        "0f29073675eb1478e6350633f3034adde5be63a343fddd34a5e8c2628cb33d48",
    ),
    (
        SMALL["rooms"],
        3,
        10,
        "cc06891657fae2945870b84c10c2c6c7ec9f000be60fd06653c16b4f3fb74642",
        "f2e0bb0b16b2cb126977da61e16322a827b42b7505814777480aaace54d5330a",
    ),
    (
        SMALL["maze"],
        7,
        30,
        "e06e38dffb7bffacf95ab651a64dc9d1f5d7a87e3229a9fbc82d8038f522089a",
        "b672b9f72a36c3eaffde9fdc4910b9ce868b6e986d1cc04b7332354d7e006b14",
    ),
    (
        SMALL["cave"],
        7,
        30,
        "e7178de2e750b7b8e2c1eb57064c4b44af39a3890b5baec39a98ed323d7c78fe",
        "2d9bae2ece32e41fa6c3a5cafe553ea568c95a23674591211e44a2f664af45eb",
    ),
    (
        SMALL["forest"],
        7,
        30,
        "b4fb9fa8796a90215e12fc74fbfa27557b07f64ea6ac78609df6a29b6f06855a",
        "daee8d0cfa88cb54f409f48d51deb336d2d69edaf7276821b5a3bb0a63011043",
    ),
    (
        SMALL["random_walls"],
        7,
        30,
        "c5e9e7e0b9c77b59e43858f9017232af34194367423897c82d1376ff79b2f0b8",
        "3b154d25635e4d4666b8081c1313c59ab645dd65aea079ade48fae4eadd24a00",
    ),
    (
        SMALL["terrain"],
        7,
        30,
        "73fd110295b425c4377556562d8d34f2227a8b615ac48b99e3a8b14441dbc125",
        "ae903a386fb05e0cf06cf042c71c3a2b28be7870bf54e6552d38018b086c2d51",
    ),
    (
        MapGenerator.preset("tiles"),
        7,
        30,
        "0ede4016f19c05aa98df10d3f075f4d85fd824064578eef8558667ff8a918faa",
        "6d0db4f6e8cc4f9433987d0518e076e2f19f8edbc310ab8e705b63d352f8e11d",
    ),
    (
        SMALL["mixture"],
        7,
        30,
        "e7abd6fbb429545897ab92d550132c443604a0ee267be31e4985542c23101b92",
        "72e46b682d6fbe56a158fe5a6a95b4e57a11bef718439a52b0de40b36c9b07dd",
    ),
    (
        Terrain(costs=(1, 5, 200), over=SMALL["maze"]),
        7,
        30,
        "2d19e77c47874c9560543e4185545e8ad3d1dcfebb8a6bcb7865f17e8b8f0eaf",
        "74184bc23b6ef8e16bd7dac9746152e9f274fb00e0280418ca684172aaab588a",
    ),
]


@pytest.mark.parametrize(("generator", "seed", "maps", "name", "content"), GOLDEN)
def test_golden_hashes(
    generator: MapGenerator, seed: int, maps: int, name: str, content: str
) -> None:
    """The bytes are what they were, on every machine; docs/format.md states those of versions 2
    and 3.
    """
    assert identity(generator, seed) == name
    assert content_hash(label(generate(generator, seed, range(maps)))) == content
    if generator.format_version > 1:
        page = (DOCS / "format.md").read_text(encoding="utf-8")
        assert f"`{name}`" in page
        assert f"`{content}`" in page


def test_every_family_has_golden_hashes() -> None:
    """A new family gets a row above, and a generator in helpers/families.py."""
    families = ["rooms", "maze", "cave", "forest", "random_walls", "terrain", "mixture"]
    assert families == FAMILIES.split(", ") == list(SMALL)
    assert families == list(dict.fromkeys(generator.name for generator, *_ in GOLDEN))


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("shard_size", [1, 7, 1000])
def test_shard_size_and_workers_do_not_matter(
    shard_size: int, workers: int, root: Path, truth: str
) -> None:
    """The content hash is that of the maps themselves, and files lie where they should."""
    manifest = make(root, shard_size=shard_size, workers=workers)
    assert manifest.content_hash == truth
    assert manifest.complete
    assert manifest == read_manifest(root)
    assert listing(root) == names(MAPS, shard_size)
    assert verify(root) == []


class LastFirst(ThreadPoolExecutor):
    """Holds tasks back until the last one is there, then runs them in reverse."""

    def __init__(self, tasks: int = 3) -> None:
        """Wait for this many tasks."""
        super().__init__(1)
        self.tasks: list[tuple[Future[Any], Task]] = []
        self.awaited = tasks

    def submit(self, function: Task, /, *arguments: object, **options: object) -> Future[Any]:
        """Take a task."""
        future: Future[Any] = Future()
        self.tasks.append((future, lambda: function(*arguments, **options)))
        if len(self.tasks) == self.awaited:
            super().submit(self.run)
        return future

    def run(self) -> None:
        """Run all tasks, the last one first."""
        for future, task in self.tasks[::-1]:
            future.set_result(task())


@pytest.mark.parametrize("executor", [InTheCaller, LastFirst, ThreadPoolExecutor])
def test_any_executor_gives_the_same(
    executor: Callable[[], Executor], root: Path, truth: str
) -> None:
    """Whatever runs the shards, in whatever order, the dataset is the same file by file."""
    reference = make(root)
    images = {name: (root / name).read_bytes() for name in names(MAPS, SIZE)}
    shutil.rmtree(root)
    with executor() as pool:
        manifest = make(root, workers=None, executor=pool)
    assert manifest == reference
    assert manifest.content_hash == truth
    assert {name: (root / name).read_bytes() for name in names(MAPS, SIZE)} == images


@pytest.mark.parametrize("seed", [0, slow(1), slow(2), slow(3)])
def test_shards_made_in_any_order_are_adopted(seed: int, root: Path, truth: str) -> None:
    """Shards that others made, in random order and twice, are adopted and not made again."""
    planned = Manifest(SPEC, SEED, SPEC.map_size, SPEC.movement, SPEC.resolution, MAPS, 2)
    root.mkdir()
    todo = [*planned_headers(planned)] * 2
    Random(seed).shuffle(todo)
    for header in todo:
        build_shard(root, header)
    before = stamps(root)
    assert make(root, shard_size=2).content_hash == truth
    assert stamps(root) == before
    assert listing(root) == names(MAPS, 2)


@pytest.mark.parametrize("generator", [SPEC, MapSpec.preset("dungeon"), Maze((21, 21))])
def test_the_bar_moves_within_a_shard(
    generator: MapGenerator, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Labels of pieces, joined, are those of all maps at once."""
    monkeypatch.setattr("mapdata.search.labels._CELLS_AT_ONCE", 1)
    root.mkdir()
    (header,) = planned_headers(
        Manifest(
            generator, SEED, generator.map_size, generator.movement, generator.resolution, 30, 100
        )
    )
    moved: list[int] = []
    entry = build_shard(root, header, advance=moved.append)
    assert moved == [8, 8, 8, 6]
    assert entry.content_hash == content_hash(label(generate(generator, SEED, range(30))))
    assert build_shard(root, header, advance=moved.append) == entry
    assert moved[4:] == [30]


def test_a_bar_counts_every_map_once(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether threads or an executor make the shards, or some are there."""
    moved: list[int] = []

    @contextmanager
    def bar(
        shown: bool, total: int, initial: int = 0, unit: str = ""
    ) -> Iterator[Callable[[int], None]]:
        moved[:] = [initial]
        yield moved.append
        assert sum(moved) == total

    monkeypatch.setattr("mapdata.shards.builder.bar", bar)
    make(root, maps=6, shard_size=2)
    assert sum(moved) == 6
    make(root, maps=11, shard_size=2)
    assert (moved[0], sum(moved)) == (6, 11)
    with ThreadPoolExecutor(2) as pool:
        make(root.with_name("other"), shard_size=2, workers=None, executor=pool)
    assert (moved[0], sum(moved)) == (0, MAPS)


# --- going on and growing -----------------------------------------------------------------------


def test_a_second_run_makes_nothing(root: Path) -> None:
    """A finished dataset is left as it is, file by file."""
    first = make(root)
    before = stamps(root)
    text = (root / MANIFEST).read_bytes()
    assert make(root, workers=2) == first
    assert stamps(root) == before
    assert (root / MANIFEST).read_bytes() == text


@pytest.mark.parametrize(
    "how",
    [
        "missing",
        "truncated",
        "empty",
        pytest.param("longer"),
    ],
)
def test_only_what_is_missing_is_made_again(how: str, root: Path, truth: str) -> None:
    """A shard that is gone or of another size is made again, and no other one."""
    make(root)
    before = stamps(root)
    name = shard_name(4, 8)
    image = (root / name).read_bytes()
    (root / name).unlink()
    if how != "missing":
        (root / name).write_bytes(
            {"truncated": image[:-1], "longer": image + b"x", "empty": b""}[how]
        )
    assert make(root).content_hash == truth
    assert (root / name).read_bytes() == image
    after = stamps(root)
    assert after.pop(name) != before.pop(name)
    assert after == before
    assert verify(root) == []


def test_a_finished_shard_that_missed_the_manifest_is_adopted(root: Path) -> None:
    """A crash between a shard and the manifest costs nothing."""
    whole = make(root)
    before = stamps(root)
    text = (root / MANIFEST).read_bytes()
    (root / MANIFEST).write_text(
        replace(whole, shards=whole.shards[1:2]).to_json(), encoding="utf-8"
    )
    assert make(root) == whole
    assert stamps(root) == before
    assert (root / MANIFEST).read_bytes() == text


@pytest.mark.parametrize("dataset", ["maps", "astar_moves", "bfs_iterations"])
def test_a_damaged_shard_that_missed_the_manifest_is_made_again(dataset: str, root: Path) -> None:
    """What is adopted was hashed: a flipped bit that HDF5 does not see is found."""
    whole = make(root)
    path = root / shard_name(4, 8)
    image = path.read_bytes()
    with h5py.File(path, "r") as file:
        place = file[dataset].id.get_offset()
    path.write_bytes(image[:place] + bytes([image[place] ^ 4]) + image[place + 1 :])
    (root / MANIFEST).write_text(
        replace(whole, shards=whole.shards[::2]).to_json(), encoding="utf-8"
    )
    assert make(root) == whole
    assert path.read_bytes() == image


@pytest.mark.parametrize("part", [(0, 1), (1, 3)])
def test_damaged_shards_are_made_again(root: Path, part: tuple[int, int]) -> None:
    """A flipped bit in a listed shard, of the same size: the next build is the first one again."""
    whole = make(root)
    truth = {path.name: path.read_bytes() for path in root.glob("*.h5")}
    path = root / shard_name(4, 8)  # the second of three: of part 1 of 3, too
    image = bytearray(truth[path.name])
    image[len(image) // 2] ^= 16
    path.write_bytes(image)
    assert build(root, **KNOWN, part=part) == whole
    assert {path.name: path.read_bytes() for path in root.glob("*.h5")} == truth
    assert verify(root) == []


def test_a_lost_manifest_is_made_again(root: Path) -> None:
    """It is derived from the shards, which are left as they are."""
    make(root)
    before = stamps(root)
    text = (root / MANIFEST).read_bytes()
    (root / MANIFEST).unlink()
    make(root)
    assert stamps(root) == before
    assert (root / MANIFEST).read_bytes() == text


@pytest.mark.parametrize("side", [64, 300])
def test_a_repaired_manifest_is_that_of_the_build(side: int, tmp_path: Path) -> None:
    """A shard that is alone is a partial one of the default size: the dataset can grow."""
    root = tmp_path / "lone"
    generator = MapSpec((side, side))
    build(root, generator, maps=3)
    text = (root / MANIFEST).read_bytes()
    (root / MANIFEST).unlink()
    repair(root)
    assert (root / MANIFEST).read_bytes() == text
    assert build(root, generator, maps=5).maps == 5
    assert verify(root) == []


def test_a_shard_that_is_alone_and_not_the_first_is_whole(tmp_path: Path) -> None:
    """Its own length is then the size: the build goes on."""
    root = tmp_path / "rest"
    whole = build(root, MapSpec(), maps=6, shard_size=2)
    for name in (MANIFEST, whole.shards[0].name, whole.shards[1].name):
        (root / name).unlink()
    repair(root)
    assert build(root, MapSpec(), maps=6, shard_size=2) == whole
    assert verify(root) == []


def test_a_build_without_a_manifest_keeps_no_shard_that_h5py_cannot_read(root: Path) -> None:
    """Its maps and labels are right, and yet it is made again."""
    make(root)
    path = root / shard_name(4, 8)
    sound = path.read_bytes()
    image = bytearray(sound)
    image[image.index(b"occupancy")] ^= 1  # the description of an array
    path.write_bytes(image)
    (root / MANIFEST).unlink()
    make(root)
    assert path.read_bytes() == sound
    assert verify(root) == []


def test_a_lost_manifest_does_not_cost_another_dataset(root: Path) -> None:
    """Shards describe themselves: what they hold is not overwritten by another dataset."""
    make(root)
    before = stamps(root)
    (root / MANIFEST).unlink()
    with pytest.raises(ValueError, match="seed"):
        build(root, SPEC, maps=MAPS, seed=SEED + 1, shard_size=SIZE, workers=1)
    assert stamps(root) == before


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"shard_size": 1000}, "with shard_size 4, asked for shard_size 1000"),
        ({"shard_size": 3}, "with shard_size 4, asked for shard_size 3"),
        ({"maps": 6}, "maps holds 8 maps, asked for 6: a dataset only grows"),
    ],
)
def test_a_lost_manifest_does_not_change_the_dataset(
    given: dict[str, int], says: str, root: Path
) -> None:
    """Its shards are refused by the arguments that its manifest would be refused by."""
    make(root)
    (root / MANIFEST).unlink()
    (root / shard_name(0, 4)).unlink()
    before = stamps(root)
    with pytest.raises(ValueError, match=says):
        build(root, **{**KNOWN, **given})
    assert stamps(root) == before


def test_more_maps_extend(root: Path, tmp_path: Path) -> None:
    """Whole shards stay, a partial last one becomes whole, the result is that of one build."""
    make(root, maps=6)
    before = stamps(root)
    extended = make(root, maps=MAPS)
    direct = make(tmp_path / "direct", maps=MAPS)
    assert extended == direct
    assert extended.shards[0].name == shard_name(0, 4)
    assert stamps(root)[shard_name(0, 4)] == before[shard_name(0, 4)]
    assert verify(root) == []


def test_extending_in_steps(root: Path, truth: str) -> None:
    """Growing map by map gives what one build gives, and every map keeps its split."""
    splits: list[int] = []
    for maps in range(1, MAPS + 1):
        manifest = make(root, maps=maps)
        found = [
            code
            for entry in manifest.shards
            for code in read_shard(root / entry.name).maps.split.tolist()
        ]
        assert found[: len(splits)] == splits
        splits = found
    assert manifest.content_hash == truth


def test_extending_removes_the_partial_shard(root: Path) -> None:
    """A last partial shard is rewritten: only the whole one is left."""
    make(root, maps=6)
    make(root, maps=MAPS)
    assert listing(root) == names(MAPS, SIZE)


# --- refusals -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("says", "arguments"),
    [
        (["skip_probability 0.3, asked for skip_probability 0.2"], {"recipe": OTHER}),
        (
            ["generator rooms, asked for generator maze"],
            {"recipe": Maze(SPEC.map_size)},
        ),
        (["seed", "5", "6"], {"seed": 6}),
        (["shard_size", "4", "5"], {"shard_size": 5}),
        (["11", "10", "grows"], {"maps": 10}),
    ],
    ids=["spec", "family", "seed", "shard size", "fewer maps"],
)
def test_another_dataset_under_the_root_is_refused(
    says: list[str], arguments: dict[str, Any], root: Path
) -> None:
    """The message names what the root holds and what was asked for; nothing changes."""
    make(root)
    before = stamps(root)
    text = (root / MANIFEST).read_bytes()
    with pytest.raises(ValueError, match=re.escape(str(root))) as caught:
        build(root, **(KNOWN | arguments))
    assert [word for word in says if word not in str(caught.value)] == []
    assert stamps(root) == before
    assert (root / MANIFEST).read_bytes() == text


def test_a_root_that_is_a_file_is_refused(root: Path) -> None:
    """The file stays as it is."""
    root.write_text("notes", encoding="utf-8")
    with pytest.raises(ValueError, match=re.escape(f"{root} is a file")):
        make(root)
    assert root.read_text(encoding="utf-8") == "notes"


def test_a_root_below_a_file_is_refused(tmp_path: Path) -> None:
    """A path that cannot be made is an OSError that names it."""
    (tmp_path / "notes").write_text("notes", encoding="utf-8")
    with pytest.raises(OSError, match="notes"):
        make(tmp_path / "notes" / "maps")


@pytest.mark.parametrize("other", ["notes.txt", ".git", "maps-0-3.h5", "maps.h5", "data"])
def test_a_root_that_holds_something_else_is_refused(other: str, root: Path) -> None:
    """What is there is named, and nothing is added."""
    root.mkdir()
    (root / other).touch()
    with pytest.raises(ValueError, match=re.escape(f"{root} holds something else ('{other}')")):
        make(root)
    assert os.listdir(root) == [other]


def test_an_empty_folder_is_welcome(root: Path, truth: str) -> None:
    """Also one in which a builder died before it wrote anything."""
    root.mkdir()
    (root / ".lock").touch()
    (root / f".{MANIFEST}.elsewhere.1.tmp").touch()
    assert make(root).content_hash == truth


def test_no_permission() -> None:
    """A root that may not be written to is refused at once, by name, and stays empty."""
    with unprivileged_folder() as folder:
        with pytest.raises(PermissionError, match=re.escape(str(folder))):
            make(folder)
        assert os.listdir(folder) == []
        with pytest.raises(PermissionError, match=re.escape(str(folder))):
            make(folder / "maps")


def test_a_manifest_that_names_other_files_is_refused(root: Path, tmp_path: Path) -> None:
    """Neither build nor verify follows a name out of the root."""
    manifest = make(root)
    outside = tmp_path / manifest.shards[0].name
    shutil.move(root / outside.name, outside)
    text = (root / MANIFEST).read_text(encoding="utf-8")
    lie = restated(text, lambda values: values["shards"][0].update(name=f"../{outside.name}"))
    (root / MANIFEST).write_text(lie, encoding="utf-8")
    with pytest.raises(ShardError, match=r"'\.\./maps"):
        make(root)
    first, *others = verify(root)
    assert "'../maps" in first
    assert others == [f"{root / outside.name}: missing"]
    assert not (root / outside.name).exists()


@pytest.mark.parametrize("listed", [True, False])
def test_a_shard_that_is_a_link_out_of_the_root(listed: bool, root: Path, tmp_path: Path) -> None:
    """It is not taken for a shard, whether the manifest lists it or not; what it leads to stays.

    Links inside the root, hard links and a root that is a link itself are as good as files.
    """
    manifest = make(root)
    one, other, _ = (root / entry.name for entry in manifest.shards)
    outside = tmp_path / one.name
    shutil.move(one, outside)
    before = outside.stat()
    one.symlink_to(outside)
    if listed:
        refusal = f"{one}: a link out of its folder"
        for read in (make, lambda root: MapDataset(root)[:]):
            with pytest.raises(ShardError, match=re.escape(refusal)):
                read(root)
        assert [fault[: len(refusal)] for fault in verify(root)] == [refusal]
        assert one.is_symlink()
    else:
        text = replace(manifest, shards=manifest.shards[1:]).to_json()
        (root / MANIFEST).write_text(text, encoding="utf-8")
        assert make(root) == manifest
        assert not one.is_symlink()
    assert outside.stat() == before
    one.unlink()
    os.link(outside, one)
    shutil.move(other, root / "other")
    other.symlink_to("other")
    (tmp_path / "link").symlink_to(root)
    assert make(tmp_path / "link") == manifest
    assert len(MapDataset(tmp_path / "link")[:].map) > 0
    assert other.is_symlink()


def test_a_manifest_that_is_a_link_out_of_the_root(root: Path, tmp_path: Path) -> None:
    """It is refused by name, by those who read and by those who build."""
    make(root)
    shutil.move(root / MANIFEST, tmp_path / MANIFEST)
    (root / MANIFEST).symlink_to(tmp_path / MANIFEST)
    for read in (make, MapDataset, read_manifest):
        with pytest.raises(ShardError, match=re.escape(f"{root / MANIFEST}: a link out")):
            read(root)
    assert f"{root / MANIFEST}: a link out" in verify(root)[0]


def test_what_is_there_is_checked_with_a_bar(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Hashing many shards takes long, so it shows how far it is."""
    make(root)
    assert capsys.readouterr().err == ""
    build(root, **KNOWN, progress=True)
    assert f"{MAPS}/{MAPS} [" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("culprit", "arguments"),
    [
        ("recipe", {"recipe": "papers"}),
        ("maps", {"maps": 10_000_000, "shard_size": 1, "part": (3, 1000)}),
        ("recipe", {"recipe": {"rooms": (2, 3)}}),
        ("maps", {"maps": 0}),
        ("maps", {"maps": -5}),
        ("maps", {"maps": 1.5}),
        ("maps", {"maps": True}),
        ("seed", {"seed": -1}),
        ("seed", {"seed": 2**64}),
        ("seed", {"seed": "5"}),
        ("shard_size", {"shard_size": 0}),
        ("workers", {"workers": 0}),
        ("workers", {"workers": "all"}),
        ("workers", {"workers": 1, "executor": InTheCaller()}),
    ],
)
def test_bad_arguments_are_named(culprit: str, arguments: dict[str, Any], root: Path) -> None:
    """The message begins with the argument, and no folder is made."""
    with pytest.raises(ValueError, match=f"^{culprit}: "):
        build(root, **(KNOWN | {"workers": None} | arguments))
    assert not root.exists()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("papers", "recipe: got 'papers', expected a preset (paper, narrow,"),
        ("{", "not JSON"),
        ("[]", "recipe: got '[]', expected a preset"),
        ('{"maps": 5, "rooms": [2, 3]}', "recipe: got 'rooms', expected one of content_hash"),
        ('{"maps": 0}', "maps: got 0"),
        ('{"maps": "many"}', "maps: got 'many'"),
        ('{"seed": -1}', "seed: got -1"),
        ('{"format_version": 4}', f"format version 4, this mapdata {__version__} reads 1 to 3"),
        ('{"spec": {"rooms": [5, 2]}}', "rooms"),
        ('{"spec": {"wings": 2}}', "unknown key: wings"),
        ('{"spec": {}, "identity": "' + "0" * 64 + '"}', "identity"),
    ],
)
def test_bad_recipes_are_named(text: str, says: str) -> None:
    """A recipe that cannot be followed says why."""
    with pytest.raises(ValueError, match=re.escape(says)):
        as_recipe(text)


def test_recipes_come_from_presets_files_and_text(tmp_path: Path) -> None:
    """A preset's name, a file, or the JSON itself; what is left out takes its default."""
    text = json.dumps({"spec": SPEC.to_dict(), "seed": 5, "maps": 11})
    (tmp_path / "recipe.json").write_text(text, encoding="utf-8")
    assert as_recipe("narrow") == Recipe(MapSpec.preset("narrow"))
    assert as_recipe("{}") == as_recipe({}) == Recipe(MapSpec())
    assert as_recipe(json.loads(text)) == as_recipe(text)
    assert as_recipe(MappingProxyType(json.loads(text))) == as_recipe(text)
    assert as_recipe(text) == as_recipe(str(tmp_path / "recipe.json")) == Recipe(SPEC, 5, 11)


# --- crashes ------------------------------------------------------------------------------------


class FailsAfter(InTheCaller):
    """Runs so many tasks, then fails: in the task, or, as Ctrl-C does, in the caller."""

    def __init__(self, tasks: int, error: BaseException) -> None:
        """Fail with ``error``."""
        self.left = tasks
        self.error = error

    def submit(self, function: Task, /, *arguments: object, **options: object) -> Future[Any]:
        """Run ``function`` now, or fail."""
        self.left -= 1
        if self.left < 0:
            if not isinstance(self.error, Exception):
                raise self.error
            function = self.fail
            arguments = ()
        return super().submit(function, *arguments, **options)

    def fail(self) -> None:
        """Fail in the task."""
        raise self.error


@pytest.mark.parametrize(
    "error", [KeyboardInterrupt(), OSError(28, "No space left on device")], ids=["stop", "full"]
)
@pytest.mark.parametrize("tasks", [0, 1, 2])
def test_a_stopped_build_continues(
    error: BaseException, tasks: int, root: Path, truth: str
) -> None:
    """What was finished is listed when the error comes out, and is not made again."""
    with pytest.raises(type(error)):
        make(root, workers=None, executor=FailsAfter(tasks, error))
    manifest = read_manifest(root)
    assert not manifest.complete
    assert {entry.name for entry in manifest.shards} <= set(stamps(root))
    before = stamps(root)
    assert len(before) == tasks
    assert make(root).content_hash == truth
    assert {name: stamp for name, stamp in stamps(root).items() if name in before} == before


@pytest.mark.parametrize(
    ("error", "waits"), [(KeyboardInterrupt(), False), (OSError(28, "No space left"), True)]
)
def test_ctrl_c_does_not_wait_for_another_builder(
    error: BaseException, waits: bool, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that holds the lock of the manifest; what is not listed is adopted by the next build."""
    asked: list[bool] = []

    def locked_by_another(_: Path, mine: Manifest, *, wait: bool = True) -> Manifest:
        asked.append(wait)
        return mine

    monkeypatch.setattr("mapdata.shards.builder.merge", locked_by_another)
    with pytest.raises(type(error)):
        make(root, workers=None, executor=FailsAfter(1, error))
    assert asked[-1] is waits


def test_a_builder_does_not_lose_what_another_one_finished(root: Path) -> None:
    """Two manifests merged in turns end as the union, and building goes on from there."""
    whole = make(root)
    (root / MANIFEST).write_text(replace(whole, shards=()).to_json(), encoding="utf-8")
    merge(root, replace(whole, shards=whole.shards[:1]))
    merge(root, replace(whole, shards=whole.shards[2:]))
    before = stamps(root)
    assert make(root) == whole
    assert stamps(root) == before


def test_the_last_builder_lists_what_merges_at_once_lost(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without locks another builder may overwrite the manifest by one that lacks our shards.

    And so may it the manifest that puts them back. All shards are there, so they are listed.
    """
    build(root, SPEC, maps=MAPS, seed=SEED, shard_size=SIZE, part=(0, 2))
    theirs = read_manifest(root)
    overwritten = [theirs, replace(theirs, shards=())]

    def merge_at_once(folder: Path, mine: Manifest, **options: Any) -> Manifest:
        merged = merge(folder, mine, **options)
        if overwritten:
            (folder / MANIFEST).write_text(overwritten.pop().to_json(), encoding="utf-8")
        return merged

    monkeypatch.setattr(builder, "merge", merge_at_once)
    before = stamps(root)
    manifest = build(root, SPEC, maps=MAPS, seed=SEED, shard_size=SIZE, part=(1, 2))
    assert overwritten == []
    assert manifest.complete
    assert read_manifest(root) == manifest
    assert verify(root) == []
    assert {name: stamp for name, stamp in stamps(root).items() if name in before} == before


def test_without_progress_there_is_no_tqdm(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bar that is not shown is not made: a builder killed inside tqdm's lock would stop all
    others of its fork.
    """

    def tqdm(*_: object, **__: object) -> None:
        raise AssertionError("a bar was made")

    monkeypatch.setattr("mapdata.shards.workers.tqdm", tqdm)
    make(root)
    verify(root)
