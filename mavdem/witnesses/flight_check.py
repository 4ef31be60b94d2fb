"""Check of whether a vehicle flew, by sensors: height, attitude and body rates, of which two must agree.

On a bench the motors run, the land detector counts throttle as flight, and an estimate without a position fix drifts
by metres. So a boot in which the motors ran counts as flown, or as not flown, only if two sensors agree on it.
"""

from dataclasses import dataclass

import numpy as np

from mavdem.dataset.flight_states import airborne_intervals, min_airborne_collective
from mavdem.dataset.intervals import (
    Intervals,
    in_intervals,
    intersection,
    true_intervals,
    union,
)
from mavdem.dataset.landed_reports import MIN_CERTAIN_RISE
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, moving_average, series_of_boot
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.facts import Facts
from mavdem.facts.witnesses import SensorFact
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.witnesses.height import height_comparison, windowed_mean
from mavdem.witnesses.rotation import rotation_under_power
from mavdem.witnesses.sensor_facts import (
    MIN_SUPPORT,
    contradicting_fact,
    contradicting_facts,
    supporting_fact,
    supporting_facts,
)

MIN_RISE = 1.0
"""Rise, m, of the height that supports a flight. Prop wash raises the barometer as much, so it is not enough alone."""

MAX_LEVEL_RISE = 0.7
"""Rise, m, up to which the height speaks against a flight; barometers at rest stay within 0.3 m for minutes."""

NOISE_RATIO = 4.0
"""Rise of the barometer over its own scatter at rest from which on it is not noise."""

CONTEXT_SECONDS = 3.0
"""Seconds before the motors' power and after it that belong to the flight: there the ground is measured."""

MEAN_SECONDS = 1.0
"""Seconds over which heights are averaged."""

TOP_QUANTILE = 0.95
"""Quantile of the heights under power that is used as the top of a flight, without single damaged samples; a choice."""


@dataclass(frozen=True)
class FlightCheck:
    """Whether a vehicle flew in one boot (a run of the autopilot until it restarts), and the sensors that show it."""

    has_flown: bool | None
    """Whether it flew; None if the sensor facts are too few, or contradict each other."""
    sensor_facts: Facts
    """Facts of sensors that support a flight, and then those that contradict it."""
    had_power: bool = True
    """Whether the motors ever gave the thrust that carries the vehicle."""


@cached_per_vehicle()
def flight_check(signals: Signals, boot: int) -> FlightCheck:
    """Checks by sensors whether a vehicle flew while its motors ran fast enough to carry it.

    Three facts of sensors support or contradict a flight: the rise of the height, whether roll and pitch follow their
    setpoints, and rotation.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        Whether the vehicle flew, None if that is not known, with these facts. If the motors were not recorded or never
        ran, it is not known and there are no facts.
    """
    powered = powered_intervals(signals, boot)
    if not powered:
        return FlightCheck(None, (), had_power=False)
    barometer = height_comparison(signals, boot).barometer
    height_source = "barometer"
    height = barometer
    if height is None:
        # Without a usable barometer, the height is the estimator's, which may drift.
        height_source = "estimate"
        height = series_of_boot(signals.height, boot)
    rise = None
    if height is not None:
        rise = _largest_rise(height, _flown_intervals(signals, boot, powered))
    sensor_facts = (*_rise_facts(rise, height_source), *_rotation_facts(signals, boot))
    support = supporting_facts(sensor_facts)
    contradictions = contradicting_facts(sensor_facts)
    has_flown = _has_flown(
        rise, len(support), len(contradictions), has_barometer=barometer is not None
    )
    return FlightCheck(has_flown, (*support, *contradictions))


def _has_flown(
    rise: float | None, support_count: int, contradiction_count: int, *, has_barometer: bool
) -> bool | None:
    """Decides whether a vehicle flew, by how far it rose and by the number of facts of sensors.

    A rise above ``MIN_CERTAIN_RISE`` is enough for a flight. Otherwise ``MIN_SUPPORT`` facts must agree, for a flight
    as well as against one, and a barometer that stays level rules a flight out.

    Args:
        rise: height gained under power, m; None if it is not known.
        support_count: number of facts that support a flight.
        contradiction_count: number of facts that contradict it.
        has_barometer: whether the rise was measured by a barometer, and not by the autopilot's estimate.

    Returns:
        Whether it flew; None if that is not known.
    """
    is_contradicted = contradiction_count >= MIN_SUPPORT
    is_high = rise is not None and rise > MIN_CERTAIN_RISE
    # An estimate may rise on a bench: two sensors that contradict it are then right.
    if is_high and (has_barometer or not is_contradicted):
        return True
    if is_contradicted:
        return False
    barometer_stayed_level = has_barometer and rise is not None and rise < MAX_LEVEL_RISE
    if support_count >= MIN_SUPPORT and not barometer_stayed_level:
        return True
    return None


def _rise_facts(rise: float | None, source: str) -> Facts:
    """Returns the fact of the height sensor that the vehicle rose, for a flight, or stayed level, against one.

    Args:
        rise: height gained under power, m; None if it is not known.
        source: "barometer" or "estimate".

    Returns:
        One fact; empty if the rise is not known, or is neither large nor small.
    """
    if rise is None:
        return ()
    if rise > MIN_RISE:
        return (supporting_fact(SensorFact.ROSE, source=source, height=rise),)
    if rise < MAX_LEVEL_RISE:
        return (contradicting_fact(SensorFact.STAYED_LEVEL, source=source, height=rise),)
    return ()


def _rotation_facts(signals: Signals, boot: int) -> Facts:
    """Returns the facts of roll, pitch and the body rates for or against a flight.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        At most one fact on how the attitude follows its setpoint, and one if the vehicle did not rotate at all.
    """
    rotation = rotation_under_power(signals, boot)
    if rotation is None:
        return ()
    facts = []
    if rotation.follows_setpoint is True:
        correlation = rotation.correlation
        facts.append(supporting_fact(SensorFact.ATTITUDE_ANSWERED, correlation=correlation))
    elif rotation.follows_setpoint is False:
        error = rotation.median_error
        facts.append(contradicting_fact(SensorFact.ATTITUDE_IGNORED, angle=error))
    if rotation.is_held:
        rate = rotation.largest_rate
        facts.append(contradicting_fact(SensorFact.DID_NOT_ROTATE, body_rate=rate))
    return tuple(facts)


def powered_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals in which the motors of a boot gave enough thrust to fly, s since boot.

    The collective is the mean output of all motors. Its average over 2 s must exceed the lowest one with which a
    vehicle flies (:func:`min_airborne_collective`).

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        Intervals. Empty if motor outputs were not recorded, or the vehicle is not a multirotor, whose motors need not
        carry it.
    """
    collective = series_of_boot(signals.collective, boot)
    if collective is None or signals.telemetry.vehicle not in POSSIBLE_MULTIROTORS:
        return []
    min_collective = min_airborne_collective(signals.telemetry.parameters)
    return true_intervals(collective.time, moving_average(collective) > min_collective)


def _flown_intervals(signals: Signals, boot: int, powered: Intervals) -> Intervals:
    """Returns the intervals in which a vehicle may have flown: with enough thrust, and what is reported around them.

    A light vehicle may need so little thrust that its motors exceed the limit of :func:`powered_intervals` only in
    short climbs, which show only a small part of its rise. So an interval that the autopilot or the estimate reports as
    flight is added if it overlaps one of those.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        powered: the intervals in it with enough thrust to fly, s since boot.

    Returns:
        Intervals, s since boot.
    """
    reported_as_flight = []
    for interval in airborne_intervals(signals, boot):
        if intersection([interval], powered):
            reported_as_flight.append(interval)
    return union(powered, reported_as_flight)


def _largest_rise(height: TimeSeries, flown: Intervals) -> float | None:
    """Returns the height by which the vehicle rose above the ground while its motors could carry it.

    The ground is the lower of the heights ``CONTEXT_SECONDS`` before and after the time under power: a log may have
    only the take-off or only the landing, and then the other end is in the air. The top is the 95th percentile of the
    height under power, so that single damaged samples have no effect.

    Args:
        height: (N,) height, m, in one boot.
        flown: intervals of :func:`_flown_intervals`, s since boot.

    Returns:
        Largest rise of all intervals, m, at least 0; None without samples under power.
    """
    mean_height = windowed_mean(height.time, height.values, MEAN_SECONDS)
    rises = []
    for start, end in flown:
        is_under_power = in_intervals(height.time, [(start, end)])
        if not is_under_power.any():
            continue
        wider_interval = (start - CONTEXT_SECONDS, end + CONTEXT_SECONDS)
        heights_around = mean_height[in_intervals(height.time, [wider_interval])]
        ground = min(heights_around[0], heights_around[-1])
        top = np.quantile(mean_height[is_under_power], TOP_QUANTILE)
        rises.append(max(float(top - ground), 0.0))
    return max(rises, default=None)
