"""Flights in 3D: a simulated one as a Rerun file, with estimates and motor outputs, and the path of a logged one."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import ceil
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from mavdem.alignment.drive import Signal
from mavdem.condition.wind_velocity import WindVelocity
from mavdem.dem.engine.linalg import Array
from mavdem.files import atomic_write
from mavdem.fleet.row import as_text
from mavdem.ingest.motors import place_name
from mavdem.ingest.vocabulary import euler_angles
from mavdem.report import palette
from mavdem.report.numbers import named, rounded
from mavdem.report.timeline import Row

BOOT_CLOCK = "boot clock"
"""Timeline of flights, s: the vehicle's boot clock; live that of its first boot, which goes on where another begins."""

# points: the viewer fills nothing, so an area is drawn as upright strokes that touch each other
FILL_WIDTH = 2.5
# of an area, which is drawn at once, and of all shaded times of a plot
MAX_STROKES = 20_000
SPAN_STROKES = 3000


@dataclass(frozen=True)
class Lines:
    """An entity of k lines over the same times, drawn in the order of the paths: one chunk a batch."""

    path: str  # of the entity
    names: tuple[str, ...]  # of the lines, in the legend
    colours: tuple[str, ...]  # of the palette
    width: float = 1.5  # points
    marked: bool = False  # whether the values are drawn as markers, not joined
    # whether the values are the edges of an area, drawn as one line of upright strokes
    filled: bool = False

    def send_style(self, recording: rr.RecordingStream) -> None:
        """Sends how the lines are drawn; once a recording."""
        look: dict[str, Any] = {
            "names": self.names,
            "colors": [palette.channels(colour) for colour in self.colours],
        }
        widths = [FILL_WIDTH if self.filled else self.width] * len(self.names)
        # Averaging within a pixel would hide gusts, and make a point of a stroke.
        style: Any = rr.SeriesLines(
            widths=widths, aggregation_policy=rr.components.AggregationPolicy.Off, **look
        )
        if self.marked:
            style = rr.SeriesPoints(marker_sizes=widths, markers=["circle"] * len(widths), **look)
        recording.log(self.path, style, static=True)

    def send(self, recording: rr.RecordingStream, time: Array, values: Array) -> None:
        """Sends values (N, k), or edges (N, 2), at times (N,), s; NaN breaks a line."""
        if not len(time):
            return
        if self.filled:
            time = np.repeat(time, 2)
            values = values.reshape(-1, 1)
        columns = rr.Scalars.columns(scalars=values.ravel()).partition(
            [len(self.names)] * len(time)
        )
        recording.send_columns(self.path, [rr.TimeColumn(BOOT_CLOCK, duration=time)], columns)


@dataclass(eq=False)
class Plot:
    """A picture over the boot clock at the entity ``origin``; later lines are drawn over earlier ones.

    The ``range`` of values is in its title, since the viewer numbers hardly an axis of a low plot.
    """

    origin: str
    title: str
    range: tuple[float, float]
    lines: list[tuple[Lines, Array, Array]] = field(default_factory=list)

    @classmethod
    def series(
        cls,
        origin: str,
        title: str,
        time: Array,
        values: Mapping[str, Array],
        colour: str = "",
        inside: Any = ...,
    ) -> Plot:
        """Returns a plot of values (N,) by name over times (N,), s, whose range is that of the rows ``inside``."""
        plot = cls(origin, title, range_of(*(line[inside] for line in values.values())))
        for i, (name, line) in enumerate(values.items()):
            plot.line(name, colour or palette.distinct(i), time, line)
        return plot

    @classmethod
    def of(cls, origin: str, row: Row, gusts: Sequence[tuple[float, float]] = ()) -> Plot:
        """Returns the plot of a ``row`` of the timeline with its bands, and ``gusts`` from start to end, s, behind."""
        usual = [0.0 if line.half is None else np.nanmedian(line.half) for line in row.lines]
        edges = [
            line.values + way * half
            for line, half in zip(row.lines, usual, strict=True)
            for way in (-1, 1)
        ]
        plot = cls(origin, named(row.title, row.unit), range_of(*edges))
        plot.spans(f"gust ({len(gusts)})", faint(palette.GUST, 0.5), gusts)
        for line in row.lines:
            if line.half is not None:
                band = line.values - line.half, line.values + line.half
                plot.area("90 % band", faint(line.colour, palette.BAND_OPACITY), line.time, *band)
            plot.line(line.name, line.colour, line.time, line.values)
        return plot

    def line(self, name: str, colour: str, time: Array, values: Array, width: float = 1.2) -> None:
        """Adds a line: values (N,) at times (N,), s; NaN breaks it; of two columns the area between them."""
        path = f"{self.origin}/{rr.escape_entity_path_part(f'{len(self.lines)} {name}')}"
        self.lines.append(
            (Lines(path, (name,), (colour,), width, filled=values.ndim > 1), time, values)
        )

    def area(self, name: str, colour: str, time: Array, low: Array, high: Array) -> None:
        """Adds the area between two lines (N,), as far as it is in sight; opaque, since strokes that overlap add up."""
        least, most = self.range
        edges = np.clip([low, high], 2 * least - most, 2 * most - least)
        step = ceil(len(time) / MAX_STROKES)
        self.line(name, colour, time[::step], edges.T[::step])

    def marks(self, name: str, colour: str, times: Sequence[float]) -> None:
        """Adds an upright line at each time, s, over the whole range; nothing if there are none."""
        if len(times):
            ends = with_gaps([np.array(self.range) for _ in times])
            self.line(
                name, colour, with_gaps([np.full(2, at) for at in times], last=True), ends, 2.0
            )

    def spans(self, name: str, colour: str, times: Sequence[tuple[float, float]]) -> None:
        """Adds filled spans of time, from start to end, s, over the whole range; nothing if there are none."""
        spacing = sum(end - start for start, end in times) / SPAN_STROKES
        parts = [
            np.linspace(*span, max(2, ceil((span[1] - span[0]) / spacing)))
            for span in times
            if spacing
        ]
        if parts:
            time = with_gaps(parts, last=True)
            inside = with_gaps([np.ones(len(part)) for part in parts])
            self.area(name, colour, time, self.range[0] * inside, self.range[1] * inside)

    def draw(self, recording: rr.RecordingStream) -> None:
        """Draws the lines."""
        for lines, time, values in self.lines:
            lines.send_style(recording)
            lines.send(recording, time, values)

    def view(self, first: float, last: float) -> rrb.View:
        """Returns the view from ``first`` to ``last``, s, with a legend where there is more than one line."""
        low, high = self.range
        margin = 0.05 * max(high - low, 1e-9 * max(abs(low), abs(high), 1.0))
        # The legend stands beside the lines.
        end = first + 1.16 * (last - first)
        start = rr.TimeRangeBoundary.absolute(seconds=first)
        stop = rr.TimeRangeBoundary.absolute(seconds=end)
        x = rrb.archetypes.TimeAxis(view_range=rr.TimeRange(start=start, end=stop))
        y = rrb.ScalarAxis(range=(low - margin, high + margin))
        legend = rrb.PlotLegend(corner=rrb.Corner2D.RightTop, visible=len(self.lines) > 1)
        title = f"{self.title} ({rounded(low, 3)} to {rounded(high, 3)})"
        return rrb.TimeSeriesView(
            name=title, origin=self.origin, axis_x=x, axis_y=y, plot_legend=legend
        )


def with_gaps(parts: Sequence[Array] | Array, last: bool = False) -> Array:
    """Returns parts (N, …) one after the other, after each a NaN, which draws no line, or its ``last`` value again."""
    ends = (part[-1:] if last else np.full_like(part[-1:], np.nan) for part in parts)
    return np.concatenate([piece for pair in zip(parts, ends, strict=True) for piece in pair])


def faint(colour: str, opacity: float) -> str:
    """Returns the colour of the palette that one with this opacity has on the viewer's dark ground."""
    over = np.array(palette.channels(colour))
    under = np.array(palette.channels(palette.PAPER_DARK))
    return "#" + bytes(np.round(opacity * over + (1 - opacity) * under).astype(np.uint8)).hex()


def blueprint(view: rrb.Container, **options: Any) -> rrb.Blueprint:
    """Returns a layout of one container with all panels beside it collapsed; ``options`` are of the time panel."""
    time = rrb.TimePanel(state="collapsed", timeline=BOOT_CLOCK, **options)
    left = rrb.BlueprintPanel(state="collapsed")
    right = rrb.SelectionPanel(state="collapsed")
    return rrb.Blueprint(view, time, left, right, auto_views=False, auto_layout=False)


def log(recording: rr.RecordingStream, time: float, sentence: str, level: str = "INFO") -> None:
    """Writes a sentence into the log at a ``time`` on the timeline, s, with a level: "INFO", "WARN" or "ERROR"."""
    recording.set_time(BOOT_CLOCK, duration=time)
    recording.log("log", rr.TextLog(sentence, level=level))


def events_view() -> rrb.View:
    """Returns the view of that log."""
    columns = rrb.archetypes.TextLogColumns(
        timeline_columns=[BOOT_CLOCK], text_log_columns=["LogLevel", "Body"]
    )
    return rrb.TextLogView(origin="log", name="Events", columns=columns)


Target = str | os.PathLike[str] | rr.RecordingStream
"""Where a recording goes: a file, or one that is :func:`streamed`."""


@contextmanager
def streamed(name: str, application: str) -> Iterator[rr.RecordingStream]:
    """Yields a recording called ``name`` that goes to standard output as it is made.

    The viewer has one blueprint for each ``application``.
    """
    with rr.RecordingStream(application) as recording:
        recording.stdout()
        recording.send_recording_name(as_text(name))
        yield recording


@contextmanager
def recorded(target: Target, name: str) -> Iterator[rr.RecordingStream]:
    """Yields a recording called ``name`` that is then written to a file, whole or not at all; ``OSError`` if not."""
    if isinstance(target, rr.RecordingStream):
        yield target
        target.flush()
        return
    recording = rr.RecordingStream("mavdem")
    memory = recording.memory_recording()
    recording.send_recording_name(as_text(name))
    yield recording
    # Rerun does not report when a file it writes fails, as on a full disk; Python does.
    contents = memory.drain_as_bytes()
    with atomic_write(target) as file:
        file.write(contents)


def range_of(*values: Array) -> tuple[float, float]:
    """Returns the least and the most of the finite ones of some values."""
    finite = np.concatenate([series[np.isfinite(series)] for series in values])
    return (float(finite.min()), float(finite.max())) if len(finite) else (-1.0, 1.0)


# the viewer draws every row, and all arrows along a path at once
MAX_ROWS = 50_000
MAX_ARROWS = 150
WIND_SCALE = 0.4  # length of the wind's arrow for 1 m/s, in arms

BODY = (210, 214, 220)
NOSE = (255, 107, 107)
GROUND = (70, 74, 80)
TRAIL = (94, 214, 120)
# slower than in hover, as there, faster
SPEEDS = np.array([(60, 110, 255), (165, 165, 170), (255, 150, 30)], float)


@dataclass(frozen=True, eq=False)
class Pose:
    """A flight to be shown: N rows, NED and body axes forward, right, down.

    Attributes:
        time, position: (N,) s, and (N, 3) m.
        attitude, known_attitude: (N, 4) unit quaternions (w, x, y, z), body to NED, true and as estimated.
        rates, known_rates: (N, 3) body rates, rad/s, likewise.
        outputs, rotor_speeds, armed: (N, 4) of the motors, µs; (N, 4) rad/s; (N,) bool.
        wind: (N, 3) NED, m/s, where the air moves to.
        moment: (N, 3) of what disturbs, body, N m.
        rotors: (4, 2) where the rotors are, forward and right of the centre of mass, m.
    """

    time: Array
    position: Array
    attitude: Array
    known_attitude: Array
    rates: Array
    known_rates: Array
    outputs: Array
    rotor_speeds: Array
    wind: Array
    moment: Array
    armed: NDArray[np.bool_]
    rotors: Array

    @property
    def motors(self) -> tuple[str, ...]:
        """The motors by their places, as ``front right``."""
        return tuple(place_name((float(forward), float(right))) for forward, right in self.rotors)

    @property
    def arm(self) -> float:
        """How far the farthest rotor is from the centre of mass, m."""
        return float(np.hypot(*self.rotors.T).max())

    def carries(self) -> NDArray[np.bool_]:
        """(N,) where the rotors carry the vehicle; everywhere if they never do."""
        speed = self.rotor_speeds.mean(axis=1)
        hover = float(np.median(speed[self.armed])) if self.armed.any() else np.inf
        carried = np.asarray(speed > 0.9 * hover)
        return carried if carried.any() else ~carried

    def at(self, rate: float) -> NDArray[np.intp]:
        """Rows of the flight, evenly, at about ``rate`` Hz, no faster than there are, and fewer of a long flight."""
        step = float(np.median(np.diff(self.time)))
        count = len(self.time)
        return np.arange(0, count, max(round(1 / rate / step), ceil(count / MAX_ROWS)))


def write_pose(path: str | os.PathLike[str], name: str, pose: Pose) -> None:
    """Writes a flight, ``pose``, as an .rrd file ``path`` with its own blueprint; ``name`` is the recording's.

    It appears whole or not at all: ``OSError`` if it cannot be written there.
    """
    rows = pose.at(50)
    plots = _plots(pose)
    with recorded(path, name) as recording:
        # North, east, down are to a world what forward, right, down are to a body.
        for frame in ("world", "world/here"):
            recording.log(frame, rr.ViewCoordinates.FRD, static=True)
        _vehicle(recording, pose, rows)
        _surroundings(recording, pose, rows)
        for plot in plots:
            plot.draw(recording)
        views = rrb.Vertical(
            *(plot.view(0.0, float(pose.time[-1])) for plot in plots), row_shares=(5, 5, 5, 7, 6, 6)
        )
        layout = rrb.Horizontal(_scene(pose), views, column_shares=[45, 55])
        recording.send_blueprint(
            blueprint(layout, play_state="playing", loop_mode="all"), make_active=False
        )


def _plots(pose: Pose) -> list[Plot]:
    """What was flown, and the errors of what the autopilot knew of it; ranges are those in the air."""
    rows = pose.at(np.inf)
    carried = pose.time[pose.carries()]
    roll = np.degrees(euler_angles(pose.attitude)[0])
    known = np.degrees(euler_angles(pose.known_attitude)[0])
    rate = np.degrees(pose.rates[:, 0])
    known_rate = np.degrees(pose.known_rates[:, 0])
    motors = pose.outputs - pose.outputs.mean(axis=1, keepdims=True)
    errors = {"roll rate": known_rate - rate, "roll": known - roll}
    tables = (
        ("roll", "Roll, °", {"roll": roll}),
        ("roll_rate", "Roll rate, °/s", {"roll rate": rate}),
        ("errors", "Errors of the autopilot's estimates, ° and °/s", errors),
        (
            "motors",
            "Motor outputs, deviation from their mean, µs",
            dict(zip(pose.motors, motors.T, strict=True)),
        ),
        (
            "wind",
            "Wind, m/s: where the air moves to",
            dict(zip(("north", "east", "down"), pose.wind.T, strict=True)),
        ),
        (
            "moment",
            "Disturbance moment, mN m",
            dict(zip(("roll", "pitch", "yaw"), 1e3 * pose.moment.T, strict=True)),
        ),
    )
    # While rotors spool, for half a second, and the ground takes or gives the vehicle, values may be far off.
    aloft = np.abs(pose.time[rows] - carried[[0, -1]].mean()) < np.ptp(carried) / 2 - 0.5
    inside = aloft if aloft.any() else np.full(len(rows), True)
    return [
        Plot.series(
            origin,
            title,
            pose.time[rows],
            {name: values[rows] for name, values in series.items()},
            "",
            inside,
        )
        for origin, title, series in tables
    ]


def _scene(pose: Pose) -> rrb.View:
    """The view that the vehicle is seen in, with the scale of its arrows."""
    thrust = 100 * pose.arm
    wind = 100 * WIND_SCALE * pose.arm
    arrows = f"Thrust arrows: {thrust:.2g} cm at hover. Wind arrow: {wind:.2g} cm for 1 m/s"
    # North, east and down: from the south-east and above, on what leaves room for the wind in the east.
    eye = pose.arm * np.array((-5.2, 2.2, -3.5))
    target = pose.arm * np.array((0.0, 0.9, -0.2))
    controls = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=eye, look_target=target, eye_up=(0, 0, -1)
    )
    # What moves along with the vehicle but does not turn with it: the eye does too.
    here: dict[str, Any] = {"origin": "world/here", "contents": "world/**", "line_grid": False}
    return rrb.Spatial3DView(
        name=f"{arrows}. Ground: 1 m. Green: the last 4 s", eye_controls=controls, **here
    )


def _vehicle(recording: rr.RecordingStream, pose: Pose, rows: NDArray[np.intp]) -> None:
    """A box with a nose on four arms; each rotor's colour shows its speed, its arrow its thrust."""
    arm = pose.arm
    count = len(pose.rotors)
    index = [rr.TimeColumn(BOOT_CLOCK, duration=pose.time[rows])]
    recording.send_columns(
        "world/here", index, rr.Transform3D.columns(translation=pose.position[rows])
    )
    attitude = np.roll(pose.attitude[rows], -1, axis=1)  # Rerun has w last
    recording.send_columns("world/here/vehicle", index, rr.Transform3D.columns(quaternion=attitude))
    hubs = np.column_stack([pose.rotors, np.full(count, -0.12 * arm)])
    heights = [0.02 * arm] * count
    radii = [0.48 * arm] * count
    parts = {
        "body": rr.Boxes3D(
            half_sizes=[[0.34 * arm, 0.2 * arm, 0.1 * arm]], colors=BODY, fill_mode="solid"
        ),
        "arms": rr.LineStrips3D(
            [[[0, 0, 0], hub] for hub in hubs.tolist()], radii=0.03 * arm, colors=BODY
        ),
        "nose": rr.Arrows3D(
            vectors=[[0.75 * arm, 0, 0]], origins=[[0.3 * arm, 0, 0]], radii=0.04 * arm, colors=NOSE
        ),
        "rotors": rr.Cylinders3D(lengths=heights, radii=radii, centers=hubs, fill_mode="solid"),
        "thrust": rr.Arrows3D.from_fields(
            origins=hubs, radii=[0.025 * arm], labels=pose.motors, show_labels=True
        ),
    }
    for name, part in parts.items():
        recording.log(f"world/here/vehicle/{name}", part, static=True)
    speeds = pose.rotor_speeds
    carries = pose.carries()
    hover = float(np.median(speeds[carries]))
    most = float(np.percentile(np.abs(speeds[carries] - hover), 98))
    beside = np.clip((speeds[rows] - hover) / max(most, 1e-9), -1, 1)
    colours = np.stack(
        [np.interp(beside, [-1, 0, 1], channel) for channel in SPEEDS.T], axis=-1
    ).astype(np.uint8)
    columns = rr.Cylinders3D.columns(colors=colours.reshape(-1, 3)).partition([count] * len(rows))
    recording.send_columns("world/here/vehicle/rotors", index, columns)
    vectors = np.zeros((len(rows), count, 3))
    # an arm long where it carries its share
    vectors[:, :, 2] = -arm * (speeds[rows] / max(hover, 1e-9)) ** 2
    arrows = rr.Arrows3D.columns(vectors=vectors.reshape(-1, 3), colors=colours.reshape(-1, 3))
    recording.send_columns(
        "world/here/vehicle/thrust", index, arrows.partition([count] * len(rows))
    )


def _surroundings(recording: rr.RecordingStream, pose: Pose, rows: NDArray[np.intp]) -> None:
    """The wind at the vehicle, its flight path, and the ground with a line every metre."""
    place = np.clip(pose.position[:, :2], -50.0, 50.0)  # m from the start
    north, east = np.floor(place.min(axis=0)) - 8.0
    northern, eastern = np.ceil(place.max(axis=0)) + 8.0
    squares = [[[n, east, 0], [n, eastern, 0]] for n in np.arange(north, northern + 1)]
    squares += [[[north, e, 0], [northern, e, 0]] for e in np.arange(east, eastern + 1)]
    recording.log(
        "world/ground", rr.LineStrips3D(squares, radii=0.004, colors=[GROUND]), static=True
    )
    arm = pose.arm
    wind = pose.wind[rows]
    speed = np.linalg.norm(wind, axis=1, keepdims=True)
    vectors = WIND_SCALE * arm * wind
    colour = palette.channels(palette.DISTURBANCE)
    away = 1.4 * arm * wind / np.maximum(speed, 1e-9)  # its head stays out of the rotors
    style = rr.Arrows3D.from_fields(radii=[0.05 * arm], colors=[colour], show_labels=True)
    recording.log("world/here/wind", style, static=True)
    labels = [f"wind {each:.1f} m/s" for each in speed[:, 0]]
    columns = rr.Arrows3D.columns(vectors=vectors, origins=-away - vectors, labels=labels)
    recording.send_columns(
        "world/here/wind", [rr.TimeColumn(BOOT_CLOCK, duration=pose.time[rows])], columns
    )
    now = pose.at(10)
    before = np.searchsorted(pose.time, pose.time[now] - 4.0)  # seconds of the way behind it
    step = max(len(pose.time) // len(pose.at(20)), 1)
    strips = [
        pose.position[first : last + 1 : step] for first, last in zip(before, now, strict=True)
    ]
    recording.log(
        "world/trail", rr.LineStrips3D.from_fields(radii=[0.022 * arm], colors=[TRAIL]), static=True
    )
    index = [rr.TimeColumn(BOOT_CLOCK, duration=pose.time[now])]
    recording.send_columns("world/trail", index, rr.LineStrips3D.columns(strips=strips))


def path_with_wind(
    recording: rr.RecordingStream, position: Signal, wind: WindVelocity
) -> rrb.View | None:
    """Draws the path that was flown in the ``wind`` and arrows of it; returns their view, None without a path."""
    rows = (
        (position.boot == wind.boot)
        & (position.time >= wind.time[0])
        & (position.time <= wind.time[-1])
    )
    time = position.time[rows]
    place = position.values[rows]
    if len(time) < 2:
        return None
    at = np.linspace(time[0], time[-1], min(MAX_ARROWS, ceil(np.ptp(time)) + 1))
    moved = np.column_stack([*(np.interp(at, wind.time, air) for air in wind.velocity.T), 0 * at])
    tails = np.column_stack([np.interp(at, time, axis) for axis in place.T])
    speeds = np.hypot(*moved.T[:2])
    size = float(np.ptp(place, axis=0).max()) + 5.0
    middle = (place.min(axis=0) + place.max(axis=0)) / 2
    scale = 0.2 * size / max(float(speeds.max()), 1.0)
    colour = palette.channels(palette.DISTURBANCE)
    corner = middle - size * np.array([0.5, 0.5, 0.0])
    parts: dict[str, Any] = {
        "": rr.ViewCoordinates.FRD,  # as north, east, down
        "/flown": rr.LineStrips3D(
            [place[:: ceil(len(time) / MAX_ROWS)]], radii=0.0025 * size, colors=[TRAIL]
        ),
        "/wind": rr.Arrows3D(
            origins=tails, vectors=scale * moved, radii=0.002 * size, colors=[colour]
        ),
        "/north": rr.Arrows3D(
            origins=[corner], vectors=[[size / 6, 0, 0]], radii=0.004 * size, labels=["north"]
        ),
        "/here": rr.Points3D.from_fields(radii=[0.01 * size], colors=[NOSE], show_labels=True),
        "/now": rr.Arrows3D.from_fields(radii=[0.006 * size], colors=[NOSE]),
    }
    for name, part in parts.items():
        recording.log(f"path{name}", part, static=True)
    index = [rr.TimeColumn(BOOT_CLOCK, duration=at)]
    labels = [f"{speed:.1f} m/s" for speed in speeds]
    recording.send_columns("path/here", index, rr.Points3D.columns(positions=tails, labels=labels))
    recording.send_columns(
        "path/now", index, rr.Arrows3D.columns(origins=tails, vectors=scale * moved)
    )
    eye: Any = {
        "position": middle + size * np.array([-1.2, -0.4, -0.9]),
        "look_target": middle,
        "eye_up": (0, 0, -1),
    }
    controls = rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, **eye)
    return rrb.Spatial3DView(
        name=f"Path: {scale:.2g} m of arrow for 1 m/s of wind", origin="path", eye_controls=controls
    )
