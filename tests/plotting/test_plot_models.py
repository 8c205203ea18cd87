"""Figures of what models do: the paths and roadmaps drawn are those given, and nothing is cut off
or covered.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers.examples import slow
from helpers.figures import assert_lines, assert_tidy, drawn, ends_of, figure_of
from helpers.samples import WIDE, build_small
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection

from mapdata import MapDataset, Maze, Movement, OnlineMapDataset, Sample, Terrain, generate
from mapdata.plotting import COLOURS, plot_prediction, plot_roadmap, plot_sample


def test_a_figure_shows_the_fields_of_its_sample(tmp_path: Path) -> None:
    """Map, start, goal, path and the title are those of the sample."""
    root = build_small(tmp_path / "d", WIDE)
    for fields in (("map", "start", "goal", "path", "cost", "hardness"), ("path", "free")):
        ds = MapDataset(root, split=None, fields=fields)
        sample = ds[4]
        values = sample._asdict()
        axes = plot_sample(sample)
        image = axes.get_images()[0].get_array()
        np.testing.assert_array_equal(
            image, values["map"][0] if "map" in values else 1 - values["free"][0]
        )
        path = np.asarray(values["path"])
        assert_lines(drawn(axes, COLOURS["astar"]), [path[path[:, 0] >= 0]])
        marks = {text.get_text(): text.get_position()[::-1] for text in axes.texts}
        expected = {"S": values["start"], "G": values["goal"]} if "start" in values else {}
        assert marks == {letter: tuple(cell.tolist()) for letter, cell in expected.items()}
        assert_tidy(figure_of(axes))


def test_samples_without_a_map_and_empty_batches_are_refused(tmp_path: Path) -> None:
    """The message names the argument."""
    root = build_small(tmp_path / "d")
    with pytest.raises(ValueError, match=r"got Sample\(start=.*, expected one sample, or more"):
        plot_sample(MapDataset(root, fields=("start",))[0])
    with pytest.raises(ValueError, match="sample: got a batch without problems"):
        plot_sample(MapDataset(root)[0:0])
    with pytest.raises(ValueError, match=r"got Sample\(map=uint8 \(3, .* more without axes"):
        plot_sample(MapDataset(root)[:3], plot_sample(MapDataset(root)[0]))


@pytest.mark.parametrize("count", [1, slow(5), slow(12)])
@pytest.mark.parametrize("dtype", [None, torch.float32])
def test_batch_is_a_grid_of_its_first_samples(
    tmp_path: Path, count: int, dtype: torch.dtype | None
) -> None:
    """There are at most 9, each drawn as it is alone, and axes without a sample are empty."""
    fields = ("map", "path_mask", "start", "goal", "path", "cost", "optimal_moves")
    dataset = MapDataset(build_small(tmp_path / "d", WIDE), fields=fields, dtype=dtype)
    figure = figure_of(plot_sample(dataset[:count]))
    shown = [axes for axes in figure.axes if axes.axison]
    assert len(shown) == min(count, 9)
    for k, axes in enumerate(shown):
        alone = plot_sample(dataset[k])
        assert axes.get_title() == alone.get_title()
        assert_lines(drawn(axes, COLOURS["astar"]), drawn(alone, COLOURS["astar"]))
        (image,) = axes.get_images()
        np.testing.assert_array_equal(np.asarray(image.get_array()), np.asarray(dataset[k].map[0]))
    assert_tidy(figure)


def far_from_start(sample: Sample) -> torch.Tensor:
    """Return a field of one's own, as large as a map."""
    rows = torch.arange(9).reshape(1, 1, 9, 1)
    distance: torch.Tensor = (rows - sample.start[:, :1, None, None]).abs().expand(-1, 1, 9, 70)
    return distance


def assert_as_high(scale: Any, axes: Axes) -> None:
    """Check that a scale is as high as the map beside it, once the figure is laid out."""
    figure_of(axes).draw_without_rendering()
    scale_box, box = (each.get_window_extent() for each in (scale, axes))
    assert (scale_box.y0, scale_box.y1) == pytest.approx((box.y0, box.y1))


@pytest.mark.parametrize("number", [3, 9])
@pytest.mark.parametrize("field", ["cost_to_go", "heuristic_ratio", far_from_start])
def test_first_dense_field_is_a_shade(tmp_path: Path, field: Any, number: int) -> None:
    """It shows values of free cells that reach the goal, with a scale that bears the
    field's name. Other free cells are grey.
    """
    fields = ("map", "goal_mask", "start", "goal", field, "path_probability")
    sample = MapDataset(build_small(tmp_path / "d", WIDE), fields=fields)[number]
    axes = plot_sample(sample)
    _, shade, *greys = axes.get_images()
    values: Any = shade.get_array()
    truth = np.asarray(sample[4][0])
    is_ratio = field == "heuristic_ratio"  # it is 0 on cells that do not reach the goal
    no_value = truth <= 0 if is_ratio else truth < 0
    np.testing.assert_array_equal(values.mask, (np.asarray(sample.map[0]) == 1) | no_value)
    np.testing.assert_array_equal(values.compressed(), truth[~values.mask])
    expected = (min(values.min(), 0.9), 1) if is_ratio else (0, values.max())
    assert shade.get_clim() == pytest.approx(expected)
    unreachable = no_value & (np.asarray(sample.map[0]) == 0)
    assert len(greys) == int(unreachable.any())
    for grey in greys:
        greys_mask: Any = grey.get_array()
        np.testing.assert_array_equal(greys_mask.mask, ~unreachable)
    (scale,) = axes.child_axes
    assert scale.get_ylabel() == sample._fields[4]
    assert_as_high(scale, axes)
    assert_tidy(figure_of(axes))


def test_the_samples_of_a_batch_have_one_scale(tmp_path: Path) -> None:
    """It reaches to the highest value of all that are shown, and stands once in the figure."""
    fields = ("map", "start", "goal", "cost_to_go")
    dataset = MapDataset(build_small(tmp_path / "d", WIDE), fields=fields)
    count = 4
    figure = figure_of(plot_sample(dataset[:count]))
    *maps, scale = figure.axes
    shades = [axes.get_images()[1] for axes in maps]
    assert len(shades) == count
    assert scale.get_ylabel() == "cost_to_go"
    highest = [float(dataset[k].cost_to_go.max()) for k in range(count)]
    assert len(set(highest)) > 1
    for shade in shades:
        assert shade.get_clim() == pytest.approx((0, max(highest)))
    assert_tidy(figure)


def test_costs_of_terrain_are_a_shade_unless_another_field_is_dense() -> None:
    """`dataset.plot` draws them, with start, goal and path on top, whatever fields are served."""
    hills = Terrain((9, 11), costs=(2, 3, 8), obstacles=0.2, seed_points=4)
    dataset = OnlineMapDataset(hills, 3, 4, fields=("cost",))
    axes = dataset.plot(1)
    _, shade = axes.get_images()
    values: Any = shade.get_array()
    terrain = generate(hills, 3, [1]).terrain
    assert terrain is not None
    np.testing.assert_array_equal(values.mask, terrain[0] == 0)
    np.testing.assert_array_equal(values.compressed(), terrain[0][terrain[0] > 0])
    assert axes.child_axes[0].get_ylabel() == "terrain"
    assert [text.get_text() for text in axes.texts] == ["S", "G"]
    assert len(axes.get_lines()) == 1
    assert_tidy(figure_of(axes))
    dense = OnlineMapDataset(hills, 3, 4, fields=("terrain", "cost_to_go")).plot(1)
    assert dense.child_axes[0].get_ylabel() == "cost_to_go"
    uniform = OnlineMapDataset(Maze((9, 11)), 3, 4, fields=("map", "terrain"))
    assert len(plot_sample(uniform[0]).get_images()) == 1


def test_waypoints_are_drawn_as_points_of_a_line(tmp_path: Path) -> None:
    """With whole numbers in the middles of cells; those that were refused are not drawn."""
    fields = ("map", "waypoints")
    sample = MapDataset(build_small(tmp_path / "d", WIDE), fields=fields)[3]
    (line,) = plot_sample(sample).get_lines()
    points = np.stack((line.get_ydata(), line.get_xdata()), axis=1)
    np.testing.assert_array_equal(points + 0.5, sample.waypoints)
    refused = sample._replace(waypoints=sample.waypoints * 0 - 1)
    assert len(plot_sample(refused).get_lines()) == 0


def legend_of(axes: Axes) -> list[str]:
    """Return the words of a legend."""
    legend = axes.get_legend()
    assert legend is not None
    return [text.get_text() for text in legend.get_texts()]


def test_a_prediction_is_drawn_with_the_shortest_path_and_marks_collisions() -> None:
    """Padding is left out, and crosses mark the predicted cells that are occupied."""
    grid = np.zeros((6, 8), np.uint8)
    grid[2, 2:5] = 1
    truth = np.array([[2, 1], [1, 1], [1, 2], [1, 3], [1, 4], [1, 5], [2, 5], [-1, -1]])
    predicted = np.array(
        [[2, 1], [2, 2], [2, 3], [2, 4], [2, 5], [2, 9]]
    )  # through the wall, and out of the map
    axes = plot_prediction(grid, predicted, truth, scores=np.linspace(0, 1, 48).reshape(6, 8))
    assert_lines(drawn(axes, COLOURS["astar"]), [truth[:-1]])
    assert_lines(drawn(axes, COLOURS["predicted"]), [predicted])
    assert_lines(drawn(axes, "#E69F00"), [predicted[1:4]])
    assert ends_of(axes) == {"S": (2, 1), "G": (2, 5)}
    assert_tidy(figure_of(axes))
    # Its last step is a jump, so that it has no cost.
    assert legend_of(axes) == ["shortest, cost 6", "predicted, 6 cells", "3 in walls"]
    assert "predicted: no path" in legend_of(plot_prediction(grid, np.empty((0, 2)), truth))
    plot_prediction(grid, np.empty((0, 2)), np.empty((0, 2)))


def test_the_legend_of_a_prediction_has_the_costs_of_both_paths() -> None:
    """Of a diagonal move as the movement says; two shortest paths have one cost."""
    grid = np.zeros((6, 8), np.uint8)
    predicted = [[2, 1], [3, 2], [3, 3]]
    truth = [[2, 1], [2, 2], [3, 3]]
    axes = plot_prediction(grid, predicted, truth)
    assert legend_of(axes) == ["shortest, cost 2.4142", "predicted, cost 2.4142"]
    assert axes.get_title() == "predicted and shortest path"
    movement = Movement(8, diagonal_cost=1)
    axes = plot_prediction(grid, predicted, truth, movement=movement)
    assert legend_of(axes) == ["shortest, cost 2", "predicted, cost 2"]


@pytest.mark.parametrize(
    "shape",
    [slow((64, 64)), (220, 300), slow((300, 220)), (20, 200), slow((200, 20)), slow((1, 9))],
)
def test_a_figure_has_the_proportions_of_its_map(shape: tuple[int, int]) -> None:
    """No more than words need is blank above, below and beside it, except beside a narrow map."""
    grid = np.zeros(shape, np.uint8)
    ends = [[0, 0], [0, 1]]
    axes = plot_prediction(grid, ends, ends)
    figure = figure_of(axes)
    assert_tidy(figure)
    width, height = np.array([axes.bbox.width, axes.bbox.height]) / figure.dpi
    figure_width, figure_height = figure.get_size_inches()
    assert figure_height - height < 1.25 or height < 0.6
    assert figure_width - width < 0.9 or shape[0] > shape[1]
    assert figure_width <= 6
    assert figure_height <= 6.5


def test_the_figure_of_a_batch_has_the_proportions_of_its_maps(tmp_path: Path) -> None:
    """Here maps are 9 x 70, so that rows of maps are lower than columns are wide."""
    dataset = MapDataset(build_small(tmp_path / "d", WIDE))
    width, height = figure_of(plot_sample(dataset[:4])).get_size_inches()
    assert height < width / 3


def test_a_prediction_is_drawn_without_a_shortest_path() -> None:
    """The path lies on the middles of its cells, and nothing else is drawn or named."""
    grid = np.zeros((6, 8), np.uint8)
    predicted = np.array([[2, 1], [1, 1], [1, 2]])
    axes = plot_prediction(grid, predicted)
    assert_lines(drawn(axes, COLOURS["predicted"]), [predicted])
    assert not drawn(axes, COLOURS["astar"])
    assert ends_of(axes) == {"S": (2, 1), "G": (1, 2)}
    assert axes.get_title() == "predicted path"
    assert legend_of(axes) == ["predicted, cost 2"]


@pytest.mark.parametrize("path", [[0, 4, 7, 9], [[[0, 1], [0, 2]]], [[0, 1, 2]], 7])
def test_a_prediction_that_is_no_path_is_refused(path: Any) -> None:
    """Such as the offsets of a batch, four of which would be drawn as a path of two cells."""
    grid = np.zeros((6, 8), np.uint8)
    with pytest.raises(ValueError, match=r"predicted: got shape .*, expected the cells \(k, 2\)"):
        plot_prediction(grid, path)
    with pytest.raises(ValueError, match="truth: got shape "):
        plot_prediction(grid, [[0, 1]], path)


def test_roadmap_shows_samples_edges_and_path() -> None:
    """Vertices, edges and the path are drawn at their points."""
    grid = np.zeros((6, 8), np.uint8)
    vertices, edges = np.array([[0.5, 1], [3, 4], [5, 7]]), np.array([[0, 1], [1, 2]])
    axes = plot_roadmap(grid, vertices, edges, path=[[0, 1], [3, 4]])
    (lines,) = [one for one in axes.collections if isinstance(one, LineCollection)]
    (points,) = [artist for artist in axes.collections if type(artist) is PathCollection]
    np.testing.assert_array_equal(np.array(lines.get_segments())[..., ::-1], vertices[edges])
    np.testing.assert_array_equal(np.asarray(points.get_offsets())[:, ::-1], vertices)
    assert_lines(drawn(axes, COLOURS["astar"]), [np.array([[0, 1], [3, 4]])])
    assert ends_of(axes) == {"S": (0, 1), "G": (3, 4)}
    assert_tidy(figure_of(axes))
    plot_roadmap(grid, np.empty((0, 2)), np.empty((0, 2), np.int64))
