"""Hugging Face ``datasets``: a folder of Parquet files and a dataset card, out only.

``datasets.load_dataset(folder)`` opens it, and ``huggingface-cli upload`` puts it on the Hub as it
is. Needs pyarrow: ``pip install pyarrow``. Source:
https://huggingface.co/docs/datasets/repository_structure.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from mapdata.describe.dataset_card import Section, card
from mapdata.describe.table import map_row
from mapdata.formats.registry import Format
from mapdata.search.api import SEARCHES
from mapdata.search.labels import Labels
from mapdata.shards.root import Root

if TYPE_CHECKING:
    import pyarrow as pa

_SPLITS = ("train", "validation", "test")
"""The Hub's names of the splits, in the order of their codes."""


def write(target: Path, root: Root, progress: bool) -> list[str]:
    """Write ``data/<split>-<shard>.parquet``, one file a shard and split, and ``README.md``.

    A row is a map: its picture, its grid as (H, W) lists of 0 free and 1 occupied, and the columns
    of the paper's CSV.

    Returns:
        Notes for the user.

    Raises:
        ValueError: pyarrow is not installed.
    """
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise ValueError("format huggingface needs pyarrow: pip install pyarrow") from None
    (target / "data").mkdir(parents=True)
    shard_count = len(root.shards)
    splits_with_maps = set()
    for number, labels in enumerate(root.labels(progress=progress)):
        for code, split in enumerate(_SPLITS):
            indices = np.flatnonzero(labels.maps.split == code).tolist()
            rows = [_row(labels, k, root.resolution) for k in indices]
            if rows:
                name = f"{split}-{number:05d}-of-{shard_count:05d}.parquet"
                table = pa.Table.from_pylist(rows, _schema(rows[0]))
                parquet.write_table(table, target / "data" / name, compression="zstd")
                splits_with_maps.add(split)
    # Splits without maps are not listed, since load_dataset refuses a pattern that matches no file.
    files = {split: f"data/{split}-*.parquet" for split in _SPLITS if split in splits_with_maps}
    text = card(root.locations, files=files, extra=[_COLUMNS])
    (target / "README.md").write_text(text, encoding="utf-8", newline="\n")
    return []


def _schema(names: Iterable[str]) -> pa.Schema:
    """Return the Arrow schema, with the features that ``datasets`` reads from its metadata."""
    import pyarrow as pa

    flags = pa.list_(pa.bool_())
    types = {
        "image": pa.struct([("bytes", pa.binary()), ("path", pa.string())]),
        "map": pa.list_(pa.list_(pa.uint8())),
        "item": pa.int64(),
        "label": pa.string(),
        "split": pa.string(),
        "resolution": pa.float64(),
        "rooms": pa.int32(),
        "passage_size": pa.int32(),
        "connected": flags,
        "reachable": flags,
        "all_connected": pa.bool_(),
    }
    for search in SEARCHES:
        types[f"{search}_iterations"] = pa.int64()
        types[f"{search}_connection_matrix"] = pa.list_(pa.list_(pa.float32()))
    # The columns without an entry above are lists of integers.
    columns = [(name, types.get(name, pa.list_(pa.int32()))) for name in names]
    # Tells the library datasets that the bytes in this column are a picture.
    features = {"image": {"_type": "Image"}}
    metadata = {"huggingface": json.dumps({"info": {"features": features}})}
    return pa.schema(columns, metadata=metadata)


def _row(labels: Labels, k: int, resolution: float) -> dict[str, object]:
    """Return the row of map ``k``, with its picture as the bytes of a PNG, free cells white."""
    grid = labels.maps.occupancy[k]
    row = map_row(labels, k, resolution)
    picture = BytesIO()
    Image.fromarray(grid == 0).save(picture, "PNG")  # bool gives 1 bit a pixel
    image = {"bytes": picture.getvalue(), "path": f"{row['label']}.png"}
    return {"image": image, "map": grid.tolist(), **row}


_COLUMNS = Section(
    "Columns",
    "A row is a map. Lists have a number a room (seed point), passage or segment between "
    "consecutive rooms.",
    (
        ("column", "meaning"),
        ("map, image", "(H, W) of 1 occupied and 0 free; the picture shows free white"),
        (
            "seed_rows, seed_columns, size_rows, size_columns",
            "seed point, rows and columns of each room, -1 unknown",
        ),
        (
            "direction_for_passages",
            "two a passage, its legs at either room: 1 horizontal, 0 vertical, -1 none",
        ),
        (
            "connected, reachable",
            "whether a passage was drawn to the next room; whether a path leads there",
        ),
        (
            "bfs_row_path, bfs_column_path and those of astar",
            "the cells of the route through all seed points",
        ),
        (
            "bfs_path_gaps, astar_path_gaps",
            "for each segment without a path, how many cells of the route precede it",
        ),
        (
            "bfs_iterations, astar_iterations",
            "cells expanded; segment_iterations has one number a segment",
        ),
        (
            "bfs_connection_matrix, astar_connection_matrix",
            "path costs between all rooms, -1 no path",
        ),
    ),
)

FORMAT = Format("huggingface", write=write)
