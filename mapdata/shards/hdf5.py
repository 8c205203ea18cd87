r"""The bytes of a shard: a strict reader of what h5py writes for one, and of nothing else.

HDF5 has many ways to say one thing, and `shard_image` always has it said in the same. So each
structure of a shard is one pattern here, and its addresses lead to the next ones:

    superblock -> root group -> B-tree and fractal heap -> attributes
                             -> B-tree and fractal heap -> links -> headers of datasets -> arrays

In a pattern ``\x08`` is a byte that must be there, ``.`` is any byte, and parentheses hold a field:
an unsigned integer, little-endian, unless it is a name or a value. White space stands for nothing.
A file is refused where it does not fit, so nothing that it says can make this reader crash, loop or
look outside of it. Checksums are not compared: the hash in the manifest covers all bytes of a file,
and the content hash all maps and labels.

Source: HDF5 File Format Specification 3.0, whose sections are named beside the patterns,
https://docs.hdfgroup.org/archive/support/HDF5/doc/H5.format.html
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from mapdata.arrays import Array

_FLAGS = re.DOTALL | re.VERBOSE

_SUPERBLOCK = rb"""       # II.A
    \x89HDF\r\n\x1a\n     # signature
    \x03 \x08 \x08 \x00   # version, bytes of an address, bytes of a length, nobody writes to it
    \x00{8} \xff{8}       # base address, no extension
    (.{8}) (.{8})         # end of the file, address of the root group
"""

_ROOT_GROUP = rb"""                             # IV.A.1.b, an object header
    OHDR \x02 (?: \x01 | \x21 .{16} ) ..        # version, flags without or with times, size
    \x02 \x12\x00 \x00 \x00\x00 (.{8}) (.{8})   # IV.A.2.c, heap and B-tree of the links
    \x0a \x02\x00 \x01 \x00\x00                 # IV.A.2.k, nothing else about the group
    \x15 \x12\x00 \x04 \x00\x00 (.{8}) (.{8})   # IV.A.2.v, heap and B-tree of the attributes
"""

_HEAP = rb"""                      # III.G, the header of a fractal heap
    FRHP \x00 .. \x00\x00 .{101}   # version, bytes of an ID, no filters, sizes and numbers
    \x04\x00 .{16} (.)\x00 ..      # blocks in a row, sizes of blocks, bits of an offset
    (.{8}) ([\x00-\x08])\x00       # address of the root block; its rows, 0 if it is the only block
"""
_INDIRECT_BLOCK = rb"FHIB \x00 .{8} \x00{%d}"  # version, heap, offset; addresses of blocks follow
_DIRECT_BLOCK = rb"FHDB \x00 .{8} (.{4})"  # version, heap, offset in the heap; objects follow

_TREE = rb"""                      # III.A.2, the header of a B-tree
    BTHD \x00 [\x05\x08] .{6}      # version, type of its records, size of a node and of a record
    \x00\x00 .. (.{8}) (.)\x00     # depth 0, when to split and merge; address of the leaf, records
"""
_LEAF = rb"BTLF \x00 [\x05\x08]"  # version, type of its records, which follow
_LINK_RECORD = rb".{4} . (.{4}) (..)"  # hash of the name; type, offset and length in the heap
_ATTRIBUTE_RECORD = rb". (.{4})\x00 (..) .{9}"  # type, offset and length; flags, order, hash

_LINK = rb"\x01 \x00 . (.+) (.{8}) \Z"  # IV.A.2.g: version, hard link, length; name, address

_TYPES = {  # IV.A.2.d: an integer; signed or not, little-endian; bytes; first bit, number of bits
    "u1": rb"\x10 \x00\x00\x00 \x01\x00\x00\x00 \x00\x00 \x08\x00",
    "i1": rb"\x10 \x08\x00\x00 \x01\x00\x00\x00 \x00\x00 \x08\x00",
    "<i2": rb"\x10 \x08\x00\x00 \x02\x00\x00\x00 \x00\x00 \x10\x00",
    "<i4": rb"\x10 \x08\x00\x00 \x04\x00\x00\x00 \x00\x00 \x20\x00",
    "<i8": rb"\x10 \x08\x00\x00 \x08\x00\x00\x00 \x00\x00 \x40\x00",
}

_ATTRIBUTE = rb"""                      # IV.A.2.m
    \x03 \x00 .{7} ([^\x00]+) \x00      # version, flags, sizes, encoding of the name; name
    (?:
        \x13 \x11\x00\x00 .{4}          # IV.A.2.d, a text of fixed length in UTF-8
        \x02 \x00\x00\x00               # IV.A.2.b, one of them
        (?P<text> [^\x00]*) \x00*
    |
        %b                              # an int64
        \x02 (?: \x00\x00\x00 | \x01\x01\x01 .{16} )  # one of them, or some
        (?P<i8> .{8} | .{16} )
    |
        \x11 \x20\x3f\x00 \x08\x00\x00\x00 \x00\x00 \x40\x00 \x34\x0b\x00\x34 \xff\x03\x00\x00
        \x02 \x00\x00\x00               # a float64, one of them
        (?P<f8> .{8} )
    ) \Z
""" % _TYPES["<i8"]

_DATASET = rb"""                                 # IV.A.1.b, an object header
    OHDR \x02 \x01 ..                            # version, flags, size
    \x01 .. \x00  \x02 \x%02x \x01\x01 %b .{%d}  # IV.A.2.b, rank, shape; how far it may grow
    \x03 \x0c\x00 \x01  %b                       # IV.A.2.d, type
    \x05 \x02\x00 \x01  \x03\x0a                 # IV.A.2.f, no fill value
    \x08 \x12\x00 \x00  [\x03\x04] \x01          # IV.A.2.i, version 3 or 4, contiguous
    ([\x00\x40\x80\xc0] .{7} | \xff{8}) (.{8})   # address, a multiple of 64 or none; bytes
"""


def read_root(file: memoryview) -> tuple[dict[str, Any], dict[str, int]]:
    """Return the attributes of the root group and the addresses of the datasets, by name.

    Attributes that are neither a text of fixed length, a float64 nor one or two int64 are left
    out, and so are links to elsewhere.

    Raises:
        ValueError: these are not the bytes of a shard.
    """
    end, root = _fields(_SUPERBLOCK, file, 0)
    if end != len(file):
        raise ValueError(f"it has {len(file)} bytes, its superblock says {end}")
    link_heap, link_tree, heap, tree = _fields(_ROOT_GROUP, file, root)
    attributes = {
        found[1].decode(): _value(found)
        for found in _objects(_ATTRIBUTE, file, heap, tree, _ATTRIBUTE_RECORD)
    }
    addresses = {
        found[1].decode(): int.from_bytes(found[2], "little")
        for found in _objects(_LINK, file, link_heap, link_tree, _LINK_RECORD)
    }
    return attributes, addresses


def read_dataset(file: memoryview, address: int, dtype: str, rank: int) -> Array:
    """Return the dataset whose header is at ``address``, as a view of the file.

    Raises:
        ValueError: it is not contiguous data of this type and rank inside the file.
    """
    pattern = _DATASET % (rank, b"(.{8})" * rank, 8 * rank, _TYPES[dtype])
    *shape, offset, size = _fields(pattern, file, address)
    # a slice ends where the file does: then it has too few bytes for the shape
    return np.frombuffer(file[offset : offset + size], dtype).reshape(shape)


def _objects(
    pattern: bytes, file: memoryview, heap: int, tree: int, record: bytes
) -> Iterator[re.Match[bytes]]:
    """Yield the objects of a heap that the records of its B-tree name, if they fit ``pattern``."""
    blocks = _blocks(file, heap)
    leaf, count = _fields(_TREE, file, tree)
    places = _fields(_LEAF + count * record, file, leaf)
    for offset, length in zip(places[::2], places[1::2], strict=True):
        # What is over 4,096 bytes lies elsewhere; in the place read here nothing fits a pattern.
        first = max(each for each in blocks if each <= offset)
        begin = blocks[first] + offset - first
        if found := _match(pattern, file[begin : begin + length]):
            yield found


def _blocks(file: memoryview, heap: int) -> dict[int, int]:
    """Return the addresses of the blocks of a heap by where they begin in it."""
    bits, root, rows = _fields(_HEAP, file, heap)
    addresses = [root]
    if rows:
        pattern = _INDIRECT_BLOCK % (bits // 8) + b"(.{8})" * 4 * rows
        addresses = _fields(pattern, file, root)
    return {
        _fields(_DIRECT_BLOCK, file, address)[0]: address
        for address in addresses
        if address != 2**64 - 1  # no block there
    }


def _value(attribute: re.Match[bytes]) -> Any:
    """Return the value of an attribute: a text, a number, or two of them."""
    kind = str(attribute.lastgroup)
    if kind == "text":
        return attribute[kind].decode()
    numbers = np.frombuffer(attribute[kind], f"<{kind}").tolist()
    return tuple(numbers) if len(numbers) > 1 else numbers[0]


def _fields(pattern: bytes, file: memoryview, address: int) -> list[int]:
    """Return the fields of the structure at ``address``, all of them unsigned integers."""
    found = _match(pattern, file[address:])
    if found is None:
        raise ValueError(f"the bytes from {address} on are not those of a shard")
    return [int.from_bytes(field, "little") for field in found.groups()]


def _match(pattern: bytes, data: memoryview) -> re.Match[bytes] | None:
    """Match from the first byte; white space and comments in a pattern stand for nothing."""
    return re.match(pattern, data, _FLAGS)
