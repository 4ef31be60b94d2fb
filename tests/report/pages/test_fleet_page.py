"""The index of a fleet: its words, charts and table, in a browser with ten thousand flights too."""

import json
import random
import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
from browsing import FITS, HOSTILE
from date_searches import FLIGHT_DATES, FOUND_BY_DATE
from fleet_rows import START, fleet_rows, flight_row
from numpy.testing import assert_allclose
from pytest import approx, mark

from mavdem.facts import Level
from mavdem.facts.lights import Light
from mavdem.fleet.flights import group_into_flights
from mavdem.fleet.row import SYSTEM_ID_BASIS, FlightRow
from mavdem.report.blocks import Sentence
from mavdem.report.charts.chart import LineStyle
from mavdem.report.charts.vehicle_charts import vehicle_groups
from mavdem.report.flight_lines import COLUMNS, file_name
from mavdem.report.heading import MAX_LISTED_LENGTH
from mavdem.report.pages import fleet_page as page_of_fleet
from mavdem.report.pages.environment import environment, render_page
from mavdem.report.palette import BAD
from mavdem.report.vehicle_summary import vehicle_summaries


def fleet_page(rows, changes=None):
    """Returns the index page of a fleet with these rows."""

    def charts(name):
        rows_of_vehicle = [row for row in rows if row.vehicle == name]
        return page_of_fleet.vehicle_charts(rows_of_vehicle, healthy_logs=())

    return page_of_fleet.fleet_page(vehicle_summaries(rows), changes, charts)


def parts(text):
    """The HTML of each vehicle, by its name."""
    listing = text.partition('<div class="list">')[2].partition("</section>")[0]
    _, *pieces = re.split('<(?:details|div) class="vehicle"', listing)
    return {re.search(r"<b [^>]*>(.*?)</b>", piece)[1]: piece for piece in pieces}


@mark.slow
def test_the_same_rows_make_the_same_bytes_in_whatever_order_they_come():
    # There is one flight of each vehicle, without a figure, and a second one of the first.
    rows = fleet_rows(6)
    shuffled = random.Random(1).sample(rows, len(rows))
    assert fleet_page(rows) == fleet_page(shuffled)


def table_of(text):
    """What the script of a page makes its lines of."""
    return json.loads(re.search(r'id="rows" type="application/json">(.*?)</script>', text)[1])


@mark.slow
def test_who_is_in_trouble_stands_first_and_open_and_others_are_folded():
    """One of five vehicles has a fault: its section is the first, and the only open one."""
    text = fleet_page(fleet_rows(20))
    sections = parts(text)
    assert list(sections) == ["quad-1", "quad-0", "quad-2", "quad-3", "quad-4"]
    opened = [name for name, part in sections.items() if " open>" in part.split("<summary")[0]]
    assert opened == ["quad-1"]
    assert "1 of 5 vehicles needs a look: quad-1 (motor" in text
    assert ">motor 3 works harder.</span>" in sections["quad-1"]
    # The summary above has the reason and the next step: the unfolded section adds how often it was found.
    body_of_open_section = sections["quad-1"].partition("</summary>")[2]
    assert "motor 3 works harder" not in body_of_open_section
    assert "Next:" not in body_of_open_section and "a fault in 1" in body_of_open_section
    # That nothing is wrong is said once, at the top: the vehicle's line has nothing to add.
    assert "<span>4 flights<" in sections["quad-0"]
    assert '2026-01-08</a></span><span class="words"></span>' in sections["quad-0"]
    assert "Quadrotor · ArduCopter V4.5" in sections["quad-0"]
    assert '<path class="good" d="M8 0v1h.8v-1zM9' in sections["quad-0"]
    assert 'aria-label="Latest flights: 1 bad and 3 good"' in sections["quad-1"]
    assert "<title>from 2026-01-08: 1 bad and 4 good</title>" in text
    assert "It is cut off at" in text and "<td>3</td>" in text.replace(' class="words"', "")


@mark.slow
def test_a_fleet_without_a_flight_and_one_with_a_single_flight_have_a_page():
    """Fleets with no flight, one flight, or flights of unknown vehicles."""
    for rows in ([], [FlightRow(file="a.bin", status="It is empty.")]):
        assert "No log holds a flight" in fleet_page(rows)
    alone = fleet_page([flight_row("quad", 0)])
    assert "<figure" not in alone and list(parts(alone)) == ["quad"]
    # Flights that do not say whose they are are drawn as nobody's.
    text = fleet_page([flight_row("unknown", number) for number in range(4)])
    assert parts(text) == {} and "they are not compared" in text


@mark.slow
def test_a_date_in_the_future_is_not_on_the_axis_of_dates():
    future = datetime.now(UTC) + timedelta(days=700)
    rows = [flight_row("quad", number) for number in range(3)]
    rows += [flight_row("sim", 0, date=future), flight_row("sim", 1, date=future)]
    text = fleet_page(rows)
    assert f"{future:%Y-%m-%d}" not in text
    assert f"clock in {future.year}" in table_of(text)["rows"][-1]
    assert '<span class="days soft"><span>2026-01-05</span>' in text


def test_a_lost_flight_without_figures_needs_a_look():
    """A flight that was lost has no settled flight, other logs have no flight at all."""
    lost = {"status": "No settled flight.", "headline": "Lost at 70.9 s.", "headline_level": "bad"}
    lost |= {"tier": None}
    unused = [
        FlightRow(file=number, status=f"Armed for {number} s.", status_code="never_airborne")
        for number in "12"
    ]
    rarer = FlightRow(file="3", status="No inputs.", status_code="motors_missing")
    text = fleet_page([flight_row("quad", 0, health="unknown", **lost), rarer, *unused])
    assert text.index("Never airborne</td>") < text.rindex("No inputs.</td>")
    assert "1 vehicle needs a look: quad (" in text and text.count("ost at 70.9 s") > 1
    assert (
        "Not compared with other flights. No settled flight." in text
        and "Its log allows no figures (1)." in text
    )
    assert '<span class="badge bad">bad<' in text and "pages/quad-0.html" in text
    # Flights without a fault before it are not an all-clear below the vehicle's mark.
    text = fleet_page([flight_row("quad", 0), flight_row("quad", 1, health="unknown", **lost)])
    assert "Compared with its other flights: no drift and no fault in 1 log that could" in text


def test_bad_flights_whose_vehicle_is_not_known_are_listed():
    bad = {"headline": "Lost at 70.9 s.", "headline_level": "bad"}
    rows = [flight_row("unknown", number, **(bad if number % 2 else {})) for number in range(4)]
    listed = fleet_page(rows).partition("Logs of bad flights whose vehicle is not known")[2]
    assert listed.partition("</ul>")[0].count("Lost at 70.9 s.") == 2
    assert "2 logs of bad flights" in fleet_page(rows)


def test_a_fault_that_only_the_fleet_shows_is_the_note_of_its_flight():
    health_columns = {"health": "fault", "health_reason": "Motor 3 lost 20 % of its thrust."}
    sound = {"headline": "Nothing wrong found.", "headline_level": "good"}
    flights = [flight_row("quad", 0, **sound), flight_row("quad", 1, **sound, **health_columns)]
    text = fleet_page(flights)
    notes = [str(row) for row in table_of(text)["rows"]]
    assert "Motor 3 lost" in notes[0] and "Nothing wrong" not in notes[0]
    assert "Nothing wrong" in notes[1]
    # The page of a single vehicle states its finding once: before the table of flights, the summary alone has it.
    assert text.partition('id="every_flight"')[0].count("Motor 3 lost") == 1


def test_flights_of_one_log_are_told_apart_by_their_vehicles():
    """Of a log with two vehicles each flight has a line, and its finding is shown in few words."""
    headline = "Motor 3 (front left) lost 19 to 41 % of its thrust at 47 s (probability > 0.99): it works 27 % harder "
    headline += "(20 to 31 %) than in 3 of the vehicle's first flights, taken for healthy."
    rows = [
        flight_row(f"px4-{number}", 0, file="/logs/two.tlog", key="two", headline=headline)
        for number in (2, 3)
    ]
    rows.append(flight_row("quad", 0))
    table = table_of(fleet_page(rows))
    names = {cells[2] for cells in table["rows"]}
    assert names == {"two.tlog, px4-2", "two.tlog, px4-3", "0000.ulg"}
    finding = headline.partition(":")[0] + "."
    assert table["findings"].count(finding) == 2


def test_what_changed_since_the_baseline_stands_with_its_vehicle():
    rows = [flight_row("quad-2", number) for number in range(2)]
    text = fleet_page(rows, {"quad-2": [Sentence("motor 3's effect −18 % ± 6 %.", "Changed:")]})
    assert (
        "motor 3&#39;s effect −18\N{NO-BREAK SPACE}% ± 6\N{NO-BREAK SPACE}%."
        in parts(text)["quad-2"]
    )


def panels(rows):
    """The charts of a vehicle, by title."""
    groups = vehicle_groups(group_into_flights(rows))
    return {chart.title: chart for group in groups for (chart,) in group.columns}


def test_battery_and_load_of_the_motors_are_followed_over_the_flights():
    voltages = {"voltage_start": 12.5, "collective": 0.4, "headroom": (0.5, 0.2, 0.4, 0.4)}
    rows = [
        flight_row("quad", number, voltage_end=11.5 - number, **voltages) for number in range(2)
    ]
    drawn = panels(rows)
    at_start, at_end = drawn["Battery (V)"].lines
    assert_allclose((at_start.y, at_end.y), [[12.5, 12.5], [11.5, 10.5]])
    assert_allclose(drawn["Mean motor output (%)"].lines[0].y, 40)
    assert_allclose(drawn["Least headroom of a motor (%)"].lines[0].y, 20)
    # With a voltage the output is that at equal voltage: a sagging battery raises it, and is no change of the motors.
    sagging = [
        replace(row, collective=collective, voltage_mean=voltage)
        for row, collective, voltage in zip(rows, (0.4, 0.44), (12.0, 12.0 / 1.1), strict=True)
    ]
    title = "Output at equal voltage (% of the first)"
    assert_allclose(panels(sagging)[title].lines[0].y, 100)


def test_the_healthy_flights_that_others_are_compared_with_are_marked_and_named():
    """A fault has the mark of lists, also in a flight that a user has named as healthy."""
    rows = [flight_row("quad", number, key=f"{number}-1") for number in range(4)]
    rows[3] = replace(rows[3], health="fault")
    *_, last_group = groups = vehicle_groups(group_into_flights(rows), (), {"0", "1"})
    marks = groups[0].columns[0][0].marks
    assert [(mark.x, mark.name) for mark in marks] == [(0, "✓"), (1, "✓"), (3, "■")]
    files = [file_name([row]) for row in rows[:2]]
    assert f"are compared, {files[0]} and {files[1]}." in last_group.caption
    # A phone folds all charts of this group but the first.
    assert last_group.names[0] == last_group.first_name == last_group.columns[0][0].title


def test_months_without_a_flight_are_marked_between_the_flights():
    """The third flight is 122 days after the second; a log without a date stands in no pause."""
    dates = [START, START + timedelta(days=40), START + timedelta(days=162), None]
    rows = [flight_row("quad", number, date=date) for number, date in enumerate(dates)]
    assert [mark.x for mark in panels(rows)["Trim deviation (%)"].marks] == [1.5]
    motors_group, *_, last_group = vehicle_groups(group_into_flights(rows))
    assert "Grey dashed lines: 4 months without a flight." in last_group.caption
    # How much harder a suspected motor works is stated over its own output, and drawn over the mean of all.
    assert motors_group.caption == ""
    rows = [replace(row, suspect_motor=2) for row in rows]
    assert "over the mean of all" in vehicle_groups(group_into_flights(rows))[0].caption


def test_vehicles_are_sorted_by_what_needs_work_first():
    latest = {
        "sound": {"headline_level": "good"},
        "watched": {"headline_level": "watch", "headline": "It vibrates."},
        "drifting": {"health": "drift"},
        "crashed": {
            "headline_level": "bad",
            "headline_rank": 0,
            "headline": "It crashed.",
        },
        "faulty": {"health": "fault"},
    }
    rows = [flight_row(name, 0, **columns) for name, columns in latest.items()]
    assert [*parts(fleet_page(rows))] == ["crashed", "faulty", "drifting", "watched", "sound"]


def test_a_fault_is_marked_and_an_unknown_is_a_gap_or_of_all_flights_no_panel():
    """The second of three flights has no damping, and none has a motor time constant."""
    health_and_probability = zip(("ok", "ok", "fault"), (0.5, None, 0.6), strict=True)
    unknown = {"lag": None, "effect_status": "not identifiable", "vibration": (1.0, 2.0, 3.0)}
    rows = [
        flight_row("quad", number, health=health, damping=damping, **unknown)
        for number, (health, damping) in enumerate(health_and_probability)
    ]
    drawn = panels(rows)
    chart = drawn["Rate damping (1/s)"]
    assert [(mark.x, mark.name, mark.colour) for mark in chart.marks] == [(2.0, "■", BAD)]
    line = chart.lines[0]
    ends = [line.y, line.lower_edge, line.upper_edge]
    assert_allclose(np.transpose(ends), [[0.5, 0.3, 0.7], [np.nan] * 3, [0.6, 0.4, 0.8]])
    assert "Motor time constant (ms)" not in drawn
    *axes, limit = drawn["Vibration, first IMU (m/s²)"].lines
    assert [line.name for line in axes] == ["x", "y", "z"]
    assert limit.name == "watch above 15" and set(limit.y) == {15.0}
    # PX4's limit is half of gravity.
    levels = panels([flight_row("quad", number, vibration=(2.0,)) for number in range(2)])
    *_, limit = levels["Vibration level, first IMU (m/s²)"].lines
    assert limit.name == "watch above 4.91"


def test_each_motor_is_followed_over_flights_and_the_suspected_one_is_labelled():
    suspected = {"health": "drift", "suspect_motor": 3}
    sound, weak = flight_row("quad", 0), flight_row("quad", 1, **suspected)
    later_sound = flight_row("quad", 1)
    lines = panels([sound, weak])["Trim deviation (%)"].lines
    assert {line.style for line in lines} == {LineStyle.JOINED_DOTS}
    assert [line.remark for line in lines] == ["", "", "motor 3, suspected", ""]
    assert not any(line.remark for line in panels([sound, later_sound])["Trim deviation (%)"].lines)


def test_motors_over_flights_are_drawn_without_what_lean_in_wind_explains():
    """Flight 1 leans, which asks for deviations of 9 %; in flight 2, in still air, motor 1 is weak."""
    places = {"positions": ((1, 1), (-1, -1), (1, -1), (-1, 1)), "spins": (1, 1, -1, -1)}
    errors = {"balance_error": (0.002,) * 3, "lean_effect_error": (0.01,) * 6}
    effects = {"lean_effect": (0.9, 0.0, 0.0, 0.0, 0.0, 0.0)}
    lean = 0.1
    flights = [
        {"balance": (0.0, 0.0, 0.0), "balance_lean": (0.0, 0.0)},
        {"balance": (0.9 * lean, 0.0, 0.0), "balance_lean": (lean, 0.0)},
        {"balance": (-0.03, 0.03, 0.03), "balance_lean": (0.0, 0.0)},
        {"balance": None, "balance_lean": None},
    ]
    rows = [
        flight_row("quad", number, **places, **errors, **effects, **flight)
        for number, flight in enumerate(flights)
    ]
    trims = np.array([line.y for line in panels(rows)["Trim without lean (%)"].lines])
    assert abs(trims[:, 0]).max() < 0.1
    assert abs(trims[:, 1]).max() < 1
    assert trims[:, 2].argmax() == 0 and 7 < trims[0, 2] < 11
    assert np.isnan(trims[:, 3]).all()
    # A vehicle leans because of a motor that fails in flight: its trim without lean is not known.
    rows[2] = replace(rows[2], failed_motor=1)
    for line in panels(rows)["Trim without lean (%)"].lines:
        assert_allclose(np.isnan(line.y), [False, False, True, True])


def test_flights_of_one_day_are_told_apart_by_their_times():
    first = flight_row("quad", 0)
    rows = [first, flight_row("quad", 1, date=first.date + timedelta(hours=1))]
    names = panels(rows)["Trim deviation (%)"].x.names
    assert names == ("2026-01-05 09:00", "2026-01-05 10:00")


def test_time_constants_of_motors_and_of_the_demand_are_not_one_line():
    by_motors = [
        flight_row("quad", number, inputs="motors", input_unit="µs") for number in range(2)
    ]
    demand = {"inputs": "demand", "input_unit": ""}
    drawn = panels([*by_motors, *(flight_row("quad", number, **demand) for number in (2, 3))])
    for unit, expected_flags in (
        ("µs", [True, True, False, False]),
        ("unit of demand", [False, False, True, True]),
    ):
        line = drawn[f"Motor time constant (ms), per {unit}"].lines[0]
        assert np.isfinite(line.y).tolist() == expected_flags


def hostile():
    """Returns rows of flights whose every text contains HTML, and one of an unknown state."""
    names = {
        "motors": tuple(rf"{HOSTILE}$\nothing{{$ {number}" for number in range(4)),
        "health_reason": HOSTILE,
        "warnings": (HOSTILE,),
    }
    rows = [
        flight_row(
            HOSTILE,
            number,
            file=f"/logs/{HOSTILE}{number}.tlog",
            page="javascript:alert(1)",
            **names,
        )
        for number in range(3)
    ]
    rows[0] = replace(rows[0], health="fault")
    return [*rows, FlightRow(file=HOSTILE, key=HOSTILE, status=HOSTILE, vehicle=HOSTILE)]


def test_marks_that_turn_text_around_are_replaced_in_the_data_of_scripts():
    template = environment().from_string("{{ text | tojson }}")
    text = "\u202eevil\x1b\x7f \\u202e\n\u00e9"
    assert json.loads(render_page(template, text=text)) == "\ufffdevil\ufffd\ufffd \\u202e\n\u00e9"


@mark.slow
def test_what_comes_from_a_log_is_text_and_no_script_scheme_is_linked():
    text = fleet_page(hostile())
    assert text.count("<script>") == 5 and "<b><" not in text and "<script>document" not in text
    assert "javascript:" not in text and '"javascript%3Aalert%281%29"' in text
    # SVG's own names do not count.
    assert set(re.findall(r"\w+://[^/]*", text)) == {"https://github.com"}
    assert "@import" not in text and "src=" not in text and "\\nothing" in text


def test_a_serial_number_stands_behind_the_frame_and_a_repeated_sentence_once_with_its_count():
    serial = "001a002f3039511333333539"
    unjudged = {"health": "unknown", "health_reason": "Too few flights."}
    rows = [flight_row(name, 0, **unjudged) for name in (serial, "quad", "hexa")]
    rows.append(flight_row("crashed", 0, health="unknown", health_reason="It fell."))
    text = fleet_page([*rows, flight_row("judged", 0), flight_row("judged too", 0)])
    assert f'<b title="{serial}">Quadrotor 001a…\N{WORD JOINER}333539</b>' in text
    assert '<small class="soft serial">0000.ulg</small>' in text
    sections = "".join(parts(text).values()).partition("Why motors")[0]
    assert "Not compared with other flights" not in sections
    # The line of a vehicle that has flown once has all, and nothing unfolds.
    assert text.count('<div class="vehicle">') == 4 and text.count('<details class="vehicle"') == 2
    # The vehicles of all reasons add up to those that the summary counts.
    reasons = re.findall(r">(\d)</td><td[^>]*>([^<]*\.)</td>", text)
    assert reasons == [("3", "Too few flights."), ("1", "It fell.")]
    assert "Motors not compared between flights:</strong> 4 vehicles." in text
    assert ">No drift and no fault in 1 log that could be judged.</td>" not in text


def seconds_of(duration):
    """The seconds of a duration such as "1:06"."""
    minutes, seconds = duration.split(":")
    return 60 * int(minutes) + int(seconds)


SORTED = """(() => {
const body = document.getElementById('flights').tBodies[0];
const lines = () => [...body.rows].filter(row => row.dataset.at !== undefined);
const cells = place => lines().map(row => row.cells[place].textContent);
const heads = [...document.querySelectorAll('#flights th button')];
const times = heads.findIndex(one => one.textContent.startsWith('time'));
const type = words => {
  filter.value = words;
  filter.dispatchEvent(new Event('input'));
};
const found = {dates: cells(2)};
scrollTo(0, body.getBoundingClientRect().top + scrollY);
heads[times].click();
found.rising = cells(times);
found.state = [...document.querySelectorAll('#flights th')].map(one => one.ariaSort);
heads[times].click();
found.falling = cells(times);
type('QUAD-1 level:bad 0199.ulg');
found.health = cells(3);
found.count = document.getElementById('count').textContent;
type('time>280');
found.longest = cells(times);
type('colour>45 ATC_RAT_RLL_P>0.1');
found.unknown = document.getElementById('count').textContent;
type('motors:unknown');
found.unknownMotors = document.getElementById('count').textContent;
type('motor:3');
found.motor = lines().map(row => row.textContent);
type('motor:30');
found.otherMotor = lines().length;
type('2026-01-07');
found.few = cells(times);
lines()[0].click();
found.unfolded = [body.querySelectorAll('.open').length, body.querySelectorAll('.note[open]').length];
type('');
scrollTo(0, document.body.scrollHeight / 2);
dispatchEvent(new Event('scroll'));
found.middle = Number(lines()[0].dataset.at);
found.laidOut = lines().length;
dispatchEvent(new Event('beforeprint'));
found.printed = [lines().length, document.getElementById('printed').textContent];
return found;
})()"""


@mark.slow
def test_a_browser_sorts_searches_and_prints_ten_thousand_flights(tmp_path, browser):
    """A browser shows a large table, and a script uses its sorting and its filter."""
    rows = fleet_rows(1000)
    text = fleet_page(rows)
    table = table_of(text)
    columns_of_rows = {
        name: table[name] * 10 for name in ("rows", "urgencies", "lights", "counted", "findings")
    }
    large_table = json.dumps(table | columns_of_rows)
    _, shown_by_browser = browser.shown(
        text.replace(json.dumps(table), large_table), SORTED, tmp_path
    )
    assert shown_by_browser["dates"] == sorted(shown_by_browser["dates"], reverse=True)
    logs = group_into_flights(rows)
    # Each log stands in the table ten times.
    flight_count = 10 * sum(log[0].has_flight for log in logs)
    unused_count = 10 * len(logs) - flight_count
    assert min(map(seconds_of, shown_by_browser["longest"])) > 280
    assert "Not understood: colour>45, atc_rat_rll_p>0.1." in shown_by_browser["unknown"]
    assert shown_by_browser["unknown"].endswith("control as ATC_RAT_RLL_P>0.1")
    assert shown_by_browser["motor"] and shown_by_browser["otherMotor"] == 0
    assert all("motor 3 works harder" in line for line in shown_by_browser["motor"])
    seconds = [log[0].flight_time for log in logs if log[0].is_read]
    numbers = [seconds_of(cell) for cell in shown_by_browser["rising"]]
    assert numbers == sorted(numbers) and numbers[0] == approx(min(seconds), rel=0.01)
    assert seconds_of(shown_by_browser["falling"][0]) == approx(max(seconds), rel=0.01)
    assert shown_by_browser["state"].count("ascending") == 1
    assert shown_by_browser["health"] == ["bad"] * 10
    motors_index = [*Light].index(Light.MOTORS)
    levels_of_motors = [levels.split()[motors_index] for levels in columns_of_rows["lights"]]
    unknown_count = levels_of_motors.count("unknown")
    assert 0 < unknown_count < len(levels_of_motors)
    found = f"{unknown_count} found, {unused_count} of them simulated or not used, in "
    assert shown_by_browser["unknownMotors"].startswith(found)
    counts = f"{flight_count} logs with flights and {unused_count} not used"
    assert f"10 found in {counts}" in shown_by_browser["count"]
    # What is not known comes last, also in falling order.
    is_duration_known = [bool(cell) for cell in shown_by_browser["few"]]
    assert is_duration_known and is_duration_known == sorted(is_duration_known, reverse=True)
    assert shown_by_browser["unfolded"] == [1, 1]
    # Only what can be seen is laid out, so that typing is quick; paper has no scroll bar.
    assert shown_by_browser["laidOut"] < 100 and 2000 < shown_by_browser["middle"] < 8000
    assert shown_by_browser["printed"] == [
        200,
        "The first 200 of 10030 logs; filter before printing to see others.",
    ]


@mark.slow
def test_a_browser_runs_nothing_of_a_log_and_scrolls_sideways_in_the_table_only(tmp_path, browser):
    assert browser.shown(fleet_page(hostile()), FITS, tmp_path, 500) == ("Fleet", True)


def test_each_line_leads_to_the_page_of_its_flight():
    text = fleet_page(
        [flight_row("quad", 0, page="pages/a b#1.html"), flight_row("quad", 1, page=None)]
    )
    # The table and each chart have it; a flight without a page has no address.
    assert text.count('"pages/') == text.count('"pages/a%20b%231.html"') > 1


FINDS = """(() => {
const found = () => [...document.querySelectorAll('#flights tbody tr[data-at]')].map(row => row.cells[0].title);
const filter = document.getElementById('filter');
const search = words => {
  filter.value = words;
  filter.dispatchEvent(new Event('input'));
  return found();
};
const click = part => { part.click(); return found().length; };
const counts = [...document.querySelectorAll('.counts [data-find]')];
return {
  gain: search('atc_rat_rll_p>0.1'),
  height: search('height>=12.5 height<20'),
  unknownGain: search('ATC_RAT_PIT_P>0.1').length,
  dates: Object.fromEntries(SEARCHES.map(words => [words, search(words)])),
  clicks: Object.fromEntries(counts.map(part => [part.dataset.find, click(part)])),
};
})()"""
"""Files that the page finds by date, and how many flights it finds by each part of the bars of lights."""


@mark.slow
def test_a_date_is_an_interval_and_a_bar_finds_the_flights_that_it_counts(tmp_path, browser):
    levels = (Level.BAD, Level.BAD, Level.WATCH, Level.GOOD, Level.BAD)
    flights = []
    for number, (date, level) in enumerate(zip(FLIGHT_DATES, levels, strict=True)):
        columns = {"date": datetime.fromisoformat(f"{date}+00:00") if date else None}
        columns |= {"light_motors": level, "headline": "The motors are fine."}
        columns["height"] = 12.5 + 10 * number
        columns["control_parameters"] = json.dumps({"ATC_RAT_RLL_P": 0.05 * number})
        flights.append(flight_row("quad", number, **columns))
    flights.append(
        flight_row(
            "sim",
            0,
            light_motors="bad",
            simulated=1.0,
            vehicle_basis=SYSTEM_ID_BASIS,
            health="unknown",
        )
    )
    script = FINDS.replace("SEARCHES", json.dumps([*FOUND_BY_DATE]))
    text = fleet_page(flights)
    _, shown_by_browser = browser.shown(text, script, tmp_path)
    for search, numbers in FOUND_BY_DATE.items():
        files = {flights[number].file for number in numbers}
        assert set(shown_by_browser["dates"][search]) - {flights[-1].file} == files, search
    # Gains and heights are no columns, and are searched all the same.
    assert set(shown_by_browser["gain"]) == {flight.file for flight in flights[3:-1]}
    assert shown_by_browser["height"] == [flights[0].file]
    assert shown_by_browser["unknownGain"] == 0
    clicks = shown_by_browser["clicks"]
    assert clicks["motors:bad counted:yes"] == 3 and clicks["motors:watch counted:yes"] == 1
    assert clicks["motors:bad,watch counted:yes"] == 4
    assert clicks["wind:unknown counted:yes"] == 5
    # The parts of the bars are buttons, which paper shows, too.
    hidden_on_paper = text.partition("@media print")[2].partition("display: none !important")[0]
    assert ".counts button" in hidden_on_paper.partition("button:not(")[2].partition(")")[0]
    # A light without a finding has none to show.
    assert "wind:bad,watch counted:yes" not in clicks
    assert "<span>wind</span>" in text


WHOLE = """(() => {
const bar = document.querySelector('.counts .bar').getBoundingClientRect();
const box = document.querySelector('.counts .bars').getBoundingClientRect();
const cut = [...document.querySelectorAll('#flights td, #flights td *')].filter(one =>
  one.clientWidth && (one.scrollWidth > one.clientWidth + 1 || one.scrollHeight > one.clientHeight + 1));
return {
  isBarInBox: bar.height > 0 && bar.top >= box.top - 1 && bar.bottom <= box.bottom + 1,
  lights: document.querySelector('.vehicle .lights').innerText,
  cut: cut.map(one => one.textContent),
};
})()"""
"""What a phone shows of the bars, of the names of the lights, and the texts that it cuts."""


@mark.slow
def test_a_phone_shows_bars_counts_of_lights_that_do_not_warn_and_whole_texts_of_few_flights(
    tmp_path,
    browser,
):
    columns = {
        "file": f"/logs/{'a_log_with_a_long_name_' * 3}.ulg",
        "headline": "What is wrong. " * 9,
    }
    text = fleet_page([flight_row("quad", number, **columns) for number in range(2)])
    _, shown_by_browser = browser.shown(text, WHOLE, tmp_path, width=390)
    assert shown_by_browser["isBarInBox"]
    assert shown_by_browser["lights"] == "8 unknown"
    assert shown_by_browser["cut"] == []


FOLDED = """(() => {
  const notes = [...document.querySelectorAll('#flights .note')];
  const summary = notes[0].querySelector('summary');
  const shown = () => [...summary.children].filter(one => one.getClientRects().length).map(one => one.textContent);
  const folded = shown(), isWhole = summary.scrollHeight <= summary.clientHeight;
  notes[0].open = true;
  return {lines: notes.length, folded, isWhole, opened: shown()};
})()"""
"""The first note on a flight as it is shown, whether nothing of it is cut, and the same when it is unfolded."""


@mark.slow
def test_a_note_of_many_flights_is_in_few_words_until_it_is_chosen(tmp_path, browser):
    columns = {"headline": "What is wrong. " * 9, "headline_level": "bad"}
    columns["headline"] = columns["headline"].strip()
    text = fleet_page([flight_row("quad", number, **columns) for number in range(9)])
    _, shown_by_browser = browser.shown(text, FOLDED, tmp_path, width=1280)
    assert shown_by_browser["lines"] == 9 and shown_by_browser["isWhole"]
    (finding,) = shown_by_browser["folded"]
    assert 0 < len(finding) <= MAX_LISTED_LENGTH
    assert shown_by_browser["opened"] == [columns["headline"]]


BRIEF = """(() => {
const drawn = () => [...document.querySelectorAll('#flights tbody tr[data-at]')];
const state = () => [drawn().length, document.getElementById('count').textContent];
const found = {first: state(), files: drawn().map(one => one.querySelector('td').title)};
const cut = [...document.querySelectorAll('#flights .clip')];
document.getElementById('all_flights').click();
return {...found, cut: cut.length, all: state()};
})()"""


@mark.slow
def test_a_phone_shows_what_needs_a_look_first_and_all_flights_when_they_are_asked_for(
    tmp_path, browser
):
    lost = {"headline": "It fell.", "headline_level": "bad", "headline_rank": 0}
    columns_by_number = {
        5: lost,
        10: {"health": "fault"},
        20: {"health": "drift"},
        30: {**lost, "simulated": 1.0},
    }
    flights = []
    for number in range(40):
        columns = {"health": "ok", **columns_by_number.get(number, {})}
        flights.append(flight_row("quad", number, **columns))
    _, shown_by_browser = browser.shown(fleet_page(flights), BRIEF, tmp_path, width=390)
    assert shown_by_browser["first"] == [3, "To look at first: 3 of 40 logs"]
    assert shown_by_browser["files"] == [flights[number].file for number in (5, 10, 20)]
    assert shown_by_browser["cut"] == 0
    assert shown_by_browser["all"][0] > 12 and shown_by_browser["all"][1] == "40 logs"


@mark.slow
def test_simulated_flights_count_as_in_the_headline_and_a_motor_that_the_log_warns_of_is_in_its_column():
    bad = {"headline": "It stopped at 3 s.", "headline_level": "bad", "light_motors": "bad"}
    bad["watched_motor"] = 1
    wind = {"wind_speed": 3.0, "wind_direction": 1.0}
    real = [flight_row("quad", number, **bad) for number in range(2)]
    simulated = [
        flight_row(
            "sim-1", number, simulated=1, vehicle_basis="system id", health="unknown", **bad, **wind
        )
        for number in range(2)
    ]
    text = fleet_page(real + simulated)
    assert "<title>from 2026-01-05: 1 bad</title>" in text
    # The day of the flight that shows what is wrong stays on one line.
    assert 'Seen in:</strong> 0001.ulg, <span class="date">2026-01-06</span>.' in text
    assert 'title="bad: 2 logs"' in text and "simulated ones only where" in text
    assert "<h2>Wind</h2>" not in text
    table = table_of(text)
    assert {row[2 + [*COLUMNS].index("motor")] for row in table["rows"]} == {"1"}
    assert "simulated ones" not in fleet_page(real)
    # The name of a simulated vehicle was given to it: its flights count.
    named = [replace(row, vehicle="Red", vehicle_basis="given") for row in simulated]
    assert "<title>from 2026-01-05: 2 bad</title>" in fleet_page(real + named)


def test_a_note_on_a_flight_is_whole_or_left_out():
    notes = tuple(f"Note {number}: {'word ' * 20}end." for number in range(5))
    text = fleet_page([flight_row("quad", 0, warnings=notes)])
    assert f"{notes[0]}\\n{notes[1]}" in text
    assert notes[4] not in text and "Note 4" not in text and "…" not in table_of(text)["rows"][0]


def test_a_light_that_is_unknown_in_all_flights_is_not_counted_as_without_a_warning():
    counts = {Level.BAD: 0, Level.WATCH: 2, Level.GOOD: 0, Level.UNKNOWN: 8}
    assert page_of_fleet.LightCounts(Light.MARGINS, counts).text == "2 watch, 8 unknown"
    assert page_of_fleet.LightCounts(Light.POWER, {Level.BAD: 0, Level.GOOD: 3}).text == "all good"
