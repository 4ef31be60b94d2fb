"""The verdicts on the vehicles of a recording that holds several, of which none was chosen."""

from typing import NamedTuple

from mavdem.facts import Fact
from mavdem.facts.session import SessionFact


class VehicleVerdict(NamedTuple):
    """The verdict on one vehicle of several in a recording."""

    name: str
    """By which ``--vehicle`` chooses it."""
    headline: Fact
    """Its headline, with the number of the flight if it has several that are judged each by itself."""

    @property
    def fact(self) -> Fact:
        """The headline, with the name of the vehicle."""
        return Fact(
            SessionFact.VEHICLE_VERDICT,
            self.headline.level,
            name=self.name,
            reason=self.headline,
        )


class RecordedVehicle(NamedTuple):
    """The vehicle of a recording that is assessed, and the verdicts on the others."""

    name: str
    """By which ``--vehicle`` chooses the vehicle."""
    other_verdicts: tuple[VehicleVerdict, ...]
    """The verdicts on the other vehicles, the worst first."""
