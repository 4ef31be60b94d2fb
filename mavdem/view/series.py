"""The series of each output (measured, predicted, forecast) for its plot, and the bands of parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from mavdem.dem import Learned
from mavdem.dem.priors import hyperparameter_prior
from mavdem.dem.validation import LEVEL
from mavdem.evaluate.held_out import CONSTANT_MEAN, FORECAST, HeldOut
from mavdem.flight import Flight
from mavdem.report.names import readable
from mavdem.view.lines import readable_range

Array = NDArray[np.float64]

MAX_BEYOND = 0.25  # how far a plot extends below and above the measured values at most, in spans of them


class OutputSeries(NamedTuple):
    """One output of T training samples and of held-out windows of H samples in all, a NaN after each window."""

    name: str
    unit: str
    time: Array  # (T,) s from the first sample
    measured: Array  # (T,)
    one_step: Array  # (T,)
    held_out_time: Array  # (H,) s from the first sample
    forecast: Array  # (H,)
    band: Array  # (H, 2) lower and upper edge
    constant_mean: Array  # (H,)

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


def output_series(flights: Sequence[Flight], learned: Learned, held_out: HeldOut) -> list[OutputSeries]:
    """One for each output of the flights that a model was learnt from."""
    first = flights[0]
    time = np.concatenate([flight.time for flight in flights]) - first.time[0]
    measured = np.vstack([flight.outputs for flight in flights])
    half, forecast = held_out.band, held_out.forecasts[FORECAST]
    inside = [
        _with_gaps(values)
        for values in (
            forecast,
            np.stack([forecast - half, forecast + half], axis=-1),
            held_out.forecasts[CONSTANT_MEAN],
        )
    ]
    held_out_time = _with_gaps(held_out.time) - first.time[0]
    one_step = learned.one_step()
    return [
        OutputSeries(
            name,
            unit.name,
            time,
            unit.scale * measured[:, i],
            unit.scale * one_step[:, i],
            held_out_time,
            *(unit.scale * values[:, i] for values in inside),
        )
        for i, (name, unit) in enumerate(zip(first.output_names, map(readable, first.output_units), strict=True))
    ]


def _with_gaps(windows: Array) -> Array:
    """Windows (W, H, …) one after the other, (W (H + 1), …); after each a value that draws no line."""
    gap = windows[:, -1:] if windows.ndim == 2 else np.full_like(windows[:, -1:], np.nan)
    return np.concatenate([windows, gap], axis=1).reshape(-1, *windows.shape[2:])


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
