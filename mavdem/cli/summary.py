"""Results for people: an account in plain text."""

from __future__ import annotations

from collections.abc import Iterable
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
    print_account(account(report, train, test, learned))
    say(f"Took {report['seconds']:.1f} s. Written: {', '.join(map(printable, report['files'].values()))}")


def print_account(blocks: Iterable[Sentence | Table]) -> None:
    """Prints sentences and tables, each with an empty line after it.

    Args:
        blocks: in their order.
    """
    for block in blocks:
        if isinstance(block, Sentence):
            say(f"{f'{block.lead} {block.text}'.strip()}\n")
        else:
            print_table(_grid(block))


def _grid(table: Table) -> Grid:
    first, *others = table.header
    grid = Grid(box=None, pad_edge=False)
    grid.add_column(first, no_wrap=True)
    for other in others:
        grid.add_column(other, justify="right")
    for row in table.rows:
        grid.add_row(*row)
    return grid
