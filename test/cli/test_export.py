"""`magcal export`, from a stored calibration to the text of another program."""

from __future__ import annotations

import numpy as np
import pytest
from sample_results import SKEWED, calibration

from magcal_ros.cli.main import main
from magcal_ros.core import Correction
from magcal_ros.files import EXPORTERS, Origin, write_calibration


@pytest.fixture
def stored(tmp_path):
    def store(correction=SKEWED):
        path = tmp_path / "calibration.yaml"
        write_calibration(path, calibration(correction), Origin.now("mag_link", "imu_link"))
        return path

    return store


@pytest.mark.parametrize("name", sorted(EXPORTERS))
def test_every_export_is_printed(stored, capsys, name):
    correction = Correction(np.diag([0.8, 1.1, 1.3]), SKEWED.hard_iron)
    assert main(["export", str(stored(correction)), "--to", name]) == 0
    assert capsys.readouterr().out == EXPORTERS[name](calibration(correction))


def test_an_export_is_written_to_a_file(stored, tmp_path, capsys):
    output = tmp_path / "new" / "mag.h"
    arguments = ["export", str(stored()), "--to", "c-header", "--output", str(output)]
    assert main(arguments) == 0
    assert output.read_text() == EXPORTERS["c-header"](calibration())
    assert capsys.readouterr().out == ""


def test_an_export_replaces_no_calibration(stored, capsys):
    path = stored()
    before = path.read_bytes()
    assert main(["export", str(path), "--to", "c-header", "--output", str(path)]) == 5
    assert "is a calibration of magcal_ros, and was not changed" in capsys.readouterr().err
    assert path.read_bytes() == before


def test_an_export_that_cannot_be_written_names_the_option(stored, tmp_path, capsys):
    arguments = ["export", str(stored()), "--to", "c-header", "--output", str(tmp_path)]
    assert main(arguments) == 5
    assert "Choose a writable place with --output" in capsys.readouterr().err


def test_a_calibration_that_a_consumer_cannot_store_is_refused_in_one_line(
    stored, tmp_path, capsys
):
    output = tmp_path / "px4.txt"
    arguments = ["export", str(stored()), "--to", "px4", "--output", str(output)]
    assert main(arguments) == 1
    captured = capsys.readouterr()
    assert captured.err.startswith("magcal: PX4 holds a symmetric matrix only")
    assert captured.err.count("\n") == 1
    assert not output.exists()


def test_a_missing_calibration_is_a_file_error(tmp_path, capsys):
    assert main(["export", str(tmp_path / "nowhere.yaml"), "--to", "px4"]) == 5
    assert "cannot read" in capsys.readouterr().err


def test_an_unknown_consumer_is_a_usage_error(stored, capsys):
    with pytest.raises(SystemExit) as caught:
        main(["export", str(stored()), "--to", "sextant"])
    assert caught.value.code == 2
    assert "ctu-vras" in capsys.readouterr().err
