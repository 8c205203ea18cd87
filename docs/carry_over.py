"""What carries over to maps that were not trained on: python docs/carry_over.py.

    python docs/carry_over.py --untrained                    what needs no training: some minutes
    python docs/carry_over.py --weights FOLDER      the trainings: some hours of one core

The trainings are {maps of paper; of paper, narrow, maze, forest and noise; of the preset mixed} x
{map and goal as planes, distances to the goal as planes and a prior}. All have the same network,
target (`optimal_moves`), hard problems, number of problems and steps, and three seeds. Each network
scores moves for `mapdata.evaluation.GuidedSearch`. FOLDER keeps weights and rows: run the command
again to continue with the trainings that are missing. ``--cell`` and ``--seed`` take some of them
alone. ``--device cuda`` trains on a GPU.

Every row is measured on problems of dungeon and cave, random and hard, of paper, and of the
families "out" of the suite carry-over-1 at 64 x 64; with ``--maps FOLDER`` also on windows of the
maps of robots in it, as docs/zero_shot.py cuts them.
docs/carry_over_results.json gets the tables of `mapdata.evaluate`, whose differences are those from
the guided search without a network on the same problems, with intervals of a paired bootstrap.

Without training, two searches are compared, each with the prior and with the pretrained path
predictor in it: the guided search, and the search of docs/problem_trainings.py, which adds a
penalty to moves that are at most half as probable as the best one. Its penalty is the one with the
best Hmean on validation problems of paper. docs/which_problems.md has this table.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import problem_trainings as searches
import torch
from planner_results import plain, this_run
from planner_tables import DOCS, filled, markdown, words_of
from torch import Tensor
from zero_shot import grids_of, hard_problems

from mapdata import OnlineMapDataset, Plan, ProblemSet, evaluate
from mapdata.arrays import Bytes, Float32s, Ints
from mapdata.evaluation import SUITES, GuidedSearch, Part, Planner, classical, prior
from mapdata.limits import Cell
from mapdata.models import PathPredictor, fast_precision
from mapdata.models.pretrained.geometry import legal_moves
from mapdata.models.pretrained.layers import Trunk, padded
from mapdata.models.pretrained.optimizer import Muon, one_cycle
from mapdata.models.pretrained.path_predictor import encode
from mapdata.shards import write_output

MOVEMENT = searches.MOVEMENT
NO_NETWORK = searches.NO_NETWORK
WEIGHTED = ("weighted A* (1.25)", "weighted A* (1.5)", "weighted A* (2)")

FAMILIES = {
    "paper": ("paper",),
    "many": ("paper", "narrow", "maze", "forest", "noise"),
    "mixed": ("mixed",),
}
"""The presets that networks are trained on: one, all of 64 x 64 but dungeon and cave, a mixture."""

PLANES = ("raw", "goal")
"""Map and goal alone; or distances to the goal, with scores that begin at the prior."""

CELLS = [f"{families}-{planes}" for families in FAMILIES for planes in PLANES]

PROBLEMS = 32_768
STEPS = 1000
BATCH = 64

HAS_BFLOAT16 = fast_precision() == "bf16-mixed"
"""Whether this processor has fast bfloat16. Trainings use it, measurements use float32."""

METRICS = ("opt", "expansion_ratio")
"""The metrics of the tables; the file has all of `mapdata.evaluate`."""

WINDOWS = 300
"""Hard problems on windows of each map of ``--maps``."""


# --- searches without a training ----------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PenaltySearch:
    """The search of docs/problem_trainings.py, by scores of moves as `GuidedSearch` takes them.

    Attributes:
        name: of its row.
        predict: returns scores of the moves and costs to go; the latter are not used.
        penalty: of a move that is at most half as probable as the best legal one, in cells.
    """

    name: str
    predict: Any
    penalty: float

    def plan(self, grid: Bytes, start: Cell, goal: Cell) -> Plan:
        """Return a path on ``grid``, (H, W)."""
        scores, _ = self.predict(grid[None], np.array([goal]))
        legal = legal_moves(torch.tensor(grid)[None, None], MOVEMENT)[0].numpy()
        best = np.where(legal, scores[0], -np.inf).max(axis=0)  # (H, W)
        best[np.isinf(best)] = 0  # no legal move
        shares = np.exp(np.minimum(scores[0] - best, 0))
        found = searches.guided_search(
            grid, np.array(start), np.array(goal), shares.astype(np.float32), self.penalty
        )
        return Plan(np.array(found.path), found.expansions)


def penalty_search(name: str, predict: Any) -> PenaltySearch:
    """Return the search with the penalty whose Hmean on validation problems is the best."""
    validation = ProblemSet.sample(
        "paper",
        searches.VALIDATION_SEED,
        searches.VALIDATION_PROBLEMS,
        movement=MOVEMENT,
        problems=searches.HARD,
    )
    rows: list[Planner] = [
        PenaltySearch(str(penalty), predict, penalty) for penalty in searches.PENALTIES
    ]
    table = evaluate(rows, validation, bootstrap=1)
    hmeans = table[table["subset"] == "all"]["hmean"]
    return PenaltySearch(name, predict, searches.PENALTIES[int(np.argmax(hmeans))])


def untrained_planners() -> list[Planner]:
    """Return the planners that need no training, the pretrained network among them."""
    by_prior = partial(prior, movement=MOVEMENT)
    network = PathPredictor.pretrained().predict
    return [
        *(planner for planner in classical(MOVEMENT) if planner.name in (*WEIGHTED, NO_NETWORK)),
        GuidedSearch("walk, no network", MOVEMENT, by_prior, math.inf),
        penalty_search("penalty search, no network", by_prior),
        GuidedSearch("guided search, pretrained network", MOVEMENT, network),
        penalty_search("penalty search, pretrained network", network),
    ]


# --- trainings ----------------------------------------------------------------------------------


class Network(torch.nn.Module):
    """Scores of moves for each cell; ``planes`` is one of `PLANES`."""

    def __init__(self, planes: str) -> None:
        """Make the layers. The last one begins at 0, so that "goal" begins as the prior."""
        super().__init__()
        self.planes = planes
        inputs = 2 if planes == "raw" else 8
        self.trunk = Trunk(inputs, len(searches.MOVES), widths=(24, 32, 48, 64), passes=2)
        for parameter in self.trunk.head.parameters():
            torch.nn.init.zeros_(parameter)

    def forward(self, maps: Tensor, goals: Tensor) -> Tensor:
        """Return scores (B, 8, H, W) for maps (B, H, W) of 0 and 1, and goals (B, 2)."""
        rows, columns = maps.shape[1:]
        occupied = padded(maps[:, None])
        planes, detours = encode(occupied, goals, MOVEMENT)
        if self.planes == "raw":
            planes = planes[:, :2]  # free cells, and the goal
        scores: Tensor = self.trunk(planes)
        if self.planes == "goal":
            scores = scores - 3 * detours
        return scores[..., :rows, :columns]

    @torch.inference_mode()
    def predict(self, grids: Bytes, goals: Ints) -> tuple[Tensor, Float32s]:
        """Return what `GuidedSearch` takes; the costs to go are those of the prior."""
        _, costs_to_go = prior(grids, goals, MOVEMENT)
        return self(torch.from_numpy(grids), torch.from_numpy(goals)), costs_to_go


def loss_of(scores: Tensor, maps: Tensor, optimal: Tensor) -> Tensor:
    """Return the mean of -log P(an optimal move) over the cells that have one.

    Args:
        scores: (B, 8, H, W).
        maps: (B, H, W) of 0 and 1.
        optimal: (B, H, W) uint8, the bits of the optimal moves.
    """
    legal = legal_moves(maps[:, None], MOVEMENT)
    bits = torch.arange(scores.shape[1], device=maps.device)[:, None, None]
    is_optimal = (optimal.int()[:, None] >> bits & 1).bool()
    scores = scores.masked_fill(~legal, -1e4)
    losses = scores.logsumexp(1) - scores.masked_fill(~is_optimal, -1e4).logsumexp(1)
    return losses[optimal > 0].mean()


def training_problems(families: tuple[str, ...], count: int) -> tuple[Tensor, ...]:
    """Return maps (N, H, W), goals (N, 2) and optimal moves (N, H, W) of hard problems.

    Each family has an equal share of the ``count`` problems.
    """
    parts = []
    for family in families:
        dataset = OnlineMapDataset(
            family,
            length=count // len(families),
            split="train",
            fields=("map", "goal", "optimal_moves"),
            problems=searches.HARD,
            movement=MOVEMENT,
        )
        batch: Any = dataset[:]
        parts.append((batch.map[:, 0], batch.goal.long(), batch.optimal_moves[:, 0]))
    return tuple(torch.cat(tensors) for tensors in zip(*parts, strict=True))


def train(planes: str, problems: tuple[Tensor, ...], seed: int, steps: int) -> Network:
    """Return a trained network on the processor.

    Args:
        planes: one of `PLANES`.
        problems: what `training_problems` returns, on the device to train on.
        seed: of the weights and of the order of the problems.
        steps: number of steps.
    """
    torch.manual_seed(seed)
    maps, goals, optimal = problems
    network = Network(planes).to(maps.device)
    optimizer = Muon(network.parameters(), lr=0.004)
    schedule = one_cycle(optimizer, steps)["lr_scheduler"]["scheduler"]
    order = torch.empty(0, dtype=torch.int64)
    for step in range(steps):
        if len(order) < BATCH:
            order = torch.randperm(len(maps))
        rows, order = order[:BATCH].to(maps.device), order[BATCH:]
        with torch.autocast(maps.device.type, torch.bfloat16, enabled=HAS_BFLOAT16):
            scores = network(maps[rows], goals[rows])
        loss = loss_of(scores.float(), maps[rows], optimal[rows])
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        schedule.step()
        if (step + 1) % 100 == 0:
            print(f"  step {step + 1}, loss {loss.item():.3f}", flush=True)
    return network.cpu().eval()


def trained(options: argparse.Namespace, folder: Path) -> dict[str, Network]:
    """Return the networks that are asked for by name, trained where ``folder`` lacks them."""
    folder.mkdir(parents=True, exist_ok=True)
    networks = {}
    for cell in options.cell:
        families, _, planes = cell.partition("-")
        files = {seed: folder / f"{cell}-{seed}.pt" for seed in options.seed}
        missing = [seed for seed, file in files.items() if not file.exists()]
        if missing:
            problems = tuple(
                tensor.to(options.device)
                for tensor in training_problems(FAMILIES[families], options.problems)
            )
        for seed in missing:
            print(f"{cell}, seed {seed}", flush=True)
            began = time.process_time()
            network = train(planes, problems, seed, options.steps)
            print(f"  {(time.process_time() - began) / 60:.1f} minutes of a core", flush=True)
            files[seed].with_suffix(".json").unlink(missing_ok=True)  # the rows of older weights
            torch.save(network.state_dict(), files[seed])
        for file in files.values():
            networks[file.stem] = Network(planes).eval()
            networks[file.stem].load_state_dict(torch.load(file, weights_only=True))
    return networks


# --- tables -------------------------------------------------------------------------------------


def suite_parts() -> list[Part]:
    """Return the parts of the suite whose families no training has, at 64 x 64."""
    parts = SUITES["carry-over-1"]
    return [part for part in parts if part.group == "out" and part.generator.map_size == (64, 64)]


def test_sets(maps: Path | None) -> dict[str, ProblemSet]:
    """Return the sets of docs/problem_trainings.py and of the suite, and those of a folder."""
    sets = {name: searches.problems_of(name) for name in searches.TEST_SETS}
    sets |= {part.name: part.problem_set() for part in suite_parts()}
    for name, grid in {} if maps is None else grids_of(maps).items():
        windows = hard_problems(name, grid, MOVEMENT, 64, WINDOWS)
        if windows is not None:
            sets[name] = windows
    return sets


def measured(rows: list[Planner], sets: dict[str, ProblemSet]) -> dict[str, Any]:
    """Return the rows of `evaluate` on each set, by its name, with the hash of its problems."""
    tables = {}
    for name, problems in sets.items():
        table = evaluate(rows, problems, difference_from=NO_NETWORK)
        records = table[table["subset"] == "all"].to_dict("records")
        tables[name] = {
            "hash": problems.content_hash,
            "rows": [{str(key): plain(value) for key, value in row.items()} for row in records],
        }
        print(f"{name}: measured", flush=True)
    return tables


def measured_networks(
    networks: dict[str, Network], sets: dict[str, ProblemSet], folder: Path
) -> dict[str, Any]:
    """Return the rows of the networks on each set, as `measured` does.

    A file in ``folder`` keeps the rows of each network, beside its weights, so that a second call
    measures only what is new.
    """
    no_network = next(one for one in classical(MOVEMENT) if one.name == NO_NETWORK)
    hashes = {name: problems.content_hash for name, problems in sets.items()}
    tables: dict[str, Any] = {}
    for planner, network in networks.items():
        file = folder / f"{planner}.json"
        kept = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
        if {name: table["hash"] for name, table in kept.items()} != hashes:
            print(planner, flush=True)
            kept = measured([no_network, GuidedSearch(planner, MOVEMENT, network.predict)], sets)
            write_output(file, json.dumps(kept).encode())
        for name, table in kept.items():
            if name in tables:
                tables[name]["rows"].append(table["rows"][1])
            else:
                tables[name] = table
    return tables


def columns_of(sets: dict[str, Any]) -> dict[str, list[str]]:
    """Return the columns of a table: their titles, and which of the sets each is the mean of."""
    suite = [part.name for part in suite_parts()]
    columns = {name: [name] for name in searches.SHOWN_SETS}
    columns["suite, out"] = suite
    columns["robots' maps"] = [name for name in sets if name not in (*searches.TEST_SETS, *suite)]
    return {
        title: shown
        for title, names in columns.items()
        if (shown := [name for name in names if name in sets])
    }


def table_of(sets: dict[str, Any], metric: str) -> str:
    """Return a table: a line for each planner or cell of the trainings, a column for some sets.

    The first line is the row without a network, with its figures. The others have the differences
    from it: means over the sets of a column, and over the seeds of a training. In brackets are the
    lowest and the highest end of the seeds' intervals, each the mean over the sets of the column.
    """
    columns = columns_of(sets)
    rows = {name: {row["planner"]: row for row in sets[name]["rows"]} for name in sets}
    lines = [["", *columns]]
    base = ["no network: " + ("optimal" if metric == "opt" else "expansions")]
    for names in columns.values():
        base.append(f"{np.mean([rows[name][NO_NETWORK][metric] for name in names]):.2f}")
    lines.append(base)
    groups: dict[str, list[str]] = {}
    for planner in rows[next(iter(sets))]:
        cell, _, _ = planner.rpartition("-")
        label = f"`{cell.replace('-', '`, ')}" if cell in CELLS else planner
        groups.setdefault(label, []).append(planner)
    del groups[NO_NETWORK]
    for label, planners in groups.items():
        line = [label]
        for names in columns.values():
            values, lows, highs = (
                [
                    np.mean([rows[name][planner][f"{metric}_difference{end}"] for name in names])
                    for planner in planners
                ]
                for end in ("", "_low", "_high")
            )
            line.append(f"{np.mean(values):+.2f} [{min(lows):+.2f}, {max(highs):+.2f}]")
        lines.append(line)
    return markdown(lines)


def write(results: dict[str, Any], folder: Path) -> None:
    """Write the results, and their tables into the page."""
    write_output(
        folder / "carry_over_results.json", (json.dumps(results, indent=1) + "\n").encode()
    )
    page = folder / "which_problems.md"
    tables = {
        f"{kind}-{metric}": table_of(measurement["sets"], metric)
        for kind, measurement in results.items()
        for metric in METRICS
    }
    if page.exists():
        write_output(page, filled(page.read_text(encoding="utf-8"), tables).encode())


def main(arguments: list[str] | None = None) -> None:
    """Measure what the command line says, and write the results."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--untrained", action="store_true", help="measure what needs no training")
    parser.add_argument("--weights", type=Path, metavar="FOLDER", help="train, and keep them here")
    parser.add_argument("--cell", choices=CELLS, action="append", help="of the trainings")
    parser.add_argument("--seed", type=int, action="append", help="of the trainings")
    parser.add_argument("--device", default="cpu", help="where to train: cpu, cuda")
    parser.add_argument("--steps", type=int, default=STEPS, help="of a training")
    parser.add_argument("--problems", type=int, default=PROBLEMS, help="of a training")
    parser.add_argument("--maps", type=Path, metavar="FOLDER", help="of .map and .yaml files")
    parser.add_argument("--pages", action="store_true", help="measure nothing")
    parser.add_argument("--folder", type=Path, default=DOCS, help="of results and pages")
    options = parser.parse_args(arguments)
    options.cell = options.cell or CELLS
    options.seed = options.seed or [0, 1, 2]
    torch.set_num_threads(1)
    path = options.folder / "carry_over_results.json"
    results = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    words = words_of(sys.argv[1:] if arguments is None else arguments)
    run = this_run(" ".join(["python docs/carry_over.py", *words]))
    if options.untrained:
        sets = measured(untrained_planners(), test_sets(options.maps))
        results["untrained"] = {"run": run, "sets": sets}
    elif options.weights is not None:
        folder = options.weights / f"{options.steps}-steps"
        networks = trained(options, folder)
        sets = measured_networks(networks, test_sets(options.maps), folder)
        results["trained"] = {"run": run, "steps": options.steps, "sets": sets}
        for metric in METRICS:
            print(f"\n{metric}\n\n{table_of(sets, metric)}")
    elif not options.pages:
        parser.error("expected --untrained, --weights FOLDER or --pages")
    write(results, options.folder)


if __name__ == "__main__":
    main()
