"""The page of a live session in Chromium: it takes over what is new, keeps its place, and says when nothing comes."""

from dataclasses import replace

from live_rows import add_flight
from pytest import MonkeyPatch, approx, fixture, mark
from serving import serving

from mavdem.facts import Fact, Level
from mavdem.facts.event import Event
from mavdem.facts.lights import Light
from mavdem.facts.motors import MotorWatchFact
from mavdem.facts.session import RowsFact, SessionFact, TimeUse, VehicleFact
from mavdem.facts.watch import WatchFact
from mavdem.live import clock
from mavdem.live.history import LiveHistory
from mavdem.live.session_status import SessionStatus
from mavdem.live.vehicle_state import VehicleState
from mavdem.report.pages.live_page import live_page
from mavdem.report.pages.page_link import PageLink
from mavdem.serve.live_pages import SessionPage

pytestmark = mark.slow

FLIGHT = "document.documentElement.charts.groups.flight"
HEADLINE = "document.querySelector('.headline').innerText"
LOUD_LINE = "(document.querySelector('#unanswered:not([hidden])')?.innerText ?? '')"


class Session:
    """A session whose vehicle flies some seconds when it is told to, in the place of the monitor of a link."""

    def begin(self):
        """Begins a session, whose vehicle has flown for four seconds."""
        self.history = LiveHistory()
        self.end = 100.0
        self.saved_flight = None
        self.fly(4.0)

    def start(self):
        pass

    def stop(self):
        pass

    def fly(self, seconds):
        """Adds some seconds of flight, at whose end the vehicle reboots, and makes a page of it."""
        add_flight(self.history, seconds, start=self.end)
        self.end += seconds
        reboot = Fact(VehicleFact.VEHICLE_REBOOTED, time=self.end, clock=self.end)
        self.history.add_event(Event(self.end, reboot, reception=0.0))
        self.show(SessionStatus("1:1", is_flying=True, message_age=0.0))

    def weaken(self, motor):
        """Reports that a motor has lost thrust, and makes a page of that."""
        weak = Fact(
            MotorWatchFact.MOTOR_LOST_THRUST,
            Level.BAD,
            time=self.end,
            subject=f"motor {motor} (front right)",
            loss=(0.1, 0.2),
            rise=0.2,
            probability=0.999,
            assumed=False,
            boot=0,
        )
        self.history.add_event(Event(self.end, weak, reception=0.0))
        alarmed = {"active_alarms": (weak,), "worst_lights": {Light.MOTORS: weak}}
        self.show(SessionStatus("1:1", is_flying=True, message_age=0.0, **alarmed))

    def show(self, status):
        """Makes the page of a status."""
        account = dict.fromkeys(TimeUse, 0.0)
        html = live_page(
            "udp",
            "roll",
            self.history,
            status,
            account,
            None,
            saved_flight=self.saved_flight,
            refresh_seconds=5.0,
        )
        self.page = SessionPage(html, clock.monotonic())


UPDATE_WAIT = 0.5
"""Seconds for which the server waits for something new, fewer than usual, so that pages may hurry."""


@fixture(scope="module")
def monitor():
    """What the server shows: one session after the other."""
    return Session()


@fixture(scope="module")
def server(tmp_path_factory, monitor):
    """A server, which all tests share: its end waits a second for the requests of pages that were open."""
    folder = tmp_path_factory.mktemp("library")
    with MonkeyPatch.context() as patch, serving(folder, monitor=monitor) as server:
        patch.setattr("mavdem.serve.live_pages.MAX_UPDATE_WAIT", UPDATE_WAIT)
        yield server


@fixture
def session(monitor):
    """A session that has just begun."""
    monitor.begin()
    return monitor


@fixture
def tab(server, browser, session):
    """A tab with the page of the session."""
    with browser.tab() as tab:
        tab.size(1280)
        tab.open(f"{server.address}/live")
        tab.until(FLIGHT)
        yield tab


READ = """(() => {
  const { groups, setCursor, zoom } = document.documentElement.charts;
  window.isSamePage = true;
  document.querySelector("#prediction-of-roll-and-the-link details").open = true;
  document.querySelector("[data-light=power]").focus();
  zoom(groups.flight, 101, 103);
  return new Promise(drawn => setTimeout(() => {
    setCursor(groups.flight, 102);
    scrollTo(0, 250);
    drawn();
  }, 50));
})()"""
PLACE = """(flight => ({
  isSamePage: window.isSamePage,
  scroll: scrollY,
  span: flight.span,
  light: document.activeElement.dataset.light,
  isOpen: document.querySelector("#prediction-of-roll-and-the-link details").open,
  cursor: Math.round(10 * flight.charts[0].posToVal(flight.charts[0].cursor.left, "x")) / 10,
}))(document.documentElement.charts.groups.flight)"""
LAST_TIME = f"{FLIGHT}.charts.at(-1).data_.columns.at(-1)"


def test_a_page_takes_over_what_is_new_and_keeps_its_readers_place(session, tab):
    tab.run(READ)
    place = tab.run(PLACE)
    assert tab.run(LAST_TIME) < 104.0
    session.fly(4.0)
    tab.until(f"{LAST_TIME} > 107 && document.querySelectorAll('tr[data-at]').length === 2")
    assert tab.run(PLACE) == place
    assert place["span"] == [101, 103] and place["cursor"] == 102 and place["isOpen"]
    assert tab.said == []


@mark.in_full
def test_what_shows_the_whole_flight_or_its_end_follows_the_flight(session, tab):
    whole = tab.run(f"{FLIGHT}.whole")
    session.fly(4.0)
    tab.until(f"{FLIGHT}.span[1] > 107")
    assert tab.run(f"{FLIGHT}.span[0]") == whole[0]
    tab.run(f"document.documentElement.charts.zoom({FLIGHT}, 105, {FLIGHT}.whole[1])")
    session.fly(4.0)
    tab.until(f"{FLIGHT}.span[1] > 111 && {FLIGHT}.span[0] > 108")


def test_the_plots_follow_the_last_seconds_until_the_whole_flight_is_chosen(session, tab):
    """The choice is remembered: a page that is opened anew shows the same."""
    session.fly(40.0)
    tab.until(f"{FLIGHT}.span[1] > 143")
    first, last = tab.run(f"{FLIGHT}.span")
    assert last - first == approx(30.0)
    tab.run("document.querySelector('#span [value=whole]').click()")
    assert tab.run(f"{FLIGHT}.span") == tab.run(f"{FLIGHT}.whole")
    tab.run("window.isSamePage = true, location.reload()")
    tab.until(f"!window.isSamePage && {FLIGHT}?.span?.[1] > 143")
    assert tab.run(f"{FLIGHT}.span[0]") < 101.0


def test_a_page_that_stays_open_shows_the_next_flight_from_its_own_beginning(session, tab):
    """A browser keeps the page of one flight open while the next vehicle flies."""
    session.fly(8.0)
    tab.until(f"{FLIGHT}.span[1] > 111")
    # The next vehicle has not taken off yet: there is nothing to draw.
    session.history = LiveHistory()
    session.show(SessionStatus("1:1", message_age=0.0))
    tab.until(f"{FLIGHT}.charts.length === 0")
    # Its clock is within the flight before.
    session.end = 101.0
    for end in (102, 103, 104):
        session.fly(1.0)
        tab.until(f"{FLIGHT}.charts.length > 0 && {FLIGHT}.whole[1] > {end - 0.1}")
    assert tab.run(f"{FLIGHT}.span") == tab.run(f"{FLIGHT}.whole")
    assert tab.run(f"{FLIGHT}.whole[0]") >= 101.0


def test_a_page_that_stays_open_goes_on_after_a_reboot(session, tab):
    session.fly(4.0)
    tab.until(f"{FLIGHT}.whole[1] > 107")
    add_flight(session.history, 3.0, segment=1, start=5.0, boot=1)
    session.show(SessionStatus("1:1", is_flying=True, message_age=0.0))
    # The clock begins again at 5 s; the timeline goes on after the 108 s before.
    tab.until(f"{FLIGHT}.span[1] > 110.9 && {LAST_TIME} > 110.9")
    assert tab.run(f"{FLIGHT}.whole[0]") < 101.0


@mark.in_full
def test_the_plots_of_a_vehicle_that_was_lost_end_soon_after_its_last_message(session, tab):
    session.fly(8.0)
    tab.until(f"{FLIGHT}.span[1] > 111")
    end = tab.run(f"{FLIGHT}.span[1]")
    silence = Fact(RowsFact.NOTHING_RECEIVED, subject="messages", duration=3.0)
    session.show(SessionStatus("1:1", silence, is_flying=True, message_age=60.0))
    tab.until(f"{FLIGHT}.span[1] > {end}")
    assert tab.run(f"{FLIGHT}.span[1]") < end + 5.0


@mark.in_full
def test_a_page_that_stays_open_shows_the_flight_of_a_restarted_server(session, tab):
    tab.hurry()
    session.fly(8.0)
    tab.until(f"{FLIGHT}.span[1] > 111")
    offline = {"latency": 0, "downloadThroughput": -1, "uploadThroughput": -1}
    tab.command("Network.enable")
    tab.command("Network.emulateNetworkConditions", offline=True, **offline)
    tab.until(f"{LOUD_LINE} !== ''")
    session.history = LiveHistory()
    session.end = 10.0
    session.fly(4.0)
    tab.command("Network.emulateNetworkConditions", offline=False, **offline)
    tab.until(f"{LOUD_LINE} === '' && {FLIGHT}.charts.length > 0 && {FLIGHT}.whole[1] < 20")
    session.fly(4.0)
    tab.until(f"{FLIGHT}.span[1] > 17 && {LAST_TIME} > 17")
    assert tab.run(f"{FLIGHT}.span[0]") >= 10.0


def test_a_page_without_an_answer_keeps_its_state_says_for_how_long_and_recovers(session, tab):
    """The browser is offline for a while: the page turns grey and counts the seconds."""
    tab.hurry()
    headline = tab.run(HEADLINE)
    tab.command("Network.enable")
    offline = {"latency": 0, "downloadThroughput": -1, "uploadThroughput": -1}
    tab.command("Network.emulateNetworkConditions", offline=True, **offline)
    tab.until(f"/^No answer from mavdem for \\d+\\ss/.test({LOUD_LINE})")
    first = tab.run(LOUD_LINE)
    tab.until(f"{LOUD_LINE} !== {first!r}")
    assert tab.run(HEADLINE) == headline
    filter_of_headline = "getComputedStyle(document.querySelector('main h1')).filter"
    assert "grayscale" in tab.run(filter_of_headline)
    # The values of the vehicle stay at the edge of the window.
    edge = "innerHeight - document.querySelector('#state').getBoundingClientRect().bottom"
    assert abs(tab.run(edge)) < 1
    session.show(SessionStatus("1:1", no_model_reason=Fact(VehicleFact.NO_VEHICLE_YET)))
    tab.command("Network.emulateNetworkConditions", offline=False, **offline)
    tab.until(f"{LOUD_LINE} === '' && {HEADLINE} !== {headline!r}")
    assert tab.run(filter_of_headline) == "none"


@mark.in_full
def test_a_page_whose_server_has_nothing_new_says_so(session, tab):
    session.page = SessionPage(session.page.html, clock.monotonic() - 60.0)
    tab.until(f"{LOUD_LINE}.includes('has had nothing new for 6')")
    session.fly(4.0)
    tab.until(f"{LOUD_LINE} === ''")


COUNT_REQUESTS = """(() => {
  const ask = window.fetch;
  window.requests = 0;
  window.fetch = (...all) => { window.requests++; return ask(...all); };
})()"""
WAIT = "new Promise(passed => setTimeout(passed, 600))"


@mark.in_full
def test_a_page_waits_while_it_is_pressed_but_not_after_a_menu_has_opened(session, tab):
    tab.run(COUNT_REQUESTS)
    tab.run("document.body.dispatchEvent(new PointerEvent('pointerdown'))")
    session.fly(4.0)
    tab.run(WAIT)
    # The server answers at most once with the state that waits, and then has nothing new for half a second.
    assert tab.run("window.requests") <= 3
    assert tab.run(LAST_TIME) < 104.0
    tab.run("document.body.dispatchEvent(new MouseEvent('contextmenu'))")
    tab.until(f"{LAST_TIME} > 107 && {LOUD_LINE} === ''")


@mark.in_full
def test_a_page_behind_a_proxy_that_asks_to_sign_in_says_so(session, tab):
    tab.hurry()
    tab.run("window.ask = window.fetch")
    tab.run("window.fetch = async () => new Response('<h1>Sign in</h1>')")
    tab.until(f"{LOUD_LINE}.includes('Something else answers in its place')")
    tab.run("window.fetch = window.ask")
    tab.until(f"{LOUD_LINE} === ''")


@mark.in_full
def test_a_page_behind_a_proxy_that_changes_tags_asks_once_a_second(session, tab):
    tab.run("window.ask = window.fetch")
    tab.run("""window.fetch = async (address, options) => {
      const { headers, body, status } = await window.ask(address, options);
      return new Response(body, { status, headers: { Age: headers.get("Age"), ETag: '"changed"' } });
    }""")
    session.fly(4.0)
    tab.until(f"{LAST_TIME} > 107")
    tab.run(COUNT_REQUESTS)
    tab.run(WAIT)
    assert tab.run("window.requests") <= 3


ICON = "decodeURIComponent(document.querySelector('link[rel=icon]').href)"
COLOUR = "getComputedStyle(document.documentElement).getPropertyValue('--%s')"
TONES = """(() => {
  window.tones = 0;
  window.OscillatorNode = class {
    connect(node) { return node; }
    start() { window.tones++; }
    stop() {}
  };
  window.GainNode = class { connect() {} };
})()"""


def test_an_alarm_is_first_in_the_tab_colours_its_sign_and_sounds_where_that_is_wanted(
    session, tab
):
    """Motors become weak one after the other.

    A tone sounds only while the sound is on. Title and icon return once the status has no alarm.
    """
    tab.run(TONES)
    session.weaken(1)
    tab.until("document.title === '⚠ Motor 1: land now — No vehicle yet on udp'")
    assert tab.run(f"{ICON}.includes({COLOUR % 'bad'})")
    assert tab.run("window.tones") == 0
    tab.run("document.getElementById('sound').click()")
    tab.until("document.getElementById('sound').innerText === 'Alarm sound is on'")
    assert tab.run("window.tones") == 1
    session.weaken(2)
    tab.until("window.tones > 1")
    tab.run("document.getElementById('sound').click()")
    assert tab.run("document.getElementById('sound').innerText") == "Turn on alarm sound"
    tones = tab.run("window.tones")
    session.weaken(3)
    tab.until("document.title.includes('Motor 3')")
    assert tab.run("window.tones") == tones
    session.fly(4.0)
    tab.until(f"document.title === 'No vehicle yet on udp' && !{ICON}.includes({COLOUR % 'bad'})")


@mark.in_full
def test_an_alarm_stays_at_the_edge_of_the_window_while_its_headline_is_out_of_sight(session, tab):
    """A telephone's page that is scrolled down; a touch of the alarm leads back to the headline."""
    tab.size(390)
    session.weaken(3)
    tab.until("document.title.startsWith('⚠')")
    is_shown = "document.querySelector('#alarm').checkVisibility()"
    assert not tab.run(is_shown)
    tab.run("scrollTo(0, document.body.scrollHeight)")
    tab.until(is_shown)
    assert "Motor 3" in tab.run("document.querySelector('#alarm').textContent")
    # A part that the bar leads to stands below the alarm.
    tab.run(
        "[...document.querySelectorAll('#jump button')].find(b => b.textContent === 'Events').click()"
    )
    place = "document.querySelector('#flight h2').getBoundingClientRect().top"
    assert tab.run(f"{place} >= document.querySelector('#alarm').offsetHeight")
    tab.run("document.querySelector('#alarm').click()")
    tab.until(f"!({is_shown})")
    assert tab.run("scrollY") == 0


def test_a_lost_link_has_a_strip_of_its_own_before_it_is_an_alarm(session, tab):
    """A page that gets no answer itself says so in the place of the strip, with what was last in it."""
    tab.hurry()
    silence = Fact(RowsFact.NOTHING_RECEIVED, subject="messages", duration=3.0)
    tab.size(390)
    session.show(SessionStatus("1:1", silence, is_flying=True, message_age=4.0))
    tab.until("document.title.startsWith('⚠')")
    tab.run("scrollTo(0, document.body.scrollHeight)")
    is_shown = "document.querySelector('#alarm').checkVisibility()"
    tab.until(f"{is_shown} && document.querySelector('#alarm').className === 'watch'")
    last = "Link lost 4 s ago, in flight"
    assert tab.run("document.querySelector('#alarm').textContent") == f"⚠ {last}"
    tab.command("Network.enable")
    offline = {"latency": 0, "downloadThroughput": -1, "uploadThroughput": -1}
    tab.command("Network.emulateNetworkConditions", offline=True, **offline)
    tab.until(f"{LOUD_LINE}.endsWith('Last alarm: {last}.') && !({is_shown})")


def test_a_repair_is_noted_at_once_and_not_offered_again(session, tab):
    """The server still has the warning for some seconds; where it stores nothing, the button is as before."""
    fault = Fact(
        SessionFact.RECORDING_JUDGED,
        Level.BAD,
        headline="Motor 3 lost thrust.",
        next_step="Do not fly before it is inspected.",
        flight_date="2026-11-28 09:15",
        motor=3,
        address="/f/no-such-flight",
    )
    warned = SessionStatus("1:1", is_flying=True, message_age=0.0, fault_in_library=fault)
    session.show(warned)
    statement = "Motor 3 was repaired or inspected after the flight of 2026-11-28 09:15 UTC"
    button = "document.querySelector('#repaired')"
    tab.until(f"{button}?.textContent === '{statement}'")
    tab.run("""(() => {
      window.confirm = question => { window.question = question; return true; };
      window.alert = refusal => { window.refusal = refusal; };
      const ask = window.fetch, asked = new Promise(answer => { window.answer = answer; });
      window.fetch = (address, options) =>
        options.method === "PATCH" ? asked.then(() => ask(address, options)) : ask(address, options);
    })()""")
    tab.run(f"{button}.click()")
    assert tab.run(f"[{button}.textContent, {button}.disabled]") == ["Noted", True]
    assert tab.run("window.question").startswith(f"{statement}?")
    session.show(replace(warned, message_age=1.0, flight_seconds=3.0))
    tab.until("document.body.innerText.includes('in flight 0:03')")
    assert tab.run(f"[{button}.textContent, {button}.disabled]") == ["Noted", True]
    # On the ground the headline is that fault, and says so at once, too.
    on_ground = replace(warned, is_flying=False, flight_seconds=None)
    on_ground = replace(on_ground, state=VehicleState(system=1))
    session.show(on_ground)
    noted = f"Noted: motor 3{statement.removeprefix('Motor 3')}."
    tab.until(f"{HEADLINE} === '{noted}'")
    step = "document.querySelector('#result .headline + p').checkVisibility()"
    assert tab.run(step) is False
    assert tab.run("document.querySelector('#earlier')") is None, "the headline says it"
    tab.run("window.answer()")
    tab.until("window.refusal")
    assert tab.run(f"[{button}.textContent, {button}.disabled]") == [statement, False]
    tab.run(f"{button}.click()")
    session.show(replace(on_ground, message_age=2.0))
    tab.until(f"{HEADLINE}.startsWith('Earlier flight (2026-11-28 09:15 UTC)')")
    assert tab.run(step)


@mark.in_full
def test_who_read_the_headline_reads_that_of_the_next_flight(session, tab):
    """Who reads the plots stays there."""
    tab.size(390)
    for number, (place, is_at_top) in enumerate(((40, True), (600, False)), start=1):
        tab.run(f"scrollTo(0, {place})")
        session.history.note_flight(number, session.end)
        session.fly(4.0)
        tab.until(f"document.querySelector('#flight').dataset.flight === '{number}'")
        assert tab.run("scrollY === 0") is is_at_top


@mark.in_full
def test_the_sound_that_was_chosen_is_remembered(session, tab):
    tab.run("document.getElementById('sound').click()")
    tab.run("window.isSamePage = true, location.reload()")
    tab.until("!window.isSamePage && document.getElementById('sound')")
    assert tab.run("document.getElementById('sound').ariaPressed") == "true"


def test_without_javascript_a_page_is_loaded_again(session):
    assert '<noscript><meta http-equiv="refresh" content="5"></noscript>' in session.page.html


def test_an_update_has_no_style_no_script_and_waits_until_something_is_new(server, session):
    answer = server.get("/live/update")
    assert "<style" not in answer.text and "uPlot" not in answer.text
    assert "<title>" in answer.text and answer.text.count("<main ") == 1
    start = clock.monotonic()
    # A proxy that compresses answers marks their tags as weak.
    shown = {"If_None_Match": f"W/{answer.headers['ETag']}"}
    assert server.get("/live/update", **shown).status == 304
    assert clock.monotonic() - start >= UPDATE_WAIT
    session.fly(4.0)
    assert server.get("/live/update", **shown).status == 200


@mark.in_full
def test_an_opened_light_that_is_good_shows_its_figures_and_stays_open_after_the_flight(
    session, tab
):
    """A telephone's page: the end of the flight puts a line above the lights."""
    reason = "document.querySelector('[data-light=motors] dd:last-child').checkVisibility()"
    good = Fact(WatchFact.NO_MOTOR_AT_LIMIT, Level.GOOD, reason=None)
    lights = {"worst_lights": {Light.MOTORS: good}}
    session.show(SessionStatus("1:1", is_flying=True, message_age=0.0, **lights))
    tab.size(390)
    tab.until("document.querySelector('[data-light=motors] dd.good')")
    figure = "document.querySelector('[data-light=motors] .brief')"
    assert not tab.run(reason) and tab.run(f"{figure}.checkVisibility()")
    assert tab.run(f"{figure}.textContent") == "none at its limit"
    tab.run("document.querySelector('[data-light=motors]').focus()")
    assert tab.run(reason) and not tab.run(f"{figure}.checkVisibility()")
    session.saved_flight = PageLink("flight.tlog", "/flights/1")
    session.show(SessionStatus("1:1", message_age=0.0, **lights))
    tab.until("document.querySelector('main').innerText.includes('This flight is over')")
    assert tab.run(reason)


def test_the_reason_of_a_light_opens_and_closes_by_touches_and_shows_that_it_can(session, tab):
    """On a narrow screen, a click on a light unfolds its reason."""
    sign = "getComputedStyle(document.querySelector('[data-light=power] dt'), '::before').content"
    reason = "document.querySelector('[data-light=power] dd:last-child').checkVisibility()"
    tab.size(390)
    middle = tab.run("""(() => {
        const { left, top, width, height } = document.querySelector("[data-light=power]").getBoundingClientRect();
        return [left + width / 2, top + height / 2];
    })()""")
    assert tab.run(sign) == '"▸"' and not tab.run(reason)
    for is_open in (True, False):
        for kind in ("mousePressed", "mouseReleased"):
            place = {"x": middle[0], "y": middle[1], "button": "left", "clickCount": 1}
            tab.command("Input.dispatchMouseEvent", type=kind, **place)
        tab.until(f"{reason} === {str(is_open).lower()}")
    tab.size(1280)
    assert tab.run(reason) and tab.run(sign) == "none"
