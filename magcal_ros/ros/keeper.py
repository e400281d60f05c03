"""Which calibration is in force, and the file it lives in."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from magcal_ros.core.calibration import Calibration
from magcal_ros.files.atomic import FileTrouble
from magcal_ros.files.calibration_file import Origin, read_calibration, write_calibration
from magcal_ros.files.places import chosen_path, default_calibration_path, known_as
from magcal_ros.files.plain import plain

LARGEST_GAIN, LARGEST_IRON, LARGEST_COVARIANCE = 1e4, 1.0, 1e8
"""Dimensionless, tesla, and their squares: far beyond every sensor, far within the floats."""


class Keeper:
    """Holds the calibration in force and moves it to and from its file.

    Parameters
    ----------
    namespace : str
        The node's namespace, part of the default path.
    apply : callable
        Called with the calibration (or None) and the magnetometer's frame whenever it changes.
    """

    def __init__(self, namespace: str, apply: Callable[[Calibration | None, str], None]) -> None:
        self._namespace = namespace
        self._apply = apply
        self.calibration: Calibration | None = None
        self.origin: Origin | None = None
        self.trouble = ""
        """What went wrong with the file last time, for the diagnostics; empty if nothing."""

    def path(self, chosen: str, magnetometer_frame: str) -> Path | None:
        """Return the file: as chosen, or by the sensor's frame; None while that is not known.

        Raises
        ------
        FileTrouble
            If it lies in a home that does not exist.
        """
        if chosen:
            return chosen_path(chosen)
        if not magnetometer_frame:
            return None
        return default_calibration_path(magnetometer_frame, self._namespace)

    def put_in_force(self, calibration: Calibration, origin: Origin) -> None:
        """Use a calibration from now on."""
        self.calibration, self.origin = calibration, origin
        self._apply(calibration, origin.magnetometer_frame)

    def reset(self) -> None:
        """Use none."""
        self.calibration = self.origin = None
        self._apply(None, "")

    def load(self, path: Path, magnetometer_frame: str) -> str:
        """Read a file and put its calibration in force; returns what was done.

        Parameters
        ----------
        path : Path
            The file.
        magnetometer_frame : str
            Frame of the sensor that is there; empty while it is not known.

        Raises
        ------
        FileTrouble
            If the file is missing, damaged, foreign, or made for another sensor; whatever was in
            force stays so.
        """
        try:
            calibration, origin = read_calibration(path)
            require_plausible(path, calibration)
            require_sensor(path, origin, magnetometer_frame)
        except FileTrouble as error:
            self.trouble = str(error)
            raise
        self.trouble = ""
        self.put_in_force(calibration, origin)
        made = f"{plain(origin.created)} by {plain(calibration.evidence.method)}"
        return f"loaded {path} (made {made})"

    def store(self, find_path: Callable[[], Path]) -> Callable[[], str]:
        """Return the work of saving what is in force now, to be done in any thread."""
        calibration, origin = self.calibration, self.origin
        if calibration is None or origin is None:
            raise FileTrouble("there is no calibration in force to save")

        def work() -> str:
            try:
                path = find_path()
                write_calibration(path, calibration, origin)
            except FileTrouble as error:
                self.trouble = str(error)
                return f"In force, but not saved: {error}"
            self.trouble = ""
            return f"In force and saved to {path}."

        return work


def require_plausible(path: Path, calibration: Calibration) -> None:
    """Refuse numbers that would leave the floats on their way to a yaw.

    Raises
    ------
    FileTrouble
        If the matrix, the hard iron or the covariance is beyond every sensor.
    """
    correction = calibration.correction
    for name, numbers, limit in (
        ("correction_matrix", correction.matrix, LARGEST_GAIN),
        ("hard_iron", correction.hard_iron, LARGEST_IRON),
        ("covariance", calibration.covariance, LARGEST_COVARIANCE),
        ("noise_field", calibration.noise_field, LARGEST_IRON),
        ("noise_up", calibration.noise_up, LARGEST_GAIN),
    ):
        largest = float(np.abs(numbers).max())
        if largest > limit:
            raise FileTrouble(
                f"{path} is not a usable calibration: {name} reads up to {largest:.0e}, which no "
                "magnetometer needs. Calibrate again to replace it."
            )


def require_sensor(path: Path, origin: Origin, magnetometer_frame: str) -> None:
    """Refuse a calibration that was made for another sensor.

    Raises
    ------
    FileTrouble
        If both frames are known and differ.
    """
    made_for = origin.magnetometer_frame
    there = known_as(magnetometer_frame)
    if made_for and there and made_for != there:
        raise FileTrouble(
            f"{path} was made for the magnetometer {made_for!r}, but the field comes from "
            f"{there!r}. Calibrate this sensor, or name its own file in "
            "calibration_file."
        )
