"""The figure of planners: each is where it was measured and named there, or named as missing."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
import pytest
from helpers.examples import slow
from helpers.figures import assert_tidy, figure_of
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Annotation, Text

from mapdata.plotting import STYLE, plot_planners

CROWDED = {
    "BFS": (17.087, 1.0),
    "Dijkstra": (16.134, 1.0),
    "A*": (1.0, 1.0),
    "weighted A* (1.1)": (0.691, 1.0048),
    "weighted A* (1.25)": (0.55, 1.0096),
    "weighted A* (1.5)": (0.479, 1.0096),
    "weighted A* (2)": (0.442, 1.0096),
    "weighted A* (3)": (0.418, 1.0096),
    "greedy best-first": (0.41, 1.0163),
    "jump point search": (0.159, 1.0),
    "A* with the exact goal field": (0.398, 1.0),
    "limit": (0.398, 1.0),
    "path_predictor (walk)": (0.398, 1.0),
    "path_predictor (search)": (0.409, 1.0),
}
"""The (expansion ratio, cost ratio) of planners on the hard problems of a small .scen."""

OWN = ("path_predictor (walk)", "path_predictor (search)")


def table_of(places: dict[str, tuple[float, float]]) -> pd.DataFrame:
    """Return the rows of planners with wide intervals, as far as the figure needs them."""
    rows = [
        {
            "planner": name,
            "subset": "hard",
            "n": 5,
            "expansion_ratio": x,
            "expansion_ratio_low": x / 1.5,
            "expansion_ratio_high": x * 1.5,
            "cost_ratio": y,
            "cost_ratio_low": 1.0,
            "cost_ratio_high": 1 + 3 * (y - 1),
        }
        for name, (x, y) in places.items()
    ]
    return pd.DataFrame(rows)


def marks_of(axes: Axes) -> dict[str, Line2D]:
    """Return the mark of each planner by its name."""
    return {str(line.get_label()): line for line in axes.get_lines() if line.get_marker() == "o"}


def place_of(mark: Line2D) -> tuple[float, float]:
    """Return the x and y of a mark."""
    (x,), (y,) = np.asarray(mark.get_xdata()), np.asarray(mark.get_ydata())
    return float(x), float(y)


def labels_of(axes: Axes) -> dict[str, Annotation]:
    """Return each label by its text."""
    return {text.get_text(): text for text in axes.texts if isinstance(text, Annotation)}


def test_each_mark_is_where_the_planner_was_measured() -> None:
    """And the axes say what they are."""
    axes = plot_planners(table_of(CROWDED))
    assert {name: place_of(mark) for name, mark in marks_of(axes).items()} == CROWDED
    assert axes.get_title() == "hard problems: 5"
    assert "expansions" in axes.get_xlabel()
    assert "cost" in axes.get_ylabel()
    assert "not shown" not in axes.get_xlabel()


def new_axes(width: float) -> Axes:
    """Return the axes of a figure of this width, in inches, in the look of all figures."""
    with rc_context(STYLE):
        return Figure(figsize=(width, 5), layout="constrained").add_subplot()


@pytest.fixture(scope="module", params=[7.0, slow(3.75)], ids=["page", "phone"])
def crowded(request: pytest.FixtureRequest) -> Axes:
    """Return a figure of the crowd, with two planners of one's own, whose layout is done."""
    axes = plot_planners(table_of(CROWDED), new_axes(request.param), own=OWN)
    figure_of(axes).draw_without_rendering()
    return axes


@pytest.mark.slow
def test_no_label_covers_another_or_a_mark(crowded: Axes) -> None:
    """Even where most marks lie at nearly one place; and all are inside the axes."""
    boxes = [Text.get_window_extent(label) for label in labels_of(crowded).values()]
    assert not [(a, b) for a, b in combinations(boxes, 2) if a.overlaps(b)]
    marks = crowded.transData.transform([place_of(mark) for mark in marks_of(crowded).values()])
    assert not [mark for mark in marks for box in boxes if box.contains(*mark)]
    page = crowded.get_window_extent()
    assert all(page.x0 < box.x0 and box.x1 < page.x1 for box in boxes)
    assert all(page.y0 < box.y0 and box.y1 < page.y1 for box in boxes)


def test_a_label_far_from_its_mark_has_a_line_to_it(crowded: Axes) -> None:
    """Without one it is right beside its mark."""
    for label in labels_of(crowded).values():
        box = Text.get_window_extent(label)
        x, y = crowded.transData.transform(label.xy)
        nearest = np.clip([x, y], box.min, box.max)
        points = np.hypot(*(nearest - [x, y])) * 72 / figure_of(crowded).dpi
        assert points < 12 or label.arrow_patch is not None


def test_every_planner_is_named_at_its_mark(crowded: Axes) -> None:
    """Marks at one place share a label, but one's own planners have labels of their own."""
    labels = labels_of(crowded)
    assert {"A* with the exact goal field\nlimit", *OWN} <= set(labels)
    places = {line: label.xy for text, label in labels.items() for line in text.split("\n")}
    weights = ("1.25", "1.5", "2", "3")
    expected = dict(CROWDED)
    for weight in weights:  # the first weight has the name of the family, the others stand alone
        expected[weight] = expected.pop(f"weighted A* ({weight})")
    assert set(places) == set(expected)
    pixels = {name: crowded.transData.transform([places[name], expected[name]]) for name in places}
    assert max(np.hypot(*(label - mark)) for label, mark in pixels.values()) < 5


def test_planners_of_one_family_are_joined_by_the_order_of_their_parameter() -> None:
    """10 comes after 9, and a name that differs in a word is no member."""
    places = {
        "w (10)": (0.2, 1.3),
        "w (9)": (0.3, 1.2),
        "w (0.5)": (0.9, 1.0),
        "w (fast)": (0.5, 1.1),
        "v (3)": (0.6, 1.1),
    }
    axes = plot_planners(table_of(places))
    (line,) = [line for line in axes.get_lines() if line.get_marker() != "o"]
    assert np.asarray(line.get_xdata()).tolist() == [0.9, 0.3, 0.2]
    assert set(labels_of(axes)) == {"w (0.5)", "9", "10", "w (fast)", "v (3)"}


@pytest.mark.slow
def test_own_planners_have_colours_of_their_own() -> None:
    """The others are grey and not filled."""
    axes = plot_planners(table_of(CROWDED), own=OWN)
    colours = {name: to_hex(mark.get_color()) for name, mark in marks_of(axes).items()}
    own_colours = {colours.pop(name) for name in OWN}
    assert len(own_colours) == len(OWN)
    assert len(set(colours.values())) == 1
    assert not own_colours & set(colours.values())
    filled = [name for name, mark in marks_of(axes).items() if mark.get_markerfacecolor() != "none"]
    assert filled == list(OWN)


def test_planners_without_a_place_are_named() -> None:
    """With the reason; a logarithmic axis has no 0."""
    places = {
        "good": (0.5, 1.1),
        "Cyd": (0.9, np.nan),
        "lazy": (0.0, 1.2),
        "scored": (np.nan, 1.2),
    }
    axes = plot_planners(table_of(places))
    assert set(marks_of(axes)) == {"good"}
    note = "not shown: Cyd (solved none), lazy (no expansions), scored (expansions unknown)"
    assert axes.get_xlabel().replace("\n", " ").endswith(f"better {note}")
    assert_tidy(figure_of(axes))


def test_a_subset_without_problems_is_an_empty_figure() -> None:
    """Its title says that there is none, and nobody is missing."""
    table = table_of({"A*": (np.nan, np.nan), "mine": (np.nan, np.nan)}).assign(n=0)
    axes = plot_planners(table, own=["mine"])
    assert axes.get_title() == "hard problems: 0"
    assert not axes.get_lines()
    assert "not shown" not in axes.get_xlabel()


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [1.0, 1.3, 2.5, 6, 40, 700, 30_000])
@pytest.mark.parametrize("width", [3.75, 7])
def test_labels_of_ticks_do_not_cover_each_other(ratio: float, width: float) -> None:
    """Whatever the range of expansions is; there are at least two, which are plain numbers."""
    places = {"slow": (3.0, 1.0), "fast": (3.0 / ratio, 1.0001)}
    axes = plot_planners(table_of(places), new_axes(width))
    assert_tidy(figure_of(axes))
    low, high = axes.get_xlim()
    ticks = [tick for tick in axes.xaxis.get_major_ticks() if low <= tick.get_loc() <= high]
    assert len(ticks) >= 2
    assert [float(tick.label1.get_text()) for tick in ticks] == pytest.approx(
        [tick.get_loc() for tick in ticks]
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"subset": "easy"}, "subset: got 'easy', expected one of hard, all"),
        ({"own": ["mine"]}, "own: got 'mine', expected one of BFS, "),
    ],
    ids=["subset", "own"],
)
def test_what_is_not_in_the_table_is_refused(options: dict[str, Any], message: str) -> None:
    """The message names what is there."""
    with pytest.raises(ValueError, match=message):
        plot_planners(table_of(CROWDED), **options)
