"""Changes that the site makes to its pages: pictures in two themes, and a link to the repository.

A page says ``![words](images/name.png)``; beside it lies ``name-dark.png``. The site shows the
picture of the theme that the reader has chosen; GitHub shows the light one.
"""

import re
from collections.abc import MutableMapping
from pathlib import Path
from typing import Any

import yaml

PICTURE = re.compile(r"!\[([^\]]*)\]\(([\w./-]*images/[\w-]+)\.png\)")
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
