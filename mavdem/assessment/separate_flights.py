"""The flights of a recording that are judged each by itself: the autopilot restarted on the ground between them.

Parameters, battery and propellers may be other ones after a restart, and another vehicle may have the same ids. Flights
of one boot are judged together.
"""

from dataclasses import replace
from math import inf
from typing import NamedTuple

import numpy as np

from mavdem.assessment.flight_verdict import FlightVerdict
from mavdem.assessment.flights import flights_in_boot
from mavdem.assessment.flown_flights import flights_and_hops, flown_flights, total_time
from mavdem.assessment.judgement import Judgement
from mavdem.assessment.restarts import restarts
from mavdem.dataset.parameter_history import BootTime, ParameterHistory, parameter_history
from mavdem.dataset.segments import Segment, Segments, recorded_spans
from mavdem.dataset.signals import Signals
from mavdem.facts.events import ReportedEvent
from mavdem.ingest.mavlink.payloads import latest_parameters
from mavdem.ingest.mavlink.vehicles import parameter_reports, vehicle_identity
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.ingest.telemetry import Columns, Parameters, Telemetry, selected_rows


class SeparateFlight(NamedTuple):
    """A flight of a recording, or several flights of one boot."""

    signals: Signals
    """The signals of this flight alone."""
    first_number: int
    """Number of the flight in the recording, from 1, or of the first of several."""
    last_number: int | None
    """Number of the last of several flights; None for a single one."""
    duration: float | None
    """Time in the air, s; None if it is not known."""

    def verdict(self, judgement: Judgement) -> FlightVerdict:
        """Returns a judgement of this flight together with the flight's number and duration.

        Args:
            judgement: the most serious fact of the flight, its status lights and the next step.
        """
        return FlightVerdict(
            self.first_number, judgement, self.duration, last_number=self.last_number
        )


class RecordedFlight(NamedTuple):
    """The flight of a recording that is assessed, and the verdicts on the others."""

    flight: SeparateFlight
    """The flight."""
    other_verdicts: tuple[FlightVerdict, ...]
    """The verdicts on the other flights, the worst first."""
    all_signals: Signals
    """The signals of all flights of the recording."""


def separate_flights(signals: Signals) -> list[SeparateFlight]:
    """Returns the flights of a multirotor's recording between which its autopilot restarted on the ground.

    Args:
        signals: logged time series of the vehicle in all boots.

    Returns:
        The flights in the order of the recording; none if it has no such restart, or is of another kind of vehicle.
    """
    flights: list[SeparateFlight] = []
    if signals.telemetry.vehicle not in POSSIBLE_MULTIROTORS:
        return flights
    flown_groups = []
    for spans in _spans_between_restarts(signals):
        if any(flights_in_boot(signals, span.boot) for span in spans):
            flown_groups.append(spans)
    if len(flown_groups) < 2:
        return flights
    flight_count = 0
    for spans in flown_groups:
        telemetry = telemetry_of_spans(signals, spans)
        signals_of_flight = Signals(telemetry, signals.axis, signals.inputs)
        # A flight that was over at once is no flight for a pilot, but it is judged and so needs a number.
        count = max(len(flown_flights(signals_of_flight)), 1)
        flights.append(
            SeparateFlight(
                signals_of_flight,
                first_number=flight_count + 1,
                last_number=flight_count + count if count > 1 else None,
                duration=total_time(flights_and_hops(signals_of_flight)),
            )
        )
        flight_count += count
    return flights


def _spans_between_restarts(signals: Signals) -> list[Segments]:
    """Groups the boots of a recording, so that a boot after a restart in flight joins the boot before it.

    A restart on the ground, for example to load parameters, ends a group.

    Args:
        signals: logged time series of the vehicle in all boots.

    Returns:
        The groups in the order of the recording. A group has several boots if the autopilot restarted in flight.
    """
    groups: list[list[Segment]] = []
    for span in recorded_spans(signals):
        # The first boot of the recording is no restart.
        is_first_boot = not groups
        events = () if is_first_boot else restarts(signals, span)
        is_in_flight = any(event.code is ReportedEvent.RESTARTED_IN_FLIGHT for event in events)
        if is_in_flight:
            groups[-1].append(span)
        else:
            groups.append([span])
    return list(groups)


def telemetry_of_spans(signals: Signals, spans: Segments) -> Telemetry:
    """Returns the messages of some boots of a vehicle, as if nothing else had been recorded.

    - The parameters are those of these boots, even if they were reported in earlier boots only.
    - Only the last boot of the recording may have been ended by the user. An earlier one ended when the autopilot
      restarted.
    - A recording states one autopilot. If another vehicle had the same ids in another boot, the autopilot is found
      anew from the heartbeats of these boots.

    Args:
        signals: logged time series of the vehicle in all boots.
        spans: recorded spans of successive boots, at least one.

    Returns:
        Their messages, with 0 as the number of the first boot.
    """
    telemetry = signals.telemetry
    first_boot, last_boot = spans[0].boot, spans[-1].boot
    messages = dict[str, Columns]()
    for name, columns in telemetry.messages.items():
        is_of_boots = (columns["boot"] >= first_boot) & (columns["boot"] <= last_boot)
        if is_of_boots.any():
            messages[name] = _with_boots_from_zero(selected_rows(columns, is_of_boots), first_boot)
    if "HEARTBEAT" in messages:
        autopilot = vehicle_identity(messages["HEARTBEAT"]).autopilot
        if autopilot != telemetry.autopilot:
            telemetry = _as_other_autopilot(telemetry, autopilot)
            signals = Signals(telemetry, signals.axis, signals.inputs)
    end = _last_time_of_parameters(signals, spans[-1])
    if "PARAM_VALUE" in telemetry.messages:
        all_reports = parameter_reports(telemetry.messages, telemetry.autopilot)
        reports = _reports_until(all_reports, spans, end)
        if len(reports["time"]):
            messages["PARAM_VALUE"] = _with_boots_from_zero(reports, first_boot)
    is_last_boot = last_boot == recorded_spans(signals)[-1].boot
    telemetry = replace(
        telemetry,
        messages=messages,
        is_ended_on_purpose=telemetry.is_ended_on_purpose and is_last_boot,
        restart_delays={
            boot - first_boot: delay for boot, delay in telemetry.restart_delays.items()
        },
    )
    return _with_parameters_between(
        telemetry, parameter_history(signals), BootTime(first_boot, -inf), end
    )


def _with_parameters_between(
    telemetry: Telemetry, history: ParameterHistory, start: BootTime, end: BootTime
) -> Telemetry:
    """Returns the messages of a part of a recording with the parameters that held in this part.

    For example, a gain was 0.15 at the start of the part, 0.12 at its end, and 0.1 at the end of the recording. Then
    0.12 is its value, 0.15 its initial and 0.1 its later one.

    Args:
        telemetry: the messages.
        history: values of all parameters over the whole recording.
        start: start of the part.
        end: end of the part, which decides the values of its parameters.
    """
    values_at_start = history.at(start)
    values_at_end = history.at(end)
    initial_values = {}
    later_values = {}
    for name in history.settings:
        if values_at_start[name] != values_at_end[name]:
            initial_values[name] = values_at_start[name]
        if values_at_end[name] != history.last_values[name]:
            later_values[name] = history.last_values[name]
    return replace(
        telemetry,
        parameters=values_at_end,
        initial_parameters=initial_values,
        later_parameters=later_values,
    )


def _with_boots_from_zero(columns: Columns, first_boot: int) -> Columns:
    """Returns the messages of one type with the numbers of their boots counted from ``first_boot``."""
    return {**columns, "boot": columns["boot"] - first_boot}


def _as_other_autopilot(telemetry: Telemetry, autopilot: str) -> Telemetry:
    """Returns the messages of a recording as those of another autopilot, with the parameters that this one reported.

    A recording may hold a PX4 and an ArduPilot vehicle with the same ids, one after the other, but it states only one
    autopilot. Parameters of the other vehicle must not count, and each autopilot encodes their values in its own way.

    Args:
        telemetry: the messages, with the autopilot that the recording states, and its parameters.
        autopilot: the other autopilot, by the name of its MAV_AUTOPILOT without the prefix, such as "PX4".
    """
    parameters: Parameters = {}
    if "PARAM_VALUE" in telemetry.messages:
        parameters = latest_parameters(parameter_reports(telemetry.messages, autopilot), autopilot)
    return replace(
        telemetry,
        autopilot=autopilot,
        parameters=parameters,
        initial_parameters={},
        later_parameters={},
    )


def _last_time_of_parameters(signals: Signals, span: Segment) -> BootTime:
    """Returns the time up to which reports of the autopilot's parameters belong to a boot and its flights.

    - Before a restart this is the last landing: a gain that the pilot sets after it acts in the next flight only.
    - In a boot without a flight, it is just before the last message. A report has no time of its own, but that of the
      message before it. So the first reports after a restart bear the time of the last message before it.
    - In the last boot of the recording all reports count.

    Args:
        signals: logged time series of the vehicle in all boots.
        span: recorded span of the boot.

    Returns:
        Number of the boot and time in it, s; infinite for the last boot.
    """
    is_last_boot = span == recorded_spans(signals)[-1]
    if is_last_boot:
        return BootTime(span.boot, inf)
    # The largest number below the time of the last message.
    end = np.nextafter(span.end, -inf)
    flights = flights_in_boot(signals, span.boot)
    if flights:
        _, last_landing = flights[-1]
        # A flight may last until the last message.
        end = min(end, last_landing)
    return BootTime(span.boot, float(end))


def _reports_until(reports: Columns, spans: Segments, end: BootTime) -> Columns:
    """Selects the reports of the autopilot's parameters that hold in a part of a recording: all until its end.

    What an autopilot reported before it restarted still holds afterwards. So the reports of boots before this part are
    included, as if they came at its start.

    Args:
        reports: columns of PARAM_VALUE, in the order of the recording.
        spans: recorded spans of the successive boots of this part, at least one.
        end: the end, in the last of these boots.

    Returns:
        The columns of these reports, with the times and boots of early ones replaced.
    """
    is_of_earlier_boot = reports["boot"] < end.boot
    is_of_last_boot = reports["boot"] == end.boot
    is_until_end = is_of_earlier_boot | (is_of_last_boot & (reports["time"] <= end.time))
    reports_until_end = selected_rows(reports, is_until_end)
    first_span = spans[0]
    is_before_part = reports_until_end["boot"] < first_span.boot
    time = np.where(is_before_part, first_span.start, reports_until_end["time"])
    boot = np.where(is_before_part, first_span.boot, reports_until_end["boot"])
    return {**reports_until_end, "time": time, "boot": boot}
