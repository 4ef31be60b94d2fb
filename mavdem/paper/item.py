"""One claim of the paper that is tested again, and the result of the test."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from PIL import Image

from mavdem.paper.checks import Check
from mavdem.paper.claims import Claim
from mavdem.paper.drawing import in_both_themes
from mavdem.paper.runner import Runner


class Cell(NamedTuple):
    """A cell of a table; ``aside`` is a small second line."""

    text: str
    best: bool = False
    aside: str = ""


@dataclass(frozen=True)
class PageTable:
    """A table of the page; each row begins with its name. Its values are in the item's numbers too."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


@dataclass(frozen=True)
class Picture:
    """A figure, drawn in the colours of the current theme."""

    name: str
    caption: str
    draw: Callable[[], Figure]

    def write(self, folder: Path) -> dict[str, str]:
        """Writes it and returns the names of its files in the folder, for a light and a dark page."""
        return in_both_themes(self.draw, folder, self.name)


class PngPicture(Picture):
    """A figure with one small PNG file for both themes."""

    def write(self, folder: Path) -> dict[str, str]:
        """Writes it and returns the name of its file in the folder, for a light and a dark page."""
        file = f"{self.name}.png"
        drawn, figure = BytesIO(), self.draw()
        figure.savefig(drawn, dpi=100)
        plt.close(figure)
        # A palette is enough for the shades, and makes a third of the file.
        Image.open(drawn).convert("RGB").quantize(256, dither=Image.Dither.NONE).save(folder / file, optimize=True)
        return {"light": file, "dark": file}


@dataclass(frozen=True)
class ItemResult:
    """What running an item gave."""

    checks: tuple[Check, ...] = ()  # decide the status; without any, ``remarks`` has the reason
    beyond: tuple[Check, ...] = ()  # of settings that are not the paper's; decide nothing
    numbers: dict[str, Any] = field(default_factory=dict)  # plain JSON values
    tables: tuple[PageTable, ...] = ()
    pictures: tuple[Picture, ...] = ()
    remarks: tuple[str, ...] = ()


class Item(NamedTuple):
    """One claim of the paper, and what tests it."""

    claim: Claim
    run: Callable[[Runner], ItemResult]
