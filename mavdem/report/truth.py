"""The estimates of a simulated flight beside its truth, as a table and sentences."""

from math import isfinite

from mavdem.experiments.truth import ComparedParameter, TruthComparison
from mavdem.facts import Level
from mavdem.facts.identifiability import Status
from mavdem.report.blocks import Blocks, Rated, Table
from mavdem.report.numbers import DisplayUnit, display_unit, plus_minus, rounded
from mavdem.report.templates import render_section

PARAMETER_NAMES = {
    "mean effect": "mean effectiveness",
    "damping": "rate damping",
    "lag of the motors": "motor time constant",
}
"""Names shown for parameters whose names in a comparison are others."""

MAX_SHOWN_ERROR = 10.0
"""Relative error up to which it is shown in percent: near a truth of 0 it has no meaning."""


def truth_blocks(comparison: TruthComparison) -> Blocks:
    """Returns the report on a simulated flight that compares the estimates with the true values of the simulation.

    A sentence states how many 90 % intervals contain the true value, a table has all parameters, and further sentences
    compare the wind torque.

    Args:
        comparison: estimates with their 90 % intervals, and the parameters of the simulation.
    """
    wind_torque = comparison.wind
    parameters = list(comparison.parameters)
    # The mean wind torque has an estimate only if the torque is larger than its error.
    if wind_torque is not None and wind_torque.resolved:
        parameters.append(wind_torque.mean)
    interval_count = 0
    inside_count = 0
    for parameter in parameters:
        # A parameter that is not identifiable has no interval.
        if parameter.inside is not None:
            interval_count += 1
            if parameter.inside:
                inside_count += 1
    blocks: Blocks = [
        *render_section(
            "truth",
            source=comparison.source,
            inside_count=inside_count,
            interval_count=interval_count,
            wind=wind_torque,
        )
    ]
    if parameters:
        header = ["", "estimate", "truth", "error", "unit", "inside"]
        rows = [_parameter_row(parameter) for parameter in parameters]
        # The first sentence counts the intervals; those on the wind follow the table.
        blocks.insert(1, Table(header, rows))
    return blocks


def _parameter_row(parameter: ComparedParameter) -> list[str]:
    """Returns the row of a parameter in a table that compares estimates with the truth of a simulation.

    The estimate counts as inside if its 90 % interval holds the truth. Times are shown in ms, angles in degrees.

    Args:
        parameter: estimate and truth of one parameter.

    Returns:
        Name, estimate, truth, error in percent, unit, and whether the estimate is inside.
    """
    unit = DisplayUnit("ms", 1e3) if parameter.unit == "s" else display_unit(parameter.unit)
    estimate = unit.scale * parameter.estimate
    half_width = unit.scale * parameter.half_width
    truth = unit.scale * parameter.truth
    error = ""
    if abs(estimate - truth) < MAX_SHOWN_ERROR * abs(truth):
        # Adding 0 turns a rounded −0 into 0, so that its sign is +.
        error = f"{round(100 * (estimate / truth - 1)) + 0:+d} %"
    default_name = parameter.name.replace("effect of", "effectiveness of")
    estimate_text = rounded(estimate)
    if isfinite(half_width):
        estimate_text = plus_minus(estimate, half_width)
    return [
        PARAMETER_NAMES.get(parameter.name, default_name),
        estimate_text,
        rounded(truth, 3),
        error,
        unit.name,
        _inside_text(parameter),
    ]


def _inside_text(parameter: ComparedParameter) -> str:
    """Returns whether the interval of a parameter holds the truth: "yes" or "no", or its status without an interval."""
    if parameter.inside is None:
        return Rated(parameter.status, Level.BAD)
    text = "yes" if parameter.inside else "no"
    return f"{text}, biased" if parameter.status is Status.BIASED else text
