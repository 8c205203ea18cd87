"""Places of labels beside marks: near them, and clear of each other, of marks and of lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mapdata.arrays import Flags, Floats

_GAPS = (2.0, 8.0, 16.0, 26.0, 38.0, 52.0, 68.0, 86.0, 106.0)
"""Points between a mark and its label that are tried; from the second on, a line joins them."""

_ANGLES = np.pi / 8 * np.array([4, 12, 0, 8, 2, 6, 14, 10, 1, 7, 3, 5, 13, 11, 15, 9])
"""Angles from a mark to its label, in the order in which equally good ones are preferred."""


class Box(NamedTuple):
    """A rectangle in points."""

    left: float
    bottom: float
    right: float
    top: float

    def nearest(self, points: Floats) -> Floats:
        """Return the point of the rectangle that is nearest to each of ``points``, (..., 2)."""
        return np.clip(points, (self.left, self.bottom), (self.right, self.top))

    def touches(self, points: Floats, distance: float) -> Flags:
        """Return whether each of ``points``, (n, 2), lies within a distance of the rectangle."""
        is_near: Flags = np.hypot(*(points - self.nearest(points)).T) < distance
        return is_near

    def overlaps(self, other: Box) -> bool:
        """Return whether two rectangles share a point."""
        return (
            self.left < other.right
            and other.left < self.right
            and self.bottom < other.top
            and other.bottom < self.top
        )


class Label(NamedTuple):
    """Where a label is: its rectangle, and points (n, 2) of the line from it to its mark."""

    box: Box
    leader: Floats


@dataclass(frozen=True)
class Drawing:
    """What labels must not cover, in points.

    Attributes:
        page: the axes.
        marks: (n, 2), middles of the marks.
        radius: of a mark.
        lines: (m, 2), points on the lines between and beside marks, which labels should not cover.
    """

    page: Box
    marks: Floats
    radius: float
    lines: Floats

    def place_labels(self, places: Sequence[Floats], sizes: Sequence[Floats]) -> list[Label]:
        """Return where the labels of marks go.

        Each label takes the best place that the others leave. Since the first ones do not know
        those after them, this is repeated.

        Args:
            places: (2,) for each label, the middle of its mark.
            sizes: (2,) for each label, its width and height.
        """
        labels: dict[int, Label] = {}
        for _ in range(4):
            before = dict(labels)
            for k, (place, size) in enumerate(zip(places, sizes, strict=True)):
                labels.pop(k, None)
                labels[k] = self._best_label(place, size, list(labels.values()))
            if all(k in before and before[k].box == labels[k].box for k in labels):
                break
        return [labels[k] for k in range(len(places))]

    def _best_label(self, place: Floats, size: Floats, others: Sequence[Label]) -> Label:
        """Return the best place of one label, near its mark and clear of what is there."""
        best: tuple[float, Label] | None = None
        for gap in _GAPS:
            if best is not None and best[0] <= gap:
                break
            for preference, angle in enumerate(_ANGLES):
                box = _beside(place, size, angle, self.radius + gap)
                leader = np.empty((0, 2))
                if gap > _GAPS[0]:
                    edge = self.radius * np.array([np.cos(angle), np.sin(angle)])
                    leader = np.linspace(box.nearest(place), place + edge, 20)
                label = Label(box, leader)
                badness = self._badness(label, place, others) + gap + preference / 10
                if best is None or badness < best[0]:
                    best = badness, label
        assert best is not None
        return best[1]

    def _badness(self, label: Label, place: Floats, others: Sequence[Label]) -> float:
        """Return how much a label covers, as the distance in points that this is worth."""
        box, leader = label
        is_inside = (
            self.page.left < box.left
            and box.right < self.page.right
            and self.page.bottom < box.bottom
            and box.top < self.page.top
        )
        # Words on words are worse than words on marks and lines.
        covered = 0 if is_inside else 5
        covered += int(box.touches(self.marks, self.radius).sum())
        for other in others:
            covered += 3 * box.overlaps(other.box)
            covered += bool(box.touches(other.leader, 1.0).any())
            covered += bool(other.box.touches(leader, 1.0).any())
            between = leader[:, None] - other.leader
            covered += bool((np.hypot(between[..., 0], between[..., 1]) < 2.0).any())
        # A line ends at the edge of its mark, where marks that overlap with it may be, too.
        is_other = np.hypot(*(self.marks - place).T) >= 2 * self.radius
        to_marks = leader[:, None] - self.marks[is_other]
        covered += bool((np.hypot(to_marks[..., 0], to_marks[..., 1]) < self.radius).any())
        to_lines = float(box.touches(self.lines, 1.0).sum())
        # A label without a line looks like that of the nearest mark.
        gap = np.hypot(*(box.nearest(place) - place))
        nearer = 0 if len(leader) else int(box.touches(self.marks, gap - 0.1).sum())
        return 1000.0 * covered + 4.0 * to_lines + 30.0 * nearer


def _beside(place: Floats, size: Floats, angle: float, distance: float) -> Box:
    """Return a label whose nearest point lies in a direction from a place.

    Args:
        place: (2,), in points.
        size: (2,), width and height of the label.
        angle: of the direction, from the right anticlockwise.
        distance: between the place and the label.
    """
    direction = np.array([np.cos(angle), np.sin(angle)])
    # Above the place the middle of its lower edge is nearest, and in the diagonal its corner.
    nearest = (1 - np.clip(1.5 * direction, -1, 1)) / 2
    corner = place + distance * direction - size * nearest
    return Box(*corner, *(corner + size))
