"""One decision on the loops of an axis: what is wrong, and what to change, whatever else the flight shows."""

from dataclasses import replace

import numpy as np
from hover import Hover, evidence_of
from known_gains import PX4
from made_up_loop import made_up
from partial_records import partial_record
from pytest import mark

from mavdem.assessment.axis.loop_decision import (
    LoopDiagnosis,
    LoopObservations,
    common_action,
    decide_on_loops,
)
from mavdem.assessment.axis.margins import AxisMargins, response_comparison
from mavdem.assessment.lights.log import log_light
from mavdem.assessment.lights.margins import margins_light
from mavdem.dataset.parameter_history import ParametersInFlight
from mavdem.dataset.segments import Segment
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Level
from mavdem.facts.ending import Ending, MotionEvent
from mavdem.facts.loops import GainFact, LoopAction, LoopFact, ResponseFact, StepResponseFact
from mavdem.facts.margins import MarginsLight, TrackingLight
from mavdem.loops.advice import advise, gain_reduction_advice
from mavdem.loops.axis_loops import MARGIN_TARGETS
from mavdem.loops.limit_cycles import Oscillation
from mavdem.loops.margins import OpenLoop
from mavdem.loops.measured_response import MeasuredResponse
from mavdem.loops.resonance import Resonance
from mavdem.loops.step_response import StepResponse

UNCHANGED_PX4 = ParametersInFlight.unchanged(PX4)
NOT_STEERED = Fact(LoopFact.NOT_STEERED, share=0.3)
FOLLOWS = Fact(TrackingLight.FOLLOWS_SETPOINT, Level.GOOD, axis="roll", angle_error=0.01)
OVERSHOOTS = Fact(TrackingLight.OVERSHOOTS_SETPOINT, Level.WATCH, axis="roll", overshoot=0.5)
MISSES = Fact(
    TrackingLight.MISSES_SETPOINT, Level.BAD, axis="roll", angle_error=0.2, offset_angle=0.0
)
RESONANCE = Resonance(
    "roll", 4.0, 21.0, 0.95, 40.0, (2.6, 3.4), ms_frequency=23.0, ms_coherence=0.9
)
"""A response whose Ms is surely beyond the least margins."""
PEAK = Resonance("roll", 5.0, 22.0, 0.9, 40.0)
LOWER_RATE_GAINS = {"MC_ROLLRATE_P": 0.1, "MC_ROLLRATE_I": 0.133, "MC_ROLLRATE_D": 0.002}


def falls_short(at_limit_share):
    """A rate that does not reach its setpoint."""
    figures = {"rate_setpoint": 1.8, "reached_rate": 1.2, "at_limit_share": at_limit_share}
    return Fact(TrackingLight.RATE_FALLS_SHORT, Level.WATCH, axis="roll", **figures)


def decision_on_roll(
    loop=NOT_STEERED, tracking=FOLLOWS, parameters=PX4, doubts=(), swing=None, **margins
):
    """The decision on roll, with these sources of its margins."""
    sources = {"response": None, "peak": None, "injected": None, **margins}
    observations = LoopObservations(
        AxisMargins("roll", loop, **sources),
        tracking,
        oscillation=None,
        gain_reduction=None,
        vehicle_repairs=doubts,
        parameters=ParametersInFlight.unchanged(parameters),
        tune_arguments=("my.tlog",),
        attitude_swing=swing,
    )
    return decide_on_loops(observations)


def changed_gains(decision):
    """The gains that a decision names, with their new values."""
    changes = decision.action.figures["changes"]
    assert all(after < before for _, before, after in changes)
    return {name: round(after, 6) for name, _, after in changes}


@mark.parametrize(
    "level, swing, advised",
    [
        (Level.WATCH, {}, "position controller"),
        (Level.WATCH, None, "motors, propellers and load"),
        # An attitude that is far from its setpoint is no matter of the position controller.
        (Level.BAD, {}, "motors, propellers and load"),
        (Level.BAD, {"angle_error": 0.8}, "gains of the attitude controller"),
        # The swing of another axis explains no error, unless the attitude was lost in it.
        (Level.WATCH, {"subject": "pitch"}, "motors, propellers and load"),
        (Level.WATCH, {"subject": "pitch", "angle_error": 0.8}, "gains of the attitude controller"),
    ],
)
def test_an_error_of_a_swinging_attitude_is_remedied_as_the_swing(level, swing, advised):
    """The attitude follows its setpoint badly.

    The advice depends on whether the same axis swung, and on how far it was from its setpoint.
    """
    event = None
    if swing is not None:
        figures = {"subject": "roll", "angle": 0.4, "count": 4, "period": 3.2, **swing}
        event = Fact(MotionEvent.ATTITUDE_SWUNG, time=5.0, end_time=9.8, **figures)
    decision = decision_on_roll(tracking=MISSES.replace(level), swing=event)
    assert decision.diagnosis is LoopDiagnosis.FOLLOWS_BADLY
    assert advised in decision.action.sentence


@mark.slow
def test_a_loop_with_its_margins_stays_as_it_is():
    decision = decision_on_roll(made_up())
    assert (decision.diagnosis, decision.action) == (LoopDiagnosis.NOTHING_WRONG, None)
    assert decision.reason.code is MarginsLight.LOOP_MARGINS and not decision.reasons_against_gains
    # A log that is slow for the loop does not show the same margins surely: neither light nor `mavdem tune` says so.
    fast = Fact(LoopFact.CROSSOVER_FAST, crossover=2.1, rate=9.4, least_rate=50.0)
    slow = replace(made_up(), cautions=(fast,))
    decision = decision_on_roll(slow)
    assert (decision.diagnosis, decision.reason.level) == (LoopDiagnosis.UNKNOWN, Level.UNKNOWN)
    assert "with rates and motors logged at 50 Hz or more" in decision.action.sentence
    slow_evidence = evidence_of(Signals(Hover(hovering=40.0).telemetry(10.0, 10.0)))
    slow_evidence = replace(slow_evidence, loops={"roll": slow})
    light = margins_light(slow_evidence)
    assert light.level is advise(slow).rating.level is Level.UNKNOWN
    assert light.sentence.startswith(
        "Margin goal probably met, roll only, but this log is too slow to be sure:"
    )
    assert log_light(slow_evidence, light).level is Level.WATCH


@mark.slow
@mark.parametrize("tracking", [FOLLOWS, OVERSHOOTS, falls_short(0.0)])
def test_a_loop_below_the_goal_gets_advised_gains_whatever_it_does_in_flight(tracking):
    decision = decision_on_roll(made_up(4.5), tracking, response=RESONANCE)
    assert decision.diagnosis is LoopDiagnosis.BELOW_GOAL and not decision.reasons_against_gains
    assert decision.action.sentence == (
        "Load the gains that `mavdem tune my.tlog --axis all` advises."
    )
    assert decision.reason.remedy == decision.fact.remedy == decision.action.sentence


@mark.slow
def test_a_loop_below_the_goal_of_a_biased_effectiveness_gets_advised_gains():
    loop = made_up(4.5)
    caution = Fact(LoopFact.EFFECT_BIASED, reason=NOT_STEERED)
    biased = replace(loop, plant=loop.plant._replace(bias=-0.15), cautions=(caution,))
    decision = decision_on_roll(biased)
    assert (decision.diagnosis, decision.reasons_against_gains) == (LoopDiagnosis.BELOW_GOAL, ())
    assert decision.action.code is LoopAction.LOAD_ADVISED_GAINS


@mark.slow
def test_a_flight_that_is_no_basis_for_the_advised_gains_is_flown_again_before_they_are_loaded():
    """With 2.5 times the gains too few models lack margin for sound advice.

    With 4.5 times the gains there are enough.
    """
    advice = advise(made_up(2.5))
    assert advice.parameters and not advice.is_sound
    decision = decision_on_roll(made_up(2.5))
    assert (decision.diagnosis, decision.reasons_against_gains) == (LoopDiagnosis.BELOW_GOAL, ())
    assert decision.action.code is LoopAction.FLY_BEFORE_GAINS
    assert decision.action.sentence.startswith("Keep the gains, and fly ten small, quick doublets")
    shares = decision.action.figures
    assert (
        shares["share"] == advice.sure
        and shares["share_lacking"] == advice.fraction_without_margins_before
    )
    to_load = decision_on_roll(made_up(4.5)).action
    assert to_load.code is LoopAction.LOAD_ADVISED_GAINS
    # What another axis surely needs is not put off.
    assert common_action([decision.action, to_load]) is to_load
    assert common_action([decision.action, None]) is decision.action


@mark.slow
def test_a_loop_that_meets_the_goal_only_in_many_models_is_flown_first():
    decision = decision_on_roll(made_up(1.7))
    assert (decision.diagnosis, decision.reasons_against_gains) == (LoopDiagnosis.UNKNOWN, ())
    assert decision.action.code is LoopAction.FLY_DOUBLETS


@mark.slow
@mark.parametrize("factor, level", [(1.0, Level.GOOD), (4.0, Level.BAD)])
def test_sure_margins_of_a_contradicted_model_are_watched_and_give_no_gains(factor, level):
    """The measured response contradicts the loop model: its margins, good or bad, are in doubt."""
    loop = made_up(factor)
    (margins_fact,) = AxisMargins("roll", loop, None, None).facts
    assert margins_fact.level is level
    contradiction = Fact(StepResponseFact.PREDICTION_DOUBTED, subject="roll rate", share=0.4)
    (fact,) = AxisMargins("roll", loop, None, None, contradiction=contradiction).facts
    assert fact.level is Level.WATCH
    assert fact.sentence.startswith("Margins in doubt: the roll ")
    assert fact.sentence.endswith("by a model whose response differs from the flight's.")
    decision = decision_on_roll(loop, contradiction=contradiction)
    assert (decision.diagnosis, decision.reasons_against_gains) == (
        LoopDiagnosis.UNKNOWN,
        (contradiction,),
    )
    assert decision.action.code is LoopAction.FLY_DOUBLETS
    # What was measured of the tracking needs no model.
    overshooting = decision_on_roll(loop, OVERSHOOTS, contradiction=contradiction)
    assert overshooting.diagnosis is LoopDiagnosis.FOLLOWS_BADLY


@mark.slow
def test_the_margin_goal_is_met_if_95_percent_of_the_models_have_it():
    levels = {}
    for factor in (1.0, 1.7, 2.5):
        loop = made_up(factor)
        (fact,) = AxisMargins("roll", loop, None, None).facts
        has_goal = loop.share_meeting(MARGIN_TARGETS["default"]) >= 0.95
        assert fact.is_good is has_goal
        levels[factor] = fact.level
    assert (levels[1.0], levels[1.7]) == (Level.GOOD, Level.WATCH)


@mark.slow
@mark.parametrize(
    "reason, caution, is_contradicted",
    [
        (Fact(ResponseFact.RESPONSE_UNEXPLAINED, rate=0.5), (), True),
        (Fact(ResponseFact.RESPONSE_LIMITED, share=0.2), (), False),
        (None, (Fact(LoopFact.PARAMETERS_CHANGED, changes=()),), False),
    ],
)
def test_a_response_at_limits_or_of_other_gains_contradicts_no_loop(
    reason, caution, is_contradicted
):
    """The measured response has half the predicted gain.

    With motors at limits or changed gains, that says nothing.
    """
    measured = None
    if reason is not None:
        measured = MeasuredResponse((0.3, 0.5), 0.0, 0.0, 1.0, reason)
    loop = replace(made_up(), measured=measured, cautions=caution)
    frequency, closed = loop.rate.frequency, loop.rate.closed_loop_response[0]
    measured_response = partial_record(
        StepResponse,
        axis="roll",
        loop="rate",
        frequency=frequency,
        response=0.5 * closed,
        gain_half=0 * frequency + 0.01,
        max_frequency=30.0,
    )
    comparison = response_comparison(measured_response, loop, frequency, closed)
    assert (comparison is not None) is is_contradicted


@mark.slow
@mark.parametrize("loop_name, is_contradicted", [("rate", False), ("attitude", True)])
def test_an_angle_may_differ_from_its_prediction_where_the_rate_agrees(loop_name, is_contradicted):
    agrees = MeasuredResponse((0.3, 5.0), 90.0, 90.0, 1.0, reason=None)
    loop = replace(made_up(), measured=agrees)
    frequency = loop.rate.frequency
    closed = loop.open_loop(loop_name).closed_loop_of_estimate
    measured_response = partial_record(
        StepResponse,
        axis="roll",
        loop=loop_name,
        frequency=frequency,
        response=1.8 * closed,
        gain_half=0 * frequency + 0.01,
        max_frequency=30.0,
    )
    comparison = response_comparison(measured_response, loop, frequency, closed)
    assert (comparison is not None) is is_contradicted


@mark.slow
def test_an_angle_that_differs_from_its_prediction_is_flown_again_before_its_gain_changes():
    loop = made_up().with_parameters({"MC_ROLL_P": 25.0})
    doubt = Fact(StepResponseFact.PREDICTION_DOUBTED, subject="roll attitude", share=0.5)
    assert decision_on_roll(loop).action.code is LoopAction.LOAD_ADVISED_GAINS
    decision = decision_on_roll(loop, attitude_contradiction=doubt)
    assert decision.diagnosis is LoopDiagnosis.BELOW_GOAL
    assert decision.action == Fact(LoopAction.DO_FIRST, reason=doubt)


def test_a_loop_that_the_flight_refutes_gives_no_gains():
    refusal = Fact(ResponseFact.RESPONSE_DISAGREES, share=0.3, needed=0.8)
    decision = decision_on_roll(refusal)
    assert decision.diagnosis is LoopDiagnosis.UNKNOWN and decision.reasons_against_gains == (
        refusal,
    )
    assert decision.fact.remedy == refusal.remedy


@mark.slow
def test_a_measured_resonance_lowers_p_and_d_unless_the_loop_explains_it():
    for loop in (made_up(), NOT_STEERED):
        decision = decision_on_roll(loop, response=RESONANCE)
        assert decision.diagnosis is LoopDiagnosis.BELOW_GOAL
        assert changed_gains(decision) == LOWER_RATE_GAINS
        assert decision.reasons_against_gains[0].code is MarginsLight.RESONATES


def integrating_loop(crossover):
    """A measured rate loop of an integrator with 45 ms of delay, which crosses over at so many Hz."""
    frequency = np.geomspace(0.5, 60.0, 60)
    response = crossover / (1j * frequency) * np.exp(-0.045j * frequency)
    return OpenLoop(frequency, response[None])


@mark.slow
@mark.parametrize(
    "crossover, diagnosis, gains",
    [
        (20.0, LoopDiagnosis.BELOW_GOAL, LOWER_RATE_GAINS),
        (5.0, LoopDiagnosis.NOTHING_WRONG, None),
    ],
)
def test_an_injected_signal_outranks_the_identified_loop(crossover, diagnosis, gains):
    decision = decision_on_roll(made_up(2.5), injected=integrating_loop(crossover))
    assert decision.diagnosis is diagnosis
    assert decision.reason.code is MarginsLight.LOOP_MEASURED
    assert decision.reasons_against_gains == (decision.reason,), (
        "no gains are computed from such a flight"
    )
    assert (decision.action and changed_gains(decision)) == gains


@mark.slow
def test_a_resonance_outranks_an_injected_signal_that_shows_none():
    decision = decision_on_roll(made_up(), injected=integrating_loop(5.0), response=RESONANCE)
    assert decision.reason.code is MarginsLight.RESONATES
    assert decision.diagnosis is LoopDiagnosis.BELOW_GOAL


@mark.slow
def test_an_overshoot_lowers_the_angle_gain_only_where_no_margin_is_small():
    for loop in (made_up(), NOT_STEERED):
        decision = decision_on_roll(loop, OVERSHOOTS)
        assert decision.diagnosis is LoopDiagnosis.FOLLOWS_BADLY
        assert changed_gains(decision) == {"MC_ROLL_P": 4.33}
        assert decision.reasons_against_gains == (decision.reason,)
    unnamed = decision_on_roll(NOT_STEERED, OVERSHOOTS, parameters={}).action
    assert unnamed.sentence == "Lower the P gain of the roll angle by a third."


@mark.slow
def test_an_axis_that_is_too_slow_gets_higher_gains_unless_a_motor_is_at_a_limit():
    slow = decision_on_roll(made_up(), falls_short(0.0))
    assert slow.is_too_slow and slow.action.code is LoopAction.RAISE_AS_ADVISED
    limited = decision_on_roll(made_up(), falls_short(0.4))
    assert not limited.is_too_slow and limited.action.code is LoopAction.SLOWER_TURNS
    unknown = decision_on_roll(NOT_STEERED, falls_short(None))
    assert unknown.action.sentence == NOT_STEERED.remedy
    for decision in (slow, limited, unknown):
        assert decision.diagnosis is LoopDiagnosis.FOLLOWS_BADLY


@mark.slow
@mark.parametrize("factor", [1.0, 2.5])
def test_an_angle_that_is_missed_asks_for_a_look_at_the_vehicle(factor):
    decision = decision_on_roll(made_up(factor), MISSES)
    assert decision.diagnosis is LoopDiagnosis.FOLLOWS_BADLY and decision.reasons_against_gains
    assert decision.action.sentence == "Check motors, propellers and load before the next flight."
    reached = decision_on_roll(made_up(factor), MISSES.replace(at_limit_share=0.0))
    assert "check the P gains of the roll angle and rate, then motors" in reached.action.sentence
    limited = decision_on_roll(made_up(factor), MISSES.replace(at_limit_share=0.4))
    assert limited.action.sentence == decision.action.sentence


def test_a_peak_of_the_spectrum_alone_decides_nothing():
    decision = decision_on_roll(NOT_STEERED, peak=PEAK)
    assert decision.diagnosis is LoopDiagnosis.UNKNOWN
    trial, logging = decision.fact.remedy.split(" stays. ")
    assert changed_gains(decision) == LOWER_RATE_GAINS
    assert trial.startswith("Hover for a minute with MC_ROLLRATE_P 0.1 for 0.15, MC_ROLLRATE_I")
    assert logging.startswith("Log the rate setpoint")
    without_gains = decision_on_roll(NOT_STEERED, peak=PEAK, parameters={})
    assert "with P, I and D of the roll rate controller a third lower:" in without_gains.fact.remedy
    assert not decision.fact.without_flight_advice.remedy
    repaired = decision_on_roll(NOT_STEERED, peak=PEAK, doubts=(Fact(Ending.CRASHED, time=9.0),))
    assert repaired.action.code is LoopAction.DO_FIRST


@mark.slow
def test_a_limit_cycle_comes_first_and_hides_the_other_axes():
    oscillation = Oscillation("roll", 22.0, 40.0, 0.9, False, 20.0, Segment(0, 10.0, 30.0))
    for axis, diagnosis in (("roll", LoopDiagnosis.OSCILLATES), ("pitch", LoopDiagnosis.UNKNOWN)):
        margins = AxisMargins(axis, made_up(), None, None)
        lowered = gain_reduction_advice(oscillation, UNCHANGED_PX4)
        observations = LoopObservations(
            margins, MISSES, oscillation, lowered, (), UNCHANGED_PX4, ()
        )
        decision = decide_on_loops(observations)
        assert (decision.diagnosis, decision.action) == (diagnosis, lowered)
        assert decision.fact.is_bad and lowered in decision.reasons_against_gains
        assert decision.action.code is GainFact.LOWER_GAINS


@mark.slow
def test_a_vehicle_that_must_be_repaired_keeps_its_diagnosis_and_gets_no_gains():
    crashed = Fact(Ending.CRASHED, time=20.0)
    decision = decision_on_roll(made_up(2.5), doubts=(crashed,))
    assert decision.diagnosis is LoopDiagnosis.BELOW_GOAL and decision.reasons_against_gains == (
        crashed,
    )
    assert decision.action.figures["reason"] == crashed
    sound_axis = decision_on_roll(made_up(), doubts=(crashed,))
    assert (sound_axis.diagnosis, sound_axis.action) == (LoopDiagnosis.NOTHING_WRONG, None)
    assert sound_axis.reasons_against_gains == (crashed,)


def test_gains_of_several_axes_are_lowered_in_one_sentence():
    roll = decision_on_roll(NOT_STEERED, OVERSHOOTS).action
    pitch = roll.replace(axis="pitch", changes=[("MC_PITCH_P", 6.0, 4.0)])
    assert common_action([None, roll, pitch]).sentence == (
        "Lower MC_ROLL_P from 6.5 to 4.33 and MC_PITCH_P from 6 to 4."
    )
    unnamed = [action.replace(changes=()) for action in (roll, pitch)]
    assert common_action(unnamed).sentence == (
        "Lower the P gain of the roll and pitch angle by a third."
    )
    assert common_action([None, None]) is None
