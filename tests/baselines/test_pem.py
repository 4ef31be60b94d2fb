import sys

import numpy as np
import pytest
from innovation_systems import flown, random_system
from peculiar_flights import (
    TRAIN,
    growing,
)
from scipy.stats import chi2
from standard_errors import Bound

from mavdem import baselines
from mavdem.baselines import prediction_error_method as errors_and_slopes
from mavdem.baselines.prediction_error_method import FreeParameters, prediction_errors, sensitivities


def determinant(identified):
    """Of the covariance of the one-step errors, as a logarithm; outputs in units of their own deviation."""
    errors = (identified.record.outputs - identified.one_step()) / identified.record.outputs.std(axis=0)
    return np.linalg.slogdet(errors.T @ errors / len(errors))[1]


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("feedback", [None, -0.3 * np.eye(2)], ids=["open", "closed"])
def test_a_system_is_recovered_as_well_as_can_be(order, feedback):
    """Errors in units of the Cramér-Rao bound are χ², in open and in closed loop."""
    system = random_system(order, order)
    flight, _ = flown(system, 1, 4000, push=1.0 if feedback is None else 0.1, feedback=feedback)
    bound = Bound(system, flight, 0.1)
    distance = bound.distance(baselines.pem(flight, order).model) * bound.freedom
    assert chi2.ppf(1e-5, bound.freedom) < distance < chi2.ppf(1 - 1e-5, bound.freedom)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("worst_modes", [0, 1e8], ids=["by sample", "by mode"])
def test_sensitivities_are_the_slopes_of_the_errors(order, worst_modes, monkeypatch):
    monkeypatch.setattr(errors_and_slopes, "WORST_MODES", worst_modes)
    system = random_system(order, order)
    flight, _ = flown(system, 0, 100)
    segments = [(flight.inputs[a:b], flight.outputs[a:b]) for a, b in ((0, 50), (60, 100))]
    rng = np.random.default_rng(0)
    starts = rng.standard_normal((2, order))
    parameters = FreeParameters(system.A, system.B, system.C, system.K, system.offset, starts)
    vector = parameters.vector()

    def errors(change):
        return prediction_errors(parameters.of(vector + change), system, segments)

    slopes = sensitivities(parameters, system, segments)
    for i, step in enumerate(1e-6 * np.eye(len(vector))):
        numerical = (errors(step) - errors(-step)) / 2e-6
        np.testing.assert_allclose(slopes[:, :, i], numerical, atol=1e-6 * np.abs(slopes).max())


@pytest.mark.slow
@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("train", [TRAIN, growing(), [TRAIN[:300], TRAIN[310:]]], ids=["windy", "growing", "cut"])
def test_errors_are_never_above_those_of_the_subspace_model(order, train):
    pem = baselines.pem(train, order)
    assert determinant(pem) < determinant(baselines.subspace(train, order)) + 1e-9
    assert np.abs(np.linalg.eigvals(pem.model.A - pem.model.K @ pem.model.C)).max() < 1


def test_what_has_not_settled_is_said(monkeypatch):
    module = sys.modules["mavdem.baselines.prediction_error_method"]
    monkeypatch.setattr(module, "REWEIGHTINGS", 1)
    monkeypatch.setattr(module, "EVALUATIONS", 2)
    assert any("still falling" in caution for caution in baselines.pem(TRAIN, 4).cautions)
