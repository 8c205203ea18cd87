"""The sections of the presets on docs/gallery.md are those that their script writes."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from mapdata.generators import PRESETS

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.slow
def test_the_sections_are_written_from_the_presets(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Writing them again changes nothing: the same hashes, figures and specs."""
    monkeypatch.syspath_prepend(str(DOCS))
    import gallery_sections

    page = tmp_path / "gallery.md"
    shutil.copy(gallery_sections.PAGE, page)
    monkeypatch.setattr(gallery_sections, "PAGE", page)
    gallery_sections.main()
    assert page.read_text() == (DOCS / "gallery.md").read_text()


def test_every_preset_has_its_section() -> None:
    """With its picture and the command that builds it, in the order of the presets."""
    lines = (DOCS / "gallery.md").read_text().splitlines()
    assert [line[4:] for line in lines if line.startswith("### ")] == list(PRESETS)
    for name in PRESETS:
        assert f"![Six maps of the preset {name}](images/preset-{name}.png)" in lines
        assert f"    mapdata build data/{name} --preset {name} --maps 1000 --seed 0" in lines
