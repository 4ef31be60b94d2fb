"""Time series of a learned flight, for Rerun and MCAP: what the model was learned from, and what it computes.

They are on the samples and in the units of the training data. What was recorded besides, over the whole boot and to be
looked at, is a ``Timeline``.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dem import Learned
from mavdem.experiments.held_out import FORECAST, HeldOut
from mavdem.flight import Flights
from mavdem.report.labels import AxisCommand, state_names
from mavdem.wind_velocity.estimation import WindVelocity

OUTPUTS = "flight/outputs"
"""Measured outputs, angle and rate."""

INPUTS = "flight/inputs"
"""Recorded inputs, such as motor outputs."""

ONE_STEP = "learned/one_step"
"""One-step predictions of the outputs."""

PROCESS_NOISE = "learned/process_noise"
"""Process noise w of DEM, for each state."""

FREE_ENERGY = "learned/free_energy"
"""Free energy F(t) of each sample, nats: its share in the free energy action F̄."""

FREE_ENERGY_TERMS = "learned/free_energy_terms"
"""Terms of F(t) of each sample, nats: the columns are the names of ``mavdem.dem.engine.free_energy.Term``."""

FREE_ENERGY_ACTION = "learned/free_energy_action"
"""Sum of F(t) from the first sample to each sample, nats: at the last sample it is the F̄ that is reported."""

COMMAND = "learned/command"
"""Command of the axis."""

WIND_TORQUE = "learned/wind_torque"
"""Wind torque and the half width of its band, rad/s²."""

WIND_VELOCITY = "wind/velocity"
"""Velocity of the air, north and east, m/s."""

WIND_BAND = "wind/band"
"""Half width of the band of the wind's velocity, m/s."""

HELD_OUT = "held_out"
"""Folder of the series of held-out windows."""


class Series(NamedTuple):
    """Columns of values over one time."""

    time: Array
    """Times (N,), s."""

    names: Sequence[str]
    """Name of each of the k columns."""

    values: Array
    """Values (N, k)."""


def series_of(
    flights: Flights,
    learned: Learned | None,
    held_out: HeldOut | None = None,
    wind: WindVelocity | None = None,
) -> dict[str, Series]:
    """Returns the series of a learned flight by name; the names are the constants of this module.

    A model knows its training samples by number only, so that the times of the flights are given to its series.

    Args:
        flights: settled segments of one boot, in order of time.
        learned: the model that was learned from them, if any.
        held_out: windows with forecasts, if any, which follow each other in their series.
        wind: the wind of the flight, if any.

    Raises:
        ValueError: the model was learned from other flights.
    """
    output_names = flights[0].output_names
    input_names = flights[0].input_names
    time = np.concatenate([flight.time for flight in flights])
    outputs = np.vstack([flight.outputs for flight in flights])
    inputs = np.vstack([flight.inputs for flight in flights])
    series = {
        OUTPUTS: Series(time, output_names, outputs),
        INPUTS: Series(time, input_names, inputs),
    }
    if learned is not None:
        if len(learned.record) != len(time):
            count = len(learned.record)
            raise ValueError(f"the model was learned from {count} samples, not these {len(time)}")
        series |= dict(_model_series(output_names, time, learned))
    if held_out is not None:
        series |= dict(_held_out_series(output_names, held_out))
    if wind is not None:
        series[WIND_VELOCITY] = Series(wind.time, ("north", "east"), wind.velocity)
        series[WIND_BAND] = Series(wind.time, ("north", "east"), wind.band)
    return series


def _model_series(
    outputs: Sequence[str], time: Array, learned: Learned
) -> Iterator[tuple[str, Series]]:
    """Yields the name and the series of each signal that a model computes.

    Args:
        outputs: names of the outputs.
        time: times of the T training samples (T,), s.
        learned: the learned model. Its process noise and free energy exist at some of the samples only.
    """
    samples, noise = learned.process_noise()
    energy = learned.free_energy_of_samples
    terms = learned.free_energy_terms_of_samples()
    command = AxisCommand.of(learned)
    commands = command.series(learned.record.inputs)[:, None]
    yield ONE_STEP, Series(time, outputs, learned.one_step())
    yield PROCESS_NOISE, Series(time[samples], state_names(outputs, learned), noise)
    yield FREE_ENERGY, Series(time[samples], ("free_energy",), energy[:, None])
    if terms:
        values = np.stack(list(terms.values()), axis=1)
        yield FREE_ENERGY_TERMS, Series(time[samples], tuple(terms), values)
    action = np.cumsum(energy)[:, None]
    yield FREE_ENERGY_ACTION, Series(time[samples], ("free_energy_action",), action)
    yield COMMAND, Series(time, (command.name,), commands)
    wind = learned.resolved_wind_torque
    if wind is not None:
        torque = np.stack([wind.torque, wind.band], axis=1)
        yield WIND_TORQUE, Series(time, ("torque", "band"), torque)


def free_energy_per_sample(learned: Learned) -> float:
    """Returns the free energy action F̄ of a model divided by the number of its samples, nats: a level for F(t)."""
    return float(learned.free_energy[-1]) / len(learned.free_energy_of_samples)


def _held_out_series(outputs: Sequence[str], held_out: HeldOut) -> Iterator[tuple[str, Series]]:
    """Yields four series of the held-out windows with their names: measured, forecast, residual, and the 90 % band.

    Args:
        outputs: names of the m outputs.
        held_out: W windows of H samples; a series has W·H rows.
    """
    time = held_out.time.ravel()
    forecast = held_out.forecasts[FORECAST]
    windows = {
        "measured": held_out.measured,
        "forecast": forecast,
        "residual": held_out.measured - forecast,
        "band": held_out.band,
    }
    for name, values in windows.items():
        yield f"{HELD_OUT}/{name}", Series(time, outputs, values.reshape(len(time), -1))
