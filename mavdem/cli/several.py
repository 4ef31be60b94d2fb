"""Several SOURCEs of one command: what they are called, and those of which nothing can be told."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import click

from mavdem.cli.output import printable
from mavdem.errors import NotLearnable, Unreadable


class Refused(NamedTuple):
    """A SOURCE of which nothing can be told, while the others stand.

    Attributes:
        name: what it is called.
        source: as it was named on the command line.
        error: why not.
    """

    name: str
    source: str
    error: NotLearnable | Unreadable

    @property
    def reason(self) -> dict[str, str]:
        """Why not and what to do, for a document."""
        if isinstance(self.error, NotLearnable):
            return {"reason": self.error.reason, "remedy": self.error.remedy}
        return {"reason": str(self.error), "remedy": ""}

    @property
    def values(self) -> dict[str, str | dict[str, str]]:
        """All of it, for a document."""
        return {"flight": self.name, "source": self.source, "error": self.reason}


def check_sources(sources: Sequence[str]) -> None:
    """Refuses a SOURCE that is named twice."""
    for place, source in enumerate(sources):
        if source in sources[:place]:
            raise click.BadParameter(f"{source} is named twice: each flight counts once.", param_hint="SOURCE")


def names_of(sources: Sequence[str]) -> list[str]:
    """What flights are called: the file's name without its ending, or all of it where others have the same."""
    stems = [printable(Path(source).stem) for source in sources]
    return [stem if stems.count(stem) == 1 else printable(source) for stem, source in zip(stems, sources, strict=True)]


def nothing_left(refused: Sequence[Refused], done: str) -> NotLearnable | Unreadable:
    """The first error, beginning with those that are not the data's; of several with the name of its SOURCE.

    Args:
        refused: all SOURCEs.
        done: what cannot be done with any of them, such as "compared".
    """
    first = min(refused, key=lambda one: isinstance(one.error, NotLearnable))
    if len(refused) == 1:
        return first.error
    reason = f"None of the {len(refused)} flights can be {done}; {first.source}: {first.reason['reason']}"
    return Unreadable(reason) if isinstance(first.error, Unreadable) else NotLearnable(reason, first.reason["remedy"])
