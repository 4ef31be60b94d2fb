"""Advised gains: rate P and D first, then the angle's, in steps that a tuner would load, with the margins promised."""

from dataclasses import replace
from math import log
from unittest.mock import Mock

import numpy as np
from known_gains import PX4
from made_up_loop import made_up
from numpy.testing import assert_array_equal
from pytest import approx, mark, param

from mavdem.assessment.axis.loop_decision import LoopDecision, LoopDiagnosis
from mavdem.assessment.axis.margins import AxisMargins
from mavdem.assessment.axis.tuning_step import (
    _advice_on_changed_loops,
    _allows_new_gains,
    judgement_with_tuning_step,
)
from mavdem.assessment.judgement import Judgement
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import NextStep
from mavdem.facts.loops import GainBound, GainFact, LoopAction, LoopFact, StepResponseFact
from mavdem.facts.margins import MarginsLight
from mavdem.facts.motors import TrimFact
from mavdem.loops.advice import Advice, advise, reasons_for_no_gains
from mavdem.loops.axis_loops import MARGIN_TARGETS, margin_scores
from mavdem.loops.gain_design import (
    EFFECTIVENESS_FACTORS,
    MAX_ANGLE_GAIN,
    MAX_GAIN_STEP,
    MIN_SCORE,
    SURE_SHARE,
    GainSearch,
    Stage,
)
from mavdem.loops.loop_construction import loop_from_plant
from mavdem.loops.margins import OpenLoop, controller_response
from mavdem.loops.measured_response import MeasuredResponse

INTEGRAL_RATIO = PX4["MC_ROLLRATE_I"] / PX4["MC_ROLLRATE_P"]
DERIVATIVE_RATIO = PX4["MC_ROLLRATE_D"] / PX4["MC_ROLLRATE_P"]


def share_with_margins(loop, target):
    """Returns the share of a loop's draws whose rate loop has the margins at each effectiveness, computed plainly."""
    frequency = np.geomspace(0.05, 90, 2000)
    s = 2j * np.pi * frequency
    (_, back) = controller_response(loop.controller, frequency)
    damping, lag, delay = loop.dynamics[1:].T[:, :, np.newaxis]
    plants = back * np.exp(-s * delay) / (s + damping) / (lag * s + 1)
    has_margins = np.ones(len(plants), dtype=bool)
    for factor in EFFECTIVENESS_FACTORS:
        response = factor * loop.effectiveness[1:, np.newaxis] * plants
        figures = OpenLoop(frequency, response).characteristics
        has_margins &= figures["phase_margin"] + 0.1 >= target.phase_margin
        has_margins &= figures["gain_margin"] + 0.02 >= target.gain_margin
        has_margins &= figures["ms"] * 0.999 <= target.ms
    return has_margins.mean()


@mark.slow
@mark.parametrize("factor", [0.5, param(4.5, marks=mark.in_full)])
def test_a_step_changes_rate_gains_together_by_half_at_most(factor):
    advice = advise(made_up(factor), raises_sound_gains=True)
    assert advice.stage is Stage.RATE
    gains = advice.gains
    for gain in gains.values():
        assert abs(log(gain.set / gain.now)) <= log(MAX_GAIN_STEP) + 0.006
        assert gain.set == float(f"{gain.set:.3g}")
    p, i, d = (gains[f"MC_ROLLRATE_{name}"].set for name in "PID")
    assert i / p == approx(INTEGRAL_RATIO, rel=0.01)
    assert 0.49 < d / p / DERIVATIVE_RATIO < 2.05
    assert gains["MC_ROLL_P"].set == gains["MC_ROLL_P"].now, "the angle's gain comes last"


@mark.slow
@mark.parametrize(
    "factor, tune",
    [
        (0.5, "soft"),
        param(2.5, "default", marks=mark.in_full),
        param(3.5, "sharp", marks=mark.in_full),
    ],
)
def test_the_design_has_the_margins_in_90_percent_of_models(factor, tune):
    loop = made_up(factor)
    target = MARGIN_TARGETS[tune]
    search = GainSearch(loop, target)
    design = search.rate_design()
    half = len(loop.effectiveness) // 2
    judged = loop.with_draws(slice(half, None)).with_parameters(design)
    assert share_with_margins(judged, target) >= 0.9
    faster = {name: 1.15 * value for name, value in design.items()}
    assert search.margin_score(search.models.with_parameters(faster).rate) < 1


@mark.slow
def test_the_share_of_models_is_that_of_draws_that_chose_nothing():
    advice = advise(before := made_up(0.5), raises_sound_gains=True)
    half = len(before.effectiveness) // 2
    assert_array_equal(advice.after.effectiveness[1:], before.effectiveness[half:])
    assert share_with_margins(advice.after, advice.target) >= advice.sure >= 0.9


@mark.slow
def test_steps_lead_to_the_margins_and_end_there():
    loop = made_up(4.5)
    target = MARGIN_TARGETS["default"]
    scores = [margin_scores(target, loop.rate)[0]]
    advice = advise(loop)
    while advice.parameters:
        assert (
            advice.stage is Stage.RATE and advice.conclusion.code is GainFact.STEP_TOWARDS_MARGINS
        )
        loop = loop.with_parameters(advice.parameters)
        scores.append(margin_scores(target, loop.rate)[0])
        advice = advise(loop)
    assert advice.conclusion.code is GainFact.KEEP_GAINS
    assert len(scores) <= 4 and scores == sorted(scores) and scores[-1] >= 1


@mark.slow
def test_more_ends_with_the_angles_gain_at_its_bound():
    loop = made_up(1.0)
    stages = []
    bounds = []
    advice = advise(loop, raises_sound_gains=True)
    while advice.parameters:
        stages.append(advice.stage)
        bounds += [note.figures["bound"] for note in advice.notes if "bound" in note.figures]
        assert advice.sure >= 0.9
        loop = loop.with_parameters(advice.parameters)
        advice = advise(loop, raises_sound_gains=True)
    assert stages == sorted(stages) and stages[-1] is Stage.ANGLE
    assert loop.controller.angle_gain == MAX_ANGLE_GAIN["roll"]
    assert bounds[-1] is GainBound.RANGE
    assert loop.lean_in_wind < made_up(1.0).lean_in_wind


@mark.slow
def test_a_step_says_what_bounds_it_and_why_the_integral_falls():
    """The loop has ten times the usual integral gain.

    The notes say that I falls, and that margins or noise bound P.
    """
    # I is far above what the autopilot's default ratio makes of P.
    loop = made_up(0.5)
    high_integral = 10 * loop.controller.parameters["MC_ROLLRATE_I"]
    loop = loop.with_parameters({"MC_ROLLRATE_I": high_integral})
    search = GainSearch(loop, MARGIN_TARGETS["default"])
    bound, integral_note = search.step(Stage.RATE).notes[:2]
    assert bound.figures["bound"] is GainBound.MARGINS
    assert integral_note == Fact(GainFact.INTEGRAL_FALLS, name="MC_ROLLRATE_I")
    # Little noise is allowed: it is what bounds P then.
    object.__setattr__(search, "max_demand_noise", search.max_demand_noise / 1.2)
    bound, *_ = search.step(Stage.RATE).notes
    assert bound.figures["bound"] is GainBound.NOISE


@mark.slow
def test_an_attitude_loop_that_alone_lacks_margin_is_in_stage_2():
    advice = advise(made_up(1.0).with_parameters({"MC_ROLL_P": 25.0}))
    assert advice.stage is Stage.ANGLE and advice.parameters.keys() == {"MC_ROLL_P"}
    assert advice.parameters["MC_ROLL_P"] == approx(25 / MAX_GAIN_STEP, rel=0.01)


@mark.slow
def test_a_doubt_about_the_attitude_keeps_the_angles_gain_and_not_those_of_the_rate():
    doubt = Fact(StepResponseFact.PREDICTION_DOUBTED, subject="roll attitude", share=0.5)
    fast_angle = made_up(1.0).with_parameters({"MC_ROLL_P": 25.0})
    kept = advise(fast_angle, attitude_doubt=doubt)
    assert kept.refusals == (doubt,) and kept.stage is None and not kept.parameters
    assert kept.conclusion.code is GainFact.NO_GAINS_ADVISED
    raised = advise(made_up(1.0), attitude_doubt=doubt, raises_sound_gains=True)
    assert raised.stage is Stage.RATE and raised.parameters.keys() == {
        "MC_ROLLRATE_P",
        "MC_ROLLRATE_I",
        "MC_ROLLRATE_D",
    }


@mark.slow
def test_the_angles_gain_falls_with_the_rate_gains_only_where_its_loop_would_lack_margin():
    usual = advise(made_up(4.5))
    assert "MC_ROLL_P" not in usual.parameters and not usual.notes
    fast_angle = advise(made_up(4.5).with_parameters({"MC_ROLL_P": 20.0}))
    assert fast_angle.parameters["MC_ROLL_P"] == approx(20 / MAX_GAIN_STEP, rel=0.01)
    assert [note.code for note in fast_angle.notes] == [GainFact.ANGLE_FOLLOWS]


@mark.slow
def test_gains_with_enough_margin_never_lose_a_fifth_of_their_bandwidth():
    loop = made_up(1.0)
    search = GainSearch(loop, MARGIN_TARGETS["default"])
    assert search.margin_score(search.all_models.rate) >= 1
    advice = advise(loop, raises_sound_gains=True)
    assert advice.after.rate.bandwidth > 0.8 * loop.rate.bandwidth


@mark.slow
def test_more_is_first_the_margins_at_all_effectivenesses():
    # The estimate has the margins, hardly any other model has them.
    advice = advise(made_up(1.7), raises_sound_gains=True)
    low, high = advice.conclusion.figures["bandwidth"][::-1]
    assert advice.stage is Stage.RATE and low < high


@mark.slow
def test_an_unusual_ratio_of_the_log_is_named():
    loop = made_up(1.0).with_parameters({"MC_ROLLRATE_D": 0.015})
    advice = advise(loop)
    (note,) = advice.notes
    assert note.figures["name"] == "MC_ROLLRATE_D" and note.figures["logged_ratio"] == approx(5)
    assert 2 < note.figures["ratio"] <= 5


@mark.slow
@mark.parametrize("factor", [1.0, 1.7])  # A sound loop, and one that may be.
def test_enough_margin_is_left_alone_unless_more_is_asked(factor):
    advice = advise(loop := made_up(factor))
    assert advice.gains and not advice.parameters
    assert (advice.conclusion.code, advice.conclusion.level) == (GainFact.KEEP_GAINS, "good")
    assert advice.after.controller.parameters == loop.controller.parameters
    (light,) = AxisMargins(loop.axis, loop, None, None).facts
    assert light.sentence.split(":")[0] == advice.rating.sentence.split(":")[0]


@mark.slow
@mark.parametrize("damping, is_sluggish", [(0.0, False), (3.0, True)])
def test_a_damped_rate_with_hardly_any_integral_gain_is_sluggish(damping, is_sluggish):
    """The open loop is 6 / (s + damping): with damping |T| is 2 / 3 for slow setpoints, without it 1."""
    frequency = np.geomspace(0.02, 20, 2000)
    s = 2j * np.pi * frequency
    rate = OpenLoop(frequency, (6 / (s + damping))[np.newaxis])
    loop = Mock(rate=rate, controller=made_up().controller)
    sluggish = Advice.rate_sluggish.fget(Mock(before=loop))
    assert (sluggish is not None) is is_sluggish
    if sluggish is not None:
        # The crossover is where |jω + 3| = 6; T is 6 / (jω + 9) at half of it.
        angular_frequency = np.sqrt(27) / 2
        gain = 6 / abs(1j * angular_frequency + 9)
        assert sluggish.figures["share"] == approx(gain, abs=1e-3)
        assert "follows only 64 % of its setpoint at 0.41 Hz" in sluggish.sentence


@mark.slow
def test_a_biased_effectiveness_is_allowed_for_by_its_draws_and_gives_gains():
    lacking = made_up(2.5)
    caution = Fact(LoopFact.EFFECT_BIASED, reason=Fact(GainFact.LOOP_UNSTABLE))
    biased = replace(lacking, plant=lacking.plant._replace(bias=0.1), cautions=(caution,))
    assert advise(biased).parameters == advise(lacking).parameters


@mark.slow
@mark.parametrize("share, code", [(0.1, None), (0.2, GainFact.MOTOR_AT_LIMIT)])
def test_gains_are_refused_only_where_motors_are_at_limits_for_longer_than_was_tried(share, code):
    loop = made_up(2.5)
    inputs = loop.record.inputs.copy()
    _, highest = loop.record.input_range
    inputs[: round(share * len(inputs))] = highest
    reasons = reasons_for_no_gains(replace(loop, record=replace(loop.record, inputs=inputs)))
    assert [reason.code for reason in reasons] == ([code] if code else [])


@mark.slow
@mark.parametrize("share, level", [(0.1, Level.GOOD), (0.5, Level.WATCH)])
def test_margins_are_not_good_where_a_motor_is_at_its_limit_for_long(share, level):
    loop = made_up(0.8)
    inputs = loop.record.inputs.copy()
    inputs[: round(share * len(inputs)), 0] = loop.record.input_range[1]
    limited = replace(loop, record=replace(loop.record, inputs=inputs))
    (fact,) = AxisMargins(loop.axis, limited, None, None).facts
    assert fact.level is level


@mark.slow
def test_gains_are_not_raised_by_a_lag_that_the_log_without_rate_setpoint_does_not_show():
    loop = made_up(1.0)
    short_lag = loop.dynamics * [1.0, 0.1, 1.0]
    by_motion_alone = replace(loop, dynamics=short_lag, plant=loop.plant._replace(filtered=True))
    (reason,) = reasons_for_no_gains(by_motion_alone, for_higher_gains=True)
    assert reason.code is GainFact.LAG_UNRESOLVED and not reasons_for_no_gains(by_motion_alone)
    in_loop = replace(by_motion_alone, plant=loop.plant._replace(filtered=False))
    assert not reasons_for_no_gains(in_loop, for_higher_gains=True)


@mark.slow
def test_no_gains_rest_on_a_loop_that_may_be_unstable_or_have_all_margins():
    """A third of the models is sound and a third unstable: what the vehicle lacks is not known."""
    loop = made_up(1.0)
    effectiveness = loop.effectiveness.copy()
    effectiveness[1::3] *= 30.0
    split = replace(loop, effectiveness=effectiveness)
    surely_low = made_up(2.5)
    (reason,) = reasons_for_no_gains(split)
    assert reason.code is GainFact.STABILITY_UNKNOWN
    assert not reasons_for_no_gains(loop) and not reasons_for_no_gains(surely_low)


class SearchWithHopelessModels(GainSearch):
    """A search of which some models that it has not sampled never have the margins, whatever the gains."""

    def margin_score(self, open_loop):
        """Returns the least score for all models, and the true one for those that were sampled."""
        if len(open_loop.response) == len(self.all_models.effectiveness):
            return MIN_SCORE
        return super().margin_score(open_loop)


@mark.slow
def test_models_that_no_gains_help_do_not_lower_the_design():
    loop = made_up()
    target = MARGIN_TARGETS["default"]
    design = SearchWithHopelessModels(loop, target).rate_design()
    assert design["MC_ROLLRATE_P"] >= GainSearch(loop, target).rate_design()["MC_ROLLRATE_P"]


@mark.slow
def test_a_gain_of_0_stays_0():
    loop = made_up()
    known = {**loop.record.parameters, "MC_ROLLRATE_D": 0.0}
    advice = advise(
        loop_from_plant(loop.plant, replace(loop.record, parameters=known)), raises_sound_gains=True
    )
    assert "MC_ROLLRATE_D" not in advice.gains
    assert advice.parameters.keys() == {"MC_ROLLRATE_P", "MC_ROLLRATE_I"}


@mark.slow
def test_refusals_say_why():
    """No gains are advised: there is a doubt, motors were at their limit, the loop is unstable, or gains changed."""
    record = (sound_loop := made_up()).record
    inputs = np.where(np.arange(2000)[:, None] % 5 == 0, 2000.0, record.inputs)
    advice_at_limit = advise(replace(sound_loop, record=replace(record, inputs=inputs)))
    advice_after_retuning = advise(
        replace(sound_loop, record=replace(record, earlier={"MC_ROLL_P": 5.0}))
    )
    doubt = Fact(LoopFact.MIXER_REVERSED)
    cases = {
        doubt: advise(sound_loop, doubts=[doubt]),
        Fact(GainFact.MOTOR_AT_LIMIT, share=0.2): advice_at_limit,
        Fact(GainFact.LOOP_UNSTABLE): advise(made_up(6.0)),
        Fact(GainFact.GAINS_CHANGED, names=["MC_ROLL_P"]): advice_after_retuning,
    }
    for refusal, advice in cases.items():
        assert advice.refusals == (refusal,) and not advice.gains
        assert advice.conclusion == Fact(GainFact.NO_GAINS_ADVISED, reasons=[refusal])


def test_the_next_step_is_as_careful_as_the_advice_is_sure():
    known = {"is_written": True, "needed": SURE_SHARE, "missing": (), "others": ()}
    sure = Fact(NextStep.LOAD_GAINS, Level.GOOD, share=0.95, is_biased=False, **known).sentence
    assert "hover for a minute" in sure and "on trial" not in sure
    doubtful = Fact(NextStep.LOAD_GAINS, Level.WATCH, share=0.58, is_biased=True, **known).sentence
    for words in ("on trial", "58 % of the vehicle models", "biased", "Hover low"):
        assert words in doubtful


def test_what_is_to_be_mended_comes_before_new_gains():
    twist = Fact(TrimFact.TRIM_OF_YAW, Level.WATCH, share=0.13)
    known = {"is_written": True, "needed": SURE_SHARE, "missing": (), "others": ()}
    step = Fact(NextStep.LOAD_GAINS, share=0.95, is_biased=False, also=(twist,), **known).sentence
    assert step.startswith(f"{twist.remedy} Then load these gains")


@mark.slow
def test_a_flight_that_shows_neither_lack_nor_success_is_flown_again_before_gains_are_loaded():
    """Half of the models of a loop have their margins before the change, and 69 % reach the goal after it.

    That is too uncertain to load gains.
    """
    lacks = advise(made_up(4.5))
    assert (
        lacks.parameters
        and lacks.sure < SURE_SHARE <= lacks.fraction_without_margins_before
        and lacks.is_sound
    )
    assert lacks.conclusion.remedy.startswith("Load them")
    # Half of the models keep a plant with which the loops have their margins.
    weak = replace(
        lacks.before,
        effectiveness=lacks.before.effectiveness
        * np.where(np.arange(len(lacks.before.effectiveness)) % 2, 0.2, 1.0),
    )
    unclear = replace(lacks, before=weak, sure=0.69)
    assert 0.3 < unclear.fraction_without_margins_before < 0.7 and not unclear.is_sound
    assert unclear.conclusion.remedy == "Load none of them before another flight."
    assert "would be a step" in unclear.conclusion.sentence
    assert replace(unclear, sure=SURE_SHARE).is_sound
    headline = Fact(MarginsLight.LOOP_MARGINS, Level.WATCH)
    judgement = Judgement(headline, headline, {})

    def next_step(judgement, advice, flight=None):
        """The next step with new gains of roll, or of roll and pitch."""
        advice_by_axis = dict(zip(("roll", "pitch"), advice, strict=False))
        return judgement_with_tuning_step(
            judgement,
            advice_by_axis,
            (),
            flight,
            has_new_gains=True,
            is_written=True,
            must_be_repaired=False,
        ).next_step

    steps = {}
    for name, advice in {"sound": [lacks, unclear], "unclear": [unclear]}.items():
        steps[name] = next_step(judgement, advice)
    assert steps["sound"].code is NextStep.LOAD_GAINS
    # Gains that are lowered on another axis are loaded with these, and come before a flight that changes none.
    lower = Fact(LoopAction.LOWER_BY_A_THIRD, subject="rate", axis="pitch", changes=(("P", 3, 2),))
    pitch = LoopDecision("pitch", LoopDiagnosis.BELOW_GOAL, headline, lower)
    lowering = Judgement(headline.replace(action=lower), lower, {}, {"pitch": pitch})
    assert _allows_new_gains(lowering.headline)
    step = next_step(lowering, [lacks, unclear])
    assert step.code is NextStep.LOAD_GAINS and step.figures["names"] == ("roll", "pitch")
    assert lower == next_step(lowering, [unclear])
    assert steps["unclear"].code is NextStep.FLY_BEFORE_GAINS
    assert steps["unclear"].sentence == (
        "Keep the gains, and fly ten small, quick doublets about roll in calm air; then run "
        "`mavdem tune --axis all` on that log. This flight does not show whether other gains are better."
    )
    # The same flight serves an axis of which nothing is known yet.
    flight = Fact(NextStep.FLY_FOR_GAINS, axes=("yaw",), also=(), names=(), rates=())
    step = next_step(judgement, [unclear], flight)
    assert "quick doublets about roll and yaw in calm air" in step.sentence


@mark.slow
def test_a_loop_that_keeps_its_gains_does_not_make_those_of_another_less_sure():
    changes = advise(made_up(4.5))
    assert changes.parameters
    kept = {name: gain._replace(set=gain.now) for name, gain in changes.gains.items()}
    keeps = replace(changes, gains=kept, sure=0.1)
    assert _advice_on_changed_loops([changes, keeps]) == [changes]
    assert _advice_on_changed_loops([keeps]) == [keeps]


@mark.slow
def test_a_flight_that_barely_confirms_a_loop_below_its_crossover_is_named():
    advice = advise(made_up())

    def weak_confirmation(highest, fit):
        measured = MeasuredResponse((0.3, highest), fit, fit, controller_gain=1.0, reason=None)
        return replace(advice, before=replace(made_up(), measured=measured)).weak_confirmation

    assert "by 81 %, barely enough" in str(weak_confirmation(highest=1.0, fit=81.0))
    assert weak_confirmation(highest=1.0, fit=95.0) is None
    assert weak_confirmation(highest=50.0, fit=81.0) is None
