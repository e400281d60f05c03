"""The calibration in force, its file, and the services that save and load it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.motors import MotorField
from magcal_ros.core.driving.front import VehicleYaw
from magcal_ros.core.session.turn_events import Conclusion
from magcal_ros.files.atomic import FileTrouble
from magcal_ros.files.backups import keep_backup
from magcal_ros.files.calibration_file import Origin, read_calibration, write_calibration
from magcal_ros.files.default_paths import SensorFile, chosen_path, is_missing, known_as, numbered
from magcal_ros.files.plain import plain
from magcal_ros.files.reading import promptly
from magcal_ros.ros.background_thread import BackgroundThread
from magcal_ros.ros.services import Tell

Key: TypeAlias = tuple[Path, int, int]
"""Path, time of change and size of a file that was read."""

TO_WRITE = 15.0
"""Seconds that a slow but living disk may take to store a calibration for good."""


@dataclass(frozen=True, eq=False)
class Loaded:
    """A calibration as a file has it."""

    path: Path
    calibration: Calibration
    origin: Origin


class Keeper:
    """Holds the calibration in force and moves it to and from its file."""

    def __init__(
        self,
        namespace: str,
        node: str,
        apply: Callable[[Calibration | None, str], None],
        given: str = "",
        number: int = 1,
    ) -> None:
        self._namespace, self._node, self._given = namespace, node, given
        self._number = number
        self._apply = apply
        self.calibration: Calibration | None = None
        self.origin: Origin | None = None
        self._read: tuple[Key | None, Loaded] | None = None
        self.trouble = ""
        """What went wrong with the file last time, for the diagnostics; empty if nothing."""

    def path(self, chosen: str, magnetometer_frame: str) -> Path:
        """Return the file to save to: as chosen, or by the node and the sensor's frame.

        Raises
        ------
        FileTrouble
            If it lies in a home that does not exist.
        """
        own = chosen_path(chosen) if chosen else self._sensor_file(magnetometer_frame).path
        return numbered(own, self._number)

    def path_to_load(self, chosen: str, magnetometer_frame: str) -> Path:
        """Return the file to load from: the same, or the one of a former release.

        Raises
        ------
        FileTrouble
            If it lies in a home that does not exist, or may be another node's.
        """
        if chosen or self._number > 1:
            return self.path(chosen, magnetometer_frame)
        file = self._sensor_file(magnetometer_frame)
        return promptly(file.find, file.path)

    def _sensor_file(self, magnetometer_frame: str) -> SensorFile:
        return SensorFile(magnetometer_frame, self._namespace, self._node)

    def put_in_force(self, calibration: Calibration, origin: Origin) -> None:
        """Use a calibration from now on."""
        self.calibration, self.origin = calibration, origin
        self._apply(calibration, origin.magnetometer_frame)

    def keep_vehicle_yaw(self, yaw: VehicleYaw) -> bool:
        """Lay a yaw beside the calibration in force; returns whether there is one to save."""
        if self.calibration is None or self.origin is None:
            return False
        self.origin = replace(self.origin, vehicle_yaw=yaw)
        return True

    def keep_motors(self, motors: MotorField) -> bool:
        """Lay what was learnt of the motors beside the calibration; returns whether there is one.

        Nothing is applied anew: whoever learnt it uses it already.
        """
        if self.calibration is None:
            return False
        self.calibration = replace(self.calibration, motors=motors)
        return True

    def reset(self) -> None:
        """Use none."""
        self.calibration = self.origin = None
        self._apply(None, "")

    def read_if_there(self, chosen: str, magnetometer_frame: str) -> Loaded | None:
        """Read a sensor's file as `read` does; None if there surely is none."""
        path = self.path_to_load(chosen, magnetometer_frame)
        if promptly(lambda: is_missing(path), path):
            return None
        return self.read(chosen, magnetometer_frame)

    def read(self, chosen: str, magnetometer_frame: str) -> Loaded:
        """Read a file, in any thread; one that has not changed since is not read again.

        Raises
        ------
        FileTrouble
            If the file is missing, damaged, foreign, or made for another sensor.
        """
        try:
            return self._read_file(chosen, magnetometer_frame)
        except FileTrouble:
            if chosen in ("", self._given):
                raise
            raise FileTrouble(
                f"{plain(chosen)} cannot be loaded: it is missing, cannot be read, is no usable "
                "calibration or was made for another sensor. Calibrate, or name another file in "
                "calibration_file"
            ) from None

    def _read_file(self, chosen: str, magnetometer_frame: str) -> Loaded:
        path = self.path_to_load(chosen, magnetometer_frame)
        key = promptly(lambda: _key_of(path), path)
        if self._read is None or key is None or self._read[0] != key:
            found = promptly(lambda: read_calibration(path), path)
            self._read = key, Loaded(path, *found)
        loaded = self._read[1]
        require_sensor(path, loaded.origin, magnetometer_frame)
        return loaded

    def use(self, loaded: Loaded) -> str:
        """Put what was read in force; returns what was done."""
        self.trouble = ""
        self.put_in_force(loaded.calibration, loaded.origin)
        origin, method = loaded.origin, loaded.calibration.evidence.method
        made = f"{plain(origin.created)} by {plain(method)}"
        where = f" in {plain(origin.node)}" if origin.node else ""
        return f"loaded {loaded.path} (made {made}{where})"

    def store(self, find_path: Callable[[], Path], with_backup: bool = True) -> Callable[[], str]:
        """Return the work of saving what is in force now, to be done in any thread."""
        calibration, origin = self.calibration, self.origin
        if calibration is None or origin is None:
            raise FileTrouble("there is no calibration in force to save")

        def work() -> str:
            lost = ""

            def keep() -> None:
                nonlocal lost
                # What is in force now matters more than what was.
                try:
                    keep_backup(path, calibration)
                except (FileTrouble, OSError, ValueError) as error:
                    lost = f" What it held before is not kept: {error}"

            try:
                path = find_path()
                told = (path, calibration, origin, keep if with_backup else None)
                promptly(lambda: write_calibration(*told), path, TO_WRITE)
            except FileTrouble as error:
                self.trouble = str(error)
                return f"In force, but not saved: {error}"
            self.trouble = ""
            return f"In force and saved to {path}.{lost}"

        return work


def _key_of(path: Path) -> Key | None:
    """Return what changes with a file; None if it cannot be looked at."""
    try:
        about = path.stat()
    except (OSError, ValueError):
        return None
    return path, about.st_mtime_ns, about.st_size


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


class CalibrationStore:
    """Saves and loads the calibration when a service asks for it."""

    def __init__(
        self,
        keeper: Keeper,
        files: BackgroundThread,
        find_path: Callable[[], Path],
        of_sensor: Callable[[], tuple[str, str]],
    ) -> None:
        self._keeper, self._files = keeper, files
        self._find_path, self._of_sensor = find_path, of_sensor

    def save(self, tell: Tell) -> None:
        """Save the calibration in force."""
        try:
            work = self._keeper.store(self._find_path)
        except FileTrouble as error:
            tell(Conclusion(False, str(error)))
            return
        self._files.run(
            work,
            lambda words: tell(Conclusion(not self._keeper.trouble, words)),
            lambda error: tell(Conclusion(False, f"not saved: {error!r}")),
        )

    def load(self, tell: Tell) -> None:
        """Put the calibration of the file in force."""
        chosen, frame = self._of_sensor()

        def fail(error: Exception) -> None:
            self._keeper.trouble = str(error)
            tell(Conclusion(False, str(error)))

        self._files.run(
            lambda: self._keeper.read(chosen, frame),
            lambda loaded: tell(Conclusion(True, self._keeper.use(loaded))),
            fail,
        )
