"""The status topic and the diagnostics of the node."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, astuple
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.session.session import Progress
from magcal_ros.core.session.turn_machine import TurnState
from magcal_ros.files.default_paths import identifier
from magcal_ros.files.disk import printable
from magcal_ros.ros.calibration_store import CalibrationStore
from magcal_ros.ros.heading_pipeline import HeadingPipeline, Inputs
from magcal_ros.ros.known_headings import KnownHeadings
from magcal_ros.ros.magnetometer import Magnetometer
from magcal_ros.ros.magnetometers import Magnetometers
from magcal_ros.ros.self_calibration_runner import SelfCalibrationRunner
from magcal_ros.ros.wire import diagnostic, yaw_values


def status_json(
    magnetometers: Magnetometers, runner: SelfCalibrationRunner, known: KnownHeadings
) -> str:
    """Return the content of `~/status`: one JSON object with stable keys and displayed units."""
    first, watch = magnetometers.active[0], runner.watch
    pipeline, reference = first.pipeline, first.pipeline.reference.reference
    store, streams, turn = first.store, first.inputs.streams, first.control.turn
    state = magnetometers.state.value
    if magnetometers.state is TurnState.IDLE:
        is_calibrated = store.calibration is not None or magnetometers.are_calibrated
        state = "calibrated" if is_calibrated else "uncalibrated"
    outcome, conclusion = turn.last_outcome, turn.last_conclusion
    multi_turn = None if outcome is None else outcome.multi_turn
    content = {
        "state": state,
        "north": reference.north,
        "reference": reference.facts,
        "progress": _progress(turn.progress),
        "answer": None if conclusion is None else asdict(conclusion),
        "verdict": None if outcome is None else _verdict(outcome),
        "turns_kept": turn.turns_kept,
        "several": None if multi_turn is None else multi_turn.facts(),
        "calibration": _calibration(store),
        "watch": watch
        and {
            "stale": watch.is_stale,
            "summary": watch.summary,
            "findings": {f.key: round(f.value or 0.0, 2) for f in watch.findings},
        },
        "magnetometers": magnetometers.facts(),
        "dropped": {
            "imu": {drop.value: n for drop, n in streams.imu_drops.items()},
            "field": {drop.value: n for drop, n in streams.field_drops.items()},
        },
        "complaints": first.inputs.complaints(),
        "turns_itself": pipeline.settings.rotation.enabled,
        "vehicle_yaw_offset": pipeline.travel.yaw_facts(),
        "drive": pipeline.travel.facts(),
        "self_calibration": runner.facts(),
        "motors": pipeline.motors.facts(first.compass),
        "known_headings": known.facts(),
    }
    return json.dumps(content, ensure_ascii=False)


def _progress(progress: Progress | None) -> Mapping[str, Any] | None:
    if progress is None:
        return None
    coverage, sigma = progress.coverage, math.degrees(progress.heading_sigma)
    return {
        "stage": progress.stage.value,
        "arc_deg": round(math.degrees(coverage.arc), 1),
        "gap_deg": round(math.degrees(coverage.gap), 1),
        "turned_deg": round(math.degrees(coverage.turned), 1),
        "filled": "".join("#" if bin_filled else "." for bin_filled in coverage.filled),
        "hole": coverage.hole_in_words,
        "advice": coverage.advice,
        "samples": progress.samples,
        "elapsed_s": round(progress.elapsed, 1),
        "turn_rate_deg_s": round(math.degrees(progress.turn_rate), 1),
        "heading_sigma_deg": round(sigma, 3) if math.isfinite(sigma) else None,
    }


def _verdict(outcome: Outcome) -> Mapping[str, Any]:
    verdict, estimate = outcome.verdict, outcome.estimate
    found = None if estimate is None else estimate.installation
    headline, against = verdict.in_full
    return {
        "accepted": verdict.accepted,
        "quality": verdict.quality.value,
        "confidence": verdict.confidence.value,
        "summary": verdict.summary,
        "headline": headline,
        "against": list(against),
        "reasons": [check.words for check in verdict.checks],
        "not_shown": list(verdict.not_shown),
        "installation_rpy_deg": found and [round(math.degrees(a), 6) for a in astuple(found)],
    }


def _calibration(store: CalibrationStore) -> Mapping[str, Any] | None:
    calibration, origin = store.calibration, store.origin
    if calibration is None or origin is None:
        return None
    correction = calibration.correction
    return {
        "method": calibration.evidence.method,
        "created": origin.created,
        "magnetometer_frame": origin.magnetometer_frame,
        "imu_frame": origin.imu_frame,
        "quality": calibration.evidence.quality,
        "confidence": calibration.evidence.confidence,
        "hard_iron_ut": [round(float(value) * 1e6, 4) for value in correction.hard_iron],
        "correction_matrix": correction.matrix.round(8).tolist(),
        "reference_strength_ut": round(calibration.strength * 1e6, 3),
        "reference_inclination_deg": round(math.degrees(calibration.inclination), 3),
    }


def calibration_diagnostic(first: Magnetometer) -> DiagnosticStatus:
    """Return the diagnostic of the calibration in force: origin, grades, and sensor."""
    store, control, level = first.store, first.control, DiagnosticStatus.OK
    calibration, facts = store.calibration, _calibration(store)
    values = {"state": control.turn.state.value}
    if control.turn.last_conclusion is not None:
        values["last answer"] = control.turn.last_conclusion.message
    if calibration is None or facts is None:
        level = DiagnosticStatus.WARN
        message = "not calibrated: call ~/calibrate and turn the robot once"
    else:
        message = calibration.evidence.summary
        values |= {key: facts[key] for key in ("method", "created", "quality", "confidence")}
        if "warn" in (values["quality"], values["confidence"]):
            level = DiagnosticStatus.WARN
        made_for, there = facts["magnetometer_frame"], identifier(first.inputs.field.frame)
        if made_for and there and made_for != there:
            level = DiagnosticStatus.ERROR
            message = (
                f"made for the magnetometer {made_for!r}, but the field now comes from {there!r}: "
                "let one sensor publish, or calibrate this one"
            )
        if complaints := first.pipeline.complaints():
            level = max(level, DiagnosticStatus.WARN)
            message = "; ".join([*complaints, message])
    if store.problem:
        level, message = DiagnosticStatus.ERROR, store.problem
    return diagnostic("Calibration", message, values, level)


def field_diagnostic(pipeline: HeadingPipeline) -> DiagnosticStatus:
    """Return the diagnostic of the corrected field, compared with calibration and reference."""
    reading, calibration = pipeline.headings.reading, pipeline.leading
    reference = pipeline.reference.reference
    values, level = dict[str, str](), DiagnosticStatus.OK
    if calibration is None:
        message = "no corrected field before a calibration is in force"
    elif reading is None:
        message = "no field message since the calibration was put in force"
    else:
        strength, heading = math.hypot(*reading.field), reading.heading
        shown, calibrated = f"{strength * 1e6:.1f} µT", f"{calibration.strength * 1e6:.1f} µT"
        values = {"corrected strength": shown, "calibrated strength": calibrated}
        values |= yaw_values(heading)
        message = f"{shown}, calibrated {calibrated}"
        if not 0.7 < strength / max(calibration.strength, 1e-9) < 1.4:
            level = DiagnosticStatus.WARN
            message += ": something magnetic is near, or the calibration belongs to another sensor"
    values["reference"] = reference.words
    if reference.complaints:
        level = max(level, DiagnosticStatus.WARN)
    words = "; ".join([message, *reference.complaints])
    return diagnostic("Field", words, values, level)


def watch_diagnostic(runner: SelfCalibrationRunner) -> DiagnosticStatus:
    """Return the diagnostic of whether the calibration holds, and of self-calibration."""
    values = {"self-calibration": runner.facts()["doing"], "fits lost": str(runner.lost)}
    words, is_wrong = ["nothing to watch before a calibration is in force"], bool(runner.problem)
    watch = runner.watch
    if watch is not None:
        words, is_wrong = [watch.summary], is_wrong or watch.is_stale
        values |= {f.name: f"{f.value or 0.0:.1f}{f.unit}" for f in watch.findings}
    words += [runner.problem] if runner.problem else []
    level = DiagnosticStatus.WARN if is_wrong else DiagnosticStatus.OK
    return diagnostic("Watch", "; ".join(words), values, level)


def inputs_diagnostic(
    inputs: Inputs, complaints: list[str], callback_errors: int
) -> DiagnosticStatus:
    """Return the diagnostic of the inputs: rates, complaints and errors in callbacks."""
    both = (inputs.imu, inputs.streams.imu_drops), (inputs.field, inputs.streams.field_drops)
    values = {f"{sensor.topic} messages": str(sensor.messages) for sensor, _ in both}
    values |= {f"{sensor.topic} rate": f"{sensor.rate:.1f} Hz" for sensor, _ in both}
    for sensor, drops in both:
        values |= {f"{sensor.topic} {drop.value}": str(n) for drop, n in drops.items()}
    values["callback errors"] = str(callback_errors)
    level = DiagnosticStatus.ERROR if complaints else DiagnosticStatus.OK
    return diagnostic("Inputs", "; ".join(complaints) or "both sensors arrive", values, level)


def diagnostic_array(
    node: str, statuses: Iterable[DiagnosticStatus], frame: str, stamp: Time
) -> DiagnosticArray:
    """Return the statuses with the node in their names and the sensor's frame as hardware id."""
    array = DiagnosticArray(status=list(statuses))
    array.header.stamp = stamp
    for status in array.status:
        status.name = f"{node}: {status.name}"
        status.hardware_id = printable(frame) or "magnetometer"
    return array
