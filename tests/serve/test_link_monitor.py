"""A server that is attached to a link: the page of the session, its log in the library, and what ends it."""

import errno
import json
import signal
import socket
import time
from dataclasses import replace
from datetime import UTC, datetime
from itertools import count
from math import inf
from threading import Event
from unittest.mock import Mock

from command_line import free_port
from fleet_rows import flight_row
from mavlink_streams import flight, heartbeat
from patience import PATIENCE, until
from pytest import fixture, mark, raises
from recorded_flights import FLIGHT
from serving import serving
from take_over import record_take_over, systems_in

from mavdem.cli.serve import serve_command
from mavdem.errors import Refusal
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import NextStep
from mavdem.facts.event import Event as HappenedEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Light
from mavdem.facts.serve import RefusalReason
from mavdem.facts.session import (
    LinkFact,
    MissingMessages,
    RowsFact,
    SessionFact,
    TimeUse,
    VehicleFact,
)
from mavdem.fleet.names import NO_NAMES
from mavdem.fleet.stored_rows import brief_json
from mavdem.ingest import read_log
from mavdem.ingest.mavlink.frame_reader import FrameReader
from mavdem.live import clock
from mavdem.live.global_position import GlobalPosition
from mavdem.live.history import LiveHistory
from mavdem.live.raw_recording import RawRecording
from mavdem.live.session_status import SessionStatus
from mavdem.live.vehicle_selection import Component
from mavdem.live.vehicle_state import VehicleState
from mavdem.report.live import (
    headline_reason,
    moment_text,
    statement_of_repair,
    verdict_on_present_flight,
)
from mavdem.report.pages import live_page
from mavdem.report.pages.page import PageLink
from mavdem.report.templates import headline as headline_text
from mavdem.serve import link_monitor, live_pages
from mavdem.serve.index import LibraryEntry
from mavdem.serve.library import Library
from mavdem.serve.link_monitor import LinkMonitor
from mavdem.serve.listening import end_by_all_signals

FRAMES = FLIGHT.read_bytes()[:100_000]
GROUND_STATION = heartbeat(255, 190, kind=6, autopilot=8)


@fixture
def heard(tmp_path, monkeypatch):
    """What begins a session that hears a vehicle; and its library, what it warns of, and the logs that came."""
    monkeypatch.setattr(link_monitor, "PAGE_SECONDS", 0.1)
    # A session is over before a part of its recording would be stored.
    monkeypatch.setattr(link_monitor, "MAX_SILENT_PAGES", 6)
    monkeypatch.setattr(link_monitor, "MAX_SILENT_PAGES_IN_AIR", 5)
    library = Library(tmp_path)
    come = []
    warned = []
    port = free_port()
    live = LinkMonitor(
        f"udpin:127.0.0.1:{port}", library, lambda: come.append(True), warned.append, print, Mock()
    )

    def begin():
        live.start()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
            for first in range(0, len(FRAMES), 1000):
                vehicle.sendto(FRAMES[first : first + 1000], ("127.0.0.1", port))
                time.sleep(0.001)
        return live

    yield begin, library, warned, come
    live.stop()


@fixture
def idle(tmp_path):
    """A monitor that runs no session, and the events that the terminal of its server has."""
    told = []
    live = LinkMonitor(
        f"udpin:127.0.0.1:{free_port()}",
        Library(tmp_path),
        Mock(),
        Mock(),
        told.append,
        Mock(),
        server_address="http://127.0.0.1:8600",
    )
    yield live, told
    live._link.close()


@mark.slow
def test_a_session_has_a_page_and_leaves_its_log(tmp_path, heard):
    """A vehicle is received and falls silent: its flight has a page, and its recording is in the library."""
    begin, library, warned, come = heard
    live = begin()
    until(lambda: come)  # The link falls silent.
    assert "udpin:127.0.0.1:" in live.page.html and not warned
    assert '<a href="/">← Flights</a>' in live.page.html and "the last 0 s" not in live.page.html
    (entry,), _ = library.find("1", [], 10)
    # While the next session waits for a vehicle, the page is that of the flight, and leads to its recording.
    until(lambda: "Saved so far:" in live.page.html)
    assert "This flight is over." not in live.page.html
    assert f'<a href="/f/{entry.id}">' in live.page.html
    (telemetry,) = read_log(library.log_path(entry)).vehicles
    assert (telemetry.system, telemetry.component) == (1, 1)
    # The flight is named after its first frame, not after the time since when the server listened.
    first_stamp = int.from_bytes(library.log_path(entry).read_bytes()[:8], "big") / 1e6
    assert entry.name == f"{datetime.fromtimestamp(first_stamp, UTC):%Y-%m-%d_%H-%M-%S}.tlog"
    with serving(tmp_path / "other") as server:
        assert server.get("/live").status == 404 and "/live" not in server.get("/").text


@mark.slow
def test_open_pages_get_a_last_one_before_the_server_ends(heard):
    """Browsers keep it until the server runs again: its link leads to the flights, and to no page of this session."""
    begin, library, _, _ = heard
    live = begin()
    until(lambda: "<main data-level" in live.page.html and "vehicle 1" in live.page.html)
    live.end_session()
    html = live.page.html
    assert (
        "<main data-level" not in html
        and "is in the library once" in html
        and '<a href="/">← Flights</a>' in html
        and 'href="/f/' not in html
    )
    live.stop()
    assert library.find("1", [], 10).total == 1


@mark.slow
def test_the_part_of_a_recording_is_a_file_of_its_own(idle, monkeypatch):
    """Also where the recording was created in the second of its first message, by which the part is named."""
    live, _ = idle
    monkeypatch.setattr(link_monitor, "_recording_name", Mock(return_value="flight.tlog"))
    live._incoming = live._new_recording()
    live._incoming.recording.add(1e9, FrameReader().feed(FRAMES))
    live._store_part(Mock())
    (entry,), _ = live._library.find("1", [], 10)
    part = live._library.log_path(entry).read_bytes()
    assert part and part == live._incoming.path.read_bytes()


@mark.slow
@mark.parametrize(
    ("is_flying", "has_landed", "longest_silence"),
    [(False, False, 60), (False, True, 15), (True, False, 600)],
)
def test_a_session_is_over_when_a_vehicle_that_was_heard_is_silent_for_long(
    idle, monkeypatch, is_flying, has_landed, longest_silence
):
    live, _ = idle
    live._flight.has_landed = has_landed
    monkeypatch.setattr(live_pages, "live_page", Mock(return_value=""))
    silence = Fact(RowsFact.NOTHING_RECEIVED, subject="messages", duration=3.0)
    session = Mock(status=SessionStatus("1:1", silence, is_flying=is_flying))
    session.history.events = []
    session.stream.followed_vehicle.frame_count = 0
    monkeypatch.setattr(live, "_store_part", Mock())
    seconds = -20 * link_monitor.PAGE_SECONDS
    for page, frames in enumerate([0] * 20 + [7] * 130):
        # Another vehicle sends on the same link all the time.
        session.intake.recording.frame_count = page
        session.stream.followed_vehicle.frame_count = frames
        live._update_page(session)
        seconds += link_monitor.PAGE_SECONDS * (not live._is_over())
    live._link.close()
    assert seconds == longest_silence


@mark.slow
def test_a_flight_goes_on_when_messages_come_again_after_a_loss_in_the_air(idle, monkeypatch):
    """A minute after the loss, what was recorded is in the library."""
    live, told = idle
    monkeypatch.setattr(live_pages, "live_page", Mock(return_value=""))
    live._incoming = live._new_recording()
    live._incoming.recording.first_stamp = 1e9
    silence = Fact(RowsFact.NOTHING_RECEIVED, subject="messages", duration=3.0)
    lost = SessionStatus("1:1", silence, is_flying=True)
    session = Mock(status=lost)
    session.history.events = []
    session.stream.followed_vehicle.name = "1:1"
    session.intake.recording.frame_count = session.stream.followed_vehicle.frame_count = 7
    for _ in range(20):
        live._update_page(session)
    [part], _ = live._library.find("1", [], 10)
    assert part.name == "2001-09-09_01-46-40.tlog"
    assert [str(event.fact) for event in told] == [
        f"Flight saved so far: http://127.0.0.1:8600/f/{part.id}"
    ]
    assert live_pages.live_page.call_args.kwargs["saved_flight"].address == f"/f/{part.id}"
    session.status = replace(lost, no_model_reason=None)
    # The event that messages come again is on the page before the next count.
    live._render_page(session)
    assert live_pages.live_page.call_args.kwargs["saved_flight"] is None
    assert not live._is_over()
    # At the end the whole recording takes its place.
    live._incoming.path.write_bytes(b"the whole flight")
    live._store_recording(session, live._incoming)
    [whole], _ = live._library.find("1", [], 10)
    assert whole.name == part.name and whole.digest != part.digest


def test_the_page_counts_the_seconds_since_a_vehicle_fell_silent_in_flight(idle, monkeypatch):
    """The page states the age of the loss at its last change, and then counts on."""
    live, _ = idle
    monkeypatch.setattr(live_pages, "live_page", lambda *args, **_: str(args[3].link_loss))
    silence = Fact(RowsFact.NOTHING_RECEIVED, subject="messages", duration=3.0)
    session = Mock(status=SessionStatus("1:1", silence, is_flying=True, message_age=4.0))
    session.history.events = []
    session.intake.recording.frame_count = session.stream.followed_vehicle.frame_count = 0
    live._watch_session(session)
    session.status = replace(session.status, message_age=5.0)
    live._watch_session(session)
    assert live.page.html == "Link lost 4 s ago, in flight: no position received in this flight."
    live._page = replace(live.page, made_time=live.page.made_time - 1.0)
    live._watch_session(session)
    assert live.page.html == "Link lost 5 s ago, in flight: no position received in this flight."


def test_the_page_of_a_flight_whose_end_nobody_saw_says_when_the_link_was_lost(idle, monkeypatch):
    monkeypatch.setattr(
        live_pages, "live_page", lambda *args, **_: str(args[3].overall_judgement.headline)
    )
    session = Mock()
    session.history.events = []
    session.stream.status.return_value = SessionStatus("1:1", is_flying=True)
    silence = Fact(RowsFact.NOTHING_RECEIVED, subject="messages", duration=3.0)
    session.status = SessionStatus("1:1", silence, is_flying=True, last_reception=1e9)
    verdict = link_monitor.NOT_JUDGED_IN_SESSION
    page = link_monitor._finished_page(session, NO_NAMES, PageLink("a.tlog", "/f/abc"), verdict)
    assert page.startswith("Link lost at ") and ", in flight: " in page


def test_the_page_of_a_vehicle_lost_in_the_air_is_not_over_and_has_the_log_as_the_library_judges_it():
    session = Mock()
    session.history = LiveHistory()
    session.link.name = "udpin:127.0.0.1:14550"
    session.stream.axis = "roll"
    session.time_account.return_value = dict.fromkeys(TimeUse, 0.0)
    session.stream.status.return_value = SessionStatus("1:1", is_flying=True)
    session.status = SessionStatus(
        "1:1",
        Fact(RowsFact.NOTHING_RECEIVED, subject="messages", duration=3.0),
        is_flying=True,
        last_reception=1e9,
        last_position=GlobalPosition(47.3977421, -8.5455938, 20.4, 1e9),
    )
    levels = dict.fromkeys(Light, "good") | {Light.LOG: "watch"}
    judged = Fact(
        SessionFact.RECORDING_JUDGED,
        Level.WATCH,
        headline="",
        next_step="Read it.",
        levels=levels,
        light_sentences={Light.LOG: "The log has gaps."},
    )
    page = link_monitor._finished_page(session, NO_NAMES, PageLink("a.tlog", "/f/abc"), judged)
    assert "This flight is over" not in page
    assert 'Saved so far: <a href="/f/abc">a.tlog</a>' in page
    assert '<a href="geo:47.39774,-8.54559">' in page
    assert '<dt>Log</dt><dd class="watch">' in page
    assert "The log has gaps." in page


@mark.slow
def test_the_page_has_an_alarm_at_once_and_other_changes_every_five_seconds(idle, monkeypatch):
    """The page is rendered again for an alarm, and otherwise after ``PAGE_SECONDS``."""
    live, _ = idle
    now = clock.monotonic()
    # Rendering takes no time.
    monkeypatch.setattr(clock, "monotonic", lambda: now)
    pages = (f"page {number}" for number in count())
    monkeypatch.setattr(live_pages, "live_page", lambda *_, **__: next(pages))
    session = Mock(status=SessionStatus("1:1"))
    session.history.events = []
    session.intake.recording.frame_count = session.stream.followed_vehicle.frame_count = 0
    live._watch_session(session)
    live._watch_session(session)
    assert live.page.html == "page 0"
    session.history.events.append(
        HappenedEvent(4.0, Fact(ReportedEvent.BATTERY_ALARMED, Level.BAD))
    )
    live._watch_session(session)
    assert live.page.html == "page 1"
    live._update_time -= link_monitor.PAGE_SECONDS
    live._watch_session(session)
    assert live.page.html == "page 2"


def test_a_finished_flight_is_shown_until_the_next_vehicle_comes(idle, monkeypatch):
    """A session without a vehicle follows a finished flight.

    Its page replaces the finished one only when a vehicle is known.
    """
    live, _ = idle
    monkeypatch.setattr(live_pages, "live_page", Mock(return_value="running"))
    live._finished_page = "finished"
    session = Mock()
    session.history.events = []
    session.stream.followed_vehicle = None
    session.intake.recording.frame_count = 0
    shown = []
    silence = Fact(RowsFact.NOTHING_RECEIVED, subject="messages", duration=2.0)
    for status in (
        SessionStatus(no_model_reason=silence),
        SessionStatus(no_model_reason=Fact(VehicleFact.NO_VEHICLE_YET)),
        SessionStatus("1:1"),
        SessionStatus(no_model_reason=silence),
    ):
        session.status = status
        live._update_page(session)
        shown.append(live.page.html)
    assert shown == ["finished", "finished", "running", "running"]


@mark.slow
def test_the_page_of_a_finished_flight_leads_to_the_library_and_keeps_what_it_knew():
    """After the flight, the page must not say that nothing is received."""
    session = Mock()
    session.history.events = []
    session.link.name = "udpin:127.0.0.1:14550"
    session.stream.axis = "roll"
    session.history = LiveHistory()
    session.time_account.return_value = dict.fromkeys(TimeUse, 0.0)
    known = SessionStatus("1:1")
    session.stream.status.return_value = known
    silence = Fact(RowsFact.NOTHING_RECEIVED, subject="messages", duration=2.0)
    session.status = replace(known, no_model_reason=silence)
    entry = LibraryEntry("abc", "a.tlog")
    awaited = link_monitor._verdict_on_recording(entry, is_compared=False)
    page = link_monitor._finished_page(session, NO_NAMES, PageLink("a.tlog", "/f/abc"), awaited)
    assert "This flight is over." in page and 'href="/f/abc">Open its page</a>' in page
    assert "Nothing was received" not in page and "The flight is over; nothing more" in page


def test_the_page_of_a_finished_flight_has_the_verdict_of_the_library_once_it_is_read(
    idle, monkeypatch
):
    """Until then it says that the log is being read."""
    live, told = idle
    library = live._library
    monkeypatch.setattr(
        live_pages, "live_page", lambda *args, **_: str(args[3].overall_judgement.headline)
    )
    session = Mock()
    flown = SessionStatus("1:1", flight_number=1)
    session.stream.status.return_value = session.status = flown
    incoming_path = library.new_incoming_path("a.tlog")
    incoming_path.write_bytes(b"a")
    entry = library.add(incoming_path, "a.tlog")
    link = PageLink("a.tlog", "/f/abc")
    flight = link_monitor._StoredFlight(Mock(), entry.id, link, session=session)
    flight = live._update_verdict(flight)
    assert live._finished_page == "Not judged yet: the log is being read."
    library.change(entry.id, headline="Too little margin.", level="watch")
    live._update_verdict(flight)
    assert live._finished_page == "Too little margin."
    assert [str(event.fact) for event in told] == ["Too little margin."]
    # The recording does not show that the link was lost for a while.
    session.status = replace(flown, link_outage=15.0)
    library.change(entry.id, headline="Nothing wrong found.", level="good")
    live._update_verdict(flight)
    assert live._finished_page == "The link was lost for 15 s in flight. Nothing wrong found."
    assert str(told[-1].fact) == live._finished_page and "antennas" in told[-1].fact.remedy


@mark.slow
def test_the_verdict_on_a_recording_waits_for_its_comparison_with_other_flights_and_has_its_fault(
    idle,
):
    """The log alone shows nothing wrong."""
    live, told = idle
    library = live._library
    path = library.new_incoming_path("a.tlog")
    path.write_bytes(b"a")
    entry = library.add(path, "a.tlog")
    library.change(entry.id, headline="Nothing wrong found.", level="good", vehicle="quad")
    weak = {"health": "fault", "health_reason": "Motor 1 lost thrust.", "suspect_motor": 1}
    row = flight_row("quad", 0, file=str(library.log_path(entry)), **weak)
    library.db.execute(
        "insert into logs (path, log, tracked) values (?, ?, 1)", [row.file, entry.digest]
    )
    # The motors are compared with those of another flight.
    for digest in (entry.digest, "of another log"):
        library.db.execute(
            "insert into flights (log, vehicle, file, row, brief) values (?, ?, ?, ?, ?)",
            [digest, "quad", row.file, '{"balance": [0, 0, 0]}', brief_json(row)],
        )
    flight = link_monitor._StoredFlight(Mock(), entry.id, PageLink("a.tlog", "/f/abc"))
    flight = live._update_verdict(flight)
    assert flight.is_unjudged and told == []
    library.db.execute("update flights set judged = ''")
    verdict = live._update_verdict(flight).verdict
    assert (verdict.is_bad, str(verdict)) == (True, "Motor 1 lost thrust.")
    assert verdict.figures["levels"]["motors"] == "bad"
    assert [str(event.fact) for event in told] == ["Motor 1 lost thrust."]


def _warning_in(status):
    """Returns the warning of a fault of an earlier flight in a status, with what to do; empty without one."""
    fault = status.unrepaired_fault
    return "" if fault is None else fault.sentence_and_remedy


@mark.slow
def test_a_fault_in_the_log_of_an_earlier_flight_stands_in_all_later_sessions(idle, monkeypatch):
    """So it does on the page and the terminal, but not of another one. What allows flight stands in the next."""
    live, told = idle
    monkeypatch.setattr(live_pages, "live_page", Mock(return_value=""))
    entries = {
        entry_id: LibraryEntry(entry_id, "a.tlog", level=level, headline=headline, next_step=step)
        for entry_id, level, headline, step in (
            ("crash", "bad", "Motor 3 lost thrust.", "Do not fly before motor 3 is inspected."),
            ("gain", "bad", "Too little margin.", "Lower the gain."),
            ("sound", "good", "Nothing is wrong.", ""),
            ("unclear", "unknown", "Too little was checked.", ""),
        )
    }
    monkeypatch.setattr(live._library, "entry", entries.__getitem__)
    monkeypatch.setattr(
        live, "_add_to_library", lambda path, _: replace(entries[path], name="a.tlog")
    )
    copter = Component(1, 1)
    copter.autopilot, copter.vehicle_type = "ARDUPILOTMEGA", "QUADROTOR"
    px4 = Component(1, 1)
    px4.autopilot, px4.vehicle_type = "PX4", "QUADROTOR"
    session = Mock(status=SessionStatus("1:1", is_flying=True))
    session.history.events = []

    def fault_in_flight_of(vehicle):
        session.stream.followed_vehicle = vehicle
        live._update_time = -inf
        live._watch_session(session)
        (shown,) = live._report_status.call_args.args
        assert live_pages.live_page.call_args.args[3] == shown
        return _warning_in(shown)

    session.stream.followed_vehicle = copter
    live._store_recording(session, Mock(path="gain"))
    # Only the ids tell that it is the same vehicle.
    allowed = (
        "In an earlier flight of a vehicle with this system id, too little margin. "
        "If it is this vehicle and that was not repaired, land soon."
    )
    assert fault_in_flight_of(copter) == allowed
    live._store_recording(session, Mock(path="sound"))
    assert not fault_in_flight_of(copter)
    fault = (
        "In an earlier flight of a vehicle with this system id, motor 3 lost thrust. "
        "If it is this vehicle and that was not repaired, land."
    )
    for name in ("crash", "unclear", "gain"):
        session.stream.followed_vehicle = copter
        live._store_recording(session, Mock(path=name))
        assert fault_in_flight_of(copter) == fault
        # Another vehicle with the same ids has not had that fault.
        assert not fault_in_flight_of(px4)
    assert [flight.entry_id for flight in live._earlier_stored_flights] == ["crash"]
    # A flight whose log has no name may be of another vehicle with the same ids: it clears no fault.
    session.stream.followed_vehicle = copter
    for name in ("sound", "unclear"):
        live._store_recording(session, Mock(path=name))
        assert fault_in_flight_of(copter) == fault
    # It stands until a user says that it was repaired; another fault stays.
    entries["wreck"] = replace(entries["crash"], id="wreck", headline="Motor 1 lost thrust.")
    live._store_recording(session, Mock(path="wreck"))
    entries["wreck"] = replace(entries["wreck"], repaired="2026-11-28T10:00:00+00:00")
    assert fault_in_flight_of(copter) == fault
    entries["crash"] = replace(entries["crash"], repaired="2026-11-28T10:00:00+00:00")
    assert not fault_in_flight_of(copter)
    # That can be taken back.
    entries["crash"] = replace(entries["crash"], repaired="")
    assert fault_in_flight_of(copter) == fault
    # A name by which logs are recognised makes it certain.
    live._earlier_stored_flights.clear()
    session.status = replace(session.status, state=VehicleState(name_in_logs="quad"))
    session.stream.followed_vehicle = copter
    live._store_recording(session, Mock(path="crash"))
    certain = "In an earlier flight, motor 3 lost thrust. If that was not repaired, land."
    assert fault_in_flight_of(copter) == certain
    # It stands until a whole flight of the vehicle was judged good, and does not come back.
    for name in ("sound", "unclear"):
        live._store_recording(session, Mock(path=name))
        assert not fault_in_flight_of(copter)
    live._store_recording(session, Mock(path="crash"))
    assert fault_in_flight_of(copter) == certain
    live._store_recording(session, Mock(path="sound"))
    assert live_pages.live_page.call_args.args[3].fault_in_library is None
    live._store_recording(session, Mock(path="crash"))
    session.status = replace(session.status, state=VehicleState(name_in_logs="other"))
    assert fault_in_flight_of(copter) == fault
    # The verdict on a flight that is over is no second alarm.
    assert told and not any(event.is_alarm for event in told)


@mark.slow
def test_a_fault_of_the_latest_flight_stands_after_a_restart_of_the_server(idle):
    """The library has it of the same vehicle, by its name, autopilot and frame; it is named as one of that flight."""
    live, told = idle
    library = live._library
    path = library.new_incoming_path("a.tlog")
    path.write_bytes(b"a")
    entry = library.add(path, "2026-11-28_09-15-00.tlog")
    fault = {"headline": "Motor 3 lost thrust.", "next_step": "Do not fly before it is inspected."}
    vehicle = {"vehicle": "quad", "autopilot": "PX4", "frame": "QUADROTOR"}
    library.change(entry.id, level="bad", date="2026-11-28T09:15:00+00:00", **fault, **vehicle)
    copter = Component(1, 1)
    copter.vehicle_type = "QUADROTOR"

    def shown_status(autopilot, name, is_named=True, **status):
        copter.autopilot = autopilot
        session = Mock()
        session.stream.followed_vehicle = copter
        state = VehicleState(
            library_name=name,
            name_in_logs=name if is_named else "",
            autopilot=autopilot,
            system=1,
        )
        session.status = replace(SessionStatus("1:1", state=state), **status)
        return live._shown_status(session)

    def next_step(autopilot, name, is_named=True):
        status = shown_status(autopilot, name, is_named, is_flying=True, flight_number=1)
        return status.session_judgement.next_step

    # The server judges it some time after its start, perhaps when the vehicle flies again.
    library.change(entry.id, level="")
    assert "repaired" not in str(next_step("PX4", "quad"))
    library.change(entry.id, level="bad")
    step = next_step("PX4", "quad")
    assert str(step) == "Land unless the earlier fault was repaired."
    hover_first = Fact(NextStep.HOVER_FIRST, reason=None)
    assert str(step.replace(next_step=hover_first)).endswith("repaired. If it was, hover.")
    assert step.figures["reason"].figures["reason"].figures["address"] == f"/f/{entry.id}"
    # Nobody is asked to take off before that: on the ground the fault is the headline.
    waiting = shown_status("PX4", "quad", no_model_reason=Fact(SessionFact.NOT_FLYING))
    landed = replace(waiting, flight_number=1)
    for status in (waiting, landed, replace(landed, is_over=True)):
        assert status.session_judgement.headline.level is Level.WATCH
        stated_fault, step, advice, *further = live_page._live_summary(status, None)
        assert stated_fault.lead == "Earlier flight (2026-11-28 09:15 UTC): motor 3 lost thrust."
        # No card repeats the headline; the button that says so names the flight.
        head = live_page._live_head(LiveHistory(), status, [], None)
        assert head.unrepaired_fault == ""
        flight = "the flight of 2026-11-28 09:15 UTC"
        assert head.statement_of_repair == f"The vehicle was repaired or inspected after {flight}"
        assert step.text == "Do not fly before it is inspected."
        assert step.address == f"/f/{entry.id}"
        assert advice.text == "Not needed if that was done since."
        # What is known of the flight that has ended since.
        own_verdict = verdict_on_present_flight(status)
        assert "".join(sentence.text for sentence in further) == own_verdict
        assert own_verdict.startswith("This flight: ") is (status.flight_number > 0)
    details = "Motor 3 lost 18 to 40 % of its thrust at 26 s (probability > 0.99): it works harder."
    stated = waiting.unrepaired_fault.figures["reason"].replace(headline=details)
    assert headline_text(waiting.unrepaired_fault.replace(reason=stated)) == (
        "Earlier flight (2026-11-28 09:15 UTC): motor 3 lost 18 to 40 % of its thrust at 26 s."
    )
    # What showed it stands beside its flight, and not below the lights of this one.
    explained = waiting.session_judgement.headline.replace(reason=stated)
    assert headline_reason(replace(waiting.session_judgement, headline=explained)) == []
    of_motor = {"motor": 3, "light_sentences": json.dumps({"motors": fault["headline"]})}
    library.change(entry.id, **of_motor)
    fault_of_motor = shown_status("PX4", "quad").unrepaired_fault
    assert (
        statement_of_repair(fault_of_motor) == f"Motor 3 was repaired or inspected after {flight}"
    )
    # Where only its system id is known, the flight may be of another vehicle.
    doubtful_step = next_step("PX4", "quad", is_named=False)
    assert "of a vehicle with this system id" in str(doubtful_step.figures["reason"])
    assert str(doubtful_step).startswith(
        "Land unless the earlier fault was repaired, or another vehicle flew then."
    )
    for autopilot, name in (("ARDUPILOTMEGA", "copter"), ("PX4", "other"), ("PX4", "")):
        assert "repaired" not in str(next_step(autopilot, name))
    # A fault with which the vehicle may fly counts in the next flight.
    library.change(entry.id, headline="Too little margin.", next_step="Lower the gain.")
    assert str(next_step("PX4", "quad")).startswith("Land soon unless the earlier fault")
    # It is no news, and the verdict on it none of this server.
    assert told == []
    # It was stored without parameters, under its system id, and has its name only now.
    library.change(entry.id, vehicle="px4-1")
    stored_without_name = next_step("PX4", "calibrated").figures["reason"]
    assert "of a vehicle with this system id" in str(stored_without_name)
    # A user has said since that it was repaired.
    library.state_repair(library.entry(entry.id), is_repaired=True)
    assert "repaired" not in str(next_step("PX4", "calibrated"))
    # The flight that the page shows is not in the library yet.
    before = link_monitor._link_to_latest_recording(library)
    assert (before.name, before.address) == ("Previous flight", f"/f/{entry.id}")


def test_the_last_page_of_the_server_has_the_fault_of_an_earlier_flight(idle, monkeypatch):
    """The next start of the server shows it again; until then browsers keep this page."""
    live, _ = idle
    finished_page = Mock(return_value="")
    monkeypatch.setattr(link_monitor, "_finished_page", finished_page)
    fault = Fact(SessionFact.FLIGHT_END_UNKNOWN, reason=None)
    monkeypatch.setattr(live, "_fault_of_earlier_flight", Mock(return_value=fault))
    session = Mock(status=SessionStatus("1:1"))
    session.history.events = []
    live._render_last_page(session)
    assert finished_page.call_args.args[-1] == fault


def test_the_next_flight_names_a_flight_whose_end_was_not_received(idle, monkeypatch):
    """A recording that ends in the air is only to be watched, and says nothing about how the vehicle came down."""
    live, _ = idle
    entry = LibraryEntry("lost", "a.tlog", level="watch", headline="The log ends in the air.")
    monkeypatch.setattr(live._library, "entry", lambda entry_id: replace(entry, id=entry_id))
    monkeypatch.setattr(
        live, "_add_to_library", lambda path, _: replace(entry, id=path, name="a.tlog")
    )
    copter = Component(1, 1)
    silent = Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MESSAGES, duration=3.0)
    lost = SessionStatus("1:1", is_flying=True, message_age=700.0, no_model_reason=silent)
    landed = SessionStatus("1:1", flight_number=1)

    def fault_after(path, status):
        session = Mock(status=status)
        session.history.events = []
        session.stream.followed_vehicle = copter
        live._store_recording(session, Mock(path=path))
        session.status = SessionStatus("1:1", is_flying=True, flight_number=1)
        return _warning_in(live._shown_status(session))

    monkeypatch.setattr(link_monitor, "_finished_page", Mock(return_value=""))
    assert fault_after("lost", lost) == (
        "The end of the flight before was not received. "
        "If the vehicle was not inspected since, land."
    )
    # A flight that ended on the ground takes its place.
    assert not fault_after("landed", landed)


@mark.slow
def test_the_status_of_a_link_that_waits_is_not_reported_after_a_flight(idle, monkeypatch):
    """The last line on a terminal would be to check the link, in the place of not to fly."""
    live, _ = idle
    monkeypatch.setattr(live_pages, "live_page", Mock(return_value=""))
    waiting = SessionStatus(no_model_reason=Fact(RowsFact.NOTHING_RECEIVED, subject="messages"))
    session = Mock(status=waiting)
    session.history.events = []
    session.stream.followed_vehicle = None
    session.intake.recording.frame_count = 0
    live._finished_page = "flight"
    live._watch_session(session)
    assert live.page.html == "flight" and not live._report_status.called
    session.status = SessionStatus("1:1", is_flying=True)
    live._update_time = -inf
    live._watch_session(session)
    assert live._report_status.called


def test_the_list_of_flights_says_which_vehicle_the_session_has_and_what_it_does(idle, monkeypatch):
    live, _ = idle
    monkeypatch.setattr(live_pages, "live_page", Mock(return_value=""))
    session = Mock()
    session.history.events = []
    session.link.name = "udpin:127.0.0.1:14550"
    state = VehicleState("Loiter", is_armed=True, voltage=15.84, system=1, autopilot="PX4")
    session.status = SessionStatus("1:1", is_flying=True, state=state, message_age=0.1)
    live._render_page(session)
    assert live.summary == "Vehicle, PX4, vehicle 1: mode Loiter, in flight, battery 15.8 V."


def test_the_terminal_has_the_events_of_a_session_its_status_and_where_the_flight_is_saved(idle):
    live, told = idle
    alarm = HappenedEvent(
        4.0, Fact(ReportedEvent.BATTERY_ALARMED, Level.BAD), reception=1e9, clock=4.0
    )
    silence = HappenedEvent(9.0, Fact(RowsFact.NOTHING_RECEIVED, subject="messages", duration=2.0))
    back = HappenedEvent(12.0, Fact(RowsFact.MESSAGES_RESUMED, subject="messages", duration=5.0))
    for event in (alarm, silence, back):
        live._take_event(event)
    live._report_saved_flight("/f/abc")
    assert told[:3] == [alarm, silence, back]
    (saved,) = told[3:]
    assert saved.sentence == "Flight saved: http://127.0.0.1:8600/f/abc"
    assert moment_text(saved).count(":") == 2
    full_disk = HappenedEvent(1.0, Fact(LinkFact.STREAM_RECORDING_ENDED, error="no space"))
    with raises(OSError, match="no space"):
        live._take_event(full_disk)


def test_a_vehicle_in_flight_is_watched_until_its_landing_without_a_recording(idle, monkeypatch):
    live, told = idle
    session = Mock(status=SessionStatus())
    session.stream.followed_vehicle.frame_count = 100
    monkeypatch.setattr(live, "_render_page", Mock())
    monkeypatch.setattr(
        live._library, "check_space", Mock(side_effect=Refusal(RefusalReason.DISK_FULL))
    )
    with raises(Refusal):
        live._update_page(session)
    live._take_event(HappenedEvent(1.0, Fact(ReportedEvent.OFF_GROUND)))
    live._update_page(session)
    assert session.intake.stop_recording.called
    live._take_event(HappenedEvent(2.0, Fact(LinkFact.STREAM_RECORDING_ENDED, error="no space")))
    assert told[-1].fact.code is LinkFact.STREAM_RECORDING_ENDED and not live._is_over()
    live._take_event(HappenedEvent(3.0, Fact(ReportedEvent.ON_GROUND)))
    assert live._is_over() and isinstance(live._recording_problem, Refusal)


@mark.parametrize("code", [RowsFact.NO_LIVE_ATTITUDE, RowsFact.LIVE_RATES_TOO_LOW])
def test_the_page_of_a_server_advises_an_option_that_the_server_has(idle, monkeypatch, code):
    live, _ = idle
    slow = Fact(code, can_ask=True, reason=Fact(RowsFact.NO_LIVE_MOTORS))
    assert slow.remedy == "Ask for more with `--request-rate 100`."
    monkeypatch.setattr(live_pages, "live_page", lambda *_, **__: slow.remedy)
    session = Mock(status=SessionStatus())
    session.history.events = []
    session.stream.followed_vehicle = None
    session.intake.recording.frame_count = 0
    live._update_page(session)
    assert "Start this server with `--request-rate 100`" in live.page.html
    assert "--request-rate" in {name for option in serve_command.params for name in option.opts}


@mark.slow
@mark.parametrize("fails", ["add", "close"])
def test_a_full_disk_ends_the_session_and_says_so(tmp_path, monkeypatch, heard, fails):
    """The disk is full when a frame is recorded, or when the recording is closed.

    Terminal and page say so, and earlier frames are kept.
    """
    begin, library, warned, come = heard
    does = getattr(RawRecording, fails)

    def full(recording, *given):
        # A recording without an attitude, which comes after the parameters of the vehicle, would not be kept.
        if recording.frame_count > 1900 or fails == "close":
            raise OSError(errno.ENOSPC, "No space left on device")
        does(recording, *given)

    monkeypatch.setattr(RawRecording, fails, full)
    live = begin()
    until(lambda: warned)
    assert warned[0].code is RefusalReason.SESSION_FAILED
    assert "not watched" in warned[0].sentence and "No space left on device." in warned[0].sentence
    assert come and library.find("1", [], 10)[1] == 1
    monkeypatch.setattr(live, "start", lambda: None)
    with serving(tmp_path / "other", monitor=live) as server:
        answer = server.get("/live")
        assert answer.status == 503 and "No space left" in answer.text
        assert "No space left" in server.get("/").text


@mark.slow
def test_what_the_socket_holds_when_the_server_ends_is_recorded(tmp_path, monkeypatch):
    """Frames that arrived, but were not processed yet, are recorded at the end."""
    has_begun = Event()

    def wait_for_the_end(session, is_over, *_):
        has_begun.set()
        until(is_over)

    monkeypatch.setattr(live_pages, "live_page", Mock(return_value=""))
    monkeypatch.setattr(link_monitor, "run_session", wait_for_the_end)
    library = Library(tmp_path)
    port = free_port()
    live = LinkMonitor(f"udpin:127.0.0.1:{port}", library, Mock(), Mock(), Mock(), Mock())
    live.start()
    assert has_begun.wait(PATIENCE)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        for first in range(0, len(FRAMES), 1000):
            vehicle.sendto(FRAMES[first : first + 1000], ("127.0.0.1", port))
    live.stop()
    (entry,), _ = library.find("1", [], 10)
    path = tmp_path / "sent.tlog"
    path.write_bytes(FRAMES)
    assert read_log(library.log_path(entry)).frames >= read_log(path).frames - 1


@mark.slow
def test_the_flight_of_a_silent_vehicle_is_saved_and_the_one_that_sends_is_followed(
    idle, monkeypatch
):
    """The next session follows vehicle 2, and the one after that any vehicle."""
    live, told = idle
    wanted = []

    def fly(session, is_over, *_):
        wanted.append(session.stream.status().no_model_reason.subject)
        assert not is_over()
        if len(wanted) == 1:
            session.intake.recording.add(1e9, session.stream.frame_reader.feed(FRAMES))
            session.successor = Component(2, 1)
            session._milestone_reporter.update(
                session.flight.learning, SessionStatus(is_flying=True), 5.0
            )
            assert is_over()

    monkeypatch.setattr(live_pages, "live_page", Mock(return_value=""))
    monkeypatch.setattr(link_monitor, "run_session", fly)
    for _ in range(3):
        live._run_one_session(None)
    assert wanted == ["", "2:1", ""]
    assert [event.fact.code for event in told] == [
        SessionFact.FLIGHT_LEARNED,
        LinkFact.FLIGHT_SAVED,
    ]
    _, found = live._library.find("1", [], 10)
    assert found == 1


def test_only_the_vehicle_that_was_chosen_is_followed(idle, monkeypatch):
    live, _ = idle
    live._chosen_vehicle = "4:1"
    sessions = []
    monkeypatch.setattr(live_pages, "live_page", Mock(return_value=""))
    monkeypatch.setattr(link_monitor, "run_session", lambda session, *_: sessions.append(session))
    live._run_one_session(None)
    [session] = sessions
    assert session.stream.status().no_model_reason.subject == "4:1" and session._keeps_vehicle


@mark.slow
@mark.parametrize("end", ["in the session", "after the session", "no file", "no move"])
def test_no_recorded_frame_of_the_next_vehicle_is_lost_when_the_server_ends(idle, monkeypatch, end):
    """Nor where the next recording cannot be created."""
    live, _ = idle

    def fly(session, is_over, *_):
        if is_over():
            return
        record_take_over(session)
        if end == "in the session":
            live._is_stopping.set()
        elif end == "no file":
            monkeypatch.setattr(link_monitor, "RawRecording", Mock(side_effect=OSError))
        elif end == "no move":
            monkeypatch.setattr(RawRecording, "move_after", Mock(side_effect=OSError))

    monkeypatch.setattr(live_pages, "live_page", Mock(return_value=""))
    monkeypatch.setattr(link_monitor, "run_session", fly)
    # A take-over takes longer than the second by which recordings are named.
    numbers = count()
    monkeypatch.setattr(link_monitor, "_recording_name", lambda _: f"{next(numbers)}.tlog")
    live._log_added = live._is_stopping.set
    live._run_sessions()
    entries, _ = live._library.find("1", [], 10)
    systems = [systems_in(live._library.log_path(entry)) for entry in entries]
    assert sorted(map(sorted, systems)) == ([[1], [2]] if end == "after the session" else [[1, 2]])
    assert not [*live._library.new_incoming_path("f.tlog").parent.iterdir()]


@mark.slow
@mark.parametrize("sender, is_stored", [(GROUND_STATION, False), (FRAMES, True)])
def test_packets_without_a_vehicle_leave_no_log(idle, monkeypatch, sender, is_stored):
    """A ground station sends its HEARTBEAT; no vehicle is there to be judged."""
    live, _ = idle

    def receive(session, *_):
        session.intake.recording.add(1.7e9, FrameReader().feed(sender))

    monkeypatch.setattr(live_pages, "live_page", Mock(return_value=""))
    monkeypatch.setattr(link_monitor, "run_session", receive)
    live._run_one_session(None)
    entries, _ = live._library.find("1", [], 10)
    assert len(entries) == is_stored and not live._incoming.path.exists()


@mark.slow
@mark.parametrize(
    "before, after, is_new_flight",
    [
        (ReportedEvent.ON_GROUND, [], True),
        (ReportedEvent.OFF_GROUND, [], False),
        (ReportedEvent.OFF_GROUND, [ReportedEvent.OFF_GROUND], True),
        (ReportedEvent.OFF_GROUND, [ReportedEvent.ON_GROUND, ReportedEvent.OFF_GROUND], False),
    ],
    ids=[
        "landed",
        "flies on",
        "link lost in the air",
        "flies on, lands and bounces",
    ],
)
def test_each_flight_of_a_vehicle_that_restarts_is_a_log(
    idle, monkeypatch, before, after, is_new_flight
):
    """A restart in the air is one flight, unless another take-off is seen after it."""
    live, _ = idle
    vehicles = []

    def fly(session, is_over, *_):
        """Feeds the first session a flight, a restart of the vehicle and another flight. Ends any later one at once."""
        vehicles.append(session.stream.status().no_model_reason.subject)
        if len(vehicles) > 1:
            return
        # The restart takes three seconds, and the clock goes back to zero.
        reader = session.stream.frame_reader
        for start, first_time in ((1.7e9, 100.0), (1.7e9 + 4.0, 0.1)):
            for number in range(9):
                time = first_time + number / 10
                sent = [heartbeat(), *flight([time], sequence=2 * number)]
                stamp = start + number / 10
                frames = reader.feed(b"".join(sent))
                session.intake.recording.add(stamp, frames)
                list(session.stream.process_frames(stamp, frames))
        assert session.stream.boot == 1
        live._take_event(HappenedEvent(90.0, Fact(before)))
        live._take_event(HappenedEvent(1.0, Fact(VehicleFact.VEHICLE_REBOOTED, clock=100.2)))
        for reported_event in after:
            assert not is_over()
            live._take_event(HappenedEvent(4.0, Fact(reported_event)))
        assert is_over() is is_new_flight

    monkeypatch.setattr(live_pages, "live_page", Mock(return_value=""))
    monkeypatch.setattr(link_monitor, "run_session", fly)
    numbers = count()
    monkeypatch.setattr(link_monitor, "_recording_name", lambda _: f"{next(numbers)}.tlog")
    for _ in range(2):
        live._run_one_session(None)
    entries, _ = live._library.find("1", [], 10)
    assert vehicles == ["", "1:1" if is_new_flight else ""]
    attitudes = []
    for entry in entries:
        (vehicle,) = read_log(live._library.log_path(entry)).vehicles
        attitudes.append(len(vehicle.messages["ATTITUDE"]["time"]))
    assert sorted(attitudes) == ([9, 9] if is_new_flight else [18])


@mark.parametrize(
    "reason, is_next_flight",
    [(SessionFact.NOT_FLYING, True), (RowsFact.RATES_BEING_MEASURED, False)],
    ids=["on the ground", "not known yet"],
)
def test_a_vehicle_that_is_armed_on_the_ground_after_it_was_lost_in_the_air_begins_a_flight(
    idle, reason, is_next_flight
):
    """Its take-off need not be awaited, and an autopilot that arms itself after a reset in the air flies on."""
    live, _ = idle
    on_ground = SessionStatus("1:1", Fact(reason))
    for code in (ReportedEvent.OFF_GROUND, VehicleFact.VEHICLE_REBOOTED):
        live._take_event(HappenedEvent(1.0, Fact(code, clock=90.0)))
    live._flight.note_status(on_ground)
    assert not live._flight.has_restarted
    live._take_event(HappenedEvent(2.3, Fact(ReportedEvent.MOTORS_ARMED)))
    live._flight.note_status(on_ground)
    assert live._flight.has_restarted is is_next_flight


@mark.skipif(not hasattr(signal, "SIGHUP"), reason="there are no terminals that hang up")
def test_a_closed_terminal_ends_the_server_in_order():
    former = signal.getsignal(signal.SIGHUP)
    server = Mock()
    try:
        # Programs that nohup starts ignore the signal.
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        end_by_all_signals(server)
        signal.raise_signal(signal.SIGHUP)
        [(number, _)] = [call.args for call in server.handle_exit.call_args_list]
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        end_by_all_signals(server)
        assert number == signal.SIGHUP and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, former)
