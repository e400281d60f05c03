"""What a drive shows: the vehicle's acceleration, its front, and the compass against course."""
