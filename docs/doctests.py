"""Shows the doctests at the end of docstrings as code in the reference, as an extension of griffe.

Without it Markdown takes ``>>>`` for quotations.
"""

import re

from griffe import Extension, Object

DOCTEST = re.compile(r"^>>> .*(?:\n.+)*", re.MULTILINE)


class Doctests(Extension):
    """Puts each doctest into a fenced block."""

    def on_object(self, *, obj: Object, **_: object) -> None:
        """Change the docstring of one object."""
        if obj.docstring is not None:
            obj.docstring.value = DOCTEST.sub(r"```pycon\n\g<0>\n```", obj.docstring.value)
