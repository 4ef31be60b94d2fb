"""Light on tracking: how roll and pitch follow their setpoints, at any rate of the log."""

from mavdem.assessment.evidence import Evidence
from mavdem.assessment.limits import worst_fact
from mavdem.dataset.axes import TILT_AXES
from mavdem.facts import Fact, Level
from mavdem.facts.margins import TrackingLight


def tracking_light(evidence: Evidence) -> Fact:
    """Judges how roll and pitch follow their setpoints, by the worse of the two; if both are unknown, what to log.

    Of two with the same level the one with the larger error is worse. If an overshoot is the worst, all axes that
    overshoot are named. A vehicle that oscillates may follow its setpoints well in the mean, but its light is to be
    watched at least.

    Args:
        evidence: what the log shows of the vehicle.

    Returns:
        A fact whose level is the colour of the light: good, watch, bad or unknown.
    """
    if evidence.other_vehicle is not None:
        return evidence.other_vehicle
    tracking = [evidence.tracking[axis] for axis in TILT_AXES]
    known = [fact for fact in tracking if fact.code is not TrackingLight.TRACKING_UNKNOWN]
    if not known:
        return tracking[0]
    by_error = sorted(known, key=lambda fact: fact.figures["angle_error"], reverse=True)
    light = worst_fact(by_error)
    if light.code is TrackingLight.OVERSHOOTS_SETPOINT:
        overshooting = [fact.figures["axis"] for fact in known if fact.code is light.code]
        return light.but(names=overshooting)
    if evidence.condition.oscillation is not None and light.is_good:
        return light.but(Level.WATCH)
    return light
