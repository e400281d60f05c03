"""The design tip's reliability figures and what else the turn measured."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.conics import fit_ellipse_halir_flusser
from magcal_ros.core.errors import Refusal
from magcal_ros.core.methods.design_tip.axis import LEAST_NOISE, TurnAxis
from magcal_ros.core.methods.design_tip.circle import derotation
from magcal_ros.core.methods.design_tip.door import TipSamples
from magcal_ros.core.methods.design_tip.installation import Candidate
from magcal_ros.core.methods.design_tip.reference import BelievedField

TIP_NOISE_MULTIPLE = 6.0
"""The tip calls a cloud a cluster when its mean distance is below this many times the noise."""


def measure_figures(
    samples: TipSamples,
    axis: TurnAxis,
    chosen: Candidate,
    rival: Candidate | None,
    believed: BelievedField,
    noise_field: float,
) -> dict[str, float]:
    """Collect the figures by name.

    Parameters
    ----------
    samples, axis, chosen, rival, believed
        What the steps found.
    noise_field : float
        Tesla per axis.

    Returns
    -------
    dict of str to float
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
    circle = chosen.circle
    figures = {
        "accelerometer_spread_over_noise": _spread(samples.down, axis.noise, LEAST_NOISE),
        "field_spread_over_noise": _spread(
            samples.field, noise_field, LEAST_NOISE * believed.strength
        ),
        "circle_radius": circle.radius,
        "axis_tilt": axis.tilt,
        "axial_field": believed.axial,
        "axial_hard_iron": circle.height - believed.axial,
        "installation_angle": chosen.angle,
    }
    figures |= _ranges("accelerometer", samples.down @ derotation(axis.direction))
    figures |= _ranges("field", samples.field @ circle.basis)
    expected = believed.strength**2 - believed.axial**2
    if expected > 0.0:
        figures["radius_ratio"] = circle.radius / math.sqrt(expected)
    try:
        flat = np.column_stack([circle.phasor.real, circle.phasor.imag])
        figures["ellipse_ratio"] = fit_ellipse_halir_flusser(flat).ratio
    except Refusal:
        pass
    if rival is not None:
        figures |= {
            "rival_roll": rival.roll,
            "rival_pitch": -rival.pitch,
            "rival_angle": rival.angle,
        }
    return figures


def _spread(cloud: FloatArray, noise: float, least_noise: float) -> float:
    distance = np.linalg.norm(cloud - cloud.mean(axis=0), axis=1).mean()
    return float(distance / (TIP_NOISE_MULTIPLE * max(noise, least_noise)))


def _ranges(sensor: str, derotated: FloatArray) -> dict[str, float]:
    sizes = np.ptp(derotated, axis=0)
    return {f"{sensor}_range_{name}": float(v) for name, v in zip("xyz", sizes, strict=True)}
