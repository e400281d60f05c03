"""The page on a drive: its map in degrees, and the compass compared with course."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from magcal_ros.core import Calibration, Correction
from magcal_ros.core.calibration import Evidence
from magcal_ros.core.self_calibration import DrivePath, DriveReplay, path_along
from magcal_ros.report.drive_page import render_drive

ERRORS = np.radians([0.5, 3.0, 7.0, 15.0, 40.0])


def replay(place):
    path = DrivePath(np.array(place, dtype=float), ERRORS, True, True)
    return DriveReplay((), None, None, 60.0, 50.0, "nothing", path)


def test_the_map_shows_degrees():
    page = render_drive(replay([[0, 0], [10, 0], [20, 0], [30, 0], [40, 0]]), "a drive")
    for name in ("0 to 2°: 20%", "2 to 5°: 20%", "more than 20°: 20%"):
        assert name in page
    assert "At 40% of the points it was less than 5°" in page
    assert "µT:" not in page


def test_without_a_calibration_there_is_no_empty_table():
    page = render_drive(replay([[k, 0] for k in range(5)]), "a drive")
    assert "<p>None.</p>" in page
    assert "made by" not in page


def test_a_narrow_path_is_centred_on_the_map():
    page = render_drive(replay([[0, 25 * k] for k in range(5)]), "a drive")
    assert {float(x) for x in re.findall(r'cx="([0-9.]+)"', page)} == {500.0}


def test_start_and_end_of_a_loop_are_named_together():
    apart = render_drive(replay([[0, 0], [10, 0], [20, 10], [30, 0], [40, 0]]), "a drive")
    assert ">start</text>" in apart
    assert ">end</text>" in apart
    loop = render_drive(replay([[0, 0], [10, 0], [20, 10], [10, 10], [0.2, 0]]), "a drive")
    assert ">start and end</text>" in loop
    assert ">end</text>" not in loop


def test_names_do_not_overlap_the_scale():
    page = render_drive(replay([[0, 0], [10, 5], [20, 10], [30, 5], [40, 8]]), "a drive")
    start, bar = (
        float(re.search(rf'y="([0-9.]+)"[^>]*>{name}<', page)[1]) for name in ("start", "[0-9]+ m")
    )
    assert bar - start > 16.0  # the height of its letters


def test_the_offset_from_course_is_on_the_page():
    reported = replace(
        replay([[k, 0] for k in range(5)]), course="compass minus course +3.0° ±1.0°"
    )
    assert 'id="course">After: compass minus course +3.0°' in render_drive(reported, "a drive")


STRENGTH, DIP = 50e-6, math.radians(60.0)
CLEAN = np.array([0.0, STRENGTH * math.cos(DIP), -STRENGTH * math.sin(DIP)])


def path_by(raw, speed):
    correction = Correction(np.eye(3), np.zeros(3))
    evidence = Evidence("smoother", "good", "good", "")
    calibration = Calibration(correction, np.eye(12) * 1e-14, 5e-7, 0.01, STRENGTH, DIP, evidence)
    up = np.tile([0.0, 0.0, 1.0], (len(raw), 1))
    return path_along(calibration, np.arange(float(len(raw))), raw, up, speed)


def test_the_page_names_the_speed_that_its_map_assumes():
    path = path_by(np.tile(CLEAN, (5, 1)), np.full(5, math.nan))
    page = render_drive(DriveReplay((), None, None, 5.0, 5.0, "nothing", path), "a drive")
    metres = np.linalg.norm(np.diff(path.place, axis=0), axis=1)
    named = re.search(r"an assumed speed of ([0-9.]+) m/s", page)[1]
    assert metres == pytest.approx(float(named))


def test_the_colour_is_the_angle_by_a_disturbance_across_the_field():
    raw = np.array([CLEAN, CLEAN + np.array([0.0, 5e-6, 0.0]), CLEAN])
    path = path_by(raw, np.ones(3))
    assert np.degrees(path.error) == pytest.approx([0.0, math.degrees(math.atan(0.2)), 0.0])
