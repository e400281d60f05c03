"""Choice of the speed source, and the samples that are kept."""

import math

import numpy as np
import pytest

from magcal_ros.core.driving import Speedometer, SpeedSource, SpeedTrack, TravelEstimator
from magcal_ros.core.samples import PositionSample, SpeedSample, VelocitySample


def track_of(rate, seconds=60.0, speed=lambda stamp: 3.0 + math.sin(0.5 * stamp)):
    track = SpeedTrack(SpeedSource.ODOMETRY)
    for step in range(1, round(rate * seconds)):
        track.add(step / rate, speed(step / rate))
    return track


@pytest.mark.parametrize("rate", [10.0, 20.0, 50.0, 200.0])
def test_a_fast_source_is_thinned_without_changing_the_speed(rate):
    track = track_of(rate)
    for stamp in (40.03, 51.7, 59.71):
        assert track.at(stamp) == pytest.approx(3.0 + math.sin(0.5 * stamp), abs=1e-3)
        assert track.along(np.array([stamp]), 0.0) == pytest.approx([track.at(stamp)])


def test_skipped_samples_are_known_by_their_stamps():
    track = track_of(10.0)
    newest = track.newest
    assert not track.wants(newest + 0.02)
    assert track.wants(newest + 0.05)
    # One that comes late, or again, is for the guard of stamps to judge.
    assert track.wants(newest)
    assert track.wants(newest - 1.0)
    assert track.wants(math.nan)


def test_there_is_no_speed_between_samples_too_far_apart():
    track = SpeedTrack(SpeedSource.ODOMETRY)
    for stamp in (1.0, 1.1, 3.0):
        track.add(stamp, 2.0)
    assert track.at(1.05) == track.at(3.0) == 2.0
    # From the sample before the gap on, the speed is not known.
    assert math.isnan(track.at(1.1))
    assert math.isnan(track.at(2.0))
    assert math.isnan(track.at(3.5))


@pytest.mark.parametrize("rate", [10.0, 50.0])
def test_impossible_jumps_are_counted(rate):
    jumping = track_of(rate, speed=lambda stamp: 8.0 * (int(stamp * 4.0) % 2))
    assert jumping.outlier_share > 0.1
    assert track_of(rate).outlier_share == 0.0


def test_wheels_come_before_the_receiver_until_they_are_silent_or_distrusted():
    meter = Speedometer()
    assert meter.track is None
    meter.add(PositionSample(1.0, 0.0, 0.0))
    meter.add(PositionSample(2.0, 3.0, 4.0))
    assert (meter.track.source, meter.track.last) == (SpeedSource.FIXES, 5.0)
    meter.add(VelocitySample(2.0, 3.0, -4.0, 0.1))
    assert (meter.track.source, meter.track.last) == (SpeedSource.VELOCITY, 5.0)
    meter.add(SpeedSample(2.0, -5.0))
    assert (meter.track.source, meter.track.last) == (SpeedSource.ODOMETRY, -5.0)
    meter.distrusted.add(SpeedSource.ODOMETRY)
    assert meter.track.source is SpeedSource.VELOCITY
    meter.distrusted.clear()
    meter.add(VelocitySample(6.0, 3.0, -4.0, 0.1))
    assert meter.track.source is SpeedSource.VELOCITY


def test_time_that_is_set_back_discards_later_samples():
    track = track_of(10.0)
    for step in range(200):
        track.add(5.0 + 0.1 * step, 1.0)
    assert track.last == 1.0
    assert math.isnan(track.at(40.0))


def test_a_single_outlier_is_ignored_and_a_lasting_speed_is_not():
    track = track_of(10.0, 10.0, lambda stamp: 3.0)
    track.add(10.0, 45.0)
    track.add(10.1, 3.0)
    assert track.at(10.05) == 3.0
    track.add(10.2, 20.0)
    assert track.last == 3.0
    track.add(10.3, 20.0)
    assert track.last == 20.0
    # No vehicle can have driven between the two.
    assert math.isnan(track.at(10.2))


def test_wheels_at_one_hertz_are_interpolated():
    track = track_of(1.0, 20.0, lambda stamp: 0.5 * stamp)
    assert not track.is_quick
    assert track.at(12.3) == pytest.approx(6.15)
    assert track_of(10.0).is_quick


def test_the_speed_of_a_silent_source_is_unknown():
    """A robot that comes to rest after its wheels fell silent would never rest again."""
    estimator = TravelEstimator()
    assert math.isnan(estimator.speed_near(1.0))
    for k in range(100):
        estimator.add_travel(SpeedSample(0.1 * k, 4.0))
    assert estimator.speed_near(10.0) == 4.0
    assert estimator.speed_near(11.0) == 4.0
    assert math.isnan(estimator.speed_near(20.0))
