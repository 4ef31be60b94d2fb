"""Results and errors that a command prints: a JSON document, or sentences and tables; and the progress bar."""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import click

from mavdem.cli.streams import (
    escape_unprintable,
    print_to_stderr,
    print_to_stdout,
    stderr_is_terminal,
    text_columns,
)
from mavdem.facts import Fact
from mavdem.report.blocks import SCREEN_LINES, Block, Sentence, wrapped_lines

TERMINAL_LINES = 24
"""Lines of a terminal that nobody has enlarged, up to which texts in tables may take more than one line."""

LINES_PER_ROW = (None, 3, 2)
"""Lines to which texts in tables of a screen are shortened, by preference; None for whole texts."""


def json_text(document: Any, name: str | None = None) -> str:
    """Returns a document of the command line as JSON text, beginning with the heading of all documents.

    NaN and infinity, which JSON lacks, become null.

    Args:
        document: Values of the document, or a record that has them.
        name: Name of the document in ``mavdem.documents.DOCUMENTS``; the running command unless given.
    """
    name = name or click.get_current_context().command.name or ""
    # Imported here, so that `mavdem --help` does not wait for it.
    from mavdem.documents import complete_document

    return json.dumps(complete_document(name, document), indent=1, allow_nan=False)


def print_json(document: Any, name: str | None = None) -> None:
    """Prints the document of ``--json`` on standard output; the arguments are passed to :func:`json_text`."""
    print_to_stdout(json_text(document, name))


def print_result(document: Any, blocks: Iterable[Block], *, as_json: bool) -> None:
    """Prints the result of a command: its JSON document with ``--json``, otherwise sentences and tables."""
    if as_json:
        print_json(document)
    else:
        print_blocks(blocks)


def print_blocks(blocks: Iterable[Block]) -> None:
    """Prints sentences and tables on standard output, with an empty line after each."""
    for block in blocks:
        print_to_stdout("\n".join([*_block_lines(block), ""]))


def print_screen(
    title: Sequence[Block],
    summary: Iterable[Block],
    details: Iterable[Block],
    footer: Iterable[Block],
    *,
    verbose: bool,
    reserved_lines: int = 0,
) -> None:
    """Prints the result of a command, the most important blocks last: the user looks there when the text has scrolled.

    A block is a sentence or a table. Without ``verbose`` the title, the footer, and between them the blocks of the
    summary that fit are printed: as many as fit into ``SCREEN_LINES`` if each row of a table is shortened to one line.
    Then the rows are printed longer, as far as all lines and the reserved ones fit into ``TERMINAL_LINES``.

    Args:
        title: First lines, such as the name of the log; always complete.
        summary: Blocks in the order of their importance; one that does not fit is left out.
        details: Further blocks that only ``verbose`` shows, after the summary.
        footer: Blocks at the end, such as headline and next step; always complete.
        verbose: Whether to print all blocks at full length.
        reserved_lines: Lines of the screen that stay free for what the command prints afterwards.
    """
    if verbose:
        print_blocks([*title, *summary, *details, *footer])
        return
    title_lines = []
    for block in title:
        title_lines += _block_lines(block)
    footer_lines = []
    for block in footer:
        footer_lines += _block_lines(block)
    occupied_lines = len(title_lines) + len(footer_lines) + reserved_lines
    summary_lines = _fitting_lines(
        summary, SCREEN_LINES - occupied_lines, TERMINAL_LINES - occupied_lines
    )
    print_to_stdout("\n".join([*title_lines, *summary_lines, *footer_lines]))


def _fitting_lines(blocks: Iterable[Block], max_short_lines: int, max_lines: int) -> list[str]:
    """Returns the lines of those blocks that fit on the screen, with texts in tables as long as there is room.

    Blocks are first selected with each row of a table shortened to one line. Then the tables get longer texts, from the
    first one on, as far as the screen has room.

    Args:
        blocks: Blocks in the order of their importance.
        max_short_lines: With shortened texts all selected blocks together have fewer lines than this.
        max_lines: With longer texts they have fewer lines than this.
    """
    line_count = 0
    selected_blocks: list[tuple[Block, list[str]]] = []
    for block in blocks:
        short_lines = _block_lines(block, lines_per_row=1)
        if line_count + len(short_lines) < max_short_lines:
            selected_blocks.append((block, short_lines))
            line_count += len(short_lines)
    lines: list[str] = []
    for block, short_lines in selected_blocks:
        shown_lines = _longest_lines(block, short_lines, spare_lines=max_lines - line_count)
        line_count += len(shown_lines) - len(short_lines)
        lines += shown_lines
    return lines


def _longest_lines(block: Block, short_lines: list[str], spare_lines: int) -> list[str]:
    """Returns the lines of a block with texts as long as there is room.

    Args:
        block: The sentence or table.
        short_lines: The lines of the block with texts that are shortened to one line.
        spare_lines: The block may have fewer additional lines than this.
    """
    # The forms from the longest to the shortest: the first one that fits is returned.
    for lines_per_row in LINES_PER_ROW:
        longer_lines = _block_lines(block, lines_per_row)
        additional_lines = len(longer_lines) - len(short_lines)
        if additional_lines < spare_lines:
            return longer_lines
    return short_lines


def _block_lines(block: Block, lines_per_row: int | None = None) -> list[str]:
    """Returns the lines of a sentence or a table, laid out for standard output.

    They wrap at the width of standard output (:func:`text_columns`).

    Args:
        block: The sentence or table.
        lines_per_row: Approximate number of lines of a row, to which the texts of a table of words are shortened; None
            for whole texts.
    """
    if isinstance(block, Sentence):
        sentence = f"{block.lead} {block.text}".strip()
        return list(wrapped_lines(escape_unprintable(sentence), text_columns()))
    # Imported here, since Rich takes long to import, and the screen of a review has no tables.
    from rich.console import Console

    from mavdem.cli.tables import terminal_tables

    console = Console(width=text_columns(), highlight=False, markup=False, emoji=False)
    with console.capture() as printed:
        has_texts = block.words
        # The cells of other tables are numbers, which cannot be shortened.
        max_row_lines = lines_per_row if has_texts else None
        # A table that is too wide becomes several tables below each other.
        for table in terminal_tables(block, console.width, max_row_lines):
            console.print(table)
    return [line.rstrip() for line in printed.get().splitlines()]


def report_error(fact: Fact, *, as_json: bool) -> None:
    """Reports on standard error what went wrong and what to do about it; with ``--json`` also as a document."""
    print_to_stderr(f"mavdem: {fact.sentence_and_remedy}")
    if as_json:
        print_json({"error": {"reason": fact, "remedy": fact.remedy, "fact": fact}}, "error")


@contextmanager
def progress(title: str, *, measured: bool = True) -> Iterator[Callable[[float], None]]:
    """Shows a progress bar on standard error while the block runs.

    Nothing is shown if standard error is no terminal.

    Args:
        title: Text before the bar.
        measured: Whether the fraction of the work that is done is known. Otherwise the bar only shows that work goes
            on.

    Yields:
        A function to call with the fraction that is done, from 0 to 1.
    """
    with progress_bar(title, measured=measured) as show:
        yield lambda fraction: show(fraction, title)


@contextmanager
def progress_bar(title: str, *, measured: bool = True) -> Iterator[Callable[[float, str], None]]:
    """Shows a progress bar on standard error whose title may change.

    Args:
        title: First title.
        measured: Whether the fraction of the work that is done is known. Otherwise the bar only shows that work goes
            on.

    Yields:
        A function to call with the fraction that is done, from 0 to 1, and the title.
    """
    if not stderr_is_terminal():
        # Nothing is shown in a file or a pipe.
        yield lambda fraction, title: None
        return
    # Imported here, since most programs that read the output show no bar.
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from mavdem.cli.console import STDERR

    with Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TimeElapsedColumn(),
        console=STDERR,
        transient=True,
    ) as bar:
        task = bar.add_task(escape_unprintable(title), total=1.0 if measured else None)
        yield lambda fraction, title: bar.update(
            task, completed=fraction, description=escape_unprintable(title)
        )
