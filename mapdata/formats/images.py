"""Pictures read without trust, and a folder of them (or a stack of arrays) as maps.

Pixels are counted before anything is decoded.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from PIL import Image, UnidentifiedImageError

from mapdata.arrays import Array, Bytes, Flags
from mapdata.checks import check_probability, check_sides
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import (
    LIMITS,
    Limits,
    check_grids,
    files_of,
    grids_of,
    read_bytes,
    split_of,
)
from mapdata.formats.registry import Format
from mapdata.limits import Size
from mapdata.npy import FormatError, Npz, StoredArray, open_npy, refusing

PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".webp", ".tif", ".tiff", ".gif")
ARRAYS = (".npy", ".npz")

_UNKNOWN = 205
"""The grey that map_saver of ROS writes for unknown cells."""

_FREE = 254
"""The grey that it writes for free cells."""

_PHOTOMETRIC = 262
"""The tag of a TIFF that says what its numbers mean: 0 is white where it is 0."""


class Pixels(NamedTuple):
    """A decoded picture.

    Attributes:
        values: (H, W, C) uint8 or uint16; C is 1 grey, 3 RGB, 4 RGB and alpha.
        maximum: the value of white.
    """

    values: Array
    maximum: int


def read_pixels(path: Path, limits: Limits = LIMITS) -> Pixels:
    """Return the pixels of a PNG, JPEG, BMP, PGM, WebP, TIFF or GIF file: of its first picture.

    Pillow scales a PGM whose white is neither 255 nor 65535 to one of them, and takes what is above
    its white for white.

    Raises:
        FormatError: missing, no such picture, damaged, or more than ``limits.pixels`` pixels.
    """
    data = read_bytes(path, limits)
    with refusing(f"{path}: damaged picture"):
        with warnings.catch_warnings():
            # of decompression bombs: our own limit follows, before anything is decoded
            warnings.simplefilter("ignore")
            try:
                # by a path Pillow would map the file, and turn some TIFF files wrongly
                image = Image.open(
                    BytesIO(data), formats=("PNG", "JPEG", "BMP", "PPM", "WEBP", "TIFF", "GIF")
                )
            except UnidentifiedImageError:
                raise FormatError(
                    f"{path}: not a PNG, JPEG, BMP, PGM, WebP, TIFF or GIF picture"
                ) from None
        with image:
            columns, rows = image.size
            if not 1 <= rows * columns <= limits.pixels:
                raise FormatError(
                    f"{path}: has {rows} x {columns} pixels, "
                    f"expected at most {limits.pixels} in all"
                )
            image.load()
            return _decoded(image)


def _decoded(image: Image.Image) -> Pixels:
    """Return the pixels of an image of Pillow as grey, RGB or RGBA, whatever its mode."""
    if image.mode == "F" or (image.mode == "I" and image.format == "TIFF"):
        raise FormatError("pixels of 32 bits, expected 8 or 16: save them as an .npy array")
    if image.mode.startswith("I"):  # integers of 16 bits, in any order of their bytes
        values = np.asarray(image).astype(np.uint16)
        # of a TIFF whose 0 is white; Pillow turns those of 8 bits itself
        if getattr(image, "tag_v2", {}).get(_PHOTOMETRIC) == 0:
            values = 65535 - values
        return Pixels(values[:, :, None], 65535)
    clear = image.mode[-1] in "Aa" or "transparency" in image.info
    if clear or image.mode not in ("L", "RGB", "RGBA"):
        image = image.convert("RGBA" if clear else "RGB")
    values = np.asarray(image)
    return Pixels(values.reshape(*values.shape[:2], -1), 255)


def brightness(pixels: Pixels) -> Bytes:
    """Return the mean of the colours, (H, W) uint8, 255 white; transparent pixels are white."""
    values, maximum = pixels
    # a strip at a time: all at once would take several times the memory of the picture
    strips = [_mean(values[k : k + 256], maximum) for k in range(0, len(values), 256)]
    return np.concatenate(strips)


def _mean(values: Array, maximum: int) -> Bytes:
    """Return `brightness` of some rows of a picture, (H, W, C) with white at ``maximum``."""
    if values.shape[2] == 4:
        colour, alpha = np.split(values.astype(np.uint16), [3], axis=2)
        # before a white background; pictures with alpha have 8 bits a channel
        values = 255 - (255 - colour) * alpha // 255
    channels = values.shape[2]
    total = values.sum(axis=2, dtype=np.uint32)
    # not black if any colour is there, as in masks of 0 and 1 in 16 bits
    return np.asarray(np.maximum(total * 255 // (channels * maximum), total > 0), np.uint8)


def read(
    source: Path,
    limits: Limits = LIMITS,
    *,
    threshold: float = 0.5,
    invert: bool = False,
    unknown: Literal["occupied", "free"] | None = None,
    size: Size | None = None,
    fit: Literal["resize", "crop"] | None = None,
) -> Collection:
    """Read a folder of pictures, one picture, or a stack of grids in an .npy or .npz file.

    Pictures: dark is occupied, as in ROS and most sets of floor plans; a pixel is occupied when its
    brightness is not above ``threshold``. Arrays: (H, W), (N, H, W) or (N, 1, H, W); 1 is occupied,
    probabilities are occupied above ``threshold``.

    Args:
        source: folder or file.
        limits: of what is read.
        threshold: in [0, 1]: brightness above which a cell is free, probability above which it is
            occupied.
        invert: the other way round.
        unknown: what the unknown cells of a robot's map without its .yaml become, those of grey
            205; without it, such pictures are left out.
        size: (rows, columns) that every map is brought to.
        fit: how: resize scales (the mean brightness of the pixels in a cell decides), crop takes
            the middle; default resize.

    Raises:
        FormatError: nothing there. A bad file among others is left out, with the reason.
        ValueError: arguments.
    """
    check_probability("threshold", threshold)
    if size is not None:
        check_sides("size", size)
    elif fit is not None:
        raise ValueError("fit: does nothing without size")
    found = Collection()
    grids: Iterator[Bytes]
    unknown_shares = []
    for path in files_of(source, (*PICTURES, *ARRAYS), limits, found):
        with found.leaving_out(path):
            if path.suffix.lower() in ARRAYS:
                array = _stack(path, limits)
                check_grids(array, limits, threshold)
                count = 1 if len(array.shape) == 2 else len(array)
                grids = (_sized(grid, invert, size, fit) for grid in grids_of(array, threshold))
            else:
                grey = brightness(read_pixels(path, limits))
                if 0 < grey.max() <= threshold * 255:
                    # a mask of 0 and 1, which looks black and would be occupied everywhere
                    what = f"its brightest pixel is {grey.max()} of 255"
                    raise FormatError(
                        f"{path}: {what}, nothing is above --images.threshold {threshold}"
                    )
                is_unknown = _unknown_pixels(grey)
                if unknown is not None:
                    # before cells are scaled, so that half a cell of it counts as half
                    grey[is_unknown] = 255 if (unknown == "free") != invert else 0
                elif is_unknown.any() and threshold * 255 < _UNKNOWN:
                    raise FormatError(f"{path}: {_what_is_unknown(path, is_unknown)}")
                unknown_shares.append(is_unknown.mean())
                # means are rounded up to what is occupied, so that half a cell of it is enough
                light = _fit(grey, size, fit) if invert else 255 - _fit(255 - grey, size, fit)
                is_dark = light <= threshold * 255
                count = 1
                grids = iter([np.asarray(is_dark != invert, np.uint8)])
            split = split_of(path, source)
            for k, grid in enumerate(grids):
                name = f"{path}[{k}]" if count > 1 else str(path)
                found.maps.append(ForeignMap(name, grid, split))
    what = "dark pixels (1 in arrays)" if invert else "bright pixels (0 in arrays)"
    tell_free(found, what, "--images.invert")
    if unknown is not None and any(unknown_shares):
        found.notes.append(
            f"{np.mean(unknown_shares):.1%} of the cells were unknown and are now {unknown}"
        )
    return found


def _unknown_pixels(grey: Bytes) -> Flags:
    """Return which pixels, (H, W), are unknown cells of a robot's map.

    ROS's map_saver writes 0 for occupied, 205 for unknown and 254 for free cells. In a floor plan,
    205 is one of many greys at the edges of lines; so it only counts where pixels of this grey are
    more than those of all other greys between black and white.
    """
    is_unknown: Flags = grey == _UNKNOWN
    greys = np.count_nonzero((grey > 0) & (grey < _FREE))
    if 2 * np.count_nonzero(is_unknown) <= greys:
        is_unknown[:] = False
    return is_unknown


def _what_is_unknown(path: Path, is_unknown: Flags) -> str:
    """Return how much of a picture is unknown, and what to do about it."""
    yamls = [beside for end in (".yaml", ".yml") if (beside := path.with_suffix(end)).is_file()]
    return (
        f"{is_unknown.mean():.1%} of its pixels are of grey {_UNKNOWN}, which robots' maps have "
        f"where nothing is known: import {yamls[0] if yamls else 'its .yaml'}, or say "
        "--images.unknown occupied or --images.unknown free"
    )


def tell_free(found: Collection, what: str, otherwise: str) -> None:
    """Note what was taken for free, how much it is, and maps whose border is mostly free.

    A map's border is mostly occupied: where that of most maps is free, free and occupied are mixed
    up. Of the paper's own maps, whose rooms reach the border, a fifth has a free one.

    Args:
        found: the maps that were read.
        what: what their source shows free cells as.
        otherwise: the option that reads them the other way round.
    """
    shares = []
    inverted = []
    for one in found.maps:
        grid = one.grid
        shares.append(1 - grid.mean())
        # the first and last row, the first and last column
        if grid[[0, -1]].mean() + grid[:, [0, -1]].mean() < 1:
            inverted.append(one.name)
    if shares:
        found.notes.append(f"{what} were taken for free: {np.mean(shares):.1%} of a map")
    if 2 * len(inverted) > len(shares):
        found.notes.append(
            f"the border of {len(inverted)} of {len(shares)} maps is mostly free ({inverted[0]}), "
            f"as if free and occupied were mixed up: {otherwise} reads them otherwise"
        )


def _stack(path: Path, limits: Limits) -> StoredArray:
    """Return the array of an .npy file, or the only one of an .npz that can hold maps, unread."""
    if path.suffix.lower() == ".npy":
        return open_npy(path)
    archive = Npz(path, limits.unpacked)
    names = [name for name, shape in archive.shapes.items() if len(shape) in (2, 3, 4)]
    if len(names) != 1:
        raise FormatError(
            f"{path}: holds arrays {', '.join(archive.shapes)}, expected one of (N, H, W)"
        )
    return archive.arrays(names[0])[0]


def _sized(grid: Bytes, invert: bool, size: Size | None, fit: str | None) -> Bytes:
    """Return a grid of an array after ``invert``, brought to ``size`` as pictures are."""
    if invert:
        grid = 1 - grid
    if size in (None, grid.shape):
        return grid
    # a cell is occupied where half of what it covers is
    return _fit(255 * grid, size, fit) // 128


def _fit(grey: Bytes, size: Size | None, fit: str | None) -> Bytes:
    """Return ``grey``, (H, W), brought to ``size``: its middle under "crop", else scaled."""
    if size is None:
        return grey
    rows, columns = size
    if fit != "crop":
        return np.asarray(Image.fromarray(grey).resize((columns, rows), Image.Resampling.BOX))
    height, width = grey.shape
    if height < rows or width < columns:
        raise FormatError(f"has {height} x {width} cells, too small to crop {rows} x {columns}")
    top = (height - rows) // 2
    left = (width - columns) // 2
    return grey[top : top + rows, left : left + columns]


FORMAT = Format("images", (*PICTURES, *ARRAYS), read)
