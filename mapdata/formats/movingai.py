"""MovingAI benchmark maps (.map) and scenarios (.scen), in and out; the check of published lengths.

Source: N. Sturtevant, "Benchmarks for Grid-Based Pathfinding", 2012, https://movingai.com/benchmarks/formats.html.

A move joins two cells of one world: land (`.`, `G` and swamp `S`) or water (`W`); `@`, `O`, `T` are
blocked. So land is
one binary grid and water another, and both are exact: nothing leads from one to the other. A
dataset holds the land; `check_scen` takes the world that a problem starts in. The benchmark's rule:
8-connected, a diagonal costs sqrt 2 and needs both orthogonal cells passable.

A line of a .scen: bucket, map, width, height, start x, start y, goal x, goal y, optimal length; x
is the column. Files of the first version have spaces, no line `version` and no sizes. Length 0
between different cells means no path. Some copies in the wild end with an empty line and a
citation.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from mapdata.arrays import Bytes
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import LIMITS, FormatError, Limits, files_of, read_text, split_of
from mapdata.formats.registry import Format
from mapdata.search.api import search_batch
from mapdata.search.lattice import MAX_CELLS
from mapdata.shards.root import Root
from mapdata.spec import MAX_ROOMS, SPLITS, Movement

Cell: TypeAlias = tuple[int, int]

MOVEMENT = Movement(8)
"""The benchmark's rule."""

LAND, WATER, BLOCKED = ".GS", "W", "@OT"


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
    size: tuple[int, int] | None
    start: Cell
    goal: Cell
    length: str
    line: int
    unit: float


def read_terrain(path: str | Path, limits: Limits = LIMITS) -> Bytes:
    """Return the letters of a .map file, (H, W) uint8 of ASCII codes. Text after the rows is
    ignored.

    Raises:
        FormatError: no sound map; the message says which line.
    """
    path = Path(path)
    lines = read_text(path, limits).split("\n")
    sides: dict[str, int] = {}
    for number, line in enumerate(lines[:20]):
        words = line.lower().split()
        if words == ["map"]:
            break
        if (
            len(words) == 2
            and words[0] in ("height", "width")
            and words[1].isascii()
            and words[1].isdigit()
        ):
            sides[words[0]] = int(words[1][:10])
        elif words and words[0] != "type":
            raise FormatError(
                f"{path}: line {number + 1} is {line[:40]!r}, expected type, height, width or map"
            )
    else:
        raise FormatError(f"{path}: no line 'map' near the top, expected a MovingAI map")
    rows, columns = sides.get("height", 0), sides.get("width", 0)
    if not 1 <= rows * columns <= limits.pixels:
        raise FormatError(
            f"{path}: height {rows} and width {columns}, expected 1 to {limits.pixels} cells"
        )
    body = [line.rstrip(" \t") for line in lines[number + 1 : number + 1 + rows]]
    for k in range(rows):
        length = len(body[k]) if k < len(body) else -1
        if length != columns:
            what = f"{length} letters" if length >= 0 else "missing"
            raise FormatError(
                f"{path}: row {k} is {what}, expected {columns} letters ({rows} rows)"
            )
    text = "".join(body)
    unknown = set(text) - set(LAND + WATER + BLOCKED)
    if unknown:
        raise FormatError(
            f"{path}: unknown terrain {sorted(unknown)[0]!r}, expected one of "
            f"{LAND + WATER + BLOCKED}"
        )
    return np.frombuffer(text.encode("ascii"), np.uint8).reshape(rows, columns)


def world(terrain: Bytes, letters: str = LAND) -> Bytes:
    """Return a grid, (H, W) uint8, in which only cells of these letters are free."""
    return np.asarray(~np.isin(terrain, np.frombuffer(letters.encode(), np.uint8)), np.uint8)


def read_scen(path: str | Path, limits: Limits = LIMITS) -> list[Problem]:
    """Return the problems of a .scen file, of either version.

    Raises:
        FormatError: a line that cannot be read; the message says which.
    """
    path = Path(path)
    problems: list[Problem] = []
    after_gap = False
    for number, line in enumerate(read_text(path, limits).split("\n"), 1):
        words = line.split()
        if not words or (words[0] == "version" and not problems):
            after_gap = not words
            continue
        if after_gap and problems and not words[0].isdecimal():
            break  # a citation
        if len(words) == 8 or len(words) < 7:
            raise FormatError(
                f"{path}: line {number} has {len(words)} fields, expected 9 (or 7 in the old form)"
            )
        numeric = 5 if len(words) == 7 else 7  # a name with spaces leaves more than 9 words
        try:
            values = [int(word) for word in (words[0], *words[-numeric:-1])]
            length = Decimal(words[-1])
        except (ValueError, InvalidOperation):
            raise FormatError(
                f"{path}: line {number} is {line[:60]!r}, expected numbers around the map"
            ) from None
        if (
            not length.is_finite()
            or length < 0
            or min(values) < 0
            or int(length.as_tuple().exponent) > 9
        ):
            raise FormatError(
                f"{path}: line {number}: expected numbers of at least 0, as people write them"
            )
        x, y, goal_x, goal_y = values[-4:]
        size = (values[2], values[1]) if numeric == 7 else None
        name = " ".join(words[1:-numeric])
        problems.append(
            Problem(values[0], name, size, (y, x), (goal_y, goal_x), words[-1], number, math.nan)
        )
    texts = [problem.length for problem in problems]
    fixed = len({len(text.partition(".")[2]) for text in texts}) == 1 and any(
        re.search(r"\.\d*0$", t) for t in texts
    )
    return [problem._replace(unit=_unit(problem.length, fixed)) for problem in problems]


def _unit(length: str, fixed: bool) -> float:
    """Return the unit of the last digit of a printed length.

    Args:
        length: as printed.
        fixed: all lengths of the file have equally many decimals, last zeros included, as in
            459.10. Else they have six significant digits, so that 440.72 stands for 440.720, or all
            digits of a double.
    """
    number = Decimal(length)
    exponent = int(number.as_tuple().exponent)
    return float(10.0 ** (exponent if fixed else min(exponent, number.adjusted() - 5)))


@dataclass
class ScenReport:
    """What a check of one .scen file found.

    Attributes:
        path: the file.
        total: number of problems.
        agreed: how many lengths our A* reproduces, as exactly as they are printed.
        disagreements: a line for each other problem.
    """

    path: Path
    total: int = 0
    agreed: int = 0
    disagreements: list[str] = field(default_factory=list)


def check_scen(
    path: str | Path, maps: str | Path | None = None, limits: Limits = LIMITS
) -> ScenReport:
    """Solve every problem of a .scen by A* under the benchmark's rule; compare with the printed
    optimal lengths.

    Args:
        path: the .scen file.
        maps: folder of the maps; default beside the .scen.
        limits: of what is read.

    Raises:
        FormatError: a file that cannot be read, a map that is missing or has another size than the
            .scen says.
    """
    path = Path(path)
    report, terrains = ScenReport(path), dict[str, Bytes]()
    groups: dict[tuple[str, str], list[Problem]] = {}
    all_problems = read_scen(path, limits)
    if not all_problems:
        raise FormatError(f"{path}: holds no problems")
    for problem in all_problems:
        if problem.map not in terrains:
            terrains[problem.map] = read_terrain(find_map(problem.map, path, maps), limits)
        terrain = terrains[problem.map]
        _check_cells(problem, terrain, path)
        letter = chr(terrain[problem.start])
        groups.setdefault((problem.map, WATER if letter == WATER else LAND), []).append(problem)
    for (name, letters), problems in groups.items():
        for problem, found in zip(
            problems, _solve(world(terrains[name], letters), problems), strict=True
        ):
            report.total += 1
            if agrees(problem, found):
                report.agreed += 1
                continue
            ours = "no path" if found < 0 else f"{found:.8f}"
            report.disagreements.append(
                f"{path}: line {problem.line}: {problem.start} to {problem.goal}: says "
                f"{problem.length}, found {ours}"
            )
    return report


def _check_cells(problem: Problem, terrain: Bytes, path: Path) -> None:
    if problem.size not in (None, terrain.shape):
        raise FormatError(
            f"{path}: line {problem.line} says {problem.size}, the map has {terrain.shape} rows, "
            "columns"
        )
    for row, column in (problem.start, problem.goal):
        if row >= terrain.shape[0] or column >= terrain.shape[1]:
            raise FormatError(
                f"{path}: line {problem.line}: {(row, column)} is outside the map of "
                f"{terrain.shape}"
            )
    if terrain.size > MAX_CELLS:
        raise FormatError(f"{path}: the map has {terrain.size} cells, expected at most {MAX_CELLS}")


def _solve(grid: Bytes, problems: list[Problem]) -> list[float]:
    """Return the optimal length of each problem, -1 without a path (an end may stand on a blocked
    cell).
    """
    starts = np.array([problem.start for problem in problems])
    goals = np.array([problem.goal for problem in problems])
    costs = np.full(len(problems), -1.0)
    open_ends = (grid[tuple(starts.T)] == 0) & (grid[tuple(goals.T)] == 0)
    if open_ends.any():
        costs[open_ends] = search_batch(
            "astar", grid, starts[open_ends], goals[open_ends], MOVEMENT
        ).cost
    return [float(cost) for cost in costs]


def agrees(problem: Problem, found: float) -> bool:
    """Return whether an optimal length (-1: no path) is what a .scen prints, as exactly as it
    prints it.

    The benchmark's own files count a diagonal as 1.414213562: their last decimals are a bit less.
    """
    stated = float(problem.length)
    if found < 0:
        return stated == 0 and problem.start != problem.goal
    if stated == 0:
        return problem.start == problem.goal
    least = found * (1.414213562 / math.sqrt(2))  # if all steps are diagonal
    slack = 0.5 * problem.unit * (1 + 1e-9) + 1e-12 * found
    return least - slack <= stated <= found + slack


def find_map(name: str, scen: Path, maps: str | Path | None = None) -> Path:
    """Return the file of the map that a .scen names: under ``maps``, or beside the .scen, and
    nowhere else.

    Raises:
        FormatError: there is none; the message says where it was looked for.
    """
    folder = scen.parent if maps is None else Path(maps)
    parts = [part for part in name.replace("\\", "/").split("/") if part not in ("", ".")]
    tried = []
    for start in range(len(parts)):
        candidate = folder.joinpath(*parts[start:])
        if ".." in parts[start:]:
            continue
        tried.append(candidate)
        if candidate.is_file() and candidate.resolve().is_relative_to(folder.resolve()):
            return candidate
    looked = f"{tried[-1]}" if tried else f"a name inside {folder}"
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
            their first appearance, and only maps that a .scen names. A .scen file as source says so
            too.
        maps: folder of the maps that .scen files name.
        seed_points: how many of these end points at most.
    """
    found = Collection(movement=MOVEMENT)
    folder = source if source.is_dir() else source.parent
    if scen or source.suffix.lower() == ".scen":
        points = _end_points(source, limits, maps, found)
    else:
        points = {path: [] for path in files_of(source, (".map",), limits, found.left_out)}
    water = 0
    for path, ends in points.items():
        with found.leaving_out(path):
            terrain = read_terrain(path, limits)
            grid = world(terrain)
            water += int((terrain == ord(WATER)).sum())
            rows, columns = grid.shape
            free = [
                cell
                for cell in dict.fromkeys(ends)
                if cell[0] < rows and cell[1] < columns and not grid[cell]
            ]
            split = split_of(path, folder) if path.is_relative_to(folder) else None
            chosen = np.array(free[:seed_points], np.int64).reshape(-1, 2)
            found.maps.append(
                ForeignMap(str(path), grid, split, seed_points=chosen, rooms_known=len(chosen) > 1)
            )
    if water:
        found.notes.append(
            f"{water} cells of water (W) are occupied: nothing leads there from land"
        )
    return found


def _end_points(
    source: Path, limits: Limits, maps: str | Path | None, found: Collection
) -> dict[Path, list[Cell]]:
    """Return the end points of the problems of each map that a .scen names, in the order of their
    appearance.
    """
    if source.suffix.lower() == ".map":
        raise FormatError(
            f"{source}: a map has no end points, expected a .scen file or a folder with some"
        )
    points: dict[Path, list[Cell]] = {}
    for path in files_of(source, (".scen",), limits, found.left_out):
        with found.leaving_out(path):
            for problem in read_scen(path, limits):
                points.setdefault(find_map(problem.map, path, maps), []).extend(
                    (problem.start, problem.goal)
                )
    return points


def write(target: Path, root: Root, progress: bool) -> list[str]:
    """Write each map as ``<split>/map<i>.map`` with ``<split>/map<i>.map.scen`` beside it: all its
    room pairs.

    Lengths are those of the benchmark's rule, whatever the movement of the dataset; pairs without a
    path have 0.

    Returns:
        Notes for the user.
    """
    for labels in root.labels(progress=progress):
        maps = labels.maps
        rows, columns = maps.occupancy.shape[1:]
        for k, grid in enumerate(maps.occupancy):
            folder, name = target / SPLITS[maps.split[k]], f"map{maps.index[k]}.map"
            folder.mkdir(parents=True, exist_ok=True)
            lines = np.where(grid, ord("@"), ord(".")).astype(np.uint8)
            body = "\n".join(line.tobytes().decode() for line in lines)
            (folder / name).write_text(
                f"type octile\nheight {rows}\nwidth {columns}\nmap\n{body}\n", newline="\n"
            )
            (folder / f"{name}.scen").write_text(
                _scen(name, grid, maps.seed_points[k, : maps.rooms[k]]), newline="\n"
            )
    return [
        "lengths in the .scen files are 8-connected without corner cutting, the benchmark's rule"
    ]


def _scen(name: str, grid: Bytes, seed_points: npt.NDArray[np.int64]) -> str:
    """Return the text of a .scen with all pairs of ``seed_points``, (n, 2)."""
    first, second = np.triu_indices(len(seed_points), 1)
    lines = ["version 1"]
    if len(first):
        costs = search_batch("astar", grid, seed_points[first], seed_points[second], MOVEMENT).cost
        for (row, column), (goal_row, goal_column), cost in zip(
            seed_points[first].tolist(), seed_points[second].tolist(), costs.tolist(), strict=True
        ):
            length = max(cost, 0.0)
            values = (math.floor(length / 4), name, grid.shape[1], grid.shape[0])
            lines.append(
                "\t".join(map(str, (*values, column, row, goal_column, goal_row, f"{length:.8f}")))
            )
    return "\n".join(lines) + "\n"


FORMAT = Format("movingai", (".map", ".scen"), read, write)
