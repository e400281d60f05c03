import numpy as np

from magcal_ros.core.methods.maximum_likelihood.linearise import linearise
from magcal_ros.core.methods.maximum_likelihood.logdet import (
    log_determinant_gradient,
    log_determinants,
)

STEP = 1e-5


def test_gradient_against_differences(state, problem):
    lin = linearise(state, problem)
    follow = lin.local_covariance @ lin.coupling

    def value(step):
        moved = state.moved(step, -follow @ step)
        return 0.5 * problem.weights.sample @ log_determinants(linearise(moved, problem))

    numerical = [(value(STEP * axis) - value(-STEP * axis)) / (2 * STEP) for axis in np.eye(18)]
    np.testing.assert_allclose(log_determinant_gradient(lin, problem), numerical, atol=1e-5)
