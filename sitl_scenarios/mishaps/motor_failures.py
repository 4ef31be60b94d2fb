"""Motors and propellers that fail: the remaining thrust of each rotor over time, as damage of the vehicle."""

from math import sqrt
from typing import NamedTuple

from numpy.random import Generator

from sitl_scenarios.mishaps.specs import LoosePropeller, MotorFade, MotorStop

FADE_STEP_SECONDS = 0.1
"""Time between two steps of a motor that fades, s; a choice."""

MEAN_SLIP_SECONDS = 0.4
"""Mean time for which a loose propeller slips, or does not, s; a choice."""


class ThrustStep(NamedTuple):
    """A time from which on a motor has a new share of its thrust."""

    time: float
    """Time after arming, s."""

    share: float
    """Share of the thrust that is left, 0 to 1."""


def remaining_thrust_history(
    mishap: MotorStop | MotorFade | LoosePropeller, end: float, random: Generator
) -> list[ThrustStep]:
    """Lists the remaining thrust of a failing motor over time, as a fraction of the thrust of a sound one, in steps.

    A motor that stops has one step to 0. One that fades has steps of ``FADE_STEP_SECONDS``. A loose propeller slips and
    grips by turns, for times that are exponentially distributed.

    Args:
        mishap: Mishap with the failing motor or propeller.
        end: Time of the flight's end, s after arming.
        random: Generator that decides when a loose propeller slips.

    Returns:
        The steps in ascending order of time; a fraction holds until the next step.
    """
    if isinstance(mishap, MotorStop):
        return [ThrustStep(mishap.start, 0.0)]
    history = []
    if isinstance(mishap, MotorFade):
        step_count = round(mishap.seconds / FADE_STEP_SECONDS)
        for step in range(1, step_count + 1):
            remaining_fraction = 1.0 - (1.0 - mishap.thrust) * step / step_count
            time = mishap.start + step * FADE_STEP_SECONDS
            history.append(ThrustStep(time, remaining_fraction))
        return history
    time = mishap.start
    slips = True
    while time < end:
        history.append(ThrustStep(time, mishap.thrust if slips else 1.0))
        time += float(random.exponential(MEAN_SLIP_SECONDS))
        slips = not slips
    return history


def remaining_speed(thrust: float) -> float:
    """Returns the share of a rotor's speed that gives a share of its ``thrust``, proportional to its square."""
    return sqrt(thrust)
