"""Lights of a live vehicle: the worst finding (fact) on each part of it, such as its motors, in its flights so far."""

from __future__ import annotations

from collections.abc import Mapping

from mavdem.assessment.limits import worst_fact
from mavdem.facts import Code, Fact, NamedFacts
from mavdem.facts.estimator import EstimatorLight
from mavdem.facts.lights import Light

MAXIMUM_FIGURES: Mapping[Code, str] = {EstimatorLight.FILTER_AGREED: "ratio"}
"""The figure in which a fact states a maximum, such as the largest innovation, by the code of the fact."""


class FlightLights:
    """The lights of one vehicle: the worst fact on each part of it, such as its motors or its power.

    Attributes:
        latest: lights of the latest flight so far, by the name of the part.
        earlier: lights of all flights of the session before it.
    """

    def __init__(
        self, former: FlightLights | None = None, *, has_flight_gone_on: bool = False
    ) -> None:
        """Begins with the lights of the former boot.

        Args:
            former: lights at the end of the former boot; None for the first boot.
            has_flight_gone_on: whether that boot ended in flight, so that its flight is still the latest one.
        """
        self.latest: dict[str, Fact] = {}
        self.earlier: dict[str, Fact] = {}
        if former is not None and has_flight_gone_on:
            self.earlier.update(former.earlier)
            self.latest.update(former.latest)
        elif former is not None:
            self.earlier = former.of_session

    @property
    def of_session(self) -> dict[str, Fact]:
        """Lights of all flights of the session so far; of two that are equally bad, that of the latest flight."""
        return worse_lights(self.latest, self.earlier)

    def begin_flight(self) -> None:
        """Makes the latest flight an earlier one, and begins another without lights."""
        self.earlier = self.of_session
        self.latest = {}

    def add(self, light: Light, fact: Fact) -> None:
        """Adds a fact on a part of the vehicle; it becomes the light of the latest flight unless that is worse.

        A fact may be about the last minute only. Where it states a maximum, an equally good one with a larger maximum
        stays the light, since a maximum of the flight never decreases.

        Args:
            light: part of the vehicle, such as the motors.
            fact: what was found on it.
        """
        present = self.latest.get(str(light), fact)
        if not _states_larger_maximum(present, fact):
            self.latest[str(light)] = worst_fact([fact, present])

    def add_first(self, light: Light, fact: Fact) -> None:
        """Adds a fact on a part of the vehicle on which nothing has been found in the latest flight.

        Args:
            light: part of the vehicle, such as the motors.
            fact: what was found; it is ignored if the part has a light already.
        """
        self.latest.setdefault(str(light), fact)

    def replace(self, light: Light, former_code: Code, fact: Fact) -> None:
        """Replaces a light by a newer fact on the same fault, even if that is better.

        Args:
            light: part of the vehicle, such as the motors.
            former_code: code of the fault. A light that states another fault stays as it is.
            fact: what is known of this fault now.
        """
        present = self.latest.get(str(light))
        if present is not None and present.code is former_code:
            self.latest[str(light)] = fact

    def move(self, former_fact: Fact | None, light: Light, fact: Fact) -> None:
        """Moves a fact to the light of another part of the vehicle, when its cause has become known.

        Args:
            former_fact: the fact as it was stated before, by the light of any part; None if it is new.
            light: the part that the fact is about, as is known now.
            fact: the fact with its cause.
        """
        for name in [name for name, present in self.latest.items() if present == former_fact]:
            del self.latest[name]
        self.latest[str(light)] = fact

    def remove_good(self, light: Light) -> None:
        """Removes a light that is good, since that is no longer certain.

        Args:
            light: name of the part; if its light warns, nothing is removed.
        """
        present = self.latest.get(str(light))
        if present is not None and present.is_good:
            del self.latest[str(light)]


def _states_larger_maximum(present: Fact, fact: Fact) -> bool:
    """Returns whether a light states a larger maximum of the same quantity, at the same level, than another fact.

    Args:
        present: the light as it is.
        fact: another fact on the same part of the vehicle.
    """
    if present.code is not fact.code or present.level is not fact.level:
        return False
    name = MAXIMUM_FIGURES.get(fact.code)
    return name is not None and bool(present.figures[name] > fact.figures[name])


def worse_lights(first: NamedFacts, second: NamedFacts) -> dict[str, Fact]:
    """Returns the worse of two facts on each part of a vehicle; a part that only one of them names has that fact.

    Args:
        first: facts by the name of the part. Where both facts are equally bad, this one is returned.
        second: other facts by the name of the part.
    """
    worst = {}
    for name in {**first, **second}:
        facts = [lights[name] for lights in (first, second) if name in lights]
        worst[name] = worst_fact(facts)
    return worst
