"""The services `save` and `load`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from magcal_ros.core.session.turn_events import Conclusion
from magcal_ros.files.atomic import FileTrouble
from magcal_ros.ros.background_thread import BackgroundThread
from magcal_ros.ros.keeper import Keeper
from magcal_ros.ros.services import Tell


class CalibrationStore:
    """Saves and loads the calibration when a service asks for it.

    Parameters
    ----------
    keeper : Keeper
        Has the calibration in force.
    files : BackgroundThread
        Reads and writes the files.
    find_path : callable
        Returns the file to save to.
    of_sensor : callable
        Returns the file that the user named (or nothing) and the magnetometer's frame.
    """

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
