"""The two simulated autopilots: their numbers, rates, modes and parameters.

As PX4 1.17 (SIH) and ArduCopter 4.7 (SITL) sent them. Sources: PX4's ``mavlink_main.cpp``, ``mavlink_stream.cpp``,
``px4_custom_mode.h`` and ``Commander.cpp``; ArduPilot's ``GCS_Common.cpp``, ``GCS_MAVLink_Copter.cpp``,
``ArduCopter/mode.h`` and ``AP_Arming_Copter.cpp``.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from pydantic import TypeAdapter

from mavdem.files import load_adjacent_toml
from sitl_scenarios.scenario import shortened

Mode = tuple[int, int]  # HEARTBEAT's base_mode, but for the armed flag, and its custom_mode


@dataclass(frozen=True)
class Autopilot:
    """The MAVLink of one kind of autopilot."""

    name: Literal["px4", "ardupilot"]  # as in scenarios
    number: int  # its MAV_AUTOPILOT
    # the messages that come at the scenario's rate; ``quarter``: those that come at a quarter of it
    fast: tuple[str, ...]
    quarter: tuple[str, ...]
    # Hz of those that come at a rate of their own; 0 for those that come only when asked for
    slow: Mapping[str, float]
    # messages by MAV_DATA_STREAM, where REQUEST_DATA_STREAM is obeyed
    groups: Mapping[int, tuple[str, ...]]
    interval_step: float  # s: intervals between messages are whole numbers of it
    # whether each stream begins a cycle after the one before, so that they do not all come at once
    apart: bool
    unused: float  # output of channels without a motor, PWM in µs
    modes: tuple[Mode, ...]  # by MAV_LANDED_STATE, from on the ground on
    # values of others, which a scenario may change, by MAV_PARAM_TYPE
    parameters: Mapping[int, Mapping[str, float]]
    # whether integer parameters are copied bit by bit into PARAM_VALUE's float, rather than cast
    bitwise: bool

    def rates(self, rate: float, replacements: Mapping[str, float]) -> dict[str, float]:
        """Returns the rates of all messages that the autopilot can send, Hz by name; 0 for those on request only.

        Args:
            rate: Rate of attitude and motor outputs, Hz.
            replacements: Rates that replace the usual ones, Hz by name.

        Raises:
            ValueError: A replacement names a message that the autopilot does not send.
        """
        usual = dict.fromkeys(self.fast, rate)
        usual |= dict.fromkeys(self.quarter, rate / 4)
        usual |= self.slow
        for name in replacements:
            if name not in usual:
                names = ", ".join(usual)
                raise ValueError(
                    f"stream.rates: {self.name} sends no {shortened(name)} here: choose among {names}"
                )
        return {**usual, **replacements}


# By ``scenario.stream.autopilot``
AUTOPILOTS = TypeAdapter(dict[str, Autopilot]).validate_python(
    load_adjacent_toml(__file__, "autopilots.toml")
)
PX4 = AUTOPILOTS["px4"]
ARDUPILOT = AUTOPILOTS["ardupilot"]
