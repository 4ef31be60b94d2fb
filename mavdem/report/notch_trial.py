"""A trial of the gyro's notch filters on a flight's page: their effect on the spectrum, and their phase lag.

The script ``notch.js`` computes the responses of ``mavdem.loops.filters``, which has their sources, for the filters of
``tried_filters``.
"""

from collections.abc import Iterator, Sequence
from pathlib import PurePath
from typing import NamedTuple

import numpy as np

from mavdem.assessment.noise_spectra import GYRO, UNFILTERED_GYRO, MeasuredNoise
from mavdem.containers import JsonValues, Numbers
from mavdem.ingest.parameter_file import parameter_files
from mavdem.ingest.telemetry import Telemetry
from mavdem.loops.ardupilot_controller import (
    MAX_HARMONICS,
    MIN_CENTER_PER_BANDWIDTH,
    NotchMode,
    hover_center_ratio,
    notch_source_count,
)
from mavdem.loops.autopilot_parameters import Notch
from mavdem.loops.axis_loops import Loop
from mavdem.loops.controllers import Controller
from mavdem.loops.filters import MAX_NOTCH_FREQUENCY_RATIO, gyro_response, notch_response
from mavdem.loops.resonance import MAX_LOOP_FREQUENCY
from mavdem.report.charts.chart import FREQUENCY, Axis, Chart, Group, Line, LineStyle, Mark
from mavdem.report.gain_changes import READERS
from mavdem.report.numbers import display_density_unit, listed
from mavdem.report.palette import BAD, COMMAND, MEASURED, PREDICTED
from mavdem.report.tried_filters import (
    TriedFilter,
    frequency_of_most_vibration,
    logged_notches,
    strongest_peaks,
    tried_filters,
    without_filters,
)
from mavdem.vibration.spectra import Spectrum, max_decimated

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
"""Lowest spectral density that is drawn, in the gyro's unit²/Hz, so that a logarithmic axis has no zero."""

OFFERED_HARMONICS = 8
"""Multiples of the centre that are offered; a mask with higher ones in the log keeps them."""

REMARK = "Notch filter that was tried on the page"
"""First line of the parameter files."""


class DocumentedRange(NamedTuple):
    """The values of a setting of a notch filter, as the autopilots document them."""

    label: str
    """What it sets."""

    unit: str
    """Unit of its values."""

    lowest: float
    highest: float


SLIDER_RANGES = {
    "centre": DocumentedRange("Centre", "Hz", 10.0, 495.0),
    "width": DocumentedRange("Width", "Hz", 5.0, 250.0),
    "depth": DocumentedRange("Depth", "dB", 5.0, 50.0),
}
"""Range of each setting that has a slider, as the documentation of PX4 and ArduPilot has it."""


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


class FilterForm(NamedTuple):
    """The settings of one notch filter."""

    title: str
    """Its name; empty where there is one filter."""

    sliders: tuple[NotchSlider, ...]
    """Centre, bandwidth and, where the autopilot has one, depth."""

    harmonics: dict[int, bool]
    """Whether each multiple of the centre has a notch at first; empty for PX4, whose notch has one centre."""

    harmonics_parameter: str
    """Name of the parameter with the mask of the multiples; empty for PX4."""

    is_on: bool
    """Whether the log has the filter on."""


class NotchTrial(NamedTuple):
    """Notch filters with sliders, the charts that follow them, and what the script needs to compute these."""

    filters: tuple[FilterForm, ...]
    """The filters, at least one."""

    charts: Group
    """Spectrum, gain and phase, with the filters as they are at first."""

    remarks: tuple[str, ...]
    """What limits the trial, in sentences."""

    endings: tuple[str, ...]
    """Endings of the parameter files, with who reads each."""

    model: JsonValues
    """All that ``notch.js`` computes with."""

    @property
    def is_on(self) -> bool:
        """Whether the log has one of the filters on."""
        return any(form.is_on for form in self.filters)


def notch_trial(
    log_name: str,
    vehicle: Telemetry,
    noise: MeasuredNoise,
    controller: Controller | None,
    loop: Loop | None,
    motor_frequencies: Numbers = (),
) -> NotchTrial | None:
    """Returns what a page shows of notch filters of the gyro that its reader can try, by changing their settings.

    The filters begin with the settings of the log. One that is off there is placed on a spectral line that it could
    attenuate.

    Args:
        log_name: name of the log, after which the parameter files are named.
        vehicle: the vehicle, which the parameter files are for.
        noise: spectra of the flight with their lines.
        controller: controller with the gyro's filters; None if it is not known.
        loop: the identified rate loop with the highest crossover frequency; None if none is identified.
        motor_frequencies: revolutions per second of each motor in flight; empty if they were not measured.

    Returns:
        The trial; None without a spectrum of the gyro that reaches above all rate loops.
    """
    spectrum = noise.gyro_spectrum
    if spectrum is None or controller is None:
        return None
    if spectrum.nyquist_frequency <= MAX_LOOP_FREQUENCY:
        return None
    peaks = strongest_peaks(noise, spectrum)
    # Without a peak a filter begins somewhere in the range of vibration, and no peak is marked.
    first_centers = peaks or (frequency_of_most_vibration(spectrum),)
    strongest_peak = peaks[0] if peaks else None
    filters = tried_filters(controller, noise, first_centers, motor_frequencies)
    crossover_mark = _crossover_mark(loop)
    # If only the filtered gyro was logged, what the filters took cannot be known.
    is_any_filter_on = any(tried_filter.is_on for tried_filter in filters)
    has_only_filtered_gyro = spectrum.name == GYRO and is_any_filter_on
    text_by_ending = _parameter_files_of(filters, vehicle)
    return NotchTrial(
        tuple(_filter_forms(filters, controller.gyro_rate)),
        charts=_trial_charts(
            controller,
            filters,
            spectrum,
            strongest_peak,
            crossover_mark,
            has_spectrum=not has_only_filtered_gyro,
        ),
        remarks=tuple(
            _remarks_on_trial(
                filters,
                has_loop=loop is not None,
                has_peak=strongest_peak is not None,
                has_only_filtered_gyro=has_only_filtered_gyro,
                has_dynamic_notch=bool(controller.parameters.get("IMU_GYRO_DNF_EN", 0.0)),
            )
        ),
        endings=tuple(f"{ending} ({READERS[ending]})" for ending in text_by_ending),
        model={
            **_filter_equations(controller, filters),
            "peak": strongest_peak,
            "crossover": crossover_mark.x,
            "place": "At the crossover of" if loop is not None else "At",
            "files": [
                {"name": f"{PurePath(log_name).stem}.notch{ending}", "text": text}
                for ending, text in text_by_ending.items()
            ],
        },
    )


def _crossover_mark(loop: Loop | None) -> Mark:
    """Returns the mark in the charts at the frequency at which the phase lag of notch filters is stated.

    Args:
        loop: the identified rate loop, whose crossover frequency is marked. None if none is identified: then the mark
            is at ``ASSUMED_CROSSOVER``, without a label.
    """
    if loop is None:
        return Mark(ASSUMED_CROSSOVER, "", BAD)
    return Mark(loop.crossover, "crossover", BAD)


def _parameter_files_of(filters: Sequence[TriedFilter], vehicle: Telemetry) -> dict[str, str]:
    """Returns the parameter files that set some notch filters, for a reader of the page to download.

    Args:
        filters: the filters, each with its parameters.
        vehicle: the vehicle, which the files are for.

    Returns:
        The text of each file by the ending of its name, such as ".params", in the order of the endings.
    """
    parameters: dict[str, float] = {}
    for tried_filter in filters:
        parameters |= tried_filter.parameters
    text_by_ending = parameter_files(parameters, vehicle, REMARK)
    return dict(sorted(text_by_ending.items()))


def _remarks_on_trial(
    filters: Sequence[TriedFilter],
    *,
    has_loop: bool,
    has_peak: bool,
    has_only_filtered_gyro: bool,
    has_dynamic_notch: bool,
) -> Iterator[str]:
    """Yields sentences on the limitations of a trial of notch filters, in which a page's reader changes their settings.

    Args:
        filters: the notch filters of the gyro that can be tried, at least one.
        has_loop: whether a rate loop is identified, at whose crossover frequency the phase lag is stated.
        has_peak: whether the spectrum has a peak, on which a notch filter may be placed.
        has_only_filtered_gyro: whether the log has the gyro only after one of these filters, which is on.
        has_dynamic_notch: whether PX4 has further notches, whose centres follow the motors or an FFT of the gyro.
    """
    if not has_loop:
        yield f"No rate loop is identified: the phase is stated at {ASSUMED_CROSSOVER:.0f} Hz."
    if not has_peak:
        yield "The gyro's spectrum has no peak that a notch filter could take."
    # The first filter can be tried even if the log has none of its parameters.
    if not filters[0].is_logged:
        yield "The log has none of its parameters: see whether the firmware has them."
    has_moving_center = False
    for title, tried_filter in zip(_titles(filters), filters, strict=True):
        # A single filter has no title.
        yield from _remark_on_moving_center(title or "It", tried_filter)
        # The centre of ArduPilot's filters may follow the motors. Names of their parameters have a common prefix.
        is_of_ardupilot = bool(tried_filter.prefix)
        if is_of_ardupilot and _tracking_mode(tried_filter) != NotchMode.FIXED:
            has_moving_center = True
    if has_moving_center:
        yield "In flight the centres move; the trial holds for the fixed ones that are shown."
    if has_dynamic_notch:
        yield "IMU_GYRO_DNF_EN adds notches that move with the motors: the trial holds for the fixed ones alone."
    if has_only_filtered_gyro:
        yield (
            "The log has the gyro only behind this filter, so its spectrum with another one is not known."
        )


def _tracking_mode(tried_filter: TriedFilter) -> float:
    """Returns what the centre of a notch filter follows in flight, such as the throttle or the speeds of the motors.

    Args:
        tried_filter: the filter, with its parameters.

    Returns:
        The value of its parameter for that, one of ``NotchMode``; ``NotchMode.FIXED`` if it has no such parameter.
    """
    return tried_filter.parameters.get(f"{tried_filter.prefix}MODE", NotchMode.FIXED)


def _titles(filters: Sequence[TriedFilter]) -> list[str]:
    """Returns the names of notch filters on a page: "Notch 1", "Notch 2" and so on; a single filter needs no name."""
    if len(filters) == 1:
        return [""]
    return [f"Notch {number}" for number in range(1, len(filters) + 1)]


def _remark_on_moving_center(name: str, tried_filter: TriedFilter) -> Iterator[str]:
    """Yields a sentence on what the centre of a notch filter follows; none if it is fixed.

    Args:
        name: name of the filter at the beginning of the sentence.
        tried_filter: the filter, with its parameters.
    """
    mode = _tracking_mode(tried_filter)
    if tried_filter.motor_frequencies:
        centers = listed(f"{frequency:.0f}" for frequency in tried_filter.motor_frequencies)
        yield f"{name} follows the motors' speeds, and is shown at those of the flight: {centers} Hz."
    elif mode == NotchMode.THROTTLE:
        yield f"{name} follows the throttle, and is shown where it is in hover."
    elif mode != NotchMode.FIXED:
        yield f"{name} follows a measurement, and is shown at its lowest frequency."


def _filter_forms(filters: Sequence[TriedFilter], gyro_rate: float) -> Iterator[FilterForm]:
    """Yields the form of each filter, by which a reader of the page changes its settings.

    A form has sliders for centre, bandwidth and depth. For ArduPilot it also has a box for each harmonic, a multiple of
    the centre at which there may be another notch.

    Args:
        filters: the filters, whose parameters are the settings that the forms show first.
        gyro_rate: rate at which the filters run, Hz, which limits their centres.
    """
    for title, tried_filter in zip(_titles(filters), filters, strict=True):
        yield FilterForm(
            title,
            sliders=_notch_sliders(tried_filter, gyro_rate),
            harmonics=_harmonics(tried_filter),
            harmonics_parameter=tried_filter.names.get("harmonics", ""),
            is_on=tried_filter.is_on,
        )


def _notch_sliders(tried_filter: TriedFilter, gyro_rate: float) -> tuple[NotchSlider, ...]:
    """Returns the sliders of a notch filter: one for each setting that the filter has as a parameter.

    A slider has its range in ``SLIDER_RANGES``, widened if the log has a value beyond it.

    Args:
        tried_filter: filter with its parameters.
        gyro_rate: rate at which the filter runs, Hz. Its centre must be below ``MAX_NOTCH_FREQUENCY_RATIO`` of this
            rate, since the autopilot switches off a notch above.

    Returns:
        Sliders with name, unit, range and value.
    """
    max_center = np.floor(MAX_NOTCH_FREQUENCY_RATIO * gyro_rate)
    sliders = []
    for setting, documented_range in SLIDER_RANGES.items():
        if setting not in tried_filter.names:
            continue
        highest_value = documented_range.highest
        if setting == "centre":
            highest_value = min(highest_value, max_center)
        name = tried_filter.names[setting]
        value = tried_filter.parameters[name]
        sliders.append(
            NotchSlider(
                name,
                label=documented_range.label,
                unit=documented_range.unit,
                lowest=min(documented_range.lowest, np.floor(value)),
                highest=max(highest_value, np.ceil(value)),
                value=value,
            )
        )
    return tuple(sliders)


def _harmonics(tried_filter: TriedFilter) -> dict[int, bool]:
    """Returns at which multiples of its centre a notch filter has another notch, with the settings shown first.

    ArduPilot sets them by the bits of one parameter: the lowest bit is of the centre itself, the next one of twice the
    centre, and so on.

    Args:
        tried_filter: the filter, with its parameters.

    Returns:
        For each multiple that is offered, whether it has a notch; empty if the filter has no such parameter.
    """
    if "harmonics" not in tried_filter.names:
        return {}
    mask = int(tried_filter.parameters[tried_filter.names["harmonics"]])
    has_notch = {}
    for multiple in range(1, OFFERED_HARMONICS + 1):
        bit = 1 << (multiple - 1)
        has_notch[multiple] = bool(mask & bit)
    return has_notch


def _filter_equations(controller: Controller, filters: Sequence[TriedFilter]) -> JsonValues:
    """Returns the filters, and the constants of their equations, for the script ``notch.js`` of the page.

    The script computes the response of the filters anew when a reader changes a setting.

    Args:
        controller: controller with the gyro's filters.
        filters: the notch filters that are tried.

    Returns:
        Values by the keys that the script reads:

        - ``filters``: for each filter its parameters; in "off" the ones that switch the filter off; in "names" the
          parameter of each setting; in "hoverRatio" the ratio of its centre in hover to its lowest one; in "sources"
          how many frequencies it follows, such as one for each motor; and in "motors" these frequencies in hover, Hz.
        - ``rate``: sampling rate of the gyro, Hz; ``maxRatio``: highest centre of a notch, relative to that.
        - ``leastCentrePerWidth``: lowest centre relative to the bandwidth; ``mostHarmonics``: largest number of
          harmonics; and ``minGain``: lowest gain that is drawn.
    """
    models = []
    for title, tried_filter in zip(_titles(filters), filters, strict=True):
        parameters = {**controller.parameters, **tried_filter.parameters}
        # The notches of PX4, whose parameters have no prefix, do not follow anything.
        hover_ratio = 1.0
        source_count = 1
        if tried_filter.prefix:
            hover_ratio = hover_center_ratio(parameters, tried_filter.prefix)
            source_count = notch_source_count(parameters, tried_filter.prefix)
        models.append(
            {
                "title": title,
                "parameters": tried_filter.parameters,
                "off": tried_filter.values_when_off,
                "names": tried_filter.names,
                "wasOn": tried_filter.is_on,
                "hoverRatio": hover_ratio,
                "sources": source_count,
                "motors": tried_filter.motor_frequencies,
            }
        )
    return {
        "filters": models,
        "rate": controller.gyro_rate,
        "maxRatio": MAX_NOTCH_FREQUENCY_RATIO,
        "isArduPilot": controller.is_ardupilot,
        "leastCentrePerWidth": MIN_CENTER_PER_BANDWIDTH,
        "mostHarmonics": MAX_HARMONICS,
        "minGain": MIN_GAIN,
    }


def _trial_charts(
    controller: Controller,
    filters: Sequence[TriedFilter],
    spectrum: Spectrum,
    peak: float | None,
    crossover: Mark,
    *,
    has_spectrum: bool,
) -> Group:
    """Returns the charts of the spectrum, and of the filters' gain and phase lag, with the filters as the log has them.

    Args:
        controller: controller with the parameters of the log.
        filters: notch filters of the gyro, each with the parameters that set it.
        spectrum: spectrum of the gyro, if possible before its filters.
        peak: frequency of the strongest peak, Hz, which is marked; None if the spectrum has none.
        crossover: mark of the frequency at which the phase lag is stated.
        has_spectrum: whether the spectrum with other filters is known.
    """
    nyquist = MAX_NOTCH_FREQUENCY_RATIO * controller.gyro_rate
    max_frequency = min(max(RESPONSE_SPAN, spectrum.nyquist_frequency), nyquist)
    axis = FREQUENCY._replace(limits=(MIN_FREQUENCY, max_frequency))
    frequency = np.geomspace(MIN_FREQUENCY, max_frequency, RESPONSE_POINTS)
    notches = logged_notches(controller, filters)
    response = notch_response(notches, controller.gyro_rate, frequency)
    gain = 20 * np.log10(np.maximum(abs(response), MIN_GAIN))
    phase = np.degrees(np.angle(response))
    filter_text = "this notch" if len(filters) == 1 else "these notches"
    peak_marks = () if peak is None else (Mark(peak, "peak"),)
    charts = [
        Chart(
            f"Gain of {filter_text}",
            axis,
            Axis(f"Gain of {filter_text} (dB)", limits=(20 * np.log10(MIN_GAIN), 3.0)),
            (Line("gain", COMMAND, frequency, gain),),
            marks=(crossover, *peak_marks),
            group="notch",
        ),
        Chart(
            f"Phase of {filter_text}",
            axis,
            Axis(f"Phase of {filter_text} (°)"),
            (Line("phase", COMMAND, frequency, phase),),
            marks=(crossover,),
            group="notch",
        ),
    ]
    if has_spectrum:
        gyro = _GyroPower(spectrum, without_filters(controller, filters), notches, filter_text)
        charts.insert(0, _spectrum_chart(gyro, peak_marks, max_frequency))
    return Group.side_by_side(charts)


class _GyroPower(NamedTuple):
    """The gyro's spectrum with the notch filters that a reader can try, from which its chart is drawn."""

    spectrum: Spectrum
    """Spectrum of the gyro before its filters or, if only that was logged, behind them; the notches are off then."""

    controller_without_notches: Controller
    """The controller with all filters of the gyro but the notches that are tried."""

    notches: Sequence[Notch]
    """The notches that are tried, with their logged settings."""

    notch_name: str
    """Name of the notches in the legend, such as "this notch"."""


def _spectrum_chart(gyro: _GyroPower, peak_marks: tuple[Mark, ...], max_frequency: float) -> Chart:
    """Returns the chart of the gyro's power spectrum in up to three places of the chain of filters.

    The lines are the measured spectrum, the input of the notches that are tried (behind all other filters), and their
    output. A power spectrum is multiplied by the squared gain of a filter. If the log has only the filtered gyro, the
    measured spectrum is the input of the notches, and there are two lines. The page's script computes the last line
    anew, from the line before it, when a reader moves a slider.

    Args:
        gyro: spectrum and filters.
        peak_marks: mark of the strongest peak of the spectrum; empty if it has none.
        max_frequency: highest frequency of the chart, Hz.
    """
    spectrum = gyro.spectrum
    density = spectrum.mean_density.sum(axis=0)
    is_shown = (spectrum.frequency >= MIN_FREQUENCY) & (spectrum.frequency <= max_frequency)
    frequency, measured_power = max_decimated(
        spectrum.frequency[is_shown], density[is_shown], RESPONSE_POINTS
    )
    if spectrum.name == UNFILTERED_GYRO:
        other_filters = gyro_response(gyro.controller_without_notches, frequency)
        notch_input = measured_power * abs(other_filters) ** 2
        name_of_input = f"without {gyro.notch_name}"
        lines = [
            Line("before all filters", MEASURED, frequency, measured_power),
            Line(name_of_input, PREDICTED, frequency, notch_input, style=LineStyle.DASHES),
        ]
    else:
        notch_input = measured_power
        lines = [Line("measured", MEASURED, frequency, measured_power)]
    gyro_rate = gyro.controller_without_notches.gyro_rate
    notch_gain = abs(notch_response(gyro.notches, gyro_rate, frequency))
    notch_output = notch_input * notch_gain**2
    lines.append(Line(f"with {gyro.notch_name}", COMMAND, frequency, notch_output))
    unit = display_density_unit(spectrum.unit)
    return Chart(
        "Gyro, power",
        FREQUENCY._replace(limits=(MIN_FREQUENCY, max_frequency)),
        Axis(f"Gyro, power ({unit.name})", is_logarithmic=True),
        tuple(line._replace(y=unit.scale * np.maximum(line.y, MIN_DENSITY)) for line in lines),
        marks=peak_marks,
        group="notch",
    )
