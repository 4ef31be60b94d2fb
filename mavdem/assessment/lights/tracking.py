"""Status light of tracking, a fact (a coded finding): how roll, pitch and yaw follow their setpoints."""

from mavdem.assessment.evidence import Evidence
from mavdem.assessment.limits import worst_fact
from mavdem.dataset.axes import TILT_AXES
from mavdem.facts import Fact, Level
from mavdem.facts.margins import TrackingLight


def tracking_light(evidence: Evidence) -> Fact:
    """Judges how roll, pitch and yaw follow their setpoints, by the worst of the axes.

    Of axes with the same level, the worst has the largest ratio of its error to its limit, since limits differ between
    axes and grow with the movement of the setpoint. Yaw is judged only together with roll or pitch, whose errors tilt
    the vehicle, and only if it warns. If the worst fact is an overshoot, all axes that overshoot are named. A vehicle
    that oscillates may follow its setpoints well on average, but its light is at least "watch".

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        A fact whose level is the colour of the light: good, watch, bad or unknown. If roll and pitch are unknown, it is
        the fact of roll, which says what to log.
    """
    if evidence.other_vehicle is not None:
        return evidence.other_vehicle
    judged_facts = []
    for axis in TILT_AXES:
        if evidence.tracking[axis].code is not TrackingLight.TRACKING_UNKNOWN:
            judged_facts.append(evidence.tracking[axis])
    if not judged_facts:
        return evidence.tracking[TILT_AXES[0]]
    yaw_fact = evidence.tracking["yaw"]
    if yaw_fact.is_watch_or_bad:
        judged_facts.append(yaw_fact)
    # The function ``worst_fact`` returns the first of several facts with the same level, so the order decides.
    largest_error_first = sorted(judged_facts, key=_error_relative_to_limit, reverse=True)
    light = worst_fact(largest_error_first)
    if light.code is TrackingLight.OVERSHOOTS_SETPOINT:
        overshooting_axes = []
        for fact in judged_facts:
            if fact.code is TrackingLight.OVERSHOOTS_SETPOINT:
                overshooting_axes.append(fact.figures["axis"])
        return light.replace(names=overshooting_axes)
    if evidence.condition.oscillation is not None and light.is_good:
        return light.replace(Level.WATCH)
    return light


def _error_relative_to_limit(fact: Fact) -> float:
    """Returns the error in a fact about tracking, of the angle or else of the rate, relative to the limit."""
    if "rate_error_limit" in fact.figures:
        rate_error: float = fact.figures["rate_error"]
        rate_limit: float = fact.figures["rate_error_limit"]
        return rate_error / rate_limit
    error: float = fact.figures["angle_error"]
    limit: float = fact.figures["error_limit"]
    return error / limit
