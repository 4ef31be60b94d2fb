"""Registry of the status lights (good, watch, bad, unknown) of a log; each is a file here that judges one subject."""

from collections.abc import Callable
from typing import NamedTuple

from mavdem.assessment.lights.estimator import estimator_light
from mavdem.assessment.lights.log import log_light
from mavdem.assessment.lights.margins import margins_light
from mavdem.assessment.lights.motors import motors_light
from mavdem.assessment.lights.power import power_light
from mavdem.assessment.lights.tracking import tracking_light
from mavdem.assessment.lights.vibration import vibration_light
from mavdem.assessment.lights.wind import wind_light
from mavdem.facts import Fact
from mavdem.facts.lights import Light


class RegisteredLight(NamedTuple):
    """One light: its name, the function that judges it, and how it counts in the headline."""

    name: Light
    judge: Callable[..., Fact]
    """Returns the fact of the light, whose level is its colour, by the ``Evidence`` and the facts of ``needs``."""
    urgency: int
    """Place in the headline: of several bad lights the one with the lowest number is named."""
    is_of_vehicle: bool = True
    """Whether it judges the vehicle; otherwise it judges the log or the weather, of which only bad is a headline."""
    is_of_loops: bool = False
    """Whether the control loops decide on it, or on what to do about it; the others are known before these."""
    needs: tuple[Light, ...] = ()
    """Lights whose facts it is judged by too; they stand before it in the ``REGISTRY``."""


REGISTRY = (
    RegisteredLight(Light.MOTORS, motors_light, urgency=1),
    RegisteredLight(Light.VIBRATION, vibration_light, urgency=4),
    RegisteredLight(Light.TRACKING, tracking_light, urgency=3, is_of_loops=True),
    RegisteredLight(Light.MARGINS, margins_light, urgency=2, is_of_loops=True),
    RegisteredLight(Light.POWER, power_light, urgency=5),
    RegisteredLight(Light.ESTIMATOR, estimator_light, urgency=6),
    RegisteredLight(
        Light.WIND, wind_light, urgency=8, is_of_vehicle=False, needs=(Light.ESTIMATOR,)
    ),
    RegisteredLight(
        Light.LOG,
        log_light,
        urgency=7,
        is_of_vehicle=False,
        is_of_loops=True,
        needs=(Light.MARGINS,),
    ),
)
"""All lights in the order in which they are shown.

The motors are most urgent, since a weak motor explains small margins and bad tracking.
"""

_BY_URGENCY = sorted(REGISTRY, key=lambda light: light.urgency)

VEHICLE_LIGHTS = [light.name for light in _BY_URGENCY if light.is_of_vehicle]
"""Names of the lights that judge the vehicle, the most urgent first."""

OTHER_LIGHTS = [light.name for light in _BY_URGENCY if not light.is_of_vehicle]
"""Names of the lights that judge the log and the weather, the most urgent first."""
