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
from mavdem.wind_velocity.velocity import WindVelocity

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


def recording_series(
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
    """Yields each signal that a model computes from its training data, after its name, a constant of this module.

    Args:
        outputs: names of the m outputs.
        time: times of the T training samples (T,), s.
        learned: the linear model that was learned from a flight, with its training data.
    """
    # (T, m): the prediction of each sample from those before it.
    yield ONE_STEP, Series(time, outputs, learned.one_step())

    # DEM computes time derivatives from a window of samples around each of S samples: it has no process noise and no
    # free energy at the first and last samples of a segment.
    process_noise = learned.process_noise()
    window_times = time[process_noise.samples]
    noise_names = state_names(outputs, learned)
    yield PROCESS_NOISE, Series(window_times, noise_names, process_noise.noise)
    free_energy = learned.free_energy_of_samples
    yield FREE_ENERGY, Series(window_times, ("free_energy",), free_energy[:, None])
    terms = learned.free_energy_terms_of_samples()
    if terms:
        values = np.stack(list(terms.values()), axis=1)
        yield FREE_ENERGY_TERMS, Series(window_times, tuple(terms), values)
    # The free energy action is the sum of the free energy over time.
    action = np.cumsum(free_energy)
    yield FREE_ENERGY_ACTION, Series(window_times, ("free_energy_action",), action[:, None])

    command = AxisCommand.of(learned)
    command_values = command.series(learned.record.inputs)
    yield COMMAND, Series(time, (command.name,), command_values[:, None])
    wind_torque = learned.resolved_wind_torque
    if wind_torque is not None:
        # The band is the half width of the interval at each sample.
        torque_and_band = np.stack([wind_torque.torque, wind_torque.band], axis=1)
        yield WIND_TORQUE, Series(time, ("torque", "band"), torque_and_band)


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
