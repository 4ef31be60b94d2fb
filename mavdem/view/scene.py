"""Scene: a vehicle in 3D, with its rotors' speed and thrust, the way it came and the wind that blows at it."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from mavdem.view.lines import FLIGHT_TIME
from mavdem.view.pose import Array, Pose

FRAMES_A_SECOND = 50
"""Of the 3D view."""
TRAIL, POINTS_A_SECOND = 4.0, 20
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

BODY, NOSE, GROUND = (210, 214, 220), (255, 107, 107), (70, 74, 80)
TRAIL_COLOUR, WIND_COLOUR = (94, 214, 120), (72, 219, 219)
SLOW, HOVERING, FAST = (60, 110, 255), (165, 165, 170), (255, 150, 30)
"""Colours of a rotor, by its speed beside that of the hover."""


def draw_scene(recording: rr.RecordingStream, pose: Pose) -> None:
    """Draws the vehicle and what is around it, all along the flight."""
    # North, east, down are to a world what forward, right, down are to a body.
    for place in ("world", "world/here"):
        recording.log(place, rr.ViewCoordinates.FRD, static=True)
    rows = pose.at(FRAMES_A_SECOND)
    _vehicle(recording, pose, rows)
    _surroundings(recording, pose, rows)


def scene_view(pose: Pose) -> rrb.View:
    """The view that the scene is seen in."""
    return rrb.Spatial3DView(
        name="The vehicle, its rotors' thrust, the way it came (green), the wind (turquoise)",
        # What moves along with the vehicle but does not turn with it: the eye does too.
        origin="world/here",
        contents="world/**",
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=pose.arm * np.array(EYE),
            look_target=pose.arm * np.array(TARGET),
            eye_up=(0, 0, -1),
        ),
    )


def _index(time: Array) -> list[rr.TimeColumn]:
    return [rr.TimeColumn(FLIGHT_TIME, duration=time)]


def _vehicle(recording: rr.RecordingStream, pose: Pose, rows: NDArray[np.intp]) -> None:
    """A box with a nose on four arms; each rotor's colour tells its speed, its arrow its thrust."""
    arm, index = pose.arm, _index(pose.time[rows])
    recording.send_columns("world/here", index, rr.Transform3D.columns(translation=pose.position[rows]))
    attitude = np.roll(pose.attitude[rows], -1, axis=1)  # Rerun has w last
    recording.send_columns("world/here/vehicle", index, rr.Transform3D.columns(quaternion=attitude))
    hubs = np.column_stack([pose.rotors, np.full(len(pose.rotors), -0.12 * arm)])
    body = rr.Boxes3D(half_sizes=[[0.34 * arm, 0.2 * arm, 0.1 * arm]], colors=BODY, fill_mode="solid")
    recording.log("world/here/vehicle/body", body, static=True)
    arms = rr.LineStrips3D([[[0, 0, 0], hub] for hub in hubs.tolist()], radii=0.03 * arm, colors=BODY)
    recording.log("world/here/vehicle/arms", arms, static=True)
    nose = rr.Arrows3D(vectors=[[0.75 * arm, 0, 0]], origins=[[0.3 * arm, 0, 0]], radii=0.04 * arm, colors=NOSE)
    recording.log("world/here/vehicle/nose", nose, static=True)
    count = len(hubs)
    discs = rr.Cylinders3D(lengths=[0.02 * arm] * count, radii=[0.48 * arm] * count, centers=hubs, fill_mode="solid")
    recording.log("world/here/vehicle/rotors", discs, static=True)
    speeds = pose.rotor_speeds
    carries = pose.carries()
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


def _surroundings(recording: rr.RecordingStream, pose: Pose, rows: NDArray[np.intp]) -> None:
    """The wind that blows at the vehicle, the way it came, and the ground, a line every metre."""
    lowest, highest = (np.clip(edge(pose.position[:, :2], axis=0), -FAR, FAR) for edge in (np.min, np.max))
    (north, east), (northern, eastern) = np.floor(lowest) - AROUND, np.ceil(highest) + AROUND
    squares = [[[n, east, 0], [n, eastern, 0]] for n in np.arange(north, northern + 1)]
    squares += [[[north, e, 0], [northern, e, 0]] for e in np.arange(east, eastern + 1)]
    recording.log("world/ground", rr.LineStrips3D(squares, radii=0.004, colors=[GROUND]), static=True)
    arm = pose.arm
    vectors = WIND_SCALE * arm * pose.wind[rows]
    # Its head stays out of the rotors.
    speed = np.linalg.norm(vectors, axis=1, keepdims=True)
    away = WIND_AWAY * arm * vectors / np.maximum(speed, 1e-9)
    recording.log("world/here/wind", rr.Arrows3D.from_fields(radii=[0.05 * arm], colors=[WIND_COLOUR]), static=True)
    columns = rr.Arrows3D.columns(vectors=vectors, origins=-away - vectors)
    recording.send_columns("world/here/wind", _index(pose.time[rows]), columns)
    now = pose.at(10)
    before = np.searchsorted(pose.time, pose.time[now] - TRAIL)
    step = max(len(pose.time) // len(pose.at(POINTS_A_SECOND)), 1)
    strips = [pose.position[first : last + 1 : step] for first, last in zip(before, now, strict=True)]
    recording.log("world/trail", rr.LineStrips3D.from_fields(radii=[0.022 * arm], colors=[TRAIL_COLOUR]), static=True)
    recording.send_columns("world/trail", _index(pose.time[now]), rr.LineStrips3D.columns(strips=strips))
