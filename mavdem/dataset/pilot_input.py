"""The pilot's sticks and switches as the autopilot received them, from -100 to 100 % or in µs."""

from typing import NamedTuple

import numpy as np

from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, clean_series, float_column
from mavdem.ingest.telemetry import Parameters

STICKS = ("roll", "pitch", "throttle", "yaw")
"""The sticks in the order of ArduPilot's default channels, 1 to 4."""

STICK_CHANNEL_PARAMETERS = {stick: f"RCMAP_{stick.upper()}" for stick in STICKS}
"""ArduPilot's parameters with the channel of each stick."""

STICK_FIELDS = {"roll": "y", "pitch": "x", "throttle": "z", "yaw": "r"}
"""Fields of MANUAL_CONTROL with the sticks, -1000 to 1000, but 0 to 1000 for the throttle."""

MAX_CHANNELS = 18
"""Number of channels of RC_CHANNELS, and of PX4's input_rc."""

_MAVLINK_FIELDS = tuple(f"chan{number}_raw" for number in range(1, MAX_CHANNELS + 1))

CHANNEL_FIELDS = {
    "RC_CHANNELS": _MAVLINK_FIELDS,
    "RC_CHANNELS_RAW": _MAVLINK_FIELDS,
    "input_rc": tuple(f"values[{index}]" for index in range(MAX_CHANNELS)),
}
"""Fields with the pulse widths of the channels 1, 2, … by message; the preferred message first."""

POSSIBLE_PULSE = (750.0, 2250.0)
"""Pulse widths, µs, of a channel; receivers without a signal report 0 or 65535."""


class PilotInput(NamedTuple):
    """What the pilot's remote control sent."""

    sticks: dict[str, TimeSeries]
    """Each stick (N,) by its name, in ``unit``."""
    unit: str
    """Unit of the sticks: "%" of their travel, or "µs"."""
    switches: dict[int, TimeSeries]
    """Pulse width (M,), µs, of each channel beyond the sticks, by its number from 1."""


def pilot_input(signals: Signals) -> PilotInput:
    """Returns the sticks and switches of the pilot that were recorded.

    The sticks of MANUAL_CONTROL, in %, are preferred. Without them, sticks are the radio channels that the autopilot's
    parameters assign to them, in µs. All other channels count as switches.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        The sticks and switches; empty if none was recorded.
    """
    channels = _received_channels(signals)
    stick_channels = _stick_channels(signals.telemetry.parameters)
    switches = {}
    for number, series in channels.items():
        if number not in stick_channels.values():
            switches[number] = series
    sticks_in_percent = _sticks_of_manual_control(signals)
    if len(sticks_in_percent) == len(STICKS):
        return PilotInput(sticks_in_percent, "%", switches)
    sticks_in_microseconds = {}
    for stick, number in stick_channels.items():
        if number in channels:
            sticks_in_microseconds[stick] = channels[number]
    return PilotInput(sticks_in_microseconds, "µs", switches)


def _sticks_of_manual_control(signals: Signals) -> dict[str, TimeSeries]:
    """Returns the sticks in the message MANUAL_CONTROL, from −100 to 100 %, by name; without those not recorded.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
    """
    columns = signals.telemetry.messages.get("MANUAL_CONTROL", {})
    sticks = {}
    for stick, field in STICK_FIELDS.items():
        if field not in columns:
            continue
        # MAVLink has sticks from −1000 to 1000.
        percent = 0.1 * float_column(columns, field)
        series = clean_series(columns, percent)
        if len(series.time):
            sticks[stick] = series
    return sticks


def _stick_channels(parameters: Parameters) -> dict[str, int]:
    """Returns the number of each stick's channel, from 1, by ArduPilot's parameters or their defaults."""
    channels = {}
    for number, (stick, name) in enumerate(STICK_CHANNEL_PARAMETERS.items(), start=1):
        channels[stick] = int(parameters.get(name, number))
    return channels


def _received_channels(signals: Signals) -> dict[int, TimeSeries]:
    """Returns the pulse width of each radio channel that was received.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        Pulse widths (N,), µs, by the number of the channel, from 1; from the first of ``CHANNEL_FIELDS`` that has any.
    """
    lowest, highest = POSSIBLE_PULSE
    for message, fields in CHANNEL_FIELDS.items():
        columns = signals.telemetry.messages.get(message, {})
        channels = {}
        for number, field in enumerate(fields, 1):
            if field not in columns:
                continue
            pulses = float_column(columns, field)
            is_possible = (pulses > lowest) & (pulses < highest)
            if np.count_nonzero(is_possible) > 1:
                channels[number] = clean_series(columns, pulses, is_possible)
        if channels:
            return channels
    return {}
