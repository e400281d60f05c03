"""The samples as a report shows them."""

from collections import deque
from dataclasses import replace

import numpy as np
import pytest
from subjects import good, subject_of

from magcal_ros.core import Compass, Knowledge, Mounting
from magcal_ros.core.calibration import MotorField, MotorInput
from magcal_ros.core.doctor import SensorReport
from magcal_ros.core.geometry import wrap_angle
from magcal_ros.core.heading import CompassReader
from magcal_ros.core.samples import ImuSample
from magcal_ros.core.session import SampleCollector, fit_collected
from magcal_ros.core.simulation import Ride, Robot
from magcal_ros.core.up import UpFollower
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


LATE_STEPS, SCALE = 4, 0.02


def late_turn():
    """A turn between rests, its field 80 ms late, its gyro of a wrong scale, and its yaw."""
    ride = Ride(Robot(noise_field=0.3e-6, noise_rate=2e-3), np.random.default_rng(5), start=10.0)
    samples, yaws, values = [], {}, deque(maxlen=LATE_STEPS + 1)
    for rate in [0.0] * 200 + [0.75] * 450 + [0.0] * 200:
        for sample in ride.step(rate):
            if isinstance(sample, ImuSample):
                rates = (1.0 + SCALE) * np.array(sample.rate)
                samples.append(sample._replace(rate=tuple(rates.tolist())))
            else:
                values.append(sample.field)
                yaws[sample.stamp] = ride.magnetic_yaw
                samples.append(sample._replace(field=values[0]))
    return samples, yaws


def read_by_node(samples, calibration):
    """What the node reads in these messages: headings by the stamps of the field."""
    follower, compass, found = UpFollower(), Compass(calibration), {}
    reader = CompassReader(follower)
    for sample in samples:
        if isinstance(sample, ImuSample):
            follower.add(sample)
        else:
            follower.add_field(sample.stamp, sample.field)
            found[sample.stamp] = reader.read(compass, sample)
    return found


def test_a_late_field_is_corrected_as_in_the_node():
    """The drawn yaw was 3.5 degrees behind the published one."""
    samples, yaws = late_turn()
    collector = SampleCollector(Mounting())
    collector.take(samples)
    window, outcome = collector.window(), fit_collected(collector, Knowledge())
    # A late field looks a little like one of motors; the estimate of that begins at a rest.
    outcome = replace(outcome, calibration=replace(outcome.calibration, motors=None))
    shown = turn.Turn.of(subject_of(window, Knowledge(), outcome))
    stamps, published = window.time.tolist(), read_by_node(samples, outcome.calibration)
    readings = [published[stamp] for stamp in stamps]
    # Near the rests, the window has fewer IMU samples than the node.
    off = np.abs(shown.corrected.field - [each.field for each in readings]).max(axis=1)
    assert np.quantile(off, 0.95) < 0.01e-6
    gap = wrap_angle(shown.corrected.yaw - [each.heading.yaw for each in readings])
    assert np.degrees(np.sqrt(np.mean(gap**2))) < 0.5
    sigma = np.sqrt([each.heading.yaw_variance for each in readings])
    assert shown.corrected.sigma == pytest.approx(sigma, rel=0.15)
    true = np.unwrap([yaws[stamp] for stamp in stamps])
    assert abs(np.degrees(np.mean(wrap_angle(shown.corrected.yaw - true)))) < 1.0
    # The uncorrected gyro has measured 4 degrees more.
    assert np.degrees(np.ptp(shown.angle)) == pytest.approx(np.degrees(np.ptp(true)), abs=1.5)
