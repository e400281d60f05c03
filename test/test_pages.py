"""What README and doc/ say can be followed: links lead somewhere, lines work as typed."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from magcal_ros.core.simulation.simulator import Robot, measure, turn

CHECKOUT = Path(__file__).resolve().parents[1]
PAGES = [CHECKOUT / "README.md", *sorted((CHECKOUT / "doc").glob("*.md"))]
every_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)

SET_UP = (CHECKOUT / "setup.py").read_text()
TARGETS = set(re.findall(r"(?m)^([a-z]+):", (CHECKOUT / "Makefile").read_text()))
PARAMETERS = (CHECKOUT / "config" / "calibrator.yaml").read_text()


def anchors(page):
    """Return the anchors that a page offers, as the usual viewers make them of headings."""
    headings = re.findall(r"(?m)^#+ (.+)$", page.read_text())
    return {
        re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings
    }


def blocks(page, *languages):
    """Return the fenced blocks of some languages."""
    fenced = re.findall(r"(?ms)^ *```(\w*)\n(.*?)^ *```$", page.read_text())
    return [text for language, text in fenced if language in languages]


def shell_lines(page):
    """Return what a reader types."""
    lines = "\n".join(blocks(page, "", "sh")).replace("\\\n", " ").splitlines()
    return [line.partition("#")[0].strip() for line in lines if line.partition("#")[0].strip()]


@every_page
def test_every_link_leads_to_something_that_is_there(page):
    links = re.findall(r"\]\(([^)\s]+)\)", page.read_text())
    for link in links:
        if link.startswith(("http://", "https://")):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), f"{page.name} links to {link}"
        if anchor:
            assert anchor in anchors(target), f"{page.name} links to {link}"


def test_every_page_is_linked_from_the_first():
    readme = PAGES[0].read_text()
    assert [page.name for page in PAGES[1:] if f"(doc/{page.name})" not in readme] == []


def test_the_readme_is_read_in_three_minutes():
    assert len(PAGES[0].read_text().split()) < 900


@every_page
def test_shell_lines_name_what_there_is(page):
    for line in shell_lines(page):
        words = shlex.split(line)
        if words[0] == "make":
            assert set(words[1:]) <= TARGETS, line
        if words[:3] != ["ros2", "run", "magcal_ros"]:
            continue
        assert f'"{words[3]} = ' in SET_UP, line
        for name in re.findall(r"-p ([\w.]+):=", line):
            *rooms, leaf = name.split(".")
            assert all(re.search(rf"\b{word}:", PARAMETERS) for word in (*rooms, leaf)), line


@every_page
def test_python_blocks_run(page):
    robot = Robot(strength=48e-6, inclination=1.13)
    window = measure(robot, turn(), np.random.default_rng(1))
    for block in blocks(page, "python"):
        samples = {
            "time": window.time,
            "field": window.field,
            "specific_force": window.specific_force,
            "angular_rate": None,
        }
        exec(compile(block, page.name, "exec"), samples)
        strength = np.linalg.norm(samples["field_body"], axis=1).mean()
        assert strength == pytest.approx(48e-6, rel=0.02)


def test_nothing_is_said_twice():
    seen = {}
    for page in PAGES:
        for paragraph in page.read_text().split("\n\n"):
            if len(paragraph.split()) > 12:
                assert paragraph not in seen, f"{page.name} repeats {seen[paragraph]}: {paragraph}"
                seen[paragraph] = page.name
