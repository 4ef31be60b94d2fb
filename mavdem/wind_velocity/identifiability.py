"""How well a flight determines drag, speed and direction of the wind, and facts (coded findings) about the doubts."""

from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.facts import Fact
from mavdem.facts.identifiability import Status
from mavdem.facts.online import DragSource
from mavdem.facts.wind import WindDoubt
from mavdem.wind_velocity.beaufort import LIGHT_BREEZE
from mavdem.wind_velocity.mean_wind import MeanWind, lower_speed_bound
from mavdem.wind_velocity.vehicle_drag import LEAN, LOG_COEFFICIENTS

REPORTED_SPEED_ERROR = 0.7
"""Half width of the speed's interval, m/s, up to which the speed is reported."""

REPORTED_RELATIVE_ERROR = 0.12
"""Half width of the speed's interval, relative to the speed, up to which the speed is reported."""

BIASED_SPEED_RATIO = 8.0
"""Ratio of the ends of the speed's interval up to which the speed is reported as biased."""

MIN_RATIO_SPEED = 0.3
"""Least lower end of the interval, m/s, in that ratio."""

REPORTED_DIRECTION_ERROR = 10.0
"""Half width of the direction's interval, degrees, up to which the direction is reported."""

MAX_DIRECTION_INTERVAL = 60.0
"""Half width of the direction's interval, degrees, up to which the direction is reported as biased."""

REPORTED_DRAG_SD = 0.18
"""Relative standard deviation of the drag up to which it is reported."""

MAX_REMAINING_DRAG_SD = 0.8
"""Standard deviation of the drag, relative to the prior's, beyond which the flight has not identified it."""


class DoubtedFigure(NamedTuple):
    """A figure of the wind that is not reported, and why."""

    figure: str
    """"drag", "speed" or "direction"."""

    status: Status
    """BIASED or NOT_IDENTIFIABLE."""

    reason: Fact
    """Reason why it is not reported."""


def speed_status(speed: float, low: float, high: float) -> Status:
    """Judges how well a wind speed is known, by its 90 % interval.

    Args:
        speed: estimated speed, m/s.
        low: lower end of its interval, m/s.
        high: upper end of its interval, m/s.

    Returns:
        "Reported" if half of the interval is small, absolutely or relative to the speed; "biased" if the ratio of the
        ends is not too large, or if there is at most a light breeze; otherwise "not identifiable".
    """
    half_width = (high - low) / 2
    if half_width <= max(REPORTED_SPEED_ERROR, REPORTED_RELATIVE_ERROR * speed):
        return Status.REPORTED
    if high <= BIASED_SPEED_RATIO * max(low, MIN_RATIO_SPEED):
        return Status.BIASED
    # Still air has no ratio. It is reported as below the upper end.
    may_be_calm = not lower_speed_bound(low, high)
    if may_be_calm and high <= LIGHT_BREEZE:
        return Status.BIASED
    return Status.NOT_IDENTIFIABLE


def is_lean_more_uncertain(mean_winds: Array, parameter_samples: Array) -> bool:
    """Returns whether the uncertain lean makes the speed of the mean wind more uncertain than the uncertain drag does.

    The speed is the component along the mean direction. Its variance over the samples is compared with the part that a
    linear regression on the lean explains, and with the part that one on the drag explains.

    Args:
        mean_winds: mean wind velocity by each of N posterior samples, north and east (N, 2), m/s.
        parameter_samples: the samples (N, 10) of the scaled parameters, among them the drag and the lean.
    """
    mean_direction = mean_winds.mean(axis=0)
    # These are proportional to the speeds: the direction need not be a unit vector, since only ratios are compared.
    speeds = mean_winds @ mean_direction
    variance_by_lean = _explained_variance(speeds, parameter_samples[:, LEAN])
    variance_by_drag = _explained_variance(speeds, parameter_samples[:, LOG_COEFFICIENTS])
    return variance_by_lean > variance_by_drag


def _explained_variance(values: Array, regressors: Array) -> float:
    """Returns the variance of values (N,) that a linear regression on k regressors (N, k) explains."""
    centred = regressors - regressors.mean(axis=0)
    coefficients = np.linalg.lstsq(centred, values - values.mean(), rcond=None)[0]
    return float(np.var(centred @ coefficients))


def doubts_on_wind(
    mean: MeanWind,
    drag_sd: float,
    remaining_sd: float,
    is_lean_worse: bool,
    steered_share: float,
    ground_speed: float,
    prior_source: DragSource,
) -> list[DoubtedFigure]:
    """Returns the reasons why drag, speed or direction are not reported.

    A figure is reported if its interval is narrow enough. Otherwise its status is biased, which means that it is given
    with a warning, or not identifiable, which means that the flight hardly determines it.

    Args:
        mean: mean wind of the flight.
        drag_sd: relative standard deviation of the drag force at the air speed of the flight.
        remaining_sd: standard deviation after the flight, relative to the one before it (the prior's).
        is_lean_worse: whether the speed is more uncertain by the lean than by the drag.
        steered_share: fraction of the force's variance that manoeuvres explain, 0 to 1; only they determine the drag.
        ground_speed: largest speed over ground in the flight, m/s.
        prior_source: source of the prior of the drag.

    Returns:
        The figures that are not reported, each with its status and reason.
    """
    doubts = []
    is_drag_uncertain = drag_sd > REPORTED_DRAG_SD
    if is_drag_uncertain:
        doubts.append(_drag_doubt(drag_sd, remaining_sd, steered_share, ground_speed, prior_source))
    if speed_status(mean.speed, mean.low, mean.high) is not Status.REPORTED:
        doubts.append(_speed_doubt(mean, is_by_drag=is_drag_uncertain and not is_lean_worse))
    if mean.direction_half_width > REPORTED_DIRECTION_ERROR:
        doubts.append(_direction_doubt(mean))
    return doubts


def _drag_doubt(
    drag_sd: float,
    remaining_sd: float,
    steered_share: float,
    ground_speed: float,
    prior_source: DragSource,
) -> DoubtedFigure:
    """Returns why an uncertain drag is not reported; the arguments are those of :func:`doubts_on_wind`."""
    status = Status.BIASED
    if remaining_sd > MAX_REMAINING_DRAG_SD:
        status = Status.NOT_IDENTIFIABLE
    reason = Fact(
        WindDoubt.DRAG_UNSURE,
        status=status,
        relative_sd=drag_sd,
        source=prior_source,
        steered=steered_share,
        ground_speed=ground_speed,
    )
    return DoubtedFigure("drag", status, reason)


def _speed_doubt(mean: MeanWind, *, is_by_drag: bool) -> DoubtedFigure:
    """Returns why an uncertain speed is not reported.

    Args:
        mean: mean wind of the flight.
        is_by_drag: whether the uncertain drag of the vehicle is the main cause, and not its uncertain lean.
    """
    status = speed_status(mean.speed, mean.low, mean.high)
    reason = Fact(
        WindDoubt.SPEED_UNSURE,
        status=status,
        low=lower_speed_bound(mean.low, mean.high),
        high=mean.high,
        by_drag=is_by_drag,
    )
    return DoubtedFigure("speed", status, reason)


def _direction_doubt(mean: MeanWind) -> DoubtedFigure:
    """Returns why an uncertain direction is not reported.

    Args:
        mean: mean wind of the flight.
    """
    status = Status.NOT_IDENTIFIABLE
    if mean.direction_half_width <= MAX_DIRECTION_INTERVAL:
        status = Status.BIASED
    interval = np.radians(mean.direction_half_width)
    reason = Fact(WindDoubt.DIRECTION_UNSURE, direction_interval=interval)
    may_be_calm = lower_speed_bound(mean.low, mean.high) == 0
    if may_be_calm:
        # Then the calm is the reason, and not how the autopilot is mounted.
        reason = reason.replace(calm=True)
    return DoubtedFigure("direction", status, reason)
