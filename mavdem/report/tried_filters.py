"""The gyro's notch filters whose settings a reader of a page can try: as logged or, if off, on a vibration line.

``NotchFilter`` of ArduPilot is set by ``INS_HNTCH_*`` and ``INS_HNTC2_*``, that of PX4 by ``IMU_GYRO_NF0_*`` and
``IMU_GYRO_NF1_*``. Other filters of the gyro stay as they are.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from mavdem.arrays import SMALLEST_POSITIVE, Array
from mavdem.assessment.noise_spectra import MeasuredNoise
from mavdem.containers import Numbers
from mavdem.facts.noise import NotchAdvice
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.ardupilot_controller import (
    MIN_CENTER_PER_BANDWIDTH,
    NotchMode,
    harmonic_notches,
    notch_source_count,
)
from mavdem.loops.autopilot_parameters import Notch
from mavdem.loops.controllers import Controller
from mavdem.loops.resonance import MAX_LOOP_FREQUENCY
from mavdem.vibration.notch_filters import ARDUPILOT_ATTENUATION, RELATIVE_BANDWIDTHS
from mavdem.vibration.spectra import Spectrum
from mavdem.vibration.spectral_lines import (
    MIN_LINE_FREQUENCY,
    MIN_PEAK_PROMINENCE,
    prominent_peaks,
)

ARDUPILOT_PREFIXES = ("INS_HNTCH_", "INS_HNTC2_")
"""Beginnings of the parameters of ArduPilot's harmonic notches that are offered. The second one, which came in 4.2, is
offered where the log has its parameters."""


class _NotchParameters(NamedTuple):
    """Names of the parameters of one of PX4's static notches."""

    center: str
    """Name of the parameter for the centre, Hz; a value of 0 switches the notch off."""

    bandwidth: str
    """Name of the parameter for the bandwidth, Hz."""


PX4_NOTCHES = (
    _NotchParameters("IMU_GYRO_NF0_FRQ", "IMU_GYRO_NF0_BW"),
    _NotchParameters("IMU_GYRO_NF1_FRQ", "IMU_GYRO_NF1_BW"),
)
"""PX4's static notches."""

OLDER_PX4_NOTCH = _NotchParameters("IMU_GYRO_NF_FREQ", "IMU_GYRO_NF_BW")
"""The one static notch that older versions of PX4 had."""


class TriedFilter(NamedTuple):
    """A notch filter of the gyro whose settings a reader of the page can change, to see the effect."""

    parameters: Parameters
    """All its parameters as the sliders have them at first, switched on."""

    values_when_off: Mapping[str, float]
    """The parameters that switch it off, with the values that do."""

    names: Mapping[str, str]
    """Name of the parameter of "centre", "width", "depth" and "harmonics", as far as the autopilot has it."""

    is_on: bool
    """Whether the log has the filter on."""

    is_logged: bool
    """Whether the log has the parameter that switches it on."""

    prefix: str = ""
    """Beginning of its parameters in ArduPilot; empty for PX4."""

    motor_frequencies: Numbers = ()
    """Frequencies, Hz, at which its centres are in hover where it follows the motors' speeds; empty otherwise."""


def tried_filters(
    controller: Controller, noise: MeasuredNoise, peaks: Numbers, motor_frequencies: Numbers
) -> tuple[TriedFilter, ...]:
    """Returns the notch filters whose settings a reader can try on a flight's page.

    A filter that the log has gets its logged settings. The first filter is always there; if it is off, it is put on the
    strongest line.

    Args:
        controller: controller with the parameters of the log.
        noise: spectra of the flight, with the advised settings of a notch.
        peaks: frequencies of the strongest spectral lines, Hz, at least one. The n-th filter is put on the n-th line if
            it is off.
        motor_frequencies: revolutions per second of each motor in flight; empty if they were not measured.

    Returns:
        Filters of ArduPilot (INS_HNTCH, INS_HNTC2) or PX4 (IMU_GYRO_NF0, IMU_GYRO_NF1).
    """
    advised_parameters: Parameters = {}
    if noise.notch is not None and noise.notch.code is NotchAdvice.SET_NOTCH:
        advised_parameters = dict(noise.notch.figures["settings"])
    logged_parameters = controller.parameters
    filters = []
    if controller.is_ardupilot:
        for index, prefix in enumerate(ARDUPILOT_PREFIXES):
            is_first = index == 0
            if is_first or f"{prefix}ENABLE" in logged_parameters:
                peak = _peak_for(index, peaks)
                filters.append(
                    _ardupilot_filter(
                        logged_parameters, prefix, advised_parameters, peak, motor_frequencies
                    )
                )
        return tuple(filters)
    for index, notch in enumerate(_px4_notches(logged_parameters)):
        is_first = index == 0
        if is_first or notch.center in logged_parameters:
            peak = _peak_for(index, peaks)
            filters.append(_px4_filter(logged_parameters, notch, advised_parameters, peak))
    return tuple(filters)


def _px4_notches(logged_parameters: Parameters) -> Sequence[_NotchParameters]:
    """Returns the names of the parameters of each notch filter that the log's version of PX4 has.

    Older versions have a single notch, whose parameters have other names. A log that has neither is taken for a newer
    version.

    Args:
        logged_parameters: parameters of the log by PX4's names.
    """
    has_newer_notch = PX4_NOTCHES[0].center in logged_parameters
    has_older_notch = OLDER_PX4_NOTCH.center in logged_parameters
    return (OLDER_PX4_NOTCH,) if has_older_notch and not has_newer_notch else PX4_NOTCHES


def _peak_for(index: int, peaks: Numbers) -> float:
    """Returns the frequency of the line that a filter is put on, Hz: the line of its number, or else the last line."""
    return peaks[min(index, len(peaks) - 1)]


def strongest_peaks(noise: MeasuredNoise, spectrum: Spectrum) -> tuple[float, ...]:
    """Returns the frequencies of the vibration, Hz, on which a notch filter may be placed, the strongest first.

    They are the frequencies of the lines in the spectra of the flight. If there is no line, they are the peaks of the
    mean spectrum in the range of frequencies in which lines are looked for.

    Args:
        noise: spectra of the flight with their lines.
        spectrum: spectrum of the gyro.

    Returns:
        The frequencies; none if no peak stands out, such as in a spectrum that only falls.
    """
    if noise.lines:
        lines = sorted(noise.lines, key=lambda line: line.density, reverse=True)
        return tuple(line.frequency for line in lines)
    density = spectrum.mean_density.sum(axis=0)
    log_density = np.log(np.maximum(density, SMALLEST_POSITIVE))
    # Peaks are indices of the frequencies.
    peaks = []
    for peak in prominent_peaks(log_density, MIN_PEAK_PROMINENCE):
        if spectrum.frequency[peak] >= MIN_LINE_FREQUENCY:
            peaks.append(peak)
    peaks.sort(key=lambda peak: density[peak], reverse=True)
    return tuple(spectrum.frequency[peaks].tolist())


def frequency_of_most_vibration(spectrum: Spectrum) -> float:
    """Returns the frequency above the bandwidth of all rate loops at which a spectrum is largest, Hz.

    Args:
        spectrum: spectrum of the gyro, which extends above that bandwidth.
    """
    is_vibration = spectrum.frequency > MAX_LOOP_FREQUENCY
    density = spectrum.mean_density.sum(axis=0)[is_vibration]
    return float(spectrum.frequency[is_vibration][np.argmax(density)])


def _ardupilot_filter(
    logged_parameters: Parameters,
    prefix: str,
    advised_parameters: Parameters,
    peak: float,
    motor_frequencies: Numbers,
) -> TriedFilter:
    """Returns one of ArduPilot's harmonic notches, with the settings that the page shows first.

    They are the log's own settings if the notch is on there. Otherwise they are the advised ones or, if the advice sets
    another filter, such that the notch attenuates a line of the spectrum.

    Args:
        logged_parameters: parameters of the log.
        prefix: beginning of the notch's parameters, such as "INS_HNTCH_".
        advised_parameters: parameters that the advice sets, perhaps of another filter; empty without advice.
        peak: frequency of the spectral line, Hz.
        motor_frequencies: revolutions per second of each motor in flight; empty if they were not measured.
    """
    enable = f"{prefix}ENABLE"
    # Rounded to as many digits as people type.
    center = float(f"{peak:.3g}")
    parameters_on_line = {
        enable: 1.0,
        f"{prefix}MODE": float(NotchMode.FIXED),
        f"{prefix}FREQ": center,
        f"{prefix}BW": float(f"{RELATIVE_BANDWIDTHS[-1] * center:.2g}"),
        f"{prefix}REF": 1.0,
        f"{prefix}HMNCS": 1.0,
        f"{prefix}ATT": ARDUPILOT_ATTENUATION,
    }
    is_on = bool(logged_parameters.get(enable, 0.0))
    first_settings = logged_parameters if is_on else advised_parameters
    parameters = {}
    for name, value_on_line in parameters_on_line.items():
        parameters[name] = first_settings.get(name, value_on_line)
    # The page shows the filter switched on.
    parameters[enable] = 1.0
    names = {"centre": "FREQ", "width": "BW", "depth": "ATT", "harmonics": "HMNCS"}
    followed_frequencies: Numbers = ()
    if parameters[f"{prefix}MODE"] == NotchMode.ESC_TELEMETRY and motor_frequencies:
        # The parameter REF scales the speeds (AP_Vehicle::update_dynamic_notch).
        scaled = [parameters[f"{prefix}REF"] * frequency for frequency in motor_frequencies]
        has_notch_for_each = notch_source_count({**logged_parameters, **parameters}, prefix) > 1
        followed_frequencies = tuple(scaled) if has_notch_for_each else (float(np.mean(scaled)),)
    return TriedFilter(
        parameters=parameters,
        values_when_off={enable: 0.0},
        names={setting: f"{prefix}{ending}" for setting, ending in names.items()},
        is_on=is_on,
        is_logged=enable in logged_parameters,
        prefix=prefix,
        motor_frequencies=followed_frequencies,
    )


def _px4_filter(
    logged_parameters: Parameters,
    notch: _NotchParameters,
    advised_parameters: Parameters,
    line_frequency: float,
) -> TriedFilter:
    """Returns one of PX4's static notches, with the settings that the page shows first.

    They are the log's own settings if the notch is on there. Otherwise they are the advised ones or, if the advice sets
    another filter, such that the notch attenuates a line of the spectrum.

    Args:
        logged_parameters: parameters of the log.
        notch: names of the notch's parameters.
        advised_parameters: parameters that the advice sets, perhaps of another filter; empty without advice.
        line_frequency: frequency of the spectral line, Hz.
    """
    is_on = (
        logged_parameters.get(notch.center, 0.0) > 0
        and logged_parameters.get(notch.bandwidth, 0.0) > 0
    )
    first_settings = logged_parameters if is_on else advised_parameters
    # Rounded to as many digits as people type.
    center_on_line = float(f"{line_frequency:.3g}")
    bandwidth_on_line = float(f"{RELATIVE_BANDWIDTHS[-1] * center_on_line:.2g}")
    return TriedFilter(
        parameters={
            notch.center: first_settings.get(notch.center, center_on_line),
            notch.bandwidth: first_settings.get(notch.bandwidth, bandwidth_on_line),
        },
        # PX4 has no parameter that enables a notch: a centre of 0 Hz switches it off.
        values_when_off={notch.center: 0.0},
        names={"centre": notch.center, "width": notch.bandwidth},
        is_on=is_on,
        is_logged=notch.center in logged_parameters,
    )


def without_filters(controller: Controller, filters: Sequence[TriedFilter]) -> Controller:
    """Returns a controller as it would be with some notch filters switched off, and all other filters unchanged.

    Args:
        controller: controller with the parameters of the log.
        filters: notch filters to switch off, each with the parameters that do so.
    """
    parameters: dict[str, float] = {}
    for tried_filter in filters:
        parameters |= tried_filter.values_when_off
    return controller.with_parameters(parameters)


def logged_notches(controller: Controller, filters: Sequence[TriedFilter]) -> list[Notch]:
    """Returns the notches that these filters make with the settings of the log; a filter that is off makes none.

    A filter may make several notches, such as one at each harmonic of a frequency.

    Args:
        controller: controller with the parameters of the log.
        filters: notch filters of the gyro, each with the parameters that set it.
    """
    notches: list[Notch] = []
    controller_without_filters = without_filters(controller, filters)
    for tried_filter in filters:
        if not tried_filter.is_on:
            continue
        if tried_filter.motor_frequencies:
            notches += _motor_notches(tried_filter)
        else:
            notches += _fixed_notches(tried_filter, controller_without_filters)
    return notches


def _fixed_notches(
    tried_filter: TriedFilter, controller_without_filters: Controller
) -> list[Notch]:
    """Returns the notches of a filter at fixed frequencies, which the controller gets when the filter is switched on.

    Args:
        tried_filter: the filter, with its parameters.
        controller_without_filters: the controller with all filters off that are tried. Others may be on.
    """
    controller = controller_without_filters.with_parameters(tried_filter.parameters)
    notch_count = len(controller.notches) - len(controller_without_filters.notches)
    # A controller lists the notches of these filters before the others, such as those of a dynamic notch.
    return [*controller.notches[:notch_count]]


def _motor_notches(tried_filter: TriedFilter) -> list[Notch]:
    """Returns the notches of a filter that follows the motors: harmonics of the speed of each motor.

    A motor that turns more slowly than the filter's lowest centre gets its notches at that centre.

    Args:
        tried_filter: the filter, with the frequencies of the motors, Hz.

    Returns:
        The notches, motor by motor; empty if the filter has neither centre nor bandwidth.
    """
    values = {
        setting: tried_filter.parameters[name] for setting, name in tried_filter.names.items()
    }
    lowest_center = max(values["centre"], MIN_CENTER_PER_BANDWIDTH * values["width"])
    if lowest_center <= 0:
        return []
    # ArduPilot computes the quality factor once, at the lowest centre, and keeps it at every other one.
    relative_bandwidth = values["width"] / lowest_center
    notches: list[Notch] = []
    centers: Array = np.maximum(tried_filter.motor_frequencies, lowest_center)
    for center in centers.tolist():
        notches += harmonic_notches(
            center, relative_bandwidth, values["depth"], int(values["harmonics"])
        )
    return notches
