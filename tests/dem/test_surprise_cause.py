"""A surprise is a misfit of the model where the command explains the acceleration, else a disturbance."""

import numpy as np
from numpy.testing import assert_allclose
from pytest import mark
from simulated import DT, MOTORS, in_closed_loop

from mavdem import OnlineLearner, Settings
from mavdem.dem.learning import prepared_training
from mavdem.dem.online.anomaly_marks import AnomalyMarks
from mavdem.dem.online.surprise_cause import (
    cause_of_surprise,
    explained_share,
    sustained_fraction,
)
from mavdem.facts.online import SurpriseCause

pytestmark = mark.usefixtures("without_wind_fits")
MANOEUVRE = in_closed_loop(seed=2, steering=1.5, samples=300, wind=0.3)
SETTINGS = prepared_training(MANOEUVRE, None)[1]


def cause_in(flight, directions=MOTORS):
    return cause_of_surprise(flight.inputs @ directions, flight.outputs, DT, SETTINGS)


@mark.parametrize("seed", range(3))
def test_a_manoeuvre_in_light_wind_is_a_misfit_of_the_model(seed):
    flight = in_closed_loop(seed=seed, steering=1.5, samples=300, wind=0.3)
    assert cause_in(flight) is SurpriseCause.MODEL_MISFIT


@mark.parametrize("seed", range(3))
def test_turbulence_is_a_disturbance_though_the_controller_answers_it(seed):
    flight = in_closed_loop(seed=seed, samples=300, wind=30.0)
    assert cause_in(flight) is SurpriseCause.DISTURBANCE


def test_motors_that_turn_the_vehicle_the_other_way_explain_nothing():
    assert explained_share(MANOEUVRE.inputs @ -MOTORS, MANOEUVRE.outputs, DT, SETTINGS) == 0.0


def test_the_cause_is_undecided_with_few_samples_or_without_a_command():
    assert cause_in(MANOEUVRE[:200]) is None
    assert cause_in(MANOEUVRE, 0 * MOTORS) is None


def test_a_command_that_stays_away_opposes_a_torque_from_outside():
    steady = MANOEUVRE.inputs.copy()
    steady[-150:] += 5000.0 * MOTORS
    cause = cause_of_surprise(steady @ MOTORS, MANOEUVRE.outputs, DT, SETTINGS)
    assert cause is SurpriseCause.DISTURBANCE
    assert sustained_fraction(steady @ MOTORS, DT) > 0.8
    assert sustained_fraction(MANOEUVRE.inputs @ MOTORS, DT) < 0.2


def test_the_share_is_that_of_a_regression_on_the_lagged_command():
    """Acceleration by a command with a lag of 40 ms, and as much of another frequency."""
    time = DT * np.arange(400)
    command = np.sin(8 * time)
    lagged = np.sin(8 * time - np.arctan(8 * 0.04))
    rate = np.cumsum(lagged + np.sin(25 * time)) * DT
    outputs = np.column_stack([np.cumsum(rate) * DT, rate])
    share = explained_share(command, outputs, DT, SETTINGS)
    # The window of the derivatives takes more of the faster half.
    assert_allclose(share, 0.5, atol=0.08)


@mark.slow
@mark.parametrize("directions, expected", [(MOTORS, SurpriseCause.MODEL_MISFIT), (None, None)])
def test_a_mark_of_the_stream_has_its_cause(monkeypatch, directions, expected):
    """One sample is marked as unusual. With a known mixer the cause of its surprise is determined."""
    marked_sample = 150
    samples = iter(range(1000))
    monkeypatch.setattr(AnomalyMarks, "add", lambda *_: next(samples) == marked_sample)
    learner = OnlineLearner(Settings(horizon=None), dt=DT, effect_directions=directions)
    flight = in_closed_loop(seed=2, steering=1.5, samples=395, wind=0.3)
    for time, outputs, inputs in zip(flight.time, flight.outputs, flight.inputs, strict=True):
        estimate = learner.update(time, outputs, inputs)
        if estimate.unusual:
            marked_time = time
    assert estimate.latest_mark.time == marked_time
    assert estimate.latest_mark.cause is expected
