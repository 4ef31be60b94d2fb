"""Charts as data: lines, bands, marks and spectrograms, which pages draw with uPlot and notebooks with matplotlib.

A :class:`Chart` has lines of one unit over one axis, or a spectrogram. Charts of one ``group`` share their axis: they
are zoomed and read together. A :class:`Plan` is a drawing with axes of its own, such as a wind rose or a vehicle from
above. A :class:`Group` arranges both in columns of a page.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from markupsafe import Markup

from mavdem.arrays import Array
from mavdem.containers import JsonValues, Names, Numbers
from mavdem.report.numbers import name_with_unit, rounded
from mavdem.report.palette import MEASURED

MAX_GAP_STEPS = 3.0
"""Longest gap between two samples that a line bridges, in usual steps of that line: one lost sample does not show."""

MAX_POINTS = 12_000
"""Points of a line on a page: ten minutes with all that autopilots log then stay within two megabytes."""

MAX_POINTS_OF_SMALL_PAGE = 2_000
"""Points of a line on a page of a fleet's flight, of which there are many."""

NO_VALUE = np.iinfo(np.int16).min
"""The 16-bit integer that stands for NaN in the data of a page."""

MAX_COUNT = 2**16 - 2
"""Steps that 16-bit integers can count, when one of them is kept for NaN."""

MAX_SAMPLES_DRAWN_SINGLY = 3
"""Samples within two steps of a grid up to which a line is interpolated; of more, minimum and maximum are drawn."""


class Kind(StrEnum):
    """How a line is drawn."""

    LINE = "line"
    """A solid line."""

    DASHES = "dashes"
    """A dashed line, for what was predicted or computed."""

    DOTS = "dots"
    """A dot for each value, with a whisker for its band."""

    STEMS = "stems"
    """A vertical line from 0 to each value, as correlations are drawn."""


class Axis(NamedTuple):
    """One axis of a chart."""

    label: str
    """What it shows, with its unit."""

    log: bool = False
    """Whether it is logarithmic."""

    ends: tuple[float | None, float | None] | None = None
    """Its limits; None where they are those of the lines."""

    names: Names = ()
    """Labels at 0, 1, 2, … where it counts things, such as motors."""


TIME = Axis("time since boot (s)")
"""Time of a flight on the autopilot's boot clock."""

TIME_AFTER_STEP = Axis("time (s)")
"""Time from the beginning of a step response."""

FREQUENCY = Axis("frequency (Hz)", log=True)
"""Frequency of responses and of spectral densities."""


class Line(NamedTuple):
    """A line of a chart, or dots or stems, with its 90 % band if there is one."""

    name: str
    """What the legend calls it."""

    colour: str
    """Colour from ``mavdem.report.palette``."""

    x: Array
    """Abscissae (N,), ascending."""

    y: Array
    """Values (N,); NaN where the line breaks."""

    low: Array | None = None
    """Lower end of the band (N,)."""

    high: Array | None = None
    """Upper end of the band (N,)."""

    kind: Kind = Kind.LINE
    """How it is drawn."""

    right: bool = False
    """Whether its values belong to the axis on the right of the chart."""

    @classmethod
    def with_band(
        cls,
        name: str,
        colour: str,
        x: Array,
        y: Array,
        half_width: Array,
        kind: Kind = Kind.LINE,
    ) -> Line:
        """Returns a line with a band around it, from ``y - half_width`` to ``y + half_width``.

        Args:
            name: what the legend calls it.
            colour: colour from ``mavdem.report.palette``.
            x, y: abscissae and values (N,).
            half_width: half width of the band (N,), in the unit of ``y``.
            kind: line, dots or stems.
        """
        return cls(name, colour, x, y, y - half_width, y + half_width, kind)

    @property
    def step(self) -> float:
        """The median distance between two samples; infinite for a single one."""
        return float(np.median(np.diff(self.x))) if len(self.x) > 1 else np.inf

    def resampled(self, grid: Array) -> Line:
        """Returns the line at the points of an even grid, without losing a peak.

        Values are interpolated linearly, and are NaN in gaps of more than ``MAX_GAP_STEPS`` and beyond the ends. Where
        many samples fall into a pair of grid points, these two get the minimum and the maximum of the samples, so that
        a short peak stays visible on a coarse grid.

        Args:
            grid: abscissae (M,), evenly spaced.

        Returns:
            A line with M samples; its band is interpolated too.
        """
        # The sample after each grid point; its distance from the one before shows whether the point lies in a gap.
        next_sample = np.clip(np.searchsorted(self.x, grid), 1, len(self.x) - 1)
        distance = self.x[next_sample] - self.x[next_sample - 1]
        is_missing = (
            (distance > MAX_GAP_STEPS * self.step) | (grid < self.x[0]) | (grid > self.x[-1])
        )

        def interpolated(values: Array) -> Array:
            return np.where(is_missing, np.nan, np.interp(grid, self.x, values))

        y = interpolated(self.y)
        self._keep_extremes(grid, y)
        low = None if self.low is None else interpolated(self.low)
        high = None if self.high is None else interpolated(self.high)
        return self._replace(x=grid, y=y, low=low, high=high)

    def _keep_extremes(self, grid: Array, y: Array) -> None:
        """Overwrites interpolated values by the extremes of the samples, where many fall into a pair of grid points.

        A pair of points stands for the interval of two grid steps that begins at its first point. It gets the minimum
        and the maximum of the samples in this interval: the maximum first where the samples fall from their first to
        their last, the minimum first otherwise.

        Args:
            grid: abscissae (M,), evenly spaced.
            y: values (M,) at these, which are changed in place.
        """
        # The last interval ends one step after the last point.
        end = 2 * grid[-1] - grid[-2]
        pair_starts = np.searchsorted(self.x, np.append(grid[::2], end))
        sample_counts = np.diff(pair_starts)[: len(grid) // 2]
        # With as many samples as grid points, three of them may fall into one pair.
        crowded = np.flatnonzero(sample_counts > MAX_SAMPLES_DRAWN_SINGLY)
        if not len(crowded):
            return
        # reduceat takes the extreme from each start up to the next; fmin and fmax pass over NaN.
        starts = np.minimum(pair_starts[:-1], len(self.x) - 1)
        minimum = np.fmin.reduceat(self.y, starts)[crowded]
        maximum = np.fmax.reduceat(self.y, starts)[crowded]
        is_falling = self.y[starts[crowded]] > self.y[pair_starts[crowded + 1] - 1]
        y[2 * crowded] = np.where(is_falling, maximum, minimum)
        y[2 * crowded + 1] = np.where(is_falling, minimum, maximum)


class Mark(NamedTuple):
    """A vertical line at one point of the horizontal axis, such as an event."""

    x: float
    """Where it is, in the unit of the axis."""

    name: str = ""
    """What is written beside it."""

    colour: str = MEASURED
    """Colour from ``mavdem.report.palette``."""


class Span(NamedTuple):
    """A shaded part of the horizontal axis, such as a flight mode."""

    start: float
    """Where it begins, in the unit of the axis."""

    end: float
    """Where it ends."""

    name: str = ""
    """What is written in it."""


class Heat(NamedTuple):
    """A spectrogram: values by colour over two even axes."""

    x: Array
    """Abscissae (W,)."""

    y: Array
    """Ordinates (F,), such as frequencies, Hz."""

    values: Array
    """Values (W, F), such as power, dB."""


class Chart(NamedTuple):
    """Lines over one horizontal axis, or a spectrogram; a chart of spans alone is a strip with their names."""

    title: str
    """What stands above it."""

    x: Axis
    """Horizontal axis."""

    y: Axis
    """Vertical axis on the left."""

    lines: tuple[Line, ...] = ()
    """Lines, drawn in this order."""

    levels: Numbers = ()
    """Ordinates of horizontal lines, such as limits."""

    marks: tuple[Mark, ...] = ()
    """Vertical lines."""

    spans: tuple[Span, ...] = ()
    """Shaded parts of the horizontal axis."""

    heat: Heat | None = None
    """A spectrogram in the place of lines."""

    right_axis: Axis | None = None
    """Vertical axis on the right, of those lines that are ``right``."""

    group: str = ""
    """Charts of the same group, unless empty, are zoomed together."""

    @property
    def description(self) -> str:
        """The chart in words, for screen readers: title, axes, and the range of each line with a finite value.

        An example is "Rates in °/s over time since boot (s): roll from -20 to 31.". A chart without such a line, such
        as a spectrogram, is called "a picture".
        """
        ranges = []
        for line in self.lines:
            text = _range_text(line)
            if text:
                ranges.append(text)
        unit = f" in {self.y.label}" if self.lines else ""
        return f"{self.title}{unit} over {self.x.label}: {'; '.join(ranges) or 'a picture'}."

    def thinned(self, max_points: int) -> Chart:
        """Returns the chart with all lines on one common even grid of at most about ``max_points`` points.

        The script of a page draws lines over common abscissae, and many points make a page large. The grid has the step
        of the densest line, or the step at which ``max_points`` cover all lines, if that is larger.

        A chart stays as it is if its lines share their abscissae already, none has too many points, and no gap in time
        has to be broken.
        """
        if not self.lines:
            return self
        longest = max(self.lines, key=lambda line: len(line.x))
        has_common_x = all(np.array_equal(line.x, longest.x) for line in self.lines)
        # Only over time does a long step mean missing samples; the steps of log-spaced frequencies grow anyway.
        is_over_time = self.x.label == TIME.label
        has_gaps = is_over_time and (np.diff(longest.x) > MAX_GAP_STEPS * longest.step).any()
        if has_common_x and not has_gaps and len(longest.x) <= max_points:
            return self
        first = min(line.x[0] for line in self.lines)
        last = max(line.x[-1] for line in self.lines)
        step = max(min(line.step for line in self.lines), (last - first) / max_points)
        grid = first + step * np.arange(int((last - first) / step) + 1)
        return self._replace(lines=tuple(line.resampled(grid) for line in self.lines))

    def as_json(self, max_points: int) -> JsonValues:
        """Returns the chart as a JSON object, from which the script ``charts.js`` of a page draws it.

        Arrays are packed as 16-bit integers in base64 (see ``_packed``), which keeps a page small. All lines are put on
        one grid of x values first, so that the grid is stored only once, under the key "at". A spectrogram takes the
        place of the lines: it becomes the only element of "lines", and "at" holds just its first and last x value,
        since its columns are evenly spaced.

        Args:
            max_points: number of points that a line has at most, about; longer lines are thinned.

        Returns:
            The fields of the chart by the keys that the script reads: "beside" is the vertical axis on the right, and
            "heat" is always null.
        """
        heat = self.heat
        if heat is not None:
            lines = [_heat_as_json(heat)]
            grid: Array | None = np.array([heat.x[0], heat.x[-1]])
        else:
            thinned_lines = self.thinned(max_points).lines
            # Only the left vertical axis may be logarithmic. Lines of the right one are packed as they are.
            lines = [_line_as_json(line, self.y.log and not line.right) for line in thinned_lines]
            grid = thinned_lines[0].x if thinned_lines else None
        return {
            "title": self.title,
            "x": self.x._asdict(),
            "y": self.y._asdict(),
            "beside": None if self.right_axis is None else self.right_axis._asdict(),
            "at": _packed(grid, self.x.log, is_even_grid=not self.x.log),
            "lines": lines,
            "levels": self.levels,
            "marks": self.marks,
            "spans": self.spans,
            "heat": None,
            "group": self.group,
        }


class Plan(NamedTuple):
    """A drawing with axes of its own, such as a wind rose."""

    title: str
    """What stands above it."""

    description: str
    """The drawing in words, for readers who do not see it."""

    svg: Markup
    """The drawing as an ``<svg>`` element."""


Panel = Chart | Plan
"""What a column of a page may hold."""

Charts = tuple[Chart, ...]


class Group(NamedTuple):
    """Panels of a page, in columns side by side where there is room."""

    columns: tuple[tuple[Panel, ...], ...]
    """The panels of each column, from top to bottom."""

    caption: str = ""
    """What stands below."""

    @classmethod
    def of(cls, panels: Iterable[Panel | None], caption: str = "") -> Group:
        """Returns a group with one column for each of the ``panels``; None among them is left out."""
        return cls(tuple((panel,) for panel in panels if panel is not None), caption)


def over_time(title: str, unit: str, lines: Iterable[Line]) -> Chart:
    """Returns a chart of a flight over the boot clock; all such charts of a page are zoomed together."""
    return Chart(title, TIME, Axis(name_with_unit(title, unit)), tuple(lines), group="flight")


def _range_text(line: Line) -> str:
    """Returns the range of a line in words, such as "motor 1 from 1.00 to 4.00"; empty without a finite value."""
    finite = line.y[np.isfinite(line.y)]
    if not len(finite):
        return ""
    return f"{line.name or 'values'} from {rounded(finite.min(), 3)} to {rounded(finite.max(), 3)}"


def _line_as_json(line: Line, is_log: bool) -> JsonValues:
    """Returns a line as a JSON object for ``charts.js``, with its values and the edges of its band packed.

    Args:
        line: the line. Its abscissae are left out ("x" is null), since all lines of a chart share those of the chart.
        is_log: whether the vertical axis is logarithmic; then decimal logarithms are packed.
    """
    return {
        **line._asdict(),
        "x": None,
        "y": _packed(line.y, is_log),
        "low": _packed(line.low, is_log),
        "high": _packed(line.high, is_log),
    }


def _heat_as_json(heat: Heat) -> JsonValues:
    """Returns a spectrogram as JSON: a byte for each value, from the lowest (0) to the highest (255), in base64.

    Values come in rows of one abscissa each, as they are in ``Heat.values``; "ends" are the first and the last
    ordinate.
    """
    levels = 255 * (heat.values - heat.values.min()) / max(np.ptp(heat.values), 1e-9)
    return {
        "heat": b64encode(levels.astype(np.uint8).tobytes()).decode(),
        "rows": len(heat.x),
        "ends": (heat.y[0], heat.y[-1]),
    }


def _packed(values: Array | None, is_log: bool, is_even_grid: bool = False) -> JsonValues | None:
    """Packs an array (N,) into 16-bit integers: value = low + step · (integer + 32767), and −32768 is NaN.

    They take a quarter of the room of numbers as text, and resolve more than any screen. ``charts.js`` unpacks them.

    Args:
        values: the array; None gives None.
        is_log: packs decimal logarithms of the values instead, for a logarithmic axis.
        is_even_grid: whether the values may be evenly spaced. If they are, only start, step and size are returned.

    Returns:
        The keys "low", "step" and "counts", the integers in base64; or "low", "step" and "size".
    """
    if values is None:
        return None
    if is_log:
        with np.errstate(divide="ignore", invalid="ignore"):
            values = np.log10(values)
    if is_even_grid and len(values) > 1:
        step = values[1] - values[0]
        if np.allclose(np.diff(values), step):
            return {"low": values[0], "step": step, "size": len(values)}
    is_finite = np.isfinite(values)
    finite = values[is_finite]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    step = (high - low) / MAX_COUNT or 1.0
    steps = (np.where(is_finite, values, np.nan) - low) / step
    counts = np.nan_to_num(np.rint(steps) + NO_VALUE + 1, nan=NO_VALUE)
    return {"low": low, "step": step, "counts": b64encode(counts.astype("<i2").tobytes()).decode()}
