"""The words of the live view: four figures to see at a glance, and all facts of the link and the learning."""

from __future__ import annotations

from math import isfinite

from mavdem.confidence import LEVEL
from mavdem.dem.online.learner import TOO_FEW
from mavdem.dem.online.tracker import FALSE_MARK_SECONDS
from mavdem.live import SessionStatus
from mavdem.live.history import sentence
from mavdem.report.numbers import plus_minus, readable, with_unit
from mavdem.view.live.rows import Channels, ViewRow

UNKNOWN = "–"

LEGEND = (
    "y ← x is the entry of A or B from x to y, in degrees and seconds. An error ratio is beside the better of the last "
    "sample and the mean. Surprise is how far F(t) is below its recent median: 1 is the worst of twenty samples. A "
    f"mark is where it stays above what is usual in this flight; one in {FALSE_MARK_SECONDS / 60:.0f} minutes is "
    "expected without a change."
)


def figures(channels: Channels, status: SessionStatus, row: ViewRow, until: float | None) -> tuple[str, ...]:
    """Four Markdown documents: the state, the prediction, the wind's torque, and the physical parameters.

    ``row`` is the latest one that was learned from, or the latest; the model was learnt ``until`` s of the boot clock.
    """
    output, now, unit = channels.output_names[0], row.estimate, readable("rad/s²")
    state = "learning" if not status.obstacle and until is not None else "waiting"
    if status.alarm:
        state = "alarm"
    said = status.alarm or _reason(status, until)
    shown = {"State": (f"{state}, {status.learned * channels.dt:.0f} s learned", said)}
    error = torque = effect = (UNKNOWN, "")
    (seconds, half), (ahead, ratio) = status.ahead, status.useful
    if isfinite(half):
        useful = f"; error ratio {ratio:.2f} at {ahead:.2g} s" if isfinite(ratio) else ""
        error = f"± {with_unit(half, readable(channels.output_units[0]))}", f"{seconds:.2g} s ahead (90 %){useful}"
    if now is not None and isfinite(now.wind_torque):
        sizes = unit.scale * now.wind_torque, unit.scale * now.wind_torque_band
        torque = f"{plus_minus(*sizes)} {unit.name}", "now, steady part included (90 %)"
    if now is not None and now.physical is not None:
        read, names = now.physical, (f"{unit.name} per {channels.input_units[0] or 'unit'}", "1/s")
        pairs = [unit.scale * value for value in read.mean_effect(LEVEL)], (read.damping, read.interval(LEVEL).damping)
        words = [
            f"{plus_minus(*pair)} {name}" if isfinite(pair[1]) else "not identifiable"
            for pair, name in zip(pairs, names, strict=True)
        ]
        effect = words[0], f"damping {words[1]}"
    shown |= {f"Error of the predicted {output}": error, "Wind's torque": torque, "Motor effect": effect}
    return tuple(f"{name}\n### {value}\n{remark}" for name, (value, remark) in shown.items())


def _reason(status: SessionStatus, until: float | None) -> str:
    return sentence(status.obstacle or (TOO_FEW if until is None else "")) or "The model follows the flight."


def status_document(channels: Channels, status: SessionStatus, row: ViewRow, until: float | None, dropped: int) -> str:
    """The latest status and row as a Markdown document, with the number of rows that this view has dropped.

    The latest model was learnt ``until`` s of the boot clock; None before the first.
    """
    facts = {"samples": f"{status.learned + status.shown:,} at {1 / channels.dt:.4g} Hz"}
    reboot = f" since a reboot; shown as {row.time:,.1f} s" if row.shift else ""
    facts["boot clock"] = f"{row.time - row.shift:,.1f} s{reboot}"
    facts |= {name: f"{rate:.1f} Hz" for name, rate in status.rates.items()}
    facts["frames lost"] = f"{status.lost:,}"
    if isfinite(status.latency[0]):
        facts["latency"] = f"{1000 * status.latency[0]:.0f} ms"
    if dropped:
        facts["rows not shown"] = f"{dropped:,}: this view is too slow"
    first, *others = (f"| {name} | {fact} |" for name, fact in facts.items())
    if until is None:
        learning = f"No model yet. {_reason(status, until)}"
    elif row.estimate is None:
        learning = f"The latest model is kept; the samples now are not settled flight. {sentence(status.obstacle)}"
    else:
        ago = max(0.0, row.estimate.time - until)
        learning = f"The model was learned up to {ago:.1f} s ago. {sentence(status.obstacle)}"
    cautions = [f"**Cautions:** {' '.join(row.learned.cautions)}"] if row.learned and row.learned.cautions else []
    table = "\n".join([first, "|---|---|", *others])
    return "\n\n".join([f"**{channels.title}**", learning.strip(), table, *cautions, LEGEND])
