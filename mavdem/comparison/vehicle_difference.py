"""The difference between two states of a vehicle: what changed beyond its interval, what did not, and what is unknown.

Each state is one flight or several. The variance of a difference is that within the flights, of their intervals, and
that between flights, which several flights of a state show; ``BETWEEN`` is what is assumed before (random effects, L.
V. Hedges and I. Olkin, "Statistical Methods for Meta-Analysis", 1985). What other conditions can do widens the
interval. All quantities are tested together: the chance that any is called changed when none did is at most
``FAMILY_ERROR`` where the intervals hold (S. Holm, "A simple sequentially rejective multiple test procedure", 1979).
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from math import exp, hypot, log, sqrt
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.stats import t as student

from mavdem.comparison.flight_figures import NAMELESS, OK, FlightFigures, flights_of, is_shared, vehicles_of
from mavdem.comparison.incomparable import OF_MODELS, other_inputs, other_kinds, why_not
from mavdem.comparison.vehicle_estimates import (
    DAMPING,
    EFFECT,
    LAG,
    MEAN_EFFECT,
    SHARE,
    FlightEstimate,
    Quantity,
    estimates_of,
)
from mavdem.confidence import LEVEL, quantile
from mavdem.health.reference import SCATTER

FAMILY_ERROR = 0.05
BETWEEN = {SHARE: float(np.linalg.norm(SCATTER)), EFFECT: 0.02, MEAN_EFFECT: 0.1, DAMPING: 0.2, LAG: 0.004}
"""Assumed standard deviation of a quantity from flight to flight of the same vehicle; of shares and effects relative.
Of shares it is what health assumes of the three axes; the others are chosen by tools/validation/vehicle_changes.py."""
PRIOR_FLIGHTS = 8  # flights that the assumption weighs as many as
WITHIN_FREEDOM = 20  # degrees of freedom of the intervals of flights
TYPICAL_LEAN = 0.07  # rad, standard deviation of the difference of roll or pitch where a lean is not known: 4°
SHARE_PER_LEAN = 0.5  # 1/rad, standard deviation: drag half an arm's length above or below the centre of mass
RESOLUTION = {SHARE: 0.06, EFFECT: 0.2, MEAN_EFFECT: 0.3, DAMPING: 0.8, LAG: 0.02}
"""Differences up to which a quantity is called the same, if its whole interval lies within (an equivalence test)."""

Outcome = Literal["changed", "same", "uncertain"]


class QuantityChange(NamedTuple):
    """One quantity in both states.

    Attributes:
        quantity: which.
        before, after: its means; of shares and effects None.
        difference, half_width: after less before, and the half width of its 90 % interval; relative ones for
            shares and effects.
        p: probability of a difference as large if nothing changed.
        allowance: standard deviation of what other conditions may do to it, which is in the half width.
        outcome: "changed", "same", or "uncertain" where the interval has both what is called the same and what is not.
    """

    quantity: Quantity
    before: float | None
    after: float | None
    difference: float
    half_width: float
    p: float
    allowance: float
    outcome: Outcome


class Conditions(NamedTuple):
    """How a state was flown, means over its flights; None where not known. SI units, rad.

    ``collective`` is the mean of the motors as a share of their range: payload, and what the battery gives.
    ``wind_torque`` by axis: standard deviation, rad/s².
    """

    voltage: float | None
    collective: float | None
    lean_roll: float | None
    lean_pitch: float | None
    tilt_sd: float | None
    wind_torque: dict[str, float]


class VehicleDifference(NamedTuple):
    """What differs between two states of a vehicle.

    Attributes:
        vehicles: names in each state.
        shared: of these, the names that several vehicles may have.
        motors: their names; empty where not known.
        flights: how many each has.
        changes: quantities known in both, in the order of kinds, motors and axes.
        incomparable: what is not known in both: its name and the reason.
        conditions: of each state.
    """

    vehicles: tuple[tuple[str, ...], tuple[str, ...]]
    shared: tuple[str, ...]
    motors: tuple[str, ...]
    flights: tuple[int, int]
    changes: tuple[QuantityChange, ...]
    incomparable: tuple[tuple[str, str], ...]
    conditions: tuple[Conditions, Conditions]

    def of(self, outcome: Outcome) -> list[QuantityChange]:
        """The changes with this outcome."""
        return [change for change in self.changes if change.outcome == outcome]

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values."""
        return {
            "vehicles": [list(names) for names in self.vehicles],
            "shared": list(self.shared),
            "motors": list(self.motors),
            "flights": list(self.flights),
            "family_error": FAMILY_ERROR,
            "level": LEVEL,
            "changes": [{**change._asdict(), "quantity": change.quantity._asdict()} for change in self.changes],
            "incomparable": [{"quantity": name, "reason": reason} for name, reason in self.incomparable],
            "conditions": [one._asdict() for one in self.conditions],
        }


class _Side(NamedTuple):
    """The estimates of a quantity in the flights of one state."""

    values: list[float]
    variances: list[float]


class _Raw(NamedTuple):
    """A difference before it is judged: on the scale of its estimates."""

    before: float
    after: float
    difference: float
    variance: float
    freedom: float
    allowance: float


def vehicle_difference(before: Sequence[FlightFigures], after: Sequence[FlightFigures]) -> VehicleDifference:
    """What differs between the flights ``before`` and ``after``, of one vehicle or of two.

    Rows without figures count for nothing.
    """
    sides = [flights_of(row for row in rows if row.status == OK) for rows in (before, after)]
    conditions = (conditions_of(sides[0]), conditions_of(sides[1]))
    estimates = [[estimates_of(flight) for flight in flights] for flights in sides]
    incomparable = why_not(sides, estimates)
    alike = [] if other_kinds(*sides) else sorted({quantity for one in estimates[0] for quantity in one})
    if other_inputs(*sides):
        alike = [quantity for quantity in alike if quantity.kind not in OF_MODELS]
    raws: dict[Quantity, list[_Raw]] = {}
    for quantity in alike:
        known = [[one[quantity] for one in side if quantity in one] for side in estimates]
        if not all(known):
            continue
        raw = _compared(quantity.kind, known[0], known[1], _allowance(quantity.kind, conditions))
        # A motor's effect on roll and on pitch changes alike.
        merged = quantity._replace(axis="") if quantity.kind == EFFECT and quantity.motor else quantity
        raws.setdefault(merged, []).append(raw)
    judged = [_judged(quantity, _merged(parts)) for quantity, parts in raws.items()]
    changes = sorted(_tested(judged), key=lambda one: (list(BETWEEN).index(one.quantity.kind), one.quantity))
    first, second = (tuple(sorted({flight[0].vehicle for flight in flights})) for flights in sides)
    motors = next((tuple(row.motors) for flights in sides for flight in flights for row in flight if row.motors), ())
    counts = (len(sides[0]), len(sides[1]))
    shared = tuple(sorted({flight[0].vehicle for flights in sides for flight in flights if is_shared([flight])}))
    return VehicleDifference((first, second), shared, motors, counts, tuple(changes), tuple(incomparable), conditions)


class SinceBaseline(NamedTuple):
    """The latest flight of a vehicle beside its flights of a baseline.

    Attributes:
        file, date: of the latest flight.
        found: what differs; None where the baseline has no flight of the vehicle.
    """

    file: str
    date: datetime | None
    found: VehicleDifference | None

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values."""
        date = None if self.date is None else self.date.isoformat()
        return {"file": self.file, "date": date, "found": None if self.found is None else self.found.as_dict()}


def since_baseline(rows: Sequence[FlightFigures], baseline: Sequence[FlightFigures]) -> dict[str, SinceBaseline]:
    """The latest flight of each vehicle beside those of a ``baseline``, which themselves are no later ones.

    The latest alone: flights with a fault and without one, taken together, would hide it. Flights that do not say whose
    they are are left out.
    """
    known = {row.key for row in baseline if row.key}
    before, after = vehicles_of(baseline), vehicles_of(row for row in rows if row.key not in known)
    latest = {name: flights[-1] for name, flights in after.items() if name != NAMELESS}
    return {
        name: SinceBaseline(
            flight[0].file,
            flight[0].date,
            vehicle_difference([row for one in before[name] for row in one], flight) if name in before else None,
        )
        for name, flight in latest.items()
    }


def _compared(kind: str, before: Sequence[FlightEstimate], after: Sequence[FlightEstimate], allowance: float) -> _Raw:
    """The difference of the means of two groups of flights, by random effects."""
    groups = [_Side([one.value for one in group], [one.sd**2 for one in group]) for group in (before, after)]
    observed = sum(len(group.values) - 1 for group in groups)
    # The spread within each group less what the flights' own errors make of it.
    excess = sum(
        sum((value - sum(group.values) / len(group.values)) ** 2 for value in group.values)
        - sum(group.variances) * (1 - 1 / len(group.values))
        for group in groups
    )
    between = (PRIOR_FLIGHTS * BETWEEN[kind] ** 2 + max(excess, 0.0)) / (PRIOR_FLIGHTS + observed)
    means, variances, shares = [], [], []
    for group in groups:
        weights = [1 / (variance + between) for variance in group.variances]
        total = sum(weights)
        means.append(sum(weight * value for weight, value in zip(weights, group.values, strict=True)) / total)
        variances.append(1 / total)
        shares.append(sum((weight / total) ** 2 * between for weight in weights))
    variance, of_between = sum(variances), sum(shares)
    within = variance - of_between
    # Welch and Satterthwaite: the part between flights is known from fewer numbers than the flights' own.
    freedom = variance**2 / (of_between**2 / (PRIOR_FLIGHTS + observed) + within**2 / WITHIN_FREEDOM)
    return _Raw(means[0], means[1], means[1] - means[0], variance, freedom, allowance)


def _merged(parts: Sequence[_Raw]) -> _Raw:
    """One difference from those of several axes, wider where they differ by more than their errors (R. T. Birge)."""
    if len(parts) == 1:
        return parts[0]
    weights = [1 / part.variance for part in parts]
    total = sum(weights)
    mean = sum(weight * part.difference for weight, part in zip(weights, parts, strict=True)) / total
    spread = sum(weight * (part.difference - mean) ** 2 for weight, part in zip(weights, parts, strict=True))
    wider = max(1.0, spread / (len(parts) - 1))
    freedom = min(part.freedom for part in parts)
    return _Raw(float("nan"), float("nan"), mean, wider / total, freedom, max(part.allowance for part in parts))


def _judged(quantity: Quantity, raw: _Raw) -> QuantityChange:
    """The difference in the unit people read, with its interval and p-value; not yet tested beside the others."""
    sd = hypot(sqrt(raw.variance), raw.allowance)
    half = quantile(LEVEL, raw.freedom) * sd
    p = float(2 * student.sf(abs(raw.difference) / sd, raw.freedom))
    before: float | None = raw.before
    after: float | None = raw.after
    difference = raw.difference
    if quantity.kind in (SHARE, EFFECT, MEAN_EFFECT):
        before = after = None
        # The interval of a ratio, at its difference.
        difference, half = exp(raw.difference) - 1, exp(raw.difference) * half
    return QuantityChange(quantity, before, after, difference, half, p, raw.allowance, "same")


def _tested(judged: Sequence[QuantityChange]) -> list[QuantityChange]:
    """The outcome of each, by Holm's procedure over all."""
    tested = []
    still = True
    for place, one in enumerate(sorted(judged, key=lambda one: one.p)):
        still = still and one.p <= FAMILY_ERROR / (len(judged) - place)
        within = abs(one.difference) + one.half_width <= RESOLUTION[one.quantity.kind]
        same: Outcome = "same" if within else "uncertain"
        tested.append(one._replace(outcome="changed" if still else same))
    return tested


def _allowance(kind: str, conditions: tuple[Conditions, Conditions]) -> float:
    """Standard deviation of a quantity's difference because the conditions differ."""
    one, other = conditions
    if kind == SHARE:
        pairs = (one.lean_roll, other.lean_roll), (one.lean_pitch, other.lean_pitch)
        return SHARE_PER_LEAN * hypot(
            *(TYPICAL_LEAN if mine is None or yours is None else mine - yours for mine, yours in pairs)
        )
    if kind == MEAN_EFFECT:
        # At the same thrust the effect is proportional to the voltage, with more thrust to the output.
        pairs = (one.voltage, other.voltage), (one.collective, other.collective)
        return sum(abs(log(mine / yours)) for mine, yours in pairs if mine and yours)
    return 0.0


def conditions_of(flights: Sequence[Sequence[FlightFigures]]) -> Conditions:
    """The mean conditions of flights."""
    firsts = [flight[0] for flight in flights]
    torques: dict[str, list[float]] = {}
    for flight in flights:
        for row in flight:
            if row.wind_torque_sd is not None and row.axis is not None:
                torques.setdefault(row.axis, []).append(row.wind_torque_sd)
    return Conditions(
        _mean([row.voltage_mean for row in firsts]),
        _mean([row.collective for row in firsts]),
        _mean([row.lean_roll for row in firsts]),
        _mean([row.lean_pitch for row in firsts]),
        _mean([row.tilt_sd for row in firsts]),
        {axis: sum(values) / len(values) for axis, values in sorted(torques.items())},
    )


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None
