"""At any sampling step the first model comes soon, and what is said until then is true."""

from __future__ import annotations

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
    [(2.5, 859), (10, 258), (30, 125), (100, 125)],
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
