"""Write the sections of the presets on docs/gallery.md: python docs/gallery_sections.py.

Each preset is built in a temporary folder, 1,000 maps of seed 0, for its content hash. What its
problems are worth is read from docs/problem_results.json, which problem_tables.py measured on the
same maps. The pictures are drawn by ``python docs/figures.py``. It takes a minute of one core.
"""

from __future__ import annotations

import json
import tempfile
import textwrap
from pathlib import Path
from typing import Any

from planner_tables import filled
from problem_tables import FILE, MAPS, SEED, read

from mapdata import build
from mapdata.generators import PRESETS, as_recipe
from mapdata.shards import write_output

PAGE = Path(__file__).parent / "gallery.md"


def share(number: list[float] | None) -> str:
    """Return a share in percent, or a dash where it is not known."""
    return "-" if number is None else f"{100 * number[0]:.0f} %"


def worth(rows: list[dict[str, Any]], preset: str) -> str:
    """Return what random problems of a preset are worth, with 4 and with 8 moves."""
    sentences = []
    for row in rows:
        if (row["preset"], row["source"]) == (preset, "random"):
            sentences.append(
                f"{share(row['hard'])} and {share(row['single_path'])} with "
                f"{row['connectivity']} moves"
            )
    return (
        "Random problems with a detour of 5 % or more, and those with a single shortest "
        f"path: {'; '.join(sentences)}."
    )


def section(preset: str, rows: list[dict[str, Any]], folder: Path) -> str:
    """Return the section of a preset."""
    recipe = as_recipe(preset, maps=MAPS, seed=SEED)
    manifest = build(folder / preset, recipe, shard_size=MAPS)
    spec = json.dumps(recipe.generator.to_dict())
    size = " x ".join(map(str, recipe.generator.map_size))
    description = recipe.generator.description
    first_line = f"{description[0].upper()}{description[1:]}, {size} cells. {worth(rows, preset)}"
    return f"""### {preset}

![Six maps of the preset {preset}](images/preset-{preset}.png)

{textwrap.fill(first_line, 128)}

    mapdata build data/{preset} --preset {preset} --maps {MAPS} --seed {SEED}

Content hash of these maps: `{manifest.content_hash}`. Spec of the recipe:

```json
{spec}
```
"""


def main() -> None:
    """Write the page anew."""
    rows = read(FILE)
    with tempfile.TemporaryDirectory() as folder:
        text = "\n".join(section(preset, rows, Path(folder)) for preset in PRESETS)
    page = PAGE.read_text(encoding="utf-8")
    write_output(PAGE, filled(page, {"presets": text.rstrip("\n")}).encode())


if __name__ == "__main__":
    main()
