"""Airborne and settled: a report of EXTENDED_SYS_STATE counts for the time it covers, elsewhere the motors' thrust."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest
from hover import Hover, changed, columns
from recorded_flights import shared

from mavdem.alignment import phases
from mavdem.alignment.phases import TRANSIENT_SECONDS
from mavdem.alignment.signals import Signals
from mavdem.alignment.verdict import verdict_of
from mavdem.ingest import read_log
from mavdem.ingest.telemetry import Telemetry

HOVER = Hover()
LIFTED, LANDED = 6.0, HOVER.landed


def reporting(time: np.ndarray, state: np.ndarray | int, without: tuple[str, ...] = ()) -> Telemetry:
    landed = columns(time, landed_state=np.broadcast_to(state, time.shape))
    return changed(HOVER.telemetry(without=without), "EXTENDED_SYS_STATE", **landed)


def in_air(time: np.ndarray) -> np.ndarray:
    return (time > LIFTED) & (time < LANDED)


def test_reports_that_come_late_leave_the_flight_before_them_to_the_motors() -> None:
    """The first report is of the landing, as of a stream that was asked for just then."""
    time = np.arange(HOVER.sinking, HOVER.end, 0.1)
    telemetry = reporting(time, np.where(time < LANDED, 4, 1))
    (flight,) = phases.airborne(Signals(telemetry), 0)
    assert flight == pytest.approx((LIFTED, LANDED), abs=1.1)
    verdict = verdict_of(Signals(telemetry))
    assert verdict.learnable and verdict.segment is not None
    assert verdict.segment.end == pytest.approx(HOVER.sinking - TRANSIENT_SECONDS, abs=1.1)


@pytest.mark.parametrize("state", [3, 4])
def test_taking_off_and_landing_are_airborne_and_not_settled(state: int) -> None:
    time = HOVER.stamps(2.0)
    signals = Signals(reporting(time, np.where(in_air(time), state, 1)))
    (flight,) = phases.airborne(signals, 0)
    assert flight == pytest.approx((LIFTED, LANDED), abs=0.6) and phases.settled(signals, 0) == []


def test_what_is_undefined_reports_nothing() -> None:
    time = HOVER.stamps(2.0)
    (flight,) = phases.airborne(Signals(reporting(time, np.where(time < 40, 0, np.where(in_air(time), 2, 1)))), 0)
    assert flight == pytest.approx((LIFTED, LANDED), abs=1.1)


def test_reports_without_any_motors_hold_until_another() -> None:
    time = np.array([1.0, 30.0, 60.0])
    signals = Signals(reporting(time, np.array([1, 2, 2]), without=("SERVO_OUTPUT_RAW",)))
    assert phases.airborne(signals, 0) == [(30.0, inf)]


def test_a_vertical_speed_that_only_sinks_has_run_away() -> None:
    telemetry = HOVER.telemetry()
    position = telemetry.messages["LOCAL_POSITION_NED"]
    signals = Signals(changed(telemetry, "LOCAL_POSITION_NED", vz=np.full(len(position["time"]), 5.0)))
    ((start, end),) = phases.settled(signals, 0)
    assert (start, end) == pytest.approx((LIFTED + TRANSIENT_SECONDS, LANDED - TRANSIENT_SECONDS), abs=1.5)


def test_a_recorded_flight_whose_reports_come_at_its_end() -> None:
    signals = Signals(read_log(shared("real/logs/ardupilot_late_landed_state.tlog")).vehicles[0])
    (flight,) = phases.airborne(signals, 0)
    assert flight == pytest.approx((45, 131), abs=1)  # by the reports it landed at 131.4 s
    ((start, end),) = phases.settled(signals, 0)
    assert start < 55 and end == pytest.approx(106, abs=2)
    assert "never left the ground" not in verdict_of(signals).reason
