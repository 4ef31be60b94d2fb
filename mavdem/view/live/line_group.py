"""LineGroup: several lines over the same times as one entity, which costs one chunk a batch."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from mavdem.report import palette
from mavdem.view.time_plot import FILL_WIDTH

Array = NDArray[np.float64]

BOOT_CLOCK = "boot clock"  # timeline, s; see ``live_view.Timeline``


@dataclass(frozen=True)
class LineGroup:
    """An entity of k lines, drawn in the order of the paths; a filled area is one line of upright strokes."""

    path: str  # of the entity
    names: tuple[str, ...]
    colours: tuple[str, ...]  # of the palette
    width: float = 1.5  # points
    marked: bool = False  # whether the values are drawn as markers, not joined
    filled: bool = False  # whether the values are the edges of an area

    def under(self, root: str) -> LineGroup:
        """The same below the entity ``root``, if that is not empty."""
        return replace(self, path=f"{root}/{self.path}") if root else self

    def send_style(self, recording: rr.RecordingStream) -> None:
        """Sends how the lines are drawn; once a recording."""
        names, colours = list(self.names), [palette.channels(colour) for colour in self.colours]
        widths = [FILL_WIDTH if self.filled else self.width] * len(names)
        style: rr.SeriesPoints | rr.SeriesLines
        if self.marked:
            style = rr.SeriesPoints(names=names, colors=colours, marker_sizes=widths, markers=["circle"] * len(names))
        else:
            # The mean of the values on one pixel would hide gusts.
            policy = rr.components.AggregationPolicy.Off if self.filled else rr.components.AggregationPolicy.MinMax
            style = rr.SeriesLines(names=names, colors=colours, widths=widths, aggregation_policy=policy)
        recording.log(self.path, style, static=True)

    def send(self, recording: rr.RecordingStream, time: Array, values: Array) -> None:
        """Sends values (N, k), or edges (N, 2), at times (N,), s of the boot clock; NaN breaks a line."""
        if not len(time):
            return
        if self.filled:
            time, values = np.repeat(time, 2), values.reshape(-1, 1)
        columns = rr.Scalars.columns(scalars=values.ravel()).partition([len(self.names)] * len(time))
        recording.send_columns(self.path, [rr.TimeColumn(BOOT_CLOCK, duration=time)], columns)
