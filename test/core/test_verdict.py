import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sample_results import estimate

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.knowledge import Belief, Knowledge, ReferenceField
from magcal_ros.core.simulator import Robot
from magcal_ros.core.verdict import (
    NO_GYRO,
    NO_REFERENCE,
    NO_YAW,
    THRESHOLDS,
    Aspect,
    Check,
    Grade,
    Verdict,
    judge,
    refuse,
)

KNOWN = Robot().knowledge()
BY_FIGURE = {threshold.figure: threshold for threshold in THRESHOLDS}
every_threshold = pytest.mark.parametrize("threshold", THRESHOLDS, ids=BY_FIGURE)


def at(threshold, value):
    """Check a value given in the unit people see."""
    return threshold.check(value / threshold.scale)


class TestThreshold:
    @every_threshold
    def test_the_table_goes_from_best_to_worst(self, threshold):
        assert 0.0 < threshold.excellent < threshold.good < threshold.warn
        assert threshold.words
        assert threshold.remedy

    @every_threshold
    def test_every_bound_belongs_to_the_better_grade(self, threshold):
        bounds = (threshold.excellent, threshold.good, threshold.warn)
        for bound, better, worse in zip(bounds, list(Grade), list(Grade)[1:], strict=False):
            assert at(threshold, 0.999 * bound).grade is better
            assert at(threshold, 1.001 * bound).grade is worse
        assert at(threshold, 0.0).grade is Grade.EXCELLENT

    @every_threshold
    @pytest.mark.parametrize("value", [math.nan, math.inf])
    def test_a_figure_that_is_no_number_is_refused(self, threshold, value):
        assert threshold.check(value).grade is Grade.REFUSED

    @every_threshold
    def test_the_words_give_the_value_in_the_unit_people_see(self, threshold):
        words = at(threshold, 0.5 * threshold.excellent).words
        assert words == f"{threshold.words} {0.5 * threshold.excellent:.3g}{threshold.unit}"

    @every_threshold
    def test_what_falls_short_says_what_is_wanted_and_what_to_do(self, threshold):
        warned = at(threshold, 0.5 * (threshold.good + threshold.warn)).words
        assert f"(want {threshold.good:g}{threshold.unit} or less): {threshold.remedy}" in warned
        refused = at(threshold, 2.0 * threshold.warn).words
        assert f"(want {threshold.warn:g}{threshold.unit} or less): {threshold.remedy}" in refused

    @every_threshold
    def test_what_is_good_needs_no_advice(self, threshold):
        assert threshold.remedy not in at(threshold, threshold.good * 0.99).words

    def test_each_figure_has_one_row(self):
        assert len(BY_FIGURE) == len(THRESHOLDS)


def graded(*grades):
    return Verdict(tuple(Check("x", aspect, grade, "") for aspect, grade in grades), (), "")


class TestGrades:
    def test_they_rank_from_best_to_worst(self):
        assert all(a.rank < b.rank for a, b in pairwise(Grade))

    @given(st.lists(st.tuples(st.sampled_from(Aspect), st.sampled_from(Grade)), max_size=8))
    def test_each_aspect_is_as_good_as_its_worst_check(self, grades):
        verdict = graded(*grades)
        for aspect, found in (
            (Aspect.QUALITY, verdict.quality),
            (Aspect.CONFIDENCE, verdict.confidence),
        ):
            own = [grade.rank for which, grade in grades if which is aspect]
            assert found.rank == (max(own) if own else Grade.REFUSED.rank)
        refused = Grade.REFUSED in (verdict.quality, verdict.confidence)
        assert verdict.accepted == (not refused)


class TestJudge:
    def test_a_flawless_estimate_is_excellent_in_both(self):
        verdict = judge(estimate(), KNOWN)
        assert verdict.quality is verdict.confidence is Grade.EXCELLENT
        assert verdict.accepted

    @pytest.mark.parametrize(
        ("figure", "aspect"), [(name, row.aspect) for name, row in BY_FIGURE.items()]
    )
    @pytest.mark.parametrize("bad", ["refused", "nan"])
    def test_one_bad_figure_refuses_its_own_aspect_only(self, figure, aspect, bad):
        row = BY_FIGURE[figure]
        value = math.nan if bad == "nan" else 2.0 * row.warn / row.scale
        verdict = judge(estimate(figures={figure: value}), KNOWN)
        assert not verdict.accepted
        expected = {aspect: Grade.REFUSED}
        assert verdict.quality is expected.get(Aspect.QUALITY, Grade.EXCELLENT)
        assert verdict.confidence is expected.get(Aspect.CONFIDENCE, Grade.EXCELLENT)
        assert verdict.summary.startswith("Refused (quality")
        assert row.remedy in verdict.summary

    @pytest.mark.parametrize("field", ["strength", "inclination"])
    def test_a_reference_field_that_is_no_number_is_refused(self, field):
        assert not judge(estimate(**{field: math.nan}), KNOWN).accepted

    def test_a_residual_that_is_no_number_is_refused(self):
        residual = np.zeros((500, 3))
        residual[7, 1] = math.nan
        assert judge(estimate(residual=residual), KNOWN).quality is Grade.REFUSED

    @pytest.mark.parametrize(
        ("strength", "grade"),
        [
            (19.9, Grade.WARN),
            (20.1, Grade.EXCELLENT),
            (69.9, Grade.EXCELLENT),
            (70.1, Grade.WARN),
        ],
    )
    def test_a_strength_that_is_not_the_earths_warns(self, strength, grade):
        verdict = judge(estimate(strength=strength * 1e-6, residual=np.zeros((500, 3))), KNOWN)
        assert verdict.quality is grade
        assert ("is not the Earth's" in verdict.summary) == (grade is Grade.WARN)

    def test_a_strength_in_gauss_is_called_so(self):
        assert "looks like gauss" in judge(estimate(strength=0.48), KNOWN).summary

    def test_the_summary_holds_what_was_found(self):
        summary = judge(estimate(), KNOWN).summary
        assert summary.startswith("Calibrated, quality excellent, confidence excellent: heading ±")
        assert "heading ±0.11° on the level" in summary
        assert "hard iron (30.0, -20.0, 25.0) µT" in summary
        assert "installation roll 3.00°, pitch -4.00°" in summary
        assert "But" not in summary

    def test_the_summary_names_warnings(self):
        summary = judge(estimate(figures={"gyro_compass_rms": math.radians(7.0)}), KNOWN).summary
        assert summary.startswith("Calibrated, quality warn, confidence excellent")
        assert "But gyro against compass around the turn 7° (want 4° or less)" in summary

    def test_the_summary_of_a_refusal_names_its_causes_only(self):
        figures = {
            "gyro_compass_rms": math.radians(20.0),
            "split_half": math.radians(9.0),
            "ellipse_excess": 0.2,
        }
        summary = judge(estimate(figures=figures), KNOWN).summary
        assert "gyro against compass around the turn 20°" in summary
        assert "two halves of the turn differ by 9°" in summary
        assert "ellipse" not in summary
        assert "Calibrated" not in summary


class TestNotShown:
    def test_the_yaw_of_the_installation_never_is(self):
        assert NO_YAW in judge(estimate(), KNOWN).not_shown

    def test_without_a_gyro_distortion_is_not(self):
        assert NO_GYRO in judge(estimate(), KNOWN).not_shown
        seen = judge(estimate(figures={"gyro_compass_rms": 0.01}), KNOWN)
        assert NO_GYRO not in seen.not_shown

    @pytest.mark.parametrize(
        ("reference", "complete"),
        [
            (ReferenceField(), False),
            (ReferenceField(Belief(50e-6), Belief.unknown()), False),
            (ReferenceField(Belief.unknown(), Belief(1.0)), False),
            (ReferenceField(Belief(50e-6), Belief(1.0, 0.1)), True),
        ],
    )
    def test_without_strength_and_inclination_the_radius_is_not(self, reference, complete):
        not_shown = judge(estimate(), Knowledge(reference)).not_shown
        assert (NO_REFERENCE in not_shown) == (not complete)

    def test_an_uncertain_axial_hard_iron_is_named_with_its_cost(self):
        covariance = np.zeros((12, 12))
        covariance[9:, 9:] = np.diag([0.05e-6, 0.05e-6, 5e-6]) ** 2
        not_shown = judge(estimate(covariance=covariance), KNOWN).not_shown
        words = [text for text in not_shown if "along the turn's axis" in text]
        # 5 µT * sin 10° / 25 µT / sqrt 2
        assert len(words) == 1
        assert "1.4° (1σ) of heading at 10° of tilt" in words[0]

    def test_a_certain_axial_hard_iron_is_not_named(self):
        assert not [t for t in judge(estimate(), KNOWN).not_shown if "turn's axis" in t]


class TestRefuse:
    def test_a_refusal_is_a_verdict_with_its_reason_in_both_aspects(self):
        refusal = Refusal(Reason.ARC_TOO_SHORT, "only 30° were seen; turn further")
        verdict = refuse(refusal)
        assert verdict.quality is verdict.confidence is Grade.REFUSED
        assert not verdict.accepted
        assert verdict.summary == "Refused: only 30° were seen; turn further."
        assert {check.figure for check in verdict.checks} == {"arc_too_short"}
        assert {check.words for check in verdict.checks} == {str(refusal)}

    def test_the_sentence_ends_with_one_stop(self):
        assert refuse(Refusal(Reason.PLANAR, "It is flat.")).summary == "Refused: It is flat."

    def test_dots_inside_the_words_are_kept(self):
        verdict = refuse(Refusal(Reason.PLANAR, "see ../notes... and turn."))
        assert verdict.summary == "Refused: see ../notes... and turn."
