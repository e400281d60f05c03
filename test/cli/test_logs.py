"""Logs of autopilots and phones with all commands, and exports back to them."""

import io
import json
import math
import re
import time

import numpy as np
import pytest
from drives import drive, write_csv
from log_writers import FRD, GAUSS, logged, write_bin, write_sensor_logger, write_ulog
from long_form import first_of

from magcal_ros.cli import fit, recorded
from magcal_ros.cli.main import main
from magcal_ros.core.geometry import rotation_from_rpy
from magcal_ros.core.samples import FieldSample
from magcal_ros.core.simulation import Robot
from magcal_ros.files import rotation_of

REFERENCE = ["--reference-strength-ut", "50", "--reference-inclination-deg", "60"]
ROBOT = Robot(roll=0.02, pitch=-0.01)
SAMPLES = drive(400.0, ROBOT)
FIELDS = np.array([s.field for s in SAMPLES if isinstance(s, FieldSample)])


def fitted(path, tmp_path, *arguments):
    quickly = ["--method", "design_tip", *arguments]
    assert main(["fit", str(path), "--output", str(tmp_path / "f"), *REFERENCE, *quickly]) == 0
    return str(tmp_path / "f" / "calibration.yaml")


def exported(calibration, to, capsys):
    capsys.readouterr()
    assert main(["export", calibration, "--to", to]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line[0] != "#"]
    pairs = [line.replace("param set ", "").replace(",", " ").split() for line in lines]
    return {name: float(value) for name, value in pairs}


def symmetric(values, diagonal, beside):
    x, y, z = (values[diagonal.format(axis)] for axis in "XYZ")
    xy, xz, yz = (values[beside.format(axis)] for axis in "XYZ")
    return np.array([[x, xy, xz], [xy, y, yz], [xz, yz, z]])


def level_circle(field):
    """Scatter of the level field's size over it, after the tilt of the turn's axis is left out."""
    _, _, axes = np.linalg.svd(field - field.mean(axis=0))
    sizes = np.linalg.norm((field @ axes.T)[:, :2], axis=1)
    return float(sizes.std() / sizes.mean())


@pytest.mark.nightly
@pytest.mark.usefixtures("right_axes")
def test_ardupilot_uses_the_calibration_from_its_log(tmp_path, capsys):
    """With two compasses, and motors whose field of 0 to 12 µT it compensates before and after."""
    pytest.importorskip("pymavlink", reason="needs pymavlink: pip install pymavlink")

    def motors(stamp):
        return np.array([80.0, -60.0, 70.0]) * (0.8 + 0.2 * math.sin(stamp))

    def compasses(sample):
        added = -1e-7 * FRD @ motors(sample.stamp)
        return {0: 0.5 * np.array(sample.field), 1: np.array(sample.field) + added}

    path = write_bin(
        tmp_path / "a.BIN",
        SAMPLES,
        offsets=(-200, 150, 80),
        slot="2",
        compasses=compasses,
        lane=(0, 1),
        motors=motors,
    )
    found = exported(fitted(path, tmp_path), "ardupilot", capsys)
    offsets = np.array([found[f"COMPASS_OFS2_{axis}"] for axis in "XYZ"])
    assert offsets == pytest.approx(-1e7 * FRD @ ROBOT.hard_iron, abs=25.0)
    matrix = symmetric(found, "COMPASS_DIA2_{}", "COMPASS_ODI2_{}")
    stamps = [s.stamp for s in SAMPLES if isinstance(s, FieldSample)]

    def applied(offsets, matrix):
        rows = zip(FIELDS, map(motors, stamps), strict=True)
        return np.array(
            [logged(f - 1e-7 * FRD @ part, offsets, matrix, 1.0, part) for f, part in rows]
        )

    corrected, before = applied(offsets, matrix), applied(np.zeros(3), np.eye(3))
    assert level_circle(corrected) < 0.02 < level_circle(before)


@pytest.mark.parametrize("rotation", first_of([6, 0]))
@pytest.mark.usefixtures("right_axes")
def test_px4_uses_the_calibration_from_its_log(tmp_path, capsys, rotation):
    pytest.importorskip("pyulog", reason="needs pyulog: pip install pyulog")
    level = rotation_from_rpy(*np.radians([3.0, -2.0, 1.0]))
    path = write_ulog(
        tmp_path / "a.ulg",
        SAMPLES,
        offset=(0.1, 0.2, -0.1),
        rotation=rotation,
        pose=level @ rotation_of(rotation),
        parameters={f"SENS_BOARD_{a}_OFF": v for a, v in zip("XYZ", (3.0, -2.0, 1.0), strict=True)},
    )
    found = exported(fitted(path, tmp_path), "px4", capsys)
    offset = np.array([found[f"CAL_MAG1_{axis}OFF"] for axis in "XYZ"])
    scale = symmetric(found, "CAL_MAG1_{}SCALE", "CAL_MAG1_{}ODIAG")
    turn = level @ rotation_of(rotation)
    own = GAUSS * FIELDS @ FRD @ turn
    assert level_circle((own - offset) @ scale @ turn.T) < 0.02 < level_circle(own)


@pytest.mark.usefixtures("right_axes")
def test_check_compares_with_the_autopilots_own_yaw(tmp_path, capsys):
    pytest.importorskip("pymavlink", reason="needs pymavlink: pip install pymavlink")
    bare = write_bin(tmp_path / "a.BIN", SAMPLES)
    calibration = fitted(bare, tmp_path)
    stamps = np.array([s.stamp for s in SAMPLES])
    turn = np.degrees(0.5 * (stamps - stamps[0]))
    yaws = list(zip(stamps.tolist(), (-turn).tolist(), strict=True))
    path = write_bin(tmp_path / "b.BIN", SAMPLES, yaws=yaws[::10])
    capsys.readouterr()
    arguments = ["--calibration", calibration, "--output", str(tmp_path / "c"), *REFERENCE]
    main(["check", str(path), *arguments, "--json"])
    own = [w for w in json.loads(capsys.readouterr().out)["about"] if "own yaw" in w]
    assert len(own) == 1
    assert "declination, which is not known" in own[0]
    assert float(own[0].split("scattered by ")[1].split("°")[0]) < 5.0


def test_the_doctor_reads_a_log(tmp_path, capsys, axes_alone):
    pytest.importorskip("pymavlink", reason="needs pymavlink: pip install pymavlink")
    assert main(["doctor", str(write_bin(tmp_path / "a.BIN", SAMPLES)), *REFERENCE]) in (0, 4)
    assert "field: unit" in capsys.readouterr().out


@pytest.mark.usefixtures("right_axes")
def test_an_upright_phone_is_fitted_with_its_mounting(tmp_path, capsys):
    turn = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # its x points up
    samples = [
        s._replace(field=tuple(turn.T @ s.field))
        if isinstance(s, FieldSample)
        else s._replace(force=tuple(turn.T @ s.force), rate=tuple(turn.T @ s.rate))
        for s in SAMPLES
    ]
    path = write_sensor_logger(tmp_path / "phone", samples)
    fitted(path, tmp_path, "--imu-rpy-deg", "0", "-90", "0", "--json")
    numbers = json.loads(capsys.readouterr().out)["numbers"]
    iron = [numbers[f"hard_iron_{axis}_ut"] for axis in "xyz"]
    assert iron == pytest.approx(1e6 * ROBOT.hard_iron, abs=2.5)


def test_the_option_for_the_mounting_is_refused_for_bags(tmp_path, capsys):
    (tmp_path / "a.mcap").write_bytes(b"")
    assert main(["fit", str(tmp_path / "a.mcap"), "--imu-rpy-deg", "0", "0", "90"]) == 2
    assert "--imu-rpy-deg is for logs" in capsys.readouterr().err


def test_a_long_fit_shows_its_progress(monkeypatch):
    monkeypatch.setattr(recorded, "REDRAW", 0.01)
    monkeypatch.setattr(recorded, "LINE_EVERY", 0.05)
    out, shares = io.StringIO(), iter((0, 0, 0, 70, *[70] * 100))
    with recorded.with_progress(lambda: f"fitting 7 messages, {next(shares)} %", out):
        time.sleep(0.5)
    # No line is repeated.
    assert out.getvalue().splitlines() == [f"fitting 7 messages, {n} %: 0 s" for n in (0, 70)]


def test_on_a_terminal_one_line_is_drawn_again_and_removed(monkeypatch):
    monkeypatch.setattr(recorded, "REDRAW", 0.01)
    out = io.StringIO()
    out.isatty = lambda: True
    with recorded.with_progress(lambda: "reading, 50 %", out):
        time.sleep(0.1)
    assert "\n" not in out.getvalue()
    assert out.getvalue().count("\rreading, 50 %: 0 s") > 1
    assert out.getvalue().endswith("\r\x1b[K")


class TestASlowImu:
    def slow(self, samples, every):
        """Means over `every` seconds of a drive at 50 Hz, as phones write them."""
        kinds, out = {}, []
        for sample in samples:
            kinds.setdefault((type(sample), int(sample.stamp / every)), []).append(sample)
        for (kind, _), several in kinds.items():
            stamp = float(np.mean([s.stamp for s in several]))
            parts = zip(*(s[1:] for s in several), strict=True)
            means = (
                tuple(np.mean(part, axis=0)) if isinstance(part[0], tuple) else part[0]
                for part in parts
            )
            out.append(kind(stamp, *means))
        return sorted(out, key=lambda s: s.stamp)

    def test_one_second_means_of_a_slow_turn_are_used(self, tmp_path, capsys):
        slow = self.slow(drive(400.0, ROBOT, rate=math.radians(5.0)), 1.0)
        path = write_sensor_logger(tmp_path / "phone", slow)
        main(["fit", str(path), "--output", str(tmp_path / "f"), *REFERENCE, "--json"])
        reported = json.loads(capsys.readouterr().out)
        assert reported["numbers"]["samples"] > 50
        assert any(
            "the IMU comes at 1 Hz" in words for words in reported["recording"]["complaints"]
        )
        iron = [reported["numbers"][f"hard_iron_{axis}_ut"] for axis in "xy"]
        assert iron == pytest.approx(1e6 * ROBOT.hard_iron[:2], abs=2.0)

    @pytest.mark.parametrize("command", ["fit", "drive"])
    def test_a_too_slow_imu_is_refused_before_the_fit_with_its_rate(
        self, tmp_path, capsys, command
    ):
        slow = self.slow(drive(400.0, ROBOT, rate=math.radians(5.0)), 3.0)
        path = write_sensor_logger(tmp_path / "phone", slow)
        assert main([command, str(path), "--output", str(tmp_path / "f")]) == 3
        err = capsys.readouterr().err
        assert "comes at 0.33 Hz" in err
        assert "Hz or more" in err

    def test_a_drive_with_a_slow_field_is_refused_before_the_fit(self, tmp_path, capsys):
        slow = self.slow(drive(400.0, ROBOT, rate=math.radians(5.0)), 1.0)
        path = write_sensor_logger(tmp_path / "phone", slow)
        assert main(["drive", str(path), "--output", str(tmp_path / "f")]) == 3
        err = capsys.readouterr().err
        assert "phone magnetometer: the field comes at 1 Hz" in err
        assert "2 Hz or more" in err

    def test_a_refusal_names_the_rate(self, tmp_path, capsys):
        slow = self.slow(drive(400.0, ROBOT, rate=math.radians(5.0)), 1.0)
        bent = [
            s._replace(field=tuple(1e-5 * math.sin(k) + np.array(s.field)))
            if isinstance(s, FieldSample)
            else s
            for k, s in enumerate(slow)
        ]
        path = write_sensor_logger(tmp_path / "phone", bent)
        assert main(["fit", str(path), "--output", str(tmp_path / "f"), *REFERENCE]) != 0
        first = capsys.readouterr().out.splitlines()[0]
        assert "the field comes at 1 Hz" in first

    @pytest.mark.usefixtures("right_axes")
    def test_check_does_not_say_that_there_is_no_gyro(self, tmp_path, capsys):
        calibration = fitted(write_sensor_logger(tmp_path / "fast", SAMPLES), tmp_path)
        slow = self.slow(drive(400.0, ROBOT, rate=math.radians(5.0)), 1.0)
        path = write_sensor_logger(tmp_path / "phone", slow)
        arguments = ["--calibration", calibration, "--output", str(tmp_path / "c"), *REFERENCE]
        capsys.readouterr()
        main(["check", str(path), *arguments])
        out = capsys.readouterr().out
        assert "there is no gyro" not in out
        assert "too far to follow the gyro" in out

    def test_the_doctor_names_the_slow_imu(self, tmp_path, capsys):
        slow = self.slow(drive(400.0, ROBOT, rate=math.radians(5.0)), 1.0)
        main(["doctor", str(write_sensor_logger(tmp_path / "phone", slow)), "--json"])
        found = {each["key"]: each for each in json.loads(capsys.readouterr().out)["findings"]}
        assert "10 Hz or more" in found["slow"]["remedy"]


def test_a_long_report_is_announced_with_the_result_of_the_fit(monkeypatch, tmp_path, capsys):
    """The report takes longer than the fit: minutes for a recording of an hour and a half."""
    monkeypatch.setattr(recorded, "LINE_EVERY", 0.05)

    def slow_report(folder, subject):
        time.sleep(0.5)
        return folder / "report.html"

    monkeypatch.setattr(fit, "write_report", slow_report)
    fitted(write_csv(tmp_path / "turn", SAMPLES), tmp_path)
    assert re.search("quality [a-z]+; writing the report: ", capsys.readouterr().err)
