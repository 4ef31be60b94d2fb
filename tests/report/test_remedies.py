"""Remedies that forbid to fly, sentences that name the margins, and what a step towards them reaches."""

from made_up_analysis import measured_vibration
from pytest import mark

from mavdem.facts import Fact, Level
from mavdem.facts.assessment import NextStep
from mavdem.facts.ending import Ending, FailedFirst
from mavdem.facts.loops import GainFact, LoopFact
from mavdem.facts.motors import MotorsLight
from mavdem.report.templates import forbids_flight, sentence_templates


def loss_of_control(cause):
    return Fact(Ending.CONTROL_LOST, time=9.0, height=2.0, cause=cause, word=None)


@mark.parametrize(
    "fact",
    [
        loss_of_control(None),
        loss_of_control(Fact(FailedFirst.ALL_OFF_FIRST)),
        loss_of_control(Fact(FailedFirst.THROTTLE_CLOSED_FIRST)),
        loss_of_control(Fact(FailedFirst.LIMIT_FIRST, subject="motor 1")),
        Fact(MotorsLight.MOTOR_LIMITED, Level.BAD, subject="motor 2", share=0.1),
        measured_vibration(Level.BAD),
        measured_vibration(Level.WATCH),
        measured_vibration(Level.GOOD),
    ],
)
def test_a_fact_forbids_flight_where_its_remedy_says_so(fact):
    """A fact forbids flight exactly if its remedy begins with "Do not fly"."""
    assert forbids_flight(fact) == fact.remedy.startswith("Do not fly")


def test_remedies_that_forbid_to_fly_are_marked_and_can_be_said_in_short():
    for code, templates in sentence_templates().items():
        remedy = templates.get("remedy", "")
        forbids = "{{ ban }}" in remedy or "do not fly" in remedy.lower()
        assert not forbids or "forbids_flight" in templates, code
        assert "Do not fly before" not in remedy, code


@mark.parametrize("ending", Ending)
def test_no_vehicle_that_was_lost_is_told_to_land(ending):
    fact = Fact(ending, time=9.0, height=2.0, cause=None, word=None, subject="")
    assert "Land now" not in Fact(NextStep.LAND_NOW, reason=fact).sentence


def test_the_margins_are_named_once_in_a_reason_for_none():
    no_setpoint = Fact(LoopFact.NO_RATE_SETPOINT, is_logged=False, least_rate=8.0)
    no_loop = Fact(LoopFact.NO_LOOP, reasons=(no_setpoint,))
    assert Fact(LoopFact.NO_MARGINS, reason=no_setpoint).sentence == no_setpoint.sentence
    assert Fact(LoopFact.NO_MARGINS, reason=no_loop).sentence == no_setpoint.sentence


@mark.parametrize(
    "share, reached",
    [
        (0.004, "and fewer than 0.5 % with 20 % more or less"),
        (0.2, "and 20 % with 20 % more or less"),
    ],
)
def test_few_models_that_reach_the_goal_are_not_rounded_to_none(share, reached):
    expected = Fact(LoopFact.MARGIN_RATING, phase_margin=44.0, gain_margin=8.9, ms=1.9)
    target = {"phase_margin": 45.0, "gain_margin": 6.0, "ms": 2.0}
    shares = {"share": share, "share_as_flown": 0.4}
    step = Fact(
        GainFact.STEP_TOWARDS_MARGINS, stage=1, flights=1, expected=expected, **shares, **target
    )
    assert reached in step.sentence


@mark.parametrize(
    ("rate", "end"),
    [
        (24.0, "calm air, with rates and motors logged at 100 Hz (here RATE at 24 Hz)."),
        (98.0, "calm air."),
    ],
)
def test_advice_to_log_faster_states_the_recorded_rates(rate, end):
    not_steered = Fact(LoopFact.NOT_STEERED, share=0.2, names=("RATE",), rates=(rate,))
    assert not_steered.remedy.endswith(end)


def test_advice_to_log_a_setpoint_names_the_messages_of_the_recorder():
    missing = Fact(LoopFact.NO_RATE_SETPOINT, is_logged=False, least_rate=8.0, recorder="DataFlash")
    assert "RATE" in missing.remedy and "ATTITUDE_TARGET" not in missing.remedy
