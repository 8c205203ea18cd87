"""A strict reader of the part of HDF5 that shards use; whatever else a file holds is refused.

libhdf5 trusts what it reads: one wrong byte can crash it or make it hang. A shard needs little of
the format: superblock version 3, object headers of version 2, hard links, contiguous datasets of
integers, attributes of numbers or text of fixed length. The names in the root stand in its header
or, where they are many, in a fractal heap with a B-tree of one leaf.

Every read is checked to lie inside the file, and every loop has a bound. The checksums of the
metadata are not compared, since the hash in the manifest covers each byte of the file.

Source: HDF5 File Format Specification 3.0,
https://support.hdfgroup.org/documentation/hdf5/latest/_f_m_t3.html; sections are named below.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

_UNDEFINED = 2**64 - 1
"""The address of what is not there."""

_LARGEST_CHUNK = 2**16
_MOST_CHUNKS = 8
_MOST_RECORDS = 64
_MOST_DIMENSIONS = 3

_DATASPACE, _LINK_INFO, _DATATYPE, _LINK, _EXTERNAL, _LAYOUT = 1, 2, 3, 6, 7, 8
_FILTERS, _ATTRIBUTE, _CONTINUATION, _ATTRIBUTE_INFO = 11, 12, 16, 21
"""Types of header messages (section IV.A.2)."""


class Dataset(NamedTuple):
    """Where a dataset lies.

    Attributes:
        dtype: its type as numpy writes it; None if it is neither integer, float nor text.
        shape: its extent.
        offset: its first byte in the file, None if it has no values.
        size: number of bytes.
    """

    dtype: str | None
    shape: tuple[int, ...]
    offset: int | None
    size: int


class Root(NamedTuple):
    """What stands in the root of a file.

    Attributes:
        attributes: the message of each attribute, for `read_attribute`.
        links: the address of each object, for `read_dataset`; None for a link to somewhere else.
    """

    attributes: dict[str, memoryview]
    links: dict[str, int | None]


class _Cursor:
    """A place in a piece of bytes that moves on as it reads, and never leaves them."""

    def __init__(self, data: memoryview, at: int = 0) -> None:
        self.data = data
        self.at = at

    def take(self, size: int) -> memoryview:
        """Return the next ``size`` bytes."""
        found = self.data[self.at : self.at + size]
        if size < 0 or len(found) < size:  # a slice ends where its bytes end
            raise ValueError(f"{size} bytes from {self.at} on reach outside")
        self.at += size
        return found

    def integer(self, size: int) -> int:
        """Return the next ``size`` bytes as an unsigned integer, little-endian."""
        number = self.data[self.at : self.at + size]
        if len(number) < size:
            raise ValueError(f"{size} bytes from {self.at} on reach outside")
        self.at += size
        return int.from_bytes(number, "little")

    def expect(self, signature: bytes) -> None:
        """Refuse bytes other than ``signature``."""
        if self.take(len(signature)) != signature:
            raise ValueError(f"no {signature!r} at {self.at - len(signature)}")

    def left(self) -> int:
        """Return the number of bytes that are left."""
        return len(self.data) - self.at


def read_root(file: memoryview) -> Root:
    """Return the attributes and links of the root group.

    Raises:
        ValueError: the file is not HDF5, or not of the kind that shards are.
    """
    superblock = _Cursor(file)  # section II.A
    superblock.expect(b"\x89HDF\r\n\x1a\n")
    superblock.expect(b"\x03\x08\x08")  # version; sizes of offsets and of lengths
    superblock.take(1)  # flags of who has it open
    base = superblock.integer(8)
    superblock.take(8)  # address of an extension
    end = superblock.integer(8)
    if base != 0 or end != len(file):
        raise ValueError(f"the superblock says {end} bytes from {base} on, there are {len(file)}")
    attributes: dict[str, memoryview] = {}
    links: dict[str, int | None] = {}
    for kind, message in _messages(file, superblock.integer(8)):
        if kind == _ATTRIBUTE:
            _add_attribute(attributes, message)
        elif kind == _LINK:
            _add_link(links, message)
        elif kind == _ATTRIBUTE_INFO:
            for item in _heap_objects(file, message, index_size=2, record_type=8):
                _add_attribute(attributes, item)
        elif kind == _LINK_INFO:
            for item in _heap_objects(file, message, index_size=8, record_type=5):
                _add_link(links, item)
    return Root(attributes, links)


def read_attribute(message: memoryview) -> npt.NDArray[np.generic]:
    """Return the value of an attribute; text is of numpy's type ``S``.

    Raises:
        ValueError: it is neither numbers nor text of fixed length.
    """
    _, datatype, dataspace, value = _attribute_parts(message)
    shape = _shape(dataspace)
    dtype = _dtype(datatype)
    if dtype is None:
        raise ValueError("neither numbers nor text of fixed length")
    size = math.prod(shape) * np.dtype(dtype).itemsize
    return np.frombuffer(value.take(size), dtype).reshape(shape)


def read_dataset(file: memoryview, address: int) -> Dataset:
    """Return where a dataset lies.

    Raises:
        ValueError: it is no dataset, or not plain contiguous numbers in this file.
    """
    messages = dict(_messages(file, address))
    if not {_DATASPACE, _DATATYPE, _LAYOUT} <= messages.keys():
        raise ValueError("is not a dataset")
    layout = _Cursor(messages[_LAYOUT])  # section IV.A.2.i
    version = layout.integer(1)
    contiguous = version in (3, 4) and layout.integer(1) == 1
    if not contiguous or _FILTERS in messages or _EXTERNAL in messages:
        raise ValueError("is not plain contiguous data in this file")
    offset = layout.integer(8)
    size = layout.integer(8)
    shape = _shape(messages[_DATASPACE])
    dtype = _dtype(messages[_DATATYPE])
    return Dataset(dtype, shape, None if offset == _UNDEFINED else offset, size)


def _messages(file: memoryview, address: int) -> Iterator[tuple[int, memoryview]]:
    """Yield type and data of the messages of an object header (section IV.A.1.b)."""
    header = _Cursor(file, address)
    header.expect(b"OHDR\x02")
    flags = header.integer(1)
    if flags & 0x20:
        header.take(16)  # times
    if flags & 0x10:
        header.take(4)  # from how many attributes on they stand in a heap
    chunks = [header.take(_limited(header.integer(1 << (flags & 3))))]
    # A chunk may say where the next one is: a file may not make us follow them for ever.
    for _ in range(_MOST_CHUNKS):
        if not chunks:
            return
        chunk = _Cursor(chunks.pop())
        head = 6 if flags & 4 else 4  # with or without the order in which messages were made
        while chunk.left() >= head:
            kind = chunk.integer(1)
            size = chunk.integer(2)
            shared = chunk.integer(1) & 2
            chunk.take(head - 4)
            message = chunk.take(size)
            if shared:
                raise ValueError("a message lies in another header")
            if kind == _CONTINUATION:
                place = _Cursor(message)
                more = _Cursor(file, place.integer(8))
                length = _limited(place.integer(8))
                more.expect(b"OCHK")
                chunks.append(more.take(length - 8))  # less the signature and a checksum
            else:
                yield kind, message
    if chunks:
        raise ValueError(f"an object header has over {_MOST_CHUNKS} chunks")


def _limited(size: int) -> int:
    if size > _LARGEST_CHUNK:
        raise ValueError(f"a chunk of {size} bytes")
    return size


def _heap_objects(
    file: memoryview, message: memoryview, index_size: int, record_type: int
) -> Iterator[memoryview]:
    """Yield the links or attributes that stand in a fractal heap, by the B-tree of their names.

    Args:
        file: the file.
        message: link info or attribute info (sections IV.A.2.c and v).
        index_size: size of the field for the order in which they were made, if there is one.
        record_type: of the B-tree: 5 for links, 8 for attributes.
    """
    info = _Cursor(message)
    info.take(1)
    if info.integer(1) & 1:
        info.take(index_size)
    heap_address = info.integer(8)
    tree_address = info.integer(8)
    if heap_address == _UNDEFINED:
        return
    blocks, offset_size, length_size = _heap(file, heap_address)
    tree = _Cursor(file, tree_address)  # section III.A.2
    tree.expect(b"BTHD\x00" + bytes([record_type]))
    tree.take(4)  # size of a node
    record_size = tree.integer(2)
    depth = tree.integer(2)
    tree.take(2)  # when nodes are split and merged
    leaf = _Cursor(file, tree.integer(8))
    count = tree.integer(2)
    if depth != 0 or count > _MOST_RECORDS:
        raise ValueError(f"a B-tree of depth {depth} with {count} records in its root")
    leaf.expect(b"BTLF\x00" + bytes([record_type]))
    for _ in range(count):
        record = _Cursor(leaf.take(record_size))
        if record_type == 5:
            record.take(4)  # hash of the name
        if record.integer(1) != 0:  # not in the heap's own blocks
            raise ValueError("an attribute or a link of over 64 KiB")
        offset = record.integer(offset_size)
        length = record.integer(length_size)
        yield _heap_object(blocks, offset, length)


def _heap(file: memoryview, address: int) -> tuple[list[tuple[int, memoryview]], int, int]:
    """Return the blocks of a fractal heap as (offset in the heap, bytes), and how many bytes an
    offset and a length take in it (section III.G).
    """
    header = _Cursor(file, address)
    header.expect(b"FRHP\x00")
    header.take(2)  # length of the numbers of objects
    filters = header.integer(2)
    header.take(1)
    largest_object = header.integer(4)
    header.take(12 * 8)  # counts, and what huge and tiny objects need
    width = header.integer(2)
    block_size = header.integer(8)
    largest_block = header.integer(8)
    bits = header.integer(2)
    header.take(2)
    root = header.integer(8)
    rows = header.integer(2)
    if filters or width != 4 or not 512 <= block_size <= 2**16 or bits > 64 or rows > 8:
        raise ValueError("a fractal heap of another kind")
    offset_size = (bits + 7) // 8
    length_size = (min(largest_block, largest_object).bit_length() + 7) // 8
    if rows == 0:  # the root is the only block
        return [(0, _block(file, root, block_size))], offset_size, length_size
    table = _Cursor(file, root)
    table.expect(b"FHIB")
    table.take(1 + 8 + offset_size)  # version, address of the heap, offset of this block in it
    blocks = []
    offset = 0
    for row in range(rows):
        size = block_size << max(row - 1, 0)  # two rows of the first size, then they double
        for _ in range(width):
            child = table.integer(8)
            if child != _UNDEFINED:
                blocks.append((offset, _block(file, child, size)))
            offset += size
    return blocks, offset_size, length_size


def _block(file: memoryview, address: int, size: int) -> memoryview:
    block = _Cursor(file, address).take(size)
    _Cursor(block).expect(b"FHDB")
    return block


def _heap_object(blocks: list[tuple[int, memoryview]], offset: int, length: int) -> memoryview:
    for first, block in blocks:
        if first <= offset < first + len(block):
            return _Cursor(block, offset - first).take(length)
    raise ValueError("an object outside its heap")


def _add_attribute(attributes: dict[str, memoryview], message: memoryview) -> None:
    name, _, _, _ = _attribute_parts(message)
    if attributes.setdefault(name, message) is not message:
        raise ValueError(f"two attributes {name!r}")


def _attribute_parts(message: memoryview) -> tuple[str, memoryview, memoryview, _Cursor]:
    """Return name, type, dataspace and what follows of an attribute (section IV.A.2.m)."""
    attribute = _Cursor(message)
    attribute.expect(b"\x03\x00")  # version; neither type nor dataspace are shared
    sizes = [attribute.integer(2) for _ in range(3)]
    attribute.take(1)  # ASCII or UTF-8
    name, dtype, dataspace = (attribute.take(size) for size in sizes)
    return bytes(name).rstrip(b"\x00").decode(), dtype, dataspace, attribute


def _add_link(links: dict[str, int | None], message: memoryview) -> None:
    """Add a link (section IV.A.2.g)."""
    link = _Cursor(message)
    link.expect(b"\x01")
    flags = link.integer(1)
    hard = not flags & 8 or link.integer(1) == 0
    if flags & 4:
        link.take(8)  # order in which it was made
    if flags & 16:
        link.take(1)  # ASCII or UTF-8
    name = bytes(link.take(link.integer(1 << (flags & 3)))).decode()
    if name in links:
        raise ValueError(f"two links {name!r}")
    links[name] = link.integer(8) if hard else None


def _shape(message: memoryview) -> tuple[int, ...]:
    """Return the extent that a dataspace says (section IV.A.2.b)."""
    dataspace = _Cursor(message)
    dataspace.expect(b"\x02")
    rank = dataspace.integer(1)
    dataspace.take(2)  # whether it also says how far it may grow; scalar, simple or empty
    if rank > _MOST_DIMENSIONS:
        raise ValueError(f"has {rank} dimensions, expected at most {_MOST_DIMENSIONS}")
    return tuple(dataspace.integer(8) for _ in range(rank))


_DOUBLE = bytes.fromhex("11 203f00 08000000 0000 4000 34 0b 00 34 ff030000")
"""The message of a float: 64 bits, little-endian, exponent and mantissa where IEEE 754 has them."""


def _dtype(message: memoryview) -> str | None:
    """Return a datatype as numpy writes it, None if it is another one (section IV.A.2.d)."""
    if message[: len(_DOUBLE)] == _DOUBLE:
        return "<f8"
    datatype = _Cursor(message)
    kind = datatype.integer(1) & 15
    bits = datatype.integer(3)
    size = datatype.integer(4)
    if kind == 3:
        return f"S{size}"
    if kind != 0 or size not in (1, 2, 4, 8) or bits & ~8:
        return None
    if datatype.integer(2) != 0 or datatype.integer(2) != 8 * size:  # bits that are not used
        return None
    sign = "i" if bits & 8 else "u"
    return f"{sign}1" if size == 1 else f"<{sign}{size}"
