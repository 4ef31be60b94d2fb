"""Identified models: what each recovers, beside bounds and other libraries, and what holds of every one of them."""

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose
from peculiar_flights import (
    FLIGHT,
    NOTHING_NEW,
    TEST,
    TRAIN,
    back_from_other_units,
    errors_of,
    growing,
    in_other_units,
    with_inputs,
)
from pytest import mark, param, raises
from refusals import refused
from scipy.stats import chi2

from mavdem import Flight, Forecaster, baselines
from mavdem.baselines import StateSpace
from mavdem.dem.engine.kalman import LinearGaussianModel, smooth_states
from mavdem.dem.engine.linalg import ROUNDING_TOLERANCE
from mavdem.dem.record import Record
from mavdem.experiments.methods import maximum_likelihood, subspace_identification
from mavdem.experiments.methods.maximum_likelihood import iterate_em
from mavdem.experiments.methods.scaling import NormalizedUnits
from mavdem.facts.forecasts import ForecastFact

NO_FEEDBACK = np.zeros((2, 2))


@mark.in_full
@mark.parametrize("order", [1, 4])
def test_subspace_identification_errs_at_most_three_times_an_efficient_estimate(
    order,
):
    """At 16 times the samples no less, which a biased one would miss by four times more."""
    system = random_system(order, order)
    for samples in (500, 8000):
        model = baselines.subspace(simulated_flight(system, 1, samples), order).model
        assert error_of(model, system, samples) < 3**2 * freedom(order)


def test_segments_are_learnt_from_together_and_nothing_across_gaps():
    system = random_system(1, 2)
    flight = simulated_flight(system, 1, 900, noise=0.0)
    segments = [flight[:200], flight[300:303], flight[420:600], flight[610:800]]
    subspace = baselines.subspace(segments, 2)
    # A segment too short for a window is predicted like the others.
    assert subspace.one_step().shape == (573, 2)
    assert errors_of(subspace.forecast(flight.inputs[800:]), flight[800:]) < 1e-5


@mark.slow
@mark.parametrize(
    "order, feedback",
    [(1, NO_FEEDBACK), (4, -0.3 * np.eye(2))],
    ids=["1 open", "4 closed"],
)
def test_a_system_is_recovered_as_well_as_can_be(order, feedback):
    """Errors are χ², in open and in closed loop."""
    system = random_system(order, order)
    options = {"push": 0.1 if feedback.any() else 1.0, "feedback": feedback}
    model = baselines.pem(simulated_flight(system, 1, 2000, **options), order).model
    least, most = chi2.ppf([1e-5, 1 - 1e-5], freedom(order))
    assert least < error_of(model, system, 2000, **options) < most


def test_what_has_not_settled_is_said(monkeypatch):
    monkeypatch.setattr(maximum_likelihood, "MAX_ITERATIONS", 1)
    cautions = [caution.code for caution in baselines.pem(TRAIN, 1).cautions]
    assert ForecastFact.STILL_IMPROVING in cautions


def noisy_system(order):
    """With noises of states and outputs that do not know of each other."""
    system = random_system(order, order, noise=1.0)
    Q, R = 0.05 * np.eye(order), 0.1 * np.eye(2)
    return LinearGaussianModel(
        system.A, 0.5 * system.B, system.offset, system.C, np.array([0.3, -0.2]), Q=Q, R=R
    )


def flown_with_noise(model, seed, samples, feedback=NO_FEEDBACK):
    """Inputs and outputs of a Gaussian model under white inputs, which with ``feedback`` answer the outputs too."""
    rng = default_rng(seed)
    pushes, of_states, of_outputs = (
        rng.standard_normal((samples, len(root))) @ root
        for root in (np.eye(2), np.sqrt(model.Q), np.sqrt(model.R))
    )
    return run(model, pushes, of_states, model.trim + of_outputs, feedback)


@mark.in_full
@mark.parametrize(
    "order, feedback",
    [(1, NO_FEEDBACK), (4, -0.2 * np.eye(2))],
    ids=["1 open", "4 closed"],
)
def test_em_recovers_a_system_as_well_as_can_be(order, feedback):
    """Twice what the likelihood gains over the truth is χ² in as many parameters as data can tell (Wilks)."""
    truth = noisy_system(order)
    segments = [
        flown_with_noise(truth, order, 800, feedback),
        flown_with_noise(truth, order + 10, 400, feedback),
    ]
    predicted = iterate_em(segments, order).log_likelihoods[-1]
    of_truth = sum(
        smooth_states(truth, np.zeros(order), *segment).log_likelihood for segment in segments
    )
    # Input and noise answers, the noises' size, what is constant, and where two segments begin.
    freedom = order * (2 + 2 * 2) + 3 + 2 + 2 * order
    assert 0 < 2 * (predicted - of_truth) < chi2.ppf(1 - 1e-5, freedom)


@mark.slow
@mark.parametrize("train", [growing(), [TRAIN[:300], TRAIN[310:]]], ids=["growing", "cut"])
def test_the_likelihood_rises_and_covariances_stay_positive(train):
    record = Record.from_flights(train)
    segments = NormalizedUnits.of(record).normalized_segments(record)
    fitted = iterate_em(segments, 3, 15)
    likelihoods = np.array(fitted.log_likelihoods)
    assert np.diff(likelihoods).min() > -1e-8 * abs(likelihoods).max()
    for covariance in (fitted.model.Q, fitted.model.R):
        assert np.linalg.eigvalsh(covariance).min() > 0.99 * ROUNDING_TOLERANCE


def test_a_breakdown_is_an_error(monkeypatch):
    def breaks_down(*arguments):
        raise np.linalg.LinAlgError

    monkeypatch.setattr(maximum_likelihood, "iterate_em", breaks_down)
    assert refused(baselines.em, TRAIN[:300], 2).code is ForecastFact.EM_BROKE_DOWN


def error_of(model, system, samples, **options):
    """Returns the one-step error of a model beyond the system's own, in variances of its innovations.

    It is for as many samples as the model was learned from: for an efficient estimate it is χ² distributed, with its
    ``freedom``.
    """
    flight = simulated_flight(system, 2, 4 * samples, **options)
    predicted, true = (
        one.predicted_outputs(np.zeros(len(one.A)), flight.inputs, flight.outputs)[100:]
        for one in (model, system)
    )
    return np.sum((predicted - true) ** 2) / 0.1**2 / 4


def freedom(order):
    """How many parameters data can tell: input and noise answers, and what is constant."""
    return order * (2 + 2 * 2) + 2


def test_derivatives_of_the_prediction_errors_of_pem_are_those_of_differences():
    """Each parameter is changed a little, also the first state of each of two segments."""
    record = Record.from_flights([TRAIN[:60], TRAIN[80:120]])
    segments = NormalizedUnits.of(record).normalized_segments(record)
    start = subspace_identification.subspace_fit(segments, 1)
    likelihood = maximum_likelihood.PredictionErrorLikelihood(start.model, start.starts, segments)
    point = likelihood.parameters
    differences = [
        (likelihood.errors(point + step) - likelihood.errors(point - step)) / 2e-6
        for step in 1e-6 * np.eye(len(point))
    ]
    assert_allclose(likelihood.error_derivatives(point), differences, atol=1e-6)


METHODS = {
    "subspace": baselines.subspace,
    "pem": partial(baselines.pem, order=2),
}
ALL = [
    param(METHODS["subspace"], id="subspace"),
    param(METHODS["pem"], id="pem", marks=mark.in_full),
    param(partial(baselines.em, order=1), id="em", marks=mark.slow),
]


@mark.parametrize("method", ALL)
def test_units_do_not_matter(method, monkeypatch):
    # EM converges slowly, and is in the same units from its first iteration on.
    monkeypatch.setattr(maximum_likelihood.iterate_em, "__defaults__", (20,))
    model = method(TRAIN)
    other = method(in_other_units(TRAIN))
    assert isinstance(model, Forecaster) and repr(model).startswith(
        f"<Identified: {model.method}, "
    )
    forecast = back_from_other_units(other.forecast(in_other_units(TEST).inputs))
    # Iterations end in other places.
    assert_allclose(forecast, model.forecast(TEST.inputs), atol=2e-3)


@mark.parametrize("method", [baselines.subspace])
@mark.parametrize("more", NOTHING_NEW)
def test_inputs_that_tell_nothing_new_change_nothing(method, more):
    wider = with_inputs(FLIGHT, NOTHING_NEW[more](FLIGHT.inputs))
    plain, predicted = (
        method(flight[:700]).forecast(flight.inputs[700:]) for flight in (FLIGHT, wider)
    )
    assert_allclose(predicted, plain, rtol=1e-4, atol=1e-6)


@mark.parametrize("method", ALL)
def test_inputs_that_stand_still_leave_what_the_outputs_do_by_themselves(method):
    still = with_inputs(FLIGHT, np.full_like(FLIGHT.inputs, 1500.0))
    model = method(still[:700])
    assert not model.model.B.any() and np.isfinite(model.forecast(still.inputs[700:])).all()


@mark.parametrize("method", ALL)
def test_an_unstable_model_is_said_to_be(method):
    as_found = method(growing(), order=1)
    assert not as_found.stable and as_found.cautions[0].code is ForecastFact.MODEL_UNSTABLE


STILL = replace(TRAIN, outputs=np.zeros((700, 2)))


@mark.parametrize(
    "make, said",
    [
        (lambda: baselines.subspace(None), "^train must be a Flight"),
        (
            lambda: baselines.subspace(TRAIN, 2.5),
            "^order must be a whole number from 1 to",
        ),
        *((partial(method, STILL), "^outputs column 0 must vary") for method in METHODS.values()),
    ],
)
def test_what_cannot_be_learned_from_is_named(make, said):
    with raises(ValueError, match=said):
        make()


@mark.parametrize(
    "method, train, order, samples",
    [
        (baselines.subspace, [TRAIN[i : i + 5] for i in range(0, 600, 5)], 4, 600),
        (baselines.em, TRAIN, 10**9, 700),
        *((method, TRAIN[:30], 2, 30) for method in (baselines.subspace, baselines.pem)),
    ],
)
def test_too_few_samples_for_an_order_are_refused(method, train, order, samples):
    fact = refused(method, train, order)
    assert (fact.code, fact.figures["samples"]) == (ForecastFact.TOO_FEW_FOR_ORDER, samples)


def test_more_states_than_the_data_have_are_refused(monkeypatch):
    sine = np.sin(0.3 * np.arange(700))[:, None]
    fact = refused(baselines.subspace, Flight(TRAIN.time, 0 * sine, sine), 4)
    assert fact.code is ForecastFact.TOO_FEW_STATES
    assert fact.figures == {"order": 4, "states": 2}

    def unobservable(*arguments):
        raise np.linalg.LinAlgError

    monkeypatch.setattr(subspace_identification, "steady_state_gain", unobservable)
    assert refused(baselines.subspace, TRAIN, 2).code is ForecastFact.NOT_OBSERVABLE


def random_system(seed, order, noise=0.1):
    """Stable with a stable predictor; trims off zero. Innovations are to be of size 1."""
    rng = default_rng(seed)
    A = np.linalg.qr(rng.standard_normal((order, order)))[0] * rng.uniform(0.6, 0.85, order)
    B, C, K = (rng.standard_normal(shape) for shape in ((order, 2), (2, order), (order, 2)))
    while abs(np.linalg.eigvals(A - K @ C)).max() > 0.9:
        K *= 0.7
    trims = rng.uniform(-5, 5, (2, 2))
    return StateSpace(A, B, noise * C, np.zeros((2, 2)), K / noise, np.zeros(order), *trims)


def run(system, pushes, of_states, of_outputs, feedback):
    """Inputs and outputs of a system with noises; with ``feedback`` (r, m) inputs answer the outputs of the sample."""
    state = np.zeros(len(system.A))
    inputs, outputs = pushes.copy(), of_outputs.copy()
    for t in range(len(pushes)):
        outputs[t] += system.C @ state
        inputs[t] += feedback @ outputs[t]
        state = system.A @ state + system.B @ inputs[t] + system.offset + of_states[t]
    return inputs, outputs


def simulated_flight(system, seed, samples, noise=0.1, push=1.0, feedback=NO_FEEDBACK):
    """A flight of the system under white inputs of size ``push``.

    Inputs that answer outputs thus know the noise of the same sample (D = 0).
    """
    rng = default_rng(seed)
    pushes, errors = (size * rng.standard_normal((samples, 2)) for size in (push, noise))
    inputs, outputs = run(system, pushes, errors @ system.K.T, errors, feedback)
    time = 0.01 * np.arange(samples)
    return Flight(time, inputs + system.input_trim, outputs + system.output_trim)
