"""How far estimates scatter, what the data did not determine, and how smooth the noise is."""

import calibration
import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from random_models import models, random_belief
from scipy.signal import lfilter
from simulated import simulated

from mavdem import Flight, Settings, learn
from mavdem.confidence import half_width, quantile, require_probability
from mavdem.dem.engine.ascent import ascend
from mavdem.dem.engine.free_energy import free_energy
from mavdem.dem.engine.generative import SufficientStatistics
from mavdem.dem.fitting import (
    long_run_covariance,
    marginal_information,
    sample_slopes,
    uncertainty_of,
    undetermined_directions,
)

seeds = st.integers(0, 10**6)


@given(model=models, seed=seeds)
@hypothesis_settings(max_examples=15)
def test_slopes_of_samples_are_those_of_their_free_energy(model, seed):
    rng = np.random.default_rng(seed)
    data = rng.standard_normal((4, model.hidden.start))
    state_map, belief = random_belief(seed, model, SufficientStatistics.of(data))
    states = data @ state_map.T
    slopes = sample_slopes(model, data, states, belief)
    numeric = np.empty_like(slopes)
    for i in range(slopes.shape[1]):
        step = np.zeros(slopes.shape[1])
        step[i] = 1e-4
        ahead, behind = (
            free_energy(model, data, states, belief._replace(theta=belief.theta + by)) for by in (step, -step)
        )
        numeric[:, i] = (ahead - behind) / 2e-4
    # What is the same in all samples, W of the states and the prior, is not in them.
    numeric -= numeric.mean(axis=0)
    slopes = slopes - slopes.mean(axis=0)
    np.testing.assert_allclose(slopes, numeric, atol=1e-6 * (np.abs(numeric).max() + 1))


def test_the_sum_of_an_autoregression_scatters_as_it_must():
    """Var Σ x = T σ²/(1 − ρ)² for innovations of variance σ²; estimated within what the kernel's width allows."""
    rho, number, runs = 0.8, 4000, 30
    rng = np.random.default_rng(0)
    estimates, freedoms = [], []
    for _ in range(runs):
        rows = lfilter([1.0], [1.0, -rho], rng.standard_normal((number, 2)), axis=0)
        covariance, freedom = long_run_covariance([rows])
        estimates.append(covariance / number * (1 - rho) ** 2)
        freedoms.append(freedom)
    # The kernel's width trades its bias, some percent, for a variance of 2/freedom.
    standard_error = np.sqrt(2 / np.mean(freedoms) / runs)
    np.testing.assert_allclose(np.mean(estimates, axis=0), np.eye(2), atol=0.1 + 4 * standard_error)


def test_independent_samples_scatter_as_the_posterior_says():
    """Where every assumption holds and the sensor is good, the corrected covariance is DEM's own."""
    model = calibration.generative_model(
        18.0, 2.0, *(calibration.temporal_precision(order, 0.1) for order in (calibration.P, calibration.Q))
    )
    rng = np.random.default_rng(0)
    truth = calibration.theta_of(calibration.VEHICLE)
    data = calibration.independent_samples(model, truth, 3000, 0.1, rng)
    climb = ascend(model, SufficientStatistics.of(data), 100)
    found = uncertainty_of(model, [data], climb).scatter
    free = np.ix_(calibration.FREE, calibration.FREE)
    own = climb.belief.theta_covariance[free]
    # A variance of N samples is known to √(2/N); five of those.
    np.testing.assert_allclose(
        np.sqrt(np.diag(found.covariance[free])), np.sqrt(np.diag(own)), rtol=5 * np.sqrt(2 / 3000)
    )
    assert found.freedom > 500


@pytest.mark.slow
def test_intervals_hold_parameters_where_the_assumptions_hold(monkeypatch):
    monkeypatch.setattr(calibration, "SYSTEMS", 60)
    coverage = calibration.as_assumed(18.0, 2.0, 150, 0.1)
    assert 0.85 <= coverage.own <= 0.95
    assert 0.85 <= coverage.corrected <= 0.95


@pytest.mark.slow
def test_the_corrected_interval_holds_them_where_dem_is_overconfident(monkeypatch):
    """Samples of a flight are not independent, and DEM says it knows two to four times as much as it does."""
    monkeypatch.setattr(calibration, "SYSTEMS", 60)
    coverage = calibration.sampled(3, 0.3)
    assert coverage.own < 0.6
    assert 0.8 <= coverage.corrected <= 0.95


def test_two_motors_that_always_agree_leave_their_difference_undetermined():
    flight = simulated(wind=0.5)
    inputs = flight.inputs.copy()
    inputs[:, 1] = inputs[:, 0]
    settings = Settings(order=2, window=5, parameter_precision=1.0, horizon=None)
    learned = learn(Flight(flight.time, inputs, flight.outputs)[:700], settings)
    (direction,) = learned.undetermined
    assert direction.share < 1e-6
    named = np.zeros(len(direction.weights))
    named[[8, 9]] = 1, -1  # B: the rate from motors 1 and 2, in θ = [A (4); B (8); C (4)]
    np.testing.assert_allclose(np.abs(direction.weights @ named) / np.sqrt(2), 1, atol=1e-6)
    # What they do together is learnt as ever: half of it each, as the prior has no preference.
    assert learned.model.B[1, 0] == pytest.approx(learned.model.B[1, 1], abs=1e-6)
    assert not learn(flight[:700], settings).undetermined


def test_where_there_is_no_maximum_no_interval_is_reported():
    """The paper's settings leave C free, and twenty iterations short of any maximum."""
    learned = learn(simulated(wind=0.5)[:700], Settings.paper())
    assert learned.scatter is None
    assert np.isnan(learned.model_interval().A).all()
    assert any("no maximum" in caution for caution in learned.cautions)


def test_much_information_hides_no_other_parameter_and_a_nuisance_has_its_best_value():
    directions = undetermined_directions(np.diag([1e13, 500.0, 0.5]), np.eye(3), np.ones(3, bool), (1, 1, 1))
    (one,) = directions
    np.testing.assert_allclose(np.abs(one.weights), [0, 0, 1], atol=1e-6)
    assert one.share == pytest.approx(0.5)
    # Schur's complement: minimizing over the second parameter, which its own prior holds somewhat.
    information, precision = np.array([[4.0, 3.0], [3.0, 5.0]]), np.diag([1.0, 2.0])
    np.testing.assert_allclose(marginal_information(information, precision, np.array([0])), [[4.0 - 9.0 / 7.0]])


@pytest.mark.parametrize("level", [0, 1, np.nan, "x", True])
def test_a_level_that_is_no_probability_is_named(level):
    with pytest.raises(ValueError, match="^level must"):
        require_probability(level)


def test_half_widths_are_those_of_normal_deviations_or_of_students():
    widths = half_width(np.array([1.0, 4.0, 4.0]), 0.9, [np.inf, np.inf, 3.0])
    np.testing.assert_allclose(widths, [1.645, 3.290, 4.707], rtol=1e-3)
    assert quantile() == pytest.approx(float(half_width(1.0)))
