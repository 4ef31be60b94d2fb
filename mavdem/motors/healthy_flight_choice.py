"""Choice of the healthy flights of a vehicle, with which its other flights are compared.

The user may name them. Otherwise they are the vehicle's first flights, before motors and propellers wore. Wear and
damage do not heal by themselves, so the choice ends at the first flight in which something changed. A later flight that
looks sound may have the same damage, just too small to be found: it would hide the damage of all others.
"""

from __future__ import annotations

from collections.abc import Sequence

from mavdem.containers import group_by
from mavdem.motors.flight_evidence import MIN_REPORTED_PROBABILITY, flight_evidence
from mavdem.motors.healthy_flights import HealthFigures, HealthFlights, distinct_flights

DEFAULT_HEALTHY_FLIGHTS = 3
"""Number of first flights, at most, that are taken for healthy ones where none are named; a choice."""


def named_healthy_flights(baseline: HealthFlights) -> HealthFlights:
    """Returns the flights that the user named as healthy, each once, without those whose motors cannot be judged."""
    return distinct_flights([flight for flight in baseline if not flight.missing])


def first_healthy_flights(flights: HealthFlights) -> HealthFlights:
    """Returns the flights that are taken for healthy where the user has named none.

    They are chosen for each motor geometry by itself (:func:`_first_unchanged_flights`). A flight without a date is not
    chosen, since it may be from after the damage.

    Args:
        flights: All flights of one vehicle.

    Returns:
        Some of these flights, the same objects; of two records of one flight the more precise one.
    """
    dated_flights = [flight for flight in flights if flight.date is not None]
    dated_flights.sort(key=lambda flight: flight.start_time)
    flights_by_geometry = group_by(dated_flights, lambda flight: flight.geometry_key)
    healthy: list[HealthFigures] = []
    for flights_of_geometry in flights_by_geometry.values():
        healthy += _first_unchanged_flights(flights_of_geometry)
    return tuple(healthy)


def _first_unchanged_flights(flights: Sequence[HealthFigures]) -> list[HealthFigures]:
    """Returns the first sound flights of a vehicle, up to the first flight that shows a change of its motors.

    A change for the better is a repair: if a motor was weak in the flights before it, the choice begins again there.

    A payload that raises the effort alone does not end the choice too early: the effort is compared with two healthy
    flights or more, and two suffice.

    Args:
        flights: Flights with the same motor geometry, in the order of their dates.

    Returns:
        At most ``DEFAULT_HEALTHY_FLIGHTS`` of these flights. Which of the first flights were damaged is not known: if
        all were alike, they are taken for healthy.
    """
    sound_flights = [flight for flight in flights if flight.sound and not flight.missing]
    usable_flights = set(distinct_flights(sound_flights))
    healthy: list[HealthFigures] = []
    for flight in flights:
        if healthy and _is_newly_suspect(flight, healthy[-1]):
            break
        if flight not in usable_flights:
            continue
        if healthy and _was_weak_motor_repaired(healthy[-1], flight):
            healthy.clear()
        elif healthy and flight_evidence(flight, healthy).is_changed:
            break
        healthy.append(flight)
        if len(healthy) == DEFAULT_HEALTHY_FLIGHTS:
            break
    return healthy


def _is_newly_suspect(flight: HealthFigures, healthy_flight: HealthFigures) -> bool:
    """Returns whether a flight's own log shows damage that the flights before did not have.

    It does if the vehicle was lost, or if the log suspects a motor. A motor that the log of the healthy flight suspects
    too does not count: the load may lie towards it in all flights.

    Args:
        flight: The flight.
        healthy_flight: The latest healthy flight before it.
    """
    suspects_motor = flight.suspected_motor is not None
    is_same_motor = flight.suspected_motor == healthy_flight.suspected_motor
    return flight.was_lost or (suspects_motor and not is_same_motor)


def _was_weak_motor_repaired(earlier_flight: HealthFigures, later_flight: HealthFigures) -> bool:
    """Returns whether a motor was weak in the earlier of two flights, and no longer is in the later one.

    The flights differ alike in roll and pitch if one motor of a quadrotor was repaired, or if the opposite one became
    weak. Yaw tells both apart, since opposite motors turn in the same direction. So each flight is judged against the
    other, and the one with the more probable fault is the one with the weak motor.

    Args:
        earlier_flight: The earlier flight.
        later_flight: The later flight, with the same motor geometry.
    """
    earlier_evidence = flight_evidence(earlier_flight, [later_flight])
    later_evidence = flight_evidence(later_flight, [earlier_flight])
    earlier_fault_probability = earlier_evidence.change.fault_probability
    later_fault_probability = later_evidence.change.fault_probability
    is_fault_probable = earlier_fault_probability >= MIN_REPORTED_PROBABILITY
    return is_fault_probable and earlier_fault_probability > later_fault_probability
