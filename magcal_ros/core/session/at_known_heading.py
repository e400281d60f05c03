"""Calibration at known headings: of a robot at rest, or of one that drives."""

from __future__ import annotations

import itertools
import math
from collections import deque
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from magcal_ros.core.assessment.grading import DEGREES
from magcal_ros.core.calibrate import Outcome, judged
from magcal_ros.core.calibration.calibration import Calibration, yaw_jacobian
from magcal_ros.core.calibration.heading_sigma import calibration_sigma
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, body_from_enu, unit, wrapped
from magcal_ros.core.geometry.vec3 import Triple, dot
from magcal_ros.core.knowledge import CLEAR, STREET_LENGTH, Knowledge, ReferenceField
from magcal_ros.core.methods.known_headings import declination_hint, fit, next_in_words
from magcal_ros.core.samples.streams import FieldSample, HeadingSample, Pair
from magcal_ros.core.session.external_heading import (
    ExternalHeading,
    GyroTurn,
    HeadingAgainstGyro,
    is_by_headings,
)
from magcal_ros.core.session.session_tuning import KNOWN, LOG, SESSION
from magcal_ros.core.smoother.headings import KnownHeadingMeasurement
from magcal_ros.core.smoother.state import SECTORS
from magcal_ros.core.smoother.unknowns import (
    DISTURBANCE_AT_REST,
    KINDS,
    MICROTESLA,
    ON_WHEELS,
    SIZES,
    USUALLY_LATE,
    Size,
)
from magcal_ros.core.up.follower import UpFollower


def _refuse_motion(field: FloatArray, rate: FloatArray, noise: float) -> None:
    half = len(field) // 2
    moved = np.abs(field[:half].mean(axis=0) - field[half:].mean(axis=0)).max()
    turned = float(np.linalg.norm(rate.mean(axis=0))) if np.isfinite(rate).all() else 0.0
    if turned > KNOWN.rate:
        what = f"the robot turned at {turned * DEGREES:.1f} °/s (measured by the gyro)"
    elif moved > KNOWN.creep + 4.0 * noise * math.sqrt(2.0 / half):
        what = f"the field changed by {moved * MICROTESLA:.1f} µT"
    else:
        return
    raise Refusal(
        Reason.HEADING_CONTRADICTED,
        f"{what} during the measurement: the robot has to stand still for {SESSION.rest:g} s at "
        "the known heading, and nothing magnetic may move near it",
    )


def _noise(values: FloatArray) -> float:
    """Return the standard deviation of one sample of (n, 3) per axis, from the differences."""
    return float(np.sqrt(np.mean(np.diff(values, axis=0) ** 2) / 2.0))


@dataclass(frozen=True, eq=False)
class HeadingResult:
    """The result of a rest at a known heading."""

    measurements: tuple[KnownHeadingMeasurement, ...]  # all rests to use from now on
    outcome: Outcome
    """The summary of its verdict has the accuracy to expect after the next heading as well."""
    applies: bool = False  # whether the new calibration is to be put in force


@dataclass(frozen=True, eq=False)
class CollectedSamples:
    """The samples of a robot at rest at a known heading."""

    pairs: tuple[Pair, ...]
    given: ExternalHeading
    knowledge: Knowledge
    """With the declination, if the heading is to true north."""
    forward: FloatArray  # direction to which the heading refers, IMU axes. Shape (3,).
    since: GyroTurn = field(default_factory=GyroTurn)  # measured since the previous measurement
    bias: Triple = (0.0, 0.0, 0.0)  # estimated bias of the gyro, rad/s; zero if unknown

    def measurement(self) -> KnownHeadingMeasurement:
        """Return the means; raises Refusal if the robot moved or there are too few samples."""
        declination = self.knowledge.reference.to_magnetic(self.given.is_true)
        if declination is None:
            raise Refusal(
                Reason.NO_SOLUTION,
                "the heading refers to true north, and the declination here is not known: give "
                "reference.latitude_deg and longitude_deg (or reference.declination_deg), wait "
                "for gps/fix, or give a heading that refers to magnetic north",
            )
        if len(self.pairs) < KNOWN.fewest:
            raise Refusal(
                Reason.TOO_FEW_SAMPLES,
                f"only {len(self.pairs)} samples of field and acceleration came in "
                f"{SESSION.rest:g} s, and {KNOWN.fewest} are needed: check that both sensors "
                "publish, and check their stamps",
            )
        field = np.array([pair.field.field for pair in self.pairs])
        force = np.array([pair.imu.force for pair in self.pairs])
        rate = np.array([pair.imu.rate for pair in self.pairs]) - self.bias
        noise = _noise(field)
        _refuse_motion(field, rate, noise)
        return KnownHeadingMeasurement(
            field.mean(axis=0),
            force.mean(axis=0),
            wrapped(self.given.yaw + declination),
            self.given.sigma,
            by_declination=self.given.is_true,
            forward=self.forward,
            turned=self.since.angle,
            turned_sigma=self.since.sigma,
            seconds=self.since.seconds,
            noise_field=max(noise, 1e-9),
            noise_up=_noise(unit(force)),
        )


def calibrate_at_known_heading(
    before: tuple[KnownHeadingMeasurement, ...],
    collected: CollectedSamples,
    in_force: Calibration | None = None,
) -> HeadingResult:
    """Calibrate with the earlier measurements and the new samples."""
    try:
        new = collected.measurement()
    except Refusal as refusal:
        return _refused(before, Outcome.refused(refusal))
    return add_known_heading(before, new, collected.knowledge, in_force)


def _refused(before: tuple[KnownHeadingMeasurement, ...], outcome: Outcome) -> HeadingResult:
    kept = f" Earlier known headings that are kept: {len(before)}." if before else ""
    return HeadingResult(before, outcome.saying(f"{outcome.verdict.summary}{kept}"))


def add_known_heading(
    before: tuple[KnownHeadingMeasurement, ...],
    new: KnownHeadingMeasurement,
    knowledge: Knowledge,
    in_force: Calibration | None = None,
) -> HeadingResult:
    """Add a measurement to the earlier ones, fit, and judge; bad data are a refused result.

    A calibration in force from a turn or drive is kept if its heading sigma is smaller. A heading
    that contradicts this calibration is refused.
    """
    other = None if in_force is None or is_by_headings(in_force) else in_force
    gap, sigma = (0.0, math.inf) if other is None else _gap(other, new)
    if abs(gap) > CLEAR * sigma:
        side = "left" if gap > 0.0 else "right"
        why = (
            f"the calibration in force shows a heading {abs(gap) * DEGREES:.0f}° further to the "
            f"{side} than the given heading; ±{sigma * DEGREES:.1f}° would be usual. Check the "
            "sign of the heading, that zero is east, and which north it refers to. If the heading "
            "is right, the calibration is out of date or the sensor was turned: call ~/reset, and "
            "then this service again"
        )
        return _refused(before, Outcome.refused(Refusal(Reason.HEADING_CONTRADICTED, why)))
    measurements = (*_without_repeated(before, new), new)[-KNOWN.most :]
    outcome, north = fit_log(measurements, knowledge, DISTURBANCE_AT_REST)
    if outcome.calibration is None:
        return _refused(before, outcome)
    applies = outcome.verdict.accepted
    words = [outcome.verdict.summary, north, next_in_words(measurements, knowledge)]
    if applies and other is not None:
        own, theirs = (calibration_sigma(each) for each in (outcome.calibration, other))
        if theirs < own:
            applies = False
            words.insert(
                0,
                f"The calibration in force agrees with this heading (off by {gap * DEGREES:.1f}°) "
                f"and predicts ±{theirs * DEGREES:.1f}°, so it is kept. By known headings:",
            )
    text = " ".join(each[0].upper() + each[1:].rstrip(".") + "." for each in words if each)
    return HeadingResult(measurements, outcome.saying(text.replace(":.", ":")), applies)


def _without_repeated(
    before: tuple[KnownHeadingMeasurement, ...], new: KnownHeadingMeasurement
) -> tuple[KnownHeadingMeasurement, ...]:
    """Return the earlier measurements without those that the new one repeats."""
    kept: list[KnownHeadingMeasurement] = []
    lost = False
    for each in before:
        near = abs(wrapped(each.heading - new.heading)) < KNOWN.same
        is_same = (
            near and np.linalg.norm(each.field - new.field) * MICROTESLA < DISTURBANCE_AT_REST.usual
        )
        if not is_same:
            # The turn since a measurement that is left out is not known.
            kept.append(replace(each, turned_sigma=math.inf) if lost else each)
        lost = bool(is_same)
    return tuple(kept)


def _gap(calibration: Calibration, new: KnownHeadingMeasurement) -> tuple[float, float]:
    """Return a calibration's heading minus the known heading, and its sigma, radians."""
    field, up = calibration.correction.apply(new.field), unit(new.force)
    east, north, _ = body_from_enu(up, field).T @ new.forward
    yaw = math.atan2(float(north), float(east))
    level = max(float(np.linalg.norm(np.cross(field, up))), 1e-9)
    jacobian = yaw_jacobian(calibration.correction, up, field)
    gradient_by_parameters = float(jacobian @ calibration.covariance @ jacobian)
    place = DISTURBANCE_AT_REST.rms / MICROTESLA / level
    return wrapped(yaw - new.heading), math.sqrt(gradient_by_parameters + place**2 + new.sigma**2)


class _DriveMean(NamedTuple):
    """A mean of samples in a drive, with the gyro's turn and the metres since the log began."""

    stamp: float
    measurement: KnownHeadingMeasurement
    turn: GyroTurn
    metres: float

    def after(self, before: _DriveMean) -> KnownHeadingMeasurement:
        """Return the measurement with distance, time and turn since the previous one."""
        turn = self.turn.since(before.turn)
        return replace(
            self.measurement,
            distance=self.metres - before.metres,
            seconds=self.stamp - before.stamp,
            turned=turn.angle,
            turned_sigma=turn.sigma,
        )


class HeadingCollector:
    """Keeps means of the field at headings measured by another device, live or from a recording.

    The number of means for each sector of headings is limited. `check` compares the headings with
    the gyro; no sample is taken while they disagree.
    """

    def __init__(self, up: UpFollower) -> None:
        self._up = up
        self.check = HeadingAgainstGyro()
        self.newest = HeadingSample(-math.inf, 0.0, 1.0)
        self._turn = GyroTurn()
        self._heard, self._metres = math.nan, 0.0
        self._forward = np.zeros(3)
        self.forget()

    def forget(self) -> None:
        """Discard the means."""
        self.kept: list[deque[_DriveMean]] = [deque(maxlen=LOG.each) for _ in range(SECTORS)]
        """The means by sectors of heading; another list after `forget`."""
        self._fresh = 0
        self._block: list[tuple[float, ...]] = []  # stamp, field, up, heading as a direction, turn

    def on_imu(self, stamp: float) -> None:
        """Integrate the gyro up to the stamp (seconds) of an IMU message that `up` has received."""
        self._turn = self._turn.followed(stamp, self._up)

    def on_heading(self, sample: HeadingSample) -> None:
        """Take a heading."""
        self.newest = sample
        self.check.add(sample.stamp, sample.yaw, self._turn.angle)

    def on_field(
        self,
        sample: FieldSample,
        forward: FloatArray,
        is_true: bool,
        reference: ReferenceField,
        max_gap: float,
    ) -> bool:
        """Take a field sample; returns whether there are enough new means for a fit.

        `forward` (3,) is the direction in the IMU's axes to which the headings refer; the means at
        another one are discarded. `is_true` says whether they refer to true or to magnetic north;
        `max_gap` is as in `UpFollower.at`. Means of a sector are one correlation length of the
        local disturbance apart, by the usual speed of a drive. So a rest gives one mean only.
        """
        stamp, given, rate = sample.stamp, self.newest, self._up.rate
        up, shift = self._up.at(stamp, max_gap), reference.to_magnetic(is_true)
        is_usable = stamp - given.stamp <= LOG.block and not self.check.fault
        if up is None or rate is None or shift is None or not is_usable:
            return False
        if not np.array_equal(self._forward, forward):
            self._forward = forward
            self.forget()
        since, self._heard = stamp - self._heard, stamp
        if since > 0.0 and not self._up.is_at_rest:
            self._metres += KINDS[ON_WHEELS].speed * since
        if abs(dot(rate, up.direction)) > LOG.rate:
            self._block = []
            return False
        if self._block and not 0.0 <= stamp - self._block[0][0] < 2.0 * LOG.block:
            self._block = []
        direction = math.cos(given.yaw), math.sin(given.yaw)
        self._block.append((stamp, *sample.field, *up.direction, *direction, self._turn.angle))
        if stamp - self._block[0][0] < LOG.block:
            return False
        mean, self._block = np.mean(self._block, axis=0), []
        measurement = KnownHeadingMeasurement(
            mean[1:4],
            STANDARD_GRAVITY * mean[4:7],
            wrapped(math.atan2(mean[8], mean[7]) + shift),
            math.hypot(given.sigma, LOG.rate * USUALLY_LATE),
            by_declination=is_true,
            forward=forward,
            force_sigma=LOG.force,
            common_sigma=LOG.common,
            drifts=True,
        )
        turn = self._turn._replace(angle=float(mean[9]))
        return self._keep(_DriveMean(stamp, measurement, turn, self._metres))

    def _keep(self, new: _DriveMean) -> bool:
        share = new.measurement.heading % math.tau / math.tau
        sector = self.kept[int(share * SECTORS) % SECTORS]
        if sector and new.metres - sector[-1].metres < STREET_LENGTH:
            return False
        sector.append(new)
        self._fresh += 1
        if self._fresh < max(LOG.each, len(self.measurements) // 3):
            return False
        self._fresh = 0
        return True

    @property
    def measurements(self) -> tuple[KnownHeadingMeasurement, ...]:
        """The kept means in the order of time."""
        kept = sorted(itertools.chain(*self.kept), key=lambda each: each.stamp)
        later = (after.after(before) for before, after in itertools.pairwise(kept))
        return (*(each.measurement for each in kept[:1]), *later)


def fit_log(
    measurements: tuple[KnownHeadingMeasurement, ...],
    knowledge: Knowledge,
    place: Size = SIZES["street"],
) -> tuple[Outcome, str]:
    """Calibrate from known headings, by default in a drive; returns the outcome and a warning.

    The warning says that the headings seem to refer to the other north; it is empty if not.
    `place` is the size of the local disturbance.
    """
    try:
        estimate = fit(measurements, knowledge, place)
    except Refusal as refusal:
        return Outcome.refused(refusal), ""
    return judged(estimate, knowledge), declination_hint(estimate, measurements, knowledge)
