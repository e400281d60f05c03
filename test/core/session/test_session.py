import math
from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
from simulated.turns import measure, turn

from magcal_ros.core import Mounting, Reason, Refusal, Window
from magcal_ros.core.geometry import rotation_from_rpy
from magcal_ros.core.samples import FieldSample, ImuSample, Pair
from magcal_ros.core.session import Limits, Session, Stage
from magcal_ros.core.session.session_tuning import SESSION
from magcal_ros.core.simulation import DEGREE, Robot

ROBOT = Robot()
CERTAIN, UNCERTAIN = math.radians(0.2), math.radians(0.9)
LIMITS = Limits(timeout=90.0, silence=10.0)


def pairs_of(window, without=()):
    """The pairs of a window; `without` names rows whose gyro reads NaN."""
    rates = window.angular_rate
    for k in range(len(window)):
        rate = (math.nan,) * 3 if rates is None or k in without else tuple(rates[k].tolist())
        stamp = float(window.time[k]) + 100.0
        imu = ImuSample(stamp, tuple(window.specific_force[k].tolist()), rate)
        yield Pair(FieldSample(stamp, tuple(window.field[k].tolist())), imu)


def simulated(robot=ROBOT, gyro=True, seed=1, **motion):
    return measure(robot, turn(**motion), np.random.default_rng(seed), gyro=gyro)


def session_with(window, limits=LIMITS, mounting=None, without=()):
    session = Session(limits, mounting or Mounting(), now=0.0)
    for pair in pairs_of(window, without):
        session.add(pair, pair.field.stamp - 100.0)
    return session


class TestStages:
    @pytest.mark.parametrize("gyro", [False, True])
    @pytest.mark.parametrize("sense", [-1.0, 1.0])
    def test_a_full_turn_completes_the_session_and_a_shorter_one_does_not(self, gyro, sense):
        window = simulated(gyro=gyro, arc=sense * 400 * DEGREE, samples=800, duration=20.0)
        session, done_at = Session(LIMITS, Mounting(), now=0.0), None
        session.note_sigma(CERTAIN, 0.0)
        for k, pair in enumerate(pairs_of(window)):
            session.add(pair, 0.025 * k)
            if (
                done_at is None
                and k % 10 == 9
                and session.progress(0.025 * k).stage is (Stage.COMPLETE)
            ):
                done_at = k * 0.5
        assert done_at == pytest.approx(345.0, abs=18.0)

    @pytest.mark.parametrize("sigmas", [[], [UNCERTAIN], [UNCERTAIN, UNCERTAIN]])
    def test_a_full_turn_ends_with_the_first_certain_fit(self, sigmas):
        session = session_with(simulated())
        for sigma in sigmas:
            session.note_sigma(sigma, 0.0)
        assert session.progress(15.0).stage is Stage.COLLECTING
        session.note_sigma(CERTAIN, 0.0)
        assert session.progress(15.1).stage is Stage.COMPLETE

    def test_a_complete_turn_ends_when_the_robot_stands(self):
        standing = turn(arc=0.0, samples=200, duration=6.0)
        session = session_with(simulated(samples=300, duration=15.0))
        last = 14.95
        assert session.progress(last).stage is Stage.COLLECTING
        window = measure(ROBOT, standing, np.random.default_rng(2), gyro=True)
        stages = []
        for k, pair in enumerate(pairs_of(window)):
            shifted = Pair(
                pair.field._replace(stamp=pair.field.stamp + 15.0),
                pair.imu._replace(stamp=pair.imu.stamp + 15.0),
            )
            session.add(shifted, last + 0.03 * k)
            if k % 10 == 0:
                stages.append(session.progress(last + 0.03 * k).stage)
        assert stages[0] is Stage.COLLECTING
        assert stages[-1] is Stage.COMPLETE

    def test_an_uncertain_turn_ends_after_two_rounds(self):
        session = session_with(simulated(arc=710 * DEGREE, samples=900, duration=27.0))
        coverage = session.progress(26.9).coverage
        assert coverage.is_complete
        session.note_sigma(math.radians(2.0), coverage.turned)
        assert session.progress(27.0).stage is Stage.COLLECTING
        session = session_with(simulated(arc=730 * DEGREE, samples=900, duration=27.0))
        assert session.progress(27.0).stage is Stage.COMPLETE

    @pytest.mark.parametrize(
        ("sigma", "turned", "stage"),
        [
            (0.8, 420, Stage.COLLECTING),
            (0.8, 440, Stage.COMPLETE),
            (1.6, 440, Stage.COLLECTING),
            (math.inf, 440, Stage.COLLECTING),
        ],
    )
    def test_near_the_target_a_little_more_than_a_turn_is_enough(self, sigma, turned, stage):
        window = simulated(arc=turned * DEGREE, samples=2 * turned, duration=turned / 20.0)
        session = Session(LIMITS, Mounting(), now=0.0)
        for k, pair in enumerate(pairs_of(window)):
            session.add(pair, 0.025 * k)
            if k == 700:
                progress = session.progress(0.025 * k)
                assert progress.stage is Stage.COLLECTING
                session.note_sigma(math.radians(sigma), progress.coverage.turned)
        assert session.progress(turned / 20.0).stage is stage

    def test_three_quarters_of_a_turn_do_not_complete_the_session(self):
        progress = session_with(simulated(arc=270 * DEGREE)).progress(15.0)
        assert progress.stage is Stage.COLLECTING
        assert progress.coverage.arc == pytest.approx(270 * DEGREE, abs=0.1)

    def test_a_session_without_any_pair_is_silent(self):
        session = Session(LIMITS, Mounting(), now=50.0)
        assert session.progress(59.9).stage is Stage.COLLECTING
        assert session.progress(60.1).stage is Stage.SILENT
        assert not session.has_samples

    def test_a_session_whose_pairs_stop_is_silent(self):
        session = session_with(simulated(arc=2.0, duration=15.0))
        last = 15.0 * 499 / 500
        assert session.progress(last + 9.0).stage is Stage.COLLECTING
        assert session.progress(last + 11.0).stage is Stage.SILENT

    def test_a_session_times_out_while_pairs_arrive(self):
        session = session_with(simulated(arc=2.0, duration=90.5, samples=900))
        assert session.progress(89.9).stage is Stage.COLLECTING
        assert session.progress(90.5).stage is Stage.TIMED_OUT

    def test_a_complete_turn_stays_complete_after_the_timeout(self):
        assert session_with(simulated()).progress(1000.0).stage is Stage.COMPLETE

    def test_only_the_clock_that_is_passed_in_counts(self):
        """Stamps may lie years from the steady clock."""
        session = Session(LIMITS, Mounting(), now=5.0)
        for pair in pairs_of(simulated(arc=2.0)):
            session.add(pair, 6.0)
        progress = session.progress(7.0)
        assert progress.stage is Stage.COLLECTING
        assert progress.elapsed == 2.0


class TestProgress:
    def test_before_any_pair_the_progress_is_zero(self):
        words = Session(LIMITS, Mounting(), now=0.0).progress(1.0).in_words
        assert words == "0° of the turn measured, 0 samples; the robot has not turned yet"

    def test_the_progress_names_arc_samples_and_gap(self):
        words = session_with(simulated(arc=270 * DEGREE)).progress(15.0).in_words
        assert ", 500 samples; missing: " in words
        assert "to the right of the start" in words

    def test_the_progress_of_a_complete_turn_names_no_gap(self):
        assert "missing" not in session_with(simulated()).progress(15.0).in_words

    @pytest.mark.parametrize("gyro", [False, True])
    @pytest.mark.parametrize("arc", [300.0, -300.0])
    def test_the_turn_rate_is_that_of_the_last_seconds(self, gyro, arc):
        session = session_with(simulated(gyro=gyro, arc=arc * DEGREE, duration=15.0))
        expected = math.copysign(20.0, arc)
        assert math.degrees(session.progress(15.0).turn_rate) == pytest.approx(expected, abs=2.0)

    def test_a_robot_at_rest_has_not_turned(self):
        progress = session_with(simulated(arc=0.0)).progress(15.0)
        assert progress.coverage.arc == progress.turn_rate == 0.0

    def test_the_nominal_mounting_is_taken_into_account(self):
        """A board built in upside down turns the same way as the robot."""
        mounting = Mounting(np.ones(3), rotation_from_rpy(math.pi, 0.0, 0.5))
        window = simulated(Robot(mounting=mounting), gyro=False, arc=4.0)
        progress = session_with(window, mounting=mounting).progress(15.0)
        assert progress.coverage.turned == pytest.approx(4.0, abs=0.1)


class TestWindow:
    def test_the_window_contains_the_added_samples(self):
        window = simulated()
        found = session_with(window).window()
        rows = np.searchsorted(window.time + 100.0, found.time)
        assert len(found) > 0.9 * len(window)
        assert (found.time == window.time[rows] + 100.0).all()
        assert (found.field == window.field[rows]).all()
        assert (found.specific_force == window.specific_force[rows]).all()
        assert (found.angular_rate == window.angular_rate[rows]).all()

    def test_without_a_gyro_the_window_has_no_rate(self):
        assert session_with(simulated(gyro=False)).window().angular_rate is None

    def test_a_gyro_that_is_always_zero_counts_as_absent(self):
        window = simulated(Robot(noise_rate=0.0), arc=0.0)
        assert (window.angular_rate == 0.0).all()
        assert session_with(window).window().angular_rate is None

    def test_a_few_samples_without_rate_are_left_out(self):
        window = simulated()
        lost = set(range(50, 60))
        found = session_with(window, without=lost).window()
        assert np.isfinite(found.angular_rate).all()
        assert not np.isin(window.time[sorted(lost)] + 100.0, found.time).any()

    def test_a_gyro_that_is_mostly_absent_costs_no_samples(self):
        window = simulated()
        found = session_with(window, without=set(range(200))).window()
        assert found.angular_rate is None
        assert len(found) > 0.9 * len(window)

    def test_a_stamp_that_stands_still_is_left_out(self):
        pairs = list(pairs_of(simulated(arc=4.0)))
        session = Session(LIMITS, Mounting(), now=0.0)
        for pair in pairs:
            session.add(pair, 1.0)
            session.add(pair, 1.0)
        assert session.progress(2.0).samples == len(pairs)
        assert not session.restarted

    def test_the_turn_restarts_if_time_is_set_back(self):
        """After a jump of the clock, or a looping bag, the robot's heading is unknown."""
        pairs = list(pairs_of(simulated()))
        session = Session(LIMITS, Mounting(), now=0.0)
        for pair in pairs[len(pairs) // 2 :]:
            session.add(pair, 1.0)
        for pair in pairs:
            session.add(pair, 2.0)
        assert "set back" in session.restarted
        assert session.progress(2.0).samples == len(pairs)
        assert session.progress(2.0).coverage.is_complete
        assert (np.diff(session.window().time) > 0.0).all()

    def test_the_turn_restarts_if_time_is_set_ahead(self):
        """A clock that gets the date during the turn made a window of decades."""
        pairs = list(pairs_of(simulated()))
        session = Session(LIMITS, Mounting(), now=0.0)
        for pair in pairs[: len(pairs) // 2]:
            session.add(pair, 1.0)
        for pair in pairs:
            later = 1.7e9 + pair.field.stamp
            imu = pair.imu._replace(stamp=later)
            session.add(pair._replace(field=pair.field._replace(stamp=later), imu=imu), 2.0)
        assert "set ahead" in session.restarted
        assert session.progress(2.0).samples == len(pairs)
        assert np.ptp(session.window().time) < 3600.0

    def test_infinite_rates_count_as_missing(self):
        pairs = list(pairs_of(simulated()))
        session = Session(LIMITS, Mounting(), now=0.0)
        for k, pair in enumerate(pairs):
            rate = (math.inf, 0.0, -math.inf) if k % 20 == 7 else pair.imu.rate
            session.add(Pair(pair.field, pair.imu._replace(rate=rate)), 1.0)
        assert session.progress(2.0).coverage.arc > 330 * DEGREE
        assert np.isfinite(session.window().angular_rate).all()

    def test_a_pause_has_no_weight_in_the_window(self):
        moving = simulated(arc=3.0, samples=300, duration=10.0)
        standing = simulated(arc=0.0, samples=3000, duration=100.0, start_rpy=(0.0, 0.0, 3.0))
        session = session_with(moving)
        for pair in pairs_of(standing):
            later = pair.field.stamp + 20.0
            session.add(Pair(pair.field._replace(stamp=later), pair.imu), 50.0)
        assert session.progress(60.0).samples == 3300
        assert len(session.window()) < 700

    def test_an_empty_session_is_refused_with_words(self):
        with pytest.raises(Refusal, match="check both topics") as caught:
            Session(LIMITS, Mounting(), now=0.0).window()
        assert caught.value.reason is Reason.TOO_FEW_SAMPLES


class TestMemory:
    @pytest.mark.nightly
    @pytest.mark.parametrize("turns", first_of([0.7, 0.0, 40.0]))
    def test_the_buffer_of_a_hundred_thousand_pairs_is_bounded(self, turns):
        """A rest, a slow part of a turn, and many turns."""
        motion = {"arc": turns * math.tau, "samples": 100_000, "duration": 2000.0}
        window = simulated(gyro=False, **motion)
        session, most = Session(LIMITS, Mounting(), now=0.0), 0
        for k, pair in enumerate(pairs_of(window)):
            session.add(pair, 0.02 * k)
            most = max(most, len(session._buffer))
        assert most == SESSION.largest_buffer
        found = session.window()
        assert len(found) > SESSION.largest_buffer // 8
        assert found.time[-1] == window.time[-1] + 100.0
        assert found.time[0] < 105.0
        arc = session.progress(2000.0).coverage.arc
        assert arc == pytest.approx(min(turns, 1.0) * math.tau, abs=0.15)

    @pytest.fixture
    def small_buffer(self, monkeypatch):
        """A buffer of a twentieth of the real size."""
        smaller = replace(SESSION, largest_buffer=1024)
        monkeypatch.setattr("magcal_ros.core.session.session.SESSION", smaller)

    def test_a_long_rest_does_not_displace_the_turn(self, small_buffer):
        moving = simulated(arc=6.0, samples=400, duration=12.0)
        session = session_with(moving)
        standing = simulated(arc=0.0, samples=3_000, duration=600.0, start_rpy=(0.0, 0.0, 6.0))
        for pair in pairs_of(standing):
            later = pair.field.stamp + 20.0
            session.add(Pair(pair.field._replace(stamp=later), pair.imu), 50.0)
        assert session.progress(60.0).coverage.arc == pytest.approx(6.0, abs=0.1)
        assert session.window().time[0] == 100.0

    @pytest.mark.parametrize("gyro", first_of([True, False]))
    def test_a_slow_turn_is_kept_completely(self, small_buffer, gyro):
        """As an hour at 1 kHz in the real buffer: 180 times what it holds."""
        steady = Robot(gyro_bias=np.zeros(3), noise_rate=1e-6)
        window = simulated(steady, gyro=gyro, arc=math.tau, samples=60_000, duration=60.0)
        found = session_with(window).window()
        true_yaw = math.tau * (found.time - 100.0) / 60.0
        counts = np.bincount((true_yaw * 36 / math.tau).astype(int).clip(0, 35), minlength=36)
        assert counts.min() > 0.5 * counts.mean()


def test_a_robot_that_is_turned_over_keeps_its_sense_of_turn():
    """Its heading stands still while it rolls, and the rows of a pause would be thinned."""
    rolled = simulated(arc=math.tau, samples=1500, duration=15.0, axis=np.array([1.0, 0.0, 0.0]))
    turned = simulated(arc=math.tau, samples=300, duration=15.0)
    end = turned.time[-1] + 0.05
    both = Window(
        *(
            np.concatenate([getattr(turned, name), getattr(rolled, name) + (name == "time") * end])
            for name in ("time", "field", "specific_force", "angular_rate")
        )
    )
    assert len(session_with(both).window()) > 1490
