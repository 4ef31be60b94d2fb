"""Flights of a log: what a row says is what the log says, at each tier, and health comes from the vehicle's others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

import mavdem
from mavdem.analysis import LogAnalysis, analyse
from mavdem.condition import identity_of
from mavdem.dem import parallel
from mavdem.errors import Unreadable
from mavdem.fleet.reading import flights
from mavdem.fleet.reading.flights import rows_of_log
from mavdem.fleet.row import FlightRow
from mavdem.fleet.second_pass import HealthyModels, with_health
from mavdem.health.motor_watch import MotorAlarm

LOGS = Path(__file__).parents[2] / "logs"
SLOW = LOGS / "ardupilot_default_rates.tlog"


@pytest.fixture(scope="module")
def slow_rows() -> list[FlightRow]:
    return rows_of_log(SLOW, None, "", "key")


def test_a_slow_log_gives_what_it_holds_and_says_why_no_more(slow_rows):
    hover = mavdem.hover(SLOW)
    assert [row.axis for row in slow_rows] == ["roll", "pitch"]
    for row in slow_rows:
        assert (row.tier, row.status, row.effect) == ("c", "ok", None) and "4.0 Hz" in row.tier_reason
        assert row.trim == pytest.approx(hover.trim) and row.headroom == pytest.approx(hover.headroom)
        assert row.duration == pytest.approx(hover.seconds) and row.attitude_rate == pytest.approx(4, abs=0.2)
        assert row.lean_roll == pytest.approx(np.radians(hover.roll))
        assert len(row.positions) == len(row.spins) == len(row.motors) == 4


def test_a_log_read_in_the_user_s_process_leaves_it_as_it_was(monkeypatch):
    monkeypatch.setattr(parallel, "_alone", False)
    rows_of_log(SLOW, None, "", "key")
    assert not parallel._alone


def test_a_page_is_written_once_for_a_vehicle(tmp_path):
    written = []

    def page(name: str, analyses: Mapping[str, LogAnalysis], path: Path) -> None:
        written.append((name, list(analyses), path))

    assert {row.page for row in rows_of_log(SLOW, page, str(tmp_path / "pages"), "")} == {None} and not written
    (tmp_path / "pages").mkdir()
    rows = rows_of_log(SLOW, page, str(tmp_path / "pages"), "0123456789abcdef0123")
    assert written == [(SLOW.name, ["roll", "pitch"], tmp_path / "pages" / "0123456789abcdef-1-1.html")]
    assert {row.page for row in rows} == {"pages/0123456789abcdef-1-1.html"}


def test_a_log_that_is_none_cannot_be_read(tmp_path):
    (tmp_path / "x.bin").write_bytes(b"PK\x03\x04")
    with pytest.raises(Unreadable, match="is a zip archive"):
        rows_of_log(tmp_path / "x.bin", None, "", "")


def flight(key: str, inputs: tuple[float, ...], **columns: object) -> FlightRow:
    """A flight whose model says that each µs of either motor turns it by 1 or -1 rad/s², damped by 2/s."""
    effect = np.array([1.0, -1.0])
    values = {
        "motors": ("1", "2"),
        "axis": "roll",
        "mean_inputs": inputs,
        "mean_outputs": (0.1, 0.0),
        "residual_gain_inputs": -effect,
        "residual_gain_outputs": (0.0, 2.0),
        "residual_offset": float(effect @ inputs),
    }
    return FlightRow(file=f"{key}.bin", key=key, **values | columns)


def test_the_residual_mean_is_what_healthy_models_leave_of_a_flight():
    healthy = [flight(str(number), (1500 + number, 1500 - number)) for number in (-1, 0, 1)]
    models = HealthyModels(healthy, healthy[0])
    assert models.residual_mean(flight("new", (1510, 1500))) == pytest.approx(-10)
    # Each of the three leaves -3, 0 and 3 by the other two: a half width of Student's t with two degrees of freedom.
    assert models.interval == pytest.approx(2.920 * np.sqrt(6), rel=1e-3)
    assert models.residual_mean(healthy[0]) == pytest.approx(3)
    others = HealthyModels(healthy, flight("new", (1510, 1500), axis="pitch"))
    assert others.residual_mean(flight("new", (1510, 1500))) is None and others.interval is None
    assert models.residual_mean(flight("new", (1510, 1500), motors=("other", "names"))) is None


def test_flights_of_nobody_known_are_not_compared(slow_rows):
    row = replace(slow_rows[0], vehicle_basis="system id")
    (found,) = with_health([row], [])
    assert found.health == "unknown" and "does not say which vehicle" in found.health_reason
    (failed,) = with_health([FlightRow(file="x", status="It is empty.")], [])
    assert failed.health_reason is None


def test_health_comes_from_the_vehicle_s_healthy_flights(slow_rows):
    row = replace(slow_rows[0], vehicle="7", vehicle_basis="board")
    dates = [datetime(2026, 5, day, tzinfo=UTC) for day in (1, 2, 3, 4)]
    flown = [replace(row, key=f"{number}", file=f"{number}", date=dates[number]) for number in range(3)]
    balance = tuple(np.add(row.balance, (0.08, 0.08, -0.08)))
    spoilt = replace(row, key="9", file="9", date=dates[3], balance=balance)
    found = with_health([*flown, spoilt], flown)
    assert [one.health for one in found[:3]] == ["ok"] * 3
    assert found[3].health in ("fault", "drift") and found[3].fault_probability > found[0].fault_probability


def test_a_flight_driven_by_the_demand_has_no_residual_beside_models_of_the_motors():
    known = [flight(str(number), (1500 + number, 1500 - number)) for number in (-1, 0, 1)]
    healthy = [replace(row, inputs="motors") for row in known]
    by_demand = replace(
        flight("new", (0.1, 0.0)),
        inputs="demand",
        mean_inputs=(0.1,),
        residual_gain_inputs=(-2.0,),
        residual_offset=0.2,
    )
    assert HealthyModels(healthy, healthy[0]).residual_mean(by_demand) is None
    assert HealthyModels([*healthy, by_demand], healthy[0]).residual_mean(healthy[0]) == pytest.approx(3)
    assert HealthyModels(healthy, by_demand).interval is None


def test_an_error_in_one_vehicle_leaves_the_rows_of_the_others(slow_rows, monkeypatch):
    log = mavdem.ingest.read_log(SLOW)
    (sound,) = log.vehicles
    other = replace(sound, component=7)

    def identity(signals, received):
        if signals.telemetry is other:
            raise KeyError("geometry")
        return identity_of(signals, received)

    monkeypatch.setattr(flights, "identity_of", identity)
    monkeypatch.setattr(flights, "read_log", lambda _: replace(log, vehicles=(other, sound)))
    failed, *rows = rows_of_log(SLOW, None, "", "key")
    assert "KeyError" in failed.status and failed.component == 7
    assert [row.axis for row in rows] == ["roll", "pitch"] and {row.status for row in rows} == {"ok"}


def test_an_alarm_in_flight_is_among_the_warnings(monkeypatch):
    alarm = MotorAlarm(20.0, 15.0, 2, "motor 2", 0.14, 0.99)
    load = alarm._replace(motor=None, name="")
    monkeypatch.setattr(flights, "analyse", lambda *arguments: replace(analyse(*arguments), alarms=(load, alarm)))
    for row in rows_of_log(SLOW, None, "", "key"):
        assert row.warnings[0] == alarm.sentence and load.sentence not in row.warnings
