"""Flights of a quadrotor in wind on demand: vehicle, wind, autopilot, and its MAVLink messages."""
