"""A recording in place of the sensors: the same streams, pairs, session and verdict as live."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeAlias

from magcal_ros.core.calibrate import METHODS, Outcome, calibrate
from magcal_ros.core.complaints import Heard, complaints
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.knowledge import Knowledge, Mounting
from magcal_ros.core.session import Limits, Progress, Session
from magcal_ros.core.streams import MAX_GAP, Drop, FieldSample, ImuSample, Pairer, Streams
from magcal_ros.core.window import Window

Reading: TypeAlias = ImuSample | FieldSample | None
"""What a sensor said; None is an Imu message that says it has no acceleration."""

LITTLE_DATA = (Reason.TOO_FEW_SAMPLES, Reason.NO_MOTION, Reason.ARC_TOO_SHORT)
"""Reasons that a longer recording would mend."""


class Gathering:
    """Takes a whole recording into one session, which does not end by itself.

    Memory stays bounded: the session thins what it holds, whatever the recording's length.

    Parameters
    ----------
    mounting : Mounting
        How the magnetometer is meant to sit; kept as `mounting`.
    imu_topic, field_topic : str
        What to call the two streams in words.
    max_gap : float
        Seconds. IMU samples further apart are not interpolated between.
    """

    def __init__(
        self,
        mounting: Mounting,
        imu_topic: str = "the IMU",
        field_topic: str = "the field",
        max_gap: float = MAX_GAP,
    ) -> None:
        self.mounting = mounting
        self.streams = Streams(max_gap)
        self._session = Session(Limits(), mounting, 0.0)
        self._pairer = Pairer(self.streams)
        self._topics = (imu_topic, field_topic)
        self._heard = [0, 0]

    @property
    def heard(self) -> tuple[int, int]:
        """How many messages of IMU and field came."""
        return self._heard[0], self._heard[1]

    def take(self, readings: Iterable[Reading]) -> None:
        """Take everything, in the order in which it was recorded."""
        streams, pairer = self.streams, self._pairer
        imus = fields = 0
        for reading in readings:
            if isinstance(reading, ImuSample):
                imus += 1
                streams.add_imu(reading)
            elif reading is None:
                imus += 1
                streams.imu_drops[Drop.ABSENT] += 1
            else:
                fields += 1
                if streams.add_field(reading) and not streams.is_repeated:
                    pairer.offer(reading)
                    self._collect()
        self._collect()
        self._heard[0] += imus
        self._heard[1] += fields

    def complaints(self) -> list[str]:
        """Say in words what is wrong with what came; empty if nothing is."""
        imu, field = (Heard(*each) for each in zip(self._topics, self._heard, strict=True))
        return complaints(self.streams, imu, field)

    def progress(self) -> Progress:
        """Return how much of a turn was seen."""
        return self._session.progress(0.0)

    def window(self) -> Window:
        """Return what was gathered, if it is enough of a turn.

        Raises
        ------
        Refusal
            If it is not; the text says what was seen and what is wrong with the input.
        """
        if not self._session.has_samples:
            words = "no pair of field and acceleration samples could be made"
            raise Refusal(Reason.TOO_FEW_SAMPLES, "; ".join([words, *self.complaints()]))
        window = self._session.window()
        self.progress().require_arc(self._session.limits.smallest_arc)
        return window

    def _collect(self) -> None:
        for pair in self._pairer.take():
            self._session.add(pair, 0.0)


def fit_gathered(
    gathering: Gathering, knowledge: Knowledge, method: str = METHODS[0]
) -> tuple[Outcome, Window | None]:
    """Calibrate from what was gathered.

    Parameters
    ----------
    gathering : Gathering
        After it took the recording.
    knowledge : Knowledge
        What is known beforehand.
    method : str
        One of `METHODS`.

    Returns
    -------
    Outcome, Window or None
        Never raises for bad data: a refusal is a verdict, and then there may be no window.
    """
    try:
        window = gathering.window()
    except Refusal as refusal:
        return Outcome.refused(refusal), None
    return calibrate(window, knowledge, method), window
