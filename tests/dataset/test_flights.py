"""From a log to the Flight of one vehicle, with its setpoints, or the reason why not."""

import dataclasses
import json

import numpy as np
from hover import Hover, changed, columns, log_of, only
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, mark
from refusals import refused

from mavdem.dataset.alignment import aligned_flight
from mavdem.dataset.flights import choose_vehicle, learnable_flight, usable_segments
from mavdem.dataset.learnability import segment_learnabilities
from mavdem.dataset.segments import settled_segments
from mavdem.dataset.setpoints import recorded_setpoints
from mavdem.dataset.signals import Signals
from mavdem.facts.learnability import Caution, NotLearnableReason
from mavdem.ingest.vocabulary import quaternion

HOVER = Hover()


def segments_of(log):
    return usable_segments(Signals(log.vehicles[0]), log.components)


@mark.slow
def test_a_flight_carries_the_cautions_of_its_learnability():
    telemetry = HOVER.telemetry()
    table = telemetry.messages["SERVO_OUTPUT_RAW"]
    flight, learnability = learnable_flight(
        log_of(
            changed(
                telemetry,
                "SERVO_OUTPUT_RAW",
                servo1_raw=np.where(np.sin(table["time"]) > 0, 2000.0, table["servo1_raw"]),
            )
        )
    )
    assert learnability.cautions and learnability.figures.saturation == approx(0.5, abs=0.1)
    assert flight.cautions == learnability.cautions
    assert flight.provenance["cautions"] == [str(caution) for caution in learnability.cautions]
    assert json.loads(json.dumps(flight.provenance, allow_nan=False)) == flight.provenance


def received(wanted):
    """A hover with the messages of attitude and motors for which ``wanted(time)`` is true."""
    return only(HOVER.telemetry(), wanted, "ATTITUDE", "SERVO_OUTPUT_RAW")


@mark.slow
def test_segments_have_one_step_also_where_a_link_lost_messages():
    lossy = received(
        lambda time: (abs(time - 25) >= 0.5) & ((time >= 25) | (np.round(100 * time) % 9 != 0))
    )
    flights, _ = segments_of(log_of(lossy))
    assert [one.dt for one in flights] == [0.01, 0.01]
    assert flights[0].provenance["rates"]["attitude"] == approx(89, abs=1)
    assert_allclose(flights[0].outputs[:, 0], HOVER.roll(flights[0].time), atol=1e-3)


@mark.slow
def test_segments_that_are_too_slow_or_too_short_are_left_out_and_counted():
    hover = Hover(hovering=60.0)
    stamps = np.concatenate(
        [np.arange(0, 30, 1 / 70), np.arange(31, 35, 0.01), np.arange(36, hover.end, 0.01)]
    )
    log = log_of(hover.telemetry(stamps, stamps))
    (flight,), learnability = segments_of(log)
    judged = {each.reason.code for each in segment_learnabilities(Signals(log.vehicles[0]))}
    assert judged == {NotLearnableReason.LEARNABLE, NotLearnableReason.SLOWER_THAN_LONGEST}
    assert flight.time[0] == approx(36) and flight.dt == 0.01
    (caution,) = set(flight.cautions) - set(learnability.cautions)
    assert caution.code is Caution.SEGMENTS_LEFT_OUT
    assert (caution.figures["count"], caution.figures["segments"]) == (2, 3)


def not_chosen(vehicles, wanted=None):
    fact = refused(choose_vehicle, vehicles, wanted)
    return fact.code, fact.figures.get("names")


def test_one_vehicle_is_chosen_and_several_are_listed():
    first = HOVER.telemetry()
    second = dataclasses.replace(HOVER.telemetry(), system=7)
    assert choose_vehicle((first, dataclasses.replace(first, system=9, messages={}))) is first
    assert choose_vehicle((first, second), "7") is second
    assert choose_vehicle((first, second), "1:1") is first
    assert not_chosen((first, second)) == (NotLearnableReason.SEVERAL_VEHICLES, ("1:1", "7:1"))
    assert not_chosen((first, second), "3") == (NotLearnableReason.NO_SUCH_VEHICLE, ("1:1", "7:1"))
    # Of the same ids, as in two logs that were joined, the boards tell.
    joined = [dataclasses.replace(first, board=board) for board in ("2a", "7f")]
    assert choose_vehicle(joined, "7f") is joined[1]
    assert not_chosen(joined) == (NotLearnableReason.SEVERAL_VEHICLES, ("2a", "7f"))
    assert not_chosen(()) == (NotLearnableReason.LOG_WITHOUT_VEHICLE, None)


def with_targets(rate=10.0, type_mask=0, start=0.0, end=np.inf):
    """A hover with ATTITUDE_TARGET whose roll rate is the time, its roll a tenth of the sine of it."""
    time = HOVER.stamps(rate)
    time = time[(time >= start) & (time < end)]
    roll = 0.1 * np.sin(time)
    pitch = 0.05 * np.cos(time)
    yaw = 0.02 * time
    return changed(
        HOVER.telemetry(),
        "ATTITUDE_TARGET",
        **columns(
            time,
            type_mask=np.full(len(time), type_mask, dtype=np.uint8),
            q=quaternion(roll, pitch, yaw),
            body_roll_rate=time,
            body_pitch_rate=2 * time,
            body_yaw_rate=3 * time,
        ),
    )


def flight_of(telemetry):
    signals = Signals(telemetry)
    return aligned_flight(signals, settled_segments(signals)[0])


@mark.slow
def test_a_flight_has_the_last_setpoint_until_its_sample_and_none_of_the_future():
    flight = flight_of(with_targets(rate=10.0))
    assert flight.setpoint_names == ("roll rate setpoint", "roll setpoint")
    assert flight.setpoint_units == ("rad/s", "rad")
    last = np.floor(10 * flight.time + 1e-6) / 10
    assert_allclose(flight.setpoints[:, 0], last, atol=1e-9)
    assert_allclose(flight.setpoints[:, 1], 0.1 * np.sin(last), atol=1e-9)
    assert (flight.setpoints[:, 0] <= flight.time + 1e-9).all()
    assert flight.provenance["setpoints"]["roll setpoint"] == "ATTITUDE_TARGET"


@mark.parametrize(
    "mask, units",
    {
        1: ["rad"],
        2: ["rad/s", "rad"],
        64: ["rad/s", "rad"],
        128: ["rad/s"],
        129: [],
    }.items(),
)
def test_masked_fields_are_no_setpoints(mask, units):
    assert [one.unit for one in recorded_setpoints(with_targets(type_mask=mask), "roll")] == units


@mark.slow
def test_before_the_first_and_long_after_the_last_nothing_is_known():
    flight = flight_of(with_targets(start=20.0, end=30.0))
    known = np.isfinite(flight.setpoints[:, 0])
    assert_array_equal(known, (flight.time >= 20 - 1e-9) & (flight.time <= 29.9 + 2.0 + 1e-9))
