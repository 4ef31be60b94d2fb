"""What is left to climb, told by the Newton step with X following; and whether a climb knows its end by it."""

import numpy as np
import pytest
from simulated import simulated

from mavdem import Settings
from mavdem.dem.engine.ascent import Rates, ascend, newton_step, theta_curvature_of_profile
from mavdem.dem.engine.free_energy import optimal_terms
from mavdem.dem.engine.generative import GeneralizedMoments, SufficientStatistics
from mavdem.dem.engine.steps import d_step, with_optimal_precisions
from mavdem.dem.fitting import generalized, generative_model
from mavdem.dem.record import Record
from mavdem.dem.scaling import Scaling


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
