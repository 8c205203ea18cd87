"""Families of maps and their seed points in slow, plain Python, written from docs/format.md."""

from __future__ import annotations

import math

from helpers.reference import Cell, block, bounded, threshold
from mapdata import Cave, Forest, Maze

MAP, POINTS = 0, 5
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
