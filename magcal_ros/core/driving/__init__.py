"""What a drive shows of the vehicle: acceleration, front, and the compass against course."""
