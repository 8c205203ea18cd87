"""Measure a set of mazes in the format of maze-30x30-hard-1k: python docs/maze_hard.py FOLDER.

FOLDER has train.csv and test.csv, as the set is published, or the folders train and test with the
arrays that the converter of HRM and TRM makes of them. Printed are tables of the mazes, of their
labels, of what needs no training to score, and of copies. With ``--beside FOLDER`` the mazes of
another set stand beside them, with two-sample tests of Kolmogorov and Smirnov.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import ks_2samp

from mapdata import Movement, astar, bfs, distance_field
from mapdata.arrays import Array, Bytes, Flags, Float32s, Floats, Ints
from mapdata.datasets.text import CHARACTERS, LABEL_ORDER, first_optimal_paths
from mapdata.formats.maze_questions import MOVES

SPLITS = ("train", "test")

_WALL, _FREE, _START, _GOAL, _PATH = range(1, len(CHARACTERS) + 1)


@dataclass(frozen=True)
class Mazes:
    """The problems of a split, and what follows from them.

    Attributes:
        walls: (N, H, W) bool.
        starts: (N, 2).
        goals: (N, 2).
        marks: (N, H, W) bool, the cells that the labels mark.
        costs: (N, H, W), number of moves to the goal; -1 where no path leads.
    """

    walls: Flags
    starts: Ints
    goals: Ints
    marks: Flags
    costs: Float32s

    def __len__(self) -> int:
        """Return the number of problems."""
        return len(self.walls)

    @property
    def moves(self) -> Ints:
        """(N,), number of moves of a shortest path."""
        moves: Ints = self.costs[(np.arange(len(self)), *self.starts.T)].astype(np.int64)
        return moves


def read_tokens(folder: Path, split: str) -> tuple[Bytes, Bytes]:
    """Return the questions and the answers of a split as tokens, (N, H, W) each."""
    if (folder / f"{split}.csv").exists():
        lines = (folder / f"{split}.csv").read_text(encoding="ascii").splitlines()[1:]
        texts = np.array([line.rsplit(",", 3)[1:3] for line in lines], "S").T
        codes = texts.copy().view(np.uint8).reshape(2, len(lines), -1)
        token_of_code = np.zeros(256, np.uint8)
        token_of_code[np.frombuffer(CHARACTERS.encode(), np.uint8)] = range(1, len(CHARACTERS) + 1)
        questions, answers = token_of_code[codes]
    else:
        questions = np.load(folder / split / "all__inputs.npy")
        answers = np.load(folder / split / "all__labels.npy")
    side = math.isqrt(questions.shape[1])
    return questions.reshape(-1, side, side), answers.reshape(-1, side, side)


def read_mazes(folder: Path, split: str) -> Mazes:
    """Return the problems of a split."""
    questions, answers = read_tokens(folder, split)
    walls = questions == _WALL
    starts = np.argwhere(questions == _START)[:, 1:]
    goals = np.argwhere(questions == _GOAL)[:, 1:]
    costs = np.array([distance_field(grid, goal) for grid, goal in zip(walls, goals, strict=True)])
    return Mazes(walls, starts, goals, answers == _PATH, costs)


def marks_of_paths(paths: Sequence[Ints] | Ints, shape: tuple[int, ...]) -> Flags:
    """Return the cells of paths between their ends, (N, H, W) bool; -1 pads a path."""
    marks = np.zeros(shape, bool)
    for mark, path in zip(marks, paths, strict=True):
        inner = path[path[:, 0] >= 0][1:-1]
        mark[tuple(inner.T)] = True
    return marks


def count_shortest_paths(
    costs: Float32s, start: Ints, steps: Collection[tuple[int, int]] = tuple(MOVES.values())
) -> int:
    """Return how many shortest paths lead from a start to the goal of a cost field (H, W).

    Args:
        costs: number of moves to the goal, -1 where no path leads.
        start: cell.
        steps: the moves, each of which costs 1; default the four moves of these mazes.
    """
    counts = {tuple(cell): 1 for cell in np.argwhere(costs == 0).tolist()}
    reached = np.argwhere((costs > 0) & (costs <= costs[tuple(start)]))
    order = np.argsort(costs[tuple(reached.T)], kind="stable")
    for row, column in reached[order].tolist():
        counts[row, column] = sum(
            counts.get((row + down, column + right), 0)
            for down, right in steps
            if _cost_at(costs, row + down, column + right) == costs[row, column] - 1
        )
    return counts[tuple(start.tolist())]


def _cost_at(costs: Float32s, row: int, column: int) -> float:
    """Return the cost of a cell, -1 beyond the border."""
    rows, columns = costs.shape
    inside = 0 <= row < rows and 0 <= column < columns
    return float(costs[row, column]) if inside else -1.0


def path_counts(mazes: Mazes) -> list[int]:
    """Return the number of shortest paths of each problem."""
    return [
        count_shortest_paths(costs, start)
        for costs, start in zip(mazes.costs, mazes.starts, strict=True)
    ]


def is_shortest(marks: Flags, mazes: Mazes) -> Flags:
    """Return for each problem whether marked cells are the inner cells of a shortest path."""
    count = np.zeros(len(mazes), bool)
    for k in range(len(mazes)):
        ends = np.zeros_like(marks[k])
        ends[tuple(mazes.starts[k])] = ends[tuple(mazes.goals[k])] = True
        path = astar(~(marks[k] | ends), mazes.starts[k], mazes.goals[k]).path
        uses_all_marks = len(path) == marks[k].sum() + 2
        leaves_walls = not (marks[k] & mazes.walls[k]).any()
        count[k] = uses_all_marks and leaves_walls and len(path) == mazes.moves[k] + 1
    return count


def canonical(walls: Bytes) -> bytes:
    """Return the same bytes for a maze and its seven mirrored and turned copies."""
    copies = [np.rot90(grid, k) for grid in (walls, walls.T) for k in range(4)]
    return min(copy.tobytes() for copy in copies)


def branching_share(walls: Flags) -> float:
    """Return the share of free cells that have three or four free neighbours."""
    free = ~np.pad(walls, ((0, 0), (1, 1), (1, 1)), constant_values=True)
    inner = free[:, 1:-1, 1:-1]
    neighbours = (
        free[:, :-2, 1:-1].astype(int) + free[:, 2:, 1:-1] + free[:, 1:-1, :-2] + free[:, 1:-1, 2:]
    )
    return float((neighbours[inner] >= 3).mean())


# --- tables -------------------------------------------------------------------------------------


def maze_rows(mazes: Mazes, counts: Sequence[int]) -> list[tuple[str, str]]:
    """Return the rows of the table of mazes: name and value."""
    side = mazes.walls.shape[1]
    wall_counts = mazes.walls.sum(axis=(1, 2))
    least_of_rule = 3 * side * side // 10
    fewest, most = min(counts), max(counts)
    median = np.median(np.array(counts, float))
    return [
        ("problems", f"{len(mazes):,}"),
        ("rows and columns", f"{side} x {side}"),
        ("share of walls: smallest, mean, largest", _range_of(mazes.walls.mean(axis=(1, 2)), 3)),
        (
            f"mazes with fewer than {least_of_rule} walls; the fewest",
            f"{(wall_counts < least_of_rule).sum()}; {wall_counts.min()}",
        ),
        ("the middle cell is a wall", f"{mazes.walls[:, side // 2, side // 2].mean():.0%}"),
        ("free cells with 3 or 4 free neighbours", f"{branching_share(mazes.walls):.0%}"),
        (
            "moves: fewest, median, most",
            f"{mazes.moves.min()}, {np.median(mazes.moves):.0f}, {mazes.moves.max()}",
        ),
        ("problems with one shortest path", f"{sum(count == 1 for count in counts)}"),
        (
            "shortest paths: fewest, median, most",
            f"{fewest:,}, {median:,.0f}, 10^{math.log10(most):.1f}",
        ),
    ]


def label_rows(mazes: Mazes) -> list[tuple[str, str]]:
    """Return the rows of the table of labels: which rules give them."""
    shape = mazes.walls.shape
    rows = [("labels that are shortest paths", f"{is_shortest(mazes.marks, mazes).sum():,}")]
    hits = []
    for order in itertools.permutations(MOVES):
        paths = first_optimal_paths(mazes.costs, mazes.starts, order)
        same = (marks_of_paths(paths, shape) == mazes.marks).all(axis=(1, 2)).sum()
        # In a small set, labels can follow several orders. Then that of the published set is first.
        hits.append((int(same), order == LABEL_ORDER, ", ".join(order)))
    hits.sort(reverse=True)
    rows += [(f"labels of the rule {order}", f"{same:,}") for same, _, order in hits[:2]]
    rows.append(("labels of each of the 22 other orders, at most", f"{hits[2][0]:,}"))
    # A label that is turned with its maze is the label of the turned maze under few symmetries.
    turned = []
    for transpose in (False, True):
        for turns in range(4):
            if transpose or turns:
                turned.append(_relabelled_share(mazes, transpose, turns))
    rows.append(
        (
            "labels of the rule that stay so under the 7 symmetries",
            ", ".join(f"{share:.0%}" for share in sorted(turned)),
        )
    )
    return rows


def _relabelled_share(mazes: Mazes, transpose: bool, turns: int) -> float:
    """Return how often the rule gives the turned label to the turned maze."""

    def turn(grids: Array) -> Array:
        grids = grids.swapaxes(1, 2) if transpose else grids
        return np.rot90(grids, turns, axes=(1, 2))

    is_start = np.zeros(mazes.walls.shape, bool)
    is_start[(np.arange(len(mazes)), *mazes.starts.T)] = True
    starts = np.argwhere(turn(is_start))[:, 1:]
    paths = first_optimal_paths(turn(mazes.costs), starts)
    marks = marks_of_paths(paths, mazes.walls.shape)
    return float((marks == turn(mazes.marks)).all(axis=(1, 2)).mean())


def score_rows(mazes: Mazes) -> list[tuple[str, str, str]]:
    """Return the rows of the table of scores: solver, exact match, share of shortest paths."""
    shape = mazes.walls.shape
    problems = list(zip(mazes.walls, mazes.starts, mazes.goals, strict=True))
    solutions: dict[str, Sequence[Ints] | Ints] = {
        f"the rule {', '.join(LABEL_ORDER)}": first_optimal_paths(mazes.costs, mazes.starts),
        "A* of mapdata": [astar(*problem, Movement(4)).path for problem in problems],
        "BFS of mapdata": [bfs(*problem, Movement(4)).path for problem in problems],
    }
    rows = []
    for name, paths in solutions.items():
        marks = marks_of_paths(paths, shape)
        exact = (marks == mazes.marks).all(axis=(1, 2)).mean()
        shortest = is_shortest(marks, mazes).mean()
        rows.append((name, f"{exact:.1%}", f"{shortest:.0%}"))
    return rows


def copy_lines(mazes_by_split: dict[str, Mazes]) -> list[str]:
    """Return sentences on mazes that occur more than once, up to symmetry."""
    keys = {split: [canonical(grid) for grid in m.walls] for split, m in mazes_by_split.items()}
    lines = [
        f"{split}: {len(found) - len(set(found))} of {len(found):,} mazes are copies in this split"
        for split, found in keys.items()
    ]
    in_train = sum(key in set(keys["train"]) for key in keys["test"])
    lines.append(f"test: {in_train} of {len(keys['test']):,} mazes are also in train")
    return [f"{line}, up to symmetry" for line in lines]


def compare_lines(mazes: Mazes, other: Mazes) -> list[str]:
    """Return a line for each quantity: medians of two sets, and whether they differ."""

    def logarithms(m: Mazes) -> Floats:
        return np.array([math.log10(count) for count in path_counts(m)])

    quantities = {
        "share of walls": (mazes.walls.mean(axis=(1, 2)), other.walls.mean(axis=(1, 2))),
        "moves": (mazes.moves, other.moves),
        "log10 of shortest paths": (logarithms(mazes), logarithms(other)),
    }
    lines = []
    for name, (first, second) in quantities.items():
        test = ks_2samp(first, second)
        lines.append(
            f"| {name} | {_range_of(first, 3)} | {_range_of(second, 3)} "
            f"| {test.statistic:.3f} | {test.pvalue:.2g} |"
        )
    weights = weights_of_pairs(other)
    mean = np.average(other.moves, weights=weights)
    count = weights.sum() ** 2 / (weights**2).sum()  # as many problems of equal weight (Kish)
    distance = weighted_distance(mazes.moves, other.moves, weights)
    lines.append(
        f"| moves, weighted as pairs | {_range_of(mazes.moves, 3)} | {other.moves.min():.3f}, "
        f"{mean:.3f}, {other.moves.max():.3f} | {distance:.3f} | of {count:.0f} problems |"
    )
    return lines


def weights_of_pairs(mazes: Mazes) -> Floats:
    """Return the weight of each problem, (N,), with which pairs of cells would be equally frequent.

    A set may draw the goal first, and then a start among the n cells that are far enough from it.
    Then a pair of goal and start is drawn with a probability in proportion to 1 / (n F) on a map of
    F free cells. Where both are drawn at once, and rare pairs that are far enough are kept, it is
    1 / F^2. The weight is the quotient, n / F.
    """
    is_far = mazes.costs >= mazes.moves.min()
    free_cells = (~mazes.walls).sum(axis=(1, 2))
    weights: Floats = is_far.sum(axis=(1, 2)) / free_cells
    return weights


def weighted_distance(first: Ints, second: Ints, weights: Floats) -> float:
    """Return the largest distance of the distributions of two samples, of which one has weights.

    With equal weights it is the statistic of Kolmogorov and Smirnov.
    """
    values = np.unique(np.concatenate([first, second]))
    share = (first[:, None] <= values).mean(axis=0)
    weighted_share = np.average(second[:, None] <= values, axis=0, weights=weights)
    return float(abs(share - weighted_share).max())


def _range_of(values: Array, digits: int) -> str:
    """Return the smallest, mean and largest of some values as text."""
    return ", ".join(f"{value:.{digits}f}" for value in (values.min(), values.mean(), values.max()))


def print_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table of Markdown."""
    for row in (header, ["---"] * len(header), *rows):
        print(f"| {' | '.join(row)} |")
    print(flush=True)


def main(arguments: list[str] | None = None) -> None:
    """Print the tables of the folder of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="of the set")
    parser.add_argument("--beside", type=Path, metavar="FOLDER", help="of a set to compare it with")
    options = parser.parse_args(arguments)
    for file in sorted(options.folder.rglob("*")):
        if file.suffix in (".csv", ".npy"):
            digest = hashlib.sha256(file.read_bytes()).hexdigest()
            print(f"{file.relative_to(options.folder)}: SHA-256 {digest}")
    print()
    mazes = {split: read_mazes(options.folder, split) for split in SPLITS}
    columns = [maze_rows(each, path_counts(each)) + label_rows(each) for each in mazes.values()]
    names = [[name, *values] for name, *values in _side_by_side(columns)]
    print_table(("", *SPLITS), names)
    for split, each in mazes.items():
        print_table((f"{split}: solver", "exact match", "shortest paths"), score_rows(each))
    print("\n".join(copy_lines(mazes)), "\n")
    if options.beside is not None:
        other = {split: read_mazes(options.beside, split) for split in SPLITS}
        for split in SPLITS:
            header = (f"{split}: smallest, mean, largest", "this set", "beside", "D", "p")
            for row in (header, ["---"] * len(header)):
                print(f"| {' | '.join(row)} |")
            print("\n".join(compare_lines(mazes[split], other[split])), "\n")


def _side_by_side(columns: Sequence[Sequence[tuple[str, str]]]) -> list[list[str]]:
    """Return rows of a name and the values of all columns.

    Rows that only some columns have, such as the best rules, are taken from the first column.
    """
    by_name = [dict(column) for column in columns]
    return [[name, *(column.get(name, "") for column in by_name)] for name, _ in columns[0]]


if __name__ == "__main__":
    main()
