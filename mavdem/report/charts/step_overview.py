"""Charts of the step responses of all axes, one for each loop: a glance at the tuning of a flight."""

from itertools import cycle

from mavdem.assessment.axis.responses import Responses
from mavdem.loops.axis_loops import LOOP_NAMES
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
        The charts by loop; loops without a measured response, or with a doubtful one, are left out.
    """
    colours = dict(zip(responses, cycle(DISTINCT), strict=False))
    # Rate comes before attitude, also if the rate of the first axis is left out.
    steps_by_loop: dict[str, dict[str, StepResponse]] = {name: {} for name in LOOP_NAMES}
    for axis, loops in responses.items():
        for loop_name, response in loops.items():
            if isinstance(response.measured, StepResponse) and not response.is_step_doubtful:
                steps_by_loop[loop_name][axis] = response.measured
    charts = {}
    for loop_name, step_by_axis in steps_by_loop.items():
        if not step_by_axis:
            continue
        are_all_identified = all(step.is_identified for step in step_by_axis.values())
        lines = []
        for axis, step in step_by_axis.items():
            is_named = step.is_identified and not are_all_identified
            name = f"{axis} (identified)" if is_named else axis
            lines.append(Line(name, colours[axis], step.time, step.step))
        kind = "identified step" if are_all_identified else "step"
        charts[loop_name] = step_chart(f"{loop_name.capitalize()}: {kind}", lines)
    return charts
