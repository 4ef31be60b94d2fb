"""The latest flight of a session's recording, cut out so that no flight is judged by the messages of another."""

from dataclasses import replace

import numpy as np

from mavdem.assessment.flights import flights_in_boot
from mavdem.assessment.separate_flights import telemetry_of_spans
from mavdem.assessment.status_texts import SEVERITIES
from mavdem.dataset.segments import recorded_spans
from mavdem.dataset.signals import Signals
from mavdem.ingest.telemetry import Columns, Fields, Log, Telemetry, selected_rows

LASTING_MESSAGES = frozenset({"AUTOPILOT_VERSION", "AVAILABLE_MODES", "PARAM_VALUE"})
"""Messages that an autopilot sends once, on request, and whose content holds until it restarts."""


def log_of_latest_flight(log: Log) -> Log:
    """Returns the part of a recording that shows the latest flight of each vehicle.

    What an autopilot did before it restarted, or another vehicle that had its ids, is not mixed with the latest flight.
    Neither is an earlier flight of the same boot: a motor may have been repaired before the latest one.

    Args:
        log: the recording of a session.

    Returns:
        The log, with one boot of each vehicle: the last in which it left the ground, or the last if it never did. If it
        left the ground several times in that boot, its messages begin half-way between the last two flights, but what
        was stated once for the whole boot is kept. A vehicle with at most one flight in a single boot is left as it is.
    """
    vehicles = []
    for telemetry in log.vehicles:
        vehicles.append(_since_last_landing(_last_flown_boot(telemetry)))
    return replace(log, vehicles=tuple(vehicles))


def _last_flown_boot(telemetry: Telemetry) -> Telemetry:
    """Returns the messages of the last boot in which one vehicle left the ground, with 0 as the number of the boot.

    Args:
        telemetry: messages of the vehicle in all boots. With a single boot they are returned unchanged, and so are
            texts alone. If the vehicle never left the ground, the messages of its last boot are returned.
    """
    signals = Signals(telemetry)
    spans = recorded_spans(signals)
    if not spans or [span.boot for span in spans] == [0]:
        return telemetry
    last_span = spans[-1]
    for span in reversed(spans):
        if flights_in_boot(signals, span.boot):
            last_span = span
            break
    return telemetry_of_spans(signals, [last_span])


def _since_last_landing(telemetry: Telemetry) -> Telemetry:
    """Returns the messages of one vehicle from half-way between its last two flights on.

    What happens soon after a landing, such as the report of a failure, belongs to the flight before. What happens soon
    before a take-off, such as the arming, belongs to the flight after it. ``LASTING_MESSAGES`` are kept, and so are
    texts without a warning from before the first flight, by which an autopilot names its firmware and board.

    Args:
        telemetry: messages of the vehicle in one boot. With fewer than two flights they are returned unchanged.
    """
    boot = 0
    # The same rule separates the flights of a live session.
    flights = flights_in_boot(Signals(telemetry), boot)
    if len(flights) < 2:
        return telemetry
    _, landing_before = flights[-2]
    latest_takeoff, _ = flights[-1]
    start_time = (landing_before + latest_takeoff) / 2
    first_takeoff, _ = flights[0]
    messages = {}
    for name, columns in telemetry.messages.items():
        kept_columns = _columns_since(name, columns, start_time, first_takeoff)
        if len(kept_columns["time"]):
            messages[name] = kept_columns
    return replace(telemetry, messages=messages)


def _columns_since(name: str, columns: Columns, start_time: float, first_takeoff: float) -> Fields:
    """Returns the messages of one type that belong to the latest flight of a boot.

    Args:
        name: name of the message.
        columns: its columns, with ``time``, s of the boot clock.
        start_time: when the messages of the latest flight begin, s.
        first_takeoff: take-off of the first flight of the boot, s.

    Returns:
        Columns of the kept messages, which may have no rows.
    """
    time = columns["time"]
    if name in LASTING_MESSAGES:
        # What was stated earlier still holds, so it gets the start time; the order of the messages stays.
        return {**columns, "time": np.maximum(time, start_time)}
    is_kept = time >= start_time
    if name == "STATUSTEXT":
        # ``SEVERITIES`` lists those that warn, 0 to 4; the numbers above only inform.
        is_information = columns["severity"] >= len(SEVERITIES)
        is_kept |= is_information & (time < first_takeoff)
    return selected_rows(columns, is_kept)
