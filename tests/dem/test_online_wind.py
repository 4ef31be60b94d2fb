"""The wind's torque live: the smoother's of the whole record but for what later samples add, at a stated delay."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from unittest.mock import Mock

import numpy as np
import pytest
from simulated import simulated

from mavdem import Flight, OnlineLearner, Settings
from mavdem.dem.online.memory import MemoryBlock
from mavdem.dem.online.wind import DELAY_SECONDS, FILTER_SECONDS, FIRST_FIT_SECONDS, OnlineWind, _Tracked, wind_filter
from mavdem.dem.record import Record

WINDY = simulated(samples=3000, wind=2.0, lag=0.05)
LAG = round(DELAY_SECONDS / WINDY.dt)
BEGINS = round((FILTER_SECONDS + DELAY_SECONDS) / WINDY.dt)


def followed(online: OnlineWind, flight: Flight, block: int = 10) -> np.ndarray:
    """(T, 2) what each update returns."""
    found = np.empty((len(flight), 2))
    for k, (inputs, outputs) in enumerate(zip(flight.inputs, flight.outputs, strict=True)):
        found[k] = online.update(inputs, outputs)
        if (k + 1) % block == 0:
            rows = slice(k + 1 - block, k + 1)
            online.add(MemoryBlock(flight.inputs[rows], flight.outputs[rows], k + 1 == block, float(flight.time[k])))
    return found


@pytest.mark.slow
def test_it_is_the_smoother_s_but_for_what_later_samples_add():
    of = wind_filter(Record.of(WINDY))
    tracked = _Tracked(of, WINDY.dt, WINDY.inputs[:1], WINDY.outputs[:1])
    live = np.full(len(WINDY), np.nan)
    for k in range(1, len(WINDY)):
        tracked.add(WINDY.inputs[k], WINDY.outputs[k])
        if k >= LAG:
            live[k - LAG] = tracked.torque[0]
    commanded = (WINDY.inputs - of.trim) @ of.physical.effect + of.constant
    rate = WINDY.outputs[:, of.column]
    whole = of.axis.smoothed(of.physical.noise, commanded, of.physical.delay / WINDY.dt, rate).mean + of.level
    far = slice(500, -LAG)
    weights = of.steady.weights(1000, of.axis.wind)
    added = np.sqrt(np.sum(weights[LAG + 1 :] ** 2) * of.steady.variance)
    assert np.std(live[far] - whole[far]) == pytest.approx(added, rel=0.5, abs=1e-9)
    assert np.std(live[far] - whole[far]) < 0.1 * whole.std()


@pytest.mark.slow
def test_it_is_known_from_the_first_fit_on_and_anew_after_a_gap():
    online = OnlineWind(WINDY.dt, 10, None, None)
    found = followed(online, WINDY)
    first = round(FIRST_FIT_SECONDS / WINDY.dt)
    assert np.isnan(found[:first]).all()
    assert np.isfinite(found[first:]).all()
    online.end_segment()
    after = followed(online, WINDY[:300])
    assert np.isnan(after[:BEGINS]).all()
    assert np.isfinite(after[BEGINS + 1 :]).all()


@pytest.mark.slow
def test_a_fit_in_an_executor_makes_no_sample_wait():
    pending: Future = Future()
    online = OnlineWind(WINDY.dt, 10, Mock(**{"submit.return_value": pending}), None)
    assert np.isnan(followed(online, WINDY[:900])).all()
    pending.set_result(wind_filter(Record.of(WINDY[:800])))
    assert np.isfinite(followed(online, WINDY[900:1000])[-1]).all()


def test_a_fit_that_fails_leaves_the_last_one():
    still = Flight(WINDY.time, np.full_like(WINDY.inputs, 1500.0), WINDY.outputs)
    online = OnlineWind(WINDY.dt, 10, None, None)
    assert np.isnan(followed(online, still)).all()
    assert online.filter is None
    with ThreadPoolExecutor(1) as executor:
        gone = OnlineWind(WINDY.dt, 10, executor, None)
    assert np.isnan(followed(gone, WINDY[:900])).all()


def test_samples_that_were_taken_back_are_not_fitted_to():
    online = OnlineWind(WINDY.dt, 10, Mock(**{"submit.return_value": Future()}), None)
    followed(online, WINDY[:600])
    online.drop_since(float(WINDY.time[300]))
    assert online._blocks[-1].until <= WINDY.time[300]


@pytest.mark.slow
def test_an_estimate_has_it_and_says_of_when():
    online = OnlineLearner(Settings(order=3, d=2, window=9, parameter_precision=1.0), dt=WINDY.dt)
    for time, outputs, inputs in zip(WINDY.time[:1000], WINDY.outputs, WINDY.inputs, strict=False):
        estimate = online.update(time, outputs, inputs)
    assert estimate.wind_time == pytest.approx(estimate.time - DELAY_SECONDS)
    assert np.isfinite([estimate.wind_torque, estimate.wind_torque_band]).all()
