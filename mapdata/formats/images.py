"""Pictures and stacks of arrays as maps, and the safe decoding of pictures.

The number of pixels is checked before a picture is decoded, so that a small file cannot fill the
memory.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from PIL import Image, ImageFilter, UnidentifiedImageError

from mapdata.arrays import Array, Bytes, Flags
from mapdata.checks import check_probability, check_sides
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import (
    LIMITS,
    Limits,
    check_grids,
    check_pixels,
    files_with_endings,
    maps_bar,
    percent,
    read_bytes,
    read_grids,
    split_from_folders,
)
from mapdata.formats.registry import Format
from mapdata.formats.shrinking import FreeSpace, any_occupied, check_free
from mapdata.generators.points import count_components
from mapdata.hints import hint_on_content
from mapdata.limits import Size
from mapdata.npy import FormatError, Npz, StoredArray, open_npy, refusing
from mapdata.search.api import distance_field

PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".webp", ".tif", ".tiff", ".gif")
ARRAYS = (".npy", ".npz")

UNKNOWN = 205
"""The grey that map_saver of ROS writes for unknown cells."""

_FREE = 254
"""The grey that map_saver of ROS writes for free cells."""

_MIN_FREE = 250
"""The darkest grey that counts as that of free cells in a picture of map_saver."""

_MIN_SHARE = 0.01
"""Share of the pixels from which on a grey is one of the main greys of a picture."""

_MIN_INSIDE = 0.2
"""Share of free cells that are left inside of a plan, below which a note doubts the result."""

_WINDOW = 1 / 8
"""Width of the square around a pixel whose mean it is compared with, of the longer side."""

_DARKER = 0.25
"""Share by which a pixel has to be darker than this mean to count as dark."""

_NEAR = 0.1
"""Distance in brightness from the threshold below which noise decides about a pixel."""

_MIN_NEAR = 0.02
"""Share of pixels near the threshold from which on a picture may be a photo."""

_SPECK_CELLS = 4
"""Components of fewer cells are specks."""

_MIN_SPECKS = 20
"""Number of specks from which on a picture may be a photo."""

_PHOTOMETRIC = 262
"""The TIFF tag of the meaning of pixel values. If it is 0, a pixel of 0 is white."""

_ORIENTATION = 274
"""The tag of EXIF that says how a camera was held."""

_TURNS = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}
"""What brings a picture upright, by its orientation of EXIF; 1 is upright."""


class Pixels(NamedTuple):
    """A decoded picture.

    Attributes:
        values: (H, W, C) uint8 or uint16; C is 1 grey, 3 RGB, 4 RGB and alpha.
        maximum: the value of white.
    """

    values: Array
    maximum: int


def read_pixels(path: Path, limits: Limits = LIMITS, *, upright: bool = False) -> Pixels:
    """Return the pixels of the first picture in a PNG, JPEG, BMP, PGM, WebP, TIFF or GIF file.

    Pillow scales a PGM whose maximum is neither 255 nor 65535 to one of these, and takes values
    above the maximum for white.

    Args:
        path: of the file.
        limits: of its bytes and pixels.
        upright: turn a photo as its orientation of EXIF says, as viewers do. The map servers of ROS
            do not.

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
                    f"{hint_on_content(content[:64])}"
                ) from None
        with image:
            columns, rows = image.size
            check_pixels(str(path), rows, columns, limits)
            image.load()
            return _decoded(_upright(image) if upright else image)


def _upright(image: Image.Image) -> Image.Image:
    """Return a loaded picture, turned as its orientation of EXIF says."""
    orientation = None
    with suppress(Exception):  # damaged EXIF, which does not damage the picture
        orientation = image.getexif().get(_ORIENTATION)
    turn = _TURNS.get(orientation) if isinstance(orientation, int) else None
    return image if turn is None else image.transpose(turn)


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
    threshold: float | Literal["local"] = 0.5,
    invert: bool = False,
    unknown: Literal["occupied", "free"] | None = None,
    outside: Literal["occupied", "free"] | None = None,
    size: Size | None = None,
    fit: Literal["resize", "crop"] | None = None,
    resample: Literal["any", "mean"] | None = None,
    array: str | None = None,
) -> Collection:
    """Read a folder of pictures, one picture, or a stack of grids in an .npy or .npz file.

    Pictures: dark is occupied, as in ROS and most sets of floor plans; a pixel is occupied when its
    brightness is not above ``threshold``. Arrays: (H, W), (N, H, W) or (N, 1, H, W); 1 is occupied,
    probabilities are occupied above ``threshold``.

    Args:
        source: folder or file.
        limits: of what is read.
        threshold: number in [0, 1]: in pictures, cells of a higher brightness are free; in arrays,
            cells of a higher probability are occupied; or, for photos with shadows, local: a pixel
            is dark if it is a quarter darker than the mean around it.
        invert: exchange free and occupied cells.
        unknown: state of unknown cells (grey 205) in a robot's map without its .yaml file; without
            this option, such pictures are left out.
        outside: state of the free cells that are connected to the edge of the map, such as the
            paper around a floor plan (default: free, and a note says so if most edges are free).
        size: (rows, columns) of the maps; pictures of other sizes are resized or cropped.
        fit: how maps get this size: resize scales them, crop takes their middle (default: resize).
        resample: rule for a cell of a resized map: it is occupied if any part of its area is
            occupied (any), or by the mean brightness of its pixels, in arrays if half of its area
            is occupied (mean) (default: any).
        array: name of the array in .npz files (default: the only one that can hold maps).

    Raises:
        FormatError: nothing there. A bad file among others is left out, with the reason.
        ValueError: arguments.
    """
    is_local = threshold == "local"
    level = 0.5 if is_local else check_probability("threshold", threshold)
    if size is not None:
        check_sides("size", size)
    elif fit is not None:
        raise ValueError("fit: does nothing without size")
    if resample is not None and (size is None or fit == "crop"):
        raise ValueError("resample: does nothing without size and resizing")
    collection = Collection()
    unknown_shares = []
    inside_shares: dict[str, float] = {}
    photos: dict[str, tuple[float, int]] = {}
    free_space = FreeSpace()
    has_archive = False
    for path in files_with_endings(source, (*PICTURES, *ARRAYS), limits, collection):
        has_archive |= path.suffix.lower() == ".npz"
        with collection.leaving_out(path):
            split = split_from_folders(path, source)
            if path.suffix.lower() in ARRAYS:
                if is_local:
                    raise FormatError(f"{path}: --images.threshold local is for pictures alone")
                stored = _open_stack(path, limits, array)
                check_grids(stored, limits, level)
                count = len(stored) if len(stored.shape) > 2 else 1
                with maps_bar(limits, count) as advance:
                    for number, grid in enumerate(read_grids(stored, level)):
                        name = f"{path}[{number}]" if count > 1 else str(path)
                        cells = 1 - grid if invert else grid
                        if outside == "occupied":
                            is_outside = _outside(cells)
                            inside_shares[name] = 1 - is_outside.sum() / (cells == 0).sum()
                            cells = cells | is_outside
                        mean = partial(_mean_of_cells, cells)
                        sized = _sized(cells, mean, size, fit, resample, free_space)
                        collection.maps.append(ForeignMap(name, sized, split))
                        advance(1)
            else:
                pixels = read_pixels(path, limits, upright=True)
                _check_brightness(path, pixels)
                grey = brightness(pixels)
                is_unknown = _unknown_pixels(grey)
                if is_local:
                    grey = _without_shadows(grey, invert)
                _check_picture(path, grey, is_unknown, level, unknown)
                if unknown is not None:
                    # Unknown pixels are replaced before the picture is scaled, so that a cell that
                    # they cover by half counts as half unknown.
                    is_white = (unknown == "free") != invert
                    grey[is_unknown] = 255 if is_white else 0
                cells = _cells_of_picture(grey, level, invert)
                near, specks = _noise(grey, cells, level)
                if near >= _MIN_NEAR and specks >= _MIN_SPECKS:
                    photos[str(path)] = near, specks
                if outside == "occupied":
                    is_outside = _outside(cells)
                    inside_shares[str(path)] = 1 - is_outside.sum() / (cells == 0).sum()
                    grey[is_outside] = 255 if invert else 0
                    cells = _cells_of_picture(grey, level, invert)
                mean = partial(_mean_of_picture, grey, level, invert)
                sized = _sized(cells, mean, size, fit, resample, free_space)
                unknown_shares.append(is_unknown.mean())
                collection.maps.append(ForeignMap(str(path), sized, split))
    if array is not None and not has_archive:
        raise ValueError("array: does nothing without an .npz file")
    if size is not None:
        collection.notes += free_space.notes(*_size_note(size, fit, resample))
    free_cells = "dark pixels (1 in arrays)" if invert else "bright pixels (0 in arrays)"
    advice = None
    if outside is None:
        advice = (
            "for the paper around a plan say --images.outside occupied, for a map that is open at "
            "its edge --images.outside free; --images.invert exchanges free and occupied"
        )
    note_free_cells(collection, free_cells, advice)
    collection.notes += _notes_on_outside(inside_shares)
    collection.notes += _notes_on_photos(photos)
    if unknown is not None and any(unknown_shares):
        share = percent(float(np.mean(unknown_shares)))
        collection.notes.append(f"{share} of the cells were unknown and are now {unknown}")
    return collection


def _check_brightness(path: Path, pixels: Pixels) -> None:
    """Check that a picture of 16 bits does not hold heights or distances, with white for "no data".

    Raises:
        FormatError: its values but black and white are many different ones, and all nearly black.
    """
    values, white = pixels
    if white != 65535:
        return
    numbers = np.unique(values)
    between = numbers[(numbers > 0) & (numbers < white)]
    if numbers[-1] == white and len(between) >= 16 and between[-1] < white // 16:
        raise FormatError(
            f"{path}: holds {between[0]} to {between[-1]}, and {white} for white: it looks like "
            "heights or distances; save it as an .npy array of 1 where cells are occupied"
        )


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
    if unknown is None and is_unknown.any() and threshold * 255 < UNKNOWN:
        raise FormatError(f"{path}: {_unknown_advice(path, is_unknown)}")


def _without_shadows(grey: Bytes, invert: bool) -> Bytes:
    """Return a picture of 0 and 255, in which each pixel is compared with the mean around it.

    So a shadow or a lamp changes a pixel and what it is compared with alike. The inside of a dark
    area that is wider than the square becomes bright.

    Source: Bradley and Roth, "Adaptive thresholding using the integral image", 2007.

    Args:
        grey: (H, W) brightness, 255 white.
        invert: whether bright pixels are occupied; they have to be brighter than the mean then.
    """
    lines_dark = 255 - grey if invert else grey
    radius = max(1, round(max(grey.shape) * _WINDOW / 2))
    mean = np.asarray(Image.fromarray(lines_dark).filter(ImageFilter.BoxBlur(radius)))
    is_dark = lines_dark <= mean * (1 - _DARKER)
    return np.where(is_dark != invert, 0, 255).astype(np.uint8)


def _noise(grey: Bytes, cells: Bytes, threshold: float) -> tuple[float, int]:
    """Return how much of a picture noise may have decided.

    Args:
        grey: (H, W) brightness, 255 white.
        cells: (H, W) of 0 and 1, which the picture became.
        threshold: brightness in [0, 1] above which a cell is bright.

    Returns:
        The share of pixels within `_NEAR` of the threshold, and the number of specks, which are not
        counted where few pixels are near.
    """
    lowest, highest = (threshold - _NEAR) * 255, (threshold + _NEAR) * 255
    near = float(((grey >= lowest) & (grey <= highest)).mean())
    if near < _MIN_NEAR:
        return near, 0
    specks = [
        count_components(of_one_kind, 2, 1) - count_components(of_one_kind, 2, _SPECK_CELLS)
        for of_one_kind in (cells, 1 - cells)
    ]
    return near, int(sum(specks))


def _notes_on_photos(photos: dict[str, tuple[float, int]]) -> list[str]:
    """Return a note on the pictures that seem to be photos or scans, with what `_noise` found."""
    if not photos:
        return []
    first, (near, specks) = next(iter(photos.items()))
    subject = f"{first} looks" if len(photos) == 1 else f"{first} and {len(photos) - 1} more look"
    return [
        f"{subject} like a photo: {percent(near)} of the pixels are within {_NEAR} of "
        f"the threshold, and {specks:,} components have fewer than {_SPECK_CELLS} cells; "
        "--images.threshold local compares each pixel with the mean around it"
    ]


def _outside(cells: Bytes) -> Flags:
    """Return which free cells of a grid, (H, W), are connected to its edge by straight moves.

    Raises:
        FormatError: all free cells are.
    """
    framed = np.pad(cells, 1)  # a frame of free cells, which joins those at the edge
    is_outside: Flags = distance_field(framed, (0, 0))[1:-1, 1:-1] >= 0
    if (is_outside | (cells != 0)).all():
        raise FormatError(
            "no free cell is left inside: all are connected to the edge of the map, perhaps by an "
            "open door; close it in the picture, or leave --images.outside out"
        )
    return is_outside


def _notes_on_outside(inside_shares: dict[str, float]) -> list[str]:
    """Return a note on the free cells that `_outside` has closed.

    Args:
        inside_shares: by the name of each map, the share of its free cells that stay free.
    """
    if not inside_shares:
        return []
    closed = percent(1 - sum(inside_shares.values()) / len(inside_shares))
    note = f"{closed} of the free cells were connected to the edge of a map and are now occupied"
    open_plans = [name for name, share in inside_shares.items() if share < _MIN_INSIDE]
    if open_plans:
        note += (
            f"; of {len(open_plans)} of {len(inside_shares)} maps ({open_plans[0]}) less than "
            f"{_MIN_INSIDE:.0%} is left, perhaps because a door or window in the outer wall is "
            "open: look at them, and close it in the picture"
        )
    return [note]


def _cells_of_picture(grey: Bytes, threshold: float, invert: bool) -> Bytes:
    """Return a picture, (H, W) brightness, as a grid, 0 free and 1 occupied."""
    is_dark = grey <= threshold * 255
    return np.asarray(is_dark != invert, np.uint8)


def _mean_of_picture(grey: Bytes, threshold: float, invert: bool, size: Size) -> Bytes:
    """Return a picture as a grid of ``size``: a cell has the mean brightness of its pixels."""
    # A cell that is half occupied must become occupied, and scaling rounds its mean of 127.5 up.
    # So the picture is scaled with bright occupied cells: inverted if dark pixels are occupied.
    scaled = _scaled(grey, size) if invert else 255 - _scaled(255 - grey, size)
    return _cells_of_picture(scaled, threshold, invert)


def _mean_of_cells(cells: Bytes, size: Size) -> Bytes:
    """Return a grid in ``size``: a cell is occupied if at least half of what it covers is."""
    return _scaled(255 * cells, size) // 128


def _scaled(values: Bytes, size: Size) -> Bytes:
    """Return ``values``, (H, W), in ``size``: a new one is the mean of the area that it covers."""
    rows, columns = size
    return np.asarray(Image.fromarray(values).resize((columns, rows), Image.Resampling.BOX))


def _sized(
    cells: Bytes,
    mean: Callable[[Size], Bytes],
    size: Size | None,
    fit: str | None,
    resample: str | None,
    free_space: FreeSpace,
) -> Bytes:
    """Return a grid in the size that the user asks for.

    Args:
        cells: (H, W) uint8, 0 free and 1 occupied.
        mean: returns the grid of a size whose cells are means.
        size: (rows, columns); None leaves the grid as it is.
        fit: "crop", or else the grid is scaled.
        resample: "mean", or else a cell is occupied if any part of it is.
        free_space: counts the free cells before and after.

    Raises:
        FormatError: the grid is too small to be cropped, or no free cell is left of it.
    """
    if size is None or size == cells.shape:
        return cells
    cell_area = 1.0
    if fit == "crop":
        sized = _middle(cells, size)
    else:
        sized = mean(size) if resample == "mean" else any_occupied(cells, size)
        cell_area = cells.size / sized.size
        _, advice = _size_note(size, fit, resample)
        check_free(cells, sized, advice)
    free_space.add(cells, [sized], cell_area)
    return sized


def _middle(cells: Bytes, size: Size) -> Bytes:
    """Return the middle of a grid.

    Raises:
        FormatError: the grid is too small.
    """
    rows, columns = size
    height, width = cells.shape
    if height < rows or width < columns:
        raise FormatError(f"has {height} x {width} cells, too small to crop {rows} x {columns}")
    top = (height - rows) // 2
    left = (width - columns) // 2
    return cells[top : top + rows, left : left + columns]


def _size_note(size: Size, fit: str | None, resample: str | None) -> tuple[str, str]:
    """Return what was done to maps of other sizes, and what to do if that loses free cells."""
    rows, columns = size
    if fit == "crop":
        return f"cropped to {rows} x {columns} cells", "crop less, or resize (--images.fit)"
    if resample == "mean":
        return f"resized to {rows} x {columns} cells by their mean", "shrink less"
    return (
        f"resized to {rows} x {columns} cells, occupied if any part is",
        "shrink less, or use mean (--images.resample)",
    )


def _unknown_pixels(grey: Bytes) -> Flags:
    """Return which pixels, (H, W), are unknown cells of a robot's map without its .yaml.

    That are those of `unknown_of_map_saver`. A map with few unknown cells has none of these. The
    thresholds of map_saver make 205 unknown there, too; but in a floor plan, 205 is one of many
    greys at the edges of lines. So these pixels of 205 count as unknown only if they are more than
    half of all pixels between black and the grey of free cells.
    """
    is_unknown = unknown_of_map_saver(grey)
    if not is_unknown.any():
        is_unknown = grey == UNKNOWN
        between = np.count_nonzero((grey > 0) & (grey < _FREE))
        if 2 * np.count_nonzero(is_unknown) <= between:
            is_unknown[:] = False
    return is_unknown


def unknown_of_map_saver(grey: Bytes) -> Flags:
    """Return which pixels, (H, W), are unknown cells if this is a picture of ROS's map_saver.

    In its mode trinary it writes 0 for occupied, 205 for unknown and 254 for free cells. So if 205
    and a grey of at least 250 each fill at least 1 % of the picture, 205 is unknown. No pixel is
    unknown otherwise.
    """
    is_unknown: Flags = grey == UNKNOWN
    min_count = _MIN_SHARE * grey.size
    free_count = np.count_nonzero(grey >= _MIN_FREE)
    if np.count_nonzero(is_unknown) < min_count or free_count < min_count:
        is_unknown[:] = False
    return is_unknown


def _unknown_advice(path: Path, is_unknown: Flags) -> str:
    """Return a message that says how much of a picture is unknown, and what to do about it."""
    candidates = [path.with_suffix(".yaml"), path.with_suffix(".yml")]
    existing = [str(candidate) for candidate in candidates if candidate.is_file()]
    yaml_name = existing[0] if existing else "its .yaml"
    share = percent(float(is_unknown.mean()))
    return (
        f"{share} of its pixels are of grey {UNKNOWN}, which robots' maps have "
        f"where nothing is known: import {yaml_name}, or say "
        "--images.unknown occupied or --images.unknown free"
    )


def note_free_cells(collection: Collection, free_cells: str, advice: str | None) -> None:
    """Add notes on which cells were taken for free, how many, and whether that seems wrong.

    The border of most maps is mostly occupied. If the border of most maps here is free, free and
    occupied may be mixed up, or the maps show plans with paper around them, where seed points would
    be drawn. Of the paper's own maps, whose rooms reach the border, a fifth has a free border.

    Args:
        collection: the maps that were read; its notes are extended.
        free_cells: how the source shows free cells, for the notes.
        advice: what to do about a free border, for the notes; None if the source itself says which
            cells are free, so that a free border is no reason to doubt.
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
            f"{free_cells} were taken for free: {percent(float(np.mean(free_shares)))} of a map"
        )
    if advice is not None and 2 * len(inverted) > len(free_shares):
        collection.notes.append(
            f"the border of {len(inverted)} of {len(free_shares)} maps is mostly free "
            f"({inverted[0]}): {advice}"
        )


def _open_stack(path: Path, limits: Limits, name: str | None) -> StoredArray:
    """Return the array of an .npy, or one array of an .npz, unread.

    Args:
        path: the file.
        limits: of what is read.
        name: of the array of an .npz; None for the only one that can hold maps.

    Raises:
        FormatError: no such array; without a name, several arrays can hold maps, or none.
    """
    if path.suffix.lower() == ".npy":
        return open_npy(path)
    archive = Npz(path, limits.unpacked)
    if name is None:
        names = [name for name, shape in archive.shapes.items() if len(shape) in (2, 3, 4)]
        if len(names) != 1:
            shapes = ", ".join(f"{name} {shape}" for name, shape in archive.shapes.items())
            advice = "; --images.array NAME says which one" if names else ""
            raise FormatError(f"{path}: holds arrays {shapes}, expected one of (N, H, W){advice}")
        (name,) = names
    return archive.arrays(name)[0]


FORMAT = Format("images", (*PICTURES, *ARRAYS), read)
