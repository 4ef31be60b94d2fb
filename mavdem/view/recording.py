"""Recording: one learned flight as a Rerun file, with the blueprint that shows it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from mavdem.analysis.findings import findings_of
from mavdem.assessment import Assessment
from mavdem.dem import Learned
from mavdem.dem.engine.linalg import Array
from mavdem.evaluate.held_out import FORECAST, HeldOut
from mavdem.fleet.row import as_text
from mavdem.flight import Flight
from mavdem.report import palette
from mavdem.report.blocks import Block, markdown
from mavdem.report.labels import Labels
from mavdem.report.numbers import TORQUE, named, place, readable
from mavdem.report.screen import detail_blocks, motor_blocks, screen, title, verdict_blocks
from mavdem.report.series import (
    COMMAND,
    FREE_ENERGY,
    INPUTS,
    PROCESS_NOISE,
    series_of,
)
from mavdem.report.timeline import Row, events_of, torque_lines, wind_rows
from mavdem.report.words import headline
from mavdem.view.flown import (
    Plot,
    Target,
    blueprint,
    events_view,
    faint,
    log,
    path_with_wind,
    range_of,
    recorded,
    with_gaps,
)

# how far a plot extends beyond the measured values, in spans of them, where a forecast does
BEYOND = 0.15


def write_recording(
    target: Target,
    flights: Sequence[Flight],
    learned: Learned,
    held_out: HeldOut,
    assessment: Assessment | None = None,
) -> None:
    """Writes ``learned``, the model of ``flights``, and forecasts of ``held_out`` windows to a ``target``.

    A file appears whole or not at all, ``OSError`` if it cannot be written. It opens with its own blueprint: the
    flight over its seconds, more of it, how the model was learned, and the report. Angles are in degrees. With the
    ``assessment`` of the log every plot is marked where something went wrong, what happened is a text log, and the wind
    in m/s of the same boot has a tab of its own, with the path.
    """
    series = FlightSeries(flights, learned, held_out)
    boot = flights[0].provenance.get("segment", {}).get("boot", 0)
    events = () if assessment is None else events_of(assessment, boot)
    series.alarms = [
        event.seconds
        for event in events
        if event.is_alarm and series.span[0] < event.seconds < series.span[1]
    ]
    with recorded(target, Path(str(flights[0].provenance.get("source", ""))).name) as recording:
        report = _text(
            recording,
            "report",
            "Report",
            [title(flights), *screen(learned, held_out, assessment=assessment)],
        )
        others = [
            plot for i in range(1, len(series.labels.output_names)) for plot in series.output(i)
        ]
        details = _drawn(recording, series, [*others, series.motors(), *series.dem()])
        flight = _flight(recording, series, assessment)
        learning = _learning(recording, learned)
        air = [] if assessment is None else _air(recording, series, assessment)
        for event in events:
            level = "ERROR" if event.is_alarm else "INFO"
            log(recording, event.seconds, event.fact.sentence, level)
        log_view = [events_view()] if events else []
        tabs = rrb.Tabs(
            flight,
            *air,
            rrb.Vertical(*details, name="Details"),
            learning,
            report,
            *log_view,
            active_tab=0,
        )
        recording.send_blueprint(blueprint(tabs, play_state="paused"), make_active=True)


def write_words(target: Target, name: str, blocks: Sequence[Block]) -> None:
    """Writes ``blocks`` about the log ``name`` to a ``target``, in place of those before; ``OSError`` if it cannot."""
    with recorded(target, name) as recording:
        words = rrb.Vertical(_text(recording, "report", "Report", blocks))
        recording.send_blueprint(blueprint(words), make_active=True)


class FlightSeries:
    """The series of a learned flight over the boot clock, s, in degrees, as plots."""

    def __init__(self, flights: Sequence[Flight], learned: Learned, held_out: HeldOut) -> None:
        self.flights = flights
        self.series = series_of(flights, learned, held_out)
        self.learned = learned
        self.held_out = held_out
        self.windows = held_out.time
        self.labels = Labels.of(learned)
        self.times = [flight.time for flight in flights]
        self.clock = with_gaps(self.times, last=True)
        after = self.windows[:, 0] > self.times[-1][-1]
        self._time = with_gaps([*self.times, *self.windows[after]], last=True)
        self._outputs = with_gaps(
            [*(flight.outputs for flight in flights), *held_out.measured[after]]
        )
        self.span = float(self._time[0]), float(self._time[-1])
        self.alarms: list[float] = []  # s

    def output(self, i: int) -> list[Plot]:
        """Returns an output with its forecasts in held-out windows, and what these leave."""
        name = self.labels.output_names[i]
        unit = readable(self.labels.output_units[i])
        measured = unit.scale * self._outputs[:, i]
        time = with_gaps(self.windows, last=True)
        windows = self.held_out.measured, self.held_out.forecasts[FORECAST], self.held_out.band
        in_windows, forecast, half = (unit.scale * with_gaps(values[:, :, i]) for values in windows)
        low, high = range_of(measured)
        span = high - low
        forecast = np.clip(forecast, low - 9 * span, high + 9 * span)  # it may overflow
        residual = in_windows - forecast
        inner = range_of(np.clip(forecast, low - BEYOND * span, high + BEYOND * span), measured)
        what = f"measured, and forecast in held-out windows of {self.held_out.seconds:.2g} s"
        heading = f"{named(name.capitalize(), unit.name)}: {what}"
        above = Plot(rr.new_entity_path(["outputs", name]), heading, inner)
        left = named("Residual: measured minus forecast", unit.name)
        below = Plot(
            rr.new_entity_path(["residuals", name]), left, range_of(np.clip(residual, -span, span))
        )
        starts = self.windows[:, 0]
        ends = self.windows[:, -1]
        apart = starts[1:] - ends[:-1] > 1.5 * self.learned.dt
        parts = list(zip(starts[np.append(True, apart)], ends[np.append(apart, True)], strict=True))
        for plot, middle in ((above, forecast), (below, 0.0)):
            plot.spans("held out", faint(palette.MEASURED, palette.HELD_OUT_OPACITY), parts)
            colour = faint(palette.PREDICTED, palette.BAND_OPACITY)
            plot.area("90 % band", colour, time, middle - half, middle + half)
        above.line("measured", palette.MEASURED, self._time, measured)
        above.line("forecast", palette.PREDICTED, time, forecast, 1.8)
        below.line("residual", palette.PREDICTED, time, residual)
        return [above, below]

    def command(self) -> Plot:
        """Returns by how much the motors that turn the vehicle one way run above the others."""
        _, (name,), values = self.series[COMMAND]
        named_so = named(name.capitalize(), self.labels.input_units[0])
        heading = f"{named_so}: the motors' difference, about its mean"
        commands = {name: self._with_gaps(values[:, 0])}
        return Plot.series("command", heading, self.clock, commands, palette.COMMAND)

    def motors(self) -> Plot:
        """Returns what drives the vehicle: several inputs, as deviations from their mean, by their places."""
        inputs = self.series[INPUTS].values
        unit = self.labels.input_units[0]
        several = inputs.shape[1] > 1
        values = inputs - inputs.mean(axis=1, keepdims=True) if several else inputs
        heading = named("Inputs, deviation from their mean" if several else "Input", unit)
        series = dict(
            zip(map(place, self.labels.input_names), self._with_gaps(values).T, strict=True)
        )
        return Plot.series("inputs", heading, self.clock, series)

    def wind(self) -> Plot | None:
        """Returns the wind torque with its band, and gusts behind it; None where it is not known."""
        lines = tuple(torque_lines(self.labels.output_names[0], self.learned, self.flights))
        wind = self.learned.wind_torque
        if wind is None or not lines:
            return None
        clock = np.concatenate(self.times)
        gusts = [(clock[gust.sample], clock[gust.sample] + gust.length) for gust in wind.gusts]
        return Plot.of("wind", Row("Wind torque", TORQUE.name, lines), gusts)

    def dem(self) -> list[Plot]:
        """Returns what DEM makes of each sample: F(t) and the process noise w."""
        clock, names, noise = self.series[PROCESS_NOISE]
        states = dict(zip(names, np.degrees(noise).T, strict=True))
        samples, _, energy = self.series[FREE_ENERGY]
        heading = "Free energy F(t) of each sample, nats"
        return [
            Plot.series("process_noise", "Process noise w of DEM, ° and s", clock, states),
            Plot.series(
                "free_energy_of_samples", heading, samples, {"F(t)": energy[:, 0]}, palette.BOUND
            ),
        ]

    def _with_gaps(self, values: Array) -> Array:
        return with_gaps(np.split(values, np.cumsum([len(flight) for flight in self.flights])[:-1]))


def _drawn(
    recording: rr.RecordingStream, series: FlightSeries, plots: Sequence[Plot]
) -> list[rrb.View]:
    """The views of plots, each with its marks."""
    for plot in plots:
        plot.marks("went wrong", palette.BAD, series.alarms)
        plot.draw(recording)
    return [plot.view(*series.span) for plot in plots]


def _air(
    recording: rr.RecordingStream, series: FlightSeries, assessment: Assessment
) -> list[rrb.Container]:
    """The path in the wind, beside its speed and where it comes from over time; nothing where it is not known."""
    wind = assessment.wind_of_model
    if wind is None or assessment.evidence is None:
        return []
    position = assessment.evidence.signals.position
    rows = wind_rows(assessment.evidence.air, wind.boot)
    plots = [Plot.of(f"air/{number}", row) for number, row in enumerate(rows)]
    path = None
    if position is not None and wind.sized:
        path = path_with_wind(recording, position, wind)
    drawn = rrb.Vertical(*_drawn(recording, series, plots))
    return [rrb.Horizontal(*filter(None, [path]), drawn, name="Wind")]


def _flight(
    recording: rr.RecordingStream, series: FlightSeries, assessment: Assessment | None
) -> rrb.Container:
    """The first sentence above, then the flight over time, verdicts and motors beside it."""
    plots = _drawn(
        recording, series, [*series.output(0), series.command(), *filter(None, [series.wind()])]
    )
    found = findings_of(series.learned, series.held_out)
    judgement = None
    if assessment is not None and assessment.analysis is not None:
        found = assessment.analysis.findings
        judgement = assessment.judgement
    beside = [
        _text(recording, "verdict", "Verdict", verdict_blocks(found, judgement)),
        *_effectiveness(recording, series),
    ]
    pictures = rrb.Vertical(*plots, row_shares=[34, 20, 20, 26][: len(plots)])
    words = rrb.Vertical(*beside, row_shares=[38, 27, 35][: len(beside)])
    below = rrb.Horizontal(pictures, words, column_shares=[78, 22])
    if judgement is None:
        return rrb.Vertical(below, name="Flight")
    said = _text(recording, "headline", "", f"## {headline(judgement.headline)}")
    return rrb.Vertical(said, below, row_shares=[7, 93], name="Flight")


def _effectiveness(recording: rr.RecordingStream, series: FlightSeries) -> list[rrb.View]:
    """Bars of the motors in their order, below a table with their names and intervals; nothing where not known."""
    physical = series.learned.physical
    if physical is None or physical.status["effect"] == "not identifiable":
        return []
    motors = motor_blocks(series.learned, None)
    words = _text(recording, "effect/table", "Control effectiveness", motors)
    return [words, _bars(recording, "effect/bars", "By motor", TORQUE.scale * physical.effect, 1)]


def _bars(
    recording: rr.RecordingStream, origin: str, name: str, values: Array, first: int
) -> rrb.View:
    """A view of bars, numbered from ``first`` on."""
    width = 0.7
    colour = palette.channels(palette.PREDICTED)
    left = first + np.arange(len(values)) - width / 2
    bars = rr.BarChart(values, abscissa=left, widths=np.full(len(values), width), color=colour)
    recording.log(origin, bars, static=True)
    return rrb.BarChartView(origin=origin, name=name, plot_legend=rrb.PlotLegend(visible=False))


def _learning(recording: rr.RecordingStream, learned: Learned) -> rrb.Container:
    """F̄ by iteration as bars, beside what was learned."""
    energy = learned.free_energy
    first = min(2, len(energy) - 1)  # the first two may be far from all others
    heading = f"F̄ below its maximum of {energy.total.max():,.0f} nats, by iteration"
    bars = _bars(
        recording, "learning/gap", heading, (energy.total.max() - energy.total)[first:], first
    )
    details = _text(
        recording, "learning/details", "The model, and how it was learned", detail_blocks(learned)
    )
    return rrb.Horizontal(bars, details, name="Learning")


def _text(
    recording: rr.RecordingStream, origin: str, name: str, words: str | Sequence[Block]
) -> rrb.View:
    """A view of Markdown, without a title bar if it has no name."""
    text = words if isinstance(words, str) else markdown(words)
    recording.log(
        origin, rr.TextDocument(as_text(text), media_type=rr.MediaType.MARKDOWN), static=True
    )
    return rrb.TextDocumentView(origin=origin, name=name or origin, titlebar=bool(name))
