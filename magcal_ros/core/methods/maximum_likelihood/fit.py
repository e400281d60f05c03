"""From a window to an estimate, in steps that the other files contain."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.calibration.estimate import Estimate, GyroSwing
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.estimation.averaging import Prepared, prepare
from magcal_ros.core.estimation.block import TurnBlock
from magcal_ros.core.estimation.effect_choice import gyro_block
from magcal_ros.core.estimation.effects import Effect
from magcal_ros.core.estimation.free_attitude import FreeBlock
from magcal_ros.core.estimation.gyro_attitude import GyroBlock
from magcal_ros.core.estimation.gyro_path import GyroPath, gyro_path, sense_of_mounting
from magcal_ros.core.estimation.heading_gap import unexplained_gap
from magcal_ros.core.estimation.initial import starts
from magcal_ros.core.estimation.motor_field import motor_field
from magcal_ros.core.estimation.multi_start import search
from magcal_ros.core.estimation.possible_pull import (
    doubtful_pull,
    jolts_without_gyro,
    leaning,
    lever_arm_left,
    pull_without_gyro,
)
from magcal_ros.core.estimation.prior import prior_from
from magcal_ros.core.estimation.seating import attitudes_from_vectors
from magcal_ros.core.estimation.selection import (
    PROPAGATION,
    Choice,
    explains_as_well,
    free_attitudes,
    look_at,
    propagated_attitudes,
)
from magcal_ros.core.estimation.soft_iron_doubt import Look
from magcal_ros.core.estimation.solver import Fit
from magcal_ros.core.estimation.systematic_errors import Lasting, Turning, systematic_covariance
from magcal_ros.core.estimation.uncertainty import twelve_covariance
from magcal_ros.core.estimation.weighting import Weights
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.knowledge import Knowledge, SoftIron, Systematics
from magcal_ros.core.methods.checks import check_window
from magcal_ros.core.methods.maximum_likelihood.diagnostics import measure_figures
from magcal_ros.core.methods.maximum_likelihood.report import EstimateParts, build_estimate
from magcal_ros.core.methods.maximum_likelihood.screening import (
    check_gyro,
    check_solution,
    seen_arc,
)
from magcal_ros.core.methods.maximum_likelihood.weakened import level_share, weakened
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoother.gyro_swing import gyro_compass_swing, lasting_stray

COMPASS_SHARE = 0.5
"""Share of the compass in its squared deviation from the gyro, which has errors as well."""
RADIAL_SHARE = 2.0
"""Squared deviation across the radius over the one along it: the field of a place that is bent goes
once round as well, which nothing along the radius shows."""
GAP_SHARE = 0.25
"""Of the squared heading between the gyro's fit and that without, what the gyro's is usually off:
most often it is the other that is."""


@dataclass(frozen=True)
class Options:
    """How the fit works; the defaults are meant to be left alone."""

    largest: int = 800
    """Neighbouring samples are averaged until no more than this number remain."""


def fit(
    window: Window, knowledge: Knowledge = Knowledge(), options: Options = Options()
) -> Estimate:
    """Find installation error and hard iron from one turn by maximum likelihood.

    Parameters
    ----------
    window : Window
        Paired samples of the turn.
    knowledge : Knowledge
        Reference field, mounting and soft iron, each known, uncertain or unknown.
    options : Options

    Returns
    -------
    Estimate
        Its `figures` are explained in `Figure`.

    Raises
    ------
    Refusal
        If the samples cannot carry a calibration; the message says what to do next.
    """
    share = level_share(window, knowledge)
    inside = weakened(knowledge, share)
    if inside is None:
        return conclude(solve(window, knowledge, options), knowledge)
    try:
        estimate = conclude(solve(window, inside, options), inside)
    except Refusal as refusal:
        raise Refusal(
            Reason.CIRCLE_TOO_SMALL,
            f"the circle's radius is {share:.0%} of the reference field's, and what is left does"
            " not follow the turn; mount the sensor away from steel, or check the reference field",
        ) from refusal
    figures = {**estimate.figures, Figure.LEVEL_SHARE: share}
    figures.pop(Figure.RADIUS_RATIO, None)
    return replace(estimate, figures=figures)


def solve(
    window: Window, knowledge: Knowledge = Knowledge(), options: Options = Options()
) -> Solved:
    """Find the optimum of one turn, before it is asked whether the turn can carry it.

    Raises
    ------
    Refusal
        If there is nothing to be found in the samples.
    """
    check_window(window, knowledge)
    prepared = prepare(window.field, window.specific_force, knowledge, options.largest)
    return _solve(window, prepared, knowledge)


@dataclass(frozen=True, eq=False)
class Solved:
    """What the fit came to, before it is judged."""

    prepared: Prepared
    choice: Choice
    """The optimum of the model that the samples ask for."""
    rival_gap: float
    """Radians of heading to a rival that explains the samples as well."""
    window: Window
    """The samples."""
    swing: GyroSwing | None = None
    """Of gyro and compass; None without a gyro."""
    gyro_gap: float = 0.0
    """Radians of heading that another explanation, or the fit without the gyro, leaves in doubt."""
    motors: FloatArray | None = None
    """Field of the motors (`motor_field`), tesla; None where no rest tells. Shape (m, 3)."""
    pull: float = 0.0
    """Radians by which the mean specific force leans from the gyro's up."""
    doubtful_pull: float = 0.0
    """Radians of it that may be there in the turn and not at rest, one sigma."""
    lever_arm: float = math.inf
    """Metres of it that the gyro leaves possible, one sigma."""
    explained: bool = False
    """Whether the gyro's turning explains the samples, even where it is not followed."""

    @property
    def turning(self) -> Turning:
        """How fast the robot turned."""
        return _turning(self.window, self.prepared, self.choice.fit.block)

    def seen(self, systematics: Systematics) -> Lasting:
        """Return what the residuals show of lasting errors; nothing where none are believed."""
        if systematics.are_none:
            return Lasting()
        if self.swing is None:
            deviation = math.sqrt(RADIAL_SHARE) * _radial_deviation(self.choice.fit.block)
        else:
            deviation = math.sqrt(COMPASS_SHARE) * self.swing.rms
        return Lasting(deviation, self.gyro_gap, self.motors, self.doubtful_pull)

    def unseen(self, systematics: Systematics) -> Systematics:
        """Return what stays unseen of lasting errors: what was fitted is in the covariance."""
        block = self.choice.fit.block
        fitted = block.path.effects if isinstance(block, GyroBlock) else ()
        known = Effect.LEVER_ARM in fitted or Effect.PULL in fitted
        return replace(
            systematics,
            lever_arm=0.0 if known else min(systematics.lever_arm, self.lever_arm),
            latency=0.0 if Effect.LATENCY in fitted else systematics.latency,
        )

    @property
    def figures(self) -> dict[Figure, float]:
        """What the search and the gyro show, by name."""
        figures = {
            Figure.RIVAL_GAP: self.rival_gap,
            Figure.SOFT_IRON_GAIN: self.choice.soft_iron_gain,
        }
        if self.motors is not None:
            figures[Figure.MOTOR_FIELD] = float(np.linalg.norm(self.motors))
        block = self.choice.fit.block
        acceleration, dip = np.zeros(3), block.place.state.shared.inclination
        figures[Figure.POSSIBLE_PULL] = self.doubtful_pull * abs(math.tan(dip))
        if self.swing is None:
            return figures
        if isinstance(block, GyroBlock):
            acceleration = block.acceleration
            if Effect.LATENCY in block.path.effects:
                figures[Figure.LATENCY] = float(block.path.found(block.errors, Effect.LATENCY)[0])
        return figures | {
            Figure.GYRO_CARRIED: float(self.explained),
            Figure.GYRO_COMPASS_SWING: self.swing.rms,
            Figure.GYRO_GAP: self.gyro_gap,
            Figure.STEADY_PULL: float(np.linalg.norm(acceleration)),
            Figure.SIDEWAYS_PULL: self.pull,
        }


def conclude(solved: Solved, knowledge: Knowledge) -> Estimate:
    """Check an optimum and bring it into the package's own form.

    Raises
    ------
    Refusal
        If the turn cannot carry a calibration.
    """
    fit, scale = solved.choice.fit, solved.prepared.scale
    arc = seen_arc(fit.block)
    swing = solved.swing
    if swing is not None:
        check_gyro(swing.rms)
    check_solution(fit.block, knowledge, arc, solved.rival_gap, gyro=swing is not None)
    axes = _axes_a_little_off(fit, knowledge, scale)
    covariance = twelve_covariance(fit, scale, solved.choice.doubt, axes)
    covariance += systematic_covariance(
        fit.shared,
        fit.mounting,
        scale,
        solved.unseen(knowledge.systematics),
        solved.turning,
        solved.seen(knowledge.systematics),
    )
    figures = measure_figures(fit, covariance, knowledge, scale, arc) | solved.figures
    axis = fit.shared.body_axis[:, 2]
    return build_estimate(
        fit, EstimateParts(solved.prepared, covariance, axis, arc, figures, swing)
    )


def _axes_a_little_off(fit: Fit, knowledge: Knowledge, scale: float) -> Look | None:
    """Return what small faults of the magnetometer's axes would bring; None if they were fitted."""
    iron, most = knowledge.soft_iron, knowledge.systematics.gains
    small = SoftIron(min(iron.sigma_diagonal, most), min(iron.sigma_cross, most))
    if fit.prior.has_soft_iron or small == SoftIron.none():
        return None
    return look_at(fit, prior_from(replace(knowledge, soft_iron=small), scale, soft_iron=True))


def _solve(window: Window, prepared: Prepared, knowledge: Knowledge) -> Solved:
    samples, scale = prepared.averaged, prepared.scale
    without_iron = prior_from(knowledge, scale, soft_iron=False)
    with_iron = prior_from(knowledge, scale, soft_iron=True)
    path = None if window.angular_rate is None else gyro_path(window, prepared.first)
    sense = 1.0 if path is None else sense_of_mounting(samples, path)
    found = search(starts(samples, knowledge.reference, scale, sense), samples, without_iron)
    thin = found.best.block.weighting
    weighting = replace(thin, weights=Weights.ones(len(samples)))
    begun = FreeBlock.seated_at(found.best.shared, samples, weighting)
    start, always = found.best.with_blocks([begun]), knowledge.soft_iron.always
    if path is None:
        free = free_attitudes(start, with_iron, always=always)
        motors = motor_field(free.fit, None, scale, window.rests)
        jolted = jolts_without_gyro(free.fit.block, float(np.ptp(window.time)))
        turning = _turning(window, prepared, free.fit.block).rms
        doubtful = pull_without_gyro(jolted, turning)
        return Solved(
            prepared, free, found.rival_gap, window, motors=motors, doubtful_pull=doubtful
        )
    choice = propagated_attitudes(start, path, with_iron, always=always)
    gap, lean = choice.gap, leaning(samples, path)
    block, lever_arm = gyro_block(choice.fit), knowledge.systematics.lever_arm
    turning = _turning(window, prepared, block).rms
    doubtful = doubtful_pull(lean.at_most, turning, lever_arm) if choice.may_be_pulled else 0.0
    # What follows the turn rate is off with the gyro and without, or they would differ by it.
    seated = FreeBlock.seated_at(found.best.shared, block.place.samples, weighting)
    freed = start.with_blocks([seated])
    if choice.own_lean:
        choice = replace(free_attitudes(freed, with_iron, always=always), own_lean=True)
    elif not explains_as_well(choice.fit, found.best):
        choice = free_attitudes(start, with_iron, always=always)
    elif Effect.PULL not in block.path.effects and not knowledge.systematics.are_none:
        free = free_attitudes(freed, with_iron, always=always)
        apart = unexplained_gap(choice.fit, free.fit)
        # What soft iron explains only without the gyro, the gyro's own walk had hidden.
        if not explains_as_well(choice.fit, free.fit, PROPAGATION.settled_lenience):
            choice, gap = free, 0.0
        elif PROPAGATION.contradicts(block, apart):
            # A gyro that is known to be bad is not used to correct the accelerometer.
            path, choice = replace(block.path, relative=block.unbiased), free
        else:
            gap = max(gap, math.sqrt(GAP_SHARE) * apart)
    carried = isinstance(choice.fit.block, GyroBlock)
    explained = carried or path.is_doubted or choice.own_lean
    swing = _swing(choice, path, window.time[prepared.first])
    motors = motor_field(choice.fit, path, scale)
    return Solved(
        prepared,
        choice,
        found.rival_gap,
        window,
        swing,
        gyro_gap=gap,
        motors=motors,
        pull=lean.apart,
        doubtful_pull=doubtful,
        lever_arm=lever_arm_left(lean.apart, turning, lever_arm, path.known.bias),
        explained=explained,
    )


def _turning(window: Window, prepared: Prepared, block: TurnBlock) -> Turning:
    if window.angular_rate is not None:
        return Turning.by_gyro(window.angular_rate)
    counted = block.weighting.inliers
    time = window.time[prepared.first][counted]
    return Turning.by_attitude(time, block.place.state.attitude[counted])


def _radial_deviation(block: TurnBlock) -> float:
    """Return the lasting deviation of the field along the turn's radius, radians; inliers alone."""
    prediction, counted = block.place.prediction, block.weighting.inliers
    back = np.linalg.inv(prediction.field_matrix)
    residual = (prediction.field_residual @ back.T)[counted]
    across = prediction.field[counted, :2]
    radius = np.linalg.norm(across, axis=1)
    radial = np.sum(residual[:, :2] * across, axis=1) / radius**2
    return lasting_stray(radial, np.unwrap(np.arctan2(across[:, 1], across[:, 0])))


def _swing(choice: Choice, path: GyroPath, time: FloatArray) -> GyroSwing:
    """Return how the compass swings against the gyro."""
    place = choice.fit.block.place
    shared = place.state.shared
    attitude = attitudes_from_vectors(shared, place.samples)
    body = shared.body_axis @ attitude @ shared.world_axis.T
    block = choice.fit.block
    relative = block.unbiased if isinstance(block, GyroBlock) else path.relative
    return gyro_compass_swing(relative, body, time)
