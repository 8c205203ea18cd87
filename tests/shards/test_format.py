"""docs/format.md holds: a reader made from that page alone reads shards; its tables are complete.

mapdata builds the datasets and says what they should hold; h5py and numpy read them.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import struct
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import h5py
import numpy as np
import numpy.typing as npt
import pytest
from helpers import reference

from mapdata import Labels, MapGenerator, MapSpec, Terrain, build, generate, label
from mapdata.movement import Movement

Array: TypeAlias = npt.NDArray[Any]
Row: TypeAlias = list[str]

PAGE = (Path(__file__).parents[2] / "docs" / "format.md").read_text(encoding="utf-8")
SEED = 2**63 + 5
MAPS = 11
SHARD_SIZE = 4
SPEC = MapSpec(
    (20, 70),
    (2, 6),
    (2, 8),
    (3, 12),
    passage_width=(1, 2),
    skip_probability=0.4,
    splits=(0.5, 0.3, 0.2),
)
SPECS = {
    "4": SPEC,
    "8": MapSpec(
        (9, 130),
        (2, 5),
        (1, 4),
        (3, 40),
        passage_width=(1, 3),
        skip_probability=0.4,
        movement=Movement(8),
    ),
    "8-cutting-one": MapSpec(
        (30, 65),
        (2, 6),
        (2, 6),
        (2, 9),
        (1, 2),
        0.5,
        movement=Movement(8, corner_cutting=True, diagonal_cost=1),
    ),
}

TERRAINS = {
    "4": Terrain((20, 70), seed_points=4, obstacles=0.2),
    "8": Terrain((9, 130), seed_points=3, obstacles=0.2, movement=Movement(8)),
    "8-one": Terrain((12, 12), seed_points=5, movement=Movement(8, True, 1.0)),
}


# --- the page as a reader -----------------------------------------------------------------------

STEPS = [(-1, 0), (0, 1), (1, 0), (0, -1), (-1, 1), (1, 1), (1, -1), (-1, -1)]


class Planner(NamedTuple):
    """What one search found on a map: moves and iterations by segment, numbers of moves by pair."""

    moves: list[list[int]]
    iterations: list[int]
    straight: list[int]
    diagonal: list[int]


class Map(NamedTuple):
    """One map as the page says that it lies in a shard."""

    number: int
    occupancy: Array
    bits: bytes
    split: int
    passage_width: int
    seed_points: list[list[int]]
    sizes: list[list[int]]
    directions: list[list[int]]
    planners: dict[str, Planner]
    terrain: Array | None


def read(path: Path) -> tuple[dict[str, Any], list[Map]]:
    """Read a shard: its root attributes and its maps."""
    with h5py.File(path, "r") as file:
        attributes: dict[str, Any] = dict(file.attrs)
        data = {name: file[name][()] for name in file}
    for name, value in attributes.items():
        if isinstance(value, bytes):
            attributes[name] = value.decode()
    count = attributes["stop"] - attributes["start"]
    return attributes, [map_of(attributes, data, m) for m in range(count)]


def map_of(attributes: dict[str, Any], data: dict[str, Array], m: int) -> Map:
    """Return the map that is the m-th of its shard."""
    _, width = attributes["map_size"].tolist()
    # "column c is bit c % 8 of byte c // 8"
    packed = data["maps"][m]
    columns = np.arange(width)
    occupancy = packed[:, columns // 8] >> (columns % 8).astype(np.uint8) & 1
    first, last = data["room_offsets"][m : m + 2].tolist()
    # each map before this one has a passage less than it has rooms
    passages = range(first - m, last - m - 1)
    return Map(
        number=int(attributes["start"]) + m,
        occupancy=occupancy,
        bits=packed.tobytes(),
        split=int(data["split"][m]),
        passage_width=int(data["passage_width"][m]),
        seed_points=data["seeds"][first:last].tolist(),
        sizes=data["sizes"][first:last].tolist(),
        directions=[data["directions"][q].tolist() for q in passages],
        planners={
            name: planner_of(attributes, data, name, m, passages) for name in ("bfs", "astar")
        },
        terrain=data["terrain"][m] if attributes["format_version"] == 3 else None,
    )


def planner_of(
    attributes: dict[str, Any], data: dict[str, Array], name: str, m: int, segments: range
) -> Planner:
    """Return what the search of this name found on the m-th map of a shard."""
    bits = 2 if json.loads(attributes["movement"])["connectivity"] == 4 else 4
    offsets = data[f"{name}_offsets"].tolist()
    codes = data[f"{name}_moves"]
    moves = []
    for q in segments:
        moves.append([move_at(codes, k, bits) for k in range(offsets[q], offsets[q + 1])])
    first, last = data["pair_offsets"][m : m + 2].tolist()
    straight = data[f"{name}_straight"][first:last].tolist()
    diagonal = [0] * len(straight)
    if name == "astar" and bits == 4:
        diagonal = data["astar_diagonal"][first:last].tolist()
    iterations = [int(data[f"{name}_iterations"][q]) for q in segments]
    return Planner(moves, iterations, straight, diagonal)


def move_at(codes: Array, k: int, bits: int) -> int:
    """Return move k of packed ones, the first in the lowest bits of a byte."""
    octet = int(codes[k * bits // 8])
    return (octet >> (k * bits % 8)) & ((1 << bits) - 1)


def path_of(stored_map: Map, search: str, q: int) -> list[list[int]]:
    """Return the cells of segment q."""
    if stored_map.planners["astar"].straight[pair_of(stored_map, q)] == -1:
        return []
    row, column = stored_map.seed_points[q]
    cells = [[row, column]]
    for move in stored_map.planners[search].moves[q]:
        down, right = STEPS[move]
        row += down
        column += right
        cells.append([row, column])
    return cells


def pair_of(stored_map: Map, q: int) -> int:
    """Return the place of the pair (q, q + 1) among the pairs i < j in row-major order."""
    pairs = list(combinations(range(len(stored_map.seed_points)), 2))
    return pairs.index((q, q + 1))


def matrix_of(stored_map: Map, search: str, diagonal_cost: float) -> Array:
    """Return the connection matrix."""
    search_labels = stored_map.planners[search]
    units = 1 if stored_map.terrain is None or search == "bfs" else 2
    n = len(stored_map.seed_points)
    matrix = np.zeros((n, n))
    for pair, (i, j) in enumerate(combinations(range(n), 2)):
        cost = (search_labels.straight[pair] + search_labels.diagonal[pair] * diagonal_cost) / units
        if search_labels.straight[pair] == -1:
            cost = -1
        matrix[i, j] = cost
        matrix[j, i] = cost
    return matrix


def record_of(stored_map: Map) -> bytes:
    """Return the record that the content hash is taken of."""
    height, width = stored_map.occupancy.shape
    words = [
        height,
        width,
        stored_map.number % 2**32,
        stored_map.number // 2**32,
        stored_map.split,
        stored_map.passage_width,
        len(stored_map.seed_points),
    ]
    words += np.ravel([*stored_map.seed_points, *stored_map.sizes, *stored_map.directions]).tolist()
    for search in (stored_map.planners["bfs"], stored_map.planners["astar"]):
        for moves, iterations in zip(search.moves, search.iterations, strict=True):
            words += [len(moves), iterations]
        for straight, diagonal in zip(search.straight, search.diagonal, strict=True):
            words += [straight, diagonal]
    record = b"".join(struct.pack("<I", word % 2**32) for word in words) + stored_map.bits
    if stored_map.terrain is not None:
        record += stored_map.terrain.tobytes()
    for search in (stored_map.planners["bfs"], stored_map.planners["astar"]):
        record += bytes(move for moves in search.moves for move in moves)
    return record + bytes(-len(record) % 4)


def hash_of(maps: Sequence[Map]) -> str:
    """Return the content hash of maps."""
    total = sum(
        int.from_bytes(hashlib.sha256(record_of(stored_map)).digest(), "big") for stored_map in maps
    )
    return f"{total % 2**256:064x}"


def canonical(values: object) -> str:
    """Return canonical JSON."""
    return json.dumps(values, sort_keys=True, separators=(",", ":"))


def threshold(probability: float) -> int:
    """Return the integer that a word must be below."""
    return round(probability * 2**32)


# --- the page as tables -------------------------------------------------------------------------


def table(heading: str) -> list[Row]:
    """Return the rows of the table of the page whose first heading is this, without code marks."""
    lines = PAGE.split("\n")
    first = next(number for number, line in enumerate(lines) if line.startswith(f"| {heading} |"))
    rows = []
    for line in lines[first + 2 :]:
        if not line.startswith("|"):
            break
        rows.append(
            [cell.strip().replace("`", "").replace("\\", "") for cell in line.strip("|").split("|")]
        )
    return rows


def names(heading: str) -> Row:
    """Return the first column of a table."""
    return [name for row in table(heading) for name in row[0].split(", ")]


# --- datasets to read ---------------------------------------------------------------------------


class Dataset(NamedTuple):
    """A built dataset, and what it should hold."""

    generator: MapGenerator
    root: Path
    shards: list[Path]
    labels: Labels


@pytest.fixture(scope="module", params=SPECS)
def dataset(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Eleven maps in three shards, the last one shorter."""
    generator = SPECS[request.param]
    root = tmp_path_factory.mktemp("format") / "maps"
    build(root, generator, maps=MAPS, seed=SEED, shard_size=SHARD_SIZE, workers=1)
    return Dataset(
        generator,
        root,
        sorted(root.glob("maps-*.h5")),
        label(generate(generator, SEED, range(MAPS))),
    )


# --- what a shard holds -------------------------------------------------------------------------


def test_the_page_reads_every_map(dataset: Dataset) -> None:
    """Maps, rooms, splits, paths, iterations and matrices are those that mapdata makes."""
    stored_maps = [stored_map for path in dataset.shards for stored_map in read(path)[1]]
    labels = dataset.labels
    maps = labels.maps
    assert [stored_map.number for stored_map in stored_maps] == list(range(MAPS))
    for i, stored_map in enumerate(stored_maps):
        n = maps.rooms[i]
        np.testing.assert_array_equal(stored_map.occupancy, maps.occupancy[i])
        assert (stored_map.split, stored_map.passage_width) == (
            maps.split[i],
            maps.passage_width[i],
        )
        assert stored_map.seed_points == maps.seed_points[i, :n].tolist()
        assert stored_map.sizes == maps.sizes[i, :n].tolist()
        assert stored_map.directions == maps.directions[i, : n - 1].tolist()
        for search in ("bfs", "astar"):
            paths = [path_of(stored_map, search, q) for q in range(n - 1)]
            assert paths == [segment.tolist() for segment in labels.route(search, i)]
            assert stored_map.planners[search].iterations == labels.iterations(search, i).tolist()
            step = 1.0 if search == "bfs" else dataset.generator.movement.diagonal_cost
            np.testing.assert_array_equal(
                matrix_of(stored_map, search, step), labels.matrix(search, i)
            )
    assert not labels.reachable.all(), "no segment without a path among them"


def test_paths_begin_and_end_at_the_seeds(dataset: Dataset) -> None:
    """Moves lead from seed point to seed point over free cells; their number is the pair's cost."""
    for stored_map in (stored_map for path in dataset.shards for stored_map in read(path)[1]):
        n = len(stored_map.seed_points)
        for search, search_labels in stored_map.planners.items():
            for q in range(n - 1):
                pair = pair_of(stored_map, q)
                cells = path_of(stored_map, search, q)
                assert (cells == []) == (search_labels.straight[pair] == -1)
                assert len(search_labels.moves[q]) == max(
                    0, search_labels.straight[pair] + search_labels.diagonal[pair]
                )
                if cells:
                    assert (cells[0], cells[-1]) == (
                        stored_map.seed_points[q],
                        stored_map.seed_points[q + 1],
                    )
                    assert not any(stored_map.occupancy[row, column] for row, column in cells)


@pytest.fixture(scope="module", params=TERRAINS)
def terrain_dataset(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Dataset:
    """Five maps of terrain in two shards."""
    generator = TERRAINS[request.param]
    root = tmp_path_factory.mktemp("terrain") / "maps"
    build(root, generator, maps=5, seed=SEED, shard_size=SHARD_SIZE, workers=1)
    labels = label(generate(generator, SEED, range(5)))
    return Dataset(generator, root, sorted(root.glob("maps-*.h5")), labels)


def test_the_page_reads_terrain(terrain_dataset: Dataset) -> None:
    """Costs of cells and of paths, moves and hashes of version 3 are those that mapdata makes."""
    labels = terrain_dataset.labels
    movement = terrain_dataset.generator.movement
    every = []
    for path in terrain_dataset.shards:
        attributes, maps = read(path)
        assert attributes["format_version"] == 3
        assert attributes["content_hash"] == hash_of(maps)
        recipe = {
            "format_version": 3,
            "seed": int(attributes["seed"]),
            "spec": json.loads(attributes["spec"]),
        }
        assert attributes["identity"] == hashlib.sha256(canonical(recipe).encode()).hexdigest()
        every += maps
    manifest = json.loads((terrain_dataset.root / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["format_version"] == 3
    assert list(manifest) == names("key")
    assert manifest["content_hash"] == hash_of(every)
    for i, stored_map in enumerate(every):
        terrain = stored_map.terrain
        assert terrain is not None
        np.testing.assert_array_equal(terrain == 0, stored_map.occupancy)
        assert labels.maps.terrain is not None
        np.testing.assert_array_equal(terrain, labels.maps.terrain[i])
        for search in ("bfs", "astar"):
            paths = [path_of(stored_map, search, q) for q in range(labels.maps.rooms[i] - 1)]
            assert paths == [segment.tolist() for segment in labels.route(search, i)]
            step = 1.0 if search == "bfs" else movement.diagonal_cost
            np.testing.assert_array_equal(
                matrix_of(stored_map, search, step), labels.matrix(search, i)
            )
        # The stored cost is that of the stored path, added up cell by cell.
        for q, segment in enumerate(labels.route("astar", i)):
            cells = [(row, column) for row, column in segment.tolist()]
            cost = reference.path_cost(cells, movement, terrain.tolist())
            assert labels.matrix("astar", i)[q, q + 1] == cost


def test_the_tables_list_every_dataset_of_version_3(terrain_dataset: Dataset) -> None:
    """Section 3 and section 11 together name all datasets, with their types and shapes."""
    sides = terrain_dataset.labels.maps.occupancy.shape[1:]
    for path in terrain_dataset.shards:
        with h5py.File(path, "r") as file:
            assert sorted(file) == sorted({*names("dataset"), *names("dataset of version 3")})
            for name, kind, *_ in (*table("dataset"), *table("dataset of version 3")):
                assert file[name].dtype == np.dtype(kind).newbyteorder("<"), name
            assert file["terrain"].shape == (len(file["split"]), *sides)
            assert file["astar_diagonal"].shape in (file["astar_straight"].shape, (0,))


def draw(word: int, limits: Sequence[int]) -> int:
    """Return the integer inside limits, both included, that a random word of 32 bits stands for."""
    lower, upper = limits
    return lower + (word * (upper - lower + 1) // 2**32)


def split_of(word: int, fractions: Sequence[float]) -> int:
    """Return the split that a random word stands for."""
    train, validation, _ = fractions
    if word < threshold(train):
        return 0
    return 1 if word < threshold(train + validation) else 2


def test_draws_are_those_of_the_page(dataset: Dataset) -> None:
    """Splits, rooms and passages follow from the spec in the file and its seed."""
    for path in dataset.shards:
        attributes, maps = read(path)
        generator = json.loads(attributes["spec"])
        seed = int(attributes["seed"])
        assert seed == SEED
        height, width = generator["map_size"]
        limits = [
            (0, height - 1),
            (0, width - 1),
            generator["room_rows"],
            generator["room_columns"],
        ]
        for stored_map in maps:
            word, *_ = reference.block(seed, stored_map.number, 0, 2, 0)
            assert stored_map.split == split_of(word, generator["splits"])
            rooms, passage_width, *_ = reference.block(seed, stored_map.number, 0, 0, 0)
            assert len(stored_map.seed_points) == draw(rooms, generator["rooms"])
            assert stored_map.passage_width == draw(passage_width, generator["passage_width"])
            for q, (seed_point, size) in enumerate(
                zip(stored_map.seed_points, stored_map.sizes, strict=True)
            ):
                words = reference.block(seed, stored_map.number, 0, 0, 1 + 2 * q)
                drawn = [draw(word, limit) for word, limit in zip(words, limits, strict=True)]
                assert [*seed_point, *size] == drawn
            for q, direction in enumerate(stored_map.directions):
                skip, first, *_ = reference.block(seed, stored_map.number, 0, 0, 2 + 2 * q)
                if skip < threshold(generator["skip_probability"]):
                    assert direction == [-1, -1]
                else:
                    assert direction == ([1, 0] if draw(first, (0, 1)) else [0, 1])


def test_the_split_draw_gives_the_fractions() -> None:
    """Over 20,000 maps each split has its share, within five standard deviations."""
    words = np.array([reference.block(SEED, i, 0, 2, 0)[0] for i in range(20_000)])
    train, validation, _ = SPEC.splits
    for bound, share in ((threshold(train), 0.5), (threshold(train + validation), 0.8)):
        assert abs((words < bound).mean() - share) < 5 * math.sqrt(share * (1 - share) / len(words))


def test_hashes_are_those_of_the_page(dataset: Dataset) -> None:
    """All hashes and the identity can be made by hand."""
    manifest = json.loads((dataset.root / "manifest.json").read_text(encoding="utf-8"))
    every = []
    for path, entry in zip(dataset.shards, manifest["shards"], strict=True):
        attributes, maps = read(path)
        every += maps
        assert attributes["content_hash"] == entry["content_hash"] == hash_of(maps)
        assert entry["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
        assert entry["bytes"] == path.stat().st_size
        recipe = {
            "format_version": 1,
            "seed": int(attributes["seed"]),
            "spec": json.loads(attributes["spec"]),
        }
        assert attributes["identity"] == hashlib.sha256(canonical(recipe).encode()).hexdigest()
        assert attributes["identity"] == manifest["identity"]
        assert attributes["spec"] == canonical(manifest["spec"])
        assert (
            attributes["movement"]
            == canonical(manifest["movement"])
            == canonical(manifest["spec"]["movement"])
        )
        assert attributes["resolution"] == manifest["resolution"] == manifest["spec"]["resolution"]
        assert (
            attributes["map_size"].tolist() == manifest["map_size"] == manifest["spec"]["map_size"]
        )
    assert manifest["content_hash"] == hash_of(every) == hash_of(every[::-1])
    stated = manifest.pop("manifest_hash")
    assert stated == hashlib.sha256(canonical(manifest).encode()).hexdigest()


# --- what the page lists ------------------------------------------------------------------------

HDF5_TYPES = {"int64": "<i8", "int64[2]": "<i8", "float64": "<f8"}


def test_the_tables_list_every_dataset_and_attribute(dataset: Dataset) -> None:
    """The page names exactly the datasets and root attributes of each shard, with their types."""
    for path in dataset.shards:
        with h5py.File(path, "r") as file:
            assert sorted(file) == sorted(names("dataset"))
            for name, kind, *_ in table("dataset"):
                assert file[name].dtype == np.dtype(kind).newbyteorder("<"), name
                assert set(file[name].attrs) == {"description", "units", "encoding"}
                assert all(
                    isinstance(value, (str, bytes)) and value for value in file[name].attrs.values()
                )
            assert sorted(file.attrs) == sorted(names("attribute"))
            for name, kind, _ in table("attribute"):
                attribute = file.attrs.get_id(name)
                assert attribute.shape == ((2,) if kind.endswith("[2]") else ())
                if kind == "text":
                    encoding, length = h5py.check_string_dtype(attribute.dtype)
                    assert encoding == "utf-8"
                    assert (length is None) == ("UTF-8 string of variable length" in PAGE), name
                else:
                    assert attribute.dtype == np.dtype(HDF5_TYPES[kind]), name


def test_shapes_are_those_of_the_page(dataset: Dataset) -> None:
    """Each dataset has the shape that its row of the table states."""
    for path in dataset.shards:
        with h5py.File(path, "r") as file:
            height, width = file.attrs["map_size"]
            connectivity = dataset.generator.movement.connectivity
            bits = 2 if connectivity == 4 else 4
            maps = file.attrs["stop"] - file.attrs["start"]
            rooms = file["room_offsets"][-1]
            pairs = file["pair_offsets"][-1]
            segments = rooms - maps
            for name, _, shape, _ in table("dataset"):
                moves = 0
                if name.endswith("_moves"):
                    moves = file[name.replace("_moves", "_offsets")][-1]
                sides = {
                    "N": maps,
                    "N + 1": maps + 1,
                    "H": height,
                    "B": 8 * ((width + 63) // 64),
                    "R": rooms,
                    "2": 2,
                    "S": segments,
                    "S + 1": segments + 1,
                    "(M b + 7) // 8": (moves * bits + 7) // 8,
                    "P": pairs,
                    "P), or (0": pairs if connectivity == 8 else 0,
                }
                stated = shape[1:-1]
                expected = (
                    (sides[stated],)
                    if stated in sides
                    else tuple(sides[side] for side in stated.split(", "))
                )
                assert file[name].shape == expected, name


def test_the_tables_list_every_key_of_the_manifest(dataset: Dataset) -> None:
    """The page names exactly the keys of manifest.json and of all in it, in its order."""
    content = (dataset.root / "manifest.json").read_text(encoding="utf-8")
    manifest = json.loads(content)
    assert content == json.dumps(manifest, indent=1) + "\n"
    assert list(manifest) == names("key")
    assert sorted(manifest["spec"]) == sorted(names("spec"))
    assert sorted(manifest["spec"]["movement"]) == sorted(names("movement"))
    for number, entry in enumerate(manifest["shards"]):
        start = number * SHARD_SIZE
        stop = min((number + 1) * SHARD_SIZE, MAPS)
        assert list(entry) == names("key of a shard")
        assert (entry["start"], entry["stop"]) == (start, stop)
        assert entry["name"] == f"maps-{start:012d}-{stop:012d}.h5" == dataset.shards[number].name
        splits = names("count")[names("count").index("train") : names("count").index("maps")]
        assert splits == ["train", "val", "test"]
        outer = names("count")[: names("count").index("maps")]
        inner = names("count")[names("count").index("maps") :]
        assert list(entry["counts"]) == outer
        assert all(list(entry["counts"][split]) == inner for split in splits)


def test_counts_are_those_of_the_page(dataset: Dataset) -> None:
    """Each count of each shard, counted by hand."""
    manifest = json.loads((dataset.root / "manifest.json").read_text(encoding="utf-8"))
    for path, entry in zip(dataset.shards, manifest["shards"], strict=True):
        counts = entry["counts"]
        _, maps = read(path)
        for code, split in enumerate(("train", "val", "test")):
            costs: dict[str, list[int]] = {"route": [], "rooms": []}
            for stored_map in maps:
                if stored_map.split != code:
                    continue
                search_labels = stored_map.planners["astar"]
                n = len(stored_map.seed_points)
                ways = [
                    s + d
                    for s, d in zip(search_labels.straight, search_labels.diagonal, strict=True)
                ]
                costs["rooms"] += ways
                costs["route"] += [ways[q * (2 * n - q - 1) // 2] for q in range(n - 1)]
            assert counts[split]["maps"] == sum(stored_map.split == code for stored_map in maps)
            for kind, ways in costs.items():
                assert counts[split][kind] == sum(way > 0 for way in ways)
                assert counts[split][f"{kind}_unsolvable"] == ways.count(-1)
        reachable = [
            [path_of(stored_map, "astar", q) != [] for q in range(len(stored_map.seed_points) - 1)]
            for stored_map in maps
        ]
        assert counts["most_rooms"] == max(len(stored_map.seed_points) for stored_map in maps)
        assert counts["segments"] == sum(map(len, reachable))
        assert counts["reachable"] == sum(map(sum, reachable))
        assert counts["all_connected"] == sum(map(all, reachable))
        assert counts["drawn"] == sum(
            direction != [-1, -1] for stored_map in maps for direction in stored_map.directions
        )


def test_files_keep_the_rules_of_the_page(dataset: Dataset) -> None:
    """Superblock 3, no user block, hard links, contiguous, no filter, aligned, spare bits clear."""
    for path in dataset.shards:
        assert path.read_bytes()[:9] == b"\x89HDF\r\n\x1a\n\x03"
        with h5py.File(path, "r") as file:
            for name in file:
                assert isinstance(file.get(name, getlink=True), h5py.HardLink)
                data = file[name]
                assert (data.chunks, data.compression, data.external, data.is_virtual) == (
                    None,
                    None,
                    None,
                    False,
                )
                if data.size:
                    assert data.id.get_offset() % 64 == 0, name
                else:
                    assert data.id.get_offset() is None
            width = file.attrs["map_size"][1]
            bits = np.unpackbits(file["maps"][()], axis=-1, bitorder="little")
            assert not bits[:, :, width:].any()
            for search in ("bfs", "astar"):
                used = file[f"{search}_offsets"][-1] * (
                    2 if dataset.generator.movement.connectivity == 4 else 4
                )
                assert not np.unpackbits(file[f"{search}_moves"][()], bitorder="little")[
                    used:
                ].any()


# --- the values at its end ----------------------------------------------------------------------


def test_values_to_check_against(tmp_path: Path) -> None:
    """Words, spec, identity, map 0, record and content hash of the page's last section."""
    section = re.sub(
        r"\s+",
        " ",
        PAGE[PAGE.index("## 9.") : PAGE.index("## 10.")].replace("`", "").replace("\\", ""),
    )
    generator = MapSpec()
    manifest = build(tmp_path / "maps", generator, maps=10, seed=0, shard_size=10, workers=1)
    maps = read(tmp_path / "maps" / manifest.shards[0].name)[1]
    first = maps[0]
    bfs = first.planners["bfs"]
    astar = first.planners["astar"]
    stated = [
        " ".join(f"{word:08x}" for word in reference.philox4x32((0, 0, 0, 0), (0, 0))),
        generator.to_json().replace(',"passage', ', "passage').replace(',"skip', ', "skip'),
        str(manifest.identity),
        f"n = {len(first.seed_points)}, T = {first.passage_width}, split "
        f"{('train', 'val', 'test')[first.split]}",
        "seed points " + " ".join(f"({row}, {column})" for row, column in first.seed_points),
        f"segments of {', '.join(str(len(moves)) for moves in bfs.moves)} moves by both",
        f"iterations {', '.join(map(str, bfs.iterations))} by BFS and "
        f"{', '.join(map(str, astar.iterations))} by A*",
        f"record has {len(record_of(first))} bytes, hash "
        f"{hashlib.sha256(record_of(first)).hexdigest()}",
        manifest.content_hash,
    ]
    assert [value for value in stated if value not in section] == []
    assert first.directions == [[1, 0]] * 4
    assert [len(moves) for moves in astar.moves] == [len(moves) for moves in bfs.moves]
    assert hash_of(maps) == manifest.content_hash
