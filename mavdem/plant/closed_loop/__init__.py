"""Closed loop: the plant, the wind's torque and the noise of one axis, whose controller is known, by their spectra."""
