"""Sample models to read and to copy.

- ``path_predictor.py``: a CNN that predicts the moves of shortest paths.
- ``neural_astar.py``: Neural A* in one file.
- ``learned_planners.py``: planners that search with the predictions of a network.
- ``lego/``: a sampler that learns where a roadmap needs its vertices.

They share five files:

- ``layers.py``: the layers of the networks.
- ``geometry.py``: distances, heuristics and legal moves on tensors of maps.
- ``symmetries.py``: the eight symmetries of a square map.
- ``optimizer.py``: Muon, and the schedule of its learning rate.
- ``model.py``: the training step, and saving and loading weights.

``training.py`` is the command line of the training scripts.
"""
