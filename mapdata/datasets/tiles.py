"""The field ``image``: `Tiles` draws pictures of maps, a small texture for each cell.

**The look of a cost** is the same in all datasets. A cost has three digits in base 11. Each digit
chooses one of 11 patterns: the lowest digit that of brightness, the middle digit that of red
against green, the highest digit that of yellow against blue. So all 256 costs look different, and
costs that follow one another differ in brightness. Patterns differ in what the symmetries of a
square leave unchanged, because the datasets turn and reflect maps.

**The textures** of a cost have random phases, directions and scales. A pattern only ranks the
pixels of a texture: all textures have the same brightnesses in another order, around a ground
colour. So with ``alike``, where the ground colours of all costs are the same, neither the mean
colour of a texture nor its brightnesses tell anything of its cost.

**A picture** is drawn from the stored map, by copying a texture for each cell from a bank, and
adding noise from another bank. Which textures and which noise, a hash of the map decides, so that a
map has the same picture wherever it is served. All numbers are integers and come from
`mapdata.rng`, so that a picture is the same on every machine.

**Jitter** is for training alone: it changes light and contrast of a served picture, and moves it
against the cells. What it draws depends on the sampling seed, the epoch and the problem, as
symmetries do.
"""

from __future__ import annotations

import hashlib
import math
import struct
from dataclasses import dataclass
from functools import lru_cache
from threading import Lock
from typing import ClassVar, Protocol

import numpy as np
import numpy.typing as npt

from mapdata.arrays import Bytes, Ints
from mapdata.checks import check_count, check_flag, check_seed
from mapdata.jit import Int, inlined, kernel
from mapdata.problems.symmetry import transform_grids
from mapdata.rng import IMAGE, JITTER, block, bounded
from mapdata.search.map_stack import MapStack

MIN_PIXELS, MIN_ALIKE_PIXELS, MAX_PIXELS = 4, 8, 32
"""Limits of the pixels of a tile; tiles of fewer pixels cannot show all patterns."""

MAX_NOISE = 64

TEXTURES = 1024
"""Number of textures of each cost."""

_TILE, _NOISE_RUN, _TEXTURE, _TINT, _NOISE = range(5)
"""The epochs of random words: each purpose has words of its own."""

Keys = npt.NDArray[np.uint64]

_BLOBS, _SPECKLES, _COARSE_CHECKS, _COARSE_STRIPES, _FINE_CHECKS, _FINE_STRIPES = range(6)
_COARSE_DIAGONALS, _FINE_DIAGONALS, _COARSE_DIAMONDS, _OBLIQUES, _FINE_DIAMONDS = range(6, 11)
"""The patterns by their digits. Stripes run along an axis, obliques between axis and diagonal.

Diamonds are checks that stand on a corner.
"""

_BASE = 11
"""Base of the digits of a cost, and number of patterns."""

_SIDE = 128
"""Side of a tile in the units of patterns, whatever its number of pixels."""

_FINE = (40, 48)
_COARSE = (72, 88)
"""Shortest and longest period of fine and of coarse patterns, in units."""

_FINE_PATTERNS = (_FINE_CHECKS, _FINE_STRIPES, _FINE_DIAGONALS, _OBLIQUES, _FINE_DIAMONDS)

_MAX_PHASE = 1023
"""Highest phase of a pattern, in units; it is many periods, so that all phases occur as often."""

_LATTICE = 8
"""Rows and columns of the random bytes of blobs and speckles."""

_GRAIN = 48
_GRAIN_OF_BLOBS = 12
"""Height of the grain that roughens a pattern of height 256; blobs are often flatter."""

_AMPLITUDES = (26, 5, 5)
_ALIKE_AMPLITUDES = (44, 12, 12)
"""Highest levels of brightness, of red against green, and of yellow against blue."""

_ALIKE_COLOUR = (124, 118, 106)
"""Mean colour of all tiles that look alike."""

_OCCUPIED_COLOUR = (46, 44, 52)

_COLOURS = (
    (122, 122, 130),  # rock
    (134, 182, 84),  # grass
    (218, 196, 138),  # sand
    (74, 124, 190),  # water
    (58, 104, 64),  # forest
    (132, 106, 66),  # earth
    (150, 112, 164),  # heath
    (206, 124, 70),  # clay
    (178, 184, 196),  # paving
    (76, 146, 136),  # swamp
    (176, 52, 60),  # lava
)
"""Mean colours by the lowest digit of a cost."""

_SHIFTS = (0, 18, -18)
"""What the higher digits of a cost, in base 3, add to the channels of its colour."""

_MAX_TINT = 8
"""By how much the channels of the mean colour of a texture differ from the ground at most."""

_NOISE_COUNT = 2**18
"""Number of levels in the bank of noise."""

_NOISE_UNIT = 8
"""The bank of noise holds eighths of grey levels."""

_MIN_CONTRAST, _MAX_CONTRAST, _EQUAL_CONTRAST = 128, 384, 256
"""Limits of the factor of contrast that jitter draws, in 256ths, and the factor 1."""

_MIDDLE_LEVEL = 128
"""The level that a change of contrast leaves as it is."""

_MAX_LIGHT = 48
"""By how many grey levels jitter brightens or darkens a picture at most."""

_MAX_SLANT = 32
"""By how many grey levels slanted light brightens one border and darkens the opposite one at most.
"""

_PIXELS_PER_SHIFT = 8
"""Jitter moves a picture by at most one pixel for this many pixels of a tile."""


@inlined
def _wave(position: Int, period: Int) -> Int:
    """Return a triangular wave of height 256 at a position."""
    phase = (position % period) * 512 // period
    return phase if phase <= 256 else 512 - phase


@kernel
def _height(digit: Int, u: Int, v: Int, period: Int, offset: Int, lattice: Ints) -> Int:
    """Return the height of a pattern, 0 to 256, at a point of a tile.

    Args:
        digit: number of the pattern, 0 to 10.
        u: first coordinate, in units.
        v: second coordinate, in units.
        period: distance of the waves, in units.
        offset: phase of the second of two waves; that of the first is a part of ``u``.
        lattice: (64,) random bytes, for speckles and blobs.
    """
    # 5 / 7 is close to 1 / sqrt(2), and 4 / 9 to 1 / sqrt(5): waves in these directions have the
    # same period.
    diagonal = (u + v) * 5 // 7
    antidiagonal = (u - v) * 5 // 7 + offset
    if digit in (_COARSE_STRIPES, _FINE_STRIPES):
        return _wave(u, period)
    if digit in (_COARSE_DIAGONALS, _FINE_DIAGONALS):
        return _wave(diagonal, period)
    if digit == _OBLIQUES:
        return _wave((2 * u + v) * 4 // 9, period)
    if digit in (_COARSE_CHECKS, _FINE_CHECKS):
        product = (_wave(u, period) - 128) * (_wave(v + offset, period) - 128)
        return 128 + product // 128
    if digit in (_COARSE_DIAMONDS, _FINE_DIAMONDS):
        product = (_wave(diagonal, period) - 128) * (_wave(antidiagonal, period) - 128)
        return 128 + product // 128
    if digit == _SPECKLES:
        return lattice[(u // 16) % _LATTICE * _LATTICE + (v // 16) % _LATTICE]
    # Blobs: random heights, a period apart, and linear in between.
    row, down = divmod(u, period)
    column, right = divmod(v + offset, period)
    row %= _LATTICE
    column %= _LATTICE
    next_row = (row + 1) % _LATTICE
    next_column = (column + 1) % _LATTICE
    upper = (
        lattice[row * _LATTICE + column] * (period - right)
        + lattice[row * _LATTICE + next_column] * right
    )
    lower = (
        lattice[next_row * _LATTICE + column] * (period - right)
        + lattice[next_row * _LATTICE + next_column] * right
    )
    return (upper * (period - down) + lower * down) // (period * period)


@kernel
def _draw_bytes(
    seed: np.uint64, index: np.uint64, epoch: Int, number: Int, random_bytes: Ints
) -> Int:
    """Fill an array with random bytes, and return the number of the next block of words."""
    for i in range(0, len(random_bytes), 16):
        words = block(seed, index, epoch, IMAGE, number)
        number += 1
        for j in range(min(16, len(random_bytes) - i)):
            random_bytes[i + j] = (words[j // 4] >> np.uint64(8 * (j % 4))) & np.uint64(255)
    return number


@kernel
def _draw_heights(seed: np.uint64, cost: Int, pixels: Int) -> Ints:
    """Return the heights of the pixels of all textures of a cost.

    Returns:
        (TEXTURES, 3, pixels * pixels) int64: the heights of the patterns of the three digits.
    """
    heights = np.empty((TEXTURES, 3, pixels * pixels), np.int64)
    lattice = np.empty(_LATTICE * _LATTICE, np.int64)
    grain = np.empty(pixels * pixels, np.int64)
    for texture in range(TEXTURES):
        index = np.uint64(cost * TEXTURES + texture)
        number = 0
        higher_digits = cost
        for axis in range(3):
            digit = higher_digits % _BASE
            higher_digits //= _BASE
            words = block(seed, index, _TEXTURE, IMAGE, number)
            min_period, max_period = _FINE if digit in _FINE_PATTERNS else _COARSE
            period = bounded(words[0], min_period, max_period)
            phase = bounded(words[1], 0, _MAX_PHASE)
            offset = bounded(words[2], 0, _MAX_PHASE)
            direction = bounded(words[3], 0, 7)
            grain_height = _GRAIN_OF_BLOBS if digit == _BLOBS else _GRAIN
            number = _draw_bytes(seed, index, _TEXTURE, number + 1, lattice)
            number = _draw_bytes(seed, index, _TEXTURE, number, grain)
            for row in range(pixels):
                for column in range(pixels):
                    # The middle of the pixel, after a symmetry of the square.
                    u = (2 * row + 1) * _SIDE // (2 * pixels)
                    v = (2 * column + 1) * _SIDE // (2 * pixels)
                    if direction & 1:
                        u = _SIDE - u
                    if direction & 2:
                        v = _SIDE - v
                    if direction & 4:
                        u, v = v, u
                    height = _height(digit, u + phase, v, period, offset, lattice)
                    pixel = row * pixels + column
                    heights[texture, axis, pixel] = 256 * height + grain_height * grain[pixel]
    return heights


def _levels_of_ranks(heights: Ints, amplitude: int) -> Ints:
    """Return levels from -``amplitude`` to ``amplitude``, in the order of the heights.

    The sum of the levels of a texture is 0 and their distribution uniform, whatever its pattern.

    Args:
        heights: (N, pixels * pixels).
        amplitude: the highest level.
    """
    count = heights.shape[1]
    # Twice the distance of a rank from the middle rank, so that it is a whole number.
    distances = 2 * np.arange(count) - (count - 1)
    levels_of_ranks = np.sign(distances) * (
        (2 * amplitude * abs(distances) + count - 1) // (2 * (count - 1))
    )
    levels = np.empty_like(heights)
    order = np.argsort(heights, axis=1, kind="stable")
    np.put_along_axis(levels, order, np.broadcast_to(levels_of_ranks, order.shape), axis=1)
    return levels


def _ground_colour(cost: int) -> tuple[int, int, int]:
    """Return the mean (red, green, blue) of the tiles of a cost, unless all costs look alike."""
    if cost == 0:
        return _OCCUPIED_COLOUR
    number, digit = divmod(cost, _BASE)
    red, green, blue = _COLOURS[digit]
    return (
        red + _SHIFTS[number % 3],
        green + _SHIFTS[number // 3 % 3],
        blue + _SHIFTS[number // 9],
    )


@kernel
def _draw_tints(seed: np.uint64) -> Ints:
    """Return (TEXTURES, 3) int64, by how much the mean colours of textures differ from the ground.

    They are the same for all costs, so that they do not tell which cost a tile has.
    """
    tints = np.empty((TEXTURES, 3), np.int64)
    for texture in range(TEXTURES):
        words = block(seed, np.uint64(texture), _TINT, IMAGE, 0)
        for channel in range(3):
            tints[texture, channel] = bounded(words[channel], -_MAX_TINT, _MAX_TINT)
    return tints


def draw_textures(cost: int, pixels: int, alike: bool, seed: int) -> Bytes:
    """Return the textures of a cost, (TEXTURES, 3, pixels, pixels) uint8.

    Args:
        cost: 0 for an occupied cell, otherwise 1 to 255.
        pixels: rows and columns of a texture.
        alike: whether all costs have the same mean colours.
        seed: key of the random words.
    """
    heights = _draw_heights(np.uint64(seed), cost, pixels)
    amplitudes = _ALIKE_AMPLITUDES if alike else _AMPLITUDES
    brightness, red_green, yellow_blue = (
        _levels_of_ranks(heights[:, axis], amplitudes[axis]) for axis in range(3)
    )
    levels = np.stack(
        (
            brightness + red_green + yellow_blue,
            brightness - red_green + yellow_blue,
            brightness - yellow_blue,
        ),
        axis=1,
    )
    ground = _ALIKE_COLOUR if alike else _ground_colour(cost)
    levels += (np.array(ground) + _draw_tints(np.uint64(seed)))[:, :, None]
    return levels.clip(0, 255).astype(np.uint8).reshape(TEXTURES, 3, pixels, pixels)


class _Bank:
    """The textures of the costs that have occurred so far, for some pixels, mode and seed.

    Attributes:
        textures: (S, TEXTURES, 3, pixels, pixels) uint8; S grows.
        slots: (256,) int64, where the textures of a cost are, -1 if they have not been drawn.
    """

    def __init__(self, pixels: int, alike: bool, seed: int) -> None:
        """Begin without textures."""
        self._pixels = pixels
        self._alike = alike
        self._seed = seed
        self._lock = Lock()
        self._count = 0
        self.textures = np.zeros((4, TEXTURES, 3, pixels, pixels), np.uint8)
        self.slots = np.full(256, -1)

    def with_costs(self, terrain: Bytes) -> tuple[Bytes, Ints]:
        """Return ``textures`` and ``slots`` after the costs of ``terrain`` have been added."""
        is_used = np.bincount(terrain.reshape(-1), minlength=256) > 0
        with self._lock:
            for cost in np.flatnonzero(is_used & (self.slots < 0)).tolist():
                if self._count == len(self.textures):
                    # The room doubles, so that it is copied a few times in all.
                    self.textures = np.concatenate((self.textures, np.zeros_like(self.textures)))
                self.textures[self._count] = draw_textures(
                    cost, self._pixels, self._alike, self._seed
                )
                self.slots[cost] = self._count
                self._count += 1
            return self.textures, self.slots


@lru_cache(maxsize=8)
def _bank(pixels: int, alike: bool, seed: int) -> _Bank:
    """Return the bank of this process for some options."""
    return _Bank(pixels, alike, seed)


def _noise_levels(noise: int) -> npt.NDArray[np.int16]:
    """Return 256 levels of noise, equally probable, in units of `_NOISE_UNIT`.

    Their standard deviation is ``noise`` / sqrt(2), because two of them are added. They are
    quantiles of the sum of four random bytes, which is close to a normal distribution.
    """
    counts = np.ones(1, np.int64)
    for _ in range(4):
        counts = np.convolve(counts, np.ones(256, np.int64))
    middle = len(counts) // 2
    # The quantiles above the middle; those below are their mirror images.
    targets = (2 * np.arange(128, 256) + 1) * 2**23
    upper = np.searchsorted(np.cumsum(counts), targets) - middle
    # 2**10 times the standard deviation of the quantiles, times sqrt(2).
    deviation = math.isqrt(2 * int((upper * upper).sum()) * 2**20 // 128)
    scale = _NOISE_UNIT * noise * 2**10
    levels = (2 * scale * upper + deviation) // (2 * deviation)
    return np.concatenate((-levels[::-1], levels)).astype(np.int16)


@kernel
def _draw_noise_bytes(seed: np.uint64) -> Ints:
    """Return `_NOISE_COUNT` random bytes as int64, of which the noise is made."""
    random_bytes = np.empty(_NOISE_COUNT, np.int64)
    _draw_bytes(seed, np.uint64(0), _NOISE, 0, random_bytes)
    return random_bytes


@lru_cache(maxsize=8)
def _noise_bank(noise: int, seed: int) -> npt.NDArray[np.int16]:
    """Return (`_NOISE_COUNT`,) levels of noise; they are the same in every process."""
    return _noise_levels(noise)[_draw_noise_bytes(np.uint64(seed))]


@kernel
def _copy_tiles(
    terrain: Bytes,
    keys: Keys,
    seed: np.uint64,
    textures: Bytes,
    slots: Ints,
    noise_bank: npt.NDArray[np.int16],
    pictures: Bytes,
) -> None:
    """Fill pictures, (B, 3, pixels * H, pixels * W), with textures of the bank and noise.

    Args:
        terrain: (B, H, W).
        keys: (B,), as `map_keys` returns them.
        seed: key of the random words.
        textures: of the bank.
        slots: of the bank.
        noise_bank: levels of noise, or empty for no noise.
        pictures: are filled.
    """
    maps, rows, columns = terrain.shape
    pixels = textures.shape[3]
    width = np.uint64(columns * pixels)
    bank_pixels = textures.reshape(-1)
    texture_size = 3 * pixels * pixels
    # For each column of pixels, where the bank has it in the first row and channel of its texture.
    sources = np.empty(width, np.uint64)
    for b in range(maps):
        index = keys[b]
        for row in range(rows):
            # Choose a texture for each cell of the row.
            for column in range(columns):
                word, _, _, _ = block(seed, index, _TILE, IMAGE, row * columns + column)
                texture = bounded(word, 0, TEXTURES - 1)
                texture_number = slots[terrain[b, row, column]] * TEXTURES + texture
                for i in range(pixels):
                    sources[column * pixels + i] = texture_number * texture_size + i
            # Copy the textures of all cells, one row of pixels of a channel after another.
            for channel in range(3):
                for pixel_row in range(pixels):
                    picture_row = row * pixels + pixel_row
                    picture_line = pictures[b, channel, picture_row]
                    row_offset = np.uint64((channel * pixels + pixel_row) * pixels)
                    for x in range(width):
                        picture_line[x] = bank_pixels[sources[x] + row_offset]
                    if len(noise_bank) > 0:
                        words = block(seed, index, _NOISE_RUN, IMAGE, 3 * picture_row + channel)
                        _add_noise(noise_bank, words[0], words[1], picture_line)


@inlined
def _add_noise(
    noise_bank: npt.NDArray[np.int16], word: np.uint64, other_word: np.uint64, line: Bytes
) -> None:
    """Add noise to a row of pixels: the sum of two runs of the bank, which two words choose."""
    last = len(noise_bank) - len(line)
    run = np.uint64(bounded(word, 0, last))
    other_run = np.uint64(bounded(other_word, 0, last))
    for x in range(np.uint64(len(line))):
        noise = noise_bank[run + x] + noise_bank[other_run + x]
        # Halves are rounded away from 0, so that the mean of the noise is 0.
        sign = noise >> np.int16(15)
        grey_levels = (noise + sign + np.int16(_NOISE_UNIT // 2)) // np.int16(_NOISE_UNIT)
        level = np.int16(line[x]) + grey_levels
        line[x] = min(max(level, np.int16(0)), np.int16(255))


def map_keys(terrain: Bytes) -> Keys:
    """Return the key of the picture of each map, (B,) uint64.

    It is the first 8 bytes, little-endian, of the SHA-256 of the numbers of rows and columns, each
    as 4 bytes little-endian, and of the costs of all cells, a byte each, row by row.

    Args:
        terrain: (B, H, W) uint8, 0 occupied, otherwise the cost of a cell.
    """
    size = struct.pack("<2I", *terrain.shape[1:])
    digests = [hashlib.sha256(size + cell_costs.tobytes()).digest()[:8] for cell_costs in terrain]
    return np.frombuffer(b"".join(digests), "<u8").astype(np.uint64)


def draw_tiles(
    terrain: Bytes, keys: Keys, pixels: int, alike: bool, noise: int, seed: int
) -> Bytes:
    """Return pictures of maps, (B, 3, pixels * H, pixels * W) uint8.

    Args:
        terrain: (B, H, W) uint8, 0 occupied, otherwise the cost of a cell.
        keys: (B,) uint64, which choose the textures and the noise: those of `map_keys`.
        pixels: rows and columns of a tile.
        alike: whether all costs have the same mean colours.
        noise: standard deviation of the noise of a pixel.
        seed: key of the random words.
    """
    maps, rows, columns = terrain.shape
    pictures = np.empty((maps, 3, rows * pixels, columns * pixels), np.uint8)
    textures, slots = _bank(pixels, alike, seed).with_costs(terrain)
    noise_bank = _noise_bank(noise, seed) if noise else np.empty(0, np.int16)
    _copy_tiles(terrain, keys, np.uint64(seed), textures, slots, noise_bank, pictures)
    return pictures


class PicturedBatch(Protocol):
    """What `Tiles` needs of a `Batch`, which describes it."""

    @property
    def stored_terrain(self) -> Bytes | None:
        """(B, H, W) uint8."""

    @property
    def stored_grids(self) -> Bytes:
        """(B, H, W) uint8."""

    @property
    def symmetries(self) -> Ints:
        """(B,) int64."""

    @property
    def problems(self) -> Ints:
        """(B,) int64."""

    @property
    def sampling_seed(self) -> int:
        """Seed of what is drawn while loading."""

    @property
    def epoch(self) -> int:
        """Pass over the data."""


@dataclass(frozen=True)
class Tiles:
    """The field ``image``, with options of your own: pictures of the maps.

    It stands among the names in ``fields=``: ``fields=("image", "path", Tiles(noise=10))``.

    Each cell is drawn as a tile by its cost: 0 for an occupied cell, the cost of terrain, or 1 for
    a free cell of a map without terrain. A cost looks alike in all maps and datasets, but never the
    same: its texture is chosen at random from `TEXTURES`, by a hash of the map and by the cell.

    The picture belongs to the stored map, and depends on its size and costs alone: the same map has
    the same picture in every dataset, problem set and export. ``augment`` turns and reflects the
    picture with the map, and a ``radius`` does not change it. A map that is stored turned or
    reflected is another map, with a picture of its own.

    ``jitter`` is for training pictures that have to be read in any light, as long as they are sharp
    and aligned. The data module gives it to the training split alone. It draws four things anew for
    each sample and epoch, from the sampling seed, the epoch and the number of the problem: a
    contrast of 1/2 to 3/2 around level 128; a light of -48 to 48 grey levels, the same for all
    pixels and channels; a slanted light, of up to 32 levels at the borders for each of the two
    axes; and a shift by up to a pixel for each 8 pixels of a tile, along both axes, after which the
    border pixels are repeated.

    Attributes:
        pixels: k, rows and columns of a tile, 4 to 32.
        alike: whether all costs have the same mean colours, so that only the patterns of the tiles
            tell them apart; needs at least 8 pixels.
        noise: standard deviation of the noise that is added to each channel of each pixel, in grey
            levels of 0 to 255; at most 64.
        seed: another seed gives other textures of the same looks, and other noise.
        jitter: whether light, contrast and position vary, as above.

    Raises:
        ValueError: an option out of range.
    """

    pixels: int = 8
    alike: bool = False
    noise: int = 0
    seed: int = 0
    jitter: bool = False

    __name__: ClassVar[str] = "image"

    def __post_init__(self) -> None:
        """Check the values."""
        check_flag("alike", self.alike)
        check_flag("jitter", self.jitter)
        pixels = check_count("pixels", self.pixels)
        min_pixels = MIN_ALIKE_PIXELS if self.alike else MIN_PIXELS
        if not min_pixels <= pixels <= MAX_PIXELS:
            raise ValueError(
                f"pixels: got {pixels}, expected {min_pixels} to {MAX_PIXELS} rows and columns of "
                f"a tile{' for alike=True' if self.alike else ''}"
            )
        noise = check_count("noise", self.noise, minimum=0)
        if noise > MAX_NOISE:
            raise ValueError(f"noise: got {noise}, expected at most {MAX_NOISE} grey levels")
        object.__setattr__(self, "pixels", pixels)
        object.__setattr__(self, "noise", noise)
        object.__setattr__(self, "seed", check_seed(self.seed))

    def __call__(self, batch: PicturedBatch) -> Bytes:
        """Return the pictures, (B, 3, pixels * H, pixels * W) uint8."""
        terrain = MapStack(batch.stored_grids, batch.stored_terrain).cell_costs
        keys = map_keys(terrain)  # Equal maps have equal pictures, whatever their numbers are.
        pictures = draw_tiles(terrain, keys, self.pixels, self.alike, self.noise, self.seed)
        pictures = after_symmetries(pictures, batch.symmetries)
        if self.jitter:
            # The light is drawn anew in each epoch, as random problems are: from their seed.
            sampling_seed = np.uint64(batch.sampling_seed)
            max_shift = self.pixels // _PIXELS_PER_SHIFT
            jitters = sample_jitters(sampling_seed, batch.epoch, batch.problems, max_shift)
            pictures = jittered(pictures, jitters)
        return pictures


def after_symmetries(pictures: Bytes, symmetries: Ints) -> Bytes:
    """Return pictures, (B, 3, rows, columns), after the symmetries of their maps, (B,)."""
    if not symmetries.any():
        return pictures
    channels = pictures.reshape(-1, *pictures.shape[2:])
    return transform_grids(channels, np.repeat(symmetries, 3)).reshape(pictures.shape)


@kernel
def sample_jitters(seed: np.uint64, epoch: Int, indices: Ints, max_shift: Int) -> Ints:
    """Return the random jitter of each of the problems ``indices``, (B, 6).

    Its numbers are the contrast in 256ths, the light, the slanted light along rows and along
    columns, in grey levels, and the shift of rows and of columns, in pixels.
    """
    jitters = np.empty((len(indices), 6), np.int64)
    for b in range(len(indices)):
        index = np.uint64(indices[b])
        w0, w1, w2, w3 = block(seed, index, epoch, JITTER, 0)
        w4, w5, _, _ = block(seed, index, epoch, JITTER, 1)
        jitters[b, 0] = bounded(w0, _MIN_CONTRAST, _MAX_CONTRAST)
        jitters[b, 1] = bounded(w1, -_MAX_LIGHT, _MAX_LIGHT)
        jitters[b, 2] = bounded(w2, -_MAX_SLANT, _MAX_SLANT)
        jitters[b, 3] = bounded(w3, -_MAX_SLANT, _MAX_SLANT)
        jitters[b, 4] = bounded(w4, -max_shift, max_shift)
        jitters[b, 5] = bounded(w5, -max_shift, max_shift)
    return jitters


@kernel
def jittered(pictures: Bytes, jitters: Ints) -> Bytes:
    """Return pictures, (B, 3, rows, columns), after the jitters of `sample_jitters`, (B, 6)."""
    changed = np.empty_like(pictures)
    channels, rows, columns = pictures.shape[1:]
    sources = np.empty(columns, np.int64)
    lights = np.empty(columns, np.int64)
    for b in range(len(pictures)):
        contrast = jitters[b, 0]
        light = jitters[b, 1]
        row_slant = jitters[b, 2]
        column_slant = jitters[b, 3]
        row_shift = jitters[b, 4]
        column_shift = jitters[b, 5]
        for x in range(columns):
            sources[x] = min(max(x - column_shift, 0), columns - 1)
            # From -slant at the first pixel to slant at the last one, in 256ths of a level.
            slant = _EQUAL_CONTRAST * column_slant * (2 * x - (columns - 1)) // (columns - 1)
            lights[x] = _EQUAL_CONTRAST * light + slant
        for y in range(rows):
            source_row = min(max(y - row_shift, 0), rows - 1)
            slant = _EQUAL_CONTRAST * row_slant * (2 * y - (rows - 1)) // (rows - 1)
            for channel in range(channels):
                line = pictures[b, channel, source_row]
                changed_line = changed[b, channel, y]
                for x in range(columns):
                    level = np.int64(line[np.uint64(sources[x])]) - _MIDDLE_LEVEL
                    level = contrast * level + lights[x] + slant + _EQUAL_CONTRAST // 2
                    level = _MIDDLE_LEVEL + level // _EQUAL_CONTRAST
                    changed_line[x] = min(max(level, 0), 255)
    return changed
