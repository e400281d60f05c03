import math
import os
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from examples import examples
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from magcal_ros.core import Calibration, Correction
from magcal_ros.core.calibration import Evidence, MotorField, MotorInput
from magcal_ros.core.heading import VehicleYaw
from magcal_ros.files import (
    BOUNDS,
    LARGEST_FILE,
    FileError,
    Origin,
    read_calibration,
    write_calibration,
)

pytestmark = pytest.mark.faults

ORIGIN = Origin("mag_link", "imu_link", "2024-05-01T12:00:00+00:00")

finite = st.floats(allow_nan=False, allow_infinity=False)
positive = st.floats(0.0, 0.1)
strengths = st.floats(BOUNDS.weakest_field, BOUNDS.strongest_field)
irons = st.floats(-5e-4, 5e-4)
dips = st.floats(-math.pi / 2, math.pi / 2)
small = st.floats(-0.3, 0.3)
words = st.text(max_size=40)


def random_covariance(seed):
    mix = np.random.default_rng(seed).standard_normal((12, 12))
    return mix @ mix.T * 1e-14


calibrations = st.builds(
    Calibration,
    st.builds(
        lambda matrix, iron: Correction(np.eye(3) + np.reshape(matrix, (3, 3)), np.array(iron)),
        st.tuples(*[small] * 9),
        st.tuples(*[irons] * 3),
    ).filter(lambda correction: np.linalg.norm(correction.matrix, -2) > BOUNDS.smallest_gain),
    st.integers(0, 2**31).map(random_covariance),
    st.floats(0.0, 1e-4),
    positive,
    strengths,
    dips,
    st.builds(
        Evidence,
        words,
        words,
        words,
        words,
        st.lists(words, max_size=3).map(tuple),
        st.lists(words, max_size=3).map(tuple),
        st.booleans(),
        st.dictionaries(words, st.floats(allow_nan=False), max_size=4),
    ),
)


def example():
    return Calibration(
        Correction(np.eye(3) + 0.01, np.array([3.1e-5, -2e-5, 1e-7])),
        random_covariance(1),
        0.3e-6,
        0.01,
        48e-6,
        1.1,
        Evidence("design_tip", "good", "excellent", "Fine.", ("a", "b"), ("c",), False, {"x": 0.1}),
    )


@pytest.fixture
def written(tmp_path):
    path = tmp_path / "mag.yaml"
    write_calibration(path, example(), ORIGIN)
    return path


def everything(calibration):
    """All of a calibration, to be compared with ==."""
    return (
        calibration.correction.parameters.tobytes(),
        calibration.covariance.tobytes(),
        calibration.noise_field,
        calibration.noise_up,
        calibration.strength,
        calibration.inclination,
        calibration.evidence,
        everything_of(calibration.motors),
    )


def everything_of(motors):
    if motors is None:
        return None
    arrays = motors.gain, motors.covariance, motors.cross_covariance
    return (
        *(each.tobytes() for each in arrays),
        motors.inputs,
        motors.ripple,
        motors.usual,
        motors.reference,
    )


def with_motors():
    mix = np.random.default_rng(2).standard_normal((18, 18))
    joint = mix @ mix.T * 1e-14
    gain = [[5e-6, -1e-6, 2e-7], [0.0, 3e-6, 0.0]]
    motors = MotorField(
        (MotorInput.MOVING, MotorInput.CURRENT),
        gain,
        joint[12:, 12:],
        joint[:12, 12:],
        2e-7,
        (1.0, 0.4),
        -0.5,
    )
    return replace(example(), covariance=joint[:12, :12], motors=motors)


def with_change(path, change):
    document = yaml.safe_load(path.read_text())
    change(document)
    path.write_text(yaml.safe_dump(document))


class TestRoundTrip:
    @examples(4, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
    @given(calibration=calibrations, frames=st.tuples(words, words))
    def test_all_numbers_and_texts_are_recovered_exactly(self, tmp_path, calibration, frames):
        path, origin = tmp_path / "mag.yaml", Origin(*frames, ORIGIN.created)
        write_calibration(path, calibration, origin)
        found, found_origin = read_calibration(path)
        assert everything(found) == everything(calibration)
        assert found_origin == origin

    @pytest.mark.parametrize(
        "odd", ["a\x85b", "\x85", "a\u2028 b", "\ufeff", "a\n\n b\r", "\0", "1e5"]
    )
    def test_line_breaks_and_control_characters_are_recovered(self, tmp_path, odd):
        write_calibration(tmp_path / "a", example(), Origin(odd, "imu", odd))
        assert read_calibration(tmp_path / "a")[1] == Origin(odd, "imu", odd)

    def test_a_printable_text_is_readable_in_the_file(self, tmp_path):
        write_calibration(tmp_path / "a", example(), Origin("größe 5 µT", "imu", "now"))
        assert "field_raw: größe 5 µT" in (tmp_path / "a").read_text()

    def test_a_figure_that_is_nan_is_recovered(self, tmp_path):
        one = example()
        one.evidence.figures["y"] = math.nan
        write_calibration(tmp_path / "a", one, ORIGIN)
        assert math.isnan(read_calibration(tmp_path / "a")[0].evidence.figures["y"])

    def test_the_motor_field_is_recovered(self, tmp_path):
        write_calibration(tmp_path / "a", with_motors(), ORIGIN)
        assert everything(read_calibration(tmp_path / "a")[0]) == everything(with_motors())

    def test_without_a_reference_current_it_is_that_at_rest(self, tmp_path):
        write_calibration(tmp_path / "a", with_motors(), ORIGIN)
        with_change(tmp_path / "a", lambda document: document["motors"].pop("reference_current"))
        assert math.isnan(read_calibration(tmp_path / "a")[0].motors.reference)

    @pytest.mark.parametrize(
        "change",
        [
            lambda motors: motors.pop("field"),
            lambda motors: motors.update(inputs=["moving", "moving"]),
            lambda motors: motors.update(inputs=["moving", "colour"]),
            lambda motors: motors["field"].pop(),
            lambda motors: motors.update(ripple=math.nan),
            lambda motors: motors["field"][0].__setitem__(0, 1.0),
            lambda motors: motors["covariance"][0].__setitem__(1, 1.0),
            lambda motors: motors.update(usual=[1.0]),
            lambda motors: motors.update(reference_current=math.inf),
        ],
    )
    def test_impossible_motors_are_refused(self, tmp_path, change):
        write_calibration(tmp_path / "a", with_motors(), ORIGIN)
        with_change(tmp_path / "a", lambda document: change(document["motors"]))
        with pytest.raises(FileError, match="not a usable calibration"):
            read_calibration(tmp_path / "a")

    def test_a_missing_folder_is_created(self, tmp_path):
        path = tmp_path / "a" / "b" / "mag.yaml"
        write_calibration(path, example(), ORIGIN)
        assert everything(read_calibration(path)[0]) == everything(example())

    def test_the_bias_at_top_level_is_the_hard_iron(self, written):
        document = yaml.safe_load(written.read_text())
        bias = [document[f"magnetometer_bias_{axis}"] for axis in "xyz"]
        assert bias == document["hard_iron"] == example().correction.hard_iron.tolist()

    def test_the_file_names_its_format(self, written):
        text = written.read_text()
        assert text.startswith("# Magnetometer calibration by magcal_ros.")
        document = yaml.safe_load(text)
        assert document["format"] == "magcal_ros/calibration"
        assert document["frames"] == {"field_raw": "mag_link", "field_body": "imu_link"}

    def test_now_is_utc_in_iso_8601(self):
        created = Origin.now("a", "b").created
        assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", created)


class TestDamage:
    @pytest.mark.parametrize(
        ("figures", "step"), [({}, 211), pytest.param({"x": 0.125}, 1, marks=pytest.mark.nightly)]
    )
    def test_a_truncated_file_is_an_error_and_never_another_calibration(
        self, tmp_path, figures, step
    ):
        one = replace(example(), covariance=np.eye(12) * 1e-14)
        one.evidence.figures.clear()
        one.evidence.figures.update(figures)
        path = tmp_path / "mag.yaml"
        write_calibration(path, one, ORIGIN)
        whole = path.read_bytes()
        outside = len(whole) - len(b"\n")
        cuts = [*range(0, outside, step), *range(outside - 20, outside)]
        for length in cuts:
            path.write_bytes(whole[:length])
            with pytest.raises(FileError):
                read_calibration(path)
        path.write_bytes(whole[:outside])
        assert everything(read_calibration(path)[0]) == everything(one)

    @examples(15, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(where=st.floats(0.0, 1.0), junk=st.binary(min_size=1, max_size=6))
    def test_overwritten_bytes_raise_only_a_file_error(self, written, where, junk):
        whole = written.read_bytes()
        at = int(where * (len(whole) - len(junk)))
        damaged = written.parent / "damaged.yaml"
        damaged.write_bytes(whole[:at] + junk + whole[at + len(junk) :])
        try:
            found, _ = read_calibration(damaged)
        except FileError:
            return
        assert np.isfinite(found.correction.parameters).all()

    @examples(15, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(
        value=st.one_of(
            st.none(), st.booleans(), st.text(max_size=5), st.lists(st.integers(), max_size=3),
            st.just(10**400), st.just({}), st.just({"a": 1}),
        ),
        data=st.data(),
    )  # fmt: skip
    def test_any_content_of_an_entry_raises_only_a_file_error(self, written, value, data):
        document = yaml.safe_load(written.read_text())
        place = data.draw(st.sampled_from([document, document["evidence"], document["reference"]]))
        place[data.draw(st.sampled_from(sorted(place)))] = value
        changed = written.parent / "changed.yaml"
        changed.write_text(yaml.safe_dump(document))
        try:
            found, _ = read_calibration(changed)
        except FileError:
            return
        assert np.isfinite(found.correction.parameters).all()

    @pytest.mark.parametrize(
        "key",
        [
            "format", "created", "frames", "hard_iron", "correction_matrix",
            "covariance", "noise_field", "noise_up", "reference", "method", "evidence",
            "magnetometer_bias_x", "magnetometer_bias_y", "magnetometer_bias_z",
        ],
    )  # fmt: skip
    def test_a_missing_entry_is_an_error(self, written, key):
        with_change(written, lambda document: document.pop(key))
        with pytest.raises(FileError, match=key):
            read_calibration(written)

    @pytest.mark.parametrize("change", [{"frames": None}, {"frames": {"field_raw": None}}])
    def test_an_entry_without_a_value_is_missing(self, written, change):
        with_change(written, lambda document: document.update(change))
        with pytest.raises(FileError, match=r"'(frames|field_raw)' is missing"):
            read_calibration(written)

    @pytest.mark.parametrize(
        "text",
        [
            "", "\n", "---\n", "[1, 2]", "hello", "a: 1", "\0", "{", "- &a [*a]", "%YAML 9.9",
            "mag: {hard_iron: [1, 2, 3]}", "!!timestamp foo", "!!bool maybe", '!!int ""',
            "[" * 5000, "? [1]\n: 2",
        ],
    )  # fmt: skip
    def test_something_else_is_not_taken_for_a_calibration(self, tmp_path, text):
        path = tmp_path / "mag.yaml"
        path.write_text(text)
        with pytest.raises(FileError, match="is not a usable calibration"):
            read_calibration(path)

    def test_bytes_that_are_not_text_are_an_error(self, tmp_path):
        path = tmp_path / "mag.yaml"
        path.write_bytes(bytes(range(256)))
        with pytest.raises(FileError):
            read_calibration(path)

    @pytest.mark.parametrize("version", [0, 2, "1", None, "one"])
    def test_another_version_is_named(self, written, version):
        with_change(written, lambda document: document.update(format_version=version))
        with pytest.raises(FileError, match=re.escape(f"its format version is {version!r}")):
            read_calibration(written)

    def test_the_error_names_the_file_and_the_remedy(self, written):
        written.write_text(written.read_text()[:300])
        with pytest.raises(FileError, match="Calibrate again to replace it") as caught:
            read_calibration(written)
        assert str(written) in str(caught.value)

    def test_the_user_is_not_told_to_replace_a_file_that_is_never_replaced(self, tmp_path):
        path = tmp_path / "parameters.yaml"
        path.write_text("a: 1")
        with pytest.raises(FileError, match=r"calibration'\. Name another file\.$"):
            read_calibration(path)
        with pytest.raises(FileError, match="was not changed; choose another name"):
            write_calibration(path, example(), ORIGIN)


class TestHostileYaml:
    def test_an_entry_that_is_given_twice_is_an_error(self, written):
        """The last one counted, without a word: two versions joined in an editor, for example."""
        identity = "correction_matrix: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n"
        written.write_text(written.read_text() + identity)
        with pytest.raises(FileError, match="'correction_matrix' is given twice"):
            read_calibration(written)

    def test_an_alias_bomb_is_not_expanded(self, written):
        rows = ["bomb0: &b0 [1, 1]"]
        rows += [f"bomb{k}: &b{k} [{', '.join([f'*b{k - 1}'] * 9)}]" for k in range(1, 12)]
        written.write_text(written.read_text() + "\n".join(rows))
        with pytest.raises(FileError, match="aliases do not belong"):
            read_calibration(written)

    @pytest.mark.parametrize(
        "tag",
        [
            "!!python/object/apply:os.mkdir ['{folder}/made']",
            "!!python/object/new:os.mkdir ['{folder}/made']",
            "!!python/name:os.system ''",
        ],
    )
    def test_python_tags_are_not_executed(self, written, tag):
        with written.open("a") as handle:
            handle.write("extra: " + tag.format(folder=written.parent) + "\n")
        with pytest.raises(FileError, match="could not determine a constructor"):
            read_calibration(written)
        assert not (written.parent / "made").exists()

    def test_a_huge_file_is_not_read(self, written):
        with written.open("a") as handle:
            handle.write("#" * LARGEST_FILE)
        with pytest.raises(FileError, match="too large"):
            read_calibration(written)


class TestInTheWay:
    def test_a_missing_file_is_an_error(self, tmp_path):
        with pytest.raises(FileError, match="No such file"):
            read_calibration(tmp_path / "none.yaml")

    def test_a_directory_instead_of_the_file_is_an_error_and_is_kept(self, tmp_path):
        folder = tmp_path / "mag.yaml"
        (folder / "inside").mkdir(parents=True)
        with pytest.raises(FileError, match="Is a directory"):
            read_calibration(folder)
        with pytest.raises(FileError, match="is not a calibration of magcal_ros"):
            write_calibration(folder, example(), ORIGIN)
        assert os.listdir(tmp_path) == ["mag.yaml"]
        assert (folder / "inside").is_dir()

    @pytest.mark.skipif(sys.platform != "linux", reason="needs /dev/zero")
    def test_a_device_or_a_pipe_is_an_immediate_error(self, tmp_path):
        pipe = tmp_path / "pipe"
        os.mkfifo(pipe)
        for path in (pipe, Path("/dev/zero")):
            with pytest.raises(FileError, match="not a regular file"):
                read_calibration(path)


class TestHandEdited:
    def test_integers_are_accepted_as_numbers(self, written):
        """YAML 1.1 takes 1e-5 for a text."""
        text = written.read_text().replace("3.1e-05", "3e-5").replace("0.01\n", "1e-2\n")
        assert "hard_iron: [3e-5," in text
        assert "noise_up: 1e-2" in text
        written.write_text(text)
        found, _ = read_calibration(written)
        assert found.correction.hard_iron[0] == 3e-5
        assert found.noise_up == 0.01

    def test_comments_and_integers_do_no_harm(self, written):
        written.write_text(
            "# mine\n" + written.read_text().replace("noise_up: 0.01", "noise_up: 1")
        )
        assert read_calibration(written)[0].noise_up == 1.0

    @pytest.mark.parametrize("bad", [".nan", ".inf", "-.inf", "nan", "inf", "yes", "~", "1,5", "x"])
    @pytest.mark.parametrize(
        "entry", ["noise_field", "noise_up", "strength", "inclination", "hard_iron"]
    )
    def test_an_entry_that_is_not_finite_is_an_error(self, written, entry, bad):
        pattern = rf"({entry}: \[?)[^,\n}}\]]+"
        text, count = re.subn(pattern, rf"\g<1>'{bad}'" if bad == "1,5" else rf"\g<1>{bad}",
                              written.read_text())  # fmt: skip
        assert count >= 1
        written.write_text(text)
        with pytest.raises(FileError):
            read_calibration(written)

    @pytest.mark.parametrize("bad", [math.nan, math.inf, "x", None])
    @pytest.mark.parametrize("entry", ["correction_matrix", "covariance"])
    def test_an_incomplete_matrix_is_an_error(self, written, entry, bad):
        with_change(written, lambda document: document[entry][1].__setitem__(2, bad))
        with pytest.raises(FileError):
            read_calibration(written)

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            (lambda d: d["covariance"][4].__setitem__(4, -1e-9), "negative variance"),
            (lambda d: d["covariance"].pop(), "covariance"),
            (lambda d: d["hard_iron"].append(0.0), "hard iron"),
            (lambda d: d.update(correction_matrix=[[0.0] * 3] * 3), "aliases|singular"),
            (lambda d: d["correction_matrix"].reverse(), "mirrors"),
            (lambda d: d["correction_matrix"][0].pop(), "inhomogeneous"),
            (lambda d: d.update(magnetometer_bias_y=1e-6), "contradict"),
            (lambda d: d["hard_iron"].__setitem__(0, 3.2e-5), "contradict"),
            (lambda d: d.update(noise_up=-0.1), "noise_up must be zero or more"),
            (lambda d: d["reference"].update(strength=-4e-5), "strength must be zero or more"),
        ],
    )
    def test_impossible_numbers_are_an_error(self, written, change, words):
        with_change(written, change)
        with pytest.raises(FileError, match=words):
            read_calibration(written)


class TestWhatBelongsToOthers:
    @pytest.mark.parametrize(
        "content",
        [
            "/**:\n  ros__parameters:\n    speed: 1.0\n",
            "#!/bin/sh\nrm -rf build\n",
            "\0\1\2",
            "hello",
            "text: 'format: magcal_ros/calibration'\n",
            "format: magcal_ros/calibrations_of_mine\n",
            "x" * (LARGEST_FILE + 1),
        ],
    )
    def test_a_file_of_another_program_is_never_replaced(self, tmp_path, content):
        path = tmp_path / "robot_params.yaml"
        path.write_text(content)
        with pytest.raises(FileError, match="is not a calibration of magcal_ros") as caught:
            write_calibration(path, example(), ORIGIN)
        assert "choose another name" in str(caught.value)
        assert path.read_text() == content

    def test_a_pipe_is_neither_opened_nor_replaced(self, tmp_path):
        pipe = tmp_path / "pipe"
        os.mkfifo(pipe)
        with pytest.raises(FileError, match="is not a calibration of magcal_ros"):
            write_calibration(pipe, example(), ORIGIN)
        with pytest.raises(FileError, match="not a regular file"):
            read_calibration(pipe)
        assert pipe.is_fifo()

    def test_a_damaged_or_empty_calibration_file_is_replaced(self, tmp_path, written):
        path = tmp_path / "mag.yaml"
        whole = written.read_bytes()
        for content in (b"", b"\n", whole, whole[:200], whole.partition(b"format:")[0]):
            path.write_bytes(content)
            write_calibration(path, example(), ORIGIN)
            assert everything(read_calibration(path)[0]) == everything(example())


class TestBombs:
    @pytest.mark.parametrize(
        "bomb",
        [
            "[" * 40_000,
            "{a: " * 20_000,
            "- " * 40_000,
            "? " * 40_000,
            "".join(" " * k + f"a{k}:\n" for k in range(300)),
            "[" * 9 + "[],".join([""] * 30_000),
        ],
        ids=["lists", "maps", "dashes", "keys", "indents", "many"],
    )
    def test_deep_nesting_is_refused(self, tmp_path, bomb):
        path = tmp_path / "mag.yaml"
        path.write_text("format: magcal_ros/calibration\nx: " + bomb)
        with pytest.raises(FileError, match="is not a usable calibration"):
            read_calibration(path)


def test_the_file_names_the_node(tmp_path):
    path, origin = tmp_path / "mag.yaml", replace(ORIGIN, node="/robot/left")
    write_calibration(path, example(), origin)
    assert read_calibration(path)[1] == origin


def test_a_large_file_of_another_program_is_not_parsed(tmp_path, monkeypatch):
    path = tmp_path / "params.yaml"
    path.write_text("x: [" + "1.0, " * ((LARGEST_FILE - 100) // 5) + "1.0]\n")
    monkeypatch.setattr(yaml, "load", None)
    with pytest.raises(FileError, match="does not say 'format: magcal_ros/calibration'"):
        read_calibration(path)


class TestUpward:
    """The direction of the vehicle's top is stored, for an IMU that does not lie flat."""

    def test_it_is_recovered_exactly(self, tmp_path):
        path, upward = tmp_path / "side.yaml", np.array([0.6, 0.0, -0.8])
        write_calibration(path, replace(example(), upward=upward), ORIGIN)
        assert read_calibration(path)[0].upward.tolist() == upward.tolist()

    @pytest.mark.parametrize(
        ("entry", "upward"),
        [("", [0.0, 0.0, 1.0]), ("upward: [0, 0, 2]", None), ("upward: [.nan, 0, 1]", None)],
    )
    def test_it_is_z_in_older_files_and_a_unit_vector(self, written, entry, upward):
        (line,) = re.findall("^upward: .*$", text := written.read_text(), re.MULTILINE)
        written.write_text(text.replace(line, entry))
        if upward is None:
            with pytest.raises(FileError):
                read_calibration(written)
        else:
            assert read_calibration(written)[0].upward.tolist() == upward


class TestVehicleYaw:
    """The yaw of the IMU in the vehicle is stored separately, not in the matrix."""

    ORIGIN = replace(ORIGIN, vehicle_yaw=VehicleYaw(0.123456789, 0.01, "course"))

    def test_the_yaw_is_recovered_exactly_and_changes_nothing_else(self, tmp_path, written):
        path = tmp_path / "with.yaml"
        write_calibration(path, example(), self.ORIGIN)
        calibration, origin = read_calibration(path)
        assert origin == self.ORIGIN
        assert everything(calibration) == everything(read_calibration(written)[0])

    def test_older_files_have_no_vehicle_yaw(self, written):
        assert "vehicle_yaw_offset" not in written.read_text()
        assert read_calibration(written)[1].vehicle_yaw is None

    @pytest.mark.parametrize(
        "entry",
        ["3", "{yaw: .nan, sigma: 0.1, source: course}", "{yaw: 0.1}", "[1, 2]",
         "{yaw: 70.0, sigma: 0.1, source: course}", "{yaw: 0.1, sigma: -1.0, source: course}"],
    )  # fmt: skip
    def test_an_invalid_vehicle_yaw_is_an_error(self, written, entry):
        written.write_text(written.read_text() + f"vehicle_yaw_offset: {entry}\n")
        with pytest.raises(FileError):
            read_calibration(written)
