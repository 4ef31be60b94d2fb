"""Blueprint: how a recording is laid out when it is opened, everything seen without a click."""

from __future__ import annotations

from math import floor, log10

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from mavdem.dem import Learned
from mavdem.flight import Flight
from mavdem.naming import left_free, named
from mavdem.view.lines import FLIGHT_TIME, ITERATIONS_A_SECOND
from mavdem.view.outlook import Outlook
from mavdem.view.parameters import estimate_band
from mavdem.view.ticks import LABELS, LABELS_ACROSS, LABELS_IF_LOW, readable_range

BESIDE_LEGEND, BESIDE_WIDE_LEGEND, BESIDE_WIDEST_LEGEND = 1.5, 1.8, 2.7
"""How far a view reaches, in lengths of its lines, for its legend to stand beside them and cover none."""

TO_LAST_NUMBER = 1.06
"""The same without a legend, for the last number of the axis not to be cut off."""

FORECAST_HEIGHT, AROUND_PLOT, LEGEND_ENTRY = 190.0, 48.0, 29.5
"""Points: a picture of a forecast; title and axis of any; what one line of a legend, which may fill four fifths of a
plot, takes of it."""

MOST_ENTRIES = 12
"""Lines of a legend that are given room; in a longer one, scroll."""


def blueprint(train: Flight, test: Flight, learned: Learned, outlooks: list[Outlook]) -> rrb.Blueprint:
    """The result in words, the flight, its forecast, and how the model was learnt, in columns from left to right."""
    last = float(len(learned.free_energy) - 1)
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.TextDocumentView(origin="result", name="Result"),
            rrb.Vertical(*_flight(train, test, learned, outlooks)),
            _forecasts_and_parameters(outlooks, learned, last),
            rrb.Vertical(*_free_energy(learned, last), _noise_precisions(learned, last), row_shares=[1, 2, 1]),
            column_shares=[25, 29, 22, 24],
        ),
        rrb.TimePanel(state="collapsed", timeline=FLIGHT_TIME),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _flight(train: Flight, test: Flight, learned: Learned, outlooks: list[Outlook]) -> list[rrb.View]:
    """One above the other over the same seconds."""
    end = BESIDE_LEGEND * float(outlooks[0].time[-1])
    return [
        *(
            _plot(
                f"{named(outlook.name.capitalize(), outlook.unit)}: measured and predicted",
                rr.new_entity_path(["outputs", outlook.name]),
                (0.0, end),
                outlook.range,
            )
            for outlook in outlooks
        ),
        _plot(named("Motors", _common(train.input_units)), "inputs", (0.0, end), _range_of(train.inputs, test.inputs)),
        _plot(
            "Process noise: wind and all else the model leaves out",
            "process_noise",
            (0.0, end),
            _range_of(learned.process_noise()[1]),
        ),
        _plot(
            "Free energy F(t), nats: low where a sample surprises the model",
            "free_energy_of_samples",
            (0.0, end),
            _range_of(learned.free_energy_of_samples),
            legend=False,
        ),
    ]


def _forecasts_and_parameters(outlooks: list[Outlook], learned: Learned, last: float) -> rrb.Vertical:
    views = [_forecast(outlook) for outlook in outlooks]
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
            views.append(_plot(f"{matrix} by iteration", f"parameters/free/{matrix}", time, values))
            heights.append(AROUND_PLOT + LEGEND_ENTRY * min(len(shown), MOST_ENTRIES))
    return rrb.Vertical(*views, row_shares=heights)


def _forecast(outlook: Outlook) -> rrb.View:
    """The held-out part, with a third as much of the training before it; in the colours of the view to its left."""
    end = float(outlook.time[-1])
    start = outlook.boundary - (end - outlook.boundary) / 3
    origin = rr.new_entity_path(["outputs", outlook.name])
    title = f"Forecast of {named(outlook.name, outlook.unit)}"
    return _plot(title, origin, (start, end), outlook.range, legend=False)


def _free_energy(learned: Learned, last: float) -> list[rrb.View]:
    """By iteration, over the range of all but iteration 0: how far off the prior is would flatten what comes after."""
    energy = learned.free_energy
    terms = np.stack([term - term[-1] for term in energy.terms.values()], axis=-1)
    title = f"F̄ by iteration, nats (prior: {energy[0]:,.0f})"
    return [
        _plot(title, "free_energy/total", _iterations(TO_LAST_NUMBER * last), _range_of(energy[1:]), legend=False),
        _plot(
            "Terms of F̄ less their last values (named), nats",
            "free_energy/terms",
            _iterations(BESIDE_WIDEST_LEGEND * last),
            _range_of(terms[1:]),
        ),
    ]


def _noise_precisions(learned: Learned, last: float) -> rrb.View:
    learning = learned.learning
    values = _range_of(*estimate_band(learning.lambda_, learning.lambda_sd))
    title = "λ by iteration: log precisions of noise"
    return _plot(title, "noise_precisions", _iterations(BESIDE_WIDE_LEGEND * last), values)


def _iterations(end: float) -> tuple[float, float]:
    """Where iterations 0 to ``end`` are, or on to the next 1, 10 or 100 s if only that is numbered."""
    seconds = max(end / ITERATIONS_A_SECOND, TO_LAST_NUMBER)
    step = 10.0 ** floor(log10(seconds))
    return 0.0, seconds if seconds <= LABELS_ACROSS * step else max(seconds, 10 * TO_LAST_NUMBER * step)


def _range_of(*values: NDArray[np.float64], labels: int = LABELS) -> tuple[float, float]:
    return readable_range(float(min(v.min() for v in values)), float(max(v.max() for v in values)), labels)


def _plot(
    name: str,
    origin: str,
    time: tuple[float, float],
    values: tuple[float, float],
    legend: bool = True,
) -> rrb.TimeSeriesView:
    """Over ranges of flight time, s, and of values."""
    start, end = (rr.TimeRangeBoundary.absolute(seconds=second) for second in time)
    return rrb.TimeSeriesView(
        name=name,
        origin=origin,
        axis_x=rrb.archetypes.TimeAxis(view_range=rr.TimeRange(start=start, end=end)),
        axis_y=rrb.ScalarAxis(range=values),
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop, visible=legend),
    )


def _common(units: tuple[str, ...]) -> str:
    return units[0] if len(set(units)) == 1 else ""
