"""Calibrations and recordings on disk: no ROS graph, every write atomic."""
