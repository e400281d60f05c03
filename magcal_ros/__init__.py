"""A compass a ground robot can trust, calibrated by one turn."""

__version__ = "0.1.0"
