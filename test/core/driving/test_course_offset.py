"""The compass compared with course: each street is one independent measurement."""

import math

import numpy as np
import pytest
from follow_drive import ROBOT, driven, follow
from long_form import first_of
from simulated import (
    Fence,
    Leg,
    Receiver,
    StreetField,
    Streets,
    Vehicle,
    circles,
    city,
    joined,
    one_street,
    reversing,
    standing,
)

from magcal_ros.core.driving import Chord, fit_course_offset

LEVEL = 21e-6
"""Tesla of the level field that the streets of these tests bend: by 8 degrees, more than most."""


def chord(east, north, course, gap, sigma=0.05, stamp=0.0):
    return Chord(stamp, east, north, course, math.remainder(gap, math.tau), 0.0, sigma, 10.0)


def bent(street, places):
    return -street.at(np.asarray(places, dtype=float))[:, 0] / LEVEL


def walk(rng, metres, street, offset=0.2, noise=0.05, iid=0.0):
    """Chords of a walk through blocks of 120 m, every 20 m of way."""
    place, course, chords = np.zeros(2), 0.0, []
    for _ in range(int(metres / 120.0)):
        ahead = np.array([math.cos(course), math.sin(course)])
        places = place + np.arange(10.0, 120.0, 20.0)[:, None] * ahead
        gaps = offset + bent(street, places) + noise * rng.standard_normal(len(places))
        gaps += iid * rng.standard_normal(len(places))
        chords += [chord(*p, course, g) for p, g in zip(places, gaps, strict=True)]
        place = place + 120.0 * ahead
        course += rng.choice([-1.0, 0.0, 1.0]) * 0.5 * math.pi
    return chords


def honesty(metres, drives, **options):
    """RMS error in degrees, and the mean of its square over the said variance."""
    errors, sigmas = [], []
    for seed in range(drives):
        rng = np.random.default_rng(seed)
        street = StreetField(Streets(size=options.get("size", 3e-6), waves=80), rng)
        found = fit_course_offset(walk(rng, metres, street, iid=options.get("iid", 0.0)))
        errors.append(found.offset - 0.2)
        sigmas.append(found.sigma)
    errors = np.array(errors)
    return np.degrees(np.sqrt(np.mean(errors**2))), np.mean((errors / sigmas) ** 2)


@pytest.mark.parametrize(("metres", "bound"), [(500.0, 2.5), (2000.0, 1.5)])
def test_the_error_is_within_the_sigma_by_the_number_of_streets(metres, bound):
    rms, nees = honesty(metres, 30)
    assert rms < bound
    assert 0.2 < nees < 2.5


@pytest.mark.nightly
@pytest.mark.parametrize(("metres", "bound"), [(500.0, 2.6), (2000.0, 1.5)])
def test_the_sigma_is_correct_over_two_hundred_drives(metres, bound):
    rms, nees = honesty(metres, 200)
    assert rms < bound
    assert 0.5 < nees < 2.0


@pytest.mark.nightly
def test_white_noise_gives_no_too_large_sigma():
    _, nees = honesty(1000.0, 200, size=1e-9, iid=math.radians(8.0))
    assert 0.25 < nees < 2.0


def again_and_again(seed, times, back):
    rng = np.random.default_rng(seed)
    street = StreetField(Streets(waves=80), rng)
    chords = []
    for time in range(times):
        west = back and time % 2
        across = 3.0 if west else 0.0
        places = [(x + rng.uniform(0.0, 5.0), across) for x in np.arange(5.0, 200.0, 12.0)]
        places = places[::-1] if west else places
        gaps = bent(street, places) + 0.05 * rng.standard_normal(len(places))
        course = math.pi if west else 0.0
        chords += [chord(*p, course, g) for p, g in zip(places, gaps, strict=True)]
    return fit_course_offset(chords).sigma


@pytest.mark.parametrize("back", [False, True])
def test_one_street_driven_twenty_times_counts_once(back):
    ratios = [again_and_again(seed, 20, back) / again_and_again(seed, 1, back) for seed in range(8)]
    assert np.median(ratios) > 0.9
    assert min(ratios) > 0.85


def test_a_single_street_gives_no_usable_offset():
    assert again_and_again(1, 20, True) > math.radians(3.0)


def test_hard_iron_enlarges_the_sigma():
    rng = np.random.default_rng(2)
    street = StreetField(Streets(waves=80), rng)
    usual = walk(rng, 3000.0, street)
    swung = [
        each._replace(gap=each.gap + math.radians(9.0) * math.cos(each.course - 1.0))
        for each in usual
    ]
    assert fit_course_offset(swung).sigma > 1.5 * fit_course_offset(usual).sigma


def gap_deg(found, true):
    return math.degrees(math.remainder(found.offset - true, math.tau))


@pytest.mark.parametrize("delay", first_of([0.6, 6.0, 0.0]))
def test_late_fixes_do_no_harm_on_straight_roads(delay):
    legs = city(np.random.default_rng(3), 150.0)
    drive = driven(legs, 3, Vehicle(ROBOT, imu_yaw=0.1), receiver=Receiver(delay=delay))
    found = follow(drive).fit_course()
    if delay < 6.0:
        assert found.sigma < math.radians(4.0)
    assert found is None or abs(gap_deg(found, 0.1)) < 3.0 * math.degrees(found.sigma)


@pytest.mark.parametrize("legs", [circles(120.0), standing(120.0)])
def test_tight_circles_and_rests_give_no_offset(legs):
    assert follow(driven(legs, 4)).fit_course() is None


def test_walking_pace_with_poor_fixes_gives_no_offset():
    legs = city(np.random.default_rng(5), 150.0, fastest=1.2)
    assert follow(driven(legs, 5, receiver=Receiver(noise=0.5))).fit_course() is None


@pytest.mark.parametrize("seed", first_of([2, 6, 7, 8]))
def test_a_drifting_boat_is_refused(seed):
    """The current takes it along while it looks about: the course is not the heading.

    Of all but the sixth the hull turns so slowly that it could pass for a gyro's bias.
    """
    rng = np.random.default_rng(seed)
    legs = [Leg(float(rng.uniform(4.0, 8.0)), 0.0, 0.0, rng.normal(0.0, 0.04)) for _ in range(40)]
    drive = driven(legs, seed, current=(2.5, 0.5), wheels=None)
    estimator = follow(drive)
    assert estimator.drifts
    assert estimator.fit_course() is None


@pytest.mark.parametrize("noise", first_of([0.6, 0.3]))
def test_the_noise_of_a_receiver_is_no_drift(noise):
    drive = driven(city(np.random.default_rng(9), 150.0), 9, receiver=Receiver(noise=noise))
    estimator = follow(drive)
    assert len(estimator.chords) > 10
    assert not estimator.drifts


@pytest.mark.nightly
def test_driving_backwards_half_of_the_time_does_not_change_the_offset():
    rng = np.random.default_rng(7)
    legs = joined(city(rng, 120.0), reversing(rng, 8))
    drive = driven(legs, 7, Vehicle(ROBOT, imu_yaw=0.1))
    found = follow(drive).fit_course()
    assert abs(gap_deg(found, 0.1)) < 3.0 * math.degrees(found.sigma)


@pytest.mark.nightly
def test_steel_beside_one_road_is_within_the_sigma():
    fence = Fence((0.0, 6e-6, 0.0), heading=0.3)
    drive = driven(one_street(6, 250.0), 8, fences=(fence,))
    found = follow(drive).fit_course()
    assert abs(gap_deg(found, 0.0)) < 2.5 * math.degrees(found.sigma)


@pytest.mark.nightly
def test_an_outage_and_houses_leave_a_correct_sigma():
    receiver = Receiver(multipath=0.03, outages=((40.0, 80.0),))
    legs = city(np.random.default_rng(9), 200.0)
    found = follow(driven(legs, 9, receiver=receiver)).fit_course()
    assert abs(gap_deg(found, 0.0)) < 3.0 * math.degrees(found.sigma)
