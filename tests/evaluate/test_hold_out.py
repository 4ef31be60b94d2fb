"""The length of the training data: all of the past, unless forecasts of held-out parts speak against it."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from mavdem import Flight
from mavdem.evaluate import training_length as chosen
from mavdem.evaluate.hold_out import FORECASTS

RATE = 20
NAME = "mavdem.evaluate.hold_out"


def flight(seconds: float) -> Flight:
    samples = round(seconds * RATE)
    numbers = np.arange(samples, dtype=float)
    return Flight(numbers / RATE, numbers, numbers % 2)


class Model:
    """Forecasts of a model of so many samples, whose errors a test decides."""

    def __init__(self, errors: np.ndarray) -> None:
        self.errors = errors

    def forecast_every(self, steps: int, inputs: np.ndarray, outputs: np.ndarray) -> np.ndarray:
        return outputs + np.repeat(np.sqrt(self.errors), steps)[:, None]


def with_errors(monkeypatch: pytest.MonkeyPatch, error_of: object) -> list[tuple[int, int]]:
    """Replaces learning: ``error_of`` a number of seconds is the squared error. Returns the samples learnt from."""
    learnt = []

    def learn(train: Flight, settings: object) -> Model:
        learnt.append((round(train.inputs[0, 0]), round(train.inputs[-1, 0]) + 1))
        seconds = len(train) / RATE
        return Model(error_of(seconds) * np.exp(np.linspace(-1.0, 1.0, FORECASTS)))

    monkeypatch.setattr(f"{NAME}.learn", learn)
    return learnt


@pytest.mark.parametrize(
    ("seconds", "error_of", "expected"),
    [
        (100, lambda s: 1 / s, 70),
        (100, lambda s: 1.0, 70),
        (50, lambda s: 1.0, 50),
        (39, lambda s: 1.0, 35),
        (100, lambda s: 1.0 + (s > 14), 14),
        (100, lambda s: s, 7),
        (100, lambda s: np.array([1.0, 1.0, 1.0, 1.0, 1.5 if s > 14 else 1.0]), 70),
        (22, lambda s: 1.0, 22),
        (21, lambda s: 1.0, 7),
        (5, lambda s: 1.0, 5),
    ],
)
def test_it_is_the_longest_that_is_not_significantly_worse(monkeypatch, seconds, error_of, expected):
    with_errors(monkeypatch, error_of)
    assert chosen(flight(seconds)) == expected * RATE


def test_no_model_has_seen_what_it_forecasts(monkeypatch):
    learnt = with_errors(monkeypatch, lambda s: 1.0)
    done: list[float] = []
    chosen(flight(100), progress=done.append)
    ends = {stop for _, stop in learnt}
    assert ends == {round((100 - 7.5) * RATE), (100 - 15) * RATE}
    assert {stop - start for start, stop in learnt} == {7 * RATE, 14 * RATE, 35 * RATE, 70 * RATE}
    assert done == [i / 8 for i in range(1, 9)]


def test_a_length_that_nothing_can_be_learnt_from_is_not_chosen(monkeypatch):
    with_errors(monkeypatch, lambda s: 1.0)
    learn = sys.modules[NAME].learn

    def refuses(train: Flight, settings: object) -> Model:
        if len(train) > 14 * RATE:
            raise ValueError("nothing")
        return learn(train, settings)

    monkeypatch.setattr(f"{NAME}.learn", refuses)
    assert chosen(flight(100)) == 14 * RATE


@pytest.mark.slow
def test_a_vehicle_that_changed_is_learnt_from_since_then():
    """Of 36 s, the first 20 of which had motors of the opposite effect."""
    from simulated import simulated  # noqa: PLC0415

    same = simulated(samples=3600, wind=0.3, lag=0.05)
    assert chosen(same) > 20 / same.dt
    inputs = same.inputs.copy()
    inputs[:2000] = 2 * inputs.mean(axis=0) - inputs[:2000]
    changed = Flight(same.time, inputs, same.outputs)
    assert chosen(changed) <= 14 / same.dt
