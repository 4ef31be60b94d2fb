"""The series of each output (measured, predicted, forecast) for its plot, and the bands of parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from mavdem import evaluate
from mavdem.dem import Learned
from mavdem.dem.priors import hyperparameter_prior
from mavdem.dem.validation import LEVEL
from mavdem.flight import Flight
from mavdem.report.names import readable
from mavdem.view.lines import readable_range

Array = NDArray[np.float64]

MAX_BEYOND = 0.25  # how far a plot extends below and above the measured values at most, in spans of them


class OutputSeries(NamedTuple):
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
        """Start of the held-out test set, s."""
        return float(self.time[len(self.one_step)])

    @property
    def range(self) -> tuple[float, float]:
        """The measured values, and of the rest what is at most MAX_BEYOND outside: a forecast may diverge."""
        low, high = float(self.measured.min()), float(self.measured.max())
        everything = np.concatenate([self.measured, self.one_step, self.forecast, self.band.ravel()])
        lowest = max(float(np.nanmin(everything)), low - MAX_BEYOND * (high - low))
        highest = min(float(np.nanmax(everything)), high + MAX_BEYOND * (high - low))
        measured, wider = readable_range(low, high), readable_range(lowest, highest)
        # If labels make the wider axis much wider, show the measured range.
        return wider if wider[1] - wider[0] <= (1 + 2 * MAX_BEYOND) * (measured[1] - measured[0]) else measured


def output_series(train: Flight, test: Flight, learned: Learned) -> list[OutputSeries]:
    """One for each output of a flight."""
    time = np.append(train.time, test.time) - train.time[0]
    measured = np.vstack([train.outputs, test.outputs])
    one_step, forecast = learned.one_step(), learned.forecast(test.inputs)
    half = learned.forecast_band(test.inputs, LEVEL)
    band = np.stack([forecast - half, forecast + half], axis=-1)
    constant = evaluate.trivial_forecasts(train, len(test))["constant mean"]
    arrays = (measured, one_step, forecast, band, constant)
    return [
        OutputSeries(name, unit.name, time, *(unit.scale * values[:, i] for values in arrays))
        for i, (name, unit) in enumerate(zip(train.output_names, map(readable, train.output_units), strict=True))
    ]


def prior_outweighs_data(learned: Learned) -> NDArray[np.bool_]:
    """Which λ, (g,), have more precision from the prior than from the data: the prior fixes them in effect."""
    posterior = 1 / learned.learning.lambda_sd[-1] ** 2
    m, n = learned.model.C.shape
    _, prior = hyperparameter_prior(learned.settings, n, m)
    return np.asarray(posterior < 2 * np.diag(prior))


def estimate_band(
    mean: NDArray[np.float64], sd: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The edges of the ``LEVEL`` interval of a Gaussian posterior."""
    half = norm.ppf(0.5 + LEVEL / 2) * sd
    return mean - half, mean + half


def by_group(noise: str, channels: Sequence[str], groups: NDArray[np.intp]) -> list[str]:
    """The name of each λ of a noise, "z" or "w": the channels that share it."""
    names = [
        " and ".join(channel for channel, group in zip(channels, groups, strict=True) if group == own)
        for own in np.unique(groups)
    ]
    return (
        [{"z": "z, measurement", "w": "w, process"}[noise]] if len(names) == 1 else [f"{noise} of {n}" for n in names]
    )
