"""What is wrong with the sensors: each stream by itself, and each against the others."""
