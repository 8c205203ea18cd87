"""Plain torch: a network learns the next move of paths. Before: python scripts/build_shards.py."""

import torch
from torch.nn import Conv2d, ReLU
from torch.utils.data import DataLoader

from mapdata import MapDataset

loader = DataLoader(MapDataset("data/maps", "train"), batch_size=64, shuffle=True)
near, far = Conv2d(3, 16, 3, padding=1), Conv2d(16, 16, 3, padding=4, dilation=4)
network = torch.nn.Sequential(near, ReLU(), far, ReLU(), Conv2d(16, 4, 1))
optimizer = torch.optim.Adam(network.parameters(), lr=0.01)
for epoch in range(2):
    for map, start, goal, path in loader:  # noqa: B007  (B, 1, H, W), (B, 2), (B, 2), (B, T, 2)
        down = torch.arange(map.shape[2])[:, None] - goal[:, :1, None, None]  # (B, 1, H, 1)
        right = torch.arange(map.shape[3]) - goal[:, 1:, None, None]  # (B, 1, 1, W)
        seen = [map, (down / 8).tanh().expand(map.shape), (right / 8).tanh().expand(map.shape)]
        scores = network(torch.cat(seen, dim=1))  # (B, 4, H, W): north, east, south, west
        problem, k = (path[:, 1:, 0] >= 0).nonzero(as_tuple=True)  # N steps; padding is -1
        row, column = path[problem, k].T  # the cell before each step
        step_down, step_right = (path[problem, k + 1] - path[problem, k]).T
        move = torch.where(step_down != 0, 1 + step_down, 2 - step_right)  # (N,) 0 is north
        loss = torch.nn.functional.cross_entropy(scores[problem, :, row, column], move)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    share = (scores[problem, :, row, column].argmax(dim=1) == move).float().mean()
    print(f"epoch {epoch}: {share:.0%} of the moves are those of the path")
