"""Headings with the gyro's bias by the fit: `python benchmarks/fitted_bias.py [--changed NAME]`.

Each row is a recording that is calibrated as the node takes it, without a rest before. It prints
the length of the gyro's bias by the fit (°/s). It then prints the RMS of the heading error after
the calibration (degrees, one constant subtracted), with the node's up without this bias and with
it. `--changed "gyro off"` adds 2, -1.5 and 1 °/s to the gyro.
"""

from __future__ import annotations

import argparse
import math

import numpy as np
import shared_cases  # noqa: F401
from changed_recordings import CHANGES, changed
from recorded_truth import Drive, read_drive, windows
from recordings import DEFAULT, heading_by, recordings_in

from magcal_ros.core.calibrate import calibrate
from magcal_ros.core.calibration.calibration import Estimate
from magcal_ros.core.errors import MagcalError
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.samples.streams import ImuSample
from magcal_ros.core.up.follower import UpFollower


def followed_up(drive: Drive, estimate: Estimate, moment: float, *, takes: bool) -> FloatArray:
    """Return up of the node at each sample, (n, 3); with `takes` it uses the fit's bias then."""
    everything, follower, ups = drive.everything, UpFollower(), []
    assert everything.angular_rate is not None
    assert estimate.gyro is not None
    columns = everything.field, everything.specific_force, everything.angular_rate
    for stamp, field, force, rate in zip(everything.time, *columns, strict=True):
        if takes and stamp >= moment:
            follower.take_bias(estimate.gyro)
            takes = False
        follower.add_field(stamp, tuple(field))
        follower.add(ImuSample(stamp, tuple(force), tuple(rate)))
        ups.append(follower.newest)
    return np.array(ups)


def error_after(drive: Drive, estimate: Estimate, moment: float, *, takes: bool) -> float:
    """Return the RMS of the heading after a moment against the truth, degrees; NaN if unknown."""
    up = followed_up(drive, estimate, moment, takes=takes)
    score = drive.score(heading_by(estimate.correction), up, since=moment)
    return math.nan if score is None else score.rms


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--changed", choices=list(CHANGES), help="by other sensors")
    arguments = parser.parse_args()
    print(f"{'recording':30s}{'bias':>8s}{'without':>9s}{'with':>7s}")
    for folder in recordings_in([DEFAULT]):
        drive = changed(read_drive(folder, None), arguments.changed)
        window = dict(windows(drive)).get("live")
        if drive.truth is None or window is None or isinstance(window, MagcalError):
            continue
        estimate = calibrate(window, drive.knowledge).estimate
        if estimate is None or estimate.gyro is None:
            continue
        moment = float(window.time[-1])
        errors = [error_after(drive, estimate, moment, takes=each) for each in (False, True)]
        bias = math.degrees(float(np.linalg.norm(estimate.gyro.rate)))
        print(f"{drive.name:30s}{bias:8.2f}{errors[0]:9.1f}{errors[1]:7.1f}", flush=True)


if __name__ == "__main__":
    main()
