"""From the nodes of a drive to a calibration with its certainty."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.smoothing.certainty import Twelve, twelve_of
from magcal_ros.core.smoothing.descent import Problem, Sizes, Smoothed, descend, smooth
from magcal_ros.core.smoothing.drive_model import (
    DOWN_FIELD,
    GYRO_BIAS,
    IRON,
    LEVEL_FIELD,
    SHARED,
    SOFT,
    SharedPrior,
    Unknowns,
    free_prior,
    held_prior,
    turned_into,
)
from magcal_ros.core.smoothing.nodes import MICROTESLA, Nodes
from magcal_ros.core.smoothing.tuning import TUNING, SmootherTuning

SECTORS = 12


@dataclass(frozen=True, eq=False)
class DriveFit:
    """What a drive shows."""

    smoothed: Smoothed
    twelve: Twelve
    """The calibration."""
    level_pull: float
    """Level field found less the one believed, in sigmas of the belief."""

    @property
    def nodes(self) -> Nodes:
        """What was fitted."""
        return self.smoothed.problem.nodes

    @property
    def sectors(self) -> int:
        """How many of twelve sectors of 30° were driven with the iron that is sought."""
        return sectors_of(self.smoothed.unknowns.yaw[self.nodes.has_iron > 0.0])

    @property
    def metres(self) -> float:
        """How far was driven; a guess where nobody measures it."""
        return float(self.nodes.metres.sum())

    @property
    def seconds(self) -> float:
        """How long the drive took, standing included, with the hard iron that is sought."""
        return float(self.nodes.time[-1] - max(self.nodes.time[0], self.nodes.iron_from))


def sectors_of(yaw: FloatArray) -> int:
    """Return how many of twelve sectors yaws fall into."""
    return len(np.unique(_sector(yaw)))


def _sector(yaw: FloatArray) -> IntArray:
    return (np.mod(yaw, math.tau) / (math.tau / SECTORS)).astype(np.int64) % SECTORS


def fit_nodes(nodes: Nodes, knowledge: Knowledge, tuning: SmootherTuning = TUNING) -> DriveFit:
    """Find all twelve numbers from a drive.

    Parameters
    ----------
    nodes : Nodes
    knowledge : Knowledge
    tuning : SmootherTuning

    Raises
    ------
    Refusal
        `TOO_FEW_SAMPLES` of too short a drive, `NO_SOLUTION` where no fit converges.
    """
    if len(nodes) < tuning.fewest_nodes:
        raise Refusal(
            Reason.TOO_FEW_SAMPLES,
            f"only {len(nodes)} half seconds of movement; at least {tuning.fewest_nodes} are"
            " needed: drive on",
        )
    if nodes.tied_share < tuning.least_tied:
        raise Refusal(
            Reason.AXES_DISAGREE,
            "for most of the drive the gyro is not heard: its stamps come in bursts, or too seldom;"
            " stamp each sample when it is measured, not when a buffer is read",
        )
    believed = free_prior(knowledge, tuning)
    start, prior = linear_start(nodes, believed, tuning)
    declination = knowledge.reference.declination or 0.0
    weakened = start.shared[LEVEL_FIELD] < tuning.weak * believed.mean[LEVEL_FIELD]
    if weakened and not knowledge.reference.strength.is_unknown:
        prior = uneven(prior, tuning)
    smoothed = smooth(Problem(nodes, prior, declination, Sizes(), tuning), start)
    if smoothed is None or not np.isfinite(smoothed.unknowns.shared).all():
        raise Refusal(
            Reason.NO_SOLUTION,
            "no calibration follows the gyro along this drive; check the axes of both sensors",
        )
    found = smoothed.unknowns.shared[LEVEL_FIELD]
    pull = float((found - believed.mean[LEVEL_FIELD]) / believed.sigma[LEVEL_FIELD])
    strain = max(1.0, abs(pull) / tuning.no_strain)
    try:
        twelve = twelve_of(smoothed, knowledge.mounting.matrix, strain)
    except (ValueError, np.linalg.LinAlgError) as fault:
        raise Refusal(
            Reason.AXES_DISAGREE,
            "along the drive the field does not turn as the gyro does; check that the axes of both"
            " sensors belong together",
        ) from fault
    return DriveFit(smoothed, twelve, pull)


def uneven(prior: SharedPrior, tuning: SmootherTuning = TUNING) -> SharedPrior:
    """Return the prior for a body that takes much of the level field away, and unevenly."""
    covariance = prior.covariance.copy()
    rows = np.arange(len(covariance))[SOFT]
    covariance[rows, rows] = tuning.widest_soft_iron**2
    return replace(prior, covariance=covariance)


def corrected(nodes: Nodes, correction: Correction, to_sensor: FloatArray) -> Nodes:
    """Return the nodes with their field corrected by a calibration.

    Parameters
    ----------
    nodes : Nodes
        In nominal body axes.
    correction : Correction
    to_sensor : ndarray, shape (3, 3)
        `Mounting.matrix`.
    """
    raw = nodes.field @ to_sensor.T / MICROTESLA
    return replace(nodes, field=MICROTESLA * correction.apply(raw))


def fit_iron(
    nodes: Nodes,
    correction: Correction,
    knowledge: Knowledge,
    tuning: SmootherTuning = TUNING,
) -> DriveFit | None:
    """Find what was added to the hard iron since a calibration was made.

    Parameters
    ----------
    nodes : Nodes
    correction : Correction
        The calibration; its matrix is kept but for the little that the priors allow.
    knowledge : Knowledge
    tuning : SmootherTuning

    Returns
    -------
    DriveFit or None
        Its `twelve` is of the raw field. None where too little was driven.
    """
    if len(nodes) < tuning.fewest_for_iron or nodes.tied_share < tuning.least_tied:
        return None
    inside = corrected(nodes, correction, knowledge.mounting.matrix)
    believed = held_prior(
        free_prior(knowledge, tuning),
        iron=True,
        tilt=tuning.kept_tilt,
        soft_iron=tuning.kept_soft_iron,
    )
    start, prior = linear_start(inside, believed, tuning)
    declination = knowledge.reference.declination or 0.0
    smoothed = smooth(Problem(inside, prior, declination, Sizes(), tuning), start, reviews=2)
    if smoothed is None:
        return None
    return DriveFit(smoothed, added_to(correction, smoothed), 0.0)


def added_to(correction: Correction, smoothed: Smoothed) -> Twelve:
    """Return the twelve numbers of the raw field, from a fit to a field corrected before."""
    change = twelve_of(smoothed, np.eye(3))
    # A = A1 A0 and h = h0 + A0^-1 h1: how the twelve numbers follow those of the change.
    by_change = np.zeros((12, 12))
    by_change[:9, :9] = np.kron(np.eye(3), correction.matrix.T)
    by_change[9:, 9:] = np.linalg.inv(correction.matrix)
    covariance = by_change @ change.covariance @ by_change.T
    return replace(change, correction=change.correction.after(correction), covariance=covariance)


def held_fit(
    nodes: Nodes,
    correction: Correction,
    knowledge: Knowledge,
    sizes: Sizes,
    tuning: SmootherTuning = TUNING,
) -> Smoothed | None:
    """Let the nodes' yaw, their street and the Earth's field follow a calibration that is held.

    Parameters
    ----------
    nodes : Nodes
    correction : Correction
    knowledge : Knowledge
    sizes : Sizes
        The same for all that are compared.
    tuning : SmootherTuning

    Returns
    -------
    Smoothed or None
        `here.cost` of two calibrations on the same nodes can be compared.
    """
    return _held(corrected(nodes, correction, knowledge.mounting.matrix), knowledge, sizes, tuning)


def _held(
    inside: Nodes, knowledge: Knowledge, sizes: Sizes, tuning: SmootherTuning
) -> Smoothed | None:
    prior = held_prior(free_prior(knowledge, tuning), iron=False)
    start = Unknowns(prior.mean, inside.heading, np.zeros((len(inside), 3)))
    declination = knowledge.reference.declination or 0.0
    problem = Problem(inside, prior, declination, sizes, tuning)
    return descend(problem, aligned(start, inside))


@dataclass(frozen=True, eq=False)
class LikelihoodRatio:
    """The log likelihood ratio of nodes between a new calibration and an old one."""

    gain: float = 0.0
    """Fall of minus twice the log likelihood, over `counts`: neighbours are alike."""
    by_sector: FloatArray = field(default_factory=lambda: np.zeros(SECTORS))
    """What of it each of twelve headings has. Shape (12,)."""

    @property
    def elsewhere(self) -> float:
        """What is left without the quarter of headings that speaks most for the new one."""
        quarters = sum(np.roll(self.by_sector, -shift) for shift in range(SECTORS // 4))
        return float(self.gain - np.max(quarters))

    @property
    def against(self) -> float:
        """What the headings that speak for the old one say together, as a positive number."""
        return float(-np.sum(np.minimum(self.by_sector, 0.0)))


def likelihood_ratio_of(
    old: Nodes, new: Nodes, knowledge: Knowledge, tuning: SmootherTuning = TUNING
) -> LikelihoodRatio:
    """Return the log likelihood ratio of nodes between a new calibration and an old one.

    Parameters
    ----------
    old, new : Nodes
        Corrected by the one and by the other, which both are held; yaw, street and the Earth's
        field are free.
    knowledge : Knowledge
    tuning : SmootherTuning

    Returns
    -------
    LikelihoodRatio
        Nothing where one of them cannot be followed.
    """
    fits = [_held(each, knowledge, Sizes(), tuning) for each in (old, new)]
    if fits[0] is None or fits[1] is None:
        return LikelihoodRatio()
    gain = fits[0].here.cost - fits[1].here.cost
    by_node = fits[0].here.node_costs - fits[1].here.node_costs
    by_sector = np.bincount(_sector(fits[1].unknowns.yaw), by_node, SECTORS)
    return LikelihoodRatio(gain / tuning.counts, by_sector / tuning.counts)


def aligned(start: Unknowns, inside: Nodes) -> Unknowns:
    """Return the start with its yaw turned to where most nodes' corrected field points."""
    level = np.einsum("nji,nj->ni", inside.axes, inside.field)
    seen = np.arctan2(level[:, 0], level[:, 1])
    gap = np.exp(1j * (seen - start.yaw))
    middle = np.angle(gap.mean())
    for _ in range(5):
        away = np.angle(gap * np.exp(-1j * middle))
        middle += float(np.average(away, weights=1.0 / (1.0 + (away / 0.2) ** 2)))
    return replace(start, yaw=start.yaw + middle)


BIASES: FloatArray = np.radians(
    [0.0, -0.1, 0.1, -0.2, 0.2, -0.5, 0.5, -1.0, 1.0, -2.0, 2.0, -3.5, 3.5, -5.0, 5.0]
)
"""rad/s that a gyro may be off by, at rest as well."""


def linear_start(
    nodes: Nodes, prior: SharedPrior, tuning: SmootherTuning = TUNING
) -> tuple[Unknowns, SharedPrior]:
    """Fit field and hard iron in the gyro's axes by IRLS, for several biases; the best is taken.

    Returns
    -------
    Unknowns, SharedPrior
        The prior's hard iron is the start's.
    """
    best, chosen, bias = math.inf, np.zeros(6), 0.0
    clock = np.cumsum(nodes.seconds)
    for trial in BIASES:
        found, misfit = _fitted(nodes, nodes.heading - trial * clock, prior, tuning)
        if misfit < best:
            best, chosen, bias = misfit, found, float(trial)
    shared = prior.mean.copy()
    shared[IRON] = chosen[3:]
    shared[LEVEL_FIELD] = max(math.hypot(chosen[0], chosen[1]), 0.5 * prior.mean[LEVEL_FIELD])
    shared[GYRO_BIAS] = bias
    first = math.atan2(chosen[0], chosen[1])
    yaw = nodes.heading - bias * clock + first
    shared[DOWN_FIELD] = prior.mean[DOWN_FIELD]
    assert len(shared) == SHARED
    return Unknowns(shared, yaw, np.zeros((len(nodes), 3))), prior.about(chosen[3:])


def _fitted(
    nodes: Nodes, heading: FloatArray, prior: SharedPrior, tuning: SmootherTuning
) -> tuple[FloatArray, float]:
    """Return field in the gyro's axes and hard iron (6,), and the median misfit, microtesla."""
    n = len(nodes)
    design = np.concatenate(
        [nodes.axes @ turned_into(heading), np.broadcast_to(np.eye(3), (n, 3, 3))], axis=2
    )
    expected = np.array([0.0, 0.0, -prior.mean[DOWN_FIELD], 0.0, 0.0, 0.0])
    known = np.array([1e-6, 1e-6, tuning.start_field**-2.0, *(prior.sigma[IRON] ** -2.0)])
    rows, read = design.reshape(-1, 6), nodes.field.ravel()
    weight, found, misfit = np.ones(n), expected, math.inf
    for _ in range(tuning.start_rounds):
        weighted = rows * np.repeat(weight, 3)[:, None]
        normal = weighted.T @ rows + n * np.diag(known) * 0.01
        found = np.linalg.solve(normal, weighted.T @ read + n * 0.01 * known * expected)
        size = np.linalg.norm((read - rows @ found).reshape(n, 3), axis=1)
        misfit = float(np.median(size))
        weight = 1.0 / (1.0 + (size / (2.0 * misfit + 1e-9)) ** 2)
    return found, misfit
