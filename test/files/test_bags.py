import builtins
import math

import numpy as np
import pytest
from drives import STORE2, drive, message, text, write_bag, write_csv

from magcal_ros.core.errors import UsageError
from magcal_ros.core.samples import FieldSample, ImuSample
from magcal_ros.files import FileError, open_recording, printable

pytestmark = pytest.mark.faults

KINDS = ["mcap", "sqlite3", "ros1"]


@pytest.fixture(scope="module")
def samples():
    return drive(60.0)


def read(path, **options):
    with open_recording(path, **options) as source:
        return list(source.readings()), source


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_gives_the_recorded_samples(tmp_path, samples, kind):
    readings, source = read(write_bag(tmp_path / "bag", samples, kind))
    assert (source.imu_topic, source.field_topic) == ("/imu/data_raw", "/imu/mag")
    assert (source.imu_frame, source.field_frame) == ("imu_link", "mag_link")
    assert source.count == len(samples)
    assert len(readings) == len(samples)
    for one, other in zip(readings, samples, strict=True):
        assert type(one) is type(other)
        assert one[1:] == other[1:]
        assert one.stamp == pytest.approx(other.stamp, abs=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_a_span_counts_from_the_beginning(tmp_path, samples, kind):
    readings, _ = read(write_bag(tmp_path / "bag", samples, kind), start=0.5, stop=1.25)
    first = samples[0].stamp
    assert readings[0].stamp - first == pytest.approx(0.5, abs=0.021)
    assert readings[-1].stamp - first == pytest.approx(1.25, abs=0.021)
    csv, _ = read(write_csv(tmp_path / "csv", samples), start=0.5, stop=1.25)
    assert abs(len(csv) - len(readings)) <= 2


def test_the_file_in_the_folder_can_be_named(tmp_path, samples):
    folder = write_bag(tmp_path / "bag", samples)
    readings, _ = read(next(folder.glob("*.mcap")))
    assert len(readings) == len(samples)


def test_reading_starts_before_the_whole_bag_is_loaded(tmp_path, samples):
    """A damaged end is met only when it is reached."""
    with open_recording(write_bag(tmp_path / "bag", samples)) as source:
        assert isinstance(next(source.readings()), ImuSample)


def test_a_missing_gyro_or_acceleration_is_recognised(tmp_path, samples):
    gyroless = [s._replace(rate=(math.nan,) * 3) for s in samples if isinstance(s, ImuSample)]
    mute = message(STORE2, gyroless[0])
    mute.linear_acceleration_covariance = np.r_[-1.0, np.zeros(8)]
    fields = [s for s in samples if isinstance(s, FieldSample)]
    content = [*gyroless, ("/imu/data_raw", mute), *fields]
    readings, _ = read(write_bag(tmp_path / "bag", content))
    assert readings.count(None) == 1
    assert all(math.isnan(r.rate[0]) for r in readings if isinstance(r, ImuSample))


class TestTopics:
    def test_several_topics_are_listed_and_none_is_guessed(self, tmp_path, samples):
        other = ("/camera/imu", message(STORE2, samples[0]))
        path = write_bag(tmp_path / "bag", [*samples, other])
        with pytest.raises(UsageError, match=r"2 topics .*/camera/imu, /imu/data_raw.*--imu"):
            read(path)
        readings, _ = read(path, imu="/camera/imu")
        assert sum(isinstance(r, ImuSample) for r in readings) == 1

    @pytest.mark.parametrize(("missing", "word"), [(ImuSample, "Imu"), (FieldSample, "Magnetic")])
    def test_a_missing_topic_is_named_with_the_existing_ones(
        self, tmp_path, samples, missing, word
    ):
        left = [s for s in samples if not isinstance(s, missing)]
        path = write_bag(tmp_path / "bag", [*left, ("/words", text(STORE2, "hello"))])
        with pytest.raises(FileError, match=rf"no sensor_msgs/{word}.*/words \(std_msgs"):
            read(path)

    def test_a_chosen_topic_must_exist_and_have_the_right_type(self, tmp_path, samples):
        path = write_bag(tmp_path / "bag", [*samples, ("/words", text(STORE2, "hello"))])
        with pytest.raises(FileError, match=r"no topic /nowhere; it has: .*/imu/mag"):
            read(path, field="/nowhere")
        with pytest.raises(FileError, match="/words is std_msgs/msg/String, not sensor_msgs"):
            read(path, imu="/words")

    def test_topics_are_refused_for_a_csv_folder(self, tmp_path, samples):
        with pytest.raises(UsageError, match="without topics"):
            read(write_csv(tmp_path / "csv", samples), imu="/imu")

    @pytest.mark.parametrize("evil", ["/\x1b[2J\x1b]0;owned\x07", "/a\r\nb", "/\u202eimu"])
    def test_hostile_names_are_not_printed_unchanged(self, tmp_path, samples, evil):
        other = (evil, message(STORE2, samples[0], frame=evil))
        with pytest.raises(UsageError) as caught:
            read(write_bag(tmp_path / "bag", [*samples, other]))
        assert str(caught.value).isprintable()
        left = [s for s in samples if not isinstance(s, ImuSample)]
        with open_recording(write_bag(tmp_path / "other", [*left, other])) as source:
            assert source.imu_topic.isprintable()


def test_printable_text_is_unchanged_and_long_text_cut():
    assert printable("/imu/data_raw ä µ") == "/imu/data_raw ä µ"
    assert printable("a\x1b[31mb\x9bc\n") == "a?[31mb?c?"
    assert len(printable("x" * 10_000)) < 300


class TestDamage:
    @pytest.mark.parametrize("share", [0.0, 0.001, 0.02, 0.3, 0.7, 0.99])
    @pytest.mark.parametrize("kind", KINDS)
    def test_a_truncated_file_is_reported(self, tmp_path, samples, kind, share):
        path = write_bag(tmp_path / "bag", samples, kind)
        file = path if path.is_file() else next(p for p in path.iterdir() if p.suffix != ".yaml")
        content = file.read_bytes()
        file.write_bytes(content[: int(share * len(content))])
        with pytest.raises(FileError, match=r"Record again; .* saves the intact part") as caught:
            read(path)
        assert str(caught.value).isprintable()

    @pytest.mark.parametrize("kind", KINDS)
    def test_wrong_bytes_give_samples_or_an_error_with_words(self, tmp_path, samples, kind):
        path = write_bag(tmp_path / "bag", samples[:60], kind)
        file = path if path.is_file() else next(p for p in path.iterdir() if p.suffix != ".yaml")
        content = np.frombuffer(file.read_bytes(), np.uint8)
        rng, stated = np.random.default_rng(1), []
        for _ in range(40):
            broken = content.copy()
            where = rng.integers(0, len(content), 20)
            broken[where] = rng.integers(0, 256, 20)
            file.write_bytes(broken.tobytes())
            try:
                read(path)
            except (FileError, UsageError) as error:
                stated.append(str(error))
        assert len(stated) > 5
        assert all(words.isprintable() for words in stated)

    @pytest.mark.parametrize("kind", KINDS)
    def test_an_empty_bag(self, tmp_path, kind):
        with pytest.raises(FileError, match=r"holds no messages|damaged"):
            read(write_bag(tmp_path / "bag", [], kind))

    def test_invalid_metadata(self, tmp_path, samples):
        path = write_bag(tmp_path / "bag", samples)
        (path / "metadata.yaml").write_text("rosbag2_bagfile_information: 7\n")
        with pytest.raises(FileError, match="damaged"):
            read(path)

    def test_other_files_and_folders_are_refused(self, tmp_path):
        with pytest.raises(FileError, match="no such file"):
            read(tmp_path / "nothing.mcap")
        with pytest.raises(FileError, match=r"is not a recording.*metadata\.yaml"):
            read(tmp_path)
        (tmp_path / "notes.txt").write_text("hello")
        with pytest.raises(FileError, match="is not a recording: name a bag"):
            read(tmp_path / "notes.txt")


def test_without_the_library_its_installation_is_explained(tmp_path, samples, monkeypatch):
    path, importing = write_bag(tmp_path / "bag", samples), builtins.__import__

    def lacking(name, *rest):
        if name.startswith("rosbags"):
            raise ImportError(name)
        return importing(name, *rest)

    monkeypatch.setattr(builtins, "__import__", lacking)
    with pytest.raises(FileError, match="source its setup file"):
        read(path)


class TestCsv:
    def test_a_csv_folder_gives_the_recorded_samples(self, tmp_path, samples):
        readings, source = read(write_csv(tmp_path / "csv", samples))
        assert readings == samples
        assert source.count == len(samples)

    @pytest.mark.parametrize("start", [0.0, -5.0])
    def test_time_may_begin_at_zero_or_before(self, tmp_path, start):
        shifted = drive(60.0, start=start)
        readings, _ = read(write_csv(tmp_path / "csv", shifted))
        stamps = np.array([r.stamp for r in readings])
        assert stamps.min() > 0.0
        np.testing.assert_allclose(np.diff(stamps), np.diff([s.stamp for s in shifted]), atol=1e-9)
