"""Fact: a coded finding about a flight, a small frozen record with code, level, time, subject and figures.

Facts are made where they are found, on any floor. They know no words: ``report.sentences`` has a sentence and a remedy
for each code. Code compares codes and levels, never text.
"""

from __future__ import annotations

import tomllib
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from importlib.resources import files
from math import inf
from pathlib import PurePath
from types import MappingProxyType
from typing import Any


def _table(name: str) -> Mapping[str, str]:
    """Reads a table of this package, such as ``units.toml``: texts by name."""
    return MappingProxyType(tomllib.loads((files("mavdem.facts") / name).read_text("utf-8")))


UNITS = _table("units.toml")
"""The unit of each figure by its name, the same in all facts: "Hz", "m/s", "1" of a share or a count, "" of words."""

LEVELS = _table("levels.toml")
"""The level of each code that matters as much wherever it is found."""


class Level(StrEnum):
    """How much a fact matters to the pilot."""

    GOOD = "good"
    WATCH = "watch"
    BAD = "bad"
    UNKNOWN = "unknown"


class Code(StrEnum):
    """Identifies what a fact states, by a unique name; each subclass lists the codes of one subject."""


Figure = Any
"""A number, a word, a code, another fact, None, or a tuple of such."""


@dataclass(frozen=True, init=False)
class Fact:
    """Something that was found out about a flight: a code with figures, from which a sentence is made.

    Attributes:
        code: identifies what it states.
        level: how much it matters.
        time: when it was so, or when that began, s on the boot clock; None for a fact that has no time.
        end_time: when it ended, s on the boot clock; None for a moment, or if it had not ended when the record did.
        subject: what it is about: "motor 2", "roll rate loop", "GPS"; empty if that is the flight as a whole.
    """

    code: Code
    level: Level
    time: float | None
    end_time: float | None
    subject: str
    _figures: tuple[tuple[str, Figure], ...]

    def __init__(
        self,
        code: Code,
        level: Level | None = None,
        *,
        time: float | None = None,
        end_time: float | None = None,
        subject: str = "",
        **figures: Figure,
    ) -> None:
        """Takes figures by name; the level is the code's own in ``levels.toml`` unless another is given, or unknown.

        Raises:
            ValueError: a figure has no unit in ``units.toml``.
        """
        # A difference of the sets of names would walk through all names that have a unit, for every fact.
        names_without_unit = [name for name in figures if name not in UNITS]
        if names_without_unit:
            names = sorted(names_without_unit)
            raise ValueError(f"figures without a unit in facts/units.toml: {names}")
        plain_figures = tuple((name, plain(value)) for name, value in figures.items())
        # The dataclass is frozen, so that its fields are set by ``object.__setattr__``.
        for name, value in {
            "code": code,
            "level": level or Level(LEVELS.get(code, Level.UNKNOWN)),
            "time": plain(time),
            "end_time": plain(end_time),
            "subject": subject,
            "_figures": plain_figures,
        }.items():
            object.__setattr__(self, name, value)

    @property
    def figures(self) -> Mapping[str, Figure]:
        """The figures by name, in the units of ``units``."""
        return MappingProxyType(dict(self._figures))

    @property
    def units(self) -> Mapping[str, str]:
        """The unit of each figure."""
        return MappingProxyType({name: UNITS[name] for name, _ in self._figures})

    def replace(self, level: Level | None = None, **changes: Figure) -> Fact:
        """Returns a copy of the fact in which some values are replaced, as :func:`dataclasses.replace` does.

        Args:
            level: the new level; None to keep the level.
            changes: new values of figures, or of ``time``, ``end_time`` and ``subject``, by name. New names are added.
        """
        values = {
            "time": self.time,
            "end_time": self.end_time,
            "subject": self.subject,
            **self.figures,
        }
        return Fact(self.code, level or self.level, **values | changes)

    def with_code(self, code: Code) -> Fact:
        """Returns a fact with another ``code`` and the usual level of that code; time, subject and figures stay."""
        return Fact(
            code,
            time=self.time,
            end_time=self.end_time,
            subject=self.subject,
            **dict(self._figures),
        )

    @property
    def start_time(self) -> float:
        """Time at which it began, s on the boot clock; 0 for a fact without a time. Events always have one."""
        return 0.0 if self.time is None else self.time

    @property
    def latest_time(self) -> float:
        """Time at which it ended, s on the boot clock; infinite without an ``end_time``."""
        return inf if self.end_time is None else self.end_time

    @property
    def is_good(self) -> bool:
        """Whether its level is "good"."""
        return self.level is Level.GOOD

    @property
    def is_bad(self) -> bool:
        """Whether its level is "bad"."""
        return self.level is Level.BAD

    @property
    def is_watch_or_bad(self) -> bool:
        """Whether its level is "watch" or "bad"."""
        return self.level in (Level.WATCH, Level.BAD)

    @property
    def without_flight_advice(self) -> Fact:
        """The fact for a vehicle that must not fly: no remedy, also of the facts in its figures, advises to fly."""
        grounded_figures = {name: _grounded(figure) for name, figure in self.figures.items()}
        return self.replace(**grounded_figures | {"is_grounded": True})

    @property
    def advises_only_flight(self) -> bool:
        """Whether the remedy of the fact is another flight, such as one with doublets, and nothing else."""
        return bool(self.remedy) and not self.without_flight_advice.remedy

    @property
    def without_measurements(self) -> Hashable:
        """Its content without measured numbers, as a key: facts with equal keys report the same.

        Live sessions find the same facts again every second, with other numbers, which are not reported again.
        """
        return _without_measurements(self)

    @property
    def sentence(self) -> str:
        """The fact in words."""
        # The sentences are made by ``report``, a room above all that make facts.
        from mavdem.report.templates import sentence

        return sentence(self)

    @property
    def remedy(self) -> str:
        """What to do about it, in words; empty if there is nothing to be done."""
        from mavdem.report.templates import remedy

        return remedy(self)

    def __str__(self) -> str:
        return self.sentence

    @property
    def forbids_flight(self) -> bool:
        """Whether what to do about it is not to fly before something is inspected or repaired."""
        # Which codes forbid it stands beside their sentences.
        from mavdem.report.templates import forbids_flight

        return forbids_flight(self)

    @property
    def sentence_and_remedy(self) -> str:
        """The sentence and, after it, the remedy."""
        return " ".join(filter(None, (self.sentence, self.remedy)))


def _without_measurements(figure: Figure) -> Hashable:
    """Returns what stays the same of a figure of a fact (coded finding) while measured numbers in it change.

    Two facts that differ only in measured numbers become equal, so that a status does not report them as a change.

    Args:
        figure: a fact, a number, a word, a code, None, or a tuple of such.

    Returns:
        The figure itself, but None for a number. A fact becomes a tuple of its code, level, subject and figures.
    """
    if isinstance(figure, Fact):
        figures = []
        for name, value in figure.figures.items():
            figures.append((name, _without_measurements(value)))
        return figure.code, figure.level, figure.subject, tuple(figures)
    if isinstance(figure, tuple):
        return tuple(_without_measurements(element) for element in figure)
    is_measurement = isinstance(figure, int | float) and not isinstance(figure, bool)
    return None if is_measurement else figure


def plain(value: Any) -> Figure:
    """Returns numbers of NumPy as Python's, lists and arrays as tuples, and paths and errors as text."""
    if isinstance(value, PurePath | BaseException):
        return str(value)
    if hasattr(value, "tolist"):
        value = value.tolist()
    return tuple(map(plain, value)) if isinstance(value, list | tuple) else value


def _grounded(figure: Figure) -> Figure:
    """Returns a figure of a fact in which all facts advise no flight (``Fact.without_flight_advice``)."""
    if isinstance(figure, tuple):
        return tuple(map(_grounded, figure))
    return figure.without_flight_advice if isinstance(figure, Fact) else figure


Facts = tuple[Fact, ...]
NamedFacts = Mapping[str, Fact]
