"""Measure the pretrained costs in another light: python docs/light_tables.py.

The pretrained `mapdata.models.CostPredictor` predicts the costs of ``tiles`` from images that a
camera might have taken: darker or brighter ones, with another contrast, shadows, blur or noise. The
table has the share of optimal paths on three test sets, each with the textures of the training and
with textures that no training has seen. The second table has images without changes, on the maps
of docs/image_tables.py.

All choices were made on the maps of seed 177 with the textures of the seeds 0, 11 and 12. The seeds
and the strengths of all changes below were chosen before the weights were scored.

The figures are written to docs/light_results.json, and the tables into docs/costs.md. That takes
one core about five minutes. Needs scipy and Pillow.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from image_tables import FAMILIES, NOISE, PAGE, TEST_MAPS, TEST_SEED, scores
from PIL import Image
from scipy.ndimage import gaussian_filter

from mapdata import ProblemSet, ProblemSetDataset, Tiles
from mapdata.arrays import Bytes, Floats
from mapdata.models import CostPredictor
from mapdata.models.pretrained.model import WEIGHTS
from mapdata.shards import write_output

RESULTS = Path(__file__).parent / "light_results.json"

TEST_SEEDS = (781, 782, 783)
"""The seeds of the maps."""

MAPS = 500
"""Number of maps of each test seed."""

NEW_TEXTURES = (31, 32, 33)
"""The seeds of textures that no training has seen, one for each of `TEST_SEEDS`."""

SEVERAL_TEXTURES = (0, 1, 2, 3)
"""The seeds of the textures of the second table; those of the training have seed 0."""


def slanted(images: Floats, levels: float, axis: int) -> Floats:
    """Return images that are darker at one border and brighter at the opposite one."""
    ramp = np.linspace(-levels, levels, images.shape[axis])
    return images + np.expand_dims(ramp, tuple(k for k in range(4) if k != axis))


def shadowed(images: Floats) -> Floats:
    """Return images whose left half has 60 % of its light."""
    columns = images.shape[3]
    return images * np.where(np.arange(columns) < columns // 2, 0.6, 1.0)


def noisy(images: Floats) -> Floats:
    """Return images with more noise."""
    generator = np.random.default_rng(0)
    return images + 32 * generator.standard_normal(images.shape)


def compressed(images: Floats) -> Floats:
    """Return images after compression to JPEG files of quality 75 and back."""
    decoded = []
    for image in images.astype(np.uint8).transpose(0, 2, 3, 1):
        file = io.BytesIO()
        Image.fromarray(image).save(file, "JPEG", quality=75)
        decoded.append(np.asarray(Image.open(file)).transpose(2, 0, 1))
    return np.stack(decoded).astype(float)


CHANGES: dict[str, Callable[[Floats], Floats]] = {
    "none": lambda images: images,
    "40 grey levels darker": lambda images: images - 40,
    "20 grey levels darker": lambda images: images - 20,
    "20 grey levels brighter": lambda images: images + 20,
    "40 grey levels brighter": lambda images: images + 40,
    "contrast 0.5": lambda images: 128 + 0.5 * (images - 128),
    "contrast 1.5": lambda images: 128 + 1.5 * (images - 128),
    "slanted light, -30 to 30 along rows": lambda images: slanted(images, 30, axis=2),
    "slanted light, -30 to 30 along columns": lambda images: slanted(images, 30, axis=3),
    "shift of 1 pixel": lambda images: np.roll(images, 1, axis=3),
    "shift of 2 pixels": lambda images: np.roll(images, 2, axis=3),
    "shadow: 60 % of the light on one half": shadowed,
    "white balance: red 115 %, blue 85 %": lambda images: (
        images * np.array([1.15, 1, 0.85])[:, None, None]
    ),
    "blur: Gaussian of 0.8 pixels": lambda images: gaussian_filter(images, (0, 0, 0.8, 0.8)),
    "noise: deviation 32": noisy,
    "JPEG of quality 75": compressed,
}
"""Changes of images (B, 3, rows, columns) with levels from 0 to 255, by their names."""

IN_TRAINING = 10
"""So many of `CHANGES` are in the jitter of the training, or are none."""


def weights_hash() -> str:
    """Return the SHA-256 of the file of the pretrained weights."""
    file = WEIGHTS / CostPredictor.PRETRAINED["tiles"]
    return hashlib.sha256(file.read_bytes()).hexdigest()


def problems_of(seed: int, maps: int) -> ProblemSet:
    """Return the problems on maps of a seed."""
    family = FAMILIES["tiles 12"]
    return ProblemSet.sample(
        family.generator,
        seed=seed,
        maps=maps,
        movement=family.generator.movement,
        problems=family.problems,
    )


def predicted(
    model: CostPredictor, problems: ProblemSet, change: Callable[[Floats], Floats], textures: int
) -> Bytes:
    """Return the terrain that a model sees in changed images of problems, (N, H, W)."""
    dataset = ProblemSetDataset(problems, ("map", Tiles(alike=True, noise=NOISE, seed=textures)))
    terrain = []
    for first in range(0, len(problems), 100):
        batch = dataset[first : first + 100]
        images = change(batch.image.numpy().astype(float))
        levels = np.rint(images).clip(0, 255).astype(np.uint8)
        terrain.append(model.predict(levels, batch.map[:, 0].numpy()))
    return np.concatenate(terrain)


def measure(model: CostPredictor, seed: int, maps: int, plan: list[tuple[str, int]]) -> list[Any]:
    """Return a row for each pair of a change and a seed of textures."""
    problems = problems_of(seed, maps)
    rows = []
    for change, textures in plan:
        terrain = predicted(model, problems, CHANGES[change], textures)
        row = {"change": change, "textures": textures, "seed": seed, "maps": maps}
        rows.append({**row, "set": problems.content_hash, **scores(problems, terrain)})
        print(json.dumps(rows[-1]), flush=True)
    return rows


def spread(percent: pd.Series[float]) -> str:
    """Return mean and range of the shares of several test sets, in percent."""
    return f"{percent.mean():.1f} % ({percent.min():.1f} to {percent.max():.1f})"


def light_table(rows: list[dict[str, Any]]) -> str:
    """Return the rows of `TEST_SEEDS` as a Markdown table."""
    lines = [
        "| change of the images | in training | optimal | new textures: optimal |",
        "|---|---|---|---|",
    ]
    frame = pd.DataFrame(rows)
    frame = frame[frame["seed"].isin(TEST_SEEDS)].assign(percent=100 * frame["opt"])
    for k, change in enumerate(CHANGES):
        of_change = frame[frame["change"] == change]
        cells = [change, "yes" if 0 < k < IN_TRAINING else "no" if k else ""]
        cells += [
            spread(of_change["percent"][of_change["textures"].isin(textures)])
            for textures in ((0,), NEW_TEXTURES)
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def texture_table(rows: list[dict[str, Any]]) -> str:
    """Return the rows of the maps of docs/image_tables.py as a Markdown table."""
    lines = ["| textures | optimal | regret |", "|---|---|---|"]
    for row in rows:
        if row["seed"] == TEST_SEED:
            textures = row["textures"]
            name = f"seed {textures}" + ("" if textures else ", those of the training")
            lines.append(f"| {name} | {row['opt']:.1%} | {row['regret']:.3%} |".replace("%", " %"))
    return "\n".join(lines)


def write_page(rows: list[dict[str, Any]], page: Path = PAGE) -> None:
    """Write both tables into the page, each between its two marks."""
    text = page.read_text()
    for name, table in (("light", light_table(rows)), ("textures", texture_table(rows))):
        begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
        before, rest = text.split(begin)
        _, after = rest.split(end)
        text = f"{before}{begin}\n\n{table}\n\n{end}{after}"
    write_output(page, text.encode())


def main() -> None:
    """Measure the pretrained weights, and write the file and the page."""
    torch.set_num_threads(1)
    model = CostPredictor.pretrained()
    rows = measure(model, TEST_SEED, TEST_MAPS, [("none", seed) for seed in SEVERAL_TEXTURES])
    for seed, new_textures in zip(TEST_SEEDS, NEW_TEXTURES, strict=True):
        pairs = [(change, textures) for change in CHANGES for textures in (0, new_textures)]
        rows += measure(model, seed, MAPS, pairs)
    results = {"weights": weights_hash(), "rows": rows}
    write_output(RESULTS, f"{json.dumps(results, indent=1)}\n".encode())
    write_page(rows)


if __name__ == "__main__":
    main()
