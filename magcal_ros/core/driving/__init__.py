"""What a drive tells of the vehicle: its own acceleration, its front, its compass by course."""
