"""Pulses: motor commands as both autopilots put them out, PWM in µs."""

from __future__ import annotations

LOWEST, HIGHEST = 1000.0, 2000.0
"""Of no command and of a full one."""

STOPPED = {"px4": 900.0, "ardupilot": 1000.0}
"""Of a motor that is disarmed, by who speaks."""


def pulse(command: float) -> float:
    """A normalised command as it is put out: whole µs."""
    return float(round(LOWEST + (HIGHEST - LOWEST) * command))
