"""The replay of a recorded drive counts all of it, also what is no longer in memory."""

import numpy as np
import pytest
from simulated.drive import Vehicle, simulated_drive
from simulated.legs import Leg
from simulated.travel import travel

from magcal_ros.core import Knowledge
from magcal_ros.core.samples import DriveRecorder
from magcal_ros.core.self_calibration import Mode, SelfCalibration, replay_drive
from magcal_ros.core.simulation import Robot

STANDS, GOES = 30.0, 50.0


def test_discarded_movement_counts_as_well():
    rng = np.random.default_rng(5)
    ride = [Leg(STANDS), Leg(GOES, turn_rate=0.2), Leg(STANDS), Leg(GOES, turn_rate=-0.2)]
    drive = simulated_drive(
        travel(ride, rng, rate=20.0), rng, Vehicle(Robot(noise_rate=2e-3)), streets=None
    )
    readings = (each for each in drive.samples() if hasattr(each, "field") or hasattr(each, "rate"))
    machine = SelfCalibration(Mode.APPLY)
    machine.recorder = DriveRecorder(20.0)
    replay = replay_drive(Knowledge(), None, readings, (), machine)
    assert machine.recorder.seconds < 25.0
    assert replay.seconds == pytest.approx(2.0 * (STANDS + GOES), abs=1.0)
    # Of each rest a few seconds at both ends are kept.
    assert 2.0 * GOES - 5.0 < replay.moved < 2.0 * GOES + 30.0


def test_samples_during_a_gap_of_the_imu_are_not_counted():
    """The last rate was held during the gap, and a fit without samples divided by zero."""
    rng = np.random.default_rng(5)
    drive = simulated_drive(
        travel([Leg(STANDS), Leg(90.0, turn_rate=0.2)], rng, rate=20.0),
        rng,
        Vehicle(Robot(noise_rate=2e-3)),
        streets=None,
    )
    silent = (1060.0, 1061.5)
    readings = (
        each
        for each in drive.samples()
        if hasattr(each, "field") or (hasattr(each, "rate") and not _within(each.stamp, silent))
    )
    machine = SelfCalibration(Mode.APPLY)
    replay_drive(Knowledge(), None, readings, (), machine)
    log = machine.recorder.log()
    steps = log.steps
    assert np.isfinite(steps.angle).all()
    assert (steps.intervals > 0.0).all()
    assert np.diff(log.time).max() > 1.4


def _within(stamp, span):
    return span[0] < stamp < span[1]
