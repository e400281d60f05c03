"""Logs of autopilots and phones, read into the recordings that bags and CSV folders give."""
