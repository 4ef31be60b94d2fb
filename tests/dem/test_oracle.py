"""Where this engine ends, against where the paper's authors' own code does."""

from __future__ import annotations

from dataclasses import replace

import as_published
import numpy as np
import pytest
from oracle import WITHOUT_EDGES, case_a_generalized, case_a_model, case_a_truth, load, needs_oracle

import mavdem
from mavdem.dem.engine.ascent import ascend, plain_rounds
from mavdem.dem.engine.free_energy import free_energy_action, theta_curvature
from mavdem.dem.engine.generative import SufficientStatistics
from mavdem.dem.engine.linalg import inverse

pytestmark = needs_oracle


def test_case_a_taken_as_published_ends_where_theirs_does():
    """The engine's parts, put together with every departure of the published code, go its way for 150 iterations.

    Whether an iteration's θ was kept is theirs: their free energy, which decides, is rounded to 2⁻⁷.
    Measured: θ to 1e-7 and λ to 1e-5 after 20 iterations as after 150.
    """
    data, theirs = load("case_a_data"), load("case_a_octave_150it")
    model, generalized = case_a_model(data), case_a_generalized(data)
    theta, theta_covariance = model.prior.theta_mean, inverse(model.prior.theta_precision)
    lambda_ = model.prior.lambda_mean
    weights = np.exp(lambda_)
    for iteration, kept in enumerate(theirs["accepted"].ravel(), start=1):
        X = as_published.d_step(model, generalized, theta, theta_covariance, weights, data["dt"].item())
        moments = as_published.moments(model, generalized, X)
        squares = model.squared_errors(as_published.expected_errors(model, moments, theta, weights))
        theta_covariance = inverse(-theta_curvature(model, moments, weights))
        if kept:
            theta = as_published.e_step(model, moments, theta, weights)
        *_, weights, lambda_ = as_published.m_step(model, len(X), squares, lambda_)
        weights = np.exp(weights)
        if iteration in (20, 150):
            # 1e-5 is what is left at the end of differences in rounding in the first iterations.
            np.testing.assert_allclose(theta, theirs["theta_mem"][:, iteration], rtol=0, atol=1e-5)
            np.testing.assert_allclose(lambda_, theirs["h_mem"][:, iteration], rtol=0, atol=0.1)


def test_case_a_ends_near_theirs_and_nearer_the_truth():
    """On their 320 samples, zeroed edges and all, this engine's own rounds: exact steps on one F̄, no departures.

    Their λʷ is not compared: 12.55 at iteration 150, it is still on its way, as published to 13.35. Ours passes 12.55
    at about round 113, is 13.54 at round 150 and 15.66 at the maximum of F̄, with θ within 0.003 of theirs at each.
    """
    data, theirs = load("case_a_data"), load("case_a_octave_150it")
    model, samples, truth = case_a_model(data), SufficientStatistics.of(case_a_generalized(data)), case_a_truth(data)
    beliefs = plain_rounds(model, samples, 150)
    published = theirs["theta"].ravel()
    # Measured: 0.0085 from their 20th after 20 rounds, 0.0020 from their 150th after 150.
    for rounds in (20, 150):
        assert np.abs(beliefs[rounds].theta - theirs["theta_mem"][:, rounds]).max() < 1e-2
    assert np.linalg.norm(beliefs[-1].theta - truth) < np.linalg.norm(published - truth)
    assert beliefs[-1].lambda_[0] == pytest.approx(theirs["h"].ravel()[0], abs=0.1)
    heights = [free_energy_action(model, samples, belief) for belief in beliefs]
    assert (np.diff(heights) >= 0).all()


def test_case_a_without_edges_ends_nearer_the_truth_than_theirs():
    data, theirs = load("case_a_data"), load("case_a_octave_150it")
    truth = case_a_truth(data)
    climb = ascend(case_a_model(data), SufficientStatistics.of(case_a_generalized(data)[WITHOUT_EDGES]), 150)
    ours, published = climb.theta[-1], theirs["theta"].ravel()
    assert np.linalg.norm(ours - truth) < np.linalg.norm(published - truth)
    assert climb.lambda_[-1][0] == pytest.approx(theirs["h"].ravel()[0], abs=0.1)
    assert (np.diff(climb.free_energy) >= 0).all()


PRIORS = 40
"""Draws of the random prior: its climbs end in different places, so one alone says little."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("p", "settings", "share"),
    [(2, {}, 0.9), (1, {"p": 1, "d": 1, "window": 2}, 0.25)],
    ids=["with generalized coordinates", "without"],
)
def test_case_c2_is_forecast_no_worse_than_by_them(p, settings, share):
    """Theirs is one draw of the prior. With p = 2 nine of ten of ours forecast no worse than that one.

    With p = 1 the model is biased by the late derivative, whoever learns it: theirs lies among ours, nearer the better
    ones (measured over 60 draws: 38 % of ours no worse, the middle one 0.0254 where theirs is 0.0225).
    Both forecasts start from the end of training.
    """
    data, theirs = (load(f"case_c2_{kind}_p{p}") for kind in ("data", "octave"))
    dt = data["dt"].item()
    flight = mavdem.Flight(dt * np.arange(850), data["pwm"].T, data["y_full"])
    errors = []
    for seed in range(PRIORS):
        learned = mavdem.learn(flight[:700], replace(mavdem.Settings.paper(seed=seed), **settings))
        errors.append(mavdem.evaluate.mspe(flight.outputs[700:], learned.forecast(flight.inputs[700:])).total)
    assert np.mean(np.array(errors) <= theirs["mspe_x0last"].item()) >= share
