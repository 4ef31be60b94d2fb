"""The server of a live session: its page, and the dashboard in Rerun's viewer, which asks nothing of other machines."""

import re
import socket
import threading
from contextlib import contextmanager
from dataclasses import replace
from http.client import HTTPConnection
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from unittest.mock import Mock, PropertyMock

from patience import until
from pytest import fixture, mark

from mavdem.errors import Refusal
from mavdem.facts import Fact, Level
from mavdem.facts.ending import MotionEvent
from mavdem.facts.event import Event
from mavdem.facts.serve import RefusalReason
from mavdem.facts.session import TimeUse, VehicleFact
from mavdem.live import clock
from mavdem.live.history import LiveHistory
from mavdem.live.session_status import SessionStatus
from mavdem.motors.motor_changes import MotorChange
from mavdem.serve.guard import POLICY_HEADER
from mavdem.serve.live_pages import PAGE_SECONDS, SessionPage
from mavdem.serve.live_server import LiveServer
from mavdem.serve.rights import Rights

LINK = "udpin:127.0.0.1:14550"
VIEWER_SCRIPT = b"""
let wasm_bindgen = async ({ module_or_path }) => {
  window.program_bytes = (await module_or_path.arrayBuffer()).byteLength;
};
wasm_bindgen.WebHandle = class {
  constructor(options) { window.viewer_options = options; }
  async start(canvas) { window.report = fetch("https://tel.rerun.io/").catch(() => "forbidden"); }
  has_panicked() { return false; }
};
"""
"""Stands in for the script of Rerun's viewer; like that, it tries to report its use."""
PROGRAM_BYTES = 3_000_000
PROGRAM = {"re_viewer.js": VIEWER_SCRIPT, "re_viewer_bg.wasm": bytes(PROGRAM_BYTES)}


class ProgramRequest(BaseHTTPRequestHandler):
    """A request to what stands in for the process of Rerun's viewer; as there, the length has a header of its own."""

    def do_GET(self):
        content = PROGRAM[self.path.strip("/")]
        self.send_response(200)
        self.send_header("rerun-final-length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_):
        pass


@fixture(autouse=True)
def short_waits(monkeypatch):
    """What a page asks for is answered sooner than usual: so pages may hurry, and a server ends sooner."""
    monkeypatch.setattr("mavdem.serve.live_pages.MAX_UPDATE_WAIT", 0.5)


@fixture
def viewer():
    """What stands in for the process of Rerun's viewer."""
    process = ThreadingHTTPServer(("127.0.0.1", 0), ProgramRequest)
    threading.Thread(target=process.serve_forever, daemon=True).start()
    yield Mock(url="rerun+http://127.0.0.1:9/proxy", port=9, page_port=process.server_port)
    process.shutdown()
    process.server_close()


@contextmanager
def live_server(viewer=None, rights=None):
    """A running server, at any free port."""
    server = LiveServer(LINK, "127.0.0.1", 0, rights or Rights(), viewer)
    try:
        yield server
    finally:
        server.close()


def flying_session():
    """A session whose vehicle flies, without anything learned."""
    session = Mock(history=LiveHistory())
    session.link.name = LINK
    session.stream.axis = "roll"
    session.time_account.return_value = dict.fromkeys(TimeUse, 0.0)
    session.successor = None
    return session


STATUS = SessionStatus("1:1", is_flying=True, message_age=0.0)


def answer(server, path, **headers):
    """The answer of a server: status, headers and text; other pages are not followed."""
    connection = HTTPConnection("127.0.0.1", int(server.address.rpartition(":")[2]))
    connection.request("GET", path, headers=headers)
    response = connection.getresponse()
    return response.status, response.headers, response.read()


@mark.slow
def test_the_address_leads_to_a_page_that_is_made_again_when_it_is_old_or_lacks_an_event(
    monkeypatch,
):
    """The page is rendered for the first status, after an event, and when it is old."""
    session = flying_session()
    now = clock.monotonic()
    # Rendering takes no time.
    monkeypatch.setattr(clock, "monotonic", lambda: now)
    with live_server() as server:
        assert answer(server, "/")[1]["Location"] == "/live"
        server.report(session, STATUS)
        first_page = server.page
        assert answer(server, "/live")[2].decode() == first_page.html
        server.report(session, STATUS)
        assert server.page is first_page
        reboot = Fact(VehicleFact.VEHICLE_REBOOTED, time=4.0, clock=4.0)
        session.history.add_event(Event(4.0, reboot, reception=0.0))
        server.report(session, STATUS)
        second_page = server.page
        assert second_page.html != first_page.html
        server.page = SessionPage(second_page.html, clock.monotonic() - PAGE_SECONDS)
        server.report(session, STATUS)
        assert server.page.age < PAGE_SECONDS


def test_only_this_machine_is_answered_and_the_port_is_free_at_the_end():
    with live_server() as server:
        port = int(server.address.rpartition(":")[2])
        assert server.address == f"http://127.0.0.1:{port}"
        assert answer(server, "/live", Host="example.org")[0] == 403
    socket.create_server(("127.0.0.1", port)).close()
    assert not server._thread.is_alive()


@mark.slow
def test_with_a_token_the_link_that_is_printed_signs_a_browser_in_to_read(monkeypatch):
    delay = 0.2
    monkeypatch.setattr("mavdem.serve.rights.WRONG_TOKEN_DELAY", delay)
    rights = Rights("0123456789abcdef", is_local=False)
    with live_server(rights=rights) as server:
        server.report(flying_session(), STATUS)
        assert answer(server, "/live")[0] == answer(server, "/live/update")[0] == 401
        path = server.sign_in_link.removeprefix(server.address)
        assert rights.token not in path
        status, headers, _ = answer(server, path)
        assert (status, headers["Location"]) == (303, "/live")
        assert "HttpOnly" in headers["Set-Cookie"]
        cookie = headers["Set-Cookie"].partition(";")[0]
        assert answer(server, "/live", Cookie=cookie)[0] == 200
        started = clock.monotonic()
        status, headers, _ = answer(server, path[:-1] + ("0" if path[-1] != "0" else "1"))
        assert status in (401, 403) and "Set-Cookie" not in headers
        assert clock.monotonic() - started >= delay


@mark.slow
def test_without_rerun_there_is_the_page_alone():
    with live_server() as server:
        server.report(flying_session(), STATUS)
        assert "/dashboard" not in server.page.html
        status, _, text = answer(server, "/dashboard")
        assert status == 404 and b"Flights" not in text and b"openapi" not in text
        assert answer(server, "/rerun/re_viewer.js")[0] == 404


@mark.slow
def test_the_dashboard_names_the_vehicle_and_may_ask_nothing_of_other_machines(viewer):
    """The content security policy of the dashboard allows this computer only."""
    with live_server(viewer) as server:
        _, _, text = answer(server, "/dashboard")
        assert f"<title>{LINK} in Rerun</title>" in text.decode()
        server.report(flying_session(), STATUS)
        assert '<a href="/dashboard" class="on-wide-screen">' in server.page.html
        _, headers, text = answer(server, "/dashboard")
        page = text.decode()
    title = re.search("<h1>(.*?)</h1>", server.page.html)[1]
    assert f"<title>{title} in Rerun</title>" in page and title != LINK
    assert not re.search(r"https?://(?!127\.0\.0\.1)", page)
    policy = dict(part.strip().split(" ", 1) for part in headers[POLICY_HEADER].split(";"))
    assert policy["default-src"] == "'none'"
    assert policy["connect-src"] == "'self' http://127.0.0.1:9"
    assert policy["script-src"] == "'self' 'wasm-unsafe-eval'"


@mark.slow
def test_the_program_of_the_viewer_is_passed_on_as_its_process_sends_it(viewer):
    with live_server(viewer) as server:
        for name, content in PROGRAM.items():
            status, headers, text = answer(server, f"/rerun/{name}")
            assert status == 200 and text == content
            assert headers["Content-Length"] == str(len(content))
        assert headers["Content-Type"] == "application/wasm"
        assert answer(server, "/rerun/..%2Flive")[0] == 404
        with socket.create_server(("127.0.0.1", 0)) as gone:
            viewer.page_port = gone.getsockname()[1]
        assert answer(server, "/rerun/re_viewer.js")[0] == 503


@mark.slow
def test_rerun_has_the_program_by_these_names():
    from mavdem.machine import free_port
    from mavdem.view import WebServer

    viewer = WebServer(free_port(), free_port())
    try:
        with live_server(viewer) as server:
            until(lambda: answer(server, "/rerun/re_viewer.js")[0] == 200)
            _, headers, program = answer(server, "/rerun/re_viewer_bg.wasm")
        assert program.startswith(b"\0asm") and headers["Content-Length"] == str(len(program))
    finally:
        viewer.close()


@mark.slow
def test_a_browser_runs_the_viewer_on_a_wide_screen_and_cannot_report_its_use(viewer, browser):
    with live_server(viewer) as server, browser.tab() as tab:
        tab.size(1280)
        tab.open(f"{server.address}/dashboard")
        tab.until("window.report")
        assert tab.run("report") == "forbidden" and tab.run("program_bytes") == PROGRAM_BYTES
        assert tab.run("viewer_options.url") == [viewer.url]
        assert tab.run("viewer_options.theme") == "dark"
        tab.until("!document.getElementById('viewer_status').textContent")


@mark.slow
def test_the_headline_of_the_session_stands_above_its_dashboard_until_nothing_answers(
    viewer, browser
):
    """A browser shows the dashboard while a motor alarm begins, and then the server closes."""
    loss = MotorChange(58.0, 56.0, 2, "motor 2", 0.3, 0.99, loss=(0.2, 0.4))
    alarmed = replace(STATUS, motor_alarms=(loss,), motor_alarms_of_flight=(loss,))
    headline = "document.getElementById('session_headline')"
    with live_server(viewer) as server, browser.tab() as tab:
        server.report(flying_session(), STATUS)
        tab.size(1280)
        tab.open(f"{server.address}/dashboard")
        tab.until(f"{headline}.textContent")
        assert not tab.run(f"{headline}.classList.contains('bad')")
        server.page = SessionPage("", clock.monotonic())
        server.report(flying_session(), alarmed)
        tab.until(f"{headline}.textContent.includes('otor\\u00a02 lost 20 to 40')")
        assert tab.run(f"{headline}.classList.contains('bad')")
        assert "otor 2" in tab.run("document.title")
        assert tab.run("document.getElementById('silence').hidden")
        tab.hurry()
        server.close()
        tab.until("!document.getElementById('silence').hidden")


@mark.in_full
def test_a_dashboard_whose_session_is_not_shown_says_so_and_asks_once_a_second(viewer, browser):
    """The page of the session becomes old, recovers, and then fails.

    The browser shows the silence and asks about once a second, of a clock that runs faster.
    """
    silence = "document.getElementById('silence')"
    with live_server(viewer) as server, browser.tab() as tab:
        server.report(flying_session(), STATUS)
        tab.size(1280)
        tab.open(f"{server.address}/dashboard")
        tab.until("document.getElementById('session_headline').textContent")
        tab.hurry()
        tab.run("window.ask = window.fetch; window.requests = 0")
        tab.run("window.fetch = (...all) => { requests++; return ask(...all); }")
        # Nothing new is made, as if the session hung.
        server.page = SessionPage(server.page.html, clock.monotonic() - 20.0)
        tab.until(f"!{silence}.hidden")
        server.page = SessionPage(server.page.html, clock.monotonic())
        tab.until(f"{silence}.hidden")
        refused = Refusal(RefusalReason.NO_SUCH_FLIGHT)
        server.page = Mock(spec=SessionPage)
        type(server.page).tag = PropertyMock(side_effect=refused)
        tab.until(f"!{silence}.hidden")
        tab.run("requests = 0")
        tab.run("new Promise(passed => setTimeout(passed, 2500))")
        assert 1 <= tab.run("requests") <= 3 and not tab.run(f"{silence}.hidden")


@mark.in_full
def test_the_last_page_of_a_session_stays_without_a_warning_until_the_next_one(browser):
    session = flying_session()
    with live_server() as server, browser.tab() as tab:
        server.report(session, STATUS)
        tab.size(1280)
        tab.open(f"{server.address}/live")
        server.report(session, replace(STATUS, is_over=True))
        tab.until("document.querySelector('main').dataset.level === undefined")
        # Without a server, whose time runs fast here, the page says quietly when it was answered last.
        tab.hurry(20.0)
        tab.run("const ask = fetch")
        tab.run("fetch = (...request) => window.isBack ? ask(...request) : Promise.reject()")
        tab.until("document.getElementById('unanswered').textContent.includes('last answer')")
        assert tab.run("document.getElementById('unanswered').className") == "quiet"
        assert not tab.run("document.documentElement.classList.contains('unanswered')")
        # Once a session runs at this address, the page shows it.
        server.page = SessionPage("", clock.monotonic())
        server.report(session, STATUS)
        tab.run("window.isBack = true")
        tab.until("document.querySelector('main').dataset.level !== undefined")


def test_a_session_that_another_one_follows_goes_on_at_the_same_address():
    session = flying_session()
    with live_server() as server:
        for successor, goes_on in (("2:1", True), (None, False)):
            session.successor = successor
            server.report(session, replace(STATUS, is_over=True))
            assert ("<main data-level" in server.page.html) is goes_on
            assert ("This session ended in flight" in server.page.html) is not goes_on


@mark.slow
def test_the_last_page_says_that_nothing_is_watched_where_the_session_ended_in_flight():
    """It does so without files too; a lost vehicle that has met the ground no longer flies."""
    flying = replace(STATUS, is_flying=True, flight_number=1, is_over=True)
    crashed = replace(flying, ground_contact=Fact(MotionEvent.HIT, Level.BAD))
    with live_server() as server:
        for status, ended_in_flight in ((flying, True), (crashed, False)):
            server.report(flying_session(), status)
            page = server.page.html
            assert ("ended in flight: land by sight, no alarm" in page) is ended_in_flight
            assert ("This session is over." in page) is not ended_in_flight


@mark.in_full
def test_a_telephone_gets_the_page_and_loads_the_viewer_only_when_told_to(viewer, browser):
    with live_server(viewer) as server, browser.tab() as tab:
        server.report(flying_session(), STATUS)
        tab.size(390)
        tab.open(f"{server.address}/live")
        assert tab.run("getComputedStyle(document.querySelector('nav a')).display") == "none"
        tab.open(f"{server.address}/dashboard")
        tab.until("!document.getElementById('narrow').hidden")
        assert tab.run("document.querySelectorAll('#narrow a[href=\"/live\"]').length") == 1
        assert not tab.run("!!window.viewer_options")
        tab.run("document.getElementById('show_anyway').click()")
        tab.until("window.viewer_options")
        assert tab.run("document.getElementById('narrow').hidden")


@mark.slow
def test_a_viewer_that_cannot_start_says_why(viewer, browser):
    viewer.page_port = None
    with live_server(viewer) as server, browser.tab() as tab:
        tab.size(1280)
        tab.open(f"{server.address}/dashboard")
        tab.until("document.getElementById('viewer_status').classList.contains('bad')")
        told = tab.run("document.getElementById('viewer_status').textContent")
        assert told.startswith("The dashboard cannot be shown: mavdem does not answer.")


def test_pages_of_a_vehicle_that_reports_events_without_end_leave_time_for_its_messages(
    monkeypatch,
):
    session = flying_session()
    now = clock.monotonic()
    monkeypatch.setattr(clock, "monotonic", lambda: now)
    page = SessionPage.made_now("page", session, STATUS, start_time=now - 0.1)
    session.history.add_event(Event(4.0, Fact(VehicleFact.NO_VEHICLE_YET), reception=0.0))
    assert not replace(page, made_time=now).is_outdated(session)
    assert replace(page, made_time=now - 1.0).is_outdated(session)
