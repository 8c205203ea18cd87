"""Hostile files to every loader: refused by name in bounded memory and time; nothing is run."""

from __future__ import annotations

import io
import json
import math
import os
import pickle
import struct
import sys
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from helpers import hostile, run_helper, wild
from helpers.builds import SOUND_SEED, SOUND_SPEC, SOUND_TERRAIN
from safetensors.torch import load, save
from torch import nn

from mapdata import build
from mapdata.limits import SPLITS
from mapdata.models.pretrained.model import _digest, load_model
from mapdata.models.pretrained.path_predictor import PathPredictor
from mapdata.shards import MANIFEST, read_manifest

MOST = 200 << 20
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="/proc/self/clear_refs is Linux's")

Case = tuple[str, Path, str]
"""A loader of `refusals.LOADERS`, the file, and the error expected."""


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset of tests/helpers/hostile.py: three maps of 20 x 70 cells, 8-connected."""
    folder = tmp_path_factory.mktemp("hostile") / "sound"
    build(folder, SOUND_SPEC, maps=3, seed=SOUND_SEED)
    return folder


# --- shards and manifests -----------------------------------------------------------------------


def shard_cases(folder: Path, sound: Path) -> Iterator[Case]:
    """Write every fault of tests/helpers/hostile.py, and other versions."""
    shard = next(sound.glob("*.h5"))
    contents = hostile.read_contents(shard)
    build(folder / "terrain", SOUND_TERRAIN, maps=3, seed=SOUND_SEED)
    terrain_shard = next((folder / "terrain").glob("*.h5"))
    terrain_contents = hostile.read_contents(terrain_shard)
    members = [(fault.dataset, fault.member) for fault in hostile.DATASETS.values()]
    for dataset in ("maps", "terrain"):
        members += [(dataset, member) for member in hostile.ELSEWHERE.values()]
    for k, (name, member) in enumerate(members):
        of_terrain = name == "terrain"
        hostile.write(
            folder / f"data{k}.h5",
            terrain_contents if of_terrain else contents,
            terrain_shard if of_terrain else shard,
            {name: member},
        )
    for k, fault in enumerate(hostile.ATTRIBUTES.values()):
        hostile.write(folder / f"attribute{k}.h5", contents, shard, attributes=fault.values)
    for version in (1, 2):
        hostile.write(
            folder / f"version{version}.h5",
            terrain_contents,
            terrain_shard,
            attributes={"format_version": version},
        )
    for k, (_, change) in enumerate(hostile.BYTES.values()):
        (folder / f"bytes{k}.h5").write_bytes(change(contents.image))
    hostile.write_moved(folder / "beyond.h5", contents, 2**62)
    os.mkfifo(folder / "pipe.h5")
    for path in sorted(folder.glob("*.h5")):
        yield "shard", path, "ShardError"


def manifest_cases(folder: Path, sound: Path) -> Iterator[Case]:
    """Write manifests that are deep, long, endless, or claim what no memory holds."""
    manifest = read_manifest(sound)
    (entry,) = manifest.shards
    counts = {
        **entry.counts,
        **{split: {**entry.counts[split], "route": 10**14} for split in SPLITS},
    }
    problems = replace(entry, bytes=10**15, counts=counts)
    rooms = replace(entry, counts={**entry.counts, "most_rooms": 10**9})
    imported = replace(manifest, generator=None, seed=None, shards=(rooms,))
    texts = {
        "deep": "[" * 10**6,
        "empty-lists": "[" + "[]," * 10**6 + "[]]",
        "digits": '{"format":' + "9" * 10**6 + "}",
        "problems": replace(manifest, shards=(problems,)).to_json(),
        "rooms": imported.to_json(),
    }
    for name, text in texts.items():
        (folder / name).mkdir()
        (folder / name / MANIFEST).write_text(text)
        yield "dataset", folder / name, "ShardError"
    (folder / "endless").mkdir()
    with open(folder / "endless" / MANIFEST, "wb") as file:
        file.truncate(2**40)  # a file of holes
    yield "manifest", folder / "endless", "ShardError"
    (folder / "pipe").mkdir()
    os.mkfifo(folder / "pipe" / MANIFEST)
    yield "manifest", folder / "pipe", "ShardError"
    (folder / "piece").write_text("[0, 1, 2], " * 10)
    yield "url", folder / "piece", "ShardError"
    for name in ("deep", "digits", "endless"):
        yield "recipe", folder / name / MANIFEST, "ValueError"


# --- foreign files ------------------------------------------------------------------------------


def zeros(path: Path, *, size: int, stated: int, claimed: int) -> None:
    """Write an .npz of ``size`` zeros, whose directory and whose array's header say otherwise."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open("maps.npy", "w", force_zip64=True) as member:
            member.write(wild.npy((claimed // 4096, 64, 64), b""))
            for _ in range(size // 2**24):
                member.write(bytes(2**24))
        archive.infolist()[0].file_size = stated


def large_before_bad(path: Path) -> None:
    """Write an .npz of planning-datasets: 256 MiB of sound maps, then goals of another shape."""
    maps = 2**16
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open("arr_0.npy", "w", force_zip64=True) as member:
            member.write(wild.npy((maps, 64, 64), b""))
            for _ in range(16):
                member.write(bytes(2**24))
        for name, shape in (("arr_1", (1, 1, 1, 1)), ("arr_2", (maps, 8, 1, 64, 64))):
            archive.writestr(f"{name}.npy", wild.npy(shape, b"\1"))
        archive.writestr("arr_3.npy", wild.npy((1, 1, 1, 1), b"\0"))


def tiles_before_bad(path: Path, *, is_path: bool) -> None:
    """Write an .npz of tile-based sets: some 1 GiB of sound numbers, and a bad one at the end.

    Args:
        path: of the file.
        is_path: whether sixty paths on a map of 4,096 x 4,096 cells are long and the last one is
            bad; otherwise the weights of many maps.
    """
    side = 4096 if is_path else 64
    maps = 1 if is_path else 2**17
    sources = 60 if is_path else 1
    shapes = {
        "maps": (maps, 1, 1, 3),
        "costs": (maps, side, side),
        "targets": (maps, 1, 2),
        "sources": (maps, 1, sources, 2),
        "paths": (maps, 1, sources, side, side),
    }
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, shape in shapes.items():
            fill = b"\x0a" if name == "costs" else b"\0"
            is_bad = name == ("paths" if is_path else "costs")
            last = (b"\2" if is_path else b"\0") if is_bad else fill
            left = math.prod(shape) - 1
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                member.write(wild.npy(shape, b""))
                while left:
                    count = min(left, 2**24)
                    member.write(fill * count)
                    left -= count
                member.write(last)


def text_chunk(size: int) -> bytes:
    """Return a PNG with a compressed text of ``size`` zeros."""
    good = wild.png(3, 4, depth=8)
    data = b"Comment\0\0" + zlib.compress(bytes(size), 9)
    chunk = b"zTXt" + data
    length = struct.pack(">I", len(data))
    checksum = struct.pack(">I", zlib.crc32(chunk))
    end_of_header = 33  # signature and IHDR
    return good[:end_of_header] + length + chunk + checksum + good[end_of_header:]


YAML = (
    "image: {image}\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\n"
    "occupied_thresh: 0.65\nfree_thresh: 0.2\n"
)


def format_cases(folder: Path, _: Path) -> Iterator[Case]:
    """Write bombs, lies, pickles and tags, each in a folder of its own."""
    table = (
        "item,label,passage_size,seed_rows,seed_columns,size_rows,size_columns,"
        "direction_for_passages\n"
    )
    touch = f"!!python/object/apply:os.mkdir ['{folder / 'hacked'}']"
    pickled = pickle.dumps(Bomb(folder / "hacked"))
    # each line holds the one before it twice: 2**60 texts, were they written out
    aliases = "a: &a [x,x]\nb0: &b0 [*a, x]\n"
    for k in range(1, 60):
        aliases += f"b{k}: &b{k} [*b{k - 1}, x]\n"
    files: dict[str, bytes] = {
        "a.png": wild.png(9400, 9400),
        "b.png": wild.png(30000, 30000),
        "c.png": text_chunk(2**28),
        "d.npy": wild.npy((1,), pickled, "|O"),
        "e.npy": wild.npy((2**20, 2**20), b""),
        "f.pgm": b"P5 99999 99999 255\n",
        "g.pgm": b"P2 4000 4000 255\n",
        "h.yaml": YAML.format(image=touch).encode(),
        "i.yaml": YAML.format(image="/etc/passwd").encode(),
        "j.yaml": aliases.encode(),
        "k.map": b"type octile\nheight 99999\nwidth 99999\nmap\n",
        "l.scen": b"version 1\n0\tnone.map\t4\t3\t0\t0\t3\t2\t1e999\n",
        "m.csv": (table + '0,a,2,"[' + "9" * 10**6 + ']","[1]","[1]","[1]","[1]"\n').encode(),
        "n.csv": (table + '0,a,2,"' + "[" * 10**6 + '","[1]","[1]","[1]","[1]"\n').encode(),
        "o.png": pickled,
        "p.npz": pickled,
    }
    for name, data in files.items():
        (folder / name[0]).mkdir()
        (folder / name[0] / name).write_bytes(data)
        yield "format", folder / name[0] / name, "FormatError"
    for name, size, stated, claimed in (
        ("q.npz", 2**24, 2**31, 2**31),
        ("r.npz", 2**24, 2**29, 2**40),
        ("s.npz", 2**28, 4096 + 128, 4096),
    ):
        zeros(folder / name, size=size, stated=stated, claimed=claimed)
        yield "format", folder / name, "FormatError"
    large_before_bad(folder / "t.npz")
    yield "format", folder / "t.npz", "FormatError"
    for name, is_path in (("u.npz", True), ("v.npz", False)):
        tiles_before_bad(folder / name, is_path=is_path)
        yield "format", folder / name, "FormatError"


# --- saved problems ----------------------------------------------------------------------------


def problem_cases(folder: Path, _: Path) -> Iterator[Case]:
    """Write sets that unpack to much, or whose headers do not fit together."""
    about = '{"movement": {"connectivity": 8}, "description": "a bomb"}'
    ends = np.zeros((2, 2), np.int64)
    bombs: dict[str, npt.NDArray[Any]] = {
        "many": np.zeros((2**15, 64, 64), np.uint8),  # 128 MiB in 130 kB
        "words": np.zeros((1, 2**12, 2**12), np.int64),
    }
    for name, grids in bombs.items():
        starts = np.zeros((len(grids), 2), np.int64)
        np.savez_compressed(
            folder / name, about=about, grids=grids, starts=starts, goals=starts + 1
        )
    shapes = {"flat": (4096, 4096), "fewer": (3, 64, 64), "none": ()}
    for name, shape in shapes.items():
        np.savez(
            folder / name, about=about, grids=np.zeros(shape, np.uint8), starts=ends, goals=ends
        )
    (folder / "pickle.npz").write_bytes(pickle.dumps(Bomb(folder / "hacked")))
    for path in sorted(folder.glob("*.npz")):
        yield "problems", path, "ValueError"


# --- checkpoints --------------------------------------------------------------------------------


class Bomb:
    """Makes a folder when it is unpickled."""

    def __init__(self, folder: Path) -> None:
        """Keep the folder."""
        self.folder = str(folder)

    def __reduce__(self) -> tuple[Callable[[str], None], tuple[str]]:
        return os.mkdir, (self.folder,)


def with_weights(
    arguments: dict[str, object] | list[int], weights: dict[str, torch.Tensor], **others: str
) -> bytes:
    """Return a file of weights, whose hash fits."""
    description = {"class": "PathPredictor", "arguments": json.dumps(arguments), **others}
    description["sha256"] = _digest(description, weights)
    return save(weights, description)


def with_header(header: dict[str, object], length: int | None = None) -> bytes:
    """Return a file of safetensors with this header, which may be called longer than it is."""
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text) if length is None else length) + text + bytes(64)


def model_cases(folder: Path, _: Path) -> Iterator[Case]:
    """Write files of weights that hold code or describe a model that no memory holds."""
    model = PathPredictor(4, widths=(8, 8, 8), passes=1)
    model.save(folder / "sound.safetensors")
    sound = (folder / "sound.safetensors").read_bytes()
    weights = load(sound)
    plain: dict[str, object] = {**model.hparams, "widths": [8, 8, 8]}
    first = next(iter(weights))
    code = io.BytesIO()
    torch.save({"arguments": Bomb(folder / "hacked"), "weights": {}}, code)
    tar = io.BytesIO()
    tarfile.open(fileobj=tar, mode="w").close()
    huge = {"dtype": "F16", "shape": [10**12], "data_offsets": [0, 2 * 10**12]}
    stretched = {"dtype": "F16", "shape": [10**12], "data_offsets": [0, 64]}
    files = {
        "pickle": pickle.dumps(Bomb(folder / "hacked")),
        "code": code.getvalue(),
        "old-form": pickle.dumps(Bomb(folder / "hacked")) * 3,
        "tar": tar.getvalue(),
        "text": b"weights\n",
        "empty": b"",
        "cut": sound[:-100],
        "no-description": save(weights),
        "a-list": with_weights([1, 2], weights),
        "long-header": with_header({}, length=2**62),
        "huge": with_header({first: huge}),
        "stretched": with_header({first: stretched}),
        "wide": with_weights({**plain, "widths": [10**6, 10**6, 10**6]}, weights),
        "deep": with_weights({**plain, "passes": 10**12}, weights),
        "infinite": with_weights({**plain, "passes": float("inf")}, weights),
        "other-arguments": with_weights({"speed": 3}, weights),
        "other-weights": with_weights(plain, {"a": torch.zeros(3)}),
    }
    for name, data in files.items():
        (folder / f"{name}.safetensors").write_bytes(data)
        yield "model", folder / f"{name}.safetensors", "ValueError"


# --- the tests ----------------------------------------------------------------------------------


@LINUX
@pytest.mark.slow
def test_refused_by_name_within_200_mb(sound: Path, tmp_path: Path) -> None:
    """In a process of their own: the loader's own error on one line, little memory, no code run."""
    wanted = []
    for cases in (shard_cases, manifest_cases, format_cases, problem_cases, model_cases):
        folder = tmp_path / cases.__name__
        folder.mkdir()
        wanted += list(cases(folder, sound))
    arguments = [f"{loader}={path}" for loader, path, _ in wanted]
    done = run_helper("refusals", *arguments)
    assert done.returncode == 0, done.stderr
    found = [json.loads(line) for line in done.stdout.splitlines()]
    errors = [(loader, Path(path), name) for loader, path, name, _ in found]
    assert errors == wanted
    *_, most = greediest = max(found, key=lambda each: each[3])
    assert most < MOST, greediest
    assert list(tmp_path.glob("*/hacked")) == []


def test_the_bomb_is_one(tmp_path: Path) -> None:
    """What the loaders refuse does run where pickles are trusted."""
    pickle.loads(pickle.dumps(Bomb(tmp_path / "hacked")))
    assert (tmp_path / "hacked").is_dir()


class Other(nn.Linear):
    """Another model than the one that was saved."""


def test_a_sound_model_is_read(tmp_path: Path) -> None:
    """Equal weights, in 16 bits, ready to plan; another class, or no file, is named."""
    model = PathPredictor(4, widths=(8, 8, 8), passes=1)
    model.save(tmp_path / "model.pt")
    again = load_model(tmp_path / "model.pt", PathPredictor)
    assert not again.training
    for name, value in model.state_dict().items():
        np.testing.assert_array_equal(again.state_dict()[name].numpy(), value.half().numpy())
    with pytest.raises(ValueError, match=r"model\.pt: holds no saved Other"):
        load_model(tmp_path / "model.pt", Other)
    with pytest.raises(FileNotFoundError, match=r"none\.pt"):
        load_model(tmp_path / "none.pt", PathPredictor)
