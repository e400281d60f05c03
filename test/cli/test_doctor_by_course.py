"""`magcal doctor` reports the yaw of the axes if a bag has a course."""

import json
import math

import numpy as np
import pytest
from drives import DRIVE_VEHICLE, recorded, write_bag
from simulated.drive import simulated_drive
from simulated.legs import city
from simulated.travel import travel

from magcal_ros.cli.main import main
from magcal_ros.core.geometry import rotation_from_rpy
from magcal_ros.core.samples import FieldSample, ImuSample

LEFT = rotation_from_rpy(0.0, 0.0, math.pi / 2.0)


def turned(sample, imu, field):
    """A sample of sensors that are rotated by `imu` and `field` in the vehicle."""
    if isinstance(sample, ImuSample):
        force, rate = (tuple(imu.T @ np.array(v)) for v in (sample.force, sample.rate))
        return sample._replace(force=force, rate=rate)
    if isinstance(sample, FieldSample):
        return sample._replace(field=tuple(field.T @ np.array(sample.field)))
    return sample


@pytest.fixture(scope="module")
def samples():
    rng = np.random.default_rng(4)
    truth = travel(city(rng, 150.0), rng, rate=10.0)
    return list(simulated_drive(truth, rng, DRIVE_VEHICLE, streets=None).samples())


@pytest.mark.parametrize(
    ("imu", "field", "wrong"),
    [
        (np.eye(3), LEFT, {"field_yaw"}),
        pytest.param(np.eye(3), np.eye(3), set(), marks=pytest.mark.nightly),
        pytest.param(LEFT, LEFT, {"imu_yaw"}, marks=pytest.mark.nightly),
    ],
    ids=["magnetometer to the left", "right", "both to the left"],
)
def test_a_course_gives_the_yaw(samples, imu, field, wrong, tmp_path, capsys):
    printed = [recorded(turned(sample, imu, field)) for sample in samples]
    bag = write_bag(tmp_path / "bag", [each for each in printed if each])
    main(["doctor", str(bag), "--json"])
    page = json.loads(capsys.readouterr().out)
    lines = {f["key"]: f for f in page["findings"]}
    assert {key for key, f in lines.items() if f["grade"] in ("warn", "refused")} == wrong
    assert {"field_yaw", "imu_yaw"} <= set(lines)
    assert page["mount_rpy_deg"] == ([0, 0, 90] if "field_yaw" in wrong else None)
