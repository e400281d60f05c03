"""Figures and the report (matplotlib is imported when used)."""
