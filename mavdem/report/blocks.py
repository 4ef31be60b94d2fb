"""Blocks: the sentences and tables that every report is made of, and their layout as plain text and Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from textwrap import shorten, wrap
from typing import NamedTuple

from mavdem.facts import Fact, Level

SCREEN_LINES = 15
"""Lines of a report on the terminal without ``--verbose``: a choice, so that it is read without scrolling."""

_SPACE_BEFORE_UNIT = re.compile(r"(?<=\d) (?=%|(?:k?m|m?s|min|h|k?Hz|V|A|dB|kg|MB|°/s)\b)")
"""The space between a number and its unit, such as that in "22.1 s" and "5 m/s"."""

_SPACE_BEFORE_NUMBER = re.compile(r"(?<=\bmotor) (?=\d)", re.IGNORECASE)
"""The space between what is counted and its number, such as that in "motor 2"."""

HARD_SPACE = "\N{NO-BREAK SPACE}"
"""A space at which no line is broken."""

_COMMAND_SENTENCE = re.compile(r" `(mavdem [^`]*)`\. ?")
"""A command of mavdem at the end of a sentence, such as "Run `mavdem info LOG`."."""

_BRACKETS = re.compile(r" \([^()]*\)")
"""A remark in brackets."""


class Sentence(NamedTuple):
    """A sentence of a report; without ``text`` its ``lead`` is a headline."""

    text: str
    """The sentence itself."""

    lead: str = ""
    """What is set off before the sentence, such as "Next:"; empty without."""

    level: Level | None = None
    """Level by which a page colours it; None without a colour."""

    address: str = ""
    """Address of the page that it leads to; empty without."""


def headline_sentence(text: object) -> Sentence:
    """Returns a sentence that stands out as a whole, as the headline of a report does."""
    return Sentence("", str(text))


def caution(text: object) -> Sentence:
    """Returns a sentence that limits what is shown; a fact stands with its advice."""
    sentence = text.sentence_and_remedy if isinstance(text, Fact) else str(text)
    return Sentence(sentence, "Caution:", Level.WATCH)


def warning(text: object) -> Sentence:
    """Returns a sentence that a user must know before using what is shown."""
    return Sentence(str(text), "Warning:", Level.WATCH)


class Rated(str):
    """The text of a table's cell that rates something.

    Attributes:
        level: level by which a page colours the cell.
        reason: why it is rated so, which a page shows behind it; empty without.
    """

    level: Level
    reason: str

    def __new__(cls, text: str, level: Level, reason: str = "") -> Rated:
        """Returns a cell with a text, its level, and the reason for it."""
        cell = super().__new__(cls, text)
        cell.level = level
        cell.reason = reason
        return cell


class Linked(str):
    """The text of a table's cell that links to a page elsewhere, which is loaded only by a click.

    Attributes:
        address: address of the page.
    """

    address: str

    def __new__(cls, text: str, address: str) -> Linked:
        """Returns a cell with a text and the address of its page."""
        cell = super().__new__(cls, text)
        cell.address = address
        return cell


class Detailed(str):
    """The text of a table's cell with a detail that a page shows in a smaller line below it.

    Attributes:
        detail: the detail, such as the interval of a figure.
    """

    detail: str

    def __new__(cls, text: str, detail: str) -> Detailed:
        """Returns a cell with a text and its detail."""
        cell = super().__new__(cls, text)
        cell.detail = detail
        return cell


class Moment(str):
    """The text of a table's cell that is a time of the flight, to which the plots of its page move by a click.

    Attributes:
        seconds: the time on the clock of the plots, s.
    """

    seconds: float

    def __new__(cls, text: str, seconds: float) -> Moment:
        """Returns a cell with a text and its time, s."""
        cell = super().__new__(cls, text)
        cell.seconds = seconds
        return cell


class Table(NamedTuple):
    """A table of formatted cells, whose first column names the rows."""

    header: list[str]
    """Header of each column."""

    rows: list[list[str]]
    """Cells of each row, as many as the header has."""

    words: bool = False
    """Whether the cells are words, aligned on the left; otherwise they are numbers, aligned on the right."""

    is_printed: bool = True
    """Whether the paper of a page has it: a long list in which things are looked up serves a screen."""

    phone_tables: Sequence[Table] = ()
    """Narrower tables with the same cells that a phone shows in its place; empty for none."""

    phone_title: str = ""
    """What a phone shows of these tables until they are opened; empty where they are open."""

    @property
    def longest_cell(self) -> int:
        """Number of letters of the longest cell behind the first column; 0 where there is none."""
        return max([len(cell) for row in self.rows for cell in row[1:]], default=0)


Block = Sentence | Table
Blocks = list[Block]


def plain_text(blocks: Iterable[Block]) -> str:
    """Returns blocks as plain text, with an empty line between them and aligned columns of tables."""
    return "\n\n".join(_block_as_text(block) for block in blocks)


def _block_as_text(block: Block) -> str:
    """Returns a block as plain text: a sentence after its lead, or a table with columns as wide as their widest cells.

    The first column, and all columns of words, are aligned on the left, numbers on the right.

    Args:
        block: a sentence with its lead, or a table.
    """
    if isinstance(block, Sentence):
        return f"{block.lead} {block.text}".strip()
    rows = [block.header, *block.rows]
    widths = []
    for column in range(len(block.header)):
        widths.append(max([len(row[column]) for row in rows]))
    lines = []
    for row in rows:
        padded_cells = []
        for column, (cell, width) in enumerate(zip(row, widths, strict=True)):
            is_left_aligned = block.words or column == 0
            padded_cells.append(cell.ljust(width) if is_left_aligned else cell.rjust(width))
        lines.append("  ".join(padded_cells).rstrip())
    return "\n".join(lines)


def markdown(blocks: Iterable[Block]) -> str:
    """Returns blocks as Markdown, with an empty line between them."""
    return "\n\n".join(_block_as_markdown(block) for block in blocks)


def _block_as_markdown(block: Block) -> str:
    """Returns a block as Markdown: a sentence with its lead in bold, or a table with a header.

    The second line of a Markdown table sets the alignment of each column: "---" aligns left, "---:" right. The first
    column holds the names of the rows and is always aligned left. The others are aligned right, as numbers are, unless
    the table is one of words.

    Args:
        block: a sentence with its lead, or a table.
    """
    if isinstance(block, Sentence):
        # A command such as "Run `mavdem info LOG`." gets a code block of its own. The Rerun Viewer, which shows this
        # text too, does not wrap long paths within a line.
        text = _COMMAND_SENTENCE.sub(r"\n\n```\n\1\n```\n\n", block.text)
        if block.lead:
            text = f"**{block.lead}** {text}"
        return text.rstrip()
    alignment = "---" if block.words else "---:"
    alignments = ["---"] + [alignment] * (len(block.header) - 1)
    lines = []
    for cells in (block.header, alignments, *block.rows):
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def wrapped_lines(text: str, columns: int) -> Iterator[str]:
    """Yields the lines of a text that is wrapped for the terminal.

    A command between backquotes stays on one line, so that it can be copied, and a number stays with its unit. For this
    the spaces in them are replaced by ones at which no line is broken, and restored after that.

    Args:
        text: the text, without line breaks.
        columns: largest number of characters in a line; a longer command or word makes a longer line.
    """
    text_with_hard_spaces = re.sub(
        "`.*?`", lambda command: command[0].replace(" ", HARD_SPACE), with_unbroken_units(text)
    )
    for line in wrap(
        text_with_hard_spaces, columns, break_long_words=False, break_on_hyphens=False
    ):
        yield line.replace(HARD_SPACE, " ")


def with_unbroken_units(text: str) -> str:
    """Returns text whose numbers stay on a line with their unit, or with the "motor" that they are the number of.

    It is for places in which a line has few words.

    Args:
        text: plain text, or the HTML of a page.
    """
    with_units = _SPACE_BEFORE_UNIT.sub(HARD_SPACE, text)
    return _SPACE_BEFORE_NUMBER.sub(HARD_SPACE, with_units)


def truncated(text: str, max_length: int) -> str:
    """Returns a text of at most so many letters; a longer one is cut, with "…"."""
    return text if len(text) <= max_length else f"{text[: max_length - 1]}…"


def shortened(text: str, columns: int) -> str:
    """Returns a text in at most ``columns`` characters, at the cost of its details.

    Remarks in brackets are dropped first, then clauses from the end. If the clauses that fit would fill less than half
    of the columns, the text is cut after a comma or, if that fills as little, after a word, with "…".

    Args:
        text: one sentence or more, in plain text.
        columns: number of characters that there is room for.
    """
    if len(text) > columns:
        text = _BRACKETS.sub("", text)
    if len(text) <= columns:
        return text
    # Beginnings of the text that end with a clause, and those that end with a comma, before which " …" has room.
    clauses = _beginnings(text, "[;.] ", columns / 2, columns - 1)
    if clauses:
        full_stop = "." if text.endswith(".") else ""
        return clauses[-1] + full_stop
    phrases = _beginnings(text, ", ", columns / 2, columns - 2)
    if phrases:
        return f"{phrases[-1]} …"
    return shorten(text, columns, placeholder=" …")


def _beginnings(text: str, end: str, min_length: float, max_length: float) -> list[str]:
    """Returns the beginnings of a text before each match of ``end``, with a length within two limits, in order."""
    positions = [match.start() for match in re.finditer(end, text)]
    return [text[:position] for position in positions if min_length <= position <= max_length]
