"""Timeline: what a flight did, as charts on one axis of time, which a page zooms together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, cycle
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mavdem.alignment import phases
from mavdem.alignment.drive import AXES, Signal
from mavdem.alignment.signals import Setpoint, Signals, attitude, held
from mavdem.analysis.findings import known_wind
from mavdem.assessment import Assessment
from mavdem.condition.wind_of_log import Air
from mavdem.condition.wind_velocity import by_compass, from_point
from mavdem.dem import Learned
from mavdem.dem.engine.linalg import Array
from mavdem.facts.event import Event
from mavdem.flight import Flight
from mavdem.report.charts import TIME, Axis, Chart, Line, Mark, over_time
from mavdem.report.numbers import TORQUE, readable, short
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

if TYPE_CHECKING:
    from mavdem.live.history import LiveHistory

AROUND = 5.0  # s shown before arming and after disarming
ANGLE = readable("rad")


class Timeline(NamedTuple):
    """The ``rows`` of a flight in its ``span``, charts of one clock, s, and what goes through all of them.

    ``axes`` are angle, rate and the error of the rate, by axis. ``trained`` are the parts that the model was trained
    on, ``modes`` beginning, end and name of each flight mode, ``events`` what happened; ``position`` is the path
    (N, 3), m north, east and down.
    """

    rows: tuple[Chart, ...]
    span: tuple[float, float]
    axes: Mapping[str, tuple[Chart, ...]] = MappingProxyType({})
    trained: tuple[tuple[float, float], ...] = ()
    modes: tuple[tuple[float, float, str], ...] = ()
    events: tuple[Event, ...] = ()
    position: Signal | None = None

    @property
    def happened(self) -> tuple[Chart, ...]:
        """The modes, and all rows with events and what was trained on."""
        strip = Chart("Modes", self._time, Axis(""), spans=self.modes, group="flight")
        return (*([strip] if self.modes else []), *map(self.marked, self.rows))

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
        lines = tuple(filter(None, (_within(line, self.span) for line in chart.lines)))
        return chart._replace(x=self._time, lines=lines, marks=tuple(marks), spans=spans)


def _within(line: Line, span: tuple[float, float]) -> Line | None:
    """The part of a line in a span; None of one without."""
    rows = slice(*np.searchsorted(line.x, (span[0], np.nextafter(span[1], np.inf))))
    if len(line.x[rows]) < 2:
        return None
    low, high = (None if one is None else one[rows] for one in (line.low, line.high))
    return line._replace(x=line.x[rows], y=line.y[rows], low=low, high=high)


def timeline_of(assessment: Assessment) -> Timeline | None:
    """Returns the timeline of the boot that was analysed, with a wind torque for each axis; None of what has no rows.

    The wind is shown where it is of the same boot, and so are events.
    """
    analysis = assessment.analysis
    evidence = assessment.evidence
    if analysis is None or evidence is None:
        return None
    signals = evidence.signals
    if (tilt := attitude(signals.telemetry, AXES[0])) is None:
        return None
    segments = analysis.verdict.segments
    boot = int(segments[0].boot if segments else np.bincount(tilt.boot, minlength=1).argmax())
    torques = (
        line
        for name, one in assessment.analyses.items()
        for line in torque_lines(name, one.learned, one.flights)
    )
    known = (
        *_driven(signals, boot),
        *wind_rows(evidence.air, boot),
        over_time("Wind torque", TORQUE.name, torques),
    )
    axes = {axis: tuple(_of_axis(signals.about(axis), boot)) for axis in AXES}
    rows = tuple(row for row in known if row.lines)
    shown = [line.x for row in (*rows, *chain(*axes.values())) for line in row.lines]
    if not shown:
        return None
    armed = phases.armed(signals, boot) or [(-np.inf, np.inf)]
    first = max(min(float(time[0]) for time in shown), armed[0][0] - AROUND)
    last = min(max(float(time[-1]) for time in shown), armed[-1][1] + AROUND)
    changes = signals.modes(boot)
    ends_of_modes = zip(changes, [*changes[1:], (last, "")], strict=False)
    modes = ((max(at, first), min(end, last), name) for (at, name), (end, _) in ends_of_modes)
    place = signals.position
    return Timeline(
        rows,
        (first, last),
        axes,
        tuple((float(flight.time[0]), float(flight.time[-1])) for flight in analysis.flights),
        tuple(mode for mode in modes if mode[0] < mode[1]),
        events_of(assessment, boot),
        place and _of(place, boot),
    )


def events_of(assessment: Assessment, boot: int) -> tuple[Event, ...]:
    """Returns what happened in a ``boot``, and when, in order."""
    return tuple(
        Event(fact.time, fact)
        for fact in assessment.events
        if fact.time is not None and fact.figures.get("boot", boot) == boot
    )


def _of(signal: Signal, boot: int) -> Signal | None:
    """The part of a ``boot``; None of one without."""
    rows = signal.boot == boot
    return (
        Signal(signal.time[rows], signal.boot[rows], signal.values[rows])
        if np.count_nonzero(rows) > 1
        else None
    )


def _of_axis(signals: Signals, boot: int) -> Iterator[Chart]:
    """Yields angle and rate with what was asked, and the error of the rate; what was not recorded is left out."""
    seen = signals.attitude
    if seen is None:
        return
    axis = signals.axis
    scale = ANGLE.scale
    yield from _beside(axis.capitalize(), "°", axis, seen.angles, signals.asked, boot, scale)
    rate, asked = signals.rates or (seen.rates, None)
    if np.nanstd(rate.values) > 10 * np.nanstd(seen.rate):  # that firmware sends degrees
        scale = 1.0
    title = f"{axis.capitalize()} rate"
    yield from _beside(title, "°/s", "rate", rate, asked, boot, scale)
    if asked is not None and (own := _of(rate, boot)) is not None:
        wanted = held(Setpoint("", "", "", asked), boot, own.time)
        error = Line("error", DISTURBANCE, own.time, scale * (own.values - wanted))
        if np.isfinite(error.y).any():
            yield over_time(f"{title} error", "°/s", [error])


def _beside(
    title: str, unit: str, name: str, seen: Signal, asked: Signal | None, boot: int, scale: float
) -> Iterator[Chart]:
    """Yields what was seen beside what was asked for."""
    if (own := _of(seen, boot)) is None:
        return
    lines = [Line(name, PREDICTED, own.time, scale * own.values)]
    if asked is not None:
        wanted = scale * held(Setpoint("", "", "", asked), boot, own.time)
        if np.isfinite(wanted).any():
            lines.insert(0, Line("setpoint", TRUTH, own.time, wanted))
    yield over_time(title, unit, lines)


def _driven(signals: Signals, boot: int) -> Iterator[Chart]:
    """Yields height, motors and battery; without lines where they were not recorded."""
    height, volts = signals.height, signals.voltage
    if height is not None:
        yield over_time("Height", "m", _lines(height, boot, ["height"]))
    if (motors := signals.motors) is not None:
        shares = Signal(motors.time, motors.boot, 100 * motors.scale.fraction(motors.outputs))
        names = [short(name) for name in motors.layout.names]
        mean = shares.values.mean(axis=1, keepdims=True)
        apart = replace(shares, values=shares.values - mean)
        yield over_time("Motors", "%", _lines(shares, boot, names))
        yield over_time("Motors, less their mean", "%", _lines(apart, boot, names))
    if volts is not None:
        yield over_time("Battery", "V", _lines(volts, boot, ["battery"]))


def _lines(
    signal: Signal, boot: int, names: Sequence[str], colours: Sequence[str] = DISTINCT
) -> Iterator[Line]:
    if (own := _of(signal, boot)) is None:
        return
    columns = own.values.reshape(len(own.time), -1).T
    for name, colour, values in zip(names, cycle(colours), columns, strict=False):
        yield Line(name, colour, own.time, values)


def torque_lines(axis: str, learned: Learned | None, flights: Sequence[Flight]) -> Iterator[Line]:
    """Yields the wind torque on an ``axis`` of the ``flights`` that a model was learned from; none if not known."""
    wind = None if learned is None else known_wind(learned.wind_torque, learned.physical)
    if wind is not None and len(wind.torque) == sum(map(len, flights)):
        colour = COMMAND if axis in AXES[1:] else DISTURBANCE
        starts = np.cumsum([len(flight) for flight in flights])[:-1]
        time = np.concatenate([flight.time for flight in flights])
        both = TORQUE.scale * wind.torque, TORQUE.scale * wind.band
        yield _broken(starts, time, f"on {axis}", colour, *both)


def _broken(
    starts: Any, time: Array, name: str, colour: str, values: Array, half: Array | None = None
) -> Line:
    """A line with a band of this ``half`` width that breaks before each of the samples ``starts``."""
    gaps = np.insert(values, starts, np.nan)
    line = Line(name, colour, np.insert(time, starts, time[starts]), gaps)
    if half is None:
        return line
    around = np.insert(half, starts, np.nan)
    return line._replace(low=gaps - around, high=gaps + around)


def wind_rows(air: Air, boot: int) -> Iterator[Chart]:
    """Yields speed and, where it is known, direction of the wind in a ``boot``, with the autopilot's own estimates."""
    wind, own, _ = air
    if wind is None or wind.boot != boot:
        return
    mean = wind.direction if wind.directed else 0.0
    speed, origin, half, turned = by_compass(wind.velocity, wind.band, mean)
    courses = [("Wind", "m/s", speed, half), (f"Wind from {from_point(mean)}", "°", origin, turned)]
    for part, (title, unit, line, width) in enumerate(courses[not wind.sized : 1 + wind.directed]):
        lines = [Line("wind", DISTURBANCE, wind.time, line, line - width, line + width)]
        if own is not None:
            theirs = Signal(own.time, own.boot, by_compass(own.values, 0 * own.values, mean)[part])
            lines += _lines(theirs, boot, ["autopilot's own"], [BASELINE])
        yield over_time(title, unit, lines)


def live_timeline(history: LiveHistory, axis: str) -> Timeline | None:
    """Returns the timeline of a live flight: what was measured, predicted and estimated as it flew."""
    # Imported here: the timeline of a log needs nothing of live sessions.
    from mavdem.live.history import AHEAD

    segments, time, measured, *others = history.rows.T
    if np.count_nonzero(np.isfinite(measured)) < 2:
        return None
    line = partial(_broken, np.flatnonzero(np.diff(segments)) + 1, time)
    (predicted, band, torque, torque_band, *air) = others[:6]
    ahead = ANGLE.scale * predicted, ANGLE.scale * band
    around = TORQUE.scale * torque, TORQUE.scale * torque_band
    angles = (
        line("measured", MEASURED, ANGLE.scale * measured),
        line(f"{AHEAD:g} s ahead", PREDICTED, *ahead),
    )
    motors = (
        line(short(name), colour, 100 * values)
        for name, colour, values in zip(history.motors, cycle(DISTINCT), others[6:], strict=False)
    )
    rows = (
        over_time(axis.capitalize(), ANGLE.name, angles),
        over_time("Motors", "%", motors),
        over_time("Wind torque", TORQUE.name, [line(f"on {axis}", DISTURBANCE, *around)]),
        over_time("Wind", "m/s", [line("wind", DISTURBANCE, *air)]),
    )
    known = tuple(row for row in rows if any(np.isfinite(one.y).any() for one in row.lines))
    span = float(time[0]), float(time[-1])
    return Timeline(known, span, trained=tuple(history.learned), events=tuple(history.events))
