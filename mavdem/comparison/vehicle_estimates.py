"""Estimates of a vehicle from one flight: the quantities that belong to the vehicle and not to its wind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite, log
from statistics import fmean, median
from typing import NamedTuple

from mavdem.comparison.flight_figures import FlightFigures
from mavdem.confidence import quantile

MAX_UNCERTAINTY = 0.5  # of an effect, as a share of it: with a wider interval its logarithm is not nearly normal
_Z = quantile()

SHARE, EFFECT, MEAN_EFFECT, DAMPING, LAG = "share", "effect", "mean effect", "damping", "lag"
FEWEST_MOTORS = 3  # of which one is compared with the others
REPORTED = "reported"  # the status of what is compared: what is "biased" is so by as much as wind and steering say


class Quantity(NamedTuple):
    """What is estimated: its ``kind``, of which ``motor`` (from 1; 0: of none), about which ``axis`` ("": of none).

    "share" and "effect" of a motor are beside the median of all motors: what changes one leaves the others alone, and
    what changes all, as the battery does, or biases all estimates, as closed loop does, leaves each alone. "mean
    effect" is that of all. Shares and effects are compared by their logarithm, the others as they are.
    """

    kind: str
    motor: int = 0
    axis: str = ""


class FlightEstimate(NamedTuple):
    """A value, or its logarithm, and the standard deviation of its error within the flight."""

    value: float
    sd: float


def estimates_of(flight: Sequence[FlightFigures]) -> dict[Quantity, FlightEstimate]:
    """What the rows of one flight, an axis each, estimate of the vehicle."""
    found: dict[Quantity, FlightEstimate] = {}
    for row in flight:
        # The motors' figures are the same on each axis.
        if row.trim_share and row.trim_share_interval and Quantity(SHARE, 1) not in found:
            known_shares = {
                motor: FlightEstimate(log(value), half / value / _Z)
                for motor, (value, half) in enumerate(zip(row.trim_share, row.trim_share_interval, strict=True), 1)
                if value > 0 and half is not None
            }
            found |= _beside_median(SHARE, "", known_shares)
        for kind, known, interval, status in (
            (DAMPING, row.damping, row.damping_interval, row.damping_status),
            (LAG, row.lag, row.lag_interval, row.lag_status),
        ):
            if known is not None and interval is not None and status == REPORTED:
                found[Quantity(kind, axis=row.axis or "")] = FlightEstimate(known, interval / _Z)
        found |= _effects(row)
    return found


def _effects(row: FlightFigures) -> dict[Quantity, FlightEstimate]:
    """Logarithms of the mean effect on the row's axis and of each motor's beside the others', if known well enough."""
    if not row.effect or not row.effect_interval or row.effect_status != REPORTED:
        return {}
    axis = row.axis or ""
    known = {
        motor: FlightEstimate(log(abs(value)), half / abs(value) / _Z)
        for motor, (value, half) in enumerate(zip(row.effect, row.effect_interval, strict=True), start=1)
        if half is not None and isfinite(half) and half < MAX_UNCERTAINTY * abs(value)
    }
    if not known:
        return {}
    # Errors of the motors' effects have much in common: their mean is hardly known better than each.
    found = {
        Quantity(MEAN_EFFECT, 0, axis): FlightEstimate(
            fmean(one.value for one in known.values()), max(one.sd for one in known.values())
        )
    }
    of_motors = row.motors is not None and len(row.motors) == len(row.effect)
    return found | (_beside_median(EFFECT, axis, known) if of_motors else {})


def _beside_median(kind: str, axis: str, known: Mapping[int, FlightEstimate]) -> dict[Quantity, FlightEstimate]:
    """Each motor's logarithm less the median of all; of too few motors none."""
    if len(known) < FEWEST_MOTORS:
        return {}
    middle = median(one.value for one in known.values())
    return {Quantity(kind, motor, axis): FlightEstimate(one.value - middle, one.sd) for motor, one in known.items()}
