"""The inventory: what is told of a log before anything is learnt."""

from __future__ import annotations

import numpy as np
import pytest
from hover import Hover, changed

from mavdem.condition.inventory import inventory
from mavdem.ingest.telemetry import Component, Log, Telemetry

HOVER = Hover(hovering=100.0)


def told(telemetry: Telemetry) -> dict:
    speaker = Component(1, 1, "QUADROTOR", "ARDUPILOTMEGA", {"ATTITUDE": 1000}, lost=4000)
    station = Component(255, 190, "GCS", "INVALID", {"HEARTBEAT": 60}, lost=100)
    return inventory(Log("made-up.tlog", (telemetry,), (speaker, station), (), 0, 0, (0.0, 0.0)))


def test_a_log_of_some_kinds_misses_nothing_of_what_it_keeps():
    vehicle, station = told(HOVER.telemetry(stamps_of_8_and_12(), 50.0))["speakers"]
    assert vehicle["lost_share"] == pytest.approx(0.8)
    assert vehicle["missing_share"] == 0
    assert station["missing_share"] is None


def stamps_of_8_and_12() -> np.ndarray:
    return np.cumsum(np.resize([0.008, 0.012], round(HOVER.end * 100)))


@pytest.mark.parametrize("stamps", [(), (stamps_of_8_and_12(), stamps_of_8_and_12())])
def test_a_link_that_loses_messages_loses_them_of_every_kind(stamps):
    random, telemetry = np.random.default_rng(3), HOVER.telemetry(*stamps)
    for message, table in telemetry.messages.items():
        kept = random.random(len(table["time"])) > 0.1
        telemetry = changed(telemetry, message, **{name: column[kept] for name, column in table.items()})
    assert told(telemetry)["speakers"][0]["missing_share"] == pytest.approx(0.1, abs=0.02)


def test_boots_and_the_segment_judged_are_reported():
    (vehicle,) = told(HOVER.telemetry())["vehicles"]
    assert vehicle["boots"] == 1
    judged = vehicle["verdict"]["segment"]
    assert {**judged, "duration": judged["end"] - judged["start"]} == vehicle["segments"][0]


def test_the_rate_of_a_message_with_several_ports_is_that_of_one():
    telemetry = HOVER.telemetry()
    table = telemetry.messages["SERVO_OUTPUT_RAW"]
    twice = {name: np.repeat(column, 2) for name, column in table.items()}
    twice["port"] = np.resize([0, 1], len(twice["time"])).astype(np.uint8)
    (one,), (two,) = (told(changed(telemetry, "SERVO_OUTPUT_RAW", **columns))["vehicles"] for columns in (table, twice))
    assert one["messages"]["SERVO_OUTPUT_RAW"]["rate"] == two["messages"]["SERVO_OUTPUT_RAW"]["rate"]
