"""What can be trusted: whether each sensor of a vehicle agrees with another one."""

from mavdem.facts.fact import Code


class TrustCheck(Code):
    """One check of a sensor, or of the flight as a whole; the level is its answer."""

    FLIGHT = "trust_flight"
    BAROMETER = "trust_barometer"
    ACCELEROMETER = "trust_accelerometer"
    POSITION = "trust_position"
    ATTITUDE_RESPONSE = "trust_attitude_response"
    GYRO = "trust_gyro"
    STICK = "trust_stick"
