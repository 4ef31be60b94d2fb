"""Charts: every picture of a page as data, which its script draws with uPlot, and matplotlib for Python users.

A :class:`Chart` has lines of one unit over one axis, with bands, marks and spans, or the heat of a spectrogram. Charts
of one ``group`` share their axis: they are zoomed and read together. A :class:`Plan` is a picture with axes of its own,
as a rose or a vehicle from above.
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

GAP_STEPS = 3.0  # usual steps of a line without a sample, beyond which it breaks
NO_VALUE = np.iinfo(np.int16).min
MAX_POINTS = 12_000
MAX_POINTS_OF_SMALL_PAGE = 2_000
"""Of a line: ten minutes with all that autopilots log stay within two megabytes; of a small page."""


class Kind(StrEnum):
    """How a line is drawn."""

    LINE = "line"
    DASHES = "dashes"
    DOTS = "dots"
    """With a whisker for its band."""
    STEMS = "stems"
    """From 0."""


class Axis(NamedTuple):
    """What an axis is of, with its unit, and its ``ends`` where they are not those of the lines.

    Of things that are counted there are ``names``, at 0, 1, 2 …
    """

    label: str
    log: bool = False
    ends: tuple[float | None, float | None] | None = None
    names: Names = ()


TIME = Axis("time since boot (s)")
TIME_AFTER_STEP = Axis("time (s)")
FREQUENCY = Axis("frequency (Hz)", log=True)


class Line(NamedTuple):
    """``y`` (N,) over ascending ``x`` (N,), NaN where it breaks, between the ends of its 90 % band, if any.

    One on the ``right`` has an axis of its own.
    """

    name: str
    colour: str
    x: Array
    y: Array
    low: Array | None = None
    high: Array | None = None
    kind: Kind = Kind.LINE
    right: bool = False

    @classmethod
    def around(
        cls, name: str, colour: str, x: Array, y: Array, half: Array, kind: Kind = Kind.LINE
    ) -> Line:
        """Returns a line with a band of this ``half`` width (N,)."""
        return cls(name, colour, x, y, y - half, y + half, kind)

    @property
    def step(self) -> float:
        """The usual distance between two samples."""
        return float(np.median(np.diff(self.x))) if len(self.x) > 1 else np.inf

    def at(self, grid: Array) -> Line:
        """Returns the line at an even ``grid`` (M,).

        Where several samples fall into two steps of it, these have the least and the largest: no peak is lost.
        """
        x = self.x
        after = np.clip(np.searchsorted(x, grid), 1, len(x) - 1)
        apart = x[after] - x[after - 1] > GAP_STEPS * self.step
        beyond = apart | (grid < x[0]) | (grid > x[-1])

        def between(values: Array) -> Array:
            return np.where(beyond, np.nan, np.interp(grid, x, values))

        middle = between(self.y)
        pairs = np.searchsorted(x, np.append(grid[::2], 2 * grid[-1] - grid[-2]))
        # Of as many samples as steps three may fall into two of them.
        several = np.flatnonzero(np.diff(pairs)[: len(grid) // 2] > 3)
        if len(several):
            starts = np.minimum(pairs[:-1], len(x) - 1)
            least, most = (
                extreme.reduceat(self.y, starts)[several] for extreme in (np.fmin, np.fmax)
            )
            falls = self.y[starts[several]] > self.y[pairs[several + 1] - 1]
            middle[2 * several] = np.where(falls, most, least)
            middle[2 * several + 1] = np.where(falls, least, most)
        low, high = (None if bound is None else between(bound) for bound in (self.low, self.high))
        return self._replace(x=grid, y=middle, low=low, high=high)


class Mark(NamedTuple):
    """What is at one place of the axis."""

    x: float
    name: str = ""
    colour: str = MEASURED


class Heat(NamedTuple):
    """``values`` (W, F) over ``x`` (W,) and ``y`` (F,), both even."""

    x: Array
    y: Array
    values: Array


class Chart(NamedTuple):
    """Lines over an axis ``x``; those of the right have the axis ``beside``.

    ``levels`` are drawn across, ``marks`` and ``spans`` (beginning, end and name) along. A chart of spans alone is a
    strip with their names.
    """

    title: str
    x: Axis
    y: Axis
    lines: tuple[Line, ...] = ()
    levels: Numbers = ()
    marks: tuple[Mark, ...] = ()
    spans: tuple[tuple[float, float, str], ...] = ()
    heat: Heat | None = None
    beside: Axis | None = None
    group: str = ""

    @property
    def said(self) -> str:
        """The chart in words, for those who do not see it."""
        drawn = filter(None, map(_said, self.lines))
        unit = f" in {self.y.label}" if self.lines else ""
        return f"{self.title}{unit} over {self.x.label}: {'; '.join(drawn) or 'a picture'}."

    def thinned(self, points: int) -> Chart:
        """Returns it with lines on one axis, at most about so many ``points`` of each."""
        if not self.lines:
            return self
        longest = max(self.lines, key=lambda line: len(line.x))
        alike = all(np.array_equal(line.x, longest.x) for line in self.lines)
        # Over time, what is far from its neighbours is apart; a line of frequencies grows apart by itself.
        steps = np.diff(longest.x)
        breaks = self.x.label == TIME.label and (steps > GAP_STEPS * longest.step).any()
        if alike and not breaks and len(longest.x) <= points:
            return self
        first = min(line.x[0] for line in self.lines)
        last = max(line.x[-1] for line in self.lines)
        step = max(min(line.step for line in self.lines), (last - first) / points)
        grid = first + step * np.arange(int((last - first) / step) + 1)
        return self._replace(lines=tuple(line.at(grid) for line in self.lines))

    def as_json(self, points: int) -> JsonValues:
        """Returns what the page's script draws, with values as 16-bit integers, base64."""
        thinned = self.thinned(points)
        lines = [
            line._asdict()
            | {
                key: _packed(getattr(line, key), self.y.log and not line.right)
                for key in ("y", "low", "high")
            }
            | {"x": None}
            for line in thinned.lines
        ]
        grid = thinned.lines[0].x if lines else None
        heat = self.heat
        if heat is not None:
            levels = 255 * (heat.values - heat.values.min()) / max(np.ptp(heat.values), 1e-9)
            grid = np.array([heat.x[0], heat.x[-1]])
            pixels = b64encode(levels.astype(np.uint8).tobytes()).decode()
            lines = [{"heat": pixels, "rows": len(heat.x), "ends": (heat.y[0], heat.y[-1])}]
        axes = {"x": self.x, "y": self.y, "beside": self.beside}
        return {
            **self._asdict(),
            **{name: axis and axis._asdict() for name, axis in axes.items()},
            "at": _packed(grid, self.x.log, even=not self.x.log),
            "lines": lines,
            "heat": None,
        }


class Plan(NamedTuple):
    """A picture as ``<svg>``, with its ``title`` and, ``said`` for those who do not see it, what it shows."""

    title: str
    said: str
    svg: Markup


Panel = Chart | Plan
Charts = tuple[Chart, ...]


class Group(NamedTuple):
    """Charts in ``columns`` beside each other, where there is room, with a ``caption``."""

    columns: tuple[tuple[Panel, ...], ...]
    caption: str = ""

    @classmethod
    def of(cls, panels: Iterable[Panel | None], caption: str = "") -> Group:
        """Returns a group with a column for each of the ``panels`` that there are."""
        return cls(tuple((panel,) for panel in panels if panel is not None), caption)


def over_time(title: str, unit: str, lines: Iterable[Line]) -> Chart:
    """Returns a chart of a flight over the boot clock, whose axis all such charts share."""
    return Chart(title, TIME, Axis(name_with_unit(title, unit)), tuple(lines), group="flight")


def _said(line: Line) -> str:
    """From where to where it goes."""
    finite = line.y[np.isfinite(line.y)]
    if not len(finite):
        return ""
    return f"{line.name or 'values'} from {rounded(finite.min(), 3)} to {rounded(finite.max(), 3)}"


def _packed(values: Array | None, log: bool, even: bool = False) -> JsonValues | None:
    """The least value, the step of what is counted in it, and the counts as 16-bit integers in base64.

    Of a ``log`` axis these are the logarithms; where steps are ``even`` there are no counts.
    """
    if values is None:
        return None
    if log:
        with np.errstate(divide="ignore", invalid="ignore"):
            values = np.log10(values)
    if even and len(values) > 1 and np.allclose(np.diff(values), values[1] - values[0]):
        return {"low": values[0], "step": values[1] - values[0], "size": len(values)}
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    step = (high - low) / (2**16 - 2) or 1.0
    shown = np.where(np.isfinite(values), values, np.nan)
    counts = np.nan_to_num(np.rint((shown - low) / step) + NO_VALUE + 1, nan=NO_VALUE)
    return {"low": low, "step": step, "counts": b64encode(counts.astype("<i2").tobytes()).decode()}
