"""Logs of one flight are joined; logs of several are refused."""

from dataclasses import replace

import numpy as np
from hover import Hover, changed, columns, log_of, only
from pytest import mark
from refusals import unreadable

from mavdem.assessment.assess import assess
from mavdem.assessment.axis import Options
from mavdem.assessment.reported import reported_events
from mavdem.dataset.signals import Signals
from mavdem.facts.events import ReportedEvent
from mavdem.facts.sources import Repair, Separation, SourceFact
from mavdem.ingest.joined import join_logs
from mavdem.ingest.telemetry import selected_rows

UTC = 1.7e9
"""UNIX time at which the clock of the first log reads 0, s."""
CUT = 25.0
"""When the first log ends, s: in flight."""

NAMES = [f"P{number}" for number in range(100)]
"""Names of parameters."""


def moved(telemetry, seconds):
    """The telemetry on a clock that reads so much less."""
    for name, table in telemetry.messages.items():
        telemetry = changed(telemetry, name, time=table["time"] - seconds)
    return telemetry


def with_utc(telemetry, utc_at_boot):
    time = telemetry.messages["ATTITUDE"]["time"][::50]
    stamps = np.rint(1e6 * (utc_at_boot + time)).astype(np.uint64)
    return changed(telemetry, "SYSTEM_TIME", **columns(time, time_unix_usec=stamps))


def halves(silence=4.0, restarted=True, has_utc=True):
    """Returns two logs of one flight, between which nothing was recorded for some seconds."""
    hover = Hover().telemetry()
    first = only(hover, lambda time: time < CUT)
    second = only(hover, lambda time: time >= CUT + silence)
    clock_shift = CUT + silence - 2.0 if restarted else 0.0
    second = replace(moved(second, clock_shift), source="second.tlog")
    if has_utc:
        first, second = with_utc(first, UTC), with_utc(second, UTC + clock_shift)
    return first, second


def joined(*telemetries):
    """The logs of one vehicle each, whose recorder had no clock, joined."""
    return join_logs([without_clock(telemetry) for telemetry in telemetries])


def without_clock(telemetry):
    return replace(log_of(telemetry), receive_time=(np.nan, np.nan))


def separation(*telemetries):
    fact = unreadable(joined, *telemetries)
    assert fact.code is SourceFact.LOGS_NOT_JOINED
    assert fact.sentence.endswith(".")
    return fact.figures["reason"]


def codes_of_reports(telemetry):
    return {event.code for event in reported_events(Signals(telemetry))}


@mark.slow
@mark.parametrize("has_utc", [True, False])
def test_a_restart_in_flight_joins_two_logs(has_utc):
    first, second = halves(has_utc=has_utc)
    log = joined(first, second)
    (vehicle,) = log.vehicles
    attitude = vehicle.messages["ATTITUDE"]
    assert set(attitude["boot"].tolist()) == {0, 1}
    assert (attitude["time"][attitude["boot"] == 1] == second.messages["ATTITUDE"]["time"]).all()
    assert len(attitude["time"]) == sum(len(t.messages["ATTITUDE"]["time"]) for t in halves())
    assert [fact.code for fact in vehicle.repairs] == [Repair.LOGS_JOINED]
    assert ReportedEvent.RESTARTED_IN_FLIGHT in codes_of_reports(vehicle)


@mark.slow
def test_a_restart_in_flight_is_the_headline():
    assessment = assess(joined(*halves()), options=Options(with_model=False))
    assert assessment.headline.code is ReportedEvent.RESTARTED_IN_FLIGHT


def test_logs_with_utc_may_be_in_any_order():
    first, second = halves()
    (vehicle,) = joined(second, first).vehicles
    assert vehicle.source == first.source
    assert abs(vehicle.repairs[0].figures["duration"] - 4.0) < 0.1


@mark.parametrize("has_utc", [True, False])
def test_an_autopilot_that_ran_on_has_one_boot(has_utc):
    """The autopilot did not restart between the two logs, so that its clock goes on."""
    first, second = halves(restarted=False, has_utc=has_utc)
    # The second log repeats a message that is older than itself, as PX4 does.
    older = selected_rows(first.messages["HEARTBEAT"], slice(-1, None))
    beats = second.messages["HEARTBEAT"]
    repeated = {name: np.concatenate([older[name], beats[name]]) for name in beats}
    log = joined(first, changed(second, "HEARTBEAT", **repeated))
    (vehicle,) = log.vehicles
    for table in vehicle.messages.values():
        assert not table["boot"].any()
        assert (np.diff(table["time"]) > 0).all()
    restarts = {ReportedEvent.RESTARTED, ReportedEvent.RESTARTED_IN_FLIGHT}
    assert not restarts & codes_of_reports(vehicle)


def test_later_logs_have_later_boots():
    first, second = halves()
    second = only(second, lambda time: time < 30.0)
    third = with_utc(replace(second, source="third.tlog"), UTC + 65.0)
    (vehicle,) = joined(third, first, second).vehicles
    assert np.unique(vehicle.messages["ATTITUDE"]["boot"]).tolist() == [0, 1, 2]


def test_parameters_that_changed_keep_their_first_value():
    first, second = halves()
    first = replace(first, parameters={"A": 1.0, "B": 2.0, "C": 3.0}, initial_parameters={"C": 0.0})
    second = replace(second, parameters={"A": 1.0, "B": 4.0, "C": 5.0}, initial_parameters={})
    (vehicle,) = joined(first, second).vehicles
    assert vehicle.parameters == {"A": 1.0, "B": 4.0, "C": 5.0}
    assert vehicle.initial_parameters == {"B": 2.0, "C": 0.0}


@mark.parametrize(
    ("other", "reason"),
    [
        ({"system": 2}, Separation.OTHER_SYSTEM),
        ({"translated_from": "DataFlash"}, Separation.OTHER_FORMAT),
        ({"autopilot": "PX4"}, Separation.OTHER_FIRMWARE),
        ({"firmware": "ArduCopter V4.5.0"}, Separation.OTHER_FIRMWARE),
        ({"board": "0A0B"}, Separation.OTHER_BOARD),
        ({"parameters": dict.fromkeys(NAMES, 2.0)}, Separation.OTHER_PARAMETERS),
    ],
)
def test_logs_of_two_vehicles_are_refused(other, reason):
    """The second log is of another system, format, firmware or board, or has other parameters."""
    first, second = halves()
    first = replace(
        first, board="0C0D", firmware="ArduCopter V4.6.0", parameters=dict.fromkeys(NAMES, 1.0)
    )
    assert separation(first, replace(second, **other)) is reason


def test_logs_of_two_flights_are_refused():
    first, second = halves()
    hours_later = with_utc(second, UTC + 9000.0)
    assert separation(first, hours_later) is Separation.OTHER_TIME
    assert separation(first, with_utc(second, UTC + 3.0)) is Separation.SAME_TIME


@mark.parametrize("has_utc", [True, False])
def test_after_a_landing_the_next_log_is_another_flight(has_utc):
    landed = Hover().telemetry()
    _, second = halves(has_utc=has_utc)
    if has_utc:
        landed = with_utc(landed, UTC)
        second = with_utc(second, UTC + landed.messages["ATTITUDE"]["time"][-1])
    assert separation(landed, second) is Separation.DISARMED


def test_without_utc_the_vehicle_is_armed_before_and_after():
    first, second = halves(has_utc=False)
    long_on_the_ground = moved(second, -100.0)
    assert separation(first, long_on_the_ground) is Separation.TIME_UNKNOWN
    assert separation(first, changed(second, "HEARTBEAT", base_mode=1)) is Separation.TIME_UNKNOWN


def test_a_log_of_two_vehicles_is_not_joined():
    first, second = halves()
    both = replace(without_clock(first), vehicles=(first, second))
    fact = unreadable(join_logs, [both, without_clock(second)])
    assert fact.figures["reason"] is Separation.NOT_ONE_VEHICLE


def test_the_clock_of_the_recorder_orders_streams():
    first, second = halves(has_utc=False)
    earlier = replace(log_of(first), receive_time=(UTC, UTC + CUT))
    later = replace(log_of(second), receive_time=(UTC + CUT + 4.0, UTC + 90.0))
    log = join_logs([later, earlier])
    assert log.receive_time == (UTC, UTC + 90.0)
    (vehicle,) = log.vehicles
    assert vehicle.source == first.source
