"""Measure the lines of docs/howto/waypoints.md: python docs/waypoint_tables.py.

The first table counts how many lines collide where points are spread over a path in three ways. The
second one has four ways to a line between start and goal. One of them is an elastic band, which
takes the obstacles into account but does not search: Quinlan and Khatib, "Elastic bands: connecting
path planning and control", 1993, https://doi.org/10.1109/ROBOT.1993.291936. Its two constants were
chosen on the maps of `BAND_SEED`.

The figures are written to docs/waypoint_results.json, and the tables into the page. That takes one
core about a minute. Needs scipy.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt

from mapdata import (
    Forest,
    MapGenerator,
    Movement,
    OnlineMapDataset,
    Random,
    Sample,
    Waypoints,
    generators,
    lines_are_free,
    pull_taut,
)
from mapdata.arrays import Bytes, Flags, Floats
from mapdata.models import PathPredictor
from mapdata.models.pretrained.model import WEIGHTS
from mapdata.shards import write_output

PAGE = Path(__file__).parent / "howto" / "waypoints.md"
RESULTS = Path(__file__).parent / "waypoint_results.json"
FAMILIES, PLANNERS = "families", "planners"
"""The names of the tables, in the file and in the marks around them on the page."""

POINTS = 32
"""Points of a line."""

PRESETS = ("paper", "narrow", "dungeon", "dungeon128", "cave", "forest", "noise", "maze")
SMALL_FOREST = Forest((32, 32))
TEST_SEED, BAND_SEED = 2, 3

Row = dict[str, Any]


def problems_of(generator: MapGenerator, seed: int, count: int, distance: int) -> Sample:
    """Return random problems of at least ``distance`` cells, with their paths and waypoints.

    Waypoints are -1 where a line has more bends than fit.
    """
    return OnlineMapDataset(
        generator,
        seed=seed,
        length=count,
        fields=("map", "start", "goal", "path", Waypoints(POINTS, fill=True)),
        problems=Random(distance=(distance, None)),
        movement=Movement(8),
    )[:]


def length_of(line: Floats) -> float:
    """Return the length of a line (n, 2), in cells."""
    return float(np.hypot(*np.diff(line, axis=0).T).sum())


def resampled(line: Floats) -> Floats:
    """Return `POINTS` points that divide a line (n, 2) into pieces of equal length."""
    distances = np.concatenate(([0.0], np.hypot(*np.diff(line, axis=0).T).cumsum()))
    places = np.linspace(0, distances[-1], POINTS)
    return np.stack([np.interp(places, distances, axis) for axis in line.T], axis=1)


# --- the first table: ways to spread points over a path -----------------------------------------


def measure_family(preset: str, count: int = 1000) -> Row:
    """Return a row of the first table."""
    batch = problems_of(generators.PRESETS[preset], TEST_SEED, count, distance=20)
    grids = batch.map[:, 0].numpy()
    cells = [path[path[:, 0] >= 0].numpy() for path in batch.path]
    taut_lines = [pull_taut(grid, path) for grid, path in zip(grids, cells, strict=True)]
    bends = np.array([len(line) - 2 for line in taut_lines])
    fits = batch.waypoints[:, 0, 0].numpy() >= 0
    of_cells = np.array([resampled(path + 0.5) for path in cells])
    of_taut_lines = np.array([resampled(line) for line in taut_lines])
    shorter = [
        1 - length_of(line) / length_of(path) for line, path in zip(taut_lines, cells, strict=True)
    ]
    return {
        "maps": preset,
        "cells": 1 - float(lines_are_free(grids, of_cells).mean()),
        "taut": 1 - float(lines_are_free(grids, of_taut_lines).mean()),
        "waypoints": 1 - float(lines_are_free(grids[fits], batch.waypoints[fits]).mean()),
        "bends": float(bends.mean()),
        "bends_max": int(bends.max()),
        "no_fit": 1 - float(fits.mean()),
        "shorter": float(np.mean(shorter)),
    }


def family_table(rows: list[Row]) -> str:
    """Return the first table as Markdown."""
    lines = [
        "| maps | lines of resampled cells that collide | taut lines resampled by length that "
        "collide | `waypoints` that collide | number of bends, mean and maximum | lines with more "
        "than 30 bends | how much shorter than the path, mean |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        shares = [f"{100 * row[name]:.1f}" for name in ("cells", "taut", "waypoints")]
        bends = f"{row['bends']:.1f}, {row['bends_max']}"
        last = [f"{100 * row[name]:.1f}" for name in ("no_fit", "shorter")]
        lines.append("| " + " | ".join([f"`{row['maps']}`", *shares, bends, *last]) + " |")
    return "\n".join(lines)


# --- the second table: planners of lines --------------------------------------------------------


def straight_lines(batch: Sample) -> Floats:
    """Return the straight lines from start to goal, (B, T, 2)."""
    starts = batch.start.numpy()[:, None] + 0.5
    goals = batch.goal.numpy()[:, None] + 0.5
    share = np.linspace(0, 1, POINTS)[:, None]
    lines: Floats = (1 - share) * starts + share * goals
    return lines


def signed_distances(grids: Bytes) -> Floats:
    """Return the distance of each cell's middle to the obstacles, (B, H, W), in cells.

    It is below 0 in obstacles, to which everything outside of the map belongs.
    """
    distances = []
    for grid in grids:
        is_free = np.pad(grid == 0, 1)
        outside = distance_transform_edt(is_free) - 0.5
        inside = distance_transform_edt(~is_free) - 0.5
        distances.append(np.where(is_free, outside, -inside)[1:-1, 1:-1])
    return np.array(distances)


def interpolated(fields: Floats, points: Floats) -> Floats:
    """Return the bilinear values of fields (B, H, W) at points (B, P, 2), in cells: (B, P)."""
    last_cell = np.array(fields.shape[1:]) - 1
    places = (points - 0.5).clip(0, last_cell)
    upper_left = places.astype(int).clip(max=last_cell - 1)
    down, right = np.moveaxis(places - upper_left, 2, 0)
    row, column = np.moveaxis(upper_left, 2, 0)
    map_number = np.arange(len(fields))[:, None]
    upper = fields[map_number, row, column] * (1 - right)
    upper += fields[map_number, row, column + 1] * right
    lower = fields[map_number, row + 1, column] * (1 - right)
    lower += fields[map_number, row + 1, column + 1] * right
    values: Floats = upper * (1 - down) + lower * down
    return values


def elastic_bands(
    grids: Bytes, lines: Floats, margin: float = 0.8, contraction: float = 0.25, rounds: int = 80
) -> Floats:
    """Return lines (B, T, 2) after some rounds of two forces on their points; the ends stay.

    Where a line is nearer than ``margin`` to an obstacle, the gradient of the distance pushes it
    away. The contraction pulls each point to the middle of its two neighbours.
    """
    distances = signed_distances(grids)
    slopes: list[Floats] = [*np.gradient(distances, axis=(1, 2))]
    shares = np.arange(4) / 4  # four places on each segment, the first one at its beginning
    for _ in range(rounds):
        begins, ends = lines[:, :-1, None], lines[:, 1:, None]
        places = begins + (ends - begins) * shares[:, None]
        points = places.reshape(len(lines), -1, 2)
        direction = np.stack([interpolated(slope, points) for slope in slopes], axis=2)
        direction /= np.linalg.norm(direction, axis=2, keepdims=True) + 1e-9
        lack = (margin - interpolated(distances, points)).clip(min=0)
        push = (lack[..., None] * direction).reshape(places.shape)
        force = np.zeros_like(lines)
        force[:, :-1] += (push * (1 - shares)[:, None]).sum(axis=2)
        force[:, 1:] += (push * shares[:, None]).sum(axis=2)
        pull = (lines[:, :-2] + lines[:, 2:]) / 2 - lines[:, 1:-1]
        lines = lines.copy()
        lines[:, 1:-1] += 0.2 * force[:, 1:-1] + contraction * pull
    return lines


def predicted_lines(batch: Sample) -> Floats:
    """Return the lines of the pretrained planner, (B, T, 2)."""
    model = PathPredictor.pretrained()
    problems = zip(batch.map, batch.start, batch.goal, strict=True)
    return np.array([model.predict_waypoints(*problem, POINTS) for problem in problems])


def planner_row(name: str, batch: Sample, lines: Floats) -> Row:
    """Return a row of the second table."""
    is_free: Flags = lines_are_free(batch.map, lines)
    labels = batch.waypoints.numpy()
    pairs = zip(lines[is_free], labels[is_free], strict=True)
    ratios = [length_of(line) / length_of(label) for line, label in pairs]
    return {
        "name": name,
        "count": len(lines),
        "collide": 1 - float(is_free.mean()),
        "ratio": float(np.mean(ratios)),
        "ratio_max": float(np.max(ratios)),
    }


def measure_planners(count: int = 500) -> list[Row]:
    """Return the rows of the second table."""
    batch = problems_of(SMALL_FOREST, TEST_SEED, count, distance=10)
    straight = straight_lines(batch)
    bands = elastic_bands(batch.map[:, 0].numpy(), straight)
    return [
        planner_row("straight line", batch, straight),
        planner_row("straight line, then elastic band", batch, bands),
        planner_row("`PathPredictor.predict_waypoints`", batch, predicted_lines(batch)),
        planner_row("labels: `waypoints`", batch, batch.waypoints.numpy()),
    ]


def planner_table(rows: list[Row]) -> str:
    """Return the second table as Markdown."""
    lines = [
        "| lines | collide | length / length of the label, of free lines: mean and maximum |",
        "|---|---|---|",
    ]
    for row in rows:
        collide = f"{100 * row['collide']:.0f} %"
        lines.append(f"| {row['name']} | {collide} | {row['ratio']:.4f}, {row['ratio_max']:.2f} |")
    return "\n".join(lines)


def weights_hash() -> str:
    """Return the SHA-256 of the file of the pretrained weights."""
    file = WEIGHTS / PathPredictor.PRETRAINED["eight"]
    return hashlib.sha256(file.read_bytes()).hexdigest()


def write_page(results: Row) -> None:
    """Write both tables into the page, between their marks."""
    page = PAGE.read_text()
    tables = {FAMILIES: family_table, PLANNERS: planner_table}
    for name, table in tables.items():
        before, rest = page.split(f"<!-- {name} -->")
        _, after = rest.split(f"<!-- end of {name} -->")
        shown = table(results[name])
        page = f"{before}<!-- {name} -->\n\n{shown}\n\n<!-- end of {name} -->{after}"
    write_output(PAGE, page.encode())


def main() -> None:
    """Measure all rows, and write the file and the page."""
    torch.set_num_threads(1)
    results = {
        "weights": weights_hash(),
        FAMILIES: [measure_family(preset) for preset in PRESETS],
        PLANNERS: measure_planners(),
    }
    write_output(RESULTS, f"{json.dumps(results, indent=1)}\n".encode())
    write_page(results)


if __name__ == "__main__":
    main()
