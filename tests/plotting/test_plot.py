"""Figures of one map: what is drawn is what is stored, and nothing is cut off or covers something
else.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from helpers.examples import slow
from helpers.figures import assert_lines, assert_tidy, drawn, figure_of
from helpers.samples import SPEC, WIDE, build_small
from matplotlib.collections import PathCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from mapdata import Labels, MapSpec, Terrain, generate, label, pull_taut
from mapdata.plotting import COLOURS, PALETTE, STYLE, plot_grid, plot_map, plot_matrix, plot_path
from mapdata.plotting.figures import plot_figure
from mapdata.plotting.plot import mark, plot_cells

OKABE_ITO = {"#000000", "#e69f00", "#56b4e9", "#009e73", "#f0e442", "#0072b2", "#d55e00", "#cc79a7"}


def some(generator: MapSpec, maps: int = 30) -> Labels:
    """Return labelled maps."""
    return label(generate(generator, 5, range(maps)))


@pytest.mark.parametrize("generator", [SPEC, WIDE], ids=["square", "wide"])
def test_map_shows_both_stored_routes_and_numbered_seeds(generator: MapSpec) -> None:
    """The lines of both searches go through the cells of their routes, and seed points are numbered
    from 1.
    """
    labels = some(generator)
    for i in range(3):
        axes = plot_map(labels, i)
        for search in ("bfs", "astar"):
            assert_lines(drawn(axes, COLOURS[search]), labels.route(search, i))
        n = int(labels.maps.rooms[i])
        assert [text.get_text() for text in axes.texts] == [str(k + 1) for k in range(n)]
        places = [(text.get_position()[1], text.get_position()[0]) for text in axes.texts]
        np.testing.assert_array_equal(places, labels.maps.seed_points[i, :n])
        state = "all connected" if labels.all_connected[i] else "not all connected"
        assert axes.get_title() == f"map{i}: {n} rooms, {state}"


@pytest.mark.parametrize("generator", [SPEC, WIDE, MapSpec()], ids=["square", "wide", "paper"])
@pytest.mark.parametrize("layout", [None, "constrained"])
def test_map_fits_into_any_figure(generator: MapSpec, layout: str | None) -> None:
    """No texts overlap, with and without a constrained layout."""
    figure = Figure() if layout is None else Figure(layout="constrained")
    plot_map(some(generator, 1), 0, figure.add_subplot())
    assert_tidy(figure)


@pytest.mark.slow
@pytest.mark.parametrize("rooms", [2, 5, 9, 120])
def test_own_figures_are_tidy(rooms: int) -> None:
    """No texts overlap in figures of maps with few or many rooms."""
    generator = MapSpec((64, 64), (rooms, rooms), (3, 9), (3, 9), (1, 2))
    labels = some(generator, 1)
    for axes in (
        plot_map(labels, 0),
        plot_path(labels, 0),
        plot_matrix(labels, 0, "bfs"),
        plot_path(labels, 0, "bfs"),
    ):
        assert_tidy(figure_of(axes))


def test_free_cells_are_white_or_in_the_papers_colours_black() -> None:
    """Occupied cells are dark grey, or white in the paper's colours."""
    grid = np.array([[0, 1], [1, 1]])
    for paper, free, occupied in ((False, 1.0, 0.2), (True, 0.0, 1.0)):
        image = plot_grid(grid, paper_colours=paper).get_images()[0]
        shades = np.asarray(image.to_rgba(grid))[..., 0]
        assert shades[0, 0] == pytest.approx(free)
        assert shades[0, 1] == pytest.approx(occupied, abs=0.05)


def test_terrain_is_drawn_in_shades() -> None:
    """The costs of the free cells, under the routes and seed points of a map."""
    labels = label(generate(Terrain((9, 11), costs=(2, 3, 8), seed_points=3), 3, range(2)))
    assert labels.maps.terrain is not None
    for axes in (plot_map(labels, 1), plot_path(labels, 1)):
        _, shade = axes.get_images()
        values: Any = shade.get_array()
        terrain = labels.maps.terrain[1]
        np.testing.assert_array_equal(values.compressed(), terrain[terrain > 0])


def test_path_shows_each_segment_with_its_iterations() -> None:
    """The lines are the stored segments, and the legend names their moves and iterations."""
    labels = some(SPEC)
    i = int(np.flatnonzero(~labels.all_connected)[0])
    for search in ("bfs", "astar"):
        axes = plot_path(labels, i, search)
        found = [
            np.stack((line.get_ydata(), line.get_xdata()), axis=1).astype(np.int64)
            for line in axes.get_lines()
        ]
        assert_lines(found, labels.route(search, i))
        assert axes.get_lines()[0].get_color() == COLOURS[search]
        other = COLOURS["bfs" if search == "astar" else "astar"]
        assert other not in {line.get_color() for line in axes.get_lines()}
        legend = axes.get_legend()
        assert legend is not None
        expected = [
            f"{q + 1} to {q + 2}: {f'{len(path) - 1} moves' if len(path) else 'no path'}, {count} "
            "iterations"
            for q, (path, count) in enumerate(
                zip(labels.route(search, i), labels.iterations(search, i).tolist(), strict=True)
            )
        ]
        assert [text.get_text() for text in legend.get_texts()] == expected
        assert any("no path" in text for text in expected)


def test_a_taut_path_shows_the_taut_line_of_each_segment() -> None:
    """Its points are those of `pull_taut`, with whole numbers in the middles of cells."""
    labels = some(SPEC)
    i = int(np.flatnonzero(labels.all_connected)[0])
    grid = labels.maps.occupancy[i]
    lines = plot_path(labels, i, taut=True).get_lines()
    route = labels.route("astar", i)
    assert len(route) >= 1
    for line, path in zip(lines, route, strict=True):
        drawn_points = np.stack((line.get_ydata(), line.get_xdata()), axis=1)
        np.testing.assert_array_equal(drawn_points + 0.5, pull_taut(grid, path))


def test_the_legend_of_many_segments_names_the_first_16() -> None:
    """A route of 40 rooms has 39 segments."""
    labels = some(MapSpec((64, 64), (40, 40), (3, 5), (3, 5), (1, 2)), 1)
    legend = plot_path(labels, 0).get_legend()
    assert legend is not None
    texts = [text.get_text() for text in legend.get_texts()]
    assert [text.partition(":")[0] for text in texts] == [f"{q} to {q + 1}" for q in range(1, 17)]


def test_routes_lie_side_by_side_and_show_their_direction() -> None:
    """The lines of both searches are some points apart, and each arrow head points to the goal."""
    labels = some(MapSpec(), 1)
    axes = plot_map(labels, 0)
    figure_of(axes).draw_without_rendering()
    # where cell (0, 0) of a route of each search is drawn, in pixels
    corners = {
        to_hex(line.get_color()).upper(): line.get_transform().transform((0, 0))
        for line in axes.get_lines()
    }
    apart = corners[COLOURS["astar"]] - corners[COLOURS["bfs"]]
    assert np.abs(apart).min() > 2

    steps = {"<": (0, -1), ">": (0, 1), "^": (-1, 0), "v": (1, 0), "/": (-1, 1), "steep": (-2, 1)}
    for way, (down, right) in steps.items():
        path = np.array([(30 + down * k, 30 + right * k) for k in range(12)])
        axes = plot_grid(np.zeros((61, 61)))
        plot_cells(axes, path, "black", "a path")
        figure_of(axes).draw_without_rendering()
        (arrow,) = (one for one in axes.collections if isinstance(one, PathCollection))
        points = np.asarray(arrow.get_paths()[0].vertices)[:3]
        along = points @ (right, -down)  # on the screen, where rows grow downwards
        left, last, tip = points[np.argsort(along)]
        assert along.max() > 0 > along.min(), way  # the base lies behind, the tip before,
        assert np.dot(left - last, (right, -down)) == pytest.approx(0), way
        # and no other corner could be taken for it
        assert np.linalg.norm(tip - left) > 1.5 * np.linalg.norm(last - left), way
    plot_cells(axes, np.empty((0, 2), np.int64), "black", "no path")


def test_a_line_stays_within_a_cell_of_its_path() -> None:
    """On a large map a cell is less than a point, and both of two equal paths are still seen."""
    for side in (20, 64, 1600):
        axes = plot_grid(np.zeros((side, side)))
        path = np.array([(3, k) for k in range(12)])
        for lane in (-1, 1):
            plot_cells(axes, path, "black", "a path", lane=lane)
        figure_of(axes).draw_without_rendering()
        cell = np.abs(axes.transData.transform((1, 1)) - axes.transData.transform((0, 0)))
        for line in axes.get_lines():
            shift = line.get_transform().transform((3, 3)) - axes.transData.transform((3, 3))
            assert (np.abs(shift) < 0.7 * cell).all(), side
        widths = [line.get_linewidth() for line in axes.get_lines()]
        assert widths[0] - widths[1] > 1 if side == 1600 else widths[0] == widths[1], side


def test_start_and_goal_have_different_shapes() -> None:
    """So they differ in black and white, too."""
    axes = plot_grid(np.zeros((9, 9)))
    for text in ("S", "G", "1"):
        mark(axes, text, 4, 4)
    discs: list[Any] = [text.get_bbox_patch() for text in axes.texts]
    start, goal, room = (type(disc.get_boxstyle()) for disc in discs)
    assert start == room != goal


def test_the_style_applies_to_new_figures_only() -> None:
    """Axes of the user and the user's settings do not change."""
    before = dict(mpl.rcParams)
    assert set(STYLE) <= set(before)
    ours = plot_grid(np.zeros((9, 9)))
    theirs = plot_grid(np.zeros((9, 9)), Figure().add_subplot())
    assert to_hex(ours.spines["top"].get_edgecolor()) == to_hex(STYLE["axes.edgecolor"])
    assert to_hex(theirs.spines["top"].get_edgecolor()) == to_hex(before["axes.edgecolor"])
    assert dict(mpl.rcParams) == before


@pytest.mark.parametrize("generator", [SPEC, slow(WIDE)], ids=["4", "8"])
def test_matrix_shows_each_cost_and_hatches_pairs_without_a_path(generator: MapSpec) -> None:
    """Texts and colours are those of the stored matrix."""
    labels = some(generator)
    i = int(np.flatnonzero(~labels.all_connected)[0])
    for search in ("bfs", "astar"):
        axes, matrix = plot_matrix(labels, i, search), labels.matrix(search, i)
        texts = {
            (round(text.get_position()[1]), round(text.get_position()[0])): text.get_text()
            for text in axes.texts
        }
        assert texts == {
            (r + 1, c + 1): f"{matrix[r, c]:.4g}" for r, c in np.argwhere(matrix >= 0).tolist()
        }
        # what the image leaves out shows the hatched background
        (image,) = axes.get_images()
        values: Any = image.get_array()
        np.testing.assert_array_equal(values.mask, matrix < 0)
        np.testing.assert_array_equal(values.compressed(), matrix[matrix >= 0])
        assert axes.patch.get_hatch()
        legend = axes.get_legend()
        assert legend is not None
        assert [text.get_text() for text in legend.get_texts()] == ["no connection"]
        assert_tidy(figure_of(axes))
    connected = int(np.flatnonzero(labels.all_connected)[0])
    assert plot_matrix(labels, connected).get_legend() is None


def test_equal_matrices_are_drawn_once(tmp_path: Path) -> None:
    """Both searches agree on all costs if all moves cost 1; with costlier diagonals BFS counts
    moves.
    """
    for generator, names in ((SPEC, ["BFS and A*"]), (WIDE, ["BFS", "A*"])):
        figure = plot_figure(build_small(tmp_path / str(len(names)), generator), "matrix", index=7)
        titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
        assert titles == [f"map7: connection matrix by {name}" for name in names]


def test_colours_are_those_of_okabe_and_ito() -> None:
    """Colour-blind readers can tell them apart, and each meaning has a colour of its own."""
    assert len(set(COLOURS.values())) == len(COLOURS)
    assert {colour.lower() for colour in (*COLOURS.values(), *PALETTE)} <= OKABE_ITO


@pytest.mark.slow
def test_matplotlib_is_imported_when_drawing() -> None:
    """The import of the module alone does not load matplotlib."""
    names = ", ".join(f"mapdata.{name}" for name in ("plotting", "shards"))
    script = f"import sys, {names}; print('matplotlib' in sys.modules)"
    found = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=Path.cwd()
    )
    assert found.stdout == "False\n"
