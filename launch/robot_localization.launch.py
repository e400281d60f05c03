"""Start the calibrator with robot_localization: wheels, gyro, compass and GPS, in two filters.

`ros2 launch magcal_ros robot_localization.launch.py`. Needs robot_localization, and tf from the
base to IMU and receiver. All settings stand in config/robot_localization.yaml: copy it, change it,
and give it as `params_file`. The calibrator is started by calibrator.launch.py, with the arguments
that are given here; `--show-args` lists them.
"""

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

CALIBRATOR = PathJoinSubstitution(
    [FindPackageShare("magcal_ros"), "launch", "calibrator.launch.py"]
)
CONFIGURATION = PathJoinSubstitution(
    [FindPackageShare("magcal_ros"), "config", "robot_localization.yaml"]
)

ARGUMENTS = (
    ("namespace", "", "Namespace of all nodes and topics"),
    ("params_file", CONFIGURATION, "Parameters of all four nodes"),
    ("use_sim_time", "false", "Whether time comes from /clock"),
    ("log_level", "info", "debug, info, warn or error"),
    ("imu", "imu/data_raw", "Topic of the IMU, sensor_msgs/Imu"),
    ("mag", "imu/mag", "Topic of the raw field, sensor_msgs/MagneticField"),
    ("mag_2", "imu/mag_2", "Topic of a second magnetometer; optional"),
    ("fix", "gps/fix", "Topic of the receiver, sensor_msgs/NavSatFix"),
    ("vel", "gps/vel", "Its velocity, geometry_msgs/TwistStamped; optional"),
    ("heading", "heading", "Topic of a measured heading, sensor_msgs/Imu; optional"),
    ("odom", "odom", "Topic of the wheels, nav_msgs/Odometry"),
    ("battery", "battery", "Topic of the current, sensor_msgs/BatteryState; optional"),
    ("cmd_vel", "cmd_vel", "Topic of the base, for rotate.enabled"),
    ("base_frame", "", "Frame of the compass's attitudes; empty: as in params_file"),
    ("calibration_file", "", "Where the calibration is stored; empty: as in params_file"),
    ("latitude", "", "Degrees north, before the first fix; empty: as in params_file"),
    ("longitude", "", "Degrees east, before the first fix; empty: as in params_file"),
)


def generate_launch_description():
    """Return the arguments, the calibrator and the three nodes of robot_localization."""
    given = {name: LaunchConfiguration(name) for name, _, _ in ARGUMENTS}
    common = {
        "namespace": given["namespace"],
        "parameters": [given["params_file"], {"use_sim_time": given["use_sim_time"]}],
        "arguments": ["--ros-args", "--log-level", given["log_level"]],
        "output": "screen",
    }
    calibrator = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(CALIBRATOR), launch_arguments=given.items()
    )
    # The filters name topics by parameter, and remaps reach those names as well.
    sensors = [("imu/data_raw", given["imu"]), ("odom", given["odom"])]
    filters = [
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
    return LaunchDescription([*declared, calibrator, *filters])
