"""What is said of the noise of gyro and accelerometer: their spectra, lines in them, and notch filters."""

from enum import auto

from mavdem.facts.fact import Code


class Noise(Code):
    """Of spectra, and the lines in them."""

    SPECTRUM_SEEN = auto()
    NO_SPECTRUM = auto()
    MOTOR_LINE = auto()
    FRAME_LINE = auto()
    ALIASED_LINE = auto()
    UNNAMED_LINE = auto()
    FILTERS_REMOVE = auto()


class NotchAdvice(Code):
    """Of notch filters to set, and why there are none."""

    SET_NOTCH = auto()
    NOTCH_NOT_NEEDED = auto()
    NOTCH_IN_PLACE = auto()
    NO_LINE_TO_REMOVE = auto()
