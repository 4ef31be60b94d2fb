"""Status of a live session, with facts (coded findings): updated in place on a terminal, or lines below each other."""

from collections import deque
from collections.abc import Hashable, Sequence
from contextlib import suppress
from math import ceil, inf, isfinite, nan
from time import monotonic
from typing import NamedTuple

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from mavdem.assessment.judgement import Judgement
from mavdem.cli.console import STDERR, STDOUT
from mavdem.cli.live_lines import (
    LEVEL_STYLES,
    NEXT_MARKER,
    STAMP_WIDTH,
    VERDICT_MARKER,
    WARNING_MARKER,
    brief_alarm_line,
    event_line,
    print_line,
    stamped_line,
    style_of_facts,
)
from mavdem.cli.streams import MAX_COLUMNS, escape_unprintable, print_to_stderr
from mavdem.errors import error_message
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.event import LEARNING_STATES, SESSION_STATES, Event
from mavdem.facts.margins import MarginsLight
from mavdem.facts.motors import MotorWatchFact
from mavdem.facts.session import LinkFact, RowsFact, SessionFact, VehicleFact
from mavdem.facts.watch import WatchedQuantity, WatchFact
from mavdem.live import clock
from mavdem.live.event_cause import cause_of_alarm
from mavdem.live.session import LiveSession
from mavdem.live.session_status import SessionStatus
from mavdem.report.blocks import shortened
from mavdem.report.live import (
    NEXT_STEP_LEAD,
    LightRow,
    headline_and_next_step,
    light_rows,
    statement_of_headline,
    states_unrepaired_fault,
    status_line_text,
    unrepaired_fault_beside_next_step,
    unwatched_quantities_text,
    vehicle_text,
    verdict_on_present_flight,
    watched_quantities_text,
)
from mavdem.report.templates import headline as headline_text
from mavdem.report.templates import render_section

UNCHANGED_STATE_PERIOD = 30.0
"""Time between two lines of a state that is the same except for its figures, s; a choice."""

NAME_WIDTH = 9
"""Width of the column with a light's name, characters: the longest name, "estimator"."""

LEVEL_WIDTH = 7
"""Width of the column with a light's level, characters: the longest level, "unknown"."""

GAPS_WIDTH = 3
"""Spaces that follow the three columns of a light, one behind each: name, level and figure."""

MIN_LIGHT_WIDTH = 40
"""Least width of a light with its figure, such as "2.2 to 9.8 m/s, 48°", characters: two fit on a line of 80."""

MAX_HEADLINE_LINES = 2
"""Most lines of the headline on a terminal: a longer one loses its details, so that the table below is seen. A choice.
"""

MAX_LIGHTS_PER_LINE = 2
"""Lights on a line of the widest terminal, a choice: with more, there is too little room for most texts beside them."""

UNREPORTED_REASONS = frozenset(
    {
        WatchFact.ON_GROUND_NOW,
        WatchFact.OSCILLATION_AWAITED,
        WatchFact.SETTLED_FLIGHT_AWAITED,
        WatchFact.TRACKING_AWAITED,
        SessionFact.NOT_SETTLED,
        RowsFact.MOTORS_NOT_KNOWN,
        RowsFact.RATES_BEING_MEASURED,
        RowsFact.NOTHING_RECEIVED,
        LinkFact.CONNECTION_LOST,
    }
)
"""Reasons for not watching that pass by themselves, or have a line of their own: no line repeats them."""

SETTLING_SECONDS = 4.0
"""Time for which the list of watched quantities must stay the same before its changes are printed, s.

It is longer than the silence after which a message counts as missing. The status that is updated in place shows the
changes at once.
"""

ADVICE_SECONDS = 10.0
"""Time after a line with advice for which the next step is not printed in the same words, s.

The status is printed every 5 s, so that this holds for two of its lines. For as long after the end of an alarm a new
next step is printed at once.
"""

UNPRINTED_STATES = LEARNING_STATES | {
    SessionFact.COMPUTER_BEHIND,
    SessionFact.COMPUTER_KEEPS_UP,
    SessionFact.PARAMETERS_KNOWN,
}
"""Events that are not printed: the status has them, or the report after the landing, and the page lists them."""

MAX_EVENT_LINES = 3
"""Most lines of an event on a terminal that is neither an alarm nor a warning, a choice: a longer one loses details."""

MAX_LATEST_LINES = 50
"""Lines above the status that are kept, to draw them anew where the terminal is resized: more than it shows."""

MAX_SETTLING_SECONDS = 15.0
"""Longest time that a change waits to be printed while further quantities change, s; a choice."""


class PrintedState(NamedTuple):
    """The state of a session that a line reports, without its values."""

    vehicle: str | None
    """The vehicle; None before it is known."""

    is_waiting: bool
    """Whether something prevents learning."""

    is_alarmed: bool
    """Whether an alarm lasts."""

    is_late: bool
    """Whether alarms come so late that a pilot must not rely on them."""

    is_motion_missing: bool
    """Whether attitude or motor outputs have not come for so long that the session has reported it."""


class ChangeDebouncer:
    """Holds back changes of the watched quantities until they are stable, so that only the last of them are printed.

    After an attachment or a take-off the list of these quantities changes each second, while messages are received for
    the first time or requested. Only the list in which this results is printed.
    """

    def __init__(self) -> None:
        """Begins without changes."""
        # The facts that differ from those printed last, by quantity.
        self._pending_changes: dict[Hashable, Hashable] = {}
        # When these facts changed last, and when the first of them did, s of the monotonic clock.
        self._latest_change_time = -inf
        self._first_change_time = -inf

    def update(self, changes: dict[Hashable, Hashable], now: float) -> bool:
        """Takes the present changes of the status, and returns whether they are stable enough to be printed.

        They are if they stayed the same for ``SETTLING_SECONDS``, or if some change has been pending for
        ``MAX_SETTLING_SECONDS``.

        Args:
            changes: What differs from the status that was printed last, without numbers, by quantity; empty for no
                change.
            now: Present time, s of the monotonic clock.

        Returns:
            Whether to print them now.
        """
        if not self._pending_changes:
            self._first_change_time = now
        if changes != self._pending_changes:
            self._pending_changes = changes
            self._latest_change_time = now
        stays_the_same = now - self._latest_change_time >= SETTLING_SECONDS
        waits_too_long = now - self._first_change_time >= MAX_SETTLING_SECONDS
        return stays_the_same or waits_too_long


class StatusTexts(NamedTuple):
    """The status of a session in sentences, ready to be printed."""

    vehicle: str
    """The vehicle, its mode and its battery."""

    learning: str
    """Whether the session learns, and how much it has learned."""

    problems: list[str]
    """What is wrong now: alarms, a computer that is too slow, and why nothing is learned."""

    headline: str
    """The headline of the judgement so far."""

    next_step: str
    """What to do next; empty if the headline says it."""


class StatusLines:
    """Shows the status of a live session on a terminal, or prints it as lines below each other.

    On a terminal the status is updated where it is. Elsewhere a short line is printed where the state is new, and every
    ``UNCHANGED_STATE_PERIOD``. Which quantities are watched, or cannot be, is printed when it changes, and not for
    ``UNREPORTED_REASONS``. A fact is new if it has another code; the same code with other values is not printed again.

    Attributes:
        terminal_text: The text on the terminal that is updated; None to print lines below each other.
    """

    def __init__(self, terminal_text: Live | None = None, console: Console = STDOUT) -> None:
        """Shows nothing yet.

        Args:
            terminal_text: The text on the terminal that is updated; None to print lines below each other.
            console: Where the lines below each other are printed.
        """
        self.terminal_text = terminal_text
        self._line_console = console
        # Whether the session prints lines below each other, which begin with the time.
        self._has_stamps = terminal_text is None
        # The alarms and the vehicle of the status on the terminal.
        self._shown_alarms: Facts = ()
        self._shown_vehicle: str | None = None
        # The latest lines above that status, with their styles, and the size of the terminal when they were printed.
        self._latest_lines: deque[tuple[str, str]] = deque(maxlen=MAX_LATEST_LINES)
        self._terminal_size = STDERR.size
        # The next step that was printed last, and its sentence.
        self._printed_next_step: Fact | None = None
        self._printed_next_text = ""
        # The headline that was printed last as the reason of a next step; empty before any.
        self._printed_reason = ""
        # The next step at the latest look, without its numbers.
        self._latest_next_step: Hashable = None
        # What the latest alarm, warning or other event advised, and when it was printed, s of the monotonic clock.
        self._advised_text = ""
        self._advice_time = -inf
        # When the end of an alarm was printed last, s of the monotonic clock.
        self._alarm_end_time = -inf
        # The line on the fault of an earlier flight that was printed last, empty before any; which flight and phase it
        # was about; and when it was printed, s of the monotonic clock.
        self._printed_fault_of_earlier_flight = ""
        self._printed_fault_key: Hashable = None
        self._fault_print_time = -inf
        # The line of the latest landing, which states what was found until then; empty before any.
        self._landing_text = ""
        # Code and subject of the headline at the latest look on the ground after a flight; None in flight.
        self._headline_on_ground: Hashable = None
        # Number of the boot, and time on its clock, s, of the latest line, which the lines at the end have too.
        self._latest_moment = (0, nan)
        # Whether the latest report on the link was an alarm.
        self._is_link_alarmed = False
        # Whether a line has warned of the present loss of the link.
        self._is_link_warned = False
        # Whether standard error has said that lines were lost, since they cannot be printed.
        self._is_loss_of_lines_reported = False
        # The state that was printed last and when, s of the monotonic clock.
        self._printed_state: PrintedState | None = None
        self._print_time = -inf
        # The fact printed last, without its numbers, for each watched quantity; keys are its vehicle and name.
        self._printed_watch_facts: dict[Hashable, Hashable] = {}
        self._watch_change_debouncer = ChangeDebouncer()

    def start_in_place(self) -> None:
        """Starts to update the status in its place on the terminal, on standard error."""
        self._has_stamps = False
        self._terminal_size = STDERR.size
        self.terminal_text = Live(console=STDERR, auto_refresh=False, transient=True)
        self.terminal_text.start()

    def stop_in_place(self) -> None:
        """Removes the status from the terminal, if it was updated there; the lines above it stay."""
        if self.terminal_text is None:
            return
        # A terminal that was closed takes no text any more.
        with suppress(OSError):
            self.terminal_text.stop()
        self.terminal_text = None

    def show(self, session: LiveSession) -> None:
        """Shows the present status of a session, as ``show_status`` does.

        Args:
            session: The live session: its link, the vehicle and the model that it learns.
        """
        self.show_status(session.shown_status)

    def show_status(self, status: SessionStatus) -> None:
        """Shows a status of a session.

        On a terminal, lines are updated in place: the vehicle, the headline so far, the next step, a table of the
        lights with their levels and figures, and one on learning, problems, and what is not watched. The headline and
        problems have the colour of the worst alarm. Elsewhere, as in a file, only what is new is printed.

        Args:
            status: State of the live session: vehicle, learning, alarms, lights and next step.
        """
        self._latest_moment = (status.boot, status.boot_clock)
        self._print_link_warning(status)
        if status.loss is None:
            self._print_watch_changes(status)
        if self.terminal_text is None:
            self._print_state(status)
        else:
            self.update_in_place(status)

    def show_if_new(self, status: SessionStatus) -> None:
        """Updates the status on a terminal if its alarms or its vehicle have changed since it was shown.

        This is called once a second, and just before an alarm or a vehicle is reported. Otherwise the report would
        stand above a status that contradicts it, until the status is updated a second later. Where lines are printed
        instead, the fault of an earlier flight is printed at the take-off, and that a link was just lost in flight.

        Args:
            status: Present state of the live session.
        """
        self._print_link_warning(status)
        has_other_alarms = status.alarms != self._shown_alarms
        has_other_vehicle = status.vehicle != self._shown_vehicle
        if has_other_alarms or has_other_vehicle:
            self.update_in_place(status)
        if self.terminal_text is None and status.is_in_flight:
            # The pilot must know at the take-off, before the next line of the state.
            self._print_fault_of_earlier_flight(status)

    def print_event(self, event: Event) -> None:
        """Prints an event of a live session, such as a take-off or an alarm, as a line of its own.

        Where the status is updated in its place, the line stands above it, and the terminal's bell rings with each
        alarm.

        Args:
            event: What was found, and when.
        """
        if isfinite(event.clock):
            self._latest_moment = (event.boot, event.clock)
        # Other alarms end by an event of their own. That of a lost link ends by the event that messages come again,
        # whose line then says so. This must be decided before the event changes whether that alarm is active.
        ends_alarm = self._is_link_alarmed and event.fact.code is RowsFact.MESSAGES_RESUMED
        self._update_link_alarm(event)
        if self.terminal_text is None:
            self._append_event_line(event, ends_alarm=ends_alarm)
        else:
            self._insert_event_line(event, ends_alarm=ends_alarm)

    def _append_event_line(self, event: Event, *, ends_alarm: bool) -> None:
        """Prints an event as the next line, as to a file, unless another line or the status states it.

        Args:
            event: What was found, and when.
            ends_alarm: Whether it ends the alarm of a lost link.
        """
        fact = event.fact
        if fact.code in UNPRINTED_STATES or self._is_verdict_printed(fact):
            return
        # What to do is said on the line of each event but one. Whether a vehicle that stands on the ground may take off
        # depends on its earlier flights: the line on the next step considers these.
        has_remedy = fact.code is not SessionFact.NOT_FLYING
        self._store_printed_event(event, has_remedy=has_remedy, ends_alarm=ends_alarm)
        is_known_link_loss = fact.code is LinkFact.LOST_IN_FLIGHT and self._is_link_warned
        if is_known_link_loss:
            # A warning has said what is lost and what to do, some seconds ago.
            line = brief_alarm_line(event)
        else:
            line = event_line(event, has_remedy=has_remedy, ends_alarm=ends_alarm)
        self._print(line, style_of_facts(fact))

    def _store_printed_event(self, event: Event, *, has_remedy: bool, ends_alarm: bool) -> None:
        """Stores what the line of an event says, so that lines on the status do not say it again.

        Args:
            event: What was found, and when.
            has_remedy: Whether the line says what to do about it.
            ends_alarm: Whether it ends the alarm of a lost link.
        """
        fact = event.fact
        if ends_alarm or fact.code is WatchFact.ALARM_OVER:
            self._store_alarm_end()
        elif has_remedy and fact.remedy:
            self._store_advice(fact.remedy, is_alarm=event.is_alarm)
        if fact.code is SessionFact.FLIGHT_LEARNED:
            # This is the event of a landing.
            self._landing_text = fact.sentence

    def _is_verdict_printed(self, fact: Fact) -> bool:
        """Returns whether a fact is the verdict on a flight that a line has just stated.

        At a take-off, the line on the fault of the flight before may come before the verdict on that flight.

        Args:
            fact: What an event has found.
        """
        is_verdict = fact.code is SessionFact.FLIGHT_VERDICT
        is_in_printed_line = fact.sentence in self._printed_fault_of_earlier_flight
        return is_verdict and is_in_printed_line and _is_recent(self._fault_print_time)

    def _store_advice(self, advice: str, *, is_alarm: bool) -> None:
        """Stores what a printed line advises, so that the next step does not repeat it right after.

        Args:
            advice: What the line says is to be done.
            is_alarm: Whether the line is an alarm. Its advice replaces the next step that was printed before, which is
                then printed again as soon as it holds again.
        """
        self._advised_text = advice
        self._advice_time = monotonic()
        if is_alarm:
            self._printed_next_step = None
            self._printed_next_text = ""

    def _store_alarm_end(self) -> None:
        """Stores that an alarm is over now: its advice does not hold any more, and another step is printed soon."""
        self._advised_text = ""
        self._alarm_end_time = monotonic()

    def _insert_event_line(self, event: Event, *, ends_alarm: bool) -> None:
        """Prints an event above the status on the terminal, with a bell if it is an alarm.

        A small terminal has room for few lines. So an event that the status shows is not printed, only alarms and
        warnings say what to do, and other events have ``MAX_EVENT_LINES`` lines at most.

        Args:
            event: What was found, and when.
            ends_alarm: Whether it ends the alarm of a lost link.
        """
        fact = event.fact
        if event.is_alarm:
            # A terminal that was closed takes no bell any more.
            with suppress(OSError):
                STDERR.bell()
        if _is_event_in_status(event):
            return
        has_remedy = event.is_alarm or fact.is_watch_or_bad
        line = event_line(event, has_remedy=has_remedy, ends_alarm=ends_alarm)
        if not fact.is_watch_or_bad:
            # Further lines of a text are indented by the width of the time with which the first one begins.
            text_width = STDERR.width - STAMP_WIDTH
            max_characters = STAMP_WIDTH + MAX_EVENT_LINES * text_width
            # On a terminal that is narrower than the time, one line is left.
            line = shortened(line, max(max_characters, STDERR.width))
        self._print(line, style_of_facts(fact))

    def _print(self, line: str, style: str = "") -> None:
        """Prints a line on the present output.

        On a terminal it stands above the status, which is updated in its place below all lines. Otherwise, as in a
        file, it stands below the line before.

        Args:
            line: The line.
            style: Style of its text on a terminal.
        """
        is_status_on_terminal = self.terminal_text is not None
        if not is_status_on_terminal:
            self._append_line(line, style)
        else:
            # The latest lines are printed again when the size of the terminal has changed.
            self._latest_lines.append((line, style))
            print_line(line, STDERR, style)

    def _append_line(self, line: str, style: str = "", *, indent: int = STAMP_WIDTH) -> None:
        """Prints a line after the line before; the first one that cannot be printed is reported on standard error.

        Args:
            line: The line.
            style: Style of its text on a terminal.
            indent: Characters before its text on a terminal, which begins with the times; 0 without these.
        """
        error = print_line(line, self._line_console, style, indent=indent)
        if error is not None and not self._is_loss_of_lines_reported:
            self._is_loss_of_lines_reported = True
            loss = Fact(SessionFact.LINES_LOST, reason=error_message(error))
            print_to_stderr(f"mavdem: {loss.sentence}")

    def _redraw_after_resizing(self) -> None:
        """Draws the terminal anew if its size has changed, since lines that it has wrapped anew cannot be erased."""
        if STDERR.size == self._terminal_size:
            return
        self.stop_in_place()
        STDERR.clear()
        self.start_in_place()
        # The status, which follows, needs the other half of the terminal.
        for line, style in self._latest_lines_in_rows(STDERR.height // 2):
            print_line(line, STDERR, style)

    def _latest_lines_in_rows(self, available_rows: int) -> list[tuple[str, str]]:
        """Returns as many of the latest lines as the terminal has room for, with their styles, the oldest line first.

        Args:
            available_rows: Rows of the terminal for them; a line that is wider than the terminal takes several.
        """
        fitting_lines: list[tuple[str, str]] = []
        for line, style in reversed(self._latest_lines):
            available_rows -= ceil(len(line) / STDERR.width)
            if available_rows < 0:
                break
            fitting_lines.append((line, style))
        return fitting_lines[::-1]

    def _update_link_alarm(self, event: Event) -> None:
        """Stores whether the alarm of a lost link lasts: from its loss in flight until messages come again.

        Args:
            event: What was found, and when.
        """
        if event.fact.code is LinkFact.LOST_IN_FLIGHT and event.is_alarm:
            self._is_link_alarmed = True
        elif event.fact.code is RowsFact.MESSAGES_RESUMED:
            self._is_link_alarmed = False

    def update_in_place(self, status: SessionStatus) -> None:
        """Shows a status on the terminal in the place of the one before; does nothing if lines are printed instead.

        Nothing is shown on a terminal that was closed, which raises ``OSError``: the operating system then sends a
        signal, by which the session ends in order.

        Args:
            status: State of the live session: vehicle, learning, alarms, headline and next step.
        """
        if self.terminal_text is None:
            return
        with suppress(OSError):
            self._redraw_after_resizing()
        # ``show_if_new`` compares these with the alarms and the vehicle of a newer status.
        self._shown_alarms = status.alarms
        self._shown_vehicle = status.vehicle
        status_block = _status_block(status)
        with suppress(OSError):
            self.terminal_text.update(status_block, refresh=True)

    def _print_watch_changes(self, status: SessionStatus) -> None:
        """Prints which quantities the session watches for faults now, and which not and why, if that has changed.

        Quantities are, for example, the battery and the vibration. A change is printed once it is stable, so that
        quantities which become known one after the other share a line.

        Args:
            status: State of the live session, with a fact (coded finding) for each of these quantities: since when it
                is watched, or why it is not.
        """
        reportable_facts = _reportable_facts(_watch_facts_without_alarm(status))
        is_updated_in_place = self.terminal_text is not None
        if is_updated_in_place:
            # A status that is updated in place names all that is not watched: what is watched again needs no line.
            self._forget_reasons_of_watched(reportable_facts)
            reportable_facts = _unwatched_facts(reportable_facts)
        changed_facts = []
        # The changed facts as they are compared with those of the next status.
        changes: dict[Hashable, Hashable] = {}
        for quantity, fact in reportable_facts.items():
            # Measured numbers in a fact change all the time, which is no change to report.
            fact_without_numbers = fact.without_measurements
            if self._printed_watch_facts.get(quantity) != fact_without_numbers:
                changed_facts.append(fact)
                changes[quantity] = fact_without_numbers
        # The debouncer must get each status, also one without changes: that ends the wait for earlier ones.
        is_stable = self._watch_change_debouncer.update(changes, monotonic())
        if changes and is_stable:
            self._printed_watch_facts.update(changes)
            text = escape_unprintable(watched_quantities_text(changed_facts))
            self._print_now(text, status)

    def _forget_reasons_of_watched(self, watch_facts: dict[Hashable, Fact]) -> None:
        """Forgets why quantities were not watched that are watched now, so that the same reason is printed once more.

        Args:
            watch_facts: For each quantity, such as vibration, since when it is watched, or why it is not. Keys are the
                vehicle and the quantity.
        """
        for quantity, fact in watch_facts.items():
            if _is_watched(fact):
                self._printed_watch_facts.pop(quantity, None)

    def _print_state(self, status: SessionStatus) -> None:
        """Prints in lines below each other what has changed in the status of the session: its state and the next step.

        Args:
            status: State of the live session: vehicle, learning, alarms, lights and next step.
        """
        reason = status.no_model_reason
        if reason is not None and reason.code is VehicleFact.LISTENING:
            # A vehicle is mostly found a moment later.
            return
        state = _state_to_print(status)
        if self._is_status_line_due(status, state):
            self._printed_state = state
            self._print_time = monotonic()
            self._print_status_line(status)
        self._print_fault_found_on_ground(status)
        self._print_next_step(status)

    def _is_status_line_due(self, status: SessionStatus, state: PrintedState) -> bool:
        """Returns whether the line on the state of the session has to be printed, since it is new or was long ago.

        Measured figures alone do not make a state new (:class:`PrintedState`). The line is repeated every
        ``UNCHANGED_STATE_PERIOD``, but not while a vehicle on the ground is switched off.

        Args:
            status: State of the live session.
            state: What the line would say of it.
        """
        if state != self._printed_state:
            return True
        is_silent_on_ground = status.is_silent and not status.is_flying
        return monotonic() - self._print_time >= UNCHANGED_STATE_PERIOD and not is_silent_on_ground

    def _print_status_line(self, status: SessionStatus) -> None:
        """Prints the state in one line, and below it a fault of an earlier flight, if that was not printed before.

        Args:
            status: State of the live session: vehicle, learning, alarms, lights and next step.
        """
        state_text = escape_unprintable(status_line_text(status))
        self._print_now(state_text, status)
        self._print_fault_of_earlier_flight(status)

    def _print_fault_of_earlier_flight(self, status: SessionStatus) -> None:
        """Prints the fault of an earlier flight, with what to do about it, unless the same was printed last.

        It is marked as the next step where nothing else in the present flight is more urgent.

        Args:
            status: State of the live session, with the fault, if there is one.
        """
        fault = _fault_of_earlier_flight(status)
        if fault is None:
            return
        key = _key_of_earlier_fault(fault, is_in_flight=status.is_in_flight)
        if key == self._printed_fault_key:
            return
        fault_text = _text_of_earlier_fault(fault)
        self._printed_fault_of_earlier_flight = fault_text
        self._printed_fault_key = key
        self._fault_print_time = monotonic()
        line = escape_unprintable(fault_text)
        is_next_step = states_unrepaired_fault(status.session_judgement.next_step)
        if status.is_in_flight and is_next_step:
            line = f"{NEXT_MARKER} {line}"
        self._print_now(line, status)

    def _print_fault_found_on_ground(self, status: SessionStatus) -> None:
        """Prints a fault of the latest flight that is found only after the landing, such as small stability margins.

        The model of a flight may be learned to the end only then. Without this line, the next step would change for no
        visible reason. The fault is found when the headline changes between two looks on the ground. The first look
        after a landing only stores the headline, since the line on the landing reports what it states.

        Args:
            status: State of the live session.
        """
        # Where a recording is judged, its verdict is printed as an event, which states such a fault.
        has_judged_recording = status.recording_verdict is not None
        if not status.is_latest_flight_over or has_judged_recording:
            self._headline_on_ground = None
            return
        headline = status.overall_judgement.headline
        former_headline = self._headline_on_ground
        # Other numbers of the same fault are no other headline.
        present_headline = (headline.code, headline.subject)
        self._headline_on_ground = present_headline
        has_changed = former_headline is not None and former_headline != present_headline
        if not has_changed or not headline.is_watch_or_bad:
            return
        text = headline_text(headline)
        # A loss and an alarm have been printed as events.
        is_printed_as_event = status.loss is not None or bool(status.alarms)
        if not is_printed_as_event and text not in self._landing_text:
            self._print_now(f"{VERDICT_MARKER} {escape_unprintable(text)}", status)

    def _print_link_warning(self, status: SessionStatus) -> None:
        """Prints once that the link has just been lost in flight, where lines are printed below each other.

        That it is lost for long is an alarm, which is an event of its own.

        Args:
            status: State of the live session.
        """
        link_loss = status.link_loss
        if link_loss is None:
            self._is_link_warned = False
        elif self.terminal_text is None and not self._is_link_warned and not link_loss.is_bad:
            self._is_link_warned = True
            self._store_advice(link_loss.remedy, is_alarm=False)
            warning = escape_unprintable(link_loss.sentence_and_remedy)
            self._print_now(f"{WARNING_MARKER} {warning}", status)

    def print_closing_line(self, line: str) -> None:
        """Prints a line of the judgement at the end of a session: what to do next, or how a flight was judged.

        Among lines with times, which programs read, a marker says which of the two it is. Then the line itself does not
        begin with "Next:", which would say it twice.

        Args:
            line: The line, as ``closing_lines`` returns it. What to do next begins with ``NEXT_STEP_LEAD``.
        """
        is_next_step = line.startswith(NEXT_STEP_LEAD)
        if not self._has_stamps:
            self.print_conclusion(line)
        elif is_next_step:
            self.print_conclusion(line.removeprefix(NEXT_STEP_LEAD), NEXT_MARKER)
        else:
            self.print_conclusion(line, VERDICT_MARKER)

    def print_conclusion(self, text: str, marker: str = "") -> None:
        """Prints a line at the end of a session: its judgement, and the files that it has written.

        Args:
            text: The line. In lines below each other it begins with the time like all others.
            marker: Word before the text in lines below each other, by which programs find the line; empty for none.
        """
        if self._has_stamps:
            marked_text = f"{marker} {text}" if marker else text
            boot, boot_clock = self._latest_moment
            self._append_line(stamped_line(marked_text, boot_clock=boot_clock, boot=boot))
        else:
            self._append_line(text, indent=0)

    def _print_next_step(self, status: SessionStatus) -> None:
        """Prints what to do next if that is a new step, unless a line of the last seconds says it.

        A step that such a line says counts as printed. Neither measured numbers nor another reason for the same
        sentence make it another step.

        Args:
            status: State of the live session.
        """
        next_step = status.session_judgement.next_step
        is_settled = self._is_next_step_settled(status)
        self._latest_next_step = next_step.without_measurements
        if not is_settled or _is_already_printed(next_step, self._printed_next_step):
            return
        text = escape_unprintable(next_step)
        is_same_text = text == self._printed_next_text
        self._printed_next_step = next_step
        self._printed_next_text = text
        if text and not is_same_text and not self._was_just_advised(next_step):
            self._print_reason_of_next_step(status)
            self._print_now(f"{NEXT_MARKER} {text}", status)

    def _print_reason_of_next_step(self, status: SessionStatus) -> None:
        """Prints the headline as a warning if it is the reason of the next step, and no other line states it.

        In flight, alarms have lines of their own. On the ground, so have the landing and the verdict.

        Args:
            status: State of the live session.
        """
        headline = status.session_judgement.headline
        if not status.is_in_flight or not headline.is_watch_or_bad or status.alarms:
            return
        text = escape_unprintable(headline_text(headline))
        # The line on the fault of an earlier flight, and that of a lost link, state what the headline does.
        is_stated = text in self._printed_fault_of_earlier_flight or self._is_link_warned
        if not is_stated and text != self._printed_reason:
            self._printed_reason = text
            self._print_now(f"{WARNING_MARKER} {text}", status)

    def _is_next_step_settled(self, status: SessionStatus) -> bool:
        """Returns whether the next step can be printed now, since it will hardly change in the next seconds.

        It may change from second to second, as at the end of a climb: it must be the same in two successive states.
        After a landing it may change until the flight is judged. It is printed at once if the headline warns, or if an
        alarm has just ended, whose advice does not hold any more.

        Args:
            status: State of the live session.
        """
        judgement = status.session_judgement
        if judgement.headline.is_watch_or_bad:
            return True
        if _is_flight_still_unjudged(status):
            return False
        is_unchanged = judgement.next_step.without_measurements == self._latest_next_step
        has_alarm_ended = _is_recent(self._alarm_end_time)
        return is_unchanged or has_alarm_ended

    def _was_just_advised(self, next_step: Fact) -> bool:
        """Returns whether a line of the last ``ADVICE_SECONDS`` says what to do next.

        That is the line of an alarm, a warning or another event with the same words, or the line on the fault of an
        earlier flight, for which the vehicle has to land unless it was repaired.

        Args:
            next_step: What to do next.
        """
        if states_unrepaired_fault(next_step) and _is_recent(self._fault_print_time):
            return True
        is_in_advice = str(next_step) in self._advised_text
        return is_in_advice and _is_recent(self._advice_time)

    def _print_now(self, text: str, status: SessionStatus) -> None:
        """Prints a line with the present time and that of the vehicle's clock.

        Args:
            text: The text of the line, without unprintable characters.
            status: State of the live session, with the present boot and its clock.
        """
        self._print(stamped_line(text, boot_clock=status.boot_clock, boot=status.boot))


def _is_event_in_status(event: Event) -> bool:
    """Returns whether an event needs no line above the status on a terminal, since the status shows what it states.

    That holds for states of the session, such as waiting for a vehicle, unless they are alarms. ``UNPRINTED_STATES``
    are in the status, or will be in the report after the landing.

    Args:
        event: What was found, and when.
    """
    fact = event.fact
    if fact.code in UNPRINTED_STATES:
        return True
    # The first line of the status says how old the last message is of a vehicle that was switched off after a landing.
    is_switched_off = fact.figures.get("is_after_landing", False)
    is_state_of_session = fact.code in SESSION_STATES and not event.is_alarm
    return is_switched_off or is_state_of_session


def _state_to_print(status: SessionStatus) -> PrintedState:
    """Returns what a printed line says of a status; a new line is printed when this changes.

    Args:
        status: State of the live session: vehicle, learning, alarms, lights and next step.
    """
    reason = status.no_model_reason
    return PrintedState(
        status.vehicle,
        is_waiting=reason is not None,
        is_alarmed=any(fact.is_bad for fact in status.alarms),
        is_late=status.delay_fact is not None,
        is_motion_missing=reason is not None and reason.code is RowsFact.NOTHING_RECEIVED,
    )


def _is_already_printed(next_step: Fact, printed_step: Fact | None) -> bool:
    """Returns whether the step that was printed last says what to do next, so that a new line would be no news.

    Both are the same but for measured numbers.

    Args:
        next_step: What to do next.
        printed_step: The next step that was printed last; None if it does not count any more.
    """
    if printed_step is None:
        return False
    return next_step.without_measurements == printed_step.without_measurements


def _is_flight_still_unjudged(status: SessionStatus) -> bool:
    """Returns whether the latest flight has ended, but neither its model nor its recording has judged it yet.

    Args:
        status: State of the live session.
    """
    is_judged = status.model_judgement is not None or status.recording_verdict is not None
    return status.is_latest_flight_over and not is_judged


def _is_recent(print_time: float) -> bool:
    """Returns whether a line was printed in the last ``ADVICE_SECONDS``.

    Args:
        print_time: When it was printed, s of the monotonic clock.
    """
    return monotonic() - print_time <= ADVICE_SECONDS


def _fault_of_earlier_flight(status: SessionStatus) -> Fact | None:
    """Returns the fault of an earlier flight that a line states; None without one.

    On the ground that is the verdict on an earlier flight of the session, where it is the headline. Otherwise it is the
    warning that a fault may not have been repaired since.

    Args:
        status: State of the live session.
    """
    headline = status.session_judgement.headline
    return headline if headline.code is SessionFact.FLIGHT_VERDICT else status.unrepaired_fault


def _text_of_earlier_fault(fault: Fact) -> str:
    """Returns the line on a fault of an earlier flight; what to do about one that is the headline is the next step."""
    if fault.code is SessionFact.FLIGHT_VERDICT:
        return headline_text(fault)
    return fault.sentence_and_remedy


def _key_of_earlier_fault(fault: Fact, *, is_in_flight: bool) -> Hashable:
    """Returns a key that is the same for two lines on the same fault of an earlier flight, so that one is enough.

    It consists of the kind of fault, the flight, and whether the vehicle flies now: a fault that was printed on the
    ground is printed again after the take-off. The words of the fault are not in it, since they become more precise
    when its recording is judged, which needs no other line.

    Args:
        fault: The fault as :func:`_fault_of_earlier_flight` returns it.
        is_in_flight: Whether the vehicle flies now.
    """
    finding = fault
    if fault.code is SessionFact.UNREPAIRED_FAULT:
        # The fault itself is the reason of the warning that it may not have been repaired.
        finding = fault.figures["reason"]
    # A flight of this session has a number. One of a former session has the address of its page in the library.
    flight = finding.figures.get("number", finding.figures.get("address"))
    return (finding.code, flight, is_in_flight)


def _watch_facts_without_alarm(status: SessionStatus) -> Facts:
    """Returns since when each quantity, such as vibration, is watched for faults, or why it is not.

    Left out are the oscillation and the motors during an alarm on them, which shows that they are watched.

    Args:
        status: State of the session, with a fact for each quantity, which is its subject, and with the active alarms.
    """
    alarmed_codes = [cause_of_alarm(alarm).code for alarm in status.active_alarms]
    alarmed_quantities = []
    if MarginsLight.OSCILLATES in alarmed_codes:
        alarmed_quantities.append(WatchedQuantity.OSCILLATION)
    if MotorWatchFact.MOTOR_LOST_THRUST in alarmed_codes:
        alarmed_quantities.append(WatchedQuantity.MOTORS)
    return tuple(fact for fact in status.watch_facts if fact.subject not in alarmed_quantities)


def _reportable_facts(watch_facts: Facts) -> dict[Hashable, Fact]:
    """Returns the facts (coded findings) on watched quantities that may be printed, by vehicle and quantity.

    Args:
        watch_facts: A fact for each quantity: since when it is watched, or why it is not. Those with
            ``UNREPORTED_REASONS`` are left out.
    """
    reportable_facts: dict[Hashable, Fact] = {}
    for fact in watch_facts:
        if _is_watched(fact) or _has_reported_reason(fact):
            vehicle = fact.figures.get("vehicle")
            reportable_facts[vehicle, fact.subject] = fact
    return reportable_facts


def _unwatched_facts(watch_facts: dict[Hashable, Fact]) -> dict[Hashable, Fact]:
    """Returns the facts on quantities that are not watched for faults, to be printed above the status on a terminal.

    Left out are motors that only wait until their outputs in hover are known, with which later ones are compared: the
    status counts the seconds down.

    Args:
        watch_facts: For each quantity, such as vibration, since when it is watched, or why it is not. Keys are the
            vehicle and the quantity.
    """
    unwatched_facts = {}
    for quantity, fact in watch_facts.items():
        if _is_watched(fact):
            continue
        waits_for_reference = fact.figures["reason"].code is WatchFact.REFERENCE_SHORT
        if not waits_for_reference:
            unwatched_facts[quantity] = fact
    return unwatched_facts


def _is_watched(watch_fact: Fact) -> bool:
    """Returns whether a fact (coded finding) on a quantity says that it is watched: then it has no reason why not."""
    return watch_fact.figures.get("reason") is None


def _has_reported_reason(watch_fact: Fact) -> bool:
    """Returns whether a quantity is not watched for a reason that lasts, and that no other line reports."""
    reason = watch_fact.figures.get("reason")
    return isinstance(reason, Fact) and reason.code not in UNREPORTED_REASONS


def _unwatched_names(watch_facts: Facts) -> list[str]:
    """Returns the names of quantities, such as the vibration, in which the session cannot notice a fault.

    Only those with a lasting reason are named, such as a message that never comes, and not those that merely wait, for
    instance for the take-off (``UNREPORTED_REASONS``).

    Args:
        watch_facts: A fact (coded finding) for each quantity, which is its subject: since when the session watches it
            for faults, or why it does not. Facts on other vehicles than the followed one have the figure "vehicle".
    """
    unwatched_names = []
    for fact in watch_facts:
        is_of_other_vehicle = "vehicle" in fact.figures
        if not is_of_other_vehicle and _has_reported_reason(fact):
            quantity = str(fact.subject)
            unwatched_names.append(quantity)
    return unwatched_names


def _status_block(status: SessionStatus) -> Group:
    """Returns the status of a session for a terminal, as Rich lines: vehicle, headline, next step, lights, learning.

    Args:
        status: State of the live session. The table of lights is left out until a vehicle is found.
    """
    texts = _status_texts(status)
    headline_style = style_of_facts(*status.alarms, status.session_judgement.headline)
    parts: list[RenderableType] = [texts.vehicle, Text(texts.headline, headline_style)]
    if texts.next_step:
        # A line of its own, so that a pilot finds at the same place what to do.
        parts.append(Text(texts.next_step, f"bold {headline_style}"))
    unrepaired_fault = escape_unprintable(unrepaired_fault_beside_next_step(status))
    if unrepaired_fault:
        parts.append(Text(unrepaired_fault, LEVEL_STYLES[Level.WATCH]))
    present_verdict = escape_unprintable(verdict_on_present_flight(status))
    if present_verdict:
        parts.append(present_verdict)
    if status.vehicle is not None:
        table_width = min(STDERR.width, MAX_COLUMNS)
        parts.append(_table_of_lights(light_rows(status), table_width))
    parts.append(_learning_line(status, texts))
    return Group(*parts)


def _learning_line(status: SessionStatus, texts: StatusTexts) -> Text:
    """Returns the last line of a status on a terminal: what the session learns, what is wrong, what is not watched.

    Args:
        status: State of the live session.
        texts: The same status in sentences.
    """
    line = Text(texts.learning)
    if texts.problems:
        line.append(f" {' '.join(texts.problems)}", style_of_facts(*status.alarms))
    # Only names: why a quantity is not watched was printed when that began.
    unwatched_text = unwatched_quantities_text(_unwatched_names(status.watch_facts))
    if unwatched_text:
        line.append(f" {unwatched_text}")
    return line


def _table_of_lights(lights: Sequence[LightRow], width: int) -> Table:
    """Returns a table of the lights, with several lights in a line where the terminal is wide enough.

    A light is the judgement of one part of the vehicle, such as its motors. Its level is a word with a colour, so that
    users who cannot tell the colours apart can read it.

    Args:
        lights: Name, level and figure of each light, in their order.
        width: Width of a line of the terminal, characters.

    Returns:
        A table for Rich. Each light has the same width, whatever its figure, so that nothing moves from second to
        second.
    """
    # Even a very narrow terminal has one light a line.
    lights_per_line = max(width // MIN_LIGHT_WIDTH, 1)
    lights_per_line = min(lights_per_line, MAX_LIGHTS_PER_LINE)

    light_width = width // lights_per_line
    figure_width = light_width - NAME_WIDTH - LEVEL_WIDTH - GAPS_WIDTH
    table = Table.grid(padding=(0, 1))
    for _ in range(lights_per_line):
        table.add_column(width=NAME_WIDTH)
        table.add_column(width=LEVEL_WIDTH)
        table.add_column(width=figure_width)
    for first_of_line in range(0, len(lights), lights_per_line):
        cells: list[RenderableType] = []
        for light in lights[first_of_line : first_of_line + lights_per_line]:
            cells += [light.name, _level_text(light.level), escape_unprintable(light.figure)]
        table.add_row(*cells)
    return table


def _level_text(level: Level) -> Text:
    """Returns a level as a word in its colour; "BAD" has capitals, so that it is seen without colours, too."""
    word = str(level)
    if level is Level.BAD:
        word = word.upper()
    return Text(word, LEVEL_STYLES[level])


def _status_texts(status: SessionStatus) -> StatusTexts:
    """Returns the sentences of a session's status; none repeats the headline or the next step, which are among them.

    Battery, wind and margins are not in them: they are in the table of lights (judgements) that a terminal shows too.

    Args:
        status: The status. Its ``no_model_reason`` is the fact (coded finding) that says why no model is learned now,
            if none is.
    """
    judgement = status.session_judgement
    headline, next_step = _headline_and_next_step(judgement)
    judgement_text = f"{headline} {next_step}"
    sentences = []
    for sentence in render_section("live_status", status=status, time=clock.unix_time()):
        sentences.append(escape_unprintable(sentence.text))
    reason = status.no_model_reason
    if reason is not None and not _is_normal_after_landing(reason, status):
        sentences.append(_unstated_reason(reason, judgement.headline, judgement_text))
    new_sentences = [text for text in sentences if text and text not in judgement_text]
    # The first sentence of the section is on the learning. It is always there, and never a part of the judgement.
    return StatusTexts(
        vehicle=escape_unprintable(vehicle_text(status, has_table=True)),
        learning=new_sentences[0],
        problems=new_sentences[1:],
        headline=headline,
        next_step=next_step,
    )


def _is_normal_after_landing(reason: Fact, status: SessionStatus) -> bool:
    """Returns whether no model is learned for a reason that is normal after a flight, and no problem.

    Args:
        reason: Why no model is learned now.
        status: State of the live session.
    """
    # There are lights only in and after a flight.
    has_flown = bool(status.worst_lights)
    # Another take-off is the pilot's choice, and the table of lights shows the flight before.
    stands_after_flight = reason.code is SessionFact.NOT_FLYING and has_flown
    # Nobody need check the link of a vehicle that was switched off after its landing.
    return stands_after_flight or status.is_switched_off


def _unstated_reason(reason: Fact, headline: Fact, judgement_text: str) -> str:
    """Returns why no model is learned and what to do about it, as far as the judgement does not state it already.

    Args:
        reason: The fact (coded finding) with the reason as its sentence, and its remedy.
        headline: The headline of the judgement. It states the reason if it is the same fact, or has it as its figure
            "reason".
        judgement_text: Headline and next step in sentences. The next step may be the same remedy.

    Returns:
        Sentence and remedy, or the one of them that the judgement lacks; empty if it states both.
    """
    remedy = escape_unprintable(reason.remedy)
    is_reason_stated = reason in (headline, headline.figures.get("reason"))
    is_remedy_stated = remedy in judgement_text
    if is_reason_stated and is_remedy_stated:
        return ""
    if is_reason_stated:
        return remedy
    if is_remedy_stated:
        return escape_unprintable(reason.sentence)
    return escape_unprintable(reason.sentence_and_remedy)


def _headline_and_next_step(judgement: Judgement) -> tuple[str, str]:
    """Returns the headline of a judgement, and the next step, which is empty if the headline has it.

    The headline is shortened: the table below it has what was checked, and the whole sentence was printed on a line of
    its own when it was new.

    Args:
        judgement: The judgement of the flight so far.
    """
    headline, *next_step = headline_and_next_step(judgement)
    statement = statement_of_headline(headline, judgement.headline)
    short_headline = shortened(statement, MAX_HEADLINE_LINES * STDERR.width)
    return escape_unprintable(short_headline), escape_unprintable(" ".join(next_step))
