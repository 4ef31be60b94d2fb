"""Status of a live session on standard error: one line that is updated on a terminal, elsewhere lines with news."""

import re
from contextlib import suppress
from math import inf
from time import monotonic, strftime
from typing import NamedTuple

from rich.console import Group
from rich.live import Live
from rich.text import Text

from mavdem.cli.streams import STDERR, escape_unprintable, print_to_stderr
from mavdem.facts import Fact, Facts
from mavdem.live.session import LiveSession
from mavdem.live.session_status import SessionStatus
from mavdem.report.live import watched_quantities
from mavdem.report.templates import render_section

UNCHANGED_STATE_PERIOD = 30.0
"""Time between two lines of a state that is the same except for its figures, s; a choice."""

MEASUREMENT = re.compile(r"\d[\d.,]*(?= ?(?:Hz|ms|min|s|V|A|m|m/s|%|°)(?!\w))")
"""A number with a unit in a sentence. It varies from second to second, and is no news; the number of a motor is."""


class PrintedState(NamedTuple):
    """What a line says of the state of a session, without its figures."""

    vehicle: str | None
    """The vehicle; None before it is known."""

    obstacle: str
    """Code of the fact why there is no new model; empty while all is well."""


class StatusLines:
    """Shows the status of a live session on standard error.

    On a terminal two lines are updated where they are. Elsewhere a line with the time of day is printed where the state
    or a sentence is new, and every ``UNCHANGED_STATE_PERIOD``. Which quantities are watched, or no longer are, is
    printed when it changes.
    """

    def __init__(self, terminal_text: Live | None) -> None:
        """Shows nothing yet.

        Args:
            terminal_text: The text on the terminal that is updated; None to print lines below each other.
        """
        self._terminal_text = terminal_text
        # The last sentences on problems and on what is watched, without measurements; the state that was printed last;
        # and when, s of the monotonic clock.
        self._printed_problems: set[str] = set()
        self._printed_state: PrintedState | None = None
        self._print_time = -inf
        self._watch_texts: set[str] = set()

    def show(self, session: LiveSession) -> None:
        """Shows the present status of a session.

        On a terminal, two lines are updated in place: one on the learning, and one on everything else, which is cut at
        the width of the terminal and red while an alarm lasts. Elsewhere, as in a file, only new sentences are printed.

        Args:
            session: The session.
        """
        status = session.status
        self._report_watch_changes(status.watch_facts)
        sentences = [
            escape_unprintable(sentence.text)
            for sentence in render_section("live_status", status=status)
        ]
        if self._terminal_text is None:
            self._print_new(_printed_state(status), sentences)
            return
        # The first sentence is on the learning. The others, on problems and on what is watched, share a line.
        remarks = [*sentences[1:], watched_quantities(status.watch_facts)]
        remark_line = Text(" ".join(remarks), _style(*status.active_alarms))
        remark_line.truncate(STDERR.width, overflow="ellipsis")
        self._terminal_text.update(Group(sentences[0], remark_line), refresh=True)

    def _report_watch_changes(self, watch_facts: Facts) -> None:
        """Prints the quantities whose watching has begun or ended since the last call, and why.

        Args:
            watch_facts: Fact for each quantity that it is monitored, or why it is not.
        """
        former_texts = self._watch_texts
        self._watch_texts = set()
        changed_facts = []
        for fact in watch_facts:
            text = _without_measurements(watched_quantities([fact]))
            self._watch_texts.add(text)
            if text not in former_texts:
                changed_facts.append(fact)
        if changed_facts:
            print_to_stderr(timed(watched_quantities(changed_facts)))

    def _print_new(self, state: PrintedState, sentences: list[str]) -> None:
        """Prints the sentences of a status that the status before did not have, as one line.

        Other figures alone are no news.

        Args:
            state: The vehicle and the obstacle to learning.
            sentences: First that on the learning, whose figures always differ, then those on problems.
        """
        learning, *problems = sentences
        former_problems = self._printed_problems
        self._printed_problems = {_without_measurements(sentence) for sentence in problems}
        new_problems = [
            sentence
            for sentence in problems
            if _without_measurements(sentence) not in former_problems
        ]
        now = monotonic()
        is_due = now - self._print_time >= UNCHANGED_STATE_PERIOD
        if new_problems or state != self._printed_state or is_due:
            self._printed_state = state
            self._print_time = now
            print_to_stderr(timed(" ".join([learning, *new_problems])))


def _printed_state(status: SessionStatus) -> PrintedState:
    """Returns what a line says of the state of a session, without its figures."""
    obstacle = "" if status.obstacle is None else str(status.obstacle.code)
    return PrintedState(status.vehicle, obstacle)


def _without_measurements(sentence: str) -> str:
    """Returns a sentence with a sign in the place of each measurement, by which it is found to be the same."""
    return MEASUREMENT.sub("#", sentence)


def print_fact(fact: Fact) -> None:
    """Prints a fact on standard error, in red if it is bad; where that is no terminal, it is one line."""
    text = Text(timed(escape_unprintable(fact.advised)), _style(fact))
    with suppress(OSError):
        STDERR.print(text, soft_wrap=not STDERR.is_terminal)


def timed(text: str) -> str:
    """Returns a line with the time of day before it, by which a pilot finds it again."""
    return f"{strftime('%H:%M:%S')} {text}"


def _style(*facts: Fact) -> str:
    """Returns the style of a text about facts, in Rich's words: red if one of them is bad."""
    if any(fact.is_bad for fact in facts):
        return "bold red"
    return ""
