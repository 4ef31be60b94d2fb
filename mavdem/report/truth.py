"""Estimates of a simulated flight beside its truth."""

from math import isfinite

from mavdem.experiments.truth import ComparedParameter, TruthComparison
from mavdem.facts import Level
from mavdem.facts.identifiability import Status
from mavdem.report.blocks import Blocks, Rated, Table
from mavdem.report.numbers import display_unit, plus_minus, rounded
from mavdem.report.templates import render_section

NAMES = {
    "mean effect": "mean effectiveness",
    "damping": "rate damping",
    "lag of the motors": "motor time constant",
}
"""What a parameter is called where it is shown."""


def truth_blocks(comparison: TruthComparison) -> Blocks:
    """Returns a row a parameter with the truth beside it, and how the wind torque compares, in a ``comparison``."""
    wind = comparison.wind
    compared = list(comparison.parameters)
    if wind is not None and wind.resolved:
        compared.append(wind.mean)
    held = [parameter.inside for parameter in compared if parameter.inside is not None]
    heading, *torque = render_section("truth", source=comparison.source, held=held, wind=wind)
    header = ["", "estimate", "truth", "error", "unit", "inside"]
    return [heading, *([Table(header, list(map(_row, compared)))] if compared else []), *torque]


def _row(parameter: ComparedParameter) -> list[str]:
    """Degrees for radians, ms for s; the error in percent of the truth, where that is no number near 0."""
    unit, scale = ("ms", 1e3) if parameter.unit == "s" else display_unit(parameter.unit)
    estimate, half, truth = (
        scale * value for value in (parameter.estimate, parameter.half_width, parameter.truth)
    )
    near = abs(estimate - truth) < 10.0 * abs(truth)
    inside: str = Rated(parameter.status, Level.BAD)  # without an interval
    if parameter.inside is not None:
        biased = ", biased" if parameter.status is Status.BIASED else ""
        inside = f"{'yes' if parameter.inside else 'no'}{biased}"
    return [
        NAMES.get(parameter.name, parameter.name.replace("effect of", "effectiveness of")),
        plus_minus(estimate, half) if isfinite(half) else rounded(estimate),
        rounded(truth, 3),
        f"{round(100 * (estimate / truth - 1)) + 0:+d} %" if near else "",
        unit,
        inside,
    ]
