"""Status lights of a live vehicle: the worst finding (``Fact`` with a level) on each part of it, such as its motors."""

from __future__ import annotations

from collections.abc import Mapping

from mavdem.assessment.limits import worst_fact
from mavdem.facts import Code, Fact
from mavdem.facts.estimator import EstimatorLight
from mavdem.facts.lights import Light

MAXIMUM_FIGURES: Mapping[Code, str] = {EstimatorLight.FILTER_AGREED: "ratio"}
"""The figure in which a fact states a maximum, such as the largest innovation, by the code of the fact."""


class FlightLights:
    """The status lights of the latest flight of one vehicle: the worst fact on each part of it, by its name.

    They are kept after the landing, and when the autopilot restarts, until the next flight begins without any.

    Attributes:
        latest: lights of the latest flight so far.
        flight_number: number of that flight in the session, from 1; 0 before the first one.
    """

    def __init__(self, former: FlightLights | None = None) -> None:
        """Begins with the lights of the former boot.

        Args:
            former: lights at the end of the former boot; None for the first boot.
        """
        self.latest: dict[str, Fact] = {}
        self.flight_number = 0
        if former is not None:
            self.latest.update(former.latest)
            self.flight_number = former.flight_number

    def begin_flight(self) -> None:
        """Begins another flight, without lights."""
        self.flight_number += 1
        self.latest = {}

    def add(self, part: Light, fact: Fact) -> None:
        """Adds a fact on a part of the vehicle, which becomes its light in the latest flight unless that is worse.

        A fact may be about the last minute only. Where it states a maximum, such as the largest innovation, a fact of
        the same level with a larger maximum stays the light, since the maximum of a flight never decreases.

        Args:
            part: part of the vehicle, such as the motors.
            fact: what was found on it.
        """
        present_light = self.latest.get(str(part), fact)
        if not _states_larger_maximum(present_light, fact):
            self.latest[str(part)] = worst_fact([fact, present_light])

    def add_first(self, part: Light, fact: Fact) -> None:
        """Adds a fact on a part of the vehicle on which nothing has been found in the latest flight.

        Args:
            part: part of the vehicle, such as the motors.
            fact: what was found; it is ignored if the part has a light already.
        """
        self.latest.setdefault(str(part), fact)

    def replace(self, part: Light, former_code: Code, fact: Fact) -> None:
        """Replaces the light of a part by a newer fact on the same fault, even if that is better.

        Args:
            part: part of the vehicle, such as the motors.
            former_code: code of the fault. A light that states another fault stays as it is.
            fact: what is known of this fault now.
        """
        present_light = self.latest.get(str(part))
        if present_light is not None and present_light.code is former_code:
            self.latest[str(part)] = fact

    def move(self, former_fact: Fact | None, part: Light, fact: Fact) -> None:
        """Moves a fact to the light of another part of the vehicle, when its cause has become known.

        Args:
            former_fact: the fact as it was stated before, by the light of any part; None if it is new.
            part: the part that the fact is about, as is known now.
            fact: the fact with its cause.
        """
        remaining_lights = {}
        for name, light in self.latest.items():
            if light != former_fact:
                remaining_lights[name] = light
        self.latest = remaining_lights
        self.latest[str(part)] = fact

    def remove_good(self, part: Light) -> None:
        """Removes the light of a part if it is good, since that is no longer certain.

        Args:
            part: part of the vehicle, such as the motors. A light that warns stays.
        """
        present_light = self.latest.get(str(part))
        if present_light is not None and present_light.is_good:
            del self.latest[str(part)]


def _states_larger_maximum(present_light: Fact, fact: Fact) -> bool:
    """Returns whether a light states a larger maximum of the same quantity, at the same level, than another fact.

    Args:
        present_light: the fact that is the light of a part of the vehicle.
        fact: another fact on the same part.

    Returns:
        False if they are about different quantities, or state no maximum (``MAXIMUM_FIGURES``).
    """
    if present_light.code is not fact.code or present_light.level is not fact.level:
        return False
    maximum_name = MAXIMUM_FIGURES.get(fact.code)
    if maximum_name is None:
        return False
    return bool(present_light.figures[maximum_name] > fact.figures[maximum_name])
