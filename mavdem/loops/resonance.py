"""Resonance of a rate loop: in the response of the body rate to its setpoint, or in the rate's own spectrum.

The response from setpoint r to rate p is estimated as T = S_rp / S_rr by Welch's method. Where the wind and not the
pilot moves the vehicle, the setpoint only responds to the rate through the attitude controller, r = −K p / s, and the
estimate would be −s / K however coherent both are. So frequencies are left out at which x = r + K p / s, the command of
pilot or navigation, has less than half of the power of r.

With the known controller C_r from the setpoint and C_p from the rate, L / (1 + L) = T C_p / C_r is the complementary
sensitivity without the controller's filters, and S = 1 − L / (1 + L) the sensitivity.
"""

from dataclasses import dataclass

import numpy as np

from mavdem.arrays import Array, Indices
from mavdem.confidence import Interval
from mavdem.dataset.segments import Segments
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.loops.controllers import Controller, controller_from_parameters
from mavdem.loops.margins import HALF_POWER_GAIN, Complex, controller_response
from mavdem.loops.welch import (
    MIN_COHERENCE,
    WelchSpectra,
    relative_half_width,
    welch_spectra,
)

MAX_LOOP_FREQUENCY = 40.0
"""Frequency that separates loops and rotors, Hz.

Rate loops of multirotors cross over below it, most at several Hz to half of it; rotors turn faster.
"""
MAX_FREQUENCY_RATIO = 0.8
"""Highest frequency, relative to half the sampling rate: above, interpolation has lost a fifth of the power."""

DEFAULT_ANGLE_GAIN = 4.5
"""Gain of the attitude controller if the log has none, 1/s: ArduCopter's default. PX4's is 6.5."""
MIN_RESPONSE_FREQUENCY = 1.0
"""Lowest frequency of the response, Hz: below it, the vehicle is moved from place to place."""
MIN_BAND_RATIO = 2.0
"""Least ratio of the highest and the lowest frequency of the response, without a gap between them: a choice."""
MIN_SETPOINT_SHARE = 0.5
"""Least power of the command of pilot or navigation, relative to the setpoint's power: a choice."""
MAX_LOWEST_GAIN = 2.0
"""|T| at the lowest frequency beyond which something else than the setpoint moves the rate.

An example is the setpoint of a heading that is only held.
"""

MIN_PEAK_FREQUENCY = 6.0
"""Lowest frequency of peaks of the rate's own spectrum, Hz: below it, pilots steer, also by sines, and wind pushes."""
MIN_PEAK_RATIO = 3.0
"""Least ratio of a peak to its background. A maximum sensitivity of 2.3 makes at most 2.5, one of 4.9 at least 5."""
BACKGROUND_RATIO = 1.5
"""The background of a peak is a straight line between frequencies so many times lower and higher: a choice."""


@dataclass(frozen=True)
class Resonance:
    """A resonance of one axis: a peak of the body rate's response to its setpoint, or of its spectrum."""

    axis: str
    """"roll", "pitch" or "yaw"."""
    peak: float
    """The largest |T|; or, without a setpoint, the peak of the spectrum over its background, about the sensitivity."""
    frequency: float
    """Frequency of the peak, Hz."""
    coherence: float
    """Coherence of the rate with its setpoint, or with the motors, at the peak."""
    max_frequency: float
    """Highest frequency at which a peak was looked for, Hz."""
    ms_interval: Interval | None = None
    """The 90 % interval of the maximum sensitivity; ``None`` without setpoint."""
    ms_frequency: float | None = None
    """Frequency of the maximum sensitivity, Hz, mostly above that of the peak of |T|; ``None`` without setpoint."""
    ms_coherence: float | None = None
    """Coherence of the rate with its setpoint there."""
    rolls_off: bool = False
    """Whether the response falls below −3 dB at the highest frequency, after it was above."""


def controller_or_reason(signals: Signals) -> Controller | Fact:
    """Returns the controller of an axis by the parameters in the log, without the mixer.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.

    Returns:
        The controller, whose output is the demand. If the log lacks its parameters, or no known autopilot has such
        parameters, the fact (coded finding) that says so.
    """
    no_mixer = (1.0,)
    try:
        return controller_from_parameters(signals.telemetry.parameters, signals.axis, no_mixer)
    except NotLearnable as error:
        return error.fact


def controller_if_known(signals: Signals) -> Controller | None:
    """Returns the controller of an axis as :func:`controller_or_reason` does, and None if it is not known."""
    controller = controller_or_reason(signals)
    return None if isinstance(controller, Fact) else controller


def setpoint_resonance(signals: Signals, segments: Segments) -> Resonance | None:
    """Returns the largest response |T| of the body rate to its setpoint, with the maximum sensitivity it implies.

    T is measured only at frequencies at which pilot or navigation move the rate. These must be one band without a gap,
    which begins at ``MIN_RESPONSE_FREQUENCY`` or above and whose highest frequency is at least ``MIN_BAND_RATIO`` times
    the lowest; a narrower band does not show a peak. If the controller is not known, T is assumed to be the
    complementary sensitivity.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        segments: segments of the flight to use.

    Returns:
        The resonance; ``None`` if there are no setpoints, messages are slower than ``MIN_STREAM_RATE``, or too
        little of the rate follows the setpoint.
    """
    if signals.rate_and_setpoint is None:
        return None
    rate, setpoint = signals.rate_and_setpoint
    spectra = welch_spectra((setpoint, rate), segments)
    if spectra is None:
        return None
    # The controller's integral divides by the frequency, which is 0 in the first row.
    frequency = np.maximum(spectra.frequency, spectra.frequency[1])
    angle_gain = DEFAULT_ANGLE_GAIN
    complementary = spectra.response
    controller = controller_if_known(signals)
    if controller is not None:
        angle_gain = controller.angle_gain
        demand_from_setpoint, demand_from_rate = controller_response(controller, frequency)
        complementary = spectra.response * demand_from_rate / demand_from_setpoint
    rows = _steered_rows(spectra, frequency, angle_gain)
    gain = abs(spectra.response[rows])
    if len(rows) == 0 or frequency[rows[-1]] < MIN_BAND_RATIO * frequency[rows[0]]:
        return None
    # At low frequencies a rate follows its setpoint. If it moves much more, it has another cause.
    if gain[0] > MAX_LOWEST_GAIN:
        return None
    peak_row = rows[np.argmax(gain)]
    complementary_gain = abs(complementary[rows])
    ms_row = rows[np.argmax(abs(1 - complementary[rows]))]
    return Resonance(
        axis=signals.axis,
        peak=abs(spectra.response[peak_row]),
        frequency=frequency[peak_row],
        coherence=spectra.coherence[peak_row],
        max_frequency=frequency[rows[-1]],
        ms_interval=_max_sensitivity_interval(spectra, complementary, rows),
        ms_frequency=frequency[ms_row],
        ms_coherence=spectra.coherence[ms_row],
        rolls_off=complementary_gain.max() > HALF_POWER_GAIN > complementary_gain[-1],
    )


def _steered_rows(spectra: WelchSpectra, frequency: Array, angle_gain: float) -> Indices:
    """Returns the widest band of frequencies in which pilot or navigation, and not the wind, cause the rate setpoint.

    Only there a response of the rate to its setpoint shows the rate loop. The attitude controller computes the rate
    setpoint r = x − K p / s from the command x of pilot or navigation, and from the angle p / s. So r also changes with
    the wind, which rotates the vehicle. The commanded fraction is the power of x = r + K p / s relative to that of r.
    With the response T from r to the rate p, the part of p that is coherent with r contributes |1 + K T / s|² to this
    fraction. The rest of p contributes |K / s|² times the ratio of its power to the power of r.

    Args:
        spectra: cross-spectra of the setpoint r (index 0) and the rate p (index 1).
        frequency: (F,) frequencies, Hz, all positive.
        angle_gain: gain K of the attitude controller, 1/s.

    Returns:
        Indices (band,) of the consecutive frequencies of the band that spans most octaves; empty if there is no band.
    """
    angle_feedback = angle_gain / (2j * np.pi * frequency)
    commanded_by_response = abs(1 + angle_feedback * spectra.response) ** 2
    # In the ratio S_pp / S_rr, |T|² follows the setpoint; the rest is incoherent with it.
    rate_per_setpoint_power = spectra.power[1, 1].real / spectra.driver_power
    incoherent_power = rate_per_setpoint_power - abs(spectra.response) ** 2
    commanded_fraction = commanded_by_response + abs(angle_feedback) ** 2 * incoherent_power
    is_steered = (spectra.coherence >= MIN_COHERENCE) & (commanded_fraction >= MIN_SETPOINT_SHARE)
    is_steered &= frequency >= MIN_RESPONSE_FREQUENCY
    is_steered &= frequency <= MAX_FREQUENCY_RATIO * frequency[-1]
    steered_rows = np.flatnonzero(is_steered)
    # A band begins where a row does not follow the row before it.
    band_starts = np.flatnonzero(np.diff(steered_rows) > 1) + 1
    bands = [band for band in np.split(steered_rows, band_starts) if len(band)]
    return max(
        bands, key=lambda band: frequency[band[-1]] / frequency[band[0]], default=steered_rows
    )


def _max_sensitivity_interval(
    spectra: WelchSpectra, complementary: Complex, rows: Indices
) -> Interval:
    """Returns the 90 % interval of the maximum sensitivity Ms = max |1 − T| over some frequencies.

    The error of the sensitivity 1 − T is at most the error of T (:func:`relative_half_width`).

    Args:
        spectra: cross-spectra of setpoint and rate, for their coherence and the number of windows.
        complementary: complementary sensitivity T at the F frequencies of the spectra (F,).
        rows: indices (rows,) of the frequencies that are used.

    Returns:
        Lower and upper end of the interval, without a unit.
    """
    coherence = spectra.coherence[rows]
    sensitivity = abs(1 - complementary[rows])
    half_width = relative_half_width(coherence, spectra.windows) * abs(complementary[rows])
    return (sensitivity - half_width).max(), (sensitivity + half_width).max()


def spectral_resonance(signals: Signals, segments: Segments) -> Resonance | None:
    """Returns the highest peak of the rate's own spectrum over its background, if the motors' command has it too.

    On logarithmic scales, the spectrum of wind, noise and plant is nearly a straight line, and the loop multiplies it
    by its sensitivity. So the height of a peak above a straight line is about the maximum sensitivity.

    The background at a frequency f is the mean of the logarithms at f · ``BACKGROUND_RATIO`` and f /
    ``BACKGROUND_RATIO``, which is a straight line on these scales. The spectrum is the median over windows, which
    short steering does not change.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        segments: segments of the flight to use.

    Returns:
        The resonance; ``None`` if messages are slower than ``MIN_STREAM_RATE``, nothing exceeds the background by
        ``MIN_PEAK_RATIO``, or the rate is not coherent with the motors' command at the peak.
    """
    attitude = signals.attitude
    inputs = signals.model_inputs
    if attitude is None or inputs is None:
        return None
    mixer_row = inputs.geometry.mixer_row(signals.axis)
    command = inputs.outputs[:, 0] if mixer_row is None else inputs.outputs @ mixer_row
    command_series = TimeSeries(inputs.time, inputs.boot, command)
    spectra = welch_spectra((command_series, attitude.rate_series), segments)
    if spectra is None or not spectra.median_output_power.all():
        return None
    frequency = spectra.frequency
    max_frequency = min(MAX_FREQUENCY_RATIO * frequency[-1], MAX_LOOP_FREQUENCY)
    is_in_band = frequency >= MIN_PEAK_FREQUENCY
    is_in_band &= frequency <= max_frequency / BACKGROUND_RATIO
    rows_in_band = np.flatnonzero(is_in_band)
    if len(rows_in_band) == 0:
        return None
    # A sensitivity is a ratio of amplitudes, and the logarithm of an amplitude is half of the logarithm of its power.
    log_amplitude = np.log(spectra.median_output_power) / 2
    log_amplitude_above = np.interp(
        frequency[rows_in_band] * BACKGROUND_RATIO, frequency, log_amplitude
    )
    log_amplitude_below = np.interp(
        frequency[rows_in_band] / BACKGROUND_RATIO, frequency, log_amplitude
    )
    background = (log_amplitude_above + log_amplitude_below) / 2
    peak_ratio = np.exp(log_amplitude[rows_in_band] - background)
    highest = np.argmax(peak_ratio)
    coherence = spectra.coherence[rows_in_band[highest]]
    if not (peak_ratio[highest] >= MIN_PEAK_RATIO and coherence >= MIN_COHERENCE):
        return None
    return Resonance(
        axis=signals.axis,
        peak=peak_ratio[highest],
        frequency=frequency[rows_in_band[highest]],
        coherence=coherence,
        max_frequency=max_frequency,
    )
