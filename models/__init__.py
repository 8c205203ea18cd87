"""Sample models to read: path_predictor.py and lego_sampler.py; each needs common.py alone.

Around them: learned_planners.py follows predictions, cvae.py has more samplers, experience.py their
targets, roadmap.py and sampler_table.py what samples are for, training.py what the scripts share.
"""
