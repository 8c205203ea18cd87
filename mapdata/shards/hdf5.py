r"""A reader of HDF5 files that accepts only the bytes that h5py writes for a shard.

HDF5 can store the same content in many ways, and `shard_image` always uses the same one. So each
structure of a shard is one pattern here, and its addresses lead to the next structures:

    superblock -> root group -> B-tree and fractal heap -> attributes
                             -> B-tree and fractal heap -> links -> headers of datasets -> arrays

In a pattern ``\x08`` is a required byte, ``.`` is any byte, and parentheses enclose a field: an
unsigned integer, little-endian, unless it is a name or a value. White space is ignored. A file that
does not match is refused, so no content of a file can make this reader crash, loop or read outside
of the file. Reading compares no checksums, because the hash in the manifest covers all bytes of a
file. Where there is no manifest, h5py compares them afterwards (`check_metadata` in image.py).

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

_BLOCKS_PER_ROW = 4
"""Blocks in a row of a fractal heap's table."""

_UNDEFINED_ADDRESS = 2**64 - 1
"""The address of a block that does not exist."""

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

_HEAP = rb"""                          # III.G, the header of a fractal heap
    FRHP \x00 [\x07\x08]\x00 \x00\x00  # version, bytes of an ID, no filters
    \x02 \x00\x10\x00\x00              # blocks have checksums; bytes of an object, at most
    .{96} \x04\x00                     # numbers and sizes, blocks in a row
    \x00[\x02\x04]\x00{6}              # bytes of the first block
    \x00\x00\x01\x00{5}                # and of the largest one that holds objects
    ([\x20\x28])\x00 \x01\x00          # bits of an offset, rows at first
    (.{8}) ([\x00-\x08])\x00           # address of the root block; rows, 0 if it is the only block
"""
_INDIRECT_BLOCK = rb"FHIB \x00 .{8} \x00{%d}"  # version, heap, offset; addresses of blocks follow
_DIRECT_BLOCK = rb"FHDB \x00 .{8} (.{4})"  # version, heap, offset in the heap; objects follow

_TREE = rb"""                      # III.A.2, the header of a B-tree
    BTHD \x00                      # version; type of its records, bytes of a node and of a record
    (?: \x05 \x00\x02\x00\x00 \x0b\x00 | \x08 \x00\x02\x00\x00 \x11\x00 )
    \x00\x00 \x64\x28              # depth 0, at how many percent of its records it splits, merges
    (.{8}) (.)\x00                 # address of the leaf, records
"""
_LEAF = rb"BTLF \x00 [\x05\x08]"  # version, type of its records, which follow
_LINK_RECORD = rb".{4} . (.{4}) (..)"  # hash of the name; type, offset and length in the heap
_ATTRIBUTE_RECORD = rb". (.{4})\x00 (..) \x00 .{8}"  # type, offset, length; flags; order and hash

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

    Attributes are left out unless they are a text of fixed length, a float64, or one or two int64.
    Links out of the file are left out, too.

    Raises:
        ValueError: these are not the bytes of a shard.
    """
    end, root = _fields(_SUPERBLOCK, file, 0)
    if end != len(file):
        raise ValueError(f"it has {len(file)} bytes, its superblock says {end}")
    link_heap, link_tree, heap, tree = _fields(_ROOT_GROUP, file, root)
    attributes = {
        attribute[1].decode(): _attribute_value(attribute)
        for attribute in _heap_objects(_ATTRIBUTE, file, heap, tree, _ATTRIBUTE_RECORD)
    }
    addresses = {
        link[1].decode(): int.from_bytes(link[2], "little")
        for link in _heap_objects(_LINK, file, link_heap, link_tree, _LINK_RECORD)
    }
    return attributes, addresses


def read_dataset(file: memoryview, address: int, dtype: str, rank: int) -> Array:
    """Return the dataset whose header is at ``address``, as a view of the file.

    Raises:
        ValueError: it is not a contiguous array of this type and rank inside the file.
    """
    pattern = _DATASET % (rank, b"(.{8})" * rank, 8 * rank, _TYPES[dtype])
    *shape, offset, size = _fields(pattern, file, address)
    # A slice beyond the end of the file is shorter, so `reshape` refuses it.
    return np.frombuffer(file[offset : offset + size], dtype).reshape(shape)


def _heap_objects(
    pattern: bytes, file: memoryview, heap: int, tree: int, record: bytes
) -> Iterator[re.Match[bytes]]:
    """Yield the objects of a heap that match a pattern.

    Args:
        pattern: of an object.
        file: all bytes of the file.
        heap: address of the heap's header.
        tree: address of the header of the B-tree that lists the objects of the heap.
        record: pattern of a record of the B-tree, with the fields offset and length.
    """
    address_by_offset = _block_addresses(file, heap)
    leaf, count = _fields(_TREE, file, tree)
    fields = _fields(_LEAF + count * record, file, leaf)
    for offset, length in zip(fields[::2], fields[1::2], strict=True):
        # The object is in the last block that begins at or before its offset. An object of more
        # than 4,096 bytes is stored elsewhere, and its record leads to bytes that do not match.
        block_offset = max(begin for begin in address_by_offset if begin <= offset)
        address = address_by_offset[block_offset] + offset - block_offset
        match = _match(pattern, file[address : address + length])
        if match:
            yield match


def _block_addresses(file: memoryview, heap: int) -> dict[int, int]:
    """Return the address of each block of a heap by its offset in the heap."""
    offset_bits, root, rows = _fields(_HEAP, file, heap)
    addresses = [root]
    if rows:
        pattern = _INDIRECT_BLOCK % (offset_bits // 8) + b"(.{8})" * _BLOCKS_PER_ROW * rows
        addresses = _fields(pattern, file, root)
    address_by_offset = {}
    for address in addresses:
        if address != _UNDEFINED_ADDRESS:
            (offset,) = _fields(_DIRECT_BLOCK, file, address)
            address_by_offset[offset] = address
    return address_by_offset


def _attribute_value(attribute: re.Match[bytes]) -> Any:
    """Return the value of an attribute: a text, a number, or two numbers."""
    dtype = str(attribute.lastgroup)
    if dtype == "text":
        return attribute[dtype].decode()
    numbers = np.frombuffer(attribute[dtype], f"<{dtype}").tolist()
    return tuple(numbers) if len(numbers) > 1 else numbers[0]


def _fields(pattern: bytes, file: memoryview, address: int) -> list[int]:
    """Return the fields of the structure at ``address``, which are unsigned integers.

    Raises:
        ValueError: the bytes there do not match the pattern.
    """
    match = _match(pattern, file[address:])
    if match is None:
        raise ValueError(f"the bytes from {address} on are not those of a shard")
    return [int.from_bytes(field, "little") for field in match.groups()]


def _match(pattern: bytes, content: memoryview) -> re.Match[bytes] | None:
    """Match a pattern, whose white space and comments are ignored, at the first byte."""
    return re.match(pattern, content, _FLAGS)
