"""Gray-box model of one axis: its physical parameters, and the wind torque as a coloured disturbance."""

from mavdem.plant.estimation import physical
from mavdem.plant.gusts import DetectedGust
from mavdem.plant.identifiability import NotIdentifiable
from mavdem.plant.parameters import Physical
from mavdem.plant.wind_torque import WindTorque

__all__ = ["DetectedGust", "NotIdentifiable", "Physical", "WindTorque", "physical"]
