r"""A reader of HDF5 files that accepts only the bytes that h5py writes for a shard.

HDF5 can store the same content in many ways, and `shard_image` always uses the same one. So each
structure of a shard is one pattern here, and its addresses lead to the next structures:

    superblock -> root group -> B-tree and fractal heap -> attributes
                             -> B-tree and fractal heap -> links -> headers of datasets -> arrays

In a pattern ``\x08`` is a required byte, ``.`` is any byte, and parentheses enclose a field: an
unsigned integer, little-endian, unless it is a name or a value. White space is ignored. A file that
does not match is refused, so no content of a file can make this reader crash, loop or read outside
of the file. Reading compares no checksums, because the hash in the manifest covers all bytes of a
file. Where there is no manifest, `check_metadata` compares the checksums that HDF5 stores with all
its metadata, so a shard that passes reads the same with any HDF5 library.

Source: HDF5 File Format Specification 3.0, whose sections are named beside the patterns,
https://docs.hdfgroup.org/archive/support/HDF5/doc/H5.format.html
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from mapdata.arrays import Array

Extent = tuple[int, int]
"""(address, bytes) of a structure in a file."""

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
    return attributes, _link_addresses(file, link_heap, link_tree)


def read_dataset(file: memoryview, address: int, dtype: str, rank: int) -> Array:
    """Return the dataset whose header is at ``address``, as a view of the file.

    Raises:
        ValueError: it is not a contiguous array of this type and rank inside the file.
    """
    pattern = _DATASET % (rank, b"(.{8})" * rank, 8 * rank, _TYPES[dtype])
    *shape, offset, size = _fields(pattern, file, address)
    # A slice beyond the end of the file is shorter, so `reshape` refuses it.
    return np.frombuffer(file[offset : offset + size], dtype).reshape(shape)


def member_counts(file: memoryview) -> tuple[int, int]:
    """Return the numbers of attributes and of links of the root group, of any type.

    Raises:
        ValueError: these are not the bytes of a shard.
    """
    _, root = _fields(_SUPERBLOCK, file, 0)
    _, link_tree, _, tree = _fields(_ROOT_GROUP, file, root)
    _, attributes = _fields(_TREE, file, tree)
    _, links = _fields(_TREE, file, link_tree)
    return attributes, links


def _link_addresses(file: memoryview, heap: int, tree: int) -> dict[str, int]:
    """Return the addresses of the objects that the links in a heap point to, by name."""
    return {
        link[1].decode(): int.from_bytes(link[2], "little")
        for link in _heap_objects(_LINK, file, heap, tree, _LINK_RECORD)
    }


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
    addresses = {}
    for address, _ in _block_extents(file, heap):
        (offset,) = _fields(_DIRECT_BLOCK, file, address)
        addresses[offset] = address
    return addresses


def _block_extents(file: memoryview, heap: int) -> list[Extent]:
    """Return the addresses and sizes of the blocks of a heap."""
    first_size, offset_bits, root, rows = _fields(_HEAP, file, heap)
    addresses = [root]
    if rows:
        pattern = _INDIRECT_BLOCK % (offset_bits // 8) + b"(.{8})" * _BLOCKS_PER_ROW * rows
        addresses = _fields(pattern, file, root)
    extents = []
    for number, address in enumerate(addresses):
        if address != _UNDEFINED_ADDRESS:
            # The blocks of rows 0 and 1 have the same size; it doubles with each row after them.
            row = number // _BLOCKS_PER_ROW
            extents.append((address, first_size << max(0, row - 1)))
    return extents


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


# --- checksums ----------------------------------------------------------------------------------

_MAX_STRUCTURE = 2**16
"""Largest structure of metadata, in bytes; those of a shard are far smaller."""

_CHECKSUM = 4
"""Bytes of a checksum, which follows the bytes that it covers."""

_WORD_MASK = 2**32 - 1
"""All bits of a word of 32 bits."""

_LINK_RECORD_BYTES = 11
_ATTRIBUTE_RECORD_BYTES = 17

_CONTINUATION = 0x10
"""Type of the message that says where an object header continues (IV.A.2.q)."""

_CHUNK_SIGNATURE = b"OCHK"

_DOES_NOT_FIT = "their checksum does not fit"


class ChecksumError(ValueError):
    """The metadata of an HDF5 file, of mapdata or another program, are damaged."""


def check_metadata(file: memoryview, names: Iterable[str]) -> None:
    """Compare the checksums of all metadata that a library reads for the datasets ``names``.

    Raises:
        ChecksumError: the metadata are damaged, or the file is cut short or too long.
        ValueError: a structure is not laid out as in a shard. Everything before it is sound, so
            this is not damage: another program wrote the file.
    """
    _check_superblock(file)
    _, root = _fields(_SUPERBLOCK, file, 0)
    _check_object_header(file, root)
    link_heap, link_tree, heap, tree = _fields(_ROOT_GROUP, file, root)
    _check_heap(file, link_heap)
    _check_tree(file, link_tree, _LINK_RECORD_BYTES)
    _check_heap(file, heap)
    _check_tree(file, tree, _ATTRIBUTE_RECORD_BYTES)
    addresses = _link_addresses(file, link_heap, link_tree)
    for name in names:
        if name in addresses:
            _check_object_header(file, addresses[name])


def metadata_checksum(content: bytes | memoryview) -> int:
    """Return the checksum that HDF5 stores with its metadata, an unsigned integer of 32 bits.

    Source: hashlittle of lookup3.c by Bob Jenkins, http://burtleburtle.net/bob/c/lookup3.c, whose
    names of variables are kept.
    """
    length = len(content)
    a = b = c = (0xDEADBEEF + length) & _WORD_MASK
    if length == 0:
        return c
    # The last block is padded with zeros. They add nothing, and the length is counted above.
    padded = bytes(content) + bytes(-length % 12)
    blocks: list[tuple[int, int, int]] = list(struct.iter_unpack("<3I", padded))
    for x, y, z in blocks[:-1]:
        a, b, c = a + x & _WORD_MASK, b + y & _WORD_MASK, c + z & _WORD_MASK
        for bits in (4, 6, 8, 16, 19, 4):
            a = (a - c ^ _rotate_left(c, bits)) & _WORD_MASK
            c = c + b & _WORD_MASK
            a, b, c = b, c, a
    x, y, z = blocks[-1]
    a, b, c = a + x & _WORD_MASK, b + y & _WORD_MASK, c + z & _WORD_MASK
    for bits in (14, 11, 25, 16, 4, 14, 24):
        c = ((c ^ b) - _rotate_left(b, bits)) & _WORD_MASK
        a, b, c = b, c, a
    return b


def _rotate_left(word: int, bits: int) -> int:
    """Return a word of 32 bits, rotated to the left."""
    return (word << bits | word >> (32 - bits)) & _WORD_MASK


def _check_structure(file: memoryview, address: int, size: int) -> None:
    """Compare the checksum of the ``size`` bytes at ``address``, which is stored behind them.

    Raises:
        ChecksumError: it differs, or the bytes are not inside the file.
    """
    end = address + size
    if not (0 <= size <= _MAX_STRUCTURE and end + _CHECKSUM <= len(file)):
        raise ChecksumError(f"its metadata at {address} lead out of the file")
    stored_checksum = int.from_bytes(file[end : end + _CHECKSUM], "little")
    if metadata_checksum(file[address:end]) != stored_checksum:
        raise ChecksumError(f"its metadata at {address} are damaged: {_DOES_NOT_FIT}")


def _check_superblock(file: memoryview) -> None:
    """Check the superblock of a file of any program (II.A).

    Raises:
        ChecksumError: it is damaged, or the file does not have the length that it states.
        ValueError: it is sound, but not of version 3 at the start of the file.
    """
    signature = b"\x89HDF\r\n\x1a\n"
    if bytes(file[:8]) != signature:
        # The superblock may follow a block of user data of 512, 1024, 2048 ... bytes.
        for k in range(9, len(file).bit_length()):
            if bytes(file[2**k : 2**k + 8]) == signature:
                raise ValueError("it begins with a user block")
        raise ChecksumError("it does not begin as an HDF5 file does")
    version = file[8] if len(file) > 8 else 0
    if version > 1:  # Versions 0 and 1 have no checksum.
        _check_structure(file, 0, 44)
    # Base address, another address and end of the file, relative to the base address.
    addresses_offset = {0: 24, 1: 28}.get(version, 12)
    stated_length = 0
    if len(file) >= addresses_offset + 24:
        base, _, end = struct.unpack_from("<3Q", file, addresses_offset)
        stated_length = base + end
    if stated_length != len(file):
        raise ChecksumError(f"it has {len(file)} bytes, its superblock says {stated_length}")
    if version != 3:
        raise ValueError(f"its superblock has version {version}")


def _check_object_header(file: memoryview, address: int) -> None:
    """Check all chunks of an object header of version 2 (IV.A.1.b), of any program.

    Raises:
        ChecksumError: a chunk is damaged, or no object header is there.
        ValueError: the header has version 1.
    """
    prefix = bytes(file[address : address + 6])
    if prefix[:2] == b"\x01\x00":
        raise ValueError("an object header of version 1 has no checksum")
    if prefix[:5] != b"OHDR\x02":
        raise ChecksumError(f"its metadata at {address} are damaged: no object header is there")
    flags = prefix[5]
    times_size = 16 if flags & 0x20 else 0
    limits_size = 4 if flags & 0x10 else 0
    size_width = 1 << (flags & 3)  # bytes of the field that states the size of the messages
    size_offset = len(prefix) + times_size + limits_size
    messages_offset = size_offset + size_width
    size_field = file[address + size_offset : address + messages_offset]
    messages_size = int.from_bytes(size_field, "little")
    # Type, size and flags of a message, and its creation order if the header has that.
    message_header_size = 6 if flags & 0x04 else 4

    pending = [_Chunk(address, messages_offset, messages_offset + messages_size)]
    checked_bytes = 0
    while pending:
        chunk = pending.pop(0)
        checked_bytes += chunk.size
        if checked_bytes > _MAX_STRUCTURE:  # for example because a chunk leads back to itself
            raise ChecksumError(f"its metadata at {address} are damaged: they have no end")
        _check_structure(file, chunk.address, chunk.size)
        pending += _continuations(file, chunk, message_header_size)


class _Chunk(NamedTuple):
    """A contiguous part of an object header.

    Attributes:
        address: of its first byte.
        messages_offset: bytes before its first message.
        size: bytes that its checksum covers, from the first byte to the end of the messages.
    """

    address: int
    messages_offset: int
    size: int


def _continuations(file: memoryview, chunk: _Chunk, message_header_size: int) -> list[_Chunk]:
    """Return the chunks that the messages of a chunk point to."""
    chunks = []
    end = chunk.address + chunk.size
    message = chunk.address + chunk.messages_offset
    while message + message_header_size <= end:
        size = int.from_bytes(file[message + 1 : message + 3], "little")
        body = message + message_header_size
        if file[message] == _CONTINUATION and size == 16 and body + size <= end:
            address, length = struct.unpack_from("<2Q", file, body)
            chunks.append(_Chunk(address, len(_CHUNK_SIGNATURE), length - _CHECKSUM))
        message = body + size
    return chunks


def _check_heap(file: memoryview, heap: int) -> None:
    """Check the header and the blocks of the fractal heap (III.G) at address ``heap``."""
    _check_structure(file, heap, 142)
    _, offset_bits, root, rows = _fields(_HEAP, file, heap)
    # Signature, version, address of the heap, and offset in the heap.
    block_header_size = 13 + offset_bits // 8
    if rows:
        _check_structure(file, root, block_header_size + 8 * _BLOCKS_PER_ROW * rows)
    for address, size in _block_extents(file, heap):
        # The checksum of a block is inside the block, and counts as zeros.
        block = bytearray(file[address : address + min(size, _MAX_STRUCTURE)])
        checksum_bytes = slice(block_header_size, block_header_size + _CHECKSUM)
        stored_checksum = int.from_bytes(block[checksum_bytes], "little")
        block[checksum_bytes] = bytes(_CHECKSUM)
        if metadata_checksum(bytes(block)) != stored_checksum:
            raise ChecksumError(f"its metadata at {address} are damaged: {_DOES_NOT_FIT}")


def _check_tree(file: memoryview, tree: int, record_size: int) -> None:
    """Check the header and the leaf of the B-tree (III.A.2) at address ``tree``.

    ``record_size`` is the number of bytes of its records.
    """
    _check_structure(file, tree, 34)
    leaf, count = _fields(_TREE, file, tree)
    _check_structure(file, leaf, 6 + count * record_size)
