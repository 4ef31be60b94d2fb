"""What 3D views are made of: the vehicle with position and attitude, its path, and the arrow of the wind.

Axes of the world are north, east, down; axes of the body forward, right, down. All lengths are in m.
"""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from mavdem.arrays import Array
from mavdem.report import palette
from mavdem.view.plots import BOOT_CLOCK

POSITION_FRAME = "world/here"
"""Entity that moves with the vehicle, but does not turn."""

VEHICLE_FRAME = "world/here/vehicle"
"""Entity that moves and turns with the vehicle."""

WIND_ARROW_SCALE = 0.4
"""Length of the wind's arrow for 1 m/s, in arms of the vehicle."""

WIND_ARROW_DISTANCE = 1.4
"""Distance of the head of the wind's arrow from the centre of the vehicle, in arms: it stays out of the rotors."""

SMALLEST_SPEED = 1e-9
"""Speed, m/s or rad/s, that keeps zero from being divided by."""

NORTH_ARROW_LENGTH = 3.0
"""Length of the arrow to the north, which begins where the path does, in arms."""

HUB_HEIGHT = 0.12
"""Height of the rotors above the body's centre, in arms."""

BODY_COLOUR = palette.channels(palette.BOUND)
NOSE_COLOUR = palette.channels(palette.BAD)
NORTH_COLOUR = palette.channels(palette.MEASURED)
PATH_COLOUR = palette.channels(palette.COMMAND)

# Proportions of the drawn vehicle, as fractions of the arm. They are chosen to look like a multirotor.

BODY_HALF_SIZE = (0.34, 0.2, 0.1)
"""Half of the length, width and height of the body."""

ARM_RADIUS = 0.03
"""Radius of an arm."""

NOSE_START = 0.3
"""Distance from the centre at which the arrow of the nose begins, inside of the body."""

NOSE_LENGTH = 0.75
"""Length of the arrow of the nose."""

NOSE_RADIUS = 0.04
"""Radius of the arrow of the nose."""

ROTOR_THICKNESS = 0.02
"""Thickness of a rotor's disc."""

ROTOR_RADIUS = 0.48
"""Radius of a rotor's disc. Those of a hexarotor, an arm apart, do not touch."""

NORTH_ARROW_RADIUS = 0.04
"""Radius of the arrow to the north, as a fraction of the arm."""


def log_axes(recording: rr.RecordingStream) -> None:
    """Names the axes of the world: north, east and down are to it what forward, right and down are to a body."""
    for frame in ("world", POSITION_FRAME):
        recording.log(frame, rr.ViewCoordinates.FRD, static=True)


def log_motion(
    recording: rr.RecordingStream, time: Array, position: Array, attitude: Array
) -> None:
    """Moves and rotates the vehicle: two nested entities have its position and its attitude.

    Args:
        recording: Rerun recording to draw into.
        time: (N,) s on the boot clock.
        position: (N, 3) north, east and down, m.
        attitude: (N, 4) unit quaternions (w, x, y, z), body to NED.
    """
    index = [rr.TimeColumn(BOOT_CLOCK, duration=time)]
    translations = rr.Transform3D.columns(translation=position)
    recording.send_columns(POSITION_FRAME, index, translations)
    # Rerun's quaternions have w last.
    rotations = rr.Transform3D.columns(quaternion=np.roll(attitude, -1, axis=1))
    recording.send_columns(VEHICLE_FRAME, index, rotations)


def rotor_hubs(rotors: Array) -> Array:
    """Returns (R, 3) the hubs of rotors (R, 2) in the body frame: above the body, where down is negative."""
    arm = float(np.hypot(*rotors.T).max())
    return np.column_stack([rotors, np.full(len(rotors), -HUB_HEIGHT * arm)])


def log_body(recording: rr.RecordingStream, rotors: Array) -> None:
    """Draws the vehicle once, in the body frame: a box with a red nose, and an arm to each rotor.

    Args:
        recording: Rerun recording to draw into.
        rotors: (R, 2) positions of the rotors, forward and right of the centre of mass, m.
    """
    hubs = rotor_hubs(rotors)
    arm = float(np.hypot(*rotors.T).max())
    arms = [[[0, 0, 0], hub] for hub in hubs.tolist()]
    body_half_size = arm * np.array(BODY_HALF_SIZE)
    shapes = {
        "body": rr.Boxes3D(half_sizes=[body_half_size], colors=BODY_COLOUR),
        "arms": rr.LineStrips3D(arms, radii=ARM_RADIUS * arm, colors=BODY_COLOUR),
        "nose": rr.Arrows3D(
            vectors=[[NOSE_LENGTH * arm, 0, 0]],
            origins=[[NOSE_START * arm, 0, 0]],
            radii=NOSE_RADIUS * arm,
            colors=NOSE_COLOUR,
        ),
        "rotors": rr.Cylinders3D(
            lengths=[ROTOR_THICKNESS * arm] * len(rotors),
            radii=[ROTOR_RADIUS * arm] * len(rotors),
            centers=hubs,
            colors=BODY_COLOUR,
            fill_mode="solid",
        ),
    }
    for name, shape in shapes.items():
        recording.log(f"{VEHICLE_FRAME}/{name}", shape, static=True)


def log_wind(
    recording: rr.RecordingStream,
    time: Array,
    wind: Array,
    arm: float,
    labels: Sequence[str] | None = None,
) -> None:
    """Draws an arrow of the wind that ends before the vehicle, labelled with the speed.

    The arrow moves with the vehicle but does not turn with it. It points where the air moves to, is
    ``WIND_ARROW_SCALE`` arms long for each m/s, and its head stays ``WIND_ARROW_DISTANCE`` arms upwind of the vehicle.

    Args:
        recording: Rerun recording to draw into.
        time: (N,) s on the boot clock.
        wind: (N, 3) velocity of the air, north, east and down, m/s.
        arm: length of an arm, m.
        labels: the N labels; None for the speeds.
    """
    speed = np.linalg.norm(wind, axis=1, keepdims=True)
    # The arrow is upwind of the vehicle, with its head at a fixed distance from it.
    vectors = WIND_ARROW_SCALE * arm * wind
    heads = -WIND_ARROW_DISTANCE * arm * wind / np.maximum(speed, SMALLEST_SPEED)
    colour = palette.channels(palette.DISTURBANCE)
    style = rr.Arrows3D.from_fields(radii=[0.05 * arm], colors=[colour], show_labels=True)
    recording.log(f"{POSITION_FRAME}/wind", style, static=True)
    if labels is None:
        labels = [f"wind {sample_speed:.1f} m/s" for sample_speed in speed[:, 0]]
    columns = rr.Arrows3D.columns(vectors=vectors, origins=heads - vectors, labels=labels)
    index = [rr.TimeColumn(BOOT_CLOCK, duration=time)]
    recording.send_columns(f"{POSITION_FRAME}/wind", index, columns)


def log_north(recording: rr.RecordingStream, start: Array, arm: float) -> None:
    """Draws an arrow to the north.

    Args:
        recording: Rerun recording to draw into.
        start: (3,) the first point of the path, where the arrow begins: north, east and down, m.
        arm: length of an arm, m.
    """
    north = rr.Arrows3D(
        vectors=[[NORTH_ARROW_LENGTH * arm, 0, 0]],
        origins=[start],
        radii=NORTH_ARROW_RADIUS * arm,
        labels=["north"],
        show_labels=True,
        colors=NORTH_COLOUR,
    )
    recording.log("world/north", north, static=True)


def log_path(recording: rr.RecordingStream, position: Array, radius: float) -> None:
    """Draws the flown path (N, 3), north, east and down, m, as a line of this radius, m."""
    path = rr.LineStrips3D([position], radii=radius, colors=[PATH_COLOUR])
    recording.log("world/path", path, static=True)
