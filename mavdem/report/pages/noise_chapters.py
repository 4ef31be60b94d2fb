"""Chapters of the spectra of gyro, accelerometer, motors' demand and D term, with the filters of the fastest loop."""

from collections.abc import Iterator

from mavdem.assessment import Assessment
from mavdem.assessment.noise_spectra import GYRO, MeasuredNoise
from mavdem.loops.axis_loops import Loop
from mavdem.report.blocks import Blocks, Sentence
from mavdem.report.charts.chart import Group
from mavdem.report.charts.flight_charts import spectrogram_charts, spectrum_chart
from mavdem.report.charts.timeline import Timeline
from mavdem.report.loops import filter_sentences
from mavdem.report.pages.page import Chapter

OTHER_SENSORS = "accelerometer", "demand", "d_term"
"""Signals besides the gyro whose spectra are shown, by their names in ``MeasuredNoise``."""


def gyro_chapter(
    assessment: Assessment, timeline: Timeline | None, *, has_spectrograms: bool
) -> Chapter:
    """Returns the chapter of the gyro's vibration: its spectrum, the filters of the fastest loop, and spectrograms.

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


def other_sensors_chapter(
    noise: MeasuredNoise, timeline: Timeline | None, *, has_spectrograms: bool
) -> Chapter:
    """Returns the folded chapter of the spectra of accelerometer, motors' demand and D term, as far as logged.

    Args:
        noise: spectra of all sensors.
        timeline: timeline of the flight; None if no vehicle flew.
        has_spectrograms: whether there are spectrograms, which take much of a page.
    """
    groups: list[Group] = []
    for sensor in OTHER_SENSORS:
        groups += _spectrum_groups(noise, sensor, timeline, has_spectrograms=has_spectrograms)
    title = "Other spectra"
    return Chapter(title, (), groups, folded=True, is_printed_closed=False)


def _spectrum_groups(
    noise: MeasuredNoise,
    sensor: str,
    timeline: Timeline | None,
    *,
    has_spectrograms: bool,
    loop: Loop | None = None,
) -> Iterator[Group]:
    """Yields the spectrum of a sensor before and after its filters, and its spectrograms; nothing if not logged.

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
    yield Group.side_by_side([spectrum_chart(noise, loop, sensor)])
    if has_spectrograms:
        charts = [*spectrogram_charts(spectrum)]
        # The first spectrogram is over time; a second one, over throttle, has no place for events.
        if timeline is not None:
            charts[0] = timeline.marked(charts[0])._replace(spans=())
        yield Group.side_by_side(charts, "The stronger the blue, the higher the power.")
