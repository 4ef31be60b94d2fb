"""Recording: one learned flight as a Rerun file, with the blueprint that shows it."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from mavdem.arrays import Array
from mavdem.assessment import Assessment
from mavdem.assessment.axis.findings import resolved_wind_torque
from mavdem.dataset.axes import AXES
from mavdem.dem import Learned
from mavdem.experiments.held_out import FORECAST, HeldOut
from mavdem.fleet.row import utf8_text
from mavdem.loops.axis_loops import identified_loops
from mavdem.loops.step_response import StepResponse
from mavdem.report import palette
from mavdem.report.blocks import Block, Sentence, markdown
from mavdem.report.charts.chart import Chart, Line, over_time
from mavdem.report.charts.timeline import Timeline, timeline_of
from mavdem.report.labels import Labels
from mavdem.report.loops import margin_tables
from mavdem.report.numbers import display_unit
from mavdem.report.screen import analysis_blocks, detail_blocks, flight_title, motor_blocks
from mavdem.report.series import FREE_ENERGY, OUTPUTS, PROCESS_NOISE, Series, series_of
from mavdem.report.templates import headline
from mavdem.view.plots import (
    BEYOND,
    Mark,
    Target,
    blueprint,
    drawn,
    events_view,
    log,
    range_of,
    recorded,
)


def write_recording(target: Target, assessment: Assessment) -> None:
    """Writes an ``assessment`` with a model, and forecasts of held-out windows, to a ``target``.

    A file appears whole or not at all, ``OSError`` if it cannot be written. It opens with its own blueprint: the
    flight as a whole, its wind and loops, forecasts, how the model was learned, and the report. Angles are in degrees;
    alarms are marked in every plot.
    """
    analysis = assessment.analysis
    timeline = timeline_of(assessment)
    assert analysis is not None and timeline is not None
    flights, learned, held_out = analysis.flights, analysis.learned, analysis.held_out
    assert learned is not None and held_out is not None
    with recorded(target, Path(assessment.log.source).name) as recording:
        page = _Page(recording, assessment, timeline)
        series = series_of(flights, learned)
        words = [flight_title(flights, assessment.simulated), *analysis_blocks(assessment)]
        tabs: list[rrb.Container | rrb.View] = [
            page.flight(),
            *page.air(learned, series[OUTPUTS].time),
            *page.loops(),
            page.forecasts(learned, held_out, series),
            page.learning(learned),
            _text(recording, "report", "Report", words),
        ]
        for event in timeline.events:
            log(recording, event.seconds, event.fact.sentence, event.fact.level)
        shown = blueprint(rrb.Tabs(*tabs, active_tab=0), play_state="paused")
        recording.send_blueprint(shown, make_active=True)


def write_words(target: Target, name: str, blocks: Sequence[Block]) -> None:
    """Writes ``blocks`` about the log ``name`` to a ``target``, in place of those before; ``OSError`` if it cannot."""
    with recorded(target, name) as recording:
        words = rrb.Vertical(_text(recording, "report", "Report", blocks))
        recording.send_blueprint(blueprint(words), make_active=True)


class _Page:
    """The tabs of a recording of an ``assessment``, whose plots are of its ``timeline``."""

    def __init__(
        self, recording: rr.RecordingStream, assessment: Assessment, timeline: Timeline
    ) -> None:
        self._recording = recording
        self._assessment = assessment
        self._timeline = timeline
        first, last = timeline.span
        happened = [event for event in timeline.events if first < event.seconds < last]
        self._alarms = [event.seconds for event in happened if event.is_alarm]

    def flight(self) -> rrb.Container:
        """Headline and next step above; axes, rates, motors and the rest on one axis of time; lights and events."""
        axes = self._timeline.axis_charts.values()
        rates = (chart.lines[0] for charts in axes for chart in charts[1:2])
        lines = (
            line._replace(name=axis, colour=palette.distinct(number))
            for number, (axis, line) in enumerate(zip(AXES, rates, strict=False))
        )
        shown = [chart for charts in axes for chart in charts[:1]]
        shown.append(over_time("Rates", "°/s", lines))
        shown += self._timeline.flight_charts
        judgement = self._assessment.judgement
        said = f"**{headline(judgement.headline)}**\n\n**Next:** {judgement.next_step.advised}"
        above = _text(self._recording, "headline", "", said)
        lights = [
            Sentence(fact.advised, f"{name.capitalize()} – {fact.level}:")
            for name, fact in judgement.lights.items()
        ]
        words = _text(self._recording, "lights", "Lights", lights)
        beside = rrb.Vertical(words, events_view(), row_shares=[55, 45])
        plots = rrb.Vertical(*self._drawn("flight", shown))
        below = rrb.Horizontal(plots, beside, column_shares=[75, 25])
        return rrb.Vertical(above, below, row_shares=[9, 91], name="Flight")

    def air(self, learned: Learned, clock: Array) -> list[rrb.Container]:
        """The wind, and its torque, with marks where gusts begin; nothing where neither is known."""
        if not self._timeline.wind_charts:
            return []
        torque = resolved_wind_torque(learned.wind_torque, learned.physical)
        gusts = torque.gusts if torque else ()
        begins = [float(clock[gust.sample]) for gust in gusts]
        marks = f"gust ({len(begins)})", palette.GUST, begins
        return [rrb.Vertical(*self._drawn("air", self._timeline.wind_charts, marks), name="Wind")]

    def loops(self) -> list[rrb.Container]:
        """Measured steps by axis, and loops with their margins; nothing where none is known."""
        steps = [
            self._bars(f"steps/{axis}/{name}", f"{axis} {name}: step", each.time, each.step)
            for axis, responses in self._assessment.responses.items()
            for name, response in responses.items()
            if isinstance(each := response.measured, StepResponse)
        ]
        identified = identified_loops(self._assessment.loops)
        hertz = np.linspace(0.5, 30.0, 60)
        pictures = [
            self._bars(
                f"loops/{axis}",
                f"{axis} rate loop: sensitivity |S| over Hz",
                hertz,
                np.interp(hertz, loop.rate.frequency, 1 / abs(1 + loop.rate.response[0])),
            )
            for axis, loop in identified.items()
        ]
        parts = list[rrb.View | rrb.Container]()
        if steps:
            parts.append(rrb.Grid(*steps, grid_columns=2))
        if identified:
            margins = _text(self._recording, "margins", "Margins", margin_tables(identified))
            parts += [rrb.Tabs(*pictures, margins)]
        return [rrb.Horizontal(*parts, name="Loops")] if parts else []

    def forecasts(
        self, learned: Learned, held_out: HeldOut, series: Mapping[str, Series]
    ) -> rrb.Container:
        """Outputs with their forecasts in held-out windows, and what DEM makes of each sample."""
        measured = series[OUTPUTS]
        labels = Labels.of(learned)
        charts = [
            _forecast(i, held_out, measured, unit) for i, unit in enumerate(labels.output_units)
        ]
        samples, _, energy = series[FREE_ENERGY]
        clock, names, noise = series[PROCESS_NOISE]
        states = zip(names, np.degrees(noise).T, strict=True)
        lines = [
            Line(name, palette.distinct(i), clock, values)
            for i, (name, values) in enumerate(states)
        ]
        bound = Line("F(t)", palette.BOUND, samples, energy[:, 0])
        charts += [
            over_time("Process noise w of DEM", "° and s", lines),
            over_time("Free energy F(t) of each sample", "nats", (bound,)),
        ]
        return rrb.Vertical(*self._drawn("forecast", charts), name="Forecast")

    def learning(self, learned: Learned) -> rrb.Container:
        """F̄ by iteration as bars, beside what was learned."""
        energy = learned.free_energy.total
        first = min(2, len(energy) - 1)  # the first two may be far from all others
        heading = f"F̄ below its maximum of {energy.max():,.0f} nats, by iteration"
        at = np.arange(first, len(energy), dtype=np.float64)
        bars = self._bars("learning/gap", heading, at, energy.max() - energy[first:])
        blocks = [*motor_blocks(learned, None), *detail_blocks(learned)]
        details = _text(
            self._recording, "learning/details", "The model, and how it was learned", blocks
        )
        return rrb.Horizontal(bars, details, name="Learning")

    def _drawn(self, folder: str, charts: Sequence[Chart], *marks: Mark) -> list[rrb.View]:
        """The views of charts, each with ``marks`` and the alarms."""
        all_marks = *marks, ("went wrong", palette.BAD, self._alarms)
        return [
            drawn(self._recording, f"{folder}/{number}", chart, self._timeline.span, all_marks)
            for number, chart in enumerate(charts)
        ]

    def _bars(self, origin: str, name: str, at: Array, values: Array) -> rrb.View:
        """A view of bars at places ``at``, evenly apart."""
        width = 0.7 * float(at[1] - at[0]) if len(at) > 1 else 0.7
        colour = palette.channels(palette.PREDICTED)
        widths = np.full(len(values), width)
        bars = rr.BarChart(values, abscissa=at - width / 2, widths=widths, color=colour)
        self._recording.log(origin, bars, static=True)
        return rrb.BarChartView(origin=origin, name=name, plot_legend=rrb.PlotLegend(visible=False))


def _text(
    recording: rr.RecordingStream, origin: str, name: str, words: str | Iterable[Block]
) -> rrb.View:
    """A view of Markdown, without a title bar if it has no name."""
    text = utf8_text(words if isinstance(words, str) else markdown(words))
    recording.log(origin, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)
    return rrb.TextDocumentView(origin=origin, name=name or origin, titlebar=bool(name))


def _forecast(i: int, held_out: HeldOut, measured: Series, label: str) -> Chart:
    """The output number ``i`` as measured, and its forecasts in held-out windows with their bands."""
    unit = display_unit(label)
    name = measured.names[i].capitalize()
    values = unit.scale * measured.values[:, i]
    low, high = range_of(values)
    beyond = BEYOND * (high - low)
    windows = held_out.forecasts[FORECAST], held_out.band
    parts = ((0, 0), (0, 1))  # no line is drawn from one window to the next
    forecast, half = (
        unit.scale * np.pad(each[:, :, i], parts, constant_values=np.nan).ravel()
        for each in windows
    )
    curves = np.array([forecast, forecast - half, forecast + half])
    inside = np.clip(curves, low - beyond, high + beyond)  # it may overflow
    time = np.pad(held_out.time, parts, mode="edge").ravel()
    lines = (
        Line("measured", palette.MEASURED, measured.time, values),
        Line("forecast", palette.PREDICTED, time, *inside),
    )
    return over_time(f"{name}, and its forecast for {held_out.seconds:.2g} s", unit.name, lines)
