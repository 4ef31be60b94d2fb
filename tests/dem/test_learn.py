"""Learning from one flight and from several segments, across whose gaps nothing looks."""

from dataclasses import replace

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, mark, raises
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lsim
from simulated import DT, GAIN, RATE, simulated

from mavdem import Flight, Forecaster, Settings, evaluate, learn
from mavdem.dem.engine.model import unpack
from mavdem.dem.learning import complete_settings
from mavdem.dem.priors import derivative_pairs
from mavdem.dem.record import Record, cross_validation_folds
from mavdem.facts.model import ModelCaution

QUICK = Settings(order=2, window=3, parameter_precision=1.0)
PLANT = replace(QUICK, horizon=None, forecasts="plant")


def alone(outputs):
    """A record of outputs with nothing driving them."""
    return Record(np.zeros((len(outputs), 1)), outputs, DT, (len(outputs),))


def test_a_clean_system_is_recovered_and_forecast():
    """A simulated second-order system without wind: the model has its stiffness 9, damping and gain."""
    flight = simulated()
    train = flight[:700]
    test = flight[700:]
    learned = learn(train, Settings(order=2, parameter_precision=0.01, window=3))
    model = learned.model
    # Motors are held over a step and read as running linearly, half a step late at worst: gain is not affected.
    assert_allclose(model.A[1], [-9, -RATE], rtol=0.1)
    assert_allclose(model.B[1], GAIN, rtol=0.1)
    assert evaluate.relative_mspe(train, test, learned.forecast(test.inputs)) < 0.02
    errors = learned.plant.mean_squared_errors
    assert len(errors) == 150 and (errors < 0.02 * train.outputs.var(axis=0)).all()
    ahead = learned.plant.one_step_predictions(learned.record)
    assert_allclose(errors[0], np.mean((ahead - train.outputs)[38:] ** 2, axis=0), rtol=0.3)
    assert isinstance(learned, Forecaster)


@mark.slow
def test_units_of_the_stream_do_not_matter():
    """The same flight in rad and µs, and in degrees and fractions, gives the same model in other units."""
    flight = simulated(wind=0.5)
    other = Flight(flight.time, flight.inputs / 1000 - 1, np.degrees(flight.outputs))
    learned_in_si_units = learn(flight[:700], QUICK)
    learned_in_other_units = learn(other[:700], QUICK)
    assert_allclose(
        learned_in_other_units.model.A, learned_in_si_units.model.A, rtol=1e-6, atol=1e-9
    )
    assert_allclose(
        learned_in_other_units.model.B,
        np.degrees(learned_in_si_units.model.B) * 1000,
        rtol=1e-6,
        atol=1e-9,
    )
    half_width, half_width_in_other_units = (
        of.model_interval().B for of in (learned_in_si_units, learned_in_other_units)
    )
    assert_allclose(half_width_in_other_units, np.degrees(half_width) * 1000, rtol=1e-6, atol=1e-9)
    for name in ("theta", "theta_sd"):
        B, other_B = (
            unpack(getattr(of.learning, name)[-1], 2, 4, 2)[1]
            for of in (learned_in_si_units, learned_in_other_units)
        )
        assert_allclose(other_B, np.degrees(B) * 1000, rtol=1e-5, atol=1e-9)
    forecast = np.degrees(learned_in_si_units.forecast(flight[700:].inputs))
    assert_allclose(
        learned_in_other_units.forecast(other[700:].inputs),
        forecast,
        rtol=0,
        atol=1e-6 * abs(forecast).max(),
    )


@mark.parametrize("rate, window", [(50, 5), (120, 11), (400, 37)])
def test_the_window_that_is_left_open_lasts_as_long_at_every_rate(rate, window):
    record = Record(np.zeros((700, 4)), np.zeros((700, 2)), 1 / rate, (700,))
    settings = complete_settings(Settings(), record)
    left_open = settings.order, settings.d, settings.window, settings.parameter_precision
    assert left_open == (3, 2, window, 10.0)
    assert complete_settings(settings, record) == settings
    plain = Settings(p=3, known_inputs=False, prior="uniform", correlation="continuous")
    assert (
        complete_settings(plain, record).d == 2
        and complete_settings(plain, record).parameter_precision == 1.0
    )


def test_the_window_that_is_left_open_is_the_shortest_in_short_segments():
    """The default window has 9 samples; it has 3 if the segments are shorter than 16."""

    def record(samples):
        return Record(
            np.zeros((60 * samples, 4)), np.zeros((60 * samples, 2)), 0.01, (samples,) * 60
        )

    assert [
        complete_settings(Settings(), record(samples)).window for samples in (20, 16, 12, 4)
    ] == [
        9,
        9,
        3,
        3,
    ]
    with raises(ValueError, match="longer for windows of 3 samples"):
        complete_settings(Settings(), record(3))
    with raises(ValueError, match="longer for windows of 9 samples"):
        complete_settings(Settings(window=9), record(12))


@mark.slow
def test_process_noise_is_the_moment_of_the_wind():
    """The estimated noise of the states correlates with the simulated torque of the wind, without a delay."""
    flight = simulated(3, wind=0.5)
    learned = learn(flight[:700], Settings(order=2, window=3, parameter_precision=0.01))
    window_centers, noise = learned.process_noise()
    rng = default_rng(3)
    rng.standard_normal((850, 4))
    moment = (
        0.5 * gaussian_filter1d(rng.standard_normal(8500), 50) * np.sqrt(100 * np.sqrt(np.pi))
    )[::10]
    likeness = [
        np.corrcoef(noise[5:-5, 1], moment[window_centers[5:-5] + lag])[0, 1] for lag in (-3, 0, 3)
    ]
    assert np.argmax(likeness) == 1
    assert likeness[1] > 0.9
    assert noise[5:-5, 1].std() == approx(moment[window_centers[5:-5]].std(), rel=0.2)


@mark.slow
def test_unstable_models_are_said_to_be():
    """The outputs grow as exp(2 t): the model has a caution with the growth time of 0.5 s."""
    time = DT * np.arange(400)
    growing = 1e-3 * np.exp(2 * time)
    rng = default_rng(1)
    outputs = np.stack([growing, 2 * growing], axis=1) + 1e-6 * rng.standard_normal((400, 2))
    flight = Flight(time, rng.standard_normal((400, 1)), outputs)
    learned = learn(flight, Settings(order=2, parameter_precision=0.01, window=3))
    assert learned.model.spectral_abscissa > 0
    growth_caution = next(
        learned_in_si_units
        for learned_in_si_units in learned.cautions
        if learned_in_si_units.code is ModelCaution.MODEL_GROWS
    )
    assert growth_caution.figures["growth_time"] == approx(1 / 2, rel=0.05)
    assert (
        not learned.stable
        and not replace(learned, settings=replace(learned.settings, forecasts="plant")).stable
    )


@mark.slow
@mark.parametrize("m", [1, 3])
def test_other_numbers_of_outputs(m):
    flight = simulated(wind=0.5)
    outputs = np.hstack([flight.outputs, flight.outputs[:, :1] ** 2])[:, :m]
    learned = learn(Flight(flight.time, flight.inputs, outputs)[:700])
    assert learned.forecast(flight.inputs[700:]).shape == (150, m)


@mark.parametrize(
    "change, message",
    [
        (lambda f: f[:30], "at least 50 samples"),
        (
            lambda f: replace(f, outputs=f.outputs * [1, 0])[:700],
            "outputs column 1 must vary",
        ),
        (
            lambda f: replace(f, inputs=f.inputs * [1, 1, 0, 1])[:700],
            "inputs column 2 must vary: .* Leave out",
        ),
    ],
)
def test_data_that_determine_nothing_are_refused(change, message):
    with raises(ValueError, match=message):
        learn(change(simulated()))


@mark.slow
def test_more_hidden_states_than_derivatives_are_refused_and_one_fewer_learnt():
    flight = simulated(wind=0.5)[:700]
    settings = {"p": 1, "window": 9, "parameter_precision": 1.0}
    for wrong in (1, 4):
        with raises(ValueError, match="^order must be between 2 and 3"):
            learn(flight, Settings(order=wrong, **settings))
    assert learn(flight, Settings(order=3, **settings)).model.A.shape == (3, 3)


def test_derivative_pairs_are_found_whatever_their_places_and_noise():
    outputs = simulated(wind=1.0).outputs
    rng = default_rng(0)
    assert derivative_pairs(alone(outputs)) == ((0, 1),)
    assert derivative_pairs(alone(outputs[:, ::-1])) == ((1, 0),)
    assert derivative_pairs(alone(outputs + rng.standard_normal(outputs.shape) * [2e-3, 2e-2])) == (
        (0, 1),
    )
    assert derivative_pairs(alone(rng.standard_normal((300, 2)))) == ()


def test_an_ascent_that_ran_out_of_iterations_has_not_converged():
    settings = Settings(window=9, parameter_precision=1.0, horizon=None, iterations=3)
    assert not learn(simulated(wind=0.5)[:700], settings).converged


@mark.slow
def test_wrong_forecast_inputs_are_named():
    learned = learn(simulated()[:200], QUICK)
    with raises(ValueError, match=r"inputs must have shape \(H, 4\)"):
        learned.forecast(np.zeros((10, 3)))
    with raises(ValueError, match="inputs must be finite"):
        learned.forecast(np.full((10, 4), np.nan))
    with raises(ValueError, match="level must be a probability"):
        learned.forecast_band(np.zeros((10, 4)), level=2)
    with raises(ValueError, match="from 1 to 100,000, not 1000000000"):
        learned.predict(10**9)


@mark.slow
@mark.parametrize("settings", [PLANT, Settings.paper(), replace(PLANT, order=3, forecasts="joint")])
def test_from_zero_row_0_is_the_trim_and_inputs_move_the_rest_by_the_physical_model(settings):
    """A forecast from zero equals the simulation of the model's equations from the trim."""
    flight = simulated(wind=0.5)
    learned = learn(flight[:700], settings)
    model = learned.model
    inputs = flight.inputs[700:]
    system = model.A, np.column_stack([model.B, model.offset]), model.C, np.zeros((2, 5))
    inputs_and_offset = np.column_stack([inputs - model.input_trim, np.ones(len(inputs))])
    _, deviation, _ = lsim(system, inputs_and_offset, DT * np.arange(len(inputs)))
    expected = deviation + model.output_trim
    forecast = learned.forecast(inputs, from_zero=True)
    assert_allclose(forecast, expected, atol=1e-8 * abs(expected).max())
    assert learned.forecast(inputs[:0], from_zero=True).shape == (0, 2)


CLEAN = Settings(order=2, parameter_precision=0.01, window=5)


@mark.slow
def test_predictions_and_noise_belong_to_their_segments():
    """Between two segments 60 samples are missing: nothing may be predicted across that gap."""
    flight = simulated()
    learned = learn([flight[:400], flight[460:700]], CLEAN)
    ahead = learned.one_step()
    assert ahead.shape == (640, 2)
    window_centers, noise = learned.process_noise()
    assert_array_equal(window_centers, np.r_[2:398, 402:638])
    assert noise.shape == (len(window_centers), 2)
    # What is predicted in the second segment depends neither on the first nor on later samples.
    record = learned.record
    outputs = record.outputs.copy()
    outputs[:400] += 1.0
    outputs[500:] += 1.0
    changed = learned.joint.one_step_predictions(replace(record, outputs=outputs))
    assert_array_equal(changed[400:501], ahead[400:501])
    assert abs(changed[501:] - ahead[501:]).max() > 0.1


def test_windows_and_folds_are_of_single_segments():
    """Embedding windows and folds of the cross-validation never reach from one segment into the next."""
    record = Record(np.zeros((10, 1)), np.arange(10.0)[:, None], DT, (3, 4, 3))
    assert (record.window_count(3), record.window_count(4), record.longest_segment) == (
        1 + 2 + 1,
        1,
        4,
    )
    # Folds are parts of equal length, in pieces of one segment.
    parts = cross_validation_folds([100, 7, 60], 4)
    assert [sum(stop - start for _, start, stop in part) for part in parts] == [41, 42, 42, 42]
    assert parts[2] == [(0, 83, 100), (1, 0, 7), (2, 0, 18)]


def test_a_flight_is_cut_at_its_gaps():
    """A flight without 30 and 69 samples: a piece of one sample is left out."""
    flight = simulated()
    kept_samples = np.r_[0:300, 330:331, 400:700]
    segments = Flight.segments(
        flight.time[kept_samples] + 1e-6,
        flight.inputs[kept_samples],
        flight.outputs[kept_samples],
        output_names=("a", "b"),
    )
    assert [len(segment) for segment in segments] == [300, 300]
    assert segments[1].time[0] == approx(4.0) and segments[1].output_names == ("a", "b")


@mark.parametrize(
    "change, named",
    [
        ({"time": 0.02 * np.arange(300)}, "^dt"),
        ({"inputs": np.ones((300, 3))}, "^inputs"),
        ({"outputs": np.ones((300, 1))}, "^outputs"),
    ],
)
def test_segments_that_do_not_belong_together_are_named(change, named):
    first = simulated()[:300]
    other = {"time": first.time, "inputs": first.inputs, "outputs": first.outputs} | change
    with raises(ValueError, match=named):
        learn([first, Flight(**other)], CLEAN)


def test_what_are_no_segments_of_a_flight_is_named():
    flight = simulated()
    short = [flight[i : i + 6] for i in range(0, 600, 6)]
    for train, named in (([], "hold"), ({"dt": 1}, "be a Flight"), (short, "be longer")):
        with raises(ValueError, match=f"^train must {named}"):
            learn(train, CLEAN)
