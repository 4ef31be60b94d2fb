"""Flights of a quadrotor in wind on demand: vehicle, wind, autopilot, and what the autopilot says of it in MAVLink."""
