"""Figures and the report (matplotlib is imported when used)."""

from magcal_ros.report.folder import mark_in_force, new_folder, remove, remove_old
from magcal_ros.report.subject import Subject
from magcal_ros.report.write import write_report

__all__ = [
    "Subject",
    "mark_in_force",
    "new_folder",
    "remove",
    "remove_old",
    "write_report",
]
