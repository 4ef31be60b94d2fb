"""Constants of physics that the code shares."""

GRAVITY = 9.80665
"""Standard acceleration of free fall, m/s² (3rd General Conference on Weights and Measures, 1901)."""
