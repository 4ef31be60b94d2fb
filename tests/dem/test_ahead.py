"""Predictions with the inputs unknown: never much worse than the last sample or the mean, bounded, with bands."""

from __future__ import annotations

import numpy as np
import pytest
from simulated import simulated

from mavdem import Flight, OnlineLearner, Settings
from mavdem.dem.closed_loop.autoregression import LagStatistics, autoregression
from mavdem.dem.engine.resumable import run_to_end
from mavdem.dem.online.ahead import PredictionsAhead
from mavdem.dem.online.autoregression import FEWEST_LAGS, Maps, OnlineAutoregression, resumable_maps
from mavdem.dem.online.bands import ErrorBands
from mavdem.dem.online.learner import BLOCK_SECONDS, HORIZONS
from mavdem.dem.online.memory import Memory, MemoryBlock
from mavdem.dem.online.mixture import Mixture

pytestmark = pytest.mark.usefixtures("without_wind_fits")
SETTLED = 1200  # samples, from which predictions are judged


def controlled(seed: int, samples: int = 6000, dt: float = 0.01, inputs: int = 4, wind: float = 2.0) -> Flight:
    """A roll axis in wind, held by a proportional and derivative controller: each motor has its share of the demand."""
    rng = np.random.default_rng(seed)
    share = rng.choice([-1.0, 1.0], inputs)
    roll = rate = gust = demand = 0.0
    rows = np.empty((samples, 2 + inputs))
    inner = max(1, round(dt / 0.01))
    for row in range(samples):
        for step in np.full(inner, dt / inner):
            gust += step * (-gust / 0.5) + wind * np.sqrt(2 * step / 0.5) * rng.standard_normal()
            demand += step / 0.05 * (-30.0 * roll - 6.0 * rate - demand)
            rate += step * (demand + gust - 2.0 * rate)
            roll += step * rate
        noise = rng.standard_normal(2 + inputs)
        rows[row] = np.concatenate([[roll, rate], 1500 + 20 * share * demand])
        rows[row] += np.concatenate([[1e-4, 1e-3], np.full(inputs, 0.3)]) * noise
    return Flight(dt * np.arange(samples), rows[:, 2:], rows[:, :2], dt=dt)


def predicted(flight: Flight, horizons: tuple[int, ...] = HORIZONS) -> tuple[np.ndarray, np.ndarray]:
    """Predictions and half widths (T, H, m), without a state-space model."""
    (count, r), m = flight.inputs.shape, flight.outputs.shape[1]
    block = max(1, round(BLOCK_SECONDS / flight.dt))
    memory = Memory(flight.dt, block, round(20.0 / flight.dt / block), r, m)
    ahead, bands = PredictionsAhead(flight.dt, block, horizons, r, m), ErrorBands(horizons, m, flight.dt)
    found = np.empty((2, count, len(horizons), m))
    for row in range(count):
        closed = memory.add(flight.inputs[row], flight.outputs[row], flight.time[row])
        found[:, row] = ahead.predict(memory, None), bands.half_widths[1:]
        bands.add(flight.outputs[row], np.full(m, np.nan), found[0, row])
        if closed:
            bands.update()
            ahead.add(memory.blocks[-1])
        ahead.advance()
    return found[0], found[1]


def ratios(flight: Flight, found: np.ndarray, horizons: tuple[int, ...] = HORIZONS) -> np.ndarray:
    """(H,) squared error over that of the better of the last sample held and the mean so far."""
    outputs, first = flight.outputs, min(SETTLED, len(flight) // 4)
    mean = np.cumsum(outputs, axis=0) / np.arange(1, len(outputs) + 1)[:, None]
    ours = []
    for place, horizon in enumerate(horizons):
        later, now = outputs[first + horizon :], slice(first, -horizon)
        size = [
            (((later - each) ** 2) / outputs.var(axis=0)).mean()
            for each in (found[now, place], outputs[now], mean[now])
        ]
        ours.append(size[0] / min(size[1:]))
    return np.array(ours)


def noise(seed: int) -> Flight:
    """White: nothing can be predicted but the mean."""
    rng = np.random.default_rng(seed)
    return Flight(
        0.01 * np.arange(5000), 1500 + rng.standard_normal((5000, 4)), rng.standard_normal((5000, 2)), dt=0.01
    )


def walk(seed: int) -> Flight:
    """Nothing can be predicted but the last sample."""
    rng = np.random.default_rng(seed)
    steps = rng.standard_normal((5000, 6)).cumsum(axis=0)
    return Flight(0.01 * np.arange(5000), steps[:, 2:], steps[:, :2], dt=0.01)


@pytest.mark.parametrize(
    "make",
    [
        pytest.param(lambda: controlled(0), id="gusts", marks=pytest.mark.slow),
        pytest.param(lambda: controlled(1, wind=0.2), id="calm", marks=pytest.mark.slow),
        pytest.param(lambda: noise(0), id="noise"),
    ],
)
def test_no_horizon_is_worse_than_the_last_sample_and_the_mean(make):
    flight = make()
    assert ratios(flight, predicted(flight)[0]).max() < 1.05


@pytest.mark.slow
def test_a_walk_is_predicted_by_its_last_sample():
    """To 0.1 s; half a second ahead any 20 s of a walk seem to return to their mean, and it errs 1.11 times as much."""
    flight, horizons = walk(0), (1, 5, 10)
    assert ratios(flight, predicted(flight, horizons)[0], horizons).max() < 1.05


@pytest.mark.slow
@pytest.mark.parametrize(("dt", "inputs"), [(0.0025, 4), (0.02, 1), (0.02, 8), (0.1, 4)])
def test_it_works_at_every_rate_and_with_one_to_eight_inputs(dt, inputs):
    horizons = tuple(sorted({1, *(round(seconds / dt) for seconds in (0.1, 0.2, 0.5))}))
    flight = controlled(2, round(40 / dt), dt, inputs)
    found = ratios(flight, predicted(flight, horizons)[0], horizons)
    assert found.min() < 0.9 and found.max() < 1.05


@pytest.mark.slow
def test_the_bands_hold_nine_of_ten():
    flight = controlled(3)
    found, half = predicted(flight)
    for place, horizon in enumerate(HORIZONS):
        rows = np.arange(SETTLED, len(flight) - horizon)
        inside = np.abs(flight.outputs[rows + horizon] - found[rows, place]) <= half[rows, place]
        assert 0.85 < inside.mean() < 0.95


def test_predictions_are_at_most_as_far_as_the_vehicle_has_ever_been_so_soon():
    """A channel that grows without end makes the autoregression explosive."""
    flight = controlled(4, 2000)
    outputs = flight.outputs.copy()
    outputs[1500:] *= np.exp(0.05 * np.arange(500))[:, None]
    found, _ = predicted(Flight(flight.time, flight.inputs, outputs, dt=0.01), (1, 50))
    assert np.isfinite(found).all()
    for row in range(1500, 2000, 7):
        changes = np.abs(outputs[50 : row + 1] - outputs[: row - 49])
        furthest = np.maximum(changes.max(axis=0), np.abs(outputs[: row + 1].mean(axis=0) - outputs[row]))
        assert (np.abs(found[row, 1] - outputs[row]) <= furthest * (1 + 1e-9)).all()


def test_the_first_predictions_are_the_last_sample():
    flight = controlled(5, 60)
    found, half = predicted(flight)
    np.testing.assert_allclose(found[0], np.tile(flight.outputs[0], (len(HORIZONS), 1)))
    assert np.isfinite(found).all() and np.isnan(half[0]).all()


def test_the_maps_are_the_autoregression_s_own_steps():
    flight = controlled(6, 800)
    channels = np.hstack([flight.outputs, flight.inputs])
    channels = (channels - channels.mean(axis=0)) / channels.std(axis=0)
    model = autoregression(LagStatistics.of([channels], 3), 3)
    maps = Maps(np.zeros(6), np.ones(6), *run_to_end(resumable_maps(model, (1, 30), 2)))
    past = list(channels[100:103])
    for _ in range(30):
        past.append(sum(A @ z for A, z in zip(model.coefficients, past[:-4:-1], strict=True)) + model.offset)
    np.testing.assert_allclose(maps.predicted(channels[100:103]), [past[3][:2], past[-1][:2]], rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_no_lag_and_no_error_reaches_across_a_gap():
    flight = controlled(7, 1500)
    online = OnlineLearner(Settings(order=2, d=1, window=7, parameter_precision=1.0, horizon=None), dt=0.01)
    for row in range(1200):
        before = online.update(flight.time[row], flight.outputs[row], flight.inputs[row])
    waiting = online._ahead._mixture.weights.copy()
    # Elsewhere after the gap: as an error, 1000 standard deviations.
    far = 1000 * flight.outputs.std(axis=0)
    first = online.update(flight.time[1200] + 5.0, flight.outputs[1200] + far, flight.inputs[1200])
    assert np.isfinite(first.ahead).all() and before.model is not None
    assert np.isnan(online._ahead._ring[:-1]).all(axis=(1, 2, 3)).sum() >= HORIZONS[-1] - 1
    for row in range(1201, 1211):
        online.update(flight.time[row] + 5.0, flight.outputs[row] + far, flight.inputs[row])
    np.testing.assert_allclose(online._ahead._mixture.weights[-1], waiting[-1], atol=0.2)


def test_what_is_taken_back_is_not_learnt_from():
    flight = controlled(8, 3000)
    ahead, anew = (OnlineAutoregression(0.01, HORIZONS, 4, 2) for _ in range(2))
    blocks = [
        MemoryBlock(flight.inputs[at : at + 10], flight.outputs[at : at + 10], at == 0, flight.time[at + 9])
        for at in range(0, 1000, 10)
    ]
    landed = [MemoryBlock(np.full((10, 4), 1000.0), np.zeros((10, 2)), False, 10.0 + 0.1 * at) for at in range(20)]
    for block in [*blocks, *landed]:
        ahead.add(block)
        ahead.advance()
    ahead.begin_with(blocks)
    for one in (ahead, anew):
        if one is anew:
            one.begin_with(blocks)
        while one.waits:
            one.advance()
    now = flight.inputs[1000:1020], flight.outputs[1000:1020]
    np.testing.assert_allclose(ahead.ahead(*now), anew.ahead(*now))


@pytest.mark.slow
def test_the_learner_takes_back_what_its_memory_takes_back():
    flight = controlled(9, 1500)
    online = OnlineLearner(Settings(order=2, d=1, window=7, parameter_precision=1.0, horizon=None), dt=0.01)
    for row in range(1500):
        online.update(flight.time[row], flight.outputs[row], flight.inputs[row])
    online.forget_since(flight.time[1000])
    assert online._ahead._number == 1000
    np.testing.assert_allclose(online._ahead._mean, flight.outputs[:1000].mean(axis=0))
    assert np.isnan(online.update(15.0, flight.outputs[-1], flight.inputs[-1]).ahead_ratio).all()


def test_weights_find_the_best_mixture_and_stay_a_mixture():
    rng = np.random.default_rng(10)
    mixture = Mixture(0.01, (1,), 1, 3)
    for _ in range(300):
        # Two with independent errors of variances 1 and 3, and one that is no use.
        errors = rng.standard_normal((10, 1, 1, 3)) * np.sqrt([1.0, 3.0, 400.0])
        mixture.add(errors, rng.standard_normal((10, 1)))
        assert mixture.weights.min() >= 0 and mixture.weights.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(mixture.weights[0, 0], [0.75, 0.25, 0.0], atol=0.1)


def test_a_still_vehicle_is_no_error():
    flight = simulated(samples=300)
    still = Flight(flight.time, np.full((300, 4), 1500.0), np.zeros((300, 2)), dt=flight.dt)
    found, _ = predicted(still)
    np.testing.assert_array_equal(found, 0.0)
    assert OnlineAutoregression(0.1, (1,), 8, 2).lags == FEWEST_LAGS
