"""Models to call: those with pretrained weights, and what they share.

They have options, checks and a command line. To read a model from top to bottom, take
``path_predictor.py`` or ``lego_sampler.py`` of the folder around this one.

- ``path_predictor.py``: `PathPredictor`, which predicts the moves of shortest paths.
- ``cost_predictor.py``: `CostPredictor`, which reads the costs of terrain from images.
- ``lego/``: samplers that learn where a roadmap needs its vertices.
- ``learned_planners.py``: the planners of a model, as rows of a table, and their validation.
- ``layers.py``: the layers of the networks.
- ``geometry.py``: distances, heuristics and legal moves on tensors of maps.
- ``symmetries.py``: the eight symmetries of a square map.
- ``optimizer.py``: Muon, and the schedule of its learning rate.
- ``model.py``: the training step, and saving and loading weights.
- ``mixed_batches.py``: batches of several families in one training step.
- ``command_line.py``: what the commands ``train`` and ``evaluate`` share.
- ``configs/``: the arguments of the trainings; ``weights/``: what they gave.
"""
