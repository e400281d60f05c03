"""Faults of single streams, and the samples that are left to compare the sensors."""

import math
from dataclasses import replace

import numpy as np
from imu_faults_cases import FAULTS, good_case

from magcal_ros.core.doctor import examine
from magcal_ros.core.samples import SensorLog


def seen_wrong(case, log):
    return [f for f in examine(log, case.knowledge, case.turned_left).findings if f.is_wrong]


def test_bursts_with_missing_ones_are_no_weak_field():
    """A line through all stamps would be seconds off, and the field 40% too weak."""
    rng = np.random.default_rng([5, 1])
    case = good_case(rng, "half minute")
    log = FAULTS["bursts of 1 s"][0](rng, case.log)
    start = log.imu_time[0]
    imu, field = (
        (time - start < 8.0) | (time - start > 12.0) for time in (log.imu_time, log.field_time)
    )
    log = SensorLog(
        log.imu_time[imu], log.force[imu], log.rate[imu], log.field_time[field], log.field[field]
    )
    assert {line.key for line in seen_wrong(case, log)} == {"bursts"}


def test_a_gyro_with_missing_samples_is_named():
    rng = np.random.default_rng([5, 1])
    case = good_case(rng, "half minute")
    rate = case.log.rate.copy()
    rate[rng.random(len(rate)) < 0.3, 1] = math.nan
    (line,) = seen_wrong(case, replace(case.log, rate=rate))
    assert line.name == "IMU: numbers"
    assert line.evidence.endswith("% not finite")
