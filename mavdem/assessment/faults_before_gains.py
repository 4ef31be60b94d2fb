"""Faults of a vehicle that a pilot mends before loading new gains, by the most serious fact of a flight and its lights.

The next step after a flight and the one after tuning both begin with them.
"""

from mavdem.assessment.lights import OTHER_LIGHTS
from mavdem.assessment.lights.motors import is_range_taken_by_commands
from mavdem.facts import Fact, Facts, NamedFacts
from mavdem.facts.lights import Light
from mavdem.facts.margins import MarginsLight, TrackingLight

LIGHTS_BEFORE_GAINS = (Light.MOTORS, Light.VIBRATION, Light.POWER)
"""Lights whose faults are mended before new gains are loaded: motors, vibration and battery change the loops."""


def faults_before_gains(headline: Fact, lights: NamedFacts) -> Facts:
    """Returns the faults of a vehicle that a pilot mends before loading new gains, such as a weak motor.

    New gains fit the vehicle as it flew, and mending the motors, the vibration or the battery changes its control
    loops. A fault is the headline of the flight or one of the status lights (facts with a level, each about one part)
    in ``LIGHTS_BEFORE_GAINS``, if that is watch or bad and not about the control loops.

    Args:
        headline: the most serious fact of the flight.
        lights: its status lights by name.

    Returns:
        The faults; empty if nothing is to be mended.
    """
    candidates = [headline]
    for name in LIGHTS_BEFORE_GAINS:
        if name in lights:
            candidates.append(lights[name])
    faults_to_mend = []
    for fault in faults_besides_loops(headline, lights):
        # A fault whose only remedy is another flight is nothing to mend on the ground.
        has_remedy_on_ground = bool(fault.without_flight_advice.remedy)
        # Motors that only fast commands take to their limits are sound: new gains make these commands smaller.
        is_remedied_by_gains = is_range_taken_by_commands(fault)
        if fault in candidates and has_remedy_on_ground and not is_remedied_by_gains:
            faults_to_mend.append(fault)
    return tuple(faults_to_mend)


def faults_besides_loops(headline: Fact, lights: NamedFacts) -> list[Fact]:
    """Returns the faults of a flight that are not about its control loops, such as a weak motor or a low battery.

    Args:
        headline: the most serious fact of the flight.
        lights: its status lights by name: a fact (coded finding with a level) for each of eight subjects such as the
            motors.

    Returns:
        Facts with the level watch or bad, each once: the headline first, then the lights in their order.
    """
    candidates = [headline]
    for name, light in lights.items():
        # As in a headline, lights of the log and of the weather count only if they are bad.
        if light.is_bad or name not in OTHER_LIGHTS:
            candidates.append(light)
    faults: list[Fact] = []
    for fact in candidates:
        is_about_loops = isinstance(fact.code, MarginsLight | TrackingLight)
        if fact.is_watch_or_bad and not is_about_loops and fact not in faults:
            faults.append(fact)
    return faults
