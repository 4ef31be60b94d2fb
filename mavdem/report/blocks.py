"""Blocks: the sentences and tables that a report is made of; whoever prints it lays them out."""

from __future__ import annotations

from typing import NamedTuple


class Sentence(NamedTuple):
    """A sentence; ``lead`` is set off at its beginning, if there is one."""

    text: str
    lead: str = ""


class Table(NamedTuple):
    """Formatted cells: the first column names the rows, the others are numbers."""

    header: list[str]
    rows: list[list[str]]
