"""Timeline: what a flight did, as charts on one axis of time, which a page zooms together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import cycle
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mavdem.assessment import Assessment
from mavdem.confidence import Interval
from mavdem.dataset import phases
from mavdem.dataset.axes import AXES
from mavdem.dataset.segments import Segment, in_segments
from mavdem.dataset.setpoints import Setpoint, held_setpoint
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts.event import Event
from mavdem.report.charts.chart import TIME, Axis, Chart, Charts, Line, Mark, over_time
from mavdem.report.charts.model_charts import torque_line
from mavdem.report.numbers import TORQUE_UNIT, display_unit, without_remark
from mavdem.report.palette import (
    BAD,
    BASELINE,
    COMMAND,
    DISTINCT,
    DISTURBANCE,
    MEASURED,
    PREDICTED,
    TRUTH,
)
from mavdem.wind_velocity.compass import compass_text, speed_and_direction
from mavdem.wind_velocity.from_log import WindEvidence

if TYPE_CHECKING:
    from mavdem.live.history import LiveHistory

AROUND_SECONDS = 5.0  # s shown before arming and after disarming
ANGLE = display_unit("rad")


class Timeline(NamedTuple):
    """The ``rows`` of a flight in its ``span``, charts of one clock, s, and what goes through all of them.

    ``wind`` are further rows of a log: in m/s, its direction, and the torque. ``axes`` are angle, rate and the error of
    the rate, by axis. ``trained`` are the parts that the model was trained on, ``modes`` beginning, end and name of
    each flight mode, ``events`` what happened; ``position`` is the path (N, 3), m north, east and down.
    """

    rows: Charts
    span: Interval
    axes: Mapping[str, Charts] = MappingProxyType({})
    trained: tuple[Interval, ...] = ()
    modes: tuple[tuple[float, float, str], ...] = ()
    events: tuple[Event, ...] = ()
    position: TimeSeries | None = None
    wind: Charts = ()

    @property
    def happened(self) -> Charts:
        """The modes, and all rows with events and what was trained on."""
        strip = Chart("Modes", self._time, Axis(""), spans=self.modes, group="flight")
        return (*([strip] if self.modes else []), *map(self.marked, self.rows + self.wind))

    @property
    def _time(self) -> Axis:
        return TIME._replace(ends=self.span)

    def marked(self, chart: Chart) -> Chart:
        """Returns a ``chart`` of the flight in its span, with events and what was trained on."""
        marks = (
            Mark(event.seconds, colour=BAD if event.is_alarm else MEASURED)
            for event in self.events
            if np.isfinite(event.seconds)
        )
        spans = tuple((*part, "") for part in self.trained)
        return chart._replace(x=self._time, marks=tuple(marks), spans=spans)


def timeline_of(assessment: Assessment) -> Timeline | None:
    """Returns the timeline of the boot that was analysed, with a wind torque for each axis; None of what has no rows.

    The wind is shown where it is of the same boot, and so are events.
    """
    analysis = assessment.analysis
    evidence = assessment.evidence
    if analysis is None or evidence is None:
        return None
    signals = evidence.signals
    if not signals.tilts:
        return None
    tilt = signals.tilts[0]
    segments = analysis.learnability.segments
    boot = int(segments[0].boot if segments else np.bincount(tilt.boot, minlength=1).argmax())
    time = tilt.time[tilt.boot == boot]
    if len(time) < 2:
        return None
    armed = phases.armed_intervals(signals, boot) or [(-np.inf, np.inf)]
    first = max(time[0], armed[0][0] - AROUND_SECONDS)
    last = min(time[-1], armed[-1][1] + AROUND_SECONDS)
    part = Segment(boot, first, last)
    torques = (
        torque_line(analysis.learned, f"on {axis}", DISTURBANCE if axis == AXES[0] else COMMAND)
        for axis, analysis in assessment.analyses.items()
        if analysis.learned is not None
    )
    torque = over_time("Wind torque", TORQUE_UNIT.name, filter(None, torques))
    changes = signals.mode_changes(boot)
    ends_of_modes = zip(changes, [*changes[1:], (last, "")], strict=False)
    modes = ((max(at, first), min(end, last), name) for (at, name), (end, _) in ends_of_modes)
    events = (
        Event(fact.time, fact)
        for fact in assessment.events
        if fact.time is not None and fact.figures.get("boot", boot) == boot
    )
    position = signals.position
    return Timeline(
        tuple(row for row in _driven(signals, part) if row.lines),
        (first, last),
        {axis: tuple(_of_axis(signals.for_axis(axis), part)) for axis in AXES},
        tuple((flight.time[0], flight.time[-1]) for flight in analysis.flights),
        tuple(mode for mode in modes if mode[0] < mode[1]),
        tuple(events),
        position and _of(position, part),
        tuple(row for row in (*wind_rows(evidence.wind, part), torque) if row.lines),
    )


def _of(signal: TimeSeries, part: Segment) -> TimeSeries | None:
    """The ``part`` of a signal; None of one without."""
    rows = in_segments(signal, part, slack=0)
    if np.count_nonzero(rows) < 2:
        return None
    return signal.select(rows)


def _of_axis(signals: Signals, part: Segment) -> Iterator[Chart]:
    """Yields angle and rate with what was asked, and the error of the rate; what was not recorded is left out."""
    seen = signals.attitude
    if seen is None:
        return
    name = signals.axis
    rate, asked = signals.rate_and_setpoint or (seen.rate_series, None)
    # some firmware sends degrees
    scale = 1.0 if np.nanstd(rate.values) > 10 * np.nanstd(seen.rate) else ANGLE.scale
    angles = _beside(name, ANGLE.scale, seen.angle_series, signals.angle_setpoint, part)
    rates = _beside("rate", scale, rate, asked, part)
    title = name.capitalize()
    if angles:
        yield over_time(title, "°", angles)
    if rates:
        yield over_time(f"{title} rate", "°/s", rates)
    if len(rates) > 1:
        wanted, own = rates
        error = Line("error", DISTURBANCE, own.x, own.y - wanted.y)
        yield over_time(f"{title} rate error", "°/s", [error])


def _beside(
    name: str, scale: float, seen: TimeSeries, asked: TimeSeries | None, part: Segment
) -> list[Line]:
    """What was seen, after what was asked for."""
    if (own := _of(seen, part)) is None:
        return []
    lines = [Line(name, PREDICTED, own.time, scale * own.values)]
    if asked is not None:
        wanted = scale * held_setpoint(Setpoint("", "", "", asked), part.boot, own.time)
        if np.isfinite(wanted).any():
            lines.insert(0, Line("setpoint", TRUTH, own.time, wanted))
    return lines


def _driven(signals: Signals, part: Segment) -> Iterator[Chart]:
    """Yields height, motors and battery; without lines where they were not recorded."""
    yield over_time("Height", "m", _lines(signals.height, part, ["height"]))
    if (motors := signals.motors) is not None:
        percent = 100 * motors.scale.fraction(motors.outputs).clip(0.0)
        shares = TimeSeries(motors.time, motors.boot, percent)
        names = [without_remark(name) for name in motors.geometry.names]
        mean = shares.values.mean(axis=1, keepdims=True)
        apart = replace(shares, values=shares.values - mean)
        yield over_time("Motors", "%", _lines(shares, part, names))
        yield over_time("Motors minus their mean", "%", _lines(apart, part, names))
    yield over_time("Battery", "V", _lines(signals.voltage, part, ["battery"]))


def _lines(
    signal: TimeSeries | None,
    part: Segment,
    names: Sequence[str],
    colours: Sequence[str] = DISTINCT,
) -> Iterator[Line]:
    own = None if signal is None else _of(signal, part)
    if own is None:
        return
    columns = own.values.reshape(len(own.time), -1).T
    for name, colour, values in zip(names, cycle(colours), columns, strict=False):
        yield Line(name, colour, own.time, values)


def wind_rows(air: WindEvidence, part: Segment) -> Iterator[Chart]:
    """Yields speed and, where it is known, direction of the wind, with the autopilot's own estimates."""
    wind, own, _ = air
    if wind is None or wind.boot != part.boot:
        return
    mean = wind.direction if wind.direction_identifiable else 0.0
    speed, origin, half, turned = speed_and_direction(wind.velocity, wind.band, mean)
    courses = [
        ("Wind", "m/s", speed, half),
        (f"Wind from {compass_text(mean)}", "°", origin, turned),
    ]
    for row, (title, unit, line, width) in enumerate(
        courses[not wind.speed_identifiable : 1 + wind.direction_identifiable]
    ):
        least = np.maximum(line - width, 0.0 if line is speed else -np.inf)
        lines = [Line("wind", DISTURBANCE, wind.time, line, least, line + width)]
        if own is not None:
            theirs = speed_and_direction(own.values, 0 * own.values, mean)[row]
            signal = TimeSeries(own.time, own.boot, theirs)
            lines += _lines(signal, part, ["autopilot's own"], [BASELINE])
        yield over_time(title, unit, lines)


def live_timeline(history: LiveHistory, axis: str) -> Timeline | None:
    """Returns the timeline of a live flight: what was measured, predicted and estimated as it flew."""
    # Imported here: the timeline of a log needs nothing of live sessions.
    from mavdem.live.history import REPORTED_HORIZON

    rows = history.table
    segments, time, measured = rows.T[:3]
    if np.count_nonzero(np.isfinite(measured)) < 2:
        return None
    # Lines break where a segment begins.
    starts = np.flatnonzero(np.diff(segments)) + 1
    rows = np.insert(rows, starts, np.nan, axis=0)
    time = np.insert(time, starts, time[starts])
    _, _, measured, predicted, band, torque, torque_band, wind, wind_band, *outputs = rows.T
    least = np.maximum(wind - wind_band, 0.0)
    angles = (
        Line("measured", MEASURED, time, ANGLE.scale * measured),
        Line.around(
            f"{REPORTED_HORIZON:g} s ahead",
            PREDICTED,
            time,
            ANGLE.scale * predicted,
            ANGLE.scale * band,
        ),
    )
    motors = (
        Line(without_remark(name), colour, time, 100 * values.clip(0.0))
        for name, colour, values in zip(history.motor_names, cycle(DISTINCT), outputs, strict=False)
    )
    charts = (
        over_time(axis.capitalize(), ANGLE.name, angles),
        over_time("Motors", "%", motors),
        over_time(
            "Wind torque",
            TORQUE_UNIT.name,
            [
                Line.around(
                    f"on {axis}",
                    DISTURBANCE,
                    time,
                    TORQUE_UNIT.scale * torque,
                    TORQUE_UNIT.scale * torque_band,
                )
            ],
        ),
        over_time(
            "Wind now", "m/s", [Line("wind", DISTURBANCE, time, wind, least, wind + wind_band)]
        ),
    )
    charts_drawn = tuple(
        chart for chart in charts if any(np.isfinite(line.y).any() for line in chart.lines)
    )
    span = time[0], time[-1]
    return Timeline(
        charts_drawn, span, trained=tuple(history.learned_intervals), events=tuple(history.events)
    )
