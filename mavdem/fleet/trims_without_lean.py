"""Trims of a vehicle's motors as they would be without lean, which flights in other winds can be compared by."""

from typing import NamedTuple

from mavdem.arrays import Array
from mavdem.containers import Names
from mavdem.fleet.flights import Flights, log_row
from mavdem.fleet.health_figures import health_figures
from mavdem.motors.deviation import deviations_of_motors, level_balances


class TrimsWithoutLean(NamedTuple):
    """Deviations of k motors from their mean in n flights without the part of lean, as fractions of the mean output."""

    motors: Names
    """Names of the k motors, with their places."""

    flight_indices: tuple[int, ...]
    """Which of the vehicle's flights the n flights are, as indices."""

    estimates: Array
    """(n, k) deviations; positive of a motor that works harder than the mean."""

    half_widths: Array
    """(n, k) half widths of their 90 % intervals."""


def trims_without_lean(flights: Flights) -> TrimsWithoutLean | None:
    """Estimates how much each motor deviates from the mean of all, without the part that the vehicle's lean explains.

    Wind makes a vehicle lean, and the lean needs a torque, so that in wind even sound motors deviate. The motors are
    judged by what remains of the deviations without this part. The effect of lean is estimated from all flights.

    A flight in which a motor failed is left out: the vehicle leans because of the failure, so that the effects of lean
    and failure on the motors cannot be told apart.

    Args:
        flights: rows of the flights of one vehicle, in the order of date. The motors are those of the latest flight
            with a known balance of the motors; flights with another arrangement of motors are left out.

    Returns:
        The deviations in the flights in which they are known; None if there is no such flight.
    """
    figures_of_flights = [health_figures(log_row(flight)) for flight in flights]
    # Figures are missing if the log of a flight does not show how the motors share the work.
    known_figures = [figures for figures in figures_of_flights if figures.missing is None]
    if not known_figures:
        return None
    latest_figures = known_figures[-1]
    # The flights with the same motors, none of which failed, by their index.
    balance_by_flight = {}
    for index, (flight, figures) in enumerate(zip(flights, figures_of_flights, strict=True)):
        is_known = figures.missing is None
        has_same_motors = figures.geometry_key == latest_figures.geometry_key
        has_failed_motor = log_row(flight).failed_motor is not None
        if is_known and has_same_motors and not has_failed_motor:
            balance_by_flight[index] = figures.known_balance
    if not balance_by_flight:
        return None
    # Known figures have signatures: how a weak motor would change the balance.
    assert latest_figures.signatures is not None
    balances_without_lean = level_balances([*balance_by_flight.values()])
    deviations = deviations_of_motors(balances_without_lean, latest_figures.signatures)
    return TrimsWithoutLean(
        latest_figures.motors,
        tuple(balance_by_flight),
        estimates=deviations.estimates,
        half_widths=deviations.half_widths,
    )
