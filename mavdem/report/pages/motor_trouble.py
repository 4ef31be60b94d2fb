"""Trouble with motors that only comparison with other flights shows, written into the page and its status light.

The page of a flight is written from its log alone. Later the vehicle is judged from all its flights, which shows
smaller losses of a motor. Then the beginning of the page is changed: the trouble becomes its headline and next step,
unless the log alone shows worse, and the light of the motors (their judgement by a level) becomes at least as bad as
the trouble.
"""

import re
from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

from mavdem.containers import JsonValues
from mavdem.facts import Level
from mavdem.facts.lights import Light
from mavdem.facts.motors import MotorHealth
from mavdem.fleet.report_columns import value_at
from mavdem.fleet.row import FlightRow
from mavdem.report.blocks import Sentence
from mavdem.report.fleet import HEALTH_LEVELS, TROUBLED_HEALTHS, motors_level
from mavdem.report.pages.environment import environment, render_page
from mavdem.report.pages.page_link import PageLink
from mavdem.report.templates import render_section

RESULT = re.compile(
    r'(?P<trouble><section id="beside".*?</section>\n)?'
    r'<section id="result" class="(?P<classes>[^"]*)">\n(?P<content>.*?)</section>\n'
    r'(?P<trouble_below><section id="beside".*?</section>\n)?',
    re.DOTALL,
)
"""The result of the log on a flight's page, and the section about trouble with the motors if there is one already."""

HEADLINE = re.compile(r'<p class="headline"><strong>(.*?)</strong></p>')
"""The headline of a log's result."""

HEADLINE_ALONE = re.compile("<p><strong>This log alone:</strong> (.*?)</p>")
"""The headline of a log's result, where the trouble has become that of the page."""

NEXT_STEP = "<p><strong>Next:</strong>"
"""The beginning of a log's next step."""

NEXT_STEP_ALONE = "<p><strong>Then, by this log alone:</strong>"
"""The beginning of a log's next step, where the trouble has one that comes first."""

SECTION_CLASSES = {Level.BAD: "doubted", Level.WATCH: "lacking"}
"""The class of a section with a result, by the level of the result."""

MOTORS_LIGHT = re.compile(
    r'(<div data-light="motors"><dt>.*?</dt>)'
    r'<dd class="(\w+)"(?: data-alone="(\w+)")?>\w+</dd><dd class="soft">(?:<b>[^<]*</b> )?'
)
"""The light of the motors on a flight's page: its heading, the shown level, and the level by the log alone.

The third group is empty if both levels are the same. The last part is a note that the levels differ, if they do.
"""


class MotorTrouble(NamedTuple):
    """A fault or a drift of the motors that shows in comparison with the other flights of the vehicle."""

    level: Level
    """Watch for a drift of the motors, bad for a fault."""

    reason: str
    """The evidence, in sentences."""

    next_step: list[Sentence]
    """What to do next; empty of a drift without a suspected motor."""

    motor: str
    """Name of the suspected motor, such as "motor 1"; empty where none is."""

    comparison: PageLink | None = None
    """The page that compares the flight with a sound one; None where there is no such page."""


def motor_trouble(row: FlightRow | None) -> MotorTrouble | None:
    """Returns the trouble with the motors that comparison of a flight with others of its vehicle has shown, if any.

    Args:
        row: row in the fleet's table of the flight's axis with the worst health; None if the flight is not compared.

    Returns:
        The trouble; None if the motors have neither a fault nor a drift.
    """
    if row is None or row.health not in TROUBLED_HEALTHS:
        return None
    next_step: list[Sentence] = []
    motor = f"motor {row.suspect_motor}" if row.suspect_motor else ""
    # A fault has a next step even where the motor is not known; a drift has one only for a suspected motor.
    if row.health == MotorHealth.FAULT or motor:
        next_step = [*render_section("difference_next", motor=motor, is_weaker=bool(motor))]
    return MotorTrouble(
        HEALTH_LEVELS[MotorHealth(row.health)], row.health_reason or "", next_step, motor
    )


def review_with_trouble(
    review: Mapping[str, Any], trouble: MotorTrouble | None
) -> Mapping[str, Any]:
    """Returns the review of a flight with its motors judged by the other flights of the vehicle, too.

    A comparison of two flights then shows the same judgement of each as lists and the flight's own page. The trouble
    with the motors replaces their status light, and the headline and the next step unless the headline is bad already.

    Args:
        review: review document of the flight, by its log alone; it is not modified.
        trouble: trouble with the motors that comparison with other flights shows; None if there is none.

    Returns:
        A changed copy; the review itself without trouble, or if its motors are as bad by the log alone.
    """
    if trouble is None:
        return review
    lights = review.get("lights") or {}
    level_of_log = Level(value_at(lights, f"{Light.MOTORS}.level") or Level.UNKNOWN)
    if motors_level(level_of_log, trouble.level) is level_of_log:
        return review
    changed_parts: JsonValues = {}
    judgement: JsonValues = {"level": trouble.level, "sentence": trouble.reason}
    if Light.MOTORS in lights:
        motors_light = judgement | {"subject": trouble.motor}
        changed_parts["lights"] = lights | {Light.MOTORS: motors_light}
    if value_at(review, "headline.level") != Level.BAD:
        changed_parts["headline"] = judgement
        for step in trouble.next_step:
            changed_parts["next_step"] = {"sentence": step.text}
    return {**review, **changed_parts}


def with_motor_trouble(page: str, trouble: MotorTrouble | None) -> str:
    """Returns a flight's page with trouble as its headline, and the light of the motors at least as bad as that.

    The function may be called again with its result: what the earlier call has written is replaced.

    Args:
        page: HTML of the page, or its beginning with the lights.
        trouble: the trouble with the motors; None if there is none, which makes the page that of the log alone again.
    """
    page = MOTORS_LIGHT.sub(partial(_light_html, trouble=trouble), page, count=1)
    return RESULT.sub(partial(_result_html, trouble=trouble), page, count=1)


def _result_html(result: re.Match[str], trouble: MotorTrouble | None) -> str:
    """Returns the HTML of a log's result with the section about trouble above it, or below it if the log shows worse.

    A next step by the log alone may be to fly again. Below that of the trouble it is therefore marked as the later one.

    Args:
        result: match of ``RESULT``.
        trouble: trouble that the comparison with other flights shows; None without any.
    """
    content = HEADLINE_ALONE.sub(r'<p class="headline"><strong>\1</strong></p>', result["content"])
    content = content.replace(NEXT_STEP_ALONE, NEXT_STEP, 1)
    opening = f'<section id="result" class="{result["classes"]}">\n'
    if trouble is None:
        return f"{opening}{content}</section>\n"
    is_log_bad = SECTION_CLASSES[Level.BAD] in result["classes"].split()
    is_below = is_log_bad and trouble.level is not Level.BAD
    section_html = render_page(
        environment().get_template("related_flights.html"),
        trouble=trouble,
        level_class=SECTION_CLASSES[trouble.level],
        is_below=is_below,
    )
    if is_below:
        return f"{opening}{content}</section>\n{section_html}\n"
    content = HEADLINE.sub(r"<p><strong>This log alone:</strong> \1</p>", content, count=1)
    if trouble.next_step:
        content = content.replace(NEXT_STEP, NEXT_STEP_ALONE, 1)
    return f"{section_html}\n{opening}{content}</section>\n"


def _light_html(light: re.Match[str], trouble: MotorTrouble | None) -> str:
    """Returns the HTML of the motors' light: its level by the log alone, or by the trouble if that is worse.

    In the second case the attribute ``data-alone`` keeps the level by the log alone, so that the change can be undone.

    Args:
        light: match of ``MOTORS_LIGHT``: the heading, the shown level, and the level by the log alone or None.
        trouble: trouble that the comparison with other flights shows; None without any.
    """
    heading, shown_level, level_alone = light.groups()
    level_of_log = Level(level_alone or shown_level)
    level = level_of_log if trouble is None else motors_level(level_of_log, trouble.level)
    if level is level_of_log:
        return f'{heading}<dd class="{level}">{level}</dd><dd class="soft">'
    note = f"Beside other flights {level} (above), by this log alone {level_of_log}:"
    return (
        f'{heading}<dd class="{level}" data-alone="{level_of_log}">{level}</dd>'
        f'<dd class="soft"><b>{note}</b> '
    )
