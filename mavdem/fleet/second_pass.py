"""The second pass: every flight of a vehicle beside the vehicle's healthy ones."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
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
FlightKey = tuple[str, str, int | None, int | None]

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
    models = {_kind(row): HealthyModels(healthy.values(), row) for row in flown}
    return [_judged(row, verdicts[_key(row)], models[_kind(row)]) if row.status == OK else row for row in rows]


def _judged(row: FlightRow, found: Assessment, models: HealthyModels) -> FlightRow:
    return replace(
        row,
        health=found.health,
        fault_probability=found.fault_probability,
        change_probability=found.change_probability,
        suspect_motor=found.suspect_motor,
        health_reason=found.reason,
        residual_mean=models.residual_mean(row),
        residual_mean_interval=models.interval,
    )


def _key(row: FlightRow, axis: str | None = None) -> FlightKey:
    return f"{row.key or row.file} {axis or ''}", row.vehicle, row.system, row.component


def _kind(row: FlightRow) -> tuple[object, ...]:
    """What models must have in common to be driven by each other's inputs: motors and the demand are other inputs."""
    return row.axis, row.motors, row.inputs, row.input_unit


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
        name=f"{row.file} {row.system} {row.component}",
        motors=motors,
        signatures=motor_signatures(len(motors), row.positions or (), row.spins or ()) if motors else None,
        balance=balance,
        date=row.date,
        collective=row.collective,
        voltage=row.voltage_mean,
    )


class HealthyModels:
    """The models of healthy flights of one vehicle and axis, frozen.

    Each predicts no angular acceleration at its own flight's means; what it leaves at another's is the residual.

    Args:
        healthy: rows of the vehicle.
        like: a row with the axis and the inputs.

    Attributes:
        interval: half width of the residual mean of a healthy flight, rad/s², by the scatter of these; None of few.
    """

    def __init__(self, healthy: Iterable[FlightRow], like: FlightRow) -> None:
        self._models = [row for row in healthy if _kind(row) == _kind(like) and row.residual_offset is not None]
        left = [residual for row in self._models if (residual := self.residual_mean(row)) is not None]
        self.interval = (
            float(t.ppf(TWO_SIDED, len(left) - 1) * np.sqrt(np.mean(np.square(left))))
            if len(left) >= FEWEST_MODELS
            else None
        )

    def residual_mean(self, row: FlightRow) -> float | None:
        """The mean acceleration that other flights' models leave unexplained in this, rad/s²; None where not known."""
        if row.mean_inputs is None:
            return None
        inputs, outputs = _array(row.mean_inputs, 0), _array(row.mean_outputs or (0.0, 0.0), 2)
        residuals = [
            float(_array(model.residual_gain_inputs, len(inputs)) @ inputs)
            + float(_array(model.residual_gain_outputs, 2) @ outputs)
            + (model.residual_offset or 0.0)
            for model in self._models
            if model.key != row.key and _kind(model) == _kind(row)
        ]
        return float(np.mean(residuals)) if residuals else None
