"""The autopilot's parameters: those that say which output drives which motor, and where that is.

Also how each travels in PARAM_VALUE's float (https://mavlink.io/en/services/parameter.html#parameter-encoding).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from sitl_scenarios.frames import SPINS, frame
from sitl_scenarios.mavlink.autopilots import Autopilot
from sitl_scenarios.pulses import HIGHEST, LOWEST, STOPPED
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.vehicles import AIRFRAMES

INT8, INT16, INT32, REAL32 = 2, 4, 6, 9
"""MAV_PARAM_TYPE."""
INTEGERS = {INT8: 8, INT16: 16, INT32: 32}
"""Bits of the integer types."""
MOTORS = 4
TORQUE_RATIO = 0.05
"""PX4's default for torque over thrust, positive for counter-clockwise."""
ARDUPILOT_FRAMES = {"plus": 0, "x": 1}
"""FRAME_TYPE."""


@dataclass(frozen=True)
class Parameter:
    """A parameter of MAV_PARAM_TYPE ``kind``; ``value`` is whole where that is an integer type."""

    name: str
    kind: int
    value: float

    def encoded(self, bitwise: bool) -> float:
        """PARAM_VALUE.param_value."""
        if bitwise and self.kind in INTEGERS:
            return float(struct.unpack("<f", struct.pack("<i", int(self.value)))[0])
        return self.value

    def changed(self, sent: float, bitwise: bool) -> Parameter | None:
        """The parameter as a PARAM_SET of ``param_value`` ``sent`` makes it; None for a value that it cannot have."""
        value = sent
        if bitwise and self.kind in INTEGERS:
            value = float(struct.unpack("<i", struct.pack("<f", sent))[0])
        elif self.kind in INTEGERS and abs(sent) < 2**31:
            value = float(round(sent))
        if self.kind in INTEGERS:
            limit = 2.0 ** (INTEGERS[self.kind] - 1)
            return Parameter(self.name, self.kind, value) if -limit <= value < limit else None
        return Parameter(self.name, self.kind, value) if abs(value) < 3.4e38 else None


def parameters(scenario: Scenario, autopilot: Autopilot, cycle: float) -> dict[str, Parameter]:
    """The parameters by name.

    Args:
        scenario: whose frame and system id they tell.
        autopilot: whose they are.
        cycle: of its loop, s.
    """
    told = _px4(scenario) if autopilot.bitwise else _ardupilot(scenario, cycle)
    return {parameter.name: parameter for parameter in sorted(told, key=lambda one: one.name)}


def _px4(scenario: Scenario) -> list[Parameter]:
    whole: dict[str, float] = {
        "CA_AIRFRAME": 0,
        "CA_ROTOR_COUNT": MOTORS,
        "MAV_SYS_ID": scenario.stream.system,
        "MAV_TYPE": 2,
        "SYS_AUTOSTART": {"x": 4001, "plus": 5001}[scenario.vehicle.frame],
    }
    whole |= {f"PWM_MAIN_FUNC{n}": 100 + n if n <= MOTORS else 0 for n in range(1, 9)}
    for bound, value in (("DIS", STOPPED["px4"]), ("MIN", LOWEST), ("MAX", HIGHEST)):
        whole |= {f"PWM_MAIN_{bound}{n}": value for n in range(1, MOTORS + 1)}
    real: dict[str, float] = {}
    rotors = frame(scenario.vehicle.frame, AIRFRAMES[scenario.vehicle.model].arm)
    for n in range(MOTORS):
        real |= {f"CA_ROTOR{n}_PX": rotors.forward[n], f"CA_ROTOR{n}_PY": rotors.right[n], f"CA_ROTOR{n}_PZ": 0.0}
        real |= {f"CA_ROTOR{n}_CT": 6.5, f"CA_ROTOR{n}_KM": TORQUE_RATIO * SPINS[n]}
    return [Parameter(name, INT32, value) for name, value in whole.items()] + [
        Parameter(name, REAL32, value) for name, value in real.items()
    ]


def _ardupilot(scenario: Scenario, cycle: float) -> list[Parameter]:
    small: dict[str, float] = {"FRAME_CLASS": 1, "FRAME_TYPE": ARDUPILOT_FRAMES[scenario.vehicle.frame]}
    medium: dict[str, float] = {
        "MAV_SYSID": scenario.stream.system,
        "MOT_PWM_MAX": HIGHEST,
        "MOT_PWM_MIN": LOWEST,
        "SCHED_LOOP_RATE": round(1 / cycle),
    }
    for n in range(1, 9):
        medium |= {f"SERVO{n}_FUNCTION": 32 + n if n <= MOTORS else 0}
        medium |= {f"SERVO{n}_MIN": LOWEST, f"SERVO{n}_MAX": HIGHEST, f"SERVO{n}_TRIM": 1500}
        small |= {f"SERVO{n}_REVERSED": 0}
    return [Parameter(name, INT8, value) for name, value in small.items()] + [
        Parameter(name, INT16, value) for name, value in medium.items()
    ]
