"""The fit of a model of costs to drives.

The loss says how much more a part of a drive costs than the cheapest path between its ends, as a
ratio: it is the logarithm of the one minus that of the other. Drives need not be cheapest paths of
anything.

A driver who misjudges what cells cost takes detours, and costs that make his drives cheapest paths
would be too flat. So cheapest paths are planned with his mistakes: the cost of each cell is
multiplied by exp(noise * normal). The noise is not known. It is the one under which planned paths
turn as much as the drives do (`turns`). Then the costs are those under which drives and planned
paths cross each kind of cell equally often (perturb-and-MAP, Papandreou and Yuille, ICCV 2011).
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from mapdata.arrays import Float32s
from mapdata.costmaps.cost_models import Costs, Curve
from mapdata.costmaps.drives import Drive, random_parts
from mapdata.costmaps.sites import Paths, Site, Windows, windows_of

PARTS = 12
"""Number of parts of drives in a training step."""

RATE = 0.01
"""The learning rate of the first step. It falls to .02 of it along a cosine."""

PIECE = 8
"""Number of moves over which a path's turns are measured."""

FIRST_NOISE = 0.2
MAX_NOISE = 1.0
NOISE_RATE = 0.1
"""The noise changes by it times the difference of the turns of drives and planned paths, which is
some hundredths, in the first step. In the last one it is a tenth of it.
"""

MEMORY = 0.97
"""Turns are averaged over steps, with this decay."""

AVERAGED = 0.4
"""The noise that is returned is the mean of the last steps, this share of all."""


def learn(model: Costs, sites: list[Site], drives: list[Drive], steps: int, seed: int) -> float:
    """Fit a model to drives, and return the driver's noise; 0 for a network, which has none.

    A curve becomes the mean of the curves of the last steps.
    """
    rng = np.random.default_rng(seed)
    # The second moment forgets soon that the first gradients were large.
    optimizer = torch.optim.Adam(model.parameters(), lr=RATE, betas=(0.9, 0.98), eps=1e-4)
    is_curve = isinstance(model, Curve)
    noise = FIRST_NOISE if is_curve else 0.0
    noises: list[float] = []
    curves: list[Tensor] = []
    turned, straight = np.zeros(2), np.zeros(2)  # of drives and of planned paths
    for step in range(steps):
        progress = step / steps
        for group in optimizer.param_groups:
            group["lr"] = RATE * max(0.02, 0.5 + 0.5 * math.cos(math.pi * progress))
        windows = windows_of(sites, random_parts(drives, PARTS, rng))
        costs = window_costs(model, windows)
        if is_curve:
            costs = costs * np.exp(noise * rng.standard_normal(costs.shape, np.float32))
        planned = windows.planned(costs)
        driven_costs, planned_costs = (
            path_costs(model, windows, paths) for paths in (windows.driven, planned)
        )
        loss = (driven_costs.log() - planned_costs.log()).mean() + model.penalty()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        model.constrain()
        if not isinstance(model, Curve):
            continue
        of_paths = np.array([turns(paths) for paths in (windows.driven, planned)])
        turned, straight = MEMORY * turned + of_paths[:, 0], MEMORY * straight + of_paths[:, 1]
        if straight.all():
            of_drives, of_planned = turned / straight
            rate = NOISE_RATE * (1 - 0.9 * progress)
            noise = min(max(noise + rate * (of_drives - of_planned), 0.0), MAX_NOISE)
        if progress >= 1 - AVERAGED:
            noises.append(noise)
            curves.append(model.steps.detach().clone())
    if isinstance(model, Curve) and curves:
        with torch.no_grad():
            model.steps.copy_(torch.stack(curves).mean(dim=0))
        model.constrain()
    return float(np.mean(noises)) if noises else noise


def turns(paths: Paths) -> tuple[float, float]:
    """Return by how much all pieces of paths are longer than the straight way, and that way.

    A piece has `PIECE` moves. The straight way between its ends is the shortest one of an empty
    map. A straight line of any direction that is drawn in cells has the same length, although its
    moves change their direction all the time, so a smooth drive counts as straight.
    """
    cells = paths.cells
    is_piece = cells[PIECE:, 0] == cells[:-PIECE, 0]
    diagonal_extra = math.sqrt(2) - 1
    apart = np.abs(np.diff(cells[:, 1:], axis=0))
    travelled = np.insert(np.cumsum(apart.max(axis=1) + diagonal_extra * apart.min(axis=1)), 0, 0)
    between = np.abs(cells[PIECE:, 1:] - cells[:-PIECE, 1:])[is_piece]
    straight = float((between.max(axis=1) + diagonal_extra * between.min(axis=1)).sum())
    return float((travelled[PIECE:] - travelled[:-PIECE])[is_piece].sum()) - straight, straight


@torch.no_grad()
def window_costs(model: Costs, windows: Windows) -> Float32s:
    """Return the cost of each cell, (B, h, w)."""
    costs: Float32s = model(torch.from_numpy(windows.planes).movedim(1, -1)).exp().numpy()
    return costs


def path_costs(model: Costs, windows: Windows, paths: Paths) -> Tensor:
    """Return the cost of the path in each window, (B,)."""
    numbers, rows, columns = paths.cells.T
    planes = torch.from_numpy(windows.planes[numbers, :, rows, columns])
    weighted = torch.from_numpy(paths.weights) * model(planes).exp()
    return torch.zeros(len(windows.grids)).index_add(0, torch.from_numpy(numbers), weighted)
