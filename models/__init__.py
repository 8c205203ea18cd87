"""Sample models to read: path_predictor.py, neural_astar.py and lego_sampler.py, upon common.py.

Around them: learned_planners.py plans with predictions, cvae.py has more samplers, experience.py
their targets, roadmap.py and sampler_table.py what samples are for, training.py what the scripts
share.
"""
