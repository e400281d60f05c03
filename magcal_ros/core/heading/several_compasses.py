"""One heading from several magnetometers: weighed, and without those that are wrong.

All of them measure the same field. Each sample is corrected by its own sensor's calibration and
turned by the gyro to the moment of the message that is answered; the mean of them, weighed by
their variances, is one field with one heading, and goes the way of a single sensor's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.geometry.attitude import wrapped
from magcal_ros.core.geometry.vec3 import Triple, between, minus, plus, propagated, scaled
from magcal_ros.core.heading.compass import Compass, Heading, Moment, levelled, yaw_ahead
from magcal_ros.core.heading.disturbance import DISTURBANCE, FieldDoubt
from magcal_ros.core.heading.fused_yaw import FusedYaw
from magcal_ros.core.samples.streams import STREAMS
from magcal_ros.core.up.follower import Up

LASTING = 3.0  # seconds over which a disagreement is looked at: its errors are alike meanwhile

WRONG_BY = tuple(math.radians(5.0 * 2.0**k) for k in range(-1, 5))
WRONG_ODDS = tuple(0.01 * each for each in (0.26, 0.32, 0.26, 0.12, 0.03, 0.01))
"""Sizes of an error of yaw that no calibration's covariance holds, radians, and their prior odds.
On one robot in a hundred a compass was mounted or calibrated wrongly, log-normally by 5° (a sigma
of the logarithm of 1): a board fixed by hand is off by some degrees, one mounted anew by more."""

SMALLEST_VARIANCE = 1e-10  # rad², the smallest that is believed


class CompassYaw(NamedTuple):
    """The yaw of one magnetometer at a moment."""

    number: int  # which it is
    field: Triple  # in the body axes of the moment, tesla
    ahead: float  # its yaw less that of the origin common to all, radians
    variance: float  # of its yaw, rad²


class Share(NamedTuple):
    """How one magnetometer takes part in the heading."""

    weight: float  # 0 to 1
    why: str = ""  # what is wrong with it, in words; empty if nothing is


class Disagreement:
    """By how much compasses disagree that have no reason to.

    Each has, beside what its calibration's covariance says, an error of yaw of an unknown size
    common to all. `variance` is its mean by the posterior, rad², and `chance` that there is one.
    """

    def __init__(self) -> None:
        self.variance = self.chance = 0.0
        self._likely: tuple[float, ...] | None = None

    def add(self, yaws: list[CompassYaw], part: float, seconds: float) -> None:
        """Take the yaws of two or more, `seconds` after those before.

        `part` of what sound ones would show is seen: of a bent field less.
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
    """Return that of the differences between yaws, if each has so much more variance, rad²."""
    wider = [each._replace(variance=each.variance + more) for each in yaws]
    norm = sum(math.log(each.variance) for each in wider)
    norm += math.log(sum(1.0 / each.variance for each in wider))
    return -0.5 * (norm + misfit(wider))


@dataclass
class _Member:
    """A magnetometer with its calibration, and what came of it last."""

    compass: Compass
    doubt: FieldDoubt
    moment: Moment | None = None
    arrived: float = -math.inf  # stamp of the IMU when a message came
    changed: float = -math.inf  # the same of one with other values
    doubt_variance: float = 0.0  # what its field adds to its yaw's, rad²
    off: float = math.nan  # smoothed yaw ahead of the origin of all, radians
    offset: Triple = (0.0, 0.0, 0.0)  # its field less the mean of all, body axes, tesla
    learnt: float = 0.0  # seconds over which that was learnt
    share: Share = field(default_factory=lambda: Share(0.0))

    def take(self, moment: Moment, now: float) -> None:
        """Take a message of this magnetometer."""
        if self.moment is None or moment.field != self.moment.field:
            self.changed = now
        self.moment, self.arrived = moment, now

    def learn_doubt(self, stamp: float, turned: tuple[float, float]) -> None:
        """Learn how far its field is from what its calibration and the gyro expect.

        `turned` is how far its yaw is ahead, radians, and the variance of the gyro's yaw, rad²;
        infinite without one.
        """
        assert self.moment is not None
        assert self.moment.up is not None
        field, up = self.moment.field, self.moment.up
        self.doubt_variance = self.doubt.add(stamp, field, up.direction, up.variance, turned)

    @property
    def heading(self) -> Heading:
        """By its last message, of one that has a heading."""
        assert self.moment is not None
        assert self.moment.heading is not None
        return self.moment.heading

    @property
    def own_variance(self) -> float:
        """Variance of the yaw by calibration and noise, rad²; tilt is common to all."""
        own = self.heading.lasting_variance + self.heading.noise_variance
        return max(own, SMALLEST_VARIANCE)

    @property
    def is_doubted(self) -> bool:
        """Whether its field departs from the calibrated one by more than its sigma."""
        return self.doubt_variance > self.own_variance


class SeveralCompasses:
    """Joins the moments of several magnetometers."""

    def __init__(self) -> None:
        self._members: dict[int, _Member] = {}
        self._now = self._stamp = -math.inf
        self._forget()

    def put_in_force(self, number: int, calibration: Calibration | None) -> None:
        """Use another calibration for a magnetometer; None leaves it out."""
        self._members.pop(number, None)
        if calibration is not None:
            self._members[number] = _Member(Compass(calibration), FieldDoubt(calibration))
        self._forget()

    @property
    def lead(self) -> Compass | None:
        """The compass in whose terms the joined field is: the first that is calibrated."""
        return self._members[min(self._members)].compass if self._members else None

    @property
    def shares(self) -> dict[int, Share]:
        """How each magnetometer with a calibration takes part, by its number."""
        return {number: self._members[number].share for number in sorted(self._members)}

    def add(
        self, number: int, moment: Moment, now: float, fused: FusedYaw | None = None
    ) -> Moment | None:
        """Take a magnetometer's moment; returns that of all if this magnetometer sets the pace.

        The first magnetometer that sends sets it, so the heading comes at one sensor's rate.

        `moment` is what a message of magnetometer `number` comes to by its own calibration, and
        `now` the stamp of the newest IMU message, seconds, as the clocks of drivers may differ. The
        gyro's yaw, `fused`, shows which one is wrong where they disagree.
        """
        if number not in self._members:
            return None
        if moment.up is None:
            return moment
        if now < self._now:
            self._forget()
        self._now = now
        self._members[number].take(moment, now)
        sending = [k for k, each in self._members.items() if self._is_new(each.arrived)]
        if number != min(sending):
            return None
        return self._joined(moment, moment.up, fused)

    def _forget(self) -> None:
        self._now = self._stamp = -math.inf
        self._is_by_gyro = False
        self._apart = Disagreement()
        # Radians between those that disagree while none of them is known to be wrong.
        self.disagreement = 0.0
        self._members = {
            number: _Member(each.compass, each.doubt, share=each.share)
            for number, each in self._members.items()
        }

    def _is_new(self, stamp: float) -> bool:
        return self._now - stamp <= STREAMS.longest_gyro_step

    def _joined(self, moment: Moment, up: Up, fused: FusedYaw | None) -> Moment:
        seconds, self._stamp = moment.stamp - self._stamp, moment.stamp
        yaws = self._compass_yaws(moment, up.direction, fused, seconds)
        if not yaws:
            return moment
        kept = believed(yaws)
        self._note_disagreement(kept, seconds)
        weights = [1.0 / (each.variance + self._apart.variance) for each in kept]
        shares = [weight / sum(weights) for weight in weights]
        self._note_shares(yaws, kept, shares)
        joined = _mean([minus(w.field, self._members[w.number].offset) for w in kept], shares)
        self._learn_offsets(kept, shares, seconds)
        return self._with_heading(moment._replace(field=joined), up, kept, shares)

    def _compass_yaws(
        self, moment: Moment, up: Triple, fused: FusedYaw | None, seconds: float
    ) -> list[CompassYaw]:
        """Return the yaws of those that send, and do not repeat one value."""
        turned: dict[int, Triple] = {}
        # Where nothing changes at all, a robot with coarse sensors stands.
        changes = any(self._is_new(member.changed) for member in self._members.values())
        for number, member in sorted(self._members.items()):
            is_heard = self._is_new(member.changed if changes else member.arrived)
            seen = self._seen(member, moment, up) if is_heard else None
            if seen is None:
                member.share = Share(0.0, self._silence(member))
                member.off = math.nan
            else:
                turned[number] = seen
        if not turned:
            return []
        origin = None if fused is None else fused.north_at(moment.stamp)
        if self._is_by_gyro is (origin is None) or not 0.0 < seconds <= STREAMS.longest_gyro_step:
            self._is_by_gyro = origin is not None
            for member in self._members.values():
                member.off = math.nan
        north = levelled(next(iter(turned.values())), up) if origin is None else origin
        assert north is not None
        share = 1.0 - math.exp(-max(seconds, 0.0) / DISTURBANCE.memory)
        # The gyro shows which one has changed, so it is no help where none has agreed with another.
        shows = origin is not None and any(self._members[k].learnt for k in turned)
        known = fused.yaw_variance if fused is not None and shows else math.inf
        ahead = {
            number: self._ahead(number, yaw_ahead(north, seen, up), share)
            for number, seen in turned.items()
        }
        return [self._compass_yaw(number, seen, ahead, known) for number, seen in turned.items()]

    def _seen(self, member: _Member, moment: Moment, up: Triple) -> Triple | None:
        """Return a member's field at a moment, in the lead's terms; None if it has none."""
        then, lead = member.moment, self.lead
        if then is None or then.heading is None or lead is None:
            return None
        since = moment.stamp - then.stamp
        if abs(since) > STREAMS.longest_gyro_step:
            return None
        seen, rate = then.field, moment.rate
        if since and rate is not None and math.isfinite(rate[0]):
            seen = propagated(seen, scaled(rate, since))
        level = levelled(seen, up)
        if level is None:
            return None
        # That two calibrations found another strength or dip is no disturbance.
        own, common = member.compass.calibration, lead.calibration
        further = common.strength * math.cos(common.inclination)
        further -= own.strength * math.cos(own.inclination)
        higher = own.strength * math.sin(own.inclination)
        higher -= common.strength * math.sin(common.inclination)
        return plus(seen, plus(scaled(level, further), scaled(up, higher)))

    def _ahead(self, number: int, ahead: float, share: float) -> float:
        """Average by how far a member's yaw is ahead of the origin, radians."""
        member = self._members[number]
        change = wrapped(ahead - member.off)
        # A step that is too large for noise need not be averaged.
        is_noise = abs(change) <= DISTURBANCE.gate * math.sqrt(member.heading.noise_variance)
        member.off = wrapped(member.off + share * change) if is_noise else ahead
        return member.off

    def _compass_yaw(
        self, number: int, seen: Triple, ahead: dict[int, float], known: float
    ) -> CompassYaw:
        member, own = self._members[number], ahead[number]
        # One alone, or one that has turned as another did, may be right and the gyro's yaw wrong.
        others = [wrapped(own - each) for other, each in ahead.items() if other != number]
        member.learn_doubt(
            self._stamp, (min([own, *others], key=abs), known if others else math.inf)
        )
        return CompassYaw(number, seen, own, member.own_variance + member.doubt_variance)

    def _silence(self, member: _Member) -> str:
        if not self._is_new(member.arrived):
            return "it is silent"
        if not self._is_new(member.changed):
            return "it repeats the same values"
        return "its stamps are far from the others', or its field shows no direction"

    def _note_disagreement(self, yaws: list[CompassYaw], seconds: float) -> None:
        self.disagreement = 0.0
        if len(yaws) < 2:
            return
        own = sum(self._members[each.number].own_variance for each in yaws)
        self._apart.add(yaws, own / sum(each.variance for each in yaws), seconds)
        if self._apart.chance > 0.5:
            first = yaws[0].ahead
            self.disagreement = max(abs(wrapped(each.ahead - first)) for each in yaws)

    def _learn_offsets(self, kept: list[CompassYaw], shares: list[float], seconds: float) -> None:
        """Learn how each field differs from the mean, while nothing seems wrong with any.

        A difference of hard iron stays in the axes of the body. With it taken off, those that are
        left go on where all of them were.
        """
        is_bent = any(self._members[each.number].is_doubted for each in kept)
        if len(kept) < 2 or self.disagreement or is_bent or seconds <= 0.0:
            return
        mean = _mean([each.field for each in kept], shares)
        for each in kept:
            member = self._members[each.number]
            step = min(seconds, STREAMS.longest_gyro_step)
            member.learnt = min(member.learnt + step, DISTURBANCE.amplitude_memory)
            new = minus(each.field, mean)
            member.offset = between(member.offset, new, step / member.learnt)

    def _note_shares(
        self, yaws: list[CompassYaw], kept: list[CompassYaw], shares: list[float]
    ) -> None:
        weights = {each.number: share for each, share in zip(kept, shares, strict=True)}
        first = 0.0 if self._is_by_gyro else kept[0].ahead
        for each in yaws:
            member, why = self._members[each.number], ""
            if each not in kept or (member.is_doubted and member.doubt.is_turned):
                off = math.degrees(wrapped(each.ahead - first))
                why = f"its yaw differs by {off:+.0f}° from the others and the gyro"
            elif member.is_doubted:
                why = "its field is not the calibrated one"
            member.share = Share(weights.get(each.number, 0.0), why)

    def _with_heading(
        self, moment: Moment, up: Up, kept: list[CompassYaw], shares: list[float]
    ) -> Moment:
        """Return the moment with the heading of its joined field, and what is not known of it.

        The errors of all depend on the attitude as the lead's do. A disagreement without a reason
        is alike at all attitudes, as a wrong mount is.
        """
        assert self.lead is not None
        heading = self.lead.heading(moment.field, up.direction, up.variance)
        if heading is None:
            return moment._replace(heading=None)
        by_tilt = heading.yaw_variance - heading.lasting_variance - heading.noise_variance
        lasting = between = noise = bent = 0.0
        for share, each in zip(shares, kept, strict=True):
            own = self._members[each.number].heading
            lasting += share**2 * own.lasting_variance
            between += share**2 * self._apart.variance
            noise += share**2 * own.noise_variance
            # Where all fields are bent, but not alike, their mean may look right.
            bent += share**2 * self._members[each.number].doubt_variance * (len(kept) > 1)
        scale = math.sqrt(lasting / max(heading.lasting_variance, SMALLEST_VARIANCE))
        return moment._replace(
            heading=heading._replace(
                yaw_variance=by_tilt + lasting + between + noise + bent,
                lasting_variance=lasting + between,
                noise_variance=noise,
                lasting=(*(scale * each for each in heading.lasting[:-1]), math.sqrt(between)),
            )
        )


def _mean(vectors: list[Triple], shares: list[float]) -> Triple:
    """Return the mean by shares whose sum is one."""
    x, y, z = (sum(s * v[k] for s, v in zip(shares, vectors, strict=True)) for k in range(3))
    return (x, y, z)


def believed(yaws: list[CompassYaw]) -> list[CompassYaw]:
    """Return the yaws without those that are wrong, as far as the yaws alone show it.

    One is left out if the others agree far better without it, and far better than without any
    other.
    """
    kept, gate = yaws, DISTURBANCE.gate**2
    while len(kept) > 1 and misfit(kept) > gate:
        rests = [kept[:k] + kept[k + 1 :] for k in range(len(kept))]
        best, second = sorted(rests, key=misfit)[:2]
        if min(misfit(kept), misfit(second)) - misfit(best) <= gate:
            break
        kept = best
    return kept


def misfit(yaws: list[CompassYaw]) -> float:
    """Return the squared sigmas by which the yaws miss the one that suits best."""
    whole = moment = square = 0.0
    for each in yaws:
        ahead, weight = wrapped(each.ahead - yaws[0].ahead), 1.0 / each.variance
        whole += weight
        moment += weight * ahead
        square += weight * ahead * ahead
    return square - moment * moment / whole
