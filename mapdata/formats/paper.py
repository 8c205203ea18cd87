"""The paper's release: one PNG a map and one CSV with its columns, written and not read.

Source: Flores-Aquino et al., arXiv 2110.13242, sections 3 and 4: 10,000 maps as images plus one
CSV. Its repository, https://github.com/gbriel21/map2D_dataSet, says no more; a script of its
authors reads ``maps_parameters.csv`` and ``map0.png``, ``map1.png``, ... beside it. The header of
that file is not published, so only this program writes tables with these columns, and whoever has
one has the shards, too.

In the pictures, of 1 bit a pixel, free is black and occupied is white, as in the paper's Figure 2.
They lie in the folder ``images`` beside the CSV. Lists are written as JSON.

| column | a cell of it |
|---|---|
| item | number of the map, from 0 |
| label | name of the picture without its ending: ``map<item>`` |
| split | train, val or test (ours) |
| resolution | metres per cell |
| rooms | number of rooms (ours) |
| passage_size | width of the passages, in cells |
| seed_rows, seed_columns | one number per room |
| size_rows, size_columns | one number per room |
| direction_for_passages | two a passage, its legs: 1 horizontal, 0 vertical, -1 none |
| connected | one a passage: whether it was drawn |
| reachable | one a segment: whether it has a path (ours) |
| all_connected | whether paths join all rooms (ours) |
| bfs_row_path, bfs_column_path | the cells of the route in one line, joints once |
| astar_row_path, astar_column_path | the same for A* |
| bfs_path_gaps, astar_path_gaps | for each segment without a path, the cells before it (ours) |
| bfs_iterations, astar_iterations | those of the whole route |
| bfs_segment_iterations, astar_segment_iterations | one a segment (ours) |
| bfs_connection_matrix, astar_connection_matrix | n lists of n costs, -1 no connection |
| movement | how paths move, as JSON (ours) |

The columns connected to astar_connection_matrix are labels.
"""

from __future__ import annotations

import csv
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
from PIL import Image

from mapdata.describe.table import map_columns
from mapdata.formats.files import write_picture
from mapdata.formats.registry import Format
from mapdata.hashing import canonical_json
from mapdata.shards.root import Root


def write(target: Path, root: Root, progress: bool) -> list[str]:
    """Write ``maps.csv`` and ``images/map<i>.png``.

    Returns:
        Notes for the user.
    """
    (target / "images").mkdir(parents=True)
    with open(target / "maps.csv", "w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        for labels in root.labels(progress=progress):
            movement = canonical_json(asdict(labels.maps.movement))
            columns = map_columns(labels, np.arange(len(labels.maps)), root.resolution)
            if file.tell() == 0:
                table.writerow([*columns, "movement"])
            for name, grid in zip(columns["label"], labels.maps.occupancy, strict=True):
                image = Image.fromarray(grid.view(np.bool_))  # bool gives a PNG of 1 bit a pixel
                write_picture(target / "images" / f"{name}.png", image)
            for row in zip(*columns.values(), strict=True):
                cells = [cell if isinstance(cell, str) else json.dumps(cell) for cell in row]
                table.writerow([*cells, movement])
    return []


def is_release(path: Path) -> bool:
    """Return whether a CSV is the table of a release: ours, or the authors' beside ``map0.png``.

    Without this, the pictures beside it would be read as others are, and be inverted.
    """
    with open(path, encoding="utf-8-sig", errors="replace") as file:
        columns = file.readline(100_000).strip().split(",")
    return (path.parent / "map0.png").exists() or {"seed_rows", "size_rows"}.issubset(columns)


FORMAT = Format(
    "paper",
    (".csv",),
    write=write,
    recognises=is_release,
    companion_endings=(".png",),
    why_unread="is written and not read: --format images --images.invert reads its pictures, where "
    "white is occupied; a dataset that was exported so is read from its shards, or built again",
)
