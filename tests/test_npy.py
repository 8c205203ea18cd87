"""Arrays in .npy and .npz files: read as NumPy reads them, refused before they are unpacked."""

from __future__ import annotations

import struct
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from helpers.wild import npy, npz

from mapdata.arrays import Array
from mapdata.npy import FormatError, Npz, open_npy


@contextmanager
def within(size: float) -> Iterator[None]:
    """Assert that no more than ``size`` bytes are allocated at a time."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < size
    finally:
        tracemalloc.stop()


ARRAYS = {
    "bytes": np.arange(24, dtype=np.uint8).reshape(4, 3, 2),
    "flags": np.array([[True, False], [False, True]]),
    "big_endian": np.arange(6, dtype=">i4").reshape(3, 2),
    "doubles": np.linspace(0, 1, 12).reshape(2, 1, 6),
    "fortran": np.asfortranarray(np.arange(12.0).reshape(3, 4)),
    "empty": np.empty((3, 0, 2), np.float32),
    "scalar": np.array(7),
}


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_are_those_that_numpy_reads(save: Callable[..., None], tmp_path: Path) -> None:
    """Whole, and an entry at a time, of every type and order."""
    save(tmp_path / "a.npz", **ARRAYS)
    archive = Npz(tmp_path / "a.npz")
    assert archive.shapes == {name: array.shape for name, array in ARRAYS.items()}
    for (name, array), stored in zip(ARRAYS.items(), archive.arrays(*ARRAYS), strict=True):
        np.save(tmp_path / f"{name}.npy", array)
        for source in (stored, open_npy(tmp_path / f"{name}.npy")):
            assert source.nbytes == array.nbytes
            whole = source.read()
            assert whole.dtype == array.dtype
            assert np.array_equal(whole, array)
            if array.size > 1:
                entries = list(source.entries())
                assert len(entries) == len(source) == len(array)
                assert np.array_equal(entries, array)
    (empty,) = archive.arrays("empty")
    assert list(empty.entries()) == []


def test_a_text_is_read(tmp_path: Path) -> None:
    """As `ProblemSet.save` writes one: without axes, of limited length."""
    np.savez_compressed(tmp_path / "a.npz", about="{'höhe': 5}", none="", numbers=np.arange(3))
    archive = Npz(tmp_path / "a.npz")
    assert archive.text("about") == "{'höhe': 5}"
    assert archive.text("none") == ""
    for name, message in (
        ("about", "expected a text of at most 4 letters"),
        ("numbers", "holds int64 of shape"),
        ("title", "holds no array 'title', but about, none, numbers"),
    ):
        with pytest.raises(FormatError, match=message):
            archive.text(name, max_length=4)


def compressed(path: Path, method: int) -> Path:
    """Write an archive that is compressed by another method than NumPy's."""
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("a.npy", npy((2**20,), bytes(2**20)))
    return path


def with_long_directory(path: Path, count: int) -> Path:
    """Write an archive whose directory has ``count`` lines, of 46 bytes and a name of one byte."""
    line = struct.pack("<4s24xH16x", b"PK\1\2", 1) + b"a"
    size = count * len(line)
    end = struct.pack("<4s4xHHIIxx", b"PK\5\6", count % 2**16, count % 2**16, size, 0)
    path.write_bytes(count * line + end)
    return path


def long_header(size: int) -> bytes:
    """Return an .npy whose header claims, and has, ``size`` bytes."""
    return b"\x93NUMPY\x02\x00" + struct.pack("<I", size) + b" " * size


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (lambda path: npz(path, a=npy((4,), bytes(3))), "has 131 bytes, expected 128 for its"),
        (lambda path: npz(path, a=npy((4,), bytes(5))), "has 133 bytes, expected 128 for its"),
        (lambda path: npz(path, a=npy((-4,), bytes(4))), "in shape"),
        (lambda path: npz(path, a=npy((2**62, 2**62), b"")), "in shape"),
        (lambda path: npz(path, a=npy((1,), b"abcd", "<U1")), "expected numbers of at most 8"),
        (lambda path: npz(path, a=npy((1,), bytes(16), "<c16")), "expected numbers of at most 8"),
        (lambda path: npz(path, a=npy((1,), b"\x80\x04N.", "|O")), "holds pickled objects"),
        (lambda path: npz(path, b=npy((4,), bytes(4))), "holds no array 'a', but b"),
        (lambda path: npz(path, a=npy((2**24,), bytes(2**24))), "a unpack to 16777216 bytes"),
        (lambda path: npz(path, a=long_header(2**24)), "not a sound .npz file"),
        (npz, "holds 0 arrays, expected 1 to 1000"),
        (lambda path: compressed(path, zipfile.ZIP_BZIP2), "is compressed by method 12"),
        (lambda path: compressed(path, zipfile.ZIP_LZMA), "is compressed by method 14"),
    ],
)
def test_archives_are_refused_before_they_are_unpacked(
    write: Callable[[Path], Path], message: str, tmp_path: Path
) -> None:
    """By name, and within two megabytes."""
    path = write(tmp_path / "a.npz")
    with within(2e6), pytest.raises(FormatError, match=message) as caught:
        Npz(path, 2**23).arrays("a")
    assert str(path) in str(caught.value)


def test_a_long_directory_is_not_read(tmp_path: Path) -> None:
    """Zipfile makes objects of all its lines before it says how many there are."""
    with zipfile.ZipFile(with_long_directory(tmp_path / "a.npz", 3)) as archive:
        assert len(archive.infolist()) == 3
    path = with_long_directory(tmp_path / "a.npz", 30_000)
    with (
        within(2e6),
        pytest.raises(FormatError, match="its directory has 1410000 bytes, expected at most"),
    ):
        Npz(path)


def test_the_limit_is_of_all_arrays_together(tmp_path: Path) -> None:
    """Of those that are read: one that is not asked for may be larger."""
    data = npy((2**20,), bytes(2**20))
    path = npz(tmp_path / "a.npz", a=data, b=data, c=npy((2**22,), bytes(2**22)))
    assert [array.shape for array in Npz(path, 2**21).arrays("a", "b")] == [(2**20,), (2**20,)]
    with pytest.raises(FormatError, match="a, b unpack to 2097152 bytes, expected at most 2097151"):
        Npz(path, 2**21 - 1).arrays("a", "b")


def test_entries_take_the_memory_of_one(tmp_path: Path) -> None:
    """Of an archive and of a plain file."""
    data = npy((64, 512, 512), bytes(2**24))
    path = npz(tmp_path / "a.npz", a=data)
    (tmp_path / "a.npy").write_bytes(data)
    for array in (*Npz(path).arrays("a"), open_npy(tmp_path / "a.npy")):
        with within(4e6):
            array.check()


def test_an_array_in_fortran_order_is_limited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its entries cannot be read one at a time."""
    monkeypatch.setattr("mapdata.npy._MAX_FORTRAN", 95)
    np.savez(tmp_path / "a.npz", fortran=ARRAYS["fortran"])
    (array,) = Npz(tmp_path / "a.npz").arrays("fortran")
    with pytest.raises(FormatError, match="has 96 bytes in Fortran order, expected at most 95"):
        array.check()


def test_damage_inside_an_array_is_found(tmp_path: Path) -> None:
    """A flipped bit, by the checksum of the archive; a directory that states less than there is."""
    numbers: Array = np.arange(20_000, dtype=np.uint16)
    np.savez(tmp_path / "a.npz", a=numbers)
    sound = (tmp_path / "a.npz").read_bytes()
    flipped = bytearray(sound)
    flipped[sound.index(numbers.tobytes()) + 30_000] ^= 1
    (tmp_path / "a.npz").write_bytes(flipped)
    (array,) = Npz(tmp_path / "a.npz").arrays("a")
    with pytest.raises(FormatError, match=r"a\.npz: array 'a': damaged"):
        array.read()
    with pytest.raises(FormatError, match=r"a\.npz: array 'a': damaged"):
        array.check()
    stated = len(npy((20_000,), numbers.tobytes(), "<u2")).to_bytes(4, "little")
    assert stated in sound
    (tmp_path / "a.npz").write_bytes(sound.replace(stated, (20_000).to_bytes(4, "little")))
    with pytest.raises(FormatError, match="expected 128 for its header"):
        Npz(tmp_path / "a.npz").arrays("a")


def test_a_file_that_is_missing_is_named(tmp_path: Path) -> None:
    """Or is a folder."""
    for path in (tmp_path, tmp_path / "none.npy"):
        for read in (open_npy, Npz):
            with pytest.raises(FormatError, match="no such file"):
                read(path)
