"""Flights of a multirotor in wind on demand: vehicle, wind, autopilot, and its MAVLink messages."""
