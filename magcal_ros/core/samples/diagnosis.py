"""What is wrong with the samples that came in, in words."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

from magcal_ros.core.samples.streams import Drop, Streams
from magcal_ros.core.samples.units import likely_field_unit


@dataclass(frozen=True)
class DiagnosisTuning:
    """When a stream is worth a complaint.

    Parameters
    ----------
    worth_a_word : float
        Share of dropped samples that is said.
    most_repeats : float
        Share of repeated field values beyond which the sensor is frozen or the robot at
        rest.
    largest_offset : float
        Seconds between the two sensors' newest stamps.
    ahead_in_gaps : float
        Gaps (the largest that is bridged) by which a field ahead of the IMU is no jitter
        any more.
    """

    worth_a_word: float = 0.02
    most_repeats: float = 0.9
    largest_offset: float = 1.0
    ahead_in_gaps: float = 1.5


TUNING = DiagnosisTuning()


WORDS = {
    Drop.NOT_FINITE: "samples are not finite",
    Drop.ZERO: "samples are all zero",
    Drop.ABSENT: "messages carry no acceleration",
    Drop.ZERO_STAMP: "stamps are zero: the driver must stamp its messages",
    Drop.BACKWARD_STAMP: "stamps go backward",
    Drop.UNPAIRED: "samples have no IMU samples within window.max_gap_s around their stamp",
    Drop.UNREADABLE: "messages are damaged: their bytes are not what their type says",
}

IMU_WORDS = WORDS | {Drop.TOO_LARGE: "samples are no acceleration in m/s² or no rate in rad/s"}


@dataclass(frozen=True)
class Heard:
    """What came on one topic in the time that is judged.

    Parameters
    ----------
    topic : str
        Its name.
    messages : int
        How many came.
    drops : Counter of Drop
        How many of them were not used, by reason.
    """

    topic: str
    messages: int
    drops: Counter[Drop] = field(default_factory=Counter)

    def since(self, earlier: Heard) -> Heard:
        """Return what came after an earlier count of the same topic."""
        drops = Counter({drop: n - earlier.drops[drop] for drop, n in self.drops.items()})
        return Heard(self.topic, self.messages - earlier.messages, drops)


def complaints(streams: Streams, imu: Heard, mag: Heard) -> list[str]:
    """Say what is wrong with two streams, and what to do; empty if nothing is.

    Parameters
    ----------
    streams : Streams
        The cleaned streams, for their newest stamps.
    imu, mag : Heard
        What came on the two topics.
    """
    found = []
    if mag.drops[Drop.TOO_LARGE]:
        unit = likely_field_unit(streams.largest_field)
        found.append(unit or f"a field of {streams.largest_field:.3g} T is no Earth field")
    for heard, all_words in ((imu, IMU_WORDS), (mag, WORDS)):
        found += [
            f"{heard.topic}: {heard.drops[drop]} of {heard.messages} {words}"
            for drop, words in all_words.items()
            if heard.drops[drop] > TUNING.worth_a_word * max(heard.messages, 1)
        ]
    if mag.drops[Drop.REPEATED] > TUNING.most_repeats * max(mag.messages, 1):
        found.append(f"{mag.topic} repeats one value: the sensor is frozen or at rest")
    for heard, stamps in ((imu, streams.imu_stamps), (mag, streams.field_stamps)):
        found += [f"{heard.topic}: {words}"] if (words := stamps.bursts.words) else []
    offset = stamp_offset(streams)
    if offset:
        found.append(
            f"the stamps of field and IMU are {offset:+.1f} s apart: "
            "let one clock stamp both sensors"
        )
    return found


def stamp_offset(streams: Streams) -> float:
    """Return by how many seconds the field's stamps lead the IMU's; zero where no fault shows.

    The true lead lies between the leads seen when each sensor's newest sample came, and neither of
    the two grows when a sensor dies.
    """
    least, most = streams.lead_at_imu, streams.lead_at_field
    if math.isfinite(least) and least > min(
        TUNING.largest_offset, TUNING.ahead_in_gaps * streams.max_gap
    ):
        return least
    return most if math.isfinite(most) and most < -TUNING.largest_offset else 0.0
