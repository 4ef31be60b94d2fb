"""HTML of flights and learnt models for notebooks: a small table, every text escaped."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

import numpy as np

from mavdem.dem import Learned
from mavdem.flight import Flight
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.numbers import named, readable, rounded
from mavdem.report.screen import screen, title

RIGHT, LEFT = (f' style="text-align: {side}"' for side in ("right", "left"))


def flight_html(flight: Flight) -> str:
    """Where the flight is from and how long it is, and a row a channel; in degrees."""
    rows = []
    channels = (
        ("input", flight.input_names, flight.input_units, flight.inputs),
        ("output", flight.output_names, flight.output_units, flight.outputs),
        ("setpoint", flight.setpoint_names, flight.setpoint_units, flight.setpoints),
    )
    for kind, names, units, values in channels:
        for name, unit, column in zip(names, map(readable, units), () if values is None else values.T, strict=True):
            known = unit.scale * column[np.isfinite(column)]
            figures = (known.mean(), known.std(), known.min(), known.max()) if len(known) else ()
            rows.append([named(name, unit.name), kind, *(rounded(figure, 3) for figure in figures)])
    header = ["channel", "is", "mean", "sd", "lowest", "highest"]
    return html_of([title([flight]), Table(header, [row + ["-"] * (len(header) - len(row)) for row in rows])])


def learned_html(learned: Learned) -> str:
    """The screen's report of what the model alone knows: by purpose, the vehicle, the wind, warnings."""
    record = learned.record
    what = f"{len(learned.model.A)} states, from {len(record) * record.dt:.0f} s at {1 / record.dt:.0f} Hz."
    return html_of([Sentence(what, "Learnt model:"), *screen(learned)])


def html_of(blocks: Iterable[Block]) -> str:
    """Paragraphs and tables."""
    return f"<div>{''.join(_paragraph(one) if isinstance(one, Sentence) else _table(one) for one in blocks)}</div>"


def _paragraph(sentence: Sentence) -> str:
    lead = f"<b>{escape(sentence.lead)}</b> " if sentence.lead else ""
    return f"<p>{lead}{escape(sentence.text)}</p>"


def _table(table: Table) -> str:
    head, *rows = (
        "".join(
            f"<{tag}{LEFT if table.words or not place else RIGHT}>{escape(cell)}</{tag}>"
            for place, cell in enumerate(row)
        )
        for tag, row in [("th", table.header), *(("td", row) for row in table.rows)]
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(f'<tr>{row}</tr>' for row in rows)}</tbody></table>"
