"""The page: one file that fetches nothing, escapes everything, zooms, prints, and fits a narrow and a wide window."""

import re
from base64 import b64decode
from dataclasses import replace
from datetime import UTC, datetime
from hashlib import sha256
from html.parser import HTMLParser
from itertools import count
from math import nan

import numpy as np
from browsing import HOSTILE
from hover import Hover, with_texts
from live_rows import add_flight
from made_up_analysis import assessment, physical
from numpy.testing import assert_allclose
from pytest import approx, fixture, mark
from recorded_flights import FLIGHT

from mavdem.assessment.assess import assess
from mavdem.assessment.flights import settled_flight
from mavdem.assessment.inventory import inventory
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Level
from mavdem.facts.ending import Ending, MotionEvent
from mavdem.facts.estimator import EstimatorLight
from mavdem.facts.event import Event
from mavdem.facts.events import ReportedEvent
from mavdem.facts.hardware import HardwareFact
from mavdem.facts.lights import Light, Unjudged
from mavdem.facts.power import PowerLight
from mavdem.facts.session import SessionFact, TimeUse, VehicleFact
from mavdem.facts.vibration import VibrationLight
from mavdem.ingest import read_log
from mavdem.live.history import LiveHistory
from mavdem.live.session_status import SessionStatus
from mavdem.report.blocks import Sentence, Table, headline_sentence
from mavdem.report.charts.chart import Group, Line, LineStyle, over_time
from mavdem.report.charts.timeline import Timeline, assessment_timeline, live_timeline
from mavdem.report.pages.chapter_of_light import (
    LOG_TITLE,
    lights_of_chapter,
    unfold_chapters_of_warnings,
)
from mavdem.report.pages.event_list import with_messages_around_loss, with_utc_of_bad_events
from mavdem.report.pages.flight_chapters import scope_of_instances_level
from mavdem.report.pages.flight_page import flight_page, log_page
from mavdem.report.pages.library_page import without_last_position
from mavdem.report.pages.live_page import live_page
from mavdem.report.pages.loop_chapters import TUNING_TITLE
from mavdem.report.pages.page import (
    Chapter,
    Head,
    PageEvent,
    Provenance,
    Section,
    render_document,
)
from mavdem.report.screen import analysis_blocks

UNSEEN = "\N{RIGHT-TO-LEFT OVERRIDE}\a"
NAME = HOSTILE + 200 * "x"
VOID = {"meta", "path", "line", "circle", "rect", "br", "wbr", "input"}


class Balanced(HTMLParser):
    """Raises ``AssertionError`` for tags that do not close in order and ids that are two; collects them."""

    def __init__(self, text):
        super().__init__()
        self.open = []
        self.seen = []
        self.ids = []
        self.feed(text)
        assert not self.open and len(self.ids) == len(set(self.ids))

    def handle_starttag(self, tag, attrs):
        self.seen.append(tag)
        self.ids += [value for name, value in attrs if name == "id"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag


@mark.slow
def test_every_column_of_the_motors_is_shown_and_no_line_ends_before_a_percent_sign(
    tmp_path, browser
):
    text = render_document("flight.tlog", "", analysis_blocks(assessment(physical())))
    widths = "[...document.querySelectorAll('.scroll')].map(e => e.scrollWidth - e.clientWidth)"
    assert [browser.shown(text, widths, tmp_path, width)[1] for width in (500, 1200)] == 2 * [
        [0, 0, 0]
    ]
    assert not re.search(r"\d ?%", text.split("<section")[1])
    assert "0.4 s long, at 77.2 s" in text


@fixture(scope="module")
def analysed():
    """The assessment of a log."""
    return assess(read_log(FLIGHT), axis="roll")


@mark.in_full
def test_two_axes_of_a_flight_of_a_fleet_fit_into_a_small_page_that_leads_back(analysed):
    analyses = dict.fromkeys(("roll", "pitch"), analysed.analysis)
    stop = Fact(MotionEvent.MOTOR_AT_ITS_STOP, time=1.0, share=0.5, subject="motor 2")
    evidence = replace(analysed.evidence, events=(stop, stop))
    text = flight_page("flight.tlog", replace(analysed, analyses=analyses, evidence=evidence))
    # In the brief list of events, and in that of all.
    assert text.count("its upper limit") == text.count("reached its upper limit 2 times, ") == 2
    assert len(text.encode()) < 500_000
    assert '<a href="../index.html">' in text and "Model of pitch" in text
    assert Balanced(text).ids


def test_a_line_divides_the_events_of_two_boots():
    """Two events are of the first boot, and two of the second, whose clock begins again."""
    stop = Fact(MotionEvent.MOTOR_OFF, Level.BAD, subject="motor 3")
    events = [
        PageEvent(Event(time, stop.replace(time=time, boot=boot)))
        for boot, time in ((0, 60.0), (0, 177.9), (1, 18.9), (1, 97.9))
    ]
    text = render_document("a.tlog", "", [], head=Head(Level.BAD, {}, events))
    before, after = text.split("The autopilot restarted: its clock begins anew.")
    assert "177.9 s" in before and "18.9 s" in after
    # The charts have the clock of the first boot.
    of_other_boot = events[2]._replace(is_on_clock_of_charts=False)
    linked = render_document("a.tlog", "", [], head=Head(Level.BAD, {}, [events[0], of_other_boot]))
    assert 'href="#t=60.00"' in linked and "18.9 s" in linked
    assert "#t=18.90" not in linked and 'data-at="18.9"' not in linked
    one_boot = render_document("a.tlog", "", [], head=Head(Level.BAD, {}, events[:2]))
    assert "its clock begins anew" not in one_boot


def test_the_loss_of_a_flight_stands_with_what_the_autopilot_sent_around_it():
    telemetry = with_texts(Hover().telemetry(), *(f"text {second}" for second in range(1, 41)))
    mode = PageEvent(Event(30.0, Fact(ReportedEvent.MODE_CHANGED, time=30.0)))
    loss = PageEvent(Event(20.5, Fact(Ending.CONTROL_LOST, Level.BAD, time=20.5)))
    unchanged, with_messages = with_messages_around_loss([mode, loss], telemetry)
    assert unchanged == mode
    assert with_messages.messages[0] == "“text 18” at 18.0 s"
    # Of the six within three seconds there is room for the first four.
    assert with_messages.messages[-1] == "“text 21” at 21.0 s"


def test_visitors_without_the_log_do_not_see_where_a_lost_flight_was_last():
    blocks = [Sentence("52.1° N.", "Last position:"), Sentence("land.", "Next:")]
    page = render_document("a.bin", "", blocks)
    assert "52.1°" in page
    shown = without_last_position(page)
    assert "52.1°" not in shown and "land." in shown


def test_bad_events_have_their_time_in_utc():
    """The autopilot's clock read 0 at noon."""
    noon = datetime(2026, 3, 9, 12, tzinfo=UTC).timestamp()
    stamps = {"time": np.array([10.0]), "boot": np.array([0])}
    utc = {"time_unix_usec": np.array([1e6 * (noon + 10.0)])}
    mode = PageEvent(Event(30.0, Fact(ReportedEvent.MODE_CHANGED, time=30.0)))
    loss = PageEvent(Event(61.9, Fact(Ending.CONTROL_LOST, Level.BAD, time=61.9)))
    with_utc = with_utc_of_bad_events([mode, loss], {"SYSTEM_TIME": stamps | utc})
    assert [event.utc and f"{event.utc:%H:%M:%S}" for event in with_utc] == [None, "12:01:01"]
    assert with_utc_of_bad_events([loss], {}) == [loss]


@mark.slow
def test_a_timeline_goes_on_for_seconds_after_the_vehicle_was_disarmed(analysed):
    evidence = replace(analysed.evidence, signals=Signals(Hover().telemetry()))
    timeline = assessment_timeline(replace(analysed, evidence=evidence))
    assert timeline.span[1] > 75.0


@mark.slow
def test_settled_flight_is_grey_where_no_model_is_learned_from_it(analysed):
    evidence = replace(analysed.evidence, signals=Signals(Hover().telemetry()))
    without_model = replace(analysed.analysis, flights=())
    assessed = replace(analysed, evidence=evidence, analyses={"roll": without_model})
    ((start, end),) = assessment_timeline(assessed).grey_intervals
    (settled,) = settled_flight(evidence.signals)
    assert (start, end) == (settled.start, settled.end) and end - start > 20.0


def test_the_board_supply_leads_to_the_hardware_and_the_rest_is_named_by_its_light():
    """The supply is watched and plotted with the hardware; batteries and estimators stay in their chapter."""
    battery = Fact(PowerLight.BATTERY_LOW, Level.WATCH)
    supply = Fact(PowerLight.SUPPLY_LOW, Level.WATCH)
    estimator = Fact(EstimatorLight.FILTER_AGREED, Level.GOOD)
    with_supply = {Light.POWER: supply, Light.ESTIMATOR: estimator}
    with_battery = {Light.POWER: battery, Light.ESTIMATOR: estimator}
    assert lights_of_chapter("Hardware", with_supply) == [Light.POWER]
    assert lights_of_chapter("Hardware", with_battery) == []
    assert scope_of_instances_level(with_supply) == " (estimator)"
    assert scope_of_instances_level(with_battery) == " (power)"


@fixture(scope="module")
def flight(analysed):
    """The page of a log with all chapters."""
    return log_page(UNSEEN + NAME, analysed, inventory(analysed.log))


@mark.slow
def test_tags_close_in_order_ids_are_unique_and_nothing_is_fetched_or_owned(flight, analysed):
    elements = Balanced(flight).seen
    assert {"figure", "table", "details"} <= {*elements}
    # What comes from a log is text, and nothing in it turns text around.
    assert not {*UNSEEN} & {*flight}
    assert not {"link", "img", "iframe", "b"} & {*elements}
    plain, again = (
        log_page(name, analysed, inventory(analysed.log)) for name in ("a", UNSEEN + NAME)
    )
    assert Balanced(plain).seen == elements and again == flight
    assert "@import" not in flight and "default-src 'none'" in flight


ZOOM = """(async () => {
for (const part of document.querySelectorAll(".chapter > details, #vibration .part, .fold")) part.open = true;
const { groups } = document.documentElement.charts;
while (!(groups.flight?.charts.length > 10)) await new Promise(done => setTimeout(done, 20));
const group = groups.flight, chart = group.charts[2], over = chart.over;
const box = over.getBoundingClientRect();
const spans = async () => {
  await new Promise(done => setTimeout(done, 50));
  return group.charts.map(chart => chart.scales.x.max - chart.scales.x.min);
};
for (const [kind, x, on] of [["move", 1, over], ["down", 1, over], ["move", 2, over], ["up", 2, document]]) {
  const at = {clientX: box.left + x * box.width / 4, clientY: box.top + 20, movementX: 9, bubbles: true};
  on.dispatchEvent(new MouseEvent(`mouse${kind}`, at));
}
const zoomed = await spans(), figure = document.querySelector("figure.chart[tabindex]");
figure.dispatchEvent(new KeyboardEvent("keydown", {key: "-"}));
const wider = await spans();
document.getElementById("whole").click();
const fits = document.documentElement.scrollWidth <= innerWidth;
return [zoomed, wider, await spans(), figure.ariaLabel ?? figure.getAttribute("aria-label"), fits];
})()"""


@mark.slow
def test_dragging_over_one_plot_zooms_all_and_a_button_shows_the_whole_flight(
    flight, tmp_path, browser
):
    """A browser drags over one chart of the page of a flight, widens the range, and resets it."""
    # The window is that of a telephone, in the dark.
    title, (zoomed, wider, whole_range, label, fits) = browser.shown(
        flight, ZOOM, tmp_path, 500, dark=True
    )
    # The plots: modes, roll, pitch, motors twice and wind torque; angle and rate of three axes; the spectrogram.
    assert (
        fits
        and len(whole_range) == 13
        and label.startswith("Modes")
        and title == f"\ufffd\ufffd{NAME}"
    )
    assert_allclose(zoomed, 15.0, atol=0.5)
    assert_allclose(wider, 30.0, atol=1.0)
    assert_allclose(whole_range, 60.0, atol=0.5)


TOUCHED = """(() => {
const {charts} = document.documentElement.charts.groups.flight, {x} = charts[0].scales;
const cursors = charts.map(({cursor, posToVal}) => cursor.left < 0 ? null : posToVal(cursor.left, "x"));
return {span: [x.min, x.max], cursors, scrolled: scrollY};
})()"""
"""What a finger changes: the shown span of time, the time under each plot's cursor, and how far the page scrolled."""


@mark.in_full
def test_fingers_on_a_plot_move_all_cursors_zoom_and_scroll(flight, tmp_path, browser):
    """Touches are sent to a browser.

    One finger moves the cursors, two zoom, a double tap resets, a vertical move scrolls.
    """
    (tmp_path / "page.html").write_text(flight)
    with browser.tab() as tab:
        tab.size(390)
        tab.command("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
        tab.open((tmp_path / "page.html").as_uri())
        tab.until("document.documentElement.charts.groups.flight?.charts.length > 3")
        tab.run("document.querySelector('#flight .charts').scrollIntoView()")
        left, top, width = tab.run("""(() => {
            const plot = document.querySelectorAll("#flight .u-over")[1].getBoundingClientRect();
            return [plot.left, plot.top + plot.height / 2, plot.width];
        })()""")

        # Events state their times, since on a busy machine two taps would come too late for a double tap.
        times = count(1.0, 0.02)

        def touch(kind, *places, above=0.0):
            """Fingers do something at these fractions of the plot's width, 20 ms after the event before."""
            points = []
            for number, position in enumerate(places):
                points.append({"id": number, "x": left + width * position, "y": top - above})
            tab.command(
                "Input.dispatchTouchEvent", type=kind, touchPoints=points, timestamp=next(times)
            )

        first = tab.run(TOUCHED)
        touch("touchStart", 0.3)
        touch("touchMove", 0.4)
        touch("touchMove", 0.5)
        touch("touchEnd")
        dragged = tab.run(TOUCHED)
        touch("touchStart", 0.4)
        touch("touchStart", 0.4, 0.6)
        touch("touchMove", 0.3, 0.7)
        touch("touchMove", 0.2, 0.8)
        touch("touchEnd")
        pinched = tab.run(TOUCHED)
        for _ in range(2):
            touch("touchStart", 0.2)
            touch("touchEnd")
        tapped = tab.run(TOUCHED)
        touch("touchStart", 0.5)
        for step in range(10):
            touch("touchMove", 0.5, above=20.0 * step)
        touch("touchEnd")
        tab.until(f"scrollY > {first['scrolled'] + 50}")
        scrolled = tab.run(TOUCHED)
    # One finger: the same time under the cursors of all plots, the same span, no scrolling.
    middle = sum(first["span"]) / 2
    assert_allclose(dragged["cursors"], middle, atol=0.3)
    assert (dragged["span"], dragged["scrolled"]) == (first["span"], first["scrolled"])
    # Two fingers that part: a third of the time, around the same place.
    low, high = pinched["span"]
    assert high - low == approx((first["span"][1] - first["span"][0]) / 3, rel=0.1)
    assert low < middle < high
    assert tapped["span"] == first["span"] == scrolled["span"]


USED = """(async () => {
const root = document.documentElement, tick = () => new Promise(done => setTimeout(done, 50));
while (!(root.charts.groups.flight?.charts.length > 3)) await tick();
const group = root.charts.groups.flight, span = () => group.charts[0].scales.x.max - group.charts[0].scales.x.min;
const event = document.querySelector("tr[data-at] a"), spans = [span()];
for (const _ of [1, 2]) { event.click(); await tick(); spans.push(span()); }
const isListClosed = !document.querySelector("details.events")?.open;
const figure = [...document.querySelectorAll("#flight figure.chart")].find(one => one.ariaLabel.startsWith("Motors"));
figure.dispatchEvent(new KeyboardEvent("keydown", {key: "ArrowRight", shiftKey: true}));
const values = figure.querySelector(".legend").innerText, now = document.getElementById("now").innerText;
const part = document.querySelector("#parameters > details"), closed = !part.open;
location.hash = "#parameters"; await tick();
const search = document.querySelector("input[data-table]");
const rows = [...document.getElementById(search.dataset.table).tBodies[0].rows];
search.value = "ATC_RAT rll_flte"; search.dispatchEvent(new Event("input"));
const found = rows.filter(row => !row.hidden).map(row => row.cells[0].textContent);
const sections = [...document.querySelectorAll(".part:not(.idle)")];
const closedSections = sections.filter(one => !one.open).length;
document.getElementById("all").click();
const opened = sections.filter(one => one.open).length;
return [spans, values, now, isListClosed && closed && part.open, found, closedSections, opened === sections.length];
})()"""


@mark.slow
def test_an_event_moves_the_plots_and_back_the_cursor_reads_them_and_a_link_opens_its_part(
    flight, tmp_path, browser
):
    _, (spans, values, now, is_opened, field_text, closed_sections, are_open) = browser.shown(
        flight, USED, tmp_path, 1200
    )
    assert field_text == ["ATC_RAT_RLL_FLTE"]
    assert closed_sections > 0 and are_open
    whole_range, around_event, whole_again = spans
    assert whole_range == whole_again and around_event <= 10.0 < whole_range
    assert re.search(r"\d s\s", values) and re.search(r"motor\s+1\s+\d", values)
    assert re.match(r"\d+\.\d s", now) and is_opened


PHONE = """(async () => {
const root = document.documentElement, tick = () => new Promise(done => setTimeout(done, 50));
while (!(root.charts.groups.flight?.charts.length > 3)) await tick();
const isShown = name => [...document.querySelectorAll(name)].some(part => part.checkVisibility());
const links = [...document.querySelectorAll(".events td:first-child a, dt a")].filter(link => link.checkVisibility());
return [isShown(".with-mouse"), isShown(".by-touch"), Math.min(...links.map(link => link.offsetHeight))];
})()"""


@mark.slow
def test_a_page_of_a_phone_speaks_of_fingers_and_has_links_that_they_hit(flight, tmp_path, browser):
    """WCAG 2.2, 2.5.8: a target is at least 24 px high. The browser of this phone reports a mouse."""
    _, (speaks_of_mouse, speaks_of_fingers, least_height) = browser.shown(
        flight, PHONE, tmp_path, 390
    )
    assert speaks_of_fingers and not speaks_of_mouse
    assert least_height >= 24


AT_CURSOR = """(async () => {
const root = document.documentElement, tick = () => new Promise(done => setTimeout(done, 50));
while (!root.charts.groups.flight) await tick();
const {flight} = root.charts.groups;
root.charts.setCursor(flight, 5.0);
return flight.charts.map(chart => chart.data_.values[0].textContent);
})()"""


@mark.slow
def test_values_under_the_cursor_have_the_decimals_that_their_axis_shows(tmp_path, browser):
    """Four charts have a value at 5 s, and axes of very different ranges."""
    time = np.linspace(0.0, 10.0, 11)
    charts = []
    for value, largest in ((-2e-4, 30.0), (-0.3332, 30.0), (-2e-4, 1e-3), (1234.5678, 2000.0)):
        values = np.where(time == 5.0, value, largest * np.sin(time))
        charts.append(over_time("Roll rate", "°/s", [Line("rate", "#1f7ad6", time, values)]))
    head = Head(Level.GOOD, {}, timeline=Timeline(tuple(charts), (0.0, 10.0)))
    page = render_document("x", "", [], head=head)
    _, values = browser.shown(page, AT_CURSOR, tmp_path, 1200)
    assert values == ["0", "−0.3", "−2e−4", "1235"]


PEAK = """(async () => {
const root = document.documentElement, tick = () => new Promise(done => setTimeout(done, 20));
while (!root.charts.groups.flight?.charts.length) await tick();
const [chart] = root.charts.groups.flight.charts, tops = [], notes = [];
for (const isShown of [false, true]) {
  if (isShown) document.querySelector("button.cut").click();
  await tick();
  tops.push(chart.scales.y.max);
  notes.push(document.querySelector("button.cut").textContent);
}
return { tops, notes, outside: document.querySelector("span.cut").textContent };
})()"""


@mark.slow
def test_a_peak_that_would_flatten_a_plot_is_left_out_until_it_is_asked_for(tmp_path, browser):
    time = np.linspace(0.0, 10.0, 501)
    rate = np.where(time == 5.0, 1875.0, 50.0 * np.sin(time))
    chart = over_time("Pitch rate", "°/s", [Line("rate", "#1f7ad6", time, rate)])
    # A chart whose axis has limits says which lines leave it.
    limited = chart._replace(y=chart.y._replace(limits=(-60.0, 60.0)))
    chapter = Chapter("Three axes", groups=[Group(((chart, limited),))])
    page = render_document("x", "", [], [chapter])
    _, shown = browser.shown(page, PEAK, tmp_path, 1200)
    assert shown["outside"] == "off the scale: rate up to 1875"
    assert shown["tops"][0] < 100 and shown["tops"][1] > 1875
    assert shown["notes"] == ["show peak 1875", "cut peaks"]


ON_PAPER = """(async () => {
const drawText = CanvasRenderingContext2D.prototype.fillText, drawnNumbers = new Set();
// The numbers of events stand on a line of their own above the plots, in runs such as "3–5, 9".
CanvasRenderingContext2D.prototype.fillText = function (text, ...place) {
  if (this.textBaseline === "bottom") for (const run of text.split(", ")) {
    const [first, last = first] = run.split("–").map(Number);
    for (let number = first; number <= last; number++) drawnNumbers.add(String(number));
  }
  drawText.call(this, text, ...place);
};
// One event has no text on paper, as if it were in a closed list only.
document.querySelector(".events .number").closest("tr").hidden = true;
const warned = document.querySelector(".chapter > details:not([open])");
warned.querySelector("summary").insertAdjacentHTML("beforeend", '<span class="rating watch">watch</span>');
dispatchEvent(new Event("beforeprint"));
await new Promise(done => setTimeout(done, 50));
const box = element => element.getBoundingClientRect();
const figures = [...document.querySelectorAll("figure.chart")].filter(figure => figure.checkVisibility());
const misfits = figures.filter(figure => {
  const canvas = figure.querySelector("canvas");
  return !canvas || Math.abs(box(canvas).width - box(figure).width) > 1;
});
const paperWidth = 190 / 25.4 * 96;
const beyondPaper = figures.filter(figure => box(figure).right > paperWidth + 1).length;
const closedParts = [...document.querySelectorAll(".chapter details:not([open])")];
const shownParts = closedParts.filter(part => !part.parentElement.closest("details:not([open])"));
const lineOfChapters = document.getElementById("unprinted");
const isNamed = part => lineOfChapters.textContent.includes(part.querySelector("h2, strong").textContent);
const hasLine = part => part.querySelector("summary").checkVisibility()
  || lineOfChapters.checkVisibility() && isNamed(part);
const numbers = [...document.querySelectorAll(".events .number")];
const printedNumbers = new Set(numbers.filter(number => number.checkVisibility()).map(number => number.textContent));
const result = {
  unexplainedNumbers: [...drawnNumbers].filter(number => !printedNumbers.has(number)),
  unmarkedNumbers: numbers.filter(number => number.checkVisibility() && number.closest("[data-at]"))
    .map(number => number.textContent).filter(number => !drawnNumbers.has(number)),
  hasNumbers: drawnNumbers.size > 0,
  isWarningPrinted: warned.open,
  hasDate: /\\d{4}-\\d\\d-\\d\\d \\d\\d:\\d\\d:\\d\\d UTC/.test(document.getElementById("identity").innerText),
  charts: figures.length, misfits: misfits.length, beyondPaper,
  paper: getComputedStyle(document.documentElement).getPropertyValue("--card").trim(),
  hasClosedParts: shownParts.length > 0,
  closedWithoutLine: shownParts.filter(part => !hasLine(part)).length,
  menu: getComputedStyle(document.querySelector(".contents")).display,
  times: document.documentElement.charts.groups.flight.charts.filter(
    chart => chart.data_.lines.length && chart.root.closest("#flight > .plots")
  ).every(chart => chart.axes[0]._size > 0),
  withFewTicks: document.documentElement.charts.groups.flight.charts.filter(
    chart => chart.data_.lines.length && chart.axes[0]._size > 0
      && chart.axes[0]._values.filter(text => text).length < 3
  ).length,
  // Chromium's viewer of PDF leaves out gradients with gaps.
  marksWithGaps: [...document.querySelectorAll(".legend i")].filter(
    mark => mark.style.cssText.includes("transparent")
  ).length,
  breaks: ["#flight .charts", "#flight figure.chart"].map(
    name => getComputedStyle(document.querySelector(name)).breakInside
  ),
};
dispatchEvent(new Event("afterprint"));
CanvasRenderingContext2D.prototype.fillText = drawText;
result.isWarningClosedAgain = !warned.open;
return { ...result, screen: getComputedStyle(document.querySelector(".contents")).display };
})()"""


@mark.in_full
def test_a_page_is_laid_out_anew_for_light_paper_and_prints_what_is_open(flight, tmp_path, browser):
    """A browser in dark mode prints the page of a flight.

    The paper is white, nothing is too wide, no chart is divided, each closed chapter is named, and
    each event that a plot numbers has its text.
    """
    assert len(flight.encode()) < 790_000
    (tmp_path / "page.html").write_text(flight)
    with browser.tab() as tab:
        tab.size(1280, dark=True)
        tab.open((tmp_path / "page.html").as_uri())
        # It has its charts too where it is printed before any was on a screen.
        printed = b64decode(tab.command("Page.printToPDF")["data"])
        tab.until("document.documentElement.charts.groups.flight")
        on_paper = tab.run(ON_PAPER)
        tab.run("document.querySelector('#all').click()")
        on_paper["closedAfterOpenAll"] = tab.run(
            "document.querySelectorAll('main details:not([open], .on-screen details, .idle)').length"
        )
        # A trial of notch filters that the log has off shows nothing before it is used.
        on_paper["closedTrials"] = tab.run("document.querySelectorAll('.idle:not([open])').length")
        tab.size(390)
        tab.until("!document.querySelector('.contents > details').open")
        columns_of_axes = tab.run("document.querySelectorAll('#three-axes .fold').length")
        open_columns = tab.run("document.querySelectorAll('#three-axes .fold[open]').length")
    # A telephone has the plots of one axis open.
    assert columns_of_axes == 3 and open_columns == 1
    assert len(re.findall(rb"/Type\s*/Page\b", printed)) <= 6
    assert on_paper.pop("charts") > 5
    assert on_paper == {
        "unexplainedNumbers": [],
        "unmarkedNumbers": [],
        "hasNumbers": True,
        "isWarningPrinted": True,
        "isWarningClosedAgain": True,
        "hasDate": True,
        "misfits": 0,
        "beyondPaper": 0,
        "paper": "#ffffff",
        "hasClosedParts": True,
        "closedWithoutLine": 0,
        "closedAfterOpenAll": 0,
        "closedTrials": 1,
        "menu": "none",
        "withFewTicks": 0,
        "marksWithGaps": 0,
        # A sheet may end between the first plots over the flight, each of which has times below it.
        "times": True,
        "breaks": ["auto", "avoid"],
        "screen": "block",
    }


def test_a_page_says_from_which_log_it_was_made_and_when(tmp_path):
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"log")
    head = Head(Level.GOOD, {}, provenance=Provenance.of_log(path))
    foot = render_document("flight.tlog", "", [], [], head=head).split("<footer>")[1]
    assert f"SHA-256 of the log: {sha256(b'log').hexdigest()}." in foot
    assert re.search(r", on \d{4}-\d\d-\d\d \(UTC\)", foot)
    # A log that was moved away, or that several files were joined to, has no digest.
    assert Provenance.of_log(tmp_path / "moved.tlog").digest == ""


def test_the_foot_of_a_sheet_has_the_title_which_cannot_end_the_style_sheet():
    page = render_document('a"} </style>\\.ulg', "", [], [])
    assert r'@bottom-left { content: "a\22 \7d  \3c \2f style\3e \5c .ulg";' in page
    assert "bottom-center" not in page, "a long title would run into a second box"


@mark.slow
def test_a_live_flight_has_what_was_trained_on_and_no_wind_below_0():
    """The history of a live session has trained intervals and poses.

    With a new boot the map begins anew.
    """
    history = LiveHistory()
    add_flight(history, 2.0)
    add_flight(history, 2.0, segment=1, start=105.0, learnt=False)
    timeline = live_timeline(history, "roll")
    above, below = timeline.overview
    assert len(above.spans) == len(timeline.grey_intervals) == 1 and "°/s²" in below.y.label
    for time in (120.0, 121.0):
        history.add_row(
            2, time, np.zeros(2), None, (0.5, 2.0, 0.0, 0.1, 0.0, 0.1, 0.2, 3.0, 4.0, 12.0)
        )
    charts = {chart.title: chart for chart in live_timeline(history, "roll").flight_charts}
    assert {"Roll", "Pitch", "Height"} <= charts.keys()
    # What was measured is bold, and lies over the rest.
    assert charts["Roll"].lines[-1].name == "measured"
    assert charts["Roll"].lines[-1].style is LineStyle.BOLD
    assert np.nanmax(charts["Height"].lines[0].y) == 12.0
    placed_timeline = live_timeline(history, "roll")
    assert placed_timeline.position.values.tolist() == [[3.0, 4.0, -12.0]] * 2
    assert placed_timeline.heading == approx(np.degrees(0.2))
    # The next boot of the autopilot may have another origin.
    history.advance(121.0, 0)
    history.advance(0.5, 1)
    for time in (0.5, 1.5):
        history.add_row(3, time, np.zeros(2), None, (nan,) * 7 + (0.0, 0.0, 2.0))
    assert live_timeline(history, "roll").position.values.tolist() == [[0.0, 0.0, -2.0]] * 2
    wind = live_timeline(history, "roll").flight_charts[-1].lines[0]
    assert (np.nanmin(wind.lower_edge), np.nanmax(wind.upper_edge)) == (0.0, 2.5)


@fixture
def live_document():
    """The page of a session that goes on, with twelve events."""
    events = [
        PageEvent(Event(float(time), Fact(VehicleFact.NO_VEHICLE_YET)), moment=f"moment {time} s")
        for time in range(12)
    ]
    history = LiveHistory()
    add_flight(history, 2.0)
    timeline = live_timeline(history, "roll")
    head = Head(Level.GOOD, {}, events, timeline, has_log=False, is_newest_first=True)
    return render_document("Live", "", [], head=head)


@mark.slow
def test_a_session_that_goes_on_lists_each_event_once_and_offers_no_fields_of_a_log(live_document):
    page = live_document
    assert [page.count(f"moment {time} s<") for time in range(12)] == [1] * 12
    assert "Learning and message rates" in page and "Plot any field" not in page
    # In flight a model is learned from the climb too, which is not settled.
    assert "what the model was learned from" in page and "Grey: settled flight" not in page


@mark.slow
def test_events_of_a_live_page_have_the_same_numbers_in_its_list_and_in_its_charts():
    """A crash and seven other events are numbered by time in the list and in the charts.

    What the session itself does has no number.
    """
    history = LiveHistory()
    early = Event(nan, Fact(VehicleFact.NO_VEHICLE_YET), reception=0.0)
    add_flight(history, 2.0)
    loss = Fact(Ending.CRASHED, time=0.5, height=0.0, speed=5.0, cause=None, mode="", word=None)
    alarm = Fact(SessionFact.ALARM, time=0.6, reason=loss)
    learning = Fact(SessionFact.BEING_LEARNED, time=0.8)
    other_facts = [
        Fact(ReportedEvent.MOTORS_ARMED, time=1.0 + index / 10, is_begun=True) for index in range(7)
    ]
    timed = [Event(fact.time, fact, reception=0.0) for fact in (alarm, learning, *other_facts)]
    history.events += [early, *timed]
    account = dict.fromkeys(TimeUse, 0.0)
    page = live_page("udpin:0", "roll", history, SessionStatus("1:1"), account, None)
    listed = re.findall(r'<span class="number">(\d+)</span> <span class="sentence">(.)', page)
    # The newest are first, with the newest alarm however old it is; what the session itself does has no number.
    assert [int(number) for number, _ in listed] == [8, 7, 6, 5, 1, 4, 3, 2]
    assert listed[4][1] == "A"
    timeline = re.search(r'"marks": *(\[\[.*?\]\])', page)
    assert '[0.6,"1",' in timeline[1].replace(" ", "")
    assert '[1.6,"8",' in timeline[1].replace(" ", "")
    assert "[0.8," not in timeline[1].replace(" ", "")


@mark.slow
def test_a_table_of_many_columns_is_on_a_telephone_too(tmp_path, browser):
    """Each row is a card there, whose cells say what they are."""
    header = [f"quantity {letter} (m/s)" for letter in "abcdefgh"]
    page = render_document("a.tlog", "", [Table(header, [["1.0 (0.9 to 1.1)"] * 8])])
    sizes = """(table => [table.parentElement.offsetHeight, table.parentElement.clientWidth, table.offsetWidth,
        getComputedStyle(table.querySelector("td:last-child"), "::before").content])(document.querySelector("table"))"""
    _, (height, room, width, label) = browser.shown(page, sizes, tmp_path, 390)
    assert height > 20 and width <= room
    assert "quantity h" in label or "attr(data-label)" in label
    _, (_, _, _, label_on_desk) = browser.shown(page, sizes, tmp_path, 1280)
    assert label_on_desk == "none"


@mark.slow
def test_a_live_page_on_a_telephone_has_lights_and_events_before_plots_and_map(tmp_path, browser):
    """A browser as wide as a telephone measures the order and places of the parts.

    The axis of a constant voltage must be narrow.
    """
    history = LiveHistory()
    history.motor_names = ("1", "2", "3", "4")
    for time in np.arange(100.0, 130.0):
        pose = (0.5, 2.0, 0.0, 0.1, 0.0, 0.1, 0.2, time / 100.0, 4.0, 12.0)
        motors = (0.69, 0.7, 0.71, 0.7)
        history.add_row(0, time, np.zeros(2), None, pose + motors)
        history.advance(time, 0)
        history.add_voltages({1: 12.6})
    armed = Fact(ReportedEvent.MOTORS_ARMED, time=110.0, is_begun=False)
    history.add_event(Event(110.0, armed, reception=0.0))
    account = dict.fromkeys(TimeUse, 0.0)
    doubted = Fact(EstimatorLight.FIX_MISSING, Level.BAD, satellites=3)
    status = SessionStatus("1:1", worst_lights={Light.ESTIMATOR: doubted})
    page = live_page("udpin:0", "roll", history, status, account, None, refresh_seconds=5.0)
    (tmp_path / "page.html").write_text(page)
    tops = """["#result", "#lights", ".events", "figure.chart", ".map"].map(
        name => document.querySelector(name).getBoundingClientRect().top)"""
    with browser.tab() as tab:
        tab.size(390)
        tab.open((tmp_path / "page.html").as_uri())
        tab.until("document.documentElement.charts.groups.flight")
        heights_of_parts = tab.run(tops)
        assert tab.run("document.querySelector('.map').closest('details').open") is False
        height = tab.run("document.documentElement.scrollHeight")
        # A phone closes further plots; one is drawn once it is in sight.
        ends = []
        tab.run("for (const part of document.querySelectorAll('details.more')) part.open = true")
        for title in ("Battery", "Motors, %"):
            chart = f"""document.documentElement.charts.groups.flight.charts.find(
                chart => chart.root.closest("figure").ariaLabel.includes("{title}"))"""
            tab.until(chart)
            tab.run(f"{chart}.root.closest('figure').scrollIntoView()")
            tab.until(f"{chart}.scales.y.max")
            ends.append(tab.run(f"[{chart}.scales.y.min, {chart}.scales.y.max]"))
        tab.run("scrollTo(0, 0)")
        # The lights are two columns, also below a headline that warns.
        lefts = tab.run("""new Set([...document.querySelectorAll("#lights div")].map(
            light => light.getBoundingClientRect().left)).size""")
        # They keep their places, whatever their levels are.
        places = tab.run("""[...document.querySelectorAll("#lights .figures > div")].map(light => {
            const { top, left } = light.getBoundingClientRect();
            return [Math.round(top / 20), left];
        })""")
    assert heights_of_parts == sorted(heights_of_parts)
    # Plots begin on the first screen of a telephone, and the map is folded below them.
    *_, top_of_plots, _ = heights_of_parts
    assert top_of_plots < 844 and height < 3 * 844
    assert places == sorted(places)
    assert lefts == 2
    # What stays the same has a narrow axis, on which a sag is seen.
    (least_voltage, largest_voltage), (least_command, largest_command) = ends
    assert 11.5 < least_voltage < 12.6 < largest_voltage < 13.7
    # The axis of motors that change little keeps a range of 40 %, so that a calm hover looks calm.
    assert 40.0 <= largest_command - least_command < 60.0


def test_the_light_of_a_live_pages_headline_does_not_say_it_again():
    fact = Fact(VehicleFact.NO_VEHICLE_YET)
    lights = {Light.POWER: fact, Light.WIND: Fact(Unjudged.NOT_JUDGED, reason=None)}
    head = Head(Level.BAD, lights, has_log=False)
    page = render_document("Live", "", [headline_sentence(fact)], head=head)
    assert (
        page.count(str(fact)) == page.count("See the headline.</dd>") == 1 and "Not judged." in page
    )
    with_figure = head._replace(light_figures={Light.POWER: "11.7 V (73 %)"})
    page = render_document("Live", "", [headline_sentence(fact)], head=with_figure)
    assert "11.7 V (73 %) (see the headline).</dd>" in page


def test_lights_of_a_log_refer_to_the_headline_instead_of_saying_it_again():
    lost = Fact(MotionEvent.POSITION_LOST, Level.BAD, time=22.0, duration=14.0)
    lights = {Light.TRACKING: lost, Light.ESTIMATOR: lost, Light.WIND: lost}
    page = render_document("a.tlog", "", [headline_sentence(lost)], head=Head(Level.BAD, lights))
    # None of them refers to another light, which would refer to the headline in turn.
    page = page.replace("\N{NO-BREAK SPACE}", " ")
    assert page.count(str(lost)) == 1 and page.count("See the headline.</dd>") == 3
    # On a phone such a light has one line.
    assert page.count(' class="reference">') == 3


def test_of_chapters_to_be_watched_the_one_of_the_headline_is_open():
    """Three lights are to be watched, and the headline is about the wind."""
    lights = {
        Light.VIBRATION: Fact(VibrationLight.VIBRATION_MEASURED, Level.WATCH),
        Light.TRACKING: Fact(Unjudged.NOT_JUDGED, Level.WATCH),
        Light.WIND: Fact(Unjudged.MULTIROTORS_ONLY, Level.WATCH),
    }
    chapters = [Chapter(title) for title in ("Three axes", "Vibration", "Wind", "Motors")]
    opened = [*unfold_chapters_of_warnings(chapters, lights, lights[Light.WIND])]
    assert [chapter.title for chapter in opened if not chapter.folded] == ["Wind"]
    assert [chapter.level for chapter in opened] == [*3 * [Level.WATCH], None]
    bad = {light: fact.replace(Level.BAD) for light, fact in lights.items()}
    opened = [*unfold_chapters_of_warnings(chapters, bad, lights[Light.WIND])]
    assert sum(not chapter.folded for chapter in opened) == 3


def test_every_chapter_in_which_something_is_bad_is_open():
    """Bad are two lights of one fact, the log, and what a chapter without a light judges by itself."""
    lost = Fact(Ending.CRASHED, Level.BAD, time=2.0)
    lights = {
        Light.MOTORS: lost,
        Light.TRACKING: lost,
        Light.WIND: Fact(Unjudged.NOT_JUDGED, Level.WATCH),
        Light.LOG: Fact(Unjudged.NOT_JUDGED, Level.BAD),
    }
    chapters = [
        Chapter("Three axes"),
        Chapter("Motors"),
        Chapter("Wind"),
        Chapter("Hardware", level=Level.BAD),
        Chapter(LOG_TITLE),
    ]
    opened = [*unfold_chapters_of_warnings(chapters, lights, lost)]
    closed = [chapter.title for chapter in opened if chapter.folded]
    assert closed == ["Wind"]
    assert [chapter.level for chapter in opened if not chapter.folded] == 4 * [Level.BAD]


def test_the_row_of_pictures_of_the_tuning_is_open_where_nothing_is_bad():
    chapters = [Chapter(TUNING_TITLE), Chapter("Vibration")]
    is_open = {}
    for level in (Level.GOOD, Level.WATCH, Level.BAD):
        lights = {Light.VIBRATION: Fact(VibrationLight.VIBRATION_MEASURED, level)}
        tuning, _ = unfold_chapters_of_warnings(chapters, lights, lights[Light.VIBRATION])
        is_open[level] = not tuning.folded
    assert is_open == {Level.GOOD: True, Level.WATCH: True, Level.BAD: False}


DRAWN_NUMBERS = """(async () => {
let chart, texts = [];
// The plots are drawn after the page has loaded.
while (!(chart = document.documentElement.charts?.groups.flight?.charts[0]))
  await new Promise(done => setTimeout(done, 20));
const original = chart.ctx.fillText.bind(chart.ctx);
chart.ctx.fillText = (text, left, bottom) => {
  texts.push([String(text), bottom <= chart.bbox.top]);
  original(text, left, bottom);
};
chart.redraw(false);
return [texts, chart.over.clientHeight];
})()"""


@mark.slow
def test_the_numbers_of_events_stand_above_a_plot_that_can_be_read(tmp_path, browser):
    history = LiveHistory()
    add_flight(history, 10.0)
    timeline = live_timeline(history, "roll")
    start, end = timeline.span
    # The second and the third are too near to have a number each.
    times = (start + 0.2 * (end - start), end - 0.3, end - 0.25)
    events = tuple(Event(time, Fact(VehicleFact.NO_VEHICLE_YET)) for time in times)
    timeline = timeline._replace(events=events, event_labels=("1", "2", "3"))
    head = Head(Level.GOOD, {}, timeline=timeline)
    _, (texts, height) = browser.shown(
        render_document("x", "", [], head=head), DRAWN_NUMBERS, tmp_path, 1280
    )
    assert [text for text, is_above in texts if is_above] == ["1", "2–3"]
    assert height >= 90


def test_a_section_shows_its_sentence_and_opens_where_it_is_to_be_watched():
    """Of two sections one has a rating to be watched, which is open and shows the rating."""
    warm = Fact(
        HardwareFact.TEMPERATURES_MEASURED,
        Level.UNKNOWN,
        names=("IMU",),
        temperatures_least=(20.0,),
        temperatures=(25.0,),
    )
    gaps = Fact(
        HardwareFact.RECORDING_MEASURED,
        Level.WATCH,
        time=15.0,
        step=0.1,
        longest_gap=1.5,
        dropouts=0,
    )
    sections = [Section("Temperatures", warm), Section("Recording", gaps), Section("More plots")]
    text = render_document("a.tlog", "", [], [Chapter("Hardware", folded=True, sections=sections)])
    temperatures, recording, more_plots = text.split('<details class="part"')[1:]
    assert "In flight IMU 20 to 25 °C." in temperatures and "rating" not in temperatures
    assert recording.startswith(" open>") and '"rating watch"' in recording
    assert "longest gap in flight 1.5 s, from 15.0 s." in recording
    assert more_plots.startswith(">\n<summary><strong>More plots</strong></summary>")


SPAN = """(async () => {
const root = document.documentElement, tick = () => new Promise(done => setTimeout(done, 50));
while (!root.charts.groups.flight?.span) await tick();
const opened = root.charts.groups.flight.span;
document.getElementById("whole").click();
return [opened, root.charts.groups.flight.span];
})()"""


@mark.slow
def test_the_plots_of_a_lost_flight_open_around_the_loss(tmp_path, browser):
    """The vehicle crashes at 77 s: plots show 62 s to 80 s at first, and paper has small ones of the whole flight."""
    time = np.linspace(0.0, 80.0, 200)
    chart = over_time("Roll", "°", [Line("roll", "#1f7ad6", time, time)])
    loss = Fact(
        Ending.CRASHED, time=77.0, height=0.0, speed=5.0, cause=None, mode="", word=None, boot=0
    )
    head = Head(
        Level.BAD, {}, [PageEvent(Event(77.0, loss))], timeline=Timeline((chart,), (0.0, 80.0))
    )
    page = render_document("x", "", [], head=head)
    _, (opened, whole_range) = browser.shown(page, SPAN, tmp_path, 1280)
    assert (opened, whole_range) == ([62.0, 80.0], [0.0, 80.0])
    for head_without_span in (head._replace(has_log=False), head._replace(events=())):
        assert head_without_span.opening_span is head_without_span.whole_flight is None
    ((whole_flight,),) = head.whole_flight.columns
    assert [span[:2] for span in whole_flight.spans] == [(62.0, 80.0)]
    assert whole_flight.group != chart.group
    assert whole_flight.lines == chart.lines and whole_flight.x.limits == (0.0, 80.0)
    in_other_boot = [PageEvent(Event(77.0, loss), is_on_clock_of_charts=False)]
    assert head._replace(events=in_other_boot).opening_span is None


@mark.slow
def test_what_happened_comes_before_plots_and_a_phone_closes_further_plots(tmp_path, browser):
    """A browser opens a page with six charts with the width of a telephone and of a desktop.

    The events stand above the charts in both.
    """
    time = np.linspace(0.0, 10.0, 50)
    charts = [
        over_time(f"Battery {n}", "V", [Line("voltage", "#1f7ad6", time, time)]) for n in range(6)
    ]
    head = Head(
        Level.GOOD,
        {},
        [PageEvent(Event(2.0, Fact(MotionEvent.FELL, time=2.0, speed=6.0)))],
        timeline=Timeline(tuple(charts), (0.0, 10.0)),
    )
    (tmp_path / "page.html").write_text(render_document("x", "", [], head=head))
    parts = """["#result", "#flight .events", "#flight figure.chart"].map(
        name => document.querySelector(name).getBoundingClientRect().top)"""
    is_open = "document.querySelector('#flight .more').open"
    all_tops = []
    with browser.tab() as tab:
        tab.size(390)
        tab.open((tmp_path / "page.html").as_uri())
        tab.until("document.documentElement.charts.groups.flight")
        tops, is_open_on_phone = tab.run(f"[{parts}, {is_open}]")
        all_tops.append(tops)
        tab.size(1280)
        tab.until(is_open)
        all_tops.append(tab.run(parts))
    for tops in all_tops:
        assert tops == sorted(tops)
    assert not is_open_on_phone


def test_a_phone_opens_the_axis_that_the_light_is_about():
    columns = dict.fromkeys(("roll", "pitch"), ())
    swing = Fact(MotionEvent.ATTITUDE_SWUNG, subject="pitch")
    assert Group.of_axes(columns, swing).first_name == "pitch"
    assert Group.of_axes(columns, swing.replace(subject="motor 2")).first_name == "roll"
