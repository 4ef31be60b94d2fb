"""Several batteries: which is judged, how it is named, and what the autopilot reports of it."""

from dataclasses import replace

import dataflash_logs as made
import numpy as np
import pytest
from hover import Hover, changed, columns, evidence_of, only
from pytest import approx, mark

from mavdem.assessment.autopilot_messages import reported_problems
from mavdem.assessment.battery_levels import ardupilot_charge_levels
from mavdem.assessment.condition import measure_condition
from mavdem.assessment.lights.power import mark_battery_reports_on_ground, power_light
from mavdem.assessment.limits import Limits
from mavdem.assessment.reported import reported_events
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Level
from mavdem.facts.ending import Ending
from mavdem.facts.events import ReportedEvent
from mavdem.facts.power import PowerLight
from mavdem.ingest import read_log
from mavdem.ingest.px4_instances import battery_status, sys_status

HOVER = Hover()
TIME = HOVER.stamps(5.0)
FULL = 16.4 - 0.01 * (TIME > 12.0)
EMPTY = np.where((TIME > 20.0) & (TIME < 45.0), 10.5, 15.6)
OK, CRITICAL, EMERGENCY, CHARGING = 1, 3, 4, 7
UNKNOWN = 65535


def evidence(telemetry):
    signals = Signals(telemetry)
    return evidence_of(signals, events=reported_events(signals))


def with_batteries(volts_by_id, states=None, parameters=None, cells=None):
    """The hover with BATTERY_STATUS of several ids, one after the other, and SYS_STATUS of the first."""
    count = len(TIME) * len(volts_by_id)
    voltages = np.full((count, 10), UNKNOWN)
    ids = np.tile(list(volts_by_id), len(TIME))
    state = np.full(count, OK)
    for battery_id, volts in volts_by_id.items():
        rows = ids == battery_id
        if volts is not None:
            elements = 1 if cells is None else cells
            voltages[rows, :elements] = np.rint(1000 * volts / elements)[:, None]
        if states and battery_id in states:
            state[rows] = states[battery_id]
    telemetry = HOVER.telemetry(20.0, 20.0, parameters=parameters)
    stamps = np.repeat(TIME, len(volts_by_id))
    telemetry = changed(
        telemetry,
        "BATTERY_STATUS",
        **columns(stamps, id=ids, voltages=voltages, charge_state=state),
    )
    return changed(telemetry, "SYS_STATUS", **columns(TIME, voltage_battery=1000 * FULL))


@mark.slow
def test_the_emptiest_of_several_batteries_is_judged_and_named_first():
    """Battery 2 of two is empty, 10.5 V for four cells."""
    telemetry = with_batteries({0: FULL, 1: EMPTY})
    fact = power_light(evidence(telemetry))
    assert (fact.code, fact.level, fact.subject) == (PowerLight.BATTERY_LOW, "bad", "battery 2")
    assert fact.figures["voltage"] == approx(10.5) and fact.figures["cells"] == 4
    (other_battery,) = fact.figures["batteries"]
    assert (other_battery.subject, other_battery.level) == ("battery 1", "good")
    assert other_battery.figures["voltage"] == approx(16.39)
    assert fact.time == approx(20.0, abs=2.0)
    assert "first at 2" in fact.sentence and "battery 2" in fact.remedy
    assert "Battery 2 down to 10.5 V" in str(fact) and "; battery 1 down to 16.4 V" in str(fact)
    figures = measure_condition(Signals(telemetry))
    assert [battery.number for battery in figures.batteries] == [2, 1]
    assert figures.battery.voltage_min == approx(10.5)


@mark.slow
def test_sound_batteries_are_all_shown_with_their_voltage():
    fact = power_light(evidence(with_batteries({0: FULL, 1: FULL - 0.5, 2: FULL - 0.2})))
    assert (fact.level, fact.subject) == ("good", "battery 2")
    other_subjects = [other_battery.subject for other_battery in fact.figures["batteries"]]
    assert other_subjects == ["battery 3", "battery 1"]


def test_the_second_battery_of_old_firmware_is_the_second():
    telemetry = HOVER.telemetry(20.0, 20.0)
    telemetry = changed(telemetry, "SYS_STATUS", **columns(TIME, voltage_battery=1000 * FULL))
    telemetry = changed(
        telemetry, "BATTERY2", **columns(TIME, voltage=1000 * EMPTY, current_battery=-1)
    )
    fact = power_light(evidence(telemetry))
    assert (fact.level, fact.subject) == ("bad", "battery 2")
    assert [other_battery.subject for other_battery in fact.figures["batteries"]] == ["battery 1"]


def test_a_single_battery_has_no_number():
    fact = power_light(evidence(with_batteries({0: FULL})))
    assert (fact.subject, fact.level) == ("", "good")
    assert fact.figures.keys().isdisjoint({"battery", "batteries"})


def test_without_a_flight_the_battery_that_the_autopilot_calls_empty_is_bad():
    spent = Fact(ReportedEvent.BATTERY_SPENT, Level.BAD, time=5.0, boot=0)
    on_ground = evidence(only(HOVER.telemetry(20.0, 20.0), lambda time: time < 5.5))
    assert power_light(replace(on_ground, events=(spent,))) == spent
    assert power_light(replace(on_ground, events=())).code is PowerLight.POWER_UNMEASURED


@mark.slow
def test_a_battery_is_judged_until_the_vehicle_was_lost():
    sagging = np.where(TIME > 30.0, 15.0, FULL)
    flight = evidence(with_batteries({0: sagging}))
    loss = Fact(Ending.CONTROL_LOST, time=25.0, boot=0)
    fact = power_light(replace(flight, ending=loss))
    assert (fact.code, fact.end_time) == (PowerLight.BATTERY_HELD, 25.0)
    assert fact.figures["voltage"] == approx(16.39)
    assert "until 25.0 s" in fact.sentence
    assert power_light(flight).end_time is None


@mark.slow
def test_a_second_battery_that_never_changes_is_shown_and_not_judged():
    fact = power_light(evidence(with_batteries({0: FULL, 1: 0 * FULL + 10.0})))
    assert (fact.subject, fact.level) == ("battery 1", "good")
    assert "; battery 2 reads 10.0 V whatever the load" in str(fact)


@mark.slow
def test_a_resistance_that_no_battery_has_is_not_stated():
    amperes = 20.0 + 5 * np.sin(5 * TIME)
    telemetry = HOVER.telemetry(20.0, 20.0)
    for resistance, expected_resistance in ((0.04, approx(0.04, abs=0.01)), (0.6, None)):
        volts = 16.4 - resistance * (amperes - 20.0)
        battery = columns(TIME, voltage_battery=1e3 * volts, current_battery=1e2 * amperes)
        fact = power_light(evidence(changed(telemetry, "SYS_STATUS", **battery)))
        assert fact.figures["resistance"] == expected_resistance


def test_a_battery_that_is_not_connected_is_left_out():
    telemetry = with_batteries({0: None, 1: EMPTY})
    messages = dict(telemetry.messages)
    del messages["SYS_STATUS"]
    telemetry = replace(telemetry, messages=messages)
    fact = power_light(evidence(telemetry))
    assert (fact.subject, fact.level) == ("battery 2", "bad") and "batteries" not in fact.figures


@pytest.mark.parametrize(
    ("number", "parameters", "level"),
    [
        (2, {"BATT2_CRT_VOLT": 14.5}, "bad"),
        (2, {"BATT2_LOW_VOLT": 14.5}, "watch"),
        (1, {"BATT_CRT_VOLT": 14.5}, "good"),
    ],
)
def test_each_battery_has_levels_of_its_own(number, parameters, level):
    sagging = np.where((TIME > 20.0) & (TIME < 45.0), 14.2, 15.6)
    fact = power_light(evidence(with_batteries({0: FULL, 1: sagging}, parameters=parameters)))
    assert fact.level == level


def test_a_limit_that_is_set_after_the_landing_does_not_judge_the_flight():
    sagging = np.where((TIME > 20.0) & (TIME < 45.0), 14.2, 15.6)
    reports = columns(
        np.array([1.0, HOVER.landed + 2.0]),
        param_id=np.array([b"BATT_LOW_VOLT"] * 2),
        param_type=9,
        param_value=np.array([14.5, 13.0]),
    )
    telemetry = with_batteries({0: sagging}, parameters={"BATT_LOW_VOLT": 13.0})
    fact = power_light(evidence(changed(telemetry, "PARAM_VALUE", **reports)))
    assert (fact.level, fact.figures["voltage_limit"]) == ("watch", 14.5)


@pytest.mark.parametrize(
    ("state", "is_bad"), [(CRITICAL, True), (EMERGENCY, True), (CHARGING, False)]
)
def test_a_battery_that_the_autopilot_calls_critical_is_bad_and_named(state, is_bad):
    """From 20 s to 45 s, the autopilot reports a state of battery 2: critical, emergency, or charging."""
    states = {1: np.where((TIME > 20.0) & (TIME < 45.0), state, OK)}
    telemetry = with_batteries({0: FULL, 1: FULL - 0.4}, states)
    fact = power_light(evidence(telemetry))
    if not is_bad:
        assert fact.level == "good"
        return
    code = ReportedEvent.BATTERY_SPENT if state == EMERGENCY else ReportedEvent.BATTERY_ALARMED
    assert (fact.code, fact.subject) == (code, "battery 2")
    assert fact.level == "bad" and fact.time == approx(20.2)
    statement = "is at its end: emergency" if state == EMERGENCY else "is critical"
    assert f"that battery 2 {statement}" in str(fact)
    assert "battery 2 and its cells" in fact.remedy
    assert len(fact.figures["batteries"]) == 2


def test_cells_follow_from_the_elements_of_the_message():
    fact = power_light(evidence(with_batteries({0: 2 * FULL, 1: 2 * FULL}, cells=8)))
    assert fact.figures["cells"] == 8


@pytest.mark.parametrize(
    ("text", "code", "subject"),
    [
        ("Battery 2 is critical 10.42V used 1200 mAh", ReportedEvent.BATTERY_ALARMED, "battery 2"),
        ("Battery 2 is low 13.90V used 1200 mAh", ReportedEvent.BATTERY_WARNED, "battery 2"),
        ("BAT2 failsafe", ReportedEvent.BATTERY_ALARMED, "battery 2"),
        ("Battery Failsafe - RTL", ReportedEvent.BATTERY_ALARMED, ""),
        ("Critical battery, landing", ReportedEvent.BATTERY_ALARMED, ""),
        ("Low battery level, return advised", ReportedEvent.BATTERY_WARNED, ""),
    ],
)
def test_what_texts_say_of_a_battery(text, code, subject):
    """Texts of ArduPilot and PX4 are recognised as warnings or alarms, with the number of the battery."""
    telemetry = HOVER.telemetry(20.0, 20.0)
    texts = np.array([text.encode()], dtype=object)
    telemetry = changed(
        telemetry,
        "STATUSTEXT",
        **columns(np.array([30.0]), text=texts, severity=np.array([2])),
    )
    (fact,) = reported_problems(telemetry)
    assert (fact.code, fact.subject) == (code, subject)


@pytest.mark.parametrize(
    ("text", "level"),
    [(b"Battery 1 is low 10.50V", "watch"), (b"Battery 1 is critical", "bad"), (None, "bad")],
)
def test_a_failsafe_of_the_battery_is_as_bad_as_the_text_before_it(text, level):
    """ArduPilot logs the error of a battery failsafe half a second after a text, or without one."""
    telemetry = HOVER.telemetry(20.0, 20.0)
    error = columns(np.array([30.5]), Subsys=np.array([6]), ECode=np.array([1]))
    telemetry = changed(telemetry, "ERR", **error)
    if text is not None:
        texts = columns(
            np.array([30.0]), text=np.array([text], dtype=object), severity=np.array([4])
        )
        telemetry = changed(telemetry, "STATUSTEXT", **texts)
    assert power_light(evidence(telemetry)).level == level


def logged(tmp_path, rows, definition):
    """A DataFlash log with a hover of half a minute and the messages of a battery."""
    path = tmp_path / "flight.bin"
    flight = made.flight([20 + 0.1 * row for row in range(300)])
    path.write_bytes(made.log(definition, *flight, *rows))
    return read_log(path).vehicles[0]


@mark.slow
def test_dataflash_batteries_are_instances_or_have_messages_of_their_own(tmp_path, monkeypatch):
    """New versions number batteries by an instance; old ones log BAT and BAT2."""
    monkeypatch.setitem(made.MESSAGES, "BAT", (151, "QBff", "TimeUS,Instance,Volt,Curr"))
    seconds = np.arange(20, 50)
    instances = []
    for second in seconds.tolist():
        for instance, volts in enumerate((0.0, 15.6 - 0.1 * (second - 20))):
            instances.append(made.message("BAT", 1_000_000 * second, instance, volts, 20.0))
    (battery,) = Signals(logged(tmp_path, instances, b"")).batteries
    assert battery.number == 2
    assert battery.voltage.values == approx(15.6 - 0.1 * (seconds - 20), abs=1e-5)
    monkeypatch.setitem(made.MESSAGES, "BAT", (151, "Qff", "TimeUS,Volt,Curr"))
    monkeypatch.setitem(made.MESSAGES, "BAT2", (152, "Qff", "TimeUS,Volt,Curr"))
    messages = []
    for second in seconds.tolist():
        messages.append(made.message("BAT", 1_000_000 * second, 16.0, 20.0))
        messages.append(made.message("BAT2", 1_000_000 * second, 15.0, 21.0))
    first, second_battery = Signals(logged(tmp_path, messages, b"")).batteries
    assert (first.number, second_battery.number) == (1, 2)
    assert second_battery.current.values == approx(np.full(30, 21.0))


def topic(volts, **fields):
    count = len(volts)
    fields = {name: np.full(count, value) for name, value in fields.items()}
    return {"time": np.arange(count, dtype=float), "voltage_v": volts, **fields}


def test_px4_batteries_are_the_connected_instances():
    volts = np.linspace(16.0, 15.0, 10)
    instances = {
        0: topic(0 * volts, connected=0, id=1, warning=0, cell_count=4),
        1: topic(volts, connected=1, id=2, warning=3, cell_count=4),
    }
    fields = battery_status({"battery_status": instances})
    assert set(fields["id"].tolist()) == {1} and set(fields["charge_state"].tolist()) == {4}
    assert fields["voltages"][:, 0] == approx(1000 * volts)
    assert sys_status({"battery_status": instances})["voltage_battery"] == approx(1000 * volts)
    assert not battery_status({"battery_status": {0: instances[1] | {"id": np.ones(10)}}})


def test_of_one_battery_the_emergency_counts_and_not_the_critical_state_before():
    states = {1: np.select([TIME < 20.0, TIME < 30.0, TIME < 45.0], [OK, CRITICAL, EMERGENCY], OK)}
    fact = power_light(evidence(with_batteries({0: FULL, 1: FULL - 0.4}, states)))
    assert (fact.code, fact.subject) == (ReportedEvent.BATTERY_SPENT, "battery 2")


@mark.slow
@pytest.mark.parametrize(("time", "is_on_ground"), [(3.0, True), (30.0, False)])
def test_a_vehicle_that_did_not_fly_is_not_told_to_land_earlier(time, is_on_ground):
    spent = Fact(ReportedEvent.BATTERY_SPENT, Level.BAD, time=time, boot=0)
    flight = evidence(HOVER.telemetry(20.0, 20.0))
    (event,) = mark_battery_reports_on_ground(replace(flight, events=(spent,)))
    assert ("land earlier" in event.remedy) is not is_on_ground
    assert ("before a flight" in event.remedy) is is_on_ground


@pytest.mark.parametrize(
    ("lowest", "level", "limit"),
    [(20, "good", None), (15, "watch", 0.15), (7, "bad", 0.07), (6, "bad", 0.07), (0, "bad", 0.07)],
)
def test_a_charge_is_judged_by_the_limits_of_px4_down_to_nothing(lowest, level, limit):
    """The charge falls to a percentage; PX4's limits are 15 % for a warning and 7 % for a critical charge."""
    telemetry = HOVER.telemetry(20.0, 20.0, autopilot="PX4")
    charge = np.interp(TIME, [0.0, 30.0], [90, lowest]).astype(int)
    status = columns(TIME, voltage_battery=1000 * FULL, battery_remaining=charge)
    fact = power_light(evidence(changed(telemetry, "SYS_STATUS", **status)))
    assert fact.level == level
    if limit is not None:
        assert fact.code is PowerLight.CHARGE_LOW
        assert fact.figures["share"] == approx(lowest / 100)
        assert fact.figures["share_limit"] == limit


def test_a_charge_that_is_always_nothing_is_not_known():
    telemetry = HOVER.telemetry(20.0, 20.0, autopilot="PX4")
    status = columns(TIME, voltage_battery=1000 * FULL, battery_remaining=np.zeros(len(TIME)))
    assert power_light(evidence(changed(telemetry, "SYS_STATUS", **status))).is_good


@pytest.mark.parametrize(
    ("lowest", "volts", "level", "words"),
    [
        (0, 13.8, "bad", "all of the capacity that is set was used"),
        (0, 15.6, "watch", "but 3.90 V a cell is not empty"),
        (3, 13.8, "good", "down to 13.8 V"),
    ],
)
def test_a_charge_of_nothing_is_bad_with_ardupilots_defaults_unless_its_cells_are_charged(
    lowest, volts, level, words
):
    """A charge of 0 % may be a wrong capacity: the voltage of the cells decides."""
    telemetry = HOVER.telemetry(20.0, 20.0)
    charge = np.interp(TIME, [0.0, 30.0], [90, lowest]).astype(int)
    voltage = np.interp(TIME, [0.0, 30.0], [16.4, volts])
    status = columns(TIME, voltage_battery=1000 * voltage, battery_remaining=charge)
    fact = power_light(evidence(changed(telemetry, "SYS_STATUS", **status)))
    assert fact.level == level
    assert words in fact.sentence


@pytest.mark.parametrize("parameters", [{}, {"BATT_CAPACITY": 5e3, "BATT_LOW_MAH": 1e3}])
def test_a_charge_that_jumps_to_nothing_was_not_used(parameters):
    telemetry = HOVER.telemetry(20.0, 20.0)
    telemetry = replace(telemetry, parameters={**telemetry.parameters, **parameters})
    charge = np.where(TIME < 20.0, 85, 0)
    status = columns(TIME, voltage_battery=1000 * FULL, battery_remaining=charge)
    fact = power_light(evidence(changed(telemetry, "SYS_STATUS", **status)))
    assert fact.code is PowerLight.CHARGE_LOW and fact.is_watch_or_bad
    assert fact.sentence.endswith("estimate: it fell from 85 % at once, as no battery does.")
    assert fact.remedy == "Check the power module of the battery."


def test_ardupilots_parameters_say_which_charge_is_low_and_critical():
    parameters = {"BATT_CAPACITY": 5000.0, "BATT_LOW_MAH": 1000.0, "BATT_CRT_MAH": 500.0}
    assert ardupilot_charge_levels(parameters, 1) == Limits(watch=0.2, bad=0.1)
    assert ardupilot_charge_levels(parameters, 2) == Limits(watch=0.0, bad=0.0)
