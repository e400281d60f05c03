import numpy as np
import pytest

from magcal_ros.core.estimation.model import (
    State,
    about_z,
    global_jacobian,
    local_jacobian,
    predict,
)
from magcal_ros.core.geometry.rotations import exp_rotation, exp_rotations

STEP = 1e-6


def prediction_in_body(state, samples):
    residual = predict(state, samples)
    up = residual.up_residual @ state.shared.body_axis.T
    return -np.hstack([up, residual.field_residual])


def rows_in_body(state, jacobian):
    turned = jacobian.copy()
    turned[:, :3] = state.shared.body_axis @ jacobian[:, :3]
    return turned


@pytest.mark.parametrize("parameter", range(18))
def test_global_jacobian_against_differences(state, samples, parameter):
    prediction = predict(state, samples)
    local = local_jacobian(prediction)
    jacobian = rows_in_body(state, global_jacobian(state, prediction, local, samples))
    step = np.zeros(18)
    step[parameter] = STEP
    still = np.zeros((len(samples), 3))
    ahead = prediction_in_body(state.moved(step, still), samples)
    behind = prediction_in_body(state.moved(-step, still), samples)
    np.testing.assert_allclose(jacobian[:, :, parameter], (ahead - behind) / (2 * STEP), atol=1e-8)


@pytest.mark.parametrize("direction", range(3))
def test_local_jacobian_against_differences(state, samples, direction):
    jacobian = rows_in_body(state, local_jacobian(predict(state, samples)))
    local = np.zeros((len(samples), 3))
    local[:, direction] = STEP
    ahead = prediction_in_body(state.moved(np.zeros(18), local), samples)
    behind = prediction_in_body(state.moved(np.zeros(18), -local), samples)
    np.testing.assert_allclose(jacobian[:, :, direction], (ahead - behind) / (2 * STEP), atol=1e-8)


def test_prediction_follows_the_written_model(state, samples):
    shared = state.shared
    rotation = shared.body_axis @ state.attitude @ shared.world_axis.T
    raw = (rotation @ shared.field_enu) @ shared.distortion(samples.mounting).T
    raw += shared.hard_iron
    prediction = predict(state, samples)
    np.testing.assert_allclose(samples.field - prediction.field_residual, raw, atol=1e-13)
    up = samples.up - prediction.up_residual @ shared.body_axis.T
    np.testing.assert_allclose(up, rotation[:, :, 2], atol=1e-13)


def test_vectorised_rotations_agree_with_the_single_one(rng):
    vectors = np.vstack([rng.standard_normal((5, 3)), 1e-10 * rng.standard_normal((2, 3))])
    expected = [exp_rotation(v) for v in vectors]
    np.testing.assert_allclose(exp_rotations(vectors), expected, atol=1e-14)


def test_upright_keeps_the_turn_and_drops_the_lean(state):
    upright = state.upright()
    np.testing.assert_allclose(upright.lean[:, :2], 0.0)
    angles = np.linspace(0.0, 5.0, len(state.attitude))
    rigid = State(state.shared, about_z(angles))
    np.testing.assert_allclose(rigid.upright().attitude, rigid.attitude, atol=1e-15)
