"""Learning in small steps arrives where learning at once does; its bands, surprise and marks are honest."""

import dataclasses
import os
from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor
from unittest.mock import Mock

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, mark, param, raises
from scipy.stats import gumbel_r, norm
from simulated import SIGNS, simulated

import mavdem
from mavdem import Flight, OnlineLearner, Settings
from mavdem.dem.engine.linalg import one_thread
from mavdem.dem.online import learner
from mavdem.dem.online.anomaly_marks import (
    MEAN_SECONDS_BETWEEN_FALSE_MARKS,
    PEAK_SECONDS,
    AnomalyMarks,
    evidence_limit,
)
from mavdem.dem.online.error_bands import BAND_SECONDS, MAX_MEDIANS, ErrorBands
from mavdem.dem.online.forecaster import OnlineForecaster
from mavdem.dem.online.free_energy_monitor import MAX_QUARTILES, FreeEnergyMonitor, Surprise
from mavdem.dem.online.learner import LEARNING_SECONDS, NEW_SAMPLE_FRACTION
from mavdem.dem.online.memory import SampleMemory, drop_blocks_since
from mavdem.facts.online import OnlineFact

pytestmark = mark.usefixtures("without_wind_fits")
COMPLETE = Settings(order=3, d=2, window=9, parameter_precision=1.0)
WINDY = simulated(samples=2000, wind=2.0, lag=0.05)


def estimates_of(online, flight):
    """Returns the learner's estimate of each sample of a flight."""
    rows = zip(flight.time, flight.outputs, flight.inputs, strict=True)
    return [online.update(time, outputs, inputs) for time, outputs, inputs in rows]


def filled(memory, samples):
    for sample in samples:
        memory.add(np.array([sample]), np.array([-sample]), 0.01 * sample)


def test_a_memory_has_its_latest_samples():
    memory = SampleMemory(0.01, block_size=4, max_blocks=3)
    filled(memory, range(100))
    inputs, outputs = memory.latest_samples(7)
    assert inputs.ravel().tolist() == list(range(93, 100))
    assert (outputs == -inputs).all()
    assert memory.blocks[-1].end_time == approx(0.99)
    memory.end_segment()
    assert len(memory.latest_samples(7)[0]) == 0
    filled(memory, range(100, 140))
    assert memory.record().lengths == (12,) and memory.record().begins == approx((1.28,))
    assert memory.record().inputs.ravel().tolist() == list(range(128, 140))


def test_what_is_taken_back_is_forgotten_and_nothing_of_an_earlier_boot():
    memory = SampleMemory(0.01, block_size=4, max_blocks=9)
    for start in (500.0, 3.0):
        for sample in range(13):
            memory.add(np.array([sample]), np.array([-sample]), start + 0.01 * sample)
        memory.end_segment()
    assert memory.record().begins == approx((500.0, 3.0))
    assert drop_blocks_since(memory.blocks, 3.045) and memory.record().lengths == (13, 4)
    assert drop_blocks_since(memory.blocks, 1.0) and memory.record().lengths == (13,)
    assert not drop_blocks_since(memory.blocks, 600.0)
    assert drop_blocks_since(memory.blocks, -1.0) and not memory.blocks


@mark.slow
@mark.parametrize("horizon", [None, param(0.3, marks=mark.in_full)])
def test_it_arrives_where_learning_at_once_does(horizon):
    flight = simulated(samples=600, wind=1.0, lag=0.05)
    settings = dataclasses.replace(COMPLETE, horizon=horizon)
    online = OnlineLearner(settings, dt=flight.dt, memory=30.0)
    estimate = estimates_of(online, flight)[-1]
    learned = round((estimate.training_end_time - flight.time[0]) / flight.dt) + 1
    longest_pause = max(LEARNING_SECONDS / flight.dt, NEW_SAMPLE_FRACTION * learned)
    assert len(flight) - learned <= longest_pause
    whole = mavdem.learn(flight[:learned], settings)
    assert_array_equal(estimate.model.A, whole.model.A)


@mark.slow
def test_a_gap_keeps_what_was_learnt_and_predicts_nothing_across():
    """After a gap of 5 s the model stays, but the first sample is not predicted."""
    online = OnlineLearner(COMPLETE, dt=0.01)
    estimates_of(online, WINDY[:400])
    later = Flight(WINDY.time[400:500] + 5.0, WINDY.inputs[400:500], WINDY.outputs[400:500])
    estimates = estimates_of(online, later)
    assert np.isnan(estimates[0].expected).all() and estimates[0].model is not None
    assert np.isfinite(estimates[1].expected).all()
    assert np.isnan([estimate.free_energy for estimate in estimates[:8]]).all() and np.isfinite(
        estimates[8].free_energy
    )
    assert online._memory.record().lengths == (400, 100)
    # A clock that jumps back is a gap too.
    assert np.isnan(online.update(3.0, WINDY.outputs[0], WINDY.inputs[0]).expected).all()


@mark.slow
def test_a_vehicle_that_stood_still_is_learnt_from_soon_after_it_moves():
    """Constant samples for 9 s give no model; the first one comes seconds after the vehicle moves."""
    samples_at_rest = 900
    dt = WINDY.dt
    online = OnlineLearner(dt=dt)
    for row in range(samples_at_rest):
        online.update(dt * row, [0.2, 0.0], [1500.0] * 4)
    assert (
        online.no_model_reason.code is OnlineFact.LEARNING_FAILED
        and not online.no_model_reason.figures["kept"]
    )
    first = None
    for row in range(700):
        estimate = online.update(
            dt * (samples_at_rest + row), WINDY.outputs[row], WINDY.inputs[row]
        )
        if first is None and estimate.model is not None:
            first = row
    assert first * dt < 2 * LEARNING_SECONDS + 2.0


@mark.slow
def test_of_many_samples_it_learns_less_often(monkeypatch):
    tracker = FreeEnergyMonitor.from_model(mavdem.learn(WINDY[:300], COMPLETE), 3.0)
    learns = Mock(return_value=tracker)
    monkeypatch.setattr(learner, "_learn_and_monitor", learns)
    estimates_of(OnlineLearner(COMPLETE, dt=WINDY.dt), WINDY[:900])
    assert [len(call.args[0]) for call in learns.call_args_list] == [200, 400, 800]
    learns.reset_mock()
    monkeypatch.setattr(learner, "FULL_RATE_SAMPLES", 100)
    estimates_of(OnlineLearner(COMPLETE, dt=WINDY.dt), WINDY[:900])
    assert [len(call.args[0]) for call in learns.call_args_list] == [200, 600]


@mark.slow
def test_unusual_samples_do_not_shorten_the_pause_between_fits_of_many_samples(monkeypatch):
    tracker = FreeEnergyMonitor.from_model(mavdem.learn(WINDY[:300], COMPLETE), 3.0)
    learns = Mock(return_value=tracker)
    monkeypatch.setattr(learner, "_learn_and_monitor", learns)
    monkeypatch.setattr(learner, "FULL_RATE_SAMPLES", 100)
    monkeypatch.setattr(AnomalyMarks, "add", Mock(return_value=True))
    estimates_of(OnlineLearner(COMPLETE, dt=WINDY.dt), WINDY[:900])
    # After 200 samples the pause is 400 samples, after 600 it is 1200.
    assert [len(call.args[0]) for call in learns.call_args_list] == [200, 600]


@mark.slow
def test_while_the_first_learning_runs_samples_are_not_too_few():
    executor = Mock(**{"submit.return_value": Future()})
    online = OnlineLearner(dt=WINDY.dt, executor=executor, effect_directions=SIGNS)
    estimates_of(online, WINDY[:150])
    assert online.no_model_reason.code is OnlineFact.TOO_FEW_SAMPLES_YET
    estimates = estimates_of(online, WINDY[150:500])
    assert online.no_model_reason.code is OnlineFact.FIRST_LEARNING
    # Samples follow from those before them without that model.
    assert (estimates[-1].expected_band < 0.05 * WINDY.outputs.std(axis=0)).all()


@mark.slow
def test_an_executor_that_is_gone_is_a_reason_for_no_model_and_no_error():
    with ThreadPoolExecutor(1) as executor:
        online = OnlineLearner(dt=0.01, executor=executor)
    estimates_of(online, WINDY[:450])
    assert online.no_model_reason.figures["reason"].figures["error"] == "RuntimeError"
    dead = Future()
    dead.set_exception(BrokenExecutor("a process was killed"))
    online._pending_fit = dead
    online.update(4.5, WINDY.outputs[450], WINDY.inputs[450])
    assert online.no_model_reason.figures["reason"].code is OnlineFact.PROCESS_KILLED


@mark.slow
def test_while_another_thread_learns_no_update_waits_for_it():
    online = OnlineLearner(
        COMPLETE, dt=WINDY.dt, executor=Mock(**{"submit.return_value": Future()})
    )
    estimates_of(online, WINDY[:250])
    with ThreadPoolExecutor(1) as executor, one_thread():
        updates = executor.submit(estimates_of, online, WINDY[250:600])
        assert len(updates.result(timeout=300)) == 350


@mark.slow
@mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
@mark.filterwarnings("ignore::DeprecationWarning")
def test_a_process_forked_while_another_thread_learns_can_learn():
    with one_thread():
        child = os.fork()
        if child == 0:
            with one_thread(wait=False) as free:
                os._exit(0 if free else 1)
        assert os.waitpid(child, 0)[1] == 0


@mark.slow
@mark.parametrize("step", [param(0.02, marks=mark.in_full), -0.01])
def test_a_wrong_dt_is_a_reason_for_no_model(step):
    """Samples come at another step than the learner was told, and later at the right one again."""
    online = OnlineLearner(COMPLETE, dt=0.01)
    estimates_of(online, WINDY[:450])
    for row in range(450, 460):
        online.update(WINDY.time[449] + step * (row - 449), WINDY.outputs[row], WINDY.inputs[row])
        if row >= 454:
            assert online.no_model_reason is not None
        else:
            assert online.no_model_reason is None
    assert online.no_model_reason.code is OnlineFact.SAMPLES_MISPLACED
    assert online.no_model_reason.figures == approx({"interval": step, "step": 0.01})
    estimates_of(online, WINDY[460:480])
    assert online.no_model_reason is None


@mark.parametrize(
    "given, said",
    [
        ({"dt": 0.0}, "dt must"),
        ({"n_inputs": 0}, "n_inputs"),
        ({"memory": 0.5}, "memory must"),
        ({"horizons": (5, 1)}, "horizons must"),
        ({"horizons": 5}, "horizons must be steps, increasing, not 5"),
        ({"horizons": (1, 10**7)}, "from 1 to 100,000"),
        ({"effect_directions": np.ones(3)}, "effect_directions must be 4 finite"),
        ({"effect_directions": np.full(4, np.nan)}, "effect_directions must be 4 finite"),
    ],
)
def test_arguments_that_cannot_be_are_named(given, said):
    with raises(ValueError, match=said):
        OnlineLearner(**given)


@mark.parametrize(
    "time, outputs, inputs, said",
    [
        (np.nan, [0, 0], [0] * 4, "time"),
        (0.0, [0, np.inf], [0] * 4, "outputs"),
        (0.0, [0, 0], [0] * 3, "inputs"),
        (0.0, [0, 1e51], [0] * 4, "outputs must not be larger"),
    ],
)
def test_samples_that_cannot_be_are_refused_and_cost_nothing(time, outputs, inputs, said):
    online = OnlineLearner()
    with raises(ValueError, match=said):
        online.update(time, outputs, inputs)
    assert online._memory.latest_samples(5)[0].size == 0


DT = 0.01


def fed(bands, errors):
    """Half widths as of each sample, where every prediction is 0."""
    half = []
    for sample, error in enumerate(errors):
        half.append(bands.half_widths)
        bands.add(np.array([error]), np.array([[error]]))
        if sample % 10 == 9:
            bands.update()
    return np.array(half)[:, :, 0]


@mark.slow
def test_a_band_forgets_by_the_number_of_errors_and_not_by_their_size():
    errors = default_rng(0).standard_normal(3000)
    errors[1000:1200] *= 1e6
    half = fed(ErrorBands((1,), 1, DT), errors)
    assert half[1000:].max() < 20
    after = 1200 + round(BAND_SECONDS / DT) + 10
    assert_allclose(half[after:], norm.ppf(0.95), rtol=0.2)


@mark.slow
def test_a_band_has_its_level_from_the_first_one_on():
    """Errors 25 steps ahead are sums of 25 innovations: those of 100 outputs, in the first 6 s and after."""
    ahead, outputs = 25, 100
    innovations = default_rng(1).standard_normal((1400 + ahead, outputs))
    sums = innovations.cumsum(axis=0)
    errors = sums[ahead:] - sums[:-ahead]
    bands = ErrorBands((ahead,), outputs, DT)
    coverage = []
    for sample, error in enumerate(errors):
        half_widths = bands.half_widths[1]
        coverage.append(np.where(np.isnan(half_widths), np.nan, abs(error) <= half_widths).mean())
        bands.add(error, error[None])
        if sample % 25 == 24:
            bands.update()
    # Nine independent errors are needed.
    assert np.isnan(coverage[:140]).all() and np.isfinite(coverage[200:]).all()
    assert np.mean(coverage[200:600]) == approx(0.9, abs=0.04)
    assert np.mean(coverage[600:]) == approx(0.9, abs=0.02)


@mark.parametrize("share", [0.99, 1.01, 2.0])
def test_a_band_and_the_unit_of_surprise_end_at_their_limits(share):
    """A fifth of the errors, and a tenth of F(t), lie ``share`` of the limit away, where the others are one away."""
    size = share * MAX_MEDIANS
    half = fed(ErrorBands((1,), 1, DT), np.where(np.arange(1000) % 5, 1.0, size))[-1]
    assert half == approx(min(size, MAX_MEDIANS))
    low = share * MAX_QUARTILES
    values = np.resize([-low, -1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0], 2000)
    assert Surprise(DT, values).add(-low) == approx(max(share, 1.0))


def test_predictions_meet_their_own_sample():
    """Without a model the last sample is held; what was predicted before a gap is not held against what is after it."""
    ahead = OnlineForecaster(DT, (1, 3), 1, None)
    memory = SampleMemory(DT, 10, 6)
    for sample in range(34):
        if sample == 30:
            ahead.end_segment()
        memory.add(np.zeros(1), np.array([sample + 1000.0 * (sample >= 30)]), DT * sample)
        ahead.predict(memory)
        errors = {30: [np.nan, np.nan], 32: [1.0, np.nan], 33: [1.0, 3.0]}.get(
            sample, ahead.errors.latest[:, 0]
        )
        assert_array_equal(ahead.errors.latest[:, 0], errors)


@mark.slow
def test_the_stream_has_the_terms_of_the_flight_and_a_new_model_its_own_past():
    """Its level shifts by nats from one model to the next, which is no change of the vehicle."""
    flight = simulated(samples=300, wind=0.5)
    memory = SampleMemory(DT, 10, 30)
    learned = mavdem.learn(flight)
    monitor = FreeEnergyMonitor.from_model(learned, 3.0)
    streamed = []
    for row in zip(flight.inputs, flight.outputs, flight.time, strict=True):
        memory.add(*row)
        streamed.append(monitor.terms(memory))
    # The first samples have no whole window.
    edge = learned.settings.window - 1
    assert all(terms is None for terms in streamed[:edge])
    terms = np.array(streamed[edge:])
    expected = np.stack(list(learned.free_energy_terms_of_samples().values()), axis=1)
    assert_allclose(terms, expected, rtol=1e-6, atol=1e-9)
    assert_allclose(monitor.past_values, terms.sum(axis=1), rtol=1e-9)
    assert monitor.free_energy_action == approx(terms.sum(), rel=1e-9)


def test_surprise_is_in_units_of_the_lowest_twentieth():
    surprise = Surprise(DT, default_rng(0).standard_normal(10_000))
    assert surprise.add(norm.ppf(0.05)) == approx(1.0, abs=0.15)
    assert surprise.add(2.0) < 0
    few = default_rng(0).standard_normal(100)
    assert np.isfinite(Surprise(DT, few).add(0.0)) and np.isnan(Surprise(DT, few[1:]).add(0.0))
    # After a free energy that did not vary a drop is still a number.
    assert 1e6 < Surprise(DT, np.full(300, 5.0)).add(-1e5) < np.inf
    # A failure that lasts does not hide the next.
    values = default_rng(0).standard_normal(1400)
    values[1000:1200] -= 1e4
    assert Surprise(DT, values).add(-1e4) > 1e3


def surprises(rng, seconds, alike=10):
    """Of F(t) with a long lower tail, ``alike`` for so many samples, in the unit of surprise."""
    low = rng.gamma(1.0, size=round(seconds / DT / alike)).repeat(alike)
    return (low - np.log(2.0)) / (np.log(20.0) - np.log(2.0))


def test_the_limit_of_evidence_is_the_peak_of_once_in_five_minutes():
    """By Gumbel's distribution, of peaks whose median deviation is 1, or less than what they scatter by at least."""
    marks = AnomalyMarks(DT)
    times = (
        marks._peaks.maxlen,
        marks._samples_per_peak,
        marks._refractory_samples,
        marks._new_value_weight,
    )
    assert times == approx((60, 500, 2000, 0.01))
    far = np.sqrt(1 + 1 / 3) * (gumbel_r.isf(1 / 60) - gumbel_r.median())
    assert evidence_limit(np.array([1.0, 2.0, 3.0])) == approx(2 + far / 0.767)
    assert evidence_limit(np.full(3, 2.0)) == approx(2 + far * 0.09)
    assert evidence_limit(np.array([1.0, 2.0])) == np.inf


def marked(marks, surprise):
    return DT * np.flatnonzero([marks.add(value) for value in surprise])


@mark.in_full
def test_marks_without_a_change_are_as_rare_as_stated():
    """Quiet, with a manoeuvre every 6 s, and in gusts of 1 s, for 15 minutes; four deviations of what is expected."""
    for size, alike in ((0.0, 10), (15.0, 10), (0.0, 100)):
        surprise = surprises(default_rng(1), 900.0, alike)
        for start in range(0, len(surprise), 600):
            surprise[start : start + 30] += size
        expected = 900.0 / MEAN_SECONDS_BETWEEN_FALSE_MARKS
        assert len(marked(AnomalyMarks(DT), surprise)) <= expected + 4 * np.sqrt(expected)


@mark.slow
@mark.parametrize("size", [4.0, 1000.0])
def test_a_change_is_marked_promptly_and_so_is_the_next(size):
    """Surprise rises for 2 s at 40 s and at 80 s, then once for good."""
    rng = default_rng(2)
    surprise = surprises(rng, 120.0)
    failures = np.array([40.0, 80.0])
    for at in failures:
        surprise[round(at / DT) : round(at / DT) + 200] += size
    assert_allclose(marked(AnomalyMarks(DT), surprise), failures, atol=0.5)
    # One that lasts hides nothing, itself included.
    surprise = surprises(rng, 55.0)
    surprise[round(20.0 / DT) :] += size
    assert_allclose(marked(AnomalyMarks(DT), surprise), [20.0, 40.0], atol=0.5)
    # Nothing is marked before there are peaks to compare with.
    surprise = np.full(3000, 1e6)
    assert not len(marked(AnomalyMarks(DT), surprise[: round(3 * PEAK_SECONDS / DT)]))
    assert not AnomalyMarks(DT).add(np.nan)
