"""Step responses of identified rate loops: which are trusted; and margins that are not known, or at their limit."""

from dataclasses import replace

import numpy as np
from made_up_loop import made_up
from numpy.testing import assert_allclose
from pytest import approx, fixture, mark, raises

from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.loops import LoopFact, ResponseFact
from mavdem.loops.identification import _require_known_margin
from mavdem.loops.identified_step import (
    MAX_UNEXPLAINED_OUTPUT,
    identified_steps,
    step_from_frequency_response,
)
from mavdem.loops.loop_construction import loop_from_plant
from mavdem.loops.margins import plant_response, rate_loop
from mavdem.loops.measured_response import MeasuredResponse
from mavdem.loops.step_response import MIN_RISE_MESSAGES, _steps_of_fast_loop, least_rise_time

TIME = np.linspace(0.0, 0.5, 101)


@fixture(scope="module")
def loop():
    """A loop whose controller explains nearly all of the output."""
    made = made_up()
    return replace(made, plant=made.plant._replace(unexplained_output=0.01))


@mark.slow
def test_the_step_of_an_identified_loop_is_that_of_its_estimate_with_draws_about_it(loop):
    steps = identified_steps(loop, TIME, 50)
    true = step_from_frequency_response(
        loop.rate.frequency, loop.rate.closed_loop_response[0], TIME
    )
    assert steps.shape == (51, 101)
    assert_allclose(steps[0], true)
    assert steps[1:].mean(axis=0) == approx(true, abs=0.05)
    assert steps[1:].std(axis=0).max() < 0.1
    assert steps[0, -1] == approx(1.0, abs=0.1)


@mark.slow
def test_a_controller_that_explains_too_little_of_the_output_shows_no_step(loop):
    other = loop.plant._replace(unexplained_output=2 * MAX_UNEXPLAINED_OUTPUT)
    assert identified_steps(replace(loop, plant=other), TIME, 5) is None
    # The made-up plant, as one of inputs and outputs alone, has a share of NaN.
    assert identified_steps(made_up(), TIME, 5) is None


@mark.slow
def test_a_loop_that_the_flight_contradicts_shows_no_step(loop):
    reason = Fact(ResponseFact.RESPONSE_DISAGREES, share=0.3, needed=0.8)
    measured = MeasuredResponse((0.3, 8.0), 20.0, 30.0, 1.0, reason)
    assert identified_steps(replace(loop, measured=measured), TIME, 5) is None


def test_only_a_loop_that_rises_within_a_few_messages_is_too_fast(monkeypatch):
    """A step that rises evenly in 0.1 s takes 0.08 s from 10 to 90 %."""
    steps = np.minimum(TIME / 0.1, 1.0)[None]
    monkeypatch.setattr(
        "mavdem.loops.step_response.identified_steps", lambda loop, time, count: steps
    )
    longest = 0.08 / MIN_RISE_MESSAGES
    assert _steps_of_fast_loop(made_up(), TIME, 1.1 * longest) is steps
    assert _steps_of_fast_loop(made_up(), TIME, 0.9 * longest) is None
    # Samples faster than 200 Hz are reduced to that.
    assert least_rise_time(50.0) == 0.24 and least_rise_time(400.0) == least_rise_time(200.0)


@mark.slow
def test_intervals_of_margins_end_at_the_limit_of_stability():
    sound = made_up(2.5)
    unsure = sound.plant._replace(covariance=30 * sound.plant.covariance)
    loop = loop_from_plant(unsure, sound.record)
    assert np.quantile(loop.characteristics["phase_margin"], 0.05) < 0 < loop.phase_margin
    assert loop.phase_margin_interval[0] == loop.gain_margin_interval[0] == 0


@mark.parametrize(
    "scale, deviation, reason",
    [
        (1.0, 0.0, ""),
        # A delay that is uncertain by 30 ms leaves much open, but not whether a slow loop has 45° of phase margin.
        (0.5, 0.03, ""),
        # The loop is unstable.
        (8.0, 0.0, "the identified loop is unstable"),
        (
            1.0,
            0.012,
            "the phase margin is 42° to 75° (90 % interval), too uncertain to say whether it reaches 45°",
        ),
    ],
)
def test_a_rate_loop_is_refused_if_its_margin_may_be_below_or_above_the_goal(
    loop, scale, deviation, reason
):
    effectiveness = np.full(101, scale * loop.effectiveness[0])
    dynamics = np.tile(loop.dynamics[0], (101, 1))
    dynamics[1:, 2] += np.linspace(-deviation, deviation, 100).clip(-dynamics[0, 2])
    rate = rate_loop(loop.controller, plant_response(loop.controller, effectiveness, dynamics))
    if not reason:
        _require_known_margin(rate)
        return
    with raises(NotLearnable) as refusal:
        _require_known_margin(rate)
    assert refusal.value.fact.code is LoopFact.MARGIN_UNCERTAIN
    assert str(refusal.value.fact).startswith(f"No margins: {reason}")


@mark.slow
def test_a_loop_that_crosses_over_where_position_control_acts_too_has_no_margins():
    sound = made_up()
    slow = sound.plant._replace(effect=0.02 * sound.plant.effect)
    with raises(NotLearnable) as refusal:
        loop_from_plant(slow, sound.record)
    fact = refusal.value.fact
    assert fact.code is LoopFact.CROSSOVER_UNSEEN
    assert "below 0.8 Hz drag and position control move the vehicle too" in str(fact)
    assert "P gain" in fact.remedy
