"""The limits of self-calibration, its candidates, and by how much calibrations differ."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration, Evidence
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import (
    calibration_sigma,
    headings_apart,
    known_sigma,
    local_sigma,
)

if TYPE_CHECKING:
    from magcal_ros.core.smoother.drives import DriveFit


@dataclass(frozen=True)
class KeepingTuning:
    """Numbers of self-calibration; seconds are of movement."""

    look_every: float = 20.0
    look_again: float = 10.0
    """Seconds between two looks, and while a changed hard iron is on probation."""
    windows: tuple[float, ...] = (120.0, 200.0, 300.0, 420.0)
    """Seconds of road to which all twelve numbers are fitted."""
    look_back: float = 240.0
    shortest_since: float = 25.0
    """Seconds of road in which a change is looked for, and the least of the road since it to which
    the hard iron is fitted."""
    notice_differs: float = 4.0
    notice_proof: float = 2.0
    """How many sigmas a changed hard iron must differ from what is in force to be told, and by how
    many units of log likelihood the road before and since must be likelier with it."""
    plainly: float = 0.2
    """Share of the difference from what is in force that a changed hard iron may be uncertain
    by."""
    largest_sigma: float = math.radians(3.0)
    """Radians of heading beyond which a candidate is not believed."""
    fewest_sectors: int = 6
    fewest_for_iron: int = 4
    """Of twelve headings that all twelve numbers need, and the hard iron alone."""
    differs: float = 2.0
    """Sigmas within which two calibrations agree: then nothing is to be mended."""
    much_better: float = 0.6
    """Share of the other's sigma below which it is taken up all the same. Where that is beyond
    `largest_sigma` and both agree, this is enough."""
    longest_probation: float = 180.0
    longest_trial: float = 300.0
    """Seconds of road after which a candidate that has not proved itself is dropped, and one in
    force is no longer compared with the one before."""
    likelihood_proof: float = 12.0
    iron_proof: float = 8.0
    """Fall of minus log likelihood, independent units, on the road of probation, with a rise in
    neither half; less is asked of a hard iron, which was far off already to be noticed."""
    elsewhere_proof: float = 2.0
    """Units of it that must be left without the quarter of headings that speaks most, where all
    twelve numbers are new."""
    most_against: float = 1.5
    """Units that the headings which speak against a changed hard iron may have together."""
    usual_speed: float = 5.0
    """m/s of a robot whose speed is not measured."""
    memory: float = 600.0
    """Seconds of road that are remembered."""
    map_every: float = 0.5
    """Seconds between points of the map of a drive."""
    kept: int = 3
    remembered: int = 20
    """Calibrations before the one in force, and decisions, that are kept."""


KEEPING = KeepingTuning()


METHOD = "smoother"


class Kind(str, Enum):
    """What of a calibration was fitted."""

    ALL = "all"
    IRON = "iron"


@dataclass(frozen=True, eq=False)
class DriveCandidate:
    """A calibration that a stretch of road shows.

    Parameters
    ----------
    kind : Kind
    calibration : Calibration
    sigma : float
        Radians of heading, as it says.
    sectors : int
        Of twelve headings driven.
    start, end : float
        Clock of the road that it was fitted to, seconds.
    """

    kind: Kind
    calibration: Calibration
    sigma: float
    sectors: int
    start: float
    end: float

    @property
    def seconds(self) -> float:
        """How much road it was fitted to."""
        return self.end - self.start

    @property
    def in_words(self) -> str:
        """What it is, for a person."""
        what = "calibration" if self.kind is Kind.ALL else "hard iron"
        return (
            f"a {what} from {self.seconds:.0f} s of driving, {self.sectors} of 12 headings,"
            f" ±{math.degrees(self.sigma):.1f}°"
        )


def candidate_of(
    fitted: DriveFit, kind: Kind, before: Calibration | None, start: float, end: float
) -> DriveCandidate:
    """Bring a fit into the form that is put in force.

    Parameters
    ----------
    fitted : DriveFit
    kind : Kind
    before : Calibration or None
        What was in force while it was driven.
    start, end : float
        Clock of the road, seconds.
    """
    sigma = fitted.posterior.heading_sigma
    covariance = fitted.posterior.covariance
    if kind is Kind.IRON and before is not None:
        # The matrix is the old one's, and so is its uncertainty.
        covariance = np.zeros_like(covariance)
        covariance[:9, :9] = before.covariance[:9, :9]
        covariance[9:, 9:] = fitted.posterior.covariance[9:, 9:]
    words = (
        f"Calibrated from {fitted.seconds:.0f} s of ordinary driving, {fitted.sectors} of 12"
        f" headings: heading ±{math.degrees(sigma):.1f}° on the level (1σ) by the calibration"
    )
    figures = {
        Figure.HEADINGS_DRIVEN.value: float(fitted.sectors),
        Figure.DRIVING_TIME.value: fitted.seconds,
        Figure.STREET.value: fitted.street,
        Figure.LOCAL_FIELD.value: fitted.local_field,
    }
    # The road was driven without the motors' field as it is known.
    motors = None if before is None else before.motors
    motors = None if motors is None else motors.with_another_calibration()
    calibration = Calibration(
        fitted.posterior.correction,
        covariance,
        fitted.noise,
        0.01 if before is None else before.noise_up,
        fitted.posterior.strength,
        fitted.posterior.inclination,
        Evidence(METHOD, "good", "good", words, figures=figures),
        motors,
    )
    by_place = local_sigma(calibration)
    figures[Figure.LOCAL_SIGMA.value] = by_place
    figures[Figure.HEADING_SIGMA.value] = math.hypot(sigma, by_place)
    return DriveCandidate(
        kind,
        replace(calibration, evidence=replace(calibration.evidence, figures=figures)),
        sigma,
        fitted.sectors,
        start,
        end,
    )


def is_another(candidate: DriveCandidate, in_force: Calibration) -> bool:
    """Whether a candidate differs from what is in force by more than both are uncertain."""
    apart = difference(in_force, candidate.calibration)
    return apart > KEEPING.differs * math.hypot(candidate.sigma, calibration_sigma(in_force))


def is_finer(candidate: DriveCandidate, in_force: Calibration) -> bool:
    """Whether a candidate agrees with what is in force, and is known much better."""
    is_better = candidate.sigma < KEEPING.much_better * known_sigma(in_force)
    return is_better and not is_another(candidate, in_force)


def difference(old: Calibration, new: Calibration) -> float:
    """Return the RMS over headings by which two calibrations differ, radians.

    The constant is taken off: no drive shows it.
    """
    apart = headings_apart(new.correction, old.correction, new.strength, new.inclination)
    turn = np.exp(1j * apart)
    return math.sqrt(float(np.mean(np.angle(turn / turn.mean()) ** 2)))
