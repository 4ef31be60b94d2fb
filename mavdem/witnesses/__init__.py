"""Witnesses: which sensors of a flight can be trusted, and which of them support or contradict an event.

An estimate that runs away looks like a crash, and a setpoint that nothing follows looks like a tumble. So no event is
stated on the word of one sensor alone. This room measures once, for each boot, what barometer, accelerometer, gyro,
position fix and stick are worth (:func:`sensor_trust`), and from them whether the vehicle flew at all.
"""

from mavdem.witnesses.flight_check import FlightCheck, flight_check
from mavdem.witnesses.trust import SensorTrust, sensor_trust, trust_of_boots

__all__ = ["FlightCheck", "SensorTrust", "flight_check", "sensor_trust", "trust_of_boots"]
