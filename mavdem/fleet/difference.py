"""The difference between two states of a vehicle: what changed beyond its interval, what did not, what is unknown.

Each state is one flight or several. The variance of a difference is that within the flights, of their intervals, and
that between flights, which several flights of a state show; ``BETWEEN`` is what is assumed before (random effects, L.
V. Hedges and I. Olkin, "Statistical Methods for Meta-Analysis", 1985). What other conditions can do widens the
interval. All quantities are tested together: the chance that any is called changed when none did is at most
``SIGNIFICANCE`` where the intervals hold (S. Holm, "A simple sequentially rejective multiple test procedure", 1979).

Compared are the quantities that belong to the vehicle and not to its wind. Share and effect of a motor are beside the
median of all motors: what changes one leaves the others alone, and what changes all, as the battery does, or biases all
estimates, as closed loop does, leaves each alone.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import exp, hypot, isclose, log, sqrt
from statistics import fmean, median
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr

from mavdem.confidence import CONFIDENCE_LEVEL, coverage_factor
from mavdem.containers import Names, Numbers
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.dem.record import MIN_MOTORS
from mavdem.experiments.paired_test import SIGNIFICANCE
from mavdem.facts import Fact
from mavdem.facts.fleet import Compared, Incomparable, QuantityOutcome
from mavdem.facts.identifiability import Status
from mavdem.fleet.row import (
    SHARED,
    UNKNOWN,
    Flight,
    FlightRow,
    FlightRows,
    flights_of,
    vehicles_of,
)
from mavdem.immutable import ReadOnlyDict
from mavdem.ingest.telemetry import Parameters
from mavdem.ingest.vocabulary import AUTOPILOT_SET_PARAMETERS, CONTROL_PARAMETERS, RATE_GAIN
from mavdem.motors.balance import SCATTER

SHARE = "share"
EFFECT = "effect"
MEAN_EFFECT = "mean effect"
DAMPING = "damping"
LAG = "lag"
BETWEEN = {
    SHARE: float(np.linalg.norm(SCATTER)),
    EFFECT: 0.02,
    MEAN_EFFECT: 0.1,
    DAMPING: 0.2,
    LAG: 0.004,
}
"""Assumed standard deviation of a quantity from flight to flight of the same vehicle; of shares and effects relative.
Of shares it is what health assumes of the three axes; docs/evidence/motors.md shows what the others give."""
PRIOR_FLIGHTS = 8  # flights that the assumption weighs as many as
WITHIN_FREEDOM = 20  # degrees of freedom of the intervals of flights
# rad, standard deviation of the difference of roll or pitch where a lean is not known: 4°
TYPICAL_LEAN = 0.07
# 1/rad, standard deviation: drag half an arm's length above or below the centre of mass
SHARE_PER_LEAN = 0.5
RESOLUTION = {SHARE: 0.06, EFFECT: 0.2, MEAN_EFFECT: 0.3, DAMPING: 0.8, LAG: 0.02}
"""Differences up to which a quantity is called the same, if its whole interval lies within (an equivalence test)."""
# of an effect, as a share of it: with a wider interval its logarithm is not nearly normal
MAX_UNCERTAINTY = 0.5
SIDES = ("A", "B")
UNSURE = {Status.BIASED, Status.NOT_IDENTIFIABLE}
_Z = coverage_factor()  # of the intervals of flights, in standard deviations

Flights = Sequence[Flight]
"""Flights of one vehicle in order of date, the rows of each."""


class Quantity(NamedTuple):
    """What is estimated: its ``kind``, of which ``motor`` (from 1; 0: of none), about which ``axis`` ("": of none).

    Shares and effects are compared by their logarithm, the others as they are; "mean effect" is that of all motors.
    """

    kind: str
    motor: int = 0
    axis: str = ""


Estimate = tuple[float, float]
"""A value, or its logarithm, and the standard deviation of its error within the flight."""


class QuantityChange(NamedTuple):
    """One quantity in both states."""

    quantity: Quantity  # which
    before: float | None  # its means; of shares and effects None
    after: float | None
    # after less before, and the half width of its 90 % interval; relative ones for shares and effects
    difference: float
    half_width: float
    p: float  # probability of a difference as large if nothing changed
    # standard deviation of what other conditions may do to it, which is in the half width
    allowance: float
    # uncertain where the interval has both what is called the same and what is not
    outcome: QuantityOutcome = QuantityOutcome.SAME


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


class MissingQuantity(NamedTuple):
    """What cannot be compared, and the reason."""

    quantity: Fact
    reason: Fact


class ParameterChange(NamedTuple):
    """A parameter that was set anew."""

    name: str
    before: float
    after: float


class VehicleDifference(NamedTuple):
    """What differs between two states of a vehicle."""

    vehicles: tuple[Names, Names]  # names in each state
    shared: Names  # of these, the names that several vehicles may have
    motors: Names  # their names; empty where not known
    flights: tuple[int, int]  # how many each has
    # quantities known in both, in the order of kinds, motors and axes
    changes: tuple[QuantityChange, ...]
    incomparable: tuple[MissingQuantity, ...]  # what is not known in both
    conditions: tuple[Conditions, Conditions]  # of each state
    family_error: float = SIGNIFICANCE  # chance that any is called changed when none did
    level: float = CONFIDENCE_LEVEL  # of the intervals

    def of(self, outcome: QuantityOutcome) -> list[QuantityChange]:
        """Returns the changes with this outcome."""
        return [change for change in self.changes if change.outcome == outcome]


SinceBaselines = dict[str, tuple[FlightRow, VehicleDifference | None]]
"""The latest flight of each vehicle, and what differs from its baseline, if it has one."""


def vehicle_difference(before: FlightRows, after: FlightRows) -> VehicleDifference:
    """Returns what differs between flights ``before`` and ``after``, of one vehicle or of two; of rows with figures."""
    sides = [flights_of(row for row in rows if row.is_read) for rows in (before, after)]
    conditions = (conditions_of(sides[0]), conditions_of(sides[1]))
    estimates = [[estimates_of(flight) for flight in flights] for flights in sides]
    unlike = _unlike(sides)
    kinds = [*BETWEEN] if unlike is None else [SHARE]
    if unlike is not None and unlike.code is not Incomparable.OTHER_INPUTS:
        kinds = []
    judged = []
    for quantity in {quantity for flight in estimates[0] for quantity in flight}:
        pair = [[flight[quantity] for flight in side if quantity in flight] for side in estimates]
        if quantity.kind in kinds and all(pair):
            judged.append(_compared(quantity, pair, _allowance(quantity.kind, conditions)))
    rows = [flight[0] for side in sides for flight in side]
    first, second = (tuple(sorted({flight[0].vehicle for flight in side})) for side in sides)
    return VehicleDifference(
        (first, second),
        tuple(sorted({row.vehicle for row in rows if row.vehicle_basis == SHARED})),
        next((row.motors for row in rows if row.motors), ()),
        (len(sides[0]), len(sides[1])),
        tuple(_tested(judged)),
        tuple(_incomparable(sides, estimates, unlike)),
        conditions,
    )


def changed_parameters(before: Parameters, after: Parameters) -> list[ParameterChange]:
    """Returns the parameters that somebody set to other values ``after``: those of control first, then by name."""
    both = sorted(
        before.keys() & after.keys(), key=lambda name: (not CONTROL_PARAMETERS.match(name), name)
    )
    return [
        ParameterChange(name, before[name], after[name])
        for name in both
        if not AUTOPILOT_SET_PARAMETERS.search(name)
        and not isclose(before[name], after[name], rel_tol=1e-6)
    ]


def without_gains(before: Parameters, after: Parameters) -> Names:
    """Returns which of the two sides have no gains of rate control, so that it is not known if these changed."""
    sides = zip(SIDES, (before, after), strict=True)
    return tuple(side for side, known in sides if not any(map(RATE_GAIN.match, known)))


def since_baseline(rows: FlightRows, baseline: FlightRows) -> SinceBaselines:
    """Returns the latest flight of each vehicle, and what differs from its flights of a ``baseline``, if it has any.

    The latest alone: flights with a fault and without one, taken together, would hide it. Flights of the baseline are
    no later ones, and those that do not say whose they are are left out.
    """
    keys = {row.key for row in baseline if row.key}
    before = vehicles_of(baseline)
    changes = {}
    for name, flights in vehicles_of(row for row in rows if row.key not in keys).items():
        latest = flights[-1]
        healthy = [row for flight in before.get(name, ()) for row in flight]
        if name != UNKNOWN:
            changes[name] = latest[0], vehicle_difference(healthy, latest) if healthy else None
    return changes


def estimates_of(flight: Flight) -> dict[Quantity, Estimate]:
    """Returns what the rows of one flight, an axis each, estimate of the vehicle.

    Only what is "reported" is compared: what is "biased" is so by as much as wind and steering say.
    """
    estimates: dict[Quantity, Estimate] = {}
    by_axis: dict[Quantity, list[Estimate]] = {}
    for row in flight:
        # The motors' figures are the same on each axis.
        estimates |= _beside_median(SHARE, _logarithms(row.trim_share, row.trim_share_interval))
        for kind in (DAMPING, LAG):
            value, half, status = (
                getattr(row, f"{kind}{ending}") for ending in ("", "_interval", "_status")
            )
            if value is not None and half is not None and status == Status.REPORTED:
                estimates[Quantity(kind, axis=row.axis or "")] = value, half / _Z
        effects = _logarithms(row.effect, row.effect_interval)
        if effects and row.effect_status == Status.REPORTED:
            # Errors of the motors' effects have much in common: their mean is hardly known better than each.
            values, sds = zip(*effects.values(), strict=True)
            estimates[Quantity(MEAN_EFFECT, axis=row.axis or "")] = fmean(values), max(sds)
            if len(row.motors or ()) == len(row.effect or ()):
                for quantity, estimate in _beside_median(EFFECT, effects).items():
                    by_axis.setdefault(quantity, []).append(estimate)
    # A motor's effect on roll and on pitch changes alike; what they have in common of their errors is not known.
    for quantity, parts in by_axis.items():
        values, sds = zip(*parts, strict=True)
        estimates[quantity] = fmean(values), max(sds)
    return estimates


def _logarithms(values: Numbers | None, halves: Numbers | None) -> dict[int, Estimate]:
    """The logarithm by motor, from 1, of what is known well enough for it."""
    return {
        motor: (log(abs(value)), half / abs(value) / _Z)
        for motor, (value, half) in enumerate(zip(values or (), halves or (), strict=False), 1)
        if half is not None and half < MAX_UNCERTAINTY * abs(value)
    }


def _beside_median(kind: str, estimates: Mapping[int, Estimate]) -> dict[Quantity, Estimate]:
    """Each motor's logarithm less the median of all; of too few motors none."""
    if len(estimates) < MIN_MOTORS:
        return {}
    middle = median(value for value, _ in estimates.values())
    return {Quantity(kind, motor): (value - middle, sd) for motor, (value, sd) in estimates.items()}


def _compared(
    quantity: Quantity, sides: Sequence[Sequence[Estimate]], allowance: float
) -> QuantityChange:
    """The difference of the means of two groups of flights, by random effects; not yet tested beside the others."""
    groups = [np.array([(value, sd**2) for value, sd in side]).T for side in sides]
    observed = sum(values.size - 1 for values, _ in groups)
    # The spread within each group less what the flights' own errors make of it.
    excess = sum(
        ((values - values.mean()) ** 2).sum() - errors.sum() * (1 - 1 / values.size)
        for values, errors in groups
    )
    assumed = PRIOR_FLIGHTS * BETWEEN[quantity.kind] ** 2
    between = (assumed + max(excess, 0.0)) / (PRIOR_FLIGHTS + observed)
    weights = [1 / (errors + between) for _, errors in groups]
    before, after = (
        float(weight @ values / weight.sum())
        for weight, (values, _) in zip(weights, groups, strict=True)
    )
    variance = float(sum(1 / weight.sum() for weight in weights))
    of_flights = float(sum(((weight / weight.sum()) ** 2).sum() * between for weight in weights))
    # Welch and Satterthwaite: the part between flights is known from fewer numbers than the flights' own.
    freedom = variance**2 / (
        of_flights**2 / (PRIOR_FLIGHTS + observed) + (variance - of_flights) ** 2 / WITHIN_FREEDOM
    )
    sd = hypot(sqrt(variance), allowance)
    half = coverage_factor(freedom=freedom) * sd
    p = float(2 * stdtr(freedom, -abs(after - before) / sd))
    if quantity.kind in (DAMPING, LAG):
        return QuantityChange(quantity, before, after, after - before, half, p, allowance)
    # The interval of a ratio, at its difference.
    ratio = exp(after - before)
    return QuantityChange(quantity, None, None, ratio - 1, ratio * half, p, allowance)


def _tested(judged: Sequence[QuantityChange]) -> list[QuantityChange]:
    """Each with its outcome, in order, by Holm's procedure over all."""
    tested = []
    outcome = QuantityOutcome.CHANGED
    for rank, change in enumerate(sorted(judged, key=lambda change: change.p)):
        if outcome is not QuantityOutcome.CHANGED or change.p > SIGNIFICANCE / (len(judged) - rank):
            within = abs(change.difference) + change.half_width <= RESOLUTION[change.quantity.kind]
            outcome = QuantityOutcome.SAME if within else QuantityOutcome.UNCERTAIN
        tested.append(change._replace(outcome=outcome))
    order = [*BETWEEN]
    return sorted(tested, key=lambda change: (order.index(change.quantity.kind), change.quantity))


def _allowance(kind: str, conditions: tuple[Conditions, Conditions]) -> float:
    """Standard deviation of a quantity's difference because the conditions differ."""
    before, after = conditions
    if kind == SHARE:
        leans = (before.lean_roll, after.lean_roll), (before.lean_pitch, after.lean_pitch)
        return SHARE_PER_LEAN * hypot(
            *(TYPICAL_LEAN if a is None or b is None else a - b for a, b in leans)
        )
    if kind == MEAN_EFFECT:
        # At the same thrust the effect is proportional to the voltage, with more thrust to the output.
        pairs = (before.voltage, after.voltage), (before.collective, after.collective)
        return sum(abs(log(a / b)) for a, b in pairs if a and b)
    return 0.0


def conditions_of(flights: Flights) -> Conditions:
    """Returns the mean conditions of flights."""

    def mean(values: Iterable[float | None]) -> float | None:
        present = [value for value in values if value is not None]
        return fmean(present) if present else None

    columns = ("voltage_mean", "collective", "lean_roll", "lean_pitch", "tilt_sd")
    means = [mean(getattr(flight[0], column) for flight in flights) for column in columns]
    rows = [row for flight in flights for row in flight]
    torques = {axis: mean(row.wind_torque_sd for row in rows if row.axis == axis) for axis in AXES}
    present = ReadOnlyDict({axis: torque for axis, torque in torques.items() if torque is not None})
    return Conditions(*means, present)  # type: ignore[call-arg, arg-type]


def _unlike(sides: Sequence[Flights]) -> Fact | None:
    """Why nothing of the two can be compared, or nothing that belongs to models; None where all can."""
    for side, flights in zip(SIDES, sides, strict=True):
        if not flights:
            return Fact(Incomparable.NO_FLIGHT, subject=side)
    rows = [[row for flight in flights for row in flight] for flights in sides]
    columns = {
        Incomparable.OTHER_VEHICLES: lambda row: (
            f"{len(row.motors)} motors" if row.motors else None
        ),
        Incomparable.OTHER_UNITS: lambda row: row.trim_unit,
        Incomparable.OTHER_INPUTS: lambda row: (
            f"{row.inputs} {row.input_unit}" if row.effect_status else None
        ),
    }
    for code, column in columns.items():
        before, after = ({*filter(None, map(column, side))} for side in rows)
        if before and after and not before & after:
            return Fact(code, before=_sorted(before), after=_sorted(after))
    return None


def _incomparable(
    sides: Sequence[Flights],
    estimates: Sequence[Sequence[Iterable[Quantity]]],
    unlike: Fact | None,
) -> Iterator[MissingQuantity]:
    """What is missing on either side, each with its reason."""
    wanted = [Quantity(SHARE)]
    if unlike is None:
        of_axes = [Quantity(kind, axis=axis) for kind in (DAMPING, LAG) for axis in TILT_AXES]
        wanted += [Quantity(EFFECT), *of_axes]
    elif unlike.code is Incomparable.OTHER_INPUTS:
        yield MissingQuantity(Fact(Compared.OF_MODELS), unlike)
    else:
        yield MissingQuantity(Fact(Compared.EVERYTHING), unlike)
        return
    for quantity in wanted:
        reasons = [
            _reason(quantity, side, flights)
            for side, flights, tables in zip(SIDES, sides, estimates, strict=True)
            if not any(
                row.kind == quantity.kind and quantity.axis in ("", row.axis)
                for table in tables
                for row in table
            )
        ]
        if reasons:
            name = Fact(Compared.QUANTITY, subject=quantity.axis, name=quantity.kind)
            yield MissingQuantity(name, Fact(Incomparable.NOT_IN_BOTH, reasons=reasons))


def _reason(quantity: Quantity, side: str, flights: Flights) -> Fact:
    """Why a side lacks a quantity."""
    rows = [row for flight in flights for row in flight if quantity.axis in ("", row.axis)]
    statuses = {getattr(row, f"{quantity.kind}_status", None) for row in rows} & UNSURE
    if statuses:
        return Fact(Incomparable.NOT_REPORTED, subject=side, names=_sorted(statuses))
    return Fact(Incomparable.NOT_ESTIMATED, subject=side)


def _sorted(values: Iterable[object]) -> list[str]:
    return sorted(map(str, values))
