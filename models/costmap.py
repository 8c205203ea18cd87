"""The former place of `mapdata.costmaps`; its names are there, and leave here in version 0.5."""

from __future__ import annotations

import warnings

from mapdata import costmaps


def __getattr__(name: str) -> object:
    """Return a name of `mapdata.costmaps`, and warn."""
    if name not in costmaps.__all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    warnings.warn(
        f"mapdata.models.costmap.{name} will be gone in 0.5.0: it is now mapdata.costmaps.{name}",
        FutureWarning,
        stacklevel=2,
    )
    value: object = getattr(costmaps, name)
    return value
