"""Gray-box model: physical parameters of the vehicle, with the wind as a coloured state."""

from mavdem.plant.estimation import physical
from mavdem.plant.gusts import DetectedGust
from mavdem.plant.identifiability import NotIdentifiable
from mavdem.plant.parameters import Physical
from mavdem.plant.wind_torque import WindTorque

__all__ = ["DetectedGust", "NotIdentifiable", "Physical", "WindTorque", "physical"]
