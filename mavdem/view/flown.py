"""Flown: a simulated flight as a Rerun file: the vehicle in its wind, and beside it what the autopilot knew and did."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from mavdem.euler import roll_and_pitch
from mavdem.view import lines
from mavdem.view.lines import FLIGHT_TIME, Line
from mavdem.view.pose import Array, Pose
from mavdem.view.scene import draw_scene, scene_view
from mavdem.view.ticks import LABELS_IF_LOW, readable_range
from mavdem.whole_file import whole_file


def write_pose(path: str | os.PathLike[str], name: str, pose: Pose) -> None:
    """Writes a flight as an .rrd file that opens with its own blueprint; it appears whole or not at all.

    Args:
        path: the file, in a folder that is there.
        name: of the recording.
        pose: the flight.

    Raises:
        OSError: it cannot be written there.
    """
    recording = rr.RecordingStream("mavdem_flight")
    memory = recording.memory_recording()
    shown = list(_plots(pose))
    recording.send_blueprint(_blueprint(pose, shown), make_active=False)
    # A file's name need not be UTF-8, and what Rerun is given must be.
    recording.send_recording_name(name.encode(errors="replace").decode())
    draw_scene(recording, pose)
    for plot in shown:
        plot.draw(recording, pose)
    with whole_file(path) as file:
        # Rerun does not tell when a file it writes fails, as on a full disk; Python does.
        file.write(memory.drain_as_bytes())


class _Plot:
    """One picture over time at the entity ``origin``: ``series`` of name, colour, width and values (N,)."""

    def __init__(self, origin: str, title: str, series: list[tuple[str, lines.Colour, float, Array]]) -> None:
        self.origin, self.title, self.series = origin, title, series

    def draw(self, recording: rr.RecordingStream, pose: Pose) -> None:
        rows = pose.at(np.inf)
        for place, (name, colour, width, values) in enumerate(self.series):
            # Drawn in the order of their paths.
            path = rr.new_entity_path([self.origin, f"{place} {name}"])
            Line(path, name, colour, width).over_time(recording, pose.time[rows], values[rows])

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


def _plots(pose: Pose) -> Iterator[_Plot]:
    roll = [("true", lines.PREDICTED, 4.0, _roll(pose.attitude)), _measured(_roll(pose.known_attitude))]
    yield _Plot("roll", "Roll, °", roll)
    rate = [
        ("true", lines.PREDICTED, 4.0, np.degrees(pose.rates[:, 0])),
        _measured(np.degrees(pose.known_rates[:, 0])),
    ]
    yield _Plot("roll_rate", "Roll rate, °/s", rate)
    yield _Plot("motors", "Motor outputs, µs", _several("motor 1,motor 2,motor 3,motor 4", pose.outputs))
    yield _Plot("wind", "Wind at the vehicle, m/s, where it blows to", _several("north,east,down", pose.wind))
    moment = _several("roll,pitch,yaw", 1e3 * pose.moment)
    yield _Plot("moment", "Moment of the disturbance, mN m", moment)


def _measured(values: Array) -> tuple[str, lines.Colour, float, Array]:
    return "known to the autopilot", lines.MEASURED, 1.2, values


def _several(names: str, table: Array) -> list[tuple[str, lines.Colour, float, Array]]:
    return [(name, lines.distinct(i), 1.2, table[:, i]) for i, name in enumerate(names.split(","))]


def _roll(attitude: Array) -> Array:
    """(N,) degrees, of unit quaternions (N, 4)."""
    return np.degrees(roll_and_pitch(attitude)[0])


def _blueprint(pose: Pose, plots: list[_Plot]) -> rrb.Blueprint:
    """The vehicle to the left, and the plots to the right, one above the other."""
    end, carries = float(pose.time[-1]), pose.carries()
    return rrb.Blueprint(
        rrb.Horizontal(
            scene_view(pose), rrb.Vertical(*(plot.view(end, carries) for plot in plots)), column_shares=[45, 55]
        ),
        rrb.TimePanel(state="collapsed", timeline=FLIGHT_TIME, play_state="playing", loop_mode="all"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )
