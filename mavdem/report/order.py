"""The report of a choice of the model order, in sentences and a table."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Any

from mavdem.dem.order.choice import OrderChoice
from mavdem.report.blocks import Sentence, Table
from mavdem.report.names import THREE_STATES


def order_report(choice: OrderChoice, names: Sequence[str]) -> list[Sentence | Table]:
    """F̄ by order and flight, and the chosen order with its reason; ``names`` are those of the flights of ``choice``."""
    several = len(names) > 1
    header = ["states", *names, *(["mean", "spread"] if several else [])]
    highest = choice.free_energy[:, choice.chosen - 1]
    rows = []
    spread = " Spread: the standard deviation over the flights." if several else ""
    for row, order in enumerate(choice.orders):
        cells = [_nats(value) for value in choice.free_energy[:, row] - highest]
        if several:
            cells += [_nats(choice.mean[row] - choice.mean[choice.chosen - 1]), _nats(choice.spread[row])]
        rows.append([f"{order}{' (chosen)' if order == choice.chosen else ''}", *cells])
    return [
        Sentence("", lead=choice.reason),
        Table(header, rows),
        Sentence(f"F̄ in nats, minus that of the chosen order.{spread}"),
        *(Sentence(remark, "Caution:") for remark in choice.remarks),
        Sentence(THREE_STATES),
    ]


def _nats(value: Any) -> str:
    return f"{value:,.1f}" if isfinite(value) else "-"
