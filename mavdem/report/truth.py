"""The report of estimates beside the truth of a simulated flight."""

from __future__ import annotations

from math import isfinite

from mavdem.evaluate.truth import ComparedParameter, ComparedWind, TruthComparison
from mavdem.report.blocks import Sentence, Table
from mavdem.report.names import readable
from mavdem.report.rounding import plus_minus, rounded, with_unit

LARGEST_ERROR = 10.0  # of the truth, from which on it is not shown in percent


def truth_blocks(found: TruthComparison) -> list[Sentence | Table]:
    """A row a parameter with the truth beside it, and how the wind's torque compares."""
    compared = list(found.parameters)
    if found.wind is not None and found.wind.resolved:
        compared.append(found.wind.mean)
    held = [one.inside for one in compared if one.inside is not None]
    count = f" {sum(held)} of {len(held)} intervals hold the truth." if held else ""
    blocks: list[Sentence | Table] = [
        Sentence(f"of {found.source}; ± is the half width of the 90 % interval.{count}", "Truth:")
    ]
    if compared:
        blocks.append(Table(["", "estimate", "truth", "error", "unit", "inside"], [_row(one) for one in compared]))
    return [*blocks, *([] if found.wind is None else [_wind(found.wind)])]


def _row(one: ComparedParameter) -> list[str]:
    unit, scale = _shown(one.unit)
    estimate, half, truth = (scale * value for value in (one.estimate, one.half_width, one.truth))
    inside = {None: one.status, True: "yes", False: "no"}[one.inside]
    return [
        one.name,
        plus_minus(estimate, half) if isfinite(half) else rounded(estimate),
        rounded(truth, 3),
        _error(estimate, truth),
        unit,
        f"{inside}, biased" if one.status == "biased" else inside,
    ]


def _error(estimate: float, truth: float) -> str:
    """In percent of the truth, where that is no number near 0."""
    return (
        f"{round(100 * (estimate / truth - 1)) + 0:+d} %" if abs(estimate - truth) < LARGEST_ERROR * abs(truth) else ""
    )


def _shown(unit: str) -> tuple[str, float]:
    """A unit to show, and what to multiply values by: degrees for radians, ms for s."""
    if unit == "s":
        return "ms", 1e3
    angle, _, per = unit.partition(" per ")
    shown = readable(angle)
    return f"{shown.name}{f' per {per}' if per else ''}", shown.scale


def _wind(found: ComparedWind) -> Sentence:
    unit = readable("rad/s²")
    resolved = "" if found.resolved else " The estimate is not resolved: its expected errors are as large as itself."
    return Sentence(
        f"correlation {found.correlation:.2f}; standard deviation {with_unit(found.sd, unit)}, truth "
        f"{with_unit(found.true_sd, unit)}; {100 * found.inside:.0f} % of the samples inside the 90 % band.{resolved}",
        "Wind's torque beside its truth:",
    )
