"""Lines: the colours that mean the same thing in every view, and how a line reaches a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rerun as rr
from numpy.typing import ArrayLike, NDArray

FLIGHT_TIME = "flight time"
"""Timeline, s from the first training sample. Iterations are on it too, since all views of a recording follow one
timeline: so the learning is seen beside the flight."""
ITERATIONS_A_SECOND = 10
"""How many; a flight of some seconds is then as long as its learning."""
ITERATION = "iteration"
"""Timeline, the iterations of the learning; 0 is the prior."""

MEASURED = (225, 228, 232)
PREDICTED = (255, 159, 28)
FORECAST = (64, 201, 162)
BAND = (40, 112, 94)
TRIVIAL = (133, 141, 153)
BOUNDARY = (150, 90, 200)
DISTINCT = (
    (92, 157, 255),
    (255, 107, 107),
    (250, 208, 44),
    (94, 214, 120),
    (198, 120, 255),
    (72, 219, 219),
    (255, 146, 196),
    (201, 160, 112),
    (158, 180, 60),
)
"""For what has no meaning of its own but must be told apart; taken round and round."""

Colour = tuple[int, int, int]


def distinct(index: int) -> Colour:
    """The ``index``-th of the distinct colours."""
    return DISTINCT[index % len(DISTINCT)]


@dataclass(frozen=True)
class Line:
    """One entity of a recording: a line, or the two edges of a band.

    Attributes:
        path: its entity path.
        name: what the legend calls it.
        colour, width: as drawn; width in points.
    """

    path: str
    name: str
    colour: Colour
    width: float = 1.5

    def over_time(self, recording: rr.RecordingStream, time: ArrayLike, values: ArrayLike) -> None:
        """Draws values (N,), or band edges (N, 2), over flight time (N,), s."""
        self._draw(recording, [rr.TimeColumn(FLIGHT_TIME, duration=np.asarray(time, np.float64))], values)

    def over_iterations(self, recording: rr.RecordingStream, values: ArrayLike) -> None:
        """Draws values (I + 1,), or band edges (I + 1, 2), over the iterations from 0 on."""
        iteration = np.arange(len(np.asarray(values)))
        by_iteration = rr.TimeColumn(ITERATION, sequence=iteration)
        beside_flight = rr.TimeColumn(FLIGHT_TIME, duration=iteration / ITERATIONS_A_SECOND)
        self._draw(recording, [by_iteration, beside_flight], values)

    def _draw(self, recording: rr.RecordingStream, index: list[rr.TimeColumn], values: ArrayLike) -> None:
        table: NDArray[np.float64] = np.asarray(values, np.float64)
        edges = table.shape[1] if table.ndim == 2 else 1
        style = rr.SeriesLines(
            colors=[self.colour] * edges,
            names=[self.name] * edges,
            widths=[self.width] * edges,
            # Averaging what falls on one pixel would cut peaks off, and make a point of an upright line.
            aggregation_policy=rr.components.AggregationPolicy.Off,
        )
        recording.log(self.path, style, static=True)
        columns = rr.Scalars.columns(scalars=table.ravel())
        recording.send_columns(self.path, index, columns.partition([edges] * len(table)) if edges > 1 else columns)
