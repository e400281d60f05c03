import dataclasses
import math

import numpy as np
import pytest
from drives import ROBOT, drive, write_csv
from long_form import first_of
from simulated import Vehicle, simulated_drive, travel
from simulated.drive import Streets
from simulated.legs import Leg
from simulated.turns import measure, turn

from magcal_ros.core import Figure, Knowledge, Mounting, Reason, Refusal
from magcal_ros.core.geometry import rotation_from_rpy
from magcal_ros.core.knowledge import knowledge_of
from magcal_ros.core.samples import FieldSample, ImuSample
from magcal_ros.core.session import LITTLE_DATA, Limits, SampleCollector, fit_collected
from magcal_ros.core.session.session_tuning import SESSION
from magcal_ros.core.simulation import Ride, Robot, heading_errors
from magcal_ros.files import open_recording

pytestmark = pytest.mark.usefixtures("right_axes")

KNOWLEDGE = ROBOT.knowledge(1.5e-6, math.radians(1.0))


def gathered(samples, mounting=ROBOT.mounting):
    collector = SampleCollector(mounting, "/imu", "/mag")
    collector.take(samples)
    return collector


def fitted(samples, knowledge=KNOWLEDGE):
    return fit_collected(gathered(samples), knowledge)


def test_the_speed_of_wheels_distinguishes_a_drive_from_a_small_circle():
    rng = np.random.default_rng(1)
    legs = [Leg(4.0)]
    for _ in range(5):
        bend = rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 0.6)
        legs += [Leg(rng.uniform(4.0, 10.0), speed=2.0), Leg(4.0, speed=2.0, turn_rate=bend)]
    way, robot = travel(legs, rng, rate=25.0), Robot(noise_force=0.05, noise_rate=2e-3)
    drive = simulated_drive(way, rng, Vehicle(robot), streets=Streets(size=1e-6), receiver=None)
    known = knowledge_of(robot.strength * 1e6, inclination_deg=math.degrees(robot.inclination))
    collector = SampleCollector(Mounting())
    collector.take(drive._sensors(), drive.speeds)
    figures = fit_collected(collector, known).estimate.figures
    assert figures[Figure.METRES] == pytest.approx(way.metres[-1], rel=0.1)
    assert figures[Figure.LOCAL_FIELD] > 0.3e-6


def test_the_heading_is_correct_after_the_calibration():
    errors = heading_errors(fitted(drive(400.0)).calibration.correction, ROBOT)
    assert np.degrees(np.sqrt(np.mean(errors**2))) < 0.7


def test_all_turns_of_the_recording_are_used():
    window = gathered(drive(1000.0)).window()
    assert window.time[-1] - window.time[0] > 0.98 * math.radians(1000.0) / 0.5


def test_straight_parts_of_a_drive_are_used_completely():
    """With gaps of seconds there, long drives were refused, or told to turn the sensor over."""
    stamps = 100.0 + 0.02 * np.arange(15_000)
    rates = 0.6 * (np.sin(math.tau * stamps / 60.0) > 0.9)
    yaws = 0.02 * np.cumsum(rates)
    field = 2e-5 * np.column_stack([np.cos(yaws), -np.sin(yaws), np.full(len(yaws), -2.0)])
    field += 1e-7 * np.random.default_rng(1).standard_normal(field.shape)
    collector = SampleCollector(ROBOT.mounting)
    for stamp, rate, raw in zip(stamps.tolist(), rates.tolist(), field.tolist(), strict=True):
        imu = ImuSample(stamp, (0.0, 0.0, 9.81 + 1e4 * raw[0]), (0.0, 0.0, rate + 10.0 * raw[1]))
        collector.take([imu, FieldSample(stamp, tuple(raw))])
    assert np.diff(collector.window().time).max() < 0.1


def test_a_gyro_without_noise_causes_no_division_by_zero():
    collector = SampleCollector(ROBOT.mounting)
    for k in range(1500):
        yaw = 0.01 * min(max(k - 400, 0), 650)
        imu = ImuSample(100.0 + 0.02 * k, (0.0, 0.0, 9.81), (0.0, 0.0, 0.5 * (400 < k < 1050)))
        field = (2e-5 * math.cos(yaw), -2e-5 * math.sin(yaw), -4e-5 + 1e-8 * (k % 2))
        collector.take([imu, FieldSample(imu.stamp, field)])
    assert collector.window().rests


@pytest.mark.nightly
def test_the_memory_for_hours_of_samples_is_bounded(monkeypatch):
    monkeypatch.setattr("magcal_ros.core.session.recorded.LONGER", 1)
    motion = turn(arc=60 * math.tau, samples=30_000, duration=600.0)
    window = measure(ROBOT, motion, np.random.default_rng(1), gyro=True)
    collector = SampleCollector(ROBOT.mounting)
    stamps = (window.time + 100.0).tolist()
    for stamp, b, f, w in zip(
        stamps, window.field, window.specific_force, window.angular_rate, strict=True
    ):
        collector.take([ImuSample(stamp, tuple(f), tuple(w)), FieldSample(stamp, tuple(b))])
    kept = collector.window()
    assert SESSION.largest_buffer // 8 < len(kept) <= SESSION.largest_buffer
    assert kept.time[-1] == stamps[-1]
    assert collector.received == [30_000, 30_000]


def test_field_may_be_recorded_before_or_after_its_imu_samples():
    """A recorder's order is not the stamps' order: the field comes 0.3 s late or early."""
    samples = drive(400.0)
    expected = gathered(samples).window()
    for late in (0.3, -0.3):
        moved = sorted(samples, key=lambda s: s.stamp + late * isinstance(s, FieldSample))
        found = gathered(moved).window()
        np.testing.assert_array_equal(found.field, expected.field)
        np.testing.assert_array_equal(found.specific_force, expected.specific_force)


class TestRefusals:
    def test_an_empty_recording(self):
        outcome = fitted([])
        assert outcome.reason is Reason.TOO_FEW_SAMPLES
        assert not outcome.verdict.accepted

    @pytest.mark.parametrize("kind", [ImuSample, FieldSample])
    def test_a_recording_of_one_sensor(self, kind):
        outcome = fitted([s for s in drive(400.0) if isinstance(s, kind)])
        assert outcome.reason is Reason.TOO_FEW_SAMPLES

    def test_a_robot_at_rest(self):
        assert fitted(drive(0.0)).reason is Reason.NO_MOTION

    def test_a_short_arc_is_refused_with_the_measured_arc(self):
        outcome = fitted(drive(30.0))
        assert outcome.reason is Reason.ARC_TOO_SHORT
        assert "of the turn measured" in outcome.verdict.summary

    def test_a_wrong_unit_is_named(self):
        samples = [
            s._replace(field=tuple(1e6 * x for x in s.field)) if isinstance(s, FieldSample) else s
            for s in drive(400.0)
        ]
        with pytest.raises(Refusal, match="looks like microtesla published as tesla"):
            gathered(samples).window()

    @pytest.mark.nightly
    def test_the_remedy_for_wrong_axes_does_not_ask_for_a_given_place(self):
        def stated(knowledge):
            swapped = (
                s._replace(rate=s.rate[::-1]) if isinstance(s, ImuSample) else s
                for s in drive(400.0)
            )
            return fit_collected(gathered(swapped), knowledge).verdict.summary

        asked = "give the position or the field's inclination"
        assert asked in stated(Knowledge())
        assert asked not in stated(knowledge_of(48.0, inclination_deg=65.0))

    def test_every_reason_of_little_data_can_be_avoided_by_more_data(self):
        assert all(fitted(drive(arc)).reason in LITTLE_DATA for arc in (0.0, 10.0, 30.0))


def test_bad_samples_are_dropped_and_reported():
    samples = drive(400.0)
    nan = (math.nan,) * 3
    spoiled = [
        s._replace(field=nan) if isinstance(s, FieldSample) and k % 2 else s
        for k, s in enumerate(samples)
    ]
    collector = gathered([None, *spoiled])
    assert np.isfinite(collector.window().field).all()
    words = "; ".join(collector.complaints())
    assert "/mag: " in words
    assert "samples are not finite" in words
    assert collector.streams.imu_drops["absent"] == 1


@pytest.mark.nightly
def test_a_mounting_upside_down_is_taken_into_account():
    mounting = Mounting(pose=rotation_from_rpy(math.pi, 0.0, math.radians(30.0)))
    knowledge = dataclasses.replace(knowledge_of(50.0, 1.5, 60.0, 1.0), mounting=mounting)
    robot = Robot(mounting=knowledge.mounting)
    collector = gathered(drive(400.0, robot), knowledge.mounting)
    outcome = fit_collected(collector, knowledge)
    errors = heading_errors(outcome.calibration.correction, robot)
    assert np.degrees(np.sqrt(np.mean(errors**2))) < 1.0


class TestRecordings:
    def read(self, folder, **span):
        with open_recording(folder, **span) as source:
            return gathered(source.readings())

    @pytest.mark.nightly
    def test_bag_and_csv_of_the_car_give_the_same(self, recording):
        folder, knowledge = recording("car_circles_neu2025_kiran"), knowledge_of(51.3, 1.5, 66.3)
        one, other = (
            fit_collected(self.read(path), knowledge) for path in (folder, folder / "bag_mcap")
        )
        assert one.verdict.accepted
        assert one.verdict.summary == other.verdict.summary
        difference = one.calibration.correction.parameters - other.calibration.correction.parameters
        assert np.abs(difference[:9]).max() < 1e-4
        assert np.abs(difference[9:]).max() < 1e-8

    @pytest.mark.nightly
    def test_a_span_of_the_hand_held_recording_is_one_turn(self, recording):
        collector = self.read(recording("broad05"), start=48.0, stop=62.0)
        assert collector.received == pytest.approx([1333, 1333], abs=2)
        assert collector.progress().coverage.is_complete
        outcome = fit_collected(collector, Knowledge())
        assert len(outcome.verdict.summary) > 40
        assert np.ptp(outcome.window.time) < 14.1

    @pytest.mark.nightly
    def test_a_boat_that_rolls_is_refused(self, recording):
        outcome = fit_collected(self.read(recording("sailboat_lsm303_roll")), Knowledge())
        assert not outcome.verdict.accepted


def test_limits_of_the_session_do_not_end_it(tmp_path):
    """Longer than the node's timeout, with a pause longer than its silence."""
    first, second = drive(200.0), drive(250.0, start=1000.0 + 2 * Limits().timeout, seed=2)
    with open_recording(write_csv(tmp_path / "csv", [*first, *second])) as source:
        window = gathered(source.readings()).window()
    assert window.time[-1] - window.time[0] > 2 * Limits().timeout


@pytest.mark.parametrize("jump", first_of([1.7e9, -100.0, 1e5]))
@pytest.mark.parametrize("turn_first", [True, False])
def test_the_better_part_of_a_recording_with_a_jump_of_time_is_used(turn_first, jump):
    first, second = 1000.0, 1000.0 + jump
    turned, little = drive(400.0, start=first), drive(90.0, start=second, seed=2)
    if not turn_first:
        turned, little = drive(400.0, start=second), drive(90.0, start=first, seed=2)
    collector = gathered([*turned, *little] if turn_first else [*little, *turned])
    assert collector.progress().coverage.is_complete
    assert "only the part with the largest arc is used" in collector.complaints()[0]
    outcome = fit_collected(collector, KNOWLEDGE)
    assert outcome.verdict.accepted, outcome.verdict.summary


@pytest.mark.parametrize("gyro", first_of([True, False]))
@pytest.mark.parametrize(
    ("imu_rate", "steps"),
    [
        (100, 10),
        (4, 1),
        *(pytest.param(*row, marks=pytest.mark.nightly) for row in ((10, 10), (20, 20))),
    ],
)
def test_a_field_at_a_tenth_of_the_imu_rate_suffices(imu_rate, steps, gyro):
    """A field sample a second is half a radian of turn: the robot turns twice, or more slowly."""
    ride = Ride(
        ROBOT,
        np.random.default_rng(3),
        start=1000.0,
        imu_rate=float(imu_rate),
        steps_per_field=steps,
        gyro=gyro,
    )
    turns = 2.2 if imu_rate / steps < 2 else 1.1
    count = int(turns * math.tau / 0.5 * imu_rate)
    outcome = fitted([sample for _ in range(count) for sample in ride.step(0.5)])
    assert outcome.verdict.accepted, outcome.verdict.summary


def test_a_field_at_ten_times_the_imu_rate_suffices():
    ride = Ride(ROBOT, np.random.default_rng(3), start=1000.0, imu_rate=50.0, steps_per_field=1)
    samples = [sample for _ in range(700) for sample in ride.step(0.5)]
    imus = [sample for sample in samples if isinstance(sample, ImuSample)][::10]
    fields = [sample for sample in samples if isinstance(sample, FieldSample)]
    both = sorted([*imus, *fields], key=lambda sample: sample.stamp)
    outcome = fitted(both)
    assert outcome.verdict.accepted, outcome.verdict.summary
