"""Content: what rows become in a recording, batch by batch."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from mavdem.dem import Estimate
from mavdem.naming import Readable, named, per_second, readable
from mavdem.view import lines
from mavdem.view.live.bundle import BOOT_CLOCK, Bundle
from mavdem.view.live.model_lines import ModelLines
from mavdem.view.live.row import Channels, LogLine, Row

Array = NDArray[np.float64]

UNUSUAL = 3.0
"""Surprise, in units of what the worst of twenty samples shows, from which on a sample is marked."""
FAR = 0.25
"""Seconds ahead of the predictions that are shown: one step ahead everything is known, and half a second ahead little,
with motors that are taken to stay as they are."""
ALARM = (255, 92, 92)


class Content:
    """Writes batches of rows of one set of channels into one recording; remembers what parts one from the next.

    Attributes:
        root: entity below which they are drawn; empty for none.
        bundles: the lines, but the model's, by their path below it.
    """

    def __init__(self, channels: Channels, root: str = "") -> None:
        self.root = root
        self._channels = channels
        self._model = ModelLines(channels, root)
        self._segment: int | None = None
        self._shown = [readable(unit) for unit in channels.output_units]
        self._pushed, self._far = pushed(channels), far(channels)
        self.bundles = {path: bundle.under(root) for path, bundle in _bundles(channels, self._shown).items()}

    def begin(self, recording: rr.RecordingStream) -> None:
        """Says how everything is drawn; once a recording, before the first row."""
        for bundle in self.bundles.values():
            bundle.send_style(recording)
        self._model.begin()

    def rows(self, recording: rr.RecordingStream, rows: list[Row]) -> None:
        """Draws rows in the order of their times."""
        if not rows:
            return
        time, breaks = np.array([row.time for row in rows]), self._breaks(rows)
        self._outputs(recording, rows, time, breaks)
        self._draw(recording, "inputs", time, np.array([row.inputs for row in rows]), breaks)
        judged = [row for row in rows if row.estimate is not None and np.isfinite(row.estimate.seen)]
        if judged:
            self._judgement(recording, judged)
        self._model.add(recording, rows)

    def log(self, recording: rr.RecordingStream, line: LogLine) -> None:
        """Writes a line of the log."""
        recording.set_time(BOOT_CLOCK, duration=line.time)
        recording.log("log", rr.TextLog(line.text, level=line.level))

    def status(self, recording: rr.RecordingStream, time: float, document: str) -> None:
        """Shows a Markdown document from a time on, s."""
        recording.set_time(BOOT_CLOCK, duration=time)
        recording.log("status", rr.TextDocument(document, media_type=rr.MediaType.MARKDOWN))

    def end(self, recording: rr.RecordingStream) -> None:
        """Sends what was held back to be sent together."""
        self._model.send(recording)

    def _breaks(self, rows: list[Row]) -> NDArray[np.intp]:
        """Before which rows lines are parted, since samples are missing there."""
        segments = [self._segment, *(row.segment for row in rows)]
        self._segment = rows[-1].segment
        return np.array([i for i in range(len(rows)) if segments[i] not in (None, segments[i + 1])], np.intp)

    def _draw(
        self, recording: rr.RecordingStream, path: str, time: Array, values: Array, breaks: NDArray[np.intp]
    ) -> None:
        if len(breaks):
            values = np.insert(values, breaks, np.nan, axis=0)
            time = np.insert(time, breaks, time[breaks] - self._channels.dt / 2)
        self.bundles[path].send(recording, time, values)

    def _outputs(self, recording: rr.RecordingStream, rows: list[Row], time: Array, breaks: NDArray[np.intp]) -> None:
        m, H = len(self._channels.output_names), len(self._channels.horizons)
        expected, band, ahead, ahead_band = (
            _of_estimates(rows, part, shape)
            for part, shape in (
                (lambda estimate: estimate.expected, (m,)),
                (lambda estimate: estimate.expected_band, (m,)),
                (lambda estimate: estimate.ahead, (H, m)),
                (lambda estimate: estimate.ahead_band, (H, m)),
            )
        )
        measured = np.array([row.outputs for row in rows])
        far = self._channels.horizons[self._far] * self._channels.dt
        later = np.array(
            [row.time + far if (of := row.estimate) is None else of.ahead_times[self._far] + row.shift for row in rows]
        )
        for i, (name, unit) in enumerate(zip(self._channels.output_names, self._shown, strict=True)):
            now = [*_around(expected[:, i], band[:, i]), measured[:, i]]
            then = _around(ahead[:, self._far, i], ahead_band[:, self._far, i])
            root = rr.new_entity_path(["outputs", name])
            self._draw(recording, f"{root}/now", time, unit.scale * np.stack(now, axis=-1), breaks)
            self._draw(recording, f"{root}/ahead", later, unit.scale * np.stack(then, axis=-1), breaks)

    def _judgement(self, recording: rr.RecordingStream, rows: list[Row]) -> None:
        """F(t), surprise and disturbance, at the times they are about; NaN parts them where windows are not whole."""
        estimates = [row.estimate for row in rows if row.estimate is not None]
        seen = np.array([estimate.seen for estimate in estimates]) + [row.shift for row in rows]
        surprise = np.array([estimate.surprise for estimate in estimates])
        pushed = np.array([_push(estimate, self._channels)[self._pushed] for estimate in estimates])
        energy = np.array([estimate.free_energy for estimate in estimates])
        self.bundles["free_energy_of_samples"].send(recording, seen, energy[:, None])
        self.bundles["disturbance"].send(recording, seen, pushed)
        self.bundles["surprise/samples"].send(recording, seen, np.stack([np.ones(len(seen)), surprise], axis=-1))
        unusual = surprise > UNUSUAL
        self.bundles["surprise/unusual"].send(recording, seen[unusual], surprise[unusual, None])


def pushed(channels: Channels) -> list[int]:
    """Which outputs' disturbances say what pushes the vehicle: those of rates, or all where no output is one.

    That an angle's rate is the rate is no news: what is left over there is the sensors' disagreement.
    """
    rates = [i for i, unit in enumerate(channels.output_units) if unit.endswith("/s")]
    return rates or list(range(len(channels.output_names)))


def far(channels: Channels) -> int:
    """Which of the horizons is shown: that nearest to ``FAR``."""
    return min(range(len(channels.horizons)), key=lambda i: abs(channels.horizons[i] * channels.dt - FAR))


def ahead_of(channels: Channels) -> str:
    """How far ahead that is, in words."""
    return f"{channels.horizons[far(channels)] * channels.dt:.2g} s"


def _push(estimate: Estimate, channels: Channels) -> Array:
    """(m,) what pushes each output beside the model, C w: the w of the first states, unless C is learnt."""
    if estimate.model is None:
        return np.full(len(channels.output_names), np.nan)
    return np.asarray(estimate.model.C @ estimate.disturbance)


def _of_estimates(rows: list[Row], part: Callable[[Estimate], Array], shape: tuple[int, ...]) -> Array:
    nothing = np.full(shape, np.nan)
    return np.array([nothing if row.estimate is None else part(row.estimate) for row in rows])


def _around(centre: Array, half: Array) -> list[Array]:
    return [centre - half, centre + half, centre]


def _bundles(channels: Channels, shown: list[Readable]) -> dict[str, Bundle]:
    """Every bundle but the model's, by path."""
    r = len(channels.input_names)
    bundles = [
        Bundle("inputs", channels.input_names, tuple(map(lines.distinct, range(r))), (1.5,) * r),
        Bundle("free_energy_of_samples", ("F(t)",), (lines.MEASURED,), (1.5,)),
        Bundle("surprise/samples", ("worst of 20", "surprise"), (lines.TRIVIAL, lines.MEASURED), (1.0, 1.5)),
        Bundle("surprise/unusual", ("unusual",), (ALARM,), (4.0,), marked=True),
        _disturbance(channels),
    ]
    for name in channels.output_names:
        root, ahead, soon = rr.new_entity_path(["outputs", name]), f"{ahead_of(channels)} ahead", "expected"
        bundles += [
            Bundle(f"{root}/ahead", (ahead,) * 3, (lines.FORECAST,) * 3, (0.6, 0.6, 1.5)),
            Bundle(
                f"{root}/now",
                (soon, soon, soon, "measured"),
                (*[lines.PREDICTED] * 3, lines.MEASURED),
                (0.6, 0.6, 4.0, 1.5),
            ),
        ]
    return {bundle.path: bundle for bundle in bundles}


def _disturbance(channels: Channels) -> Bundle:
    names = [named(channels.output_names[i], per_second(channels.output_units[i])) for i in pushed(channels)]
    colours = tuple(lines.distinct(i) for i in range(len(names)))
    return Bundle("disturbance", tuple(names), colours, (1.5,) * len(names))
