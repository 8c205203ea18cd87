"""Compare losses for costs from images on one network: python docs/loss_tables.py FILE.

A `mapdata.models.CostPredictor` is trained on images of ``tiles`` by three losses:

- "paths": the loss of mapdata, from shortest paths alone (`CostPredictor.path_loss`);
- "SPO+": Elmachtoub and Grigas, Management Science 2022, from the true costs;
- "Fenchel-Young": perturbed, one sample a step, Berthet et al., NeurIPS 2020, from shortest paths.

The last two are those of PyEPO (``pip install pyepo``; 2.2.7 was used). Its solver is the search of
mapdata, which solves a whole batch at once, so no loss waits for a slower search than another one.

Each loss has four trials: two values of its own option, with two learning rates each. A
trial is trained for `SECONDS` of CPU time and scored on 500 maps of `TRIAL_SEED`. The best one is
then trained with three other seeds, for `SECONDS` and for `STEPS`, and these models are scored on
1,000 maps of the seed of docs/image_tables.py, once.

FILE collects the rows as JSON and grows, so the command can be stopped and run again. At the end
the table is written into docs/costs.md. All rows take one core about half an hour.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytorch_lightning as pl
import torch
from image_tables import FAMILIES, PAGE, predicted_terrain, problems_of, scores, training_batches
from torch import Tensor

from mapdata import ProblemSet, Sample, search_batch, terrain_from_costs
from mapdata.arrays import Bytes, Floats, Ints
from mapdata.models import CostPredictor
from mapdata.models.pretrained.cost_predictor import BETAS, centred
from mapdata.shards import write_output

BEGIN, END = "<!-- losses -->", "<!-- end of losses -->"
"""The marks around the table in the page."""

FAMILY = FAMILIES["tiles 12"]
MOVEMENT = FAMILY.generator.movement
SHAPE = (FAMILY.batch_size, 12, 12)
"""Maps, rows and columns of a batch."""

TRAINING_MAPS = 10_000

SECONDS = 45.0
"""CPU time of a training, of one core."""

STEPS = 4000
"""Steps of a training at equal steps."""

TRIAL_SEED, TRIAL_MAPS = 177, 500
"""The maps on which trials are scored. `TRIAL_SEED` is the seed of their trainings, too."""

SEEDS = (0, 1, 2)
"""The seeds of the trainings that are scored on the test maps."""

OPTIONS = {
    "paths": ("parts", (0, 8)),
    "SPO+": ("scale", (0.1, 1.0)),
    "Fenchel-Young": ("sigma", (0.03, 0.1)),
}
"""The own option of each loss: its name, and the values that are tried.

- parts: random parts of each path that a step asks for beside the whole.
- scale: geometric mean of the true costs; that of the predicted ones is 1.
- sigma: deviation of the noise that is added to the predicted costs.
"""

RATES = (0.01, 0.003)
"""The learning rates that are tried."""

Loss = Callable[[CostPredictor, Sample], Tensor]


def path_masks(costs: Floats, grids: Bytes, starts: Ints, goals: Ints) -> Floats:
    """Return the cells of the shortest paths under ``costs`` (B, H, W), as masks of this shape.

    A cost below 0 counts as 0. With diagonal moves of cost 1, the cost of a path is the sum of its
    cells, less half of the two ends, so the shortest paths are those of PyEPO's notebook.
    """
    terrain = terrain_from_costs(costs.clip(min=0), grids)
    found = search_batch("astar", grids, starts, goals, MOVEMENT, terrain=terrain)
    return found.masks(costs.shape).astype(np.float64)


def problem_arrays(batch: Sample) -> tuple[Bytes, Ints, Ints]:
    """Return grids, starts and goals of a batch."""
    grids = batch.map[:, 0].byte().cpu().numpy()
    return grids, batch.start.cpu().numpy(), batch.goal.cpu().numpy()


def teacher_masks(batch: Sample) -> Tensor:
    """Return the cells of the paths of a batch, as masks (B, H, W)."""
    masks = torch.zeros_like(batch.map[:, 0], dtype=torch.float32)
    problem, step = (batch.path[:, :, 0] >= 0).nonzero(as_tuple=True)
    masks[(problem, *batch.path[problem, step].unbind(1))] = 1
    return masks


def batch_model() -> Any:
    """Return PyEPO's model of a batch of shortest paths, which is one linear program.

    Its ``problems`` are the grids, starts and goals of the batch, and are set before each solution.
    """
    model_class: Any = import_module("pyepo.model.opt").optModel

    # PyEPO has no types.
    class BatchModel(model_class):  # type: ignore[misc]
        problems: tuple[Bytes, Ints, Ints]

        def _getModel(self) -> tuple[None, range]:  # noqa: N802  (PyEPO's names)
            return None, range(math.prod(SHAPE))

        def setObj(self, c: Any) -> None:  # noqa: N802
            self.costs = np.asarray(c, np.float64).reshape(SHAPE)

        def solve(self) -> tuple[Floats, float]:
            masks = path_masks(self.costs, *self.problems)
            return masks.ravel(), float((masks * self.costs).sum())

    return BatchModel()


def loss_of(method: str, option: float, seed: int) -> Loss:
    """Return a loss: a function of the model and a batch, the mean over the maps of the batch."""
    if method == "paths":
        return lambda model, batch: model.path_loss(batch)
    import pyepo

    optimization = batch_model()
    if method == "SPO+":
        spo_plus = pyepo.func.SPOPlus(optimization)
    else:
        fenchel_young = pyepo.func.PFY(optimization, n_samples=1, sigma=option, seed=seed)

    def loss(model: CostPredictor, batch: Sample) -> Tensor:
        optimization.problems = problem_arrays(batch)
        predicted = model(batch.image, batch.map).reshape(1, -1)
        solution = teacher_masks(batch).reshape(1, -1)
        if method == "SPO+":
            log_costs = batch.terrain[:, 0].float().clamp(min=1).log()
            true_costs = (option * centred(log_costs, batch.map).exp()).reshape(1, -1)
            objective = (true_costs * solution).sum(dim=1, keepdim=True)
            total = spo_plus(predicted, true_costs, solution, objective)
        else:
            total = fenchel_young(predicted, solution)
        mean: Tensor = total / len(batch.map)
        return mean

    return loss


def train(
    method: str, option: float, rate: float, seed: int, *, seconds: float = 0, steps: int = 0
) -> tuple[CostPredictor, dict[str, Any]]:
    """Return a trained model, and what the training took.

    The training ends after ``seconds`` of CPU time, or after ``steps``. The learning rate rises for
    100 steps and falls as a cosine of the share that is done.
    """
    pl.seed_everything(seed, verbose=False)
    loader = training_batches(FAMILY, TRAINING_MAPS, seed)
    model = CostPredictor(
        MOVEMENT.connectivity,
        MOVEMENT.corner_cutting,
        MOVEMENT.diagonal_cost,
        parts=int(option) if method == "paths" else 0,
    )
    loss = loss_of(method, option, seed)
    batches = epochs(loader)
    loss(model, next(batches)).backward()  # compiles the kernels, which takes no time of the loss
    optimizer = torch.optim.Adam(model.parameters(), rate, betas=BETAS)
    began = time.process_time()
    step = 0
    while (done := (time.process_time() - began) / seconds if seconds else step / steps) < 1:
        for group in optimizer.param_groups:
            group["lr"] = rate * min(1, (step + 1) / 100) * (1 + math.cos(math.pi * done)) / 2
        optimizer.zero_grad()
        loss(model, next(batches)).backward()
        optimizer.step()
        step += 1
    spent = time.process_time() - began
    return model.eval(), {"seconds": round(spent, 1), "steps": step}


def epochs(loader: Any) -> Iterator[Sample]:
    """Return the batches of a loader, epoch after epoch."""
    while True:
        yield from loader


def trial_problems() -> ProblemSet:
    """Return the problems on which trials are scored."""
    return ProblemSet.sample(
        FAMILY.generator, TRIAL_SEED, TRIAL_MAPS, movement=MOVEMENT, problems=FAMILY.problems
    )


def measure(problems: ProblemSet, role: str, method: str, **arguments: Any) -> dict[str, Any]:
    """Return one row of the file: a training and its scores on ``problems``."""
    model, effort = train(method, **arguments)
    score = scores(problems, predicted_terrain(model, problems, textures=0))
    budget = {key: arguments.pop(key) for key in ("seconds", "steps") if key in arguments}
    (equal,) = budget
    row = {"role": role, "method": method, "equal": equal, **arguments, **effort, **score}
    return row | {"set": problems.content_hash}


def best_trial(rows: list[dict[str, Any]], method: str) -> dict[str, Any]:
    """Return the trial of a loss with the most optimal paths; of equal ones, the least regret."""
    trials = [row for row in rows if row["role"] == "trial" and row["method"] == method]
    return max(trials, key=lambda row: (row["opt"], -row["regret"]))


def interval(values: pd.Series[float], digits: int, unit: str = "") -> str:
    """Return the mean and the range of some numbers."""
    mean, low, high = values.mean(), values.min(), values.max()
    return f"{mean:,.{digits}f}{unit} ({low:,.{digits}f} to {high:,.{digits}f})"


SEES = {"paths": "paths", "SPO+": "paths and true costs", "Fenchel-Young": "paths"}
"""What each loss is given."""


def table(rows: list[dict[str, Any]]) -> str:
    """Return the rows as a Markdown table."""
    lines = [
        f"| loss | sees | chosen | {SECONDS:.0f} s: steps | optimal | regret "
        f"| {STEPS:,} steps: CPU s | optimal | regret |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for method, (name, _) in OPTIONS.items():
        best = best_trial(rows, method)
        cells = [method, SEES[method], f"{name} {best['option']:g}, rate {best['rate']:g}"]
        for equal, effort in (("seconds", "steps"), ("steps", "seconds")):
            tests = [row for row in rows if row["role"] == "test" and row["method"] == method]
            frame = pd.DataFrame([row for row in tests if row["equal"] == equal])
            cells.append(interval(frame[effort], 0))
            cells += [
                interval(100 * frame["opt"], 1, " %"),
                interval(100 * frame["regret"], 4, " %"),
            ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def write_page(rows: list[dict[str, Any]]) -> None:
    """Write the table of the rows into the page, between its two marks."""
    before, rest = PAGE.read_text().split(BEGIN)
    _, after = rest.split(END)
    write_output(PAGE, f"{before}{BEGIN}\n\n{table(rows)}\n\n{END}{after}".encode())


def main() -> None:
    """Measure the rows that the file lacks, and write the table into the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    file: Path = parser.parse_args().file
    torch.set_num_threads(1)
    rows: list[dict[str, Any]] = json.loads(file.read_text()) if file.exists() else []
    names = ("role", "method", "equal", "option", "rate", "seed")
    measured = {tuple(row[name] for name in names) for row in rows}

    def add(problems: ProblemSet, role: str, method: str, equal: str, **arguments: Any) -> None:
        """Measure a row that the file lacks, and write the file."""
        if (role, method, equal, *arguments.values()) in measured:
            return
        budget = {"seconds": SECONDS} if equal == "seconds" else {"steps": STEPS}
        rows.append(measure(problems, role, method, **arguments, **budget))
        write_output(file, f"{json.dumps(rows, indent=1)}\n".encode())
        print(json.dumps(rows[-1]), flush=True)

    # The losses take turns, so that a machine that is busy for a while slows down all of them.
    problems = trial_problems()
    for trial, rate, method in product(range(2), RATES, OPTIONS):
        option = OPTIONS[method][1][trial]
        add(problems, "trial", method, "seconds", option=option, rate=rate, seed=TRIAL_SEED)
    problems = problems_of(FAMILY)
    for equal, seed, method in product(("seconds", "steps"), SEEDS, OPTIONS):
        best = best_trial(rows, method)
        chosen = {"option": best["option"], "rate": best["rate"], "seed": seed}
        add(problems, "test", method, equal, **chosen)
    write_page(rows)


if __name__ == "__main__":
    main()
