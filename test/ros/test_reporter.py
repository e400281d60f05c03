"""One report at a time, the newest next, and a limited number is kept."""

import threading
import time
from datetime import datetime, timedelta
from types import SimpleNamespace

import pytest
from support import wait_until

from magcal_ros.report import mark_in_force, new_folder, remove_old
from magcal_ros.report.write import IN_FORCE
from magcal_ros.ros import reporter as reporter_module
from magcal_ros.ros.reporter import Reporter

NOW = datetime(2026, 5, 31, 14, 3, 7)


class Draws:
    """Replaces the process that draws: the test ends each report."""

    def __init__(self):
        self.started, self.may_end = [], threading.Semaphore(0)

    def run_once(self, _, folder, __):
        self.started.append(folder)
        assert self.may_end.acquire(timeout=30.0)
        (folder / "report.html").write_text("drawn")

    def stop(self):
        pass


SENSOR = SimpleNamespace(topic="/mag", frame="mag")


@pytest.fixture(autouse=True)
def window_says_when(monkeypatch):
    """A report is of the second that stands in place of its window."""
    monkeypatch.setattr(
        "magcal_ros.report.Subject",
        lambda second, *_, **__: SimpleNamespace(created=NOW + timedelta(seconds=second)),
    )


def report(reporter, folder, second=0, accepted=False, kept=50):
    outcome = SimpleNamespace(verdict=SimpleNamespace(accepted=accepted))
    settings = SimpleNamespace(
        report_folder=str(folder), reports_kept=kept, knowledge=None, method=""
    )
    return reporter.report(second, settings, outcome)


def reporter_of(stated):
    log = SimpleNamespace(error=stated.append)
    node = SimpleNamespace(executor=None, get_logger=lambda: log)
    inputs, travel = SimpleNamespace(imu=SENSOR, field=SENSOR), SimpleNamespace(yaw=None)
    return Reporter(node, inputs, travel)


@pytest.fixture
def stated():
    return []


@pytest.fixture
def reporter(stated):
    reporter = reporter_of(stated)
    reporter._worker = Draws()
    return reporter


def test_of_forty_refusals_the_first_and_the_newest_are_drawn(tmp_path, stated, reporter):
    draws, thread = reporter._worker, reporter._thread
    for k in range(40):
        assert "Report: " in report(reporter, tmp_path, k)
        wait_until(lambda: draws.started)
    assert len(draws.started) == 1
    for _ in range(2):
        draws.may_end.release()
    assert thread.finish_within(30.0)
    thread.deliver()
    assert sorted(f.name for f in tmp_path.iterdir()) == [
        "2026-05-31_14-03-07",
        "2026-05-31_14-03-46",
    ]
    assert all((f / "report.html").exists() for f in tmp_path.iterdir())
    assert len(stated) == 38
    assert "there were newer turns before the report was written" in stated[0]
    draws.may_end.release()
    report(reporter, tmp_path, 50)
    assert thread.finish_within(30.0)
    assert len(draws.started) == 3


def test_a_report_that_hangs_is_ended_and_the_next_is_drawn(tmp_path, stated, monkeypatch):
    reporter = reporter_of(stated)
    run, thread = reporter._worker.run_once, reporter._thread
    for longest, work in ((1.0, (time.sleep, 600.0)), (30.0, (time.sleep, 0.0))):
        monkeypatch.setattr(reporter_module, "LONGEST", longest)
        monkeypatch.setattr(reporter._worker, "run_once", lambda *_, work=work: run(*work))
        report(reporter, tmp_path)
        assert thread.finish_within(30.0)
    thread.deliver()
    (words,) = stated
    assert "took more than 1 s and was ended" in words


def test_the_newest_and_those_put_in_force_are_kept(tmp_path, reporter):
    for k in range(8):
        reporter._worker.may_end.release()
        report(reporter, tmp_path, k, accepted=k in (0, 2), kept=3)
        if k == 1:
            reporter.put_in_force()
        assert reporter._thread.finish_within(30.0)
    kept = sorted(int(f.name[-2:]) - 7 for f in tmp_path.iterdir())
    assert kept == [0, 1, 2, 5, 6, 7]
    marked = sorted(int(f.name[-2:]) - 7 for f in tmp_path.iterdir() if (f / IN_FORCE).exists())
    assert marked == [0, 1, 2]


def test_files_of_other_programs_are_kept(tmp_path):
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
