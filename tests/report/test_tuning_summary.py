"""What stands first in the report of ``mavdem tune``: its headline, and what to do next."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
from hover import Hover
from made_up_loop import made_up
from partial_records import partial_record
from pytest import mark

from mavdem.assessment.axis.flight_for_gains import (
    flight_for_gains,
    hover_before_tuning,
    is_removed_by_flight,
)
from mavdem.assessment.axis.loop_decision import LoopDecision, LoopDiagnosis
from mavdem.assessment.axis.lowered_gains import limited_to_axes, lowered_gains
from mavdem.assessment.axis.responses import LoopResponse
from mavdem.assessment.axis.tuning import Tuning
from mavdem.assessment.axis.tuning_step import judgement_with_tuning_step
from mavdem.assessment.judgement import Judgement
from mavdem.confidence import IntervalEstimate
from mavdem.dataset.motor_outputs import DEMAND_MESSAGE
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import NextStep
from mavdem.facts.lights import Light
from mavdem.facts.loops import ControllerFact, GainFact, LoopAction, LoopFact, StepResponseFact
from mavdem.facts.margins import MarginsLight
from mavdem.facts.model import ParameterDoubt
from mavdem.facts.motors import MotorsLight
from mavdem.facts.power import PowerLight
from mavdem.loops.advice import Advice, Gain, advise
from mavdem.loops.identified_step import PredictedStep
from mavdem.loops.step_response import StepResponse
from mavdem.report.blocks import Sentence, plain_text
from mavdem.report.pages.loop_chapters import sentences_without_response
from mavdem.report.pages.page import Chapter
from mavdem.report.pages.step_captions import gain_caption, step_caption
from mavdem.report.pages.tune_page import (
    _repeats_headline,
    rate_disagreement_sentences,
)
from mavdem.report.templates import Medium, render_section, sentences_for
from mavdem.report.tuning.advice import is_stated
from mavdem.report.tuning.goal import _goal_prospect, sentences_on_reached_goal
from mavdem.report.tuning.outcomes import outcome_by_axis, outcome_sentences
from mavdem.report.tuning.reasons import sentences_without_gains, tune_blocks
from mavdem.report.tuning.result import tuning_result
from mavdem.report.tuning.slower import facts_on_slower_rate
from mavdem.report.tuning.summary import later_flight_sentences, tune_summary
from mavdem.report.tuning.tables import _rise_time_text

NOT_STEERED = Fact(LoopFact.NOT_STEERED, share=0.3)
STEP_TO_CONFIRM = {"names": ("roll",), "can_go_on": False, "needed": 0.9, "least_rate": None}
LOWER = Fact(
    LoopAction.LOWER_BY_A_THIRD,
    subject="rate",
    axis="roll",
    changes=(("ATC_RAT_RLL_P", 0.135, 0.09),),
)
RESONATES = Fact(
    MarginsLight.RESONATES,
    Level.BAD,
    axis="roll",
    ms_interval=(4.5, 5.0),
    needed=2.0,
    frequency=22.0,
    coherence=0.62,
    action=LOWER,
)
SUPPLY_LOW = Fact(PowerLight.SUPPLY_LOW, Level.WATCH, voltage=4.61, voltage_limit=4.8, time=None)
LIMITED = Fact(MotorsLight.MOTOR_LIMITED, Level.BAD, names=("motor 1",), share=0.1)


def phase_margin_fact(axis, phase_margin, level=Level.BAD):
    """The phase margin of a rate loop that has too little of it, known to ±5°."""
    return Fact(
        MarginsLight.LOOP_MARGINS,
        level,
        subject="rate",
        axis=axis,
        rating=Level.BAD,
        lacking="phase_margin",
        phase_margin=phase_margin,
        phase_margin_interval=(phase_margin - 5.0, phase_margin + 5.0),
        reason=None,
    )


def tuning_of(headline, reason_of_next_step, decisions, **fields):
    """A tuning of a flight with this headline, in which the loops of roll and pitch are not known."""
    lights = {Light.TRACKING: NOT_STEERED, Light.MARGINS: NOT_STEERED}
    next_step = Fact(NextStep.DO_AS_ADVISED, reason=reason_of_next_step)
    judgement = Judgement(headline, next_step, lights, decisions)
    no_loop = Fact(LoopFact.NO_LOOP, reasons=(NOT_STEERED,))
    axes = {"roll": no_loop, "pitch": no_loop}
    return Tuning(axes, (), {}, {}, None, judgement, no_loop=no_loop, **fields)


def test_the_headline_names_all_axes_that_lack_the_same_margin_as_much():
    facts = {
        "roll": phase_margin_fact("roll", 29.0),
        "pitch": phase_margin_fact("pitch", 30.0),
        "yaw": phase_margin_fact("yaw", 40.0, Level.WATCH),
    }
    decisions = {
        axis: LoopDecision(axis, LoopDiagnosis.BELOW_GOAL, fact) for axis, fact in facts.items()
    }
    result = tuning_result(tuning_of(facts["roll"], facts["roll"], decisions))
    assert result.sentence == (
        "Too little margin: the roll rate loop has 29° (24 to 34) of phase margin, "
        "that of pitch 30° (25 to 35)."
    )


def test_a_measured_lack_of_margin_names_the_other_axes_that_lack_it():
    measured = Fact(
        MarginsLight.RESONATES,
        Level.WATCH,
        axis="pitch",
        ms_interval=(2.2, 2.3),
        needed=2.0,
        frequency=19.0,
        coherence=0.94,
    )
    facts = {"roll": phase_margin_fact("roll", 29.0), "pitch": measured}
    decisions = {
        axis: LoopDecision(axis, LoopDiagnosis.BELOW_GOAL, fact) for axis, fact in facts.items()
    }
    result = tuning_result(tuning_of(measured, measured, decisions))
    assert result.sentence == (
        "Little margin: the pitch rate loop has Ms 2.2 to 2.3 at 19 Hz by the measured response of the rate "
        "(at most 2 is good; coherence 0.94). The roll rate loop is below the margin goal, too."
    )


def test_a_reason_that_all_axes_share_is_the_headline_and_stands_nowhere_else():
    tuning = tuning_of(SUPPLY_LOW, SUPPLY_LOW, {})
    headline, *_ = tune_summary(tuning, SUPPLY_LOW)
    assert headline.lead.startswith("No gains, because") and "30 %" in headline.lead
    assert tune_blocks(tuning, headline_above=SUPPLY_LOW) == []
    own_reason = Fact(LoopFact.NO_LOOP, reasons=(LIMITED,))
    tuning = tuning._replace(axes={**tuning.axes, "yaw": own_reason})
    headline, *_ = tune_summary(tuning, SUPPLY_LOW)
    assert headline.lead.endswith("no margins of roll, pitch and yaw can be relied on.")


def test_what_the_flight_shows_and_needs_is_said_once():
    """A motor at its limit is a finding of the flight, and one of two reasons against gains."""
    other = Fact(MotorsLight.MOTOR_LIMITED, Level.BAD, names=("motor 2",), share=0.2)
    tuning = tuning_of(NOT_STEERED, NOT_STEERED, {})
    lights = {**tuning.judgement.lights, Light.MOTORS: LIMITED}
    judgement = replace(tuning.judgement, lights=lights)
    reasons = Fact(LoopFact.NO_LOOP, reasons=(other, LIMITED))
    tuning = tuning._replace(judgement=judgement, axes={"roll": reasons})
    [sentence] = tune_blocks(tuning, is_full=False)
    assert "motor 2" in sentence.text and "motor 1" not in sentence.text
    needs = [line for line in tune_summary(tuning, NOT_STEERED) if "For gains" in line.lead]
    assert not any(LIMITED.remedy in line.text for line in needs)


def test_telemetry_of_px4_needs_a_command_to_have_the_rate_setpoint():
    """ArduPilot's telemetry, and logs on board, name the messages."""
    missing = NO_SETPOINT.replace(recorder="", autopilot="PX4")
    assert missing.remedy == (
        "To log the rate setpoint, in PX4's shell run `mavlink stream -d DEVICE -s ATTITUDE_TARGET -r 100`, "
        "where DEVICE is the telemetry port (`-u PORT` for UDP)."
    )
    ardupilot = missing.replace(autopilot="ARDUPILOTMEGA")
    assert ardupilot.remedy == "Log the rate setpoint: ATTITUDE_TARGET."
    assert NO_SETPOINT.replace(autopilot="PX4").remedy.endswith(
        "RATE and ATT (ArduCopter from 3.3 on)."
    )


def flight_of(
    reasons,
    *,
    axes_without_controller=(),
    is_after_repair=False,
    parameters=None,
    attitude_rate=400.0,
):
    """The flight for gains of the axes that have these reasons for no gains, after a DataFlash log."""
    advice = {axis: Fact(LoopFact.NO_LOOP, reasons=(reason,)) for axis, reason in reasons.items()}
    telemetry = replace(
        Hover().telemetry(parameters=parameters or {}),
        translated_from="DataFlash",
        messages={DEMAND_MESSAGE: {}},
    )
    evidence = Mock(loops=advice)
    evidence.signals.telemetry = telemetry
    evidence.signals.attitude.rate_series = _messages_at(attitude_rate)
    evidence.log.components = ()
    return flight_for_gains(
        evidence, advice, {}, axes_without_controller, is_after_repair=is_after_repair
    )


SLOW = Fact(LoopFact.NOT_STEERED, share=0.16, names=("ATT", "RCOU"), rates=(9.8, 9.8))
SLOWER = SLOW.replace(share=0.1)
NO_SETPOINT = Fact(LoopFact.NO_RATE_SETPOINT, is_logged=False, least_rate=8.0, recorder="DataFlash")
NOT_FOUND = Fact(LoopFact.LOOP_NOT_FOUND)


@mark.parametrize(
    "reasons, parameters, text",
    [
        (
            {"roll": NO_SETPOINT, "yaw": NOT_STEERED},
            {},
            "Log the rate setpoint: RATE and ATT (ArduCopter from 3.3 on). Set bit 0 of LOG_BITMASK (fast attitude; "
            "the log does not show whether it is set), which logs attitude and the demand at 50 Hz or more. "
            "Then fly ten quick doublets about each of roll and yaw in calm air, "
            "and run `mavdem tune --axis all` on that log.",
        ),
        (
            {"roll": NOT_STEERED, "pitch": SLOWER, "yaw": SLOW},
            {"LOG_BITMASK": 176126.0},
            "LOG_BITMASK is 176126 in this log: set it to 176127, with bit 0 (fast attitude), which logs attitude "
            "and the demand at 50 Hz or more. Then fly ten quick doublets about each of roll, pitch and yaw in calm "
            "air, and run `mavdem tune --axis all` on that log.",
        ),
        # The log shows no setting that makes messages faster.
        (
            {"roll": SLOW},
            {"LOG_BITMASK": 176127.0},
            "Fly ten quick doublets about roll in calm air, with rates and motors logged at 100 Hz (here ATT at "
            "9.8 Hz and RCOU at 9.8 Hz), and run `mavdem tune` on that log.",
        ),
    ],
)
def test_one_next_step_for_all_axes_says_what_to_set_and_which_doublets_to_fly(
    reasons, parameters, text
):
    flight = flight_of(reasons, parameters=parameters)
    assert flight.sentence == text
    assert len(set(flight.figures["also"])) == len(flight.figures["also"])
    tuning = tuning_of(NOT_STEERED, NOT_STEERED, {}, flight_for_gains=flight)
    axes = {axis: Fact(LoopFact.NO_LOOP, reasons=(reason,)) for axis, reason in reasons.items()}
    judgement = judgement_with_tuning_step(
        tuning.judgement,
        axes,
        (),
        flight,
        has_new_gains=False,
        is_written=False,
        must_be_repaired=False,
    )
    tuning = tuning._replace(axes=axes, judgement=judgement)
    [*_, last_sentence] = tune_summary(tuning, NOT_STEERED)
    assert last_sentence == Sentence(text, "Next:")
    report = tune_blocks(tuning, is_full=False, headline_above=NOT_STEERED)
    assert not any("doublets" in sentence.text for sentence in report)


def test_after_a_repair_doublets_are_flown_if_another_flight_can_show_the_gains():
    reasons = {"roll": LIMITED, "pitch": LIMITED}
    assert flight_of(reasons) is None
    # No flight shows the gains of a controller that the log does not describe.
    assert flight_of(reasons, axes_without_controller=[*reasons], is_after_repair=True) is None
    flight = flight_of(reasons, axes_without_controller=("roll",), is_after_repair=True)
    tuning = tuning_of(LIMITED, LIMITED, {}, flight_for_gains=flight)
    *_, last_sentence = tune_summary(tuning, LIMITED)
    assert last_sentence.lead == "To tune then:"
    # The repair changes the loops: they may have less margin than those that flew.
    assert last_sentence.text.startswith(
        "Hover low for a minute, ready to land; if nothing shakes or swings, fly ten quick doublets"
    )
    # The same log settings are advised as for a vehicle that needs no repair.
    slow_log = {"parameters": {"LOG_BITMASK": 126.0}, "attitude_rate": 10.0}
    flight = flight_of({"pitch": LIMITED}, is_after_repair=True, **slow_log)
    assert flight.sentence.startswith("LOG_BITMASK is 126 in this log: set it to 127")
    assert "fly ten quick doublets about pitch" in flight.sentence


def test_a_vehicle_that_oscillates_hovers_with_lower_gains_before_it_is_tuned():
    evidence = Mock()
    evidence.log.components = ()
    telemetry = Hover().telemetry(parameters={"LOG_BITMASK": 126.0})
    evidence.signals.telemetry = replace(telemetry, translated_from="DataFlash")
    evidence.signals.attitude.rate_series = _messages_at(10.0)
    tuning = tuning_of(LIMITED, LIMITED, {}, hover_to_tune=hover_before_tuning(evidence))
    *_, last_sentence = tune_summary(tuning, LIMITED)
    assert last_sentence.lead == "Then:"
    assert last_sentence.text.startswith("LOG_BITMASK is 126 in this log: set it to 127")
    assert "Then hover low for a few seconds with the lower gains" in last_sentence.text
    evidence.signals.attitude.rate_series = _messages_at(400.0)
    assert not hover_before_tuning(evidence).figures["also"]


def test_a_filter_to_try_after_the_lower_gains_is_advised_below_them():
    margins = Fact(LoopFact.MARGIN_RATING, phase_margin=57.0, gain_margin=6.5, ms=1.9)
    cutoff = Fact(
        GainFact.GYRO_CUTOFF_LOW,
        axis="roll",
        name="INS_GYRO_FILTER",
        changes=(("INS_GYRO_FILTER", 20.0, 40.0),),
        crossover=13.0,
        phase_lag=57.0,
        new_phase_lag=27.0,
        rating=margins.replace(ms=2.3),
        expected=margins,
        noise=2e-4,
    )
    tuning = tuning_of(LIMITED, LIMITED, {}, gyro_cutoff=cutoff)
    assert "INS_GYRO_FILTER" not in plain_text(tune_summary(tuning, LIMITED))
    [later] = later_flight_sentences(tuning)
    assert later.lead == "Later, instead of lower gains:" and "INS_GYRO_FILTER 40," in later.text
    assert not later_flight_sentences(tuning._replace(gyro_cutoff=None))
    # The filter that takes the phase is named above the next step, and its lag is not repeated below the gains.
    lags = {"motor_phase_lag": 8.0, "delay_phase_lag": 2.0}
    noise = {"new_noise": 8e-4, "lowest_noise": 62.0, "highest_noise": 180.0}
    lag = cutoff.replace(**lags, **noise).with_code(GainFact.GYRO_FILTER_LAG)
    tuning = tuning._replace(gyro_filter_lag=lag)
    leads = [sentence.lead for sentence in tune_summary(tuning, LIMITED)]
    assert leads.index("Cause:") + 1 == leads.index("Next:")
    [later] = later_flight_sentences(tuning)
    assert later.text.startswith("Fly the lower gains first:")


def test_the_goal_of_gains_that_must_not_be_loaded_is_apart_from_that_of_present_gains():
    kept = advise(made_up(), doubts=[Fact(LoopFact.NOT_STEERED, share=0.3)])
    tried = replace(kept, gains={"ATC_RAT_RLL_P": Gain(0.1, 0.08)}, sure=0.69)
    assert tried.parameters and not tried.is_sound
    with_tried, with_present = sentences_on_reached_goal({"roll": tried, "pitch": kept})
    assert with_tried.lead == "Goal with the gains tried, not to be loaded:"
    assert "roll" in with_tried.text and "pitch" not in with_tried.text
    assert "with the present gains" in with_tried.text
    assert "More steps may follow" not in with_tried.text
    assert with_present.lead == "Goal reached:" and "present gains" not in with_present.text


def test_a_goal_that_more_or_less_thrust_misses_is_so_qualified_in_the_headline():
    kept = advise(made_up(), doubts=[Fact(LoopFact.NOT_STEERED, share=0.3)])
    rating = kept.rating.figures | {"axis": "roll", "action": None, "reason": None}
    met = Fact(
        MarginsLight.LOOP_MARGINS, Level.WATCH, rating=Level.WATCH, is_biased=False, **rating
    )
    for sure, clause in ((0.18, "thrust, but only by 18 % of the models"), (0.9, "")):
        tuning = tuning_of(met, met, {})._replace(advice=[replace(kept, sure=sure)])
        result = tuning_result(tuning)
        assert clause in result.sentence
        assert ("at this flight's thrust" in result.sentence) is bool(clause)


def test_after_a_repair_a_firmware_without_the_gains_is_updated_before_any_doublets():
    too_old = Fact(
        ControllerFact.PARAMETERS_MISSING,
        names=("MOT_THST_EXPO",),
        firmware="ArduCopter V3.2.1",
        is_too_old=True,
    )
    tuning = tuning_of(LIMITED, LIMITED, {}, controller_faults={"roll": too_old, "pitch": too_old})
    crashed = Fact(LoopFact.NO_LOOP, reasons=(LIMITED,))
    tuning = tuning._replace(axes={"roll": crashed, "pitch": crashed})
    *_, last_sentence = tune_summary(tuning, LIMITED)
    assert last_sentence == Sentence(
        "ArduCopter V3.2.1 has no MOT_THST_EXPO, and so cannot be tuned with mavdem. "
        "Update ArduCopter, and log all of its parameters.",
        "Then, for gains of roll and pitch:",
    )


@mark.parametrize(
    "doubt, is_removed",
    [
        (Fact(ParameterDoubt.WIND_SHARE_HIGH, share=0.24, share_limit=0.2, bias=None), True),
        # Doublets show no motor time constant that is shorter than a sample.
        (Fact(ParameterDoubt.FILTER_TAKEN_FOR_LAG, bias=0.1), False),
    ],
)
def test_doublets_are_flown_for_margins_that_wind_biases_and_not_the_log(doubt, is_removed):
    bias = Fact(LoopFact.EFFECT_BIASED, reason=doubt)
    assert is_removed_by_flight(bias) is is_removed
    unsure = Fact(LoopFact.MARGIN_RATING, Level.WATCH, is_log_slow=False)
    kept = Mock(spec=Advice, refusals=(), parameters={}, rating=unsure, before=Mock())
    kept.before.cautions = (bias,)
    evidence = Mock()
    evidence.log.components = ()
    evidence.signals.telemetry = Hover().telemetry()
    flight = flight_for_gains(evidence, {"yaw": kept}, {}, (), is_after_repair=False)
    assert (flight is not None) is is_removed
    kept.rating = unsure.replace(Level.GOOD)
    assert flight_for_gains(evidence, {"yaw": kept}, {}, (), is_after_repair=False) is None
    # Margins that a log was too slow for are flown for, too, with the rate that they need.
    kept.rating = unsure.replace(Level.UNKNOWN, is_log_slow=True)
    fast = Fact(LoopFact.CROSSOVER_FAST, crossover=2.1, rate=9.4, least_rate=50.0)
    kept.before.cautions = (fast,)
    flight = flight_for_gains(evidence, {"yaw": kept}, {}, (), is_after_repair=False)
    assert flight.sentence.startswith("Set the telemetry port's SRn_EXTRA1")
    unset = flight.replace(also=()).sentence
    assert "about yaw in calm air, with rates and motors logged at 50 Hz or more, and" in unset


def test_a_next_step_with_doublets_says_what_to_log_in_the_same_flight():
    flight = flight_of({"yaw": SLOW}, parameters={"LOG_BITMASK": 126.0})
    tuning = tuning_of(NOT_STEERED, NOT_STEERED, {}, flight_for_gains=flight)
    next_step = Fact(NextStep.KEEP_OR_CONFIRM_GAINS, Level.WATCH, **STEP_TO_CONFIRM)
    tuning = tuning._replace(judgement=replace(tuning.judgement, next_step=next_step))
    [next_sentence] = [each for each in tune_summary(tuning, NOT_STEERED) if each.lead == "Next:"]
    assert next_sentence.text.startswith("LOG_BITMASK is 126")
    assert next_sentence.text.endswith(f". {next_step}")


def test_what_no_flight_removes_is_said_of_its_axis_alone():
    flight = flight_of({"roll": NOT_STEERED, "pitch": NOT_FOUND})
    assert flight.figures["axes"] == ("roll",)
    tuning = tuning_of(NOT_STEERED, NOT_STEERED, {}, flight_for_gains=flight)
    pitch = Fact(LoopFact.NO_LOOP, reasons=(NOT_FOUND,))
    judgement = replace(tuning.judgement, next_step=flight)
    tuning = tuning._replace(axes={**tuning.axes, "pitch": pitch}, judgement=judgement)
    *_, next_step, for_pitch = tune_summary(tuning, NOT_STEERED)
    assert next_step.lead == "Next:" and "about roll" in next_step.text
    assert for_pitch == Sentence(NOT_FOUND.remedy, "For gains of pitch:")


def test_lowered_gains_are_one_set_for_headline_report_and_files():
    change = ("ATC_RAT_PIT_P", 0.2, 0.1333)
    lower = Fact(LoopAction.LOWER_BY_A_THIRD, subject="rate", axis="pitch", changes=(change,))
    decision = LoopDecision("pitch", LoopDiagnosis.BELOW_GOAL, NOT_STEERED, lower)
    tuning = tuning_of(
        NOT_STEERED, lower, {"pitch": decision}, gains_to_lower={"ATC_RAT_PIT_P": Gain(0.2, 0.1333)}
    )
    [outcome] = outcome_sentences(tuning)
    assert outcome.lead == "Pitch: lower gains. Roll: no gains, margins not known."
    assert outcome_by_axis(tuning) == {
        "roll": "no gains, margins not known",
        "pitch": "lower gains",
    }
    report = tune_blocks(tuning, is_full=False, headline_above=NOT_STEERED)
    assert Sentence("no gains, for the reason above.", "Roll:") in report
    files = tuning.files(Hover().telemetry())
    assert sorted(files) == [".lower.param", ".lower.params"]
    assert "ATC_RAT_PIT_P,0.1333" in files[".lower.param"]


@mark.parametrize(
    "headline, step_of_review, next_words",
    [
        # The steered loop of a resonance would be better known from a longer flight, which would fly the resonance.
        (RESONATES, RESONATES, "Load these lower gains, hover low"),
        # The decision lowers gains of an axis that the headline is not about.
        (NOT_STEERED, NOT_STEERED, "Load these lower gains, hover low"),
        # A vehicle that loses its supply is repaired, though that is only to be watched.
        (SUPPLY_LOW, SUPPLY_LOW, "Check the power module"),
    ],
)
def test_a_repair_comes_before_lower_gains_and_these_before_data(
    headline, step_of_review, next_words
):
    decision = LoopDecision("roll", LoopDiagnosis.BELOW_GOAL, RESONATES, LOWER)
    tuning = tuning_of(headline, step_of_review, {"roll": decision})
    uncertain = Fact(
        LoopFact.MARGIN_UNCERTAIN,
        is_stable=True,
        is_steered=True,
        phase_margin_interval=(0.0, 38.0),
    )
    judgement = judgement_with_tuning_step(
        tuning.judgement,
        {"roll": Fact(LoopFact.NO_LOOP, reasons=(uncertain,))},
        (),
        None,
        has_new_gains=False,
        is_written=False,
        must_be_repaired=False,
    )
    with sentences_for(Medium(table_gains=frozenset({"ATC_RAT_RLL_P"}))):
        assert judgement.next_step.sentence.startswith(next_words)


def test_gains_on_trial_are_a_table_and_files():
    peak = Fact(MarginsLight.RATE_STANDS_OUT, Level.WATCH)
    hover = Fact(LoopAction.HOVER_WITH_LOWER_GAINS, reason=peak, **LOWER.figures)
    decision = LoopDecision("roll", LoopDiagnosis.UNKNOWN, peak, hover)
    tuning = tuning_of(peak, hover, {"roll": decision})
    gains = lowered_gains(tuning.judgement.next_step)
    assert gains == {"ATC_RAT_RLL_P": Gain(0.135, 0.09)}
    tuning = tuning._replace(gains_to_lower=gains)
    assert outcome_by_axis(tuning)["roll"] == "lower gains on trial, margins not known"
    with sentences_for(Medium(table_gains=frozenset(gains))):
        assert hover.sentence.startswith(
            "Hover for a minute with these lower gains on trial: a peak"
        )


@mark.parametrize("axes, other_axes", [(("roll",), ("pitch",)), (("roll", "pitch", "yaw"), ())])
def test_gains_are_lowered_of_requested_axes_alone_and_others_are_named(axes, other_axes):
    """Roll and pitch oscillate, and one fact lowers the gains of both."""
    parameters = {"ATC_RAT_RLL_P": 0.135, "ATC_RAT_PIT_P": 0.2}
    changes = tuple((name, value, value / 1.5) for name, value in parameters.items())
    lower = Fact(GainFact.LOWER_GAINS, Level.BAD, changes=changes, axes=("roll", "pitch"))
    reason = Fact(MarginsLight.RESONATES, Level.BAD, axis="roll", reason=lower)
    decision = LoopDecision("roll", LoopDiagnosis.OSCILLATES, reason, lower, (lower,))
    judgement = tuning_of(LIMITED, lower, {"roll": decision}).judgement
    limited = limited_to_axes(judgement, axes, parameters)
    assert limited.other_axes == other_axes
    gains = lowered_gains(limited.judgement.next_step)
    assert ("ATC_RAT_PIT_P" in gains) == ("pitch" in axes) and "ATC_RAT_RLL_P" in gains
    limited_decision = limited.judgement.loop_decisions["roll"]
    # The decision and its reasons agree with the next step.
    [against_gains] = limited_decision.reasons_against_gains
    for fact in (against_gains, limited_decision.action, limited_decision.reason.figures["reason"]):
        assert fact == limited.judgement.next_step.figures["reason"]
    tuning = tuning_of(LIMITED, lower, {}, axes_also_to_lower=limited.other_axes)
    leads = [sentence.lead for sentence in tune_summary(tuning, LIMITED)]
    assert ("Pitch:" in leads) == bool(other_axes)


@mark.parametrize(
    "sluggish_axes, words", [(["roll", "pitch"], "sluggish"), (["roll"], "roll is sluggish")]
)
def test_axes_that_are_all_sluggish_are_not_named_twice(sluggish_axes, words):
    [outcome] = render_section(
        "tune_axes",
        axes=["roll", "pitch"],
        axes_by_outcome={"keep": ["roll", "pitch"]},
        outcomes=["keep"],
        has_outcomes=True,
        sluggish_axes=sluggish_axes,
    )
    assert outcome.lead == f"Roll and pitch: keep the gains, though {words}."


def test_an_attitude_that_rings_more_than_predicted_has_its_fit_below_the_chart():
    # The chart ends before the last value, which the line below it ignores.
    end = 0.35
    time = np.arange(0.0, 0.5, 0.1)
    step = np.array([0.0, 1.0, 1.3, 1.0, 1.9])
    measured = partial_record(StepResponse, time=time, step=step)
    predicted_step = np.array([0.0, 1.0, 1.0, 1.0, 0.5])
    # The RMS of the difference is 0.15, the standard deviation of the step 0.49.
    caption = step_caption(LoopResponse(measured, predicted_step), end)
    assert caption == "Measured: overshoot 30 %, predicted 0 %; fit 70 %."
    without_loop = step_caption(LoopResponse(measured), end)
    assert without_loop.endswith("no loop is identified to compare with.")
    assert step_caption(None) == "Identified loop; no step was measured."


def _messages_at(message_rate):
    """Returns five seconds of messages at a rate, Hz."""
    time = np.arange(0.0, 5.0, 1 / message_rate)
    return TimeSeries(time, np.zeros(len(time), int), np.zeros(len(time)))


@mark.parametrize("code, is_doubtful", [("AGREES", False), ("DOUBTED", True)])
def test_an_identified_step_that_the_measured_gain_contradicts_is_doubtful(code, is_doubtful):
    rise_time = IntervalEstimate(0.056, 0.05, 0.07)
    step = partial_record(StepResponse, is_identified=True, rise_time=rise_time)
    compared = Fact(StepResponseFact[f"PREDICTION_{code}"], share=0.35)
    agreement = "differs at 35 % of the frequencies" if is_doubtful else "agrees"
    assert gain_caption(compared) == f"Measured; the identified loop {agreement}."
    response = LoopResponse(step, compared=compared)
    assert response.is_step_doubtful is is_doubtful
    messages = _messages_at(50.0)
    caption = step_caption(response, rate_and_setpoint=(messages, messages))
    assert "rises in 56 ms, messages at 50 Hz measure a rise from 240 ms on" in caption
    assert caption.startswith("Doubtful:" if is_doubtful else "Identified loop:")


@mark.parametrize(
    "predicted_end, half_width, band",
    [
        (0.68, 0.06, "± 0.06"),
        (0.9, 0.06, None),
        # A band that is narrower than the last digit makes no fault of a difference of 1 %.
        (0.92, 0.002, None),
        (0.68, 0.002, "below ± 0.01"),
    ],
)
def test_a_rate_whose_predicted_step_ends_outside_the_measured_band_is_named(
    predicted_end, half_width, band
):
    measured = partial_record(
        StepResponse,
        step=np.array([0.0, 0.93]),
        step_half=np.array([0.0, half_width]),
        is_identified=False,
    )
    response = LoopResponse(measured, np.array([0.0, predicted_end]))
    sentences = rate_disagreement_sentences({"yaw": {"rate": response}})
    assert [sentence.lead for sentence in sentences] == (["Yaw rate:"] if band else [])
    if band:
        assert sentences[0].text.startswith(
            f"the measured step ends at 0.93 (90 % band {band}), the predicted one at 0.68,"
        )


@mark.parametrize("message_rate, is_step_too_fast", [(50.0, True), (400.0, False)])
def test_a_measured_step_is_too_fast_if_it_rises_within_few_messages(
    message_rate, is_step_too_fast
):
    """At 50 Hz twelve messages take 240 ms, at 400 Hz 30 ms."""
    rise_time = IntervalEstimate(0.06, 0.05, 0.07)
    ramp = np.array([0.0, 1.0])
    measured = partial_record(
        StepResponse,
        is_identified=False,
        unseen_part=0.0,
        time=ramp,
        step=ramp,
        rise_time=rise_time,
    )
    series = _messages_at(message_rate)
    caption = step_caption(LoopResponse(measured), rate_and_setpoint=(series, series))
    assert ("It rises fast for this log" in caption) is is_step_too_fast


@mark.parametrize(
    "lacking, margins, price",
    [
        ("ms", (2.3, 1.7), ": the price of a lower Ms."),
        ("gain_margin", (4.0, 6.5), ": the price of more gain margin."),
        (None, None, "."),
    ],
)
def test_gains_that_slow_the_rate_have_their_price_beside_the_margin(
    lacking, margins, price, monkeypatch
):
    """With the advised gains the rate responds in 38 instead of 23 ms, with or without a margin that it lacked.

    It takes much longer to 90 % of a step, which is stated, too.
    """
    overshoot = IntervalEstimate(0.1, 0.05, 0.2)
    rise_now, rise_new = IntervalEstimate(0.023, 0.02, 0.027), IntervalEstimate(0.09, 0.078, 0.134)
    now = PredictedStep(overshoot, rise_now, IntervalEstimate(0.023, 0.02, 0.028))
    new = PredictedStep(overshoot, rise_new, IntervalEstimate(0.038, 0.031, 0.046))
    steps = {"before": now, "after": new}
    monkeypatch.setattr(
        "mavdem.report.tuning.slower.predicted_step", lambda loop, _: steps[loop.name]
    )
    level = Level.BAD if lacking else Level.GOOD
    rating = Fact(LoopFact.MARGIN_RATING, level, subject="rate", lacking=lacking)
    monkeypatch.setattr("mavdem.report.tuning.slower.margin_rating", lambda *_: rating)
    loops = {}
    for index, name in enumerate(steps):
        rate = Mock(**{lacking: margins[index]} if lacking else {})
        rate.name = name
        loops[name] = Mock(rate=rate, open_loop=lambda _, rate=rate: rate)
    advice = Mock(parameters={"ATC_RAT_RLL_P": 0.15}, **loops)
    (slower,) = facts_on_slower_rate(advice)
    rise = "and 90 ms from 10 to 90 %, now 23 ms, 3.9 times as long"
    assert slower.sentence == (
        f"With these gains the rate takes 38 ms to 63 % of a step, now 23 ms, 1.7 times as long, {rise}{price}"
    )
    # No factor is sure where the intervals overlap.
    unsure_time = IntervalEstimate(0.038, 0.027, 0.046)
    steps["after"] = new._replace(
        response_time=unsure_time, rise_time=IntervalEstimate(0.09, 0.025, 0.5)
    )
    (slower,) = facts_on_slower_rate(advice)
    rise = "and 90 ms (25 to > 500) from 10 to 90 %, now 23 ms (20 to 27)"
    assert slower.sentence.endswith(f"now 23 ms (20 to 28), {rise}{price}")
    # A rate that reaches 63 % as soon as before may rise slowly from there.
    steps["after"] = now._replace(rise_time=IntervalEstimate(0.5, 0.4, 0.5))
    (slower,) = facts_on_slower_rate(advice)
    assert f"and more than 500 ms from 10 to 90 %, now 23 ms{price}" in slower.sentence
    steps["after"] = steps["before"]
    assert not facts_on_slower_rate(advice)


@mark.parametrize(
    "rise_time, text",
    [
        ((0.087, 0.063, 0.14), "87 (63 to 140)"),
        ((0.087, 0.063, 0.5), "87 (63 to > 500)"),
        ((0.5, 0.2, 0.5), "> 500"),
    ],
)
def test_a_step_that_does_not_rise_within_its_length_has_a_bound(rise_time, text):
    assert _rise_time_text(IntervalEstimate(*rise_time), 0.5) == text


def test_a_chapter_that_only_points_to_the_headline_is_left_out():
    tuning = tuning_of(LIMITED, LIMITED, {})
    pointer = Sentence("no gains, for the reason above.", "Roll and pitch:")
    assert _repeats_headline(Chapter("Margins", [pointer]), tuning)
    finding = Sentence("No gains, because a motor was at its limit.", "Roll:")
    assert not _repeats_headline(Chapter("Margins", [pointer, finding]), tuning)
    oscillates = Fact(MarginsLight.OSCILLATES, Level.BAD, reason=None)
    [pointer] = sentences_without_gains(tuning_of(oscillates, LIMITED, {}), ["yaw"])
    assert pointer == Sentence("no gains, until the oscillation has ended.", "Yaw:")


def test_uncertain_steps_of_several_loops_share_a_sentence():
    uncertain = Fact(
        StepResponseFact.STEP_UNCERTAIN,
        band_half_width=6.0,
        largest_half_width=0.3,
        sampling_rate=10.0,
    )
    incoherent = Fact(
        StepResponseFact.NOT_COHERENT, frequency=0.5, coherence=0.48, least_coherence=0.5
    )
    responses = {
        "roll": {"attitude": LoopResponse(uncertain)},
        "pitch": {"attitude": LoopResponse(uncertain.replace(band_half_width=2.0))},
        "yaw": {"attitude": LoopResponse(incoherent)},
    }
    tilt, yaw = sentences_without_response(responses)
    assert tilt.text == (
        "No step response of the roll attitude and pitch attitude: with samples at 10 Hz the 90 % band "
        "would be ± 2 or more, and ± 0.3 is the limit."
    )
    assert yaw.text.startswith("No step response of the yaw attitude: above 0.5 Hz")


@mark.parametrize(
    "share_as_flown, share_at_all_thrusts, is_certain, prospect",
    [
        (1.0, 0.95, True, "sure"),
        (0.95, 0.8, True, "sure_at_flown_thrust"),
        # A log that is too slow for the margins makes none sure.
        (1.0, 0.95, False, "probable"),
        (0.46, 0.03, True, "improbable"),
    ],
)
def test_whether_the_goal_is_reached_is_said_before_the_shares_of_models(
    share_as_flown, share_at_all_thrusts, is_certain, prospect
):
    assert _goal_prospect(share_as_flown, share_at_all_thrusts, is_certain=is_certain) == prospect


def test_steps_to_the_goal_say_at_which_thrust_it_is_to_hold():
    """By the estimate the margins after the first step may almost reach the goal, at the thrust of the flight."""
    step = Fact(GainFact.STEP_TOWARDS_MARGINS, stage=1, flights=4, is_goal_stated=True)
    assert step.sentence == "Stage 1, rate P, I and D: at most 4 steps to the goal."
    figures = {"is_written": True, "is_biased": False, "missing": (), "names": (), "share": 0.1}
    next_step = Fact(NextStep.LOAD_GAINS, Level.BAD, flights=4, needed=0.9, **figures)
    assert next_step.sentence.startswith(
        "Load these gains on trial (step 1 of at most 4), hover low"
    )


def test_a_headline_with_what_to_do_states_its_fact():
    peak = Fact(MarginsLight.RATE_STANDS_OUT, axis="roll", ratio=5.9)
    headline = peak.replace(action=Fact(LoopAction.HOVER_WITH_LOWER_GAINS, axis="roll"))
    assert is_stated(peak, [headline])
    assert not is_stated(peak.replace(axis="pitch"), [headline])


def test_the_unknown_mixer_of_a_hexarotor_is_stated_once_for_all_axes():
    mixer = Fact(ControllerFact.MIXER_UNKNOWN, autopilot=None, motors=6, has_demand=False)
    faults = dict.fromkeys(("roll", "pitch"), mixer)
    tuning = tuning_of(NOT_STEERED, NOT_STEERED, {}, controller_faults=faults)
    tuning = tuning._replace(axes=faults)
    assert plain_text(outcome_sentences(tuning)).startswith("No gains: the mixer of 6 motors")
    assert tune_blocks(tuning, is_full=False) == []
