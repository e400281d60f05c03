"""A report whose process is killed: the page is whole or not there, and so are the samples."""

import pickle
import random
import subprocess
import sys
import tempfile
import time

import pytest
from long_form import rounds
from subjects import good

from magcal_ros.files.recording import read_samples

pytestmark = pytest.mark.faults


@pytest.mark.parametrize("attempt", range(rounds(1, 300)))
def test_killed_at_any_moment(tmp_path, attempt):
    subject, chance = good(), random.Random(attempt)
    with tempfile.TemporaryFile() as handover:
        pickle.dump((tmp_path, subject), handover)
        handover.seek(0)
        process = subprocess.Popen([sys.executable, "-m", "magcal_ros.report"], stdin=handover)
    time.sleep(chance.uniform(0.3, 2.0))
    process.kill()
    process.wait()
    samples, page = tmp_path / "samples.csv", tmp_path / "report.html"
    if samples.exists():
        assert len(read_samples(samples)) == len(subject.window)
    if page.exists():
        assert samples.exists()
        assert page.read_text().endswith("</html>\n")


def test_a_page_that_cannot_be_written_is_said_by_the_exit_status(tmp_path):
    (tmp_path / "report.html").write_text("mine")
    handover = pickle.dumps((tmp_path, good()))
    command = [sys.executable, "-c", "from magcal_ros.report.write import main; exit(main())"]
    done = subprocess.run(command, input=handover, capture_output=True, check=False)
    assert done.returncode == 1
    assert "stays; choose another folder" in done.stderr.decode()
    assert "Traceback" not in done.stderr.decode()
    assert (tmp_path / "report.html").read_text() == "mine"
