"""Recordings with good axes have no fault of axes; bad stamps are named."""

import numpy as np
import pytest
from long_form import first_of

from magcal_ros.core import Knowledge, Mounting
from magcal_ros.core.doctor import examine, wrong_axes
from magcal_ros.core.knowledge import knowledge_of
from magcal_ros.core.samples import SensorLog
from magcal_ros.core.session import SampleCollector, fit_collected
from magcal_ros.files import open_recording

GOOD = (
    "car_drive_neu2022_rahul",
    "broad05",
    "car_circles_neu2025_kiran",
    "car_neu2022_rahul",
    "car_neu2023_huang",
    "car_neu2024_gautham",
    "car_neu2024_jackg",
    "car_neu2024_rohx",
    "car_neu2024_yash",
)
BIASED = "car_neu2024_yash"
BURSTS = "car_neu2023_aswin_asrec"


def log_of(folder):
    with open_recording(folder) as source:
        return SensorLog.of(r for r in source.readings() if r is not None)


def report_of(folder):
    return examine(log_of(folder))


@pytest.mark.nightly
@pytest.mark.parametrize("name", first_of([*GOOD, BURSTS]))
def test_the_axes_of_recordings_are_not_called_wrong(recording, name):
    collector = SampleCollector(Mounting())
    with open_recording(recording(name)) as source:
        collector.take(source.readings())
    assert wrong_axes(collector.window(), Knowledge()) is None


@pytest.mark.parametrize("name", first_of([name for name in GOOD if name != BIASED]))
def test_good_recorded_sensors_have_no_fault(recording, name):
    assert [f for f in report_of(recording(name)).findings if f.is_wrong] == []


@pytest.mark.nightly
@pytest.mark.parametrize("bias", first_of([(2.0, -1.5, 1.0), (-2.0, 2.0, -3.0)]))
def test_a_biased_gyro_has_no_wrong_axes_on_a_drive_that_begins_with_a_rest(recording, bias):
    """With the bias, the rates are largest while the vehicle stands."""
    log = log_of(recording("car_drive_neu2022_rahul"))
    imu, field = (time < log.imu_time[0] + 240.0 for time in (log.imu_time, log.field_time))
    rate = log.rate[imu] + np.radians(bias)
    log = SensorLog(
        log.imu_time[imu], log.force[imu], rate, log.field_time[field], log.field[field]
    )
    assert {f.key for f in examine(log).findings if f.is_wrong} <= {"gyro_bias"}


@pytest.mark.nightly
def test_stamps_in_bursts_are_named(recording):
    wrong = [f for f in report_of(recording(BURSTS)).findings if f.is_wrong]
    assert [f.name for f in wrong] == ["IMU: stamps", "field: stamps"]
    assert all("bursts" in f.remedy for f in wrong)


@pytest.mark.nightly
def test_a_turn_with_bad_stamps_is_refused_for_them(recording):
    """As in a node, which cannot wait for the end of a recording to spread them."""
    collector = SampleCollector(Mounting())
    with open_recording(recording(BURSTS), start=30.0, stop=80.0) as source:
        collector.take(source.readings())
    outcome = fit_collected(collector, knowledge_of(51.3, inclination_deg=66.3))
    assert not outcome.verdict.accepted
    assert "gyro and field do not match: the stamps come in bursts" in outcome.verdict.summary


@pytest.mark.nightly
def test_the_gyro_bias_is_measured_at_rest(recording):
    (bias,) = [f for f in report_of(recording(BIASED)).findings if f.is_wrong]
    assert bias.key == "gyro_bias"
    assert bias.evidence.startswith("(3.5")


@pytest.mark.nightly
@pytest.mark.parametrize("seconds", first_of([29.0, 28.0, 31.0]))
def test_a_leaning_car_does_not_determine_the_inclination(recording, seconds):
    """The gyro shows no more tilt than the bends tilt the accelerometer's up."""
    collector = SampleCollector(Mounting())
    with open_recording(recording("car_neu2023_ampomah")) as source:
        collector.take(source.readings())
    window = collector.window()
    part = window.take(window.time >= window.time[-1] - seconds)
    assert wrong_axes(part, knowledge_of(51.2, inclination_deg=66.2)) is None


@pytest.mark.nightly
def test_a_disturbed_street_does_not_determine_the_gyro_unit(recording):
    """The car drives straight on; the field changes by 21 µT from place to place."""
    folder = recording("car_drive_neu2022_rahul")
    with open_recording(folder, start=195.2, stop=215.2) as source:
        report = examine(SensorLog.of(r for r in source.readings() if r is not None))
    assert [f for f in report.findings if f.is_wrong] == []


@pytest.mark.nightly
@pytest.mark.parametrize("start", first_of([6.7, 8.0]))
def test_a_large_bias_at_rest_is_the_only_finding(recording, start):
    """Fits that begin without it end far from the truth, and other axes seem to fit better."""
    with open_recording(recording(BIASED), start=start, stop=start + 60.0) as source:
        report = examine(SensorLog.of(r for r in source.readings() if r is not None))
    assert [f.key for f in report.findings if f.is_wrong] == ["gyro_bias"]
