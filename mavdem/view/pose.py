"""Pose: a simulated flight as a Rerun file: the vehicle in its wind, and beside it what the autopilot knew and did."""

from __future__ import annotations

import os
from collections.abc import Iterator
from math import ceil
from typing import Protocol

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import ArrayLike, NDArray

from mavdem.view import lines
from mavdem.view.lines import FLIGHT_TIME, Line
from mavdem.view.ticks import LABELS_IF_LOW, readable_range
from mavdem.whole_file import whole_file

Array = NDArray[np.float64]

FRAMES_A_SECOND = 50
"""Of the 3D view."""
MOST_SAMPLES = 50_000
"""Of a line: longer flights are thinned out evenly, since the viewer draws every one."""
TRAIL = 4.0
"""Seconds of the way behind the vehicle that are drawn, anew ten times a second."""
WIND_SCALE = 0.4
"""Length of the wind's arrow for 1 m/s, in lengths of an arm."""
WIND_AWAY = 1.4
"""Where that arrow ends before the vehicle, in lengths of an arm."""
THRUST_SCALE = 1.1
"""Length of a rotor's arrow where it carries its quarter of the weight, in lengths of an arm."""
EYE = (-5.2, 2.2, -3.5)
"""Where the vehicle is looked at from, in lengths of an arm, north, east and down: from the south-east and above."""
TARGET = (0.0, 0.6, -0.2)
"""What is looked at, likewise: a little to the east, where there is room for the wind."""
FAR, AROUND = 50.0, 8.0
"""m: how far from the beginning, and how far around the flight, the ground is drawn."""
CARRYING = 0.7
"""Share of the median speed of armed rotors above which they are taken to carry the vehicle."""

SPOOLING = 0.5
"""Seconds that rotors take to speed up and to slow down."""

BODY, NOSE, GROUND = (210, 214, 220), (255, 107, 107), (70, 74, 80)
TRAIL_COLOUR, WIND_COLOUR = (94, 214, 120), (72, 219, 219)
SLOW, HOVERING, FAST = (60, 110, 255), (165, 165, 170), (255, 150, 30)
"""Colours of a rotor, by its speed beside that of the hover."""


class Motion(Protocol):
    """What is shown of a flight: N rows, NED and body axes forward, right, down, SI units.

    ``time`` (N,) s; ``position`` (N, 3); ``attitude`` and ``known_attitude`` (N, 4), w first; ``rates`` and
    ``known_rates`` (N, 3); ``outputs`` (N, 4) µs; ``rotor_speeds`` (N, 4); ``wind`` and ``moment`` (N, 3); ``armed``
    (N,) bool.
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


def write_pose(path: str | os.PathLike[str], name: str, motion: Motion, rotors: ArrayLike) -> None:
    """Writes a flight as an .rrd file that opens with its own blueprint; it appears whole or not at all.

    Args:
        path: the file, in a folder that is there.
        name: of the recording.
        motion: the flight.
        rotors: (4, 2) where the rotors are, forward and right of the centre of mass, m.

    Raises:
        OSError: it cannot be written there.
    """
    recording = rr.RecordingStream("mavdem_flight")
    memory = recording.memory_recording()
    shown = list(_plots(motion))
    hubs = np.asarray(rotors, dtype=np.float64)
    arm = float(np.hypot(*hubs.T).max())
    recording.send_blueprint(_blueprint(motion, shown, arm), make_active=False)
    recording.send_recording_name(name)
    # North, east, down are to a world what forward, right, down are to a body.
    for place in ("world", "world/here"):
        recording.log(place, rr.ViewCoordinates.FRD, static=True)
    rows = _thinned(motion, FRAMES_A_SECOND)
    _vehicle(recording, motion, rows, hubs, arm)
    _surroundings(recording, motion, rows, arm)
    for plot in shown:
        plot.draw(recording, motion)
    with whole_file(path) as file:
        # Rerun does not tell when a file it writes fails, as on a full disk; Python does.
        file.write(memory.drain_as_bytes())


def _thinned(motion: Motion, rate: float) -> NDArray[np.intp]:
    """Rows of the flight, evenly, at about ``rate`` Hz."""
    step = float(np.median(np.diff(motion.time)))
    return np.arange(0, len(motion.time), max(round(1 / rate / step), 1))


def _carries(motion: Motion) -> NDArray[np.bool_]:
    """(N,) where the rotors carry the vehicle, not just now or only just; everywhere, if they never do."""
    speed = motion.rotor_speeds.mean(axis=1)
    hover = float(np.median(speed[motion.armed])) if motion.armed.any() else np.inf
    carried = motion.time[speed > CARRYING * hover]
    if not len(carried) or carried[-1] - carried[0] < 3 * SPOOLING:
        return np.ones(len(speed), dtype=np.bool_)
    return np.asarray((motion.time > carried[0] + SPOOLING) & (motion.time < carried[-1] - SPOOLING))


def _index(time: Array) -> list[rr.TimeColumn]:
    return [rr.TimeColumn(FLIGHT_TIME, duration=time)]


def _vehicle(recording: rr.RecordingStream, motion: Motion, rows: NDArray[np.intp], rotors: Array, arm: float) -> None:
    """A box with a nose on four arms; each rotor's colour tells its speed, its arrow its thrust."""
    index = _index(motion.time[rows])
    recording.send_columns("world/here", index, rr.Transform3D.columns(translation=motion.position[rows]))
    attitude = np.roll(motion.attitude[rows], -1, axis=1)  # Rerun has w last
    recording.send_columns("world/here/vehicle", index, rr.Transform3D.columns(quaternion=attitude))
    hubs = np.column_stack([rotors, np.full(len(rotors), -0.12 * arm)])
    body = rr.Boxes3D(half_sizes=[[0.34 * arm, 0.2 * arm, 0.1 * arm]], colors=BODY, fill_mode="solid")
    recording.log("world/here/vehicle/body", body, static=True)
    arms = rr.LineStrips3D([[[0, 0, 0], hub] for hub in hubs.tolist()], radii=0.03 * arm, colors=BODY)
    recording.log("world/here/vehicle/arms", arms, static=True)
    nose = rr.Arrows3D(vectors=[[0.75 * arm, 0, 0]], origins=[[0.3 * arm, 0, 0]], radii=0.04 * arm, colors=NOSE)
    recording.log("world/here/vehicle/nose", nose, static=True)
    count = len(hubs)
    discs = rr.Cylinders3D(lengths=[0.02 * arm] * count, radii=[0.48 * arm] * count, centers=hubs, fill_mode="solid")
    recording.log("world/here/vehicle/rotors", discs, static=True)
    speeds = motion.rotor_speeds
    carries = _carries(motion)
    hover = float(np.median(speeds[carries]))
    most = float(np.percentile(np.abs(speeds[carries] - hover), 98))
    beside = np.clip((speeds[rows] - hover) / max(most, 1e-9), -1, 1)
    scale = np.array([SLOW, HOVERING, FAST], dtype=np.float64)
    colours = np.stack([np.interp(beside, [-1, 0, 1], channel) for channel in scale.T], axis=-1).astype(np.uint8)
    columns = rr.Cylinders3D.columns(colors=colours.reshape(-1, 3)).partition([count] * len(rows))
    recording.send_columns("world/here/vehicle/rotors", index, columns)
    thrust = (speeds[rows] / max(hover, 1e-9)) ** 2
    vectors = np.zeros((len(rows), count, 3))
    vectors[:, :, 2] = -THRUST_SCALE * arm * thrust
    recording.log("world/here/vehicle/thrust", rr.Arrows3D.from_fields(origins=hubs, radii=[0.025 * arm]), static=True)
    arrows = rr.Arrows3D.columns(vectors=vectors.reshape(-1, 3), colors=colours.reshape(-1, 3))
    recording.send_columns("world/here/vehicle/thrust", index, arrows.partition([count] * len(rows)))


def _surroundings(recording: rr.RecordingStream, motion: Motion, rows: NDArray[np.intp], arm: float) -> None:
    """The wind that blows at the vehicle, the way it came, and the ground, a line every metre."""
    lowest, highest = (np.clip(edge(motion.position[:, :2], axis=0), -FAR, FAR) for edge in (np.min, np.max))
    (north, east), (northern, eastern) = np.floor(lowest) - AROUND, np.ceil(highest) + AROUND
    squares = [[[n, east, 0], [n, eastern, 0]] for n in np.arange(north, northern + 1)]
    squares += [[[north, e, 0], [northern, e, 0]] for e in np.arange(east, eastern + 1)]
    recording.log("world/ground", rr.LineStrips3D(squares, radii=0.004, colors=[GROUND]), static=True)
    vectors = WIND_SCALE * arm * motion.wind[rows]
    # Its head stays out of the rotors.
    speed = np.linalg.norm(vectors, axis=1, keepdims=True)
    away = WIND_AWAY * arm * vectors / np.maximum(speed, 1e-9)
    recording.log("world/here/wind", rr.Arrows3D.from_fields(radii=[0.05 * arm], colors=[WIND_COLOUR]), static=True)
    columns = rr.Arrows3D.columns(vectors=vectors, origins=-away - vectors)
    recording.send_columns("world/here/wind", _index(motion.time[rows]), columns)
    now = _thinned(motion, 10)
    before = np.searchsorted(motion.time, motion.time[now] - TRAIL)
    step = max(len(motion.time) // len(now) // 4, 1)
    strips = [motion.position[first : last + 1 : step] for first, last in zip(before, now, strict=True)]
    recording.log("world/trail", rr.LineStrips3D.from_fields(radii=[0.022 * arm], colors=[TRAIL_COLOUR]), static=True)
    recording.send_columns("world/trail", _index(motion.time[now]), rr.LineStrips3D.columns(strips=strips))


class _Plot:
    """One picture over time: ``series`` (name, colour, width, values (N,)) in ``unit``."""

    def __init__(self, origin: str, title: str, series: list[tuple[str, lines.Colour, float, Array]]) -> None:
        self.origin, self.title, self.series = origin, title, series

    def draw(self, recording: rr.RecordingStream, motion: Motion) -> None:
        rows = np.arange(0, len(motion.time), ceil(len(motion.time) / MOST_SAMPLES))
        for place, (name, colour, width, values) in enumerate(self.series):
            # Drawn in the order of their paths.
            path = rr.new_entity_path([self.origin, f"{place} {name}"])
            Line(path, name, colour, width).over_time(recording, motion.time[rows], values[rows])

    def view(self, end: float, carries: NDArray[np.bool_]) -> rrb.View:
        """Over the whole flight, with room for the legend beside it, and the range of what is in the air."""
        values = [values[carries] for *_, values in self.series]
        low, high = min(float(one.min()) for one in values), max(float(one.max()) for one in values)
        time = rr.TimeRange(
            start=rr.TimeRangeBoundary.absolute(seconds=0.0), end=rr.TimeRangeBoundary.absolute(seconds=1.22 * end)
        )
        return rrb.TimeSeriesView(
            name=self.title,
            origin=self.origin,
            axis_x=rrb.archetypes.TimeAxis(view_range=time),
            axis_y=rrb.ScalarAxis(range=readable_range(low, high, LABELS_IF_LOW)),
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
        )


def _plots(motion: Motion) -> Iterator[_Plot]:
    roll = [("true", lines.PREDICTED, 4.0, _roll(motion.attitude)), _measured(_roll(motion.known_attitude))]
    yield _Plot("roll", "Roll, °", roll)
    rate = [
        ("true", lines.PREDICTED, 4.0, np.degrees(motion.rates[:, 0])),
        _measured(np.degrees(motion.known_rates[:, 0])),
    ]
    yield _Plot("roll_rate", "Roll rate, °/s", rate)
    yield _Plot("motors", "Motor outputs, µs", _several("motor 1,motor 2,motor 3,motor 4", motion.outputs))
    yield _Plot("wind", "Wind at the vehicle, m/s, where it blows to", _several("north,east,down", motion.wind))
    moment = _several("roll,pitch,yaw", 1e3 * motion.moment)
    yield _Plot("moment", "Moment of the disturbance, mN m", moment)


def _measured(values: Array) -> tuple[str, lines.Colour, float, Array]:
    return "known to the autopilot", lines.MEASURED, 1.2, values


def _several(names: str, table: Array) -> list[tuple[str, lines.Colour, float, Array]]:
    return [(name, lines.distinct(i), 1.2, table[:, i]) for i, name in enumerate(names.split(","))]


def _roll(attitude: Array) -> Array:
    """(N,) degrees, of unit quaternions (N, 4)."""
    w, x, y, z = attitude.T
    return np.asarray(np.degrees(np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))))


def _blueprint(motion: Motion, plots: list[_Plot], arm: float) -> rrb.Blueprint:
    """The vehicle to the left, and the plots to the right, one above the other."""
    view = rrb.Spatial3DView(
        name="The vehicle, its rotors' thrust, the way it came (green), the wind (turquoise)",
        # What moves along with the vehicle but does not turn with it: the eye does too.
        origin="world/here",
        contents="world/**",
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=arm * np.array(EYE),
            look_target=arm * np.array(TARGET),
            eye_up=(0, 0, -1),
        ),
    )
    end, carries = float(motion.time[-1]), _carries(motion)
    return rrb.Blueprint(
        rrb.Horizontal(view, rrb.Vertical(*(plot.view(end, carries) for plot in plots)), column_shares=[45, 55]),
        rrb.TimePanel(state="collapsed", timeline=FLIGHT_TIME, play_state="playing", loop_mode="all"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )
