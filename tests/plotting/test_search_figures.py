"""Figures of searches: the cells that were expanded have the colours of their numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.figures import assert_tidy, drawn, figure_of
from helpers.samples import SPEC, build_small
from PIL import Image

from mapdata import Labels, generate, label, search_order
from mapdata.cli import main
from mapdata.formats import Collection, ForeignMap, import_maps
from mapdata.plotting import COLOURS, plot_search
from mapdata.plotting.figures import plot_figure
from mapdata.plotting.search_figures import plot_both_searches, write_search_animation

GRID = np.array([[0, 1, 0], [0, 0, 0]])


@pytest.fixture(scope="module")
def labels() -> Labels:
    """Return labelled maps."""
    return label(generate(SPEC, 5, range(4)))


def test_expanded_cells_are_coloured_by_their_order() -> None:
    """The image over the grid has the numbers, and hides the cells that were not expanded."""
    found = search_order(GRID, (0, 0), (0, 2))
    axes = plot_search(GRID, found.order, found.path)
    shown = axes.images[-1].get_array()
    assert shown is not None
    np.testing.assert_array_equal(np.ma.filled(shown, -1), found.order)
    assert axes.images[-1].get_clim() == (0, 4)
    np.testing.assert_array_equal(drawn(axes, COLOURS["bfs"])[0], found.path)
    assert axes.get_title() == "5 expansions"
    assert_tidy(figure_of(axes))


def test_one_end_of_the_colours_compares_two_searches() -> None:
    """``last`` is the number where they end, whatever this search expanded."""
    found = search_order(GRID, (0, 0), (0, 2))
    axes = plot_search(GRID, found.order, last=99)
    assert axes.images[-1].get_clim() == (0, 99)


def test_what_is_no_order_of_the_map_is_refused() -> None:
    """The result of a search as a whole, and an order on another map."""
    found = search_order([[0, 0, 0]], (0, 0), (0, 2))
    with pytest.raises(ValueError, match=r"order: got SearchOrder, expected \(1, 3\), as in plot_"):
        plot_search([[0, 0, 0]], found)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"order: got shape \(1, 3\), expected \(1, 2\)"):
        plot_search([[0, 0]], found.order)


def test_both_searches_are_those_of_the_labels(labels: Labels) -> None:
    """They show the segment for which A* expands most cells, with the stored numbers."""
    axes = plot_both_searches(labels, 1)
    segment = int(labels.iterations("astar", 1).argmax())
    for ax, search, name in zip(axes, ("bfs", "astar"), ("BFS", "A*"), strict=True):
        count = labels.iterations(search, 1)[segment]
        assert ax.get_title() == f"{name}: {count:,} iterations"
        shown = ax.images[-1].get_array()
        assert shown is not None
        assert np.ma.count(shown) == count
        np.testing.assert_array_equal(
            drawn(ax, COLOURS["bfs"])[0], labels.segment(search, 1, segment)
        )
    assert_tidy(figure_of(axes[0]))


@pytest.mark.slow
def test_the_animation_ends_with_the_figure(labels: Labels, tmp_path: Path) -> None:
    """It has at most 60 pictures, each with more cells than the one before."""
    write_search_animation(labels, 1, tmp_path / "search.gif")
    with Image.open(tmp_path / "search.gif") as animation:
        assert 2 <= animation.n_frames <= 60  # type: ignore[attr-defined]
        coloured = []
        for frame in range(animation.n_frames):  # type: ignore[attr-defined]
            animation.seek(frame)
            pixels = np.asarray(animation.convert("RGB")).astype(int)
            saturation = pixels.max(axis=-1) - pixels.min(axis=-1)
            coloured.append(int((saturation > 40).sum()))
        assert animation.info["duration"] > 1000
    assert (np.diff(coloured) >= 0).all()
    assert coloured[-1] > coloured[0]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), [("search.gif", "GIF"), ("search.png", "PNG")])
def test_the_command_writes_a_picture_or_an_animation(name: str, kind: str, tmp_path: Path) -> None:
    """The ending of the target decides."""
    root = build_small(tmp_path / "d")
    main(["show", str(root), "--figure", "search", "-o", str(tmp_path / name)])
    with Image.open(tmp_path / name) as picture:
        assert picture.format == kind


def test_a_map_with_one_seed_point_has_no_search(tmp_path: Path) -> None:
    """The message has the number of the map."""
    one = ForeignMap("one", np.zeros((5, 5)), seed_points=np.array([[2, 2]]), rooms_known=True)
    import_maps(tmp_path / "d", Collection([one]))
    with pytest.raises(ValueError, match="map 0 has one seed point, so it has no path to search"):
        plot_figure(tmp_path / "d", "search")
