"""Reports with figures (matplotlib is imported when it is used)."""

from magcal_ros.report.turn import Subject
from magcal_ros.report.write import mark_in_force, new_folder, remove, remove_old, write_report

__all__ = ["Subject", "mark_in_force", "new_folder", "remove", "remove_old", "write_report"]
