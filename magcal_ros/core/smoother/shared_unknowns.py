"""Which shared unknowns are common to several windows, and which belong to one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import BoolArray, IntArray
from magcal_ros.core.smoother.model import Model, Point, counted_unknowns
from magcal_ros.core.smoother.unknowns import AT, SHARED

OF_A_MOMENT = ("gyro_bias", "drift", "gradient", "place")
"""Groups of shared unknowns that each window has for itself."""
OF_A_TURN = ("gyro_matrix", "lever_arm", "height", "axis", "upright")
"""The same if axes of the gyro are silent: the turn's axis and its circle."""


@dataclass(frozen=True, eq=False)
class Layout:
    """The indices of each window's unknowns among those of all."""

    rows: list[IntArray]
    """For each window, the indices of its free shared unknowns and its centres."""
    common: IntArray
    """Which shared unknowns the first rows are."""
    count: int

    @classmethod
    def of(cls, models: Sequence[Model], points: Sequence[Point]) -> Layout:
        """Return the layout: common unknowns first, then those of each window."""
        counted = [counted_unknowns(m, p.places) for m, p in zip(models, points, strict=True)]
        owned = [is_own(model, free) for model, free in zip(models, counted, strict=True)]
        common = np.unique(
            np.concatenate([free[~own] for free, own in zip(counted, owned, strict=True)])
        )
        at, rows = len(common), []
        for free, own in zip(counted, owned, strict=True):
            row = np.searchsorted(common, np.where(own, common[0], free))
            row[own] = np.arange(at, at + int(own.sum()))
            at += int(own.sum())
            rows.append(row)
        return cls(rows, common, at)


def own_groups(model: Model) -> tuple[str, ...]:
    """Return the groups of shared unknowns that belong to one window."""
    # Dead axes leave the gyro's matrix no spread.
    has_dead_axes = model.priors.spread["gyro_matrix"] == 0.0
    is_by_field = model.nodes.tied_to is not None
    return OF_A_MOMENT + (OF_A_TURN if has_dead_axes or is_by_field else ())


def common_groups(models: Sequence[Model]) -> dict[str, int]:
    """Return the common groups, and the window in which most of each is free."""
    free = [model.priors.scale > 0.0 for model in models]
    found = {}
    for name, at in AT.items():
        number = [
            -1 if name in own_groups(model) else int(each[at].sum())
            for model, each in zip(models, free, strict=True)
        ]
        if max(number) >= 0:
            found[name] = int(np.argmax(number))
    return found


def is_own(model: Model, counted: IntArray) -> BoolArray:
    """Return which unknowns belong to one window; those of its centres do."""
    return np.isin(counted, rows_of(own_groups(model))) | (counted >= SHARED)


def rows_of(groups: Sequence[str]) -> IntArray:
    """Return the indices of the shared unknowns of some groups."""
    return np.concatenate([np.arange(AT[name].start, AT[name].stop) for name in groups])
