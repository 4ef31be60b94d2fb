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
    loops. So these are the status lights (judgements of one part with a level) of ``LIGHTS_BEFORE_GAINS`` and the
    headline of the flight, as far as they are watch or bad, are not about the loops, and can be mended. Motors that
    only fast commands take to their limits are no such fault: new gains make these commands smaller.

    Args:
        headline: the most serious fact of the flight.
        lights: the facts of its status lights by name.

    Returns:
        The faults, coded findings; empty if nothing is to be mended.
    """
    facts_that_matter = [headline]
    for name in LIGHTS_BEFORE_GAINS:
        if name in lights:
            facts_that_matter.append(lights[name])
    faults_to_mend = []
    for fault in faults_besides_loops(headline, lights):
        # What only another flight can clear up is nothing to mend.
        is_mendable = bool(fault.without_flight_advice.remedy)
        is_of_gains = is_range_taken_by_commands(fault)
        if fault in facts_that_matter and is_mendable and not is_of_gains:
            faults_to_mend.append(fault)
    return tuple(faults_to_mend)


def faults_besides_loops(headline: Fact, lights: NamedFacts) -> list[Fact]:
    """Returns what a flight shows to be watch or bad about anything but its control loops, each finding once.

    Args:
        headline: the most serious fact of the flight.
        lights: its status lights by name: a fact (coded finding with a level) for each of eight subjects such as the
            motors.

    Returns:
        The headline, if it is such a finding, and the facts of the lights in their order.
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
