"""Checks of arguments and of plain values, as JSON and configurations hold them."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields
from operator import index
from typing import Any, TypeGuard

from mapdata.limits import MAX_SIDE, SPLITS, Range, Size


def check_seed(seed: int, name: str = "seed") -> int:
    """Return ``seed`` as an int.

    Raises:
        ValueError: not an integer of 64 bits, 0 to 2**64 - 1.
    """
    value = _integer(name, seed)
    if not 0 <= value < 2**64:
        raise ValueError(f"{name}: got {value}, expected 0 to 2**64 - 1")
    return value


def check_count(name: str, value: object, lowest: int = 1) -> int:
    """Return ``value`` as an int.

    Raises:
        ValueError: not an integer, or below ``lowest``.
    """
    count = _integer(name, value)
    if count < lowest:
        raise ValueError(f"{name}: got {count}, expected an integer of at least {lowest}")
    return count


def check_choice(name: str, value: object, choices: Collection[str]) -> None:
    """Refuse a value that is not one of ``choices``; the message names the nearest of them."""
    if value not in tuple(choices):  # JSON may hold what has no hash
        hint = did_you_mean(value, choices)
        raise ValueError(f"{name}: got {value!r}, expected one of {', '.join(choices)}{hint}")


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return the end of an error message: the known name that is most like ``name``, if any is.

    >>> did_you_mean("dungoen", ["paper", "dungeon"])
    '; did you mean dungeon?'
    """
    import difflib  # only errors need it

    near = difflib.get_close_matches(str(name), known, n=1)
    return f"; did you mean {near[0]}?" if near else ""


def known_values(
    what: str,
    values: object,
    of: type[Any],
    *further: str,
    other_words: Mapping[str, str] = {},
) -> dict[str, Any]:
    """Return ``values`` as keyword arguments of the dataclass ``of``.

    Args:
        what: what they are, for the error.
        values: named values, as JSON has them.
        of: the dataclass; its fields are the keys that are known.
        further: keys that are known, too.
        other_words: keys that are not known but likely to be written, with the key that is meant.

    Raises:
        ValueError: no object of named values, or a key that is not known.
    """
    if not isinstance(values, Mapping):
        raise ValueError(f"{what}: got {values!r}, expected an object of named values")
    names = [*further, *(item.name for item in fields(of))]
    unknown = [str(name) for name in values if name not in names]
    if unknown:
        meant = [other_words[name] for name in unknown if name in other_words]
        hint = f"; did you mean {meant[0]}?" if meant else did_you_mean(unknown[0], names)
        keys = "key" if len(unknown) == 1 else "keys"
        raise ValueError(
            f"{what}: unknown {keys}: {', '.join(unknown)}; known are {', '.join(names)}{hint}"
        )
    return dict(values)


def items_of(values: object) -> tuple[Any, ...]:
    """Return the items of a tuple, a list or another sequence; of anything else there are none."""
    return tuple(values) if _is_sequence(values) else ()


def plain_values(values: object) -> Any:
    """Return ``values`` with a dict in place of each mapping, and a list in place of each sequence.

    JSON and checkpoints cannot hold the configurations of other libraries, such as OmegaConf.
    """
    if isinstance(values, Mapping):
        return {name: plain_values(value) for name, value in values.items()}
    return [plain_values(item) for item in values] if _is_sequence(values) else values


def _is_sequence(values: object) -> TypeGuard[Sequence[Any]]:
    """Return whether ``values`` is a sequence of items; text and bytes are not."""
    return isinstance(values, Sequence) and not isinstance(values, (str, bytes, bytearray))


def check_integers(name: str, values: object) -> Range:
    """Return ``values`` as two ints; numpy integers are welcome, floats and bools are not."""
    items = items_of(values)
    if len(items) != 2:
        raise ValueError(f"{name}: got {values!r}, expected 2 integers")
    return _integer(name, items[0]), _integer(name, items[1])


def _integer(name: str, value: Any) -> int:
    with suppress(TypeError):  # of what is no integer, and of arrays
        if not isinstance(value, bool):
            return index(value)
    raise ValueError(f"{name}: got {value!r}, expected an integer")


def check_sides(name: str, values: object) -> Size:
    """Return ``values`` as the (rows, columns) of a map."""
    sides = check_integers(name, values)
    if not 1 <= min(sides) <= max(sides) <= MAX_SIDE:
        raise ValueError(f"{name}: got {sides}, expected 1 to {MAX_SIDE} rows and columns")
    return sides


def check_flag(name: str, value: object) -> None:
    """Refuse what is neither True nor False, such as the text "false", which counts as true."""
    if not isinstance(value, bool):
        raise ValueError(f"{name}: got {value!r}, expected True or False")


def check_number(name: str, value: object) -> float:
    """Return ``value`` as a float; text and bools are no numbers."""
    if hasattr(value, "__float__") and not isinstance(value, (bool, str)):
        with suppress(OverflowError, TypeError):  # of arrays
            return float(value)
    raise ValueError(f"{name}: got {value!r}, expected a number")


def check_probability(name: str, value: object) -> float:
    """Return ``value`` as a float in [0, 1]."""
    probability = check_number(name, value)
    if not 0 <= probability <= 1:
        raise ValueError(f"{name}: got {probability}, expected a probability in [0, 1]")
    return probability


def check_resolution(name: str, value: object) -> float:
    """Return ``value`` as metres per cell: finite, and above 0."""
    resolution = check_number(name, value)
    if not 0 < resolution < math.inf:
        raise ValueError(f"{name}: got {resolution}, expected metres per cell above 0")
    return resolution


def check_fractions(values: object) -> tuple[float, ...]:
    """Return ``values`` as the fractions of the splits, which add up to 1."""
    items = tuple(check_number("splits", item) for item in items_of(values))
    inside = len(items) == len(SPLITS) and all(0 <= item <= 1 for item in items)
    if not inside or abs(sum(items) - 1) > 1e-9:
        raise ValueError(
            f"splits: got {values!r}, expected three fractions in [0, 1] that add up to 1"
        )
    return items


def check_range(name: str, limits: Range, lowest: int, highest: int, why: str = "") -> None:
    """Refuse a range that runs backwards, or that leaves ``lowest`` to ``highest``."""
    low, high = limits
    if low > high:
        raise ValueError(f"{name}: upper limit {high} is under the lower limit {low}")
    if low < lowest:
        raise ValueError(f"{name}: got {limits}, expected at least {lowest}")
    if high > highest:
        raise ValueError(f"{name}: got {limits}, expected at most {highest}{why}")
