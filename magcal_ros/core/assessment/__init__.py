"""Grades of figures, bounds and verdicts."""
