"""Restarts of the autopilot: on the ground between flights, or in the air.

An autopilot that restarts in the air begins its clock anew while it flies or falls. ArduPilot then logs why its
watchdog restarted it ("WDG: …"), and reports the internal error 0x800 (``AP_InternalError::error_t::watchdog_reset``).
A restart without the watchdog is one of the supply: a brown-out.

Source: https://ardupilot.org/copter/docs/common-watchdog.html.
"""

import re
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mavdem.assessment.flights import flights_in_boot
from mavdem.assessment.status_texts import StatusText, status_texts
from mavdem.containers import Names
from mavdem.dataset.flight_states import armed_intervals
from mavdem.dataset.intervals import intersection
from mavdem.dataset.segments import Segment
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, series_of_boot
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.facts import Fact
from mavdem.facts.events import ReportedEvent
from mavdem.ingest.joined import MAX_BOOT_CLOCK
from mavdem.witnesses.accelerometer import rest_intervals, still_windows

FALL_SECONDS = 10.0
"""Duration from the beginning, s, in which the fall after a restart is sought: one from 400 m takes as long."""

MIN_FALL_HEIGHT = 3.0
"""Height, m, by which a vehicle falls at least that has reported a watchdog reset: a choice."""

MIN_UNREPORTED_FALL_HEIGHT = 10.0
"""Height, m, by which it falls at least if nothing reports the reset.

A choice: the estimated height may run away by some metres while the estimator starts.
"""

MIN_FALL_SPEED = 3.0
"""Speed downward, m/s, that must agree with the height: a choice, more than a descent in flight."""

MAX_HEIGHT_AT_REST = 1.0
"""Range of the height after an impact, m: what the estimate still moves on the ground. A choice."""

MIN_REST_SECONDS = 1.0
"""Time, s, for which the vehicle rests at least after an impact: a choice, longer than a bounce."""

MAX_STOP_SECONDS = 0.5
"""Time, s, before an impact within which the vehicle still falls: the estimate and its log are no faster. A choice."""

MIN_IMPACT_SPEED = 3.0
"""Speed downward, m/s, shortly before an impact: a choice, more than that of a hard landing."""

MIN_FALL_TILT = np.deg2rad(60)
"""Roll or pitch, rad, that shows the fall where nothing reports the reset: a choice, not met on the ground."""

MAX_LATE_TAKE_OFF = 3.0
"""Time from the beginning, s, within which motors that run were never stopped: a choice; arming takes longer."""

MAX_DELAY_IN_FLIGHT = 2.0
"""Time, s, between the last message in flight and the start of the autopilot's clock in which nobody lands.

A choice: more than the interval of HEARTBEATs, 1 s, and less than to land, disarm and switch the supply off and on.
"""

_WATCHDOG_TEXT = re.compile(r"^WDG: T-?\d|watchdog reset", re.IGNORECASE)
"""Texts that report a watchdog reset in words."""

_INTERNAL_ERROR_TEXT = re.compile(r"internal errors?\W+0x([0-9a-f]+)\b", re.IGNORECASE)
"""Texts that report internal errors; the group is the mask of the errors, in hexadecimal."""

WATCHDOG_ERROR = 0x800
"""Bit of ArduPilot's internal errors that means a watchdog reset."""


class FallAtStart(NamedTuple):
    """A fall at the beginning of a boot (a run of the autopilot): how far, and when it hit the ground."""

    descent: float
    """Height from the highest to the lowest point thereafter, m."""

    impact: float | None
    """When the vehicle hit the ground, s; None if it did not within ``FALL_SECONDS``, or did not rest then."""


def restarts(signals: Signals, recorded_span: Segment) -> Iterator[Fact]:
    """Yields an event if the autopilot restarted before one boot of a log.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        recorded_span: recorded time of the boot.

    Yields:
        At most one fact, with the figures of :func:`mavdem.assessment.reported.reported_events`. The fact of a restart
        in flight also has ``watchdog``, whether the watchdog caused it; ``descent``, how far the vehicle fell then, m;
        and ``impact``, when it hit the ground, s since boot. The last two are None without a fall, or if not known.
    """
    is_watchdog = _reports_watchdog(signals, recorded_span)
    fall = _fall_at_start(signals, recorded_span)
    attitude_name = signals.telemetry.name_in_source("ATTITUDE")
    if _is_restart_in_flight(signals, recorded_span, fall, is_watchdog=is_watchdog):
        basis: Names = (attitude_name,)
        if is_watchdog:
            basis = (signals.telemetry.name_in_source("STATUSTEXT"), attitude_name)
        # A smaller loss of height may be an error of the estimator, which has just started.
        has_fallen = fall is not None and fall.descent >= MIN_FALL_HEIGHT
        yield Fact(
            ReportedEvent.RESTARTED_IN_FLIGHT,
            time=recorded_span.start,
            boot=recorded_span.boot,
            basis=basis,
            watchdog=is_watchdog,
            descent=fall.descent if fall is not None and has_fallen else None,
            impact=fall.impact if fall is not None and has_fallen else None,
        )
    elif recorded_span.boot > 0:
        # The first boot of a log (number 0) is no restart unless it begins in flight.
        yield Fact(
            ReportedEvent.RESTARTED,
            time=recorded_span.start,
            boot=recorded_span.boot,
            basis=(attitude_name,),
        )


def _is_restart_in_flight(
    signals: Signals, recorded_span: Segment, fall: FallAtStart | None, *, is_watchdog: bool
) -> bool:
    """Returns whether the vehicle was in the air when the autopilot started at the beginning of a boot.

    The more shows that it flew before, the less is required of its motion afterwards:

    - The boot before ended in the air, and the autopilot started too soon for a landing in between: nothing more.
    - The boot before ended in the air, or the watchdog caused the restart: a fall, or another sign of flight.
    - Neither: a deep fall while the vehicle tumbles, soon after the autopilot started.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        recorded_span: recorded time of the boot, s since boot.
        fall: the fall of the vehicle at the beginning of the boot; None if its height shows none.
        is_watchdog: whether the autopilot reports that its watchdog caused the restart.
    """
    was_in_air_before = recorded_span.boot > 0 and _ends_in_air(signals, recorded_span.boot - 1)
    # Seconds from the last message of the boot before to the start of this one, infinite if not known.
    restart_delay = signals.telemetry.restart_delays.get(recorded_span.boot, np.inf)
    if was_in_air_before and abs(restart_delay) <= MAX_DELAY_IN_FLIGHT:
        return True
    descent = 0.0 if fall is None else fall.descent
    if was_in_air_before or is_watchdog:
        return descent >= MIN_FALL_HEIGHT or _begins_in_flight(signals, recorded_span)
    # A log that begins long after the autopilot has started does not show its restart.
    begins_with_start = recorded_span.start <= MAX_BOOT_CLOCK
    has_fallen_far = descent >= MIN_UNREPORTED_FALL_HEIGHT
    return begins_with_start and has_fallen_far and _tilts_far_at_start(signals, recorded_span)


def _reports_watchdog(signals: Signals, recorded_span: Segment) -> bool:
    """Returns whether the autopilot reports, in the first ``MAX_BOOT_CLOCK`` of a boot, that its watchdog reset it.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        recorded_span: recorded time of the boot.
    """
    latest_time = recorded_span.start + MAX_BOOT_CLOCK
    return any(
        message.boot == recorded_span.boot and message.time <= latest_time
        for message in _watchdog_texts(signals)
    )


@cached_per_vehicle()
def _watchdog_texts(signals: Signals) -> tuple[StatusText, ...]:
    """Returns the texts of all boots that report a watchdog reset; a log may have hundreds of boots.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
    """
    texts = status_texts(signals.telemetry)
    return tuple(text for text in texts if _is_watchdog_text(text))


def _is_watchdog_text(message: StatusText) -> bool:
    """Returns whether a text reports a watchdog reset, in words or by its bit in the mask of internal errors."""
    if _WATCHDOG_TEXT.search(message.text):
        return True
    error_mask = _INTERNAL_ERROR_TEXT.search(message.text)
    return error_mask is not None and bool(int(error_mask[1], 16) & WATCHDOG_ERROR)


def _ends_in_air(signals: Signals, boot: int) -> bool:
    """Returns whether the record of a boot ends in flight."""
    flights = flights_in_boot(signals, boot)
    if not flights:
        return False
    _, last_landing = flights[-1]
    return last_landing == np.inf


def _begins_in_flight(signals: Signals, recorded_span: Segment) -> bool:
    """Returns whether the motors are armed and the vehicle flies from the beginning of a boot on.

    It does if it flies at the first moment that shows it. An autopilot that restarts in the air may also report for a
    moment that it is disarmed or on the ground. So both may begin within ``MAX_LATE_TAKE_OFF``, if the body rates show
    that the vehicle did not rest before, still and without power: a recording may begin on the ground, shortly before a
    take-off. Without body rates that is not known, and the boot does not count as begun in flight.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        recorded_span: recorded time of the boot.
    """
    armed_spans = armed_intervals(signals, recorded_span.boot)
    flights = flights_in_boot(signals, recorded_span.boot)
    if not armed_spans or not flights:
        return False
    first_arming, _ = armed_spans[0]
    first_take_off, _ = flights[0]
    if first_take_off == -np.inf:
        return True
    if still_windows(signals, recorded_span.boot) is None:
        return False
    before_take_off = [(-np.inf, first_take_off)]
    rests_before_take_off = intersection(
        rest_intervals(signals, recorded_span.boot), before_take_off
    )
    if rests_before_take_off:
        return False
    latest_time = recorded_span.start + MAX_LATE_TAKE_OFF
    return first_arming <= latest_time and first_take_off <= latest_time


def _fall_at_start(signals: Signals, recorded_span: Segment) -> FallAtStart | None:
    """Returns the fall of the vehicle at the beginning of a boot, if height and vertical speed agree on it.

    A vehicle whose autopilot restarts in the air falls. It hit the ground if it was fast until ``MAX_STOP_SECONDS``
    before the end of the fall, and the height is constant from then on.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        recorded_span: recorded time of the boot.

    Returns:
        The fall within ``FALL_SECONDS``; None if height or speed was not recorded, or the speed does not reach
        ``MIN_FALL_SPEED``.
    """
    height = series_of_boot(signals.height, recorded_span.boot)
    climb_rate = series_of_boot(signals.climb_rate, recorded_span.boot)
    if height is None or climb_rate is None:
        return None
    searched_interval = (-np.inf, recorded_span.start + FALL_SECONDS)
    height = height.within(searched_interval)
    climb_rate = climb_rate.within(searched_interval)
    if not len(height.time) or not len(climb_rate.time):
        return None
    if climb_rate.values.min() > -MIN_FALL_SPEED:
        return None
    # How far the vehicle is below the highest point so far, m, at each sample.
    drops = np.maximum.accumulate(height.values) - height.values
    descent = float(drops.max())
    # The fall ended at the first sample near the lowest point.
    last_sample_of_fall = int(np.argmax(drops >= descent - MAX_HEIGHT_AT_REST))
    fall_end = float(height.time[last_sample_of_fall])
    rests_after_fall = _is_at_rest(height.select(slice(last_sample_of_fall, None)))
    before_fall_end = climb_rate.within((fall_end - MAX_STOP_SECONDS, fall_end))
    was_fast = (before_fall_end.values <= -MIN_IMPACT_SPEED).any()
    return FallAtStart(descent, impact=fall_end if rests_after_fall and was_fast else None)


def _is_at_rest(height: TimeSeries) -> bool:
    """Returns whether a height stays constant, up to ``MAX_HEIGHT_AT_REST``, for at least ``MIN_REST_SECONDS``.

    Args:
        height: (N,) heights, m, at least one.
    """
    duration = height.time[-1] - height.time[0]
    height_range = np.ptp(height.values)
    return bool(height_range <= MAX_HEIGHT_AT_REST and duration >= MIN_REST_SECONDS)


def _tilts_far_at_start(signals: Signals, recorded_span: Segment) -> bool:
    """Returns whether roll or pitch exceeds ``MIN_FALL_TILT`` in the first ``FALL_SECONDS`` of a boot, as in a tumble.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        recorded_span: recorded time of the boot.
    """
    end_time = recorded_span.start + FALL_SECONDS
    for tilt in signals.tilts:
        is_at_start = (tilt.boot == recorded_span.boot) & (tilt.time <= end_time)
        if (abs(tilt.angle[is_at_start]) > MIN_FALL_TILT).any():
            return True
    return False
