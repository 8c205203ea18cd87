"""Reading a dataset card."""

from __future__ import annotations


def table(text: str, heading: str) -> dict[str, list[str]]:
    """Return the table under a heading of the card: the other cells of each row, by the first."""
    part = text.split(f"\n## {heading}\n")[1].split("\n## ", maxsplit=1)[0]
    rows = [line.strip("|").split("|") for line in part.splitlines() if line.startswith("|")]
    return {row[0].strip(): [cell.strip() for cell in row[1:]] for row in rows}
