import numpy as np
import pytest
from simulated import simulated

from mavdem import Flight, Forecaster, baselines


def lagged_system(seed, order, samples, noise):
    """A flight of a stable ARX system of two outputs and inputs, and its coefficients (order, 2, 2) each."""
    rng = np.random.default_rng(seed)
    of_outputs, of_inputs = 0.3 / order * rng.standard_normal((order, 2, 2)), rng.standard_normal((order, 2, 2))
    u, y = rng.standard_normal((samples, 2)), np.zeros((samples, 2))
    e = noise * rng.standard_normal((samples, 2))
    for t in range(order, samples):
        y[t] = e[t] + [0.3, -0.2]
        for lag in range(order):
            y[t] += of_outputs[lag] @ y[t - 1 - lag] + of_inputs[lag] @ u[t - 1 - lag]
    # From where it knows of no beginning.
    return Flight(0.01 * np.arange(samples - 50), u[50:], y[50:]), of_outputs, of_inputs


def coefficients(model, order):
    """Of outputs and inputs by lag, out of the observer form."""
    return model.K.reshape(order, 2, 2), model.B.reshape(order, 2, 2)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_a_lagged_system_is_recovered_within_its_standard_errors(order):
    """Of 8 · order coefficients, in units of their least-squares standard errors, the squares' mean must be near 1."""
    flight, of_outputs, of_inputs = lagged_system(order, order, 4050, noise=0.1)
    model = baselines.arx(flight, order).model
    regressors = np.hstack(
        [table[order - lag : 4000 - lag] for table in (flight.outputs, flight.inputs) for lag in range(1, order + 1)]
        + [np.ones((4000 - order, 1))]
    )
    errors = 0.1 * np.sqrt(np.diag(np.linalg.inv(regressors.T @ regressors)))[:-1].reshape(2, order, 1, 2)
    found = np.array(coefficients(model, order))
    squares = ((found - [of_outputs, of_inputs]) / errors) ** 2
    # χ² with so many degrees of freedom, over their number: five of its standard deviations.
    assert abs(squares.mean() - 1) < 5 * np.sqrt(2 / squares.size)


def test_one_step_is_the_regression_and_forecast_continues_it():
    flight, _, _ = lagged_system(0, 2, 550, noise=0.1)
    train, test = flight[:400], flight[400:]
    arx = baselines.arx(train, 2)
    (a1, a2), (b1, b2) = coefficients(arx.model, 2)
    constant = arx.model.offset[:2] - (b1 + b2) @ arx.model.input_trim
    trim = arx.model.output_trim
    y, u = train.outputs - trim, train.inputs
    ahead = a1 @ y[1:-1].T + a2 @ y[:-2].T + b1 @ u[1:-1].T + b2 @ u[:-2].T + constant[:, None]
    np.testing.assert_allclose(arx.one_step()[2:], ahead.T + trim, atol=1e-9)
    np.testing.assert_allclose(arx.one_step()[0], trim)

    y, u = list(y), np.vstack([u, test.inputs])
    for t in range(400, 550 - 50):
        y.append(a1 @ y[t - 1] + a2 @ y[t - 2] + b1 @ u[t - 1] + b2 @ u[t - 2] + constant)
    np.testing.assert_allclose(arx.forecast(test.inputs), np.array(y[400:]) + trim, atol=1e-9)


def test_without_noise_the_forecast_is_exact():
    flight, _, _ = lagged_system(3, 3, 500, noise=0.0)
    forecast = baselines.arx(flight[:300], 3).forecast(flight.inputs[300:])
    np.testing.assert_allclose(forecast, flight.outputs[300:], atol=1e-9)


def test_no_lag_reaches_across_a_gap():
    flight, of_outputs, of_inputs = lagged_system(1, 2, 650, noise=0.0)
    segments = [flight[:250], flight[300:302], flight[400:]]
    arx = baselines.arx(segments, 2)
    found = coefficients(arx.model, 2)
    np.testing.assert_allclose(found, [of_outputs, of_inputs], atol=1e-9)
    assert arx.one_step().shape == (452, 2)
    np.testing.assert_allclose(arx.one_step()[[0, 250, 252]], np.tile(arx.model.output_trim, (3, 1)))
    np.testing.assert_allclose(arx.one_step()[254:], segments[-1].outputs[2:], atol=1e-9)


def test_units_do_not_matter():
    flight = simulated(wind=2.0)
    rescaled = Flight(flight.time, flight.inputs * [1, 10, 0.1, 3] - 7, np.degrees(flight.outputs) + 4)
    one, two = (baselines.arx(train[:700], 2).forecast(train.inputs[700:]) for train in (flight, rescaled))
    np.testing.assert_allclose(np.radians(two - 4), one, rtol=0, atol=1e-6 * np.abs(one).max())


@pytest.mark.parametrize(
    "spoilt",
    [
        lambda u: np.hstack([u, np.full((len(u), 1), 1500.0)]),
        lambda u: np.hstack([u, u[:, :2] @ [[1.0], [-2.0]]]),
        lambda u: np.hstack([u, u[:, :1], u[:, :1] + 1e-9 * u[:, 1:2]]),
    ],
)
def test_inputs_that_tell_nothing_new_change_nothing(spoilt):
    flight = simulated(wind=2.0)
    more = Flight(flight.time, spoilt(flight.inputs), flight.outputs)
    one, two = (baselines.arx(train[:700], 2).forecast(train.inputs[700:]) for train in (flight, more))
    np.testing.assert_allclose(two, one, rtol=1e-5, atol=1e-7)


def test_inputs_that_stand_still_leave_what_the_outputs_do_by_themselves():
    flight = simulated(wind=2.0)
    still = Flight(flight.time, np.full_like(flight.inputs, 1500.0), flight.outputs)
    arx = baselines.arx(still[:700], 2)
    assert not arx.model.B.any()
    assert np.isfinite(arx.forecast(still.inputs[700:])).all()


def unstable_flight():
    """Motion that doubles in a second, under noise."""
    rng = np.random.default_rng(0)
    y = np.zeros((700, 1))
    for t in range(1, 700):
        y[t] = 1.007 * y[t - 1] + 0.1 * rng.standard_normal()
    return Flight(0.01 * np.arange(700), rng.standard_normal((700, 1)), y)


def test_an_unstable_model_is_said_to_be_and_made_stable_only_when_asked():
    flight = unstable_flight()
    as_found, asked = baselines.arx(flight, 1), baselines.arx(flight, 1, stable=True)
    assert not as_found.stable and not as_found.stabilised
    assert "unstable" in as_found.cautions[0]
    assert asked.stable and asked.stabilised and 0.9 < asked.spectral_radius < 1
    assert asked.cautions == ("The model was unstable and has been made stable, as requested.",)
    # Where there is nothing to enforce, nothing is touched.
    train = simulated(wind=2.0)
    asked = baselines.arx(train, 2, stable=True)
    assert not asked.stabilised and not asked.cautions
    np.testing.assert_array_equal(asked.model.A, baselines.arx(train, 2).model.A)


@pytest.mark.filterwarnings("error")
def test_a_forecast_beyond_all_numbers_is_no_error():
    arx = baselines.arx(unstable_flight(), 1)
    assert not np.isfinite(arx.forecast(np.zeros((200_000, 1)))).all()


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda flight: baselines.arx(flight[:9], 2), "^train has 7 samples with 2 before them"),
        (lambda flight: baselines.arx([flight[:4], flight[10:13]], 4), "^train has 0 samples with 4 before them"),
        (lambda flight: baselines.arx(flight, 0), "^order must be a positive whole number, not 0"),
        (lambda flight: baselines.arx(flight, 2.5), "^order must be a positive whole number, not 2.5"),
        (lambda flight: baselines.arx(flight, True), "^order"),
        (lambda flight: baselines.arx(None), "^train must be a Flight"),
        (
            lambda flight: baselines.arx(Flight(flight.time, flight.inputs, np.ones((850, 2)))),
            "^outputs column 0 must vary",
        ),
    ],
)
def test_what_cannot_be_learnt_from_is_named(make, said):
    with pytest.raises(ValueError, match=said):
        make(simulated())


def test_it_is_a_forecaster():
    assert isinstance(baselines.arx(simulated(), 2), Forecaster)
    assert repr(baselines.arx(simulated(), 2)).startswith("<Identified: ARX(2), 4 states, 4 inputs, 2 outputs from 850")
