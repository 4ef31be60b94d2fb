import numpy as np
import pytest

from mavdem import Flight, baselines


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


def test_no_lag_reaches_across_a_gap():
    flight, of_outputs, of_inputs = lagged_system(1, 2, 650, noise=0.0)
    segments = [flight[:250], flight[300:302], flight[400:]]
    arx = baselines.arx(segments, 2)
    found = coefficients(arx.model, 2)
    np.testing.assert_allclose(found, [of_outputs, of_inputs], atol=1e-9)
    assert arx.one_step().shape == (452, 2)
    np.testing.assert_allclose(arx.one_step()[[0, 250, 252]], np.tile(arx.model.output_trim, (3, 1)))
    np.testing.assert_allclose(arx.one_step()[254:], segments[-1].outputs[2:], atol=1e-9)
