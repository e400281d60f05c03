"""Results of self-calibration on simulated drives: `python benchmarks/self_calibration.py`.

Drives through cities with streets that bend the field, as the node would decide on them. Degrees
of heading on the level, a constant taken off. `--drives N` sets how many of each and
`--first SEED` the first; `--only NAME` runs one of: fit, circles, long, begin, jump, good, traps,
watch.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import shared_cases  # noqa: F401
from long_windows import (
    PAPER_SOFT_IRON,
    swaying,
    swaying_robot,
    swaying_window,
)
from simulated.drive import (
    Drive,
    Fence,
    Iron,
    Streets,
    Vehicle,
    random_vehicle,
    simulated_drive,
)
from simulated.legs import Leg, circles, city, joined, one_street, parking, standing
from simulated.travel import travel

from magcal_ros.core.calibration.calibration import Calibration, Evidence
from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.geometry.attitude import yaw_from_up_and_field
from magcal_ros.core.geometry.rotations import rotation_from_rpy
from magcal_ros.core.knowledge import Knowledge, knowledge_of
from magcal_ros.core.samples.drive_log import log_of
from magcal_ros.core.samples.streams import Pair
from magcal_ros.core.samples.window import Window
from magcal_ros.core.self_calibration.drive_replay import DriveReplay, examine_drive, replay_drive
from magcal_ros.core.self_calibration.jobs import Decision, DecisionKind, DriveResult, Mode
from magcal_ros.core.self_calibration.self_calibration import SelfCalibration
from magcal_ros.core.smoother.drives import DriveFit, drive_nodes, fit_drive

BOSTON = knowledge_of(51.3, inclination_deg=66.3)
LEVEL = 51.3e-6 * math.cos(math.radians(66.3))
CHANGE_AT = 180.0
WORSE = 0.3
WATCHED_FROM = 240.0


def drive_of(seed: int, seconds: float, legs: list[Leg] | None = None, **options: object) -> Drive:
    rng = np.random.default_rng(seed)
    vehicle = replace(random_vehicle(rng), imu_yaw=math.radians(rng.normal(0.0, 5.0)))
    way = travel(city(rng, seconds) if legs is None else legs, rng, rate=10.0)
    return simulated_drive(way, rng, vehicle, receiver=None, **options)  # type: ignore[arg-type]


def some_fence(seed: int) -> Fence:
    """Draw where steel of 12 µT stands and which way it points, on the level."""
    heading, way = np.random.default_rng([seed, 9]).uniform(0.0, math.tau, 2)
    return Fence((12e-6 * math.cos(way), 12e-6 * math.sin(way), 0.0), heading)


def replayed(drive: Drive, initial: Calibration | None, speed: bool = True) -> DriveReplay:
    return replay_drive(BOSTON, initial, drive._sensors(), drive.speeds if speed else ())


class RecordedResults(SelfCalibration):
    """Makes no decision, and keeps the results, for several decisions."""

    def __init__(self) -> None:
        super().__init__(Mode.OFF)
        self.rows: list[tuple[Pair, float]] = []

    def add(self, pair: Pair, speed: float = math.nan) -> bool:
        self.rows.append((pair, speed))
        return False

    def decide(self, initial: Calibration) -> tuple[list[tuple[float, Decision]], Calibration]:
        """Return the node's decisions with their seconds, and the calibration at the end."""
        machine, now, made = SelfCalibration(Mode.APPLY), initial, []
        machine.put_in_force(initial)
        for row in self.rows:
            if machine.add(*row):
                for decision in machine.note(examine_drive(machine.job(BOSTON))):
                    made.append((row[0].field.stamp - self.rows[0][0].field.stamp, decision))
                    if decision.calibration is not None:
                        now = decision.calibration
                        machine.put_in_force(now)
        return made, now


def results_of(drive: Drive) -> RecordedResults:
    taken = RecordedResults()
    replay_drive(BOSTON, None, drive._sensors(), drive.speeds, taken)
    return taken


def error(correction: Correction, drive: Drive, seconds: float) -> float:
    """Return the calibration's own error at a moment of a drive, degrees RMS over headings."""
    truth = drive.correction_at(drive.time[0] + seconds)
    yaw = np.arange(72) * (math.tau / 72)
    attitude = np.array([rotation_from_rpy(0.0, 0.0, angle).T for angle in yaw])
    raw = truth.undo(attitude @ drive.vehicle.robot.field_enu)
    turn = np.exp(1j * (yaw_from_up_and_field(attitude[:, :, 2], correction.apply(raw)) - yaw))
    return math.degrees(math.sqrt(float(np.mean(np.angle(turn / turn.mean()) ** 2))))


def fitted(window: Window, known: Knowledge) -> DriveFit:
    """Fit all twelve numbers to a drive."""
    log = log_of(window)
    return fit_drive(log, drive_nodes(log, np.eye(3)), known)


def calibration_of(correction: Correction, sigma: float = math.radians(0.84)) -> Calibration:
    """Return the calibration by a turn."""
    covariance = np.zeros((12, 12))
    covariance[9:, 9:] = np.eye(3) * (sigma * LEVEL) ** 2
    evidence = Evidence("maximum_likelihood", "good", "good", "")
    dip = math.radians(66.3)
    return Calibration(correction, covariance, 5e-7, 0.01, 51.3e-6, dip, evidence)


def changes(replay: DriveReplay) -> Iterator[tuple[float, Calibration]]:
    for seconds, made in replay.decisions:
        if made.calibration is not None:
            yield seconds, made.calibration


def bench_fit(seeds: range) -> None:
    """One fit of the smoother to the first minutes, nothing known before."""
    for seconds in (120.0, 200.0, 300.0, 420.0):
        errors, stated, took = [], [], []
        for seed in seeds:
            drive = drive_of(seed, seconds)
            window = Window(drive.time, drive.field, drive.force, drive.rate)
            started = time.process_time()
            found = fitted(window, BOSTON)
            took.append(time.process_time() - started)
            errors.append(error(found.posterior.correction, drive, 0.0))
            stated.append(math.degrees(found.posterior.heading_sigma))
        squares = (np.array(errors) / np.array(stated)) ** 2
        print(
            f"fit to {seconds:3.0f} s, no speed: rms {rms(errors):.2f} median"
            f" {np.median(errors):.2f} worst {max(errors):.1f}, said {rms(stated):.2f}, NEES mean"
            f" {squares.mean():.2f} median {np.median(squares):.2f}, CPU {np.median(took):.2f} s"
        )


def bench_circles(seeds: range) -> None:
    """90 s of circles in one place, nothing known before; the last with a poor gyro and a rest."""
    for radius, biased in ((4.0, False), (8.0, False), (14.0, False), (8.0, True)):
        errors, stated = [], []
        for seed in seeds:
            rest = standing(5.0) if biased else []
            drive = drive_of(seed, 90.0, joined(rest, circles(90.0, radius=radius)))
            off = np.random.default_rng(seed).normal(0.0, math.radians(2.0), 3) * biased
            taken = Window(drive.time, drive.field, drive.force, drive.rate + off)
            found = fitted(taken, BOSTON)
            errors.append(error(found.posterior.correction, drive, 0.0))
            stated.append(math.degrees(found.posterior.heading_sigma))
        squares = (np.array(errors) / np.array(stated)) ** 2
        print(
            f"circles of {radius:2.0f} m{', a poor gyro' if biased else ''}: rms {rms(errors):.2f}"
            f" worst {max(errors):.1f}, said {rms(stated):.2f}, NEES {squares.mean():.2f}"
        )


def bench_long(seeds: range) -> None:
    """Windows of weak motion, 1 µT and .01 rad/s at 10 Hz."""
    known = knowledge_of(47.3, inclination_deg=60.5)
    for turns in (False, True):
        for soft in (PAPER_SOFT_IRON, np.zeros((3, 3))):
            for seconds in (120.0, 600.0):
                errors, stated = [], []
                robot = swaying_robot(soft)
                for seed in seeds:
                    motion = swaying(seconds, turns=turns)
                    window = swaying_window(robot, motion, np.random.default_rng(seed))
                    found = fitted(window, known)
                    drive = replace(drive_of(0, 10.0), vehicle=Vehicle(robot))
                    errors.append(error(found.posterior.correction, drive, 0.0))
                    stated.append(math.degrees(found.posterior.heading_sigma))
                squares = (np.array(errors) / np.array(stated)) ** 2
                name = f"{'mid' if turns else 'low'}, {'soft iron' if soft.any() else 'none'}"
                print(
                    f"weak motion ({name}) {seconds:3.0f} s: rms {rms(errors):.2f}, said"
                    f" {rms(stated):.2f}, NEES {squares.mean():.2f}"
                )


def bench_begin(seeds: range) -> None:
    """From nothing: when a calibration is there, and how good it is after five minutes."""
    for speed in (True, False):
        first, late, missing = [], [], 0
        for seed in seeds:
            drive = drive_of(seed, 420.0)
            found = list(changes(replayed(drive, None, speed)))
            missing += not found
            if found:
                first.append(found[0][0])
                late.append(error(found[-1][1].correction, drive, 420.0))
        name = "with wheels" if speed else "no speed"
        print(
            f"from nothing, {name}: first after {np.median(first):.0f} s (median), none"
            f" {missing} of {len(seeds)}; at the end rms {rms(late):.2f} worst {max(late):.1f}"
        )


def bench_jump(seeds: range) -> None:
    """10 µT added: when it is noticed, and when the error is down to 3 degrees."""
    noticed, repaired, left = [], [], []
    for seed in seeds:
        angle = np.random.default_rng(seed + 77).uniform(0.0, math.tau)
        iron = (10e-6 * math.cos(angle), 10e-6 * math.sin(angle), 0.0)
        drive = drive_of(seed, 540.0, irons=(Iron(iron, CHANGE_AT),))
        initial = calibration_of(drive.vehicle.robot.true_correction)
        replay = replayed(drive, initial)
        seen = [
            at for at, m in replay.decisions if m.kind is DecisionKind.NOTICED and at > CHANGE_AT
        ]
        noticed.append(min(seen, default=math.inf) - CHANGE_AT)
        good = [
            at
            for at, each in changes(replay)
            if at > CHANGE_AT and error(each.correction, drive, at) < 3.0
        ]
        repaired.append(min(good, default=math.inf) - CHANGE_AT)
        assert replay.last_calibration is not None
        left.append(error(replay.last_calibration.correction, drive, 540.0))
    late, never = (sum(t > limit for t in repaired) for limit in (180.0, 540.0))
    print(
        f"10 µT added: noticed after {np.median(noticed):.0f} s (median; worst"
        f" {max(noticed):.0f}), down to 3° after {np.median(repaired):.0f} s (median; {late} of"
        f" {len(seeds)} after more than 180 s, {never} never); left rms {rms(left):.2f} worst"
        f" {max(left):.1f}"
    )


def bench_good(seeds: range) -> None:
    """Good calibrations in force: how many are made worse."""
    gains: dict[float, list[float]] = {0.0: [], 2.0: [], 4.0: []}
    changed, noticed = dict.fromkeys(gains, 0), dict.fromkeys(gains, 0)
    for seed in seeds:
        drive = drive_of(seed, 420.0)
        taken = results_of(drive)
        for off in gains:
            way = np.random.default_rng(seed + 5).normal(0.0, 1.0, 2)
            way *= math.radians(off) * math.sqrt(2.0) * LEVEL / float(np.linalg.norm(way))
            initial = drive.vehicle.with_iron(np.array([*way, 0.0])).robot.true_correction
            made, last_calibration = taken.decide(calibration_of(initial))
            gains[off].append(
                error(initial, drive, 0.0) - error(last_calibration.correction, drive, 420.0)
            )
            changed[off] += any(each.calibration is not None for _, each in made)
            noticed[off] += any(each.kind is DecisionKind.NOTICED for _, each in made)
    for off, gained in gains.items():
        worse = sum(gain < -WORSE for gain in gained)
        print(
            f"in force and off by {off:.0f}°: changed {changed[off]} of {len(seeds)}, made worse by"
            f" more than {WORSE}°: {worse}; reported a change: {noticed[off]}; mean gain"
            f" {np.mean(gained):+.2f}°"
        )


def bench_traps(seeds: range) -> None:
    """Cases without a change: the number of changed calibrations, and their errors."""
    traps: dict[str, Callable[[int], Drive]] = {
        "standing 10 min": lambda seed: drive_of(seed, 600.0, [Leg(600.0)]),
        "parking": lambda seed: drive_of(
            seed, 600.0, joined(*[parking(np.random.default_rng([seed, k])) for k in range(22)])
        ),
        "one street": lambda seed: drive_of(seed, 400.0, one_street(12)),
        "steel on one side": lambda seed: drive_of(seed, 600.0, fences=(some_fence(seed),)),
        "trailer for 60 s": lambda seed: drive_of(
            seed, 420.0, irons=(Iron((0.0, 10e-6, 0.0), 150.0, 210.0),)
        ),
        "trailer for 240 s": lambda seed: drive_of(
            seed, 720.0, irons=(Iron((0.0, 10e-6, 0.0), 150.0, 390.0),)
        ),
    }
    for name, make in traps.items():
        left, changed, noticed, worse = [], 0, 0, 0
        for seed in seeds:
            drive = make(seed)
            replay = replayed(drive, calibration_of(drive.vehicle.robot.true_correction))
            changed += any(True for _ in changes(replay))
            noticed += any(made.kind is DecisionKind.NOTICED for _, made in replay.decisions)
            assert replay.last_calibration is not None
            left.append(error(replay.last_calibration.correction, drive, float(np.ptp(drive.time))))
            worse += left[-1] > WORSE
        print(
            f"{name}: changed {changed} of {len(seeds)}, reported a change {noticed}; at the end"
            f" {worse} worse by more than {WORSE}°, rms {rms(left):.2f}"
        )


def watched(drive: Drive, in_force: Calibration) -> list[tuple[float, bool]]:
    """Return when the calibration in force was said to be stale, and when no longer, seconds."""
    machine, states = ChangesOfWatch(), list[tuple[float, bool]]()
    replay_drive(BOSTON, in_force, drive._sensors(), drive.speeds, machine)
    for clock, is_stale in machine.states:
        if is_stale is not (bool(states) and states[-1][1]):
            states.append((clock - machine.recorder.start, is_stale))
    return states


class ChangesOfWatch(SelfCalibration):
    """Makes no decision, and keeps what each job says about the calibration in force."""

    def __init__(self) -> None:
        super().__init__(Mode.PROPOSE)
        self.states: list[tuple[float, bool]] = []

    def _weigh(self, findings: DriveResult) -> list[Decision]:
        self.states.append((findings.clock, self.watch.is_stale))
        return []


Watched = tuple[Drive, Calibration]


def bench_watch(seeds: range) -> None:
    """A calibration in force that holds, and one that no longer does from `WATCHED_FROM` on."""

    def with_iron(size: float) -> Callable[[int], Watched]:
        def make(seed: int) -> Watched:
            angle = np.random.default_rng(seed + 77).uniform(0.0, math.tau)
            iron = (size * math.cos(angle), size * math.sin(angle), 0.0)
            drive = drive_of(seed, 660.0, irons=(Iron(iron, WATCHED_FROM),) if size else ())
            return drive, calibration_of(drive.vehicle.robot.true_correction)

        return make

    def moved(seed: int) -> Watched:
        drive = drive_of(seed, 660.0)
        angle = np.random.default_rng(seed + 77).uniform(0.0, math.tau)
        tilt = math.radians(5.0)
        rotation = rotation_from_rpy(tilt * math.cos(angle), tilt * math.sin(angle), 0.0)
        true = drive.vehicle.robot.true_correction
        return drive, calibration_of(Correction(rotation @ true.matrix, true.hard_iron))

    def right(legs: list[Leg] | None = None, **place: Any) -> Callable[[int], Watched]:
        def make(seed: int) -> Watched:
            drive = drive_of(seed, 660.0, legs, **place)
            return drive, calibration_of(drive.vehicle.robot.true_correction)

        return make

    def beside_steel(seed: int) -> Watched:
        return right(fences=(some_fence(seed),))(seed)

    cases = {
        "holds, city": (with_iron(0.0), math.inf),
        "holds, one street": (right(one_street(14)), math.inf),
        "holds, streets of 8 µT": (right(streets=Streets(size=8e-6)), math.inf),
        "holds, steel on one side": (beside_steel, math.inf),
        "3 µT added (6°)": (with_iron(3e-6), WATCHED_FROM),
        "5 µT added (10°)": (with_iron(5e-6), WATCHED_FROM),
        "10 µT added (20°)": (with_iron(10e-6), WATCHED_FROM),
        "mounting off by 5° (8°)": (moved, 0.0),
    }
    for name, (make, since) in cases.items():
        false, after = 0, []
        for seed in seeds:
            begun = [at for at, is_stale in watched(*make(seed)) if is_stale]
            false += any(at < since for at in begun)
            after.append(min((at - since for at in begun if at >= since), default=math.inf))
        found = [at for at in after if math.isfinite(at)]
        middle, worst = (f"{each(found):.0f}" if found else "-" for each in (np.median, max))
        print(
            f"{name}: wrongly stale {false} of {len(seeds)} found {len(found)} after {middle} s"
            f" (median) {worst} s (worst)",
            flush=True,
        )


def rms(values: list[float]) -> float:
    return math.sqrt(float(np.mean(np.square(values)))) if values else math.nan


BENCHES = {
    "fit": bench_fit,
    "circles": bench_circles,
    "long": bench_long,
    "begin": bench_begin,
    "jump": bench_jump,
    "good": bench_good,
    "traps": bench_traps,
    "watch": bench_watch,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drives", type=int, default=20, help="of each kind")
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    parser.add_argument("--only", default="", choices=["", *BENCHES])
    options = parser.parse_args()
    for name, bench in BENCHES.items():
        if options.only in ("", name):
            bench(range(options.first, options.first + options.drives))


if __name__ == "__main__":
    main()
