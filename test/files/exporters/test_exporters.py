"""Every export, applied as its consumer applies it, gives the same correction."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import consumers
import numpy as np
import pytest
import yaml
from consumers import FLIP
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from sample_results import calibration

from magcal_ros.core import Correction
from magcal_ros.core.geometry import rotation_from_rpy
from magcal_ros.files import EXPORTERS, NOTES, OF_TESLA, NotExportable, checksum, number

seeds = st.integers(0, 2**32 - 1)
FIELDS = 60e-6 * np.random.default_rng(0).standard_normal((50, 3))
SMALLEST = 1e-12
"""Tesla: far below what any sensor resolves."""

FULL = {
    "ctu-vras": consumers.ctu_vras,
    "fusioncore": consumers.fusioncore,
}
SYMMETRIC = {"ardupilot": consumers.ardupilot, "px4": consumers.px4}
DEGREE = np.pi / 180.0


def any_correction(seed, degrees=180.0):
    rng = np.random.default_rng(seed)
    lean = rng.uniform(-0.1, 0.1, (3, 3))
    symmetric = np.diag(rng.uniform(0.6, 1.6, 3)) + lean + lean.T
    limit = degrees * DEGREE / np.sqrt(3.0)
    turned = rotation_from_rpy(*rng.uniform(-limit, limit, 3)) @ symmetric
    return Correction(turned, rng.uniform(-150e-6, 150e-6, 3))


def symmetric_correction(seed):
    return any_correction(seed, degrees=0.0)


def in_frd(correct):
    """Fields in forward-left-up, corrected by a consumer with forward-right-down axes."""
    return lambda field: correct(field * FLIP) * FLIP


@examples(25)
@given(seeds, st.sampled_from(sorted(FULL)))
def test_consumers_of_the_full_matrix_get_the_whole_correction(seed, name):
    correction = any_correction(seed)
    text = EXPORTERS[name](calibration(correction))
    found = FULL[name](text)(FIELDS)
    np.testing.assert_allclose(found, correction.apply(FIELDS), atol=SMALLEST)
    assert "LOST" not in text


@examples(25)
@given(seeds)
def test_vectornav_gets_gauss_in_its_own_axes_and_a_checksum(seed):
    correction = any_correction(seed)
    correct = in_frd(consumers.vectornav(EXPORTERS["vectornav"](calibration(correction))))
    np.testing.assert_allclose(correct(FIELDS), correction.apply(FIELDS), atol=SMALLEST)


@examples(25)
@given(seeds, st.sampled_from(sorted(SYMMETRIC)))
def test_autopilots_get_a_symmetric_correction_completely(seed, name):
    correction = symmetric_correction(seed)
    text = EXPORTERS[name](calibration(correction))
    correct = in_frd(SYMMETRIC[name](text))
    np.testing.assert_allclose(correct(FIELDS), correction.apply(FIELDS), atol=SMALLEST)
    assert "LOST" not in text


@examples(25)
@given(seeds, st.sampled_from(sorted(SYMMETRIC)))
def test_autopilots_lose_only_a_rotation(seed, name):
    correction = any_correction(seed, degrees=4.5)
    correct = in_frd(SYMMETRIC[name](EXPORTERS[name](calibration(correction))))
    origin = correct(np.zeros((1, 3)))
    found = (correct(np.eye(3)) - origin).T
    rotation = correction.matrix @ np.linalg.inv(found)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-8)
    assert np.degrees(np.arccos(0.5 * (np.trace(rotation) - 1.0))) < 5.0
    np.testing.assert_allclose(correct(correction.hard_iron[None]), 0.0, atol=SMALLEST)


@pytest.mark.parametrize("name", sorted(SYMMETRIC))
def test_a_lost_rotation_is_reported_or_refused(name):
    def turned_by(degrees):
        pose = rotation_from_rpy(degrees * DEGREE, 0.0, 0.0)
        return calibration(Correction(pose @ np.diag([1.0, 1.1, 0.9]), np.zeros(3)))

    assert "LOST" not in EXPORTERS[name](turned_by(0.4))
    text = EXPORTERS[name](turned_by(3.0))
    lost = next(line for line in text.splitlines() if "LOST" in line)
    assert lost.startswith("# LOST: a rotation of 3.00 degrees, roll 3.00, pitch 0.00, yaw 0.00")
    EXPORTERS[name](turned_by(4.9))
    with pytest.raises(NotExportable, match="orientation"):
        EXPORTERS[name](turned_by(5.1))


def test_ardupilot_adds_milligauss_and_turns_left_to_right():
    correction = Correction(np.eye(3), [10e-6, -20e-6, 30e-6])
    lines = EXPORTERS["ardupilot"](calibration(correction)).splitlines()
    values = dict(line.split(",") for line in lines if not line.startswith("#"))
    assert float(values["COMPASS_OFS_X"]) == pytest.approx(-100.0)
    assert float(values["COMPASS_OFS_Y"]) == pytest.approx(-200.0)
    assert float(values["COMPASS_OFS_Z"]) == pytest.approx(300.0)
    assert float(values["COMPASS_DIA_X"]) == 1.0


def test_px4_subtracts_gauss_and_turns_left_to_right():
    lean = np.array([[1.0, 0.02, 0.03], [0.02, 1.1, 0.04], [0.03, 0.04, 0.9]])
    text = EXPORTERS["px4"](calibration(Correction(lean, [10e-6, -20e-6, 30e-6])))
    words = [line.split(" ") for line in text.splitlines() if not line.startswith("#")]
    values = {name: float(value) for _, _, name, value in words}
    offsets = [values[f"CAL_MAG0_{axis}OFF"] for axis in "XYZ"]
    assert offsets == pytest.approx([0.1, 0.2, -0.3])
    assert values["CAL_MAG0_YSCALE"] == pytest.approx(1.1)
    off = [values[f"CAL_MAG0_{axis}ODIAG"] for axis in "XYZ"]
    assert off == pytest.approx([-0.02, -0.03, 0.04])


def test_scales_that_px4_would_ignore_are_refused():
    with pytest.raises(NotExportable, match=r"0\.1 to 3"):
        EXPORTERS["px4"](calibration(Correction(np.diag([1.0, 1.0, 3.1]), np.zeros(3))))


def test_the_checksum_is_that_of_the_manufacturer():
    # Examples of the user manual and of commands in the field.
    assert checksum("VNRRG,23,1,0,0,0,1,0,0,0,1,0,0,0") == 0x73
    assert checksum("VNWRG,23,1,0,0,0,1,0,0,0,1,0,0,0") == 0x76


def test_vectornav_gets_no_exponents_and_no_impossible_numbers():
    tiny = Correction(np.eye(3) + 1e-8, [1e-12, 0.0, -1e-12])
    line = EXPORTERS["vectornav"](calibration(tiny))
    assert "e" not in line
    assert line.count(",") == 13
    with pytest.raises(NotExportable, match="tesla"):
        EXPORTERS["vectornav"](calibration(Correction(np.eye(3), [0.2, 0.0, 0.0])))


def test_madgwick_gets_the_hard_iron_and_the_loss_is_reported():
    correction = any_correction(3)
    text = EXPORTERS["imu_filter_madgwick"](calibration(correction))
    found = consumers.madgwick(text)(FIELDS)
    np.testing.assert_allclose(found, FIELDS - correction.hard_iron, atol=SMALLEST)
    assert "LOST: installation of" in text
    assert "imu/mag_unbiased" in text
    plain = Correction(np.eye(3), correction.hard_iron)
    assert "LOST" not in EXPORTERS["imu_filter_madgwick"](calibration(plain))


def test_ctu_vras_gets_every_name_it_reads():
    correction = any_correction(5)
    text = EXPORTERS["ctu-vras"](calibration(correction))
    documented = consumers.ctu_vras(text, "initial_scaling_matrix")(FIELDS)
    np.testing.assert_array_equal(documented, consumers.ctu_vras(text)(FIELDS))
    observed = consumers.ros_parameters(text)
    bias = [observed[f"magnetometer_bias_{axis}"] for axis in "xyz"]
    np.testing.assert_allclose(bias, correction.hard_iron, atol=SMALLEST)


def test_fusioncore_gets_the_strength_of_the_corrected_field():
    given = consumers.ros_parameters(EXPORTERS["fusioncore"](calibration()))
    assert given["magnetometer.field_strength"] == 50e-6


def test_fusioncore_is_connected_as_the_page_on_wiring_says():
    page = (Path(__file__).parents[3] / "doc" / "wiring.md").read_text()
    blocks = [yaml.safe_load(block) for block in re.findall(r"(?ms)```yaml\n(.*?)```", page)]
    (advised,) = [each["fusioncore"]["ros__parameters"] for each in blocks if "fusioncore" in each]
    given = consumers.ros_parameters(EXPORTERS["fusioncore"](calibration()))
    assert advised.items() <= given.items()


def test_a_compiler_reads_the_same_twelve_numbers(tmp_path):
    correction = any_correction(7)
    text = EXPORTERS["c-header"](calibration(correction))
    found = consumers.c_header(text, tmp_path)(FIELDS)
    np.testing.assert_allclose(found, correction.apply(FIELDS), atol=SMALLEST)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_survive_yaml_and_stay_floats(value):
    read = yaml.safe_load(number(value, OF_TESLA))
    assert isinstance(read, float)
    assert read == round(value, OF_TESLA)


@pytest.mark.parametrize("name", sorted(EXPORTERS))
def test_no_export_shows_the_rounding_errors_of_a_computer(name):
    iron = np.array([1e-5, -2.17e-19, 3e-5 * (1.0 + 2.0**-52)])
    text = EXPORTERS[name](calibration(Correction(np.eye(3) * (1.0 + 2.0**-52), iron)))
    assert not re.search(r"\d\.\d{10,}|e-1[4-9]|-0\.0+\b(?!\d)", text)


@pytest.mark.parametrize("name", sorted(set(EXPORTERS) - {"vectornav"}))
def test_every_text_names_its_origin(name):
    text = EXPORTERS[name](calibration(symmetric_correction(1)))
    assert "by magcal_ros, method design_tip, quality good" in text
    assert text.endswith("\n")


def test_exporters_need_no_ros():
    code = (
        "import sys, magcal_ros.files.exporters; "
        "assert not {'rclpy', 'matplotlib'} & set(sys.modules), sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=240)


@pytest.mark.parametrize("consumer", EXPORTERS)
def test_text_from_a_file_cannot_end_a_comment(consumer):
    one = calibration(Correction(np.eye(3), np.array([1e-5, 0.0, 0.0])))
    evil = "good\nevil: 1 */ int evil; **//\x1b[2J"
    text = EXPORTERS[consumer](replace(one, evidence=replace(one.evidence, method=evil)))
    assert "\x1b" not in text
    assert not any(line.startswith("evil") for line in text.splitlines())
    if consumer == "c-header":
        assert text.count("*/") == 1


def test_a_rotation_just_beyond_the_limit_is_not_shown_as_the_limit():
    turned = calibration(Correction(rotation_from_rpy(np.radians(5.02), 0.0, 0.0), np.zeros(3)))
    with pytest.raises(NotExportable, match=r"turns the field by 5\.02°, more than 5° "):
        EXPORTERS["px4"](turned)


@pytest.mark.parametrize(
    ("name", "words"), [("ardupilot", "RAW_IMU"), ("px4", "CAL_MAG0_ID"), ("vectornav", "identity")]
)
def test_the_basis_of_the_numbers_is_given(name, words):
    text = EXPORTERS[name](calibration(Correction.identity()))
    assert words in NOTES.get(name, text)
    assert (name in NOTES) is not ("DEPENDS ON" in text)
