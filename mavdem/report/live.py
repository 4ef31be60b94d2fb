"""The report of a live flight: how well it was predicted, what was learnt from, and what happened when."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import sqrt

from mavdem.health.motor_watch import FALSE_ALARMS_BASIS
from mavdem.live.history import ACCOUNT, AHEAD, HorizonErrors, LiveHistory, SessionStatus
from mavdem.report.blocks import Sentence, Table
from mavdem.report.names import named, readable


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
