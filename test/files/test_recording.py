import numpy as np
import pytest

from magcal_ros.core.samples import FieldSample, ImuSample
from magcal_ros.files import FileError, Recording, open_recording, read_csv_folder

IMU = "t,ax,ay,az,gx,gy,gz\n1.0,0.1,0.2,9.8,0.01,0.02,0.03\n1.1,0.4,0.5,9.7,nan,nan,nan\n"
MAG = "t,mx,my,mz\n1.05,1e-5,2e-5,-3e-5\n"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "imu.csv").write_text(IMU)
    (tmp_path / "mag.csv").write_text(MAG)
    return tmp_path


def test_both_tables_are_read(folder):
    recording = read_csv_folder(folder)
    assert recording.imu[0].tolist() == [1.0, 0.1, 0.2, 9.8, 0.01, 0.02, 0.03]
    assert np.isnan(recording.imu[1, 4:]).all()
    assert recording.field.tolist() == [[1.05, 1e-5, 2e-5, -3e-5]]


def test_columns_are_found_by_name_in_any_order(folder):
    (folder / "mag.csv").write_text("temperature, mz ,my,t,mx\n20,-3e-5,2e-5,1.05,1e-5\n")
    assert read_csv_folder(folder).field.tolist() == [[1.05, 1e-5, 2e-5, -3e-5]]


@pytest.mark.parametrize(("unit", "second"), [("s", 1), ("ms", 1e3), ("µs", 1e6), ("ns", 1e9)])
def test_stamps_in_a_unit_that_the_header_names_are_read(folder, unit, second):
    for name in ("imu", "mag"):
        path = folder / f"{name}.csv"
        first, *rows = path.read_text().splitlines()
        rows = [row.split(",", 1) for row in rows]
        rows = [f"{float(stamp) * second!r},{others}" for stamp, others in rows]
        path.write_text("\n".join([first.replace("t,", f"t [{unit}],"), *rows]) + "\n")
    recording = read_csv_folder(folder)
    assert recording.imu[:, 0].tolist() == pytest.approx([1.0, 1.1], abs=1e-12)
    assert recording.field[0].tolist() == pytest.approx([1.05, 1e-5, 2e-5, -3e-5], rel=1e-12)


def test_a_byte_order_mark_is_no_part_of_the_first_name(folder):
    """A spreadsheet writes it; the answer was that there is no column t."""
    (folder / "mag.csv").write_text(MAG, encoding="utf-8-sig")
    assert read_csv_folder(folder).field.tolist() == [[1.05, 1e-5, 2e-5, -3e-5]]


def test_samples_come_in_the_order_of_their_stamps_the_imu_first():
    imu = np.column_stack([[1.0, 2.0, 3.0], np.ones((3, 6))])
    field = np.column_stack([[0.5, 2.0, 2.5], np.ones((3, 3))])
    samples = list(Recording(imu, field).samples())
    assert [(type(s), s.stamp) for s in samples] == [
        (FieldSample, 0.5),
        (ImuSample, 1.0),
        (ImuSample, 2.0),
        (FieldSample, 2.0),
        (FieldSample, 2.5),
        (ImuSample, 3.0),
    ]


def test_streams_with_a_clock_set_back_stay_synchronous():
    """Sorted by stamps, all of one stream came before the other."""
    stamps = np.concatenate([1000.0 + 0.1 * np.arange(50), 5.0 + 0.1 * np.arange(50)])
    imu = np.column_stack([stamps, np.ones((100, 6))])
    field = np.column_stack([stamps - 0.05, np.ones((100, 3))])
    samples = list(Recording(imu, field).samples())
    came = [row for row, each in enumerate(samples) if isinstance(each, ImuSample)]
    assert [samples[row].stamp for row in came] == stamps.tolist()
    assert np.abs(np.array(came) - 2.0 * np.arange(100)).max() <= 2.0


def test_a_sample_out_of_order_does_not_set_the_clock_back():
    stamps = 1.0 + 0.1 * np.arange(40)
    stamps[[7, 8]] = stamps[[8, 7]]
    imu = np.column_stack([stamps, np.ones((40, 6))])
    field = np.column_stack([1.05 + 0.1 * np.arange(40), np.ones((40, 3))])
    samples = list(Recording(imu, field).samples())
    assert [each.stamp for each in samples if isinstance(each, ImuSample)] == stamps.tolist()
    assert [each.stamp for each in samples[-4:]] == pytest.approx([4.8, 4.85, 4.9, 4.95])


def test_samples_carry_force_rate_and_field(folder):
    first, field, _ = read_csv_folder(folder).samples()
    assert first == ImuSample(1.0, (0.1, 0.2, 9.8), (0.01, 0.02, 0.03))
    assert field == FieldSample(1.05, (1e-5, 2e-5, -3e-5))


@pytest.mark.parametrize("name", ["imu.csv", "mag.csv"])
def test_a_missing_file_is_an_error(folder, name):
    (folder / name).unlink()
    with pytest.raises(FileError, match=f"cannot read .*{name}: No such file"):
        read_csv_folder(folder)


@pytest.mark.parametrize("end", ["3,4", "3,", "3"])
def test_a_truncated_last_line_of_a_table_is_ignored(folder, end):
    (folder / "mag.csv").write_text(f"t,mx,my,mz\n1,2,3,4\n2,2,3,4\n{end}")
    assert len(read_csv_folder(folder).field) == 2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "has no column t, mx, my, mz; its first line should be t,mx,my,mz"),
        ("t,mx,mz\n1,2,3\n", "has no column my"),
        ("t [min],mx,my,mz\n1,2,3,4\n", "stamps in an unknown unit, 'min': write s, ms, us or ns"),
        ("t,mx,my,mz\n1.7e12,2,3,4\n", r"reach 1.7e\+12: .* name their unit in the header"),
        ("t,mx,my,mz\n1,2,x,4\n", "is damaged"),
        ("t,mx,my,mz\n1,2,3,4\n1,2\n", "is damaged"),
    ],
)
def test_a_damaged_table_is_an_error(folder, text, words):
    (folder / "mag.csv").write_text(text)
    with pytest.raises(FileError, match=words):
        read_csv_folder(folder)


@pytest.mark.filterwarnings("ignore:loadtxt")
def test_a_table_without_samples_is_an_error(folder):
    (folder / "mag.csv").write_text("t,mx,my,mz\n")
    with pytest.raises(FileError, match="holds no samples"):
        read_csv_folder(folder)


def test_bytes_that_are_not_text_are_an_error(folder):
    (folder / "mag.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileError, match="is damaged"):
        read_csv_folder(folder)


@pytest.mark.parametrize(("name", "words"), [("a.zip", "unpack it"), ("imu.csv", "its folder")])
def test_a_folder_that_contains_a_recording_is_reported(tmp_path, name, words):
    (tmp_path / name).write_bytes(b"t,ax")
    with pytest.raises(FileError, match=words):
        open_recording(tmp_path / name)


def test_without_gyro_columns_there_is_no_gyro(tmp_path):
    (tmp_path / "imu.csv").write_text("t,ax,ay,az\n1.0,0.1,0.2,9.8\n")
    (tmp_path / "mag.csv").write_text("t,mx,my,mz\n1.05,1e-5,2e-5,-3e-5\n")
    recording = read_csv_folder(tmp_path)
    assert recording.imu[0, :4].tolist() == [1.0, 0.1, 0.2, 9.8]
    assert np.isnan(recording.imu[0, 4:]).all()


def test_a_span_without_samples_is_empty(folder):
    with open_recording(folder, start=100.0) as source:
        assert list(source.readings()) == []
