"""Turns with real sensor errors: `python benchmarks/realistic.py [--runs N] [--only X] [--turns]`.

One effect at a time, on full turns of a small robot with a reference field, with the gyro and
without. A row shows how many turns are refused and warned of, the heading's RMS error on the level
(degrees), the median sigma, NEES of the heading, and the share beyond three sigmas. Sensors are
evaluated as they are used: an accelerometer with an offset has it afterwards, too; motors are
switched off. Some effects have a course of their own: a rest before and after the turn, stops on
the way, an uneven speed. Such turns go through a session, as those of a robot do. The third line is
the RMS with the gyro over that without, of the turns that are answered either way: it should not be
above one.

With `--turns` each row is a kind of turn instead (`cases/turn_kinds.py`; a fifth has no reference
field), with perfect, good, typical and cheap sensors; what was warned of and refused is counted.
With `--rested` the rows are courses that begin and end at rest, as a robot's own turns do. With
`--arcs` they are arcs of 40 to 90° (from `--least` degrees on), as of a turn that is finished by
hand, with rests before and after or without, of good, typical and cheap sensors. With `--place` the
robot stands near iron or indoors instead of in the open, and is judged by the field of the open: a
turn also contains the field of its place. *Wrong* is beyond five sigmas and one degree. Below the
kinds of turns of one set of sensors is a row of all of them; `--first` is the seed of the first
turn of each row.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
import shared_cases  # noqa: F401
from places import PLACES
from realistic_robots import (
    ARCS,
    COURSES,
    EFFECTS,
    RESTED,
    SENSORS,
    Scene,
    Scenes,
    by_arc,
    by_effect,
    by_rested_turn,
    by_turn,
    collected,
    heading_error,
)
from turn_kinds import KINDS

from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.calibrate import calibrate
from magcal_ros.core.calibration.heading_sigma import calibration_sigma
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.simulation import DEGREE


@dataclass
class Row:
    """The results of the turns of one row, with the gyro or without."""

    gyro: bool
    refused: int = 0
    warned: int = 0
    answers: dict[int, tuple[float, float]] = field(default_factory=dict)
    """Error and sigma by number, radians."""
    reasons: Counter[str] = field(default_factory=Counter)

    def take(self, number: int, scene: Scene, knowledge: Knowledge) -> None:
        window = scene.window if self.gyro else replace(scene.window, angular_rate=None)
        window = collected(window) if scene.has_course else window
        outcome = calibrate(window, knowledge)
        grade = max(outcome.verdict.quality, outcome.verdict.confidence, key=lambda g: g.rank)
        if grade.rank >= Grade.WARN.rank:
            checks = outcome.verdict.checks
            self.reasons.update({check.key for check in checks if check.grade is grade})
        if outcome.estimate is None or grade is Grade.REFUSED:
            self.refused += 1
            return
        self.warned += grade is Grade.WARN
        error = heading_error(scene, outcome.estimate.correction)
        self.answers[number] = error, calibration_sigma(outcome.estimate, 0.0)

    def text(self, name: str) -> str:
        text = f"{name:28s}{'gyro' if self.gyro else '-':>5s}{self.refused:8d}{self.warned:8d}"
        if not self.answers:
            return text
        errors, sigmas = np.array(list(self.answers.values())).T
        ratio = errors / sigmas
        rms, sigma = (math.degrees(v) for v in (rms_of(errors), np.median(sigmas)))
        text += f"{rms:8.2f}{sigma:8.2f}{np.mean(ratio**2):8.2f}{np.mean(ratio > 3.0):8.1%}"
        text += f"{np.sum((ratio > 5.0) & (errors > DEGREE)):8d}"
        return text + "".join(f"  {why} {count}" for why, count in self.reasons.most_common())


def rms_of(errors: FloatArray) -> float:
    return math.sqrt(float(np.mean(np.square(errors))))


def of_all(rows: list[Row]) -> Row:
    """Return the turns of several rows as one."""
    answers = [answer for row in rows for answer in row.answers.values()]
    return Row(
        rows[0].gyro,
        sum(row.refused for row in rows),
        sum(row.warned for row in rows),
        dict(enumerate(answers)),
    )


def show_kinds(sensors: str, kinds: dict[str, Scenes], numbers: range, only: str) -> None:
    """Print the rows of several kinds of turns, and those of all of them."""
    found = [
        show(f"{sensors} {kind}", scenes, numbers)
        for kind, scenes in kinds.items()
        if only in f"{sensors} {kind}"
    ]
    for rows in zip(*found, strict=True):
        print(of_all(list(rows)).text(f"{sensors}, all"), flush=True)


def show(name: str, scenes: Scenes, numbers: range) -> list[Row]:
    """Print a row with the gyro, one without, and what the gyro does to turns answered by both."""
    rows = [Row(gyro=True), Row(gyro=False)]
    for number in numbers:
        for row in rows:
            row.take(number, *scenes(number))
    print("\n".join(row.text(name) for row in rows), flush=True)
    both = sorted(set(rows[0].answers) & set(rows[1].answers))
    if both:
        by, without = (rms_of(np.array([row.answers[n][0] for n in both])) for row in rows)
        print(f"{'':28s}gyro over none, {len(both)} turns: {by / max(without, 1e-9):.2f}")
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--only", default="", help="effects whose name holds this")
    parser.add_argument("--turns", action="store_true", help="kinds of turns instead of effects")
    parser.add_argument("--rested", action="store_true", help="from rest to rest, instead")
    parser.add_argument("--arcs", action="store_true", help="40 to 90° of a turn, instead")
    parser.add_argument("--least", type=float, default=40.0, help="degrees, of those arcs")
    parser.add_argument("--place", default="open", choices=PLACES, help="of those turns")
    parser.add_argument("--first", type=int, default=0, help="seed of the first turn")
    arguments = parser.parse_args()
    numbers = range(arguments.first, arguments.first + arguments.runs)
    names = ("refused", "warned", "rms", "sigma", "NEES", ">3s", "wrong")
    print(f"{'effect':28s}{'':5s}" + "".join(f"{name:>8s}" for name in names))
    if not (arguments.turns or arguments.rested or arguments.arcs):
        for name in (*EFFECTS, *COURSES):
            if arguments.only in name:
                show(name, by_effect(name), numbers)
        return
    for sensors in ("good", "typical", "cheap") if arguments.arcs else SENSORS:
        if arguments.arcs:
            kinds = {course: by_arc(course, sensors, arguments.least) for course in ARCS}
        elif arguments.rested:
            kinds = {kind: by_rested_turn(kind, sensors, arguments.place) for kind in RESTED}
        else:
            kinds = {kind: by_turn(kind, sensors, arguments.place) for kind in KINDS}
        title = sensors if arguments.place == "open" else f"{sensors} {arguments.place}"
        show_kinds(title, kinds, numbers, arguments.only)


if __name__ == "__main__":
    main()
