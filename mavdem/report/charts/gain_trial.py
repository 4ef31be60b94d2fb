"""Charts of what advised gains would do, over the same with the gains that flew: steps, tracking, and lean in wind."""

from collections.abc import Mapping

import numpy as np

from mavdem.arrays import Flags
from mavdem.assessment.axis.twin import GainTrial, TwinMotion, try_gains
from mavdem.assessment.evidence import Evidence
from mavdem.loops.advice import Advice, AdviceByAxis
from mavdem.loops.axis_loops import Loop
from mavdem.loops.step_response import step_from_frequency_response
from mavdem.report.charts.chart import TIME_AFTER_STEP, Axis, Chart, Group, Line, LineStyle
from mavdem.report.palette import COMMAND, PHYSICAL, PREDICTED

STEP_SECONDS = {"rate": 0.6, "attitude": 2.0}
"""Duration of the step responses that are drawn, s, by the loop."""
STEP_POINTS = 200
"""Points of a step response."""
TRACKING_SECONDS = 8.0
"""Longest part of the twin's flight on recorded setpoints that is drawn, s: that in which the setpoint moves most."""
HOVER_SECONDS = 4.0
"""Part of the twin's hover in wind that is drawn, s."""
GAIN_COLOURS = {"now": PREDICTED, "advised": PHYSICAL}
"""Colours of what the gains that flew do, and of what the advised ones would."""
TRIAL_TIME = Axis("time (s)")
"""Time since the twin's flight began."""
CAPTION = (
    "Blue: with the gains that flew; green: with the advised ones. Steps by the identified loops; the rest is flown by "
    "the twin, on the recorded setpoints and in a hover, in wind of the recorded spectrum."
)
"""What stands below the charts."""


def gain_trial_groups(evidence: Evidence, advice_by_axis: AdviceByAxis) -> dict[str, Group]:
    """Returns charts of each axis with new gains: what they would do, over the same with the gains that flew.

    The twin flies with the new gains of all axes at once. Where it cannot fly, there are step responses alone.

    Args:
        evidence: of the vehicle.
        advice_by_axis: advice on each axis, or why there is none.

    Returns:
        A group of charts by axis.
    """
    changed = dict[str, Advice]()
    gains = dict[str, float]()
    for axis, advice in advice_by_axis.items():
        if isinstance(advice, Advice) and advice.parameters:
            changed[axis] = advice
            gains |= advice.parameters
    trial = try_gains(evidence, gains) if changed else None
    groups = {}
    for axis, advice in changed.items():
        loops = {"now": advice.before, "advised": advice.after}
        columns = [_step_chart(loops, loop_name) for loop_name in STEP_SECONDS]
        if isinstance(trial, GainTrial):
            if axis in trial.tracking:
                motion = trial.tracking[axis]
                title = f"{axis.capitalize()} of the twin"
                columns.append(_motion_chart(title, motion, _liveliest_part(motion)))
            if axis in trial.wind:
                motion = trial.wind[axis]
                is_drawn = motion.time < HOVER_SECONDS
                columns.append(_motion_chart(f"{axis.capitalize()} in wind", motion, is_drawn))
        groups[axis] = Group.side_by_side(columns, CAPTION)
    return groups


def _step_chart(loops: Mapping[str, Loop], loop_name: str) -> Chart:
    """Returns the chart of the predicted step responses of one loop.

    Args:
        loops: loops of the axis, "now" and "advised".
        loop_name: "rate" or "attitude".
    """
    duration = STEP_SECONDS[loop_name]
    time = np.linspace(duration / STEP_POINTS, duration, STEP_POINTS)
    lines = []
    for name, loop in loops.items():
        open_loop = getattr(loop, loop_name)
        step = step_from_frequency_response(open_loop.frequency, open_loop.closed[0], time)
        lines.append(Line(name, GAIN_COLOURS[name], time, step))
    title = f"{next(iter(loops.values())).axis.capitalize()} {loop_name}: step"
    return Chart(title, TIME_AFTER_STEP, Axis("share of the step"), tuple(lines), (1.0,))


def _liveliest_part(motion: TwinMotion) -> Flags:
    """Returns which samples of a motion lie in the ``TRACKING_SECONDS`` in which the setpoint moves most (T,)."""
    starts = np.arange(0.0, max(motion.time[-1] - TRACKING_SECONDS, 0.0) + 1.0)
    parts = [(motion.time >= start) & (motion.time < start + TRACKING_SECONDS) for start in starts]
    return max(parts, key=lambda part: float(np.std(motion.setpoint[part])))


def _motion_chart(title: str, motion: TwinMotion, is_drawn: Flags) -> Chart:
    """Returns the chart of an angle of the twin, degrees, with both sets of gains and the setpoint.

    Args:
        title: axis and flight.
        motion: the whole motion, of which the title gives the error of the angle.
        is_drawn: which samples are drawn (T,).
    """
    errors = f"{motion.present_error:.2g} → {motion.advised_error:.2g}°"
    time = motion.time[is_drawn]
    lines = []
    if np.any(motion.setpoint):
        setpoint = np.degrees(motion.setpoint[is_drawn])
        lines.append(Line("setpoint", COMMAND, time, setpoint, style=LineStyle.DASHES))
    lines.append(Line("now", GAIN_COLOURS["now"], time, np.degrees(motion.present[is_drawn])))
    advised = np.degrees(motion.advised[is_drawn])
    lines.append(Line("advised", GAIN_COLOURS["advised"], time, advised))
    return Chart(f"{title}: error {errors}", TRIAL_TIME, Axis("angle (°)"), tuple(lines))
