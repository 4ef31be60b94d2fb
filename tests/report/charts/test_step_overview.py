"""The row of step responses: one chart for each loop, with a line for each axis that was measured."""

import numpy as np

from mavdem.assessment.axis.responses import LoopResponse
from mavdem.facts import Fact
from mavdem.facts.loops import StepResponseFact
from mavdem.loops.step_response import StepResponse
from mavdem.report.charts.step_overview import step_overview_charts


def measured_response(height, *, is_identified=False):
    """Returns a response that is constant at ``height``, with the attributes that a chart reads."""
    response = object.__new__(StepResponse)
    object.__setattr__(response, "time", np.linspace(0.0, 0.5, 11))
    object.__setattr__(response, "step", np.full(11, height))
    object.__setattr__(response, "is_identified", is_identified)
    return response


def test_each_loop_has_a_chart_with_a_line_for_each_axis_that_was_measured():
    """Rate and attitude responses were measured of some axes."""
    unknown = Fact(StepResponseFact.TOO_SLOW)
    heights = {"roll": (0.9, None), "pitch": (1.1, 1.0), "yaw": (None, None)}
    responses = {}
    for axis, loops in heights.items():
        responses[axis] = {
            loop: LoopResponse(unknown if height is None else measured_response(height))
            for loop, height in zip(("rate", "attitude"), loops, strict=True)
        }
    charts = step_overview_charts(responses)
    lines = {loop: {line.name: line.y[0] for line in chart.lines} for loop, chart in charts.items()}
    assert lines == {"rate": {"roll": 0.9, "pitch": 1.1}, "attitude": {"pitch": 1.0}}
    colours = {line.name: line.colour for line in charts["rate"].lines}
    assert colours["roll"] != colours["pitch"] == charts["attitude"].lines[0].colour


def test_a_step_that_was_not_measured_is_called_identified():
    identified = LoopResponse(measured_response(1.0, is_identified=True))
    chart = step_overview_charts({"roll": {"rate": identified}})["rate"]
    assert (chart.title, chart.lines[0].name) == ("Rate: identified step", "roll")
    measured = LoopResponse(measured_response(1.0))
    chart = step_overview_charts({"roll": {"rate": identified}, "yaw": {"rate": measured}})["rate"]
    assert chart.title == "Rate: step"
    assert [line.name for line in chart.lines] == ["roll (identified)", "yaw"]
