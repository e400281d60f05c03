"""The calibration in force of one magnetometer, and its file."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from rclpy.node import Node

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.correction import MotorField
from magcal_ros.core.errors import in_words
from magcal_ros.core.heading.base_heading import VehicleYaw
from magcal_ros.core.session.turn_machine import Conclusion
from magcal_ros.files.calibration_file import (
    Origin,
    keep_backup,
    read_calibration,
    write_calibration,
)
from magcal_ros.files.default_paths import (
    chosen_path,
    identifier,
    is_missing,
    numbered,
    sensor_file,
)
from magcal_ros.files.disk import FileError, printable, with_time_limit
from magcal_ros.ros.threads import BackgroundThread

Tell = Callable[[Conclusion], None]

WRITE_WITHIN = 15.0  # longest time to write a calibration to a slow disk, seconds
MOST_SENSORS = 100  # frames of sensors that are remembered; the oldest is dropped first

NOT_HEARD = (
    "no field has arrived yet, so the frame in the file's name is not known: start the "
    "magnetometer's driver and call ~/load again, or name the file in calibration_file"
)


class LoadedCalibration(NamedTuple):
    """A calibration that was read from a file."""

    path: Path
    calibration: Calibration
    origin: Origin


class CalibrationStore:
    """Holds the calibration in force, and saves and loads its file.

    The node's namespace and name are part of the default path; a `number` above 1 is added to the
    file's name. `chosen` returns the parameter calibration_file. Messages do not reveal the
    content of a file that is named after the start. `apply` is called with the new calibration (or
    None) and the magnetometer's frame at each change.
    """

    def __init__(
        self,
        node: Node,
        files: BackgroundThread,
        apply: Callable[[Calibration | None, str], object],
        chosen: Callable[[], str] = lambda: "",
        number: int = 1,
    ) -> None:
        self._node, self._number, self._apply, self._chosen = node, number, apply, chosen
        self._files, self._log, self._given = files, node.get_logger(), chosen()
        self.calibration: Calibration | None = None
        self.origin: Origin | None = None
        self.problem = ""  # the last failure with the file; empty after a success
        self._frame, self._was_received, self._was_named = "", False, False
        self._is_reading = False
        self._found: OrderedDict[str, LoadedCalibration | None] = OrderedDict()
        self._loads_files = True  # without a call of ~/load

    def put_in_force(self, calibration: Calibration, origin: Origin) -> None:
        """Use a calibration from now on."""
        self.calibration, self.origin = calibration, origin
        self._apply(calibration, origin.magnetometer_frame)

    def keep(self, learnt: VehicleYaw | MotorField | None) -> None:
        """Store a yaw or a motor field with the calibration in force, if there are both.

        `apply` is not called, because the caller uses the value already.
        """
        if learnt is None or self.calibration is None or self.origin is None:
            return
        if isinstance(learnt, VehicleYaw):
            self.origin = replace(self.origin, vehicle_yaw=learnt)
        else:
            self.calibration = replace(self.calibration, motors=learnt)
        self.save()

    def reset(self) -> None:
        """Put no calibration in force."""
        self.calibration = self.origin = None
        self._apply(None, "")

    def save(self, tell: Tell = lambda _: None, with_backup: bool = True) -> None:
        """Save the calibration in force; a different one in the file is kept as a backup."""
        calibration, origin = self.calibration, self.origin
        if calibration is None or origin is None:
            tell(Conclusion(False, "there is no calibration in force to save"))
            return
        frame = self._frame

        def work() -> str:
            lost = ""

            def keep() -> None:
                nonlocal lost
                # A failed backup must not prevent saving.
                try:
                    keep_backup(path, calibration)
                except (FileError, OSError, ValueError) as error:
                    lost = f" No backup of the previous calibration: {error}"

            path = self._path(frame)
            content = (path, calibration, origin, keep if with_backup else None)
            with_time_limit(lambda: write_calibration(*content), path, WRITE_WITHIN)
            return f"In force and saved to {path}.{lost}"

        def done(words: str) -> None:
            self.problem = ""
            tell(Conclusion(True, words))

        def failed(error: Exception) -> None:
            why = in_words(error).rstrip(".")
            self.problem = f"In force until the node ends, but not saved: {why}. Then call ~/save."
            tell(Conclusion(False, self.problem))

        self._files.run(work, done, failed)

    def load(self, tell: Tell) -> None:
        """Put the calibration in the file in force."""
        chosen, frame = self._chosen(), self._frame
        if not chosen and not self._was_received:
            tell(Conclusion(False, NOT_HEARD))
            return

        def done(found: LoadedCalibration | Exception) -> None:
            if isinstance(found, Exception):
                self.problem = str(found)
                tell(Conclusion(False, str(found)))
            else:
                tell(Conclusion(True, self.use(found)))

        self._files.run(lambda: self.read(chosen, frame), done, done)

    def read(self, chosen: str, frame: str) -> LoadedCalibration:
        """Read the file of a sensor, in any thread.

        Raises FileError if the file is missing, damaged, no calibration or of another sensor.
        """
        try:
            path = self._path(frame, chosen)
            found = with_time_limit(lambda: read_calibration(path), path)
            loaded = LoadedCalibration(path, *found)
            _require_sensor(path, loaded.origin, frame)
        except FileError:
            if chosen in ("", self._given):
                raise
            raise FileError(
                f"{printable(chosen)} cannot be loaded: it is missing, cannot be read, is not a "
                "usable calibration, or was made for another sensor. Calibrate, or name another "
                "file in calibration_file"
            ) from None
        return loaded

    def use(self, loaded: LoadedCalibration) -> str:
        """Put a calibration that was read in force; returns what was done, in words."""
        self.problem = ""
        self.put_in_force(loaded.calibration, loaded.origin)
        origin, method = loaded.origin, loaded.calibration.evidence.method
        made = f"{printable(origin.created)} by {printable(method)}"
        where = f" in {printable(origin.node)}" if origin.node else ""
        return f"loaded {loaded.path} (made {made}{where})"

    def begin(self) -> None:
        """Load the file in the parameter calibration_file, before any message arrives."""
        if self._chosen():
            self._read_next()

    def note_sensor(self, frame: str) -> None:
        """Load the calibration of a sensor that has begun to publish, in the background.

        If a calibration is in force, its sensor is checked. The file of a sensor that was there
        before is not read again.
        """
        self._frame, self._was_received = frame, True
        if frame in self._found:
            self._use_found(self._found[frame])
            return
        # The first messages of a driver may have no frame.
        is_first, self._was_named = not self._was_named, self._was_named or bool(frame)
        if self.calibration is None:
            self._read_next()
            return
        self._remember(frame)
        if is_first:
            self._check_sensor(frame)

    def forget(self) -> None:
        """From now on, load a file only on request."""
        self._loads_files = False

    def _path(self, frame: str, chosen: str | None = None) -> Path:
        """Return the chosen file, or the default one of this node and sensor."""
        chosen = self._chosen() if chosen is None else chosen
        if chosen:
            return numbered(chosen_path(chosen), self._number)
        node = self._node
        return numbered(sensor_file(frame, node.get_namespace(), node.get_name()), self._number)

    def _remember(self, frame: str) -> None:
        self._found[frame] = None
        if len(self._found) > MOST_SENSORS:
            self._found.popitem(last=False)

    def _read_next(self) -> None:
        """Read the file of the present sensor once, after the running read has ended."""
        frame, chosen = self._frame, self._chosen()
        is_known = self.calibration is not None or frame in self._found
        if self._is_reading or is_known or not self._loads_files:
            return
        self._is_reading = True
        self._remember(frame)

        def read_if_there() -> LoadedCalibration | None:
            path = self._path(frame, chosen)
            return (
                None
                if with_time_limit(lambda: is_missing(path), path)
                else self.read(chosen, frame)
            )

        def done(found: LoadedCalibration | Exception | None) -> None:
            self._is_reading = False
            if isinstance(found, Exception):
                self.problem = str(found)
                self._log.error(f"{str(found).rstrip('.')}. Running uncalibrated.")
            else:
                if found is None and not frame and chosen:
                    # Only at the start: a path that is set later is not revealed to the network.
                    self._log.warning(
                        f"{self._path(frame, chosen)} does not exist: no calibration is in force. "
                        "The next calibration is saved there"
                    )
                if frame in self._found:
                    self._found[frame] = found
                # A chosen file is for any sensor, and the sensor may have published since.
                if frame == self._frame or (chosen and not frame):
                    self._use_found(found)
            self._read_next()

        self._files.run(read_if_there, done, done)

    def _use_found(self, loaded: LoadedCalibration | None) -> None:
        if loaded is None or self.calibration is not None or not self._loads_files:
            return
        words = self.use(loaded)
        # The first log line of a process takes rclpy some 30 ms, so a background thread writes it.
        self._files.run(lambda: self._log.info(words), lambda _: None, lambda _: None)
        self._check_sensor(self._frame)

    def _check_sensor(self, frame: str) -> None:
        """Reset a loaded calibration that was made for another sensor."""
        try:
            assert self.origin is not None
            _require_sensor(self._path(frame), self.origin, frame)
        except FileError as error:
            self.reset()
            self.problem = str(error)
            self._log.error(str(error))


def _require_sensor(path: Path, origin: Origin, frame: str) -> None:
    """Raise FileError for a calibration of another sensor: both frames known and different."""
    made_for, there = origin.magnetometer_frame, identifier(frame)
    if made_for and there and made_for != there:
        raise FileError(
            f"{path} was made for the magnetometer {made_for!r}, but the field comes from "
            f"{there!r}. Calibrate this sensor, or name the file of this sensor in "
            "calibration_file."
        )
