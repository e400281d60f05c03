"""Previous contents of a calibration file are kept, and no other file is changed."""

import os
from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
from simulated.turns import measure, turn

from magcal_ros.core import calibrate
from magcal_ros.core.simulation import Robot
from magcal_ros.files import (
    FileError,
    Origin,
    backup_files,
    keep_backup,
    read_calibration,
    write_calibration,
)

pytestmark = pytest.mark.faults

ORIGIN = Origin.now("mag_link", "imu_link")


@pytest.fixture(scope="module")
def found():
    robot = Robot()
    window = measure(robot, turn(), np.random.default_rng(3))
    return calibrate(window, robot.knowledge()).calibration


@pytest.fixture
def path(tmp_path):
    return tmp_path / "mag.yaml"


@pytest.fixture
def irons(path, found):
    """Return a function that saves a calibration with a hard iron like the node."""

    def save(microtesla):
        correction = replace(found.correction, hard_iron=[microtesla * 1e-6, 0.0, 0.0])
        calibration = replace(found, correction=correction)
        write_calibration(path, calibration, ORIGIN, lambda: keep_backup(path, calibration))

    return save


def iron_of(path):
    return round(read_calibration(path)[0].correction.hard_iron[0] * 1e6) if path.exists() else None


def kept(path):
    return [iron_of(file) for file in backup_files(path)]


def test_the_last_three_are_kept_next_to_the_file(path, irons):
    for number in range(6):
        irons(number)
    assert iron_of(path) == 5
    assert kept(path) == [4, 3, 2]


def test_the_calibration_in_force_is_no_backup(path, irons):
    for number in (1, 2, 3, 3, 3, 3):
        irons(number)
    assert kept(path) == [2, 1, None]


@pytest.mark.nightly
def test_two_alternating_calibrations_do_not_displace_a_third(path, irons):
    for number in (0, 1, 2, 1, 2, 1, 2):
        irons(number)
    assert iron_of(path) == 2
    assert sorted(kept(path)) == [0, 1, 2]
    assert kept(path)[0] == 1


def test_the_newest_backup_is_not_repeated(path, irons, monkeypatch):
    irons(1)
    replace_file = os.replace

    def refuse(source, target):
        if target == path:
            raise OSError(28, "No space left on device")
        replace_file(source, target)

    monkeypatch.setattr(os, "replace", refuse)
    for _ in range(4):
        with pytest.raises(FileError):
            irons(2)
    assert (iron_of(path), kept(path)) == (1, [1, None, None])


def test_a_full_disk_changes_no_backup(path, irons, monkeypatch):
    for number in (1, 2, 3):
        irons(number)
    monkeypatch.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError(28, "No space left")))
    for number in (4, 5, 6):
        with pytest.raises(FileError, match="No space left"):
            irons(number)
    assert (iron_of(path), kept(path)) == (3, [2, 1, None])


@pytest.mark.parametrize("slot", first_of([1, 0, 2]))
@pytest.mark.parametrize("kind", ["text", "folder", "link"])
def test_files_of_other_programs_are_kept_and_backups_continue(path, irons, slot, kind, tmp_path):
    theirs = backup_files(path)[slot]
    if kind == "folder":
        theirs.mkdir()
    elif kind == "link":
        elsewhere = tmp_path / "elsewhere.yaml"
        elsewhere.write_text("mine")
        theirs.symlink_to(elsewhere)
    else:
        theirs.write_text("mine")
    for number in range(6):
        irons(number)
    rest = [file for file in backup_files(path) if file != theirs]
    assert [iron_of(file) for file in rest] == [4, 3]
    assert theirs.is_dir() if kind == "folder" else theirs.read_text() == "mine"
    assert theirs.is_symlink() is (kind == "link")


def test_missing_free_names_are_reported(path, irons, found):
    irons(1)
    for file in backup_files(path):
        file.mkdir()
    with pytest.raises(FileError, match="not ours"):
        keep_backup(path, found)


def test_a_link_to_a_calibration_is_no_free_name(path, irons, tmp_path):
    irons(1)
    backup = tmp_path / "backup.yaml"
    backup.write_bytes(path.read_bytes())
    backup_files(path)[0].symlink_to(backup)
    for number in (2, 3):
        irons(number)
    assert iron_of(backup) == 1
    assert [iron_of(file) for file in backup_files(path)[1:]] == [2, 1]
