"""The page in a real browser: nothing is fetched, nothing overflows, and it fits two sheets."""

import re
from dataclasses import replace

import numpy as np
import pytest
from browser import Browser, find_browser
from long_form import first_of
from subjects import good, refused, troubled

from magcal_ros.core import Outcome
from magcal_ros.core.assessment import TURN_BOUNDS, judge
from magcal_ros.report import write_report

PROGRAM = find_browser()
pytestmark = pytest.mark.skipif(
    PROGRAM is None, reason="no chromium, chromium-browser or google-chrome on PATH"
)


def wordy():
    """The longest report: every check fails, and the names are long."""
    subject = troubled()
    figures = dict(subject.outcome.estimate.figures)
    figures |= {t.figure: 3.0 * t.good / t.scale for t in TURN_BOUNDS}
    inliers = np.arange(len(subject.window)) % 20 > 0
    estimate = replace(subject.outcome.estimate, figures=figures, inliers=inliers)
    outcome = Outcome(judge(estimate, subject.knowledge), None, estimate)
    source = "/robot_seven/sensors/front/imu/data_raw, " * 3 + "/a" * 150
    return replace(subject, outcome=outcome, source=source)


CASES = {
    "good": (good, 4),
    "no gyro": (lambda: good(gyro=False), 3),
    "troubled": (troubled, 4),
    "wordy": (wordy, 4),
    "refused": (refused, 2),
}


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    opened = Browser(PROGRAM, tmp_path_factory.mktemp("profile"))
    yield opened
    opened.close()


@pytest.fixture(
    scope="module", params=first_of(["refused", "wordy", "good", "no gyro", "troubled"])
)
def page(request, browser, tmp_path_factory):
    make, pictures = CASES[request.param]
    path = write_report(tmp_path_factory.mktemp("report"), make())
    browser.set_width(1200)
    browser.open(path)
    return path, pictures


def test_the_page_loads_nothing_else(page, browser):
    path, _ = page
    assert browser.requests == [path.as_uri()]
    assert browser.complaints == []


def test_every_picture_has_a_size(page, browser):
    _, pictures = page
    script = (
        "[...document.querySelectorAll('figure svg')].map(s => s.getBoundingClientRect().width)"
    )
    for width in (390, 1200):
        browser.set_width(width)
        sizes = browser.evaluate(script)
        assert len(sizes) == pictures
        assert min(sizes) > 0.75 * (width if width < 760 else 440)


@pytest.mark.parametrize("width", [320, 390, 1200])
def test_nothing_overflows_horizontally(page, browser, width):
    browser.set_width(width, phone=width < 760)
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    # What may be wider than the screen scrolls by itself; everything else ends before the edge.
    script = f"""[...document.querySelectorAll('body *:not(svg *)')]
        .filter(e => !e.closest('.scroll, pre') && e.getBoundingClientRect().right > {width})
        .map(e => e.outerHTML.slice(0, 80))"""
    assert browser.evaluate(script) == []


def test_the_text_is_readable_on_a_phone(page, browser):
    browser.set_width(390, phone=True)
    script = """Math.min(...[...document.querySelectorAll('figure svg text')].map(t => {
        const m = t.getScreenCTM();
        return parseFloat(getComputedStyle(t).fontSize) * Math.hypot(m.a, m.b); }))"""
    assert browser.evaluate(script) > 7.5


def test_a_screenshot_is_taken_at_both_widths(page, browser):
    for width in (390, 1200):
        browser.set_width(width)
        assert browser.screenshot().startswith(b"\x89PNG")


def test_it_prints_on_two_pages_at_most(page, browser):
    pages = re.findall(rb"/Type\s*/Page\b(?!s)", browser.pdf())
    assert 1 <= len(pages) <= 2


def test_no_script_runs_on_the_page(page, browser, tmp_path):
    """Even if escaping failed, the page's own policy would stop what slipped through."""
    path, _ = page
    text = path.read_text(encoding="utf-8")
    broken = tmp_path / "broken.html"
    broken.write_text(text.replace("</body>", "<script>document.title = 'ran'</script></body>"))
    browser.open(broken)
    assert browser.evaluate("document.title") == "Compass calibration"
    assert "Content Security Policy" in " ".join(browser.complaints)
