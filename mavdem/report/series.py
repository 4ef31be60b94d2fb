"""Series of a learned flight: what the model was learned from and makes of it, on its samples and in their units.

For Rerun and for MCAP. What was recorded beside it, over the whole boot and for eyes, is a ``Timeline``.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.axis.findings import resolved_wind_torque
from mavdem.dem import Learned
from mavdem.experiments.held_out import FORECAST, HeldOut
from mavdem.flight import Flights
from mavdem.report.labels import AxisCommand, state_names
from mavdem.wind_velocity.estimation import WindVelocity

OUTPUTS = "flight/outputs"
INPUTS = "flight/inputs"
ONE_STEP = "learned/one_step"
PROCESS_NOISE = "learned/process_noise"
FREE_ENERGY = "learned/free_energy"
COMMAND = "learned/command"
WIND_TORQUE = "learned/wind_torque"
WIND_VELOCITY = "wind/velocity"
WIND_BAND = "wind/band"
HELD_OUT = "held_out"


class Series(NamedTuple):
    """``values`` (N, k) over ``time`` (N,), s, a column for each of the ``names``."""

    time: Array
    names: Sequence[str]
    values: Array


def series_of(
    flights: Flights,
    learned: Learned | None,
    held_out: HeldOut | None = None,
    wind: WindVelocity | None = None,
) -> dict[str, Series]:
    """Returns the series of ``flights`` of one boot, of the model ``learned`` from them, and of the ``wind``, by name.

    The wind torque has its half width beside it, rad/s²; so has the wind's velocity, m/s north and east. Held-out
    windows follow each other, with what was measured, forecast and left, and the half width of the forecast's band.
    ``ValueError``: the model is of other flights.
    """
    first = flights[0]
    time = np.concatenate([flight.time for flight in flights])
    outputs = np.vstack([flight.outputs for flight in flights])
    inputs = np.vstack([flight.inputs for flight in flights])
    series = {
        OUTPUTS: Series(time, first.output_names, outputs),
        INPUTS: Series(time, first.input_names, inputs),
    }
    if learned is not None:
        if len(learned.record) != len(time):
            count = len(learned.record)
            raise ValueError(f"the model was learned from {count} samples, not these {len(time)}")
        series |= dict(_learned(first.output_names, time, learned))
    if held_out is not None:
        inside = held_out.time.ravel()
        forecast = held_out.forecasts[FORECAST]
        windows = {
            "measured": held_out.measured,
            "forecast": forecast,
            "residual": held_out.measured - forecast,
            "band": held_out.band,
        }
        for name, values in windows.items():
            columns = values.reshape(len(inside), -1)
            series[f"{HELD_OUT}/{name}"] = Series(inside, first.output_names, columns)
    if wind is not None:
        for name, values in ((WIND_VELOCITY, wind.velocity), (WIND_BAND, wind.band)):
            series[name] = Series(wind.time, ("north", "east"), values)
    return series


def _learned(names: Sequence[str], time: Array, learned: Learned) -> Iterator[tuple[str, Series]]:
    samples, noise = learned.process_noise()
    energy = learned.free_energy_of_samples[:, None]
    command = AxisCommand.of(learned)
    commands = command.series(learned.record.inputs)[:, None]
    yield ONE_STEP, Series(time, names, learned.one_step())
    yield PROCESS_NOISE, Series(time[samples], state_names(names, learned), noise)
    yield FREE_ENERGY, Series(time[samples], ("free_energy",), energy)
    yield COMMAND, Series(time, (command.name,), commands)
    if (wind := resolved_wind_torque(learned.wind_torque, learned.physical)) is not None:
        torque = np.stack([wind.torque, wind.band], axis=1)
        yield WIND_TORQUE, Series(time, ("torque", "band"), torque)
