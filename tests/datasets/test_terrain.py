"""What holds on terrain alone: ones, mixed trainings, costs that are too high, and no taut lines.

That all fields on terrain are those of the reference, in any dataset, is tested with those of other
maps: in test_fields.py, test_dataset.py, test_radius.py and test_problem_set_dataset.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from helpers import samples
from helpers.specs import movements
from torch.utils.data import ConcatDataset, DataLoader

from mapdata import (
    MapDataModule,
    MapDataset,
    Maze,
    Movement,
    OnlineMapDataset,
    Pairs,
    ProblemSet,
    ProblemSetDataset,
    Random,
    Route,
    Terrain,
    apply_symmetry,
    generate,
    inflate_terrain,
)
from mapdata.arrays import Ints
from mapdata.datasets import Waypoints
from mapdata.datasets.field_kernels import (
    GoalFields,
    fill_goal_fields,
    fill_room_matrices,
    path_probabilities,
)
from mapdata.generators.maps import Maps, pack
from mapdata.search.ground import as_ground
from mapdata.search.kernels import search_memory
from mapdata.search.lattice import move_rule

HILLS = Terrain((9, 11), costs=(2, 3, 8, 91), obstacles=0.2, seed_points=4)
SEED = 4


@pytest.mark.parametrize("search", ["bfs", "astar"])
@movements
@pytest.mark.parametrize(
    "problems", [Route(), Pairs(), Random(), Random(distance=(6, 30), hardness=(1, 1.6))], ids=str
)
@pytest.mark.parametrize("radius", [0.0, 0.1])
def test_terrain_of_ones_gives_the_fields_without_terrain(
    movement: Movement, search: str, problems: Any, radius: float
) -> None:
    """All of them bit for bit, with the same problems, paths and iterations."""
    options: dict[str, Any] = {
        "fields": samples.TERRAIN_FIELDS,
        "problems": problems,
        "search": search,
        "movement": movement,
        "radius": radius,
        "augment": True,
    }
    ones = Terrain(costs=(1,), over=samples.SPEC)
    on_ones, without = (
        OnlineMapDataset(generator, SEED, 12, **options)[:] for generator in (ones, samples.SPEC)
    )
    samples.assert_same(on_ones, without)


# --- batches --------------------------------------------------------------------------------------


def test_a_batch_without_problems_has_all_fields() -> None:
    """Their dtypes are those of other batches, and so are their shapes but for the first axis."""
    online = OnlineMapDataset(samples.ROUGH, SEED, 6, fields=samples.TERRAIN_FIELDS, augment=True)
    for empty, others in zip(online[0:0], online[:1], strict=True):
        assert len(empty) == 0
        assert empty.dtype == others.dtype
        assert empty.ndim == others.ndim


def test_a_batch_keeps_the_stored_maps_beside_the_served_ones() -> None:
    """Numbers, grids and terrain before augmentation and inflation, and the symmetries."""
    generator = samples.ROUGH
    dataset = OnlineMapDataset(
        generator, SEED, 30, "train", problems="random", augment=True, radius=0.1
    )
    batch = dataset._batch(np.arange(12), 0)
    assert batch.map_numbers.max() > 11  # those of other splits are left out
    drawn = generate(generator, SEED, batch.map_numbers)
    assert (drawn.split == 0).all()
    np.testing.assert_array_equal(batch.stored_terrain, drawn.terrain)
    np.testing.assert_array_equal(batch.stored_grids, drawn.occupancy)
    assert batch.terrain is not None
    assert drawn.terrain is not None
    inflated = [inflate_terrain(terrain, 0.1 / generator.resolution) for terrain in drawn.terrain]
    served = apply_symmetry(
        torch.from_numpy(np.stack(inflated))[:, None], torch.from_numpy(batch.symmetries)
    )
    np.testing.assert_array_equal(batch.terrain, served[:, 0])
    plain = OnlineMapDataset(generator, SEED, 30, problems="random")._batch(np.arange(3), 0)
    assert plain.symmetries.tolist() == [0, 0, 0]
    assert plain.map_numbers.tolist() == [0, 1, 2]
    np.testing.assert_array_equal(plain.terrain, plain.stored_terrain)


def test_problems_that_share_a_terrain_share_its_number() -> None:
    """As pictures of it must be the same."""
    terrain = np.array([[1, 2, 3], [1, 0, 9]], np.uint8)
    problems = ProblemSet(
        np.broadcast_to(terrain == 0, (3, 2, 3)),
        np.array([[0, 0], [0, 1], [1, 0]]),
        np.array([[0, 2], [1, 2], [1, 2]]),
        Movement(),
        terrain=np.broadcast_to(terrain, (3, 2, 3)),
    )
    batch = ProblemSetDataset(problems, ("terrain", "cost"))._batch(np.arange(3), 0)
    assert batch.map_numbers.tolist() == [0, 0, 0]
    np.testing.assert_array_equal(batch.stored_terrain, [terrain] * 3)


# --- beside maps without terrain ------------------------------------------------------------------


def test_mixed_training_stacks_terrain_of_both_kinds_of_maps() -> None:
    """Maps without terrain serve ones on their free cells."""
    fields = ("map", "terrain", "cost")
    uniform = OnlineMapDataset(Maze((9, 11)), SEED, 8, fields=fields)
    costly = OnlineMapDataset(HILLS, SEED, 8, fields=fields)
    (batch,) = DataLoader(ConcatDataset([uniform, costly]), batch_size=16)
    assert batch.terrain.shape == (16, 1, 9, 11)
    assert torch.equal(batch.terrain[:8], 1 - batch.map[:8])
    assert torch.equal(batch.terrain == 0, batch.map == 1)
    assert batch.terrain[8:].max() > 1


def test_roots_with_and_without_terrain_are_no_dataset(tmp_path: Path) -> None:
    """Each is opened as a dataset of its own; the error says so."""
    uniform = samples.build_small(tmp_path / "uniform", maps=4)
    costly = samples.build_small(tmp_path / "costly", samples.ROUGH, maps=4)
    with pytest.raises(ValueError, match=r"have terrain, .* open them as datasets of their own"):
        MapDataset([costly, uniform])
    fields = ("map", "terrain", "cost")
    dataset = MapDataset(costly, fields=fields)
    assert dataset.has_terrain
    assert dataset.info.has_terrain
    twice = MapDataset([costly, costly], fields=fields)
    samples.assert_same(twice[: len(dataset)], twice[len(dataset) :])


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize("field", ["waypoints", Waypoints(8)], ids=str)
def test_waypoints_on_terrain_are_refused_when_a_dataset_is_made(
    field: Any, tmp_path: Path
) -> None:
    """Since taut lines are shortest only where all free cells cost the same."""
    fields = ("map", field)
    root = samples.build_small(tmp_path / "maps", samples.ROUGH, maps=4)
    problems = ProblemSet.sample(HILLS, SEED, 2)
    data = MapDataModule(None, build=HILLS, fields=fields)
    for refused in (
        lambda: OnlineMapDataset(HILLS, fields=fields),
        lambda: MapDataset(root, fields=fields),
        lambda: ProblemSetDataset(problems, fields=fields),
        lambda: data.setup("fit"),
    ):
        with pytest.raises(ValueError, match="fields: waypoints and bends: got maps with terrain"):
            refused()
    with pytest.raises(ValueError, match="waypoints and bends: got maps with terrain, expected"):
        MapDataset(root).filter(bends=(0, 3))


@dataclass(frozen=True)
class Expensive(Terrain):
    """Long detours through cells of the highest cost, on maps from number 2 on."""

    name: ClassVar[str] = "expensive"

    def draw(self, seed: int, indices: Ints) -> Maps:
        """Return the maps."""
        terrain = np.ones((len(indices), *self.map_size), np.uint8)
        terrain[indices >= 2] = 255
        terrain[:, 1, :-1] = 0
        return replace(
            super().draw(seed, indices),
            packed=pack((terrain == 0).astype(np.uint8)),
            terrain=terrain,
            seed_points=np.broadcast_to([[0, 0], [2, 0]], (len(indices), 2, 2)).copy(),
            rooms=np.full(len(indices), 2),
        )


@pytest.mark.parametrize(
    ("field", "problems"),
    [
        ("path", "route"),
        ("cost", "random"),
        ("start", Random(distance=(10, None))),
        ("start", Random(length=(3, None))),
        ("cost_to_go", "random"),
        ("connection_matrix", "random"),
    ],
)
def test_costs_that_are_too_high_are_refused_by_the_number_of_the_map(
    field: str, problems: Any
) -> None:
    """Rather than served inexactly."""
    generator = Expensive((3, 4000), seed_points=2, obstacles=0.0, movement=Movement(8))
    options: dict[str, Any] = {"fields": (field,), "problems": problems, "sampling_seed": 1}
    assert len(OnlineMapDataset(generator, 0, 4, **options)[:2][0]) == 2
    dataset = OnlineMapDataset(generator, 0, 4, **options)
    epochs = 20
    numbers = np.arange(4 * epochs)
    with pytest.raises(ValueError, match=r"map [23]: terrain: a path costs 1,\d\d\d,\d\d\d"):
        [dataset.__getitems__(batch) for batch in np.split(numbers, epochs)]
    one_cost = Movement(8, diagonal_cost=1)
    assert len(OnlineMapDataset(generator, 0, 4, movement=one_cost, **options)[:][0]) == 4


def test_a_map_whose_costs_are_too_high_is_reported() -> None:
    """By each kernel of fields, with its number and cost."""
    terrains = np.full((2, 1, 4200), 255, np.uint8)
    terrains[0] = 1
    starts = np.array([[0, 0], [0, 0]])
    goals = np.array([[0, 5], [0, 5]])
    memory = search_memory(terrains.shape[1:], move_rule(Movement(8)))
    empty = np.empty((0, 1, 1, 4200), np.float32)
    cost_to_go = np.empty((2, 1, 1, 4200), np.float32)
    no_bytes = empty.astype(np.uint8)
    fields = GoalFields(cost_to_go, no_bytes, empty, no_bytes)
    ground = as_ground((terrains == 0).astype(np.uint8), terrains)
    number, high_cost = fill_goal_fields(*ground, starts, goals, *memory, fields)
    assert number == 1
    assert high_cost >= 2**62
    cells = np.tile(np.stack((np.zeros(6, int), np.arange(6)), axis=1), (2, 1))
    offsets = np.array([0, 6, 12])
    _, *refused = path_probabilities(*ground, starts, goals, cells, offsets, *memory)
    assert refused[0] == 1
    assert refused[1] >= 2**62
    _, *refused = fill_room_matrices(*ground, np.stack((starts, goals), axis=1), *memory)
    assert refused[0] == 1
    assert refused[1] >= 2**62
