"""Lights of margins and tracking: resonances of known loops, errors and overshoot against known setpoints."""

from dataclasses import replace

import numpy as np
from hover import (
    Hover,
    asking,
    changed,
    columns,
    evidence_of,
)
from numpy.random import default_rng
from partial_records import partial_record
from pytest import approx, mark
from recorded_flights import LOGS
from scipy.signal import lfilter

from mavdem.assessment.assess import without_flight_advice
from mavdem.assessment.axis.loops import loops_of_axes
from mavdem.assessment.axis.margins import AxisMargins
from mavdem.assessment.axis.responses import measure_responses
from mavdem.assessment.axis.tracking import ANGLE_ERROR_LIMITS, MAX_RESPONSE_PEAK, ResponsePeak
from mavdem.assessment.condition import Condition
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.judgement import judge
from mavdem.assessment.lights.margins import margins_light
from mavdem.assessment.lights.motors import motors_light
from mavdem.assessment.lights.tracking import tracking_light
from mavdem.dataset.alignment import aligned_flight
from mavdem.dataset.segment_learnability import slow_streams
from mavdem.dataset.segments import Segment, settled_segments
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import Override
from mavdem.facts.ending import Ending, MotionEvent
from mavdem.facts.identifiability import Status
from mavdem.facts.learnability import NotLearnableReason
from mavdem.facts.loops import GainFact, LoopAction, LoopFact, ResponseFact
from mavdem.facts.margins import MarginsLight, TrackingLight
from mavdem.facts.sources import Repair
from mavdem.facts.wind import NoWind
from mavdem.ingest import read_log
from mavdem.ingest.vocabulary import wrapped_angle
from mavdem.loops.limit_cycles import Oscillation
from mavdem.loops.measured_response import MeasuredResponse
from mavdem.loops.resonance import Resonance
from mavdem.report.charts.flight_charts import attitude_gain_chart
from mavdem.wind_velocity.from_log import WindEvidence

HOVER = Hover(hovering=40.0)
TIME = HOVER.stamps(100.0)
RATES, ATTITUDE = 7, 128  # Bits of ATTITUDE_TARGET for ignored setpoints.


def evidence(telemetry, **known):
    return evidence_of(Signals(telemetry), **known)


def noise(seed=1):
    """White below 30 Hz."""
    values = default_rng(seed).standard_normal(len(TIME))
    return lfilter([0.2, 0.4, 0.2], [1.0, -0.3, 0.1], values)


def second_order_response(setpoint, damping, omega):
    """Returns the response to a setpoint, sampled at 100 Hz, of the system ω² / (s² + 2 ζ ω s + ω²)."""
    pole = np.exp((-damping + 1j * np.sqrt(1 - damping**2)) * omega * 0.01)
    denominator = [1.0, -2 * pole.real, abs(pole) ** 2]
    return lfilter([0.0, sum(denominator)], denominator, setpoint)


def closed_loop(margin):
    """A rate at 10 Hz and its setpoint, of a loop that has about so many degrees of phase margin."""
    setpoint = noise()
    rate = second_order_response(setpoint, np.tan(np.radians(margin)) / 2, 20 * np.pi)
    return rate + 0.05 * noise(2), setpoint


def with_setpoint(telemetry, rate=None, angle=None):
    """Returns telemetry with setpoints of roll at 100 Hz, (N,) rad/s or rad, in addition."""
    return asking(telemetry, TIME, RATES if rate is None else ATTITUDE, rate, angle)


def flight(rate, setpoint):
    """A hover at 100 Hz with a roll rate and its setpoint, (N,) rad/s."""
    return with_setpoint(changed(HOVER.telemetry(), "ATTITUDE", rollspeed=rate), rate=setpoint)


@mark.slow
def test_a_resonance_is_seen_by_the_response_to_the_setpoint():
    flight_evidence = evidence(flight(*closed_loop(12.0)))
    light = margins_light(flight_evidence)
    assert (light.code, light.level) == (MarginsLight.RESONATES, "bad")
    response = flight_evidence.margins[0].response
    assert response.frequency == approx(10.0, abs=1.0) and response.coherence > 0.9
    assert response.peak == approx(0.5 / np.sin(np.radians(6.0)), rel=0.2)
    # What resonates is said by the sensitivity, since a rate that is as large as its setpoint would read as good.
    low, high = response.ms_interval
    assert f"Ms is {low:.2g} to {high:.2g} at {response.ms_frequency:.2g} Hz by" in light.sentence
    # The sensitivity peaks above the closed loop.
    assert response.frequency <= response.ms_frequency < 15.0


@mark.slow
def test_where_no_resonance_shows_it_is_said_up_to_which_frequency():
    flight_evidence = evidence(flight(*closed_loop(60.0)))
    light = margins_light(flight_evidence)
    assert (light.code, light.level) == (MarginsLight.NO_RESONANCE, "good")
    margins = flight_evidence.margins[0]
    slow = replace(margins.response, max_frequency=19.0)
    vars(flight_evidence)["margins"] = (replace(margins, response=slow),)
    assert margins_light(flight_evidence).sentence.endswith("No resonance shows up to 19 Hz.")


@mark.slow
def test_a_vehicle_that_is_asked_for_rates_alone_is_judged_by_them():
    """The type mask says that the attitude is ignored. A rate that lags by 0.04 s follows."""
    asked_rate = 1.2 * np.sin(5.0 * TIME)
    followed = evidence(flight(1.2 * np.sin(5.0 * (TIME - 0.04)), asked_rate))
    light = tracking_light(followed)
    assert (light.code, light.level) == (TrackingLight.FOLLOWS_RATE_SETPOINT, "good")
    assert light.figures["delay"] == approx(0.04) and "no angle is asked for" in str(light)
    missed = tracking_light(evidence(flight(-asked_rate, 0 * TIME)))
    assert (missed.code, missed.level) == (TrackingLight.MISSES_RATE_SETPOINT, "bad")
    assert missed.figures["rate_error_limit"] == approx(4.5 * np.radians(10.0))
    assert str(missed).startswith("Roll rate misses its setpoint by 48 °/s (RMS")
    # Without an angle no side of the error is known.
    no_angle = {"angle_error": None, "offset_angle": None, "at_limit_share": None}
    action = Fact(LoopAction.CHECK_VEHICLE, axis="roll", **no_angle)
    assert str(action) == "Check motors, propellers and load before the next flight."


def test_a_peak_asks_for_no_setpoint_where_one_was_logged():
    peak = Resonance("roll", 4.9, 19.0, 0.9, 40.0)
    (light,) = AxisMargins("roll", Fact(LoopFact.LOOP_NOT_FOUND), None, peak).facts
    assert light.remedy.startswith("Check")


@mark.slow
def test_a_setpoint_that_only_answers_the_rate_shows_no_response():
    """In wind the attitude's controller asks for −K times the angle: the ratio of both rises with the frequency."""
    rate = noise()
    angle = np.cumsum(rate) * 0.01
    answer = lfilter([0.01], [1, -0.99], angle) - angle
    light = margins_light(evidence(flight(rate, 4.5 * answer)))
    assert light.code is MarginsLight.MARGINS_UNKNOWN and light.level == "unknown"


@mark.slow
def test_what_the_autopilot_injects_shows_no_margin():
    telemetry = flight(*closed_loop(12.0))
    autotune = changed(telemetry, "CURRENT_MODE", **columns([8.0], custom_mode=[15]))
    assert margins_light(evidence(autotune)).level == "unknown"


def with_oscillation(found):
    """Returns evidence with a limit cycle of pitch and roll at 5 Hz in its condition."""
    swinging = Oscillation("pitch", 5.0, 40.0, 0.98, False, 20.0, Segment(0, 10.0, 30.0))
    swinging = swinging._replace(other_axes=(swinging._replace(axis="roll", rate=9.0),))
    return replace(found, condition=replace(found.condition, oscillation=swinging))


@mark.slow
def test_a_limit_cycle_decides_the_lights_of_motors_margins_and_tracking():
    swinging = with_oscillation(evidence(flight(*closed_loop(60.0))))
    assert motors_light(swinging).sentence.endswith("lower limit (idle) 98 % of the time.")
    light = margins_light(swinging)
    assert (light.code, light.level) == (MarginsLight.OSCILLATES, "bad")
    assert light.figures["reason"].code is GainFact.LOWER_GAINS
    assert light.sentence.startswith("Pitch and roll oscillate: pitch at 5 Hz, by 40 °/s; roll")
    # Where motors swing from stop to stop, the vehicle may turn little: that comes first.
    stops = light.replace(is_stop_to_stop=True)
    assert stops.sentence.startswith(
        "Pitch and roll oscillate, and motors swing from stop to stop: pitch at 5 Hz, by 40 °/s;"
    )
    assert stops.replace(axes=stops.figures["axes"][:1]).sentence == (
        "The pitch rate oscillates, and motors swing from stop to stop: at 5 Hz, by 40 °/s "
        "(standard deviation)."
    )
    # Gains may be the cause, or a wrong frame type, with which no gain makes it safe to fly.
    assert light.remedy.startswith("Do not fly. First check frame type and motor order. Lower ")
    # With a wrong order it would have turned over within a second.
    assert light.replace(was_upright=True).remedy.startswith(
        "Do not fly with these gains. It stayed upright, so the motors' order is right. Lower "
    )
    light = tracking_light(with_oscillation(evidence_of_delayed_roll(0.1)))
    assert (light.code, light.level) == (TrackingLight.FOLLOWS_SETPOINT, "watch")


@mark.slow
def test_the_reason_for_unknown_margins_is_stated_at_any_message_rate():
    """Messages are slow, and a loop has no margins for another reason. The light states that reason, once."""
    for refusal, statement in (
        (
            Fact(LoopFact.NOT_STEERED, share=0.3),
            "No margins: commands explain only 30 % of the rate's motion, wind and noise the rest.",
        ),
        (
            Fact(LoopFact.NO_MARGINS, reason=Fact(LoopFact.NOT_STEERED, share=0.3)),
            "No margins: commands explain only 30 % of the rate's motion, wind and noise the rest.",
        ),
        (
            Fact(
                LoopFact.CROSSOVER_UNSEEN,
                crossover=9.0,
                rate=30.0,
                frequency=7.5,
                least_rate=100.0,
            ),
            "messages at 30 Hz show no motion faster than 7.5 Hz.",
        ),
        (
            slow_streams({"ATTITUDE": 10.0}, "roll"),
            "Margins do not show at 10 Hz: attitude, body rates and motors need 40 Hz.",
        ),
    ):
        light = margins_light(evidence(HOVER.telemetry(10.0, 10.0), loops={"roll": refusal}))
        assert light.level == "unknown" and light.figures["reason"] is refusal
        assert light.sentence.endswith(statement) and "there are the" not in light.sentence
        assert light.sentence.lower().count("no margins") <= 1


@mark.slow
def test_the_worst_loop_of_a_flight_is_rated():
    """The loops of roll are taken for pitch too, with a gain that is 12 % higher.

    The light names pitch, and its advice names the command with vehicle, file and axes.
    """
    log = read_log(LOGS / "ardupilot_wind5_steps.tlog")
    loops, _ = loops_of_axes(log, Signals(log.vehicles[0]))
    assert list(loops) == ["roll", "pitch", "yaw"] and isinstance(loops["pitch"], Fact)
    # A vehicle whose control effectiveness is known: a doubtful one gives no gains.
    plant = loops["roll"].plant
    identified_plant = plant._replace(bias=0.0, status={**plant.status, "effect": Status.REPORTED})
    loops["roll"] = replace(loops["roll"], plant=identified_plant, cautions=())
    # Nine of ten models of pitch lack margin with this gain, so that the flight is a basis for new ones.
    tighter = loops["roll"].with_parameters({"ATC_RAT_RLL_P": 1.12 * loops["roll"].controller.p})
    loops["pitch"] = replace(tighter, axis="pitch")
    added = Fact(Repair.PARAMETERS_ADDED, count=1, path="my.param")
    vehicle = replace(log.vehicles[0], repairs=(added,))
    log = replace(log, source="my flight.tlog", vehicles=2 * log.vehicles)
    flight_evidence = evidence(vehicle, loops=loops, log=log)
    light = judge(flight_evidence).lights["margins"]
    assert (light.code, light.level) == (MarginsLight.LOOP_MARGINS, "watch")
    assert light.remedy == (
        "Load the gains that `mavdem tune 'my flight.tlog' --vehicle 1:1 --params my.param --axis all` advises."
    )
    assert light.figures["axis"] == "pitch"
    alive = replace(flight_evidence, log=replace(log, source="", vehicles=log.vehicles[:1]))
    assert "`mavdem tune --params my.param --axis all`" in judge(alive).lights["margins"].remedy
    disagrees = Fact(ResponseFact.RESPONSE_DISAGREES, share=0.3, needed=0.8)
    measured = MeasuredResponse((0.5, 9.0), 30.0, 30.0, 1.0, disagrees)
    loops["roll"] = replace(loops["roll"], measured=measured)
    light = margins_light(replace(flight_evidence, loops=loops))
    assert light.figures["reason"] is disagrees  # Pitch, which nothing confirms, does not count.


def evidence_of_delayed_roll(size, late=0.2, error=0.0):
    """Returns evidence of a roll that follows a moving setpoint ``late`` s later, with a constant ``error``, rad.

    ``size`` is the amplitude of each of the two sines of the setpoint, rad.
    """

    def steered(time):
        return size * (np.sin(1.3 * time) + np.sin(2.9 * time + 1.0))

    telemetry = changed(HOVER.telemetry(), "ATTITUDE", roll=steered(TIME - late) + error)
    return evidence(with_setpoint(telemetry, angle=steered(TIME)))


@mark.slow
def test_the_tracking_error_excludes_the_delay():
    """Roll follows its setpoint 0.2 s late, or without a delay and with a constant error."""
    light = tracking_light(evidence_of_delayed_roll(0.1))
    assert (light.code, light.level) == (TrackingLight.FOLLOWS_SETPOINT, "good")
    assert light.figures["delay"] == approx(0.2, abs=0.021)
    assert light.figures["angle_error"] < 0.01
    axes = evidence_of_delayed_roll(0.1, late=0.0, error=0.02).tracking
    figures = axes["roll"].figures
    assert figures["offset_angle"] == approx(0.02, rel=0.05)
    assert figures["angle_error"] == approx(0.02, rel=0.05)
    # The least delay that is tried fits best, so that the delay itself is not known.
    assert figures["delay"] is None
    assert "late" not in axes["roll"].sentence
    assert "angle_error" not in axes["yaw"].figures


def test_the_axis_nearest_to_bad_is_named():
    """Yaw's error of 13° is nearer to its limit of 15° than pitch's 5.5° to 10°; a good yaw is not named."""

    def missing(axis, error, limit, level=Level.WATCH):
        errors = {"angle_error": np.radians(error), "error_limit": np.radians(limit)}
        return Fact(TrackingLight.MISSES_SETPOINT, level, axis=axis, **errors)

    tilts = {"roll": missing("roll", 4.0, 10.0), "pitch": missing("pitch", 5.5, 10.0)}
    for level, named in ((Level.WATCH, "yaw"), (Level.GOOD, "pitch")):
        tracking = tilts | {"yaw": missing("yaw", 13.0, 15.0, level)}
        flight_evidence = partial_record(
            Evidence,
            tracking=tracking,
            other_vehicle=None,
            condition=Condition(60.0),
        )
        light = tracking_light(flight_evidence)
        assert light.figures["axis"] == named
        assert ("bad from 15°" if named == "yaw" else "bad from 10°") in light.sentence


@mark.parametrize("rate", [10.0, 20.0])
def test_an_oscillation_at_half_of_the_sampling_rate_is_an_error(rate):
    """The roll alternates by 2° from sample to sample, about a setpoint that is sampled as often."""
    amplitude = np.radians(2.0)
    telemetry = HOVER.telemetry(rate, rate)
    time = telemetry.messages["ATTITUDE"]["time"]
    setpoint = 0.05 * np.sin(1.3 * time)
    roll = setpoint + amplitude * (-1.0) ** np.arange(len(time))
    telemetry = asking(changed(telemetry, "ATTITUDE", roll=roll), time, 7, None, setpoint)
    figures = evidence(telemetry).tracking["roll"].figures
    assert figures["angle_error"] == approx(amplitude, rel=0.05)


@mark.slow
@mark.parametrize(
    "size, error, level",
    [
        (0.02, 0.9 * ANGLE_ERROR_LIMITS.watch, "good"),
        (0.02, 1.1 * ANGLE_ERROR_LIMITS.watch, "watch"),
        (0.2, 1.1 * ANGLE_ERROR_LIMITS.watch, "good"),
        (0.02, 0.9 * ANGLE_ERROR_LIMITS.bad, "watch"),
        (0.02, 1.1 * ANGLE_ERROR_LIMITS.bad, "bad"),
        (0.3, 1.1 * ANGLE_ERROR_LIMITS.bad, "watch"),
    ],
)
def test_the_limit_of_the_tracking_error_grows_with_the_setpoint(size, error, level):
    """The same error is judged with small and with large setpoints."""
    assert tracking_light(evidence_of_delayed_roll(size, late=0.0, error=error)).level == level


def evidence_of_steps(hover, damping):
    """Returns evidence of a roll that follows steps of 3° with this damping ratio and 9 rad/s, and some gyro noise."""
    time = hover.stamps(50.0)
    steps = 0.06 * np.sign(np.sin(0.7 * time) + np.sin(1.9 * time) + np.sin(3.1 * time))
    # A sample lasts twice as long as in `second_order_response`, so that the natural frequency is half of 18 rad/s.
    roll = second_order_response(steps, damping, 18.0) + 0.002 * default_rng(1).standard_normal(
        len(time)
    )
    telemetry = changed(hover.telemetry(50.0, 50.0), "ATTITUDE", roll=roll)
    return evidence(asking(telemetry, time, RATES, None, steps))


@mark.slow
def test_overshoot_is_that_of_the_measured_step_response():
    damping = 0.2
    tracking = evidence_of_steps(Hover(hovering=100.0), damping)
    light = tracking_light(tracking)
    overshoot = light.figures["overshoot"]
    assert (light.code, light.level) == (TrackingLight.OVERSHOOTS_SETPOINT, "watch")
    assert overshoot == approx(np.exp(-np.pi * damping / np.sqrt(1 - damping**2)), abs=0.06)
    assert light.sentence == f"Roll overshoots its setpoint by {100 * overshoot:.0f} % of a step."
    response = measure_responses(tracking)["roll"]["attitude"].measured
    assert response.overshoot.value == overshoot
    assert tracking_light(evidence_of_steps(Hover(hovering=100.0), 0.45)).level == "good"


@mark.slow
def test_a_resonance_without_a_step_response_is_not_called_overshoot():
    tracking = evidence_of_steps(HOVER, 0.2)
    light = tracking_light(tracking)
    assert (light.code, light.level) == (TrackingLight.AMPLIFIES_SETPOINT, "watch")
    assert light.figures["overshoot"] is None
    assert light.sentence.startswith("Roll moves 2 times as far as its setpoint at 1.2 Hz; without")
    # The chart of that gain shows this peak. An axis that follows has none.
    gain = tracking.amplifying_attitude_gain("roll")
    [measured] = attitude_gain_chart("roll", gain, None).lines
    assert measured.y.max() == light.figures["ratio"]
    assert measured.x[measured.y.argmax()] == light.figures["frequency"]
    assert (measured.lower_edge < measured.y).all() and (measured.lower_edge > 0).all()
    assert tracking.amplifying_attitude_gain("pitch") is None


@mark.slow
def test_a_setpoint_that_holds_a_position_shows_no_resonance():
    """It answers how wind moved the vehicle: the ratio of angle and setpoint is the position controller's."""
    loiter = 5
    tracking = evidence_of_steps(HOVER, 0.2)
    telemetry = changed(
        tracking.signals.telemetry, "CURRENT_MODE", **columns([0.0], custom_mode=[loiter])
    )
    light = tracking_light(evidence(telemetry))
    assert (light.code, light.level) == (TrackingLight.FOLLOWS_SETPOINT, "good")


def test_a_large_response_is_sure_only_with_enough_coherence_or_windows():
    unsure = ResponsePeak(ratio=1.53, frequency=0.75, coherence=0.84, windows=11)
    assert unsure.lowest_ratio < MAX_RESPONSE_PEAK
    assert unsure._replace(coherence=1.0).lowest_ratio == 1.53
    assert unsure._replace(windows=5000).lowest_ratio > MAX_RESPONSE_PEAK


def telemetry_of_turns(turn_rate, asked_rate, outputs=None):
    """Returns telemetry of a vehicle that yaws for 1 s of 6, at one rate, °/s, while the setpoint is another one."""
    is_turning = (TIME % 6.0 < 1.0) & (TIME > 14.0) & (TIME < 48.0)
    rate = np.radians(turn_rate) * is_turning
    yaw = np.cumsum(rate) * 0.01
    telemetry = HOVER.telemetry()
    if outputs is not None:
        servos = telemetry.messages["SERVO_OUTPUT_RAW"]
        at_limit = {
            f"servo{n}_raw": np.where(is_turning, outputs[n - 1], servos[f"servo{n}_raw"])
            for n in range(1, 5)
        }
        telemetry = changed(telemetry, "SERVO_OUTPUT_RAW", **at_limit)
    telemetry = changed(telemetry, "ATTITUDE", yaw=wrapped_angle(yaw), yawspeed=rate)
    telemetry = with_setpoint(telemetry, angle=0.01 * np.sin(TIME))
    late_yaw = np.interp(TIME + 0.1, TIME, yaw)
    half = (late_yaw + 2 * np.pi) / 2
    attitude = np.column_stack([np.cos(half), 0 * half, 0 * half, np.sin(half)])
    setpoint = np.radians(asked_rate) * is_turning
    return changed(
        telemetry, "ATTITUDE_TARGET", q=attitude, body_yaw_rate=setpoint, type_mask=0 * TIME
    )


@mark.slow
def test_yaw_follows_its_setpoint_through_whole_turns():
    flight_evidence = evidence(telemetry_of_turns(100.0, 100.0))
    yaw = flight_evidence.tracking["yaw"]
    assert (yaw.code, yaw.level) == (TrackingLight.FOLLOWS_SETPOINT, "good")
    assert yaw.figures["delay"] == approx(0.1, abs=0.021)
    assert yaw.figures["angle_error"] < np.radians(1.0)
    assert yaw.figures["reached_rate"] == approx(yaw.figures["rate_setpoint"])


@mark.slow
def test_a_heading_that_is_set_at_once_is_no_error_while_the_vehicle_turns_to_it():
    """A mission sets the heading of its next leg, 90° off; the vehicle turns there at 20°/s."""
    heading = np.radians(90.0) * ((TIME > 20.0) & (TIME < 34.0))
    yaw = np.radians(90.0) * np.interp(TIME, [20.0, 24.5, 34.0, 38.5], [0.0, 1.0, 1.0, 0.0])
    telemetry = with_setpoint(telemetry_of_turns(0.0, 0.0), angle=0.01 * np.sin(TIME))
    attitude = np.column_stack([np.cos(heading / 2), 0 * heading, 0 * heading, np.sin(heading / 2)])
    telemetry = changed(telemetry, "ATTITUDE_TARGET", q=attitude)
    follows = evidence(changed(telemetry, "ATTITUDE", yaw=yaw)).tracking["yaw"]
    assert (follows.code, follows.level) == (TrackingLight.FOLLOWS_SETPOINT, "good")
    # One that stays 30° beside its heading long after the turn misses it.
    setpoint = yaw - np.radians(30.0) * (TIME > 24.0)
    misses = evidence(changed(telemetry, "ATTITUDE", yaw=setpoint)).tracking["yaw"]
    assert (misses.code, misses.level) == (TrackingLight.MISSES_SETPOINT, "bad")
    assert misses.figures["largest_error"] == approx(np.radians(30.0), rel=0.1)
    assert misses.figures["largest_error_time"] > 24.0


@mark.slow
@mark.parametrize(
    "outputs, cause",
    [
        (None, "no motor is at a limit: its rate loop is slow."),
        ([2000.0, 2000.0, 1100.0, 1100.0], "a motor is at a limit 100 % of that time."),
    ],
)
def test_a_yaw_rate_that_falls_short_is_watched_with_its_cause(outputs, cause):
    light = tracking_light(evidence(telemetry_of_turns(70.0, 100.0, outputs)))
    assert (light.code, light.level) == (TrackingLight.RATE_FALLS_SHORT, "watch")
    assert light.sentence.startswith("Yaw turns at 70 °/s where 100 °/s is asked")
    assert light.sentence.endswith(cause)


@mark.slow
def test_small_rates_that_answer_the_wind_do_not_fall_short():
    yaw = evidence(telemetry_of_turns(10.0, 30.0)).tracking["yaw"]
    assert yaw.code is not TrackingLight.RATE_FALLS_SHORT and "reached_rate" not in yaw.figures


@mark.slow
def test_a_yaw_setpoint_that_never_changes_is_none():
    flight_evidence = evidence(with_setpoint(HOVER.telemetry(), angle=0.1 * np.sin(TIME)))
    assert flight_evidence.tracking["yaw"].code is TrackingLight.TRACKING_UNKNOWN


@mark.slow
def test_a_flight_for_a_model_of_yaw_has_the_setpoint_of_the_rate_only():
    signals = Signals(telemetry_of_turns(100.0, 100.0), "yaw")
    assert [setpoint.unit for setpoint in signals.setpoints] == ["rad/s", "rad"]
    (segment,) = settled_segments(signals)
    assert aligned_flight(signals, segment).setpoint_names == ("yaw rate setpoint",)


@mark.slow
def test_rates_that_are_flown_by_hand_have_no_angle_to_follow():
    steered = evidence_of_delayed_roll(0.02, late=0.0, error=0.3).signals.telemetry
    for modes, level in (([1, 2], "bad"), ([1], "unknown")):
        acro = columns([8.0, 30.0][: len(modes)], custom_mode=modes)
        assert tracking_light(evidence(changed(steered, "CURRENT_MODE", **acro))).level == level


@mark.slow
def test_nothing_after_the_vehicle_was_lost_counts():
    lost = replace(
        evidence_of_delayed_roll(0.02, late=0.0, error=0.3),
        ending=Fact(NotLearnableReason.NEVER_ARMED, time=11.5),
    )
    assert tracking_light(lost).level == "unknown"


@mark.slow
def test_oscillation_a_loss_or_a_motor_at_its_stop_without_hover_grounds_a_vehicle():
    """Each of these is a reason not to fly, so that no flights are advised."""
    lost = Fact(Ending.CRASHED, time=20.0)
    stop = Fact(MotionEvent.MOTOR_AT_ITS_STOP, Level.WATCH, time=15.0, boot=0)
    caught = Fact(MotionEvent.ATTITUDE_CAUGHT, Level.WATCH)
    sound = evidence(HOVER.telemetry(), events=(caught,))
    touched = replace(sound, events=(caught, stop), ending=lost)
    assert not sound.reasons_not_to_fly and touched.reasons_not_to_fly == (lost,)
    assert replace(touched, condition=replace(sound.condition, hover=None)).reasons_not_to_fly == (
        lost,
        stop,
    )
    (reason,) = with_oscillation(sound).reasons_not_to_fly
    assert reason.code is Override.OSCILLATION and reason.figures["turn_rate"] < 1
    doubt = Fact(NoWind.STUCK, lean=0.5, duration=9.0)
    grounded = without_flight_advice(WindEvidence(None, None, doubt, "PX4"))
    assert grounded == WindEvidence(None, None, doubt.without_flight_advice, "PX4")
