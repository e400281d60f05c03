"""Whether faults are found and named: `python benchmarks/imu_faults.py [--runs N] [--good N]`.

Each run puts one fault, or two at once, on the sensors of a realistic robot. The sensors are cheap
ones at their own rates, with jitter, vibration, a lever arm, hard and soft iron, and an
installation of the magnetometer that is up to 8° off. The floor slopes. In "turn" the robot turns
once; in "lift" the nose is lifted meanwhile; in "half minute" it stands, turns left once, and the
nose is lifted, as `magcal doctor` asks for; in "quarter" it turns by 90°. A fault is found if its
own line of the page names it. Lines about sensors without a fault are "blamed". If the movement
does not show which of two sensors is wrong and the page asks, this counts as found, and in
"either". The page of a good robot must name nothing.
"""

from __future__ import annotations

import argparse
import itertools
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
import shared_cases  # noqa: F401
from imu_faults_cases import FAULTS, MOTIONS, Case, Fault, good_case

from magcal_ros.core.doctor.sensor_report import examine

CANNOT_SHOW = {
    "turn": (
        *("gyro x mirrored", "gyro y mirrored", "gyro x, y swapped"),
        *("accelerometer late", "gyro ahead"),
    ),
    "quarter": ("scale +5 %", "scale -5 %"),
}
"""Faults that a movement does not show: nothing turns about these axes, or not far enough."""

ASKED = frozenset({"axes", "gyro_axes", "field_axes", "force_axes"})
"""Lines that one question may stand for."""


@dataclass
class Row:
    """The count of one fault and one movement."""

    runs: int = 0
    found: int = 0
    either: int = 0
    blamed: Counter[str] = field(default_factory=Counter)

    def add(self, wanted: set[str], case: Case) -> None:
        report = examine(case.log, case.knowledge, case.turned_left)
        lines = [f for f in report.findings if f.is_wrong]
        self.runs += 1
        keys = {f.key for f in lines}
        asked = ASKED if "axes" in keys else frozenset[str]()
        self.found += wanted - asked <= keys
        self.either += bool(wanted & asked)
        self.blamed.update(keys - wanted - (asked if wanted & asked else frozenset()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=40, help="of each fault and movement")
    parser.add_argument("--pairs", type=int, default=2, help="runs of each pair of faults")
    parser.add_argument("--good", type=int, default=400, help="robots without a fault")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="faults whose name holds this")
    arguments = parser.parse_args()
    seed = arguments.seed
    print(f"{'fault':<22}{'movement':<13}{'found %':>8}{'either %':>9}  blamed beside it")
    for (name, (fault, keys)), motion in itertools.product(FAULTS.items(), MOTIONS):
        if name in CANNOT_SHOW.get(motion, ()) or arguments.only not in name:
            continue
        row = Row()
        for number in range(arguments.runs):
            rng = np.random.default_rng([seed, number])
            row.add(set(keys), spoilt(good_case(rng, motion), rng, fault))
        show(name, motion, row)
    for motion in ("lift", "half minute"):
        two_at_once(motion, arguments.pairs, seed)
    for motion in MOTIONS:
        row = Row()
        for number in range(arguments.good // len(MOTIONS)):
            row.add(set(), good_case(np.random.default_rng([seed, 7, number]), motion))
        alarms = sum(row.blamed.values())
        print(f"good, {motion}: {alarms} false lines in {row.runs} pages {dict(row.blamed) or ''}")


def two_at_once(motion: str, runs: int, seed: int) -> None:
    row, worst = Row(), Counter[str]()
    for pair, (one, two) in enumerate(itertools.combinations(FAULTS, 2)):
        keys = {*FAULTS[one][1], *FAULTS[two][1]}
        if len(keys) < 2 or {one, two} & set(CANNOT_SHOW.get(motion, ())):
            continue
        for number in range(runs):
            rng = np.random.default_rng([seed, 3, pair, number])  # another robot for each
            before = row.found
            case = spoilt(good_case(rng, motion), rng, FAULTS[one][0])
            row.add(keys, spoilt(case, rng, FAULTS[two][0]))
            if row.found == before:
                worst.update([one, two])
    show("two at once", motion, row)
    print("  missed most with:", worst.most_common(5))


def spoilt(case: Case, rng: np.random.Generator, fault: Fault) -> Case:
    return Case(fault(rng, case.log), case.knowledge, case.turned_left, case.nose_lifted)


def show(name: str, motion: str, row: Row) -> None:
    share = 100.0 / max(row.runs, 1)
    blamed = ", ".join(f"{key} {share * count:.0f} %" for key, count in row.blamed.most_common(4))
    print(
        f"{name:<22}{motion:<13}{share * row.found:>8.0f}{share * row.either:>9.0f}  {blamed}",
        flush=True,
    )


if __name__ == "__main__":
    main()
