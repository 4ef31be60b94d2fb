"""Gray-box model: physical parameters of the vehicle, with the wind as a coloured state."""

from mavdem.dem.graybox.estimation import physical
from mavdem.dem.graybox.gusts import DetectedGust
from mavdem.dem.graybox.identifiability import NotIdentifiable
from mavdem.dem.graybox.parameters import Physical
from mavdem.dem.graybox.wind import WindTorque

__all__ = ["DetectedGust", "NotIdentifiable", "Physical", "WindTorque", "physical"]
