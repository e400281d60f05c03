"""Windows without a gyro or with silent axes: a turn rate from the field, and wider priors.

An axis that never changes measures nothing. The field shows the turn rate about the turn's axis,
which is used only to average samples to nodes. The attitudes of neighbouring nodes are linked
because the robot turns about a fixed axis and sways, so that up changes slowly in body axes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, interpolated
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.rotations import minimal_rotation
from magcal_ros.core.geometry.shapes import fit_circle_robustly
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.core.samples.spikes import without_spikes
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoother.factors import Z
from magcal_ros.core.smoother.nodes import Nodes, Spacing, nodes_of
from magcal_ros.core.smoother.priors import Priors
from magcal_ros.core.smoother.start import StartGuess, starts
from magcal_ros.core.smoother.state import State, level_axes
from magcal_ros.core.smoother.unknowns import (
    AT,
    EARTH,
    LOCAL,
    MICROTESLA,
    RATE,
    ROLL_PITCH,
    SHIELDING,
    UNKNOWNS,
    Size,
)

SMOOTHED = 0.5
"""Seconds (one sigma) over which the angle of the field is averaged for the turn rate."""
NODE, SWAY_SMOOTHED = 0.3, 0.1
"""Seconds of a node at most, and those (one sigma) over which the force is averaged for the rate of
the sway: a robot that sways may tilt by `Spacing.most_turn` (RMS) during a node."""
CIRCLE = 0.6  # sigma of the accelerometer's distance from the centre of a small circle, metres
MOUNTED = 0.1  # sigma of a robot's up off the z axis of its IMU, radians: most are mounted level
LEAN = Size(0.02, 0.7, 6.0, "rad", "tilt of the body off its axis on the way", "roads: .01 to .05")
SWAY: Mapping[str, Size] = {
    "lean": Size(0.01, 1.5, 6.0, "rad", "tilt of the body off its axis", "robots: 0 to .05", 0.03),
    "gyro_up": Size(0.01, 1.5, 4.0, "rad/√s", "yaw beyond a changing rate", "jerks", 0.05),
    "rate_change": Size(0.05, 1.5, 4.0, "rad/s/√s", "change of the turn rate", "0 to .3", 0.2),
    "speed_change": Size(
        0.003, 1.2, 4.0, "m/s", "velocity that neither turn nor sway explains", "on the spot: none"
    ),
}


def nodes_by_field(window: Window, to_body: FloatArray) -> Nodes:
    """Return the nodes of a window without a gyro, with the turn rate from the field."""
    window = window.take(without_spikes(window.field) & without_spikes(window.specific_force))
    field = window.field @ to_body.T * MICROTESLA
    circle = fit_circle_robustly(field)
    usual = unit(np.median(window.specific_force, axis=0))
    axis = circle.normal * math.copysign(1.0, float(circle.normal @ usual))
    turn = np.unwrap(circle.phase(field)) * math.copysign(1.0, float(circle.normal @ usual))
    rate = np.gradient(-_smooth(window.time, turn[:, None], SMOOTHED), window.time, axis=0) * axis
    made = replace(window, angular_rate=rate, missed=None)
    nodes = nodes_of(made, to_body, Spacing(longest=_longest(window)))
    return replace(nodes, tied_to=minimal_rotation(Z, axis))


def _longest(window: Window) -> float:
    """Return the duration of a node in which a robot sways by at most `Spacing.most_turn`, RMS."""
    up = unit(_smooth(window.time, window.specific_force, SWAY_SMOOTHED))
    rate = np.linalg.norm(np.gradient(up, window.time, axis=0), axis=1)
    return min(NODE, Spacing().most_turn / max(math.sqrt(float(np.mean(rate**2))), 1e-9))


def _smooth(time: FloatArray, values: FloatArray, seconds: float) -> FloatArray:
    """Return values averaged over some seconds to both sides, about a straight line."""
    step = max(float(np.median(np.diff(time))), (time[-1] - time[0]) / 2000.0)
    grid = np.arange(time[0], time[-1] + step, step)
    rows = interpolated(grid, time, values)
    reach = max(1, min(round(3.0 * seconds / step), (len(grid) - 1) // 2))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step / seconds) ** 2)
    padded = np.pad(rows, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    smooth = np.stack(
        [np.convolve(axis, kernel / kernel.sum(), mode="valid") for axis in padded.T], axis=1
    )
    return interpolated(time, grid, smooth)


def with_dead_axes(priors: Priors, living: tuple[bool, bool, bool]) -> Priors:
    """Return the priors of a window in which axes of the gyro are silent.

    The robot turns about an axis that is fixed in the body, and tilts off it. Without a limit of
    the tilt, the centripetal acceleration of a circle would count as tilt.
    """
    if all(living):
        return priors
    scale, dead = priors.scale.copy(), ~np.array(living)
    scale[AT["gyro_bias"]][dead] = 0.0
    scale[AT["gyro_matrix"]].reshape(3, 3)[dead] = 0.0
    if dead[2]:
        scale[AT["bias_walk"]] = 0.0
    scale[AT["axis"]], scale[AT["upright"]] = MOUNTED, UNKNOWNS["upright"].sigma
    return replace(priors, scale=scale, sizes={**priors.sizes, "lean": LEAN})


def without_rates(priors: Priors, *, rests: bool) -> Priors:
    """Return the priors of a window without a gyro; `rests` is whether it contains a rest."""
    scale = priors.scale.copy()
    for name in ("gyro_bias", "bias_walk", "gyro_matrix", "gradient"):
        scale[AT[name]] = 0.0
    for name in ("axis", "upright", "sway_arm"):
        scale[AT[name]] = UNKNOWNS[name].sigma
    scale[AT["latency"]] = 0.0
    if not priors.fields.is_known:
        scale[AT["shielding"]] = 0.0
    # Without a rest, the size of the accelerometer's shift in motion is not observable.
    spread = priors.spread if rests else {**priors.spread, "force_moving": 0.0}
    return replace(priors, scale=scale, spread=spread, sizes={**priors.sizes, **SWAY})


def in_a_gradient(priors: Priors) -> Priors:
    """Return the priors of a magnetometer that moves through a field gradient."""
    scale = priors.scale.copy()
    scale[AT["gradient"]] = UNKNOWNS["gradient"].sigma
    return replace(priors, scale=scale)


def in_a_circle(priors: Priors) -> Priors:
    """Return the priors of a robot that may drive a small circle, with a distant pivot."""
    scale = priors.scale.copy()
    scale[AT["lever_arm"]][:2] *= CIRCLE / UNKNOWNS["lever_arm"].sigma[0]
    return replace(priors, scale=scale, spread={**priors.spread, "lever_arm": 0.0})


def guesses(
    nodes: Nodes, priors: Priors, reference: ReferenceField
) -> list[tuple[Nodes, State, Priors]]:
    """Return the starts: every geometric solution for axis, circle and dip."""
    up = unit(_smooth(nodes.time, nodes.mean_force, SMOOTHED))
    found = []
    assert nodes.tied_to is not None
    for guess in starts(nodes.field, up, reference):
        # The installation tilts the axis that the field shows.
        turning = nodes.in_axes(minimal_rotation(nodes.tied_to[:, 2], guess.axis))
        found.append((turning, *_as_state(guess, turning, priors)))
    return found


def state_distance(one: State, other: State) -> float:
    """Return the larger difference: of installation (radians), or of hard iron over the field."""
    off = np.abs(one.shared - other.shared)
    field = float(np.linalg.norm(one.shared[EARTH]))
    return float(max(off[ROLL_PITCH].max(), off[AT["iron"]].max() / field))


def _as_state(guess: StartGuess, nodes: Nodes, priors: Priors) -> tuple[State, Priors]:
    shared = priors.mean.copy()
    shared[AT["iron"]] = guess.iron
    shared[ROLL_PITCH] = guess.roll, guess.pitch
    level, down = guess.strength * np.array(
        [math.cos(guess.inclination), math.sin(guess.inclination)]
    )
    shared[EARTH] = level, down
    if priors.scale[SHIELDING] > 0.0:
        shared[SHIELDING] = _gain(nodes.field, guess.attitude, shared[EARTH]) - 1.0
    local = np.zeros((len(nodes), LOCAL))
    assert nodes.tied_to is not None
    local[:, RATE] = nodes.rate @ nodes.tied_to[:, 2:]
    about = priors.about(guess.iron, level_axes(np.median(guess.attitude[:, :, 2], axis=0)))
    return State(guess.attitude, local, shared), about


def _gain(field: FloatArray, attitude: FloatArray, earth: FloatArray) -> float:
    """Return the ratio of the varying part of a field (n, 3) to that expected by the attitudes.

    `earth` is the level and the downward field. A steel body may weaken the field to a fifth.
    """
    level, down = earth
    expected = attitude @ np.array([0.0, level, -down])
    turns, seen = expected - expected.mean(axis=0), field - field.mean(axis=0)
    return max(float(np.sum(turns * seen) / np.sum(turns**2)), 0.2)
