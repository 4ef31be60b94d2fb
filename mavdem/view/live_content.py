"""What a live view is given, how it becomes the entities of a recording, and the layout and words that show them."""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from mavdem.arrays import Array
from mavdem.confidence import CONFIDENCE_LEVEL, Interval
from mavdem.containers import Names
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.dem import Estimate
from mavdem.dem.online.anomaly_marks import MEAN_SECONDS_BETWEEN_FALSE_MARKS
from mavdem.dem.online.learner import TOO_FEW_SAMPLES
from mavdem.live import SessionStatus
from mavdem.live.display import DisplayRow
from mavdem.live.history import REPORTED_HORIZON
from mavdem.live.samples import MAX_SAMPLES
from mavdem.report.blocks import markdown
from mavdem.report.live import watched_quantities
from mavdem.report.numbers import (
    TORQUE_UNIT,
    display_unit,
    motor_position,
    name_with_unit,
    unit_per_input,
)
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
from mavdem.report.screen import assessment_blocks
from mavdem.report.templates import render_section
from mavdem.view.plots import BEYOND, BOOT_CLOCK, Lines, blueprint, events_view, faint

# in view
FLIGHT_SECONDS = 20.0
LEGEND = (
    "Error ratios: beside the better of the last sample and the mean. Surprise is how far F(t) is below its recent "
    "median: 1 is the worst of twenty samples. Unexpected motion is an event; one in "
    f"{MEAN_SECONDS_BETWEEN_FALSE_MARKS / 60:.0f} minutes is expected without a change."
)


class Channels(NamedTuple):
    """The channels of a live flight; their names and units as of a ``Flight``."""

    title: str  # of the recording: vehicle and link
    dt: float  # sampling step, s
    horizons: tuple[int, ...]  # the learner's, in steps
    input_names: Names
    output_names: Names
    input_units: Names
    output_units: Names


Sample = tuple[int, float, Sequence[float] | Array]
"""A segment's number, which changes where samples are missing; a time on the timeline, s; and what is drawn there."""


class LiveWriter:
    """Writes rows of one set of channels into one recording, to which it sends their layout."""

    def __init__(self, channels: Channels, recording: rr.RecordingStream) -> None:
        recording.send_recording_name(channels.title)
        recording.send_blueprint(live_blueprint(channels))
        self.channels = channels
        self._recording = recording
        # by plot, the least and most that were measured
        self._seen: dict[str, Interval] = {}
        # of each, the segment and the time, s, of the latest sample
        self._drawn: dict[Lines, tuple[int, float]] = {}
        # the latest samples of the wind torque: an alarm of a motor is about the last seconds
        self._torques = deque[Sample](maxlen=MAX_SAMPLES)

    def rows(self, rows: list[DisplayRow]) -> None:
        """Draws rows in the order of their times, and what happens in them."""
        names = tuple(map(motor_position, self.channels.input_names))
        motors = Lines("motors", names, DISTINCT[: len(names)])
        self._draw(motors, [(row.segment, row.timeline_time, row.inputs) for row in rows])
        self._angle(rows)
        self._poses(rows)
        speed = Lines(
            "air/speed",
            ("wind", "90 % from", "to"),
            (DISTURBANCE, *2 * (faint(DISTURBANCE, 0.5),)),
        )
        winds = [(row, row.wind) for row in rows if row.wind is not None]
        self._draw(
            speed,
            [(0, wind.time + row.timeline_offset, wind.compass[:3]) for row, wind in winds],
        )
        self._estimates([(row, row.estimate) for row in rows if row.estimate is not None])

    def disown(self, since: float) -> None:
        """Marks the torque from the time ``since`` until now: it was that of a motor that changed."""
        torques = [(int(since), at, torque) for _, at, torque in self._torques if at >= since]
        self._draw(Lines("wind/2_motor", ("of a motor",), (BAD,), 3.0), torques)

    def mark(self, since: float) -> None:
        """Marks an alarm at the time ``since`` in every plot; NaN is none."""
        for plot, (low, high) in self._seen.items() if np.isfinite(since) else ():
            line = Lines(f"{plot}/9_alarms", ("alarm",), (BAD,), filled=True)
            line.send_style(self._recording)
            ends = np.array([[np.nan, np.nan], [low, high]])
            line.send(self._recording, np.array([since - 1e-3, since]), ends)

    def _draw(self, lines: Lines, samples: Sequence[Sample], is_cut: bool = False) -> None:
        """Draws the samples that are later than those before; lines break between segments.

        What ``is_cut`` is cut off beyond what was measured so far, or it would decide about the range of the axis.
        """
        segment, latest = self._drawn.get(lines, (0, -np.inf))
        new = {time: (part, values) for part, time, values in samples if time > latest}
        values = np.array([values for _, values in new.values()], np.float64)
        finite = values[np.isfinite(values)]
        if not new or not (lines in self._drawn or len(finite)):
            return  # a setpoint, say, that nothing sends
        if lines not in self._drawn:
            lines.send_style(self._recording)
        time = np.array([*new])
        parts = [segment, *(part for part, _ in new.values())]
        self._drawn[lines] = parts[-1], time[-1]
        plot = lines.path.rpartition("/")[0] or lines.path
        seen = self._seen.get(plot, ())
        if is_cut and seen:
            low, high = seen
            beyond = BEYOND * (high - low)
            values = np.clip(values, low - beyond, high + beyond)
        elif len(finite):
            drawn = [*seen, finite.min(), finite.max()]
            self._seen[plot] = float(min(drawn)), float(max(drawn))
        breaks = np.flatnonzero(np.diff(parts))
        values = np.insert(values, breaks, np.nan, axis=0)
        time = np.insert(time, breaks, time[breaks] - self.channels.dt / 2)
        lines.send(self._recording, time, values)

    def _angle(self, rows: list[DisplayRow]) -> None:
        """Draws the angle with its prediction, of those nearest to ``REPORTED_HORIZON`` seconds ahead."""
        seconds = np.array(self.channels.horizons) * self.channels.dt
        h = abs(seconds - REPORTED_HORIZON).argmin()
        scale = display_unit(self.channels.output_units[0]).scale
        plot = f"axes/{self.channels.output_names[0]}"
        line = Lines(f"{plot}/1_measured", ("measured",), (MEASURED,), 1.2)
        self._draw(
            line, [(row.segment, row.timeline_time, scale * row.outputs[:1]) for row in rows]
        )
        predictions = [
            (row.segment, row.timeline_time + seconds[h], np.nan, np.nan)
            if (now := row.estimate) is None
            else (
                row.segment,
                now.ahead_times[h] + row.timeline_offset,
                now.ahead[h, 0],
                now.ahead_band[h, 0],
            )
            for row in rows
        ]
        name = f"{seconds[h]:.2g} s ahead"
        ahead = Lines(f"{plot}/2_predicted", (name,), (PREDICTED,), 1.8)
        self._banded(f"{plot}/0_band", ahead, predictions, scale, True)

    def _banded(
        self,
        band: str,
        line: Lines,
        estimates: list[tuple[int, float, float, float]],
        scale: float,
        is_cut: bool = False,
    ) -> list[Sample]:
        """Draws a line with its band, of segment, time, value and half width each; returns what the line draws."""
        edges = [
            (part, at, [scale * (y - half), scale * (y + half)]) for part, at, y, half in estimates
        ]
        shade = (faint(line.colours[0], BAND_OPACITY),)
        self._draw(Lines(band, ("90 % band",), shade, filled=True), edges, is_cut)
        values: list[Sample] = [(part, at, [scale * y]) for part, at, y, _ in estimates]
        self._draw(line, values, is_cut)
        return values

    def _poses(self, rows: list[DisplayRow]) -> None:
        """Draws the angles with what was asked for, and the rates."""
        poses = [
            (row.segment, row.pose.time + row.timeline_offset, row.pose)
            for row in rows
            if row.pose is not None
        ]
        for number, axis in enumerate(AXES):
            if axis not in self.channels.output_names:
                line = Lines(f"axes/{axis}/1_measured", (axis,), (MEASURED,))
                self._draw(
                    line, [(s, t, [np.degrees(pose.angles[number])]) for s, t, pose in poses]
                )
        for number, axis in enumerate(TILT_AXES):
            line = Lines(f"axes/{axis}/0_asked", ("setpoint",), (TRUTH,))
            asked = [(s, t, [np.degrees(pose.setpoint[number])]) for s, t, pose in poses]
            self._draw(line, asked, True)
        rates = Lines("rates", AXES, DISTINCT[: len(AXES)])
        self._draw(rates, [(s, t, np.degrees(pose.rates)) for s, t, pose in poses])

    def _estimates(self, rows: Sequence[tuple[DisplayRow, Estimate]]) -> None:
        """Draws the wind torque with its band at the times it is of; F(t) and surprise at those of their windows."""
        estimates = [
            (0, now.wind_time + row.timeline_offset, now.wind_torque, now.wind_torque_band)
            for row, now in rows
            if np.isfinite(now.wind_time)
        ]
        torque = Lines("wind/1_torque", ("torque",), (DISTURBANCE,))
        self._torques += self._banded("wind/0_band", torque, estimates, TORQUE_UNIT.scale)
        seen = [(now.seen + row.timeline_offset, now) for row, now in rows if np.isfinite(now.seen)]
        energy = [(0, at, [now.free_energy]) for at, now in seen]
        surprise = [(0, at, [1.0, now.surprise]) for at, now in seen]
        self._draw(Lines("free_energy_of_samples", ("F(t)",), (MEASURED,)), energy)
        samples = Lines("surprise/samples", ("worst of 20", "surprise"), (BOUND, PREDICTED))
        self._draw(samples, surprise)


def live_blueprint(channels: Channels) -> rrb.Blueprint:
    """Returns tabs: the flight on one axis of time, more of the samples, the status."""

    def plot(name: str, origin: str) -> rrb.TimeSeriesView:
        """A plot of the last seconds before the time cursor; only these are queried."""
        start = rr.TimeRangeBoundary.cursor_relative(seconds=-FLIGHT_SECONDS)
        end = rr.TimeRangeBoundary.cursor_relative(seconds=REPORTED_HORIZON)
        axis = rrb.archetypes.TimeAxis(view_range=rr.TimeRange(start=start, end=end))
        shown = rrb.VisibleTimeRange(BOOT_CLOCK, start=start, end=end)
        return rrb.TimeSeriesView(
            name=name,
            origin=origin,
            axis_x=axis,
            time_ranges=[shown],
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop),
        )

    axes = [plot(name_with_unit(axis.capitalize(), "°"), f"axes/{axis}") for axis in AXES]
    motors = name_with_unit("Motors", next(iter(channels.input_units), ""))
    pictures = rrb.Vertical(
        *axes,
        plot("Rates, °/s", "rates"),
        plot(motors, "motors"),
        plot("Wind, m/s", "air"),
        plot(f"Wind torque on {channels.output_names[0]}, {TORQUE_UNIT.name}", "wind"),
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


def figures(
    status: SessionStatus, row: DisplayRow, channels: Channels, until: float | None
) -> Names:
    """Returns Markdown documents: state, prediction, wind, its torque, physical parameters, and what is watched.

    ``row`` is the latest, of these ``channels``; the model was learned ``until`` s of the boot clock.
    """
    judged = status.model_judgement
    now = row.estimate
    cards = render_section(
        "live_cards",
        status=status,
        watched=watched_quantities(status.watch_facts),
        row=row,
        channels=channels,
        until=until,
        reason=_reason(status, until),
        is_bad=judged is not None and judged.headline.is_bad,
        now=now,
        physical=None if now is None else now.physical,
        level=CONFIDENCE_LEVEL,
        unit=TORQUE_UNIT,
        per_input=unit_per_input(TORQUE_UNIT, channels.input_units[0]),
    )
    return tuple(card.text for card in cards)


def _reason(status: SessionStatus, until: float | None) -> str:
    """Why there is no model, or no newer one."""
    if status.obstacle is not None:
        return status.obstacle.advised
    return TOO_FEW_SAMPLES.advised if until is None else ""


def status_document(
    status: SessionStatus, row: DisplayRow, channels: Channels, until: float | None
) -> str:
    """Returns the latest status and row as Markdown; the model was learned ``until`` s, None before the first."""
    title, *details = render_section(
        "live_details",
        status=status,
        row=row,
        channels=channels,
        until=until,
        reason=_reason(status, until),
    )
    blocks = []
    if status.findings is not None:
        blocks = [markdown(assessment_blocks(status.findings, status.overall_judgement))]
    return "\n\n".join([title.text, *blocks, *(sentence.text for sentence in details), LEGEND])
