#!/usr/bin/env python
"""Free energy and forecast errors of the closed-loop model (plant and controller), compared with other models.

The first table has two figures of each recorded flight.

- F̄ of angle, rate and the motors' combination over 7 s: of the closed loop (the plant in its loop) and of the joint
  VAR. Both approximate the log evidence of the same samples in the same units: rad, rad/s and the unit of the motors.
  The first 20 samples are given.
- The log density of angle and rate in the 1.5 s after them, which no model was trained on, each sample given the motors
  up to it and all samples before it. DEM's plant has one too. The errors' covariance is taken from the training data.

The second table has the squared error of forecasts that start anew at every k-th sample, relative to the error of joint
VAR(10), motors known, or joint VAR(4), motors unknown: geometric means over flights. Half A are the flights whose name
has an even hash.

With --margins there is a third one: crossover and margins of the rate loop with the autopilot's gains, marginals of the
closed loop's posterior from these 7 s, with their 90 % intervals.

Usage: tools/bench/free_energies.py [--window I] [--flight TEXT] [--margins]
"""

import sys
import zlib
from collections.abc import Sequence
from typing import NamedTuple

import click
import numpy as np
import scipy.stats

from mavdem import baselines, learn
from mavdem.arrays import Array
from mavdem.baselines import ClosedLoop
from mavdem.dem import Learned
from mavdem.dem.forecast.joint import LAG_CANDIDATES
from mavdem.evaluate import Method, Window, windows
from mavdem.experiments.outcomes import evaluate_model
from mavdem.experiments.paper.flights import DATA_FOLDER, recorded_flights
from mavdem.experiments.scores import KNOWN_INPUTS, UNKNOWN_INPUTS, ForecastKind
from mavdem.forecaster import Forecaster
from mavdem.report.blocks import Table, markdown

GIVEN_SAMPLES = max(LAG_CANDIDATES)
"""First samples of the training data that every model takes as given: the past of the joint VAR with most lags."""

STEPS = {KNOWN_INPUTS: (10, 25, 50, 150), UNKNOWN_INPUTS: (1, 5, 10, 25, 50)}
"""Numbers of samples from one forecast to the next, by what the forecasts are given."""

DEM_PLANT = "DEM's plant"
"""DEM's model with the motors as causes."""

MODELS = ("closed loop", "DEM's joint model")
"""Models whose forecasts the second table compares with the forecasts of joint VARs."""


class FlightFigures(NamedTuple):
    """Free energies and errors of the models that were trained on one window of a flight."""

    flight: str
    """Name of the flight."""
    gains_known: bool
    """Whether the closed loop had the gains of the autopilot's parameters."""
    free_energies: dict[str, float]
    """F̄ of the training part by model, nats."""
    log_densities: dict[str, float]
    """Mean log density of the outputs of a sample of the test part by model, nats."""
    error_ratios: dict[tuple[str, ForecastKind, int], float]
    """Squared error over the joint VAR's, by model, kind of forecast and number of steps."""
    closed_loop: ClosedLoop
    """The closed loop."""

    @property
    def half(self) -> str:
        """Half of the flights that this one belongs to, "A" or "B"."""
        return "AB"[zlib.crc32(self.flight.encode()) % 2]


def held_out_log_density(one_step: Array, forecast: Array, window: Window) -> float:
    """Returns the mean log density of the held-out samples under a normal distribution of one-step prediction errors.

    The covariance of the distribution is the errors' in the training samples.

    Args:
        one_step: (T, 2) one-step predictions of the T training samples: angle, rad, and rate, rad/s.
        forecast: (H, 2) one-step predictions of the H held-out samples after them.
        window: the window, with its training samples and its held-out samples.

    Returns:
        Log density per sample, nats.
    """
    training_errors = (window.train.outputs - one_step)[GIVEN_SAMPLES:]
    covariance = training_errors.T @ training_errors / len(training_errors)
    errors = window.test.outputs - forecast
    # Squared Mahalanobis distance of each sample, eᵀ C⁻¹ e.
    squared_distances = np.sum(errors @ np.linalg.inv(covariance) * errors, axis=1)
    _, log_determinant = np.linalg.slogdet(2 * np.pi * covariance)
    return float(-0.5 * (log_determinant + squared_distances.mean()))


def flight_figures(window: Window) -> FlightFigures:
    """Trains all models on a window, and returns their free energies and errors.

    Args:
        window: the window.

    Returns:
        Free energies, nats, log densities per held-out sample, nats, and squared errors relative to a joint VAR's.

    Raises:
        ValueError: the closed loop cannot be learned.
    """
    closed_loop = baselines.closed_loop(window.train)
    learned = learn(window.train)
    return FlightFigures(
        flight=window.flight,
        gains_known=closed_loop.gains_known,
        free_energies=_free_energies(closed_loop, learned),
        log_densities=_log_densities(closed_loop, learned, window),
        error_ratios=_error_ratios(closed_loop, learned, window),
        closed_loop=closed_loop,
    )


def _free_energies(closed_loop: ClosedLoop, learned: Learned) -> dict[str, float]:
    """Returns the free energies F̄ of the closed loop and of the joint VAR, both in the units of the measured signals.

    Args:
        closed_loop: the plant with its controller, learned from T training samples.
        learned: DEM's models of the same samples, among them the joint VAR of outputs and inputs.

    Returns:
        F̄, nats, by model, of the samples after the first ``GIVEN_SAMPLES``.
    """
    closed_loop_terms = closed_loop.free_energy
    log_likelihood = closed_loop_terms.log_densities[GIVEN_SAMPLES:].sum()
    joint = learned.joint
    # The joint VAR is learned from signals divided by their standard deviations. Its log density of the signals
    # themselves is less by the logarithm of these divisors at every sample.
    predicted_samples = len(learned.record) - GIVEN_SAMPLES
    log_divisors = np.log(joint.process.scaling.scale).sum()
    return {
        "closed loop": log_likelihood - closed_loop_terms.complexity,
        "joint VAR": sum(joint.terms.values()) - predicted_samples * log_divisors,
    }


def _log_densities(closed_loop: ClosedLoop, learned: Learned, window: Window) -> dict[str, float]:
    """Returns the log densities of the held-out samples by model, each sample predicted from all samples before it.

    Args:
        closed_loop: the plant with its controller, trained on the window's training samples.
        learned: DEM's plant and the joint VAR, trained on the same samples.
        window: training samples of a flight, and the held-out samples after them.

    Returns:
        Mean log density per held-out sample, nats, by model.
    """
    test = window.test
    plant = learned.plant
    plant_forecast = plant.rolling_forecast_known_inputs(1, test.inputs, test.outputs)
    plant_training_predictions = plant.one_step_predictions(learned.record)
    log_densities = {
        DEM_PLANT: held_out_log_density(plant_training_predictions, plant_forecast.mean, window)
    }
    models: dict[str, Forecaster] = {"closed loop": closed_loop, "joint VAR": learned}
    for name, model in models.items():
        # A forecast that starts anew at every sample is a one-step prediction.
        forecast = model.forecast_every(1, test.inputs, test.outputs)
        log_densities[name] = held_out_log_density(model.one_step(), forecast, window)
    return log_densities


def _error_ratios(
    closed_loop: ClosedLoop, learned: Learned, window: Window
) -> dict[tuple[str, ForecastKind, int], float]:
    """Returns the squared errors of forecasts of the held-out samples, relative to those of a joint VAR.

    Args:
        closed_loop: the plant with its controller, trained on the window's training samples.
        learned: DEM's joint model, trained on the same samples.
        window: training samples of a flight, and the held-out samples after them.

    Returns:
        Ratios by name of the model, kind of forecast, and number of samples from one forecast to the next.
    """
    # Least-squares VARs of outputs and inputs, of ten lags where the motors are known and four where they are not.
    reference_models = {
        KNOWN_INPUTS: baselines.var(window.train, 10),
        UNKNOWN_INPUTS: baselines.var(window.train, 4),
    }
    models: dict[str, Forecaster] = {"closed loop": closed_loop, "DEM's joint model": learned}
    ratios = {}
    for kind, horizons in STEPS.items():
        reference_errors = _relative_errors(reference_models[kind], kind, window)
        for name, model in models.items():
            errors = _relative_errors(model, kind, window)
            for horizon in horizons:
                ratios[name, kind, horizon] = errors[horizon] / reference_errors[horizon]
    return ratios


def _relative_errors(model: Forecaster, kind: ForecastKind, window: Window) -> dict[int, float]:
    """Returns the squared errors of a trained model's forecasts of the held-out samples, relative to a constant's.

    The held-out samples are forecast piece by piece. Each piece has as many samples as the horizon, and is forecast
    from the measurements before it.

    Args:
        model: a model that was trained on the window's training samples.
        kind: whether the inputs (the motors) of a piece are known to its forecast.
        window: training samples of a flight, and the held-out samples after them.

    Returns:
        By horizon in samples: mean squared error over that of a constant forecast, the mean of the training samples.
    """
    # The evaluation is written for methods, which learn a model. Of this one it uses only that its models can forecast
    # without known inputs too (``predicts``): the model is trained already.
    method = Method(name="trained", learn=learn, predicts=True)
    scores_by_kind, _ = evaluate_model(method, window, model)
    scores = scores_by_kind[kind]
    relative_errors = {}
    for horizon, error_ratio in zip(scores.steps, scores.ratio, strict=True):
        relative_errors[horizon] = float(error_ratio)
    return relative_errors


def free_energy_table(figures: list[FlightFigures]) -> Table:
    """Returns the first table, with a row for each flight: free energies, nats, and log densities of held-out samples.

    Args:
        figures: results of the models on each flight.
    """
    columns = [
        "flight",
        "gains",
        "F̄ closed loop",
        "F̄ joint VAR",
        "held out: closed loop",
        "joint VAR",
        "DEM's plant",
    ]
    rows = []
    for flight in figures:
        rows.append(
            [
                flight.flight,
                "known" if flight.gains_known else "unknown",
                f"{flight.free_energies['closed loop']:.0f}",
                f"{flight.free_energies['joint VAR']:.0f}",
                f"{flight.log_densities['closed loop']:.2f}",
                f"{flight.log_densities['joint VAR']:.2f}",
                f"{flight.log_densities[DEM_PLANT]:.2f}",
            ]
        )
    return Table(columns, rows)


def forecast_table(figures: list[FlightFigures]) -> Table:
    """Returns the second table: squared forecast errors of each model relative to a joint VAR's.

    Args:
        figures: results of the models on each flight.

    Returns:
        A row for each model and each half of the flights ("A" and "B"), and one for all of them; a column for each kind
        of forecast and number of samples from one forecast to the next. Cells are geometric means over the flights:
        below 1 the model has smaller errors than the joint VAR (a vector autoregression of outputs and inputs).
    """
    columns = ["model", "flights"]
    for kind, step_counts in STEPS.items():
        columns += [f"{kind}, {step_count}" for step_count in step_counts]
    rows = []
    for model in MODELS:
        for half in ("A", "B", "all"):
            flights = [flight for flight in figures if half in ("all", flight.half)]
            if not flights:
                continue
            rows.append([model, f"{half} ({len(flights)})", *_mean_error_ratios(model, flights)])
    return Table(columns, rows)


def _mean_error_ratios(model: str, flights: Sequence[FlightFigures]) -> list[str]:
    """Returns the geometric means, over some flights, of a model's squared forecast errors relative to a joint VAR's.

    Args:
        model: name of the model, one of ``MODELS``.
        flights: results of the models on each flight.

    Returns:
        A text for each kind of forecast and number of samples from one forecast to the next, in the order of ``STEPS``.
    """
    texts = []
    for kind, step_counts in STEPS.items():
        for step_count in step_counts:
            ratios = [flight.error_ratios[model, kind, step_count] for flight in flights]
            texts.append(f"{scipy.stats.gmean(ratios):.2f}")
    return texts


def margin_table(figures: list[FlightFigures]) -> Table:
    """Returns the third table: the margins of the rate loop, with a row for each flight whose gains are known.

    Args:
        figures: results of the models on each flight.

    Returns:
        The table; margins have their 90 % intervals in parentheses.
    """
    columns = ["flight", "crossover", "phase margin", "gain margin", "Ms"]
    rows = []
    for flight in figures:
        if not flight.gains_known:
            continue
        loop = flight.closed_loop.rate_loop()
        low_phase, high_phase = loop.phase_margin_interval
        low_gain, high_gain = loop.gain_margin_interval
        rows.append(
            [
                flight.flight,
                f"{loop.crossover:.1f} Hz",
                f"{loop.phase_margin:.0f}° ({low_phase:.0f} to {high_phase:.0f})",
                f"{loop.gain_margin:.1f} dB ({low_gain:.1f} to {high_gain:.1f})",
                f"{loop.ms:.2f}",
            ]
        )
    return Table(columns, rows)


@click.command(help=__doc__)
@click.option("--window", "window_index", default=0, help="Which window of each flight, from 0.")
@click.option(
    "--flight", "name_part", default="", help="Only flights whose name contains this text."
)
@click.option("--margins", "with_margins", is_flag=True, help="Also margins of the rate loop.")
def main(window_index: int, name_part: str, with_margins: bool) -> None:
    """Trains the closed loop, DEM and joint VARs on a window of each recorded flight, and prints tables of errors.

    Args:
        window_index: which window of each flight, from 0; the last one where a flight has fewer.
        name_part: text in the names of the flights; all flights if it is empty.
        with_margins: whether to print stability margins of the rate loops, too.
    """
    figures = []
    for name, flight in recorded_flights():
        if name_part not in name:
            continue
        flight_windows = windows(name, flight)
        window = flight_windows[min(window_index, len(flight_windows) - 1)]
        try:
            figures.append(flight_figures(window))
        except ValueError as error:
            print(f"{name}: {error}", file=sys.stderr)
            continue
        print(markdown([free_energy_table(figures[-1:])]), file=sys.stderr, flush=True)
    if not figures:
        sys.exit(
            f"There are no such flights in {DATA_FOLDER}; MAVDEM_SHARED_DATA names their folder."
        )
    tables = [free_energy_table(figures), forecast_table(figures)]
    if with_margins:
        tables.append(margin_table(figures))
    print(markdown(tables))


if __name__ == "__main__":
    main()
