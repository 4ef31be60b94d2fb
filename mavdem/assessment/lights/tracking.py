"""Status light of tracking, a fact (a coded finding): how roll, pitch and yaw follow their setpoints."""

from mavdem.assessment.evidence import Evidence
from mavdem.assessment.limits import worst_fact
from mavdem.dataset.axes import TILT_AXES
from mavdem.facts import Fact, Level
from mavdem.facts.margins import TrackingLight


def tracking_light(evidence: Evidence) -> Fact:
    """Judges how roll, pitch and yaw follow their setpoints, by the worst of the axes.

    Of axes with the same level the worst is the one with the largest ratio of its error to its limit, since limits
    differ between axes and grow with the movement of the setpoint. Yaw is judged only together with roll or pitch,
    whose errors tilt the vehicle, and only if it warns. If the worst fact is an overshoot, all axes that overshoot are
    named. A vehicle that oscillates may follow its setpoints well on average, but its light is at least "watch".

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        A fact whose level is the colour of the light: good, watch, bad or unknown. If roll and pitch are unknown, it is
        the fact of roll, which says what to log.
    """
    if evidence.other_vehicle is not None:
        return evidence.other_vehicle
    tilt_facts = [evidence.tracking[axis] for axis in TILT_AXES]
    judged_facts = [fact for fact in tilt_facts if fact.code is not TrackingLight.TRACKING_UNKNOWN]
    if not judged_facts:
        return tilt_facts[0]
    yaw_fact = evidence.tracking["yaw"]
    if yaw_fact.warns:
        judged_facts.append(yaw_fact)
    # The function ``worst_fact`` returns the first of several facts with the same level.
    nearest_to_bad_first = sorted(
        judged_facts,
        key=lambda fact: fact.figures["angle_error"] / fact.figures["error_limit"],
        reverse=True,
    )
    light = worst_fact(nearest_to_bad_first)
    if light.code is TrackingLight.OVERSHOOTS_SETPOINT:
        overshooting_axes = [
            fact.figures["axis"] for fact in judged_facts if fact.code is light.code
        ]
        return light.replace(names=overshooting_axes)
    if evidence.condition.oscillation is not None and light.is_good:
        return light.replace(Level.WATCH)
    return light
