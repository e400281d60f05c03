"""The scale error of the gyro that a turn found is corrected in the fused yaw."""

import math
from dataclasses import replace

import numpy as np
import pytest
from fusing import CALIBRATED, Fusing
from moving import Course
from realistic_robots import collected, driven, there_and_back
from simulated.turns import measure

from magcal_ros.core import Figure, calibrate
from magcal_ros.core.samples import ImuSample
from magcal_ros.core.simulation import DEGREE, Robot


@pytest.mark.parametrize("error", [-0.02, 0.02])
def test_a_turn_there_and_back_finds_the_scale_of_the_gyro(error, right_axes):
    robot = Robot(noise_field=0.3e-6, noise_force=0.05, noise_rate=2e-3)
    motion = driven(there_and_back, math.tau, (0.0, 0.0, 0.0), np.zeros((1, 3)))
    window = measure(robot, motion, np.random.default_rng(7), gyro=True)
    window = replace(window, angular_rate=(1.0 + error) * window.angular_rate)
    knowledge = replace(robot.knowledge(1.5e-6, 1.0 * DEGREE), exact_sensors=False)
    found = calibrate(collected(window), knowledge).estimate.figures[Figure.GYRO_SCALE]
    assert found == pytest.approx(error, abs=0.003)


def fused(error, known):
    """Drive circles to one side and turn to the other."""
    figures = {**CALIBRATED.evidence.figures, Figure.GYRO_SCALE.value: known}
    evidence = replace(CALIBRATED.evidence, figures=figures)
    fusing = Fusing(replace(CALIBRATED, evidence=evidence))

    def listen(sample, ride):
        if isinstance(sample, ImuSample):
            rate = (1.0 + error) * np.array(sample.rate)
            sample = sample._replace(rate=tuple(rate.tolist()))
        fusing(sample, ride)

    course = Course(listen, seed=3)
    course.go(5.0)
    course.circle(20.0, 0.5, 1.0)
    course.go(5.0, yaw_rate=-0.6)
    return fusing


def test_the_scale_that_a_turn_found_is_corrected():
    known, ignored = fused(0.02, 0.02), fused(0.02, 0.0)
    errors, wrong = (np.abs(each.errors_deg()[200:]).max() for each in (known, ignored))
    assert errors < 1.0
    assert wrong > 3.0 * errors
    assert np.abs(known.errors_deg() / known.sigmas_deg())[200:].max() < 2.0
