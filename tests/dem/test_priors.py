"""Priors of any mean and precision, through the settings and through the generative model itself."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, mark, raises
from refusals import refused
from scipy.linalg import expm
from simulated import DT, GAIN, RATE, simulated

from mavdem import Flight, Settings, learn
from mavdem.dem import Gaussian
from mavdem.dem.engine.model import pack, unpack
from mavdem.dem.engine.state_space import filter_gain
from mavdem.dem.priors import explicit_prior
from mavdem.facts.model import ModelRefusal

KNOWN = 1e8


def roll_prior():
    """Kinematics and C known, the rate's equation open; physical units."""
    mean = pack(np.array([[0.0, 1.0], [-5.0, -2.0]]), np.array([np.zeros(4), GAIN]), np.eye(2))
    precision = pack(
        np.array([[KNOWN, KNOWN], [1e-3, 1e-3]]),
        np.array([np.full(4, 1e4 * KNOWN), np.full(4, 1e-3)]),
        np.full((2, 2), KNOWN),
    )
    return Gaussian(mean, precision)


SETTINGS = Settings(order=2, window=3, prior=roll_prior(), parameter_precision=0.01)


@mark.slow
def test_a_prior_in_physical_units_means_the_same_in_any_scaling():
    """Learned with scaled and with unscaled channels, the model is the same."""
    flight = simulated(wind=0.2)[:700]
    scaled = learn(flight, SETTINGS)
    # As they are: the prior then has no trim to learn beside it, so the trims are taken off first.
    inputs, outputs = (table - table.mean(axis=0) for table in (flight.inputs, flight.outputs))
    centred = replace(flight, inputs=inputs, outputs=outputs)
    learned_unscaled = learn(centred, replace(SETTINGS, scaling="none", lambda_w=0.0))
    for learned in (scaled, learned_unscaled):
        assert_allclose(learned.model.A[1], [-9, -RATE], rtol=0.15)
        assert_allclose(learned.model.B[1], GAIN, rtol=0.15)
    assert_allclose(scaled.model.A, learned_unscaled.model.A, atol=0.1)
    assert_allclose(scaled.model.B, learned_unscaled.model.B, atol=2e-3)
    mean, precision = explicit_prior(Gaussian([6.0], 3.0), 0.5, np.array([1]), np.array([7.0, 2.0]))
    assert_array_equal(mean, [0.0, 3.0])
    assert_array_equal(precision, np.diag([0.5, 12.0]))


@mark.slow
def test_a_known_parameter_stays_and_coupled_ones_may_be_known_by_their_sum_alone():
    """A precision matrix with off-diagonal entries: the first two motors' gains must cancel."""
    off = 1.3
    prior = roll_prior()
    mean = np.array(prior.mean)
    precision = np.array(prior.precision)
    precision[np.ix_([8, 9], [8, 9])] += 1e8 * np.ones((2, 2))
    mean[8:10] = 0.3, -0.3
    mean[12:] *= off
    learned = learn(simulated(wind=0.1)[:700], replace(SETTINGS, prior=Gaussian(mean, precision)))
    assert abs(learned.model.B[1, 0] + learned.model.B[1, 1]) < 1e-3
    assert learned.model.B[1, 0] == approx(GAIN[0] / off, rel=0.2)
    # To within five of the prior's standard deviations, 1e-4 each.
    assert_allclose(learned.model.C, off * np.eye(2), atol=5e-4)
    A, B, C = unpack(learned.known, 2, 4, 2)
    assert C.all() and A[0].all() and B[0].all() and not A[1].any() and not B[1, 2:].any()


def test_a_state_that_no_output_shows_breaks_the_fit_down():
    A = np.diag([0.0, -RATE])
    C = np.array([[0.0, 1.0], [0.0, 1.0]])
    unseen = Gaussian(pack(A, np.array([np.zeros(4), GAIN]), C), KNOWN)
    fact = refused(learn, simulated(wind=0.1)[:700], replace(SETTINGS, prior=unseen))
    assert fact.code is ModelRefusal.FIT_BREAKS_DOWN


@mark.slow
def test_unknown_inputs_are_process_noise_of_the_filter():
    """What is not known of them moves the state as well, so the filter counts it with the process noise."""
    outputs = simulated(samples=300, wind=0.5).outputs
    A = np.array([[0.0, 1.0], [-9.0, -RATE]])
    B = np.array([[0.0], [1.0]])
    settings = Settings(
        order=2,
        window=3,
        smoothness=0.3,
        prior=Gaussian(pack(A, B, np.eye(2)), KNOWN),
        scaling="none",
        known_inputs=False,
        input_precision=0.1,
        lambda_w=10.0,
        lambda_log_precision=(25.0, np.log(1e4)),
        parameter_precision=1.0,
    )
    learned = learn(Flight(DT * np.arange(300), np.zeros(300), outputs), settings)
    A, B, C = unpack(learned.theta, 2, 1, 2)
    output_noise_variance, state_noise_variance = np.exp(-learned.learning.lambda_[-1])
    process_noise = state_noise_variance * np.eye(2) + B @ B.T / settings.input_precision
    expected = filter_gain(A, C, DT, np.full(2, output_noise_variance), process_noise, 0.3)
    # A Riccati equation is solved to rounding relative to the whole matrix, not to an element that is 5e-5 of it.
    expected = expm(A * DT) @ expected
    assert_allclose(learned.predictor.K, expected, rtol=0, atol=1e-9 * abs(expected).max())
    # Nothing is known of inputs to come, whatever is handed in.
    assert_array_equal(learned.forecast(np.ones((20, 1))), learned.forecast(np.zeros((20, 1))))


@mark.slow
@mark.parametrize("p, d", [(0, 6), (6, 0)])
def test_every_order_from_zero_to_six_can_be_learnt(p, d):
    window = max(p, d) + 1
    settings = Settings(
        order=2, p=p, d=d, window=window + 1 - window % 2, parameter_precision=1.0, iterations=5,
        correlation="continuous",
    )  # fmt: skip
    learned = learn(simulated(wind=0.5)[:120], settings)
    assert np.isfinite(learned.forecast(np.full((20, 4), 1500.0))).all()
    assert (np.diff(learned.free_energy.total) >= 0).all()
    assert len(learned.process_noise()[0]) == len(learned.free_energy_of_samples)


@mark.parametrize(
    "mean, precision, named",
    [
        ([np.nan], 1.0, "^mean"),
        ([1.0, 2.0], [[1.0]], "^precision must have shape"),
        ([1.0, 2.0], [[1.0, 2.0], [2.0, 1.0]], "^precision must be positive definite"),
        ([1.0, 2.0], [[1.0, 0.5], [0.0, 1.0]], "^precision must be symmetric"),
    ],
)
def test_what_is_no_gaussian_is_named(mean, precision, named):
    with raises(ValueError, match=named):
        Gaussian(mean, precision)


@mark.parametrize(
    "settings, named",
    [
        ({"prior": Gaussian([0.0] * 3, 1.0)}, "^prior must be of the 16 parameters"),
        (
            {"prior": Gaussian([0.0] * 16, 1.0)},
            '^correlation must be "continuous" with a prior that leaves C free',
        ),
    ],
)
def test_settings_that_do_not_fit_the_flight_are_named(settings, named):
    with raises(ValueError, match=named):
        learn(simulated()[:200], Settings(order=2, window=3, parameter_precision=1.0, **settings))
