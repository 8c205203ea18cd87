"""Names beside the marks of a scatter plot, tied to them by lines where marks crowd."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import product
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mapdata.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.path import Path
    from matplotlib.transforms import Bbox

RADIUS = 6
"""Radius of a mark with its edge, in points."""

_GAP = 8
"""Points between the centre of a mark and a name beside it."""

_LINE_LENGTHS = (20, 34, 50, 70, 95, 125, 160, 200)
"""Points between the centre of a mark and a name at the end of a line."""

_ANGLES = tuple(
    math.radians(angle if side > 0 else 180 - angle)
    for angle in (0, 20, 40, 60, 80, -20, -40, -60, -80)
    for side in (1, -1)  # right and left
)
"""Directions from a mark to its name, counterclockwise from the right, in the order of preference:
level, then above and at last below the mark, where the axis is near."""

_COST_OF_A_BAR = 12
"""A name goes this many points farther away, to not cover an interval."""

_COST_OF_A_CROSSING = 6
"""A name goes this many points farther away, so that its line does not meet an interval."""

_COST_OF_A_FAULT = 1000
"""A name goes anywhere instead of covering another name or a mark."""

_ORDERS = range(4, 13)
"""Names are placed in this many different orders; in more than the first number only as long as
there is no arrangement without fault."""

_COST_OF_LEAVING = 5000
"""A name goes anywhere within the axes instead of outside, where it could be cut off."""

_NAME_LINE: dict[str, Any] = {
    "arrowstyle": "-",
    "color": "0.45",
    "linewidth": 0.8,
    "shrinkA": 1,
    "shrinkB": 0,
}


class _Candidate(NamedTuple):
    """A position of a name, in points to the right of its mark and above it.

    Attributes:
        right, up: of the corner or the middle of the side of the name that is next to the mark.
        horizontal, vertical: which corner or side that is, 0 left or bottom, 0.5, 1 right or top.
        has_line: whether a line leads from the mark to the name.
    """

    right: float
    up: float
    horizontal: float
    vertical: float
    has_line: bool


def name_marks(axes: Axes, marks: dict[str, tuple[float, float]], bars: Sequence[Path]) -> None:
    """Write the name of each mark beside it.

    A name without a line is nearer to its own mark than to any other one. Where marks crowd, the
    name is farther away, at the end of a thin line that passes no other mark, name or line. No
    name covers another one or a mark, and it covers an interval only where this saves a long line.

    Args:
        axes: with the marks.
        marks: (x, y) of each name, in the units of the axes; names of marks that are not finite
            are left out.
        bars: the intervals of the marks, in the units of the axes.
    """
    from matplotlib.text import Text

    figure: Any = axes.figure  # matplotlib's type hints also allow None here
    figure.draw_without_rendering()  # makes the layout, on which the sizes of texts depend
    names = [name for name, point in marks.items() if np.isfinite(point).all()]
    if not names:
        return
    points_per_pixel = 72 / figure.dpi
    centres = points_per_pixel * axes.transData.transform([marks[name] for name in names])
    page = _in_points(axes.bbox, points_per_pixel)
    bars_in_points = [
        _path(points_per_pixel * bar.transformed(axes.transData).vertices) for bar in bars
    ]
    sizes = []
    for name in names:
        text = axes.annotate(name, marks[name], fontsize="small")
        box = Text.get_window_extent(text)
        sizes.append((points_per_pixel * box.width, points_per_pixel * box.height))
        text.remove()
    best = min(_arrangements(page, centres, sizes, bars_in_points), key=attrgetter("cost"))
    for k, name in enumerate(names):
        candidate = best.chosen[k]
        line_style = _NAME_LINE | {"relpos": (candidate.horizontal, candidate.vertical)}
        axes.annotate(
            name,
            marks[name],
            (candidate.right, candidate.up),
            textcoords="offset points",
            ha=("left", "center", "right")[round(2 * candidate.horizontal)],
            va=("bottom", "center", "top")[round(2 * candidate.vertical)],
            fontsize="small",
            arrowprops=line_style if candidate.has_line else None,
        )


class _Arrangement:
    """Positions of names, which are chosen one after another; all lengths are in points.

    Attributes:
        boxes, lines, chosen: the names by the numbers of their marks.
        costs: the distances between marks and names, plus what speaks against the positions; low
            is good.
    """

    def __init__(
        self, page: Bbox, centres: Floats, sizes: list[tuple[float, float]], bars: list[Path]
    ) -> None:
        """Begin without names.

        Args:
            page: names lie within it.
            centres: (n, 2), the centres (x, y) of the marks.
            sizes: the n (width, height) of the names.
            bars: the intervals.
        """
        self.page = page
        self.centres = centres
        self.sizes = sizes
        self.bars = bars
        self.boxes: dict[int, Bbox] = {}
        self.lines: dict[int, Path] = {}
        self.chosen: dict[int, _Candidate] = {}
        self.costs: dict[int, float] = {}

    @property
    def cost(self) -> float:
        """The sum of the costs of all names."""
        return math.fsum(self.costs.values())

    def place(self, k: int) -> None:
        """Choose the best position of the name of mark ``k`` beside the other names placed."""
        self.boxes.pop(k, None)
        self.lines.pop(k, None)
        best = None
        min_cost = math.inf
        for distance, candidate in _candidates():
            if distance >= min_cost:
                break
            box, line = self._drawn(k, candidate)
            cost = distance + self._objections(k, box, line)
            if cost < min_cost:
                min_cost = cost
                best = candidate, box, line
        assert best is not None
        self.chosen[k], box, line = best
        self.costs[k] = min_cost
        self.boxes[k] = box
        if line is not None:
            self.lines[k] = line

    def _drawn(self, k: int, candidate: _Candidate) -> tuple[Bbox, Path | None]:
        """Return the box of the name of mark ``k``, and its line from the edge of the mark."""
        from matplotlib.transforms import Bbox

        centre = self.centres[k]
        anchor = centre + np.array([candidate.right, candidate.up])
        width, height = self.sizes[k]
        left = anchor[0] - candidate.horizontal * width
        bottom = anchor[1] - candidate.vertical * height
        box = Bbox.from_bounds(left, bottom, width, height)
        if not candidate.has_line:
            return box, None
        direction = (anchor - centre) / np.linalg.norm(anchor - centre)
        return box, _path(np.array([centre + RADIUS * direction, anchor]))

    def _objections(self, k: int, box: Bbox, line: Path | None) -> float:
        """Return by how much farther away a name would be as good, in points."""
        to_marks = _distances_to_box(self.centres, box)
        is_other = np.arange(len(self.centres)) != k
        from_centre = np.linalg.norm(self.centres - self.centres[k], axis=1)
        padded = box.padded(1.5)
        faults = padded.count_overlaps(list(self.boxes.values()))
        faults += int((to_marks < RADIUS + 1).sum())
        faults += sum(
            placed.intersects_bbox(padded, filled=False) for placed in self.lines.values()
        )
        if line is None:
            # Without a line the name belongs to the nearest mark, which must be clear.
            faults += int((to_marks[is_other] < _GAP + RADIUS / 2).sum())
        else:
            faults += int((to_marks[from_centre > 2 * RADIUS] < 2 * RADIUS).sum())
            # From marks that overlap this one, the line leads away.
            whole_line = np.array([self.centres[k], np.asarray(line.vertices)[-1]])
            to_line = _distances_to_line(self.centres, whole_line)
            faults += int((to_line < np.minimum(RADIUS + 1, 0.7 * from_centre)).sum())
            faults += sum(
                line.intersects_bbox(placed, filled=False) for placed in self.boxes.values()
            )
            faults += sum(
                line.intersects_path(placed, filled=False) for placed in self.lines.values()
            )
        cost = float(_COST_OF_A_FAULT * faults)
        if not all(self.page.contains(*corner) for corner in padded.corners()):
            cost += _COST_OF_LEAVING
        for bar in self.bars:
            if bar.intersects_bbox(box, filled=False):
                cost += _COST_OF_A_BAR
            if line is not None and bar.intersects_path(line, filled=False):
                cost += _COST_OF_A_CROSSING
        return cost


def _arrangements(
    page: Bbox, centres: Floats, sizes: list[tuple[float, float]], bars: list[Path]
) -> Iterator[_Arrangement]:
    """Yield arrangements to choose from; the arguments are those of `_Arrangement`.

    They differ in the order in which the names are placed: one that is placed late may find no
    good position. First come the marks that stand apart, whose names need no line, then random
    orders, always the same ones.
    """
    distances = np.linalg.norm(centres[:, None] - centres, axis=-1)
    order = np.argsort((distances < 4 * RADIUS).sum(axis=1), kind="stable")
    generator = np.random.default_rng(0)
    is_faultless = False
    for count in range(1, _ORDERS.stop):
        arrangement = _Arrangement(page, centres, sizes, bars)
        for k in (*order.tolist(), *order.tolist()):  # the second time, all others are placed
            arrangement.place(k)
        yield arrangement
        is_faultless |= arrangement.cost < _COST_OF_A_FAULT
        if is_faultless and count >= _ORDERS.start:
            return
        order = generator.permutation(order)


def _candidates() -> Iterator[tuple[float, _Candidate]]:
    """Yield positions of a name and their distances from its mark, the nearest first."""
    yield _GAP, _Candidate(_GAP, 0, 0, 0.5, has_line=False)
    yield _GAP, _Candidate(-_GAP, 0, 1, 0.5, has_line=False)
    for up, right in product((1, -1), (1, -1)):
        corner = (0 if right > 0 else 1, 0 if up > 0 else 1)
        yield _GAP + 2, _Candidate(5 * right, 5 * up, *corner, has_line=False)
    for length, angle in product(_LINE_LENGTHS, _ANGLES):
        cosine = math.cos(angle)
        sine = math.sin(angle)
        yield (
            length,
            _Candidate(
                length * cosine,
                length * sine,
                0.5 - 0.5 * _sign(cosine),
                0.5 - 0.5 * _sign(sine),
                has_line=True,
            ),
        )


def _sign(number: float) -> int:
    """Return 1, 0 or -1; 0 also for the rounding errors of a cosine."""
    return (number > 1e-9) - (number < -1e-9)


def _in_points(box: Bbox, points_per_pixel: float) -> Bbox:
    """Return a box in pixels as one in points."""
    from matplotlib.transforms import Bbox

    return Bbox(points_per_pixel * box.get_points())


def _path(points: Floats) -> Path:
    """Return a line through ``points``, (n, 2)."""
    from matplotlib.path import Path

    return Path(points)


def _distances_to_box(points: Floats, box: Bbox) -> Floats:
    """Return the distance of each point, (n, 2), to a box; 0 inside."""
    nearest = np.clip(points, box.min, box.max)
    return np.asarray(np.linalg.norm(points - nearest, axis=1))


def _distances_to_line(points: Floats, line: Floats) -> Floats:
    """Return the distance of each point, (n, 2), to a line between two points, (2, 2)."""
    start, end = line
    along = end - start
    share = np.clip((points - start) @ along / (along @ along), 0, 1)
    return np.asarray(np.linalg.norm(points - (start + share[:, None] * along), axis=1))
