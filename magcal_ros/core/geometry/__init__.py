"""Vectors, rotations and shapes in space; nothing about calibration."""

from magcal_ros.core.geometry.arrays import (
    BoolArray,
    FloatArray,
    centred,
    frozen_array,
    interpolated,
    running_mean,
    runs,
)
from magcal_ros.core.geometry.attitude import (
    FRD_FROM_FLU,
    STANDARD_GRAVITY,
    body_from_enu,
    field_in_enu,
    level_part,
    true_yaw,
    unit,
    wrap_angle,
    wrapped,
    yaw_from_up_and_field,
)
from magcal_ros.core.geometry.rotations import (
    chained,
    exp_rotation,
    exp_rotations,
    is_mirrored,
    likely_slip,
    minimal_rotation,
    roll_pitch_between,
    rotation_about,
    rotation_angle,
    rotation_from_quaternion,
    rotation_from_rpy,
    rpy_from_rotation,
    signed_permutations,
    skew,
    spoken,
)

__all__ = [
    "FRD_FROM_FLU", "STANDARD_GRAVITY", "BoolArray", "FloatArray", "body_from_enu", "centred",
    "chained", "exp_rotation", "exp_rotations", "field_in_enu", "frozen_array", "interpolated",
    "is_mirrored", "level_part", "likely_slip", "minimal_rotation", "roll_pitch_between",
    "rotation_about", "rotation_angle", "rotation_from_quaternion", "rotation_from_rpy",
    "rpy_from_rotation", "running_mean", "runs", "signed_permutations", "skew", "spoken",
    "true_yaw", "unit", "wrap_angle", "wrapped", "yaw_from_up_and_field",
]  # fmt: skip
