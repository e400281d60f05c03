"""One report at a time, the newest waiting, and only so many of them kept."""

import signal
import subprocess
import threading
from datetime import datetime, timedelta
from types import SimpleNamespace

import pytest
from support import wait_until

from magcal_ros.report import mark_in_force, new_folder, remove_old
from magcal_ros.report.write import IN_FORCE
from magcal_ros.ros import reporter as reporter_module
from magcal_ros.ros.reporter import Reporter

NOW = datetime(2026, 5, 31, 14, 3, 7)


class Drawing:
    """Stands for the process that draws: it ends when the test says so."""

    def __init__(self, folder):
        self.folder, self.may_end, self.returncode = folder, threading.Event(), 0

    def communicate(self, timeout):
        assert self.may_end.wait(timeout)
        (self.folder / "report.html").write_text("drawn")
        return b"", b""


class Draws:
    def __init__(self):
        self.started = []

    def __call__(self, folder, subject):
        self.started.append(Drawing(folder))
        return self.started[-1]

    def wait_for(self, count):
        for _ in range(1000):
            if len(self.started) == count:
                return
            threading.Event().wait(0.01)
        raise AssertionError(f"{len(self.started)} reports were started, not {count}")


def subject(second=0, accepted=False):
    outcome = SimpleNamespace(verdict=SimpleNamespace(accepted=accepted))
    return SimpleNamespace(created=NOW + timedelta(seconds=second), outcome=outcome)


@pytest.fixture
def draws():
    return Draws()


@pytest.fixture
def said():
    return []


def test_forty_refusals_in_a_row_start_one_process_and_the_newest_waits(tmp_path, draws, said):
    reporter = Reporter(said.append, draws)
    for k in range(40):
        assert "Report: " in reporter.begin(str(tmp_path), subject(k), 50)
    assert len(draws.started) == 1
    draws.started[0].may_end.set()
    draws.wait_for(2)
    draws.started[1].may_end.set()
    for _ in range(1000):
        if not reporter._drawing:
            break
        threading.Event().wait(0.01)
    assert sorted(f.name for f in tmp_path.iterdir()) == [
        "2026-05-31_14-03-07",
        "2026-05-31_14-03-46",
    ]
    assert all((f / "report.html").exists() for f in tmp_path.iterdir())
    assert len(said) == 38
    reporter.begin(str(tmp_path), subject(50), 50)
    draws.wait_for(3)
    draws.started[2].may_end.set()


def test_a_report_that_hangs_is_ended_and_the_next_is_drawn(tmp_path, said, monkeypatch):
    monkeypatch.setattr(reporter_module, "LONGEST", 1.0)
    processes = []

    def draw(*_):
        command = ["true"] if processes else ["sleep", "600"]
        processes.append(subprocess.Popen(command, stderr=subprocess.PIPE))
        return processes[-1]

    reporter = Reporter(said.append, draw)
    for k in range(2):
        reporter.begin(str(tmp_path), subject(k), 50)
    wait_until(lambda: len(processes) == 2 and not reporter._drawing)
    assert [process.returncode for process in processes] == [-signal.SIGKILL, 0]
    (words,) = said
    assert "was not done after 1 s, and the node has ended it" in words


def test_the_newest_are_kept_and_those_put_in_force(tmp_path, draws, said):
    reporter = Reporter(said.append, draws)
    for k in range(8):
        reporter.begin(str(tmp_path), subject(k, accepted=k in (0, 2)), 3)
        if k == 1:
            reporter.put_in_force()
        draws.started[-1].may_end.set()
        for _ in range(1000):
            if not reporter._drawing:
                break
            threading.Event().wait(0.01)
    kept = sorted(int(f.name[-2:]) - 7 for f in tmp_path.iterdir())
    assert kept == [0, 1, 2, 5, 6, 7]
    marked = sorted(int(f.name[-2:]) - 7 for f in tmp_path.iterdir() if (f / IN_FORCE).exists())
    assert marked == [0, 1, 2]


def test_what_others_keep_there_stays(tmp_path):
    for _ in range(12):
        folder = new_folder(tmp_path, NOW)
        (folder / "report.html").write_text("x")
    with_notes = new_folder(tmp_path, NOW - timedelta(days=1))
    (with_notes / "notes.txt").write_text("mine")
    (with_notes / "report.html").write_text("x")
    in_force = new_folder(tmp_path, NOW - timedelta(days=2))
    mark_in_force(in_force)
    elsewhere = tmp_path / "photographs"
    elsewhere.mkdir()
    link = tmp_path / "2020-01-01_00-00-00"
    link.symlink_to(elsewhere)
    (tmp_path / "2020-01-01_00-00-01").write_text("a file")
    theirs = tmp_path / "2020-01-01_00-00-02"
    theirs.mkdir()
    for name in ("report.html", "samples.csv"):
        (theirs / name).write_text("mine")
    remove_old(tmp_path, 2)
    assert sorted(file.name for file in theirs.iterdir()) == ["report.html", "samples.csv"]
    assert (with_notes / "notes.txt").read_text() == "mine"
    assert in_force.exists()
    assert elsewhere.is_dir()
    assert link.is_symlink()
    names = [f.name for f in tmp_path.iterdir() if f.name.startswith("2026-05-31")]
    assert sorted(names) == ["2026-05-31_14-03-07-11", "2026-05-31_14-03-07-12"]
