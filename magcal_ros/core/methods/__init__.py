"""The methods that estimate a correction from a window, all with one signature.

A method is a function `fit(window, knowledge) -> Estimate` that raises `Refusal` if the samples do
not determine a calibration.
"""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    known_headings: declination_hint
    min_max: samples_on_ellipsoid
    resampling: jackknife_covariance
    tumbling: estimate_mounting
    """,
)
