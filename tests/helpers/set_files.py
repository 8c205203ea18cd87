"""Files of problem sets, written with NumPy as docs/problems.md describes them (Saved sets)."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np

from mapdata import ProblemSet
from mapdata.arrays import Array


def write_arrays(path: Path, arrays: Mapping[str, Array], *, compress: bool = False) -> None:
    """Write a file of format 2 that holds these arrays and a hash that fits."""
    archive = io.BytesIO()
    save = np.savez_compressed if compress else np.savez
    save(archive, **arrays)  # type: ignore[arg-type]  # NumPy's option allow_pickle is bool
    comment_size = len(b"mapdata sha256 ") + 64
    # The last two bytes of an archive without a comment hold the length of the comment.
    content = archive.getvalue()[:-2] + comment_size.to_bytes(2, "little")
    digest = hashlib.sha256(content).hexdigest()
    path.write_bytes(content + b"mapdata sha256 " + digest.encode())


def read_arrays(path: Path) -> dict[str, Array]:
    """Return the arrays of a file."""
    with np.load(path) as file:
        return dict(file)


def write_first_format(path: Path, problems: ProblemSet) -> None:
    """Write a file of format 1, as mapdata 0.2 did: a map for each problem, and no hash."""
    about = {"movement": asdict(problems.movement), "description": problems.description}
    maps = {"grids": problems.grids} if problems.terrain is None else {"terrain": problems.terrain}
    np.savez_compressed(
        path,
        about=np.array(json.dumps(about)),
        starts=problems.starts,
        goals=problems.goals,
        **maps,  # type: ignore[arg-type]
    )
