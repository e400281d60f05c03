"""Shapes and turns in space, without a word of calibration."""
