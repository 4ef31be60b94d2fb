"""The layout of the live view, which scrolls with the flight."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from mavdem.report.numbers import named, readable
from mavdem.view.live.line_group import BOOT_CLOCK
from mavdem.view.live.rows import Channels

FLIGHT_SECONDS, LEARNING_SECONDS = 20.0, 120.0  # in view
LEGEND_SHARE, WIDE_LEGEND_SHARE = 0.22, 0.35  # of the time in view, left free on the right for the legend
FIGURES = 4  # Markdown documents above the plots


class FollowingTimePanel(rrb.TimePanel):
    """A time panel that follows the latest data; the SDK's own does not send its play state."""

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        super()._log_to_stream(stream)
        following = rrb.archetypes.TimePanelBlueprint.from_fields(play_state=rrb.components.PlayState.Following)
        stream.log(self.blueprint_path(), following)


def live_blueprint(channels: Channels, root: str = "") -> rrb.Blueprint:
    """Tabs: the flight under its figures, the model, more of the samples, the status; lines are below ``root``."""

    def plot(name: str, origin: str, seconds: float = FLIGHT_SECONDS) -> rrb.TimeSeriesView:
        """A plot of the last seconds before the time cursor; only these are queried."""
        share = LEGEND_SHARE if seconds == FLIGHT_SECONDS else WIDE_LEGEND_SHARE
        start = rr.TimeRangeBoundary.cursor_relative(seconds=-seconds)
        end = rr.TimeRangeBoundary.cursor_relative(seconds=share * seconds)
        return rrb.TimeSeriesView(
            name=name,
            origin=f"{root}/{origin.lstrip('/')}",
            axis_x=rrb.archetypes.TimeAxis(view_range=rr.TimeRange(start=start, end=end)),
            time_ranges=[rrb.VisibleTimeRange(BOOT_CLOCK, start=start, end=end)],
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
        )

    outputs = [
        plot(
            f"{named(name.capitalize(), readable(unit).name)}: measured, and predicted without the motors ahead",
            rr.new_entity_path(["outputs", name]),
        )
        for name, unit in zip(channels.output_names, channels.output_units, strict=True)
    ]
    command = f"{channels.output_names[0].capitalize()} command" if channels.command else "Motors"
    log_columns = rrb.archetypes.TextLogColumns(timeline_columns=[BOOT_CLOCK], text_log_columns=["LogLevel", "Body"])
    flight = rrb.Vertical(
        rrb.Horizontal(
            *(rrb.TextDocumentView(origin=f"figures/{i}", name=f"Figure {i}", titlebar=False) for i in range(FIGURES))
        ),
        rrb.Horizontal(
            rrb.Vertical(
                outputs[0],
                plot(f"Disturbance torque (wind), {readable('rad/s²').name}", "wind"),
                plot(named(command, next(iter(channels.input_units), "")), "command"),
                row_shares=[42, 32, 26],
            ),
            rrb.TextLogView(origin="log", name="Events", columns=log_columns),
            column_shares=[70, 30],
        ),
        row_shares=[13, 87],
        name="Flight",
    )
    model = rrb.Grid(
        plot("λ: log precisions of the noise", "noise_precisions", LEARNING_SECONDS),
        plot("F̄ of the learner's memory, nats", "free_energy_action", LEARNING_SECONDS),
        plot("A: motion from motion, 1/s and 1/s²", "parameters/A", LEARNING_SECONDS),
        plot("B: motion from motors, degrees and s", "parameters/B", LEARNING_SECONDS),
        grid_columns=2,
        name="Model",
    )
    details = rrb.Vertical(
        *outputs[1:],
        plot("Surprise: how unusual a sample is", "surprise"),
        plot("F(t), nats: low at an unusual sample", "free_energy_of_samples"),
        name="Details",
    )
    return rrb.Blueprint(
        rrb.Tabs(flight, model, details, rrb.TextDocumentView(origin="status", name="Status"), active_tab=0),
        FollowingTimePanel(state="collapsed", timeline=BOOT_CLOCK),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )
