"""What is drawn in a figure, and whether words are cut off or cover one another."""

from __future__ import annotations

from itertools import combinations
from typing import Any

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
    page = figure.bbox.padded(0.5)
    boxes = {}
    insets: list[Any] = [inset for axes in figure.axes for inset in axes.child_axes]
    for k, axes in enumerate([*figure.axes, *insets]):
        words = [axes.title, axes.xaxis.label, axes.yaxis.label, *_ticks(axes), axes.get_legend()]
        for number, word in enumerate(words):
            if word is None or not word.get_visible():
                continue
            if isinstance(word, Text) and not word.get_text():
                continue
            boxes[k, number] = word.get_window_extent()
        if axes.axison:
            boxes[k, -1] = axes.get_window_extent()
    for name, box in boxes.items():
        assert page.x0 <= box.x0, f"{name} is cut off on the left"
        assert box.x1 <= page.x1, f"{name} is cut off on the right"
        assert page.y0 <= box.y0, f"{name} is cut off below"
        assert box.y1 <= page.y1, f"{name} is cut off above"
    for (a, first), (b, second) in combinations(boxes.items(), 2):
        shared = Bbox.intersection(first.padded(-1), second.padded(-1))
        assert shared is None or shared.width * shared.height <= 0, f"{a} covers {b}"


def _ticks(axes: Axes) -> list[Text]:
    """Return the labels of the ticks that are inside the axes."""
    found = []
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        for tick in axis.get_major_ticks():
            if axes.axison and low <= tick.get_loc() <= high:
                found.append(tick.label1)
    return found


def drawn(axes: Axes, colour: str) -> list[npt.NDArray[np.int64]]:
    """Return the lines of a colour as cells (row, col)."""
    found = []
    for line in axes.get_lines():
        if to_hex(line.get_color()).upper() == colour and line.get_linestyle():
            cells = np.stack((line.get_ydata(), line.get_xdata()), axis=1)
            found.append(cells.astype(np.int64))
    return found


def assert_lines(found: list[npt.NDArray[np.int64]], expected: list[npt.NDArray[np.int64]]) -> None:
    """Compare lists of paths."""
    assert len(found) == len(expected)
    for line, path in zip(found, expected, strict=True):
        np.testing.assert_array_equal(line, path)


def ends_of(axes: Axes) -> dict[str, tuple[float, float]]:
    """Return where the texts S and G stand, as (row, col)."""
    places = {text.get_text(): text.get_position() for text in axes.texts}
    return {letter: places[letter][::-1] for letter in ("S", "G") if letter in places}
