"""Charts of the step responses of all axes, one for each loop: a glance at the tuning of a flight."""

from collections.abc import Mapping
from itertools import cycle

from mavdem.assessment.axis.responses import Responses
from mavdem.loops.axis_loops import LOOP_NAMES
from mavdem.loops.step_response import StepResponse
from mavdem.report.charts.chart import Chart, Line, step_chart
from mavdem.report.palette import DISTINCT


def step_overview_charts(responses: Responses) -> dict[str, Chart]:
    """Returns for each loop, "rate" and "attitude", a chart of the step responses of all axes.

    Args:
        responses: the measured responses by axis ("roll") and loop ("rate").

    Returns:
        The charts by loop. Axes whose step was not measured, or is doubtful, have no line; loops without a line have no
        chart.
    """
    colours = dict(zip(responses, cycle(DISTINCT), strict=False))
    # Rate comes before attitude, also if the rate of the first axis is left out.
    steps_by_loop: dict[str, dict[str, StepResponse]] = {name: {} for name in LOOP_NAMES}
    for axis, loops in responses.items():
        for loop_name, response in loops.items():
            if isinstance(response.measured, StepResponse) and not response.is_step_doubtful:
                steps_by_loop[loop_name][axis] = response.measured
    return {
        loop_name: _chart_of_steps(loop_name, step_by_axis, colours)
        for loop_name, step_by_axis in steps_by_loop.items()
        if step_by_axis
    }


def _chart_of_steps(
    loop_name: str, step_by_axis: Mapping[str, StepResponse], colours: Mapping[str, str]
) -> Chart:
    """Returns the chart of the step responses of one loop, with a line for each axis.

    Where messages came too slowly to measure a step, it is computed from the identified loop. The legend says so of
    such a line; if all lines are such, the title says it once.

    Args:
        loop_name: "rate" or "attitude".
        step_by_axis: step response of each axis, at least one.
        colours: colour of the line of each axis.
    """
    are_all_identified = all(step.is_identified for step in step_by_axis.values())
    lines = []
    for axis, step in step_by_axis.items():
        name = axis
        if step.is_identified and not are_all_identified:
            name = f"{axis} (identified)"
        lines.append(Line(name, colours[axis], step.time, step.step))
    kind = "identified step" if are_all_identified else "step"
    return step_chart(f"{loop_name.capitalize()}: {kind}", lines)
