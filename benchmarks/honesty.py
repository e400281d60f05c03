"""Whether the verdict can be believed: `python benchmarks/honesty.py [--runs N] [--seed S]`.

Random turns, good and bad, are fitted and judged. What counts is a *miss*: a calibration accepted
without a warning whose heading on the level is wrong by more than five times what it predicts, or
by more than three degrees. Hidden cases are those that nothing in the samples can betray, such as
a mirrored magnetometer where there is no gyro; their misses are shown, but apart.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass

import numpy as np
from honesty_cases import KINDS, Case, draw_case

from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.calibrate import Outcome, calibrate
from magcal_ros.core.calibration.estimate import Estimate
from magcal_ros.core.calibration.heading_sigma import predicted_heading_sigma
from magcal_ros.core.geometry.attitude import yaw_from_up_and_field as yaw_of
from magcal_ros.core.simulation.simulator import DEGREE, LEVEL_TILT, trial_attitudes

SIGMAS = 5.0
FLOOR = 0.1 * DEGREE
"""The truth is not asked for more than this, whatever is predicted."""
WORST = 3.0 * DEGREE


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    rows: dict[str, Row] = {kind: Row() for kind in KINDS}
    for number in range(arguments.runs):
        kind, case = draw_case(arguments.seed, number)
        rows[kind].run(case, f"{kind}, seed {arguments.seed}, case {number}")
    print_table(rows)


@dataclass
class Row:
    """The count of one kind of trouble."""

    runs: int = 0
    refused: int = 0
    warned: int = 0
    accepted: int = 0
    misses: int = 0
    hidden: int = 0
    broken: int = 0
    slowest: float = 0.0

    def run(self, case: Case, name: str) -> None:
        self.runs += 1
        begun = time.perf_counter()
        try:
            outcome = calibrate(case.window, case.knowledge)
        except Exception as problem:
            self.broken += 1
            print(f"broken: {name}: {problem!r}")
            return
        self.slowest = max(self.slowest, time.perf_counter() - begun)
        self.count(case, outcome, name)

    def count(self, case: Case, outcome: Outcome, name: str) -> None:
        grades = outcome.verdict.quality, outcome.verdict.confidence
        if outcome.estimate is not None and not is_finite(outcome.estimate):
            self.broken += 1
            print(f"not finite: {name}")
        if Grade.REFUSED in grades:
            self.refused += 1
        elif Grade.WARN in grades:
            self.warned += 1
        else:
            self.accepted += 1
            assert outcome.estimate is not None
            error, sigma = heading_error(case, outcome.estimate)
            if error > min(SIGMAS * math.hypot(sigma, FLOOR), WORST):
                self.misses += not case.hidden
                self.hidden += case.hidden
                apart = " (hidden)" if case.hidden else ""
                words = f"{error / DEGREE:.2f}° for a predicted {sigma / DEGREE:.2f}°"
                print(f"miss{apart}: {name}: {words}")


def is_finite(estimate: Estimate) -> bool:
    numbers = [estimate.correction.matrix, estimate.correction.hard_iron, estimate.covariance,
               np.array(list(estimate.figures.values()))]  # fmt: skip
    return all(np.isfinite(number).all() for number in numbers)


def heading_error(case: Case, estimate: Estimate) -> tuple[float, float]:
    """Return the heading's RMS error on the level, and what was predicted, radians."""
    poses = trial_attitudes()[:, LEVEL_TILT]
    up, truth = poses[:, :, 2], poses @ case.robot.field_enu
    raw = case.robot.raw_field(truth @ case.body.T) @ case.wiring.T
    gap = yaw_of(up, estimate.correction.apply(raw)) - yaw_of(up, truth)
    gap = (gap + math.pi) % math.tau - math.pi
    error = math.sqrt(float(np.mean(gap**2)))
    return error, predicted_heading_sigma(estimate, 0.0)


def print_table(rows: dict[str, Row]) -> None:
    names = ("runs", "refused", "warned", "accepted", "misses", "hidden", "broken")
    print(f"\n{'kind':24s}" + "".join(f"{name:>10s}" for name in names) + "   slowest s")
    for kind, row in rows.items():
        counts = "".join(f"{getattr(row, name):10d}" for name in names)
        print(f"{kind:24s}{counts}{row.slowest:12.2f}")
    total = {name: sum(getattr(row, name) for row in rows.values()) for name in names}
    print(f"{'all':24s}" + "".join(f"{total[name]:10d}" for name in names))
    print(f"unflagged misses {100.0 * total['misses'] / max(total['runs'], 1):.3f} % of all runs")


if __name__ == "__main__":
    main()
