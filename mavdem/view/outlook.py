"""Outlook: one output of a flight as learnt and as forecast, in the unit and over the range it is shown in."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem import evaluate
from mavdem.dem import Learned
from mavdem.flight import Flight
from mavdem.naming import readable
from mavdem.view.ticks import readable_range

Array = NDArray[np.float64]

LEVEL = 0.9
"""Probability of every band."""

BEYOND = 0.25
"""How far below and above what was measured a picture reaches at most, in spans of it."""


class Outlook(NamedTuple):
    """One output of the T training and H held-out samples; times in s from the first training sample."""

    name: str
    unit: str
    time: Array  # (T + H,)
    measured: Array  # (T + H,)
    one_step: Array  # (T,)
    forecast: Array  # (H,)
    band: Array  # (H, 2) lower and upper edge
    constant_mean: Array  # (H,)

    @property
    def boundary(self) -> float:
        """When the held-out part begins, s."""
        return float(self.time[len(self.one_step)])

    @property
    def range(self) -> tuple[float, float]:
        """What was measured, and what of the rest is no more than BEYOND it: a forecast and its band may run away."""
        low, high = float(self.measured.min()), float(self.measured.max())
        everything = np.concatenate([self.measured, self.one_step, self.forecast, self.band.ravel()])
        lowest = max(float(np.nanmin(everything)), low - BEYOND * (high - low))
        highest = min(float(np.nanmax(everything)), high + BEYOND * (high - low))
        measured, wider = readable_range(low, high), readable_range(lowest, highest)
        # A wider axis may have to be much wider to be numbered: then what was measured must do.
        return wider if wider[1] - wider[0] <= (1 + 2 * BEYOND) * (measured[1] - measured[0]) else measured


def outlooks(train: Flight, test: Flight, learned: Learned) -> list[Outlook]:
    """One for each output of a flight."""
    time = np.append(train.time, test.time) - train.time[0]
    measured = np.vstack([train.outputs, test.outputs])
    one_step, forecast = learned.one_step(), learned.forecast(test.inputs)
    band = np.stack(learned.forecast_band(test.inputs, LEVEL), axis=-1)
    constant = evaluate.trivial_forecasts(train, len(test))["constant mean"]
    return [
        Outlook(name, unit.name, time, *(unit.scale * y[:, i] for y in (measured, one_step, forecast, band, constant)))
        for i, (name, unit) in enumerate(zip(train.output_names, map(readable, train.output_units), strict=True))
    ]
