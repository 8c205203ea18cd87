"""Names that have left the faces of folders."""

from __future__ import annotations

from importlib import import_module

import pytest

FORMER = {
    "evaluation.metrics": ("METRICS", "TERRAIN_METRICS", "median_interval"),
    "evaluation.planners": ("BestFirst", "Limit", "Search"),
    "export.layouts": ("LAYOUTS", "Layout", "LayoutArray"),
    "formats.registry": ("FORMATS", "recognise"),
    "generators.generator": ("GENERATORS",),
    "generators.maps": ("WORD", "pack"),
    "generators.points": ("draw_points", "largest_component"),
    "generators.splits": ("SplitMaps", "draw_splits", "maps_of_split", "split_thresholds"),
    "plotting.figures": ("plot_figure",),
    "problems.sources": ("Source",),
    "search.arguments": ("as_terrain",),
}
"""The names that left in 0.4.0, by the module that has each."""


@pytest.mark.parametrize("home", FORMER)
def test_a_former_name_is_given_with_a_warning(home: str) -> None:
    """It is the object of the module that the warning names, and no longer of ``__all__``."""
    face = import_module(f"mapdata.{home.partition('.')[0]}")
    module = import_module(f"mapdata.{home}")
    for name in FORMER[home]:
        with pytest.warns(
            FutureWarning, match=f"{face.__name__}.{name} .* is in {module.__name__}"
        ) as seen:
            value = getattr(face, name)
        assert value is getattr(module, name)
        assert seen[0].filename == __file__
        assert name not in face.__all__


def test_other_names_are_missing() -> None:
    """As of any module."""
    with pytest.raises(AttributeError, match=r"'mapdata\.search' has no attribute 'nothing'"):
        import_module("mapdata.search").nothing  # noqa: B018
