"""The one table of parameters: descriptors, checks and the table of doc/node.md come from it."""

from __future__ import annotations

from magcal_ros.core.calibrate import METHODS
from magcal_ros.core.earth_field.wmm import VALIDITY
from magcal_ros.core.heading.disturbance import PATIENCE
from magcal_ros.core.keeping.jobs import Mode
from magcal_ros.core.knowledge import (
    DECLINATION_SIGMA_DEG,
    INCLINATION_SIGMA_DEG,
    STRENGTH_SIGMA_UT,
)
from magcal_ros.core.samples.streams import STREAMS
from magcal_ros.ros.spec import MAGNETIC_NORTH, TRUE_NORTH, UNSET, Later, Spec

MAY_BE_ENABLED = "rotate.may_be_enabled"

PARAMETERS: tuple[Spec, ...] = (
    Spec(
        "calibration_file",
        "",
        "Where the calibration is stored and loaded from. Empty: "
        "$ROS_HOME/magcal/<namespace>/<node>.<frame of the magnetometer>.yaml. While the node runs "
        "only what lies below $ROS_HOME/magcal, or what it was at start",
        later=Later.FILE,
    ),
    Spec(
        "report_folder",
        "",
        "Where each turn leaves a dated folder with report.html and samples.csv. Empty: "
        "$ROS_HOME/magcal/reports; none: no reports. While the node runs only what lies below "
        "$ROS_HOME/magcal, or below what it was at start",
        later=Later.FOLDER,
        words=("", "none"),
    ),
    Spec(
        "reports_kept",
        50,
        "How many reports stay beside those of turns that were put in force; older ones are "
        "removed",
        1,
        100_000,
    ),
    Spec(
        "memory_limit_mb",
        1024,
        "How much more memory than at its start the node may take; a request that claims to hold "
        "millions of values ends there. Read when the node starts; fits are not bounded",
        256,
        1_000_000,
        "MB",
        later=Later.NOTHING,
    ),
    Spec("method", METHODS[0], "How a turn is turned into a calibration", choices=METHODS),
    Spec(
        "accumulate",
        False,
        "Join the next turns, made on different tilts, into one estimate of the full correction, "
        "installation yaw included; false: each turn starts afresh",
    ),
    Spec(
        "self_calibration",
        "propose",
        "What is done with a calibration that ordinary driving has shown and proved better: "
        "proposed (call ~/accept), applied (and taken back where it was worse), or nothing looked "
        "for",
        choices=tuple(mode.value for mode in Mode),
    ),
    Spec(
        "reference.strength_ut",
        UNSET,
        "Strength of the Earth's field here; .nan to take it from the World Magnetic Model",
        15.0,
        100.0,
        "µT",
    ),
    Spec(
        "reference.strength_sigma_ut",
        STRENGTH_SIGMA_UT,
        "What crust and iron near by do to the strength (1 σ); indoors rather 7",
        0.0,
        100.0,
        "µT",
    ),
    Spec(
        "reference.inclination_deg",
        UNSET,
        "Inclination (dip) of the Earth's field here, positive down; .nan for the model's",
        -90.0,
        90.0,
        "°",
    ),
    Spec(
        "reference.inclination_sigma_deg",
        INCLINATION_SIGMA_DEG,
        "What crust and iron near by do to the inclination (1 σ); indoors rather 5",
        0.0,
        90.0,
        "°",
    ),
    Spec(
        "reference.declination_deg",
        UNSET,
        "Declination here, positive east; .nan for the model's",
        -180.0,
        180.0,
        "°",
    ),
    Spec(
        "reference.declination_sigma_deg",
        DECLINATION_SIGMA_DEG,
        "What crust and iron near by do to the declination (1 σ); indoors rather 5",
        0.0,
        90.0,
        "°",
    ),
    Spec(
        "reference.latitude_deg",
        UNSET,
        "Where the robot is, for the model, positive north; .nan to take it from gps/fix",
        -90.0,
        90.0,
        "°",
    ),
    Spec(
        "reference.longitude_deg",
        UNSET,
        "The same, positive east",
        -180.0,
        180.0,
        "°",
    ),
    Spec(
        "reference.altitude_m",
        0.0,
        "The same, above the sea or the ellipsoid; a kilometre changes the strength by 0.05%",
        *VALIDITY.altitudes,
        "m",
    ),
    Spec(
        "soft_iron_gains",
        (1.0, 1.0, 1.0),
        "Known gains of the magnetometer's axes",
        0.1,
        10.0,
    ),
    Spec(
        "base_frame",
        "",
        "Frame that the attitudes are published for, given by the fixed joints of "
        "robot_description or the static transforms. Empty: the IMU's own",
    ),
    Spec(
        "vehicle_yaw_deg",
        UNSET,
        "Yaw of the IMU in the vehicle by hand, to the left of its front, for base_frame; .nan for "
        "what the robot's description says, corrected by up to 15° by what driving shows",
        -360.0,
        360.0,
        "°",
    ),
    Spec(
        "mount_rpy_deg",
        (UNSET, UNSET, UNSET),
        "Nominal roll, pitch, yaw of the magnetometer in the IMU's frame, as in a URDF; .nan for "
        "what the robot's description says if base_frame is set, else zero",
        -360.0,
        360.0,
        "°",
    ),
    Spec(
        "mount_2_rpy_deg",
        (UNSET, UNSET, UNSET),
        "The same of the magnetometer on imu/mag_2",
        -360.0,
        360.0,
        "°",
    ),
    Spec(
        "magnetometers",
        2,
        "How many magnetometers are listened to: imu/mag, imu/mag_2, imu/mag_3 and so on. One that "
        "is silent from the start does not count. Read when the node starts",
        1,
        8,
        later=Later.NOTHING,
    ),
    Spec(
        "confidence.target_sigma_deg",
        0.5,
        "Predicted heading error (1 σ, on the level) at which a complete turn is enough; so is up "
        "to twice as much where turning on no longer makes it more certain, or after 1.2 turns",
        0.01,
        10.0,
        "°",
    ),
    Spec(
        "known_heading.yaw_deg",
        UNSET,
        "Heading at which the robot stands when ~/calibrate_at_heading is called: ENU yaw, 0 to "
        "the east, 90 to the north, positive to the left; .nan for that of the topic heading",
        -360.0,
        360.0,
        "°",
    ),
    Spec(
        "known_heading.north",
        "",
        "Which north known_heading.yaw_deg is to; there is no default",
        choices=("", TRUE_NORTH, MAGNETIC_NORTH),
    ),
    Spec(
        "known_heading.sigma_deg",
        2.0,
        "How far known_heading.yaw_deg may be off (1 σ)",
        0.05,
        30.0,
        "°",
    ),
    Spec(
        "known_heading.topic_north",
        TRUE_NORTH,
        "Which north the topic heading is to; that of two antennas is true",
        choices=(TRUE_NORTH, MAGNETIC_NORTH),
    ),
    Spec(
        "window.timeout_s",
        90.0,
        "A turn is used or refused after this time, whatever was seen",
        2.0,
        3600.0,
        "s",
    ),
    Spec(
        "window.silence_s",
        10.0,
        "A turn ends when a sensor was silent for so long",
        0.5,
        600.0,
        "s",
    ),
    Spec(
        "window.max_gap_s",
        STREAMS.max_gap,
        "IMU samples further apart are not interpolated between",
        0.001,
        5.0,
        "s",
    ),
    Spec(
        "fused.patience_s",
        PATIENCE,
        "A field that departs from the calibrated one for so long is taken for the new one",
        1.0,
        3600.0,
        "s",
    ),
    Spec(
        "rotate.enabled",
        False,
        "Whether the robot turns itself, by velocities on cmd_vel, when a turn is asked for. While "
        "the node runs it may be switched off, and on only with rotate.may_be_enabled",
        later=Later.SWITCH_OFF,
    ),
    Spec(
        MAY_BE_ENABLED,
        False,
        "Whether rotate.enabled may be switched on while the node runs, by whoever reaches it. "
        "Read when the node starts",
        later=Later.NOTHING,
    ),
    Spec("rotate.speed_rad_s", 0.4, "How fast it turns", 0.1, 1.0, "rad/s"),
    Spec("rotate.stamped", False, "Whether cmd_vel is a TwistStamped instead of a Twist"),
    Spec("rotate.frame_id", "base_link", "Frame of the TwistStamped"),
)
