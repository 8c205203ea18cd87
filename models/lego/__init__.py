"""Where a roadmap needs its vertices: samplers that learn it, their targets, and roadmaps.

- ``sampler.py``: `Sampler`, the base class, and `Heatmap`, which predicts shares of cells.
- ``cvae.py``: `CVAE`, the autoencoder of the LEGO paper.
- ``experience.py``: the targets that samplers learn from, mined with LEGO's method.
- ``roadmap.py``: roadmaps, and samplers that learn nothing.
- ``comparison.py``: the table that compares samplers.
"""

from importlib.util import find_spec

if find_spec("scipy") is None:
    raise ModuleNotFoundError(
        "mapdata.models.lego needs scipy, the extra [examples]: pip install scipy", name="scipy"
    )
