"""Start the calibrator.

`ros2 launch magcal_ros calibrator.launch.py imu:=/your/imu mag:=/your/magnetometer`, and
`--show-args` lists the rest.
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
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
    ("mag_2", "imu/mag_2", "Topic of a second magnetometer; optional"),
    ("fix", "gps/fix", "Topic of the receiver, sensor_msgs/NavSatFix; optional"),
    ("vel", "gps/vel", "Its velocity, geometry_msgs/TwistStamped; optional"),
    ("heading", "heading", "Topic of a measured heading, sensor_msgs/Imu; optional"),
    ("odom", "odom", "Topic of the wheels, nav_msgs/Odometry; optional"),
    ("battery", "battery", "Topic of the current, sensor_msgs/BatteryState; optional"),
    ("cmd_vel", "cmd_vel", "Topic of the base, for rotate.enabled"),
    ("base_frame", "", "Frame for which attitudes are published; empty: as in params_file"),
    ("calibration_file", "", "Where the calibration is stored; empty: as in params_file"),
    ("latitude", "", "Degrees north, for the reference field; empty: as in params_file"),
    ("longitude", "", "Degrees east, for the reference field; empty: as in params_file"),
)

TEXTS = ("base_frame", "calibration_file")
NUMBERS = {"latitude": "reference.latitude_deg", "longitude": "reference.longitude_deg"}
"""Parameters of the node that may be given here as well."""


def start_node(context):
    """Return the node; what was given here takes precedence over the file of parameters."""
    given = {name: LaunchConfiguration(name) for name, _, _ in ARGUMENTS}
    parameters = {
        name: ParameterValue(given[name], value_type=str)
        for name in TEXTS
        if given[name].perform(context)
    }
    for name, parameter in NUMBERS.items():
        if words := given[name].perform(context):
            parameters[parameter] = float(words)  # 48 as well as 48.0
    node = Node(
        package="magcal_ros",
        executable="calibrator",
        name="calibrator",
        namespace=given["namespace"],
        parameters=[given["params_file"], {"use_sim_time": given["use_sim_time"], **parameters}],
        remappings=[
            ("imu/data_raw", given["imu"]),
            ("imu/mag", given["mag"]),
            ("imu/mag_2", given["mag_2"]),
            ("gps/fix", given["fix"]),
            ("gps/vel", given["vel"]),
            ("heading", given["heading"]),
            ("odom", given["odom"]),
            ("battery", given["battery"]),
            ("cmd_vel", given["cmd_vel"]),
        ],
        arguments=["--ros-args", "--log-level", given["log_level"]],
        output="screen",
    )
    return [node]


def generate_launch_description():
    """Return the arguments and the node."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=words)
        for name, default, words in ARGUMENTS
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start_node)])
