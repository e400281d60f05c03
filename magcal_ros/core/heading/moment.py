"""What one field message comes to, computed once for all who look at it."""

from __future__ import annotations

from typing import NamedTuple

from magcal_ros.core.calibration.motors import AT_REST, Running
from magcal_ros.core.geometry.vec3 import Triple
from magcal_ros.core.heading.compass import Compass, Heading
from magcal_ros.core.samples.streams import FieldSample
from magcal_ros.core.up import Up


class Moment(NamedTuple):
    """A field sample under a calibration.

    Parameters
    ----------
    stamp : float
        Of the field message, seconds.
    field : tuple of float
        Corrected, body axes, tesla.
    up : Up or None
        Of the same moment; None if no IMU sample is near enough.
    heading : Heading or None
        What field and up come to; None where they tell no direction.
    rate : tuple of float or None
        Newest angular velocity, rad/s, NaN without a gyro; None before the first IMU message.
    """

    stamp: float
    field: Triple
    up: Up | None
    heading: Heading | None
    rate: Triple | None

    @classmethod
    def of(
        cls,
        compass: Compass,
        sample: FieldSample,
        up: Up | None,
        rate: Triple | None,
        running: Running = AT_REST,
    ) -> Moment:
        """Return what a field sample comes to by the compass in force, and what motors do."""
        field, heading = compass.correct(compass.without_motors(sample.field, running)), None
        if up is not None:
            heading = compass.heading(field, up.direction, up.variance, running)
        return cls(sample.stamp, field, up, heading, rate)
