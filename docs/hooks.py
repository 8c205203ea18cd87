"""Changes that the site makes to its pages: pictures in two themes, words for its search, and pages
at old addresses, which lead to where their text is now.

A page says ``![words](images/name.png)``; beside it lies ``name-dark.png``. The site shows the
picture of the theme that the reader has chosen; GitHub shows the light one. Of wide pictures there
is also ``name-phone.png``, with fewer columns, which narrow screens show.
"""

import logging
import re
from collections.abc import MutableMapping
from pathlib import Path
from typing import Any

import yaml

PICTURE = re.compile(r"!\[([^\]]*)\]\(([\w./-]*images/[\w-]+)\.png\)")
IMAGES = Path(__file__).parent / "images"
IMAGE = re.compile(r'<img [^>]*src="([\w./-]*images/)([\w-]+?)(-dark)?\.png(#[\w-]+)"[^>]*>')
CITATION = Path(__file__).parent.parent / "CITATION.cff"

MOVED = {
    "formats/maze-hard.md": "formats.md#maze-hard",
    "formats/paper.md": "formats.md#paper",
    "formats/planning-datasets.md": "formats.md#planning-datasets",
    "formats/text.md": "formats.md#text",
    "formats/tilebased.md": "formats.md#tilebased",
    "formats/transpath.md": "formats.md#transpath",
    "formats/warcraft.md": "formats.md#warcraft",
    "planner_tables.md": "planners.md#planners-compared",
    "limits.md": "promises.md#limits",
    "urls.md": "loading.md#at-a-url",
    "versions.md": "install.md#tested-versions",
}
"""Pages of earlier versions, and where their text is now: links to them stay good."""

NOT_SEARCHED = ("benchmarks.md", "format.md", "paper.md")
"""Long tables and definitions: they have nearly every word, and hide the page that explains one."""

SEARCH_WORDS = {
    "command.md": ["shell", "CLI"],
    "distributed.md": ["DDP", "multi-GPU", "resume", "reproducible"],
    "faq.md": [
        "CUDA",
        "citation",
        "cite",
        "gymnasium",
        "license",
        "normalize",
        "slow",
        "out of memory",
    ],
    "fields.md": ["optimal_moves", "cost_to_go", "path_mask"],
    "gallery.md": ["visualize", "plot"],
    "formats/ros.md": ["robot map", "map_server"],
    "howto/coming_from.md": ["GPU", "huggingface"],
    "howto/maps.md": ["own map", "png", "image", "import"],
    "howto/planner.md": ["custom planner"],
    "howto/spec.md": ["custom generator", "add a family"],
    "howto/teach.md": [
        "custom heuristic",
        "draw search tree",
        "visualize expanded cells",
        "lecture",
        "competition",
    ],
    "howto/terrain.md": ["weighted", "cost map", "terrain cost"],
    "howto/text.md": ["LLM", "language model"],
    "howto/training.md": [
        "wandb",
        "profiler",
        "bf16",
        "fp16",
        "AMP",
        "num_workers",
        "samples per second",
    ],
    "install.md": ["windows", "macOS", "pip", "docker"],
    "loading.md": ["custom dataset", "DataLoader", "Lightning", "batch size", "U-Net", "unet"],
    "planners.md": ["A*", "Dijkstra", "JPS"],
    "problems.md": ["random problems", "hard problems", "start and goal"],
    "recipes.md": ["hydra", "accelerate"],
    "reference/datasets.md": ["MapDataset", "MapDataModule"],
    "reference/plotting.md": ["visualize", "matplotlib"],
    "words.md": ["corner cutting", "diagonal moves", "glossary", "seed"],
}
"""What newcomers type to find a page, where it does not stand in the title."""

EDGE = re.compile(r"(e=e\+\w\+\w\.id)\}return e")
"""Where the search (lunr.js, TokenSet.toString) names a node of its index by the edges that leave
it: the character of each, and the number of the node that it leads to."""


def missing_inventory_is_no_error(record: logging.LogRecord) -> bool:
    """Make a message of mkdocstrings on an inventory that it could not load a mere note.

    The inventories of mkdocs.yml link types of other projects to their pages. Without a network
    the site has these types as plain text; an error would stop a strict build.
    """
    if "Couldn't load inventory" in record.getMessage():
        record.levelno, record.levelname = logging.INFO, "INFO"
    return True


def on_config(config: MutableMapping[str, Any]) -> None:
    """Link the repository at the top of each page, if CITATION.cff has its address."""
    logging.getLogger("mkdocs.plugins.mkdocstrings").addFilter(missing_inventory_is_no_error)
    address = yaml.safe_load(CITATION.read_text(encoding="utf-8")).get("repository-code")
    if address:
        config["repo_url"] = address
        config["repo_name"] = address.rstrip("/").rpartition("/")[2]


def on_page_markdown(markdown: str, page: Any, **_: object) -> str:
    """Give each picture its two themes, and the search its words."""
    name = page.file.src_uri
    if name in NOT_SEARCHED:
        page.meta["search"] = {"exclude": True}
    if name in SEARCH_WORDS:
        page.meta["tags"] = SEARCH_WORDS[name]
    return PICTURE.sub(r"![\1](\2.png#only-light)![\1](\2-dark.png#only-dark)", markdown)


def on_page_content(html: str, **_: object) -> str:
    """Give wide pictures their variant for phones."""
    return IMAGE.sub(_with_phone_variant, html)


def _with_phone_variant(image: re.Match[str]) -> str:
    folder, name, dark = image[1], image[2], image[3] or ""
    if not (IMAGES / f"{name}-phone.png").exists():
        return image[0]
    source = f'<source media="(max-width: 30em)" srcset="{folder}{name}-phone{dark}.png">'
    return f"<picture>{source}{image[0]}</picture>"


def on_post_build(config: MutableMapping[str, Any]) -> None:
    """Write a page at each old address, and mend the search."""
    site = Path(config["site_dir"])
    for old, new in MOVED.items():
        page = site / old.removesuffix(".md") / "index.html"
        page.parent.mkdir(parents=True, exist_ok=True)
        page.write_text(_redirect(old, new), encoding="utf-8")
    _let_the_search_answer_every_word(site)


def _redirect(old: str, new: str) -> str:
    """Return a page that leads to a new place; an anchor of the old address is kept."""
    target, _, anchor = new.partition("#")
    up = "../" * (old.count("/") + 1)
    address = f"{up}{target.removesuffix('.md')}/"
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>This page has moved</title>
<link rel="canonical" href="{address}">
<meta name="robots" content="noindex">
<script>location.replace("{address}" + (location.hash || "#{anchor}"))</script>
<noscript><meta http-equiv="refresh" content="0; url={address}#{anchor}"></noscript>
</head>
<body>This page has moved to <a href="{address}#{anchor}">another place</a>.</body>
</html>
"""


def _let_the_search_answer_every_word(site: Path) -> None:
    """Change the program of the search where it takes a word for another.

    lunr writes the edges of a node without anything between them. Two nodes may so have one name:
    "1234" is an edge "1" to node 234, or an edge "1" to node 2 and an edge "3" to node 4. lunr then
    takes one for the other, and answers words such as "batch" with an error. A comma after each
    edge makes the names differ. tests/docs/test_docs.py tries all words.
    """
    for worker in site.glob("assets/javascripts/workers/search.*.js"):
        program = worker.read_text(encoding="utf-8")
        worker.write_text(EDGE.sub(r'\1+","}return e', program), encoding="utf-8")
