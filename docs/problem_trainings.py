"""Train one small network on five kinds of problems: python docs/problem_trainings.py.

All trainings have the same network, the same number of problems and steps, maps of the preset
``paper`` and 8 moves. They differ in the problems and in the target. Each network then guides the
same search on problems of two families that it has not seen. docs/training_results.json gets the
scores, from which docs/which_problems.md has its tables.

The search is A* with another order. The key of a cell in the queue is g + h: the cost of the path
to it, plus the heuristic. A penalty is added where the network does not expect a shortest path:
where it gives the cell, or the move that leads there, a probability of at most 1/2. Of equal keys
the latest comes first. So a network that expects a path everywhere leaves A* as it is. The penalty
is chosen for each network on validation problems of ``paper``.

The first row is `mapdata.evaluation.GuidedSearch` without a network, which needs no training.
``--no-network`` measures this row alone.

With ``--device cuda`` it takes a quarter of an hour, on one core of a processor hours. ``--weights
FOLDER`` keeps the trained networks, and takes those that are there.
"""

from __future__ import annotations

import argparse
import heapq
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from scipy.stats import binomtest
from torch import Tensor

from mapdata import Movement, OnlineMapDataset, ProblemSet, Random, check_path
from mapdata.arrays import Bytes, Float32s, Floats, Ints
from mapdata.evaluation import BatchPlanner, classical, confidence_intervals
from mapdata.models.pretrained.layers import Trunk
from mapdata.problems.sources import SourceLike
from mapdata.search import STEPS

DOCS = Path(__file__).parent
MOVEMENT = Movement(8)
HARD = Random(hardness=(1.05, None))

TRAININGS: dict[str, tuple[SourceLike, str]] = {
    "`route` (default), `path_mask`": ("route", "path_mask"),
    "`random`, `path_mask`": ("random", "path_mask"),
    "hard, `path_mask`": (HARD, "path_mask"),
    "hard, `optimal_mask`": (HARD, "optimal_mask"),
    "hard, `optimal_moves`": (HARD, "optimal_moves"),
}
"""The problems and the target of each training."""

TRAINING_PROBLEMS = 32_768
TRAINING_STEPS = 6000
BATCH = 64
SEEDS = (0, 1)

VALIDATION_SEED = 31
TEST_SEED = 4242
VALIDATION_PROBLEMS = 100
TEST_PROBLEMS = 300
TEST_SETS: dict[str, tuple[str, SourceLike]] = {
    "`paper`, hard": ("paper", HARD),
    "`dungeon`, random": ("dungeon", "random"),
    "`dungeon`, hard": ("dungeon", HARD),
    "`cave`, random": ("cave", "random"),
    "`cave`, hard": ("cave", HARD),
}
"""The problems that the networks are scored on. Their maps have other seeds than those of training.
"""

SHOWN_SETS = ("`paper`, hard", "`dungeon`, hard", "`cave`, hard")
"""The columns of the page, as many as a phone shows. The file has all of `TEST_SETS`."""

PENALTIES = (0.5, 2.0, 8.0, 32.0)

NO_NETWORK = "guided search, no network"

MOVES = [(int(down), int(right)) for down, right in STEPS]
LENGTHS = [math.hypot(down, right) for down, right in MOVES]


# --- training -----------------------------------------------------------------------------------


class Network(torch.nn.Module):
    """A small convolutional network: planes of map, start and goal in, logits of cells out."""

    def __init__(self, outputs: int) -> None:
        """Make the layers; ``outputs`` is 1 for a mask and 8 for moves."""
        super().__init__()
        self.trunk = Trunk(3, outputs, widths=(24, 32, 48, 64), passes=2)

    def forward(self, planes: Tensor) -> Tensor:
        """Return logits (B, outputs, H, W) for planes (B, 3, H, W)."""
        logits: Tensor = self.trunk(planes)
        return logits


def planes_of(maps: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
    """Return the input of the network, (B, 3, H, W), for maps (B, H, W) and cells (B, 2)."""
    planes = torch.zeros(len(maps), 3, *maps.shape[1:], device=maps.device)
    planes[:, 0] = maps
    problems = torch.arange(len(maps), device=maps.device)
    planes[problems, 1, starts[:, 0], starts[:, 1]] = 1
    planes[problems, 2, goals[:, 0], goals[:, 1]] = 1
    return planes


def train(
    maps: Tensor, starts: Tensor, goals: Tensor, targets: Tensor, outputs: int, seed: int
) -> Network:
    """Return a network that is trained on N problems, on the device of the tensors.

    Args:
        maps: (N, H, W) uint8.
        starts: (N, 2) int64.
        goals: (N, 2) int64.
        targets: (N, H, W) uint8: a mask, or the bits of the moves.
        outputs: 1 for a mask, 8 for moves.
        seed: of the weights and of the order of the problems.
    """
    torch.manual_seed(seed)
    network = Network(outputs).to(maps.device)
    optimizer = torch.optim.AdamW(network.parameters(), lr=2e-3, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 2e-3, TRAINING_STEPS)
    bits = torch.arange(outputs, device=maps.device)[:, None, None]
    order = torch.empty(0, dtype=torch.int64)
    for _ in range(TRAINING_STEPS):
        if len(order) < BATCH:
            order = torch.randperm(len(maps))
        rows = order[:BATCH].to(maps.device)
        order = order[BATCH:]
        logits = network(planes_of(maps[rows], starts[rows], goals[rows]))
        wanted = ((targets[rows].int()[:, None] >> bits) & 1).float()
        loss = F.binary_cross_entropy_with_logits(logits, wanted)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        schedule.step()
    return network.eval()


def training_problems(problems: SourceLike, target: str) -> tuple[Tensor, ...]:
    """Return the maps, starts, goals and targets of a training, as `train` takes them."""
    dataset = OnlineMapDataset(
        "paper",
        length=TRAINING_PROBLEMS,
        split="train",
        fields=("map", "start", "goal", target),
        problems=problems,
        movement=MOVEMENT,
    )
    batch: Any = dataset[:]
    return batch.map[:, 0], batch.start.long(), batch.goal.long(), batch[3][:, 0]


# --- the search ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Found:
    """What a search found: the cost of its path, how many cells it expanded, and the path."""

    cost: float
    expansions: int
    path: list[tuple[int, int]]


def guided_search(
    grid: Bytes, start: Ints, goal: Ints, probabilities: Float32s, penalty: float
) -> Found:
    """Search a path by A* that puts off cells where the network does not expect a path.

    Args:
        grid: (H, W).
        start: (2,), from which a path leads to the goal.
        goal: (2,).
        probabilities: (1, H, W) of cells, or (8, H, W) of moves.
        penalty: what is added to the key of a cell that the network does not expect; 0 for A*.
    """
    free = np.pad(grid == 0, 1).tolist()
    is_of_moves = len(probabilities) == len(MOVES)
    penalties = np.where(probabilities > 0.5, 0.0, penalty)
    penalty_of = np.broadcast_to(penalties, (len(MOVES), *grid.shape)).tolist()
    first = (int(start[0]), int(start[1]))
    last = (int(goal[0]), int(goal[1]))
    costs = {first: 0.0}
    parents: dict[tuple[int, int], tuple[int, int]] = {}
    closed = set()
    queue = [(0.0, 0, first)]
    pushes = 0
    while queue:
        _, _, cell = heapq.heappop(queue)
        if cell in closed:
            continue
        closed.add(cell)
        if cell == last:
            path = [cell]
            while path[-1] != first:
                path.append(parents[path[-1]])
            return Found(costs[cell], len(closed), path[::-1])
        row, column = cell
        for k, (down, right) in enumerate(MOVES):
            there = (row + down, column + right)
            # The padded map has cell (r, c) at (r + 1, c + 1). Diagonal moves cut no corner.
            if not free[row + down + 1][column + right + 1]:
                continue
            if not (free[row + down + 1][column + 1] and free[row + 1][column + right + 1]):
                continue
            cost = costs[cell] + LENGTHS[k]
            if there not in closed and cost < costs.get(there, math.inf):
                costs[there] = cost
                parents[there] = cell
                place = cell if is_of_moves else there
                key = cost + _heuristic(there, last) + penalty_of[k][place[0]][place[1]]
                pushes += 1
                heapq.heappush(queue, (key, -pushes, there))
    raise ValueError(f"no path from {first} to {last}")


def _heuristic(cell: tuple[int, int], goal: tuple[int, int]) -> float:
    """Return the cost of the shortest path on an empty map with 8 moves."""
    rows, columns = abs(cell[0] - goal[0]), abs(cell[1] - goal[1])
    return max(rows, columns) + (math.sqrt(2) - 1) * min(rows, columns)


@torch.no_grad()
def predict(network: Network, problems: ProblemSet) -> Float32s:
    """Return the probabilities of all problems, (N, 1 or 8, H, W)."""
    tensors = [
        torch.from_numpy(array.copy())
        for array in (problems.grids, problems.starts, problems.goals)
    ]
    planes = planes_of(*tensors)
    probabilities: Float32s = torch.cat(
        [network(part).sigmoid() for part in planes.split(64)]
    ).numpy()
    return probabilities


def searched(problems: ProblemSet, probabilities: Float32s, penalty: float) -> Floats:
    """Return for each problem whether its path is optimal, and its expansions, (N, 2)."""
    rows = []
    optimal = problems.optimal.cost
    for k in range(len(problems)):
        found = guided_search(
            problems.grids[k], problems.starts[k], problems.goals[k], probabilities[k], penalty
        )
        rows.append((found.cost <= optimal[k] + 1e-6, found.expansions))
    return np.array(rows, float)


# --- scores -------------------------------------------------------------------------------------


def chosen_penalty(network: Network, problems: ProblemSet, plain: Floats) -> float:
    """Return the penalty with the largest harmonic mean of optimal paths and saved expansions.

    Args:
        network: that guides the search.
        problems: of validation.
        plain: (N, 2), what `searched` says of A*.
    """
    probabilities = predict(network, problems)
    scores = []
    for penalty in PENALTIES:
        optimal, expansions = searched(problems, probabilities, penalty).mean(axis=0)
        saved = max(1 - expansions / plain[:, 1].mean(), 0.0)
        scores.append(2 * optimal * saved / max(optimal + saved, 1e-9))
    return PENALTIES[int(np.argmax(scores))]


def without_network(problems: ProblemSet) -> Floats:
    """Return what `searched` says of A*."""
    nothing = np.zeros((len(problems), 1, *problems.grids.shape[1:]), np.float32)
    return searched(problems, nothing, 0.0)


def by_the_prior(problems: ProblemSet) -> Floats:
    """Return what `searched` says of the guided search without a network."""
    (planner,) = [one for one in classical(MOVEMENT) if one.name == NO_NETWORK]
    assert isinstance(planner, BatchPlanner)
    plans = planner.plan_batch(problems.grids, problems.starts, problems.goals)
    costs = [
        check_path(grid, plan.path, MOVEMENT)
        for grid, plan in zip(problems.grids, plans, strict=True)
    ]
    expansions = [plan.expansions for plan in plans]
    return np.array([costs == problems.optimal.cost, expansions], float).T


def row_of(results: Floats, plain: Floats) -> dict[str, list[float]]:
    """Return the optimal share and the expansions beside A*, each with its interval of 95 %.

    Args:
        results: (S, N, 2), what `searched` says of the networks of all seeds.
        plain: (N, 2), what it says of A*.
    """
    optimal = results[:, :, 0]
    outcomes = np.stack((results[:, :, 1].mean(axis=0), plain[:, 1]), axis=1)  # (N, 2)
    ratio = confidence_intervals(outcomes, lambda means: means[..., :1] / means[..., 1:])
    share = binomtest(int(optimal.sum()), optimal.size)
    ends = share.proportion_ci(method="wilson")
    return {
        "optimal": [share.statistic, ends.low, ends.high],
        "expansions": ratio[:, 0].tolist(),
        "optimal of each seed": optimal.mean(axis=1).tolist(),
        "expansions of each seed": (results[:, :, 1].mean(axis=1) / plain[:, 1].mean()).tolist(),
    }


def problems_of(set_name: str) -> ProblemSet:
    """Return the problems of one of `TEST_SETS`."""
    family, problems = TEST_SETS[set_name]
    return ProblemSet.sample(family, TEST_SEED, TEST_PROBLEMS, movement=MOVEMENT, problems=problems)


def row_without_network(problems: ProblemSet, plain: Floats) -> dict[str, list[float]]:
    """Return the row of the guided search without a network; ``plain`` is as in `row_of`."""
    return row_of(by_the_prior(problems)[None], plain)


def measure(networks: dict[str, list[Network]]) -> dict[str, Any]:
    """Return the rows of all trainings on all test sets."""
    validation = ProblemSet.sample(
        "paper", VALIDATION_SEED, VALIDATION_PROBLEMS, movement=MOVEMENT, problems=HARD
    )
    plain_validation = without_network(validation)
    penalties = {
        name: [chosen_penalty(network, validation, plain_validation) for network in of_seeds]
        for name, of_seeds in networks.items()
    }
    sets: dict[str, Any] = {}
    for set_name in TEST_SETS:
        test = problems_of(set_name)
        plain = without_network(test)
        rows = {NO_NETWORK: row_without_network(test, plain)}
        for name, of_seeds in networks.items():
            results = [
                searched(test, predict(network, test), penalty)
                for network, penalty in zip(of_seeds, penalties[name], strict=True)
            ]
            rows[name] = row_of(np.array(results), plain)
        sets[set_name] = {"hash": test.content_hash, "rows": rows}
        print(f"{set_name}: measured", flush=True)
    return {"penalties": penalties, "sets": sets}


def table_of(results: dict[str, Any], figure: str) -> str:
    """Return a table of the page, with a line for each row of the file.

    Args:
        results: as in docs/training_results.json.
        figure: "optimal" or "expansions".
    """
    names = [name for name in results["sets"] if name in SHOWN_SETS]
    lines = [f"| trained on | {' | '.join(names)} |", "|---" + "|--:" * len(names) + "|"]
    for training in next(iter(results["sets"].values()))["rows"]:
        cells = [text_of(results["sets"][name]["rows"][training][figure], figure) for name in names]
        lines.append(f"| {training} | {' | '.join(cells)} |")
    return "\n".join(lines)


def text_of(values: list[float], figure: str) -> str:
    """Return a value and half the width of its interval as the page prints them."""
    value, low, high = values
    half_width = (high - low) / 2
    if figure == "optimal":
        return f"{value:.0%} ±{100 * half_width:.0f}"
    return f"{value:.2f} ±{half_width:.2f}"


def write(results: dict[str, Any], file: Path) -> None:
    """Write the results to a file, and print their tables."""
    file.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    for figure in ("optimal", "expansions"):
        print(f"{figure}\n\n{table_of(results, figure)}\n")


def main(arguments: list[str] | None = None) -> None:
    """Train, measure, and write the results."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", default="cpu", help="where to train: cpu, cuda")
    parser.add_argument("--weights", type=Path, metavar="FOLDER", help="of trained networks")
    parser.add_argument("--no-network", action="store_true", help="measure the first row alone")
    options = parser.parse_args(arguments)
    file = DOCS / "training_results.json"
    if options.no_network:
        results = json.loads(file.read_text(encoding="utf-8"))
        for set_name, of_set in results["sets"].items():
            test = problems_of(set_name)
            rows = {NO_NETWORK: row_without_network(test, without_network(test))}
            of_set["rows"].pop(NO_NETWORK, None)
            of_set["rows"] = rows | of_set["rows"]
        write(results, file)
        return
    networks: dict[str, list[Network]] = {}
    for number, (name, (problems, target)) in enumerate(TRAININGS.items()):
        outputs = 8 if target == "optimal_moves" else 1
        networks[name] = []
        for seed in SEEDS:
            kept = options.weights / f"training-{number}-{seed}.pt" if options.weights else None
            if kept is not None and kept.exists():
                network = Network(outputs).eval()
                network.load_state_dict(torch.load(kept, weights_only=True))
            else:
                maps, starts, goals, targets = (
                    tensor.to(options.device) for tensor in training_problems(problems, target)
                )
                network = train(maps, starts, goals, targets, outputs, seed).cpu()
                if kept is not None:
                    options.weights.mkdir(parents=True, exist_ok=True)
                    torch.save(network.state_dict(), kept)
            networks[name].append(network)
            print(f"{name}, seed {seed}: trained", flush=True)
    write(measure(networks), file)


if __name__ == "__main__":
    main()
