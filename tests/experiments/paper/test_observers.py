"""Observers of states and inputs: each agrees with a computation of another kind, on data whose truth is known."""

import numpy as np
from numpy.random import default_rng
from pytest import approx, fixture, mark
from scipy.signal import lfilter

from mavdem.experiments.paper.estimation import (
    input_estimation,
    state_estimation,
    state_observers,
)
from mavdem.experiments.paper.estimation.dem_observer import embedding_derivative
from mavdem.experiments.paper.estimation.observers import (
    DiscreteModel,
    fit_autoregression,
    fixed_lag_states,
    kalman_states,
    smikf_states,
)
from mavdem.experiments.paper.estimation.roll_windows import (
    FIRST_SAMPLE,
    WITH_WIND,
    WITHOUT_WIND,
    RollWindow,
    flight_windows,
    missing_flights_sentence,
    simulated_window,
    smooth_noise,
    wind_of_flight,
)
from mavdem.experiments.paper.estimation.state_estimation import TrimmedMean
from mavdem.experiments.paper.figures import draw_lines
from mavdem.experiments.paper.runner import Runner
from mavdem.flight import Flight

SAMPLES = 40


@fixture(scope="module")
def window():
    return simulated_window(0, smoothness=0.006, samples=SAMPLES)


@fixture(scope="module")
def model(window):
    return state_observers.white_noise_model(window)


def batch_states(model, noise_covariance, outputs, inputs):
    """States (T, n) of every sample given all outputs, by regression on the joint Gaussian of states and outputs.

    The first state is known; ``noise_covariance`` is that of the stacked noises w of all steps.
    """
    T, n = len(outputs), len(model.Phi)
    powers = [np.linalg.matrix_power(model.Phi, k) for k in range(T)]
    response = np.zeros((T * n, (T - 1) * n))
    for t in range(1, T):
        for step in range(t):
            rows = slice(t * n, (t + 1) * n)
            response[rows, step * n : (step + 1) * n] = powers[t - 1 - step]
    mean = response @ (inputs[:-1] @ model.Gamma.T).ravel()
    covariance = response @ noise_covariance @ response.T
    output_map = np.kron(np.eye(T), model.C)
    innovation_covariance = output_map @ covariance @ output_map.T + np.kron(np.eye(T), model.R)
    gain = covariance @ output_map.T @ np.linalg.inv(innovation_covariance)
    return (mean + gain @ (outputs.ravel() - output_map @ mean)).reshape(T, n)


def started_from_zero(window):
    """Outputs and inputs that begin with state 0, exactly measured, so that no first covariance matters."""
    outputs = window.outputs - window.outputs[0]
    return outputs, window.inputs


def test_filter_and_fixed_lag_smoother_equal_the_regression_on_the_joint_gaussian(window, model):
    """The last state of the filter equals the estimate from all samples at once."""
    outputs, inputs = started_from_zero(window)
    certain = model._replace(R=np.array([[1e-6]]))
    T = 25
    # The filter begins with the identity as covariance; a first noise as large stands for it here.
    noise = np.kron(np.eye(T - 1), model.Q)
    filtered = kalman_states(certain, outputs[:T], inputs[:T])
    later = fixed_lag_states(certain, 2, 3, outputs, inputs)
    batch = batch_states(certain, noise, outputs[:T], inputs[:T])
    to_lagged = batch_states(
        certain, np.kron(np.eye(T + 2), model.Q), outputs[: T + 3], inputs[: T + 3]
    )
    # After 25 samples the different first covariances are forgotten.
    assert filtered[-1] == approx(batch[-1], rel=0.01, abs=1e-4)
    assert later[T - 1] == approx(to_lagged[T - 1], rel=0.01, abs=1e-4)


def test_smikf_of_white_noise_is_the_kalman_filter(window, model):
    # A series whose neighbours do not correlate at all.
    uncorrelated = np.tile([1.0, 0.0, -1.0, 0.0], 25)[:, None] * np.array([1e-3, 0.1])
    white = model._replace(Q=np.diag(np.mean(uncorrelated**2, axis=0)))
    estimates = smikf_states(white, uncorrelated, window.outputs, window.inputs)
    expected = kalman_states(white, window.outputs, window.inputs)
    # The two begin differently, which is forgotten.
    assert estimates[-1] == approx(expected[-1], rel=1e-6, abs=1e-9)


def test_smikf_is_better_than_the_kalman_filter_where_noise_is_coloured():
    coloured = simulated_window(0, smoothness=0.02, samples=150)
    white_model = state_observers.white_noise_model(coloured)
    noise = coloured.process_noise
    smikf = smikf_states(white_model, noise, coloured.outputs, coloured.inputs)[:, 1]
    kalman = kalman_states(white_model, coloured.outputs, coloured.inputs)[:, 1]
    smikf_error = state_estimation.squared_error(smikf, coloured)
    assert smikf_error < 0.8 * state_estimation.squared_error(kalman, coloured)


def test_burgs_method_finds_the_coefficients_of_a_long_series():
    series = lfilter([1.0], [1.0, -1.2, 0.5], default_rng(0).normal(size=20_000))
    fit = fit_autoregression(series, 2)
    assert fit.coefficients == approx([1.2, -0.5], abs=0.03)
    assert fit.variance == approx(1.0, rel=0.03)
    assert not fit_autoregression(np.zeros(50), 3).coefficients.any()


def test_smooth_noise_has_the_autocorrelation_of_its_kernel():
    noise = smooth_noise(default_rng(0).standard_normal(200_000), 2.0)
    assert noise.var() == approx(1.0, rel=0.02)
    assert np.mean(noise[3:] * noise[:-3]) == approx(np.exp(-9 / 16), abs=0.02)


def test_dem_estimates_states_and_inputs_of_exact_data():
    window = simulated_window(1, smoothness=0.02, samples=200)
    estimates = state_observers.dem_states(window, window.outputs, window.inputs, p=6)
    inner = slice(10, -10)
    deviation = np.abs(estimates[inner, 0] - window.outputs[inner, 0]).max()
    assert deviation < 0.02 * np.ptp(window.outputs)
    correlation = np.corrcoef(estimates[inner, 1], window.states[inner, 1])[0, 1]
    assert correlation > 0.99
    assert np.isnan(estimates[0]).all()


def test_the_derivative_of_the_embedding_is_that_of_a_polynomial():
    t = 0.01 * np.arange(20)[:, None]
    derivative = embedding_derivative(t**3, order=4, dt=0.01)
    assert derivative[2:-2] == approx(3 * t[2:-2] ** 2)
    assert np.isnan(derivative[[0, 1, -2, -1]]).all()


def test_a_constant_unknown_input_is_estimated_without_noise():
    window = simulated_window(0, smoothness=0.0, samples=400)
    Phi, Gamma = window.transition
    inputs = window.inputs.copy()
    inputs[:, 0] = 0.3
    states = np.zeros((400, 2))
    for t in range(399):
        states[t + 1] = Phi @ states[t] + Gamma @ inputs[t]
    exact = RollWindow("exact", states, states[:, :1], inputs, window.B)
    estimate = input_estimation.minimum_variance_input(exact)
    assert estimate == approx(inputs[:, 0], abs=1e-9)
    observed = input_estimation.proportional_integral_input(exact)
    assert observed[-1] == approx(0.3, rel=0.01)


def recorded_flight(seed, samples):
    window = simulated_window(seed, smoothness=0.006, samples=samples)
    motors = 20 * window.inputs + 170
    time = window.dt * np.arange(samples)
    return Flight(time, motors, window.states, dt=window.dt)


def test_windows_follow_each_other_and_still_flights_are_left_out():
    flight = recorded_flight(0, FIRST_SAMPLE + 250)
    frozen_rate = flight.outputs * [1, 0]
    still = Flight(flight.time, flight.inputs, frozen_rate, dt=flight.dt)
    flights = {"exp_1_WM_1": flight, "exp_2_WM_0": still}
    windows = flight_windows(flights, samples=120)
    assert [window.flight for window in windows] == ["exp_1_WM_1", "exp_1_WM_1"]
    assert np.array_equal(windows[1].states[0], flight.outputs[FIRST_SAMPLE + 120])
    assert windows[0].inputs.mean(axis=0) == approx(np.zeros(4), abs=1e-12)
    assert "None of the 1" in missing_flights_sentence({"exp_2_WM_0": still})
    assert wind_of_flight("exp_2_WM_0") == WITHOUT_WIND
    assert wind_of_flight("exp_1_WM_1") == WITH_WIND


def test_estimates_that_are_one_sample_late_fit_best_at_a_delay(window):
    rates = np.append(window.states[1:, 1], 0.0)
    errors = [state_estimation.squared_error(rates, window, delay) for delay in range(3)]
    assert errors[1] == approx(0.0, abs=1e-20)
    assert errors[0] > 0 and errors[2] > 0
    rates[20] = np.nan
    assert state_estimation.squared_error(rates, window) == np.inf


def test_windows_beyond_the_authors_limit_are_left_out_and_counted():
    kept = state_estimation.WindowErrors({}, dict.fromkeys(state_estimation.PUBLISHED_SSE, 2.0), {})
    lost = state_estimation.WindowErrors(
        {}, dict.fromkeys(state_estimation.PUBLISHED_SSE, 100.0), {}
    )
    means = state_estimation.trimmed_errors([kept, kept, lost])
    assert means[state_observers.DEM] == TrimmedMean(2.0, 1)
    assert np.isnan(state_estimation.trimmed_errors([lost])[state_observers.DEM].sse)


@mark.slow
def test_the_reports_have_the_least_error_first_and_all_flights(monkeypatch):
    """Short runs of both experiments, with and without the recorded flights."""
    monkeypatch.setattr(state_estimation, "SIMULATED_WINDOWS", 1)
    monkeypatch.setattr(state_estimation, "SIMULATED_SMOOTHNESS", {"s = 0.006 s": 0.006})
    monkeypatch.setattr(input_estimation, "SIMULATED_SMOOTHNESS", {"s = 0.006 s": 0.006})
    monkeypatch.setattr(input_estimation, "INPUT_SAMPLES", 240)
    flights = {
        "exp_21_WW_WM_1": recorded_flight(1, FIRST_SAMPLE + 240),
        "exp_21_WW_WM_0": recorded_flight(2, FIRST_SAMPLE + 240),
    }
    runner = Runner(recorded_flights=flights)
    states = state_estimation.run(runner)
    own_time_table = states.tables[1]
    errors = [float(row[2]) for row in own_time_table.rows]
    assert errors == sorted(errors)
    assert own_time_table.header[2] == "with wind, SSE"
    assert len(states.checks) == 6
    inputs = input_estimation.run(runner)
    recorded_table = inputs.tables[1]
    assert recorded_table.header == ["estimator", "exp_21_WW_WM_1"]
    assert recorded_table.rows[-2] == ["DEM, published", "43.1"]
    assert len(inputs.checks) == 6
    without_flights = input_estimation.run(Runner())
    assert "--flights" in without_flights.remarks[0]
    assert len(without_flights.checks) == 3


@mark.slow
def test_many_lines_have_one_legend_below_their_panels():
    few = {"a": {f"line {index}": np.arange(3.0) for index in range(3)}}
    many = {name: {f"line {index}": np.arange(3.0) for index in range(9)} for name in "ab"}
    assert not draw_lines(few, "x").legends
    figure = draw_lines(many, "x")
    assert len(figure.legends) == 1
    assert all(axes.get_legend() is None for axes in figure.axes)


def test_a_model_without_noise_follows_its_inputs(model, window):
    quiet = DiscreteModel(model.Phi, model.Gamma, model.C, np.zeros((2, 2)), np.eye(1) * 1e9)
    estimates = kalman_states(quiet, np.zeros((SAMPLES, 1)), window.inputs)
    state = np.zeros(2)
    for t in range(SAMPLES - 1):
        state = model.Phi @ state + model.Gamma @ window.inputs[t]
    assert estimates[-1] == approx(state, rel=1e-3, abs=1e-5)
