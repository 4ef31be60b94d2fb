"""Held-out windows: forecasts of every part of a flight by a model that was trained without that part.

The settled flight is cut into contiguous parts (blocked cross-validation). A model is trained on all parts but one, and
forecasts that one window by window, each forecast from the state that its filter has at the window's start.

The training data adjoin each part on both sides, without a gap: the first second of a part is correlated with them.

References:
    C. Bergmeir and J. M. Benítez, "On the use of cross-validation for time series predictor evaluation", Information
    Sciences 191, 2012: blocks keep neighbouring samples, which are correlated, on the same side.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any, NamedTuple

import numpy as np

from mavdem.confidence import LEVEL
from mavdem.dem import Learned, Settings, learn
from mavdem.dem.engine.linalg import Array
from mavdem.evaluate.scores import error_over
from mavdem.evaluate.windows import TEST_SECONDS, samples_in
from mavdem.flight import Flight

FOLDS = 5
MIN_PIECE_SECONDS = 1.0
"""A piece of training data between two cuts that is shorter is left out: it is mostly the edge of its embedding."""

FORECAST, PREDICTION = "forecast", "prediction"
BASELINES = CONSTANT_MEAN, HOLD_LAST = "constant mean", "hold last"


class Piece(NamedTuple):
    """Samples ``start`` to ``stop`` of a flight."""

    flight: Flight
    start: int
    stop: int


@dataclass(frozen=True, eq=False)
class HeldOut:
    """W windows of H samples and m outputs that no model saw which forecasts them; angles in rad, rates in rad/s.

    Attributes:
        time: (W, H) s on the autopilot's boot clock.
        measured: (W, H, m).
        forecasts: (W, H, m) by name: "forecast", with the recorded motors; "prediction", without them; and the
            baselines "constant mean", of the training data, and "hold last", the sample before the window. NaN where no
            model could be learnt.
        band: (W, H, m) half width of the 90 % band of "forecast".
        expected: (W, H, m) squared error to expect of "forecast", as the model states it.
        variance: (m,) of the training data: the unit in which the errors of outputs are added up.
        failures: why models of parts could not be learnt, one sentence each.
    """

    time: Array
    measured: Array
    forecasts: dict[str, Array]
    band: Array
    expected: Array
    variance: Array
    failures: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.time)

    @property
    def seconds(self) -> float:
        """Length of a window, s."""
        steps = self.time.shape[1]
        return float(np.ptp(self.time[0]) * steps / (steps - 1)) if len(self) and steps > 1 else 0.0

    def squared_errors(self, name: str = FORECAST) -> Array:
        """(W, m) mean squared error of the forecast ``name`` in each window; infinite where there is none."""
        with np.errstate(over="ignore", invalid="ignore"):
            squares = ((self.measured - self.forecasts[name]) ** 2).mean(axis=1)
        return np.where(np.isnan(squares), np.inf, squares)

    def rmse(self, name: str = FORECAST) -> Array:
        """(m,) root mean squared error of the forecast ``name`` over all windows, in the units of the outputs."""
        return np.asarray(np.sqrt(self.squared_errors(name).mean(axis=0)))

    def error_ratio(self, name: str = FORECAST) -> float:
        """Mean squared error of the forecast ``name`` over that of the constant mean, all windows together."""
        ours, theirs = (self._sizes(each).mean() for each in (name, CONSTANT_MEAN))
        return float(error_over(ours, theirs))

    def error_ratios(self, name: str = FORECAST, baseline: str = CONSTANT_MEAN) -> Array:
        """(W,) mean squared error of the forecast ``name`` over that of the ``baseline``, in each window alone."""
        return error_over(self._sizes(name), self._sizes(baseline))

    def _sizes(self, name: str) -> Array:
        """(W,) squared errors summed over outputs, each in units of its training variance."""
        return np.asarray((self.squared_errors(name) / self.variance).sum(axis=1))

    @property
    def best_baseline(self) -> str:
        """The baseline with the lower error over all windows."""
        return min(BASELINES, key=self.error_ratio)

    @property
    def coverage(self) -> float:
        """Share of the samples that were forecast, of all outputs, that lie inside the 90 % band; 0 if none was."""
        forecast = self.forecasts[FORECAST]
        made = ~(np.isnan(forecast) & np.isnan(self.band))
        with np.errstate(invalid="ignore"):
            return float((np.abs(self.measured - forecast) <= self.band)[made].mean()) if made.any() else 0.0

    @property
    def over_expected(self) -> float:
        """Mean squared error over the one to expect, each output in units of its training variance."""
        expected = (self.expected / self.variance).sum(axis=-1).mean()
        return float(error_over(self._sizes(FORECAST).mean(), expected))

    def as_dict(self) -> dict[str, Any]:
        """The figures as plain JSON values: without the series."""
        ratios = self.error_ratios()
        return {
            "windows": len(self),
            "seconds": self.seconds,
            "start": self.time[:, 0].tolist(),
            "rmse": {name: self.rmse(name).tolist() for name in self.forecasts},
            "error_ratio": {name: self.error_ratio(name) for name in self.forecasts},
            "error_ratios": ratios.tolist(),
            "median_error_ratio": float(np.median(ratios)),
            "error_ratio_quartiles": np.percentile(ratios, [25, 75]).tolist(),
            "share_worse_than_constant_mean": float((ratios > 1).mean()),
            "share_worse_than_hold_last": float((self.error_ratios(baseline=HOLD_LAST) > 1).mean()),
            "inside_90_percent_band": self.coverage,
            "over_expected_error": self.over_expected,
            "failures": list(self.failures),
        }


def held_out_windows(
    flights: Sequence[Flight],
    settings: Settings | None = None,
    steps: int | None = None,
    progress: Callable[[float], None] = lambda _: None,
    start: Learned | None = None,
) -> HeldOut:
    """Forecasts of all of some flights, by five models that are each trained on four fifths of the samples.

    Every window follows samples that only the filter sees: those before it in its flight, or at the beginning of a
    flight, its first 1.5 s or more, which are in no window.

    Args:
        flights: segments of one vehicle, sampled alike.
        settings: of the fits; ``Settings()`` unless given.
        steps: samples of a window; those of 1.5 s unless given.
        progress: called with the share of the work that is done.
        start: a model of all the flights, at whose estimates the five fits begin: they take half the time.

    Raises:
        ValueError: too little flight for a window in any part.
    """
    steps = samples_in(TEST_SECONDS, flights[0].dt) if steps is None else steps
    found: list[HeldOut] = []
    for fold in range(FOLDS):
        inside, outside = _split(flights, fold)
        found += _of_fold(inside, outside, settings, steps, start)
        progress((fold + 1) / FOLDS)
    if not found:
        raise ValueError(f"no held-out window of {steps} samples fits into a part of these flights")
    return _together(found)


def held_out_test(train: Flight, test: Flight, learned: Learned) -> HeldOut:
    """The one window ``test``, right after the training data ``train`` of the model ``learned``: the paper's protocol.

    Raises:
        ValueError: samples of other widths than the model's.
    """
    return _forecast(learned, test, len(test), 0, train.outputs[-1:])


def _split(flights: Sequence[Flight], fold: int) -> tuple[list[Piece], list[Piece]]:
    """The pieces inside a fold, a contiguous part of all samples, and those outside it."""
    total = sum(map(len, flights))
    begin, end = (total * place // FOLDS for place in (fold, fold + 1))
    inside, outside, first = [], [], 0
    for flight in flights:
        cuts = [0, *(min(max(place - first, 0), len(flight)) for place in (begin, end)), len(flight)]
        before, within, after = (Piece(flight, *cut) for cut in zip(cuts, cuts[1:], strict=False))
        inside.append(within)
        outside += [before, after]
        first += len(flight)
    least = MIN_PIECE_SECONDS / flights[0].dt
    return [piece for piece in inside if piece.stop > piece.start], [
        piece for piece in outside if piece.stop - piece.start >= least
    ]


def _of_fold(
    inside: list[Piece], outside: list[Piece], settings: Settings | None, steps: int, begin: Learned | None
) -> Iterator[HeldOut]:
    """The windows of each piece inside a fold, by a model of those outside."""
    training = [piece.flight[piece.start : piece.stop] for piece in outside]
    learned: Learned | None = None
    failure: tuple[str, ...] = ()
    try:
        learned = learn(training, settings, begin)
    except ValueError as error:
        failure = (str(error),)
    for flight, start, stop in inside:
        # The filter finds its state in whole windows before the first that counts.
        lead = steps * ceil(samples_in(TEST_SECONDS, flight.dt) / steps)
        first = max(start, lead)
        windows = (stop - first) // steps
        if windows < 1:
            continue
        part = flight[first - lead : first + windows * steps]
        if learned is None:
            yield _lost(training, part, steps, lead, failure)
        else:
            yield _forecast(learned, part, steps, lead, flight.outputs[:1])


def _forecast(learned: Learned, part: Flight, steps: int, lead: int, before: Array) -> HeldOut:
    """Windows of ``steps`` samples after the first ``lead`` of a part, which follows the sample ``before`` (1, m)."""
    inputs, outputs = part.inputs, part.outputs
    last = np.concatenate([before, outputs])[lead : len(outputs) : steps]
    forecast = learned.forecast_every_with_band(steps, inputs, outputs, LEVEL)
    with np.errstate(over="ignore", invalid="ignore"):
        prediction = learned.predict_every(steps, inputs, outputs)

    def windows(values: Array) -> Array:
        return values[lead:].reshape(-1, steps, *values.shape[1:])

    shape = windows(outputs).shape
    return HeldOut(
        windows(part.time),
        windows(outputs),
        {
            FORECAST: windows(forecast.mean),
            PREDICTION: windows(prediction),
            **_baselines(learned.record.outputs, last, shape),
        },
        windows(forecast.half_width),
        windows(forecast.variance),
        learned.record.outputs.var(axis=0),
    )


def _lost(training: list[Flight], part: Flight, steps: int, lead: int, failures: tuple[str, ...]) -> HeldOut:
    """Windows after the first ``lead`` samples of a part that no model forecasts, beside the baselines."""
    measured = part.outputs[lead:].reshape(-1, steps, part.outputs.shape[1])
    trained = np.concatenate([flight.outputs for flight in training or [part]])
    missing = np.full_like(measured, np.nan)
    baselines = _baselines(trained, part.outputs[lead - 1 : -1 : steps], measured.shape)
    time = part.time[lead:].reshape(-1, steps)
    forecasts = {FORECAST: missing, PREDICTION: missing, **baselines}
    return HeldOut(time, measured, forecasts, missing, missing, trained.var(axis=0), failures)


def _baselines(trained: Array, last: Array, shape: tuple[int, ...]) -> dict[str, Array]:
    """Of windows of a ``shape`` (W, H, m): the mean of what was trained on, and the sample before each, ``last``."""
    return {
        CONSTANT_MEAN: np.broadcast_to(trained.mean(axis=0), shape),
        HOLD_LAST: np.broadcast_to(last[:, None], shape),
    }


def _together(parts: Sequence[HeldOut]) -> HeldOut:
    """All windows of several parts in the order of time; the variance is the mean of the parts'."""
    order = np.argsort(np.concatenate([part.time[:, 0] for part in parts]), kind="stable")

    def joined(name: str) -> Array:
        return np.concatenate([getattr(part, name) for part in parts])[order]

    return HeldOut(
        joined("time"),
        joined("measured"),
        {name: np.concatenate([part.forecasts[name] for part in parts])[order] for name in parts[0].forecasts},
        joined("band"),
        joined("expected"),
        np.mean([part.variance for part in parts], axis=0),
        tuple(dict.fromkeys(failure for part in parts for failure in part.failures)),
    )
