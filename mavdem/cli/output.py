"""Output: the result on standard output, progress and errors on standard error, and files, each whole or not at all."""

import io
import json
import logging
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import accumulate
from pathlib import Path
from types import FrameType
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table as Grid

from mavdem.containers import Names
from mavdem.errors import Unreadable
from mavdem.facts import Fact
from mavdem.facts.command import Place
from mavdem.files import (
    PathName,
    atomic_writes,
    is_writable,
    reporting_write_errors,
    writable_target,
)
from mavdem.report.blocks import SCREEN_LINES, Block, Sentence, Table, shortened

STDERR = Console(stderr=True, highlight=False, markup=False, emoji=False)  # standard error


def prepare_streams() -> None:
    """Lets no character that the terminal cannot show end a run, and shows a warning as one line."""
    sys.stdout = sys.stdout or open(os.devnull, "w")  # noqa: SIM115 - it stays open for as long as the process
    sys.stderr = sys.stderr or open(os.devnull, "w")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    # What is no number is left out where it is used.
    warnings.simplefilter("ignore", RuntimeWarning)
    # A cache that it cannot write, and faults of a matplotlibrc, matter to nothing that is written here.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    warnings.showwarning = lambda message, *_, **__: say_aside(f"mavdem: warning: {message}")


def json_text(document: Any, name: str | None = None) -> str:
    """Returns a JSON ``document`` of the command that runs, or of this ``name``, after its header.

    NaN and infinity become null.
    """
    name = name or click.get_current_context().command.name or ""
    # Imported here: `mavdem --help` need not wait for it.
    from mavdem.documents import whole

    return json.dumps(whole(name, document), indent=1, allow_nan=False)


def say(text: str) -> None:
    """Prints on standard output, in its encoding: ``click.echo`` left alone writes UTF-8 where that is ASCII."""
    click.echo(text, file=sys.stdout)


def say_aside(text: object) -> None:
    """Prints a line on standard error; a failure is ignored: the exit code reports it."""
    with suppress(OSError):
        click.echo(printable(" ".join(str(text).splitlines())), file=sys.stderr)


def printable(text: object) -> str:
    r"""Returns text with every character that is none to look at as Python writes it, ``\n`` or ``\x1b``.

    Names and files may hold line breaks and what a terminal obeys: escapes, and marks that turn text around.
    """
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode()
        for letter in str(text)
    )


def print_json(document: Any, name: str | None = None) -> None:
    """Prints the one document of ``--json`` on standard output, as :func:`json_text` makes it."""
    click.echo(json_text(document, name))


def print_result(document: Any, blocks: Iterable[Block], as_json: bool) -> None:
    """Prints the one document of ``--json``, or else the blocks."""
    if as_json:
        print_json(document)
    else:
        print_blocks(blocks)


def print_blocks(blocks: Iterable[Block]) -> None:
    """Prints sentences and tables with an empty line after each; names in them may hold what a terminal obeys."""
    for block in blocks:
        say("\n".join([*_lines(block), ""]))


def print_screen(
    title: Sentence | None,
    brief: Iterable[Block],
    more: Iterable[Block],
    conclusion: Iterable[Block],
    verbose: bool,
) -> None:
    """Prints a title, what was found, and last the ``conclusion``: where somebody looks when all has scrolled by.

    Without ``verbose`` that are ``SCREEN_LINES`` at most: of the ``brief`` blocks, those which fit, a line each.
    """
    first = [] if title is None else [title]
    if verbose:
        print_blocks([*first, *brief, *more])
        print_blocks([*conclusion])
        return
    shown = [line for block in first for line in _lines(block, is_cut=True)]
    last = [line for block in conclusion for line in _lines(block)]
    for block in brief:
        lines = _lines(block, is_cut=True)
        if len(shown) + len(lines) + len(last) < SCREEN_LINES:
            shown += lines
    say("\n".join([*shown, *last]))


def _lines(block: Block, is_cut: bool = False) -> list[str]:
    """The lines of a block, as wide as the terminal; ``is_cut``: texts of tables have one line a row."""
    terminal = sys.stdout.isatty()
    # Where it is no terminal, a sentence is one line, for programs that search it, and tables take 120 columns.
    console = Console(width=None if terminal else 120, highlight=False, markup=False, emoji=False)
    with console.capture() as captured:
        if isinstance(block, Sentence):
            console.print(printable(f"{block.lead} {block.text}".strip()), soft_wrap=not terminal)
        else:
            for grid in _grids(block, console.width, is_cut and block.words):
                console.print(grid)
    return [line.rstrip() for line in captured.get().splitlines()]


def _grids(table: Table, width: int, is_cut: bool) -> Iterator[Grid]:
    """The table; of one with more numbers than fit beside each other, parts that begin with its first column."""
    columns = [
        list(map(printable, column)) for column in zip(table.header, *table.rows, strict=True)
    ]
    if is_cut:
        room = width - sum(max(map(len, column)) + 2 for column in columns[:-1])
        columns[-1] = [shortened(cell, room) for cell in columns[-1]]
    is_whole = table.words or sum(max(map(len, column)) + 2 for column in columns) - 2 <= width
    least = [max(map(len, [*heading.split(), *cells])) for heading, *cells in columns]
    least[0] = max(map(len, columns[0]))
    first, *rest = zip(columns, least, strict=True)
    while rest:
        ends = accumulate((2 + size for _, size in rest), initial=first[1])
        count = len(rest) if is_whole else max(sum(end <= width for end in ends) - 1, 1)
        grid = Grid(box=None, pad_edge=False)
        shown = [first, *rest[:count]]
        del rest[:count]
        for (heading, *_), size in shown:
            grid.add_column(
                heading,
                justify="right" if grid.columns and not table.words else "left",
                no_wrap=not grid.columns,
                width=None if is_whole else size,
            )
        for row in zip(*(cells[1:] for cells, _ in shown), strict=True):
            grid.add_row(*row)
        yield grid


def complain(fact: Fact, as_json: bool) -> None:
    """Says on standard error what is wrong and what to do, and with ``as_json`` the same as the document."""
    say_aside(f"mavdem: {fact.advised}")
    if as_json:
        print_json({"error": {"reason": fact, "remedy": fact.remedy, "fact": fact}}, "error")


@contextmanager
def progress(title: str, measured: bool = True) -> Iterator[Callable[[float], None]]:
    """Shows a bar on standard error, if that is a terminal; yields the function to call with the fraction done."""
    if not STDERR.is_terminal:
        yield lambda _: None
        return
    with Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TimeElapsedColumn(),
        console=STDERR,
        transient=True,
    ) as bar:
        task = bar.add_task(printable(title), total=1.0 if measured else None)
        yield lambda fraction: bar.update(task, completed=fraction)


def check_folder(folder: Path, names: Names = (), *inputs: PathName | None) -> None:
    """Raises ``Unreadable``, before the work, for a folder that cannot be written to; it makes nothing.

    Nor may a file of these ``names`` in it be one of the ``inputs``.
    """
    existing = next(filter(os.path.lexists, (folder, *folder.absolute().parents)))
    if not existing.is_dir():
        raise Unreadable(Place.OUT_IS_A_FILE, path=folder, existing=existing)
    if not is_writable(existing):
        raise Unreadable(Place.OUT_NOT_WRITABLE, path=folder, existing=existing)
    with reporting_write_errors(folder, code=Place.OUT_FAILED):
        for part in folder.parts:
            with suppress(FileNotFoundError):
                (existing / part).lstat()  # its name may be too long
    for name in names:
        with reporting_write_errors(folder / name), suppress(FileNotFoundError):
            writable_target(folder / name)
    written = {os.path.realpath(folder / name) for name in names}
    for path in inputs:
        if path and os.path.realpath(path) in written:
            raise Unreadable(Place.OUT_REPLACES_INPUT, path=folder, existing=path)


@contextmanager
def files_in(folder: Path, names: Sequence[str], stale: Names = ()) -> Iterator[tuple[Path, ...]]:
    """Yields paths to write instead of these files, which then replace them; raises ``Unreadable`` if not.

    Of a run before, files of ``stale`` names then go.
    """
    with reporting_write_errors(folder, code=Place.OUT_FAILED):
        folder.mkdir(parents=True, exist_ok=True)
        with atomic_writes(*(folder / name for name in names)) as files:
            yield files
        for name in set(stale) - set(names):
            (folder / name).unlink(missing_ok=True)


def check_file(path: Path | None, option: str, endings: Names) -> None:
    """Raises ``Unreadable``, before the work, for a file that cannot be written, ``BadParameter`` for other endings."""
    if path is not None:
        if path.suffix.lower() not in endings:
            raise click.BadParameter(
                f"{path} must end in {' or '.join(endings)}.", param_hint=option
            )
        with reporting_write_errors(path):
            writable_target(path)


DONE = 0
UNSUPPORTED = 1
UNUSABLE = 2
"""Exit codes: done; the data cannot support the request; bad usage, unreadable input or output that fails."""
# exit codes as a shell reports them: of any signal, less its number; of SIGINT
OF_SIGNAL = 128
INTERRUPTED = OF_SIGNAL + signal.SIGINT


@contextmanager
def ending_at_once() -> Iterator[None]:
    """Lets Ctrl-C end the process, around imports.

    An exception could be lost in, or changed by, what is being imported.
    """
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def unwind_when_terminated() -> None:
    """Lets Ctrl-C, SIGTERM and a closed terminal's SIGHUP end the process as an exception does, once.

    What is begun then, as the removal of temporary files, is not broken off by another. A process that was started with
    one of these ignored, as SIGHUP by nohup, continues.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _unwind)


@contextmanager
def asked_to_end() -> Iterator[Callable[[], bool]]:
    """Takes Ctrl-C, SIGTERM and SIGHUP as a request to end, and yields a function that returns whether there was one.

    Asking again changes nothing: what is kept at the end must not be lost to impatience. An ignored SIGHUP stays so.
    """
    asked = False

    def ask(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        asked = True

    numbers = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    before = {number: signal.signal(number, ask) for number in numbers}
    try:
        yield lambda: asked
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_IGN if asked else handler)


def _unwind(number: int, frame: FrameType | None) -> None:
    for ending in (signal.SIGINT, signal.SIGTERM, number):
        signal.signal(ending, signal.SIG_IGN)
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    sys.exit(OF_SIGNAL + number)
