"""The file layouts of other repositories: names, shapes and dtypes of arrays, in one table.

Each layout is read by the loader of its repository as that loader stands. A layout that is not
here is a short program over ``mapdata export --format arrays`` (docs/howto/coming_from.md).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mapdata.arrays import Array, Bytes
from mapdata.datasets.field_kernels import PADDING
from mapdata.datasets.text import CHARACTERS, first_optimal_paths, maze_tokens
from mapdata.limits import Size
from mapdata.movement import STEPS, Movement

Columns = Mapping[str, Array]
"""The fields of B problems by name; ``path`` is padded with -1 to (B, T, 2)."""


class LayoutArray(NamedTuple):
    """One array of a layout.

    Attributes:
        name: of the file, without ``.npy``; archives number their arrays instead.
        dtype: of the file.
        shape: in words, for the documentation.
        rows: gives the rows of a batch, from its fields and the movement of its paths.
    """

    name: str
    dtype: str
    shape: str
    rows: Callable[[Columns, Movement], Array]


@dataclass(frozen=True)
class Layout:
    """How a repository expects its training data.

    Attributes:
        name: as ``mapdata export --format`` takes it.
        source: address of the loader that reads it.
        fields: fields of a dataset that the arrays are made of.
        arrays: the arrays of one split.
        splits: our name of a split -> that of the layout; splits that are missing have no place.
        problems: which problems are drawn unless the caller says otherwise.
        movement: rule of the repository's planner, used unless the caller says otherwise.
        file_name: of the file of an array, from ``{split}`` and ``{array}``.
        archive: name of one ``.npz`` that holds all splits, as arr_0, arr_1, ... in the order of
            ``splits`` and ``arrays``; empty where each array is a file.
        has_terrain: whether the arrays hold the costs of cells. Such a layout is for maps with
            terrain alone; the others are for maps without.
        check: called with the fields of each batch and the movement of the paths; raises
            ValueError where the loader would take the problems for other ones.
        max_batch: how many problems are turned into rows at once; fewer where one problem has many
            rows.
        write_index: called with the folder of a split, the number of its problems and the map
            size, to write what is no array of rows.
    """

    name: str
    source: str
    fields: tuple[str, ...]
    arrays: tuple[LayoutArray, ...]
    splits: Mapping[str, str]
    problems: str
    movement: Movement
    file_name: str = "{split}/{array}.npy"
    archive: str = ""
    has_terrain: bool = False
    check: Callable[[Columns, Movement], None] | None = None
    max_batch: int = 4096
    write_index: Callable[[Path, int, Size], None] | None = None


def _field(name: str) -> Callable[[Columns, Movement], Array]:
    """Return a function that returns a field as it is."""
    return lambda columns, movement: columns[name]


# --- GPPN -----------------------------------------------------------------------------------------

_GPPN_MOVES = np.array([(-1, 0), (0, 1), (0, -1), (1, 0), (-1, 1), (-1, -1), (1, 1), (1, -1)])
"""GPPN's actions: N, E, W, S, and with 8 moves NE, NW, SE, SW."""

_VIN_MOVES = np.array([(-1, 0), (1, 0), (0, 1), (0, -1), (-1, 1), (-1, -1), (1, 1), (1, -1)])
"""VIN's actions: N, S, E, W, NE, NW, SE, SW."""


def _move_numbers(moves: Array) -> Array:
    """Return for each of ``moves`` (n, 2) the number k of the same move in `STEPS`."""
    is_same: Array = (STEPS[None, :, :] == moves[:, None, :]).all(axis=2)
    move_numbers: Array = is_same.argmax(axis=1)
    return move_numbers


def _optimal_policy(columns: Columns, movement: Movement) -> Bytes:
    """Return (B, A, 1, H, W): 1 where action a is optimal, for A = 4 or 8 actions.

    Several actions of a cell may be optimal. The loader's own generator draws one of them.
    """
    bits = columns["optimal_moves"]
    actions = _GPPN_MOVES[: movement.connectivity]
    move_numbers = _move_numbers(actions).astype(np.uint8)
    policy = (bits >> move_numbers[None, :, None, None]) & 1
    return policy[:, :, None].astype(np.uint8)


# --- VIN ------------------------------------------------------------------------------------------


class _Steps(NamedTuple):
    """All moves of the paths of a batch: M moves from M cells.

    Attributes:
        problems: (M,) row of the batch.
        cells: (M, 2) where the move begins.
        actions: (M,) number of the move in VIN's order.
    """

    problems: Array
    cells: Array
    actions: Array


def _steps(columns: Columns) -> _Steps:
    """Return the moves of all paths of a batch, problem by problem."""
    path = columns["path"]
    is_move = path[:, 1:, 0] != PADDING
    problems, numbers = np.nonzero(is_move)
    cells = path[problems, numbers]
    moves = path[problems, numbers + 1] - cells
    actions = (_VIN_MOVES[None] == moves[:, None]).all(axis=2).argmax(axis=1)
    return _Steps(problems, cells, actions)


def _vin_images(columns: Columns) -> Bytes:
    """Return (M, 2, H, W): the map, and 10 at the goal; once for each move of a path."""
    images = np.concatenate([columns["map"], 10 * columns["goal_mask"]], axis=1)
    return images[_steps(columns).problems]


# --- HRM and TRM ----------------------------------------------------------------------------------


MAZE_FIELDS = ("map", "start", "goal", "cost_to_go")
"""The fields that mazes with marked paths are made of."""


def with_first_optimal_paths(columns: Columns) -> Columns:
    """Return `MAZE_FIELDS` with the field ``path``: the paths of maze-30x30-hard-1k's rule."""
    paths = first_optimal_paths(columns["cost_to_go"][:, 0], columns["start"])
    return {**columns, "path": paths}


def _maze_rows(columns: Columns, *, with_path: bool) -> Bytes:
    """Return mazes as tokens (B, H * W)."""
    fields = with_first_optimal_paths(columns) if with_path else columns
    tokens = maze_tokens(fields, with_path=with_path)
    return tokens.reshape(len(tokens), -1)


def _write_hrm_index(folder: Path, count: int, map_size: Size) -> None:
    """Write which rows are one puzzle: here each row is a puzzle and a group of its own."""
    bounds = np.arange(count + 1, dtype=np.int32)
    # numpy's own writing into a file raises an error without a reason where the disk is full.
    array_file = BytesIO()
    np.save(array_file, bounds)
    for name in ("all__puzzle_indices.npy", "all__group_indices.npy"):
        (folder / name).write_bytes(array_file.getvalue())
    rows, columns = map_size
    metadata = {
        "seq_len": rows * columns,
        "vocab_size": len(CHARACTERS) + 1,
        "pad_id": 0,
        "ignore_label_id": 0,
        "blank_identifier_id": 0,
        "num_puzzle_identifiers": 1,
        "total_groups": count,
        "total_puzzles": count,  # read by TRM, ignored by HRM
        "mean_puzzle_examples": 1,
        "sets": ["all"],
    }
    (folder / "dataset.json").write_text(json.dumps(metadata) + "\n", encoding="utf-8")
    # Only visualisation reads it, from the folder above.
    (folder.parent / "identifiers.json").write_text('["<blank>"]\n', encoding="utf-8")


# --- Warcraft -------------------------------------------------------------------------------------

WARCRAFT_MOVEMENT = Movement(8, corner_cutting=True, diagonal_cost=1.0)
"""The rule of the Warcraft sets, `mapdata.formats.warcraft`."""

_WARCRAFT_UNIT = 0.1
"""The weight of a cell of cost 1."""


def _check_warcraft(columns: Columns, movement: Movement) -> None:
    """Refuse problems that are not as the loaders of Warcraft sets take all problems to be.

    Raises:
        ValueError: another movement, a map with occupied cells, a problem between other cells than
            the upper left and the lower right one.
    """
    if movement != WARCRAFT_MOVEMENT:
        raise ValueError(
            f"warcraft: got {movement}, expected {WARCRAFT_MOVEMENT}, the rule of its loaders"
        )
    is_occupied = columns["terrain"] == 0
    if is_occupied.any():
        raise ValueError(
            "warcraft: got maps with occupied cells, whose weight 0 would be the cheapest; "
            "expected free cells alone, as of the preset tiles"
        )
    rows, width = is_occupied.shape[2:]
    goal_corner = np.array([rows - 1, width - 1])
    is_from_corner = (columns["start"] == 0).all(axis=1) & (columns["goal"] == goal_corner).all(
        axis=1
    )
    if not is_from_corner.all():
        problem = int(is_from_corner.argmin())
        start = tuple(columns["start"][problem].tolist())
        goal = tuple(columns["goal"][problem].tolist())
        raise ValueError(
            f"warcraft: got a problem from {start} to {goal}, but its loaders take all problems to "
            f"lead from (0, 0) to {rows - 1, width - 1}: expected Terrain(corners=True), as the "
            "preset tiles"
        )


def _vertex_weights(columns: Columns, movement: Movement) -> Array:
    """Return the weights of the cells, (B, H, W) float32."""
    return (columns["terrain"][:, 0] * _WARCRAFT_UNIT).astype(np.float32)


# --- the table ------------------------------------------------------------------------------------

LAYOUTS: dict[str, Layout] = {
    layout.name: layout
    for layout in (
        Layout(
            name="transpath",
            source="https://github.com/AIRI-Institute/TransPath/blob/main/data/hmaps.py",
            fields=(
                "map",
                "start_mask",
                "goal_mask",
                "path_probability",
                "heuristic_ratio",
                "cost_to_go",
            ),
            arrays=(
                LayoutArray("maps", "uint8", "(N, 1, H, W)", _field("map")),
                LayoutArray("starts", "uint8", "(N, 1, H, W)", _field("start_mask")),
                LayoutArray("goals", "uint8", "(N, 1, H, W)", _field("goal_mask")),
                LayoutArray("focal", "float32", "(N, 1, H, W)", _field("path_probability")),
                LayoutArray("cf", "float32", "(N, 1, H, W)", _field("heuristic_ratio")),
                LayoutArray("abs", "float32", "(N, 1, H, W)", _field("cost_to_go")),
            ),
            splits={"train": "train", "val": "val", "test": "test"},
            problems='{"random": {"hardness": [1.05, null]}}',
            movement=Movement(8, corner_cutting=True),
        ),
        Layout(
            name="gppn",
            source="https://github.com/RLAgent/gated-path-planning-networks/blob/master/utils/maze.py",
            fields=("free", "goal_mask", "optimal_moves"),
            arrays=(
                LayoutArray(
                    "mazes", "uint8", "(N, H, W)", lambda columns, movement: columns["free"][:, 0]
                ),
                LayoutArray("goal_maps", "uint8", "(N, 1, H, W)", _field("goal_mask")),
                LayoutArray("opt_policies", "uint8", "(N, A, 1, H, W)", _optimal_policy),
            ),
            splits={"train": "train", "val": "valid", "test": "test"},
            problems="random",
            movement=Movement(4),
            archive="gppn.npz",
        ),
        Layout(
            name="vin",
            source="https://github.com/kentsommer/pytorch-value-iteration-networks/blob/master/dataset/dataset.py",
            fields=("map", "goal_mask", "path"),
            arrays=(
                LayoutArray(
                    "images",
                    "uint8",
                    "(M, 2, H, W)",
                    lambda columns, movement: _vin_images(columns),
                ),
                LayoutArray(
                    "S1", "int64", "(M,)", lambda columns, movement: _steps(columns).cells[:, 0]
                ),
                LayoutArray(
                    "S2", "int64", "(M,)", lambda columns, movement: _steps(columns).cells[:, 1]
                ),
                LayoutArray(
                    "labels",
                    "int64",
                    "(M,)",
                    lambda columns, movement: _steps(columns).actions,
                ),
            ),
            splits={"train": "train", "test": "test"},
            problems="random",
            movement=Movement(8, corner_cutting=True),
            archive="vin.npz",
            max_batch=32,
        ),
        Layout(
            name="hrm",
            source="https://github.com/sapientinc/HRM/blob/main/puzzle_dataset.py",
            fields=MAZE_FIELDS,
            arrays=(
                LayoutArray(
                    "all__inputs",
                    "uint8",
                    "(N, H * W)",
                    lambda columns, movement: _maze_rows(columns, with_path=False),
                ),
                LayoutArray(
                    "all__labels",
                    "uint8",
                    "(N, H * W)",
                    lambda columns, movement: _maze_rows(columns, with_path=True),
                ),
                LayoutArray(
                    "all__puzzle_identifiers",
                    "int32",
                    "(N,)",
                    lambda columns, movement: np.zeros(len(columns["map"]), np.int32),
                ),
            ),
            splits={"train": "train", "test": "test"},
            problems="random",
            movement=Movement(4),
            write_index=_write_hrm_index,
        ),
        Layout(
            name="warcraft",
            source="https://github.com/omron-sinicx/neural-astar/blob/main/src/neural_astar/utils/data.py",
            fields=("image", "terrain", "start", "goal", "path_mask"),
            arrays=(
                LayoutArray(
                    "maps",
                    "uint8",
                    "(N, k H, k W, 3)",
                    lambda columns, movement: columns["image"].transpose(0, 2, 3, 1),
                ),
                LayoutArray("vertex_weights", "float32", "(N, H, W)", _vertex_weights),
                LayoutArray(
                    "shortest_paths",
                    "uint8",
                    "(N, H, W)",
                    lambda columns, movement: columns["path_mask"][:, 0],
                ),
            ),
            splits={"train": "train", "val": "val", "test": "test"},
            problems="route",
            movement=WARCRAFT_MOVEMENT,
            file_name="{split}_{array}.npy",
            has_terrain=True,
            check=_check_warcraft,
        ),
    )
}
"""All layouts by name."""
