"""Fits of a window for each kind of motion (turn, small circle, drive), weighted by evidence."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.calibration.heading_sigma import rms_sigma
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import integral
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoother.factors import soft_iron
from magcal_ros.core.smoother.fit import Fit, Tolerances, fit, without_distortion
from magcal_ros.core.smoother.nodes import Nodes, Spacing, nodes_of
from magcal_ros.core.smoother.posterior import Posterior, posterior
from magcal_ros.core.smoother.priors import Priors, priors_of
from magcal_ros.core.smoother.start import start
from magcal_ros.core.smoother.unknowns import (
    AT,
    BEYOND_USUAL,
    DRIVES,
    KINDS,
    LATE,
    MOTORS,
    MOVED,
    ON_THE_SPOT,
    ON_WHEELS,
    PASSED,
    ROLLING,
    SIZES,
    SMALL_CIRCLE,
    UNKNOWNS,
    USUAL,
    USUALLY_LATE,
)

EVIDENCE_WEIGHT = 0.25
"""Weight of the evidence, which is minus twice a logarithm; exact evidence would have 0.5.

It is approximate (Laplace, at the most likely sizes), and real robots differ from the model."""

NO_SOLUTION = "the samples do not determine a calibration; turn the robot through a full circle"
DIFFERENT_TURNS = (
    "the field does not turn as the gyro does; check that the axes of both sensors match, check "
    "their stamps, and check that no samples of a shaking gyro are lost"
)

ROUGH = Tolerances(rounds=20)  # of a first, rough fit of a kind of motion
UNTIL_PLACES = Tolerances(rounds=12)
"""Of the first fits of a drive, which end soon after the places passed are known. The likeliest one
is continued, and the other kinds then start again from it."""
WHILE_DRIVING = Spacing(1.5, math.radians(15.0), math.radians(0.5), short=1.5)
"""Nodes of a drive: it has more data than a turn, so that longer means are enough."""
PART, FEWEST_OF_PART = 60.0, 100
"""Length in seconds of the part of a long window that is first tried as a turn on the spot, and the
fewest samples in it."""
CONFOUNDED = "installation", "soft_iron", "axes", "iron"
"""Unknowns that are confounded with a part moved on the robot."""
LARGEST_GAIN = 3.0  # by which soft iron may amplify the field along an axis: its prior ends there
NEAR_LIMIT = 0.95
"""Fraction of the largest gyro noise from which the gyro disagrees with the other sensors."""


@dataclass(frozen=True, eq=False)
class Smoothed:
    """The result of `smooth`: fits by kind of motion, weights and posterior."""

    nodes: Nodes
    mode: str  # the most likely kind of motion
    fits: dict[str, Fit]  # by kind of motion
    weights: dict[str, float]  # their probabilities
    posterior: Posterior  # of all kinds together
    by_acceleration: float
    """Part of the sigma of the heading on the level, radians, between and within kinds of motion:
    acceleration of the robot and offset of the accelerometer cannot be separated."""

    @property
    def fit(self) -> Fit:
        """The fit of the most likely kind of motion."""
        return self.fits[self.mode]


class _MotionFits:
    """The fits of a window by kind of motion, the best of each as `fits`.

    `progress` is called with the fraction of the work that is done.
    """

    def __init__(
        self,
        window: Window,
        knowledge: Knowledge,
        progress: Callable[[float], object] | None = None,
    ) -> None:
        self._samples, self._knowledge = window, knowledge
        self._usual = ROLLING if window.rolls else USUAL
        self._progress, self._started = progress, 0
        self.fits: dict[str, Fit] = {}
        self._impossible = False

    def _begin(self, spacing: Spacing) -> None:
        samples, knowledge = self._samples, self._knowledge
        self.nodes = nodes_of(samples, knowledge.mounting.to_body, spacing)
        priors = priors_of(knowledge, samples.bias_sigma).with_dead_axes(self.nodes.working)
        self._state, self._priors = start(self.nodes, priors)
        self.fits = {}

    def on_the_spot(self) -> Fit | None:
        """Return a coarse fit of a turn on the spot if it explains the samples, else None."""
        if self._samples.rolls:
            return None
        part = part_with_most_motion(self._samples)
        if part is not None and _MotionFits(part, self._knowledge).on_the_spot() is None:
            return None
        self._begin(Spacing())
        self.add(ON_THE_SPOT, tolerances=ROUGH)
        spot = self.fits.get(ON_THE_SPOT)
        if spot is None or not gyro_is_usual(spot):
            return None
        # With dead axes, only a rest shows that a constant force is no centripetal acceleration.
        return spot if all(self.nodes.working) or spot.point.course.still.any() else None

    def add(
        self,
        name: str,
        like: Fit | None = None,
        tolerances: Tolerances = Tolerances(),
        priors: Priors | None = None,
        *,
        ends_early: bool = True,
    ) -> None:
        """Fit one kind of motion, and keep the fit if it is the most likely one of its kind.

        `priors` are those of this kind alone, if they differ from those of the others. With
        `ends_early` the fit ends as soon as its evidence cannot come near that of the others.
        """
        done, self._started = self._started, self._started + 1

        def report(rounds: int) -> None:
            if self._progress is not None:
                # How many rounds it takes is not known beforehand.
                share = rounds / (rounds + 0.5 * ROUGH.rounds)
                # Of a drive: each kind roughly, the likeliest to the end, the others from it.
                most = 2 * len(KINDS) + 1
                self._progress(min((done + share) / most, 1.0))

        priors = self._priors if priors is None else priors
        start = self.nodes, priors, self._state, KINDS.get(name, KINDS[ON_THE_SPOT])
        known = self.fits.get(name)
        rival = self._equal_weight(name) if ends_early else math.inf
        found = fit(*start, tolerances, like, report, rival)
        if found is None:
            return
        if not is_possible(found):
            self._impossible = True
            return
        # A fit that continues the known one replaces it, which had not converged.
        if known is None or like is known or found.evidence < known.evidence:
            self.fits[name] = found

    def _equal_weight(self, name: str) -> float:
        """Return the evidence at which a kind of motion has the weight of the likeliest other."""
        # With the same weights as in `mixture_of_kinds`.
        own = math.log(self._usual.get(name, 1.0))
        others = [
            each.evidence + (own - math.log(self._usual.get(other, 1.0))) / EVIDENCE_WEIGHT
            for other, each in self.fits.items()
            if other != name
        ]
        return min(others, default=math.inf)

    def field_late(self) -> Fit:
        """Return the better fit of a turn on the spot, with or without a delayed field.

        In a turn between rests at one heading, a delayed field resembles the field of motors. Each
        is a separate optimum, and the iterations find that of the motors first.
        """
        spot = self.fits[ON_THE_SPOT]
        groups = spot.point.groups
        if max(groups[name] for name in MOTORS) < BEYOND_USUAL:
            return spot
        shared = spot.state.shared.copy()
        shared[AT["latency"]] = USUALLY_LATE
        for name in MOTORS:
            shared[AT[name]] = 0.0
        usual = dict.fromkeys(MOTORS, 1.0)
        usual["latency"] = USUALLY_LATE / UNKNOWNS["latency"].sigma[0]
        point = replace(
            spot.point, state=replace(spot.state, shared=shared), groups={**groups, **usual}
        )
        self.add(LATE, replace(spot, point=point))
        return min(self.fits.values(), key=lambda each: each.evidence)

    def something_passes(self) -> None:
        """Fit a turn on the spot of exact sensors again, with something magnetic that passes."""
        like = without_distortion(self.fits[ON_THE_SPOT])
        self.add(PASSED, like, priors=self._priors.with_something_passing)

    def parts_moved(self, usual: Fit) -> Fit:
        """Return the likelier fit of a turn on the spot, with or without parts that are moved.

        Without moved parts, soft iron and installation absorb a lasting step of the field: they
        start at their means here. The likelier explanation is used for other kinds of motion, too.
        """
        priors = self._priors.with_parts_moved
        point, shared = usual.point, usual.state.shared.copy()
        for name in CONFOUNDED:
            shared[AT[name]] = priors.mean[AT[name]]
        state = replace(usual.state, shared=shared)
        groups = {**point.groups, **dict.fromkeys(CONFOUNDED, 1.0)}
        like = replace(usual, point=replace(point, state=state, groups=groups))
        self.add(MOVED, like, priors=priors)
        moved = self.fits.get(MOVED, usual)
        if moved.evidence >= self._equal_weight(MOVED):
            return usual
        self._priors = priors
        return moved

    def in_other_ways(self, spot: Fit) -> None:
        """Fit a circle and a drive, too, although a turn on the spot explains the samples."""
        kinds = SMALL_CIRCLE, ON_WHEELS
        # At the optimum on the spot, acceleration counts as tilt. Without a rest, the path is known
        # only at the optimum of a fit. Before, its evidence is too bad to compare it with others.
        for name in kinds if may_drive(spot) or not all(self.nodes.working) else ():
            self.add(name, ends_early=bool(spot.point.course.still.any()))
        found = [spot, *(self.fits[name] for name in kinds if name in self.fits)]
        likeliest = min(found, key=lambda each: each.evidence)
        for name in kinds:
            if self.fits.get(name) is not likeliest:
                self.add(name, likeliest)

    def drives(self) -> None:
        """Fit all other kinds of motion, for a robot that certainly did not turn on the spot."""
        self._begin(WHILE_DRIVING)
        self._without_false_rests()
        for name in DRIVES if self._samples.rolls else KINDS:
            if name != ON_THE_SPOT and name not in self.fits:
                self.add(name, tolerances=UNTIL_PLACES)
        self._started = max(self._started, len(KINDS))
        if not self.fits:
            return
        first = self._likeliest
        if not self.fits[first].converged:
            self.add(first, self.fits[first])
        # The others stopped early, or at a local optimum that is worse than the best fit.
        for name in [*(other for other in self.fits if other != first), first]:
            if name != self._likeliest:
                self.add(name, self.fits[self._likeliest])

    @property
    def _likeliest(self) -> str:
        return min(self.fits, key=lambda name: self.fits[name].evidence)

    def _without_false_rests(self) -> None:
        """Drop the rests if that is more likely: driving on a smooth road may look like a rest."""
        self.add(ON_WHEELS, tolerances=UNTIL_PLACES)
        if self._samples.rested is not None or not self.nodes.quiet.any():
            return
        resting, rested = self.nodes, self.fits.pop(ON_WHEELS, None)
        self.nodes = replace(resting, quiet=np.zeros(len(resting), dtype=np.bool_))
        # From the same start and for as many rounds as the fit with rests, to be comparable.
        self.add(ON_WHEELS, tolerances=UNTIL_PLACES)
        moved = self.fits.get(ON_WHEELS)
        if rested is not None and (moved is None or rested.evidence < moved.evidence):
            self.nodes, self.fits[ON_WHEELS] = resting, rested

    def drives_roughly(self) -> None:
        """Fit only the most usual kind of drive, with few iterations."""
        self._begin(WHILE_DRIVING)
        self._without_false_rests()

    def mixture_of_kinds(self) -> Smoothed:
        """Return the weighted result of the fits."""
        if not self.fits and self._impossible:
            raise Refusal(Reason.AXES_DISAGREE, DIFFERENT_TURNS)
        if not self.fits:
            raise Refusal(Reason.NO_SOLUTION, NO_SOLUTION)
        return mixture_of_kinds(self.fits, self.nodes, self._knowledge, self._usual)


def part_with_most_motion(window: Window) -> Window | None:
    """Return the part of a long window in which the force changes most.

    None if the window is short or the part has too few samples.
    """
    time, force = window.time, window.specific_force
    if len(time) == 0 or time[-1] - time[0] < 2.0 * PART:
        return None
    deviation = np.sum((force - np.median(force, axis=0)) ** 2, axis=1)
    done = integral(time, deviation)
    begin = np.arange(time[0], time[-1] - PART, 0.1 * PART)
    gained = np.interp(begin + PART, time, done) - np.interp(begin, time, done)
    first = float(begin[np.argmax(gained)])
    rows = (time >= first) & (time <= first + PART)
    return None if np.count_nonzero(rows) < FEWEST_OF_PART else window.take(rows)


def smooth(
    window: Window,
    knowledge: Knowledge,
    progress: Callable[[float], object] | None = None,
) -> Smoothed:
    """Fit a window for each kind of motion, and weight the fits by their evidence.

    The window has a gyro. `progress` is called with the fraction of the work that is done. Raises
    `Refusal` if no fit is possible.
    """
    trials = _MotionFits(window, knowledge, progress)
    if (spot := trials.on_the_spot()) is not None:
        if not spot.converged:
            trials.add(ON_THE_SPOT, spot)
        best = trials.field_late()
        if knowledge.exact_sensors:
            trials.something_passes()
        else:
            best = trials.parts_moved(best)
            trials.in_other_ways(best)
    else:
        trials.drives()
    return trials.mixture_of_kinds()


def expected_sigma(window: Window, knowledge: Knowledge) -> float:
    """Return an approximate sigma of the heading on the level by `smooth`, radians.

    Parameters and errors as for `smooth`. It takes less time (two fifths for a drive): only two
    fits are made, with few iterations.
    """
    trials = _MotionFits(window, knowledge)
    if (spot := trials.on_the_spot()) is not None:
        trials.add(SMALL_CIRCLE, spot, ROUGH)
    else:
        trials.drives_roughly()
    return trials.mixture_of_kinds().posterior.heading_sigma


def may_drive(spot: Fit) -> bool:
    """Return whether a turn on the spot leaves open that the robot drove.

    Without a rest, a constant force may be the centripetal acceleration of a circle. A noise beyond
    a sigma of its prior may have another cause: that of the force an acceleration that changes,
    that of the motors a local disturbance that changes from place to place.
    """
    usual = spot.model.priors.sizes
    noises = [(spot.point.sizes[name], usual[name]) for name in ("force", "motors_noise")]
    is_large = any(size > prior.usual * math.exp(prior.spread) for size, prior in noises)
    return is_large or not bool(spot.point.course.still.any())


def gyro_is_usual(fit: Fit) -> bool:
    """Return whether the estimated noise of the gyro is plausible, and its axes are not dead."""
    prior = fit.model.priors.sizes
    return all(
        fit.point.sizes[name] < NEAR_LIMIT * SIZES[name].most
        for name in ("gyro", "gyro_up")
        if prior[name] == SIZES[name]
    )


def mixture_of_kinds(
    fits: dict[str, Fit], nodes: Nodes, knowledge: Knowledge, usual: Mapping[str, float] = USUAL
) -> Smoothed:
    """Return fits with their weights: evidence times the prior weight of the kind of motion."""
    least = min(each.evidence for each in fits.values())
    odds = {
        n: usual.get(n, 1.0) * math.exp(-EVIDENCE_WEIGHT * min(f.evidence - least, 700.0))
        for n, f in fits.items()
    }
    weights = {name: value / sum(odds.values()) for name, value in odds.items()}
    best = max(weights, key=lambda name: weights[name])
    found = {name: posterior(each, knowledge.mounting.matrix) for name, each in fits.items()}
    mean = mixture(found, weights, best)
    square = sum(
        weights[name]
        * (each.distance_to(mean) ** 2 + rms_sigma(each.heading_jacobian, each.by_offset) ** 2)
        for name, each in found.items()
    )
    return Smoothed(nodes, best, fits, weights, mean, math.sqrt(square))


def is_possible(fit: Fit, largest_gain: float = LARGEST_GAIN) -> bool:
    """Return whether the soft iron of a fit neither mirrors the field nor amplifies it too much."""
    least, _, most = np.linalg.eigvalsh(soft_iron(fit.state.shared))
    return bool(least > 0.0 and most < largest_gain)


def mixture(found: dict[str, Posterior], weights: dict[str, float], mode: str) -> Posterior:
    """Return the mean of the twelve numbers over all fits, with its covariance."""
    mean = np.sum([weights[name] * each.numbers for name, each in found.items()], axis=0)
    joint = np.zeros((len(mean), len(mean)))
    for name, each in found.items():
        off = each.numbers - mean
        joint += weights[name] * (each.joint + np.outer(off, off))
    return replace(found[mode], numbers=mean, joint=joint)
