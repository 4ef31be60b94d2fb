"""The document: blocks, drawings and folded chapters as one HTML file, with nothing to fetch and no script."""

from __future__ import annotations

import platform
import re
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from typing import NamedTuple

from jinja2 import ChoiceLoader, Environment, PackageLoader
from markupsafe import Markup, escape

from mavdem.report.blocks import Block, Sentence, Table

RATINGS = {
    "good": ("GOOD", "ok", "reported", "reproduced"),
    "fair": ("LIMITED", "biased", "drift"),
    "bad": ("NOT IDENTIFIABLE", "not identifiable", "fault", "unstable"),
}
"""Words that are set off by a colour where a cell of a table begins with one, by that colour's class."""
WARNINGS = ("Caution", "Warning")
"""How the lead of a sentence begins that is set off at its side."""

_NUMBER = re.compile(r"[-+−±(<>≤≥~≈]?\s*[\d.∞]|-$|–$|nan$|inf$")


class Drawing(NamedTuple):
    """A figure of the page.

    ``svg`` is of ``inline_svg``; the ``title`` is above it, and a ``caption`` below it says how to read it. A ``large``
    one takes two columns, where there are as many.
    """

    title: str
    svg: Markup
    caption: str
    large: bool = False


class Chapter(NamedTuple):
    """A part of the page after its result: ``title``, ``blocks``, ``drawings``.

    Of a ``folded`` one only the title is shown until it is opened.
    """

    title: str
    blocks: Sequence[Block] = ()
    drawings: Sequence[Drawing] = ()
    folded: bool = False


def render_page(
    title: str,
    subtitle: str,
    blocks: Sequence[Block],
    chapters: Sequence[Chapter] = (),
    strip: Sequence[tuple[str, str]] = (),
    back: tuple[str, str] | None = None,
) -> str:
    """The HTML of a page: its title and subtitle, the result in ``blocks``, then chapters.

    ``strip`` are the few figures to see at a glance, label and value; ``back`` the name and the relative address of the
    page that leads here. All text is escaped. The same arguments give the
    same bytes with the same versions of mavdem and Python.
    """
    return (
        environment()
        .get_template("document.html")
        .render(
            title=title,
            subtitle=subtitle,
            blocks=blocks,
            chapters=[one for one in chapters if one.blocks or one.drawings],
            strip=strip,
            back=back,
            made_by=f"mavdem {version('mavdem')}, Python {platform.python_version()}",
        )
    )


def environment(package: str = "mavdem.page") -> Environment:
    """Jinja's environment for templates of a package, which may extend this one's ``base.html``; it escapes all."""
    loader = ChoiceLoader([PackageLoader(one, "") for one in dict.fromkeys((package, "mavdem.page"))])
    made = Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    made.tests |= {"table": lambda block: isinstance(block, Table), "warning": _is_warning}
    made.filters |= {"of_text": _of_text, "rating": _rating, "prose": _prose, "headline": _headline}
    return made


def _is_warning(block: Sentence) -> bool:
    return block.lead.startswith(WARNINGS)


def _of_text(table: Table) -> list[bool]:
    """Which columns hold words: the first, and those whose cells are not mostly numbers."""
    columns = zip(*table.rows, strict=True) if table.rows else [()] * len(table.header)
    filled = [[cell for cell in column if cell] for column in columns]
    words = [2 * sum(not _NUMBER.match(cell) for cell in cells) > len(cells) for cells in filled]
    return [True, *(table.words or of_words for of_words in words[1:])]


def _prose(text: str) -> Markup:
    """Text with what stands between backquotes as code."""
    parts = [Markup("<code>{}</code>").format(part) if odd else escape(part) for part, odd in _quoted(text)]
    return Markup("").join(parts)


def _headline(text: str) -> tuple[str, str]:
    """The first sentence, and the others."""
    first, *others = re.split(r"(?<=[.:!?]) (?=[A-Z])", text, maxsplit=1)
    return first, "".join(others)


def _quoted(text: str) -> Iterator[tuple[str, bool]]:
    """The parts of a text, and whether each was between backquotes."""
    parts = text.split("`")
    if len(parts) % 2:
        yield from ((part, bool(place % 2)) for place, part in enumerate(parts))
    else:
        yield text, False


def _rating(cell: str) -> str:
    """The class of a cell that rates something; empty for others."""
    return next((name for name, words in RATINGS.items() if cell.startswith(words)), "")
