"""Where a roadmap needs its vertices: samplers that learn it, and their targets.

- ``sampler.py``: `Sampler`, the base class, and `Heatmap`, which predicts shares of cells.
- ``cvae.py``: `CVAE`, the autoencoder of the LEGO paper.
- ``experience.py``: the targets that samplers learn from, mined with LEGO's method.

`mapdata.roadmaps` has roadmaps, samplers that learn nothing, and the table that compares samplers.
"""
