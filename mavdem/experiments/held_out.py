"""Held-out windows: forecasts of every part of a flight by a model that was trained without that part.

The settled flight is cut into contiguous parts (blocked cross-validation). A model is trained on all parts but one, and
forecasts that one window by window, each forecast from the state that its filter has at the window's start.

The training data adjoin each part on both sides, without a gap: the first second of a part is correlated with them.

References:
    C. Bergmeir and J. M. Benítez, "On the use of cross-validation for time series predictor evaluation", Information
    Sciences 191, 2012: blocks keep neighbouring samples, which are correlated, on the same side.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import CONFIDENCE_LEVEL
from mavdem.dem import Learned, Settings
from mavdem.dem.engine.linalg import may_overflow
from mavdem.dem.forecast.joint import JointModel
from mavdem.dem.learning import learn_forecasts
from mavdem.dem.record import cross_validation_folds
from mavdem.errors import fact_from_error
from mavdem.experiments.scores import error_over
from mavdem.experiments.window import part_samples
from mavdem.facts import Facts
from mavdem.facts.forecasts import HeldOutForecast
from mavdem.flight import Flight
from mavdem.immutable import ImmutableResult

Progress = Callable[[float], None]
"""What is called with the share that is done."""
FOLDS = 5
MIN_PIECE_SECONDS = 1.0
"""A piece of training data between two cuts that is shorter is left out: it is mostly the edge of its embedding."""

FORECAST, PREDICTION, CONSTANT_MEAN, HOLD_LAST = HeldOutForecast
BASELINES = CONSTANT_MEAN, HOLD_LAST


@dataclass(frozen=True, eq=False)
class HeldOut(ImmutableResult):
    """W held-out windows of H samples and m outputs, none used to train its model; angles in rad, rates in rad/s.

    Attributes:
        time: (W, H) s on the autopilot's boot clock.
        measured: (W, H, m).
        forecasts: (W, H, m) by name: "forecast", with the recorded motors; "prediction", without them; and the
            baselines "constant mean", of the training data, and "hold last". NaN where no model could be learned.
        band, expected: (W, H, m) half width of the 90 % band of "forecast", and the squared error to expect of it.
        variance: (m,) of the training data: the unit in which the errors of outputs are added up.
        failures: why models of parts could not be learned.
    """

    time: Array
    measured: Array
    forecasts: Mapping[HeldOutForecast, Array]
    band: Array
    expected: Array
    variance: Array
    failures: Facts = ()

    def __len__(self) -> int:
        return len(self.time)

    @property
    def seconds(self) -> float:
        """Length of a window, s."""
        steps = self.time.shape[1]
        return float(np.ptp(self.time[0]) * steps / (steps - 1)) if len(self) and steps > 1 else 0.0

    @may_overflow
    def squared_errors(self, name: HeldOutForecast) -> Array:
        """Returns the mean squared error (W, m) of the forecast ``name`` in each window; infinite without one."""
        squares = ((self.measured - self.forecasts[name]) ** 2).mean(axis=1)
        return np.where(np.isnan(squares), np.inf, squares)

    def rmse(self, name: HeldOutForecast = FORECAST) -> Array:
        """Returns the root mean squared error (m,) of the forecast ``name`` over all windows, in the outputs' units."""
        return np.sqrt(self.squared_errors(name).mean(axis=0))

    def error_ratio(self, name: HeldOutForecast = FORECAST) -> float:
        """Returns the mean squared error of the forecast ``name`` over that of the constant mean, of all windows."""
        return float(error_over(self._sizes(name).mean(), self._sizes(CONSTANT_MEAN).mean()))

    def error_ratios(self, baseline: HeldOutForecast = CONSTANT_MEAN) -> Array:
        """Returns the mean squared error of the forecast over that of the ``baseline``, by window (W,)."""
        return error_over(self._sizes(FORECAST), self._sizes(baseline))

    def _sizes(self, name: HeldOutForecast) -> Array:
        """(W,) squared errors summed over outputs, each in units of its training variance."""
        return (self.squared_errors(name) / self.variance).sum(axis=1)

    @property
    def best_baseline(self) -> HeldOutForecast:
        """The baseline with the lower error over all windows."""
        return min(BASELINES, key=self.error_ratio)

    @property
    def coverage(self) -> float:
        """Share of the samples that were forecast, of all outputs, that lie inside the 90 % band; 0 if none was."""
        forecast = self.forecasts[FORECAST]
        made = ~(np.isnan(forecast) & np.isnan(self.band))
        with np.errstate(invalid="ignore"):
            return (
                float((abs(self.measured - forecast) <= self.band)[made].mean())
                if made.any()
                else 0.0
            )

    @property
    def over_expected(self) -> float:
        """Mean squared error over the one to expect, each output in units of its training variance."""
        expected = (self.expected / self.variance).sum(axis=-1).mean()
        return float(error_over(self._sizes(FORECAST).mean(), expected))


def held_out_windows(
    flights: Sequence[Flight],
    settings: Settings | None = None,
    steps: int | None = None,
    progress: Progress = lambda _: None,
) -> HeldOut:
    """Returns forecasts of all of some flights, by five models that are each trained on four fifths of the samples.

    Every window follows samples that only the filter sees: those before it in its flight, or at the beginning of a
    flight, its first 1.5 s or more, which are in no window.

    Args:
        flights: segments of one vehicle, sampled alike.
        settings: of the fits; ``Settings()`` unless given.
        steps: samples of a window; those of 1.5 s unless given.
        progress: called with the share done.

    Raises:
        ValueError: too little flight for a window in any part.
    """
    _, usual = part_samples(flights[0].dt)
    steps = usual if steps is None else steps
    parts = []
    for number, fold in enumerate(
        cross_validation_folds([len(flight) for flight in flights], FOLDS), start=1
    ):
        training = [*_others(flights, fold)]
        model = None
        failures = Facts()
        try:
            model = learn_forecasts(training, settings)
        except ValueError as error:
            failures = (fact_from_error(error),)
        for i, first, stop in fold:
            flight = flights[i]
            # The filter finds its state in whole windows before the first that counts.
            lead = steps * ceil(usual / steps)
            first = max(first, lead)
            count = (stop - first) // steps
            if count > 0:
                part = flight[first - lead : first + count * steps]
                parts.append(
                    _forecast(
                        model, training or [part], part, steps, lead, flight.outputs[:1], failures
                    )
                )
        progress(number / FOLDS)
    if not parts:
        raise ValueError(f"no held-out window of {steps} samples fits into a part of these flights")
    return _together(parts)


def held_out_test(train: Flight, test: Flight, learned: Learned) -> HeldOut:
    """Returns the one window ``test``, right after the training data ``train`` of ``learned``: the paper's protocol.

    Raises:
        ValueError: samples of other widths than the model's.
    """
    return _forecast(learned, [train], test, len(test), 0, train.outputs[-1:])


def _others(flights: Sequence[Flight], fold: Sequence[tuple[int, int, int]]) -> Iterator[Flight]:
    """The pieces of the flights outside a fold that are long enough to learn from."""
    inside = {i: (first, stop) for i, first, stop in fold}
    least = max(MIN_PIECE_SECONDS / flights[0].dt, 1)
    for i, flight in enumerate(flights):
        first, stop = inside.get(i, (len(flight), len(flight)))
        for begin, end in ((0, first), (stop, len(flight))):
            if end - begin >= least:
                yield flight[begin:end]


def _forecast(
    model: JointModel | Learned | None,
    training: Sequence[Flight],
    part: Flight,
    steps: int,
    lead: int,
    before: Array,
    failures: Facts = (),
) -> HeldOut:
    """Windows of ``steps`` samples after the first ``lead`` of a part, which follows the sample ``before`` (1, m).

    Without a model there are the baselines only.
    """
    inputs = part.inputs
    outputs = part.outputs

    def windows(values: Array) -> Array:
        return values[lead:].reshape(-1, steps, *values.shape[1:])

    measured = windows(outputs)
    forecast = prediction = expected = band = np.full_like(measured, np.nan)
    if model is not None:
        with np.errstate(over="ignore", invalid="ignore"):
            made = model.rolling_forecast_known_inputs(steps, inputs, outputs)
            half = model.half_widths(made.variance, CONFIDENCE_LEVEL, steps)
            forecast, expected, band = map(windows, (*made, half))
            prediction = windows(model.rolling_forecast_unknown_inputs(steps, inputs, outputs).mean)
    trained = np.concatenate([flight.outputs for flight in training])
    last = np.concatenate([before, outputs])[lead : len(outputs) : steps]
    forecasts = {
        FORECAST: forecast,
        PREDICTION: prediction,
        CONSTANT_MEAN: np.broadcast_to(trained.mean(axis=0), measured.shape),
        HOLD_LAST: np.broadcast_to(last[:, None], measured.shape),
    }
    return HeldOut(
        windows(part.time), measured, forecasts, band, expected, trained.var(axis=0), failures
    )


def _together(parts: Sequence[HeldOut]) -> HeldOut:
    """All windows of several parts in the order of time; the variance is the mean of the parts'."""
    order = np.argsort(np.concatenate([part.time[:, 0] for part in parts]), kind="stable")

    def joined(tables: Iterable[Array]) -> Array:
        return np.concatenate([*tables])[order]

    return HeldOut(
        time=joined(part.time for part in parts),
        measured=joined(part.measured for part in parts),
        forecasts={
            name: joined(part.forecasts[name] for part in parts) for name in HeldOutForecast
        },
        band=joined(part.band for part in parts),
        expected=joined(part.expected for part in parts),
        variance=np.mean([part.variance for part in parts], axis=0),
        failures=tuple(dict.fromkeys(failure for part in parts for failure in part.failures)),
    )
