"""Names and definitions of all figures of a calibration."""

from __future__ import annotations

from enum import Enum

from magcal_ros.core.geometry.arrays import FloatArray


class Figure(str, Enum):
    """A figure; SI units unless said. Its value is its name in files, in JSON and in ROS."""

    __str__ = str.__str__

    HEADING_SIGMA = "heading_sigma"
    """Predicted standard deviation of the heading on the level, radians; of a drive including local
    magnetic disturbances."""
    LOCAL_SIGMA = "local_sigma"
    """The part of it due to local disturbances; only of drives."""
    HEADING_SIGMA_TILTED = "heading_sigma_tilted"
    """The heading sigma on slopes of 10 degrees to all sides."""
    RESIDUAL_RATIO = "residual_ratio"
    """RMS of the inliers' field residual over the level field."""
    OUTLIER_SHARE = "outlier_share"
    """Share of the samples that are outliers."""
    SAMPLES = "samples"
    """Number of inliers."""
    ARC = "arc"
    """Radians of the turn that were seen."""
    RADIUS_RATIO = "radius_ratio"
    """Radius of the turn's circle over the one expected by strength and inclination; absent if one
    of them is unknown."""
    LEVEL_SHARE = "level_share"
    """The radius ratio of a body that weakens the level field so much that it is modelled as a
    gain; then there is no `RADIUS_RATIO`."""
    RADIUS_MISFIT = "radius_misfit"
    """Absolute difference of the radius ratio from one."""
    ELLIPSE_RATIO = "ellipse_ratio"
    """Longer over shorter axis of the ellipse in the turn's plane, after the known gains."""
    ELLIPSE_EXCESS = "ellipse_excess"
    """The ellipse ratio minus one, if it was not modelled as soft iron."""
    STRENGTH_DEVIATION = "strength_pull"
    """Estimated minus given strength, in sigmas of the given one; absent if that is exact or
    unknown."""
    INCLINATION_DEVIATION = "inclination_pull"
    """Estimated minus given inclination, likewise."""
    WOBBLE = "wobble"
    """RMS tilt of the turn's axis, radians per axis; zero for a rigid axis."""
    SOFT_IRON = "soft_iron"
    """One where soft iron was fitted, else zero."""
    NOT_CONVERGED = "not_converged"
    """One where the optimisation ended before it had converged, else zero."""
    ITERATIONS = "iterations"
    """Steps of the optimisation from the search's optimum to the last."""
    AXIAL_IRON = "axial_iron"
    """Hard iron along the turn's axis where only the reference field shows it, tesla."""
    INSTALLATION_ANGLE = "installation_angle"
    """Radians of the whole installation error."""
    INSTALLATION_YAW_SIGMA = "installation_yaw_sigma"
    """Standard deviation of the installation's yaw, radians; absent where nothing shows it."""
    MISALIGNMENT = "misalignment"
    """Radians between the corrected field's axes and the IMU's as gravity shows it."""
    AXIS_LEAN = "axis_lean"
    """Radians between the turn's axis and the body's z; of a robot that turned about all axes,
    between its median up and the body's z."""

    GYRO_CARRIED = "gyro_carried"
    """One where the gyro's turning explains the samples, else zero; absent without a gyro."""
    STEADY_ACCELERATION = "steady_pull"
    """Tilt of the accelerometer's up by a steady linear acceleration, which was subtracted,
    radians; absent without a gyro."""
    POSSIBLE_ACCELERATION = "possible_pull"
    """Sigma of the heading by an unobserved linear acceleration, radians; zero if samples or a rest
    exclude it; absent without a gyro."""
    MOTOR_FIELD = "motor_field"
    """Change of the field between rest and turn, or during the turn, tesla; zero if it is not
    significant, absent if it was not observed."""
    ON_THE_SPOT = "on_the_spot"
    """Probability that the robot turned on the spot and did not drive, by the smoother."""
    LATENCY = "latency"
    """Delay of the field against the gyro, seconds, which was corrected; absent if the turn does
    not show it."""
    SIDEWAYS_ACCELERATION = "sideways_pull"
    """Radians between the gyro's mean axis and the mean specific force of a full turn."""
    GYRO_COMPASS_SWING = "gyro_compass_rms"
    """RMS of the compass less the gyro by sectors of a turn, without offset, bias, scale and the
    noise of single samples; radians."""
    GYRO_COMPASS_DIFFERENCE = "gyro_compass_difference"
    """RMS of compass less gyro over all samples of a recheck, noise included, without one offset
    per part and one steady bias; radians."""
    GYRO_COMPASS_HARMONIC = "gyro_compass_harmonic"
    """RMS of the first harmonic of compass less gyro over the headings of a drive, radians; zero if
    it is not significant. Of a compass that covers few headings it is the median size of the
    difference, if that is large."""

    HEADING_SWING = "heading_swing"
    """RMS over headings by which the level field varies, over its mean."""
    STRENGTH_SPREAD = "strength_spread"
    """RMS over headings by which the strength varies, over the calibrated one."""
    DIP_SPREAD = "dip_spread"
    """RMS over headings by which the dip varies, radians."""
    STRENGTH_OFFSET = "strength_offset"
    """Mean strength minus the calibrated one, over the latter."""
    DIP_OFFSET = "dip_offset"
    """Mean dip minus the calibrated inclination, radians."""
    HARD_IRON_CHANGE = "hard_iron_change"
    """Change of the level hard iron over the level field, as a drive shows it."""
    SOFT_IRON_CHANGE = "soft_iron_change"
    """Swing of the strength twice a turn over the level field's share of it."""
    MOUNTING_CHANGE = "mounting_change"
    """Change of the angle between field and gravity, radians."""
    STRENGTH_SHIFT = "strength_shift"
    """Deviation of the strength common to all headings of a drive, over the calibrated strength."""
    DIP_SHIFT = "dip_shift"
    """Deviation of the dip common to all headings of a drive, radians."""

    COURSE_SWING_ONCE = "course_swing_once"
    """Amplitude by which compass less course swings once around, radians: hard iron."""
    COURSE_SWING_TWICE = "course_swing_twice"
    """The same twice around: soft iron."""

    STRENGTH = "strength"
    """Strength of the field, tesla."""
    GRAVITY = "gravity"
    """Median length of the specific force, m/s²."""

    TURNS = "turns"
    """Turns that were joined."""
    TURN_MISFIT = "turn_misfit"
    """Largest deviation of a turn from the others, over its expected size."""

    HEADINGS_DRIVEN = "headings_driven"
    """Number of the twelve sectors of heading in a drive."""
    DRIVING_TIME = "driving_time"
    """Seconds of a drive, standing included."""
    METRES = "metres"
    """Metres of a drive; absent where the speed was not measured."""
    STREET = "street"
    """Disturbance of the field along a drive that changes with the place, tesla per axis."""
    LOCAL_FIELD = "local_field"
    """Standard deviation of the field along a drive, including unsteady fields of the motors, tesla
    per axis."""

    KNOWN_HEADINGS = "known_headings"
    """Number of known headings."""
    HEADING_MISFIT = "heading_misfit"
    """Deviation of known headings, field and gyro from one another, over its expected size; absent
    for a single heading."""

    CIRCLE_RADIUS = "circle_radius"
    """Radius of the turn's circle, tesla."""
    AXIS_TILT = "axis_tilt"
    """Radians of the turn's axis off the vertical."""
    AXIAL_FIELD = "axial_field"
    """Field along the turn's axis, positive downwards, tesla."""
    AXIAL_HARD_IRON = "axial_hard_iron"
    """Hard iron along it, positive downwards, tesla."""
    ACCELEROMETER_SPREAD = "accelerometer_spread_over_noise"
    """Mean distance of gravity from its cloud's centre over six times its noise."""
    FIELD_SPREAD = "field_spread_over_noise"
    """The same of the field."""
    RIVAL_ROLL = "rival_roll"
    """Installation roll of the turn's second solution, radians."""
    RIVAL_PITCH = "rival_pitch"
    """Its pitch, radians."""
    RIVAL_ANGLE = "rival_angle"
    """Its whole angle, radians."""
    ACCELEROMETER_RANGE_X = "accelerometer_range_x"
    ACCELEROMETER_RANGE_Y = "accelerometer_range_y"
    ACCELEROMETER_RANGE_Z = "accelerometer_range_z"
    """Ranges of gravity after de-rotation, over g; z should be the smallest by far."""
    FIELD_RANGE_X = "field_range_x"
    FIELD_RANGE_Y = "field_range_y"
    FIELD_RANGE_Z = "field_range_z"
    """The same of the field, tesla."""

    SPHERE_EXTENT = "sphere_extent"
    """Diameters of the sphere that were seen in the least seen direction."""
    CENTRE_X = "centre_x"
    CENTRE_Y = "centre_y"
    CENTRE_Z = "centre_z"
    """Centre of the ellipsoid in nominal axes, tesla."""
    RADIUS_1 = "radius_1"
    RADIUS_2 = "radius_2"
    RADIUS_3 = "radius_3"
    """Radii of the ellipsoid, tesla."""
    RADII_RATIO = "radii_ratio"
    """The longest over the shortest of them."""
    AXIS_1_X = "axis_1_x"
    AXIS_1_Y = "axis_1_y"
    AXIS_1_Z = "axis_1_z"
    AXIS_2_X = "axis_2_x"
    AXIS_2_Y = "axis_2_y"
    AXIS_2_Z = "axis_2_z"
    AXIS_3_X = "axis_3_x"
    AXIS_3_Y = "axis_3_y"
    AXIS_3_Z = "axis_3_z"
    """Axes of the ellipsoid in nominal axes, unit, in the order of the radii."""
    OFFSET_X = "offset_x"
    OFFSET_Y = "offset_y"
    OFFSET_Z = "offset_z"
    """Middle of the field's range along each nominal axis, tesla."""
    HALF_RANGE_X = "half_range_x"
    HALF_RANGE_Y = "half_range_y"
    HALF_RANGE_Z = "half_range_z"
    """Half of that range, tesla."""

    @property
    def key(self) -> str:
        """The name of the figure in JSON and status.

        A recheck's and a drive's comparison of gyro and compass keep the one that readers know.
        """
        compared = (Figure.GYRO_COMPASS_DIFFERENCE, Figure.GYRO_COMPASS_HARMONIC)
        return "gyro_compass_rms" if self in compared else self.value


def along(name: str, values: FloatArray) -> dict[Figure, float]:
    """Return the three figures of a quantity along x, y and z, from its values (3,)."""
    return {Figure(f"{name}_{axis}"): float(v) for axis, v in zip("xyz", values, strict=True)}
