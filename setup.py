"""The part of a release's metadata that depends on the address of the repository.

The address is the line ``repository-code`` of CITATION.cff. The project links are made from it, and
so are the links and pictures of README, which the package index shows outside the repository. Until
the line is there, README stays as it is. Everything else is in pyproject.toml.
"""

from __future__ import annotations

import re
from pathlib import Path

from setuptools import setup

ROOT = Path(__file__).parent
PAPER = "https://arxiv.org/abs/2110.13242"


def citation_line(name: str) -> str:
    """Return the value of a top-level line of CITATION.cff; "" where there is no such line."""
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    line = re.search(rf"^{name}: *\"?([^\"\n]*)", text, re.MULTILINE)
    return line[1].strip().rstrip("/") if line else ""


def project_urls(address: str, version: str) -> dict[str, str]:
    """Return the links that the package index shows beside a release."""
    if not address:
        return {"Paper": PAPER}
    return {
        "Source": address,
        "Documentation": f"{address}/blob/v{version}/docs/index.md",
        "Issues": f"{address}/issues",
        "Changelog": f"{address}/blob/v{version}/CHANGELOG.md",
        "Paper": PAPER,
    }


def description(readme: str, address: str, version: str) -> str:
    """Return README with absolute links and pictures, those of the tag of this version."""
    if not address:
        return readme
    readme = re.sub(
        r'(src|srcset)="(?!https?:)([^"]+)"', rf'\1="{address}/raw/v{version}/\2"', readme
    )
    return re.sub(r"\]\((?!https?:|#)([^)]+)\)", rf"]({address}/blob/v{version}/\1)", readme)


if __name__ == "__main__":
    ADDRESS, VERSION = citation_line("repository-code"), citation_line("version")
    setup(
        long_description=description(
            (ROOT / "README.md").read_text(encoding="utf-8"), ADDRESS, VERSION
        ),
        long_description_content_type="text/markdown",
        project_urls=project_urls(ADDRESS, VERSION),
    )
