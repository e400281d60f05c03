"""`magcal fit` at known headings, instead of a turn."""

import math

import numpy as np
import pytest
from drives import STORE2, header, write_bag, write_csv

from magcal_ros.cli.main import main
from magcal_ros.core.samples import FieldSample
from magcal_ros.core.simulation import Ride, Robot
from magcal_ros.files import read_calibration

ROBOT = Robot(strength=50e-6, inclination=math.radians(60.0), hard_iron=(30e-6, -20e-6, 10e-6))
REFERENCE = ["--reference-strength-ut", "50", "--reference-inclination-deg", "60"]
YAWS = (10.0, 130.0, 250.0)


@pytest.fixture
def fit(tmp_path, capsys):
    def run(*arguments):
        output = ["--output", str(tmp_path / "found")]
        try:
            status = main(["fit", *map(str, arguments), *output, *REFERENCE])
        except SystemExit as left:
            status = left.code
        return status, "".join(capsys.readouterr())

    return run


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """Recordings of five seconds, one at each heading."""
    folder, found = tmp_path_factory.mktemp("standings"), []
    for k, yaw in enumerate(YAWS):
        ride = Ride(ROBOT, np.random.default_rng(k), start=1000.0 + 60.0 * k, imu_rate=50.0)
        ride.stand(0.01, -0.02, math.radians(yaw))
        samples = [sample for _ in range(250) for sample in ride.step(0.0)]
        found.append(write_csv(folder / f"at_{k}", samples))
    return found


def iron(tmp_path):
    return read_calibration(tmp_path / "found" / "calibration.yaml")[0].correction.hard_iron


def test_three_known_headings_give_a_calibration(fit, recordings, tmp_path):
    known = "--heading-deg", *YAWS, "--north", "magnetic", "--sigma-deg", 1
    status, words = fit(*recordings, *known)
    assert status == 0, words
    assert "One more known heading" in words
    assert np.linalg.norm(iron(tmp_path)[:2] - ROBOT.hard_iron[:2]) < 1.5e-6


def test_a_bearing_instead_of_a_yaw_is_named(fit, recordings):
    reported = [90.0 - yaw for yaw in YAWS]
    status, words = fit(*recordings, "--heading-deg", *reported, "--north", "magnetic")
    assert status == 4
    assert "as a compass bearing does" in words


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--heading-deg", 10, 20, 30], "--north true or --north magnetic"),
        (["--heading-deg", 10, "--north", "true"], "1 headings for 3 recordings"),
        (["--heading-deg", 10, 20, 30, "--north", "true"], "give --latitude and --longitude"),
        (["--north", "true"], "give --heading-deg or --heading-topic"),
        (["--sigma-deg", 1], "--sigma-deg is only for headings"),
        (
            ["--heading-topic", "/h", "--north", "true", "--sigma-deg", 1],
            "--sigma-deg is for --heading-deg",
        ),
        (["--heading-topic", "/heading", "--north", "true"], "takes one recording"),
    ],
)
def test_incomplete_headings_are_refused(fit, recordings, arguments, words):
    status, printed = fit(*recordings, *arguments)
    assert status == 2
    assert words in printed


def antenna(stamp, yaw):
    kinds = STORE2.types
    quaternion = kinds["geometry_msgs/msg/Quaternion"](
        0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)
    )
    known, absent = np.zeros(9), np.r_[-1.0, np.zeros(8)]
    known[8] = math.radians(1.0) ** 2
    nothing = kinds["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    parts = header(stamp, "gps"), quaternion, known, nothing, absent, nothing, absent
    return "/heading", kinds["sensor_msgs/msg/Imu"](*parts)


def driven(path, sign=1.0, late=0.0, pace=1.0):
    """A bag of a robot that turns slowly once, and the headings of its antennas."""
    ride = Ride(ROBOT, np.random.default_rng(5), start=1000.0, imu_rate=25.0)
    samples = []
    for k in range(25 * 75):
        new = ride.step(0.09 if k > 50 else 0.0)
        samples += new
        if k % 5 == 0:
            samples.append(antenna(ride.stamp - late, sign * ride.magnetic_yaw))
    assert any(isinstance(each, FieldSample) for each in samples)
    return write_bag(path, samples, pace=pace)


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return driven(tmp_path_factory.mktemp("antennas") / "bag")


def test_the_headings_of_two_antennas_in_a_bag_calibrate(fit, bag, tmp_path):
    options = "--imu", "/imu/data_raw", "--heading-topic", "/heading", "--north", "magnetic"
    status, words = fit(bag, *options)
    assert status == 0, words
    assert np.linalg.norm(iron(tmp_path)[:2] - ROBOT.hard_iron[:2]) < 1.5e-6


def test_antennas_to_magnetic_instead_of_true_north_are_named(fit, bag):
    options = "--heading-topic", "/heading", "--north", "true", "--reference-declination-deg", 14
    status, words = fit(bag, "--imu", "/imu/data_raw", *options)
    assert status == 0, words
    assert "the headings are to magnetic north and not to true north" in " ".join(words.split())


def test_mirrored_antennas_in_a_bag_are_named(fit, tmp_path):
    bag = driven(tmp_path / "bag", -1.0)
    options = "--imu", "/imu/data_raw", "--heading-topic", "/heading", "--north", "magnetic"
    status, words = fit(bag, *options)
    assert status == 4
    assert "mirrored" in words


def test_headings_of_a_simulator_at_half_speed_are_used(fit, tmp_path):
    """The recorder's clock gains a second in two, which is no fault of the headings' stamps."""
    bag = driven(tmp_path / "bag", pace=2.0)
    options = "--imu", "/imu/data_raw", "--heading-topic", "/heading", "--north", "magnetic"
    status, words = fit(bag, *options)
    assert status == 0, words


@pytest.mark.parametrize(("late", "words"), [(5.0, "5.0 s before"), (-5.0, "5.0 s after")])
def test_headings_in_a_bag_by_another_clock_are_refused(fit, tmp_path, late, words):
    bag = driven(tmp_path / "bag", late=late)
    options = "--imu", "/imu/data_raw", "--heading-topic", "/heading", "--north", "magnetic"
    status, printed = fit(bag, *options)
    assert status == 5
    assert f"their stamps are {words} those of /imu/data_raw" in printed
