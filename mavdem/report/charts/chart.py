"""Charts as data: lines, bands, marks and spectrograms, which pages draw with uPlot and notebooks with matplotlib.

A :class:`Chart` has lines of one unit over one axis, or a spectrogram. Charts of one ``group`` share their axis: they
are zoomed and read together. A :class:`Plan` is a drawing with axes of its own, such as a wind rose or a vehicle from
above. A :class:`Group` arranges both in columns of a page.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from itertools import chain
from math import ceil
from typing import NamedTuple

import numpy as np
from markupsafe import Markup

from mavdem.arrays import Array
from mavdem.containers import JsonValues, Names, Numbers
from mavdem.facts import Fact
from mavdem.facts.loops import SETTLING_BAND
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

MAX_BYTE = 255
"""Byte of the highest power of a spectrogram."""

MAX_SAMPLES_DRAWN_SINGLY = 3
"""Samples within two steps of a grid up to which a line is interpolated; of more, minimum and maximum are drawn."""


class LineStyle(StrEnum):
    """How a line is drawn."""

    LINE = "line"
    """A solid line."""

    BOLD = "bold"
    """A solid line of twice the width, which lies over others: what was measured beside what was asked for."""

    WIDE = "wide"
    """A wide solid line, which is seen below others where they are equal: what was measured beside predictions."""

    DASHES = "dashes"
    """A dashed line, for what was predicted or computed."""

    DOTS = "dots"
    """A dot for each value, with a whisker for its band."""

    SQUARES = "squares"
    """A square for each value, with a whisker for its band: the second of two sides beside the dots of the first."""

    JOINED_DOTS = "joined"
    """Dots with whiskers, joined by a thin line that is broken at unknown values."""

    STEMS = "stems"
    """A vertical line from 0 to each value, as correlations are drawn."""


class Tick(NamedTuple):
    """A tick of an axis with a name in the place of its number."""

    value: float
    """Where it is, in the unit of the axis."""

    name: str
    """What is written beside it."""


class Axis(NamedTuple):
    """One axis of a chart: its label with the unit, its scale and its limits."""

    label: str
    """What it shows, with its unit."""

    is_logarithmic: bool = False
    """Whether its scale is logarithmic."""

    limits: tuple[float | None, float | None] | None = None
    """Lowest and highest value shown; None where the lines decide."""

    names: Names = ()
    """Labels at 0, 1, 2, … where it counts things, such as motors."""

    addresses: Names = ()
    """Addresses of pages on these things, which a click opens; empty where there are none."""

    ticks: tuple[Tick, ...] = ()
    """Ticks with names, such as points of the compass; empty for ticks at round numbers."""

    has_gaps: bool = False
    """Whether a long step between two values means that samples are missing, as over the time of a flight."""

    @property
    def is_time(self) -> bool:
        """Whether it is a time in seconds."""
        return self.label.endswith("(s)")

    def as_json(self) -> JsonValues:
        """Returns the axis as JSON for ``charts.js``, the script that draws the charts of a page.

        Returns:
            The label, the names, the addresses and the ticks under their own names, the last two only if there are any;
            ``log``, whether the scale is logarithmic; and ``ends``, the limits, whose unknown end the script takes from
            the lines.
        """
        values: JsonValues = {
            "label": self.label,
            "log": self.is_logarithmic,
            "ends": self.limits,
            "names": self.names,
        }
        if any(self.addresses):
            values["addresses"] = self.addresses
        if self.ticks:
            values["ticks"] = self.ticks
        return values


TIME = Axis("time since boot (s)", has_gaps=True)
"""Time of a flight on the autopilot's boot clock."""

TIME_AFTER_STEP = Axis("time (s)")
"""Time from the beginning of a step response."""

STEP_RESPONSE = Axis("share of the step")
"""Response to a step of the setpoint."""

CLIP_SPANS = 0.25
"""Distance beyond other lines at which a line is clipped to them, in spans of their values: a choice."""

STEP_TIME_UNIT = 0.1
"""A chart of step responses ends at a multiple of this time, s: a choice."""

SETTLED_SHARE = 0.1
"""Largest deviation of a settled step response from its last value, as a share of that value: a choice."""

FREQUENCY = Axis("frequency (Hz)", is_logarithmic=True)
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

    lower_edge: Array | None = None
    """Lower edge of the band (N,)."""

    upper_edge: Array | None = None
    """Upper edge of the band (N,)."""

    style: LineStyle = LineStyle.LINE
    """How it is drawn."""

    is_on_right_axis: bool = False
    """Whether its values belong to the axis on the right of the chart."""

    remark: str = ""
    """What is written in its colour beside the title of a chart that counts things; empty for nothing."""

    bridged_gap: float = 0.0
    """A distance of two samples that is no gap however small the usual one is, in the unit of the axis."""

    @classmethod
    def with_band(
        cls,
        name: str,
        colour: str,
        x: Array,
        y: Array,
        half_width: Array,
        style: LineStyle = LineStyle.LINE,
    ) -> Line:
        """Returns a line with a band around it, from ``y - half_width`` to ``y + half_width``.

        Args:
            name: name in the legend.
            colour: colour from ``mavdem.report.palette``.
            x, y: abscissae and values (N,) each.
            half_width: (N,) half widths of the band, in the unit of ``y``.
            style: style in which the line is drawn.

        Returns:
            The line, with the lower and upper edge of its band.
        """
        return cls(
            name,
            colour,
            x,
            y,
            lower_edge=y - half_width,
            upper_edge=y + half_width,
            style=style,
        )

    @property
    def step(self) -> float:
        """The median distance between two samples, in the unit of the abscissae; infinite for a single sample."""
        if len(self.x) < 2:
            return np.inf
        return float(np.median(np.diff(self.x)))

    @property
    def longest_bridged_gap(self) -> float:
        """Distance of two samples beyond which the line has a gap, in the unit of the axis."""
        return max(MAX_GAP_STEPS * self.step, self.bridged_gap)

    def until(self, end: float) -> Line:
        """Returns the part of the line, and of its band, up to an abscissa.

        Args:
            end: last abscissa that is kept, in the unit of the line's abscissae.
        """
        count = int(np.searchsorted(self.x, end, side="right"))
        lower_edge = None if self.lower_edge is None else self.lower_edge[:count]
        upper_edge = None if self.upper_edge is None else self.upper_edge[:count]
        return self._replace(
            x=self.x[:count], y=self.y[:count], lower_edge=lower_edge, upper_edge=upper_edge
        )

    def clipped_to(self, lines: Iterable[Line]) -> Line:
        """Returns the line and its band clipped to the range of other lines, with a margin of ``CLIP_SPANS`` of it.

        A prediction that diverges would otherwise determine the range of the axis, on which the other lines are flat.

        Args:
            lines: lines that determine the range; without any finite value in them, nothing is clipped.
        """
        values_of_lines = np.concatenate([line.y[np.isfinite(line.y)] for line in lines])
        if not len(values_of_lines):
            return self
        lowest = values_of_lines.min()
        highest = values_of_lines.max()
        margin = CLIP_SPANS * (highest - lowest)
        limits = (lowest - margin, highest + margin)
        # A line without a band has no edges.
        lower_edge = None if self.lower_edge is None else np.clip(self.lower_edge, *limits)
        upper_edge = None if self.upper_edge is None else np.clip(self.upper_edge, *limits)
        return self._replace(
            y=np.clip(self.y, *limits), lower_edge=lower_edge, upper_edge=upper_edge
        )

    def resampled(self, grid: Array) -> Line:
        """Returns the line at the points of an even grid, without losing a peak.

        Values are interpolated linearly, and are NaN beyond the ends and in gaps, ``longest_bridged_gap``. Where
        many samples fall into a pair of grid points, these two get the minimum and the maximum of the samples, so that
        a short peak stays visible on a coarse grid.

        Args:
            grid: abscissae (M,), evenly spaced.

        Returns:
            A line with M samples; its band is interpolated too.
        """
        # The sample after each grid point; its distance from the one before shows whether the point lies in a gap.
        next_sample = np.clip(np.searchsorted(self.x, grid), 1, len(self.x) - 1)
        sample_distance = self.x[next_sample] - self.x[next_sample - 1]
        is_in_gap = sample_distance > self.longest_bridged_gap
        is_missing = is_in_gap | (grid < self.x[0]) | (grid > self.x[-1])

        def interpolated(values: Array) -> Array:
            """Returns values at the grid points, NaN where they are missing."""
            return np.where(is_missing, np.nan, np.interp(grid, self.x, values))

        y = self._with_extremes(grid, interpolated(self.y))
        lower_edge = None if self.lower_edge is None else interpolated(self.lower_edge)
        upper_edge = None if self.upper_edge is None else interpolated(self.upper_edge)
        return self._replace(x=grid, y=y, lower_edge=lower_edge, upper_edge=upper_edge)

    def _with_extremes(self, grid: Array, interpolated_y: Array) -> Array:
        """Replaces interpolated values by minima and maxima where many samples lie between two points of a grid.

        The points of the grid are taken in pairs: 0 and 1, 2 and 3, and so on. A pair stands for the samples in the two
        grid steps that begin at its first point. If these are many, the pair gets their minimum and their maximum, so
        that a peak stays visible: the maximum first if the last sample is below the first one, otherwise the minimum
        first. On the grid 0, 1, 2, 3, for example, the samples between 0 and 2 give the values at 0 and 1.

        Args:
            grid: abscissae (M,), evenly spaced.
            interpolated_y: (M,) values of the line, interpolated at these.

        Returns:
            (M,) values, with the extremes at crowded pairs: those with more than ``MAX_SAMPLES_DRAWN_SINGLY`` samples.
        """
        # The last grid step ends one step after the last point.
        end_of_grid = 2 * grid[-1] - grid[-2]
        # The index of the first sample of each pair and, last, the end of the samples of the last pair.
        pair_bounds = np.searchsorted(self.x, np.append(grid[::2], end_of_grid))
        # A last point without a partner is no pair.
        pair_count = len(grid) // 2
        sample_counts = np.diff(pair_bounds)[:pair_count]
        # Three samples may fall into one pair of grid points, even if there are no more samples than grid points.
        crowded_pairs = np.flatnonzero(sample_counts > MAX_SAMPLES_DRAWN_SINGLY)
        if not len(crowded_pairs):
            return interpolated_y
        # The bounds of empty pairs after the last sample are moved back to it, since ``reduceat`` needs valid indices.
        first_samples = np.minimum(pair_bounds[:-1], len(self.x) - 1)
        last_samples = pair_bounds[1:] - 1
        # ``reduceat`` takes the extreme from each first sample up to the next one; fmin and fmax pass over NaN.
        minimum = np.fmin.reduceat(self.y, first_samples)[crowded_pairs]
        maximum = np.fmax.reduceat(self.y, first_samples)[crowded_pairs]
        first_values = self.y[first_samples[crowded_pairs]]
        last_values = self.y[last_samples[crowded_pairs]]
        is_falling = last_values < first_values
        y = interpolated_y.copy()
        # The first grid point of each crowded pair; the second one follows it.
        first_points = 2 * crowded_pairs
        y[first_points] = np.where(is_falling, maximum, minimum)
        y[first_points + 1] = np.where(is_falling, minimum, maximum)
        return y


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


class Spectrogram(NamedTuple):
    """Power as a colour, over two axes with even steps."""

    x: Array
    """Abscissae (W,), such as times, s."""

    frequency: Array
    """Ordinates (F,), Hz."""

    power: Array
    """Power (W, F), dB."""


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

    level_names: Names = ()
    """What is written at the left end of each of these lines, which may be empty; without any, nothing is."""

    marks: tuple[Mark, ...] = ()
    """Vertical lines."""

    spans: tuple[Span, ...] = ()
    """Shaded parts of the horizontal axis."""

    spectrogram: Spectrogram | None = None
    """A spectrogram in the place of lines."""

    right_axis: Axis | None = None
    """Vertical axis on the right, of the lines that are ``is_on_right_axis``."""

    group: str = ""
    """Charts of the same group, unless empty, are zoomed together."""

    caption: str = ""
    """A line below it, such as where what it shows comes from; empty for none."""

    @property
    def description(self) -> str:
        """The chart in words, for screen readers: title, axes, and the range of each line with a finite value.

        An example is "Rates in °/s over time since boot (s): roll from -20 to 31.". A chart without such a line, such
        as a spectrogram, is called "a picture". The caption follows.
        """
        ranges = []
        for line in self.lines:
            text = _range_text(line)
            if text:
                ranges.append(text)
        unit = f" in {self.y.label}" if self.lines else ""
        content = "; ".join(ranges)
        if not ranges:
            content = "a picture"
        return f"{self.title}{unit} over {self.x.label}: {content}. {self.caption}".strip()

    def thinned(self, max_points: int) -> Chart:
        """Returns the chart with all lines on one common even grid of at most about ``max_points`` points.

        The script of a page draws lines over common abscissae, and many points make a page large. The grid has the step
        of the densest line, or the step at which ``max_points`` cover all lines, if that is larger.

        A chart stays as it is if its lines share their abscissae already, none has too many points, and no gap in time
        has to be broken.

        Args:
            max_points: number of points for each line.
        """
        if not self.lines or self._has_common_abscissae(max_points):
            return self
        start = min([line.x[0] for line in self.lines])
        end = max([line.x[-1] for line in self.lines])
        densest_step = min([line.step for line in self.lines])
        step = max(densest_step, (end - start) / max_points)
        step_count = int((end - start) / step)
        grid = start + step * np.arange(step_count + 1)
        resampled_lines = tuple(line.resampled(grid) for line in self.lines)
        return self._replace(lines=resampled_lines)

    def _has_common_abscissae(self, max_points: int) -> bool:
        """Returns whether all lines have the same abscissae, at most ``max_points``, and over time without a gap.

        Args:
            max_points: number of points that a line may have at most.
        """
        longest_line = max(self.lines, key=lambda line: len(line.x))
        if len(longest_line.x) > max_points:
            return False
        # The steps of log-spaced frequencies, for example, grow without a missing sample.
        longest_step = longest_line.longest_bridged_gap
        if self.x.has_gaps and (np.diff(longest_line.x) > longest_step).any():
            return False
        return all(np.array_equal(line.x, longest_line.x) for line in self.lines)

    def as_json(self, max_points: int) -> JsonValues:
        """Returns the chart as a JSON object, from which the script ``charts.js`` of a page draws it.

        Arrays are packed as 16-bit integers in base64 (see ``packed``), which keeps a page small. All lines are put on
        one grid of abscissae first, so that the grid is stored only once, under the key "at". A spectrogram replaces
        the lines: it becomes the only element of "lines", and "at" contains just its first and last abscissa, since its
        columns are evenly spaced.

        Args:
            max_points: approximate largest number of points of a line; longer lines are thinned.

        Returns:
            The fields of the chart by the keys that the script reads: "beside" is the vertical axis on the right, and
            "heat" is always null.
        """
        spectrogram = self.spectrogram
        packed_lines = []
        grid: Array | None = None
        if spectrogram is not None:
            packed_lines.append(_spectrogram_as_json(spectrogram))
            grid = np.array([spectrogram.x[0], spectrogram.x[-1]])
        else:
            for line in self.thinned(max_points).lines:
                # Only the left vertical axis may be logarithmic. Lines of the right one are packed as they are.
                is_logarithmic = self.y.is_logarithmic and not line.is_on_right_axis
                packed_lines.append(_line_as_json(line, is_logarithmic=is_logarithmic))
                grid = line.x
        is_grid_logarithmic = self.x.is_logarithmic
        return {
            "title": self.title,
            "x": self.x.as_json(),
            "y": self.y.as_json(),
            "beside": None if self.right_axis is None else self.right_axis.as_json(),
            "at": packed(
                grid, is_logarithmic=is_grid_logarithmic, may_be_even=not is_grid_logarithmic
            ),
            "lines": packed_lines,
            "levels": self.levels,
            "levelNames": self.level_names,
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

    track: JsonValues | None = None
    """Of a map: what the script ``page.js`` needs to follow the cursor of the charts; None of another drawing."""


class Note(NamedTuple):
    """Words in the place of a chart that cannot be drawn."""

    title: str
    """What is missing."""

    text: str
    """Why."""


Panel = Chart | Plan | Note
"""What a column of a page may hold."""

Charts = tuple[Chart, ...]


CAPTION_LETTERS = 30
"""Letters in a line of a caption below one of three charts side by side, on a screen of 1100 pixels."""


class Group(NamedTuple):
    """Panels of a page, in columns side by side where there is room."""

    columns: tuple[tuple[Panel, ...], ...]
    """The panels of each column, from top to bottom."""

    caption: str = ""
    """What stands below."""

    names: Names = ()
    """Names of the columns, such as axes. A phone, which has room for one column, opens one and closes the others to
    these names. Empty where all stay open."""

    first: str = ""
    """Name of the column that a phone opens and shows first; where none has this name it is the first column."""

    is_flat: bool = False
    """Whether charts over time are as low as those of a single column, although there are several columns."""

    columns_in_row: int | None = None
    """Columns side by side where there is room; None for all of them."""

    has_common_x: bool = False
    """Whether all charts of a column have one horizontal axis, which is drawn below the lowest chart alone."""

    @property
    def caption_lines(self) -> int:
        """Number of lines of the longest caption below a chart: all have so much room, so that rows are aligned."""
        lengths = [0]
        for panel in chain.from_iterable(self.columns):
            if isinstance(panel, Chart):
                lengths.append(len(panel.caption))
        return ceil(max(lengths) / CAPTION_LETTERS)

    @property
    def first_name(self) -> str:
        """Name of the only column that a phone, which has room for one, shows opened at first.

        It is the column that was chosen (``first``), otherwise the first one. Empty if the columns have no names, or if
        there is only one: then all are open.
        """
        if self.first in self.names:
            return self.first
        if len(self.names) > 1:
            return self.names[0]
        return ""

    @classmethod
    def of_axes(
        cls, columns: Mapping[str, Sequence[Panel]], light: Fact | None = None, caption: str = ""
    ) -> Group:
        """Returns the charts of several axes side by side, with one column for each axis.

        Args:
            columns: the charts and drawings of each axis, from top to bottom, by its name.
            light: the status light that the charts explain, that is the judgement of one part of the vehicle. Its
                figure "axis", or its subject, is the axis that decides it, which a phone shows first. None if the
                charts explain no light.
            caption: text below the charts.
        """
        deciding_axis = ""
        if light is not None:
            deciding_axis = str(light.figures.get("axis", light.subject))
        return cls(
            columns=tuple(tuple(panels) for panels in columns.values()),
            caption=caption,
            names=tuple(columns),
            first=deciding_axis,
        )

    @classmethod
    def side_by_side(cls, panels: Iterable[Panel | None], caption: str = "") -> Group:
        """Returns a group in which each chart or drawing has a column of its own.

        Args:
            panels: charts and drawings, from left to right; None, where there was nothing to draw, is left out.
            caption: text below them.
        """
        columns = [(panel,) for panel in panels if panel is not None]
        return cls(tuple(columns), caption)

    def folded_by_title(self) -> Group:
        """Returns the group with each column named by its first chart, so that a phone folds all columns but one."""
        return self._replace(names=tuple(column[0].title for column in self.columns))


def step_chart(title: str, steps: Sequence[Line]) -> Chart:
    """Makes a chart of step responses over the time after the step, s; a horizontal line at 1 is the setpoint.

    A chart ends after twice the time in which its slowest response settles, which differs much between vehicles: the
    rest would only compress the part in which the responses differ. It does not end before the largest overshoot of a
    response, if that exceeds ``SETTLING_BAND``. The time is rounded up to a multiple of ``STEP_TIME_UNIT``, so that
    similar axes are mostly compared on one scale. A response has settled when it stays within the fraction
    ``SETTLED_SHARE`` of its last value.

    Args:
        title: title of the chart.
        steps: responses to a step of 1, all of the same duration.
    """
    setpoint = 1.0
    # Charts of steps end at different times, so that each is zoomed by itself: it is a group of its own.
    chart = Chart(
        title, TIME_AFTER_STEP, STEP_RESPONSE, tuple(steps), levels=(setpoint,), group=title
    )
    longest_settling_time = 0.0
    latest_overshoot_time = 0.0
    for step in steps:
        last_value = step.y[-1]
        is_unsettled = abs(step.y - last_value) > SETTLED_SHARE * abs(last_value)
        # Time of the last sample that is not settled; 0 if all are.
        settling_time = float(step.x[is_unsettled].max(initial=0.0))
        longest_settling_time = max(longest_settling_time, settling_time)
        if step.y.max() > setpoint + SETTLING_BAND:
            latest_overshoot_time = max(latest_overshoot_time, float(step.x[step.y.argmax()]))
    if longest_settling_time == 0.0:
        return chart
    shown_time = max(2 * longest_settling_time, latest_overshoot_time)
    end = STEP_TIME_UNIT * ceil(shown_time / STEP_TIME_UNIT)
    return chart._replace(lines=tuple(step.until(end) for step in steps))


def over_time(title: str, unit: str, lines: Iterable[Line]) -> Chart:
    """Makes a chart of a flight over the boot clock.

    Args:
        title: title of the chart, which is also the label of the vertical axis.
        unit: unit of the lines.
        lines: lines over times, s.

    Returns:
        The chart; all such charts of a page are zoomed together.
    """
    return Chart(title, TIME, Axis(name_with_unit(title, unit)), tuple(lines), group="flight")


def _range_text(line: Line) -> str:
    """Returns the range of a line in words, such as "motor 1 from 1.00 to 4.00", for readers who do not see the chart.

    Args:
        line: the line; one without a name is called "values".

    Returns:
        The text; empty if the line has no finite value.
    """
    finite_values = line.y[np.isfinite(line.y)]
    if not len(finite_values):
        return ""
    name = line.name or "values"
    lowest = rounded(finite_values.min(), 3)
    highest = rounded(finite_values.max(), 3)
    return f"{name} from {lowest} to {highest}"


def _line_as_json(line: Line, *, is_logarithmic: bool) -> JsonValues:
    """Returns a line as a JSON object for ``charts.js``, with its values and the edges of its band packed.

    Args:
        line: the line. Its abscissae are left out ("x" is null), since all lines of a chart have the same.
        is_logarithmic: whether the vertical axis is logarithmic; then decimal logarithms are packed.
    """
    values: JsonValues = {}
    if line.remark:
        values["remark"] = line.remark
    return values | {
        "name": line.name,
        "colour": line.colour,
        "x": None,
        "y": packed(line.y, is_logarithmic=is_logarithmic),
        "low": packed(line.lower_edge, is_logarithmic=is_logarithmic),
        "high": packed(line.upper_edge, is_logarithmic=is_logarithmic),
        "kind": line.style,
        "right": line.is_on_right_axis,
    }


def _spectrogram_as_json(spectrogram: Spectrogram) -> JsonValues:
    """Returns a spectrogram as JSON: a byte for each value, from the lowest power (0) to the highest (255), in base64.

    The bytes come in rows of one abscissa each, as in ``Spectrogram.power``; "ends" are the first and the last
    frequency, and "range" is the power, dB, from the lowest to the highest.

    Args:
        spectrogram: the spectrogram, in dB.
    """
    power = spectrogram.power
    # The lower limit only avoids a division by zero where all power is the same.
    power_range = max(np.ptp(power), 1e-9)
    pixels = MAX_BYTE * (power - power.min()) / power_range
    return {
        "heat": b64encode(pixels.astype(np.uint8).tobytes()).decode(),
        "rows": len(spectrogram.x),
        "range": power_range,
        "ends": (spectrogram.frequency[0], spectrogram.frequency[-1]),
    }


def packed(
    values: Array | None, *, is_logarithmic: bool, may_be_even: bool = False
) -> JsonValues | None:
    """Packs an array into 16-bit integers: value = low + step · (integer + 32767), and −32768 is NaN.

    They take a quarter of the space of numbers as text, and resolve more than any screen. ``charts.js`` unpacks them.

    Args:
        values: (N,) the array; None gives None.
        is_logarithmic: whether the decimal logarithms of the values are packed instead.
        may_be_even: whether the values may be evenly spaced. If they are, only start, step and size are returned.

    Returns:
        The keys "low", "step" and "counts", the integers in base64; or "low", "step" and "size".
    """
    if values is None:
        return None
    if is_logarithmic:
        with np.errstate(divide="ignore", invalid="ignore"):
            values = np.log10(values)
    if may_be_even and len(values) > 1:
        step = values[1] - values[0]
        if np.allclose(np.diff(values), step):
            return {"low": values[0], "step": step, "size": len(values)}
    finite_values = values[np.isfinite(values)]
    if not len(finite_values):
        finite_values = np.zeros(1)
    low = float(finite_values.min())
    value_range = float(finite_values.max()) - low
    # Any step will do where all values are the same.
    step = value_range / MAX_COUNT or 1.0
    steps_above_lowest = np.rint((np.where(np.isfinite(values), values, np.nan) - low) / step)
    # The integer ``NO_VALUE`` stands for NaN, and the next one for the lowest value.
    integers = np.nan_to_num(steps_above_lowest + NO_VALUE + 1, nan=NO_VALUE)
    packed_bytes = integers.astype("<i2").tobytes()
    return {"low": low, "step": step, "counts": b64encode(packed_bytes).decode()}
