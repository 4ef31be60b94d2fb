"""The notch filter of a flight's page, whose settings a reader tries: what it takes, and the phase it costs.

The script ``notch.js`` computes the responses of ``mavdem.loops.filters``, which has their sources: ``NotchFilter``
of ArduPilot, set by ``INS_HNTCH_*``, and of PX4, set by ``IMU_GYRO_NF0_*``. Other filters of the gyro stay as they are.
"""

from collections.abc import Mapping
from pathlib import PurePath
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array
from mavdem.assessment.noise_spectra import GYRO, UNFILTERED_GYRO, MeasuredNoise
from mavdem.containers import JsonValues
from mavdem.facts.noise import NotchAdvice
from mavdem.ingest.parameter_file import parameter_files
from mavdem.ingest.telemetry import Parameters, Telemetry
from mavdem.loops.ardupilot_controller import (
    MAX_HARMONICS,
    MIN_CENTER_PER_BANDWIDTH,
    NotchMode,
    hover_center_ratio,
    notch_source_count,
)
from mavdem.loops.axis_loops import Loop
from mavdem.loops.controllers import Controller
from mavdem.loops.filters import MAX_NOTCH_FREQUENCY_RATIO, gyro_response, notch_response
from mavdem.loops.resonance import MAX_LOOP_FREQUENCY
from mavdem.report.charts.chart import FREQUENCY, Axis, Chart, Group, Line, LineStyle, Mark
from mavdem.report.gain_changes import READERS
from mavdem.report.palette import BAD, COMMAND, MEASURED, PREDICTED
from mavdem.vibration.notch_filters import ARDUPILOT_ATTENUATION, RELATIVE_BANDWIDTHS
from mavdem.vibration.spectra import Spectrum, max_decimated

ARDUPILOT_PREFIX = "INS_HNTCH_"
"""Beginning of the parameters of ArduPilot's first harmonic notch, which is the one to try."""

PX4_NOTCH = ("IMU_GYRO_NF0_FRQ", "IMU_GYRO_NF0_BW")
"""Centre and bandwidth of PX4's first static notch, which is the one to try."""

OLDER_PX4_NOTCH = ("IMU_GYRO_NF_FREQ", "IMU_GYRO_NF_BW")
"""The same in older versions, which had one notch."""

ASSUMED_CROSSOVER = 10.0
"""Frequency at which the phase lag is stated where no rate loop is identified, Hz: a choice, a fast loop's."""

MIN_FREQUENCY = 1.0
"""Lowest frequency of the charts, Hz: rate loops cross over above it."""

RESPONSE_SPAN = 500.0
"""Highest frequency of the charts, Hz, unless the spectrum reaches further; motors' harmonics lie below it."""

RESPONSE_POINTS = 400
"""Points of the filter's response: about as many as pixels on a small screen."""

MIN_GAIN = 1e-3
"""Lowest gain that is drawn, −60 dB: ArduPilot's notches are no deeper, and PX4's are infinitely deep at one point."""

MIN_DENSITY = 1e-12
"""Lowest spectral density that is drawn, so that a logarithmic axis has no zero."""

OFFERED_HARMONICS = 8
"""Multiples of the centre that are offered; a mask with higher ones in the log keeps them."""

REMARK = "Notch filter that was tried on the page"
"""First line of the parameter files."""


class NotchSlider(NamedTuple):
    """A setting of the notch that a slider sets."""

    parameter: str
    """Name of the parameter."""

    label: str
    """What it sets."""

    unit: str
    """Unit of its values."""

    lowest: float
    """Value at the slider's left end."""

    highest: float
    """Value at the slider's right end."""

    value: float
    """Value at first."""


class NotchTrial(NamedTuple):
    """A notch filter with sliders, the charts that follow them, and what the script needs to compute these."""

    sliders: tuple[NotchSlider, ...]
    """Centre, bandwidth and, where the autopilot has one, depth."""

    harmonics: dict[int, bool]
    """Whether each multiple of the centre has a notch at first; empty for PX4, whose notch has one centre."""

    is_on: bool
    """Whether the log has the filter on."""

    charts: Group
    """Spectrum, gain and phase, with the filter as it is at first."""

    remarks: tuple[str, ...]
    """What limits the trial, in sentences."""

    endings: tuple[str, ...]
    """Endings of the parameter files, with who reads each."""

    model: JsonValues
    """All that ``notch.js`` computes with."""


class _TriedFilter(NamedTuple):
    """The filter to try: its parameters, and the controller with and without it."""

    parameters: Parameters
    """All parameters of the filter as the sliders have them at first, switched on."""

    switch: Mapping[str, float]
    """The parameters that switch it off, with their values then."""

    names: Mapping[str, str]
    """Name of the parameter of "centre", "width", "depth" and "harmonics", as far as the autopilot has it."""

    is_on: bool
    """Whether the log has the filter on."""

    is_logged: bool
    """Whether the log has the parameter that switches it on."""

    with_filter: Controller
    """The controller with the filter on."""

    without_filter: Controller
    """The controller with the filter off, and all others as they are."""


def notch_trial(
    log_name: str,
    vehicle: Telemetry,
    noise: MeasuredNoise,
    controller: Controller | None,
    loop: Loop | None,
) -> NotchTrial | None:
    """Returns the notch filter to try, as the log has it; if it is off there, on the line that it would be for.

    Args:
        log_name: name of the log, after which the parameter files are named.
        vehicle: the vehicle that these are for.
        noise: spectra of the flight with their lines.
        controller: controller with the gyro's filters; None where it is not known.
        loop: the identified rate loop with the highest crossover frequency; None where none is identified.

    Returns:
        The trial; None without a spectrum of the gyro that reaches above all rate loops.
    """
    spectrum = noise.spectra.get(UNFILTERED_GYRO, noise.spectra.get(GYRO))
    if spectrum is None or controller is None:
        return None
    if spectrum.nyquist_frequency <= MAX_LOOP_FREQUENCY:
        return None
    peak = _peak_frequency(noise, spectrum)
    tried = _tried_filter(controller, noise, peak)
    crossover = ASSUMED_CROSSOVER if loop is None else loop.crossover
    mark = Mark(crossover, "crossover" if loop is not None else "", BAD)
    remarks = []
    if loop is None:
        remarks.append(
            f"No rate loop is identified: the phase is stated at {ASSUMED_CROSSOVER:.0f} Hz."
        )
    if not tried.is_logged:
        remarks.append("The log has none of its parameters: see whether the firmware has them.")
    mode = tried.parameters.get(f"{ARDUPILOT_PREFIX}MODE", NotchMode.FIXED)
    if mode == NotchMode.THROTTLE:
        remarks.append("It follows the throttle, and is shown where it is in hover.")
    elif mode != NotchMode.FIXED:
        remarks.append("It follows a measurement, and is shown at its lowest frequency.")
    # Where only the gyro behind the filter was logged, what it took cannot be known.
    is_behind_it = spectrum.name == GYRO and tried.is_on
    if is_behind_it:
        remarks.append(
            "The log has the gyro only behind this filter, so its spectrum with another one is not known."
        )
    files = parameter_files(tried.parameters, vehicle, REMARK)
    endings = tuple(sorted(files))
    return NotchTrial(
        _sliders(tried, controller.gyro_rate),
        _harmonics(tried),
        tried.is_on,
        _charts(tried, spectrum, peak, mark, has_spectrum=not is_behind_it),
        tuple(remarks),
        tuple(f"{ending} ({READERS[ending]})" for ending in endings),
        {
            **_filter_as_json(tried),
            "peak": peak,
            "crossover": crossover,
            "place": "At the crossover of" if loop is not None else "At",
            "files": [
                {"name": f"{PurePath(log_name).stem}.notch{ending}", "text": files[ending]}
                for ending in endings
            ],
        },
    )


def _peak_frequency(noise: MeasuredNoise, spectrum: Spectrum) -> float:
    """Returns the frequency of the strongest line, Hz, or of the highest density above all rate loops without one."""
    if noise.lines:
        return max(noise.lines, key=lambda line: line.density).frequency
    density = spectrum.mean_density.sum(axis=0)
    is_vibration = spectrum.frequency > MAX_LOOP_FREQUENCY
    return float(spectrum.frequency[is_vibration][np.argmax(density[is_vibration])])


def _tried_filter(controller: Controller, noise: MeasuredNoise, peak: float) -> _TriedFilter:
    """Returns the filter as the log has it; if it is off, as the advice would set it, or else at the peak.

    Args:
        controller: controller with the gyro's filters.
        noise: spectra of the flight with the advice.
        peak: frequency of the strongest line, Hz.
    """
    advised: Parameters = {}
    if noise.notch is not None and noise.notch.code is NotchAdvice.SET_NOTCH:
        advised = dict(noise.notch.figures["settings"])
    if controller.is_ardupilot:
        return _ardupilot_filter(controller, advised, peak)
    return _px4_filter(controller, advised, peak)


def _ardupilot_filter(controller: Controller, advised: Parameters, peak: float) -> _TriedFilter:
    """Returns ArduPilot's first harmonic notch.

    Args:
        controller: controller with the parameters of the log.
        advised: parameters that the advice sets; empty without one.
        peak: frequency of the strongest line, Hz.
    """
    logged = controller.parameters
    enable = f"{ARDUPILOT_PREFIX}ENABLE"
    center = float(f"{peak:.3g}")
    parameters = {
        enable: 1.0,
        f"{ARDUPILOT_PREFIX}MODE": float(NotchMode.FIXED),
        f"{ARDUPILOT_PREFIX}FREQ": center,
        f"{ARDUPILOT_PREFIX}BW": float(f"{RELATIVE_BANDWIDTHS[-1] * center:.2g}"),
        f"{ARDUPILOT_PREFIX}REF": 1.0,
        f"{ARDUPILOT_PREFIX}HMNCS": 1.0,
        f"{ARDUPILOT_PREFIX}ATT": ARDUPILOT_ATTENUATION,
    }
    is_on = bool(logged.get(enable, 0.0))
    source = logged if is_on else advised
    for name in parameters:
        parameters[name] = source.get(name, parameters[name])
    parameters[enable] = 1.0
    names = {"centre": "FREQ", "width": "BW", "depth": "ATT", "harmonics": "HMNCS"}
    switch = {enable: 0.0}
    return _TriedFilter(
        parameters,
        switch,
        {setting: f"{ARDUPILOT_PREFIX}{ending}" for setting, ending in names.items()},
        is_on,
        is_logged=enable in logged,
        with_filter=controller.with_parameters(parameters),
        without_filter=controller.with_parameters(switch),
    )


def _px4_filter(controller: Controller, advised: Parameters, peak: float) -> _TriedFilter:
    """Returns PX4's first static notch.

    Args:
        controller: controller with the parameters of the log.
        advised: parameters that the advice sets, perhaps those of the dynamic notch, which is another filter.
        peak: frequency of the strongest line, Hz.
    """
    logged = controller.parameters
    center_name, width_name = PX4_NOTCH
    if center_name not in logged and OLDER_PX4_NOTCH[0] in logged:
        center_name, width_name = OLDER_PX4_NOTCH
    is_on = logged.get(center_name, 0.0) > 0 and logged.get(width_name, 0.0) > 0
    center = float(f"{peak:.3g}")
    parameters = {
        center_name: center,
        width_name: float(f"{RELATIVE_BANDWIDTHS[-1] * center:.2g}"),
    }
    source = logged if is_on else advised
    for name in parameters:
        parameters[name] = source.get(name, parameters[name])
    switch = {center_name: 0.0}
    return _TriedFilter(
        parameters,
        switch,
        {"centre": center_name, "width": width_name},
        is_on,
        is_logged=center_name in logged,
        with_filter=controller.with_parameters(parameters),
        without_filter=controller.with_parameters(switch),
    )


def _sliders(tried: _TriedFilter, gyro_rate: float) -> tuple[NotchSlider, ...]:
    """Returns the sliders with the ranges of the autopilots' documentation, or wider ones where the log has more.

    Args:
        tried: the filter.
        gyro_rate: rate at which it runs, Hz: above a share of it, a notch is off.
    """
    highest_center = min(495.0, np.floor(MAX_NOTCH_FREQUENCY_RATIO * gyro_rate))
    ranges = {
        "centre": ("Centre", "Hz", 10.0, highest_center),
        "width": ("Width", "Hz", 5.0, 250.0),
        "depth": ("Depth", "dB", 5.0, 50.0),
    }
    sliders = []
    for setting, (label, unit, lowest, highest) in ranges.items():
        if setting in tried.names:
            name = tried.names[setting]
            value = tried.parameters[name]
            ends = (min(lowest, np.floor(value)), max(highest, np.ceil(value)))
            sliders.append(NotchSlider(name, label, unit, *ends, value))
    return tuple(sliders)


def _harmonics(tried: _TriedFilter) -> dict[int, bool]:
    """Returns whether each multiple of the centre has a notch at first; empty where the filter has no mask."""
    if "harmonics" not in tried.names:
        return {}
    mask = int(tried.parameters[tried.names["harmonics"]])
    return {k: bool(mask >> (k - 1) & 1) for k in range(1, OFFERED_HARMONICS + 1)}


def _filter_as_json(tried: _TriedFilter) -> JsonValues:
    """Returns the filter by the keys that ``notch.js`` reads, with the constants of its equations."""
    is_ardupilot = tried.with_filter.is_ardupilot
    parameters = tried.with_filter.parameters
    return {
        "parameters": tried.parameters,
        "off": tried.switch,
        "names": tried.names,
        "wasOn": tried.is_on,
        "rate": tried.with_filter.gyro_rate,
        "maxRatio": MAX_NOTCH_FREQUENCY_RATIO,
        "isArduPilot": is_ardupilot,
        "leastCentrePerWidth": MIN_CENTER_PER_BANDWIDTH,
        "hoverRatio": hover_center_ratio(parameters, ARDUPILOT_PREFIX) if is_ardupilot else 1.0,
        "sources": notch_source_count(parameters, ARDUPILOT_PREFIX) if is_ardupilot else 1,
        "mostHarmonics": MAX_HARMONICS,
        "minGain": MIN_GAIN,
    }


def _charts(
    tried: _TriedFilter, spectrum: Spectrum, peak: float, crossover: Mark, has_spectrum: bool
) -> Group:
    """Returns the charts of the spectrum, and of the filter's gain and phase lag, with the filter as the log has it.

    Args:
        tried: the filter.
        spectrum: spectrum of the gyro, if possible before its filters.
        peak: frequency of the strongest line, Hz.
        crossover: mark of the frequency at which the phase lag is stated.
        has_spectrum: whether the spectrum with another filter is known.
    """
    nyquist = MAX_NOTCH_FREQUENCY_RATIO * tried.with_filter.gyro_rate
    highest = min(max(RESPONSE_SPAN, spectrum.nyquist_frequency), nyquist)
    axis = FREQUENCY._replace(limits=(MIN_FREQUENCY, highest))
    frequency = np.geomspace(MIN_FREQUENCY, highest, RESPONSE_POINTS)
    response = _response(tried, frequency)
    gain = 20 * np.log10(np.maximum(abs(response), MIN_GAIN))
    phase = np.degrees(np.angle(response))
    charts = [
        Chart(
            "Gain of this notch",
            axis,
            Axis("Gain of this notch (dB)", limits=(20 * np.log10(MIN_GAIN), 3.0)),
            (Line("gain", COMMAND, frequency, gain),),
            marks=(crossover, Mark(peak, "peak")),
            group="notch",
        ),
        Chart(
            "Phase of this notch",
            axis,
            Axis("Phase of this notch (°)"),
            (Line("phase", COMMAND, frequency, phase),),
            marks=(crossover,),
            group="notch",
        ),
    ]
    if has_spectrum:
        charts.insert(0, _spectrum_chart(tried, spectrum, peak, highest))
    return Group.side_by_side(charts)


def _response(tried: _TriedFilter, frequency: Array) -> NDArray[np.complex128]:
    """Returns the response of the notch alone (F,), complex, as the log has it: 1 where it is off there."""
    if not tried.is_on:
        return np.ones(len(frequency), complex)
    # The controller lists the notches of this filter first.
    count = len(tried.with_filter.notches) - len(tried.without_filter.notches)
    return notch_response(tried.with_filter.notches[:count], tried.with_filter.gyro_rate, frequency)


def _spectrum_chart(tried: _TriedFilter, spectrum: Spectrum, peak: float, highest: float) -> Chart:
    """Returns the chart of the gyro's spectrum as measured, behind all other filters, and behind this one too.

    The script puts the last line where the sliders have it, and takes the one before for what the notch gets. Behind
    the filters, what is measured is what it gets.

    Args:
        tried: the filter.
        spectrum: spectrum of the gyro before its filters or, with the notch off, behind them.
        peak: frequency of the strongest line, Hz.
        highest: highest frequency of the chart, Hz.
    """
    density = spectrum.mean_density.sum(axis=0)
    is_shown = (spectrum.frequency >= MIN_FREQUENCY) & (spectrum.frequency <= highest)
    frequency, power = max_decimated(
        spectrum.frequency[is_shown], density[is_shown], RESPONSE_POINTS
    )
    lines = []
    if spectrum.name == UNFILTERED_GYRO:
        lines.append(Line("before all filters", MEASURED, frequency, power))
        power = power * abs(gyro_response(tried.without_filter, frequency)) ** 2
        lines.append(
            Line("without this notch", PREDICTED, frequency, power, style=LineStyle.DASHES)
        )
    else:
        lines.append(Line("measured", MEASURED, frequency, power))
    power = power * abs(_response(tried, frequency)) ** 2
    lines.append(Line("with this notch", COMMAND, frequency, power))
    unit = "(rad/s)²/Hz"
    return Chart(
        "Gyro, power",
        FREQUENCY._replace(limits=(MIN_FREQUENCY, highest)),
        Axis(f"Gyro, power ({unit})", is_logarithmic=True),
        tuple(line._replace(y=np.maximum(line.y, MIN_DENSITY)) for line in lines),
        marks=(Mark(peak, "peak"),),
        group="notch",
    )
