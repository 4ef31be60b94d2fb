"""The line below the chart of a step response: whether the step was measured, and whether model and flight agree."""

from collections.abc import Sequence

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.axis.responses import LoopResponse
from mavdem.dataset.signals import rate_between_outages
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact
from mavdem.loops.step_response import MIN_RISE_MESSAGES, StepResponse
from mavdem.report.templates import render_section

FIT_MEANING = (
    "Fit: 100 % is no difference, 0 % one as large as the standard deviation of the measured step."
)
"""What the caption of a chapter adds if a line below a chart has the fit of a predicted step."""


def step_caption(
    response: LoopResponse | None, rate_and_setpoint: Sequence[TimeSeries] | None = None
) -> str:
    """Returns the line below the chart of a step, such as "Measured: overshoot 13 %, predicted 14 %; fit 85 %.".

    Args:
        response: the response of one loop; None, or with a fact in the place of the measured response, if the chart has
            only what the identified loop predicts.
        rate_and_setpoint: messages of the body rate and of its setpoint, by which the step of a rate is too fast or
            not; None for the step of an attitude.
    """
    if response is None or isinstance(response.measured, Fact):
        return _caption("predicted")
    step = response.measured
    compared_code = None if response.compared is None else response.compared.code
    if step.is_identified:
        return _caption("identified", step=step, compared_code=compared_code)
    if response.is_step_doubtful:
        return _caption("doubtful", step=step)
    fit = None
    predicted_overshoot = None
    if response.predicted_step is not None:
        fit = step_fit(step.step, response.predicted_step)
        predicted_overshoot = max(0.0, float(response.predicted_step.max()) - 1)
    return _caption(
        "measured",
        step=step,
        compared_code=compared_code,
        overshoot=max(0.0, step.overshoot.value),
        predicted_overshoot=predicted_overshoot,
        fit=fit,
        is_too_fast=rate_and_setpoint is not None and is_too_fast(step, rate_and_setpoint),
    )


def gain_caption(contradiction: Fact) -> str:
    """Returns the line below the chart of the gain |T| of a rate loop whose prediction the flight contradicts.

    Args:
        contradiction: that measured and predicted gain differ (``LoopResponse.contradiction``), a coded finding with
            the ``share`` of the frequencies.
    """
    return _caption("gain", share=contradiction.figures["share"])


def _caption(source: str, **values: object) -> str:
    """Returns the sentences of the template ``step_caption``.

    Args:
        source: where the step comes from: "measured", "doubtful", "identified" or "predicted"; "gain" for |T|.
        values: the other values of the template, by name.
    """
    [sentence] = render_section("step_caption", source=source, **values)
    return sentence.text


def has_fit(response: LoopResponse | None) -> bool:
    """Returns whether the line below the chart of a response has the fit of its predicted step."""
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


def is_too_fast(step: StepResponse, rate_and_setpoint: Sequence[TimeSeries]) -> bool:
    """Returns whether a measured step rises within fewer messages than it takes to measure it.

    Args:
        step: measured step of a body rate.
        rate_and_setpoint: messages of the rate and of its setpoint; the slower ones decide.
    """
    message_rate = min([rate_between_outages(series) for series in rate_and_setpoint])
    return step.rise_time.value < MIN_RISE_MESSAGES / message_rate
