"""Chapters of vibration: over time, and as spectra of gyro, accelerometer, motors' demand and D term, with filters."""

from collections.abc import Mapping
from types import MappingProxyType

from mavdem.assessment import Assessment
from mavdem.assessment.noise_spectra import GYRO, MeasuredNoise
from mavdem.containers import Names
from mavdem.dataset.axes import AXES
from mavdem.facts.fact import Level
from mavdem.facts.lights import Light
from mavdem.facts.margins import MarginsLight
from mavdem.loops.axis_loops import Loop
from mavdem.report.blocks import Blocks, Sentence
from mavdem.report.charts.chart import Chart, Group
from mavdem.report.charts.flight_charts import (
    UNNAMED_LINE,
    axis_spectrum_charts,
    fastest_loop,
    spectrogram_charts,
)
from mavdem.report.charts.hardware_charts import raw_sensor_charts, vibration_charts
from mavdem.report.charts.timeline import Timeline
from mavdem.report.numbers import listed
from mavdem.report.pages.page import Chapter, Section
from mavdem.report.tuning.details import filter_sentences
from mavdem.vibration.folding import faster_frequencies, folded_frequency, possibly_folded_peak
from mavdem.vibration.spectra import Spectrum

ACCELEROMETER = "accelerometer"
"""Name of the accelerometer in ``MeasuredNoise``."""

CONTROLLER_SIGNALS = "demand", "d_term"
"""Signals of the controllers whose spectra are shown, by their names in ``MeasuredNoise``."""

AXES_OF_SENSORS: dict[str, Names] = {ACCELEROMETER: ("forward", "right", "down"), GYRO: AXES}
"""Names of the three axes of a sensor. Spectra of other signals are about roll, pitch and yaw."""

NO_LOOPS: Mapping[str, Loop] = MappingProxyType({})
"""The loops of a signal that is in none, or of a vehicle whose loops are not identified."""

VIBRATION_CAPTION = """\
The light judges the mean of settled flight, and no clips of an impact. Clips add up from the left."""
"""What stands below the charts of vibration and clips."""

UNNAMED_LINE_CAPTION = f"""\
“{UNNAMED_LINE}” marks a line whose cause is not known. Notch filters act on the gyro, whatever the accelerometer\
 shows."""
"""What stands below spectra with such a line."""

SLOW_SPECTRUM_CAPTION = """\
Of the filtered signal, what is above {nyquist:.0f} Hz appears below it (aliasing): the lines do not show how much\
 the filters remove."""
"""What stands below spectra of a sensor that was sampled more slowly after its filters than before."""

FOLDED_OSCILLATION = """\
the oscillation at {frequency:.2g} Hz appears at {folded:.2g} Hz, since this gyro was logged at {rate:.3g} Hz\
 (aliasing)."""
"""What is said of an axis below the spectra of a gyro that was logged too slowly for its oscillation."""

FOLDED_PEAK = """\
a peak at {frequency:.2g} Hz. A gyro logged at {rate:.3g} Hz does not show whether that is its frequency:\
 {others} Hz would appear there, too (aliasing)."""
"""What is said of an axis with a peak of unknown cause below the spectra of a slowly logged gyro."""

NO_OSCILLATIONS: Mapping[str, float] = MappingProxyType({})
"""The frequencies of oscillation of a vehicle that does not oscillate."""


def vibration_chapter(
    assessment: Assessment, timeline: Timeline | None, *, has_spectrograms: bool
) -> Chapter:
    """Returns the chapter on vibration: its strength over time, and the spectra of gyro and accelerometer.

    Vibration and clips (samples at the end of an accelerometer's range) over time come first, with the limits by which
    they are judged. The spectra of the gyro show where they come from. Parts to open follow, since two rows of plots
    say enough at first: the spectrograms of the gyro, the spectra of the accelerometer, and the samples of both
    sensors.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        timeline: charts over time, whose events are marked; None if no vehicle flew.
        has_spectrograms: whether there are spectrograms, which take much of a page.
    """
    gyro = gyro_chapter(assessment, timeline, has_spectrograms=has_spectrograms)
    vibration_over_time: list[Chart] = []
    raw_charts: list[Chart] = []
    if timeline is not None and assessment.evidence is not None:
        light = assessment.lights[Light.VIBRATION]
        vibration_over_time = vibration_charts(assessment.evidence, timeline, light)
        # A page without room for spectrograms has none for the samples of the sensors either.
        if has_spectrograms:
            raw_charts = raw_sensor_charts(assessment.evidence, timeline, AXES_OF_SENSORS)
    groups = [*gyro.groups]
    if vibration_over_time:
        groups.insert(0, Group.side_by_side(vibration_over_time, VIBRATION_CAPTION))
    sections = [*gyro.sections]
    accelerometer_groups = _spectra(assessment.noise, ACCELEROMETER)
    if has_spectrograms:
        accelerometer_groups += _spectrograms(assessment.noise, ACCELEROMETER, timeline)
    if accelerometer_groups:
        sections.append(Section("Spectra of the accelerometer", groups=accelerometer_groups))
    if raw_charts:
        raw_group = Group.side_by_side(raw_charts)
        sections.append(Section("Raw acceleration and angular rate", groups=[raw_group]))
    return gyro._replace(title="Vibration", groups=groups, sections=sections)


def gyro_chapter(
    assessment: Assessment, timeline: Timeline | None, *, has_spectrograms: bool
) -> Chapter:
    """Returns the chapter of the gyro's vibration: its spectra, the filters of the fastest loop, and spectrograms.

    The fastest loop is the one with the highest crossover frequency, which the filters' delay concerns most. The
    spectrograms are a part to open.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        timeline: charts over time, whose events are marked in the spectrogram.
        has_spectrograms: whether there are spectrograms, which take much of a page.
    """
    noise = assessment.noise
    blocks = Blocks()
    for fact in noise.facts:
        # What the log does not show needs the advice how to record it.
        is_unknown = fact.level is Level.UNKNOWN
        blocks.append(Sentence(fact.sentence_and_remedy if is_unknown else str(fact)))
    loops = assessment.identified_loops
    loop = fastest_loop(loops)
    if loop is not None:
        blocks += filter_sentences(loop)
    sections = []
    if has_spectrograms:
        spectrograms = _spectrograms(noise, GYRO, timeline)
        if spectrograms:
            sections.append(Section("Gyro over time and throttle", groups=spectrograms))
    groups = _spectra(noise, GYRO, loops, _frequencies_of_oscillation(assessment))
    return Chapter("Spectra", blocks, groups, sections=sections)


def _frequencies_of_oscillation(assessment: Assessment) -> dict[str, float]:
    """Returns the frequency at which each axis oscillates or resonates, Hz, such as {"roll": 7.5}; others left out.

    Args:
        assessment: all results on a vehicle of the log, with the limit cycle and the measured margins of each axis.
    """
    frequencies = {}
    for margins in assessment.margins:
        for fact in margins.facts:
            if fact.code is MarginsLight.RESONATES:
                frequencies[margins.axis] = fact.figures["frequency"]
    if assessment.evidence is not None and assessment.evidence.condition.oscillation is not None:
        limit_cycle = assessment.evidence.condition.oscillation
        for cycle in (limit_cycle, *limit_cycle.other_axes):
            if cycle.frequency is not None:
                frequencies[cycle.axis] = cycle.frequency
    return frequencies


def controller_spectra_chapter(
    noise: MeasuredNoise, timeline: Timeline | None, *, has_spectrograms: bool
) -> Chapter:
    """Returns the folded chapter of the spectra of the motors' demand and of the D term, as far as logged.

    Args:
        noise: spectra of all signals.
        timeline: timeline of the flight; None if no vehicle flew.
        has_spectrograms: whether there are spectrograms, which take much of a page.
    """
    groups: list[Group] = []
    for signal in CONTROLLER_SIGNALS:
        groups += _spectra(noise, signal)
        if has_spectrograms:
            groups += _spectrograms(noise, signal, timeline)
    title = "Controller spectra"
    return Chapter(title, (), groups, folded=True)


def _spectra(
    noise: MeasuredNoise,
    sensor: str,
    loops: Mapping[str, Loop] = NO_LOOPS,
    oscillations: Mapping[str, float] = NO_OSCILLATIONS,
) -> list[Group]:
    """Returns the spectra of the three axes of a sensor before and after its filters, side by side.

    A caption explains lines of unknown cause, if the charts mark any. It also warns of aliasing, if the filtered signal
    was logged more slowly than the signal before the filters.

    Args:
        noise: spectra of all sensors.
        sensor: name of the sensor in ``noise``.
        loops: identified loop of each axis, whose crossover and filters are drawn.
        oscillations: frequency at which an axis oscillates, Hz, by the axis.

    Returns:
        One group of charts; none for a sensor that was not logged.
    """
    if _first_spectrum(noise, sensor) is None:
        return []
    charts = axis_spectrum_charts(noise, loops, sensor, AXES_OF_SENSORS.get(sensor, AXES))
    # Spectral lines are marked in the charts with their cause.
    mark_names = set[str]()
    for chart in charts.values():
        mark_names.update(mark.name for mark in chart.marks)
    captions = []
    if UNNAMED_LINE in mark_names:
        captions.append(UNNAMED_LINE_CAPTION)
    slow_spectrum = noise.slow_filtered_spectrum(sensor)
    if slow_spectrum is not None:
        nyquist = slow_spectrum.nyquist_frequency
        captions.append(SLOW_SPECTRUM_CAPTION.format(nyquist=nyquist))
    if sensor == GYRO:
        captions += _folding_captions(noise, oscillations)
    charts_of_axes = {axis: [chart] for axis, chart in charts.items()}
    return [Group.of_axes(charts_of_axes, caption=" ".join(captions))]


def _folding_captions(noise: MeasuredNoise, oscillations: Mapping[str, float]) -> list[str]:
    """Returns sentences on peaks in the spectra of a slowly logged gyro that may stand for a faster motion (aliasing).

    Args:
        noise: spectra of all sensors, the gyro's among them.
        oscillations: frequency at which an axis oscillates, Hz, by the axis.

    Returns:
        A sentence for all axes with the same peak, such as "Roll and pitch: …".
    """
    spectrum = _first_spectrum(noise, GYRO)
    assert spectrum is not None
    axes_by_text: dict[str, list[str]] = {}
    for index, axis in enumerate(AXES):
        text = _folding_text(spectrum, index, oscillations.get(axis))
        if text:
            axes_by_text.setdefault(text, []).append(axis)
    return [f"{listed(axes).capitalize()}: {text}" for text, axes in axes_by_text.items()]


def _folding_text(spectrum: Spectrum, axis: int, oscillation: float | None) -> str:
    """Returns where an oscillation beyond a spectrum appears in it, or what a slow peak may be; empty without either.

    Args:
        spectrum: spectrum of the gyro.
        axis: number of the axis, from 0.
        oscillation: frequency at which the axis oscillates, Hz; None if it does not.
    """
    nyquist = spectrum.nyquist_frequency
    if oscillation is not None and oscillation > nyquist:
        template, frequency = FOLDED_OSCILLATION, oscillation
    else:
        peak = possibly_folded_peak(spectrum, axis)
        if peak is None:
            return ""
        template, frequency = FOLDED_PEAK, peak
    others = [f"{other:.2g}" for other in faster_frequencies(frequency, nyquist)]
    return template.format(
        frequency=frequency,
        rate=2 * nyquist,
        folded=folded_frequency(frequency, nyquist),
        others=listed(others),
    )


def _spectrograms(noise: MeasuredNoise, sensor: str, timeline: Timeline | None) -> list[Group]:
    """Returns the spectrograms of a sensor over time and over throttle, side by side.

    Args:
        noise: spectra of all sensors.
        sensor: name of the sensor in ``noise``.
        timeline: timeline of the flight, whose events are marked in the spectrogram over time; None if no vehicle flew.

    Returns:
        One group of charts; none for a sensor that was not logged.
    """
    spectrum = _first_spectrum(noise, sensor)
    if spectrum is None:
        return []
    spectrograms = [*spectrogram_charts(spectrum)]
    # The first spectrogram is over time; a second one, over throttle, has no place for events.
    if timeline is not None:
        spectrograms[0] = timeline.marked(spectrograms[0])._replace(spans=())
    caption = "All axes together; 0 dB is the highest power in the plot."
    return [Group.side_by_side(spectrograms, caption)]


def _first_spectrum(noise: MeasuredNoise, sensor: str) -> Spectrum | None:
    """Returns the spectrum of a sensor before its filters or, if that was not logged, behind them; None without any."""
    return noise.spectra.get(f"{sensor}_before", noise.spectra.get(sensor))
