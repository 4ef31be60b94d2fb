"""What a live view is given, how it becomes the entities of a recording, and the layout and words that show them."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from mavdem.alignment.align import MAX_GAP_SECONDS
from mavdem.alignment.drive import AXES
from mavdem.confidence import LEVEL
from mavdem.dem import Estimate, Learned
from mavdem.dem.engine.linalg import Array
from mavdem.dem.online.learner import TOO_FEW
from mavdem.dem.online.tracker import FALSE_MARK_SECONDS
from mavdem.facts import Level
from mavdem.live import SessionStatus
from mavdem.live.history import AHEAD
from mavdem.live.stream import Pose
from mavdem.live.wind import WindRow
from mavdem.report.blocks import markdown
from mavdem.report.live import watching
from mavdem.report.numbers import TORQUE, named, per, place, readable
from mavdem.report.palette import (
    BAD,
    BAND_OPACITY,
    BOUND,
    DISTINCT,
    DISTURBANCE,
    MEASURED,
    PREDICTED,
    TRUTH,
)
from mavdem.report.screen import verdict_blocks
from mavdem.report.words import advised, section
from mavdem.view.plots import BOOT_CLOCK, Lines, blueprint, events_view, faint

# in view
FLIGHT_SECONDS = 20.0
MAX_TORQUES = 8192  # of 20 s at 400 Hz: motors that weaken are found within 5 s
LEGEND = (
    "Error ratios: beside the better of the last sample and the mean. Surprise is how far F(t) is below its recent "
    "median: 1 is the worst of twenty samples. Unexpected motion is an event; one in "
    f"{FALSE_MARK_SECONDS / 60:.0f} minutes is expected without a change."
)
BEYOND = 0.3  # how far predictions and bands are drawn beyond what was measured, in spans of it


class Channels(NamedTuple):
    """The channels of a live flight; their names and units as of a ``Flight``."""

    title: str  # of the recording: vehicle and link
    dt: float  # sampling step, s
    horizons: tuple[int, ...]  # the learner's, in steps
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    input_units: tuple[str, ...]
    output_units: tuple[str, ...]


class ViewRow(NamedTuple):
    """A sample and its estimate."""

    time: float  # on the timeline, s
    shift: float  # timeline minus boot clock, s
    segment: int  # changes where samples are missing or the vehicle rebooted
    outputs: Array  # (m,)
    inputs: Array  # (r,)
    estimate: Estimate | None  # of this sample; ``None`` without a learner
    learned: Learned | None  # the learner's last batch result
    channels: Channels  # of outputs and inputs
    wind: WindRow | None = None  # the latest, in m/s
    pose: Pose | None = None


class LiveWriter:
    """Writes rows of one set of channels into one recording, to which it sends their layout."""

    def __init__(self, channels: Channels, recording: rr.RecordingStream) -> None:
        recording.send_recording_name(channels.title)
        recording.send_blueprint(live_blueprint(channels))
        self.channels = channels
        self._recording = recording
        self._segment: int | None = None
        # by plot, the least and most that were measured
        self._seen: dict[str, tuple[float, float]] = {}
        self._aired = self._posed = -np.inf
        # the latest times, s, and torques: an alarm of a motor is about the last seconds
        self._torques = deque[tuple[float, float]](maxlen=MAX_TORQUES)
        self._styled: set[Lines] = set()

    def rows(self, rows: list[ViewRow]) -> None:
        """Draws rows in the order of their times, and what happens in them."""
        time = np.array([row.time for row in rows])
        inputs = np.array([row.inputs for row in rows])
        segments = [self._segment, *(row.segment for row in rows)]
        self._segment = rows[-1].segment
        breaks = np.array(
            [i for i in range(len(rows)) if segments[i] not in (None, segments[i + 1])], np.intp
        )
        self._angle(rows, time, breaks)
        names = tuple(map(place, self.channels.input_names))
        self._in_sight("motors", inputs, inputs)
        self._draw(Lines("motors", names, DISTINCT[: len(names)]), time, inputs, breaks)
        self._poses(rows)
        estimates = [(row.estimate, row.shift) for row in rows if row.estimate is not None]
        self._judgement([pair for pair in estimates if np.isfinite(pair[0].seen)])
        self._wind(estimates)
        self._air(rows)

    def _poses(self, rows: list[ViewRow]) -> None:
        """Draws the angles with what was asked for, and the rates, each attitude once."""
        new = {row.pose.time + row.shift: row.pose for row in rows if row.pose is not None}
        poses = {time: pose for time, pose in new.items() if time > self._posed}
        if not poses:
            return
        time = np.array([*poses])
        apart = np.diff([self._posed, *time]) > MAX_GAP_SECONDS
        breaks = np.flatnonzero(apart & np.isfinite(self._posed))
        self._posed = float(time[-1])
        angles, rates, asked = (
            np.degrees([pose[part] for pose in poses.values()]) for part in (1, 2, 3)
        )
        for number, axis in enumerate(AXES):
            values = angles[:, number, None]
            if axis != "yaw" and np.isfinite(asked[:, number]).any():
                wanted = asked[:, number, None]
                self._draw(
                    Lines(f"axes/{axis}/0_asked", ("setpoint",), (TRUTH,)), time, wanted, breaks
                )
            if axis not in self.channels.output_names:
                self._in_sight(f"axes/{axis}", values, values)
                self._draw(
                    Lines(f"axes/{axis}/1_measured", (axis,), (MEASURED,)), time, values, breaks
                )
        self._in_sight("rates", rates, rates)
        self._draw(Lines("rates", AXES, DISTINCT[: len(AXES)]), time, rates, breaks)

    def mark(self, since: float, is_motor: bool) -> None:
        """Marks an alarm at the time ``since`` in every plot; NaN is none. A motor's torque is no wind from then on."""
        if is_motor:
            time, torque = (
                np.array([row for row in self._torques if row[0] >= since]).reshape(-1, 2).T
            )
            self._draw(Lines("wind/2_motor", ("of a motor",), (BAD,), 3.0), time, torque[:, None])
        if np.isfinite(since):
            for plot, (low, high) in self._seen.items():
                line = Lines(f"{plot}/9_alarms", ("alarm",), (BAD,), filled=True)
                ends = np.array([[np.nan, np.nan], [low, high]])
                self._draw(line, np.array([since - 1e-3, since]), ends)

    def _draw(self, lines: Lines, time: Array, values: Array, breaks: Any = ()) -> None:
        """Draws lines that break before the rows ``breaks``, where samples are missing."""
        if lines not in self._styled:
            self._styled.add(lines)
            lines.send_style(self._recording)
        if len(breaks):
            values = np.insert(values, breaks, np.nan, axis=0)
            time = np.insert(time, breaks, time[breaks] - self.channels.dt / 2)
        lines.send(self._recording, time, values)

    def _angle(self, rows: list[ViewRow], time: Array, breaks: Any) -> None:
        """Draws the angle with its prediction, of those nearest to ``AHEAD`` seconds ahead."""
        seconds = np.array(self.channels.horizons) * self.channels.dt
        h = int(np.abs(seconds - AHEAD).argmin())
        known = [
            (row.time + seconds[h], np.nan, np.nan)
            if (now := row.estimate) is None
            else (now.ahead_times[h] + row.shift, now.ahead[h, 0], now.ahead_band[h, 0])
            for row in rows
        ]
        later, ahead, half = np.array(known).T
        scale = readable(self.channels.output_units[0]).scale
        plot = f"axes/{self.channels.output_names[0]}"
        drawn = scale * np.array([row.outputs[:1] for row in rows])
        curves = scale * np.stack([ahead - half, ahead + half, ahead], axis=-1)
        then = self._in_sight(plot, drawn, curves)
        shade = (faint(PREDICTED, BAND_OPACITY),)
        band = Lines(f"{plot}/0_band", ("90 % band",), shade, filled=True)
        line = Lines(f"{plot}/1_measured", ("measured",), (MEASURED,), 1.2)
        name = f"{seconds[h]:.2g} s ahead"
        predicted = Lines(f"{plot}/2_predicted", (name,), (PREDICTED,), 1.8)
        self._draw(band, later, then[:, :2], breaks)
        self._draw(line, time, drawn, breaks)
        self._draw(predicted, later, then[:, 2:], breaks)

    def _in_sight(self, plot: str, measured: Array, values: Array) -> Array:
        """Values cut off beyond what was measured so far, or they would decide about the range of the axis."""
        finite = np.append(measured[np.isfinite(measured)], self._seen.get(plot, ()))
        if not len(finite):
            return values
        self._seen[plot] = low, high = float(finite.min()), float(finite.max())
        beyond = BEYOND * (high - low)
        return np.clip(values, low - beyond, high + beyond) if high > low else values

    def _wind(self, estimates: Sequence[tuple[Estimate, float]]) -> None:
        """Draws the wind torque with its band at the times it is of; NaN where it is not known."""
        scale = TORQUE.scale
        torques = []
        for now, shift in estimates:
            if np.isfinite(now.wind_time):
                torques.append((now.wind_time + shift, now.wind_torque, now.wind_torque_band))
        if torques:
            time, torque, half = np.array(torques).T
            self._torques += zip(time, scale * torque, strict=True)
            edges = np.stack([torque - half, torque + half], axis=-1)
            band = Lines(
                "wind/0_band", ("90 % band",), (faint(DISTURBANCE, BAND_OPACITY),), filled=True
            )
            self._in_sight("wind", scale * edges, edges)
            self._draw(band, time, scale * edges)
            self._draw(
                Lines("wind/1_torque", ("torque",), (DISTURBANCE,)), time, scale * torque[:, None]
            )

    def _air(self, rows: Sequence[ViewRow]) -> None:
        """Draws the speed of the wind in m/s with its interval, each row once."""
        new = {
            row.wind.time + row.shift: row.wind.by_compass[:3]
            for row in rows
            if row.wind is not None
        }
        new = {time: speeds for time, speeds in new.items() if time > self._aired}
        if new:
            self._aired, speeds = max(new), np.array([*new.values()])
            lines = Lines(
                "air/speed",
                ("wind", "90 % from", "to"),
                (DISTURBANCE, *2 * (faint(DISTURBANCE, 0.5),)),
            )
            self._in_sight("air", speeds, speeds)
            self._draw(lines, np.array([*new]), speeds)

    def _judgement(self, estimates: Sequence[tuple[Estimate, float]]) -> None:
        """Draws F(t) and surprise at the centres of their windows."""
        if not estimates:
            return
        rows = [(now.seen + shift, now.free_energy, now.surprise) for now, shift in estimates]
        time, energy, surprise = np.array(rows, np.float64).T
        self._in_sight("surprise", surprise, surprise)
        samples = Lines("surprise/samples", ("worst of 20", "surprise"), (BOUND, PREDICTED))
        self._draw(Lines("free_energy_of_samples", ("F(t)",), (MEASURED,)), time, energy[:, None])
        self._draw(samples, time, np.stack([np.ones(len(time)), surprise], axis=-1))


def live_blueprint(channels: Channels) -> rrb.Blueprint:
    """Returns tabs: the flight on one axis of time, more of the samples, the status."""

    def plot(name: str, origin: str) -> rrb.TimeSeriesView:
        """A plot of the last seconds before the time cursor; only these are queried."""
        start = rr.TimeRangeBoundary.cursor_relative(seconds=-FLIGHT_SECONDS)
        end = rr.TimeRangeBoundary.cursor_relative(seconds=AHEAD)
        axis = rrb.archetypes.TimeAxis(view_range=rr.TimeRange(start=start, end=end))
        shown = rrb.VisibleTimeRange(BOOT_CLOCK, start=start, end=end)
        return rrb.TimeSeriesView(
            name=name,
            origin=origin,
            axis_x=axis,
            time_ranges=[shown],
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop),
        )

    axes = [plot(named(axis.capitalize(), "°"), f"axes/{axis}") for axis in AXES]
    motors = named("Motors", next(iter(channels.input_units), ""))
    pictures = rrb.Vertical(
        *axes,
        plot("Rates, °/s", "rates"),
        plot(motors, "motors"),
        plot("Wind, m/s", "air"),
        plot(f"Wind torque on {channels.output_names[0]}, {TORQUE.name}", "wind"),
    )
    *cards, watched = (
        rrb.TextDocumentView(origin=f"figures/{i}", name=f"Figure {i}", titlebar=False)
        for i in range(6)
    )
    words = rrb.Vertical(watched, events_view(), row_shares=[20, 80])
    beside = rrb.Horizontal(pictures, words, column_shares=[70, 30])
    flight = rrb.Vertical(rrb.Horizontal(*cards), beside, row_shares=[15, 85], name="Flight")
    surprise = plot("Surprise: how unusual a sample is", "surprise")
    samples = plot("F(t), nats: low at an unusual sample", "free_energy_of_samples")
    details = rrb.Vertical(surprise, samples, name="Details")
    status = rrb.TextDocumentView(origin="status", name="Status")
    return blueprint(rrb.Tabs(flight, details, status, active_tab=0), play_state="following")


def figures(status: SessionStatus, row: ViewRow, until: float | None) -> tuple[str, ...]:
    """Returns Markdown documents: state, prediction, wind, its torque, physical parameters, and what is watched.

    ``row`` is the latest; the model was learned ``until`` s of the boot clock.
    """
    judged = status.judgement
    now = row.estimate
    cards = section(
        "live_cards",
        status=status,
        watched=watching(status),
        row=row,
        channels=row.channels,
        until=until,
        reason=_reason(status, until),
        is_bad=judged is not None and judged.headline.level is Level.BAD,
        now=now,
        physical=None if now is None else now.physical,
        level=LEVEL,
        unit=TORQUE,
        per_input=per(TORQUE, row.channels.input_units[0]),
    )
    return tuple(card.text for card in cards)


def _reason(status: SessionStatus, until: float | None) -> str:
    """Why there is no model, or no newer one."""
    if status.obstacle is not None:
        return advised(status.obstacle)
    return advised(TOO_FEW) if until is None else ""


def status_document(status: SessionStatus, row: ViewRow, until: float | None) -> str:
    """Returns the latest status and row as Markdown; the model was learned ``until`` s, None before the first."""
    title, *details = section(
        "live_details",
        status=status,
        row=row,
        channels=row.channels,
        until=until,
        reason=_reason(status, until),
    )
    found = []
    if status.findings is not None:
        found = [markdown(verdict_blocks(status.findings, status.judgement))]
    return "\n\n".join([title.text, *found, *(one.text for one in details), LEGEND])
