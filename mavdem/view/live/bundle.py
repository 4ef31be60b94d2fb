"""Bundle: several lines over the same times, as one entity: a chunk a batch, not one a line."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from mavdem.view.lines import Colour

Array = NDArray[np.float64]

BOOT_CLOCK = "boot clock"
"""Timeline, s; see :class:`mavdem.view.live.clock.Clock`."""


@dataclass(frozen=True)
class Bundle:
    """An entity of k lines.

    Attributes:
        path: its entity path.
        names, colours, widths: of each line, in the order they are drawn; widths in points. The legend counts those of
            one name and colour once.
        marked: whether the values are markers and not joined.
    """

    path: str
    names: tuple[str, ...]
    colours: tuple[Colour, ...]
    widths: tuple[float, ...]
    marked: bool = False

    def under(self, root: str) -> Bundle:
        """The same below another entity; an empty ``root`` is none."""
        return replace(self, path=f"{root}/{self.path}") if root else self

    def send_style(self, recording: rr.RecordingStream) -> None:
        """Says how the lines are drawn; once a recording."""
        names, colours, widths = list(self.names), list(self.colours), list(self.widths)
        if self.marked:
            points = rr.SeriesPoints(names=names, colors=colours, marker_sizes=widths, markers=["circle"] * len(names))
            recording.log(self.path, points, static=True)
        else:
            # Averaging what falls on one pixel would cut gusts off.
            policy = rr.components.AggregationPolicy.MinMax
            lines = rr.SeriesLines(names=names, colors=colours, widths=widths, aggregation_policy=policy)
            recording.log(self.path, lines, static=True)

    def send(self, recording: rr.RecordingStream, time: Array, values: Array) -> None:
        """Draws values (N, k) over times (N,), s of the boot clock; NaN parts a line."""
        if len(time):
            columns = rr.Scalars.columns(scalars=values.ravel()).partition([len(self.names)] * len(time))
            recording.send_columns(self.path, [rr.TimeColumn(BOOT_CLOCK, duration=time)], columns)


def estimate(path: str, name: str, colour: Colour) -> Bundle:
    """The edges of a band, thin, and what it is about."""
    return Bundle(path, (name,) * 3, (colour,) * 3, (0.6, 0.6, 2.5))
