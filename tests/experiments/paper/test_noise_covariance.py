"""Estimators of noise variances: each finds known variances where its assumptions hold."""

import numpy as np
from pytest import approx, fixture, mark

from mavdem.experiments.paper.estimation import noise_covariance
from mavdem.experiments.paper.estimation.covariance_estimators import (
    kalman_states_with_variances,
)
from mavdem.experiments.paper.estimation.dem_covariance import (
    dem_variances,
    online_dem_variances,
)
from mavdem.experiments.paper.estimation.noise_covariance import (
    BATCH_ESTIMATORS,
    DEM,
    ONLINE_DEM,
    RECURSIVE_ESTIMATORS,
    MeanErrors,
    final_variances,
)
from mavdem.experiments.paper.estimation.noisy_records import flight_records, random_record
from mavdem.experiments.paper.estimation.roll_windows import FIRST_SAMPLE, simulated_window
from mavdem.experiments.paper.runner import Runner
from mavdem.flight import Flight

WHITE = 0.0


@fixture(scope="module")
def white_record():
    return random_record(0, WHITE)


@fixture(scope="module")
def coloured_record():
    return random_record(0, smoothness=0.2)


@mark.slow
@mark.parametrize("name", BATCH_ESTIMATORS)
def test_batch_estimators_find_the_variances_of_white_noise(white_record, name):
    variances = BATCH_ESTIMATORS[name](white_record)
    assert np.log(variances) == approx(np.log(white_record.noise_variances), abs=0.3)


@mark.parametrize("name", RECURSIVE_ESTIMATORS)
def test_recursive_estimators_find_the_variances_of_white_noise(white_record, name):
    estimates = RECURSIVE_ESTIMATORS[name](white_record)
    variances = final_variances(estimates.variances)
    assert np.log(variances) == approx(np.log(white_record.noise_variances), abs=0.8)
    errors = (estimates.states - white_record.states)[100:].var(axis=0)
    assert (errors < white_record.noise_variances).all()


@mark.slow
def test_dem_finds_the_variances_of_coloured_noise_that_others_take_for_motion(coloured_record):
    truth = np.log(coloured_record.noise_variances)
    dem_error = np.abs(np.log(dem_variances(coloured_record).variances[-1]) - truth).max()
    online = final_variances(online_dem_variances(coloured_record))
    online_error = np.abs(np.log(online) - truth).max()
    bayes = RECURSIVE_ESTIMATORS[noise_covariance.VARIATIONAL_BAYES](coloured_record)
    bayes_error = np.abs(np.log(final_variances(bayes.variances)) - truth).max()
    assert dem_error < 1.0
    assert online_error < 1.0
    assert bayes_error > 1.0


def test_a_step_of_the_variances_is_in_the_second_half_only():
    record = random_record(3, smoothness=0.1, variance_step=100.0)
    noise = record.outputs - record.states
    half = len(noise) // 2
    ratio = noise[half:].var(axis=0) / noise[:half].var(axis=0)
    assert (ratio > 20).all()
    assert noise[half:].var(axis=0) == approx(record.noise_variances, rel=0.8)


def test_added_noise_of_flights_has_its_known_variance():
    window = simulated_window(0, smoothness=0.006, samples=FIRST_SAMPLE + 240)
    time = window.dt * np.arange(len(window.states))
    flight = Flight(time, 20 * window.inputs, window.states, dt=window.dt)
    (record,) = flight_records({"a": flight}, smoothness=0.01)
    noise = record.outputs - record.states
    assert noise.var(axis=0) == approx(record.noise_variances, rel=0.5)
    assert np.array_equal(record.states, flight.outputs[FIRST_SAMPLE:])


@mark.slow
def test_true_variances_give_better_states_than_wrong_ones(white_record):
    right = kalman_states_with_variances(white_record, white_record.noise_variances)
    wrong = kalman_states_with_variances(white_record, white_record.noise_variances / 1000)
    right_error = (right - white_record.states)[50:].var()
    assert right_error < (wrong - white_record.states)[50:].var()


def test_checks_compare_dem_with_the_best_of_the_others():
    means = {name: MeanErrors(2.0, 0.5) for name in noise_covariance.BASELINES}
    means[DEM] = MeanErrors(1.5, 0.6)
    errors = {"white noise": means, "s = 2 steps": means}
    (check,) = noise_covariance.covariance_checks(errors, "made up")
    assert check.holds
    assert "a factor of 1.50 by DEM and 2.00 by" in check.finding
    assert not noise_covariance.state_check(means).holds
    factors = dict.fromkeys(RECURSIVE_ESTIMATORS, 2.0) | {ONLINE_DEM: 2.5}
    assert not noise_covariance.online_check(factors).holds


@mark.slow
def test_the_report_has_the_best_estimator_in_white_noise_first(monkeypatch):
    """A short run of the experiment with one fast estimator and one record."""
    monkeypatch.setattr(noise_covariance, "RANDOM_RECORDS", 1)
    quick = {"innovation correlation (ALS)": BATCH_ESTIMATORS["innovation correlation (ALS)"]}
    monkeypatch.setattr(noise_covariance, "BATCH_ESTIMATORS", quick)
    monkeypatch.setattr(noise_covariance, "BASELINES", (*quick, *RECURSIVE_ESTIMATORS))
    result = noise_covariance.run(Runner())
    assert len(result.checks) == 5
    assert result.remarks
    factors = [float(row[1]) for row in result.tables[1].rows]
    assert factors == sorted(factors)
