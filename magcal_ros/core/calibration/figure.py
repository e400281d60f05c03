"""Names and definitions of all figures of a calibration."""

from __future__ import annotations

from enum import Enum

from magcal_ros.core.geometry.arrays import FloatArray


class Figure(str, Enum):
    """A figure; SI units unless stated. Its value is its name in files, in JSON and in ROS."""

    __str__ = str.__str__

    HEADING_SIGMA = "heading_sigma"
    """Predicted sigma of the heading on the level, radians; of a drive with local disturbances."""
    LOCAL_SIGMA = "local_sigma"  # part of the heading sigma by local disturbances; only of drives
    HEADING_SIGMA_TILTED = "heading_sigma_tilted"
    """The heading sigma on slopes of 10 degrees to all sides."""
    RESIDUAL_RATIO = "residual_ratio"  # RMS of the inliers' field residual over the level field
    OUTLIER_SHARE = "outlier_share"  # share of the samples that are outliers
    SAMPLES = "samples"  # number of inliers
    ARC = "arc"  # radians of the turn that were seen
    RADIUS_RATIO = "radius_ratio"
    """Radius of the turn's circle over that of the reference; absent if the latter is unknown."""
    LEVEL_SHARE = "level_share"
    """The radius ratio, if a body weakens the level field so much that it is modelled as a gain;
    `RADIUS_RATIO` is then absent."""
    RADIUS_MISFIT = "radius_misfit"  # absolute difference of the radius ratio from one
    ELLIPSE_RATIO = "ellipse_ratio"
    """Longer over shorter axis of the ellipse in the turn's plane, after the known gains."""
    ELLIPSE_EXCESS = "ellipse_excess"
    """The ellipse ratio minus one, if it was not modelled as soft iron."""
    STRENGTH_DEVIATION = "strength_pull"
    """Normalised difference of estimated and given strength; absent if that is exact or unknown."""
    INCLINATION_DEVIATION = "inclination_pull"  # estimated minus given inclination, likewise
    WOBBLE = "wobble"  # RMS tilt of the turn's axis, radians per axis; zero for a rigid axis
    SOFT_IRON = "soft_iron"  # one if soft iron was fitted, else zero
    NOT_CONVERGED = "not_converged"
    """One if the optimisation ended before it had converged, else zero."""
    ITERATIONS = "iterations"  # steps of the optimisation from the search's optimum to the last
    AXIAL_IRON = "axial_iron"
    """Hard iron along the turn's axis, if only the reference field determines it, tesla."""
    REFERENCE_STRENGTH = "reference_strength"
    REFERENCE_INCLINATION = "reference_inclination"
    """The reference field that the calibration was made with, tesla and radians; absent if it was
    not known."""
    INSTALLATION_ANGLE = "installation_angle"  # radians of the whole installation error
    INSTALLATION_YAW_SIGMA = "installation_yaw_sigma"
    """Standard deviation of the installation's yaw, radians; absent if it is not observable."""
    MISALIGNMENT = "misalignment"
    """Angle between the corrected field's axes and the IMU's, by gravity, radians."""
    AXIS_LEAN = "axis_lean"
    """Angle between the turn's axis and the body's z, radians; for a robot that turned about all
    axes, between the median up and the body's z."""

    GYRO_CARRIED = "gyro_carried"
    """One if the gyro's rotation explains the samples, else zero; absent without a gyro."""
    STEADY_ACCELERATION = "steady_pull"
    """Tilt of the accelerometer's up by a steady linear acceleration, which was subtracted,
    radians; absent without a gyro."""
    POSSIBLE_ACCELERATION = "possible_pull"
    """Sigma of the heading by an unobserved linear acceleration, radians; zero if samples or a rest
    exclude it; absent without a gyro."""
    MOTOR_FIELD = "motor_field"
    """Change of the field between rest and turn, or during the turn, tesla; zero if it is not
    significant, absent if it was not observed."""
    IRON_DRIFT = "iron_drift"
    """Change of the hard iron from the beginning to the end of a window, tesla; zero if it is not
    significant."""
    ON_THE_SPOT = "on_the_spot"
    """Probability that the robot turned on the spot and did not drive, by the smoother."""
    LATENCY = "latency"
    """Corrected latency of the field against the gyro, seconds; absent if not observable."""
    GYRO_SCALE = "gyro_scale"
    """Relative error of the gyro's rate about up; absent without a gyro."""
    SIDEWAYS_ACCELERATION = "sideways_pull"
    """Radians between the gyro's mean axis and the mean specific force of a full turn."""
    GYRO_COMPASS_SWING = "gyro_compass_rms"
    """RMS of compass minus gyro by sectors of a turn, without offset, bias, scale and the noise of
    single samples; radians."""
    GYRO_COMPASS_DIFFERENCE = "gyro_compass_difference"
    """RMS of compass minus gyro in a recheck, without the part by the calibration, radians."""

    HEADING_SWING = "heading_swing"
    """RMS heading error of a calibration by a new fit, without its constant part, radians."""
    STRENGTH_OFFSET = "strength_offset"  # mean strength minus the calibrated one, over the latter
    DIP_OFFSET = "dip_offset"  # mean dip minus the calibrated inclination, radians

    STRENGTH = "strength"  # strength of the field, tesla
    GRAVITY = "gravity"  # median length of the specific force, m/s²

    TURNS = "turns"  # turns that were joined
    TURN_MISFIT = "turn_misfit"
    """Largest deviation of a turn from the others, over its expected size."""

    HEADINGS_DRIVEN = "headings_driven"  # number of the twelve sectors of heading in a drive
    DRIVING_TIME = "driving_time"  # seconds of a drive, with rests
    METRES = "metres"  # length of a drive, metres; absent if the speed was not measured
    STREET = "street"
    """Local disturbance of the field along a drive, tesla per axis."""
    LOCAL_FIELD = "local_field"
    """Sigma of the field along a drive, with the motors' fluctuation, tesla per axis."""

    KNOWN_HEADINGS = "known_headings"  # number of known headings
    HEADING_MISFIT = "heading_misfit"
    """RMS normalised residual of known headings, field and gyro; absent for one heading."""

    CIRCLE_RADIUS = "circle_radius"  # radius of the turn's circle, tesla
    AXIS_TILT = "axis_tilt"  # radians of the turn's axis off the vertical
    AXIAL_FIELD = "axial_field"  # field along the turn's axis, positive downwards, tesla
    AXIAL_HARD_IRON = "axial_hard_iron"  # hard iron along the axis, positive downwards, tesla
    ACCELEROMETER_SPREAD = "accelerometer_spread_over_noise"
    """Mean distance of gravity from its mean over six times its noise."""
    FIELD_SPREAD = "field_spread_over_noise"  # the same for the field
    RIVAL_ROLL = "rival_roll"  # installation roll of the turn's second solution, radians
    RIVAL_PITCH = "rival_pitch"  # its pitch, radians
    RIVAL_ANGLE = "rival_angle"  # its whole angle, radians
    ACCELEROMETER_RANGE_X = "accelerometer_range_x"
    ACCELEROMETER_RANGE_Y = "accelerometer_range_y"
    ACCELEROMETER_RANGE_Z = "accelerometer_range_z"
    """Ranges of gravity after de-rotation, over g; z should be the smallest by far."""
    FIELD_RANGE_X, FIELD_RANGE_Y, FIELD_RANGE_Z = "field_range_x", "field_range_y", "field_range_z"
    """The same for the field, tesla."""

    SPHERE_EXTENT = "sphere_extent"
    """Diameters of the sphere that were seen in the least seen direction."""
    CENTRE_X, CENTRE_Y, CENTRE_Z = "centre_x", "centre_y", "centre_z"
    """Centre of the ellipsoid in nominal axes, tesla."""
    RADIUS_1, RADIUS_2, RADIUS_3 = "radius_1", "radius_2", "radius_3"
    """Radii of the ellipsoid, tesla."""
    RADII_RATIO = "radii_ratio"  # the longest over the shortest of them
    AXIS_1_X, AXIS_1_Y, AXIS_1_Z = "axis_1_x", "axis_1_y", "axis_1_z"
    AXIS_2_X, AXIS_2_Y, AXIS_2_Z = "axis_2_x", "axis_2_y", "axis_2_z"
    AXIS_3_X, AXIS_3_Y, AXIS_3_Z = "axis_3_x", "axis_3_y", "axis_3_z"
    """Axes of the ellipsoid in nominal axes, unit, in the order of the radii."""
    OFFSET_X, OFFSET_Y, OFFSET_Z = "offset_x", "offset_y", "offset_z"
    """Middle of the field's range along each nominal axis, tesla."""
    HALF_RANGE_X, HALF_RANGE_Y, HALF_RANGE_Z = "half_range_x", "half_range_y", "half_range_z"
    """Half of that range, tesla."""

    @property
    def key(self) -> str:
        """The name of the figure in JSON and status."""
        return "gyro_compass_rms" if self is Figure.GYRO_COMPASS_DIFFERENCE else self.value


def along(name: str, values: FloatArray) -> dict[Figure, float]:
    """Return the three figures of a quantity along x, y and z, from its values (3,)."""
    return {Figure(f"{name}_{axis}"): float(v) for axis, v in zip("xyz", values, strict=True)}
