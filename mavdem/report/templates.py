"""Words: the sentence and the remedy of each fact; no other place has prose about a flight.

The tables in ``sentences`` hold Jinja2 templates by the value of each code. Where ``is_flown`` stands, the remedy is to
fly, or so is the sentence of what is a remedy itself: of a fact that is ``grounded`` it is not said. A figure stands
for itself, another fact for its sentence without the full stop. Filters format figures for people: shares as percent,
lists as "a, b and c".
"""

import tomllib
from collections.abc import Callable, Iterable
from functools import cache
from importlib.resources import files
from math import degrees, tau
from operator import attrgetter
from shlex import quote
from typing import Any

from jinja2 import Environment, StrictUndefined, Template

from mavdem.containers import group_by
from mavdem.facts import Code, Fact, Words
from mavdem.files import load_adjacent_toml
from mavdem.report.blocks import Sentence
from mavdem.report.numbers import (
    counted,
    few,
    in_one_line,
    listed,
    plus_minus,
    readable,
    rounded,
    short,
    with_unit,
)
from mavdem.wind_velocity.compass import compass_text

PARAMETERS = {
    "effect": "control effectiveness",
    "damping": "rate damping",
    "lag": "motor time constant",
}
"""What physical parameters are called."""


@cache
def table() -> dict[str, dict[str, str]]:
    """Returns the sentence, and the remedy where there is one, by the value of a code."""
    words = dict[str, dict[str, str]]()
    for part in (files("mavdem.report") / "sentences").iterdir():
        if part.name.endswith(".toml"):
            words |= tomllib.loads(part.read_text("utf-8"))
    return words


def words(fact: Fact) -> Words:
    """Returns the sentence and the remedy of a ``fact``; one among its figures, where the table has none."""
    return Words(_rendered(fact, "sentence"), _rendered(fact, "remedy"))


def headline(fact: Fact) -> str:
    """Returns the shorter sentence that stands above all else, or else the sentence, of a ``fact``."""
    return _rendered(fact, "headline") or sentence(fact)


def _rendered(fact: Fact, part: str) -> str:
    of_code = table()[fact.code]
    flown_part = "remedy" if "remedy" in of_code else "sentence"
    if part == flown_part and "is_flown" in of_code and "is_grounded" in fact.figures:
        return ""
    figures = {
        "remedy": "",
        "is_grounded": False,
        "level": fact.level,
        "time": fact.time,
        "until": fact.until,
        "subject": fact.subject,
        **fact.figures,
    }
    return _template(fact.code, part).render(figures).strip()


def sentence(fact: Fact | str) -> str:
    """Returns the sentence of a ``fact``; text that is no fact yet as it is."""
    return fact if isinstance(fact, str) else words(fact).sentence


@cache
def _paragraphs(section: str) -> list[dict[str, Template]]:
    told = load_adjacent_toml(__file__, f"sections/{section}.toml")["paragraph"]
    make = _environment().from_string
    return [{part: make(str(text)) for part, text in paragraph.items()} for paragraph in told]


def section(name: str, record: object = None, /, **values: Any) -> list[Sentence]:
    """Returns the paragraphs of the section of this ``name`` that say something, in order.

    They say it of the attributes of a ``record``, and of further ``values``.
    """
    sentences = []
    if record is not None:
        values |= {key: getattr(record, key) for key in dir(record) if not key.startswith("_")}
    for paragraph in _paragraphs(name):
        parts = {part: template.render(values).strip() for part, template in paragraph.items()}
        if parts.get("text") or "text" not in parts or "always" in parts:
            sentences.append(Sentence(parts.get("text", ""), parts.get("lead", "")))
    return sentences


@cache
def _template(code: Code, part: str) -> Template:
    missing = "{{ remedy | string if remedy }}" if part == "remedy" else ""
    return _environment().from_string(table()[code].get(part, missing))


@cache
def _environment() -> Environment:
    environment = Environment(undefined=StrictUndefined, finalize=_shown, autoescape=False)
    environment.globals |= {"comma": comma, "counted": counted, "tau": tau, "zip": zip}
    environment.filters |= {
        "advised": attrgetter("advised"),
        "bare": bare,
        "begin": begin,
        "below": below,
        "degrees": degrees,
        "fixed": lambda value, digits=0: f"{value:z.{digits}f}",
        "few": few,
        "from_point": compass_text,
        "go_on": go_on,
        "headline": headline,
        "in_one_line": in_one_line,
        "interval": interval,
        "listed": listed,
        "parameter": PARAMETERS.get,
        "percent": lambda share, digits=0: f"{100 * share:.{digits}f} %",
        "plus_minus": plus_minus,
        "quoted": quote,
        "rounded": rounded,
        "sentence": sentence,
        "short": short,
        "with_unit": lambda value, unit: with_unit(value, readable(unit)),
    }
    return environment


def _shown(value: Any) -> Any:
    return bare(value) if isinstance(value, Fact) else value


def comma(loop: Any, more: bool = False) -> str:
    """Returns what stands before an entry of a list in words: "a, b and c"; ``more``: another follows the last."""
    if loop.first:
        return ""
    return " and " if loop.last and not more else ", "


def together(said: Iterable[tuple[str, Fact]], told: Callable[[Fact], str] = str) -> list[Sentence]:
    """Returns what is ``said`` of axes, in one sentence of all of which the same is said."""
    alike = group_by(said, lambda named: named[1].but(axis="")).items()
    named = [(listed(axis for axis, _ in axes), fact) for fact, axes in alike]
    return [Sentence(told(fact.but(axis=names)), f"{names.capitalize()}:") for names, fact in named]


def interval(value: float, half: float | None, unit: str = " %") -> str:
    """Returns a share in percent, or an angle in degrees, with the ``half`` width of its interval, if known."""
    scale = 100.0 if unit == " %" else degrees(1)
    wide = scale * (half or 0.0)
    shown = plus_minus(scale * value, wide) if wide > 0.1 else rounded(scale * value)
    return f"{shown}{unit}"


def bare(fact: Fact | str) -> str:
    """Returns the sentence of a ``fact`` without its full stop, for the inside of another."""
    return str(fact).removesuffix(".")


def below(value: float, limit: float) -> str:
    """Returns the value with as many decimals as show that it is below the limit, one unless that is 0."""
    return next(
        (text for digits in range(1, 6) if float(text := f"{value:z.{digits}f}") < limit),
        f"{value:.6g}",
    ).removesuffix(".0")


def begin(text: object) -> str:
    """Returns ``text`` with a capital letter at its beginning."""
    return str(text)[:1].upper() + str(text)[1:]


def go_on(text: object) -> str:
    """Returns ``text`` with a small letter at its beginning, unless it is an acronym, for the inside of a sentence."""
    said = bare(str(text))
    return said if said[1:2].isupper() else said[:1].lower() + said[1:]
