"""Against the results of the paper's authors' own code, where they are at hand."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mavdem
from mavdem.dem.ascent import ascend
from mavdem.dem.coordinates import embed
from mavdem.dem.generative import GenerativeModel, Samples
from mavdem.dem.priors import Prior
from mavdem.dem.smoothness import temporal_precision

SHARED = Path(os.environ.get("MAVDEM_SHARED_DATA", Path(__file__).parents[3] / "shared" / "data"))
ORACLE = SHARED / "oracle"

pytestmark = pytest.mark.skipif(not ORACLE.is_dir(), reason=f"the authors' results are not in {ORACLE}")

EDGE = 7
"""Samples at either end of case a whose derivatives the authors set to zero."""


def case_a():
    return np.load(ORACLE / "case_a_data.npz"), np.load(ORACLE / "case_a_octave_150it.npz")


def generalized(data):
    """Outputs (p = 6) and inputs (d = 2) of case a, about the same instants, without the edges."""
    dt = float(data["dt"].item())
    outputs, inputs = embed(data["y"], 6, dt, 7, 3), embed(data["u"].T, 2, dt, 3, 1)[2:-2]
    return outputs[EDGE - 3 : -EDGE + 2], inputs[EDGE - 3 : -EDGE + 2]


def test_noise_correlation_and_embedding_are_theirs():
    data, theirs = case_a()
    S = temporal_precision(6, float(data["s"].item()))
    precision = np.kron(S, np.eye(4))
    scale = np.sqrt(np.outer(np.diag(precision), np.diag(precision)))
    np.testing.assert_allclose(theirs["Q_V0y"] / scale, precision / scale, atol=1e-9)
    outputs, inputs = generalized(data)
    embedded = theirs["Y_embed"][:, EDGE : -EDGE - 1].T
    np.testing.assert_allclose(
        outputs / embedded[:, :28].std(axis=0), embedded[:, :28] / embedded[:, :28].std(axis=0), atol=1e-9
    )
    np.testing.assert_allclose(inputs, -embedded[:, 28:], atol=1e-9)


def test_case_a_ends_nearer_the_truth_than_theirs():
    data, theirs = case_a()
    prior_mean = np.concatenate([data[name].ravel() for name in ("A_prior", "B_prior", "C_prior")])
    model = GenerativeModel(
        n=2,
        r=1,
        m=4,
        p=6,
        d=2,
        q=6,
        output_correlation=temporal_precision(6, float(data["s"].item())),
        state_correlation=temporal_precision(6, float(data["s"].item())),
        output_groups=np.zeros(4, np.intp),
        state_groups=np.ones(2, np.intp),
        input_precision=theirs["V0v"],
        prior=Prior(prior_mean, data["P_theta"], np.zeros(2), data["P_lambda"]),
    )
    climb = ascend(model, Samples.of(np.hstack(generalized(data))), 150)
    truth = np.concatenate([data[name].ravel() for name in ("A", "B", "C")])
    ours, published = climb.theta[-1], theirs["theta"].ravel()
    assert np.linalg.norm(ours - truth) < np.linalg.norm(published - truth)
    assert climb.lambda_[-1][0] == pytest.approx(theirs["h"].ravel()[0], abs=0.1)
    assert (np.diff(climb.free_energy) >= 0).all()


@pytest.mark.parametrize(
    ("p", "settings"),
    [(2, {}), (1, {"p": 1, "d": 1, "window": 2})],
    ids=["with generalized coordinates", "without"],
)
def test_case_c2_is_forecast_no_worse_than_by_them(p, settings):
    data, theirs = (np.load(ORACLE / f"case_c2_{kind}_p{p}.npz") for kind in ("data", "octave"))
    dt = float(data["dt"].item())
    flight = mavdem.Flight(dt * np.arange(850), data["pwm"].T, data["y_full"])
    errors = []
    for seed in range(10):
        learned = mavdem.learn(flight[:700], replace(mavdem.Settings.paper(seed=seed), **settings))
        errors.append(mavdem.evaluate.mspe(flight.outputs[700:], learned.forecast(flight.inputs[700:])).total)
    # Their one random prior against the middle of ten of ours; both forecasts start from the end of training.
    assert np.median(errors) <= theirs["mspe_x0last"].item()
