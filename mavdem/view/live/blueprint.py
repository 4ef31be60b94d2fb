"""Blueprint: how a live flight is laid out, scrolling with it."""

from __future__ import annotations

from collections.abc import Callable

import rerun as rr
import rerun.blueprint as rrb

from mavdem.naming import named, per_second, readable
from mavdem.view.live.bundle import BOOT_CLOCK
from mavdem.view.live.content import ahead_of, pushed
from mavdem.view.live.row import Channels

RECENT = 20.0
"""Seconds of flight in sight."""
SETTLING = 60.0
"""Seconds of learning in sight."""
BESIDE_LEGEND = 0.4
"""Left free to the right, in parts of what is in sight, for the legend to cover no line."""


class FollowingTimePanel(rrb.TimePanel):
    """A time panel that shows the latest; the SDK's own takes a play state but leaves it out of what it sends."""

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        super()._log_to_stream(stream)
        following = rrb.archetypes.TimePanelBlueprint.from_fields(play_state=rrb.components.PlayState.Following)
        stream.log(self.blueprint_path(), following)


def live_blueprint(channels: Channels, root: str = "") -> rrb.Blueprint:
    """Words and noise, the flight, and what is made of it, in columns from left to right; lines are below ``root``."""

    def plot(name: str, origin: str, seconds: float) -> rrb.TimeSeriesView:
        return _plot(name, f"{root}/{origin.lstrip('/')}", seconds)

    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.TextDocumentView(origin="status", name="Status"),
                _log(),
                plot("λ: log precisions of noise, those that are learnt", "noise_precisions", SETTLING),
                plot("Free energy action F̄ of the learner's memory, nats", "free_energy_action", SETTLING),
                row_shares=[31, 27, 21, 21],
            ),
            rrb.Vertical(*_flight(channels, plot), row_shares=[*[30] * len(channels.output_names), 20, 20]),
            rrb.Vertical(
                plot("Surprise: how unusual a sample is", "surprise", RECENT),
                plot("Free energy F(t), nats: low where a sample surprises", "free_energy_of_samples", RECENT),
                plot("A: motion from motion, learnt entries", "parameters/A", SETTLING),
                plot("B: motion from motors, learnt entries", "parameters/B", SETTLING),
                row_shares=[20, 20, 24, 36],
            ),
            column_shares=[26, 41, 33],
        ),
        FollowingTimePanel(state="collapsed", timeline=BOOT_CLOCK),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _log() -> rrb.TextLogView:
    columns = rrb.archetypes.TextLogColumns(timeline_columns=[BOOT_CLOCK], text_log_columns=["LogLevel", "Body"])
    return rrb.TextLogView(origin="log", name="Log", columns=columns)


def _flight(channels: Channels, plot: Callable[[str, str, float], rrb.TimeSeriesView]) -> list[rrb.View]:
    """One above the other over the same seconds."""
    far = ahead_of(channels)
    outputs = [
        plot(
            f"{named(name.capitalize(), readable(unit).name)}: measured, expected, and predicted {far} ahead",
            rr.new_entity_path(["outputs", name]),
            RECENT,
        )
        for name, unit in zip(channels.output_names, channels.output_units, strict=True)
    ]
    units = {per_second(channels.output_units[i]) for i in pushed(channels)}
    wind = named("Disturbance: wind and all else the model leaves out", _common(units))
    motors = named("Motors", _common(set(channels.input_units)))
    return [*outputs, plot(wind, "disturbance", RECENT), plot(motors, "inputs", RECENT)]


def _plot(name: str, origin: str, seconds: float) -> rrb.TimeSeriesView:
    """Over the last seconds before the time cursor; only they are looked up, however long the flight."""
    start, end = (
        rr.TimeRangeBoundary.cursor_relative(seconds=-seconds),
        rr.TimeRangeBoundary.cursor_relative(seconds=BESIDE_LEGEND * seconds),
    )
    return rrb.TimeSeriesView(
        name=name,
        origin=origin,
        axis_x=rrb.archetypes.TimeAxis(view_range=rr.TimeRange(start=start, end=end)),
        time_ranges=[rrb.VisibleTimeRange(BOOT_CLOCK, start=start, end=end)],
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
    )


def _common(units: set[str]) -> str:
    return next(iter(units)) if len(units) == 1 else ""
