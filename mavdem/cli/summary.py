"""The result of ``mavdem learn`` for people: its account in plain text."""

from __future__ import annotations

from typing import Any

from rich.table import Table as Grid

from mavdem.account import Sentence, Table, account
from mavdem.cli.output import print_table, printable, say
from mavdem.dem import Learned
from mavdem.flight import Flight


def print_summary(report: dict[str, Any], train: Flight, test: Flight, learned: Learned) -> None:
    """Prints the account of ``learned``, how long it took and where it was written.

    Args:
        report: of ``mavdem.evaluate.report``, with the ``seconds`` and ``files`` that ``mavdem learn`` adds.
        train, test, learned: what it is about.
    """
    for block in account(report, train, test, learned):
        if isinstance(block, Sentence):
            say(f"{f'{block.lead} {block.text}'.strip()}\n")
        else:
            print_table(_grid(block))
    say(f"Took {report['seconds']:.1f} s. Written: {', '.join(map(printable, report['files'].values()))}")


def _grid(table: Table) -> Grid:
    first, *others = table.header
    grid = Grid(box=None, pad_edge=False)
    grid.add_column(first)
    for other in others:
        grid.add_column(other, justify="right")
    for row in table.rows:
        grid.add_row(*row)
    return grid
