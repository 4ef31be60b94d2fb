"""The report of a live flight: how well it was predicted, what was learnt from, and what happened when.

The report of estimates beside the truth of a simulated flight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite, sqrt

from mavdem.evaluate.truth import ComparedParameter, ComparedWind, TruthComparison
from mavdem.health.motor_watch import FALSE_ALARMS_BASIS
from mavdem.live.history import ACCOUNT, AHEAD, HorizonErrors, LiveHistory, SessionStatus
from mavdem.report.blocks import Sentence, Table
from mavdem.report.numbers import named, plus_minus, readable, rounded, with_unit


def live_report(
    history: LiveHistory, status: SessionStatus, account: Mapping[str, float], axis: str
) -> list[Sentence | Table]:
    """The errors of what was predicted, the parts learnt from, and the events; times in s from the beginning.

    ``account`` are seconds by the keys of ``ACCOUNT``.
    """
    errors = history.errors()
    blocks: list[Sentence | Table] = [Sentence("", lead=_headline(errors, axis))]
    blocks += [Sentence(alarm.sentence.removeprefix("Alarm: "), "Motors:") for alarm in status.alarms]
    if any(alarm.motor is not None for alarm in status.alarms):
        blocks.append(Sentence(FALSE_ALARMS_BASIS, "False alarms:"))
    if status.obstacle:
        blocks.append(Sentence(status.obstacle, "At the end:"))
    if errors:
        blocks += [
            _errors(errors, axis),
            Sentence(
                "predictions without the motors of the time ahead, made in flight and compared with what came. "
                "Baseline: the last sample held.",
                "How they were made:",
            ),
        ]
    if history.learnt:
        rows = [[f"{first:.0f} s", f"{last:.0f} s", f"{last - first:.0f} s"] for first, last in history.learnt]
        blocks.append(Table(["learned from", "until", "length"], rows))
    spent = [[what[0].upper() + what[1:], f"{account[kind]:.0f} s"] for kind, what in ACCOUNT.items() if account[kind]]
    return [*blocks, Table([f"of {sum(account.values()):.0f} s", "time"], spent), *_link(status)]


def event_blocks(history: LiveHistory) -> list[Sentence | Table]:
    """What happened when."""
    rows = [[f"{event.seconds:.1f} s", event.sentence] for event in history.events]
    return [Table(["time", "what happened"], rows, words=True)] if rows else [Sentence("Nothing happened.")]


def _headline(errors: Sequence[HorizonErrors], axis: str) -> str:
    if not errors:
        return f"Nothing of {axis} was predicted: there was no settled flight to learn from."
    best = min(errors, key=lambda one: abs(one.seconds - AHEAD))
    unit = readable("rad")
    ours, held = (unit.scale * sqrt(square[0]) for square in (best.mse, best.held))
    return (
        f"{axis.capitalize()} was predicted {best.seconds:.2g} s ahead with an RMSE of {ours:.2g}° (baseline "
        f"{held:.2g}°); {100 * best.inside[0]:.0f} % of the samples were inside the 90 % band."
    )


def _errors(errors: Sequence[HorizonErrors], axis: str) -> Table:
    names = [(axis, readable("rad")), (f"{axis} rate", readable("rad/s"))]
    header = ["RMSE of predictions"]
    for name, unit in names:
        header += [named(name, unit.name), "baseline", "in its 90 % band"]
    rows = []
    for one in errors:
        row = [f"{one.seconds:.2g} s ahead"]
        for i, (_, unit) in enumerate(names):
            row += [*(f"{unit.scale * sqrt(square[i]):.2g}" for square in (one.mse, one.held)), f"{one.inside[i]:.0%}"]
        rows.append(row)
    return Table(header, rows)


def _link(status: SessionStatus) -> list[Sentence]:
    if status.vehicle is None:
        return []
    rates = ", ".join(f"{name} {rate:.3g} Hz" for name, rate in sorted(status.rates.items()) if rate)
    parts = [f"vehicle {status.vehicle}", *([f"at the end {rates}"] if rates else [])]
    parts.append(f"{status.lost} messages lost, {status.late} samples too late, {status.unread} frames not decoded")
    return [Sentence(f"{'; '.join(parts)}.", "Link:")]


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
