"""What README and doc/ say can be followed: links lead somewhere, lines work as typed."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from magcal_ros.core.simulation.simulator import Robot, measure, turn

CHECKOUT = Path(__file__).resolve().parents[1]
PAGES = [CHECKOUT / "README.md", *sorted((CHECKOUT / "doc").rglob("*.md"))]
every_page = pytest.mark.parametrize(
    "page", PAGES, ids=lambda page: str(page.relative_to(CHECKOUT))
)

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


def test_every_page_is_linked_from_the_first_or_from_the_index_of_its_folder():
    for page in PAGES[1:]:
        folder = page.parent
        index = PAGES[0] if folder.name == "doc" else folder.with_suffix(".md")
        assert f"({folder.name}/{page.name})" in index.read_text()


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


LONGEST_SENTENCE, MEAN_SENTENCE = 40, 25.0

STILL_LONGER = {"estimator.md": 128}
"""Words of the longest sentence of pages that are not rewritten yet: only ever lower these."""

STILL_LONGER_ON_THE_MEAN = {"estimator.md": 27.0}


def prose_of(text):
    """Return a page without code, generated tables and the targets of links."""
    text = re.sub(r"(?ms)^ *```.*?^ *```$", "", text)
    text = re.sub(r"(?s)<!-- (\w+): .*?<!-- end of \1 -->", "", text)
    return re.sub(r"\]\([^)]*\)", "]", text)


def pieces_of(text):
    """Return headings, items, cells of tables and paragraphs, each by itself."""
    starts = r"(?m)^\s*(?:#+|[-*>]|\d+\.)\s+|(?<!\\)\||\n\s*\n|^(?=\s*\|)"
    return re.split(starts, prose_of(text))


def lengths_of_sentences(text):
    """Return the words of each sentence; what has three or fewer is a label."""
    ends = re.compile(r"(?<=[.!?…])[)\"*]*\s+(?=[A-Z`\"*(\[])")
    sentences = [sentence for piece in pieces_of(text) for sentence in ends.split(piece)]
    counts = [sum(bool(re.search(r"\w", word)) for word in each.split()) for each in sentences]
    return [count for count in counts if count > 3]


def test_sentences_are_counted_as_a_reader_would():
    text = "# A heading of five words\n\nOne two three four. `Five` six (seven) eight!\n"
    text += "- an item that\n  goes on\n- another item of five words\n\n| a cell of four | no |\n"
    assert lengths_of_sentences(text) == [5, 4, 4, 5, 5, 4]


@every_page
def test_sentences_are_short(page):
    lengths = lengths_of_sentences(page.read_text())
    assert max(lengths) <= STILL_LONGER.get(page.name, LONGEST_SENTENCE)
    mean = sum(lengths) / len(lengths)
    assert mean <= STILL_LONGER_ON_THE_MEAN.get(page.name, MEAN_SENTENCE)
