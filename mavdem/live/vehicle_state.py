"""The state of a live vehicle that a pilot looks for first: flight mode, arming, battery and satellites."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from mavdem.assessment.identity import vehicle_name
from mavdem.assessment.simulation import named_simulator
from mavdem.dataset.batteries import BATTERY_MESSAGES, Battery, battery_name
from mavdem.dataset.position_fix import UNKNOWN_SATELLITES, has_fix_by_row
from mavdem.dataset.signals import Signals
from mavdem.facts.vehicle import Basis
from mavdem.ingest.telemetry import Columns, Telemetry
from mavdem.ingest.vocabulary import AUTOPILOT_NAMES
from mavdem.live.recent_messages import RecentMessages

STATE_SECONDS = 20.0
"""Time over which messages show the state, s: a battery needs some messages, which may come every 2 s or slower."""


class VehicleState(NamedTuple):
    """Mode, arming, battery and satellites by the latest messages."""

    mode: str = ""
    """Name of the flight mode; empty where it is not known."""

    lands_by_itself: bool = False
    """Whether it is a mode in which the vehicle lands by itself, sooner or later."""

    is_armed: bool | None = None
    """Whether the motors are armed; None before a heartbeat."""

    voltage: float | None = None
    """Voltage, V, of the battery with the least charge, or of the first where that is not known; None without any."""

    charge: float | None = None
    """Remaining charge of that battery, percent; None where it is not known."""

    battery: str = ""
    """Name of that battery, such as "battery 2", where there are several."""

    voltages: Mapping[int, float] = MappingProxyType({})
    """Voltage of each battery, V, by its number from 1."""

    has_position_fix: bool | None = None
    """Whether the receiver of satellites has a three-dimensional fix; None where no receiver reports."""

    satellites: int | None = None
    """Number of satellites that it receives; None where it is not known."""

    system: int = 0
    """MAVLink system id; 0 where it is not known."""

    frame: str = ""
    """MAV_TYPE without its prefix, such as "QUADROTOR"."""

    autopilot: str = ""
    """MAV_AUTOPILOT without its prefix."""

    name_in_logs: str = ""
    """Name by which its logs are recognised, from the calibration of a sensor; empty where that is not known."""

    library_name: str = ""
    """Name under which a library lists its logs: the same or, where that is empty, one made of its system id."""

    @property
    def autopilot_name(self) -> str:
        """How people call its autopilot; empty where that is not known."""
        return autopilot_name(self.autopilot)


def autopilot_name(autopilot: str) -> str:
    """Returns how people call an autopilot, such as "ArduPilot".

    Args:
        autopilot: name of its MAV_AUTOPILOT without the prefix, such as "ARDUPILOTMEGA".
    """
    return AUTOPILOT_NAMES.get(autopilot, autopilot)


def vehicle_state(slow_messages: RecentMessages, vehicle: Telemetry, now: float) -> VehicleState:
    """Returns the state of a vehicle by its latest messages: flight mode, arming, battery, satellites and name.

    Args:
        slow_messages: slow messages of the present boot, such as battery and position.
        vehicle: identity and parameters of the vehicle, without messages.
        now: present time on the boot clock, s.
    """
    columns = slow_messages.columns(("HEARTBEAT", *BATTERY_MESSAGES), now - STATE_SECONDS)
    columns |= slow_messages.columns(["AVAILABLE_MODES"])
    receiver = slow_messages.columns(["GPS_RAW_INT"], now - STATE_SECONDS).get("GPS_RAW_INT")
    signals = Signals(replace(vehicle, messages=columns))
    armed = signals.armed
    # Whether the mode is one in which the vehicle lands by itself, over time.
    landing_mode = signals.landing
    voltages = {battery.number: float(battery.voltage.values[-1]) for battery in signals.batteries}
    emptiest_battery = _emptiest_battery(signals.batteries)
    name, basis = vehicle_name(vehicle, is_simulated=named_simulator(vehicle) is not None)
    return VehicleState(
        signals.mode_at(slow_messages.boot, now),
        lands_by_itself=landing_mode is not None and bool(landing_mode.values[-1]),
        is_armed=None if armed is None else bool(armed.values[-1]),
        voltage=None if emptiest_battery is None else voltages[emptiest_battery.number],
        charge=None if emptiest_battery is None else _latest_charge(emptiest_battery),
        battery=_name_among_several(emptiest_battery, len(voltages)),
        voltages=voltages,
        has_position_fix=None if receiver is None else bool(has_fix_by_row(receiver)[-1]),
        satellites=None if receiver is None else _latest_satellites(receiver),
        system=vehicle.system,
        frame=vehicle.vehicle,
        autopilot=vehicle.autopilot,
        # Several vehicles may have the same system id.
        name_in_logs="" if basis is Basis.SYSTEM_ID else name,
        library_name=name,
    )


def _latest_satellites(receiver: Columns) -> int | None:
    """Returns how many satellites a receiver had in its last message; None if it does not know.

    Args:
        receiver: its messages in the last seconds, at least one, by field.
    """
    satellites = int(np.asarray(receiver["satellites_visible"])[-1])
    return None if satellites == UNKNOWN_SATELLITES else satellites


def _emptiest_battery(batteries: Iterable[Battery]) -> Battery | None:
    """Returns the battery with the least remaining charge, or the first one if no charge is known.

    Args:
        batteries: voltage and charge of each battery in the last seconds; None is returned if there are none.
    """
    emptiest_battery = None
    lowest_charge = None
    for battery in batteries:
        charge = _latest_charge(battery)
        is_emptier = charge is not None and (lowest_charge is None or charge < lowest_charge)
        if emptiest_battery is None or is_emptier:
            emptiest_battery = battery
            lowest_charge = charge
    return emptiest_battery


def _name_among_several(battery: Battery | None, count: int) -> str:
    """Returns the name of a battery, such as "battery 2", if the vehicle has several; otherwise an empty text.

    Args:
        battery: the battery; None without any.
        count: how many batteries the vehicle has.
    """
    return "" if battery is None or count < 2 else battery_name(battery.number)


def _latest_charge(battery: Battery) -> float | None:
    """Returns the latest remaining charge of a battery, percent; None if the autopilot does not send it.

    Args:
        battery: voltage and charge of one battery in the last seconds.
    """
    if battery.charge is None:
        return None
    charge = float(battery.charge.values[-1])
    # An autopilot that does not know the charge sends −1.
    return charge if charge >= 0 else None
