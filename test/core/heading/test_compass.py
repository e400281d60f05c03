import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sample_results import SKEWED, calibration, small_covariance
from scipy.spatial.transform import Rotation

from magcal_ros.core import Compass, Correction, Figure
from magcal_ros.core.calibration import AT_REST, MotorField, MotorInput, MotorState
from magcal_ros.core.geometry import (
    body_from_enu,
    field_in_enu,
    rotation_from_rpy,
    rpy_from_rotation,
    unit,
    wrap_angle,
    yaw_from_up_and_field,
)
from magcal_ros.core.heading import ODDS, UNSEEN, quaternion_from_rpy

angle = st.floats(-math.pi, math.pi)
tilt = st.floats(-1.4, 1.4)
dip = st.floats(-1.4, 1.4)
G = 9.80665

POSES = [
    (0.0, 0.0, 0.3, 1.0),
    (0.0, 0.0, -2.2, -0.9),
    (0.4, -0.3, 1.0, 1.1),
    (-0.5, 0.6, 2.5, 0.8),
    (0.2, 0.9, -2.0, 1.0),
    (2.8, 0.1, 0.7, 1.0),
]
"""Roll, pitch, yaw, inclination."""


def seen(roll, pitch, yaw, inclination):
    """Up and field in body axes at a pose."""
    to_body = rotation_from_rpy(roll, pitch, yaw).T
    return to_body[:, 2], to_body @ field_in_enu(50e-6, inclination)


def heading_at(compass, up, field):
    return compass.heading(tuple(field.tolist()), tuple((G * up).tolist()))


class TestAgainstTheArrayFormulas:
    @given(st.tuples(*[st.floats(-1e-4, 1e-4)] * 3))
    def test_the_compass_applies_the_correction(self, raw):
        found = Compass(calibration()).correct(raw)
        assert found == pytest.approx(SKEWED.apply(np.array(raw)), abs=1e-18)

    @given(tilt, tilt, angle, dip)
    def test_roll_pitch_and_yaw_of_a_pose_are_recovered(self, roll, pitch, yaw, inclination):
        up, field = seen(roll, pitch, yaw, inclination)
        found = heading_at(Compass(calibration()), up, field)
        assert found.roll == pytest.approx(roll, abs=1e-9)
        assert found.pitch == pytest.approx(pitch, abs=1e-9)
        assert abs(wrap_angle(found.yaw - yaw)) < 1e-9

    @given(st.tuples(*[st.floats(-20, 20)] * 3), st.tuples(*[st.floats(-1e-4, 1e-4)] * 3))
    def test_the_yaw_is_that_of_attitude(self, force, field):
        found = Compass(calibration()).heading(field, force)
        if found is not None:
            expected = yaw_from_up_and_field(np.array(force), np.array(field))
            assert abs(wrap_angle(found.yaw - expected)) < 1e-9

    @given(tilt, tilt, angle, dip, st.floats(-math.pi, math.pi))
    def test_the_quaternion_turns_body_axes_into_enu(self, roll, pitch, yaw, dip_, declination):
        up, field = seen(roll, pitch, yaw, dip_)
        heading = heading_at(Compass(calibration()), up, field)
        to_magnetic = Rotation.from_quat(heading.quaternion()).as_matrix()
        assert to_magnetic == pytest.approx(body_from_enu(up, field).T, abs=1e-9)
        to_true = Rotation.from_quat(heading.quaternion(declination)).as_matrix()
        turned = Rotation.from_euler("z", -declination).as_matrix() @ to_magnetic
        assert to_true == pytest.approx(turned, abs=1e-9)

    @given(angle, angle, angle)
    def test_quaternion_from_rpy_is_scipys(self, roll, pitch, yaw):
        expected = Rotation.from_euler("xyz", [roll, pitch, yaw])
        found = Rotation.from_quat(quaternion_from_rpy(roll, pitch, yaw))
        assert (found * expected.inv()).magnitude() < 1e-9

    def test_the_quaternion_has_length_one(self):
        assert np.linalg.norm(quaternion_from_rpy(0.3, -0.4, 2.0)) == pytest.approx(1.0)

    def test_true_yaw_is_less_if_magnetic_north_is_east(self):
        """Facing magnetic north, 10° east of true north, is facing 10° clockwise of it."""
        up, field = seen(0.0, 0.0, math.pi / 2, 1.0)
        heading = heading_at(Compass(calibration()), up, field)
        true = Rotation.from_quat(heading.quaternion(math.radians(10.0))).as_euler("xyz")[2]
        assert math.degrees(true) == pytest.approx(80.0)


class TestNoDirection:
    @pytest.mark.parametrize(
        ("field", "force"),
        [
            ((2e-5, 0.0, -4e-5), (0.0, 0.0, 0.0)),
            ((2e-5, 0.0, -4e-5), (0.0, 0.0, 0.09)),
            ((0.0, 0.0, 0.0), (0.0, 0.0, G)),
            ((0.0, 0.0, -5e-5), (0.0, 0.0, G)),
            ((0.9e-6, 0.0, -5e-5), (0.0, 0.0, G)),
            ((0.0, 0.0, 5e-5), (0.0, 0.0, -G)),
        ],
    )
    def test_there_is_no_heading_without_gravity_or_level_field(self, field, force):
        assert Compass(calibration()).heading(field, force) is None

    def test_there_is_a_heading_with_any_level_field(self):
        assert Compass(calibration()).heading((1.1e-6, 0.0, -5e-5), (0.0, 0.0, G)) is not None

    def test_every_number_is_finite_with_the_nose_up(self):
        heading = Compass(calibration()).heading((-4e-5, 0.0, 2e-5), (G, 0.0, 0.0))
        assert np.isfinite(heading.covariance()).all()


def attitudes_seen(up, field):
    """Roll, pitch and yaw of many ups and fields, by the direct formulas."""
    roll = np.arctan2(up[:, 1], up[:, 2])
    pitch = np.arctan2(-up[:, 0], np.hypot(up[:, 1], up[:, 2]))
    return np.stack([roll, pitch, yaw_from_up_and_field(up, field)], axis=-1)


DRAWS = 60_000


def monte_carlo(calibration_, up, field, rng):
    """Covariance of roll, pitch, yaw when parameters, field and up are drawn anew each time."""
    truth = calibration_.correction
    raw = truth.undo(field)
    drawn = rng.multivariate_normal(
        truth.parameters * 0.0, calibration_.covariance, DRAWS, method="eigh"
    )
    matrices = truth.matrix + drawn[:, :9].reshape(-1, 3, 3)
    noisy = raw + calibration_.noise_field * rng.standard_normal((DRAWS, 3))
    fields = np.einsum("nij,nj->ni", matrices, noisy - truth.hard_iron - drawn[:, 9:])
    ups = unit(up + calibration_.noise_up * rng.standard_normal((DRAWS, 3)))
    centre = attitudes_seen(up[None], field[None])
    errors = wrap_angle(attitudes_seen(ups, fields) - centre)
    return np.cov(errors.T)


CAUSES = {
    "parameters": {"noise_field": 0.0, "noise_up": 0.0},
    "field noise": {"noise_up": 0.0, "covariance": np.zeros((12, 12))},
    "up noise": {"noise_field": 0.0, "covariance": np.zeros((12, 12))},
    "everything": {"covariance": small_covariance(seed=3)},
}


class TestCovarianceAgainstMonteCarlo:
    @pytest.mark.parametrize("pose", POSES)
    @pytest.mark.parametrize("cause", CAUSES)
    def test_every_element_is_the_scatter_of_the_attitude(self, pose, cause):
        one = calibration(**CAUSES[cause])
        up, field = seen(*pose)
        claimed = np.reshape(heading_at(Compass(one), up, field).covariance(), (3, 3))
        drawn = monte_carlo(one, up, field, np.random.default_rng(11))
        scale = np.sqrt(np.outer(np.diag(drawn), np.diag(drawn)))
        assert claimed == pytest.approx(drawn, abs=0.035 * scale.max(), rel=0.035)
        assert claimed[2, 2] == pytest.approx(drawn[2, 2], rel=0.035)

    def test_local_disturbances_are_in_the_variance_but_not_in_the_noise(self):
        """A field that deviates by 2 µT per axis from place to place, after a drive showed it."""
        plain = calibration(**CAUSES["field noise"], noise_field=0.0)
        shown = replace(plain.evidence, figures={Figure.LOCAL_FIELD.value: 2e-6})
        up, field = seen(*POSES[0])
        claimed = heading_at(Compass(replace(plain, evidence=shown)), up, field)
        scattered = replace(plain, noise_field=2e-6, noise_up=0.0)
        drawn = monte_carlo(scattered, up, field, np.random.default_rng(4))
        assert claimed.yaw_variance == pytest.approx(drawn[2, 2], rel=0.035)
        assert claimed.noise_variance == claimed.lasting_variance == 0.0

    @pytest.mark.parametrize("pose", POSES)
    def test_roll_and_pitch_correlate_with_yaw_in_the_right_sense(self, pose):
        """Each correlation by itself: a wrong sign is far outside."""
        one = calibration(**CAUSES["up noise"])
        up, field = seen(*pose)
        claimed = np.reshape(heading_at(Compass(one), up, field).covariance(), (3, 3))
        drawn = monte_carlo(one, up, field, np.random.default_rng(12))

        def correlation(matrix):
            spread = np.sqrt(np.diag(matrix))
            return matrix / np.outer(spread, spread)

        assert correlation(claimed) == pytest.approx(correlation(drawn), abs=0.02)

    @given(tilt, tilt, angle, dip)
    def test_it_is_a_covariance_at_every_pose(self, roll, pitch, yaw, inclination):
        heading = heading_at(Compass(calibration()), *seen(roll, pitch, yaw, inclination))
        matrix = np.reshape(heading.covariance(), (3, 3))
        assert (matrix == matrix.T).all()
        values = np.linalg.eigvalsh(matrix)
        assert values[0] >= -1e-9 * values[2]

    def test_twice_the_up_noise_is_four_times_the_tilt_variance(self):
        one, two = calibration(noise_up=0.01), calibration(noise_up=0.02)
        up, field = seen(0.2, -0.1, 1.0, 1.0)
        first, second = (heading_at(Compass(c), up, field) for c in (one, two))
        assert first.tilt_variance == pytest.approx(1e-4)
        assert second.covariance()[5] == pytest.approx(4.0 * first.covariance()[5])

    def test_it_does_not_depend_on_how_the_correction_is_split(self):
        """A gain in front of the sensor, undone by A, leaves the up's share unchanged."""
        gained = Correction(SKEWED.matrix * 2.0, SKEWED.hard_iron)
        up, field = seen(0.2, -0.1, 1.0, 1.0)
        a, b = (
            heading_at(Compass(calibration(c, np.zeros((12, 12)), 0.0)), up, field)
            for c in (SKEWED, gained)
        )
        assert a[:9] == pytest.approx(b[:9])


def test_rpy_from_rotation_agrees_with_the_heading():
    up, field = seen(0.3, -0.5, 2.0, 1.0)
    heading = heading_at(Compass(calibration()), up, field)
    expected = rpy_from_rotation(body_from_enu(up, field).T)
    assert heading[:3] == pytest.approx(expected)


UNSEEN_SIGMA = math.sqrt(float(ODDS @ UNSEEN**2))
"""Share of the motors' field that no input shows, before any sample."""


class TestMotors:
    MOTION = MotorState(1.0, 0.4, 0.7, 3.0)

    @staticmethod
    def numbers(seed):
        """A calibration with motors, and its joint covariance."""
        rng = np.random.default_rng(seed)
        mix = rng.standard_normal((18, 18)) * np.repeat([0.003, 0.3e-6, 0.3e-6], [9, 3, 6])[:, None]
        joint = mix @ mix.T / 18.0
        joint[:12, 12:] = joint[12:, :12] = 0.0
        inputs = MotorInput.MOVING, MotorInput.SPEED
        gain = rng.normal(0.0, 5e-6, (2, 3))
        motors = MotorField(inputs, gain, joint[12:, 12:], joint[:12, 12:], 0.0, (1.0, 0.7))
        return replace(calibration(), covariance=joint[:12, :12], motors=motors), joint

    def test_the_field_of_motors_is_subtracted(self):
        found, _ = self.numbers(0)
        field = np.array([1e-5, 2e-5, -4e-5])
        added = found.motors.gain[0] + 0.7 * found.motors.gain[1]
        back = Compass(found).without_motors(tuple(field + added), self.MOTION)
        assert back == pytest.approx(field, abs=1e-15)
        assert Compass(found).without_motors(tuple(field), AT_REST) == tuple(field)

    def test_the_variance_is_that_of_drawn_numbers(self):
        found, joint = self.numbers(1)
        up, field = seen(0.1, -0.2, 0.9, 1.0)
        rng = np.random.default_rng(2)
        raw = found.correction.undo(field)
        u = np.array([1.0, 0.7])
        drawn = rng.multivariate_normal(np.zeros(18), joint, 4000)
        matrix = found.correction.matrix + drawn[:, :9].reshape(-1, 3, 3)
        moved = drawn[:, 9:12] + np.einsum("k,nkj->nj", u, drawn[:, 12:].reshape(-1, 2, 3))
        moved += np.outer(UNSEEN_SIGMA * rng.standard_normal(4000), u @ found.motors.gain)
        fields = np.einsum("nij,nj->ni", matrix, raw - found.correction.hard_iron - moved)
        yaws = yaw_from_up_and_field(up, fields)
        args = tuple(field.tolist()), tuple(up.tolist())
        added = raw + u @ found.motors.gain
        heading = self.heading(found, added, up, self.MOTION)
        assert heading.yaw_variance - heading.noise_variance == pytest.approx(np.var(yaws), rel=0.1)
        without = Compass(replace(found, motors=None)).heading(*args, 0.0)
        assert self.heading(found, raw, up, AT_REST)[:9] == pytest.approx(without[:9])

    @staticmethod
    def heading(known, raw, up, motor_state):
        """The heading of a robot without a gyro."""
        compass = Compass(known)
        field, motors = compass.at_rest(0.0, tuple(raw.tolist()), None, motor_state)
        return compass.heading(field, tuple(up.tolist()), 0.0, motors)

    @pytest.mark.parametrize("doubt", [MotorState(0.5, 0.0, 0.7), MotorState(1.0, 0.0, math.nan)])
    def test_unknown_inputs_are_in_the_variance(self, doubt):
        found, _ = self.numbers(3)
        up, field = seen(0.0, 0.0, 0.9, 1.0)
        raw = found.correction.undo(field)
        speed = 0.0 if math.isnan(doubt.speed) else doubt.speed
        reported = np.array([doubt.moving, speed]) @ found.motors.gain
        sure = self.heading(found, raw, up, AT_REST)
        which = int(math.isnan(doubt.speed))
        gain = found.correction.matrix @ found.motors.gain[which] * (0.7 if which else 0.5)
        east = np.cross(field, up)
        turned = float(east @ gain / (east @ east))
        known = replace(found.motors, covariance=np.zeros((6, 6)))
        seen_so = self.heading(replace(found, motors=known), raw + reported, up, doubt)
        apart = seen_so.yaw_variance - seen_so.lasting_variance
        unseen = UNSEEN_SIGMA * float(east @ found.correction.matrix @ reported / (east @ east))
        expected = turned**2 + unseen**2
        assert apart - seen_so.noise_variance == pytest.approx(expected, rel=1e-6)
        assert seen_so.yaw == pytest.approx(sure.yaw)
