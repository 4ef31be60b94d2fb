"""Notch filters for a line of the gyro's spectrum: which parameters to set, what they remove, and their phase lag.

ArduPilot's harmonic notch follows the root of the throttle, or the motors' speed where ESCs report it. PX4's static
notch stays where it is, its dynamic one follows that speed. A notch is as narrow as removes enough of the line over all
windows of the flight, each with the notch where it would have been. Parameters and recommended values:
https://ardupilot.org/copter/docs/common-imu-notch-filtering.html, https://docs.px4.io/main/en/config_mc/filter_tuning.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.facts import Fact
from mavdem.facts.noise import NotchAdvice
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.ardupilot_controller import NotchMode
from mavdem.loops.controllers import Controller
from mavdem.loops.filters import gyro_filters, gyro_response
from mavdem.loops.resonance import MAX_LOOP_FREQUENCY
from mavdem.vibration.spectra import Spectrum
from mavdem.vibration.spectral_lines import LineCause, SpectralLine

RELATIVE_BANDWIDTHS = (1 / 4, 1 / 3, 1 / 2)
"""Bandwidths of a notch relative to the frequency of its line, in the order in which they are tried; 1/2 is usual."""
MIN_REMOVED_SHARE = 0.9
"""Least fraction of a line's power that a notch removes, unless the widest one removes less: a choice."""
MIN_NOISE_SHARE = 0.2
"""Share of a line in the noise above the loop's bandwidth, after the filters, that is worth a notch: a choice."""
ARDUPILOT_ATTENUATION = 40.0
"""Attenuation of a notch, dB: the default of ``INS_HNTCH_ATT``."""
DEFAULT_HOVER_THROTTLE = 0.35
"""``MOT_THST_HOVER`` where the log has none: ArduCopter's default."""
HIGHEST_ROTOR_FREQUENCY = 200.0
"""Frequency, Hz, that rotors of most multirotors do not exceed in hover: those with 5-inch propellers come near it.

ArduPilot's default of ``INS_HNTCH_FREQ``, 80 Hz, is for larger propellers.
"""
LINE_BAND = (0.75, 1.35)
"""Lowest and highest frequency whose power counts as the line's, relative to the line's frequency: a choice."""


def notch_advice(
    controller: Controller,
    lines: Sequence[SpectralLine],
    unfiltered: Spectrum | None,
    filtered: Spectrum | None,
    crossover: float | None,
) -> Fact:
    """Advises a notch filter on the strongest line of motors or frame in the gyro's spectrum, or states why none.

    A notch adds phase lag, which takes from the phase margin. So one is advised only for a line that makes at least
    ``MIN_NOISE_SHARE`` of the noise after the present filters. Noise is what lies above all frequencies at which rate
    loops work (``MAX_LOOP_FREQUENCY``). A spectrum that ends below it shows no motors, and there is no advice.

    Args:
        controller: controller with the present filters of the gyro.
        lines: lines of the gyro's spectrum.
        unfiltered: spectrum of the gyro before its filters, which is preferred; ``None`` where it was not logged.
        filtered: spectrum of the gyro after its filters; ``None`` where it was not logged.
        crossover: crossover frequency of the rate loop, Hz, at which the phase lag of the notch is stated; ``None``
            where it is not known.

    Returns:
        A fact: the parameters to set, the fraction of the line that they remove and their phase lag; or the reason for
        no notch.
    """
    spectrum = unfiltered or filtered
    lines_to_filter = [line for line in lines if line.cause in (LineCause.MOTOR, LineCause.FRAME)]
    if spectrum is None:
        return Fact(NotchAdvice.NO_LINE_TO_REMOVE)
    shows_only_loops = spectrum.nyquist_frequency <= MAX_LOOP_FREQUENCY
    if shows_only_loops or not (lines_to_filter or _reaches_motors(spectrum)):
        return Fact(
            NotchAdvice.SPECTRUM_BELOW_MOTORS,
            highest=spectrum.nyquist_frequency,
            rotor_frequency=_rotor_frequency(spectrum),
        )
    if not lines_to_filter:
        return Fact(NotchAdvice.NO_LINE_TO_REMOVE)
    strongest_line = max(lines_to_filter, key=lambda line: line.density)
    frequency = strongest_line.frequency
    if any(abs(notch.frequency - frequency) < notch.bandwidth / 2 for notch in controller.notches):
        return Fact(NotchAdvice.NOTCH_IN_PLACE, frequency=frequency)
    filtered_density = spectrum.total_density.mean(axis=0)
    # The spectrum after the filters is the unfiltered one times the square of their gain.
    if unfiltered is not None:
        gain = abs(gyro_response(controller, spectrum.frequency))
        filtered_density = filtered_density * gain**2
    lowest_ratio, highest_ratio = LINE_BAND
    lower_edge = lowest_ratio * frequency
    upper_edge = highest_ratio * frequency
    is_line = (spectrum.frequency > lower_edge) & (spectrum.frequency < upper_edge)
    is_above_loop = spectrum.frequency > MAX_LOOP_FREQUENCY
    line_share = filtered_density[is_line].sum() / filtered_density[is_above_loop].sum()
    if line_share < MIN_NOISE_SHARE:
        return Fact(NotchAdvice.NOTCH_NOT_NEEDED, frequency=frequency, share=line_share)
    notch = _narrowest_notch(controller, strongest_line, spectrum, is_line)
    return Fact(
        NotchAdvice.SET_NOTCH,
        frequency=frequency,
        share=notch.removed_share,
        phase_cost=_phase_cost(controller, notch.controller, crossover),
        crossover=crossover,
        settings=tuple(notch.settings.items()),
    )


def _reaches_motors(spectrum: Spectrum) -> bool:
    """Returns whether a spectrum reaches the frequency at which the motors turn, so that it would show their line.

    Where their speed was not logged, it must reach the highest one of usual multirotors (``HIGHEST_ROTOR_FREQUENCY``).

    Args:
        spectrum: spectrum of the gyro, with the motors' speed in each window if it was logged.
    """
    rotor_frequency = _rotor_frequency(spectrum)
    if rotor_frequency is None:
        rotor_frequency = HIGHEST_ROTOR_FREQUENCY
    return rotor_frequency <= spectrum.nyquist_frequency


def _rotor_frequency(spectrum: Spectrum) -> float | None:
    """Returns the median frequency at which the motors turn, Hz; ``None`` if no window has their logged speed."""
    logged_speeds = spectrum.motor_speed[np.isfinite(spectrum.motor_speed)]
    if not logged_speeds.size:
        return None
    return float(np.median(logged_speeds))


def _phase_cost(
    controller: Controller, with_notch: Controller, crossover: float | None
) -> float | None:
    """Returns the phase lag that a notch adds at the crossover of the rate loop, which the phase margin loses.

    Args:
        controller: controller with the present filters of the gyro.
        with_notch: the same controller with the notch.
        crossover: crossover frequency of the rate loop, Hz; ``None`` where it is not known.

    Returns:
        Phase lag, degrees; ``None`` where the crossover is not known.
    """
    if crossover is None:
        return None
    lag_with_notch = gyro_filters(with_notch, crossover).phase_lag
    lag_without_notch = gyro_filters(controller, crossover).phase_lag
    return lag_with_notch - lag_without_notch


class _NotchSettings(NamedTuple):
    """A notch filter that may be set."""

    settings: Parameters
    """The parameters to set, by name."""
    controller: Controller
    """The controller with this notch; its centre is where it lies at the median of the motors' speed or throttle."""
    removed_share: float
    """Fraction of the line's power that the notch removes."""


def _narrowest_notch(
    controller: Controller, line: SpectralLine, spectrum: Spectrum, is_line: Flags
) -> _NotchSettings:
    """Finds the narrowest notch that removes ``MIN_REMOVED_SHARE`` of a line's power.

    A narrow notch costs less phase margin, but the frequency of a line varies in flight. So ``RELATIVE_BANDWIDTHS`` are
    tried from narrow to wide, and for each the power that it would have removed over all W windows of the flight is
    computed. A notch that follows the motors has another centre in each window. Instead of moving the notch, the
    frequencies of the window are divided by its relative centre.

    Args:
        controller: controller with the present filters.
        line: line to remove.
        spectrum: spectrum with the line.
        is_line: whether each frequency of the spectrum belongs to the line (F,).

    Returns:
        The settings of that notch; the settings of the widest one if none removes that much.
    """
    power = spectrum.total_density[:, is_line]
    relative_center = _relative_notch_frequency(controller, line, spectrum)
    # Frequencies of the line in each window, relative to a notch that stays: W windows in rows.
    frequency = spectrum.frequency[is_line] / relative_center[:, None]
    for relative_bandwidth in RELATIVE_BANDWIDTHS:
        # Rounded to two significant digits, as a user would enter it.
        bandwidth = float(f"{relative_bandwidth * line.frequency:.2g}")
        settings = _notch_parameters(controller, line, bandwidth)
        static_settings = settings
        if "IMU_GYRO_DNF_EN" in settings:
            # PX4's dynamic notch is not modelled. At the median of the motors' speed it acts like a static one.
            static_settings = _px4_static_notch(line, settings["IMU_GYRO_DNF_BW"])
        controller_with_notch = controller.with_parameters(static_settings)
        # The notch is in series with the present filters, so its gain is the ratio of the gains with and without it.
        gain = abs(
            gyro_response(controller_with_notch, frequency) / gyro_response(controller, frequency)
        )
        removed_share = 1 - (power * gain**2).sum() / power.sum()
        if removed_share >= MIN_REMOVED_SHARE:
            break
    return _NotchSettings(settings, controller_with_notch, removed_share)


def _relative_notch_frequency(
    controller: Controller, line: SpectralLine, spectrum: Spectrum
) -> Array:
    """Returns the centre frequency of a notch in each window of the flight, relative to its median.

    A notch on a line of motors follows the motors' speed if ESCs report it, so that the line has an ``order``.
    Otherwise ArduPilot's notch follows the square root of the throttle, to which the speed is nearly proportional. All
    other notches have a fixed centre.

    Args:
        controller: controller of ArduPilot or PX4.
        line: line that the notch is to remove.
        spectrum: spectrum with motor speed and throttle of each of W windows.

    Returns:
        Relative centre frequency (W,); 1 for a fixed notch.
    """
    if line.cause is LineCause.MOTOR and line.order is not None:
        return spectrum.motor_speed / np.median(spectrum.motor_speed)
    if line.cause is LineCause.MOTOR and controller.is_ardupilot:
        return np.sqrt(spectrum.throttle / np.median(spectrum.throttle))
    return np.ones(len(spectrum.time))


def _notch_parameters(controller: Controller, line: SpectralLine, bandwidth: float) -> Parameters:
    """Returns the parameters that set a notch on a line, by the filters that the autopilot has.

    ArduPilot has one harmonic notch for all cases. PX4's dynamic notch (``IMU_GYRO_DNF_*``) follows the speed that ESCs
    report; ``HMC`` is its number of harmonics. Without that speed, PX4 has static notches only.

    Args:
        controller: controller of ArduPilot or PX4.
        line: line to remove.
        bandwidth: bandwidth of the notch, Hz.

    Returns:
        Values by the name of the parameter.
    """
    if controller.is_ardupilot:
        return _ardupilot_harmonic_notch(controller, line, bandwidth)
    if line.cause is LineCause.MOTOR and line.order is not None:
        return {
            "IMU_GYRO_DNF_EN": 1.0,
            "IMU_GYRO_DNF_BW": bandwidth,
            "IMU_GYRO_DNF_HMC": float(max(line.harmonics)),
        }
    return _px4_static_notch(line, bandwidth)


def _ardupilot_harmonic_notch(
    controller: Controller, line: SpectralLine, bandwidth: float
) -> Parameters:
    """Returns the parameters that set ArduPilot's harmonic notch on a line.

    A line of the frame gets a fixed notch. A line of motors gets a notch that follows their speed if ESCs report it, so
    that the line has an ``order``, and otherwise the throttle. ``INS_HNTCH_REF`` is the throttle at which the notch is
    at ``INS_HNTCH_FREQ``, or a factor on the motors' speed. Bit k − 1 of the mask ``INS_HNTCH_HMNCS`` enables the notch
    at k times the frequency.

    Args:
        controller: controller with the logged hover throttle.
        line: line to remove.
        bandwidth: bandwidth of the notch, Hz.

    Returns:
        Values by the autopilot's name.
    """
    reference = 1.0
    if line.cause is not LineCause.MOTOR:
        mode = NotchMode.FIXED
    elif line.order is not None:
        mode = NotchMode.ESC_TELEMETRY
    else:
        mode = NotchMode.THROTTLE
        hover_throttle = controller.parameters.get("MOT_THST_HOVER", DEFAULT_HOVER_THROTTLE)
        # Three digits, so that the value can be typed in.
        reference = float(f"{hover_throttle:.3g}")
    harmonics_mask = 0
    for multiple in line.harmonics:
        harmonics_mask |= 1 << (multiple - 1)
    return {
        "INS_HNTCH_ENABLE": 1.0,
        "INS_HNTCH_MODE": float(mode),
        "INS_HNTCH_FREQ": float(f"{line.frequency:.3g}"),
        "INS_HNTCH_BW": bandwidth,
        "INS_HNTCH_REF": reference,
        "INS_HNTCH_HMNCS": float(harmonics_mask),
        "INS_HNTCH_ATT": ARDUPILOT_ATTENUATION,
    }


def _px4_static_notch(line: SpectralLine, bandwidth: float) -> Parameters:
    """Returns the parameters that set PX4's first static notch on a line, with a bandwidth in Hz, by their names."""
    return {"IMU_GYRO_NF0_FRQ": float(f"{line.frequency:.3g}"), "IMU_GYRO_NF0_BW": bandwidth}
