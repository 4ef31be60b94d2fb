"""This engine beside the code of the paper's authors: their noise and embedding, and where both end."""

from dataclasses import replace
from functools import cache

import numpy as np
from numpy.testing import assert_allclose
from oracle import case_a_generalized, case_a_model, case_a_truth, load, needs_oracle
from pytest import approx, mark, param

import mavdem
from mavdem.dem.engine.ascent import posterior_after_each_round
from mavdem.dem.engine.free_energy import SampleFreeEnergy
from mavdem.dem.engine.generalized_coordinates import taylor_weights
from mavdem.dem.engine.moments import SufficientStatistics

pytestmark = needs_oracle


def test_case_a_ends_near_theirs_and_nearer_the_truth():
    """On their 320 samples, zeroed edges and all, this engine's own rounds: exact steps on one F̄, no departures.

    Their λʷ is not compared: 12.55 at iteration 150, it is still on its way, as published to 13.35. Ours passes 12.55
    at about round 113, is 13.54 at round 150 and 15.66 at the maximum of F̄, with θ within 0.003 of theirs at each.
    """
    data = load("case_a_data")
    theirs = load("case_a_octave_150it")
    model = case_a_model(data)
    samples = case_a_generalized(data)
    truth = case_a_truth(data)
    posteriors = posterior_after_each_round(model, SufficientStatistics.from_segments(samples), 150)
    published = theirs["theta"].ravel()
    # Measured: 0.0085 from their 20th after 20 rounds, 0.0020 from their 150th after 150.
    for rounds in (20, 150):
        assert abs(posteriors[rounds].theta - theirs["theta_mem"][:, rounds]).max() < 1e-2
    assert np.linalg.norm(posteriors[-1].theta - truth) < np.linalg.norm(published - truth)
    assert posteriors[-1].lambda_[0] == approx(theirs["h"].ravel()[0], abs=0.1)
    free_energies = [
        SampleFreeEnergy.from_posterior(posterior).evaluate(samples).sum()
        for posterior in posteriors
    ]
    assert (np.diff(free_energies) >= 0).all()


MANY_PRIORS, SOME_PRIORS = 40, 10
"""Draws of the random prior: ascents from it end at different maxima, so one alone says little."""


@mark.slow
@mark.parametrize(
    "p, settings, priors, share",
    [
        param(2, {}, MANY_PRIORS, 0.9, marks=mark.in_full),
        (1, {"p": 1, "d": 1, "window": 2}, SOME_PRIORS, 0.25),
    ],
    ids=["with generalized coordinates", "without"],
)
def test_case_c2_is_forecast_no_worse_than_by_them(p, settings, priors, share):
    """Theirs is one draw of the prior. With p = 2 nine of ten of ours forecast no worse than that one.

    With p = 1 the model is biased by the late derivative, whoever learns it: theirs lies among ours, nearer the better
    ones (measured over 60 draws: 38 % of ours no worse, the middle one 0.0254 where theirs is 0.0225).
    Both forecasts start from the end of training.
    """
    data, theirs = (load(f"case_c2_{kind}_p{p}") for kind in ("data", "octave"))
    dt = data["dt"].item()
    flight = mavdem.Flight(dt * np.arange(850), data["pwm"].T, data["y_full"])
    errors = []
    for seed in range(priors):
        learned = mavdem.learn(flight[:700], replace(mavdem.Settings.paper(seed=seed), **settings))
        errors.append(
            mavdem.evaluate.mspe(flight.outputs[700:], learned.forecast(flight.inputs[700:])).total
        )
    assert np.mean(np.array(errors) <= theirs["mspe_x0last"].item()) >= share


ROUNDING = 1e-9
"""Relative difference allowed between two computations of one thing."""

SUMS = 1e-12
"""The same of plain sums, relative to the size of what is summed."""


@cache
def case_a():
    return case_a_model(load("case_a_data"))


@cache
def twenty():
    return load("case_a_octave")


@cache
def embedded():
    """Their [ỹ; η̃], (320, 31); they keep η̃ with the opposite sign."""
    return twenty()["Y_embed"].T * np.repeat([1.0, -1.0], [28, 3])


def equal_by_unit(actual, theirs):
    """Within rounding, for matrices whose rows have different units."""
    unit = np.sqrt(theirs.diagonal())
    assert_allclose(
        actual / unit / unit[:, None], theirs / unit / unit[:, None], rtol=0, atol=ROUNDING
    )


def test_noise_precisions_are_theirs():
    theirs = twenty()
    of_y, of_v, of_x, _ = case_a().error_rows
    for weights, names in (
        (np.ones(2), ("Q_V0y", "Q_W0")),
        (theirs["F_exp_h"][:, -1], ("V0y", "W0")),
    ):
        precision = case_a().error_precision(weights)
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
