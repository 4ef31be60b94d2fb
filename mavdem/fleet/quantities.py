"""The quantities of motors, plant and loops that are compared between flights, and their estimates from one flight.

They belong to the vehicle and its gains, and not to the wind. The trim share and the effect of a motor are relative to
the median of all motors: a change of one motor leaves the others unchanged, and a change of all, such as by the
battery's voltage or by the bias of the closed loop, leaves each unchanged.
"""

from collections.abc import Iterable, Mapping
from math import isfinite, log
from statistics import fmean, median
from typing import NamedTuple

from mavdem.confidence import coverage_factor
from mavdem.containers import Numbers
from mavdem.dem.record import MIN_MOTORS
from mavdem.facts.identifiability import Status
from mavdem.fleet.flights import AxisRows

SHARE = "share"
"""Trim share of a motor: its mean command in hover, relative to the median motor."""

EFFECT = "effect"
"""Control effectiveness of a motor, relative to the median motor."""

MEAN_EFFECT = "mean effect"
"""Mean control effectiveness of all motors about one axis."""

DAMPING = "damping"
"""Rate damping about one axis, 1/s."""

LAG = "lag"
"""Motor time constant, as estimated from one axis, s."""

PHASE_MARGIN = "phase margin"
"""Phase margin of the rate loop of one axis, rad."""

GAIN_MARGIN = "gain margin"
"""Gain margin of the rate loop of one axis, dB."""

MAX_SENSITIVITY = "maximum sensitivity"
"""Maximum sensitivity Ms of the rate loop of one axis."""

ATTITUDE_PHASE_MARGIN = "attitude phase margin"
"""Phase margin of the attitude loop of one axis, rad."""

ATTITUDE_GAIN_MARGIN = "attitude gain margin"
"""Gain margin of the attitude loop of one axis, dB."""

OVERSHOOT = "overshoot"
"""Overshoot of the measured rate of one axis after a step of its setpoint, as a fraction of the step."""

RISE = "rise"
"""Rise time of the measured rate of one axis after a step of its setpoint, s."""

ATTITUDE_LOOP_KINDS = ATTITUDE_PHASE_MARGIN, ATTITUDE_GAIN_MARGIN
"""Kinds of quantities of an attitude loop, which depend on its gain and on those of the rate loop within it."""

LOOP_KINDS = PHASE_MARGIN, GAIN_MARGIN, MAX_SENSITIVITY, *ATTITUDE_LOOP_KINDS, OVERSHOOT, RISE
"""Kinds of quantities of rate and attitude loops, which depend on the gains."""

LOGARITHMIC_KINDS = SHARE, EFFECT, MEAN_EFFECT, MAX_SENSITIVITY, RISE
"""Kinds of quantities that are compared by their logarithm."""

MAX_RELATIVE_HALF_WIDTH = 0.5
"""Largest half width of the interval of a quantity that is compared by its logarithm, relative to it: a choice.

With a wider interval the error of its logarithm is not nearly normal.
"""

HALF_WIDTH_PER_SD = coverage_factor()
"""Half width of the 90 % intervals of flights, in standard deviations."""


class Quantity(NamedTuple):
    """A quantity that is compared: by its logarithm if its kind is one of ``LOGARITHMIC_KINDS``, otherwise as it is."""

    kind: str
    """``SHARE``, ``EFFECT``, ``MEAN_EFFECT``, ``DAMPING``, ``LAG``, or one of ``LOOP_KINDS``."""

    motor: int = 0
    """Number of the motor, from 1; 0 where the quantity is of no single motor."""

    axis: str = ""
    """Axis, "roll", "pitch" or "yaw"; empty where the quantity is of no axis."""

    @property
    def is_of_motor(self) -> bool:
        """Whether it is a quantity of one motor; otherwise it is one of an axis or of the whole vehicle."""
        return self.motor != 0


class Estimate(NamedTuple):
    """An estimate of a quantity from one flight."""

    value: float
    """The quantity, or its logarithm."""

    sd: float
    """Standard deviation of its error within the flight."""


def flight_estimates(flight: AxisRows) -> dict[Quantity, Estimate]:
    """Collects the estimates of all compared quantities from one flight.

    Only physical parameters with the status "reported" are taken. The bias of the others depends on wind and steering,
    so that they would seem to change with the weather. In a flight in which a motor failed, the figures of motors are
    means over the time before and after, which mean neither; so they are left out.

    Args:
        flight: the rows of roll, pitch and yaw. Half widths of 90 % intervals become standard deviations.

    Returns:
        By quantity: logarithms, relative to the median motor, of trim shares and effects; the logarithm of the mean
        effect by axis; the damping, 1/s, the motor time constant, s, and the ``LOOP_KINDS``, by axis.
    """
    estimates: dict[Quantity, Estimate] = {}
    effects_by_axis: dict[Quantity, list[Estimate]] = {}
    for row in flight:
        axis = row.axis or ""
        has_failed_motor = row.failed_motor is not None
        if not has_failed_motor:
            # The motors' trim is the same in the rows of all axes.
            shares = motor_log_estimates(row.trim_share, row.trim_share_interval)
            estimates |= relative_to_median_motor(SHARE, shares)

        axis_estimates = {
            PHASE_MARGIN: estimate_from_interval(row.phase_margin, row.phase_margin_interval),
            GAIN_MARGIN: estimate_from_interval(row.gain_margin, row.gain_margin_interval),
            MAX_SENSITIVITY: log_estimate(row.ms, row.ms_interval),
            ATTITUDE_PHASE_MARGIN: estimate_from_interval(
                row.attitude_phase_margin, row.attitude_phase_margin_interval
            ),
            ATTITUDE_GAIN_MARGIN: estimate_from_interval(
                row.attitude_gain_margin, row.attitude_gain_margin_interval
            ),
            OVERSHOOT: estimate_from_interval(row.rate_overshoot, row.rate_overshoot_interval),
            RISE: log_estimate(row.rate_rise, row.rate_rise_interval),
        }
        if row.damping_status == Status.REPORTED:
            axis_estimates[DAMPING] = estimate_from_interval(row.damping, row.damping_interval)
        if row.lag_status == Status.REPORTED:
            axis_estimates[LAG] = estimate_from_interval(row.lag, row.lag_interval)
        for kind, estimate in axis_estimates.items():
            if estimate is not None:
                estimates[Quantity(kind, axis=axis)] = estimate

        effects = motor_log_estimates(row.effect, row.effect_interval)
        if effects and row.effect_status == Status.REPORTED:
            estimates[Quantity(MEAN_EFFECT, axis=axis)] = mean_estimate(effects.values())
            # A model may have the controller's demand as its input in place of the motors.
            are_of_motors = len(row.motors or ()) == len(row.effect or ())
            if are_of_motors and not has_failed_motor:
                for quantity, effect in relative_to_median_motor(EFFECT, effects).items():
                    effects_by_axis.setdefault(quantity, []).append(effect)
    # A motor that weakens loses the same factor of its effect about every axis. So the axes give one estimate.
    for quantity, effects_of_axes in effects_by_axis.items():
        estimates[quantity] = mean_estimate(effects_of_axes)
    return estimates


def estimate_from_interval(value: float | None, half_width: float | None) -> Estimate | None:
    """Returns an estimate with its standard deviation.

    A loop that no gain makes unstable has an infinite margin, with which nothing can be compared.

    Args:
        value: the estimate.
        half_width: half width of its 90 % interval, in the same unit.

    Returns:
        The estimate; None if value or interval are unknown or infinite.
    """
    if value is None or half_width is None or not isfinite(value + half_width):
        return None
    return Estimate(value, half_width / HALF_WIDTH_PER_SD)


def log_estimate(value: float | None, half_width: float | None) -> Estimate | None:
    """Returns the logarithm of a positive quantity with its error.

    To first order, the error of ln x is the error of x divided by x. This holds for small errors only, so a value with
    a wider interval than ``MAX_RELATIVE_HALF_WIDTH`` is left out.

    Args:
        value: the quantity. Its sign is ignored: a motor's effect is negative on one side of the axis.
        half_width: half width of its 90 % interval, in the same unit.

    Returns:
        The logarithm with its error; None if the quantity is unknown or too uncertain.
    """
    if value is None or half_width is None:
        return None
    magnitude = abs(value)
    # Written with "not", so that NaN counts as too uncertain.
    if not half_width < MAX_RELATIVE_HALF_WIDTH * magnitude:
        return None
    relative_half_width = half_width / magnitude
    return Estimate(log(magnitude), relative_half_width / HALF_WIDTH_PER_SD)


def mean_estimate(estimates: Iterable[Estimate]) -> Estimate:
    """Returns the mean of estimates whose errors have much in common.

    Errors in common do not cancel in the mean. So its standard deviation is taken to be the largest of the estimates,
    and not smaller by the root of their number.

    Args:
        estimates: at least one estimate, such as the same logarithm for several motors or axes.

    Returns:
        The mean with its standard deviation, in the unit of the estimates.
    """
    values = []
    standard_deviations = []
    for estimate in estimates:
        values.append(estimate.value)
        standard_deviations.append(estimate.sd)
    return Estimate(value=fmean(values), sd=max(standard_deviations))


def motor_log_estimates(values: Numbers | None, half_widths: Numbers | None) -> dict[int, Estimate]:
    """Returns the logarithm of a quantity of each motor, so that a change by a factor is a difference.

    Args:
        values: one value for each motor (r,), in any unit.
        half_widths: half widths of their 90 % intervals (r,), in the same unit.

    Returns:
        Estimates by the number of the motor, from 1.
    """
    estimates = {}
    values_and_half_widths = zip(values or (), half_widths or (), strict=False)
    for motor, (value, half_width) in enumerate(values_and_half_widths, start=1):
        estimate = log_estimate(value, half_width)
        if estimate is not None:
            estimates[motor] = estimate
    return estimates


def relative_to_median_motor(
    kind: str, estimates: Mapping[int, Estimate]
) -> dict[Quantity, Estimate]:
    """Returns each motor's logarithm less the median of all motors: how far the motor is from the typical one.

    What all motors have in common, such as the battery's voltage, drops out. The median does not move if a single motor
    changes, so the others stay unchanged. The error of the median is neglected.

    Args:
        kind: kind of the quantity, ``SHARE`` or ``EFFECT``.
        estimates: logarithms by the number of the motor.

    Returns:
        Estimates by quantity; nothing with fewer than ``MIN_MOTORS``, whose median is no typical motor.
    """
    if len(estimates) < MIN_MOTORS:
        return {}
    median_value = median(estimate.value for estimate in estimates.values())
    relative = {}
    for motor, estimate in estimates.items():
        relative[Quantity(kind, motor)] = Estimate(estimate.value - median_value, estimate.sd)
    return relative
