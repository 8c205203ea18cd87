"""MovingAI benchmark maps (.map) and scenarios (.scen), in and out; the check of published lengths.

Source: N. Sturtevant, "Benchmarks for Grid-Based Pathfinding", 2012,
https://movingai.com/benchmarks/formats.html.

A move joins two cells of land (`.`, `G` and swamp `S`), two of water (`W`) or two of trees (`T`);
`@` and `O` are blocked. No move leads from land to water or trees, so each of the three is an exact
binary grid of its own. A dataset holds the land; `check_scen` takes the terrain that a problem
starts in. The benchmark's rule: 8-connected, a diagonal costs sqrt 2 and needs both orthogonal
cells passable. Letters have no costs in the benchmark. An import may give them costs; then moves
join all cells that have one.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path, PureWindowsPath
from typing import Literal

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import (
    LIMITS,
    Limits,
    checked_inside,
    files_with_endings,
    joint_name,
    maps_to_write,
    read_text,
    sampling_step,
    split_from_folders,
)
from mapdata.formats.movingai_scen import Problem, agrees, read_scen
from mapdata.formats.registry import Format
from mapdata.limits import MAX_CELL_COST, MAX_ROOMS, Cell, Size
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
"""The letters of cells that are free in a dataset."""

BLOCKED = "@O"
"""The letters of cells on which no move starts or ends."""


_ISLANDS = {"W": "water", "T": "trees"}
"""Terrain by letter that can be crossed, but neither entered from land nor left to land."""

_OTHER_TYPES = {
    "type octile-corner": "whose map gives the corners of cells",
    "type raw": "whose map gives numbers",
}
"""Types of maps of the benchmark's own program that hold no letter for each cell, by their line."""

_LAND_COST = 1
"""The cost of a letter of land to which an import with costs gives none."""


def read_terrain(path: StrPath, limits: Limits = LIMITS) -> Bytes:
    """Return the letters of a .map file, (H, W) uint8 of ASCII codes; text after them is ignored.

    Raises:
        FormatError: no sound map; the message says which line.
    """
    path = Path(path)
    lines = read_text(path, limits).split("\n")
    first_row, sides = _map_header(path, lines)
    rows = sides.get("height", 0)
    columns = sides.get("width", 0)
    if not 1 <= rows * columns <= limits.pixels:
        raise FormatError(
            f"{path}: height {rows} and width {columns}, expected 1 to {limits.pixels} cells; "
            "--max-pixels sets this limit"
        )
    body = [line.rstrip(" \t") for line in lines[first_row : first_row + rows]]
    expected = f"{columns} letters ({rows} rows)"
    for number, row in enumerate(body):
        if len(row) != columns:
            raise FormatError(f"{path}: row {number} is {len(row)} letters, expected {expected}")
    if len(body) < rows:
        raise FormatError(f"{path}: row {len(body)} is missing, expected {expected}")
    text = "".join(body)
    letters = LAND + "".join(_ISLANDS) + BLOCKED
    unknown_letters = sorted(set(text) - set(letters))
    if unknown_letters:
        raise FormatError(
            f"{path}: unknown terrain {unknown_letters[0]!r}, expected one of {letters}"
        )
    return np.frombuffer(text.encode("ascii"), np.uint8).reshape(rows, columns)


def _map_header(path: Path, lines: list[str]) -> tuple[int, dict[str, int]]:
    """Return the header of a .map file.

    Returns:
        The index in ``lines`` of the map's first row, and "height" and "width" as far as the header
        states them.

    Raises:
        FormatError: a line that is no part of a header, or no line "map" among the first 20.
    """
    sides: dict[str, int] = {}
    for number, line in enumerate(lines[:20]):
        words = " ".join(line.lower().split())
        if words == "map":
            return number + 1, sides
        match = re.fullmatch(r"(height|width) ([0-9]{1,10})", words)
        if match is not None:
            sides[match[1]] = int(match[2])
        elif words in _OTHER_TYPES:
            raise FormatError(
                f"{path}: is of {words}, {_OTHER_TYPES[words]}; expected type octile, with a "
                "letter for each cell"
            )
        elif words and not words.startswith("type"):
            raise FormatError(
                f"{path}: line {number + 1} is {line[:40]!r}, expected type, height, width or map"
            )
    raise FormatError(f"{path}: no line 'map' near the top, expected a MovingAI map")


def terrain_grid(terrain: Bytes, free_letters: str = LAND) -> Bytes:
    """Return a grid, (H, W) uint8, in which only cells of ``free_letters`` are free.

    Args:
        terrain: (H, W) uint8 of ASCII codes.
        free_letters: the letters of the free cells.
    """
    is_free = np.isin(terrain, list(free_letters.encode()))
    return np.asarray(~is_free, np.uint8)


@dataclass
class ScenReport:
    """The comparison of the lengths in a .scen file with those of our A*.

    Attributes:
        total: number of problems that were solved.
        in_file: number of problems in the file.
        has_lengths: whether the file states lengths. Scenarios of several agents (MAPF) often do
            not: all their lengths are 0, although there are paths.
        disagreements: a message for each length that our A* does not reproduce to its last digit,
            and for each problem with a cell outside the map.
        wrong_lengths: number of those lengths whose problem has a path.
        solved: the problems that have a path, each with its grid.
        hint: what is probably wrong with the whole file; empty if there is no such guess.
    """

    total: int
    in_file: int
    has_lengths: bool = True
    disagreements: list[str] = field(default_factory=list)
    wrong_lengths: int = 0
    solved: list[tuple[Bytes, Problem]] = field(default_factory=list)
    hint: str = ""

    @property
    def agreed(self) -> int:
        """Number of lengths that our A* reproduces."""
        return self.total - len(self.disagreements)


_BATCH = 256
"""Number of problems that are solved between two steps of a progress bar."""


def check_scen(
    path: StrPath,
    maps: StrPath | None = None,
    limits: Limits = LIMITS,
    count: int | None = None,
) -> ScenReport:
    """Compare the optimal lengths of a .scen with those that A* finds under the benchmark's rule.

    Args:
        path: the .scen file.
        maps: folder of the maps; default the folder of the .scen.
        limits: of what is read, and whether a progress bar shows it.
        count: maximal number of problems, evenly spread over the file; default all.

    Raises:
        FormatError: a file that cannot be read, a map that is missing or has another size than the
            .scen says.
    """
    path = local_path(path)
    selected = read_scen(path, limits)
    if not selected:
        raise FormatError(f"{path}: holds no problems")
    in_file = len(selected)
    are_zero = all(float(problem.length) == 0 for problem in selected)
    if count is not None:
        selected = selected[:: sampling_step(in_file, count)]
    terrains: dict[str, Bytes] = {}
    # Problems on the same terrain of the same map are solved together.
    groups: dict[tuple[str, str], list[Problem]] = {}
    report = ScenReport(len(selected), in_file)
    outside_messages = []
    for problem in selected:
        if problem.map not in terrains:
            terrains[problem.map] = read_terrain(find_map(problem.map, path, maps, limits), limits)
        terrain = terrains[problem.map]
        _check_size(problem, terrain.shape, path)
        outside = _outside(problem, terrain.shape)
        if outside:
            outside_messages.append(f"{path}: line {problem.line}: {outside}")
            continue
        start_letter = chr(terrain[problem.start])
        free_letters = start_letter if start_letter in _ISLANDS else LAND
        groups.setdefault((problem.map, free_letters), []).append(problem)
    is_long = report.total > _BATCH
    with bar(limits.progress and is_long, report.total, unit=" problems") as advance:
        for (name, free_letters), group in groups.items():
            grid = terrain_grid(terrains[name], free_letters)
            for first in range(0, len(group), _BATCH):
                batch = group[first : first + _BATCH]
                _check_lengths(batch, grid, path, report)
                advance(len(batch))
    if are_zero and report.solved:
        # The lengths claim that there are no paths, but there are some: nobody has computed them.
        report.has_lengths = False
        report.wrong_lengths = 0
        report.disagreements.clear()
    report.disagreements[:0] = outside_messages
    if report.disagreements and _are_exchanged(selected, terrains):
        report.hint = (
            f"{path}: x and y are probably exchanged: only then are all starts and goals on cells "
            "that moves can cross; x is the column, and comes first"
        )
    return report


def _check_lengths(batch: list[Problem], grid: Bytes, path: Path, report: ScenReport) -> None:
    """Solve problems on one grid, and add the solved ones and the disagreements to ``report``."""
    starts = [problem.start for problem in batch]
    goals = [problem.goal for problem in batch]
    # This search accepts a start or goal on an occupied cell: it returns that there is no path.
    costs = solve_batch(
        ASTAR, grid, starts, goals, MOVEMENT, allow_occupied_ends=True
    ).cost.tolist()
    for problem, cost in zip(batch, costs, strict=True):
        if cost > 0:
            report.solved.append((grid, problem))
        if not agrees(problem, cost):
            report.wrong_lengths += cost > 0
            our_length = f"{cost:.8f}"
            if cost < 0:
                our_length = "no path" + _why_no_path(problem, grid)
            report.disagreements.append(
                f"{path}: line {problem.line}: {problem.start} to {problem.goal} "
                f"(row, col): says {problem.length}, found {our_length}"
            )


def _why_no_path(problem: Problem, grid: Bytes) -> str:
    """Return the end of a message that says which end of a problem is occupied, if one is."""
    ends = {"start": problem.start, "goal": problem.goal}
    occupied = [name for name, cell in ends.items() if grid[cell]]
    return f" ({' and '.join(occupied)} on an occupied cell)" if occupied else ""


def _are_exchanged(problems: list[Problem], terrains: dict[str, Bytes]) -> bool:
    """Return whether the ends of all problems can be crossed only with x and y exchanged.

    Args:
        problems: of a .scen.
        terrains: letters of its maps, (H, W) uint8, by their names in the .scen.
    """

    def can_cross(terrain: Bytes, row: int, column: int) -> bool:
        is_inside = row < terrain.shape[0] and column < terrain.shape[1]
        return is_inside and chr(terrain[row, column]) not in BLOCKED

    ends = [
        (terrains[problem.map], *cell)
        for problem in problems
        for cell in (problem.start, problem.goal)
    ]
    are_sound = all(can_cross(terrain, row, column) for terrain, row, column in ends)
    return not are_sound and all(can_cross(terrain, column, row) for terrain, row, column in ends)


def problems(
    source: Path,
    limits: Limits = LIMITS,
    *,
    count: int | None = None,
    maps: Path | None = None,
    lengths: Literal["check", "ours"] = "check",
) -> ProblemSet:
    """Return the problems of a .scen, to compare planners on.

    Problems without a path and problems from a cell to itself are left out. The description of the
    set says how many are left out.

    Args:
        source: the .scen file.
        limits: of what is read, and whether a progress bar shows it.
        count: maximal number of problems, evenly spread over the file; default all.
        maps: folder of the maps; default the folder of the .scen.
        lengths: "check" refuses a file with a length that our A* does not reproduce, or with a cell
            outside the map; "ours" takes the lengths of our A* in place of such lengths, and leaves
            out problems with a cell outside the map.

    Raises:
        FormatError: a file that `check_scen` refuses; a length that our A* does not reproduce,
            unless ``lengths`` is "ours"; no problem has a path.
        ValueError: maps of several sizes.
    """
    report = check_scen(source, maps, limits, count)
    if report.disagreements and lengths == "check":
        others = len(report.disagreements) - 1
        more = f"; and {others:,} more" if others else ""
        hint = f"; {report.hint}" if report.hint else '; lengths="ours" takes our lengths'
        raise FormatError(f"{report.disagreements[0]}{more}{hint}")
    if not report.solved:
        raise FormatError(f"{source}: none of its {report.total} problems has a path")
    grids = [grid for grid, _ in report.solved]
    first_grid = grids[0]
    if all(grid is first_grid for grid in grids):
        # All problems are on one map, as in most files: it is in memory once.
        stacked = np.broadcast_to(first_grid, (len(grids), *first_grid.shape))
    else:
        stacked = np.stack(grids)
    return ProblemSet(
        stacked,
        np.array([problem.start for _, problem in report.solved]),
        np.array([problem.goal for _, problem in report.solved]),
        MOVEMENT,
        _description(source, report, count),
    )


def _description(source: Path, report: ScenReport, count: int | None) -> str:
    """Return a description of the problems of a .scen: how many, which, and of what lengths."""
    solved = len(report.solved)
    text = f"{solved} problems of {source}"
    if solved != report.in_file:
        text = f"{solved} of {report.in_file} problems of {source}"
    step = 1 if count is None else sampling_step(report.in_file, count)
    if step > 1:
        text += f", one in {step}"
    left_out = report.total - solved
    if left_out:
        text += f", {left_out} without a path or a move left out"
    if report.wrong_lengths:
        return f"{text}, {report.wrong_lengths} of them with our length in place of another"
    if report.has_lengths:
        return f"{text}, whose lengths are ours"
    return f"{text}, which gives no lengths"


def _check_size(problem: Problem, shape: Size, path: Path) -> None:
    """Refuse a problem whose .scen, ``path``, states another size than that of its map.

    Raises:
        FormatError: the message has both.
    """
    if problem.size not in (None, shape):
        raise FormatError(
            f"{path}: line {problem.line} says {problem.size}, the map has {shape} rows, columns"
        )


def _outside(problem: Problem, shape: Size) -> str:
    """Return a message that says which cell lies outside a map; empty if none does."""
    for cell in (problem.start, problem.goal):
        if np.greater_equal(cell, shape).any():
            return f"(row, col) {cell} is outside the map of {shape}"
    return ""


def find_map(name: str, scen: Path, maps: StrPath | None = None, limits: Limits = LIMITS) -> Path:
    """Return the path of a map that a .scen names.

    The map must lie below ``maps``, or below the folder of the .scen if ``maps`` is None. If the
    name contains folders that do not exist there, the first ones are removed, one after another.

    Args:
        name: of the map, as the .scen has it.
        scen: the .scen file.
        maps: folder of the maps.
        limits: say whether links out of the folder are followed.

    Raises:
        FormatError: there is no such file, and the message names the last path that was tried; the
            file is a link out of the folder.
    """
    folder = scen.parent if maps is None else Path(maps)
    path = PureWindowsPath(name)  # separated by slashes or backslashes
    parts = path.relative_to(path.anchor).parts
    last_tried = f"a name inside {folder}"
    for start in range(len(parts)):
        if ".." in parts[start:]:
            continue
        candidate = folder.joinpath(*parts[start:])
        last_tried = str(candidate)
        if candidate.is_file():
            return checked_inside(candidate, folder, limits)
    advice = "maps= (--maps, or --movingai.maps of an import) names their folder"
    raise FormatError(f"{scen}: its map {name!r} is missing: looked for {last_tried}; {advice}")


def read(
    source: Path,
    limits: Limits = LIMITS,
    *,
    scen: bool = False,
    maps: Path | str | None = None,
    seed_points: int = MAX_ROOMS,
    costs: dict[str, int] | None = None,
) -> Collection:
    """Read a .map or .scen file, or all below a folder.

    Args:
        source: file or folder.
        limits: of what is read.
        scen: use the starts and goals of .scen files as seed points, in the order of their first
            appearance, and read only maps that a .scen file names; always on if the source is a
            .scen file.
        maps: folder of the maps that .scen files name.
        seed_points: maximal number of these end points.
        costs: costs of letters, such as {"S": 3, "W": 5}, for maps with terrain. Cells of these
            letters are free, whatever moves the benchmark allows between them; other land costs 1.

    Raises:
        ValueError: ``costs`` is no mapping of letters to costs from 1 to 255.
    """
    cost_by_code = None if costs is None else _cost_by_code(costs)
    collection = Collection(movement=MOVEMENT)
    end_points: Iterable[tuple[Path, list[Cell]]]
    if scen or source.suffix.lower() == ".scen":
        end_points = _end_points(source, limits, maps, collection).items()
    else:
        paths = files_with_endings(source, (".map",), limits, collection)
        end_points = ((path, []) for path in paths)
    letter_counts = np.zeros(128, np.int64)  # indexed by ASCII code
    chosen_count = 0
    end_point_count = 0
    for path, cells in end_points:
        with collection.leaving_out(path):
            letters = read_terrain(path, limits)
            letter_counts += np.bincount(letters.ravel(), minlength=len(letter_counts))
            cell_costs = None if cost_by_code is None else cost_by_code[letters]
            grid = terrain_grid(letters)
            if cell_costs is not None:
                grid = np.asarray(cell_costs == 0, np.uint8)
            distinct_cells = dict.fromkeys(cells)
            free_cells = [cell for cell in distinct_cells if grid[cell] == 0]
            chosen = np.array(free_cells[:seed_points], np.int64).reshape(-1, 2)
            chosen_count += len(chosen)
            end_point_count += len(free_cells)
            collection.maps.append(
                ForeignMap(
                    str(path),
                    grid,
                    split_from_folders(path, source),
                    seed_points=chosen,
                    rooms_known=len(chosen) > 1,  # with fewer, the import draws more
                    terrain=cell_costs,
                )
            )
    if chosen_count < end_point_count:
        collection.notes.append(
            f"{chosen_count} of the {end_point_count} free start and goal cells of the problems "
            "are seed points (--seed-points N takes more); mapdata.formats.read_problems(file) "
            "reads the problems themselves"
        )
    if cost_by_code is not None:
        letter_costs = ", ".join(
            f"{letter} {cost_by_code[ord(letter)]} ({letter_counts[ord(letter)]} cells)"
            for letter in LAND + "".join(_ISLANDS)
            if cost_by_code[ord(letter)] and letter_counts[ord(letter)]
        )
        collection.notes.append(f"costs of the letters: {letter_costs}")
    for letter, name in _ISLANDS.items():
        count = letter_counts[ord(letter)]
        has_cost = cost_by_code is not None and cost_by_code[ord(letter)] > 0
        if count and not has_cost:
            reason = "nothing leads there from land" if costs is None else "they have no cost"
            collection.notes.append(f"{count} cells of {name} ({letter}) are occupied: {reason}")
    return collection


def _cost_by_code(costs: dict[str, int]) -> Bytes:
    """Return the cost of each letter, (128,) uint8 by ASCII code; 0 where a cell is occupied.

    Raises:
        ValueError: letters that have no cells to move on, or costs that are not 1 to 255.
    """
    letters = LAND + "".join(_ISLANDS)
    if not isinstance(costs, dict) or not costs:
        raise ValueError(f'costs: got {costs!r}, expected letters and their costs as in {{"S": 3}}')
    cost_by_code = np.zeros(128, np.uint8)
    cost_by_code[list(LAND.encode())] = _LAND_COST
    for letter, cost in costs.items():
        if not isinstance(letter, str) or len(letter) != 1 or letter not in letters:
            raise ValueError(f"costs: got the letter {letter!r}, expected one of {letters}")
        if type(cost) is not int or not 1 <= cost <= MAX_CELL_COST:
            raise ValueError(
                f"costs: got {cost!r} for {letter!r}, expected a whole number from 1 to "
                f"{MAX_CELL_COST}"
            )
        cost_by_code[ord(letter)] = cost
    return cost_by_code


def _end_points(
    source: Path, limits: Limits, maps: StrPath | None, collection: Collection
) -> dict[Path, list[Cell]]:
    """Return the starts and goals in .scen files, in their order, by the path of their map.

    Files that cannot be read are added to what ``collection`` leaves out.

    Raises:
        FormatError: ``source`` is a .map file.
    """
    if source.suffix.lower() == ".map":
        raise FormatError(
            f"{source}: a map has no end points, expected a .scen file or a folder with some"
        )
    end_points: dict[Path, list[Cell]] = {}
    shapes: dict[Path, Size] = {}
    for scen in files_with_endings(source, (".scen",), limits, collection):
        outside_lines = []
        with collection.leaving_out(scen):
            for problem in read_scen(scen, limits):
                map_path = find_map(problem.map, scen, maps, limits)
                if map_path not in shapes:
                    shapes[map_path] = read_terrain(map_path, limits).shape
                _check_size(problem, shapes[map_path], scen)
                if _outside(problem, shapes[map_path]):
                    outside_lines.append(problem.line)
                    continue
                end_points.setdefault(map_path, []).extend([problem.start, problem.goal])
        if outside_lines:
            name = joint_name(f"{scen}: line", outside_lines)
            collection.left_out.append((name, "its start or goal is outside the map"))
    return end_points


def write(target: Path, root: Root, progress: bool) -> list[str]:
    """Write each map as ``<split>/map<i>.map``, and all pairs of its rooms as a .scen beside it.

    Lengths are those of the benchmark's rule, whatever the movement of the dataset; pairs without a
    path have 0.

    Returns:
        Notes for the user.
    """
    rows, columns = root.map_size
    for stem, grid, seed_points in maps_to_write(target, root, progress):
        letters = np.frombuffer(b".@", np.uint8)[grid]
        body = "\n".join(row.tobytes().decode() for row in letters)
        text = f"type octile\nheight {rows}\nwidth {columns}\nmap\n{body}\n"
        stem.with_suffix(".map").write_text(text, newline="\n")
        scen = _scen_text(f"{stem.name}.map", grid, seed_points)
        stem.with_suffix(".map.scen").write_text(scen, newline="\n")
    return [
        "lengths in the .scen files are 8-connected without corner cutting, the benchmark's rule"
    ]


def _scen_text(map_name: str, grid: Bytes, seed_points: Ints) -> str:
    """Return the text of a .scen with a problem for each pair of ``seed_points``, (n, 2)."""
    height, width = grid.shape
    first_rooms, second_rooms = np.triu_indices(len(seed_points), 1)
    starts = seed_points[first_rooms].tolist()
    goals = seed_points[second_rooms].tolist()
    costs = search_batch("astar", grid, starts, goals, MOVEMENT).cost.tolist()
    lines = ["version 1"]
    for (start_y, start_x), (goal_y, goal_x), cost in zip(starts, goals, costs, strict=True):
        length = max(cost, 0.0)  # without a path the cost is -1, and the printed length 0
        bucket = int(length / 4)
        lines.append(
            f"{bucket}\t{map_name}\t{width}\t{height}\t{start_x}\t{start_y}\t{goal_x}\t{goal_y}\t"
            f"{length:.8f}"
        )
    return "\n".join(lines) + "\n"


FORMAT = Format("movingai", (".map", ".scen"), read, write, problems)
