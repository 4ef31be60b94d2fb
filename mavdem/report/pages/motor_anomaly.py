"""Anomalies of motors that only comparison with other flights shows, written into the page and its status light.

The page of a flight is written from its log alone. Later the vehicle is judged from all its flights, which shows
smaller losses of a motor. Then the beginning of the page is changed: the anomaly becomes its headline and next step,
unless the log alone shows something bad, and the light of the motors (their judgement by a level) becomes at least as
bad as the anomaly.
"""

import json
import re
from collections.abc import Mapping
from functools import partial
from pathlib import PurePath
from typing import Any, NamedTuple

from mavdem.containers import JsonValues
from mavdem.facts import Level
from mavdem.facts.fact import UNITS
from mavdem.facts.lights import Light
from mavdem.facts.motors import MotorHealth
from mavdem.fleet.flights import Flights, group_into_flights, log_row, worst_health, worst_row
from mavdem.fleet.report_columns import value_at
from mavdem.fleet.row import FlightRow, FlightRows
from mavdem.report.blocks import Sentence
from mavdem.report.fleet import (
    ANOMALOUS_HEALTHS,
    BY_LOG_ALONE,
    HEALTH_LEVELS,
    is_headline_replaced,
    level_beside_other_flights,
    light_level,
    motor_next_step,
    suspected_motor,
)
from mavdem.report.heading import Heading, listed_headline
from mavdem.report.pages.environment import environment, render_page
from mavdem.report.pages.page_link import PageLink
from mavdem.report.templates import first_and_further_sentences

RESULT_HTML = re.compile(
    r'(?P<anomaly><section id="beside".*?</section>\n)?'
    r'<section id="result" class="(?P<classes>[^"]*)">\n(?P<content>.*?)</section>\n'
    r'(?P<anomaly_below><section id="beside".*?</section>\n)?',
    re.DOTALL,
)
"""The result of the log on a flight's page, and the section about an anomaly of the motors if there is one."""

HEADLINE = re.compile(r'<p class="headline"><strong>(.*?)</strong></p>')
"""The headline of a log's result."""

HEADLINE_ALONE = re.compile("<p><strong>This log alone:</strong> (.*?)</p>")
"""The headline of a log's result, where the anomaly has become that of the page."""

NEXT_STEP = "<p><strong>Next:</strong>"
"""The beginning of a log's next step."""

NEXT_STEP_ALONE = "<p><strong>Then, by this log alone:</strong>"
"""The beginning of a log's next step, where the anomaly has one that comes first."""

NEXT_STEP_REPEATED = "<p hidden><strong>Next:</strong>"
"""The beginning of a log's next step that the anomaly has too, so that it is not shown again."""

SECTION_CLASSES = {Level.BAD: "doubted", Level.WATCH: "lacking"}
"""The class of a section with a result, by the level of the result."""

MOTORS_LIGHT_HTML = re.compile(
    r'(?P<heading><div data-light="motors"[^>]*><dt>.*?</dt>)'
    r'<dd class="(?P<level>\w+)"(?: data-alone="(?P<level_of_log>\w+)")?>\w+</dd>'
    r'(?:<dd class="brief"(?: hidden)?>(?P<figure>[^<]*)</dd>)?'
    r'<dd class="soft">(?:<b>[^<]*</b> )?(?P<sentence>.*?)</dd>',
    re.DOTALL,
)
"""The light of the motors on a flight's page: its heading, level and figure, and the sentence that explains the level.

The figure, which not every light has, stands in the place of the sentence on a phone. It is by this log alone, and
hidden where an anomaly has changed the level.

``level_of_log`` is the level by this log alone. The page states it, as ``data-alone`` and in a note before the
sentence, only if an anomaly has changed the level. The template ``motors_light.html`` writes this part of a page.
"""


class MotorAnomaly(NamedTuple):
    """A fault or a drift of the motors that shows in comparison with the other flights of the vehicle."""

    level: Level
    """Watch for a drift of the motors, bad for a fault."""

    reason: str
    """The evidence, in sentences."""

    next_step: list[Sentence]
    """What to do next."""

    code: str
    """Code of the evidence, a value of ``MotorsBetween``; empty where it is not known."""

    motor: str
    """Name of the suspected motor, such as "motor 1"; empty where none is."""

    figures: Mapping[str, Any]
    """Figures of the evidence by name, such as the loss of thrust; empty where they are not known."""

    comparison: PageLink | None = None
    """The page that compares the flight with a sound one; None where there is no such page."""

    @property
    def heading(self) -> Heading:
        """The first sentence of the evidence in few words, and what that leaves out."""
        first, further = first_and_further_sentences(self.reason)
        finding = listed_headline(first)
        return Heading(finding, details=further if finding == first else self.reason)


def motor_anomaly(row: FlightRow | None) -> MotorAnomaly | None:
    """Returns the fault or drift of the motors that shows when a flight is compared with others of its vehicle.

    Args:
        row: row of the flight in the fleet's table, for the axis whose motors are in the worst health; None if the
            flight is not compared.

    Returns:
        The anomaly with its evidence and next step; None if the motors have neither a fault nor a drift.
    """
    if row is None or row.health not in ANOMALOUS_HEALTHS:
        return None
    return MotorAnomaly(
        HEALTH_LEVELS[MotorHealth(row.health)],
        row.health_reason or "",
        next_step=motor_next_step(row),
        code=row.health_code or "",
        motor=suspected_motor(row),
        figures=_motor_figures(row),
    )


def _motor_figures(row: FlightRow) -> Mapping[str, Any]:
    """Reads the figures behind the judgement of a flight's motors, such as the lost thrust, by name.

    Args:
        row: row of the flight in the fleet's table.

    Returns:
        The figures; empty if the row has none, as rows of old versions, or if their JSON text is damaged.
    """
    try:
        figures = json.loads(row.health_figures or "{}")
    except (ValueError, RecursionError):
        return {}
    return figures if isinstance(figures, dict) else {}


def review_with_compared_motors(review: Mapping[str, Any], rows: FlightRows) -> Mapping[str, Any]:
    """Adds to the review of a flight what a comparison with other flights of the vehicle shows of its motors.

    Args:
        review: review document of the flight, by its log alone; empty for a fleet, which has no review as a whole.
        rows: rows of the fleet's table, with the health of the motors by that comparison; the latest flight counts.

    Returns:
        A changed copy, with the health of the motors as ``motor_health``; the review itself if the motors were not
        compared. Of a fleet, what its rows say of its flights.
    """
    flights = group_into_flights(row for row in rows if row.is_read)
    if not flights:
        return review
    row = worst_row(flights[-1])
    is_fleet = not review
    if is_fleet:
        review = _fleet_document(flights)
    if row.health_reason is None:
        return review
    if is_fleet:
        judged_review: Mapping[str, Any] = {**review, **_fleet_judgement(flights)}
    else:
        judged_review = review_with_anomaly(review, motor_anomaly(row))
    return {**judged_review, "motor_health": _motor_health_document(row)}


def _fleet_document(flights: Flights) -> Mapping[str, Any]:
    """Returns a document that stands in for the review of a fleet, which has reviews only of its single flights.

    Args:
        flights: flights of the fleet in order of date, at least one.

    Returns:
        A part of a review document: ``identity`` with the frame and the dates of the first and the latest flight
        (``first_date`` and ``date``), the level of each status light in each flight (``light_levels``), and whether the
        latest flight was simulated.
    """
    first_row, last_row = log_row(flights[0]), log_row(flights[-1])
    identity: JsonValues = {"frame": last_row.frame}
    if first_row.date is not None and last_row.date is not None:
        identity["first_date"] = first_row.date.isoformat()
        identity["date"] = last_row.date.isoformat()
    light_levels = {light: [light_level(flight, light) for flight in flights] for light in Light}
    document: JsonValues = {"identity": identity, "light_levels": light_levels}
    if last_row.simulated is not None:
        document["simulated"] = bool(last_row.simulated)
    return document


def _fleet_judgement(flights: Flights) -> Mapping[str, Any]:
    """Returns the judgement of a fleet's motors as part of its document, with the keys of a flight's review.

    Motors are all that is judged of a fleet as a whole. Their status light is that of the latest flight, with their
    level in each flight (``levels``), and which flights these are (``flights``). If the motors have an anomaly, that is
    also the headline, with the next step. There is neither if the latest flight has a bad headline by its own log, such
    as a crash, which is more urgent.

    Args:
        flights: flights of the fleet in order of date, at least one, with the health of their motors.
    """
    latest_row = worst_row(flights[-1])
    motors_light = {
        "code": latest_row.health_code,
        "level": HEALTH_LEVELS[MotorHealth(latest_row.health)],
        "sentence": latest_row.health_reason,
        "subject": suspected_motor(latest_row),
        "figures": _motor_figures(latest_row),
        "levels": [HEALTH_LEVELS[MotorHealth(worst_health(flight))] for flight in flights],
        "flights": [_flight_document(worst_row(flight)) for flight in flights],
    }
    lights = {Light.MOTORS: motors_light}
    if latest_row.headline_level == Level.BAD:
        return {"lights": lights}
    headline_and_next_step = review_with_anomaly({}, motor_anomaly(latest_row))
    return {**headline_and_next_step, "lights": lights}


def _flight_document(row: FlightRow) -> JsonValues:
    """Returns file and day of a flight for a fleet's document, and whether it is only a reference for other flights.

    Args:
        row: row of the flight, for the axis whose motors are in the worst health.

    Returns:
        The file name as ``file``; the day on which it began, UTC, as ``day``, empty where it is not known; and
        ``is_reference``, which is true if other flights are compared with it and it was not judged itself.
    """
    day = "" if row.date is None else row.date.date().isoformat()
    is_reference = row.is_unjudged_reference
    return {"file": PurePath(row.file).name, "day": day, "is_reference": is_reference}


def _motor_health_document(row: FlightRow) -> JsonValues:
    """Returns the health of a flight's motors by comparison with other flights, as it stands in a review document.

    Args:
        row: row of the flight in the fleet's table, for the axis whose motors are in the worst health.
    """
    return {
        "health": row.health,
        "code": row.health_code,
        "sentence": row.health_reason,
        "fault_probability": row.fault_probability,
        "suspect_motor": row.suspect_motor,
    }


def review_with_anomaly(
    review: Mapping[str, Any], anomaly: MotorAnomaly | None
) -> Mapping[str, Any]:
    """Returns the review document of a flight with an anomaly of the motors that only other flights of it show.

    The review itself judges the log alone. The anomaly replaces two parts of it, so that lists and comparisons of
    flights judge the motors in the same way as their pages do:

    - The status light of the motors, even one of the same level. If the anomaly names no motor, and the light by the
      log alone names one, the sentence of this light is kept beside the anomaly, and all of it as ``by_log_alone``.
    - The headline with the next step, as :func:`is_headline_replaced` decides.

    Args:
        review: review document of the flight; it is not modified.
        anomaly: the anomaly of the motors; None if there is none.

    Returns:
        A changed copy; the review itself without an anomaly.
    """
    if anomaly is None:
        return review
    changed_parts: JsonValues = {}
    lights = review.get("lights") or {}
    if Light.MOTORS in lights:
        motors_light = _light_with_anomaly(lights[Light.MOTORS] or {}, anomaly)
        changed_parts["lights"] = lights | {Light.MOTORS: motors_light}
    level_of_log = Level(value_at(review, "headline.level") or Level.UNKNOWN)
    if is_headline_replaced(level_of_log):
        changed_parts["headline"] = _anomaly_document(anomaly)
        for step in anomaly.next_step:
            changed_parts["next_step"] = _sentence_document(anomaly, step.text)
    return {**review, **changed_parts}


def _light_with_anomaly(light: Mapping[str, Any], anomaly: MotorAnomaly) -> Mapping[str, Any]:
    """Returns the motors' status light of a review document with an anomaly that other flights show.

    Args:
        light: the light as the log alone shows it, by the keys of a fact in a review document, such as "level".
        anomaly: the anomaly of the motors.

    Returns:
        The unchanged light if it is bad: nothing is worse. Otherwise the anomaly in its place. If the anomaly names no
        motor, but the log alone warns of one, that sentence follows, and the light of the log is kept under the key
        ``by_log_alone``.
    """
    level_of_log = Level(light.get("level") or Level.UNKNOWN)
    if level_of_log is Level.BAD:
        return light
    motor_of_log = light.get("subject") or ""
    if level_of_log is Level.WATCH and motor_of_log and not anomaly.motor:
        sentences = f"{anomaly.reason} {BY_LOG_ALONE} {light['sentence']}"
        document = _sentence_document(anomaly, sentences, subject=motor_of_log)
        return {**document, "by_log_alone": light}
    return _anomaly_document(anomaly, subject=anomaly.motor)


def _anomaly_document(anomaly: MotorAnomaly, subject: str = "") -> JsonValues:
    """Returns an anomaly by the keys that a fact has in a review document, with its figures and their units.

    Args:
        anomaly: the anomaly.
        subject: the motor that it is about; empty if it is about the flight as a whole.
    """
    document = _sentence_document(anomaly, anomaly.reason, subject)
    units = {name: UNITS[name] for name in anomaly.figures}
    return {**document, "figures": anomaly.figures, "units": units}


def _sentence_document(anomaly: MotorAnomaly, text: str, subject: str = "") -> JsonValues:
    """Returns a sentence about an anomaly by the keys that a fact has in a review document, without figures.

    Args:
        anomaly: the anomaly.
        text: the sentence.
        subject: the motor that it is about; empty if it is about the flight as a whole.
    """
    return {
        "code": anomaly.code,
        "level": anomaly.level,
        "time": None,
        "until": None,
        "subject": subject,
        "figures": {},
        "units": {},
        "sentence": text,
        "remedy": "",
    }


def with_motor_anomaly(page: str, anomaly: MotorAnomaly | None, *, is_compared: bool = True) -> str:
    """Returns the HTML page of a flight with an anomaly of the motors that only a comparison with other flights shows.

    The page was made from the log of the flight alone. Regular expressions find the two parts of it that change:

    - The status light of the motors gets the level of the anomaly if that is worse.
    - A section about the anomaly stands above the result of the log, as the headline of the page, or below it, as
      :func:`is_headline_replaced` decides.

    The function may be called again with its own result: the anomaly of the earlier call is replaced.

    Args:
        page: HTML of the page, or its beginning up to the status lights.
        anomaly: the anomaly; None if there is none, which restores the page of the log alone.
        is_compared: whether the motors were compared with those of the vehicle's other flights, or never will be. If
            they are still to be compared, good motors are unknown: the log alone does not show smaller losses.
    """
    light_with_anomaly = partial(_light_html, anomaly=anomaly, is_compared=is_compared)
    page = MOTORS_LIGHT_HTML.sub(light_with_anomaly, page, count=1)
    result_with_anomaly = partial(_result_html, anomaly=anomaly)
    return RESULT_HTML.sub(result_with_anomaly, page, count=1)


def _result_html(result: re.Match[str], anomaly: MotorAnomaly | None) -> str:
    """Returns the HTML of a log's result and, above or below it, the section about an anomaly of the motors.

    The anomaly comes first, since its headline becomes that of the page. Only if the log alone shows something bad,
    such as a crash, its result stays on top (:func:`is_headline_replaced`).

    Args:
        result: match of ``RESULT_HTML`` in the page, in which an earlier call may have written an anomaly.
        anomaly: the anomaly that the comparison with other flights shows; None without any.
    """
    classes = result["classes"]
    content = _without_marks_of_anomaly(result["content"])
    if anomaly is None:
        return _result_section(classes, content)
    is_below = not is_headline_replaced(_level_of_section(classes))
    anomaly_section = _anomaly_section(anomaly, is_below=is_below)
    if is_below:
        return _result_section(classes, content) + anomaly_section
    return anomaly_section + _result_section(classes, _marked_as_by_log_alone(content, anomaly))


def _result_section(classes: str, content: str) -> str:
    """Returns the HTML of the section with a log's result, as ``RESULT_HTML`` finds it again."""
    return f'<section id="result" class="{classes}">\n{content}</section>\n'


def _anomaly_section(anomaly: MotorAnomaly, *, is_below: bool) -> str:
    """Returns the HTML of the section about an anomaly of the motors, with its evidence and next step.

    Args:
        anomaly: the anomaly.
        is_below: whether the section stands below the log's result, where it is one paragraph without a headline.
    """
    section = render_page(
        environment().get_template("related_flights.html"),
        anomaly=anomaly,
        level_class=SECTION_CLASSES[anomaly.level],
        is_below=is_below,
    )
    return f"{section}\n"


def _marked_as_by_log_alone(content: str, anomaly: MotorAnomaly) -> str:
    """Returns the HTML of a log's result for below an anomaly: headline and next step are marked as by the log alone.

    Unmarked, a next step such as "Next: Fly again" would contradict that of the anomaly, "Next: Inspect motor 2". It
    becomes "Then, by this log alone: Fly again", and is hidden if the anomaly has the same step.
    :func:`_without_marks_of_anomaly` reverses this.

    Args:
        content: HTML of the result, as the page of the log was made.
        anomaly: the anomaly that stands above.
    """
    content = HEADLINE.sub(r"<p><strong>This log alone:</strong> \1</p>", content, count=1)
    is_same_step = any(f"{NEXT_STEP} {step.text}</p>" in content for step in anomaly.next_step)
    marked_step = NEXT_STEP_REPEATED if is_same_step else NEXT_STEP_ALONE
    return content.replace(NEXT_STEP, marked_step, 1)


def _level_of_section(classes: str) -> Level:
    """Returns the level of a log's result, "bad" or "watch", by the CSS classes of its section; "unknown" for others.

    The HTML of a page has the level only as a class. A good result has none of its own.

    Args:
        classes: the classes, separated by spaces, such as "blocks assessment doubted" for a bad result.
    """
    for level, section_class in SECTION_CLASSES.items():
        if section_class in classes.split():
            return level
    return Level.UNKNOWN


def _without_marks_of_anomaly(content: str) -> str:
    """Returns the HTML of a log's result as its page was made, with headline and next step unmarked.

    Args:
        content: HTML of the result, in which an earlier call of :func:`with_motor_anomaly` may have marked both as by
            the log alone (:func:`_marked_as_by_log_alone`).
    """
    content = HEADLINE_ALONE.sub(r'<p class="headline"><strong>\1</strong></p>', content)
    content = content.replace(NEXT_STEP_ALONE, NEXT_STEP, 1)
    return content.replace(NEXT_STEP_REPEATED, NEXT_STEP, 1)


def _light_html(light: re.Match[str], anomaly: MotorAnomaly | None, *, is_compared: bool) -> str:
    """Returns the HTML of the motors' status light with the worse of two levels: by the log, and by other flights.

    If the anomaly that the other flights show is worse, the HTML also states the level by the log alone, from which a
    later call restores the light.

    Args:
        light: match of ``MOTORS_LIGHT_HTML`` in the page, in which an earlier call may have changed the level.
        anomaly: the anomaly of the motors; None without any.
        is_compared: whether the motors were compared with other flights, or never will be. As long as that is pending,
            a good light is unknown.
    """
    level_of_log = Level(light["level_of_log"] or light["level"])
    level = level_of_log
    if anomaly is not None:
        level = level_beside_other_flights(level_of_log, anomaly.level)
    elif not is_compared and level_of_log is Level.GOOD:
        level = Level.UNKNOWN
    return render_page(
        environment().get_template("motors_light.html"),
        heading=light["heading"],
        level=level,
        level_of_log=level_of_log,
        figure=light["figure"],
        sentence=light["sentence"],
    )
