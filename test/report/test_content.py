import html
import math
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
from simulated.turns import measure, slope_rpy, turn
from subjects import ROBOT, good, refused, subject_of, troubled

from magcal_ros.core import Figure, Outcome, Window, calibrate_turns
from magcal_ros.core.assessment import DRIVE_BOUNDS, HEADING_BOUNDS, NO_YAW, TURN_BOUNDS, judge
from magcal_ros.core.multi_turn import joined
from magcal_ros.core.simulation import Robot
from magcal_ros.report import turn_views, write_report
from magcal_ros.report.page import figure_row

LARGEST_PAGE = 1_000_000
DRIVE_FIGURES = (
    *(bound.figure for bound in (*TURN_BOUNDS, *DRIVE_BOUNDS, *HEADING_BOUNDS)),
    Figure.LOCAL_SIGMA,
    Figure.DRIVING_TIME,
    Figure.METRES,
    Figure.STREET,
    Figure.LOCAL_FIELD,
    Figure.AXIAL_IRON,
)


PAGES = {}


def report_of(folder, subject):
    """The page on a subject; drawing takes long, so pages are kept."""
    if id(subject) not in PAGES:
        page = write_report(folder, subject).read_text(encoding="utf-8")
        PAGES[id(subject)] = subject, page
    return PAGES[id(subject)][1]


def text_of(folder, subject):
    """The page on a subject without its pictures."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setitem(sys.modules, "matplotlib", None)
        return write_report(folder, subject).read_text(encoding="utf-8")


def words_of(page):
    """The visible text, without style and tags."""
    body = page[page.index("<body>") :]
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", body)).split())


def names_of(page):
    return re.findall(r'<figure id="(\w+)">', page)


def test_the_report_has_the_verdict_and_what_was_not_shown(tmp_path):
    subject = good()
    words = words_of(report_of(tmp_path, subject))
    verdict = subject.outcome.verdict
    assert verdict.summary in words
    assert f"quality {verdict.quality.value}" in words
    assert f"confidence {verdict.confidence.value}" in words
    assert NO_YAW in words
    for item in (*verdict.not_shown, *(check.words for check in verdict.checks)):
        assert " ".join(item.split()) in words


def test_numbers_have_units(tmp_path):
    subject = good()
    words = words_of(report_of(tmp_path, subject))
    estimate = subject.outcome.estimate
    iron = estimate.correction.hard_iron[0] * 1e6
    assert re.search(rf"hard iron x \(±1σ\) {iron:.2f} ± \d+\.\d+ µT", words)
    assert f"installation roll {math.degrees(estimate.installation.roll):.2f}°" in words
    assert f"strength of the corrected field {1e6 * estimate.strength:.2f} µT" in words
    assert "reference inclination 60.00 ± 1.00°" in words
    assert "500 over 15.0 s" in words
    assert f"method {subject.method}" in words
    assert "numpy" in words


def test_every_figure_of_the_method_is_named(tmp_path):
    assert "(SI)" not in words_of(report_of(tmp_path, good()))


def driven():
    """The same samples, as those of a drive."""
    subject = good()
    of_a_drive = {"headings_driven": 12.0, "driving_time": 93.7, "street": 1.4e-6}
    of_a_drive |= {"local_field": 1.5e-6, "metres": 800.0}
    estimate = subject.outcome.estimate
    estimate = replace(estimate, figures={**estimate.figures, **of_a_drive})
    verdict = judge(estimate, subject.knowledge, subject.window)
    return replace(subject, outcome=replace(subject.outcome, estimate=estimate, verdict=verdict))


def test_a_drive_is_called_a_drive_and_its_figures_have_units(tmp_path):
    words = words_of(text_of(tmp_path, driven()))
    assert "(SI)" not in words
    for stated in (
        "headings driven 12 of 12",
        "length of the drive 93.7 s",
        "disturbance that changes with the place (1σ per axis) 1.4 µT",
        "heading error by the calibration, on level ground (1σ) ±",
        "heading error along the drive, on level ground (1σ) ±",
        "Not determined by this drive",
        "The drive was measured by the gyro",
    ):
        assert stated in words
    assert "measured arc" not in words


def test_every_graded_figure_has_a_unit():
    for figure in DRIVE_FIGURES:
        assert "(SI)" not in figure_row(figure, 1.0).value, figure


def test_an_unknown_figure_is_shown_in_si(tmp_path):
    subject = good()
    estimate = replace(subject.outcome.estimate, figures={"odd_thing": 0.25})
    outcome = replace(subject.outcome, estimate=estimate)
    words = words_of(text_of(tmp_path, replace(subject, outcome=outcome)))
    assert "odd thing 0.25 (SI)" in words


def test_four_pictures_with_captions(tmp_path):
    page = report_of(tmp_path, good())
    assert names_of(page) == ["views", "around", "heading", "gyro"]
    assert page.count("<svg") == page.count("<figcaption>") == 4
    for label in ("raw field", "corrected field", "ideal circle", "sphere: the field's strength"):
        assert f">{label}<" in page
    for unit in ("[µT]", "[°]"):
        assert unit in page


def test_the_words_in_the_ring_fit_into_its_hole(monkeypatch, tmp_path):
    pytest.importorskip("matplotlib")
    from matplotlib.figure import Figure

    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    monkeypatch.setattr(turn_views, "_inline", lambda *_: "")
    write_report(tmp_path, good())
    ring = next(axes for figure in drawn for axes in figure.axes if axes.name == "polar")
    ring.figure.canvas.draw()
    inside = ring.transData.inverted().transform(ring.texts[-1].get_window_extent().corners())
    assert inside[:, 1].max() < turn_views.HOLE


def test_ids_are_unique(tmp_path):
    found = re.findall(r'\bid="([^"]*)"', report_of(tmp_path, good()))
    assert len(found) == len(set(found))


def test_the_report_names_a_missing_gyro(tmp_path):
    subject = good()
    blind = replace(subject, window=replace(subject.window, angular_rate=None))
    assert "there was no gyro in these samples" in text_of(tmp_path, blind)


@pytest.mark.nightly
def test_without_a_gyro_there_are_three_pictures(tmp_path):
    assert report_of(tmp_path, good(gyro=False)).count("<svg") == 3


@pytest.mark.parametrize("make", first_of([good, refused, troubled], 2))
def test_the_report_is_small_and_has_no_external_references(tmp_path, make):
    page = report_of(tmp_path, make())
    assert len(page.encode()) < LARGEST_PAGE
    assert "://" not in page
    assert not re.search(r"\b(src|srcset|action|data|poster)\s*=", page)
    assert not re.findall(r'href="(?!#)', page)
    assert "@import" not in page
    assert "<script" not in page
    assert re.search(r"""http-equiv="Content-Security-Policy" content="default-src 'none';""", page)
    assert not re.findall(r"url\((?!#)", page)


@pytest.mark.parametrize(
    "place",
    [
        "source",
        *(
            pytest.param(place, marks=pytest.mark.nightly)
            for place in ("title", "magnetometer_frame", "imu_frame", "method")
        ),
    ],
)
def test_foreign_text_is_escaped(tmp_path, place):
    evil = "<script>alert('x')</script>\"&<img src=x>"
    # A page names the requested method if none gave a result.
    subject = refused() if place == "method" else good()
    page = text_of(tmp_path, replace(subject, **{place: evil}))
    assert "<script" not in page
    assert "<img" not in page
    assert "&lt;script&gt;" in page


def test_a_refusal_shows_the_raw_samples_and_the_reason(tmp_path):
    subject = refused()
    assert subject.outcome.estimate is None
    page = report_of(tmp_path, subject)
    words = words_of(page)
    assert subject.outcome.verdict.summary in words
    assert "quality refused" in words
    assert names_of(page) == ["views", "around"]
    assert page.count("<svg") == 2
    assert ">corrected field<" not in page
    text_of(tmp_path / "text", subject)
    assert (tmp_path / "text" / "samples.csv").read_text().count("\n") == 501


@pytest.mark.parametrize("samples", [0, 1, 2])
def test_hardly_any_samples_are_reported_too(tmp_path, samples):
    nothing = np.zeros((samples, 3))
    window = Window(np.arange(samples), nothing, nothing)
    words = words_of(text_of(tmp_path, subject_of(window, ROBOT.knowledge())))
    assert f"Only {samples} samples" in words


@pytest.mark.nightly
def test_pictures_are_drawn_even_of_zeros(tmp_path):
    nothing = np.zeros((30, 3))
    window = Window(np.arange(30), nothing, nothing, nothing)
    page = report_of(tmp_path, subject_of(window, ROBOT.knowledge()))
    assert page.count("<svg") == 2


def test_a_calibration_accepted_by_the_user_is_marked(tmp_path):
    subject = good()
    calibration = subject.outcome.calibration.accepted_by_person()
    outcome = replace(subject.outcome, calibration=calibration)
    words = words_of(text_of(tmp_path, replace(subject, outcome=outcome)))
    assert "The user put it in force against this verdict." in words


@pytest.mark.nightly
def test_an_estimate_without_calibration_is_enough(tmp_path):
    subject = good()
    outcome = Outcome(subject.outcome.verdict, None, subject.outcome.estimate)
    assert report_of(tmp_path, replace(subject, outcome=outcome)).count("<svg") == 4


def test_outliers_are_marked(tmp_path):
    subject = good()
    inliers = np.arange(500) % 10 > 0
    estimate = replace(subject.outcome.estimate, inliers=inliers)
    outcome = replace(subject.outcome, estimate=estimate)
    page = report_of(tmp_path, replace(subject, outcome=outcome))
    assert ">left out<" in page
    assert "450 of 500" in page
    lines = (tmp_path / "samples.csv").read_text().splitlines()[1:]
    assert [line[-1] == "1" for line in lines] == list(inliers)


@pytest.mark.nightly
def test_a_nominal_mounting_turns_the_raw_field_into_body_axes(tmp_path):
    robot = Robot(mounting=replace(ROBOT.mounting, pose=np.diag([1.0, -1.0, -1.0])))
    window = measure(robot, turn(samples=200), np.random.default_rng(5), gyro=True)
    assert report_of(tmp_path, subject_of(window, robot.knowledge())).count("<svg") == 4


def test_the_report_is_written_although_a_picture_fails(tmp_path, monkeypatch):
    from magcal_ros.report import turn_views

    def fail(*_):
        raise ZeroDivisionError("a <bug>")

    monkeypatch.setattr(turn_views, "_draw_solid", fail)
    page = write_report(tmp_path, good()).read_text(encoding="utf-8")
    assert page.count("<svg") == 3
    assert "drawing has failed (ZeroDivisionError: a &lt;bug&gt;)" in page


def test_without_matplotlib_the_report_is_still_written(tmp_path):
    page = text_of(tmp_path, good())
    words = words_of(page)
    assert "<svg" not in page
    assert "Install python3-matplotlib with apt" in words
    assert good().outcome.verdict.summary in words
    assert (tmp_path / "samples.csv").exists()


def test_matplotlib_is_imported_only_when_a_picture_is_drawn():
    code = (
        "import sys, magcal_ros.report, magcal_ros.files.recording\n"
        "assert not {'matplotlib', 'rclpy'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=240)


def test_pyplot_is_never_loaded(tmp_path):
    report_of(tmp_path, good())
    assert "matplotlib.pyplot" not in sys.modules


def test_a_page_is_written_with_all_warnings_at_once(tmp_path):
    subject = good()
    figures = {t.figure: 3.0 * t.good / t.scale for t in TURN_BOUNDS}
    estimate = replace(subject.outcome.estimate, figures=figures)
    verdict = judge(estimate, subject.knowledge)
    page = text_of(tmp_path, replace(subject, outcome=Outcome(verdict, None, estimate)))
    assert page.count('class="grade refused"') > 3


def test_joined_turns_have_a_section(tmp_path, monkeypatch):
    monkeypatch.setattr(joined, "wrong_axes", lambda *_: None)
    robot = replace(ROBOT, yaw=math.radians(5.0))
    rng = np.random.default_rng(1)
    starts = [slope_rpy(tilt, 0.0, 0.3) for tilt in (0.0, math.radians(10.0))]
    rides = [turn(samples=150, start_rpy=start) for start in starts]
    windows = [measure(robot, ride, rng, gyro=True) for ride in rides]
    names = ["<first>", "second", "copy"]
    knowledge = robot.knowledge(1e-6, math.radians(1.0))
    outcome = calibrate_turns([*windows, windows[0]], knowledge, names=names)
    subject = subject_of(windows[1], knowledge, outcome, method="maximum_likelihood")
    words = words_of(text_of(tmp_path, subject))
    assert "Joined turns" in words
    assert "it holds the same samples as <first>" in words
    assert outcome.multi_turn.advice_in_words in words
    assert "installation yaw (±1σ)" in words
    assert "all samples of the newest turn" in words


def test_the_yaw_of_the_imu_is_given_if_driving_determined_it(tmp_path):
    words = "the IMU's x points 4.1° ± 0.6° to the left of the vehicle's front, by course"
    assert words in words_of(text_of(tmp_path / "told", replace(good(), vehicle=words)))
    assert "in the vehicle" not in words_of(text_of(tmp_path / "untold", good()))
