"""Mazes as text: the answers are those that the scorer calls right."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import pytest

from mapdata import Cave, Maze, Movement, OnlineMapDataset, Route
from mapdata.datasets import maze_text
from mapdata.formats import is_shortest_answer, score_answer

LONGER = {"random": {"length": [3, None]}}
"""Problems whose start and goal are no neighbours."""


@pytest.mark.parametrize("radius", [0.0, 0.15])
def test_the_text_of_a_map_is_a_right_answer(radius: float) -> None:
    """Also for BFS, for a robot with a radius, and for rotated maps with padded paths."""
    texts: Any = OnlineMapDataset(
        "cave",
        length=10,
        problems=LONGER,
        search="bfs",
        augment=True,
        max_length=400,
        radius=radius,
        transform=maze_text,
    )
    assert all(is_shortest_answer(text["prompt"], text["answer"]) for text in texts)


@pytest.mark.parametrize(
    ("recipe", "arguments", "message"),
    [
        (Cave((32, 32), movement=Movement(8)), {}, "got a path with diagonal moves, expected"),
        ("terrain", {"movement": Movement(4)}, r"got a path of \d+ moves where \d+ are enough"),
        (
            "paper",
            {"problems": Route(unsolvable=True), "movement": Movement(4), "radius": 0.5},
            r"got no path where \d+ moves are enough \(the start or the goal is occupied\)",
        ),
        ("maze15", {"fields": ("map", "path")}, "got samples of map, path; expected the fields"),
    ],
)
def test_maps_whose_text_would_be_no_right_answer_are_refused(
    recipe: Any, arguments: dict[str, Any], message: str
) -> None:
    """`is_shortest_answer` would call all of these answers wrong."""
    arguments = {"problems": LONGER, **arguments}
    dataset = OnlineMapDataset(recipe, length=20, transform=maze_text, **arguments)
    with pytest.raises(ValueError, match=message):
        list(dataset)


@pytest.mark.parametrize("answer", ["cells", "moves", "letters"])
def test_answers_of_each_form_are_right(answer: Any) -> None:
    """Also "infeasible", where there is no path."""
    transform = functools.partial(maze_text, answer=answer)
    loops = Maze((9, 9), reopened=0.5)
    texts: Any = OnlineMapDataset(loops, length=20, problems=LONGER, transform=transform)
    assert all(score_answer(text["prompt"], text["answer"]) == 1 for text in texts)
    segments: Any = OnlineMapDataset(
        "paper", length=60, problems=Route(unsolvable=True), transform=transform
    )
    texts = list(segments)
    assert all(score_answer(text["prompt"], text["answer"]) == 1 for text in texts)
    assert 0 < sum(text["answer"] == "infeasible" for text in texts) < 30


def test_a_marked_maze_of_neighbours_would_be_the_prompt() -> None:
    """The error names the band that leaves them out, and the forms that can say it."""
    neighbours = {"random": {"length": [2, 2]}}
    options: dict[str, Any] = {"length": 3, "problems": neighbours}
    with pytest.raises(ValueError, match=r'expected longer paths, problems=\{"random": \{"length"'):
        OnlineMapDataset(Maze((7, 7)), transform=maze_text, **options)[0]
    letters = functools.partial(maze_text, answer="letters")
    texts: Any = OnlineMapDataset(Maze((7, 7)), transform=letters, **options)
    assert {text["answer"] for text in texts} <= set("UDLR")


@pytest.mark.parametrize(
    ("what", "message"),
    [
        (
            lambda dataset: dataset[:2],
            r"maze_text: got a batch, expected one sample: .*dataset\[0\]",
        ),
        (lambda dataset: "S G", "maze_text: got str, expected a sample of a dataset"),
    ],
)
def test_what_is_no_sample_is_refused(
    what: Callable[[OnlineMapDataset], Any], message: str
) -> None:
    """A batch is changed by the dataset itself."""
    dataset = OnlineMapDataset("maze15", length=2, problems="random")
    with pytest.raises(ValueError, match=message):
        maze_text(what(dataset))


def test_another_form_of_answer_is_refused() -> None:
    """The error names the three forms."""
    transform = functools.partial(maze_text, answer="arrows")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="answer: got 'arrows', expected one of cells, moves, let"):
        OnlineMapDataset("maze15", length=1, transform=transform)[0]
