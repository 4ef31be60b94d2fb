"""Bos et al. on unknown inputs: the command of one motor, estimated by DEM and by unknown input observers (UIO).

The command of motor 1 is hidden; roll, roll rate and the other three commands are known. The criterion is the sum of
squared errors (SSE) of the command over 10 s, in units of the range of all commands, without ten samples at each end.

An estimate of the input contains everything else that acts like it, such as the torque of the wind.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.experiments.paper.checks import Check, ExperimentResult
from mavdem.experiments.paper.error_tables import table_by_estimator
from mavdem.experiments.paper.estimation.dem_observer import KNOWN_INPUT_PRECISION, DemObserver
from mavdem.experiments.paper.estimation.observers import DiscreteModel, kalman_states
from mavdem.experiments.paper.estimation.roll_windows import (
    MEASUREMENT_VARIANCE,
    ROLL_SYSTEM_MATRIX,
    SIMULATED_SMOOTHNESS,
    TRIM,
    WITH_WIND,
    WITHOUT_WIND,
    RollWindow,
    flight_windows,
    missing_flights_sentence,
    simulated_window,
    wind_of_flight,
)
from mavdem.experiments.paper.runner import Runner
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.numbers import rounded

INPUT_SAMPLES = 1201
"""Samples of the one window of a flight, 10 s, as in the authors' scripts."""

UNKNOWN_INPUT = 0
"""Index of the motor whose command is hidden, as in the authors' scripts."""

UNKNOWN_INPUT_PRECISION = 1.0
"""Prior precision of the hidden command, as in the authors' scripts, in units of the range of the commands."""

UNKNOWN_INPUT_MEAN = 0.5
"""Prior mean of the hidden command, as in the authors' scripts; its true mean is 0, by their scaling.

With the prior precision above it has no effect: a prior mean of 0 changes no SSE in three digits.
"""

INPUT_STATE_PRECISION = float(np.exp(3.0))
"""Precision of the process noise of both states in DEM, as in the authors' scripts."""

UIO_INPUT_GAIN = 0.5
"""Gain γ of the input in the authors' observer: the lower bound that their scripts set for it."""

UIO_STATE_SHARE = 0.5
"""Share of an error of the state that the authors' observer corrects at each sample; a choice.

Their gain comes from an optimization without an objective, and is not published.
"""

FIRST_INPUT = 0.01
"""First value of the hidden command in the authors' observer, as in their scripts."""

INPUT_WALK_FLOOR = 1e-12
"""Smallest variance of the change of the hidden command in one sample, where the others do not change at all."""

DEM = "DEM"
DEM_ROLL_ONLY = "DEM, roll alone measured"
UIO = "UIO, the authors’ form"
MINIMUM_VARIANCE_UIO = "UIO, minimum variance"
AUGMENTED = "Kalman filter, the input as a random walk"
INPUT_MEAN = "the input’s mean"
"""Names of the estimators in tables and documents."""


class PublishedInputSse(NamedTuple):
    """SSE of the hidden command in one published flight, by Bos et al."""

    dem: float
    """Of DEM."""

    uio: float
    """Of their unknown input observer."""


PUBLISHED_INPUT_SSE = {
    "exp_21": PublishedInputSse(43.1, 41.2),
    "exp_22": PublishedInputSse(19.0, 17.3),
    "exp_24": PublishedInputSse(31.8, 29.8),
    "exp_25": PublishedInputSse(46.4, 43.4),
}
"""Heights of the bars in the authors' figure (``Figures/bar_UIO.eps`` of their repository), by experiment with blower.

The figure has no numbers; these are read from the coordinates of the file's vector graphics.
"""

MAX_SIMILAR_RATIO = 1.25
"""Ratio of two SSE, either way, up to which they count as similar; the published ones differ by 1.10 at most."""


def dem_input(window: RollWindow, measures_rate: bool = True) -> Array:
    """Estimates the command of one motor, which is hidden from the estimator, by DEM with the authors' settings.

    The states are roll and roll rate. The prior of each known command is its recorded value, with a high precision. The
    prior of the hidden command is the same at all times, with a low precision.

    Args:
        window: T samples of a roll flight, with the model of the roll axis.
        measures_rate: whether the roll rate is measured as well as the roll.

    Returns:
        (T,) estimates; NaN at both ends, where no whole embedding window lies about the sample.
    """
    outputs = measured_states(window) if measures_rate else window.outputs
    # Roll is the first state and the first output, so that the rows of the identity select what is measured.
    output_matrix = np.eye(outputs.shape[1], 2)
    input_precisions = np.full(window.inputs.shape[1], KNOWN_INPUT_PRECISION)
    input_precisions[UNKNOWN_INPUT] = UNKNOWN_INPUT_PRECISION
    prior_means = window.inputs.copy()
    prior_means[:, UNKNOWN_INPUT] = UNKNOWN_INPUT_MEAN
    observer = DemObserver(
        A=ROLL_SYSTEM_MATRIX,
        B=window.B,
        C=output_matrix,
        output_precision=1 / MEASUREMENT_VARIANCE,
        state_precisions=np.full(2, INPUT_STATE_PRECISION),
        input_precisions=input_precisions,
        dt=window.dt,
    )
    return observer.estimate(outputs, prior_means).inputs[:, UNKNOWN_INPUT]


def measured_states(window: RollWindow) -> Array:
    """Returns the measured roll and roll rate (T, 2): C is the identity, as the authors' observer requires."""
    return np.hstack([window.outputs, window.states[:, 1:]])


class HiddenCommandModel(NamedTuple):
    """Discrete model x⁺ = Φ x + Γ v + g d of the states x, with the hidden command d and the known commands v."""

    Phi: Array
    """(2, 2) state transition matrix Φ."""

    known_forcing: Array
    """(T, 2) contribution Γ v of the known commands to the next state, at each sample."""

    hidden_effect: Array
    """(2,) effect g of the hidden command on the next state."""


def hidden_command_model(window: RollWindow) -> HiddenCommandModel:
    """Returns the discrete model of a window, in which the hidden command is separated from the known ones.

    Args:
        window: T samples of states and commands.

    Returns:
        The model, with what the known commands contribute to each sample, and the effect of the hidden one.
    """
    # The discrete model of the window is x⁺ = Φ x + Γ u, with all commands u.
    Phi, Gamma = window.transition
    known_columns = np.delete(np.arange(Gamma.shape[1]), UNKNOWN_INPUT)
    known_commands = window.inputs[:, known_columns]
    return HiddenCommandModel(
        Phi,
        known_forcing=known_commands @ Gamma[:, known_columns].T,
        hidden_effect=Gamma[:, UNKNOWN_INPUT],
    )


def proportional_integral_input(window: RollWindow) -> Array:
    """Estimates the hidden command by the proportional-integral observer of the authors' scripts.

    In x⁺ = Φ x + Γ v + g d the hidden command d acts on the state x with the known effect g, and so do the known
    commands v. The observer predicts the measured states y as s + g d, where s is the predicted state without the
    effect of d. With the innovation e = y − (s + g d) it corrects both: d⁺ = d + γ gᵀ e and
    s⁺ = Φ (s + g d) + Γ v + L e, with the gains γ = ``UIO_INPUT_GAIN`` and L = ``UIO_STATE_SHARE`` Φ.

    Args:
        window: T samples of states and commands.

    Returns:
        (T,) estimates of the hidden command at each sample.
    """
    model = hidden_command_model(window)
    outputs = measured_states(window)
    state_gain = UIO_STATE_SHARE * model.Phi
    state_without_command = outputs[0]
    command = FIRST_INPUT
    commands = np.zeros(len(outputs))
    for t in range(len(outputs)):
        state = state_without_command + model.hidden_effect * command
        innovation = outputs[t] - state
        state_without_command = model.Phi @ state + model.known_forcing[t] + state_gain @ innovation
        command += UIO_INPUT_GAIN * float(model.hidden_effect @ innovation)
        commands[t] = command
    # The states of a sample show the command of the sample before, so that the estimates are moved by one sample.
    return np.append(commands[1:], commands[-1])


def minimum_variance_input(window: RollWindow) -> Array:
    """Estimates the hidden command without any prior, by the unbiased minimum-variance filter.

    The states are measured almost without noise, so the measured states y take the place of the filter's. The command d
    of a sample is the weighted least-squares solution of y⁺ − Φ y − Γ v = g d, where y⁺ are the states of the next
    sample, v the known commands and g the effect of d.

    S. Gillijns and B. De Moor, "Unbiased minimum-variance input and state estimation for linear discrete-time systems",
    Automatica 43(1), 2007.

    Args:
        window: T samples of states and commands.

    Returns:
        (T,) estimates; the last one, which has no next sample, repeats the one before.
    """
    model = hidden_command_model(window)
    outputs = measured_states(window)
    measurement_noise = MEASUREMENT_VARIANCE * np.eye(2)
    noise_variances = window.process_noise.var(axis=0, ddof=1)
    # The residuals contain the process noise, and the measurement noise of both samples.
    residual_covariance = (
        np.diag(noise_variances) + measurement_noise + model.Phi @ measurement_noise @ model.Phi.T
    )
    weights = np.linalg.solve(residual_covariance, model.hidden_effect)
    residuals = outputs[1:] - outputs[:-1] @ model.Phi.T - model.known_forcing[:-1]
    commands = residuals @ weights / float(weights @ model.hidden_effect)
    return np.append(commands, commands[-1])


def random_walk_input(window: RollWindow) -> Array:
    """Estimates the hidden command by a Kalman filter in which the command is a third state, a random walk.

    The variance of a step of the random walk is the variance of the changes of the three known commands.

    Args:
        window: T samples of states and commands.

    Returns:
        (T,) estimates.
    """
    model = hidden_command_model(window)
    known_commands = np.delete(window.inputs, UNKNOWN_INPUT, axis=1)
    step_variance = max(float(np.diff(known_commands, axis=0).var()), INPUT_WALK_FLOOR)
    Phi = np.eye(3)
    Phi[:2, :2] = model.Phi
    Phi[:2, 2] = model.hidden_effect
    Q = np.diag([*window.process_noise.var(axis=0, ddof=1), step_variance])
    # The known commands enter as their effect on the two states.
    augmented_model = DiscreteModel(
        Phi, np.eye(3, 2), np.eye(2, 3), Q, R=MEASUREMENT_VARIANCE * np.eye(2)
    )
    commands = kalman_states(augmented_model, measured_states(window), model.known_forcing)[:, 2]
    # The states of a sample show the command of the sample before, so that the estimates are moved by one sample.
    return np.append(commands[1:], commands[-1])


def mean_input(window: RollWindow) -> Array:
    """Returns the true mean of the hidden command, 0, at every sample: the trivial estimate.

    The inputs of a window are scaled to a mean of 0.

    Args:
        window: T samples.

    Returns:
        (T,) zeros.
    """
    return np.zeros(len(window.inputs))


ESTIMATORS: dict[str, Callable[[RollWindow], Array]] = {
    DEM: dem_input,
    DEM_ROLL_ONLY: partial(dem_input, measures_rate=False),
    UIO: proportional_integral_input,
    MINIMUM_VARIANCE_UIO: minimum_variance_input,
    AUGMENTED: random_walk_input,
    INPUT_MEAN: mean_input,
}
"""The estimators by name."""


def input_errors(window: RollWindow) -> dict[str, float]:
    """Returns the sum of squared errors (SSE) of the hidden command by each estimator.

    Args:
        window: samples of states and commands; the ends are left out of the sum (``TRIM``).

    Returns:
        SSE by name of the estimator, in the squared unit of the commands; infinite if an estimate is not finite.
    """
    true_commands = window.inputs[TRIM:-TRIM, UNKNOWN_INPUT]
    errors = {}
    for name, estimate in ESTIMATORS.items():
        deviations = estimate(window)[TRIM:-TRIM] - true_commands
        sse = float(deviations @ deviations)
        errors[name] = sse if np.isfinite(sse) else np.inf
    return errors


def run(runner: Runner) -> ExperimentResult:
    """Compares estimates of a hidden motor command by DEM and by unknown input observers, by their SSE.

    Args:
        runner: runner that has the recorded flights, if there are any, and runs the windows in several processes.

    Returns:
        Checks, tables, and the SSE of every estimator as ``numbers``.
    """
    simulated_windows = [
        simulated_window(0, smoothness, INPUT_SAMPLES)
        for smoothness in SIMULATED_SMOOTHNESS.values()
    ]
    recorded_windows = flight_windows(runner.recorded_flights, INPUT_SAMPLES, count=1)
    # All windows are one batch of jobs, so that the processes work on simulations and recordings at once.
    errors = runner.map_jobs(input_errors, [*simulated_windows, *recorded_windows])
    errors_of_simulations = errors[: len(simulated_windows)]
    errors_of_recordings = errors[len(simulated_windows) :]
    simulated_errors = dict(zip(SIMULATED_SMOOTHNESS, errors_of_simulations, strict=True))
    recorded_names = [window.flight for window in recorded_windows]
    recorded_errors = dict(zip(recorded_names, errors_of_recordings, strict=True))
    checks = []
    tables: tuple[Block, ...] = ()
    notes = []
    if recorded_errors:
        errors_in_wind = {}
        for flight, errors_of_flight in recorded_errors.items():
            if wind_of_flight(flight) == WITH_WIND:
                errors_in_wind[flight] = errors_of_flight
        if errors_in_wind:
            checks += input_checks(errors_in_wind, "flights in wind")
        tables += recorded_table(recorded_errors)
    else:
        notes.append(missing_flights_sentence(runner.recorded_flights))
    checks += input_checks(simulated_errors, "simulated")
    tables += (
        Sentence("SSE of the hidden command in 10 s of each noise.", "Simulated:"),
        error_table(simulated_errors),
    )
    numbers = {
        "simulated": simulated_errors,
        "recorded": recorded_errors,
        "published": {name: sse._asdict() for name, sse in PUBLISHED_INPUT_SSE.items()},
    }
    return ExperimentResult(tuple(checks), numbers, tables, remarks=tuple(notes))


def input_checks(errors: Mapping[str, Mapping[str, float]], data: str) -> list[Check]:
    """Checks that DEM's SSE is similar to the SSE of unknown input observers, and lower than the constant mean's.

    Args:
        errors: SSE by window and estimator, in the squared unit of the commands.
        data: name of the windows, for the text.

    Returns:
        A check for each observer, and one for the mean.
    """
    checks = []
    for observer in (UIO, MINIMUM_VARIANCE_UIO):
        ratios = np.array([sse[DEM] / sse[observer] for sse in errors.values()])
        similar_count = int((np.maximum(ratios, 1 / ratios) <= MAX_SIMILAR_RATIO).sum())
        checks.append(
            Check(
                rule=f"{data}: the SSE of DEM is at most {MAX_SIMILAR_RATIO} times that of the {observer}, and the "
                "reverse, every time",
                holds=similar_count == len(ratios),
                finding=f"{data}: the SSE of DEM is {rounded(ratios.min(), 3)} to {rounded(ratios.max(), 3)} times "
                f"that of the {observer}, similar in {similar_count} of {len(ratios)}",
            )
        )
    lower_count = sum(sse[DEM] < sse[INPUT_MEAN] for sse in errors.values())
    checks.append(
        Check(
            rule=f"{data}: the SSE of DEM is lower than that of the constant mean of the input, every time",
            holds=lower_count == len(errors),
            finding=f"{data}: DEM estimates the input better than its constant mean in {lower_count} of {len(errors)}",
        )
    )
    return checks


def error_table(errors: Mapping[str, Mapping[str, float]]) -> Table:
    """Returns a table of the errors of a hidden motor command, with the estimator of the least total error on top.

    Args:
        errors: sum of squared errors (SSE) of the command, by name of the window and of the estimator.

    Returns:
        The table, with a row for each estimator and a column for each window.
    """
    total_errors = {}
    for name in ESTIMATORS:
        total_errors[name] = sum(window_errors[name] for window_errors in errors.values())
    return table_by_estimator(errors, sorted(total_errors, key=total_errors.__getitem__))


def recorded_table(errors_by_flight: Mapping[str, Mapping[str, float]]) -> tuple[Block, ...]:
    """Returns the tables of the errors (SSE) on the recorded flights, with the published ones.

    Args:
        errors_by_flight: SSE by flight and estimator, in the squared unit of the commands.

    Returns:
        A sentence and a table for flights with wind, and for those without.
    """
    blocks: list[Block] = []
    for wind in (WITH_WIND, WITHOUT_WIND):
        flights = {}
        for flight, errors in errors_by_flight.items():
            if wind_of_flight(flight) == wind:
                flights[flight] = errors
        if not flights:
            continue
        table = error_table(flights)
        if wind == WITH_WIND:
            table.rows.extend(_published_rows(list(flights)))
        blocks.append(
            Sentence(
                "SSE of the hidden command of motor 1 over 10 s, in units of the commands’ range.",
                f"Recorded flights {wind}:",
            )
        )
        blocks.append(table)
    return tuple(blocks)


def _published_rows(flights: list[str]) -> list[list[str]]:
    """Returns the rows of the published errors (SSE) for flights in the wind of a blower.

    Args:
        flights: names of the flights, the columns of the table.

    Returns:
        One row for DEM and one for the unknown input observer (UIO); a dash for a flight without a published value.
    """
    dem_row = ["DEM, published"]
    uio_row = ["UIO, published"]
    for flight in flights:
        # A flight is named after its file, which begins with the name of the experiment: six characters, like "exp_21".
        experiment = flight[: len("exp_21")]
        published_errors = PUBLISHED_INPUT_SSE.get(experiment)
        dem_row.append(rounded(published_errors.dem, 3) if published_errors else "-")
        uio_row.append(rounded(published_errors.uio, 3) if published_errors else "-")
    return [dem_row, uio_row]
