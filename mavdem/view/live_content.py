"""The layout of a live view in Rerun, its channels, and the texts that are shown beside the plots."""

from typing import NamedTuple

import rerun as rr
import rerun.blueprint as rrb

from mavdem.confidence import CONFIDENCE_LEVEL
from mavdem.containers import Names
from mavdem.dataset.axes import AXES
from mavdem.dem.online.anomaly_marks import MEAN_SECONDS_BETWEEN_FALSE_MARKS
from mavdem.dem.online.learner import TOO_FEW_SAMPLES
from mavdem.live import SessionStatus
from mavdem.live.display import DisplayRow
from mavdem.live.history import REPORTED_HORIZON
from mavdem.report.blocks import markdown
from mavdem.report.live import watched_quantities
from mavdem.report.numbers import (
    TORQUE_UNIT,
    name_with_unit,
    unit_per_input,
)
from mavdem.report.screen import assessment_blocks
from mavdem.report.templates import render_section
from mavdem.view.plots import BOOT_CLOCK, blueprint, events_view

FLIGHT_SECONDS = 20.0
"""s of flight that the plots show."""

CARD_COUNT = 5
"""Texts above the plots: state, prediction, wind, wind torque and physical parameters."""

LEGEND = (
    "Error ratios: beside the better of the last sample and the mean. Surprise is how far F(t) is below its recent "
    "median: 1 is the worst of twenty samples. Where it stays high, an event says so; one in "
    f"{MEAN_SECONDS_BETWEEN_FALSE_MARKS / 60:.0f} minutes is expected without a change. It is a model misfit where the "
    "motors' command explains the acceleration, and a disturbance where it does not."
)


class Channels(NamedTuple):
    """The channels of a live flight; their names and units as of a ``Flight``."""

    title: str
    """of the recording: vehicle and link"""
    dt: float
    """sampling step, s"""
    horizons: tuple[int, ...]
    """of the online learner, in steps"""
    input_names: Names
    output_names: Names
    input_units: Names
    output_units: Names


def live_blueprint(channels: Channels) -> rrb.Blueprint:
    """Returns the layout of a live flight in three tabs: the flight, details of its samples, and the status.

    The first tab has texts at the top, plots over the last seconds below, and what is watched with the events beside
    them. The paths of entities are those that ``LiveWriter`` and ``SinkThread`` write to.

    Args:
        channels: names and units of what is shown.
    """

    def plot(name: str, origin: str) -> rrb.TimeSeriesView:
        """Returns a plot of the last ``FLIGHT_SECONDS`` before the time cursor, and of the predictions after it.

        The viewer loads only the samples of this range, which keeps it fast during a long flight.

        Args:
            name: title of the plot.
            origin: path of the entity whose lines the plot shows.
        """
        start = rr.TimeRangeBoundary.cursor_relative(seconds=-FLIGHT_SECONDS)
        end = rr.TimeRangeBoundary.cursor_relative(seconds=REPORTED_HORIZON)
        axis = rrb.archetypes.TimeAxis(view_range=rr.TimeRange(start=start, end=end))
        visible_range = rrb.VisibleTimeRange(BOOT_CLOCK, start=start, end=end)
        return rrb.TimeSeriesView(
            name=name,
            origin=origin,
            axis_x=axis,
            time_ranges=[visible_range],
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop),
        )

    axes = [plot(name_with_unit(axis.capitalize(), "°"), f"axes/{axis}") for axis in AXES]
    input_unit = channels.input_units[0] if channels.input_units else ""
    motors = name_with_unit("Motors", input_unit)
    plots = rrb.Vertical(
        *axes,
        plot("Rates, °/s", "rates"),
        plot(motors, "motors"),
        plot("Wind, m/s", "air"),
        plot(f"Wind torque on {channels.output_names[0]}, {TORQUE_UNIT.name}", "wind"),
    )
    documents = [
        rrb.TextDocumentView(origin=f"figures/{number}", name=f"Figure {number}", titlebar=False)
        for number in range(CARD_COUNT + 1)
    ]
    # The last text, what is watched, is longer than the others and stands beside the plots.
    cards = documents[:CARD_COUNT]
    watched = documents[CARD_COUNT]
    side = rrb.Vertical(watched, events_view(), row_shares=[20, 80])
    bottom = rrb.Horizontal(plots, side, column_shares=[70, 30])
    flight = rrb.Vertical(rrb.Horizontal(*cards), bottom, row_shares=[15, 85], name="Flight")
    surprise = plot("Surprise: how unusual a sample is", "surprise")
    samples = plot("F(t), nats: low at an unusual sample", "free_energy_of_samples")
    details = rrb.Vertical(surprise, samples, name="Details")
    status = rrb.TextDocumentView(origin="status", name="Status")
    return blueprint(rrb.Tabs(flight, details, status, active_tab=0), play_state="following")


def figures(
    status: SessionStatus, row: DisplayRow, channels: Channels, trained_until: float | None
) -> Names:
    """Returns the texts that are shown beside the plots.

    Args:
        status: state of the session.
        row: the latest row, with the estimates at its time.
        channels: names and units of the row's channels.
        trained_until: time of the last sample that the latest model was trained on, s of the boot clock; None before
            the first model.

    Returns:
        Markdown: state, prediction, wind, wind torque, physical parameters, and what is watched.
    """
    judgement = status.model_judgement
    estimate = row.estimate
    cards = render_section(
        "live_cards",
        status=status,
        watched=watched_quantities(status.watch_facts),
        row=row,
        channels=channels,
        until=trained_until,
        reason=_missing_model_reason(status, trained_until),
        is_bad=judgement is not None and judgement.headline.is_bad,
        now=estimate,
        physical=None if estimate is None else estimate.physical,
        level=CONFIDENCE_LEVEL,
        unit=TORQUE_UNIT,
        per_input=unit_per_input(TORQUE_UNIT, channels.input_units[0]),
    )
    return tuple(card.text for card in cards)


def _missing_model_reason(status: SessionStatus, trained_until: float | None) -> str:
    """Returns why there is no model, or no newer one; empty where there is no reason to give."""
    if status.obstacle is not None:
        return status.obstacle.advised
    return TOO_FEW_SAMPLES.advised if trained_until is None else ""


def status_document(
    status: SessionStatus, row: DisplayRow, channels: Channels, trained_until: float | None
) -> str:
    """Returns the text of the tab "Status": the session, the judgement of the flight so far, and a legend.

    The arguments are those of :func:`figures`.

    Returns:
        Markdown, whose words come from the templates of live sessions.
    """
    title, *details = render_section(
        "live_details",
        status=status,
        row=row,
        channels=channels,
        until=trained_until,
        reason=_missing_model_reason(status, trained_until),
    )
    paragraphs = [title.text]
    if status.findings is not None:
        blocks = assessment_blocks(status.findings, status.overall_judgement)
        paragraphs.append(markdown(blocks))
    paragraphs += [detail.text for detail in details]
    paragraphs.append(LEGEND)
    return "\n\n".join(paragraphs)
