"""At any sampling step the first model comes soon, and what is said until then is true."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import mavdem
from mavdem.dem.learning import FEWEST_SAMPLES
from mavdem.dem.online.learner import FIRST_LEARNING_SECONDS, FIRST_RUNS, TOO_FEW

pytestmark = pytest.mark.usefixtures("without_wind_fits")
LOG = Path(__file__).parents[2] / "logs" / "ardupilot_wind5_steps.tlog"


@pytest.fixture(scope="module")
def flight() -> mavdem.Flight:
    return mavdem.read_flight(LOG)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("milliseconds", "samples"),
    # Before, with the samples beside: 859, 463, 258, 165, 160, 495, 476, 325, 339, and none at 100 ms within 60 s.
    [(2.5, 859), (5, 463), (10, 258), (20, 126), (25, 119), (30, 125), (35, 125), (40, 170), (50, 150), (100, 125)],
)
def test_the_first_model_comes_after_so_many_samples(flight, milliseconds, samples):
    dt = milliseconds / 1e3
    time = np.arange(flight.time[0], flight.time[0] + max(3.5, 1.3 * samples * dt), dt)
    outputs, inputs = (
        np.column_stack([np.interp(time, flight.time, channel) for channel in table.T])
        for table in (flight.outputs, flight.inputs)
    )
    online, said, first = mavdem.OnlineLearner(dt=dt), [], None
    for sample, row in enumerate(zip(time, outputs, inputs, strict=True), start=1):
        estimate = online.update(*row)
        if estimate.model is not None:
            first = sample
            break
        said.append(online.obstacle)
    assert first is not None and first <= 1.1 * samples
    begins = max(round(FIRST_LEARNING_SECONDS / dt), 2 * FEWEST_SAMPLES)
    assert set(said[: begins - 1]) == {TOO_FEW}
    assert set(said[begins - 1 : -1]) <= {FIRST_RUNS}
    assert online.obstacle == said[-1] == ""


def test_a_fit_under_way_is_finished_before_another_choice_of_samples(flight):
    complete = mavdem.Settings(order=3, d=2, window=9, parameter_precision=1.0)
    online = mavdem.OnlineLearner(complete, dt=flight.dt)
    rows = zip(flight.time, flight.outputs, flight.inputs, strict=True)
    while online._refit is None:
        online.update(*next(rows))
    begun, online._next_choice = online._refit, 0
    online._settings = dataclasses.replace(complete, window=7)
    while (estimate := online.update(*next(rows))).model is None:
        assert online._refit is begun
    assert online._tracker.window == 9 and estimate.model is not None
    online.update(*next(rows))
    assert online._refit.settings.window == 7
