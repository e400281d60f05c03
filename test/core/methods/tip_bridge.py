"""The printed tip's turns and answers, in the package's terms and back."""

from __future__ import annotations

import numpy as np
from printed_tip import Answer, Turn

from magcal_ros.core import Belief, Knowledge, Mounting, ReferenceField, Window
from magcal_ros.core.geometry import FRD_FROM_FLU, STANDARD_GRAVITY
from magcal_ros.core.methods import design_tip


def window_of(turn: Turn) -> Window:
    force = -STANDARD_GRAVITY * turn.gravity @ FRD_FROM_FLU
    return Window(np.arange(len(force)) * 0.05, turn.field @ FRD_FROM_FLU, force)


def knowledge_of(turn: Turn) -> Knowledge:
    reference = ReferenceField(Belief(1.0), Belief(turn.dip))
    return Knowledge(reference, Mounting(gains=turn.gains))


def ours(turn: Turn) -> Answer:
    estimate = design_tip.fit(window_of(turn), knowledge_of(turn))
    rotation = FRD_FROM_FLU @ estimate.installation.pose.T @ FRD_FROM_FLU
    iron = FRD_FROM_FLU @ estimate.correction.hard_iron
    return Answer(rotation, iron, -FRD_FROM_FLU @ estimate.axis)


def worst_difference(turn: Turn, answer: Answer) -> float:
    return max(
        np.abs(answer.rotation - turn.installation).max(),
        np.abs(answer.hard_iron - turn.hard_iron).max(),
    )
