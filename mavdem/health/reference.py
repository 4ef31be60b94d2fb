"""The healthy reference: the balance of a vehicle's healthy flights, and how much healthy flights differ.

Few vehicles have more than a handful of healthy flights on record, so their scatter is estimated with a prior, and
verdicts are as cautious as few flights make them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import NamedTuple

import numpy as np
from scipy import stats

from mavdem.confidence import quantile
from mavdem.dem.engine.linalg import Array
from mavdem.health.balance import BalanceFigures, MotorSignatures

FEWEST_FLIGHTS = 2  # Of healthy ones: one alone does not show how much they differ

SCATTER = np.array([0.010, 0.010, 0.008])
"""Standard deviation of the level balance over healthy flights, before any was seen, in shares of the mean command. A
battery 3 mm off on arms of 160 mm shifts 2 % of the thrust from one side to the other; commands go with its root or a
little more slowly. An arm twisted by 1° gives about 3 % in yaw, and a quarter of that is taken for usual."""
SCATTER_FREEDOM = 6.0  # So many healthy flights that knowledge is worth

LEAN_EFFECT = np.array([[1.0, 0.3], [0.3, 1.0], [0.3, 0.3]])
"""Standard deviation of the effects of lean, 1/rad, before any flight: drag an arm's length above or below the centre
of mass in roll and pitch; in yaw, and across, a load 5 mm beside it."""
LEAN_EFFECT_SCATTER, LEAN_EFFECT_FREEDOM = 0.2, 1.0
"""Standard deviation of the same over flights of one vehicle, 1/rad, before any flight, and how many flights that is
worth: loads differ, and where a vehicle manoeuvres it also leans without wind."""


@dataclass(frozen=True, eq=False)
class HealthFigures:
    """One flight of a vehicle, as far as its health is judged by it."""

    name: str  # of the flight
    motors: tuple[str, ...] = ()  # names of the motors
    signatures: MotorSignatures | None = None  # of the motors; None where the motors are not known
    balance: BalanceFigures | None = None  # None where it was too short or the log holds none
    date: datetime | None = None  # when it began
    collective: float | None = None  # mean command of all motors, as a share of the range
    voltage: float | None = None  # mean of the battery, V
    sound: bool = True  # no motor was at its limit, and it did not oscillate: it may be taken for healthy

    @property
    def missing(self) -> str:
        """What the judgement of a motor needs and the flight does not have; empty if it has all."""
        if self.signatures is None or self.balance is None:
            return "there is too little settled flight with attitude and motor outputs"
        if not self.signatures.names_a_motor:
            return "where its motors are, or which way they turn, is not known"
        if not all(np.isfinite(values).all() for values in self.balance[:3]):
            return "its lean was not recorded"
        return ""

    @property
    def layout(self) -> tuple[tuple[str, ...], bytes]:
        """The motors' names, places and spins: only flights that agree in them have comparable balances."""
        return self.motors, b"" if self.signatures is None else self.signatures.weights.round(6).tobytes()

    def overlaps(self, other: HealthFigures) -> bool:
        """Whether both are one flight, logged twice: a vehicle that began to fly has not landed as the other begins."""
        if self.date is None or other.date is None or self.balance is None or other.balance is None:
            return False
        first = min(self, other, key=lambda flight: flight.when)
        return abs(self.when - other.when) < _balance(first).seconds

    @property
    def when(self) -> float:
        """By which flights are sorted: UNIX s, those without a date last."""
        return np.inf if self.date is None else self.date.timestamp()

    @property
    def effort(self) -> float | None:
        """The collective at a battery of 1 V: it grows with the payload, and not as the battery sags."""
        return self.collective * self.voltage if self.collective and self.voltage else None


HealthFlights = Sequence[HealthFigures]  # Of one vehicle


class Deviation(NamedTuple):
    """How far a flight's level balance is from that of healthy flights."""

    change: Array  # (3,) in roll, pitch and yaw, in shares of the mean command
    scale: Array  # (3,) by which that of a healthy flight is Student-distributed about the healthy flights' true mean
    freedom: float  # degrees of freedom of that
    centre_error: Array  # (3,) standard error of the mean of the healthy flights; all flights share it
    lean: float = 0.0  # of the flight, from level, rad

    @property
    def usual(self) -> Array:
        """(3,) half widths of the interval of 90 % of healthy flights' deviations."""
        return np.asarray(quantile() * np.hypot(self.scale, self.centre_error))

    @property
    def beyond(self) -> bool:
        """Whether it is farther off on some axis than 999 healthy flights in 1000 are."""
        far = stats.t.ppf((1 + 0.999) / 2, self.freedom) * np.hypot(self.scale, self.centre_error)
        return bool((np.abs(self.change) > far).any())


def healthy_flights(flights: HealthFlights, baseline: HealthFlights | None = None) -> HealthFlights:
    """Those to compare with: of the ``baseline``, or else the first three sound dated ones of each layout."""
    if baseline is not None:
        return distinct_flights([flight for flight in baseline if not flight.missing])
    usable = [flight for flight in flights if flight.sound and flight.date is not None and not flight.missing]
    dated = distinct_flights(usable)
    first: dict[object, list[HealthFigures]] = {}
    for flight in sorted(dated, key=lambda flight: flight.when):
        first.setdefault(flight.layout, []).append(flight)
    return tuple(flight for same in first.values() for flight in same[:3])


def distinct_flights(flights: HealthFlights) -> list[HealthFigures]:
    """Each flight once, though it was logged twice, as on board and on the ground: with the surer balance."""
    kept: list[HealthFigures] = []
    for flight in sorted(flights, key=lambda flight: float(np.linalg.norm(_balance(flight).error))):
        if not any(flight.overlaps(other) for other in kept):
            kept.append(flight)
    return [flight for flight in flights if flight in kept]


def deviation(flight: HealthFigures, healthy: HealthFlights) -> Deviation:
    """How far a flight is from ``healthy`` ones, of which it is none; all have what :attr:`HealthFigures.missing` asks.

    The flights are compared level, by the effect of lean that they show themselves. What is left follows Student's
    distribution, by the healthy flights' scatter and its prior; to its scale come the errors of the effects of lean
    and of the flight's own mean.
    """
    balances = [_balance(other) for other in (flight, *healthy)]
    effect, variance = _lean_effects(balances)
    lean = np.array([balance.lean for balance in balances])
    level = np.array([balance.mean for balance in balances]) - np.einsum("fal,fl->fa", effect, lean)
    error = np.einsum("fal,fl->fa", variance, lean**2) + np.array([balance.error for balance in balances]) ** 2
    centre, count = level[1:].mean(axis=0), len(healthy)
    freedom = SCATTER_FREEDOM + count - 1
    scatter = (SCATTER_FREEDOM * SCATTER**2 + ((level[1:] - centre) ** 2).sum(axis=0)) / freedom
    centre_error = np.sqrt((scatter + error[1:].mean(axis=0)) / count)
    leaned = float(np.linalg.norm(lean[0]))
    return Deviation(level[0] - centre, np.sqrt(scatter + error[0]), freedom, centre_error, leaned)


def _balance(flight: HealthFigures) -> BalanceFigures:
    assert flight.balance is not None
    return flight.balance


def _lean_effects(flights: Sequence[BalanceFigures]) -> tuple[Array, Array]:
    """(f, 3, 2) the effects of lean in each flight, and their variances: what it shows itself, drawn to the mean.

    How much they differ shows in the flights, and half of that is taken for what manoeuvres make of the estimates.
    """
    seen = np.array([flight.lean_effect for flight in flights])
    variance = np.array([flight.lean_effect_error for flight in flights]) ** 2
    known = np.isfinite(seen) & np.isfinite(variance)
    seen, variance = np.where(known, seen, 0.0), np.where(known, variance, np.inf)
    plain = seen.sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    spread = np.where(known, (seen - plain) ** 2, 0.0).sum(axis=0)
    freedom = LEAN_EFFECT_FREEDOM + np.maximum(known.sum(axis=0) - 1, 0)
    scatter = (LEAN_EFFECT_FREEDOM * LEAN_EFFECT_SCATTER**2 + spread) / freedom
    weights = 1 / (variance + scatter)
    total = weights.sum(axis=0) + LEAN_EFFECT**-2
    mean = (weights * seen).sum(axis=0) / total
    own, common = 1 / (variance + scatter / 2), 1 / (scatter / 2 + 1 / total)
    return (own * seen + common * mean) / (own + common), 1 / (own + common)
