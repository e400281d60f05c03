"""The estimator: one smoother in which every error is an unknown with a prior.

doc/smoother.md states the model. `smooth` (kinds_of_motion.py) fits a window; `posterior.py` turns
the result into the twelve numbers with their covariance.
"""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    currents: Clock Currents
    drives: LikelihoodRatio corrected drive_nodes fit_drive fit_iron likelihood_ratio_of
    earth: EarthFieldPrior GaussianEarthPrior
    factors: Residuals
    fit: Damping Fit
    gyro_swing: gyro_compass_swing
    headings: KnownHeadingMeasurement fit_headings
    iron_added: find_change
    joint_fit: JointFit fit_jointly imagined_information
    kinds_of_motion: part_with_most_motion smooth
    nodes: nodes_of
    places: Places
    priors: priors_of
    state: Course State
    turn_by_field: smooth_by_field
    unknowns: ACCELERATION ALIKE AT ATTITUDE CURRENT_LATE DRIVES LOCAL Lengths MICROTESLA MODULE
        RATE SHARED SIZES SMALL_CIRCLE STREET TURNED UNKNOWNS VELOCITY
    """,
)
