"""Status of a live session on standard error: lines updated in place on a terminal, elsewhere lines with news."""

from collections.abc import Hashable
from contextlib import suppress
from math import inf
from time import monotonic, strftime
from typing import NamedTuple

from rich.console import Group
from rich.live import Live
from rich.text import Text

from mavdem.cli.streams import STDERR, escape_unprintable, print_to_stderr
from mavdem.facts import Fact, Facts
from mavdem.facts.event import Event
from mavdem.facts.session import LinkFact, RowsFact, SessionFact
from mavdem.facts.watch import WatchFact
from mavdem.live.session import LiveSession
from mavdem.live.session_status import SessionStatus
from mavdem.report.live import (
    moment_text,
    vehicle_text,
    verdict_lines,
    watched_quantities_text,
)
from mavdem.report.templates import render_section

UNCHANGED_STATE_PERIOD = 30.0
"""Time between two lines of a state that is the same except for its figures, s; a choice."""


PASSING_OBSTACLES = frozenset(
    {
        WatchFact.ON_GROUND_NOW,
        WatchFact.REFERENCE_SHORT,
        SessionFact.NOT_SETTLED,
        RowsFact.NOTHING_RECEIVED,
        LinkFact.CONNECTION_LOST,
    }
)
"""Reasons for not watching that pass by themselves, or have a line of their own: no line repeats them."""


class PrintedState(NamedTuple):
    """The state of a session that a line reports, without its values."""

    vehicle: str | None
    """The vehicle; None before it is known."""

    is_waiting: bool
    """Whether something prevents learning."""

    is_alarmed: bool
    """Whether an alarm lasts."""

    is_late: bool
    """Whether this computer does not keep up."""


class StatusLines:
    """Shows the status of a live session on standard error.

    On a terminal the status is updated where it is. Elsewhere a line with the time of day is printed where the state is
    new, and every ``UNCHANGED_STATE_PERIOD``. Which quantities are watched, or cannot be, is printed when it changes,
    and not for ``PASSING_OBSTACLES``. A fact is new if it has another code; the same code with other values is not
    printed again.
    """

    def __init__(self, terminal_text: Live | None) -> None:
        """Shows nothing yet.

        Args:
            terminal_text: The text on the terminal that is updated; None to print lines below each other.
        """
        self._terminal_text = terminal_text
        # The state that was printed last and when, s of the monotonic clock; and what was last printed of each quantity
        # that is watched, by its vehicle and name.
        self._printed_state: PrintedState | None = None
        self._print_time = -inf
        self._watch_meanings: dict[Hashable, Hashable] = {}

    def show(self, session: LiveSession) -> None:
        """Shows the present status of a session.

        On a terminal, lines are updated in place: one on the vehicle and the link, one with the verdict so far and the
        next step, one on the learning, and one on problems and on the quantities that are watched without a model, such
        as the battery. Those on the verdict and on problems are red while an alarm lasts. Elsewhere, as in a file, only
        what is new is printed.

        Args:
            session: The session.
        """
        status = session.status
        if status.loss is None:
            self._print_watch_changes(status.watch_facts)
        sentences = [
            escape_unprintable(sentence.text)
            for sentence in render_section("live_status", status=status)
        ]
        judgement = status.overall_judgement
        vehicle_line = escape_unprintable(vehicle_text(status))
        verdict = escape_unprintable(" ".join(verdict_lines(judgement)))
        obstacle = status.obstacle
        if obstacle is not None:
            # The reason why nothing is learned, and its remedy, are left out here if the verdict states them.
            advised = escape_unprintable(obstacle.advised)
            remedy = escape_unprintable(obstacle.remedy)
            if judgement.headline == obstacle:
                sentences[sentences.index(advised)] = "" if remedy in verdict else remedy
            elif remedy in verdict:
                sentences[sentences.index(advised)] = escape_unprintable(obstacle.sentence)
        sentences = [text for text in sentences if text and text not in verdict]
        if self._terminal_text is None:
            self._print_new(status, [vehicle_line, *sentences, verdict])
            return
        learning_line = sentences[0]
        problems = sentences[1:]
        # The obstacle to learning is stated in the sentences above: it is not repeated as the reason for not watching.
        watched = watched_quantities_text(status.watch_facts, status.obstacle)
        style = _style(*status.active_alarms)
        lines = Group(
            vehicle_line,
            Text(verdict, style),
            learning_line,
            Text(" ".join([*problems, watched]), style),
        )
        self._terminal_text.update(lines, refresh=True)

    def _print_watch_changes(self, watch_facts: Facts) -> None:
        """Prints the quantities that are watched, or are no longer watched, since the last call, with the reason.

        Args:
            watch_facts: A fact for each quantity that is watched without a model, such as the battery: since when it is
                watched, or why it is not.
        """
        changed_facts = []
        for fact in watch_facts:
            reason = fact.figures.get("reason")
            if isinstance(reason, Fact) and reason.code in PASSING_OBSTACLES:
                continue
            key = (fact.figures.get("vehicle"), fact.subject)
            if self._watch_meanings.get(key) != fact.meaning:
                self._watch_meanings[key] = fact.meaning
                changed_facts.append(fact)
        if changed_facts:
            print_to_stderr(timed(watched_quantities_text(changed_facts)))

    def _print_new(self, status: SessionStatus, sentences: list[str]) -> None:
        """Prints a line if the state has changed since the last line, or if that line was printed long ago.

        A changed state is a short line on the vehicle and the learning, since the session itself reports alarms and
        reasons for learning no model when they begin. A state that has not changed for ``UNCHANGED_STATE_PERIOD`` is
        repeated as a reminder, with all problems, the headline and the next step.

        Args:
            status: The status.
            sentences: A sentence about the vehicle, one about the learning, those about problems, and at the end the
                headline with the next step.
        """
        state = PrintedState(
            status.vehicle,
            status.obstacle is not None,
            any(fact.is_bad for fact in status.active_alarms),
            status.delay_fact is not None,
        )
        now = monotonic()
        is_new = state != self._printed_state
        if not is_new and now - self._print_time < UNCHANGED_STATE_PERIOD:
            return
        self._printed_state = state
        self._print_time = now
        # The reason why nothing is learned was reported when it began: it is not repeated.
        reported_texts = set()
        if status.obstacle is not None:
            reported_texts.add(escape_unprintable(status.obstacle.sentence))
            reported_texts.add(escape_unprintable(status.obstacle.advised))
        *first_sentences, verdict = sentences
        printed_sentences = [text for text in first_sentences if text not in reported_texts]
        printed_sentences.append(verdict)
        if is_new:
            printed_sentences = sentences[:2]
            if status.delay_fact is not None:
                printed_sentences.append(str(status.delay_fact))
        print_to_stderr(timed(" ".join(printed_sentences)))


def print_fact(fact: Fact, moment: str = "") -> None:
    """Prints a fact on standard error, in red if it is bad; where that is no terminal, it is one line.

    Args:
        fact: The fact.
        moment: When it was reported; empty for now.
    """
    text = Text(timed(escape_unprintable(fact.advised), moment), _style(fact))
    with suppress(OSError):
        STDERR.print(text, soft_wrap=not STDERR.is_terminal)


def print_event(event: Event) -> None:
    """Prints an event as ``print_fact`` does, after the time of day and that of the vehicle's clock."""
    print_fact(event.fact, moment_text(event))


def timed(text: str, moment: str = "") -> str:
    """Returns a line with the time before it, by which a pilot finds it again.

    Args:
        text: The line.
        moment: The time; empty for the present time of day.
    """
    return f"{moment or strftime('%H:%M:%S')} {text}"


def _style(*facts: Fact) -> str:
    """Returns the style of a text about facts, in Rich's words: red if one of them is bad."""
    if any(fact.is_bad for fact in facts):
        return "bold red"
    return ""
