r"""The bytes of a shard: a strict reader of what h5py writes for one, and of nothing else.

HDF5 has many ways to say one thing, and `shard_image` always has it said in the same. So each
structure of a shard is one pattern here, and its addresses lead to the next ones:

    superblock -> root group -> B-tree and fractal heap -> attributes
                             -> B-tree and fractal heap -> links -> headers of datasets -> arrays

In a pattern ``\x08`` is a byte that must be there, ``.`` is any byte, and parentheses hold a field:
an unsigned integer, little-endian, unless it is a name or a value. White space stands for nothing.
A file is refused where it does not fit, so nothing that it says can make this reader crash, loop or
look outside of it. Reading compares no checksums: the hash in the manifest covers all bytes of a
file. Where there is no manifest, `check_metadata` compares the checksums that HDF5 keeps of all its
metadata, so a shard that passes reads the same with any HDF5 library.

Source: HDF5 File Format Specification 3.0, whose sections are named beside the patterns,
https://docs.hdfgroup.org/archive/support/HDF5/doc/H5.format.html
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from mapdata.arrays import Array

Extent = tuple[int, int]
"""(address, bytes) of a structure in a file."""

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
    FRHP \x00 .. \x00\x00 \x02      # version, bytes of an ID, no filters, blocks have checksums
    .{100} \x04\x00 (.{8}) .{8}     # sizes and numbers, blocks in a row, bytes of the first block
    (.)\x00 ..                      # bits of an offset
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
    return attributes, _linked(file, link_heap, link_tree)


def read_dataset(file: memoryview, address: int, dtype: str, rank: int) -> Array:
    """Return the dataset whose header is at ``address``, as a view of the file.

    Raises:
        ValueError: it is not contiguous data of this type and rank inside the file.
    """
    pattern = _DATASET % (rank, b"(.{8})" * rank, 8 * rank, _TYPES[dtype])
    *shape, offset, size = _fields(pattern, file, address)
    # a slice ends where the file does: then it has too few bytes for the shape
    return np.frombuffer(file[offset : offset + size], dtype).reshape(shape)


def member_counts(file: memoryview) -> tuple[int, int]:
    """Return how many attributes and how many links the root group has, of whatever type.

    Raises:
        ValueError: these are not the bytes of a shard.
    """
    _, root = _fields(_SUPERBLOCK, file, 0)
    _, link_tree, _, tree = _fields(_ROOT_GROUP, file, root)
    _, attributes = _fields(_TREE, file, tree)
    _, links = _fields(_TREE, file, link_tree)
    return attributes, links


def _linked(file: memoryview, heap: int, tree: int) -> dict[str, int]:
    """Return the addresses that the links in a heap lead to, by name."""
    return {
        link[1].decode(): int.from_bytes(link[2], "little")
        for link in _objects(_LINK, file, heap, tree, _LINK_RECORD)
    }


def _objects(
    pattern: bytes, file: memoryview, heap: int, tree: int, record: bytes
) -> Iterator[re.Match[bytes]]:
    """Yield the objects of a heap that the records of its B-tree name, if they fit ``pattern``."""
    blocks = _blocks(file, heap)
    leaf, count = _fields(_TREE, file, tree)
    places = _fields(_LEAF + count * record, file, leaf)
    for offset, length in zip(places[::2], places[1::2], strict=True):
        # What is over 4,096 bytes lies elsewhere; in the place read here nothing fits a pattern.
        first = max(begin for begin in blocks if begin <= offset)
        begin = blocks[first] + offset - first
        if found := _match(pattern, file[begin : begin + length]):
            yield found


def _blocks(file: memoryview, heap: int) -> dict[int, int]:
    """Return the addresses of the blocks of a heap by where they begin in it."""
    return {
        _fields(_DIRECT_BLOCK, file, address)[0]: address
        for address, _ in _block_extents(file, heap)
    }


def _block_extents(file: memoryview, heap: int) -> list[Extent]:
    """Return the addresses and sizes of the blocks of a heap."""
    size, bits, root, rows = _fields(_HEAP, file, heap)
    addresses = [root]
    if rows:
        pattern = _INDIRECT_BLOCK % (bits // 8) + b"(.{8})" * 4 * rows
        addresses = _fields(pattern, file, root)
    return [
        # all blocks of the first two rows have one size, those of each further row twice as much
        (address, size << max(0, number // 4 - 1))
        for number, address in enumerate(addresses)
        if address != 2**64 - 1  # no block there
    ]


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


# --- checksums ----------------------------------------------------------------------------------

_MAX_STRUCTURE = 2**16
"""Most bytes of one structure of metadata; those of a shard are far smaller."""

_CHECKSUM = 4
"""Bytes of a checksum, which follows what it covers."""

_WORD = 2**32 - 1
"""All bits of a word."""

_LINK_RECORD_BYTES = 11
_ATTRIBUTE_RECORD_BYTES = 17


_DOES_NOT_FIT = "their checksum does not fit"


class ChecksumError(ValueError):
    """Metadata of HDF5 that are not as they were written: damage, whoever wrote them."""


def check_metadata(file: memoryview, names: Iterable[str]) -> None:
    """Compare the checksums of all metadata that a library reads of a shard's datasets ``names``.

    Raises:
        ChecksumError: the metadata are damaged, or the file is cut short or too long.
        ValueError: they are not laid out as those of a shard. Since all is sound up to the first
            such structure, this is no damage: another program wrote it.
    """
    _check_superblock(file)
    _, root = _fields(_SUPERBLOCK, file, 0)
    _check_object_header(file, root)
    link_heap, link_tree, heap, tree = _fields(_ROOT_GROUP, file, root)
    _check_heap(file, link_heap)
    _check_tree(file, link_tree, _LINK_RECORD_BYTES)
    _check_heap(file, heap)
    _check_tree(file, tree, _ATTRIBUTE_RECORD_BYTES)
    addresses = _linked(file, link_heap, link_tree)
    for name in names:
        if name in addresses:
            _check_object_header(file, addresses[name])


def checksum_of(data: bytes | memoryview) -> int:
    """Return the checksum that HDF5 keeps of its metadata, an unsigned integer of 32 bits.

    Source: hashlittle of lookup3.c by Bob Jenkins, http://burtleburtle.net/bob/c/lookup3.c
    """
    a = b = c = (0xDEADBEEF + len(data)) & _WORD
    if not len(data):
        return c
    # Zeros at the end add nothing, and the length is counted above.
    padded = bytes(data) + bytes(-len(data) % 12)
    blocks: list[tuple[int, int, int]] = list(struct.iter_unpack("<3I", padded))
    for x, y, z in blocks[:-1]:
        a, b, c = a + x & _WORD, b + y & _WORD, c + z & _WORD
        for bits in (4, 6, 8, 16, 19, 4):
            a = (a - c ^ _rotated(c, bits)) & _WORD
            c = c + b & _WORD
            a, b, c = b, c, a
    x, y, z = blocks[-1]
    a, b, c = a + x & _WORD, b + y & _WORD, c + z & _WORD
    for bits in (14, 11, 25, 16, 4, 14, 24):
        c = ((c ^ b) - _rotated(b, bits)) & _WORD
        a, b, c = b, c, a
    return b


def _rotated(word: int, bits: int) -> int:
    """Rotate a word of 32 bits to the left."""
    return (word << bits | word >> (32 - bits)) & _WORD


def _compare(file: memoryview, begin: int, size: int) -> None:
    """Compare the checksum of ``size`` bytes, which stands behind them."""
    end = begin + size
    if not (0 <= size <= _MAX_STRUCTURE and end + _CHECKSUM <= len(file)):
        raise ChecksumError(f"its metadata at {begin} lead out of the file")
    if checksum_of(file[begin:end]) != int.from_bytes(file[end : end + _CHECKSUM], "little"):
        raise ChecksumError(f"its metadata at {begin} are damaged: {_DOES_NOT_FIT}")


def _check_superblock(file: memoryview) -> None:
    """Check the superblock of a file of any program (II.A)."""
    signature = b"\x89HDF\r\n\x1a\n"
    if bytes(file[:8]) != signature:
        # the block of a user before it has 512 bytes, or twice as many, and so on
        if any(bytes(file[2**k :][:8]) == signature for k in range(9, len(file).bit_length())):
            raise ValueError("it begins with a user block")
        raise ChecksumError("it does not begin as an HDF5 file does")
    version = file[8] if len(file) > 8 else 0
    # versions 0 and 1 have no checksum; base address and end of file tell whether it is whole
    base = {0: 24, 1: 28}.get(version, 12)
    if version > 1:
        _compare(file, 0, 44)
    first, *_, last = struct.unpack_from("<3Q", file, base) if len(file) >= base + 24 else (0, 0)
    if first + last != len(file):
        raise ChecksumError(f"it has {len(file)} bytes, its superblock says {first + last}")
    if version != 3:
        raise ValueError(f"its superblock has version {version}")


def _check_object_header(file: memoryview, address: int) -> None:
    """Check all chunks of an object header of version 2 (IV.A.1.b), of any program."""
    prefix = bytes(file[address : address + 6])
    if prefix[:2] == b"\x01\x00":
        raise ValueError("an object header of version 1 has no checksum")
    if prefix[:5] != b"OHDR\x02":
        raise ChecksumError(f"its metadata at {address} are damaged: no object header is there")
    flags = prefix[5]
    width = 1 << (flags & 3)  # bytes of the size of the first chunk
    begin = 6 + (16 if flags & 0x20 else 0) + (4 if flags & 0x10 else 0) + width
    size = int.from_bytes(file[address + begin - width : address + begin], "little")
    left = _MAX_STRUCTURE
    chunks = [(address, begin, begin + size)]
    for chunk, first, covered in chunks:
        left -= covered
        if left < 0:
            raise ChecksumError(f"its metadata at {address} are damaged: they have no end")
        _compare(file, chunk, covered)
        # type, size and flags of a message, and its number where the header says so
        message_header = 6 if flags & 0x04 else 4
        place = chunk + first
        while place + message_header <= chunk + covered:
            size = int.from_bytes(file[place + 1 : place + 3], "little")
            body = place + message_header
            ends = body + size <= chunk + covered
            if (
                file[place] == 0x10 and size == 16 and ends
            ):  # IV.A.2.q: the header goes on elsewhere
                where, length = struct.unpack_from("<2Q", file, body)
                chunks.append((where, len(b"OCHK"), length - _CHECKSUM))
            place = body + size


def _check_heap(file: memoryview, heap: int) -> None:
    """Check the header and the blocks of a fractal heap (III.G)."""
    _compare(file, heap, 142)
    _, bits, root, rows = _fields(_HEAP, file, heap)
    offset_bytes = bits // 8
    if rows:
        _compare(file, root, 13 + offset_bytes + 8 * 4 * rows)
    begin = 13 + offset_bytes
    for address, size in _block_extents(file, heap):
        # The checksum of a block is part of it, and counts as zeros there.
        block = bytearray(file[address : address + min(size, _MAX_STRUCTURE)])
        stated = int.from_bytes(block[begin : begin + _CHECKSUM], "little")
        block[begin : begin + _CHECKSUM] = bytes(_CHECKSUM)
        if checksum_of(bytes(block)) != stated:
            raise ChecksumError(f"its metadata at {address} are damaged: {_DOES_NOT_FIT}")


def _check_tree(file: memoryview, tree: int, record: int) -> None:
    """Check the header and the leaf of a B-tree (III.A.2) with records of ``record`` bytes."""
    _compare(file, tree, 34)
    leaf, count = _fields(_TREE, file, tree)
    _compare(file, leaf, 6 + count * record)
