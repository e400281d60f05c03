"""Calibrates the magnetometer of a ground robot from one turn."""

__version__ = "0.1.0"
