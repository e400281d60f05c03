import numpy as np
import pytest

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.samples.stamps import bursts_of_a_turn, long_gaps
from magcal_ros.core.samples.units import explained
from magcal_ros.core.samples.window import Window


def bursts(period=1.0, count=40, within=20):
    """Stamps of `within` samples in a row, every `period` seconds."""
    return (np.arange(count)[:, None] * period + np.arange(within) * 0.0025).ravel()


def window(time):
    n = len(time)
    return Window(time, np.full((n, 3), 20e-6), np.tile([0.0, 0.0, 9.81], (n, 1)))


@pytest.mark.parametrize("period", [0.5, 1.0])
def test_a_turn_that_is_stamped_when_a_buffer_is_read_says_so(period):
    words = bursts_of_a_turn(bursts(period))
    assert "bursts" in words
    assert f"{period - 19 * 0.0025:.2f} s" in words


def test_pauses_that_were_thinned_out_are_no_bursts():
    rng = np.random.default_rng(1)
    steps = np.where(rng.random(2000) < 0.1, rng.exponential(1.0, 2000) + 0.06, 0.01)
    time = np.cumsum(steps)
    assert len(long_gaps(time)) > 100
    assert bursts_of_a_turn(time) == ""


@pytest.mark.parametrize("time", [np.zeros(0), np.arange(3.0), np.arange(500) * 0.02])
def test_even_stamps_and_few_are_no_bursts(time):
    assert bursts_of_a_turn(time) == ""


def test_a_refusal_that_bursts_can_be_the_cause_of_names_them():
    refusal = Refusal(Reason.AXES_DISAGREE, "gyro and compass differ by 28 degrees")
    assert "bursts" in str(explained(refusal, window(bursts())))
    assert str(explained(refusal, window(np.arange(800) * 0.025))) == str(refusal)
    other = Refusal(Reason.TOO_FEW_SAMPLES, "no samples")
    assert str(explained(other, window(bursts()))) == str(other)
