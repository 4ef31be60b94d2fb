"""The second pass: every flight of a vehicle beside the vehicle's healthy ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t

from mavdem.fleet.row import OK, UNKNOWN, FlightRow, Numbers
from mavdem.health.assessment import Assessment, assess
from mavdem.health.balance import BalanceFigures
from mavdem.health.motor_signature import motor_signatures
from mavdem.health.reference import HealthFigures, healthy_flights

Array = NDArray[np.float64]
FlightKey = tuple[str, str, int | None]

SHARED_BY_MANY = "system id"  # the basis of a name that several vehicles may have
FEWEST_MODELS = 3  # of healthy flights, from which their scatter gives an interval
TWO_SIDED = 0.95  # the quantile at the end of an interval of 90 %


def with_health(rows: Sequence[FlightRow], baseline: Sequence[FlightRow]) -> Sequence[FlightRow]:
    """All rows of one vehicle with what its other flights say of each.

    Args:
        rows: of one vehicle.
        baseline: of its healthy flights; without any, its first flights are the reference.
    """
    flown = [row for row in rows if row.status == OK]
    named = rows[0].vehicle != UNKNOWN and rows[0].vehicle_basis != SHARED_BY_MANY
    if not flown:
        return rows
    if not (named or baseline):
        reason = "Health is unknown: the log does not say which vehicle it is of. Name its healthy flights as baseline."
        return [replace(row, health=UNKNOWN, health_reason=reason) if row.status == OK else row for row in rows]
    healthy_rows = [row for row in baseline if row.status == OK]
    # A flight that is among both is one flight.
    figures = {_key(row): _figures(row) for row in (*healthy_rows, *flown)}
    own = {_key(row): figures[_key(row)] for row in flown}
    given = list({_key(row): figures[_key(row)] for row in healthy_rows}.values())
    verdicts = dict(zip(own, assess(list(own.values()), given or None), strict=True))
    reference = given or list(healthy_flights(list(own.values())))
    names = {flight.name for flight in reference}
    healthy = {_key(row, row.axis): row for row in (*healthy_rows, *flown) if figures[_key(row)].name in names}
    return [_judged(row, verdicts, list(healthy.values())) if row.status == OK else row for row in rows]


def _judged(row: FlightRow, verdicts: Mapping[FlightKey, Assessment], healthy: Sequence[FlightRow]) -> FlightRow:
    found = verdicts[_key(row)]
    mean, interval = residual_mean(row, healthy)
    return replace(
        row,
        health=found.health,
        fault_probability=found.fault_probability,
        suspect_motor=found.suspect_motor,
        health_reason=found.reason,
        residual_mean=mean,
        residual_mean_interval=interval,
    )


def _key(row: FlightRow, axis: str | None = None) -> FlightKey:
    return f"{row.key or row.file} {axis or ''}", row.vehicle, row.system


def _array(values: Numbers | None, count: int) -> Array:
    """As an array, NaN for what is not known."""
    if values is None:
        return np.full(count, np.nan)
    return np.array([np.nan if value is None else value for value in values])


def _figures(row: FlightRow) -> HealthFigures:
    motors = row.motors or ()
    balance = None
    if row.balance is not None:
        balance = BalanceFigures(
            _array(row.balance, 3),
            _array(row.balance_error, 3),
            _array(row.balance_lean, 2),
            _array(row.lean_effect, 6).reshape(3, 2),
            _array(row.lean_effect_error, 6).reshape(3, 2),
            row.duration or 0.0,
        )
    return HealthFigures(
        name=f"{row.file} {row.system}",
        motors=motors,
        signatures=motor_signatures(len(motors), row.positions or (), row.spins or ()) if motors else None,
        balance=balance,
        date=row.date,
        collective=row.collective,
        voltage=row.voltage_mean,
    )


def residual_mean(row: FlightRow, healthy: Sequence[FlightRow]) -> tuple[float | None, float | None]:
    """The mean one-step residual of healthy flights' models on a flight, and its half width, rad/s²; None if unknown.

    Each model predicts no angular acceleration at its own flight's means; what it leaves at this flight's is the
    residual. Its interval comes from the scatter of these residuals over healthy flights.
    """
    models = [
        other
        for other in healthy
        if other.axis == row.axis and other.residual_offset is not None and other.motors == row.motors
    ]
    found = _residual(row, [model for model in models if model.key != row.key])
    if found is None:
        return None, None
    scatter = [
        residual
        for model in models
        if (residual := _residual(model, [other for other in models if other is not model])) is not None
    ]
    if len(scatter) < FEWEST_MODELS:
        return found, None
    return found, float(t.ppf(TWO_SIDED, len(scatter) - 1) * np.sqrt(np.mean(np.square(scatter))))


def _residual(row: FlightRow, models: Sequence[FlightRow]) -> float | None:
    if not models or row.mean_inputs is None:
        return None
    inputs, outputs = _array(row.mean_inputs, 0), _array(row.mean_outputs or (0.0, 0.0), 2)
    residuals = [
        float(_array(model.residual_gain_inputs, 0) @ inputs)
        + float(_array(model.residual_gain_outputs, 2) @ outputs)
        + (model.residual_offset or 0.0)
        for model in models
        if model.residual_gain_inputs is not None and len(model.residual_gain_inputs) == len(inputs)
    ]
    return float(np.mean(residuals)) if residuals else None
