"""ArduPilot's DataFlash logs, binary and text."""
