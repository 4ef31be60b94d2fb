"""The page of two flights compared: its charts show the figures that its text compares."""

import re
from dataclasses import replace

import numpy as np
import pytest
from fleet_rows import flight_row
from numpy.testing import assert_allclose

from mavdem.facts.fleet import QuantityOutcome
from mavdem.facts.margins import MarginsLight
from mavdem.facts.motors import MotorsBetween
from mavdem.fleet.difference import vehicle_difference
from mavdem.fleet.parameter_changes import ParameterChange, renamed_gain
from mavdem.fleet.quantities import PHASE_MARGIN, SHARE, Quantity
from mavdem.fleet.random_effects import QuantityChange
from mavdem.report.blocks import plain_text
from mavdem.report.charts.change_plan import change_plan
from mavdem.report.charts.chart import Axis, Chart, Line, Mark
from mavdem.report.charts.comparison_charts import (
    BOOT_CLOCK,
    BOOT_NUMBER,
    MEAN_MOTOR_OUTPUT,
    MOTOR_OUTPUTS,
    PITCH,
    ROLL,
    VIBRATIONS,
    flight_series_charts,
)
from mavdem.report.difference.changes import (
    change_sentences,
    difference_blocks,
    undetected_change_table,
)
from mavdem.report.difference.conditions import (
    condition_sentence,
    condition_table,
    vibration_rows,
    wind_rows,
)
from mavdem.report.difference.flight_cautions import flight_cautions
from mavdem.report.difference.gain_table import gain_phrase, gain_table, tabled_gains
from mavdem.report.difference.headline import (
    headline_blocks,
    headline_in_two_sizes,
    headline_of_comparison,
    light_headings,
)
from mavdem.report.difference.identity import identity_remarks
from mavdem.report.difference.lights import (
    light_blocks,
    light_heading,
    sentences_on_further_watched_lights,
)
from mavdem.report.difference.motors import motor_table
from mavdem.report.difference.next_step import next_step_sentences
from mavdem.report.difference.parameter_rows import parameter_rows
from mavdem.report.difference.parameters import parameter_sentences
from mavdem.report.difference.quantity_texts import change_with_interval
from mavdem.report.difference.reviewed import ComparedState, compared_states, reviewed_difference
from mavdem.report.difference.sides import side_descriptions
from mavdem.report.fleet import motor_next_step
from mavdem.report.pages.difference_page import (
    MAX_LISTED_PARAMETERS,
    SIDE_COLOURS,
    _change_chapter,
    _have_common_range,
    _main_chart,
    _motor_groups,
    _overview_titles,
    _parameter_chapters,
    _pictures,
    _spectrum_chart,
    _trim_chart,
    _unchanged_chapter,
    _with_single_side,
    comparison_page,
)
from mavdem.report.palette import BAD

SHARES = {"A": (1.0, 1.0, 1.0, 1.0), "B": (0.9756, 1.0732, 0.9756, 0.9756)}
"""Motor 2 changes by 10 % beside motors of which none moves: beside their mean it would be 7.3 %."""

LEGEND = {"A": "A: first", "B": "B: second"}
CHANGE_DRAWING = "Changes with their 90 % intervals"
"""What the drawing of the changes is called for those who do not see it."""


@pytest.fixture(scope="module")
def difference():
    intervals = {"trim_share_interval": (0.01,) * 4}
    states = [
        [flight_row("quad", number, trim_share=shares, **intervals)]
        for number, shares in enumerate(SHARES.values())
    ]
    return vehicle_difference(*states)


def test_the_chart_of_trims_shows_the_changes_that_are_compared(difference):
    before, after = _trim_chart(LEGEND, difference).lines
    assert_allclose(after.y - before.y, [0.0, 10.0, 0.0, 0.0], atol=0.1)


def test_flights_of_fleets_have_a_column_for_each_motor_and_side():
    states = [[flight_row("quad", number) for number in numbers] for numbers in ((0, 1), (2, 3))]
    chart = _trim_chart({"A": "A", "B": "B"}, vehicle_difference(*states))
    assert chart.x.names == ("1 A", "1 B", "2 A", "2 B", "3 A", "3 B", "4 A", "4 B")
    for line in chart.lines:
        drawn = line.x[np.isfinite(line.y)]
        # The mean stands left of its flights, and all dots within the column of their side.
        assert set(np.round(drawn) % 2) == {"AB".index(line.name[0])}
        assert len(drawn) == (4 if line.name.endswith("mean") else 8)


@pytest.mark.slow
def test_trims_of_a_flight_in_which_a_motor_failed_are_not_compared():
    intervals = {"trim_share_interval": (0.01,) * 4}
    before = flight_row("quad", 0, trim_share=SHARES["A"], **intervals)
    after = flight_row("quad", 1, trim_share=SHARES["B"], failed_motor=2, **intervals)
    difference = vehicle_difference([before], [after])
    assert not any(change.quantity.is_of_motor for change in difference.changes)
    text = plain_text(difference_blocks(reviewed_difference(difference)))
    assert "relative trim of motors and control effectiveness of motors: motor 2 failed" in text
    assert not _trim_chart(LEGEND, difference).lines


def test_whiskers_of_trims_make_the_interval_of_the_change(difference):
    before, after = _trim_chart(LEGEND, difference).lines
    stated = [100 * one.half_width for one in difference.changes if one.quantity.kind == "share"]
    assert len(stated) == 4
    assert_allclose(np.hypot(before.upper_edge - before.y, after.upper_edge - after.y), stated)


def test_a_loss_is_marked_in_the_chart_of_its_motor_on_the_time_axis_of_the_chart(
    difference, monkeypatch
):
    """B took off 4 s after boot and lost motor 3 at 47 s; in A, whose start is not known, nothing is marked."""
    times = np.arange(0.0, 60.0)
    outputs = {title: np.array([times, 50.0 + np.sin(times)]) for title in MOTOR_OUTPUTS[:4]}
    start = {BOOT_NUMBER: np.array([[0.0], [0.0]]), BOOT_CLOCK: np.array([[0.0], [4.0]])}
    lost = motor_review("motor 3")
    lost["lights"]["motors"]["time"] = 47.0
    reviewed = reviewed_difference(difference, {"A": lost, "B": lost})
    flights = {"A": outputs, "B": outputs | start}
    charts = flight_series_charts(flights, LEGEND, SIDE_COLOURS)
    (group,) = _motor_groups(reviewed, flights, [*charts])
    marks = {chart.title: chart.marks for (chart,) in group.columns}
    assert marks.pop(MOTOR_OUTPUTS[2]) == (Mark(43.0, "B: 47 s since boot, 43 s in the air", BAD),)
    assert not any(marks.values())
    assert (
        group.first_name == MOTOR_OUTPUTS[2] and "take-off (4 s in B, since boot)" in group.caption
    )
    # This motor is the one picture at the top, which a phone shows before all text but heading and next step.
    mean_output = {MEAN_MOTOR_OUTPUT: outputs[MOTOR_OUTPUTS[0]]}
    series = (outputs | mean_output, outputs | mean_output | start)
    pictures = _pictures(reviewed, series)
    assert _main_chart(reviewed, pictures).title == MOTOR_OUTPUTS[2]
    page = comparison_page(("a.bin", "b.bin"), reviewed, flights=series)
    result = page[page.index('<section id="result"') : page.index('class="contents"')]
    order = ("is weak", "Inspect motor 3", "<h3>Motor 3 output", "bad in A and B")
    assert [result.index(text) for text in order] == sorted(result.index(text) for text in order)
    closed = re.findall(r'<section id="([^"]*)"[^>]*>\s*<details class="phone-closed" open>', page)
    assert "motors" in closed and "both-flights" in closed and "what-changed" not in closed
    # How plots are moved stands with the first of them over time.
    chapter = page[page.index('id="motors"') :]
    assert "Drag over a plot" in chapter[: chapter.index("</section>")]
    assert page.count("Drag over a plot") == 1
    # Few changes are drawn below this picture, and more of them in their chapter.
    order = ("<h3>Motor 3 output", CHANGE_DRAWING, "bad in A and B")
    assert [result.index(text) for text in order] == sorted(result.index(text) for text in order)
    assert result.count(CHANGE_DRAWING) == 1
    monkeypatch.setattr("mavdem.report.pages.difference_page.MAX_CHANGES_AT_TOP", 0)
    page = comparison_page(("a.bin", "b.bin"), reviewed, flights=series)
    assert page.index('id="what-changed"') < page.index(CHANGE_DRAWING)
    assert _main_chart(reviewed_difference(unchanged()), pictures).title == MEAN_MOTOR_OUTPUT
    # Of a bad wind it is the axis that leans more.
    leans = tuple(
        {ROLL: np.array([times, times]), PITCH: np.array([times, 2 * times])} for _ in "AB"
    )
    wind = {"A": {"lights": {"wind": {"level": "bad", "sentence": "Wind carried it away."}}}}
    windy = reviewed_difference(unchanged(), wind | {"B": wind["A"]})
    assert _main_chart(windy, _pictures(windy, leans)).title == PITCH


def test_a_line_of_one_side_alone_is_named_by_the_title():
    line = Line(LEGEND["A"], "blue", np.zeros(2), np.zeros(2))
    chart = Chart("Roll (°)", Axis("time (s)"), Axis("roll (°)"), (line,))
    assert _with_single_side(chart).title == "Roll (°), only A: first"
    both = chart._replace(lines=(line, line))
    assert _with_single_side(both) == both


def test_lights_that_are_equal_are_one_sentence():
    """Two reviews differ in one light.

    The table has that light alone, and margins of different axes are not equal.
    """
    lights = {
        name: {"level": level, "sentence": f"{name} is {level}."}
        for name, level in {"motors": "good", "power": "unknown", "log": "good"}.items()
    }
    worse = lights | {"motors": {"level": "bad", "sentence": "Motor 1 is weak."}}
    table, equal = light_blocks({"A": {"lights": lights}, "B": {"lights": worse}})
    assert table.header == ["light", "A", "B"]
    assert table.rows == [["motors", "good", "bad"]]
    assert table.rows[0][2].reason == "Motor 1 is weak."
    assert equal.lead == "Equal in A and B:" and equal.text == "power unknown; log good."
    assert light_blocks({"A": {"lights": lights}, "B": {}}) == []
    # Good margins of one axis are not those of three.
    roll, all_axes = (
        {
            "code": "loop_margins",
            "level": "good",
            "sentence": f"{axes}.",
            "figures": {"names": axes},
        }
        for axes in (["roll"], ["pitch", "roll", "yaw"])
    )
    reviews = {"A": {"lights": {"margins": roll}}, "B": {"lights": {"margins": all_axes}}}
    table, *_ = light_blocks(reviews)
    assert table.rows == [["margins", "good", "good"]]


@pytest.mark.slow
def test_a_comparison_states_first_that_it_is_of_two_vehicles():
    rows = [flight_row(vehicle, 0) for vehicle in ("quad", "other")]
    difference = vehicle_difference(rows[:1], rows[1:])
    page = comparison_page(("a.bin", "b.bin"), reviewed_difference(difference, {"A": {}, "B": {}}))
    assert page.index("are two vehicles") < page.index("No compared figure differs significantly.")
    # The style of the lights of a flight's page is not that of a table of two.
    assert 'id="lights"' not in page


def test_vehicles_without_a_name_are_called_so():
    px4, ardupilot = (
        flight_row(f"{autopilot}-1".lower(), 0, vehicle_basis="system id", autopilot=autopilot)
        for autopilot in ("PX4", "ARDUPILOTMEGA")
    )
    first, *_ = headline_of_comparison(reviewed_difference(vehicle_difference([px4], [ardupilot])))
    assert "two vehicles: unnamed PX4 vehicle and unnamed ArduPilot vehicle." in first.text
    same_id = reviewed_difference(vehicle_difference([px4], [flight_row("px4-1", 1)]))
    (remark,) = identity_remarks(same_id)
    assert remark.text.startswith("The logs name no vehicle (px4-1 is a system id): A and B")


def test_parameters_that_a_library_does_not_have_are_not_compared_for_the_true_reason(difference):
    reviewed = reviewed_difference(difference, {"A": {}, "B": {}})
    tracked = plain_text(parameter_sentences(reviewed._replace(tracked_sides=("A",))))
    outdated = plain_text(parameter_sentences(reviewed._replace(outdated_sides=("B",))))
    assert "`mavdem track`" in tracked and "earlier version" not in tracked
    assert "earlier version" in outdated and "`mavdem track`" not in outdated


def test_a_simulation_and_a_flight_are_two_vehicles_even_by_the_same_name(difference):
    reviews = {"A": {"simulated": {"sentence": "Simulated flight."}}, "B": {"simulated": None}}
    reviewed = reviewed_difference(difference, reviews)
    first, *_ = headline_of_comparison(reviewed)
    assert first.text.startswith("A is a simulated flight, B is not")
    assert identity_remarks(reviewed) == []
    both = reviewed_difference(difference, {"A": reviews["A"], "B": reviews["A"]})
    assert "simulated" not in plain_text(headline_of_comparison(both))
    # A log that names neither board nor sensor may lack what would show a simulator.
    unnamed = reviewed_difference(difference._replace(shared=("quad",)), reviews)
    assert not unnamed.are_two_vehicles
    assert "simulated" not in plain_text(headline_of_comparison(unnamed))
    *_, remark = flight_cautions(unnamed)
    assert (remark.lead, remark.text) == ("Simulated:", "A. The log of B does not say.")
    assert remark.level is None and flight_cautions(reviewed) == flight_cautions(both) == []


def test_frames_with_other_numbers_of_motors_are_two_vehicles():
    quad, hexa = (flight_row("px4-1", 0), flight_row("px4-1", 1, motors=tuple("123456")))
    first, *_ = headline_of_comparison(reviewed_difference(vehicle_difference([quad], [hexa])))
    assert "A and B are two vehicles" in first.text


def test_other_frames_are_two_vehicles_and_other_system_ids_show_nothing():
    quad = flight_row("001a", 0)
    hexa = replace(quad, frame="HEXAROTOR")
    assert vehicle_difference([quad], [hexa]).is_of_two_vehicles
    unknown_frame = replace(quad, frame="GENERIC")
    assert not vehicle_difference([quad], [unknown_frame]).is_of_two_vehicles
    unnamed = [flight_row(f"px4-{system}", 0, vehicle_basis="system id") for system in (1, 2)]
    assert not vehicle_difference(unnamed[:1], unnamed[1:]).is_of_two_vehicles


def test_a_yaw_trim_of_two_vehicles_is_named():
    """Motors 3 and 4 turn clockwise and work 16 % harder beside the others in B, or one motor alone does."""
    intervals = {"trim_share_interval": (0.01,) * 4, "spins": (1, 1, -1, -1)}
    for shares, is_yaw in (((0.92, 0.92, 1.08, 1.08), True), ((0.97, 0.97, 1.09, 0.97), False)):
        states = [
            [flight_row("quad", 0, trim_share=SHARES["A"], **intervals)],
            [flight_row("other", 1, trim_share=shares, **intervals)],
        ]
        headline = headline_of_comparison(reviewed_difference(vehicle_difference(*states)))
        text = plain_text(headline)
        assert ("in B clockwise motors work harder beside" in text) == is_yaw


def test_two_vehicles_with_serial_numbers_are_told_apart_by_these():
    names = ("003b002f3039511333343932", "0005002f3039511333c19d7")
    first, *_ = headline_of_comparison(
        reviewed_difference(vehicle_difference(*([flight_row(name, 0)] for name in names)))
    )
    assert "two vehicles: Vehicle 003b…343932 and Vehicle 0005…3c19d7." in first.text


def test_a_crash_that_makes_several_lights_bad_is_stated_once(difference):
    crashed = {"level": "bad", "sentence": "It crashed."}
    sound = {"level": "good", "sentence": "Fine."}
    reviews = {
        side: {"lights": {"motors": light, "tracking": light}}
        for side, light in {"A": crashed, "B": sound}.items()
    }
    motors, tracking, *_ = headline_of_comparison(reviewed_difference(difference, reviews))
    assert motors.text == "bad in A, good in B. It crashed."
    assert (tracking.lead, tracking.text) == (
        "Tracking:",
        "bad in A, good in B, for the cause stated above.",
    )
    tilted = {"level": "bad", "sentence": "It tilted."}
    reviews["B"] = {"lights": {"motors": sound, "tracking": tilted}}
    # What is bad in the later flight comes before what became better.
    tracking, motors, *_ = headline_of_comparison(reviewed_difference(difference, reviews))
    assert tracking.text == "bad in A and B. A: It crashed. B: It tilted."
    assert motors.text == "bad in A, good in B, for the cause stated above."


def test_still_air_comes_from_nowhere(difference):
    wind = {"speed": 1.3, "speed_interval": [0.0, 3.1], "direction": 110.0}
    wind |= {"direction_interval": 12.0, "status": {"speed": "reported", "direction": "reported"}}
    calm, windy = {"wind": wind | {"calm": True}}, {"wind": wind | {"calm": False}}
    speeds, directions = wind_rows(reviewed_difference(difference, {"A": calm, "B": windy}))
    assert speeds.cells == ("below 3.1", "1.3 (0 to 3.1)")
    assert directions.cells == ("-", "110 ± 12")
    calm["wind"]["speed_interval"] = [0.0, 3.14]
    assert wind_rows(reviewed_difference(difference, {"A": calm}))[0].cells == ("below 3.2", "-")
    # A speed that is not identifiable has the bounds that the light on the wind states.
    status = {"speed": "not identifiable", "direction": "not identifiable"}
    unsure = {"wind": {"status": status, "calm": False}}
    for low, text in ((0.0, "below 3.6"), (1.2, "1.2 to 3.6")):
        reason = {"low": low, "high": 3.58}
        review = {**unsure, "lights": {"wind": {"figures": {"reason": reason}}}}
        assert wind_rows(reviewed_difference(difference, {"B": review}))[0].cells[1].endswith(text)


def test_the_scale_of_a_large_change_contains_it_and_has_round_ticks(difference):
    (largest, *_) = sorted(difference.changes, key=lambda change: -abs(change.difference))
    far = difference._replace(
        changes=(largest._replace(tested_difference=1.3, tested_half_width=0.3),)
    )
    svg = change_plan(far).svg
    assert 'width="10"' in svg
    positions = [float(value) for value in re.findall(r'(?:x|x1|x2|cx)="([\d.]+)%"', svg)]
    assert max(positions) == 94.0
    # The interval ends at exp(1.6) - 1, and nothing falls by more than 100 %.
    ticks = re.findall(r'<text class="small[^>]*>([^<]*)<', svg)
    assert ticks == ["0", "+200 %"]


def test_a_light_to_be_watched_on_one_side_is_in_the_headline(difference):
    vibration = {"good": "Vibration 10 m/s².", "watch": "Vibration 16 m/s²."}
    reviews = {}
    for side, level in {"A": "watch", "B": "good"}.items():
        lights = {
            name: {"level": level, "sentence": vibration[level]} for name in ("vibration", "log")
        }
        reviews[side] = {"lights": lights}
    (sentence,) = [
        one
        for one in headline_of_comparison(reviewed_difference(difference, reviews))
        if one.text and "watch" in one.text
    ]
    assert sentence.lead == "Vibration:"
    assert sentence.text == "watch in A (16 m/s²), good in B (10 m/s²)."

    def heading(**figures):
        """Returns the first line of the page of two flights whose light has these figures by level."""
        for review in reviews.values():
            light = review["lights"]["vibration"]
            light |= {"subject": "IMU 2", "figures": figures.get(light["level"], {})}
        reviewed = reviewed_difference(unchanged(), reviews)
        first, second, *_ = headline_in_two_sizes(reviewed, headline_of_comparison(reviewed))
        assert not figures or second.text == "IMU 2: 16 → 9.4 m/s²."
        return first.lead

    assert heading() == "In A: vibration 16 m/s² (watch); good in B."
    figures = {"watch": {"vibration": 15.7}, "good": {"vibration": 9.4}}
    assert heading(**figures) == "Vibration of IMU 2 15.7 → 9.4 m/s²: watch in A, good in B."
    # On the page the next step follows the heading, and the table alone has the vibration of each IMU.
    page = comparison_page(("a.bin", "b.bin"), reviewed_difference(unchanged(), reviews))
    assert "IMU 2 15.7" in page.replace("\N{NO-BREAK SPACE}", " ") and "IMU 2: 16 →" not in page
    weak = {"level": "watch", "subject": "motor 1", "sentence": "Motor 1 is weak."}
    reviews["A"]["lights"]["motors"] = {"level": "good", "sentence": "Motors even."}
    reviews["B"]["lights"]["motors"] = weak
    page = comparison_page(("a.bin", "b.bin"), reviewed_difference(unchanged(), reviews))
    page = page.replace("\N{NO-BREAK SPACE}", " ")
    order = ["In B: motor 1 is weak.", "Inspect motor 1 and", "good in A, watch in B."]
    assert [page.index(text) for text in order] == sorted(page.index(text) for text in order)
    assert "watch in A, good in B; the table has the figures." in page
    # What was not compared has the reason that the light of the margins gives.
    unknown = {
        "level": "unknown",
        "code": "margins_unknown",
        "sentence": "Margins do not show at 9.8 Hz.",
    }
    for review in reviews.values():
        review["lights"]["margins"] = unknown
    *_, result = headline_of_comparison(reviewed_difference(unchanged(), reviews))
    assert "Not compared: loops (margins do not show at 9.8 Hz) and parameters." in result.text


def test_spectra_of_both_flights_are_open_after_what_changed(difference):
    spectrum = {"frequency": [0.0, 1.0, 2.0], "density": {"roll": [1.0, 2.0, 3.0]}}
    review = {"spectra": {"gyro": spectrum}}
    reviewed = reviewed_difference(difference, {"A": review, "B": review})
    page = comparison_page(("a.bin", "b.bin"), reviewed)
    # The caption of the drawing explains the shapes that it has.
    assert "Square: changed; red worse, green better" in page and "Dot: the same." not in page
    assert "Ring: too uncertain to tell; perhaps changed if the interval leaves out 0." in page
    chapter = page[page.index('id="both-flights"') : page.index('id="in-words"')]
    assert page.index(CHANGE_DRAWING) < page.index('id="both-flights"')
    # One from before the filters beside one from after them would show the filters.
    raw = {"gyro_before": spectrum | {"frequency": [0.0, 200.0, 400.0]}}
    with_raw = {"A": {"spectra": raw | review["spectra"]}, "B": review}
    first, second = _spectrum_chart(with_raw, LEGEND).lines
    assert first.x.tolist() == second.x.tolist()
    raw_alone = _spectrum_chart({"A": {"spectra": raw}, "B": review}, LEGEND)
    assert not _have_common_range(raw_alone) and _have_common_range(
        _spectrum_chart(reviewed.reviews, LEGEND)
    )
    # Spectra have no time to drag over.
    assert "Drag over a plot" not in page
    assert "Gyro, power" in chapter and '<details class="phone-closed" open>' in chapter


def test_where_nothing_changed_it_says_what_would_have_been_found():
    intervals = {"trim_share_interval": (0.01,) * 4}
    states = [
        [flight_row("quad", number, trim_share=SHARES["A"], **intervals)] for number in (0, 1)
    ]
    reviewed = reviewed_difference(vehicle_difference(*states))
    assert not _change_chapter(reviewed).has_content
    chapter = _unchanged_chapter(reviewed)
    assert chapter.folded and chapter.title.startswith("No change found: 11 fig")
    (table,) = undetected_change_table(reviewed)
    trims, *_ = table.rows
    assert trims[0] == "relative trim of motors 1, 2, 3 and 4"
    # The quantities may be uncertain: they are not called alike.
    bound, detectable = (float(re.search(r"[\d.]+", cell)[0]) for cell in trims[1:])
    assert 0 < bound < detectable < 20
    # Where every figure is uncertain, the heading says so, and does not say that nothing changed.
    for state in states:
        state[0] = replace(
            state[0], trim_share_interval=(0.2,) * 4, effect=None, damping=None, lag=None
        )
    first, *_ = headline_of_comparison(reviewed_difference(vehicle_difference(*states)))
    pattern = r"No change found; one below \d+ % \(relative trim\) may not show\."
    assert re.fullmatch(pattern, first.lead)
    assert first.text.startswith("All 4 figures compared (trims) are too uncertain to tell.")
    # Trims are known better without the part that another lean makes. Loops with other gains are not tested.
    difference = vehicle_difference(*states)
    changes = []
    for change in difference.changes:
        level = change._replace(tested_difference=0.01, tested_half_width=0.05)
        changes.append(change._replace(without_lean=level))
    loop = changes[0]._replace(quantity=Quantity(PHASE_MARGIN, 0, "roll"))
    difference = difference._replace(changes=(*changes, loop), axes_with_other_gains=("roll",))
    reviewed = reviewed_difference(difference)
    (table,) = undetected_change_table(reviewed)
    assert table.rows[1:] == [["relative trims without lean", "±7 %", "not tested"]]
    *_, first = headline_of_comparison(reviewed)
    limit = "without lean, relative trims differ by at most 7 % (90 % interval)."
    assert first.lead == f"No change found; {limit}"
    assert first.text.startswith(
        "All 4 figures tested (trims) are too uncertain to tell with the part that lean makes."
        " Not tested: 1 figure of loops with other gains or filters."
    )


def motor_review(motor, level="bad", **figures):
    """Returns a review whose motors' light warns of one of four motors, which is in its next step, too."""
    sentence = f"{motor.capitalize()} is weak."
    light = {"level": level, "code": "motor_lost_thrust", "subject": motor, "sentence": sentence}
    light |= {"time": 47.0, "figures": figures}
    names = [f"motor {number}" for number in (1, 2, 3, 4)]
    return {
        "lights": {"motors": light},
        "events": [light],
        "condition": {"hover": {"motors": names}},
        "next_step": {"sentence": f"Inspect {motor}."},
    }


def unchanged():
    """Returns the comparison of two flights of a vehicle whose compared figures are the same.

    The mean effect varies too much from flight to flight for that, and is not among them.
    """
    figures = {"trim_share": SHARES["A"], "trim_share_interval": (0.01,) * 4, "effect": None}
    return vehicle_difference(*([flight_row("quad", number, **figures)] for number in (0, 1)))


def test_two_weak_motors_are_no_equal_lights_and_come_before_figures(difference):
    reviews = {"A": motor_review("motor 3"), "B": motor_review("motor 1")}
    (table,) = light_blocks(reviews)
    assert table.rows == [["motors", "bad", "bad"]]
    # What both warn of alike is no difference, but may be what is to be done next: the later log's own step.
    shaken = {"level": "watch", "subject": "IMU 2", "sentence": "Vibration 16 m/s²."}
    alike = {"lights": {"vibration": shaken}, "next_step": {"sentence": "Balance the propellers."}}
    reviewed = reviewed_difference(unchanged(), {"A": alike, "B": alike})
    assert plain_text(sentences_on_further_watched_lights(reviewed.reviews, [])) == (
        "Watch in A and B: vibration. Vibration 16 m/s²."
    )
    # The reasons may differ, or be known on one side alone; the next step needs them all the same.
    other = alike | {"lights": {"vibration": shaken | {"subject": "IMU 1", "sentence": "Clips."}}}
    unknown = {"lights": {"vibration": {"level": "unknown", "sentence": "No message came."}}}
    assert plain_text(sentences_on_further_watched_lights({"A": alike, "B": other}, [])).startswith(
        "Watch in A and B: vibration. A: Vibration 16 m/s². B: Clips."
    )
    assert plain_text(sentences_on_further_watched_lights({"A": unknown, "B": alike}, [])) == (
        "Unknown in A, watch in B: vibration. Vibration 16 m/s². A: No message came."
    )
    assert plain_text(next_step_sentences(reviewed)) == "Next, by B: Balance the propellers."
    assert not sentences_on_further_watched_lights(reviews, [])
    first, *_ = headline_of_comparison(reviewed_difference(difference, reviews))
    assert (first.lead, first.text) == (
        "Motors:",
        "bad in A and B. A: Motor 3 is weak. B: Motor 1 is weak.",
    )
    steps = [
        (step.lead, step.text)
        for step in next_step_sentences(reviewed_difference(difference, reviews))
    ]
    assert steps == [("Next, by B:", "Inspect motor 1."), ("Next, by A:", "Inspect motor 3.")]
    # A fault that the later log does not have may return, unless it was repaired.
    good = {"level": "good", "sentence": "All motors are alike."}
    mended = alike | {"lights": {"motors": good}}
    (step,) = next_step_sentences(reviewed_difference(unchanged(), reviews | {"B": mended}))
    assert step.text.startswith("Unless motor 3 or its propeller was repaired between A and B")
    # What else the later log warns of has its step, too.
    mended["lights"]["vibration"] = shaken
    steps = next_step_sentences(reviewed_difference(unchanged(), reviews | {"B": mended}))
    assert [step.text for step in steps[1:]] == ["Balance the propellers."]


@pytest.mark.parametrize("level", ["bad", "watch"])
def test_where_another_motor_is_weak_only_other_figures_do_not_differ(level):
    same = unchanged()
    reviews = {"A": motor_review("motor 3", level), "B": motor_review("motor 1", level)}
    first, second, *_ = headline_of_comparison(reviewed_difference(same, reviews))
    assert first.text.startswith(f"{level} in A and B. A: Motor 3 is weak.")
    assert second.lead.startswith("No other compared figure changed")
    reviews = {"A": motor_review("motor 3", level), "B": motor_review("motor 3", level)}
    leads = [
        sentence.lead for sentence in headline_of_comparison(reviewed_difference(same, reviews))
    ]
    assert any(lead.endswith(" did not change.") for lead in leads)


def test_motors_are_compared_one_by_one_where_one_is_weak(difference):
    reviews = {"A": motor_review("motor 3", loss=[0.19, 0.42]), "B": {}}
    (table,) = motor_table(reviews, difference)
    assert table.header[:4] == ["", "A", "B", "relative trim"]
    cells = [row[:3] for row in table.rows]
    assert cells[0] == ["motor 1 (front right)", "no warning", "not known"]
    assert cells[2] == ["motor 3 (front left)", "lost 19 to 42 % at 47 s", "not known"]
    assert table.rows[2][1].level == "bad"
    assert table.rows[1][3].startswith("+10 % (")
    # Trims without lean have a column where they are known.
    trim, *other_changes = difference.changes
    without_lean = (trim._replace(without_lean=trim), *other_changes)
    (table,) = motor_table(reviews, difference._replace(changes=without_lean))
    assert table.header[4] == "without lean"
    assert table.rows[0][4] == table.rows[0][3] and table.rows[1][4] == ""
    assert motor_table({"A": {}, "B": {}}, difference) == []
    page = comparison_page(("a.bin", "b.bin"), reviewed_difference(difference, reviews))
    # What a motor lost comes after what has changed, and before other charts.
    chapter = page[page.index('id="motors"') :]
    assert page.index(CHANGE_DRAWING) < page.index('id="motors"')
    assert "lost 19 to 42 % at 47 s" in chapter[: chapter.index("</section>")]
    # A loss by comparison with other flights has its mean before the ends of its interval.
    loss = {"loss": [0.20, 0.14, 0.26], "rise": [0.12, 0.08, 0.16], "probability": 0.9}
    reviews = {"A": motor_review("motor 3", **loss), "B": {}}
    weak = reviews["A"]["lights"]["motors"]
    weak |= {
        "code": "motor_weak",
        "time": None,
        "sentence": "Motor 3 lost about 20 % of its thrust.",
    }
    (table,) = motor_table(reviews, difference)
    assert table.rows[2][1] == "lost about 20 %"
    # A loss that is as likely as not is stated by what was measured.
    weak["figures"]["probability"] = 0.5
    (table,) = motor_table(reviews, difference)
    assert table.rows[2][1] == "works 12 % harder"
    # The same motor has one heading for both flights.
    weak |= {"figures": {**loss, "motor_probability": 0.89}}
    stronger = {**weak, "figures": {**weak["figures"], "loss": [0.25, 0.2, 0.3]}}
    heading = light_heading({"A": weak, "B": stronger})
    assert heading == (
        "In A and B: motor 3 lost about 20 % and 25 % of its thrust with probability 0.89."
    )
    flights = {"A": {**weak, "levels": ["good", "bad"]}, "B": {**stronger, "levels": ["bad"] * 2}}
    assert light_heading(flights).startswith("In the last logs of A and B: motor 3 lost about")


@pytest.mark.parametrize(
    ("level", "leads"), [("unknown", ["Next, by A:"]), ("good", [])], ids=["unknown", "mended"]
)
def test_the_next_step_of_an_earlier_bad_light_stays_until_it_is_good(difference, level, leads):
    next_step = {"sentence": "Inspect motor 3."}
    bad = {"level": "bad", "subject": "motor 3", "sentence": "Motor 3 is weak."}
    later = {"level": level, "sentence": "Motors."}
    reviews = {
        "A": {"lights": {"motors": bad}, "next_step": next_step},
        "B": {"lights": {"motors": later}},
    }
    first, *_ = headline_of_comparison(reviewed_difference(difference, reviews))
    assert first.text.startswith(f"bad in A, {level} in B. Motor 3 is weak.")
    steps = next_step_sentences(reviewed_difference(difference, reviews))
    assert [step.lead for step in steps if step.lead != "Next:"] == leads
    # A bad B has its step also where its date, perhaps of a wrong clock, lies before that of A.
    dated = {"A": reviews["B"] | {"identity": {"date": "2026-02-08"}}}
    dated["B"] = reviews["A"] | {"identity": {"date": "2026-01-08"}}
    steps = next_step_sentences(reviewed_difference(difference, dated))
    assert "Next, by B:" in [step.lead for step in steps]


def test_the_vibration_of_each_imu_is_compared_with_its_own(difference):
    """The worst vibration was measured by different IMUs in the two flights.

    That difference is no change, unless the same IMU is known in both.
    """

    def review(imu, vibration, level):
        """Returns a review whose light of the vibration is of an IMU, and whose first IMU has 5 m/s²."""
        light = {"level": level, "subject": imu, "figures": {"vibration": vibration}}
        light |= {"sentence": f"Vibration {vibration} m/s² on {imu}."}
        return {"lights": {"vibration": light}, "condition": {"vibration": {"level": [5.0]}}}

    worse, better = review("IMU 2", 16.2, "watch"), review("IMU 3", 7.9, "good")
    *_, sentence = headline_of_comparison(
        reviewed_difference(difference, {"A": worse, "B": better})
    )
    assert sentence.text == (
        "watch in A (16.2 m/s² on IMU 2), good in B (7.9 m/s² on IMU 3). "
        "IMU 2 and IMU 3 are different sensors: their difference is no change."
    )
    first_imu = vehicle_difference(
        *([flight_row("quad", number, vibration=(5.0,))] for number in (0, 1))
    )
    rows = vibration_rows(reviewed_difference(first_imu, {"A": worse, "B": better}))
    assert rows == [("vibration of IMU 1", "m/s²", ("5.0", "5.0"))]
    # Where every IMU is known, each is compared with itself.
    worse["lights"]["vibration"]["figures"]["imu_levels"] = [11.0, 16.2, 8.5]
    better["lights"]["vibration"]["figures"]["imu_levels"] = [5.1, 7.4, 7.9]
    *_, sentence = headline_of_comparison(
        reviewed_difference(difference, {"A": worse, "B": better})
    )
    assert sentence.text == (
        "watch in A, good in B. IMU 1: 11 → 5.1 m/s²; IMU 2: 16 → 7.4 m/s²; IMU 3: 8.5 → 7.9 m/s²."
    )
    lights, *_ = light_blocks({"A": worse, "B": better})
    ((_, worse_cell, better_cell),) = lights.rows
    assert worse_cell.reason == "Vibration 16.2 m/s² on IMU 2."
    assert better_cell.reason.endswith("IMU 2: 16 → 7.4 m/s²; IMU 3: 8.5 → 7.9 m/s².")
    # Clips are a reason of their own.
    worse["lights"]["vibration"]["figures"]["clips"] = 3
    *_, sentence = headline_of_comparison(
        reviewed_difference(difference, {"A": worse, "B": better})
    )
    assert sentence.text.startswith("watch in A (16.2 m/s² on IMU 2), good in B")
    rows = vibration_rows(reviewed_difference(first_imu, {"A": worse, "B": better}))
    assert rows[:2] == [
        ("vibration of IMU 1", "m/s²", ("11", "5.1")),
        ("vibration of IMU 2", "m/s²", ("16", "7.4")),
    ]
    same = review("IMU 2", 7.9, "good")
    *_, sentence = headline_of_comparison(reviewed_difference(difference, {"A": worse, "B": same}))
    assert "different sensors" not in sentence.text
    # Without clips, the sentence has the same shape where one IMU is the worst in both.
    del worse["lights"]["vibration"]["figures"]["clips"]
    *_, sentence = headline_of_comparison(reviewed_difference(difference, {"A": worse, "B": same}))
    assert sentence.text == "watch in A, good in B. IMU 2: 16 → 7.9 m/s²."
    (row,) = vibration_rows(reviewed_difference(first_imu, {"A": worse, "B": same}))
    assert row.name == "vibration of IMU 2"


def test_conditions_of_both_flights_stand_on_page_and_terminal():
    states = [[flight_row("quad", 0, collective=0.4)], [flight_row("quad", 1, collective=0.55)]]
    wind = {"speed": 3.2, "speed_interval": [2.5, 3.9], "calm": False}
    wind |= {"direction": 110.0, "direction_interval": 12.0}
    reviewed = reviewed_difference(vehicle_difference(*states), {"A": {"wind": wind}, "B": {}})
    (table,) = condition_table(reviewed)
    assert ["wind (m/s)", "3.2 (2.5 to 3.9)", "-"] in table.rows
    assert ["mean motor output (%)", "40", "55"] in table.rows
    (sentence,) = condition_sentence(reviewed)
    assert "wind 3.2 (2.5 to 3.9) m/s in A, not known in B" in sentence.text
    assert "mean motor output 40 → 55 %" in sentence.text
    assert "mean motor output (%)" in comparison_page(("a.bin", "b.bin"), reviewed)
    # Of fleets each IMU is compared, since any of them may be the one that is to be watched.
    shaken = [
        [flight_row("quad", number, vibration_imus=(4.0, 10.0 + number))] for number in range(2)
    ]
    rows = vibration_rows(reviewed_difference(vehicle_difference(*shaken)))
    assert [row.cells for row in rows] == [("4.0", "4.0"), ("10", "11")]
    # Of a fleet the wind is known by flight.
    fleet = [
        flight_row("quad", number, wind_speed=speed) for number, speed in ((0, 3.0), (1, None))
    ]
    windy = [flight_row("quad", number, wind_speed=number + 2.0) for number in (2, 3)]
    (sentence,) = condition_sentence(reviewed_difference(vehicle_difference(fleet, windy)))
    assert "wind 3.0 (1 of 2 logs) → 4.0 to 5.0 m/s" in sentence.text
    # A single speed has its interval.
    fleet[0] = replace(fleet[0], wind_speed_interval=(2.0, 4.5))
    speeds, _ = wind_rows(reviewed_difference(vehicle_difference(fleet, windy)))
    assert speeds.cells == ("3.0 (2.0 to 4.5; 1 of 2 logs)", "4.0 to 5.0")


def test_motors_that_all_work_harder_are_stated_for_two_single_flights():
    """Relative trims do not show it, and one flight a side does not tell it from what flights differ by."""

    def reviewed(collective, **other):
        battery = {"voltage_start": 12.4, "voltage_end": 11.6}
        before = flight_row("quad", 0, collective=0.5, voltage_mean=12.0, **battery)
        columns = {"collective": collective, "voltage_mean": 12.0, **battery, **other}
        return reviewed_difference(vehicle_difference([before], [flight_row("quad", 1, **columns)]))

    harder = reviewed(0.5 * 1.086)
    first, *_ = headline_of_comparison(harder)
    assert first.text.startswith(
        "output 8.6 % higher in B (+3 to +15 %), at equal voltage. "
        "Not decided: whether that is more than flights usually vary by (probability 0.28)."
    )
    assert first.lead == "All motors:"
    # What may be a damage comes before a light that became better, and after one that became worse.
    for level, later_level, leads in (
        ("watch", "good", ["All motors:", "Vibration:"]),
        ("good", "watch", ["Vibration:", "All motors:"]),
    ):
        lights = {"A": level, "B": later_level}
        reviews = {
            side: {"lights": {"vibration": {"level": one, "sentence": f"Vibration {one}."}}}
            for side, one in lights.items()
        }
        headline = headline_of_comparison(harder._replace(reviews=reviews))
        assert [sentence.lead for sentence in headline][:2] == leads
    assert next_step_sentences(harder)[0].text.startswith("Fly again as in B")
    (table,) = condition_table(harder)
    assert ["mean output at equal voltage (% of A)", "100", "109"] in table.rows
    much_harder = reviewed(0.7)
    first, *_ = headline_of_comparison(much_harder)
    assert first.lead == "Changed:"
    assert next_step_sentences(much_harder)[0].text == "Check the load, then all propellers."
    # A fuller battery needs as much more output as it has less voltage, and another range means other fractions.
    full = reviewed(0.5 * 12.0 / 13.0, voltage_mean=13.0)
    assert "all motors" not in headline_of_comparison(full)[0].text and not next_step_sentences(
        full
    )
    other_range = [ParameterChange("MOT_PWM_MAX", 2000.0, 1900.0)]
    rows = [flight_row("quad", number, collective=0.5, voltage_mean=12.0) for number in range(2)]
    assert vehicle_difference(rows[:1], rows[1:]).effort is not None
    assert vehicle_difference(rows[:1], rows[1:], other_range).effort is None
    # The advice is that of the judgement of the motors by earlier flights.
    judged = replace(rows[1], health="drift", health_code=MotorsBetween.EFFORT_CHANGED)
    assert motor_next_step(judged) == next_step_sentences(much_harder)


def test_a_step_response_of_one_flight_alone_says_why_the_other_has_none(difference):
    step = {"time": [0.0, 1.0], "step": [0.0, 1.0], "step_half": [0.0, 0.1]}
    too_slow = {"measured": None, "facts": [{"sentence": "The log is too slow."}]}
    reviews = {
        "A": {"axes": {"roll": {"rate": too_slow, "attitude": too_slow}}},
        "B": {"axes": {"roll": {"rate": {"measured": step}, "attitude": {"measured": step}}}},
    }
    page = comparison_page(("a.bin", "b.bin"), reviewed_difference(difference, reviews))
    assert page.count("Not measured in A:</strong> The log is too slow.") == 1
    assert "Not measured in B" not in page
    # The logs of a fleet are not read.
    reviews["A"] = {"light_levels": {"motors": ["good", "good"]}}
    page = comparison_page(("fleet", "b.bin"), reviewed_difference(difference, reviews))
    assert "Not drawn:</strong> step responses of A, which" in page


def test_a_list_of_changes_does_not_repeat_the_one_that_the_headline_names():
    """Of two changes the headline names both, of three one, and says how many others there are."""

    def reviewed(*shares):
        """Returns the comparison of a flight whose motors work alike with one that has these trims."""
        states = [
            [flight_row("quad", number, trim_share=trims, trim_share_interval=(0.01,) * 6)]
            for number, trims in enumerate([(1.0,) * 6, shares])
        ]
        return reviewed_difference(vehicle_difference(*states))

    two = reviewed(1.2, 1.0, 0.85, 1.0, 1.0, 1.0)
    headline = headline_of_comparison(two)
    assert all(motor in plain_text(headline) for motor in ("motor 1", "motor 3"))
    assert "changed:" not in plain_text(change_sentences(two, headline))
    assert change_sentences(two)[0].lead == "All that changed:"
    three = reviewed(1.2, 1.0, 0.85, 1.0, 1.18, 1.0)
    headline = headline_of_comparison(three)
    assert "motor 1's relative trim +20 %" in plain_text(headline)
    assert "and 2 more" in plain_text(headline)
    (further,) = [
        sentence
        for sentence in change_sentences(three, headline)
        if sentence.lead == "The others that changed:"
    ]
    assert "motor 1" not in further.text
    assert all(motor in further.text for motor in ("motor 3", "motor 5"))


def test_one_reason_of_several_axes_is_stated_once_with_all_of_them(difference):
    step = {"measured": {"time": [0.0, 1.0], "step": [0.0, 1.0], "step_half": [0.0, 0.1]}}
    axes = ("roll", "pitch", "yaw")
    missing = {}
    for axis in axes:
        sentence = f"The controller of the {axis} rate has no setpoint."
        fact = {"sentence": sentence, "subject": f"{axis} rate"}
        missing[axis] = {"rate": {"facts": [fact]}}
    reviews = {"A": {"axes": missing}, "B": {"axes": {axis: {"rate": step} for axis in axes}}}
    page = comparison_page(("a.bin", "b.bin"), reviewed_difference(difference, reviews))
    reason = "The controller of the roll, pitch and yaw rate has no setpoint."
    assert f"Not measured in A:</strong> {reason}</p>" in page


def test_a_motor_that_perhaps_became_weaker_is_inspected_before_the_next_flight(difference):
    (share, *_) = [change for change in difference.changes if change.quantity.kind == SHARE]
    doubtful = share._replace(
        tested_difference=0.08, tested_half_width=0.06, outcome=QuantityOutcome.UNCERTAIN, p=0.047
    )
    (step,) = next_step_sentences(reviewed_difference(difference._replace(changes=(doubtful,))))
    assert step.text.startswith(f"Inspect motor {share.quantity.motor} and its propeller. Then fly")


@pytest.mark.slow
def test_a_page_lists_no_more_parameters_than_an_autopilot_has(difference):
    parameters = [
        ParameterChange(f"P{number}", 0.0, 1.0 + number)
        for number in range(MAX_LISTED_PARAMETERS + 9)
    ]
    reviewed = reviewed_difference(
        difference, {"A": {}, "B": {}}, parameters, (), 2 * len(parameters)
    )
    page = comparison_page(("a.bin", "b.bin"), reviewed)
    # Both numbers of the top of the page add up.
    simulator = ParameterChange("SIM_WIND_SPD", 0.0, 5.0)
    with_simulator = reviewed._replace(parameters=[*parameters, simulator])
    headline = plain_text(headline_of_comparison(with_simulator))
    count = len(parameters)
    assert f"{count} of the {count + 1} that are set anew can change how it flies" in headline
    assert f">P{MAX_LISTED_PARAMETERS - 1}<" in page and f">P{MAX_LISTED_PARAMETERS}<" not in page
    assert f"{len(parameters)} of {2 * len(parameters)} parameters changed, the first" in page
    # The headline has no gains to name, but does not leave out that parameters changed.
    assert f"{len(parameters)} are set anew; no gain of the rate controllers differs." in page


def test_parameters_of_several_outputs_that_changed_alike_have_one_row():
    changes = [ParameterChange(f"SERVO{number}_MIN", 1000.0, 1100.0) for number in (1, 10, 2, 3)]
    changes += [ParameterChange("SERVO4_MIN", 1000.0, 1200.0), ParameterChange("THR_MIN", 0.1, 0.2)]
    assert parameter_rows(changes) == [
        ["SERVO1–3_MIN", "1000", "1100"],
        ["SERVO10_MIN", "1000", "1100"],
        ["SERVO4_MIN", "1000", "1200"],
        ["THR_MIN", "0.1", "0.2"],
    ]
    # The number of a frame or a mode is no amount.
    coded = [ParameterChange("FRAME_CLASS", 2.0, 1.0), ParameterChange("INS_GYRO_FILTER", 20, 30)]
    percentages = [row[-1] for row in parameter_rows(coded, has_percentages=True)]
    assert percentages == ["", "+50 %"]


def test_changed_gains_are_one_phrase_and_a_table():
    gains = [ParameterChange(f"ATC_RAT_{axis}_D", 0.004, 0.002) for axis in ("PIT", "RLL")]
    gains.append(ParameterChange("ATC_RAT_RLL_P", 0.1, 0.05))
    reviewed = reviewed_difference(unchanged(), {}, gains)
    assert gain_phrase(tabled_gains(reviewed)) == "roll P and D −50 %; pitch D −50 %"
    (table,) = gain_table(reviewed)
    assert table.rows[0] == ["ATC_RAT_RLL_P", "0.1", "0.05", "−50 %"]
    # Many different changes are named without percentages, and more gains than have room by the largest changes.
    many = [
        ParameterChange(f"MC_{axis}RATE_{term}", 1.0, 1.1 + number / 10 + share)
        for number, axis in enumerate(("ROLL", "PITCH", "YAW"))
        for term, share in zip("PIDK", (0.0, 0.3, 0.5, 0.9), strict=True)
    ]
    reviewed = reviewed_difference(unchanged(), {}, many)
    assert gain_phrase(many).endswith("P, I, D and K of roll, pitch and yaw")
    (table,) = gain_table(reviewed)
    assert len(table.rows) == 10 and "MC_ROLLRATE_P" not in [row[0] for row in table.rows]


def test_gains_have_a_table_before_many_other_parameters(difference):
    others = [ParameterChange(f"RC_{letter}", 0.0, 1.0) for letter in "ABCDEFGHIJKLMNOPQRSTUVW"]
    gain = ParameterChange("MC_ROLLRATE_P", 0.1, 0.2)
    reviewed = reviewed_difference(difference, parameters=[*others, gain])
    gain_chapter, other_chapter = _parameter_chapters(reviewed._replace(common_parameter_count=99))
    (table,) = gain_chapter.blocks
    assert table.header[0] == "24 of 99 parameters changed, of control 1"
    assert table.header[1:] == ["A", "B", "change"]
    assert table.rows == [["MC_ROLLRATE_P", "0.1", "0.2", "+100 %"]]
    # The table at the top of the page has the gain already.
    assert gain_chapter.folded
    (table,) = other_chapter.blocks
    assert len(table.rows) == 23 and other_chapter.folded
    (chapter,) = _parameter_chapters(reviewed._replace(parameters=[gain, *others[:3]]))
    assert len(chapter.blocks[0].rows) == 4


def test_gains_that_both_sides_name_differently_are_not_compared_and_not_called_equal():
    before = ComparedState([flight_row("quad", 0)], {}, {"RATE_RLL_P": 0.129, "X": 1.0})
    after = ComparedState([flight_row("quad", 1)], {}, {"ATC_RAT_RLL_P": 0.0856, "X": 2.0})
    text = plain_text(headline_of_comparison(compared_states(before, after)))
    assert "no gain" not in text
    assert "RATE_RLL_P 0.129 in A, ATC_RAT_RLL_P 0.0856 in B" in text
    assert renamed_gain(before.parameters, {"RATE_RLL_P": 0.1}) is None
    assert renamed_gain(before.parameters, {"X": 2.0}) is None


def test_parameters_of_two_autopilots_are_not_compared_where_they_share_a_name():
    before = ComparedState(
        [flight_row("quad", 0, autopilot="ARDUPILOTMEGA")], {}, {"RC1_DZ": 20.0, "RATE_RLL_P": 0.1}
    )
    for autopilot, is_compared in (("ARDUPILOTMEGA", True), ("PX4", False)):
        parameters = {"RC1_DZ": 10.0, "MC_ROLLRATE_P": 0.15}
        after = ComparedState([flight_row("quad", 1, autopilot=autopilot)], {}, parameters)
        reviewed = compared_states(before, after)
        assert bool(reviewed.parameters) == is_compared
        text = plain_text(parameter_sentences(reviewed))
        assert ("RC1_DZ" in text) == is_compared
        assert ("A and B have different autopilots" in text) != is_compared


def test_a_difference_below_its_uncertainty_has_its_sign_and_unit():
    overshoot = Quantity("overshoot", axis="pitch")
    change = QuantityChange(overshoot, 0.045, 0.0, -0.045, 0.8, 0.9, 0.0)
    assert change_with_interval(change) == "−4.5 ± 80 percentage points"


def test_only_the_first_sentence_of_a_headline_is_large(difference):
    good = {"level": "good", "sentence": "Nothing wrong."}
    bad = {"level": "bad", "sentence": "Motor 1 failed. It stopped at take-off."}
    reviews = {"A": {"lights": {"motors": good}}, "B": {"lights": {"motors": bad}}}
    page = comparison_page(("a.bin", "b.bin"), reviewed_difference(difference, reviews))
    first, *_ = re.findall('<p class="headline"><strong>(.*?)</strong></p>', page)
    # The heading is what happened and where; the levels of both lights stand below it.
    assert first == "In B: motor\N{NO-BREAK SPACE}1 failed." and "It stopped at take-off." in page
    assert "<strong>Motors:</strong> good in A, bad in B. It stopped at take-off.</p>" in page
    loss = "lost about 25 % of its thrust (17 to 32 %; motor or propeller) with probability 0.87"
    bad["sentence"] = f"Motor 1 (front right) {loss}: it then works 16 % harder."
    headings = light_headings(reviewed_difference(difference, reviews))
    heading = "In B: motor 1 (front right) lost about 25 % of its thrust with probability 0.87."
    assert headings == {"Motors:": heading}
    # What the heading states does not stand below it again, nor in the table of lights.
    page = comparison_page(("a.bin", "b.bin"), reviewed_difference(difference, reviews))
    page = page.replace("\N{NO-BREAK SPACE}", " ")
    below = "The 90 % interval is 17 to 32 % (motor or propeller). It then works 16 % harder."
    assert f"good in A, bad in B. {below}" in page
    assert page.count("probability 0.87") == 1 and "see the top of the page." in page
    # No heading is cut within a clause, and a probability stays.
    clause = (
        "all motors work 8 % harder than in 3 of the vehicle's first flights, taken for healthy"
    )
    bad["sentence"] = (
        f"{clause.capitalize()} (probability 0.66): check the load, then all propellers."
    )
    headings = light_headings(reviewed_difference(difference, reviews))
    assert headings == {"Motors:": f"In B: {clause} (probability 0.66)."}
    # One cause of two lights heads the page once.
    reviews = {
        "A": {"lights": {"motors": good, "tracking": good}},
        "B": {"lights": {"motors": bad, "tracking": bad}},
    }
    headings = light_headings(reviewed_difference(difference, reviews))
    assert headings["Motors:"] and headings["Tracking:"] == ""


def test_the_vibration_at_the_top_is_of_the_imu_that_vibrates_most():
    charts = []
    for title, level in zip(VIBRATIONS, (2.0, 40.0), strict=False):
        line = Line("A", "blue", np.arange(2.0), np.full(2, level))
        charts.append(Chart(title, Axis("time (s)"), Axis(""), (line, line)))
    assert _overview_titles(charts) == [VIBRATIONS[1], MEAN_MOTOR_OUTPUT]


def test_a_bad_margin_is_stated_for_both_flights():
    """The lights of both lack the same margin, which one sentence compares; other reasons stay as they are."""
    states = [
        [flight_row("quad", 0, phase_margin=margin, phase_margin_interval=0.02)]
        for margin in (0.5, 0.2)
    ]
    margins = vehicle_difference(*states)
    figures = {"lacking": "phase_margin", "axis": "roll", "reason": None}
    light = {"level": "bad", "code": MarginsLight.LOOP_MARGINS, "subject": "rate"}
    reviews = {
        side: {"lights": {"margins": light | {"figures": figures, "sentence": f"{side} lacks it."}}}
        for side in "AB"
    }
    sentence, *_ = headline_of_comparison(reviewed_difference(margins, reviews))
    assert sentence.text.startswith("bad in A and B: phase margin on roll 29 → 11° (")
    # A change that is too uncertain is no result; each light then has its own reason, and gains that changed since
    # leave the next step to the later flight.
    reviews["A"]["next_step"] = {"sentence": "Lower P."}
    watched = reviews["B"]["lights"]["margins"] | {"level": "watch", "sentence": "Ms is 2.4."}
    watch = {"B": {"lights": {"margins": watched}, "next_step": {"sentence": "Fly doublets."}}}
    for state in states:
        state[0] = replace(state[0], phase_margin_interval=0.6)
    for gains, step in (
        ([], "Next, by A: Lower P."),
        ([ParameterChange("ATC_RAT_RLL_P", 1.1, 0.2)], "Next, by B: Fly doublets."),
    ):
        uncertain = reviewed_difference(vehicle_difference(*states, gains), reviews | watch, gains)
        first, *others = headline_of_comparison(uncertain)
        # What surely changed comes first, with its size.
        changed_gains = "roll P −82 %."
        assert (first.text == changed_gains) == bool(gains)
        margins_sentence = first
        if gains:
            pair, margins_sentence, *_ = others
            assert pair.text == "Rate loop on roll: phase margin 29 → 11°, not certain to differ."
        assert margins_sentence.text == "bad in A, watch in B. A: A lacks it. B: Ms is 2.4."
        assert plain_text(next_step_sentences(uncertain)) == step
    other_loop = reviews["B"]["lights"]["margins"] | {"subject": "attitude"}
    reviews["B"] = {"lights": {"margins": other_loop}}
    sentence, *_ = headline_of_comparison(reviewed_difference(margins, reviews))
    assert sentence.text == "bad in A and B. A: A lacks it. B: B lacks it."


@pytest.mark.parametrize(
    "date, text",
    [
        ("2026-01-22T10:00:00Z", "2026-01-22 10:00 UTC, 12 days after A"),
        ("2022-05-10T10:00:00Z", "4 years before A"),
        ("2026-01-10T07:40:00Z", "2 hours before A"),
        ("2026-01-10T10:59:30Z", "60 minutes after A"),
        ("2026-01-10T10:00:10Z", "2026-01-10 10:00 UTC"),
    ],
)
def test_the_order_in_time_of_both_flights_is_stated(date, text):
    reviews = {
        "A": {"identity": {"date": "2026-01-10T10:00:00Z"}},
        "B": {"identity": {"date": date}},
    }
    descriptions = side_descriptions(("a", "b"), reviewed_difference(unchanged(), reviews))
    assert descriptions["B"].endswith(text)


def test_the_same_headline_of_both_flights_stands_once():
    (sentence,) = headline_blocks({"A": "Too few messages.", "B": "Too few messages."})
    assert (sentence.lead, sentence.text) == ("Each by itself:", "Too few messages.")
