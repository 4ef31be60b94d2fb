"""A learned flight as a Rerun recording with its layout: flight, motion, wind, loops, forecasts, learning, report."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from mavdem.arrays import Array
from mavdem.assessment import Assessment
from mavdem.dem import Learned
from mavdem.dem.online.unusual_samples import unusual_samples
from mavdem.experiments.held_out import FORECAST, HeldOut
from mavdem.facts.model import ModelName
from mavdem.fleet.row import utf8_text
from mavdem.loops.step_response import StepResponse
from mavdem.plant.parameter_history import parameter_history
from mavdem.plant.parameters import ESTIMATE
from mavdem.report import palette
from mavdem.report.blocks import Block, Blocks, markdown
from mavdem.report.charts.chart import Chart, Line, over_time
from mavdem.report.charts.model_charts import torque_line
from mavdem.report.charts.timeline import Timeline, assessment_timeline
from mavdem.report.labels import Labels
from mavdem.report.numbers import TORQUE_UNIT, display_unit
from mavdem.report.review import review_title
from mavdem.report.screen import analysis_blocks, detail_blocks, flight_title, motor_blocks
from mavdem.report.series import (
    FREE_ENERGY,
    FREE_ENERGY_ACTION,
    FREE_ENERGY_TERMS,
    OUTPUTS,
    PROCESS_NOISE,
    Series,
    free_energy_per_sample,
    recording_series,
)
from mavdem.report.templates import headline
from mavdem.report.tuning.decisions import decision_sentences
from mavdem.report.tuning.tables import margin_tables
from mavdem.view.first_tab import (
    SideTexts,
    events_text,
    first_tab,
    free_energy_title,
    height_shares,
    plot_titles,
)
from mavdem.view.logged_flight import flight_scene
from mavdem.view.parameter_traces import parameter_estimates, parameter_traces
from mavdem.view.plots import (
    EventMarks,
    Target,
    blueprint,
    draw_chart,
    events_view,
    log_event,
    recording_to_file,
)

BAR_WIDTH = 0.7
"""Width of a bar, in distances between bars."""

FIRST_ITERATION = 2
"""Iteration from which F̄ is drawn: before it F̄ may be far from all later values."""

SENSITIVITY_FREQUENCIES = np.linspace(0.5, 30.0, 60)
"""Hz at which the sensitivity of a loop is drawn as bars: rate loops of multirotors cross over at 3 to 20 Hz."""


def write_recording(target: Target, assessment: Assessment) -> None:
    """Writes all plots of a flight and of its learned model as a recording, which the Rerun viewer shows.

    The recording contains its layout, a row of tabs. The first one has the same plots as the first tab of a live
    session. The others are motion, space, vehicle, wind, loops, free energy, forecasts, learning, and the report as
    text; without a model there is nothing to show of free energy, forecasts and learning. Angles are in degrees. Alarms
    are marked in every plot.

    Args:
        target: a file, which appears completely or not at all, or a stream.
        assessment: assessment of a log. Without a model it has at least a flight to draw over time; a log without even
            that is reported in words alone.

    Raises:
        OSError: the file cannot be written.
    """
    timeline = assessment_timeline(assessment)
    log_name = Path(assessment.log.source).name
    if timeline is None:
        write_words(target, log_name, analysis_blocks(assessment))
        return
    with recording_to_file(target, log_name) as recording:
        tabs = RecordingTabs(recording, assessment, timeline)
        views = tabs.all()
        for event in timeline.events:
            # An event that began before the record has no finite time, and is listed at the start.
            time = event.seconds if event.has_time else timeline.span[0]
            log_event(recording, time, event.fact.sentence, event.fact.level)
        layout = blueprint(rrb.Tabs(*views, active_tab=0), play_state="paused")
        recording.send_blueprint(layout, make_active=True)


def write_words(target: Target, name: str, blocks: Sequence[Block]) -> None:
    """Writes a Rerun recording that has only a text, for example that a log is being read, or why it cannot be.

    In a stream to a viewer it replaces the text that was written before.

    Args:
        target: a file or a stream.
        name: name of the log.
        blocks: sentences, tables and lists of the text.

    Raises:
        OSError: the file cannot be written.
    """
    with recording_to_file(target, name) as recording:
        text_view = log_text(recording, "report", "Report", blocks)
        layout = blueprint(rrb.Vertical(text_view))
        recording.send_blueprint(layout, make_active=True)


class RecordingTabs:
    """The tabs of a recording of one assessment: each method draws one, and returns its layout."""

    def __init__(
        self, recording: rr.RecordingStream, assessment: Assessment, timeline: Timeline
    ) -> None:
        """Collects what all tabs of the recording need: the charts, and the times of the alarms in them.

        Args:
            recording: recording to draw into.
            assessment: all results about the log.
            timeline: charts and events of the boot that was analysed, over one axis of time.
        """
        self._recording = recording
        self._assessment = assessment
        self._timeline = timeline
        start_time, end_time = timeline.span
        self._alarm_times = [
            event.seconds
            for event in timeline.events
            if event.is_alarm and start_time < event.seconds < end_time
        ]

    def all(self) -> list[rrb.Container | rrb.View]:
        """Draws all tabs, those on the model if one was learned; the report comes last."""
        analysis = self._assessment.analysis
        # A log that has charts over time was analysed.
        assert analysis is not None
        learned = analysis.learned
        held_out = analysis.held_out
        if learned is None or held_out is None:
            report = [review_title(self._assessment), *analysis_blocks(self._assessment)]
            return [
                self.flight_without_model(),
                self.motion(),
                *self.space(),
                *self.vehicle(),
                *self.wind(),
                *self.loops(),
                log_text(self._recording, "report", "Report", report),
            ]
        series = recording_series(analysis.flights, learned)
        title = flight_title(analysis.flights, self._assessment.simulated)
        wind_torque = learned.resolved_wind_torque
        gusts = wind_torque.gusts if wind_torque else ()
        gust_times = [float(series[OUTPUTS].time[gust.sample]) for gust in gusts]
        return [
            self.flight(learned, held_out, series),
            self.motion(),
            *self.space(),
            *self.vehicle(),
            *self.wind(gust_times),
            *self.loops(),
            self.free_energy(learned, series),
            self.forecasts(learned, held_out, series),
            self.learning(learned),
            log_text(
                self._recording, "report", "Report", [title, *analysis_blocks(self._assessment)]
            ),
        ]

    def flight(
        self, learned: Learned, held_out: HeldOut, series: Mapping[str, Series]
    ) -> rrb.Container:
        """Draws the first tab: the plots of a live session over the whole flight, with headline, lights and events.

        Args:
            learned: the linear model that was learned from a flight, with its training data.
            held_out: forecasts in windows that the model was not trained on.
            series: outputs and free energy (T, k) by name.

        Returns:
            The tab.
        """
        energy = series[FREE_ENERGY]
        unusual = unusual_samples(energy.values[:, 0], learned.dt)
        surprises = EventMarks("surprise", palette.LIMITED, energy.time[unusual].tolist())
        axis = series[OUTPUTS].names[0]
        unit = Labels.of(learned).output_units[0]
        forecast = f"forecasts for {held_out.seconds:.2g} s"
        titles = plot_titles(axis, display_unit(unit).name, forecast, "%", held_out.model)
        charts = {
            "angle": self._angle_chart(held_out, series[OUTPUTS], unit),
            "motors": _chart_with_label(self._timeline.flight_charts, "Motors, %"),
            "parameters": parameter_chart(self._assessment),
            "wind": _chart_with_label(self._timeline.wind_charts, "Wind, m/s"),
            "torque": torque_chart(learned),
        }
        titled_charts = {}
        for name, chart in charts.items():
            titled_charts[name] = chart._replace(y=chart.y._replace(label=titles[name]))
        return self._first_tab(titled_charts, surprises)

    def flight_without_model(self) -> rrb.Container:
        """Draws the first tab of a flight without a model: roll with its setpoint, the motors and the wind."""
        angle_lines = self._angle_and_setpoint(axis="roll")
        charts = {
            "angle": over_time("Roll", "°", angle_lines),
            "motors": _chart_with_label(self._timeline.flight_charts, "Motors, %"),
            "wind": _chart_with_label(self._timeline.wind_charts, "Wind, m/s"),
        }
        return self._first_tab(charts, EventMarks("surprise", palette.LIMITED, []))

    def _first_tab(self, charts: Mapping[str, Chart], surprises: EventMarks) -> rrb.Container:
        """Draws the plots of the first tab, with headline, lights and events beside them.

        Args:
            charts: charts by the keys of ``PLOT_HEIGHTS``; those without lines are left out.
            surprises: times at which the model is surprised, which are marked in the plot of the angle.
        """
        summary = self.summary()
        events = log_text(self._recording, "events", "", events_text(self._timeline.events))
        alarms = EventMarks("alarm", palette.BAD, self._alarm_times)
        drawn_charts = {name: chart for name, chart in charts.items() if chart.lines}
        shares = height_shares(drawn_charts)
        plots = {}
        for name, chart in drawn_charts.items():
            marks = (surprises, alarms) if name == "angle" and surprises.times else (alarms,)
            plots[name] = draw_chart(
                self._recording,
                f"flight/{name}",
                chart,
                self._timeline.span,
                shares[name],
                marks,
            )
        return first_tab(plots, SideTexts([summary, events], [60, 40]))

    def summary(self) -> rrb.View:
        """Writes the text beside the first plots: headline, next step, and the judgement of each part of the vehicle.

        Returns:
            The view of the text.
        """
        judgement = self._assessment.judgement
        lines = [
            f"**{headline(judgement.headline)}**",
            f"**Next:** {judgement.next_step.sentence_and_remedy}",
        ]
        # The status light of a part, such as the motors, is a finding with a level: good, watch, bad or unknown.
        for name, light in judgement.lights.items():
            text = light.sentence_and_remedy
            if light.sentence == judgement.headline.sentence:
                text = "See the headline."
            lines.append(f"**{name.capitalize()} – {light.level}:** {text}")
        return log_text(self._recording, "headline", "", "\n\n".join(lines))

    def _angle_chart(self, held_out: HeldOut, outputs: Series, unit_in_data: str) -> Chart:
        """Returns the chart of the angle over the whole record, with its setpoint and its forecasts.

        Args:
            held_out: forecasts in windows that the model was not trained on.
            outputs: outputs of the model (T, m) in settled flight (without take-off and landing), the angle first.
            unit_in_data: unit of the angle in the data.
        """
        angle_output = 0
        chart = forecast_chart(angle_output, held_out, outputs, unit_in_data)
        lines_of_whole_record = self._angle_and_setpoint(axis=outputs.names[angle_output])
        if not lines_of_whole_record:
            return chart
        # They replace the measured line of the chart, which has settled flight alone.
        forecast_lines = [line for line in chart.lines if line.name != "measured"]
        return chart._replace(lines=(*lines_of_whole_record, *forecast_lines))

    def _angle_and_setpoint(self, axis: str) -> Sequence[Line]:
        """Returns the measured angle of an axis and, if it was recorded, its setpoint as lines over the whole record.

        Args:
            axis: "roll", "pitch" or "yaw".

        Returns:
            The lines, degrees, the setpoint first; none if the angle was not recorded.
        """
        charts = self._timeline.axis_charts.get(axis, ())
        if not charts:
            return ()
        # The first chart is that of the angle. Its last line is the measured angle, after the setpoint if there is one.
        lines = charts[0].lines
        measured_line = lines[-1]._replace(name="measured", colour=palette.MEASURED)
        return [*lines[:-1], measured_line]

    def motion(self) -> rrb.Container:
        """Draws the motion of the vehicle: a plot of the angle of each axis with its setpoint, and one of all rates.

        The event log is next to the plots.

        Returns:
            The tab "Motion".
        """
        angle_charts: list[Chart] = []
        rate_lines = []
        for number, (axis, axis_charts) in enumerate(self._timeline.axis_charts.items()):
            # Each axis has a chart of its angle, and a second one if the rate was recorded.
            angle_charts += axis_charts[:1]
            if len(axis_charts) > 1:
                # The measured rate comes last, after its setpoint where one was recorded.
                rate_line = axis_charts[1].lines[-1]
                rate_lines.append(rate_line._replace(name=axis, colour=palette.distinct(number)))
        charts = [*angle_charts, over_time("Rates", "°/s", rate_lines)]
        plots = rrb.Vertical(*self._draw_charts("motion", charts))
        # A click on an event moves the time. Rows are cut off at the edge; the texts of the first tab wrap instead.
        return rrb.Horizontal(plots, events_view(), column_shares=[72, 28], name="Motion")

    def space(self) -> list[rrb.Container]:
        """Draws the vehicle on its path in 3D, with the wind; nothing if no position was recorded."""
        evidence = self._assessment.evidence
        if evidence is None or evidence.time_history is None:
            return []
        view = flight_scene(self._recording, evidence.time_history, self._assessment.wind)
        return [] if view is None else [rrb.Vertical(view, name="3D")]

    def vehicle(self) -> list[rrb.Container]:
        """Draws height, motors and battery, as far as they were recorded."""
        if not self._timeline.flight_charts:
            return []
        views = self._draw_charts("vehicle", self._timeline.flight_charts)
        return [rrb.Vertical(*views, name="Vehicle")]

    def wind(self, gust_times: Sequence[float] = ()) -> list[rrb.Container]:
        """Draws the wind, m/s, and the torque that it exerts on the vehicle, °/s², with marks where gusts begin.

        Args:
            gust_times: times at which gusts begin, s; empty without a model, which shows them.

        Returns:
            A list with the tab "Wind"; empty if neither is known.
        """
        if not self._timeline.wind_charts:
            return []
        marks = []
        if gust_times:
            marks.append(EventMarks(f"gust ({len(gust_times)})", palette.GUST, list(gust_times)))
        # A live session stores its wind under the same path.
        views = self._draw_charts("air", self._timeline.wind_charts, *marks)
        return [rrb.Vertical(*views, name="Wind")]

    def loops(self) -> list[rrb.Container]:
        """Draws the tab of the control loops: measured step responses, and sensitivities with stability margins.

        The sensitivity |S| = 1 / |1 + L|, with the response L of the open rate loop, shows by how much the loop
        amplifies disturbances of a frequency: its peak is small where the margins are large.

        Returns:
            The layout of the tab; empty if neither a step response nor a loop is known.
        """
        step_views = self._draw_step_responses()
        loops = self._assessment.identified_loops
        sensitivity_views = self._draw_sensitivities()
        views: list[rrb.View | rrb.Container] = []
        if step_views:
            views.append(rrb.Grid(*step_views, grid_columns=2))
        if loops:
            decisions = decision_sentences(self._assessment.loop_decisions)
            doubtful = self._assessment.axes_with_doubtful_loop
            text: Blocks = [*decisions, *margin_tables(loops, doubtful)]
            margins = log_text(self._recording, "margins", "Margins", text)
            # The text is first, since it tells the user what to do.
            views.append(rrb.Tabs(margins, *sensitivity_views))
        return [rrb.Horizontal(*views, name="Loops")] if views else []

    def _draw_step_responses(self) -> list[rrb.View]:
        """Draws the measured step responses of angles and rates over time, a bar chart for each."""
        views = []
        for axis, responses in self._assessment.responses.items():
            for name, response in responses.items():
                measured_response = response.measured
                if isinstance(measured_response, StepResponse):
                    view = self._draw_bars(
                        f"steps/{axis}/{name}",
                        f"{axis} {name}: step",
                        measured_response.time,
                        measured_response.step,
                    )
                    views.append(view)
        return views

    def _draw_sensitivities(self) -> list[rrb.View]:
        """Draws the sensitivity |S| of each identified rate loop over frequency, Hz, as a bar chart."""
        views = []
        for axis, loop in self._assessment.identified_loops.items():
            # The first response is by the estimate; samples of the posterior follow.
            sensitivity = 1 / abs(1 + loop.rate.response[ESTIMATE])
            view = self._draw_bars(
                f"loops/{axis}",
                f"{axis} rate loop: sensitivity |S| over Hz",
                SENSITIVITY_FREQUENCIES,
                np.interp(SENSITIVITY_FREQUENCIES, loop.rate.frequency, sensitivity),
            )
            views.append(view)
        return views

    def free_energy(self, learned: Learned, series: Mapping[str, Series]) -> rrb.Container:
        """Draws the free energy F(t) of each sample, nats, the terms that it consists of, and its sum over time.

        The sum from the first sample on ends at F̄, which learning maximised.

        Args:
            learned: the linear model that was learned from a flight, with its training data.
            series: values (T, k) by name; a model whose F(t) has no terms has neither these nor the sum.

        Returns:
            The tab "Free energy".
        """
        energy_chart = free_energy_chart(learned, series[FREE_ENERGY])
        charts = [energy_chart._replace(y=energy_chart.y._replace(label=free_energy_title()))]
        terms = series.get(FREE_ENERGY_TERMS)
        if terms is not None:
            charts += self._term_charts(terms, series[FREE_ENERGY_ACTION])
        views = self._draw_charts("free_energy", charts)
        return rrb.Vertical(*views, name="Free energy")

    def _term_charts(self, terms: Series, action: Series) -> list[Chart]:
        """Returns charts of the terms of F(t), and of the sum of F(t) from the first sample on.

        Args:
            terms: terms (T, k) of F(t), nats.
            action: sum (T, 1) of F(t), nats.
        """
        term_lines = []
        for number, name in enumerate(terms.names):
            colour = palette.distinct(number)
            term_lines.append(Line(name, colour, terms.time, terms.values[:, number]))
        sum_line = Line("sum of F(t)", palette.PREDICTED, action.time, action.values[:, 0])
        unit_and_model = f"nats · model: {ModelName.DEM}"
        return [
            over_time("Terms of F(t)", unit_and_model, term_lines),
            over_time(
                "Sum of F(t) from the first sample, which ends at F̄", unit_and_model, (sum_line,)
            ),
        ]

    def forecasts(
        self, learned: Learned, held_out: HeldOut, series: Mapping[str, Series]
    ) -> rrb.Container:
        """Draws outputs with their forecasts in held-out windows, and the process noise of DEM by sample.

        Args:
            learned: the linear model that was learned from a flight, with its training data.
            held_out: forecasts in windows that the model was not trained on.
            series: times (T,) and values (T, k) by name: outputs, and process noise of the states.

        Returns:
            The tab "Forecast".
        """
        charts = []
        for output, unit in enumerate(Labels.of(learned).output_units):
            charts.append(forecast_chart(output, held_out, series[OUTPUTS], unit))
        process_noise = series[PROCESS_NOISE]
        noise_lines = []
        for state, name in enumerate(process_noise.names):
            values = np.degrees(process_noise.values[:, state])
            noise_lines.append(Line(name, palette.distinct(state), process_noise.time, values))
        title = f"Process noise w, ° and s · model: {ModelName.DEM}"
        charts.append(over_time(title, "", noise_lines))
        return rrb.Vertical(*self._draw_charts("forecast", charts), name="Forecast")

    def learning(self, learned: Learned) -> rrb.Container:
        """Draws how learning converged: how far the free energy F̄, nats, was below its maximum at each iteration.

        A text beside it has the details of the model and of its learning.

        Args:
            learned: the linear model that was learned from a flight, with its training data.

        Returns:
            The tab "Learning".
        """
        energy = learned.free_energy.total
        maximum = energy.max()
        # The first iterations are left out, but of a fit with very few at least the last one is shown.
        first_iteration = min(FIRST_ITERATION, len(energy) - 1)
        title = f"F̄ below its maximum of {maximum:,.0f} nats, by iteration"
        iterations = np.arange(first_iteration, len(energy), dtype=np.float64)
        distances = maximum - energy[first_iteration:]
        bars = self._draw_bars("learning/gap", title, iterations, distances)
        blocks = [*motor_blocks(learned, None), *detail_blocks(learned)]
        details = log_text(
            self._recording, "learning/details", "The model, and how it was learned", blocks
        )
        return rrb.Horizontal(bars, details, name="Learning")

    def _draw_charts(
        self, folder: str, charts: Sequence[Chart], *marks: EventMarks
    ) -> list[rrb.View]:
        """Draws charts that share the height of a tab, with vertical lines at the times of alarms and other events.

        Args:
            folder: path in the recording under which the charts are stored, each by its number.
            charts: charts over time.
            marks: further events to mark, such as gusts.

        Returns:
            Views of the charts in the same order.
        """
        alarm_marks = EventMarks("alarm", palette.BAD, self._alarm_times)
        height = 1 / len(charts)
        views = []
        for number, chart in enumerate(charts):
            path = f"{folder}/{number}"
            view = draw_chart(
                self._recording, path, chart, self._timeline.span, height, (*marks, alarm_marks)
            )
            views.append(view)
        return views

    def _draw_bars(self, origin: str, name: str, positions: Array, values: Array) -> rrb.View:
        """Draws a bar chart.

        Args:
            origin: path of the entity.
            name: title of the view.
            positions: (N,) centres of the bars, at equal distances.
            values: (N,) heights of the bars.

        Returns:
            View of the chart.
        """
        distance = float(positions[1] - positions[0]) if len(positions) > 1 else 1.0
        width = BAR_WIDTH * distance
        bars = rr.BarChart(
            values,
            # Rerun places bars by their left edges.
            abscissa=positions - width / 2,
            widths=np.full(len(values), width),
            color=palette.channels(palette.PREDICTED),
        )
        self._recording.log(origin, bars, static=True)
        return rrb.BarChartView(origin=origin, name=name, plot_legend=rrb.PlotLegend(visible=False))


def log_text(
    recording: rr.RecordingStream, origin: str, name: str, content: str | Iterable[Block]
) -> rrb.View:
    """Adds a text to a recording.

    Args:
        recording: recording to write into.
        origin: path of the text's entity.
        name: title of the view; without one, the view has no title bar.
        content: the text, as Markdown or as blocks of a report.

    Returns:
        The view that shows the text.
    """
    text = utf8_text(content if isinstance(content, str) else markdown(content))
    recording.log(origin, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)
    return rrb.TextDocumentView(origin=origin, name=name or origin, titlebar=bool(name))


def forecast_chart(
    output: int, held_out: HeldOut, measured_outputs: Series, unit_in_data: str
) -> Chart:
    """Returns a chart of one output of the model: the measurement, and its forecasts with their 90 % bands.

    The forecasts are those in held-out windows, on which the model was not trained. Forecasts of an unstable model may
    overflow, so that they and their bands are clipped near the range of the measurement.

    Args:
        output: index of the output.
        held_out: forecasts of W windows with H samples each, (W, H, outputs), and half widths of their bands.
        measured_outputs: outputs of the whole flight, (T, outputs).
        unit_in_data: unit of the output in the data, such as rad. The chart is in the unit that people read, such as
            degrees.

    Returns:
        A chart over time, in which the line of the forecasts is interrupted between windows.
    """
    unit = display_unit(unit_in_data)
    name = measured_outputs.names[output].capitalize()
    measurement = unit.scale * measured_outputs.values[:, output]
    measured_line = Line("measured", palette.MEASURED, measured_outputs.time, measurement)
    # A NaN after the last sample of each window keeps a line from being drawn to the next one.
    gap = ((0, 0), (0, 1))
    forecasts = np.pad(held_out.forecasts[FORECAST][:, :, output], gap, constant_values=np.nan)
    bands = np.pad(held_out.band[:, :, output], gap, constant_values=np.nan)
    time = np.pad(held_out.time, gap, mode="edge").ravel()
    values = unit.scale * forecasts.ravel()
    half_width = unit.scale * bands.ravel()
    forecast_line = Line(
        "forecast", palette.PREDICTED, time, values, values - half_width, values + half_width
    )
    lines = (measured_line, forecast_line.clipped_to([measured_line]))
    chart = over_time(f"{name}, and its forecast for {held_out.seconds:.2g} s", unit.name, lines)
    return chart._replace(y=chart.y._replace(label=f"{chart.y.label} · model: {held_out.model}"))


def _chart_with_label(charts: Sequence[Chart], label: str) -> Chart:
    """Returns the chart whose axis of values has this label; one without lines where there is none."""
    for chart in charts:
        if chart.y.label == label:
            return chart
    return over_time(label, "", ())


def free_energy_chart(learned: Learned, free_energy: Series) -> Chart:
    """Returns a chart of the free energy F(t) of each sample, nats, which shows the samples that the model fits badly.

    A second line has F̄ per sample: the free energy of all samples together (an integral over time), divided by their
    number.

    Args:
        learned: the linear model that was learned from a flight, with its training data.
        free_energy: F(t) of T samples, (T, 1), nats.
    """
    time = free_energy.time
    mean = np.full(len(time), free_energy_per_sample(learned))
    lines = (
        Line("F(t)", palette.MEASURED, time, free_energy.values[:, 0]),
        Line("F̄ per sample", palette.PREDICTED, time, mean),
    )
    return over_time("Free energy", "nats", lines)


def parameter_chart(assessment: Assessment) -> Chart:
    """Returns a chart that shows whether the physical parameters changed during a flight.

    The flight is divided into parts, and the parameters are estimated in each part separately. They are drawn as
    constant over each part, with their 90 % bands.

    Args:
        assessment: assessment of a log from which a model was learned.

    Returns:
        The chart, with a line for each parameter that is identifiable; it has no lines if none is.
    """
    analysis = assessment.analysis
    assert analysis is not None
    history = parameter_history(analysis.flights)
    if not history:
        return over_time("Physical parameters", "", ())
    estimates_of_parts = [parameter_estimates(part.physical) for part in history]
    # Names, colours and scales of the lines, in the order of the estimates.
    traces = parameter_traces(history[0].physical, analysis.flights[0].input_units[0])
    times_of_parts = [part.samples.time for part in history]
    lines = []
    for number, trace in enumerate(traces):
        # One parameter in each part: its value and the half width of its band.
        trace_estimates = [trace.scale * estimates[number] for estimates in estimates_of_parts]
        is_identifiable = not np.isnan(trace_estimates).all()
        if is_identifiable:
            lines.append(_line_of_parts(trace.name, trace.colour, times_of_parts, trace_estimates))
    return over_time("Physical parameters", "", lines)


def _line_of_parts(
    name: str, colour: str, times: Sequence[Array], estimates: Sequence[Array]
) -> Line:
    """Returns a line that is constant in each part of a flight, with its 90 % band, and interrupted between the parts.

    Args:
        name: name of the line.
        colour: its colour.
        times: times of the samples of each part, s.
        estimates: for each part the value and the half width of its band, (2,).
    """
    line_times: list[Array] = []
    values: list[Array] = []
    half_widths: list[Array] = []
    # A further sample with NaN breaks the line after each part.
    gap = np.array([np.nan])
    for part_time, (value, half_width) in zip(times, estimates, strict=True):
        line_times += [part_time, part_time[-1:]]
        values += [np.full(len(part_time), value), gap]
        half_widths += [np.full(len(part_time), half_width), gap]
    return Line.with_band(
        name,
        colour,
        np.concatenate(line_times),
        np.concatenate(values),
        np.concatenate(half_widths),
    )


def torque_chart(learned: Learned) -> Chart:
    """Returns a chart of the wind torque, °/s², with its band; without lines where it is not identifiable."""
    line = torque_line(learned, "torque", palette.DISTURBANCE)
    return over_time("Wind torque", TORQUE_UNIT.name, () if line is None else (line,))
