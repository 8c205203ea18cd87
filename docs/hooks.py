"""Changes that the site makes to its pages: pictures in two themes, and a link to the repository.

A page says ``![words](images/name.png)``; beside it lies ``name-dark.png``. The site shows the
picture of the theme that the reader has chosen; GitHub shows the light one. Of wide pictures there
is also ``name-phone.png``, with fewer columns, which narrow screens show.
"""

import re
from collections.abc import MutableMapping
from pathlib import Path
from typing import Any

import yaml

PICTURE = re.compile(r"!\[([^\]]*)\]\(([\w./-]*images/[\w-]+)\.png\)")
IMAGES = Path(__file__).parent / "images"
IMAGE = re.compile(r'<img [^>]*src="([\w./-]*images/)([\w-]+?)(-dark)?\.png(#[\w-]+)"[^>]*>')
CITATION = Path(__file__).parent.parent / "CITATION.cff"


def on_config(config: MutableMapping[str, Any]) -> None:
    """Link the repository at the top of each page, if CITATION.cff has its address."""
    address = yaml.safe_load(CITATION.read_text(encoding="utf-8")).get("repository-code")
    if address:
        config["repo_url"] = address
        config["repo_name"] = address.rstrip("/").rpartition("/")[2]


def on_page_markdown(markdown: str, **_: object) -> str:
    """Give each picture its two themes."""
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
