"""This engine beside the code of the paper's authors: its steps on their X, θ and λ, and where both end."""

from dataclasses import dataclass, replace
from functools import cache, cached_property

import as_published
import numpy as np
from numpy.testing import assert_allclose
from oracle import case_a_generalized, case_a_model, case_a_truth, load, needs_oracle
from pytest import approx, mark

import mavdem
from mavdem.dem.engine.ascent import plain_rounds
from mavdem.dem.engine.free_energy import (
    Belief,
    free_energy_action,
    optimal_terms,
    state_curvature,
    theta_curvature,
)
from mavdem.dem.engine.generative import (
    SufficientStatistics,
    taylor_weights,
)
from mavdem.dem.engine.linalg import inverse

pytestmark = needs_oracle


@mark.slow
def test_case_a_taken_as_published_ends_where_theirs_does():
    """The engine's parts, put together with every departure of the published code, go its way for 150 iterations.

    Whether an iteration's θ was kept is theirs: their free energy, which decides, is rounded to 2⁻⁷.
    Measured: θ to 1e-7 and λ to 1e-5 after 20 iterations as after 150.
    """
    data = load("case_a_data")
    theirs = load("case_a_octave_150it")
    model = case_a_model(data)
    generalized = case_a_generalized(data)
    theta = model.prior.theta_mean
    theta_covariance = inverse(model.prior.theta_precision)
    lambda_ = model.prior.lambda_mean
    weights = np.exp(lambda_)
    for iteration, kept in enumerate(theirs["accepted"].ravel(), start=1):
        X = as_published.d_step(
            model, generalized, theta, theta_covariance, weights, data["dt"].item()
        )
        moments = as_published.moments(model, generalized, X)
        squares = model.squared_errors(as_published.expected_errors(model, moments, theta, weights))
        theta_covariance = inverse(-theta_curvature(model, moments, weights))
        if kept:
            theta = as_published.e_step(model, moments, theta, weights)
        *_, weights, lambda_ = as_published.m_step(model, len(X), squares, lambda_)
        weights = np.exp(weights)
        if iteration in (20, 150):
            # 1e-5 is what is left at the end of differences in rounding in the first iterations.
            assert_allclose(theta, theirs["theta_mem"][:, iteration], rtol=0, atol=1e-5)
            assert_allclose(lambda_, theirs["h_mem"][:, iteration], rtol=0, atol=0.1)


def test_case_a_ends_near_theirs_and_nearer_the_truth():
    """On their 320 samples, zeroed edges and all, this engine's own rounds: exact steps on one F̄, no departures.

    Their λʷ is not compared: 12.55 at iteration 150, it is still on its way, as published to 13.35. Ours passes 12.55
    at about round 113, is 13.54 at round 150 and 15.66 at the maximum of F̄, with θ within 0.003 of theirs at each.
    """
    data = load("case_a_data")
    theirs = load("case_a_octave_150it")
    model = case_a_model(data)
    samples = SufficientStatistics.of(case_a_generalized(data))
    truth = case_a_truth(data)
    beliefs = plain_rounds(model, samples, 150)
    published = theirs["theta"].ravel()
    # Measured: 0.0085 from their 20th after 20 rounds, 0.0020 from their 150th after 150.
    for rounds in (20, 150):
        assert abs(beliefs[rounds].theta - theirs["theta_mem"][:, rounds]).max() < 1e-2
    assert np.linalg.norm(beliefs[-1].theta - truth) < np.linalg.norm(published - truth)
    assert beliefs[-1].lambda_[0] == approx(theirs["h"].ravel()[0], abs=0.1)
    heights = [free_energy_action(model, samples, belief) for belief in beliefs]
    assert (np.diff(heights) >= 0).all()


PRIORS = 40
"""Draws of the random prior: its climbs end in different places, so one alone says little."""


@mark.slow
@mark.parametrize(
    "p, settings, share",
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
        errors.append(
            mavdem.evaluate.mspe(flight.outputs[700:], learned.forecast(flight.inputs[700:])).total
        )
    assert np.mean(np.array(errors) <= theirs["mspe_x0last"].item()) >= share


ROUNDING = 1e-9
"""Relative difference allowed between two computations of one thing."""

SUMS = 1e-12
"""The same of plain sums, relative to the size of what is summed."""

T = 320
AB = slice(0, 6)
C = slice(6, 14)
"""Parameters of A and B, and of C, which a prior of precision e³² holds: next to that all else is rounded."""

logged = mark.parametrize("number", [1, 2, 3])
every = mark.parametrize("number", range(1, 21))


@cache
def case_a():
    return case_a_model(load("case_a_data"))


@cache
def twenty():
    return load("case_a_octave")


@cache
def first_three():
    return load("case_a_debug_it1to3")


@cache
def embedded():
    """Their [ỹ; η̃], (320, 31); they keep η̃ with the opposite sign."""
    return twenty()["Y_embed"].T * np.repeat([1.0, -1.0], [28, 3])


@dataclass(frozen=True)
class Iteration:
    """One of theirs, counted from 1.

    All of it is made with θ of its start, and the noise precisions that the M step before it had one substep before its
    end; ``F_exp_h`` are those of its own M step one substep before the end.
    """

    number: int

    def of(self, name):
        return twenty()[name][:, self.number - 1]

    def log(self, name):
        return first_three()[f"dbg{self.number}_{name}"].squeeze()

    @property
    def theta(self):
        return self.of("theta_used")

    @property
    def weights(self):
        return self.of("D_step_exp_h")

    @cached_property
    def moments(self):
        return as_published.moments(case_a(), embedded(), twenty()["DEM_x_all"][self.number - 1])

    @property
    def state_precision(self):
        return -state_curvature(case_a(), self.theta, self.weights)


def equal(actual, theirs):
    """Within rounding of the largest."""
    assert_allclose(actual, theirs, rtol=0, atol=ROUNDING * abs(theirs).max())


def equal_by_unit(actual, theirs):
    """Within rounding, for matrices whose rows have different units."""
    unit = np.sqrt(theirs.diagonal())
    assert_allclose(
        actual / unit / unit[:, None], theirs / unit / unit[:, None], rtol=0, atol=ROUNDING
    )


def test_noise_precisions_are_theirs():
    theirs = twenty()
    (of_y, of_v, of_x) = case_a().errors
    for weights, names in (
        (np.ones(2), ("Q_V0y", "Q_W0")),
        (theirs["F_exp_h"][:, -1], ("V0y", "W0")),
    ):
        precision = case_a().precision(weights)
        equal_by_unit(precision[of_y, of_y], theirs[names[0]])
        equal_by_unit(precision[of_x, of_x], theirs[names[1]])
        equal_by_unit(precision[of_v, of_v], theirs["V0v"])


def test_embedding_is_theirs():
    data = load("case_a_data")
    # A derivative is a sum of samples whose weights grow with its order and cancel: so does what rounding leaves.
    of_y, of_u = (
        abs(samples).max()
        * abs(taylor_weights(order, data["dt"].item(), order + 1, order // 2)).sum(axis=1)
        for samples, order in ((data["y"], 6), (data["u"], 2))
    )
    size = np.append(np.repeat(of_y, 4), of_u)
    assert_allclose(case_a_generalized(data) / size, embedded() / size, rtol=0, atol=SUMS)


@logged
def test_sums_slopes_and_curvatures_are_theirs(number):
    """What they take a step with has a factor 10, an integration time, and the states' mean field once a sample."""
    it = Iteration(number)
    prior = case_a().prior
    equal_by_unit(it.state_precision, it.log("Pu"))
    equal_by_unit(it.moments.errors(it.theta), it.log("EE"))
    curvature = theta_curvature(case_a(), it.moments, it.weights)
    for theirs in (it.log("AA"), it.log("dFdpp") / 10 - T * it.log("dWdpp")):
        equal(curvature[AB, AB], theirs[AB, AB])
        last_place = np.spacing(prior.theta_precision.max())
        assert_allclose(curvature[C, C], theirs[C, C], rtol=0, atol=2 * last_place)
    slope = as_published.internal_slope(case_a(), it.moments, it.theta, it.weights)
    theirs = it.log("dFdp") / 10 - T * it.log("dWdp")
    equal(slope[AB], theirs[AB])
    # Theirs is the difference of two numbers of this size.
    size = abs(prior.theta_precision @ it.theta).max()
    assert_allclose(slope[C], theirs[C], rtol=0, atol=2 * np.spacing(size))


def lost(it):
    """One unit in the last place of the largest precision of the states, next to the least that is not left out."""
    precisions = np.linalg.svd(it.state_precision, compute_uv=False)
    unit = np.spacing(precisions[0])
    return unit / precisions[precisions > len(precisions) * unit][-1]


@every
def test_terms_of_the_free_energy_are_theirs(number):
    """At three different λ, of which each term says its own; the prior of θ is taken about zero."""
    it = Iteration(number)
    model = case_a()
    theirs = it.of("temp")
    about_zero = replace(model, prior=model.prior._replace(theta_mean=np.zeros_like(it.theta)))
    belief = Belief(
        it.moments,
        # Of the D step, before λ is updated.
        np.linalg.inv(as_published.ridged(it.state_precision)),
        it.theta,
        np.linalg.inv(as_published.ridged(-theta_curvature(model, it.moments, it.weights))),
        np.log(it.of("F_exp_h")),
        inverse(as_published.fisher_information(model, T)),
    )
    samples = SufficientStatistics(T, it.moments.gram)
    terms = optimal_terms(about_zero, samples, belief)
    after = optimal_terms(
        about_zero, samples, belief._replace(lambda_=twenty()["h_mem"][:, number])
    )
    ours = [
        sum(terms[f"prediction error of {what}"] for what in ("outputs", "inputs", "states")),
        terms["state and input entropy"],
        terms["noise entropy"],
        terms["prediction error of parameters"],
        terms["parameter entropy"],
        after["prediction error of hyperparameters"],
        terms["hyperparameter entropy"],
    ]
    assert_allclose(ours, theirs[:7], rtol=ROUNDING)
    # Their sum has the constant that ours leaves out. It is rounded to 2⁻⁷ at each of seven terms, and at each of the
    # 14 parameters in the largest.
    constant = -0.5 * (model.p + 1) * model.m * T * np.log(2 * np.pi)
    assert sum(ours) + constant == approx(theirs[7], rel=0, abs=21 * np.spacing(-theirs[7]))
