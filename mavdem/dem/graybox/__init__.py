"""Gray-box model: physical parameters of the vehicle, with the wind as a coloured state."""

from mavdem.dem.graybox.parameters import Physical, physical

__all__ = ["Physical", "physical"]
