"""Step responses: of loops that are known, and why there are none."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
from hover import Hover, asking, changed, only
from made_up_loop import made_up
from numpy.random import default_rng
from numpy.testing import assert_allclose
from partial_records import partial_record
from pytest import approx, mark
from scipy.signal import cont2discrete, freqz, lfilter, resample_poly

from mavdem.assessment.flights import settled_flight
from mavdem.dataset.segments import Segment
from mavdem.dataset.signals import Signals
from mavdem.facts.loops import StepResponseFact
from mavdem.ingest.vocabulary import IGNORE_ATTITUDE
from mavdem.loops import step_response
from mavdem.loops.attitude_response import predicted_attitude_response
from mavdem.loops.identified_step import predicted_step, step_from_frequency_response
from mavdem.loops.impulse_response import estimate_impulse_response
from mavdem.loops.step_response import (
    MAX_STEP_HALF_WIDTH,
    StepResponse,
    _Responses,
    _unseen_part,
    attitude_step_response,
    decimated_pieces,
    rate_step_response,
)
from mavdem.loops.welch import MIN_COHERENCE, welch_spectra_of_pieces

HOVER = Hover(hovering=60.0)
TIME = HOVER.stamps(200.0)
FREQUENCY = np.linspace(0.02, 95.0, 4000)


@mark.parametrize("decimation", [2, 7])
def test_samples_are_left_out_behind_the_low_pass_of_scipy(decimation):
    piece = default_rng(3).normal(size=(4, 1001)).cumsum(axis=1)
    (decimated,) = decimated_pieces([piece], decimation)
    expected = resample_poly(piece, 1, decimation, axis=1, padtype="line")
    assert_allclose(decimated, expected, atol=1e-12 * abs(piece).max())


@mark.parametrize("ahead", [False, True])
def test_an_attitude_whose_rate_is_asked_for_too_is_followed_at_once(ahead):
    """By an ideal rate loop, of which the attitude is the integral."""
    s = 2j * np.pi * FREQUENCY
    angle = 4.5
    attitude = Mock(frequency=FREQUENCY, closed_loop_of_estimate=angle / (s + angle))
    predicted_loop = Mock(attitude=attitude, controller=Mock(angle_gain=angle))
    assert_allclose(
        predicted_attitude_response(predicted_loop, has_feedforward=ahead),
        1.0 if ahead else angle / (s + angle),
    )


def loop(hertz=12.0, damping=0.25, frequency=FREQUENCY):
    """Coefficients at 200 Hz of ω² / (s² + 2 ζ ω s + ω²) of this frequency, and its response at others."""
    omega = 2 * np.pi * hertz
    continuous = [omega**2], [1, 2 * damping * omega, omega**2]
    (numerator,), denominator, _ = cont2discrete(continuous, 1 / 200)
    _, closed = freqz(numerator, denominator, frequency, fs=200)
    return numerator, denominator, closed


def steered(seed=1, slow_setpoint=0.9):
    """What a pilot asks for: noise below a few Hz."""
    values = default_rng(seed).standard_normal(len(TIME))
    return lfilter([1 - slow_setpoint], [1.0, -slow_setpoint], values)


def flight(rate, setpoint, angle=None, attitude_setpoint=None):
    """A hover at 200 Hz with a roll rate and its setpoint, (N,) rad/s, and an angle and its setpoint, rad."""
    roll = 0 * TIME if angle is None else angle
    telemetry = changed(HOVER.telemetry(200.0, 200.0), "ATTITUDE", rollspeed=rate, roll=roll)
    return asking(
        telemetry, TIME, 128 if attitude_setpoint is None else 0, setpoint, attitude_setpoint
    )


def measured(telemetry, response=rate_step_response):
    signals = Signals(telemetry)
    return response(signals, settled_flight(signals))


@mark.slow
@mark.parametrize("repeated", [slice(0), slice(3000, 5000)])
def test_a_resonance_is_measured_with_a_band_that_holds_it(repeated):
    """The step response of a resonant loop in wind is estimated from its setpoint.

    In one case, samples repeat for 10 s.
    """
    numerator, denominator, closed = loop()
    rate_setpoint = steered()
    gusts = 0.05 * lfilter([1.0], [1.0, -0.95], steered(2, slow_setpoint=0.0))
    rate = lfilter(numerator, denominator, rate_setpoint) + gusts
    rate[repeated] = rate_setpoint[repeated] = 0.1
    measured_step = measured(flight(rate, rate_setpoint))
    true_step = step_from_frequency_response(FREQUENCY, closed, measured_step.time)
    assert np.mean(abs(measured_step.step - true_step) <= measured_step.step_half) > 0.8
    assert measured_step.overshoot.value == approx(true_step.max() - 1, abs=0.03)
    peak = np.argmax(abs(closed))
    assert measured_step.peak.value == approx(abs(closed[peak]), rel=0.1)
    assert measured_step.peak_frequency.value == approx(FREQUENCY[peak], rel=0.05)
    assert measured_step.coherence > 0.8 and measured_step.max_frequency > 15
    assert measured_step.fact.code is StepResponseFact.STEP_MEASURED
    assert measured_step.comparison(FREQUENCY, closed).code is StepResponseFact.PREDICTION_AGREES
    slower = measured_step.comparison(FREQUENCY, loop(5.0)[2])
    assert slower.code is StepResponseFact.PREDICTION_DOUBTED and slower.figures["share"] > 0.5
    faster = measured_step.comparison(FREQUENCY, loop(90.0, damping=0.1)[2])
    assert faster.code is StepResponseFact.MEASUREMENT_DOUBTED


def body_yaw(setpoint, turn_by_tilt, angle_gain, *, has_feedforward):
    """Returns the angle that a loop yaws the body by, where tilting turns the heading besides, at 200 Hz."""
    feedforward = 200 * np.gradient(setpoint) if has_feedforward else np.zeros(len(setpoint))
    angles, angle, rate = [], 0.0, 0.0
    for wanted, turn, added in zip(setpoint, turn_by_tilt, feedforward, strict=True):
        # The rate follows its setpoint with a lag of 0.1 s.
        rate += 0.05 * (angle_gain * (wanted - angle - turn) + added - rate)
        angle += rate / 200
        angles.append(angle)
    return np.array(angles)


@mark.slow
@mark.parametrize("has_feedforward", [True, False])
def test_a_turn_of_the_heading_by_tilt_is_no_response_to_the_setpoint_of_yaw(has_feedforward):
    """Without it, the rest of the heading answers the rest of the setpoint as the loop does."""
    setpoint = 0.1 * lfilter([0.01], [1.0, -0.99], steered(5))[:4000]
    rate_by_tilt = 20 * np.gradient(np.roll(setpoint, 60))
    turn_by_tilt = np.cumsum(rate_by_tilt) / 200
    body = body_yaw(setpoint, turn_by_tilt, 2.0, has_feedforward=has_feedforward)
    piece = np.array([setpoint, body + turn_by_tilt, rate_by_tilt])
    gain = 2.0 if has_feedforward else None
    remaining_setpoint, remaining_angle = step_response._without_turn_by_tilt(piece, 200, gain)
    no_turn = np.zeros(len(setpoint))
    answer = body_yaw(remaining_setpoint, no_turn, 2.0, has_feedforward=has_feedforward)
    undisturbed = body_yaw(setpoint, no_turn, 2.0, has_feedforward=has_feedforward)
    assert remaining_angle == approx(body)
    assert (remaining_angle - answer).std() < 0.05 * (remaining_angle - undisturbed).std()


def test_a_setpoint_that_follows_the_heading_shows_no_response():
    """A loop lags its setpoint. ArduPilot before 3.4 moved the setpoint of the heading with the vehicle."""
    setpoint = 0.1 * lfilter([0.05], [1.0, -0.95], steered(5))[:4000]
    answer = body_yaw(setpoint, np.zeros(len(setpoint)), 2.0, has_feedforward=False)
    controller = step_response._AttitudeController(2.0, has_feedforward=False)

    def follows(setpoint, heading, controller=controller):
        """Returns whether the setpoint counts as following the heading."""
        spectra = welch_spectra_of_pieces(200, [np.array([setpoint, heading])])
        return step_response._setpoint_follows_angle(spectra, controller)

    assert not follows(setpoint, answer)
    # The heading moves by other causes, and the setpoint keeps near it.
    heading, error = setpoint, 0.1 * np.roll(setpoint, 2000)
    assert follows(heading + error, heading)
    assert not follows(heading + error, heading, controller._replace(has_feedforward=None))


@mark.slow
@mark.parametrize("is_corrected", [True, False])
def test_wind_that_the_attitude_controller_answers_does_not_bias_it(is_corrected):
    """The setpoint of the rate answers the wind, whether the log has that correction in it or not."""
    attitude_setpoint = 0.6 * lfilter([0.01], [1.0, -0.99], steered(3))
    ahead = 200 * np.gradient(attitude_setpoint)
    wind = 0.5 * lfilter([0.05], [1.0, -0.95], steered(4, slow_setpoint=0.0))
    frequency = np.fft.rfftfreq(len(TIME), 1 / 200)
    derivative_factor = 200 * (np.exp(2j * np.pi * frequency / 200) - 1)
    *_, closed = loop(frequency=frequency)
    rotation_spectrum = closed * np.fft.rfft(ahead + 4.5 * attitude_setpoint) + np.fft.rfft(wind)
    angle = np.fft.irfft(rotation_spectrum / (derivative_factor + 4.5 * closed), len(TIME))
    rate = 200 * (np.roll(angle, -1) - angle)
    rate_setpoint = ahead + 4.5 * (attitude_setpoint - angle)
    telemetry = flight(rate, rate_setpoint if is_corrected else ahead, angle, attitude_setpoint)
    measured_step = measured(telemetry)
    true_step = step_from_frequency_response(frequency[1:], closed[1:], measured_step.time)
    assert np.mean(abs(measured_step.step - true_step) <= measured_step.step_half) > 0.7
    assert measured_step.peak_frequency.value == approx(12.0, rel=0.1)
    outer = measured(telemetry, attitude_step_response)
    assert outer.loop == "attitude" and outer.step[-1] == approx(1.0, abs=0.1)


@mark.slow
def test_of_higher_gains_a_faster_step_with_more_overshoot_is_predicted():
    loops = [made_up(factor).rate for factor in (1.0, 2.0)]
    usual, high = (predicted_step(loop, 0.6) for loop in loops)
    # Reports need it of the same loop several times.
    assert predicted_step(loops[0], 0.6) is usual
    assert high.rise_time.value < usual.rise_time.value
    assert high.overshoot.value > usual.overshoot.value
    assert usual.rise_time.low <= usual.rise_time.value <= usual.rise_time.high


@mark.slow
@mark.parametrize("highest, is_doubtful", [(40.0, False), (0.5, True)])
def test_a_step_is_doubtful_where_the_setpoint_hardly_moves_at_its_frequencies(
    highest, is_doubtful
):
    """A lag of 30 ms has its corner at 5 Hz."""
    lag = 0.03
    time = np.linspace(0.0, 2.0, 201)
    responses = _Responses(time, 1 - np.exp(-time[None] / lag), np.empty(0), np.empty(0))
    estimate = Mock(
        values=np.zeros(1),
        frequency_responses=lambda _, hertz: 1 / (1 + 2j * np.pi * hertz[None] * lag),
    )
    unseen_part = _unseen_part(estimate, responses, highest)
    step = partial_record(
        StepResponse,
        axis="yaw",
        loop="attitude",
        is_identified=False,
        unseen_part=unseen_part,
        max_frequency=highest,
    )
    assert step.is_doubtful == is_doubtful
    if is_doubtful:
        assert step.fact.sentence.startswith(
            "The step of the yaw attitude is doubtful: the flight shows the response up to 0.5 Hz only"
        )


def test_a_step_response_begins_at_zero():
    numerator, denominator, _ = loop()
    rate_setpoint = steered()
    measured_step = measured(
        flight(
            lfilter(numerator, denominator, rate_setpoint) + steered(2, slow_setpoint=0.0) / 50,
            rate_setpoint,
        )
    )
    assert measured_step.time[0] == measured_step.step[0] == 0.0


@mark.slow
def test_a_rate_without_an_angle_setpoint_as_fast_is_measured_unless_it_lacks_a_correction():
    """PX4 logs the setpoint of the attitude at 20 Hz, and that of the rate, complete, at 50 Hz."""
    numerator, denominator, _ = loop(4.0)
    rate_setpoint = steered()
    rate = lfilter(numerator, denominator, rate_setpoint) + steered(2, slow_setpoint=0.0) / 50
    telemetry = flight(rate, rate_setpoint, 0 * TIME, steered(3))
    targets = telemetry.messages["ATTITUDE_TARGET"]
    is_slow = np.arange(len(targets["time"])) % 10 > 0
    mask = targets["type_mask"] + IGNORE_ATTITUDE * is_slow
    slow_angles = changed(telemetry, "ATTITUDE_TARGET", type_mask=mask)
    assert measured(slow_angles).code is StepResponseFact.TOO_SLOW
    px4 = replace(slow_angles, autopilot="PX4")
    assert measured(px4).peak_frequency.value == approx(4.0, rel=0.1)


@mark.slow
def test_a_slow_setpoint_does_not_show_a_fast_response():
    """Whatever follows at once looks the same: the band is too wide to be drawn."""
    rate_setpoint = lfilter([0.01], [1.0, -0.99], steered(1, slow_setpoint=0.97))
    noise = steered(2, slow_setpoint=0.0) / 2000
    measured_step = measured(flight(rate_setpoint + noise, rate_setpoint))
    assert measured_step.code is StepResponseFact.STEP_UNCERTAIN
    assert measured_step.figures["band_half_width"] >= MAX_STEP_HALF_WIDTH


@mark.slow
def test_pieces_too_short_for_a_window_give_no_step_response():
    """Each gap in the messages begins another piece; here a flight is nothing but pieces of 2.2 s."""
    pieces = [Segment(0, start, start + 2.2) for start in np.arange(12.0, 60.0, 3.0)]
    measured_step = rate_step_response(Signals(flight(steered(), steered())), pieces)
    assert measured_step.code is StepResponseFact.NO_RESPONSE_WINDOW


@mark.slow
def test_a_setpoint_that_moves_before_the_windows_only_gives_no_step_response():
    rate_setpoint = np.where(TIME < 12.8, steered(), 0.0)
    whole = Segment(0, 12.0, 60.0)
    measured_step = rate_step_response(Signals(flight(0 * TIME, rate_setpoint)), [whole])
    assert measured_step.code is StepResponseFact.NOT_COHERENT


@mark.slow
def test_nothing_is_estimated_without_setpoint_or_from_infinite_values():
    steps = np.floor(TIME)
    assert (
        estimate_impulse_response(20.0, [np.array([steps, 0 * steps])], 0.0, 0.5, 0.005) is not None
    )
    assert estimate_impulse_response(20.0, [np.array([0 * steps, steps])], 0.0, 0.5, 0.005) is None
    endless = np.where(TIME > 30.0, np.inf, steps)
    assert estimate_impulse_response(20.0, [np.array([steps, endless])], 0.0, 0.5, 0.005) is None


@mark.slow
def test_why_there_is_no_step_response(monkeypatch):
    """There is no setpoint, no excitation, a slow setpoint, no settled flight, or too much uncertainty."""
    rate = steered()
    without_setpoint = measured(HOVER.telemetry(200.0, 200.0))
    without_excitation = measured(flight(rate, 0 * rate))
    telemetry = flight(rate, rate)
    slow_setpoint = measured(
        only(telemetry, lambda time: np.isin(time, TIME[::10]), "ATTITUDE_TARGET")
    )
    without_flight = rate_step_response(Signals(telemetry), ())
    monkeypatch.setattr("mavdem.loops.step_response.coverage_factor", lambda: 1e6)
    uncertain_step = measured(telemetry)
    without_attitude_setpoint = measured(HOVER.telemetry(), attitude_step_response)
    assert without_setpoint.code is without_attitude_setpoint.code is StepResponseFact.NO_SETPOINT
    assert slow_setpoint.code is StepResponseFact.TOO_SLOW
    assert without_flight.code is StepResponseFact.TOO_LITTLE_FLIGHT
    assert without_excitation.code is StepResponseFact.TOO_LITTLE_ASKED
    assert without_excitation.figures["moving_duration"] == 0.0
    assert uncertain_step.code is StepResponseFact.STEP_UNCERTAIN
    monkeypatch.setattr("mavdem.loops.step_response.MAX_GAIN_DEVIATION", 0.0)
    assert measured(telemetry).code is StepResponseFact.GAIN_UNCERTAIN
    # The rate moves, but has nothing to do with its setpoint.
    unrelated = measured(flight(steered(2), rate))
    assert unrelated.code is StepResponseFact.NOT_COHERENT
    assert unrelated.figures["coherence"] < MIN_COHERENCE
