"""From a corrected field to a yaw."""
