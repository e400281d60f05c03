"""Which pictures a report holds, in their order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from magcal_ros.report.figures import heading, turn_views
from magcal_ros.report.figures.canvas import Draw, draw_svg
from magcal_ros.report.turn import Turn

NO_MATPLOTLIB = (
    "No picture: matplotlib is not installed. Install python3-matplotlib with apt, or matplotlib "
    "with pip in a virtual environment, and make the report again from samples.csv."
)


@dataclass(frozen=True)
class Picture:
    """One figure of the page."""

    name: str
    """Its id on the page."""
    title: str
    caption: str
    """Plain text."""
    svg: str = ""
    """The drawing, or empty."""
    missing: str = ""
    """Why there is no drawing."""


@dataclass(frozen=True)
class Plan:
    """How one picture is made."""

    name: str
    title: str
    draw: Draw
    caption: Callable[[Turn], str]


VIEWS = Plan("views", "The turn in space", turn_views.draw, turn_views.caption)
AROUND = Plan(
    "around", "Around the turn", turn_views.draw_residuals, turn_views.caption_of_residuals
)
HEADING = Plan("heading", "Heading before and after", heading.draw, heading.caption)
GYRO = Plan("gyro", "Gyro against compass", heading.draw_gyro, heading.caption_of_gyro)

NO_GYRO = Picture(
    GYRO.name,
    GYRO.title,
    "Only a gyro shows whether steel near by bends the field: the compass then swings around the "
    "turn although the circle looks clean.",
    missing="Not checked: there was no gyro in these samples.",
)


def pictures(turn: Turn) -> list[Picture]:
    """Draw everything that the turn can show."""
    if not len(turn.time):
        return []
    if turn.corrected is None:
        return [_picture(turn, plan) for plan in (VIEWS, AROUND)]
    found = [_picture(turn, plan) for plan in (VIEWS, AROUND, HEADING)]
    return [*found, _picture(turn, GYRO) if turn.has_gyro else NO_GYRO]


def _picture(turn: Turn, plan: Plan) -> Picture:
    words = plan.caption(turn)
    try:
        svg = draw_svg(plan.draw, turn, plan.name, plan.title)
        return Picture(plan.name, plan.title, words, svg)
    except ImportError:
        return Picture(plan.name, plan.title, words, missing=NO_MATPLOTLIB)
    except Exception as error:
        # Foreign drawing code meets foreign samples here; a report without one picture is worth
        # more than none, and the calibration behind it is already made.
        why = f"No picture: it could not be drawn ({type(error).__name__}: {error})."
        return Picture(plan.name, plan.title, words, missing=why)
