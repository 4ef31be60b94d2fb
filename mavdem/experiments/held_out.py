"""Held-out windows: forecasts of each block of a flight by a model that was trained on the other blocks.

The settled flight is cut into contiguous blocks (blocked cross-validation). A model is trained on all blocks but one,
and forecasts that one window by window, each forecast from the state that its filter has at the window's start.

The training data adjoin each block on both sides, without a gap: the first second of a block is correlated with them.

References:
    C. Bergmeir and J. M. Benítez, "On the use of cross-validation for time series predictor evaluation", Information
    Sciences 191, 2012: blocks keep neighbouring samples, which are correlated, on the same side.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import CONFIDENCE_LEVEL
from mavdem.dem import Learned, Settings
from mavdem.dem.engine.linalg import may_overflow
from mavdem.dem.forecast.joint import JointModel
from mavdem.dem.learning import learn_forecasts
from mavdem.dem.record import FoldPiece, cross_validation_folds
from mavdem.errors import fact_from_error
from mavdem.experiments.scores import error_over
from mavdem.experiments.window import part_samples
from mavdem.facts import Fact, Facts
from mavdem.facts.forecasts import HeldOutForecast
from mavdem.facts.model import ModelName
from mavdem.flight import Flight
from mavdem.immutable import ImmutableResult

Progress = Callable[[float], None]
"""A function that is called with the share that is done, 0 to 1."""

FOLDS = 5
"""Number of blocks that the settled flight is cut into. Five are usual: each model is trained on 80 % of the data."""

MIN_PIECE_SECONDS = 1.0
"""Shortest piece of training data between two cuts, s: the derivatives at its edges are less certain. A choice."""

FORECAST, PREDICTION, CONSTANT_MEAN, HOLD_LAST = HeldOutForecast

BASELINES = CONSTANT_MEAN, HOLD_LAST
"""Trivial forecasts that a model has to beat."""


class ForecastErrors(NamedTuple):
    """The errors of one forecast, of m outputs over all windows."""

    name: HeldOutForecast
    """Name of the forecast."""
    rmse: Array
    """Root mean squared errors (m,), in the units of the outputs."""
    error_ratio: float
    """Mean squared error over the constant mean's."""


@dataclass(frozen=True, eq=False)
class HeldOut(ImmutableResult):
    """W held-out windows of H samples and m outputs, none used to train its model; angles in rad, rates in rad/s."""

    time: Array
    """Times of the samples (W, H), s on the autopilot's boot clock."""

    measured: Array
    """Measured outputs (W, H, m)."""

    forecasts: Mapping[HeldOutForecast, Array]
    """Forecast outputs (W, H, m) by name; NaN where no model could be learned.

    The names are "forecast", with the recorded motors; "prediction", without them; and the baselines "constant mean",
    of the training data, and "hold last".
    """

    band: Array
    """Half width of the 90 % band of "forecast" (W, H, m)."""

    expected: Array
    """Squared error that the model expects of "forecast" (W, H, m)."""

    variance: Array
    """Variance of each output in the training data (m,): the unit in which the errors of outputs are added up."""

    failures: Facts = ()
    """Reasons why models of blocks could not be learned."""

    model: ModelName = ModelName.JOINT_VAR
    """Model of "forecast"; "prediction" is by the joint VAR always, since A, B and C need the motors."""

    def __len__(self) -> int:
        """Returns the number of windows."""
        return len(self.time)

    @property
    def seconds(self) -> float:
        """Length of a window, s; 0 without windows, and for windows of one sample."""
        steps = self.time.shape[1]
        if not len(self) or steps < 2:
            return 0.0
        return float(np.ptp(self.time[0]) * steps / (steps - 1))

    @may_overflow
    def squared_errors(self, name: HeldOutForecast) -> Array:
        """Returns the mean squared error of one of the forecasts in each window.

        Args:
            name: name of the forecast.

        Returns:
            (W, m) errors; infinite without a forecast.
        """
        squares = ((self.measured - self.forecasts[name]) ** 2).mean(axis=1)
        return np.where(np.isnan(squares), np.inf, squares)

    def rmse(self, name: HeldOutForecast = FORECAST) -> Array:
        """Returns the root mean squared error of one of the forecasts over all windows (m,), in the outputs' units.

        Args:
            name: name of the forecast.
        """
        return np.sqrt(self.squared_errors(name).mean(axis=0))

    def error_ratio(self, name: HeldOutForecast = FORECAST) -> float:
        """Returns the mean squared error of a forecast over the error of forecasting the mean of the training data.

        Args:
            name: name of the forecast.

        Returns:
            The ratio over all windows and outputs, without a unit; below 1 the forecast is better than the mean.
        """
        error = self._total_errors(name).mean()
        return float(error_over(error, self._total_errors(CONSTANT_MEAN).mean()))

    @property
    def ranked_errors(self) -> list[ForecastErrors]:
        """The errors of all forecasts over all windows, the one with the lowest error ratio first."""
        errors = [
            ForecastErrors(name, self.rmse(name), self.error_ratio(name)) for name in self.forecasts
        ]
        return sorted(errors, key=lambda forecast: forecast.error_ratio)

    @property
    def error_ratio_quartiles(self) -> Array:
        """Quartiles (3,) of the error ratio of single windows."""
        return np.percentile(self.error_ratios(), [25, 50, 75])

    @property
    def worse_shares(self) -> dict[HeldOutForecast, float]:
        """By name of the baseline, the share of the windows in which the model's forecast has the larger error."""
        shares = {}
        for baseline in BASELINES:
            is_worse = self.error_ratios(baseline) > 1
            shares[baseline] = float(is_worse.mean())
        return shares

    def error_ratios(self, baseline: HeldOutForecast = CONSTANT_MEAN) -> Array:
        """Returns the mean squared error of the forecast in each window (W,), relative to a baseline's.

        Args:
            baseline: name of the baseline.

        Returns:
            (W,) ratios without a unit: below 1 the forecast is better than the baseline.
        """
        return error_over(self._total_errors(FORECAST), self._total_errors(baseline))

    def _total_errors(self, name: HeldOutForecast) -> Array:
        """Returns the squared error of each window (W,), summed over outputs in units of their training variances."""
        return (self.squared_errors(name) / self.variance).sum(axis=1)

    @property
    def best_baseline(self) -> HeldOutForecast:
        """The baseline with the lower error over all windows."""
        return min(BASELINES, key=self.error_ratio)

    @property
    def coverage(self) -> float:
        """Fraction of the samples inside the 90 % band of the forecast: 0.9 if the widths of the bands are right.

        All windows and outputs count. Samples without a forecast are left out; samples of a forecast that overflowed
        are outside. The fraction is 0 if nothing was forecast.
        """
        forecast = self.forecasts[FORECAST]
        # Without a forecast, because no model was learned, both the forecast and its band are NaN. A forecast that
        # overflowed to NaN still has a band.
        has_no_forecast = np.isnan(forecast) & np.isnan(self.band)
        has_forecast = ~has_no_forecast
        if not has_forecast.any():
            return 0.0
        with np.errstate(invalid="ignore"):
            is_inside_band = abs(self.measured - forecast) <= self.band
        return float(is_inside_band[has_forecast].mean())

    @property
    def ratio_to_expected_error(self) -> float:
        """Mean squared error of the forecast over the error that the model expects: 1 if its variances are right.

        Outputs have different units, so the squared errors of each one are divided by its variance in the training data
        before they are added up.
        """
        expected_error = (self.expected / self.variance).sum(axis=-1).mean()
        return float(error_over(self._total_errors(FORECAST).mean(), expected_error))


def held_out_windows(
    flights: Sequence[Flight],
    settings: Settings | None = None,
    steps: int | None = None,
    progress: Progress = lambda _: None,
) -> HeldOut:
    """Forecasts each block of some flights by a model that was not trained on it (5-fold blocked cross-validation).

    Each of five models is trained on four fifths of the samples, and forecasts the remaining fifth in windows.

    Before its first window, a model's filter needs samples to find the state. They are those before the window in its
    flight. At the beginning of a flight there are none, so the first 1.5 s or more of it are in no window.

    Args:
        flights: segments of one vehicle, sampled alike.
        settings: settings of the fits; ``Settings()`` unless given.
        steps: number of samples of a window; as many as 1.5 s have unless given.
        progress: function that is called with the share of the folds that are done, 0 to 1.

    Returns:
        All windows in the order of time, with their forecasts and the baselines' forecasts. Windows whose model could
        not be learned have NaN, and the reason is in ``failures``.

    Raises:
        ValueError: too little flight for a window in any block.
    """
    _, default_steps = part_samples(flights[0].dt)
    steps = default_steps if steps is None else steps
    # The samples before the first window, in which the filter finds its state, are whole windows of at least 1.5 s.
    lead_samples = steps * ceil(default_steps / steps)
    block_forecasts = []
    folds = cross_validation_folds([len(flight) for flight in flights], FOLDS)
    for fold_number, fold in enumerate(folds, start=1):
        training_flights = list(training_pieces(flights, fold))
        model = None
        failures = Facts()
        try:
            model = learn_forecasts(training_flights, settings)
        except ValueError as error:
            failures = (fact_from_error(error),)
        # A fold may contain samples of several flights.
        for piece in fold:
            flight = flights[piece.segment]
            first_sample = max(piece.first, lead_samples)
            window_count = (piece.stop - first_sample) // steps
            if window_count > 0:
                block = HeldOutBlock(
                    samples=flight[
                        first_sample - lead_samples : first_sample + window_count * steps
                    ],
                    lead=lead_samples,
                    steps=steps,
                    # At the beginning of a flight there is no sample before; its first one stands for it.
                    previous_output=flight.outputs[:1],
                )
                # If no training data remain, the baselines take their mean from the block itself.
                block_forecasts.append(
                    forecast_block(model, training_flights or [block.samples], block, failures)
                )
        progress(fold_number / FOLDS)
    if not block_forecasts:
        raise ValueError(f"no held-out window of {steps} samples fits into a part of these flights")
    return joined_results(block_forecasts)


def held_out_test(train: Flight, test: Flight, learned: Learned) -> HeldOut:
    """Forecasts one window that directly follows the training data, as the paper's experiments do.

    The forecast starts from the state at the end of the training data, which the model knows. So no sample of the
    window is used up to find a state, and all of them are forecast.

    Args:
        train: the training data of the model.
        test: H samples of the window; the first one follows the last of the training data.
        learned: the model that was learned from the training data.

    Returns:
        The result of the one window (W = 1): measured and forecast outputs, and the baselines.

    Raises:
        ValueError: samples have other numbers of inputs or outputs than the model.
    """
    block = HeldOutBlock(test, lead=0, steps=len(test), previous_output=train.outputs[-1:])
    return forecast_block(learned, [train], block)


def training_pieces(flights: Sequence[Flight], fold: Sequence[FoldPiece]) -> Iterator[Flight]:
    """Yields the pieces of flights outside a fold that are long enough to learn from.

    If a fold is cut out of the middle of a flight, a piece before it and one after it remain. They stay separate: a
    model must not take the step between them for motion.

    Args:
        flights: segments of one vehicle.
        fold: the samples that are held out, at most one piece of each flight.

    Yields:
        Pieces in the order of the flights, each of at least ``MIN_PIECE_SECONDS``.
    """
    held_out_pieces = {piece.segment: piece for piece in fold}
    min_samples = max(MIN_PIECE_SECONDS / flights[0].dt, 1)
    for flight_index, flight in enumerate(flights):
        flight_end = len(flight)
        # An empty piece at the end leaves the whole flight for training.
        no_piece = FoldPiece(flight_index, first=flight_end, stop=flight_end)
        held_out_piece = held_out_pieces.get(flight_index, no_piece)
        if held_out_piece.first >= min_samples:
            yield flight[: held_out_piece.first]
        if flight_end - held_out_piece.stop >= min_samples:
            yield flight[held_out_piece.stop :]


@dataclass(frozen=True, eq=False)
class HeldOutBlock:
    """Consecutive windows of a flight that a model forecasts without having seen them, with samples before them."""

    samples: Flight
    """Samples of the block: ``lead`` samples for the filter, then W windows."""

    lead: int
    """Number of samples before the first window."""

    steps: int
    """Number H of samples of a window."""

    previous_output: Array
    """Outputs of the sample before the block (1, m)."""

    def windows(self, values: Array) -> Array:
        """Cuts values of the block's samples into windows; values before the first window are left out.

        Args:
            values: (T, …) one value or row for each sample of the block: ``lead`` samples, then W windows of H samples.

        Returns:
            (W, H, …) values of each window.
        """
        shape_of_sample = values.shape[1:]
        values_in_windows = values[self.lead :]
        return values_in_windows.reshape(-1, self.steps, *shape_of_sample)

    @property
    def outputs_before_windows(self) -> Array:
        """Outputs of the sample before each window (W, m)."""
        outputs = self.samples.outputs
        previous_outputs = np.concatenate([self.previous_output, outputs])
        return previous_outputs[self.lead : len(outputs) : self.steps]


def forecast_block(
    model: JointModel | Learned | None,
    training: Sequence[Flight],
    block: HeldOutBlock,
    failures: Facts = (),
) -> HeldOut:
    """Forecasts W windows of H samples that a model was not trained on, each from the filtered state at its start.

    The forecast uses the recorded motors of its window, the prediction does not. Two trivial forecasts are made for
    comparison: the mean of the training data, and the last outputs before each window.

    Args:
        model: model that was trained without the block; ``None`` where there is none. Then only the trivial forecasts
            are made, and the others are NaN.
        training: data that the model was trained on, for its mean and its variance, the unit of errors.
        block: the windows, with the samples before them that the filter needs.
        failures: reasons why there is no model.

    Returns:
        Measured outputs, forecasts, expected squared errors and 90 % bands, all (W, H, m).
    """
    inputs = block.samples.inputs
    outputs = block.samples.outputs
    measured_outputs = block.windows(outputs)
    # Without a model these stay NaN.
    forecast = np.full_like(measured_outputs, np.nan)
    prediction = forecast
    expected_squared_errors = forecast
    band = forecast
    if model is not None:
        # The forecast of an unstable model may overflow, which is a result too.
        with np.errstate(over="ignore", invalid="ignore"):
            rolling_forecast = model.rolling_forecast_known_inputs(block.steps, inputs, outputs)
            half_widths = model.half_widths(
                rolling_forecast.variance, CONFIDENCE_LEVEL, block.steps
            )
            forecast = block.windows(rolling_forecast.mean)
            expected_squared_errors = block.windows(rolling_forecast.variance)
            band = block.windows(half_widths)
            rolling_prediction = model.rolling_forecast_unknown_inputs(block.steps, inputs, outputs)
            prediction = block.windows(rolling_prediction.mean)
    training_outputs = np.concatenate([flight.outputs for flight in training])
    last_outputs = block.outputs_before_windows
    forecasts = {
        FORECAST: forecast,
        PREDICTION: prediction,
        CONSTANT_MEAN: np.broadcast_to(training_outputs.mean(axis=0), measured_outputs.shape),
        HOLD_LAST: np.broadcast_to(last_outputs[:, None], measured_outputs.shape),
    }
    return HeldOut(
        time=block.windows(block.samples.time),
        measured=measured_outputs,
        forecasts=forecasts,
        band=band,
        expected=expected_squared_errors,
        variance=training_outputs.var(axis=0),
        failures=failures,
    )


def joined_results(results: Sequence[HeldOut]) -> HeldOut:
    """Joins the held-out windows of all folds of a cross-validation to one result, in the order of time.

    Args:
        results: results of single blocks of a flight, with the same number of samples in each window.

    Returns:
        All windows. Each fold has training data of its own, so the variance, which is the unit of errors, is the mean
        of their variances. Each reason why a window failed is contained once.
    """
    start_times = np.concatenate([block_result.time[:, 0] for block_result in results])
    windows_by_time = np.argsort(start_times, kind="stable")

    def joined(arrays: Sequence[Array]) -> Array:
        """Joins arrays with a row for each window, in the order of time."""
        return np.concatenate(arrays)[windows_by_time]

    forecasts = {}
    for name in HeldOutForecast:
        forecasts[name] = joined([block_result.forecasts[name] for block_result in results])
    failures = list[Fact]()
    for block_result in results:
        failures += block_result.failures
    return HeldOut(
        time=joined([block_result.time for block_result in results]),
        measured=joined([block_result.measured for block_result in results]),
        forecasts=forecasts,
        band=joined([block_result.band for block_result in results]),
        expected=joined([block_result.expected for block_result in results]),
        variance=np.mean([block_result.variance for block_result in results], axis=0),
        # A dictionary keeps one of equal failures, in their order.
        failures=tuple(dict.fromkeys(failures)),
    )
