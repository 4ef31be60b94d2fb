"""The inventory: the tier of made-up flights by their rates, flights read at each tier, and what a link lost."""

from __future__ import annotations

import numpy as np
import pytest
from hover import Hover, changed

import mavdem
from mavdem.alignment import read
from mavdem.alignment.signals import Signals
from mavdem.alignment.verdict import verdict_of
from mavdem.condition import condition_of
from mavdem.condition.inventory import Tier, inventory, tier_of
from mavdem.errors import NotLearnable
from mavdem.ingest import Log
from mavdem.ingest.telemetry import Component, Telemetry

HOVER, LONG = Hover(hovering=60.0), Hover(hovering=100.0)


def tier(telemetry: Telemetry) -> Tier:
    signals = Signals(telemetry)
    return tier_of(verdict_of(signals), condition_of(signals))


@pytest.mark.parametrize(
    ("attitude", "motors", "name", "following"),
    [
        (100.0, 100.0, "a", None),
        (50.0, 10.0, "b", "a"),
        (10.0, 10.0, "b", "a"),
        (100.0, 4.0, "c", "b"),
        (4.0, 4.0, "c", "b"),
        (1.0, 1.0, "c", "b"),
    ],
)
def test_the_slower_stream_decides_the_tier(attitude, motors, name, following):
    found = tier(HOVER.telemetry(attitude, motors))
    assert (found.name, found.next_tier) == (name, following)
    assert bool(found.remedy) == (name != "a") and (name == "a" or "Hz" in found.reason)


def test_without_settled_flight_there_is_no_tier_but_what_it_takes():
    telemetry = HOVER.telemetry(10.0, 10.0)
    beats = telemetry.messages["HEARTBEAT"]
    found = tier(changed(telemetry, "HEARTBEAT", base_mode=np.zeros(len(beats["time"]), dtype=np.uint8)))
    assert (found.name, found.next_tier, found.reason) == (None, "c", "The vehicle was never armed.")
    submarine = tier(HOVER.telemetry(100.0, 100.0, vehicle="SUBMARINE"))
    assert submarine.name is None and "SUBMARINE" in submarine.reason


def flight(telemetry: Telemetry, monkeypatch: pytest.MonkeyPatch, lowest: str) -> mavdem.Flight:
    monkeypatch.setattr(read, "read_log", lambda _: Log("", (telemetry,), (), (), 0, 0, (0.0, 0.0)))
    return mavdem.read_flight("log", tier=lowest)


def test_a_flight_is_read_at_the_tier_that_is_accepted_and_says_what_it_lacks(monkeypatch):
    slow = HOVER.telemetry(10.0, 10.0)
    with pytest.raises(NotLearnable, match="10.0 Hz"):
        flight(slow, monkeypatch, "a")
    for lowest in ("b", "c"):
        found = flight(slow, monkeypatch, lowest)
        assert found.dt == pytest.approx(0.1) and "No full roll model" in found.provenance["cautions"][-1]
    with pytest.raises(NotLearnable, match="4.0 Hz"):
        flight(HOVER.telemetry(4.0, 4.0), monkeypatch, "b")
    assert flight(HOVER.telemetry(4.0, 4.0), monkeypatch, "c").dt == pytest.approx(0.25)
    with pytest.raises(ValueError, match="tier must be one of a, b, c"):
        mavdem.read_flight("log", tier="d")


def test_rates_that_contradict_the_angles_make_no_slow_motion(monkeypatch):
    """A 12 Hz oscillation at 10 Hz looks like one of 2 Hz, at a sixth of its rate."""
    time = HOVER.stamps(10.0)
    fast = 2 * np.pi * 12.2
    slow = HOVER.telemetry(10.0, 10.0)
    oscillating = {"roll": 0.02 * np.sin(fast * time), "rollspeed": 0.02 * fast * np.cos(fast * time)}
    aliased = changed(slow, "ATTITUDE", **oscillating)
    assert tier(aliased).name == "b"
    with pytest.raises(NotLearnable, match="contradict"):
        flight(aliased, monkeypatch, "b")
    assert flight(aliased, monkeypatch, "c").dt == pytest.approx(0.1)


def told(telemetry: Telemetry) -> dict:
    speaker = Component(1, 1, "QUADROTOR", "ARDUPILOTMEGA", {"ATTITUDE": 1000}, lost=4000)
    station = Component(255, 190, "GCS", "INVALID", {"HEARTBEAT": 60}, lost=100)
    return inventory(Log("made-up.tlog", (telemetry,), (speaker, station), (), 0, 0, (0.0, 0.0)))


def test_a_log_of_some_kinds_misses_nothing_of_what_it_keeps():
    vehicle, station = told(LONG.telemetry(stamps_of_8_and_12(), 50.0))["speakers"]
    assert vehicle["lost_share"] == pytest.approx(0.8)
    assert vehicle["missing_share"] == 0
    assert station["missing_share"] is None


def stamps_of_8_and_12() -> np.ndarray:
    return np.cumsum(np.resize([0.008, 0.012], round(LONG.end * 100)))


@pytest.mark.parametrize("stamps", [(), (stamps_of_8_and_12(), stamps_of_8_and_12())])
def test_a_link_that_loses_messages_loses_them_of_every_kind(stamps):
    random, telemetry = np.random.default_rng(3), LONG.telemetry(*stamps)
    for message, table in telemetry.messages.items():
        kept = random.random(len(table["time"])) > 0.1
        telemetry = changed(telemetry, message, **{name: column[kept] for name, column in table.items()})
    assert told(telemetry)["speakers"][0]["missing_share"] == pytest.approx(0.1, abs=0.02)


def test_the_rate_of_a_message_with_several_ports_is_that_of_one():
    telemetry = LONG.telemetry()
    table = telemetry.messages["SERVO_OUTPUT_RAW"]
    twice = {name: np.repeat(column, 2) for name, column in table.items()}
    twice["port"] = np.resize([0, 1], len(twice["time"])).astype(np.uint8)
    (one,), (two,) = (told(changed(telemetry, "SERVO_OUTPUT_RAW", **columns))["vehicles"] for columns in (table, twice))
    assert one["messages"]["SERVO_OUTPUT_RAW"]["rate"] == two["messages"]["SERVO_OUTPUT_RAW"]["rate"]
