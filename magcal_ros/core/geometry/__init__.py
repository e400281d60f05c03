"""Vectors, rotations and shapes in space; nothing about calibration."""
