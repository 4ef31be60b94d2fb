"""Status light of tracking: how roll, pitch and yaw follow their setpoints, at any rate of the log."""

from mavdem.assessment.evidence import Evidence
from mavdem.assessment.limits import worst_fact
from mavdem.dataset.axes import TILT_AXES
from mavdem.facts import Fact, Level
from mavdem.facts.margins import TrackingLight


def tracking_light(evidence: Evidence) -> Fact:
    """Judges how roll, pitch and yaw follow their setpoints, by the worst; if roll and pitch are unknown, what to log.

    Yaw alone says too little. Of axes with the same level the one with the largest error is worse, but a good yaw is
    not named in the place of roll or pitch, whose errors tilt the vehicle. If an overshoot is the worst, all axes that
    overshoot are named. A vehicle that oscillates may follow its setpoints well in the mean, but its light is to be
    watched at least.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        A fact whose level is the colour of the light: good, watch, bad or unknown.
    """
    if evidence.other_vehicle is not None:
        return evidence.other_vehicle
    tilt_tracking = [evidence.tracking[axis] for axis in TILT_AXES]
    known = [fact for fact in tilt_tracking if fact.code is not TrackingLight.TRACKING_UNKNOWN]
    if not known:
        return tilt_tracking[0]
    yaw_tracking = evidence.tracking["yaw"]
    if yaw_tracking.warns:
        known.append(yaw_tracking)
    by_error = sorted(known, key=lambda fact: fact.figures["angle_error"], reverse=True)
    light = worst_fact(by_error)
    if light.code is TrackingLight.OVERSHOOTS_SETPOINT:
        overshooting = [fact.figures["axis"] for fact in known if fact.code is light.code]
        return light.replace(names=overshooting)
    if evidence.condition.oscillation is not None and light.is_good:
        return light.replace(Level.WATCH)
    return light
