"""The ellipsoid through a tumbled sensor's samples, by least squares.

Centre v, radii and axes of the ellipsoid give the correction S (x - v) to a sphere. S is symmetric:
it scales along the axes and does not rotate, because the field alone does not determine the
rotation of the magnetometer against the IMU.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.calibration import Estimate
from magcal_ros.core.calibration.figure import Figure, along
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.shapes import Ellipsoid, QuadricFit, fit_quadric
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.methods_tuning import CLOUD, ELLIPSOID
from magcal_ros.core.methods.tumbling import Shape, finish, on_unit_sphere
from magcal_ros.core.samples.window import Window


@dataclass(frozen=True)
class Options:
    """Choices of the ellipsoid method; ValueError for another shape."""

    shape: QuadricFit = QuadricFit.ROTATED
    """"rotated" for any ellipsoid, "aligned" for one along the axes, "sphere" for no soft iron."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", QuadricFit(self.shape))


def fit(
    window: Window, knowledge: Knowledge = Knowledge(), *, options: Options = Options()
) -> Estimate:
    """Calibrate by the ellipsoid through the samples.

    The sensor must be tumbled through most orientations. Without a known strength the correction
    keeps the geometric mean of the radii. Figures are in nominal body axes. The covariance comes
    from a jackknife over pieces of time, and from the mounting as far as gravity shows it. Raises
    `Refusal` if the samples do not determine a solution.
    """
    remedy = "Tumble again away from iron and moving loads."
    return finish(
        lambda nominal: solve(nominal, options),
        window,
        knowledge,
        method="ellipsoid",
        least_extent=ELLIPSOID.least_extent,
        remedy=remedy,
    )


def solve(nominal: FloatArray, options: Options) -> Shape:
    """Fit the ellipsoid without outliers. Raises `Refusal` if there is none of a possible shape."""
    ellipsoid = fit_quadric(nominal, options.shape)
    kept = np.ones(len(nominal), dtype=np.bool_)
    for _ in range(CLOUD.rounds):
        points = (nominal - ellipsoid.centre) @ ellipsoid.to_unit_sphere
        accepted = on_unit_sphere(np.linalg.norm(points, axis=1))
        if (accepted == kept).all() or accepted.mean() < 0.5:
            break
        kept = accepted
        ellipsoid = fit_quadric(nominal[kept], options.shape)
    if ellipsoid.ratio > ELLIPSOID.largest_ratio:
        raise Refusal(
            Reason.NO_SOLUTION,
            f"The longest radius of the ellipsoid is {ellipsoid.ratio:.1f} times the shortest: too "
            "little of it was seen, or iron touches the sensor. Tumble the sensor through all "
            "orientations, and move it away from iron.",
        )
    return Shape(ellipsoid.centre, ellipsoid.to_unit_sphere, ellipsoid.radius, _figures(ellipsoid))


def _figures(ellipsoid: Ellipsoid) -> dict[Figure, float]:
    figures = along("centre", ellipsoid.centre)
    for k in range(3):
        figures[Figure(f"radius_{k + 1}")] = float(ellipsoid.radii[k])
        figures |= along(f"axis_{k + 1}", ellipsoid.axes[:, k])
    figures[Figure.RADII_RATIO] = ellipsoid.ratio
    return figures
