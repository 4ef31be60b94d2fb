"""Status: how flight, link and learning stand, as a Markdown document."""

from __future__ import annotations

from math import isfinite

from mavdem.dem.online import TOO_FEW
from mavdem.view.live.row import Channels, Row, Status


def status_document(channels: Channels, status: Status, row: Row | None, dropped: int) -> str:
    """What a pilot must know beside the pictures.

    Args:
        channels: what the numbers are.
        status: the latest.
        row: the latest, if there is any.
        dropped: how many rows this view could not show.
    """
    facts = {"samples": f"{status.samples:,} at {1 / channels.dt:.4g} Hz"}
    if row is not None:
        facts["boot clock"] = f"{row.time - row.shift:,.1f} s" + (
            f" since a reboot; shown as {row.time:,.1f} s" if row.shift else ""
        )
    facts |= {name: f"{rate:.1f} Hz" for name, rate in status.rates.items()}
    facts["frames lost"] = f"{status.lost:,}"
    if isfinite(status.latency):
        facts["latency"] = f"{1000 * status.latency:.0f} ms"
    if dropped:
        facts["rows not shown"] = f"{dropped:,}: this view could not keep up"
    first, *others = (f"| {name} | {fact} |" for name, fact in facts.items())
    table = "\n".join([first, "|---|---|", *others])
    return "\n\n".join([f"**{channels.title}**", _learning(status, row), table, *_cautions(row), READING])


READING = (
    "Thin lines beside a thick one are its 90 % band. y ← x is the entry of A or B by which x drives y, in the model's "
    "units. Surprise is how far F(t) lies below its recent median: 1 is the worst of twenty samples; from 3 on it is "
    "marked."
)


def _learning(status: Status, row: Row | None) -> str:
    if row is None or row.estimate is None or row.estimate.model is None:
        return f"No model yet: {status.obstacle or TOO_FEW}."
    age = max(0.0, row.estimate.time - row.estimate.until)
    learnt = f"The model was learnt up to {age:.1f} s ago"
    return f"{learnt}; {status.obstacle}." if status.obstacle else f"{learnt}."


def _cautions(row: Row | None) -> list[str]:
    if row is None or row.learned is None or not row.learned.cautions:
        return []
    return ["**Cautions:** " + " ".join(row.learned.cautions)]
