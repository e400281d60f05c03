"""The estimator: one smoother in which every error is an unknown with a prior.

doc/smoother.md states the model. `smooth` (kinds_of_motion.py) fits a window; `posterior.py` turns
the result into the twelve numbers with their covariance.
"""
