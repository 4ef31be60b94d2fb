#!/usr/bin/env python
"""Predictions of OnlineLearner on whole flights, motors unknown, beside VAR(4), the last sample held and the mean.

Squared error over that of the mean of all samples so far, each output in units of its variance, summed, from the 12th
second on; beside each horizon the share of samples in the 90 % band. VAR(4) is a joint autoregression of outputs and
motors, fitted each second to the last 20 s, ridge 0.01. Every flight belongs to half A or half B, as in forecasts.py.

Usage: tools/bench/ahead.py [--seconds S] [--without-model] [--name PART] [--half A] [--json FILE]
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
from forecasts import DEMAND_LOGS, SCENARIOS, HalvedFlight, simulated

import mavdem
from mavdem.dem.engine.linalg import Array
from mavdem.dem.forecast.var import Var
from mavdem.dem.online.ahead import PredictionsAhead
from mavdem.dem.online.learner import BLOCK_SECONDS, HORIZONS
from mavdem.dem.online.memory import Memory
from mavdem.dem.online.tracker import ErrorBands
from mavdem.dem.record import Record
from mavdem.paper.flights import SHARED, recorded_flights

SKIPPED_SECONDS = 12.0
MEMORY_SECONDS = 20.0
LAGS = 4
RATES = (50, 100, 250)  # Hz, of simulated flights, in turn


def flights() -> Iterator[HalvedFlight]:
    """Recorded flights, autopilots' own logs on both axes, and each scenario at one rate."""
    for number, (name, flight) in enumerate(recorded_flights()):
        yield HalvedFlight(name, number, flight)
    for number, name in enumerate(DEMAND_LOGS):
        for shift, axis in enumerate(("roll", "pitch")):
            if (SHARED / name).exists():
                flight = mavdem.read_flight(SHARED / name, axis=axis)
                yield HalvedFlight(f"{Path(name).name} {axis}", number + shift, flight)
    for number, name in enumerate(SCENARIOS):
        rate = RATES[number % len(RATES)]
        yield HalvedFlight(f"{name} at {rate} Hz", number, simulated(name, rate))


def var4(flight: mavdem.Flight) -> Array:
    """(T, H, m): predictions of the reference; NaN in the first two seconds."""
    outputs, inputs = flight.outputs, flight.inputs
    channels = np.hstack([outputs, inputs])
    second, most, m = round(1 / flight.dt), round(MEMORY_SECONDS / flight.dt), outputs.shape[1]
    found = np.full((len(outputs), len(HORIZONS), m), np.nan)
    for now in range(2 * second, len(outputs), second):
        past = slice(max(0, now - most), now)
        model = Var.learn(Record(inputs[past], outputs[past], flight.dt, (now - past.start,)), LAGS)
        rows = np.arange(now, min(now + second, len(outputs)))
        before = channels[rows[:, None] + np.arange(1 - LAGS, 1)]
        found[rows] = model.predict(before, HORIZONS[-1]).mean[:, np.array(HORIZONS) - 1, :m]
    return found


def ours(flight: mavdem.Flight, model: bool) -> tuple[Array, Array]:
    """Predictions and half widths (T, H, m)."""
    (count, r), m = flight.inputs.shape, flight.outputs.shape[1]
    found, bands = np.full((2, count, len(HORIZONS), m), np.nan)
    rows = zip(flight.time, flight.outputs, flight.inputs, strict=True)
    if model:
        online = mavdem.OnlineLearner(None, flight.dt, r, m)
        for row, (time, outputs, inputs) in enumerate(rows):
            estimate = online.update(time, outputs, inputs)
            found[row], bands[row] = estimate.ahead, estimate.ahead_band
        return found, bands
    block = max(1, round(BLOCK_SECONDS / flight.dt))
    memory = Memory(flight.dt, block, round(MEMORY_SECONDS / flight.dt / block), r, m)
    ahead, errors = PredictionsAhead(flight.dt, block, HORIZONS, r, m), ErrorBands(HORIZONS, m, flight.dt)
    for row, (time, outputs, inputs) in enumerate(rows):
        closed = memory.add(inputs, outputs, time)
        found[row], bands[row] = ahead.predict(memory), errors.half_widths[1:]
        errors.add(outputs, np.full(m, np.nan), found[row])
        if closed:
            errors.update()
            ahead.add(memory.blocks[-1])
        ahead.advance()
    return found, bands


def figures(flight: mavdem.Flight, model: bool) -> dict[str, list[float]]:
    """Squared errors of each prediction, by horizon, in units of the outputs' variance; and coverage."""
    outputs, first = flight.outputs, round(SKIPPED_SECONDS / flight.dt)
    found, bands = ours(flight, model)
    held = np.repeat(outputs[:, None], len(HORIZONS), axis=1)
    mean = np.cumsum(held, axis=0) / np.arange(1, len(held) + 1)[:, None, None]
    variance = outputs[first:].var(axis=0)
    by_method: dict[str, list[float]] = {}
    for name, predicted in {"ours": found, "VAR(4)": var4(flight), "hold": held, "mean": mean}.items():
        by_method[name] = []
        for place, horizon in enumerate(HORIZONS):
            errors = outputs[first + horizon :] - predicted[first:-horizon, place]
            by_method[name].append(float((errors**2 / variance).mean(axis=0).sum()))
    by_method["inside"] = [
        float(np.mean(np.abs(outputs[first + h :] - found[first:-h, i]) <= bands[first:-h, i]))
        for i, h in enumerate(HORIZONS)
    ]
    return by_method


def line(label: str, *groups: Array) -> str:
    return f"| {label} | " + " | ".join(" ".join(f"{value:.3g}" for value in group) for group in groups) + " |"


def print_row(row: dict[str, Any]) -> None:
    ours_, var, hold, mean = (np.array(row[name]) for name in ("ours", "VAR(4)", "hold", "mean"))
    label = f"{row['flight']} | {row['half']} | {row['rate']}"
    print(line(label, ours_ / mean, ours_ / var, ours_ / np.minimum(hold, mean), np.array(row["inside"])), flush=True)


def print_summary(rows: list[dict[str, Any]]) -> None:
    print("\n| half | flights | ours | VAR(4) | hold | ours ÷ VAR(4) | in the 90 % band |")
    print("|---|---|---|---|---|---|---|")
    for half in ("A", "B", "AB"):
        those = [row for row in rows if row["half"] in half]
        if not those:
            continue
        columns = {name: np.array([row[name] for row in those]) for name in ("ours", "VAR(4)", "hold", "mean")}
        of_mean = [np.exp(np.log(columns[n] / columns["mean"]).mean(axis=0)) for n in ("ours", "VAR(4)", "hold")]
        inside = np.mean([row["inside"] for row in those], axis=0)
        print(line(f"{half} | {len(those)}", *of_mean, of_mean[0] / of_mean[1], inside))
    worst = np.array([np.divide(row["ours"], np.minimum(row["hold"], row["mean"])) for row in rows])
    inside = np.array([row["inside"] for row in rows])
    print(
        f"\nOf {worst.size} flights and horizons, {np.sum(worst > 1.05)} are worse than 1.05 times the better of hold "
        f"and mean, the worst {worst.max():.3g}; coverage is {inside.min():.2f} to {inside.max():.2f}, by flight "
        f"{inside.mean(axis=1).min():.2f} to {inside.mean(axis=1).max():.2f}."
    )


@click.command(help=__doc__)
@click.option("--seconds", type=float, default=np.inf, help="Of each flight.  [default: all]")
@click.option("--without-model", is_flag=True, help="Without the state-space model beside it: ten times faster.")
@click.option("--name", default="", help="Only flights whose name contains this.")
@click.option("--half", default="AB", show_default=True)
@click.option("--json", "to", type=click.Path(path_type=Path), help="Also write each flight's figures there.")
def main(seconds: float, without_model: bool, name: str, half: str, to: Path | None) -> None:
    steps = " ".join(map(str, HORIZONS))
    print(f"| flight | half | Hz | ours ÷ mean at {steps} | ÷ VAR(4) | ÷ better of hold and mean | in the 90 % band |")
    print("|---|---|---|---|---|---|---|")
    rows: list[dict[str, Any]] = []
    for one in flights():
        own, flight = "AB"[one.number % 2], one.flight
        if name not in one.name or own not in half:
            continue
        flight = flight[: round(min(seconds, len(flight) * flight.dt) / flight.dt)]
        row = {"flight": one.name, "half": own, "rate": round(1 / flight.dt)} | figures(flight, not without_model)
        rows.append(row)
        print_row(row)
    if not rows:
        sys.exit(f"There is no such flight in {SHARED}; name the folder in MAVDEM_SHARED_DATA.")
    print_summary(rows)
    if to:
        to.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
