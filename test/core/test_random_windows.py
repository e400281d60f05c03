"""Any window gives a result with finite numbers, or a refusal with a reason."""

import math

import numpy as np
import pytest
from long_form import IS_LONG, rounds

from magcal_ros.core import METHODS, Belief, Knowledge, ReferenceField, Window, calibrate
from magcal_ros.core.calibrate import predicted_sigma

pytestmark = pytest.mark.faults

COUNT = rounds(60, 10_000)
SLOW = {"maximum_likelihood": rounds(20, 10_000), "smoother_one": rounds(5, 10_000)}
"""The second is another name of the first."""
SAMPLES = (0, 1, 2, 3, 4, 5, 7, 10, 30, 100, 400)
FIELD_SCALES = (5e-5, 5e-5, 5e-5, 1e-3, 50.0, 5e4, 1e-9, 1e-20, 1e-150, 1e150)
FORCE_SCALES = (9.81, 9.81, 9.81, 1.0, 1e3, 1e-5, 1e4, 1e150)
RATE_SCALES = (0.5, 0.5, 1.0, 100.0, 1e4, 1e-9, 1e-300)


def random_times(rng):
    n = int(rng.choice(SAMPLES))
    if rng.random() < 0.3:
        return np.unique(np.cumsum(10.0 ** rng.uniform(-6, 3, n)))
    return np.unique(1e9 * (rng.random() < 0.5) + np.arange(n) * 10.0 ** rng.uniform(-4, 2))


def random_vectors(rng, n, scale):
    """Vectors of one size: turning, noise, a line, a point, a lattice; or very different ones."""
    around = rng.uniform(-7.0, 7.0) * np.linspace(0.0, 1.0, n)
    circle = np.column_stack([np.cos(around), np.sin(around), np.full(n, rng.standard_normal())])
    noise = rng.standard_normal((n, 3))
    kinds = (
        circle,
        circle + 0.01 * noise,
        noise,
        np.outer(rng.standard_normal(n), rng.standard_normal(3)),
        np.tile(rng.standard_normal(3), (n, 1)),
        np.tile([0.0, 0.0, 1.0], (n, 1)),
        np.round(noise),
        np.zeros((n, 3)),
        noise * 10.0 ** rng.uniform(-12, 3, (n, 1)),
    )
    return scale * kinds[rng.integers(0, len(kinds))]


def random_window(rng):
    time = random_times(rng)
    n = len(time)
    field = random_vectors(rng, n, rng.choice(FIELD_SCALES))
    force = random_vectors(rng, n, rng.choice(FORCE_SCALES))
    rate = None if rng.random() < 0.4 else random_vectors(rng, n, rng.choice(RATE_SCALES))
    return Window(time, field, force, rate)


def random_knowledge(rng):
    if rng.random() < 0.4:
        return Knowledge()
    strength = Belief(48e-6, float(rng.choice([0.0, 1.5e-6])))
    dip = Belief(float(rng.uniform(-0.5 * math.pi, 0.5 * math.pi)), float(rng.choice([0.0, 0.02])))
    return Knowledge(ReferenceField(strength, dip))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("method", METHODS)
def test_any_window_gives_finite_numbers_or_a_refusal(method):
    accepted, count = 0, SLOW.get(method, COUNT)
    for number in range(count):
        rng = np.random.default_rng([number, 17])
        window, knowledge = random_window(rng), random_knowledge(rng)
        outcome = calibrate(window, knowledge, method)
        assert outcome.verdict.summary, number
        accepted += outcome.verdict.accepted
        if outcome.calibration is None:
            assert outcome.reason is not None, number
            continue
        found = outcome.calibration
        for numbers in (found.correction.parameters, found.covariance, found.strength):
            assert np.isfinite(numbers).all(), number
    # Such samples are no turns: what is accepted among them is accepted by chance.
    assert accepted <= 0.02 * count


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_the_predicted_sigma_of_any_window_is_a_number_or_infinite():
    for number in range(COUNT // 4):
        rng = np.random.default_rng([number, 23])
        assert predicted_sigma(random_window(rng), random_knowledge(rng)) >= 0.0


@pytest.mark.skipif(not IS_LONG, reason="`make soak` runs it; it takes an hour")
def test_a_wrong_heading_is_flagged_in_all_but_a_thousandth():
    """Error beyond five sigma and accepted without a warning, in good and bad random turns."""
    from honesty_cases import KINDS, Row, draw_case

    rows = {kind: Row() for kind in KINDS}
    for number in range(10_000):
        kind, case = draw_case(7, number)
        rows[kind].run(case, f"{kind}, case {number}")
    assert sum(row.broken for row in rows.values()) == 0
    assert sum(row.misses for row in rows.values()) <= 10
