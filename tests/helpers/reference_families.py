"""Families of maps and their seed points in slow, plain Python, written from docs/format.md."""

from __future__ import annotations

import math

from helpers.reference import Cell, block, bounded, threshold
from mapdata import Cave, Forest, Maze, RandomWalls, Terrain

MAP, POINTS, TERRAIN = 0, 5, 6
STEPS = ((-1, 0), (0, 1), (1, 0), (0, -1))


def reference_maze(generator: Maze, seed: int, index: int) -> list[list[int]]:
    """Return a maze: the lattice's cells and its open walls first, then the grid that they make."""
    pitch = generator.corridor + generator.wall
    tall, wide = ((side - generator.wall) // pitch for side in generator.map_size)
    trail: list[Cell] = [(0, 0)]
    seen = {(0, 0)}
    opened: set[frozenset[Cell]] = set()
    steps = 0
    while trail:
        row, column = trail[-1]
        fresh = []
        for down, right in STEPS:
            r = row + down
            c = column + right
            if 0 <= r < tall and 0 <= c < wide and (r, c) not in seen:
                fresh.append((r, c))
        if not fresh:
            trail.pop()
            continue
        word = block(seed, index, 0, MAP, steps)[0]
        cell = fresh[bounded(word, 0, len(fresh) - 1)]
        steps += 1
        opened.add(frozenset((trail[-1], cell)))
        seen.add(cell)
        trail.append(cell)
    number = steps
    for row in range(tall):
        for column in range(wide):
            for other in ((row, column + 1), (row + 1, column)):
                word = block(seed, index, 0, MAP, number)[0]
                number += 1
                inside = other[0] < tall and other[1] < wide
                if inside and word < threshold(generator.reopened):
                    opened.add(frozenset(((row, column), other)))
    grid = [[1] * generator.map_size[1] for _ in range(generator.map_size[0])]
    for row, column in seen:
        for r in range(generator.corridor):
            for c in range(generator.corridor):
                grid[generator.wall + row * pitch + r][generator.wall + column * pitch + c] = 0
    for (row, column), (other_row, other_column) in map(sorted, opened):
        for across in range(generator.corridor):
            for along in range(generator.corridor, pitch):
                r, c = (across, along) if row == other_row else (along, across)
                grid[generator.wall + row * pitch + r][generator.wall + column * pitch + c] = 0
        assert (other_row - row, other_column - column) in ((0, 1), (1, 0))
    return grid


def reference_cave(generator: Cave, seed: int, index: int) -> list[list[int]]:
    """Return a cave: noise whose cells take the side of most of their neighbours."""
    rows, columns = generator.map_size
    halves: list[int] = []
    for number in range(-(-rows * columns // 8)):
        for word in block(seed, index, 0, MAP, number):
            halves += [word % 2**16, word // 2**16]
    limit = round(generator.occupied * 2**16)
    grid = [
        [int(halves[row * columns + column] < limit) for column in range(columns)]
        for row in range(rows)
    ]
    for _ in range(generator.steps):
        before = grid
        grid = []
        for row in range(rows):
            grid.append([])
            for column in range(columns):
                count = 0
                for r in (row - 1, row, row + 1):
                    for c in (column - 1, column, column + 1):
                        inside = 0 <= r < rows and 0 <= c < columns
                        count += before[r][c] if inside else 1
                grid[row].append(int(count >= 5))
    grid[rows // 2][columns // 2] = 0
    return grid


def reference_random_walls(generator: RandomWalls, seed: int, index: int) -> list[list[int]]:
    """Return random walls: noise of one density, drawn again while no cell is free."""
    rows, columns = generator.map_size
    least, most = (round(share * 2**16) for share in generator.occupied)
    number = 0
    while True:
        limit = bounded(block(seed, index, 0, MAP, number)[0], least, most)
        number += 1
        bits: list[int] = []
        while len(bits) < rows * columns:
            for word in block(seed, index, 0, MAP, number):
                bits += [word % 2**16, word // 2**16]
            number += 1
        cells = [int(value < limit) for value in bits[: rows * columns]]
        if 0 in cells:
            return [cells[row * columns : (row + 1) * columns] for row in range(rows)]


def reference_forest(generator: Forest, seed: int, index: int) -> list[list[int]]:
    """Return a forest: the union of obstacles, as sets of cells, until enough are covered."""
    rows, columns = generator.map_size
    least, most = (round(share * rows * columns) for share in generator.cover)
    target = bounded(block(seed, index, 0, MAP, 0)[0], least, most)
    covered: set[Cell] = set()
    number = 0
    while len(covered) < target:
        number += 1
        place, first, second, shape = block(seed, index, 0, MAP, number)
        row, column = divmod(bounded(place, 0, rows * columns - 1), columns)
        tall = bounded(first, *generator.sizes)
        wide = bounded(second, *generator.sizes)
        if bounded(shape, 0, 1):
            middle = (row - tall // 2 + tall / 2, column - tall // 2 + tall / 2)
            cells = {
                (r, c)
                for r in range(rows)
                for c in range(columns)
                if math.dist((r + 0.5, c + 0.5), middle) <= tall / 2
            }
        else:
            top = row - tall // 2
            left = column - wide // 2
            cells = {(r, c) for r in range(top, top + tall) for c in range(left, left + wide)}
        covered |= {(r, c) for r, c in cells if 0 <= r < rows and 0 <= c < columns}
    covered.discard((rows // 2, columns // 2))
    return [[int((row, column) in covered) for column in range(columns)] for row in range(rows)]


def reference_terrain(
    generator: Terrain, seed: int, index: int, occupancy: list[list[int]] | None = None
) -> list[list[int]]:
    """Return the costs of a map of terrain, whose obstacles are those of ``occupancy`` if given."""
    rows, columns = generator.map_size
    cells = [(row, column) for row in range(rows) for column in range(columns)]
    if occupancy is None:
        noise = reference_noise(generator, seed, index, 2)
        by_noise = sorted(cells, key=lambda cell: noise[cell])
        always_free = {by_noise[0]}
        if generator.corners:
            always_free = {(0, 0), (rows - 1, columns - 1)}
        candidates = [cell for cell in by_noise if cell not in always_free]
        count = min(round(generator.obstacles * len(cells)), len(candidates))
        occupied = set(candidates[len(candidates) - count :])
    else:
        occupied = {(row, column) for row, column in cells if occupancy[row][column]}
    noise = reference_noise(generator, seed, index, 0)
    free = sorted((cell for cell in cells if cell not in occupied), key=lambda cell: noise[cell])
    level_count = len(generator.costs)
    shares = generator.shares or (1 / level_count,) * level_count
    terrain = [[0] * columns for _ in range(rows)]
    start = 0
    for level in range(level_count):
        total = 1.0 if level == level_count - 1 else sum(shares[: level + 1])
        end = (len(free) * min(threshold(total), 2**32) + 2**31) // 2**32
        for row, column in free[start:end]:
            terrain[row][column] = generator.costs[level]
        start = end
    return terrain


def reference_noise(generator: Terrain, seed: int, index: int, octave: int) -> dict[Cell, int]:
    """Return the sum of two octaves of value noise for each cell."""
    first = reference_octave(generator, seed, index, octave, generator.scale)
    second = reference_octave(generator, seed, index, octave + 1, (generator.scale + 1) // 2)
    return {cell: (2 * first[cell] + second[cell]) // 64 for cell in first}


def reference_octave(
    generator: Terrain, seed: int, index: int, octave: int, spacing: int
) -> dict[Cell, int]:
    """Return an octave of value noise: numbers on a lattice, interpolated by a smooth step."""
    rows, columns = generator.map_size
    number = octave * 2**22
    w0, w1, _, _ = block(seed, index, 0, TERRAIN, number)
    down = bounded(w0, 0, spacing - 1)
    right = bounded(w1, 0, spacing - 1)
    tall = (down + rows - 1) // spacing + 2
    wide = (right + columns - 1) // spacing + 2
    halves: list[int] = []
    while len(halves) < tall * wide:
        number += 1
        for word in block(seed, index, 0, TERRAIN, number):
            halves += [word % 2**16, word // 2**16]

    def mixed(first: int, second: int, step: int) -> int:
        weight = step**2 * (3 * spacing - 2 * step) * 2**16 // spacing**3
        return (first * (2**16 - weight) + second * weight) // 2**16

    heights = {}
    for row in range(rows):
        for column in range(columns):
            i, row_step = divmod(row + down, spacing)
            j, column_step = divmod(column + right, spacing)
            above, below = (
                mixed(halves[k * wide + j], halves[k * wide + j + 1], column_step)
                for k in (i, i + 1)
            )
            heights[row, column] = mixed(above, below, row_step)
    return heights


def reference_points(cells: list[Cell], seed: int, index: int, count: int) -> list[Cell]:
    """Return seed points that lie far apart: each the one of 8 candidates with the widest gap."""

    def gap(cell: Cell) -> float:
        squares = [(cell[0] - row) ** 2 + (cell[1] - column) ** 2 for row, column in points]
        return min(squares, default=float("inf"))

    points: list[Cell] = []
    for k in range(min(count, len(cells))):
        words = [*block(seed, index, 0, POINTS, 2 * k), *block(seed, index, 0, POINTS, 2 * k + 1)]
        places = [bounded(word, 0, len(cells) - 1) for word in words]
        best = max(places, key=lambda place: gap(cells[place]))  # the first of equal ones
        while cells[best] in points:
            best = (best + 1) % len(cells)
        points.append(cells[best])
    return points
