"""Content: what a live view is given, and how it becomes the entities of a recording, batch by batch."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from mavdem.dem import Estimate, Learned, LinearModel
from mavdem.dem.engine.linalg import Array
from mavdem.dem.graybox.wind import LEVEL_SECONDS, gusts
from mavdem.dem.priors import hyperparameter_groups
from mavdem.dem.record import Record
from mavdem.live.history import AHEAD
from mavdem.report.numbers import place, readable, state_names
from mavdem.report.palette import BAD, BAND_OPACITY, BOUND, COMMAND, DISTURBANCE, MEASURED, PREDICTED, distinct
from mavdem.view.plots import BOOT_CLOCK, Lines, faint

GUST_SECONDS = 60.0  # of the latest torque, which gusts are found in
BEYOND = 0.3  # how far predictions and bands are drawn beyond what was measured, in spans of it


class Channels(NamedTuple):
    """The channels of a live flight.

    Attributes:
        title: of the recording: vehicle and link.
        dt: sampling step, s.
        horizons: the learner's, in steps.
        input_names, output_names, input_units, output_units: as of a ``Flight``.
        command: weights of the inputs in the command of the axis; empty where they are not known.
    """

    title: str
    dt: float
    horizons: tuple[int, ...]
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    input_units: tuple[str, ...]
    output_units: tuple[str, ...]
    command: tuple[float, ...] = ()


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


class LogLine(NamedTuple):
    """A sentence ``text`` at a ``time`` on the timeline, s, with a ``level``: "INFO", "WARN" or "ERROR"."""

    time: float
    level: str
    text: str

    def send(self, recording: rr.RecordingStream) -> None:
        """Writes it into the log."""
        recording.set_time(BOOT_CLOCK, duration=self.time)
        recording.log("log", rr.TextLog(self.text, level=self.level))


class LiveWriter:
    """Writes rows of one set of channels into one recording."""

    def __init__(self, channels: Channels) -> None:
        self._channels = channels
        self._units = [readable(unit) for unit in channels.output_units]
        self._torques: deque[tuple[float, float, float]] = deque(maxlen=round(GUST_SECONDS / channels.dt))
        self._gusts_until = -np.inf
        self._segment: int | None = None
        self._seen: dict[str, tuple[float, float]] = {}  # by plot, the least and most that were measured
        self._unusual = False
        self._model: LinearModel | None = None
        self._horizon = int(np.abs(np.array(channels.horizons) * channels.dt - AHEAD).argmin())
        self.lines = {lines.path: lines for lines in self._all_lines()}

    def _all_lines(self) -> list[Lines]:
        """All but those of the model; predictions are those nearest to ``AHEAD`` seconds ahead."""
        channels = self._channels
        command = Lines("command", ("motors' difference",), (COMMAND,))
        if not channels.command:
            names = tuple(map(place, channels.input_names))
            command = Lines("command", names, tuple(map(distinct, range(len(names)))))
        lines = [
            command,
            Lines("free_energy_of_samples", ("F(t)",), (MEASURED,)),
            Lines("free_energy_action", ("F̄",), (MEASURED,), 2.0),
            Lines("surprise/samples", ("worst of 20", "surprise"), (BOUND, PREDICTED)),
            Lines("surprise/unusual", ("unusual",), (BAD,), 4.0, marked=True),
            Lines("wind/0_band", ("90 % band",), (faint(DISTURBANCE, BAND_OPACITY),), filled=True),
            Lines("wind/1_torque", ("torque",), (DISTURBANCE,)),
        ]
        for name in channels.output_names:
            plot = rr.new_entity_path(["outputs", name])
            ahead = f"{channels.horizons[self._horizon] * channels.dt:.2g} s ahead"
            lines += [
                Lines(f"{plot}/0_band", ("90 % band",), (faint(PREDICTED, BAND_OPACITY),), filled=True),
                Lines(f"{plot}/1_measured", ("measured",), (MEASURED,), 1.2),
                Lines(f"{plot}/2_predicted", (ahead,), (PREDICTED,), 1.8),
            ]
        return lines

    def begin(self, recording: rr.RecordingStream) -> None:
        """Sends the styles; once a recording, before the first row."""
        for lines in self.lines.values():
            lines.send_style(recording)

    def rows(self, recording: rr.RecordingStream, rows: list[ViewRow]) -> None:
        """Draws rows in the order of their times, and what happens in them."""
        time, inputs = np.array([row.time for row in rows]), np.array([row.inputs for row in rows])
        segments = [self._segment, *(row.segment for row in rows)]
        self._segment = rows[-1].segment
        breaks = np.array([i for i in range(len(rows)) if segments[i] not in (None, segments[i + 1])], np.intp)
        self._outputs(recording, rows, time, breaks)
        command = inputs @ np.array(self._channels.command)[:, None] if self._channels.command else inputs
        self._draw(recording, "command", time, command, breaks)
        estimates = [(row.estimate, row.shift) for row in rows if row.estimate is not None]
        self._judgement(recording, [pair for pair in estimates if np.isfinite(pair[0].seen)])
        self._wind(recording, estimates)
        self._models(recording, rows)

    def _draw(
        self, recording: rr.RecordingStream, path: str, time: Array, values: Array, breaks: NDArray[np.intp]
    ) -> None:
        """Draws lines that break before the rows ``breaks``, where samples are missing."""
        if len(breaks):
            values = np.insert(values, breaks, np.nan, axis=0)
            time = np.insert(time, breaks, time[breaks] - self._channels.dt / 2)
        self.lines[path].send(recording, time, values)

    def _outputs(
        self, recording: rr.RecordingStream, rows: list[ViewRow], time: Array, breaks: NDArray[np.intp]
    ) -> None:
        h, measured = self._horizon, np.array([row.outputs for row in rows])
        ahead, half = np.full((2, *measured.shape), np.nan)
        later = time + self._channels.horizons[h] * self._channels.dt
        for i, row in enumerate(rows):
            if (now := row.estimate) is not None:
                ahead[i], half[i], later[i] = now.ahead[h], now.ahead_band[h], now.ahead_times[h] + row.shift
        for i, (name, unit) in enumerate(zip(self._channels.output_names, self._units, strict=True)):
            plot, drawn = rr.new_entity_path(["outputs", name]), unit.scale * measured[:, i]
            then = unit.scale * np.stack([ahead[:, i] - half[:, i], ahead[:, i] + half[:, i], ahead[:, i]], axis=-1)
            then = self._in_sight(plot, drawn, then)
            self._draw(recording, f"{plot}/0_band", later, then[:, :2], breaks)
            self._draw(recording, f"{plot}/1_measured", time, drawn[:, None], breaks)
            self._draw(recording, f"{plot}/2_predicted", later, then[:, 2:], breaks)

    def _in_sight(self, plot: str, measured: Array, values: Array) -> Array:
        """Values cut off beyond what was measured so far, or they would decide about the range of the axis."""
        finite = np.append(measured[np.isfinite(measured)], self._seen.get(plot, ()))
        if not len(finite):
            return values
        self._seen[plot] = low, high = float(finite.min()), float(finite.max())
        beyond = BEYOND * (high - low)
        return np.clip(values, low - beyond, high + beyond) if high > low else values

    def _wind(self, recording: rr.RecordingStream, estimates: Sequence[tuple[Estimate, float]]) -> None:
        """Draws the wind torque with its band at the times it is of, and logs gusts; NaN where it is not known."""
        scale, torques = readable("rad/s²").scale, []
        for now, shift in estimates:
            if np.isfinite(now.wind_time):
                torques.append((now.wind_time + shift, now.wind_torque, now.wind_torque_band))
                self._torques.append(torques[-1])
                if not np.isfinite(now.wind_torque):
                    self._torques.clear()
        self._log_gusts(recording)
        if torques:
            time, torque, half = np.array(torques).T
            edges = np.stack([torque - half, torque + half], axis=-1)
            self.lines["wind/0_band"].send(recording, time, self._in_sight("wind", scale * torque, scale * edges))
            self.lines["wind/1_torque"].send(recording, time, scale * torque[:, None])

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
                LogLine(float(time[gust.sample]), "WARN", text).send(recording)

    def _judgement(self, recording: rr.RecordingStream, estimates: Sequence[tuple[Estimate, float]]) -> None:
        """Draws F(t) and surprise at the centres of their windows, and logs marks."""
        if not estimates:
            return
        rows = [(now.seen + shift, now.free_energy, now.surprise, now.unusual) for now, shift in estimates]
        time, energy, surprise, unusual = np.array(rows, np.float64).T
        marked = unusual > 0
        self.lines["free_energy_of_samples"].send(recording, time, energy[:, None])
        self.lines["surprise/samples"].send(recording, time, np.stack([np.ones(len(time)), surprise], axis=-1))
        self.lines["surprise/unusual"].send(recording, time[marked], surprise[marked, None])
        for i in np.flatnonzero(marked & ~np.append(self._unusual, marked[:-1])):
            LogLine(float(time[i]), "WARN", f"unusual motion: surprise {surprise[i]:.2g}").send(recording)
        self._unusual = bool(marked[-1])

    def _models(self, recording: rr.RecordingStream, rows: list[ViewRow]) -> None:
        """Draws F̄ and λ: a point for each new model."""
        for row in rows:
            now = row.estimate
            if now is None or now.model is None or now.model is self._model:
                continue
            self._model = now.model
            time, action = np.array([row.time]), np.array([now.free_energy_action])
            self.lines["free_energy_action"].send(recording, time, action)
            if row.learned is not None:
                names = precision_names(self._channels.output_names, row.learned)
                lines = Lines("noise_precisions", names, tuple(map(distinct, range(len(names)))), 2.0)
                lines.send_style(recording)
                lines.send(recording, time, now.log_precisions)


def precision_names(outputs: Sequence[str], learned: Learned) -> tuple[str, ...]:
    """Returns what each λ is of: the measurement noise z, then the process noise w."""
    states, names = state_names(outputs, learned), []
    groups = hyperparameter_groups(learned.settings, len(states), len(outputs))
    for noise, whole, channels, group in zip("zw", ("measurement", "process"), (outputs, states), groups, strict=True):
        numbers = np.unique(group)
        for number in numbers:
            shared = " and ".join(name for name, member in zip(channels, group, strict=True) if member == number)
            names.append(f"{noise} of {shared}" if len(numbers) > 1 else f"{noise}, {whole}")
    return tuple(names)
