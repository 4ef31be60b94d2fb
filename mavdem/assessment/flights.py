"""The flights of a log, their settled parts, and when the loss of one began."""

from collections.abc import Callable

from mavdem.dataset import phases
from mavdem.dataset.flight_states import airborne_intervals, armed_intervals
from mavdem.dataset.grounded import without_grounded
from mavdem.dataset.intervals import Intervals, intersection, merge_close_intervals
from mavdem.dataset.segments import Segment, Segments, recorded_spans, settled_segments
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.witnesses import sensor_trust

RECOVERY_SECONDS = 5.0
"""Seconds of flight after which a loss of attitude counts as recovered; a fall from 100 m takes as long.

Events of one kind that follow each other within this time are one event.
"""

MIN_DISARMED_SECONDS = 2.0
"""Seconds for which a vehicle must be disarmed to have landed: a choice, more than one heartbeat that may be wrong."""

MIN_FLIGHT_SECONDS = 1.0
"""Shortest time off the ground, s, that is listed as a flight: a land detector may be wrong for a moment. A choice."""


def settled_flight(signals: Signals) -> Segments:
    """Returns the parts of a log in which a multirotor flies settled: off the ground, and not in a manoeuvre or fall.

    The attitude is recorded in all of them, and the motor outputs too, unless the log has none.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        Segments in the order of boot and time; none for a vehicle that is not a multirotor.
    """
    if signals.telemetry.vehicle not in POSSIBLE_MULTIROTORS:
        return ()
    if signals.motors is not None:
        return tuple(sorted(settled_segments(signals)))
    return segments_of_boots(signals, phases.settled_intervals)


def segments_of_boots(
    signals: Signals, intervals_of_boot: Callable[[Signals, int], Intervals]
) -> Segments:
    """Collects the intervals of every boot as segments, as far as anything was recorded.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        intervals_of_boot: a function that takes the signals and the number of a boot, and returns intervals of it, s,
            such as :func:`flights_in_boot`.

    Returns:
        The segments, in order of boot and time.
    """
    segments = []
    for recorded_span in recorded_spans(signals):
        recorded_interval = [(recorded_span.start, recorded_span.end)]
        for start, end in intersection(
            recorded_interval, intervals_of_boot(signals, recorded_span.boot)
        ):
            segments.append(Segment(recorded_span.boot, start, end))
    return tuple(segments)


def total_duration(segments: Segments) -> float:
    """Returns the sum of the durations of segments, s."""
    return float(sum(segment.duration for segment in segments))


def flights_in_boot(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of a boot in which the vehicle is off the ground.

    A pause of less than ``RECOVERY_SECONDS`` is not a landing: a land detector may be mistaken in the air. But a
    vehicle that was disarmed meanwhile, for at least ``MIN_DISARMED_SECONDS``, has landed.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot, from 0.

    Returns:
        Start and end of each flight, s since boot; infinite if the record begins or ends in the air.
    """
    airborne = airborne_intervals(signals, boot)
    flights: Intervals = []
    for armed in merge_close_intervals(armed_intervals(signals, boot), MIN_DISARMED_SECONDS):
        flights += merge_close_intervals(intersection(airborne, [armed]), RECOVERY_SECONDS)
    return flights


def flights_off_ground(signals: Signals, boot: int) -> Intervals:
    """Returns the flights of a boot in which the vehicle left the ground for at least ``MIN_FLIGHT_SECONDS``.

    The land detector of a vehicle whose motors are tested reports flights as well. Of the intervals of
    :func:`flights_in_boot`, those are left out in which the ground carried or held the vehicle almost all the time, and
    all of them if the sensors show that the vehicle did not fly in this boot.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot, from 0.

    Returns:
        Start and end of each flight, s since boot; infinite if the record begins or ends in the air.
    """
    if _never_flew(signals, boot):
        return []
    flights = []
    for flight in flights_in_boot(signals, boot):
        intervals_in_air = without_grounded([flight], signals, boot)
        seconds_in_air = sum(end - start for start, end in intervals_in_air)
        if seconds_in_air >= MIN_FLIGHT_SECONDS:
            flights.append(flight)
    return flights


def _never_flew(signals: Signals, boot: int) -> bool:
    """Returns whether the sensors show that a multirotor did not fly in a boot; False if they do not show it.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot, from 0.
    """
    is_multirotor = signals.telemetry.vehicle in POSSIBLE_MULTIROTORS
    has_attitude = bool(signals.tilts) and boot in signals.tilts[0].boot
    return is_multirotor and has_attitude and sensor_trust(signals, boot).flew is False


def loss_onset(loss: Fact) -> float | None:
    """Returns the time at which the loss of a vehicle began.

    It is the time of the event, unless that is an impact of a vehicle that lost its attitude before: such a fact has
    the time of that loss as its figure ``onset``.

    Args:
        loss: event with which the vehicle was lost.

    Returns:
        The time, s since boot; None if it is not known.
    """
    onset: float | None = loss.figures.get("onset", loss.time)
    return onset
