"""Samples of the sensors: streams, paired windows, and their faults."""
