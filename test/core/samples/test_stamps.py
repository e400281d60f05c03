import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core import Reason, Refusal, Window
from magcal_ros.core.doctor import with_explanation
from magcal_ros.core.samples import (
    StampGuard,
    bursts_in_words,
    spread_bursts,
    spread_each,
)


def bursts(period=1.0, count=40, within=20):
    """Stamps of `within` samples in a row, every `period` seconds."""
    return (np.arange(count)[:, None] * period + np.arange(within) * 0.0025).ravel()


def window(time):
    n = len(time)
    return Window(time, np.full((n, 3), 20e-6), np.tile([0.0, 0.0, 9.81], (n, 1)))


@pytest.mark.parametrize("period", [0.5, 1.0])
def test_stamps_of_buffer_reads_are_reported(period):
    words = bursts_in_words(bursts(period))
    assert "bursts" in words
    assert f"{period - 19 * 0.0025:.2f} s" in words


def test_thinned_pauses_are_no_bursts():
    rng = np.random.default_rng(1)
    steps = np.where(rng.random(2000) < 0.1, rng.exponential(1.0, 2000) + 0.06, 0.01)
    time = np.cumsum(steps)
    assert bursts_in_words(time) == ""


@pytest.mark.parametrize("time", [np.zeros(0), np.arange(3.0), np.arange(500) * 0.02])
def test_even_or_few_stamps_are_no_bursts(time):
    assert bursts_in_words(time) == ""


def test_a_refusal_that_bursts_may_cause_names_them():
    refusal = Refusal(Reason.AXES_DISAGREE, "gyro and compass differ by 28 degrees")
    assert "bursts" in str(with_explanation(refusal, window(bursts())))
    assert str(with_explanation(refusal, window(np.arange(800) * 0.025))) == str(refusal)
    other = Refusal(Reason.TOO_FEW_SAMPLES, "no samples")
    assert str(with_explanation(other, window(bursts()))) == str(other)


class TestMended:
    """Stamps of a buffer become those of the measurements."""

    @given(
        rate=st.floats(10.0, 500.0),
        period=st.floats(0.3, 2.0),
        apart=st.floats(0.0, 0.1),
        phase=st.floats(0.0, 1.0),
    )
    def test_the_even_rate_is_found_for_any_buffer(self, rate, period, apart, phase):
        each = rate * period
        measured = 1.7e9 + np.arange(int(40 * each)) / rate
        read = 1.7e9 + (np.floor((measured - 1.7e9) / period + phase) + 1 - phase) * period
        nth = np.arange(len(read)) - np.searchsorted(read, read)
        even = spread_bursts(read + nth * apart / rate)
        if each < 3.0:
            assert even is None
        elif each > 10.0:
            assert np.abs(even - measured).max() < 0.15 * period + 3.0 / rate

    def test_the_newest_sample_of_a_buffer_is_slightly_older_than_its_stamp(self):
        time = bursts(within=40)
        late = time - spread_bursts(time)
        assert late.min() == pytest.approx(0.0, abs=1e-6)
        assert np.abs(np.diff(spread_bursts(time)) - 0.025).max() < 1e-3

    @pytest.mark.parametrize(
        "time",
        [
            np.zeros(0),
            np.arange(500) * 0.02,
            np.repeat(np.arange(500) * 0.02, 2),
            np.delete(bursts(), slice(200, 400)),
            np.concatenate([bursts(), bursts()]),
            np.concatenate([bursts(), 60.0 + bursts()]),
        ],
        ids=["none", "even", "twice", "samples missing", "set back", "a pause"],
    )
    def test_stamps_off_the_line_are_unchanged(self, time):
        assert spread_bursts(time) is None

    def test_bursts_with_missing_ones_are_spread_individually(self):
        nth = np.arange(800)
        measured, read = 0.025 * (nth + 1), nth // 40 + 1.0 + 1e-6 * (nth % 40 - 39)
        kept = np.isin(nth // 40, [3, 4, 5, 11, 16], invert=True)
        found = spread_each(read[kept])
        assert np.abs(found - measured[kept]).max() < 2e-3


class TestStampGuard:
    """A running robot's stamps, gap after gap."""

    def words(self, *stamps):
        guard = StampGuard()
        for time in stamps:
            for stamp in max(guard.newest, 0.0) + 1.0 + time:
                guard.check(float(stamp))
        return guard.bursts_in_words

    @pytest.mark.parametrize("period", [0.2, 0.9])
    @pytest.mark.parametrize("within", [5, 40, 150])
    def test_bursts_are_reported_with_their_interval(self, period, within):
        time = (np.arange(12)[:, None] * period + np.arange(within) * 0.0003).ravel()
        assert f"bursts, {period - (within - 1) * 0.0003:.2f} s apart" in self.words(time)

    def test_a_stream_may_begin_between_two_bursts(self):
        assert "bursts" in self.words(bursts()[19:])

    @given(st.lists(st.floats(0.5, 1.5), min_size=50, max_size=300))
    def test_jitter_is_no_burst(self, gaps):
        assert self.words(np.cumsum(np.array(gaps) * 0.2)) == ""

    def test_a_serial_port_with_sixteen_milliseconds_is_harmless(self):
        assert self.words(bursts(period=0.016, within=6, count=500)) == ""

    def test_a_few_pauses_are_no_bursts(self):
        steps = np.full(3000, 0.01)
        steps[::250] = 5.0
        assert self.words(np.cumsum(steps)[:2000]) == ""

    def test_a_corrected_driver_ends_the_complaint(self):
        time = bursts()
        assert "bursts" in self.words(time)
        assert self.words(time, np.arange(3000) * 0.01) == ""
