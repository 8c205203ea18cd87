"""What is asked for: a specification of maps and the rule by which one moves on them. Plain values, checked once."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict, dataclass, field, fields
from typing import Any

FORMAT_VERSION = 1
"""Version of the bytes: draws, labels and shard layout (docs/format.md)."""

MAX_SIDE = 1024
"""Largest number of rows or columns of a map."""

MAX_ROOMS = 255
"""Largest number of rooms of a map."""

SPLITS = ("train", "val", "test")
"""Names of the splits, in the order of their codes 0, 1, 2."""

Range = tuple[int, int]


@dataclass(frozen=True)
class Movement:
    """How one moves on a grid.

    Attributes:
        connectivity: 4 (north, east, south, west; the paper's distance in pixels) or 8 (diagonals too).
        corner_cutting: True lets a diagonal step pass between or beside occupied cells; False demands that both
            orthogonal neighbours are free. Only with 8.
        diagonal_cost: sqrt(2), or 1 to reproduce data that count moves. Only with 8.

    Raises:
        ValueError: a value that is not one of these, or one that would do nothing.
    """

    connectivity: int = 4
    corner_cutting: bool = False
    diagonal_cost: float = math.sqrt(2)

    def __post_init__(self) -> None:
        """Check the values and bring ``diagonal_cost`` to exactly 1.0 or sqrt(2)."""
        if isinstance(self.connectivity, bool) or self.connectivity not in (4, 8):
            raise ValueError(f"connectivity: got {self.connectivity!r}, expected 4 or 8")
        if not isinstance(self.corner_cutting, bool):
            raise ValueError(f"corner_cutting: got {self.corner_cutting!r}, expected True or False")
        cost = _number("diagonal_cost", self.diagonal_cost)
        exact = [value for value in (1.0, math.sqrt(2)) if math.isclose(cost, value, rel_tol=1e-6)]
        if not exact:
            raise ValueError(f"diagonal_cost: got {cost!r}, expected 1 or sqrt(2) = {math.sqrt(2)}")
        object.__setattr__(self, "diagonal_cost", exact[0])
        if self.connectivity == 4 and (self.corner_cutting or exact[0] == 1.0):
            raise ValueError("connectivity 4 has no diagonal moves: corner_cutting and diagonal_cost would do nothing")


@dataclass(frozen=True)
class MapSpec:
    """The distribution that maps are drawn from: the parameters of Table 1 of the paper, which are the defaults.

    All ranges are (lowest, highest), both included. See arXiv 2110.13242, section III and Table 1.

    Attributes:
        map_size: (rows, columns) of a map, in cells, at most ``MAX_SIDE`` each.
        rooms: number of rooms, 2 to ``MAX_ROOMS``.
        room_rows: rows of a room as drawn, in cells, before it is clipped at the border.
        room_columns: columns of a room, likewise.
        passage_width: width of the tunnels of a map, in cells; one draw a map.
        skip_probability: probability that no tunnel is drawn between two consecutive rooms.
        resolution: metres per cell.
        movement: how paths move.
        splits: fractions of maps in train, val and test; they add up to 1.

    Raises:
        ValueError: a value outside these limits, rooms or tunnels larger than the map.
    """

    map_size: Range = (64, 64)
    rooms: Range = (2, 9)
    room_rows: Range = (14, 33)
    room_columns: Range = (14, 33)
    passage_width: Range = (7, 15)
    skip_probability: float = 0.1
    resolution: float = 0.1
    movement: Movement = field(default_factory=Movement)
    splits: tuple[float, float, float] = (0.8, 0.1, 0.1)

    def __post_init__(self) -> None:
        """Check the values and bring them to tuples of int and float, so that equal specs have equal JSON."""
        for name in ("map_size", "rooms", "room_rows", "room_columns", "passage_width"):
            object.__setattr__(self, name, _integers(name, getattr(self, name)))
        for name in ("skip_probability", "resolution"):
            object.__setattr__(self, name, _number(name, getattr(self, name)))
        object.__setattr__(self, "splits", _fractions(self.splits))
        if not isinstance(self.movement, Movement):
            raise ValueError(f"movement: got {self.movement!r}, expected a Movement")
        rows, columns = self.map_size
        if not (1 <= rows <= MAX_SIDE and 1 <= columns <= MAX_SIDE):
            raise ValueError(f"map_size: got {self.map_size}, expected 1 to {MAX_SIDE} rows and columns")
        _check_range("rooms", self.rooms, 2, MAX_ROOMS, "")
        _check_range("room_rows", self.room_rows, 1, rows, f": rooms would be larger than the map of {rows} rows")
        _check_range(
            "room_columns", self.room_columns, 1, columns, f": rooms would be larger than the map of {columns} columns"
        )
        side = min(self.map_size)
        _check_range(
            "passage_width", self.passage_width, 1, side, f": tunnels would be larger than the map, {rows} x {columns}"
        )
        if not 0 <= self.skip_probability <= 1:
            raise ValueError(f"skip_probability: got {self.skip_probability}, expected a probability in [0, 1]")
        if not (self.resolution > 0 and math.isfinite(self.resolution)):
            raise ValueError(f"resolution: got {self.resolution}, expected metres per cell above 0")

    @staticmethod
    def preset(name: str) -> MapSpec:
        """Return the preset ``name``: "paper", "narrow", "dungeon" or "dungeon128".

        Raises:
            ValueError: no such preset.
        """
        if name not in PRESETS:
            raise ValueError(f"preset: got {name!r}, expected one of {', '.join(PRESETS)}")
        return PRESETS[name]

    def to_dict(self) -> dict[str, Any]:
        """Return the spec as plain values for JSON."""
        return asdict(self)

    def to_json(self) -> str:
        """Return the spec as canonical JSON: sorted keys, no white space."""
        return canonical_json(self.to_dict())

    @staticmethod
    def from_dict(values: object) -> MapSpec:
        """Return the spec with these values; missing ones take their defaults.

        Raises:
            ValueError: an unknown name, or a value that a spec refuses.
        """
        known = _known("spec", values, MapSpec)
        if "movement" in known:
            known["movement"] = Movement(**_known("movement", known["movement"], Movement))
        return MapSpec(**known)

    @staticmethod
    def from_json(text: str) -> MapSpec:
        """Return the spec written as JSON by hand or by `to_json`.

        Raises:
            ValueError: not JSON, an unknown name, or a value that a spec refuses.
        """
        try:
            values = json.loads(text)
        except (json.JSONDecodeError, RecursionError) as error:
            raise ValueError(f"spec: not JSON ({error})") from None
        return MapSpec.from_dict(values)


def canonical_json(values: object) -> str:
    """Return the one JSON text of ``values`` that hashes are taken of: sorted keys, no white space, ASCII."""
    return json.dumps(values, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)


def check_seed(seed: int) -> int:
    """Return ``seed`` as an int.

    Raises:
        ValueError: not an integer of 64 bits, 0 to 2**64 - 1.
    """
    (value,) = _integers("seed", (seed,), 1)
    if not 0 <= value < 2**64:
        raise ValueError(f"seed: got {value}, expected 0 to 2**64 - 1")
    return value


def check_count(name: str, value: object, lowest: int = 1) -> int:
    """Return ``value`` as an int.

    Raises:
        ValueError: not an integer, or below ``lowest``.
    """
    (count,) = _integers(name, (value,), 1)
    if count < lowest:
        raise ValueError(f"{name}: got {count}, expected an integer of at least {lowest}")
    return count


def identity(spec: MapSpec, seed: int) -> str:
    """Return the identity of a dataset: SHA-256 (hex) of the canonical JSON of format version, spec and seed.

    The number of maps is not in it, so that a dataset can grow.
    """
    recipe = {"format_version": FORMAT_VERSION, "spec": spec.to_dict(), "seed": check_seed(seed)}
    return hashlib.sha256(canonical_json(recipe).encode()).hexdigest()


def _known(what: str, values: object, of: type[MapSpec | Movement]) -> dict[str, Any]:
    """Return ``values`` as keyword arguments of the dataclass ``of``."""
    if not isinstance(values, dict):
        raise ValueError(f"{what}: got {values!r}, expected an object of named values")
    names = [item.name for item in fields(of)]
    unknown = [str(name) for name in values if name not in names]
    if unknown:
        raise ValueError(f"{what}: unknown {', '.join(unknown)}; known are {', '.join(names)}")
    return dict(values)


def _integers(name: str, values: object, count: int = 2) -> tuple[int, ...]:
    """Return ``values`` as a tuple of ``count`` ints; numpy integers are welcome, floats and bools are not."""
    items = tuple(values) if isinstance(values, (tuple, list)) else ()
    if len(items) != count or any(isinstance(item, bool) or not hasattr(item, "__index__") for item in items):
        what = "an integer" if count == 1 else f"{count} integers"
        raise ValueError(f"{name}: got {items[0] if count == 1 and items else values!r}, expected {what}")
    return tuple(item.__index__() for item in items)


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not hasattr(value, "__float__") or isinstance(value, str):
        raise ValueError(f"{name}: got {value!r}, expected a number")
    try:
        return float(value)
    except OverflowError:
        raise ValueError(f"{name}: got {value!r}, expected a number") from None


def _fractions(values: object) -> tuple[float, ...]:
    items = tuple(_number("splits", item) for item in values) if isinstance(values, (tuple, list)) else ()
    if len(items) != len(SPLITS) or not all(0 <= item <= 1 for item in items) or abs(sum(items) - 1) > 1e-9:
        raise ValueError(f"splits: got {values!r}, expected three fractions in [0, 1] that add up to 1")
    return items


def _check_range(name: str, limits: Range, lowest: int, highest: int, why: str) -> None:
    low, high = limits
    if low > high:
        raise ValueError(f"{name}: upper limit {high} is under the lower limit {low}")
    if low < lowest:
        raise ValueError(f"{name}: got {limits}, expected at least {lowest}")
    if high > highest:
        raise ValueError(f"{name}: got {limits}, expected at most {highest}{why}")


PRESETS: dict[str, MapSpec] = {
    "paper": MapSpec(),
    "narrow": MapSpec(passage_width=(1, 3)),
    "dungeon": MapSpec(rooms=(8, 16), room_rows=(6, 14), room_columns=(6, 14), passage_width=(1, 3)),
    "dungeon128": MapSpec(
        map_size=(128, 128), rooms=(16, 40), room_rows=(8, 20), room_columns=(8, 20), passage_width=(2, 4)
    ),
}
"""The presets: "paper" is Table 1; in "dungeon" a planner has something to learn."""
