"""Pictures: the chapter of a page with the figures that can be drawn, and why others cannot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from mavdem.errors import advice
from mavdem.page.document import Chapter, Drawing
from mavdem.page.inline_svg import COLUMN_WIDTH, inline_svg
from mavdem.report.blocks import Sentence
from mavdem.report.palette import INK_ON_LIGHT

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK = {INK_ON_LIGHT: "ink", "#000000": "ink"}
"""The colours of figures that a theme changes, and the CSS property of ``base.html``; the others suit both themes."""


class PicturePlan(NamedTuple):
    """A figure to be drawn: its ``title``, a ``caption`` on how to read it, and the function that draws it.

    ``draw`` may raise ``ValueError`` with the reason why there is none. A ``large`` one takes two columns.
    """

    title: str
    caption: str
    draw: Callable[[], Figure]
    large: bool = False


def picture_chapter(
    plans: Callable[[], Sequence[PicturePlan]],
    title: str = "Pictures",
    name: str = "figure",
    column: float = COLUMN_WIDTH,
) -> Chapter:
    """The figures of ``plans``, which is called only where matplotlib is installed.

    ``name`` is unique on the page; ``column`` as for :func:`mavdem.page.inline_svg.inline_svg`.
    """
    if hint := advice("Drawing the pictures of this page", "plot"):
        return Chapter(title, [Sentence(f"{hint} Then run the same command again.")])
    drawings: list[Drawing] = []
    reasons: list[Sentence] = []
    for number, (heading, caption, draw, large) in enumerate(plans()):
        try:
            svg = inline_svg(draw(), f"{name}-{number}", heading, INK, column)
        except ValueError as error:
            reasons.append(Sentence(f"{error}.", f"{heading}:"))
        else:
            drawings.append(Drawing(heading, svg, caption, large))
    return Chapter(title, reasons, drawings)
