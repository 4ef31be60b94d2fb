"""The gyro's notch filters whose settings a page lets one try: as logged or, if off, on the strongest vibration line.

``NotchFilter`` of ArduPilot is set by ``INS_HNTCH_*`` and ``INS_HNTC2_*``, that of PX4 by ``IMU_GYRO_NF0_*`` and
``IMU_GYRO_NF1_*``. Other filters of the gyro stay as they are.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
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

ARDUPILOT_PREFIXES = ("INS_HNTCH_", "INS_HNTC2_")
"""Beginnings of the parameters of ArduPilot's harmonic notches that are offered. The second one, which came in 4.2, is
offered where the log has its parameters."""

PX4_NOTCHES = (
    ("IMU_GYRO_NF0_FRQ", "IMU_GYRO_NF0_BW"),
    ("IMU_GYRO_NF1_FRQ", "IMU_GYRO_NF1_BW"),
)
"""Centre and bandwidth of PX4's static notches."""

OLDER_PX4_NOTCH = ("IMU_GYRO_NF_FREQ", "IMU_GYRO_NF_BW")
"""Centre and bandwidth of the one static notch that older versions of PX4 had."""


class TriedFilter(NamedTuple):
    """One notch filter to try."""

    parameters: Parameters
    """All its parameters as the sliders have them at first, switched on."""

    switch: Mapping[str, float]
    """The parameters that switch it off, with their values then."""

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
        peaks: frequencies of the strongest lines, Hz, at least one. The n-th filter is put on the n-th line if it is
            off.
        motor_frequencies: revolutions per second of each motor in flight; empty if they were not measured.

    Returns:
        Filters of ArduPilot (INS_HNTCH, INS_HNTC2) or PX4 (IMU_GYRO_NF0, IMU_GYRO_NF1).
    """
    advised: Parameters = {}
    if noise.notch is not None and noise.notch.code is NotchAdvice.SET_NOTCH:
        advised = dict(noise.notch.figures["settings"])
    logged = controller.parameters
    filters = []
    if controller.is_ardupilot:
        for index, prefix in enumerate(ARDUPILOT_PREFIXES):
            if index == 0 or f"{prefix}ENABLE" in logged:
                peak = _peak_for(index, peaks)
                filters.append(_ardupilot_filter(logged, prefix, advised, peak, motor_frequencies))
        return tuple(filters)
    # Older versions of PX4 have a single notch, whose parameters have other names.
    notches: Sequence[tuple[str, str]] = PX4_NOTCHES
    first_frequency, _ = PX4_NOTCHES[0]
    older_frequency, _ = OLDER_PX4_NOTCH
    if first_frequency not in logged and older_frequency in logged:
        notches = (OLDER_PX4_NOTCH,)
    for index, notch in enumerate(notches):
        frequency, _ = notch
        if index == 0 or frequency in logged:
            filters.append(_px4_filter(logged, notch, advised, _peak_for(index, peaks)))
    return tuple(filters)


def _peak_for(index: int, peaks: Numbers) -> float:
    """Returns the line that a filter is put on, Hz: that of its number, or the last one if there are fewer lines."""
    return peaks[min(index, len(peaks) - 1)]


def strongest_peaks(noise: MeasuredNoise, spectrum: Spectrum) -> tuple[float, ...]:
    """Returns the frequencies of the spectral lines, the strongest first.

    Args:
        noise: spectra of the flight with their lines.
        spectrum: spectrum of the gyro, which extends above the bandwidth of all rate loops.

    Returns:
        Frequencies, Hz. Without any line, the one with the highest density above the bandwidth.
    """
    if noise.lines:
        lines = sorted(noise.lines, key=lambda line: -line.density)
        return tuple(line.frequency for line in lines)
    density = spectrum.mean_density.sum(axis=0)
    is_vibration = spectrum.frequency > MAX_LOOP_FREQUENCY
    return (float(spectrum.frequency[is_vibration][np.argmax(density[is_vibration])]),)


def _ardupilot_filter(
    logged: Parameters,
    prefix: str,
    advised: Parameters,
    peak: float,
    motor_frequencies: Numbers,
) -> TriedFilter:
    """Returns one of ArduPilot's harmonic notches.

    Args:
        logged: parameters of the log.
        prefix: beginning of its parameters.
        advised: parameters that the advice sets; empty without one.
        peak: frequency of a line, Hz.
        motor_frequencies: revolutions per second of each motor in flight.
    """
    enable = f"{prefix}ENABLE"
    center = float(f"{peak:.3g}")
    parameters = {
        enable: 1.0,
        f"{prefix}MODE": float(NotchMode.FIXED),
        f"{prefix}FREQ": center,
        f"{prefix}BW": float(f"{RELATIVE_BANDWIDTHS[-1] * center:.2g}"),
        f"{prefix}REF": 1.0,
        f"{prefix}HMNCS": 1.0,
        f"{prefix}ATT": ARDUPILOT_ATTENUATION,
    }
    # What the log or, if the filter is off, the advice has replaces these values.
    is_on = bool(logged.get(enable, 0.0))
    source = logged if is_on else advised
    for name, value in parameters.items():
        parameters[name] = source.get(name, value)
    parameters[enable] = 1.0
    names = {"centre": "FREQ", "width": "BW", "depth": "ATT", "harmonics": "HMNCS"}
    followed: Numbers = ()
    if parameters[f"{prefix}MODE"] == NotchMode.ESC_TELEMETRY and motor_frequencies:
        # The parameter REF scales the speeds (AP_Vehicle::update_dynamic_notch).
        scaled = [parameters[f"{prefix}REF"] * frequency for frequency in motor_frequencies]
        has_notch_for_each = notch_source_count({**logged, **parameters}, prefix) > 1
        followed = tuple(scaled) if has_notch_for_each else (float(np.mean(scaled)),)
    return TriedFilter(
        parameters=parameters,
        switch={enable: 0.0},
        names={setting: f"{prefix}{ending}" for setting, ending in names.items()},
        is_on=is_on,
        is_logged=enable in logged,
        prefix=prefix,
        motor_frequencies=followed,
    )


def _px4_filter(
    logged: Parameters, pair: tuple[str, str], advised: Parameters, peak: float
) -> TriedFilter:
    """Returns one of PX4's static notches: as logged if it is on, otherwise as advised or on the line ``peak``.

    Args:
        logged: parameters of the log.
        pair: names of its centre and of its bandwidth.
        advised: parameters that the advice sets, perhaps those of the dynamic notch, which is another filter.
        peak: frequency of a line, Hz.
    """
    center_name, width_name = pair
    is_on = logged.get(center_name, 0.0) > 0 and logged.get(width_name, 0.0) > 0
    # Parameters are typed with three digits.
    center_on_line = float(f"{peak:.3g}")
    width_on_line = float(f"{RELATIVE_BANDWIDTHS[-1] * center_on_line:.2g}")
    source = logged if is_on else advised
    return TriedFilter(
        parameters={
            center_name: source.get(center_name, center_on_line),
            width_name: source.get(width_name, width_on_line),
        },
        switch={center_name: 0.0},
        names={"centre": center_name, "width": width_name},
        is_on=is_on,
        is_logged=center_name in logged,
    )


def without_filters(controller: Controller, filters: Sequence[TriedFilter]) -> Controller:
    """Returns the controller with these filters off, and all others as they are."""
    switched: dict[str, float] = {}
    for tried in filters:
        switched |= tried.switch
    return controller.with_parameters(switched)


def logged_notches(controller: Controller, filters: Sequence[TriedFilter]) -> list[Notch]:
    """Returns the notches of these filters as the log has them; those that are off there have none.

    Args:
        controller: controller with the parameters of the log.
        filters: the filters.
    """
    notches: list[Notch] = []
    controller_without_filters = without_filters(controller, filters)
    other_notch_count = len(controller_without_filters.notches)
    for tried in filters:
        if not tried.is_on:
            continue
        if tried.motor_frequencies:
            notches += _motor_notches(tried)
            continue
        # Of the filters that are tried, this controller has one. It lists the notches of that one before all others.
        controller_with_filter = controller_without_filters.with_parameters(tried.parameters)
        notch_count = len(controller_with_filter.notches) - other_notch_count
        notches += controller_with_filter.notches[:notch_count]
    return notches


def _motor_notches(tried: TriedFilter) -> list[Notch]:
    """Returns the notches of a filter that follows the motors: harmonics of the speed of each motor.

    A motor that turns more slowly than the filter's lowest centre gets its notches at that centre.

    Args:
        tried: the filter, with the frequencies of the motors, Hz.

    Returns:
        The notches, motor by motor; empty if the filter has neither centre nor bandwidth.
    """
    values = {setting: tried.parameters[name] for setting, name in tried.names.items()}
    min_center = max(values["centre"], MIN_CENTER_PER_BANDWIDTH * values["width"])
    if min_center <= 0:
        return []
    # ArduPilot computes the quality factor once, at the lowest centre, and keeps it at every other one.
    relative_bandwidth = values["width"] / min_center
    notches: list[Notch] = []
    centers: Array = np.maximum(tried.motor_frequencies, min_center)
    for center in centers.tolist():
        notches += harmonic_notches(
            center, relative_bandwidth, values["depth"], int(values["harmonics"])
        )
    return notches
