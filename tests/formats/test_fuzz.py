"""Bytes at random: every importer answers with maps or with one FormatError, whatever the file."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.examples import examples
from helpers.foreign_files import SOURCES
from helpers.wild import SETTINGS
from hypothesis import given
from hypothesis import strategies as st

from mapdata.formats import FormatError, Limits, read_any
from mapdata.formats.movingai import check_scen
from mapdata.formats.registry import FORMATS, functions_by_format

LIMITS = Limits(pixels=2**12, unpacked=2**16)
CHANGES = st.lists(
    st.tuples(
        st.integers(0, 2**16),
        st.sampled_from(["flip", "set", "cut", "insert", "delete"]),
        st.binary(max_size=6),
    ),
    max_size=4,
)


def test_every_format_has_a_source() -> None:
    """A new format gets one in helpers/foreign_files.py."""
    assert {source.format for source in SOURCES.values()} == functions_by_format("read").keys()


def changed(data: bytes, changes: list[tuple[int, str, bytes]]) -> bytes:
    """Return ``data`` after these changes."""
    out = bytearray(data)
    for place, change, more in changes:
        at = place % max(len(out), 1)
        if change == "flip" and out:
            out[at] ^= 1 << (place % 8)
        elif change == "set":
            out[at : at + len(more)] = more
        elif change == "insert":
            out[at:at] = more
        elif change == "cut":
            del out[at:]
        else:
            del out[at : at + len(more)]
    return bytes(out)


def attempt(read: Callable[[], object]) -> None:
    """Call an importer: a FormatError must be one line, and nothing else may come."""
    problem = ""
    try:
        read()
    except FormatError as error:
        problem = str(error)
    assert "\n" not in problem


@pytest.mark.parametrize("kind", SOURCES)
@examples(120, SETTINGS)
@given(CHANGES, st.integers(0, 5), st.booleans())
def test_a_changed_file_is_read_or_refused(
    kind: str, changes: list[tuple[int, str, bytes]], number: int, is_named: bool
) -> None:
    """A few bytes of a valid file are changed, of those that are named and of those beside them."""
    source = SOURCES[kind]
    names = list(source.files)
    changed_name = names[number % len(names)]
    spoiled = {**source.files, changed_name: changed(source.files[changed_name], changes)}
    with tempfile.TemporaryDirectory() as folder:
        named = source._replace(files=spoiled).write(Path(folder))
        attempt(lambda: read_any(named if is_named else folder, source.format, LIMITS))
        if named.suffix == ".scen":
            attempt(lambda: check_scen(named, limits=LIMITS))


@SETTINGS
@given(st.binary(max_size=60))
def test_a_file_of_any_bytes_is_read_or_refused(data: bytes) -> None:
    """The file has any bytes and any ending, and its format is recognised or named."""
    endings = sorted({ending for known in FORMATS.values() for ending in known.endings})
    with tempfile.TemporaryDirectory() as folder:
        for ending in endings:
            path = Path(folder) / f"a{ending}"
            path.write_bytes(data)
            attempt(lambda path=path: read_any(path, limits=LIMITS))  # type: ignore[misc]
