"""Arrow heads look alike on maps of any size, in figures of any size."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import numpy.typing as npt
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure

from mapdata.plotting.arrows import MIN_DISTANCE, MIN_LENGTH, SPACING
from mapdata.plotting.plot import plot_cells

Floats = npt.NDArray[np.float64]


def l_shaped(side: int) -> npt.NDArray[np.int64]:
    """Return a path that goes down and then to the right, on a map with this many rows."""
    quarter = side // 4
    down = [(row, quarter) for row in range(quarter, 3 * quarter)]
    right = [(3 * quarter, column) for column in range(quarter, 3 * quarter)]
    return np.array(down + right)


def arrow_heads(axes: Axes) -> PathCollection:
    """Draw the figure and return the arrow heads of its only path."""
    figure = axes.get_figure()
    assert isinstance(figure, Figure)
    figure.draw_without_rendering()
    (heads,) = (artist for artist in axes.collections if isinstance(artist, PathCollection))
    return heads


def on_page(axes: Axes) -> Floats:
    """Return where the arrow heads of the only path are drawn, (n, 2), in points."""
    heads = arrow_heads(axes)
    offsets = np.asarray(heads.get_offsets(), np.float64)
    figure = axes.get_figure()
    assert figure is not None
    return np.asarray(heads.get_offset_transform().transform(offsets) * 72 / figure.dpi)


def whole_figure(side: int, inches: float) -> Axes:
    """Return the axes of a map with this many rows and columns, which fill a square figure."""
    axes = Figure(figsize=(inches, inches)).add_axes((0, 0, 1, 1))
    axes.set(xlim=(-0.5, side - 0.5), ylim=(side - 0.5, -0.5), autoscale_on=False)
    return axes


def drawn(side: int, inches: float) -> Axes:
    """Draw the path in a square figure."""
    axes = whole_figure(side, inches)
    plot_cells(axes, l_shaped(side), "black", "a path")
    return axes


def test_the_size_of_the_map_does_not_change_the_arrow_heads() -> None:
    """They are where they are on a map of 64 x 64 cells; once a map of 2,048 cells had
    128 of them.
    """
    small = on_page(drawn(64, 6))
    assert len(small) == 4
    for side in (512, 2048):
        np.testing.assert_allclose(on_page(drawn(side, 6)), small, atol=4)


@pytest.mark.parametrize("inches", [2.5, 3.5, 12])
def test_a_larger_figure_has_more_arrow_heads(inches: float) -> None:
    """Their distances on the page are equal along the path, and about the same in figures of any
    size.
    """
    places = on_page(drawn(128, inches))
    steps = np.abs(np.diff(places, axis=0)).sum(axis=1)
    assert len(places) == round(72 * inches * 127 / 128 / SPACING)
    np.testing.assert_allclose(steps, np.full(len(steps), 72 * inches * 127 / 128 / len(places)))


def test_short_paths_have_no_arrow_head() -> None:
    """The marks at their ends would cover it."""
    axes = whole_figure(64, 6)
    per_cell = 72 * 6 / 64
    for cells in (0, 1, int(MIN_LENGTH / per_cell)):
        plot_cells(axes, np.stack([np.arange(cells), np.arange(cells) * 0], 1), "black", "_")
        assert len(on_page(axes)) == 0
        axes.collections[-1].remove()


def test_arrow_heads_of_a_winding_path_do_not_crowd() -> None:
    """A path through the parallel corridors of a maze returns to where it was."""
    columns = np.concatenate([np.arange(200)[:: 1 - 2 * (k % 2)] for k in range(10)])
    path = np.stack([np.repeat(np.arange(10) * 2, 200), columns], axis=1)
    axes = whole_figure(200, 6)
    plot_cells(axes, path, "black", "a path")
    places = on_page(axes)
    distances = np.linalg.norm(places[:, None] - places[None], axis=-1)
    assert len(places) > 3
    assert distances[~np.eye(len(places), dtype=bool)].min() >= MIN_DISTANCE


def test_arrow_heads_follow_the_scale_when_a_figure_is_drawn_again() -> None:
    """A saved picture has another number of pixels, and axes may be zoomed."""
    axes = drawn(128, 6)
    before = on_page(axes)
    figure = axes.get_figure()
    assert isinstance(figure, Figure)
    figure.savefig(BytesIO(), dpi=300)
    np.testing.assert_allclose(on_page(axes), before)
    figure.set_dpi(50)
    np.testing.assert_allclose(on_page(axes), before)
    axes.set(xlim=(0, 256), ylim=(256, 0))  # half of the scale
    assert len(on_page(axes)) == len(before) // 2
