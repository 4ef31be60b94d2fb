"""SOURCEs: one log or several, what each is called, and those that cannot be used."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

import click

from mavdem.alignment.read import learnable_flight
from mavdem.cli.commands import UNUSABLE
from mavdem.cli.output import printable, progress, say, say_aside
from mavdem.errors import NotLearnable, Unreadable
from mavdem.flight import Flight
from mavdem.ingest import Log, read_log

Result = TypeVar("Result")

LINK_PATTERN = re.compile(r"(udp|tcp|mcast|ws)\w*:|/dev/(tty|cu|serial)|COM\d", re.IGNORECASE)
"""The beginning of pymavlink's connection strings (``mavutil.mavlink_connection``)."""


def refuse_link(source: str) -> None:
    """Raises ``Unreadable`` for a link and for standard input, where a log is needed."""
    if source == "-":
        raise Unreadable("A log cannot be read from standard input (-): save it as a file and name that.")
    if LINK_PATTERN.match(source) and not os.path.isfile(source):
        attach = shlex.join(["mavdem", "live", source])
        raise Unreadable(f"{source} is a MAVLink link, and only logs are read here: attach to it with `{attach}`.")


def read_source(source: str) -> Log:
    """Returns the log that SOURCE names; raises ``Unreadable`` for a link and for what ``read_log`` cannot read."""
    refuse_link(source)
    with progress(f"Reading {source}") as done:
        return read_log(source, done)


class Refused(NamedTuple):
    """A SOURCE that cannot be used, while the others can; ``source`` is as on the command line."""

    name: str
    source: str
    error: NotLearnable | Unreadable

    @property
    def values(self) -> dict[str, str | dict[str, str]]:
        """All of it, for a document."""
        error = {"reason": self.error.reason, "remedy": self.error.remedy}
        return {"flight": self.name, "source": self.source, "error": error}


def names_of(sources: Sequence[str]) -> list[str]:
    """Names of flights: the file's name without its ending, or the whole SOURCE if others have the same name."""
    stems = [printable(Path(source).stem) for source in sources]
    return [stem if stems.count(stem) == 1 else printable(source) for stem, source in zip(stems, sources, strict=True)]


def of_each(
    sources: Sequence[str], axis: str, vehicle: str | None, inputs: str | None, use: Callable[[str, Flight], Result]
) -> tuple[dict[str, Result], list[Refused]]:
    """Returns what ``use`` makes of each settled flight, by the flight's name, and the refused SOURCEs."""
    for place, source in enumerate(sources):
        if source in sources[:place]:
            raise click.BadParameter(f"{source} is named twice: each flight counts once.", param_hint="SOURCE")
    found: dict[str, Result] = {}
    refused = []
    for name, source in zip(names_of(sources), sources, strict=True):
        try:
            flight, _ = learnable_flight(read_source(source), axis, vehicle, inputs)
            found[name] = use(name, flight)
        except (NotLearnable, Unreadable) as error:
            refused.append(Refused(name, source, error))
    return found, refused


def end_report(context: click.Context, refused: Sequence[Refused], outcome: str, last: str, as_json: bool) -> None:
    """Prints why SOURCEs are refused and a last sentence, with JSON the former, aside; exits with 2 if unreadable."""
    for one in refused:
        if as_json:
            say_aside(printable(f"mavdem: {one.source}: {outcome}: {one.error}"))
        else:
            say(f"{one.name}: {outcome}. {one.error}\n")
    if not as_json:
        say(last)
    if any(isinstance(one.error, Unreadable) for one in refused):
        context.exit(UNUSABLE)


def nothing_left(refused: Sequence[Refused], done: str) -> NotLearnable | Unreadable:
    """The error if all SOURCEs are refused: the first one, unreadable ones first; with its SOURCE if there are more."""
    first = min(refused, key=lambda one: isinstance(one.error, NotLearnable))
    if len(refused) == 1:
        return first.error
    reason = f"None of the {len(refused)} flights can be {done}; {first.source}: {first.error.reason}"
    return Unreadable(reason) if isinstance(first.error, Unreadable) else NotLearnable(reason, first.error.remedy)
