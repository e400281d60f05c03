"""The least a rclpy node can do with two topics: receive both, publish both."""

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu, MagneticField


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("relay")
    for kind, topic in ((Imu, "imu/data_raw"), (MagneticField, "imu/mag")):
        publisher = node.create_publisher(kind, f"relayed/{topic}", 10)
        node.create_subscription(kind, topic, publisher.publish, qos_profile_sensor_data)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
