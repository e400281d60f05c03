"""Start the calibrator.

`ros2 launch magcal_ros calibrator.launch.py imu:=/your/imu mag:=/your/magnetometer`, and
`--show-args` lists the rest.
"""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

CONFIGURATION = PathJoinSubstitution([FindPackageShare("magcal_ros"), "config", "calibrator.yaml"])

ARGUMENTS = (
    ("namespace", "", "Namespace of the node and of all its topics"),
    ("params_file", CONFIGURATION, "Parameters; config/ of the package has samples"),
    ("use_sim_time", "false", "Whether time comes from /clock"),
    ("log_level", "info", "debug, info, warn or error"),
    ("imu", "imu/data_raw", "Topic of the IMU, sensor_msgs/Imu"),
    ("mag", "imu/mag", "Topic of the raw field, sensor_msgs/MagneticField"),
    ("fix", "gps/fix", "Topic of the receiver, sensor_msgs/NavSatFix; optional"),
    ("odom", "odom", "Topic of the wheels, nav_msgs/Odometry; optional"),
    ("cmd_vel", "cmd_vel", "Topic of the base, for rotate.enabled"),
)


def generate_launch_description():
    """Return the arguments and the node."""
    given = {name: LaunchConfiguration(name) for name, _, _ in ARGUMENTS}
    node = Node(
        package="magcal_ros",
        executable="calibrator",
        name="calibrator",
        namespace=given["namespace"],
        parameters=[given["params_file"], {"use_sim_time": given["use_sim_time"]}],
        remappings=[
            ("imu/data_raw", given["imu"]),
            ("imu/mag", given["mag"]),
            ("gps/fix", given["fix"]),
            ("odom", given["odom"]),
            ("cmd_vel", given["cmd_vel"]),
        ],
        arguments=["--ros-args", "--log-level", given["log_level"]],
        output="screen",
    )
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=words)
        for name, default, words in ARGUMENTS
    ]
    return LaunchDescription([*declared, node])
