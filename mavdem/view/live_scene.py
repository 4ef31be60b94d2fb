"""The 3D tab of a live flight: the vehicle with its present position, attitude and path, and the wind.

It is drawn by the same functions as a log (``vehicle_scene``). A log's path is known from the start; here it grows,
piece by piece.
"""

from collections.abc import Sequence
from math import inf

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from mavdem.containers import JsonValues, Numbers
from mavdem.ingest.vocabulary import quaternion
from mavdem.live.display import DisplayRow
from mavdem.report.numbers import rounded
from mavdem.view.logged_flight import PATH_RADIUS, ROTORS
from mavdem.view.plots import BOOT_CLOCK
from mavdem.view.vehicle_scene import (
    PATH_COLOUR,
    POSITION_FRAME,
    WIND_ARROW_SCALE,
    log_axes,
    log_body,
    log_motion,
    log_north,
    log_wind,
)

ARM = 1.0
"""Length of the drawn vehicle's arms, m: larger than most, so that it is seen on a path of some tens of metres."""

MIN_STEP = 0.1
"""Least time between two drawn positions, s: autopilots send them at 1 to 30 Hz, and rows come at 100 Hz."""

EYE_OFFSET = ARM * np.array((-9.0, 4.5, -6.0))
"""Where the eye is from the vehicle, m north, east and down: south-east of it, and above. It moves with the vehicle."""

MAX_PIECE_POINTS = 100
"""Points of a piece of the path, a choice: the latest piece is sent again with each batch, earlier ones never."""


def live_scene_view() -> rrb.View:
    """Returns the view of the 3D tab. Its eye moves with the vehicle, but does not turn with it."""
    length = rounded(WIND_ARROW_SCALE * ARM)
    title = (
        f"Path in 3D; the vehicle is drawn with arms of {rounded(ARM)} m, its nose red; "
        f"wind: {length} m for 1 m/s"
    )
    controls = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=EYE_OFFSET, look_target=(0, 0, 0), eye_up=(0, 0, -1)
    )
    options: JsonValues = {"origin": POSITION_FRAME, "contents": "world/**", "line_grid": False}
    return rrb.Spatial3DView(name=title, eye_controls=controls, **options)


class LiveScene:
    """Draws the poses of a live flight in 3D, beginning with the first row that has a position."""

    def __init__(self, recording: rr.RecordingStream) -> None:
        """Draws nothing yet.

        Args:
            recording: Rerun recording to draw into.
        """
        self._recording = recording
        # Time of the latest drawn position, s of the timeline, and the segment of its row.
        self._last_time = -inf
        self._last_segment: int | None = None
        # Points of the latest piece of the path, north, east and down, m, and the number of the piece.
        self._piece: list[Numbers] = []
        self._piece_number = 0
        self._wind_time = -inf

    def draw(self, rows: Sequence[DisplayRow]) -> None:
        """Draws the motion of the vehicle in the 3D scene: its pose, its path and the arrow of the wind.

        Args:
            rows: samples of the flight at one time each, in the order of time; those without a position are skipped.
        """
        times = []
        positions = []
        angles = []
        for row in rows:
            pose = row.pose
            if pose is None or pose.position is None:
                continue
            time = pose.time + row.timeline_offset
            if time - self._last_time < MIN_STEP:
                continue
            if self._last_segment is None:
                log_axes(self._recording)
                log_body(self._recording, ARM * ROTORS)
                log_north(self._recording, np.array(pose.position), ARM)
            self._add_to_path(pose.position, row.segment)
            self._last_time = time
            times.append(time)
            positions.append(pose.position)
            angles.append(pose.angles)
        if not times:
            return
        attitude = quaternion(*np.array(angles).T)
        log_motion(self._recording, np.array(times), np.array(positions), attitude)
        self._draw_path()
        self._draw_wind(rows[-1])

    def _add_to_path(self, position: Numbers, segment: int) -> None:
        """Adds a point to the path, which is drawn in pieces of at most ``MAX_PIECE_POINTS`` points.

        A piece that is full continues in a new piece, which begins with its last point. After a gap a new piece begins
        without a connection.

        Args:
            position: north, east and down, m.
            segment: number of the segment of data; a new number means that a gap, in which the path is not known, lies
                before.
        """
        follows_gap = self._last_segment is not None and segment != self._last_segment
        if follows_gap or len(self._piece) >= MAX_PIECE_POINTS:
            self._draw_path()
            self._piece = [] if follows_gap else self._piece[-1:]
            self._piece_number += 1
        self._last_segment = segment
        self._piece.append(position)

    def _draw_path(self) -> None:
        """Draws the latest piece of the path as of its last point: a time cursor before it does not show that."""
        if len(self._piece) < 2:
            return
        self._recording.set_time(BOOT_CLOCK, duration=self._last_time)
        line = rr.LineStrips3D([self._piece], radii=PATH_RADIUS * ARM, colors=[PATH_COLOUR])
        self._recording.log(f"world/path/{self._piece_number}", line)

    def _draw_wind(self, row: DisplayRow) -> None:
        """Draws the arrow of the wind in the 3D scene, if there is a new estimate of the wind.

        Args:
            row: the latest samples of the flight, with the estimates at their time.
        """
        wind = row.wind
        if wind is None or wind.time + row.timeline_offset <= self._wind_time:
            return
        self._wind_time = wind.time + row.timeline_offset
        velocity = np.append(wind.velocity, 0.0)
        log_wind(self._recording, np.array([self._wind_time]), velocity[None], ARM)
