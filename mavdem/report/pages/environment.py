"""The environment of HTML templates: Jinja with the filters, tests and names that all pages share."""

import json
import platform
import re
from functools import cache
from importlib.metadata import version
from typing import Any

from jinja2 import Environment, PackageLoader, Template
from markupsafe import Markup, escape

from mavdem.report.blocks import HARD_SPACE, Table, with_unbroken_units
from mavdem.report.charts.chart import Chart, Note
from mavdem.report.numbers import listed
from mavdem.report.palette import DISTURBANCE, INK_ON_LIGHT, MODE_COLOURS, PREDICTED
from mavdem.report.template_cache import CompiledTemplates
from mavdem.report.why import evidence_text

_UNSAFE_CHARACTERS = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]"
)
"""Control characters, and marks that reverse the direction of text: the name of a file may contain them."""

_JSON_ESCAPE = re.compile(r"\\(?:u([0-9a-f]{4})|.)")
"""An escape in a JSON text; that of a character by its number has the four digits as its group."""

_HYPHEN_BEFORE_NUMBER = re.compile(r"(?<![^\s(])-(?=\d)")
"""The hyphen of a negative number, such as "-4.5", and no part of a date or a name."""

_SPACE_BEFORE_PERCENT = re.compile(r"(?<=\d) ?%")
"""A percent sign after a number, with the space before it if there is one."""

_INTERVAL = re.compile(r"\(\S+ to \S+\)")
"""An interval after a figure, such as "(23 to 35)"."""

_TAG_OR_DATE = re.compile(r"<[^>]*>|\b\d{4}-\d\d-\d\d( \d\d:\d\d)?\b")
"""A tag of a page, or a date with or without its time of day, such as "2026-11-28 09:15"."""

_ELLIPSIS_IN_NAME = re.compile(r"(?<=\w)…(?=\w)")
"""An ellipsis within a shortened name, such as "001a…333539"."""

_CODE = re.compile("`([^`]*)`")
"""Text between backquotes, such as a command."""

_OPTION = re.compile(r"--[a-z][a-z-]*")
"""An option of a command, which a browser would break after its hyphens."""


def render_page(template: Template, **values: Any) -> str:
    """Renders a template as HTML, in which characters that could disguise text are replaced."""
    return _UNSAFE_CHARACTERS.sub("\N{REPLACEMENT CHARACTER}", template.render(values))


@cache
def environment() -> Environment:
    """Returns Jinja's environment for the templates of ``mavdem/report``; it escapes all text.

    Beside Jinja's own, templates have the filters ``prose``, ``with_unbroken_units``, ``with_unbroken_dates``,
    ``with_unbroken_intervals``, ``css_string`` and ``evidence_text``, the tests ``is table``, ``is chart`` and ``is
    note`` by which they choose how to draw a block, and as globals the version of the program and the colours of
    charts. The environment is cached and shared: a filter that one page adds is there for all pages.
    """
    jinja = Environment(
        loader=PackageLoader("mavdem.report", ""),
        bytecode_cache=CompiledTemplates(),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    jinja.policies["json.dumps_function"] = _json_text
    jinja.globals |= {
        "made_by": f"mavdem {version('mavdem')}, Python {platform.python_version()}",
        "ink": INK_ON_LIGHT,
        "mode_colours": MODE_COLOURS,
        "disturbance": DISTURBANCE,
        "predicted": PREDICTED,
    }
    jinja.tests["table"] = lambda block: isinstance(block, Table)
    jinja.tests["chart"] = lambda panel: isinstance(panel, Chart)
    jinja.tests["note"] = lambda panel: isinstance(panel, Note)
    jinja.filters["prose"] = _prose_as_html
    jinja.filters["with_unbroken_units"] = lambda html: Markup(with_unbroken_units(html))
    jinja.filters["with_unbroken_dates"] = _with_unbroken_dates
    jinja.filters["with_unbroken_intervals"] = _with_unbroken_intervals
    jinja.filters["css_string"] = _css_string
    jinja.filters["evidence_text"] = evidence_text
    jinja.filters["listed"] = listed
    return jinja


def _json_text(value: Any, **options: Any) -> str:
    """Returns a value as JSON, for the script of a page, in which characters that could disguise text are replaced.

    The text of a page is cleaned of these characters when it is rendered (:func:`render_page`). In JSON they stand as
    escapes with their numbers, such as 202e for U+202E, so that they are not found there.

    Args:
        value: what JSON can express.
        options: options of ``json.dumps``, as Jinja gives them.
    """
    return _JSON_ESCAPE.sub(_safe_escape, json.dumps(value, **options))


def _safe_escape(escape: re.Match[str]) -> str:
    """Returns an escape of JSON or, if it stands for an unsafe character, that of the replacement character U+FFFD.

    Args:
        escape: match of ``_JSON_ESCAPE``. Its group 1 has the four hexadecimal digits of a character that is escaped by
            its number; None for another escape, such as that of a line break.
    """
    digits = escape[1]
    if digits is None:
        return escape[0]
    character = chr(int(digits, 16))
    return r"\ufffd" if _UNSAFE_CHARACTERS.match(character) else escape[0]


def _prose_as_html(text: str) -> Markup:
    """Converts text to HTML: parts between backquotes become code; numbers with "%" and shortened names stay on a line.

    Negative numbers get a minus sign. The text is escaped first, since it may come from a log. If a backquote has no
    partner, all are kept as they are.

    Args:
        text: plain text of one sentence or more.

    Returns:
        The HTML.
    """
    text = _SPACE_BEFORE_PERCENT.sub(f"{HARD_SPACE}%", text)
    if "`" not in text:
        # Code, such as an option with its value, is to be copied as it is.
        text = _HYPHEN_BEFORE_NUMBER.sub("−", text)
    html = str(escape(_ELLIPSIS_IN_NAME.sub("…\N{WORD JOINER}", text)))
    has_unpaired_backquote = html.count("`") % 2 == 1
    if has_unpaired_backquote:
        return Markup(html)

    def code_with_unbroken_options(match: re.Match[str]) -> str:
        """Returns a command as code, in which each option stays on a line."""
        command = _OPTION.sub(r"<span>\g<0></span>", match[1])
        return f"<code>{command}</code>"

    return Markup(_CODE.sub(code_with_unbroken_options, html))


def _css_string(text: str) -> Markup:
    """Returns text as a string of a style sheet, in which characters that could end it are escaped by their number.

    Args:
        text: plain text, such as the name of a file.
    """
    characters = [
        character if character.isalnum() or character in " .,-_" else f"\\{ord(character):x} "
        for character in text
    ]
    return Markup('"' + "".join(characters) + '"')


def _with_unbroken_dates(html: str) -> Markup:
    """Keeps dates such as "2026-11-28 09:15" in the text of a page on one line each.

    A browser would otherwise break a line after one of the hyphens.

    Args:
        html: text of a page, with its tags; an address in a tag may have a date, too, and stays as it is.
    """

    def wrap_date(tag_or_date: re.Match[str]) -> str:
        """Returns a tag as it is, and a date within an element that stays on one line."""
        text = tag_or_date[0]
        return text if text.startswith("<") else f'<span class="date">{text}</span>'

    return Markup(_TAG_OR_DATE.sub(wrap_date, html))


def _with_unbroken_intervals(html: Markup) -> Markup:
    """Replaces the spaces within intervals such as "57 (50 to 63)" by ones at which no line breaks.

    In a narrow table a line then ends before an interval and not in the middle of it.

    Args:
        html: text of a page.
    """

    def unbroken(interval: re.Match[str]) -> str:
        """Returns an interval with spaces at which no line breaks."""
        return interval[0].replace(" ", HARD_SPACE)

    return Markup(_INTERVAL.sub(unbroken, html))
