"""Content: turns rows into the entities of a recording, batch by batch."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from mavdem.dem import Estimate
from mavdem.report.names import Readable, named, per_second, readable
from mavdem.view import lines
from mavdem.view.live.line_group import BOOT_CLOCK, LineGroup, around, band
from mavdem.view.live.model_lines import ModelLines
from mavdem.view.live.rows import Channels, LogLine, ViewRow

Array = NDArray[np.float64]

AHEAD_SECONDS = 0.25  # horizon shown, before errors say which is useful
CHANGE_SECONDS = 10.0  # for which a horizon is shown at least
ALARM = (255, 92, 92)


class Content:
    """Writes rows of one set of channels into one recording, below the entity ``root``, which may be empty."""

    def __init__(self, channels: Channels, root: str = "") -> None:
        self.root = root
        self._channels = channels
        self._model = ModelLines(channels, root)
        self._segment: int | None = None
        self._units = [readable(unit) for unit in channels.output_units]
        self._disturbed, self._horizon, self._since = disturbed(channels), shown_horizon(channels), -np.inf
        self.groups = {group.path: group.under(root) for group in _groups(channels, self._units)}

    def begin(self, recording: rr.RecordingStream) -> None:
        """Sends the styles; once a recording, before the first row."""
        for group in self.groups.values():
            group.send_style(recording)
        self._model.begin()

    def rows(self, recording: rr.RecordingStream, rows: list[ViewRow]) -> None:
        """Draws rows in the order of their times."""
        if not rows:
            return
        time = np.array([row.time for row in rows])
        segments = [self._segment, *(row.segment for row in rows)]
        self._segment = rows[-1].segment
        breaks = np.array([i for i in range(len(rows)) if segments[i] not in (None, segments[i + 1])], np.intp)
        self._outputs(recording, rows, time, breaks)
        self._draw(recording, "inputs", time, np.array([row.inputs for row in rows]), breaks)
        judged = [row for row in rows if row.estimate is not None and np.isfinite(row.estimate.seen)]
        if judged:
            self._judgement(recording, judged)
        self._wind(recording, [row for row in rows if row.estimate is not None])
        self._model.add(recording, rows)

    def log(self, recording: rr.RecordingStream, line: LogLine) -> None:
        """Writes a line of the log."""
        recording.set_time(BOOT_CLOCK, duration=line.time)
        recording.log("log", rr.TextLog(line.text, level=line.level))

    def status(self, recording: rr.RecordingStream, time: float, document: str) -> None:
        """Shows a Markdown document from ``time``, s, on."""
        recording.set_time(BOOT_CLOCK, duration=time)
        recording.log("status", rr.TextDocument(document, media_type=rr.MediaType.MARKDOWN))

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
        m, h = len(self._channels.output_names), self._horizon

        def column(part: Callable[[Estimate], Array]) -> Array:
            nothing = np.full(m, np.nan)
            return np.array([nothing if row.estimate is None else part(row.estimate) for row in rows])

        expected, half = column(lambda one: one.expected), column(lambda one: one.expected_band)
        ahead, ahead_half = column(lambda one: one.ahead[h]), column(lambda one: one.ahead_band[h])
        measured = np.array([row.outputs for row in rows])
        horizon = self._channels.horizons[h] * self._channels.dt
        later = np.array(
            [row.time + horizon if row.estimate is None else row.estimate.ahead_times[h] + row.shift for row in rows]
        )
        for i, (name, unit) in enumerate(zip(self._channels.output_names, self._units, strict=True)):
            now = [*around(expected[:, i], half[:, i]), measured[:, i]]
            then = around(ahead[:, i], ahead_half[:, i])
            root = rr.new_entity_path(["outputs", name])
            self._draw(recording, f"{root}/now", time, unit.scale * np.stack(now, axis=-1), breaks)
            self._draw(recording, f"{root}/ahead", later, unit.scale * np.stack(then, axis=-1), breaks)

    def _choose_horizon(self, recording: rr.RecordingStream, row: ViewRow) -> None:
        """Shows the longest useful horizon from here on, and its name in the legend; the first where none is useful."""
        if row.estimate is None or not np.isfinite(row.estimate.ahead_ratio).all():
            return
        useful = row.estimate.useful or 0
        if useful == self._horizon or row.time - self._since < CHANGE_SECONDS:
            return
        self._horizon, self._since = useful, row.time
        for name in self._channels.output_names:
            group = _ahead(self._channels, name, useful)
            self.groups[group.path] = group.under(self.root)
            self.groups[group.path].send_style(recording)

    def _wind(self, recording: rr.RecordingStream, rows: list[ViewRow]) -> None:
        """Draws the wind's torque with its band at the times it is of; NaN breaks the line where it is not known."""
        estimates = [row.estimate for row in rows if row.estimate is not None]
        times = np.array([estimate.wind_time for estimate in estimates]) + [row.shift for row in rows]
        torque, half = (
            np.array([getattr(estimate, name) for estimate in estimates])
            for name in ("wind_torque", "wind_torque_band")
        )
        of_a_time = np.isfinite(times)
        values = np.stack(around(torque, half), axis=-1)
        self.groups["disturbance/wind_torque"].send(recording, times[of_a_time], values[of_a_time])

    def _judgement(self, recording: rr.RecordingStream, rows: list[ViewRow]) -> None:
        """Draws F(t), surprise and disturbance at the centres of their windows; NaN breaks incomplete windows."""
        estimates = [row.estimate for row in rows if row.estimate is not None]
        seen = np.array([estimate.seen for estimate in estimates]) + [row.shift for row in rows]
        surprise = np.array([estimate.surprise for estimate in estimates])
        energy = np.array([estimate.free_energy for estimate in estimates])
        # C w: the disturbance of each output.
        nothing = np.full(len(self._channels.output_names), np.nan)
        disturbance = np.array([nothing if one.model is None else one.model.C @ one.disturbance for one in estimates])
        self.groups["free_energy_of_samples"].send(recording, seen, energy[:, None])
        self.groups["disturbance"].send(recording, seen, disturbance[:, self._disturbed])
        self.groups["surprise/samples"].send(recording, seen, np.stack([np.ones(len(seen)), surprise], axis=-1))
        unusual = np.array([estimate.unusual for estimate in estimates])
        self.groups["surprise/unusual"].send(recording, seen[unusual], surprise[unusual, None])


def disturbed(channels: Channels) -> list[int]:
    """The outputs whose disturbance is shown: the rates, or all outputs if there is no rate."""
    # That of an angle is only the disagreement of the sensors: its derivative is the rate.
    rates = [i for i, unit in enumerate(channels.output_units) if unit.endswith("/s")]
    return rates or list(range(len(channels.output_names)))


def shown_horizon(channels: Channels) -> int:
    """The index of the horizon nearest to ``AHEAD_SECONDS``."""
    return min(range(len(channels.horizons)), key=lambda i: abs(channels.horizons[i] * channels.dt - AHEAD_SECONDS))


def _ahead(channels: Channels, output: str, horizon: int) -> LineGroup:
    """The lines of an output's predictions, named by their horizon."""
    seconds = channels.horizons[horizon] * channels.dt
    return band(f"{rr.new_entity_path(['outputs', output])}/ahead", f"{seconds:.2g} s ahead", lines.FORECAST, 1.5)


def _groups(channels: Channels, units: list[Readable]) -> list[LineGroup]:
    """All lines except the model's."""
    r, rates = len(channels.input_names), disturbed(channels)
    disturbances = tuple(named(channels.output_names[i], per_second(channels.output_units[i])) for i in rates)
    groups = [
        LineGroup("inputs", channels.input_names, tuple(map(lines.distinct, range(r))), (1.5,) * r),
        LineGroup("free_energy_of_samples", ("F(t)",), (lines.MEASURED,), (1.5,)),
        LineGroup("surprise/samples", ("worst of 20", "surprise"), (lines.TRIVIAL, lines.MEASURED), (1.0, 1.5)),
        LineGroup("surprise/unusual", ("unusual",), (ALARM,), (4.0,), marked=True),
        band("disturbance/wind_torque", "wind's torque, rad/s²", lines.FORECAST, 1.5),
        LineGroup("disturbance", disturbances, tuple(map(lines.distinct, range(len(rates)))), (1.5,) * len(rates)),
    ]
    for name in channels.output_names:
        root = rr.new_entity_path(["outputs", name])
        now = (*["expected"] * 3, "measured"), (*[lines.PREDICTED] * 3, lines.MEASURED), (0.6, 0.6, 4.0, 1.5)
        groups += [
            _ahead(channels, name, shown_horizon(channels)),
            LineGroup(f"{root}/now", *now),
        ]
    return groups
