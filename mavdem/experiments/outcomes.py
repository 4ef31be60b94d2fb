"""Outcome of one method on one window: its model, or why there is none, and the errors of its forecasts."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from math import isnan
from time import perf_counter, thread_time

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import JsonValues
from mavdem.errors import fact_from_error
from mavdem.experiments.compared_methods import Method
from mavdem.experiments.scores import (
    FROM_STATE_ZERO,
    KNOWN_INPUTS,
    UNKNOWN_INPUTS,
    ForecastKind,
    Scores,
    baseline_errors,
    horizons,
    mspe,
)
from mavdem.experiments.window import Window
from mavdem.facts import Fact
from mavdem.flight import Flight
from mavdem.forecaster import Forecaster, ProbabilisticForecaster

ROUNDED_SECONDS = 4
"""Decimals of the processor time in documents."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """The forecasts of one method on one window, with their errors; all errors are infinite where it failed."""

    method: str
    """Name of the method."""

    flight: str
    """Name of the flight."""

    start: int
    """Index of the window's first sample in the flight."""

    failure: Fact | None
    """Reason why there is no forecast; ``None`` where there is one."""

    stable: bool | None
    """Whether the model is stable; ``None`` without a model."""

    cautions: tuple[Fact | str, ...]
    """Known limits of the model."""

    seconds: float
    """Processor time of the training, s."""

    elapsed_seconds: float
    """Time that training and forecasts took, s, waiting for a processor included."""

    scores: Mapping[ForecastKind, Scores]
    """Errors by kind of forecast, that is, by the data that it may use."""

    forecasts: Mapping[ForecastKind, Array]
    """Forecast outputs of the whole test part, H samples of m outputs (H, m), by kind of forecast."""

    def mspe(self, kind: ForecastKind = KNOWN_INPUTS) -> Array:
        """Returns the mean squared prediction error of each output over the whole test part.

        Args:
            kind: kind of forecast, by the data that it may use.

        Returns:
            Errors (m,), in the squares of the outputs' units.
        """
        return self.scores[kind].squared_error[-1]

    def to_dict(self, kind: ForecastKind = KNOWN_INPUTS) -> JsonValues:
        """Returns the values of this outcome for a document, without the forecasts themselves.

        Args:
            kind: kind of forecast, by the data that it may use.

        Returns:
            Values by key. ``failure``, ``stable``, ``cautions`` and ``seconds`` are as in this class. ``mspe`` has the
            mean squared errors over the whole test part, by output and in total. Two lists have a value for each
            horizon: ``relative``, the error over the constant mean's, and ``inside_90_percent_band``, the share
            of samples inside the band, ``None`` without a band.
        """
        errors = self.mspe(kind)
        scores = self.scores[kind]
        # JSON cannot state NaN, the share without a band.
        shares_inside_band = []
        for share in scores.inside.tolist():
            shares_inside_band.append(None if isnan(share) else share)
        return {
            "failure": self.failure,
            "stable": self.stable,
            "cautions": self.cautions,
            "mspe": {"per_output": errors, "total": errors.sum()},
            "relative": scores.ratio,
            "inside_90_percent_band": shares_inside_band,
            "seconds": round(self.seconds, ROUNDED_SECONDS),
        }


def evaluate_window(method: Method, window: Window) -> Outcome:
    """Trains a method on the training part of a window and forecasts the test part.

    A method that fails on a window must not end the comparison. The outcome then has the reason, and infinite errors,
    so that a failure counts as the worst forecast.

    Args:
        method: the method.
        window: the window, with its training part and its test part.

    Returns:
        Errors and forecasts of the test part, whether the model is stable, and the processor time of training, s.
    """
    start_time = perf_counter()
    start_of_training = thread_time()
    # Overflow shows in the errors or the failure of the outcome, so that warnings would only repeat it.
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            model = method.learn(window.train)
            training_seconds = thread_time() - start_of_training
            scores, forecasts = evaluate_model(method, window, model)
            return Outcome(
                method.name,
                window.flight,
                window.start,
                failure=None,
                stable=model.stable,
                cautions=model.cautions,
                seconds=training_seconds,
                elapsed_seconds=perf_counter() - start_time,
                scores=scores,
                forecasts=forecasts,
            )
        except (ValueError, ArithmeticError, RuntimeError) as error:
            failure = fact_from_error(error)
    return Outcome(
        method.name,
        window.flight,
        window.start,
        failure=failure,
        stable=None,
        cautions=(),
        seconds=thread_time() - start_of_training,
        elapsed_seconds=perf_counter() - start_time,
        scores=infinite_scores(method, window),
        forecasts={},
    )


def infinite_scores(method: Method, window: Window) -> dict[ForecastKind, Scores]:
    """Returns the scores of a method that made no forecast: infinite errors at every horizon.

    Args:
        method: the method. If it can forecast without the inputs (``predicts``), it gets scores for that kind too.
        window: the window, whose test part gives horizons and number of outputs.

    Returns:
        Scores by kind of forecast, of the same shapes as for a method that succeeds.
    """
    test = window.test
    output_count = test.outputs.shape[1]
    kinds = [KNOWN_INPUTS, FROM_STATE_ZERO]
    if method.predicts:
        kinds.append(UNKNOWN_INPUTS)
    scores = {}
    for kind in kinds:
        steps = horizons_of_kind(kind, test)
        scores[kind] = Scores(
            steps,
            squared_error=np.full((len(steps), output_count), np.inf),
            inside=np.full(len(steps), np.nan),
            # The ratio is infinite in any unit.
            variance=np.ones(output_count),
            baseline=np.ones(output_count),
        )
    return scores


def horizons_of_kind(kind: ForecastKind, test: Flight) -> tuple[int, ...]:
    """Returns the horizons, in steps, at which the forecasts of one kind are evaluated.

    A forecast from state 0 has only the horizon of the whole test part, because it is not renewed from the data.

    Args:
        kind: kind of forecast, by the data that it may use.
        test: the test part.

    Returns:
        Numbers of steps.
    """
    return (len(test),) if kind == FROM_STATE_ZERO else horizons(len(test), test.dt)


def evaluate_model(
    method: Method, window: Window, model: Forecaster
) -> tuple[dict[ForecastKind, Scores], dict[ForecastKind, Array]]:
    """Forecasts the test part of a window (H samples, m outputs) at several horizons, and scores the forecasts.

    A model makes up to three kinds of forecasts: with known inputs, with known inputs from state 0, and, if it can,
    without the inputs. For each horizon of h steps the test part is forecast in pieces of h samples, each from the
    filtered state at its start; the last horizon is the test part as one piece.

    Args:
        method: the method, which states whether its models can forecast without the inputs.
        window: the window, on whose training part the model was trained.
        model: the model. If it estimates its own errors, the share of samples in its 90 % band is scored as well.

    Returns:
        Scores, and forecasts (H, m) of the whole test part, both by kind of forecast.
    """
    test = window.test
    forecasts = {
        KNOWN_INPUTS: model.forecast(test.inputs),
        FROM_STATE_ZERO: model.forecast(test.inputs, from_zero=True),
    }
    bands = {}
    if method.predicts:
        forecasts[UNKNOWN_INPUTS] = model.predict(len(test))
    if isinstance(model, ProbabilisticForecaster):
        bands[KNOWN_INPUTS] = model.forecast_band(test.inputs)
        if method.predicts:
            bands[UNKNOWN_INPUTS] = model.predict_band(len(test))
    baseline = baseline_errors(window.train, test)
    scores = {}
    for kind, forecast in forecasts.items():
        steps = horizons_of_kind(kind, test)
        forecast_every = model.predict_every if kind == UNKNOWN_INPUTS else model.forecast_every
        errors = []
        # The forecast at the last horizon, the whole test part, is already made.
        for horizon in steps[:-1]:
            rolling_forecast = forecast_every(horizon, test.inputs, test.outputs)
            errors.append(mspe(test.outputs, rolling_forecast).per_output)
        errors.append(mspe(test.outputs, forecast).per_output)
        inside_shares = np.full(len(steps), np.nan)
        if kind in bands:
            is_inside = abs(test.outputs - forecast) <= bands[kind]
            inside_shares = np.array([is_inside[:horizon].mean() for horizon in steps])
        scores[kind] = Scores(
            steps,
            squared_error=np.array(errors),
            inside=inside_shares,
            variance=baseline.variance,
            baseline=baseline.constant_mean,
        )
    return scores, forecasts


def run_trial(trial: tuple[Method, Window]) -> Outcome:
    """Runs :func:`evaluate_window` on a pair of method and window, in a worker process."""
    return evaluate_window(*trial)
