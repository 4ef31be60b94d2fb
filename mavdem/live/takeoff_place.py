"""Where a live vehicle took off, by satellites and barometer, which a reboot of the autopilot does not move."""

from typing import NamedTuple

import numpy as np

from mavdem.live.global_position import GlobalPosition
from mavdem.witnesses.ground_heights import horizontal_distance
from mavdem.witnesses.sensors import POSSIBLE_PRESSURE, standard_altitude


class Displacement(NamedTuple):
    """How far a vehicle is from a place, such as that of its take-off."""

    distance: float | None
    """Horizontal distance, m; None where only the height is known."""

    height: float
    """Height above that place, m."""


class Place(NamedTuple):
    """A place as sensors measure it; None where they have not."""

    position: tuple[float, float] | None = None
    """Latitude and longitude by satellites, degrees."""

    altitude: float | None = None
    """Altitude by the barometer, m above an arbitrary level."""

    def displacement_from(self, start: "Place") -> Displacement | None:
        """Returns how far this place is from another one; None if one of them was not measured completely.

        Args:
            start: the other place, at most some kilometres away.
        """
        if self.position is None or start.position is None:
            return None
        if self.altitude is None or start.altitude is None:
            return None
        distance = horizontal_distance(np.array(start.position), np.array(self.position))
        return Displacement(distance, self.altitude - start.altitude)


def displacement_from_home(
    home: GlobalPosition | None, position: GlobalPosition | None
) -> Displacement | None:
    """Returns how far a vehicle is from its home position; None if its height above that is not known.

    Args:
        home: the home position, which the autopilot has set before the take-off; None where it did not come. Then the
            distance is not known.
        position: position of the vehicle, with its height above the home position.
    """
    if position is None or position.height is None:
        return None
    if home is None:
        return Displacement(None, position.height)
    distance = horizontal_distance(
        np.array([home.latitude, home.longitude]), np.array([position.latitude, position.longitude])
    )
    return Displacement(distance, position.height)


class TakeoffPlace:
    """Keeps the place of a vehicle's take-off by its sensors, over reboots of the autopilot in flight.

    The autopilot's own position is more exact, but its origin is another one after a reboot.
    """

    def __init__(self) -> None:
        """Begins without a place."""
        self._latest = Place()
        # Where the vehicle stood last in this boot, and where it stood before its latest take-off.
        self._ground: Place | None = None
        self._takeoff: Place | None = None

    def restart(self, *, was_flying: bool) -> None:
        """Forgets what was measured before a reboot, except the place of the take-off of a flight that goes on.

        Args:
            was_flying: whether the vehicle flew when the former boot ended.
        """
        self._latest = Place()
        self._ground = None
        if not was_flying:
            self._takeoff = None

    @property
    def displacement(self) -> Displacement | None:
        """How far the vehicle is from where it took off; None where one of the two places is not known."""
        return None if self._takeoff is None else self._latest.displacement_from(self._takeoff)

    def add_fix(self, fix: GlobalPosition) -> None:
        """Takes a position by satellites."""
        self._latest = self._latest._replace(position=(fix.latitude, fix.longitude))

    def add_pressure(self, pressure: float) -> None:
        """Takes a pressure of the barometer, hPa; an impossible one is ignored."""
        lowest, highest = POSSIBLE_PRESSURE
        if lowest <= pressure <= highest:
            [altitude] = standard_altitude(np.array([pressure])).tolist()
            self._latest = self._latest._replace(altitude=altitude)

    def note_phase(self, *, is_flying: bool, is_takeoff_seen: bool) -> None:
        """Updates the place of the take-off by the latest measured place and by whether the vehicle flies.

        On the ground the latest place is stored as the one where the vehicle stands. In flight the stored place is that
        of the take-off, unless the take-off was not seen: the vehicle may then have been elsewhere.

        Args:
            is_flying: whether the vehicle is in the air.
            is_takeoff_seen: whether the take-off was seen since the autopilot started.
        """
        if not is_flying:
            self._ground = self._latest
        elif self._ground is not None and is_takeoff_seen:
            self._takeoff = self._ground
