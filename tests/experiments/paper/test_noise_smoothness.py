"""The smoothness of noise by F̄: its gradient and its maximum by brute force, and the checks on what it earns."""

import numpy as np
from pytest import approx, fixture, mark

from mavdem.experiments.paired_test import Paired
from mavdem.experiments.paper.estimation import noise_smoothness
from mavdem.experiments.paper.estimation.dem_covariance import generalized_data
from mavdem.experiments.paper.estimation.noise_smoothness import (
    SimulatedResult,
    coverage_check,
    fit_with_known_variances,
    learned_smoothness_check,
)
from mavdem.experiments.paper.estimation.noisy_records import random_record
from mavdem.experiments.paper.estimation.smoothness_learning import (
    learn_smoothness,
    smoothness_gradient,
    smoothness_uncertainty,
)
from mavdem.experiments.paper.runner import Runner

TRUE_SMOOTHNESS = 0.4
GRID = (0.1, 0.2, 0.4, 0.8, 1.6)


@fixture(scope="module")
def known_record():
    """A record with known variances: its generalized data, and the fit for one smoothness."""
    record = random_record(seed=0, smoothness=TRUE_SMOOTHNESS)
    data = generalized_data(record)
    return record, data, fit_with_known_variances(record, data)


def test_the_gradient_by_smoothness_is_the_difference_of_free_energies(known_record):
    """The gradient by ln s is compared with a central difference of the free energy."""
    _, _, fit_at = known_record
    for smoothness in (0.3, 0.5):
        above = fit_at(smoothness * np.exp(1e-3)).free_energy
        below = fit_at(smoothness * np.exp(-1e-3)).free_energy
        gradient = smoothness_gradient(fit_at(smoothness).posterior)
        assert gradient == approx((above - below) / 2e-3, rel=1e-4)


@mark.slow
def test_the_learned_smoothness_is_the_maximum_on_a_fine_grid_and_near_the_true_one(known_record):
    record, data, fit_at = known_record
    learned = learn_smoothness(fit_at, GRID)
    fine_grid = TRUE_SMOOTHNESS * np.exp(np.linspace(-0.5, 0.5, 101))
    best = fine_grid[np.argmax([fit_at(smoothness).free_energy for smoothness in fine_grid])]
    assert learned.is_inside
    assert np.log(learned.smoothness / best) == approx(0.0, abs=0.015)
    assert learned.smoothness == approx(TRUE_SMOOTHNESS, rel=0.1)
    uncertainty = smoothness_uncertainty(learned, fit_at, data, record.dt)
    assert uncertainty.sandwich > uncertainty.laplace


def test_a_maximum_at_the_edge_of_the_grid_is_marked(known_record):
    _, _, fit_at = known_record
    assert not learn_smoothness(fit_at, (0.05, 0.1)).is_inside


def test_coverage_and_gain_have_their_bars():
    covering = [SimulatedResult(0.0, laplace_covers=False, sandwich_covers=True)] * 9
    missing = [SimulatedResult(0.5, laplace_covers=False, sandwich_covers=False)]
    assert coverage_check({3: covering + missing}).holds
    assert not coverage_check({3: covering + missing, 2: missing}).holds
    lower = Paired(ratio=0.9, less=8, windows=9, tested=4, tested_less=3, p_value=0.1)
    assert learned_smoothness_check({"alone": lower}).holds
    assert not learned_smoothness_check(
        {"alone": lower, "with fit": lower._replace(ratio=0.97)}
    ).holds


@mark.slow
def test_without_recorded_flights_only_simulated_noise_is_examined(monkeypatch):
    monkeypatch.setattr(noise_smoothness, "TRUE_WIDTHS", (3,))
    monkeypatch.setattr(noise_smoothness, "RECORD_COUNT", 2)
    result = noise_smoothness.run(Runner(experiment_numbers=()))
    assert len(result.checks) == 1 and len(result.numbers["simulated"]["3"]) == 2
    assert result.tables[1].rows[0][0] == "3 dt"
    assert "--flights" in result.remarks[0]
