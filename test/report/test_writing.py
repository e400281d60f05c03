import re
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from long_form import first_of
from subjects import CREATED, good, refused

from magcal_ros.core import Window, calibrate
from magcal_ros.files import FileError, read_samples, write_samples
from magcal_ros.report import new_folder, write_report
from magcal_ros.report.page import recipe


@pytest.fixture
def no_pictures(monkeypatch):
    """Draw no pictures, as where matplotlib is missing."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)


def same(one, other):
    rates = [window.angular_rate for window in (one, other) if window.angular_rate is not None]
    return (
        np.array_equal(one.time, other.time)
        and np.array_equal(one.field, other.field)
        and np.array_equal(one.specific_force, other.specific_force)
        and (not rates or np.array_equal(*rates))
    )


def test_folders_are_dated_and_never_shared(tmp_path):
    parent = tmp_path / "not" / "there" / "yet"
    folders = [new_folder(parent, CREATED) for _ in range(3)]
    names = ["2024-05-31_14-03-07", "2024-05-31_14-03-07-2", "2024-05-31_14-03-07-3"]
    assert [folder.name for folder in folders] == names
    assert all(folder.is_dir() for folder in folders)


def test_folders_created_at_the_same_time_differ(tmp_path):
    found = []
    threads = [
        threading.Thread(target=lambda: found.append(new_folder(tmp_path, CREATED)))
        for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(found)) == 8


def test_a_folder_that_cannot_be_made_is_explained(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="writable folder"):
        new_folder(tmp_path / "file", CREATED)


def test_a_report_is_never_overwritten(no_pictures, tmp_path):
    page = write_report(tmp_path, good())
    before = page.read_bytes(), (tmp_path / "samples.csv").read_bytes()
    with pytest.raises(FileError, match="exists already"):
        write_report(tmp_path, refused())
    assert (page.read_bytes(), (tmp_path / "samples.csv").read_bytes()) == before


def test_existing_samples_are_not_overwritten(tmp_path):
    samples = tmp_path / "samples.csv"
    samples.write_text("somebody's own")
    with pytest.raises(FileError, match="exists already"):
        write_report(tmp_path, good())
    assert samples.read_text() == "somebody's own"
    assert not (tmp_path / "report.html").exists()


@pytest.mark.nightly
def test_reports_from_several_threads(tmp_path):
    pages = []

    def work():
        pages.append(write_report(new_folder(tmp_path, CREATED), refused()).read_text())

    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(pages) == 2
    # The matplotlib of Ubuntu 22.04 names clip paths by their place in memory.
    assert len({re.sub(r"-p[0-9a-f]{10}\b", "", page) for page in pages}) == 1


def test_only_page_and_samples_are_left(no_pictures, tmp_path):
    write_report(tmp_path, good())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.html", "samples.csv"]


@pytest.mark.nightly
@pytest.mark.parametrize("gyro", first_of([True, False]))
def test_the_fit_repeats_exactly_from_the_samples(no_pictures, tmp_path, gyro):
    subject = good(gyro)
    write_report(tmp_path, subject)
    window = read_samples(tmp_path / "samples.csv")
    assert same(window, subject.window)
    again = calibrate(window, subject.knowledge, subject.method)
    assert again.verdict == subject.outcome.verdict
    found, before = again.estimate, subject.outcome.estimate
    assert np.array_equal(found.correction.parameters, before.correction.parameters)
    assert np.array_equal(found.covariance, before.covariance)


def test_the_recipe_on_the_page_repeats_the_fit(no_pictures, tmp_path, monkeypatch, capsys):
    subject = good()
    write_report(tmp_path, subject)
    monkeypatch.chdir(tmp_path)
    exec(recipe(subject.knowledge, subject.method), {})
    assert capsys.readouterr().out.strip() == subject.outcome.verdict.summary


def test_the_header_names_units(tmp_path):
    write_samples(tmp_path / "s.csv", good().window)
    header = (tmp_path / "s.csv").read_text().splitlines()[0]
    assert header == (
        "t [s],mx [T],my [T],mz [T],ax [m/s^2],ay [m/s^2],az [m/s^2],"
        "gx [rad/s],gy [rad/s],gz [rad/s],believed [1/0]"
    )


def test_columns_may_come_in_any_order_without_units(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text("ax,ay,az,mx,my,mz,t\n1,2,3,4,5,6,7\n1,2,3,4,5,6,8\n")
    window = read_samples(path)
    assert same(window, Window([7, 8], [[4, 5, 6]] * 2, [[1, 2, 3]] * 2))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("t,mx,my\n1,2,3\n", "no column mz, ax, ay, az"),
        ("t,mx,my,mz,ax,ay,az\n1,2,3,4,5,6,north\n", "is damaged"),
        ("t,mx,my,mz,ax,ay,az\n1,2,3,4,5,6,nan\n", "is damaged"),
        ("t,mx,my,mz,ax,ay,az\n1,2,3,4,5,6,7\n1,2,3,4,5,6,7\n", "must increase"),
        ("", "no column"),
    ],
)
def test_a_bad_file_is_explained(tmp_path, text, reason):
    path = tmp_path / "s.csv"
    path.write_text(text)
    with pytest.raises(FileError, match=reason):
        read_samples(path)


def test_a_missing_file_is_explained():
    with pytest.raises(FileError, match="cannot read"):
        read_samples(Path("/nowhere/samples.csv"))


def test_an_empty_window_is_recovered(tmp_path):
    nothing = np.zeros((0, 3))
    window = Window(np.zeros(0), nothing, nothing)
    write_samples(tmp_path / "s.csv", window)
    assert len(read_samples(tmp_path / "s.csv")) == 0
