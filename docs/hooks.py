"""What the site does with its pages: a picture is shown in the theme that the reader has chosen.

A page says ``![words](images/name.png)``; beside it lies ``name-dark.png``. On GitHub the light one
is shown.
"""

import re

PICTURE = re.compile(r"!\[([^\]]*)\]\(([\w./-]*images/[\w-]+)\.png\)")


def on_page_markdown(markdown: str, **_: object) -> str:
    """Give each picture its two themes."""
    return PICTURE.sub(r"![\1](\2.png#only-light)![\1](\2-dark.png#only-dark)", markdown)
