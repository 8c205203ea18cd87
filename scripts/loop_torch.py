"""Plain torch: a network learns the next move of paths. Before: python scripts/build_shards.py."""

import torch
from torch.nn import Conv2d, ReLU
from torch.utils.data import DataLoader

from mapdata import MapDataset

loader = DataLoader(MapDataset("data/maps", "train"), batch_size=64, shuffle=True)
wide = Conv2d(16, 16, 3, padding=4, dilation=4)
network = torch.nn.Sequential(Conv2d(3, 16, 3, padding=1), ReLU(), wide, ReLU(), Conv2d(16, 4, 1))
optimizer = torch.optim.Adam(network.parameters(), lr=0.01)
for epoch in range(2):
    for map, start, goal, path in loader:  # noqa: B007  (B, 1, H, W), (B, 2), (B, 2), (B, T, 2)
        cells = torch.cartesian_prod(torch.arange(map.shape[2]), torch.arange(map.shape[3]))
        to_goal = (cells - goal[:, None]).mT.unflatten(2, map.shape[2:])  # (B, 2, H, W)
        scores = network(torch.cat([map, (to_goal / 8).tanh()], dim=1))  # (B, 4, H, W)
        k, t = (path[:, 1:, 0] >= 0).nonzero(as_tuple=True)  # N moves; paths are padded with -1
        row, column = path[k, t].T
        down, right = (path[k, t + 1] - path[k, t]).T
        move = torch.where(down != 0, 1 + down, 2 - right)  # 0 north, 1 east, 2 south, 3 west
        predicted = scores[k, :, row, column]  # (N, 4)
        loss = torch.nn.functional.cross_entropy(predicted, move)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    share = (predicted.argmax(dim=1) == move).float().mean()
    print(f"epoch {epoch}: {share:.0%} of the moves are those of the path")
