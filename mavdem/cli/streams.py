"""Standard output and standard error of the command line: lines that any terminal can show, and quiet libraries."""

import io
import logging
import os
import shutil
import sys
import warnings
from contextlib import suppress
from pathlib import Path
from typing import TextIO

import click

DEFAULT_COLUMNS = 80
"""Characters of a line of a terminal that does not say how wide it is."""

MIN_COLUMNS, MAX_COLUMNS = 40, 120
"""Narrowest and widest line of a screen: below, words no longer fit, and longer lines are hard to read; a choice."""


def prepare_streams() -> None:
    """Prepares the standard streams of the process for whatever text a command prints.

    A stream that the caller has closed is replaced by the null device. Characters that the terminal's encoding lacks
    are printed as "?" instead of ending the run. Warnings take one line of standard error.
    """
    # The streams stay open for as long as the process.
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    # NumPy warns of NaN and infinity; the code that uses the results leaves these out.
    warnings.simplefilter("ignore", RuntimeWarning)
    # Matplotlib reports a cache that it cannot write and faults of a matplotlibrc, which do not affect our pictures.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    warnings.showwarning = lambda message, *_, **__: print_to_stderr(f"mavdem: warning: {message}")


def stderr_is_terminal() -> bool:
    """Returns whether somebody may watch standard error: it is a terminal, and no file or pipe."""
    return sys.stderr.isatty()


def has_known_width(stream: TextIO) -> bool:
    """Returns whether a stream has a width: it is a terminal, or the environment variable COLUMNS gives the width."""
    return stream.isatty() or "COLUMNS" in os.environ


def text_columns() -> int:
    """Returns how many characters a line of standard output has, by which all commands lay out screens and tables.

    The number comes from the environment variable COLUMNS, otherwise from the terminal, limited to ``MIN_COLUMNS`` and
    ``MAX_COLUMNS``; without both it is ``MAX_COLUMNS``.
    """
    if not has_known_width(sys.stdout):
        return MAX_COLUMNS
    return _known_width()


def _known_width() -> int:
    """Returns the width of COLUMNS, otherwise of the terminal, limited to ``MIN_COLUMNS`` and ``MAX_COLUMNS``."""
    width = shutil.get_terminal_size((DEFAULT_COLUMNS, 0)).columns
    return min(max(width, MIN_COLUMNS), MAX_COLUMNS)


def print_to_stdout(text: str) -> None:
    """Prints text on standard output, in the encoding of ``sys.stdout``.

    Without ``file``, ``click.echo`` would write UTF-8 where the encoding is ASCII.
    """
    click.echo(text, file=sys.stdout)


def print_page_path(path: Path, seconds: float) -> None:
    """Prints on standard output where a page is, and how long the command took, in whole seconds and at least one."""
    print_to_stdout(f"Page: {escape_unprintable(path)} (took {max(seconds, 1):.0f} s)")


def print_to_stderr(text: object) -> None:
    """Prints text on standard error; a failure is ignored, since the exit code reports the result.

    It wraps at the width of standard error. In files and pipes, which have none, it is one line, which programs can
    search for.

    Args:
        text: object to print; it is converted to a string, and line breaks in it to spaces.
    """
    single_line = " ".join(str(text).splitlines())
    line = escape_unprintable(single_line)
    if has_known_width(sys.stderr):
        # Imported here, so that `mavdem --help` does not wait for it.
        from mavdem.report.blocks import wrapped_lines

        # Paths and commands stay whole, so that they can be copied.
        line = "\n".join(wrapped_lines(line, _known_width()))
    with suppress(OSError):
        click.echo(line, file=sys.stderr)


def escape_unprintable(text: object) -> str:
    r"""Returns text in which control characters are replaced by Python's escapes, such as ``\n`` or ``\x1b``.

    Names of files and texts from logs may contain line breaks, escape sequences that terminals obey, and marks that
    reverse the direction of writing. No-break spaces, which pages have between a number and its unit, become spaces.

    Args:
        text: object to print; it is converted to a string.
    """
    printable_characters = []
    for character in str(text).replace("\N{NO-BREAK SPACE}", " "):
        if not character.isprintable():
            character = character.encode("unicode_escape").decode()
        printable_characters.append(character)
    return "".join(printable_characters)
