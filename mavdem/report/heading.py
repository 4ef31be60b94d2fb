"""The heading of a flight's page and of its row in a list: what was found in few words, and its details."""

import re
from collections.abc import Sequence
from typing import NamedTuple

from mavdem.facts import Fact
from mavdem.facts.ending import Ending
from mavdem.report.templates import (
    BAN,
    capitalize_first,
    first_and_further_sentences,
    first_sentence,
    headline,
    without_full_stop,
)

SOURCE_OF_HEIGHT = re.compile(
    r" by the (?:barometer|autopilot's estimate)(?![^:]* by satellites)(?=[^:]*: )"
)
"""What measured the height or the descent of a lost vehicle, before the colon of its cause.

Where satellites contradict it, the text says which height is meant.
"""

MAX_HEADING_LENGTH = 120
"""Longest heading, characters: a choice, so that it fills at most four lines of a telephone and two of a desktop."""

MAX_LISTED_LENGTH = 140
"""Longest headline in a list, characters: a choice, so that a loss keeps its cause on four lines of a telephone."""

CLAUSE_ENDS = (": ", "; ")
"""What ends a clause of a sentence after which its details may follow."""

LISTED_ENDS = (*CLAUSE_ENDS, ", although ", ". ")
"""What ends a clause or a sentence after which a list leaves out the rest; no decimal point has a space behind it."""

REMARK = re.compile(r"(?<!motor \d)(?<!motor \d\d) \((?![^()]*probability)[^()]*\)", re.IGNORECASE)
"""A remark in brackets, such as an interval or a limit; neither a probability nor the place of a motor is one."""


class Heading(NamedTuple):
    """The headline of a flight in two parts."""

    finding: str
    """What was found, in one sentence of at most ``MAX_HEADING_LENGTH`` characters where it can be divided."""

    details: str
    """What that leaves out, as a sentence of its own; empty if the finding is the whole headline."""


def heading_of(fact: Fact, text: str) -> Heading:
    """Divides the headline of a flight's page into the finding, in large letters, and its details below.

    A headline that is short enough has no details. That of a lost flight is shortened first by what measured height and
    descent; if it is still too long, the finding names only what failed first, and the
    details are the causes in full. Any other headline is divided at a clause.

    Args:
        fact: the headline, a coded finding. If it is the verdict on one of several flights or vehicles, its figure
            ``reason`` is what was found.
        text: its sentence.
    """
    if len(text) <= MAX_HEADING_LENGTH:
        return Heading(text, "")
    reason = fact.figures.get("reason")
    ending = reason if isinstance(reason, Fact) else fact
    if ending.code not in Ending:
        return _divided(text, CLAUSE_ENDS, MAX_HEADING_LENGTH)
    short_ending = _without_source_of_height(ending)
    short_text = _with_ending(fact, short_ending)
    if len(short_text) <= MAX_HEADING_LENGTH:
        return Heading(short_text, "")
    finding = _with_ending(fact, _with_cause_in_short(short_ending))
    _how_it_ended, _, causes = str(ending).partition(": ")
    if len(finding) > MAX_HEADING_LENGTH or not causes:
        return _divided(short_text, CLAUSE_ENDS, MAX_HEADING_LENGTH)
    return Heading(finding, capitalize_first(causes))


def listed_headline(text: str) -> str:
    """Shortens the headline of a flight for its row in a list of flights.

    A headline that is too long loses first what measured a height, then its remarks in brackets, such as intervals and
    limits. What is still too long ends with its first clauses or sentences: the rest states the evidence, or what to
    check.

    Args:
        text: the headline, of one sentence or several.

    Returns:
        At most ``MAX_LISTED_LENGTH`` characters where the text can be shortened so far.
    """
    for detail in (SOURCE_OF_HEIGHT, REMARK):
        if len(text) > MAX_LISTED_LENGTH:
            text = detail.sub("", text)
    if len(text) <= MAX_LISTED_LENGTH:
        return text
    return _divided(text, LISTED_ENDS, MAX_LISTED_LENGTH).finding


def listed_next_step(text: str) -> str:
    """Shortens the next step of a flight for its row in a list: the first action, as a whole sentence.

    A sentence that only forbids flight is no action: the one after it says what to do.

    >>> listed_next_step("Do not fly. Check the battery. Also balance the propellers.")
    'Do not fly. Check the battery.'

    Args:
        text: what to do next, in sentences; empty where nothing is wrong.
    """
    first, further = first_and_further_sentences(text)
    if first == f"{BAN}." and further:
        return f"{first} {first_sentence(further)}"
    return first


def _without_source_of_height(ending: Fact) -> Fact:
    """Removes from the loss of a flight which sensors measured height and descent; the list of events names them.

    If satellites contradict the height, the sensors stay, since they say which height is meant.

    Args:
        ending: the loss, a coded finding.
    """
    is_contradicted = ending.figures.get("satellite_height") is not None
    if is_contradicted:
        return ending
    return ending.replace(height_source=None, speed_source=None)


def _with_cause_in_short(ending: Fact) -> Fact:
    """Shortens the loss of a flight to what happened and the headline of what failed first.

    Args:
        ending: the loss, a coded finding. Its figure ``cause`` is what failed first; without one, nothing is shortened.

    Returns:
        The loss without two other figures: ``word``, a report of the autopilot, and ``weak_motor``, found before.
    """
    cause = ending.figures.get("cause")
    if cause is None:
        return ending
    return ending.replace(cause=headline(cause), word=None, weak_motor=None)


def _with_ending(fact: Fact, ending: Fact) -> str:
    """Returns the sentence of a headline with another statement of how the flight was lost.

    Args:
        fact: the headline, a coded finding: the loss itself, or a verdict that has it as its figure ``reason``.
        ending: how the flight was lost.
    """
    if fact.code in Ending:
        return headline(ending)
    return fact.replace(reason=ending).sentence


def _divided(text: str, ends: Sequence[str], max_length: int) -> Heading:
    """Divides a long text after the last clause or sentence that still ends within ``max_length`` characters.

    It is not divided within brackets.

    Args:
        text: the text.
        ends: what ends the clauses or sentences after which it may be divided.
        max_length: number of characters that there is room for.

    Returns:
        The heading, and the rest as a sentence of its own. The rest is empty if the text could not be divided.
    """
    for length in range(max_length - 1, 0, -1):
        beginning, rest = text[:length], text[length:]
        is_within_brackets = beginning.count("(") > beginning.count(")")
        if is_within_brackets:
            continue
        for end in ends:
            if rest.startswith(end):
                finding = f"{without_full_stop(beginning)}."
                return Heading(finding, details=capitalize_first(rest.removeprefix(end)))
    return Heading(text, "")
