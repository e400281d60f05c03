"""Fits of a drive: all numbers, the hard iron alone, and the likelihood ratio of two calibrations.

All use the same model of a drive on wheels. To hold a calibration fixed, the field is corrected
with the calibration, and only those of the twelve numbers that are sought are free.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from magcal_ros.core.calibration.correction import PARAMETERS, Correction
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoother.fit import Fit, Tolerances, fit
from magcal_ros.core.smoother.kinds_of_motion import (
    DIFFERENT_TURNS,
    EVIDENCE_WEIGHT,
    NO_SOLUTION,
    WHILE_DRIVING,
    is_possible,
)
from magcal_ros.core.smoother.nodes import Nodes, nodes_of
from magcal_ros.core.smoother.posterior import Posterior, posterior, posterior_at
from magcal_ros.core.smoother.priors import Priors, priors_of
from magcal_ros.core.smoother.start import start
from magcal_ros.core.smoother.state import SECTORS
from magcal_ros.core.smoother.unknowns import (
    AT,
    EARTH,
    KINDS,
    MICROTESLA,
    ON_WHEELS,
    SHARED,
    UNKNOWNS,
)

FEWEST = 16  # nodes of the shortest drive that is fitted
FIXED = 0.01  # prior spread of the logarithm of a size that is held fixed
TOLERANCES = Tolerances(rounds=60, step=0.2)
HELD = (
    "installation",
    "axes",
    "soft_iron",
    "shielding",
    "motors_moving",
    "motors_rate",
    "drift",
    "force_moving",
)
"""The unknowns that are held at zero after correction by a calibration."""
KEPT_TILT, KEPT_SOFT_IRON = math.radians(0.5), 0.002
"""Sigmas of the small changes of installation and soft iron that `fit_iron` allows."""


@dataclass(frozen=True, eq=False)
class DriveFit:
    """The fit of a change of hard iron to a drive."""

    fit: Fit
    posterior: Posterior  # of the raw field

    @property
    def sectors(self) -> int:
        """Number of heading sectors, of twelve, that were driven with the changed hard iron."""
        return len(np.unique(self.fit.state.sector[self._counted]))

    @property
    def seconds(self) -> float:
        """Duration of the drive with the changed hard iron, seconds."""
        return float(np.ptp(self.fit.model.nodes.time[self._counted]))

    @property
    def street(self) -> float:
        """Size of the local disturbance, tesla per axis."""
        return self.fit.point.sizes["street"] / MICROTESLA

    @property
    def local_field(self) -> float:
        """Local disturbance and fluctuating field of the motors together, tesla per axis."""
        return self.fit.local_field / MICROTESLA

    @property
    def noise(self) -> float:
        """Noise of a node's field, tesla per axis."""
        return self.fit.point.sizes["field"] / MICROTESLA

    @property
    def _counted(self) -> IntArray:
        nodes = self.fit.model.nodes
        is_added = math.isfinite(nodes.added_from)
        return np.flatnonzero(nodes.time > (nodes.added_from if is_added else -math.inf))


def drive_nodes(log: Window, to_body: FloatArray) -> Nodes:
    """Return the nodes of a drive; `to_body` as for `nodes_of`."""
    return nodes_of(log, to_body, WHILE_DRIVING)


def fit_drive(log: Window, nodes: Nodes, knowledge: Knowledge) -> DriveFit:
    """Return the fit of all twelve numbers to a drive on wheels.

    The nodes are those of the log. Raises `Refusal`: `TOO_FEW_SAMPLES` if the drive is too short,
    `NO_SOLUTION` if the fit fails, `AXES_DISAGREE` if the gyro or the axes are wrong.
    """
    check_length(nodes)
    priors = priors_of(knowledge, log.bias_sigma).with_dead_axes(nodes.working)
    state, about = start(nodes, priors)
    found = fit(nodes, about, state, KINDS[ON_WHEELS], TOLERANCES)
    if found is None:
        raise Refusal(Reason.NO_SOLUTION, NO_SOLUTION)
    if not is_possible(found):
        raise Refusal(Reason.AXES_DISAGREE, DIFFERENT_TURNS)
    return DriveFit(found, posterior(found, knowledge.mounting.matrix))


def check_length(nodes: Nodes) -> None:
    """Raise `Refusal` if a drive is too short, or its gyro is missing for too long."""
    refusal = why_too_little(nodes)
    if refusal is not None:
        raise refusal


def why_too_little(nodes: Nodes) -> Refusal | None:
    """Return the refusal if the drive is too short or the gyro is missing, else None."""
    if len(nodes) < FEWEST:
        return Refusal(
            Reason.TOO_FEW_SAMPLES,
            f"only {len(nodes) * WHILE_DRIVING.longest:.0f} s of movement; at least"
            f" {FEWEST * WHILE_DRIVING.longest:.0f} s are needed: drive for longer",
        )
    if np.mean(nodes.is_tied) < 0.5:
        return Refusal(
            Reason.AXES_DISAGREE,
            "gyro samples are missing for most of the drive: the stamps come in bursts or too"
            " seldom; stamp each sample when it is measured, not when a buffer is read",
        )
    return None


def corrected(nodes: Nodes, correction: Correction, to_sensor: FloatArray) -> Nodes:
    """Return the nodes with their field corrected by a calibration.

    The nodes are in nominal body axes; `to_sensor` (3, 3) is `Mounting.matrix`.
    """
    raw = nodes.field @ to_sensor.T / MICROTESLA
    return replace(nodes, field=MICROTESLA * correction.apply(raw))


def held_priors(
    nodes: Nodes, knowledge: Knowledge, iron: FloatArray, *, may_change: bool = False
) -> Priors:
    """Return the priors for a field corrected with a calibration that is held fixed.

    `iron` (3,) is the sigma of the remaining hard iron, µT. `may_change` allows small changes of
    installation and soft iron. The nodes are those that will be fitted.
    """
    priors = priors_of(knowledge).with_dead_axes(nodes.working)
    scales: dict[str, FloatArray | float] = {
        **dict.fromkeys(HELD, 0.0),
        # Up is taken as measured: only an offset along z is free, which does not tilt up.
        "force_offset": priors.scale[AT["force_offset"]] * [0.0, 0.0, 1.0],
        "iron": iron,
    }
    if may_change:
        scales |= {"installation": KEPT_TILT, "soft_iron": KEPT_SOFT_IRON}
    return priors.with_scales(scales, fixed=["installation", "soft_iron"])


def held_fit(inside: Nodes, priors: Priors) -> Fit | None:
    """Return the fit of corrected nodes; None if it fails."""
    state, about = start(inside, priors)
    mean = about.mean.copy()
    # The expected remaining hard iron is zero, not that of the start.
    mean[AT["iron"]] = priors.mean[AT["iron"]]
    shared = mean.copy()
    for which in (AT["gyro_bias"], EARTH):
        shared[which] = state.shared[which]
    priors, state = replace(priors, mean=mean), replace(state, shared=shared)
    return fit(inside, priors, state, KINDS[ON_WHEELS], TOLERANCES)


def fit_iron(nodes: Nodes, correction: Correction, knowledge: Knowledge) -> DriveFit | None:
    """Return the fit of the change of hard iron since a calibration was made.

    The matrix of the correction is kept, apart from the small changes that the priors allow. The
    result refers to the raw field. None if the drive is too short or the fit fails.
    """
    if why_too_little(nodes) is not None:
        return None
    inside = corrected(nodes, correction, knowledge.mounting.matrix)
    free = np.array(UNKNOWNS["added"].sigma)
    found = held_fit(inside, held_priors(inside, knowledge, free, may_change=True))
    return None if found is None else added_to(correction, found, AT["iron"])


def added_to(correction: Correction, found: Fit, iron: slice) -> DriveFit:
    """Return the posterior of the raw field's calibration, from a fit to the corrected field."""
    swapped = np.arange(SHARED)
    swapped[AT["iron"]], swapped[iron] = swapped[iron].copy(), swapped[AT["iron"]].copy()
    state = replace(found.state, shared=found.state.shared[swapped])
    change = posterior_at(state, found.covariance[np.ix_(swapped, swapped)], np.eye(3))
    # Derivatives of the twelve numbers by those of the change: A = A1 A0 and h = h0 + A0^-1 h1.
    by_change = np.eye(len(change.numbers))
    by_change[:9, :9] = np.kron(np.eye(3), correction.matrix.T)
    by_change[9:12, 9:12] = np.linalg.inv(correction.matrix)
    numbers = change.numbers.copy()
    numbers[:PARAMETERS] = change.correction.after(correction).parameters
    joint = by_change @ change.joint @ by_change.T
    return DriveFit(found, replace(change, numbers=numbers, joint=joint))


@dataclass(frozen=True, eq=False)
class LikelihoodRatio:
    """The log likelihood ratio of nodes between a new calibration and an old one."""

    by_node: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Log likelihood ratio of each node, weighted by `EVIDENCE_WEIGHT`. Shape (n,)."""
    sector: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    """Heading sector of each node by the new calibration, 0 to 11. Shape (n,)."""
    seconds: float = 0.0  # duration of the nodes

    @property
    def gain(self) -> float:
        """The ratio over all nodes."""
        return float(self.by_node.sum())

    def log_odds(self, local: float) -> float:
        """Return the ratio if the old calibration may come with a local disturbance.

        With the prior probability `local`, the field was disturbed at one quarter of the headings,
        as by steel on one side of all roads, or during one half of the time. The disturbance
        explains the nodes there as well as the new calibration does.
        """
        first = np.arange(len(self.by_node)) < len(self.by_node) // 2
        quarters = (self.sector - np.arange(SECTORS)[:, None]) % SECTORS < SECTORS // 4
        elsewhere = ~np.vstack([quarters, first, ~first]) @ self.by_node
        disturbed = np.logaddexp.reduce(-elsewhere) + math.log(local / len(elsewhere))
        return -float(np.logaddexp(math.log1p(-local) - self.gain, disturbed))


def likelihood_ratio_of(old: Nodes, new: Nodes, knowledge: Knowledge) -> LikelihoodRatio:
    """Return the log likelihood ratio of nodes between a new calibration and an old one.

    The nodes are corrected by the old and by the new calibration, and both calibrations are held.
    The ratio is empty if one of the two fits fails.
    """
    priors = held_priors(old, knowledge, np.zeros(3))
    fits = [held_fit(each, priors) for each in (old, new)]
    known = [each for each in fits if each is not None]
    if len(known) < len(fits):
        return LikelihoodRatio()
    # Costs are comparable at the same noise sizes only.
    likelier = min(known, key=lambda each: each.evidence)
    sizes = {
        name: priors.sizes[name]._replace(usual=size, spread=FIXED)
        for name, size in likelier.point.sizes.items()
    }
    before, after = (held_fit(each, replace(priors, sizes=sizes)) for each in (old, new))
    if before is None or after is None:
        return LikelihoodRatio()
    by_node = EVIDENCE_WEIGHT * (_costs(before) - _costs(after))
    return LikelihoodRatio(by_node, after.state.sector, float(np.ptp(old.time)))


def _costs(found: Fit) -> FloatArray:
    """Return minus twice the log likelihood of each node and of the link before it, shape (n,)."""
    count = len(found.model.nodes)
    total = np.zeros(count)
    for part in found.weighted.values():
        total[count - len(part.chi2) :] += part.costs
    return total
