"""The samples as a report shows them."""

from dataclasses import replace

import numpy as np
from subjects import good

from magcal_ros.core.calibration import MotorField, MotorInput
from magcal_ros.core.doctor import SensorReport
from magcal_ros.report import turn


def test_the_field_of_the_motors_is_subtracted_as_the_node_does(monkeypatch):
    """With 7 µT of motors the drawn deviation was 17 degrees, with a sigma of .3 degrees."""
    monkeypatch.setattr(turn, "examine_window", lambda *_: SensorReport(()))
    subject = good()
    gain, zeros = np.array([[5e-6, 4e-6, 0.0]]), np.zeros((12, 3))
    motors = MotorField((MotorInput.MOVING,), gain, 1e-14 * np.eye(3), zeros, 1e-7, (1.0,))
    known = replace(subject.outcome.calibration, motors=motors)
    outcome = replace(subject.outcome, calibration=known)
    window = replace(subject.window, field=subject.window.field + gain)
    seen = turn.Turn.of(replace(subject, window=window, outcome=outcome)).corrected
    usual = turn.Turn.of(subject).corrected
    assert np.std(seen.deviation) < 1.2 * np.std(usual.deviation)
    assert np.mean(np.abs(seen.deviation) < 2.0 * seen.sigma) > 0.9
