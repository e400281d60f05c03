"""Follows a simulated drive as the node does, with a calibrated compass."""

import numpy as np
from simulated import Vehicle, simulated_drive, travel

from magcal_ros.core.driving import TravelEstimator
from magcal_ros.core.geometry import yaw_from_up_and_field
from magcal_ros.core.samples import FieldSample, ImuSample
from magcal_ros.core.simulation import Robot
from magcal_ros.core.up import UpFollower

ROBOT = Robot(noise_force=0.05, noise_rate=2e-3, noise_field=0.3e-6)


def driven(legs, seed=1, vehicle=None, rate=25.0, heading=0.3, current=(0.0, 0.0), **options):
    """Return a simulated drive."""
    rng = np.random.default_rng(seed)
    truth = travel(legs, rng, rate=rate, heading=heading, current=current)
    return simulated_drive(truth, rng, vehicle or Vehicle(ROBOT), **options)


def follow(drive, estimator=None, watch=lambda estimator, stamp: None, added=0.0):
    """Pass all samples to a `TravelEstimator`; returns it. `added` rotates the compass, rad."""
    estimator = estimator or TravelEstimator()
    field = drive.correction_at(drive.time[0]).apply(drive.field)
    yaws = iter((yaw_from_up_and_field(drive.up, field) + added).tolist())
    for sample in drive.samples():
        kind = type(sample)
        if kind is ImuSample:
            estimator.add_imu(sample, (0.0, 0.0, 0.0))
            watch(estimator, sample.stamp)
        elif kind is FieldSample:
            estimator.add_yaw(next(yaws))
        else:
            estimator.add_travel(sample)
    return estimator


def tilts(drive, estimator=None):
    """Return the error of up with the vehicle's acceleration subtracted, degrees."""
    follower, found = UpFollower(), []
    for sample in drive.samples():
        kind = type(sample)
        if kind is ImuSample:
            own = None
            if estimator is not None:
                own = estimator.add_imu(sample, follower.gyro_bias.rate)
            follower.add(sample, own)
            found.append(follower.newest)
        elif kind is FieldSample:
            follower.add_field(sample.stamp, sample.field)
        elif estimator is not None:
            estimator.add_travel(sample)
    ups = np.array(found)
    ups /= np.linalg.norm(ups, axis=1)[:, None]
    return np.degrees(np.arccos(np.clip(np.sum(ups * drive.up, axis=1), -1.0, 1.0)))
