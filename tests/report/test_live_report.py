"""The report of a live session: what its time was spent on."""

import re
from dataclasses import replace

import numpy as np
from pytest import mark

from mavdem.assessment.flight_verdict import FlightVerdict
from mavdem.assessment.judgement import unjudged
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import Headline
from mavdem.facts.ending import Ending
from mavdem.facts.event import Event
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Light
from mavdem.facts.loops import GainFact, LoopFact
from mavdem.facts.motors import MotorsLight
from mavdem.facts.power import PowerLight
from mavdem.facts.session import MissingMessages, RowsFact, SessionFact, TimeUse
from mavdem.facts.watch import WatchFact
from mavdem.facts.witnesses import HeightSource
from mavdem.fleet.names import GivenNames
from mavdem.live.history import LiveHistory
from mavdem.live.link_loss import link_loss_fact
from mavdem.live.session_status import SessionStatus
from mavdem.live.takeoff_place import Displacement
from mavdem.live.vehicle_state import VehicleState
from mavdem.motors.motor_changes import MotorChange
from mavdem.report.blocks import Sentence, Table
from mavdem.report.live import (
    headline_reason,
    live_alarm,
    live_report,
    live_title,
    statement_of_headline,
    status_line_text,
    vehicle_state_cells,
)
from mavdem.report.pages.live_page import live_page
from mavdem.report.pages.page_link import PageLink
from mavdem.report.templates import headline

NOT_JUDGED_LEVELS = dict.fromkeys(Light, "")
"""Levels of the lights of a recording of which nothing is judged."""


def test_the_table_of_time_adds_up():
    """Uses of less than a second have no row."""
    account = dict.fromkeys(TimeUse, 0.0)
    first, second, third = list(TimeUse)[:3]
    account |= {first: 12.2, second: 30.0, third: 0.3}
    blocks = live_report(LiveHistory(), SessionStatus(), account, "roll")
    [table] = [block for block in blocks if isinstance(block, Table)]
    assert table.header == ["of 42 s", "time"]
    assert [row[1] for row in table.rows] == ["12 s", "30 s"]


def test_the_title_of_a_live_page_names_the_vehicle_as_its_owner_does():
    assert live_title(SessionStatus(), "udpin:0", GivenNames()) == "No vehicle yet on udpin:0"
    # Of a vehicle without attitude no state is known.
    assert status_line_text(SessionStatus("3:1")).startswith("3:1; ")
    state = VehicleState(
        system=3, frame="GROUND_ROVER", autopilot="ARDUPILOTMEGA", name_in_logs="ardupilotmega-3"
    )
    status = SessionStatus("3:1", state=state)
    assert live_title(status, "", GivenNames()) == "Ground rover, ArduPilot, vehicle 3"
    names = GivenNames(vehicles={"ardupilotmega-3": "Old Red"})
    assert live_title(status, "", names) == "Old Red, ArduPilot, vehicle 3"


def test_the_headline_of_a_live_flight_leaves_what_was_checked_to_the_lights_beside_it():
    nothing_wrong = Fact(Headline.NOTHING_WRONG, Level.GOOD)
    text = "No alarm now; too little was checked: motors were checked."
    assert statement_of_headline(text, nothing_wrong) == "No alarm now; too little was checked."
    assert statement_of_headline("Bad: this.", Fact(SessionFact.NOT_FLYING)) == "Bad: this."


@mark.slow
def test_an_alarm_that_is_over_is_neither_in_the_title_nor_beside_the_headline():
    """Motors were at their limit and recovered.

    The past alarm is an event of the page and no warning in its title.
    """
    limit = Fact(MotorsLight.MOTORS_AT_LIMIT, Level.BAD, time=9.0, names=("motor 1", "motor 2"))
    alarm = Fact(SessionFact.ALARM, time=9.0, reason=limit)
    history = LiveHistory()
    history.add_event(Event(9.0, alarm, reception=0.0))
    account = dict.fromkeys(TimeUse, 0.0)
    lasting = SessionStatus(
        "1:1",
        is_flying=True,
        message_age=0.0,
        active_alarms=(limit,),
        worst_lights={Light.MOTORS: limit},
    )
    over = Fact(WatchFact.ALARM_OVER, Level.BAD, time=20.0, reason=limit)
    past = replace(lasting, active_alarms=(over,), worst_lights={Light.MOTORS: over})
    assert live_alarm(lasting).startswith("⚠") and live_alarm(past) == ""
    page = live_page("udp", "roll", history, past, account, None)
    # The alarm of before is an event, and asks for nothing beside the headline.
    assert (
        "Over since 20\N{NO-BREAK SPACE}s" in page and page.count("Alarm: motor 1 and motor 2") == 1
    )


@mark.slow
def test_a_page_states_a_weak_motor_in_its_headline_and_the_details_in_its_event_alone():
    change = MotorChange(58.0, 56.0, 2, "motor 2", 0.3, 0.99, loss=(0.2, 0.4))
    weak_motor = change.fact
    history = LiveHistory()
    history.add_event(Event(58.0, Fact(SessionFact.ALARM, reason=weak_motor), reception=0.0))
    account = dict.fromkeys(TimeUse, 0.0)
    flying = SessionStatus(
        "1:1",
        is_flying=True,
        flight_number=1,
        message_age=0.0,
        active_alarms=(weak_motor,),
        motor_alarms_of_flight=(change,),
    )
    page = live_page("udp", "roll", history, flying, account, None)
    assert page.replace("\N{NO-BREAK SPACE}", " ").count("(probability 0.99)") == 1
    assert "Why:" not in page and "(see the headline)" in page
    # The report of the landing stays in sight, and leaves its verdict to the headline.
    landing = Fact(
        SessionFact.FLIGHT_LEARNED,
        clock=70.0,
        axis="roll",
        is_flying=False,
        is_lost=False,
        verdict=weak_motor,
        is_fitted=False,
        margins_follow=True,
        reason=(),
    )
    disarmed = Fact(ReportedEvent.MOTORS_DISARMED)
    for seconds, fact in ((70.0, landing), *((71.0 + index, disarmed) for index in range(5))):
        history.add_event(Event(seconds, fact, reception=0.0))
    landed = replace(flying, is_flying=False, active_alarms=())
    page = live_page("udp", "roll", history, landed, account, None)
    assert page.index("Landed at") < page.index("Earlier events")
    assert "Landed at 70 s. Its recording is judged next. Mean wind" in page
    # The verdict of the recording states the details in the headline, and no reason repeats them.
    verdict = Fact(
        SessionFact.RECORDING_JUDGED,
        Level.BAD,
        headline=weak_motor.sentence,
        next_step=weak_motor.remedy,
        levels=dict.fromkeys(Light, ""),
        light_sentences={},
    )
    judged = replace(landed, is_over=True, recording_verdict=verdict)
    page = live_page("udp", "roll", history, judged, account, None)
    assert "Why:" not in page and "of its thrust" in page.replace("\N{NO-BREAK SPACE}", " ")


def test_a_telephone_always_shows_mode_height_battery_satellites_and_link():
    """A lost link and an emptying battery have the colour of a fault; what is not known is left out."""
    state = VehicleState(
        mode="Loiter", is_armed=True, voltage=11.1, charge=20.0, has_position_fix=True, satellites=9
    )
    flying = SessionStatus(
        "1:1",
        state=state,
        is_flying=True,
        flight_seconds=65.0,
        message_age=0.0,
        rates={"ATTITUDE": 50.0},
        position=(3.0, 4.0, -12.0),
        takeoff_position=(0.0, 0.0, 0.0),
    )
    cells = vehicle_state_cells(flying)
    assert [(cell.lead, cell.text) for cell in cells] == [
        ("Loiter", "in flight 1:05"),
        ("12 m up", "5 m away"),
        ("11.1 V", "20 %"),
        ("9", "satellites"),
        ("50 Hz", "link"),
    ]
    no_fix = replace(flying, state=state._replace(has_position_fix=False))
    assert vehicle_state_cells(no_fix)[3].lead == "No fix"
    landed = replace(flying, is_flying=False, state=VehicleState(is_armed=False))
    assert [cell.text for cell in vehicle_state_cells(landed)] == ["disarmed", "link"]
    silence = Fact(RowsFact.NOTHING_RECEIVED, duration=12.0)
    lost = replace(flying, message_age=12.0, no_model_reason=silence)
    *last_values, link = vehicle_state_cells(lost)
    assert (link.lead, link.text, link.level) == ("12 s ago", "last message", Level.BAD)
    assert {cell.level for cell in last_values} == {Level.UNKNOWN}


@mark.slow
def test_gains_are_a_table_and_the_page_of_an_ended_session_names_its_files_and_flight():
    """The events have neither the gains nor what the twin does with them."""
    rating = Fact(
        LoopFact.MARGIN_RATING, subject="rate", phase_margin=52.0, gain_margin=9.0, ms=1.6
    )
    reason = Fact(
        GainFact.STEP_TOWARDS_MARGINS,
        is_sound=True,
        share=0.67,
        share_as_flown=0.9,
        stage=1,
        flights=1,
        expected=rating,
        phase_margin=45.0,
        gain_margin=6.0,
        ms=2.0,
    )
    gains = Fact(
        GainFact.GAINS_ADVISED,
        subject="roll",
        changes=[("ATC_RAT_RLL_P", 1.084, 0.722), ("ATC_RAT_RLL_I", 2.0, 2.0)],
        reason=reason,
        expected_error=0.045,
        present_error=0.03,
    )
    history = LiveHistory()
    written = Fact(GainFact.GAINS_WRITTEN, path="f.gains.params", reason=reason)
    for fact in (Fact(GainFact.ADVICE_WAITS), gains, written):
        history.add_event(Event(9.0, fact, reception=0.0))
    over = SessionStatus("1:1", is_over=True, flight_number=3)
    account = dict.fromkeys(TimeUse, 0.0)
    files = ["Recording: f.tlog. Judge it: `mavdem f.tlog`"]
    page = live_page("udp", "roll", history, over, account, None, files=files)
    assert page.count("ATC_RAT_RLL_P") == 1 and "<td>0.722</td>" in page
    assert "ATC_RAT_RLL_I" not in page, "a gain that stays is not in the table"
    chapter_on_gains = page.split('id="gains"')[1].split("<section")[0]
    assert "0.722" in chapter_on_gains and "keeps up with the link" not in chapter_on_gains
    assert "plots of flight 3" in page
    assert "This session is over." in page and "<code>mavdem f.tlog</code>" in page
    # What to do and the lights come first.
    places = [page.index(f'id="{name}"') for name in ("result", "lights", "files", "flight")]
    assert places == sorted(places)


def test_a_weak_motor_of_an_earlier_flight_is_named_as_such():
    loss = MotorChange(58.0, 56.0, 2, "motor 2", 0.3, 0.99, loss=(0.2, 0.4))
    of_flight = SessionStatus("1:1", motor_alarms=(loss,), motor_alarms_of_flight=(loss,))
    seconds = dict.fromkeys(TimeUse, 0.0)
    for status, lead in (
        (of_flight, "Motors:"),
        (replace(of_flight, motor_alarms_of_flight=()), "Motors, in an earlier flight:"),
    ):
        report = live_report(LiveHistory(), status, seconds, "roll")
        leads = [block.lead for block in report if isinstance(block, Sentence)]
        assert lead in leads


def test_the_headline_of_a_lost_link_is_short_and_where_it_was_stands_below():
    loss = link_loss_fact(
        Fact(RowsFact.NOTHING_RECEIVED, duration=12.0),
        12.0,
        0.0,
        Displacement(distance=5.0, height=12.0),
        11.1,
        None,
        cause=None,
        is_over=False,
    )
    judgement = replace(unjudged(loss), headline=loss)
    assert headline(loss) == "Link lost 12 s ago, in flight."
    assert headline_reason(judgement) == [], "the bar of the page has height, distance and voltage"
    over = replace(judgement, headline=loss.replace(is_over=True))
    [last_seen] = headline_reason(over)
    assert last_seen.lead == "Last seen:"
    assert last_seen.text.startswith(
        "12 m above the take-off, 5 m from it, battery 11.1 V; no latitude and longitude"
    )
    # On the page it comes before the lights, which a telephone would show in its place.
    silence = Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MESSAGES, duration=12.0)
    silent = SessionStatus("1:1", is_flying=True, message_age=12.0, no_model_reason=silence)
    account = dict.fromkeys(TimeUse, 0.0)
    page = live_page("udp", "roll", LiveHistory(), silent, account, None)
    assert page.index("Last seen:") < page.index('<section id="lights">')
    # The verdict on the flight keeps the place, by which the vehicle is searched; the page has it once, in its card.
    assert "12 m above the take-off" in headline(loss.replace(is_over=True))
    over = replace(silent, is_over=True, last_reception=0.0)
    page = live_page("udp", "roll", LiveHistory(), over, account, None)
    assert "<strong>Link lost at 00:00:00, in flight.</strong>" in page


@mark.slow
def test_plots_have_one_order_whatever_the_alarm():
    history = LiveHistory()
    for time in (100.0, 101.0, 102.0):
        pose = (0.5, 2.0, 0.0, 0.1, 0.0, 0.1, 0.2, time / 100.0, 4.0, 12.0)
        history.add_row(0, time, np.zeros(2), None, pose)
        history.advance(time, 0)
        history.add_voltages({1: 12.6})
    account = dict.fromkeys(TimeUse, 0.0)

    def plot_titles(status):
        page = live_page("udp", "roll", history, status, account, None)
        return re.findall("<h3>([^<]*)", page)

    sound = SessionStatus("1:1", is_flying=True, message_age=0.0)
    low = Fact(PowerLight.CHARGE_LOW, Level.BAD, share=0.08, share_limit=0.1)
    alarmed = replace(sound, active_alarms=(low,), worst_lights={Light.POWER: low})
    assert plot_titles(alarmed) == plot_titles(sound)
    assert len(plot_titles(sound)) > 1
    # What grey means stands with the plots; beside the map of a session that is over it would take their place.
    history.learned_intervals.append((100.0, 102.0))
    meaning = '<p class="soft grey">Grey: what the model was learned from.</p>'
    for status, is_above in ((sound, False), (replace(sound, is_over=True), True)):
        page = live_page("udp", "roll", history, status, account, None)
        assert (page.index(meaning) < page.index('<div class="plots')) is is_above


def test_a_recordings_verdict_that_the_session_found_too_is_stated_once():
    """The verdict of a library is a text, and the light is of the session's own fact."""
    loss = MotorChange(58.0, 56.0, 2, "motor 2", 0.3, 0.99, loss=(0.2, 0.4))
    landed = SessionStatus("1:1", flight_number=1, is_over=True, motor_alarms_of_flight=(loss,))
    account = dict.fromkeys(TimeUse, 0.0)

    def page_with_verdict(text, levels=NOT_JUDGED_LEVELS, outage=None):
        verdict = Fact(
            SessionFact.RECORDING_JUDGED,
            Level.BAD,
            headline=text,
            next_step="Do not fly: check the load.",
            levels=levels,
            light_sentences={},
        )
        status = replace(landed, recording_verdict=verdict, link_outage=outage)
        return live_page("udp", "roll", LiveHistory(), status, account, None)

    page = page_with_verdict(headline(loss.fact))
    # The headline is the whole sentence but its probability, and the light of the motors does not repeat it.
    assert page.count("its thrust") == 1 and "(see the headline)" in page
    assert "<strong>Next:</strong> Do not fly.</p>" in page and "Check the load." in page
    assert '<section id="reasons">' not in page_with_verdict("Another fault.")
    # Lights that change after the landing say why.
    basis = "These are of the whole recording."
    assert basis not in page
    page = page_with_verdict("Another fault.", dict.fromkeys(Light, "good"))
    assert basis in page and "is of the live session" not in page
    assert "In flight, tracking, vibration and estimator were of the last minute" in page
    # Only what was judged can have had other figures in flight.
    levels = dict.fromkeys(Light, "good") | {Light.VIBRATION: "unknown", Light.ESTIMATOR: "unknown"}
    assert "In flight, tracking was of the last minute" in page_with_verdict("A fault.", levels)
    # The page of the recording calls its log good.
    page = page_with_verdict("Another fault.", dict.fromkeys(Light, "good"), outage=17.0)
    assert "The lost link is of the live session, not of the recording." in page


@mark.slow
def test_a_page_with_the_headline_of_an_earlier_flight_says_where_its_plots_are():
    """The session keeps the signals of its latest flight only."""
    account = dict.fromkeys(TimeUse, 0.0)
    weak_motor = MotorChange(58.0, 56.0, 3, "motor 3", 0.3, 0.99, loss=(0.2, 0.4)).fact
    first = FlightVerdict(1, unjudged(weak_motor))
    status = SessionStatus(flight_number=2, is_over=True, is_recorded=True, verdicts=(first,))
    history = LiveHistory()
    for time in (100.0, 101.0):
        history.add_row(0, time, np.zeros(2), None)
        history.advance(time, 0)
    note = "plots flight 1 from the recording"
    assert status.session_judgement.headline == first.fact
    page_at_end = live_page("udp", "roll", history, status, account, None)
    assert note in page_at_end
    # That, and what shows the headline, stand above the lights and plots, which are of the latest flight.
    assert page_at_end.index(note) < page_at_end.index('<section id="flight"')
    # Where the link was lost in the latest flight, that fault stands below, once.
    silence = Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MESSAGES, duration=12.0)
    lost_in_air = replace(
        status,
        no_model_reason=silence,
        is_flying=True,
        verdicts=(first, first._replace(number=2)),
    )
    page_after_loss = live_page("udp", "roll", history, lost_in_air, account, None)
    assert page_after_loss.replace("\N{NO-BREAK SPACE}", " ").count(first.fact.sentence) == 1
    assert "Flight 1, why:" not in page_at_end, "the sentence only repeats the headline"
    # The lights are those of the latest flight, whose verdict stands below the headline.
    assert "<p>Flight 2: " in page_at_end
    # In the next flight its fault is the headline: no card below the lights repeats that.
    crash = Fact(
        Ending.CRASHED,
        time=22.0,
        cause=None,
        word=None,
        height=None,
        speed=5.0,
        speed_source=HeightSource.ESTIMATE,
    )
    lost = FlightVerdict(1, unjudged(crash))
    flying_again = replace(status, is_over=False, is_flying=True, verdicts=(lost,))
    page_in_flight = live_page("udp", "roll", history, flying_again, account, None)
    assert flying_again.session_judgement.headline.code is SessionFact.UNREPAIRED_FAULT
    assert "<strong>Flight 1: " in page_in_flight
    assert '<section id="earlier">' not in page_in_flight
    for other in (replace(status, verdicts=()), replace(status, is_over=False)):
        assert note not in live_page("udp", "roll", history, other, account, None)
    saved = PageLink("a.tlog", "/f/a")
    page = live_page("udp", "roll", history, status, account, None, saved_flight=saved)
    assert '<a href="/f/a">Plots of flight 1 are on the page of the recording.</a>' in page
