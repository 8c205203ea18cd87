"""Problems: they are the reference's, the same from a spec and from a dataset, and what has no
answer is refused.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from helpers import reference
from helpers.pages import DOCS

from mapdata import MapSpec, Problems, Random, astar, build
from mapdata.generators import Generator
from mapdata.problems import HARD
from mapdata.spec import Movement

DUNGEON = MapSpec.preset("dungeon")
CUTTING = Movement(8, corner_cutting=True)


def same(one: Problems, other: Problems) -> bool:
    """Compare what two sets of problems hold."""
    return one.movement == other.movement and all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("grids", "starts", "goals")
    )


@pytest.mark.parametrize("movement", [Movement(), Movement(8), CUTTING], ids=["4", "8", "cutting"])
@pytest.mark.parametrize(
    "spec",
    [
        MapSpec(
            map_size=(20, 31),
            rooms=(2, 5),
            room_rows=(2, 7),
            room_columns=(2, 7),
            passage_width=(1, 2),
        ),
        MapSpec(
            map_size=(9, 7),
            rooms=(2, 3),
            room_rows=(1, 3),
            room_columns=(1, 3),
            passage_width=(1, 1),
        ),
    ],
    ids=["dungeon", "tiny"],
)
def test_the_sample_is_the_references(spec: MapSpec, movement: Movement) -> None:
    """Start, goal and which maps are left out, on maps where a goal has to be sampled again and on
    maps without any.
    """
    for problems in (Random(distance=(10, None)), Random((6, 12), (1.05, 2), (None, 11))):
        expected = []
        for index in range(12):
            grid = reference.reference_map(spec, 3, index).occupancy
            sampled = reference.reference_problem(
                grid, 3, index, 0, problems.bands, movement, draws=1000
            )
            if sampled is not None:
                expected.append((grid, *sampled))
        if not expected:
            with pytest.raises(ValueError, match="no map has a problem"):
                Problems.sample(spec, 3, 12, problems=problems, movement=movement)
            continue
        found = Problems.sample(spec, 3, 12, problems=problems, movement=movement)
        assert len(expected) == len(found)
        for k, (grid, start, goal, cost) in enumerate(expected):
            assert found.grids[k].tolist() == grid
            assert (tuple(found.starts[k]), tuple(found.goals[k])) == (start, goal)
            assert found.optimal.cost[k] == reference.as_float(cost, movement)


def test_the_first_problems_do_not_depend_on_how_many() -> None:
    """A longer sample begins with the shorter one, over the border of a chunk; another seed gives
    others.
    """
    longer, shorter = Problems.sample(DUNGEON, 1, 270), Problems.sample(DUNGEON, 1, 258)
    assert same(
        shorter,
        Problems(longer.grids[:258], longer.starts[:258], longer.goals[:258], longer.movement),
    )
    assert not same(shorter, Problems.sample(DUNGEON, 2, 258))


def test_until_hard_stops_at_the_last_hard_problem() -> None:
    """Exactly so many hard problems, the last of them at the end; ``maps`` is then a limit."""
    problems = Problems.sample(DUNGEON, 4, until_hard=20)
    assert problems.hard.sum() == 20
    assert problems.hard[-1]
    assert same(problems, Problems.sample(DUNGEON, 4, len(problems)))
    assert same(problems, Problems.sample(DUNGEON, 4, len(problems), until_hard=20))
    hard = Problems.sample(DUNGEON, 4, 60, problems=Random(hardness=(HARD, None)))
    assert hard.hard.all()
    with pytest.raises(ValueError, match="until_hard: got 20, found only 19"):
        Problems.sample(DUNGEON, 4, len(problems) - 1, until_hard=20)


def test_hardness_is_cost_over_heuristic() -> None:
    """By hand, and on sampled problems with the searches of one map."""
    grid = np.zeros((4, 4), np.uint8)
    grid[0, 1] = 1
    ends = [[(0, 0), (0, 0), (3, 0)], [(0, 2), (3, 3), (3, 2)]]
    problems = Problems(np.stack([grid] * 3), np.array(ends[0]), np.array(ends[1]), Movement())
    assert problems.hardness.tolist() == [2.0, 1.0, 1.0]
    assert problems.hard.tolist() == [True, False, False]
    root = 2**0.5
    octile = Problems(np.stack([grid] * 3), np.array(ends[0]), np.array(ends[1]), Movement(8))
    np.testing.assert_allclose(octile.hardness, [4 / 2, (2 + 2 * root) / (3 * root), 1], rtol=1e-12)
    drawn = Problems.sample(DUNGEON, 8, 20)
    for k in range(20):
        start, goal = tuple(drawn.starts[k].tolist()), tuple(drawn.goals[k].tolist())
        cost = astar(drawn.grids[k], start, goal, Movement(8)).cost
        estimate = reference.as_float(reference.heuristic(start, goal, Movement(8)), Movement(8))
        assert (drawn.optimal.cost[k], drawn.hardness[k]) == (
            cost,
            pytest.approx(cost / estimate, rel=1e-12),
        )
        assert drawn.hard[k] == (cost / estimate >= HARD)


def test_a_dataset_gives_the_problems_of_its_spec(tmp_path: Path) -> None:
    """On the test split of a root stand the problems that its spec and seed give on these maps."""
    build(tmp_path, DUNGEON, maps=120, seed=9, shard_size=50, workers=1)
    every = Problems.sample(DUNGEON, 9, 120)
    test = [k for k in range(120) if reference.reference_split(DUNGEON, 9, k) == 2]
    assert len(test) > 3
    expected = Problems(every.grids[test], every.starts[test], every.goals[test], every.movement)
    assert same(Problems.read(tmp_path), expected)
    assert same(
        Problems.read(tmp_path, 2),
        Problems(
            every.grids[test[:2]], every.starts[test[:2]], every.goals[test[:2]], every.movement
        ),
    )
    assert len(Problems.read(str(tmp_path), split="train")) > 60
    assert not np.array_equal(Problems.read(tmp_path, seed=1).starts, expected.starts)
    with pytest.raises(ValueError, match="split"):
        Problems.read(tmp_path, split="validation")


def test_the_arrays_cannot_be_written() -> None:
    """They are copies: neither the caller's array nor a planner changes the problems."""
    grids = np.zeros((1, 2, 3), np.int64)
    problems = Problems(grids, np.array([[0, 0]]), np.array([[1, 2]]), Movement())  # type: ignore[arg-type]
    grids[:] = 1
    assert problems.grids.dtype == np.uint8
    assert not problems.grids.any()
    with pytest.raises(ValueError, match="read-only"):
        problems.goals[0, 0] = 0


@pytest.mark.parametrize(
    ("grids", "starts", "goals", "why"),
    [
        ([[[0, 1, 0]]], [(0, 0)], [(0, 2)], "problem 0 has no path"),
        ([[[0, 0]]] * 2, [(0, 0), (0, 1)], [(0, 1), (0, 1)], "problem 1 starts at its goal"),
        ([[0, 0]], [(0, 0)], [(0, 1)], "expected \\(N, H, W\\)"),
        ([[[0, 0]]], [(0, 0), (0, 1)], [(0, 1), (0, 1)], "equal numbers"),
        ([[[0, 0]]], [(0, 0)], [(0, 2)], "outside"),
        ([[[0, 3]]], [(0, 0)], [(0, 1)], "3"),
        ([[[0, 0]]], [(0, 0)], [(0, 0.5)], "goals"),
    ],
)
def test_what_cannot_be_evaluated_is_refused(
    grids: npt.ArrayLike, starts: npt.ArrayLike, goals: npt.ArrayLike, why: str
) -> None:
    """No path, nothing to do, arrays that do not fit, bad values: named when the problems are
    made.
    """
    with pytest.raises(ValueError, match=why):
        Problems(np.array(grids), np.array(starts), np.array(goals), Movement())


def test_a_sample_without_problems_is_refused() -> None:
    """No number, none of the maps large enough, numbers below 1."""
    tiny = MapSpec(
        map_size=(5, 5), rooms=(2, 3), room_rows=(1, 3), room_columns=(1, 3), passage_width=(1, 2)
    )
    for spec, maps, until_hard, why in (
        (DUNGEON, None, None, "neither maps nor until_hard"),
        (tiny, 3, None, r"no map has a problem that meets Random\(distance=\(10.0, inf\)"),
        (DUNGEON, 0, None, "maps: got 0"),
        (DUNGEON, None, -1, "until_hard: got -1"),
    ):
        with pytest.raises(ValueError, match=why):
            Problems.sample(spec, 0, maps, until_hard=until_hard)


def test_a_saved_set_is_the_same(tmp_path: Path) -> None:
    """To the last array, with movement and words; its bytes and hash are those of the problems."""
    for movement in (Movement(), CUTTING):
        problems = Problems.sample(DUNGEON, 77, 20, movement=movement)
        problems.save(tmp_path / "set.npz")
        again = Problems.load(tmp_path / "set.npz")
        assert same(problems, again)
        assert again.description == problems.description
        assert again.content_hash == problems.content_hash
        again.save(tmp_path / "other")
        assert (tmp_path / "other").read_bytes() == (tmp_path / "set.npz").read_bytes()


def test_the_hash_tells_sets_apart() -> None:
    """By maps, ends and movement; not by words. One is golden."""
    problems = Problems(
        np.array([[[0, 0, 0], [0, 1, 0]]]), np.array([[0, 0]]), np.array([[1, 2]]), Movement()
    )
    golden = "1bf9f5c51756f669d05ec4ffbeb97619ba32f691e8c76b05aa62cc8bbf2c8ad1"
    assert problems.content_hash == golden
    assert replace(problems, description="others").content_hash == golden
    for change in (
        {"starts": np.array([[1, 0]])},
        {"goals": np.array([[0, 2]])},
        {"grids": np.zeros((1, 2, 3), int)},
        {"movement": Movement(8)},
    ):
        assert replace(problems, **change).content_hash != golden


def test_what_is_no_saved_set_is_refused(tmp_path: Path) -> None:
    """By name: text, another archive, arrays that do not fit, pickles."""
    path = tmp_path / "set.npz"
    contents: list[dict[str, object]] = [
        {"grids": np.zeros((1, 2, 2))},
        {"about": np.array("[]"), "grids": 1, "starts": 1, "goals": 1},
        {"about": np.array("{"), "grids": 1, "starts": 1, "goals": 1},
        {"about": np.array({"a": 1}, object)},
    ]
    for arrays in contents:
        np.savez(path, **arrays)  # type: ignore[arg-type]
        with pytest.raises(ValueError, match=r"set\.npz: holds no saved problems"):
            Problems.load(path)
    path.write_text("text")
    with pytest.raises(ValueError, match=r"set\.npz: holds no saved problems"):
        Problems.load(path)
    with pytest.raises(FileNotFoundError):
        Problems.load(tmp_path / "none.npz")


def sets() -> list[tuple[str, str, str]]:
    """Return name, flags and hash of each set in the table of docs/planners.md."""
    page = (DOCS / "planners.md").read_text(encoding="utf-8")
    return re.findall(r"^\| ([\w-]+) \| `(--preset [^`]+)` \|.*\| `([0-9a-f]{12})` \|$", page, re.M)


def test_the_page_names_its_sets() -> None:
    """The table is found."""
    assert {"dungeon-hard-1000", "paper-hard-1000"} <= {name for name, _, _ in sets()}


@pytest.mark.parametrize(("name", "flags", "digits"), sets())
def test_the_sets_behind_the_tables_are_what_their_recipes_give(
    name: str, flags: str, digits: str
) -> None:
    """Each has the hash that stands beside it, and as many hard problems as its name says."""
    words = flags.split()
    movement = Movement(4 if "--connectivity" in words else 8, "--corner-cutting" in words)
    hard = int(words[words.index("--until-hard") + 1])
    found = Problems.sample(Generator.preset(words[1]), seed=77, until_hard=hard, movement=movement)
    assert name.endswith(f"-hard-{found.hard.sum()}")
    assert found.content_hash.startswith(digits)
