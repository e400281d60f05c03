"""The node's messages as bytes: read on arrival, filled before sending.

rclpy turns each message into Python objects and back, which costs more than everything that is
computed with it. The few messages of the node have fixed places for all their numbers, so these
are read and written where they lie. What is laid out otherwise goes through rclpy.
"""
