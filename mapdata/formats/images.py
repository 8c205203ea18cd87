"""Pictures and stacks of arrays as maps, and the safe decoding of pictures.

The number of pixels is checked before a picture is decoded, so that a small file cannot fill the
memory.
"""

from __future__ import annotations

import warnings
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
    files_with_endings,
    read_bytes,
    read_grids,
    split_from_folders,
)
from mapdata.formats.registry import Format
from mapdata.limits import Size
from mapdata.npy import FormatError, Npz, StoredArray, open_npy, refusing

PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".webp", ".tif", ".tiff", ".gif")
ARRAYS = (".npy", ".npz")

_UNKNOWN = 205
"""The grey that map_saver of ROS writes for unknown cells."""

_FREE = 254
"""The grey that map_saver of ROS writes for free cells."""

_PHOTOMETRIC = 262
"""The TIFF tag of the meaning of pixel values. If it is 0, a pixel of 0 is white."""


class Pixels(NamedTuple):
    """A decoded picture.

    Attributes:
        values: (H, W, C) uint8 or uint16; C is 1 grey, 3 RGB, 4 RGB and alpha.
        maximum: the value of white.
    """

    values: Array
    maximum: int


def read_pixels(path: Path, limits: Limits = LIMITS) -> Pixels:
    """Return the pixels of the first picture in a PNG, JPEG, BMP, PGM, WebP, TIFF or GIF file.

    Pillow scales a PGM whose maximum is neither 255 nor 65535 to one of these, and takes values
    above the maximum for white.

    Raises:
        FormatError: missing, no such picture, damaged, or more than ``limits.pixels`` pixels.
    """
    content = read_bytes(path, limits)
    with refusing(f"{path}: damaged picture"):
        with warnings.catch_warnings():
            # Pillow warns of many pixels; our own limit is checked below, before decoding.
            warnings.simplefilter("ignore")
            try:
                # Pillow gets the bytes and not the path, with which it would map the file into
                # memory and orient some TIFF files wrongly.
                image = Image.open(
                    BytesIO(content), formats=("PNG", "JPEG", "BMP", "PPM", "WEBP", "TIFF", "GIF")
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
    """Return the pixels of an image of Pillow, of any mode, as grey, RGB or RGBA.

    Raises:
        FormatError: pixels of 32 bits.
    """
    if image.mode == "F" or (image.mode == "I" and image.format == "TIFF"):
        raise FormatError("pixels of 32 bits, expected 8 or 16: save them as an .npy array")
    if image.mode.startswith("I"):  # 16 bits, in any byte order
        values = np.asarray(image).astype(np.uint16)
        zero_is_white = getattr(image, "tag_v2", {}).get(_PHOTOMETRIC) == 0
        if zero_is_white:  # Pillow inverts only TIFF files of 8 bits
            values = 65535 - values
        return Pixels(values[:, :, None], 65535)
    has_alpha = image.mode[-1] in "Aa" or "transparency" in image.info
    if has_alpha:
        image = image.convert("RGBA")
    elif image.mode not in ("L", "RGB"):
        image = image.convert("RGB")
    values = np.asarray(image)
    rows, columns = values.shape[:2]
    return Pixels(values.reshape(rows, columns, -1), 255)


def brightness(pixels: Pixels) -> Bytes:
    """Return the mean of the colours, (H, W) uint8, 255 white; transparent pixels are white."""
    values, maximum = pixels
    # In strips of rows, since the whole picture at once would take several times its memory.
    strips = [
        _strip_brightness(values[first : first + 256], maximum)
        for first in range(0, len(values), 256)
    ]
    return np.concatenate(strips)


def _strip_brightness(values: Array, maximum: int) -> Bytes:
    """Return the `brightness` of some rows of a picture.

    Args:
        values: (H, W, C), as in `Pixels`.
        maximum: the value of white.
    """
    if values.shape[2] == 4:
        colour, alpha = np.split(values.astype(np.uint16), [3], axis=2)
        # Transparent pixels show a white background. Pictures with alpha have 8 bits a channel.
        values = 255 - (255 - colour) * alpha // 255
    channels = values.shape[2]
    total = values.sum(axis=2, dtype=np.uint32)
    mean = total * 255 // (channels * maximum)
    # A pixel that is not quite black gets at least 1. Otherwise masks of 0 and 1 in 16 bits would
    # be black everywhere.
    mean[(mean == 0) & (total > 0)] = 1
    return np.asarray(mean, np.uint8)


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
        threshold: number in [0, 1]: in pictures, cells of a higher brightness are free; in arrays,
            cells of a higher probability are occupied.
        invert: exchange free and occupied cells.
        unknown: state of unknown cells (grey 205) in a robot's map without its .yaml file; without
            this option, such pictures are left out.
        size: (rows, columns) of the maps; pictures of other sizes are resized or cropped.
        fit: how maps get this size: resize scales them (a cell gets the mean brightness of its
            pixels), crop takes their middle (default: resize).

    Raises:
        FormatError: nothing there. A bad file among others is left out, with the reason.
        ValueError: arguments.
    """
    check_probability("threshold", threshold)
    if size is not None:
        check_sides("size", size)
    elif fit is not None:
        raise ValueError("fit: does nothing without size")
    collection = Collection()
    unknown_shares = []
    for path in files_with_endings(source, (*PICTURES, *ARRAYS), limits, collection):
        with collection.leaving_out(path):
            split = split_from_folders(path, source)
            if path.suffix.lower() in ARRAYS:
                array = _open_stack(path, limits)
                check_grids(array, limits, threshold)
                is_stack = len(array.shape) > 2 and len(array) > 1
                for number, grid in enumerate(read_grids(array, threshold)):
                    name = f"{path}[{number}]" if is_stack else str(path)
                    sized = _sized_grid(grid, invert, size, fit)
                    collection.maps.append(ForeignMap(name, sized, split))
            else:
                grey = brightness(read_pixels(path, limits))
                is_unknown = _unknown_pixels(grey)
                _check_picture(path, grey, is_unknown, threshold, unknown)
                if unknown is not None:
                    # Unknown pixels are replaced before the picture is scaled, so that a cell that
                    # they cover by half counts as half unknown.
                    is_white = (unknown == "free") != invert
                    grey[is_unknown] = 255 if is_white else 0
                grid = _grid_of_picture(grey, threshold, invert, size, fit)
                unknown_shares.append(is_unknown.mean())
                collection.maps.append(ForeignMap(str(path), grid, split))
    free_cells = "dark pixels (1 in arrays)" if invert else "bright pixels (0 in arrays)"
    note_free_cells(collection, free_cells, "--images.invert")
    if unknown is not None and any(unknown_shares):
        collection.notes.append(
            f"{np.mean(unknown_shares):.1%} of the cells were unknown and are now {unknown}"
        )
    return collection


def _check_picture(
    path: Path, grey: Bytes, is_unknown: Flags, threshold: float, unknown: str | None
) -> None:
    """Check that a picture shows free cells, and that its unknown cells may be used.

    Args:
        path: named in errors.
        grey: (H, W) brightness, 255 white.
        is_unknown: (H, W) where cells are unknown.
        threshold: brightness in [0, 1] above which a cell is free.
        unknown: what unknown cells become; None if the user has not decided.

    Raises:
        FormatError: all cells would be occupied, or unknown ones would be free.
    """
    brightest = grey.max()
    if 0 < brightest <= threshold * 255:
        # A mask of 0 and 1 looks black, and all of it would be occupied.
        raise FormatError(
            f"{path}: its brightest pixel is {brightest} of 255, nothing is above "
            f"--images.threshold {threshold}"
        )
    if unknown is None and is_unknown.any() and threshold * 255 < _UNKNOWN:
        raise FormatError(f"{path}: {_unknown_advice(path, is_unknown)}")


def _grid_of_picture(
    grey: Bytes, threshold: float, invert: bool, size: Size | None, fit: str | None
) -> Bytes:
    """Return a picture, (H, W) brightness, as a grid of ``size``, 0 free and 1 occupied."""
    # A cell that is half occupied must become occupied, and scaling rounds its mean of 127.5 up.
    # So the picture is scaled with bright occupied cells: inverted if dark pixels are occupied.
    scaled = _fit(grey, size, fit) if invert else 255 - _fit(255 - grey, size, fit)
    is_dark = scaled <= threshold * 255
    return np.asarray(is_dark != invert, np.uint8)


def _unknown_pixels(grey: Bytes) -> Flags:
    """Return which pixels, (H, W), are unknown cells of a robot's map.

    ROS's map_saver writes 0 for occupied, 205 for unknown and 254 for free cells. In a floor plan,
    205 is one of many greys at the edges of lines. So pixels of 205 count as unknown only if they
    are more than half of all pixels between black and the grey of free cells.
    """
    is_unknown: Flags = grey == _UNKNOWN
    between = np.count_nonzero((grey > 0) & (grey < _FREE))
    if 2 * np.count_nonzero(is_unknown) <= between:
        is_unknown[:] = False
    return is_unknown


def _unknown_advice(path: Path, is_unknown: Flags) -> str:
    """Return a message that says how much of a picture is unknown, and what to do about it."""
    candidates = [path.with_suffix(".yaml"), path.with_suffix(".yml")]
    existing = [str(candidate) for candidate in candidates if candidate.is_file()]
    yaml_name = existing[0] if existing else "its .yaml"
    return (
        f"{is_unknown.mean():.1%} of its pixels are of grey {_UNKNOWN}, which robots' maps have "
        f"where nothing is known: import {yaml_name}, or say "
        "--images.unknown occupied or --images.unknown free"
    )


def note_free_cells(collection: Collection, free_cells: str, option: str) -> None:
    """Add notes on which cells were taken for free, how many, and whether that seems wrong.

    The border of most maps is mostly occupied. If the border of most maps here is free, free and
    occupied are probably mixed up. Of the paper's own maps, whose rooms reach the border, a fifth
    has a free border.

    Args:
        collection: the maps that were read; its notes are extended.
        free_cells: how the source shows free cells, for the notes.
        option: the option that swaps free and occupied, for the notes.
    """
    free_shares = []
    inverted = []
    for foreign_map in collection.maps:
        grid = foreign_map.grid
        free_shares.append(1 - grid.mean())
        first_and_last_row = grid[[0, -1]]
        first_and_last_column = grid[:, [0, -1]]
        if (first_and_last_row.mean() + first_and_last_column.mean()) / 2 < 0.5:
            inverted.append(foreign_map.name)
    if free_shares:
        collection.notes.append(
            f"{free_cells} were taken for free: {np.mean(free_shares):.1%} of a map"
        )
    if 2 * len(inverted) > len(free_shares):
        collection.notes.append(
            f"the border of {len(inverted)} of {len(free_shares)} maps is mostly free "
            f"({inverted[0]}), as if free and occupied were mixed up: {option} reads them otherwise"
        )


def _open_stack(path: Path, limits: Limits) -> StoredArray:
    """Return the array of an .npy, or the only array of an .npz that can hold maps, unread.

    Raises:
        FormatError: several arrays can hold maps, or none.
    """
    if path.suffix.lower() == ".npy":
        return open_npy(path)
    archive = Npz(path, limits.unpacked)
    names = [name for name, shape in archive.shapes.items() if len(shape) in (2, 3, 4)]
    if len(names) != 1:
        raise FormatError(
            f"{path}: holds arrays {', '.join(archive.shapes)}, expected one of (N, H, W)"
        )
    return archive.arrays(names[0])[0]


def _sized_grid(grid: Bytes, invert: bool, size: Size | None, fit: str | None) -> Bytes:
    """Return a grid of an array in the given ``size``, with free and occupied swapped if asked."""
    if invert:
        grid = 1 - grid
    if size in (None, grid.shape):
        return grid
    # A new cell is occupied if at least half of the area that it covers is.
    return _fit(255 * grid, size, fit) // 128


def _fit(grey: Bytes, size: Size | None, fit: str | None) -> Bytes:
    """Return ``grey``, (H, W), in the given ``size``: its middle if ``fit`` is "crop", else scaled.

    Raises:
        FormatError: the picture is too small to be cropped.
    """
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
