"""Stamps of buffer reads in recordings are replaced by times of measurement."""

import numpy as np
import pytest
from drives import drive, write_bag, write_csv

from magcal_ros.core import Refusal
from magcal_ros.core.samples import ImuSample
from magcal_ros.files import RepairedReadings, open_recording

PERIOD = 0.8


def buffered(samples, sensors=(True, False)):
    """Stamp the samples of some sensors, IMU or not, when a buffer would have been read."""
    return [
        sample._replace(stamp=(sample.stamp // PERIOD + 1.0) * PERIOD)
        if isinstance(sample, ImuSample) in sensors
        else sample
        for sample in samples
    ]


def stamps(samples, of_imu):
    return np.array([s.stamp for s in samples if isinstance(s, ImuSample) is of_imu])


def read(path):
    with open_recording(path) as source:
        readings = RepairedReadings(source)
        return list(readings), readings.notes


@pytest.fixture(scope="module")
def turn():
    return list(drive(400.0, hertz=50.0))


@pytest.mark.parametrize("write", [write_csv, write_bag])
def test_a_turn_with_bursts_gets_its_times_of_measurement(write, turn, tmp_path):
    samples, notes = read(write(tmp_path / "one", buffered(turn)))
    for of_imu in (True, False):
        late = stamps(samples, of_imu) - stamps(turn, of_imu)
        assert np.ptp(late) < 0.06
        assert abs(np.median(late)) < 0.06
    assert len(notes) == 1
    assert f"bursts, {PERIOD:.2f} s apart" in notes[0]
    assert " and " in notes[0].partition(":")[0]


def test_one_sensor_alone_may_be_buffered(turn, tmp_path):
    samples, notes = read(write_csv(tmp_path / "one", buffered(turn, sensors=(False,))))
    np.testing.assert_array_equal(stamps(samples, True), stamps(turn, True))
    assert np.ptp(stamps(samples, False) - stamps(turn, False)) < 0.06
    assert notes[0].startswith("mag.csv: ")


@pytest.mark.parametrize(("write", "is_table"), [(write_csv, True), (write_bag, False)])
def test_milliseconds_without_a_unit_are_refused_and_of_a_table_explained(
    write, is_table, turn, tmp_path
):
    late = [sample._replace(stamp=1e3 * sample.stamp) for sample in turn]
    with pytest.raises(Refusal, match="Hz by its stamps, too slowly") as caught:
        read(write(tmp_path / "one", late))
    words = "If the stamps are not seconds, name their unit in the header, as in t [ms]"
    assert (words in str(caught.value)) is is_table


def test_even_stamps_are_unchanged(turn, tmp_path):
    samples, notes = read(write_csv(tmp_path / "one", turn))
    assert samples == turn
    assert notes == []


def test_stamps_are_not_spread_over_a_pause(turn, tmp_path):
    late = [s._replace(stamp=s.stamp + 30.0 * (s.stamp > turn[900].stamp)) for s in turn]
    samples, notes = read(write_csv(tmp_path / "one", buffered(late)))
    for of_imu in (True, False):
        np.testing.assert_array_equal(stamps(samples, of_imu), stamps(buffered(late), of_imu))
    assert notes == []


def test_interpolated_samples_are_not_counted(tmp_path):
    samples = [s for s in drive(90.0, rate=0.05) if not isinstance(s, ImuSample)]
    imus = [s for s in drive(90.0, rate=0.05) if isinstance(s, ImuSample)][::20]
    merged = sorted([*samples, *imus], key=lambda sample: sample.stamp)
    with open_recording(write_csv(tmp_path / "slow", merged)) as source:
        readings = RepairedReadings(source)
        given = list(readings)
    assert readings.read == [len(imus), len(samples)]
    assert len(given) > len(imus) + len(samples)
