"""What is true of the data: numpy and scipy only; no ROS, no clock, no files, no printing."""
