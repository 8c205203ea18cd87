"""maze-hard: HRM's converter, written down once more, reads what we write; answers are scored."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from helpers.builds import Built

from mapdata import (
    MapDataset,
    MapSpec,
    Maze,
    Movement,
    build,
)
from mapdata.export import export_problems
from mapdata.formats import Limits, import_maps, is_shortest_answer, read_any

CHARSET = "# SGo"

_TEXT = np.frombuffer(f"\0{CHARSET}".encode(), np.uint8)
"""The character of each token."""


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
def root(built: Built) -> Path:
    """40 mazes with loops of 15 x 15 cells."""
    return built(Maze((15, 15), reopened=0.2, seed_points=3), maps=40, seed=2)


def test_the_converter_of_hrm_reads_what_we_write(root: Path, tmp_path: Path) -> None:
    """Each segment of each split comes in order, with its map and ends, and a shortest path."""
    export_problems(root, tmp_path / "out", format="maze-hard", problems="route")
    for split in ("train", "val", "test"):
        inputs, labels = convert(tmp_path / "out" / f"{split}.csv")
        stored = MapDataset(root, split, ("map", "start", "goal", "cost"))
        assert len(stored) == len(inputs)
        for sample, given_, wanted in zip(stored, inputs, labels, strict=True):
            assert ((given_ == 1) == (sample.map[0].numpy() == 1)).all()
            assert given_[tuple(sample.start)] == 3
            assert given_[tuple(sample.goal)] == 4
            texts = (_TEXT[tokens].tobytes().decode() for tokens in (given_, wanted))
            assert (wanted == 5).sum() == sample.cost - 1
            assert is_shortest_answer(*texts) or sample.cost == 1


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
