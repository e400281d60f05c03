import json
import math
from dataclasses import replace

from magcal_ros.core.multi_turn import MultiTurnReport, TurnAccuracy, TurnAdvice, TurnResult

DEGREE = math.pi / 180.0
BEFORE = TurnAccuracy(
    5.0 * DEGREE, (0.03,) * 6, 2e-6, 1e-6, 1.0 * DEGREE, 0.1, 0.1, 5.0 * DEGREE, 5.1 * DEGREE
)
AFTER = replace(BEFORE, installation_yaw=0.3 * DEGREE, absolute_tilted=0.5 * DEGREE)
FATES = (TurnResult("turn 1", "x", BEFORE), TurnResult("turn 2", "it is a copy"))


def test_advice_has_numbers_before_and_after():
    multi_turn = MultiTurnReport(FATES, (TurnAdvice("on a slope", AFTER),))
    assert multi_turn.advice_in_words == (
        "Next turn on a slope: installation yaw from ±5° to ±0.3°, absolute heading at 10° of "
        "tilt from ±5.1° to ±0.5°."
    )


def test_both_kinds_of_turn_are_named():
    advice = (TurnAdvice("about the vertical", AFTER), TurnAdvice("on a slope", AFTER))
    assert " Or on a slope: " in MultiTurnReport(FATES, advice).advice_in_words


def test_little_improvement_is_reported():
    words = MultiTurnReport(
        (replace(FATES[0], shown=AFTER),), (TurnAdvice("on a slope", AFTER),)
    ).advice_in_words
    assert words.startswith("Another turn would bring little: ")


def test_a_turn_that_did_not_join_is_named_with_its_reason():
    multi_turn = MultiTurnReport(FATES, ())
    assert multi_turn.joined == (0,)
    assert "Not joined: turn 2: it is a copy." in multi_turn.in_words


def test_very_uncertain_values_are_written_without_a_number():
    unknown = replace(BEFORE, inclination=50.0, axial_hard_iron=1e-3)
    assert "inclination ±many °" in unknown.in_words
    assert "many µT" in replace(AFTER, axial_hard_iron=1e-6).improvement(unknown)


def test_the_same_tilt_gives_no_improvement():
    assert BEFORE.improvement(BEFORE).startswith("the same tilt as before")


def test_facts_are_json_in_the_users_units():
    facts = json.loads(json.dumps(MultiTurnReport(FATES, (TurnAdvice("a", AFTER),)).facts()))
    assert facts["shown"]["installation_yaw_deg"] == 5.0
    assert facts["next"][0]["after"]["installation_yaw_deg"] == 0.3
    assert [turn["joined"] for turn in facts["turns"]] == [True, False]
