"""README and doc/ can be followed: links exist, and commands work as written."""

import re
import runpy
import shlex
from pathlib import Path

import numpy as np
import pytest
from long_form import first_of
from simulated.turns import measure, turn

from magcal_ros.core.simulation import Robot

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
    fenced = re.findall(r"(?ms)^ *```([{}\w]*)\n(.*?)^ *```$", page.read_text())
    return [text for language, text in fenced if language in languages]


def shell_lines(page):
    """Return the commands that a reader types."""
    lines = "\n".join(blocks(page, "", "sh")).replace("\\\n", " ").splitlines()
    return [line.partition("#")[0].strip() for line in lines if line.partition("#")[0].strip()]


@every_page
def test_every_link_has_a_target(page):
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
        if page.name == "index.md":
            continue
        folder = page.parent
        index = PAGES[0] if folder.name == "doc" else folder.with_suffix(".md")
        assert f"({folder.name}/{page.name})" in index.read_text()


def test_pictures_are_small_and_shown():
    shown = "".join(page.read_text() for page in PAGES)
    pictures = list((CHECKOUT / "doc").rglob("*.png"))
    assert pictures
    for picture in pictures:
        assert picture.stat().st_size < 150_000
        assert f"pictures/{picture.name})" in shown


@pytest.mark.nightly
@pytest.mark.parametrize("name", first_of(["doctor_80", "report", "drive"], 2))
def test_pictures_have_the_words_of_today(monkeypatch, tmp_path, name):
    """If not: `make pictures`."""
    image = pytest.importorskip("PIL.Image", reason="needs Pillow, which matplotlib brings along")
    monkeypatch.chdir(tmp_path)
    pictures = runpy.run_path(str(CHECKOUT / "doc" / "pictures.py"))
    held = image.open(CHECKOUT / "doc" / "pictures" / f"{name}.png").text
    assert pictures["words_in"](pictures["page_of"](name)).split() == held["words"].split()


def test_the_site_has_every_page():
    index = CHECKOUT / "doc" / "index.md"
    named = re.findall(r"(?m)^([\w/]+)$", "".join(blocks(index, "{toctree}")))
    pages = {str(page.relative_to(index.parent).with_suffix("")) for page in PAGES[1:]}
    assert sorted(named) == sorted(pages - {"index"})
    settings = runpy.run_path(str(index.with_name("conf.py")))
    assert "myst_parser" in settings["extensions"]


def test_the_files_named_by_architecture_exist():
    text = (CHECKOUT / "doc" / "architecture.md").read_text()
    named = re.findall(r"`((?:core|ros|files|report|cli)/[\w/]+\.py)`", text)
    assert len(named) > 25
    assert [name for name in named if not (CHECKOUT / "magcal_ros" / name).is_file()] == []


def test_the_readme_is_read_in_three_minutes():
    assert len(PAGES[0].read_text().split()) < 900


@every_page
def test_shell_lines_name_existing_commands_and_options(page):
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
        if "generate_launch_description" in block:
            continue  # test_launch.py runs these
        samples = {
            "time": window.time,
            "field": window.field,
            "specific_force": window.specific_force,
            "angular_rate": None,
        }
        exec(compile(block, page.name, "exec"), samples)
        strength = np.linalg.norm(samples["field_body"], axis=1).mean()
        assert strength == pytest.approx(48e-6, rel=0.02)


def test_no_sentence_is_repeated():
    seen = {}
    for page in PAGES:
        for paragraph in page.read_text().split("\n\n"):
            if len(paragraph.split()) > 12:
                assert paragraph not in seen, f"{page.name} repeats {seen[paragraph]}: {paragraph}"
                seen[paragraph] = page.name


LONGEST_SENTENCE, MEAN_SENTENCE = 40, 25.0


def prose_of(text):
    """Return a page without code, generated tables and the targets of links."""
    text = re.sub(r"(?ms)^ *```.*?^ *```$", "", text)
    text = re.sub(r"(?s)<!-- (\w+): .*?<!-- end of \1 -->", "", text)
    return re.sub(r"\]\([^)]*\)", "]", text)


def pieces_of(text):
    """Return headings, items, cells of tables and paragraphs, each by itself."""
    rows = re.sub(
        r"(?m)^\s*\|.*$", lambda row: re.sub(r"(?<!\\)\|", "\n\n", row[0]) + "\n", prose_of(text)
    )
    return re.split(r"(?m)^\s*(?:#+|[-*>]|\d+\.)\s+|\n\s*\n", rows)


def sentences_of(text):
    """Return the sentences of a page; what has three words or fewer is a label."""
    ends = re.compile(r"(?<=[.!?…])[)\"*]*\s+(?=[A-Z`\"*(\[])")
    sentences = [sentence for piece in pieces_of(text) for sentence in ends.split(piece)]
    return [sentence for sentence in sentences if words_of(sentence) > 3]


def words_of(sentence):
    """Return how many words a sentence has."""
    return sum(bool(re.search(r"\w", word)) for word in sentence.split())


def test_sentences_are_counted_as_a_reader_would():
    text = "# A heading of five words\n\nOne two three four. `Five` six (seven) eight!\n"
    text += "- an item that\n  goes on\n- another item of five words\n\n| a cell of four | no |\n"
    assert [words_of(each) for each in sentences_of(text)] == [5, 4, 4, 5, 5, 4]


def test_a_long_sentence_is_found_across_lines_links_and_formulas():
    line = "one two, three; four: five [six](seven.md) $|e|$ `nine. ten`"
    text = f"It is.\n\n{line}\n{line}\n\n```\nnot this\n```\n\n| a cell of four | no |\n"
    assert [words_of(each) for each in sentences_of(text)] == [18, 4]


@every_page
def test_sentences_are_short(page):
    sentences = sentences_of(page.read_text())
    assert [each for each in sentences if words_of(each) > LONGEST_SENTENCE] == []
    assert sum(map(words_of, sentences)) / len(sentences) <= MEAN_SENTENCE


def test_each_question_is_answered_by_three_sentences_and_a_command():
    page = (CHECKOUT / "doc" / "questions.md").read_text()
    for section in page.split("\n## ")[1:]:
        title, _, rest = section.partition("\n\n")
        answer, fence, _ = rest.partition("```")
        assert fence, title
        assert len(sentences_of(answer)) <= 3, title
