"""Content: turns rows into the entities of a recording, batch by batch."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from mavdem.dem import Estimate
from mavdem.dem.graybox.wind import LEVEL_SECONDS, gusts
from mavdem.dem.record import Record
from mavdem.report.numbers import place, readable
from mavdem.report.palette import BAD, BAND_OPACITY, BOUND, COMMAND, DISTURBANCE, MEASURED, PREDICTED, distinct
from mavdem.view.live.line_group import BOOT_CLOCK, LineGroup
from mavdem.view.live.model_lines import ModelLines
from mavdem.view.live.rows import Channels, LogLine, ViewRow
from mavdem.view.time_plot import faint

Array = NDArray[np.float64]

AHEAD_SECONDS = 0.25  # horizon shown, before errors say which is useful
CHANGE_SECONDS = 10.0  # for which a horizon is shown at least
GUST_SECONDS = 60.0  # of the latest torque, which gusts are found in
BEYOND = 0.3  # how far predictions and bands are drawn beyond what was measured, in spans of it


class Content:
    """Writes rows of one set of channels into one recording, below the entity ``root``, which may be empty."""

    def __init__(self, channels: Channels, root: str = "") -> None:
        self.root = root
        self._channels = channels
        self._model = ModelLines(channels, root)
        self._torques: deque[tuple[float, float, float]] = deque(maxlen=round(GUST_SECONDS / channels.dt))
        self._gusts_until = -np.inf
        self._segment: int | None = None
        self._units = [readable(unit) for unit in channels.output_units]
        self._horizon, self._since = shown_horizon(channels), -np.inf
        self._seen: dict[
            str, tuple[float, float]
        ] = {}  # by the entity of a plot, the least and most that were measured
        self._unusual = False
        self.groups = {group.path: group.under(root) for group in _groups(channels)}

    def begin(self, recording: rr.RecordingStream) -> None:
        """Sends the styles; once a recording, before the first row."""
        for group in self.groups.values():
            group.send_style(recording)
        self._model.begin()

    def rows(self, recording: rr.RecordingStream, rows: list[ViewRow]) -> None:
        """Draws rows in the order of their times, and what happens in them."""
        if not rows:
            return
        time = np.array([row.time for row in rows])
        segments = [self._segment, *(row.segment for row in rows)]
        self._segment = rows[-1].segment
        breaks = np.array([i for i in range(len(rows)) if segments[i] not in (None, segments[i + 1])], np.intp)
        self._outputs(recording, rows, time, breaks)
        inputs = np.array([row.inputs for row in rows])
        command = inputs @ np.array(self._channels.command)[:, None] if self._channels.command else inputs
        self._draw(recording, "command", time, command, breaks)
        learned = [row for row in rows if row.estimate is not None]
        self._judgement(recording, [row for row in learned if row.estimate and np.isfinite(row.estimate.seen)])
        self._wind(recording, learned)
        self._model.add(recording, rows)

    def log(self, recording: rr.RecordingStream, line: LogLine) -> None:
        """Writes a line of the log."""
        recording.set_time(BOOT_CLOCK, duration=line.time)
        recording.log("log", rr.TextLog(line.text, level=line.level))

    def status(self, recording: rr.RecordingStream, time: float, document: str, figures: Sequence[str]) -> None:
        """Shows a Markdown document, and one for each of some figures, from ``time``, s, on."""
        recording.set_time(BOOT_CLOCK, duration=time)
        for path, text in (*((f"figures/{i}", text) for i, text in enumerate(figures)), ("status", document)):
            recording.log(path, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))

    def end(self, recording: rr.RecordingStream) -> None:
        """Sends what still waits."""
        self._model.send(recording)

    def _draw(
        self, recording: rr.RecordingStream, path: str, time: Array, values: Array, breaks: NDArray[np.intp]
    ) -> None:
        """Draws lines that break before the rows ``breaks``, where samples are missing."""
        if len(breaks):
            values = np.insert(values, breaks, np.nan, axis=0)
            time = np.insert(time, breaks, time[breaks] - self._channels.dt / 2)
        self.groups[path].send(recording, time, values)

    def _outputs(
        self, recording: rr.RecordingStream, rows: list[ViewRow], time: Array, breaks: NDArray[np.intp]
    ) -> None:
        self._choose_horizon(recording, rows[-1])
        h, nothing = self._horizon, np.full(len(self._channels.output_names), np.nan)

        def column(part: Callable[[Estimate], Array]) -> Array:
            return np.array([nothing if row.estimate is None else part(row.estimate) for row in rows])

        ahead, half = column(lambda one: one.ahead[h]), column(lambda one: one.ahead_band[h])
        measured = np.array([row.outputs for row in rows])
        horizon = self._channels.horizons[h] * self._channels.dt
        later = np.array(
            [row.time + horizon if row.estimate is None else row.estimate.ahead_times[h] + row.shift for row in rows]
        )
        for i, (name, unit) in enumerate(zip(self._channels.output_names, self._units, strict=True)):
            root, drawn = rr.new_entity_path(["outputs", name]), unit.scale * measured[:, i]
            then = unit.scale * np.stack([ahead[:, i] - half[:, i], ahead[:, i] + half[:, i], ahead[:, i]], axis=-1)
            then = self._in_sight(root, drawn, then)
            self._draw(recording, f"{root}/0_band", later, then[:, :2], breaks)
            self._draw(recording, f"{root}/1_measured", time, drawn[:, None], breaks)
            self._draw(recording, f"{root}/2_predicted", later, then[:, 2:], breaks)

    def _in_sight(self, plot: str, measured: Array, values: Array) -> Array:
        """Values cut off beyond what was measured so far, or they would decide about the range of the axis."""
        low, high = self._seen.get(plot, (np.inf, -np.inf))
        finite = measured[np.isfinite(measured)]
        if len(finite):
            self._seen[plot] = low, high = min(low, float(finite.min())), max(high, float(finite.max()))
        beyond = BEYOND * (high - low)
        return np.clip(values, low - beyond, high + beyond) if high > low else values

    def _choose_horizon(self, recording: rr.RecordingStream, row: ViewRow) -> None:
        """Shows the longest useful horizon from here on, and its name in the legend; the first where none is useful."""
        if row.estimate is None or not np.isfinite(row.estimate.ahead_ratio).all():
            return
        useful = row.estimate.useful or 0
        if useful == self._horizon or row.time - self._since < CHANGE_SECONDS:
            return
        self._horizon, self._since = useful, row.time
        for group in _groups(self._channels, useful):
            if group.path.endswith("/2_predicted"):
                self.groups[group.path] = group.under(self.root)
                self.groups[group.path].send_style(recording)

    def _wind(self, recording: rr.RecordingStream, rows: list[ViewRow]) -> None:
        """Draws the wind's torque with its band at the times it is of, and logs gusts; NaN where it is not known."""
        scale, known = readable("rad/s²").scale, []
        for row in rows:
            now = row.estimate
            if now is None or not np.isfinite(now.wind_time):
                continue
            known.append((now.wind_time + row.shift, now.wind_torque, now.wind_torque_band))
            if not np.isfinite(now.wind_torque):
                self._torques.clear()
                continue
            self._torques.append(known[-1])
        self._log_gusts(recording)
        if known:
            time, torque, half = np.array(known).T
            edges = np.stack([torque - half, torque + half], axis=-1)
            edges = self._in_sight("wind", scale * torque, scale * edges)
            self.groups["wind/0_band"].send(recording, time, edges)
            self.groups["wind/1_torque"].send(recording, time, scale * torque[:, None])

    def _log_gusts(self, recording: rr.RecordingStream) -> None:
        """Logs the gusts of the latest torque that have ended since the last time, about once a second."""
        dt = self._channels.dt
        if len(self._torques) * dt < 2 * LEVEL_SECONDS or self._torques[-1][0] < self._gusts_until + 1.0:
            return
        time, torque, band = np.array(self._torques).T
        before, self._gusts_until = self._gusts_until, time[-1]
        for gust in gusts(torque, band, Record(torque[:, None], torque[:, None], dt, (len(torque),))).found:
            end = gust.sample + round(gust.length / dt)
            if end < len(time) and time[end] > before:
                text = f"gust: {readable('rad/s²').scale * gust.size:+.0f} °/s² for {gust.length:.2g} s"
                self.log(recording, LogLine(float(time[gust.sample]), "WARN", text))

    def _judgement(self, recording: rr.RecordingStream, rows: list[ViewRow]) -> None:
        """Draws F(t) and surprise at the centres of their windows, and logs marks; NaN breaks incomplete windows."""
        estimates = [row.estimate for row in rows if row.estimate is not None]
        seen = np.array([estimate.seen for estimate in estimates]) + [row.shift for row in rows]
        surprise = np.array([estimate.surprise for estimate in estimates])
        energy = np.array([estimate.free_energy for estimate in estimates])
        self.groups["free_energy_of_samples"].send(recording, seen, energy[:, None])
        self.groups["surprise/samples"].send(recording, seen, np.stack([np.ones(len(seen)), surprise], axis=-1))
        unusual = np.array([estimate.unusual for estimate in estimates], dtype=np.bool_)
        self.groups["surprise/unusual"].send(recording, seen[unusual], surprise[unusual, None])
        for i in np.flatnonzero(unusual & ~np.append(self._unusual, unusual[:-1])):
            self.log(recording, LogLine(float(seen[i]), "WARN", f"unusual motion: surprise {surprise[i]:.2g}"))
        self._unusual = bool(unusual[-1]) if len(unusual) else self._unusual


def shown_horizon(channels: Channels) -> int:
    """The index of the horizon nearest to ``AHEAD_SECONDS``."""
    return min(range(len(channels.horizons)), key=lambda i: abs(channels.horizons[i] * channels.dt - AHEAD_SECONDS))


def _groups(channels: Channels, horizon: int | None = None) -> list[LineGroup]:
    """All lines except the model's, predictions as far ahead as the ``horizon``, or the first to be shown."""
    seconds = channels.horizons[shown_horizon(channels) if horizon is None else horizon] * channels.dt
    names = ("motors' difference",) if channels.command else tuple(map(place, channels.input_names))
    colours = (COMMAND,) if channels.command else tuple(map(distinct, range(len(names))))
    groups = [
        LineGroup("command", names, colours),
        LineGroup("free_energy_of_samples", ("F(t)",), (MEASURED,)),
        LineGroup("surprise/samples", ("worst of 20", "surprise"), (BOUND, PREDICTED)),
        LineGroup("surprise/unusual", ("unusual",), (BAD,), 4.0, marked=True),
        LineGroup("wind/0_band", ("90 % band",), (faint(DISTURBANCE, BAND_OPACITY),), filled=True),
        LineGroup("wind/1_torque", ("torque",), (DISTURBANCE,)),
    ]
    for name in channels.output_names:
        root = rr.new_entity_path(["outputs", name])
        groups += [
            LineGroup(f"{root}/0_band", ("90 % band",), (faint(PREDICTED, BAND_OPACITY),), filled=True),
            LineGroup(f"{root}/1_measured", ("measured",), (MEASURED,), 1.2),
            LineGroup(f"{root}/2_predicted", (f"{seconds:.2g} s ahead",), (PREDICTED,), 1.8),
        ]
    return groups
