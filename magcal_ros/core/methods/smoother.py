"""Calibration by the smoother (doc/smoother.md): of a window with a turn, and of a drive."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from magcal_ros.core.assessment.bounds import FULL_ARC_DEG
from magcal_ros.core.calibration.calibration import (
    Estimate,
    FittedGyroBias,
    GyroSwing,
    Installation,
)
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray, accumulated
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, body_from_enu, unit, usual_size
from magcal_ros.core.geometry.rotations import chained, rotation_vectors_near
from magcal_ros.core.knowledge import CLEAR, Knowledge
from magcal_ros.core.methods.checks import (
    SCREENING,
    check_arc,
    check_radius,
    check_window,
    refuse_empty,
    refuse_milliseconds,
)
from magcal_ros.core.samples.drive_log import log_of
from magcal_ros.core.samples.streams import SWAY
from magcal_ros.core.samples.units import likely_field_unit
from magcal_ros.core.samples.window import Window, working_axes
from magcal_ros.core.smoother.drives import check_length, drive_nodes
from magcal_ros.core.smoother.factors import distortion, motor_inputs, soft_iron
from magcal_ros.core.smoother.factors_of_motion import QUARTER, turned_by
from magcal_ros.core.smoother.fit import Fit
from magcal_ros.core.smoother.gyro_swing import gyro_compass_swing
from magcal_ros.core.smoother.joint import rows_of
from magcal_ros.core.smoother.kinds_of_motion import (
    DIFFERENT_TURNS,
    Smoothed,
    gyro_is_usual,
    smooth,
)
from magcal_ros.core.smoother.posterior import motors_of
from magcal_ros.core.smoother.turn_by_field import rival_gap, smooth_by_field
from magcal_ros.core.smoother.unknowns import (
    AT,
    BODY_FIELD,
    CURRENT_LATE,
    DRIVES,
    MICROTESLA,
    ON_THE_SPOT,
    ROLL_PITCH,
    SHIELDING,
    TURNED,
    VELOCITY,
    YAW,
)

METHOD, DRIVE_METHOD = "maximum_likelihood", "smoother"
"""Names of `fit` and of `fit_drive` in files and in the parameter `method`."""
FEWEST_SECTORS = 4  # sectors of heading, of twelve, that a drive has to reach
LARGEST_STREET = 12.0
"""µT of local disturbance and noise beyond which the axes of the sensors do not match."""
INLIER_WEIGHT = 0.3  # Student weight above which a node counts as an inlier
DRIVE_NEEDS_GYRO = (
    "a drive without a turn needs a gyro; turn the robot once instead, or connect a gyro"
)
LARGEST_GAIN_ERROR = 0.1  # of a sensor, relative; a body explains a larger loss of the level field


def fit(
    window: Window,
    knowledge: Knowledge = Knowledge(),
    progress: Callable[[float], object] | None = None,
) -> Estimate:
    """Return the estimate of a turn or a drive, with a gyro or (turns only) without one.

    `progress` is called with the fraction of the work that is done. Raises `Refusal` if the samples
    do not determine a calibration.
    """
    found = smoothed(window, knowledge, progress)
    estimate = estimate_of(found, window, knowledge)
    check(found, estimate, window, knowledge)
    return estimate


def fit_drive(window: Window, knowledge: Knowledge = Knowledge()) -> Estimate:
    """Return the estimate of a drive with a gyro, its samples averaged as in a drive's log.

    Raises `Refusal` if the drive does not determine a calibration.
    """
    refuse_empty(window)
    refuse_milliseconds(window.time)
    if window.angular_rate is None:
        raise Refusal(Reason.NO_SOLUTION, DRIVE_NEEDS_GYRO)
    return fit_log(log_of(window), knowledge, window)


def fit_log(log: Window, knowledge: Knowledge, window: Window | None = None) -> Estimate:
    """Return the estimate of a drive's log.

    The estimate's residuals are those of the rows of `window`, by default of the log. Raises
    `Refusal` if the drive does not determine a calibration.
    """
    check_length(drive_nodes(log, knowledge.mounting.to_body))
    window = log if window is None else window
    found = smooth(log, knowledge)
    estimate = estimate_of(found, window, knowledge)
    check(found, estimate, window, knowledge)
    figures = dict(estimate.figures)
    speed = found.nodes.speed
    if speed is not None:
        figures[Figure.METRES] = float(np.nansum(np.abs(speed[:-1]) * found.nodes.seconds))
    return replace(estimate, method=DRIVE_METHOD, figures=figures)


def smoothed(
    window: Window, knowledge: Knowledge, progress: Callable[[float], object] | None = None
) -> Smoothed:
    """Return the smoother's fit of a window, before `check`.

    Raises `Refusal` if the window is unusable (`check_window`), or if no fit is found.
    """
    check_window(window, knowledge)
    hint = likely_field_unit(usual_size(window.field))
    if hint:
        raise Refusal(Reason.NO_SOLUTION, hint)
    if working_axes(window.angular_rate)[2]:
        return smooth(window, knowledge, progress)
    return smooth_by_field(window, knowledge)


def check(found: Smoothed, estimate: Estimate, window: Window, knowledge: Knowledge) -> None:
    """Raise `Refusal` if a fit does not determine a calibration."""
    if found.nodes.tied_to is not None:
        _check_turn_without_gyro(found, estimate, knowledge)
        return
    if found.mode in DRIVES:
        _check_drive(found, estimate)
    elif not gyro_is_usual(found.fit):
        if knowledge.exact_sensors or window.imu_gap <= SWAY:
            raise Refusal(Reason.AXES_DISAGREE, DIFFERENT_TURNS)
        raise Refusal(
            Reason.TOO_SLOW,
            f"The samples of field and IMU come at {1.0 / window.imu_gap:.2g} Hz, too slowly to "
            "follow how the robot turned and swayed between them. Publish or record both at 10 Hz "
            "or more, or let the driver average its readings and turn more slowly.",
        )


def _check_drive(found: Smoothed, estimate: Estimate) -> None:
    """Refuse a drive with too few headings or a too large disturbance."""
    sizes = found.fit.point.sizes
    deviation = math.hypot(sizes["street"], sizes["field"])
    if deviation > LARGEST_STREET:
        raise Refusal(
            Reason.AXES_DISAGREE,
            f"along the drive the field deviates by {deviation:.0f} µT from what gyro and gravity "
            "predict; check that the axes of both sensors match, and drive away from iron",
        )
    sectors = estimate.figures[Figure.HEADINGS_DRIVEN]
    if sectors < FEWEST_SECTORS:
        raise Refusal(
            Reason.ARC_TOO_SHORT,
            f"the drive covered only {sectors:.0f} of 12 headings; drive longer, round a block",
        )


def _check_turn_without_gyro(found: Smoothed, estimate: Estimate, knowledge: Knowledge) -> None:
    """Refuse a turn without a gyro that does not determine the model."""
    sizes, state = found.fit.point.sizes, found.fit.state
    deviation = math.hypot(sizes["field"], sizes["body_field"], sizes["motors_noise"]) / MICROTESLA
    axes = np.einsum("nji,j->ni", state.attitude, estimate.axis)
    axis = unit(np.median(axes, axis=0))
    wobble = float(np.median(np.arccos(np.clip(axes @ axis, -1.0, 1.0))))
    across = float(np.linalg.norm(np.cross(axis, unit(state.earth))))
    share = deviation / estimate.strength
    causes = []
    if share > SCREENING.worst_field_noise:
        causes.append(f"the field deviates by {share:.0%} of its strength")
    if wobble > SCREENING.worst_wobble:
        causes.append(f"the turn's axis wobbles by {math.degrees(wobble):.0f} degrees")
    inliers = float(np.mean(estimate.inliers))
    if inliers < SCREENING.fewest_inliers:
        causes.append(f"only {inliers:.0%} of the samples fit")
    if causes:
        raise Refusal(
            Reason.FIELD_NOT_ON_A_PLANE,
            f"the field does not follow one turn of the robot ({', '.join(causes)}); turn about one"
            " axis, away from iron and running motors",
        )
    check_radius(across, estimate.inclination)
    check_arc(
        estimate.arc,
        solved_by_knowledge=knowledge.reference.is_complete,
        tolerance=SCREENING.arc_tolerance,
    )
    gap = rival_gap(found)
    if gap <= SCREENING.widest_rival:
        return
    remedy = "turn a full circle on level ground"
    if math.degrees(estimate.arc) >= FULL_ARC_DEG:
        remedy = "turn once more on other ground, more slowly, with the robot upright"
    raise Refusal(
        Reason.AMBIGUOUS,
        f"two calibrations explain this turn equally well and differ by"
        f" {math.degrees(gap):.0f} degrees of heading; {remedy}"
        f"{'' if knowledge.reference.is_complete else ', or give the reference field'}",
    )


def estimate_of(found: Smoothed, window: Window, knowledge: Knowledge) -> Estimate:
    """Return the estimate of a fit; residuals are those of the window's rows."""
    best, nodes = found.fit, found.nodes
    shared, posterior = best.state.shared, found.posterior
    part = best.weighted["field"]
    residual = part.linear.residual @ knowledge.mounting.matrix.T / MICROTESLA
    belongs = np.searchsorted(nodes.time, window.time).clip(0, len(nodes) - 1)
    up = best.state.attitude[:, :, 2]
    steps = np.median(np.abs(np.diff(window.field, axis=0))) / 0.954
    tilts = np.median(np.abs(np.diff(unit(window.specific_force), axis=0))) / 0.954
    roll, pitch = shared[ROLL_PITCH]
    figures = _figures(found)
    if not knowledge.reference.is_complete:
        figures.pop(Figure.RADIUS_RATIO, None)
    swing = _swing(found) if nodes.tied_to is None else None
    if swing is None:
        del figures[Figure.GYRO_CARRIED]
        figures[Figure.WOBBLE] = _wobble(best)
    else:
        figures[Figure.GYRO_COMPASS_SWING] = swing.rms
    return Estimate(
        method=METHOD,
        correction=posterior.correction,
        covariance=posterior.covariance,
        installation=Installation(float(roll), float(pitch), float(shared[YAW] + shared[TURNED])),
        axis=unit(up.mean(axis=0)) if nodes.tied_to is None else nodes.tied_to[:, 2],
        arc=_arc(found, window),
        strength=posterior.strength,
        inclination=posterior.inclination,
        noise_field=max(float(steps), 1e-9),
        noise_up=float(tilts),
        inliers=(part.weight * part.variance > INLIER_WEIGHT)[belongs],
        residual=residual[belongs],
        figures=figures,
        message=best.message,
        swing=swing,
        motors=motors_of(posterior, best),
        gyro=_gyro_bias(best, window),
    )


def _gyro_bias(best: Fit, window: Window) -> FittedGyroBias | None:
    """Return the gyro's error at the mean rate of a window, by bias, scale and misalignment.

    In an even turn their sum is known better than each of them, and it is the sum that makes up
    lean. None if a bias was subtracted from the window, or axes are missing.
    """
    if math.isfinite(window.bias_sigma) or not all(working_axes(window.angular_rate)):
        return None
    nodes, rows = best.model.nodes, rows_of(("gyro_bias", "gyro_matrix"))
    rate = nodes.angle.sum(axis=0) / nodes.seconds.sum()
    by = np.hstack([np.eye(3), np.kron(np.eye(3), rate)])
    covariance = by @ best.covariance[np.ix_(rows, rows)] @ by.T
    return FittedGyroBias(by @ best.state.shared[rows], covariance)


def _wobble(best: Fit) -> float:
    """Return the RMS tilt of the turn's axis in the body, radians per axis."""
    up = best.state.attitude[:, :, 2]
    across = np.cross(unit(up.mean(axis=0)), up)
    # On a slope the tilt is constant in world axes: its mean there is subtracted.
    world = np.einsum("nji,nj->ni", best.state.attitude, across)
    return math.sqrt(float(np.mean(np.sum((world - world.mean(axis=0)) ** 2, axis=1))) / 2.0)


def _swing(found: Smoothed) -> GyroSwing:
    """Return compass minus corrected gyro, the compass corrected by the fit."""
    best = found.fit
    shared = best.state.shared
    run = motor_inputs(best.point.course, shared)
    motors = sum(share * shared[AT[name]] for name, share in run.items())
    motors = motors + best.state.local[:, BODY_FIELD]
    back = np.linalg.inv(distortion(shared))
    return swing_of(found, (found.nodes.field - shared[AT["iron"]] - motors) @ back.T)


def swing_of(found: Smoothed, field: FloatArray) -> GyroSwing:
    """Return compass minus corrected gyro by sectors of heading, while the robot moves.

    `field` (n, 3) is the compass's field at the nodes, in body axes and in any unit.
    """
    best, nodes = found.fit, found.nodes
    attitude = body_from_enu(best.state.attitude[:, :, 2], field)
    moves = best.point.course.moving > 0.0
    relative = chained(turned_by(nodes, best.state.shared)[None])[0]
    return gyro_compass_swing(relative[moves], attitude[moves], nodes.time[moves])


def _arc(found: Smoothed, window: Window) -> float:
    """Return the range of the angle about the main axis of rotation, radians, at most 2 pi."""
    attitude, nodes = found.fit.state.attitude, found.nodes
    between = attitude[1:] @ np.swapaxes(attitude[:-1], 1, 2)
    steps = rotation_vectors_near(between, -nodes.angle)
    # The steps of a sway cancel; those of the turn add up.
    turned = accumulated(steps)
    main = np.linalg.svd(turned - turned.mean(axis=0), full_matrices=False)[2][0]
    angle = turned @ main
    # The first and the last samples lie half a node beyond the middles.
    pace = np.diff(angle) / nodes.seconds
    first = angle[0] - pace[0] * (nodes.time[0] - window.time[0])
    last = angle[-1] + pace[-1] * (window.time[-1] - nodes.time[-1])
    return min(float(np.ptp(np.concatenate([[first], angle, [last]]))), math.tau)


def _level_acceleration(best: Fit) -> float:
    """Return the mean level acceleration of a moving robot, in body axes, m/s²."""
    state, course = best.state, best.point.course
    rate = course.nodes.rate @ course.axes[:, 2]
    level = (rate * course.moving)[:, None] * state.local[:, VELOCITY] @ QUARTER.T
    mean = level.sum(axis=0) / max(float(course.moving.sum()), 1.0)
    return float(np.linalg.norm(mean + course.axes[:, :2].T @ state.shared[AT["force_moving"]]))


def _figures(found: Smoothed) -> dict[Figure, float]:
    best, course = found.fit, found.fit.point.course
    shared, sigma = best.state.shared, np.sqrt(np.diag(best.covariance))
    turning = float(np.median(found.nodes.rate[:, 2]))
    at_rate = np.zeros((3, len(shared)))
    at_rate[:, AT["motors_moving"]] = np.eye(3)
    at_rate[:, AT["motors_rate"]] = turning * np.eye(3)
    if found.nodes.currents is not None:
        beyond = found.nodes.currents.at(shared[CURRENT_LATE])
        usual = float(np.median(beyond[course.moving > 0.0]))
        at_rate[:, AT["motors_current"]] = usual * np.eye(3)
    size = float(np.linalg.norm(at_rate @ shared))
    doubt = math.sqrt(float(np.trace(at_rate @ best.covariance @ at_rate.T)))
    share = float(np.trace(soft_iron(shared)[:2, :2])) / 2.0
    weakened = 1.0 - share > max(LARGEST_GAIN_ERROR, CLEAR * sigma[SHIELDING])
    figures = {
        Figure.LEVEL_SHARE if weakened else Figure.RADIUS_RATIO: share,
        Figure.STEADY_ACCELERATION: _level_acceleration(best) / STANDARD_GRAVITY,
        Figure.POSSIBLE_ACCELERATION: found.by_acceleration,
        Figure.GYRO_CARRIED: float(gyro_is_usual(best)),
        Figure.NOT_CONVERGED: float(not best.is_settled),
        Figure.ITERATIONS: float(best.rounds),
        Figure.SOFT_IRON: float(best.model.priors.scale[AT["soft_iron"]].any()),
        Figure.IRON_DRIFT: _iron_drift(best) / MICROTESLA,
        Figure.ON_THE_SPOT: sum(
            share for name, share in found.weights.items() if name.startswith(ON_THE_SPOT)
        ),
    }
    if best.model.priors.scale[AT["latency"]].any():
        figures[Figure.LATENCY] = float(shared[AT["latency"]][0])
    if len(best.model.priors.rows_of_group["gyro_matrix"]) == 9:
        up = course.axes[:, 2]
        figures[Figure.GYRO_SCALE] = float(up @ shared[AT["gyro_matrix"]].reshape(3, 3) @ up)
    # The absence of a motors' field needs a rest.
    if size > CLEAR * doubt or course.still.any():
        figures[Figure.MOTOR_FIELD] = size / MICROTESLA if size > CLEAR * doubt else 0.0
    if found.mode in DRIVES:
        sectors = np.unique(best.state.sector[course.moving > 0.0])
        figures |= {
            Figure.HEADINGS_DRIVEN: float(len(sectors)),
            Figure.DRIVING_TIME: float(np.ptp(found.nodes.time)),
            Figure.STREET: best.point.sizes["street"] / MICROTESLA,
            Figure.LOCAL_FIELD: best.local_field / MICROTESLA,
        }
    return figures


def _iron_drift(best: Fit) -> float:
    """Return the drift of the hard iron over the window, µT; zero if it is no more than its sigma.

    Its prior is about zero. Without a drift, the estimate therefore stays well within its sigma.
    """
    drift, known = best.state.shared[AT["drift"]], best.covariance[AT["drift"], AT["drift"]]
    if not known.any() or drift @ np.linalg.solve(known, drift) < len(drift):
        return 0.0
    return float(np.linalg.norm(drift))
