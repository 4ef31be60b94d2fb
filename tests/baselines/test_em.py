import sys

import numpy as np
import pytest
from innovation_systems import random_system
from oracle import load, needs_oracle
from peculiar_flights import (
    TRAIN,
    growing,
)
from scipy.stats import chi2

from mavdem import Flight, baselines, evaluate
from mavdem.baselines.expectation_maximization import LEAST_NOISE, iterated
from mavdem.baselines.identified import Units
from mavdem.dem.engine.kalman import GaussianModel, smoothed
from mavdem.dem.record import Record


def noisy_system(order):
    """With noises of states and outputs that do not know of each other."""
    system = random_system(order, order, noise=1.0)
    return GaussianModel(
        system.A,
        0.5 * system.B,
        system.offset,
        system.C,
        np.array([0.3, -0.2]),
        Q=0.05 * np.eye(order),
        R=0.1 * np.eye(2),
    )


def flown(model, seed, samples, feedback=None):
    """Inputs and outputs of a Gaussian model under white inputs, which with ``feedback`` answer the outputs too."""
    rng = np.random.default_rng(seed)
    inputs, state = rng.standard_normal((samples, model.B.shape[1])), rng.standard_normal(len(model.A))
    outputs = np.empty((samples, len(model.C)))
    Q, R = np.linalg.cholesky(model.Q), np.linalg.cholesky(model.R)
    for t, u in enumerate(inputs):
        outputs[t] = model.C @ state + model.trim + R @ rng.standard_normal(len(R))
        if feedback is not None:
            u += feedback @ outputs[t]
        state = model.A @ state + model.B @ u + model.offset + Q @ rng.standard_normal(len(Q))
    return inputs, outputs


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 4])
@pytest.mark.parametrize("feedback", [None, 0.5 * np.eye(2)], ids=["open", "closed"])
def test_a_system_is_recovered_as_well_as_can_be(order, feedback):
    """Twice what the likelihood gains over the truth is χ² in as many parameters as data can tell (Wilks)."""
    truth = noisy_system(order)
    segments = [flown(truth, order, 800, feedback), flown(truth, order + 10, 400, feedback)]
    found = iterated(segments, order).log_likelihoods[-1]
    of_truth = sum(smoothed(truth, np.zeros(order), *segment).log_likelihood for segment in segments)
    # Input and noise answers, the noises' size, what is constant, and where two segments begin.
    freedom = order * (2 + 2 * 2) + 3 + 2 + 2 * order
    assert 0 < 2 * (found - of_truth) < chi2.ppf(1 - 1e-5, freedom)


@pytest.mark.slow
@pytest.mark.parametrize("order", [3])
@pytest.mark.parametrize("train", [TRAIN, [TRAIN[:300], TRAIN[310:]], growing()], ids=["windy", "cut", "growing"])
def test_the_likelihood_rises_and_covariances_stay_positive(order, train):
    record = Record.of(train)
    segments = Units.of(record).segments(record)
    fitted = iterated(segments, order, 40)
    likelihoods = np.array(fitted.log_likelihoods)
    assert np.diff(likelihoods).min() > -1e-8 * np.abs(likelihoods).max()
    for covariance in (fitted.model.Q, fitted.model.R):
        assert np.linalg.eigvalsh(covariance).min() > 0.99 * LEAST_NOISE


@needs_oracle
def test_the_authors_em_is_matched_within_its_spread_over_starts():
    """Simulated System 2 of the paper: errors of the 150 samples after training, from the last estimate and from 0."""
    data, theirs = load("case_c2_data_p2"), load("case_c2_em")
    step = data["dt"].item()
    flight = Flight(step * np.arange(850), data["u_full"].T, data["y_full"])
    train, test = flight[:700], flight[700:]
    em = baselines.em(train, 2)
    for from_zero, name in ((False, "mspe_x0last_aligned"), (True, "mspe_x0zero")):
        ours = evaluate.mspe(test.outputs, em.forecast(test.inputs, from_zero)).total
        assert theirs[name].min() < ours < theirs[name].max()
    # From the estimate at the end of training it is better than most of theirs.
    assert evaluate.mspe(test.outputs, em.forecast(test.inputs)).total < np.median(theirs["mspe_x0last_aligned"])


def test_a_breakdown_is_an_error(monkeypatch):
    def breaks_down(*arguments):
        raise np.linalg.LinAlgError

    monkeypatch.setattr(sys.modules["mavdem.baselines.expectation_maximization"], "iterated", breaks_down)
    with pytest.raises(ValueError, match="^EM for 2 states broke down"):
        baselines.em(TRAIN[:300], 2)
