"""The errors of the methods and the limit: `python benchmarks/accuracy.py [--runs N] [--quick]`.

Each row is one condition; heading errors in degrees are RMS over runs, 24 headings and level or
nine tilts. NEES/dof is the squared error over its predicted variance and should be one.
"""

from __future__ import annotations

import argparse
import math
import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import shared_cases  # noqa: F401
from limit import Scene, covariance_limit, heading_rms
from simulated.turns import Trouble, measure, smooth_wobble, turn

from magcal_ros.core.calibration.calibration import Estimate, yaw_jacobian
from magcal_ros.core.errors import MagcalError
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.smoother import fit
from magcal_ros.core.samples.window import Window
from magcal_ros.core.simulation import (
    DEGREE,
    LEVEL_TILT,
    UP_ENU,
    Robot,
    heading_errors,
    trial_attitudes,
)

UPRIGHT = (0.0, 0.0, 1.0)
TILTED = (0.0, 0.9, 0.9)
DURATION = 15.0


@dataclass(frozen=True)
class Condition:
    """One row of the table."""

    name: str
    arc: float = 360.0
    samples: int = 500
    noise: float = 1.0
    ramp: float = 0.0
    axis: tuple[float, float, float] = UPRIGHT
    wobble: float = 0.0
    trouble: Trouble = field(default_factory=Trouble)
    soft_iron: float = 0.0
    strength_sigma: float = 0.0
    dip_sigma: float = 0.0
    gyro: bool = False


def conditions() -> list[Condition]:
    """Return every row."""
    strength = Robot().strength
    rows = [Condition(f"level, arc {arc}", arc=arc) for arc in (360, 180, 90, 45)]
    rows += [
        Condition(f"level, arc {a}, N={n}", arc=a, samples=n) for a in (360, 90) for n in (50, 3000)
    ]
    rows += [Condition(f"level, arc {a}, noise x3", arc=a, noise=3.0) for a in (360, 180, 90)]
    rows += [Condition(f"ramp 10, arc {a}", arc=a, ramp=10.0) for a in (360, 180, 90, 45)]
    rows += [Condition(f"tilted axis 45, arc {a}", arc=a, axis=TILTED) for a in (360, 180, 90, 45)]
    rows += [Condition("tilted axis 45, arc 180, N=50", arc=180, axis=TILTED, samples=50)]
    rows += [Condition("tilted axis 45, arc 360, noise x3", axis=TILTED, noise=3.0)]
    for share in (0.02, 0.1, 0.25):
        trouble = Trouble(outliers=share, outlier_size=0.3 * strength)
        rows.append(Condition(f"outliers {share:.0%}, arc 360", trouble=trouble))
        rows.append(
            Condition(
                f"outliers {share:.0%}, tilted, arc 180", arc=180, axis=TILTED, trouble=trouble
            )
        )
    for size in (0.03, 0.1, 0.3):
        trouble = Trouble(disturbance=size * strength)
        rows.append(Condition(f"disturbance {size} B", trouble=trouble))
        rows.append(Condition(f"disturbance {size} B, wobble 5", trouble=trouble, wobble=5.0))
    for wobble in (2.0, 5.0, 10.0):
        rows += [
            Condition(f"wobble {wobble:.0f}, arc {a}", wobble=wobble, arc=a) for a in (360, 180)
        ]
        rows.append(Condition(f"wobble {wobble:.0f}, arc 360, gyro", wobble=wobble, gyro=True))
    rows += [
        Condition(f"soft iron 5%, arc {a}{', gyro' if g else ''}", arc=a, soft_iron=0.05, gyro=g)
        for a in (360, 180)
        for g in (False, True)
    ]
    rows += [
        Condition(
            f"B 3%, dip 2, arc {a}{', gyro' if g else ''}",
            arc=a,
            gyro=g,
            strength_sigma=0.03,
            dip_sigma=2.0,
        )
        for a in (360, 180, 90)
        for g in (False, True)
    ]
    rows.append(Condition("B, dip unknown, arc 360", strength_sigma=math.inf, dip_sigma=math.inf))
    return rows


@dataclass
class Tally:
    """The results of the runs of one row."""

    limit: list[tuple[float, float]]
    likelihood: list[tuple[float, float]]
    tip: list[tuple[float, float]]
    nees: list[float]
    heading_nees: list[float]
    refused: int = 0
    missed: int = 0
    seconds: float = 0.0


def run(condition: Condition, runs: int, seed: int, tip: Callable[..., Estimate] | None) -> Tally:
    """Simulate and fit one row."""
    tally = Tally([], [], [], [], [])
    for number in range(runs):
        rng = np.random.default_rng([seed, number])
        scene, window = draw(condition, rng)
        knowledge = draw_knowledge(condition, scene.robot, rng)
        limit = covariance_limit(
            [scene], knowledge, soft_iron=condition.soft_iron > 0.0, gyro=condition.gyro
        )
        began = time.perf_counter()
        try:
            estimate = fit(window, knowledge)
        except MagcalError:
            tally.refused += 1
            continue
        finally:
            tally.seconds += time.perf_counter() - began
        tally.limit.append(heading_rms(limit, scene.robot))
        tally.likelihood.append(_score(estimate, scene.robot))
        _judge(tally, estimate, scene.robot)
        if tip is not None:
            try:
                tally.tip.append(_score(tip(window, knowledge), scene.robot))
            except MagcalError:
                tally.tip.append((math.nan, math.nan))
    return tally


def draw(condition: Condition, rng: np.random.Generator) -> tuple[Scene, Window]:
    """Draw one turn: random start heading, noise and whatever the condition asks for."""
    known = Robot()
    iron = np.zeros((3, 3))
    if condition.soft_iron > 0.0:
        half = rng.standard_normal((3, 3))
        iron = half + half.T
        iron *= condition.soft_iron / np.abs(np.linalg.eigvalsh(iron)).max()
    robot = replace(
        known,
        noise_field=condition.noise * known.noise_field,
        noise_force=condition.noise * known.noise_force,
        soft_iron=iron,
    )
    start = (condition.ramp * DEGREE, 0.0, rng.uniform(-math.pi, math.pi))
    axis = np.array(condition.axis) / np.linalg.norm(condition.axis)
    wobble = None
    if condition.wobble > 0.0:
        rms = condition.wobble * DEGREE
        wobble = smooth_wobble(rng, condition.samples, DURATION, rms, axis=axis)
    motion = turn(
        arc=condition.arc * DEGREE,
        samples=condition.samples,
        duration=DURATION,
        axis=axis,
        start_rpy=start,
        wobble=wobble,
    )
    scene = Scene(robot, motion, axis, start, condition.wobble * DEGREE)
    return scene, measure(robot, motion, rng, gyro=condition.gyro, trouble=condition.trouble)


def draw_knowledge(condition: Condition, robot: Robot, rng: np.random.Generator) -> Knowledge:
    """Return the knowledge of the reference field, with an error of its sigma."""
    strength_sigma = condition.strength_sigma * robot.strength
    dip_sigma = condition.dip_sigma * DEGREE
    wrong = [
        s * rng.standard_normal() if math.isfinite(s) else 0.0 for s in (strength_sigma, dip_sigma)
    ]
    reported = replace(
        robot, strength=robot.strength + wrong[0], inclination=robot.inclination + wrong[1]
    )
    return reported.knowledge(strength_sigma, dip_sigma)


def _score(estimate: Estimate, robot: Robot) -> tuple[float, float]:
    errors = np.degrees(heading_errors(estimate.correction, robot))
    level = errors[:, LEVEL_TILT]
    return math.sqrt(np.mean(level**2)), math.sqrt(np.mean(errors**2))


def _judge(tally: Tally, estimate: Estimate, robot: Robot) -> None:
    scale = np.concatenate([np.ones(9), np.full(3, 1.0 / robot.strength)])
    error = scale * (estimate.correction.parameters - robot.true_correction.parameters)
    values, vectors = np.linalg.eigh(estimate.covariance * np.outer(scale, scale))
    # A rotation has three degrees of freedom; along others its matrix varies in the second order.
    shown = values > values[-1] ** 2
    along = vectors[:, shown].T @ error
    tally.nees.append(float(np.mean(along**2 / values[shown])))
    poses = trial_attitudes()
    errors = heading_errors(estimate.correction, robot)
    jacobian = yaw_jacobian(estimate.correction, poses @ UP_ENU, poses @ robot.field_enu)
    variance = np.einsum("...i,ij,...j->...", jacobian, estimate.covariance, jacobian)
    ratio = errors**2 / variance
    tally.heading_nees.append(float(ratio.mean()))
    tally.missed += bool(ratio[:, LEVEL_TILT].max() > 25.0)


def rms(pairs: list[tuple[float, float]]) -> tuple[float, float]:
    """Return the root mean square of both columns."""
    level, everywhere = np.sqrt(np.nanmean(np.square(np.array(pairs)), axis=0))
    return float(level), float(everywhere)


def line(condition: Condition, tally: Tally, runs: int) -> str:
    """Write one row."""
    if not tally.likelihood:
        return f"{condition.name:38s} refused {tally.refused}"
    limit, found = rms(tally.limit), rms(tally.likelihood)
    worst = max(level for level, _ in tally.likelihood)
    tip = "     - /-     " if not tally.tip else "{:6.2f} /{:<6.2f}".format(*rms(tally.tip))
    return (
        f"{condition.name:38s} {tip} {found[0]:6.3f} /{found[1]:<6.3f}"
        f" {limit[0]:6.3f} /{limit[1]:<6.3f}"
        f" {found[0] / limit[0]:5.2f} /{found[1] / limit[1]:<5.2f} {worst:6.2f}"
        f" {np.mean(tally.nees):5.2f} {np.mean(tally.heading_nees):5.2f}"
        f" {tally.refused:4d} {tally.missed:4d} {1e3 * tally.seconds / runs:6.0f}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200, help="runs per row")
    parser.add_argument("--quick", action="store_true", help="20 runs per row")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="rows whose name matches this pattern")
    parser.add_argument("--no-tip", action="store_true", help="leave out the design tip")
    arguments = parser.parse_args()
    runs = 20 if arguments.quick else arguments.runs
    tip = None if arguments.no_tip else _design_tip()
    print(
        f"{'':38s} {'design tip':>13s} {'likelihood':>13s} {'limit':>13s} {'ratio':>11s}"
        f" {'worst':>6s} {'NEES':>5s} {'head.':>5s} {'ref.':>4s} {'>5s':>4s} {'ms':>6s}"
    )
    for condition in conditions():
        if re.search(arguments.only, condition.name):
            print(line(condition, run(condition, runs, arguments.seed, tip), runs), flush=True)


def _design_tip() -> Callable[..., Estimate] | None:
    try:
        from magcal_ros.core.methods import design_tip
    except ImportError:
        return None
    return design_tip.fit


if __name__ == "__main__":
    main()
