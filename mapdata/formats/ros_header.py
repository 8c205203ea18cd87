"""The .yaml of a ROS map: its fields, checked, and the picture that it names."""

from __future__ import annotations

import math
import os
import re
from contextlib import suppress
from pathlib import Path, PureWindowsPath
from typing import Any, NamedTuple

import yaml

from mapdata.checks import check_resolution
from mapdata.formats.files import LIMITS, Limits, check_file, checked_inside, read_text
from mapdata.formats.images import PICTURES
from mapdata.npy import FormatError, refusing

MODES = ("trinary", "scale", "raw")

MAX_YAML_BYTES = 2**16
"""Maximal size of a .yaml file; that of a map has some 200 bytes."""

MAX_YAML_DEPTH = 16
"""Maximal nesting of lists and mappings; in the .yaml of a map it is 2."""

_MAP_FIELDS = re.compile(rb"""\b(image|free_thresh|occupied_thresh)['"]?\s*:""")
"""What tells the .yaml of a map from other files with this ending, such as parameters of nodes."""

_MESSAGE = re.compile(rb"""^["']?data["']?\s*:\s*(\[|-\s)\s*-?[0-9]+\s*[],\n]""", re.MULTILINE)
"""What tells a message, as ``ros2 topic echo`` prints it: a list of integers named data."""

_OPENING_TOKENS = (
    yaml.BlockMappingStartToken,
    yaml.BlockSequenceStartToken,
    yaml.FlowMappingStartToken,
    yaml.FlowSequenceStartToken,
)

_CLOSING_TOKENS = (yaml.BlockEndToken, yaml.FlowMappingEndToken, yaml.FlowSequenceEndToken)


def is_ros_map(path: Path) -> bool:
    """Return whether a .yaml file is that of a map, or a printed message that holds one."""
    with path.open("rb") as file:
        start = file.read(MAX_YAML_BYTES)
    return bool(_MAP_FIELDS.search(start) or _MESSAGE.search(start))


class Header(NamedTuple):
    """The fields of a .yaml file.

    Attributes:
        picture: path of the picture.
        resolution: metres per cell.
        origin: (x, y, yaw) of the lower left corner, in metres and radians.
        mode: trinary, scale or raw.
        negate: whether white is occupied.
        low: probability below which a cell is free.
        high: probability above which a cell is occupied.
    """

    picture: Path
    resolution: float
    origin: tuple[float, float, float]
    mode: str
    negate: bool
    low: float
    high: float


def read_header(path: Path, limits: Limits) -> Header:
    """Return the fields of a .yaml file.

    Args:
        path: of the file.
        limits: say whether a picture that is a link is followed.

    Raises:
        FormatError: fields missing or out of range, a picture that is missing or outside the
            yaml's folder.
    """
    fields = _read_yaml(path)
    resolution = _number(path, "resolution", fields["resolution"])
    try:
        check_resolution("resolution", resolution)
    except ValueError as error:
        raise FormatError(f"{path}: {error}") from None
    low = _number(path, "free_thresh", fields["free_thresh"])
    high = _number(path, "occupied_thresh", fields["occupied_thresh"])
    if not 0 <= low <= high <= 1:
        raise FormatError(
            f"{path}: free_thresh {low} and occupied_thresh {high}, expected 0 <= free <= "
            "occupied <= 1"
        )
    negate = fields.get("negate", 0)
    if negate not in (0, 1) or isinstance(negate, float):
        raise FormatError(f"{path}: negate is {negate!r}, expected 0 or 1")
    mode = str(fields.get("mode", "trinary")).lower()
    if mode not in MODES:
        raise FormatError(f"{path}: mode is {mode[:40]!r}, expected {', '.join(MODES)}")
    if mode == "raw" and negate:
        raise FormatError(
            f"{path}: mode raw with negate: ROS 1 turns values round, Nav2 does not; say negate: 0"
        )
    origin = fields.get("origin", [0.0, 0.0, 0.0])
    if not isinstance(origin, list) or len(origin) != 3:
        raise FormatError(f"{path}: origin is {str(origin)[:40]!r}, expected [x, y, yaw]")
    x, y = (_number(path, "origin", coordinate) for coordinate in origin[:2])
    # Old versions of map_saver write nan for the yaw of a map without rotation.
    yaw = math.nan if _is_nan(origin[2]) else _number(path, "origin", origin[2])
    return Header(
        picture=_picture_path(path, fields["image"], limits),
        resolution=resolution,
        origin=(x, y, yaw),
        mode=mode,
        negate=bool(negate),
        low=low,
        high=high,
    )


def _read_yaml(path: Path) -> dict[str, Any]:
    """Return the fields of a .yaml file by name, after checking that required ones are there.

    Raises:
        FormatError: not YAML, or a required field is missing.
    """
    with refusing(f"{path}: cannot be read"):
        check_file(path, LIMITS)
        with path.open("rb") as file:
            start = file.read(MAX_YAML_BYTES)
    if _MESSAGE.search(start) and not _MAP_FIELDS.search(start):
        raise FormatError(
            f"{path}: is a message, such as an OccupancyGrid, and not the YAML of a map: save the "
            "topic with map_saver, or see 'Messages' in docs/formats/ros.md"
        )
    text = read_text(path, Limits(unpacked=MAX_YAML_BYTES))
    with refusing(f"{path}: not plain YAML"):
        _check_tokens(path, text)
        fields = yaml.safe_load(text)
    if not isinstance(fields, dict):
        fields = {}
    for name in ("image", "resolution", "free_thresh", "occupied_thresh"):
        if name not in fields:
            raise FormatError(f"{path}: has no field {name!r}, expected the YAML of a ROS map")
    return fields


def _check_tokens(path: Path, text: str) -> None:
    """Refuse YAML whose parsing would take minutes.

    The scanner yields tokens one by one, so the text after the first bad token is not scanned.

    Raises:
        FormatError: an alias, or lists and mappings nested deeper than `MAX_YAML_DEPTH`.
    """
    depth = 0
    for token in yaml.scan(text):
        # Aliases of aliases multiply: 700 bytes can take minutes to expand.
        if isinstance(token, yaml.AliasToken):
            raise FormatError(f"{path}: not plain YAML (an alias: write out what it stands for)")
        # The time that the scanner takes grows with the square of the depth.
        if isinstance(token, _OPENING_TOKENS):
            depth += 1
        elif isinstance(token, _CLOSING_TOKENS):
            depth -= 1
        if depth > MAX_YAML_DEPTH:
            raise FormatError(
                f"{path}: not plain YAML (lists or mappings in one another more than "
                f"{MAX_YAML_DEPTH} deep, expected the flat YAML of a ROS map)"
            )


def _number(path: Path, name: str, value: object) -> float:
    """Return the value of a field as a finite number.

    Text is accepted if it is the text of a number, since 5e-2 without a point is text in YAML 1.1.

    Raises:
        FormatError: not a number, infinite or NaN.
    """
    number = math.nan
    if isinstance(value, (int, float, str)) and not isinstance(value, bool):
        with suppress(ValueError, OverflowError):
            number = float(value)
    if not math.isfinite(number):
        raise FormatError(f"{path}: {name} is {str(value)[:40]!r}, expected a finite number")
    return number


def _is_nan(value: object) -> bool:
    """Return whether the value of a field is NaN, also as the text that C++ writes."""
    if isinstance(value, str):
        return value.strip().lower() in ("nan", "-nan")
    return isinstance(value, float) and math.isnan(value)


def _picture_path(path: Path, name: object, limits: Limits) -> Path:
    """Return the path of the picture that the .yaml file ``path`` names.

    It must lie in the folder of the .yaml, as `checked_inside` has it.

    Raises:
        FormatError: not a name, a missing picture, or a picture outside the folder.
    """
    if not isinstance(name, str) or not name or "\0" in name:
        raise FormatError(f"{path}: image is {str(name)[:40]!r}, expected the name of a picture")
    folder = path.parent
    with refusing(f"{path}: image is {name[:80]!r}"):
        picture = Path(os.path.abspath(folder / name))
        is_inside = picture.is_relative_to(os.path.abspath(folder))
        if is_inside and picture.is_file():
            return checked_inside(picture, folder, limits)
    fault = "is missing" if is_inside else "lies outside the folder of the yaml"
    advice = ""
    base_name = PureWindowsPath(name).name
    stem = PureWindowsPath(name).stem
    # The picture may have been moved, or converted to another type.
    candidates = [base_name, *(f"{stem}{ending}" for ending in PICTURES)]
    for candidate in candidates:
        if candidate and candidate != name and (folder / candidate).is_file():
            advice = f"; say image: {candidate}, which lies beside it"
            break
    raise FormatError(f"{path}: image {name[:80]!r} {fault}{advice}")
