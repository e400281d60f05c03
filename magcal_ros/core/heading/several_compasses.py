"""One heading from several magnetometers: a weighted mean without outliers.

All magnetometers measure the same field. Each sample is corrected by the calibration of its sensor
and rotated by the gyro to the moment of the present message. The mean, weighted by the variances,
is used like the field of a single sensor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.geometry.attitude import wrapped
from magcal_ros.core.geometry.vec3 import Triple, interpolate, minus, plus, propagated, scaled
from magcal_ros.core.heading.compass import Compass, CompassReading, Heading, levelled, yaw_between
from magcal_ros.core.heading.disturbance import FieldDeviation
from magcal_ros.core.heading.fused_yaw import FusedYaw
from magcal_ros.core.heading.heading_tuning import DISTURBANCE
from magcal_ros.core.knowledge import CLEAR
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.up.follower import Up

LASTING = 3.0  # correlation time of a disagreement, seconds

WRONG_BY = tuple(math.radians(5.0 * 2.0**k) for k in range(-1, 5))
WRONG_ODDS = tuple(0.01 * each for each in (0.26, 0.32, 0.26, 0.12, 0.03, 0.01))
"""Sizes of a yaw error that is not in a calibration's covariance, radians, and their prior odds. On
one robot in a hundred a compass is mounted or calibrated wrongly, log-normally by 5° (sigma of the
logarithm: 1): a board fixed by hand by some degrees, one that is mounted again by more."""

SMALLEST_VARIANCE = 1e-10  # least variance that is assumed, rad²


class CompassYaw(NamedTuple):
    """The yaw of one magnetometer at a moment."""

    number: int  # of the magnetometer
    field: Triple  # in the body axes of the moment, tesla
    relative_yaw: float  # yaw relative to an origin common to all, radians
    variance: float  # of the yaw, rad²


class CompassWeight(NamedTuple):
    """The part of one magnetometer in the heading."""

    weight: float  # 0 to 1
    why: str = ""  # its fault in words; empty if there is none


class Disagreement:
    """Yaw errors of compasses beyond the covariances of their calibrations.

    Each compass has an additional yaw error; its size is unknown and common to all. `variance` is
    the posterior mean of the squared size, rad², and `chance` the probability of such an error.
    """

    def __init__(self) -> None:
        self.variance = self.chance = 0.0
        self._likely: tuple[float, ...] | None = None

    def add(self, yaws: list[CompassYaw], part: float, seconds: float) -> None:
        """Add the yaws of two or more compasses, `seconds` after the previous ones.

        `part` is the weight of the evidence, one in an undisturbed field.
        """
        seen = tuple(_log_likelihood(yaws, size**2) for size in (0.0, *WRONG_BY))
        old = self._likely or seen
        share = part * (1.0 - math.exp(-max(seconds, 0.0) / LASTING))
        self._likely = tuple(was + share * (now - was) for was, now in zip(old, seen, strict=True))
        none, *wrong = (each - max(self._likely) for each in self._likely)
        odds = [each * math.exp(now) for each, now in zip(WRONG_ODDS, wrong, strict=True)]
        whole = math.exp(none) + sum(odds)
        self.chance = sum(odds) / whole
        self.variance = sum(o * size**2 for o, size in zip(odds, WRONG_BY, strict=True)) / whole


def _log_likelihood(yaws: list[CompassYaw], more: float) -> float:
    """Return the log likelihood of the differences of yaws with `more` variance each, rad²."""
    wider = [each._replace(variance=each.variance + more) for each in yaws]
    norm = sum(math.log(each.variance) for each in wider)
    norm += math.log(sum(1.0 / each.variance for each in wider))
    return -0.5 * (norm + misfit(wider))


@dataclass
class _CompassState:
    """A magnetometer with its calibration and its last message."""

    compass: Compass
    deviation: FieldDeviation
    reading: CompassReading | None = None
    arrived: float = -math.inf  # stamp of the IMU at the last message
    changed: float = -math.inf  # the same for the last message with other values
    extra_variance: float = 0.0  # variance of the yaw by a disturbed field, rad²
    offset: Triple = (0.0, 0.0, 0.0)  # its field minus the mean of all, body axes, tesla
    offset_seconds: float = 0.0  # seconds over which the offset was learnt
    weight: CompassWeight = field(default_factory=lambda: CompassWeight(0.0))

    def take(self, reading: CompassReading, now: float) -> None:
        """Add a message of this magnetometer."""
        if self.reading is None or reading.measured != self.reading.measured:
            self.changed = now
        self.reading, self.arrived = reading, now

    @property
    def heading(self) -> Heading:
        """The heading of its last message, which has one."""
        assert self.reading is not None
        assert self.reading.heading is not None
        return self.reading.heading

    @property
    def old_value_variance(self) -> float:
        """Variance of the yaw because its last value may be an old one, rad²."""
        return 0.0 if self.reading is None else self.reading.old_value_variance

    @property
    def own_variance(self) -> float:
        """Variance of the yaw by calibration and noise, rad²; tilt is common to all."""
        own = self.heading.lasting_variance + self.heading.noise_variance
        return max(own, SMALLEST_VARIANCE)

    @property
    def deviates(self) -> bool:
        """Whether its field deviates from the calibrated one by more than its sigma."""
        return self.extra_variance > self.own_variance


class SeveralCompasses:
    """Joins the readings of several magnetometers."""

    def __init__(self) -> None:
        self._members: dict[int, _CompassState] = {}
        self._now = self._stamp = -math.inf
        self._forget()

    def put_in_force(self, number: int, calibration: Calibration | None) -> None:
        """Use a calibration for a magnetometer, if it is not used already; None leaves it out."""
        present = self._members.get(number)
        if calibration is (present and present.compass.calibration):
            return
        self._members.pop(number, None)
        if calibration is not None:
            self._members[number] = _CompassState(Compass(calibration), FieldDeviation(calibration))
        self._forget()

    @property
    def reference_compass(self) -> Compass | None:
        """The first calibrated compass; the joined field is given as if it had measured it."""
        return self._members[min(self._members)].compass if self._members else None

    @property
    def weights(self) -> dict[int, CompassWeight]:
        """The part of each calibrated magnetometer, by its number."""
        return {number: self._members[number].weight for number in sorted(self._members)}

    def add(
        self, number: int, reading: CompassReading, now: float, fused: FusedYaw | None = None
    ) -> CompassReading | None:
        """Add a reading of a magnetometer; return that of all if it is the first that sends.

        The heading has the rate of this sensor. `reading` is a message of magnetometer `number`,
        corrected by its calibration. `now` is the stamp of the newest IMU message, seconds, as the
        clocks of drivers may differ. The gyro's yaw, `fused`, shows which compass is wrong.
        """
        if number not in self._members:
            return None
        if reading.up is None:
            return reading
        if now < self._now:
            self._forget()
        self._now = now
        self._members[number].take(reading, now)
        sending = [k for k, each in self._members.items() if self._is_new(each.arrived)]
        if number != min(sending):
            return None
        return self._joined(reading, reading.up, fused)

    def _forget(self) -> None:
        self._now = self._stamp = -math.inf
        self._is_by_gyro = False
        self._disagreement = Disagreement()
        self.disagreement = 0.0  # radians between compasses, while none is known to be wrong
        self._members = {
            number: _CompassState(each.compass, each.deviation, weight=each.weight)
            for number, each in self._members.items()
        }

    def _is_new(self, stamp: float) -> bool:
        return self._now - stamp <= STREAMS.longest_gyro_step

    def _is_frozen(self, member: _CompassState) -> bool:
        """Whether a magnetometer repeats one value although another one has changed since."""
        newest = max(each.changed for each in self._members.values())
        return newest - member.changed > STREAMS.longest_gyro_step

    def _joined(self, reading: CompassReading, up: Up, fused: FusedYaw | None) -> CompassReading:
        seconds, self._stamp = reading.stamp - self._stamp, reading.stamp
        yaws = self._compass_yaws(reading, up.direction, fused)
        if not yaws:
            return reading._replace(heading=None)
        kept = without_outliers(yaws)
        self._note_disagreement(kept, seconds)
        weights = [1.0 / (each.variance + self._disagreement.variance) for each in kept]
        shares = [weight / sum(weights) for weight in weights]
        self._note_shares(yaws, kept, shares)
        joined = _mean([minus(w.field, self._members[w.number].offset) for w in kept], shares)
        self._learn_offsets(kept, shares, seconds)
        return self._with_heading(reading._replace(field=joined), up, kept, shares)

    def _compass_yaws(
        self, reading: CompassReading, up: Triple, fused: FusedYaw | None
    ) -> list[CompassYaw]:
        """Return the yaws of magnetometers that send, and do not repeat one value."""
        turned: dict[int, Triple] = {}
        for number, member in sorted(self._members.items()):
            is_heard = self._is_new(member.arrived) and not self._is_frozen(member)
            seen = self._seen(member, reading, up) if is_heard else None
            if seen is None:
                member.weight = CompassWeight(0.0, self._silence(member))
            else:
                turned[number] = seen
        if not turned:
            return []
        origin = None if fused is None else fused.north_at(reading.stamp)
        self._is_by_gyro = origin is not None
        north = levelled(next(iter(turned.values())), up) if origin is None else origin
        assert north is not None
        # The gyro shows which compass has changed. Until they have agreed, this is no evidence.
        shows = origin is not None and any(self._members[k].offset_seconds for k in turned)
        known = fused.yaw_variance if fused is not None and shows else math.inf
        yaws = {number: yaw_between(north, seen, up) for number, seen in turned.items()}
        return [self._compass_yaw(number, seen, yaws, known) for number, seen in turned.items()]

    def _seen(self, member: _CompassState, reading: CompassReading, up: Triple) -> Triple | None:
        """Return a magnetometer's field as if by the reference compass; None if it has none."""
        then, reference = member.reading, self.reference_compass
        if then is None or then.heading is None or reference is None:
            return None
        since = reading.stamp - then.stamp
        if abs(since) > STREAMS.longest_gyro_step:
            return None
        seen, rate = then.field, reading.rate
        if since and rate is not None:
            seen = propagated(seen, scaled(rate, since))
        level = levelled(seen, up)
        if level is None:
            return None
        # Different strengths or dips in two calibrations are no disturbance.
        own, common = member.compass.calibration, reference.calibration
        further = common.strength * math.cos(common.inclination)
        further -= own.strength * math.cos(own.inclination)
        higher = own.strength * math.sin(own.inclination)
        higher -= common.strength * math.sin(common.inclination)
        return plus(seen, plus(scaled(level, further), scaled(up, higher)))

    def _compass_yaw(
        self, number: int, seen: Triple, yaws: dict[int, float], known: float
    ) -> CompassYaw:
        member, own = self._members[number], yaws[number]
        reading = member.reading
        assert reading is not None
        assert reading.up is not None
        # A single compass, or one that agrees with another, may be right and the gyro's yaw wrong.
        others = [wrapped(own - each) for other, each in yaws.items() if other != number]
        turned = min([own, *others], key=abs), known if others else math.inf
        member.extra_variance = member.deviation.add(
            self._stamp, reading.field, *reading.up, turned=turned
        )
        variance = member.own_variance + member.extra_variance + member.old_value_variance
        return CompassYaw(number, seen, own, variance)

    def _silence(self, member: _CompassState) -> str:
        if not self._is_new(member.arrived):
            return "it is silent"
        if self._is_frozen(member):
            return "it repeats the same values"
        return "its stamps are far from the others', or its field shows no direction"

    def _note_disagreement(self, yaws: list[CompassYaw], seconds: float) -> None:
        self.disagreement = 0.0
        if len(yaws) < 2:
            return
        own = sum(self._members[each.number].own_variance for each in yaws)
        self._disagreement.add(yaws, own / sum(each.variance for each in yaws), seconds)
        if self._disagreement.chance > 0.5:
            first = yaws[0].relative_yaw
            self.disagreement = max(abs(wrapped(each.relative_yaw - first)) for each in yaws)

    def _learn_offsets(self, kept: list[CompassYaw], shares: list[float], seconds: float) -> None:
        """Learn the offset of each field from the mean, while no compass seems wrong.

        A difference of hard iron is constant in body axes. With the offsets subtracted, the mean
        does not jump when a compass is left out.
        """
        is_bent = any(self._members[each.number].deviates for each in kept)
        if len(kept) < 2 or self.disagreement or is_bent or seconds <= 0.0:
            return
        mean = _mean([each.field for each in kept], shares)
        for each in kept:
            member = self._members[each.number]
            step = min(seconds, STREAMS.longest_gyro_step)
            member.offset_seconds = min(member.offset_seconds + step, DISTURBANCE.amplitude_memory)
            new = minus(each.field, mean)
            member.offset = interpolate(member.offset, new, step / member.offset_seconds)

    def _note_shares(
        self, yaws: list[CompassYaw], kept: list[CompassYaw], shares: list[float]
    ) -> None:
        weights = {each.number: share for each, share in zip(kept, shares, strict=True)}
        first = 0.0 if self._is_by_gyro else kept[0].relative_yaw
        for each in yaws:
            member, why = self._members[each.number], ""
            if each not in kept or (member.deviates and member.deviation.is_turned):
                gap = math.degrees(wrapped(each.relative_yaw - first))
                why = f"its yaw differs by {gap:+.0f}° from the others and the gyro"
            elif member.deviates:
                why = "its field is not the calibrated one"
            member.weight = CompassWeight(weights.get(each.number, 0.0), why)

    def _with_heading(
        self, reading: CompassReading, up: Up, kept: list[CompassYaw], shares: list[float]
    ) -> CompassReading:
        """Return the reading with the heading of its joined field, and the variances.

        All calibration errors are assumed to depend on the attitude like those of the reference
        compass. The additional yaw error is constant, like that of a wrong mounting.
        """
        assert self.reference_compass is not None
        heading = self.reference_compass.heading(reading.field, up.direction, up.variance)
        if heading is None:
            return reading._replace(heading=None)
        lasting = differing = noise = bent = old = 0.0
        for share, each in zip(shares, kept, strict=True):
            member = self._members[each.number]
            own = member.heading
            lasting += share**2 * own.lasting_variance
            differing += share**2 * self._disagreement.variance
            noise += share**2 * own.noise_variance
            # If all fields are disturbed differently, their mean may look undisturbed.
            bent += share**2 * member.extra_variance * (len(kept) > 1)
            old += share**2 * member.old_value_variance
        scale = math.sqrt(lasting / max(heading.lasting_variance, SMALLEST_VARIANCE))
        return reading._replace(
            heading=heading._replace(
                yaw_variance=heading.variance_by_tilt + lasting + differing + noise + bent + old,
                lasting_variance=lasting + differing,
                noise_variance=noise,
                lasting=(*(scale * each for each in heading.lasting[:-1]), math.sqrt(differing)),
            )
        )


def _mean(vectors: list[Triple], shares: list[float]) -> Triple:
    """Return the mean by shares whose sum is one."""
    x, y, z = (sum(s * v[k] for s, v in zip(shares, vectors, strict=True)) for k in range(3))
    return (x, y, z)


def without_outliers(yaws: list[CompassYaw]) -> list[CompassYaw]:
    """Return the yaws without outliers.

    A yaw is an outlier if the others agree far better without it, and far better than without any
    other yaw.
    """
    kept, gate = yaws, CLEAR**2
    while len(kept) > 1 and misfit(kept) > gate:
        rests = [kept[:k] + kept[k + 1 :] for k in range(len(kept))]
        best, second = sorted(rests, key=misfit)[:2]
        if min(misfit(kept), misfit(second)) - misfit(best) <= gate:
            break
        kept = best
    return kept


def misfit(yaws: list[CompassYaw]) -> float:
    """Return the sum of squared normalised residuals of yaws about their weighted mean."""
    whole = reading = square = 0.0
    for each in yaws:
        yaw, weight = wrapped(each.relative_yaw - yaws[0].relative_yaw), 1.0 / each.variance
        whole += weight
        reading += weight * yaw
        square += weight * yaw * yaw
    return square - reading * reading / whole
