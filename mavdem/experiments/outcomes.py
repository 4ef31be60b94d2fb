"""Outcome of one method on one window: its model, or why there is none, and the errors of its forecasts."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from math import isnan
from time import thread_time

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import JsonValues
from mavdem.errors import fact_from_error
from mavdem.experiments.compared_methods import Method
from mavdem.experiments.scores import (
    FROM_ZERO,
    KNOWN,
    UNKNOWN,
    Question,
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

    scores: Mapping[Question, Scores]
    """Errors by question: by what the forecast was given."""

    forecasts: Mapping[Question, Array]
    """Forecast outputs of the whole test part, H samples of m outputs (H, m), by question."""

    def mspe(self, question: Question = KNOWN) -> Array:
        """Returns the mean squared prediction error of each output over the whole test part.

        Args:
            question: kind of forecast: which data it may use.

        Returns:
            Errors (m,), in the squares of the outputs' units.
        """
        return self.scores[question].squared_error[-1]

    def to_dict(self, question: Question = KNOWN) -> JsonValues:
        """Returns the values of this outcome for a document, without the forecasts themselves.

        Args:
            question: kind of forecast: which data it may use.

        Returns:
            Values by key. ``failure``, ``stable``, ``cautions`` and ``seconds`` are as in this class. ``mspe`` has the
            mean squared errors over the whole test part, by output and in total. Two lists have a value for each
            horizon: ``relative``, the error over that of the constant mean, and ``inside_90_percent_band``, the share
            of samples inside the band, ``None`` without a band.
        """
        errors = self.mspe(question)
        scores = self.scores[question]
        return {
            "failure": self.failure,
            "stable": self.stable,
            "cautions": self.cautions,
            "mspe": {"per_output": errors, "total": errors.sum()},
            "relative": scores.ratio,
            # JSON cannot state NaN, the share without a band.
            "inside_90_percent_band": [
                None if isnan(share) else share for share in scores.inside.tolist()
            ],
            "seconds": round(self.seconds, ROUNDED_SECONDS),
        }


def evaluate_window(method: Method, window: Window) -> Outcome:
    """Trains a method on the first part of a window and forecasts the second.

    A method that fails on a window must not end the comparison. The outcome then has the reason, and infinite errors,
    so that a failure counts as the worst forecast.

    Args:
        method: the method.
        window: the window, with its training part and its test part.

    Returns:
        Errors and forecasts of the test part, whether the model is stable, and the processor time of training, s.
    """
    begin = thread_time()
    # Overflow shows in the errors or the failure of the outcome, so that warnings would only repeat it.
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            model = method.learn(window.train)
            seconds = thread_time() - begin
            scores, forecasts = evaluate_model(method, window, model)
            return Outcome(
                method.name,
                window.flight,
                window.start,
                failure=None,
                stable=model.stable,
                cautions=model.cautions,
                seconds=seconds,
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
        seconds=thread_time() - begin,
        scores=infinite_scores(method, window),
        forecasts={},
    )


def infinite_scores(method: Method, window: Window) -> dict[Question, Scores]:
    """Returns the scores of a method that made no forecast: infinite errors at every horizon.

    Args:
        method: the method; one that predicts has scores without the inputs too.
        window: the window, whose test part gives horizons and number of outputs.

    Returns:
        Scores by question, of the same shapes as those of a forecast.
    """
    test = window.test
    output_count = test.outputs.shape[1]
    questions = [KNOWN, FROM_ZERO]
    if method.predicts:
        questions.append(UNKNOWN)
    scores = {}
    for question in questions:
        steps = question_horizons(question, test)
        scores[question] = Scores(
            steps,
            squared_error=np.full((len(steps), output_count), np.inf),
            inside=np.full(len(steps), np.nan),
            # The ratio is infinite in any unit.
            variance=np.ones(output_count),
            baseline=np.ones(output_count),
        )
    return scores


def question_horizons(question: Question, test: Flight) -> tuple[int, ...]:
    """Returns the horizons, in steps, at which the forecasts of one question are evaluated.

    A forecast from state 0 has only the horizon of the whole test part, because it is not renewed from the data.

    Args:
        question: the kind of forecast: what data it may use.
        test: the test part.

    Returns:
        Numbers of steps.
    """
    return (len(test),) if question == FROM_ZERO else horizons(len(test), test.dt)


def evaluate_model(
    method: Method, window: Window, model: Forecaster
) -> tuple[dict[Question, Scores], dict[Question, Array]]:
    """Forecasts the test part of a window (H samples, m outputs) at several horizons, and scores the forecasts.

    A model is asked up to three questions: forecasts with known inputs, with known inputs from state 0, and, if it can,
    without the inputs. For each horizon of h steps the test part is forecast in pieces of h samples, each from the
    filtered state at its start; the last horizon is the test part as one piece.

    Args:
        method: the method, which states whether its models can forecast without the inputs.
        window: the window, on whose first part the model was trained.
        model: the model. If it estimates its own errors, the share of samples in its 90 % band is scored as well.

    Returns:
        Scores, and forecasts (H, m) of the whole test part, by question.
    """
    test = window.test
    forecasts = {
        KNOWN: model.forecast(test.inputs),
        FROM_ZERO: model.forecast(test.inputs, from_zero=True),
    }
    bands = {}
    if method.predicts:
        forecasts[UNKNOWN] = model.predict(len(test))
    if isinstance(model, ProbabilisticForecaster):
        bands[KNOWN] = model.forecast_band(test.inputs)
        if method.predicts:
            bands[UNKNOWN] = model.predict_band(len(test))
    baseline = baseline_errors(window.train, test)
    scores = {}
    for question, forecast in forecasts.items():
        horizons = question_horizons(question, test)
        forecast_every = model.predict_every if question == UNKNOWN else model.forecast_every
        errors = []
        # The last horizon is the whole test part, of which the forecast is there.
        for horizon in horizons[:-1]:
            rolling_forecast = forecast_every(horizon, test.inputs, test.outputs)
            errors.append(mspe(test.outputs, rolling_forecast).per_output)
        errors.append(mspe(test.outputs, forecast).per_output)
        inside_shares = np.full(len(horizons), np.nan)
        if question in bands:
            is_inside = abs(test.outputs - forecast) <= bands[question]
            inside_shares = np.array([is_inside[:horizon].mean() for horizon in horizons])
        scores[question] = Scores(
            horizons,
            squared_error=np.array(errors),
            inside=inside_shares,
            variance=baseline.variance,
            baseline=baseline.constant_mean,
        )
    return scores, forecasts


def run_trial(trial: tuple[Method, Window]) -> Outcome:
    """Runs :func:`evaluate_window` on a pair of method and window, in a worker process."""
    return evaluate_window(*trial)
