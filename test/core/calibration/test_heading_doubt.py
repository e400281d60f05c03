import math

import numpy as np
import pytest
from sample_results import SKEWED, estimate, small_covariance

from magcal_ros.core.calibration import in_doubt, predicted_heading_sigma


@pytest.mark.parametrize("doubt", [0.0, 0.01, 0.2])
def test_it_adds_to_the_heading_on_the_level(doubt):
    one = estimate(covariance=small_covariance(of_matrix=3e-3, of_iron=0.1e-6))
    expected = math.hypot(predicted_heading_sigma(one, 0.0), doubt)
    assert predicted_heading_sigma(in_doubt(one, doubt), 0.0) == pytest.approx(expected, rel=1e-6)


def test_it_is_counted_where_the_correction_turns_and_stretches_the_field():
    one = estimate(correction=SKEWED, covariance=np.zeros((12, 12)))
    assert predicted_heading_sigma(in_doubt(one, 0.05), 0.0) == pytest.approx(0.05, rel=0.2)
