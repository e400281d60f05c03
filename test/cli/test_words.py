"""How the commands print: wrapped on a terminal, whole lines elsewhere, in a command's words."""

import io
import json

import pytest

from magcal_ros.cli.check import _words
from magcal_ros.cli.common import tell, with_options, wrapped
from magcal_ros.cli.live_view import status_of, with_all_reasons
from magcal_ros.cli.main import main
from magcal_ros.core import METHODS, Grade, Recheck, Verdict
from magcal_ros.core.assessment import Aspect
from magcal_ros.core.monitoring import RECHECK_BOUNDS, check_beside_chance

PROSE = "turn once more, more slowly or on other ground, away from iron"


@pytest.mark.parametrize(
    ("begin", "column"),
    [("", 0), ("  - ", 4), ("  ok    field: unit    ", 23), ("   12 s  put in force: ", 9)],
)
def test_long_lines_are_broken_below_their_last_column(begin, column):
    lines = wrapped(begin + PROSE, 50).splitlines()
    assert len(lines) > 1
    assert lines[0].startswith(begin)
    assert all(len(line) <= 50 for line in lines)
    assert all(len(line) - len(line.lstrip()) == column for line in lines[1:])
    assert " ".join(line.strip() for line in lines).split() == (begin + PROSE).split()


@pytest.mark.parametrize(
    "line", ["  - /a/path/that/is/longer/than/a/terminal/is/wide", "  hard iron x   -19.66  µT", ""]
)
def test_paths_and_short_lines_stay_whole(line):
    assert wrapped(line, 30) == line


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(("out", "lines"), [(Terminal(), 4), (io.StringIO(), 1)])
def test_a_terminal_gets_its_width_and_a_script_whole_lines(monkeypatch, out, lines):
    monkeypatch.setenv("COLUMNS", "50")
    tell("word " * 40, out)
    assert out.getvalue().count("\n") == lines


@pytest.mark.parametrize(
    ("words", "printed"),
    [
        ("check reference.strength_ut,", "check --reference-strength-ut,"),
        ("and inclination_deg or", "and --reference-inclination-deg or"),
        ("with mount_rpy_deg", "with --mount-rpy-deg"),
        ("reference.latitude_deg and longitude_deg", "--latitude and --longitude"),
        (
            "(NED): set `mount_rpy_deg: [180.0, 0.0, -90.0]`; or",
            "(NED): repeat with `--mount-rpy-deg 180 0 -90`; or",
        ),
        ("residual_percent", "residual_percent"),
    ],
)
def test_a_command_names_its_options(words, printed):
    assert with_options(words) == printed


def recheck(*chances):
    """A recheck of one figure of 8° of which chance may be so many degrees, each."""
    bound = RECHECK_BOUNDS[0]
    graded = [check_beside_chance(bound, 8.0 / bound.scale, c / bound.scale) for c in chances]
    assert all(each.aspect is Aspect.QUALITY for each in graded)
    return Recheck(Verdict(tuple(graded), (), ""), None)


def test_uncertain_findings_are_listed_separately():
    out = _words(recheck(0.0, 9.0), [])
    stale, uncertain = out.partition("Too uncertain to judge:")[::2]
    words = (
        "  - the calibration makes the heading swing by 8° (doubtful beyond 4°, stale beyond 7°)"
    )
    assert stale.count(words) == 1
    assert "8°, no more than chance explains: too uncertain to judge; turn once" in uncertain
    rows = [line.split()[-1] for line in stale.splitlines() if " ≤ 4° " in line]
    assert rows == ["stale", "unclear"]


def test_a_recording_that_shows_nothing_is_no_verdict():
    result = recheck(9.0)
    assert not result.is_judged
    assert _words(result, []).startswith("This recording does not show whether")
    assert recheck(0.0).is_judged
    assert recheck(0.0).verdict.quality is Grade.REFUSED


STATUS = {"summary": "A. But b; and 1 more.", "headline": "A.", "against": ["b", "c"]}


def test_the_answer_of_a_turn_names_every_reason():
    status = {"verdict": STATUS | {"accepted": True}}
    reported = with_all_reasons("timed out; A. But b; and 1 more. It is saved.", status)
    assert reported == "timed out; A.\n\nBut:\n  - b\n  - c\n\nIt is saved."


@pytest.mark.parametrize(
    "text", ["no json", "{}", "7", json.dumps({"verdict": STATUS | {"summary": "another"}})]
)
def test_an_answer_without_a_status_is_unchanged(text):
    reported = with_all_reasons("A. But b; and 1 more.", status_of(text))
    assert reported == "A. But b; and 1 more."


@pytest.mark.parametrize("name", ["fit", "drive", "check", "doctor", "calibrate", "export", "demo"])
def test_the_help_of_a_command_fits_a_terminal(monkeypatch, capsys, name):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        main([name, "--help"])
    printed = capsys.readouterr().out
    assert [line for line in printed.splitlines() if len(line) > 80] == []


def test_the_help_of_fit_names_every_method(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        main(["fit", "--help"])
    printed = " ".join(capsys.readouterr().out.split())
    assert ", ".join(METHODS) in printed


def test_the_help_of_drive_explains_the_decisions(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        main(["drive", "--help"])
    reported = " ".join(capsys.readouterr().out.split())
    assert "as with `self_calibration: apply`; the node's default, `propose`, waits for" in reported
