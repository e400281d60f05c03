import array
import math

import pytest

pytest.importorskip("rclpy")

from magcal_ros.core.geometry import rotation_from_rpy
from magcal_ros.ros.parameter_table import PARAMETERS, ParameterSpec
from magcal_ros.ros.parameters import Settings

NUMBERS = [s for s in PARAMETERS if isinstance(s.default, float)]
LISTS = [s for s in PARAMETERS if isinstance(s.default, tuple)]
TEXTS = [s for s in PARAMETERS if isinstance(s.default, str)]
WHOLE = [s for s in PARAMETERS if type(s.default) is int]
SWITCHES = [s for s in PARAMETERS if isinstance(s.default, bool)]
DEFAULTS = {spec.name: spec.default for spec in PARAMETERS}


def rows(specs):
    return pytest.mark.parametrize("spec", specs, ids=lambda spec: spec.name)


def is_same(a, b):
    return a == b or (a != a and b != b)


def just_below(value):
    return value - max(1e-6, 1e-6 * abs(value))


def just_above(value):
    return value + max(1e-6, 1e-6 * abs(value))


@rows(PARAMETERS)
def test_every_row_accepts_its_own_default(spec):
    assert is_same(spec.parse(spec.default), spec.default)
    assert spec.description


def test_names_are_unique_and_every_row_is_of_a_known_kind():
    kinds = (NUMBERS, WHOLE, LISTS, TEXTS, SWITCHES)
    assert len(DEFAULTS) == len(PARAMETERS) == sum(len(kind) for kind in kinds)


def test_a_switch_accepts_only_true_and_false():
    spec = ParameterSpec("moves", False)
    assert [spec.parse(True), spec.parse(False), spec.yaml_default] == [True, False, "false"]
    for wrong in (1, 0.0, "true", None):
        with pytest.raises(ValueError, match="moves must be true or false"):
            spec.parse(wrong)


@rows(PARAMETERS)
@pytest.mark.parametrize("huge", ["x" * 10**6, [1.0] * 10**5, ["\x1b[2J" * 10**5] * 9])
def test_a_huge_value_is_refused_in_few_words(spec, huge):
    with pytest.raises(ValueError, match=spec.name) as refused:
        spec.parse(huge)
    assert len(str(refused.value)) < 5000
    assert str(refused.value).isprintable()


@rows(NUMBERS)
class TestNumbers:
    def test_integers_are_numbers(self, spec):
        value = math.ceil(spec.span.low)
        found = spec.parse(value)
        assert (found, type(found)) == (float(value), float)

    def test_both_ends_belong_to_the_range(self, spec):
        assert (spec.parse(spec.span.low), spec.parse(spec.span.high)) == (
            spec.span.low,
            spec.span.high,
        )

    def test_infinity_is_out_of_range(self, spec):
        for outside in (math.inf, -math.inf):
            with pytest.raises(ValueError, match="must lie between"):
                spec.parse(outside)

    def test_a_value_outside_is_refused_with_the_range_and_its_unit(self, spec):
        for value in (just_below(spec.span.low), just_above(spec.span.high)):
            with pytest.raises(ValueError, match="must lie between") as caught:
                spec.parse(value)
            words = str(caught.value)
            assert words.startswith(
                f"{spec.name} must lie between {spec.span.low:g} and {spec.span.high:g}"
            )
            assert spec.span.unit in words

    def test_nan_is_allowed_only_if_it_means_unknown(self, spec):
        if math.isnan(spec.default):
            assert math.isnan(spec.parse(math.nan))
        else:
            with pytest.raises(ValueError, match="must lie between"):
                spec.parse(math.nan)

    def test_another_type_is_refused(self, spec):
        for wrong in ("one", "", True, None, [1.0], (1.0,), b"1"):
            with pytest.raises(ValueError, match=f"{spec.name} must be a number"):
                spec.parse(wrong)

    def test_a_number_given_as_text_is_accepted(self, spec):
        """YAML 1.1 leaves 1e-05 a text, and `ros2 param load` sends NaN as one."""
        middle = (spec.span.low + spec.span.high) / 2.0
        assert spec.parse(f"{middle:.17e}") == middle
        for text in ("nan", ".nan", "NaN", ".NaN"):
            if spec.may_be_unset:
                assert math.isnan(spec.parse(text))
            else:
                with pytest.raises(ValueError, match="must lie between"):
                    spec.parse(text)

    def test_an_integer_beyond_all_floats_is_out_of_range(self, spec):
        with pytest.raises(ValueError, match="must lie between"):
            spec.parse(10**400)


@rows(WHOLE)
class TestWholeNumbers:
    def test_both_ends_belong_to_the_range_and_stay_integers(self, spec):
        for end in (spec.span.low, spec.span.high):
            assert (spec.parse(end), type(spec.parse(float(end)))) == (end, int)

    def test_a_fraction_is_refused(self, spec):
        for wrong in (1.5, "x", True, None, math.nan, math.inf, [1]):
            with pytest.raises(ValueError, match=f"{spec.name} must be a whole number"):
                spec.parse(wrong)

    def test_a_value_outside_is_refused(self, spec):
        for value in (spec.span.low - 1, spec.span.high + 1):
            with pytest.raises(ValueError, match="must lie between"):
                spec.parse(value)


def test_a_list_is_shown_as_it_is_typed():
    spec = ParameterSpec("mount_rpy_deg", (0.0, 0.0, 0.0))
    for wrong in (array.array("q", [1, 1]), [1, 1], (1, 1)):
        with pytest.raises(ValueError, match=r"must be 3 numbers, .* not \[1, 1\]$"):
            spec.parse(wrong)
    with pytest.raises(ValueError, match=r"not \[true, 'a'\]$"):
        spec.parse([True, "a"])
    with pytest.raises(ValueError, match=r"not nothing$"):
        spec.parse(None)


def test_a_list_of_mixed_numbers_given_as_text_is_accepted():
    spec = ParameterSpec("mount_rpy_deg", (0.0, 0.0, 0.0))
    assert spec.parse("[0, 0.5, -1e-3]") == (0.0, 0.5, -0.001)


@rows(LISTS)
class TestLists:
    @pytest.mark.parametrize("make", [list, tuple, lambda v: array.array("q", v)])
    def test_integers_are_numbers(self, spec, make):
        found = spec.parse(make([1] * len(spec.default)))
        assert found == (1.0,) * len(spec.default)
        assert {type(value) for value in found} == {float}

    def test_an_array_of_doubles_is_a_list(self, spec):
        assert spec.parse(array.array("d", spec.default)) == spec.default

    def test_another_length_or_type_is_refused(self, spec):
        for wrong in ([], [1.0] * 2, [1.0] * 4, "111", 1.0, None, {}):
            with pytest.raises(ValueError, match=f"{spec.name} must be 3 numbers"):
                spec.parse(wrong)

    @pytest.mark.parametrize("bad", ["x", True, None, math.nan, math.inf])
    def test_a_list_with_one_bad_number_is_refused(self, spec, bad):
        for place in range(3):
            values = [1.0] * len(spec.default)
            values[place] = bad
            with pytest.raises(ValueError, match=spec.name):
                spec.parse(values)

    def test_each_number_must_lie_in_the_range(self, spec):
        for bad in (just_below(spec.span.low), just_above(spec.span.high)):
            with pytest.raises(ValueError, match="must lie between"):
                spec.parse([*spec.default[:2], bad])


@rows(TEXTS)
class TestTexts:
    def test_another_type_is_refused(self, spec):
        for wrong in (1, 1.0, True, None, ["a"], b"a"):
            with pytest.raises(ValueError, match=f"{spec.name} must be a text"):
                spec.parse(wrong)

    def test_only_the_choices_are_accepted(self, spec):
        for choice in spec.choices:
            assert spec.parse(choice) == choice
        if spec.choices:
            with pytest.raises(ValueError, match="must be one of"):
                spec.parse("no_such_choice")
        else:
            assert spec.parse("no_such_choice") == "no_such_choice"


def test_off_is_accepted_as_ros_reads_it():
    """`-p self_calibration:=off` and `self_calibration: off` in a file arrive as a boolean."""
    spec = next(each for each in PARAMETERS if each.name == "self_calibration")
    assert spec.parse(False) == "off"


def test_a_spec_without_a_range_takes_any_number():
    assert ParameterSpec("x", 0.0).parse(-1e300) == -1e300


def settings(**changes):
    values = {name.replace("__", "."): value for name, value in changes.items()}
    return Settings.of(DEFAULTS | values)


class TestSettings:
    def test_the_defaults_have_no_reference_field(self):
        reference = settings().knowledge.reference
        assert reference.strength.is_unknown
        assert reference.inclination.is_unknown
        assert reference.declination is None

    def test_microtesla_and_degrees_become_tesla_and_radians(self):
        reference = settings(
            reference__strength_ut=48.0,
            reference__strength_sigma_ut=7.0,
            reference__inclination_deg=-60.0,
            reference__inclination_sigma_deg=5.0,
            reference__declination_deg=12.0,
        ).knowledge.reference
        assert reference.strength.value == pytest.approx(48e-6)
        assert reference.strength.sigma == pytest.approx(7e-6)
        assert reference.inclination.value == pytest.approx(math.radians(-60.0))
        assert reference.inclination.sigma == pytest.approx(math.radians(5.0))
        assert reference.declination == pytest.approx(math.radians(12.0))

    def test_a_declination_of_zero_is_known(self):
        assert settings(reference__declination_deg=0.0).knowledge.reference.declination == 0.0

    def test_the_mounting_is_a_urdf_pose_in_degrees(self):
        changes = {"mount_rpy_deg": (180.0, 10.0, -90.0), "soft_iron_gains": (0.5, 1.2, 0.9)}
        mounting = settings(**changes).knowledge.mounting
        expected = rotation_from_rpy(math.pi, math.radians(10.0), -math.pi / 2)
        assert mounting.pose == pytest.approx(expected)
        assert mounting.gains.tolist() == [0.5, 1.2, 0.9]

    def test_the_windows_limits_are_seconds(self):
        changes = {"window__timeout_s": 33.0, "window__silence_s": 4.0, "window__max_gap_s": 0.5}
        found = settings(**changes)
        assert (found.limits.timeout, found.limits.silence, found.max_gap) == (33.0, 4.0, 0.5)

    def test_texts_are_unchanged(self):
        found = settings(calibration_file="/a/b.yaml")
        assert (found.calibration_file, found.method) == ("/a/b.yaml", DEFAULTS["method"])
