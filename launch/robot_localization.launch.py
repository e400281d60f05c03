"""Start the calibrator with robot_localization: wheels, gyro, compass and GPS, in two filters.

`ros2 launch magcal_ros robot_localization.launch.py`. Needs robot_localization, and tf from the
base to IMU and receiver. All settings stand in config/robot_localization.yaml: copy it, change it,
and give it as `params_file`.
"""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

CONFIGURATION = PathJoinSubstitution(
    [FindPackageShare("magcal_ros"), "config", "robot_localization.yaml"]
)

ARGUMENTS = (
    ("namespace", "", "Namespace of all nodes and topics"),
    ("params_file", CONFIGURATION, "Parameters of all four nodes"),
    ("use_sim_time", "false", "Whether time comes from /clock"),
    ("imu", "imu/data_raw", "Topic of the IMU, sensor_msgs/Imu"),
    ("mag", "imu/mag", "Topic of the raw field, sensor_msgs/MagneticField"),
    ("fix", "gps/fix", "Topic of the receiver, sensor_msgs/NavSatFix"),
    ("odom", "odom", "Topic of the wheels, nav_msgs/Odometry"),
)


def generate_launch_description():
    """Return the arguments and the four nodes."""
    given = {name: LaunchConfiguration(name) for name, _, _ in ARGUMENTS}
    common = {
        "namespace": given["namespace"],
        "parameters": [given["params_file"], {"use_sim_time": given["use_sim_time"]}],
        "output": "screen",
    }
    # The filters name topics by parameter, and remaps reach those names as well.
    sensors = [("imu/data_raw", given["imu"]), ("odom", given["odom"])]
    nodes = [
        Node(
            package="magcal_ros",
            executable="calibrator",
            name="calibrator",
            remappings=[*sensors, ("imu/mag", given["mag"]), ("gps/fix", given["fix"])],
            **common,
        ),
        # Continuous, for control: odom to base_link.
        Node(
            package="robot_localization",
            executable="ekf_node",
            name="ekf_filter_node_odom",
            remappings=[*sensors, ("odometry/filtered", "odometry/local")],
            **common,
        ),
        # Absolute, with compass and GPS: map to odom.
        Node(
            package="robot_localization",
            executable="ekf_node",
            name="ekf_filter_node_map",
            remappings=[*sensors, ("odometry/filtered", "odometry/global")],
            **common,
        ),
        # Fixes become metres in the map.
        Node(
            package="robot_localization",
            executable="navsat_transform_node",
            name="navsat_transform",
            remappings=[
                ("imu", "compass/true/enu/imu"),
                ("gps/fix", given["fix"]),
                ("odometry/filtered", "odometry/global"),
            ],
            **common,
        ),
    ]
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=words)
        for name, default, words in ARGUMENTS
    ]
    return LaunchDescription([*declared, *nodes])
