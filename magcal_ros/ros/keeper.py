"""The calibration in force of one magnetometer, and its file."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.correction import MotorField
from magcal_ros.core.errors import in_words
from magcal_ros.core.heading.base_view import VehicleYaw
from magcal_ros.core.session.turn_machine import Conclusion
from magcal_ros.files.calibration_file import (
    Origin,
    keep_backup,
    read_calibration,
    write_calibration,
)
from magcal_ros.files.default_paths import (
    chosen_path,
    is_missing,
    known_as,
    numbered,
    sensor_file,
)
from magcal_ros.files.disk import FileTrouble, plain, promptly
from magcal_ros.ros.announcer import Log
from magcal_ros.ros.threads import BackgroundThread

Tell = Callable[[Conclusion], None]

TO_WRITE = 15.0  # seconds that a slow but living disk may take to store a calibration for good
MOST_KNOWN = 100  # names of sensors that are remembered; beyond that the oldest one is dropped

NOT_HEARD = (
    "no field has arrived yet, so the frame in the file's name is not known: start the "
    "magnetometer's driver and call ~/load again, or name the file in calibration_file"
)


class Loaded(NamedTuple):
    """A calibration as a file has it."""

    path: Path
    calibration: Calibration
    origin: Origin


class Keeper:
    """Holds the calibration in force and moves it to and from its file.

    `name` is the node's namespace and name, part of the default path; a `number` above 1 stands in
    the file's name. `chosen` returns the parameter calibration_file; of a file that is named there
    after the start nothing is revealed to the network. `apply` is called with the calibration (or
    None) and the magnetometer's frame whenever it changes.
    """

    def __init__(
        self,
        name: tuple[str, str],
        files: BackgroundThread,
        log: Log,
        apply: Callable[[Calibration | None, str], object],
        chosen: Callable[[], str] = lambda: "",
        number: int = 1,
    ) -> None:
        self._name, self._number, self._apply, self._chosen = name, number, apply, chosen
        self._files, self._log, self._given = files, log, chosen()
        self.calibration: Calibration | None = None
        self.origin: Origin | None = None
        self.trouble = ""  # what went wrong with the file last; empty if nothing
        self._frame, self._was_heard, self._was_named = "", False, False
        self._last_read: tuple[object, Loaded] | None = None
        self._is_reading = False
        self._found: OrderedDict[str, Loaded | None] = OrderedDict()
        self._used: Path | None = None
        self._dismissed: Path | None = None
        self._resets = 0

    def put_in_force(self, calibration: Calibration, origin: Origin) -> None:
        """Use a calibration from now on."""
        self.calibration, self.origin = calibration, origin
        self._apply(calibration, origin.magnetometer_frame)

    def keep(self, learnt: VehicleYaw | MotorField) -> None:
        """Store what was learnt while driving with the calibration in force, if there is one.

        Nothing is applied: the caller uses it already.
        """
        if self.calibration is None or self.origin is None:
            return
        if isinstance(learnt, VehicleYaw):
            self.origin = replace(self.origin, vehicle_yaw=learnt)
        else:
            self.calibration = replace(self.calibration, motors=learnt)
        self.save()

    def reset(self) -> None:
        """Use none."""
        self.calibration = self.origin = None
        self._apply(None, "")

    def save(self, tell: Tell = lambda _: None, with_backup: bool = True) -> None:
        """Save the calibration in force; another one that the file holds is kept as a backup."""
        calibration, origin = self.calibration, self.origin
        if calibration is None or origin is None:
            tell(Conclusion(False, "there is no calibration in force to save"))
            return
        frame = self._frame

        def work() -> str:
            lost = ""

            def keep() -> None:
                nonlocal lost
                # What is in force now matters more than what was.
                try:
                    keep_backup(path, calibration)
                except (FileTrouble, OSError, ValueError) as error:
                    lost = f" Its previous content could not be kept: {error}"

            try:
                path = self._path(frame)
                content = (path, calibration, origin, keep if with_backup else None)
                promptly(lambda: write_calibration(*content), path, TO_WRITE)
            except FileTrouble as error:
                self.trouble = str(error)
                return f"In force, but not saved: {error}"
            self.trouble = ""
            return f"In force and saved to {path}.{lost}"

        self._files.run(
            work,
            lambda words: tell(Conclusion(not self.trouble, words)),
            lambda error: tell(Conclusion(False, f"In force, but not saved: {in_words(error)}")),
        )

    def load(self, tell: Tell) -> None:
        """Put the calibration of the file in force."""
        chosen, frame = self._chosen(), self._frame
        if not chosen and not self._was_heard:
            tell(Conclusion(False, NOT_HEARD))
            return

        def done(found: Loaded | Exception) -> None:
            if isinstance(found, Exception):
                self.trouble = str(found)
                tell(Conclusion(False, str(found)))
            else:
                tell(Conclusion(True, self.use(found)))

        self._files.run(lambda: self.read(chosen, frame), done, done)

    def read(self, chosen: str, frame: str) -> Loaded:
        """Read the file of a sensor, in any thread; one that has not changed is not read again.

        A FileTrouble if it is missing, damaged, foreign, or made for another sensor.
        """
        try:
            path = self._path(frame, chosen)
            key = promptly(lambda: _key_of(path), path)
            if self._last_read is None or key is None or self._last_read[0] != key:
                found = promptly(lambda: read_calibration(path), path)
                self._last_read = key, Loaded(path, *found)
            loaded = self._last_read[1]
            _require_sensor(path, loaded.origin, frame)
        except FileTrouble:
            if chosen in ("", self._given):
                raise
            raise FileTrouble(
                f"{plain(chosen)} cannot be loaded: it is missing, cannot be read, is not a usable "
                "calibration, or was made for another sensor. Calibrate, or name another file in "
                "calibration_file"
            ) from None
        return loaded

    def use(self, loaded: Loaded) -> str:
        """Put what was read in force; returns what was done."""
        self.trouble = ""
        self.put_in_force(loaded.calibration, loaded.origin)
        origin, method = loaded.origin, loaded.calibration.evidence.method
        made = f"{plain(origin.created)} by {plain(method)}"
        where = f" in {plain(origin.node)}" if origin.node else ""
        return f"loaded {loaded.path} (made {made}{where})"

    def begin(self) -> None:
        """Load a file that was chosen by its name, before any message arrives."""
        if self._chosen():
            self._read_next()

    def note_sensor(self, frame: str) -> None:
        """Load the calibration of the sensor whose field comes now, in the background.

        One that is loaded already is checked; a sensor that was there before is not read again.
        """
        self._frame, self._was_heard = frame, True
        if frame in self._found:
            self._use_found(self._found[frame])
            return
        # A driver may leave out the frame at first.
        is_first, self._was_named = not self._was_named, self._was_named or bool(frame)
        if self.calibration is None:
            self._read_next()
            return
        self._remember(frame)
        if is_first:
            self._check_sensor(frame)

    def forget(self) -> None:
        """Do not use any more what was found, or began to be read, so far."""
        self._found = OrderedDict.fromkeys(self._found)
        self._dismissed = self._used
        self._resets += 1

    def _path(self, frame: str, chosen: str | None = None) -> Path:
        """Return the file to save to: as chosen, or by the node and the sensor's frame."""
        chosen = self._chosen() if chosen is None else chosen
        own = chosen_path(chosen) if chosen else sensor_file(frame, *self._name)
        return numbered(own, self._number)

    def _remember(self, frame: str) -> None:
        self._found[frame] = None
        if len(self._found) > MOST_KNOWN:
            self._found.popitem(last=False)

    def _read_next(self) -> None:
        """Read the file of the present sensor, once, when the one before it is read."""
        frame, chosen, resets = self._frame, self._chosen(), self._resets
        if self._is_reading or self.calibration is not None or frame in self._found:
            return
        self._is_reading = True
        self._remember(frame)

        def read_if_there() -> Loaded | None:
            path = self._path(frame, chosen)
            return None if promptly(lambda: is_missing(path), path) else self.read(chosen, frame)

        def done(found: Loaded | Exception | None) -> None:
            self._is_reading = False
            if isinstance(found, Exception):
                self.trouble = str(found)
                self._log.error(f"{found} Running uncalibrated.")
            elif resets == self._resets:
                if found is None and not frame and chosen:
                    # At the start; a path that is named later is not told to the network.
                    self._log.warning(
                        f"{self._path(frame, chosen)} does not exist: no calibration is in force. "
                        "The next calibration is saved there"
                    )
                if frame in self._found:
                    self._found[frame] = found
                # A chosen file is that of any sensor, and one may have been met meanwhile.
                if frame == self._frame or (chosen and not frame):
                    self._use_found(found)
            self._read_next()

        self._files.run(read_if_there, done, done)

    def _use_found(self, loaded: Loaded | None) -> None:
        if loaded is None or self.calibration is not None:
            return
        # A chosen file is the same for a sensor that is met only after the reset.
        if loaded.path == self._dismissed:
            return
        self._used = loaded.path
        words = self.use(loaded)
        # rclpy takes some 30 ms for the first log line of a process; messages do not wait for it.
        self._files.run(lambda: self._log.info(words), lambda _: None, lambda _: None)
        self._check_sensor(self._frame)

    def _check_sensor(self, frame: str) -> None:
        """Take a loaded calibration out of force that was made for another sensor."""
        try:
            assert self.origin is not None
            _require_sensor(self._path(frame), self.origin, frame)
        except FileTrouble as error:
            self.reset()
            self.trouble = str(error)
            self._log.error(str(error))


def _key_of(path: Path) -> object:
    """Return what changes with a file; None if it cannot be looked at."""
    try:
        about = path.stat()
    except (OSError, ValueError):
        return None
    return path, about.st_mtime_ns, about.st_size


def _require_sensor(path: Path, origin: Origin, frame: str) -> None:
    """Raise a FileTrouble for a calibration of another sensor: both frames are known and differ."""
    made_for, there = origin.magnetometer_frame, known_as(frame)
    if made_for and there and made_for != there:
        raise FileTrouble(
            f"{path} was made for the magnetometer {made_for!r}, but the field comes from "
            f"{there!r}. Calibrate this sensor, or name its own file in "
            "calibration_file."
        )
