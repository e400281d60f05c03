"""Vectors, rotations and shapes in space, without calibration."""
