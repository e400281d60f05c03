"""Heading of a turning robot whose field is late and whose gyro has a wrong scale:
`python benchmarks/late_field.py [--robots N] [--first N]`.

Each robot turns once between rests, there and back or to one side, and is calibrated by this turn.
Then it drives circles of 2 m at 1 m/s and turns on the spot to both sides. Printed are the errors
of the compass and of the fused yaw in degrees RMS, in brackets the NEES (the squared error over the
published variance): without the latency and the scale that the turn found, and with them.
"""

from __future__ import annotations

import argparse
import math
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import shared_cases  # noqa: F401
from moving import LEFT, ROBOT, Samples, Walk, against, figures, moved, show

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.knowledge import Knowledge, Mounting
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.core.session.recorded import SampleCollector, fit_collected
from magcal_ros.core.simulation import Ride

CASES = ((0.0, 0.0), (0.01, 0.01), (0.03, -0.01), (0.08, 0.02), (0.2, 0.01))
"""Latency of the field, seconds, and scale error of the gyro."""
CORRECTED = frozenset({Figure.LATENCY.value, Figure.GYRO_SCALE.value})


def spoiled(steps: Iterable[Samples], late: float, scale: float) -> Iterator[Samples]:
    """Delay the values of the field, and not their stamps; multiply the rates."""
    past: deque[FieldSample] = deque()
    for samples in steps:
        out: list[ImuSample | FieldSample] = []
        for sample in samples:
            if isinstance(sample, ImuSample):
                x, y, z = ((1.0 + scale) * rate for rate in sample.rate)
                out.append(sample._replace(rate=(x, y, z)))
                continue
            past.append(sample)
            while len(past) > 1 and past[1].stamp <= sample.stamp - late + 1e-9:
                past.popleft()
            out.append(sample._replace(field=past[0].field))
        yield out


def turn(ride: Ride, *, is_back: bool) -> Iterator[Samples]:
    """Rest, turn once, and back if wanted, and rest."""
    yield from moved(ride, 4.0)
    yield from moved(ride, 9.0, yaw_rate=0.75)
    if is_back:
        yield from moved(ride, 2.0)
        yield from moved(ride, 9.0, yaw_rate=-0.75)
    yield from moved(ride, 4.0)


def drive(ride: Ride) -> Iterator[Samples]:
    """Rest, drive circles to the left, and turn on the spot to both sides."""
    yield from moved(ride, 5.0)
    yield from moved(ride, 20.0, yaw_rate=0.5, acceleration=0.5 * LEFT)
    yield from moved(ride, 3.0)
    for rate in (1.2, -1.0):
        yield from moved(ride, 6.0, yaw_rate=rate)
    yield from moved(ride, 3.0)


def calibrated(seed: int, late: float, scale: float, *, is_back: bool) -> Calibration | None:
    """Return the calibration of a robot by a turn."""
    ride = Ride(ROBOT, np.random.default_rng([seed, 1]), start=10.0)
    collector = SampleCollector(Mounting())
    for samples in spoiled(turn(ride, is_back=is_back), late, scale):
        collector.take(samples)
    return fit_collected(collector, Knowledge()).calibration


def main() -> None:
    """Print a table, one row for each case and kind of turn."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=8)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    show(("late", "gyro", "turn", "compass", "corrected", "fused", "corrected"))
    show(("---",) * 7)
    for late, scale in CASES:
        for is_back in (False, True):
            errors: dict[str, list[tuple[float, float]]] = {}
            for seed in range(options.first, options.first + options.robots):
                calibration = calibrated(seed, late, scale, is_back=is_back)
                if calibration is not None:
                    _add(errors, calibration, seed, late, scale)
            found = [figures(each) for each in errors.values()]
            way = "there and back" if is_back else "to one side"
            show((f"{1e3 * late:.0f} ms", f"{100.0 * scale:+.0f}%", way, *found))


def _add(
    errors: dict[str, list[tuple[float, float]]],
    calibration: Calibration,
    seed: int,
    late: float,
    scale: float,
) -> None:
    evidence = calibration.evidence
    others = {name: n for name, n in evidence.figures.items() if name not in CORRECTED}
    ignoring = replace(calibration, evidence=replace(evidence, figures=others))
    walks = [Walk(each, "propagated") for each in (ignoring, calibration)]
    ride = Ride(ROBOT, np.random.default_rng([seed, 2]), start=10.0)
    ride.stand(0.0, 0.0, math.tau * seed / 8.0)
    stamps, truth = [], []
    for samples in spoiled(drive(ride), late, scale):
        stamps.append(ride.stamp)
        truth.append(ride.magnetic_yaw)
        for walk in walks:
            for sample in samples:
                walk.take(sample)
    for name in ("raw", "fused"):
        for walk in walks:
            found = against(getattr(walk, name), stamps, truth, 13.0)
            errors.setdefault(f"{name} {walks.index(walk)}", []).extend(found)


if __name__ == "__main__":
    main()
