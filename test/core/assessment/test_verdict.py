import math
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sample_results import estimate

from magcal_ros.core import (
    Belief,
    Figure,
    Grade,
    Knowledge,
    Reason,
    ReferenceField,
    Refusal,
    Verdict,
    Window,
)
from magcal_ros.core.assessment import (
    GYRO_UNUSED,
    LEVEL_ONLY,
    NO_GYRO,
    NO_REFERENCE,
    NO_YAW,
    TURN_BOUNDS,
    Aspect,
    Bound,
    Check,
    judge,
    refuse,
    shown,
)
from magcal_ros.core.simulation import Robot

KNOWN = Robot().knowledge()
DRIVE = {
    Figure.HEADINGS_DRIVEN: 12.0,
    Figure.DRIVING_TIME: 300.0,
    Figure.LOCAL_FIELD: 1e-6,
    Figure.STREET: 1e-6,
}
BY_FIGURE = {bound.figure: bound for bound in TURN_BOUNDS}
every_threshold = pytest.mark.parametrize(
    "threshold", TURN_BOUNDS, ids=[f.value for f in BY_FIGURE]
)


def at(threshold, value):
    """Check a value given in the user's unit."""
    return threshold.check(value / threshold.scale)


def refused_value(threshold):
    """A value beyond the last bound, in the user's unit."""
    return threshold.warn * (0.5 if threshold.at_least else 2.0)


class TestBound:
    @every_threshold
    def test_the_table_goes_from_best_to_worst(self, threshold):
        bounds = threshold.limits
        assert min(bounds) > 0.0
        assert list(bounds) == sorted(set(bounds), reverse=threshold.at_least)
        assert threshold.words
        assert threshold.remedy

    @every_threshold
    def test_every_bound_belongs_to_the_better_grade(self, threshold):
        bounds = threshold.limits
        for bound, better, worse in zip(bounds, list(Grade), list(Grade)[1:], strict=False):
            inside, outside = (1.001, 0.999) if threshold.at_least else (0.999, 1.001)
            assert at(threshold, inside * bound).grade is better
            assert at(threshold, outside * bound).grade is worse
        none = Grade.REFUSED if threshold.at_least else Grade.EXCELLENT
        assert at(threshold, 0.0).grade is none

    @every_threshold
    def test_only_the_size_counts(self, threshold):
        assert at(threshold, -0.99 * threshold.good) == at(threshold, 0.99 * threshold.good)

    @every_threshold
    @pytest.mark.parametrize("value", [math.nan, math.inf])
    def test_a_figure_that_is_not_a_number_is_refused(self, threshold, value):
        assert threshold.check(value).grade is Grade.REFUSED

    @every_threshold
    def test_the_words_give_the_value_in_the_users_unit(self, threshold):
        value = threshold.limits[0] * (2.0 if threshold.at_least else 0.5)
        words = at(threshold, value).words
        assert words == f"{threshold.words} {value:g}{threshold.unit}"

    @every_threshold
    def test_a_failed_check_names_the_limit_and_the_remedy(self, threshold):
        warned = at(threshold, 0.5 * (threshold.good + threshold.warn)).words
        side = "more" if threshold.at_least else "less"
        assert f"(want {threshold.good:g}{threshold.unit} or {side}): {threshold.remedy}" in warned
        refused = at(threshold, refused_value(threshold)).words
        advice = threshold.when_refused or threshold.remedy
        assert f"(want {threshold.warn:g}{threshold.unit} or {side}): {advice}" in refused

    @every_threshold
    def test_a_good_check_has_no_remedy(self, threshold):
        inside = 1.01 if threshold.at_least else 0.99
        assert threshold.remedy not in at(threshold, threshold.good * inside).words

    @pytest.mark.parametrize(
        ("value", "words"), [(2450.0, "2450"), (999.6, "1000"), (1e-6, "below 0.001"), (0.0, "0")]
    )
    def test_sizes_are_written_in_a_usual_form(self, value, words):
        assert shown(value) == words

    def test_each_figure_has_one_row(self):
        assert len(BY_FIGURE) == len(TURN_BOUNDS)


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
    def test_a_perfect_estimate_is_excellent_in_both_aspects(self):
        verdict = judge(estimate(), KNOWN)
        assert verdict.quality is verdict.confidence is Grade.EXCELLENT
        assert verdict.accepted

    @pytest.mark.parametrize(
        ("figure", "aspect"), [(name, row.aspect) for name, row in BY_FIGURE.items()]
    )
    @pytest.mark.parametrize("bad", ["refused", "nan"])
    def test_one_bad_figure_refuses_its_own_aspect_only(self, figure, aspect, bad):
        row = BY_FIGURE[figure]
        value = math.nan if bad == "nan" else refused_value(row) / row.scale
        verdict = judge(estimate(figures={figure: value}), KNOWN)
        assert not verdict.accepted
        expected = {aspect: Grade.REFUSED}
        assert verdict.quality is expected.get(Aspect.QUALITY, Grade.EXCELLENT)
        assert verdict.confidence is expected.get(Aspect.CONFIDENCE, Grade.EXCELLENT)
        assert verdict.summary.startswith("Refused (quality")
        # The perfect estimate has the full circle.
        assert (row.when_refused or row.after_full or row.remedy) in verdict.summary

    @pytest.mark.parametrize("field", ["strength", "inclination"])
    def test_a_reference_field_that_is_not_a_number_is_refused(self, field):
        assert not judge(estimate(**{field: math.nan}), KNOWN).accepted

    def test_a_residual_that_is_not_a_number_is_refused(self):
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
            (279.0, Grade.REFUSED),
        ],
    )
    def test_a_strength_unlike_that_of_the_earth_warns(self, strength, grade):
        verdict = judge(estimate(strength=strength * 1e-6, residual=np.zeros((500, 3))), KNOWN)
        assert verdict.quality is grade
        assert ("is not the Earth's" in verdict.summary) == (grade is not Grade.EXCELLENT)

    def test_a_strength_in_gauss_is_named(self):
        assert "looks like gauss" in judge(estimate(strength=0.48), KNOWN).summary

    def test_the_summary_contains_the_result(self):
        summary = judge(estimate(), KNOWN).summary
        assert summary.startswith("Calibrated, quality excellent, confidence excellent: heading ±")
        assert "heading ±0.11° on level ground" in summary
        assert "hard iron (30.0, -20.0, 25.0) µT" in summary
        assert "installation roll 3.00°, pitch -4.00°" in summary
        assert "But" not in summary

    def test_the_summary_names_warnings(self):
        summary = judge(estimate(figures={"gyro_compass_rms": math.radians(7.0)}), KNOWN).summary
        assert summary.startswith("Calibrated, quality warn, confidence excellent")
        assert "But gyro against compass around the turn 7° (want 2° or less)" in summary

    def test_the_summary_of_a_refusal_names_its_causes_only(self):
        figures = {
            "gyro_compass_rms": math.radians(20.0),
            "latency": 2.0,
            "ellipse_excess": 0.2,
        }
        summary = judge(estimate(figures=figures), KNOWN).summary
        assert "gyro against compass around the turn 20°" in summary
        assert "the stamps of field and gyro differ by 2000 ms" in summary
        assert "ellipse" not in summary
        assert "Calibrated" not in summary

    def test_the_summary_names_two_reasons_and_counts_the_others(self):
        figures = {
            "gyro_compass_rms": math.radians(7.0),
            "strength_pull": -4.0,
            "inclination_pull": 4.0,
            "misalignment": math.radians(2.0),
        }
        verdict = judge(estimate(figures=figures), KNOWN)
        assert "gyro against compass" in verdict.summary
        assert "field strength deviates" in verdict.summary
        assert verdict.summary.endswith("; and 2 more.")
        headline, reasons = verdict.in_full
        assert verdict.summary.startswith(f"{headline} But {reasons[0]}; {reasons[1]}; and")
        warned = [check.words for check in verdict.checks if check.grade is Grade.WARN]
        assert list(reasons) == warned
        assert len(warned) == 4

    def test_a_given_summary_is_unchanged(self):
        verdict = replace(judge(estimate(), KNOWN), says="Calibrated. But something else.")
        assert verdict.in_full == (verdict.summary, ())

    def test_a_drive_reports_the_errors_by_calibration_and_by_streets_separately(self):
        verdict = judge(estimate(figures=DRIVE), KNOWN)
        assert re.search(
            r"heading ±[\d.]+° on level ground, ±[\d.]+° at 10° of tilt \(1σ\) by the calibration; "
            r"along the drive, with local magnetic disturbances, ±[\d.]+°; hard iron",
            verdict.summary,
        ), verdict.summary

    @pytest.mark.parametrize(
        ("degrees", "grade"),
        [(0.6, Grade.EXCELLENT), (1.8, Grade.GOOD), (2.5, Grade.WARN), (13.0, Grade.REFUSED)],
    )
    def test_one_heading_error_has_one_grade(self, degrees, grade):
        """A turn, a drive and known headings; of a drive it is the part by the calibration."""
        ways = ({}, DRIVE, {Figure.KNOWN_HEADINGS: 4.0, Figure.HEADING_MISFIT: 1.0})
        for figures in ways:
            covariance = np.zeros((12, 12))
            covariance[9:, 9:] = np.eye(3) * (25e-6 * math.radians(degrees)) ** 2
            verdict = judge(estimate(figures=figures, covariance=covariance), KNOWN)
            assert verdict.confidence is grade
            if verdict.accepted:
                assert f"heading ±{degrees:.2f}° on level ground" in verdict.summary

    @pytest.mark.parametrize("arc", [math.tau, 4.0])
    def test_the_remedy_for_a_drive_asks_for_missing_headings_only(self, arc):
        covariance = np.zeros((12, 12))
        covariance[9:, 9:] = np.eye(3) * (2e-6) ** 2
        figures = DRIVE | {"not_converged": 1.0}
        verdict = judge(estimate(arc=arc, figures=figures, covariance=covariance), KNOWN)
        words = "; ".join(verdict.reasons)
        assert "with circles to both sides, or fit a longer recording" in words
        assert ("with all headings" in words) is (arc < math.tau)
        assert "drive elsewhere" in words
        assert "turn once more" not in words


def window(force):
    n = len(force)
    return Window(np.arange(n) / 10.0, np.full((n, 3), 30e-6), force)


def grade_of(verdict, figure):
    return next(check for check in verdict.checks if check.figure == figure)


class TestWhatTheEstimateItselfShows:
    @pytest.mark.parametrize(
        ("arc", "grade"),
        [(360, Grade.EXCELLENT), (200, Grade.GOOD), (100, Grade.WARN), (30, Grade.REFUSED)],
    )
    def test_a_short_arc_reduces_confidence(self, arc, grade):
        verdict = judge(estimate(arc=math.radians(arc)), KNOWN)
        assert (verdict.quality, verdict.confidence) == (Grade.EXCELLENT, grade)
        if grade is Grade.WARN:
            assert "the turn covers 100° (want 160° or more): turn the full circle" in (
                verdict.summary
            )

    @pytest.mark.parametrize(
        ("arc", "iron_ut", "grade"),
        [(93, 0.05, Grade.WARN), (93, 1.0, Grade.REFUSED), (99, 1.0, Grade.WARN)],
    )
    def test_an_arc_that_may_be_below_the_limit_is_refused(self, arc, iron_ut, grade):
        covariance = np.zeros((12, 12))
        covariance[9:, 9:] = np.eye(3) * (iron_ut * 1e-6) ** 2
        verdict = judge(estimate(arc=math.radians(arc), covariance=covariance), KNOWN)
        found = grade_of(verdict, Figure.ARC)
        assert found.grade is grade
        if grade is Grade.REFUSED:
            assert "the turn covers 93° (want 96.5° or more): the arc is known to ±6.48°" in (
                found.words
            )

    def test_few_inliers_reduce_confidence(self):
        few = {"inliers": np.ones(30, dtype=bool), "residual": np.zeros((30, 3))}
        verdict = judge(estimate(**few), KNOWN)
        assert verdict.confidence is Grade.WARN
        assert "samples used: 30 (want 50 or more)" in verdict.summary

    @pytest.mark.parametrize(
        ("axis", "grade"),
        [
            ([0.0, 0.0, 1.0], Grade.EXCELLENT),
            ([0.5, 0.0, 0.866], Grade.GOOD),
            ([0.0, 0.9, 0.436], Grade.WARN),
            ([0.0, 0.0, -1.0], Grade.REFUSED),
        ],
    )
    def test_a_board_that_is_not_upright_is_reported(self, axis, grade):
        check = grade_of(judge(estimate(axis=np.array(axis)), KNOWN), "axis_lean")
        assert check.grade is grade
        reported = "z points down or sideways at rest" in check.words
        assert reported == (grade.rank >= Grade.WARN.rank)

    @pytest.mark.parametrize(("carried", "grade"), [(1.0, Grade.EXCELLENT), (0.0, Grade.WARN)])
    def test_a_gyro_that_measures_another_turn_warns(self, carried, grade):
        figures = {"gyro_carried": carried, "gyro_compass_rms": 0.01}
        verdict = judge(estimate(figures=figures), KNOWN)
        assert verdict.quality is grade
        reported = "the turn that the gyro measured does not explain the samples" in verdict.summary
        assert reported == (grade is Grade.WARN)

    def test_a_radius_within_the_sigma_of_the_reference_is_no_fault(self):
        figures = {"radius_ratio": 1.2}
        vague = Robot().knowledge(strength_sigma=5e-6, inclination_sigma=0.05)
        assert grade_of(judge(estimate(figures=figures), KNOWN), "radius_misfit").grade is (
            Grade.WARN
        )
        verdict = judge(estimate(figures=figures), vague)
        assert verdict.quality is Grade.EXCELLENT
        words = grade_of(verdict, "radius_misfit").words
        larger = "the sensor reads the Earth's field larger than the reference by"
        assert words.startswith(f"{larger} 20% ± 26% (2σ)")
        small = judge(estimate(figures={"radius_ratio": 0.8}), vague)
        assert "smaller than the reference by 20%" in grade_of(small, "radius_misfit").words


class TestGravity:
    @pytest.mark.parametrize(
        ("size", "words"),
        [
            (1.0, "g published as m/s²; multiply by 9.80665"),
            (1000.0, "milli-g published as m/s²"),
            (7.5, "check the accelerometer's range and scale"),
            (12.0, "is not gravity's (9.81 m/s²)"),
        ],
    )
    def test_a_force_unlike_gravity_warns(self, size, words):
        force = np.zeros((50, 3))
        force[:, 2] = size
        verdict = judge(estimate(), KNOWN, window(force))
        assert verdict.quality is Grade.WARN
        assert words in verdict.summary

    @pytest.mark.parametrize(
        ("size", "grade"), [(9.7, Grade.EXCELLENT), (8.8, Grade.GOOD), (-9.81, Grade.EXCELLENT)]
    )
    def test_gravity_with_a_scale_error_passes(self, size, grade):
        verdict = judge(estimate(), KNOWN, window(np.full((50, 3), [0.0, 0.0, size])))
        assert grade_of(verdict, "gravity").grade is grade

    def test_without_samples_it_is_not_checked(self):
        assert "gravity" not in {check.figure for check in judge(estimate(), KNOWN).checks}


class TestNotShown:
    def test_the_yaw_of_the_installation_is_never_shown(self):
        assert NO_YAW in judge(estimate(), KNOWN).not_shown

    def test_without_a_gyro_distortion_is_not_shown(self):
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
    def test_without_strength_and_inclination_the_radius_is_not_shown(self, reference, complete):
        not_shown = judge(estimate(), Knowledge(reference)).not_shown
        assert (NO_REFERENCE in not_shown) == (not complete)
        assert LEVEL_ONLY not in not_shown
        not_shown = judge(estimate(figures=DRIVE), Knowledge(reference)).not_shown
        assert (LEVEL_ONLY in not_shown) == (not complete)

    def test_a_weak_level_field_is_judged_by_the_sigma_of_the_reference(self):
        figures = {"level_share": 0.89}
        assert grade_of(judge(estimate(figures=figures), KNOWN), "level_share").grade is Grade.WARN
        doubtful = replace(KNOWN.reference, strength=Belief(KNOWN.reference.strength.value, 1e-6))
        found = grade_of(judge(estimate(figures=figures), Knowledge(doubtful)), "level_share")
        assert found.grade is Grade.GOOD
        assert "share of the level field that reaches the sensor 89% ± 4% (2σ)" in found.words

    def test_an_unused_gyro_is_not_called_missing(self):
        one = window(np.full((50, 3), [0.0, 0.0, 9.81]))
        turning = Window(one.time, one.field, one.specific_force, np.full((50, 3), [0.0, 0.0, 0.4]))
        not_shown = judge(estimate(), KNOWN, turning).not_shown
        assert GYRO_UNUSED in not_shown
        assert NO_GYRO not in not_shown

    @pytest.mark.parametrize("known", [True, False])
    def test_a_given_reference_field_is_not_asked_for(self, known):
        covariance = np.zeros((12, 12))
        covariance[11, 11] = (3e-6) ** 2
        bad = estimate(figures={"heading_sigma": math.radians(2.5)}, covariance=covariance)
        verdict = judge(bad, KNOWN if known else Knowledge())
        reported = " ".join([grade_of(verdict, "heading_sigma").words, *verdict.not_shown])
        assert ("give the reference field" in reported) == (not known)

    def test_an_uncertain_axial_hard_iron_is_named_with_its_effect(self):
        covariance = np.zeros((12, 12))
        covariance[9:, 9:] = np.diag([0.05e-6, 0.05e-6, 5e-6]) ** 2
        not_shown = judge(estimate(covariance=covariance), KNOWN).not_shown
        words = [text for text in not_shown if "along the turn's axis" in text]
        # 5 µT * sin 10° / 25 µT / sqrt 2
        assert len(words) == 1
        assert "at 10° of tilt its error in the heading is 1.4° (1σ)" in words[0]

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

    def test_the_sentence_ends_with_one_period(self):
        assert refuse(Refusal(Reason.PLANAR, "It is flat.")).summary == "Refused: It is flat."

    def test_dots_inside_the_words_are_kept(self):
        verdict = refuse(Refusal(Reason.PLANAR, "see ../notes... and turn."))
        assert verdict.summary == "Refused: see ../notes... and turn."


@pytest.mark.parametrize(("figure", "grade"), [(0.0, Grade.EXCELLENT), (1.0, Grade.WARN)])
def test_an_optimisation_without_convergence_gives_a_warning(figure, grade):
    verdict = judge(estimate(figures={Figure.NOT_CONVERGED: figure}), KNOWN)
    check = next(check for check in verdict.checks if check.figure is Figure.NOT_CONVERGED)
    assert check.grade is grade
    assert ("did not converge" in verdict.summary) is (grade is Grade.WARN)


def test_convergence_is_not_checked_without_iterations():
    figures = {check.figure for check in judge(estimate(), KNOWN).checks}
    assert Figure.NOT_CONVERGED not in figures


@pytest.mark.parametrize(
    ("value", "words"), [(2.003, "2.003"), (2.4, "2.4"), (2.0000004, "2.0000004")]
)
def test_a_narrowly_missed_bound_is_not_shown_as_met(value, words):
    bound = Bound(Figure.STRENGTH_OFFSET, (None, 2.0, 8.0), "off by", "look", unit="%")
    check = bound.check(value / bound.scale)
    assert check.words.startswith(f"off by {words}%")
    assert "(want 2% or less)" in check.words
