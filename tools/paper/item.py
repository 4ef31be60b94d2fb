"""Item: one thing the paper reports, and what was found when it was done again."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.figure import Figure
from paper.drawing import in_both_themes
from paper.laboratory import Laboratory
from paper.published import Published
from paper.verdict import Check


class Cell(NamedTuple):
    """A cell of a table.

    Attributes:
        text: as it is shown.
        best: whether it is the best of its kind.
        aside: what stands below it, small.
    """

    text: str
    best: bool = False
    aside: str = ""


@dataclass(frozen=True)
class Table:
    """Numbers as they are shown; all of them are in the item's numbers too.

    Attributes:
        caption: what they are.
        columns: headings, the first that of the rows' names.
        rows: cells, the first a row's name.
    """

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


@dataclass(frozen=True)
class Picture:
    """A figure.

    Attributes:
        name: of its files.
        caption: what is seen.
        draw: makes it in the colours that are set.
    """

    name: str
    caption: str
    draw: Callable[[], Figure]

    def write(self, folder: Path) -> dict[str, str]:
        """Writes it and answers the names of its files in the folder, for a light and a dark page."""
        return in_both_themes(self.draw, folder, self.name)


@dataclass(frozen=True)
class Print:
    """A figure that another tool draws, as a PNG for every page.

    Attributes:
        name: of its file.
        caption: what is seen.
        draw: writes it.
    """

    name: str
    caption: str
    draw: Callable[[Path], None]

    def write(self, folder: Path) -> dict[str, str]:
        """Writes it and answers the name of its file in the folder, for a light and a dark page."""
        file = f"{self.name}.png"
        # They print tables of their own, which are no part of the report.
        with redirect_stdout(StringIO()):
            self.draw(folder / file)
        return {"light": file, "dark": file}


@dataclass(frozen=True)
class Found:
    """What came of an item.

    Attributes:
        checks: what decides the verdict; none where nothing could be tried.
        beyond: what else is asked, of settings that are not the paper's, and decides nothing.
        numbers: all of them, plain JSON values by name.
        tables, pictures: what is shown of them, in order.
        remarks: what else a reader must know, a sentence each; where there are no checks, why.
    """

    checks: tuple[Check, ...] = ()
    beyond: tuple[Check, ...] = ()
    numbers: dict[str, Any] = field(default_factory=dict)
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture | Print, ...] = ()
    remarks: tuple[str, ...] = ()


class Item(NamedTuple):
    """One thing the paper reports.

    Attributes:
        name: on the command line and of the files.
        title: what it is.
        published: what the paper says.
        run: does it again.
    """

    name: str
    title: str
    published: Published
    run: Callable[[Laboratory], Found]
