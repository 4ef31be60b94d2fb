"""Facts about the noise of gyro and accelerometer: their spectra, lines in them, and notch filters."""

from mavdem.facts.fact import Code


class NoiseFact(Code):
    """Of spectra, and the lines in them."""

    SPECTRUM_SEEN = "spectrum_seen"
    NO_SPECTRUM = "no_spectrum"
    MOTOR_LINE = "motor_line"
    FRAME_LINE = "frame_line"
    ALIASED_LINE = "aliased_line"
    OSCILLATION_LINE = "oscillation_line"
    UNNAMED_LINE = "unnamed_line"
    FILTERS_REMOVE = "filters_remove"


class NotchAdvice(Code):
    """Of notch filters to set, and why there are none."""

    SET_NOTCH = "set_notch"
    NOTCH_NOT_NEEDED = "notch_not_needed"
    NOTCH_IN_PLACE = "notch_in_place"
    NO_LINE_TO_REMOVE = "no_line_to_remove"
    SPECTRUM_BELOW_MOTORS = "spectrum_below_motors"
    NO_NOTCH_IN_FIRMWARE = "no_notch_in_firmware"
