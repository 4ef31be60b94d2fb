"""Recording: one learnt flight as a Rerun file, with the blueprint that shows it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from math import floor, log10
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from mavdem.dem import Learned
from mavdem.dem.priors import hyperparameter_groups
from mavdem.evaluate.held_out import HeldOut
from mavdem.files import atomic_write
from mavdem.flight import Flight
from mavdem.report.blocks import markdown
from mavdem.report.names import entries, left_free, named, short, state_names, state_rate_units
from mavdem.report.screen import screen, title
from mavdem.view import lines
from mavdem.view.lines import (
    ITERATIONS_A_SECOND,
    LABELS,
    LABELS_ACROSS,
    LABELS_IF_LOW,
    Line,
    collapsed_panels,
    readable_range,
    time_plot,
    utf8,
)
from mavdem.view.series import OutputSeries, by_group, estimate_band, output_series, prior_outweighs_data

Array = NDArray[np.float64]


def write_recording(
    path: str | os.PathLike[str], flights: Sequence[Flight], learned: Learned, held_out: HeldOut
) -> None:
    """Writes the model of ``flights`` and the forecasts of ``held_out`` windows as an .rrd file.

    The file appears whole or not at all, replaces one that is there, and opens with its own blueprint. Angles are in
    degrees where they are measured or forecast, in rad in the model.

    The folder of ``path`` must be there; ``learned`` is the model of ``flights``. ``OSError`` if it cannot be written.
    """
    train, seen = flights[0], output_series(flights, learned, held_out)
    time = np.concatenate([flight.time for flight in flights]) - train.time[0]
    recording = rr.RecordingStream("mavdem")
    memory = recording.memory_recording()
    recording.send_blueprint(_blueprint(flights, learned, seen), make_active=False)
    recording.send_recording_name(utf8(Path(str(train.provenance.get("source", path))).name))
    document = rr.TextDocument(utf8(_result(flights, learned, held_out)), media_type=rr.MediaType.MARKDOWN)
    recording.log("result", document, static=True)
    for output in seen:
        _output(recording, output)
    _inputs(recording, flights, time)
    _of_samples(recording, train, time, learned)
    _parameters(recording, train, learned)
    _free_energy(recording, learned)
    _noise_precisions(recording, train, learned)
    # Rerun does not report when a file it writes fails, as on a full disk; Python does.
    contents = memory.drain_as_bytes()
    with atomic_write(path) as file:
        file.write(contents)


def _result(flights: Sequence[Flight], learned: Learned, held_out: HeldOut) -> str:
    return markdown([title(flights), *screen(learned, held_out)])


def _output(recording: rr.RecordingStream, output: OutputSeries) -> None:
    root = rr.new_entity_path(["outputs", output.name])
    before, after = output.time, output.held_out_time
    for name, label, colour, width, time, values in (
        ("band", "90 % band", lines.BAND, 1.5, after, output.band),
        ("constant_mean", "constant mean", lines.TRIVIAL, 1.5, after, output.constant_mean),
        ("dem_forecast", "DEM: forecast", lines.FORECAST, 2.5, after, output.forecast),
        ("dem_one_step", "DEM: one step ahead", lines.PREDICTED, 5.0, before, output.one_step),
        # Drawn in the order of their paths: this one last, thin on the thick prediction.
        ("measured", "measured", lines.MEASURED, 1.5, output.time, output.measured),
    ):
        Line(f"{root}/{name}", label, colour, width).over_time(recording, time, values)


def _inputs(recording: rr.RecordingStream, flights: Sequence[Flight], time: Array) -> None:
    inputs = np.vstack([flight.inputs for flight in flights])
    for i, (name, values) in enumerate(zip(flights[0].input_names, inputs.T, strict=True)):
        Line(rr.new_entity_path(["inputs", name]), name, lines.distinct(i)).over_time(recording, time, values)


def _of_samples(recording: rr.RecordingStream, train: Flight, time: Array, learned: Learned) -> None:
    """The process noise and F(t) of each sample."""
    places, noise = learned.process_noise()
    time = time[places]
    units = state_rate_units(train, learned)
    for i, (name, unit) in enumerate(zip(state_names(train, learned), units, strict=True)):
        line = Line(rr.new_entity_path(["process_noise", name]), named(name, unit), lines.distinct(i))
        line.over_time(recording, time, noise[:, i])
    line = Line("free_energy_of_samples", "F(t)", lines.MEASURED)
    line.over_time(recording, time, learned.free_energy_of_samples)


def _parameters(recording: rr.RecordingStream, train: Flight, learned: Learned) -> None:
    learning = learned.learning
    first = 0
    for matrix, free in left_free(learned).items():
        # Colours are for those that are shown, which are those left free.
        colours = np.cumsum(free) - 1
        for i, (row, column) in enumerate(entries(train, learned)[matrix]):
            root = ["parameters", "free" if free[i] else "known_beforehand", matrix, f"{row} from {column}"]
            mean, sd = learning.theta[:, first + i], learning.theta_sd[:, first + i]
            _estimate(recording, root, f"{row} ← {short(column)}", lines.distinct(int(colours[i])), mean, sd)
        first += len(free)


def _free_energy(recording: rr.RecordingStream, learned: Learned) -> None:
    energy = learned.free_energy
    Line("free_energy/total", "F̄", lines.MEASURED, 2.5).over_iterations(recording, energy.total)
    for i, (name, term) in enumerate(energy.terms.items()):
        # Their sizes differ by a factor of 10 000: minus their final values all changes are visible in one plot.
        label = f"{name.removeprefix('prediction ')}: {round(float(term[-1])):,}"
        line = Line(rr.new_entity_path(["free_energy", "terms", name]), label, lines.distinct(i))
        line.over_iterations(recording, term - term[-1])


def _noise_precisions(recording: rr.RecordingStream, train: Flight, learned: Learned) -> None:
    learning, states = learned.learning, state_names(train, learned)
    of_outputs, of_states = hyperparameter_groups(learned.settings, len(states), len(train.output_names))
    # Each process noise in the colour of its own picture, those of the measurements after them.
    process = by_group("w", states, of_states)
    measurement = by_group("z", train.output_names, of_outputs)
    named_colours = [(name, len(process) + i) for i, name in enumerate(measurement)]
    named_colours += [(name, i) for i, name in enumerate(process)]
    fixed = prior_outweighs_data(learned)
    for i, (name, colour) in enumerate(named_colours):
        root, label = ["noise_precisions", name], f"{name} (fixed)" if fixed[i] else name
        _estimate(recording, root, label, lines.distinct(colour), learning.lambda_[:, i], learning.lambda_sd[:, i])


def _estimate(
    recording: rr.RecordingStream, root: list[str], name: str, colour: lines.Colour, mean: Array, sd: Array
) -> None:
    """A posterior mean and its band by iteration; the legend counts them as one, since they share name and colour."""
    band = np.stack(estimate_band(mean, sd), axis=-1)
    Line(rr.new_entity_path([*root, "band"]), name, colour, 0.6).over_iterations(recording, band)
    Line(rr.new_entity_path([*root, "mean"]), name, colour, 2.5).over_iterations(recording, mean)


BESIDE_LEGEND, BESIDE_WIDE_LEGEND, BESIDE_WIDEST_LEGEND = 1.5, 1.8, 2.7
"""Length of a time axis, in lengths of its lines, with room for the legend beside them."""

TO_LAST_NUMBER = 1.06  # the same without a legend, for the last number of the axis not to be cut off

FORECAST_SECONDS = 8.0  # of the picture of forecasts
FORECAST_HEIGHT, AROUND_PLOT, LEGEND_ENTRY = 190.0, 48.0, 29.5
"""Points: a picture of a forecast; title and axis of any; what one line of a legend, which may fill four fifths of a
plot, takes of it."""

MOST_ENTRIES = 12  # lines of a legend that are given room; in a longer one, scroll


def _blueprint(flights: Sequence[Flight], learned: Learned, series: list[OutputSeries]) -> rrb.Blueprint:
    """The result in words, the flight, its forecast, and how the model was learnt, in columns from left to right."""
    last = float(len(learned.free_energy) - 1)
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.TextDocumentView(origin="result", name="Result"),
            rrb.Vertical(*_flight_views(flights, learned, series)),
            _forecasts_and_parameters(series, learned, last),
            rrb.Vertical(*_learning_views(learned, last), row_shares=[1, 2, 1]),
            column_shares=[25, 29, 22, 24],
        ),
        *collapsed_panels(),
        auto_views=False,
        auto_layout=False,
    )


def _flight_views(flights: Sequence[Flight], learned: Learned, series: list[OutputSeries]) -> list[rrb.View]:
    """One above the other over the same seconds."""
    train = flights[0]
    end = BESIDE_LEGEND * float(series[0].time[-1])
    return [
        *(
            time_plot(
                f"{named(output.name.capitalize(), output.unit)}: measured and predicted",
                rr.new_entity_path(["outputs", output.name]),
                (0.0, end),
                output.range,
            )
            for output in series
        ),
        time_plot(
            named("Motors", _common(train.input_units)),
            "inputs",
            (0.0, end),
            _range_of(*(flight.inputs for flight in flights)),
        ),
        time_plot(
            "Process noise w: wind and unmodelled dynamics",
            "process_noise",
            (0.0, end),
            _range_of(learned.process_noise()[1]),
        ),
        time_plot(
            "Free energy F(t) of each sample, nats",
            "free_energy_of_samples",
            (0.0, end),
            _range_of(learned.free_energy_of_samples),
            legend=False,
        ),
    ]


def _forecasts_and_parameters(series: list[OutputSeries], learned: Learned, last: float) -> rrb.Vertical:
    views = [_forecast_view(output) for output in series]
    heights = [FORECAST_HEIGHT] * len(views)
    learning = learned.learning
    first = 0
    for matrix, free in left_free(learned).items():
        shown = first + np.flatnonzero(free)
        first += len(free)
        if len(shown):
            edges = estimate_band(learning.theta[:, shown], learning.theta_sd[:, shown])
            values = _range_of(*edges, labels=LABELS_IF_LOW)
            time = _iterations(BESIDE_WIDE_LEGEND * last)
            views.append(time_plot(f"{matrix} by iteration", f"parameters/free/{matrix}", time, values))
            heights.append(AROUND_PLOT + LEGEND_ENTRY * min(len(shown), MOST_ENTRIES))
    return rrb.Vertical(*views, row_shares=heights)


def _forecast_view(output: OutputSeries) -> rrb.View:
    """The last held-out windows; in the colours of the view to its left."""
    end = float(output.held_out_time[-1])
    start = max(end - FORECAST_SECONDS, float(output.time[0]))
    origin = rr.new_entity_path(["outputs", output.name])
    title = f"Forecast of {named(output.name, output.unit)}"
    return time_plot(title, origin, (start, end), output.range, legend=False)


def _learning_views(learned: Learned, last: float) -> list[rrb.View]:
    """F̄, its terms and λ by iteration; F̄ over the range of all but iteration 0, which would flatten the others."""
    energy, learning = learned.free_energy, learned.learning
    terms = np.stack([term - term[-1] for term in energy.terms.values()], axis=-1)
    title = f"F̄ by iteration, nats (prior: {energy[0]:,.0f})"
    return [
        time_plot(title, "free_energy/total", _iterations(TO_LAST_NUMBER * last), _range_of(energy[1:]), legend=False),
        time_plot(
            "Terms of F̄ minus their final values (in the legend), nats",
            "free_energy/terms",
            _iterations(BESIDE_WIDEST_LEGEND * last),
            _range_of(terms[1:]),
        ),
        time_plot(
            "λ by iteration: log noise precisions",
            "noise_precisions",
            _iterations(BESIDE_WIDE_LEGEND * last),
            _range_of(*estimate_band(learning.lambda_, learning.lambda_sd)),
        ),
    ]


def _iterations(end: float) -> tuple[float, float]:
    """Where iterations 0 to ``end`` are, or on to the next 1, 10 or 100 s if only that is numbered."""
    seconds = max(end / ITERATIONS_A_SECOND, TO_LAST_NUMBER)
    step = 10.0 ** floor(log10(seconds))
    return 0.0, seconds if seconds <= LABELS_ACROSS * step else max(seconds, 10 * TO_LAST_NUMBER * step)


def _range_of(*values: Array, labels: int = LABELS) -> tuple[float, float]:
    return readable_range(float(min(v.min() for v in values)), float(max(v.max() for v in values)), labels)


def _common(units: tuple[str, ...]) -> str:
    return units[0] if len(set(units)) == 1 else ""
