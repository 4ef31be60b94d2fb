"""Loops that new gains make slower, by their predicted step responses."""

from typing import NamedTuple

from mavdem.facts import Fact, Figure
from mavdem.facts.loops import GainFact
from mavdem.loops.advice import Advice
from mavdem.loops.axis_loops import margin_rating
from mavdem.loops.gain_design import MIN_GAIN_CHANGE
from mavdem.loops.identified_step import STEP_SECONDS, PredictedStep, predicted_step


def facts_on_slower_rate(advice: Advice) -> list[Fact]:
    """Returns the fact that with the new gains the rate follows its setpoint more slowly, and for which margin.

    Args:
        advice: advice on the gains of an axis.

    Returns:
        A list with the fact; empty if the rate does not become slower (:func:`_slower_response`). If the rate loop
        lacks margin with the present gains, the figure by the name of the margin that it lacks most, such as "ms", has
        its values with the present and with the new gains.
    """
    response = _slower_response(advice, "rate")
    if response is None:
        return []
    rating = margin_rating(advice.before, advice.target)
    margins: dict[str, Figure] = {}
    if not rating.is_good and rating.subject == "rate":
        margin = rating.figures["lacking"]
        margins[margin] = (getattr(advice.before.rate, margin), getattr(advice.after.rate, margin))
    return [Fact(GainFact.RATE_SLOWER, None, **response.figures, **margins)]


def facts_on_slower_attitude(advice: Advice) -> list[Fact]:
    """Returns the fact that with the new gains the angle follows its setpoint more slowly, by the predicted steps.

    Higher gains of the rate may have that effect: with less of the integral term the angle overshoots less.

    Args:
        advice: advice on the gains of an axis.

    Returns:
        A list with the fact; empty if the angle does not become slower (:func:`_slower_response`).
    """
    response = _slower_response(advice, "attitude")
    if response is None:
        return []
    return [Fact(GainFact.ATTITUDE_SLOWER, None, **response.figures)]


class _SlowerResponse(NamedTuple):
    """Predicted steps of a loop that new gains make slower."""

    now: PredictedStep
    """With the gains that flew."""
    new: PredictedStep
    """With the new gains."""
    duration: float
    """Length of both, s, which is the rise time of a step that does not reach 90 % within it."""

    @property
    def figures(self) -> dict[str, Figure]:
        """Figures of a fact (coded finding): times to 63 % and from 10 to 90 %, with their intervals, now first.

        The loop may reach 63 % almost as soon as before and then take much longer to 90 %, so both are stated. By which
        factor a time grows is stated only if its intervals do not overlap (``is_factor_sure``, ``is_rise_factor_sure``)
        and the step reaches 90 % with the new gains.
        """
        response_now, response_new = self.now.response_time, self.new.response_time
        rise_now, rise_new = self.now.rise_time, self.new.rise_time
        return {
            "response_times": (response_now.value, response_new.value),
            "response_time_intervals": (response_now.interval, response_new.interval),
            "is_factor_sure": response_now.high < response_new.low,
            "rise_times": (rise_now.value, rise_new.value),
            "rise_time_intervals": (rise_now.interval, rise_new.interval),
            "is_rise_factor_sure": rise_now.high < rise_new.low,
            "duration": self.duration,
        }


def _slower_response(advice: Advice, loop_name: str) -> _SlowerResponse | None:
    """Returns the predicted steps of a loop now and with new gains, if these make it slower.

    It is slower if the step reaches 63 % later, or surely rises longer from 10 to 90 %.

    Args:
        advice: advice on the gains of an axis.
        loop_name: "rate" or "attitude".

    Returns:
        Both steps. None if no gains change, if a step cannot be predicted or does not reach 63 %, or if both times grow
        by less than ``MIN_GAIN_CHANGE``, a factor within what batteries and weather do to a loop.
    """
    if not advice.parameters:
        return None
    duration = STEP_SECONDS[loop_name]
    step_now = predicted_step(advice.before.open_loop(loop_name), duration)
    new_step = predicted_step(advice.after.open_loop(loop_name), duration)
    if step_now is None or new_step is None:
        return None
    if new_step.response_time.value >= duration:
        return None
    reaches_63_percent_later = (
        new_step.response_time.value >= MIN_GAIN_CHANGE * step_now.response_time.value
    )
    # The last tenth may take long by chance, so that the time to 90 % counts only beyond its interval.
    rises_longer = (
        new_step.rise_time.value >= MIN_GAIN_CHANGE * step_now.rise_time.value
        and new_step.rise_time.low > step_now.rise_time.high
    )
    if not (reaches_63_percent_later or rises_longer):
        return None
    return _SlowerResponse(step_now, new_step, duration)
