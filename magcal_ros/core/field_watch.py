"""Whether the field of the moment is the one that was calibrated, or something bends it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from magcal_ros.core.triples import Triple, dot, length

STRENGTH_TOLERANCE = 0.02
"""Share of its strength by which a good field varies from place to place (1 σ)."""
DIP_TOLERANCE = math.radians(1.0)
NOISE_SHARE = 2.0
"""Sigmas of the calibration's field noise that are added to both."""
IGNORED_FROM = 3.0
"""Sigmas of departure from which a field is no compass."""
PATIENCE = 60.0
"""Seconds after which a departed field is taken for the expected one, unless told otherwise."""
BELIEVED_BELOW = 2.0
"""Sigmas to which an ignored field must come back."""
MEMORY = 0.3
"""Seconds over which strength and dip are averaged."""


class Trust(str, Enum):
    """How the field of the moment is taken."""

    GOOD = "good"
    WEIGHED_DOWN = "weighed down"
    IGNORED = "ignored"


@dataclass(frozen=True)
class Disturbance:
    """A spell in which the field was not the expected one.

    Parameters
    ----------
    since, until : float
        Stamps, seconds.
    yaw : float
        Where the robot looked when it began, radians, ENU to magnetic north.
    strength : float
        Largest departure of the strength, as a share of the expected one.
    dip : float
        Largest departure of the inclination, radians.
    is_accepted : bool
        Whether it lasted for so long that the new field was taken for the expected one.
    """

    since: float
    until: float
    yaw: float
    strength: float
    dip: float
    is_accepted: bool = False

    @property
    def in_words(self) -> str:
        """One line for a person."""
        line = (
            f"strength {100.0 * self.strength:+.0f}%, dip {math.degrees(self.dip):+.0f}° "
            f"for {self.until - self.since:.0f} s from {self.since:.1f} s, "
            f"looking to {math.degrees(self.yaw):.0f}°"
        )
        return f"{line}; accepted because it lasted" if self.is_accepted else line


@dataclass(frozen=True)
class Expected:
    """A field by what is the same at every heading: tesla, and radians below the horizon."""

    strength: float
    inclination: float


class FieldWatch:
    """Compares the corrected field with what the calibration expects.

    Parameters
    ----------
    expected : Expected
        The calibrated field.
    noise_field : float
        Tesla per axis of one sample.
    patience : float
        Seconds after which a departed field is taken for the expected one.

    Attributes
    ----------
    trust : Trust
        How the newest sample is to be taken.
    departure : float
        Its departure in sigmas.
    last : Disturbance or None
        The newest spell of disturbance.
    """

    def __init__(self, expected: Expected, noise_field: float, patience: float) -> None:
        self.patience = patience
        self.trust = Trust.GOOD
        self.departure = 0.0
        self.last: Disturbance | None = None
        self._calibrated = self._expected = expected
        self._noise = NOISE_SHARE * noise_field / max(expected.strength, 1e-9)
        self._mean: tuple[float, float] | None = None
        self._stamp = -math.inf
        self._disturbed_since: float | None = None

    def add(
        self, stamp: float, field: Triple, up: Triple, tilt_variance: float, yaw: float
    ) -> bool:
        """Take a corrected field (tesla, body axes); returns whether a new field was accepted.

        Parameters
        ----------
        stamp : float
            Seconds.
        field, up : tuple of float
            Tesla, and a unit vector; body axes.
        tilt_variance : float
            Of up, rad².
        yaw : float
            Radians, for the record.
        """
        size = length(field)
        dip = math.asin(max(-1.0, min(1.0, -dot(field, up) / size))) if size > 0.0 else 0.0
        seconds, self._stamp = stamp - self._stamp, stamp
        if self._mean is None or not 0.0 < seconds < 1.0:
            self._mean = (size, dip)
        share = 1.0 - math.exp(-min(max(seconds, 0.0), 1.0) / MEMORY)
        old_size, old_dip = self._mean
        self._mean = (old_size + share * (size - old_size), old_dip + share * (dip - old_dip))
        if self._distance(self._calibrated, tilt_variance) < 1.0:
            self._expected = self._calibrated
        self.departure = self._distance(self._expected, tilt_variance)
        self.trust = self._judge()
        if self.trust is not Trust.IGNORED:
            self._disturbed_since = None
            return False
        return self._note(stamp, yaw)

    def _judge(self) -> Trust:
        # A field at the edge must not be heard now and then.
        edge = BELIEVED_BELOW if self.trust is Trust.IGNORED else IGNORED_FROM
        if self.departure >= edge:
            return Trust.IGNORED
        return Trust.GOOD if self.departure <= 1.0 else Trust.WEIGHED_DOWN

    def _distance(self, expected: Expected, tilt_variance: float) -> float:
        """Return how far the mean is from a field, in sigmas."""
        assert self._mean is not None
        strength = self._mean[0] / max(expected.strength, 1e-9) - 1.0
        dip = self._mean[1] - expected.inclination
        of_strength = math.hypot(STRENGTH_TOLERANCE, self._noise)
        of_dip = math.sqrt(DIP_TOLERANCE**2 + self._noise**2 + tilt_variance)
        return math.hypot(strength / of_strength, dip / of_dip)

    def _note(self, stamp: float, yaw: float) -> bool:
        """Write down the disturbance; returns whether it has lasted long enough."""
        assert self._mean is not None
        strength = self._mean[0] / max(self._expected.strength, 1e-9) - 1.0
        dip = self._mean[1] - self._expected.inclination
        last = self.last
        if self._disturbed_since is None or last is None:
            self._disturbed_since = stamp
            last = Disturbance(stamp, stamp, yaw, strength, dip)
        accepts = stamp - self._disturbed_since > self.patience
        self.last = Disturbance(
            last.since,
            stamp,
            last.yaw,
            max(strength, last.strength, key=abs),
            max(dip, last.dip, key=abs),
            accepts,
        )
        if accepts:
            self._expected = Expected(*self._mean)
            self._disturbed_since = None
        return accepts
