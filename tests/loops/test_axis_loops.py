"""Loops: the controller of the parameters, margins of known loops and of flights, and gains that have margins."""

import tomllib
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
from hover import Hover, changed, columns
from known_gains import ARDUPILOT, PX4, X_ROLL
from made_up_loop import made_up
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from partial_records import partial_record
from pytest import approx, mark
from refusals import refused
from scipy.signal import lfilter

from mavdem.assessment import Assessment
from mavdem.assessment.axis.gains import autotune_fact, changed_gains_at_end, loop_at_end_of_log
from mavdem.assessment.axis.loop_decision import LoopDecision, LoopDiagnosis
from mavdem.assessment.axis.tuning import tune_loops
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.judgement import Judgement
from mavdem.assessment.noise_spectra import MeasuredNoise
from mavdem.dataset.alignment import aligned_flight
from mavdem.dataset.parameter_history import ParametersInFlight
from mavdem.dataset.segments import Segment, settled_segments
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import NextStep
from mavdem.facts.identifiability import Status
from mavdem.facts.loops import (
    ControllerFact,
    GainFact,
    LoopAction,
    LoopFact,
    ResponseFact,
    TwinFact,
)
from mavdem.facts.margins import MarginsLight, TrackingLight
from mavdem.facts.motors import MotorsLight
from mavdem.facts.noise import NotchAdvice
from mavdem.ingest import Log
from mavdem.ingest.mavlink.payloads import decoded_parameters
from mavdem.ingest.vocabulary import Injection
from mavdem.loops.advice import (
    gain_reduction_advice,
)
from mavdem.loops.axis_loops import margin_rating
from mavdem.loops.controllers import (
    ROTOR_LAG_CORRECTION,
    TYPICAL_ROTOR_LAG,
    UNMODELLED_PARAMETERS,
    controller_from_parameters,
)
from mavdem.loops.limit_cycles import Oscillation
from mavdem.loops.loop_construction import loop_from_plant
from mavdem.loops.margins import controller_response
from mavdem.loops.measured_response import measured_rate_response
from mavdem.loops.twin import build_twin
from mavdem.loops.twin_flight import replay_segments
from mavdem.report.charts.flight_charts import loop_charts
from mavdem.report.tuning.outcomes import outcome_sentences
from mavdem.report.tuning.reasons import tune_blocks
from mavdem.report.vehicle_files import vehicle_text
from mavdem.wind_velocity.vehicle_drag import Drag
from mavdem.wind_velocity.velocity import WindVelocity
from sitl_scenarios.files import scenario_from_table
from sitl_scenarios.scenario import SteadyWind
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth

HOVER = Hover()


def test_gains_have_their_names_and_units_before_arducopter_34():
    """4500 was full demand, of 0.01 °/s: 1.27 times in radians, of which an X's mixer now turns √2 times as much."""
    old = {
        "RATE_RLL_P": 0.13,
        "RATE_RLL_I": 0.1,
        "RATE_RLL_D": 0.005,
        "RATE_RLL_FILT_HZ": 20.0,
        "STB_RLL_P": 9.0,
        "FRAME": 1.0,
        "THR_MIN": 130.0,
        "MOT_THST_MAX": 0.95,
        "MOT_THST_EXPO": 0.5,
    }
    of_demand = controller_from_parameters(old, "roll", (1.0,))
    assert of_demand.p == approx(0.13 * np.degrees(100) / 4500, rel=0.003)
    assert (of_demand.angle_gain, of_demand.error_filter) == (9.0, 20.0)
    of_motors = controller_from_parameters(old, "roll", X_ROLL)
    assert of_motors.p == approx(of_demand.p / 2**0.5, rel=0.003)
    assert of_motors.spin_range == (0.13, 0.95)
    # Motors are at a limit beyond their spin, a demand at the ends of its range.
    shares = np.array([[0.1], [0.5], [0.96]])
    assert of_motors.outputs_at_limit(np.tile(shares, 4)).tolist() == [True, False, True]
    assert (
        not of_demand.outputs_at_limit(shares).any()
        and of_demand.outputs_at_limit(np.eye(2)[:, :1]).all()
    )
    assert controller_from_parameters({**old, "FRAME": 0.0}, "roll", X_ROLL).p == of_demand.p
    assert of_motors.with_parameters({"RATE_RLL_P": 0.26}).p == approx(2 * of_motors.p)


def test_the_mixer_and_the_slope_of_the_thrust_curve_are_the_autopilots():
    """ArduPilot scales roll and pitch by the longest arm; PX4 by the root of the sum of squares.

    Both model the curve of thrust by the command.
    """
    ardupilot_controller = controller_from_parameters(ARDUPILOT, "roll", X_ROLL)
    assert ardupilot_controller.mixer == (-0.5, 0.5, 0.5, -0.5)

    # Thrust is 0.35 of the command and 0.65 of its square, from 15 to 95 % of the range.
    thrusts = np.polyval([0.65, 0.35, 0], (np.array([0.4995, 0.5005]) - 0.15) / 0.8)
    derivative_gain = 0.001 / np.diff(thrusts)
    assert ardupilot_controller.outputs_per_demand([0.5] * 4) == approx(
        np.multiply(ardupilot_controller.mixer, derivative_gain), rel=1e-5
    )
    px4_controller = controller_from_parameters(PX4)
    assert (px4_controller.p, px4_controller.d) == (0.3, 0.006) and px4_controller.with_parameters(
        {"MC_ROLLRATE_D": 0.0}
    ).d == 0
    # Roll and pitch are scaled alike, so that the shorter arm has the larger factor.
    assert (
        px4_controller.mixer == approx(np.multiply(X_ROLL, 0.5**1.5))
        and px4_controller.thrust_expo == 0.3
    )


@mark.slow
def test_a_slam_turns_by_rotors_whose_speeds_lag():
    """Large steps of the demand accelerate the rotors.

    The thrust of lagging speeds, squares of speeds, is that of a corrected demand. With slow samples there is no
    correction.
    """
    ardupilot_controller = controller_from_parameters(PX4)
    step = 1e-4
    slam = np.sin(np.arange(5000) * step * 100) > 0.7
    shares = 0.4 + np.outer(slam, [-0.4, 0.6, 0.6, -0.4])
    decay = np.exp(-step / TYPICAL_ROTOR_LAG)
    lag = [0.0, 1 - decay], [1.0, -decay]
    commanded_shares = np.sqrt(
        (1 - ardupilot_controller.thrust_expo + ardupilot_controller.thrust_expo * shares) * shares
    )
    speeds, _ = lfilter(*lag, commanded_shares, axis=0, zi=commanded_shares[:1])
    torque = speeds**2 @ ardupilot_controller.mixer / np.square(ardupilot_controller.mixer).sum()
    linear, acting = (
        ardupilot_controller.demand_from_outputs(shares),
        ardupilot_controller.demand_from_outputs(shares, step),
    )
    full_correction = linear + (acting - linear) / ROTOR_LAG_CORRECTION
    assert lfilter(*lag, full_correction) == approx(torque, abs=0.02 * np.ptp(torque))
    assert_array_equal(
        ardupilot_controller.demand_from_outputs(shares, 2 * TYPICAL_ROTOR_LAG), linear
    )


def test_the_frame_of_older_firmware_is_its_class():
    """Copter 3.4 has no FRAME_CLASS."""
    old = {name: value for name, value in ARDUPILOT.items() if name != "FRAME_CLASS"}
    older = controller_from_parameters(old | {"FRAME": 1.0}, "roll", X_ROLL)
    newer = controller_from_parameters(ARDUPILOT, "roll", X_ROLL)
    assert replace(older, parameters={}) == replace(newer, parameters={})
    unknown = refused(controller_from_parameters, old | {"FRAME": 1.0}, "roll", ())
    assert "FRAME_CLASS" not in unknown.sentence and "FRAME" in unknown.sentence


@mark.parametrize(
    "parameters, weights, code, figures",
    [
        ({}, X_ROLL, ControllerFact.NO_GAINS, {}),
        (
            {name: value for name, value in ARDUPILOT.items() if name != "ATC_RAT_RLL_D"},
            X_ROLL,
            ControllerFact.PARAMETERS_MISSING,
            {"names": ("ATC_RAT_RLL_D",)},
        ),
        (
            ARDUPILOT | {"FRAME_CLASS": 2.0},
            (1.0,) * 6,
            ControllerFact.MIXER_UNKNOWN,
            {"autopilot": "ardupilot", "names": ("FRAME_CLASS", "FRAME_TYPE")},
        ),
        (
            ARDUPILOT,
            (),
            ControllerFact.MIXER_UNKNOWN,
            {"autopilot": "ardupilot", "names": ("FRAME_CLASS", "FRAME_TYPE")},
        ),
        (PX4 | {"CA_ROTOR_COUNT": 8.0}, (), ControllerFact.MIXER_UNKNOWN, {"autopilot": "px4"}),
        (PX4 | {"CA_ROTOR1_PY": 1e3}, (), ControllerFact.MIXER_UNKNOWN, {"autopilot": "px4"}),
        # Older firmware has no such parameters, so they are not asked for.
        (
            {name: value for name, value in PX4.items() if not name.startswith("CA_")},
            (),
            ControllerFact.MIXER_IN_FILE,
            {},
        ),
        (
            PX4 | {"MC_ROLL_P": 0.0},
            (),
            ControllerFact.PARAMETER_IMPOSSIBLE,
            {"name": "MC_ROLL_P", "value": 0.0},
        ),
    ],
)
def test_a_controller_that_is_not_known_says_why(parameters, weights, code, figures):
    """Gains, the layout of the motors or valid values are missing among the parameters, and the refusal names them."""
    assert refused(controller_from_parameters, parameters, "roll", weights) == Fact(code, **figures)


def test_parameters_that_the_controller_model_leaves_out_are_reported():
    """Each parameter in use that the model of the controller ignores gives a caution."""
    names = ["ATC_RAT_RLL_SMAX", "ATC_RAT_RLL_PDMX", "FSTRATE_ENABLE", "MOT_BAT_VOLT_MAX"]
    unmodelled = ARDUPILOT | dict.fromkeys([*names, "ATC_RAT_PIT_SMAX"], 1.0)
    cautions = controller_from_parameters(unmodelled, "roll", X_ROLL).cautions
    assert [fact.figures["name"] for fact in cautions] == names
    assert {fact.code for fact in cautions} == set(UNMODELLED_PARAMETERS.values()) - {
        ControllerFact.DEMAND_BY_VOLTAGE,
        ControllerFact.NOTCHES_UNMODELLED,
    }
    px4_controller = controller_from_parameters(
        PX4 | {"MC_BAT_SCALE_EN": 1.0, "IMU_GYRO_DNF_EN": 1.0}
    ).cautions
    assert [one.code for one in px4_controller] == list(UNMODELLED_PARAMETERS.values())[-2:]
    assert {one.level for one in px4_controller} == {"watch"}


@mark.slow
def test_gains_that_change_in_flight_come_with_it(monkeypatch):
    """A gain changes at 40 s; the flight has its earlier value, unless it begins after the change."""
    read = Mock(wraps=decoded_parameters)
    monkeypatch.setattr("mavdem.dataset.parameter_history.decoded_parameters", read)
    telemetry = HOVER.telemetry(parameters={"ATC_RAT_RLL_P": 0.25, "ATC_RAT_RLL_D": 0.125})
    names = np.repeat([b"ATC_RAT_RLL_P", b"ATC_RAT_RLL_D"], 2)
    sent = columns([1.0, 40.0, 1.0, 2.0], param_id=names, param_value=[0.5, 0.25, 0.5, 0.125])
    signals = Signals(changed(telemetry, "PARAM_VALUE", **sent))
    (segment,) = settled_segments(signals)
    for start, earlier in ((segment.start, {"ATC_RAT_RLL_P": 0.5}), (41.0, {})):
        result = aligned_flight(signals, replace(segment, start=start))
        assert result.provenance["earlier"] == earlier
    assert read.call_count == 1  # Otherwise each segment of a log with many boots would read all.


def ac_pid(controller, frequency):
    """Responses of ArduPilot's AC_PID, without its setpoint's filter, and of a difference over a cycle."""
    dt = controller.loop_period
    late = np.exp(-2j * np.pi * frequency * dt)
    derivative_gain = (1 - late) / dt

    def low_pass(cutoff):
        turn = 2 * np.pi * dt * cutoff
        return turn / (1 + turn - late)

    filtered = low_pass(controller.error_filter)
    for notch in controller.error_notches:
        turn = 2 * np.pi * notch.frequency * dt
        alpha = np.sin(turn) * notch.bandwidth / notch.frequency / 2
        kept, width = np.outer([alpha * 10 ** (-notch.attenuation / 20), alpha], 1 - late**2)
        middle = 1 - 2 * np.cos(turn) * late + late**2
        filtered = filtered * (middle + kept) / (middle + width)
    of_slope = controller.d * low_pass(controller.derivative_filter)
    return filtered * (
        controller.p + controller.i / derivative_gain + of_slope * derivative_gain
    ), derivative_gain


def test_the_controllers_response_is_that_of_its_program():
    """The frequency response equals that of ArduPilot's program AC_PID. It has filters and feed-forward."""
    filters = {"FLTE": 40.0, "FLTD": 20.0, "NEF": 2.0, "NTF": 2.0, "FF": 0.5, "D_FF": 0.25}
    notch = {"TYPE": 1.0, "NOTCH_FREQ": 60.0, "NOTCH_Q": 2.0, "NOTCH_ATT": 40.0}
    parameters = ARDUPILOT | {f"ATC_RAT_RLL_{end}": value for end, value in filters.items()}
    refused(controller_from_parameters, parameters, "roll", X_ROLL)
    parameters |= {f"FILT2_{end}": value for end, value in notch.items()}
    controller = controller_from_parameters(parameters, "roll", X_ROLL)
    frequency = np.array([0.5, 4.0, 30.0, 150.0])
    forward, back = controller_response(controller, frequency)
    simulated_gain, derivative_gain = ac_pid(controller, frequency)
    assert_allclose(back, simulated_gain)
    off = controller_from_parameters(parameters | {"FILT2_TYPE": 0.0}, "roll", X_ROLL)
    assert off.error_notches == off.target_notches == ()
    notched = back / controller_response(off, frequency)[1]
    assert_allclose(forward, notched * (back + 0.5 + 0.25 * derivative_gain), rtol=1e-12)


def tuned_by(loops, decisions=None, headline=None, **options):
    """Returns the tuning of a vehicle with these loops and decisions, and with a notch filter advised."""
    evidence = partial_record(
        Evidence,
        log=partial_record(Log, components=()),
        signals=Signals(Hover().telemetry(parameters=ARDUPILOT)),
        loops=loops,
        gain_reduction=None,
        reasons_not_to_fly=(),
        command_arguments=("flight.tlog",),
    )
    notch = Fact(NotchAdvice.SET_NOTCH, settings=(("INS_HNTCH_FREQ", 80.0),))
    even = Fact(MotorsLight.MOTORS_EVEN, Level.GOOD)
    next_step = Fact(NextStep.DO_AS_ADVISED, reason=headline) if headline else even
    judgement = Judgement(headline or even, next_step, {"motors": even}, decisions or {})
    assessment = partial_record(
        Assessment,
        judgement=judgement,
        evidence=evidence,
        margins=(),
        noise=MeasuredNoise({}, {}, notch),
    )
    return tune_loops(assessment, [*loops], is_written=False, **options)


@mark.slow
def test_an_axis_that_is_too_slow_gets_more_gain_with_a_notch_too():
    sluggish = Fact(TrackingLight.RATE_FALLS_SHORT, Level.WATCH, axis="roll")
    decision = LoopDecision("roll", LoopDiagnosis.FOLLOWS_BADLY, sluggish, is_too_slow=True)
    tuning = tuned_by({"roll": made_up(0.4)}, decisions={"roll": decision}, filters=True)
    assert tuning.parameters["MC_ROLLRATE_P"] > PX4["MC_ROLLRATE_P"]
    assert tuning.notch_parameters


@mark.slow
def test_of_one_axis_that_keeps_its_gains_the_next_step_names_the_axis_that_needs_new_ones():
    to_tune = Fact(LoopAction.LOAD_ADVISED_GAINS, arguments=("flight.tlog",))
    reason = Fact(LoopFact.MARGIN_RATING, Level.BAD, axis="pitch", action=to_tune)
    decision = LoopDecision("pitch", LoopDiagnosis.BELOW_GOAL, reason, to_tune)
    tuning = tuned_by({"roll": made_up()}, {"pitch": decision}, headline=reason)
    assert not tuning.parameters
    assert tuning.judgement.next_step.sentence == (
        "Keep the gains of roll, and change those of pitch: "
        "`mavdem tune flight.tlog --axis all` advises them."
    )


@mark.slow
def test_margins_that_are_not_sure_end_the_tuning_or_are_made_sure_by_more(monkeypatch):
    """Without more, keeping the gains is one of two ways; with it, the gains that were found are loaded."""
    loop = made_up(1.7)
    rating = margin_rating(loop)
    assert rating.level is Level.WATCH
    unsure = Fact(
        MarginsLight.LOOP_MARGINS,
        rating=rating.level,
        reason=None,
        is_biased=False,
        action=Fact(LoopAction.FLY_DOUBLETS, axis="roll", is_biased=False),
        **rating.figures | {"axis": "roll"},
    )
    kept = tuned_by({"roll": loop}, headline=unsure).judgement.next_step
    assert kept.sentence.startswith("Fly on with these gains, or make sure of roll.")
    assert "`mavdem tune flight.tlog --axis all --more`" in kept.sentence
    assert "more doublets than in this log, and larger ones: that" in kept.sentence
    gentle = Fact(LoopFact.STEERING_SLOW, frequency=5.2, crossover=11.8)
    gently_steered = tuned_by({"roll": replace(loop, cautions=(gentle,))}, headline=unsure)
    next_step = gently_steered.judgement.next_step.sentence
    assert "more doublets than in this log, and larger and quicker ones: that" in next_step
    report = " ".join(block.text for block in tune_blocks(gently_steered) if hasattr(block, "text"))
    assert "below the crossover: margins may be at either end of their" in report
    changed = tuned_by({"roll": loop}, headline=unsure, raises_sound_gains=True)
    assert changed.parameters and changed.judgement.next_step.code is NextStep.LOAD_GAINS
    # Higher gains that are refused are not sought a second time.
    with monkeypatch.context() as patch:
        patch.setattr("mavdem.loops.advice._shows_lag", lambda loop: False)
        refused = tuned_by({"roll": loop}, headline=unsure, raises_sound_gains=True)
    assert refused.judgement.next_step.code is NextStep.KEEP_OR_CONFIRM_GAINS
    assert "--more" not in refused.judgement.next_step.sentence
    [outcome] = outcome_sentences(refused)
    assert outcome.lead == "Roll: keep the gains, margins not sure." and refused.failure is None
    biased = replace(loop, cautions=(Fact(LoopFact.EFFECT_BIASED, reason=""),))
    tuning = tuned_by({"roll": biased}, headline=unsure.replace(is_biased=True))
    [outcome] = outcome_sentences(tuning)
    assert outcome.lead == "Roll: keep the gains, margins not sure."
    assert tuning.judgement.next_step.code is not NextStep.KEEP_OR_CONFIRM_GAINS
    # The draws allow for wind that biases the effectiveness: margins that nearly all of them have are sure.
    biased = replace(made_up(), cautions=(Fact(LoopFact.EFFECT_BIASED, reason=""),))
    [outcome] = outcome_sentences(tuned_by({"roll": biased}))
    assert outcome.lead == "Roll: keep the gains."
    # What a slow log does not show is in no interval.
    fast = Fact(LoopFact.CROSSOVER_FAST, crossover=2.1, rate=9.4, least_rate=50.0)
    slow = replace(made_up(), cautions=(fast,))
    tuning_of_slow_log = tuned_by({"roll": slow}, headline=unsure)
    [outcome] = outcome_sentences(tuning_of_slow_log)
    assert outcome.lead == "Roll: keep the gains, margins not sure."
    [roll, *_] = tune_blocks(tuning_of_slow_log, is_full=False, is_page=True)
    assert roll.text.startswith("Margin goal probably met, but this log is too slow to be sure:")
    assert roll.text.endswith("both loops reach the goal by an estimate from a slow log.")


@mark.slow
@mark.parametrize("time_step, level", [(0.02, Level.GOOD), (0.1, Level.UNKNOWN)])
def test_an_extrapolated_gain_margin_is_sure_where_no_gain_beyond_the_log_exceeds_it(
    time_step, level
):
    """At 50 Hz |L| is below −6 dB from 25 Hz on, at any phase; at 10 Hz it is above that at 5 Hz."""
    loop = made_up()
    beyond = Fact(LoopFact.GAIN_MARGIN_EXTRAPOLATED, rate=0.5 / time_step, least_rate=100.0)
    extrapolated = replace(loop, record=replace(loop.record, dt=time_step), cautions=(beyond,))
    gain_at_limit = np.interp(0.5 / time_step, loop.rate.frequency, abs(loop.rate.response[0]))
    assert bool(gain_at_limit < 0.5) is (level is Level.GOOD)
    assert margin_rating(extrapolated).level is level


@mark.slow
def test_gains_that_no_model_supports_are_not_to_be_loaded():
    to_tune = Fact(LoopAction.LOAD_ADVISED_GAINS, arguments=("flight.tlog",))
    reason = Fact(LoopFact.MARGIN_RATING, Level.BAD, axis="roll", action=to_tune)
    tuning = tuned_by({"roll": made_up()}, headline=reason)
    assert not tuning.parameters
    assert "advises" not in tuning.judgement.next_step.sentence


@mark.slow
def test_no_notch_is_set_where_no_gains_are_advised():
    loop = made_up(2.5)
    retuned = replace(loop, record=replace(loop.record, earlier={"MC_ROLLRATE_P": 0.1}))
    tuning = tuned_by({"roll": retuned}, filters=True)
    assert tuning.refusal and not tuning.parameters and not tuning.files(HOVER.telemetry())


@mark.slow
def test_a_stage_has_its_own_files_of_the_gains_that_are_to_be_loaded():
    slow_rate, fast_angle = made_up(2.5), made_up().with_parameters({"MC_ROLL_P": 25.0})
    tuning = tuned_by({"roll": slow_rate, "pitch": fast_angle})
    files = tuning.files(HOVER.telemetry())
    assert "MC_ROLL_P\t16.7" in files[".stage2.params"]
    assert "Stage 2, angle P" in files[".stage2.params"]
    # Another flight is to confirm the gains of the slow rate loop.
    roll = tuning.axes["roll"]
    assert roll.parameters and not roll.is_sound and ".stage1.params" not in files
    assert tuning.tried_parameters == roll.parameters and tuning.failure is None
    assert [*tuning.parameters] == ["MC_ROLL_P"]
    unconfirmed = tuned_by({"roll": slow_rate})
    assert not unconfirmed.parameters and unconfirmed.failure == roll.conclusion


def test_one_axis_without_a_loop_has_its_own_reason_and_several_have_theirs():
    mixer, steered = Fact(LoopFact.MIXER_REVERSED), Fact(LoopFact.NOT_STEERED, share=0.3)
    single = tuned_by({"roll": mixer})
    assert single.refusal.sentence == mixer.sentence and not single.advice
    several = tuned_by({"roll": mixer, "pitch": steered, "yaw": mixer}).refusal
    named = [fact.figures["names"] for fact in several.figures["reasons"]]
    assert named == [("roll", "yaw"), ("pitch",)]


def test_the_next_step_without_gains_leads_to_gains():
    steered = Fact(LoopFact.NOT_STEERED, share=0.3)
    tuning = tuned_by({"roll": Fact(LoopFact.MIXER_REVERSED), "pitch": steered})
    assert steered.remedy and tuning.judgement.next_step.sentence == steered.remedy
    # A fault of the vehicle comes before a flight for gains.
    limited = Fact(MotorsLight.MOTOR_LIMITED, Level.BAD, names=("motor 1",))
    tuning = tuned_by({"pitch": steered}, headline=limited)
    assert tuning.judgement.next_step.figures["reason"] == limited


@mark.slow
@mark.parametrize(
    "factor, level, lacking",
    [
        (1.0, "good", "phase_margin"),
        (1.7, "watch", "phase_margin"),
        (2.5, "bad", "phase_margin"),
        (6.0, "bad", "gain_margin"),
    ],
)
def test_a_loop_is_rated_by_its_weaker_margins(factor, level, lacking):
    """The gains of a loop with good margins are multiplied.

    The rating names the weaker loop and which of its margins is too small.
    """
    rating = margin_rating(loop := made_up(factor))
    weak = getattr(loop, rating.subject)
    assert (rating.code, rating.level) == (LoopFact.MARGIN_RATING, level)
    assert rating.figures["phase_margin"] == weak.phase_margin
    if level != "bad":
        assert rating.figures["share"] >= 1
    else:
        assert rating.figures["share"] < 1
    assert rating.figures["lacking"] == lacking


@mark.slow
def test_gains_after_px4s_autotune_are_rated_like_those_before():
    """The autotune injects a signal from 21 s to 29 s and multiplies the gains by 6."""
    time = np.arange(20.0, 30.0)
    injected = columns(time, axis=Injection.RATE_SETPOINT, target=time - 20)
    telemetry = changed(HOVER.telemetry(autopilot="PX4"), "SIDD", **injected)
    sent = columns([1.0, 35.0], param_id=b"MC_ROLLRATE_K", param_value=[1.0, 6.0], param_type=9)
    autotune = autotune_fact(Signals(changed(telemetry, "PARAM_VALUE", **sent)), made_up())
    assert (autotune.level, autotune.time, autotune.end_time) == ("watch", 21.0, 29.0)
    assert [one.level for one in autotune.figures["ratings"]] == ["good", "bad"]
    assert (
        autotune.figures["is_saved"] and "parameters are those from before" not in autotune.sentence
    )


@mark.slow
def test_advice_starts_from_the_gains_with_which_the_log_ends():
    sent = columns([1.0, 35.0], param_id=b"MC_ROLLRATE_K", param_value=[1.0, 2.5], param_type=9)
    telemetry = changed(HOVER.telemetry(autopilot="PX4"), "PARAM_VALUE", **sent)
    loop = made_up()
    since = changed_gains_at_end(Signals(telemetry), loop.controller)
    assert since.figures["changes"] == (("MC_ROLLRATE_K", 1.0, 2.5),)
    assert "MC_ROLLRATE_K 1 → 2.5" in since.sentence
    loop_at_end = loop_at_end_of_log(replace(loop, cautions=(since,)))
    assert loop_at_end.controller.parameters["MC_ROLLRATE_K"] == 2.5
    assert loop_at_end_of_log(loop) is loop
    assert changed_gains_at_end(Signals(telemetry), loop_at_end.controller) is None


UNCHANGED_PX4 = ParametersInFlight.unchanged(PX4)


def oscillation_of_roll(frequency):
    """A limit cycle of roll at this frequency, Hz."""
    return Oscillation("roll", frequency, 40.0, 0.9, False, 20.0, Segment(0, 10.0, 30.0))


@mark.parametrize(
    "frequency, names",
    {
        23.0: ["MC_ROLLRATE_P", "MC_ROLLRATE_I", "MC_ROLLRATE_D"],
        None: ["MC_ROLLRATE_P", "MC_ROLLRATE_I", "MC_ROLLRATE_D"],
        1.5: ["MC_ROLL_P"],
        0.4: ["MC_ROLL_P", "MC_ROLLRATE_I"],
    }.items(),
)
def test_an_oscillating_vehicle_lowers_the_gains_that_act_at_its_frequency(frequency, names):
    """A fast oscillation lowers P and D, with I in ratio; a slow one the attitude gain, a very slow one I too."""
    oscillation = oscillation_of_roll(frequency)
    fact = gain_reduction_advice(oscillation, UNCHANGED_PX4)
    lower = [(name, PX4[name], approx(PX4[name] * 2 / 3, rel=5e-3)) for name in names]
    assert [*fact.figures["changes"]] == lower
    assert all(name in fact.sentence for name in names)
    assert "alike_axis" not in fact.figures, "pitch has other gains, or none in the log"
    same_pitch = {name.replace("ROLL", "PITCH"): value for name, value in PX4.items()}
    fact = gain_reduction_advice(oscillation, ParametersInFlight.unchanged(PX4 | same_pitch))
    lowered_names = [name for name, _, _ in fact.figures["changes"]]
    assert lowered_names == names + [name.replace("ROLL", "PITCH") for name in names]
    assert fact.remedy == "Pitch has the same gains, so these are lowered too."
    oscillation_of_both_axes = oscillation._replace(other_axes=(oscillation,))
    assert [
        *gain_reduction_advice(oscillation_of_both_axes, UNCHANGED_PX4).figures["changes"]
    ] == 2 * lower
    unknown = gain_reduction_advice(oscillation, ParametersInFlight.unchanged({}))
    assert (unknown.code, unknown.figures["changes"]) == (GainFact.LOWER_GAINS, ())


def test_an_oscillating_axis_without_p_lowers_its_integral():
    without_p = PX4 | {"MC_ROLLRATE_P": 0.0}
    parameters = ParametersInFlight.unchanged(without_p)
    changes = gain_reduction_advice(oscillation_of_roll(23.0), parameters).figures["changes"]
    assert [name for name, _, _ in changes] == ["MC_ROLLRATE_I"]


def test_gains_are_lowered_from_their_value_while_the_vehicle_oscillated():
    """P was lowered by less than a third after the oscillation, or by more."""
    little_lower = ParametersInFlight(PX4, (), PX4 | {"MC_ROLLRATE_P": 0.12})
    fact = gain_reduction_advice(oscillation_of_roll(23.0), little_lower)
    assert fact.sentence.startswith(
        "Lower MC_ROLLRATE_P from 0.12 to 0.1, MC_ROLLRATE_I from 0.2 to 0.133 and MC_ROLLRATE_D from 0.003 to 0.002."
    )
    # A log has the advised value in single precision, as 0.13300000131.
    as_advised = ParametersInFlight(PX4, (), PX4 | {"MC_ROLLRATE_I": float(np.float32(0.133))})
    assert gain_reduction_advice(oscillation_of_roll(23.0), as_advised).figures["changes"] == ()
    far_lower = ParametersInFlight(PX4, (), PX4 | {"MC_ROLLRATE_P": 0.05})
    fact = gain_reduction_advice(oscillation_of_roll(23.0), far_lower)
    assert not fact.figures["changes"]
    assert fact.sentence == (
        "MC_ROLLRATE_P has been lowered since: it was 0.15, and the log ends with 0.05."
    )


def test_a_gain_that_changed_while_the_vehicle_oscillated_gets_no_value():
    names = ("MC_ROLLRATE_D", "MC_ROLLRATE_P")
    constant = {name: value for name, value in PX4.items() if name not in names}
    fact = gain_reduction_advice(
        oscillation_of_roll(23.0), ParametersInFlight(constant, names, PX4)
    )
    assert not fact.figures["changes"]
    assert fact.sentence == (
        "Lower P, I and D of the rate controllers by a third. "
        "MC_ROLLRATE_P had several values meanwhile, so that no new one is advised. "
        "MC_ROLLRATE_D had several values meanwhile, so that no new one is advised."
    )


@mark.slow
@mark.parametrize(
    "plant, record, code",
    [
        ({}, {"parameters": {}}, LoopFact.CONTROLLER_UNKNOWN),
        ({}, {"parameters": PX4 | {"MC_ROLLRATE_P": 0.0}}, LoopFact.NO_PROPORTIONAL_GAIN),
        ({"effect": -0.18 * np.array(X_ROLL)}, {}, LoopFact.MIXER_REVERSED),
        ({}, {"input_range": ()}, ControllerFact.MIXER_UNKNOWN),
        ({}, {"dt": 0.05}, LoopFact.CROSSOVER_UNSEEN),
        ({"filtered": False}, {"dt": 0.1}, LoopFact.CROSSOVER_UNSEEN),
    ],
)
def test_a_flight_without_loops_says_why(plant, record, code):
    """The gains are unknown or zero, the mixer is reversed or unknown, or samples are too slow for the crossover."""
    sound = made_up()
    changes = sound.plant._replace(**plant), replace(sound.record, **record)
    assert refused(loop_from_plant, *changes).code is code


@mark.slow
@mark.parametrize("filtered, dt", [(True, 0.05), (False, 0.1)])
def test_a_log_at_the_rate_that_a_slow_one_lacks_shows_the_crossover(filtered, dt):
    sound = made_up()
    plant = sound.plant._replace(filtered=filtered)
    fact = refused(loop_from_plant, plant, replace(sound.record, dt=dt))
    rate = fact.figures["least_rate"]
    assert f"at {rate:.0f} Hz or more" in fact.remedy
    loop = loop_from_plant(plant, replace(sound.record, dt=1 / rate))
    assert LoopFact.CROSSOVER_FAST not in {caution.code for caution in loop.cautions}


OF_ALL = Drag.from_parameters()


def twin(loop, **parameters):
    usual = {"px4": True, "hover": 0.5, "wind": None, "drag": OF_ALL, "mass": None}
    return build_twin({"roll": loop}, **usual | parameters)


@mark.slow
@mark.parametrize("bias, factor", [(-0.15, 1 / 0.85), (0.1, 1.0)])
def test_draws_of_a_plant_that_wind_biases_are_about_its_likely_effect(bias, factor):
    loop = made_up()
    biased = loop_from_plant(
        loop.plant._replace(bias=bias, reasons={"effect": "wind"}), loop.record
    )
    assert_allclose(biased.effectiveness[0], loop.effectiveness[0])
    assert_allclose(biased.effectiveness[1:], loop.effectiveness[1:] * factor)


@mark.slow
def test_the_crossover_of_a_loop_that_wind_biases_may_be_faster():
    loop = made_up()
    too_low = loop_from_plant(
        loop.plant._replace(bias=-0.15, reasons={"effect": "wind"}), loop.record
    )
    assert too_low.rate.crossover_interval[0] > loop.rate.crossover_interval[0]


@mark.slow
def test_a_twin_says_of_each_figure_how_sure_it_is():
    """Mass, arm, inertia, damping and lag each have a note: given, assumed, or estimated with an interval."""
    loop = made_up()
    _, phase, sensitivity = loop_charts({"now": loop})
    assert phase.marks[0].name.endswith("°") and not sensitivity.marks[0].name
    result = twin(loop)
    notes = result.notes
    assert notes["mass"] == Fact(TwinFact.MASS_NOTE, is_given=False)
    assert notes["arm"] == Fact(TwinFact.ARM_NOTE, is_given=True) and result.arm == (0.1, 0.2)
    inertia = notes["inertia"].figures
    assert inertia["pitch"] is None and inertia["roll"].code is TwinFact.EFFECT_NOTE
    assert inertia["roll"].figures["share"] == approx(1.645 * 0.0095 / 0.36, rel=0.1)
    assert notes["moment"].code is TwinFact.MOMENT_NOTE
    assert notes["damping"] == Fact(TwinFact.DAMPING_NOTE, damping=loop.plant.interval().damping)
    status = {**loop.plant.status, "lag": Status.NOT_IDENTIFIABLE}
    unsure = twin(replace(loop, plant=loop.plant._replace(status=status)), mass=2.0).notes
    assert unsure["lag"] == Fact(TwinFact.LAG_NOTE, lag=None) and unsure["mass"].figures["is_given"]
    assert refused(twin, loop, hover=0.05) == Fact(TwinFact.NO_HOVER, share=0.05)


@mark.slow
@mark.parametrize("delay", [0.004, 0.0])
def test_a_twin_has_the_margins_of_its_loop_and_its_cycle_in_the_delay(delay):
    """The twin is flown in the simulator, whose true margins must be those of the identified loop."""
    loop = made_up()
    loop = replace(loop, dynamics=loop.dynamics * [1, 0, 0] + [0, 0.02, delay])
    filters = {"IMU_GYRO_CUTOFF": 40.0, "IMU_GYRO_NF0_FRQ": 50.0, "IMU_GYRO_NF0_BW": 20.0}
    loop = loop.with_parameters(filters)
    body = twin(loop)
    assert body.lag + body.delay == approx(0.02 + delay - 0.5 / 250)
    if delay:
        scenario = scenario_from_table(
            tomllib.loads(vehicle_text(body, ".toml", "")) | {"duration": 15.0}
        )
        result = truth(scenario, fly(scenario))["roll_rate_margins"]
        parameters = [loop.crossover, loop.phase_margin, loop.gain_margin, loop.ms]
        assert result == approx(parameters, rel=0.02)


@mark.slow
@mark.parametrize("with_correction, with_ahead", [(0, 1), (1, 1), (1, 0)])
def test_setpoints_of_rates_are_flown_beside_what_the_angles_error_asks_for(
    with_correction, with_ahead
):
    """A logged rate setpoint has the attitude controller's correction, the derivative of the angle, or both.

    The replayed setpoint must have the derivative only.
    """
    loop = made_up()
    loop = replace(loop, controller=replace(loop.controller, derivative_of_error=True))
    time = 0.005 * np.arange(2000)
    angle = 0.2 * np.sin(3 * time)
    ahead = 0.6 * np.cos(3 * time)
    commanded_shares = (
        with_correction * loop.controller.angle_gain * (angle - loop.record.outputs[:, 0])
    )
    setpoints = np.column_stack([angle, commanded_shares + with_ahead * ahead])
    names = ("roll setpoint", "roll rate setpoint")
    record = replace(loop.record, setpoints=setpoints, setpoint_names=names)
    replayed = replay_segments({"roll": replace(loop, record=record)})["roll"]
    assert_allclose(replayed.setpoints[1:-1, 1], with_ahead * ahead[1:-1], atol=0.01)
    assert replay_segments({"roll": loop}) == {}


@mark.slow
@mark.parametrize("known", [True, False])
def test_a_twin_has_the_mean_wind_of_the_flight_where_it_is_known(known):
    status = dict.fromkeys(("speed", "direction"), Status.REPORTED)
    if not known:
        status["speed"] = Status.NOT_IDENTIFIABLE
    wind = partial_record(
        WindVelocity, speed=3.0, speed_interval=(2.0, 4.0), direction=80.0, status=status
    )
    body = twin(made_up(), wind=wind)
    scenario = scenario_from_table(tomllib.loads(vehicle_text(body, ".toml", "a.tlog")))
    assert scenario.wind == (SteadyWind(kind="steady", speed=3.0, direction=80.0),) * known
    assert str(body.notes["drag_linear"]).endswith(", typical: not identified from this flight")
    assert scenario.vehicle.drag_linear == approx(OF_ALL.linear, rel=1e-4), "the wind pushes it"


@mark.slow
@mark.parametrize(
    "by_wind, factor, limited_share, code, agrees",
    [
        (0.0, 1.0, 0.1, None, True),
        (0.0, 3.0, 0.0, ResponseFact.RESPONSE_DISAGREES, False),
        (0.0, 3.0, 0.1, ResponseFact.RESPONSE_LIMITED, None),
        (30.0, 1.0, 0.0, ResponseFact.RESPONSE_UNEXPLAINED, None),
    ],
)
def test_a_response_that_is_not_the_predicted_one_says_how(
    by_wind, factor, limited_share, code, agrees
):
    """A rate that follows its setpoint by the closed loop, or ``factor`` times as far, and wind."""
    sound = made_up()
    rng = default_rng(8)
    dt = sound.record.dt
    samples = 12000
    predicted = sound.rate.frequency, sound.rate.closed_loop_response[0]
    response = np.interp(np.fft.rfftfreq(samples, dt), *predicted)
    setpoint = rng.normal(0, 0.3, samples)
    rate = factor * np.fft.irfft(response * np.fft.rfft(setpoint), samples)
    rate += by_wind * rng.normal(0, 0.3, samples)
    record = replace(
        sound.record,
        inputs=1500 + rng.normal(0, 1, (samples, 1)) * X_ROLL,
        outputs=np.column_stack([rate.cumsum() * dt, rate]),
        lengths=(samples,),
        setpoints=setpoint[:, None],
        setpoint_names=("roll rate setpoint",),
    )
    measured = measured_rate_response(
        record, sound.controller, np.array(X_ROLL), *predicted, limited_share=limited_share
    )
    assert getattr(measured.reason, "code", None) == code
    assert replace(sound, measured=measured).agrees is agrees


@mark.slow
def test_an_attitude_loop_around_an_unstable_rate_loop_has_no_margins():
    """Its response alone looks as if it had: the poles of the rate loop in the right half plane do not show in it."""
    sound = made_up()
    assert sound.rate.is_stable and sound.attitude.is_stable
    assert sound.attitude.phase_margin > 0
    unstable = made_up(12.0)
    assert not unstable.rate.is_stable and not unstable.attitude.is_stable
    for name in ("phase_margin", "gain_margin", "delay_margin"):
        assert getattr(unstable.attitude, name) == -np.inf
    assert np.isfinite(unstable.attitude.crossover)
