"""The reference field by parameters and model, and its contradictions."""

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulated.turns import measure, turn

from magcal_ros.core import Belief, Knowledge, ReferenceField, calibrate
from magcal_ros.core.earth_field import LocalField, made_elsewhere, model_field, resolve
from magcal_ros.core.earth_field.wmm import Place
from magcal_ros.core.knowledge import knowledge_of
from magcal_ros.core.simulation import Robot

pytestmark = pytest.mark.usefixtures("right_axes")

MUNICH, SYDNEY = Place(48.14, 11.58, 520.0), Place(-33.87, 151.21)
YEAR = 2026.9
NOTHING, LOCAL = ReferenceField(), LocalField()
MODEL = model_field(MUNICH, YEAR)


def by_hand(**numbers):
    return knowledge_of(**numbers).reference


def test_without_information_the_reference_is_unknown():
    for found in (resolve(NOTHING, LOCAL, None, None), resolve(NOTHING, LOCAL, MUNICH, None)):
        assert (found.field, found.source, found.complaints) == (NOTHING, "unknown", ())
        assert found.words == "unknown"
        assert {v for k, v in found.facts.items() if k not in ("source", "complaints")} == {None}


def test_a_place_and_a_date_give_everything():
    found = resolve(NOTHING, LOCAL, MUNICH, YEAR)
    assert found.source == "World Magnetic Model 2025 at 48.14°N 11.58°E, 2026.9"
    assert found.complaints == ()
    assert found.field.is_known
    assert found.field.strength.value == MODEL.strength.value
    assert found.field.inclination.value == MODEL.inclination.value
    assert found.field.declination == MODEL.declination.value
    json.dumps(found.facts)
    assert found.facts["declination_deg"] == pytest.approx(4.4, abs=0.2)


def test_the_sigma_is_the_models_and_the_places_own_in_quadrature():
    local = LocalField(7e-6, math.radians(5.0), math.radians(4.0))
    field = resolve(NOTHING, local, MUNICH, YEAR).field
    assert field.strength.sigma == pytest.approx(math.hypot(7e-6, 138e-9))
    assert math.degrees(field.inclination.sigma) == pytest.approx(math.hypot(5.0, 0.2))
    expected = math.hypot(MODEL.declination.sigma, math.radians(4.0))
    assert field.declination_sigma == pytest.approx(expected)
    bare = resolve(NOTHING, LocalField(0.0, 0.0, 0.0), MUNICH, YEAR).field
    assert bare.declination_belief == MODEL.declination


HAND = {"strength_ut": 48.5, "inclination_deg": 64.0, "declination_deg": 4.0}


@pytest.mark.parametrize("names", [[n] for n in HAND] + [list(HAND)[:2], list(HAND)[1:]])
def test_given_numbers_have_priority_one_by_one(names):
    mine = by_hand(**{name: HAND[name] for name in names})
    found = resolve(mine, LOCAL, MUNICH, YEAR)
    for name in HAND:
        part = name.rpartition("_")[0]
        attribute = "declination_belief" if part == "declination" else part
        ours = getattr(found.field, attribute)
        if name in names:
            assert ours == getattr(mine, attribute)
            assert part in found.source.split(" given")[0]
        else:
            assert ours.value == getattr(MODEL, part).value
    assert "given, the rest from the World Magnetic Model 2025 at 48.14°N" in found.source
    assert not found.complaints


def test_a_complete_given_field_needs_no_model():
    mine = by_hand(**HAND)
    for place, year in ((None, None), (MUNICH, YEAR), (MUNICH, 1970.0)):
        found = resolve(mine, LOCAL, place, year)
        assert (found.field, found.source, found.complaints) == (mine, "given", ())


def test_a_declination_of_the_wrong_sign_is_reported_and_used():
    found = resolve(by_hand(declination_deg=-4.4), LOCAL, MUNICH, YEAR)
    assert math.degrees(found.field.declination) == pytest.approx(-4.4)
    (complaint,) = found.complaints
    assert "is given as -4.4°, but it is 4.4° by the World Magnetic Model 2025" in complaint


def test_numbers_of_another_place_are_reported():
    mine = by_hand(strength_ut=30.0, inclination_deg=-60.0)
    assert len(resolve(mine, LOCAL, MUNICH, YEAR).complaints) == 2
    wide = LocalField(20e-6, math.radians(60.0), 1.0)
    assert not resolve(mine, wide, MUNICH, YEAR).complaints


def test_declinations_are_compared_across_180_degrees():
    place = next(
        Place(lat, lon)
        for lat in (-66.0, -68.0, -70.0, 84.0)
        for lon in range(-180, 180, 2)
        if abs(math.degrees(model_field(Place(lat, lon), YEAR).declination.value)) > 179.0
    )
    declination = math.degrees(model_field(place, YEAR).declination.value)
    other_side = declination + (0.9 if declination > 0 else -0.9)
    other_side -= math.copysign(360.0, other_side) if abs(other_side) > 180.0 else 0.0
    found = resolve(by_hand(declination_deg=other_side), LOCAL, place, YEAR)
    assert not [c for c in found.complaints if "is given as" in c]


def test_near_a_pole_there_is_no_true_north_unless_it_is_given():
    found = resolve(NOTHING, LOCAL, Place(88.9, -121.0), 2025.0)
    assert found.field.is_complete
    assert found.field.declination is None
    assert "a compass is of no use here, and no true north" in found.complaints[0]
    mine = by_hand(declination_deg=-99.0)
    found = resolve(mine, LocalField(1.0, 1.0, 2.0), Place(88.9, -121.0), 2025.0)
    assert found.field.declination == mine.declination
    assert found.complaints[0].endswith("a compass is of no use here")


def test_farther_from_the_pole_the_declination_is_doubtful():
    found = resolve(NOTHING, LOCAL, Place(80.0, -96.0), 2025.0)
    assert found.field.declination_sigma > math.radians(2.4)
    assert "uncertain by 2.5° (1σ) or more" in found.complaints[0]


@pytest.mark.parametrize("year", [1970.0, 2012.0, 2036.0])
def test_a_date_outside_every_model_is_reported(year):
    found = resolve(by_hand(strength_ut=48.0), LOCAL, MUNICH, year)
    assert (found.field, found.source) == (by_hand(strength_ut=48.0), "given")
    assert f"for the year {year:.1f}" in found.complaints[0]


def test_a_date_after_the_life_of_the_model_is_reported_and_used():
    found = resolve(NOTHING, LOCAL, MUNICH, 2032.0)
    assert found.field.is_known
    assert "2.0 years after the life of the World Magnetic Model 2025" in found.complaints[0]


@given(st.floats(-90, 90), st.floats(-180, 180), st.floats(1900, 2200), st.floats(-1e3, 8.5e5))
def test_any_parameters_give_usable_numbers_without_an_error(lat, lon, year, altitude):
    found = resolve(NOTHING, LOCAL, Place(lat, lon, altitude), year)
    for belief in (found.field.strength, found.field.inclination):
        assert math.isfinite(belief.value)
        assert belief.is_unknown or belief.sigma > 0.0
    assert 0.0 <= found.field.declination_sigma <= 4.0
    json.dumps(found.facts)
    assert found.words


@pytest.fixture(scope="module")
def window_and_robot():
    field = resolve(NOTHING, LOCAL, MUNICH, YEAR).field
    robot = Robot(strength=field.strength.value, inclination=field.inclination.value)
    return measure(robot, turn(), np.random.default_rng(5), gyro=True), robot


@pytest.fixture(scope="module")
def known(window_and_robot):
    """The result of the turn with the field by the model."""
    window, _ = window_and_robot
    return calibrate(window, Knowledge(resolve(NOTHING, LOCAL, MUNICH, YEAR).field))


@pytest.fixture(scope="module")
def unknown(window_and_robot):
    """The result of the same turn without a reference field."""
    window, _ = window_and_robot
    return calibrate(window, Knowledge())


def test_the_model_makes_tilted_headings_certain_and_the_verdict_names_its_absence(
    window_and_robot, known, unknown
):
    _, robot = window_and_robot
    assert known.estimate is not None
    assert unknown.estimate is not None
    assert np.linalg.norm(known.estimate.correction.hard_iron - robot.hard_iron) < 2e-6
    assert not [
        words for words in known.verdict.not_shown if "reference field is not known" in words
    ]
    (cost,) = [w for w in unknown.verdict.not_shown if "at 10° of tilt its error" in w]
    assert float(cost.split("heading is ")[1].split("°")[0]) > 0.5
    assert [words for words in unknown.verdict.not_shown if "reference field is not known" in words]


def test_a_calibration_made_in_another_field_is_reported(known):
    here = resolve(NOTHING, LOCAL, MUNICH, YEAR).field
    there = resolve(NOTHING, LOCAL, SYDNEY, YEAR).field
    calibration = known.calibration
    assert calibration is not None
    assert made_elsewhere(calibration, here) == ""
    words = made_elsewhere(calibration, there)
    assert "if it was made elsewhere" in words
    assert "inclination 64" in words
    assert "inclination -64" in words
    assert made_elsewhere(calibration, ReferenceField()) == ""
    assert made_elsewhere(calibration, dataclasses.replace(there, strength=Belief(5e-5))) == ""


def test_a_field_distorted_by_steel_is_no_other_place(known):
    """The one that is found may be far from the reference, here as well as at any other time."""
    here = resolve(NOTHING, LOCAL, MUNICH, YEAR).field
    weak = dataclasses.replace(known.calibration, strength=44e-6)
    assert made_elsewhere(weak, here) == ""
    there = resolve(NOTHING, LOCAL, SYDNEY, YEAR).field
    assert "inclination 64" in made_elsewhere(weak, there)


def test_without_a_stored_reference_the_estimated_field_is_used(known):
    here = resolve(NOTHING, LOCAL, MUNICH, YEAR).field
    evidence = dataclasses.replace(known.calibration.evidence, figures={})
    old = dataclasses.replace(known.calibration, evidence=evidence)
    assert made_elsewhere(old, here) == ""
    assert "44.0 µT" in made_elsewhere(dataclasses.replace(old, strength=44e-6), here)


def test_a_calibration_without_a_reference_shows_no_place(unknown):
    calibration = unknown.calibration
    there = resolve(NOTHING, LOCAL, SYDNEY, YEAR).field
    assert calibration is None or made_elsewhere(calibration, there) == ""
