"""Yaw of a moving robot: simulated starts, stops and circles, and real drives with a truth.

Run it as `python benchmarks/moving.py [recordings]`. The folder with the recordings is
`../shared/recordings` unless given; drives that are not there are left out. With the package `vqf`
installed its 9-axis filter is shown too. NEES is the squared error over the published variance.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import shared_cases  # noqa: F401
from simulated.drive import Vehicle, simulated_drive
from simulated.legs import city
from simulated.travel import travel

from magcal_ros.core.calibration.calibration import Calibration, Evidence
from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import wrap_angle
from magcal_ros.core.heading.compass import Compass, CompassReader
from magcal_ros.core.heading.disturbance import PATIENCE
from magcal_ros.core.heading.fused_yaw import FusedYaw
from magcal_ros.core.knowledge import Belief, Knowledge, Mounting, ReferenceField
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.streams import FieldSample, ImuSample, Streams
from magcal_ros.core.session.recorded import SampleCollector, fit_collected
from magcal_ros.core.simulation import DEGREE, Ride, Robot
from magcal_ros.core.up.follower import UpFollower
from magcal_ros.files.recording import Recording, read_csv_folder

SEEDS = 5
CARS = {
    "car_circles_neu2025_kiran": "car_circles_neu2025_kiran",
    "car_drive_neu2022_rahul": "car_neu2022_rahul",
    "car_neu2024_jackg": "car_neu2024_jackg",
    "car_neu2024_gautham": "car_neu2024_gautham",
}
"""Recordings of cars, and what each is calibrated by."""
FORWARD, LEFT = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
ROBOT = Robot(inclination=65.0 * DEGREE, noise_field=0.3e-6, noise_force=0.05, noise_rate=2e-3)
Samples = Iterable[ImuSample | FieldSample]
Rows = list[tuple[float, float, float]]
"""Stamp, yaw, variance."""


def exact(correction: Correction, noise: float, strength: float, dip: float) -> Calibration:
    """Return a calibration that is right, so that only the motion is seen."""
    evidence = Evidence("truth", "", "", "")
    return Calibration(correction, np.zeros((12, 12)), noise, 0.005, strength, dip, evidence)


class Walk:
    """Processes messages as the node does, its motors off, with one of the methods for up."""

    def __init__(self, calibration: Calibration, way: str) -> None:
        self.way = way
        self.raw: Rows = []
        self.fused: Rows = []
        self._compass = Compass(replace(calibration, motors=None))
        self._noise_up = calibration.noise_up
        self._streams = Streams(STREAMS.max_gap)
        self._follower = UpFollower()
        self._reader = CompassReader(self._follower)
        self._fusion = FusedYaw(calibration, PATIENCE)

    def take(self, sample: ImuSample | FieldSample) -> None:
        """Take a sample of either sensor."""
        if isinstance(sample, FieldSample):
            self._take_field(sample)
        elif self._streams.add_imu(sample):
            if self.way == "low-pass":
                sample = sample._replace(rate=(math.nan,) * 3)
            self._follower.add(sample)
            if self.way == "propagated":
                self._fusion.propagate_by(sample.stamp, self._follower)
                heading = self._fusion.heading()
                if heading is not None:
                    self.fused.append((sample.stamp, heading.yaw, heading.yaw_variance))

    def _take_field(self, sample: FieldSample) -> None:
        if not self._streams.add_field(sample):
            return
        self._follower.add_field(sample.stamp, sample.field)
        reading = self._reader.read(self._compass, sample)
        heading = reading.heading
        if self.way == "accelerometer":
            imu = self._streams.imu_at(sample.stamp)
            variance = self._noise_up**2
            heading = imu and self._compass.heading(reading.field, imu.force, variance)
        if heading is not None:
            self.raw.append((sample.stamp, heading.yaw, heading.yaw_variance))
            if self.way == "propagated":
                self._fusion.correct(reading)


def starts_and_stops(ride: Ride) -> Iterator[list[ImuSample | FieldSample]]:
    """Stand, then speed up and brake with 2 m/s² for a second each, turning in between."""
    yield from moved(ride, 3.0)
    for _ in range(6):
        for pull in (2.0, 0.0, -2.0, 0.0):
            yield from moved(ride, 1.0, acceleration=pull * FORWARD)
        yield from moved(ride, 1.0, yaw_rate=1.0)


def circle(ride: Ride) -> Iterator[list[ImuSample | FieldSample]]:
    """Stand, then drive circles at 3 m/s and 0.5 rad/s."""
    yield from moved(ride, 3.0)
    yield from moved(ride, 1.5, acceleration=2.0 * FORWARD)
    yield from moved(ride, 40.0, yaw_rate=0.5, acceleration=1.5 * LEFT)


def circle_from_the_start(ride: Ride) -> Iterator[list[ImuSample | FieldSample]]:
    """The same, never seen at rest; the first half circle is left out of the score."""
    yield from moved(ride, 40.0, yaw_rate=0.5, acceleration=1.5 * LEFT)


def ramps(ride: Ride) -> Iterator[list[ImuSample | FieldSample]]:
    """Drive up and down 8° ramps, turning in between."""
    yield from moved(ride, 3.0)
    for _ in range(4):
        for tip in (-8.0, 0.0, 8.0, 0.0):
            yield from moved(ride, 1.5, tipping=tip / 1.5 * DEGREE * LEFT)
        yield from moved(ride, 1.0, yaw_rate=1.0)


def streets(ride: Ride) -> Iterator[list[ImuSample | FieldSample]]:
    """Stand, then drive for four minutes through streets that bend the field by 3 µT an axis."""
    rng = np.random.default_rng(int(1e6 * abs(ride.magnetic_yaw)))
    truth = travel(city(rng, 240.0), rng, rate=1.0 / ride.period, start=ride.stamp)
    drive = simulated_drive(truth, rng, Vehicle(ROBOT), wheels=None, receiver=None)
    samples = drive.samples()
    for ride.stamp, ride.attitude in zip(truth.time.tolist(), truth.attitude, strict=True):
        yield [next(samples), next(samples)]  # type: ignore[list-item]


def moved(ride: Ride, seconds: float, **motion: object) -> Iterator[list[ImuSample | FieldSample]]:
    """Yield the samples while the robot moves."""
    for _ in range(int(seconds / ride.period)):
        yield ride.step(**motion)  # type: ignore[arg-type]


def simulated(drive: Callable[[Ride], Iterator[list[ImuSample | FieldSample]]]) -> None:
    """Print the yaw errors of a simulated drive."""
    calibration = exact(ROBOT.true_correction, ROBOT.noise_field, ROBOT.strength, ROBOT.inclination)
    errors: dict[str, list[tuple[float, float]]] = {}
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        ways = [Walk(calibration, way) for way in ("accelerometer", "low-pass", "propagated")]
        ride = Ride(ROBOT, rng, start=10.0)
        ride.stand(0.0, 0.0, float(rng.uniform(-3.0, 3.0)))
        stamps, truth = [], []
        for samples in drive(ride):
            stamps.append(ride.stamp)
            truth.append(ride.magnetic_yaw)
            for walk in ways:
                for sample in samples:
                    walk.take(sample)
        first = 17.0 if drive is circle_from_the_start else 10.0
        for walk in ways:
            kept = against(walk.raw, stamps, truth, first)
            errors.setdefault(walk.way, []).extend(kept)
        errors.setdefault("fused", []).extend(against(ways[-1].fused, stamps, truth, first))
    show((drive.__name__.replace("_", " "), *(figures(found) for found in errors.values())))


def against(
    rows: Rows, stamps: list[float], truth: list[float], first: float
) -> list[tuple[float, float]]:
    """Return error and variance of each row from a stamp on."""
    found = np.array([row for row in rows if row[0] > first])
    gaps = wrap_angle(found[:, 1] - np.interp(found[:, 0], stamps, np.unwrap(truth)))
    return list(zip(gaps.tolist(), found[:, 2].tolist(), strict=True))


def figures(found: list[tuple[float, float]]) -> str:
    """Return RMS in degrees and NEES."""
    error, variance = np.array(found).T
    return f"{math.degrees(math.sqrt(np.mean(error**2))):.2f} ({np.mean(error**2 / variance):.2f})"


def show(cells: tuple[str, ...]) -> None:
    """Print one row of a table."""
    print("| " + " | ".join(cells) + " |", flush=True)


def broad(folder: Path) -> None:
    """Print the yaw errors of a hand-held drive where its tilt is below 45°."""
    recording = read_csv_folder(folder)
    for stream in (recording.imu, recording.field):
        stream[:, 0] += 1.0
    truth = np.genfromtxt(folder / "truth.csv", delimiter=",", skip_header=1)
    lean = 1.0 - 2.0 * (truth[:, 3] ** 2 + truth[:, 4] ** 2)
    bias = np.array([-0.14e-6, 0.20e-6, 0.39e-6])
    calibration = exact(Correction(np.eye(3), bias), 0.8e-6, 44.3e-6, math.radians(69.6))

    def score(rows: Rows) -> str:
        found = np.array(rows)
        stamps = found[:, 0] - 1.0
        gap = wrap_angle(found[:, 1] - np.interp(stamps, truth[:, 0], np.unwrap(truth[:, 1])))
        level = np.interp(stamps, truth[:, 0], lean) > math.cos(math.radians(45.0))
        return recorded_figures(gap[level], found[level, 2])

    recorded("broad05, tilt < 45°", recording, calibration, score)


def car(folder: Path, turned: Path) -> None:
    """Print the yaw errors of a car against its GPS course, calibrated by what it turned before."""
    recording = read_csv_folder(folder)
    truth = np.genfromtxt(folder / "truth.csv", delimiter=",", skip_header=1)
    truth = truth[truth[:, 2] > 2.0]
    collector = SampleCollector(Mounting())
    collector.take(read_csv_folder(turned).samples())
    reference = ReferenceField(
        Belief(51.3e-6, 1.5e-6), Belief(math.radians(66.3), math.radians(1.0))
    )
    outcome = fit_collected(collector, Knowledge(reference))
    if outcome.calibration is None:
        show((folder.name, f"no calibration: {outcome.verdict.summary}"))
        return

    def score(rows: Rows) -> str:
        found = np.array(rows)
        yaws = np.unwrap(found[:, 1])
        gaps = []
        for lag in np.arange(-2.0, 2.01, 0.05):
            moments = truth[:, 0] + lag
            inside = (moments > found[0, 0]) & (moments < found[-1, 0])
            gap = np.interp(moments[inside], found[:, 0], yaws) - truth[inside, 1]
            gap = wrap_angle(gap - np.angle(np.mean(np.exp(1j * gap))))
            gaps.append((gap, np.interp(moments[inside], found[:, 0], found[:, 2])))
        return recorded_figures(*min(gaps, key=lambda pair: float(np.mean(pair[0] ** 2))))

    recorded(folder.name, recording, outcome.calibration, score)


def recorded_figures(error: FloatArray, variance: FloatArray) -> str:
    """Return RMS in degrees, and NEES where there is a variance."""
    rms = f"{math.degrees(math.sqrt(np.mean(error**2))):.2f}"
    return f"{rms} ({np.mean(error**2 / variance):.2f})" if variance.all() else rms


def recorded(
    name: str, recording: Recording, calibration: Calibration, score: Callable[[Rows], str]
) -> None:
    """Print one row: each method for up, the fused yaw, and vqf if it is installed."""
    cells = []
    for way in ("accelerometer", "low-pass", "propagated"):
        walk = Walk(calibration, way)
        for sample in recording.samples():
            walk.take(sample)
        cells.append(score(walk.raw))
    fused = score(walk.fused) if walk.fused else "-"
    show((name, *cells, fused, vqf_score(recording, calibration, score)))


def vqf_score(recording: Recording, calibration: Calibration, score: Callable[[Rows], str]) -> str:
    """Return the error of the 9-axis filter of vqf with the corrected field; "-" without it."""
    try:
        from vqf import VQF
    except ImportError:
        return "-"
    time = recording.imu[:, 0]
    field = calibration.correction.apply(recording.field[:, 1:])
    aligned = [np.interp(time, recording.field[:, 0], field[:, axis]) for axis in range(3)]
    found = VQF(float(np.median(np.diff(time)))).updateBatch(
        np.ascontiguousarray(recording.imu[:, 4:7]),
        np.ascontiguousarray(recording.imu[:, 1:4]),
        np.ascontiguousarray(np.column_stack(aligned) * 1e6),
    )
    w, x, y, z = found["quat9D"].T
    yaw = np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
    return score([(t, value, 0.0) for t, value in zip(time.tolist(), yaw.tolist(), strict=True)])


def main() -> None:
    """Print both tables."""
    print("Simulated: yaw RMS in degrees (NEES)")
    show(("drive", "accelerometer", "low-pass, no gyro", "propagated", "fused"))
    show(("---",) * 5)
    for drive in (starts_and_stops, circle, circle_from_the_start, ramps, streets):
        simulated(drive)
    beside = Path(__file__).resolve().parents[2] / "shared" / "recordings"
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else beside
    print("\nRecorded: yaw RMS in degrees (NEES)")
    show(("drive", "accelerometer", "low-pass, no gyro", "propagated", "fused", "vqf"))
    show(("---",) * 6)
    if (folder / "broad05").is_dir():
        broad(folder / "broad05")
    for name, turned in CARS.items():
        if (folder / name).is_dir() and (folder / turned).is_dir():
            car(folder / name, folder / turned)


if __name__ == "__main__":
    main()
