"""Physical parameters over time as lines of one plot: control effectiveness, damping and motor time constant.

Their units differ, and so do their sizes. Each is drawn in a power of ten of its unit, which the legend names, so that
all are numbers of about 1 to 4.
"""

from math import floor, log10
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.plant import Physical
from mavdem.report.numbers import TORQUE_UNIT, unit_per_input
from mavdem.report.palette import distinct

LARGEST_SHOWN_NUMBER = 4.0
"""A parameter is drawn as a number of a tenth of this up to this: a choice, for an axis that ends at about 5."""


class ParameterTrace(NamedTuple):
    """How one physical parameter is drawn."""

    name: str
    """Name in the legend, with the unit."""

    colour: str
    """Colour of the palette."""

    scale: float
    """Factor from the unit of data to the unit in the legend."""


def parameter_traces(physical: Physical, input_unit: str) -> tuple[ParameterTrace, ...]:
    """Returns how control effectiveness, damping and motor time constant are drawn, in this order.

    Args:
        physical: the first estimate, whose magnitudes decide the power of ten of each unit.
        input_unit: unit of the inputs.

    Returns:
        Name, unit, scale and colour of each of the three lines.
    """
    # Parameters that are not identifiable yet have an estimate, too, whose magnitude is good enough for the scale.
    mean_effect, _ = physical.mean_effect()
    effect_unit = unit_per_input(TORQUE_UNIT, input_unit)
    return (
        _parameter_trace("effectiveness", effect_unit, TORQUE_UNIT.scale, mean_effect, distinct(0)),
        _parameter_trace("damping", "1/s", 1.0, physical.damping, distinct(1)),
        _parameter_trace("time constant", "ms", 1e3, physical.lag, distinct(2)),
    )


def _parameter_trace(
    name: str, unit: str, unit_scale: float, value: float, colour: str
) -> ParameterTrace:
    """Chooses the power of ten in which a parameter is drawn.

    Args:
        name: name of the parameter.
        unit: unit that people read.
        unit_scale: factor from the unit of data to the unit that people read.
        value: the parameter, in the unit of data.
        colour: colour of the palette.

    Returns:
        The parameter's line: its name with unit, its colour, and the factor from data to the plot.
    """
    shown_value = max(unit_scale * abs(value), np.finfo(np.float64).tiny)
    power = floor(log10(shown_value / LARGEST_SHOWN_NUMBER)) + 1
    power_text = "" if power == 0 else f"{10.0**power:g} "
    return ParameterTrace(f"{name} ({power_text}{unit})", colour, unit_scale / 10.0**power)


def parameter_estimates(physical: Physical) -> Array:
    """Returns mean control effectiveness, damping and time constant, each with the half width of its band.

    Args:
        physical: control effectiveness, damping, time constant and delay of one axis.

    Returns:
        Values and half widths of their 90 % intervals, (3, 2): rad/s² per unit of input, 1/s and s. Both are NaN where
        a parameter is not identifiable.
    """
    interval = physical.interval_90_percent
    estimates = np.array(
        [
            physical.mean_effect(),
            (physical.damping, interval.damping),
            (physical.lag, interval.lag),
        ]
    )
    estimates[np.isnan(estimates[:, 1])] = np.nan
    return estimates
