"""What the filter of the fused yaw estimates in addition to the yaw."""

import math

import numpy as np
import pytest
from long_form import first_of

from magcal_ros.core.heading import BY_COMPASS, BY_REST, PERFECT, GyroDrift, YawFilter


@pytest.mark.parametrize(
    ("walk", "turn"),
    [(1e-4, 0.0), (1e-5, 1e-3), pytest.param(1e-5, 0.0, marks=pytest.mark.nightly)],
)
def test_rests_show_the_random_walk_of_the_bias_and_whether_the_robot_stands(walk, turn):
    rng, loss, bias, noise = np.random.default_rng(2), GyroDrift(), 0.003, 1.5e-4
    loss.begin(bias, 1e-6)
    for k in range(100):
        bias += walk * math.sqrt(30.0) * rng.standard_normal()
        shown = bias + math.hypot(noise, turn) * rng.standard_normal()
        loss.walk_variance = 3e-5
        # A rest, which is used when it ends.
        loss.add_rest(30.0 * k, (shown, noise**2))
        assert loss.add_rest(30.0 * k, None) == pytest.approx((shown, noise**2))
    if not turn:
        assert walk / 2.0 < math.sqrt(loss.walked) < 2.0 * walk
    assert math.sqrt(loss.rest_turn) == pytest.approx(turn, rel=0.5, abs=1e-4)


@pytest.mark.nightly
@pytest.mark.parametrize("lasts", first_of([20.0, 0.0]))
def test_headings_show_the_correlation_time_of_their_errors(lasts):
    rng, loss, sigma, wrong = np.random.default_rng(4), GyroDrift(), math.radians(1.0), 0.0
    loss.begin(0.0, 1e-6)
    kept = math.exp(-2.0 / lasts) if lasts else 0.0
    assert loss.add_heading(-2.0, 0.0, sigma**2, math.inf)
    # Of ten headings with errors of their own the mean is taken.
    new = sigma * math.sqrt(1.0 - kept**2 if lasts else 0.1)
    for k in range(150):
        wrong = kept * wrong + new * rng.standard_normal()
        loss.walk_variance = 2e-6
        used = [loss.add_heading(2.0 * k - 0.2 * j, wrong, sigma**2, 0.2) for j in range(9, -1, -1)]
        assert used == [False] * 9 + [True]
    if lasts:
        assert 8.0 < loss.heading_error_time < 50.0
    else:
        assert loss.heading_error_time < 0.3


def test_remaining_hard_iron_is_averaged_over_the_headings():
    sigma, iron, following = math.radians(3.0), np.array([1.2, -0.8]), YawFilter()

    def compass(heading):
        errors = PERFECT.copy()
        errors[:2] = sigma * math.cos(heading), sigma * math.sin(heading)
        return errors

    off = float(compass(0.0)[:2] @ iron)
    following.begin(1e-6, 1e-10, 1e-6, compass(0.0))
    for k in range(720):
        following.propagate(0.5, 1e-8, 1e-14)
        following.change_disturbance(0.9, 1e-6)
        seen = compass(k * math.tau / 72.0)
        innovation = float(seen[:2] @ iron - seen @ following.errors) - off
        off += following.observe(BY_COMPASS, innovation, 1e-5, seen)
    assert following.errors[:2] == pytest.approx(iron, abs=0.2)
    assert abs(off) < 0.1 * sigma
    assert abs(off) < 3.0 * math.sqrt(following.yaw_variance + following.own_error_variance)


def test_a_rest_shows_the_bias_and_corrects_the_yaw():
    following = YawFilter()
    following.begin(1e-8, 1e-6, 0.0)
    for _ in range(600):
        following.propagate(0.1, 0.0, 0.0)
    # The bias of 0.5 mrad/s that was not known has turned the yaw by 30 mrad to the left.
    turned = following.observe(BY_REST, 5e-4, 1e-10)
    assert following.bias == pytest.approx(5e-4, rel=1e-3)
    assert turned == pytest.approx(-0.03, rel=1e-3)
    assert math.sqrt(following.yaw_variance) < 1e-3


def test_the_disagreement_of_compasses_stays_in_the_yaw_variance():
    sigma, following, compass = math.radians(10.0), YawFilter(), PERFECT.copy()
    following.begin(1e-6, 1e-10, 1e-6)
    compass[-2] = sigma
    for _ in range(200):
        following.propagate(0.5, 1e-6, 1e-14)
        following.change_disturbance(0.9, 1e-6)
        following.observe(BY_COMPASS, math.radians(5.0), 1e-6, compass)
    assert following.errors[-2] == 0.0
    assert math.sqrt(following.own_error_variance) == pytest.approx(sigma, rel=0.05)
