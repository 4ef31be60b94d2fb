"""The HTML pages of ``mavdem serve``: the library, a flight and its status lights, a vehicle, refusals.

The page of a flight is the file in its folder, with a bar above it. The content security policy of the server allows
one script, ``serve.js``, and within a flight's page those that draw the charts, by their hashes.
"""

import base64
import hashlib
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple, Protocol

from jinja2 import Environment
from markupsafe import escape

from mavdem.assessment.time_history import TimeHistory
from mavdem.containers import Names, group_by
from mavdem.facts import Fact, Level
from mavdem.facts.learnability import NotLearnableReason
from mavdem.facts.lights import Light
from mavdem.facts.serve import RefusalReason
from mavdem.files import load_adjacent_toml
from mavdem.fleet.flights import (
    AxisRows,
    Flights,
    group_by_vehicle,
    group_into_flights,
    log_row,
)
from mavdem.fleet.names import NO_NAMES, content_hash
from mavdem.fleet.row import FlightRow
from mavdem.ingest.vocabulary import AUTOPILOT_SET_PARAMETERS
from mavdem.report.blocks import Block, plain_text
from mavdem.report.charts.chart import MAX_POINTS_OF_SMALL_PAGE, Group
from mavdem.report.charts.timeline import history_timeline
from mavdem.report.charts.vehicle_charts import vehicle_groups
from mavdem.report.fleet import (
    HEALTH_LEVELS,
    VehicleTexts,
    badge_level,
    short_name,
    unnamed_vehicle,
    urgency_and_age,
    vehicle_label,
    vehicle_texts,
)
from mavdem.report.flight_lines import flight_line, minutes_text, wind_speed_text
from mavdem.report.heading import listed_headline, listed_next_step
from mavdem.report.pages.environment import environment, render_page
from mavdem.report.pages.motor_anomaly import MotorAnomaly, with_motor_anomaly
from mavdem.report.pages.page import PageEvent

POLICY_ELEMENT = re.compile(r'<meta http-equiv="Content-Security-Policy"[^>]*>')
"""The element of a flight's page with its own policy, which is for a file without a server."""

LAST_POSITION = re.compile(r"<p><strong>Last position:</strong>.*?</p>\n")
"""The sentence of a flight's page that says to a decimetre where a lost flight was seen last."""

SCRIPT_ELEMENT = re.compile(r"<script>(.*?)</script>", re.DOTALL)
"""A script within a flight's page."""

TITLE = re.compile(r"<h1>(.*?)</h1>")
"""The title of a flight's page, which is the name of its log."""

VEHICLE_OF_PAGE = re.compile(r"Vehicle (\d+:\d+), one of \d+ in the log")
"""What a flight's page says of its vehicle where the log has several: system and component."""

LINK_TO_FLEET_HTML = '<nav><a href="../index.html">← Fleet</a></nav>'
"""Link to the index of a fleet on a page that ``mavdem track`` has written; the server has no such index."""

MAX_FLIGHTS_OF_LOG = 12
"""Flights of one log that have a line of their own in the list, so that a log of many hops does not fill it."""

METRES_PER_KILOMETRE = 1000
"""Metres of a kilometre."""

CHART_SCRIPTS = (
    "sharp.js",
    "uplot/uPlot.iife.min.js",
    "charts.js",
    "page.js",
    "notch.js",
    "updates.js",
    "live.js",
)
"""The scripts within a page: those that draw its charts, and what else it does."""


@cache
def interface_words() -> dict[str, dict[str, str]]:
    """Returns the names shown for the stages of reading, the kinds of sharing, and the operations of the interface."""
    return load_adjacent_toml(__file__, "../serve/words.toml")


@cache
def server_script() -> bytes:
    """Returns the script of these pages, ``serve.js``."""
    return (files("mavdem.report") / "serve" / "serve.js").read_bytes()


@cache
def viewer_script() -> bytes:
    """Returns the script of the page with Rerun's viewer, ``rerun.js``, after that by which it follows a session."""
    folder = files("mavdem.report")
    return (folder / "updates.js").read_bytes() + (folder / "serve" / "rerun.js").read_bytes()


@cache
def script_hashes() -> Names:
    """Returns the SHA-256 hashes of the chart scripts, in the form in which a content security policy lists them."""
    return tuple(
        _script_hash(_server_environment().get_template(name).render()) for name in CHART_SCRIPTS
    )


def script_hashes_of_page(page: str) -> set[str]:
    """Returns the hashes of the scripts in a flight's page, by which a content security policy permits them.

    Elements with data for the scripts, which have a type, are no scripts and are left out.

    Args:
        page: HTML of the page, as this or an earlier version of mavdem has written it.

    Returns:
        Hashes in the form of :func:`script_hashes`.
    """
    return {_script_hash(source) for source in SCRIPT_ELEMENT.findall(page)}


def _script_hash(source: str) -> str:
    """Returns the SHA-256 hash of a script as a content security policy lists it."""
    digest = hashlib.sha256(source.encode(errors="replace")).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"


@cache
def _server_environment() -> Environment:
    """Returns Jinja's environment for the pages of the server: that of all pages, with more filters and values."""
    # An overlay shares the settings and filters of the environment. Its values are made a dictionary of its own below.
    jinja = environment().overlay()
    # Filters turn a value into text; a template writes them after a bar, as in {{ time | utc }}.
    jinja.filters["brief"] = _short_vehicle_name
    jinja.filters["listed_vehicle"] = _listed_vehicle_name
    jinja.filters["unnamed"] = _unnamed_vehicle
    jinja.filters["utc"] = _utc_text
    jinja.filters["minutes"] = minutes_text
    jinja.filters["metres"] = _metres_text
    jinja.filters["listed_headline"] = listed_headline
    jinja.filters["listed_next_step"] = listed_next_step
    # Constants and functions that the templates use by these names.
    values = {
        "lights": [str(light) for light in Light],
        "healths": HEALTH_LEVELS,
        "MAX_PARTS": MAX_FLIGHTS_OF_LOG,
        "wind_speed_text": wind_speed_text,
    }
    jinja.globals = {**jinja.globals, **interface_words(), **values}
    # All templates are compiled now, so that the first visitor does not wait for that.
    for name in jinja.list_templates(["html"]):
        jinja.get_template(name)
    return jinja


def _short_vehicle_name(name: str, frames: Mapping[str, str]) -> str:
    """Returns the short name of a vehicle to which its owner gave no name; a filter of the server's templates.

    It is the name in the logs or, if that is a serial number, the type of the frame and both ends of the number, which
    no line break parts.

    Args:
        name: name of the vehicle in its logs.
        frames: type of the frame of each vehicle, such as "QUADROTOR", by the name in the logs.
    """
    return vehicle_label(name, frames.get(name, ""), NO_NAMES).replace("…", "…\N{WORD JOINER}")


def _listed_vehicle_name(name: str) -> str:
    """Returns the name of a vehicle for one line of a narrow column; a filter of the server's templates.

    Args:
        name: name of the vehicle in its logs; its owner gave it none.

    Returns:
        Both ends of a serial number, the end of a calibration's hash, such as "…6f6923", or the name itself.
    """
    return short_name(name).replace("…", "…\N{WORD JOINER}")


class _FlightOfVehicle(Protocol):
    """What the library knows of the vehicle of a flight."""

    @property
    def frame(self) -> str:
        """Kind of the frame, such as "QUADROTOR"; empty where it is not known."""

    @property
    def autopilot(self) -> str:
        """MAV_AUTOPILOT; empty where it is not known."""


def _unnamed_vehicle(flight: _FlightOfVehicle) -> str:
    """Returns the description of a flight's vehicle that its log does not identify, such as "unnamed PX4 quadrotor"."""
    return unnamed_vehicle(flight.autopilot, flight.frame)


def _utc_text(seconds: float) -> str:
    """Returns a UNIX time in s as date and minute in UTC."""
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M}"


def _metres_text(metres: float) -> str:
    """Returns a distance in m in whole metres, or in kilometres from one on: "433 m", "1.2 km"."""
    if metres < METRES_PER_KILOMETRE:
        return f"{metres:.0f} m"
    return f"{metres / METRES_PER_KILOMETRE:.1f} km"


def render_server_page(name: str, /, **values: Any) -> str:
    """Renders a page of the server.

    Args:
        name: name of the template, without the ending, in ``mavdem/report/serve``.
        **values: values that the template uses, by name.

    Returns:
        The page as HTML.
    """
    return render_page(_server_environment().get_template(f"serve/{name}.html"), **values)


def first_plots(history: TimeHistory) -> str:
    """Renders the plots of a flight that are shown before its full page is ready, and a table of its events.

    Learning a model takes much longer than reading a log. So visitors first see the plots that need no model: charts
    over time, such as the motors, and the angles with their setpoints. Lines in them mark the events.

    Args:
        history: signals and events of the flight over time.

    Returns:
        Part of a page as HTML.
    """
    timeline = history_timeline(history)
    marked_charts_by_axis = {}
    for axis, charts in timeline.axis_charts.items():
        if charts:
            marked_charts_by_axis[axis] = [timeline.marked(chart) for chart in charts]
    # The charts of the whole vehicle are above each other, below them the axes are side by side.
    groups = [Group((timeline.overview,)), Group.of_axes(marked_charts_by_axis)]
    # A flight without attitudes has no charts of axes.
    groups_with_charts = [group for group in groups if any(group.columns)]
    return render_server_page(
        "first_plots",
        groups=groups_with_charts,
        events=[PageEvent(event) for event in timeline.events],
        points=MAX_POINTS_OF_SMALL_PAGE,
    )


def _with_given_name(page: str, given_name: str) -> str:
    """Returns the HTML page of a flight whose title is a name that the owner gave, with the name of the log after it.

    Args:
        page: HTML of the page, whose title is the name of the log.
        given_name: the given name, as plain text.
    """

    def title_with_name(title: re.Match[str]) -> str:
        """Returns the HTML of the title; the group of the match is the name of the log."""
        return f'<h1>{escape(given_name)} <small class="soft">{title[1]}</small></h1>'

    # With a text in the place of this function, backslashes of the name would be references to groups.
    return TITLE.sub(title_with_name, page, count=1)


def with_toolbar(
    page: str,
    given_name: str = "",
    anomaly: MotorAnomaly | None = None,
    *,
    is_compared: bool = True,
    **values: Any,
) -> str:
    """Returns the page of a flight as the server sends it: with a bar of downloads and settings at its top.

    The stored file of the page is never changed: each visitor gets a copy with these additions.

    Args:
        page: HTML of the flight's page, as it was written to its file.
        given_name: name that the owner gave to the flight. It becomes the title, with the name of the log after it.
            Empty if there is none.
        anomaly: fault or drift of the motors that a comparison with other flights of the vehicle shows. It is written
            into the page. None without any.
        is_compared: whether that comparison was made; False while it is still to be made.
        **values: further values that the templates of the bar and of the script use, by name: the flight with its
            files, the flights it can be compared with, and what the visitor may do.

    Returns:
        The page as HTML.
    """
    page = with_motor_anomaly(page, anomaly, is_compared=is_compared)
    page = page.replace(LINK_TO_FLEET_HTML, "", 1)
    if given_name:
        page = _with_given_name(page, given_name)
    page = with_server_script(page, **values)
    bar = render_server_page(
        "bar",
        given_name=given_name,
        is_compared=is_compared,
        # The script of the bar, which compares parameters with those of the last flight, marks the ones that the
        # autopilot itself learns in flight.
        self_set_parameters=AUTOPILOT_SET_PARAMETERS.pattern,
        **values,
    )
    # The bar stands at the beginning of the page's main element.
    return page.replace("<main>\n", f"<main>\n{bar}", 1)


def vehicle_id_on_page(page: str) -> str:
    """Returns the MAVLink system and component that the page of a flight names, such as "2:1".

    Args:
        page: HTML of the page. If the log has a single vehicle, the page does not name it, and the result is empty.
    """
    match = VEHICLE_OF_PAGE.search(page)
    return "" if match is None else match[1]


def without_last_position(page: str) -> str:
    """Returns the page of a flight without the sentence on where it was seen last, for visitors without its log."""
    return LAST_POSITION.sub("", page)


def with_comparison_bar(page: str, uncompared_names: Sequence[str], **values: Any) -> str:
    """Returns the page of a comparison as the server sends it: with the bar of the library's pages, and its script.

    Args:
        page: HTML of the page.
        uncompared_names: names of the compared flights whose motors are still to be compared with others of the
            vehicle. A remark states that the verdict on them may become worse.
        **values: further values that the templates of the bar and of the script use, by name: what the visitor may do,
            and the names of all vehicles.
    """
    page = with_server_script(page, **values)
    bar = render_server_page("comparing", uncompared_names=uncompared_names, **values)
    return page.replace("<main>\n", f"<main>\n{bar}", 1)


def with_server_script(page: str, **values: Any) -> str:
    """Replaces a page's own content security policy by the elements that load the server's script.

    The policy in the page is for one that is opened as a file, and forbids all scripts from elsewhere. The server sends
    its own policy as an HTTP header instead; a page obeys both, so that the first one has to go.

    Args:
        page: HTML of a flight's page, or of a comparison of flights.
        **values: values that the template of these elements, ``key.html``, uses by name.

    Returns:
        The page as HTML.
    """
    head_elements = render_server_page("key", **values)
    # The replacement is a function, since backslashes in a text would be taken for references to groups.
    return POLICY_ELEMENT.sub(lambda _: head_elements, page, count=1)


def vehicle_page(
    flights: Sequence[AxisRows],
    changes: Iterable[Block],
    healthy_logs: Collection[str],
    **values: Any,
) -> str:
    """Renders the server's page of one vehicle: the judgement of its motors, and how they changed over its flights.

    Args:
        flights: for each flight, in the order of time, its rows in the fleet's table, one for each axis. With fewer
            than two flights there are no charts.
        changes: sentences and tables on how the latest flight differs from the baseline of healthy flights.
        healthy_logs: hashes of the contents of the logs with whose flights the motors of the others are compared.
        **values: further values that the template ``vehicle.html`` uses, by name. Its ``entries`` are the entries of
            the flights in the library, to which the points of the charts link.

    Returns:
        The page as HTML.
    """
    # Without flights nothing is judged.
    texts = VehicleTexts(latest_flight="", reason="", all_flights="", next_step="", finding="")
    level = Level.UNKNOWN
    if flights:
        texts = vehicle_texts(flights)
        level = badge_level(flights)
    changes = [*changes]
    charts: list[Group] = []
    if len(flights) > 1:
        addresses = _addresses_of_flights(flights, values.get("entries", ()))
        charts = vehicle_groups(flights, addresses, healthy_logs)
    headline = texts.finding or texts.latest_flight
    if texts.reason:
        if texts.reason in plain_text(changes):
            # The changes below have the evidence.
            headline = listed_headline(headline)
        # The headline states why the motors are judged so.
        texts = vehicle_texts(flights, has_reason=False)
    return render_server_page(
        "vehicle",
        headline=headline,
        level=level,
        words=texts.all_flights,
        next_step=texts.next_step,
        changes=changes,
        groups=charts,
        **values,
    )


class VehicleLine(NamedTuple):
    """The line of one vehicle in the table of all vehicles."""

    name: str
    """What its logs call the vehicle."""

    level: Level
    """How well it is, by its latest flight and by its motors in comparison with its other flights."""

    finding: str
    """Its faults, the most serious first; without any, what its latest judged flight shows."""

    log_count: int
    """Number of its logs that hold flights; 0 if none can be analysed."""

    last_date: datetime | None
    """When the latest flight, or log, began, UTC; None where that is not known."""

    next_step: str
    """What to do next; empty where nothing is wrong."""


def vehicles_page(rows: Iterable[FlightRow], **values: Any) -> str:
    """Renders the server's page of all vehicles, a table with the most urgent vehicle at its top.

    Args:
        rows: rows of the vehicles' flights in the fleet's table, one for each axis.
        **values: further values that the template ``vehicles.html`` uses, by name.

    Returns:
        The page as HTML.
    """
    rows = [*rows]
    flights_by_vehicle = group_by_vehicle(rows)
    most_urgent_first = sorted(flights_by_vehicle.values(), key=urgency_and_age)
    lines = [_vehicle_line(flights) for flights in most_urgent_first]
    other_rows = [row for row in rows if row.vehicle not in flights_by_vehicle]
    rows_without_flight = group_by(other_rows, lambda row: row.vehicle)
    for name in sorted(rows_without_flight):
        logs = group_into_flights(rows_without_flight[name])
        lines.append(_line_without_flight(logs))
    return render_server_page("vehicles", lines=lines, **values)


def _line_without_flight(logs: Flights) -> VehicleLine:
    """Returns the line of a vehicle without a flight that can be analysed: what its latest log shows.

    A submarine or an aeroplane has lights without a model. Of any other log the line says why it has no flight.

    Args:
        logs: rows of each of its logs, in the order of date; at least one log.
    """
    last_row = log_row(logs[-1])
    level = Level.UNKNOWN
    next_step = ""
    if last_row.status_code == NotLearnableReason.NO_MULTIROTOR:
        level = Level(last_row.headline_level or Level.UNKNOWN)
        next_step = last_row.next_step or ""
    return VehicleLine(
        name=last_row.vehicle,
        level=level,
        finding=flight_line(logs[-1]).finding,
        log_count=0,
        last_date=last_row.past_date,
        next_step=next_step,
    )


def _vehicle_line(flights: Flights) -> VehicleLine:
    """Returns the line of a vehicle, with the judgement that its own page states.

    Args:
        flights: rows of each of its flights, one for each axis, in the order of date; at least one flight.
    """
    texts = vehicle_texts(flights)
    last_row = log_row(flights[-1])
    return VehicleLine(
        name=last_row.vehicle,
        level=badge_level(flights),
        finding=texts.finding or texts.latest_flight,
        log_count=len(flights),
        last_date=last_row.past_date,
        next_step=texts.next_step,
    )


def _addresses_of_flights(flights: Sequence[AxisRows], entries: Iterable[Any]) -> list[str]:
    """Returns the address of each flight's page on the server, "/f/ID"; empty for a flight without an entry.

    Args:
        flights: rows of each flight in the fleet's table, one for each axis.
        entries: entries of flights in the library (``serve.index.LibraryEntry``). The entry of a flight is found by the
            hash of its log's content.
    """
    ids = {entry.content_hash: entry.id for entry in entries}
    addresses = []
    for flight in flights:
        flight_id = ids.get(content_hash(log_row(flight).key))
        addresses.append("" if flight_id is None else f"/f/{flight_id}")
    return addresses


def refusal_page(fact: Fact, *, asks_for_token: bool, **values: Any) -> str:
    """Renders the page that is shown instead of a refused one, with the reason.

    Args:
        fact: fact (a coded finding) with the reason of the refusal, and what to do.
        asks_for_token: whether the page has a form for the token, by which a visitor signs in.
        **values: further values that the template uses, by name.

    Returns:
        The page as HTML.
    """
    return render_server_page(
        "message",
        sentence=fact.sentence,
        remedy=fact.remedy,
        asks=asks_for_token,
        may_be_private=fact.code is RefusalReason.NO_SUCH_FLIGHT,
        **values,
    )
