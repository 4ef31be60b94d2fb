"""Lights of margins and tracking: resonances of known loops, errors and overshoot against known setpoints."""

from dataclasses import replace

import numpy as np
from hover import (
    X_QUAD,
    X_QUAD_PARAMETERS,
    Hover,
    asking,
    changed,
    columns,
    evidence_of,
    with_pulses,
)
from numpy.random import default_rng
from pytest import approx, mark
from recorded_flights import LOGS, recorded
from scipy.signal import lfilter

from mavdem.alignment.learnability import too_slow
from mavdem.alignment.signals import Signals
from mavdem.analysis.loops import loops_of_axes
from mavdem.assessment.assess import grounded_air
from mavdem.assessment.margins import margins_light
from mavdem.assessment.tracking import ERROR, tracking_light, tracking_of
from mavdem.condition.condition import settled_parts
from mavdem.condition.oscillation import Oscillation
from mavdem.condition.resonance import response_of
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import Override
from mavdem.facts.ending import Ending, MotionEvent
from mavdem.facts.learnability import Reason
from mavdem.facts.loops import Loops
from mavdem.facts.margins import MarginsLight, TrackingLight
from mavdem.facts.wind import NoWind
from mavdem.ingest import read_log

HOVER = Hover(hovering=40.0)
TIME = HOVER.stamps(100.0)
RATES, ATTITUDE = 7, 128  # bits of ATTITUDE_TARGET of what does not count


def evidence(telemetry, **known):
    return evidence_of(Signals(telemetry), **known)


def noise(seed=1):
    """White below 30 Hz."""
    values = default_rng(seed).standard_normal(len(TIME))
    return lfilter([0.2, 0.4, 0.2], [1.0, -0.3, 0.1], values)


def followed(setpoint, damping, omega):
    """What follows a setpoint by ω² / (s² + 2 ζ ω s + ω²)."""
    pole = np.exp((-damping + 1j * np.sqrt(1 - damping**2)) * omega * 0.01)
    denominator = [1.0, -2 * pole.real, abs(pole) ** 2]
    return lfilter([0.0, sum(denominator)], denominator, setpoint)


def closed_loop(margin):
    """A rate at 10 Hz and its setpoint, of a loop that has about so many degrees of phase margin."""
    setpoint = noise()
    rate = followed(setpoint, np.tan(np.radians(margin)) / 2, 20 * np.pi)
    return rate + 0.05 * noise(2), setpoint


def asked(telemetry, rate=None, angle=None):
    """With setpoints of roll at 100 Hz, (N,) rad/s or rad."""
    return asking(telemetry, TIME, RATES if rate is None else ATTITUDE, rate, angle)


def flight(rate, setpoint):
    """A hover at 100 Hz with a roll rate and its setpoint, (N,) rad/s."""
    return asked(changed(HOVER.telemetry(), "ATTITUDE", rollspeed=rate), rate=setpoint)


@mark.parametrize(
    "margin, code, level",
    [
        (12.0, MarginsLight.RESONATES, Level.BAD),
        (60.0, MarginsLight.NO_RESONANCE, Level.GOOD),
    ],
)
def test_a_resonance_is_seen_by_the_response_to_the_setpoint(margin, code, level):
    found = evidence(flight(*closed_loop(margin)))
    light = margins_light(found)
    assert (light.code, light.level, light.figures["axis"]) == (code, level, "roll")
    seen = found.margins[0].response
    if level is Level.BAD:
        assert seen.frequency == approx(10.0, abs=1.0) and seen.coherence > 0.9
        peak = 1 / (2 * np.sin(np.radians(margin / 2)))
        assert seen.peak == approx(peak, rel=0.2)
    else:
        slow = replace(found.margins[0], response=replace(seen, highest=19.0))
        vars(found)["margins"] = (slow,)
        assert margins_light(found).sentence.endswith("No resonance shows up to 19 Hz.")


def test_a_setpoint_that_only_answers_the_rate_shows_no_response():
    """In wind the attitude's controller asks for −K times the angle: the ratio of both rises with the frequency."""
    rate = noise()
    angle = np.cumsum(rate) * 0.01
    light = margins_light(
        evidence(flight(rate, -4.5 * (angle - lfilter([0.01], [1, -0.99], angle))))
    )
    assert light.code is MarginsLight.MARGINS_UNKNOWN and light.level is Level.UNKNOWN


@mark.parametrize("damping, stands_out", [(0.1, True), (0.19, False)])
def test_a_peak_that_the_motors_share_stands_out_without_a_setpoint(damping, stands_out):
    """Over the line between 2/3 and 3/2 of its frequency it is 1 / (2.4 damping): 4.2 and 2.2, where 3 is much."""
    rate = closed_loop(np.degrees(np.arctan(2 * damping)))[0]
    telemetry = changed(HOVER.telemetry(parameters=X_QUAD_PARAMETERS), "ATTITUDE", rollspeed=rate)
    flying = (TIME > 6.0) & (HOVER.landed > TIME)
    pulses = np.where(flying, (1500.0 + X_QUAD * 20 * rate[:, None]).T, 1000.0)
    light = margins_light(evidence(with_pulses(telemetry, pulses)))
    assert (light.code is MarginsLight.RATE_STANDS_OUT) is stands_out
    if stands_out:
        assert light.level is Level.WATCH
        assert light.figures["frequency"] == approx(10.0, abs=1.0)
        assert light.figures["ratio"] == approx(1 / (2.4 * damping), rel=0.25)


def test_what_the_autopilot_injects_shows_no_margin():
    autotune = columns([8.0], custom_mode=[15])
    telemetry = changed(flight(*closed_loop(12.0)), "CURRENT_MODE", **autotune)
    assert margins_light(evidence(telemetry)).level is Level.UNKNOWN


def oscillating(found):
    """The same of a vehicle that oscillates."""
    swinging = Oscillation("pitch", 5.0, 40.0, 0.0, False, 20.0)
    return replace(found, condition=replace(found.condition, oscillation=swinging))


def test_a_limit_cycle_goes_before_all():
    light = margins_light(oscillating(evidence(flight(*closed_loop(60.0)))))
    assert (light.code, light.level) == (MarginsLight.OSCILLATES, Level.BAD)
    light = tracking_light(oscillating(following(0.1)))
    assert (light.code, light.level) == (TrackingLight.FOLLOWS_SETPOINT, Level.WATCH)


def test_what_hides_the_margins_is_said_at_any_rate():
    for refusal, said in (
        (
            Fact(Loops.NOT_STEERED, share=0.3),
            "No margins: only 30 % of the rate's motion was asked for.",
        ),
        (Fact(Loops.CROSSOVER_UNSEEN, crossover=9.0, rate=30.0), " a quarter of their rate."),
        (
            too_slow({"ATTITUDE": 10.0}, "roll"),
            "Margins do not show at 10 Hz: attitude and motors need 40 Hz.",
        ),
    ):
        light = margins_light(evidence(HOVER.telemetry(10.0, 10.0), loops={"roll": refusal}))
        assert light.level is Level.UNKNOWN and light.figures["because"] is refusal
        assert light.sentence.endswith(said) and "there are the" not in light.sentence


@mark.slow
def test_the_worst_loop_of_a_flight_is_rated():
    log = read_log(LOGS / "ardupilot_wind5_steps.tlog")
    loops = loops_of_axes(log, Signals(log.vehicles[0]))
    assert list(loops) == ["roll", "pitch", "yaw"] and isinstance(loops["pitch"], Fact)
    light = margins_light(evidence(log.vehicles[0], loops=loops))
    assert (light.code, light.level) == (MarginsLight.LOOP_MARGINS, Level.WATCH)
    assert light.figures["axis"] == "roll"
    roll = loops["roll"]
    assert roll.refusal is None
    tighter = roll.changed({"ATC_RAT_RLL_P": 1.03 * roll.controller.p})
    loops["pitch"] = replace(tighter, axis="pitch")
    light = margins_light(evidence(log.vehicles[0], loops=loops))
    assert (light.level, light.figures["axis"]) == (Level.WATCH, "pitch")


@mark.parametrize(
    "name, peak, ms",
    [("ap_raw_off", 2.5, 4.88), ("ap_autotune", 0.93, 1.95)],
)
def test_the_response_of_ardupilots_rate_loop_is_measured_at_its_own_rate(name, peak, ms):
    """RATE comes at 200 Hz, ATT at 5; the sensitivity by its plant is 4.88."""
    signals = Signals(recorded(f"sitl_raw/{name}.BIN.xz"))
    seen = response_of(signals, settled_parts(signals))
    assert seen.peak == approx(peak, rel=0.05)
    assert np.mean(seen.ms_interval) == approx(ms, rel=0.05)


def following(size, late=0.2, error=0.0):
    """Roll ``late`` s behind a setpoint of this standard deviation, rad, and that many rad off."""

    def steered(time):
        return size * (np.sin(1.3 * time) + np.sin(2.9 * time + 1.0))

    telemetry = changed(HOVER.telemetry(), "ATTITUDE", roll=steered(TIME - late) + error)
    return evidence(asked(telemetry, angle=steered(TIME)))


def test_tracking_has_the_error_without_the_delay():
    light = tracking_light(following(0.1))
    assert (light.code, light.level) == (TrackingLight.FOLLOWS_SETPOINT, Level.GOOD)
    assert light.figures["delay"] == approx(0.2, abs=0.021)
    assert light.figures["angle_error"] < 0.01
    axes = tracking_of(following(0.1, late=0.0, error=0.02))
    figures = axes["roll"].figures
    assert figures["offset_angle"] == approx(0.02, rel=0.05)
    assert figures["angle_error"] == approx(0.02, rel=0.05)
    assert "angle_error" not in axes["yaw"].figures


def test_tracking_has_the_error_of_the_rate():
    telemetry = changed(HOVER.telemetry(), "ATTITUDE", rollspeed=0.03)
    targets = asked(telemetry, rate=0 * TIME).messages["ATTITUDE_TARGET"]
    made = changed(telemetry, "ATTITUDE_TARGET", **(targets | {"type_mask": np.zeros(len(TIME))}))
    assert tracking_light(evidence(made)).figures["rate_error"] == approx(0.03, rel=0.01)


@mark.parametrize(
    "size, error, level",
    [
        (0.02, 0.9 * ERROR.watch, Level.GOOD),
        (0.02, 1.1 * ERROR.watch, Level.WATCH),
        (0.2, 1.1 * ERROR.watch, Level.GOOD),
        (0.02, 0.9 * ERROR.bad, Level.WATCH),
        (0.02, 1.1 * ERROR.bad, Level.BAD),
        (0.3, 1.1 * ERROR.bad, Level.WATCH),
    ],
)
def test_an_error_counts_beside_what_was_asked(size, error, level):
    assert tracking_light(following(size, late=0.0, error=error)).level is level


@mark.parametrize("damping, level", [(0.3, Level.WATCH), (0.45, Level.GOOD)])
def test_overshoot_is_that_of_a_step(damping, level):
    steps = 0.1 * np.sign(np.sin(0.7 * TIME) + np.sin(1.9 * TIME))
    answer = changed(HOVER.telemetry(), "ATTITUDE", roll=followed(steps, damping, 9.0))
    found = evidence(asked(answer, angle=steps))
    expected = np.exp(-np.pi * damping / np.sqrt(1 - damping**2))
    light = tracking_light(found)
    if light.figures["axis"] == "roll":
        assert light.figures["overshoot"] == approx(expected, abs=0.06)
    assert light.level is level
    assert level is Level.GOOD or light.code is TrackingLight.OVERSHOOTS_SETPOINT


def test_what_is_not_in_the_log_is_unknown():
    light = tracking_light(evidence(HOVER.telemetry()))
    assert (light.code, light.level) == (TrackingLight.TRACKING_UNKNOWN, Level.UNKNOWN)


def test_ardupilots_navigation_has_the_angle_that_was_asked():
    telemetry = HOVER.telemetry(4.0, 4.0)
    time = HOVER.stamps(2.0)
    asked = np.degrees(HOVER.roll(time))
    telemetry = changed(
        telemetry, "NAV_CONTROLLER_OUTPUT", **columns(time, nav_roll=asked, nav_pitch=0.0)
    )
    assert tracking_light(evidence(telemetry)).level is Level.GOOD


def test_rates_that_are_flown_by_hand_have_no_angle_to_follow():
    steered = following(0.02, late=0.0, error=0.3).signals.telemetry
    acro = columns([8.0, 30.0], custom_mode=[1, 2])
    assert tracking_light(evidence(changed(steered, "CURRENT_MODE", **acro))).level is Level.BAD
    acro = columns([8.0], custom_mode=[1])
    assert tracking_light(evidence(changed(steered, "CURRENT_MODE", **acro))).level is Level.UNKNOWN


def test_nothing_after_the_vehicle_was_lost_counts():
    lost = replace(following(0.02, late=0.0, error=0.3), ending=Fact(Reason.NEVER_ARMED, time=11.5))
    assert tracking_light(lost).level is Level.UNKNOWN


def test_a_vehicle_that_oscillates_was_lost_or_had_a_motor_at_its_stop_without_a_hover_is_grounded():
    lost = Fact(Ending.CRASHED, time=20.0)
    stop = Fact(MotionEvent.MOTOR_AT_ITS_STOP, Level.WATCH, time=15.0, boot=0)
    caught = Fact(MotionEvent.ATTITUDE_CAUGHT, Level.WATCH)
    sound = evidence(HOVER.telemetry(), events=(caught,))
    touched = replace(sound, events=(caught, stop), ending=lost)
    assert not sound.grounds and touched.grounds == (lost,)
    assert replace(touched, condition=replace(sound.condition, hover=None)).grounds == (lost, stop)
    (found,) = oscillating(sound).grounds
    assert found.code is Override.OSCILLATION and found.figures["turn_rate"] < 1
    doubt = Fact(NoWind.STUCK, lean=0.5, duration=9.0)
    assert grounded_air((None, None, doubt)) == (None, None, doubt.grounded)
