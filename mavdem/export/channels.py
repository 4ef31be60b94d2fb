"""A flight and its model's time series as MCAP channels, for Foxglove and PlotJuggler."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mavdem.dem import Learned
from mavdem.files import atomic_write
from mavdem.flight import Flight
from mavdem.ingest.mcap.writer import Series, write_series
from mavdem.report.names import short, state_names

Array = NDArray[np.float64]


def write_channels(
    path: str | os.PathLike[str], train: Flight, learned: Learned | None = None, test: Flight | None = None
) -> None:
    """Writes a flight as JSON channels of an .mcap file, on the boot clock, in the units of the flight.

    ``flight/outputs`` and ``flight/inputs`` are what was measured; with ``learned`` also ``learned/one_step``,
    ``learned/process_noise`` (per second), ``learned/free_energy`` (F(t)) and, if it is known, ``learned/wind_torque``
    with the half width of its band (rad/s²); and with ``test`` ``learned/forecast``.

    The model must be of ``train``, and ``test`` the samples right after it, to be forecast. ``OSError`` if it cannot be
    written, ``ValueError`` for a time before 0, which MCAP cannot hold, or a model of another flight.
    """
    flights = [train] if test is None else [train, test]
    if train.time[0] < 0:
        raise ValueError("time must not be negative: MCAP counts from 0")
    time = np.concatenate([flight.time for flight in flights])
    series = {
        "flight/outputs": _series(time, train.output_names, np.vstack([flight.outputs for flight in flights])),
        "flight/inputs": _series(time, train.input_names, np.vstack([flight.inputs for flight in flights])),
    }
    if learned is not None:
        series |= _learned(train, learned, test)
    with atomic_write(path) as file:
        write_series(file, series)


def _learned(train: Flight, learned: Learned, test: Flight | None) -> dict[str, Series]:
    if len(learned.record.outputs) != len(train):
        raise ValueError(f"the model was learnt from {len(learned.record.outputs)} samples, not these {len(train)}")
    places, noise = learned.process_noise()
    series = {
        "learned/one_step": _series(train.time, train.output_names, learned.one_step()),
        "learned/process_noise": _series(train.time[places], state_names(train, learned), noise),
        "learned/free_energy": (train.time[places], {"free_energy": learned.free_energy_of_samples}),
    }
    if learned.wind is not None:
        torque = np.stack([learned.wind.torque, learned.wind.band], axis=1)
        series["learned/wind_torque"] = _series(train.time, ("torque", "band"), torque)
    if test is not None:
        series["learned/forecast"] = _series(test.time, train.output_names, learned.forecast(test.inputs))
    return series


def _series(time: Array, names: Sequence[str], values: Array) -> Series:
    return time, dict(zip(_keys(names), values.T, strict=True))


def _keys(names: Sequence[str]) -> list[str]:
    """The names as a viewer's paths can have them: "motor_1" for "motor 1 (front right)"; apart in any case."""
    keys = [re.sub(r"\W+", "_", short(name)).strip("_") for name in names]
    return keys if len(set(keys)) == len(keys) else [f"{key}_{i + 1}" for i, key in enumerate(keys)]
