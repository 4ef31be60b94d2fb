"""MAVLink of a simulated autopilot, PX4's or ArduPilot's, to a file or to a ground station."""
