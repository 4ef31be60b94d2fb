"""Recording: one learnt flight as a Rerun file, with the blueprint that shows it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from mavdem.analysis.findings import findings, known_wind
from mavdem.confidence import LEVEL
from mavdem.dem import Learned
from mavdem.evaluate.held_out import FORECAST, HeldOut
from mavdem.files import atomic_write
from mavdem.flight import Flight
from mavdem.report import palette
from mavdem.report.blocks import markdown
from mavdem.report.numbers import AxisCommand, Labels, named, place, plus_minus, readable, state_names
from mavdem.report.screen import key_figures, screen, title
from mavdem.view.chart import bar_chart
from mavdem.view.learning import learning_view
from mavdem.view.time_plot import Plot, PlotLine, area, collapsed_panels, faint, range_of, spans, utf8

Array = NDArray[np.float64]

BEYOND = 0.15  # how far a plot extends beyond the measured values, in spans of them, where a forecast does


def write_recording(
    path: str | os.PathLike[str], flights: Sequence[Flight], learned: Learned, held_out: HeldOut
) -> None:
    """Writes the model of ``flights`` and the forecasts of ``held_out`` windows as an .rrd file.

    The file appears whole or not at all, replaces one that is there, and opens with its own blueprint: the flight over
    its seconds, more of it, how the model was learnt, and the report. Angles are in degrees.

    The folder of ``path`` must be there; ``learned`` is the model of ``flights``. ``OSError`` if it cannot be written.
    """
    recording = rr.RecordingStream("mavdem")
    memory = recording.memory_recording()
    recording.send_recording_name(utf8(Path(str(flights[0].provenance.get("source", path))).name))
    series = FlightSeries(flights, learned, held_out)
    tabs = rrb.Tabs(
        _flight(recording, series),
        _details(recording, series),
        learning_view(recording, learned),
        _text(recording, "report", "Report", markdown([title(flights), *screen(learned, held_out)])),
        active_tab=0,
    )
    recording.send_blueprint(
        rrb.Blueprint(tabs, *collapsed_panels(play_state="paused"), auto_views=False, auto_layout=False),
        make_active=False,
    )
    # Rerun does not report when a file it writes fails, as on a full disk; Python does.
    contents = memory.drain_as_bytes()
    with atomic_write(path) as file:
        file.write(contents)


class FlightSeries:
    """The series of a learnt flight over seconds from its first sample, in degrees, as plots."""

    def __init__(self, flights: Sequence[Flight], learned: Learned, held_out: HeldOut) -> None:
        self.flights, self.learned, self.held_out = flights, learned, held_out
        self.labels = Labels.of(learned)
        self._start = float(flights[0].time[0])
        times = [flight.time - self._start for flight in flights]
        self.windows = held_out.time - self._start
        after = self.windows[:, 0] > times[-1][-1]
        # A gap after each segment.
        self.time = np.concatenate([np.append(one, one[-1]) for one in [*times, *self.windows[after]]])
        self._outputs = _with_gaps([*(flight.outputs for flight in flights), *held_out.measured[after]])
        self.end = float(self.time[-1])

    def output(self, i: int) -> list[Plot]:
        """An output and its forecasts in held-out windows, and what these leave."""
        name, unit = self.labels.output_names[i], readable(self.labels.output_units[i])
        measured, time = unit.scale * self._outputs[:, i], _with_gaps(self.windows, last=True)
        in_windows, forecast, half = (
            unit.scale * _with_gaps(values[:, :, i])
            for values in (self.held_out.measured, self.held_out.forecasts[FORECAST], self.held_out.band)
        )
        low, high = range_of(measured)
        span = high - low
        forecast = np.clip(forecast, low - 9 * span, high + 9 * span)  # it may overflow
        inner = range_of(np.clip(forecast, low - BEYOND * span, high + BEYOND * span), measured)
        residual = in_windows - forecast
        outer = range_of(np.clip(residual, -span, span))
        colour = faint(palette.PREDICTED, palette.BAND_OPACITY)
        seconds = f"{self.held_out.seconds:.2g} s"
        return [
            Plot(
                rr.new_entity_path(["outputs", name]),
                f"{named(name.capitalize(), unit.name)}: measured, and forecast in held-out windows of {seconds}",
                inner,
                [
                    *self._held_out(inner),
                    area("90 % band", colour, time, *np.clip([forecast - half, forecast + half], *_wider(inner))),
                    PlotLine("measured", palette.MEASURED, self.time, measured, 1.2),
                    PlotLine("forecast", palette.PREDICTED, time, forecast, 1.8),
                ],
            ),
            Plot(
                rr.new_entity_path(["residuals", name]),
                f"{named('Residual: measured minus forecast', unit.name)}",
                outer,
                [
                    *self._held_out(outer),
                    area("90 % band", colour, time, *np.clip([-half, half], *_wider(outer))),
                    PlotLine("residual", palette.PREDICTED, time, residual, 1.2),
                ],
            ),
        ]

    def _held_out(self, values: tuple[float, float]) -> list[PlotLine]:
        """What is held out, behind the lines."""
        starts, ends = self.windows[:, 0], self.windows[:, -1]
        apart = starts[1:] - ends[:-1] > 1.5 * self.learned.dt
        parts = list(zip(starts[np.append(True, apart)], ends[np.append(apart, True)], strict=True))
        return spans("held out", faint(palette.MEASURED, palette.HELD_OUT_OPACITY), parts, values)

    def command(self) -> Plot:
        """By how much the motors that turn the vehicle one way run above the others."""
        command = AxisCommand.of(self.learned)
        inputs = command.series(np.vstack([flight.inputs for flight in self.flights]))
        title = f"{named(command.name.capitalize(), command.unit)}: the motors' difference, about its mean"
        return self._of_flights("command", title, {command.name: (palette.COMMAND, inputs)})

    def motors(self) -> Plot:
        """What drives the vehicle: several inputs, each beyond the mean of all, by their places."""
        inputs, unit = np.vstack([flight.inputs for flight in self.flights]), self.labels.input_units[0]
        several = inputs.shape[1] > 1
        values = inputs - inputs.mean(axis=1, keepdims=True) if several else inputs
        names = map(place, self.labels.input_names)
        title = named("Inputs, each beyond the mean of all" if several else "Input", unit)
        return self._of_flights(
            "inputs", title, {name: (palette.distinct(i), values[:, i]) for i, name in enumerate(names)}
        )

    def wind(self) -> Plot | None:
        """The wind's torque with its band, and gusts behind it; None where it is not known."""
        wind, unit = known_wind(self.learned.wind, self.learned.physical), readable("rad/s²")
        if wind is None or len(wind.torque) != sum(map(len, self.flights)):
            return None
        torque, band = unit.scale * wind.torque, unit.scale * wind.band
        plot = self._of_flights(
            "wind", f"Disturbance torque (wind), {unit.name}", {"torque": (palette.DISTURBANCE, torque)}
        )
        time, shown = plot.lines[0].time, plot.range
        edges = self._with_gaps_of_flights(np.stack([torque - band, torque + band]).T)
        clock = np.concatenate([flight.time for flight in self.flights]) - self._start
        gusts = [(clock[gust.sample], clock[gust.sample] + gust.length) for gust in wind.gusts]
        behind = [
            *spans(f"gust ({len(gusts)})", faint(palette.GUST, 0.5), gusts, shown),
            area(
                "90 % band", faint(palette.DISTURBANCE, palette.BAND_OPACITY), time, *np.clip(edges.T, *_wider(shown))
            ),
        ]
        return Plot(plot.origin, plot.title, shown, [*behind, *plot.lines])

    def dem(self) -> list[Plot]:
        """What DEM makes of each sample: F(t) and the process noise w."""
        places, noise = self.learned.process_noise()
        clock = np.concatenate([flight.time for flight in self.flights])[places] - self._start
        energy = self.learned.free_energy_of_samples
        names = state_names(self.labels, self.learned)
        shown = [
            PlotLine(name, palette.distinct(i), clock, np.degrees(noise[:, i]), 1.0) for i, name in enumerate(names)
        ]
        return [
            Plot("process_noise", "Process noise w of DEM, ° and s", range_of(np.degrees(noise)), shown),
            Plot(
                "free_energy_of_samples",
                "Free energy F(t) of each sample, nats",
                range_of(energy),
                [PlotLine("F(t)", palette.BOUND, clock, energy, 1.2)],
            ),
        ]

    def _of_flights(self, origin: str, title: str, lines: dict[str, tuple[str, Array]]) -> Plot:
        """Series (T,) over the training data, by name with their colours."""
        time = np.concatenate([np.append(one.time, one.time[-1]) for one in self.flights]) - self._start
        drawn = [
            PlotLine(name, colour, time, self._with_gaps_of_flights(values), 1.2)
            for name, (colour, values) in lines.items()
        ]
        return Plot(origin, title, range_of(*(line.values for line in drawn)), drawn)

    def _with_gaps_of_flights(self, values: Array) -> Array:
        return _with_gaps(np.split(values, np.cumsum([len(flight) for flight in self.flights])[:-1]))


def _with_gaps(parts: Sequence[Array] | Array, last: bool = False) -> Array:
    """Parts (N, …) one after the other, after each a NaN, which draws no line, or its ``last`` value again."""
    return np.concatenate(
        [np.concatenate([one, one[-1:] if last else np.full_like(one[-1:], np.nan)]) for one in parts]
    )


def _wider(values: tuple[float, float]) -> tuple[float, float]:
    """A range beyond what is visible: what lies outside need not be drawn."""
    return values[0] - (values[1] - values[0]), values[1] + (values[1] - values[0])


def _flight(recording: rr.RecordingStream, series: FlightSeries) -> rrb.Container:
    """The key figures above, then the flight over time, verdicts and motors beside it."""
    figures = key_figures(series.learned, series.held_out)
    strip = [_text(recording, f"figures/{i}", "", _figure(*figure)) for i, figure in enumerate(figures)]
    plots = [*series.output(0), series.command(), *filter(None, [series.wind()])]
    for plot in plots:
        plot.draw(recording)
    verdicts = "\n\n".join(
        f"**{one.purpose.capitalize()}: {one.grade}.** {one.reason}"
        for one in findings(series.learned, series.held_out)
    )
    beside: list[rrb.View] = [_text(recording, "verdict", "Verdict", verdicts)]
    read = series.learned.physical
    if read is not None and read.status["effect"] != "not identifiable":
        unit = readable("rad/s²")
        values, halves = unit.scale * read.effect, unit.scale * read.interval(LEVEL).effect
        name = f"Motor effect, {unit.name} per {series.labels.input_units[0] or 'unit'} ± {LEVEL:.0%} interval"
        labels = [
            f"{place(motor)} {plus_minus(*pair)}"
            for motor, *pair in zip(series.labels.input_names, values, halves, strict=True)
        ]
        beside.append(bar_chart(recording, "effect", name, labels, values, halves))
    return rrb.Vertical(
        rrb.Horizontal(*strip, column_shares=[max(len(value.split(" (")[0]), 11) for _, value in figures]),
        rrb.Horizontal(
            rrb.Vertical(*(plot.view(series.end) for plot in plots), row_shares=[34, 20, 20, 26][: len(plots)]),
            rrb.Vertical(*beside, row_shares=[42, 58][: len(beside)]),
            column_shares=[78, 22],
        ),
        row_shares=[12.5, 87.5],
        name="Flight",
    )


def _figure(name: str, value: str) -> str:
    """A figure in large letters, and what stands in brackets after it below that."""
    number, bracket, remark = value.partition(" (")
    return f"{name[:1].upper()}{name[1:]}\n### {number}\n{remark.removesuffix(')') if bracket else ''}"


def _details(recording: rr.RecordingStream, series: FlightSeries) -> rrb.Container:
    """The other outputs, the motors, and what DEM makes of each sample."""
    others = range(1, len(series.labels.output_names))
    plots = [*(plot for i in others for plot in series.output(i)), series.motors(), *series.dem()]
    for plot in plots:
        plot.draw(recording)
    return rrb.Vertical(*(plot.view(series.end) for plot in plots), name="Details")


def _text(recording: rr.RecordingStream, origin: str, name: str, words: str) -> rrb.View:
    """A view of Markdown, without a title bar if it has no name."""
    recording.log(origin, rr.TextDocument(utf8(words), media_type=rr.MediaType.MARKDOWN), static=True)
    return rrb.TextDocumentView(origin=origin, name=name or origin, titlebar=bool(name))
