"""The page: one file that fetches nothing, escapes everything, zooms, prints, and fits a narrow and a wide window."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from browser import FITS, HOSTILE, shown
from live_rows import flown
from made_up_analysis import assessment, physical
from numpy.testing import assert_allclose

from mavdem.assessment.assess import assess
from mavdem.condition.inventory import inventory
from mavdem.facts import Fact
from mavdem.facts.event import Event
from mavdem.facts.session import Rows, Spent, VehicleFact
from mavdem.ingest import read_log
from mavdem.live import SessionStatus
from mavdem.live.history import LiveHistory
from mavdem.report.blocks import Sentence, Table
from mavdem.report.figures.series import still
from mavdem.report.figures.style import band, picture
from mavdem.report.page import Chapter, Picture, document, flight_page, live_page, log_page
from mavdem.report.palette import PREDICTED
from mavdem.report.screen import analysis_blocks
from mavdem.report.timeline import Line, live_timeline

LOG = Path(__file__).parents[2] / "logs" / "ardupilot_wind5_steps.tlog"
NAME = f"{HOSTILE}.tlog"
VOID = {"meta", "path", "use", "rect", "br", "image"}
NOTHING = dict.fromkeys(Spent, 0.0)


class Balanced(HTMLParser):
    """Raises ``AssertionError`` for tags that do not close in order, and collects them."""

    def __init__(self, text):
        super().__init__()
        self.open: list[str] = []
        self.seen: list[str] = []
        self.ids: list[str] = []
        self.feed(text)
        assert not self.open

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
        assert tag in VOID or self.open.pop() == tag


def wave(label="measured", samples=20_000):
    with picture() as figure:
        axes = figure.subplots()
        time = np.linspace(0, 60, samples)
        values = np.sin(time) + 0.1 * np.random.default_rng(1).normal(size=samples)
        axes.plot(time, values, label=label[:60])
        band(axes, time, values - 0.3, values + 0.3, PREDICTED)
        axes.plot(time[:100], values[:100], marker="o")
        axes.set_xlabel("0.00125 s")
        axes.legend()
    return figure


def refuse():
    raise ValueError("there is no wind")


def page(name="flight.tlog"):
    pictures = [Picture(name, name, lambda: wave(name)) for _ in range(2)]
    blocks = [
        Sentence("", lead=f"Good: {name}"),
        Sentence(f"`mavdem learn {name}`", "Caution:"),
        Table(
            ["motor", "control effectiveness, °/s² per µs", "status"],
            [[name, "8.3 ± 0.7", "reported"]] * 4,
        ),
    ]
    chapters = [
        Chapter("Pictures", pictures=[*pictures, Picture("Wind", "", refuse)]),
        Chapter(name, [Table([name], [[name]])], folded=True),
    ]
    return document(name, name, blocks, chapters, [(name, "8.3 ± 0.7")] * 7)


@pytest.fixture(scope="module")
def pages():
    return page(), page(NAME + "x" * 200)


@pytest.mark.slow
def test_the_same_result_makes_the_same_bytes_small_though_its_lines_are_long(pages):
    assert page() == pages[0]
    assert len(pages[0]) < 250_000


@pytest.mark.slow
def test_tags_close_in_order_ids_are_unique_and_nothing_is_fetched_or_run(pages):
    seen = Balanced(pages[0])
    assert len(seen.ids) == len(set(seen.ids)) and {"svg", "table", "details"} <= set(seen.seen)
    assert not {"script", "link", "img", "iframe"} & set(seen.seen)
    fetched = (
        pages[0]
        .replace("http://www.w3.org/2000/svg", "")
        .replace("http://www.w3.org/1999/xlink", "")
    )
    assert "://" not in fetched and "@import" not in fetched
    # What comes from a log is text.
    assert not {"script", "b"} & set(Balanced(pages[1]).seen)


def test_what_cannot_be_drawn_says_why_and_letters_follow_the_theme(pages):
    assert pages[0].count("<svg") == 2 and "<strong>Wind:</strong> there is no wind." in pages[0]
    assert 'figure [style*="fill: #24292f"] { fill: var(--ink) !important; }' in pages[0]
    assert re.search(r'<text style="[^"]*fill: #24292f', pages[0]) and ">0.00125 s<" in pages[0]


@pytest.mark.slow
@pytest.mark.parametrize(("which", "width"), [(0, 1600), (1, 500)])
def test_a_browser_shows_it_without_a_complaint_and_without_scrolling_sideways(
    which, width, pages, tmp_path
):
    title, fits = shown(pages[which], FITS, tmp_path, width)
    assert fits and title == ("flight.tlog", NAME + "x" * 200)[which]


@pytest.mark.slow
def test_every_column_of_the_motors_is_shown_and_no_line_ends_before_a_percent_sign(tmp_path):
    text = document("flight.tlog", "", analysis_blocks(assessment(physical())))
    widths = (
        "return [...document.querySelectorAll('.scroll')].map(e => e.scrollWidth - e.clientWidth)"
    )
    assert [shown(text, widths, tmp_path, width)[1] for width in (500, 1200)] == 2 * [[0, 0, 0]]
    assert not re.search(r"\d ?%", text.split("<section")[1])


@pytest.fixture(scope="module")
def analysed():
    """The assessment of a log."""
    log = read_log(LOG)
    return assess(log, axis="roll")


@pytest.mark.slow
def test_two_axes_of_a_flight_of_a_fleet_fit_into_a_small_page_that_leads_back(analysed):
    two = dict.fromkeys(("roll", "pitch"), analysed.analysis)
    text = flight_page("flight.tlog", replace(analysed, analyses=two))
    assert len(text.encode()) < 300_000 and 2 <= text.count("<svg") <= 4
    assert '<a href="../index.html">' in text and "Prediction of pitch" in text
    ids = Balanced(text).ids
    assert len(ids) == len(set(ids))


@pytest.fixture(scope="module")
def flight(analysed):
    """The page of a log with all chapters."""
    return log_page(Sentence("A flight.", f"{HOSTILE}:"), analysed, inventory(analysed.log))


ZOOM = """
const root = document.getElementById("timeline"), charts = root.charts, over = charts[2].over;
const box = over.getBoundingClientRect(), said = [charts.length];
const spans = async () => {
  await new Promise(done => setTimeout(done, 50));
  return charts.map(chart => chart.scales.x.max - chart.scales.x.min);
};
for (const [kind, x, on] of [["move", 1, over], ["down", 1, over], ["move", 2, over], ["up", 2, document]]) {
  const at = {clientX: box.left + x * box.width / 4, clientY: box.top + 20, movementX: 9, bubbles: true};
  on.dispatchEvent(new MouseEvent(`mouse${kind}`, at));
}
const zoomed = await spans();
document.getElementById("whole").click();
const fits = document.documentElement.scrollWidth <= innerWidth;
return [zoomed, await spans(), getComputedStyle(document.querySelector(".still")).display, fits];
"""


@pytest.mark.slow
@pytest.mark.parametrize(("width", "scheme"), [(500, "1"), (1600, "0")])
def test_dragging_over_one_plot_zooms_all_and_a_button_shows_the_whole_flight(
    width, scheme, flight, tmp_path
):
    # dark and light
    options = "--virtual-time-budget=1000", f"--blink-settings=preferredColorScheme={scheme}"
    title, (zoomed, whole, picture, fits) = shown(flight, ZOOM, tmp_path, width, *options)
    assert (
        fits and len(whole) == 6 and picture == "none" and title == HOSTILE
    )  # modes, three angles, motors and wind torque
    assert_allclose(zoomed, 15.0, atol=0.5)
    assert_allclose(whole, 60.0, atol=0.5)


@pytest.mark.slow
def test_a_page_with_all_chapters_is_small_fetches_nothing_and_prints_on_four_sheets(
    flight, tmp_path
):
    seen = Balanced(flight)
    assert (
        seen.seen.count("script") == 3
        and len(seen.ids) == len(set(seen.ids))
        and "default-src 'none'" in flight
    )
    assert len(flight.encode()) < 1_200_000
    shown(
        flight,
        "return 0",
        tmp_path,
        1600,
        f"--print-to-pdf={tmp_path / 'page.pdf'}",
        "--no-pdf-header-footer",
    )
    assert len(re.findall(rb"/Type\s*/Page\b", (tmp_path / "page.pdf").read_bytes())) == 4


def test_a_line_that_is_thinned_keeps_its_peaks_and_its_gaps():
    time = np.arange(0, 100, 0.01)
    time = time[(time < 40) | (time > 60)]
    values = np.sin(time)
    values[1234] = 9.0
    values[4321] = -9.0
    found, _ = Line("x", "", time, values).at(np.linspace(0, 100, 501))
    assert np.nanmax(found) == 9.0 and np.nanmin(found) == -9.0 and np.isnan(found[205:295]).all()
    assert_allclose(found[:50], np.sin(np.linspace(0, 100, 501)[:50]), atol=0.2)


def test_a_live_flight_is_drawn_in_degrees_with_what_was_trained_on_and_has_its_events():
    history = LiveHistory()
    flown(history, 2.0)
    flown(history, 2.0, segment=1, start=105.0, learnt=False)
    history.events += [
        Event(np.nan, Fact(VehicleFact.NO_VEHICLE_YET)),
        Event(12.25, Fact(Rows.MESSAGES_RESUMED, subject="messages", duration=3.0)),
    ]
    timeline = live_timeline(history, "roll")
    above, below = still(timeline).axes
    assert np.nanmax(timeline.rows[0].lines[0].values) == pytest.approx(
        np.rad2deg(history.rows[:, 2].max())
    )
    assert len(above.patches) == len(timeline.trained) == 1
    assert "°/s²" in below.get_ylabel()
    text = live_page(
        "udpin:<b>", "roll", history, SessionStatus("1:1"), NOTHING | {"learned": 53.0}, None
    )
    assert str(history.events[1].fact) in text and "udpin:&lt;b&gt;" in text and "<svg" in text
    assert "NaN" not in text.split('id="timeline-data"')[1].split("</script>")[0]
    # A link without a vehicle has a page too.
    text = live_page(
        "udpin:0",
        "roll",
        LiveHistory(),
        SessionStatus(obstacle=Fact(VehicleFact.NO_VEHICLE_YET)),
        NOTHING,
        None,
    )
    assert "No vehicle found yet." in text
