"""Names and definitions of all figures of a calibration."""

from __future__ import annotations

from enum import Enum

from magcal_ros.core.geometry.arrays import FloatArray


class Figure(str, Enum):
    """A figure; SI units unless said. Its value is its name in files, in JSON and in ROS."""

    __str__ = str.__str__

    HEADING_SIGMA = "heading_sigma"
    """Predicted standard deviation of the heading on the level, radians; after a drive with what
    local magnetic disturbances along such a way add."""
    LOCAL_SIGMA = "local_sigma"
    """The part of it that the local disturbances make; only of drives."""
    HEADING_SIGMA_TILTED = "heading_sigma_tilted"
    """The same on slopes of 10 degrees to all sides."""
    RESIDUAL_RATIO = "residual_ratio"
    """RMS of the inliers' field residual over the level field."""
    OUTLIER_SHARE = "outlier_share"
    """Share of the samples that are outliers."""
    SAMPLES = "samples"
    """Number of inliers."""
    ARC = "arc"
    """Radians of the turn that were seen."""
    RADIUS_RATIO = "radius_ratio"
    """Radius of the turn's circle over the one that the known strength and inclination ask for;
    absent where one of them is unknown."""
    LEVEL_SHARE = "level_share"
    """The same where the body weakens the level field so much that it was taken for a gain; then
    there is no `RADIUS_RATIO`."""
    RADIUS_MISFIT = "radius_misfit"
    """How far the radius ratio is off one, beyond what the reference's own uncertainty allows."""
    ELLIPSE_RATIO = "ellipse_ratio"
    """Longer over shorter axis of the ellipse in the turn's plane, after the known gains."""
    ELLIPSE_EXCESS = "ellipse_excess"
    """The same less one, where it was not taken for soft iron."""
    STRENGTH_DEVIATION = "strength_pull"
    """Strength found minus believed, in sigmas of the belief; absent where that is exact or
    unknown."""
    INCLINATION_DEVIATION = "inclination_pull"
    """The same for the inclination."""
    WOBBLE = "wobble"
    """RMS lean of the turn's axis, radians per axis; zero for a rigid axis."""
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
    between its usual up and the body's z."""

    GYRO_CARRIED = "gyro_carried"
    """One where the gyro's turning explains the samples, else zero; absent without a gyro."""
    STEADY_ACCELERATION = "steady_pull"
    """Lean of the accelerometer's up that was found to turn with the robot and was subtracted,
    radians; zero without one; absent without a gyro."""
    POSSIBLE_ACCELERATION = "possible_pull"
    """What a linear acceleration that nothing shows may do to the heading, radians, one sigma; zero
    where samples or a rest beside the turn exclude it; absent without a gyro."""
    MOTOR_FIELD = "motor_field"
    """Field that is there while the robot turns and not while it rests beside its turn, or that
    switched on the way, tesla; zero where chance explains it, absent where nothing shows it."""
    ON_THE_SPOT = "on_the_spot"
    """Probability that the robot turned on the spot and did not drive, by the smoother."""
    LATENCY = "latency"
    """By how much the field comes later than the gyro, seconds, taken off; absent where the turn
    does not show any."""
    SIDEWAYS_ACCELERATION = "sideways_pull"
    """Radians between the gyro's mean axis and the mean specific force of a full turn."""
    GYRO_COMPASS_SWING = "gyro_compass_rms"
    """RMS of a turn's lasting swing of the compass against the gyro by sectors of the turn:
    offset, bias, scale and the noise of single samples taken off; radians."""
    GYRO_COMPASS_DIFFERENCE = "gyro_compass_difference"
    """RMS of compass less gyro over all samples of a recheck, noise included: one offset a
    stretch and one steady bias taken off; radians."""
    GYRO_COMPASS_HARMONIC = "gyro_compass_harmonic"
    """RMS of the first harmonic of compass less gyro over the headings of a drive, zero unless
    it stands out of its noise; of a compass that has hardly come round the median size of all of
    it, where it is lost; radians."""

    HEADING_SWING = "heading_swing"
    """RMS over headings by which the level field varies, over its mean."""
    STRENGTH_SPREAD = "strength_spread"
    """RMS over headings by which the strength varies, over the calibrated one."""
    DIP_SPREAD = "dip_spread"
    """RMS over headings by which the dip varies, radians."""
    STRENGTH_OFFSET = "strength_offset"
    """How far the mean strength is off the calibrated one, over it."""
    DIP_OFFSET = "dip_offset"
    """How far the mean dip is off the calibrated inclination, radians."""
    HARD_IRON_CHANGE = "hard_iron_change"
    """Change of the level hard iron over the level field, as a drive shows it."""
    SOFT_IRON_CHANGE = "soft_iron_change"
    """Swing of the strength twice a turn over the level field's share of it."""
    MOUNTING_CHANGE = "mounting_change"
    """Radians by which the field has tilted against gravity."""
    STRENGTH_SHIFT = "strength_shift"
    """How far the strength at all headings of a drive is off the calibrated one, over it."""
    DIP_SHIFT = "dip_shift"
    """How far the dip at all headings of a drive is off the calibrated inclination, radians."""

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
    """Worst turn off the others, as many times as noise explains."""

    HEADINGS_DRIVEN = "headings_driven"
    """How many of twelve sectors of heading a drive went through."""
    DRIVING_TIME = "driving_time"
    """Seconds of a drive, standing included."""
    METRES = "metres"
    """Metres of a drive; absent where the speed was not measured."""
    STREET = "street"
    """Disturbance of the field along a drive that changes with the place, tesla per axis."""
    LOCAL_FIELD = "local_field"
    """By how much the field deviates along a drive, with what motors add unsteadily: tesla per
    axis, standard deviation."""

    KNOWN_HEADINGS = "known_headings"
    """At how many known headings a robot stood."""
    HEADING_MISFIT = "heading_misfit"
    """How far known headings, field and gyro are apart, as many times as their sigmas explain;
    absent of one known heading alone, which nothing contradicts."""

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
