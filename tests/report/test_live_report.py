"""The report of a live session: what its time was spent on."""

from dataclasses import replace

from mavdem.facts import Fact, Level
from mavdem.facts.assessment import Headline
from mavdem.facts.event import Event
from mavdem.facts.lights import Light
from mavdem.facts.motors import MotorsLight
from mavdem.facts.session import SessionFact, TimeUse
from mavdem.facts.watch import WatchFact
from mavdem.fleet.names import GivenNames
from mavdem.live.history import LiveHistory
from mavdem.live.session_status import SessionStatus
from mavdem.live.vehicle_state import VehicleState
from mavdem.report.blocks import Table
from mavdem.report.live import live_alarm, live_report, live_title, statement_of_headline
from mavdem.report.pages.flight_page import live_page


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
