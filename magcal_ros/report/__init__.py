"""Figures and the report (matplotlib is imported when used)."""

from magcal_ros.report.folder import new_folder
from magcal_ros.report.subject import Subject
from magcal_ros.report.write import write_report

__all__ = ["Subject", "new_folder", "write_report"]
