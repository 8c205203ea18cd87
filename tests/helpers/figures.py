"""What is drawn in a figure, and whether words are cut off or cover one another."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox


def figure_of(axes: Axes) -> Figure:
    """Return the figure that holds axes."""
    figure = axes.get_figure()
    assert isinstance(figure, Figure)
    return figure


def assert_tidy(figure: Figure) -> None:
    """Check that all words are inside the figure and that none covers another, or a map."""
    figure.draw_without_rendering()
    page, boxes = figure.bbox.padded(0.5), {}
    for k, axes in enumerate(figure.axes):
        ticks = [
            tick.label1
            for axis in (axes.xaxis, axes.yaxis)
            for tick in axis.get_major_ticks()
            if axes.axison
            and min(axis.get_view_interval()) <= tick.get_loc() <= max(axis.get_view_interval())
        ]
        words = [axes.title, axes.xaxis.label, axes.yaxis.label, *ticks, axes.get_legend()]
        for number, word in enumerate(words):
            if (
                word is not None
                and word.get_visible()
                and (not isinstance(word, Text) or word.get_text())
            ):
                boxes[k, number] = word.get_window_extent()
        if axes.axison:
            boxes[k, -1] = axes.get_window_extent()
    for name, box in boxes.items():
        assert page.x0 <= box.x0 and box.x1 <= page.x1, f"{name} is cut off at the side"  # noqa: PT018
        assert page.y0 <= box.y0 and box.y1 <= page.y1, f"{name} is cut off above or below"  # noqa: PT018
    for (a, first), (b, second) in combinations(boxes.items(), 2):
        shared = Bbox.intersection(first.padded(-1), second.padded(-1))
        assert shared is None or shared.width * shared.height <= 0, f"{a} covers {b}"


def drawn(axes: Axes, colour: str) -> list[npt.NDArray[np.int64]]:
    """Return the lines of a colour as cells (row, col)."""
    lines = [
        line
        for line in axes.get_lines()
        if to_hex(line.get_color()).upper() == colour and line.get_linestyle()
    ]
    return [
        np.stack((line.get_ydata(), line.get_xdata()), axis=1).astype(np.int64) for line in lines
    ]


def assert_lines(found: list[npt.NDArray[np.int64]], expected: list[npt.NDArray[np.int64]]) -> None:
    """Compare lists of paths."""
    assert len(found) == len(expected)
    for line, path in zip(found, expected, strict=True):
        np.testing.assert_array_equal(line, path)
