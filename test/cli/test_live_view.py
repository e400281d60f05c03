"""The live view of a turn, on a terminal and in a log."""

import io
import re
import sys

import pytest

from magcal_ros.cli.live_view import Panel, ProgressLines, advice, best_view, line, ring

PROGRESS = {
    "stage": "collecting",
    "arc_deg": 90.0,
    "filled": "#" * 9 + "." * 27,
    "advice": "turn left",
    "samples": 50,
    "elapsed_s": 3.2,
    "turn_rate_deg_s": 20.0,
    "heading_sigma_deg": None,
}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, "turn left"),
        ({"advice": ""}, "until the heading is certain"),
        ({"turn_rate_deg_s": -60.0}, "slower"),
        ({"turn_rate_deg_s": 3.0}, "faster"),
        ({"turn_rate_deg_s": 0.0}, "turn left"),
        ({"stage": "complete"}, "you can stop"),
    ],
)
def test_the_advice_is_for_the_present_state(change, words):
    assert words in advice(PROGRESS | change)


def test_measured_headings_are_left_of_the_start_on_the_ring():
    rows = ring(PROGRESS["filled"])
    assert "".join(rows).count("#") >= 7
    middle = len(rows[0]) // 2
    for number, row in enumerate(rows):
        for column, mark in enumerate(row):
            is_upper_left = column <= middle and number <= len(rows) // 2
            assert mark != "#" or is_upper_left
    assert set("".join(ring("#" * 36))) == {"#", " "}


def test_a_log_gets_a_line_a_second_while_something_changes(capsys):
    with ProgressLines() as view:
        for elapsed, sigma in ((3.2, 0.31), (3.4, 0.3), (3.9, 0.3), (4.1, 0.3), (5.2, 0.3)):
            view.show(PROGRESS | {"elapsed_s": elapsed, "heading_sigma_deg": sigma})
    printed = capsys.readouterr().out.splitlines()
    assert printed == [line(PROGRESS | {"heading_sigma_deg": sigma}) for sigma in (0.31, 0.3)]
    assert "±0.31°" in printed[0]


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_terminal_gets_a_panel(monkeypatch):
    pytest.importorskip("rich")
    screen = Terminal()
    monkeypatch.setattr(sys, "stdout", screen)
    monkeypatch.setenv("TERM", "xterm")
    view = best_view()
    assert isinstance(view, Panel)
    with view:
        view.show(PROGRESS)
        view.show(PROGRESS | {"heading_sigma_deg": 0.31})
    shown = screen.getvalue()
    for words in ("one turn", "90° of the turn measured", "±0.31°", "turn left", "Ctrl-C cancels"):
        assert words in shown


@pytest.mark.parametrize("columns", [80, 120])
def test_no_line_is_wider_than_the_terminal(monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("TERM", "xterm")
    wide = PROGRESS | {"arc_deg": 359.0, "samples": 12345, "advice": "", "heading_sigma_deg": 0.5}
    for kind in (ProgressLines, Panel):
        monkeypatch.setattr(sys, "stdout", Terminal())
        try:
            view = kind()
        except ImportError:
            continue
        with view:
            view.show(wide)
        shown = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", sys.stdout.getvalue())
        assert max(len(row) for row in re.split(r"[\r\n]+", shown)) <= columns


def test_without_rich_a_terminal_gets_lines(monkeypatch):
    monkeypatch.setattr(sys, "stdout", Terminal())
    monkeypatch.setitem(sys.modules, "rich.live", None)
    assert isinstance(best_view(), ProgressLines)
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    assert isinstance(best_view(), ProgressLines)
