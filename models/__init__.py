"""Sample models to read and to copy.

- ``path_predictor.py``: a CNN that predicts the moves of shortest paths.
- ``neural_astar.py``: Neural A* in one file.
- ``learned_planners.py``: planners that search with what a network predicts.
- ``lego/``: a sampler that learns where a roadmap needs its vertices.

They share ``layers.py``, ``geometry.py``, ``symmetries.py``, ``optimizer.py`` and ``model.py``.
``training.py`` is the command line of the training scripts.
"""
