"""read_flight: from a log to the Flight of one vehicle, or the reason why not."""

import dataclasses
import json

import numpy as np
import pytest
from hover import Hover, changed, log_of
from recorded_flights import shared

from mavdem.alignment.align import Segment
from mavdem.alignment.read import choose_vehicle, learnable_flight, read_flight, usable_segments
from mavdem.alignment.signals import Signals
from mavdem.alignment.verdict import Verdict
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.flight import Flight
from mavdem.ingest import Log
from mavdem.ingest.telemetry import Telemetry

HOVER = Hover()


def segments_of(log: Log) -> tuple[tuple[Flight, ...], Verdict]:
    return usable_segments(Signals(log.vehicles[0]), log.components)


def test_a_flight_carries_the_cautions_of_its_verdict():
    telemetry = HOVER.telemetry()
    table = telemetry.messages["SERVO_OUTPUT_RAW"]
    full = {"servo1_raw": np.where(np.sin(table["time"]) > 0, 2000.0, table["servo1_raw"])}
    flight, verdict = learnable_flight(log_of(changed(telemetry, "SERVO_OUTPUT_RAW", **full)))
    assert verdict.cautions and verdict.figures.saturation == pytest.approx(0.5, abs=0.1)
    assert flight.provenance["cautions"] == list(verdict.cautions)
    assert json.loads(json.dumps(flight.provenance, allow_nan=False)) == flight.provenance


def without_messages(telemetry: Telemetry, lost) -> Telemetry:
    """The telemetry without the messages of attitude and motors for which ``lost(time)`` is true."""
    for message in ("ATTITUDE", "SERVO_OUTPUT_RAW"):
        table = telemetry.messages[message]
        kept = ~lost(table["time"])
        telemetry = changed(telemetry, message, **{name: column[kept] for name, column in table.items()})
    return telemetry


def test_segments_are_all_of_settled_flight_and_the_longest_is_the_flight():
    gaps = without_messages(HOVER.telemetry(), lambda time: (abs(time - 20) < 0.5) | (abs(time - 33) < 0.5))
    log = log_of(gaps)
    (first, middle, last), (flight, verdict) = segments_of(log)[0], learnable_flight(log)
    assert [round(one.time[0], 2) for one in (middle, last)] == [20.5, 33.5]
    np.testing.assert_array_equal(last.outputs, flight.outputs)
    np.testing.assert_array_equal(last.inputs, flight.inputs)
    assert last.provenance == flight.provenance and Segment(**last.provenance["segment"]) == verdict.segment
    record = Record.of([first, middle, last])
    assert record.lengths == (len(first), len(middle), len(last))
    for one in (first, middle):
        np.testing.assert_allclose(one.outputs[:, 0], HOVER.roll(one.time), atol=1e-9)


def test_segments_have_one_step_also_where_a_link_lost_messages():
    lossy = without_messages(
        HOVER.telemetry(), lambda time: (abs(time - 25) < 0.5) | ((time < 25) & (np.round(100 * time) % 9 == 0))
    )
    flights, _ = segments_of(log_of(lossy))
    assert [one.dt for one in flights] == [0.01, 0.01]
    assert flights[0].provenance["rates"]["attitude"] == pytest.approx(89, abs=1)
    np.testing.assert_allclose(flights[0].outputs[:, 0], HOVER.roll(flights[0].time), atol=1e-3)


def test_segments_that_are_too_slow_or_too_short_are_left_out_and_counted():
    hover = Hover(hovering=60.0)
    stamps = np.concatenate([np.arange(0, 30, 1 / 60), np.arange(31, 35, 0.01), np.arange(36, hover.end, 0.01)])
    log = log_of(hover.telemetry(stamps, stamps))
    (flight,), verdict = segments_of(log)
    assert flight.time[0] == pytest.approx(36) and flight.dt == 0.01
    (caution,) = set(flight.provenance["cautions"]) - set(verdict.cautions)
    assert caution.startswith("2 of 3 segments of settled flight, 2") and "left out" in caution


def test_one_vehicle_is_chosen_and_several_are_listed():
    first, second = HOVER.telemetry(), dataclasses.replace(HOVER.telemetry(), system=7)
    silent = dataclasses.replace(first, system=9, messages={})
    assert choose_vehicle((first, silent)) is first
    assert choose_vehicle((first, second), "7") is second
    assert choose_vehicle((first, second), "1:1") is first
    with pytest.raises(NotLearnable, match="1:1 .*7:1 .*--vehicle"):
        choose_vehicle((first, second))
    with pytest.raises(NotLearnable, match="no vehicle 3"):
        choose_vehicle((first, second), "3")
    # Of the same ids, as in two logs that were joined, the boards tell.
    joined = [dataclasses.replace(first, board=board) for board in ("2a", "7f")]
    assert choose_vehicle(joined, "7f") is joined[1]
    with pytest.raises(NotLearnable, match="2a .*7f ") as several:
        choose_vehicle(joined)
    assert "--vehicle 2a" in several.value.remedy
    with pytest.raises(NotLearnable, match="no vehicle"):
        choose_vehicle(())


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("samples/ardupilot_default_rates.tlog", "4.0 Hz"),
        ("logs/dronekit_flight.tlog", "Hz"),
        ("logs/lucagemma_crlf.tlog", "Hz"),
        ("logs/bluerobotics_00025.tlog", "SUBMARINE"),
        ("sitl_px4/px4_two_vehicles_gcslink.tlog", "several vehicles"),
    ],
)
def test_recorded_logs_that_must_be_refused(name, said):
    with pytest.raises(NotLearnable, match=said) as refusal:
        read_flight(shared(name))
    assert refusal.value.remedy
