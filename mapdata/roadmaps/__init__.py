"""Probabilistic roadmaps on grid maps, and the comparison of samplers of their vertices.

It needs scipy (docs/samplers.md). `mapdata.models` has samplers that learn.
"""

from importlib.util import find_spec

if find_spec("scipy") is None:
    raise ModuleNotFoundError(
        "roadmaps need scipy, the extra [examples]: pip install scipy", name="scipy"
    )

from mapdata.roadmaps.comparison import (
    SIZES,
    LearnedSampler,
    compare,
    contenders,
    plot_success,
    sample_half_halton,
    to_text,
)
from mapdata.roadmaps.roadmap import (
    NO_ROADMAPS_ON_TERRAIN,
    SAMPLERS,
    Roadmap,
    bridge,
    build_roadmap,
    connection_radius,
    corners,
    free_at,
    gaussian,
    halton,
    medial_axis,
    path_lengths,
    roadmap_between,
    segments_are_free,
    uniform,
)

__all__ = [
    "NO_ROADMAPS_ON_TERRAIN",
    "SAMPLERS",
    "SIZES",
    "LearnedSampler",
    "Roadmap",
    "bridge",
    "build_roadmap",
    "compare",
    "connection_radius",
    "contenders",
    "corners",
    "free_at",
    "gaussian",
    "halton",
    "medial_axis",
    "path_lengths",
    "plot_success",
    "roadmap_between",
    "sample_half_halton",
    "segments_are_free",
    "to_text",
    "uniform",
]
