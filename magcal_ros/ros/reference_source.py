"""The reference field in use, by parameters, place and date."""

from __future__ import annotations

import time
from dataclasses import replace

from rclpy.node import Node

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.earth_field.position import Fix, Fixes
from magcal_ros.core.earth_field.reference import Reference, made_elsewhere, resolve
from magcal_ros.core.earth_field.wmm import year_of
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.ros.announcer import Announcer
from magcal_ros.ros.parameters import Parameters
from magcal_ros.ros.settings import Settings

HALF_A_PLACE = (
    "only one of reference.latitude_deg and reference.longitude_deg is given: give both, or leave "
    "both out"
)

FIX_PAUSE = 0.2
"""Seconds after a look within which another fix brings no new one."""


class ReferenceSource:
    """Listens to gps/fix and keeps the reference field up to date."""

    def __init__(self, node: Node, table: Parameters) -> None:
        self._node, self._table = node, table
        self._fixes = Fixes()
        self._calibration: Calibration | None = None
        self._settings: Settings | None = None
        self._announcer = Announcer(node.get_logger(), lasting=0.0)
        self._looked = -FIX_PAUSE
        self._reference = Reference(ReferenceField(), "unknown")
        self.refresh()

    @property
    def reference(self) -> Reference:
        """The reference field in use, by the parameters of this moment."""
        if self._table.settings is not self._settings:
            self.refresh()
        return self._reference

    @property
    def settings(self) -> Settings:
        """The parameters, with the reference field in use in place of the one given by hand."""
        settings = self._table.settings
        knowledge = replace(settings.knowledge, reference=self.reference.field)
        return replace(settings, knowledge=knowledge)

    def use(self, calibration: Calibration | None) -> None:
        """Compare the place where a calibration was made with this one from now on."""
        self._calibration = calibration
        self.refresh()

    def refresh(self) -> None:
        """Evaluate parameters, place and date again, and log what is new."""
        self._looked = time.monotonic()
        before, self._reference = self._reference, self._resolve()
        say = self._announcer
        say.complain(self._reference.complaints)
        north, was = self._reference.north, before.north
        if self._calibration is not None and north != was:
            words = f"compass/yaw counts from {north} north from now on, not from {was} north"
            say.tell("north", words, wrong=True)
        if before.source != self._reference.source:
            say.tell("reference", f"reference field: {self._reference.words}")
        say.catch_up()

    def _resolve(self) -> Reference:
        settings = self._settings = self._table.settings
        given = settings.knowledge.reference
        place = settings.place or self._fixes.place
        found = resolve(given, settings.local, place, None if place is None else self._year())
        notes = list(found.complaints)
        if settings.place is not None or not given.is_known:
            notes += self._fixes.complaints(settings.place)
        if settings.half_place:
            notes.append(HALF_A_PLACE)
        if self._calibration is not None:
            notes.append(made_elsewhere(self._calibration, found.field))
        return replace(found, complaints=tuple(note for note in notes if note))

    def _year(self) -> float:
        """Return the date to a tenth of a year; a clock of its own has simulated time."""
        clock = self._node.get_clock().now().nanoseconds * 1e-9
        return round(year_of((self._fixes.stamp, clock), time.time()), 1)

    def on_fix(self, fix: Fix) -> None:
        """Take a fix of a receiver."""
        news = self._fixes.add(fix)
        # The heartbeat looks again, so that a faulty receiver cannot cost a model for each message.
        if news and time.monotonic() - self._looked >= FIX_PAUSE:
            self.refresh()
