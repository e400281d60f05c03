"""The node: rclpy lives only here."""
