"""ArduPilot's rate and attitude controller of one axis, read from the autopilot's parameters.

Sources: ``AC_PID``, ``AP_NotchFilter_params``, ``AP_MotorsMatrix``, ``Thrust_Linearization``, ``NotchFilter`` and
``HarmonicNotchFilter`` of https://github.com/ArduPilot/ardupilot.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from math import sqrt

import numpy as np

from mavdem.containers import Numbers
from mavdem.errors import NotLearnable
from mavdem.facts.loops import ControllerFact
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.autopilot_parameters import (
    DEFAULT_LOOP_RATES,
    LOOP_RATE_PARAMETERS,
    MIN_LOOP_RATE,
    MOTOR_COUNT,
    ControllerFields,
    GainNames,
    Notch,
    required_parameters,
)

AXIS_ABBREVIATIONS = {"roll": "RLL", "pitch": "PIT", "yaw": "YAW"}
"""Abbreviations of the axes in names of parameters, as in ``ATC_RAT_RLL_P``."""
GYRO_NOTCH_PREFIXES = ("INS_HNTCH_", "INS_HNTC2_", "INS_HNTC3_", "INS_NOTCH_")
"""Beginnings of the parameters of each notch filter of the gyro; ``INS_NOTCH_`` is from before ArduPilot 4.2."""

QUAD_FRAME_CLASS = 1.0
"""``FRAME_CLASS`` of a quadrotor."""
GAIN_SCALE_BEFORE_34 = 1.27
"""Factor from rate gains before ArduCopter 3.4 to those since (``convert_pid_parameters`` in its ``Parameters.cpp``).

The older gains were for rates in 0.01 °/s, and a full demand of 4500.
"""
X_GAIN_SCALE_BEFORE_34 = 0.9
"""The same for an X, V or H frame, whose mixer gave a motor √2 times less of a demand than it does now."""
X_FRAMES_BEFORE_34 = (1.0, 2.0, 3.0)
"""Values of ``FRAME`` for an X, V and H frame before ArduCopter 3.4."""

GYRO_RATE_BASE = 1000.0
"""Rate at which gyro samples are filtered with ``INS_GYRO_RATE`` 0, Hz; each step of that parameter doubles it."""
MAX_GYRO_RATE_EXPONENT = 3.0
"""The largest ``INS_GYRO_RATE``, for 8 kHz."""

MIN_CENTER_PER_BANDWIDTH = 0.52
"""Least centre of a harmonic notch over its bandwidth (``bandwidth_limit`` in ``HarmonicNotchFilter::init``)."""
MULTI_SOURCE_OPTION = 1 << 1
"""Bit of ``INS_HNTCH_OPTS``: each motor, or each peak of the spectrum, has its own notches."""
SPECTRUM_PEAKS = 3
"""Peaks of the in-flight FFT that a multi-source notch follows."""
MAX_HARMONICS = 16
"""Bits of the masks ``INS_HNTCH_HMNCS`` and ``FILTn_NOTCH_HMNC`` that mean multiples of the centre."""
MIN_PID_NOTCH_QUALITY = 0.5
"""``AP_NotchFilter_params`` switches a notch off whose ``FILTn_NOTCH_Q`` is not above this."""


class NotchMode(IntEnum):
    """``INS_HNTCH_MODE``: what the centre of a harmonic notch follows."""

    FIXED = 0
    THROTTLE = 1
    RPM_SENSOR = 2
    ESC_TELEMETRY = 3
    SPECTRUM = 4


@dataclass(frozen=True)
class _RateParameters:
    """Names of one axis' parameters, which depend on the version of the firmware."""

    prefix: str
    """Beginning of the parameters of the rate controller."""
    names: dict[str, str]
    """Name of the parameter by the field of :class:`mavdem.loops.controllers.Controller` that it sets."""
    is_before_3_4: bool
    """Whether these are the names and units of before ArduCopter 3.4."""


def ardupilot_controller(
    parameters: Parameters, axis: str, motor_weights: Numbers
) -> ControllerFields:
    """Returns the fields of a :class:`mavdem.loops.controllers.Controller` with ArduPilot's parameters.

    Args:
        parameters: values of the ``CONTROL_PARAMETERS`` by the autopilot's names.
        axis: "roll", "pitch" or "yaw".
        motor_weights: weights of the motors' thrusts in the torque about the axis (4,), of any scale; or a single one
            if the outputs are the demand itself, so that no mixer is needed.

    Returns:
        Values of the controller's fields by name.

    Raises:
        NotLearnable: a parameter is missing, or the mixer is not a quadrotor's.
    """
    rate = _rate_parameters(parameters, axis)
    gain_values = required_parameters(parameters, *rate.names.values())
    gains = dict(zip(rate.names, gain_values, strict=True))
    has_mixer = len(motor_weights) != 1
    if rate.is_before_3_4:
        gain_scale = GAIN_SCALE_BEFORE_34
        if has_mixer and parameters.get("FRAME") in X_FRAMES_BEFORE_34:
            gain_scale = X_GAIN_SCALE_BEFORE_34
        for gain in ("p", "i", "d"):
            gains[gain] = gain_scale * gains[gain]
    # The exponent is limited, since a corrupt one would give an absurd rate.
    gyro_rate_exponent = np.clip(parameters.get("INS_GYRO_RATE", 0.0), 0.0, MAX_GYRO_RATE_EXPONENT)
    loop_rate = parameters.get(LOOP_RATE_PARAMETERS["ardupilot"], DEFAULT_LOOP_RATES["ardupilot"])
    gyro_notches: list[Notch] = []
    for prefix in GYRO_NOTCH_PREFIXES:
        gyro_notches += _gyro_notches(parameters, prefix)
    fields: ControllerFields = {
        "parameter_names": rate.names,
        **gains,
        "ff": parameters.get(f"{rate.prefix}FF", 0.0),
        "gyro_filter": parameters.get("INS_GYRO_FILTER", 0.0),
        "gyro_rate": GYRO_RATE_BASE * 2**gyro_rate_exponent,
        "notches": tuple(gyro_notches),
        "derivative_ff": parameters.get(f"{rate.prefix}D_FF", 0.0),
        "target_notches": tuple(_pid_notches(parameters, f"{rate.prefix}NTF")),
        "error_notches": tuple(_pid_notches(parameters, f"{rate.prefix}NEF")),
        "derivative_of_error": True,
        "loop_period": 1 / max(loop_rate, MIN_LOOP_RATE),
        "mixer": (1.0,),
    }
    if has_mixer:
        spin_min, spin_max = _spin_range(parameters, is_before_3_4=rate.is_before_3_4)
        if len(motor_weights) != MOTOR_COUNT or not any(motor_weights) or not spin_min < spin_max:
            raise _unknown_mixer(parameters)
        # AP_MotorsMatrix normalises the largest factor of an axis to a half.
        largest_weight = max(map(abs, motor_weights))
        fields["mixer"] = tuple(weight / largest_weight / 2 for weight in motor_weights)
        fields["spin_range"] = (spin_min, spin_max)
    return fields


def ardupilot_gain_names(parameters: Parameters, axis: str) -> GainNames:
    """Returns how ArduCopter names the gains of one axis: by "ATC_RAT_RLL_…" and "ATC_ANG_RLL_P", or as before 3.4.

    Args:
        parameters: parameters of the log, by name, which show the version of the firmware.
        axis: "roll", "pitch" or "yaw".
    """
    rate = _rate_parameters(parameters, axis)
    return GainNames(rate_prefix=rate.prefix, angle_gain=rate.names["angle_gain"])


def _rate_parameters(parameters: Parameters, axis: str) -> _RateParameters:
    """Returns the names that the parameters of one axis have in the firmware of the log.

    Before ArduCopter 3.4 gains had other names and units; before 4.0 there was one filter instead of three.

    Args:
        parameters: parameters of the log, by name, which show the version of the firmware.
        axis: "roll", "pitch" or "yaw".

    Returns:
        The prefix of the rate controller's parameters, names by field of the controller, and whether the firmware is
        older than 3.4.
    """
    abbreviation = AXIS_ABBREVIATIONS[axis]
    prefix = f"ATC_RAT_{abbreviation}_"
    angle_gain = f"ATC_ANG_{abbreviation}_P"
    is_before_3_4 = f"{prefix}P" not in parameters and f"RATE_{abbreviation}_P" in parameters
    if is_before_3_4:
        prefix = f"RATE_{abbreviation}_"
        angle_gain = f"STB_{abbreviation}_P"
        filters = {"error_filter": "FILT_HZ"}
    elif f"{prefix}FILT" in parameters:
        # Before ArduCopter 4.0 there was one filter, of the error.
        filters = {"error_filter": "FILT"}
    else:
        filters = {"target_filter": "FLTT", "error_filter": "FLTE", "derivative_filter": "FLTD"}
    names = {"p": f"{prefix}P", "i": f"{prefix}I", "d": f"{prefix}D", "angle_gain": angle_gain}
    for field, ending in filters.items():
        names[field] = prefix + ending
    names["thrust_expo"] = "MOT_THST_EXPO"
    return _RateParameters(prefix, names, is_before_3_4)


def _spin_range(parameters: Parameters, *, is_before_3_4: bool) -> tuple[float, float]:
    """Returns the range of the motor outputs in which the propellers give thrust.

    Args:
        parameters: parameters of the log, by name.
        is_before_3_4: whether the parameters belong to a firmware before ArduCopter 3.4.

    Returns:
        Beginning and end of thrust, as fractions of the range of the output.

    Raises:
        NotLearnable: a parameter is missing, or the frame is not a quadrotor.
    """
    if is_before_3_4:
        # This firmware had no FRAME_CLASS: there was a separate build for quadrotors. THR_MIN is in thousandths.
        throttle_min, spin_max = required_parameters(parameters, "THR_MIN", "MOT_THST_MAX")
        return throttle_min / 1000, spin_max
    spin_min, spin_max = required_parameters(parameters, "MOT_SPIN_MIN", "MOT_SPIN_MAX")
    if _is_frame_compiled_in(parameters):
        # There is no parameter of the frame class. The log has four motors, so that the frame is a quadrotor.
        return spin_min, spin_max
    (frame_class,) = required_parameters(parameters, "FRAME_CLASS")
    if frame_class != QUAD_FRAME_CLASS:
        raise _unknown_mixer(parameters)
    return spin_min, spin_max


def _is_frame_compiled_in(parameters: Parameters) -> bool:
    """Returns whether the firmware is one before ArduCopter 3.5, which was built for one class of frames.

    Args:
        parameters: parameters of the log, by name.
    """
    return "FRAME_CLASS" not in parameters and "FRAME" in parameters


def _unknown_mixer(parameters: Parameters) -> NotLearnable:
    """Returns the error that the mixer is not known, with the parameters of this firmware that say which frame it is.

    Args:
        parameters: parameters of the log, by name.
    """
    names = ["FRAME"] if _is_frame_compiled_in(parameters) else ["FRAME_CLASS", "FRAME_TYPE"]
    return NotLearnable(ControllerFact.MIXER_UNKNOWN, autopilot="ardupilot", names=names)


def _gyro_notches(parameters: Parameters, prefix: str) -> Iterator[Notch]:
    """Yields the notches of one harmonic notch filter of the gyro, if it is enabled (``HarmonicNotchFilter``).

    The centre of the filter is at ``FREQ``. If it follows the throttle, its centre in hover is used (see
    :func:`hover_center_ratio`). If it follows a measurement, its lowest centre is used, at which it costs most phase. A
    double or triple notch (``OPTS``) is modelled as a single one: at a quarter of the centre their phases differ by at
    most 3°. The filter may have a notch for each motor, or for each peak of a spectrum, here all with the same centre.

    Args:
        parameters: parameters of the log, by name.
        prefix: beginning of the names of the filter's parameters, such as "INS_HNTCH_".

    Yields:
        Each harmonic as often as the filter has sources; nothing if the filter is disabled.
    """
    if not parameters.get(f"{prefix}ENABLE"):
        return
    frequency, bandwidth, attenuation = required_parameters(
        parameters, f"{prefix}FREQ", f"{prefix}BW", f"{prefix}ATT"
    )
    # ArduPilot raises a centre that is too low for the bandwidth.
    configured_center = max(frequency, MIN_CENTER_PER_BANDWIDTH * bandwidth)
    if configured_center <= 0:
        return
    center_in_hover = configured_center * hover_center_ratio(parameters, prefix)
    harmonics = int(parameters.get(f"{prefix}HMNCS", 1.0))
    relative_bandwidth = bandwidth / configured_center
    for notch in harmonic_notches(center_in_hover, relative_bandwidth, attenuation, harmonics):
        for _ in range(notch_source_count(parameters, prefix)):
            yield notch


def hover_center_ratio(parameters: Parameters, prefix: str) -> float:
    """Returns the centre frequency of a harmonic notch in hover, relative to its parameter ``FREQ``.

    A notch that follows the throttle has the frequency ``FREQ`` at the throttle ``REF``. At another throttle it is
    higher by the square root of their ratio, as the speed of the motors is, but never below ``FM_RAT`` times ``FREQ``
    (``AP_Vehicle::update_throttle_notch``). Other notches are assumed to be at ``FREQ``.

    Args:
        parameters: parameters of the log, by name.
        prefix: beginning of the names of the filter's parameters, such as "INS_HNTCH_".

    Returns:
        The ratio, without a unit; 1 if the notch does not follow the throttle.
    """
    reference_throttle = parameters.get(f"{prefix}REF", 0.0)
    follows_throttle = parameters.get(f"{prefix}MODE", 0.0) == NotchMode.THROTTLE
    if not follows_throttle or reference_throttle <= 0:
        return 1.0
    hover_throttle = parameters.get("MOT_THST_HOVER", reference_throttle)
    throttle_ratio = max(hover_throttle / reference_throttle, 0.0)
    least_ratio = parameters.get(f"{prefix}FM_RAT", 1.0)
    return max(least_ratio, sqrt(throttle_ratio))


def notch_source_count(parameters: Parameters, prefix: str) -> int:
    """Counts the notches that a harmonic notch filter has at each harmonic: one for each source that it follows.

    With the option ``MULTI_SOURCE_OPTION`` the sources are the motors, whose speeds the ESCs report, or the highest
    peaks of the spectrum. Otherwise there is a single one.

    Args:
        parameters: parameters of the log, by name.
        prefix: beginning of the names of the filter's parameters, such as "INS_HNTCH_".

    Returns:
        The number, at least 1.
    """
    options = int(parameters.get(f"{prefix}OPTS", 0.0))
    mode = parameters.get(f"{prefix}MODE", 0.0)
    has_one_source = not options & MULTI_SOURCE_OPTION
    if has_one_source:
        return 1
    if mode == NotchMode.ESC_TELEMETRY:
        return MOTOR_COUNT
    if mode == NotchMode.SPECTRUM:
        return SPECTRUM_PEAKS
    return 1


def _pid_notches(parameters: Parameters, name: str) -> Iterator[Notch]:
    """Yields the notches that ``AC_PID`` applies to its target or its error (``AP_NotchFilter_params``).

    A parameter of the axis has the number n of its filter, whose own parameters begin with ``FILTn_``. A filter that
    ArduPilot does not switch on, because it has no depth, or a quality of ``MIN_PID_NOTCH_QUALITY`` or less, has no
    notches.

    Args:
        parameters: parameters of the log, by name.
        name: name of the parameter with the number, such as ``ATC_RAT_RLL_NEF``, which is 0 for no filter.

    Yields:
        One notch for each harmonic.
    """
    number = int(parameters.get(name, 0.0))
    prefix = f"FILT{number}_"
    if not number or parameters.get(f"{prefix}TYPE") == 0:
        return
    frequency, quality, attenuation = required_parameters(
        parameters, f"{prefix}NOTCH_FREQ", f"{prefix}NOTCH_Q", f"{prefix}NOTCH_ATT"
    )
    if frequency and attenuation and quality > MIN_PID_NOTCH_QUALITY:
        harmonics = int(parameters.get(f"{prefix}NOTCH_HMNC", 1.0))
        yield from harmonic_notches(frequency, 1 / quality, attenuation, harmonics)


def harmonic_notches(
    center: float, relative_bandwidth: float, attenuation: float, harmonics: int
) -> Iterator[Notch]:
    """Yields the notches of a harmonic notch filter, one at each of the chosen multiples of its fundamental.

    All have the quality factor Q of the fundamental. In ``NotchFilter::calculate_A_and_Q`` a relative bandwidth b is
    converted to n = 2 log₂(1 / (1 − b/2)) octaves, and then 1/Q = 2^(n/2) − 2^(−n/2). Together this is
    1/Q = b/2 (2 − b/2) / (1 − b/2).

    Args:
        center: centre of the fundamental, Hz.
        relative_bandwidth: bandwidth divided by the centre, b, without a unit; between 0 and 2.
        attenuation: attenuation at the centre, dB.
        harmonics: bit mask of the multiples; bit k − 1 is set if there is a notch at k times the centre.

    Yields:
        Notches in ascending order; none if centre, bandwidth or attenuation is not positive.
    """
    if min(center, relative_bandwidth, attenuation) <= 0:
        return
    half_bandwidth = relative_bandwidth / 2
    inverse_quality = half_bandwidth * (2 - half_bandwidth) / (1 - half_bandwidth)
    for multiple in range(1, MAX_HARMONICS + 1):
        is_in_mask = harmonics >> (multiple - 1) & 1
        if is_in_mask:
            frequency = multiple * center
            yield Notch(frequency, inverse_quality * frequency, attenuation)
