"""The latest geographic position of a live vehicle, where it is searched after its link was lost."""

from typing import NamedTuple

import numpy as np

from mavdem.containers import Numbers
from mavdem.dataset.signals import global_positions
from mavdem.ingest.vocabulary import MILLIMETRES_PER_METRE


class GlobalPosition(NamedTuple):
    """A position of the vehicle as its autopilot estimates it."""

    latitude: float
    """Latitude, degrees."""

    longitude: float
    """Longitude, degrees."""

    height: float
    """Height above the home position, m."""

    reception: float
    """When it was received, UNIX s."""


def received_position(values: Numbers, reception: float) -> GlobalPosition | None:
    """Returns the position in a message; None before the autopilot knows one, when it sends zeros.

    Args:
        values: fields of GLOBAL_POSITION_INT: altitude above the home position, mm, latitude and longitude, units of
            1e-7 degrees.
        reception: when the message was received, UNIX s.
    """
    altitude, latitude, longitude = values
    degrees, is_fix = global_positions({"lat": np.array([latitude]), "lon": np.array([longitude])})
    if not is_fix.all():
        return None
    [[latitude_degrees, longitude_degrees]] = degrees.tolist()
    height = altitude / MILLIMETRES_PER_METRE
    return GlobalPosition(latitude_degrees, longitude_degrees, height, reception)
