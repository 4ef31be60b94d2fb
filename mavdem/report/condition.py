"""The contents of a log, and the wind and the drag of its vehicle, in sentences and tables."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment import Assessment
from mavdem.assessment.judgement import Judgement
from mavdem.confidence import IntervalEstimate, coverage_factor
from mavdem.containers import JsonValues
from mavdem.dataset.axes import TILT_AXES
from mavdem.dataset.intervals import (
    Intervals,
    TimeInterval,
    intersection,
    split_at_gaps,
    total_duration,
)
from mavdem.dataset.segment_learnability import Learnability
from mavdem.facts import Level
from mavdem.facts.lights import Light
from mavdem.facts.online import DragSource
from mavdem.ingest.vocabulary import UNNAMED
from mavdem.physical_constants import GRAVITY
from mavdem.report.blocks import Block, Blocks, Sentence, Table, caution
from mavdem.report.charts.chart import MAX_GAP_STEPS
from mavdem.report.numbers import listed
from mavdem.report.templates import render_section, rounded_up
from mavdem.wind_velocity.beaufort import is_speed_known
from mavdem.wind_velocity.compass import compass_text, meteorological_direction
from mavdem.wind_velocity.from_log import WindEvidence, is_certain_setting
from mavdem.wind_velocity.mean_wind import INDEPENDENT_SECONDS
from mavdem.wind_velocity.vehicle_drag import (
    DRAG_PARAMETER_NAMES,
    LEAN_SD,
    Drag,
)
from mavdem.wind_velocity.velocity import WindVelocity

WIND_LIGHTS = (Light.WIND, Light.ESTIMATOR)
"""Lights that bear on the wind: the estimate rests on the attitude and velocity of the autopilot's estimator."""

DRAG_SOURCES = {
    DragSource.POPULATION: "typical multirotors",
    DragSource.PARAMETERS: "the autopilot's parameters",
    DragSource.FLIGHT: "this flight",
    DragSource.EARLIER_FLIGHT: "an earlier flight",
    DragSource.CALIBRATION: "calibration",
}
"""Names shown for the sources of a drag."""

MIN_LISTED_RATE = 0.95
"""Rate, Hz, below which messages are listed together: they are too slow to describe the motion."""

MIN_LOST_SHARE = 0.01
"""Share of missing sequence numbers from which on it is reported; less is normal on a radio link."""

PARAMETER_MESSAGE = "PARAM_VALUE"
"""Message with parameters, which a vehicle sends on request; its rate has no meaning."""


def log_blocks(contents: JsonValues) -> Blocks:
    """Returns the report on what a log contains: the messages of each vehicle, then what each sender lost on the link.

    Args:
        contents: inventory of the log, from ``mavdem.assessment.inventory``.
    """
    blocks = Blocks()
    for vehicle in contents["vehicles"]:
        blocks += vehicle_contents_blocks(vehicle)
    return [*blocks, *stream_contents(contents)]


def vehicle_contents_blocks(vehicle: JsonValues) -> Blocks:
    """Returns the report on the messages of one vehicle in a log, and on whether a model can be learned from them.

    Args:
        vehicle: what a log contains of the vehicle, by the keys of the JSON document of `mavdem info`
            (:func:`mavdem.assessment.inventory.inventory`). The values are not yet converted to JSON, so that
            ``vehicle["verdict"]`` is an object of the class ``Learnability``: whether a model of one axis can be
            learned from the log, and if not, why.

    Returns:
        Sentences and a table, in this order:

        1. Whether a model of the vehicle can be learned and, if not, why, and what to change.
        2. The tier of the log, "a", "b" or "c": the kind of model that its message rates allow.
        3. Cautions about the model that can be learned.
        4. Repairs: corrections that the reader made to the log, such as of a clock that went back.
        5. The longest segment of settled flight, without large manoeuvres, in which a model can be trained.
        6. A table of the periodic messages by their rate.
    """
    learnability: Learnability = vehicle["verdict"]
    blocks: Blocks = []
    blocks += render_section(
        "vehicle",
        system=vehicle["system"],
        component=vehicle["component"],
        vehicle=vehicle["vehicle"],
        autopilot=vehicle["autopilot"],
        verdict=learnability,
        is_tilt=learnability.axis in TILT_AXES,
        # Only the document of an analysed log has these two keys.
        model=vehicle.get("model"),
        next_step=vehicle.get("next_step"),
    )
    blocks += render_section("tier", tier=vehicle["tier"], allows=vehicle["allows"])
    blocks += [caution(fact) for fact in learnability.cautions]
    blocks += [Sentence(str(repair), lead="Noted:") for repair in vehicle["repairs"]]
    blocks += render_section("settled", segments=vehicle["segments"], boots=vehicle["boots"])
    rows = []
    for rate, names in _messages_by_rate(vehicle).items():
        rows.append([rate, ", ".join(names)])
    if rows:
        blocks.append(Table(["rate", "messages"], rows, words=True, is_printed=False))
    return blocks


def _messages_by_rate(vehicle: JsonValues) -> dict[str, list[str]]:
    """Groups the names of a vehicle's periodic messages by their rate, the fastest first.

    Args:
        vehicle: one of the vehicles of a log's inventory, values by key.

    Returns:
        Names of messages by the text of their rate, such as "50.0 Hz"; messages below 1 Hz are one group. If the log
        has another name for a message, that name follows in brackets.
    """
    names_in_log = vehicle["names"]
    rates = {}
    for name, message in vehicle["messages"].items():
        # A message has no rate if it did not come twice.
        if message["rate"] and name != PARAMETER_MESSAGE:
            rates[name] = message["rate"]
    names_by_rate = dict[str, list[str]]()
    for name in sorted(rates, key=lambda name: rates[name], reverse=True):
        rate_text = "below 1 Hz"
        if rates[name] >= MIN_LISTED_RATE:
            rate_text = f"{rates[name]:.1f} Hz"
        full_name = name
        if name in names_in_log:
            full_name = f"{name} ({names_in_log[name]})"
        names_by_rate.setdefault(rate_text, []).append(full_name)
    return names_by_rate


def stream_contents(contents: JsonValues) -> list[Sentence]:
    """Returns sentences on the senders of the messages in a log, and on messages that could not be decoded.

    A vehicle has a sentence if messages of it were lost. Other senders, such as a ground station, have one only in a
    log without a vehicle.

    Args:
        contents: inventory from ``mavdem.assessment.inventory``: ``speakers`` are all senders of messages, ``vehicles``
            the senders that are vehicles, and ``unread`` the messages that could not be decoded.
    """
    vehicle_ids = [component_id(vehicle) for vehicle in contents["vehicles"]]
    sentences = []
    for sender in contents["speakers"]:
        is_vehicle = component_id(sender) in vehicle_ids
        sentences += render_section(
            "sender",
            # In a log with a vehicle, ground stations and radios are usual, and are not listed. In a log without one
            # every sender is listed, so that the reader sees what it contains.
            is_ordinary=bool(vehicle_ids),
            # Without a heartbeat the kind of a component is not known.
            is_silent=sender["kind"] == UNNAMED and not is_vehicle,
            # The gaps of a ground station have no meaning: it numbers its messages to all links together.
            is_lossy=is_vehicle and _is_lossy(sender),
            # Ids of the sender and counts of its messages, by the names that the template uses.
            **sender,
        )
    return [*sentences, *render_section("unread", unread=contents["unread"])]


def _is_lossy(sender: JsonValues) -> bool:
    """Returns whether messages of a MAVLink sender were lost on the link to the log.

    Sequence numbers are missing if messages were lost, but also if the log keeps only some kinds of messages. In the
    second case the periodic messages have no gaps. So missing numbers count as losses only if the periodic messages
    lack at least half of the same fraction, or ``MIN_LOST_SHARE``, if that is less. If the log has no periodic
    messages, the missing numbers count as losses.

    Args:
        sender: a sender in the list of a log's contents. "lost_share" is the fraction (0 to 1) of its messages that
            were lost by the sequence numbers. "missing_share" is the fraction by the gaps in its periodic messages,
            None if it has no such messages.
    """
    fraction_by_numbers = sender["lost_share"]
    fraction_by_gaps = sender["missing_share"]
    if fraction_by_numbers < MIN_LOST_SHARE:
        return False
    if fraction_by_gaps is None:
        return True
    return fraction_by_gaps >= min(MIN_LOST_SHARE, fraction_by_numbers / 2)


def component_id(component: JsonValues) -> str:
    """Returns the MAVLink system and component of a sender, such as "1:1"."""
    return f"{component['system']}:{component['component']}"


def flight_warning(judgement: Judgement) -> list[Sentence]:
    """Returns the headline of a flight, for a report on its wind, if it is bad and about something else.

    A report on the wind alone must not read as if the flight were sound, for example if control was lost.

    Args:
        judgement: headline, next step and all status lights of the flight.

    Returns:
        A list with one sentence; empty if the headline is not bad, or if a light of ``WIND_LIGHTS`` states it.
    """
    headline = judgement.headline
    lights_on_wind = [judgement.lights[light_name] for light_name in WIND_LIGHTS]
    is_stated_by_light = any(str(light) == str(headline) for light in lights_on_wind)
    if not headline.is_bad or is_stated_by_light:
        return []
    return [Sentence(str(headline), "The flight:", Level.BAD)]


def wind_blocks(
    evidence: WindEvidence, tables: Sequence[Block] = (), remarks: Sequence[Block] = ()
) -> Blocks:
    """Returns the report on the wind that was estimated from a flight, in sentences with optional tables.

    First comes the sentence on speed, direction and gusts with their 90 % intervals, then the remarks, then sentences
    on how certain that is, and on the autopilot's own estimate for comparison. Then come the tables, and last, for each
    quantity that the data does not determine well, the reason.

    Args:
        evidence: all that is known of the wind of a log: the estimate or, without one, the reason for that if known;
            and the autopilot's own estimate.
        tables: tables of the wind, such as its mean in each minute, and what explains them.
        remarks: what a reader must know before using the estimate, such as what speaks against its prior.

    Returns:
        The report. Without an estimate it is only the reason for that, or empty if the reason is not known.
    """
    wind = evidence.estimate
    if wind is None:
        if evidence.reason is None:
            return []
        return [Sentence(evidence.reason.sentence_and_remedy, lead="Wind:")]
    # The reason why each quantity, such as the speed or the drag, has a wide interval or is not identifiable.
    reasons = dict(wind.reasons)
    is_speed_uncertain_by_drag = "speed" in reasons and bool(reasons["speed"].figures["by_drag"])
    estimate, *certainty = _wind_estimate_sentences(
        evidence, wind, is_speed_uncertain_by_drag=is_speed_uncertain_by_drag
    )
    if wind.speed_identifiable and (is_speed_uncertain_by_drag or wind.may_be_lean):
        # The sentences on the estimate say already that the drag or a lean widens the intervals of the speed.
        del reasons["speed"]
    reason_sentences = []
    for quantity, reason in reasons.items():
        reason_sentences.append(Sentence(str(reason), lead=f"{quantity.capitalize()}:"))
    return [estimate, *remarks, *certainty, *tables, *reason_sentences]


def _wind_estimate_sentences(
    evidence: WindEvidence, wind: WindVelocity, *, is_speed_uncertain_by_drag: bool
) -> list[Sentence]:
    """Returns sentences on the speed, direction and gusts of a wind, and on the autopilot's own estimate of it.

    The sentences also state on which conditions the intervals hold, such as a typical drag.

    Args:
        evidence: all that is known of the wind of a log, with the autopilot's estimate.
        wind: the estimate of mavdem.
        is_speed_uncertain_by_drag: whether the interval of the speed is wide because the drag is not well known.

    Returns:
        The sentences, as the template "wind" (``sections/wind.toml``) makes them of these figures.
    """
    return render_section(
        "wind",
        wind=wind,
        # The first and the last direction of a wind that turned during the flight; None if it did not turn.
        direction_change=wind.turn,
        # Time before and after a large attitude error for which no wind is estimated, s.
        excluded_seconds=INDEPENDENT_SECONDS,
        # How long the flight had no estimate between the first and the last one, s.
        seconds_without_estimate=np.ptp(wind.time) - total_duration(estimated_intervals(wind.time)),
        # A speed that the light calls known only roughly is called so here as well.
        is_rough=not is_speed_known(wind.mean_speed_interval),
        typical_drag=_typical_drag_interval(),
        lean_without_wind=_lean_without_wind(),
        is_speed_uncertain_by_drag=is_speed_uncertain_by_drag,
        autopilot_wind=_autopilot_wind(evidence, wind),
        # Message with the autopilot's estimate if it is always 0; otherwise empty.
        zero_estimate=evidence.zero_estimate,
        # Setting with which the autopilot would estimate the wind itself; empty if it has none.
        drag_model_setting=evidence.drag_model_setting,
    )


def _typical_drag_interval() -> Array:
    """Returns both ends (2,) of the 90 % interval of the linear drag of typical multirotors, 1/s.

    It is the mean of both body axes, and the same for every flight: what a wind is estimated with unless the drag of
    the vehicle is known better.
    """
    return Drag.from_parameters().interval("linear").mean(axis=1)


def _lean_without_wind() -> float:
    """Returns the lean of a vehicle without wind that the intervals of the wind allow for, rad, as a 90 % half width.

    A vehicle also leans by a misaligned attitude or an offset load. ``LEAN_SD`` is the standard deviation of this lean
    as an acceleration, m/s². Divided by gravity it is an angle.
    """
    return coverage_factor() * LEAN_SD / GRAVITY


class _AutopilotWind(NamedTuple):
    """The mean of the wind that the autopilot itself estimated."""

    mean_speed: float
    """Mean of the speeds, m/s."""

    direction: float
    """Direction that the mean of the velocities comes from, degrees clockwise from north."""


def _autopilot_wind(evidence: WindEvidence, wind: WindVelocity) -> _AutopilotWind | None:
    """Returns the mean of the autopilot's own wind estimate, for comparison with the estimate of mavdem.

    Args:
        evidence: all that is known of the wind of a log, with the autopilot's estimate (north and east, m/s).
        wind: the estimate of mavdem.

    Returns:
        The mean over the time for which mavdem has an estimate; None if the autopilot has none of that time.
    """
    estimate = evidence.autopilot_estimate
    if estimate is None:
        return None
    start_time, end_time = wind.time[[0, -1]]
    is_in_time = (estimate.time >= start_time) & (estimate.time <= end_time)
    is_selected = (estimate.boot == wind.boot) & is_in_time
    if not is_selected.any():
        return None
    velocities = estimate.values[is_selected]
    north, east = velocities.mean(axis=0)
    mean_speed = float(np.hypot(*velocities.T).mean())
    return _AutopilotWind(mean_speed, direction=meteorological_direction(north, east))


def wind_tables(wind: WindVelocity) -> list[Table]:
    """Returns two tables of the mean wind: one over time, in parts of about a minute, and one over height, in layers.

    Each row has both ends of the part, s, or the mean height in the layer, m; the wind speed with its 90 % interval,
    m/s; and the direction that the wind comes from, if that is identifiable. A table with a single row is left out,
    since it would only repeat the mean of the flight.

    Args:
        wind: estimated wind of a flight.

    Returns:
        Up to two tables; none if the data does not determine the wind speed.
    """
    identified_wind = wind.without_unidentified_speeds
    with_estimate = estimated_intervals(wind.time)
    times = []
    for part in identified_wind.minutes:
        times.append(_part_of_flight_text((part["start"], part["end"]), with_estimate))
    heights = [f"{layer['height']:.0f}" for layer in identified_wind.profile]
    tables = []
    if len(times) >= 2:
        tables.append(_mean_wind_table("Time (s)", times, identified_wind.minutes, wind))
    if len(heights) >= 2:
        tables.append(_mean_wind_table("Height (m)", heights, identified_wind.profile, wind))
    return tables


def estimated_intervals(time: Array) -> Intervals:
    """Returns the intervals of a flight that have an estimate of the wind, s, in the order of time.

    Between them are landings, resets of the state estimator, and what was left out. Lines over time are interrupted in
    the same gaps.

    Args:
        time: (T,) times of the estimate, s, evenly spaced but for gaps.
    """
    steps = np.diff(time)
    return split_at_gaps(time, steps > MAX_GAP_STEPS * np.median(steps))


def _part_of_flight_text(part: TimeInterval, with_estimate: Intervals) -> str:
    """Returns both ends of a part of a flight in whole seconds, and how much of it has an estimate, unless it is all.

    Args:
        part: start and end, s, such as 533 and 633.
        with_estimate: intervals of the flight with an estimate of the wind, s.

    Returns:
        Text such as "533–633", or "533–633 (57 s of it)" for a part with a landing.
    """
    start, end = part
    text = f"{start:.0f}–{end:.0f}"
    estimated_seconds = total_duration(intersection([part], with_estimate))
    if round(end - start - estimated_seconds) < 1:
        return text
    return f"{text} ({estimated_seconds:.0f} s of it)"


def _mean_wind_table(
    header: str, labels: Sequence[str], mean_winds: Sequence[dict[str, float]], wind: WindVelocity
) -> Table:
    """Returns a table of the mean wind over time or over height.

    Args:
        header: header of the first column.
        labels: first cell of each row.
        mean_winds: mean wind of each row: "speed", "low" and "high", m/s, and "direction", degrees.
        wind: the wind of the whole flight; if its direction is identifiable, the table has a column of the direction
            that the wind comes from.
    """
    headers = [header, "Vector mean (m/s)"]
    if wind.direction_identifiable:
        headers.append("From")
    rows = []
    for label, mean_wind in zip(labels, mean_winds, strict=True):
        row = [label, _mean_speed_cell(mean_wind)]
        if wind.direction_identifiable:
            row.append(_origin_cell(mean_wind))
        rows.append(row)
    return Table(headers, rows)


def _mean_speed_cell(mean_wind: Mapping[str, float]) -> str:
    """Returns the speed of a mean wind with its 90 % interval, or its upper end where still air is likely as well."""
    if not mean_wind["low"]:
        return f"below {rounded_up(mean_wind['high'], 1)}"
    return f"{mean_wind['speed']:.1f} ({mean_wind['low']:.1f} to {mean_wind['high']:.1f})"


def _origin_cell(mean_wind: Mapping[str, float]) -> str:
    """Returns where a mean wind comes from, or that it may be still air, which has no direction."""
    if not mean_wind["low"]:
        return "may be still air"
    return compass_text(mean_wind["direction"])


def drag_blocks(drag: Drag, autopilot: str, settings: Mapping[str, IntervalEstimate]) -> Blocks:
    """Returns the report on a vehicle's drag: a table of its coefficients, then sentences.

    The autopilot estimates wind with parameters of the drag. The table has the value that the flight suggests for each
    of them, with its 90 % interval. The sentences say why some of them should not be set, if there are any.

    Args:
        drag: drag of the vehicle, estimated from the flight.
        autopilot: name of the autopilot, which decides on the names of the parameters.
        settings: value and both ends of the interval of each parameter to set, by its name.
    """
    table = _drag_table(drag, autopilot, settings)
    return [table, *_sentences_on_unset_parameters(drag, autopilot, settings)]


def _drag_table(drag: Drag, autopilot: str, settings: Mapping[str, IntervalEstimate]) -> Table:
    """Returns the table of a vehicle's drag: value and 90 % interval of each parameter to set, and the linear drag.

    An autopilot has a parameter for the linear drag, its "momentum drag coefficient", and others for the quadratic
    drag. If the first is not among the parameters to set, the linear drag has a row without such a name.

    Args:
        drag: drag of the vehicle, with linear coefficients along x and y of the body (2,), 1/s. Their mean is shown.
        autopilot: name of the autopilot, which decides on the names of the parameters.
        settings: value and both ends of the interval of each parameter of the autopilot to set, by its name.
    """
    linear_drag_name, _ = DRAG_PARAMETER_NAMES.get(autopilot, ("", ""))
    # Value and interval by the text of the row's first cell.
    quantities: dict[str, IntervalEstimate] = {}
    for name, setting in settings.items():
        unit = "linear drag, 1/s" if name == linear_drag_name else "kg/m²"
        quantities[f"{name} ({unit})"] = setting
    if linear_drag_name not in settings:
        low, high = drag.interval("linear").mean(axis=1)
        linear_drag = IntervalEstimate(float(drag.linear.mean()), low=float(low), high=float(high))
        quantities["linear drag (1/s)"] = linear_drag
    rows = []
    for name, quantity in quantities.items():
        rows.append([name, f"{quantity.value:.3g}", f"{quantity.low:.3g}", f"{quantity.high:.3g}"])
    header = [f"Drag, from {DRAG_SOURCES[drag.source]}", "value", "from", "to"]
    return Table(header, rows)


def _sentences_on_unset_parameters(
    drag: Drag, autopilot: str, settings: Mapping[str, IntervalEstimate]
) -> list[Sentence]:
    """Returns sentences on parameters of the drag that are not set although others are.

    The value of a parameter may be outside the range that the autopilot accepts, or too uncertain after this flight.

    Args:
        drag: drag of the vehicle.
        autopilot: name of the autopilot, which decides on the names of the parameters.
        settings: the parameters to set, by name; without any there are no sentences either.
    """
    if not settings:
        return []
    # Parameters of the linear drag, and of the quadratic drag along body x and y.
    momentum_name, ballistic_prefix = DRAG_PARAMETER_NAMES.get(autopilot, ("", ""))
    names = (momentum_name, f"{ballistic_prefix}X", f"{ballistic_prefix}Y")
    values_in_range = drag.autopilot_parameters(autopilot)
    names_out_of_range = []
    uncertain_names = []
    for name in names:
        if name not in values_in_range:
            names_out_of_range.append(name)
        elif name not in settings and not is_certain_setting(values_in_range[name]):
            # A certain value that is not to be set has no sentence: the log has no such parameter.
            uncertain_names.append(name)
    sentences = []
    if names_out_of_range:
        text = (
            f"{listed(names_out_of_range)}: the autopilot does not take the value of this vehicle."
        )
        sentences.append(Sentence(text, lead="Not set:"))
    if uncertain_names:
        text = f"This flight does not show {listed(uncertain_names)}."
        sentences.append(Sentence(text, lead="Unknown:"))
    return sentences


def air_blocks(assessment: Assessment) -> Blocks:
    """Returns the report on the wind of a flight: its speed and direction, and how much of the wind torque it explains.

    The wind torque is the part of the torque on the vehicle that the motors do not explain. Gusts of the estimated wind
    explain some of it.

    Args:
        assessment: all results on a vehicle of a log: events, status lights, model, loops and wind.

    Returns:
        The report; empty if the vehicle was not judged at all.
    """
    if assessment.evidence is None:
        return []
    blocks = wind_blocks(assessment.evidence.wind)
    explained_torque = assessment.wind_share_of_torque
    if explained_torque is not None:
        blocks.append(Sentence(str(explained_torque), lead="Wind torque:"))
    return blocks
