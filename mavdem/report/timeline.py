"""Timeline: what a flight did, in rows on one axis of time, for the page's zoomable plots and for its still picture."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import cycle
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mavdem.alignment import phases
from mavdem.alignment.drive import AXES, Signal
from mavdem.alignment.signals import Signals, attitude, held, setpoints
from mavdem.analysis.findings import known_wind
from mavdem.assessment import Assessment
from mavdem.condition.wind_of_log import Air
from mavdem.condition.wind_velocity import by_compass, from_point
from mavdem.dem import Learned
from mavdem.dem.engine.linalg import Array
from mavdem.facts.event import Event
from mavdem.flight import Flight
from mavdem.report import palette
from mavdem.report.numbers import TORQUE, named, readable

if TYPE_CHECKING:
    from mavdem.live.history import LiveHistory

GAP_STEPS = 3.0  # usual steps of a line without a sample, beyond which it breaks
AROUND = 5.0  # s shown before arming and after disarming
NO_VALUE = -(2**15)
ANGLE = readable("rad")


class Line(NamedTuple):
    """``values`` (N,) over ``time`` (N,), s, NaN where it breaks, and the half width of their 90 % band, if any."""

    name: str
    colour: str
    time: Array
    values: Array
    half: Array | None = None

    @property
    def step(self) -> float:
        """The usual time between two samples, s."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else np.inf

    def at(self, grid: Array) -> Array:
        """Returns (2, M): values and half widths at times of an even ``grid`` (M,).

        Where several samples fall into two steps of it, these have the least and the largest: no peak is lost.
        """
        after = np.clip(np.searchsorted(self.time, grid), 1, len(self.time) - 1)
        apart = self.time[after] - self.time[after - 1] > GAP_STEPS * self.step
        bands = 0 * self.time if self.half is None else self.half
        found, half = (np.interp(grid, self.time, one) for one in (self.values, bands))
        found[apart | (grid < self.time[0]) | (grid > self.time[-1])] = np.nan
        pairs = np.searchsorted(self.time, np.append(grid[::2], 2 * grid[-1] - grid[-2]))
        several = np.flatnonzero(np.diff(pairs)[: len(grid) // 2] > 2)
        if len(several):
            starts = np.minimum(pairs[:-1], len(self.time) - 1)
            low, high = (one.reduceat(self.values, starts)[several] for one in (np.fmin, np.fmax))
            falls = self.values[starts[several]] > self.values[pairs[several + 1] - 1]
            found[2 * several], found[2 * several + 1] = np.where(falls, (high, low), (low, high))
        return np.array([found, half])


class Row(NamedTuple):
    """Lines of one unit."""

    title: str
    unit: str
    lines: tuple[Line, ...]


class Timeline(NamedTuple):
    """The ``rows`` of a flight in its ``span``, and what goes through all of them, in s of one clock.

    ``trained`` are the parts that the model was trained on, ``modes`` beginning, end and name of each flight mode,
    ``events`` what happened; ``position`` is the path (N, 3), m north, east and down.
    """

    rows: tuple[Row, ...]
    span: tuple[float, float]
    trained: tuple[tuple[float, float], ...] = ()
    modes: tuple[tuple[float, float, str], ...] = ()
    events: tuple[Event, ...] = ()
    position: Signal | None = None

    def thinned(self, points: int) -> Iterator[tuple[Row, Array, list[Array]]]:
        """Yields each row with its times (M,), at most about so many ``points``, and of each line (2, M) as of it."""
        first, last = self.span
        for row in self.rows:
            step = max(min(line.step for line in row.lines), (last - first) / points)
            grid = np.asarray(first + step * np.arange(int((last - first) / step) + 1), np.float64)
            yield row, grid, [line.at(grid) for line in row.lines]

    def as_json(self, points: int) -> dict[str, Any]:
        """Returns what the page's script draws, with values as 16-bit integers, base64."""
        rows = [
            {
                "title": named(row.title, row.unit),
                "times": (float(grid[0]), float(np.ptp(grid[:2]))),
                "lines": [
                    (
                        line.name,
                        line.colour,
                        _packed(mean),
                        None if line.half is None else _packed(half),
                    )
                    for line, (mean, half) in zip(row.lines, found, strict=True)
                ],
            }
            for row, grid, found in self.thinned(points)
        ]
        events = [
            (event.seconds, event.is_alarm) for event in self.events if np.isfinite(event.seconds)
        ]
        return {
            "span": self.span,
            "modes": self.modes,
            "events": events,
            "trained": self.trained,
            "rows": rows,
        }


def _packed(values: Array) -> tuple[float, float, str]:
    """The least value, the step of what is counted in it, and the counts as 16-bit integers in base64."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    step = (high - low) / (2**16 - 2) or 1.0
    counts = np.nan_to_num(np.rint((values - low) / step) + NO_VALUE + 1, nan=NO_VALUE)
    return low, step, b64encode(counts.astype("<i2").tobytes()).decode()


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
    torques = tuple(
        line
        for name, one in assessment.analyses.items()
        for line in torque_lines(name, one.learned, one.flights)
    )
    known = (
        *_driven(signals, boot),
        Row("Wind torque", TORQUE.name, torques),
        *wind_rows(evidence.air, boot),
        *_rest(signals, boot),
    )
    if not (rows := tuple(row for row in known if row.lines)):
        return None
    armed = phases.armed(signals, boot) or [(-np.inf, np.inf)]
    ends = min(row.lines[0].time[0] for row in rows), max(row.lines[0].time[-1] for row in rows)
    span = float(max(ends[0], armed[0][0] - AROUND)), float(min(ends[1], armed[-1][1] + AROUND))
    changes = signals.modes(boot)
    ends_of_modes = zip(changes, [*changes[1:], (span[1], "")], strict=False)
    modes = [(max(at, span[0]), min(end, span[1]), name) for (at, name), (end, _) in ends_of_modes]
    trained = tuple((float(flight.time[0]), float(flight.time[-1])) for flight in analysis.flights)
    place = signals.position
    flown = tuple(mode for mode in modes if mode[0] < mode[1])
    return Timeline(
        rows, span, trained, flown, events_of(assessment, boot), place and _of(place, boot)
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


def _driven(signals: Signals, boot: int) -> Iterator[Row]:
    """Attitude with setpoint by axis, and motors; without lines where they were not recorded."""
    for axis in AXES:
        lines = list[Line]()
        if (found := attitude(signals.telemetry, axis)) is not None and np.count_nonzero(
            rows := found.boot == boot
        ) > 1:
            time = found.time[rows]
            angle = ANGLE.scale * found.angle[rows]
            if axis == "yaw":
                turned = np.exp(1j * found.angle[rows])
                mean = np.angle(turned.mean())  # the cut is opposite of it
                angle = ANGLE.scale * (np.angle(turned * np.exp(-1j * mean)) + mean % (2 * np.pi))
                angle[np.flatnonzero(np.abs(np.diff(angle)) > 180)] = np.nan
            asked = (
                one for one in setpoints(signals.telemetry, axis) if one.name == f"{axis} setpoint"
            )
            wanted = [ANGLE.scale * held(one, boot, time) for one in asked]
            lines = [Line(axis, palette.PREDICTED, time, angle)]
            lines += [
                Line("setpoint", palette.TRUTH, time, one)
                for one in wanted
                if np.isfinite(one).any()
            ]
        yield Row(axis.capitalize(), ANGLE.name, tuple(lines))
    if (motors := signals.motors) is not None:
        shares = Signal(motors.time, motors.boot, 100 * motors.scale.fraction(motors.outputs))
        yield Row("Motors", "%", _lines(shares, boot, motors.layout.names))


def _rest(signals: Signals, boot: int) -> Iterator[Row]:
    """Height and battery."""
    for title, unit, signal in (("Height", "m", signals.height), ("Battery", "V", signals.voltage)):
        if signal is not None:
            yield Row(title, unit, _lines(signal, boot, [title.lower()]))


def _lines(
    signal: Signal, boot: int, names: Sequence[str], colours: Sequence[str] = palette.DISTINCT
) -> tuple[Line, ...]:
    if (own := _of(signal, boot)) is None:
        return ()
    columns = zip(names, cycle(colours), own.values.reshape(len(own.time), -1).T, strict=False)
    return tuple(Line(name, colour, own.time, values) for name, colour, values in columns)


def torque_lines(axis: str, learned: Learned | None, flights: Sequence[Flight]) -> Iterator[Line]:
    """Yields the wind torque on an ``axis`` of the ``flights`` that a model was learned from; none if not known."""
    wind = None if learned is None else known_wind(learned.wind_torque, learned.physical)
    if wind is not None and len(wind.torque) == sum(map(len, flights)):
        colour = palette.COMMAND if axis in AXES[1:] else palette.DISTURBANCE
        starts = np.cumsum([len(flight) for flight in flights])[:-1]
        time = np.concatenate([flight.time for flight in flights])
        both = TORQUE.scale * wind.torque, TORQUE.scale * wind.band
        yield _broken(starts, time, f"on {axis}", colour, *both)


def _broken(
    starts: Any, time: Array, name: str, colour: str, values: Array, half: Array | None = None
) -> Line:
    """A line that breaks before each of the samples ``starts``."""
    around = None if half is None else np.insert(half, starts, np.nan)
    return Line(
        name,
        colour,
        np.insert(time, starts, time[starts]),
        np.insert(values, starts, np.nan),
        around,
    )


def wind_rows(air: Air, boot: int) -> Iterator[Row]:
    """Yields speed and, where it is known, direction of the wind in a ``boot``, with the autopilot's own estimates."""
    wind, own, _ = air
    if wind is None or wind.boot != boot:
        return
    mean = wind.direction if wind.directed else 0.0
    speed, origin, half, turned = by_compass(wind.velocity, wind.band, mean)
    courses = [("Wind", "m/s", speed, half), (f"Wind from {from_point(mean)}", "°", origin, turned)]
    for part, (title, unit, line, width) in enumerate(courses[not wind.sized : 1 + wind.directed]):
        lines: tuple[Line, ...] = (Line("wind", palette.DISTURBANCE, wind.time, line, width),)
        if own is not None:
            theirs = Signal(own.time, own.boot, by_compass(own.values, 0 * own.values, mean)[part])
            lines += _lines(theirs, boot, ["autopilot's own"], [palette.BASELINE])
        yield Row(title, unit, lines)


def live_timeline(history: LiveHistory, axis: str) -> Timeline | None:
    """Returns the timeline of a live flight: what was measured, predicted and estimated as it flew."""
    # Imported here: the timeline of a log needs nothing of live sessions.
    from mavdem.live.history import AHEAD

    segments, time, measured, *others = history.rows.T
    if np.count_nonzero(np.isfinite(measured)) < 2:
        return None
    gaps = np.flatnonzero(np.diff(segments)) + 1
    line = partial(_broken, gaps, time)
    (predicted, band, torque, torque_band, *air) = others[:6]
    ahead = ANGLE.scale * predicted, ANGLE.scale * band
    angles = (
        line("measured", palette.MEASURED, ANGLE.scale * measured),
        line(f"{AHEAD:g} s ahead", palette.PREDICTED, *ahead),
    )
    motors = zip(history.motors, cycle(palette.DISTINCT), others[6:], strict=False)
    rows = (
        Row(axis.capitalize(), ANGLE.name, angles),
        Row(
            "Motors",
            "%",
            tuple(line(name, colour, 100 * values) for name, colour, values in motors),
        ),
        Row(
            "Wind torque",
            TORQUE.name,
            (
                line(
                    f"on {axis}",
                    palette.DISTURBANCE,
                    TORQUE.scale * torque,
                    TORQUE.scale * torque_band,
                ),
            ),
        ),
        Row("Wind", "m/s", (line("wind", palette.DISTURBANCE, *air),)),
    )
    known = tuple(row for row in rows if any(np.isfinite(one.values).any() for one in row.lines))
    return Timeline(
        known, (float(time[0]), float(time[-1])), tuple(history.learned), (), tuple(history.events)
    )
