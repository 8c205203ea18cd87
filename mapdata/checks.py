"""Checks of arguments, and of plain values as JSON files and configurations hold them."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields
from operator import index
from typing import Any, TypeGuard

from mapdata.limits import MAX_RESOLUTION, MAX_SIDE, MIN_RESOLUTION, SPLITS, Range, Size


def check_seed(seed: int, name: str = "seed") -> int:
    """Return ``seed`` as an int.

    Raises:
        ValueError: it is not an unsigned integer of 64 bits.
    """
    integer = _as_integer(name, seed)
    if not 0 <= integer < 2**64:
        raise ValueError(f"{name}: got {integer}, expected 0 to 2**64 - 1")
    return integer


def check_count(name: str, value: object, minimum: int = 1) -> int:
    """Return ``value`` as an int.

    Raises:
        ValueError: it is not an integer, or below ``minimum``.
    """
    count = _as_integer(name, value)
    if count < minimum:
        raise ValueError(f"{name}: got {count}, expected an integer of at least {minimum}")
    return count


def check_choice(name: str, value: object, choices: Collection[str]) -> None:
    """Refuse a value that is not in ``choices``.

    Raises:
        ValueError: the message names all choices, and the one that is most similar.
    """
    # The choices may be a dict or a set, where looking up a list from JSON would raise TypeError.
    if value not in tuple(choices):
        hint = did_you_mean(value, choices)
        raise ValueError(f"{name}: got {value!r}, expected one of {', '.join(choices)}{hint}")


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return the end of an error message: the known name that is most similar, if any is similar.

    >>> did_you_mean("dungoen", ["paper", "dungeon"])
    '; did you mean dungeon?'
    """
    import difflib  # imported here, because only error messages need it

    spelled = {known_name.lower(): known_name for known_name in known}
    matches = difflib.get_close_matches(str(name).lower(), spelled, n=1)
    return f"; did you mean {spelled[matches[0]]}?" if matches else ""


def printable(text: str) -> str:
    r"""Return a text, such as the name of a file, with "?" for each letter that cannot be printed.

    Such letters are line ends, tabs and the bytes of a name that are no UTF-8. Python has these
    bytes as lone surrogates, which no file of text and no table can hold.

    >>> printable("plan\udcff 1.png")
    'plan? 1.png'
    """
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def known_values(
    name: str,
    values: object,
    dataclass: type[Any],
    *extra_keys: str,
    synonyms: Mapping[str, str] = {},
) -> dict[str, Any]:
    """Return ``values`` as keyword arguments of a dataclass.

    Args:
        name: name of the argument, which begins error messages.
        values: named values, as JSON has them.
        dataclass: its fields are the known keys.
        extra_keys: further known keys, which are no fields.
        synonyms: unknown keys that users are likely to write, with the known key that they mean.

    Raises:
        ValueError: ``values`` is not an object of named values, or has an unknown key.
    """
    if not isinstance(values, Mapping):
        raise ValueError(f"{name}: got {values!r}, expected an object of named values")
    known_keys = [*extra_keys, *(field.name for field in fields(dataclass))]
    unknown_keys = [str(key) for key in values if key not in known_keys]
    if unknown_keys:
        intended_keys = [synonyms[key] for key in unknown_keys if key in synonyms]
        if intended_keys:
            hint = f"; did you mean {intended_keys[0]}?"
        else:
            hint = did_you_mean(unknown_keys[0], known_keys)
        noun = "key" if len(unknown_keys) == 1 else "keys"
        raise ValueError(
            f"{name}: unknown {noun}: {', '.join(unknown_keys)}; known are "
            f"{', '.join(known_keys)}{hint}"
        )
    return dict(values)


def items_of(values: object) -> tuple[Any, ...]:
    """Return the items of a list, tuple or other sequence; an empty tuple for anything else."""
    return tuple(values) if _is_sequence(values) else ()


def plain_values(values: object) -> Any:
    """Return ``values`` with every mapping turned into a dict and every sequence into a list.

    JSON and checkpoints cannot hold the mappings and sequences of other libraries, such as
    OmegaConf.
    """
    if isinstance(values, Mapping):
        return {key: plain_values(value) for key, value in values.items()}
    if _is_sequence(values):
        return [plain_values(item) for item in values]
    return values


def _is_sequence(values: object) -> TypeGuard[Sequence[Any]]:
    """Return whether ``values`` is a sequence and neither text nor bytes."""
    return isinstance(values, Sequence) and not isinstance(values, (str, bytes, bytearray))


def check_integers(name: str, values: object) -> Range:
    """Return ``values`` as two ints; numpy integers are accepted, floats and bools are not.

    Raises:
        ValueError: it is not a sequence of two integers.
    """
    pair = items_of(values)
    if len(pair) != 2:
        raise ValueError(f"{name}: got {values!r}, expected 2 integers")
    first, second = pair
    return _as_integer(name, first), _as_integer(name, second)


def _as_integer(name: str, value: Any) -> int:
    """Return an integer of Python or numpy as an int; floats and bools are refused."""
    if not isinstance(value, bool):
        with suppress(TypeError):  # raised for floats, texts and arrays
            return index(value)
    raise ValueError(f"{name}: got {value!r}, expected an integer")


def check_sides(name: str, values: object) -> Size:
    """Return ``values`` as the (rows, columns) of a map.

    Raises:
        ValueError: it is not two integers, or a side is below 1 or above `MAX_SIDE`.
    """
    sides = check_integers(name, values)
    if not 1 <= min(sides) <= max(sides) <= MAX_SIDE:
        raise ValueError(f"{name}: got {sides}, expected 1 to {MAX_SIDE} rows and columns")
    return sides


def check_flag(name: str, value: object) -> None:
    """Refuse a value that is not a bool: the text "false", for example, would count as true."""
    if not isinstance(value, bool):
        raise ValueError(f"{name}: got {value!r}, expected True or False")


def check_number(name: str, value: object) -> float:
    """Return ``value`` as a float; numbers as text and bools are refused."""
    if hasattr(value, "__float__") and not isinstance(value, (bool, str)):
        # Integers above the largest float overflow; arrays of several numbers raise TypeError.
        with suppress(OverflowError, TypeError):
            return float(value)
    raise ValueError(f"{name}: got {value!r}, expected a number")


def check_finite(name: str, value: object) -> float:
    """Return ``value`` as a finite float of at least 0.

    Raises:
        ValueError: it is no such number.
    """
    number = check_number(name, value)
    if not 0 <= number < math.inf:
        raise ValueError(f"{name}: got {number}, expected a finite number of at least 0")
    return number


def check_probability(name: str, value: object) -> float:
    """Return ``value`` as a float in [0, 1]."""
    probability = check_number(name, value)
    if not 0 <= probability <= 1:
        raise ValueError(f"{name}: got {probability}, expected a probability in [0, 1]")
    return probability


def check_resolution(name: str, value: object) -> float:
    """Return ``value`` as metres per cell, from `MIN_RESOLUTION` to `MAX_RESOLUTION`."""
    resolution = check_number(name, value)
    if not MIN_RESOLUTION <= resolution <= MAX_RESOLUTION:
        raise ValueError(
            f"{name}: got {resolution}, expected metres per cell above 0, from {MIN_RESOLUTION:g} "
            f"to {MAX_RESOLUTION:g}"
        )
    return resolution


def check_fractions(values: object) -> tuple[float, ...]:
    """Return ``values`` as the fractions of maps in the splits train, val and test.

    Raises:
        ValueError: it is not three fractions in [0, 1] that add up to 1.
    """
    return check_shares("splits", values, len(SPLITS))


def check_shares(name: str, values: object, count: int) -> tuple[float, ...]:
    """Return ``values`` as shares of a whole.

    Raises:
        ValueError: it is not ``count`` fractions in [0, 1] that add up to 1.
    """
    shares = tuple(check_number(name, share) for share in items_of(values))
    are_in_range = all(0 <= share <= 1 for share in shares)
    add_up_to_1 = abs(sum(shares) - 1) <= 1e-9
    if not (len(shares) == count and are_in_range and add_up_to_1):
        number = "three" if count == 3 else count
        raise ValueError(
            f"{name}: got {values!r}, expected {number} fractions in [0, 1] that add up to 1"
        )
    return shares


def check_shares_if_any(name: str, values: object, count: int) -> tuple[float, ...]:
    """Return ``values`` as `check_shares` does; an empty list or tuple, for equal shares, stays.

    Raises:
        ValueError: as `check_shares`.
    """
    is_empty = isinstance(values, (list, tuple)) and len(values) == 0
    return () if is_empty else check_shares(name, values, count)


def check_range(name: str, limits: Range, minimum: int, maximum: int, reason: str = "") -> None:
    """Refuse a range (low, high) that is reversed, or not inside ``minimum`` to ``maximum``.

    Args:
        name: name of the argument, which begins error messages.
        limits: the range, both ends included.
        minimum: lowest allowed number.
        maximum: highest allowed number.
        reason: why there is a maximum, the end of the error message.
    """
    low, high = limits
    if low > high:
        raise ValueError(f"{name}: upper limit {high} is under the lower limit {low}")
    if low < minimum:
        raise ValueError(f"{name}: got {limits}, expected at least {minimum}")
    if high > maximum:
        raise ValueError(f"{name}: got {limits}, expected at most {maximum}{reason}")
