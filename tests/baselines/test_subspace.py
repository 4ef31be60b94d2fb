import numpy as np
import pytest
from innovation_systems import flown, random_system
from peculiar_flights import (
    errors_of,
)
from standard_errors import Bound

from mavdem import baselines


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_a_system_is_recovered_to_within_three_times_what_an_efficient_estimate_errs(order):
    """At 16 times the samples no less, which a biased one would miss by four times more."""
    system = random_system(order, order)
    for samples in (1000, 16_000):
        flight, _ = flown(system, 1, samples)
        bound = Bound(system, flight, 0.1)
        assert bound.distance(baselines.subspace(flight, order).model) < 3**2


def test_state_is_carried_over_from_the_end_of_training_and_begins_at_zero_when_asked():
    system = random_system(1, 2)
    flight, _ = flown(system, 1, 450, noise=0.0)
    subspace = baselines.subspace(flight[:300], 2)
    (A, B, C, _, _, offset, input_trim, output_trim, *_), ahead = subspace.model, flight.inputs[300:]
    state, forecast = np.zeros(2), []
    for inputs in ahead:
        forecast.append(C @ state + output_trim)
        state = A @ state + B @ (inputs - input_trim) + offset
    np.testing.assert_allclose(subspace.forecast(ahead, from_zero=True), forecast, atol=1e-9)
    # Row 0 is the sample after training: the last training input acts on it, its own input does not.
    changed = ahead.copy()
    changed[0] += 1
    np.testing.assert_allclose(subspace.forecast(changed)[0], subspace.forecast(ahead)[0])
    assert np.abs(subspace.forecast(changed)[1] - subspace.forecast(ahead)[1]).max() > 0.01


def test_segments_are_learnt_from_together_and_nothing_across_gaps():
    system = random_system(1, 2)
    flight, _ = flown(system, 1, 900, noise=0.0)
    segments = [flight[:200], flight[300:303], flight[420:600], flight[610:800]]
    subspace = baselines.subspace(segments, 2)
    together = np.vstack([segment.outputs for segment in segments])
    assert subspace.one_step().shape == together.shape
    # A segment too short for a window is predicted like the others.
    assert np.abs(subspace.one_step() - together).max() < 1e-5 * together.std()
    assert errors_of(subspace.forecast(flight.inputs[800:]), flight[800:]) < 1e-5
