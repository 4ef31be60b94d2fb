"""ArduPilot's AutoTune and QuickTune as linear rules, to compare their gains with advised ones on simulated vehicles.

Both tune the true plant in calm air. Simplified: responses are linear and without noise; I follows P in the ratio of
the autopilot's defaults; filters stay as they are (QuickTune would set them by the gyro's); QuickTune's threshold of
the demand's slew rate is taken for the limit of stability; AutoTune tunes D of no axis whose D is 0, and not yaw's
error filter; a twitch is the step response of the rate loop, whose I is a tenth of P as during its tests.

Sources: ``AC_AutoTune_Multi.cpp`` and ``VTOL-quicktune.lua`` of https://github.com/ArduPilot/ardupilot.
"""

from typing import NamedTuple

import numpy as np

from mavdem.ingest.telemetry import Parameters
from mavdem.loops.axis_loops import Loop
from mavdem.loops.gain_design import ARDUPILOT_DEFAULTS, PX4_DEFAULTS
from mavdem.loops.identified_step import step_from_frequency_response

AGGRESSIVENESS = 0.075
"""AUTOTUNE_AGGR: bounce back, as a fraction of the largest rate, up to which D is raised."""
BACKOFF = 0.25
"""AUTOTUNE_GMBK: fraction by which AutoTune lowers rate P and D at the end; angle P is lowered by AGGR besides."""
TWITCH_STEP = 0.05
"""Fraction by which AutoTune changes a gain after a twitch; D is raised by twice that."""
PEAK_MARGIN = 0.2
"""Fraction of the target rate below which a peak is too small to judge D by (AUTOTUNE_D_UP_DOWN_MARGIN)."""
TESTING_INTEGRAL_RATIO = 0.1
"""I over P while AutoTune twitches, 1/s."""
MAX_TWITCHES = 120
"""Most twitches of one of AutoTune's steps: it gives up then."""
MAX_ANGLE_GAIN = 40.0
"""AutoTune's largest gain of the angle, 1/s (AUTOTUNE_SP_MAX)."""
TWITCH_SECONDS = 0.5
"""Length of a twitch of the rate, s."""
ANGLE_TWITCH_SECONDS = 1.5
"""Length of a twitch of the angle, s."""

QUICKTUNE_FACTOR = 0.4
"""Factor on the gain at which the vehicle oscillates: QUIK_GAIN_MARGIN is 60 %."""
MIN_GAIN_FACTOR = 0.8
"""Least factor on a gain in one run of QuickTune (QUIK_MAX_REDUCE is 20 %)."""
GAIN_GROWTH = 2 ** (1 / 8)
"""Factor between two gains that QuickTune is simulated at; it doubles a gain in 10 s."""
MAX_GROWTHS = 80
"""Most steps by ``GAIN_GROWTH``, together a factor of 1024: a loop that is stable beyond is not simulated further."""
MIN_PROPORTIONAL_FACTOR = 0.5
"""Least factor by which QuickTune lowers P together with D."""


class TunedGains(NamedTuple):
    """Gains that a rule ends with."""

    p: float
    """Rate P, in the unit of the parameter."""
    d: float
    """Rate D."""
    angle_gain: float
    """Gain of the attitude controller, 1/s."""


def _logged_gains(loop: Loop) -> TunedGains:
    """Returns the gains of a loop before it is tuned.

    Args:
        loop: the loops of an axis, whose controller has the logged parameters.
    """
    parameters = loop.controller.parameters
    names = loop.controller.parameter_names
    return TunedGains(
        p=parameters[names["p"]],
        d=parameters[names["d"]],
        angle_gain=parameters[names["angle_gain"]],
    )


def parameters_of(loop: Loop, gains: TunedGains, integral_ratio: float | None = None) -> Parameters:
    """Returns P, I, D and the angle's gain by the autopilot's parameter names; I follows from P.

    Args:
        loop: the loops, which give the autopilot and the axis.
        gains: P, D and the gain of the attitude controller.
        integral_ratio: ratio of I to P, 1/s; the autopilot's default unless given.
    """
    defaults = ARDUPILOT_DEFAULTS if loop.controller.is_ardupilot else PX4_DEFAULTS
    if integral_ratio is None:
        integral_ratio = defaults[loop.axis].ratios.integral
    names = loop.controller.parameter_names
    values = {
        "p": gains.p,
        "i": integral_ratio * gains.p,
        "d": gains.d,
        "angle_gain": gains.angle_gain,
    }
    return {names[field]: value for field, value in values.items()}


def quicktune(loop: Loop) -> Parameters:
    """Returns the gains after one run of QuickTune.

    It raises D until the vehicle oscillates, sets 0.4 times that value, and does the same with P. Where D becomes lower
    than it was, P is first lowered in the same ratio, by half at most. In all, one run lowers no gain below 0.8 times
    its value before the run.

    Args:
        loop: the loops of the true plant, with the gains before.

    Returns:
        The new gains by the autopilot's parameter names.
    """
    gains_before = _logged_gains(loop)
    least_p = MIN_GAIN_FACTOR * gains_before.p
    least_d = MIN_GAIN_FACTOR * gains_before.d
    gains = gains_before
    if gains_before.d:
        d = QUICKTUNE_FACTOR * _gain_at_oscillation(loop, gains, "d")
        ratio_of_d = min(d / gains_before.d, 1.0)
        p = gains_before.p * max(ratio_of_d, MIN_PROPORTIONAL_FACTOR)
        gains = gains._replace(d=max(d, least_d), p=max(p, least_p))
    p = QUICKTUNE_FACTOR * _gain_at_oscillation(loop, gains, "p")
    gains = gains._replace(p=max(p, least_p))
    return parameters_of(loop, gains)


def _gain_at_oscillation(loop: Loop, gains: TunedGains, raised_gain: str) -> float:
    """Raises one gain of the rate controller in small steps until the rate loop becomes unstable.

    Args:
        loop: rate and attitude loop of the true plant, with the controller that is tuned.
        gains: all gains, with the value to begin with.
        raised_gain: the gain to raise, "p" or "d".

    Returns:
        The first value, in the unit of the gain, with which the loop is unstable; after ``MAX_GROWTHS`` steps without
        one, the last value.
    """
    value: float = getattr(gains, raised_gain)
    for _ in range(MAX_GROWTHS):
        changed_gains = gains._replace(**{raised_gain: value})
        changed_loop = loop.with_parameters(parameters_of(loop, changed_gains))
        if not changed_loop.rate.is_stable:
            break
        value *= GAIN_GROWTH
    return value


def autotune(loop: Loop) -> Parameters:
    """Returns the gains after AutoTune: it tunes D, then P of the rate, lowers both, and tunes the gain of the angle.

    Each gain is tuned by twitches (steps of the setpoint) up to a limit of stability, and then lowered for a margin:
    AUTOTUNE_GMBK lowers all of them, and the gain of the angle is lowered by AUTOTUNE_AGGR besides.

    Args:
        loop: the loops of the true plant, with the gains before.

    Returns:
        The new gains by the autopilot's parameter names.
    """
    gains = _logged_gains(loop)
    if gains.d:
        gains = _tuned_derivative(loop, gains)
    gains = _tuned_proportional(loop, gains)
    gains = gains._replace(p=(1 - BACKOFF) * gains.p, d=(1 - BACKOFF) * gains.d)
    angle_gain = _tuned_angle_gain(loop, gains) * (1 - BACKOFF) * (1 - AGGRESSIVENESS)
    return parameters_of(loop, gains._replace(angle_gain=angle_gain))


class Twitch(NamedTuple):
    """The body rate in a twitch, AutoTune's test of gains: a step of the rate's setpoint, to the target rate."""

    peak: float
    """Largest rate, relative to the target rate."""
    bounce: float
    """Fall of the rate after the peak, as a fraction of the peak."""


def _rate_twitch(loop: Loop, gains: TunedGains) -> Twitch:
    """Simulates AutoTune's twitch of the rate: the response to a step of the rate's setpoint, relative to the step.

    Args:
        loop: rate and attitude loop of the true plant, with the controller that is tuned.
        gains: gains to test; I is small, as during AutoTune's tests.

    Returns:
        Peak of the response, and its fall after the peak.
    """
    tested_loop = loop.with_parameters(parameters_of(loop, gains, TESTING_INTEGRAL_RATIO))
    rate = tested_loop.rate
    if not rate.is_stable:
        # Its response has no peak: it counts as one of twice the step, from which the rate falls to 0.
        return Twitch(peak=2.0, bounce=1.0)
    time = np.linspace(0.01, TWITCH_SECONDS, 50)
    response = step_from_frequency_response(rate.frequency, rate.closed_loop_of_estimate, time)
    peak_sample = int(response.argmax())
    peak = float(response[peak_sample])
    lowest_after_peak = float(response[peak_sample:].min())
    return Twitch(peak, (peak - lowest_after_peak) / peak)


def _tuned_derivative(loop: Loop, gains: TunedGains) -> TunedGains:
    """Returns the gains after AutoTune's steps "D up" and "D down".

    In the first step D is raised until the rate bounces back after a twitch, and in the second one it is lowered until
    it does not. Meanwhile P is adjusted so that the peak stays just below the target rate, where the bounce is judged.

    Args:
        loop: rate and attitude loop of the true plant, with the controller that is tuned.
        gains: P, D and angle gain to begin with.

    Returns:
        The gains with the tuned P and D; the others are unchanged.
    """
    for is_raised in (True, False):
        for _ in range(MAX_TWITCHES):
            twitch = _rate_twitch(loop, gains)
            if twitch.peak > 1:
                gains = gains._replace(p=gains.p * (1 - TWITCH_STEP))
            elif twitch.peak < 1 - PEAK_MARGIN:
                gains = gains._replace(p=gains.p * (1 + TWITCH_STEP))
            elif is_raised and twitch.bounce < AGGRESSIVENESS:
                gains = gains._replace(d=gains.d * (1 + 2 * TWITCH_STEP))
            elif not is_raised and twitch.bounce > AGGRESSIVENESS:
                gains = gains._replace(d=gains.d * (1 - TWITCH_STEP))
            else:
                break
    return gains


def _tuned_proportional(loop: Loop, gains: TunedGains) -> TunedGains:
    """Returns the gains after AutoTune's step "P up": P is raised until the rate exceeds its target.

    The rate may exceed the target by half of AUTOTUNE_AGGR. Where it bounces back too far before it has reached the
    target, P and D are both lowered.

    Args:
        loop: rate and attitude loop of the true plant, with the controller that is tuned.
        gains: P, D and angle gain to begin with.

    Returns:
        The gains with the last P and D.
    """
    for _ in range(MAX_TWITCHES):
        twitch = _rate_twitch(loop, gains)
        if twitch.peak > 1 + AGGRESSIVENESS / 2:
            break
        # A lower peak is too small to judge the bounce by.
        almost_reaches_target = 1 - PEAK_MARGIN < twitch.peak < 1
        if almost_reaches_target and twitch.bounce > AGGRESSIVENESS and gains.d:
            gains = gains._replace(p=gains.p * (1 - TWITCH_STEP), d=gains.d * (1 - TWITCH_STEP))
        else:
            gains = gains._replace(p=gains.p * (1 + TWITCH_STEP))
    return gains


def _tuned_angle_gain(loop: Loop, gains: TunedGains) -> float:
    """Returns the gain of the attitude controller, 1/s, after AutoTune's steps "angle P down" and "angle P up".

    The gain is first lowered while the step response of the angle overshoots by more than half of AUTOTUNE_AGGR, and
    then raised until it does.

    Args:
        loop: rate and attitude loop of the true plant, with the controller that is tuned.
        gains: gains of the rate controller, and the gain of the angle to begin with.
    """
    for _ in range(MAX_TWITCHES):
        if not _angle_overshoots(loop, gains):
            break
        gains = gains._replace(angle_gain=gains.angle_gain * (1 - TWITCH_STEP))
    for _ in range(MAX_TWITCHES):
        if _angle_overshoots(loop, gains) or gains.angle_gain >= MAX_ANGLE_GAIN:
            break
        gains = gains._replace(angle_gain=gains.angle_gain * (1 + TWITCH_STEP))
    return gains.angle_gain


def _angle_overshoots(loop: Loop, gains: TunedGains) -> bool:
    """Returns whether the angle overshoots a step of its setpoint by too much, or its loop is unstable.

    Args:
        loop: rate and attitude loop of the true plant, with the controller that is tuned.
        gains: gains to test; I is small, as during AutoTune's tests.
    """
    tested_loop = loop.with_parameters(parameters_of(loop, gains, TESTING_INTEGRAL_RATIO))
    attitude = tested_loop.attitude
    if not attitude.is_stable:
        return True
    time = np.linspace(0.05, ANGLE_TWITCH_SECONDS, 30)
    response = step_from_frequency_response(
        attitude.frequency, attitude.closed_loop_of_estimate, time
    )
    return bool(response.max() > 1 + AGGRESSIVENESS / 2)
