import subprocess
import sys
from pathlib import Path

COMMAND = Path(__file__).resolve().parents[1] / "benchmarks" / "house.py"

TABLE = '''
"""A docstring."""
import numpy as np

ANGLE = np.radians(3.0)
NAMES = ("x", "y")
lower = 5


@dataclass(frozen=True)
class SmallTuning:
    rate: float = -3.0
    sizes: tuple[float, ...] = (1.0, 2.0)
    name: str = "none"
    wide: float = dataclasses.field(default=2 * 0.5)
    whether: bool = True


@dataclass(frozen=True)
class Result:
    sigma: float = 0.0
'''


def rows(*arguments):
    done = subprocess.run(
        [sys.executable, COMMAND, *arguments], capture_output=True, text=True, check=True
    )
    lines = done.stdout.splitlines()[1:]
    return {line[:24].strip(): [int(each) for each in line[24:].split()] for line in lines}


def test_modules_lines_and_tuned_numbers_are_counted_by_room(tmp_path):
    room = tmp_path / "core" / "small"
    room.mkdir(parents=True)
    (tmp_path / "__init__.py").write_text("LIMIT: int = 3\n")
    (room / "table.py").write_text(TABLE)
    lines = len(TABLE.splitlines())
    assert rows(tmp_path) == {
        "magcal_ros": [1, 1, 0, 1],
        "core/small": [1, lines, 3, 1],
        "core, all of it": [1, lines, 3, 1],
        "all": [2, lines + 1, 3, 2],
    }


def test_the_package_is_counted_without_an_argument():
    found = rows()
    assert {"core/geometry", "files", "ros", "cli", "report"} <= set(found)
    assert found["all"][0] == sum(1 for _ in COMMAND.parents[1].glob("magcal_ros/**/*.py"))
