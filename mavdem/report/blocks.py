"""Blocks: the sentences and tables that every report is made of, and their layout as text and Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterable
from textwrap import shorten
from typing import NamedTuple

from mavdem.facts import Fact, Level

SCREEN_LINES = 15
"""Of a screen without ``--verbose``: with what is being read, and where the page is."""


class Sentence(NamedTuple):
    """A sentence; ``lead`` is set off at its beginning, if there is one; without ``text`` it is a headline."""

    text: str
    lead: str = ""
    level: Level | None = None


def caution(text: object) -> Sentence:
    """Returns a sentence that limits what is shown."""
    said = text.advised if isinstance(text, Fact) else str(text)
    return Sentence(said, "Caution:", Level.WATCH)


def warning(text: object) -> Sentence:
    """Returns a sentence that must be known before what is shown is used."""
    return Sentence(str(text), "Warning:", Level.WATCH)


class Rated(str):
    """The text of a cell that rates something, and the ``level``, by which a page colours it."""

    level: Level

    def __new__(cls, text: str, level: Level) -> Rated:
        """Returns a cell of a ``level``."""
        cell = super().__new__(cls, text)
        cell.level = level
        return cell


class Table(NamedTuple):
    """Formatted cells: the first column names the rows, the others are numbers or, with ``words``, are read as text."""

    header: list[str]
    rows: list[list[str]]
    words: bool = False


Block = Sentence | Table
Blocks = list[Block]


def plain_text(blocks: Iterable[Block]) -> str:
    """Returns ``blocks`` as plain text: columns aligned, an empty line between blocks."""
    return "\n\n".join(map(_text, blocks))


def _text(block: Block) -> str:
    if isinstance(block, Sentence):
        return f"{block.lead} {block.text}".strip()
    columns = []
    for number, column in enumerate(zip(block.header, *block.rows, strict=True)):
        aligned = str.ljust if block.words or not number else str.rjust
        width = max(map(len, column))
        columns.append([aligned(cell, width) for cell in column])
    return "\n".join("  ".join(row).rstrip() for row in zip(*columns, strict=True))


def markdown(blocks: Iterable[Block]) -> str:
    """Returns ``blocks`` as Markdown, an empty line between blocks."""
    return "\n\n".join(map(_markdown, blocks))


def _markdown(block: Block) -> str:
    if isinstance(block, Sentence):
        # A viewer breaks no path within a line, and hides what stands around it.
        text = re.sub(r" `(mavdem [^`]*)`\. ?", r"\n\n```\n\1\n```\n\n", block.text)
        lead = f"**{block.lead}** " if block.lead else ""
        return f"{lead}{text}".rstrip()
    rule = ["---", *["---" if block.words else "---:"] * (len(block.header) - 1)]
    return "\n".join("| " + " | ".join(row) + " |" for row in [block.header, rule, *block.rows])


def shortened(text: str, columns: int) -> str:
    """Returns a ``text`` in so many ``columns``: what is in brackets goes first, then clauses from its end.

    Where clauses that are left fill less than half of the columns, it is what fits and "…".
    """
    if len(text) > columns:
        text = re.sub(r" \([^()]*\)", "", text)
    if len(text) <= columns:
        return text
    ends = (match.start() for match in re.finditer("[;.] ", text))
    whole = [text[:end] for end in ends if columns / 2 <= end < columns]
    stop = "." * text.endswith(".")
    return whole[-1] + stop if whole else shorten(text, columns, placeholder=" …")
