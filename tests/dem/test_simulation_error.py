"""The simulation-error fit: its errors, derivatives, convergence and posterior, and mixer geometry as a prior."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, fixture, mark, param
from scipy.ndimage import zoom
from simulated import GAIN, simulated
from textbook_filter import TextbookFilter

from mavdem import Flight, Settings, learn
from mavdem.dem.engine.model import unpack
from mavdem.dem.fitting import fit
from mavdem.dem.forecast import simulation_error
from mavdem.dem.record import Record
from mavdem.facts.model import ModelCaution

COMPLETE = Settings(order=3, d=2, window=9, parameter_precision=1.0)
FLIGHT = simulated(wind=1.0, lag=0.05)
ROTORS = FLIGHT.inputs.shape[1]


def objective_of(flight):
    """Returns the simulation-error objective of a flight with some free parameters, and the parameters' values."""
    record = Record.from_flights(flight)
    fitted = fit(record, COMPLETE)
    scaling = fitted.scaling
    model = fitted.model
    segments = [(scaling.scale_inputs(u), scaling.scale_outputs(y)) for u, y in record.segments]
    pieces = simulation_error.SimulationPieces.from_segments(segments, 30)
    places = np.array([3, 4, 8, 14, 15, 19])
    mean = model.prior.theta_mean[places]
    precision = np.diag(np.linspace(0.1, 1.0, len(places)))
    objective = simulation_error.SimulationObjective(
        fitted.ascent.posterior.theta,
        places,
        mean,
        precision,
        model.sizes,
        fitted.gain,
        record.dt,
        pieces,
    )
    return objective, fitted.ascent.posterior.theta[places]


@mark.slow
def test_errors_are_those_of_forecasts_that_begin_at_every_middle():
    """The filter runs over the first half of a piece, and a forecast over the second.

    Both are repeated by a textbook filter.
    """
    objective, free = objective_of(FLIGHT[:300])
    errors = objective.errors(free[None])[0]
    inputs, outputs, filter_steps, _ = objective.pieces
    n, r, m = objective.sizes
    A, B, C = unpack(objective.theta, n, r, m)
    textbook = TextbookFilter.of(A, B, C, objective.dt, objective.gain)
    for piece in (0, -1):
        piece_samples = inputs[..., piece], outputs[..., piece]
        states, _ = textbook.corrected(*(series[: filter_steps + 1] for series in piece_samples))
        ahead = textbook.forecast(states[-1], piece_samples[0][filter_steps:])
        assert_allclose(errors[..., piece], piece_samples[1][filter_steps + 1 :] - ahead, atol=1e-9)


@mark.slow
def test_gradient_and_curvature_are_those_of_the_log_joint():
    objective, free = objective_of(FLIGHT[:400])

    def value(point):
        return objective.value(point)

    expansion = objective.expand(free)
    steps = 1e-4 * np.maximum(1.0, abs(free))
    by_differences = [
        (value(free + step) - value(free - step)) / (2 * step.max()) for step in np.diag(steps)
    ]
    assert_allclose(
        expansion.gradient, by_differences, rtol=1e-3, atol=1e-4 * abs(expansion.gradient).max()
    )
    assert np.linalg.eigvalsh(expansion.curvature).min() > 0


@mark.slow
@mark.parametrize("wind", [0.3, 2.0])
def test_the_fit_never_decreases_the_log_joint_and_converges(wind):
    learned = learn(simulated(wind=wind, lag=0.05)[:700], COMPLETE)
    trajectory = learned.simulation_fit
    assert trajectory.converged
    log_joint = sum(term for name, term in trajectory.terms.items() if name != "parameter entropy")
    assert (np.diff(log_joint) > 0).all()
    assert set(trajectory.terms) <= set(learned.free_energy.terms)


@mark.in_full
def test_the_posterior_holds_the_truth_as_often_as_it_says():
    """Of a simulated axis in wind that forgets within the horizon, by the binomial spread of what is counted."""
    inside = []
    for seed in range(25):
        flight = simulated(wind=1.0, seed=seed)
        learned = learn(flight[:700], Settings(order=2, window=9, parameter_precision=0.01))
        half_width = learned.model_interval(0.9).B[1]
        inside.append(abs(learned.model.B[1] - GAIN) <= half_width)
    share = np.mean(inside)
    # The four motors of one flight err together, so the flights are what is counted.
    assert share > 0.9 - 3 * np.sqrt(0.9 * 0.1 / len(inside))


@mark.slow
@mark.parametrize("samples, seconds", [(420, 0.3), (175, 0.12)])
def test_the_horizon_is_as_long_as_the_samples_suffice_for(samples, seconds):
    simulation_fit = learn(FLIGHT[:samples], COMPLETE).simulation_fit
    assert simulation_fit.horizon == round(seconds / FLIGHT.dt)
    assert simulation_fit.effective_samples >= simulation_error.MIN_SAMPLES_PER_PARAMETER * len(
        simulation_fit.free
    )


@mark.slow
@mark.parametrize("rate", [50, param(400, marks=mark.in_full)])
def test_the_horizon_lasts_as_long_at_every_rate(rate):
    resampled = (
        zoom(table[:700], (rate / 100, 1), order=1) for table in (FLIGHT.inputs, FLIGHT.outputs)
    )
    record = Record.from_flights(Flight(np.arange(7 * rate) / rate, *resampled))
    settings = replace(COMPLETE, window=5)
    fitted = fit(record, settings)
    assert (
        simulation_error.simulation_horizon(fitted.model, settings, fitted.scaling, record)
        == 0.3 * rate
    )


@mark.slow
def test_too_little_leaves_theta_where_generalized_coordinates_led_it_and_says_so():
    learned = learn(FLIGHT[:60], COMPLETE)
    assert learned.simulation_fit is None
    cautions = {caution.code: caution.figures for caution in learned.cautions}
    assert cautions[ModelCaution.NO_SIMULATION_FIT]["duration"] == approx(0.6)
    short = learn(FLIGHT[:60], replace(COMPLETE, horizon=None))
    assert ModelCaution.NO_SIMULATION_FIT not in {caution.code for caution in short.cautions}
    assert_array_equal(learned.theta, short.theta)


def test_nothing_runs_across_a_gap_and_long_flights_are_thinned():
    """The pieces of two segments are those of each by itself. Of a long flight a limited number is used."""
    flight = simulated(samples=400, wind=1.0)
    parts = [
        (flight.inputs[:150], flight.outputs[:150]),
        (flight.inputs[200:], flight.outputs[200:]),
    ]
    pieces_of_both = simulation_error.SimulationPieces.from_segments(parts, 30)
    pieces_of_each = [simulation_error.SimulationPieces.from_segments([part], 30) for part in parts]
    assert pieces_of_both is not None and all(pieces_of_each)
    assert_array_equal(
        pieces_of_both.outputs,
        np.concatenate([series.outputs for series in pieces_of_each], axis=2),
    )
    assert pieces_of_both.effective_count == approx((150 + 200) / 30)
    zeros = np.zeros((simulation_error.MAX_PIECES * 20, 1))
    pieces_of_long_flight = simulation_error.SimulationPieces.from_segments([(zeros, zeros)], 30)
    assert pieces_of_long_flight.outputs.shape[2] == simulation_error.MAX_PIECES
    assert pieces_of_long_flight.effective_count == approx(simulation_error.MAX_PIECES * 20 / 30)


@fixture(scope="module")
def learned():
    return learn(FLIGHT[:300], COMPLETE)


@mark.slow
@mark.parametrize("size", [1e150, 1e300])
def test_inputs_without_measure_are_forecast_without_a_word(learned, size):
    """Huge inputs overflow without a floating-point warning."""
    ahead = np.full((150, ROTORS), size)
    with np.errstate(all="raise", under="ignore"):
        learned.forecast(ahead, from_zero=True)
        learned.forecast_band(ahead)
        learned.forecast_every(5, ahead, np.full((150, 2), 1e308))


@mark.in_full
def test_a_known_geometry_takes_the_place_of_the_one_that_is_inferred():
    """The mixer of the motors is estimated from the flight, given correctly, or given wrongly."""
    flight = simulated(wind=1.0, lag=0.05)[:700]
    inferred, known, other = (
        learn(replace(flight, effect_directions=directions), COMPLETE)
        for directions in (None, [0.2, -0.2, -0.2, 0.2], [1.0, 1.0, -1.0, -1.0])
    )
    assert_allclose(known.joint.mixer[:, 0], np.array([1, -1, -1, 1]) / 2, atol=1e-12)
    assert_allclose(known.theta, inferred.theta, atol=1e-4)
    assert abs(other.theta - inferred.theta).max() > 1e-2


def test_segments_of_different_geometries_have_none_in_common():
    same = np.array([1.0, -1.0, -1.0, 1.0])
    one = replace(FLIGHT, effect_directions=same)
    assert_array_equal(Record.from_flights([one, one]).effect_directions, same)
    for others in (-same, None):
        assert (
            Record.from_flights([one, replace(FLIGHT, effect_directions=others)]).effect_directions
            is None
        )
    assert (
        Record.from_flights(replace(FLIGHT, effect_directions=np.zeros(4))).effect_directions
        is None
    )
