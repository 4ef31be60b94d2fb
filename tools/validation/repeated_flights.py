"""Simulated flights of the same vehicles again and again, in other winds and with other steering, as rows."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from physical_flights import MOMENTS, SPEEDS, STEERING

from mavdem.alignment.read import choose_vehicle
from mavdem.alignment.signals import Signals
from mavdem.condition import condition_of
from mavdem.dem.validation import LEVEL
from mavdem.evaluate.vehicle_figures import AxisFigures, vehicle_of_log
from mavdem.export.conversion import STREAMS
from mavdem.fleet.row import FlightRow
from mavdem.ingest import Log, read_log
from sitl_scenarios.files import scenario_of
from sitl_scenarios.mavlink.recorded import recorded
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import Simulation, fly

SECONDS = 60.0
START = datetime(2026, 1, 1, tzinfo=UTC)


class RepeatedFlight(NamedTuple):
    """The ``number``-th flight of a vehicle; ``weak_motor`` from 1, 0 for none."""

    vehicle: str
    number: int
    weak_motor: int
    seed: int
    thrust: float  # share of its thrust that a weak motor has left


def repeated(seed: int, healthy: int, weak: int, thrust: float) -> list[RepeatedFlight]:
    """So many healthy flights of each vehicle, and after them flights with a weak motor."""
    rng = np.random.default_rng(seed)
    return [
        RepeatedFlight(
            vehicle, number, int(rng.integers(1, 5)) if number >= healthy else 0, int(rng.integers(10**6)), thrust
        )
        for vehicle in SPEEDS
        for number in range(healthy + weak)
    ]


def scenario(flight: RepeatedFlight) -> Scenario:
    """Wind, steering and the battery's sag are drawn by the flight's seed; the vehicle is the same."""
    rng = np.random.default_rng(flight.seed)
    k, moment = SPEEDS[flight.vehicle], MOMENTS[flight.vehicle]
    speed, direction = float(rng.uniform(0, 7) * k), float(rng.uniform(0, 360))
    winds: list[list[dict[str, Any]]] = [
        [],
        [{"kind": "gaussian", "sd": 0.5 * k, "s": 0.2}],
        [{"kind": "dryden", "speed": speed, "direction": direction, "wind_at_20_feet": float(rng.uniform(3, 15)) * k}],
        [{"kind": "von_karman", "speed": speed, "direction": direction, "wind_at_20_feet": 8 * k}],
        [{"kind": "steady", "speed": speed, "direction": direction}, {"kind": "gaussian", "sd": 1.2 * k, "s": 0.3}],
    ]
    values: dict[str, Any] = {
        "duration": SECONDS,
        "seed": flight.seed,
        "height": 8.0,
        "vehicle": {
            "model": flight.vehicle,
            "battery_sag": float(rng.uniform(0, 0.1)),
            "weak_motor": flight.weak_motor,
            "weak_thrust": flight.thrust,
        },
        "wind": winds[int(rng.integers(len(winds)))],
        "moments": [{"sd": moment / 2, "s": 0.1}] if rng.random() < 0.5 else [],
    }
    steering = STEERING[list(STEERING)[int(rng.integers(len(STEERING)))]]
    return scenario_of(values if steering is None else values | {"excitation": steering})


def rows_of(flight: RepeatedFlight) -> list[FlightRow]:
    """The rows of a flight as a fleet has them: flown, written as a telemetry log, and read again."""
    of = scenario(flight)
    with TemporaryDirectory() as folder:
        log = Path(folder) / "flight.tlog"
        with log.open("wb") as file:
            STREAMS[".tlog"](file, recorded(of, fly(of), Simulation(of).cycle, lambda _: None))
        return _rows(flight, read_log(log))


def _rows(flight: RepeatedFlight, log: Log) -> list[FlightRow]:
    condition = condition_of(Signals(choose_vehicle(log.vehicles, None), inputs="motors"))
    hover, lean, battery = condition.hover, condition.lean, condition.battery
    assert hover is not None
    name = f"{flight.vehicle}-{flight.number}"
    known: dict[str, Any] = {
        "file": name,
        "key": name,
        "vehicle": flight.vehicle,
        "date": START + timedelta(days=flight.number),
        "tier": "a",
        "duration": hover.seconds,
        "voltage_mean": None if battery is None else battery.voltage_mean,
        "collective": condition.collective,
        "lean_roll": lean["roll"].mean if lean else None,
        "lean_pitch": lean["pitch"].mean if lean else None,
        "tilt_sd": condition.tilt_sd,
        "motors": hover.motors,
        "trim_unit": hover.unit,
        "inputs": "motors",
        "input_unit": hover.unit,
        "trim": hover.trim,
        "trim_share": hover.trim_share,
        "trim_share_interval": None if None in condition.share_interval else condition.share_interval,
        # The truth, which nothing that is compared looks at.
        "suspect_motor": flight.weak_motor or None,
    }
    figures = vehicle_of_log(log, ("roll", "pitch")).axes
    return [FlightRow(axis=axis, **known, **_model(own)) for axis, own in figures.items()]


def _model(own: AxisFigures) -> dict[str, Any]:
    found, wind = own.physical, own.wind
    columns: dict[str, Any] = {}
    if found is not None:
        half = found.interval(LEVEL)
        for parameter in ("effect", "damping", "lag"):
            columns[parameter] = getattr(found, parameter)
            columns[f"{parameter}_interval"] = getattr(half, parameter)
            columns[f"{parameter}_status"] = found.status[parameter]
    if wind is not None:
        columns |= {"wind_torque_sd": wind.sd, "wind_torque_mean": wind.mean, "wind_torque_interval": wind.mean_band}
    return columns
