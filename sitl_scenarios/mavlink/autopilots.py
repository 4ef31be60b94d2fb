"""Autopilots: MAVLink messages, rates, flight modes and parameters of the simulated PX4 and ArduPilot.

As PX4 1.17 (SIH) and ArduCopter 4.7 (SITL) sent them. Sources: PX4's ``mavlink_main.cpp``, ``mavlink_stream.cpp``,
``px4_custom_mode.h`` and ``Commander.cpp``; ArduPilot's ``GCS_Common.cpp``, ``GCS_MAVLink_Copter.cpp``,
``ArduCopter/mode.h`` and ``AP_Arming_Copter.cpp``.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from pydantic import TypeAdapter

from mavdem.files import load_adjacent_toml
from sitl_scenarios.section import shortened

Mode = tuple[int, int]
"""HEARTBEAT's base_mode without the flag of an armed vehicle, and its custom_mode."""


@dataclass(frozen=True)
class Autopilot:
    """MAVLink behaviour of one kind of autopilot."""

    name: Literal["px4", "ardupilot"]
    """Name in scenarios."""
    number: int
    """Its MAV_AUTOPILOT."""
    full_rate_messages: tuple[str, ...]
    """Messages that are sent at the scenario's rate."""
    quarter_rate_messages: tuple[str, ...]
    """Messages that are sent at a quarter of the scenario's rate."""
    fixed_rates: Mapping[str, float]
    """Rates of the other messages, Hz by name; 0 for a message that is sent only on request."""
    groups: Mapping[int, tuple[str, ...]]
    """Messages by MAV_DATA_STREAM; empty for an autopilot that does not obey REQUEST_DATA_STREAM."""
    interval_step: float
    """Step of the intervals between messages, s: each is a whole number of it."""
    staggers_streams: bool
    """Whether each stream begins a cycle after the one before, so that they do not all come at once."""
    unused: float
    """Output of channels without a motor, PWM pulse in µs."""
    modes: tuple[Mode, ...]
    """Flight modes by MAV_LANDED_STATE, the first on the ground."""
    manual_modes: tuple[Mode, ...]
    """Modes that a flight plan does not have: stabilised by hand, flip, and landing by a failsafe."""
    instruments: Mapping[str, float]
    """Rates of the messages of instruments, Hz by name, where they are sent."""
    parameters: Mapping[int, Mapping[str, float]]
    """Values of fixed parameters by name, by MAV_PARAM_TYPE; a scenario may change them."""
    bitwise: bool
    """Whether integer parameters are copied bit by bit into PARAM_VALUE's float, rather than converted."""

    def rates(
        self, rate: float, replacements: Mapping[str, float], has_instruments: bool = False
    ) -> dict[str, float]:
        """Returns the rates at which the autopilot sends its messages when it boots, before any request.

        Args:
            rate: Rate of attitude and motor outputs, Hz.
            replacements: Rates that replace the usual ones, Hz by name.
            has_instruments: Whether the vehicle sends what its instruments measure.

        Returns:
            Rates, Hz, by name; 0 for messages that are sent on request only.

        Raises:
            ValueError: A replacement names a message that the autopilot does not send.
        """
        usual_rates = dict.fromkeys(self.full_rate_messages, rate)
        usual_rates |= dict.fromkeys(self.quarter_rate_messages, rate / 4)
        usual_rates |= self.fixed_rates
        if has_instruments:
            usual_rates |= self.instruments
        for name in replacements:
            if name not in usual_rates:
                names = ", ".join(usual_rates)
                raise ValueError(
                    f"stream.rates: {self.name} sends no {shortened(name)} here: choose among {names}"
                )
        return {**usual_rates, **replacements}


AUTOPILOTS = TypeAdapter(dict[str, Autopilot]).validate_python(
    load_adjacent_toml(__file__, "autopilots.toml")
)
"""Autopilots by the name that a scenario's ``stream.autopilot`` gives."""

PX4 = AUTOPILOTS["px4"]
ARDUPILOT = AUTOPILOTS["ardupilot"]
