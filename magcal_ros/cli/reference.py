"""The reference field of the commands on recordings: by hand, or from place and date."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from datetime import date, datetime, timezone

from magcal_ros.cli.common import number
from magcal_ros.core.earth_field.reference import Local, Reference, resolve
from magcal_ros.core.earth_field.wmm import Place, decimal_year, year_of
from magcal_ros.core.errors import Misuse
from magcal_ros.core.knowledge import ReferenceField, knowledge_of
from magcal_ros.ros.parameter_table import PARAMETERS


def add_reference_options(parser: argparse.ArgumentParser) -> None:
    """Add what may be known of the Earth's field; ranges and defaults are the node's."""
    group = parser.add_argument_group(
        "reference field (numbers given win; the rest comes from the World Magnetic Model for the "
        "place, else for the first fix in a bag)"
    )

    specs = {spec.name: spec for spec in PARAMETERS}

    def add(name: str, parameter: str, words: str) -> None:
        spec = specs[f"reference.{parameter}"]
        within = number(spec.low, spec.high)
        group.add_argument(name, type=within, default=spec.default, metavar="NUMBER", help=words)

    add("--reference-strength-ut", "strength_ut", "strength of the Earth's field, µT")
    add("--reference-strength-sigma-ut", "strength_sigma_ut", "local part (1 σ), µT")
    add("--reference-inclination-deg", "inclination_deg", "inclination, positive down, °")
    add("--reference-inclination-sigma-deg", "inclination_sigma_deg", "local part, °")
    add("--reference-declination-deg", "declination_deg", "declination, positive east, °")
    add("--reference-declination-sigma-deg", "declination_sigma_deg", "local part, °")
    add("--latitude", "latitude_deg", "where it was recorded, positive north, °")
    add("--longitude", "longitude_deg", "the same, positive east, °")
    add("--altitude", "altitude_m", "the same, m")
    group.add_argument(
        "--date",
        type=_year,
        metavar="DATE",
        help="when, 2026-11-21 or 2026.9 (default: the recording's stamps, else today)",
    )


def reference_in_use(
    options: argparse.Namespace, recorded: Place | None, stamp: float
) -> Reference:
    """Return what was given, and the rest from the model.

    Parameters
    ----------
    options : argparse.Namespace
        With the options of `add_reference_options`.
    recorded : Place or None
        From the recording's own fixes; a place given by hand wins.
    stamp : float
        Newest of the recording, seconds.

    Raises
    ------
    Misuse
        If only half a place is given.
    """
    spot = (options.latitude, options.longitude)
    unset = [math.isnan(angle) for angle in spot]
    if unset[0] is not unset[1]:
        raise Misuse("give --latitude and --longitude together, or neither")
    place = recorded if any(unset) else Place(*spot, options.altitude)
    local = Local(
        options.reference_strength_sigma_ut * 1e-6,
        math.radians(options.reference_inclination_sigma_deg),
        math.radians(options.reference_declination_sigma_deg),
    )
    year = year_of([stamp], time.time()) if options.date is None else options.date
    return resolve(_given(options), local, place, year)


def _given(options: argparse.Namespace) -> ReferenceField:
    knowledge = knowledge_of(
        options.reference_strength_ut,
        options.reference_strength_sigma_ut,
        options.reference_inclination_deg,
        options.reference_inclination_sigma_deg,
        options.reference_declination_deg,
        declination_sigma_deg=options.reference_declination_sigma_deg,
    )
    return knowledge.reference


def _year(text: str) -> float:
    parsers: tuple[Callable[[str], float], ...] = (float, _year_of_day)
    for parse in parsers:
        try:
            year = parse(text)
        except ValueError:
            continue
        if 1900.0 <= year <= 2200.0:
            return year
    raise argparse.ArgumentTypeError(f"{text!r} is no date: write 2026-11-21 or 2026.9")


def _year_of_day(text: str) -> float:
    day = date.fromisoformat(text)
    noon = datetime(day.year, day.month, day.day, 12, tzinfo=timezone.utc)
    return decimal_year(noon.timestamp())
