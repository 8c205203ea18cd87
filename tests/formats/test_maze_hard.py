"""maze-hard: HRM's converter, written down once more, reads what we write; answers are scored."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import networkx as nx  # type: ignore[import-untyped]
import numpy as np
import pytest
from helpers.wild import SETTINGS, cli
from hypothesis import given
from hypothesis import strategies as st

from mapdata import (
    Cave,
    MapDataset,
    MapSpec,
    Maze,
    Movement,
    OnlineMapDataset,
    Route,
    astar,
    build,
    generate,
)
from mapdata.datasets import maze_text
from mapdata.export import export_problems
from mapdata.formats import (
    FormatError,
    Limits,
    import_maps,
    is_shortest_answer,
    read_any,
    recognise,
)

CHARSET = "# SGo"


def convert(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, side * side) inputs and labels, as dataset/build_maze_dataset.py of HRM does."""
    inputs, labels = [], []
    with path.open(newline="") as file:
        lines = csv.reader(file)
        next(lines)
        for _, question, answer, _ in lines:
            side = int(len(question) ** 0.5)
            inputs.append(np.frombuffer(question.encode(), np.uint8).reshape(side, side))
            labels.append(np.frombuffer(answer.encode(), np.uint8).reshape(side, side))
    tokens = np.zeros(256, np.uint8)
    tokens[[ord(letter) for letter in CHARSET]] = np.arange(len(CHARSET)) + 1
    return tokens[np.stack(inputs)], tokens[np.stack(labels)]


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """40 mazes with loops of 15 x 15 cells."""
    folder = tmp_path_factory.mktemp("mazes") / "maps"
    build(folder, Maze((15, 15), reopened=0.2, seed_points=3), maps=40, seed=2)
    return folder


def test_the_converter_of_hrm_reads_what_we_write(root: Path, tmp_path: Path) -> None:
    """Each segment of each split comes in order, with the same map, ends and path."""
    export_problems(root, tmp_path / "out", format="maze-hard", problems="route")
    for split in ("train", "val", "test"):
        inputs, labels = convert(tmp_path / "out" / f"{split}.csv")
        stored = MapDataset(root, split)
        assert len(stored) == len(inputs)
        for sample, given_, wanted in zip(stored, inputs, labels, strict=True):
            assert ((given_ == 1) == (sample.map[0].numpy() == 1)).all()
            assert given_[tuple(sample.start)] == 3
            assert given_[tuple(sample.goal)] == 4
            inner = {tuple(cell) for cell in sample.path.tolist()[1:-1] if cell[0] >= 0}
            assert {tuple(cell) for cell in np.argwhere(wanted == 5).tolist()} == inner


def test_round_trip(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each line becomes a map in its split with its start and goal as seed points, and every answer
    is confirmed.
    """
    out = tmp_path / "out"
    assert cli(capsys, "export", root, out, "--format", "maze-hard", "--problems", "route")[0] == 0
    assert recognise(out) == "maze-hard"
    code, _, _ = cli(capsys, "import", out, tmp_path / "back")
    assert code == 0
    for split in ("train", "val", "test"):
        there, back = MapDataset(root, split)[:], MapDataset(tmp_path / "back", split)[:]
        for name in ("map", "start", "goal"):
            np.testing.assert_array_equal(getattr(there, name), getattr(back, name))


def test_wrong_answers_are_counted(root: Path, tmp_path: Path) -> None:
    """The import compares each answer with all shortest paths."""
    export_problems(root, tmp_path / "out", format="maze-hard", problems="route")
    lines = (tmp_path / "out" / "test.csv").read_text().splitlines()
    source, question, answer, rating = lines[1].split(",")
    lines[1] = ",".join((source, question, answer.replace("o", " ", 1), rating))
    (tmp_path / "test.csv").write_text("\n".join(lines) + "\n")
    (imported,) = import_maps(tmp_path / "back", read_any(tmp_path / "test.csv"))
    assert imported.checked == len(lines) - 1
    assert sum(imported.disagreements.values()) == 1


@SETTINGS
@given(st.integers(0, 10_000), st.data())
def test_all_shortest_paths_of_networkx_are_right_answers(seed: int, data: st.DataObject) -> None:
    """A path with a cell added, removed or moved is wrong, unless it is another shortest path."""
    grid = generate(Maze((9, 9), reopened=0.6, seed_points=2), seed, [0])
    cells = grid.occupancy[0]
    start, goal = (tuple(point.tolist()) for point in grid.seed_points[0])
    graph = nx.grid_2d_graph(9, 9)
    graph.remove_nodes_from([tuple(cell) for cell in np.argwhere(cells).tolist()])
    letters = np.where(cells, "#", " ")
    letters[start], letters[goal] = "S", "G"
    question = "".join(letters.flat)

    def answer(path: list[tuple[int, int]]) -> str:
        marked = letters.copy()
        for cell in path[1:-1]:
            marked[cell] = "o"
        return "".join(marked.flat)

    paths = list(nx.all_shortest_paths(graph, start, goal))
    assert all(is_shortest_answer(question, answer(path)) for path in paths)
    right = {answer(path) for path in paths}
    other = list(data.draw(st.sampled_from(sorted(right))))
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, 80))
        other[place] = data.draw(st.sampled_from(CHARSET))
    assert is_shortest_answer(question, "".join(other)) == ("".join(other) in right)


def test_longer_paths_are_wrong() -> None:
    """Wrong answers are a detour, a loop beside the path, another length and a changed wall."""
    question = "S        " + "       G "
    question = question.ljust(25)
    start, goal = 0, 16
    found = astar(np.zeros((5, 5)), (0, 0), divmod(goal, 5))
    cells = [row * 5 + column for row, column in found.path.tolist()]
    right = "".join("o" if k in cells[1:-1] else letter for k, letter in enumerate(question))
    assert is_shortest_answer(question, right)
    assert not is_shortest_answer(question, right[:-1])
    assert not is_shortest_answer(question, right[:-1] + "#")
    assert not is_shortest_answer(question, right[:-1] + "o")
    assert right[start] == "S"


def test_line_ends_around_an_answer_are_ignored() -> None:
    """Models end their answers with a newline, and files of Windows have CRLF; spaces are cells."""
    question = "####\n#S #\n# G#\n####"
    answer = question.replace("S ", "So")
    questions = (question, question + "\n", question.replace("\n", "\r\n") + "\r\n")
    answers = (answer, answer + "\n", "\n" + answer, answer.replace("\n", "\r\n") + "\r\n")
    for each_question in questions:
        assert all(is_shortest_answer(each_question, each_answer) for each_answer in answers)
        assert not is_shortest_answer(each_question, " " + answer)
        assert not is_shortest_answer(each_question, answer.replace("\n", "\n\n"))


@pytest.mark.parametrize(
    ("question", "answer", "message"),
    [
        ("#########", "#########", "question: expected cells '#' and ' ', one S and one G"),
        ("", "", "one S and one G"),
        ("S  SG    ", "S  SG    ", "one S and one G"),
        ("SéG ", "SéG ", "expected cells '#' and ' '"),
        ("S G", "SoG", "got 3 cells, expected a square map"),
        ("S G", "S G ", "got 3 cells, expected a square map"),
        ("S \n G ", "S \n G ", "got lines of several lengths"),
        (None, "S  G", "question: got None, expected a text"),
        ("S  G", None, "answer: got None, expected a text"),
    ],
)
def test_a_question_that_is_no_map_raises_a_format_error(
    question: Any, answer: Any, message: str
) -> None:
    """The docstring promises this error and no other."""
    with pytest.raises(FormatError, match=message):
        is_shortest_answer(question, answer)


@pytest.mark.parametrize("radius", [0.0, 0.15])
def test_the_text_of_a_map_is_a_right_answer(radius: float) -> None:
    """Also for BFS, for a robot with a radius, and for rotated maps with padded paths."""
    texts: Any = OnlineMapDataset(
        "cave",
        length=10,
        problems="random",
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
            {"problems": Route(unsolvable=True), "movement": Movement(4), "radius": 5},
            "got a path of 0 cells",
        ),
        ("maze15", {"fields": ("map", "path")}, "got samples of map, path; expected the fields"),
    ],
)
def test_maps_whose_text_would_be_no_right_answer_are_refused(
    recipe: Any, arguments: dict[str, Any], message: str
) -> None:
    """`is_shortest_answer` would call all of these answers wrong."""
    arguments = {"problems": "random", **arguments}
    dataset = OnlineMapDataset(recipe, length=20, transform=maze_text, **arguments)
    with pytest.raises(ValueError, match=message):
        list(dataset)


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("x,S G,S G,2", "got 3 cells, expected a square map"),
        ("x,S  S,S  S,2", "one S and one G"),
        ("x,S  X,S  X,2", "expected cells"),
        ("x,,,", "one S and one G"),
        ("x,SG", "expected source,question"),
    ],
)
def test_lines_that_are_no_maze_are_left_out(tmp_path: Path, line: str, why: str) -> None:
    """They are left out by line with a reason, and the other lines are read."""
    path = tmp_path / "train.csv"
    path.write_text(f"source,question,answer,rating\n{line}\nx,S  G,So G,2\n")
    collection = read_any(path)
    assert [each.split for each in collection.maps] == [0]
    ((name, reason),) = collection.left_out
    assert name.endswith("train.csv, line 2")
    assert why in reason


def test_files_that_cannot_be_read_are_left_out(tmp_path: Path) -> None:
    """They are a dangling link and a file beyond the limit; the other files are read."""
    (tmp_path / "train.csv").write_text("source,question,answer,rating\nx,S  G,So G,2\n")
    (tmp_path / "val.csv").symlink_to("gone.csv")
    (tmp_path / "test.csv").write_text("source,question,answer,rating\n" + 9 * "x,S  G,So G,2\n")
    collection = read_any(tmp_path, "maze-hard", Limits(unpacked=100))
    assert [each.split for each in collection.maps] == [0]
    assert [Path(name).name for name, _ in collection.left_out] == ["test.csv", "val.csv"]


def test_maps_that_the_format_cannot_hold_are_refused(tmp_path: Path) -> None:
    """Refused are maps that are not square and diagonal moves; a CSV of another format cannot be
    read.
    """
    wide = MapSpec((20, 31), room_rows=(3, 5), room_columns=(3, 5), passage_width=(1, 2))
    diagonal = Maze((9, 9), seed_points=2, movement=Movement(8))
    for name, generator, movement in (
        ("wide", wide, None),
        ("diagonal", diagonal, Movement(8)),
    ):
        build(tmp_path / name, generator, maps=3)
        with pytest.raises(ValueError, match="expected square maps and 4-connected paths"):
            export_problems(
                tmp_path / name, tmp_path / f"{name}-out", format="maze-hard", movement=movement
            )
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    with pytest.raises(
        ValueError, match=r"no map can be used: .*other.csv, line 2: expected source"
    ):
        read_any(tmp_path / "other.csv", "maze-hard")
