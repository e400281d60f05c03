"""The node; only this part of the package imports rclpy."""
