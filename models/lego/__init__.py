"""Where a roadmap needs its vertices: samplers that learn it, their targets, and roadmaps.

- ``sampler.py``: `Sampler`, a model that says where to sample, and the heat map.
- ``cvae.py``: the published autoencoder.
- ``experience.py``: the targets that both learn from, mined with LEGO's method.
- ``roadmap.py``: roadmaps, and samplers that learn nothing.
- ``comparison.py``: the table that compares samplers.
"""
