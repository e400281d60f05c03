import json

import numpy as np
import pytest

from magcal_ros.core import Figure
from magcal_ros.core.calibration import Evidence, along


def test_a_figure_is_written_as_its_name():
    assert json.dumps({Figure.ARC: Figure.WOBBLE}) == '{"arc": "wobble"}'
    assert f"{Figure.ARC} {Figure.WOBBLE}" == "arc wobble"
    assert type(str(Figure.ARC)) is str


def test_the_key_of_gyro_against_compass_is_unchanged():
    one, two = Figure.GYRO_COMPASS_SWING, Figure.GYRO_COMPASS_DIFFERENCE
    assert one is not two
    assert one.key == two.key == "gyro_compass_rms"
    assert all(figure.key == figure.value for figure in Figure if figure is not two)


def test_an_unknown_name_is_refused():
    with pytest.raises(ValueError, match="centre_length_x"):
        along("centre_length", np.zeros(3))


def test_evidence_gives_figures_by_their_stored_names():
    evidence = Evidence("m", "good", "good", "", figures={"heading_sigma": 0.02, "of_2031": 1.0})
    assert evidence.figure(Figure.HEADING_SIGMA, 0.0) == 0.02
    assert evidence.figure(Figure.WOBBLE, 7.0) == 7.0
