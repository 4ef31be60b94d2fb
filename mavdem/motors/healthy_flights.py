"""Flights of one vehicle with the figures by which its motors are judged, and which of them can be compared."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from math import inf

import numpy as np

from mavdem.containers import Names
from mavdem.facts import Fact
from mavdem.facts.motors import HealthUnknown
from mavdem.motors.motor_balance import MotorBalance
from mavdem.motors.signatures import MotorSignatures

MIN_HEALTHY_FLIGHTS = 2
"""Number of healthy flights that show that nothing changed: a single one does not show how much they differ."""

MIN_BASELINE_FLIGHTS = 1
"""Number of healthy flights from which on a weak motor or another change is found.

How much flights differ is then the prior alone, if need be, which does not show that nothing changed.
"""

GEOMETRY_DECIMALS = 6
"""Decimals to which the mixers of two flights must agree."""


@dataclass(frozen=True, eq=False)
class HealthFigures:
    """Measurements of one flight of a vehicle by which the health of its motors is judged."""

    name: str
    """Name of the flight."""
    motors: Names = ()
    """Names of the motors."""
    signatures: MotorSignatures | None = None
    """Mixer of the vehicle; None where its motors are not known."""
    balance: MotorBalance | None = None
    """Balance of the motors; None where steady flight was too short or was not recorded."""
    date: datetime | None = None
    """When the flight began; None where it is not known."""
    collective: float | None = None
    """Mean command of all motors, as a fraction of the range."""
    voltage: float | None = None
    """Mean voltage of the battery, V."""
    sound: bool = True
    """Whether it may be taken for healthy: no motor at its limit, no oscillation, no fault."""
    suspected_motor: int | None = None
    """Number of the motor that its own log blames or warns of, from 1; None without one."""
    was_lost: bool = False
    """Whether the vehicle was lost in this flight, as in a crash."""

    @property
    def missing(self) -> Fact | None:
        """Which quantity is missing to judge the motors, as a fact (a code with figures); None if all are there.

        Needed are the balance (torque of the motors' commands relative to thrust), a motor geometry in which a weak
        motor can be identified, and the mean lean in flight, since wind changes the balance too.
        """
        if self.signatures is None or self.balance is None:
            return Fact(HealthUnknown.BALANCE_UNKNOWN)
        if not self.signatures.is_motor_identifiable:
            return Fact(HealthUnknown.GEOMETRY_UNKNOWN)
        needed_figures = (self.balance.mean, self.balance.error, self.balance.lean)
        if not all(np.isfinite(values).all() for values in needed_figures):
            return Fact(HealthUnknown.LEAN_UNKNOWN)
        return None

    @property
    def known_balance(self) -> MotorBalance:
        """Balance of a flight that lacks nothing (``missing``)."""
        assert self.balance is not None
        return self.balance

    @property
    def geometry_key(self) -> tuple[Names, bytes]:
        """Names and mixer of the motors, as a key: only flights with equal keys have comparable balances.

        The mixer is rounded to ``GEOMETRY_DECIMALS``, and empty if it is not known.
        """
        if self.signatures is None:
            return self.motors, b""
        return self.motors, self.signatures.mixer_rows.round(GEOMETRY_DECIMALS).tobytes()

    @property
    def start_time(self) -> float:
        """UNIX time, s, at which the flight began; infinite where it is not known, so that such flights sort last."""
        if self.date is None:
            return inf
        return self.date.timestamp()

    @property
    def effort(self) -> float | None:
        """Collective (mean motor output, 0 to 1) times battery voltage, V.

        It grows with the payload, but does not change as the battery sags. None if one of the two is not known.
        """
        if self.collective and self.voltage:
            return self.collective * self.voltage
        return None

    def overlaps(self, other: HealthFigures) -> bool:
        """Returns whether two records are of one flight, logged twice: one begins before the other has ended.

        The duration of the earlier flight is taken to be the duration of its steady flight, since only this is known;
        it is 0 without a balance.

        Args:
            other: The other record, of the same vehicle.
        """
        earlier_flight, later_flight = self, other
        if other.start_time < self.start_time:
            earlier_flight, later_flight = other, self
        if earlier_flight.balance is None:
            seconds = 0.0
        else:
            seconds = earlier_flight.balance.seconds
        return later_flight.start_time - earlier_flight.start_time < seconds


HealthFlights = Sequence[HealthFigures]
"""Flights of one vehicle."""


def is_comparable(flight: HealthFigures, healthy_flight: HealthFigures) -> bool:
    """Returns whether a flight's motors are compared with a healthy flight: another one, with the same motors.

    Args:
        flight: A flight of the vehicle.
        healthy_flight: One of its healthy flights.
    """
    has_same_motors = healthy_flight.geometry_key == flight.geometry_key
    return has_same_motors and not is_same_flight(flight, healthy_flight)


def is_same_flight(flight: HealthFigures, other: HealthFigures) -> bool:
    """Returns whether two records are the same one, or two of one flight: these overlap in time."""
    return other is flight or other.overlaps(flight)


def distinct_flights(flights: HealthFlights) -> list[HealthFigures]:
    """Removes second records of a flight that was logged twice, for example on board and on the ground.

    Of two records of one flight, the one whose balance has the smaller error is kept.

    Args:
        flights: Flights of one vehicle, with known balances.

    Returns:
        The flights that are kept, in the given order.
    """

    def balance_error(flight: HealthFigures) -> float:
        """Returns the standard error of a flight's balance: the root sum of squares over roll, pitch and yaw."""
        return float(np.linalg.norm(flight.known_balance.error))

    # Sorted by start. They do not overlap each other, so that only the one before and the one after may overlap a
    # further one.
    kept_flights: list[HealthFigures] = []
    for flight in sorted(flights, key=balance_error):
        index = bisect_left(kept_flights, flight.start_time, key=lambda kept: kept.start_time)
        neighbours = kept_flights[max(index - 1, 0) : index + 1]
        is_second_record = any(flight.overlaps(neighbour) for neighbour in neighbours)
        if not is_second_record:
            kept_flights.insert(index, flight)
    # The class compares records by identity, so that two equal ones are not confused.
    kept_set = set(kept_flights)
    return [flight for flight in flights if flight in kept_set]
