"""The numbers on the page of a report: their names, their units, and how they are written."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from magcal_ros.core.assessment.bounds import DRIVE_BOUNDS, HEADING_BOUNDS, TURN_BOUNDS
from magcal_ros.core.calibration.calibration import Estimate
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import (
    CHECKED_TILT,
    calibration_sigma,
    common_figures,
)
from magcal_ros.core.knowledge import Belief, Knowledge

DEGREES = 180.0 / math.pi
MICRO = 1e6


class Row(NamedTuple):
    """One line of a table: what it is, and its value with its unit."""

    words: str
    value: str


class Unit(NamedTuple):
    """How a figure is shown: its words, the factor from SI, and the unit."""

    words: str
    scale: float = 1.0
    unit: str = ""


FIGURES: dict[Figure, Unit] = {
    b.figure: Unit(b.words.removesuffix(":").removesuffix(" by"), b.scale, b.unit)
    for b in (*HEADING_BOUNDS, *DRIVE_BOUNDS, *TURN_BOUNDS)
} | {
    Figure.HEADING_SIGMA_TILTED: Unit("predicted heading error at 10° of tilt (1σ)", DEGREES, "°"),
    Figure.LOCAL_SIGMA: Unit("heading error by local magnetic disturbances (1σ)", DEGREES, "°"),
    Figure.DRIVING_TIME: Unit("length of the drive", 1.0, " s"),
    Figure.METRES: Unit("way that was driven", 1.0, " m"),
    Figure.STREET: Unit("disturbance that changes with the place (1σ per axis)", MICRO, " µT"),
    Figure.LOCAL_FIELD: Unit("all disturbance along the drive (1σ per axis)", MICRO, " µT"),
    Figure.AXIAL_IRON: Unit(
        "hard iron along the turn's axis, by the reference field", MICRO, " µT"
    ),
    Figure.STEADY_ACCELERATION: Unit("tilt by a steady acceleration, taken off", DEGREES, "°"),
    Figure.POSSIBLE_ACCELERATION: Unit(
        "heading error by an acceleration that nothing shows (1σ)", DEGREES, "°"
    ),
    Figure.CIRCLE_RADIUS: Unit("radius of the field's circle", MICRO, " µT"),
    Figure.RADIUS_RATIO: Unit("circle radius over the reference's"),
    Figure.ELLIPSE_RATIO: Unit("ellipse in the turn's plane, longer axis over shorter"),
    Figure.AXIS_TILT: Unit("turn's axis off the vertical", DEGREES, "°"),
    Figure.AXIAL_FIELD: Unit("field along the turn's axis, positive downwards", MICRO, " µT"),
    Figure.AXIAL_HARD_IRON: Unit(
        "hard iron along the turn's axis, positive downwards", MICRO, " µT"
    ),
    Figure.ACCELEROMETER_SPREAD: Unit("accelerometer's spread over six times its noise"),
    Figure.FIELD_SPREAD: Unit("field's spread over six times its noise"),
    Figure.RIVAL_ROLL: Unit("second solution, installation roll", DEGREES, "°"),
    Figure.RIVAL_PITCH: Unit("second solution, installation pitch", DEGREES, "°"),
    Figure.RIVAL_ANGLE: Unit("second solution, installation angle", DEGREES, "°"),
    Figure.WOBBLE: Unit("wobble of the turn's axis (1σ per axis)", DEGREES, "°"),
    Figure.SOFT_IRON: Unit("soft iron was fitted (1 yes, 0 no)"),
    Figure.GYRO_CARRIED: Unit("the turn that the gyro measured explains the samples (1 yes, 0 no)"),
    Figure.NOT_CONVERGED: Unit("the optimisation ended before it had converged (1 yes, 0 no)"),
    Figure.ITERATIONS: Unit("steps of the optimisation"),
    Figure.ON_THE_SPOT: Unit("probability that the robot turned on the spot"),
    Figure.TURNS: Unit("turns that were joined"),
    Figure.TURN_MISFIT: Unit("worst turn off the others, as many times as noise explains"),
}
for _sensor, _scale, _unit in (("accelerometer", 1.0, " g"), ("field", MICRO, " µT")):
    for _axis in "xyz":
        FIGURES[Figure(f"{_sensor}_range_{_axis}")] = Unit(
            f"{_sensor}'s range along {_axis}, de-rotated", _scale, _unit
        )


def key_numbers(estimate: Estimate, samples: int) -> list[Row]:
    """Return what a user wants to know first."""
    figures = common_figures(estimate) | dict(estimate.figures)
    sigma = np.sqrt(np.maximum(np.diag(estimate.covariance)[9:], 0.0))
    iron, sigma = estimate.correction.hard_iron * MICRO, sigma * MICRO
    level, tilted = figures[Figure.HEADING_SIGMA], figures[Figure.HEADING_SIGMA_TILTED]
    where = (" on the level (1σ)", " at 10° of tilt (1σ)")
    said = [("heading error", level, tilted)]
    if Figure.LOCAL_SIGMA in figures:
        own, own_tilted = (calibration_sigma(estimate, tilt) for tilt in (0.0, CHECKED_TILT))
        said = [
            ("heading error by the calibration,", own, own_tilted),
            ("heading error along the way,", level, tilted),
        ]
    rows = [
        Row(words + place, f"±{sigma * DEGREES:.2f}°")
        for words, *sigmas in said
        for place, sigma in zip(where, sigmas, strict=True)
    ]
    rows += [
        Row(f"hard iron {name} (±1σ)", f"{value:.2f} ± {spread:.2f} µT")
        for name, value, spread in zip("xyz", iron, sigma, strict=True)
    ]
    if estimate.installation is not None:
        rows.append(Row("installation roll", f"{estimate.installation.roll * DEGREES:.2f}°"))
        rows.append(Row("installation pitch", f"{estimate.installation.pitch * DEGREES:.2f}°"))
    if Figure.INSTALLATION_YAW_SIGMA in figures and estimate.installation is not None:
        yaw, off = estimate.installation.yaw, figures[Figure.INSTALLATION_YAW_SIGMA]
        words = f"{yaw * DEGREES:.2f} ± {off * DEGREES:.2f}°"
        rows.append(Row("installation yaw (±1σ)", words))
    inliers = int(np.count_nonzero(estimate.inliers))
    driven = figures.get(Figure.HEADINGS_DRIVEN)
    seen = Row("turn seen", f"{estimate.arc * DEGREES:.0f}°")
    return [
        *rows,
        seen if driven is None else Row("headings driven", f"{driven:.0f} of 12"),
        Row("samples used (repeats and rests not counted)", f"{inliers} of {samples}"),
        Row("strength of the corrected field", f"{estimate.strength * MICRO:.2f} µT"),
        Row("its inclination, positive downwards", f"{estimate.inclination * DEGREES:.2f}°"),
    ]


def all_numbers(estimate: Estimate) -> list[Row]:
    """Return everything else that was measured."""
    axis = ", ".join(f"{value:.4f}" for value in estimate.axis)
    rows = [
        Row("turn's axis in body axes", f"({axis})"),
        Row("noise of one field sample (1σ)", f"{estimate.noise_field * MICRO:.3g} µT"),
        Row("noise of one tilt (1σ)", f"{estimate.noise_up * DEGREES:.3g}°"),
    ]
    figures = (common_figures(estimate) | dict(estimate.figures)).items()
    return rows + [figure_row(name, value) for name, value in figures]


def figure_row(name: Figure, value: float) -> Row:
    """Name one figure; a name that is not known is shown as it is, in SI."""
    if (unit := FIGURES.get(name)) is None:
        return Row(str(name).replace("_", " "), f"{value:.6g} (SI)")
    return Row(unit.words, f"{value * unit.scale:.4g}{unit.unit}")


def matrix_rows(estimate: Estimate) -> list[list[str]]:
    """Return the twelve numbers with their sigmas: three of A and one of h per line."""
    sigma = np.sqrt(np.maximum(np.diag(estimate.covariance), 0.0))
    a, h = estimate.correction.matrix, estimate.correction.hard_iron * MICRO
    spread, iron = sigma[:9].reshape(3, 3), sigma[9:] * MICRO
    return [
        [
            "xyz"[i],
            *(f"{a[i, j]:.6f} ± {spread[i, j]:.6f}" for j in range(3)),
            f"{h[i]:.4f} ± {iron[i]:.4f}",
        ]
        for i in range(3)
    ]


def known_before(knowledge: Knowledge) -> list[Row]:
    """Return what was known beforehand."""
    reference, mounting, iron = knowledge.reference, knowledge.mounting, knowledge.soft_iron
    pose = "; ".join(" ".join(f"{value:.4g}" for value in row) for row in mounting.pose)
    spread = f"±{iron.sigma_diagonal * 100:g}% on, ±{iron.sigma_cross * 100:g}% off the diagonal"
    return [
        Row("reference strength", _belief(reference.strength, MICRO, " µT")),
        Row("reference inclination", _belief(reference.inclination, DEGREES, "°")),
        Row("declination, positive east", _belief(reference.declination_belief, DEGREES, "°")),
        Row("known soft-iron gains x, y, z", ", ".join(f"{gain:g}" for gain in mounting.gains)),
        Row("nominal mounting, rows of the pose", pose),
        Row("soft iron beyond the gains (1σ)", spread),
    ]


def _belief(belief: Belief, scale: float, unit: str) -> str:
    if belief.is_unknown:
        return "not known"
    value = f"{belief.value * scale:.2f}"
    return f"{value}{unit}" if belief.is_exact else f"{value} ± {belief.sigma * scale:.2f}{unit}"
