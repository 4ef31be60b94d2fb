"""Loops: rate and attitude loop of one axis, from the identified plant and the autopilot's own gains."""
