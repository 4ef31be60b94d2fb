"""What is said of many flights: who needs a look first, what was flown, and what changed between two states."""

from dataclasses import replace
from datetime import timedelta
from math import pi

from fleet_rows import WEAK, flight_row
from pytest import mark

from mavdem.facts.urgency import Urgency
from mavdem.fleet.difference import baseline_differences, vehicle_difference
from mavdem.fleet.flights import group_into_flights
from mavdem.fleet.names import NO_NAMES, GivenNames
from mavdem.fleet.parameter_changes import ParameterChange
from mavdem.fleet.row import FlightRow
from mavdem.fleet.rows_of_log import has_page
from mavdem.report import fleet_summary
from mavdem.report.blocks import plain_text
from mavdem.report.difference.baseline import baseline_blocks
from mavdem.report.difference.changes import difference_blocks
from mavdem.report.difference.conditions import condition_rows
from mavdem.report.difference.headline import headline_of_comparison
from mavdem.report.difference.next_step import next_step_sentences
from mavdem.report.difference.parameters import parameter_sentences
from mavdem.report.difference.reviewed import reviewed_difference
from mavdem.report.fleet import badge, vehicle_health, vehicle_label, vehicle_texts
from mavdem.report.flight_lines import COLUMNS, flight_line
from mavdem.report.pages.fleet_page import _named_cells
from mavdem.report.pages.library_page import vehicles_page
from mavdem.report.vehicle_summary import vehicle_summaries


def fleet_blocks(rows, **options):
    """The summary of a fleet with these rows."""
    return fleet_summary.fleet_blocks(vehicle_summaries(rows), **options)


def fleet_counts(rows):
    """The counts of a fleet with these rows."""
    return fleet_summary.fleet_counts(vehicle_summaries(rows))


@mark.parametrize(
    "headline_level, health, word",
    [
        ("bad", "drift", "bad"),
        ("watch", "fault", "bad"),
        ("good", "drift", "watch"),
        ("good", "ok", "good"),
        (None, "ok", "good"),
        ("unknown", "ok", "unknown"),
    ],
)
def test_the_word_of_a_flight_is_the_worse_level_of_headline_and_motors(
    headline_level, health, word
):
    row = flight_row("quad", 0, headline_level=headline_level, health=health)
    assert badge([(row,)]) == word


def test_a_fleet_has_the_next_step_of_each_vehicle_that_needs_a_look():
    """One vehicle has a weak motor, another oscillates, a third fell.

    Each gives its next step, the most urgent one first and with its reason.
    """
    inspect = "Inspect motor 2 and its propeller before the next flight."
    weak = flight_row("beta", 0, health="fault", suspect_motor=2, next_step="Fly longer.")
    assert f"Next: {inspect}" in plain_text(fleet_blocks([weak]))
    reason = "Motor 2 lost about 21 % of its thrust."
    explained = replace(weak, health_reason=reason)
    assert f"Why: {reason}" in plain_text(fleet_blocks([explained]))
    # Page and terminal have the same headline of one vehicle.
    headline, *_ = fleet_blocks([explained])
    assert headline.lead == "1 vehicle needs a look: beta (motor 2: fault)."
    assert "Seen in: 0000.ulg, 2026-01-05." in plain_text(fleet_blocks([explained]))
    assert fleet_blocks([explained], lists_follow=True)[0] == headline
    motors = fleet_summary.motor_health_by_vehicle(vehicle_summaries([explained]))["beta"]
    assert motors == {"health": "fault", "sentence": reason, "next_step": inspect}
    lost = flight_row("beta", 0, health="unknown", headline="It fell.", headline_level="bad")
    motors = fleet_summary.motor_health_by_vehicle(vehicle_summaries([lost]))["beta"]
    assert (motors["health"], motors["sentence"]) == ("unknown", "It fell.")
    cycle = {"headline": "Oscillates.", "headline_level": "bad", "next_step": "Lower the gains."}
    rows = [flight_row("alpha", 0, **cycle), weak]
    # Of several vehicles each has a line with what was found and what to do, in one order.
    grounded = replace(rows[0], next_step="Do not fly: lower the gains first. Then hover.")
    headline, alpha, beta, *rest = fleet_blocks([grounded, weak])
    assert headline.lead == "2 of 2 vehicles need a look."
    assert (alpha.lead, alpha.text) == (
        "alpha:",
        "oscillates (0000.ulg, 2026-01-05) · Do not fly: lower the gains first.",
    )
    assert (beta.lead, beta.text) == (
        "beta:",
        f"motor 2: fault (0000.ulg, 2026-01-05) · {inspect}",
    )
    assert "Next:" not in plain_text(rest)
    assert vehicle_texts([[rows[0]]]).next_step == "Lower the gains."
    lost = flight_row("beta", 1, **cycle, health="fault", suspect_motor=2)
    assert vehicle_texts([[weak], [lost]]).next_step == f"Lower the gains. {inspect}"
    sound = flight_row("alpha", 0, headline_level="good", next_step="Fly longer.")
    assert "Next:" not in plain_text(fleet_blocks([sound]))


def test_vehicles_in_trouble_come_first_and_the_worst_before_others():
    """Vehicles have a fault, a drift, or a bad headline in their latest flight, or none."""
    cycle = {"headline": "Oscillates.", "headline_level": "bad"}
    rows = [
        flight_row("alpha", 0),
        flight_row("alpha", 1, health="drift"),
        flight_row("alpha", 2, health="unknown"),
        flight_row("beta", 0, health="fault", suspect_motor=2),
        flight_row("newer", 3, health="drift"),
        flight_row("board", 1, **cycle, vehicle_basis="board", firmware="PX4 v1.16.0"),
        flight_row("mended", 0, **cycle),
        flight_row("mended", 1),
    ]
    headline, *lines = fleet_blocks(rows)
    assert headline.lead == "4 of 5 vehicles need a look."
    findings = [f"{line.lead} {line.text.partition(' · ')[0]}" for line in lines[:4]]
    assert findings == [
        "board: oscillates (0001.ulg, 2026-01-06).",
        "beta: motor 2: fault (0000.ulg, 2026-01-05)",
        "newer: drift (0003.ulg, 2026-01-08)",
        # The latest flight was not judged.
        "alpha: drift (0001.ulg, 2026-01-06)",
    ]
    # Several vehicles may have flown under no name, or under one system id.
    unnamed = [
        flight_row("unknown", 0, **cycle, health="unknown"),
        flight_row("1", 0, **cycle, health="unknown", vehicle_basis="system id"),
        flight_row("1", 1, health="unknown", vehicle_basis="system id"),
    ]
    text = plain_text(fleet_blocks([*rows, *unnamed]))
    other_flights_text = "and so do 2 logs of bad flights whose vehicle is not known."
    assert text.startswith(f"4 of 5 vehicles need a look, {other_flights_text}")
    text = plain_text(fleet_blocks(unnamed[:1]))
    assert text.startswith("1 log of a bad flight whose vehicle is not known needs a look.")
    unjudged = plain_text(fleet_blocks([flight_row("quad", 0, health="unknown")]))
    assert unjudged.startswith("Whether motors drift could not be judged of any vehicle yet.")


def test_a_name_that_another_vehicle_has_merges_no_vehicles():
    rows = [flight_row("px4-a", 0, health="drift"), flight_row("px4-b", 1)]
    names = GivenNames({"px4-a": "px4-b"}, logged_vehicles=frozenset({"px4-a", "px4-b"}))
    text = plain_text(fleet_blocks(rows, names=names))
    assert text.startswith("1 of 2 vehicles needs a look: px4-b (px4-a) (drift)")
    assert "2 flights of 2 vehicles" in text


@mark.parametrize(
    "given, labels",
    [
        ({"A": "Red", "C": "Red", "D": "Red (A)"}, ["Red (A)", "B", "Red (C)", "Red (A) (D)"]),
        ({"A": "B", "B": "A"}, ["B (A)", "A (B)", "C", "D"]),
        ({"A": "A", "B": "Blue"}, ["A", "Blue", "C", "D"]),
    ],
)
def test_no_two_vehicles_are_called_the_same(given, labels):
    names = GivenNames(given, logged_vehicles=frozenset("ABCD"))
    assert [names.vehicle(vehicle) for vehicle in "ABCD"] == labels


def test_a_repaired_vehicle_says_that_later_flights_show_nothing():
    """The first flight has a fault of motor 1, the second is sound."""
    flights = [
        [flight_row("quad", 0, health="fault", suspect_motor=1, fault_probability=0.99)],
        [flight_row("quad", 1)],
    ]
    assert vehicle_health(flights) == "ok"
    summary_text = vehicle_texts(flights).all_flights
    # That a motor is weak, whichever it is: the row has no probability of this motor.
    assert (
        "motor 1 (probability of a fault 0.99)" in summary_text
        and "The latest flight that was judged shows none." in summary_text
    )
    # What a drift is stands beside the word.
    drifted = [[flight_row("quad", 2, health="drift")]]
    assert "a drift in 1 (a change is more likely than not" in vehicle_texts(drifted).all_flights
    assert "more likely than not" not in summary_text
    text = plain_text(fleet_blocks([row for flight in flights for row in flight]))
    assert text.startswith("No drift and no fault in the latest flights of 1 vehicle")
    assert "A drift or a fault in earlier flights, and not in the latest: quad." in text


def test_vehicles_to_watch_and_not_judged_are_counted_beside_those_that_need_a_look():
    """One vehicle was lost, two are to be watched; no motors could be judged."""
    unjudged = {"health": "unknown", "headline": "It drifts.", "headline_level": "watch"}
    rows = [
        flight_row("lost", 0, health="unknown", headline="It fell.", headline_level="bad"),
        flight_row("changed", 0, **unjudged),
        flight_row("other", 0, **unjudged),
    ]
    text = plain_text(fleet_blocks(rows))
    assert "1 of 3 vehicles needs a look: lost (it fell); 2 more are to be watched." in text
    # A terminal has no list of all vehicles, in which these would be found.
    watched_line = "changed, to watch: it drifts (0000.ulg, 2026-01-05)."
    assert text.index("Seen in:") < text.index(watched_line) < text.index("Flown:")
    assert "to watch" not in plain_text(fleet_blocks(rows, lists_follow=True))
    assert "Motors not compared between flights: 3 vehicles." in text
    text = plain_text(fleet_blocks(rows[1:2]))
    assert text.startswith("1 vehicle is to be watched: changed (it drifts).")
    assert "Between flights: whether motors drift could not be judged of any vehicle yet." in text
    assert "Motors not compared" not in text
    assert plain_text(fleet_blocks(rows[1:])).startswith(
        "2 vehicles are to be watched: changed (it drifts) and other."
    )
    watched_line = "other, to watch: it drifts (0000.ulg, 2026-01-05)."
    assert watched_line in plain_text(fleet_blocks(rows[1:]))
    # A vehicle that flew with the same fault from the first flight on shows no drift.
    motors = {"headline": "Motor 1 is weak.", "headline_level": "watch", "light_motors": "watch"}
    same = flight_row("same", 0, **motors, next_step="Compare its propeller.")
    text = plain_text(fleet_blocks([same]))
    assert text.startswith("1 vehicle is to be watched: same (motor 1 is weak).")
    assert "in 1 vehicle, but its first flights may have had the same." in text
    assert "Next: Compare its propeller." in text


def test_a_flight_that_two_logs_have_counts_once_and_by_the_better():
    slow = [
        flight_row("quad", 0, axis, key="slow", file="/logs/quad/0.tlog", tier="c")
        for axis in ("roll", "pitch")
    ]
    late = [replace(row, date=row.date + timedelta(seconds=5)) for row in slow]
    rows = [flight_row("quad", 0), *late, flight_row("quad", 1, duration=600.0)]
    assert "2 flights of 1 vehicle (1 more log has a flight of these)" in plain_text(
        fleet_blocks(rows)
    )
    assert "2026-01-05 to 2026-01-06, 3 min in the air, 11 min settled" in plain_text(
        fleet_blocks(rows)
    )
    counts = fleet_counts(rows)
    assert (counts["flights"], counts["tiers"], counts["health"]) == (2, {"a": 2}, {"ok": 2})
    # A log with three flights, and one of a vehicle that turned over before it flew.
    rows = [replace(rows[0], flight_count=3), replace(rows[-1], flight_count=0)]
    assert "Flown: 3 flights in 2 logs of 1 vehicle" in plain_text(fleet_blocks(rows))
    counts = fleet_counts(rows)
    assert (counts["flights"], counts["tiers"]) == (3, {"a": 2})
    simulated = [replace(row, simulated=1) for row in rows]
    assert "Simulated: 3 flights" in plain_text(fleet_blocks(simulated))


def test_a_flight_without_figures_keeps_its_headline_and_is_not_called_unused():
    """A flight that was too short for figures has a headline by its log; a log without time in the air has none."""
    reason = "No settled flight (between climb and landing) in 50 s in the air."
    landed = {"headline": "Landed hard at 1.8 m/s.", "headline_level": "watch"}
    short = flight_row("quad", 0, status=reason, health="unknown", **landed)
    cells = dict(zip(COLUMNS, flight_line([short]).cells, strict=True))
    assert cells["health"] == "watch"
    assert cells["notes"].split("\n") == [
        "Landed hard at 1.8 m/s.",
        f"Motors not compared: {reason}",
    ]
    on_ground = replace(short, flight_time=0.0)
    cells = dict(zip(COLUMNS, flight_line([on_ground]).cells, strict=True))
    assert (cells["health"], cells["notes"]) == ("not used", reason)


def test_a_wind_without_an_end_of_its_interval_is_the_estimate_alone():
    """A row has None in the place of a number that is not finite."""
    nan = float("nan")
    rows = [
        flight_row("quad", number, wind_speed=speed, wind_speed_interval=(low, nan))
        for number, (speed, low) in enumerate([(3.0, 1.0), (nan, nan)])
    ]
    assert [flight_line([row]).cell("wind (m/s)") for row in rows] == ["3.0", ""]
    (summary,) = vehicle_summaries([replace(rows[0], wind_direction=1.0)])
    assert summary.winds == [(1.0, 3.0, 3.0, 3.0)]


def test_the_motor_of_a_flight_is_the_one_that_failed_in_it_or_that_others_suspect():
    flight = [flight_row("quad", 0, failed_motor=2), flight_row("quad", 0, suspect_motor=4)]
    assert COLUMNS["motor"].cell(flight) == "2 and 4"
    assert COLUMNS["motor"].cell([flight_row("quad", 0)]) == ""


def test_flights_by_a_system_id_are_no_vehicle_until_they_are_judged_as_one():
    """Logs that name only a MAVLink system id may be of several vehicles."""
    rows = [
        flight_row("px4-1", number, vehicle_basis="system id", health="unknown")
        for number in range(2)
    ]
    text = plain_text(fleet_blocks(rows))
    assert "2 flights whose logs do not name a vehicle" in text and "of 1 vehicle" not in text
    assert fleet_counts(rows)["vehicles"] == 0
    # A simulated flight without a name stands beside those that were flown, and is none of them.
    text = plain_text(fleet_blocks([flight_row("quad", 0), replace(rows[0], simulated=1)]))
    assert "Flown: 1 flight of 1 vehicle, 2026-01-05" in text and "1 simulated besides" in text
    # Logs that are too slow for margins are to be faster.
    assert "40 Hz" not in text
    text = plain_text(fleet_blocks([replace(flight_row("quad", 0), tier="b")]))
    assert "slow motion alone (1). To know margins, log attitude, body rates and motors" in text
    # A bad flight under such a name is counted once, as a flight.
    fell = replace(rows[1], headline="It fell.", headline_level="bad")
    text = plain_text(fleet_blocks([rows[0], fell, flight_row("quad", 0)]))
    assert text.startswith("1 log of a bad flight whose vehicle is not known needs a look.")
    assert "(unnamed PX4 quadrotor): it fell." in text
    bad_rows = [replace(row, headline="It fell.", headline_level="bad") for row in rows]
    text = plain_text(fleet_blocks(bad_rows))
    assert text.startswith("2 logs of bad flights whose vehicle is not known need a look.")
    assert text.count("(unnamed PX4 quadrotor): it fell.") == 2
    judged = [replace(row, health="fault") for row in rows]
    text = plain_text(fleet_blocks([*judged, flight_row("quad", 0)]))
    assert (
        "1 needs a look: unnamed PX4 quadrotor (fault)" in text and "2 flights whose logs" in text
    )
    assert "3 flights of 1 vehicle and of unnamed ones" in text
    assert [COLUMNS["vehicle"].cell([row]) for row in (rows[0], flight_row("quad", 0))] == [
        "unnamed PX4 quadrotor",
        "quad",
    ]
    line = flight_line(rows)
    named = GivenNames(vehicles={"px4-1": "Red quad"})
    assert [_named_cells(line, names)[1] for names in (NO_NAMES, named)] == [
        "unnamed PX4 quadrotor",
        "Red quad",
    ]
    assert "px4-1" not in text
    assert "these may be several" in vehicle_texts([[row] for row in judged]).all_flights


def rows_of_flight(number, vehicle="quad", **changed):
    """Returns the rows of one flight, for roll and pitch, under usual conditions but for ``changed`` columns."""
    conditions = {"voltage_mean": 16.0, "collective": 0.4}
    return [
        flight_row(vehicle, number, axis, **(conditions | changed)) for axis in ("roll", "pitch")
    ]


def test_wind_battery_and_lean_are_conditions():
    difference = vehicle_difference(
        rows_of_flight(0, lean_roll=0.0, lean_pitch=0.0),
        rows_of_flight(1, wind_torque_sd=4.0, voltage_mean=14.0, lean_roll=0.2, lean_pitch=0.0),
    )
    texts = [row.text for row in condition_rows(reviewed_difference(difference))]
    assert {
        "battery 16.0 → 14.0 V",
        "mean roll and pitch 0 and 0 → +11 and 0°",
        "wind torque on roll 46 → 229 °/s²",
    } <= {*texts}


def test_two_vehicles_differ_and_none_changed():
    margins = {"phase_margin_interval": 0.05}
    before = rows_of_flight(0, "quad", phase_margin=1.0, **margins)
    for vehicle, word in (("quad", "Changed: "), ("other", "Different: ")):
        after = rows_of_flight(1, vehicle, phase_margin=0.3, **margins)
        text = plain_text(
            headline_of_comparison(reviewed_difference(vehicle_difference(before, after)))
        )
        assert word in text
        assert ("Changed" in text) == (vehicle == "quad")


def test_motors_are_not_checked_for_what_new_gains_explain():
    """The phase margin fell between two flights.

    With changed gains they are named as the cause, and a check of the motors is not advised.
    """
    before = rows_of_flight(0, phase_margin=1.0, phase_margin_interval=0.05)
    after = rows_of_flight(1, phase_margin=0.3, phase_margin_interval=0.05)
    gains = [ParameterChange(f"ATC_RAT_{axis}_P", 0.1, 0.2) for axis in ("RLL", "PIT")]
    assert "check motors" in plain_text(
        next_step_sentences(reviewed_difference(vehicle_difference(before, after)))
    )
    difference = vehicle_difference(before, after, gains)
    assert not next_step_sentences(reviewed_difference(difference))
    equal = reviewed_difference(difference)._replace(common_parameter_count=866)
    assert "all 866 that A and B have in common are equal" in plain_text(parameter_sentences(equal))
    names = ("RC1_MIN", "STAT_BOOTCNT", "COMPASS_OFS_X")
    equal = equal._replace(
        parameters_set_by_autopilot=[ParameterChange(name, 0.0, 1.0) for name in names]
    )
    text = plain_text(parameter_sentences(equal))
    assert (
        "863 of 866 that A and B have in common are equal; 1 of a new calibration (radio), 1 calibrated or learned "
        "in flight (compass), 1 counted or learned by the autopilot." in text
    )
    # A few parameters that are no gains are named, but none that a flight does not depend on.
    others = [
        ParameterChange(name, 2.0, 5.0) for name in ("WPNAV_SPEED", "SIM_WIND_SPD", "MAV_SYS_ID")
    ]
    without_gains = reviewed_difference(vehicle_difference(before, after, others), {}, others)
    headline = headline_of_comparison(without_gains)
    assert "Parameters: WPNAV_SPEED 2 → 5; no gain of the rate controllers differs." in plain_text(
        headline
    )
    assert "SIM_WIND_SPD 2 → 5" in plain_text(parameter_sentences(without_gains, headline))
    of_id_alone = without_gains._replace(parameters=others[1:])
    assert "Parameters:" not in plain_text(headline_of_comparison(of_id_alone))
    # The gains are the cause, and what follows from them is neither doubtful nor tested.
    sentences = headline_of_comparison(reviewed_difference(difference, {}, gains))
    headline = plain_text(sentences)
    # That no other figure changed comes after those that did, and none is named twice.
    assert headline.index("By them") < headline.index("No compared figure changed")
    also = plain_text(
        difference_blocks(reviewed_difference(difference, parameters=gains), sentences)
    )
    # The list has the interval that the headline leaves out.
    assert "By the changed gains: phase margin on pitch 57 → 17° (−40" in also
    assert "Settings of the control of roll and" in also
    assert "roll and pitch P +100 %.\n\nBy them: phase margin on pitch 57 → 17°;" in headline
    assert (
        "No compared figure changed significantly, but for what other gains explain. "
        "Of 14 figures (trims and physical parameters) 2 are too uncertain to tell."
    ) in headline
    assert "Doubtful" not in plain_text(
        difference_blocks(reviewed_difference(difference, parameters=gains))
    )


def test_a_figure_of_a_loop_with_other_gains_differs_only_by_its_own_interval():
    before = rows_of_flight(
        0, phase_margin=1.0, phase_margin_interval=0.2, ms=1.4, ms_interval=0.01
    )
    after = rows_of_flight(1, phase_margin=1.1, phase_margin_interval=0.2, ms=3.0, ms_interval=0.01)
    gains = [ParameterChange("ATC_RAT_RLL_P", 0.1, 0.2), ParameterChange("ATC_RAT_PIT_P", 0.1, 0.2)]
    reviewed = reviewed_difference(vehicle_difference(before, after, gains), parameters=gains)
    sentences = difference_blocks(reviewed)
    texts = {sentence.lead: sentence.text for sentence in sentences}
    # The headline states what may have become of the margins, though it is not certain.
    pairs = "on pitch: phase margin 57 → 63°; on roll: phase margin 57 → 63°"
    headline = [sentence.text for sentence in headline_of_comparison(reviewed)]
    assert f"Rate loop {pairs}, not certain to differ." in headline
    assert texts["By the changed gains:"].startswith("Ms on ")
    assert "phase margin" not in texts["By the changed gains:"]
    assert "phase margin on roll 57 → 63°" in texts["Uncertain:"]


def test_the_bound_on_false_changes_is_that_of_the_families_that_were_tested():
    """The text about false alarms names trims and physical parameters, or trims only."""
    flights = rows_of_flight(0), rows_of_flight(1, voltage_mean=15.0)
    text = plain_text(difference_blocks(reviewed_difference(vehicle_difference(*flights))))
    assert (
        "(trims and physical parameters), so that of the changes found in a group at most" in text
    )
    assert "at most one in 20 is expected to be wrong, on average over these groups." in text
    without_models = {f"{name}_status": "refused" for name in ("effect", "damping", "lag")}
    flights = [[replace(row, **without_models) for row in rows] for rows in flights]
    text = plain_text(difference_blocks(reviewed_difference(vehicle_difference(*flights))))
    assert "4 figures (trims), so that of the changes found at most one in 20 is" in text


def test_the_latest_flight_of_each_vehicle_is_compared_with_the_baseline():
    """Four healthy flights, and then four in which motor 3 is weak."""
    baseline = [row for number in range(4) for row in rows_of_flight(number)]
    later = [row for number in range(4, 8) for row in rows_of_flight(number, **WEAK)]
    rows = [*baseline, *later, *rows_of_flight(0, "new"), *rows_of_flight(0, "unknown")]
    differences = baseline_differences(rows, baseline)
    assert set(differences) == {"quad", "new"} and differences["new"][1] is None
    text = plain_text(baseline_blocks(*differences["quad"]))
    # Each change is named once.
    assert "Changed: motor 3's control effectiveness −29 % (−35 to −23 %), and motor 3's" in text
    assert text.count("motor 3's relative trim +12 % (+9 to +15 %)") == 1
    for widest in ("4 %", "9 %", "0.40 1/s", "13 ms"):
        assert f" (within ±{widest})" in text
    # Its whole interval is not within 20 %: too uncertain to be called the same.
    assert "Uncertain: mean control effectiveness on pitch −9 % (−24 to +10 %)" in text
    assert "the latest log, 0007.ulg (2026-01-12), compared with 4 logs." in text
    assert "over the median motor's" in text


def test_a_flight_without_a_date_comes_last():
    rows = [flight_row("quad", 0, date=None), flight_row("quad", 1)]
    assert sum(group_into_flights(rows), []) == rows[::-1]


@mark.parametrize(
    "speed, interval, text",
    [
        (5.7, None, "5.7 W (270°) →"),
        (5.7, (5.1, 6.5), "5.1 to 6.5 W (270°) →"),
        (5.7, (2.9, 10.4), "2.9 to 10.4 W (270°) →"),
        (None, (0.0, 2.04), "below 2.1 W (270°) →"),
        (None, (1.2, 6.0), "1.2 to 6.0 W (270°) →"),
        (None, None, "W (270°) →"),
    ],
)
def test_a_wind_that_is_known_only_roughly_is_an_interval_in_the_table(speed, interval, text):
    """The cell has the interval, and the speed alone only where no interval is known."""
    row = flight_row(
        "quad", 0, wind_speed=speed, wind_speed_interval=interval, wind_direction=1.5 * pi
    )
    assert flight_line([row]).cells[[*COLUMNS].index("wind (m/s)")] == text


def test_before_a_list_all_of_five_vehicles_in_need_have_a_line_and_the_worst_of_more():
    """Four named vehicles fell, and two flights have no known vehicle.

    Where a list follows, the headline is short.
    """
    rows = [
        flight_row(f"quad {number}", 0, headline=f"Fell {number}.", headline_level="bad")
        for number in range(3)
    ]
    rows += [
        flight_row(
            "px4-1", number, vehicle_basis="system id", headline="Lost.", headline_level="bad"
        )
        for number in (1, 2)
    ]
    rows.append(replace(rows[0], vehicle="quad 3", headline="Fell 3.", file="fourth.bin"))
    for lists_follow in (False, True):
        headline, *lines = fleet_blocks(rows, lists_follow=lists_follow)
        assert headline.lead == (
            "4 of 4 vehicles need a look, and so do 2 logs of bad flights whose vehicle is not known."
        )
        assert sum("(unnamed PX4 quadrotor):" in line.lead for line in lines) == 2
    # A flight to be watched counts, too, if its vehicle is not known.
    rows.append(
        flight_row("px4-2", 3, vehicle_basis="system id", headline="Low.", headline_level="watch")
    )
    headline, *_ = fleet_blocks(rows, lists_follow=True)
    assert headline.lead.endswith("not known; 1 log of an unnamed vehicle is to be watched.")
    # Each of up to five vehicles has a line above the list, and so has the flight to be watched, with its page.
    _, *lines = fleet_blocks(rows, lists_follow=True)
    leads = [f"quad {number}:" for number in range(4)]
    bad = [f"000{number}.ulg (unnamed PX4 quadrotor):" for number in (2, 1)]
    watched = "0003.ulg (unnamed PX4 quadrotor), to watch:"
    assert [line.lead for line in lines[:8]] == [*leads, *bad, watched, "Flown:"]
    # The list below has the flight and what to do.
    assert lines[0].text == "fell 0." and lines[6][0::3] == (
        "low.",
        "pages/px4-2-3.html",
    )
    # The list says what to do; a terminal has none, and says it here.
    rows[0] = replace(rows[0], next_step="Do not fly.")
    texts = [fleet_blocks(rows, lists_follow=follows)[1].text for follows in (True, False)]
    assert texts == [
        "fell 0.",
        "fell 0 (0000.ulg, 2026-01-05) · Do not fly.",
    ]
    # A crash comes before a drift of the motors.
    drift = {"health": "drift", "health_reason": "The load shifted. More."}
    drifted = replace(rows[0], **drift, flight_time=12.6, status="Too short.")
    assert fleet_blocks([drifted, rows[1]])[1].text == (
        "fell 0. The load shifted (0000.ulg, 2026-01-05) · Do not fly. Unless they were replaced, check motors and "
        "propellers, then the load."
    )
    assert flight_line([drifted]).cell("time") == "0:13"
    assert "13 s in the air" in plain_text(fleet_blocks([drifted]))
    # A vehicle that is no multirotor has lights and a page, and is no flight to look at.
    submarine = FlightRow(
        file="sub.tlog",
        frame="SUBMARINE",
        headline="It was in a failsafe.",
        headline_level="watch",
        status="Give a multirotor's log.",
        status_code="no_multirotor",
    )
    line = flight_line([submarine])
    assert line.finding == "Submarine: lights alone, no model and no motors. It was in a failsafe."
    assert line.urgency is Urgency.UNKNOWN and has_page([submarine])
    # Nor is it without a word among the vehicles of a library.
    values = {"given": NO_NAMES, "frames": {}, "unnamed_groups": ()}
    page = vehicles_page([replace(submarine, vehicle="Nemo"), rows[0]], **values)
    assert page.index(">quad 0<") < page.index(">Nemo<")
    assert '<span class="said watch">Submarine: lights alone, no model and no motors.' in page
    board = "3063313364663764343766363439613462_submarine"
    assert vehicle_label(board, "", NO_NAMES) == "Submarine 3063…613462"
    # Of more vehicles the worst have a line.
    more = [replace(rows[1], vehicle=f"quad {number}", file=f"{number}.bin") for number in (4, 5)]
    _, *lines = fleet_blocks([*rows, *more], lists_follow=True)
    assert [line.lead for line in lines[:3]] == leads[:3]
    assert lines[3].text == "And 3 more vehicles below."
    # So have two vehicles: what is wrong stands at the top of the page.
    headline, *lines = fleet_blocks(rows[:2], lists_follow=True)
    assert headline.lead == "2 of 2 vehicles need a look."
    assert [line.lead for line in lines[:2]] == ["quad 0:", "quad 1:"]


def test_a_crash_in_a_simulator_is_marked_and_needs_no_look():
    crash = {"vehicle_basis": "system id", "headline": "Lost.", "headline_level": "bad"}
    simulated, real = (
        flight_row("px4-1", number, simulated=1 - number, **crash) for number in (0, 1)
    )
    assert flight_line([simulated]).cells[[*COLUMNS].index("vehicle")].endswith(", simulated")
    text = plain_text(fleet_blocks([simulated]))
    assert "need" not in text.split("Simulated:")[0] and "Simulated: 1 flight;" in text
    assert "all simulated" in text
    text = plain_text(fleet_blocks([simulated, real]))
    assert "1 log of a bad flight" in text
    assert "Flown: 1 flight, " in text and "; 1 simulated besides. Its log" in text
    # The log has neither parameters nor a serial number, by which a simulator would show.
    undecided = "Counted as flown: 1 log, since it has neither parameters nor a board's number"
    assert undecided in text and "would show: 0001.ulg, 2026-01-06." in text
    for columns in ({"control_parameters": '{"ATC_RAT_RLL_P": 0.1}'}, {"vehicle_basis": "board"}):
        decided = replace(real, **columns)
        assert "Counted as flown" not in plain_text(fleet_blocks([simulated, decided]))
