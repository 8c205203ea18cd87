"""Reading a dataset card."""

from __future__ import annotations


def table(text: str, heading: str) -> dict[str, list[str]]:
    """Return the table under a heading of the card: the other cells of each row, by the first."""
    _, after = text.split(f"\n## {heading}\n")
    section = after.split("\n## ", maxsplit=1)[0]
    found = {}
    for line in section.splitlines():
        if line.startswith("|"):
            first, *others = (cell.strip() for cell in line.strip("|").split("|"))
            found[first] = others
    return found
