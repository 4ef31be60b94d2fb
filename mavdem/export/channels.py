"""A flight and its model's time series as MCAP channels, for Foxglove and PlotJuggler."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence

import numpy as np

from mavdem.dem import Learned
from mavdem.dem.engine.linalg import Array
from mavdem.evaluate.held_out import FORECAST, HeldOut
from mavdem.files import atomic_write
from mavdem.flight import Flight
from mavdem.ingest.mcap.writer import Series, write_series
from mavdem.report.numbers import AxisCommand, short, state_names


def write_channels(
    path: str | os.PathLike[str],
    flights: Sequence[Flight],
    learned: Learned | None = None,
    held_out: HeldOut | None = None,
) -> None:
    """Writes flights of one boot as JSON channels of an .mcap file, on the boot clock, in the units of the flight.

    ``flight/outputs`` and ``flight/inputs`` are what was measured; with ``learned``, the model of these ``flights``,
    also ``learned/one_step``, ``learned/process_noise`` (per second), ``learned/free_energy`` (F(t)),
    ``learned/command``, the motors' difference, and, if it is known, ``learned/wind_torque`` with the half width of its
    band (rad/s²); and with ``held_out`` windows ``held_out/measured``, ``held_out/forecast``, ``held_out/residual`` and
    ``held_out/band``, the half width of the forecast's 90 % band. ``docs/layouts`` shows them in either viewer.

    ``OSError`` if ``path`` cannot be written, ``ValueError`` for a time before 0, which MCAP cannot hold, or a model of
    other flights.
    """
    first, time = flights[0], np.concatenate([flight.time for flight in flights])
    if time[0] < 0:
        raise ValueError("time must not be negative: MCAP counts from 0")
    series = {
        "flight/outputs": _series(time, first.output_names, np.vstack([flight.outputs for flight in flights])),
        "flight/inputs": _series(time, first.input_names, np.vstack([flight.inputs for flight in flights])),
    }
    if learned is not None:
        series |= _learned(first, time, learned)
    if held_out is not None:
        inside = held_out.time.ravel()
        measured, forecast = held_out.measured, held_out.forecasts[FORECAST]
        windows = {"measured": measured, "forecast": forecast, "residual": measured - forecast, "band": held_out.band}
        for name, values in windows.items():
            series[f"held_out/{name}"] = _series(inside, first.output_names, values.reshape(len(inside), -1))
    with atomic_write(path) as file:
        write_series(file, series)


def _learned(flight: Flight, time: Array, learned: Learned) -> dict[str, Series]:
    if len(learned.record) != len(time):
        raise ValueError(f"the model was learned from {len(learned.record)} samples, not these {len(time)}")
    (places, noise), command = learned.process_noise(), AxisCommand.of(learned)
    series = {
        "learned/one_step": _series(time, flight.output_names, learned.one_step()),
        "learned/process_noise": _series(time[places], state_names(flight.output_names, learned), noise),
        "learned/free_energy": (time[places], {"free_energy": learned.free_energy_of_samples}),
        "learned/command": _series(time, [command.name], command.series(learned.record.inputs)[:, None]),
    }
    if learned.wind is not None:
        torque = np.stack([learned.wind.torque, learned.wind.band], axis=1)
        series["learned/wind_torque"] = _series(time, ("torque", "band"), torque)
    return series


def _series(time: Array, names: Sequence[str], values: Array) -> Series:
    """By the names as a viewer's paths can have them: "motor_1" for "motor 1 (front right)"; apart in any case."""
    keys = [re.sub(r"\W+", "_", short(name)).strip("_") for name in names]
    if len(set(keys)) < len(keys):
        keys = [f"{key}_{i + 1}" for i, key in enumerate(keys)]
    return time, dict(zip(keys, values.T, strict=True))
