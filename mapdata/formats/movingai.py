"""MovingAI benchmark maps (.map) and scenarios (.scen), in and out; the check of published lengths.

Source: N. Sturtevant, "Benchmarks for Grid-Based Pathfinding", 2012,
https://movingai.com/benchmarks/formats.html.

A move joins two cells of land (`.`, `G` and swamp `S`), two of water (`W`) or two of trees (`T`);
`@` and `O` are blocked. So land, water and trees are three binary grids, and all are exact: nothing
leads from one to another. A dataset holds the land; `check_scen` takes the one that a problem
starts in. The benchmark's rule: 8-connected, a diagonal costs sqrt 2 and needs both orthogonal
cells passable.

A line of a .scen: bucket, map, width, height, start x, start y, goal x, goal y, optimal length; x
is the column. Files of the first version have spaces, no line `version` and no sizes. Length 0
between different cells means no path. Some copies in the wild end with an empty line and a
citation.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path, PureWindowsPath
from typing import NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.checks import check_count
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import LIMITS, Limits, files_of, map_files, read_text, split_of
from mapdata.formats.registry import Format
from mapdata.limits import MAX_ROOMS, Cell, Size
from mapdata.movement import Movement
from mapdata.npy import FormatError
from mapdata.problems.problem_set import ProblemSet
from mapdata.search.api import search_batch, solve_batch
from mapdata.search.lattice import ASTAR
from mapdata.shards.files import StrPath
from mapdata.shards.locations import local_path
from mapdata.shards.root import Root
from mapdata.shards.workers import bar

MOVEMENT = Movement(8)
"""The benchmark's rule."""

LAND = ".GS"
BLOCKED = "@O"

_LINE = re.compile(
    r"(\d{1,9}) (.+?)(?: (?P<width>\d{1,9}) (\d{1,9}))?"  # bucket, map and its size
    r" (\d{1,9}) (\d{1,9}) (\d{1,9}) (\d{1,9}) (\d+(?:\.\d*)?)",  # start, goal, length
    re.ASCII,
)
"""A line of a .scen, its fields with one space between them."""

_ISLANDS = {"W": "water", "T": "trees"}
"""What can be walked on, but neither entered from land nor left for it."""


class Problem(NamedTuple):
    """A line of a .scen, with cells as (row, col).

    Attributes:
        bucket: length // 4 in the benchmark's own files.
        map: the map's name as the file says it.
        size: (rows, columns) of the map, None in files of the first version.
        start, goal: cells.
        length: optimal length as printed; 0 for different cells: no path.
        line: number of the line.
        unit: of the last digit that its file prints.
    """

    bucket: int
    map: str
    size: Size | None
    start: Cell
    goal: Cell
    length: str
    line: int
    unit: float


def read_terrain(path: StrPath, limits: Limits = LIMITS) -> Bytes:
    """Return the letters of a .map file, (H, W) uint8 of ASCII codes; text after them is ignored.

    Raises:
        FormatError: no sound map; the message says which line.
    """
    path = Path(path)
    lines = read_text(path, limits).split("\n")
    first, sides = _map_header(path, lines)
    rows = sides.get("height", 0)
    columns = sides.get("width", 0)
    if not 1 <= rows * columns <= limits.pixels:
        raise FormatError(
            f"{path}: height {rows} and width {columns}, expected 1 to {limits.pixels} cells"
        )
    body = [line.rstrip(" \t") for line in lines[first : first + rows]]
    expected = f"{columns} letters"
    for k in range(rows):
        what = f"{len(body[k])} letters" if k < len(body) else "missing"
        if what != expected:
            raise FormatError(f"{path}: row {k} is {what}, expected {expected} ({rows} rows)")
    text = "".join(body)
    known = LAND + "".join(_ISLANDS) + BLOCKED
    unknown = set(text) - set(known)
    if unknown:
        raise FormatError(
            f"{path}: unknown terrain {sorted(unknown)[0]!r}, expected one of {known}"
        )
    return np.frombuffer(text.encode("ascii"), np.uint8).reshape(rows, columns)


def _map_header(path: Path, lines: list[str]) -> tuple[int, dict[str, int]]:
    """Return the number of the first row's line, from 0, and the sides that the lines above state.

    Raises:
        FormatError: another line among them, or no line "map" among the first 20.
    """
    sides: dict[str, int] = {}
    for number, line in enumerate(lines[:20]):
        words = " ".join(line.lower().split())
        if words == "map":
            return number + 1, sides
        match = re.fullmatch(r"(height|width) ([0-9]{1,10})", words)
        if match is not None:
            sides[match[1]] = int(match[2])
        elif words and not words.startswith("type"):
            raise FormatError(
                f"{path}: line {number + 1} is {line[:40]!r}, expected type, height, width or map"
            )
    raise FormatError(f"{path}: no line 'map' near the top, expected a MovingAI map")


def terrain_grid(terrain: Bytes, letters: str = LAND) -> Bytes:
    """Return a grid, (H, W) uint8, in which only cells of these letters are free."""
    return np.asarray(~np.isin(terrain, list(letters.encode())), np.uint8)


def read_scen(path: StrPath, limits: Limits = LIMITS) -> list[Problem]:
    """Return the problems of a .scen file, of either version.

    Raises:
        FormatError: a line that cannot be read; the message says which.
    """
    path = Path(path)
    problems: list[Problem] = []
    lines = read_text(path, limits).split("\n")
    for number, line in enumerate(lines, 1):
        words = line.split()
        is_version = words[:1] == ["version"] and not problems
        if not words or is_version:
            continue
        is_after_gap = not lines[number - 2].strip()
        if problems and is_after_gap and not words[0].isdecimal():
            break  # a citation ends the file
        problems.append(_problem(line, number, path))
    decimals = [problem.length.partition(".")[2] for problem in problems]
    is_fixed = "" not in decimals and len(set(map(len, decimals))) == 1
    return [problem._replace(unit=_unit(problem.length, is_fixed)) for problem in problems]


def _problem(line: str, number: int, path: Path) -> Problem:
    """Return the problem of a line; its unit is not known before all lines are read."""
    words = line.split()
    match = _LINE.fullmatch(" ".join(words))
    if match is None or len(words) == 8:  # of 8, the width would be part of the name
        raise FormatError(
            f"{path}: line {number} has {len(words)} fields, {line[:60]!r}, expected numbers of at "
            "least 0 around the map, in all 9 fields (or 7 in the old form)"
        )
    bucket, name, *sides, length = match.groups()
    columns, rows, x, y, goal_x, goal_y = [int(side or 0) for side in sides]
    return Problem(
        bucket=int(bucket),
        map=name,
        size=(rows, columns) if match["width"] else None,
        start=(y, x),
        goal=(goal_y, goal_x),
        length=length,
        line=number,
        unit=math.nan,
    )


def _unit(length: str, is_fixed: bool) -> float:
    """Return the unit of the last digit of a printed length.

    Args:
        length: as printed.
        is_fixed: all lengths of the file have equally many decimals, as in 459.10. Else they have
            six significant digits, so that 440.72 stands for 440.720, or all digits of a double.
    """
    whole, _, decimals = length.partition(".")
    places = len(decimals)
    if not is_fixed:
        places = max(places, 6 - len(whole))
    return 10.0**-places


@dataclass
class ScenReport:
    """What a check of one .scen file found.

    Attributes:
        total: number of problems that were looked at.
        in_file: number of problems in the file.
        has_lengths: the file gives lengths. Scenarios of several agents (MAPF) often do not: all
            of theirs are 0, although there are paths.
        disagreements: a line for each length that our A* does not reproduce as exactly as printed.
        solved: the problems that have a path, each with its grid.
    """

    total: int
    in_file: int
    has_lengths: bool = True
    disagreements: list[str] = field(default_factory=list)
    solved: list[tuple[Bytes, Problem]] = field(default_factory=list)

    @property
    def agreed(self) -> int:
        """How many lengths our A* reproduces."""
        return self.total - len(self.disagreements)


_AT_A_TIME = 256
"""Problems that are solved between two steps of a progress bar."""


def check_scen(
    path: StrPath,
    maps: StrPath | None = None,
    limits: Limits = LIMITS,
    count: int | None = None,
) -> ScenReport:
    """Compare the optimal lengths of a .scen with those that A* finds under the benchmark's rule.

    Args:
        path: the .scen file.
        maps: folder of the maps; default beside the .scen.
        limits: of what is read, and whether a progress bar shows it.
        count: how many problems at most, evenly spread over the file; all without.

    Raises:
        FormatError: a file that cannot be read, a map that is missing or has another size than the
            .scen says.
    """
    path = local_path(path)
    terrains = {}
    # problems of one map and one type of terrain are solved together
    groups: dict[tuple[str, str], list[Problem]] = {}
    all_problems = read_scen(path, limits)
    if not all_problems:
        raise FormatError(f"{path}: holds no problems")
    in_file = len(all_problems)
    are_zero = all(float(problem.length) == 0 for problem in all_problems)
    if count is not None:
        all_problems = all_problems[:: _step(in_file, count)]
    for problem in all_problems:
        if problem.map not in terrains:
            terrains[problem.map] = read_terrain(find_map(problem.map, path, maps), limits)
        terrain = terrains[problem.map]
        _check_cells(problem, terrain.shape, path)
        letter = chr(terrain[problem.start])
        letters = letter if letter in _ISLANDS else LAND
        groups.setdefault((problem.map, letters), []).append(problem)
    report = ScenReport(len(all_problems), in_file)
    is_long = report.total > _AT_A_TIME
    with bar(limits.progress and is_long, report.total, unit=" problems") as advance:
        for (name, letters), problems in groups.items():
            grid = terrain_grid(terrains[name], letters)
            for first in range(0, len(problems), _AT_A_TIME):
                part = problems[first : first + _AT_A_TIME]
                starts = [problem.start for problem in part]
                goals = [problem.goal for problem in part]
                # an end on a blocked cell is a problem without a path here
                costs = solve_batch(ASTAR, grid, starts, goals, MOVEMENT, most=1).cost
                for problem, found in zip(part, costs, strict=True):
                    if found > 0:
                        report.solved.append((grid, problem))
                    if not agrees(problem, found):
                        ours = "no path" if found < 0 else f"{found:.8f}"
                        report.disagreements.append(
                            f"{path}: line {problem.line}: {problem.start} to {problem.goal}: "
                            f"says {problem.length}, found {ours}"
                        )
                advance(len(part))
    if are_zero and report.solved:
        # 0 is no path, but there are some: nobody has computed these lengths
        report.has_lengths = False
        report.disagreements.clear()
    return report


def _step(total: int, count: int) -> int:
    """Return the least k for which every k-th of ``total`` problems are at most ``count``.

    Raises:
        ValueError: ``count`` is not at least 1.
    """
    return -(-total // check_count("count", count))


def problems(
    source: Path, limits: Limits = LIMITS, *, count: int | None = None, maps: Path | None = None
) -> ProblemSet:
    """Return the problems of a .scen, to compare planners on.

    Those without a path are left out, and those from a cell to itself. The description says how
    many of the file there are.

    Args:
        source: the .scen file.
        limits: of what is read, and whether a progress bar shows it.
        count: how many problems at most, evenly spread over the file; all without.
        maps: folder of the maps; default beside the .scen.

    Raises:
        FormatError: what `check_scen` refuses; a length that our A* does not reproduce; no problem
            has a path.
        ValueError: maps of several sizes.
    """
    report = check_scen(source, maps, limits, count)
    if report.disagreements:
        raise FormatError(report.disagreements[0])
    if not report.solved:
        raise FormatError(f"{source}: none of its {report.total} problems has a path")
    grids = [grid for grid, _ in report.solved]
    shared = grids[0]
    ends = np.array([(problem.start, problem.goal) for _, problem in report.solved])
    return ProblemSet(
        # mostly all problems are on one map, which is kept once
        np.broadcast_to(shared, (len(grids), *shared.shape))
        if all(grid is shared for grid in grids)
        else np.stack(grids),
        ends[:, 0],
        ends[:, 1],
        MOVEMENT,
        _description(source, report, count),
    )


def _description(source: Path, report: ScenReport, count: int | None) -> str:
    """Return in words which problems of a .scen were taken, and what is known of their lengths."""
    text = f"{len(report.solved)} problems of {source}"
    if len(report.solved) != report.in_file:
        text = f"{len(report.solved)} of {report.in_file} problems of {source}"
    step = 1 if count is None else _step(report.in_file, count)
    if step > 1:
        text += f", one in {step}"
    left_out = report.total - len(report.solved)
    if left_out:
        text += f", {left_out} without a path or a move left out"
    return text + (", whose lengths are ours" if report.has_lengths else ", which gives no lengths")


def _check_cells(problem: Problem, shape: Size, path: Path) -> None:
    """Refuse a problem that does not fit on its map."""
    if problem.size not in (None, shape):
        raise FormatError(
            f"{path}: line {problem.line} says {problem.size}, the map has {shape} rows, columns"
        )
    for cell in (problem.start, problem.goal):
        if np.greater_equal(cell, shape).any():
            raise FormatError(f"{path}: line {problem.line}: {cell} is outside the map of {shape}")


def agrees(problem: Problem, found: float) -> bool:
    """Return whether an optimal length (-1: no path) is what a .scen prints, up to its last digit.

    The benchmark's own files count a diagonal as 1.414213562, and those of six significant digits
    as 1.41421354, sqrt 2 in float32: their last decimals are a bit less.
    """
    stated = float(problem.length)
    if found < 0:
        return stated == 0 and problem.start != problem.goal
    if stated == 0:
        return problem.start == problem.goal
    is_short = len(problem.length.replace(".", "")) <= 6
    diagonal = 1.41421354 if is_short else 1.414213562
    least = found * (diagonal / math.sqrt(2))  # if all steps are diagonal
    # half a unit for rounding, a bit more for the errors of floating point
    slack = 0.5 * problem.unit * (1 + 1e-9) + 1e-12 * found
    return least - slack <= stated <= found + slack


def find_map(name: str, scen: Path, maps: StrPath | None = None) -> Path:
    """Return the map that a .scen names: a file below ``maps`` or below the .scen's own folder.

    A name with folders that are not there is looked for without the first of them.

    Raises:
        FormatError: there is none; the message says where it was looked for.
    """
    folder = scen.parent if maps is None else Path(maps)
    parts = PureWindowsPath(name).parts  # separated by / or by \
    looked = f"a name inside {folder}"
    for start in range(len(parts)):
        if ".." in parts[start:]:
            continue
        candidate = folder.joinpath(*parts[start:])
        looked = str(candidate)
        # a link may still lead out of the folder
        if candidate.is_file() and candidate.resolve().is_relative_to(folder.resolve()):
            return candidate
    advice = "--maps DIR, or --movingai.maps DIR of an import, says where maps are"
    raise FormatError(f"{scen}: its map {name!r} is missing: looked for {looked}; {advice}")


def read(
    source: Path,
    limits: Limits = LIMITS,
    *,
    scen: bool = False,
    maps: Path | str | None = None,
    seed_points: int = MAX_ROOMS,
) -> Collection:
    """Read a .map or .scen file, or all below a folder.

    Args:
        source: file or folder.
        limits: of what is read.
        scen: take the end points of the problems in .scen files as seed points, in the order of
            their first appearance, and only maps that a .scen names; always so if the source is a
            .scen file.
        maps: folder of the maps that .scen files name.
        seed_points: how many of these end points at most.
    """
    found = Collection(movement=MOVEMENT)
    if scen or source.suffix.lower() == ".scen":
        points = _end_points(source, limits, maps, found)
    else:
        points = ((path, []) for path in files_of(source, (".map",), limits, found))
    cells = np.zeros(128, np.int64)  # of each letter, by its code
    for path, ends in points:
        with found.leaving_out(path):
            terrain = read_terrain(path, limits)
            grid = terrain_grid(terrain)
            cells += np.bincount(terrain.ravel(), minlength=len(cells))
            free = [cell for cell in dict.fromkeys(ends) if not grid[cell]]  # each once
            chosen = np.array(free[:seed_points], np.int64).reshape(-1, 2)
            found.maps.append(
                ForeignMap(
                    str(path),
                    grid,
                    split_of(path, source),
                    seed_points=chosen,
                    rooms_known=len(chosen) > 1,  # else the import draws the others
                )
            )
    for letter, name in _ISLANDS.items():
        closed = cells[ord(letter)]
        if closed:
            what = f"{closed} cells of {name} ({letter}) are occupied"
            found.notes.append(f"{what}: nothing leads there from land")
    return found


def _end_points(
    source: Path, limits: Limits, maps: StrPath | None, found: Collection
) -> Iterable[tuple[Path, list[Cell]]]:
    """Return each map that a .scen names, with the end points of its problems in their order."""
    if source.suffix.lower() == ".map":
        raise FormatError(
            f"{source}: a map has no end points, expected a .scen file or a folder with some"
        )
    points: dict[Path, list[Cell]] = {}
    shapes = {}
    for path in files_of(source, (".scen",), limits, found):
        with found.leaving_out(path):
            for problem in read_scen(path, limits):
                where = find_map(problem.map, path, maps)
                if where not in shapes:
                    shapes[where] = read_terrain(where, limits).shape
                _check_cells(problem, shapes[where], path)
                points.setdefault(where, []).extend([problem.start, problem.goal])
    return points.items()


def write(target: Path, root: Root, progress: bool) -> list[str]:
    """Write each map as ``<split>/map<i>.map``, and all pairs of its rooms as a .scen beside it.

    Lengths are those of the benchmark's rule, whatever the movement of the dataset; pairs without a
    path have 0.

    Returns:
        Notes for the user.
    """
    rows, columns = root.map_size
    for path, grid, seed_points in map_files(target, root, progress):
        letters = np.frombuffer(b".@", np.uint8)[grid]
        body = "\n".join(row.tobytes().decode() for row in letters)
        text = f"type octile\nheight {rows}\nwidth {columns}\nmap\n{body}\n"
        path.with_suffix(".map").write_text(text, newline="\n")
        scen = _scen(f"{path.name}.map", grid, seed_points)
        path.with_suffix(".map.scen").write_text(scen, newline="\n")
    return [
        "lengths in the .scen files are 8-connected without corner cutting, the benchmark's rule"
    ]


def _scen(name: str, grid: Bytes, seed_points: Ints) -> str:
    """Return the text of a .scen with all pairs of ``seed_points``, (n, 2)."""
    height, width = grid.shape
    starts, goals = seed_points[np.stack(np.triu_indices(len(seed_points), 1))].tolist()
    costs = search_batch("astar", grid, starts, goals, MOVEMENT).cost.tolist()
    lines = ["version 1"]
    for (y, x), (goal_y, goal_x), cost in zip(starts, goals, costs, strict=True):
        length = max(cost, 0.0)  # 0 stands for no path
        cells = f"{x}\t{y}\t{goal_x}\t{goal_y}"
        lines.append(f"{int(length / 4)}\t{name}\t{width}\t{height}\t{cells}\t{length:.8f}")
    return "\n".join(lines) + "\n"


FORMAT = Format("movingai", (".map", ".scen"), read, write, problems)
