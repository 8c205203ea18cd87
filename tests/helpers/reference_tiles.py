"""Tiles pixel by pixel in plain Python: slow, and easy to check against the documentation."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from fractions import Fraction
from functools import cache
from itertools import product
from math import isqrt

from helpers.reference import block, bounded

Colour = tuple[int, int, int]

IMAGE, JITTER = 7, 9
TILE, NOISE_RUN, TEXTURE, TINT, NOISE = range(5)
TEXTURES = 1024
NOISE_COUNT = 2**18

BLOBS, SPECKLES, COARSE_CHECKS, COARSE_STRIPES, FINE_CHECKS, FINE_STRIPES = range(6)
COARSE_DIAGONALS, FINE_DIAGONALS, COARSE_DIAMONDS, OBLIQUE_STRIPES, FINE_DIAMONDS = range(6, 11)
FINE = (FINE_CHECKS, FINE_STRIPES, FINE_DIAGONALS, OBLIQUE_STRIPES, FINE_DIAMONDS)

GROUNDS: list[Colour] = [
    (122, 122, 130),
    (134, 182, 84),
    (218, 196, 138),
    (74, 124, 190),
    (58, 104, 64),
    (132, 106, 66),
    (150, 112, 164),
    (206, 124, 70),
    (178, 184, 196),
    (76, 146, 136),
    (176, 52, 60),
]


def random_byte(seed: int, index: int, epoch: int, first_block: int, position: int) -> int:
    """Return byte ``position`` of a run of blocks, the lowest byte of the first word first."""
    word = block(seed, index, epoch, IMAGE, first_block + position // 16)[position % 16 // 4]
    return word >> 8 * (position % 4) & 255


def wave(position: int, period: int) -> int:
    """Return a triangular wave between 0 and 256."""
    phase = position % period * 512 // period
    return min(phase, 512 - phase)


def crossed(height: int, other_height: int) -> int:
    """Return the product of two waves around their middle."""
    return 128 + (height - 128) * (other_height - 128) // 128


def blob_height(lattice: Sequence[int], u: int, v: int, period: int) -> int:
    """Return the bilinear interpolation between bytes of a lattice of 8 x 8."""
    total = Fraction(0)
    for down, right in product((0, 1), repeat=2):
        row = (u // period + down) % 8
        column = (v // period + right) % 8
        row_weight = Fraction(u % period, period) if down else 1 - Fraction(u % period, period)
        column_weight = Fraction(v % period, period) if right else 1 - Fraction(v % period, period)
        total += lattice[8 * row + column] * row_weight * column_weight
    return int(total)


def pattern_height(
    digit: int, u: int, v: int, period: int, offset: int, lattice: Sequence[int]
) -> int:
    """Return the height of a pattern at a point; a phase is a part of ``u``."""
    diagonal = (u + v) * 5 // 7
    antidiagonal = (u - v) * 5 // 7 + offset
    if digit in (COARSE_STRIPES, FINE_STRIPES):
        return wave(u, period)
    if digit in (COARSE_DIAGONALS, FINE_DIAGONALS):
        return wave(diagonal, period)
    if digit == OBLIQUE_STRIPES:
        return wave((2 * u + v) * 4 // 9, period)
    if digit in (COARSE_CHECKS, FINE_CHECKS):
        return crossed(wave(u, period), wave(v + offset, period))
    if digit in (COARSE_DIAMONDS, FINE_DIAMONDS):
        return crossed(wave(diagonal, period), wave(antidiagonal, period))
    if digit == SPECKLES:
        return lattice[u // 16 % 8 * 8 + v // 16 % 8]
    return blob_height(lattice, u, v + offset, period)


def reference_levels(
    seed: int, cost: int, texture: int, axis: int, pixels: int, amplitude: int
) -> list[int]:
    """Return the levels of the pixels of a texture for one digit of its cost."""
    index = cost * TEXTURES + texture
    digit = cost // 11**axis % 11
    blocks_of_grain = -(-pixels * pixels // 16)
    first_block = axis * (1 + 4 + blocks_of_grain)
    words = block(seed, index, TEXTURE, IMAGE, first_block)
    period = bounded(words[0], *((40, 48) if digit in FINE else (72, 88)))
    phase, offset = bounded(words[1], 0, 1023), bounded(words[2], 0, 1023)
    direction = bounded(words[3], 0, 7)
    lattice = [random_byte(seed, index, TEXTURE, first_block + 1, k) for k in range(64)]
    heights = []
    for row, column in product(range(pixels), repeat=2):
        u = (2 * row + 1) * 128 // (2 * pixels)
        v = (2 * column + 1) * 128 // (2 * pixels)
        u = 128 - u if direction & 1 else u
        v = 128 - v if direction & 2 else v
        u, v = (v, u) if direction & 4 else (u, v)
        height = pattern_height(digit, u + phase, v, period, offset, lattice)
        grain = random_byte(seed, index, TEXTURE, first_block + 5, row * pixels + column)
        heights.append(256 * height + (12 if digit == BLOBS else 48) * grain)
    levels = [0] * len(heights)
    by_height = sorted(range(len(heights)), key=lambda pixel: (heights[pixel], pixel))
    for rank, pixel in enumerate(by_height):
        # From -amplitude to amplitude, halves rounded away from 0.
        exact = amplitude * Fraction(2 * rank - len(heights) + 1, len(heights) - 1)
        rounded = int(abs(exact) + Fraction(1, 2))
        levels[pixel] = rounded if exact > 0 else -rounded
    return levels


def ground_of(cost: int, alike: bool) -> Colour:
    """Return the mean colour of the textures of a cost."""
    if alike:
        return (124, 118, 106)
    if cost == 0:
        return (46, 44, 52)
    shifts = [(0, 18, -18)[cost // 11 // 3**channel % 3] for channel in range(3)]
    red, green, blue = (
        level + shift for level, shift in zip(GROUNDS[cost % 11], shifts, strict=True)
    )
    return red, green, blue


@cache
def reference_texture(
    cost: int, texture: int, pixels: int, alike: bool, seed: int
) -> list[list[int]]:
    """Return the levels of the pixels of a texture, for each channel."""
    amplitudes = (44, 12, 12) if alike else (26, 5, 5)
    brightness, red_green, yellow_blue = (
        reference_levels(seed, cost, texture, axis, pixels, amplitude)
        for axis, amplitude in enumerate(amplitudes)
    )
    tints = [bounded(word, -8, 8) for word in block(seed, texture, TINT, IMAGE, 0)[:3]]
    red, green, blue = map(sum, zip(ground_of(cost, alike), tints, strict=True))
    pixels_of_channels: list[list[int]] = [[], [], []]
    for light, red_minus_green, yellow_minus_blue in zip(
        brightness, red_green, yellow_blue, strict=True
    ):
        pixels_of_channels[0].append(red + light + red_minus_green + yellow_minus_blue)
        pixels_of_channels[1].append(green + light - red_minus_green + yellow_minus_blue)
        pixels_of_channels[2].append(blue + light - yellow_minus_blue)
    return [[min(max(level, 0), 255) for level in channel] for channel in pixels_of_channels]


@cache
def noise_levels(noise: int) -> list[int]:
    """Return 256 quantiles of the sum of four bytes, in eighths of levels, scaled to a deviation.

    The deviation is ``noise`` / sqrt(2).
    """
    counts = Counter({0: 1})
    for _ in range(4):
        sums: Counter[int] = Counter()
        for total, count in counts.items():
            for byte in range(256):
                sums[total + byte] += count
        counts = sums
    quantiles: list[int] = []
    cumulated = 0
    for total in sorted(counts):
        cumulated += counts[total]
        while 512 * cumulated >= (2 * len(quantiles) + 1) * 2**32 and len(quantiles) < 256:
            quantiles.append(total - 510)
    upper = quantiles[128:]
    deviation = isqrt(2 * sum(quantile**2 for quantile in upper) * 2**20 // 128)
    scaled = [int(Fraction(8 * noise * 2**10 * q, deviation) + Fraction(1, 2)) for q in upper]
    return [-level for level in reversed(scaled)] + scaled


def reference_key(terrain: Sequence[Sequence[int]]) -> int:
    """Return the key of the picture of a map: 8 bytes of a hash of its size and costs."""
    size = len(terrain).to_bytes(4, "little") + len(terrain[0]).to_bytes(4, "little")
    costs = b"".join(bytes(row) for row in terrain)
    return int.from_bytes(hashlib.sha256(size + costs).digest()[:8], "little")


def reference_picture(
    terrain: Sequence[Sequence[int]],
    key: int,
    pixels: int,
    alike: bool,
    noise: int,
    seed: int,
) -> list[list[list[int]]]:
    """Return a picture, channel by channel and row by row."""
    rows, columns = len(terrain), len(terrain[0])
    width = columns * pixels
    picture = []
    for channel in range(3):
        lines = []
        for picture_row in range(rows * pixels):
            run_words = block(seed, key, NOISE_RUN, IMAGE, 3 * picture_row + channel)
            run, other_run = (bounded(word, 0, NOISE_COUNT - width) for word in run_words[:2])
            line = []
            for x in range(width):
                row, column = picture_row // pixels, x // pixels
                words = block(seed, key, TILE, IMAGE, row * columns + column)
                texture = bounded(words[0], 0, TEXTURES - 1)
                levels = reference_texture(terrain[row][column], texture, pixels, alike, seed)
                level = levels[channel][picture_row % pixels * pixels + x % pixels]
                if noise:
                    added = sum(
                        noise_levels(noise)[random_byte(seed, 0, NOISE, 0, begin + x)]
                        for begin in (run, other_run)
                    )
                    rounded = int(abs(Fraction(added, 8)) + Fraction(1, 2))
                    level += rounded if added > 0 else -rounded
                    level = min(max(level, 0), 255)
                line.append(level)
            lines.append(line)
        picture.append(lines)
    return picture


def reference_jittered(
    picture: Sequence[Sequence[Sequence[int]]], seed: int, problem: int, epoch: int, pixels: int
) -> list[list[list[int]]]:
    """Return a picture, channel by channel and row by row, after the jitter of a problem."""
    words = (*block(seed, problem, epoch, JITTER, 0), *block(seed, problem, epoch, JITTER, 1))
    contrast, light = bounded(words[0], 128, 384), bounded(words[1], -48, 48)
    row_slant, column_slant = bounded(words[2], -32, 32), bounded(words[3], -32, 32)
    row_shift, column_shift = (bounded(word, -(pixels // 8), pixels // 8) for word in words[4:6])
    rows, columns = len(picture[0]), len(picture[0][0])
    changed = [[[0] * columns for _ in range(rows)] for _ in picture]
    for channel, row, column in product(range(3), range(rows), range(columns)):
        source_row = sorted((0, row - row_shift, rows - 1))[1]
        source_column = sorted((0, column - column_shift, columns - 1))[1]
        level = contrast * (picture[channel][source_row][source_column] - 128)
        level += 256 * light
        level += 256 * row_slant * (2 * row - rows + 1) // (rows - 1)
        level += 256 * column_slant * (2 * column - columns + 1) // (columns - 1)
        rounded = 128 + (level + 128) // 256
        changed[channel][row][column] = sorted((0, rounded, 255))[1]
    return changed
