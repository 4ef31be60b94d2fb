"""How often the posterior holds parameters, and what the data did not determine."""

import calibration
import numpy as np
import pytest
from simulated import simulated

from mavdem import Flight, Settings, learn
from mavdem.confidence import half_width, quantile, require_probability
from mavdem.dem.fitting import marginal_information, undetermined_directions


@pytest.mark.slow
def test_intervals_hold_parameters_where_the_assumptions_hold(monkeypatch):
    monkeypatch.setattr(calibration, "SYSTEMS", 60)
    coverage = calibration.coverage(18.0, 2.0, 150, 0.1)
    assert 0.85 <= coverage <= 0.95


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
