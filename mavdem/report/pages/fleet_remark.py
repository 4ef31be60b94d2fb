"""How a flight differs from others of its vehicle, on its page: a remark, and the light (judgement) of its motors.

The page of a flight is written from its log alone. When the vehicle is judged from all its flights, its top is changed.
"""

import re
from typing import NamedTuple

from mavdem.facts import Level
from mavdem.facts.motors import MotorHealth
from mavdem.fleet.row import FlightRow
from mavdem.report.blocks import Blocks
from mavdem.report.fleet import HEALTH_LEVELS, TROUBLED_HEALTHS, motors_level
from mavdem.report.pages.environment import environment, render_page
from mavdem.report.templates import render_section

REMARK_PLACE = re.compile(
    r'(?<=<main>\n)(<p class="said [^<]*(?:<strong>[^<]*</strong>[^<]*)*</p>\n)?'
)
"""The beginning of a flight's page, with the remark about other flights of the vehicle if there is one already."""

MOTORS_LIGHT = re.compile(
    r'(<div data-light="motors"><dt>.*?</dt>)'
    r'<dd class="(\w+)"(?: data-alone="(\w+)")?>\w+</dd><dd class="soft">(?:<b>[^<]*</b> )?'
)
"""The light of the motors on a flight's page: heading, level shown, the log's own level if that is another one.

The last part is a note that the comparison decides, where it does.
"""


class FleetRemark(NamedTuple):
    """How a flight differs from the other flights of its vehicle, for the page of the flight."""

    level: Level
    """Watch for a drift of the motors, bad for a fault."""

    reason: str
    """The evidence, in sentences."""

    next_step: Blocks
    """What to do next; empty of a drift."""


def remark_on(row: FlightRow | None) -> FleetRemark | None:
    """Returns how a flight differs from the other flights of its vehicle.

    Args:
        row: row of the flight's axis with the worst health; None if the flight is not compared with others.

    Returns:
        The remark; None if the motors are not in trouble.
    """
    if row is None or row.health not in TROUBLED_HEALTHS:
        return None
    next_step: Blocks = []
    # A fault has one even where the motor is not known.
    if row.health == MotorHealth.FAULT or row.suspect_motor:
        motor = f"motor {row.suspect_motor}" if row.suspect_motor else ""
        next_step = [*render_section("difference_next", motor=motor, is_weaker=bool(motor))]
    return FleetRemark(HEALTH_LEVELS[MotorHealth(row.health)], row.health_reason or "", next_step)


def fleet_remark(remark: FleetRemark | None) -> str:
    """Renders a remark as HTML for the top of the flight's page; empty without one."""
    return render_page(environment().get_template("related_flights.html"), trouble=remark)


def with_fleet_remark(page: str, html: str, remark: FleetRemark | None) -> str:
    """Returns a flight's page with a remark at its top, and the light of the motors at least as bad as that remark.

    The light of the motors is their judgement, with a level. What an earlier call has written is replaced: the page
    keeps the level by the log alone in the attribute ``data-alone``.

    Args:
        page: HTML of the page, or its beginning with the lights.
        html: HTML to put at the top: the remark, and what else the caller shows there.
        remark: the remark; None if the flight does not differ from others.
    """

    def shown_light(light: re.Match[str]) -> str:
        """Returns the HTML of the light: its level by the log alone, or by the other flights if that is worse.

        Args:
            light: match of ``MOTORS_LIGHT``: heading, shown level, and the level by the log alone if it differs.
        """
        heading, shown_level, level_alone = light.groups()
        own_level = Level(level_alone or shown_level)
        level = own_level if remark is None else motors_level(own_level, remark.level)
        if level is own_level:
            return f'{heading}<dd class="{level}">{level}</dd><dd class="soft">'
        note = f"Beside other flights {level} (above), by this log alone {own_level}:"
        return (
            f'{heading}<dd class="{level}" data-alone="{own_level}">{level}</dd>'
            f'<dd class="soft"><b>{note}</b> '
        )

    page = MOTORS_LIGHT.sub(shown_light, page, count=1)
    return REMARK_PLACE.sub(lambda _: html, page, count=1)
