"""The design tip's solution, its reliability figures and what else the turn measured."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.calibration.estimate import Installation
from magcal_ros.core.calibration.figure import Figure, along
from magcal_ros.core.errors import Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.conics import ConicFit
from magcal_ros.core.methods.design_tip.axial_field import BelievedField
from magcal_ros.core.methods.design_tip.axis import TurnAxis
from magcal_ros.core.methods.design_tip.circle import FieldCircle, derotation
from magcal_ros.core.methods.design_tip.installation import Candidate
from magcal_ros.core.methods.design_tip.tip_frame import ROUNDING, TipSamples

TIP_NOISE_MULTIPLE = 6.0
"""The tip calls a cloud a cluster when its mean distance is below this many times the noise."""


@dataclass(frozen=True, eq=False)
class TipSolution:
    """The steps' results before their uncertainty is known."""

    samples: TipSamples
    circle: FieldCircle
    axis: TurnAxis
    chosen: Candidate
    rival: Candidate | None
    believed: BelievedField
    correction: Correction
    installation: Installation


def measure_figures(solution: TipSolution, noise_field: float) -> dict[Figure, float]:
    """Collect the figures by name.

    Parameters
    ----------
    solution : TipSolution
        What the steps found.
    noise_field : float
        Tesla per axis.

    Returns
    -------
    dict of Figure to float
        `accelerometer_spread_over_noise`, `field_spread_over_noise`: mean distance from the
        cloud's centre over six times the noise, the tip's measure of a plane's reliability.
        `accelerometer_range_x`, `_y`, `_z` (m/s² over gravity) and `field_range_x`, `_y`, `_z`
        (tesla): ranges after de-rotation; z should be the smallest by far.
        `circle_radius` (tesla); `radius_ratio`: over the radius that strength and axis demand;
        `ellipse_ratio`: of a free ellipse, where there is one.
        `axis_tilt` (rad); `axial_field`, `axial_hard_iron` (tesla).
        `installation_angle` and, where the turn has a second solution, `rival_roll`,
        `rival_pitch`, `rival_angle` (rad, URDF sense).
    """
    samples, axis, chosen = solution.samples, solution.axis, solution.chosen
    rival, believed, circle = solution.rival, solution.believed, chosen.circle
    figures = {
        Figure.ACCELEROMETER_SPREAD: _spread(samples.down, axis.noise, ROUNDING),
        Figure.FIELD_SPREAD: _spread(samples.field, noise_field, ROUNDING * believed.strength),
        Figure.CIRCLE_RADIUS: circle.radius,
        Figure.AXIS_TILT: axis.tilt,
        Figure.AXIAL_FIELD: believed.axial,
        Figure.AXIAL_HARD_IRON: circle.height - believed.axial,
        Figure.INSTALLATION_ANGLE: chosen.angle,
    }
    down = samples.down @ derotation(axis.direction)
    figures |= along("accelerometer_range", np.ptp(down, axis=0))
    figures |= along("field_range", np.ptp(samples.field @ circle.basis, axis=0))
    expected = believed.strength**2 - believed.axial**2
    if expected > 0.0:
        figures[Figure.RADIUS_RATIO] = circle.radius / math.sqrt(expected)
    try:
        flat = np.column_stack([circle.phasor.real, circle.phasor.imag])
        figures[Figure.ELLIPSE_RATIO] = ConicFit.HALIR_FLUSSER(flat).ratio
    except Refusal:
        pass
    if rival is not None:
        figures |= {
            Figure.RIVAL_ROLL: rival.roll,
            Figure.RIVAL_PITCH: -rival.pitch,
            Figure.RIVAL_ANGLE: rival.angle,
        }
    return figures


def _spread(cloud: FloatArray, noise: float, least_noise: float) -> float:
    distance = np.linalg.norm(cloud - cloud.mean(axis=0), axis=1).mean()
    return float(distance / (TIP_NOISE_MULTIPLE * max(noise, least_noise)))
