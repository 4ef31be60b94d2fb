"""Live sessions on a monitored link: a page and facts (coded findings) while the vehicle flies, then its stored log."""

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from math import inf, nan
from pathlib import Path
from threading import Event as ThreadEvent
from threading import Thread
from typing import NamedTuple, Self

from mavdem.dataset.intervals import TimeInterval
from mavdem.dem import Settings
from mavdem.dem.parallel import LearningProcess
from mavdem.errors import Refusal, fact_from_error
from mavdem.facts import Fact, Level
from mavdem.facts.event import Event
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Light
from mavdem.facts.serve import ListingOrder, RefusalReason, Stage
from mavdem.facts.session import LinkFact, RecordingState, RowsFact, SessionFact, VehicleFact
from mavdem.facts.vehicle import system_id_name
from mavdem.fleet.names import GivenNames
from mavdem.ingest import read_log
from mavdem.live import LiveStream, clock
from mavdem.live.link import Link, ReceivedPiece
from mavdem.live.link_outage import headline_with_outage
from mavdem.live.raw_recording import RawRecording
from mavdem.live.session import LiveSession
from mavdem.live.session_loop import run_session
from mavdem.live.session_status import SessionStatus
from mavdem.live.unanswered_requests import verdict_after_requests
from mavdem.live.vehicle_selection import Component
from mavdem.live.vehicle_state import VehicleState
from mavdem.report.live import live_title, vehicle_text
from mavdem.report.pages.page_link import PageLink
from mavdem.report.templates import Medium, sentences_for
from mavdem.serve.index import LibraryEntry
from mavdem.serve.library import Library
from mavdem.serve.live_pages import (
    NEWS_SECONDS,
    PAGE_SECONDS,
    SessionPage,
    session_page,
)

MAX_SILENT_PAGES = 12
"""Pages in a row during which nothing is received, a minute in all, after which the session of a vehicle is over.

If it was last in the air, what was recorded is added to the library then, and the session goes on.
"""

MAX_SILENT_PAGES_IN_AIR = 120
"""Pages in a row without a message after which the session of a vehicle is over that was last in the air: 10 min.

A choice. Most links that are lost in flight come back, since the vehicle returns or lands by itself, for which its
battery lasts some minutes. Until then the flight goes on, with its take-off, its judgement and the reference of its
motors.
"""

MAX_SILENT_PAGES_AFTER_LANDING = 3
"""Pages in a row without a message after which the session of a vehicle is over that has landed: 15 s, a choice.

The vehicle was switched off, or its next flight gets a session of its own. An autopilot that reboots, or a radio that
fades, is mostly back before.
"""

NO_VEHICLE_CODES = frozenset(
    {
        LinkFact.CONNECTION_LOST,
        RowsFact.NOTHING_RECEIVED,
        VehicleFact.LISTENING,
        VehicleFact.NO_VEHICLE_YET,
    }
)
"""Reasons for learning no model with which no vehicle has been received on the link yet."""

NOT_JUDGED_IN_SESSION = Fact(
    SessionFact.RECORDING_NOT_JUDGED,
    kind=RecordingState.IN_SESSION,
    duration=MAX_SILENT_PAGES_AFTER_LANDING * PAGE_SECONDS,
)
"""The fact that the recording of the running session is not judged yet, in the place of the library's verdict on it."""

READ_AT_NEXT_START = Fact(SessionFact.RECORDING_NOT_JUDGED, kind=RecordingState.READ_AT_NEXT_START)
"""The fact that the recording of a session that ends with the server is judged once the server runs again."""

MAX_LAST_PAGE_SECONDS = 5.0
"""Longest time for which the end of the server waits for the last page, s: a choice; a slow computer renders a page in
one second."""

RECORDING_NAME_PATTERN = "????-??-??_??-??-??.tlog"
"""Pattern of SQLite's GLOB for the names of recordings, which state when their first message came."""

MAX_FLIGHTS_BEFORE_START = 10
"""Flights of a vehicle before the start of the server in which a fault is looked for that still stands: a choice, about
a day of flying."""

MODEL_AXIS = "roll"
"""Axis whose model a session learns."""


LIBRARY_LINK = PageLink("Flights", "/")
"""Link to the page of the library."""


class _IncomingRecording(NamedTuple):
    """The recording of a session before it is added to the library."""

    recording: RawRecording
    """The recording."""

    path: Path
    """Path of its file."""

    first_pieces: Sequence[ReceivedPiece] = ()
    """Messages that it has already: those of its vehicle that came during the session before."""


class _LinkedVehicle(NamedTuple):
    """A vehicle of the link by its ids, autopilot and type, since another one may use the same ids later."""

    name: str
    """Its ids on the link, such as "1:1"."""

    autopilot: str
    """Name of its MAV_AUTOPILOT."""

    vehicle_type: str
    """Name of its MAV_TYPE."""

    @classmethod
    def of_component(cls, component: Component) -> Self:
        """Returns the vehicle of a MAVLink component, with the autopilot and type of its latest HEARTBEAT."""
        return cls(component.name, component.autopilot, component.vehicle_type)


class _StoredFlight(NamedTuple):
    """A flight of the link whose recording, or a part of it, is in the library."""

    vehicle: _LinkedVehicle
    """Its vehicle."""

    entry_id: str
    """Id of its recording in the library."""

    saved_flight: PageLink
    """Link to its page in the library."""

    verdict: Fact | None = None
    """The verdict of the library when it was looked up last: how it judges the recording, or that it has not judged it
    yet. None before it was looked up."""

    session: LiveSession | None = None
    """Its session, if that is over and shown until another vehicle comes; otherwise None."""

    is_end_unknown: bool = False
    """Whether its end was not received, since link or autopilot failed in the air."""

    name_in_logs: str = ""
    """Name by which logs of its vehicle are recognised; empty where only its ids on the link are known."""

    is_repaired: bool = False
    """Whether a user has stated that the fault of the flight was repaired."""

    @classmethod
    def of_entry(
        cls, entry: LibraryEntry, vehicle: _LinkedVehicle, session: LiveSession | None = None
    ) -> Self:
        """Returns the flight of a recording in the library, without a verdict.

        Args:
            entry: the recording in the library.
            vehicle: the vehicle of the flight.
            session: its session, if that is over; None while it goes on.
        """
        page = PageLink(entry.name, _page_address(entry))
        return cls(vehicle, entry.id, page, session=session)

    @property
    def forbids_flight(self) -> bool:
        """Whether the library's verdict is that the vehicle must not fly before a repair, which nobody has stated."""
        verdict = self.verdict
        if verdict is None or self.is_repaired:
            return False
        return verdict.is_bad and verdict.forbids_flight

    @property
    def is_judged_good(self) -> bool:
        """Whether its recording was judged good as a whole, also by comparison with the vehicle's other flights."""
        verdict = self.verdict
        if verdict is None or verdict.code is not SessionFact.RECORDING_JUDGED:
            return False
        return verdict.is_good

    @property
    def is_unjudged(self) -> bool:
        """Whether the library had not judged its recording yet when the verdict was looked up last, but will."""
        if self.verdict is None:
            return True
        is_not_judged = self.verdict.code is SessionFact.RECORDING_NOT_JUDGED
        return is_not_judged and self.verdict.figures["kind"] is RecordingState.BEING_READ


class _FlightState:
    """Whether the vehicle of a session has landed or has restarted, by which is decided when its session ends.

    Attributes:
        has_landed: whether the latest flight has ended with a landing.
        has_restarted: whether the vehicle has restarted on the ground since, so that the flight is over and the next
            one gets a session of its own.
        is_in_air: whether the vehicle has taken off, and has not landed since.
    """

    def __init__(self) -> None:
        """Begins before the first take-off."""
        self.has_landed = False
        self.has_restarted = False
        self.is_in_air = False
        # Whether the vehicle was in the air when it was received last before its latest restart. While its link was
        # lost it may have landed, and restarted on the ground.
        self._was_in_air_before_restart = False
        self._is_armed_since_restart = False

    def update(self, fact: Fact) -> None:
        """Notes a take-off, landing, arming or restart of the vehicle.

        A restart after a landing ends the flight. A vehicle that was last received in the air may have restarted there
        and fly on, or may have landed while its link was lost. So such a restart ends the flight only if what comes
        later shows that it was on the ground: a take-off, or motors that are armed on the ground (:meth:`note_status`).

        Args:
            fact: an event of the session; those of other kinds are ignored.
        """
        if fact.code is ReportedEvent.OFF_GROUND:
            self.has_landed = False
            self.is_in_air = True
            if self._was_in_air_before_restart:
                # A vehicle that takes off after its restart was on the ground.
                self.has_restarted = True
            self._was_in_air_before_restart = False
        elif fact.code is ReportedEvent.ON_GROUND:
            # If it restarted in the air, it has flown on until this landing, which ends the flight as usual.
            self.has_landed = True
            self.is_in_air = False
            self._was_in_air_before_restart = False
        elif fact.code is VehicleFact.VEHICLE_REBOOTED:
            self.has_restarted = self.has_landed
            self._was_in_air_before_restart = self.is_in_air
            self._is_armed_since_restart = False
        elif fact.code is ReportedEvent.MOTORS_ARMED:
            self._is_armed_since_restart = True

    def note_status(self, status: SessionStatus) -> None:
        """Notes a restart on the ground, if a vehicle that was last received in the air is later armed on the ground.

        Armed motors alone do not show that, since an autopilot that is reset in the air may arm them too.

        Args:
            status: present status of the vehicle.
        """
        if not self._was_in_air_before_restart:
            return
        if self._is_armed_since_restart and _is_on_ground(status):
            self.has_restarted = True


class _Silence:
    """For how long the vehicle of a session has been silent, counted in pages: one is made every ``PAGE_SECONDS``.

    Attributes:
        page_count: number of pages of the session that were made in a row without a new MAVLink frame of the vehicle.
        is_in_air: whether the vehicle was in the air when its messages ended, and nothing shows that the flight is
            over.
    """

    def __init__(self) -> None:
        """Begins with a session that has not received anything."""
        self.page_count = 0
        self.is_in_air = False
        self._frames_at_last_page = 0

    def count_page(self, session: LiveSession) -> None:
        """Updates the silence at a new page of the session, which the monitor makes every ``PAGE_SECONDS``.

        The silence is a page longer if no frame of the vehicle came since the page before; otherwise it is over.

        Args:
            session: the running session, which records what it receives.
        """
        frame_count = _received_frames(session)
        # Before the first frame the session waits for a vehicle without a limit.
        is_silent = frame_count > 0 and frame_count == self._frames_at_last_page
        self.page_count = self.page_count + 1 if is_silent else 0
        self._frames_at_last_page = frame_count
        # The status states a loss of the link while a vehicle is silent that was in the air when its messages ended. It
        # is taken together with the count, so that both are always of the same silence.
        self.is_in_air = session.status.link_loss is not None

    def is_too_long(self, *, has_landed: bool) -> bool:
        """Returns whether the session is over because of the silence.

        Args:
            has_landed: whether the latest flight of the vehicle has ended with a landing.
        """
        longest = MAX_SILENT_PAGES
        if self.is_in_air:
            longest = MAX_SILENT_PAGES_IN_AIR
        elif has_landed:
            longest = MAX_SILENT_PAGES_AFTER_LANDING
        return self.page_count >= longest


class LinkMonitor:
    """Runs live sessions on a link, one after the other, in a thread; nothing is sent to the vehicle unless asked for.

    A session ends

    - when its vehicle is silent for a minute; for 15 s after a landing; for 10 min after its link was lost in the air,
      when what was recorded is stored after a minute;
    - when its vehicle is silent for ``SUCCESSION_SECONDS`` while another one sends, which the next session follows;
    - when its vehicle restarts after a landing, since its next flight gets a session of its own; or takes off again
      after it restarted on the ground while its link was lost in the air;
    - when the server ends.

    After an error, such as a full disk, no further session begins; what was recorded until then is kept.

    Attributes:
        problem: why no session runs any more; None while one does.
    """

    def __init__(
        self,
        link: str,
        library: Library,
        log_added: Callable[[], None],
        warn: Callable[[Fact], None],
        report_event: Callable[[Event], None],
        report_status: Callable[[SessionStatus], None],
        request_rate: float | None = None,
        server_address: str = "",
        vehicle: str | None = None,
    ) -> None:
        """Opens the link; sessions begin with :meth:`start`.

        Args:
            link: address of the link, such as ``udpin:127.0.0.1:14550``.
            library: library to which recordings of sessions are added.
            log_added: function that is called after a recording was added.
            warn: function that is called with a reason why no session runs any more, and with lost datagrams.
            report_event: function that is called with each event of a session, with the address of each saved flight,
                and with the library's verdict on it.
            report_status: function that is called with the status of the session every ``PAGE_SECONDS``.
            request_rate: rate that each vehicle is asked for, Hz; None to send nothing at all.
            server_address: URL of the server, with which the address of a saved flight begins.
            vehicle: "system" or "system:component" of the only vehicle to follow; None for any that sends.

        Raises:
            Unreadable: the link cannot be opened.
        """
        self.problem: Fact | None = None
        self._page = SessionPage("", clock.monotonic())
        self._summary = ""
        # When ``_update_page`` was called last, s of the monotonic clock.
        self._update_time = -inf
        # The page of the session before, which is shown until another vehicle is received; empty for none.
        self._finished_page = ""
        # The latest flight whose session is over, with the library's verdict on its recording; None for none.
        self._stored_flight: _StoredFlight | None = None
        # Flights before it, the oldest first, that decide which fault still stands (``_flights_to_keep``).
        self._earlier_stored_flights: list[_StoredFlight] = []
        # Ids of the recordings that this server has added to the library.
        self._recorded_ids: set[str] = set()
        # The part of the running session's recording that was stored once its vehicle was lost in the air.
        self._stored_part: _StoredFlight | None = None
        # The latest recording of a session in the library, also of one before the server was started.
        self._latest_flight = _link_to_latest_recording(library)
        self._link = Link(link)
        self._library = library
        self._log_added = log_added
        self._warn = warn
        self._report_event = report_event
        self._report_status = report_status
        self._server_address = server_address
        self._request_rate = request_rate
        self._chosen_vehicle = vehicle
        # Name of the vehicle that the next session is to follow; None for the only one on the link.
        self._next_vehicle: str | None = None
        # The recording of the running session.
        self._incoming: _IncomingRecording | None = None
        # The recording of the next session, where it has messages of its vehicle already.
        self._next_recording: _IncomingRecording | None = None
        # Whether the vehicle of the running session has landed or restarted.
        self._flight = _FlightState()
        # Why the recording of the running session has ended in flight, which ends the session after the landing; None
        # while it goes on.
        self._recording_problem: Exception | None = None
        # For how long that vehicle has been silent.
        self._silence = _Silence()
        # Set when the server ends.
        self._is_stopping = ThreadEvent()
        # Set once the page is there that says that the server has ended.
        self._has_last_page = ThreadEvent()
        # Number of datagrams that the link had lost at the end of the latest session.
        self._lost_datagrams = 0
        self._thread = Thread(target=self._run_sessions, daemon=True)

    def start(self) -> None:
        """Starts the thread with the first session."""
        self._thread.start()

    def end_session(self) -> None:
        """Ends the session, and waits until its last page is there for open browsers: a second, mostly."""
        self._is_stopping.set()
        self._has_last_page.wait(MAX_LAST_PAGE_SECONDS)

    def stop(self) -> None:
        """Ends the session, adds its recording to the library, and closes the link."""
        self._is_stopping.set()
        self._thread.join()
        self._link.close()

    @property
    def summary(self) -> str:
        """One line on the running session: its vehicle, and what that does; or why no session runs any more."""
        if self.problem is not None:
            return str(self.problem)
        return self._summary

    @property
    def page(self) -> SessionPage:
        """The page of the running session, which is at most a few seconds old; empty before the first one.

        Until its vehicle is received, it is the page of the session before, if there was one.

        Raises:
            Refusal: no session runs any more.
        """
        if self.problem is not None:
            raise Refusal(self.problem)
        return self._page

    def _run_sessions(self) -> None:
        """Runs one live session after the other until the server stops or a session fails; the function of the thread.

        If a session fails, the reason is kept in ``problem`` and reported, since no caller of this thread would see the
        error.
        """
        try:
            with LearningProcess() as executor:
                # If the next recording has messages already, its session must run, so that it is added to the library.
                while not self._is_stopping.is_set() or self._next_recording is not None:
                    self._run_one_session(executor)
        except Exception as error:
            reason = fact_from_error(error)
            self.problem = Fact(RefusalReason.SESSION_FAILED, name=self._link.name, reason=reason)
            self._warn(self.problem)
        finally:
            # Whoever waits for a last page waits no longer where there is none.
            self._has_last_page.set()

    def _run_one_session(self, executor: LearningProcess) -> None:
        """Runs one live session on the link until it is over, and adds its recording to the library.

        What was recorded is kept however the session ends, also by an error. Only a recording without a vehicle is
        deleted. Datagrams that were lost because nobody read them in time are reported.

        Args:
            executor: the process in which models are learned.

        Raises:
            OSError: the recording cannot be written any more.
            Refusal: the library has no room.
        """
        incoming = self._next_recording or self._new_recording()
        self._next_recording = None
        self._incoming = incoming
        session = self._new_session(incoming, executor)
        try:
            self._run_until_over(session, incoming.recording)
        finally:
            self._warn_of_lost_datagrams()
            self._keep_recording(session, incoming)

    def _run_until_over(self, session: LiveSession, recording: RawRecording) -> None:
        """Runs a session until it is over, and begins the recording of the next one if its vehicle is known already.

        Args:
            session: the session.
            recording: its recording, from which the messages that belong to the next session are moved.

        Raises:
            OSError: the recording cannot be written any more.
            Refusal: the disk is nearly full.
        """
        try:
            self._update_page(session)
            no_time_limit = None
            run_session(
                session,
                lambda: self._is_over() or session.successor is not None,
                no_time_limit,
                NEWS_SECONDS,
                self._watch_session,
            )
            successor = self._finish_session(session)
        finally:
            session.end()
        if self._recording_problem is not None:
            raise self._recording_problem
        vehicle = session.stream.followed_vehicle
        if successor is not None and vehicle is not None:
            restart = session.stream.latest_restart if self._flight.has_restarted else None
            self._next_recording = self._recording_of_next_session(recording, vehicle, restart)

    def _finish_session(self, session: LiveSession) -> Component | None:
        """Reports the end of a session that is over, and returns the vehicle that the next session is to follow.

        Args:
            session: the session. If the server ends, the messages that wait are analysed for its last page; otherwise
                they may belong to the next session.

        Returns:
            The next vehicle; None if none is known, and then all that was received is recorded in this session.
        """
        if self._is_stopping.is_set():
            session.analyse_rest()
            self._render_last_page(session)
        # A flight whose landing was reported is not reported again.
        session.report_end(session.status, model=None)
        successor = self._vehicle_of_next_session(session)
        if successor is None:
            session.intake.record_rest()
        else:
            self._next_vehicle = successor.name
        return successor

    def _keep_recording(self, session: LiveSession, incoming: _IncomingRecording) -> None:
        """Closes the recording of a session that has ended, and adds it to the library if a vehicle was received.

        Args:
            session: the session.
            incoming: its recording, which is deleted if it has no vehicle.

        Raises:
            Refusal: the library has no room.
        """
        # A recording that has failed is still open: what it had to write last may fit after all.
        with suppress(OSError):
            incoming.recording.close()
        is_empty = incoming.recording.remove_if_empty()
        if not is_empty and _may_have_vehicle(session, incoming.path):
            self._store_recording(session, incoming)
        else:
            # Stray packets, or those of ground stations alone, are no flight.
            incoming.path.unlink(missing_ok=True)

    def _new_session(self, incoming: _IncomingRecording, executor: LearningProcess) -> LiveSession:
        """Makes the next session, and resets what the monitor has noted of the session before.

        Args:
            incoming: recording of the session.
            executor: the process in which models are learned.
        """
        stream = LiveStream(
            MODEL_AXIS,
            self._next_vehicle or self._chosen_vehicle,
            rates_requested=self._request_rate is not None,
        )
        session = LiveSession(
            self._link,
            stream,
            Settings(),
            open_display=_ignore,
            report_status=_ignore,
            report_event=self._take_event,
            executor=executor,
            recording=incoming.recording,
            requested_rate=self._request_rate,
            # An empty name: the user finds the recording in the library when the session has ended.
            recording_name="",
            keeps_vehicle=self._chosen_vehicle is not None,
            first_pieces=incoming.first_pieces,
        )
        self._next_vehicle = None
        self._forget_former_session()
        return session

    def _forget_former_session(self) -> None:
        """Resets what the monitor has noted of a session, such as its silence and the state of its flight."""
        self._flight = _FlightState()
        self._silence = _Silence()
        self._stored_part = None

    def _vehicle_of_next_session(self, session: LiveSession) -> Component | None:
        """Returns the vehicle that the next session follows: one that sends now, or the same one after its restart.

        Args:
            session: the session that ends. Its successor is another vehicle that sends while its own is silent.

        Returns:
            The vehicle; None if the server ends, or if the next session waits for any vehicle.
        """
        if self._is_stopping.is_set():
            return None
        if session.successor is None and self._flight.has_restarted:
            return session.stream.followed_vehicle
        return session.successor

    def _warn_of_lost_datagrams(self) -> None:
        """Warns of the datagrams that the link has lost since the session before, if any."""
        newly_lost = self._link.dropped_datagrams - self._lost_datagrams
        self._lost_datagrams += newly_lost
        if newly_lost > 0:
            self._warn(Fact(LinkFact.DATAGRAMS_LOST, count=newly_lost))

    def _store_recording(self, session: LiveSession, incoming: _IncomingRecording) -> None:
        """Adds the recording of an ended session to the library, and reports the address of its page.

        From now on the live page links to this flight. Unless the server stops, the page of the ended session is shown
        until the next vehicle is received.

        Args:
            session: the session, which has ended.
            incoming: its recording, with at least one frame.

        Raises:
            Refusal: the library has no room.
        """
        entry = self._add_to_library(incoming.path, incoming.recording)
        self._replace_stored_part(entry)
        self._latest_flight = _link_to_previous_flight(entry)
        self._log_added()
        self._report_saved_flight(_page_address(entry))
        vehicle = session.stream.followed_vehicle
        if vehicle is not None and not self._is_stopping.is_set():
            flight = _StoredFlight.of_entry(entry, _LinkedVehicle.of_component(vehicle), session)
            flight = flight._replace(
                is_end_unknown=_is_end_unknown(session.status),
                name_in_logs=_name_in_logs(session),
            )
            self._show_stored_flight(flight)

    def _replace_stored_part(self, entry: LibraryEntry) -> None:
        """Replaces the part of a flight that was stored while its vehicle was lost, if any, by the whole recording.

        Args:
            entry: the whole recording in the library. If nothing came after the part, it is the same entry.
        """
        if self._stored_part is None or self._stored_part.entry_id == entry.id:
            return
        # Somebody may have deleted the part meanwhile, or the disk is full. Then the library stays as it is.
        with suppress(Refusal):
            self._library.replace_part(self._stored_part.entry_id, entry)

    def _show_stored_flight(self, flight: _StoredFlight) -> None:
        """Makes the page of the flight that was just stored, which is shown until another vehicle comes.

        The flight that was stored before it becomes one of the earlier flights, whose faults the page states, too.

        Args:
            flight: the flight, with its session.
        """
        if self._stored_flight is not None:
            self._earlier_stored_flights.append(self._stored_flight._replace(session=None))
            # Otherwise the page would count it twice: as the latest stored flight, and as an earlier one.
            self._stored_flight = None
        # The flight has no verdict yet, so that looking it up also makes the page.
        self._stored_flight = self._update_verdict(flight)

    def _store_part(self, session: LiveSession) -> None:
        """Adds what was recorded of a vehicle that is lost in the air to the library; the session goes on.

        So its last minutes can be read while the vehicle is searched. If it comes back, the whole recording takes the
        place of this part at the end of the session.

        Args:
            session: the running session.

        Raises:
            Refusal: the library has no room.
            OSError: the recording cannot be copied.
        """
        vehicle = session.stream.followed_vehicle
        assert self._incoming is not None
        assert vehicle is not None
        recording = self._incoming.recording
        # The file of the recording itself may have this name: if its first message came in the second of its creation.
        path = self._library.new_incoming_path()
        recording.copy_to(path)
        entry = self._add_to_library(path, recording)
        self._stored_part = _StoredFlight.of_entry(entry, _LinkedVehicle.of_component(vehicle))
        self._log_added()
        self._report_saved_flight(_page_address(entry), is_part=True)

    def _add_to_library(self, path: Path, recording: RawRecording) -> LibraryEntry:
        """Adds a file of a session to the library, named by the time of the first message.

        The session itself may have waited for its vehicle for hours.

        Args:
            path: path of the file.
            recording: the recording of the session that the file has, or the beginning of which.

        Returns:
            The index entry.

        Raises:
            Refusal: the library has no room.
        """
        first_time = datetime.fromtimestamp(recording.first_stamp, UTC)
        entry = self._library.add(path, _recording_name(first_time))
        self._recorded_ids.add(entry.id)
        return entry

    def _update_verdict(self, flight: _StoredFlight) -> _StoredFlight:
        """Looks up how the library judges a stored flight now (its verdict); if that is new, reports and shows it.

        The library judges a recording some time after it was stored.

        Args:
            flight: the flight, with the verdict that was looked up last.

        Returns:
            The flight with the present verdict; unchanged if its recording was deleted.
        """
        try:
            entry = self._library.entry(flight.entry_id)
        except Refusal:
            # Somebody has deleted the recording; the page stays as it is.
            return flight
        (verdict,) = self._verdicts_on_recordings([entry])
        if verdict == flight.verdict:
            return flight
        # That a recording is not judged yet is shown on the page, but is no event.
        if verdict.code is SessionFact.RECORDING_JUDGED:
            reported_verdict = _verdict_after_session(verdict, flight.session)
            self._report_event(Event(nan, reported_verdict, reception=clock.unix_time()))
        judged_flight = flight._replace(verdict=verdict)
        # A flight keeps its session as long as the page of that session is shown.
        if flight.session is not None:
            self._finished_page = _finished_page(
                flight.session,
                self._library.names,
                flight.saved_flight,
                verdict,
                self._fault_of_earlier_flight(flight.session, judged_flight),
            )
        return judged_flight

    def _verdicts_on_recordings(self, entries: Sequence[LibraryEntry]) -> list[Fact]:
        """Returns the verdicts on recordings by their logs and by comparison with the vehicle's other flights.

        The comparison may show a loss of thrust that the log alone does not show. It is made a moment after the log was
        read; before that the recording counts as not judged.

        Args:
            entries: the recordings in the library.

        Returns:
            A verdict on each, in the same order.
        """
        compared = self._library.compared_entries(entries)
        verdicts = []
        for entry in compared.entries:
            is_compared = entry.id not in compared.uncompared_ids
            verdicts.append(_verdict_on_recording(entry, is_compared=is_compared))
        return verdicts

    def _new_recording(self) -> _IncomingRecording:
        """Creates the recording of a session, among the incoming files of the library."""
        path = self._library.new_incoming_path(_recording_name(datetime.now(UTC)))
        return _IncomingRecording(RawRecording(path), path)

    def _recording_of_next_session(
        self, recording: RawRecording, vehicle: Component, restart: TimeInterval | None = None
    ) -> _IncomingRecording:
        """Creates the recording of the next session, and moves the messages that belong to it out of the ended one.

        They are those after the last message of the ended session's vehicle, or those since that vehicle restarted.

        Args:
            recording: recording of the session that ends.
            vehicle: vehicle of that session.
            restart: time interval in which it restarted, UNIX s, if the next session is its next flight; None if the
                next session follows another vehicle.

        Returns:
            The new recording, with the pieces of the stream that were moved to it.

        Raises:
            OSError: the messages cannot be moved. Then the file of the new recording is deleted.
        """
        next_recording = self._new_recording()
        new_file = next_recording.recording
        try:
            if restart is None:
                pieces = recording.move_after(vehicle.system, vehicle.component, new_file)
            else:
                pieces = recording.move_since_restart(
                    restart, vehicle.system, vehicle.component, new_file
                )
        except OSError:
            new_file.close()
            next_recording.path.unlink()
            raise
        return next_recording._replace(first_pieces=pieces)

    def _take_event(self, event: Event) -> None:
        """Updates the state of the flight by an event of a session, and reports the event on the server's terminal.

        Args:
            event: event that the session reports.

        Raises:
            OSError: the event is the failure of the recording on the ground. This error ends the session.
        """
        fact = event.fact
        if fact.code is LinkFact.STREAM_RECORDING_ENDED:
            problem = OSError(fact.figures["error"])
            if not self._flight.is_in_air:
                raise problem
            # The pilot of a vehicle that flies needs the alarms more than the recording.
            self._recording_problem = self._recording_problem or problem
        self._flight.update(fact)
        if self._finished_page and fact.code is RowsFact.NOTHING_RECEIVED:
            # A link that waits for the next vehicle is as it should be after a flight.
            return
        # The sentences must not advise options of `mavdem live`, which this server does not have.
        with sentences_for(Medium(has_terminal=False)):
            self._report_event(event)

    def _report_saved_flight(self, path: str, *, is_part: bool = False) -> None:
        """Reports the address of the page of a flight that was added to the library.

        Args:
            path: path of the page on this server.
            is_part: whether only a part of the flight was added, whose session goes on.
        """
        address = self._server_address + path
        saved_fact = Fact(LinkFact.FLIGHT_SAVED, address=address, is_part=is_part)
        # The event is one of this server, without a time of the vehicle's clock.
        no_vehicle_time = nan
        self._report_event(Event(no_vehicle_time, saved_fact, reception=clock.unix_time()))

    def _is_over(self) -> bool:
        """Returns whether the session is to end, whatever else is received on its link.

        It is if the server stops, if the vehicle has restarted after a flight, or if it has been silent for long. A
        session whose recording has ended in flight, as on a full disk, goes on until the landing.
        """
        if self._is_stopping.is_set() or self._flight.has_restarted:
            return True
        if self._recording_problem is not None and not self._flight.is_in_air:
            return True
        return self._silence.is_too_long(has_landed=self._flight.has_landed)

    def _watch_session(self, session: LiveSession) -> None:
        """Updates the page of the running session if it is due, and reports its status; called every ``NEWS_SECONDS``.

        The page is due every ``PAGE_SECONDS``, and sooner if it is outdated.

        Args:
            session: the running session.

        Raises:
            Refusal: the disk is nearly full.
        """
        self._flight.note_status(session.stream.status())
        is_page_due = clock.monotonic() - self._update_time >= PAGE_SECONDS
        if is_page_due:
            self._update_page(session)
            self._print_status(session)
        elif self._page.is_outdated(session):
            self._render_page(session)

    def _print_status(self, session: LiveSession) -> None:
        """Prints the status of the running session on the server's terminal.

        Nothing is printed while the session waits for a vehicle after a flight: the last line on the terminal stays the
        one on that flight, as the page of the link still shows it.

        Args:
            session: the running session.
        """
        if self._finished_page:
            return
        # The sentences must not advise options of `mavdem live`, which this server does not have.
        with sentences_for(Medium(has_terminal=False)):
            self._report_status(self._shown_status(session))

    def _update_page(self, session: LiveSession) -> None:
        """Renders the page of the running session, after it has checked the disk and the silence of the vehicle.

        It is called every ``PAGE_SECONDS``. Once a vehicle that was in the air has been silent for a minute, what was
        recorded of it is stored.

        Args:
            session: the running session, which records what it receives.

        Raises:
            Refusal: the disk is nearly full, so that the session must end while its recording can still be kept. In
                flight the recording alone ends.
        """
        self._update_time = clock.monotonic()
        if self._recording_problem is None:
            try:
                self._library.check_space(0)
            except Refusal as refusal:
                if not self._flight.is_in_air:
                    raise
                self._recording_problem = refusal
                session.intake.stop_recording(refusal)
        self._silence.count_page(session)
        is_lost_for_long = self._silence.is_in_air and self._silence.page_count >= MAX_SILENT_PAGES
        if is_lost_for_long and self._stored_part is None:
            self._store_part(session)
        self._render_page(session)

    def _render_page(self, session: LiveSession) -> None:
        """Renders the page that the link shows now: that of the running session, or of the one before.

        Until a vehicle is received, the page of the session before stays, if there was one, so that its end can be
        read.

        Args:
            session: the running session.
        """
        start_time = clock.monotonic()
        status = session.status
        self._update_summary(session, status)
        if self._finished_page and not _awaits_vehicle(status):
            self._forget_finished_page()
        # The pages of both sessions show verdicts. A new one renews the page of the finished session.
        self._update_verdicts()
        if self._finished_page:
            html = self._finished_page
        else:
            status = self._shown_status(session)
            html = self._page_of_running_session(session, status)
        self._page = SessionPage.made_now(html, session, status, start_time)

    def _render_last_page(self, session: LiveSession) -> None:
        """Renders the last page before the server stops, which browsers show until the server runs again.

        If the given session received no vehicle, the page still shows the previous session, whose flight is in the
        library. Its verdict is shown if the library has judged it; otherwise the page says that it will be judged when
        the server starts again.

        Args:
            session: the latest session, which has just ended.
        """
        start_time = clock.monotonic()
        shown_session = session
        shown_flight = None
        verdict = READ_AT_NEXT_START
        flight = self._stored_flight
        # The stored flight keeps its session until another vehicle comes, whose session is shown instead.
        if flight is not None and flight.session is not None and flight.verdict is not None:
            shown_session = flight.session
            shown_flight = flight
            if not flight.is_unjudged:
                verdict = flight.verdict
        html = _finished_page(
            shown_session,
            self._library.names,
            None,
            verdict,
            self._fault_of_earlier_flight(shown_session, shown_flight),
        )
        self._page = SessionPage.made_now(html, session, session.status, start_time)
        self._has_last_page.set()

    def _forget_finished_page(self) -> None:
        """Ends showing the page of the session before: a vehicle has come, whose session is shown from now on."""
        self._finished_page = ""
        if self._stored_flight is not None:
            self._stored_flight = self._stored_flight._replace(session=None)

    def _update_verdicts(self) -> None:
        """Looks up the verdicts of the library, which judges a recording some time after it was stored.

        They are those on the latest flight, on earlier flights, and on the stored part of a flight whose link was lost.
        """
        self._earlier_stored_flights = _flights_to_keep(
            [self._update_verdict(flight) for flight in self._earlier_stored_flights]
        )
        if self._stored_flight is not None:
            self._stored_flight = self._update_verdict(self._stored_flight)
        if self._stored_part is not None:
            self._stored_part = self._update_verdict(self._stored_part)

    def _page_of_running_session(self, session: LiveSession, status: SessionStatus) -> str:
        """Renders the HTML page of the running session, with links to the latest recording and to the library.

        While a vehicle that was lost in the air is searched, it also links to what was stored of this flight.

        Args:
            session: the running session.
            status: its status, as users are to see it.
        """
        saved_flight = None
        is_link_lost_in_air = status.link_loss is not None
        if is_link_lost_in_air and self._stored_part is not None:
            saved_flight = self._stored_part.saved_flight
        links = [] if self._latest_flight is None else [self._latest_flight]
        return session_page(
            session,
            status,
            self._library.names,
            back=LIBRARY_LINK,
            links=links,
            saved_flight=saved_flight,
        )

    def _shown_status(self, session: LiveSession) -> SessionStatus:
        """Returns the status of the running session as users see it: with the fault that an earlier flight had, if any.

        It has no all-clear, since the recording of a session is judged only after its end.

        Args:
            session: the running session.
        """
        return replace(
            session.status,
            recording_verdict=NOT_JUDGED_IN_SESSION,
            fault_in_library=self._fault_of_earlier_flight(session),
        )

    def _flights_from_before_start(
        self, vehicle: _LinkedVehicle, session: LiveSession
    ) -> list[_StoredFlight]:
        """Returns the latest flights of a vehicle in the library that this server has not recorded.

        They are needed since a new start of the server repairs no fault. The library is searched each time, since it
        may judge the last flight of the server before only after this one has received the vehicle.

        Args:
            vehicle: the vehicle.
            session: its session, with the name under which the library lists the vehicle.

        Returns:
            The flights, the latest one last (:meth:`_latest_judged_flights`).
        """
        state = session.status.state
        if state is None or not state.library_name:
            return []
        return self._latest_judged_flights(vehicle, state)

    def _latest_judged_flights(
        self, vehicle: _LinkedVehicle, state: VehicleState
    ) -> list[_StoredFlight]:
        """Finds the latest judged flights of a vehicle in the library, and later ones that it may have flown.

        The library lists a recording without the vehicle's parameters under a name made of its system id. Such a
        flight may be of this vehicle or of another one with the same id.

        Args:
            vehicle: the vehicle.
            state: its state in the session, with its names in the library and in logs.

        Returns:
            The flights under the vehicle's name, and after them those under the name of its system id that are later;
            the latest one last.
        """
        named_entries = self._latest_judged_entries(state.library_name, vehicle)
        flights = self._flights_of_entries(named_entries, vehicle, state.name_in_logs)
        name_by_id = system_id_name(state.autopilot, state.system)
        if name_by_id == state.library_name:
            return flights
        # Dates in ISO 8601 are compared as texts; the empty text is before all of them.
        date_of_named_flight = named_entries[-1].date if named_entries else ""
        later_entries = []
        for entry in self._latest_judged_entries(name_by_id, vehicle):
            if entry.date > date_of_named_flight:
                later_entries.append(entry)
        return flights + self._flights_of_entries(later_entries, vehicle, name_in_logs="")

    def _latest_judged_entries(self, name: str, vehicle: _LinkedVehicle) -> list[LibraryEntry]:
        """Finds the latest flights under a name that the library has judged, at most ``MAX_FLIGHTS_BEFORE_START``.

        Those that this server has recorded are left out.

        Args:
            name: name under which the library lists the vehicle.
            vehicle: the vehicle, with the autopilot and frame that the flights must have.

        Returns:
            The flights, the latest one last.
        """
        # A flight that is not judged yet has an empty level.
        condition = (
            "vehicle = ? and autopilot = ? and frame = ? and level <> ''"
            " and id not in (select value from json_each(?))"
        )
        recorded_ids = json.dumps([*self._recorded_ids])
        values = (name, vehicle.autopilot, vehicle.vehicle_type, recorded_ids)
        found = self._library.find(
            condition, values, limit=MAX_FLIGHTS_BEFORE_START, order=ListingOrder.FLIGHT
        )
        return list(found.entries)[::-1]

    def _flights_of_entries(
        self, entries: Sequence[LibraryEntry], vehicle: _LinkedVehicle, name_in_logs: str
    ) -> list[_StoredFlight]:
        """Returns flights of the library with the verdicts on them, in the same order.

        Args:
            entries: the flights, which the library has judged.
            vehicle: the vehicle that has flown them, perhaps.
            name_in_logs: name by which logs of this vehicle are recognised; empty if another one may have flown them.
        """
        flights = []
        for entry, verdict in zip(entries, self._verdicts_on_recordings(entries), strict=True):
            flight = _StoredFlight.of_entry(entry, vehicle)
            flights.append(flight._replace(verdict=verdict, name_in_logs=name_in_logs))
        return flights

    def _fault_of_earlier_flight(
        self, session: LiveSession, shown_flight: _StoredFlight | None = None
    ) -> Fact | None:
        """Returns the fault that the library found in an earlier flight of a vehicle, if the pilot must still know it.

        The first of these that exists is returned:

        1. A fault that forbids to fly. It counts until a later flight was judged good as a whole
           (:func:`_faulty_flight`) or a user states that it was repaired: a take-off alone repairs nothing.
        2. Any other bad fault of the flight just before this one, or that its end was not received
           (:func:`_fault_of_flight_before`).

        Args:
            session: the session that is shown, running or over; its vehicle is meant.
            shown_flight: the stored flight of that session; None before it is stored. If it was judged good, it ends
                the faults before it.

        Returns:
            The fact with the address of the flight's page, and whether another vehicle may have flown that flight
            (:func:`_fault_for_session`); None without a fault, and before a vehicle is followed.
        """
        vehicle = session.stream.followed_vehicle
        if vehicle is None:
            return None
        linked_vehicle = _LinkedVehicle.of_component(vehicle)
        earlier_flights = self._earlier_flights(linked_vehicle, session, shown_flight)
        sound_flights = []
        if shown_flight is not None and shown_flight.is_judged_good:
            sound_flights.append(shown_flight)
        faulty_flight = _faulty_flight([*earlier_flights, *sound_flights], _name_in_logs(session))
        if faulty_flight is not None and faulty_flight.verdict is not None:
            return _fault_for_session(faulty_flight.verdict, faulty_flight, session)
        if sound_flights or not earlier_flights:
            return None
        flight_before = earlier_flights[-1]
        if self._stored_flight is not None and flight_before != self._stored_flight:
            # It is not the flight just before: another one was stored since, of another vehicle or of this session.
            return None
        return _fault_of_flight_before(flight_before, session)

    def _earlier_flights(
        self, vehicle: _LinkedVehicle, session: LiveSession, shown_flight: _StoredFlight | None
    ) -> list[_StoredFlight]:
        """Returns the earlier flights of a vehicle in the library that may have a fault, the latest one last.

        Args:
            vehicle: the vehicle.
            session: the session that is shown, of this vehicle.
            shown_flight: the stored flight of that session, which is left out; None for none.
        """
        shown_entry_id = "" if shown_flight is None else shown_flight.entry_id
        flights_before_start = self._flights_from_before_start(vehicle, session)
        earlier_flights = []
        for flight in (
            *flights_before_start,
            *self._earlier_stored_flights,
            self._stored_flight,
        ):
            if flight is None or flight.entry_id == shown_entry_id:
                continue
            if flight.vehicle == vehicle:
                is_repaired = self._was_stated_repaired(flight)
                earlier_flights.append(flight._replace(is_repaired=is_repaired))
        return earlier_flights

    def _was_stated_repaired(self, flight: _StoredFlight) -> bool:
        """Returns whether a user has stated that the fault of a stored flight was repaired; False if it was deleted."""
        try:
            return self._library.entry(flight.entry_id).repaired != ""
        except Refusal:
            return False

    def _update_summary(self, session: LiveSession, status: SessionStatus) -> None:
        """Updates the line on the running session that the library shows: its title, and what the vehicle does.

        Args:
            session: the running session.
            status: its present status.
        """
        title = live_title(status, session.link.name, self._library.names)
        self._summary = title
        if status.vehicle is not None:
            # The title names the vehicle already.
            vehicle_state = vehicle_text(status).removeprefix(f"{status.vehicle}, ")
            self._summary = f"{title}: {vehicle_state}"


def _faulty_flight(flights: Sequence[_StoredFlight], name_in_logs: str) -> _StoredFlight | None:
    """Returns the latest flight with a fault for which the vehicle must not fly, if no later flight shows it repaired.

    A flight shows a vehicle repaired if its whole recording was judged good, and if the vehicle is known by name, since
    other vehicles may have the same ids on the link. Such a flight clears

    - the earlier flights of the vehicle with that name;
    - all earlier flights, if this is the vehicle that is followed now: its newest state is known to be good.

    Any other fault stands until a user states that it was repaired.

    Args:
        flights: flights of vehicles with the same ids on the link, the latest one last.
        name_in_logs: name by which logs of the followed vehicle are recognised; empty where only its ids are known.

    Returns:
        The flight, whose verdict states the fault; None without one.
    """
    names_of_sound_vehicles = set()
    # From the latest flight back: a flight clears only those before it.
    for flight in reversed(flights):
        clears_faults = flight.is_judged_good and flight.name_in_logs != ""
        if clears_faults and flight.name_in_logs == name_in_logs:
            return None
        if clears_faults:
            names_of_sound_vehicles.add(flight.name_in_logs)
        if flight.forbids_flight and flight.name_in_logs not in names_of_sound_vehicles:
            return flight
    return None


def _flights_to_keep(flights: Sequence[_StoredFlight]) -> list[_StoredFlight]:
    """Returns the flights that must be kept, since :func:`_faulty_flight` decides by them now or later.

    They are those that the library has still to judge, and of each vehicle the latest one that was judged good, with
    the flights after it that forbid to fly. Of vehicles whose logs have no name all those are kept that forbid to fly.

    Args:
        flights: flights of all vehicles of the link, the latest one last.

    Returns:
        Those flights, in the same order.
    """
    kept_flights = []
    sound_vehicles = set()
    for flight in reversed(flights):
        identity = (flight.vehicle, flight.name_in_logs)
        clears_faults = flight.is_judged_good and flight.name_in_logs != ""
        has_decisive_verdict = clears_faults or flight.forbids_flight
        is_decisive = has_decisive_verdict and identity not in sound_vehicles
        if flight.is_unjudged or is_decisive:
            kept_flights.append(flight)
        if clears_faults:
            sound_vehicles.add(identity)
    return kept_flights[::-1]


def _fault_of_flight_before(flight: _StoredFlight, session: LiveSession) -> Fact | None:
    """Returns what the flight before warns of: that its end was not received, or a bad fault; None for neither.

    It warns until the next landing, since the next flight shows whether the fault is still there; or until a user
    states that it was repaired.

    Args:
        flight: the flight before, with the library's verdict on it.
        session: the session that is shown, of the same vehicle.
    """
    verdict = flight.verdict
    if flight.is_repaired:
        return None
    if flight.is_end_unknown:
        end_unknown = Fact(SessionFact.FLIGHT_END_UNKNOWN, reason=verdict)
        return _fault_for_session(end_unknown, flight, session)
    if verdict is not None and verdict.is_bad:
        return _fault_for_session(verdict, flight, session)
    return None


def _is_end_unknown(status: SessionStatus) -> bool:
    """Returns whether the end of the latest flight of an ended session was not received.

    Its link was lost in the air and did not come back, or the autopilot restarted after the last message in the air.

    Args:
        status: status at the end of the session.
    """
    was_link_lost_in_air = status.link_loss is not None
    if was_link_lost_in_air:
        return True
    if not status.verdicts:
        return False
    # Without a lost link, only a restart of the autopilot ends a flight in the air.
    verdict_on_latest_flight = status.verdicts[-1]
    return verdict_on_latest_flight.is_lost_in_air


def _is_on_ground(status: SessionStatus) -> bool:
    """Returns whether the messages of a vehicle show that it is on the ground; False if they do not show where it is.

    Args:
        status: status of the vehicle. On the ground, that it does not fly is the reason for learning no model of it.
    """
    reason = status.no_model_reason
    return reason is not None and reason.code is SessionFact.NOT_FLYING


def _may_have_vehicle(session: LiveSession, recording_path: Path) -> bool:
    """Returns whether the recording of an ended session is worth keeping: it has messages of a vehicle, or may have.

    Args:
        session: the session.
        recording_path: path of its recording, which is closed and has a frame.
    """
    if session.stream.has_heard_attitude:
        return True
    # The last frames of a session are recorded, but may not have been analysed: their vehicle is in the file alone.
    try:
        return bool(read_log(recording_path).vehicles)
    except Refusal:
        # A recording that cannot be read is kept, since its page in the library says why.
        return True


def _page_address(entry: LibraryEntry) -> str:
    """Returns the path of the page of a recording on this server."""
    return f"/f/{entry.id}"


def _link_to_previous_flight(entry: LibraryEntry) -> PageLink:
    """Returns the link from the live page to a flight that ended before the one that the page shows.

    Args:
        entry: index entry of the earlier flight.
    """
    return PageLink("Previous flight", _page_address(entry))


def _link_to_latest_recording(library: Library) -> PageLink | None:
    """Returns the link to the latest recording of a live session in a library; None without any.

    Recordings are recognised by their names (:func:`_recording_name`), so that uploaded logs do not count.

    Args:
        library: the library.
    """
    found = library.find("name glob ?", [RECORDING_NAME_PATTERN], limit=1)
    return _link_to_previous_flight(found.entries[0]) if found.entries else None


def _recording_name(first_time: datetime) -> str:
    """Returns the name of the recording of a session, such as ``2026-11-28_09-15-00.tlog``.

    Args:
        first_time: time of its first frame, UTC.
    """
    return f"{first_time:%Y-%m-%d_%H-%M-%S}.tlog"


def _received_frames(session: LiveSession) -> int:
    """Returns the number of MAVLink frames of the followed vehicle or, before one is followed, of all vehicles.

    Args:
        session: the session, which records what it receives.
    """
    vehicle = session.stream.followed_vehicle
    if vehicle is not None:
        # Frames of another vehicle on the same link do not count: it has its turn once the followed one is silent.
        return vehicle.frame_count
    recording = session.intake.recording
    # If writing the recording fails before a vehicle flies, the session ends before its next page.
    assert recording is not None
    return recording.frame_count


def _awaits_vehicle(status: SessionStatus) -> bool:
    """Returns whether no vehicle has been received in a session."""
    reason = status.no_model_reason
    return status.vehicle is None and (reason is None or reason.code in NO_VEHICLE_CODES)


def _verdict_on_recording(entry: LibraryEntry, *, is_compared: bool) -> Fact:
    """Returns the verdict of the library on a recording as a fact (a coded finding), or that it is not judged yet.

    Args:
        entry: the recording in the library. Once it is judged, the verdict has a level, such as good; and each light
            (the judgement of one subject, such as wind) has a level, a sentence and a figure.
        is_compared: whether its motors have been compared with the vehicle's other flights. Before that no verdict is
            given, since it might be an all-clear that the comparison then takes back.
    """
    if entry.level and is_compared:
        return Fact(
            SessionFact.RECORDING_JUDGED,
            Level(entry.level),
            headline=entry.headline,
            next_step=entry.next_step,
            levels={light: getattr(entry, light) for light in Light},
            light_sentences=json.loads(entry.light_sentences),
            flight_date=_date_to_the_minute(entry),
            motor=_motor_of_headline(entry),
            light_figures=json.loads(entry.light_figures),
        )
    has_failed = entry.stage == Stage.FAILED
    state = RecordingState.FAILED if has_failed else RecordingState.BEING_READ
    return Fact(SessionFact.RECORDING_NOT_JUDGED, kind=state)


def _date_to_the_minute(entry: LibraryEntry) -> str:
    """Returns when the flight of a recording began, such as "2026-11-28 09:15", UTC; empty where that is not known."""
    return entry.date[: len("2026-11-28T09:15")].replace("T", " ")


def _motor_of_headline(entry: LibraryEntry) -> int | None:
    """Returns the number of the motor whose fault is the headline of a recording; None if that is something else.

    Args:
        entry: the recording in the library, which has judged it.
    """
    motors_sentence = json.loads(entry.light_sentences).get(Light.MOTORS, "")
    return entry.motor if entry.headline == motors_sentence else None


def _name_in_logs(session: LiveSession) -> str:
    """Returns the name by which logs of a session's vehicle are recognised; empty where only its ids are known."""
    state = session.status.state
    return "" if state is None else state.name_in_logs


def _fault_for_session(fault: Fact, flight: _StoredFlight, session: LiveSession) -> Fact:
    """Adds to the fault of an earlier flight the address of its page, and whether another vehicle may have flown it.

    Two vehicles may have the same ids on the link. It is the same vehicle for certain if the names by which its logs
    are recognised are equal. Different names prove nothing, since a calibration changes them.

    Args:
        fault: the verdict on the flight, or that its end was not received.
        flight: the earlier flight.
        session: the session, of a vehicle that has the same ids on the link.

    Returns:
        The fact with the figures ``address``, of the flight's page, and ``may_be_other_vehicle``.
    """
    is_same_vehicle = flight.name_in_logs != "" and flight.name_in_logs == _name_in_logs(session)
    return fault.replace(
        address=flight.saved_flight.address, may_be_other_vehicle=not is_same_vehicle
    )


def _finished_page(
    session: LiveSession,
    names: GivenNames,
    saved_flight: PageLink | None,
    verdict: Fact,
    fault_of_earlier_flight: Fact | None = None,
) -> str:
    """Returns the HTML page of a live session that has ended, which links to the stored flight in the library.

    Args:
        session: the ended session.
        names: names that were given to vehicles in the library.
        saved_flight: link to the page of its flight in the library; None where the server ends too. Browsers then keep
            this page until the server runs again.
        verdict: what the recording of the flight shows, or that it is not judged yet.
        fault_of_earlier_flight: the fault that an earlier flight of this vehicle had; None without one.
    """
    final_status = replace(
        _final_status(session),
        recording_verdict=verdict,
        fault_in_library=fault_of_earlier_flight,
    )
    is_last = saved_flight is None
    files = []
    if is_last and not _awaits_vehicle(session.status):
        # The recording has no page yet that could be linked.
        files.append(Fact(LinkFact.FLIGHT_SAVED, address=None, is_part=False).sentence)
    return session_page(
        session,
        final_status,
        names,
        back=LIBRARY_LINK,
        saved_flight=saved_flight,
        files=files,
        is_last=is_last,
    )


def _verdict_after_session(verdict: Fact, session: LiveSession | None) -> Fact:
    """Returns the verdict on a recording with two things that only its live session knows.

    These are an outage of the link in flight, and messages that were requested and never came.

    Args:
        verdict: what the recording of the flight shows.
        session: the session that received the flight; None if it is not known any more.
    """
    if session is None:
        return verdict
    status = session.status
    verdict = verdict_after_requests(verdict, status.absent_messages)
    if status.link_outage is None:
        return verdict
    return headline_with_outage(verdict, status.link_outage)


def _final_status(session: LiveSession) -> SessionStatus:
    """Returns the status of an ended session; its rates of messages and what is watched are those at the last message.

    Most sessions end after the vehicle was switched off, so that the rates of its messages are 0 at the end, and
    nothing is watched any more.

    Args:
        session: the ended session.
    """
    status_at_end = session.status
    status_at_last_message = session.stream.status()
    return replace(
        status_at_end,
        is_over=True,
        no_model_reason=_final_reason_without_model(status_at_end, status_at_last_message),
        rates=status_at_last_message.rates,
        watch_facts=status_at_last_message.watch_facts,
    )


def _final_reason_without_model(
    status_at_end: SessionStatus, status_at_last_message: SessionStatus
) -> Fact:
    """Returns the reason for learning no model that the page of an ended session states.

    The first of these rules that applies decides:

    1. If the link was lost in flight, the reason is that no messages come: the page then shows where the vehicle was
       last.
    2. If no model was being learned when the last message came, the reason is the one at that time, such as that the
       vehicle was on the ground. That it is silent at the end says nothing more: most are switched off.
    3. If a model was being learned until the last message, the reason is that the flight is over.

    Args:
        status_at_end: status at the end of the session, when its vehicle has mostly been silent for a while.
        status_at_last_message: status of the same session when the last message of the vehicle came.
    """
    reason_at_end = status_at_end.no_model_reason
    was_link_lost_in_flight = status_at_end.link_loss is not None
    if was_link_lost_in_flight and reason_at_end is not None:
        return reason_at_end
    reason_at_last_message = status_at_last_message.no_model_reason
    if reason_at_last_message is not None:
        return reason_at_last_message
    # The figure "reason" of this fact is how the vehicle was lost; here nothing is known of a loss.
    return Fact(SessionFact.FLIGHT_OVER, reason=None)


def _ignore(_: object) -> None:
    """Ignores a report of a session, since the server shows on the page what it says."""
