"""Advice on higher rates of attitude and motor outputs, as facts (coded findings), by the settings in the log."""

import re
from collections.abc import Sequence

from mavdem.dataset.motor_outputs import DEMAND_MESSAGE
from mavdem.dataset.signals import MIN_STREAM_RATE
from mavdem.facts import Fact
from mavdem.facts.learnability import Remedy
from mavdem.ingest import Component
from mavdem.ingest.mavlink.dialect import mavlink_constant
from mavdem.ingest.telemetry import Parameters, Telemetry, firmware_version

RATE_REQUEST_MESSAGE = "REQUEST_DATA_STREAM"
"""Message by which a ground station asks for the rates of groups of messages."""

SET_MESSAGE_INTERVAL = mavlink_constant("MAV_CMD_SET_MESSAGE_INTERVAL")
"""Command by which a ground station asks for the rate of one message."""

STREAM_RATE_PARAMETER = re.compile(r"(?P<port>(?P<prefix>SR|MAV)\d+)_(EXTRA1|RC_CHAN)$")
"""ArduPilot's parameters for the rates of attitude (EXTRA1) and motor outputs (RC_CHAN) of a port; MAV from 4.7 on."""

STREAM_GROUPS = ("EXTRA1", "RC_CHAN")
"""ArduPilot's groups of messages with the attitude and with the motor outputs."""

LOG_RATE_LIMITS = {"LOG_FILE_RATEMAX": 1, "LOG_MAV_RATEMAX": 2, "LOG_BLK_RATEMAX": 4}
"""ArduPilot's limits of the rate at which each message is logged, and the bit of LOG_BACKEND_TYPE that each is for.

A limit is in Hz; 0 means none.
"""

ALL_LOG_BACKENDS = 7
"""Value of LOG_BACKEND_TYPE with the bits of all limits, for logs without that parameter."""

FAST_ATTITUDE_BIT = 1
"""Bit of ArduPilot's LOG_BITMASK that logs the attitude at the rate of the main loop."""

HIGH_RATE_BIT = 16
"""Bit of PX4's SDLOG_PROFILE that logs attitude and motor outputs at a high rate."""

FIRST_VERSION_WITH_DEMAND = (3, 3)
"""First version of ArduCopter that logs the demands (RATE); some development builds of it did not yet."""

STREAM_REMEDIES = {
    "uXRCE-DDS": Remedy.DDS_TOPICS,
    "MAVROS": Remedy.MAVROS_INTERVALS,
    "PX4": Remedy.PX4_STREAMS,
    "ARDUPILOTMEGA": Remedy.ARDUPILOT_STREAMS,
}
"""Remedies for the rates of a stream, by what a log was translated from or else by its autopilot."""


def rate_advice(
    telemetry: Telemetry, rate: int = 100, components: Sequence[Component] = ()
) -> Fact:
    """Advises how to get attitude and motor outputs at a higher rate.

    If another component, such as a ground station, requests rates, it has to be stopped first, since its requests
    override all settings.

    Args:
        telemetry: Messages of the vehicle.
        rate: Rate to advise, Hz.
        components: All components in the log.

    Returns:
        The advice (``Remedy``).
    """
    requesting_components = []
    for component in components:
        is_vehicle = (component.system, component.component) == (
            telemetry.system,
            telemetry.component,
        )
        if RATE_REQUEST_MESSAGE in component.messages and not is_vehicle:
            requesting_components.append(f"{component.system}:{component.component}")
    remedy = _settings_advice(telemetry, rate, is_requested=bool(requesting_components))
    # An acknowledged request shows that some component requests rates, even if its request was not recorded.
    acknowledged_commands = telemetry.messages.get("COMMAND_ACK", {}).get("command", ())
    if requesting_components or SET_MESSAGE_INTERVAL in acknowledged_commands:
        return Fact(Remedy.STOP_ASKING_FOR_RATES, names=requesting_components, remedy=remedy)
    return remedy


def names_setting(advice: Fact) -> bool:
    """Returns whether advice on higher rates names a setting to change.

    It names none if the autopilot was set already to log on board as fast as it can, and lost nothing.

    Args:
        advice: The advice (:func:`rate_advice`).
    """
    figures = advice.figures
    if advice.code is Remedy.LOG_FAST_ATTITUDE:
        # The names are those of parameters that limit the rates of messages.
        is_limited = bool(figures["names"]) or bool(figures["dropouts"])
        return is_limited or not _has_bit(figures["bitmask"], FAST_ATTITUDE_BIT)
    if advice.code is Remedy.LOG_HIGH_RATE:
        return bool(figures["dropouts"]) or not _has_bit(figures["profile"], HIGH_RATE_BIT)
    return True


def _has_bit(value: int | None, bit: int) -> bool:
    """Returns whether a bit of a parameter is set; False if the value of the parameter is not known (None)."""
    return value is not None and bool(value & bit)


def _settings_advice(telemetry: Telemetry, rate: int, *, is_requested: bool) -> Fact:
    """Advises which settings of the logger or the telemetry stream raise the rates.

    Args:
        telemetry: Messages of the vehicle.
        rate: Rate that is needed, Hz.
        is_requested: Whether some component requests rates from the vehicle.

    Returns:
        The advice, as a fact (a code with figures): for a DataFlash log, a ULog or a telemetry stream.
    """
    if telemetry.translated_from == "DataFlash":
        return _dataflash_advice(telemetry)
    if telemetry.translated_from == "ULog":
        profile = telemetry.parameters.get("SDLOG_PROFILE")
        return Fact(
            Remedy.LOG_HIGH_RATE,
            profile=None if profile is None else int(profile),
            has_parameters=bool(telemetry.parameters),
            dropouts=telemetry.dropouts,
        )
    return _stream_advice(telemetry, rate, is_requested=is_requested)


def _stream_advice(telemetry: Telemetry, rate: int, *, is_requested: bool) -> Fact:
    """Advises how to raise the rates of a telemetry stream.

    Args:
        telemetry: Messages of the vehicle.
        rate: Rate that is needed, Hz.
        is_requested: Whether some component requests rates from the vehicle.

    Returns:
        The remedy for the autopilot, with the names of ArduPilot's ports that are fast enough already, such as "SR1",
        and the prefix of their parameters, "SR" or "MAV"; empty if the log has no such parameters.
    """
    # ArduPilot has parameters such as SR1_EXTRA1: the rate of a group of messages (EXTRA1) on a port (SR1).
    ports = set()
    prefixes = set()
    for name in telemetry.parameters:
        match = STREAM_RATE_PARAMETER.match(name)
        if match:
            ports.add(match["port"])
            prefixes.add(match["prefix"])
    # Both prefixes occur if a log has parameters of two firmwares; SR is the usual one.
    prefix = ""
    if "SR" in prefixes:
        prefix = "SR"
    elif "MAV" in prefixes:
        prefix = "MAV"
    remedy_of_autopilot = STREAM_REMEDIES.get(telemetry.autopilot, Remedy.MESSAGE_INTERVALS)
    return Fact(
        STREAM_REMEDIES.get(telemetry.translated_from, remedy_of_autopilot),
        rate=rate,
        asked=is_requested,
        names=[port for port in sorted(ports) if _is_fast_port(port, telemetry.parameters)],
        prefix=prefix,
    )


def _is_fast_port(port: str, parameters: Parameters) -> bool:
    """Returns whether an ArduPilot port sends attitude and motor outputs at ``MIN_STREAM_RATE`` or faster.

    Args:
        port: Prefix of the port's parameters, such as "SR1".
        parameters: The autopilot's parameters by name; a rate that is not among them is 0.
    """
    rates = [parameters.get(f"{port}_{message_group}", 0) for message_group in STREAM_GROUPS]
    return min(rates) >= MIN_STREAM_RATE


def _dataflash_advice(telemetry: Telemetry) -> Fact:
    """Advises which settings make ArduPilot log attitude and demands fast to its DataFlash log.

    The demands replace the motor outputs, which ArduCopter logs at 10 Hz only (message RCOU). They are logged at the
    attitude's rate if a bit of the parameter LOG_BITMASK is set, by firmware from ``FIRST_VERSION_WITH_DEMAND`` on.
    Parameters that limit the rate of logging may prevent this.

    Args:
        telemetry: messages and parameters of the vehicle.

    Returns:
        A fact. Where demands are missing although fast logging is on, or because the firmware cannot log them, it has
        the ``firmware``, its ``version``, and whether that can log them. Otherwise it has the current ``bitmask`` (None
        if it is not known), and ``names`` and ``rates`` of the limits, Hz, that are too low.
    """
    parameters = telemetry.parameters
    firmware = telemetry.firmware
    bitmask = int(parameters["LOG_BITMASK"]) if "LOG_BITMASK" in parameters else None
    is_fast = _has_bit(bitmask, FAST_ATTITUDE_BIT)
    # An empty version, of a firmware without one in its name, is before every other.
    version = firmware_version(telemetry) or ()
    is_first_version = version == FIRST_VERSION_WITH_DEMAND
    can_log = version > FIRST_VERSION_WITH_DEMAND or (is_first_version and "-dev" not in firmware)
    is_demand_expected = is_fast or (bool(version) and not can_log)
    if DEMAND_MESSAGE not in telemetry.messages and is_demand_expected:
        return Fact(
            Remedy.DEMAND_NOT_LOGGED,
            firmware=firmware,
            version=version,
            can_log=can_log,
            is_fast=is_fast,
        )
    # Each kind of storage has a limit of its own, which counts only if the autopilot logs to it.
    active_backends = int(parameters.get("LOG_BACKEND_TYPE", ALL_LOG_BACKENDS))
    low_limits = {}
    for name, backend_bit in LOG_RATE_LIMITS.items():
        limit = parameters.get(name, 0.0)
        if 0 < limit < MIN_STREAM_RATE and backend_bit & active_backends:
            low_limits[name] = limit
    return Fact(
        Remedy.LOG_FAST_ATTITUDE,
        bitmask=bitmask,
        names=tuple(low_limits),
        rates=tuple(low_limits.values()),
        dropouts=telemetry.dropouts,
    )
