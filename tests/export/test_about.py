"""`verify_export` finds every change of an export of any format, and takes older exports."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapdata import PRESETS, Maze
from mapdata.export import PROBLEM_FORMATS, export_problems, verify_export
from mapdata.hashing import json_hash

MAZE = Maze((5, 5), seed_points=2)


@pytest.fixture(scope="module")
def exports(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a small export of each format."""
    folder = tmp_path_factory.mktemp("exports")
    for name in PROBLEM_FORMATS:
        source = PRESETS["tiles"] if name == "warcraft" else MAZE
        options: dict[str, Any] = {"problems": "random"} if name != "warcraft" else {}
        if name not in ("gppn", "vin"):  # one file of all splits
            options["split"] = "train"
        export_problems(source, folder / name, format=name, count=2, **options)
    return folder


def flipped(content: bytes, bit: int) -> bytes:
    """Return bytes with one bit flipped."""
    changed = bytearray(content)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def check_flips(folder: Path, flips: int | None) -> None:
    """Check that flipped bits of each file are found, ``flips`` of them or all.

    There is one line, which names the file.
    """
    assert verify_export(folder) == []
    for path in sorted(folder.rglob("*")):
        if path.is_dir() or path.name == "README.md":
            continue
        content = path.read_bytes()
        bits = 8 * len(content)
        for bit in range(3, bits, 1 if flips is None else max(1, bits // flips)):
            path.write_bytes(flipped(content, bit))
            faults = verify_export(folder)
            assert len(faults) == 1, (path, bit)
            assert faults[0].startswith(str(path)), (path, bit)
            assert "\n" not in faults[0]
        path.write_bytes(content)
    assert verify_export(folder) == []


@pytest.mark.parametrize("name", PROBLEM_FORMATS)
def test_flipped_bits_are_found(name: str, exports: Path, tmp_path: Path) -> None:
    """In every file of every format, headers and archives included; the card may be edited."""
    folder = Path(shutil.copytree(exports / name, tmp_path / "copy"))
    if (folder / "README.md").exists():
        (folder / "README.md").write_text("mine")
    check_flips(folder, 3)
    about = folder / "export.json"
    text = about.read_text()
    about.write_text(text.replace('"format_version"', '"format_versinn"'))
    assert verify_export(folder) == [f"{about}: damaged (its hash does not fit)"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["arrays", "gppn", "hrm", "maze-hard"])
def test_every_flipped_bit_is_found(name: str, exports: Path, tmp_path: Path) -> None:
    """One after the other."""
    check_flips(Path(shutil.copytree(exports / name, tmp_path / "copy")), None)


def test_missing_truncated_and_strange_files_are_named(exports: Path, tmp_path: Path) -> None:
    """All of them at once."""
    folder = Path(shutil.copytree(exports / "hrm", tmp_path / "copy"))
    (folder / "train/all__inputs.npy").unlink()
    (folder / "train/dataset.json").unlink()
    labels = folder / "train/all__labels.npy"
    labels.write_bytes(labels.read_bytes()[:-1])
    (folder / "train/mine.npy").write_bytes(b"")
    (folder / ".gitattributes").write_text("hidden")
    faults = {line.partition(": ")[0]: line.partition(": ")[2] for line in verify_export(folder)}
    assert faults == {
        str(folder / "train/all__inputs.npy"): "missing",
        str(folder / "train/dataset.json"): "missing",
        str(labels): faults[str(labels)],
        str(folder / "train/mine.npy"): "no file of this export: keep it elsewhere",
    }
    assert "expected 128 for its header" in faults[str(labels)]


def test_arrays_of_another_type_or_shape_are_named(exports: Path, tmp_path: Path) -> None:
    """As is another spelling of the same type, which is another bit of the header."""
    folder = Path(shutil.copytree(exports / "arrays", tmp_path / "copy"))
    grids = folder / "train/map.npy"
    content = grids.read_bytes()
    grids.write_bytes(content.replace(b"|u1", b"<u1"))
    says = "damaged (the hash of its header does not fit)"
    assert verify_export(folder) == [f"{grids}: {says}"]
    grids.write_bytes(content)
    starts = folder / "train/start.npy"
    np.save(starts, np.load(starts).astype(np.int32))
    says = "holds int32 of shape [2, 2], export.json says int64 of shape [2, 2]"
    assert verify_export(folder) == [f"{starts}: {says}"]


def test_exports_of_mapdata_0_2_are_compared_with_what_they_state(
    exports: Path, tmp_path: Path
) -> None:
    """They have no format number; the contents of their arrays, rows and lines have hashes."""
    for name in ("arrays", "gppn", "maze-hard"):
        folder = Path(shutil.copytree(exports / name, tmp_path / name))
        about = json.loads((folder / "export.json").read_text())
        for entry in ("format_version", "header_hashes", "file_hashes", "hash"):
            del about[entry]
        (folder / "export.json").write_text(json.dumps(about, indent=1) + "\n")
        assert verify_export(folder) == []
        first = next(iter(about["files"]))
        about["files"][first]["sha256"] = "0" * 64
        about["content_hash"] = json_hash(about["files"])
        (folder / "export.json").write_text(json.dumps(about, indent=1) + "\n")
        damaged = "damaged (the hash in export.json does not fit)"
        assert verify_export(folder) == [f"{folder / first}: {damaged}"]


def test_a_newer_format_and_names_that_lead_out_are_refused(exports: Path, tmp_path: Path) -> None:
    """In a line; a folder without the file is no export."""
    folder = Path(shutil.copytree(exports / "arrays", tmp_path / "copy"))
    path = folder / "export.json"
    about = json.loads(path.read_text())
    path.write_text(json.dumps(about | {"format_version": 3}))
    says = "has format_version 3, expected 1 to 2: install a newer version of mapdata"
    assert verify_export(folder) == [f"{path}: {says}"]
    files = {"../../secret.npy": {"sha256": ""}}
    path.write_text(json.dumps({"files": files, "content_hash": json_hash(files)}))
    assert verify_export(folder) == [f"{path}: damaged (it names the file '../../secret.npy')"]
    for text in ("", "[]", '{"files": 3, "content_hash": ""}', "{}"):
        path.write_text(text)
        assert verify_export(folder)[0].startswith(f"{path}: ")
    path.unlink()
    with pytest.raises(FileNotFoundError):
        verify_export(folder)
