"""What commanded motors would do: the plant alone, from physical parameters, beside a plant that is commanded."""

from __future__ import annotations

import numpy as np
import pytest
from test_physical import DAMPING, DT, LAG, MOTORS, flown

import mavdem
from mavdem import Flight, Settings
from mavdem.dem.graybox.likelihood import FIRST_ORDER
from mavdem.dem.graybox.parameters import Physical, WindComponent, WindowTable
from mavdem.dem.graybox.simulation import simulated
from mavdem.dem.record import Record

STEPS = 100
DOUBLET = np.repeat([1.0, -1.0, 0.0, 0.5], STEPS // 4)[:, None] * np.sign(MOTORS) * 20
TRUE = Physical(
    effect=MOTORS,
    damping=DAMPING,
    lag=LAG,
    delay=DT / 2,
    covariance=np.zeros((7, 7)),
    status=dict.fromkeys(("effect", "damping", "lag"), "reported"),
    reasons=dict.fromkeys(("effect", "damping", "lag"), ""),
    bias=0.0,
    wind=1.0,
    wind_share=0.05,
    components=(WindComponent(FIRST_ORDER, 1.0, 0.5),),
    noise=0.005,
    refinements={},
    windows=WindowTable(*np.empty((8, 0))),
)


def test_the_true_plant_does_what_the_vehicle_does_in_calm_air():
    flight = flown(0, steering=0.5, samples=400 + STEPS, wind=0.0, commanded=DOUBLET)
    train, test = flight[:400], flight[400:]
    found = simulated(TRUE, Record.of(train), test.inputs).mean
    # The last measured rate has noise of 0.005 rad/s, and so has each of the test.
    np.testing.assert_allclose(found, test.outputs, atol=0.04)
    assert np.ptp(test.outputs, axis=0).min() > 0.4


def test_the_variance_is_that_of_wind_which_nothing_counteracts():
    """Over many winds, from the same beginning: four standard errors of a variance of so many flights."""
    record, flights = Record.of(flown(0, steering=0.5)), 400
    variance = simulated(TRUE, record, record.inputs[:STEPS]).variance
    rng, fine = np.random.default_rng(0), 10
    step = DT / fine
    keeps = np.exp(-step / 0.5)
    drift, rate, angle = rng.standard_normal(flights), np.zeros(flights), np.zeros(flights)
    for k in range(STEPS):
        for _ in range(fine):
            rate, angle = rate + step * (drift - DAMPING * rate), angle + step * rate
            drift = keeps * drift + np.sqrt(1 - keeps**2) * rng.standard_normal(flights)
        if k in (9, 49, 99):
            found = np.array([angle.var(), rate.var()])
            np.testing.assert_allclose(found, variance[k], rtol=4 * np.sqrt(2 / flights))


def test_uncertain_parameters_widen_it_to_first_order():
    record = Record.of(flown(0, steering=0.5))
    sd = 0.03 * np.abs(MOTORS)
    covariance = np.zeros((7, 7))
    covariance[:4, :4] = np.outer(sd, sd)
    uncertain = simulated(TRUE._replace(covariance=covariance), record, 1500 + DOUBLET).variance
    base = simulated(TRUE, record, 1500 + DOUBLET)
    other = simulated(TRUE._replace(effect=MOTORS + sd), record, 1500 + DOUBLET)
    np.testing.assert_allclose(uncertain - base.variance, (other.mean - base.mean) ** 2, rtol=1e-3, atol=1e-12)


def test_outputs_may_come_in_any_order_and_must_be_an_angle_and_its_rate():
    flight = flown(0, steering=0.5)
    turned = Flight(flight.time, flight.inputs, flight.outputs[:, ::-1])
    one, other = (simulated(TRUE, Record.of(each), 1500 + DOUBLET) for each in (flight, turned))
    np.testing.assert_allclose(one.mean, other.mean[:, ::-1])
    np.testing.assert_allclose(one.variance, other.variance[:, ::-1])
    with pytest.raises(ValueError, match="an angle and its rate"):
        simulated(TRUE, Record.of(Flight(flight.time, flight.inputs, flight.outputs[:, 1:])), 1500 + DOUBLET)


SETTINGS = Settings(order=3, window=9, parameter_precision=10.0)


@pytest.mark.slow
def test_bands_hold_commanded_flights():
    inside, errors = [], []
    for seed in range(8):
        flight = flown(seed, steering=1.0, samples=700 + STEPS, wind=0.5, commanded=DOUBLET)
        train, test = flight[:700], flight[700:]
        learned = mavdem.learn(train, SETTINGS)
        assert learned.physical is not None and learned.physical.identifiable
        ahead = learned.simulate(test.inputs)
        inside.append(np.mean(np.abs(ahead - test.outputs) <= learned.simulate_band(test.inputs)))
        errors.append(np.mean((ahead - test.outputs) ** 2) / np.mean((test.outputs - train.outputs.mean(axis=0)) ** 2))
    assert np.mean(inside) > 0.8
    assert np.median(errors) < 0.1


@pytest.mark.slow
def test_where_motors_are_not_identifiable_it_says_so_and_gives_no_band():
    flight = flown(0, steering=0.0, wind=3.0)
    learned = mavdem.learn(flight, SETTINGS)
    with pytest.warns(UserWarning, match="may be far off.*not identifiable"):
        assert learned.simulate(flight.inputs[:20]).shape == (20, 2)
    with pytest.raises(ValueError, match="no band.*not identifiable"):
        learned.simulate_band(flight.inputs[:20])
    with pytest.raises(ValueError, match="level must"):
        learned.simulate_band(flight.inputs[:20], level=2)
    with pytest.raises(ValueError, match="inputs must"), pytest.warns(UserWarning):
        learned.simulate(flight.inputs[:20, :3])


def test_without_physical_parameters_it_is_refused_with_the_reason():
    flight = flown(0, steering=0.5)
    learned = mavdem.learn(flight[:150], SETTINGS)
    assert learned.physical is None
    for answer in (learned.simulate, learned.simulate_band):
        with pytest.raises(ValueError, match="at least 200 samples"):
            answer(flight.inputs[150:])
