"""A simulated flight in 3D as a Rerun file, with its wind and motor outputs."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import ceil

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from mavdem.arrays import Array, Flags, Indices
from mavdem.containers import JsonValues, Names
from mavdem.dataset.axes import AXES
from mavdem.dataset.signals import MIN_STREAM_RATE
from mavdem.files import PathName
from mavdem.ingest.motors import position_name
from mavdem.ingest.vocabulary import euler_angles
from mavdem.report import palette
from mavdem.report.charts.chart import Chart, Line, over_time
from mavdem.view.plots import BOOT_CLOCK, MAX_STROKES, blueprint, drawn, recorded

WIND_SCALE = 0.4  # length of the wind's arrow for 1 m/s, in arms

BODY = palette.channels(palette.BOUND)
NOSE = palette.channels(palette.BAD)
TRAIL = palette.channels(palette.COMMAND)


@dataclass(frozen=True, eq=False)
class Pose:
    """A flight to be shown: N rows, NED and body axes forward, right, down.

    Attributes:
        time, position: (N,) s, and (N, 3) m.
        attitude: (N, 4) unit quaternions (w, x, y, z), body to NED.
        rates: (N, 3) body rates, rad/s.
        outputs, rotor_speeds, armed: (N, 4) of the motors, µs; (N, 4) rad/s; (N,) bool.
        wind: (N, 3) NED, m/s, where the air moves to.
        moment: (N, 3) of what disturbs, body, N m.
        rotors: (4, 2) where the rotors are, forward and right of the centre of mass, m.
    """

    time: Array
    position: Array
    attitude: Array
    rates: Array
    outputs: Array
    rotor_speeds: Array
    wind: Array
    moment: Array
    armed: Flags
    rotors: Array

    @property
    def motors(self) -> Names:
        """The motors by their places, as ``front right``."""
        return tuple(
            position_name((float(forward), float(right))) for forward, right in self.rotors
        )

    @property
    def arm(self) -> float:
        """How far the farthest rotor is from the centre of mass, m."""
        return float(np.hypot(*self.rotors.T).max())

    def carries(self) -> Flags:
        """Returns where the rotors carry the vehicle, (N,); everywhere if they never do."""
        speed = self.rotor_speeds.mean(axis=1)
        hover = np.median(speed[self.armed]) if self.armed.any() else np.inf
        carried = speed > 0.9 * hover
        return carried if carried.any() else ~carried

    def drawn(self) -> Indices:
        """Returns rows of the flight, evenly, at about ``MINIMUM_RATE``, and fewer of a long flight."""
        step = np.median(np.diff(self.time))
        count = len(self.time)
        return np.arange(
            0, count, max(round(1 / MIN_STREAM_RATE / step), ceil(count / MAX_STROKES))
        )


def pose_of(motion: object, rotors: Sequence[Sequence[float]]) -> Pose:
    """Returns what is shown of a simulated ``motion`` with ``rotors`` so far forward, and right, m."""
    places = np.column_stack(rotors)
    shown = {field.name: getattr(motion, field.name, places) for field in fields(Pose)}
    return Pose(**shown)


def write_pose(path: PathName, name: str, pose: Pose) -> None:
    """Writes a flight, ``pose``, as an .rrd file ``path`` with its own blueprint; ``name`` is the recording's.

    It appears whole or not at all: ``OSError`` if it cannot be written there.
    """
    span = float(pose.time[0]), float(pose.time[-1])
    with recorded(path, name) as recording:
        # North, east, down are to a world what forward, right, down are to a body.
        for frame in ("world", "world/here"):
            recording.log(frame, rr.ViewCoordinates.FRD, static=True)
        _vehicle(recording, pose)
        _surroundings(recording, pose)
        views = [
            drawn(recording, f"plots/{number}", row, span) for number, row in enumerate(_rows(pose))
        ]
        layout = rrb.Horizontal(_scene(pose), rrb.Vertical(*views), column_shares=[45, 55])
        shown = blueprint(layout, play_state="playing", loop_mode="all")
        recording.send_blueprint(shown, make_active=False)


def _rows(pose: Pose) -> list[Chart]:
    """What was flown in the air."""
    rows = np.flatnonzero(pose.carries())
    *tilts, yaw = euler_angles(pose.attitude[rows])
    motors = pose.outputs[rows] - pose.outputs[rows].mean(axis=1, keepdims=True)
    tables = (
        ("Angles", "°", AXES, np.degrees([*tilts, np.unwrap(yaw)])),
        ("Rates", "°/s", AXES, np.degrees(pose.rates[rows].T)),
        ("Motor outputs, deviation from their mean", "µs", pose.motors, motors.T),
        ("Wind, where the air moves to", "m/s", ("north", "east", "down"), pose.wind[rows].T),
        ("Disturbance moment", "mN m", AXES, 1e3 * pose.moment[rows].T),
    )
    time = pose.time[rows]
    return [
        over_time(
            title,
            unit,
            tuple(
                Line(name, palette.distinct(number), time, values)
                for number, (name, values) in enumerate(zip(names, series, strict=True))
            ),
        )
        for title, unit, names, series in tables
    ]


def _scene(pose: Pose) -> rrb.View:
    """The view that the vehicle is seen in, with the scale of its arrows."""
    wind = 100 * WIND_SCALE * pose.arm
    said = (
        f"Thrust arrows: an arm long at hover. Wind arrow: {wind:.2g} cm for 1 m/s. Green: the path"
    )
    # North, east and down: from the south-east and above, on what leaves room for the wind in the east.
    eye = pose.arm * np.array((-5.2, 2.2, -3.5))
    target = pose.arm * np.array((0.0, 0.9, -0.2))
    controls = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=eye, look_target=target, eye_up=(0, 0, -1)
    )
    # What moves along with the vehicle but does not turn with it: the eye does too.
    here: JsonValues = {"origin": "world/here", "contents": "world/**", "line_grid": False}
    return rrb.Spatial3DView(name=said, eye_controls=controls, **here)


def _vehicle(recording: rr.RecordingStream, pose: Pose) -> None:
    """A box with a nose on four arms, with an arrow for the thrust of each rotor."""
    arm = pose.arm
    rows = pose.drawn()
    index = [rr.TimeColumn(BOOT_CLOCK, duration=pose.time[rows])]
    moved = rr.Transform3D.columns(translation=pose.position[rows])
    recording.send_columns("world/here", index, moved)
    attitude = np.roll(pose.attitude[rows], -1, axis=1)  # Rerun has w last
    recording.send_columns("world/here/vehicle", index, rr.Transform3D.columns(quaternion=attitude))
    count = len(pose.rotors)
    hubs = np.column_stack([pose.rotors, np.full(count, -0.12 * arm)])
    arms = [[[0, 0, 0], hub] for hub in hubs.tolist()]
    forward: JsonValues = {"vectors": [[0.75 * arm, 0, 0]], "origins": [[0.3 * arm, 0, 0]]}
    discs: JsonValues = {"lengths": [0.02 * arm] * count, "radii": [0.48 * arm] * count}
    parts = {
        "body": rr.Boxes3D(half_sizes=[[0.34 * arm, 0.2 * arm, 0.1 * arm]], colors=BODY),
        "arms": rr.LineStrips3D(arms, radii=0.03 * arm, colors=BODY),
        "nose": rr.Arrows3D(radii=0.04 * arm, colors=NOSE, **forward),
        "rotors": rr.Cylinders3D(centers=hubs, colors=BODY, fill_mode="solid", **discs),
        "thrust": rr.Arrows3D.from_fields(origins=hubs, radii=[0.025 * arm], labels=pose.motors),
    }
    for name, part in parts.items():
        recording.log(f"world/here/vehicle/{name}", part, static=True)
    hover = np.median(pose.rotor_speeds[pose.carries()])
    vectors = np.zeros((len(rows), count, 3))
    # an arm long where it carries its share
    vectors[:, :, 2] = -arm * (pose.rotor_speeds[rows] / max(hover, 1e-9)) ** 2
    arrows = rr.Arrows3D.columns(vectors=vectors.reshape(-1, 3)).partition([count] * len(rows))
    recording.send_columns("world/here/vehicle/thrust", index, arrows)


def _surroundings(recording: rr.RecordingStream, pose: Pose) -> None:
    """The wind at the vehicle, and its path."""
    arm = pose.arm
    rows = pose.drawn()
    wind = pose.wind[rows]
    speed = np.linalg.norm(wind, axis=1, keepdims=True)
    vectors = WIND_SCALE * arm * wind
    away = 1.4 * arm * wind / np.maximum(speed, 1e-9)  # its head stays out of the rotors
    colour = palette.channels(palette.DISTURBANCE)
    style = rr.Arrows3D.from_fields(radii=[0.05 * arm], colors=[colour], show_labels=True)
    recording.log("world/here/wind", style, static=True)
    labels = [f"wind {each:.1f} m/s" for each in speed[:, 0]]
    columns = rr.Arrows3D.columns(vectors=vectors, origins=-away - vectors, labels=labels)
    index = [rr.TimeColumn(BOOT_CLOCK, duration=pose.time[rows])]
    recording.send_columns("world/here/wind", index, columns)
    path = rr.LineStrips3D([pose.position[rows]], radii=0.004 * arm, colors=[TRAIL])
    recording.log("world/path", path, static=True)
