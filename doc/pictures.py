"""Draws the pictures of what magcal writes, from simulated sensors alone.

`python doc/pictures.py [NAME ...]` (by `make pictures`) writes `doc/pictures/*.png`: pages, and
terminals of 80 and 120 columns. Takes the browser Chromium, Pillow, which matplotlib brings along,
and for the demo ROS.
"""

from __future__ import annotations

import contextlib
import fcntl
import html
import math
import os
import pty
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import termios
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageChops
from PIL.PngImagePlugin import PngInfo

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
PICTURES = ("report", "drive", "doctor_80", "demo_80", "demo_120")
"""Names of the files; a number is the width of a terminal in columns."""
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
REFERENCE = ("--reference-strength-ut", "48", "--reference-inclination-deg", "65")
WIDTH, TALLEST = 1000, 4000
"""Pixels of the window."""
REPORT = 1782
"""Pixels of the report, down to the end of its pictures."""
WORDS = "words"
"""Key under which a picture holds the words of its page: a test compares them with today's."""
BELOW = 12
"""Pixels that stay under the last line."""
COLOURS = 256
"""Number of colours of a picture, which keeps the file small."""
TERMINAL = (
    "<meta charset='utf-8'><style>body {margin: 0} pre {font: 13px/1.3 'DejaVu Sans Mono', "
    "monospace; color: #eee; background: #222; padding: 10px; margin: 0}</style>"
)
TEXT_OR_CONTROL = r"(\n|[^\n\r\x1b]+)|\x1b\[(?:(\d+)A|(2K)|[?;\d]*[A-Za-z])"
"""Text, or how the panel goes up a line and erases it, or a colour and the like."""
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


def typed(columns: int, *words: str) -> str:
    """Return what a terminal of so many columns shows when a command has ended."""
    process, terminal = pty.fork()
    if process == 0:
        os.environ.pop("COLUMNS", None)
        os.environ |= {"TERM": "xterm", "PYTHONPATH": str(CHECKOUT)}
        os.execv(sys.executable, [sys.executable, "-m", "magcal_ros.cli.main", *words])
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 60, columns, 0, 0))
    written = b""
    with contextlib.suppress(OSError):  # that is how a terminal ends
        while part := os.read(terminal, 65536):
            written += part
    if os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) != 0:
        raise SystemExit(f"magcal {words[0]} failed: {written.decode(errors='replace')}")
    return shown(written.decode())


def shown(written: str) -> str:
    """Return the lines that stay where some were erased and drawn again, without colours."""
    lines, row = [""], 0
    for text, up, erases in re.findall(TEXT_OR_CONTROL, written):
        if up:
            row -= int(up)
        elif erases:
            lines[row] = ""
        elif text == "\n":
            row += 1
            lines += [""] * (row == len(lines))
        else:
            lines[row] += text  # empty for a colour
    return "\n".join(line.rstrip() for line in lines).strip("\n")


def terminal(name: str, columns: int, *words: str) -> Path:
    """Return a page that shows a terminal after a command."""
    page = Path(f"{name}.html")
    text = html.escape(f"$ magcal {' '.join(words)}\n{typed(columns, *words)}")
    page.write_text(f"{TERMINAL}<pre style='width: {columns}ch'>{text}</pre>", encoding="utf-8")
    return page.resolve()


def words_in(page: Path) -> str:
    """Return the different words of a page, without numbers and names of files."""
    text = re.sub(r"(?s)<style.*?</style>|<[^>]*>", " ", page.read_text(encoding="utf-8"))
    return " ".join(sorted(set(re.findall(r"(?<![\w/.])[^\W\d_]+(?![\w/])", html.unescape(text)))))


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
    _, _, right, end = ImageChops.difference(seen, paper).getbbox() or (0, 0, WIDTH, height)
    cut = seen.crop((0, 0, min(right + BELOW, WIDTH), min(end + BELOW, height)))
    picture.parent.mkdir(exist_ok=True)
    # An octree keeps the colours of a few marks, too.
    few = cut.quantize(COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    words = PngInfo()
    words.add_itxt(WORDS, words_in(page))
    few.save(picture, optimize=True, pnginfo=words)
    print(f"{picture.relative_to(CHECKOUT)}: {picture.stat().st_size // 1000} kB")


def page_of(name: str) -> Path:
    """Return the page that a picture shows."""
    kind, _, columns = name.partition("_")
    if kind == "drive":
        a_drive(Path("drive"))
        return written("drive", Path("drive"))
    if kind == "demo":
        return terminal(name, int(columns), "demo", "--speed", "4")
    a_turn(Path("turn"))
    if kind == "doctor":
        return terminal(name, int(columns), "doctor", "turn", *REFERENCE)
    return written("fit", Path("turn"))


def draw(names: Iterable[str]) -> None:
    """Draw some of the pictures."""
    for name in names:
        height = REPORT if name == "report" else TALLEST
        photograph(page_of(name), FOLDER / f"{name}.png", height)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory(prefix="magcal_") as place:
        os.chdir(place)
        draw(sys.argv[1:] or PICTURES)
