"""Calibrations and recordings on disk, without a ROS graph; every write is atomic."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    calibration_file: LARGEST_FILE Origin backup_files keep_backup read_calibration
        write_calibration
    default_paths: LONGEST_FRAME RESERVED chosen_path identifier is_missing own_folder safe_name
        sensor_file
    disk: FileError LEFT_BEHIND NotRegularFile UNFINISHED printable read_small with_time_limit
        write_atomically
    exporters: EXPORTERS NOTES NotExportable OF_TESLA checksum number
    plausibility: BOUNDS require_possible
    px4: RIGHT_ANGLES mounting_of rotation_of
    recording: Recording read_csv_folder read_samples write_samples
    robot_description: LARGEST RobotDescriptionError joints_of
    sources: RepairedReadings open_recording
    wire: CDR
    """,
)
