from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
from slope_turns import EAST, KNOWN, LEVEL, ROBOT, window_on

from magcal_ros.core import Reason
from magcal_ros.core.calibrate import add_turn
from magcal_ros.core.multi_turn import (
    KeptTurns,
    MultiTurnReport,
    TurnAccuracy,
    TurnResult,
    names_of,
)
from magcal_ros.core.multi_turn.result import TUNING

pytestmark = pytest.mark.usefixtures("right_axes")

METHOD = "maximum_likelihood"


@pytest.fixture(scope="module")
def windows():
    rng = np.random.default_rng(1)
    foreign = replace(ROBOT, hard_iron=ROBOT.hard_iron + np.array([4e-6, 0.0, 0.0]))
    return {
        "level": window_on(LEVEL, rng, samples=300, gyro=True),
        "east": window_on(EAST, rng, samples=300, gyro=True),
        "foreign": window_on(EAST, rng, foreign, samples=300, gyro=True),
        "still": window_on(LEVEL, rng, arc=1e-3, samples=60, gyro=True),
    }


@pytest.fixture(scope="module")
def first(windows):
    return add_turn(KeptTurns(), windows["level"], KNOWN, METHOD, accumulate=True)


@pytest.mark.nightly
def test_turns_join_one_after_another(windows, first):
    outcome, kept = first
    assert outcome.verdict.accepted
    assert kept.names == ("turn 1",)
    outcome, kept = add_turn(kept, windows["east"], KNOWN, METHOD, accumulate=True)
    assert kept.names == ("turn 1", "turn 2")
    assert outcome.estimate.figures["turns"] == 2.0


@pytest.mark.parametrize("kind", first_of(["still", "foreign"]))
def test_a_refused_turn_does_not_join_and_the_others_stay(windows, first, kind):
    outcome, kept = add_turn(first[1], windows[kind], KNOWN, METHOD, accumulate=True)
    assert kept is first[1]
    assert not outcome.verdict.accepted
    assert outcome.calibration is None
    assert "turn 2 does not join the turn before it: " in outcome.verdict.summary
    assert "the turns before are kept" in outcome.verdict.summary
    if kind == "foreign":
        assert outcome.reason is Reason.TURNS_DISAGREE


def test_a_first_turn_that_is_refused_is_not_kept(windows):
    outcome, kept = add_turn(KeptTurns(), windows["still"], KNOWN, METHOD, accumulate=True)
    assert not outcome.verdict.accepted
    assert kept.windows == ()


def test_without_accumulation_no_turns_are_kept(windows, first):
    outcome, kept = add_turn(first[1], windows["east"], KNOWN, METHOD, accumulate=False)
    assert outcome.multi_turn is None
    assert kept.windows == ()


def test_the_kept_turns_are_bounded(windows):
    window = window_on(LEVEL, np.random.default_rng(2), samples=TUNING.most_samples + 1)
    shown = TurnAccuracy(0.1, (0.0,) * 6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    kept = KeptTurns()
    for _ in range(TUNING.most_turns + 2):
        turns = tuple(TurnResult(f"{k}", "", shown) for k in range(len(kept.windows) + 1))
        kept = kept.joined(window, MultiTurnReport(turns, ()))
    assert len(kept.windows) == TUNING.most_turns
    assert max(len(each) for each in kept.windows) <= TUNING.most_samples
    assert kept.names[-1] == f"turn {TUNING.most_turns + 2}"


def test_recordings_with_equal_names_get_different_names():
    assert names_of(["a", "b", "a"]) == ["a (1)", "b", "a (2)"]
