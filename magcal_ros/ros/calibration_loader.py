"""Loads the calibration of a sensor when its first message arrives, in the background."""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable
from pathlib import Path

from magcal_ros.files.atomic import FileTrouble
from magcal_ros.ros.control import Runner
from magcal_ros.ros.keeper import Keeper, Loaded, require_sensor

MOST_KNOWN = 100
"""Names of sensors that are remembered; beyond that the oldest one is dropped."""


class CalibrationLoader:
    """Loads the calibration of the sensor, or checks that the loaded one was made for it."""

    def __init__(
        self,
        keeper: Keeper,
        files: Runner,
        chosen: Callable[[], str],
        info: Callable[[str], object],
        error: Callable[[str], object],
    ) -> None:
        self._keeper, self._files, self._chosen = keeper, files, chosen
        self._info, self._error = info, error
        self._current = ""
        self._wanted: deque[str] = deque(maxlen=MOST_KNOWN)
        self._is_reading = False
        self._found: OrderedDict[str, Loaded | None] = OrderedDict()
        self._used: Path | None = None
        self._dismissed: Path | None = None
        self._resets = 0

    def begin(self) -> None:
        """Load a file that was chosen by its name, before any message arrives."""
        if self._chosen():
            self._read("", is_met=False)

    def meet(self, frame: str) -> None:
        """Take note of the sensor that the field comes from now; it may have been used before."""
        self._current = frame
        if frame in self._found:
            self._use(self._found[frame])
            return
        # A driver may leave out the frame at first.
        is_first = not any(self._found)
        self._found[frame] = None
        if len(self._found) > MOST_KNOWN:
            self._found.popitem(last=False)
        if self._keeper.calibration is None:
            self._wanted.append(frame)
            self._go()
        elif is_first:
            self._check(frame)

    def forget(self) -> None:
        """Do not use any more what was found, or began to be read, so far."""
        self._found = OrderedDict.fromkeys(self._found)
        self._dismissed = self._used
        self._resets += 1

    def _go(self) -> None:
        if self._keeper.calibration is not None:
            self._wanted.clear()
        if self._wanted and not self._is_reading:
            self._read(self._wanted.pop(), is_met=True)

    def _read(self, frame: str, is_met: bool) -> None:
        self._is_reading = True
        chosen, resets = self._chosen(), self._resets
        self._files.run(
            lambda: self._keeper.read_if_there(chosen, frame),
            lambda loaded: self._note(frame, loaded if resets == self._resets else None, is_met),
            self._fail,
        )

    def _note(self, frame: str, loaded: Loaded | None, is_met: bool) -> None:
        self._is_reading = False
        if is_met and frame in self._found:
            self._found[frame] = loaded
        if not is_met or frame == self._current:
            self._use(loaded)
        self._go()

    def _use(self, loaded: Loaded | None) -> None:
        if loaded is None or self._keeper.calibration is not None:
            return
        # A chosen file is the same for a sensor that is met only after the reset.
        if loaded.path == self._dismissed:
            return
        self._used = loaded.path
        self._info(self._keeper.use(loaded))
        self._check(self._current)

    def _check(self, frame: str) -> None:
        """Take a loaded calibration out of force that was made for another sensor."""
        try:
            assert self._keeper.origin is not None
            path = self._keeper.path(self._chosen(), frame)
            require_sensor(path, self._keeper.origin, frame)
        except FileTrouble as error:
            self._keeper.reset()
            self._keeper.trouble = str(error)
            self._error(str(error))

    def _fail(self, error: Exception) -> None:
        self._is_reading = False
        self._keeper.trouble = str(error)
        self._error(f"{error} Running uncalibrated.")
        self._go()
