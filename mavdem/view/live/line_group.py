"""LineGroup: several lines over the same times as one entity, which costs one chunk a batch."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from mavdem.view.lines import Colour

Array = NDArray[np.float64]

BOOT_CLOCK = "boot clock"  # timeline, s; see ``live_view.Timeline``


@dataclass(frozen=True)
class LineGroup:
    """An entity of k lines, in the order of drawing; the legend shows lines of one name and colour once."""

    path: str  # of the entity
    names: tuple[str, ...]
    colours: tuple[Colour, ...]
    widths: tuple[float, ...]  # points
    marked: bool = False  # whether the values are drawn as markers, not joined

    def under(self, root: str) -> LineGroup:
        """The same below the entity ``root``, if that is not empty."""
        return replace(self, path=f"{root}/{self.path}") if root else self

    def send_style(self, recording: rr.RecordingStream) -> None:
        """Sends how the lines are drawn; once a recording."""
        names, colours, widths = list(self.names), list(self.colours), list(self.widths)
        style: rr.SeriesPoints | rr.SeriesLines
        if self.marked:
            style = rr.SeriesPoints(names=names, colors=colours, marker_sizes=widths, markers=["circle"] * len(names))
        else:
            # The mean of the values on one pixel would hide gusts.
            policy = rr.components.AggregationPolicy.MinMax
            style = rr.SeriesLines(names=names, colors=colours, widths=widths, aggregation_policy=policy)
        recording.log(self.path, style, static=True)

    def send(self, recording: rr.RecordingStream, time: Array, values: Array) -> None:
        """Sends values (N, k) at times (N,), s of the boot clock; NaN breaks a line."""
        if len(time):
            columns = rr.Scalars.columns(scalars=values.ravel()).partition([len(self.names)] * len(time))
            recording.send_columns(self.path, [rr.TimeColumn(BOOT_CLOCK, duration=time)], columns)


def band(path: str, name: str, colour: Colour, width: float) -> LineGroup:
    """A line of ``width`` points between two thin ones, the edges of its band."""
    return LineGroup(path, (name,) * 3, (colour,) * 3, (0.6, 0.6, width))


def around(centre: Array, half: Array) -> list[Array]:
    """The values of a ``band``."""
    return [centre - half, centre + half, centre]
