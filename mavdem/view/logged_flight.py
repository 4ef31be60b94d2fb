"""The 3D tab of a log's recording: the vehicle on its path with its attitude, and the mean wind."""

from math import ceil, floor, log10, radians

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from mavdem.arrays import Array
from mavdem.assessment.time_history import TimeHistory
from mavdem.dataset.axes import AXES
from mavdem.dataset.time_series import TimeSeries
from mavdem.ingest.vocabulary import quaternion
from mavdem.report.charts.plans import MIN_PATH_SIZE
from mavdem.report.numbers import rounded
from mavdem.view.plots import MAX_STROKES
from mavdem.view.vehicle_scene import (
    WIND_ARROW_SCALE,
    log_axes,
    log_body,
    log_motion,
    log_north,
    log_path,
    log_wind,
)
from mavdem.wind_velocity.compass import compass_text
from mavdem.wind_velocity.velocity import WindVelocity

ARM_SHARE = 0.05
"""Length of the drawn vehicle's arms, as a share of the largest extent of the path: a real one would be a dot."""

PATH_RADIUS = 0.015
"""Radius of the line of the path, in drawn arms."""

ROTORS = np.array([[1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]]) / np.sqrt(2)
"""(4, 2) rotors of the drawn vehicle, forward and right, in arms: a sign for any vehicle, not its own geometry."""

MIN_GROUND_LINES = 3
"""Least number of lines of the ground's grid along the largest extent of the path: a choice; 30 at most."""

GROUND_COLOUR = (128, 128, 128, 90)
"""Colour of these lines, RGBA: grey that shows on a dark and on a light page without hiding the path."""

EYE_DISTANCE = np.array([-0.8, 0.55, -0.6])
"""Where the eye is from the middle of the path, in extents of the path: south-east of it, and above."""


def flight_scene(
    recording: rr.RecordingStream, history: TimeHistory, wind: WindVelocity | None
) -> rrb.View | None:
    """Draws a logged flight in 3D, and returns its view; the vehicle is where and as it was at the time of the cursor.

    Args:
        recording: Rerun recording to draw into.
        history: the signals of the flight over time.
        wind: the wind of the flight; None if it is not known.

    Returns:
        The view; None if no position was recorded.
    """
    position = history.position
    if position is None:
        return None
    stride = ceil(len(position.time) / MAX_STROKES)
    time = position.time[::stride]
    path = position.values[::stride]
    extent = max(float(np.ptp(path, axis=0).max()), MIN_PATH_SIZE)
    arm = ARM_SHARE * extent
    log_axes(recording)
    log_motion(recording, time, path, _attitude_at(history, time))
    log_body(recording, arm * ROTORS)
    log_path(recording, path, PATH_RADIUS * arm)
    log_north(recording, path[0], arm)
    title = f"Path in 3D; the vehicle is drawn with arms of {rounded(arm)} m, its nose red"
    if wind is not None and wind.speed_identifiable and wind.direction_identifiable:
        _log_mean_wind(recording, float(time[0]), wind, arm)
        arrow_length = rounded(WIND_ARROW_SCALE * arm)
        title += f"; mean wind from {compass_text(wind.direction)}, {arrow_length} m for 1 m/s"
    return _view_of_path(path, extent, title)


def _log_mean_wind(
    recording: rr.RecordingStream, start_time: float, wind: WindVelocity, arm: float
) -> None:
    """Draws the mean wind of a flight as an arrow, from the beginning of the flight on.

    Args:
        recording: Rerun recording to draw into.
        start_time: beginning of the flight, s on the boot clock.
        wind: the wind, with its mean speed and direction.
        arm: length of an arm of the vehicle, m, which the length of the arrow follows.
    """
    # A wind's direction is where it blows from; the arrow points where the air moves to.
    angle = radians(wind.direction)
    velocity = -wind.mean_speed * np.array([[np.cos(angle), np.sin(angle), 0.0]])
    # The reports state the mean speed and its interval, which is wide if the drag is not known.
    low, high = wind.mean_speed_interval
    label = f"wind {low:.1f} to {high:.1f} m/s"
    log_wind(recording, np.array([start_time]), velocity, arm, [label])


def _view_of_path(path: Array, extent: float, title: str) -> rrb.View:
    """Returns a 3D view with its eye on the middle of a path, and a grid on the ground where the path begins.

    Height and direction are seen by the grid.

    Args:
        path: (N, 3) positions, m north, east and down.
        extent: size of the path, m, which decides the distance of the eye and the spacing of the grid.
        title: title of the view, to which the spacing is added.
    """
    middle = (path.min(axis=0) + path.max(axis=0)) / 2
    controls = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=middle + extent * EYE_DISTANCE,
        look_target=middle,
        eye_up=(0, 0, -1),
    )
    spacing = 10.0 ** floor(log10(extent / MIN_GROUND_LINES))
    ground = rrb.LineGrid3D(
        plane=rr.components.Plane3D((0.0, 0.0, 1.0), float(path[0, 2])),
        spacing=spacing,
        color=GROUND_COLOUR,
    )
    return rrb.Spatial3DView(
        name=f"{title}; grid of {spacing:g} m",
        origin="world",
        contents="world/**",
        eye_controls=controls,
        line_grid=ground,
    )


def _attitude_at(history: TimeHistory, time: Array) -> Array:
    """Returns the attitude of a recorded flight at given times, interpolated from its angles.

    Args:
        history: the flight over time; an angle that was not recorded counts as 0.
        time: times (N,), s on the boot clock.

    Returns:
        Unit quaternions (N, 4), w first, body to NED.
    """
    angles = []
    for axis in AXES:
        axis_history = history.axes[axis]
        if axis_history is None or axis_history.angle is None:
            angles.append(np.zeros(len(time)))
        else:
            angles.append(_angle_at(axis_history.angle.measured, time))
    roll, pitch, yaw = angles
    return quaternion(roll, pitch, yaw)


def _angle_at(angle: TimeSeries, time: Array) -> Array:
    """Returns an angle, rad, at other times, s; between two samples it turns the shorter way."""
    return np.interp(time, angle.time, np.unwrap(angle.values))
