"""Find the sensor whose axes contradict the other two, its axes, and whether the IMU is upright."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magcal_ros.core.doctor.axes_hypotheses import AxesHypotheses
from magcal_ros.core.doctor.doctor_tuning import AXES, WIDE
from magcal_ros.core.doctor.finding import (
    Finding,
    ok_or_severe,
    ok_or_warning,
    undetermined,
    vector_in_words,
)
from magcal_ros.core.doctor.quirks import FIELD_POINTS_UP, INVERTED
from magcal_ros.core.doctor.turn_fit import TurnFit, fit_turn
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray
from magcal_ros.core.geometry.rotations import (
    DIRECTIONS,
    axes_in_words,
    is_mirrored,
    likely_slip,
    rank_of,
    rpy_from_rotation,
    swapped,
)
from magcal_ros.core.knowledge import CLEAR, Knowledge, Mounting
from magcal_ros.core.samples.units import LEAST_UPRIGHT, usual_up
from magcal_ros.core.samples.window import SensorLog

NOSE = "lift the nose by 20° while the robot turns"
LIFT = f"{NOSE}, or drive over a kerb"
GIVE_DIP = ", and give the position or the field's inclination"
DRIVE = "; or drive straight, where a receiver's course shows the yaw"
WRONG_SIGN = (
    "gravity has the wrong sign: REP-145 requires +9.81 on z at rest, so negate "
    "linear_acceleration in the driver"
)
UPSIDE_DOWN = (
    "the IMU's z points down, but REP-103 requires x forward, y left, z up: turn the IMU's axes "
    "in the driver (by 180° about x if they are x forward, y right, z down), or mount it upright"
)
STAND = "let the robot stand upright for a few seconds, and turn it about its vertical axis alone"
WHICH_GRAVITY = "To tell which, turn left and see whether angular_velocity.z is positive"


def check_gravity_direction(
    log: SensorLog,
    given: AxesHypotheses | None,
    other: AxesHypotheses | None,
    turned_left: bool | None,
    mounting: Mounting,
) -> tuple[Finding, bool | None]:
    """Check the direction of gravity against the body's z and the described top of the vehicle.

    Return a finding, and whether gravity's sign is wrong; None if either the sign or the IMU's axes
    are. `turned_left` is whether the user turned the robot to the left; None if unknown.
    """
    name = "accelerometer: up"
    usual = usual_up(log.imu_time, log.force, log.rate if log.has_gyro else None)
    if np.linalg.norm(usual) < LEAST_UPRIGHT:
        return undetermined("gravity_sign", name, STAND), False
    usual = usual / np.linalg.norm(usual)
    evidence = f"up is {vector_in_words(usual)}"
    if math.cos(mounting.lean(usual)) > LEAST_UPRIGHT:
        return ok_or_warning("gravity_sign", name, evidence), False
    if usual[2] > -LEAST_UPRIGHT:
        axis = int(np.argmax(np.abs(usual)))
        way = DIRECTIONS[2][int(usual[axis] < 0.0)]
        words = (
            f"at rest the IMU's {'xyz'[axis]} axis points {way}, but its z axis should point up: "
            "turn the IMU's axes in the driver, or mount it upright"
        )
        return ok_or_severe("imu_axes", name, evidence, words), False
    flipped = _is_flipped(given, other, turned_left)
    key, words = {
        None: ("gravity_sign", f"either {WRONG_SIGN}; or {UPSIDE_DOWN}. {WHICH_GRAVITY}"),
        True: ("gravity_sign", WRONG_SIGN),
        False: ("imu_axes", UPSIDE_DOWN),
    }[flipped]
    return ok_or_severe(key, name, evidence, words), flipped


def _is_flipped(
    given: AxesHypotheses | None, other: AxesHypotheses | None, turned_left: bool | None
) -> bool | None:
    """Return whether gravity's sign is wrong, or else the IMU is upside down; None if unclear."""
    if given is None or other is None:
        return None
    turned = float(given.turned[given.best])
    if turned_left is not None and abs(turned) > AXES.least_turn:
        # If the vector of up points down, a turn to the left looks like one to the right.
        return (turned > 0.0) is not turned_left
    worse = given.field_right - other.field_right
    return None if abs(worse) < AXES.doubtful else worse > 0.0


STANDARD = np.eye(3)
NOTHING_FITS = (
    "no mounting and no swapped or mirrored axes explain gyro, field and gravity together: check "
    "that the gyro responds to turns, check its unit and the stamps, and turn far from iron"
)
SEVERAL_WRONG = (
    "gyro, magnetometer and gravity contradict each other, and wrong axes of one sensor do not "
    "explain it. Linear acceleration and iron nearby can be the cause, too: stand still, turn on "
    f"the spot away from iron, and {LIFT}"
)
DEAD_GYRO = "correct the dead axes of the gyro first, then turn once more"
TURNED_RIGHT = (
    "all sensors measured a turn to the right, but a turn to the left was expected: turn left and "
    "check again. If it was a turn to the left, z of all sensors points down"
)


@dataclass(frozen=True, eq=False)
class PossibleAxes:
    """The possible axes of the magnetometer by a movement."""

    candidates: FloatArray
    """Axes that explain the samples, the likeliest first. Rows are the magnetometer's axes, after
    the known mounting, in the body's. Shape (k, 3, 3)."""
    right: bool  # whether the axes as given are possible
    knowledge: Knowledge

    @property
    def pose(self) -> FloatArray:
        """The known mounting, shape (3, 3)."""
        return self.knowledge.mounting.pose

    @property
    def dip_known(self) -> bool:
        """Whether the reference inclination distinguishes axes from their opposites."""
        dip = self.knowledge.reference.inclination
        return not dip.is_unknown and abs(dip.value) > CLEAR * WIDE.soft_iron

    @property
    def likeliest(self) -> FloatArray:
        """The likeliest axes; the axes as given if these are possible."""
        return STANDARD if self.right else np.asarray(self.candidates[0])

    @property
    def mount_rpy_deg(self) -> tuple[int, int, int] | None:
        """The correct parameter `mount_rpy_deg`; None if no mounting corrects the axes."""
        return None if is_mirrored(self.likeliest) else mount_of(self.likeliest, self.pose)

    @property
    def words(self) -> str:
        """The fault and its remedy, if gyro and accelerometer are right; empty without a fault."""
        if self.right:
            return ""
        which = f". To tell which, {self.movement}" if self.movement else ""
        return self.alternatives + which

    @property
    def alternatives(self) -> str:
        """As `words`, but without the movement that distinguishes the candidates."""
        alternatives = named(self.candidates, self._describe)
        return f"the magnetometer's axes do not match the IMU's: {alternatives}"

    @property
    def movement(self) -> str:
        """The movement that distinguishes the candidates; empty for a single candidate."""
        if len(self.candidates) < 2:
            return ""
        first = self.candidates[0]
        is_opposite = len(self.candidates) == 2 and np.array_equal(first, -self.candidates[1])
        if is_opposite and not self.dip_known:
            return (
                "give the position or the field's inclination: only this shows whether all axes "
                "are reversed"
            )
        dip = "" if self.dip_known else GIVE_DIP
        level = all(np.array_equal(np.abs(first[2]), np.abs(c[2])) for c in self.candidates)
        return f"{LIFT}{dip}{DRIVE if level else ''}"

    def _describe(self, axes: FloatArray) -> str:
        whole = np.rint(self.pose.T @ axes)
        if not np.array_equal(np.abs(whole).sum(axis=0), np.ones(3)):
            whole = axes
        if is_mirrored(axes):
            words = axes_in_words(whole)
            if np.array_equal(whole, INVERTED):
                return f"{words} (the driver gives all three the wrong sign, or {FIELD_POINTS_UP})"
            return f"{words} (mirrored: no mounting explains this; {likely_slip(whole)})"
        named = " (NED)" if np.array_equal(whole, np.diag([1.0, -1.0, -1.0])) else ""
        return f"{axes_in_words(whole)}{named}: set `{parameter_line(mount_of(axes, self.pose))}`"


def named(candidates: FloatArray, say: Callable[[FloatArray], str]) -> str:
    """Describe the likeliest of the candidates (k, 3, 3), with the number of the others."""
    left = len(candidates) - AXES.most_named
    words = [say(axes) for axes in candidates[: AXES.most_named]]
    return "; or ".join([*words, f"{left} more"] if left > 0 else words)


def mount_of(axes: FloatArray, pose: FloatArray) -> tuple[int, int, int]:
    """Return roll, pitch and yaw, degrees, of the mounting for axes found after a known pose."""
    degrees = (round(math.degrees(angle)) for angle in rpy_from_rotation(axes.T @ pose))
    roll, pitch, yaw = ((angle + 179) % 360 - 179 for angle in degrees)
    return roll, pitch, yaw


def parameter_line(rpy_deg: tuple[int, int, int]) -> str:
    """Return the line for a parameter file."""
    return f"mount_rpy_deg: [{', '.join(f'{angle}.0' for angle in rpy_deg)}]"


class AxesDiagnosis(NamedTuple):
    """Which sensors have wrong axes."""

    findings: tuple[Finding, ...]
    """The findings on the axes of all sensors."""
    chosen: int | None = None  # the chosen hypothesis; None if none explains the movement
    axes: PossibleAxes | None = None
    """The possible axes of the magnetometer; None if they are not determined."""
    turn: TurnFit | None = None  # the fit by the chosen hypothesis, if it was compared with others


def diagnose_axes(
    hypotheses: AxesHypotheses,
    knowledge: Knowledge,
    turned_left: bool | None,
    up_is_down: bool,
    gyro_is_half_dead: bool = False,
) -> AxesDiagnosis:
    """Name the sensors whose axes are or may be wrong; with dead gyro axes, only the gyro.

    `up_is_down` is whether the sign of the specific force is wrong.
    """
    misfit, given = hypotheses.cost - hypotheses.cost.min(), hypotheses.as_given
    if hypotheses.fit.rms[hypotheses.best] > AXES.worst_fit:
        finding = ok_or_warning("nothing_fits", "axes", "gyro and field disagree", NOTHING_FITS)
        return AxesDiagnosis((finding,))
    remains = misfit < AXES.remains
    contrary = np.zeros(len(misfit), dtype=np.bool_)
    if turned_left is not None:
        # The user may have turned the wrong way while all sensors are right.
        turned = hypotheses.turned
        contrary = (np.abs(turned) > AXES.least_turn) & ((turned > 0.0) != turned_left)
    if misfit[given] < 2.0 * AXES.remains:
        return _all_agree(hypotheses, remains, knowledge, contrary)
    kept = remains & ~contrary
    left = [int(k) for k in np.flatnonzero(kept if kept.any() else remains)]
    # Likely hypotheses are ordered by how common the mistake is.
    gyro, field = hypotheses.gyro, hypotheses.field
    left.sort(key=lambda k: (misfit[k] > 0.5 * AXES.remains, rank_of(gyro[k]), rank_of(field[k])))
    suspects: dict[tuple[str, ...], list[int]] = {}
    for k in left:
        suspects.setdefault(_wrong_sensors(hypotheses, k), []).append(k)
    fewest = min(map(len, suspects))
    suspects = {sensors: each for sensors, each in suspects.items() if len(sensors) == fewest}
    if gyro_is_half_dead and list(suspects) != [("gyro",)]:
        return AxesDiagnosis((undetermined("axes", "axes", DEAD_GYRO),))
    fits: dict[int | None, TurnFit | None] = {}
    if hypotheses.fit.rms[given] < AXES.good_fit:
        # The model of the comparison is simple: some errors of right sensors resemble other axes.
        asked = [given, *(each[0] for each in suspects.values())]
        fits = {k: fit_turn(hypotheses.hypothesis(k), knowledge, up_is_down) for k in asked}
        own, *others = (-math.inf if fit is None else fit.log_odds for fit in fits.values())
        if 2.0 * (own - max(others)) > AXES.remains:
            return _all_agree(hypotheses, remains, knowledge, contrary)._replace(turn=fits[given])
    found = _findings_on_axes(hypotheses, suspects, knowledge)
    return found._replace(turn=fits.get(found.chosen))


def _wrong_sensors(hypotheses: AxesHypotheses, k: int) -> tuple[str, ...]:
    """Return the sensors whose axes are wrong by hypothesis `k`."""
    gyro, field = hypotheses.gyro[k], hypotheses.field[k]
    axes = {"gyro": gyro, "magnetometer": field}
    wrong = tuple(sensor for sensor, each in axes.items() if not np.array_equal(each, STANDARD))
    # If both differ from the accelerometer in the same way, the accelerometer's axes are wrong.
    alike = np.array_equal(gyro, field) or np.array_equal(gyro, -field)
    return ("accelerometer",) if len(wrong) > 1 and alike and not is_mirrored(gyro) else wrong


def _all_agree(
    hypotheses: AxesHypotheses, remains: BoolArray, knowledge: Knowledge, contrary: BoolArray
) -> AxesDiagnosis:
    given = hypotheses.as_given
    # The possible axes of the magnetometer if the gyro's are right.
    alike = (hypotheses.gyro == hypotheses.gyro[given]).all(axis=(1, 2))
    axes = PossibleAxes(hypotheses.field[remains & alike], True, knowledge)
    known = np.array_equal(knowledge.mounting.pose, STANDARD)
    evidence = "x forward, y left, z up" if known else "as mount_rpy_deg says"
    more = int(remains.sum() - remains[given])
    found = [ok_or_warning("axes", "axes", evidence)]
    if more:
        pairs = f"pair{'s' * (more > 1)} of orientations"
        rest = f"{more} other {pairs} of gyro and magnetometer"
        why = f"{evidence} fit, but so would {rest}; to tell them apart, {axes.movement or LIFT}"
        found = [undetermined("axes", "axes", why)]
    if contrary[given]:
        others = [_wrong_sensors(hypotheses, int(k)) for k in np.flatnonzero(remains & ~contrary)]
        alone = {sensors[0]: None for sensors in others if len(sensors) == 1}
        words = TURNED_RIGHT + "".join(f", or only the {sensor} has wrong axes" for sensor in alone)
        found.append(ok_or_warning("imu_axes", "axes: up", "a turn to the right", words))
    return AxesDiagnosis(tuple(found), given, axes)


def _findings_on_axes(
    hypotheses: AxesHypotheses, suspects: dict[tuple[str, ...], list[int]], knowledge: Knowledge
) -> AxesDiagnosis:
    """Name the sensor with wrong axes; ask for a movement if several are possible or wrong.

    `suspects` holds the hypotheses by the sensors that are wrong, the likeliest first.
    """
    first, chosen = next(iter(suspects.items()))
    if len(first) > 1:
        names = " and ".join(first)
        evidence = f"other axes of {names} explain the movement better"
        return AxesDiagnosis((ok_or_warning("axes", "axes", evidence, SEVERAL_WRONG),))
    is_clear = len(suspects) == 1
    remedies, axes = {}, None
    for (sensor,), alternatives in suspects.items():
        if sensor == "magnetometer":
            axes = PossibleAxes(_distinct(hypotheses.field[alternatives]), False, knowledge)
            remedies[sensor] = axes.words if is_clear else axes.alternatives
            continue
        words, slip = AXES_REMEDIES[sensor]
        candidates = _distinct(hypotheses.gyro[alternatives])
        is_asked = is_clear and len(candidates) > AXES.most_named
        which = f". To tell which, {LIFT}" if is_asked else ""
        remedies[sensor] = words.format(named(candidates, slip)) + which
    names = " or ".join(remedies)
    if not is_clear:
        evidence = f"{names} contradicts the other sensors"
        is_opposite = axes is not None and not axes.dip_known and len(axes.candidates) > 1
        asked = f"{names} has wrong axes, and this movement does not show which: "
        either = "; or ".join(remedies.values())
        asked += f"{LIFT}{GIVE_DIP if is_opposite else ''}. Either {either}"
        if axes is not None and (axes.candidates == INVERTED).all(axis=(1, 2)).any():
            asked += f"; or {FIELD_POINTS_UP}"
        return AxesDiagnosis((ok_or_severe("axes", "axes", evidence, asked),), chosen[0], axes)
    evidence = "the other sensors contradict them"
    line = ok_or_severe(AXES_KEYS[names], f"{names}: axes", evidence, remedies[names])
    return AxesDiagnosis((line,), chosen[0], axes)


AXES_KEYS = {"magnetometer": "field_axes", "gyro": "gyro_axes", "accelerometer": "force_axes"}
"""By sensor: the key of the finding that its axes are wrong."""


def _distinct(axes: FloatArray) -> FloatArray:
    rows = (axes + 0.0).reshape(len(axes), -1)  # No zero with a sign.
    return np.array([axes[k] for k in sorted(np.unique(rows, axis=0, return_index=True)[1])])


def gyro_slip(axes: FloatArray) -> str:
    """Describe how the gyro's axes (3, 3), rows in the body's, differ from the body's."""
    if np.array_equal(np.abs(axes), STANDARD):
        flipped = [name for name, sign in zip("xyz", np.diag(axes), strict=True) if sign < 0.0]
        verb = "has" if len(flipped) == 1 else "have"
        return f"{' and '.join(flipped)} {verb} the wrong sign"
    if exchanged := swapped(axes):
        return exchanged
    return axes_in_words(axes, (("x", "-x"), ("y", "-y"), ("z", "-z")), " holds ")


AXES_REMEDIES: dict[str, tuple[str, Callable[[FloatArray], str]]] = {
    "gyro": (
        "the gyro's axes do not match the accelerometer's: {}; correct it in the driver",
        gyro_slip,
    ),
    "accelerometer": (
        "gyro and magnetometer agree, but the accelerometer's axes do not match theirs: they are "
        "{}; correct them in the driver",
        lambda axes: axes_in_words(axes.T),
    ),
}
"""By sensor: the remedy for wrong axes, and a function that describes one candidate."""
