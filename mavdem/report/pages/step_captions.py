"""The line below the chart of a step response: whether the step was measured, and whether model and flight agree."""

from collections.abc import Sequence
from math import inf

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.axis.responses import LoopResponse
from mavdem.dataset.signals import rate_between_outages
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact
from mavdem.loops.step_response import StepResponse, least_rise_time
from mavdem.report.templates import render_section

FIT_MEANING = (
    "Overshoot and fit are of the lines as drawn. Fit: 100 % is no difference, 0 % one as large as the standard "
    "deviation of the measured line."
)
"""What the caption of a chapter adds if a line below a chart has the fit of a predicted step."""


def step_caption(
    response: LoopResponse | None,
    end: float = inf,
    rate_and_setpoint: Sequence[TimeSeries] | None = None,
) -> str:
    """Returns the line below the chart of a step, such as "Measured: overshoot 13 %, predicted 14 %; fit 85 %.".

    Its figures are those of the lines as far as they are drawn, so that the chart shows them.

    Args:
        response: the response of one loop; None, or with a fact in the place of the measured response, if the chart has
            only what the identified loop predicts.
        end: time at which the chart ends, s after the step.
        rate_and_setpoint: messages of the body rate and of its setpoint, by which the step of a rate is too fast or
            not; None for the step of an attitude.
    """
    if response is None or isinstance(response.measured, Fact):
        return _caption("predicted")
    step = response.measured
    if step.is_identified:
        # Only the step of a rate can be that of the identified loop.
        assert rate_and_setpoint is not None
        return _caption(
            "identified",
            step=step,
            compared_code=None if response.compared is None else response.compared.code,
            message_rate=_message_rate(rate_and_setpoint),
            least_rise_time=least_rise_time(_message_rate(rate_and_setpoint)),
        )
    if response.is_step_doubtful:
        return _caption("doubtful", step=step)
    rises_too_fast = False
    if rate_and_setpoint is not None:
        shortest_rise = least_rise_time(_message_rate(rate_and_setpoint))
        rises_too_fast = step.rise_time.value < shortest_rise
    return _caption_of_measured_step(response, step, end, rises_too_fast=rises_too_fast)


def _caption_of_measured_step(
    response: LoopResponse, step: StepResponse, end: float, *, rises_too_fast: bool
) -> str:
    """Returns the line below the chart of a measured step: its overshoot and, if it was predicted, how well that fits.

    Args:
        response: the response of one loop, with the predicted step if it is known.
        step: the measured step in it.
        end: time at which the chart ends, s after the step.
        rises_too_fast: whether the step rises within fewer messages than it takes to measure it.
    """
    fit = None
    predicted_overshoot = None
    is_drawn = step.time <= end
    measured_step = step.step[is_drawn]
    if response.predicted_step is not None:
        predicted_step = response.predicted_step[is_drawn]
        fit = step_fit(measured_step, predicted_step)
        predicted_overshoot = _overshoot(predicted_step)
    return _caption(
        "measured",
        step=step,
        compared_code=None if response.compared is None else response.compared.code,
        overshoot=_overshoot(measured_step),
        predicted_overshoot=predicted_overshoot,
        fit=fit,
        is_too_fast=rises_too_fast,
    )


def _overshoot(step: Array) -> float:
    """Returns the overshoot of a response (K,) to a step of 1, such as 0.13; 0 if it stays below 1."""
    return max(0.0, float(step.max()) - 1)


def gain_caption(compared: Fact | None) -> str:
    """Returns the line below the chart of the measured gain |T| of a rate loop: whether the prediction agrees.

    Args:
        compared: whether measured and predicted gain agree (``LoopResponse.compared``), a coded finding with the
            ``share`` of the frequencies at which they differ, if they do; None if the two were not compared.
    """
    share = None if compared is None or compared.is_good else compared.figures["share"]
    return _caption("gain", is_compared=compared is not None, share=share)


def _caption(source: str, **values: object) -> str:
    """Returns the sentences of the template ``step_caption``.

    Args:
        source: where the step comes from: "measured", "doubtful", "identified" or "predicted"; "gain" for |T|.
        values: the other values of the template, by name.
    """
    [sentence] = render_section("step_caption", source=source, **values)
    return sentence.text


def has_fit(response: LoopResponse | None) -> bool:
    """Returns whether the line below the chart of a step says how well the predicted step fits the measured one.

    It does for a step that was measured, is not doubtful, and has a prediction.
    """
    if response is None or isinstance(response.measured, Fact) or response.is_step_doubtful:
        return False
    return response.predicted_step is not None and not response.measured.is_identified


def step_fit(measured_step: Array, predicted_step: Array) -> float:
    """Returns how well a predicted step response fits a measured one, both (K,) at the same times.

    Returns:
        1 less the RMS of their difference relative to the standard deviation of the measured step; at least 0.
    """
    error = np.sqrt(np.mean((measured_step - predicted_step) ** 2))
    return max(0.0, 1 - float(error / measured_step.std()))


def _message_rate(rate_and_setpoint: Sequence[TimeSeries]) -> float:
    """Returns the rate, Hz, of the slower messages among those of a body rate and of its setpoint."""
    return min([rate_between_outages(series) for series in rate_and_setpoint])
