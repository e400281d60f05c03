"""Calibrations of real recordings: `python benchmarks/recordings.py [FOLDER...] [--only NAME]`.

Each row is a window of a recording: the verdict, the heading sigma, and the heading's RMS and
median against the truth, in degrees. Then come the errors of five usual methods with the same
samples and the same up, and of the gyro alone (a linear drift subtracted). "to best" is our RMS
over that of the best of the five, chosen afterwards. "to truth" is our RMS over that of the twelve
numbers that fit best where the truth is known: streets limit every calibration. "told" is the ratio
to the best of five of the fit to the same samples with their true yaw: no calibration of a window
has this information. Headings are scored on the whole recording. With `--changed` other sensors
have recorded the same drive (`changed_recordings.py`; `all` of them).
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shared_cases  # noqa: F401
from changed_recordings import CHANGES, changed
from recorded_truth import Drive, Heading, Score, asked_on_the_way, peers, read_drive, windows
from truth_fit import told_by_truth

from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.calibrate import Outcome, calibrate, calibrate_drive
from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.calibration.heading_sigma import predicted_heading_sigma
from magcal_ros.core.errors import MagcalError, Reason, Refusal
from magcal_ros.core.geometry.attitude import yaw_from_up_and_field
from magcal_ros.core.samples.drive_log import log_of
from magcal_ros.core.samples.window import Window

DEFAULT = Path(__file__).resolve().parents[2] / "shared" / "recordings"
PEERS = ("minmax2", "minmax3", "sphere", "circle", "ellipsoid")
AS_GOOD = 1.1
"""Times the best peer's RMS up to which an answer counts as good as it."""
SIGMAS, FLOOR = 5.0, 2.0
"""An answer is a wrong one beyond so many promised sigmas and so many degrees."""


@dataclass(frozen=True)
class Line:
    """One row of the table."""

    name: str
    window: str
    seconds: float
    grade: str
    why: str
    sigma: float
    ours: Score | None
    others: tuple[float, ...]
    floor: Score | None
    by_truth: Score | None = None
    reported: Score | None = None

    @property
    def answered(self) -> bool:
        return self.grade not in ("refused", "-")

    @property
    def ratio(self) -> float:
        """Our RMS over the best peer's; NaN where either is missing."""
        return self.to_best(self.ours)

    def to_best(self, score: Score | None) -> float:
        """Return a score's RMS over the best peer's; NaN where either is missing."""
        known = [other for other in self.others if math.isfinite(other)]
        return score.rms / min(known) if score and known else math.nan

    @property
    def to_truth(self) -> float:
        """Our RMS over that of the best twelve numbers; NaN where either is missing."""
        return self.ours.rms / self.by_truth.rms if self.ours and self.by_truth else math.nan

    @property
    def is_wrong(self) -> bool:
        """Whether there was a result, and the error is far beyond its sigma.

        A truth has errors of its own, which the floor shows.
        """
        if not self.answered or self.ours is None:
            return False
        return self.beyond_floor * self.sigma > max(SIGMAS * self.sigma, FLOOR)

    @property
    def beyond_floor(self) -> float:
        """Our error beyond that of the gyro alone, over sigma; NaN where nothing was answered."""
        if self.ours is None:
            return math.nan
        own = self.floor.rms if self.floor else 0.0
        return math.sqrt(max(self.ours.rms**2 - own**2, 0.0)) / self.sigma


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", type=Path, nargs="*", default=[DEFAULT])
    parser.add_argument("--only", default="", help="recordings whose name holds this")
    parser.add_argument("--reference", type=float, nargs=2, metavar=("UT", "DIP_DEG"))
    parser.add_argument("--window", default="", help="whole, circles, live or drive")
    parser.add_argument("--asked-every", type=float, metavar="SECONDS", help="as the node, instead")
    parser.add_argument("--changed", choices=[*CHANGES, "all"], help="by other sensors")
    parser.add_argument("--reasons", action="store_true", help="print each verdict's summary")
    arguments = parser.parse_args()
    folders = [f for f in recordings_in(arguments.folders) if arguments.only in f.name]
    ways = CHANGES if arguments.changed == "all" else [arguments.changed]
    for way in ways:
        lines = []
        print(HEADER if way is None else f"{way}\n{HEADER}")
        for folder in folders:
            drive = changed(read_drive(folder, arguments.reference), way)
            for line in run(drive, arguments.window, arguments.asked_every):
                print(row(line) + (f"\n    {line.why}" if arguments.reasons else ""), flush=True)
                lines.append(line)
        print(summary(lines))


def recordings_in(folders: list[Path]) -> list[Path]:
    """Return the recordings among folders and what they hold."""
    found = [f for top in folders for f in [top, *sorted(top.iterdir())] if is_recording(f)]
    return list(dict.fromkeys(found))


def is_recording(folder: Path) -> bool:
    return (folder / "imu.csv").exists() and (folder / "mag.csv").exists()


def run(drive: Drive, only: str, asked_every: float | None) -> list[Line]:
    floor = drive.floor()
    if asked_every:
        asked = asked_on_the_way(drive, asked_every)
        return [fitted(drive, name, window, floor) for name, window in asked]
    found = []
    for name, window in windows(drive) if only != "drive" else ():
        if only in name:
            found.append(fitted(drive, name, window, floor))
    if only in "drive" and drive.everything.angular_rate is not None:
        # The whole recording by the smoother, whatever turns it contains.
        log = log_of(drive.everything)
        found.append(fitted(drive, "drive", log, floor, calibrate_drive(log, drive.knowledge)))
    return found


def fitted(
    drive: Drive,
    name: str,
    window: Window | MagcalError,
    floor: Score | None,
    outcome: Outcome | None = None,
) -> Line:
    if isinstance(window, MagcalError):
        return Line(drive.name, name, 0.0, "-", str(window), math.nan, None, (), floor)
    outcome = outcome or outcome_of(window, drive)
    sigma, ours, by_truth, reported = math.nan, None, None, None
    if outcome.estimate is not None:
        sigma = math.degrees(predicted_heading_sigma(outcome.estimate, 0.0))
        correction = outcome.estimate.correction
        ours = scored(drive, correction)
        by_truth = scored(drive, told_by_truth(drive, correction))
        span = float(window.time[0]), float(window.time[-1])
        reported = scored(drive, told_by_truth(drive, correction, span))
    headings = peers(window)
    scores = [drive.score(heading) if heading else None for heading in map(headings.get, PEERS)]
    others = tuple(score.rms if score else math.nan for score in scores)
    seconds = float(np.ptp(window.time))
    grade, why = graded(outcome), outcome.verdict.summary
    return Line(
        drive.name, name, seconds, grade, why, sigma, ours, others, floor, by_truth, reported
    )


def scored(drive: Drive, correction: Correction | None) -> Score | None:
    return None if correction is None else drive.score(heading_by(correction))


def heading_by(correction: Correction) -> Heading:
    return lambda up, raw: yaw_from_up_and_field(up, correction.apply(raw))


def outcome_of(window: Window, drive: Drive) -> Outcome:
    try:
        return calibrate(window, drive.knowledge)
    except ValueError as fault:
        print(f"broken: {drive.name}: {fault!r}")
        return Outcome.refused(Refusal(Reason.NO_SOLUTION, f"broken: {fault}"))


def graded(outcome: Outcome) -> str:
    return max(outcome.verdict.quality, outcome.verdict.confidence, key=lambda g: g.rank).value


HEADER = (
    f"{'recording':28s}{'window':8s}{'s':>5s} {'verdict':10s}{'sigma':>6s}{'rms':>7s}{'median':>7s}"
    + "".join(f"{name:>10s}" for name in PEERS)
    + f"{'gyro':>7s}{'to best':>8s}{'told':>7s}{'to truth':>9s}"
)


def row(line: Line) -> str:
    ours = (line.ours.rms, line.ours.median) if line.ours else (math.nan, math.nan)
    numbers = [*(number(v, 7) for v in ours), *(number(v, 10) for v in line.others)]
    numbers += ["         -"] * (len(PEERS) - len(line.others))
    numbers += [
        number(line.floor.rms if line.floor else math.nan, 7),
        number(line.ratio, 8),
    ]
    numbers += [number(line.to_best(line.reported), 7), number(line.to_truth, 9)]
    start = f"{line.name:28s}{line.window:8s}{line.seconds:5.0f} {line.grade:10s}"
    wrong = "  WRONG" if line.is_wrong else ""
    return start + number(line.sigma, 6) + "".join(numbers) + wrong


def number(value: float, width: int) -> str:
    if not math.isfinite(value):
        return "-".rjust(width)
    return f"{value:{width}.2f}" if value < 100.0 else f"{value:{width}.0f}"


def summary(lines: list[Line]) -> str:
    text = []
    for window in dict.fromkeys(line.window for line in lines):
        rows = [line for line in lines if line.window == window and math.isfinite(line.ratio)]
        answered = [line for line in rows if line.answered]
        clean = sum(line.grade != Grade.WARN.value for line in answered)
        good = sum(line.ratio <= AS_GOOD for line in answered)
        to_best = mean_of([line.ratio for line in answered])
        reported = mean_of([line.to_best(line.reported) for line in answered])
        to_truth = mean_of([line.to_truth for line in answered])
        wrong = sum(line.is_wrong for line in answered)
        beyond = [line.beyond_floor for line in answered if line.name.startswith("car")]
        square, most = mean_of([value**2 for value in beyond]), max(beyond, default=math.nan)
        text.append(
            f"{window}: {len(answered)} of {len(rows)} with a truth answered ({clean} without a"
            f" warning), {good} of them within {AS_GOOD} of the best peer. Mean ratio"
            f" {to_best:.2f} ({reported:.2f} if the samples' true yaw were given; to what the whole"
            f" truth shows {to_truth:.2f}). Error of cars beyond the gyro's {most:.1f} sigma at"
            f" most, its square {square:.2f} on the mean. Wrong {wrong}"
        )
    return "\n".join(text)


def mean_of(values: list[float]) -> float:
    return sum(values) / len(values) if values else math.nan


if __name__ == "__main__":
    main()
