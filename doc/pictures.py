"""Draws the pictures of pages that magcal writes, from simulated sensors alone.

`python doc/pictures.py` (by `make pictures`) writes `doc/pictures/*.png`. Takes the browser
Chromium, and Pillow, which matplotlib brings along.
"""

from __future__ import annotations

import contextlib
import math
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageChops

CHECKOUT = Path(__file__).resolve().parents[1]
sys.path.insert(1, str(CHECKOUT / "cases"))

from simulated.drive import Vehicle, simulated_drive  # noqa: E402
from simulated.legs import city  # noqa: E402
from simulated.travel import travel  # noqa: E402
from simulated.turns import Motion, measure  # noqa: E402

from magcal_ros.cli.demo import ROBOT  # noqa: E402
from magcal_ros.cli.main import main  # noqa: E402
from magcal_ros.core.geometry.rotations import rotation_about  # noqa: E402
from magcal_ros.core.simulation import UP_ENU  # noqa: E402

FOLDER = CHECKOUT / "doc" / "pictures"
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
REFERENCE = ("--reference-strength-ut", "48", "--reference-inclination-deg", "65")
WIDTH, TALLEST = 1000, 4000
"""Pixels of the window."""
REPORT = 1782
"""Pixels of the report, down to the end of its pictures."""
BELOW = 12
"""Pixels that stay under the last line."""
COLOURS = 256
"""Of each picture: it is small, and nobody sees the others."""
RATE, MINUTES = 25.0, 8.0
"""Hz of the sensors, and length of the drive."""


def write_table(path: Path, head: str, *columns: Any) -> None:
    """Write columns as a CSV file."""
    path.parent.mkdir(exist_ok=True)
    np.savetxt(path, np.column_stack(columns), "%.9g", ",", header=head, comments="")


def write_sensors(folder: Path, time: Any, force: Any, rate: Any, field: Any) -> None:
    """Write what IMU and magnetometer measured."""
    write_table(folder / "imu.csv", "t,ax,ay,az,gx,gy,gz", time, force, rate)
    write_table(folder / "mag.csv", "t,mx,my,mz", time, field)


def a_turn(folder: Path) -> None:
    """Record a full turn of the robot of the demo, which stands before and after it."""
    time = np.arange(-5.0, 30.0, 1.0 / RATE)
    rate = np.clip(np.minimum(time, 25.0 - time), 0.0, 1.0)
    yaw = np.cumsum(rate) * math.tau / rate.sum()
    motion = Motion(time, rotation_about(UP_ENU, -yaw))
    window = measure(ROBOT, motion, np.random.default_rng(1), gyro=True)
    write_sensors(folder, window.time, window.specific_force, window.angular_rate, window.field)


def a_drive(folder: Path) -> None:
    """Record a drive of the same robot through streets, with wheels and a receiver."""
    rng = np.random.default_rng(4)
    truth = travel(city(rng, 60.0 * MINUTES), rng, rate=RATE)
    drive = simulated_drive(truth, rng, Vehicle(ROBOT))
    write_sensors(folder, drive.time, drive.force, drive.rate, drive.field)
    write_table(folder / "odom.csv", "t,speed", [sample[:2] for sample in drive.speeds])
    write_table(folder / "gps.csv", "t,east,north", list(drive.positions))


def written(command: str, folder: Path) -> Path:
    """Return the page that a command writes on a recording."""
    output = Path(f"{command} of {folder}")
    with contextlib.redirect_stdout(sys.stderr):
        status = main([command, str(folder), *REFERENCE, "--output", str(output)])
    if status != 0:
        raise SystemExit(f"magcal {command} ended with {status}")
    return output.resolve() / "report.html"


def photograph(page: Path, picture: Path, height: int = TALLEST) -> None:
    """Draw the first lines of a page as the browser shows them."""
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        raise SystemExit(f"none of {', '.join(BROWSERS)} is installed")
    size = f"--window-size={WIDTH},{height}"
    options = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", size)
    target = page.with_suffix(".png")
    subprocess.run(
        [browser, *options, f"--screenshot={target}", page.as_uri()],
        check=True,
        stderr=subprocess.DEVNULL,
    )
    seen = Image.open(target).convert("RGB")
    paper = Image.new("RGB", seen.size, "white")
    _, _, _, end = ImageChops.difference(seen, paper).getbbox() or (0, 0, 0, height)
    cut = seen.crop((0, 0, WIDTH, min(end + BELOW, height)))
    picture.parent.mkdir(exist_ok=True)
    # An octree keeps the colours of a few marks, too.
    few = cut.quantize(COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    few.save(picture, optimize=True)
    print(f"{picture.relative_to(CHECKOUT)}: {picture.stat().st_size // 1000} kB")


def draw(names: Iterable[str]) -> None:
    """Draw some of the pictures."""
    for name in names:
        if name == "report":
            a_turn(Path("turn"))
            photograph(written("fit", Path("turn")), FOLDER / "report.png", REPORT)
        else:
            a_drive(Path("drive"))
            photograph(written("drive", Path("drive")), FOLDER / "drive.png")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        os.chdir(place)
        draw(sys.argv[1:] or ("report", "drive"))
