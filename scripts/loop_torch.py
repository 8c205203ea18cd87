"""Plain torch: any DataLoader gives padded batches. python scripts/build_shards.py comes first."""

import torch
from torch.utils.data import DataLoader

from mapdata import MapDataset

dataset = MapDataset("data/maps", "train", ("map", "goal_mask", "heuristic_ratio"))
layers = torch.nn.Conv2d(2, 16, 5, padding=2), torch.nn.ReLU(), torch.nn.Conv2d(16, 1, 1)
model = torch.nn.Sequential(*layers)
optimizer = torch.optim.Adam(model.parameters())
for epoch in range(2):
    for map, goal, ratio in DataLoader(dataset, 64, shuffle=True):
        predicted = model(torch.cat((map, goal), dim=1).float())
        loss = torch.nn.functional.mse_loss(predicted, ratio)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    print(f"epoch {epoch}: loss {loss.item():.3f}")
