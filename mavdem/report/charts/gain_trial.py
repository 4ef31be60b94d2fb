"""Charts of a trial of advised gains, over those of the present gains: step responses, tracking, and lean in wind."""

from collections.abc import Sequence

import numpy as np

from mavdem.arrays import Flags
from mavdem.assessment.axis.responses import NO_RESPONSES, Responses
from mavdem.assessment.axis.twin import GainTrial, TwinMotion, try_gains
from mavdem.assessment.evidence import Evidence
from mavdem.facts import Fact
from mavdem.loops.advice import Advice, AdviceByAxis, advised_parameters
from mavdem.loops.axis_loops import LOOP_NAMES, LoopsByAxis
from mavdem.loops.identified_step import STEP_SECONDS, step_from_frequency_response
from mavdem.loops.step_response import StepResponse
from mavdem.report.charts.chart import Axis, Chart, Group, Line, LineStyle, step_chart
from mavdem.report.charts.flight_charts import LOOP_COLOURS
from mavdem.report.palette import TRUTH

STEP_POINTS = 200
"""Points of a step response that are drawn: a choice, enough for a smooth line."""
HOVER_SECONDS = 4.0
"""Part of the twin's hover in wind that is drawn, s: a choice."""
EQUAL_ERRORS = 0.1
"""Errors of the twin's two flights that differ by at most this part are stated as one.

A standard deviation of some 50 independent values, as of ten seconds in which a motion changes five times a second, is
known to 10 %.
"""
TRIAL_TIME = Axis("time (s)")
"""Time since the twin's flight began."""
CAPTION = (
    "The twin, a simulation by the identified loops, flies the recorded setpoints{hovers} with the gains that flew and "
    "with the new ones, in wind and gyro noise of the recorded spectra. Errors are the standard deviations of "
    "these seconds; those expected by wind torque alone are of long flights."
)
"""What stands below the charts of the twin, with a place for what it flies besides."""
STEP_CAPTION = "Steps by the identified loops. "
"""What stands before the caption where there are steps."""


def gain_trial_groups(
    evidence: Evidence,
    advice_by_axis: AdviceByAxis,
    responses: Responses = NO_RESPONSES,
    *,
    in_wind: bool = True,
    trial: GainTrial | Fact | None = None,
) -> dict[str, Group]:
    """Returns charts of each axis with new gains: the motion with them, drawn over that with the gains that flew.

    Each axis has the step responses of its loops, computed from the identified plant, and the motion of the twin, which
    is a simulation of the vehicle with the plants of all axes. The twin flies with the new gains of all axes at once.
    If it cannot fly, there are step responses alone.

    Args:
        evidence: signals, events and measurements of the vehicle, on which the twin flies if ``trial`` is None.
        advice_by_axis: advice on the gains of each axis, or the fact (coded finding) that says why there is none.
        responses: responses of each axis's loops, measured in the flight. For a loop with a measured step, another
            chart of the page has the steps, with the advised gains too; it gets no second one here.
        in_wind: whether the twin hovers in wind too, which takes as long as the flight on the recorded setpoints.
        trial: flights of the twin that were computed before, or the fact that says why it cannot fly; None to compute
            them here.

    Returns:
        A group of charts for each axis whose gains change; none if there is nothing to draw.
    """
    advice_on_changes = dict[str, Advice]()
    for axis, advice in advice_by_axis.items():
        if isinstance(advice, Advice) and advice.parameters:
            advice_on_changes[axis] = advice
    if not advice_on_changes:
        return {}
    if trial is None:
        trial = try_gains(evidence, advised_parameters(advice_by_axis), in_wind=in_wind)
    groups = {}
    for axis, advice in advice_on_changes.items():
        caption = CAPTION.format(hovers=", and hovers, both" if in_wind else "")
        charts = _charts_of_predicted_steps(axis, advice, responses)
        if charts:
            caption = STEP_CAPTION + caption
        # Instead of flights there may be a fact, which states why the twin cannot fly.
        if isinstance(trial, GainTrial):
            charts += twin_charts(axis, trial)
        if charts:
            groups[axis] = Group(_columns_without_gap(charts), caption)
    return groups


def _charts_of_predicted_steps(axis: str, advice: Advice, responses: Responses) -> list[Chart]:
    """Returns the step responses of an axis's loops with the present and the new gains, computed from its plant.

    Args:
        axis: "roll", "pitch" or "yaw".
        advice: the axis's identified loops, with the gains that flew and with the new ones.
        responses: measured responses by axis and loop. A loop with a measured step has a chart elsewhere on the page.
    """
    loops = {"now": advice.before, "new": advice.after}
    charts = []
    for loop_name in LOOP_NAMES:
        response = responses.get(axis, {}).get(loop_name)
        has_measured_step = response is not None and isinstance(response.measured, StepResponse)
        if not has_measured_step:
            charts.append(predicted_step_chart(loops, loop_name))
    return charts


def _columns_without_gap(charts: Sequence[Chart]) -> tuple[tuple[Chart, ...], ...]:
    """Distributes charts to columns, row by row: four to two rows of two, which leave no gap, fewer to a single row."""
    column_count = 2 if len(charts) == 4 else len(charts)
    return tuple(tuple(charts[column::column_count]) for column in range(column_count))


def twin_charts(axis: str, trial: GainTrial) -> list[Chart]:
    """Returns charts of how one axis moves with the present and with the advised gains in simulated flights.

    The twin, a simulated model of the vehicle with its identified loops, flies twice: one flight follows the recorded
    setpoints, the other is a hover in wind.

    Args:
        axis: "roll", "pitch" or "yaw".
        trial: the motion of the twin in both flights, by axis.

    Returns:
        A chart for each flight in which this axis was simulated.
    """
    charts = []
    tracking_motion = trial.tracking.get(axis)
    if tracking_motion is not None:
        title = f"{axis.capitalize()} of the twin"
        all_samples = np.ones(len(tracking_motion.time), bool)
        charts.append(_motion_chart(title, tracking_motion, all_samples))
    hover_motion = trial.wind.get(axis)
    if hover_motion is not None:
        title = f"{axis.capitalize()} of the twin in a hover"
        is_at_beginning = hover_motion.time < HOVER_SECONDS
        charts.append(_motion_chart(title, hover_motion, is_at_beginning))
    return charts


def predicted_step_chart(loops: LoopsByAxis, loop_name: str) -> Chart:
    """Returns the chart of the predicted step responses of one loop, with the gains that flew and any advised ones.

    A step response is computed from the closed-loop frequency response of the estimated plant, from the setpoint to the
    rate or angle, for ``STEP_SECONDS`` after the step.

    Args:
        loops: rate and attitude loop of one axis with the gains that flew, under "now"; and with the new gains, under
            "new", if gains change.
        loop_name: "rate" or "attitude", the loop of which steps are drawn.
    """
    duration = STEP_SECONDS[loop_name]
    time = np.linspace(0.0, duration, STEP_POINTS)
    lines = []
    # The line of the present gains is dashed and drawn last, so that both are seen where they are equal.
    for gains, style in (("new", LineStyle.LINE), ("now", LineStyle.DASHES)):
        if gains in loops:
            loop = loops[gains].open_loop(loop_name)
            step = step_from_frequency_response(loop.frequency, loop.closed_loop_of_estimate, time)
            lines.append(Line(gains, LOOP_COLOURS[gains], time, step, style=style))
    title = f"{loops['now'].axis.capitalize()} {loop_name}: identified step"
    return step_chart(title, lines)


def _motion_chart(title: str, motion: TwinMotion, is_drawn: Flags) -> Chart:
    """Returns the chart of an angle in a simulated flight, °: with the present gains, with the new ones, and setpoint.

    Args:
        title: names the axis and the flight. The error of the angle with both sets of gains, °, is added to it: one
            error if they hardly differ, and the standard deviation between both motions, whose lines lie on each other.
        motion: motion of the twin, the simulated vehicle, with both sets of gains.
        is_drawn: (T,) whether a sample is drawn; the errors are of all samples.
    """
    if abs(motion.expected_error - motion.present_error) <= EQUAL_ERRORS * motion.present_error:
        difference = np.degrees(np.std(motion.advised - motion.present))
        errors = (
            f"about {motion.expected_error:.2g}° with both gains; the motions differ by "
            f"{difference:.1g}°"
        )
    else:
        errors = f"{motion.present_error:.2g}° now, {motion.expected_error:.2g}° new"
    time = motion.time[is_drawn]
    lines = []
    # The setpoint of a hover is 0 throughout and needs no line.
    if np.any(motion.setpoint):
        setpoint = np.degrees(motion.setpoint[is_drawn])
        lines.append(Line("setpoint", TRUTH, time, setpoint, style=LineStyle.DASHES))
    advised_angle = np.degrees(motion.advised[is_drawn])
    present_angle = np.degrees(motion.present[is_drawn])
    lines.append(Line("new", LOOP_COLOURS["new"], time, advised_angle))
    # The line of the present gains is dashed and drawn last, so that both are seen where they are equal.
    lines.append(Line("now", LOOP_COLOURS["now"], time, present_angle, style=LineStyle.DASHES))
    return Chart(f"{title}: error {errors}", TRIAL_TIME, Axis("angle (°)"), tuple(lines))
