"""The layout of the live view, which scrolls with the flight."""

from __future__ import annotations

from collections.abc import Callable

import rerun as rr
import rerun.blueprint as rrb

from mavdem.report.names import named, per_second, readable
from mavdem.view.live.content import disturbed
from mavdem.view.live.line_group import BOOT_CLOCK
from mavdem.view.live.rows import Channels

FLIGHT_SECONDS = 20.0  # of the flight in view
LEARNING_SECONDS = 60.0  # of the learning in view
LEGEND_SHARE = 0.4  # of the time in view, left free on the right for the legend


class FollowingTimePanel(rrb.TimePanel):
    """A time panel that follows the latest data; the SDK's own does not send its play state."""

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        super()._log_to_stream(stream)
        following = rrb.archetypes.TimePanelBlueprint.from_fields(play_state=rrb.components.PlayState.Following)
        stream.log(self.blueprint_path(), following)


def live_blueprint(channels: Channels, root: str = "") -> rrb.Blueprint:
    """Three columns: text and noise, the flight, the estimates; the lines are below the entity ``root``."""

    def plot(name: str, origin: str, seconds: float) -> rrb.TimeSeriesView:
        """A plot of the last seconds before the time cursor; only these are queried."""
        start = rr.TimeRangeBoundary.cursor_relative(seconds=-seconds)
        end = rr.TimeRangeBoundary.cursor_relative(seconds=LEGEND_SHARE * seconds)
        return rrb.TimeSeriesView(
            name=name,
            origin=f"{root}/{origin.lstrip('/')}",
            axis_x=rrb.archetypes.TimeAxis(view_range=rr.TimeRange(start=start, end=end)),
            time_ranges=[rrb.VisibleTimeRange(BOOT_CLOCK, start=start, end=end)],
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
        )

    log_columns = rrb.archetypes.TextLogColumns(timeline_columns=[BOOT_CLOCK], text_log_columns=["LogLevel", "Body"])

    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.TextDocumentView(origin="status", name="Status"),
                rrb.TextLogView(origin="log", name="Log", columns=log_columns),
                plot("λ: learned log precisions of the noise", "noise_precisions", LEARNING_SECONDS),
                plot("Free energy action F̄ of the learner's memory, nats", "free_energy_action", LEARNING_SECONDS),
                row_shares=[31, 27, 21, 21],
            ),
            rrb.Vertical(*_flight(channels, plot), row_shares=[*[30] * len(channels.output_names), 20, 20]),
            rrb.Vertical(
                plot("Surprise: how unusual a sample is", "surprise", FLIGHT_SECONDS),
                plot("Free energy F(t), nats: low at an unusual sample", "free_energy_of_samples", FLIGHT_SECONDS),
                plot("A: motion from motion, learned entries", "parameters/A", LEARNING_SECONDS),
                plot("B: motion from motors, learned entries", "parameters/B", LEARNING_SECONDS),
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


def _flight(channels: Channels, plot: Callable[[str, str, float], rrb.TimeSeriesView]) -> list[rrb.View]:
    """The plots of the flight, one above the other."""
    outputs = [
        plot(
            f"{named(name.capitalize(), readable(unit).name)}: measured, expected, and predicted ahead",
            rr.new_entity_path(["outputs", name]),
            FLIGHT_SECONDS,
        )
        for name, unit in zip(channels.output_names, channels.output_units, strict=True)
    ]
    units = {per_second(channels.output_units[i]) for i in disturbed(channels)}
    wind = named("Disturbance: wind and everything else outside the model", _common(units))
    motors = named("Motors", _common(set(channels.input_units)))
    return [*outputs, plot(wind, "disturbance", FLIGHT_SECONDS), plot(motors, "inputs", FLIGHT_SECONDS)]


def _common(units: set[str]) -> str:
    return next(iter(units)) if len(units) == 1 else ""
