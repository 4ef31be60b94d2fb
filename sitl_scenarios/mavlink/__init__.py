"""MAVLink out: what an autopilot of either kind says of a simulated flight, to a file or to a ground station."""
