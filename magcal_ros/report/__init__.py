"""Figures and the report (matplotlib is imported when used)."""

from magcal_ros.report.turn import Subject
from magcal_ros.report.write import mark_in_force, new_folder, remove, remove_old, write_report

__all__ = ["Subject", "mark_in_force", "new_folder", "remove", "remove_old", "write_report"]
