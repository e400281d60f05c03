"""What the node tells the world about itself: the status topic and the diagnostics."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from magcal_ros.core.reference import Reference
from magcal_ros.core.session import Progress
from magcal_ros.core.verdict import Verdict
from magcal_ros.core.watch import Watch, Watched
from magcal_ros.ros.control import Control, State
from magcal_ros.ros.inputs import Inputs
from magcal_ros.ros.keeper import Keeper
from magcal_ros.ros.outputs import Outputs


def status_json(
    control: Control,
    keeper: Keeper,
    inputs: Inputs,
    reference: Reference,
    watch: Watch | None,
    turns_itself: bool,
) -> str:
    """Return the content of `~/status`: one JSON object, stable keys, people's units."""
    state = control.state.value
    if control.state is State.IDLE:
        state = "uncalibrated" if keeper.calibration is None else "calibrated"
    outcome, conclusion = control.last_outcome, control.last_conclusion
    return json.dumps(
        {
            "state": state,
            "north": reference.north,
            "reference": reference.facts,
            "turns_itself": turns_itself,
            "progress": _progress(control.progress),
            "answer": None
            if conclusion is None
            else {"success": conclusion.success, "message": conclusion.message},
            "verdict": None if outcome is None else _verdict(outcome.verdict),
            "calibration": _calibration(keeper),
            "watch": None if watch is None else _watch(watch.watched),
            "dropped": {
                "imu": {drop.value: n for drop, n in inputs.streams.imu_drops.items()},
                "field": {drop.value: n for drop, n in inputs.streams.field_drops.items()},
            },
            "complaints": inputs.complaints(),
        },
        ensure_ascii=False,
    )


def _progress(progress: Progress | None) -> Mapping[str, Any] | None:
    if progress is None:
        return None
    coverage = progress.coverage
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
        "heading_sigma_deg": round(math.degrees(progress.heading_sigma), 3)
        if math.isfinite(progress.heading_sigma)
        else None,
    }


def _verdict(verdict: Verdict) -> Mapping[str, Any]:
    return {
        "accepted": verdict.accepted,
        "quality": verdict.quality.value,
        "confidence": verdict.confidence.value,
        "summary": verdict.summary,
        "reasons": [check.words for check in verdict.checks],
        "not_shown": list(verdict.not_shown),
    }


def _watch(watched: Watched) -> Mapping[str, Any]:
    return {
        "stale": watched.is_stale,
        "summary": watched.summary,
        "findings": {f.figure: round(f.after, 2) for f in watched.findings},
    }


def _calibration(keeper: Keeper) -> Mapping[str, Any] | None:
    calibration, origin = keeper.calibration, keeper.origin
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


def calibration_diagnostic(name: str, control: Control, keeper: Keeper) -> DiagnosticStatus:
    """Say whether a calibration is in force, which, and how good it was."""
    status = _named(name, "Calibration")
    calibration, origin = keeper.calibration, keeper.origin
    values = {"state": control.state.value}
    if control.last_conclusion is not None:
        values["last answer"] = control.last_conclusion.message
    if calibration is None or origin is None:
        status.level = DiagnosticStatus.WARN
        status.message = "not calibrated: call ~/calibrate and turn the robot once"
    else:
        status.message = calibration.evidence.summary
        values |= {
            "method": calibration.evidence.method,
            "created": origin.created,
            "quality": calibration.evidence.quality,
            "confidence": calibration.evidence.confidence,
        }
        if "warn" in (calibration.evidence.quality, calibration.evidence.confidence):
            status.level = DiagnosticStatus.WARN
    if keeper.trouble:
        status.level = DiagnosticStatus.ERROR
        status.message = keeper.trouble
    status.values = _key_values(values)
    return status


def field_diagnostic(
    name: str, outputs: Outputs, keeper: Keeper, reference: Reference
) -> DiagnosticStatus:
    """Say whether the field looks like the calibrated one, and what it is compared with."""
    status = _corrected_field(name, outputs, keeper)
    status.values = [*status.values, KeyValue(key="reference", value=reference.words)]
    if reference.complaints:
        status.level = max(status.level, DiagnosticStatus.WARN)
        status.message = "; ".join([status.message, *reference.complaints])
    return status


def _corrected_field(name: str, outputs: Outputs, keeper: Keeper) -> DiagnosticStatus:
    status = _named(name, "Field")
    calibration, heading = keeper.calibration, outputs.last_heading
    if calibration is None:
        status.message = "no corrected field before a calibration is in force"
        return status
    if outputs.last_field is None:
        status.message = "no field has come since the calibration is in force"
        return status
    strength = math.hypot(*outputs.last_field)
    values = {
        "corrected strength": f"{strength * 1e6:.1f} µT",
        "calibrated strength": f"{calibration.strength * 1e6:.1f} µT",
    }
    status.message = f"{strength * 1e6:.1f} µT, calibrated {calibration.strength * 1e6:.1f} µT"
    if heading is not None:
        values["yaw"] = f"{math.degrees(heading.yaw):.1f}° (ENU, magnetic)"
        values["yaw sigma"] = f"{math.degrees(math.sqrt(heading.yaw_variance)):.2f}°"
    if not 0.7 < strength / max(calibration.strength, 1e-9) < 1.4:
        status.level = DiagnosticStatus.WARN
        status.message += ": something magnetic is near, or the calibration is another sensor's"
    status.values = _key_values(values)
    return status


def watch_diagnostic(name: str, watch: Watch | None) -> DiagnosticStatus:
    """Say whether the calibration has held over the last minutes of driving."""
    status = _named(name, "Watch")
    if watch is None:
        status.message = "nothing to watch before a calibration is in force"
        return status
    watched = watch.watched
    status.message = watched.summary
    if watched.is_stale:
        status.level = DiagnosticStatus.WARN
    status.values = _key_values({f.name: f"{f.after:.1f}{f.unit}" for f in watched.findings})
    return status


def inputs_diagnostic(
    name: str, inputs: Inputs, parameter_complaints: list[str]
) -> DiagnosticStatus:
    """Say whether both sensors arrive, and what is wrong with their messages."""
    status = _named(name, "Inputs")
    complaints = inputs.complaints() + parameter_complaints
    status.message = "; ".join(complaints) or "both sensors arrive"
    status.level = DiagnosticStatus.ERROR if complaints else DiagnosticStatus.OK
    values = {
        f"{sensor.topic} messages": str(sensor.messages) for sensor in (inputs.imu, inputs.field)
    }
    for sensor, drops in (
        (inputs.imu, inputs.streams.imu_drops),
        (inputs.field, inputs.streams.field_drops),
    ):
        values |= {f"{sensor.topic} {drop.value}": str(n) for drop, n in drops.items()}
    status.values = _key_values(values)
    return status


def _named(name: str, part: str) -> DiagnosticStatus:
    status = DiagnosticStatus(name=f"{name}: {part}", hardware_id="magnetometer")
    status.level = DiagnosticStatus.OK
    return status


def _key_values(values: Mapping[str, str]) -> list[KeyValue]:
    return [KeyValue(key=key, value=value) for key, value in values.items()]
