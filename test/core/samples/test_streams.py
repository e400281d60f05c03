import itertools
import math

import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core.geometry import exp_rotation, exp_rotations
from magcal_ros.core.samples import (
    STREAMS,
    DropReason,
    FieldSample,
    ImuSample,
    Pairer,
    StampGuard,
    Streams,
)

UP = (0.0, 0.0, 9.81)
STILL = (0.0, 0.0, 0.0)
FIELD = (20e-6, 5e-6, -40e-6)
MAX_GAP = 0.2


def imu(stamp, force=UP, rate=STILL):
    return ImuSample(stamp, force, rate)


def mag(stamp, field=FIELD):
    return FieldSample(stamp, field)


def numbered(stamp):
    """A field sample whose values no other stamp has."""
    return FieldSample(stamp, (20e-6 + 1e-9 * stamp, 5e-6, -40e-6))


def line(stamp):
    """An IMU whose every number is a straight line over time."""
    force = (1.0 + 0.5 * stamp, 2.0 - 0.25 * stamp, 9.0 + 0.125 * stamp)
    return ImuSample(stamp, force, (0.5 * stamp, -stamp, 1.0 + stamp))


class Walk:
    """Streams and pairer as the node puts them together."""

    def __init__(self, max_gap=MAX_GAP):
        self.streams = Streams(max_gap)
        self.pairer = Pairer(self.streams)
        self.pairs = []

    def feed(self, sample):
        if isinstance(sample, ImuSample):
            self.streams.add_imu(sample)
        elif self.streams.add_field(sample) and not self.streams.is_repeated:
            self.pairer.offer(sample)
        self.pairs += self.pairer.take()

    def feed_all(self, samples):
        for sample in samples:
            self.feed(sample)
        return self.pairs


def drive(start, seconds, imu_rate=100.0, field_rate=50.0, phase=0.003):
    imus = [line(start + k / imu_rate) for k in range(int(seconds * imu_rate))]
    fields = [numbered(start + phase + k / field_rate) for k in range(int(seconds * field_rate))]
    return imus, fields


def by_stamp(imus, fields):
    return sorted([*imus, *fields], key=lambda sample: sample.stamp)


class TestStampGuard:
    def test_increasing_stamps_are_accepted(self):
        guard = StampGuard()
        assert [guard.check(stamp) for stamp in (0.1, 0.2, 5.0)] == [None, None, None]
        assert guard.newest == 5.0

    @pytest.mark.parametrize("stamp", [0.0, -1.0, math.nan, math.inf, -math.inf])
    def test_a_stamp_that_is_not_finite_is_refused(self, stamp):
        guard = StampGuard()
        assert guard.check(stamp) is DropReason.ZERO_STAMP
        assert guard.check(1e-3) is None

    def test_a_stamp_before_the_newest_is_refused(self):
        guard = StampGuard()
        guard.check(2.0)
        assert guard.check(1.0) is DropReason.BACKWARD_STAMP
        assert guard.newest == 2.0

    def test_a_repeated_stamp_is_never_accepted(self):
        guard = StampGuard()
        guard.check(2.0)
        frozen = [guard.check(2.0) for _ in range(5 * STREAMS.restart_after)]
        assert set(frozen) == {DropReason.REPEATED}

    def test_time_that_stays_set_back_is_followed(self):
        guard = StampGuard()
        guard.check(100.0)
        answers = [guard.check(1.0 + 0.01 * k) for k in range(STREAMS.restart_after + 5)]
        assert answers[:9] == [DropReason.BACKWARD_STAMP] * (STREAMS.restart_after - 1)
        assert answers[9:] == [None] * 6

    def test_single_old_stamps_do_not_set_time_back(self):
        guard = StampGuard()
        for k in range(100):
            assert guard.check(10.0 + k) is None
            assert guard.check(9.5 + k) is DropReason.BACKWARD_STAMP
        assert guard.newest == 109.0

    @given(st.lists(st.floats(0.001, 1e4), min_size=1, max_size=60))
    def test_accepted_stamps_increase_unless_time_was_set_back(self, stamps):
        guard, newest, refused = StampGuard(), -math.inf, 0
        for stamp in stamps:
            passed = guard.check(stamp) is None
            assert passed == (stamp > newest or (stamp < newest and refused == 9))
            refused = 0 if passed else refused + (stamp < newest)
            newest = stamp if passed else newest
            assert guard.newest == newest


class TestImuDrops:
    @pytest.mark.parametrize(
        ("sample", "reason"),
        [
            (imu(1.0, (math.nan, 0.0, 9.8)), DropReason.NOT_FINITE),
            (imu(1.0, (0.0, math.inf, 9.8)), DropReason.NOT_FINITE),
            (imu(1.0, (0.0, 1e200, 9.8)), DropReason.NOT_FINITE),
            (imu(1.0, (0.0, 0.0, 0.0)), DropReason.ZERO),
            (imu(1.0, (0.0, 5e-324, 1e-160)), DropReason.ZERO),
            (imu(1.0, (0.0, 1e6, 9.8)), DropReason.TOO_LARGE),
            (imu(1.0, (0.0, 0.0, 9.8), (1e200, 0.0, 0.0)), DropReason.TOO_LARGE),
            (imu(1.0, (0.0, 0.0, 9.8), (0.0, -math.inf, 0.0)), DropReason.TOO_LARGE),
            (imu(0.0), DropReason.ZERO_STAMP),
            (imu(0.5), DropReason.BACKWARD_STAMP),
            (imu(0.6), DropReason.REPEATED),
        ],
    )
    def test_an_unusable_sample_is_counted_by_its_reason_and_not_used(self, sample, reason):
        streams = Streams(MAX_GAP)
        assert streams.add_imu(imu(0.6))
        assert not streams.add_imu(sample)
        assert streams.imu_drops == {reason: 1}
        assert streams.newest_imu == imu(0.6)

    def test_a_sample_without_gyro_is_used(self):
        streams = Streams(MAX_GAP)
        assert streams.add_imu(imu(1.0, rate=(math.nan,) * 3))
        assert not streams.imu_drops

    def test_a_gyro_that_is_sometimes_missing_is_not_absent(self):
        """A third of the rates are not numbers: the path is integrated over the others."""
        empty = np.random.default_rng(1).random(500) < 0.3
        walk, whole = Walk(), Walk()
        imus, fields = drive(1.0, 5.0)
        spoiled = [
            each._replace(rate=(0.1, math.nan, 0.1)) if bad and k else each
            for k, (each, bad) in enumerate(zip(imus, empty, strict=True))
        ]
        pairs, best = (
            walk.feed_all(by_stamp(spoiled, fields)),
            whole.feed_all(by_stamp(imus, fields)),
        )
        assert walk.streams.imu_drops == {DropReason.NOT_FINITE: empty[1:].sum()}
        assert all(pair.span is not None for pair in pairs[1:])
        path, true = (
            np.sum([pair.span.velocity for pair in each[1:]], 0) for each in (pairs, best)
        )
        assert path == pytest.approx(true, rel=1e-3)

    def test_the_accelerometer_is_used_when_the_gyro_stops(self):
        streams = Streams(MAX_GAP)
        lost = STREAMS.longest_gyro_step
        assert streams.add_imu(imu(1.0))
        assert not streams.add_imu(imu(1.0 + 0.5 * lost, rate=(math.nan,) * 3))
        assert streams.add_imu(imu(1.0 + 1.5 * lost, rate=(math.nan,) * 3))


class TestFieldDrops:
    @pytest.mark.parametrize(
        ("sample", "reason"),
        [
            (mag(1.0, (math.nan, 0.0, 1e-6)), DropReason.NOT_FINITE),
            (mag(1.0, (math.inf, 0.0, 1e-6)), DropReason.NOT_FINITE),
            (mag(1.0, (0.0, 0.0, 0.0)), DropReason.ZERO),
            (mag(1.0, (0.0, 5e-324, 1e-160)), DropReason.ZERO),
            (mag(1.0, (0.0, 0.0, 1.001 * STREAMS.largest_field)), DropReason.TOO_LARGE),
            (mag(0.0), DropReason.ZERO_STAMP),
            (mag(0.5), DropReason.BACKWARD_STAMP),
            (mag(0.6), DropReason.REPEATED),
        ],
    )
    def test_an_unusable_sample_is_counted_by_its_reason(self, sample, reason):
        streams = Streams(MAX_GAP)
        assert streams.add_field(mag(0.6))
        assert not streams.add_field(sample)
        assert streams.field_drops == {reason: 1}

    def test_the_largest_turn_with_one_value_is_known(self):
        streams, seen = Streams(MAX_GAP), []
        values = [1e-5, 1e-5, 1e-5, 1e-5, 2e-5, 2e-5, 1e-5]
        for k, (value, turned) in enumerate(zip(values, [5, 5, 7, 4, 1, 0, 0], strict=True)):
            assert streams.add_field(mag(1.0 + k, (value, 0.0, 0.0)), float(turned))
            seen.append(streams.turned_unchanged)
        assert seen == [0, 0, 2, 2, 0, 1, 0]

    def test_a_field_up_to_the_limit_is_used(self):
        assert Streams(MAX_GAP).add_field(mag(1.0, (0.0, 0.0, 0.999 * STREAMS.largest_field)))

    def test_the_size_of_a_too_large_field_is_stored(self):
        streams = Streams(MAX_GAP)
        streams.add_field(mag(1.0, (30.0, 0.0, 40.0)))
        assert streams.largest_field == pytest.approx(50.0)

    def test_a_bad_sample_does_not_move_time(self):
        streams = Streams(MAX_GAP)
        streams.add_field(mag(1000.0, (math.nan, 0.0, 0.0)))
        assert streams.add_field(mag(1.0))

    def test_an_unchanged_value_with_a_new_stamp_is_usable_and_counted(self):
        streams = Streams(MAX_GAP)
        streams.add_field(mag(1.0))
        assert not streams.is_repeated
        assert streams.add_field(mag(1.1))
        assert streams.is_repeated
        assert streams.field_drops == {DropReason.REPEATED: 1}
        assert streams.add_field(mag(1.2, (21e-6, 5e-6, -40e-6)))
        assert not streams.is_repeated


class TestInterpolation:
    @given(
        st.lists(st.floats(0.005, 0.19), min_size=1, max_size=20),
        st.floats(0.0, 1.0),
    )
    def test_interpolation_reproduces_a_straight_line(self, steps, share):
        streams, stamp = Streams(MAX_GAP), 1.0
        streams.add_imu(line(stamp))
        for step in steps:
            stamp += step
            streams.add_imu(line(stamp))
        asked = 1.0 + share * (stamp - 1.0)
        found, truth = streams.imu_at(min(asked, stamp)), line(min(asked, stamp))
        assert found.stamp == truth.stamp
        assert found.force == pytest.approx(truth.force, abs=1e-12)
        assert found.rate == pytest.approx(truth.rate, abs=1e-12)

    def test_there_is_no_value_outside_the_samples(self):
        streams = Streams(MAX_GAP)
        assert streams.imu_at(1.0) is None
        streams.add_imu(line(1.0))
        streams.add_imu(line(1.1))
        assert streams.imu_at(0.999) is None
        assert streams.imu_at(1.101) is None

    def test_across_a_gap_only_its_edges_have_values(self):
        streams = Streams(MAX_GAP)
        streams.add_imu(line(1.0))
        streams.add_imu(line(1.0 + 1.01 * MAX_GAP))
        assert streams.imu_at(1.1) is None
        assert streams.imu_at(1.0) == line(1.0)
        streams.add_imu(line(1.3))
        assert streams.imu_at(1.25).force == pytest.approx(line(1.25).force)

    def test_a_rate_that_is_absent_stays_absent(self):
        streams = Streams(MAX_GAP)
        for stamp in (1.0, 1.1):
            streams.add_imu(imu(stamp, rate=(math.nan,) * 3))
        found = streams.imu_at(1.05)
        assert found.force == pytest.approx(UP)
        assert all(math.isnan(value) for value in found.rate)

    def test_only_the_history_is_kept(self):
        streams = Streams(MAX_GAP)
        for k in range(STREAMS.remembered + 1):
            streams.add_imu(line(1.0 + 0.001 * k))
        assert streams.imu_at(1.0) is None
        assert streams.imu_at(1.0015) is not None

    def test_after_time_was_set_back_old_samples_are_not_used(self):
        streams = Streams(MAX_GAP)
        for k in range(200):
            streams.add_imu(imu(1.0 + 0.01 * k, force=(9.81, 0.0, 0.0)))
        for k in range(50):
            streams.add_imu(imu(2.0 + 0.01 * k))
        assert streams.imu_at(2.05) is None
        assert streams.imu_at(2.255).force == pytest.approx(UP)


class TestPairs:
    def test_a_field_sample_waits_for_the_next_imu_sample(self):
        walk = Walk()
        walk.feed_all([line(1.0), numbered(1.005)])
        assert not walk.pairs
        walk.feed(line(1.01))
        assert [pair.field.stamp for pair in walk.pairs] == [1.005]
        assert walk.pairs[0].imu.force == pytest.approx(line(1.005).force)

    @pytest.mark.nightly
    @examples(60)
    @given(
        st.data(),
        st.floats(20.0, 400.0),
        st.floats(5.0, 150.0),
        st.floats(0.0, 0.05),
    )
    def test_the_order_of_arrival_does_not_matter(self, data, imu_rate, field_rate, phase):
        imus, fields = drive(1.0, 1.0, imu_rate, field_rate, phase)
        expected = Walk().feed_all(by_stamp(imus, fields))
        merged, i, j = [], 0, 0
        while i < len(imus) or j < len(fields):
            take_imu = i < len(imus) and (j == len(fields) or data.draw(st.booleans()))
            merged.append(imus[i] if take_imu else fields[j])
            i, j = i + take_imu, j + (not take_imu)
        assert Walk().feed_all(merged) == expected
        enclosed = [f for f in fields if imus[0].stamp <= f.stamp <= imus[-1].stamp]
        assert [pair.field for pair in expected] == enclosed

    @pytest.mark.parametrize("late", ["imu", "field"])
    def test_one_sensor_may_arrive_seconds_after_the_other(self, late):
        imus, fields = drive(1.0, 8.0)
        expected = Walk().feed_all(by_stamp(imus, fields))
        first, second = (fields, imus) if late == "imu" else (imus, fields)
        assert Walk().feed_all([*first, *second]) == expected
        assert len(expected) == len(fields)

    def test_pairs_have_the_imu_sample_at_their_stamp(self):
        for pair in Walk().feed_all(by_stamp(*drive(1.0, 3.0, 37.0, 61.0))):
            truth = line(pair.field.stamp)
            assert pair.imu.force == pytest.approx(truth.force)
            assert pair.imu.rate == pytest.approx(truth.rate)

    @pytest.mark.parametrize("imu_rate", [97.0, 11.0])
    def test_pairs_have_the_integrals_since_the_previous_pair(self, imu_rate):
        pairs = Walk().feed_all(by_stamp(*drive(1.0, 3.0, imu_rate, 23.0)))
        assert pairs[0].span is None
        for before, pair in itertools.pairwise(pairs):
            start, end = before.field.stamp, pair.field.stamp
            middle = line(0.5 * (start + end))
            assert pair.span.velocity == pytest.approx(np.multiply(middle.force, end - start))
            # Of a rate that keeps its direction nearly, the vector is the integral.
            assert pair.span.angle == pytest.approx(np.multiply(middle.rate, end - start), abs=1e-4)
            assert pair.span.intervals >= 1

    def test_coning_causes_a_net_rotation(self):
        """Tilts a quarter of a period apart add up to a turn about the third axis."""
        walk, tilt, way = Walk(), 0.05, math.tau * 4.0
        for row in range(1001):
            stamp = 1.0 + row / 1000.0
            spin = tilt * way * math.cos(way * stamp), tilt * way * math.sin(way * stamp), 0.0
            walk.feed(imu(stamp, rate=spin))
            if row % 50 == 0:
                walk.feed(FieldSample(stamp, (2e-5, 1e-8 * row, 0.0)))
        turned = np.eye(3)
        for pair in walk.pairs[1:]:
            turned = exp_rotation(-np.array(pair.span.angle)) @ turned
        half_solid_angle = 0.5 * tilt**2 * way
        assert turned[0, 1] == pytest.approx(half_solid_angle, rel=0.02)

    def test_there_are_no_integrals_over_a_gap_or_without_a_gyro(self):
        imus, fields = drive(1.0, 3.0)
        holed = [sample for sample in imus if not 1.8 < sample.stamp < 2.3]
        pairs = Walk().feed_all(by_stamp(holed, fields))
        lost = [pair.field.stamp for pair in pairs if pair.span is None]
        assert lost == [pairs[0].field.stamp, pytest.approx(2.303)]
        guessed = [sample._replace(is_measured=sample.stamp % 0.25 < 0.005) for sample in imus]
        spans = [pair.span for pair in Walk().feed_all(by_stamp(guessed, fields))]
        assert all(span is None or span.intervals <= 2 for span in spans)
        blind = [sample._replace(rate=(math.nan,) * 3) for sample in imus]
        assert all(pair.span is None for pair in Walk().feed_all(by_stamp(blind, fields)))

    def test_a_span_of_more_than_half_a_turn_is_integrated_while_the_body_sways(self):
        """A field of 1 Hz, or one that is silent for a second while its robot turns."""
        step, body = 0.01, np.eye(3)
        stamps = 1.0 + step * np.arange(301)
        lean = 0.6 * np.cos(9.0 * stamps[:, None] + [0.0, 1.0])
        rates = np.column_stack([lean, np.full(len(stamps), 3.5)])
        bodies = [body]
        for turn in exp_rotations(-0.5 * step * (rates[1:] + rates[:-1])):
            bodies.append(turn @ bodies[-1])
        imus = [imu(t, rate=tuple(w)) for t, w in zip(stamps, rates.tolist(), strict=True)]
        pairs = Walk().feed_all(by_stamp(imus, [numbered(float(t)) for t in stamps[::100]]))
        for k, pair in enumerate(pairs[1:]):
            truth = bodies[100 * (k + 1)] @ bodies[100 * k].T
            np.testing.assert_allclose(exp_rotation(-np.array(pair.span.angle)), truth, atol=1e-6)
            assert pair.span.angle[2] == pytest.approx(3.5, abs=0.1)
        assert len(pairs) == 4

    def test_a_field_in_a_gap_of_the_imu_is_counted_as_unpaired(self):
        imus, fields = drive(1.0, 3.0)
        holed = [sample for sample in imus if not 1.8 < sample.stamp < 2.3]
        walk = Walk()
        walk.feed_all(by_stamp(holed, fields))
        lost = [sample for sample in fields if 1.8 < sample.stamp < 2.3]
        assert walk.streams.field_drops[DropReason.UNPAIRED] == len(lost) > 20
        assert len(walk.pairs) == len(fields) - len(lost)

    def test_a_field_sample_without_an_imu_sample_is_dropped_and_counted(self):
        walk = Walk()
        walk.feed_all(drive(1.0, 100.0)[1])
        assert walk.streams.field_drops[DropReason.UNPAIRED] == 5000 - STREAMS.remembered

    def test_a_repeated_field_sample_gives_no_second_pair(self):
        imus, fields = drive(1.0, 2.0)
        doubled = [copy for f in fields for copy in (f, FieldSample(f.stamp + 1e-3, f.field))]
        walk = Walk()
        walk.feed_all(by_stamp(imus, doubled))
        assert [pair.field for pair in walk.pairs] == fields[: len(walk.pairs)]
        assert len(walk.pairs) >= len(fields) - 1
        assert walk.streams.field_drops[DropReason.REPEATED] == len(fields)

    @pytest.mark.parametrize("tail", ["imu", "field"])
    def test_a_restarted_bag_is_paired_again_after_a_few_samples(self, tail):
        """Whichever sensor was the last before the loop."""
        imus, fields = drive(50.0, 2.0)
        first = by_stamp(imus, fields)
        first = first[:-5] if tail == "imu" else [*first, numbered(52.5)]
        walk = Walk()
        walk.feed_all(first)
        before = len(walk.pairs)
        again = by_stamp(*drive(1.0, 2.0))
        walk.feed_all(again)
        found = [pair.field.stamp for pair in walk.pairs[before:]]
        assert len(found) >= 100 - 2 * STREAMS.restart_after
        assert found == sorted(found)
        assert all(1.0 <= stamp < 3.1 for stamp in found)
        for pair in walk.pairs[before:]:
            assert pair.imu.force == pytest.approx(line(pair.field.stamp).force)

    @pytest.mark.parametrize("which", ["imu", "field"])
    def test_a_single_stamp_in_the_far_future_costs_only_a_few_samples(self, which):
        imus, fields = drive(1.0, 4.0)
        stray = line(1e9) if which == "imu" else mag(1e9, (1e-6, 2e-6, 3e-6))
        stream = by_stamp(imus, fields)
        stream.insert(len(stream) // 2, stray)
        walk = Walk()
        walk.feed_all(stream)
        assert len(walk.pairs) >= len(fields) - 2 * STREAMS.restart_after
        assert walk.pairs[-1].field.stamp > 4.9
        for pair in walk.pairs:
            assert pair.imu.force == pytest.approx(line(pair.field.stamp).force)
