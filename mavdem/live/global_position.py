"""The latest geographic position of a live vehicle, where it is searched after its link was lost."""

from typing import NamedTuple

import numpy as np

from mavdem.containers import Numbers
from mavdem.dataset.position_fix import FIX_3D
from mavdem.dataset.signals import global_positions
from mavdem.ingest.vocabulary import MILLIMETRES_PER_METRE
from mavdem.live.messages import MESSAGE_FIELDS


class GlobalPosition(NamedTuple):
    """A position of the vehicle as its autopilot estimates it, or as a receiver of satellites measures it."""

    latitude: float
    """Latitude, degrees."""

    longitude: float
    """Longitude, degrees."""

    height: float | None
    """Height above the home position, m; None in a position by satellites."""

    reception: float
    """When it was received, UNIX s."""


def received_position(values: Numbers, reception: float) -> GlobalPosition | None:
    """Returns the position in a message; None before the autopilot knows one, when it sends zeros.

    Args:
        values: three fields of GLOBAL_POSITION_INT: height above the home position, mm, then latitude and longitude in
            units of 1e-7 degrees.
        reception: when the message was received, UNIX s.
    """
    height, latitude, longitude = values
    return _possible_position(latitude, longitude, height / MILLIMETRES_PER_METRE, reception)


def fix_position(values: Numbers, reception: float) -> GlobalPosition | None:
    """Returns the position that a receiver of satellites has measured; None if it had no fix in three dimensions.

    Args:
        values: values of a message GPS_RAW_INT, in the order of its ``MESSAGE_FIELDS``.
        reception: when the message was received, UNIX s.
    """
    fields = dict(zip(MESSAGE_FIELDS["GPS_RAW_INT"], values, strict=True))
    if fields["fix_type"] < FIX_3D:
        return None
    return _possible_position(fields["lat"], fields["lon"], height=None, reception=reception)


def home_position(values: Numbers, reception: float) -> GlobalPosition | None:
    """Returns the home position of the vehicle, where the autopilot returns to; None before it has one.

    Args:
        values: latitude and longitude of HOME_POSITION, in units of 1e-7 degrees.
        reception: when the message was received, UNIX s.
    """
    latitude, longitude = values
    return _possible_position(latitude, longitude, height=0.0, reception=reception)


def _possible_position(
    latitude: float, longitude: float, height: float | None, reception: float
) -> GlobalPosition | None:
    """Returns a position in degrees; None where it is zero, or not on the earth.

    Args:
        latitude: in units of 1e-7 degrees.
        longitude: in units of 1e-7 degrees.
        height: height above the home position, m; None where it is not known.
        reception: when the message was received, UNIX s.
    """
    degrees, is_fix = global_positions({"lat": np.array([latitude]), "lon": np.array([longitude])})
    if not is_fix.all():
        return None
    [[latitude_degrees, longitude_degrees]] = degrees.tolist()
    return GlobalPosition(latitude_degrees, longitude_degrees, height, reception)
