"""Advice on rates: how to get faster attitude and motor outputs from each autopilot."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from mavdem.alignment.drive import DEMAND_MESSAGE
from mavdem.alignment.signals import MINIMUM_RATE
from mavdem.ingest import Component
from mavdem.ingest.telemetry import Telemetry

STREAMS_OFF = "`set streamrate -1`"  # of MAVProxy
REQUEST, SET_MESSAGE_INTERVAL = "REQUEST_DATA_STREAM", 511
"""How ground stations ask a vehicle for rates: a message, and a command of MAV_CMD."""
STREAM_RATE = re.compile(r"(SR|MAV)\d+_(EXTRA1|RC_CHAN)$")
"""ArduPilot's parameters for the rates of attitude and motor outputs on each port; MAV from 4.7 on."""
RATE_LIMITS = {"LOG_FILE_RATEMAX": 1, "LOG_MAV_RATEMAX": 2, "LOG_BLK_RATEMAX": 4}
"""ArduPilot's limits of the rate of each message, Hz, 0 for none, and the bits of LOG_BACKEND_TYPE that use them."""
FIRMWARE_VERSION, DEMAND_SINCE = re.compile(r"V(\d+)\.(\d+)"), (3, 3)
"""Where ArduCopter's version is in what it calls itself, and the first that logs RATE; some builds of its development
did not."""
HIGH_RATE_PROFILE = 1 << 4  # of PX4's SDLOG_PROFILE


def _kept_from_asking(telemetry: Telemetry, speakers: Sequence[Component]) -> str:
    """About whoever asks the vehicle for rates, which hold whatever it was set to; empty if none does."""
    own = (telemetry.system, telemetry.component)
    asking = [
        f"{speaker.system}:{speaker.component}"
        for speaker in speakers
        if REQUEST in speaker.messages and (speaker.system, speaker.component) != own
    ]
    if asking:
        return (
            f"A ground station ({', '.join(asking)}) sets rates with {REQUEST}: switch that off (in MAVProxy with "
            f"{STREAMS_OFF}). "
        )
    replies = telemetry.messages.get("COMMAND_ACK")
    if replies is not None and (np.asarray(replies["command"]) == SET_MESSAGE_INTERVAL).any():
        return (
            "Somebody asks for rates with SET_MESSAGE_INTERVAL, which the vehicle acknowledged: let them ask for more, "
            "or for none. "
        )
    return ""


def ask_for_rate(telemetry: Telemetry, rate: int = 100, speakers: Sequence[Component] = ()) -> str:
    """How to get attitude and motors at ``rate`` Hz out of this autopilot, by the settings that its log shows.

    Where one of the ``speakers`` asks for rates, how to end that comes first.

    PX4: https://docs.px4.io/main/en/modules/modules_communication (``mavlink``) and
    https://docs.px4.io/main/en/dev_log/logging. ArduPilot: https://ardupilot.org/dev/docs/mavlink-requesting-data.html;
    its stream groups EXTRA1 and RC_CHAN send ATTITUDE and SERVO_OUTPUT_RAW. ROS 2:
    https://docs.px4.io/main/en/middleware/uxrce_dds and MAVROS's ``plugins/sys_status.cpp``.
    """
    interval, kept = round(1e6 / rate), _kept_from_asking(telemetry, speakers)
    streams_off = "" if STREAMS_OFF in kept else f"{STREAMS_OFF}, "
    advice = {
        "uXRCE-DDS": "In PX4's src/modules/uxrce_dds_client/dds_topics.yaml add vehicle_attitude, "
        f"vehicle_angular_velocity and actuator_motors to the publications, no rate_limit below {rate}; build and "
        "flash PX4, and record anew.",
        "MAVROS": "Call `ros2 service call /mavros/set_message_interval mavros_msgs/srv/MessageInterval "
        f'"{{message_id: 31, message_rate: {rate}}}"` (attitude), then with 36 (motors), and record anew.',
        "DataFlash": _dataflash(telemetry),
        "ULog": _ulog(telemetry),
        "PX4": f"In PX4's shell run `mavlink stream -d DEVICE -s ATTITUDE -r {rate}` and "
        f"`mavlink stream -d DEVICE -s SERVO_OUTPUT_RAW_0 -r {rate}`, where DEVICE is the telemetry port "
        "(`-u PORT` for UDP), and record anew.",
        "ARDUPILOTMEGA": f"{_stream_rates(telemetry, rate)} and reboot, or in MAVProxy enter {streams_off}"
        f"`long SET_MESSAGE_INTERVAL 30 {interval}` and `long SET_MESSAGE_INTERVAL 36 {interval}`; then record anew.",
    }
    otherwise = (
        f"Ask the autopilot for messages 30 (ATTITUDE) and 36 (SERVO_OUTPUT_RAW) every {interval} µs with "
        "MAV_CMD_SET_MESSAGE_INTERVAL, and record anew."
    )
    return kept + (advice.get(telemetry.translated_from) or advice.get(telemetry.autopilot, otherwise))


def _stream_rates(telemetry: Telemetry, rate: int) -> str:
    """Which of ArduPilot's parameters to set, and which port's are high enough already."""
    asked = {found.group(): value for name, value in telemetry.parameters.items() if (found := STREAM_RATE.match(name))}
    family = {name[:2] for name in asked}
    named = "MAVn_EXTRA1 and MAVn_RC_CHAN" if family == {"MA"} else "SRn_EXTRA1 and SRn_RC_CHAN"
    if not family:
        named += " (MAVn_EXTRA1 and MAVn_RC_CHAN from ArduPilot 4.7)"
    ports = {name.partition("_")[0] for name in asked}
    fast = [
        f"{port}_EXTRA1 and {port}_RC_CHAN"
        for port in sorted(ports)
        if min(asked.get(f"{port}_EXTRA1", 0), asked.get(f"{port}_RC_CHAN", 0)) >= MINIMUM_RATE
    ]
    if fast:
        return (
            f"{', '.join(fast)} are {MINIMUM_RATE:.0f} or more already: if that is the port of this link, reboot, and "
            f"raise its baud rate if that does not help. Otherwise set the {named} of this link's port to {rate}"
        )
    return f"Set the telemetry port's {named} to {rate}"


def _dataflash(telemetry: Telemetry) -> str:
    """How to log attitude and the demand fast with ArduPilot; ArduCopter logs motor outputs (RCOU) at 10 Hz."""
    bitmask, firmware = telemetry.parameters.get("LOG_BITMASK"), telemetry.firmware
    is_set = bitmask is not None and bool(int(bitmask) & 1)
    already = "Bit 0 of LOG_BITMASK (fast attitude) is set already"
    found = FIRMWARE_VERSION.search(firmware)
    version = (int(found[1]), int(found[2])) if found else (0, 0)
    logs_demand = version > DEMAND_SINCE or (version == DEMAND_SINCE and "-dev" not in firmware)
    if DEMAND_MESSAGE not in telemetry.messages and (is_set or (found and not logs_demand)):
        missing, give = f"{already}, but there is no demand (RATE with ROut)", "give the log as the autopilot wrote it"
        if logs_demand:
            return f"{missing}, which {firmware} logs then: {give}, or fly anew."
        if not found:
            return f"{missing}: {give}, or fly anew with a firmware that logs it, such as ArduCopter from 3.3 on."
        with_bit = " with bit 0 of LOG_BITMASK (fast attitude) set"
        if is_set:
            with_bit = "; LOG_BITMASK has bit 0 (fast attitude) set already"
        return (
            f"{firmware} did not log the controller's demand (RATE with ROut): install ArduCopter "
            f"{'.'.join(map(str, DEMAND_SINCE))} or later, which APM 2 boards cannot run, and fly again{with_bit}."
        )
    backends = int(telemetry.parameters.get("LOG_BACKEND_TYPE", 7))
    limits = {name: telemetry.parameters.get(name, 0.0) for name, backend in RATE_LIMITS.items() if backend & backends}
    low = [name for name, limit in limits.items() if 0 < limit < MINIMUM_RATE]
    unlimited = "".join(f", and {name}, {limits[name]:g} Hz in this log, to 0" for name in low)
    effect = f"{unlimited}, which logs attitude and the demand at 50 Hz or more; fly anew."
    if bitmask is None:
        return f"If it is not set (the log does not show it), set bit 0 of LOG_BITMASK (fast attitude){effect}"
    if not is_set:
        changed = f"set it to {int(bitmask) | 1}, with bit 0 (fast attitude)"
        return f"LOG_BITMASK is {int(bitmask)} in this log: {changed}{effect}"
    if low:
        return f"{already}, but the rate of messages is limited: set {unlimited.removeprefix(', and ')}; fly anew."
    if telemetry.dropouts:
        return (
            f"{already}, but the logger had no room for {telemetry.dropouts} messages: use a faster card, raise "
            "LOG_FILE_BUFSIZE or clear other bits of LOG_BITMASK; fly anew."
        )
    return (
        f"{already}, and the log does not show why messages come no faster: fly anew if the bit was set after this "
        "flight began, and look at the load of the board (PM) and at what else the log was passed through."
    )


def _ulog(telemetry: Telemetry) -> str:
    """How to log attitude and the demand fast with PX4."""
    profile = telemetry.parameters.get("SDLOG_PROFILE")
    effect = "which logs attitude and the demand fast; reboot and fly anew."
    if profile is None:
        lacking = "this PX4 has no such parameter: update it" if telemetry.parameters else "the log does not show it"
        return f"Set SDLOG_PROFILE to 17 (default and high rate; {lacking}), {effect}"
    if not int(profile) & HIGH_RATE_PROFILE:
        fast = int(profile) | HIGH_RATE_PROFILE
        return f"SDLOG_PROFILE is {int(profile)} in this log: set it to {fast} (adds the high rate, bit 4), {effect}"
    already = f"SDLOG_PROFILE is {int(profile)}, so the high rate (bit 4) is set already"
    if telemetry.dropouts:
        return f"{already}, but the logger dropped out {telemetry.dropouts} times: use a faster card and fly anew."
    return (
        f"{already}: reboot if it was set after this boot, and remove etc/logging/logger_topics.txt from the card if "
        "it is there, because it replaces the profile; fly anew."
    )
