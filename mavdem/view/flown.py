"""A simulated flight in 3D as a Rerun recording, with its wind, thrust and path, and plots of its motion."""

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
from mavdem.view.plots import BOOT_CLOCK, MAX_STROKES, blueprint, draw_chart, recording_to_file
from mavdem.view.vehicle_scene import (
    POSITION_FRAME,
    SMALLEST_SPEED,
    VEHICLE_FRAME,
    WIND_ARROW_SCALE,
    log_axes,
    log_body,
    log_motion,
    log_path,
    log_wind,
    rotor_hubs,
)

PATH_RADIUS = 0.004
"""Radius of the line of the path, in arms of the vehicle."""

AIRBORNE_SPEED_SHARE = 0.9
"""Share of the rotor speed in hover above which the rotors carry the vehicle."""

EYE_POSITION = (-5.2, 2.2, -3.5)
"""Position of the viewer's eye, north, east and down of the vehicle, in lengths of an arm; a choice."""

EYE_TARGET = (0.0, 0.9, -0.2)
"""Point that the eye looks at, in the same frame and unit; a choice."""


@dataclass(frozen=True, eq=False)
class Pose:
    """N samples of a simulated flight for the 3D view; the world is NED, the body forward, right, down."""

    time: Array
    """(N,) s"""
    position: Array
    """(N, 3) m"""
    attitude: Array
    """(N, 4) unit quaternions (w, x, y, z), body to NED"""
    rates: Array
    """(N, 3) body rates, rad/s"""
    outputs: Array
    """(N, 4) motor outputs, µs"""
    rotor_speeds: Array
    """(N, 4) rad/s"""
    wind: Array
    """(N, 3) velocity of the air, NED, m/s"""
    moment: Array
    """(N, 3) disturbance moment about the body axes, N m"""
    armed: Flags
    """(N,) whether the motors are armed"""
    rotors: Array
    """(4, 2) positions of the rotors, forward and right of the centre of mass, m"""

    @property
    def motors(self) -> Names:
        """The names of the motors by their positions, such as "front right"."""
        names = []
        for forward, right in self.rotors:
            names.append(position_name((float(forward), float(right))))
        return tuple(names)

    @property
    def arm(self) -> float:
        """Distance of the farthest rotor from the centre of mass, m."""
        return float(np.hypot(*self.rotors.T).max())

    def airborne_samples(self) -> Flags:
        """Returns flags (N,) of the airborne samples, by the speed of the rotors; all samples if none is.

        The speed in hover is estimated as the median, while armed, of the mean rotor speed, since most of a flight is
        near hover. In a descent slightly slower rotors carry the vehicle, hence the factor ``AIRBORNE_SPEED_SHARE``.
        """
        speed = self.rotor_speeds.mean(axis=1)
        hover_speed = np.median(speed[self.armed]) if self.armed.any() else np.inf
        is_airborne = speed > AIRBORNE_SPEED_SHARE * hover_speed
        if not is_airborne.any():
            # A record without a flight is drawn as a whole.
            return np.ones_like(is_airborne)
        return is_airborne

    def drawn_samples(self) -> Indices:
        """Returns the indices of the samples that are drawn in 3D: every n-th of the flight.

        They come at about ``MIN_STREAM_RATE``, and less often in a long flight, which is drawn with no more than
        ``MAX_STROKES`` samples so that the viewer stays fast.
        """
        time_step = np.median(np.diff(self.time))
        count = len(self.time)
        stride = max(round(1 / MIN_STREAM_RATE / time_step), ceil(count / MAX_STROKES))
        return np.arange(0, count, stride)


def pose_from_motion(motion: object, rotors: Sequence[Sequence[float]]) -> Pose:
    """Collects what the 3D view shows of a simulated flight: its motion, and the positions of the rotors.

    The simulator is a separate package, which the view does not import. So its record is read by attributes with the
    names of the fields of ``Pose``.

    Args:
        motion: record of the simulated motion, with an attribute for each field of ``Pose`` except ``rotors``.
        rotors: two sequences with an entry for each rotor: its distances forward of the centre of mass, and those to
            the right of it, m. ``Pose`` has them as rows (rotors, 2).

    Returns:
        The pose over time.

    Raises:
        AttributeError: the record lacks a field.
    """
    values = {"rotors": np.column_stack(rotors)}
    for field in fields(Pose):
        if field.name != "rotors":
            values[field.name] = getattr(motion, field.name)
    return Pose(**values)


def write_pose(path: PathName, name: str, pose: Pose) -> None:
    """Writes the motion of a simulated flight to a Rerun recording (.rrd): 3D scene next to plots that play in a loop.

    The file is written completely or not at all.

    Args:
        path: path of the file.
        name: name of the recording.
        pose: samples of the flight, of which only :meth:`Pose.drawn_samples` enter the scene.

    Raises:
        OSError: the file cannot be written.
    """
    span = float(pose.time[0]), float(pose.time[-1])
    with recording_to_file(path, name) as recording:
        log_axes(recording)
        drawn = pose.drawn_samples()
        time = pose.time[drawn]
        log_motion(recording, time, pose.position[drawn], pose.attitude[drawn])
        log_body(recording, pose.rotors)
        _log_thrust(recording, pose)
        log_wind(recording, time, pose.wind[drawn], pose.arm)
        log_path(recording, pose.position[drawn], PATH_RADIUS * pose.arm)
        plots = []
        charts = motion_charts(pose)
        for number, chart in enumerate(charts):
            plots.append(draw_chart(recording, f"plots/{number}", chart, span, 1 / len(charts)))
        layout = rrb.Horizontal(scene_view(pose), rrb.Vertical(*plots), column_shares=[45, 55])
        layout_with_time = blueprint(layout, play_state="playing", loop_mode="all")
        recording.send_blueprint(layout_with_time, make_active=False)


def motion_charts(pose: Pose) -> list[Chart]:
    """Returns charts of a simulated flight while the vehicle is airborne, for the plots next to its 3D view.

    Args:
        pose: N samples of the simulation: attitude quaternions, rates (rad/s), motor outputs (µs), wind (m/s) and
            disturbance moment (N m).

    Returns:
        Charts of angles (°), rates (°/s), motor outputs as deviations from the mean of all motors (µs), wind (m/s) and
        disturbance moment (mN m).
    """
    airborne = pose.airborne_samples()
    time = pose.time[airborne]
    roll, pitch, yaw = euler_angles(pose.attitude[airborne])
    outputs = pose.outputs[airborne]
    # The mean of the motors carries the vehicle; the differences between them rotate it, and are plotted.
    output_deviations = outputs - outputs.mean(axis=1, keepdims=True)
    angles = np.degrees([roll, pitch, np.unwrap(yaw)])
    return [
        _chart("Angles", "°", AXES, time, angles),
        _chart("Rates", "°/s", AXES, time, np.degrees(pose.rates[airborne].T)),
        _chart(
            "Motor outputs, deviation from their mean", "µs", pose.motors, time, output_deviations.T
        ),
        _chart(
            "Wind, where the air moves to",
            "m/s",
            ("north", "east", "down"),
            time,
            pose.wind[airborne].T,
        ),
        _chart("Disturbance moment", "mN m", AXES, time, 1e3 * pose.moment[airborne].T),
    ]


def _chart(title: str, unit: str, names: Names, time: Array, series: Array) -> Chart:
    """Returns a chart of k series (k, N) over ``time`` (N,), s, in distinct colours."""
    lines = []
    for number, (name, values) in enumerate(zip(names, series, strict=True)):
        lines.append(Line(name, palette.distinct(number), time, values))
    return over_time(title, unit, tuple(lines))


def scene_view(pose: Pose) -> rrb.View:
    """Returns the Rerun view that shows a simulated vehicle in 3D from the south-east, with arrows of thrust and wind.

    Args:
        pose: the simulated flight. Its arm, m, is the length that all distances of the view are multiples of.

    Returns:
        The view, with the scale of the arrows in its title.
    """
    centimetres = 100 * WIND_ARROW_SCALE * pose.arm
    title = (
        f"Thrust arrows: an arm long at hover. Wind arrow: {centimetres:.2g} cm for 1 m/s. "
        "Green: the path"
    )
    # The eye is in the south-east and above, and looks past the vehicle, which leaves room for the wind in the east.
    eye = pose.arm * np.array(EYE_POSITION)
    target = pose.arm * np.array(EYE_TARGET)
    controls = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=eye, look_target=target, eye_up=(0, 0, -1)
    )
    # The eye moves with the vehicle, but does not turn with it.
    options: JsonValues = {"origin": POSITION_FRAME, "contents": "world/**", "line_grid": False}
    return rrb.Spatial3DView(name=title, eye_controls=controls, **options)


def _log_thrust(recording: rr.RecordingStream, pose: Pose) -> None:
    """Draws the thrust of each rotor as an upward arrow, which has the length of an arm in hover.

    Thrust is proportional to the square of the rotor speed, so the length is relative to that in hover.

    Args:
        recording: Rerun recording to draw into.
        pose: motion, rotor thrust and wind of the simulated flight, with its rotors.
    """
    drawn = pose.drawn_samples()
    rotor_count = len(pose.rotors)
    arm = pose.arm
    style = rr.Arrows3D.from_fields(
        origins=rotor_hubs(pose.rotors), radii=[0.025 * arm], labels=pose.motors
    )
    recording.log(f"{VEHICLE_FRAME}/thrust", style, static=True)
    hover_speed = np.median(pose.rotor_speeds[pose.airborne_samples()])
    relative_thrusts = (pose.rotor_speeds[drawn] / max(hover_speed, SMALLEST_SPEED)) ** 2
    time = pose.time[drawn]
    # An arrow for each sample and rotor. The third axis of the body points down.
    vectors = np.zeros((len(time), rotor_count, 3))
    vectors[:, :, 2] = -arm * relative_thrusts
    arrows_of_all_samples = rr.Arrows3D.columns(vectors=vectors.reshape(-1, 3))
    arrows = arrows_of_all_samples.partition([rotor_count] * len(time))
    index = [rr.TimeColumn(BOOT_CLOCK, duration=time)]
    recording.send_columns(f"{VEHICLE_FRAME}/thrust", index, arrows)
