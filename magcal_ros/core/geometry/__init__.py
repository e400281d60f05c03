"""Vectors, rotations and shapes in space, without calibration."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    arrays: centred frozen_array integral interpolated running_mean
    attitude: FRD_FROM_FLU STANDARD_GRAVITY body_from_enu field_in_enu level_part true_yaw unit
        wrap_angle wrapped yaw_from_up_and_field
    frame_tree: FIXED FrameJoint FrameTree FrameTreeError Frames pose_in_words sensor_poses
    rotations: axes_in_words chained crossed exp_rotation exp_rotations in_axes is_mirrored
        likely_slip minimal_rotation roll_pitch_between rotation_about rotation_angle
        rotation_from_quaternion rotation_from_rpy rotation_vectors_near rpy_from_rotation
        signed_permutations skew
    shapes: QuadricFit ellipse_ratio fit_circle fit_circle_in_space fit_plane fit_quadric
    slope: Slope
    """,
)
