"""Chapters of vibration: over time, and as spectra of gyro, accelerometer, motors' demand and D term, with filters."""

from collections.abc import Iterator

from mavdem.assessment import Assessment
from mavdem.assessment.noise_spectra import GYRO, MeasuredNoise
from mavdem.dataset.axes import AXES
from mavdem.facts.lights import Light
from mavdem.loops.axis_loops import Loop
from mavdem.report.blocks import Blocks, Sentence
from mavdem.report.charts.chart import Group
from mavdem.report.charts.flight_charts import (
    UNNAMED_LINE,
    axis_spectrum_charts,
    spectrogram_charts,
)
from mavdem.report.charts.hardware_charts import vibration_charts
from mavdem.report.charts.timeline import Timeline
from mavdem.report.loops import filter_sentences
from mavdem.report.pages.page import Chapter

ACCELEROMETER = "accelerometer"
"""Name of the accelerometer in ``MeasuredNoise``."""

CONTROLLER_SIGNALS = "demand", "d_term"
"""Signals of the controllers whose spectra are shown, by their names in ``MeasuredNoise``."""

AXES_OF_SENSORS = {ACCELEROMETER: ("forward", "right", "down")}
"""Names of the three axes of a spectrum, by the sensor. All others are about roll, pitch and yaw."""

VIBRATION_CAPTION = """\
The light judges the mean of settled flight, not single peaks. Clips add up from the left edge on; those of an impact\
 are drawn, but not judged."""
"""What stands below the charts of vibration and clips."""

UNNAMED_LINE_CAPTION = f"""\
“{UNNAMED_LINE}” marks a line whose cause is not known. Notch filters act on the gyro, whatever the accelerometer\
 shows."""
"""What stands below spectra with such a line."""


def vibration_chapter(
    assessment: Assessment, timeline: Timeline | None, *, has_spectrograms: bool
) -> Chapter:
    """Returns the chapter to which the light of the vibration leads: vibration, clips and spectra of gyro and IMU.

    Vibration and clips over time come first, with the limits of the light. The spectra show where they come from.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        timeline: charts over time, whose events are marked; None if no vehicle flew.
        has_spectrograms: whether there are spectrograms, which take much of a page.
    """
    gyro = gyro_chapter(assessment, timeline, has_spectrograms=has_spectrograms)
    groups: list[Group] = []
    if timeline is not None and assessment.evidence is not None:
        light = assessment.lights[Light.VIBRATION]
        charts = vibration_charts(assessment.evidence, timeline, light)
        if charts:
            groups.append(Group.side_by_side(charts, VIBRATION_CAPTION))
    groups += gyro.groups
    groups += _spectrum_groups(
        assessment.noise, ACCELEROMETER, timeline, has_spectrograms=has_spectrograms
    )
    return gyro._replace(title="Vibration", groups=groups)


def gyro_chapter(
    assessment: Assessment, timeline: Timeline | None, *, has_spectrograms: bool
) -> Chapter:
    """Returns the chapter of the gyro's vibration: its spectra, the filters of the fastest loop, and spectrograms.

    The fastest loop is the one with the highest crossover frequency, which the filters' delay concerns most.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        timeline: charts over time, whose events are marked in the spectrogram.
        has_spectrograms: whether there are spectrograms, which take much of a page.
    """
    noise = assessment.noise
    blocks: Blocks = [Sentence(str(fact)) for fact in noise.facts]
    loop = fastest_loop(assessment)
    if loop is not None:
        blocks += filter_sentences(loop)
    groups = [
        *_spectrum_groups(noise, GYRO, timeline, has_spectrograms=has_spectrograms, loop=loop)
    ]
    return Chapter("Spectra", blocks, groups)


def fastest_loop(assessment: Assessment) -> Loop | None:
    """Returns the identified rate loop with the highest crossover frequency, which filters concern most."""
    loops = assessment.identified_loops.values()
    return max(loops, key=lambda loop: loop.crossover, default=None)


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
        groups += _spectrum_groups(noise, signal, timeline, has_spectrograms=has_spectrograms)
    title = "Spectra of the controllers"
    return Chapter(title, (), groups, folded=True, is_printed_closed=False)


def _spectrum_groups(
    noise: MeasuredNoise,
    sensor: str,
    timeline: Timeline | None,
    *,
    has_spectrograms: bool,
    loop: Loop | None = None,
) -> Iterator[Group]:
    """Yields the spectra of the three axes of a sensor before and after its filters, and its spectrograms.

    A sensor that was not logged yields nothing.

    Args:
        noise: spectra of all sensors.
        sensor: name of the sensor in ``noise``.
        timeline: timeline of the flight, whose events are marked in the spectrogram over time.
        has_spectrograms: whether there are spectrograms, which take much of a page.
        loop: the loop whose filters are drawn, if any.
    """
    spectrum = noise.spectra.get(f"{sensor}_before", noise.spectra.get(sensor))
    if spectrum is None:
        return
    charts = axis_spectrum_charts(noise, loop, sensor, AXES_OF_SENSORS.get(sensor, AXES))
    mark_names = {mark.name for chart in charts.values() for mark in chart.marks}
    caption = UNNAMED_LINE_CAPTION if UNNAMED_LINE in mark_names else ""
    yield Group.of_axes({axis: [chart] for axis, chart in charts.items()}, caption=caption)
    if has_spectrograms:
        spectrograms = [*spectrogram_charts(spectrum)]
        # The first spectrogram is over time; a second one, over throttle, has no place for events.
        if timeline is not None:
            spectrograms[0] = timeline.marked(spectrograms[0])._replace(spans=())
        yield Group.side_by_side(
            spectrograms, "All axes together; 0 dB is the highest power in the plot."
        )
