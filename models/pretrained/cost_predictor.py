"""A CNN that reads the costs of terrain from images, taught by shortest paths alone.

The input is a picture of a map on which one sees what the ground is like, but not what it costs.
The only teachers are shortest paths: nobody says what any cell costs. After training, A* on the
predicted costs finds nearly shortest paths on new pictures:

    import pytorch_lightning as pl
    from mapdata import MapDataModule, Tiles
    from mapdata.models import CostPredictor
    from mapdata.models.pretrained.cost_predictor import TRAINING_FIELDS

    data = MapDataModule(
        "data/tiles", build="tiles", fields=(*TRAINING_FIELDS, Tiles(alike=True)), batch_size=32
    )
    model = CostPredictor()
    pl.Trainer(max_epochs=10).fit(model, data)

How it learns. The network gives each cell a cost, and an exact search finds the shortest path under
these costs. The path that it finds costs at most as much as the path of the teacher. The loss is
the difference: it is 0 when the teacher's path is a shortest one. Its gradient lowers the costs on
the teacher's path and raises those on the path that was found instead. This is the structured
perceptron of Collins (EMNLP 2002, https://aclanthology.org/W02-1001), maximum margin planning
without a margin (Ratliff, Bagnell, Zinkevich, ICML 2006), and the limit of the black-box gradient
of Vlastelica et al. (ICLR 2020, arXiv 1912.02175) for a large step.

Each part of a shortest path is a shortest path, too. So a batch also asks for random parts of the
teacher's paths, which say more exactly where the costs are wrong.

Pictures are darker at dusk, and brighter on one side of a lamp. So a tile is brought to the mean 0
and the deviation 1 before the network sees it: neither light nor contrast changes that. What the
colour of a tile says is how it differs from the mean colour of the picture, which a second, small
network reads.

Paths tell no scale: if all costs are doubled, the shortest paths stay. So the predicted costs of
each map have the geometric mean 1, and a planner stretches them to the range 1 to 255 of terrain.

Instead of a picture, the network can read any stack of planes per cell, such as the clearance of
the cell or the class of its ground: ``CostPredictor(planes=2)`` takes two numbers of each cell, on
maps of any size. `mapdata.costmaps` learns the costs of a robot's map from its drives.

The class can also be taught in two other ways, to compare with: by the true costs, and by the loss
of Neural A* (neural_astar.py), which wants the search to expand few cells, and so does not pin down
costs. docs/costs.md has the table.

The pretrained weights were trained by

    OMP_NUM_THREADS=1 python -m mapdata.models.train cost_predictor fit --weights FILE

for 20,000 steps on 10,000 maps of ``tiles`` with ``Tiles(alike=True, noise=8, jitter=True)``.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import ClassVar, Literal

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from numpy.typing import ArrayLike
from torch import Tensor, nn

from mapdata import Movement, Sample, search_batch, terrain_from_costs
from mapdata.arrays import Bytes, Float32s, Ints, offsets_of
from mapdata.checks import check_choice, check_count

from ..neural_astar import search as neural_search
from .model import Model, Tensors

TRAINING_FIELDS = ("map", "start", "goal", "path", "terrain")
"""The fields of a batch beside ``image``. Training by paths does not look at ``terrain``, from
which validation computes the regret.
"""

MIN_COST = 0.01
"""Smallest predicted cost, where the geometric mean of a map is about 1."""

MAX_LOG_COST = 10.0
"""Largest absolute logarithm of a predicted cost. Its exponential is a factor of 22,000, far more
than terrain can hold, and far from numbers that overflow.
"""

MIN_PIXELS = 7
"""Smallest number of pixels of a cell: the first layer makes 3 x 3 places of them, the second 1."""

BETAS = (0.9, 0.99)
"""The decay rates of Adam's moments.

Adam divides its steps by the root of the mean square of recent gradients. The first 25 steps have
large gradients, which make all predicted costs nearly equal. With the usual rate of .999 Adam
remembers them for a thousand steps, and learns little in this time.
"""

LOSSES = ("paths", "terrain", "expansions")
"""What a `CostPredictor` can be taught by."""


class CostPredictor(Model):
    """Predicts the cost of each cell from an image of the map.

    A batch has the fields ``image`` and `TRAINING_FIELDS`, with the movement of the model.

    Args:
        connectivity: number of moves, 4 or 8.
        corner_cutting: whether diagonal moves may pass beside occupied cells.
        diagonal_cost: cost of a diagonal move, sqrt(2) or 1; the defaults are those of ``tiles``.
        pixels: pixels of a cell in each direction, at least `MIN_PIXELS`.
        width: channels of the first layer.
        parts: number of random parts of each path that a training step asks for beside the whole,
            at least 0.
        loss: "paths" as above; "terrain" for the squared error of the logarithm of the true costs;
            "expansions" for the loss of Neural A*.
        learning_rate: the highest of the schedule.
        planes: None for pictures; or how many planes, (B, planes, H, W), the field ``image`` has in
            place of a picture. Each cell's cost depends on its own numbers alone, and ``pixels``
            means nothing. The numbers should be of the order of 1.
    """

    PRETRAINED: ClassVar[Mapping[str, str]] = {"tiles": "cost_predictor.safetensors"}

    optimizer_class = staticmethod(partial(torch.optim.Adam, betas=BETAS))

    def __init__(
        self,
        connectivity: int = 8,
        corner_cutting: bool = True,
        diagonal_cost: float = 1.0,
        pixels: int = 8,
        width: int = 16,
        parts: int = 8,
        loss: Literal["paths", "terrain", "expansions"] = "paths",
        learning_rate: float = 0.01,
        planes: int | None = None,
    ) -> None:
        """Make the network."""
        super().__init__()
        check_choice("loss", loss, LOSSES)
        # Of fewer pixels the convolutions would leave no place.
        check_count("pixels", pixels, minimum=MIN_PIXELS)
        check_count("width", width)
        check_count("parts", parts, minimum=0)
        self.save_hyperparameters()
        self._check_learning_rate()
        self.movement = Movement(connectivity, corner_cutting, diagonal_cost)
        self.pixels = pixels
        self.planes = planes
        if planes is not None:
            check_count("planes", planes)
            self.network = network_of_planes(planes, width)
            return
        # The network sees the pixels of one cell, and not those of its neighbours. What a cell
        # costs depends on nothing else, and a network that saw more would need many more maps to
        # find that out.
        self.network = nn.Sequential(
            nn.Conv2d(3, width, 3, stride=2),
            nn.ReLU(),
            nn.Conv2d(width, 2 * width, 3),
            nn.ReLU(),
            nn.Conv2d(2 * width, 2 * width, 1),
            nn.ReLU(),
            nn.Conv2d(2 * width, 1, 1),
        )
        # Light changes the colour of a cell, and hardly its difference from the picture's mean.
        self.colour_network = nn.Sequential(nn.Linear(3, width), nn.ReLU(), nn.Linear(width, 1))

    def log_costs(self, image: Tensor) -> Tensor:
        """Return the logarithm of each cell's cost up to a constant, (B, H, W).

        Args:
            image: (B, 3, pixels * H, pixels * W), 0 to 255; or (B, planes, H, W).
        """
        if self.planes is not None:
            of_planes: Tensor = self.network(image.float())[:, 0].float()
            return of_planes
        batch, channels, height, width = image.shape
        k = self.pixels
        rows, columns = height // k, width // k
        tiles = image.reshape(batch, channels, rows, k, columns, k).permute(0, 2, 4, 1, 3, 5)
        tiles = tiles.reshape(-1, channels, k * k).to(torch.float32, copy=True)
        colours = tiles.mean(dim=2)  # (B * H * W, 3)
        tiles -= colours[:, :, None]
        deviations = tiles.square().mean(dim=(1, 2)).sqrt()  # (B * H * W,)
        tiles /= (deviations + 1)[:, None, None]  # a tile of a single colour has the deviation 0
        patterns = tiles.reshape(-1, channels, k, k)
        output = self.network(patterns).float()  # (B * H * W, 1, places, places)
        # The colours of a picture differ less from their mean where its contrast is low.
        contrasts = deviations.reshape(batch, -1).mean(dim=1) + 1  # (B,)
        colours = colours.reshape(batch, rows * columns, channels)
        colours = (colours - colours.mean(dim=1, keepdim=True)) / contrasts[:, None, None]
        log_costs: Tensor = output.mean(dim=(1, 2, 3)) + self.colour_network(colours).flatten()
        return log_costs.float().reshape(batch, rows, columns)

    def forward(self, image: Tensor, occupied: Tensor) -> Tensor:
        """Return the cost of each cell, (B, H, W), whose geometric mean over free cells is about 1.

        Args:
            image: (B, 3, pixels * H, pixels * W), 0 to 255; or (B, planes, H, W).
            occupied: (B, 1, H, W), 0 free and anything else occupied.
        """
        log_costs = centred(self.log_costs(image), occupied).clamp(-MAX_LOG_COST, MAX_LOG_COST)
        return log_costs.exp() + MIN_COST

    # --- training -------------------------------------------------------------------------------

    def losses(self, batch: Sample) -> Tensors:
        """Return ``loss``, that of the parameter ``loss``."""
        match self.hparams["loss"]:
            case "terrain":
                loss = self.terrain_loss(batch)
            case "expansions":
                loss = self.expansions_loss(batch)
            case _:
                loss = self.path_loss(batch)
        return {"loss": loss}

    def path_loss(self, batch: Sample) -> Tensor:
        """Return how much more the paths of the batch cost than the shortest ones, in the mean.

        Both are taken under the predicted costs. Whole paths and `random_parts` of them count
        equally. The loss of a batch without any path is 0.
        """
        costs: Tensor = self(batch.image, batch.map)  # (B, H, W)
        grids = batch.map[:, 0].byte().cpu().numpy()
        terrain = terrain_from_costs(costs.detach().cpu().numpy(), grids)
        maps, paths = random_parts(batch.path.cpu().numpy(), int(self.hparams["parts"]))
        if not paths:
            return costs.sum() * 0
        lengths = [len(path) for path in paths]
        teacher_weights = path_weights(
            np.concatenate(paths), offsets_of(lengths), grids, self.movement, maps
        )
        shortest = search_batch(
            "astar",
            grids[maps],
            np.array([path[0] for path in paths]),
            np.array([path[-1] for path in paths]),
            self.movement,
            terrain=terrain[maps],
        )
        shortest_weights = path_weights(
            shortest.cells, shortest.offsets, grids, self.movement, maps
        )
        # A path costs the sum of weight times cost. The gradient of the loss for the costs is this
        # difference of weights: no gradient passes through the search.
        (weight_difference,) = self.tensors(teacher_weights - shortest_weights)  # (B, H, W)
        loss: Tensor = (costs * weight_difference).sum() / len(paths)
        return loss

    def terrain_loss(self, batch: Sample) -> Tensor:
        """Return the mean squared error of the logarithm of the costs, up to a constant a map.

        It is 0 without any free cell.
        """
        is_free = batch.map == 0  # (B, 1, H, W)
        truth = batch.terrain.float().clamp(min=1).log()[:, 0]  # (B, H, W)
        error = centred(self.log_costs(batch.image), batch.map) - centred(truth, batch.map)
        loss: Tensor = (error**2)[is_free[:, 0]].sum() / is_free.sum().clamp(min=1)
        return loss

    def expansions_loss(self, batch: Sample) -> Tensor:
        """Return the loss of Neural A*: cells that differ between the expanded ones and a path.

        Problems without a path do not count. The loss of a batch without any path is 0.
        """
        guidance: Tensor = torch.sigmoid(self.log_costs(batch.image))  # (B, H, W)
        has_path: Tensor = batch.path[:, 0, 0] >= 0  # (B,)
        if not has_path.any():
            return guidance.sum() * 0
        guidance = guidance[has_path]
        problems = (batch.map[has_path], batch.start[has_path], batch.goal[has_path])
        max_expansions = guidance[0].numel()
        expanded, _ = neural_search(guidance, *problems, self.movement, max_expansions)
        path_mask = torch.zeros_like(guidance)  # (B, H, W)
        paths = batch.path[has_path]
        problem, step = (paths[:, :, 0] >= 0).nonzero(as_tuple=True)
        path_mask[(problem, *paths[problem, step].unbind(1))] = 1
        return F.l1_loss(expanded, path_mask)

    def validation_step(self, batch: Sample, batch_idx: int, dataloader_idx: int = 0) -> None:
        """Log ``val_regret`` and ``val_opt``, the share of shortest paths, of the planned paths."""
        grids = batch.map[:, 0].byte().cpu().numpy()
        truth = batch.terrain[:, 0].byte().cpu().numpy()
        starts = batch.start.cpu().numpy()
        goals = batch.goal.cpu().numpy()
        problems = (grids, starts, goals, self.movement)
        terrain = self.predict(batch.image.cpu().numpy(), grids)
        planned = search_batch("astar", *problems, terrain=terrain)
        optimal = search_batch("astar", *problems, terrain=truth)
        is_solved = optimal.cost > 0
        if not is_solved.any():
            return  # a mean over nothing would make the logged mean of all batches NaN
        maps = np.arange(len(grids))
        weights = path_weights(planned.cells, planned.offsets, grids, self.movement, maps)
        costs = (weights.astype(np.float64) * truth).sum(axis=(1, 2))
        regrets = costs[is_solved] / optimal.cost[is_solved] - 1
        scores = {"val_regret": regrets.mean(), "val_opt": (regrets < 1e-6).mean()}
        self.log_dict(scores, batch_size=int(is_solved.sum()), prog_bar=True)

    # --- prediction -----------------------------------------------------------------------------

    def predict(self, images: ArrayLike | Tensor, grids: ArrayLike) -> Bytes:
        """Return the predicted terrain, (B, H, W) uint8: 1 to 255, and 0 on occupied cells.

        `mapdata.search_batch` and `mapdata.astar` search on it with ``terrain=``.

        Args:
            images: (B, 3, pixels * H, pixels * W) numbers from 0 to 255, usually uint8; or (B,
                planes, H, W) finite numbers.
            grids: (B, H, W), 0 free and 1 occupied.

        Raises:
            ValueError: an image that is not of its grid's size, or has other numbers, such as NaN;
                weights that predict costs that are not finite.
        """
        # numpy would warn of a tensor that it is asked to copy.
        pixels = images.cpu().numpy() if isinstance(images, Tensor) else images
        image, occupied = self.tensors(pixels, np.not_equal(grids, 0)[:, None])
        rows, columns = occupied.shape[2:]
        expected = (len(occupied), 3, self.pixels * rows, self.pixels * columns)
        if self.planes is not None:
            expected = (len(occupied), self.planes, rows, columns)
        if image.shape != expected:
            raise ValueError(f"images: got shape {tuple(image.shape)}, expected {expected}")
        if image.is_complex():
            raise ValueError(f"images: got {image.dtype}, expected numbers from 0 to 255")
        numbers = "numbers from 0 to 255" if self.planes is None else "finite numbers"
        is_legal = (image >= 0) & (image <= 255) if self.planes is None else image.isfinite()
        if not is_legal.all():  # NaN is not legal
            number = image[~is_legal][0].item()
            raise ValueError(f"images: got the value {number}, expected {numbers}")
        # In 32 bits: costs of bfloat16, which has 8 bits, would be too coarse.
        with torch.inference_mode():
            costs = self(image, occupied)
        return terrain_from_costs(costs.cpu().numpy(), occupied[:, 0].byte().cpu().numpy())


def network_of_planes(planes: int, width: int) -> nn.Sequential:
    """Return a network from planes (B, planes, H, W) of the order of 1 to costs (B, 1, H, W).

    It looks at each cell alone. The bends of its first layer are spread over the range of the
    planes, so that it can follow a curve from the first step on.
    """
    first = nn.Conv2d(planes, width, 1)
    nn.init.normal_(first.weight, std=2.0)
    assert first.bias is not None
    nn.init.uniform_(first.bias, -2.0, 2.0)
    return nn.Sequential(
        first,
        nn.ReLU(),
        nn.Conv2d(width, width, 1),
        nn.ReLU(),
        nn.Conv2d(width, 1, 1),
    )


def centred(log_costs: Tensor, occupied: Tensor) -> Tensor:
    """Return (B, H, W) numbers less their mean over the free cells of each map."""
    free = (occupied[:, 0] == 0).float()  # (B, H, W)
    cell_counts = free.sum(dim=(1, 2), keepdim=True).clamp(min=1)  # (B, 1, 1)
    mean = (log_costs * free).sum(dim=(1, 2), keepdim=True) / cell_counts
    return log_costs - mean


def random_parts(paths: Ints, count: int) -> tuple[Ints, list[Ints]]:
    """Return the paths of a batch, and ``count`` random parts of each, with at least 3 cells.

    Args:
        paths: (B, T, 2), padded with -1. Paths of fewer than 2 cells are left out.
        count: number of parts of a path. There are none of a path of fewer than 4 cells.

    Returns:
        The number of each part's path, (P,), and its cells, (k, 2) each.
    """
    lengths = (paths[:, :, 0] >= 0).sum(axis=1)
    numbers = []
    parts = []
    for number, length in enumerate(lengths.tolist()):
        if length < 2:
            continue
        bounds = [(0, length)]
        if length >= 4:
            first = torch.randint(0, length - 2, (count,)).tolist()
            bounds += [(k, int(torch.randint(k + 3, length + 1, ()))) for k in first]
        for begin, end in bounds:
            numbers.append(number)
            parts.append(paths[number, begin:end])
    return np.array(numbers, np.int64), parts


def path_weights(
    cells: Ints, offsets: Ints, grids: Bytes, movement: Movement, maps: Ints
) -> Float32s:
    """Return how often the cost of each cell counts in the paths on each map, (B, H, W) float32.

    A move costs the mean of its two cells times its length. So the costs of all paths on map b add
    up to the sum over its cells of weight times cost.

    Args:
        cells: (M, 2), the cells of P paths, one path after another.
        offsets: (P + 1,), where each path begins, and where the last one ends.
        grids: (B, H, W), the maps.
        movement: movement of the paths.
        maps: (P,), the number of each path's map.
    """
    weights = np.zeros(grids.shape, np.float32)
    path_of_cell = np.repeat(np.arange(len(maps)), np.diff(offsets))
    is_move = path_of_cell[1:] == path_of_cell[:-1]  # from cell k to cell k + 1
    is_diagonal = np.abs(np.diff(cells, axis=0)).sum(axis=1) == 2
    half_lengths = np.where(is_diagonal, movement.diagonal_cost, 1.0)[is_move] / 2
    map_of_cell = maps[path_of_cell]
    for ends in (np.flatnonzero(is_move), np.flatnonzero(is_move) + 1):
        index = (map_of_cell[ends], cells[ends, 0], cells[ends, 1])
        np.add.at(weights, index, half_lengths.astype(np.float32))
    return weights
