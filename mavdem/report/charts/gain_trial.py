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
"""Duration of the step responses that are drawn, s, by the loop: a choice, in which usual loops settle."""
STEP_POINTS = 200
"""Points of a step response that are drawn: a choice, enough for a smooth line."""
TRACKING_SECONDS = 8.0
"""Longest part of the twin's flight on recorded setpoints that is drawn, s: a choice.

It is the part in which the setpoint moves most.
"""
HOVER_SECONDS = 4.0
"""Part of the twin's hover in wind that is drawn, s: a choice."""
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

    Each axis has the step responses of its loops, computed from the identified plant, and the motion of the twin, which
    is a simulation of the vehicle with the plants of all axes. The twin flies with the new gains of all axes at once.
    Where it cannot fly, there are step responses alone.

    Args:
        evidence: what the log shows of the vehicle.
        advice_by_axis: advice on each axis, or why there is none.

    Returns:
        A group of charts for each axis whose gains change.
    """
    advice_on_changes = dict[str, Advice]()
    new_gains = dict[str, float]()
    for axis, advice in advice_by_axis.items():
        if isinstance(advice, Advice) and advice.parameters:
            advice_on_changes[axis] = advice
            new_gains |= advice.parameters
    if not advice_on_changes:
        return {}
    trial = try_gains(evidence, new_gains)
    groups = {}
    for axis, advice in advice_on_changes.items():
        loops = {"now": advice.before, "advised": advice.after}
        charts = [_step_chart(loops, loop_name) for loop_name in STEP_SECONDS]
        # Instead of flights there may be a fact, which states why the twin cannot fly.
        if isinstance(trial, GainTrial):
            charts += _twin_charts(axis, trial)
        groups[axis] = Group.side_by_side(charts, CAPTION)
    return groups


def _twin_charts(axis: str, trial: GainTrial) -> list[Chart]:
    """Returns the charts of the twin's flights about one axis: on recorded setpoints, and in a hover in wind.

    Args:
        axis: "roll", "pitch" or "yaw".
        trial: the flights; one that does not have the axis has no chart.
    """
    charts = []
    tracking_motion = trial.tracking.get(axis)
    if tracking_motion is not None:
        title = f"{axis.capitalize()} of the twin"
        is_drawn = _samples_of_most_movement(tracking_motion)
        charts.append(_motion_chart(title, tracking_motion, is_drawn))
    hover_motion = trial.wind.get(axis)
    if hover_motion is not None:
        is_drawn = hover_motion.time < HOVER_SECONDS
        charts.append(_motion_chart(f"{axis.capitalize()} in wind", hover_motion, is_drawn))
    return charts


def _step_chart(loops: Mapping[str, Loop], loop_name: str) -> Chart:
    """Returns the chart of the predicted step responses of one loop, with the gains that flew and the advised ones.

    Each is computed from the closed-loop frequency response of the estimated plant.

    Args:
        loops: loops of one axis, by "now" (with the gains that flew) and "advised".
        loop_name: "rate" or "attitude".
    """
    duration = STEP_SECONDS[loop_name]
    time = np.linspace(duration / STEP_POINTS, duration, STEP_POINTS)
    lines = []
    for name, loop in loops.items():
        open_loop = loop.rate if loop_name == "rate" else loop.attitude
        # Row 0 is the estimated plant; further rows are draws from its posterior.
        closed_loop_response = open_loop.closed[0]
        step = step_from_frequency_response(open_loop.frequency, closed_loop_response, time)
        lines.append(Line(name, GAIN_COLOURS[name], time, step))
    title = f"{loops['now'].axis.capitalize()} {loop_name}: step"
    return Chart(title, TIME_AFTER_STEP, Axis("share of the step"), tuple(lines), (1.0,))


def _samples_of_most_movement(motion: TwinMotion) -> Flags:
    """Returns which samples of a motion lie in the ``TRACKING_SECONDS`` in which the setpoint moves most.

    Windows that begin at each full second are compared by the standard deviation of their setpoint.

    Args:
        motion: the whole motion, T samples.

    Returns:
        Flags (T,).
    """
    last_start = max(motion.time[-1] - TRACKING_SECONDS, 0.0)
    windows = []
    for start in np.arange(0.0, last_start + 1.0):
        windows.append((motion.time >= start) & (motion.time < start + TRACKING_SECONDS))
    return max(windows, key=lambda is_in_window: float(np.std(motion.setpoint[is_in_window])))


def _motion_chart(title: str, motion: TwinMotion, is_drawn: Flags) -> Chart:
    """Returns the chart of an angle of the twin, degrees, with both sets of gains and the setpoint.

    Args:
        title: names the axis and the flight; the error of the angle with both sets of gains is added to it.
        motion: the whole motion, from which the error is computed.
        is_drawn: which samples are drawn (T,).
    """
    errors = f"{motion.present_error:.2g} → {motion.advised_error:.2g}°"
    time = motion.time[is_drawn]
    lines = []
    # In a hover the setpoint is 0 throughout, which needs no line.
    if np.any(motion.setpoint):
        setpoint = np.degrees(motion.setpoint[is_drawn])
        lines.append(Line("setpoint", COMMAND, time, setpoint, style=LineStyle.DASHES))
    lines.append(Line("now", GAIN_COLOURS["now"], time, np.degrees(motion.present[is_drawn])))
    advised = np.degrees(motion.advised[is_drawn])
    lines.append(Line("advised", GAIN_COLOURS["advised"], time, advised))
    return Chart(f"{title}: error {errors}", TRIAL_TIME, Axis("angle (°)"), tuple(lines))
