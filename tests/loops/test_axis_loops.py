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
from mavdem.dataset.segments import settled_segments
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
from mavdem.facts.margins import TrackingLight
from mavdem.facts.motors import MotorsLight
from mavdem.facts.noise import NotchAdvice
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
    old_parameters = {
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
    demand_controller = controller_from_parameters(old_parameters, "roll", (1.0,))
    assert demand_controller.p == approx(0.13 * np.degrees(100) / 4500, rel=0.003)
    assert (demand_controller.angle_gain, demand_controller.error_filter) == (9.0, 20.0)
    motor_controller = controller_from_parameters(old_parameters, "roll", X_ROLL)
    assert motor_controller.p == approx(demand_controller.p / 2**0.5, rel=0.003)
    assert motor_controller.spin_range == (0.13, 0.95)
    # Motors are at a limit beyond their spin, a demand at the ends of its range.
    outputs = np.array([[0.1], [0.5], [0.96]])
    assert motor_controller.outputs_at_limit(np.tile(outputs, 4)).tolist() == [True, False, True]
    assert not demand_controller.outputs_at_limit(outputs).any()
    assert demand_controller.outputs_at_limit(np.eye(2)[:, :1]).all()
    assert (
        controller_from_parameters({**old_parameters, "FRAME": 0.0}, "roll", X_ROLL).p
        == demand_controller.p
    )
    assert motor_controller.with_parameters({"RATE_RLL_P": 0.26}).p == approx(
        2 * motor_controller.p
    )


def test_the_mixer_and_the_slope_of_the_thrust_curve_are_the_autopilots():
    ardupilot = controller_from_parameters(ARDUPILOT, "roll", X_ROLL)
    assert ardupilot.mixer == (-0.5, 0.5, 0.5, -0.5)

    # Thrust is 0.35 of the command and 0.65 of its square, from 15 to 95 % of the range.
    thrusts = np.polyval([0.65, 0.35, 0], (np.array([0.4995, 0.5005]) - 0.15) / 0.8)
    slope = 0.001 / np.diff(thrusts)
    assert ardupilot.outputs_per_demand([0.5] * 4) == approx(
        np.multiply(ardupilot.mixer, slope), rel=1e-5
    )
    px4 = controller_from_parameters(PX4)
    assert (px4.p, px4.d) == (0.3, 0.006)
    assert px4.with_parameters({"MC_ROLLRATE_D": 0.0}).d == 0
    # Roll and pitch are scaled alike, so that the shorter arm has the larger factor.
    assert px4.mixer == approx(np.multiply(X_ROLL, 0.5**1.5))
    assert px4.thrust_expo == 0.3


def test_demands_of_fast_changes_follow_from_rotor_speeds_that_lag():
    """The torque of rotors with lagging speeds is a first-order lag of the effective demand.

    At samples that are slower than the lag, nothing is known of it, and the demand is that of the outputs alone.
    """
    controller = controller_from_parameters(PX4)
    step = 1e-4
    is_slam = np.sin(np.arange(5000) * step * 100) > 0.7
    outputs = 0.4 + np.outer(is_slam, [-0.4, 0.6, 0.6, -0.4])
    decay = np.exp(-step / TYPICAL_ROTOR_LAG)
    rotor_lag = [0.0, 1 - decay], [1.0, -decay]
    commanded_speeds = np.sqrt(
        (1 - controller.thrust_expo + controller.thrust_expo * outputs) * outputs
    )
    speeds, _ = lfilter(*rotor_lag, commanded_speeds, axis=0, zi=commanded_speeds[:1])
    torque = speeds**2 @ controller.mixer / np.square(controller.mixer).sum()
    static_demand = controller.demand_from_outputs(outputs)
    corrected_demand = controller.demand_from_outputs(outputs, step)
    # Only a part of the correction is applied to logs, since their rotors differ; here all of it.
    effective_demand = static_demand + (corrected_demand - static_demand) / ROTOR_LAG_CORRECTION
    assert lfilter(*rotor_lag, effective_demand) == approx(torque, abs=0.02 * np.ptp(torque))
    slow_demand = controller.demand_from_outputs(outputs, 2 * TYPICAL_ROTOR_LAG)
    assert_array_equal(slow_demand, static_demand)


def test_the_frame_of_older_firmware_is_its_class():
    """Copter 3.4 has no FRAME_CLASS."""
    old = {name: value for name, value in ARDUPILOT.items() if name != "FRAME_CLASS"}
    older = controller_from_parameters(old | {"FRAME": 1.0}, "roll", X_ROLL)
    newer = controller_from_parameters(ARDUPILOT, "roll", X_ROLL)
    assert replace(older, parameters={}) == replace(newer, parameters={})
    reason = refused(controller_from_parameters, old | {"FRAME": 1.0}, "roll", ())
    assert "FRAME_CLASS" not in reason.sentence
    assert "FRAME" in reason.sentence


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
    assert refused(controller_from_parameters, parameters, "roll", weights) == Fact(code, **figures)


def test_parameters_that_the_controller_model_leaves_out_are_reported():
    names = ["ATC_RAT_RLL_SMAX", "ATC_RAT_RLL_PDMX", "FSTRATE_ENABLE", "MOT_BAT_VOLT_MAX"]
    unmodelled = ARDUPILOT | dict.fromkeys([*names, "ATC_RAT_PIT_SMAX"], 1.0)
    cautions = controller_from_parameters(unmodelled, "roll", X_ROLL).cautions
    assert [fact.figures["name"] for fact in cautions] == names
    assert {fact.code for fact in cautions} == set(UNMODELLED_PARAMETERS.values()) - {
        ControllerFact.DEMAND_BY_VOLTAGE,
        ControllerFact.NOTCHES_UNMODELLED,
    }
    unmodelled_px4 = PX4 | {"MC_BAT_SCALE_EN": 1.0, "IMU_GYRO_DNF_EN": 1.0}
    px4_cautions = controller_from_parameters(unmodelled_px4).cautions
    assert [caution.code for caution in px4_cautions] == list(UNMODELLED_PARAMETERS.values())[-2:]
    assert {caution.level for caution in px4_cautions} == {"watch"}


def test_an_aligned_flight_has_the_gains_that_were_different_at_its_start(monkeypatch):
    decoding = Mock(wraps=decoded_parameters)
    monkeypatch.setattr("mavdem.dataset.alignment.decoded_parameters", decoding)
    telemetry = HOVER.telemetry(parameters={"ATC_RAT_RLL_P": 0.25, "ATC_RAT_RLL_D": 0.125})
    names = np.repeat([b"ATC_RAT_RLL_P", b"ATC_RAT_RLL_D"], 2)
    sent = columns([1.0, 40.0, 1.0, 2.0], param_id=names, param_value=[0.5, 0.25, 0.5, 0.125])
    signals = Signals(changed(telemetry, "PARAM_VALUE", **sent))
    (segment,) = settled_segments(signals)
    for start, earlier in ((segment.start, {"ATC_RAT_RLL_P": 0.5}), (41.0, {})):
        flight = aligned_flight(signals, replace(segment, start=start))
        assert flight.provenance["earlier"] == earlier
    # The parameters of a log are decoded once, and not for each segment.
    assert decoding.call_count == 1


def ac_pid(controller, frequency):
    """Responses of ArduPilot's AC_PID, without its setpoint's filter, and of a difference over a cycle.

    They are computed from the difference equations of the program, with the unit delay z⁻¹.
    """
    dt = controller.loop_period
    unit_delay = np.exp(-2j * np.pi * frequency * dt)
    derivative = (1 - unit_delay) / dt

    def low_pass(cutoff):
        scaled_cutoff = 2 * np.pi * dt * cutoff
        return scaled_cutoff / (1 + scaled_cutoff - unit_delay)

    filtered = low_pass(controller.error_filter)
    for notch in controller.error_notches:
        angle = 2 * np.pi * notch.frequency * dt
        alpha = np.sin(angle) * notch.bandwidth / notch.frequency / 2
        undamped = 1 - 2 * np.cos(angle) * unit_delay + unit_delay**2
        damping = alpha * (1 - unit_delay**2)
        gain_at_centre = 10 ** (-notch.attenuation / 20)
        filtered = filtered * (undamped + gain_at_centre * damping) / (undamped + damping)
    derivative_term = controller.d * low_pass(controller.derivative_filter) * derivative
    response = filtered * (controller.p + controller.i / derivative + derivative_term)
    return response, derivative


def test_the_response_of_ardupilots_controller_is_that_of_its_program():
    filters = {"FLTE": 40.0, "FLTD": 20.0, "NEF": 2.0, "NTF": 2.0, "FF": 0.5, "D_FF": 0.25}
    notch = {"TYPE": 1.0, "NOTCH_FREQ": 60.0, "NOTCH_Q": 2.0, "NOTCH_ATT": 40.0}
    parameters = ARDUPILOT | {f"ATC_RAT_RLL_{name}": value for name, value in filters.items()}
    # The parameters of filter 2 are missing.
    refused(controller_from_parameters, parameters, "roll", X_ROLL)
    parameters |= {f"FILT2_{name}": value for name, value in notch.items()}
    controller = controller_from_parameters(parameters, "roll", X_ROLL)
    frequency = np.array([0.5, 4.0, 30.0, 150.0])
    demand_from_setpoint, demand_from_rate = controller_response(controller, frequency)
    expected_response, derivative = ac_pid(controller, frequency)
    assert_allclose(demand_from_rate, expected_response)
    parameters_without_notch = parameters | {"FILT2_TYPE": 0.0}
    without_notch = controller_from_parameters(parameters_without_notch, "roll", X_ROLL)
    assert without_notch.error_notches == without_notch.target_notches == ()
    _, response_without_notch = controller_response(without_notch, frequency)
    # The same notch filters the target, to which also the feed-forwards FF and D_FF are applied.
    notch_response = demand_from_rate / response_without_notch
    feed_forward = 0.5 + 0.25 * derivative
    assert_allclose(
        demand_from_setpoint, notch_response * (demand_from_rate + feed_forward), rtol=1e-12
    )


def tuned_by(loops, decisions=None, headline=None, **options):
    """The tuning of a vehicle with these loops and decisions; a notch is advised, and nothing else is to be said."""
    evidence = partial_record(
        Evidence,
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


def test_if_one_axis_keeps_its_gains_the_next_step_names_the_other():
    to_tune = Fact(LoopAction.LOAD_ADVISED_GAINS, arguments=("flight.tlog",))
    reason = Fact(LoopFact.MARGIN_RATING, Level.BAD, axis="pitch", action=to_tune)
    decision = LoopDecision("pitch", LoopDiagnosis.BELOW_GOAL, reason, to_tune)
    tuning = tuned_by({"roll": made_up()}, {"pitch": decision}, headline=reason)
    assert not tuning.parameters
    assert tuning.judgement.next_step.sentence == (
        "Keep the gains of roll, and change those of pitch: "
        "`mavdem tune flight.tlog --axis pitch` advises them."
    )


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
def test_each_stage_has_its_own_files_with_its_own_gains():
    slow_rate, fast_angle = made_up(2.5), made_up().with_parameters({"MC_ROLL_P": 25.0})
    files = tuned_by({"roll": slow_rate, "pitch": fast_angle}).files(HOVER.telemetry())
    texts = {ending: files[ending] for ending in (".stage1.params", ".stage2.params")}
    assert texts[".stage1.params"].count("MC_ROLLRATE_") == 3
    assert "MC_ROLL_P\t16.7" in texts[".stage2.params"]
    assert "Stage 2 of 2" in texts[".stage2.params"]


def test_one_axis_without_a_loop_has_its_own_reason_and_several_have_theirs():
    mixer, steered = Fact(LoopFact.MIXER_REVERSED), Fact(LoopFact.NOT_STEERED, share=0.3)
    assert refused(tuned_by, {"roll": mixer}) == mixer
    several = refused(tuned_by, {"roll": mixer, "pitch": steered, "yaw": mixer})
    named = [fact.figures["names"] for fact in several.figures["reasons"]]
    assert named == [("roll", "yaw"), ("pitch",)]


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
    rating = margin_rating(loop := made_up(factor))
    weak = getattr(loop, rating.subject)
    assert (rating.code, rating.level) == (LoopFact.MARGIN_RATING, level)
    assert rating.figures["phase_margin"] == weak.phase_margin
    if level != "bad":
        assert rating.figures["share"] >= 1
    else:
        assert rating.figures["share"] < 1
    assert rating.figures["lacking"] == lacking


def test_gains_after_px4s_autotune_are_rated_like_those_before():
    time = np.arange(20.0, 30.0)
    injected = columns(time, axis=Injection.RATE_SETPOINT, target=time - 20)
    telemetry = changed(HOVER.telemetry(autopilot="PX4"), "SIDD", **injected)
    sent = columns([1.0, 35.0], param_id=b"MC_ROLLRATE_K", param_value=[1.0, 6.0], param_type=9)
    tuned = autotune_fact(Signals(changed(telemetry, "PARAM_VALUE", **sent)), made_up())
    assert (tuned.level, tuned.time, tuned.end_time) == ("watch", 21.0, 29.0)
    assert [rating.level for rating in tuned.figures["ratings"]] == ["good", "bad"]
    assert tuned.figures["is_saved"]
    assert "parameters are those from before" not in tuned.sentence


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


@mark.parametrize(
    "frequency, names",
    {
        23.0: ["MC_ROLLRATE_P", "MC_ROLLRATE_D"],
        None: ["MC_ROLLRATE_P", "MC_ROLLRATE_D"],
        1.5: ["MC_ROLL_P"],
        0.4: ["MC_ROLL_P", "MC_ROLLRATE_I"],
    }.items(),
)
def test_an_oscillating_vehicle_lowers_the_gains_that_act_at_its_frequency(frequency, names):
    oscillation = Oscillation("roll", frequency, 40.0, 0.9, False, 20.0)
    fact = gain_reduction_advice(oscillation, PX4)
    lower = [(name, PX4[name], approx(PX4[name] * 2 / 3)) for name in names]
    assert [*fact.figures["changes"]] == lower
    assert all(name in fact.sentence for name in names)
    both = oscillation._replace(other_axes=(oscillation,))
    assert [*gain_reduction_advice(both, PX4).figures["changes"]] == 2 * lower
    unknown = gain_reduction_advice(oscillation, {})
    assert (unknown.code, unknown.figures["changes"]) == (GainFact.LOWER_GAINS, ())


def test_an_oscillating_axis_without_p_lowers_its_integral():
    without_p = PX4 | {"MC_ROLLRATE_P": 0.0}
    oscillation = Oscillation("roll", 23.0, 40.0, 0.9, False, 20.0)
    changes = gain_reduction_advice(oscillation, without_p).figures["changes"]
    assert [name for name, _, _ in changes] == ["MC_ROLLRATE_I"]


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
def test_a_flight_without_loops_is_refused_with_the_reason(plant, record, code):
    loop = made_up()
    changed_plant = loop.plant._replace(**plant)
    changed_record = replace(loop.record, **record)
    assert refused(loop_from_plant, changed_plant, changed_record).code is code


TYPICAL_DRAG = Drag.from_parameters()


def twin(loop, **arguments):
    defaults = {"px4": True, "hover": 0.5, "wind": None, "drag": TYPICAL_DRAG, "mass": None}
    return build_twin({"roll": loop}, **defaults | arguments)


@mark.parametrize("bias, factor", [(-0.15, 1 / 0.85), (0.1, 1.0)])
def test_draws_of_a_plant_that_wind_biases_are_about_its_likely_effect(bias, factor):
    loop = made_up()
    biased = loop_from_plant(
        loop.plant._replace(bias=bias, reasons={"effect": "wind"}), loop.record
    )
    assert_allclose(biased.effectiveness[0], loop.effectiveness[0])
    assert_allclose(biased.effectiveness[1:], loop.effectiveness[1:] * factor)


def test_the_crossover_of_a_loop_that_wind_biases_may_be_faster():
    loop = made_up()
    too_low = loop_from_plant(
        loop.plant._replace(bias=-0.15, reasons={"effect": "wind"}), loop.record
    )
    assert too_low.rate.crossover_interval[0] > loop.rate.crossover_interval[0]


def test_the_phase_margin_is_marked_in_the_chart_of_the_phase():
    _, phase, sensitivity = loop_charts({"now": made_up()})
    assert phase.marks[0].name.endswith("°")
    assert not sensitivity.marks[0].name


def test_a_twin_has_notes_on_the_certainty_of_its_figures():
    loop = made_up()
    body = twin(loop)
    assert body.arm == (0.1, 0.2)
    notes = body.notes
    assert notes["mass"] == Fact(TwinFact.MASS_NOTE, is_given=False)
    assert notes["arm"] == Fact(TwinFact.ARM_NOTE, is_given=True)
    inertia = notes["inertia"].figures
    assert inertia["pitch"] is None
    assert inertia["roll"].code is TwinFact.EFFECT_NOTE
    assert inertia["roll"].figures["share"] == approx(1.645 * 0.0095 / 0.36, rel=0.1)
    assert notes["moment"].code is TwinFact.MOMENT_NOTE
    assert notes["damping"] == Fact(TwinFact.DAMPING_NOTE, damping=loop.plant.interval().damping)
    status = {**loop.plant.status, "lag": Status.NOT_IDENTIFIABLE}
    with_unknown_lag = replace(loop, plant=loop.plant._replace(status=status))
    notes = twin(with_unknown_lag, mass=2.0).notes
    assert notes["lag"] == Fact(TwinFact.LAG_NOTE, lag=None)
    assert notes["mass"].figures["is_given"]
    assert refused(twin, loop, hover=0.05) == Fact(TwinFact.NO_HOVER, share=0.05)


@mark.slow
@mark.parametrize("delay", [0.004, 0.0])
def test_a_twin_has_the_margins_of_its_loop_and_its_cycle_in_the_delay(delay):
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
        true_margins = truth(scenario, fly(scenario))["roll_rate_margins"]
        margins = [loop.crossover, loop.phase_margin, loop.gain_margin, loop.ms]
        assert true_margins == approx(margins, rel=0.02)


@mark.parametrize("with_correction, with_feed_forward", [(0, 1), (1, 1), (1, 0)])
def test_a_replay_has_the_rate_setpoints_without_the_correction_of_the_angle(
    with_correction, with_feed_forward
):
    """The cases are ArduPilot's ATTITUDE_TARGET, its RATE, and rate setpoints of the correction alone."""
    loop = made_up()
    loop = replace(loop, controller=replace(loop.controller, derivative_of_error=True))
    time = 0.005 * np.arange(2000)
    angle = 0.2 * np.sin(3 * time)
    feed_forward = with_feed_forward * 0.6 * np.cos(3 * time)
    angle_error = angle - loop.record.outputs[:, 0]
    correction = with_correction * loop.controller.angle_gain * angle_error
    setpoints = np.column_stack([angle, correction + feed_forward])
    names = ("roll setpoint", "roll rate setpoint")
    record = replace(loop.record, setpoints=setpoints, setpoint_names=names)
    segment = replay_segments({"roll": replace(loop, record=record)})["roll"]
    assert_allclose(segment.setpoints[1:-1, 1], feed_forward[1:-1], atol=0.01)
    assert replay_segments({"roll": loop}) == {}


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
    assert scenario.vehicle.drag_linear == approx(TYPICAL_DRAG.linear, rel=1e-4), (
        "the wind pushes it"
    )


@mark.parametrize(
    "by_wind, factor, limited_share, code, agrees",
    [
        (0.0, 1.0, 0.1, None, True),
        (0.0, 3.0, 0.0, ResponseFact.RESPONSE_DISAGREES, False),
        (0.0, 3.0, 0.1, ResponseFact.RESPONSE_LIMITED, None),
        (30.0, 1.0, 0.0, ResponseFact.RESPONSE_UNEXPLAINED, None),
    ],
)
def test_a_measured_response_that_differs_from_the_predicted_one_has_a_reason(
    by_wind, factor, limited_share, code, agrees
):
    """A rate that follows its setpoint by the closed loop, or ``factor`` times as far, and wind."""
    loop = made_up()
    rng = default_rng(8)
    dt = loop.record.dt
    samples = 12000
    predicted = loop.rate.frequency, loop.rate.closed_loop_response[0]
    response = np.interp(np.fft.rfftfreq(samples, dt), *predicted)
    setpoint = rng.normal(0, 0.3, samples)
    rate = factor * np.fft.irfft(response * np.fft.rfft(setpoint), samples)
    rate += by_wind * rng.normal(0, 0.3, samples)
    record = replace(
        loop.record,
        inputs=1500 + rng.normal(0, 1, (samples, 1)) * X_ROLL,
        outputs=np.column_stack([rate.cumsum() * dt, rate]),
        lengths=(samples,),
        setpoints=setpoint[:, None],
        setpoint_names=("roll rate setpoint",),
    )
    measured = measured_rate_response(
        record, loop.controller, np.array(X_ROLL), *predicted, limited_share=limited_share
    )
    assert getattr(measured.reason, "code", None) == code
    assert replace(loop, measured=measured).agrees is agrees


def test_an_attitude_loop_around_an_unstable_rate_loop_has_no_margins():
    """Its response alone looks as if it had: the poles of the rate loop in the right half plane do not show in it."""
    sound = made_up()
    assert sound.rate.is_stable
    assert sound.attitude.is_stable
    assert sound.attitude.phase_margin > 0
    unstable = made_up(12.0)
    assert not unstable.rate.is_stable
    assert not unstable.attitude.is_stable
    for name in ("phase_margin", "gain_margin", "delay_margin"):
        assert getattr(unstable.attitude, name) == -np.inf
    assert np.isfinite(unstable.attitude.crossover)
