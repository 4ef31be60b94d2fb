"""The layout of a live view in Rerun, its channels, and the texts that are shown next to the plots."""

from typing import NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from mavdem.confidence import CONFIDENCE_LEVEL
from mavdem.containers import Names
from mavdem.dataset.axes import AXES
from mavdem.dem.online.anomaly_marks import MEAN_SECONDS_BETWEEN_FALSE_MARKS
from mavdem.dem.online.learner import TOO_FEW_SAMPLES
from mavdem.facts import Level
from mavdem.facts.model import ModelName
from mavdem.live import SessionStatus
from mavdem.live.display import DisplayRow
from mavdem.live.history import REPORTED_HORIZON
from mavdem.plant.online_wind_torque import is_torque_resolved
from mavdem.report.blocks import markdown
from mavdem.report.live import (
    headline_and_next_step,
    unrepaired_fault_beside_next_step,
    watched_quantities_text,
)
from mavdem.report.numbers import (
    TORQUE_UNIT,
    display_unit,
    name_with_unit,
    unit_per_input,
)
from mavdem.report.screen import assessment_blocks
from mavdem.report.templates import render_section
from mavdem.view.axes import WIDTH_PER_SPAN
from mavdem.view.first_tab import SideTexts, first_tab, free_energy_title, plot_titles
from mavdem.view.live_scene import live_scene_view
from mavdem.view.plots import BOOT_CLOCK, LEGEND, blueprint, events_view

FLIGHT_SECONDS = 20.0
"""Length of the flight that the plots show, s, up to now: a choice."""

STATUS_LEGEND = (
    "Error ratios: beside the better of the last sample and the mean. Surprise is how far F(t) is below its recent "
    "median: 1 is the worst of twenty samples. Where it stays high, an event says so; one in "
    f"{MEAN_SECONDS_BETWEEN_FALSE_MARKS / 60:.0f} minutes is expected without a change. It is a model misfit where the "
    "motors' command explains the acceleration, and a disturbance where it does not."
)

PLOT_CONDITIONS = {
    "parameters": "after 8 s of settled flight",
    "wind": "after 8 s of flight with velocity over ground",
    "torque": "where it exceeds its error",
}
"""When plots of the first tab show something, which their titles say, so that an empty one explains itself."""

VALUES_AND_EVENTS_HEIGHTS = (58, 42)
"""Shares, %, of the height of the first tab that the current values and the events below them get; a choice."""

LIGHT_LEVELS = (Level.BAD, Level.WATCH, Level.GOOD, Level.UNKNOWN)
"""Levels of lights in the order in which the dashboard names the lights of each."""

FREE_ENERGY_HEIGHTS = (25, 35, 20, 20)
"""Shares, %, of the height that the plots of the tab "Free energy" get: the terms need most; a choice."""


class Channels(NamedTuple):
    """Names and units of the channels of a live flight."""

    title: str
    """Title of the recording: vehicle and link."""
    dt: float
    """Sampling step, s."""
    horizons: tuple[int, ...]
    """Horizons of the online learner's predictions, in steps."""
    input_names: Names
    """(r,) names of the motors."""
    output_names: Names
    """(m,) names of the outputs of the model: an angle, and its rate."""
    input_units: Names
    """(r,) units of the inputs."""
    output_units: Names
    """(m,) units of the outputs."""

    @property
    def shown_horizon(self) -> int:
        """Index of the horizon that is drawn: the one nearest to ``REPORTED_HORIZON``."""
        seconds = self.dt * np.array(self.horizons)
        return int(abs(seconds - REPORTED_HORIZON).argmin())


def live_blueprint(channels: Channels) -> rrb.Blueprint:
    """Returns the layout of a live flight in five tabs: the flight, the rest of its motion, 3D, free energy, status.

    The first tab has five plots over the last seconds, and next to them the current values and the events. The paths of
    the data are those to which ``LiveWriter`` and ``SinkThread`` write.

    Args:
        channels: names and units of what is shown.

    Returns:
        The layout, which opens with the first tab and follows the flight.
    """
    axis = channels.output_names[0]
    angle_unit = display_unit(channels.output_units[0]).name
    seconds = channels.dt * channels.horizons[channels.shown_horizon]
    input_unit = channels.input_units[0] if channels.input_units else ""
    titles = plot_titles(axis, angle_unit, f"its prediction {seconds:.2g} s ahead", input_unit)
    paths = first_tab_paths(axis)
    plots = {}
    for name, title in titles.items():
        condition = PLOT_CONDITIONS.get(name)
        full_title = title if condition is None else f"{title} · {condition}"
        plots[name] = live_plot(full_title, paths[name])
    values = rrb.TextDocumentView(origin="figures", name="Figures", titlebar=False)
    events = rrb.TextDocumentView(origin="events", name="Events", titlebar=False)
    flight = first_tab(plots, SideTexts([values, events], list(VALUES_AND_EVENTS_HEIGHTS)))

    status = rrb.TextDocumentView(origin="status", name="Status", titlebar=False)
    status_and_log = rrb.Horizontal(status, events_view(), name="Status")
    scene = rrb.Vertical(live_scene_view(), name="3D")
    tabs = rrb.Tabs(
        flight, _motion_tab(axis), scene, _free_energy_tab(), status_and_log, active_tab=0
    )
    return blueprint(tabs, play_state="following")


def _motion_tab(learned_axis: str) -> rrb.Vertical:
    """Returns the tab with the angles that the first tab does not show, and the body rates of all axes.

    Args:
        learned_axis: axis of the model, whose angle is in the first tab.
    """
    plots = []
    for axis in AXES:
        if axis != learned_axis:
            plots.append(live_plot(name_with_unit(axis.capitalize(), "°"), f"axes/{axis}"))
    plots.append(live_plot("Rates, °/s", "rates"))
    return rrb.Vertical(*plots, name="Motion")


def _free_energy_tab() -> rrb.Container:
    """Returns the layout of the tab with F(t), its terms, F̄ of each learning run, and the surprise."""
    model_note = f"model: {ModelName.DEM}"
    return rrb.Vertical(
        live_plot(free_energy_title(), "free_energy"),
        live_plot(f"Terms of F(t), nats · {model_note}", "free_energy_terms"),
        live_plot(f"F̄ of each learning run, nats · {model_note}", "free_energy_action"),
        live_plot(f"Surprise: how unusual a sample is · {model_note}", "surprise"),
        row_shares=list(FREE_ENERGY_HEIGHTS),
        name="Free energy",
    )


def first_tab_paths(axis: str) -> dict[str, str]:
    """Returns where in the Rerun recording the data of each plot of the first tab are.

    Rerun stores each line under a path, like a file in a folder ("air/1_speed"). A plot shows all lines under its path,
    and draws them in the order of their names: those with lower numbers lie below the others.

    Args:
        axis: the axis that a model is learned of, "roll" or "pitch".

    Returns:
        Path of the lines by name of the plot. The names are the keys of ``PLOT_HEIGHTS``.
    """
    return {
        "angle": f"axes/{axis}",
        "motors": "motors",
        "parameters": "parameters",
        # Two paths differ from the names of the plots: the velocity of the wind, m/s, is under "air", and the torque
        # that the wind exerts on the vehicle is under "wind".
        "wind": "air",
        "torque": "wind",
    }


def live_plot(title: str, origin: str) -> rrb.View:
    """Returns a plot of the last ``FLIGHT_SECONDS`` before the time cursor, and of the predictions after it.

    The viewer loads only the samples of this range, which keeps it fast during a long flight. The axis of time begins
    with them and ends later, to leave room for the legend: it is ``WIDTH_PER_SPAN`` times as long as the range.

    Args:
        title: title of the plot.
        origin: path of the entity whose lines the plot shows.

    Returns:
        The view for Rerun's layout.
    """
    first_sample = rr.TimeRangeBoundary.cursor_relative(seconds=-FLIGHT_SECONDS)
    last_sample = rr.TimeRangeBoundary.cursor_relative(seconds=REPORTED_HORIZON)
    axis_seconds = WIDTH_PER_SPAN * (FLIGHT_SECONDS + REPORTED_HORIZON)
    axis_end = rr.TimeRangeBoundary.cursor_relative(seconds=-FLIGHT_SECONDS + axis_seconds)
    axis = rrb.archetypes.TimeAxis(view_range=rr.TimeRange(start=first_sample, end=axis_end))
    visible_range = rrb.VisibleTimeRange(BOOT_CLOCK, start=first_sample, end=last_sample)
    return rrb.TimeSeriesView(
        name=title, origin=origin, axis_x=axis, time_ranges=[visible_range], plot_legend=LEGEND
    )


def current_value_texts(
    status: SessionStatus, row: DisplayRow, channels: Channels, training_end_time: float | None
) -> Names:
    """Returns the texts with the current values of a live flight, which are shown next to the plots of the first tab.

    Args:
        status: state of the session.
        row: the latest row, with the estimates at its time.
        channels: names and units of the row's channels.
        training_end_time: time of the last sample that the latest model was trained on, s of the boot clock; None
            before the first model.

    Returns:
        Markdown, one text a card, by the template "live_cards": headline, next step and state, with the level of each
        light, which judges one part of the vehicle such as its motors; then prediction, wind, wind torque, physical
        parameters and free energy; and what is watched.
    """
    model_judgement = status.model_judgement
    judgement = status.session_judgement
    estimate = row.estimate
    physical = None if estimate is None else estimate.physical
    # A wind torque that is smaller than its error is left out.
    is_resolved = False
    if estimate is not None and physical is not None:
        is_resolved = is_torque_resolved(physical, estimate.wind_torque_band)
    cards = render_section(
        "live_cards",
        status=status,
        headline_lines=headline_and_next_step(judgement),
        unrepaired_fault=unrepaired_fault_beside_next_step(status),
        lights=judgement.lights,
        levels=LIGHT_LEVELS,
        watched=watched_quantities_text(status.watch_facts),
        row=row,
        channels=channels,
        training_end_time=training_end_time,
        reason=_no_model_text(status, training_end_time),
        is_bad=model_judgement is not None and model_judgement.headline.is_bad,
        now=estimate,
        physical=physical,
        is_torque_resolved=is_resolved,
        level=CONFIDENCE_LEVEL,
        unit=TORQUE_UNIT,
        per_input=unit_per_input(TORQUE_UNIT, channels.input_units[0]),
    )
    return tuple(card.text for card in cards)


def _no_model_text(status: SessionStatus, training_end_time: float | None) -> str:
    """Returns why there is no model of the vehicle, or why no newer one is learned, for the texts beside the plots.

    Args:
        status: state of the session. Its ``no_model_reason`` is the reason why nothing is learned now, if there is one.
        training_end_time: time of the last sample that the latest model was trained on, s; None before the first model.

    Returns:
        The reason with what to do about it; empty while learning proceeds.
    """
    if status.no_model_reason is not None:
        return status.no_model_reason.sentence_and_remedy
    if training_end_time is None:
        return TOO_FEW_SAMPLES.sentence_and_remedy
    return ""


def status_document(
    status: SessionStatus, row: DisplayRow, channels: Channels, training_end_time: float | None
) -> str:
    """Returns the text of the tab "Status": the session, the judgement of the flight so far, and a legend.

    Args:
        status: state of the session.
        row: the latest row, with the estimates at its time.
        channels: names and units of the row's channels.
        training_end_time: time of the last sample that the latest model was trained on, s of the boot clock; None
            before the first model.

    Returns:
        Markdown: by the template "live_details" a title and the session; between them what the model is good for, once
        it is judged.
    """
    title, *details = render_section(
        "live_details",
        status=status,
        row=row,
        channels=channels,
        training_end_time=training_end_time,
        reason=_no_model_text(status, training_end_time),
    )
    paragraphs = [title.text]
    if status.findings is not None:
        blocks = assessment_blocks(status.findings, status.overall_judgement)
        paragraphs.append(markdown(blocks))
    paragraphs += [detail.text for detail in details]
    paragraphs.append(STATUS_LEGEND)
    return "\n\n".join(paragraphs)
