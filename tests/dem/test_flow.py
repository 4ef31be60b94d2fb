"""The D step at a finite learning rate, and climbs at finite rates."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_models import models, random_model, random_samples
from scipy.integrate import solve_ivp
from simulated import simulated

from mavdem import Settings
from mavdem.dem.engine.ascent import Rates, ascend, newton_step, theta_curvature_of_profile
from mavdem.dem.engine.free_energy import free_energy_action, optimal_terms
from mavdem.dem.engine.generative import GeneralizedMoments, SufficientStatistics
from mavdem.dem.engine.steps import StateFlow, d_step, e_step, m_step, state_slope, with_optimal_precisions
from mavdem.dem.fitting import fit, generalized, generative_model
from mavdem.dem.record import Record
from mavdem.dem.scaling import Scaling

seeds = st.integers(0, 10**6)
DT = 0.1


def slope_of(model):
    prior = model.prior
    nothing = np.zeros_like(prior.theta_precision), np.zeros_like(prior.lambda_precision)
    return state_slope(model, prior.theta_mean, nothing[0], prior.lambda_mean, nothing[1])


def test_the_flow_runs_the_equation_it_stands_for():
    model = random_model(1, 2, 1, 2, 2, 1, drop=False, groups=False)
    of_data, precision = slope_of(model)
    flow = StateFlow.of(model, of_data, precision, 3.0)
    assert flow.spectral_abscissa < 0
    data = np.random.default_rng(0).standard_normal((20, model.hidden.start)).cumsum(axis=0)
    time = DT * np.arange(20)
    states = flow.states(data, DT)
    for k in range(19):

        def motion(t, X, k=k):
            now = data[k] + (t - time[k]) / DT * (data[k + 1] - data[k])
            gradient = of_data @ now - precision @ X
            carried = np.concatenate([X[2:6], np.zeros(2), X[7:8], np.zeros(1)])
            return carried + 3.0 * gradient

        end = solve_ivp(motion, (time[k], time[k + 1]), states[k], method="LSODA", rtol=1e-9, atol=1e-9).y[:, -1]
        np.testing.assert_allclose(states[k + 1], end, rtol=1e-6, atol=1e-6)


@given(model=models, seed=seeds)
@settings(max_examples=15)
def test_a_fast_flow_is_the_exact_limit(model, seed):
    of_data, precision = slope_of(model)
    data = np.random.default_rng(seed).standard_normal((10, model.hidden.start))
    # So fast that the slowest direction of the gradient forgets within a hundredth of a step.
    rate = 1e4 / DT / np.linalg.eigvalsh(precision).min()
    exact = np.linalg.solve(precision, of_data @ data.T).T
    flow = StateFlow.of(model, of_data, precision, rate)
    assert flow.spectral_abscissa < 0
    # What is left is the lag: the time to forget, 1e-4 of a step, over a step's change.
    np.testing.assert_allclose(flow.states(data, DT), exact, atol=2e-3 * np.abs(exact).max())


def test_an_unstable_flow_is_known_and_not_run():
    model = random_model(5, 2, 1, 2, 4, 1, drop=False, groups=False)
    of_data, precision = slope_of(model)
    rates = np.geomspace(1e-6, 1e6, 25)
    abscissae = np.array([StateFlow.of(model, of_data, precision, rate).spectral_abscissa for rate in rates])
    assert (abscissae > 0).any() and (abscissae < 0).any()
    unstable = rates[abscissae > 0][-1]
    data = np.random.default_rng(0).standard_normal((60, model.hidden.start))
    samples = SufficientStatistics.of(data)
    climb = ascend(model, samples, 1, Rates(state=unstable, segments=(data,), dt=DT))
    assert not climb.flowed.any()
    exact = ascend(model, samples, 1)
    np.testing.assert_array_equal(climb.theta, exact.theta)


@given(model=models, seed=seeds, logs=st.tuples(*[st.one_of(st.none(), st.floats(-4, 4))] * 3))
@settings(max_examples=30)
def test_a_climb_at_any_rates_never_falls(model, seed, logs):
    data = np.random.default_rng(seed).standard_normal((40, model.hidden.start))
    rates = [None if log is None else 10**log for log in logs]
    climb = ascend(model, SufficientStatistics.of(data), 12, Rates(*rates, segments=(data,), dt=DT))
    assert (np.diff(climb.free_energy) >= 0).all()
    assert np.isfinite(climb.theta).all()


def test_flows_run_and_lead_to_the_same_place():
    record = Record.of(simulated(wind=0.5)[:700])
    settings = Settings(order=2, d=2, window=5, parameter_precision=1.0)
    exact, flowing = fit(record, settings), fit(record, replace(settings, learning_rates=(1e5, None, None)))
    assert flowing.ascent.flowed.sum() > 1
    np.testing.assert_allclose(flowing.ascent.theta[-1], exact.ascent.theta[-1], rtol=1e-3, atol=1e-3)


@given(model=models, seed=seeds)
@settings(max_examples=15)
def test_steps_at_a_finite_rate_follow_the_gradient_and_end_at_the_maximum(model, seed):
    samples = random_samples(seed, model)
    climb = ascend(model, samples, 2)
    belief = with_optimal_precisions(model, climb.belief._replace(theta=model.prior.theta_mean))
    for step, mean in ((e_step, belief.theta), (m_step, belief.lambda_)):
        moved = [np.linalg.norm(step(model, samples, belief, rate) - mean) for rate in (1e-12, 1e-6)]
        assert moved[0] < moved[1]
    # θ has one scale here: a parameter near zero is as exact as the largest.
    exact = e_step(model, samples, belief)
    np.testing.assert_allclose(e_step(model, samples, belief, 1e12), exact, rtol=0, atol=1e-6 * np.abs(exact).max())


@pytest.mark.parametrize("rate", [1e-3, 1.0, 1e3])
def test_a_finite_m_step_is_a_step_up(rate):
    model = random_model(3, 2, 1, 2, 2, 1, drop=False, groups=True)
    samples = random_samples(0, model)
    belief = ascend(model, samples, 1).belief
    after = belief._replace(lambda_=m_step(model, samples, belief, rate))
    assert free_energy_action(model, samples, after) >= free_energy_action(model, samples, belief)


def problem(**settings):
    complete = Settings(**{"order": 3, "d": 2, "window": 9, "parameter_precision": 1.0, **settings})
    record = Record.of(simulated(wind=0.5)[:700])
    scaling = Scaling.of(*record.spread, complete)
    model = generative_model(complete, scaling, record)
    return model, SufficientStatistics.of(*generalized(complete, scaling, record))


def height(model, samples, belief):
    return sum(optimal_terms(model, samples, with_optimal_precisions(model, belief)).values())


def following(model, samples, belief, theta):
    """The belief with θ elsewhere and X at its maximum there."""
    state_map = d_step(model, theta, belief.theta_covariance, belief.lambda_, belief.lambda_covariance)
    return belief._replace(theta=theta, moments=GeneralizedMoments.of(model, samples, state_map))


def test_the_curvature_is_that_of_the_profile():
    model, samples = problem(order=2, window=3)
    belief = ascend(model, samples, 200).belief
    curvature = theta_curvature_of_profile(model, samples, belief)
    rng = np.random.default_rng(0)
    for _ in range(3):
        direction = np.sqrt(belief.theta_covariance.diagonal()) * rng.standard_normal(len(belief.theta))
        ahead, here, behind = (
            height(model, samples, following(model, samples, belief, belief.theta + step * direction))
            for step in (1.0, 0.0, -1.0)
        )
        # The entropies of what is held fixed there change little over a standard deviation.
        assert direction @ curvature @ direction == pytest.approx(2 * here - ahead - behind, rel=0.02)


def test_the_step_leads_back_and_promises_what_it_brings():
    model, samples = problem(order=2, window=3)
    belief = ascend(model, samples, 200).belief
    rng = np.random.default_rng(0)
    away = 3 * np.sqrt(belief.theta_covariance.diagonal()) * rng.standard_normal(len(belief.theta))
    displaced = following(model, samples, belief, belief.theta + away)
    step = newton_step(model, samples, with_optimal_precisions(model, displaced))
    back = following(model, samples, belief, displaced.theta + step.theta)
    gained = height(model, samples, back) - height(model, samples, displaced)
    assert gained > 1
    assert step.gain == pytest.approx(gained, rel=0.1)
    assert newton_step(model, samples, belief).gain < 0.1


@pytest.mark.parametrize("settings", [{}, {"order": 2, "window": 3, "noise_groups": ((0, 1), (0, 1))}])
def test_a_climb_that_says_it_has_settled_has_nothing_left(settings):
    model, samples = problem(**settings)
    finished = ascend(model, samples, 300)
    assert finished.converged
    assert newton_step(model, samples, finished.belief).gain < 0.1


def test_a_climb_at_a_rate_of_next_to_nothing_has_not_settled():
    model, samples = problem(order=2, window=3)
    climb = ascend(model, samples, 20, Rates(theta=1e-9))
    assert not climb.converged
    assert len(climb.free_energy) == 21
