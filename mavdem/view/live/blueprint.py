"""Blueprint: the layout of the live view, which scrolls with the flight, and the words that stand in it."""

from __future__ import annotations

from math import isfinite

import rerun as rr
import rerun.blueprint as rrb

from mavdem.confidence import LEVEL
from mavdem.dem.online.learner import TOO_FEW
from mavdem.dem.online.tracker import FALSE_MARK_SECONDS
from mavdem.live import SessionStatus
from mavdem.live.history import sentence
from mavdem.report.numbers import named, plus_minus, readable, with_unit
from mavdem.view.live.content import Channels, ViewRow
from mavdem.view.plots import BOOT_CLOCK, blueprint

FLIGHT_SECONDS, LEARNING_SECONDS = 20.0, 120.0  # in view
UNKNOWN = "–"
LEGEND = (
    "An error ratio is beside the better of the last sample and the mean. Surprise is how far F(t) is below its recent "
    "median: 1 is the worst of twenty samples. A mark is where it stays above what is usual in this flight; one in "
    f"{FALSE_MARK_SECONDS / 60:.0f} minutes is expected without a change."
)


class FollowingTimePanel(rrb.TimePanel):
    """A time panel that follows the latest data; the SDK's own does not send its play state."""

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        super()._log_to_stream(stream)
        following = rrb.archetypes.TimePanelBlueprint.from_fields(play_state=rrb.components.PlayState.Following)
        stream.log(self.blueprint_path(), following)


def live_blueprint(channels: Channels) -> rrb.Blueprint:
    """Returns tabs: the flight, the model, more of the samples, the status."""

    def plot(name: str, origin: str, seconds: float = FLIGHT_SECONDS) -> rrb.TimeSeriesView:
        """A plot of the last seconds before the time cursor; only these are queried."""
        right = 0.22 if seconds == FLIGHT_SECONDS else 0.35  # left free for the legend
        start, end = (rr.TimeRangeBoundary.cursor_relative(seconds=at * seconds) for at in (-1, right))
        return rrb.TimeSeriesView(
            name=name,
            origin=origin,
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
            *(rrb.TextDocumentView(origin=f"figures/{i}", name=f"Figure {i}", titlebar=False) for i in range(4))
        ),
        rrb.Horizontal(
            rrb.Vertical(
                outputs[0],
                plot(f"Wind torque, {readable('rad/s²').name}", "wind"),
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
        grid_columns=1,
        name="Model",
    )
    details = rrb.Vertical(
        *outputs[1:],
        plot("Surprise: how unusual a sample is", "surprise"),
        plot("F(t), nats: low at an unusual sample", "free_energy_of_samples"),
        name="Details",
    )
    status = rrb.TextDocumentView(origin="status", name="Status")
    following = FollowingTimePanel(state="collapsed", timeline=BOOT_CLOCK)
    return blueprint(rrb.Tabs(flight, model, details, status, active_tab=0), following)


def figures(channels: Channels, status: SessionStatus, row: ViewRow, until: float | None) -> tuple[str, ...]:
    """Returns four Markdown documents: the state, the prediction, the wind torque, and the physical parameters.

    ``row`` is the latest one that was trained on, or the latest; the model was learned ``until`` s of the boot clock.
    """
    output, now, unit = channels.output_names[0], row.estimate, readable("rad/s²")
    state = "alarm" if status.alarm else "waiting" if status.obstacle or until is None else "learning"
    said = status.alarm or _reason(status, until)
    shown = {"State": (f"{state}, {status.learned * channels.dt:.0f} s learned", said)}
    error = torque = effect = (UNKNOWN, "")
    (seconds, half), (ahead, ratio) = status.ahead, status.useful
    if isfinite(half):
        useful = f"; error ratio {ratio:.2f} at {ahead:.2g} s" if isfinite(ratio) else ""
        error = f"± {with_unit(half, readable(channels.output_units[0]))}", f"{seconds:.2g} s ahead (90 %){useful}"
    if now is not None and isfinite(now.wind_torque):
        sizes = unit.scale * now.wind_torque, unit.scale * now.wind_torque_band
        torque = f"{plus_minus(*sizes)} {unit.name}", "now, steady part included (90 %)"
    if now is not None and now.physical is not None:
        physical, names = now.physical, (f"{unit.name} per {channels.input_units[0] or 'unit'}", "1/s")
        mean = [unit.scale * value for value in physical.mean_effect(LEVEL)]
        pairs = zip((mean, (physical.damping, physical.interval(LEVEL).damping)), names, strict=True)
        words = [f"{plus_minus(*pair)} {name}" if isfinite(pair[1]) else "not identifiable" for pair, name in pairs]
        effect = words[0], f"rate damping {words[1]}"
    shown |= {f"Error of the predicted {output}": error, "Wind torque": torque, "Control effectiveness": effect}
    return tuple(f"{name}\n### {value}\n{remark}" for name, (value, remark) in shown.items())


def _reason(status: SessionStatus, until: float | None) -> str:
    return sentence(status.obstacle or (TOO_FEW if until is None else "")) or "The model follows the flight."


def status_document(channels: Channels, status: SessionStatus, row: ViewRow, until: float | None) -> str:
    """Returns the latest status and row as a Markdown document.

    The latest model was learned ``until`` s of the boot clock; None before the first.
    """
    reboot = f" since a reboot; shown as {row.time:,.1f} s" if row.shift else ""
    facts = {
        "samples": f"{status.learned + status.shown:,} at {1 / channels.dt:.4g} Hz",
        "boot clock": f"{row.time - row.shift:,.1f} s{reboot}",
        **{name: f"{rate:.1f} Hz" for name, rate in status.rates.items()},
        "frames lost": f"{status.lost:,}",
    }
    if isfinite(status.latency[0]):
        facts["latency"] = f"{1000 * status.latency[0]:.0f} ms"
    if until is None:
        learning = f"No model yet. {_reason(status, until)}"
    elif row.estimate is None:
        learning = f"The latest model is kept; the samples now are not settled flight. {sentence(status.obstacle)}"
    else:
        ago = max(0.0, row.estimate.time - until)
        learning = f"The model was learned up to {ago:.1f} s ago. {sentence(status.obstacle)}"
    cautions = [f"**Cautions:** {' '.join(row.learned.cautions)}"] if row.learned and row.learned.cautions else []
    table = "\n".join(f"- {name}: {fact}" for name, fact in facts.items())
    return "\n\n".join([f"**{channels.title}**", learning.strip(), table, *cautions, LEGEND])
