"""Advice on rates: how to get faster attitude and motor outputs from each autopilot, as a table.

PX4: https://docs.px4.io/main/en/modules/modules_communication (``mavlink``) and
https://docs.px4.io/main/en/dev_log/logging. ArduPilot: https://ardupilot.org/dev/docs/mavlink-requesting-data.html;
its stream groups EXTRA1 and RC_CHAN send ATTITUDE and SERVO_OUTPUT_RAW. ROS 2:
https://docs.px4.io/main/en/middleware/uxrce_dds and MAVROS's ``plugins/sys_status.cpp``.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from importlib.resources import files

import numpy as np

from mavdem.alignment.drive import DEMAND_MESSAGE
from mavdem.alignment.signals import MINIMUM_RATE
from mavdem.ingest import Component
from mavdem.ingest.telemetry import Telemetry

ADVICE: dict[str, str] = tomllib.loads((files("mavdem.alignment") / "rate_advice.toml").read_text("utf-8"))
"""Sentences by ``Telemetry.translated_from`` or else by autopilot."""
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


def ask_for_rate(telemetry: Telemetry, rate: int = 100, components: Sequence[Component] = ()) -> str:
    """Returns how to get attitude and motors at ``rate`` Hz out of this autopilot, by the settings that its log shows.

    How to stop one of the ``components`` from asking for rates comes first: those hold whatever the settings.
    """
    kept = _kept_from_asking(telemetry, components)
    recorder = telemetry.translated_from
    if recorder in ("DataFlash", "ULog"):
        return kept + (_dataflash(telemetry) if recorder == "DataFlash" else _ulog(telemetry))
    advice = ADVICE.get(recorder or telemetry.autopilot) or ADVICE.get(telemetry.autopilot, ADVICE[""])
    streams_off = "" if STREAMS_OFF in kept else f"{STREAMS_OFF}, "
    values = {"interval": round(1e6 / rate), "stream_rates": _stream_rates(telemetry, rate), "streams_off": streams_off}
    return kept + advice.format(rate=rate, **values)


def _kept_from_asking(telemetry: Telemetry, components: Sequence[Component]) -> str:
    own = (telemetry.system, telemetry.component)
    others = (one for one in components if REQUEST in one.messages and (one.system, one.component) != own)
    if asking := ", ".join(f"{one.system}:{one.component}" for one in others):
        off = f"switch that off (in MAVProxy with {STREAMS_OFF})"
        return f"A ground station ({asking}) sets rates with {REQUEST}: {off}. "
    replies = telemetry.messages.get("COMMAND_ACK")
    if replies is None or not (np.asarray(replies["command"]) == SET_MESSAGE_INTERVAL).any():
        return ""
    acknowledged = "Somebody asks for rates with SET_MESSAGE_INTERVAL, which the vehicle acknowledged"
    return f"{acknowledged}: let them ask for more, or for none. "


def _stream_rates(telemetry: Telemetry, rate: int) -> str:
    asked = {name: value for name, value in telemetry.parameters.items() if STREAM_RATE.match(name)}
    old, new = "SRn_EXTRA1 and SRn_RC_CHAN", "MAVn_EXTRA1 and MAVn_RC_CHAN"
    named = new if all(name.startswith("MAV") for name in asked) else old
    named = named if asked else f"{old} ({new} from ArduPilot 4.7)"
    ports = {port: (f"{port}_EXTRA1", f"{port}_RC_CHAN") for port in sorted({name.partition("_")[0] for name in asked})}
    fast = [" and ".join(both) for both in ports.values() if min(asked.get(one, 0) for one in both) >= MINIMUM_RATE]
    if not fast:
        return f"Set the telemetry port's {named} to {rate}"
    known = f"{', '.join(fast)} are {MINIMUM_RATE:.0f} or more already: if that is the port of this link, reboot, and "
    known += "raise its baud rate if that does not help."
    return f"{known} Otherwise set the {named} of this link's port to {rate}"


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
        bit = "; LOG_BITMASK has bit 0 (fast attitude) set already"
        anew = f"and fly again{bit if is_set else ' with bit 0 of LOG_BITMASK (fast attitude) set'}."
        since = f"install ArduCopter {'.'.join(map(str, DEMAND_SINCE))} or later, which APM 2 boards cannot run"
        return f"{firmware} did not log the controller's demand (RATE with ROut): {since}, {anew}"
    backends = int(telemetry.parameters.get("LOG_BACKEND_TYPE", 7))
    limits = {name: telemetry.parameters.get(name, 0.0) for name, backend in RATE_LIMITS.items() if backend & backends}
    low = [f"{name}, {limit:g} Hz in this log, to 0" for name, limit in limits.items() if 0 < limit < MINIMUM_RATE]
    effect = f"{''.join(f', and {one}' for one in low)}, which logs attitude and the demand at 50 Hz or more; fly anew."
    if bitmask is None:
        return f"If it is not set (the log does not show it), set bit 0 of LOG_BITMASK (fast attitude){effect}"
    if not is_set:
        changed = f"set it to {int(bitmask) | 1}, with bit 0 (fast attitude)"
        return f"LOG_BITMASK is {int(bitmask)} in this log: {changed}{effect}"
    if low:
        return f"{already}, but the rate of messages is limited: set {', and '.join(low)}; fly anew."
    if telemetry.dropouts:
        card = "use a faster card, raise LOG_FILE_BUFSIZE or clear other bits of LOG_BITMASK; fly anew."
        return f"{already}, but the logger had no room for {telemetry.dropouts} messages: {card}"
    late = "fly anew if the bit was set after this flight began"
    load = "look at the load of the board (PM) and at what else the log was passed through"
    return f"{already}, and the log does not show why messages come no faster: {late}, and {load}."


def _ulog(telemetry: Telemetry) -> str:
    profile = telemetry.parameters.get("SDLOG_PROFILE")
    effect = "which logs attitude and the demand fast; reboot and fly anew."
    if profile is None:
        lacking = "this PX4 has no such parameter: update it" if telemetry.parameters else "the log does not show it"
        return f"Set SDLOG_PROFILE to 17 (default and high rate; {lacking}), {effect}"
    fast = int(profile) | 1 << 4  # the high rate
    if fast != int(profile):
        return f"SDLOG_PROFILE is {int(profile)} in this log: set it to {fast} (adds the high rate, bit 4), {effect}"
    already = f"SDLOG_PROFILE is {int(profile)}, so the high rate (bit 4) is set already"
    if telemetry.dropouts:
        return f"{already}, but the logger dropped out {telemetry.dropouts} times: use a faster card and fly anew."
    topics = "remove etc/logging/logger_topics.txt from the card if it is there, because it replaces the profile"
    return f"{already}: reboot if it was set after this boot, and {topics}; fly anew."
