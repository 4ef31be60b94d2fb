"""The report of a live session: what its time was spent on."""

from mavdem.facts import Fact, Level
from mavdem.facts.assessment import Headline
from mavdem.facts.session import SessionFact, TimeUse
from mavdem.fleet.names import GivenNames
from mavdem.live.history import LiveHistory
from mavdem.live.session_status import SessionStatus
from mavdem.live.vehicle_state import VehicleState
from mavdem.report.blocks import Table
from mavdem.report.live import live_report, live_title, statement_of_headline


def test_the_table_of_time_adds_up():
    account = dict.fromkeys(TimeUse, 0.0)
    first, second, third = list(TimeUse)[:3]
    account |= {first: 12.2, second: 30.0, third: 0.3}
    blocks = live_report(LiveHistory(), SessionStatus(), account, "roll")
    [table] = [block for block in blocks if isinstance(block, Table)]
    assert table.header == ["of 42 s", "time"]
    assert [row[1] for row in table.rows] == ["12 s", "30 s"]


def test_the_title_of_a_live_page_names_the_vehicle_as_its_owner_does():
    assert live_title(SessionStatus(), "udpin:0", GivenNames()) == "Flight over udpin:0"
    state = VehicleState(
        system=3, frame="GROUND_ROVER", autopilot="ARDUPILOTMEGA", name_in_logs="ardupilotmega-3"
    )
    status = SessionStatus("3:1", state=state)
    assert live_title(status, "", GivenNames()) == "Ground rover, ArduPilot, vehicle 3"
    names = GivenNames(vehicles={"ardupilotmega-3": "Old Red"})
    assert live_title(status, "", names) == "Old Red, ArduPilot, vehicle 3"


def test_the_headline_of_a_live_flight_leaves_what_was_checked_to_the_lights_beside_it():
    nothing_wrong = Fact(Headline.NOTHING_WRONG, Level.GOOD)
    text = "No alarm so far; too little was checked: motors were checked."
    assert statement_of_headline(text, nothing_wrong) == "No alarm so far; too little was checked."
    assert statement_of_headline("Bad: this.", Fact(SessionFact.NOT_FLYING)) == "Bad: this."
