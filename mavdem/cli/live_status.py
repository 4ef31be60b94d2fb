"""Status of a live session on standard error: two lines updated in place on a terminal, elsewhere lines with news."""

from collections.abc import Hashable
from contextlib import suppress
from math import inf
from time import monotonic, strftime
from typing import NamedTuple

from rich.console import Group
from rich.live import Live
from rich.text import Text

from mavdem.cli.streams import STDERR, escape_unprintable, print_to_stderr
from mavdem.facts import Fact, Facts, Figure
from mavdem.live.session import LiveSession
from mavdem.live.session_status import SessionStatus
from mavdem.report.live import watched_quantities_text
from mavdem.report.templates import render_section

UNCHANGED_STATE_PERIOD = 30.0
"""Time between two lines of a state that is the same except for its figures, s; a choice."""


class PrintedState(NamedTuple):
    """The state of a session that a line reports, without its values."""

    vehicle: str | None
    """The vehicle; None before it is known."""

    obstacle: Hashable
    """Code of the reason why there is no new model; None while models are learned."""

    is_late: bool
    """Whether this computer does not keep up."""


class StatusLines:
    """Shows the status of a live session on standard error.

    On a terminal the status is updated where it is. Elsewhere a line with the time of day is printed where the state is
    new, and every ``UNCHANGED_STATE_PERIOD``. Which quantities are watched, or no longer are, is printed when it
    changes. A fact is new if it has another code; the same code with other values is not printed again.
    """

    def __init__(self, terminal_text: Live | None) -> None:
        """Shows nothing yet.

        Args:
            terminal_text: The text on the terminal that is updated; None to print lines below each other.
        """
        self._terminal_text = terminal_text
        # The state that was printed last and when, s of the monotonic clock; and what was watched, or why not.
        self._printed_state: PrintedState | None = None
        self._print_time = -inf
        self._watch_meanings: set[Hashable] = set()

    def show(self, session: LiveSession) -> None:
        """Shows the present status of a session.

        On a terminal, two lines are updated in place: one on the learning, and one on problems and on the quantities
        that are watched without a model, such as the battery. The second is red while an alarm lasts. Elsewhere, as in
        a file, only what is new is printed.

        Args:
            session: The session.
        """
        status = session.status
        self._print_watch_changes(status.watch_facts)
        sentences = [
            escape_unprintable(sentence.text)
            for sentence in render_section("live_status", status=status)
        ]
        if self._terminal_text is None:
            self._print_new(status, sentences)
            return
        learning_line = sentences[0]
        problems = sentences[1:]
        # The obstacle to learning is stated in the sentences above: it is not repeated as the reason for not watching.
        watched = watched_quantities_text(status.watch_facts, status.obstacle)
        second_line = Text(" ".join([*problems, watched]), _style(*status.active_alarms))
        self._terminal_text.update(Group(learning_line, second_line), refresh=True)

    def _print_watch_changes(self, watch_facts: Facts) -> None:
        """Prints the quantities that are watched, or are no longer watched, since the last call, with the reason.

        Args:
            watch_facts: A fact for each quantity that is watched without a model, such as the battery: since when it is
                watched, or why it is not.
        """
        former_meanings = self._watch_meanings
        self._watch_meanings = {_meaning(fact) for fact in watch_facts}
        changed_facts = [fact for fact in watch_facts if _meaning(fact) not in former_meanings]
        if changed_facts:
            print_to_stderr(timed(watched_quantities_text(changed_facts)))

    def _print_new(self, status: SessionStatus, sentences: list[str]) -> None:
        """Prints a line if the state has changed since the last line, or if that line was printed long ago.

        The session itself reports alarms and obstacles to learning when they begin. So the line repeats them only as a
        reminder, when the state has not changed for long.

        Args:
            status: The status.
            sentences: The sentence about the learning, then those about problems.
        """
        state = PrintedState(
            status.vehicle,
            None if status.obstacle is None else _meaning(status.obstacle),
            status.delay_fact is not None,
        )
        now = monotonic()
        is_new = state != self._printed_state
        if not is_new and now - self._print_time < UNCHANGED_STATE_PERIOD:
            return
        self._printed_state = state
        self._print_time = now
        printed_sentences = sentences
        if is_new:
            printed_sentences = sentences[:1]
            if status.delay_fact is not None:
                printed_sentences.append(str(status.delay_fact))
        print_to_stderr(timed(" ".join(printed_sentences)))


def _meaning(figure: Figure) -> Hashable:
    """Returns the content of a fact without its measurements, so that two facts can be compared for news.

    Measurements vary from second to second, and their changes are no news.

    Args:
        figure: A fact, or a value of one.

    Returns:
        A key of the fact's code, level, subject and values, with None in the place of every number.
    """
    if isinstance(figure, Fact):
        figures = tuple((name, _meaning(value)) for name, value in figure.figures.items())
        return figure.code, figure.level, figure.subject, figures
    if isinstance(figure, tuple):
        return tuple(map(_meaning, figure))
    is_measurement = isinstance(figure, int | float) and not isinstance(figure, bool)
    return None if is_measurement else figure


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
