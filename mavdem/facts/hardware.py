"""Facts about a vehicle's hardware over the flight, part by part."""

from enum import StrEnum

from mavdem.facts.fact import Code


class HardwarePart(StrEnum):
    """A part of the hardware."""

    POWER = "power"
    SUPPLY = "board supply"
    CURRENT_SENSOR = "current sensor"
    CONTROLLERS = "speed controllers"
    RECEIVERS = "satellite receiver"
    COMPASSES = "magnetic field"
    PROCESSOR = "processor"
    RECORDING = "recording"
    TEMPERATURES = "temperatures"
    CALIBRATION = "sensors and calibration"


class HardwareFact(Code):
    """What was measured of a part, and whether that is well."""

    CONTROLLERS_MEASURED = "controllers_measured"
    RECEIVER_MEASURED = "receiver_measured"
    FIELD_MEASURED = "field_measured"
    PROCESSOR_MEASURED = "processor_measured"
    RECORDING_MEASURED = "recording_measured"
    TEMPERATURES_MEASURED = "temperatures_measured"
    SENSORS_CALIBRATED = "sensors_calibrated"


class ReceiverDoubt(StrEnum):
    """What is not well with a satellite receiver."""

    SATELLITES = "number of satellites"
    DILUTION = "dilution"
    ACCURACY = "accuracy"
    JAMMING = "jamming"
