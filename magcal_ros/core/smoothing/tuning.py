"""What the smoother takes for granted of sensors, streets and magnetometers."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class SmootherTuning:
    """The smoother's model in numbers; fields in microtesla.

    Parameters
    ----------
    row : float
        Seconds of samples that make one row of the log of a drive.
    chunk : int
        Rows after which it is asked whether the robot rests.
    rests, rest_chunks : int
        What is remembered of the gyro: rests, and chunks of each that its mean is over.
    node : float
        Seconds of samples that make one node: a field turns little in it, and noise averages out.
    most_nodes : int
        Of one fit, which bounds its time: ten minutes of driving.
    level_memory, pulled : float
        Seconds over which up is averaged before and after, and the share of gravity by which a
        specific force may be off its usual length before it weighs less.
    level_memory_unpulled, unpulled, pull_memory : float, float, float
        The same seconds where nothing pulls the force aside: by less than so many m/s² in the mean,
        over a second each, from up averaged over the last of the three. Then a gyro errs more than
        the accelerometer, and a robot that tells no speed is taken to stay where it is.
    fewest_seconds : int
        Seconds of a stretch below which nobody can tell whether something pulls.
    bias_stretches : tuple of float
        Seconds of the stretches in which the gyro's bias is told from what pulls in bends, round
        after round.
    rested_bias, rested_limit : float, float
        What a bias that a rest has shown changes by from rest to motion, rad/s per axis; and sigmas
        of it up to which a robot may be one that stays.
    bias_rows : int
        Rows of the log that are one row there.
    usual_bias, largest_bias, any_bias : float, float, float
        rad/s, of the gyro's bias; of a larger one every size is as likely as another. And the one
        up to which a robot may be one that stays, as what a small circle pulls looks like more, and
        from which what the drive says alone is looked into. And one sigma where that is asked.
    pull_per_rate : float
        How far a bend leans the force, over gravity, per rad/s of turning: that of 10 m/s.
    jolt_lean, jolt_seconds : float
        What else leans it, over gravity, and seconds over which that is one and the same.
    bends_alike : float
        How many bends count as one where it is told how certain the bias is: drivers take all of
        them alike, and what they pull otherwise than the turn rate says is systematic.
    still_field, still_yaw, still_rate : float
        A block that differs by no more than this from the one that began a rest, microtesla beyond
        its noise and radians, stands; a gyro's bias turns on by so much more, rad/s.
    rest_field, rest_rate, rest_force, rest_noise, rest_speed : float
        A robot rests while five seconds of rows change by less than this from half to half:
        microtesla and rad/s, so many times their spread included; the force may spread by m/s²,
        and the speed, where it is known, is m/s at most.
    street, noise : float
        Standard deviations per axis of the streets' disturbance and of a node's own noise, small
        iron within two metres included. Cars in two cities: 2.5 to 5 and about 1.5.
    reach : float
        Metres over which the disturbance is alike, e to the minus one.
    small_reach : float
        Metres over which small iron is alike: who comes again sees it again.
    own_noise : float
        What of a node's noise is the sensor's own, and new each time.
    most_places : int
        Places between which the streets' covariance is reckoned; nodes beyond are joined.
    freedom : float
        Degrees of freedom of Student's distribution of both.
    usual_speed : float
        m/s, for the metres of a robot that tells no speed.
    angle_walk : float
        rad/s^.5, angle random walk of the gyro's yaw, what turns leave of its scale included.
    hard_iron, tilt, soft_iron, soft_iron_upright, gyro_bias, gyro_scale : float
        Prior sigmas: hard iron about the linear start, installation roll and pitch (rad), soft
        iron in the level plane and out of it, the gyro's bias about up (rad/s), its scale.
    strength, unknown_strength, unknown_dip, gain : float
        Prior sigmas of the level and upright field where the reference says less: per axis;
        relative and radians where there is no reference; the sensor's own gain, relative.
    typical_dip : float
        Radians of inclination, where there is no reference.
    counts : float
        How often the priors on tilt, soft iron and field count: the errors of nodes are not as
        independent as the model has them, and their number would overrule them.
    widest_soft_iron, far_beyond : float
        A number of soft iron beyond `far_beyond` sigmas gets a sigma of its own size, at most this.
    shared_soft_iron : float
        And the others at least this share of it: iron that bends one number bends them all.
    weak : float
        Share of the reference's level field below which the body is taken to take some away.
    no_strain : float
        Sigmas that the level field may be pulled from what is believed; beyond, the calibration's
        sigma grows in proportion: something is there that the model does not have.
    kept_tilt, kept_soft_iron : float
        Prior sigmas of tilt (rad) and soft iron where only the hard iron is sought anew.
    fewest_nodes, fewest_for_iron : int
        Below which nothing is fitted, and no iron is sought that was added.
    steps_tried, moments_apart, fewest_since : int
        Of a change of the hard iron: how many of the largest steps of the field are tried, and how
        many nodes apart moments besides; nodes before and since that it takes.
    least_tied : float
        Share of the nodes that the gyro must have been heard on the way to.
    believed : float
        Student's weight above which a node counts as believed.
    pseudo, least_street, least_noise : float
        The sizes of street and noise are estimated with so many observations of the usual size,
        and never below these shares of it.
    most_repeated : float
        By how much a road that is driven again and again widens the variance at most: part of what
        it tells is the sensor's own noise, which does not repeat.
    usual_observations : float
        Independent observations of new road that the usual size of the street counts as, in the
        smallest sigma that streets allow.
    lasting : float
        Microtesla that sensors and a place err by all along a window in which nobody travels.
    start_rounds, start_field : int, float
        Rounds of reweighting to the linear start, and microtesla to which the prior's field along
        up is known there: enough to keep apart what level ground does not.
    most_rounds, enough, largest_turn : int, float, float
        Steps at most; a heading that moves less than this many radians has converged; the largest
        turn of any node in one step.
    """

    row: float = 0.1
    chunk: int = 10
    rests: int = 60
    rest_chunks: int = 60
    node: float = 0.5
    most_nodes: int = 1200
    level_memory: float = 20.0
    pulled: float = 0.1
    level_memory_unpulled: float = 2.0
    unpulled: float = 0.15
    pull_memory: float = 8.0
    fewest_seconds: int = 10
    bias_stretches: tuple[float, ...] = (8.0, 8.0, 15.0, 30.0)
    bias_rows: int = 2
    usual_bias: float = 0.003
    largest_bias: float = 0.012
    rested_bias: float = 0.001
    rested_limit: float = 4.0
    any_bias: float = 0.1
    pull_per_rate: float = 1.0
    jolt_lean: float = 0.05
    jolt_seconds: float = 2.0
    bends_alike: float = 4.0
    still_field: float = 0.1
    still_yaw: float = math.radians(1.0)
    still_rate: float = math.radians(0.3)
    rest_field: float = 0.6
    rest_rate: float = math.radians(0.5)
    rest_force: float = 0.15
    rest_noise: float = 0.5
    rest_speed: float = 0.1
    street: float = 3.0
    noise: float = 1.5
    reach: float = 30.0
    small_reach: float = 2.0
    own_noise: float = 0.3
    most_places: int = 600
    freedom: float = 8.0
    usual_speed: float = 5.0
    angle_walk: float = math.radians(0.15)
    hard_iron: float = 60.0
    tilt: float = math.radians(6.0)
    soft_iron: float = 0.04
    soft_iron_upright: float = 0.01
    gyro_bias: float = math.radians(0.3)
    gyro_scale: float = 0.01
    strength: tuple[float, float] = (1.5, 2.0)
    unknown_strength: float = 0.3
    unknown_dip: float = math.radians(20.0)
    gain: float = 0.03
    typical_dip: float = math.radians(60.0)
    counts: float = 4.0
    widest_soft_iron: float = 0.25
    far_beyond: float = 2.5
    shared_soft_iron: float = 0.3
    weak: float = 0.75
    no_strain: float = 2.0
    kept_tilt: float = math.radians(0.5)
    kept_soft_iron: float = 0.01
    fewest_nodes: int = 24
    fewest_for_iron: int = 40
    steps_tried: int = 8
    moments_apart: int = 40
    fewest_since: int = 10
    least_tied: float = 0.5
    believed: float = 0.3
    pseudo: float = 18.0
    least_street: float = 0.1
    least_noise: float = 0.1
    most_repeated: float = 4.0
    usual_observations: float = 6.0
    lasting: float = 0.15
    start_rounds: int = 8
    start_field: float = 10.0
    most_rounds: int = 40
    enough: float = math.radians(0.01)
    largest_turn: float = 0.3

    def after_rest(self, sigma: float) -> SmootherTuning:
        """Return what is known of a gyro whose bias a rest has shown, by so many rad/s per axis."""
        usual = math.hypot(self.rested_bias, sigma)
        if usual >= self.usual_bias:
            return self
        return replace(self, usual_bias=usual, largest_bias=self.rested_limit * usual)


TUNING = SmootherTuning()
