"""Identification of one axis in closed loop: a Whittle likelihood of logged spectra, with the controller known."""
