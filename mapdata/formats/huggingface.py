"""Hugging Face ``datasets``: a folder of Parquet files and a card, out only.

``datasets.load_dataset(folder)`` opens it, and ``huggingface-cli upload`` puts it on the Hub as it is. Needs pyarrow:
``pip install mapdata[hub]``. Source: https://huggingface.co/docs/datasets/repository_structure.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from mapdata.formats.registry import Format
from mapdata.formats.stored import Stored
from mapdata.search.labels import Labels
from mapdata.shards.table import SEARCHES, map_row
from mapdata.spec import SPLITS, canonical_json

if TYPE_CHECKING:
    import pyarrow as pa

_NAMES = {"train": "train", "val": "validation", "test": "test"}
"""The Hub's names of the splits."""


def write(target: Path, source: Stored) -> list[str]:
    """Write ``data/<split>-<shard>.parquet``, one file a shard and split, and ``README.md``.

    A row is a map: picture, grid as (H, W) lists of 0 free and 1 occupied, and the columns of the paper's CSV.

    Returns:
        Notes for the user.

    Raises:
        ValueError: pyarrow is not installed.
    """
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise ValueError("format huggingface needs pyarrow: pip install 'mapdata[hub]'") from None
    (target / "data").mkdir(parents=True)
    schema = _schema()
    shards = len(source.manifest.shards)
    counts = dict.fromkeys(SPLITS, 0)
    for number, labels in enumerate(source.batches()):
        for code, split in enumerate(SPLITS):
            indices = np.flatnonzero(labels.maps.split == code).tolist()
            rows = [_row(labels, k, source.manifest.resolution) for k in indices]
            if rows:
                name = f"{_NAMES[split]}-{number:05d}-of-{shards:05d}.parquet"
                parquet.write_table(pa.Table.from_pylist(rows, schema), target / "data" / name, compression="zstd")
                counts[split] += len(rows)
    (target / "README.md").write_text(_card(source, counts), encoding="utf-8", newline="\n")
    return []


def _schema() -> pa.Schema:
    """Return the Arrow schema, with the features that ``datasets`` reads from its metadata."""
    import pyarrow as pa

    integers = pa.list_(pa.int32())
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
        "seed_rows": integers,
        "seed_columns": integers,
        "size_rows": integers,
        "size_columns": integers,
        "direction_for_passages": integers,
        "connected": flags,
        "reachable": flags,
        "all_connected": pa.bool_(),
    }
    for search in SEARCHES:
        types[f"{search}_row_path"] = integers
        types[f"{search}_column_path"] = integers
        types[f"{search}_iterations"] = integers
        types[f"{search}_connection_matrix"] = pa.list_(pa.list_(pa.float32()))
    features = {name: _feature(kind) for name, kind in types.items()}
    features["image"] = {"_type": "Image"}
    metadata = {"huggingface": json.dumps({"info": {"features": features}})}
    return pa.schema(list(types.items()), metadata=metadata)


def _feature(kind: pa.DataType) -> dict[str, object]:
    """Return what ``datasets`` writes for an Arrow type."""
    if hasattr(kind, "value_type"):
        return {"feature": _feature(kind.value_type), "_type": "List"}
    return {"dtype": str(kind), "_type": "Value"}


def _row(labels: Labels, k: int, resolution: float) -> dict[str, object]:
    grid = labels.maps.occupancy[k]
    row = map_row(labels, k, resolution)
    picture = BytesIO()
    Image.fromarray(255 * (1 - grid)).convert("1").save(picture, "PNG")
    return {"image": {"bytes": picture.getvalue(), "path": f"{row['label']}.png"}, "map": grid.tolist(), **row}


def _card(source: Stored, counts: dict[str, int]) -> str:
    """Return the card: front matter that says where each split lies, and what a cell of the table means."""
    manifest, (rows, columns) = source.manifest, source.manifest.map_size
    total = sum(counts.values())
    category = next((name for bound, name in _SIZES if total < bound), "1M<n<10M")
    files = "".join(
        f"  - split: {_NAMES[split]}\n    path: data/{_NAMES[split]}-*.parquet\n" for split in SPLITS if counts[split]
    )
    origin = f"identity `{manifest.identity}`, seed {manifest.seed}" if manifest.identity else "imported maps"
    return f"""---
pretty_name: mapdata {rows} x {columns}
task_categories:
- robotics
size_categories:
- {category}
tags:
- path planning
- occupancy grid
configs:
- config_name: default
  data_files:
{files}---

# {total:,} grid maps of {rows} x {columns} cells with shortest paths

Written by mapdata: {origin}, content hash `{manifest.content_hash}`.
Splits: {", ".join(f"{_NAMES[split]} {count:,}" for split, count in counts.items())}.

- `map`: 1 occupied, 0 free; `image` shows free white. Cells are (row, col), origin upper left;
  {manifest.resolution} metres a cell.
- `seed_rows`, `seed_columns`, `size_rows`, `size_columns`: seed point, and rows and columns, of each room (-1 unknown).
  `direction_for_passages`: the two legs of each passage, 1 horizontal, 0 vertical, -1 none; `connected`: it was drawn;
  `reachable`: a path to the next room exists.
- `row_path`, `column_path` of `bfs` and `astar`: the cells of the route through all seed points, where one exists;
  `iterations`: cells expanded on the way to each next room; `connection_matrix`: cost between rooms, -1 no path.
- Movement: `{canonical_json(asdict(manifest.movement))}`.

Source of the distribution: Flores-Aquino et al., "2D Grid Map Generation for Deep-Learning-based Navigation
Approaches", arXiv 2110.13242.
"""


_SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))

FORMAT = Format("huggingface", write=write)
