"""Neural A*: batches as its train.py has them.

For Planner take NeuralAstar() of neural_astar.planner, and .histories of what it returns.
Its moves: 8 neighbours, any diagonal, each at cost 1.
Source: https://github.com/omron-sinicx/neural-astar.
"""

import torch
from torch.utils.data import DataLoader

from mapdata import MapDataset, Movement, Random


class Planner(torch.nn.Conv2d):
    def forward(self, *inputs: torch.Tensor) -> torch.Tensor:
        return super().forward(torch.cat(inputs, dim=1)).sigmoid()


planner = Planner(3, 1, 5, padding=2)
fields = ("free", "start_mask", "goal_mask", "path_mask")
problems = Random(distance=(10, None))
movement = Movement(8, corner_cutting=True, diagonal_cost=1)
dataset = MapDataset("data/maps", "train", fields, problems=problems, movement=movement)
optimizer = torch.optim.RMSprop(planner.parameters(), lr=0.001)
for batch in DataLoader(dataset, 100, shuffle=True):
    map_designs, start_maps, goal_maps, opt_trajs = (field.float() for field in batch)
    loss = torch.nn.functional.l1_loss(planner(map_designs, start_maps, goal_maps), opt_trajs)
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    print(f"loss {loss.item():.3f}")
