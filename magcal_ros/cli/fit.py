"""`magcal fit`: a calibration from a recording, without ROS."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from magcal_ros.cli import common, recorded
from magcal_ros.cli.recorded import CollectedRecording
from magcal_ros.core.calibrate import METHOD_WORDS, METHODS, ONE_SMOOTHER, Outcome, calibrate
from magcal_ros.core.calibration.calibration import Estimate
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import calibration_sigma, every_figure
from magcal_ros.core.errors import UsageError
from magcal_ros.core.geometry.attitude import usual_size
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.multi_turn.result import names_of
from magcal_ros.core.samples.window import Window
from magcal_ros.core.session.recorded import LITTLE_DATA, fit_collected, fit_several
from magcal_ros.files.calibration_file import Origin, write_calibration
from magcal_ros.files.disk import FileError, printable
from magcal_ros.report import Subject, write_report


@dataclass(frozen=True, eq=False)
class FitResult:
    """A recording, or several that were joined, and the result."""

    recording: CollectedRecording  # of several recordings, the last that was joined
    knowledge: Knowledge
    outcome: Outcome
    everything: Sequence[CollectedRecording]

    @property
    def complaints(self) -> list[str]:
        """The faults of the recordings, in words."""
        found = [words for each in self.everything for words in each.complaints()]
        return list(dict.fromkeys(found))

    @property
    def status(self) -> common.Exit:
        """The exit status."""
        if self.outcome.verdict.accepted:
            return common.Exit.GOOD
        is_little = self.outcome.reason in LITTLE_DATA
        return common.Exit.TOO_LITTLE_DATA if is_little else common.Exit.REFUSED


def add_fit(commands: Any) -> None:
    """Add the command's arguments."""
    parser = common.command(commands, "fit", run, "calibrate from a recording")
    recorded.add_recording_options(parser, several=True)
    common.add_output_option(parser, "calibration and report", "magcal_fit")
    words = f"{METHOD_WORDS}: {', '.join(METHODS)}"
    named: dict[str, Any] = {"choices": METHODS, "metavar": "METHOD"}
    parser.add_argument("--method", default=METHODS[0], help=words, **named)
    parser.add_argument(
        "--compare", action="store_true", help="print the results of all methods; write no files"
    )
    recorded.add_heading_options(parser)
    recorded.add_knowledge_options(parser)


def run(options: argparse.Namespace) -> int:
    """Calibrate from a recording of a turn or a drive, as the node does live.

    Several recordings of turns at different tilts are joined into one estimate, which includes the
    yaw of the installation. Exit status: 0 good, 2 usage, 3 too little data, 4 refused, 5 file
    trouble.
    """
    folder = common.new_or_named(options.output, "magcal_fit")
    # An existing calibration is never overwritten.
    if (folder / common.CALIBRATION).exists():
        raise FileError(f"{folder / common.CALIBRATION} exists already: name another --output")
    _check_use(options)
    mounting, everything = recorded.mounting_from(options), list[CollectedRecording]()
    for path in options.recordings:
        with recorded.opened(options, path) as source:
            everything.append(recorded.collect(options, mounting, source))
    count = sum(sum(each.repaired.read) for each in everything)
    shares = [0.0]
    with recorded.with_progress(lambda: f"fitting {count} messages, {100.0 * shares[-1]:.0f}%"):
        fitted = _fit(everything, options, shares.append)
    if options.compare:
        common.tell(compare_methods(fitted.outcome.window, fitted.knowledge))
        return fitted.status
    quality, files = fitted.outcome.verdict.quality.value, list[Path]()
    try:
        with recorded.with_progress(lambda: f"quality {quality}; writing the report"):
            files.extend(_write_files(folder, fitted, options))
    finally:  # an error must not hide the result
        common.tell_result(_facts(fitted, files), _words(fitted, files), as_json=options.json)
    return fitted.status


def _check_use(options: argparse.Namespace) -> None:
    recorded.check_heading_options(options)
    if options.compare and options.json:
        raise UsageError("--compare prints a table without JSON: leave out --compare or --json")
    if len(options.recordings) == 1:
        return
    if options.compare:
        raise UsageError("--compare takes one recording, because not all methods join several")
    if options.start > 0.0 or options.stop < math.inf:
        raise UsageError(
            "--from and --to take one recording: several recordings are used as a whole"
        )


def _fit(
    everything: Sequence[CollectedRecording],
    options: argparse.Namespace,
    report_share: Callable[[float], object],
) -> FitResult:
    frames = sorted({each.source.field_frame for each in everything if each.source.field_frame})
    if len(frames) > 1:
        raise UsageError(
            f"the recordings are of different magnetometers ({', '.join(frames)}); join only "
            "recordings of one sensor"
        )
    # All turns are made at one place, so the first recording with a known field gives the
    # reference.
    known = next((g for g in everything if g.reference.field.is_complete), everything[0])
    knowledge = Knowledge(known.reference.field, known.collector.mounting)
    recording, outcome = everything[-1], recorded.fit_known(options, knowledge)
    if outcome is None and len(everything) == 1:
        outcome = fit_collected(known.collector, knowledge, options.method, report_share)
    elif outcome is None:
        names = names_of([str(path) for path in options.recordings])
        collectors = [each.collector for each in everything]
        outcome, newest = fit_several(collectors, names, knowledge, options.method)
        recording = replace(everything[newest], reference=known.reference)
    return FitResult(recording, knowledge, outcome, everything)


def _write_files(folder: Path, fitted: FitResult, options: argparse.Namespace) -> Iterator[Path]:
    """Write the result into the folder, and yield each file that was written."""
    outcome, source = fitted.outcome, fitted.recording.source
    if outcome.calibration is not None and outcome.verdict.accepted:
        origin = Origin.now(source.field_frame, source.imu_frame)
        file = folder / common.CALIBRATION
        write_calibration(file, outcome.calibration, origin, remedy=common.REMEDY)
        yield file
    if outcome.window is not None:
        paths = ", ".join(printable(str(path)) for path in options.recordings)
        subject = Subject(
            outcome.window,
            fitted.knowledge,
            outcome,
            source=f"{paths} ({source.field_topic} and {source.imu_topic})",
            method=options.method,
            magnetometer_frame=source.field_frame,
            imu_frame=source.imu_frame,
        )
        yield write_report(folder, subject)


GIVE_PLACE = (
    "give --latitude and --longitude, or --reference-strength-ut and --reference-inclination-deg"
)
APART = (
    "the heading errors above do not include the unknown soft iron and the unknown yaw of the "
    "installation"
)


def _words(fitted: FitResult, files: list[Path]) -> str:
    verdict, estimate = fitted.outcome.verdict, fitted.outcome.estimate
    headline, reasons = verdict.in_full
    is_drive = estimate is not None and Figure.HEADINGS_DRIVEN in estimate.figures
    # For a drive, local disturbances and the number of headings are more informative.
    left_out = ("residual_percent", "arc_deg") if is_drive else ()
    rows = [row[1:] for row in _numbers(fitted) if row[0] not in left_out]
    text = common.with_options(headline) + "\n"
    against = "But" if verdict.accepted else "The reasons"
    text += common.bullets(f"{against}:", [common.with_options(words) for words in reasons])
    reference = fitted.recording.reference
    known = reference.words if reference.is_known else f"{reference.words}: {GIVE_PLACE}"
    text += f"\n{common.table(rows)}\n\nReference field: {known}.\n"
    multi_turn = fitted.outcome.multi_turn
    if multi_turn is not None:
        lines = [
            f"{fate.name}: {'' if fate.joined else 'left out: '}{fate.words}"
            for fate in multi_turn.turns
        ]
        has_yaw = estimate is not None and Figure.INSTALLATION_YAW_SIGMA in estimate.figures
        title = "Turns:" if has_yaw else f"Turns ({APART}):"
        text += common.bullets(title, [*lines, multi_turn.advice_in_words])
    which = "this recording" if len(fitted.everything) == 1 else "these recordings"
    text += common.bullets(f"Not shown by {which}:", verdict.not_shown)
    text += common.bullets("About the recording:", fitted.complaints)
    text += common.bullets("Written:", [str(file) for file in files])
    if fitted.status != common.Exit.GOOD:
        text += "\nNo calibration was written.\n"
    return text.rstrip("\n")


def _facts(fitted: FitResult, files: list[Path]) -> dict[str, Any]:
    recording, outcome = fitted.recording, fitted.outcome
    verdict = outcome.verdict
    return {
        "summary": verdict.summary,
        "accepted": verdict.accepted,
        "quality": verdict.quality.value,
        "confidence": verdict.confidence.value,
        "reason": outcome.reason.value if outcome.reason else None,
        "checks": [
            {"figure": c.key, "aspect": c.aspect.value, "grade": c.grade.value, "words": c.words}
            for c in verdict.checks
        ],
        "not_shown": list(verdict.not_shown),
        "numbers": {key: float(number) for key, _, number, _ in _numbers(fitted)},
        "recording": {
            "imu_topic": recording.source.imu_topic,
            "mag_topic": recording.source.field_topic,
            "complaints": fitted.complaints,
        },
        "reference": recording.reference.facts,
        "several": None if outcome.multi_turn is None else outcome.multi_turn.facts(),
        "files": [str(file) for file in files],
        "exit": int(fitted.status),
    }


def _numbers(fitted: FitResult) -> list[tuple[str, str, str, str]]:
    """Return key, name, number and unit of the printed quantities."""
    collector, source = fitted.recording.collector, fitted.recording.source
    imus, fields = fitted.recording.repaired.read
    window, estimate = fitted.outcome.window, fitted.outcome.estimate
    used = 0 if window is None else len(window)
    arc = math.degrees(collector.progress().coverage.arc if estimate is None else estimate.arc)
    rows = [
        ("imu_messages", f"messages on {source.imu_topic}", f"{imus}", ""),
        ("mag_messages", f"messages on {source.field_topic}", f"{fields}", ""),
        ("samples", "samples in the fit", f"{used}", ""),
        ("arc_deg", "measured arc", f"{arc:.0f}", "°"),
    ]
    return rows if estimate is None else rows + _found(estimate, window)


def _before_correction(
    estimate: Estimate, window: Window | None
) -> list[tuple[str, str, str, str]]:
    """Return the strengths at the sensor, if only a part of the field reaches the sensor."""
    if window is None or Figure.LEVEL_SHARE not in estimate.figures:
        return []
    iron = estimate.correction.hard_iron
    raw, without = (1e6 * usual_size(window.field - h) for h in (np.zeros(3), iron))
    share = 100.0 * estimate.figures[Figure.LEVEL_SHARE]
    return [
        ("raw_strength_ut", "strength at the sensor, usually", f"{raw:.1f}", "µT"),
        ("sensor_strength_ut", "  without its hard iron", f"{without:.1f}", "µT"),
        ("level_share_percent", "Earth's level field at the sensor", f"{share:.1f}", "%"),
    ]


def _found(estimate: Estimate, window: Window | None) -> list[tuple[str, str, str, str]]:
    iron = estimate.correction.hard_iron * 1e6
    sigmas = np.sqrt(np.diag(estimate.covariance)[-3:]) * 1e6
    rows = []
    for axis, value, sigma in zip("xyz", iron, sigmas, strict=True):
        rows.append((f"hard_iron_{axis}_ut", f"hard iron {axis}", f"{value:.2f}", "µT"))
        rows.append((f"hard_iron_{axis}_sigma_ut", "  its error (1σ)", f"{sigma:.2f}", "µT"))
    figures = every_figure(estimate)
    if Figure.HEADINGS_DRIVEN in figures:
        driven = f"{figures[Figure.HEADINGS_DRIVEN]:.0f}"
        rows.insert(0, ("headings_driven", "headings driven", driven, "of 12"))
    if estimate.installation is not None:
        sigma = figures.get(Figure.INSTALLATION_YAW_SIGMA)
        for axis in ("roll", "pitch") if sigma is None else ("roll", "pitch", "yaw"):
            angle = math.degrees(getattr(estimate.installation, axis))
            rows.append((f"installation_{axis}_deg", f"installation {axis}", f"{angle:.2f}", "°"))
        if sigma is not None:
            error = f"{math.degrees(sigma):.2f}"
            rows.append(("installation_yaw_sigma_deg", "  its error (1σ)", error, "°"))
    rows += _before_correction(estimate, window)
    rows += [
        ("strength_ut", "strength of the corrected field", f"{estimate.strength * 1e6:.1f}", "µT"),
        ("inclination_deg", "  its inclination", f"{math.degrees(estimate.inclination):.1f}", "°"),
    ]
    along = ""
    if Figure.LOCAL_SIGMA in figures:
        own, along = math.degrees(calibration_sigma(estimate)), " along the drive"
        name = "heading error by the calibration (1σ), level"
        rows.append(("calibration_sigma_deg", name, f"{own:.2f}", "°"))
    for figure, name in (
        (Figure.HEADING_SIGMA, f"heading error{along} (1σ), level"),
        (Figure.HEADING_SIGMA_TILTED, f"heading error{along} (1σ), 10° of tilt"),
        (Figure.GYRO_COMPASS_SWING, "gyro against compass, beyond noise"),
    ):
        if figure in figures:
            angle = math.degrees(figures[figure])
            rows.append((f"{figure.value}_deg", name, f"{angle:.2f}", "°"))
    ratio = 100.0 * figures[Figure.RESIDUAL_RATIO]
    rows.append(("residual_percent", "residual against the level field", f"{ratio:.1f}", "%"))
    return rows


HEADER = ("method", "verdict", "hard iron x, y, z (µT)", "heading ±", "residual")


def compare_methods(window: Window | None, knowledge: Knowledge) -> str:
    """Return a table of the results of each method for a window, and the reasons without one."""
    if window is None:
        return "there are no results: the recording has no usable turn"
    outcomes = {
        method: calibrate(window, knowledge, method)
        for method in METHODS
        if method not in ONE_SMOOTHER[1:]
    }
    rows = [HEADER, *(_row(method, outcome) for method, outcome in outcomes.items())]
    why = (f"{method}: {outcome.verdict.summary}" for method, outcome in outcomes.items())
    return "\n".join([common.table(rows), "", *why])


def _row(method: str, outcome: Outcome) -> tuple[str, ...]:
    accepted = "accepted" if outcome.verdict.accepted else "refused"
    estimate = outcome.estimate
    if estimate is None:
        return method, accepted, "-", "-", "-"
    iron = ", ".join(f"{value * 1e6:.2f}" for value in estimate.correction.hard_iron)
    figures = every_figure(estimate)
    sigma = f"{math.degrees(figures[Figure.HEADING_SIGMA]):.2f}°"
    return method, accepted, iron, sigma, f"{100.0 * figures[Figure.RESIDUAL_RATIO]:.1f}%"
