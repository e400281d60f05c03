"""Results of drives, simulated and recorded: up, the front of the vehicle, the compass by course.

Run it as `python benchmarks/driving.py [drives] [recordings] [seed]`. Each row of the simulated
table is over so many drives (20 unless given) from a seed on (0 unless given); the folder with the
recordings is `../shared/recordings` unless given. NEES is the squared error over the said variance.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shared_cases  # noqa: F401
from moving import CARS, exact, show
from simulated.drive import (
    AnySample,
    Drive,
    Iron,
    Streets,
    Vehicle,
    simulated_drive,
)
from simulated.legs import Leg, city, one_street, reversing, standing
from simulated.reckoning import Receiver, Wheels
from simulated.travel import travel

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.driving.chords import CourseOffset
from magcal_ros.core.driving.mounting_yaw import MountingYaw
from magcal_ros.core.driving.travel_estimator import TravelEstimator
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import wrap_angle
from magcal_ros.core.heading.compass import Compass, CompassReader
from magcal_ros.core.knowledge import Belief, Knowledge, Mounting, ReferenceField
from magcal_ros.core.samples.streams import FieldSample, ImuSample, PositionSample, SpeedSample
from magcal_ros.core.session.recorded import SampleCollector, fit_collected
from magcal_ros.core.up.follower import UpFollower
from magcal_ros.files.recording import Recording, read_csv_folder

WAYS = ("nothing", "odometry", "velocity", "fixes")
RECEIVERS = {"velocity": Receiver(speed_noise=0.1), "fixes": Receiver()}


@dataclass(frozen=True, eq=False)
class FollowedDrive:
    """The results of a drive; `early` is the course's offset by its first half."""

    stamps: FloatArray
    ups: FloatArray
    yaws: FloatArray
    estimator: TravelEstimator
    course: CourseOffset | None
    early: CourseOffset | None

    @property
    def mounting(self) -> MountingYaw | None:
        """The yaw of the IMU in the vehicle."""
        return self.estimator.known_mounting


def follow(
    samples: Iterable[AnySample], calibration: Calibration, half: float = math.inf
) -> FollowedDrive:
    """Process a drive as the node does; `half` is the stamp of its middle, seconds."""
    up, compass, estimator = UpFollower(), Compass(calibration), TravelEstimator()
    reader, stamps, ups, yaws = CompassReader(up), [], [], []
    early = None
    for sample in samples:
        if sample.stamp >= half:
            early, half = estimator.fit_course(), math.inf
        if isinstance(sample, ImuSample):
            up.add(sample, estimator.add_imu(sample, up.gyro_bias.rate))
        elif isinstance(sample, FieldSample):
            up.add_field(sample.stamp, sample.field)
            reading = reader.read(compass, sample)
            if reading.up is None or reading.heading is None:
                continue
            estimator.add_yaw(reading.heading.yaw)
            stamps.append(sample.stamp)
            ups.append(reading.up.direction)
            yaws.append(reading.heading.yaw)
        else:
            estimator.add_travel(sample)
    course = estimator.fit_course()
    return FollowedDrive(np.array(stamps), np.array(ups), np.array(yaws), estimator, course, early)


def of_robot(drive: Drive) -> Calibration:
    """Return the calibration that is right at the start of a simulated drive."""
    robot = drive.vehicle.robot
    correction = drive.correction_at(drive.time[0])
    return exact(correction, robot.noise_field, robot.strength, robot.inclination)


def city_drive(seed: int, seconds: float, way: str) -> Drive:
    """Return a new drive through a city with an IMU of any orientation."""
    rng = np.random.default_rng(seed)
    vehicle = Vehicle(
        imu_yaw=float(rng.uniform(-math.pi, math.pi)),
        imu_roll=0.05 * float(rng.standard_normal()),
        imu_pitch=0.05 * float(rng.standard_normal()),
        imu_ahead=float(rng.uniform(-0.5, 1.5)),
    )
    truth = travel(city(rng, seconds), rng, heading=float(rng.uniform(-3.0, 3.0)))
    return simulated_drive(
        truth,
        rng,
        vehicle,
        wheels=Wheels() if way == "odometry" else None,
        receiver=RECEIVERS.get(way, Receiver() if way == "odometry" else None),
    )


def tilt_errors(drive: Drive, seen: FollowedDrive) -> FloatArray:
    """Return the errors of up, degrees."""
    truth = drive.up[np.searchsorted(drive.time, seen.stamps)]
    across = np.clip(np.sum(truth * seen.ups, axis=1), -1.0, 1.0)
    return np.asarray(np.degrees(np.arccos(across)))


def simulated(drives: int, seed: int) -> None:
    """Print up, mounting and course over fresh drives of 2, 4 and 8 minutes."""
    show(("speed from", "minutes", "up p50 / p90 / p99", "heading RMS", "beta RMS (said, NEES)",
          "o RMS (said, NEES)", "second half by o of the first / best constant"))  # fmt: skip
    show(("---",) * 7)
    for way in WAYS:
        for minutes in (2.0, 4.0, 8.0) if way == "odometry" else (4.0,):
            row(way, minutes, [city_drive(seed + n, 60.0 * minutes, way) for n in range(drives)])


def row(name: str, minutes: float, drives: list[Drive]) -> None:
    """Print one row."""
    tilts, headings = [], []
    beta: list[tuple[float, float]] = []
    offset: list[tuple[float, float]] = []
    halves: list[tuple[float, float]] = []
    for drive in drives:
        half = 0.5 * (drive.time[0] + drive.time[-1])
        seen = follow(drive.samples(), of_robot(drive), half)
        true = drive.vehicle.imu_yaw
        tilts.append(tilt_errors(drive, seen))
        gap = wrap_angle(seen.yaws - drive.imu_yaw[np.searchsorted(drive.time, seen.stamps)])
        headings.append(np.degrees(gap))
        if seen.mounting is not None:
            beta.append((math.remainder(seen.mounting.yaw - true, math.tau), seen.mounting.sigma))
        if seen.course is not None:
            offset.append((math.remainder(seen.course.offset - true, math.tau), seen.course.sigma))
        if seen.early is not None:
            halves.append(without(seen.early.offset - true, gap[seen.stamps > half]))
    tilt = " / ".join(
        f"{np.mean([np.percentile(each, share) for each in tilts]):.1f}" for share in (50, 90, 99)
    )
    rms = f"{np.sqrt(np.mean(np.concatenate(headings) ** 2)):.1f}"
    both = "-"
    if halves:
        both = " / ".join(f"{value:.1f}" for value in np.sqrt(np.mean(np.square(halves), axis=0)))
    summaries = (summary(beta, len(drives)), summary(offset, len(drives)))
    show((name, f"{minutes:.0f}", tilt, rms, *summaries, both))


def without(offset: float, gap: FloatArray) -> tuple[float, float]:
    """Return a heading's RMS error without an offset, and without the constant that is best."""
    best = float(np.angle(np.mean(np.exp(1j * gap))))
    rms = [math.degrees(np.sqrt(np.mean(wrap_angle(gap - each) ** 2))) for each in (offset, best)]
    return rms[0], rms[1]


def summary(found: list[tuple[float, float]], drives: int) -> str:
    """Return RMS error, median sigma in degrees, NEES, and of how many drives."""
    if not found:
        return "-"
    error, sigma = np.array(found).T
    rms, stated = math.degrees(np.sqrt(np.mean(error**2))), math.degrees(np.median(sigma))
    answered = "" if len(found) == drives else f", {len(found)} of {drives}"
    return f"{rms:.2f} ({stated:.2f}, {np.mean((error / sigma) ** 2):.1f}{answered})"


def traps(drives: int, seed: int) -> None:
    """Print cases that must not give a wrong result."""
    print("\nBackwards half of the time, speed without a sign: wrong directions of travel")
    wrong = trips = 0
    for number in range(drives):
        rng = np.random.default_rng(1000 + seed + number)
        truth = travel(city(rng, 90.0) + reversing(rng, 10), rng)
        wheels = Wheels(is_signed=False)
        drive = simulated_drive(truth, rng, Vehicle(imu_yaw=0.3), wheels=wheels)
        counted, bad = directions(drive)
        trips, wrong = trips + counted, wrong + bad
    print(f"{wrong} of {trips} trips")
    print(
        "\nOne street of 200 m there and back: said sigma of o by the times it is driven, degrees"
    )
    for times in (1, 2, 20):
        rng = np.random.default_rng(5)
        drive = simulated_drive(travel(one_street(times), rng), rng, streets=Streets())
        course = follow(drive.samples(), of_robot(drive)).course
        print(times, "-" if course is None else f"{math.degrees(course.sigma):.2f}")


def odd_ones(drives: int, seed: int) -> None:
    """Print what becomes of o where a course is no heading, or the field is not the vehicle's."""
    print("\nAnd where o must not be reported, or with a larger sigma")
    show(("what", "reported", "o RMS (sigma, NEES)"))
    show(("---",) * 3)
    trailer = Iron((10e-6, 0.0, 0.0), 80.0, 160.0)
    for name, legs_of, options, current in (
        ("a boat that drifts and looks about", drifting, {"wheels": None}, (2.5, 0.5)),
        ("standing for four minutes", lambda _: standing(240.0), {}, (0.0, 0.0)),
        ("a trailer of 10 µT for a third of it", lambda rng: city(rng, 240.0),
         {"irons": (trailer,)}, (0.0, 0.0)),
    ):  # fmt: skip
        found = []
        for number in range(drives):
            rng = np.random.default_rng(2000 + seed + number)
            truth = travel(legs_of(rng), rng, current=current)
            drive = simulated_drive(truth, rng, Vehicle(imu_yaw=0.1), **options)
            course = follow(drive.samples(), of_robot(drive)).course
            if course is not None:
                found.append((math.remainder(course.offset - 0.1, math.tau), course.sigma))
        show((name, f"{len(found)} of {drives}", summary(found, len(found))))


def drifting(rng: np.random.Generator) -> list[Leg]:
    """Turn on the spot for four minutes."""
    return [Leg(rng.uniform(4.0, 8.0), turn_rate=rng.normal(0.0, 0.04)) for _ in range(40)]


def directions(drive: Drive) -> tuple[int, int]:
    """Return how many trips ended with a direction that the force had decided, and how many of
    those were wrong.
    """
    up, estimator = UpFollower(), TravelEstimator()
    speeds = np.abs(drive.truth.speed)
    ends = drive.time[np.flatnonzero((speeds[:-1] > 0.7) & (speeds[1:] <= 0.7))]
    ends = ends[ends > drive.time[0] + 90.0].tolist()
    counted = wrong = 0
    for sample in drive.samples():
        if isinstance(sample, ImuSample):
            estimator.add_imu(sample, up.gyro_bias.rate)
            if ends and sample.stamp >= ends[0]:
                true = np.interp(ends.pop(0) - 0.3, drive.time, drive.truth.speed)
                counted += 1
                wrong += estimator.acceleration.sign * true < 0.0
        elif isinstance(sample, SpeedSample):
            estimator.add_travel(sample)
    return counted, wrong


def recorded(folder: Path) -> None:
    """Print the results of recorded cars with and without their fixes."""
    show(("recording", "up by acceleration, ° per m/s²: without speed", "with",
          "heading RMS without speed", "with", "beta", "-o"))  # fmt: skip
    show(("---",) * 7)
    for name, turned in CARS.items():
        if not (folder / name).is_dir() or not (folder / turned).is_dir():
            continue
        recording = read_csv_folder(folder / name)
        truth = np.genfromtxt(folder / name / "truth.csv", delimiter=",", skip_header=1)
        calibration = turned_before(folder / turned)
        if calibration is None:
            show((name, "no calibration"))
            continue
        without = follow(recording.samples(), calibration)
        seen = follow(merged(recording, truth), calibration)
        cells = [found(each, truth) for found in (lean, heading_rms) for each in (without, seen)]
        beta = "-" if seen.mounting is None else angle(seen.mounting.yaw, seen.mounting.sigma)
        course = seen.course
        offset = "-" if course is None else angle(course.offset, course.sigma)
        show((name, *cells, beta, offset))


def angle(value: float, sigma: float) -> str:
    """Return an angle and its sigma in words."""
    return f"{math.degrees(value):.1f} ± {math.degrees(sigma):.1f}"


def turned_before(folder: Path) -> Calibration | None:
    """Return the calibration of a recorded turn."""
    collector = SampleCollector(Mounting())
    collector.take(read_csv_folder(folder).samples())
    reference = ReferenceField(
        Belief(51.3e-6, 1.5e-6), Belief(math.radians(66.3), math.radians(1.0))
    )
    return fit_collected(collector, Knowledge(reference)).calibration


def merged(recording: Recording, truth: FloatArray) -> list[AnySample]:
    """Return a recording's samples with its fixes among them."""
    fixes = [PositionSample(row[0], row[3], row[4]) for row in truth.tolist()]
    return sorted([*recording.samples(), *fixes], key=lambda sample: sample.stamp)


def lean(seen: FollowedDrive, truth: FloatArray) -> str:
    """Return by how much up leans with the acceleration along the course, degrees per m/s²."""
    faster = np.interp(seen.stamps, truth[:, 0], np.gradient(truth[:, 2], truth[:, 0]))
    faster -= faster.mean()
    slope = faster @ (seen.ups - seen.ups.mean(axis=0)) / (faster @ faster)
    return f"{math.degrees(float(np.linalg.norm(slope))):.2f}"


def heading_rms(seen: FollowedDrive, truth: FloatArray) -> str:
    """Return the yaw's RMS against course, one constant and the best lag removed, degrees."""
    good = truth[truth[:, 2] > 2.0]
    yaws, best = np.unwrap(seen.yaws), math.inf
    for lag in np.arange(-2.0, 2.01, 0.1):
        moments = good[:, 0] + lag
        inside = (moments > seen.stamps[0]) & (moments < seen.stamps[-1])
        gap = np.interp(moments[inside], seen.stamps, yaws) - good[inside, 1]
        gap = wrap_angle(gap - np.angle(np.mean(np.exp(1j * gap))))
        best = min(best, float(np.sqrt(np.mean(gap**2))))
    return f"{math.degrees(best):.2f}"


def main() -> None:
    """Print the tables."""
    drives = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    print(f"Simulated: {drives} drives a row, city, degrees")
    seed = int(sys.argv[3]) if len(sys.argv) > 3 else 0
    simulated(drives, seed)
    traps(max(1, drives // 2), seed)
    odd_ones(max(1, drives // 2), seed)
    beside = Path(__file__).resolve().parents[2] / "shared" / "recordings"
    print("\nRecorded cars, calibrated by what they turned before, degrees")
    recorded(Path(sys.argv[2]) if len(sys.argv) > 2 else beside)


if __name__ == "__main__":
    main()
