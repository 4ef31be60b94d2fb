"""Charts of the step responses of all axes, one for each loop: a glance at the tuning of a flight."""

from itertools import cycle

from mavdem.assessment.axis.responses import Responses
from mavdem.loops.step_response import StepResponse
from mavdem.report.charts.chart import Chart, Line, step_chart
from mavdem.report.palette import DISTINCT


def step_overview_charts(responses: Responses) -> dict[str, Chart]:
    """Returns a chart of the measured step responses of all axes for each loop, such as "rate".

    A step that the messages were too slow to measure is that of the identified loop, and its line says so; where all
    are, the title does.

    Args:
        responses: responses by axis and loop.

    Returns:
        The charts by loop; loops without a measured response are left out.
    """
    measured_by_loop: dict[str, list[StepResponse]] = {}
    for loops in responses.values():
        for loop_name, response in loops.items():
            if isinstance(response.measured, StepResponse):
                measured_by_loop.setdefault(loop_name, []).append(response.measured)
    identified_loops = {
        loop_name
        for loop_name, steps in measured_by_loop.items()
        if all(step.is_identified for step in steps)
    }
    lines_by_loop: dict[str, list[Line]] = {}
    for (axis, loops), colour in zip(responses.items(), cycle(DISTINCT), strict=False):
        for loop_name, response in loops.items():
            measured_response = response.measured
            if isinstance(measured_response, StepResponse):
                is_named = measured_response.is_identified and loop_name not in identified_loops
                name = f"{axis} (identified)" if is_named else axis
                line = Line(name, colour, measured_response.time, measured_response.step)
                lines_by_loop.setdefault(loop_name, []).append(line)
    charts = {}
    for loop_name, lines in lines_by_loop.items():
        kind = "identified step" if loop_name in identified_loops else "step"
        title = f"{loop_name.capitalize()}: {kind}"
        charts[loop_name] = step_chart(title, lines)
    return charts
