"""Small circles without rests, the sizes of all errors given: `python benchmarks/known_sizes.py
[--robots N] [--first N]`.

The simulated robots have typical sensors. An estimator usually finds the sizes of their errors with
the errors themselves; here it is given the sizes with which the simulator draws them, and that the
field is the same all along the circle. Sizes of the other noises are estimated in both cases.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from unittest import mock

import numpy as np
import shared_cases  # noqa: F401
from realistic_robots import heading_error
from side_by_side import small_circle

from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.smoother import estimate_of, smoothed
from magcal_ros.core.smoother import AT, kinds_of_motion
from magcal_ros.core.smoother.priors import Priors, priors_of

SCATTER = math.exp(0.6**2)
"""Root mean square of the factors, half to double, that the simulator draws."""
TYPICAL = {
    "axes": 0.005,
    "soft_iron": 0.005,
    "drift": 0.1,
    "motors_moving": 0.1,
    "motors_rate": 0.05,
    "latency": 0.008,
    "lever_arm": 0.08,
    "force_offset": 0.05,
    "gyro_bias": math.radians(0.2),
    "gyro_matrix": 0.008,
}
"""Sizes of the typical errors of `realistic_robots`, in the units of the smoother."""
ABSENT = {"force_moving": 1e-4, "shielding": 1e-4, "gradient": 1e-3}  # these robots have none
UNIFORM, CERTAIN = 1e-3, 0.1
"""Size of the local disturbance of a uniform field, µT, and the spread of its logarithm."""


def priors_given(knowledge: Knowledge, bias_sigma: float = math.inf) -> Priors:
    """Return the priors of a robot whose errors have the sizes of the simulator."""
    usual = priors_of(knowledge, bias_sigma)
    scale = usual.scale.copy()
    for name, size in ({k: SCATTER * v for k, v in TYPICAL.items()} | ABSENT).items():
        scale[AT[name]] = np.where(scale[AT[name]] > 0.0, size, 0.0)
    local = {
        name: usual.sizes[name]._replace(usual=UNIFORM, spread=CERTAIN)
        for name in ("street", "revisited")
    }
    sizes, fixed = {**usual.sizes, **local}, dict.fromkeys(usual.spread, 0.0)
    return replace(usual, scale=scale, spread=fixed, sizes=sizes)


@contextmanager
def with_priors(priors: Callable[..., Priors]) -> Iterator[None]:
    """Let the smoother use other priors."""
    with mock.patch.object(kinds_of_motion, "priors_of", priors):
        yield


def main() -> None:
    """Print a line for each radius and each knowledge of the sizes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=24)
    parser.add_argument("--first", type=int, default=0, help="number of the first robot")
    arguments = parser.parse_args()
    numbers = range(arguments.first, arguments.first + arguments.robots)
    print(f"{'radius':>6}  {'sizes':9} {'rms':>5} {'sigma':>6} {'NEES':>5} {'worst':>6}")
    for radius in (0.5, 1.0, 4.0):
        for name, priors in (("estimated", priors_of), ("given", priors_given)):
            errors, sigmas = [], []
            for number in numbers:
                scene, knowledge = small_circle(radius)(number)
                with with_priors(priors):
                    found = smoothed(scene.window, knowledge)
                estimate = estimate_of(found, scene.window, knowledge)
                errors.append(math.degrees(heading_error(scene, estimate.correction)))
                sigmas.append(math.degrees(found.posterior.heading_sigma))
            error, sigma = np.array(errors), np.array(sigmas)
            square = (error / sigma) ** 2
            print(
                f"{radius:5.1f}m  {name:9} {math.sqrt(np.mean(error**2)):5.2f} "
                f"{math.sqrt(np.mean(sigma**2)):6.2f} {square.mean():5.2f} "
                f"{math.sqrt(square.max()):5.1f}σ",
                flush=True,
            )


if __name__ == "__main__":
    main()
