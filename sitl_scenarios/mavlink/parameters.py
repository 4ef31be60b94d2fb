"""The autopilot's parameters: which output drives which motor, and where that motor is.

Also how each travels in PARAM_VALUE's float (https://mavlink.io/en/services/parameter.html#parameter-encoding).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from sitl_scenarios.mavlink.autopilots import Autopilot
from sitl_scenarios.mixer import DISARMED_PULSE, MAX_PULSE, MIN_PULSE, SPINS, frame
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.vehicles import AIRFRAMES

INT8, INT16, INT32, REAL32 = 2, 4, 6, 9  # MAV_PARAM_TYPE
INTEGERS = {INT8: 8, INT16: 16, INT32: 32}  # Bits of the integer types
MOTORS = 4


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
    """An autopilot's parameters by name, in alphabetical order; ``cycle`` of its loop in s."""
    by_kind = _px4(scenario) if autopilot.bitwise else _ardupilot(scenario, cycle)
    made = [Parameter(name, kind, value) for kind, values in by_kind.items() for name, value in values.items()]
    return {parameter.name: parameter for parameter in sorted(made, key=lambda one: one.name)}


def _px4(scenario: Scenario) -> dict[int, dict[str, float]]:
    whole: dict[str, float] = {
        "CA_AIRFRAME": 0,
        "CA_ROTOR_COUNT": MOTORS,
        "MAV_SYS_ID": scenario.stream.system,
        "MAV_TYPE": 2,
        "SYS_AUTOSTART": {"x": 4001, "plus": 5001}[scenario.vehicle.frame],
    }
    whole |= {f"PWM_MAIN_FUNC{n}": 100 + n if n <= MOTORS else 0 for n in range(1, 9)}
    for bound, value in (("DIS", DISARMED_PULSE["px4"]), ("MIN", MIN_PULSE), ("MAX", MAX_PULSE)):
        whole |= {f"PWM_MAIN_{bound}{n}": value for n in range(1, MOTORS + 1)}
    real: dict[str, float] = _thrust_curve("THR_MDL_FAC", scenario)
    rotors = frame(scenario.vehicle.frame, AIRFRAMES[scenario.vehicle.model].arm)
    for n in range(MOTORS):
        real |= {f"CA_ROTOR{n}_PX": rotors.forward[n], f"CA_ROTOR{n}_PY": rotors.right[n], f"CA_ROTOR{n}_PZ": 0.0}
        real |= {f"CA_ROTOR{n}_CT": 6.5, f"CA_ROTOR{n}_KM": 0.05 * SPINS[n]}  # KM: positive counter-clockwise
    return {INT32: whole, REAL32: real}


def _ardupilot(scenario: Scenario, cycle: float) -> dict[int, dict[str, float]]:
    small: dict[str, float] = {"FRAME_CLASS": 1, "FRAME_TYPE": {"plus": 0, "x": 1}[scenario.vehicle.frame]}
    medium: dict[str, float] = {
        "MAV_SYSID": scenario.stream.system,
        "MOT_PWM_MAX": MAX_PULSE,
        "MOT_PWM_MIN": MIN_PULSE,
        "SCHED_LOOP_RATE": round(1 / cycle),
    }
    for n in range(1, 9):
        medium |= {f"SERVO{n}_FUNCTION": 32 + n if n <= MOTORS else 0}
        medium |= {f"SERVO{n}_MIN": MIN_PULSE, f"SERVO{n}_MAX": MAX_PULSE, f"SERVO{n}_TRIM": 1500}
        small |= {f"SERVO{n}_REVERSED": 0}
    return {INT8: small, INT16: medium, REAL32: _thrust_curve("MOT_THST_EXPO", scenario)}


def _thrust_curve(name: str, scenario: Scenario) -> dict[str, float]:
    """The parameter by which an autopilot undoes the thrust curve: its share that is quadratic in the command."""
    share = scenario.vehicle.quadratic_thrust
    return {} if share is None else {name: share}
