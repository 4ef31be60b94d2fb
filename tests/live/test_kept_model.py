"""The last good model is kept beside the newest, and written where the newest samples make a poor one."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from functools import cache

import numpy as np
import pytest

import mavdem
from mavdem.dem import Settings
from mavdem.dem.record import Record
from mavdem.live.kept_model import DatedModel, KeptModel, forecast_error

pytestmark = pytest.mark.usefixtures("without_wind_fits")
SETTINGS = Settings(order=3, d=2, window=9, parameter_precision=10.0)
DT = 0.01


def flown(samples: int, seed: int, gain: float = 40.0) -> Record:
    """A roll motion that two motors drive."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.normal(size=(samples // 20 + 1, 2)), 20, axis=0)[:samples]
    y = np.zeros((samples, 2))
    for row in range(1, samples):
        y[row, 1] = 0.97 * y[row - 1, 1] - 0.03 * y[row - 1, 0] + DT * gain * (u[row - 1, 0] - u[row - 1, 1])
        y[row, 0] = y[row - 1, 0] + DT * y[row, 1]
    return Record(u, y + 1e-3 * rng.normal(size=y.shape), DT, (samples,))


def noise(samples: int) -> Record:
    """What a vehicle measures whose motors do nothing: on the ground."""
    rng = np.random.default_rng(9)
    return Record(rng.normal(size=(samples, 2)), np.cumsum(rng.normal(size=(samples, 2)), axis=0), DT, (samples,))


@cache
def good() -> mavdem.Learned:
    return mavdem.learn(flown(1200, 0), SETTINGS)


@cache
def again() -> mavdem.Learned:
    return mavdem.learn(flown(1200, 1), SETTINGS)


@cache
def poor() -> mavdem.Learned:
    return mavdem.learn(noise(1200), SETTINGS)


class Learner:
    """Whose newest samples are these."""

    def __init__(self, record: Record | None) -> None:
        self.record = record

    def learn_now(self) -> mavdem.Learned:
        if self.record is None:
            raise ValueError("there are not enough samples yet")
        return mavdem.learn(self.record, SETTINGS)


def kept(*models: mavdem.Learned, executor: Executor | None = None) -> KeptModel:
    one = KeptModel(executor)
    for time, learned in enumerate((None, *models)):
        one.take(learned, float(time))
    return one


@pytest.mark.slow
def test_the_error_is_small_for_a_model_of_the_same_motion_and_large_for_noise():
    assert forecast_error(good(), flown(1000, 5)) < 0.05
    assert forecast_error(poor(), flown(1000, 5)) > 0.3
    assert np.isnan(forecast_error(good(), flown(50, 5)))
    assert np.isnan(forecast_error(good(), flown(110, 5))), "ten samples after the filter found the state"
    other = flown(1000, 5)
    assert forecast_error(good(), Record(other.inputs[:, :1], other.outputs, DT, (1000,))) == np.inf
    assert forecast_error(good(), Record(other.inputs, other.outputs, 2 * DT, (1000,))) == np.inf


@pytest.mark.slow
def test_a_model_is_kept_once_the_samples_after_it_confirm_it():
    assert kept(good()).model is None
    assert kept(poor(), good()).model.learned is poor(), "better than none"
    assert kept(poor(), good(), again()).model.learned is good()
    one = kept(good(), poor(), again())
    assert one.model == DatedModel(good(), 1.0), "what came after the poor one shows that it is poor"


def test_judging_takes_place_in_the_executor():
    class Later(Executor):
        jobs: list = []

        def submit(self, job, /, *args):
            self.jobs.append((Future(), job, args))
            return self.jobs[-1][0]

    one = kept(poor(), good(), again(), executor=Later())
    ((future, job, args),) = Later.jobs
    assert one.model.learned is poor()
    future.set_result(job(*args))
    one.take(again(), 9.0)
    assert one.model.learned is good()


@pytest.mark.slow
def test_the_newest_is_written_where_it_is_good_even_after_a_change():
    one = kept(good(), again())
    for record in (flown(1500, 7), flown(1500, 7, gain=15.0)):
        learned, reason = one.choose(Learner(record))
        assert reason == "" and len(learned.record) == 1500


def test_the_last_good_one_is_written_where_the_newest_samples_make_a_poor_one():
    one = kept(good(), again())
    rng = np.random.default_rng(3)
    hardly = flown(1500, 7)
    # The first half is too still to learn from: nothing but the sensors' noise.
    still = Record(
        np.where(np.arange(1500)[:, None] < 750, 0.01 * rng.normal(size=(1500, 2)), hardly.inputs),
        np.where(np.arange(1500)[:, None] < 750, 1e-3 * rng.normal(size=(1500, 2)), hardly.outputs),
        DT,
        (1500,),
    )
    learned, reason = one.choose(Learner(still))
    assert learned is good()
    assert "make a poor model" in reason and "learned at 1 s of the boot clock is kept." in reason


def test_without_enough_samples_at_the_end_the_last_good_one_is_written():
    learned, reason = kept(good(), again()).choose(Learner(None))
    assert learned is good() and "not enough samples" in reason
    with pytest.raises(ValueError, match="not enough"):
        kept(good()).choose(Learner(None))
